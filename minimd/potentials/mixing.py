"""Mixing rules: the (ε, σ) of an unlike pair from those of the like pairs."""

from math import sqrt

Parameters = tuple[float, ...]


def lorentz_berthelot(first: Parameters, second: Parameters) -> Parameters:
    """ε = √(ε₁ ε₂), σ = (σ₁ + σ₂)/2.  H. A. Lorentz, Ann. Phys. 248, 127 (1881); D. Berthelot, C. R. 126, 1703 (1898)."""
    return sqrt(first[0] * second[0]), 0.5 * (first[1] + second[1])


def geometric(first: Parameters, second: Parameters) -> Parameters:
    """ε = √(ε₁ ε₂), σ = √(σ₁ σ₂)."""
    return sqrt(first[0] * second[0]), sqrt(first[1] * second[1])


MIXING = {"lorentz-berthelot": lorentz_berthelot, "geometric": geometric}
