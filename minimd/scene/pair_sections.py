"""The sections of a scene file for laws of pairs with numbers for each species or pair of species."""

from collections.abc import Iterator
from typing import Annotated, Any, ClassVar, Literal

from pydantic import Field

from minimd.core.potentials.mie import Mie
from minimd.core.potentials.pair import MIXING, LennardJones, Nonbonded
from minimd.core.potentials.soft_repulsion import SoftRepulsion
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

    law: ClassVar[type[Nonbonded]] = LennardJones
    numbers: ClassVar[tuple[str, ...]] = ("epsilon", "sigma")
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
        missing = [getattr(self, name) for name in self.numbers].count(None)
        if missing != (0 if self.species is None else len(self.numbers)):
            names = ", ".join(self.numbers[:-1])
            yield f"must have either {names} and {self.numbers[-1]}, or a table of species with all of them"

    def potential(self) -> Nonbonded:
        """The potential that the section describes."""
        first, *others = self._numbers_of(self)
        if self.species is not None:
            first = {name: self._numbers_of(well) for name, well in self.species.items()}
        pairs: Any = {tuple(pair.species): self._numbers_of(pair) for pair in self.pairs}
        options = self.model_dump(exclude={"type", "species", "pairs", *self.numbers})
        law: Any = self.law
        return law(first, *others, pairs=pairs, **options)

    def _numbers_of(self, section: Section) -> tuple[Any, ...]:
        return tuple(getattr(section, name) for name in self.numbers)


class MieSpeciesSection(SpeciesSection):
    """[potential.species.X]: Mie parameters of one species."""

    n: Positive
    m: Positive


class MiePairSection(MieSpeciesSection):
    """An entry of pairs: Mie parameters of two species, in place of those of the mixing rule."""

    species: PairOfSpecies


class MieSection(LennardJonesSection):
    """[[potential]] of type "mie"."""

    law: ClassVar[type[Nonbonded]] = Mie
    numbers: ClassVar[tuple[str, ...]] = ("epsilon", "sigma", "n", "m")
    type: Literal["mie"]  # type: ignore[assignment]
    n: Positive | None = None
    m: Positive | None = None
    species: dict[str, MieSpeciesSection] | None = None  # type: ignore[assignment]
    pairs: list[MiePairSection] = Field([])  # type: ignore[assignment]


class SoftPairSection(Section):
    """An entry of pairs: the height for two species."""

    species: PairOfSpecies
    height: Annotated[NotNegative, Dimension("energy")]


class SoftRepulsionSection(Section):
    """[[potential]] of type "soft-repulsion"."""

    type: Literal["soft-repulsion"]
    height: Annotated[NotNegative | None, Dimension("energy")] = None
    pairs: Annotated[list[SoftPairSection] | None, Field(min_length=1)] = None
    cutoff: Annotated[Positive, Dimension("length")]
    bonded_scale: Vector = Field([1.0, 1.0, 1.0])

    def faults(self, units: str) -> Iterator[str]:
        """See Section."""
        if (self.height is None) == (self.pairs is None):
            yield f"must have either {self.key('height', units)}, that of all pairs, or pairs, with that of each"

    def potential(self) -> SoftRepulsion:
        """The potential that the section describes."""
        by_pair: Any = {tuple(pair.species): pair.height for pair in self.pairs or ()}
        height = by_pair if self.height is None else self.height
        return SoftRepulsion(height, self.cutoff, bonded_scale=self.bonded_scale)
