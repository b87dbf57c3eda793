"""The sections of a scene file: one class for each section, one line for each key.

Tables of tabulated laws are files with two columns, or the same numbers in the scene itself. A scene that is stored in
the file of its run needs no other files: [tables."argon.dat"] at its end holds the numbers of argon.dat.
"""

import json
from collections import ChainMap
from collections.abc import Callable, Iterator, Mapping, Sequence
from itertools import chain
from pathlib import Path
from typing import Annotated, Any, ClassVar, Literal, NamedTuple

import numpy as np
from pydantic import AfterValidator, Field, FiniteFloat, NonNegativeInt, PositiveInt, create_model

from minimd.core.console.quiet import quiet
from minimd.core.console.words import printable
from minimd.core.forces.options import Precision
from minimd.core.integrators.barostats import COUPLINGS, StochasticCellRescaling
from minimd.core.integrators.ramp import Ramp
from minimd.core.integrators.splitting import Splitting
from minimd.core.integrators.table import SPLITTINGS, THERMOSTATS
from minimd.core.minimization.minimization import FORCE_TOLERANCE, MAX_STEP_LENGTH, MAX_STEPS
from minimd.core.potentials.embedded import FORMS, EmbeddedAtom
from minimd.core.potentials.embedded_files import tables_from
from minimd.core.potentials.tabulated import FEWEST, Tabulated
from minimd.core.potentials.term import OwnPotential
from minimd.core.potentials.truncation import TRUNCATIONS
from minimd.core.structure.checks import checked_count, checked_flag
from minimd.core.structure.constraints import (
    Constraint,
    DistanceConstraints,
    FixedAtoms,
    SolverName,
)
from minimd.core.structure.lattice import BASES, EDGES
from minimd.core.structure.system import MOST_ATOMS, System, changed
from minimd.core.structure.units import GRAM_PER_CM3
from minimd.observers import KINDS, Accumulator, arguments
from minimd.scene.force_sections import ForceSection
from minimd.scene.pair_sections import (
    Length,
    LennardJonesSection,
    MieSection,
    PairOfSpecies,
    SoftRepulsionSection,
)
from minimd.scene.section import (
    KEY_UNITS,
    Dimension,
    NotNegative,
    PairOfAtoms,
    Positive,
    Section,
    Three,
    Two,
    Vector,
    one_of,
)
from minimd.scene.water import (
    ModelName,
    checked_ions,
    ions_of,
    water,
    water_of,
    water_potentials,
)

# types of values
Column = Annotated[list[FiniteFloat], Field(min_length=FEWEST)]


class Numbers(NamedTuple):
    """r : distances [length].
    u : energies [energy], one for each distance."""

    r: list[float]
    u: list[float]


class TableSection(Section):
    """[tables.NAME]: a table in the scene, in place of a file with this name."""

    r: Annotated[Column, Dimension("length")]
    u: Annotated[Column, Dimension("energy")]


class FileSection(Section):
    """[files.NAME]: the text of a file, in place of a file with this name."""

    text: str


def read_table(path: Path) -> Numbers:
    """The two columns of a text file, in the units of the scene; '#' begins a comment, a byte order mark is left out.
    Raises ValueError, with the path, for anything else."""
    if path.exists() and not path.is_file():
        raise ValueError(f"table {str(path)!r} is not a regular file")
    try:
        with quiet():  # NumPy warns of an empty file, which is refused
            columns = np.loadtxt(path, ndmin=2, encoding="utf-8-sig")
    except FileNotFoundError:
        raise ValueError(
            f"table {str(path)!r} does not exist; its path is taken relative to the scene file"
        ) from None
    except OSError as error:
        raise ValueError(f"table {str(path)!r} cannot be read: {error.strerror or error}") from None
    except ValueError as error:
        raise ValueError(
            f"table {str(path)!r} must hold two numbers on each line, r and u: {error}"
        ) from None

    n_lines, n_columns = columns.shape
    if n_columns != 2 or n_lines == 0:
        raise ValueError(
            f"table {str(path)!r} must hold two numbers on each line, r and u; it has {n_lines} lines of {n_columns}"
        )

    return Numbers(*columns.T.tolist())


