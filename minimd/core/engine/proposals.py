"""Hybrid Monte Carlo on an engine: new momenta, and decisions about trajectories; by whole numbers in fixed point."""

from collections.abc import Callable
from fractions import Fraction
from functools import partial
from math import exp, inf, nan

import numpy as np

from minimd.core.compiled.normal_numbers import OF_DECISIONS, UNIT, philox
from minimd.core.compiled.program import Program
from minimd.core.constraints.constraint_set import ConstraintSet
from minimd.core.forces.forces import ForceResult, Forces
from minimd.core.integrators.exact_chances import WIDEST, happens, rotated, whole_normals
from minimd.core.integrators.hybrid_monte_carlo import CHECKED, HybridMonteCarlo
from minimd.core.integrators.state import GridState, State, Surroundings
from minimd.core.integrators.steps import FIRST, Moment
from minimd.core.structure.arrays import Array, Indices
from minimd.core.structure.system import System

CHECKED_EVERY = 1000  # proposals
SAME_FORCE = 1e-6  # of the largest one
CLOSE = 1e-6  # of the way, with rigid bonds: farther from the start, a trajectory has not come back
ROOM = 16  # widths of the momenta that must be in the range of a grid
OF_MOMENTA, OF_PROPOSALS, OF_VOLUMES = range(3)  # words of decisions


def half_squares(widths: Indices, *momenta: Array) -> Fraction:
    """Σ p²/2s² of whole numbers, each (N, 3), with widths s, (N,); of atoms with s > 0."""
    total = Fraction(0)
    for s in np.unique(widths[widths > 0]).tolist():
        chosen = np.concatenate([p[widths == s].ravel() for p in momenta])
        whole = chosen.astype(np.int64).astype(object)
        total += Fraction(int(whole @ whole), 2 * s * s)
    return total


