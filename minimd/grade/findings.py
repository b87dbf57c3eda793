"""The contents of a grade: findings with a tick, a cross or a question mark, the faults in words, and a verdict."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field
from enum import Enum
from fractions import Fraction
from math import isfinite

from minimd.console.display import Displayed, Rows

TICKS = {True: "✓", False: "✗", None: "?"}
EXACT = 1e-5  # coefficients that differ by less are taken as equal
DENOMINATOR = 24  # the largest in fractions for coefficients


class Kind(Enum):
    """Kinds of faults that do not count beside others."""

    OF_UNITS = "a Lennard-Jones force with other numbers than those for ε = σ = 1"
    BESIDE_MINIMD = "a difference from minimd's force"
    JUMP = "a jump of the energy at the cutoff"
    CUTOFF = "a cutoff that is not applied"


class Fault(str):
    """A fault in words, of a kind."""

    kind: Kind

    def __new__(cls, kind: Kind, words: str) -> Fault:
        """A text."""
        made = super().__new__(cls, words)
        made.kind = kind
        return made


def without(faults: Iterable[str], kind: Kind) -> list[str]:
    """The faults that are not of a kind."""
    return [fault for fault in faults if getattr(fault, "kind", None) != kind]


@dataclass(frozen=True)
class Finding:
    """One law that was tested.

    Attributes
    ----------
    name : of the law.  passed : True, False, or None if the reader has to judge.  words : what was measured.
    value : the measured number, dimensionless unless the words give a unit; NaN if there is none.
    limit : the largest difference of value from 1 that passes, for laws of dynamics; else NaN.
    """

    name: str
    passed: bool | None
    words: str
    value: float = float("nan")
    limit: float = float("nan")


@dataclass(frozen=True)
class Grade(Displayed):
    """The laws that a student's function obeys and those that it does not, with the reasons. print() shows a table.

    Attributes
    ----------
    function : how it was called.  findings : the laws that were tested, each with the measured number.
    faults : what is wrong, one sentence each, the most important first; empty if nothing was found.
    method : name of the method or law that was recognized; empty if none was.
    """

    function: str
    findings: tuple[Finding, ...] = ()
    faults: tuple[str, ...] = ()
    method: str = ""
    remarks: tuple[str, ...] = field(default=())

    @property
    def passed(self) -> bool:
        """Whether every tested law holds and no fault was found."""
        return not self.faults and all(finding.passed is not False for finding in self.findings)

    def __iter__(self) -> Iterator[Finding]:
        """The findings, in their order."""
        return iter(self.findings)

    def __getitem__(self, name: str) -> Finding:
        """The finding of a law, such as grade["order"].  Raises KeyError with the names that exist."""
        for finding in self.findings:
            if finding.name == name:
                return finding
        raise KeyError(
            f"no law {name!r} was tested; those that were: {', '.join(finding.name for finding in self.findings)}"
        )

    @property
    def verdict(self) -> str:
        """The result in one sentence."""
        if self.passed:
            return "nothing wrong was found"
        failed = [finding.name for finding in self.findings if finding.passed is False]
        n = len(self.faults)
        kept = f"laws that do not hold: {', '.join(failed)}" if failed else "all laws that were tested hold"
        return f"{n} fault{'s' * (n != 1)} found; {kept}" if n else kept

    def display_rows(self) -> Rows:
        """See Displayed."""
        rows = [("called as", self.function)]
        rows += [("recognized", self.method)] if self.method else []
        rows += [(finding.name, f"{TICKS[finding.passed]} {finding.words}") for finding in self.findings]
        rows += [("fault" if k == 0 else "", sentence) for k, sentence in enumerate(self.faults)]
        rows += [("remark" if k == 0 else "", sentence) for k, sentence in enumerate(self.remarks)]
        return [*rows, ("verdict", self.verdict)]


def coefficient(value: float) -> str:
    """A number as a simple fraction, such as 1/2, if it equals one; else with four digits."""
    near = Fraction(value if isfinite(value) else 0).limit_denominator(DENOMINATOR)
    return str(near) if abs(value - near) < EXACT * max(1.0, abs(value)) else f"{value:.4g}"


def is_near(value: float, other: float) -> bool:
    """Whether two coefficients are the same number."""
    return abs(value - other) < EXACT * max(1.0, abs(other))


def all_of(*rows: tuple[object, str]) -> list[str]:
    """The sentences whose conditions hold."""
    return [sentence for condition, sentence in rows if condition]


def first_of(*rows: tuple[object, str]) -> list[str]:
    """The first sentence whose condition holds; none if no condition does."""
    return all_of(*rows)[:1]


def first_of_each(*groups: Iterable[tuple[object, str]]) -> list[str]:
    """The first sentence of each group whose condition holds."""
    return [sentence for group in groups for sentence in first_of(*group)]
