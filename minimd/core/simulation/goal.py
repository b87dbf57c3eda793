"""When a run has seen enough: means that are as precise as was asked, or a state that has forgotten its start.

An estimate of an error that ends a run when it happens to be small is too small. So a run ends by an estimate from all
lags of a series, which hardly fluctuates, and is made larger by twice its own relative variance: see windowed_error.
P. W. Glynn, W. Whitt, Ann. Appl. Probab. 2, 180 (1992), on means at such times; J. D. Chodera, J. Chem. Theory Comput.
12, 1799 (2016), on the equilibration.
"""

import sys
from collections.abc import Mapping, Sequence
from math import ceil, exp, hypot, inf, log, nan, sqrt
from time import monotonic
from typing import Any, NamedTuple

import numpy as np

from minimd.core.console.display import Displayed, Rows
from minimd.core.console.quiet import warn
from minimd.core.console.words import shown
from minimd.core.engine.observer import StoredObserver
from minimd.core.engine.record import Record
from minimd.core.structure.arrays import Array
from minimd.core.structure.checks import checked_number
from minimd.core.structure.statistics import windowed_error, with_error

EQUILIBRATED = "equilibrated"
FIRST = 100  # looks before the first judgment
GROWTH = 1.1  # of the run from one judgment to the next, at least; and TWICE at most
TWICE = 2.0
INDEPENDENT = 50.0  # looks that a run must have
# parts of the run that is allowed, after which it is told that this will not do: where the length is known, and not
EARLY, MIDDLE = 0.1, 0.5
LAST_PART = 2.0 / 3.0  # of the looks at an equilibration, which must be equilibrated
STARTS = 20  # places where equilibration may have ended, that are compared
UNLIMITED = 10**15


class Progress(NamedTuple):
    """What is known of one quantity.
    mean, error : so far.
    needed : looks that the run will need."""

    mean: float
    error: float
    needed: float


