"""The conservation report: what should have stayed constant, and whether it did."""

from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from minimd.record import Record

BLOCKS = 20  # averages of the total energy between which the drift is fitted
SIGNIFICANT = 3.0  # standard errors
NEGLIGIBLE_DRIFT = 0.01  # of the kinetic energy, over the whole run
ROUNDING = 1e-9  # of Σ|mv|, change of the total momentum that rounding can explain


@dataclass(frozen=True)
class Drift:
    """Slope of a straight line through block averages [per time], and its standard error; error infinite below four blocks."""

    slope: float
    error: float

    @property
    def is_significant(self) -> bool:
        """True if the slope differs from zero by more than three standard errors."""
        return abs(self.slope) > SIGNIFICANT * self.error


def drift(time: NDArray[np.float64], series: NDArray[np.float64], blocks: int = BLOCKS) -> Drift:
    """Least-squares slope of a series, with the standard error that its correlated fluctuations leave.

    Averages over a few long blocks are nearly independent of each other, so that their scatter about the line gives the
    error. time, series : (T,).  H. Flyvbjerg, H. G. Petersen, J. Chem. Phys. 91, 461 (1989).
    """
    blocks = min(blocks, len(series))
    if blocks < 4 or np.ptp(time) == 0.0:
        slope = (series[-1] - series[0]) / np.ptp(time) if np.ptp(time) > 0.0 else 0.0
        return Drift(float(slope), np.inf)
    t = np.array([part.mean() for part in np.array_split(time, blocks)])
    y = np.array([part.mean() for part in np.array_split(series, blocks)])
    centred = t - t.mean()
    slope = centred @ y / (centred @ centred)
    residuals = y - y.mean() - slope * centred
    return Drift(float(slope), float(np.sqrt(residuals @ residuals / (blocks - 2) / (centred @ centred))))


@dataclass(frozen=True)
class Report:
    """What a run conserved, and what it cost. str(report) is the text for people.

    Attributes
    ----------
    energy_drift : Drift of the total energy per atom [energy/time]; time in ps, or τ in reduced units.
    energy_oscillation : standard deviation of the total energy per atom about that line [energy].
    momentum_change : largest |P(t) − P(0)| / Σ|mv|.
    angular_momentum_change : largest |L(t) − L(0)| / |L| scale, or None where L is not a constant.
    mean_temperature, temperature_deviation : mean and standard deviation of the kinetic temperature.
    duration : [ps or τ].  kinetic_energy : mean per atom [energy].
    """

    energy_drift: Drift
    energy_oscillation: float
    momentum_change: float
    angular_momentum_change: float | None
    mean_temperature: float
    temperature_deviation: float
    duration: float
    kinetic_energy: float
    n_frames: int
    units: tuple[str, str, str]
    steps_per_second: float | None = None
    list_builds: int | None = None
    n_evaluations: int | None = None
    skipped: list[str] = field(default_factory=list)

    @property
    def energy_is_conserved(self) -> bool:
        """True if the drift is zero within three standard errors, or negligible beside the kinetic energy."""
        total = abs(self.energy_drift.slope) * self.duration
        return not self.energy_drift.is_significant or total < NEGLIGIBLE_DRIFT * self.kinetic_energy

    @property
    def momentum_is_conserved(self) -> bool:
        """True if the change is what rounding explains."""
        return self.momentum_change < ROUNDING

    def with_run(self, **figures: object) -> "Report":
        """The same report with what only the simulation knows."""
        return replace(self, **figures)  # type: ignore[arg-type]

    def __str__(self) -> str:
        energy, time, temperature = self.units
        drift_, per = self.energy_drift, f"{energy} per atom"
        lines = [
            f"total energy   drift {drift_.slope:+.2e} ± {drift_.error:.1e} {per} per {time}",
            f"               oscillation {self.energy_oscillation:.2e} {per} (standard deviation)",
            f"momentum       change {self.momentum_change:.1e} of the sum of |mv|",
        ]
        if self.angular_momentum_change is not None:
            lines.append(f"ang. momentum  change {self.angular_momentum_change:.1e} of its scale")
        lines.append(f"temperature    {self.mean_temperature:.4g} ± {self.temperature_deviation:.2g} {temperature}")
        if self.steps_per_second is not None:
            lines.append(
                f"speed          {self.steps_per_second:.4g} steps/s; {self.n_evaluations} force evaluations, {self.list_builds} list builds"
            )
        if self.skipped:
            lines.append(f"not needed     {', '.join(self.skipped)}")
        return "\n".join([*lines, f"verdict        {self.verdict}"])

    @property
    def verdict(self) -> str:
        """One sentence."""
        if self.n_frames < 4:
            return "too few frames to judge; observe more often"
        energy = "the total energy is conserved" if self.energy_is_conserved else "THE TOTAL ENERGY DRIFTS: reduce the time step or smooth the cutoff"
        momentum = "momentum is conserved to rounding" if self.momentum_is_conserved else "THE TOTAL MOMENTUM CHANGES: a force is not pairwise"
        return f"{energy}; {momentum}."


def conservation_report(record: Record, angular: bool) -> Report:
    """The report of a record.  angular : whether the scene conserves angular momentum (nothing periodic)."""
    units = record.units
    time, energy = record.time * units.to_picosecond, record.total_energy / record.n_atoms
    slope = drift(time, energy)
    about_line = energy - energy.mean() - slope.slope * (time - time.mean())
    return Report(
        energy_drift=slope,
        energy_oscillation=float(about_line.std()),
        momentum_change=_largest_change(record.momentum, record.absolute_momentum),
        angular_momentum_change=_largest_change(record.angular_momentum, np.linalg.norm(record.angular_momentum, axis=1)) if angular else None,
        mean_temperature=float(record.temperature.mean()),
        temperature_deviation=float(record.temperature.std()),
        duration=float(np.ptp(time)),
        kinetic_energy=float(record.kinetic_energy.mean() / record.n_atoms),
        n_frames=len(time),
        units=(units.energy, units.shown_time, units.temperature),
    )


def _largest_change(vectors: NDArray[np.float64], scales: NDArray[np.float64]) -> float:
    """max |v(t) − v(0)| over the largest scale; 0 if there is no scale, because nothing moves."""
    scale = scales.max()
    return float(np.linalg.norm(vectors - vectors[0], axis=1).max() / scale) if scale > 0.0 else 0.0
