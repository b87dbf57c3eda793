"""What may stand in a scene file: one class for each section, one line for each key.

A key that holds a quantity carries its unit, timestep_fs; a field of a section is named without it, and holds the quantity.
"""

from collections.abc import Iterable
from dataclasses import dataclass, field
from typing import Annotated, Any, Literal, Self

from pydantic import AfterValidator, BaseModel, ConfigDict, Field, FiniteFloat, NonNegativeInt, PositiveInt, ValidationInfo, model_validator

from minimd.integrators import SPLITTINGS, THERMOSTATS
from minimd.lattice import BASES
from minimd.potentials import HarmonicAngle, HarmonicBond, LennardJones
from minimd.potentials.mixing import MIXING
from minimd.potentials.truncation import TRUNCATIONS
from minimd.scene.key_units import KEY_UNITS

PLOT_SUFFIXES = (".png", ".pdf", ".svg")


class Dimension(str):
    """Marks a field as a quantity: a key of KEY_UNITS[units]."""


@dataclass
class Unknown:
    """A key that its section does not have, and one that it has already in another unit."""

    table: dict
    key: str
    twice: bool


@dataclass
class Reading:
    """What is noted while a document is read: its unit system, the class of each table by its id, unknown keys."""

    units: str
    sections: dict[int, type["Section"]] = field(default_factory=dict)
    unknown: list[Unknown] = field(default_factory=list)


def _reading(info: ValidationInfo) -> Reading:
    """The notes that go with a validation."""
    if not isinstance(info.context, Reading):
        raise TypeError("a section is read with context=Reading(units)")
    return info.context


class Section(BaseModel):
    """A table of a scene file. Its fields hold numbers in the units of the engine."""

    model_config = ConfigDict(extra="forbid", strict=True, frozen=True)

    @classmethod
    def keys_of(cls, name: str, units: str) -> dict[str, float | None]:
        """The keys under which a field may be written, and the factor that each puts on its numbers; None for no number."""
        dimension = next((mark for mark in cls.model_fields[name].metadata if isinstance(mark, Dimension)), None)
        return {name: None} if dimension is None else {name + ending: size for ending, size in KEY_UNITS[units][dimension].items()}

    @classmethod
    def keys(cls, units: str) -> dict[str, tuple[str, float | None]]:
        """All keys of the section: the field of each, and the factor that it puts on its numbers."""
        return {key: (name, size) for name in cls.model_fields for key, size in cls.keys_of(name, units).items()}

    @model_validator(mode="before")
    @classmethod
    def _without_units(cls, table: Any, info: ValidationInfo) -> Any:
        """The table under the names of the fields, units multiplied into the numbers; unknown keys are noted and dropped."""
        if not isinstance(table, dict):
            return table
        reading = _reading(info)
        reading.sections[id(table)] = cls
        keys, fields = cls.keys(reading.units), {}
        for key, value in table.items():
            name, size = keys.get(key, (None, None))
            if name is None or name in fields:
                reading.unknown.append(Unknown(table, key, twice=name is not None))
            else:
                fields[name] = _multiplied(value, size)
        return fields


def _multiplied(value: Any, size: float | None) -> Any:
    if size is None or isinstance(value, bool):
        return value
    if isinstance(value, list):
        return [_multiplied(entry, size) for entry in value]
    return value * size if isinstance(value, int | float) else value


def _one_of(allowed: Iterable[str]) -> AfterValidator:
    names = tuple(allowed)

    def check(value: str) -> str:
        if value not in names:
            raise ValueError(f"must be one of {', '.join(map(repr, names))}")
        return value

    return AfterValidator(check)


Three = Field(min_length=3, max_length=3)
Positive = Annotated[FiniteFloat, Field(gt=0.0)]
NotNegative = Annotated[FiniteFloat, Field(ge=0.0)]
PairOfAtoms = Annotated[list[int], Field(min_length=2, max_length=2)]
TripleOfAtoms = Annotated[list[int], Three]


class StructureSection(Section):
    """[structure]: a file that ASE reads, or a block of a cubic crystal."""

    file: str | None = None
    lattice: Annotated[str, _one_of(BASES)] | None = None
    element: str | None = None
    repeat: Annotated[list[PositiveInt], Three] | None = None
    density: Annotated[Positive | None, Dimension("density")] = None
    lattice_constant: Annotated[Positive | None, Dimension("length")] = None
    cell: Annotated[Annotated[list[NotNegative], Three] | None, Dimension("length")] = None
    pbc: bool | Annotated[list[bool], Three] | None = None
    species: list[str] | None = None
    bonds: list[PairOfAtoms] | None = None

    @model_validator(mode="after")
    def _is_complete(self, info: ValidationInfo) -> Self:
        if (self.file is None) == (self.lattice is None):
            raise ValueError("must have either file or lattice")
        if self.file is not None:
            self._forbid("file", "element", "repeat", "density", "lattice_constant")
            return self
        self._forbid("lattice", "cell")
        units = _reading(info).units
        if self.repeat is None or (self.element is None and units == "ASE"):
            raise ValueError("must have repeat beside lattice" if self.repeat is None else "must have element beside lattice")
        if (self.density is None) == (self.lattice_constant is None):
            either, other = (next(iter(self.keys_of(name, units))) for name in ("density", "lattice_constant"))
            raise ValueError(f"must have either {either} or {other} beside lattice")
        return self

    def _forbid(self, origin: str, *others: str) -> None:
        for name in others:
            if getattr(self, name) is not None:
                raise ValueError(f"cannot have {name} beside {origin}")


class SpeciesSection(Section):
    """[potential.species.X]: Lennard-Jones parameters of one species."""

    epsilon: Annotated[NotNegative, Dimension("energy")]
    sigma: Annotated[Positive, Dimension("length")]


