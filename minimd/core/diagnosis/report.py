"""The conservation report: what should have stayed constant, and whether it did."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from minimd.core.console.display import NAME_WIDTH, Displayed, Rows
from minimd.core.engine.record import SERIES, Record
from minimd.core.structure import statistics
from minimd.core.structure.arrays import Array
from minimd.core.structure.statistics import (
    FEW,
    block_means,
    correlation_times,
    independent,
    mean_and_error,
    short_run,
    with_error,
)

DAY = 86400.0  # seconds
BLOCKS = 40  # averages of the total energy between which the drift is fitted
BLOCKS_OF_WALK = 20  # the same for a series that wanders like a random walk
SIGNIFICANT = 3.0  # standard errors, if these are well known: chance exceeds them 3 times in 1000
# standard errors, if these are poorly known: no fluctuation looks so straight
MOST_SIGNIFICANT = 6.0
INDEPENDENT = 4.0  # entries: with fewer, a series is too short to judge
LARGEST_RANGE = 0.5  # of the kinetic energy
RANGE_OF_ROUNDING = 1e-11  # of the potential energy
NEGLIGIBLE_DRIFT = 1e-6  # of the kinetic energy, in each ps or τ
# of the potential energy: a smaller kinetic energy comes from rounding of the forces, and is of its square
AT_REST = 1e-20
QUIET = 0.01  # of the kinetic energy, by which the energy of a short run may vary
# of Σ|mv|, change of the total momentum that rounding explains in 10⁴ steps; it grows as √steps
MOMENTUM_KEPT = 1e-13
# of Σ m|r||v|, likewise of the angular momentum, whose terms are larger
ANGULAR_MOMENTUM_KEPT = 1e-12
# likewise where momentum is exactly constant: displacements are rounded to some 2⁻⁴⁰ of the scene
KEPT_ON_A_GRID = 1e-9
# of the temperature: a change between the first and the last fifth of a run that fluctuations seldom explain
SETTLING = 0.1
SWELLING = 0.05  # of the volume, likewise
# of |r² − d²|/d²: a rigid length is then off by 5e-9 of itself, far below the thermal motion of any bond
LENGTHS_KEPT = 1e-8

FAR_FROM_PRESSURE = "the barostat is far from its pressure; equilibrate first"
KEPT = {True: "conserved", False: "NOT CONSERVED"}
DRIFTS = {None: "too short to judge", True: "none", False: "IT DRIFTS"}


@dataclass(frozen=True)
class Line:
    """The result of one check.
    name : at most 14 letters.
    summary : with figures.
    verdict : in words.
    is_good : whether it is as it should be.
    misses_pressure : whether it says that the volume still changes, or that the mean pressure is not that of the
        barostat.
    is_rough : whether it says that an energy or a force jumps at a cutoff."""

    name: str
    summary: str
    verdict: str
    is_good: bool
    misses_pressure: bool = False
    is_rough: bool = False

    def __str__(self) -> str:
        return f"{self.name:<14} {self.summary}: {self.verdict}"


@dataclass(frozen=True)
class DriftRate:
    """Slope of a straight line through block averages [per time], and its standard error.

    With fewer than four blocks, the error is infinite and the slope is that between the ends.
    n_independent : how many independent averages would leave this error.  is_unsure :
        whether they are too few to rule a drift out."""

    slope: float
    error: float
    n_independent: float = np.inf
    is_unsure: bool = False

    def __str__(self) -> str:
        error = "" if np.isinf(self.error) else f" ± {self.error:.1e}"
        return f"{self.slope:+.2e}{error}"

    @property
    def most(self) -> float:
        """Standard errors that chance exceeds 3 times in 1000: three, or up to six (Student's t) if fluctuations last
        long compared with the run."""
        if np.isinf(self.n_independent):
            return SIGNIFICANT
        from scipy.special import ndtr, stdtrit  # takes its time to load

        largest = stdtrit(max(1.0, self.n_independent - 2.0), ndtr(SIGNIFICANT))
        return min(MOST_SIGNIFICANT, float(largest))

    @property
    def is_significant(self) -> bool:
        """True if the slope is beyond what chance makes of it, or if it is not a number."""
        return not abs(self.slope) <= self.most * self.error

    @property
    def is_too_short(self) -> bool:
        """True if fluctuations last so long, compared with the run, that they cannot be told from a drift."""
        return self.is_unsure and not self.is_significant


def drift(
    time: Array, series: Array, blocks: int = BLOCKS, beside: Array | None = None
) -> DriftRate:
    """Least-squares slope of a series, with the standard error that follows from its correlated fluctuations.

        error² = σ² / ((n − 2) Var t),   n = blocks (1 − ρ)/(1 + ρ)

    Averages over blocks scatter by σ about the line, and each resembles the next by ρ, the correlation of neighbors: n
    of them are independent. A short series makes ρ too small by (2 + 4ρ)/blocks, since the line follows it;
    this is corrected.
    time, series : (T,). NaN if one of them is not finite.
    beside : (T,) another series of the same run, whose n is taken if it is smaller. The energy error depends on
        the state, whose slow changes show in the kinetic energy, while in the total energy faster ones hide them.

    H. Flyvbjerg, H. G. Petersen, J. Chem. Phys. 91, 461 (1989), on blocks; M. G. Kendall, Biometrika 41, 403 (1954),
    on the bias of ρ."""
    blocks = min(blocks, len(series))
    if not np.isfinite([time, series]).all():
        return DriftRate(np.nan, np.nan)
    duration = np.ptp(time)
    if blocks < FEW or duration == 0.0:
        slope = (series[-1] - series[0]) / duration if duration > 0.0 else 0.0
        return DriftRate(float(slope), np.inf)
    t = block_means(time, blocks)
    slope, rest = _line(t, block_means(series, blocks))
    variance = rest @ rest / blocks

    def rate(n: float) -> DriftRate:
        return DriftRate(slope, float(np.sqrt(variance / max(1.0, n - 2.0) / t.var())), n)

    own = independent(rest)
    least = own
    if beside is not None:
        least = min(own, independent(_line(t, block_means(beside, blocks))[1]))
    is_unsure = own < INDEPENDENT or rate(own).is_significant
    return replace(rate(least), is_unsure=is_unsure)


def _line(t: Array, y: Array) -> tuple[float, Array]:
    """Slope of the line through points, and their distances from it."""
    slope, at_zero = np.polyfit(t, y, 1)
    return float(slope), y - slope * t - at_zero


def drift_of_walk(time: Array, series: Array, blocks: int = BLOCKS_OF_WALK) -> DriftRate:
    """Slope of a series that is the sum of a drift, a random walk and fluctuations,
    and the standard error of the slope.

    Total energy minus reservoir energy is such a series. A method conserves a shadow Hamiltonian, which differs from
    the energy, and each contact with the bath changes the difference at random. The slope is that between the means of
    the first and of the last block. Its error is that of the mean change from block to block,
    which is known as well as that of half as many independent changes."""
    blocks = min(blocks, len(series))
    if blocks <= FEW or np.ptp(time) == 0.0 or not np.isfinite([time, series]).all():
        return drift(time, series, blocks)
    t = block_means(time, blocks)
    y = block_means(series, blocks)
    steps = np.diff(y)
    rate = (blocks - 1.0) / np.ptp(t)
    error = float(statistics.standard_error(steps, statistics.wandering)) * rate
    return DriftRate(float(steps.mean() * rate), error, blocks / 2.0)


@dataclass(frozen=True)
class Cost:
    """What a run cost: atoms, steps, seconds, list builds, force evaluations (not those that only observations need, of
    a method that begins with a drift); and in words its lists, its constraints and the work it did not need.
    seconds : of wall time, of the steps alone.
    peak_memory : bytes that the process has held at most so far, or None if that is unknown.
    observing : seconds that observers of minimd.observers took besides those of the steps.
    nanoseconds : of the run [ns]; 0 in reduced units."""

    n_atoms: int
    n_steps: int
    seconds: float
    list_builds: int
    n_evaluations: int
    pair_search: str
    skipped: list[str]
    constraints: str = ""
    peak_memory: int | None = None
    observing: float = 0.0
    nanoseconds: float = 0.0

    def rows(self) -> Rows:
        """Rows of a report."""
        speed = "no steps"
        if self.seconds > 0.0:
            speed = f"{1e-6 * self.n_atoms * self.n_steps / self.seconds:.4g} Matom-steps/s"
            if self.nanoseconds > 0.0:
                speed += f", {DAY * self.nanoseconds / self.seconds:.4g} ns/day"
        work = f"{self.n_evaluations} force evaluations, {self.pair_search}, built {self.list_builds} times"
        rows = [("speed", f"{speed}; {work}")]
        if self.observing > 0.0:
            share = self.observing / (self.seconds + self.observing)
            rows.append(("observers", f"took {100.0 * share:.2g} % of the time"))
        if self.constraints:
            rows.append(("constraints", self.constraints))
        if self.peak_memory is not None:
            held = f"{self.peak_memory / 1e6:.4g} MB at most so far, of the whole process"
            rows.append(("memory", held))
        if self.skipped:
            unused = (
                f"{', '.join(self.skipped)}: this scene does not need them, and they take no time"
            )
            rows.append(("unused", unused))
        return rows


@dataclass(frozen=True)
class Report(Displayed):
    """What a run conserved, and what it cost. str() gives the report as text.

    Attributes
    ----------
    energy_drift : Drift of the total energy per atom [energy/time], minus reservoir energy if has_bath; time in ps,
        or τ in reduced units.
    energy_oscillation : standard deviation of the total energy per atom about that line [energy].
    momentum_change : largest |P(t) − P(0)| / Σ|mv|, or None if P is not a constant.
    angular_momentum_change : largest |L(t) − L(0)| / Σ m|r − r_cm||v|, or None if L is not a constant.
    constraint_violation : largest |r² − d²|/d², or None without constraints.
    mean_temperature, temperature_deviation : mean and standard deviation of the kinetic temperature.
        temperature_error : standard error of the mean.
    duration : [ps or τ].
    n_frames : number of observations.
    n_steps : from the first to the last.
    cost : of the run, if known.
    kinetic_energy : mean per atom [energy]: ½ n_dof k_B T / N, without a motion of the center of mass if n_dof is.
    energy_range : largest difference of two total energies per atom beyond rounding [energy].
    shadow_drift, shadow_oscillation : the same for the shadow energy; None and 0 if it was not recorded.
    temperatures : means of the first and of the last fifth of the run.
    not_finite : the first observable with an entry that is NaN or infinite, and its step, in words; empty if none has.
    lines : results that need no run: see diagnosis.run_report.
    bath : temperature of the thermostat, and how far below it the time step keeps that of the velocities (NaN if that
    is unknown); None without a thermostat.
    too_long_a_step : a clause, if the time step of the run is too long; empty if it is not, or if that is unknown.
    changed : a clause, if thermostat or barostat were set to something else during the run; empty if they were not.
    uncounted : a clause, if a force does work that is not known; empty if none does.
    is_smooth : whether no energy and no force is known to jump at a cutoff; False if that is unknown.
    is_at_rest : whether nothing moves except by rounding; changes of momentum then have no scale to be judged by.
    """

    energy_drift: DriftRate
    energy_oscillation: float
    momentum_change: float | None
    angular_momentum_change: float | None
    mean_temperature: float
    temperature_deviation: float
    duration: float
    kinetic_energy: float
    n_frames: int
    n_steps: int
    units: tuple[str, str, str]
    has_bath: bool = False
    has_work: bool = False
    constraint_violation: float | None = None
    cost: Cost | None = None
    shadow_drift: DriftRate | None = None
    shadow_oscillation: float = 0.0
    lines: tuple[Line, ...] = ()
    energy_range: float = 0.0
    temperatures: tuple[float, float] = (0.0, 0.0)
    not_finite: str = ""
    temperature_error: float = np.nan
    is_at_rest: bool = False
    bath: tuple[float, float] | None = None
    too_long_a_step: str = ""
    changed: str = ""
    uncounted: str = ""
    is_smooth: bool = False

    @property
    def energy_is_conserved(self) -> bool | None:
        """True if the drift is zero within its error, or below 1e-6 of the kinetic energy in each ps or τ;
        None if the run is too short to tell, or if the work of a force is not known. A run whose baths were changed is
        never True, because the error of the energy depends on the temperature: None unless it drifts and varies by more
        than a hundredth of the kinetic energy.

        An energy that varies by more than half the kinetic energy is not conserved, whatever its drift: one bad step is
        no drift. Nothing is conserved if an observable is not finite."""
        if self.uncounted and not self.not_finite:
            return None
        if self.not_finite or self._varies_too_much:
            return False
        has_no_drift = self._has_no(self.energy_drift)
        if self.changed and (has_no_drift or self._varies_little):
            return None
        return has_no_drift

    @property
    def _varies_little(self) -> bool:
        return self.energy_range < QUIET * self.kinetic_energy

    @property
    def _varies_too_much(self) -> bool:
        return not self.has_bath and self.energy_range > LARGEST_RANGE * self.kinetic_energy

    @property
    def shadow_is_conserved(self) -> bool | None:
        """Whether the shadow energy has no drift, likewise; None if it was not recorded, or in too few frames."""
        if self.shadow_drift is None:
            return None
        return self._has_no(self.shadow_drift) and not self.not_finite

    def _has_no(self, drift: DriftRate) -> bool | None:
        if self.n_frames < FEW:
            return None
        if not np.isfinite([drift.slope, drift.error, self.kinetic_energy]).all():
            return False
        slope = abs(drift.slope)
        negligible = NEGLIGIBLE_DRIFT * self.kinetic_energy
        if slope + SIGNIFICANT * drift.error < negligible:
            return True
        if drift.is_too_short:
            return None
        return not drift.is_significant or slope < negligible

    def _about_error(self, drift: DriftRate) -> str:
        """What the error of a drift is, and why one of more than three of them is none, in parentheses; empty if it is
        unknown."""
        if np.isinf(drift.error):
            return ""
        words = "standard error"
        if abs(drift.slope) > SIGNIFICANT * drift.error and self._has_no(drift):
            reason = f"in so short a run chance makes up to {drift.most:.2g} of them"
            if drift.is_significant:
                reason = f"below {NEGLIGIBLE_DRIFT:g} of the kinetic energy per {self.units[1]}, which counts as none"
            words = f"{words}; {reason}"
        return f" ({words})"

    @property
    def momentum_is_conserved(self) -> bool:
        """True if rounding, which adds up like a random walk, explains the change, or if it need not be constant."""
        return self._is_rounding(self.momentum_change, MOMENTUM_KEPT)

    @property
    def angular_momentum_is_conserved(self) -> bool:
        """Likewise."""
        kept = ANGULAR_MOMENTUM_KEPT if self.momentum_change else KEPT_ON_A_GRID
        return self._is_rounding(self.angular_momentum_change, kept)

    def _is_rounding(self, change: float | None, kept: float) -> bool:
        most = kept * max(1.0, (self.n_steps / 1e4) ** 0.5)
        return not self.not_finite and (self.is_at_rest or (change or 0.0) < most)

    @property
    def is_settling(self) -> bool:
        """Whether the temperature of the first and of the last fifth of the run differ much, as before equilibrium."""
        return _differ(self.temperatures, SETTLING)

    @property
    def is_far_from_pressure(self) -> bool:
        """Whether a barostat still changes the volume much, or the mean pressure is not the one wanted."""
        return any(line.misses_pressure for line in self.lines)

    @property
    def is_quiet(self) -> bool:
        """Whether the energy stays within a hundredth of the kinetic energy, in a run that cannot tell a drift."""
        is_open = self.energy_is_conserved is None and self.n_frames >= FEW
        return is_open and self._varies_little

    def __str__(self) -> str:
        return "\n".join(f"{name:<{NAME_WIDTH}} {text}" for name, text in self.display_rows())

    def display_rows(self) -> Rows:
        """See Displayed."""
        energy, time, _ = self.units
        per = f"{energy} per atom"
        has_one_frame = self.n_frames == 1
        minus = " - reservoir" * self.has_bath + " - work" * self.has_work
        change = f"drift {self.energy_drift} {per} per {time}{self._about_error(self.energy_drift)}"
        rows = [
            (
                f"E{minus}" if minus else "total energy",
                "drift unknown: one frame" if has_one_frame else change,
            ),
            ("", f"oscillation {self.energy_oscillation:.2e} {per} (standard deviation)"),
        ]
        if self.shadow_drift is not None:
            verdict = DRIFTS[self.shadow_is_conserved]
            change = f"drift {self.shadow_drift} {per} per {time}{self._about_error(self.shadow_drift)}: {verdict}"
            rows.append(("shadow energy", change))
            rows.append(("", f"oscillation {self.shadow_oscillation:.2e} {per}"))
        if self.momentum_change is not None:
            change = "exactly constant"
            if self.is_at_rest:
                change = "no motion but rounding: the atoms are at rest"
            elif self.momentum_change:
                kept = KEPT[self.momentum_is_conserved]
                change = f"change {self.momentum_change:.1e} of the sum of |mv|: {kept}"
            rows.append(("momentum", change))
        if self.angular_momentum_change is not None and not self.is_at_rest:
            kept = KEPT[self.angular_momentum_is_conserved]
            change = f"change {self.angular_momentum_change:.1e} of the sum of m|r||v|: {kept}"
            rows.append(("ang. momentum", change))
        if self.constraint_violation is not None:
            kept = "kept" if self.constraint_violation < LENGTHS_KEPT else "NOT KEPT"
            violation = f"kept to {self.constraint_violation:.1e} (|r² − d²|/d²): {kept}"
            rows.append(("lengths", violation))
        rows += [(line.name, f"{line.summary}: {line.verdict}") for line in self.lines]
        rows += self._temperature_rows
        if self.cost is not None:
            rows += self.cost.rows()
        return [*rows, ("verdict", self.verdict)]

    @property
    def _temperature_rows(self) -> Rows:
        """The mean temperature, or, of a ramp, that of its ends, and what was asked of the thermostat."""
        heat = self.units[2]
        error = self.temperature_error
        mean = f"{with_error(self.mean_temperature, error)} {heat}"
        spread = f"on average, standard deviation {self.temperature_deviation:.2g} {heat}"
        rows = [("temperature", f"{mean} {'of one frame' if self.n_frames == 1 else spread}")]
        times = float(correlation_times(self.temperature_deviation**2, error))
        short = short_run(times, "temperature")
        if self.changed and self.is_settling:
            first, last = self.temperatures
            ends = (
                f"{first:.4g} {heat} in the first fifth of the run, {last:.4g} {heat} in the last"
            )
            rows = [("temperature", ends)]
        elif short:
            rows.append(("", short))
        if self.bath is not None:
            asked, deficit = self.bath
            setting = f"{asked:.4g} {heat} is asked of the thermostat"
            distance = abs(self.mean_temperature - asked + deficit)
            is_far = error > 0.0 and distance > SIGNIFICANT * error
            if self.changed:
                setting += f" at the end; {self.changed}"
            elif deficit > error:
                expected = f"{asked - deficit:.4g} {heat} is expected of them"
                setting += (
                    f"; the time step makes velocities too slow: {expected}, positions have what is asked "
                    "(docs/temperature.md, which temperature?)"
                )
            if is_far and not (self.changed or self.is_at_rest):
                setting += (
                    f"; THE MEAN IS {distance / error:.2g} STANDARD ERRORS FROM IT: not settled, heated by "
                    "work or a flow, or so short a run that its error bar is itself uncertain"
                )
            rows.append(("", setting))
        return rows

    @property
    def verdict(self) -> str:
        """One sentence."""
        if self.not_finite:
            return f"NOTHING IS CONSERVED: {self.not_finite}"
        if self.n_frames < FEW:
            are = "frames are" if self.n_frames > 1 else "frame is"
            few = f"{self.n_frames} {are} too few to judge the energy; run longer, or with a smaller every"
            return f"{few}{self._and_the_step}"
        momentum = "THE TOTAL MOMENTUM CHANGES: a force is not pairwise."
        if self.is_at_rest:
            momentum = "the atoms are at rest: set_temperature gives them velocities."
        elif self.momentum_change is None:
            momentum = "the total momentum is not a constant of this run."
        elif self.momentum_is_conserved:
            momentum = f"momentum is {'conserved to rounding' if self.momentum_change else 'exactly constant'}."
        is_to_be_told = self.is_far_from_pressure and self.energy_is_conserved is not False
        far = f" BUT {FAR_FROM_PRESSURE}." if is_to_be_told else ""
        return f"{self._energy_verdict}; {momentum}{far}"

    @property
    def _change(self) -> str:
        return f"{self.changed}, and with it the energy, or its error (with half the time step a quarter of it)"

    @property
    def _and_the_step(self) -> str:
        return f"; AND {self.too_long_a_step}" if self.too_long_a_step else ""

    @property
    def _energy_verdict(self) -> str:
        taken = " and ".join(["reservoir energy"] * self.has_bath + ["work"] * self.has_work)
        name = f"total energy minus {taken}" if taken else "total energy"
        if self.energy_is_conserved is None:
            varies = "varies"
            if self.is_quiet:
                share = self.energy_range / self.kinetic_energy
                varies = f"varies by {100.0 * share:.1g} % of the kinetic energy"
            if self.changed or self.uncounted:
                why = self.uncounted or self._change
                return f"the {name} {varies}; whether it drifts cannot be told: {why}"
            return (
                f"the {name} {varies}; the run is too short to tell whether it drifts: "
                f"its fluctuations last nearly as long as the run{self._and_the_step}"
            )
        cause = self.too_long_a_step
        if self.energy_is_conserved:
            return f"the {name} {f'does not drift, BUT {cause}' if cause else 'is conserved'}"
        if self._varies_too_much and self._has_no(self.energy_drift) is not False:
            times = f"BY {self.energy_range / self.kinetic_energy:.2g} TIMES THE KINETIC ENERGY"
            near = "it oscillates near the limit of stability, or has jumped; reduce the time step"
            return f"THE {name.upper()} VARIES {times}, without a drift: {cause or near}"
        causes = [cause] if cause else []
        if self.changed:
            causes.append(self._change)
        elif self.is_settling:
            first, last = self.temperatures
            causes.append(
                f"the temperature went from {first:.3g} to {last:.3g} {self.units[2]}, "
                "and with it the error of the energy; equilibrate first"
            )
        if self.is_far_from_pressure:
            causes.append(FAR_FROM_PRESSURE)
        cure = "reduce the time step"
        if not self.is_smooth:
            cure += " or smooth the cutoff"
        return f"THE {name.upper()} DRIFTS: {'; '.join(causes) or cure}"


def _differ(ends: tuple[float, float], share: float) -> bool:
    return abs(ends[1] - ends[0]) > share * max(ends)


@np.errstate(all="ignore")  # the report says what is not finite
def conservation_report(
    record: Record,
    angular: bool,
    cost: Cost | None = None,
    linear: bool = True,
    lines: Sequence[Line] = (),
    n_dof: int | None = None,
    too_long_a_step: str = "",
) -> Report:
    """The report of a record.
    linear, angular : whether momentum is constant (see Engine.conserves_momentum), and angular momentum, too (then
        nothing is periodic).
    lines, cost, too_long_a_step : see Report.
    n_dof : degrees of freedom of the run; if not given, the kinetic energy includes a motion of the center of mass.
    With a thermostat or barostat, total energy minus reservoir energy is judged; with forces that depend on time, the
    total energy and the shadow energy minus their work."""
    units = record.units
    has_bath = "conserved_energy" in record
    has_work = "work" in record
    n = record.n_atoms
    heat = record.temperature
    thermal = record.kinetic_energy if n_dof is None else 0.5 * n_dof * units.k_B * heat
    time = record.time * units.to_picosecond
    work = record.work if has_work else 0.0
    energy, slope = conserved_energy(record)
    shadow = None
    shadow_oscillation = 0.0
    if "shadow_energy" in record:
        series = (record.shadow_energy - work) / n
        shadow = drift(time, series, beside=record.kinetic_energy)
        shadow_oscillation = _oscillation(time, series, shadow)
    violation = None
    if "constraint_violation" in record:
        violation = float(record.constraint_violation.max())
    potential = np.abs(record.potential_energy)
    energy_range = float(np.ptp(energy) - RANGE_OF_ROUNDING * (potential / n).max())
    angular_momentum = (record.angular_momentum, record.absolute_angular_momentum)
    return Report(
        energy_drift=slope,
        energy_oscillation=_oscillation(time, energy, slope),
        momentum_change=_largest_change(record.momentum, record.absolute_momentum, linear),
        angular_momentum_change=_largest_change(*angular_momentum, angular),
        mean_temperature=float(heat.mean()),
        temperature_deviation=float(heat.std()),
        duration=float(np.ptp(time)),
        kinetic_energy=float(thermal.mean()) / n,
        n_frames=len(time),
        n_steps=int(record.step[-1] - record.step[0]),
        units=(units.energy, units.shown_time, units.temperature),
        has_bath=has_bath,
        has_work=has_work,
        constraint_violation=violation,
        cost=cost,
        shadow_drift=shadow,
        shadow_oscillation=shadow_oscillation,
        lines=tuple(lines),
        energy_range=max(0.0, energy_range),
        temperatures=_ends(heat),
        not_finite=_not_finite(record),
        temperature_error=mean_and_error(heat)[1],
        is_at_rest=bool(record.kinetic_energy.max() <= AT_REST * potential.max()),
        too_long_a_step=too_long_a_step,
    )


def conserved_energy(record: Record) -> tuple[Array, DriftRate]:
    """The energy per atom that should be constant, (T,) [energy], and its drift in units of reports.
    See conservation_report."""
    time = record.time * record.units.to_picosecond
    if "conserved_energy" in record:
        energy = record.conserved_energy / record.n_atoms
        return energy, drift_of_walk(time, energy)
    work = record.work if "work" in record else 0.0
    energy = (record.total_energy - work) / record.n_atoms
    return energy, drift(time, energy, beside=record.kinetic_energy)


def _not_finite(record: Record) -> str:
    """The first observable with an entry that is NaN or infinite, and its step, in words; empty if there is none."""
    for name in ("time", *SERIES):
        if name in record:
            values = np.asarray(getattr(record, name)).reshape(len(record), -1)
            is_finite = np.isfinite(values).all(axis=1)
            if not is_finite.all():
                step = record.step[np.argmin(is_finite)]
                return f"{name.replace('_', ' ')} is not finite at step {step}"
    return ""


def _ends(series: Array) -> tuple[float, float]:
    """Means of the first and of the last fifth."""
    fifth = max(1, len(series) // 5)
    return float(series[:fifth].mean()), float(series[-fifth:].mean())


def swelling(volume: Array) -> float:
    """The change of a volume, (T,), from the first to the last fifth of a run, as a fraction; 0 if it is at most
    SWELLING, or if fluctuations explain it.

    They do if the means of the first fifth and of the second half differ by at most three standard errors, and those of
    the last fifth and of the first half. If e is the error of the half, that of the difference is √(1 + 5/2) e: the
    error of a mean falls as the root of the length of the run."""
    first, last = _ends(volume)
    change = last / first - 1.0
    if not _differ((first, last), SWELLING):
        return 0.0
    half = len(volume) // 2
    for fifth, rest in ((first, volume[half:]), (last, volume[:half])):
        mean, error = mean_and_error(rest)
        if abs(fifth - mean) > SIGNIFICANT * 3.5**0.5 * error:
            return change
    return 0.0


def _oscillation(time: Array, series: Array, slope: DriftRate) -> float:
    """Standard deviation about a line."""
    return float((series - series.mean() - slope.slope * (time - time.mean())).std())


def _largest_change(vectors: Array, scales: Array, is_constant: bool) -> float | None:
    """max |v(t) − v(0)| over the largest scale; 0 if there is no scale, because nothing moves; None if not constant."""
    if not is_constant:
        return None
    scale = scales.max()
    return float(np.linalg.norm(vectors - vectors[0], axis=1).max() / scale) if scale > 0.0 else 0.0
