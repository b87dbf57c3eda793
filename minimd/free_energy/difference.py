"""Free-energy differences from the work of many processes between two states: Jarzynski's equality, and Bennett's
acceptance ratio."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike

from minimd.core.console.display import Displayed, Rows
from minimd.core.structure.arrays import Array
from minimd.core.structure.checks import checked_number, checked_numbers
from minimd.core.structure.statistics import FEWEST, mean_and_error, with_error

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

EVIDENCE = 4  # works or samples: from fewer there is no error bar
CONTRADICTS = 5.0  # standard errors


class FreeEnergy(Displayed):
    """Base class of results: a picture, and the first words of their text."""

    def draw(self, panel: Axes) -> None:
        """Draw the result into axes of matplotlib."""

    def plot(self) -> Figure:
        """A figure, which a notebook shows; .savefig(path) writes it to a file."""
        from minimd.core.engine.record_picture import Picture  # matplotlib is slow to load

        figure = Picture(figsize=(6.0, 4.0), dpi=150, layout="constrained")
        self.draw(figure.subplots())
        return figure

    def __repr__(self) -> str:
        return f"{type(self).__name__}({self.display_rows()[0][1]})"


@dataclass(frozen=True, repr=False)
class FreeEnergyDifference(FreeEnergy):
    """ΔF of two states [energy].

    method : "Jarzynski" or "BAR".
    kT : [energy].
    free_energy, free_energy_error : ΔF and its standard error.
    forward, backward : (n,) works, done on the system; backward is empty for Jarzynski's equality.
    n_effective : on how many works the number rests: (Σ w)²/Σ w² of their weights w, of BAR the smaller of both ways.
    crooks : standard errors by which the works are off P_F(W) = P_B(−W) exp[(W − ΔF)/kT]; NaN without backward works.
    """

    method: str
    kT: float
    free_energy: float
    free_energy_error: float
    forward: Array
    backward: Array
    n_effective: float
    crooks: float = np.nan

    def numbers(self) -> dict[str, float]:
        """Its single numbers by name."""
        names = "kT", "free_energy", "free_energy_error", "n_effective", "crooks"
        return {name: getattr(self, name) for name in names}

    def display_rows(self) -> Rows:
        """See Displayed."""
        value = with_error(self.free_energy, self.free_energy_error)
        dissipated = self.forward.mean() - self.free_energy
        rows = [
            (self.method, f"ΔF = {value}, kT = {self.kT:g}"),
            (
                "works",
                f"{len(self.forward)} forward, {len(self.backward)} backward; {dissipated:.3g} is lost on average",
            ),
        ]
        if self.n_effective < FEWEST:
            rows.append(
                (
                    "",
                    f"it rests on about {self.n_effective:.0f} of the works: THE ERROR BAR IS A LOWER BOUND",
                )
            )
        if abs(self.crooks) > CONTRADICTS:
            advice = "check kT, the signs, and that each way begins in equilibrium"
            rows.append(
                (
                    "",
                    f"the works are off Crooks' theorem by {self.crooks:.0f} σ: THEY CONTRADICT EACH OTHER; {advice}",
                )
            )
        return rows

    def draw(self, panel: Axes) -> None:
        """Draw histograms of the works, W forward and −W backward, which cross at ΔF."""
        panel.hist(self.forward, "auto", density=True, alpha=0.5, label="W forward")
        if len(self.backward):
            panel.hist(-self.backward, "auto", density=True, alpha=0.5, label="−W backward")
        panel.axvline(self.free_energy, color="k", ls="--", label="ΔF")
        panel.set(xlabel="work  [energy]", ylabel="probability density", title=self.method)
        panel.legend(frameon=False)


def jarzynski(works: ArrayLike, kT: float) -> FreeEnergyDifference:
    """ΔF from the works W of processes that begin in equilibrium: ΔF = −kT ln ⟨exp(−W/kT)⟩.

    Parameters
    ----------
    works : (n,) works done on the system [energy], in the order of the processes.
    kT : k_B times the temperature of the equilibrium [energy].

    Raises
    ------
    ValueError : if the average rests on fewer than 4 works: there is no evidence for a number.

    C. Jarzynski, Phys. Rev. Lett. 78, 2690 (1997).
    """
    forward = checked_series("works", works)
    kT = checked_number("kT", kT, "positive and finite")
    weights = np.exp((forward.min() - forward) / kT)
    n_effective = _effective(weights)
    if n_effective < EVIDENCE:
        raise ValueError(
            f"works must be such that the average of exp(-W/kT) rests on {EVIDENCE} of them or more; it rests on "
            f"{n_effective:.1f} of {len(forward)}, from {forward.min():.4g} to {forward.max():.4g} with kT = {kT:g}: "
            "take more processes, slower ones, or works of both ways and bar"
        )
    mean, error = mean_and_error(weights)
    free_energy = float(forward.min()) - kT * float(np.log(mean))
    return FreeEnergyDifference(
        "Jarzynski", kT, free_energy, kT * error / mean, forward, np.zeros(0), n_effective
    )


def bar(works_forward: ArrayLike, works_backward: ArrayLike, kT: float) -> FreeEnergyDifference:
    """ΔF of the forward process, from works of both ways, by Bennett's acceptance ratio.

        Σ_F f(x) = Σ_B f(y),   x = (M + W_F − ΔF)/kT,   y = (−M + W_B + ΔF)/kT,
        f(x) = 1/(1 + eˣ),     M = kT ln(n_F/n_B)

    This is the most probable ΔF. The error is that of the two sums over Σ f (1 − f); with independent works it is that
    of Shirts et al., and correlated ones, as of one run, are taken into account.

    Parameters
    ----------
    works_forward, works_backward : (n,) works done on the system [energy], each way begun in equilibrium; of one step,
        as for perturbations, the change of the energy.
    kT : k_B times the temperature of the equilibrium [energy].

    Raises
    ------
    ValueError : if the works W_F and −W_B do not overlap: there is no evidence for a number.

    C. H. Bennett, J. Comput. Phys. 22, 245 (1976); M. R. Shirts, E. Bair, G. Hooker, V. S. Pande, Phys. Rev. Lett. 91,
    140601 (2003); G. E. Crooks, Phys. Rev. E 60, 2721 (1999).
    """
    from scipy.optimize import brentq
    from scipy.special import expit

    forward = checked_series("works_forward", works_forward)
    backward = checked_series("works_backward", works_backward)
    kT = checked_number("kT", kT, "positive and finite")
    low, high = overlap(-backward, forward)
    wanted = (
        f"works must overlap: the {EVIDENCE}th largest of -works_backward, {high:.4g}, must be above the {EVIDENCE}th "
        f"smallest of works_forward, {low:.4g}"
    )
    advice = "take slower processes or states between; both works are done on the system, with their signs"
    if high < low:
        raise ValueError(f"{wanted}: {advice}")

    offset = kT * np.log(len(forward) / len(backward))

    def exponents(free_energy: float) -> tuple[Array, Array]:
        return (offset + forward - free_energy) / kT, (backward - offset + free_energy) / kT

    def excess(free_energy: float) -> Any:
        x, y = exponents(free_energy)
        return expit(-x).sum() - expit(-y).sum()

    works = np.concatenate([forward, -backward])
    reach = 40.0 * kT + abs(offset)  # there one of the sums is zero
    free_energy = float(
        brentq(excess, works.min() - reach, works.max() + reach, xtol=1e-12 * reach)
    )
    x, y = exponents(free_energy)
    p = expit(-x)
    q = expit(-y)
    n_effective = min(_effective(p), _effective(q))
    if n_effective < EVIDENCE:
        raise ValueError(f"{wanted}; ΔF would rest on {n_effective:.1f} of them: {advice}")

    slope = ((p * (1.0 - p)).sum() + (q * (1.0 - q)).sum()) / kT
    error = _error_of_sums(p, q) / slope
    # zero by Crooks' theorem: the derivative of the likelihood of x by a factor of x
    contradiction = (x * p).sum() + (y * q).sum()
    scatter = _error_of_sums(x * p, y * q)
    crooks = contradiction / scatter if scatter > 0.0 else np.nan
    return FreeEnergyDifference(
        "BAR", kT, free_energy, error, forward, backward, n_effective, float(crooks)
    )


def overlap(lower: Array, upper: Array) -> tuple[float, float]:
    """The 4th smallest number of those that should be larger, and the 4th largest of the others; overlapping ones have
    the first below the second."""
    return float(np.partition(upper, EVIDENCE - 1)[EVIDENCE - 1]), float(
        np.partition(lower, -EVIDENCE)[-EVIDENCE]
    )


def _error_of_sums(*series: Array) -> float:
    """The standard error of the sum of all numbers of independent series."""
    return float(np.linalg.norm([len(values) * mean_and_error(values)[1] for values in series]))


def _effective(weights: Array) -> float:
    """How many equal weights have the same scatter.  L. Kish, Survey Sampling (1965), section 8.2."""
    return float(weights.sum() ** 2 / (weights**2).sum())


def checked_series(name: str, series: ArrayLike) -> Array:
    """A series of numbers, enough for an error bar.
    Raises ValueError for anything else."""
    values = checked_numbers(name, series, "a list of numbers")
    if values.ndim != 1 or len(values) < EVIDENCE or not np.isfinite(values).all():
        raise ValueError(
            f"{name} must be {EVIDENCE} or more finite numbers; its shape is {values.shape}"
        )
    return values
