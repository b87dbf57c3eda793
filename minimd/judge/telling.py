"""A grade for others: as JSON, as a picture, and its laws as tests of another suite."""

from collections.abc import Callable
from dataclasses import asdict
from functools import cache
from importlib import import_module
from pathlib import Path
from runpy import run_path
from typing import Any

import numpy as np

from minimd.judge import grading
from minimd.judge.findings import Finding, Grade

COLORS = {True: "tab:green", False: "tab:red", None: "tab:gray"}


def as_dict(grade: Grade) -> dict[str, Any]:
    """A grade for json.dumps: its fields, passed and verdict; numbers that are not finite are None."""
    fields = asdict(grade) | {"passed": grade.passed, "verdict": grade.verdict}
    for finding in fields["findings"]:
        for name in ("value", "limit"):
            if not np.isfinite(finding[name]):
                finding[name] = None
    return fields


def draw(grade: Grade, file: Path) -> None:
    """A picture of a grade of dynamics: each measured number, and what would pass."""
    from matplotlib.figure import Figure

    rows = [finding for finding in grade.findings if np.isfinite(finding.limit)][::-1]
    if not rows:
        raise ValueError(
            f"a picture shows laws with a limit, as NVT and NPT have them; {grade.function} has none"
        )

    figure = Figure(figsize=(7.0, 1.2 + 0.32 * len(rows)), layout="constrained")
    axes = figure.subplots()
    for k, row in enumerate(rows):
        axes.barh(k, 2.0 * row.limit, left=1.0 - row.limit, color="0.9")
        axes.plot(row.value, k, "o", color=COLORS[row.passed])

    axes.axvline(1.0, color="0.5", linewidth=1.0)
    axes.set_yticks(range(len(rows)), [row.name for row in rows])
    axes.set_xlabel("measured / right; gray: passes")
    verdict = grade.verdict if len(grade.verdict) < 60 else "faults were found"
    axes.set_title(f"{grade.function}\n{verdict}", fontsize=9, parse_math=False)
    figure.savefig(file, dpi=120)


def named(place: str) -> Callable[..., Any]:
    """What "module:name" or "file.py:name" names.  Raises ValueError if it is not there."""
    module, _, name = place.partition(":")
    try:
        names = run_path(module) if module.endswith(".py") else vars(import_module(module))
        return names[name]
    except (ImportError, OSError, KeyError, SyntaxError, TypeError, ValueError) as error:
        cause = f"{module} has no {name!r}" if isinstance(error, KeyError) else error
        raise ValueError(
            "dynamics must be module:class, as ase.md.langevin:Langevin, or file.py:class; got "
            f"{place!r}: {cause}"
        ) from error


def laws_of(dynamics: Callable[..., Any], **options: Any) -> list[Any]:
    """The laws of a class of dynamics as tests, for pytest.mark.parametrize: law() raises AssertionError with a cause.

        @pytest.mark.parametrize("law", laws_of(MyThermostat, temperature_K=300.0), ids=repr)
        def test_law(law):
            law()

    All laws are measured together when the first one is called.  options : of md.grade.
    """
    from minimd.judge.dynamics import names_of

    graded = cache(lambda: grading.grade(dynamics, kind="dynamics", **options))
    return [LawOf(name, graded) for name in names_of(dynamics, options)]


class LawOf:
    """One law of a class of dynamics."""

    def __init__(self, name: str, graded: Callable[[], Grade]) -> None:
        self.name = name
        self._graded = graded

    def __repr__(self) -> str:
        return self.name

    def __call__(self) -> Finding:
        """Its finding.  Raises AssertionError if the law does not hold, was not reached, or was too short to judge."""
        grade = self._graded()
        finding = Finding(self.name, False, "was not reached")
        for law in grade:
            if law.name == self.name:
                finding = law
        is_right = finding.passed is not False and not finding.is_open
        assert is_right, f"{finding.words}; {'; '.join(grade.faults)}"
        return finding
