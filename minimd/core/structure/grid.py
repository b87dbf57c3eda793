"""The grid of fixed-point dynamics: the steps of which positions, momenta and energies are whole multiples."""

from dataclasses import dataclass
from math import frexp, ldexp, log2

import numpy as np
from numpy.typing import ArrayLike

from minimd.core.compiled.fixed_point import FARTHEST, MOST, GridSteps
from minimd.core.console.display import Displayed, Rows
from minimd.core.console.words import shown
from minimd.core.structure.arrays import Array
from minimd.core.structure.errors import RangeError
from minimd.core.structure.observables import largest_component
from minimd.core.structure.system import System

# times the size of the scene: how far atoms can go; in scenes with an open direction
TRAVEL = 64.0
FAR_TRAVEL = 4096.0
# times the momentum of the fastest atom, or of one that falls into DEEP wells: how fast atoms can become
FASTER = 8.0
DEEP = 10.0
ENERGY_ROOM = 4.0  # times the energy of all atoms
TOO_LARGE = (
    "the force between two atoms is beyond the range of fixed-point numbers: they are too close to each other; "
    "take a shorter time step, or give grid=minimd.Grid(...) with a larger step of momentum"
)
NO_SIGN = 0.0  # added to turn −0 into 0
SLOW = 1e-3  # of the scene in a step, if nothing shows how fast atoms are


