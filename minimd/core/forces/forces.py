"""Forces: which terms of a scene run, on which list, and their sum at each step, with energies and virial if asked."""

from __future__ import annotations

from collections import namedtuple
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import replace

import numpy as np
from numba.core.errors import NumbaError
from numpy.typing import NDArray

from minimd.core.compiled.by_address import ByAddress
from minimd.core.compiled.kernels import DirectCalls, announce_compilation, called_kernel
from minimd.core.compiled.program import (
    GO_ON,
    Operation,
    Program,
    in_python,
    n_chunks_of,
    operation,
)
from minimd.core.console.quiet import warn
from minimd.core.forces.cluster_term import ClusterTerm
from minimd.core.forces.mesh_sum import charge_sum
from minimd.core.forces.options import FIXED_POINT, Options, pool_for
from minimd.core.forces.pair_laws import PairLaws, deepest
from minimd.core.forces.pair_list_term import PairListTerm
from minimd.core.neighbors.verlet_list import Built, VerletList
from minimd.core.potentials.coulomb import SpecialLaw
from minimd.core.potentials.laws import Scaled
from minimd.core.potentials.links import FixedPairs, LinkedTerm, Slots
from minimd.core.potentials.pair_loop import from_table
from minimd.core.potentials.term import (
    BOND_LOOP,
    FORCES,
    PER_ATOM,
    TOTALS,
    OwnTerm,
    PairLaw,
    Potential,
    Target,
    Term,
    as_potentials,
    bound,
    check_force,
)
from minimd.core.structure.cell import Images
from minimd.core.structure.checks import checked_kind
from minimd.core.structure.errors import RangeError, why_not_compiled
from minimd.core.structure.grid import TOO_LARGE, Grid, steps_of
from minimd.core.structure.system import System, check_resolution


def plan(
    terms_bound: Sequence[Term],
    system: System,
    options: Options,
    displacement: float,
    skins: Sequence[float] = (),
) -> list[Term]:
    """The terms to run: those that add their forces themselves, one with a list for all pair laws, others for what
    the list leaves out, and for sums over waves.

    terms_bound : the terms that the potentials were bound to.  displacement : of the fastest atom in a step [length],
        0 if unknown.
    skins : of the lists [length], if they are known.
    """
    terms = [term for term in terms_bound if term.pair_law is None]
    pair_laws = [term.pair_law for term in terms_bound if term.pair_law is not None]
    if pair_laws:
        known = replace(options, skin=skins[0]) if skins else options
        laws = PairLaws(system, pair_laws)
        with_list = ClusterTerm if laws.fit_clusters(system, known, displacement) else PairListTerm
        terms.append(with_list(system, laws, known, displacement))
        terms.extend(special_terms(system, pair_laws, laws))
    for one in pair_laws:
        if one.split is not None and one.charges is not None:
            how = (
                one.method,
                options.precision == FIXED_POINT,
                pool_for(options, len(system)).n_threads,
            )
            terms.append(charge_sum(system, one.charges, one.split, *how))
    return terms


def special_terms(system: System, members: Sequence[PairLaw], laws: PairLaws) -> Iterator[Term]:
    """Terms for the pairs that the list leaves out: each law times its factors."""
    for one, of_law in zip(members, laws.factors, strict=True):
        acts = (of_law != 0.0) | (one.split is not None)
        if not acts.any():
            continue
        pairs = laws.excluded[acts]
        factors = of_law[acts]
        species = system.species_index[pairs] if len(one.table) > 1 else np.zeros_like(pairs)
        rows = one.table[species[:, 0], species[:, 1]]
        product = [] if one.charges is None else [one.charges[pairs].prod(axis=1)]
        if one.split is None:
            columns = np.column_stack([rows[:, 0], factors, *product, rows[:, 1:]])
            yield FixedPairs(pairs, Scaled(one.law), from_table(columns))
        else:
            columns = np.column_stack([np.full(len(pairs), np.inf), *product, factors, rows[:, 0]])
            yield FixedPairs(pairs, SpecialLaw(one.split.numbers), from_table(columns))


# the skin is chosen anew when atoms are faster or slower by this factor: its optimum is flat
CHANGED_SPEED = 2.0
# places of xx yy zz yz xz xy in a (3, 3) tensor
VOIGT = np.array([[0, 5, 4], [5, 1, 3], [4, 3, 2]])


class Clearing(ByAddress, namedtuple("Clearing", "forces n_chunks")):
    """Forces (N, 3) to be set to zero, in chunks."""


