"""The contents of a grade: findings with a tick, a cross or a question mark, the faults in words, and a verdict."""

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from fractions import Fraction
from math import isfinite, isnan, log, nan
from typing import Any, NamedTuple

from minimd.core.console.display import Displayed, Rows

TICKS = {True: "✓", False: "✗", None: "?"}
EXACT = 2e-6  # coefficients that differ by less are equal
DENOMINATOR = 24  # the largest denominator in their fractions


@dataclass(frozen=True)
class Finding:
    """One law that was tested.

    Attributes
    ----------
    name : of the law.
    passed : True, False, or None if the reader has to judge.
    words : what was measured.
    value : the measured number, dimensionless unless the words give a unit; NaN if there is none.
    limit : the largest difference of value from 1 that passes, for laws of dynamics; else NaN.
    is_open : whether the runs were too short, or too few, to tell.
    cause : what is wrong in general if the law does not hold.
    """

    name: str
    passed: bool | None
    words: str
    value: float = nan
    cause: str = ""
    limit: float = nan
    is_open: bool = False


class Measurement(NamedTuple):
    """What was measured for a law.

    value : the number.
    off : how far it is off.
    said : what is wrong.
    error : of the number, statistical.
    limit : the largest difference from 1 that passes.
    allowed : what of the limit is no error of statistics, in words.
    is_open : whether the runs were too short, or too few, to tell.
    """

    value: float
    off: float
    said: str = ""
    error: float = nan
    limit: float = nan
    allowed: str = ""
    is_open: bool = False


Answer = tuple[Any, ...]  # a number, how far it is off, and what else the words of a law need


class Law(NamedTuple):
    """One law.

    measure : of what is judged; a number, or an Answer.
    bound : the law holds if the number is off by less; if that is NaN, the reader has to judge.
    words, cause : formats of a Finding.
    needs : what must be there.
    """

    name: str
    measure: Callable[[Any], Any]
    bound: float
    words: str
    cause: str = ""
    needs: str = ""

    def finding(self, answer: Any) -> Finding:
        """The finding from what was measured."""
        numbers = answer if isinstance(answer, tuple) else (answer, answer)
        value, off = numbers[:2]
        passed = None if isnan(off) else bool(abs(off) < self.bound)
        words = self.words.format(*numbers)
        cause = self.cause.format(*numbers)
        limit = getattr(numbers, "limit", nan)
        is_open = passed is None and getattr(numbers, "is_open", False)
        return Finding(self.name, passed, words, float(value), cause, limit, is_open)


def needed(laws: Iterable[Law], has: set[str]) -> list[Law]:
    """The laws of which all needs are there."""
    return [law for law in laws if has.issuperset(law.needs.split())]


def judged(laws: Iterable[Law], case: Any) -> list[Finding]:
    """The findings of the laws of which all needs are in case.has."""
    return [law.finding(law.measure(case)) for law in needed(laws, case.has)]


def causes(findings: Iterable[Finding]) -> list[str]:
    """The causes of laws that do not hold."""
    return [law.cause for law in findings if law.passed is False and law.cause]


@dataclass(frozen=True)
class Grade(Displayed):
    """The laws that a student's function obeys and those that it does not, with the reasons. print() shows a table.

    Attributes
    ----------
    function : how it was called.
    findings : the laws that were tested, each with the measured number.
    faults : what is wrong, one sentence each, the most important first; empty if nothing was found.
    method : name of the method or law that was recognized; empty if none was.
    """

    function: str
    findings: tuple[Finding, ...] = ()
    faults: tuple[str, ...] = ()
    method: str = ""
    remarks: tuple[str, ...] = ()

    @property
    def passed(self) -> bool | None:
        """Whether every tested law holds and no fault was found; None if that was too short to judge."""
        if self.faults or any(finding.passed is False for finding in self.findings):
            return False
        return None if any(finding.is_open for finding in self.findings) else True

    def __iter__(self) -> Iterator[Finding]:
        """The findings, in their order."""
        return iter(self.findings)

    def __getitem__(self, name: str) -> Finding:
        """The finding of a law, such as grade["order"].  Raises KeyError with the names that exist."""
        by_name = {finding.name: finding for finding in self.findings}
        if name not in by_name:
            raise KeyError(f"no law {name!r} was tested; the laws tested are {', '.join(by_name)}")
        return by_name[name]

    @property
    def verdict(self) -> str:
        """The result in one sentence."""
        if self.passed:
            return "nothing wrong was found"
        if self.passed is None:
            names = ", ".join(finding.name for finding in self.findings if finding.is_open)
            return f"too short to judge: {names}; take more runs= or steps="
        failed = [finding.name for finding in self.findings if finding.passed is False]
        laws = "all laws that were tested hold"
        if failed:
            laws = f"laws that do not hold: {', '.join(failed)}"
        n = len(self.faults)
        return f"{n} fault{'s' * (n != 1)} found; {laws}" if n else laws

    def display_rows(self) -> Rows:
        """See Displayed."""
        rows = [("called as", self.function)]
        if self.method:
            rows.append(("recognized", self.method))
        for finding in self.findings:
            rows.append((finding.name, f"{TICKS[finding.passed]} {finding.words}"))
        for name, sentences in (("fault", self.faults), ("remark", self.remarks)):
            for k, sentence in enumerate(sentences):
                rows.append(("" if k else name, sentence))
        return [*rows, ("verdict", self.verdict)]


def coefficient(value: float) -> str:
    """A number as a simple fraction, such as 1/2, if it equals one; else with seven digits."""
    near = Fraction(value if isfinite(value) else 0).limit_denominator(DENOMINATOR)
    return str(near) if is_near(value, float(near)) else f"{value:.7g}"


def is_near(value: float, other: float) -> bool:
    """Whether two coefficients are the same number."""
    return abs(value - other) < EXACT * max(1.0, abs(other))


def nearest(value: float, table: dict[float, str], within: float) -> str:
    """: and the meaning of the number in a table that is nearest, if it is near."""
    best = min(table, key=lambda number: abs(log(max(value, 1e-9) / number)))
    return f": {table[best]}" if abs(value / best - 1.0) < within else ""
