"""What all sections of a scene file share: keys with units, strict types, and notes about what is unknown.

A key that holds a quantity carries its unit, timestep_fs; a field of a section is named without it, and holds the quantity.
"""

from collections.abc import Iterable
from dataclasses import dataclass, field
from typing import Any

from pydantic import AfterValidator, BaseModel, ConfigDict, ValidationInfo, model_validator

from minimd.scene.key_units import KEY_UNITS


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


def reading_of(info: ValidationInfo) -> Reading:
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
        reading = reading_of(info)
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


def one_of(allowed: Iterable[str]) -> AfterValidator:
    """A check that a text is one of some names."""
    names = tuple(allowed)

    def check(value: str) -> str:
        if value not in names:
            raise ValueError(f"must be one of {', '.join(map(repr, names))}")
        return value

    return AfterValidator(check)
