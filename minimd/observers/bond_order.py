"""Order of the bonds between neighbors: hexatic in a plane, and Steinhardt's in space, computed by freud."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from minimd.core.engine.engine import Engine
from minimd.core.engine.observation import check_has_volume
from minimd.core.neighbors.queries import neighbor_list
from minimd.core.structure.arrays import Array
from minimd.core.structure.checks import checked_choice
from minimd.core.structure.system import System
from minimd.observers.accumulator import ObservedRun
from minimd.observers.arguments import argument, label, names, orders, positive, steps
from minimd.observers.means import Means, MeansResult, Quantity

CUTOFF = 1.4  # (V/N)^(1/d): beyond 6 neighbors in a triangular lattice, 12 neighbors in fcc and hcp, and 14 in bcc
WIDE = 10.0  # cutoffs: a box in which a bond has no images
AMONG = (
    'species whose atoms and neighbors are meant, such as "O", or a list of them; all if not given'
)
REACH = "of neighbors; 1.4 (V/N)^(1/d) if not given, in d dimensions"


class BondOrderResult(MeansResult):
    """Parameters of bond order, see MeansResult: of each name q6 the mean over atoms, and q6_of_all."""

    title = "bond order"


class BondOrder(Means):
    """Order of the directions of bonds to neighbors, those within a cutoff.

        q_l = √(4π/(2l + 1) Σ_m |q_lm|²),   q_lm = ⟨Y_lm(r_ij)⟩ over the neighbors of an atom         Steinhardt
        ψ_k = |⟨e^(i k φ_ij)⟩|,   φ: angle of r_ij in the xy plane                                    hexatic: k = 6

    Of each order, such as "q6" or "psi6", the mean over atoms is known, and that of_all, in which q_lm or e^(i k φ) are
    averaged over atoms first: 0 in a large liquid, and not in a crystal. An atom without neighbors counts as 0. Of some
    species both atoms and neighbors are meant, such as the oxygens of water; N is their number. In
    perfect crystals q6 is 0.5745 (fcc), 0.5107 (bcc, 14 neighbors), 0.4848 (hcp), psi6 is 1 (triangular lattice).

    P. J. Steinhardt, D. R. Nelson, M. Ronchetti, Phys. Rev. B 28, 784 (1983), eq. 1.3; D. R. Nelson, B. I. Halperin,
    Phys. Rev. B 19, 2457 (1979). freud: V. Ramasubramani et al., Comput. Phys. Commun. 254, 107275 (2020).

    Raises ValueError for arguments out of range; when a run begins, if there is neither a cutoff nor a volume;
    ModuleNotFoundError without freud.
    """

    kind = "bond-order"
    fits_plane = True
    answer = BondOrderResult
    order: str | list[str] = argument(orders, 'orders, such as "q6", "psi6" or ["q4", "q6"]', "q6")
    cutoff: float | None = argument(positive, REACH, None, "length")
    every: int = steps(100)
    species: str | list[str] | None = argument(names, AMONG, None)
    name: str = label()

    def _begin(self, engine: Engine) -> None:
        for name in self.species or ():
            checked_choice("species", name, [*map(str, engine.system.species_names)])
        if self.cutoff is None:
            check_has_volume(engine)
        _freud()

    def _quantities(self, scene: ObservedRun) -> list[Quantity]:
        quantities = []
        for order in self.order:
            symbol = order.replace("psi", "ψ_").replace("q", "q_")
            quantities.append(Quantity(order, symbol, ""))
            quantities.append(Quantity(f"{order}_of_all", f"{symbol} of all atoms together", ""))
        return quantities

    def _values(self, engine: Engine) -> Array:
        system = engine.system
        if self.species is not None:
            chosen = np.isin(system.species.astype(str), self.species)
            system = System(system.positions[chosen], cell=system.cell)
        cutoff = self.cutoff or CUTOFF * system.cell.spacing(len(system))
        values: list[float] = []
        for order in self.order:
            harmonics = bond_harmonics(system, order, cutoff)
            each = np.linalg.norm(harmonics, axis=1)
            values += [float(each.mean()), float(np.linalg.norm(harmonics.mean(axis=0)))]
        return np.array(values)


def bond_harmonics(system: System, order: str, cutoff: float) -> NDArray[np.complex128]:
    """(N, 2l + 1) √(4π/(2l + 1)) q_lm of each atom, or (N, 1) ⟨e^(i k φ)⟩, zero without neighbors; their lengths are
    q_l or ψ_k.
    Raises ModuleNotFoundError without freud."""
    freud = _freud()
    n = len(system)
    first, bonds = neighbor_list("iD", system, cutoff)
    is_plane = order.startswith("psi")
    if is_plane:
        bonds = bonds * [1.0, 1.0, 0.0]
    # each bond as a point of its own, seen from the origin: any cell, and several images of a pair
    points = np.concatenate([np.zeros((n, 3)), bonds])
    size = len(points)
    pairs = freud.locality.NeighborList.from_arrays(
        size, size, first, n + np.arange(len(bonds)), bonds
    )
    degree = int(order.lstrip("psiq"))
    kind = freud.box.Box.square if is_plane else freud.box.Box.cube
    found = (freud.order.Hexatic if is_plane else freud.order.Steinhardt)(degree)
    found.compute((kind(WIDE * cutoff), points), neighbors=pairs)
    if is_plane:
        return np.nan_to_num(found.particle_order[:n, None])
    return np.nan_to_num(found.particle_harmonics[:n]) * np.sqrt(4.0 * np.pi / (2 * degree + 1))


def _freud() -> Any:
    """The package.
    Raises ModuleNotFoundError."""
    try:
        import freud
    except ModuleNotFoundError as error:
        raise ModuleNotFoundError(
            "the order of bonds needs the package freud, which is missing: pip install 'minimd-engine[order]'"
        ) from error
    return freud
