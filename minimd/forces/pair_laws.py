"""What the pair potentials of a scene say about it: laws, parameters, reach, excluded pairs; and the rule which list it gets."""

from collections.abc import Iterable, Sequence
from math import isfinite

import numpy as np

from minimd.forces.cluster_loop import runs_on_vectors
from minimd.forces.options import Options
from minimd.neighbors.verlet_list import LEAST_SKIN, best_skin
from minimd.potentials.law import evaluate_law
from minimd.potentials.pair import PairPotential
from minimd.structure.bond_graph import pairs_by_bonds_apart
from minimd.structure.system import System, number_density

CLUSTERS_FROM = 64  # atoms: below, the pair list is as fast
ROUNDED_DOWN = 1.0 - 1e-9
SINGLE = (1e-34, 1e30)  # float32 ends at 1e-38 and 3e38; the products in a law need room beside their results
TRIED_AT = (0.3, 0.5, 0.7, 0.9)  # of the cutoff


class PairLaws:
    """What pair potentials with one bonded_scale say about a system: laws, parameter tables, the largest cutoff, excluded pairs.

    Attributes
    ----------
    laws, tables : markers, and (S, S, 1 + P) arrays; one for each potential.  cutoff : the largest [length].
    special : pairs (P, 2) that are scaled, with their factors.  excluded : (P, 2) all of them: no list may hold their nearest image.
    """

    def __init__(self, system: System, potentials: Sequence[PairPotential]) -> None:
        _check_cutoffs(system, potentials)
        by_bonds, scale = pairs_by_bonds_apart(system.bonds, len(system)), potentials[0].bonded_scale
        self.special = [(pairs, factor) for pairs, factor in zip(by_bonds, scale, strict=True) if factor != 1.0 and len(pairs)]
        self.excluded = np.concatenate([np.zeros((0, 2), dtype=np.int64), *(pairs for pairs, _ in self.special)])
        self.potentials = potentials
        self.laws = [potential.law for potential in potentials]
        self.tables = [potential.table(system.species_names) for potential in potentials]
        self.cutoff = max(potential.cutoff for potential in potentials)

    def skipped(self) -> Iterable[str]:
        """See Term."""
        if all(len(table) == 1 for table in self.tables):
            yield "parameter table"
        if not len(self.excluded):
            yield "exclusions"

    def fit_clusters(self, system: System, options: Options, stride: float) -> bool:
        """Whether clusters serve: CLUSTERS_FROM atoms or more, a finite cutoff, heights of at least cutoff + skin, laws that run on vectors."""
        if len(system) < CLUSTERS_FROM or self.cutoff == np.inf:
            return False
        reach = self.cutoff + skin_for(system, self, options, stride)
        high_enough = bool(np.all(system.cell.heights[system.cell.pbc] >= reach))
        return high_enough and all(runs_on_vectors(law, table.shape[-1] - 1) for law, table in zip(self.laws, self.tables, strict=True))


def _check_cutoffs(system: System, potentials: Sequence[PairPotential]) -> None:
    for potential in potentials:
        if potential.cutoff == np.inf and system.cell.is_periodic:
            raise ValueError(f"cutoff must be given in a periodic cell; that of {type(potential).__name__} is None")
        if potential.tail_correction and system.volume is None:
            raise ValueError("tail_correction needs a density: a cell that is periodic in all three directions")


def check_single_precision(laws: PairLaws) -> None:
    """Raise ValueError if squared distances, energies or forces of a law have no room in float32, as they may in units far from those of atoms."""
    for potential, table in zip(laws.potentials, laws.tables, strict=True):
        for cutoff2, *numbers in table.reshape(-1, table.shape[-1]).tolist():
            u, f = np.abs([_tried(potential.law, x * x * cutoff2, tuple(numbers)) for x in TRIED_AT]).max(axis=0)
            sizes = [size for size in (TRIED_AT[0] ** 2 * cutoff2, cutoff2, float(u), float(f)) if size > 0.0 and isfinite(size)]
            if min(sizes) < SINGLE[0] or max(sizes) > SINGLE[1]:
                raise ValueError(
                    f"precision='mixed' has room for squared distances, energies and forces from {SINGLE[0]:g} to {SINGLE[1]:g}; those of "
                    f"{type(potential).__name__} go from {min(sizes):.1e} to {max(sizes):.1e}: take other units, or precision='double'"
                )


def _tried(law: tuple, r2: float, numbers: tuple[float, ...]) -> tuple[float, float]:
    try:
        u, f = evaluate_law(law, r2, numbers)
        return float(u), float(f)
    except (ArithmeticError, ValueError, TypeError):  # of a law of the user's, which may end before the cutoff
        return 0.0, 0.0


def skin_for(system: System, laws: PairLaws, options: Options, stride: float) -> float:
    """The skin that the user gave, or the best one that the cell has room for [length].

    stride : how far the fastest atom moves in a step [length], 0 if unknown. There is no skin where the nearest image of a
    scaled pair can change while the list is in use.
    """
    cutoff, cell = laws.cutoff, system.cell
    safe = float(np.sqrt(cell.safe_distance2)) if len(laws.excluded) else np.inf
    skin = options.skin
    if skin is None:
        skin = best_skin(cutoff, number_density(system, cutoff), stride)
        for room in (safe - cutoff, cell.heights[cell.pbc].min(initial=np.inf) - cutoff):
            skin = min(skin, ROUNDED_DOWN * room) if room > LEAST_SKIN * cutoff else skin
    return 0.0 if cutoff + skin > safe else skin
