"""Velocity Verlet for ASE's scripts, in compiled steps."""

from collections.abc import Sequence

import numpy as np
from ase import Atoms
from ase.md.md import MolecularDynamics
from numpy.typing import NDArray

from minimd.ase.calculator import Calculator
from minimd.diagnosis.run_guard import RunGuard
from minimd.engine.engine import Engine
from minimd.forces.forces import Potential
from minimd.integrators.splitting.verlet import VelocityVerlet as Method
from minimd.structure.ase_atoms import cell_of, same_scene
from minimd.structure.console import stop_on_signals
from minimd.structure.system import System


class VelocityVerlet(MolecularDynamics):
    """ase.md.verlet.VelocityVerlet for atoms whose calculator is a minimd Calculator, with the steps made by minimd.

    run makes all steps between two observations at once, then brings atoms, momenta and the calculator's results up to
    date; an observer may change positions, momenta or cell. irun yields after every step, as ASE's does.
    Parameters (atoms, timestep, trajectory, logfile, loginterval), attach and get_time are ASE's.

    Raises
    ------
    TypeError : when it runs, if the calculator of the atoms is another one.  ValueError : for constraints that minimd does not know.
    NonFiniteError : if the run blows up; atoms hold the last good state.
    KeyboardInterrupt : after Ctrl-C; atoms hold the state of the last whole step.
    """

    guard: RunGuard
    _made_for: Atoms | None = None
    _made_with: Potential | Sequence[Potential]

    def run(self, steps: int = 50) -> bool:
        """Make this many steps. Returns False if an observer lowered max_steps below nsteps, else True."""
        next(self.irun(steps))  # what ASE does before the first step
        while self.nsteps < self.max_steps:
            self._advance(self._next_look() - self.nsteps)
            self._refresh_properties()
            self.log()
            self.call_observers()
        return self.nsteps == self.max_steps

    def step(self) -> NDArray[np.float64]:
        """Make one step, which the caller counts; returns the forces after it, (N, 3) [eV/Å]."""
        self._advance(1)
        self.nsteps -= 1
        return self.atoms.get_forces(md=True)

    def _next_look(self) -> int:
        """The step after which the next observer is due, or the last one: interval n > 0 is every n-th, −n the n-th only."""
        looks = [n * (self.nsteps // n + 1) if n > 0 else -n for _, n, _, _ in self.observers]
        return min([self.max_steps, *(look for look in looks if look > self.nsteps)])

    def _advance(self, n_steps: int) -> None:
        """Make n_steps steps; atoms and nsteps are right also after an exception."""
        atoms, guard = self.atoms, self._guard_at(self.atoms)
        engine, start = guard.engine, guard.engine.step
        engine.method = Method(self.dt)
        try:
            with stop_on_signals(engine.surroundings):
                guard.check_start()
                guard.observe()
                guard.make_steps(n_steps, with_energy=True)
                frame = guard.observe()
        finally:
            self.nsteps += engine.step - start
            atoms.positions[:] = engine.positions
            atoms.set_momenta(_momenta(engine), apply_constraint=False)
        atoms.calc.adopt(atoms, frame.observables["potential_energy"], engine.forces)

    def _guard_at(self, atoms: Atoms) -> RunGuard:
        """The guarded engine, with positions and momenta of the atoms; a new one if anything else was changed from outside."""
        made_for = self._made_for
        if (
            made_for is None
            or atoms.constraints
            or self.guard.engine.constraints
            or not (same_scene(made_for, atoms) and cell_of(made_for).same_as(cell_of(atoms)))
            or atoms.calc.potentials is not self._made_with
        ):
            return self._new_guard(atoms)
        engine = self.guard.engine
        engine.positions[:] = atoms.positions
        if not np.array_equal(atoms.get_momenta(), _momenta(engine)):
            engine.velocities[:] = atoms.get_velocities()
        return self.guard

    def _new_guard(self, atoms: Atoms) -> RunGuard:
        calculator = atoms.calc
        if not isinstance(calculator, Calculator):
            name = type(calculator).__name__
            raise TypeError(f"the calculator of atoms must be a minimd.ase.Calculator; it is {name}: use ase.md.verlet.VelocityVerlet")
        system = System.from_ase(atoms, calculator.bonds)
        self.guard = RunGuard(Engine(system, calculator.potentials, Method(self.dt), options=calculator.options))
        self._made_for = atoms.copy()
        self._made_for.calc = calculator
        self._made_with = calculator.potentials
        return self.guard


def _momenta(engine: Engine) -> NDArray[np.float64]:
    return engine.velocities * engine.system.masses[:, None]