class PairSection(SpeciesSection):
    """An entry of pairs: Lennard-Jones parameters of two species that do not follow the mixing rule."""

    species: Annotated[list[str], Field(min_length=2, max_length=2)]


class LennardJonesSection(Section):
    """[[potential]] of type "lennard-jones"."""

    type: Literal["lennard-jones"]
    epsilon: Annotated[NotNegative | None, Dimension("energy")] = None
    sigma: Annotated[Positive | None, Dimension("length")] = None
    species: dict[str, SpeciesSection] | None = None
    pairs: list[PairSection] = []
    mixing: Annotated[str, _one_of(MIXING)] = "lorentz-berthelot"
    cutoff: Annotated[Positive | None, Dimension("length")] = None
    truncation: Annotated[str, _one_of(TRUNCATIONS)] = "shifted"
    switch_start: Annotated[Positive | None, Dimension("length")] = None
    bonded_scale: Annotated[list[FiniteFloat], Three] = [1.0, 1.0, 1.0]
    tail_correction: bool = False

    @model_validator(mode="after")
    def _has_parameters(self) -> Self:
        if (self.epsilon is None) != (self.sigma is None) or (self.epsilon is None) == (self.species is None):
            raise ValueError("must have either epsilon and sigma, or a table of species with both")
        return self

    def potential(self) -> LennardJones:
        """The potential that the section describes."""
        by_species: dict[str | int, tuple[float, float]] = {name: (s.epsilon, s.sigma) for name, s in (self.species or {}).items()}
        return LennardJones(
            by_species if self.epsilon is None else self.epsilon,
            self.sigma,
            self.cutoff,
            self.truncation,
            mixing=self.mixing,
            pairs={(pair.species[0], pair.species[1]): (pair.epsilon, pair.sigma) for pair in self.pairs},
            switch_start=self.switch_start,
            bonded_scale=self.bonded_scale,
            tail_correction=self.tail_correction,
        )


class HarmonicBondSection(Section):
    """[[potential]] of type "harmonic-bond": on structure.bonds, or on pairs."""

    type: Literal["harmonic-bond"]
    k: Annotated[NotNegative, Dimension("stiffness")]
    length: Annotated[NotNegative, Dimension("length")]
    pairs: list[PairOfAtoms] | None = None

    def potential(self) -> HarmonicBond:
        """The potential that the section describes."""
        return HarmonicBond(self.k, self.length, self.pairs)


class HarmonicAngleSection(Section):
    """[[potential]] of type "harmonic-angle": on triples of atoms."""

    type: Literal["harmonic-angle"]
    k: Annotated[NotNegative, Dimension("angular stiffness")]
    angle: Annotated[NotNegative, Dimension("angle")]
    triples: list[TripleOfAtoms]

    def potential(self) -> HarmonicAngle:
        """The potential that the section describes."""
        return HarmonicAngle(self.k, self.angle, self.triples)


class DynamicsSection(Section):
    """[dynamics]: method and length. Without a temperature velocities stay; a bath needs one, and a relaxation time (1/friction)."""

    method: Annotated[str, _one_of([*SPLITTINGS, *THERMOSTATS])] = "velocity-verlet"
    timestep: Annotated[Positive, Dimension("time")]
    steps: NonNegativeInt
    temperature: Annotated[NotNegative | None, Dimension("temperature")] = None
    relaxation_time: Annotated[Positive | None, Dimension("time")] = None
    seed: NonNegativeInt = 1
    threads: PositiveInt | None = None
    precision: Literal["double", "mixed"] = "double"

    @model_validator(mode="after")
    def _has_a_bath_if_it_needs_one(self) -> Self:
        is_bath = self.method in THERMOSTATS
        if is_bath != (self.relaxation_time is not None) or (is_bath and self.temperature is None):
            raise ValueError(
                f"a thermostat ({', '.join(THERMOSTATS)}) needs a temperature and a relaxation time, other methods take no relaxation time"
            )
        return self


class EquilibrationSection(Section):
    """[equilibration]: steps before the run, with velocities rescaled to a temperature, that of the dynamics if not given."""

    steps: NonNegativeInt
    temperature: Annotated[Positive | None, Dimension("temperature")] = None
    rescale_every: PositiveInt = 10


def _plot_name(value: bool | str) -> bool | str:
    if isinstance(value, str) and not value.lower().endswith(PLOT_SUFFIXES):
        raise ValueError(f"must be true, false or a name that ends in one of {', '.join(PLOT_SUFFIXES)}")
    return value


class OutputSection(Section):
    """[output]: files in the current folder; the trajectory is named after the scene if not said otherwise."""

    trajectory: str | list[str] | None = None
    every: PositiveInt = 100
    forces: bool = False
    shadow_energy: bool = False
    plot: Annotated[bool | str, AfterValidator(_plot_name)] = False


PotentialSection = Annotated[LennardJonesSection | HarmonicBondSection | HarmonicAngleSection, Field(discriminator="type")]


class SceneSections(Section):
    """A whole scene file."""

    title: str = ""
    units: Literal["ASE", "LJ"] = "ASE"
    structure: StructureSection
    potential: Annotated[list[PotentialSection], Field(min_length=1)]
    dynamics: DynamicsSection
    equilibration: EquilibrationSection | None = None
    output: OutputSection = OutputSection.model_construct()

    @model_validator(mode="after")
    def _can_equilibrate(self, info: ValidationInfo) -> Self:
        if self.equilibration is not None and self.dynamics.temperature is None:
            key = next(iter(DynamicsSection.keys_of("temperature", _reading(info).units)))
            raise ValueError(f"equilibration needs dynamics.{key}, the temperature of the first velocities")
        return self