def read_text(path: Path) -> str:
    """The text of a file.
    Raises ValueError, with the path, for one that cannot be read."""
    try:
        if path.is_file():
            return path.read_text(encoding="utf-8", errors="replace")
        reason = "it is not a regular file" if path.exists() else "it does not exist"
    except (OSError, ValueError) as error:
        reason = getattr(error, "strerror", None) or str(error)
    raise ValueError(
        f"file {str(path)!r} cannot be read: {reason}; its path is taken relative to the scene"
    )


def _quoted(text: str) -> str:
    """A string of TOML, which forbids one control character more than JSON."""
    return json.dumps(text, ensure_ascii=False).replace("\x7f", "\\u007f")


def as_sections(tables: Mapping[str, Numbers], texts: Mapping[str, str], units: str) -> str:
    """The text that adds these tables and files to a scene, to the last bit.
    units : of the scene, "ASE" or "LJ"."""
    # the units of the engine, of size 1: the first of lengths, the last of energies
    (length, *_) = KEY_UNITS[units]["length"]
    (*_, energy) = KEY_UNITS[units]["energy"]
    text = ""
    for name, table in tables.items():
        title = _quoted(name)
        text += f"\n[tables.{title}]\nr{length} = {table.r}\nu{energy} = {table.u}\n"
    for name, content in texts.items():
        title, of_file = (_quoted(part) for part in (name, content))
        text += f"\n[files.{title}]\ntext = {of_file}\n"
    return text


# by structure and water: either gives the atoms, and water their charges and bonds
GIVEN_TWICE = {"lattice", "bonds", "charges", "molecules", "density", "seed"}
PLOT_SUFFIXES = (".png", ".pdf", ".svg")
METHODS: Mapping[str, type[Splitting]] = ChainMap(THERMOSTATS, SPLITTINGS)
# arguments of single methods, with the methods that take them
OF_METHODS = {"inner": ("respa", "langevin-respa"), "n_steps": ("hybrid-monte-carlo",)}
OF_FILES = ("format", "masses", "elements", "atom_style", "lammps_units")  # of system_from_file


class StructureSection(Section):
    """[structure]: a file that ASE or MDAnalysis reads, or a block of a cubic crystal.
    format : name of the format, for a file whose suffix does not show it.
    bonds : pairs of atoms; "file" for the bonds, angles and dihedrals in the file; or the name of another file that
        holds them.
    masses, elements, atom_style, lammps_units : what the file does not state, see system_from_file.
    planar : whether the atoms of the file move in a plane; those of a "square" or "triangular" lattice do."""

    file: str | None = None
    lattice: Annotated[str, one_of(BASES)] | None = None
    element: str | None = None
    planar: bool = False
    repeat: list[PositiveInt] | None = None
    density: Annotated[Positive | None, Dimension("density")] = None
    lattice_constant: Length = None
    cell: Annotated[Annotated[list[NotNegative], Three] | None, Dimension("length")] = None
    pbc: bool | Annotated[list[bool], Three] | None = None
    species: list[str] | None = None
    charges: list[FiniteFloat] | dict[str, FiniteFloat] | None = None
    format: str | None = None
    masses: Positive | list[Positive] | dict[str, Positive] | None = None
    elements: list[str] | dict[str, str] | None = None
    atom_style: str | None = None
    lammps_units: str | None = None
    bonds: list[PairOfAtoms] | str | None = None

    def faults(self, units: str) -> Iterator[str]:
        """See Section."""
        if (self.file is None) == (self.lattice is None):
            yield "must have either file or lattice"
        if self.file is not None:
            for name in ("element", "repeat", "density", "lattice_constant"):
                if name in self.model_fields_set:
                    yield f"cannot have {name} together with file"
            return

        for name in ("cell", "planar", *OF_FILES):
            if name in self.model_fields_set:
                yield f"cannot have {name} together with lattice"
        if isinstance(self.bonds, str):
            yield "cannot have bonds from a file together with lattice; list the pairs, or give the structure as a file"
        for name in ("repeat", "element") if units == "ASE" else ("repeat",):
            if name not in self.model_fields_set:
                yield f"must have {name} together with lattice"
        if units == "ASE" and self.lattice in EDGES and self.density is not None:
            yield "cannot have density with a lattice of a plane: give lattice_constant"
        if (self.density is None) == (self.lattice_constant is None):
            density = self.key("density", units)
            edge = self.key("lattice_constant", units)
            yield f"must have either {density} or {edge} together with lattice"


