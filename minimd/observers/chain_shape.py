"""The size and shape of molecules."""

from __future__ import annotations

from dataclasses import field

import numpy as np

from minimd.core.engine.engine import Engine
from minimd.core.structure.arrays import Array
from minimd.observers.accumulator import ObservedRun
from minimd.observers.arguments import label, steps
from minimd.observers.means import Means, MeansResult, Quantity
from minimd.observers.molecules import MoleculeKind, Molecules, kinds_of

NAMES = "squared_radius_of_gyration", "asphericity", "anisotropy", "squared_end_to_end"
SYMBOLS = "R_g²", "b", "κ²", "R_ee²"


class ChainShapeResult(MeansResult):
    """Sizes and shapes of molecules, see MeansResult; names end in the formula if there are several kinds."""

    title = "molecule sizes"


class ChainShape(Means):
    """Mean size and shape of the molecules, from their gyration tensors: of each kind of molecule with two atoms or
    more, by the bonds and the lengths held fixed.

        S = Σ m s ⊗ s / Σ m,   eigenvalues λ₁ ≥ λ₂ ≥ λ₃       s: from the center of mass
        R_g² = λ₁ + λ₂ + λ₃
        b = λ₁ − (λ₂ + λ₃)/2                                  asphericity; 0 for a sphere or a cube, R_g² for a rod
        κ² = (3 Σ λ²/R_g⁴ − 1)/2                              relative shape anisotropy, 0 to 1
        R_ee² = |r_n − r_1|²                                  between the ends of a chain without branches

    Molecules are made whole bond by bond, each to the nearest image. Those whose atoms have the same species and
    numbers of bonds, in the same order, are of one kind.

    D. N. Theodorou, U. W. Suter, Macromolecules 18, 1206 (1985), eqs. 10 to 13, where all masses are equal.

    Raises ValueError for arguments out of range; when a run begins, if there are no such molecules, or if one is joined
    to its own image.
    """

    kind = "chain-shape"
    answer = ChainShapeResult
    every: int = steps(100)
    name: str = label()
    kinds: list[str] = field(init=False, default_factory=lambda: ["A2"])
    numbers: list[int] = field(init=False, default_factory=lambda: [1])  # of molecules
    are_chains: list[bool] = field(init=False, default_factory=lambda: [True])

    def _begin(self, engine: Engine) -> None:
        kinds = kinds_of(Molecules(engine.system), engine.system)
        if not kinds:
            raise ValueError(
                "the shape of molecules needs bonds, or lengths held fixed, that join atoms; "
                f"this run has {engine.system!r}: give bonds=[[0, 1], ...] to md.System"
            )
        self.kinds = [kind.name for kind in kinds]
        self.numbers = [len(kind.atoms) for kind in kinds]
        self.are_chains = [bool(kind.ends) for kind in kinds]

    def _laid_out(self, scene: ObservedRun) -> None:
        super()._laid_out(scene)
        self._molecules: tuple[Molecules, list[MoleculeKind]] | None = None

    def _quantities(self, scene: ObservedRun) -> list[Quantity]:
        square = f"{scene.unit_system.length}²"
        units = square, square, "", square
        quantities = []
        for kind, number, is_chain in zip(self.kinds, self.numbers, self.are_chains, strict=True):
            end = f"_{kind}" if len(self.kinds) > 1 else ""
            of_kind = f" of {number} molecule{'s' * (number > 1)} {kind}"
            for name, symbol, unit in zip(NAMES[: 3 + is_chain], SYMBOLS, units, strict=False):
                quantities.append(Quantity(name + end, symbol + of_kind, unit))
        return quantities

    def _values(self, engine: Engine) -> Array:
        system = engine.system
        if self._molecules is None:
            molecules = Molecules(system)
            self._molecules = molecules, kinds_of(molecules, system)
        molecules, kinds = self._molecules
        whole = molecules.whole(system)
        means = [
            shapes(whole[atoms], system.masses[atoms], ends).mean(axis=1)
            for _, atoms, ends in kinds
        ]
        return np.concatenate(means)


def shapes(positions: Array, masses: Array, ends: list[int]) -> Array:
    """(4, M) R_g², b, κ², R_ee² of M molecules of n atoms; without ends (3, M).
    positions : (M, n, 3), of whole molecules.  masses : (M, n).  ends : two places among the n atoms, or none."""
    shares = (masses / masses.sum(axis=1, keepdims=True))[:, :, None]
    inner = positions - (shares * positions).sum(axis=1, keepdims=True)
    eigenvalues = np.linalg.eigvalsh((shares * inner).swapaxes(1, 2) @ inner)
    size = eigenvalues.sum(axis=1)
    asphericity = 1.5 * eigenvalues[:, 2] - 0.5 * size
    anisotropy = 1.5 * np.square(eigenvalues).sum(axis=1) / size**2 - 0.5
    found = [size, asphericity, anisotropy]
    if ends:
        found.append(np.square(inner[:, ends[1]] - inner[:, ends[0]]).sum(axis=1))
    return np.array(found)
