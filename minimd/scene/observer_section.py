"""[[observer]]: a quantity that is measured during the run."""

from typing import Annotated, Any, Self

from pydantic import Field, FiniteFloat, PositiveInt, ValidationInfo, model_validator

from minimd.observers import KINDS, Accumulator
from minimd.scene.section import Dimension, Section, one_of

Length = Annotated[Annotated[FiniteFloat, Field(gt=0.0)] | None, Dimension("length")]
ARGUMENTS = ("every", "name", "r_max", "n_bins", "n_levels", "most_atoms", "axis", "extent")


class ObserverSection(Section):
    """[[observer]]: an observer of minimd.observers, with its kind and its arguments."""

    kind: Annotated[str, one_of(KINDS)]
    every: PositiveInt | None = None
    name: str | None = None
    r_max: Length = None
    n_bins: PositiveInt | None = None
    n_levels: PositiveInt | None = None
    most_atoms: PositiveInt | None = None
    axis: Annotated[str, one_of("abc")] | None = None
    extent: Annotated[Annotated[list[FiniteFloat], Field(min_length=2, max_length=2)] | None, Dimension("length")] = None

    @model_validator(mode="after")
    def _has_what_its_kind_takes(self, info: ValidationInfo) -> Self:
        takes = (*KINDS[self.kind].arguments, "name")
        for one in self._given():
            if one not in takes:
                known = ", ".join(self.key(name, info) for name in ARGUMENTS if name in takes)
                raise ValueError(f"cannot have {self.key(one, info)} with kind {self.kind!r}, which takes {known}")
        self.observer()  # raises ValueError if the observer refuses its arguments
        return self

    def _given(self) -> dict[str, Any]:
        return {name: value for name in ARGUMENTS if (value := getattr(self, name)) is not None}

    def observer(self) -> Accumulator:
        """A new observer of this kind.  Raises ValueError if it refuses the arguments."""
        return KINDS[self.kind](**self._given())