class WaterSection(Section):
    """[water]: rigid water, of the atoms of [structure] file or of a box of its own, with its potentials and
    constraints: see minimd.scene.water."""

    model: ModelName = "SPC/E"
    molecules: Annotated[PositiveInt, Field(le=MOST_ATOMS // 3)] = 512
    density: Annotated[Positive, Dimension("density")] = 0.997 * GRAM_PER_CM3
    ions: dict[str, PositiveInt] | None = None
    cutoff: Length = None
    accuracy: Positive = 1e-5
    seed: NonNegativeInt = 0

    def faults(self, units: str) -> Iterator[str]:
        """See Section."""
        checked_ions(self.model, self.ions)  # raises ValueError
        yield from ()

    def system(self, placed: System | None) -> System:
        """The molecules, held rigid.
        placed : the atoms of a file, or None.
        Raises ValueError as water, water_of."""
        if placed:
            system, _, rigid = water_of(placed, self.model)
            if ions_of(placed) != (self.ions or {}):
                raise ValueError(
                    f"water.ions must be those of the file, {ions_of(placed)}; water.ions = {self.ions}"
                )
        else:
            density = self.density / GRAM_PER_CM3
            system, _, rigid = water(
                self.model,
                self.molecules,
                density,
                ions=self.ions,
                cutoff=self.cutoff,
                seed=self.seed,
            )
        return changed(system, constraints=(*system.constraints, rigid))

    def potentials(self) -> list[OwnPotential]:
        """Its potentials, also of a run in a file, without making molecules.  With atoms of a file, molecules and
        density have their default values, and the default cutoff is 9 Å.
        Raises ValueError as water."""
        density = self.density / GRAM_PER_CM3
        return water_potentials(
            self.model, self.molecules, density, self.cutoff, self.accuracy, self.ions
        )


class ConstraintsSection(Section):
    """[constraints]: lengths and atoms that are held fixed.
    Constraints that it does not mention are those of the structure file."""

    pairs: list[PairOfAtoms] | Literal["bonds"] | None = None
    lengths: Annotated[Positive | list[Positive] | None, Dimension("length")] = None
    fixed: list[NonNegativeInt] | None = None
    tolerance: Positive | None = None
    solver: SolverName | None = None

    def faults(self, units: str) -> Iterator[str]:
        """See Section."""
        key = self.key("lengths", units)
        n = len(self.lengths) if isinstance(self.lengths, list) else None
        if self.lengths is not None and not self.pairs:
            yield f"must have pairs together with {key}"
        if n is not None and isinstance(self.pairs, list) and n != len(self.pairs):
            yield f"must have one number as {key}, or one for each of its {len(self.pairs)} pairs; it has {n}"

    def constraints(
        self, bonds: list[list[int]], known: Sequence[Constraint]
    ) -> tuple[Constraint, ...]:
        """The constraints of a system whose file, of structure or run, may hold some already.
        bonds : of the structure.
        known : constraints of the file; they hold where the section says nothing, lengths only if the pairs are the
            same.
        Raises ValueError for impossible constraints."""
        fixed: list[Constraint] = [held for held in known if isinstance(held, FixedAtoms)]
        if self.fixed is not None:
            fixed = [FixedAtoms(self.fixed)] if self.fixed else []
        rigid = next((held for held in known if isinstance(held, DistanceConstraints)), None)
        pairs = bonds if self.pairs == "bonds" else self.pairs
        if pairs is None and rigid is not None:
            pairs = rigid.pairs.tolist()
        if not pairs:
            if self.tolerance is not None or self.solver is not None:
                raise ValueError(
                    "tolerance and solver are for lengths, and no lengths are held; give pairs, or leave tolerance and "
                    "solver out"
                )
            return tuple(fixed)

        if rigid is None or rigid.pairs.tolist() != pairs:
            rigid = DistanceConstraints(pairs)
        lengths = rigid.lengths if self.lengths is None else self.lengths
        tolerance = self.tolerance or rigid.tolerance
        solver = self.solver or rigid.solver
        return (*fixed, DistanceConstraints(pairs, lengths, tolerance, solver))


class WithFiles(Section):
    """A potential with files beside the scene, whose contents the scene of a run holds.
    kept_in : the section that holds them."""

    kept_in: ClassVar[str]

    @property
    def files(self) -> list[str]:
        """Their names, without repetition."""
        raise NotImplementedError(f"{type(self).__name__} has no files")


class EmbeddedPairSection(Section):
    """An entry of pairs: the parameters of two species, in place of those of the mixing rule."""

    species: PairOfSpecies
    parameters: list[FiniteFloat]


class EmbeddedAtomSection(WithFiles):
    """[[potential]] of type "embedded-atom": a file for LAMMPS' eam, eam/alloy or eam/fs, with a path relative to the
    scene file, or a name in [files]; or a law by its name, with the parameters of all atoms or of each species, in the
    units of the scene and in the order of EmbeddedAtom."""

    kept_in: ClassVar[str] = "files"
    type: Literal["embedded-atom"]
    file: str | None = None
    law: Annotated[str, one_of(FORMS)] | None = None
    parameters: list[FiniteFloat] | None = None
    species: dict[str, list[FiniteFloat]] | None = None
    pairs: list[EmbeddedPairSection] = Field([])
    cutoff: Length = None
    truncation: Annotated[str, one_of(TRUNCATIONS)] = "shifted"
    switch_start: Length = None

    def faults(self, units: str) -> Iterator[str]:
        """See Section."""
        if (self.file is None) == (self.law is None):
            yield "must have either file, with all functions in it, or law, the name of one"
        elif self.file is not None and self.model_fields_set - {"type", "file"}:
            yield "with a file must have nothing else: all parameters and the cutoff are in it"
        elif self.law is not None and (self.parameters is None) == (self.species is None):
            yield "with a law must have either parameters, those of all atoms, or species, with those of each"

    @property
    def files(self) -> list[str]:
        """See WithFiles."""
        return [] if self.file is None else [self.file]

    def potential(self, text_of: Callable[[str], str]) -> EmbeddedAtom:
        """The potential that the section describes.
        text_of : returns the text of a file."""
        if self.file is not None:
            return EmbeddedAtom.of_tables(tables_from(self.file, text_of(self.file)))
        species = self.species or {}
        own: Any = self.parameters and tuple(self.parameters)
        by_species: Any = {name: tuple(numbers) for name, numbers in species.items()}
        pairs: Any = {tuple(pair.species): tuple(pair.parameters) for pair in self.pairs}
        options = self.model_dump(include={"cutoff", "truncation", "switch_start"})
        law: Any = self.law
        return EmbeddedAtom(law, own or by_species, pairs=pairs, **options)


class PairTableSection(Section):
    """An entry of pairs: the table of two species."""

    species: PairOfSpecies
    file: str


class TabulatedSection(WithFiles):
    """[[potential]] of type "tabulated": one table for all atoms, or one for each pair of species, all at the same r.
    file : two columns, r and u in the units of the scene, with a path relative to the scene file;
        or a name in [tables]."""

    kept_in: ClassVar[str] = "tables"
    type: Literal["tabulated"]
    file: str | None = None
    pairs: Annotated[list[PairTableSection] | None, Field(min_length=1)] = None
    cutoff: Length = None
    truncation: Annotated[str, one_of(TRUNCATIONS)] = "shifted"
    switch_start: Length = None
    bonded_scale: Vector = Field([1.0, 1.0, 1.0])

    def faults(self, units: str) -> Iterator[str]:
        """See Section."""
        if (self.file is None) == (self.pairs is None):
            yield "must have either file, the table of all atoms, or pairs, each with its species and file"

    @property
    def files(self) -> list[str]:
        """See WithFiles."""
        if self.file is not None:
            return [self.file]
        return list(dict.fromkeys(pair.file for pair in self.pairs or ()))

    def potential(self, table_of: Callable[[str], Numbers]) -> Tabulated:
        """The potential that the section describes.
        table_of : returns the numbers of a table.
        Raises ValueError for tables that do not fit."""
        tables = {name: table_of(name) for name in self.files}
        first = self.files[0]
        r, u = tables[first]
        for name, table in tables.items():
            if table.r != r:
                raise ValueError(
                    f"the tables of one potential must have the same r; those of {name!r} and {first!r} differ"
                )
        by_pair: Any = {tuple(pair.species): tables[pair.file].u for pair in self.pairs or ()}
        options = self.model_dump(exclude={"type", "file", "pairs"})
        return Tabulated(r, by_pair or u, **options)


class DynamicsSection(Section):
    """[dynamics]: method and length of the run. Without a temperature, velocities are those of the structure.
    temperature : of a thermostat also two numbers, from which and to which it goes during the run.
    inner, n_steps : of OF_METHODS.
    """

    method: Annotated[str, one_of(METHODS)] = "velocity-verlet"
    timestep: Annotated[Positive, Dimension("time")]
    steps: NonNegativeInt
    temperature: Annotated[
        NotNegative | Annotated[list[NotNegative], Two] | None, Dimension("temperature")
    ] = None
    relaxation_time: Annotated[Positive | None, Dimension("time")] = None
    inner: PositiveInt | None = None
    n_steps: PositiveInt | None = None
    seed: NonNegativeInt = 1
    threads: PositiveInt | None = None
    precision: Precision = "double"
    max_seconds: Positive | None = None

    def faults(self, units: str) -> Iterator[str]:
        """See Section."""
        relaxation_time = self.key("relaxation_time", units)
        if self.method in THERMOSTATS:
            missing = []
            if self.temperature is None:
                missing.append(self.key("temperature", units))
            if self.relaxation_time is None:
                missing.append(relaxation_time)
            if missing:
                yield f"must have {' and '.join(missing)} with method {self.method!r}"
        elif self.relaxation_time is not None:
            yield (
                f"cannot have {relaxation_time} with method {self.method!r}, which has no relaxation time; "
                f"{', '.join(THERMOSTATS)} have one"
            )
        if self.method not in THERMOSTATS and isinstance(self.temperature, list):
            yield (
                f"must have one {self.key('temperature', units)} with method {self.method!r}, at which the run begins; "
                f"{', '.join(THERMOSTATS)} can change it during the run"
            )
        for name in self._of_method():
            methods = OF_METHODS[name]
            if self.method not in methods:
                key = self.key(name, units)
                yield f"cannot have {key} with method {self.method!r}; {', '.join(methods)} have it"

    def _of_method(self) -> dict[str, Any]:
        """The arguments of OF_METHODS that are given."""
        return {
            name: getattr(self, name) for name in self.model_fields_set.intersection(OF_METHODS)
        }

    @property
    def first_temperature(self) -> float | None:
        """The temperature at which the run begins."""
        return self.temperature[0] if isinstance(self.temperature, list) else self.temperature

    def level(self, value: Any) -> Any:
        """A number, or the ramp between two numbers over all steps of the run."""
        if not isinstance(value, list):
            return value
        start, stop = value
        return Ramp(start, stop, max(1, self.steps))

    def integrator(self) -> Splitting:
        """The method with its time step; a thermostat with its bath."""
        own = self._of_method()
        if self.method not in THERMOSTATS:
            return SPLITTINGS[self.method](self.timestep, **own)
        return THERMOSTATS[self.method].with_relaxation_time(
            self.timestep, self.level(self.temperature), self.relaxation_time, self.seed, **own
        )


class BarostatSection(Section):
    """[barostat]: constant pressure by stochastic cell rescaling, at the temperature of the dynamics.
    pressure : also two numbers, from which and to which it goes during the run.
    """

    pressure: Annotated[FiniteFloat | Annotated[list[FiniteFloat], Two], Dimension("pressure")]
    compressibility: Annotated[Positive, Dimension("compressibility")]
    relaxation_time: Annotated[Positive, Dimension("time")]
    coupling: Annotated[str, one_of(COUPLINGS)] = "isotropic"
    every: PositiveInt = 50
    seed: NonNegativeInt = 1

    def barostat(self, dynamics: DynamicsSection) -> StochasticCellRescaling:
        """The barostat that the section describes; it follows a thermostat, and else has a temperature of its own."""
        own = None if dynamics.method in THERMOSTATS else dynamics.first_temperature
        arguments = self.model_dump() | {"pressure": dynamics.level(self.pressure)}
        return StochasticCellRescaling(**arguments, temperature=own)


class MinimizationSection(Section):
    """[minimization]: first of all, atoms move to a nearby minimum of the potential energy. The table may be empty."""

    force_tolerance: Annotated[Positive, Dimension("force")] = FORCE_TOLERANCE
    max_steps: NonNegativeInt = MAX_STEPS
    max_step_length: Annotated[Positive, Dimension("length")] = MAX_STEP_LENGTH


class EquilibrationSection(Section):
    """[equilibration]: steps before the run, with velocities rescaled to a temperature; if not given,
    that of [dynamics]."""

    steps: NonNegativeInt
    temperature: Annotated[Positive | None, Dimension("temperature")] = None
    rescale_every: PositiveInt = 10


class OfObservers(Section):
    """[[observer]]: a quantity that is measured during the run by an observer of minimd.observers, with its
    arguments."""

    def faults(self, units: str) -> Iterator[str]:
        """See Section."""
        takes, kind = KINDS[self.kind].declared, self.kind  # type: ignore[attr-defined]
        for one in self._given():
            if one not in takes:
                known = ", ".join(
                    self.key(name, units) for name in type(self).model_fields if name in takes
                )
                yield f"cannot have {self.key(one, units)} with kind {kind!r}, which takes {known}"
        self.observer()  # raises ValueError if the observer refuses its arguments

    def _given(self) -> dict[str, Any]:
        return {name: value for name, value in self if name != "kind" and value is not None}

    def observer(self) -> Accumulator:
        """A new observer of this kind.
        Raises ValueError if it refuses the arguments."""
        return KINDS[self.kind](**self._given())  # type: ignore[attr-defined]


ARGUMENTS: dict[Any, Any] = {  # of observers, by what they must be
    checked_count: PositiveInt, arguments.levels: PositiveInt, arguments.positive: Positive, arguments.identifier: str,
    arguments.names: str | list[str], arguments.orders: str | list[str], checked_flag: bool,
    arguments.axis_name: Annotated[str, one_of(arguments.AXES)],
    arguments.particles: Annotated[str, one_of(arguments.PARTICLES)],
    arguments.interval: Annotated[list[FiniteFloat], Two],
}  # fmt: skip


def _argument(name: str) -> tuple[Any, None]:
    """Type and default of a field, from the declaration of the observers that take this argument."""
    taken = {kind: made.declared[name] for kind, made in KINDS.items() if name in made.declared}
    check, words, dimension = next(iter(taken.values()))
    if len(taken) < len(KINDS):
        words = f"of {', '.join(f'`{kind}`' for kind in taken)}: {words}"
    marks = [Field(description=words), *([Dimension(dimension)] if dimension else [])]
    return Annotated[ARGUMENTS[check] | None, *marks], None


KIND_OF_OBSERVER = Field(
    description="what is measured during the run, see [observers](observers.md)"
)
ObserverSection = create_model(  # type: ignore[call-overload]
    "ObserverSection", __base__=OfObservers, __module__=__name__, __doc__=OfObservers.__doc__,
    kind=(Annotated[str, one_of(KINDS), KIND_OF_OBSERVER], ...),
    **{one: _argument(one) for one in ("every", "name", *chain(*(made.declared for made in KINDS.values())))},
)  # fmt: skip


def _plot_name(value: bool | str) -> bool | str:
    if isinstance(value, str) and not value.lower().endswith(PLOT_SUFFIXES):
        raise ValueError(
            f"must be true, false or a name that ends in one of {', '.join(PLOT_SUFFIXES)}"
        )
    return value


class OutputSection(Section):
    """[output]: files in the current folder; if no name is given, the trajectory is named after the scene.
    shadow_energy, stress : whether to record these observables too."""

    trajectory: str | list[str] | None = None
    every: PositiveInt = 100
    forces: bool = False
    shadow_energy: bool = False
    stress: bool = False
    plot: Annotated[bool | str, AfterValidator(_plot_name)] = False

    @property
    def extra_observables(self) -> list[str]:
        """The names of the extra observables that are recorded."""
        return [name for name in ("shadow_energy", "stress") if getattr(self, name)]


PotentialSection = Annotated[
    LennardJonesSection
    | MieSection
    | SoftRepulsionSection
    | TabulatedSection
    | EmbeddedAtomSection
    | ForceSection,  # type: ignore[valid-type]
    Field(discriminator="type"),
]


class SceneSections(Section):
    """A whole scene file."""

    title: Annotated[str, AfterValidator(printable)] = ""
    units: Literal["ASE", "LJ"] = "ASE"
    structure: StructureSection = StructureSection.model_construct()
    water: WaterSection | None = None
    constraints: ConstraintsSection | None = None
    potential: Annotated[list[PotentialSection], Field(min_length=1)] = Field([])
    dynamics: DynamicsSection
    barostat: BarostatSection | None = None
    minimization: MinimizationSection | None = None
    equilibration: EquilibrationSection | None = None
    tables: dict[str, TableSection] = Field({})
    files: dict[str, FileSection] = Field({})
    observer: list[ObserverSection] = Field([])  # type: ignore[valid-type]
    output: OutputSection = OutputSection.model_construct()

    def faults(self, units: str) -> Iterator[str]:
        """See Section."""
        given_sections = self.model_fields_set
        if not given_sections & {"structure", "water"}:
            yield "structure is missing; give it, or water in its place"
        if not given_sections & {"potential", "water"}:
            yield "potential is missing; give it"
        pairs = self.constraints and self.constraints.pairs
        if self.water:
            keys = self.structure.model_fields_set | self.water.model_fields_set
            if "structure" in given_sections and keys & GIVEN_TWICE:
                yield f"structure and water give the same; leave {', '.join(sorted(GIVEN_TWICE))} out"
            if pairs is not None:
                yield "constraints.pairs would replace those of water; leave them out"
            if units != "ASE":
                yield f'water needs units = "ASE"; units = "{units}"'

        if self.dynamics.temperature is None:
            temperature = f"dynamics.{DynamicsSection.key('temperature', units)}"
            if self.equilibration:
                yield f"equilibration needs {temperature}, at which first velocities are drawn"
            if self.barostat:
                yield f"barostat needs {temperature}, the temperature of its noise"

        if pairs == "bonds" and not self.structure.bonds:
            yield 'constraints.pairs = "bonds" needs structure.bonds; give them there, or list the pairs'
        with_files = [section for section in self.potential if isinstance(section, WithFiles)]
        for kept_in in ("tables", "files"):
            used = {name for part in with_files if part.kept_in == kept_in for name in part.files}
            unused = [repr(name) for name in getattr(self, kept_in) if name not in used]
            if unused:
                names = f", {kept_in}.".join(unused)
                yield f"no potential uses {kept_in}.{names}; name it as the file of one, or leave it out"
