"""Types of values that several sections of a scene file use."""

from typing import Annotated

from pydantic import Field, FiniteFloat, NonNegativeInt

Three = Field(min_length=3, max_length=3)
Positive = Annotated[FiniteFloat, Field(gt=0.0)]
NotNegative = Annotated[FiniteFloat, Field(ge=0.0)]
Vector = Annotated[list[FiniteFloat], Three]
Atoms = list[NonNegativeInt]
PairOfAtoms = Annotated[list[int], Field(min_length=2, max_length=2)]
TripleOfAtoms = Annotated[list[int], Three]
QuadrupleOfAtoms = Annotated[list[int], Field(min_length=4, max_length=4)]
