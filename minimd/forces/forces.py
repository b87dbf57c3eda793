"""Forces: the sum of all terms of a scene, each step; energies and virial when somebody looks."""

import warnings
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numba.core.errors import NumbaError
from numpy.typing import NDArray

from minimd.compiled.kernels import announce_compilation
from minimd.forces.cluster_term import ClusteredPairs
from minimd.forces.options import Options
from minimd.forces.terms import FixedPairs, ListedPairs, Potential, Term, plan
from minimd.neighbors.queries import closest_pair
from minimd.potentials.bonded import BondPotential
from minimd.potentials.pair import PairPotential
from minimd.potentials.pair_loop import FORCES, PER_ATOM, TOTALS
from minimd.structure.console import outside_minimd
from minimd.structure.errors import NonFiniteError
from minimd.structure.system import System

if TYPE_CHECKING:
    import ase

RESTLESS = 2.0  # the skin is chosen anew when atoms have become faster or slower by this factor
VOIGT = np.array([[0, 5, 4], [5, 1, 3], [4, 3, 2]])  # places of xx yy zz yz xz xy in a (3, 3) tensor


class Forces:
    """All forces on the atoms of one system.

    Parameters
    ----------
    system : the System whose positions and cell each call reads.
    potentials : one potential or several.
    options : threads, precision and skin.

    Attributes
    ----------
    forces : (N, 3) [energy/length], of the last compute.  n_evaluations : calls of compute since the last reset_counts.

    Raises
    ------
    TypeError, ValueError : for something that is no potential, a species without parameters, a periodic scene without a
        cutoff, bonded terms that name missing atoms.
    """

    def __init__(self, system: System, potentials: Potential | Sequence[Potential], options: Options | None = None) -> None:
        self.system, self.options = system, options or Options()
        self.potentials = tuple(potentials) if isinstance(potentials, Sequence) and not isinstance(potentials, str) else (potentials,)
        _warn_of_missing_bonds(system, self.potentials)
        self._stride = 0.0
        self.terms: list[Term] = []
        self.n_evaluations, self._builds_before = 0, 0
        self._plan()
        self.forces = np.zeros_like(system.positions)
        self._compiled: set[int] = set()
        self._energies, self._virials = np.zeros(0), np.zeros((0, 6))
        self._detail = FORCES
        self._tail: tuple[float | None, float, float] = (None, 0.0, 0.0)

    def _plan(self) -> None:
        """What a scene needs depends on its cell: which list fits, which skin, whether there are images."""
        terms = plan(self.system, self.potentials, self.options, self._stride)
        self._builds_before = self.n_builds  # of the terms that these replace
        self.terms, self._planned_for = terms, self.system.cell

    def fit_skin(self, stride: float) -> None:
        """Choose the skin for a fastest atom that moves so far in a step [length], unless the user chose it or it is still right."""
        if self.options.skin is None and not self._stride / RESTLESS <= stride <= self._stride * RESTLESS:
            self._stride = stride
            self._plan()

    def reset_counts(self) -> None:
        """Count evaluations and list builds from zero."""
        self.n_evaluations, self._builds_before = 0, self._builds_before - self.n_builds

    @property
    def counts(self) -> tuple[int, int]:
        """Evaluations and list builds; set them to forget those that have come since."""
        return self.n_evaluations, self.n_builds

    @counts.setter
    def counts(self, counts: tuple[int, int]) -> None:
        self.n_evaluations, self._builds_before = counts[0], self._builds_before + counts[1] - self.n_builds

    def compute(self, detail: int = FORCES) -> NDArray[np.float64]:
        """Evaluate the forces at system.positions and return them; TOTALS and PER_ATOM also evaluate energy and virial.

        Raises
        ------
        NonFiniteError : if a position is not finite.  ValueError : as Forces, if the cell has changed and no longer fits.
        """
        if not self.system.cell.same_as(self._planned_for):
            self._plan()
        self.forces[:] = 0.0
        if detail != FORCES:
            self._open_books(detail)
        if detail in self._compiled:
            self._sum(detail)
        else:
            self._compile(detail)
        self.n_evaluations += 1
        self._detail = detail
        return self.forces

    @contextmanager
    def set_aside(self) -> Iterator[None]:
        """While active, something else can be computed; then forces, energies and virials are those of before."""
        forces, energies, virials, detail = self.forces.copy(), self._energies.copy(), self._virials.copy(), self._detail
        try:
            yield
        finally:
            self.forces[:], self._energies, self._virials, self._detail = forces, energies, virials, detail

    def _open_books(self, detail: int) -> None:
        """Room for energies and virials: of all atoms, or, where nothing but cluster lists asks for their totals, of one."""
        one_will_do = detail == TOTALS and all(isinstance(term, ClusteredPairs) for term in self.terms)
        n = 1 if one_will_do else len(self.system)
        if len(self._energies) != n:
            self._energies, self._virials = np.empty(n), np.empty((n, 6))
        self._energies[:], self._virials[:] = 0.0, 0.0

    def _compile(self, detail: int) -> None:
        """The first sum; a law of the user's may not compile."""
        try:
            with announce_compilation():
                self._sum(detail)
        except NumbaError as error:
            laws = ", ".join(repr(potential) for potential in self.potentials)
            reason = str(error).strip().splitlines()[0]
            raise TypeError(f"a law among {laws} does not compile; laws are arithmetic on numbers, as numba.njit takes it: {reason}") from error
        self._compiled.add(detail)

    def _sum(self, detail: int) -> None:
        for term in self.terms:
            term.add(self.system, detail, self.forces, self._energies, self._virials)

    @property
    def has_energy(self) -> bool:
        """True if the last compute was asked for energy and virial."""
        return self._detail != FORCES

    @property
    def potential_energy(self) -> float:
        """U [energy] of the last compute with TOTALS or PER_ATOM, tail corrections included."""
        return float(self._energies.sum()) + self._tail_corrections()[0]

    @property
    def virial(self) -> NDArray[np.float64]:
        """W = Σ f r_ij ⊗ r_ij [energy], (3, 3), of the last compute with TOTALS or PER_ATOM, tail corrections included."""
        return self._virials.sum(axis=0)[VOIGT] + np.eye(3) * self._tail_corrections()[1] / 3.0

    @property
    def energies(self) -> NDArray[np.float64]:
        """Each atom's share of U [energy], (N,), of the last compute with PER_ATOM; the tail in equal shares."""
        return self._energies + self._tail_corrections()[0] / len(self.system)

    @property
    def virials(self) -> NDArray[np.float64]:
        """Each atom's share of W [energy], (N, 6) as xx yy zz yz xz xy, of the last compute with PER_ATOM."""
        tail = np.array([1.0, 1.0, 1.0, 0.0, 0.0, 0.0]) * self._tail_corrections()[1] / 3.0
        return self._virials + tail / len(self.system)

    @property
    def longest_stride(self) -> float:
        """The largest finite cutoff [length]: an atom that moves farther in one step has passed its neighbors unseen."""
        cutoffs = [p.cutoff for p in self.potentials if isinstance(p, PairPotential) and np.isfinite(p.cutoff)]
        return max(cutoffs, default=np.inf)

    @property
    def n_builds(self) -> int:
        """How often a list was built, since the last reset_counts."""
        return self._builds_before + sum(term.list.n_builds for term in self.terms if isinstance(term, (ListedPairs, ClusteredPairs)))

    @property
    def skins(self) -> list[float]:
        """Of all lists that are rebuilt as atoms move [length]."""
        lists = [term.list for term in self.terms if isinstance(term, (ListedPairs, ClusteredPairs))]
        return [one.skin for one in lists if np.isfinite(one.cutoff)]

    @property
    def pair_search(self) -> str:
        """Which lists this scene got, in words."""
        return ", ".join(term.summary for term in self.terms if isinstance(term, (ListedPairs, ClusteredPairs))) or "no list"

    def skipped(self) -> list[str]:
        """What this scene lacks and therefore does not pay for, in words."""
        absent = [] if self.system.cell.is_periodic else ["periodic images"]
        if not any(isinstance(term, FixedPairs) for term in self.terms):
            absent.append("bond loop")
        return absent + [word for term in self.terms for word in term.skipped()]

    def _tail_corrections(self) -> tuple[float, float]:
        """Energy and virial trace of all tails, computed anew only when the volume has changed."""
        corrected = [p for p in self.potentials if isinstance(p, PairPotential) and p.tail_correction]
        if not corrected:
            return 0.0, 0.0
        volume = self.system.volume
        if volume is None:
            raise ValueError("tail_correction needs a density: a cell that is periodic in all three directions")
        if self._tail[0] != volume:
            counts = np.bincount(self.system.species_index, minlength=len(self.system.species_names))
            tails = [potential.tail(counts, self.system.species_names, volume) for potential in corrected]
            self._tail = (volume, sum(u for u, _ in tails), sum(w for _, w in tails))
        return self._tail[1], self._tail[2]