class Goal(Displayed):
    """What a run is to reach, see Simulation.run.

    until : relative errors by names of observables, or of numbers of results; or "equilibrated".
    known : Progress by name, of the last judgment.
    is_reached : whether the run has reached it.
    equilibrated_from : the step from which the state was judged to be equilibrated, or None.

    Raises TypeError, ValueError for anything else, or a relative error that is not positive.
    """

    def __init__(self, until: Any, observers: Sequence[StoredObserver], max_seconds: float) -> None:
        self.until: dict[str, float] = {}
        if until != EQUILIBRATED:
            if not isinstance(until, Mapping) or not until:
                raise TypeError(
                    "until must be relative errors of means by their names, such as {'pressure': 0.01}, or "
                    f"'equilibrated'; until = {shown(until)}"
                )
            for name, error in until.items():
                self.until[name] = checked_number(f"until[{name!r}]", error, "positive and finite")
        self.known: dict[str, Progress] = {}
        self.is_reached = False
        self.equilibrated_from: int | None = None
        self._observers = observers
        self._seconds = max_seconds
        self._began = monotonic()
        self._due = FIRST
        self._is_told = False
        self._logs: dict[str, tuple[float, float]] = {}

    def check(self, observables: Mapping[str, Any]) -> None:
        """Raise ValueError for a name that is none of an observable, nor of a number of a result; numbers of observers
        that do not say before their first look what they have are checked later."""
        names = [name for name, value in observables.items() if np.ndim(value) == 0]
        numbers = [_numbers_of(observer) for observer in self._observers]
        if not all(numbers):
            return
        self._refuse_other_than([*names, *(name for each in numbers for name in each)])

    def _refuse_other_than(self, names: Sequence[str]) -> None:
        for name in self.until:
            if name not in names:
                raise ValueError(
                    "until must name an observable, or a number with an error of an observer's result: "
                    f"{', '.join(names)}; it names {name!r}"
                )

    def judge(self, record: Record, first: int, end: int) -> int | None:
        """Judge a run after a look; returns the step at which it is expected to end, or None as long as that is not
        known, or was told before.
        first, end : step of its first look; the last one that is allowed."""
        n = len(record)
        if n < self._due:
            return None
        if self.until:
            self.known = {
                name: self._progress(name, error, record) for name, error in self.until.items()
            }
            needed = max(each.needed for each in self.known.values())
            self.is_reached = needed <= n
        else:
            needed = self._equilibration(record)
        likely = needed if np.isfinite(needed) else inf
        self._due = ceil(min(TWICE * n, max(GROWTH * n, likely)))
        expected = first + (record.step[-1] - first) * max(1.0, likely / n)
        self._warn(expected, first, int(record.step[-1]), end)
        return int(expected) if expected < end else None

    def _progress(self, name: str, wanted: float, record: Record) -> Progress:
        """Of a quantity: the error that a mean has now, and the looks that it will need."""
        n = len(record)
        if name in record.names[2:]:
            series = getattr(record, name)
            mean = float(series.mean())
            error, independent, v = windowed_error(series)
            if independent < INDEPENDENT:
                return Progress(mean, error, inf)
            if error == 0.0 or mean == 0.0:
                return Progress(mean, error, n if error == 0.0 else inf)
            # N of g s²/N (1 + 2 v n/N) = (wanted · mean)²
            plain = n * (error / (wanted * mean)) ** 2 / (1.0 + 2.0 * v)
            return Progress(mean, error, 0.5 * (plain + sqrt(plain**2 + 8.0 * v * n * plain)))
        numbers = self._numbers()
        self._refuse_other_than([*record.names[2:], *_with_errors(numbers)])
        mean = float(numbers[name])
        error = float(numbers[f"{name}_error"])
        if not error > 0.0 or not np.isfinite(mean):
            return Progress(mean, error, inf)
        # errors from few blocks: a mean over the run, later ones count more
        weight, total = self._logs.get(name, (0.0, 0.0))
        weight += n
        total += n * log(n * (error / (wanted * abs(mean))) ** 2)
        self._logs[name] = weight, total
        return Progress(mean, error, exp(total / weight))

    def _numbers(self) -> dict[str, float]:
        """The single numbers of all results that there are."""
        numbers: dict[str, float] = {}
        for observer in self._observers:
            try:
                numbers.update(observer.result().numbers())  # type: ignore[attr-defined]
            except ValueError:  # it has not looked yet
                continue
        return numbers

    def _equilibration(self, record: Record) -> float:
        """The looks that the run needs, infinite if that is not known.

        A start of the series is left out so that as many independent looks as possible are left; they must be
        INDEPENDENT, in the LAST_PART of the run, and the means of both halves agree."""
        n = len(record)
        needed = float(n)
        start = 0
        for name in ("potential_energy", "kinetic_energy", "volume"):
            if name not in record:
                continue
            series: Array = getattr(record, name)
            if np.ptp(series) == 0.0:
                continue
            starts = np.linspace(0, n // 2, STARTS).astype(int)
            counts = [windowed_error(series[k:])[1] for k in starts]
            best = int(starts[np.argmax(counts)])
            halves = np.array_split(series[best:], 2)
            errors = [windowed_error(half)[0] for half in halves]
            apart = abs(halves[0].mean() - halves[1].mean())
            is_flat = apart <= 2.0 * hypot(*errors)
            start = max(start, best)
            if max(counts) < INDEPENDENT or not is_flat or n - best < LAST_PART * n:
                needed = inf
        self.is_reached = needed <= n
        if self.is_reached:
            self.equilibrated_from = int(record.step[start])
        return needed

    def _warn(self, expected: float, first: int, step: int, end: int) -> None:
        """Say once, after a tenth of what is allowed, that it will not do."""
        part = (step - first) / (end - first)
        seconds = monotonic() - self._began
        early = EARLY if np.isfinite(expected) else MIDDLE
        if self._is_told or max(part, seconds / self._seconds) < early or self.is_reached:
            return
        self._is_told = True
        rate = seconds / max(1, step - first)
        likely = rate * (expected - first)
        if expected <= end and likely <= self._seconds:
            return
        limit = (
            f"max_steps = {end - first}" if expected > end else f"max_seconds = {self._seconds:g}"
        )
        length = (
            f"some {expected - first:.2g} steps"
            if np.isfinite(expected)
            else "more steps than can be told yet"
        )
        reached = ", ".join(self._told()) or "not equilibrated yet"
        warn(
            f"this run needs {length} to reach its goal, more than {limit} allows; so far {reached}"
        )

    def _told(self) -> list[str]:
        return [
            f"{name} {with_error(each.mean, each.error)}, {_part(each):.2g} of it, {self.until[name]:g} asked"
            for name, each in self.known.items()
        ]

    def display_rows(self) -> Rows:
        """See Displayed."""
        verdict = "reached" if self.is_reached else "not reached"
        if not self.until:
            since = (
                "" if self.equilibrated_from is None else f", from step {self.equilibrated_from}"
            )
            return [("until", f"equilibrated: {verdict}{since}")]
        return [("until", verdict), *(("mean", told) for told in self._told())]

    def __repr__(self) -> str:
        return f"Goal({self.until or EQUILIBRATED!r}, {'reached' if self.is_reached else 'not reached'})"


def _with_errors(numbers: Sequence[str] | Mapping[str, Any]) -> list[str]:
    return [name for name in numbers if f"{name}_error" in numbers]


def _numbers_of(observer: StoredObserver) -> list[str]:
    """The numbers with an error that the results of an observer have; empty if its class does not say."""
    kind = type(observer).result.__annotations__.get("return")  # type: ignore[attr-defined]
    result = getattr(sys.modules[type(observer).__module__], str(kind), None)
    return _with_errors(getattr(result, "coefficients", ()))


def _part(progress: Progress) -> float:
    return progress.error / abs(progress.mean) if progress.mean else nan
