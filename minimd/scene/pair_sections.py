"""The sections of a scene file for laws of pairs with numbers for each species or pair of species."""

from collections.abc import Iterator
from typing import Annotated, Any, ClassVar, Literal

from pydantic import Field

from minimd.core.potentials.pair import MIXING, LennardJones, Mie, Nonbonded, SoftRepulsion
from minimd.core.potentials.truncation import TRUNCATIONS
from minimd.scene.section import Dimension, NotNegative, Positive, Section, Two, Vector, one_of

Length = Annotated[Positive | None, Dimension("length")]
PairOfSpecies = Annotated[list[str], Two]


class SpeciesSection(Section):
    """[potential.species.X]: Lennard-Jones parameters of one species."""

    epsilon: Annotated[NotNegative, Dimension("energy")]
    sigma: Annotated[Positive, Dimension("length")]


class PairSection(SpeciesSection):
    """An entry of pairs: Lennard-Jones parameters of two species, in place of those of the mixing rule."""

    species: PairOfSpecies


class LennardJonesSection(Section):
    """[[potential]] of type "lennard-jones"."""

    law: ClassVar[Any] = LennardJones
    type: Literal["lennard-jones"]
    epsilon: Annotated[NotNegative | None, Dimension("energy")] = None
    sigma: Length = None
    species: dict[str, SpeciesSection] | None = None
    pairs: list[PairSection] = Field([])
    mixing: Annotated[str, one_of(MIXING)] = "lorentz-berthelot"
    cutoff: Length = None
    truncation: Annotated[str, one_of(TRUNCATIONS)] = "shifted"
    switch_start: Length = None
    bonded_scale: Vector = Field([1.0, 1.0, 1.0])
    tail_correction: bool = False

    def faults(self, units: str) -> Iterator[str]:
        """See Section."""
        numbers = self._numbers_of(self)
        if numbers.count(None) != (0 if self.species is None else len(numbers)):
            *names, last = self.law.numbers_of_well
            yield f"must have either {', '.join(names)} and {last}, or a table of species with all of them"

    def potential(self) -> Nonbonded:
        """The potential that the section describes."""
        first, *others = self._numbers_of(self)
        if self.species is not None:
            first = {name: self._numbers_of(well) for name, well in self.species.items()}
        pairs: Any = {tuple(pair.species): self._numbers_of(pair) for pair in self.pairs}
        options = self.model_dump(exclude={"type", "species", "pairs", *self.law.numbers_of_well})
        potential: Nonbonded = self.law(first, *others, pairs=pairs, **options)
        return potential

    def _numbers_of(self, section: Section) -> tuple[Any, ...]:
        return tuple(getattr(section, name) for name in self.law.numbers_of_well)


class MieSpeciesSection(SpeciesSection):
    """[potential.species.X]: Mie parameters of one species."""

    n: Positive
    m: Positive


class MiePairSection(MieSpeciesSection):
    """An entry of pairs: Mie parameters of two species, in place of those of the mixing rule."""

    species: PairOfSpecies


class MieSection(LennardJonesSection):
    """[[potential]] of type "mie"."""

    law: ClassVar[Any] = Mie
    type: Literal["mie"]  # type: ignore[assignment]
    n: Positive | None = None
    m: Positive | None = None
    species: dict[str, MieSpeciesSection] | None = None  # type: ignore[assignment]
    pairs: list[MiePairSection] = Field([])  # type: ignore[assignment]


class SoftRepulsionSection(Section):
    """[[potential]] of type "soft-repulsion"."""

    type: Literal["soft-repulsion"]
    height: Annotated[NotNegative, Dimension("energy")]
    cutoff: Annotated[Positive, Dimension("length")]
    bonded_scale: Vector = Field([1.0, 1.0, 1.0])

    def potential(self) -> SoftRepulsion:
        """The potential that the section describes."""
        return SoftRepulsion(**self.model_dump(exclude={"type"}))