def _warn_of_missing_bonds(system: System, potentials: Sequence[Potential]) -> None:
    """Say that something is meant for bonds where there are none."""
    if len(system.bonds):
        return
    for potential in potentials:
        scaled = isinstance(potential, PairPotential) and potential.bonded_scale != (1.0, 1.0, 1.0)
        if scaled or (isinstance(potential, BondPotential) and potential.pairs is None):
            what = f"bonded_scale of {potential!r}" if scaled else repr(potential)
            hint = "give them as System(bonds=...) or System.from_ase(atoms, bonds=...)"
            warnings.warn(f"{what} has no effect: the system has no bonds; {hint}", stacklevel=outside_minimd())


@dataclass(frozen=True)
class Evaluation:
    """potential_energy : U [energy].  forces : (N, 3) [energy/length].  virial : (3, 3) W = Σ f r_ij ⊗ r_ij [energy].

    energies : (N,) each atom's share of U [energy].
    """

    potential_energy: float
    forces: NDArray[np.float64]
    virial: NDArray[np.float64]
    energies: NDArray[np.float64]


def evaluate(system: "System | ase.Atoms", potentials: Potential | Sequence[Potential]) -> Evaluation:
    """Potential energy, forces, virial and energies per atom of a System, or of ase.Atoms, as they stand.

    Raises
    ------
    NonFiniteError : if a force or an energy is not finite, as for two atoms on one spot; it names the closest pair.
    ValueError, TypeError : as Forces.
    """
    system = system if isinstance(system, System) else System.from_ase(system)
    forces = Forces(system, potentials, Options(skin=0.0))
    forces.compute(PER_ATOM)
    result = Evaluation(forces.potential_energy, forces.forces, forces.virial, forces.energies)
    if not (np.isfinite(result.forces).all() and np.isfinite(result.energies).all()):
        raise NonFiniteError(f"forces or energies are not finite; the closest pair is {closest_pair(system)}: move them apart")
    return result
