"""ASE's molecular dynamics with the steps made by minimd: the base of all its classes, and velocity Verlet."""

from collections.abc import Iterator
from typing import Any, TypeVar

import ase.md.verlet
import numpy as np
from ase import Atoms
from ase.io.jsonio import encode
from ase.md.md import MolecularDynamics
from numpy.typing import NDArray

from minimd.ase.calculator import Calculator
from minimd.core.console.quiet import warn
from minimd.core.console.signals import stop_on_signals
from minimd.core.diagnosis.run_guard import RunGuard
from minimd.core.engine.engine import Engine
from minimd.core.integrators.rows import VelocityVerlet as Method
from minimd.core.integrators.splitting import Splitting
from minimd.core.potentials.term import CalculatorTerm, calculators_said
from minimd.core.structure.arrays import Array
from minimd.core.structure.ase_atoms import fixes_center, same_scene
from minimd.core.structure.system import System
from minimd.core.structure.units import ASE

T = TypeVar("T", bound=MolecularDynamics)


class MinimdSteps(MolecularDynamics):
    """A mixin with which a class of ase.md makes its steps with minimd, put before that class in the list of bases.

    run makes all steps between two observations at once, then updates atoms, momenta and the calculator's results
    (energy, forces, stress). Changes between two blocks take effect in the next block: positions, momenta, cell,
    masses, charges, calculator, potentials, constraints, time step, temperature, friction. irun yields after every
    step, and step makes one step, as in ASE.

    Forces are those of minimd's potentials if the calculator of the atoms is a minimd.ase.Calculator. The forces of any
    other calculator can be used, too, at its speed; a warning says so once.

    Raises
    ------
    ValueError : in a run, for constraints that minimd does not know, with their names.
    NonFiniteError, ConstraintError : if the run blows up; atoms hold the last good state.
    KeyboardInterrupt : after Ctrl-C; atoms hold the state of the last whole step.
    """

    _guard: RunGuard
    _made_for: Atoms | None = None
    _made_with: Any = None  # potentials of the calculator, constraints
    _is_new_run = True  # no step of the present run was made yet
    _steps_made = 0  # in all calls; the noise depends on it
    _is_told = False

    def __repr__(self) -> str:
        return f"{type(self).__name__}({len(self.atoms)} atoms, timestep {ASE.shown(self.dt)}, step {self.nsteps})"

    def method(self) -> Splitting:
        """The method of minimd with the present parameters."""
        raise NotImplementedError(f"{type(self).__name__} has no method")

    def run(self, steps: int = 50) -> bool:
        """Make this many steps. Returns False if an observer lowered max_steps below nsteps, else True."""
        own = (MinimdSteps.step, MolecularDynamics.log)
        present = tuple(getattr(method, "__func__", None) for method in (self.step, self.log))
        if present != own:  # one was replaced, as by a log of every step
            return bool(super().run(steps))
        next(self.irun(steps))  # what ASE does before the first step
        while self.nsteps < self.max_steps:
            # An interval n > 0 of an observer means every n-th step, −n the n-th step only.
            looks = [n * (self.nsteps // n + 1) if n > 0 else -n for _, n, _, _ in self.observers]
            end = min([self.max_steps, *(look for look in looks if look > self.nsteps)])
            self._advance(int(end) - self.nsteps)
            self._refresh_properties()
            self.log()
            self.call_observers()
        return bool(self.nsteps == self.max_steps)

    def irun(self, steps: int = 50) -> Iterator[bool]:
        """Make this many steps one by one, and yield after each, as in ASE."""
        self._is_new_run = True
        return super().irun(steps)  # type: ignore[no-any-return]

    def step(self, forces: Array | None = None) -> Array:
        """Make one step, without changing nsteps; returns the forces after it, (N, 3) [eV/Å].
        forces : at the present positions, as in ASE's classes; they are ignored, because they are already known."""
        self._advance(1)
        self.nsteps -= 1
        return np.asarray(self.atoms.get_forces(md=True))

    def _advance(self, n_steps: int) -> None:
        """Make n_steps steps; atoms and nsteps are right also after an exception."""
        atoms = self.atoms
        guard, is_same_run = self._guard_at(atoms)
        engine = guard.engine
        start = engine.step
        reservoir_energy = engine.reservoir_energy
        engine.method = self.method()
        engine.noise_shift = self._steps_made - start
        try:
            with stop_on_signals(engine.surroundings):
                guard.check_start(is_same_run)
                guard.observe()
                guard.make_steps(n_steps, with_energy=True)
                guard.observe()
        finally:
            self.nsteps += engine.step - start
            self._steps_made += engine.step - start
            self._count_heat(engine.reservoir_energy - reservoir_energy)
            atoms.positions[:] = engine.positions
            atoms.set_momenta(_momenta(engine), apply_constraint=False)
        if isinstance(atoms.calc, Calculator):
            atoms.calc.adopt(atoms, engine.sums)

    def _count_heat(self, energy: float) -> None:
        """Take notice of the energy [eV] that the bath has given to the atoms."""

    def _guard_at(self, atoms: Atoms) -> tuple[RunGuard, bool]:
        """The guarded engine, with positions and momenta of the atoms; a new one if anything else was changed.
        Also returns whether this continues the run of its last steps, with atoms that were not moved since."""
        before = self._made_for
        is_new_run = self._is_new_run
        self._is_new_run = False
        if before is None or not same_scene(before, atoms):
            return self._new_guard(atoms), False
        if not np.array_equal(before.cell.array, atoms.cell.array):
            return self._new_guard(atoms), False
        engine = self._guard.engine
        potentials, constraints = _essence(atoms)
        is_known = potentials is self._made_with[0] and constraints == self._made_with[1]
        # rigid bonds are measured again where atoms have moved
        has_moved = constraints and not np.array_equal(atoms.positions, engine.positions)
        if has_moved or not is_known:
            return self._new_guard(atoms), False
        engine.positions[:] = atoms.positions
        if not np.array_equal(atoms.get_momenta(), _momenta(engine)):
            engine.velocities[:] = atoms.get_velocities()
        is_same_run = engine.enter() and not is_new_run
        if not isinstance(atoms.calc, Calculator):
            # its parameters may have changed: it is called again, and answers at once if they have not
            engine.changed()
        return self._guard, is_same_run

    def _new_guard(self, atoms: Atoms) -> RunGuard:
        calculator = atoms.calc
        if calculator is None:
            raise RuntimeError(
                "the atoms have no calculator; set atoms.calc, for example to a minimd.ase.Calculator"
            )
        bonds = options = None
        potentials: Any = ForcesOnAtoms(atoms)
        is_own = isinstance(calculator, Calculator)
        if is_own:
            bonds = calculator.bonds
            potentials = calculator.potentials
            options = calculator.options
        system = System.from_ase(atoms, bonds)
        if not (is_own or self._is_told):
            warn(calculators_said(calculator))
            self._is_told = True
        engine = Engine(system, potentials, self.method(), options=options)
        engine.step = self.nsteps
        engine.counts_center = True
        self._guard = RunGuard(engine)
        self._made_for = atoms.copy()
        self._made_with = _essence(atoms)
        self._made_for.calc = calculator
        return self._guard


def named_as_in_ase(dynamics: type[T]) -> type[T]:
    """A class under the name of the class of ASE from which it derives, as trajectories, logs and scripts know it.
    In sources it has another one, for the methods of minimd have those names."""
    dynamics.__name__ = dynamics.__qualname__ = dynamics.__bases__[-1].__name__
    return dynamics


@named_as_in_ase
class VelocityVerletDynamics(MinimdSteps, ase.md.verlet.VelocityVerlet):
    """ase.md.verlet.VelocityVerlet with the steps made by minimd: the same motion, to rounding.
    Parameters, attach, irun, get_time and everything else are those of ASE. Raises : see MinimdSteps."""

    def method(self) -> Splitting:
        """Velocity Verlet."""
        return Method(self.dt)


VelocityVerlet = VelocityVerletDynamics


def _momenta(engine: Engine) -> Array:
    return engine.velocities * engine.system.masses[:, None]


def _essence(atoms: Atoms) -> tuple[Any, list[str]]:
    """The potentials of the calculator, if it is minimd's, and the constraints as texts."""
    potentials = atoms.calc.potentials if isinstance(atoms.calc, Calculator) else None
    return potentials, [encode(constraint.todict()) for constraint in atoms.constraints]


class ForcesOnAtoms:
    """A potential for one ase.Atoms: forces and energy from its calculator, which is called with these atoms and all
    their arrays. Their positions follow those of the system. The virial is NaN: the stress is not needed here."""

    def __init__(self, atoms: Atoms) -> None:
        self._atoms = atoms

    def __repr__(self) -> str:
        return f"ForcesOnAtoms({type(self._atoms.calc).__name__})"

    def bind(self, system: System) -> "WithoutVirial":
        """The term that gets the forces on the atoms from the calculator."""
        return WithoutVirial(self._atoms)


class WithoutVirial(CalculatorTerm):
    """Forces and energy only. If the atoms have FixCom, the force on their center of mass is removed, in proportion to
    the masses."""

    def add(
        self, system: System, detail: int, forces: NDArray, energies: NDArray, virials: NDArray
    ) -> None:
        """See CalculatorTerm."""
        super().add(system, detail, forces, energies, virials)
        if fixes_center(self._atoms):
            forces -= system.masses[:, None] / system.masses.sum() * forces.sum(axis=0)

    def _virial(self, system: System, forces: Array) -> Array:
        return np.full(6, np.nan)