class Proposals:
    """The proposals of a method on the parts of an engine.

    Raises ValueError for a scene that cannot be sampled so: see check.
    """

    def __init__(
        self,
        method: HybridMonteCarlo,
        system: System,
        state: State,
        interactions: Forces,
        surroundings: Surroundings,
        constraints: ConstraintSet,
    ) -> None:
        self._method = method
        self._system = system
        self._state = state
        self._around = surroundings
        self._before = state.positions, state.velocities
        self._level: float | Fraction = nan
        self._counts = np.zeros(3, dtype=np.int64)
        at = Moment(self._counts)
        touch = partial(method.touch, state, method.duration, surroundings, at)
        self._renewal = Program(touch, lambda: 0, interactions.pool)
        self._check(interactions, constraints)

    def thermal(self, number: int) -> float:
        """k_B T at a step [energy]."""
        return self._system.units.k_B * self._method.temperature_at(number)

    def widths(self, state: GridState, number: int) -> Indices:
        """(N,) of the Gaussians of whole momenta, √(m k_B T) in steps, rounded; 0 for atoms that are held fixed."""
        width = np.sqrt(state.masses * self.thermal(number)) / state.grid.momentum
        return np.rint(width).astype(np.int64)

    def begin(self, number: int, potential_energy: float) -> None:
        """New velocities for the step with this number; the state is remembered."""
        if isinstance(self._state, GridState):
            self._renew(self._state, number)
        else:
            self._counts[FIRST] = number
            self._renewal.run()
        self._before = self._state.positions.copy(), self._state.velocities.copy()
        self._level = self.level(number, potential_energy)

    def _renew(self, state: GridState, number: int) -> None:
        """New momenta; or old ones that turn towards new ones, which is accepted with exact balance, too."""
        method = self._method
        widths = self.widths(state, number)
        drawn = whole_normals(method.seed, number, widths, self._system.dimensions).astype(float)
        kept, _ = method.kept_and_lost(method.duration)
        p = drawn
        if kept:
            old = state.grid.momenta(state.velocities, state.inverse_masses)
            p, q = rotated(old, drawn, kept)
            x = half_squares(widths, p, q) - half_squares(widths, old, drawn)
            is_in_range = max(np.abs(p).max(), np.abs(q).max()) <= WIDEST
            if not (is_in_range and self._happens(x, OF_MOMENTA, number)):
                p = old
        state.velocities[:] = state.grid.velocities(p, state.inverse_masses)

    def level(self, number: int, potential_energy: float) -> float | Fraction:
        """H/k_B T of the present state; in fixed point a rational number."""
        state = self._state
        thermal = self.thermal(number)
        if not isinstance(state, GridState):
            return (potential_energy + state.kinetic_energy()) / thermal
        momenta = state.grid.momenta(state.velocities, state.inverse_masses)
        kinetic = half_squares(self.widths(state, number), momenta)
        return Fraction(potential_energy) / Fraction(thermal) + kinetic

    def decide(self, number: int, potential_energy: float) -> bool:
        """Whether the trajectory to the present state is accepted; if not, it is taken back, and velocities are turned
        round."""
        x = self.level(number, potential_energy) - self._level
        is_accepted = self._happens(x, OF_PROPOSALS, number)
        self._method.note(float(x), is_accepted)
        if not is_accepted:
            self.take_back()
            self._state.velocities *= -1.0
        return is_accepted

    def take_back(self) -> None:
        """Return to the state before the trajectory; forces are left."""
        self._state.positions[:], self._state.velocities[:] = self._before

    def accepts_volume(self, number: int, x: float) -> bool:
        """Whether another cell is accepted; x = ΔH/k_B T of the change, see StochasticCellRescaling."""
        return self._happens(x, OF_VOLUMES, number)

    def _happens(self, x: float | Fraction, which: int, number: int) -> bool:
        """True with probability min(1, e^(−x)); false of NaN."""
        generator = philox(self._method.seed, OF_DECISIONS, number, which).bit_generator
        words: Callable[[], int] = generator.random_raw  # type: ignore[attr-defined]
        if isinstance(x, Fraction):
            return happens(x, words)
        return x <= 0.0 or (words() >> 11) * UNIT < exp(-x)

    def audit(self, go: Callable[[], float | None], evaluated: Callable[[], ForceResult]) -> None:
        """Check what balance rests on. Forces computed twice must agree. In fixed point, and with rigid bonds, a
        trajectory is made, and undone, and must come back, in fixed point to the last bit; there the energy must stay
        the same if each atom is moved by lattice vectors.

        go : makes a trajectory, see Engine.
        evaluated : forces and energy of the present state, computed anew.
        Raises RuntimeError if it is not so."""
        state = self._state
        fault = ""
        forces = state.forces.copy()
        apart = float(np.abs(evaluated().forces - forces).max())
        if apart > SAME_FORCE * np.abs(forces).max():
            fault = f"forces computed twice differ by {apart:.1e}"
        is_exact = isinstance(state, GridState)
        if is_exact or self._around.constraints is not None:
            for _ in range(2):
                end = go()
                state.velocities *= -1.0
                if end is None or not end < inf:
                    self.take_back()
                    return
            fault = fault or self._missed()
            self.take_back()
        if is_exact:
            energy = evaluated().potential_energy
            cell = self._system.cell
            signs = 1.0 - 2.0 * (np.arange(len(forces)) % 2)
            state.positions += np.outer(signs, cell.vectors[cell.pbc].sum(axis=0))
            elsewhere = evaluated().potential_energy
            self.take_back()
            if elsewhere != energy:
                fault = f"the energy is {energy!r}, and {elsewhere!r} of atoms that are each moved by lattice vectors"
        if fault:
            raise RuntimeError(
                f"{self._method.name} cannot go on: {fault}; forces must be functions of the positions, and rigid "
                "bonds be found again: take a shorter time step, or look at potentials of your own"
            )
        self._method.memory[CHECKED] += 1.0

    def _missed(self) -> str:
        """A clause if a trajectory that was undone has not come back; empty if it has."""
        state = self._state
        positions, velocities = self._before
        way = float(np.abs(state.positions - positions).max())
        if isinstance(state, GridState):
            is_back = way == 0.0 and np.array_equal(state.velocities, velocities)
        else:
            is_back = way <= CLOSE * np.abs(velocities).max() * self._method.duration
        return "" if is_back else f"a trajectory that was undone ends {way:.1e} from its start"

    def _check(self, interactions: Forces, constraints: ConstraintSet) -> None:
        """Raise ValueError for forces that depend on time, or change from cell to cell; and in fixed point for rigid
        bonds, and a grid that is too coarse, or too fine, for these momenta."""
        name = self._method.name
        if interactions.depend_on_time:
            raise ValueError(f"{name} needs an energy that does not depend on time; a force does")
        axes = interactions.falling_along()
        if axes:
            raise ValueError(
                f"{name} needs an energy that is the same one lattice vector away; that of a field is not, along "
                f"{', '.join('abc'[axis] for axis in axes)}: set pbc to False there"
            )
        state = self._state
        if not isinstance(state, GridState):
            return
        if constraints.bonds is not None:
            raise ValueError(
                f"{name} with precision='fixed-point' is exact, and rigid bonds are solved by rounded numbers: take "
                "precision='double', or flexible bonds"
            )
        moving = state.masses > 0.0
        widths = self.widths(state, 0)[moving]
        step = self._method.timestep * state.grid.momentum * state.inverse_masses.max()
        if widths.min() < 1 or step > state.grid.length:
            raise ValueError(
                f"the grid is too coarse for {name}: one step of momentum, {state.grid.momentum:.3g}, moves an atom by "
                f"{step:.3g} in a step; it must be at most the step of length, {state.grid.length:.3g}, and at most "
                "the thermal momentum of the lightest atom: give grid=minimd.Grid(...) with a smaller step of momentum"
            )
        if ROOM * widths.max() > WIDEST:
            raise ValueError(
                f"the grid is too fine for {name}: its momenta reach to {WIDEST * state.grid.momentum:.3g}, and must "
                f"to {ROOM} times the thermal momentum of the heaviest atom: give grid=minimd.Grid(...) with a larger "
                "step of momentum"
            )
