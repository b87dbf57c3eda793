"""Stored states of an engine: of a system, and of all that determines the bits of the steps to come."""

from typing import NamedTuple

from minimd.core.neighbors.verlet_list import Built
from minimd.core.structure.arrays import Array
from minimd.core.structure.cell import Cell
from minimd.core.structure.grid import Grid


class Snapshot(NamedTuple):
    """A stored state, see Engine.restore.
    positions, velocities : (N, 3), copies.
    reservoir_energy : [energy].

    clock : a step and its time, from which the times of other steps are counted.
    cell : with a barostat, else None.
    work : done by forces that depend on time [energy].
    memory : of the method, see Splitting, or None.
    """

    step: int
    time: float
    positions: Array
    velocities: Array
    reservoir_energy: float
    clock: tuple[int, float] | None = None
    work: float = 0.0
    cell: Cell | None = None
    memory: Array | None = None


class Checkpoint(NamedTuple):
    """What determines the bits of the steps to come, besides system, potentials, method, constraints and options.

    displacement : of the fastest atom in a step, for which skins were chosen [length].
    lists : of neighbors.
    images : (K, 3) lattice vectors of rigid bonds [length], and their tolerance; None without.
    equilibrated : steps of equilibrations so far.
    grid : of fixed-point arithmetic; None without.
    """

    state: Snapshot
    displacement: float
    lists: tuple[Built, ...]
    images: tuple[Array, float] | None
    equilibrated: int
    grid: Grid | None = None
