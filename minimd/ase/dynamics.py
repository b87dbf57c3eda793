"""Velocity Verlet for ASE's scripts, in compiled steps."""

from collections.abc import Sequence

import numpy as np
from ase import Atoms
from ase.md.md import MolecularDynamics
from numpy.typing import NDArray

from minimd import integrators
from minimd.ase.calculator import Calculator
from minimd.forces.forces import Potential
from minimd.simulation.simulation import Simulation
from minimd.structure.ase_atoms import cell_of, same_scene
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

    _simulation: Simulation
    _made_for: Atoms | None = None
    _made_with: Potential | Sequence[Potential]

    def run(self, steps: int = 50) -> bool:
        """Make so many steps; True at their end, False if an observer lowered max_steps."""
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
        atoms, simulation = self.atoms, self._simulation_at(self.atoms)
        simulation.method = integrators.VelocityVerlet(self.dt)
        start = simulation.step
        try:
            record = simulation.run(n_steps, every=n_steps, progress=False)
        finally:
            self.nsteps += simulation.step - start
            atoms.positions[:] = simulation.positions
            atoms.set_momenta(_momenta(simulation), apply_constraint=False)
        atoms.calc.adopt(atoms, float(record.potential_energy[-1]), simulation.forces)

    def _simulation_at(self, atoms: Atoms) -> Simulation:
        """The simulation, with positions and momenta of the atoms; a new one if anything else was changed from outside."""
        made_for = self._made_for
        if (
            made_for is None
            or atoms.constraints
            or self._simulation.constraints
            or not (same_scene(made_for, atoms) and cell_of(made_for).same_as(cell_of(atoms)))
        ):
            return self._new_simulation(atoms)
        if atoms.calc.potentials is not self._made_with:
            return self._new_simulation(atoms)
        simulation = self._simulation
        simulation.positions[:] = atoms.positions
        if not np.array_equal(atoms.get_momenta(), _momenta(simulation)):
            simulation.velocities[:] = atoms.get_velocities()
        return simulation

    def _new_simulation(self, atoms: Atoms) -> Simulation:
        calculator = atoms.calc
        if not isinstance(calculator, Calculator):
            name = type(calculator).__name__
            raise TypeError(f"the calculator of atoms must be a minimd.ase.Calculator; it is {name}: use ase.md.verlet.VelocityVerlet")
        system, method = System.from_ase(atoms, calculator.bonds), integrators.VelocityVerlet(self.dt)
        options = calculator.options
        self._simulation = Simulation(system, calculator.potentials, method, threads=options.threads, precision=options.precision, skin=options.skin)
        self._made_for = atoms.copy()
        self._made_for.calc = calculator
        self._made_with = calculator.potentials
        return self._simulation


def _momenta(simulation: Simulation) -> NDArray[np.float64]:
    return simulation.velocities * simulation.system.masses[:, None]
