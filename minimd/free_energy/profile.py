"""Profiles of the free energy along a coordinate, from runs in umbrella windows, by MBAR."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike

from minimd.core.console.display import Rows
from minimd.core.console.words import shown
from minimd.core.structure.arrays import Array
from minimd.core.structure.checks import checked_number, checked_numbers, checked_sizes
from minimd.core.structure.statistics import (
    MOST_BLOCKS,
    correlation_times,
    mean_and_error,
    short_run,
    standard_error,
    with_error,
)
from minimd.free_energy.difference import EVIDENCE, FreeEnergy, checked_series, overlap

if TYPE_CHECKING:
    from matplotlib.axes import Axes

CONVERGED = 1e-9  # of the number of samples
MOST_STEPS = 100  # of Newton; ten are usual


@dataclass(frozen=True, repr=False)
class FreeEnergyProfile(FreeEnergy):
    """F(ξ) = −kT ln p(ξ) of the run without bias, zero at its minimum [energy]; bins with fewer than 4 samples are left
    out.

    coordinate : (B,) centers of bins [unit of ξ].
    free_energy, free_energy_error : (B,), and the standard errors of the differences from the minimum, where it is 0.
    kT : [energy].
    window_free_energies : (K,) of the windows with their biases; the first is 0.
    correlation_times : the length of the run that has the fewest.
    shortest : the number of its window.
    """

    coordinate: Array
    free_energy: Array
    free_energy_error: Array
    kT: float
    window_free_energies: Array
    correlation_times: float
    shortest: int

    def numbers(self) -> dict[str, float]:
        """Its single numbers by name; the barrier is the largest free energy."""
        top = int(self.free_energy.argmax())
        return {
            "minimum": float(self.coordinate[self.free_energy.argmin()]),
            "highest": float(self.free_energy[top]),
            "highest_error": float(self.free_energy_error[top]),
            "correlation_times": self.correlation_times,
        }

    def display_rows(self) -> Rows:
        """See Displayed."""
        numbers = self.numbers()
        top = self.coordinate[self.free_energy.argmax()]
        highest = with_error(numbers["highest"], numbers["highest_error"])
        ends = f"{self.coordinate[0]:.4g} to {self.coordinate[-1]:.4g}"
        rows = [
            (
                "profile",
                f"{len(self.coordinate)} bins, {ends}, of {len(self.window_free_energies)} windows",
            ),
            ("minimum", f"at {numbers['minimum']:.4g}; highest F = {highest}, at {top:.4g}"),
        ]
        words = short_run(self.correlation_times, f"coordinate in window {self.shortest}")
        return [*rows, ("", words)] if words else rows

    def draw(self, panel: Axes) -> None:
        """Draw F(ξ), with a band of one standard error."""
        f, error = self.free_energy, self.free_energy_error
        panel.plot(self.coordinate, f)
        panel.fill_between(self.coordinate, f - error, f + error, alpha=0.25, lw=0)
        panel.set(xlabel="ξ", ylabel="F  [energy]", title="free energy")


def umbrella(
    coordinates: Sequence[ArrayLike],
    centers: ArrayLike,
    stiffnesses: ArrayLike,
    kT: float,
    bins: int | ArrayLike = 50,
) -> FreeEnergyProfile:
    """F(ξ) from windows with a bias ½ k (ξ − c)², as of md.Restraint and md.HarmonicBond: WHAM without bins, MBAR.

        Dₙ⁻¹ = Σ_j N_j exp(f_j − u_jn),   u_jn = k_j (ξₙ − c_j)²/2kT,   Σₙ Dₙ exp(f_j − u_jn) = 1,
        F(bin) = −kT ln [Σ_{n in bin} Dₙ/width]

    n counts the samples of all windows. The last equations are solved by Newton's method. Errors are those of the
    linear response of F to the mean of each window, whose samples may be correlated in time.

    Parameters
    ----------
    coordinates : K series of ξ in equilibrium, each in the order of time, of any lengths.
    centers, stiffnesses : c, (K,) [unit of ξ], and k [energy/unit²], one number or (K,).
    kT : k_B times the temperature [energy].
    bins : how many between the ends of the samples, or their edges.

    Raises
    ------
    ValueError : if neighboring windows do not overlap: there is no evidence for their difference.

    M. R. Shirts, J. D. Chodera, J. Chem. Phys. 129, 124105 (2008), eq. 9, 11; S. Kumar et al., J. Comput. Chem. 13,
    1011 (1992), for WHAM.
    """
    series = [checked_series(f"coordinates[{k}]", values) for k, values in enumerate(coordinates)]
    places = checked_numbers("centers", centers, "one for each window")
    kT = checked_number("kT", kT, "positive and finite")
    if not series or places.shape != (len(series),) or not np.isfinite(places).all():
        raise ValueError(
            f"centers must be one finite number for each of the {len(series)} windows; centers = {shown(centers)}"
        )
    springs = checked_sizes("stiffnesses", stiffnesses, len(series), "window")
    _check_overlap(series, places)

    x = np.concatenate(series)
    biases = springs[:, None] * (x - places[:, None]) ** 2 / (2.0 * kT)
    counts = np.array([len(values) for values in series], float)
    f, logs, shares = _solved(biases, counts)

    edges = checked_numbers("bins", bins, "how many there are, or their edges")
    if not edges.ndim:
        edges = np.linspace(x.min(), x.max(), max(int(edges), 0) + 1)
    members = (edges[:-1, None] <= x) & (x < edges[1:, None])
    occupied = members.sum(axis=1) >= EVIDENCE
    if not occupied.any():
        raise ValueError(
            f"bins must be a number, or increasing edges, with {EVIDENCE} samples in a bin; bins = {shown(bins)}"
        )
    weights = np.exp(-logs + logs.min()) * members[occupied]
    sums = weights.sum(axis=1)
    profile = -kT * np.log(sums / np.diff(edges)[occupied])
    lowest = int(profile.argmin())
    errors = kT * _errors(weights / sums[:, None], shares, counts, lowest)
    lengths = [
        float(correlation_times(values.var(), mean_and_error(values)[1])) for values in series
    ]
    shortest = int(np.argmin(lengths))
    middles = 0.5 * (edges[1:] + edges[:-1])[occupied]
    return FreeEnergyProfile(
        middles,
        profile - profile[lowest],
        errors,
        kT,
        kT * (f - f[0]),
        lengths[shortest],
        shortest,
    )


def _errors(responses: Array, shares: Array, counts: Array, lowest: int) -> Array:
    """The standard errors of ln p of bins relative to that of the lowest, (B,).

    responses : (B, N) of ln p to the weight of each sample, at fixed f; f responds by −H⁺ times the shares, with the
        curvature H of the likelihood.
    """
    curvature = np.diag(counts) - shares @ shares.T
    total = responses + responses @ shares.T @ np.linalg.pinv(curvature, hermitian=True) @ shares
    total -= total[lowest]
    variance = np.zeros(len(total))
    for own in np.split(total, np.cumsum(counts[:-1]).astype(int), axis=1):
        parts = np.array_split(own, min(own.shape[1], MOST_BLOCKS), axis=1)
        blocks = np.array([part.mean(axis=1) for part in parts])
        variance += (own.shape[1] * standard_error(blocks)) ** 2
    return np.sqrt(variance)


def _solved(biases: Array, counts: Array) -> tuple[Array, Array, Array]:
    """The f of the windows (K,), −ln D of the samples (N,), and the shares N_j Dₙ exp(f_j − u_jn) (K, N).

    Newton's method on the likelihood Σ_j N_j f_j − Σₙ ln Dₙ⁻¹, which is concave; a step that lowers it is halved.
    Raises ValueError if it does not converge.
    """
    from scipy.special import logsumexp

    f = np.zeros(len(counts))
    step = np.zeros(len(counts))
    best = -np.inf
    for _ in range(MOST_STEPS):
        exponents = np.log(counts)[:, None] + (f + step)[:, None] - biases
        logs = logsumexp(exponents, axis=0)
        likelihood = counts @ (f + step) - logs.sum()
        if likelihood < best - CONVERGED * abs(best):
            step *= 0.5
            continue
        f = f + step
        best = likelihood
        shares = np.exp(exponents - logs)
        excess = counts - shares.sum(axis=1)
        if np.abs(excess).max() <= CONVERGED * counts.sum():
            return f, logs, shares
        curvature = np.diag(shares.sum(axis=1)) - shares @ shares.T
        step = np.linalg.pinv(curvature, hermitian=True) @ excess
    raise ValueError(
        f"coordinates of windows must overlap; their free energies do not converge in {MOST_STEPS} steps"
    )


def _check_overlap(series: Sequence[Array], centers: Array) -> None:
    """Raise ValueError unless samples of the windows on both sides of each gap between centers overlap."""
    order = np.argsort(centers)
    for k in range(1, len(order)):
        lower, upper = (
            np.concatenate([series[w] for w in part]) for part in (order[:k], order[k:])
        )
        low, high = overlap(lower, upper)
        if high < low:
            raise ValueError(
                f"windows must overlap; windows {order[k - 1]} and {order[k]}, with centers {centers[order[k - 1]]:g} "
                f"and {centers[order[k]]:g}, leave a gap from {high:.4g} to {low:.4g}: add a window, or soften springs"
            )
