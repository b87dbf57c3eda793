"""Motion: a system, its forces, its constraints and a method; the state, and what can be asked of it."""

import warnings
from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from minimd.constraints.constraint_set import ConstraintSet
from minimd.constraints.solver import ConstraintSolver
from minimd.diagnosis.causes import Moment
from minimd.forces.forces import Forces, Potential
from minimd.forces.options import Options
from minimd.integrators.splitting.splitting import Splitting, State
from minimd.potentials.term import FORCES, TOTALS
from minimd.structure.console import outside_minimd
from minimd.structure.constraints import Constraint
from minimd.structure.system import System
from minimd.structure.velocities import maxwell_boltzmann, rescaled

if TYPE_CHECKING:
    import ase


class Motion:
    """The state of a simulation and what can be asked of it; see Simulation for the parameters."""

    def __init__(
        self,
        system: "System | ase.Atoms",
        potentials: Potential | Sequence[Potential],
        method: Splitting,
        constraints: Constraint | Sequence[Constraint] | None,
        options: Options,
    ) -> None:
        self._method = _checked(method)
        self._system = system.copy() if isinstance(system, System) else System.from_ase(system)
        self.step = 0
        self.time = 0.0
        self._forces = Forces(self.system, potentials, options)
        _warn_of_dropped(self._system.constraints, constraints)
        self._rigidity = ConstraintSet(self.system, self.system.constraints if constraints is None else constraints, options.most_threads)
        self.system.constraints = self._rigidity.kept
        self._state = State(self.system.positions, self.system.velocities, self._forces.forces, self._rigidity.inverse_masses)
        self._state.constraints = self._rigidity.bonds
        self._state.k_B = self.system.units.k_B
        self._share_energy()
        self.noise_shift, self._equilibrated = 0, 0  # noise of step n is that of n + shift; steps of equilibrations so far

    def __repr__(self) -> str:
        return f"{type(self).__name__}({self.system!r}, {self.method!r}, step {self.step})"

    @property
    def system(self) -> System:
        """The state; its arrays can be changed, not replaced by those of another system."""
        return self._system

    @property
    def method(self) -> Splitting:
        """The integrator with its time step; another one takes over from the next run on.

        Raises, when it is set
        ----------------------
        TypeError : for anything but a splitting with its time step.  ValueError : if it leaves no degree of freedom.
        """
        return self._method

    @method.setter
    def method(self, method: Splitting) -> None:
        self._rigidity.degrees_of_freedom(_checked(method).conserves_momentum)
        self._method = method
        self._share_energy()

    @property
    def n_dof(self) -> int:
        """Degrees of freedom that share the kinetic energy."""
        return self._rigidity.degrees_of_freedom(self.method.conserves_momentum)

    @property
    def heat(self) -> float:
        """What a thermostat has put in since the start [energy]; set it when a run is resumed."""
        return self._state.heat

    @heat.setter
    def heat(self, heat: float) -> None:
        self._state.heat = heat

    @property
    def conserves_momentum(self) -> bool:
        """Whether the total momentum is a constant: nothing is fixed, and no bath acts on atoms one by one."""
        return self.method.conserves_momentum and not self._rigidity.n_fixed

    @property
    def constraints(self) -> tuple[Constraint, ...]:
        """What is held fixed, with the lengths that are kept; also those of system."""
        return self._rigidity.kept

    @property
    def potentials(self) -> tuple[Potential, ...]:
        """What acts on the atoms."""
        return self._forces.potentials

    @property
    def options(self) -> Options:
        """Threads, precision and skin, as they were asked for."""
        return self._forces.options

    @property
    def moment(self) -> Moment:
        """A copy of the present state, for go_to."""
        return Moment(self.step, self.time, *self._saved())

    def go_to(self, moment: Moment) -> None:
        """Go back to a state."""
        self.step, self.time = moment.step, moment.time
        self._restore(moment[2:])

    @property
    def rigid_bonds(self) -> ConstraintSolver | None:
        """Lengths that are held, as they are kept in a run; None without."""
        return self._rigidity.bonds

    @property
    def skins(self) -> list[float]:
        """Of all lists that have one [length]."""
        return self._forces.skins

    @property
    def inverse_masses(self) -> NDArray[np.float64]:
        """(N,) [1/mass], zero of atoms that are held fixed."""
        return self._rigidity.inverse_masses

    def forces_displaced(self, displacements: NDArray[np.float64]) -> NDArray[np.float64]:
        """Forces, (N, 3) [energy/length], with all atoms moved by (N, 3) [length]; they are put back."""
        here = self.positions.copy()
        self.positions[:] += displacements
        try:
            return self._forces.compute(FORCES).copy()
        finally:
            self.positions[:] = here
            self._state.forces_are_current = False

    @property
    def positions(self) -> NDArray[np.float64]:
        """(N, 3) [length], never wrapped."""
        return self.system.positions

    @property
    def velocities(self) -> NDArray[np.float64]:
        """(N, 3) [length/time]."""
        return self.system.velocities

    @property
    def forces(self) -> NDArray[np.float64]:
        """(N, 3) [energy/length], of the last evaluation."""
        return self._forces.forces

    def set_temperature(self, temperature: float, seed: int | None = None) -> None:
        """Draw Maxwell-Boltzmann velocities: kinetic temperature exactly this one, total momentum zero (of several free atoms).

        Raises
        ------
        ValueError : if the temperature is negative or not finite.
        """
        self.velocities[:] = maxwell_boltzmann(self.system.masses, temperature, self.system.units.k_B, seed)
        self._fit_images()
        self._rigidity.project(self.velocities, self.positions)
        if temperature > 0.0:
            self.rescale_temperature(temperature)

    def rescale_temperature(self, temperature: float) -> None:
        """Multiply all velocities so that the kinetic temperature is exactly this one.

        Raises
        ------
        ValueError : if the temperature is negative or not finite, or nothing moves.
        """
        self.velocities[:] = rescaled(self.velocities, self.system.masses, temperature, self.system.units.k_B, self.n_dof)

    def _fit_images(self) -> None:
        """Take rigid bonds at their present images: between two runs atoms may have been moved by lattice vectors."""
        self._rigidity.fit(self.system)
        self._state.constraints = self._rigidity.bonds

    def _share_energy(self) -> None:
        """Tell the state which motions share the kinetic energy; a single atom keeps its three."""
        self._state.n_dof = self.n_dof
        self._state.conserves_momentum = self.conserves_momentum and len(self.system) > 1

    def _look(self) -> None:
        """Make sure that forces, energy and virial are those of the present positions."""
        if not (self._state.forces_are_current and self._forces.has_energy):
            self._compute_forces(self._state, True)
            self._state.forces_are_current = True

    def _compute_forces(self, _state: State, look: bool) -> None:
        self._forces.compute(TOTALS if look else FORCES)

    def _saved(self) -> tuple[NDArray, NDArray, float]:
        return self.positions.copy(), self.velocities.copy(), self._state.heat

    def _restore(self, state: tuple[NDArray, NDArray, float]) -> None:
        self.positions[:], self.velocities[:], self._state.heat = state
        self._state.forces_are_current = False


def _checked(method: Splitting) -> Splitting:
    if not isinstance(method, Splitting):
        raise TypeError(f"method must be an integrator with its time step, such as VelocityVerlet(0.005); got {method!r}")
    return method


def _warn_of_dropped(those_of_system: Sequence[Constraint], given: Constraint | Sequence[Constraint] | None) -> None:
    """Say that constraints of a kind were not given again, where others are given instead of those of the system."""
    if given is None:
        return
    kinds = {type(one) for one in (given if isinstance(given, Sequence) else [given])}
    dropped = [repr(one) for one in those_of_system if type(one) not in kinds]
    if kinds and dropped:
        warnings.warn(f"{', '.join(dropped)} of the system are not kept: other constraints are given in their place", stacklevel=outside_minimd())
