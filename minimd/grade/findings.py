"""What a grade says: findings with a tick, a cross or a question mark, the faults in words, and a verdict."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from fractions import Fraction

from minimd.structure.display import Displayed, Rows

TICKS = {True: "✓", False: "✗", None: "?"}
EXACT = 1e-5  # coefficients that agree within it are taken for the same number
DENOMINATOR = 24  # largest of a coefficient that is shown as a fraction


@dataclass(frozen=True)
class Finding:
    """One law that was tested.

    Attributes
    ----------
    name : of the law.  passed : True, False, or None where it is for the reader to judge.  words : what was measured.
    value : the figure behind the words, dimensionless unless the words name its unit; NaN if there is none.
    """

    name: str
    passed: bool | None
    words: str
    value: float = float("nan")


@dataclass(frozen=True)
class Grade(Displayed):
    """What a student's function keeps, what it does not, and why. print() shows a table.

    Attributes
    ----------
    function : how it was called.  findings : the laws that were tested, each with its figure.
    faults : what is wrong, one sentence each, the most telling first; empty if nothing was found.
    method : name of the method or law that was recognized; empty if none was.
    """

    function: str
    findings: tuple[Finding, ...] = ()
    faults: tuple[str, ...] = ()
    method: str = ""
    remarks: tuple[str, ...] = field(default=())

    @property
    def passed(self) -> bool:
        """Whether every law that was tested holds and no fault was named."""
        return not self.faults and all(finding.passed is not False for finding in self.findings)

    def __iter__(self) -> Iterator[Finding]:
        """The findings, one after another."""
        return iter(self.findings)

    def __getitem__(self, name: str) -> Finding:
        """The finding of a law, such as grade["order"].  Raises KeyError with the names that exist."""
        for finding in self.findings:
            if finding.name == name:
                return finding
        raise KeyError(f"no law {name!r} was tested; those that were: {', '.join(finding.name for finding in self.findings)}")

    @property
    def verdict(self) -> str:
        """One sentence."""
        if self.passed:
            return "nothing wrong was found"
        failed = [finding.name for finding in self.findings if finding.passed is False]
        n = len(self.faults)
        kept = f"not kept: {', '.join(failed)}" if failed else "all laws that were tested hold"
        return f"{n} fault{'s' * (n != 1)} named; {kept}" if n else kept

    def display_rows(self) -> Rows:
        """See Displayed."""
        rows = [("called as", self.function)]
        rows += [("recognized", self.method)] if self.method else []
        rows += [(finding.name, f"{TICKS[finding.passed]} {finding.words}") for finding in self.findings]
        rows += [("fault" if k == 0 else "", sentence) for k, sentence in enumerate(self.faults)]
        rows += [("remark" if k == 0 else "", sentence) for k, sentence in enumerate(self.remarks)]
        return [*rows, ("verdict", self.verdict)]


def coefficient(value: float) -> str:
    """A number as a fraction, such as 1/2, if it is one; else with four digits."""
    near = Fraction(value).limit_denominator(DENOMINATOR)
    return str(near) if abs(value - near) < EXACT * max(1.0, abs(value)) else f"{value:.4g}"


def is_near(value: float, other: float) -> bool:
    """Whether two coefficients are the same number."""
    return abs(value - other) < EXACT * max(1.0, abs(other))
