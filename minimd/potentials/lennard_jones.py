"""The Lennard-Jones potential: a small class for the parameters of its law."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from math import inf
from typing import Any

import numpy as np

from minimd.console.words import shown
from minimd.potentials.laws import LennardJonesLaw
from minimd.potentials.pair import UNSCALED, ByPairOfLabels, Label, MixingName, PairPotential, Parameters
from minimd.potentials.truncation import TruncationName
from minimd.structure.checks import checked_number


def curvature_at_minimum(epsilon: Any, sigma: Any) -> Any:
    """u″ of the Lennard-Jones law at its minimum, r = 2^(1/6) σ: 72 ε / (2^(1/3) σ²) [energy/length²]; or arrays."""
    return 72.0 * epsilon / (2.0 ** (1.0 / 3.0) * sigma * sigma)


class LennardJones(PairPotential):
    """Lennard-Jones 12-6 potential u(r) = 4ε [(σ/r)¹² − (σ/r)⁶].

    Parameters
    ----------
    epsilon : ε, depth of the well [energy]; or a mapping from species to (ε, σ), and no sigma.
    sigma : σ, distance where u = 0 [length].
    cutoff, truncation, pairs, switch_start, bonded_scale, tail_correction : as for PairPotential.
    mixing : "lorentz-berthelot" (default), "geometric", or a function of two (ε, σ), for unlike pairs not in pairs.

    Raises
    ------
    ValueError : if ε is negative or σ not positive, and as PairPotential does.
    """

    def __init__(
        self,
        epsilon: float | Mapping[Label, tuple[float, float]],
        sigma: float | None = None,
        cutoff: float | Mapping[tuple[Label, Label], float] | None = None,
        truncation: TruncationName = "shifted",
        *,
        mixing: MixingName | Callable[[Parameters, Parameters], Parameters] | None = "lorentz-berthelot",
        pairs: ByPairOfLabels | None = None,
        switch_start: float | None = None,
        bonded_scale: Sequence[float] = UNSCALED,
        tail_correction: bool = False,
    ) -> None:
        if isinstance(epsilon, Mapping) == (sigma is not None):
            wanted = "either epsilon and sigma, or one mapping from species to (epsilon, sigma)"
            raise ValueError(f"give LennardJones {wanted}")
        parameters: Any = epsilon if isinstance(epsilon, Mapping) else (epsilon, sigma)
        super().__init__(
            LennardJonesLaw(),
            parameters,
            cutoff,
            truncation,
            mixing=mixing,
            pairs=pairs,
            switch_start=switch_start,
            bonded_scale=bonded_scale,
            tail_correction=tail_correction,
        )

    def law_arguments(self) -> dict[str, Any]:
        """See PairPotential."""
        if isinstance(self.parameters, dict):
            return {"epsilon": self.parameters}
        return dict(zip(("epsilon", "sigma"), self.parameters, strict=True))

    @property
    def shortest_length(self) -> float:
        """See PairPotential; without a cutoff the smallest σ [length]."""
        if self.cutoff < inf:
            return super().shortest_length
        parameters = self.parameters.values() if isinstance(self.parameters, dict) else [self.parameters]
        return min((sigma for _, sigma in (*parameters, *self.pairs.values())), default=inf)

    def _checked_numbers(self, numbers: Any, of: Any) -> Parameters:
        if not isinstance(numbers, Sequence | np.ndarray) or len(numbers) != 2:
            raise ValueError(f"Lennard-Jones parameters are (epsilon, sigma); those of {of!r} are {shown(numbers)}")
        whose = "" if of is None else f" of {of!r}"
        epsilon = checked_number(f"epsilon{whose}", numbers[0], "finite and not negative")
        return epsilon, checked_number(f"sigma{whose}", numbers[1], "positive and finite")