@called_kernel
def clear_forces(clearing, chunk):
    """Forces = 0."""
    forces, n_chunks = clearing
    n = forces.shape[0]
    for i in range(chunk * n // n_chunks, (chunk + 1) * n // n_chunks):
        for c in range(3):
            forces[i, c] = 0
    return GO_ON


class Forces:
    """All forces on the atoms of one system.

    Parameters
    ----------
    system : the System whose positions and cell each call reads.
    potentials : one potential or several.  options : threads, precision and skin.

    Attributes
    ----------
    forces : (N, 3) [energy/length], of the last compute.  terms : those that compute adds up.
    displacement : of the fastest atom in a step, for which skins were chosen [length]; 0 if unknown.
    n_evaluations : calls of compute since the last reset_counts.
    grid : of fixed-point arithmetic, see lay_grid; None in float64.  impulses : (N, 3) int64 in its steps of momentum,
        of the last compute.
    unit : of time, over which they are computed if compute is given no other [time].
    time : at which forces that depend on it are evaluated [time].  pool : the threads for this scene.

    Raises
    ------
    TypeError, ValueError : for an object that is no potential, a species without parameters, a periodic scene without a
        cutoff, bonded terms that name missing atoms; and as check_resolution.
    """

    def __init__(
        self,
        system: System,
        potentials: Potential | Sequence[Potential],
        options: Options | None = None,
    ) -> None:
        self.system = checked_kind("system", system, System, "a minimd System")
        self.options = checked_kind("options", options, Options | None, "Options") or Options()
        self.pool = pool_for(self.options, len(system))
        self.potentials = as_potentials(potentials)
        self.terms: list[Term] = []
        self.n_evaluations = 0
        self._builds_before = 0
        self.displacement = 0.0
        self.time = 0.0
        self._grid: Grid | None = None
        self.forces = np.zeros_like(system.positions)
        self.impulses = np.zeros((0, 3), dtype=np.int64)
        self.unit = 1.0
        self._images, self._calls, self._n_plans = Images.of(system.cell), DirectCalls(), 0
        self._bind()
        for term in self._bound if self.options.skin else ():
            if term.list is not None and term.list.skin != self.options.skin:
                raise ValueError(
                    f"skin must be that of the list of neighbors of {type(term).__name__}, which it made itself: "
                    f"{term.list.skin:g}; skin = {self.options.skin:g}: give it where the list is made"
                )
        self.check_resolution()
        told = [term.warning for term in self._bound if term.warning]
        # others may use them
        if system.charges.any() and all(isinstance(one, OwnTerm) for one in self._bound):
            largest = f"the charges of the atoms, up to {np.abs(system.charges).max():.4g} e, are not used"
            is_used = any(
                one.pair_law is not None and one.pair_law.charges is not None for one in self._bound
            )
            told += [] if is_used else [f"{largest}: add Coulomb(cutoff) to the potentials"]
        for words in told:
            warn(words)
        if self.options.skin is not None and self.options.skin > (
            widest := min(self.widest_skins, default=np.inf)
        ):
            why = "where bonded pairs are left out or scaled, cutoff + skin can be at most half the height of the cell"
            what = f"skin {self.options.skin:g} {system.units.length} does not fit, {widest:.3g} is used"
            warn(f"{what}: {why}")
        self._energies = np.zeros(0)
        self._virials = np.zeros((0, 6))
        self._detail = FORCES

    def _bind(self) -> None:
        """Bind the potentials to the system, as it is in its present cell, and plan the terms."""
        self._plan([bound(potential, self.system) for potential in self.potentials])

    def _plan(self, terms_bound: list[Term], skins: Sequence[float] = ()) -> None:
        """Choose lists, and skins unless they are given; both depend on the cell and on how fast the atoms move."""
        # no splitting moves the atoms
        is_in_double = self.grid is None and self.options.precision == FIXED_POINT
        options = (
            replace(self.options, precision="double", grid=None) if is_in_double else self.options
        )
        terms = plan(terms_bound, self.system, options, self.displacement, skins)
        self._builds_before += _n_builds(self.terms) - _n_builds(terms)
        self.terms = terms
        self._bound = terms_bound
        self._planned_for = self.system.cell
        self._timed = [term for term in terms if term.depends_on_time]
        self._images.take(self.system.cell)
        linked = [term for term in terms if isinstance(term, LinkedTerm)]
        of_pairs = sorted(
            (term for term in terms if term.list is not None), key=lambda term: not term.assigns
        )
        others = [term for term in terms if term not in linked and term not in of_pairs]
        self._in_order = of_pairs, linked, others
        self._slots, n_chunks = Slots(linked), n_chunks_of(len(self.system))
        self._slot_forces = np.zeros(
            3 * self._slots.size, dtype=np.float64 if self.grid is None else np.int64
        )
        self._clearing = Clearing(self.forces if self.grid is None else self.impulses, n_chunks)
        self._targets: dict[tuple[int, float], Target] = {}
        self._programs: dict[int, Program] = {}  # by the id of their target
        self._n_plans += 1

    @property
    def grid(self) -> Grid | None:
        """See the class; after lay_grid it can be replaced by another one."""
        return self._grid

    @grid.setter
    def grid(self, grid: Grid) -> None:
        if grid != self._grid:
            self._grid = grid
            self._targets = {}
            self._programs = {}
            self._n_plans += 1

    def lay_grid(self, grid: Grid) -> None:
        """Compute impulses on a grid from now on.  Raises ValueError for a term that cannot."""
        self._grid = grid
        self.impulses = np.zeros(self.forces.shape, dtype=np.int64)
        self._plan(self._bound)
        for term in self.terms:
            if not term.fits_grid:
                kinds = "laws u(r) of pairs and bonds, angles, dihedrals, and fields that are constant in time"
                why = f"{type(term).__name__} cannot round its forces"
                raise ValueError(
                    f"precision='fixed-point' is for {kinds}; {why}: take precision='double'"
                )

    def depth(self) -> float:
        """Depth of the deepest well of all pair laws [energy], see pair_laws.deepest."""
        laws = [term.pair_law for term in self._bound if term.pair_law is not None]
        return max((deepest(law) for law in laws), default=0.0)

    def check_resolution(self) -> None:
        """Raise ValueError if atoms are so far from the origin that their separations are lost in rounding."""
        cell = self.system.cell
        check_resolution(
            self.system, float(cell.heights[cell.pbc].min(initial=np.inf)), "the height of the cell"
        )
        for term in self._bound:
            check_resolution(
                self.system, term.shortest_length, "the shortest length of a potential"
            )

    def check_forces(self, time: float) -> None:
        """Raise ValueError if the force of a user's term is not minus the gradient of its energy, at a time."""
        for potential, term in zip(self.potentials, self._bound, strict=True):
            if term.is_checked:
                check_force(potential, self.system, time)

    def fit_skin(self, displacement: float) -> None:
        """Choose the skin anew if the displacement of the fastest atom in a step [length] has changed much,
        unless the user gave a skin."""
        slow = self.displacement / CHANGED_SPEED
        fast = self.displacement * CHANGED_SPEED
        if self.options.skin is None and not slow <= displacement <= fast:
            self.displacement = displacement
            self._plan(self._bound)

    def follow(self) -> None:
        """After atoms and cell were strained together: keep terms and lists in the new cell, if possible; if not,
        compute binds them again."""
        if sum(not term.follow(self.system) for term in self.terms) == 0:
            self._planned_for = self.system.cell
            self._images.take(self.system.cell)

    def lists_built(self) -> tuple[Built, ...]:
        """What build_lists needs to rebuild the lists that are in use."""
        return tuple(one.built() for one in _lists(self.terms))

    def build_lists(self, built: Sequence[Built]) -> None:
        """Build the lists again as they were."""
        for one, as_it_was in zip(_lists(self.terms), built, strict=True):
            one.build_again(as_it_was, self.system.cell)

    def go_on_with(self, displacement: float, built: Sequence[Built]) -> None:
        """Take over skins and lists of other Forces of the same scene; choose new ones if their number differs, or for
        skins that are never chosen."""
        lists = _lists(self.terms)
        fit = len(built) == len(lists) and all(
            one.skin <= max(now.cutoff, now.skin) for one, now in zip(built, lists, strict=True)
        )
        self.displacement = displacement
        self._plan(self._bound, [one.skin for one in built] if fit else ())
        if fit:
            self.build_lists(built)

    def reset_counts(self) -> None:
        """Count evaluations and list builds from zero."""
        self.counts = 0, 0

    @property
    def counts(self) -> tuple[int, int]:
        """Numbers of evaluations and of list builds. Assigning earlier numbers discards the counts made since."""
        return self.n_evaluations, self.n_builds

    @counts.setter
    def counts(self, counts: tuple[int, int]) -> None:
        self.n_evaluations = counts[0]
        self._builds_before = self._builds_before + counts[1] - self.n_builds

    def compute(self, detail: int = FORCES, unit: float | None = None) -> NDArray[np.float64]:
        """Evaluate the forces at system.positions and return them; TOTALS and PER_ATOM also evaluate energy and virial.

        unit : over which impulses are computed on a grid [time].

        Raises
        ------
        NonFiniteError : if a position is not finite.  RangeError : if an impulse leaves the range of a grid.
        ValueError : as Forces, if the cell has changed and no longer fits.
        """
        self.follow_cell()
        target = self.target(detail, self.unit if unit is None else unit)
        program = self._programs.get(id(target))
        if program is None:
            program = Program(lambda: self.operations(target), lambda: self.version, self.pool)
            if detail != PER_ATOM:
                self._programs[id(target)] = program
        with self.running(program):
            program.run()
        self.taken(target)
        self.n_evaluations += 1
        return self.forces

    def follow_cell(self) -> None:
        """Bind the potentials again if the cell was changed."""
        cell = self.system.cell
        if cell is not self._planned_for and not cell.same_as(self._planned_for):
            self._bind()

    def target(self, detail: int, unit: float = 1.0) -> Target:
        """What operations(target) write to, for one detail; on a grid, for impulses over a unit of time [time]."""
        key = detail, unit if self.grid is not None else 1.0
        if key in self._targets:
            return self._targets[key]
        n = (
            1
            if detail == TOTALS and all(term.needs_one_accumulator for term in self.terms)
            else len(self.system)
        )
        energies, virials = (
            (np.empty(0), np.empty((0, 6))) if detail == FORCES else (np.empty(n), np.empty((n, 6)))
        )
        steps = () if self.grid is None else steps_of(self.grid, (unit,))
        forces = self.forces if self.grid is None else self.impulses
        target = Target(detail, forces, energies, virials, self._slot_forces, self._images, steps)
        if detail != PER_ATOM:  # whose accumulators are large
            self._targets[key] = target
        return target

    def operations(self, target: Target) -> Iterator[Operation]:
        """The operations of one evaluation: of pairs, of links and their sums, of all other terms."""
        of_pairs, linked, others = self._in_order
        if self._timed:
            yield in_python(self._tell_time)
        if target.detail != FORCES:
            yield in_python(lambda: clear(target))
        if not (of_pairs and of_pairs[0].assigns):
            yield operation(self._calls, clear_forces, self._clearing, self._clearing.n_chunks)
        for term in (*of_pairs, *linked):
            yield from self._of(term, target)
        yield from self._slots.operations(target)
        for term in others:
            yield from self._of(term, target)

    def _tell_time(self) -> None:
        for term in self._timed:
            term.time = self.time

    def _of(self, term: Term, target: Target) -> Iterator[Operation]:
        for one in term.operations(self.system, target):
            yield one._replace(python=_refuse) if one.python is None else one

    @contextmanager
    def running(self, program: Program) -> Iterator[None]:
        """Context in which a program with operations of these forces runs: makes lists ready, compiles what is not
        compiled yet; at the end, takes note of what the operations have done to the lists.

        Raises TypeError if a user's law does not compile.
        """
        for one in _lists(self.terms):
            one.ready(self.system.positions, self.system.cell)
        try:
            if program.is_outdated:
                with self._compiling():
                    program.prepare()
            yield
        finally:
            for one in _lists(self.terms):
                one.settle()

    def taken(self, target: Target) -> None:
        """After the operations of an evaluation: take energies and virials, and forces of impulses."""
        for term in self.terms:
            term.collect(target)
        self._energies = target.energies
        self._virials = target.virials
        self._detail = target.detail
        if self.grid is not None:
            np.divide(self.impulses, target.steps.per_force[0], out=self.forces)

    @property
    def version(self) -> tuple[int, ...]:
        """Of the memory that operations work on."""
        return self._n_plans, *(one.version for one in _lists(self.terms))

    @contextmanager
    def _compiling(self) -> Iterator[None]:
        """Context of a compilation.  Raises TypeError if a user's law does not compile."""
        try:
            with announce_compilation():
                yield
        except NumbaError as error:
            laws = ", ".join(map(repr, self.potentials))
            reason = why_not_compiled(str(error))
            needed = "laws must be arithmetic on numbers that numba.njit accepts"
            raise TypeError(f"a law of {laws} does not compile; {needed}: {reason}") from error

    @contextmanager
    def set_aside(self) -> Iterator[None]:
        """Context for calls of compute at displaced positions; then forces, energies and virials are restored."""
        forces = self.forces.copy()
        energies = self._energies
        virials = self._virials
        detail = self._detail
        # with other accumulators
        self._programs, self._targets, before = {}, {}, (self._programs, self._targets)
        try:
            yield
        finally:
            self._programs, self._targets = before
            self.forces[:] = forces
            self._energies = energies
            self._virials = virials
            self._detail = detail

    @property
    def has_energy(self) -> bool:
        """True if the last compute was asked for energy and virial."""
        return self._detail != FORCES

    @property
    def potential_energy(self) -> float:
        """U [energy] of the last compute with TOTALS or PER_ATOM, tail corrections included."""
        return float(self._energies.sum()) + self.tail_corrections()[0]

    @property
    def virial(self) -> NDArray[np.float64]:
        """W = Σ f r_ij ⊗ r_ij [energy], (3, 3), of the last compute with TOTALS or PER_ATOM, tails included."""
        return self._virials.sum(axis=0)[VOIGT] + np.eye(3) * self.tail_corrections()[1] / 3.0

    @property
    def energies(self) -> NDArray[np.float64]:
        """Each atom's share of U [energy], (N,), of the last compute with PER_ATOM; the tail in equal shares."""
        return self._energies + self.tail_corrections()[0] / len(self.system)

    @property
    def virials(self) -> NDArray[np.float64]:
        """Each atom's share of W [energy], (N, 6) as xx yy zz yz xz xy, of the last compute with PER_ATOM."""
        tail = np.array([1.0, 1.0, 1.0, 0.0, 0.0, 0.0]) * self.tail_corrections()[1] / 3.0
        return self._virials + tail / len(self.system)

    @property
    def largest_cutoff(self) -> float:
        """The largest finite cutoff [length]: an atom moving farther in a step may pass another without interacting."""
        return max(
            (term.cutoff for term in self._bound if np.isfinite(term.cutoff)), default=np.inf
        )

    @property
    def act_from_outside(self) -> bool:
        """Whether a term acts from outside, so that the total momentum is not constant."""
        return any(term.acts_from_outside for term in self._bound)

    @property
    def depend_on_time(self) -> bool:
        """Whether a term depends on time."""
        return bool(self._timed)

    @property
    def power(self) -> float:
        """∂U/∂t of the last compute [energy/time]: zero unless a term depends on time."""
        return sum(term.power for term in self._timed)

    @property
    def n_builds(self) -> int:
        """Number of list builds since the last reset_counts."""
        return self._builds_before + _n_builds(self.terms)

    @property
    def skins(self) -> list[float]:
        """Skins of all lists that are rebuilt as atoms move [length]."""
        return [one.skin for one in _lists(self.terms) if np.isfinite(one.cutoff)]

    @property
    def widest_skins(self) -> list[float]:
        """The widest that each of them could be in this cell [length]."""
        return [
            term.widest_skin
            for term in self.terms
            if term.list is not None and np.isfinite(term.list.cutoff)
        ]

    @property
    def pair_search(self) -> str:
        """The lists that this scene uses, for the report."""
        return ", ".join(term.summary for term in self.terms if term.summary) or "no list"

    def skipped(self) -> list[str]:
        """Names of the computations that this scene does not need, for the report."""
        absent = [] if self.system.cell.is_periodic else ["periodic images"]
        absent += [BOND_LOOP] if all(term.ingredient != BOND_LOOP for term in self.terms) else []
        return absent + [what for term in self.terms for what in term.skipped()]

    def tail_corrections(self) -> tuple[float, float]:
        """Energy and virial trace of all tails."""
        tails = [term.tail(self.system) for term in self._bound]
        return sum(u for u, _ in tails), sum(w for _, w in tails)


def clear(target: Target) -> None:
    """Energies and virials = 0."""
    target.energies[:] = 0.0
    target.virials[:] = 0.0


def _refuse(_answer: int) -> None:
    raise RangeError(TOO_LARGE)


def _lists(terms: Sequence[Term]) -> list[VerletList]:
    return [term.list for term in terms if term.list is not None]


def _n_builds(terms: Sequence[Term]) -> int:
    return sum(one.n_builds for one in _lists(terms))
