"""The base of all sections of a scene file: strict types, and keys that end in a unit.

The key of a quantity ends in its unit, as in timestep_fs. The name of the field has no unit, as in timestep, and its
value is in the units of the engine.
"""

from collections.abc import Collection, Iterator, Mapping
from dataclasses import dataclass, field
from typing import Annotated, Any, Self

from pydantic import (
    AfterValidator,
    BaseModel,
    ConfigDict,
    Field,
    FiniteFloat,
    NonNegativeInt,
    model_validator,
)

from minimd.core.structure.checks import LARGEST
from minimd.core.structure.units import (
    BAR,
    BOLTZMANN_EV_PER_K,
    DEGREE,
    FEMTOSECOND,
    GPA,
    GRAM_PER_CM3,
    PICOSECOND,
)

# unit system: dimension: ending of the key: size of that unit in units of the engine
KEY_UNITS: dict[str, dict[str, dict[str, float]]] = {}
KEY_UNITS["ASE"] = {
    "length": {"_A": 1.0},
    "time": {"_fs": FEMTOSECOND},
    "temperature": {"_K": 1.0},
    "energy": {"_K": BOLTZMANN_EV_PER_K, "_eV": 1.0},
    "force": {"_eV_A": 1.0},
    "density": {"_g_cm3": GRAM_PER_CM3},
    "pressure": {"_bar": BAR, "_GPa": GPA},
    "compressibility": {"_per_bar": 1.0 / BAR, "_per_GPa": 1.0 / GPA},
    "stiffness": {"_eV_A2": 1.0},
    "cubic stiffness": {"_eV_A3": 1.0},
    "quartic stiffness": {"_eV_A4": 1.0},
    "angle": {"_degree": DEGREE},
    "angular stiffness": {"_eV_rad2": 1.0},
    "inverse length": {"_per_A": 1.0},
    "velocity": {"_A_ps": 1.0 / PICOSECOND},
    "acceleration": {"_A_ps2": 1.0 / PICOSECOND**2},
}
KEY_UNITS["LJ"] = {name: {"": 1.0} for name in KEY_UNITS["ASE"]} | {"angle": {"_degree": DEGREE}}
# key: its field, and the factor by which its numbers are multiplied, None if it is not a quantity
Keys = dict[str, tuple[str, float | None]]
# types of values that several sections use
Two = Field(min_length=2, max_length=2)
Three = Field(min_length=3, max_length=3)
Positive = Annotated[FiniteFloat, Field(gt=0.0)]
NotNegative = Annotated[FiniteFloat, Field(ge=0.0)]
Vector = Annotated[list[FiniteFloat], Three]
Atoms = list[NonNegativeInt]
PairOfAtoms = Annotated[list[int], Two]
SIGNS = str.maketrans("A234", "Å²³⁴")  # of units, for letters in keys
UNKNOWN = "?"  # put before a key that its section does not know


def quantity_of(key: str) -> str:
    """A parameter as the label of an axis; of the key of a scene dynamics.temperature_K, "temperature  [K]"."""
    name = key.rpartition(".")[2]
    endings = [ending for keys in KEY_UNITS["ASE"].values() for ending in keys]
    for ending in sorted(endings, key=len, reverse=True):
        if name != key and name.endswith(ending):
            unit = ending[1:].replace("per_", "1/").replace("_", "/").translate(SIGNS)
            return f"{name.removesuffix(ending).replace('_', ' ')}  [{unit}]"
    return name.replace("_", " ") if name != key else key


class Dimension(str):
    """Marks a field as a quantity with this dimension, a key of KEY_UNITS[units]."""


@dataclass
class Reading:
    """The context of a validation: the document, and the class that reads each of its tables, by id of the table."""

    document: dict[str, Any]
    sections: dict[int, type["Section"]] = field(default_factory=dict)

    @property
    def units(self) -> str:
        """The unit system of the document; ASE unless it is LJ."""
        return "LJ" if self.document.get("units") == "LJ" else "ASE"

    def keys(self, table: Any) -> Keys:
        """The keys that a table of the document may have; none if it is not a section."""
        section = self.sections.get(id(table))
        return section.keys(self.units) if section else {}


class Section(BaseModel):
    """A table of a scene file. Its fields hold numbers in the units of the engine."""

    model_config = ConfigDict(extra="forbid", strict=True, frozen=True)

    @classmethod
    def keys(cls, units: str) -> Keys:
        """All keys that the section may have."""
        keys: Keys = {}
        for name, info in cls.model_fields.items():
            endings: Mapping[str, float | None] = {"": None}
            for mark in info.metadata:
                if isinstance(mark, Dimension):
                    endings = KEY_UNITS[units][mark]
            keys |= {name + ending: (name, size) for ending, size in endings.items()}
        return keys

    @classmethod
    def key(cls, name: str, units: str) -> str:
        """The first key for a field."""
        return next(key for key, (field, _) in cls.keys(units).items() if field == name)

    def faults(self, units: str) -> Iterator[str]:
        """What is wrong with its values together, in words that follow its name.
        units : of the document."""
        yield from ()

    @model_validator(mode="after")
    def _fits_together(self, info: Any) -> Self:
        for fault in self.faults(info.context.units):
            raise ValueError(fault)
        return self

    @model_validator(mode="before")
    @classmethod
    def _without_units(cls, table: Any, info: Any) -> Any:
        """The table with the names of fields as keys, and numbers in the units of the engine.
        A key that is unknown, or gives a quantity for the second time, gets a name that is not a field."""
        if not isinstance(table, dict):
            return table
        reading: Reading = info.context
        reading.sections[id(table)] = cls
        keys = cls.keys(reading.units)
        fields = {}
        for key, value in table.items():
            name, size = keys.get(key, (UNKNOWN + key, None))
            fields[UNKNOWN + key if name in fields else name] = _multiplied(value, size)
        return fields


def sections_below(section: type[Section]) -> Iterator[type[Section]]:
    """All subclasses of a section that have fields, with theirs."""
    for subclass in section.__subclasses__():
        if subclass.model_fields:
            yield subclass
        yield from sections_below(subclass)


def _multiplied(value: Any, size: float | None) -> Any:
    if isinstance(value, list):
        return [_multiplied(entry, size) for entry in value]
    is_number = isinstance(value, int | float) and not isinstance(value, bool)
    if size is None or not is_number or not abs(value) < LARGEST:
        return value  # numbers that are too large are refused later, as they are written
    return value * size


def one_of(allowed: Collection[str]) -> AfterValidator:
    """A check that a text is one of the allowed names.
    allowed : read at each check, so that names registered later are included."""

    def check(value: str) -> str:
        if value not in allowed:
            raise ValueError(f"must be one of {', '.join(map(repr, allowed))}")
        return value

    return AfterValidator(check)
