"""What is stored of an engine: the state of a step, and all that decides the bits of the steps to come."""

from typing import NamedTuple

from minimd.neighbors.verlet_list import Built
from minimd.structure.cell import Cell
from minimd.structure.grid import Grid
from minimd.structure.observables import Array


class Snapshot(NamedTuple):
    """A stored state, see Engine.restore.  positions, velocities : (N, 3), copies.  reservoir_energy : [energy].

    clock : a step and its time, from which the times of other steps are counted.  work :
        done by forces that depend on time [energy].
    cell : with a barostat, else None.
    """

    step: int
    time: float
    positions: Array
    velocities: Array
    reservoir_energy: float
    clock: tuple[int, float] | None = None
    work: float = 0.0
    cell: Cell | None = None


class Checkpoint(NamedTuple):
    """All that determines the bits of the steps to come, besides system, potentials, method, constraints and options;
    see Engine.go_on_from.

    state : Snapshot.
    displacement : of the fastest atom in a step, for which skins were chosen [length].  lists :
        Built of each list of neighbors.
    images : (K, 3) lattice vectors of rigid bonds [length], and their tolerance; None without.  equilibrated :
        of the engine.
    grid : of fixed-point arithmetic; None without.
    """

    state: Snapshot
    displacement: float
    lists: tuple[Built, ...]
    images: tuple[Array, float] | None
    equilibrated: int
    grid: Grid | None = None
