"""Forces: which terms of a scene run, on which list, and their sum at each step, with energies and virial if asked."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import replace
from itertools import chain
from math import nan
from operator import attrgetter
from typing import NamedTuple

import numpy as np
from numba.core.errors import NumbaError
from numpy.typing import NDArray

from minimd.core.compiled.kernels import (
    DirectCalls,
    announce_compilation,
    kernel,
)
from minimd.core.compiled.machine import rounds_once
from minimd.core.compiled.program import (
    Operation,
    Program,
    in_python,
    n_chunks_of,
    operation,
    side_by_side,
)
from minimd.core.console.quiet import warn
from minimd.core.forces.clearing import (
    Accumulators,
    Clearing,
    clear_accumulators,
    clear_forces,
)
from minimd.core.forces.options import FIXED_POINT, Options, pool_for
from minimd.core.forces.pair_laws import ListTerm, deepest
from minimd.core.forces.planning import plan
from minimd.core.forces.site_passes import SitePasses
from minimd.core.forces.slab_term import OpenSlabTerm
from minimd.core.neighbors.verlet_list import Built, VerletList
from minimd.core.potentials.coulomb import Coulomb
from minimd.core.potentials.fields import FieldTerm
from minimd.core.potentials.links import Lines, LinkedTerm, Slots
from minimd.core.potentials.term import (
    BOND_LOOP,
    FORCES,
    PER_ATOM,
    TOTALS,
    VOIGT,
    OwnTerm,
    Potential,
    Target,
    Term,
    as_potentials,
    bound,
    check_force,
)
from minimd.core.structure.arrays import Array
from minimd.core.structure.cell import Images
from minimd.core.structure.checks import checked_kind
from minimd.core.structure.errors import RangeError, why_not_compiled
from minimd.core.structure.grid import TOO_LARGE, Grid, steps_of
from minimd.core.structure.system import System, check_in_plane, check_resolution

# the skin is chosen anew when atoms are faster or slower by this factor: its optimum is flat
CHANGED_SPEED = 2.0


@kernel
def totals_of(energies, virials):
    """The sums of energies, (N,), and of virials, (N, 6) as xx yy zz yz xz xy, as (3, 3) [energy]."""
    energy = 0.0
    xx = yy = zz = 0.0
    yz = xz = xy = 0.0
    for i in range(energies.size):
        energy += energies[i]
        xx += virials[i, 0]
        yy += virials[i, 1]
        zz += virials[i, 2]
        yz += virials[i, 3]
        xz += virials[i, 4]
        xy += virials[i, 5]
    return energy, np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])


NONE = np.zeros(0)
UNKNOWN = np.broadcast_to(nan, (3, 3))
NO_VIRIALS = np.zeros((0, 6))


class ForceResult(NamedTuple):
    """What one evaluation of the forces has given; energies and virials only if they were asked for.

    forces : (N, 3) [energy/length], in the memory of Forces, which the next evaluation overwrites.
    potential_energy : U [energy].
    virial : W = Σ f r_ij ⊗ r_ij [energy], (3, 3).
    energies : (N,) each atom's share of U [energy].
    virials : (N, 6) of W, as xx yy zz yz xz xy. Tail corrections are included, for atoms in equal shares.
    """

    forces: Array
    potential_energy: float = nan
    virial: Array = UNKNOWN
    energies: Array = NONE
    virials: Array = NO_VIRIALS
    has_energy: bool = False


class Forces:
    """All forces on the atoms of one system.

    Parameters
    ----------
    system : the System whose positions and cell each call reads.
    potentials : one potential or several.
    options : threads, precision and skin.

    Attributes
    ----------
    forces : (N, 3) [energy/length], of the last compute.
    terms : those that compute adds up.
    displacement : of the fastest atom in a step, for which skins were chosen [length]; 0 if unknown.
    n_evaluations : calls of compute since the last reset_counts.
    grid : of fixed-point arithmetic, see lay_grid; None in float64.
    impulses : (N, 3) int64 in its steps of momentum, of the last compute.
    unit : of time, over which they are computed if compute is given no other [time].
    time : at which forces that depend on it are evaluated [time].
    pool : the threads for this scene.
    depend_on_time, act_from_outside : whether a term does, so that energy, or total momentum, is not constant.
    largest_cutoff : the largest finite one [length]: an atom that moves farther in a step may pass another without
        interacting.

    Raises
    ------
    TypeError, ValueError : for an object that is no potential, a species without parameters, a periodic scene without a
        cutoff, bonded terms that name missing atoms, sites in fixed-point arithmetic; and as check_resolution.
    """

    def __init__(
        self,
        system: System,
        potentials: Potential | Sequence[Potential],
        options: Options | None = None,
    ) -> None:
        self.system = checked_kind("system", system, System, "a minimd System")
        self.options = checked_kind("options", options, Options | None, "Options") or Options()
        if system.sites is not None and self.options.precision == FIXED_POINT:
            raise ValueError(
                "precision='fixed-point' is for atoms with masses; this system has massless sites, whose forces are "
                "not handed over to the last bit: take precision='double'"
            )
        self.pool = pool_for(self.options, len(system))
        self.potentials = as_potentials(potentials)
        self._bound: list[Term] = []
        self.unchecked: list[str] = []  # see check_forces
        self.terms: list[Term] = []
        self._lists: list[VerletList] = []
        self.n_evaluations = 0
        self._builds_before = 0
        self.displacement = 0.0
        self.time = 0.0
        self._grid: Grid | None = None
        self.forces = np.zeros_like(system.positions)
        self.impulses = np.zeros((0, 3), dtype=np.int64)
        self.unit = 1.0
        self._images = Images.of(system.cell)
        self._sites = SitePasses(system, self._images)
        self._calls = DirectCalls()
        self._n_plans = 0
        self._bind()

        for term in self._bound if self.options.skin else ():
            if term.list is not None and term.list.skin != self.options.skin:
                raise ValueError(
                    f"skin must be that of the list of neighbors of {type(term).__name__}, which it made itself: "
                    f"{term.list.skin:g}; skin = {self.options.skin:g}: give it where the list is made"
                )

        self.check_resolution()
        for term in self._bound:
            if term.warning:
                warn(term.warning)
        skin = self.options.skin
        widest = min(self.widest_skins, default=np.inf)
        if skin is not None and skin > widest:
            warn(
                f"skin {skin:g} {system.units.length} does not fit, {widest:.3g} is used: where bonded pairs are left "
                "out or scaled, cutoff + skin can be at most half the height of the cell"
            )

    def warn_of_potentials(self) -> None:
        """Warn of charges that no potential uses, unless one of a user's own may use them; of a field whose force is
        another one a lattice vector away, unless a slab has only empty space there; and of fixed-point runs with bits
        of their own."""
        if self.options.precision == FIXED_POINT and not rounds_once():
            warn(
                "this processor has no fused multiply-add: fixed-point runs have other bits than on those that have "
                "it; MINIMD_VECTORS=sse-exact gives the same bits, many times more slowly"
            )
        for axis in self.changing_along():
            warn(
                f"the cell is periodic along {'abc'[axis]}, but the field is not: an atom and its image feel "
                f"different forces; set pbc to False there, or, in a charged slab, give "
                f'Coulomb(..., slab="{"xyz"[axis]}")'
            )
        largest = np.abs(self.system.charges).max(initial=0.0)
        laws = [term.pair_law for term in self._bound]
        is_used = any(law is not None and law.charges is not None for law in laws)
        if largest and not is_used and all(isinstance(term, OwnTerm) for term in self._bound):
            warn(
                f"no potential uses the charges of the atoms, up to {largest:.4g} e: add Coulomb(cutoff), "
                "or leave charges out of the system if they shall not act on each other"
            )

    def changing_along(self) -> list[int]:
        """Periodic directions, but that of a slab, along which a field is another one a lattice vector away."""
        slabs = {
            "xyz".find(potential.slab)
            for potential in self.potentials
            if isinstance(potential, Coulomb)
        }
        fields = [term for term in self._bound if isinstance(term, FieldTerm)]
        return sorted({axis for field in fields for axis in field.changes_along} - slabs)

    def falling_along(self) -> list[int]:
        """Periodic directions along which an atom has another energy a lattice vector away."""
        fields = [term for term in self._bound if isinstance(term, FieldTerm)]
        falls = {axis for field in fields for axis in field.falls_along}
        return sorted(falls.union(self.changing_along()))

    def _bind(self) -> None:
        """Bind the potentials to the system, as it is in its present cell, and plan the terms."""
        kept = [memory.copy() for memory in self.memories]
        self._plan([bound(potential, self.system) for potential in self.potentials])
        for memory, values in zip(self.memories, kept, strict=False):
            memory[:] = values

    @property
    def memories(self) -> list[Array]:
        """What terms remember from step to step."""
        return [term.memory for term in self._bound if term.memory is not None]

    def _plan(self, terms_bound: list[Term], skins: Sequence[float] = ()) -> None:
        """Choose lists, and skins unless they are given; both depend on the cell and on how fast the atoms move."""
        options = self.options
        if self.grid is None and options.precision == FIXED_POINT:  # no splitting moves the atoms
            options = replace(options, precision="double", grid=None)
        terms = plan(terms_bound, self.system, options, self.displacement, skins)
        n_builds = self.n_builds
        self.terms = terms
        self._lists = [term.list for term in terms if term.list is not None]
        self._renewed = [*self._lists, *(term for term in terms if isinstance(term, OpenSlabTerm))]
        self._builds_before += n_builds - self.n_builds
        self._bound = terms_bound
        self._planned_for = self.system.cell
        self._tails = self.tail_corrections()
        self._timed = [term for term in terms if term.depends_on_time]
        self.depend_on_time = bool(self._timed)
        self.act_from_outside = any(term.acts_from_outside for term in terms_bound)
        cutoffs = [term.cutoff for term in terms_bound if np.isfinite(term.cutoff)]
        self.largest_cutoff = max(cutoffs, default=np.inf)
        self._images.take(self.system.cell)
        linked = [term for term in terms if isinstance(term, LinkedTerm)]
        with_lists = [term for term in terms if term.list is not None]
        with_lists.sort(key=lambda term: not term.assigns)
        others = [term for term in terms if term not in linked and term not in with_lists]
        self._in_order = with_lists, linked, others
        self._slots = Slots(linked)
        self._memory = self.forces if self.grid is None else self.impulses
        self._bonded_pushes: NDArray | None = None
        self._slot_forces = np.zeros(3 * self._slots.size, dtype=self._memory.dtype)
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
        """Compute impulses on a grid from now on.
        Raises ValueError for a term that cannot."""
        self._grid = grid
        self.impulses = np.zeros(self.forces.shape, dtype=np.int64)
        self._plan(self._bound)

        for term in self.terms:
            if not term.fits_grid:
                raise ValueError(
                    "precision='fixed-point' is for laws u(r) of pairs and bonds, angles, dihedrals, and fields "
                    f"that are constant in time; {term.name or type(term).__name__} cannot round its forces: "
                    "take precision='double'"
                )

    def depth(self) -> float:
        """Depth of the deepest well of all pair laws [energy], see pair_laws.deepest."""
        laws = [term.pair_law for term in self._bound if term.pair_law is not None]
        return max((deepest(law) for law in laws), default=0.0)

    def check_resolution(self) -> None:
        """Raise ValueError if atoms are so far from the origin that their separations are lost in rounding."""
        system = self.system
        height = float(system.cell.heights[system.cell.pbc].min(initial=np.inf))
        check_resolution(system, height, "the height of the cell")
        for term in self._bound:
            check_resolution(system, term.shortest_length, "the shortest length of a potential")

    def check_forces(self, time: float) -> None:
        """Raise ValueError if the force of a user's term is not minus the gradient of its energy, at a time.
        Those from outside that cannot be compared, or shall not be, are in unchecked from now on."""
        self.unchecked = []
        for potential, term in zip(self.potentials, self._bound, strict=True):
            is_compared = term.is_checked and check_force(potential, self.system, time)
            if term.acts_from_outside and not (is_compared or isinstance(term, OwnTerm)):
                self.unchecked.append(type(potential).__name__)

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
            self._tails = self.tail_corrections()

    def lists_built(self) -> tuple[Built, ...]:
        """What build_lists needs to rebuild the lists that are in use."""
        return tuple(pairs.built() for pairs in self._lists)

    def place_sites(self) -> None:
        """Bring massless sites, if there are any, to where their parents are in the present cell.
        Raises ValueError as System.check_plane."""
        if self.system.cell.dimensions == 2:
            self.system.check_plane()
        if self.system.sites is not None:
            self._images.take(self.system.cell)
            self._sites.place()

    def build_lists(self, built: Sequence[Built]) -> None:
        """Build the lists again as they were."""
        for pairs, as_it_was in zip(self._lists, built, strict=True):
            pairs.build_again(as_it_was, self.system.cell)

    def go_on_with(self, displacement: float, built: Sequence[Built]) -> None:
        """Take over skins and lists of other Forces of the same scene; choose new ones if their number differs, or for
        skins that are never chosen."""
        widest = [max(pairs.cutoff, pairs.skin) for pairs in self._lists]
        skins = [pairs.skin for pairs in built]
        fit = len(skins) == len(widest) and bool(np.less_equal(skins, widest).all())
        self.displacement = displacement
        self._plan(self._bound, skins if fit else ())
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

    def compute(self, detail: int = FORCES, unit: float | None = None) -> ForceResult:
        """Evaluate the forces at system.positions; TOTALS and PER_ATOM also energy and virial, of all and of each atom.

        unit : over which impulses are computed on a grid [time].

        Raises
        ------
        NonFiniteError : if a position is not finite.
        RangeError : if an impulse leaves the range of a grid.
        ValueError : as Forces, if the cell has changed and no longer fits.
        """
        self.follow_cell()
        target = self.target(detail, self.unit if unit is None else unit)
        program = self._programs.get(id(target))
        if program is None:
            program = Program(lambda: self.operations(target), self.version, self.pool)
            self._programs[id(target)] = program

        with self.running(program):
            program.run()
        self.n_evaluations += 1
        return self.taken(target)

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
        n_accumulators = 0 if detail == FORCES else len(self.system)
        if detail == TOTALS and all(term.needs_one_accumulator for term in self.terms):
            n_accumulators = 1
        energies = np.empty(n_accumulators)
        virials = np.empty((n_accumulators, 6))
        steps = () if self.grid is None else steps_of(self.grid, (unit,))
        memory = (self._memory, energies, virials, self._slot_forces)
        target = Target(detail, *memory, self._images, steps)
        self._targets[key] = target
        return target

    def operations(self, target: Target) -> Iterator[Operation]:
        """The operations of one evaluation: of pairs, of links and their sums, of all other terms."""
        with_lists, linked, others = self._in_order
        if self._timed:
            yield in_python(self._tell_time)
        yield from self._sites.before()
        if target.detail != FORCES:
            accumulators = Accumulators(target.energies, target.virials)
            yield operation(self._calls, clear_accumulators, accumulators)
        if not (with_lists and with_lists[0].assigns):
            yield self._cleared(target)
        first = [self._of(term, target) for term in (*with_lists, *linked)]
        parts = [list(self._of(term, target)) for term in others]
        sums = self._slots.operations(target)
        yield from side_by_side(chain(*first, sums), parts, self.pool.n_threads)
        yield from self._sites.after(target)

    def bonded_operations(self, unit: float) -> Iterator[Operation]:
        """The operations for forces of bonded terms alone, which set bonded_pushes: of bonds, angles, dihedrals, and of
        the excluded and scaled pairs that belong to them.
        unit : see target [time]."""
        _, linked, _ = self._in_order
        target = self.target(FORCES, unit)._replace(forces=self.bonded_pushes)
        yield from self._sites.before()
        yield self._cleared(target)
        for term in linked:
            yield from self._of(term, target)
        yield from self._slots.operations(target)
        yield from self._sites.after(target)

    @property
    def bonded_pushes(self) -> NDArray:
        """(N, 3), forces or impulses of bonded terms alone, where somebody wants them."""
        if self._bonded_pushes is None:
            self._bonded_pushes = np.zeros_like(self._memory)
        return self._bonded_pushes

    def _cleared(self, target: Target) -> Operation:
        clearing = Clearing(target.forces, n_chunks_of(len(self.system)))
        return operation(self._calls, clear_forces, clearing, clearing.n_chunks)

    def _tell_time(self) -> None:
        for term in self._timed:
            term.time = self.time

    def _of(self, term: Term, target: Target) -> Iterator[Operation]:
        for step in term.operations(self.system, target):
            yield step._replace(python=_refuse) if step.python is None else step

    @contextmanager
    def running(self, program: Program) -> Iterator[None]:
        """Context in which a program with operations of these forces runs: binds the potentials again if the cell was
        changed, makes lists ready, compiles what is not compiled yet; at the end, takes note of what the operations
        have done to the lists.

        Raises TypeError if a user's law does not compile.
        """
        self.follow_cell()
        for pairs in self._lists:
            pairs.ready(self.system.positions, self.system.cell)
        try:
            if program.is_outdated:
                with self._compiling():
                    program.prepare()
            yield
        finally:
            for pairs in self._lists:
                pairs.settle()

    def taken(self, target: Target) -> ForceResult:
        """What the operations of an evaluation have given: forces of impulses, energies and virials with tails."""
        for term in self.terms:
            term.collect(target)
        if self.grid is not None:
            np.divide(self.impulses, target.steps.per_force[0], out=self.forces)
        if self.system.cell.dimensions == 2:
            check_in_plane("forces", self.forces)
        if target.detail == FORCES:
            return ForceResult(self.forces)
        tail_energy, trace = self._tails
        energy, virial = totals_of(target.energies, target.virials)
        if trace:
            virial += np.eye(3) * (trace / 3.0)
        sums = ForceResult(self.forces, energy + tail_energy, virial, has_energy=True)
        if target.detail == TOTALS:
            return sums
        n_atoms = len(self.system)
        isotropic = np.array([1.0, 1.0, 1.0, 0.0, 0.0, 0.0])
        energies = target.energies + tail_energy / n_atoms
        virials = target.virials + isotropic * (trace / 3.0 / n_atoms)
        return sums._replace(energies=energies, virials=virials)

    def heat_flux(self, velocities: Array) -> Array:
        """The part of the energy flux that is due to interactions, times the volume [energy length/time], (3,).

            Σ_i (u_i v_i + W_i v_i) + what W leaves out of terms of three and four atoms, see LinkedTerm.uneven_flux

        With Σ_i K_i v_i it is d/dt Σ_i r_i (K_i + u_i), where no atom has images.
        velocities : (N, 3).
        Raises ValueError as check_pairwise.
        """
        self.check_pairwise("a heat flux", "exchange velocities, see docs/recipes.md")
        sums = self.compute(PER_ATOM)
        flux: Array = sums.energies @ velocities
        for virial, row, column in zip(sums.virials.T, *VOIGT, strict=True):
            flux[row] += virial @ velocities[:, column]
            if row != column:
                flux[column] += virial @ velocities[:, row]
        slots = self._pulls()
        for term in self.terms:
            if isinstance(term, LinkedTerm):
                flux += term.uneven_flux(self.system, velocities, slots)
        return flux

    def lines(self) -> Iterator[Lines]:
        """The straight lines between two atoms along which the forces of all terms act, see Lines; tail corrections
        have none. Atoms are at any of their images.

            Σ_lines r ⊗ f = W,   for terms that check_pairwise accepts
        """
        self.compute(FORCES)
        slots = self._pulls()
        for term in self.terms:
            if isinstance(term, ListTerm):
                yield term.lines(self.system)
            elif isinstance(term, LinkedTerm):
                yield term.lines(self.system, slots)

    def _pulls(self) -> Array:
        """(3 S,) the forces of links, of the last evaluation [energy/length]."""
        steps = self.target(FORCES, self.unit).steps
        return np.asarray(self._slot_forces / (steps.per_force[0] if steps else 1.0))

    def check_pairwise(self, quantity: str, instead: str) -> None:
        """Raise ValueError for a term whose energies and virials of atoms are not those of pairs, or of LinkedTerm.
        quantity, instead : what needs them, and what can be done, for the message."""
        for term in self.terms:
            if not term.has_heat_flux:
                raise ValueError(
                    f"{quantity} is known for laws of pairs (charges by pairs included), bonds, angles and dihedrals; "
                    f"it is not for {term.name or type(term).__name__}: leave that out, or {instead}"
                )

    def version(self) -> tuple[int, ...]:
        """Of the memory that operations work on."""
        return self._n_plans, *map(attrgetter("version"), self._renewed)

    @contextmanager
    def _compiling(self) -> Iterator[None]:
        """Context of a compilation.
        Raises TypeError if a user's law does not compile."""
        try:
            with announce_compilation():
                yield
        except NumbaError as error:
            laws = ", ".join(map(repr, self.potentials))
            raise TypeError(
                f"a law of {laws} does not compile; laws must be arithmetic on numbers that numba.njit accepts: "
                f"{why_not_compiled(str(error))}"
            ) from error

    @property
    def powers(self) -> tuple[float, float]:
        """∂U/∂t of the last compute [energy/time], just before its time and just after: zero unless a term depends on
        time."""
        before, after = (
            sum(term.power * term.is_moved[side] for term in self._timed) for side in (0, 1)
        )
        return before, after

    @property
    def n_builds(self) -> int:
        """Number of list builds since the last reset_counts."""
        return self._builds_before + sum([pairs.n_builds for pairs in self._lists])

    @property
    def skins(self) -> list[float]:
        """Skins of all lists that are rebuilt as atoms move [length]."""
        return [pairs.skin for pairs in self._lists if np.isfinite(pairs.cutoff)]

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
        if all(term.ingredient != BOND_LOOP for term in self.terms):
            absent.append(BOND_LOOP)
        for term in self.terms:
            absent += term.skipped()
        return absent

    def tail_corrections(self) -> tuple[float, float]:
        """Energy and virial trace of all tails, in the present cell."""
        energy = 0.0
        trace = 0.0
        for term in self._bound:
            tail = term.tail(self.system)
            energy += tail[0]
            trace += tail[1]
        return energy, trace


def _refuse(_answer: int) -> None:
    raise RangeError(TOO_LARGE)