@dataclass(frozen=True, repr=False)
class Grid(Displayed):
    """The steps of fixed-point dynamics, powers of two.

    length : of positions and lattice vectors [length]; they reach to 2⁵² steps.
    momentum : of momenta, and of the impulse F Δt of each pair [mass length/time]; they reach to 2⁵⁰ steps.
    energy : of the energies and virials of pairs [energy]; sums reach to 2⁵² steps.

    Positions r and velocities v = p/m are float64; on a grid they stand for whole numbers of steps: r/length is exact,
    and rounding m v/momentum gives the whole number from which v was made.

    Raises ValueError for a step that is not a positive power of two."""

    length: float
    momentum: float
    energy: float

    def __post_init__(self) -> None:
        for name, step in vars(self).items():
            # the mantissa of infinity and NaN is not ½, that of −½ is −½
            if not isinstance(step, float) or frexp(step)[0] != 0.5:
                raise ValueError(
                    f"the step of {name} of a Grid must be a power of two, such as 2.0**-40; {name} = {shown(step)}"
                )

    def __repr__(self) -> str:
        steps = [f"{name}=2.0**{log2(step):.0f}" for name, step in vars(self).items()]
        return f"Grid({', '.join(steps)})"

    def display_rows(self) -> Rows:
        """See Displayed."""
        return [(f"step of {name}", f"2^{log2(step):.0f}") for name, step in vars(self).items()]

    @classmethod
    def of_scene(cls, system: System, timestep: float, depth: float) -> "Grid":
        """Steps that leave room for the motion of this scene, and round as little as they can. timestep : [time].
        depth : of the deepest well of a pair [energy]."""
        cell = system.cell
        longest = float(np.linalg.norm(cell.vectors[cell.pbc], axis=1).max(initial=0.0))
        extent = float(np.ptp(system.positions, axis=0).max())
        size = max(largest_component(system.positions), extent, longest)
        heaviest = float(system.masses.max())
        lightest = float(system.masses.min())
        timestep = abs(timestep)
        fastest = float(np.abs(system.masses[:, None] * system.velocities).max())
        momentum = max(fastest, (2.0 * heaviest * DEEP * depth) ** 0.5)
        momentum = momentum or heaviest * SLOW * (size or 1.0) / timestep
        energy = len(system) * (DEEP * depth + momentum**2 / lightest)
        travel = TRAVEL if cell.pbc.all() else FAR_TRAVEL
        reach = (size or momentum * timestep / lightest) * travel
        return cls(
            _upper_power_of_two(reach) / FARTHEST,
            _upper_power_of_two(momentum * FASTER) / MOST,
            _upper_power_of_two(energy * ENERGY_ROOM) / FARTHEST,
        )

    def has_room_for(self, system: System) -> bool:
        """Whether positions and momenta of a system are in the inner half of the range."""
        momenta = system.masses[:, None] * system.velocities
        is_near = largest_component(system.positions) <= 0.5 * FARTHEST * self.length
        return is_near and largest_component(momenta) <= 0.5 * MOST * self.momentum

    def widened(self, other: "Grid") -> "Grid":
        """The larger steps of two grids."""
        return Grid(*map(max, vars(self).values(), vars(other).values()))

    def take(self, system: System, inverse_masses: Array) -> None:
        """Round positions, lattice vectors and momenta of a system to the grid, in place.
        inverse_masses : (N,), zero for fixed atoms.
        Raises RangeError if one of them is beyond its range."""
        vectors = np.rint(system.cell.vectors / self.length) * self.length
        if not np.array_equal(vectors, system.cell.vectors):
            system.cell = system.cell.with_vectors(vectors)
        self.take_positions(system.positions)
        self.take_velocities(system.velocities, inverse_masses)
        self.check_positions(system.positions)
        self.check_momenta(system.velocities, inverse_masses)

    def take_positions(self, positions: Array) -> None:
        """Round positions (N, 3) to the grid, in place."""
        positions[:] = np.rint(positions / self.length) * self.length + NO_SIGN

    def take_velocities(self, velocities: Array, inverse_masses: Array) -> None:
        """Round velocities (N, 3) to those of whole momenta, in place."""
        velocities[:] = self.velocities(self.momenta(velocities, inverse_masses), inverse_masses)

    def velocities(self, momenta: Array, inverse_masses: Array) -> Array:
        """Velocities (N, 3) of momenta in steps."""
        return momenta * (self.momentum * inverse_masses)[:, None]

    def momenta(self, velocities: Array, inverse_masses: Array) -> Array:
        """Momenta in steps, whole numbers (N, 3), of velocities (N, 3); zero for fixed atoms."""
        steps = (self.momentum * inverse_masses)[:, None]
        momenta = np.zeros_like(velocities)
        np.divide(velocities, steps, out=momenta, where=steps > 0.0)
        return np.rint(momenta) + NO_SIGN

    def check_momenta(self, velocities: Array, inverse_masses: Array) -> None:
        """Raise RangeError if a momentum is beyond the range of the grid."""
        momenta = self.momenta(velocities, inverse_masses)
        if not largest_component(momenta) <= MOST:
            atom = int(np.argmax(np.abs(momenta).max(axis=1)))
            largest = np.abs(momenta).max() * self.momentum
            raise RangeError(
                f"the momentum of atom {atom} is {largest:.3g}, beyond the range of fixed-point numbers, "
                f"{MOST * self.momentum:.3g}: give grid=minimd.Grid(...) with a larger step of momentum than "
                f"{self.momentum:.3g}"
            )

    def check_positions(self, positions: Array) -> None:
        """Raise RangeError if a position is beyond the range of the grid."""
        if not largest_component(positions) <= FARTHEST * self.length:
            atom = int(np.argmax(np.abs(positions).max(axis=1)))
            raise RangeError(
                f"atom {atom} is {np.abs(positions).max():.3g} from the origin, beyond the range of fixed-point "
                f"numbers, {FARTHEST * self.length:.3g}: give grid=minimd.Grid(...) with a larger step of length than "
                f"{self.length:.3g}; or, in a periodic cell, wrap the positions: "
                "simulation.positions[:] = simulation.system.cell.wrapped(simulation.positions)"
            )


def steps_of(grid: Grid, units: ArrayLike) -> GridSteps:
    """Steps for a kernel.
    units : the time over which impulses are computed [time]."""
    return GridSteps(
        np.asarray(units) / grid.momentum, grid.length, grid.momentum, grid.energy, 0.0
    )


def _upper_power_of_two(x: float) -> float:
    """The smallest power of two that is not below x > 0."""
    mantissa, exponent = frexp(x)
    return ldexp(1.0, exponent - 1 if mantissa == 0.5 else exponent)
