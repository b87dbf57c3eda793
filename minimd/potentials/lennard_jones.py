"""The Lennard-Jones potential: a small class for the parameters of its law."""

from collections.abc import Callable, Mapping, Sequence
from math import isfinite

from minimd.potentials.laws import LennardJonesLaw
from minimd.potentials.pair import ByPairOfLabels, Label, PairPotential, Parameters


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
        truncation: str = "shifted",
        *,
        mixing: str | Callable[[Parameters, Parameters], Parameters] | None = "lorentz-berthelot",
        pairs: ByPairOfLabels | None = None,
        switch_start: float | None = None,
        bonded_scale: Sequence[float] = (1.0, 1.0, 1.0),
        tail_correction: bool = False,
    ) -> None:
        if pairs and not isinstance(epsilon, Mapping):
            raise ValueError("pairs of LennardJones need a mapping from species to (epsilon, sigma) beside them")
        if isinstance(epsilon, Mapping) == (sigma is not None):
            raise ValueError("give LennardJones either epsilon and sigma, or one mapping from species to (epsilon, sigma)")
        by_species = epsilon if isinstance(epsilon, Mapping) else {"all atoms": (epsilon, sigma)}
        _check_lennard_jones({**by_species, **(pairs or {})})
        super().__init__(
            LennardJonesLaw(),
            epsilon if isinstance(epsilon, Mapping) else (epsilon, float(sigma or 0.0)),
            cutoff,
            truncation,
            mixing=mixing,
            pairs=pairs,
            switch_start=switch_start,
            bonded_scale=bonded_scale,
            tail_correction=tail_correction,
        )


def _check_lennard_jones(parameters: Mapping) -> None:
    for name, numbers in parameters.items():
        if len(tuple(numbers)) != 2:
            raise ValueError(f"Lennard-Jones parameters are (epsilon, sigma); those of {name!r} are {numbers!r}")
        epsilon, sigma = numbers
        if not (isfinite(epsilon) and epsilon >= 0.0):
            raise ValueError(f"epsilon must be finite and not negative; epsilon of {name!r} = {epsilon}")
        if not (isfinite(sigma) and sigma > 0.0):
            raise ValueError(f"sigma must be finite and positive; sigma of {name!r} = {sigma}")
