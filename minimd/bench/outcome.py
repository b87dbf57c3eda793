"""The outcome of a benchmark: a table to read, JSON for programs, a picture.

A picture can be read at the width of a page: few curves, with their names at their ends, in letters as large as those
of the text.
"""

import json
import platform
import re
import shutil
import subprocess
from collections.abc import Mapping, Sequence
from math import floor, log10
from pathlib import Path
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np

import minimd as md
from minimd.core.compiled.machine import MISSING, available_cores, processor_name, version
from minimd.core.console.whole_file import write_picture, write_whole
from minimd.core.structure.arrays import Array

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

DIGITS = 3  # of a median, because rounds differ by a percent or more
ALIGN = {str: ":---", float: "---:"}
DPI = 150
WIDTH = 7.5  # inches, the width of a page
MARKERS = "os^vD<"
MOST_CURVES = len(MARKERS)  # in a panel
BETWEEN_NAMES = 0.22  # inches, from one name to the next

Ratios = Array | None


class Outcome(Protocol):
    """The outcome of one benchmark.
    name : in its files.
    packages : whose versions matter, besides minimd, numba and numpy."""

    name: str

    @property
    def packages(self) -> Sequence[str]: ...  # noqa: D102

    def lines(self) -> list[str]:
        """The results as lines of Markdown."""

    def content(self) -> dict[str, Any]:
        """Everything that was measured, in every round."""

    def figure(self) -> "Figure":
        """A figure of the results."""


def markdown(outcome: Outcome) -> str:
    """The tables, below a description of machine and versions."""
    title = f"# minimd bench {outcome.name}"
    numbers = ", ".join(f"{name} {number}" for name, number in versions(outcome.packages).items())
    return "\n".join([title, "", f"{machine()['text']}.  ", f"{numbers}.", "", *outcome.lines()])


def as_json(outcome: Outcome) -> str:
    """All results as JSON, with machine and versions."""
    where = {"machine": machine(), "versions": versions(outcome.packages)}
    return json.dumps(where | outcome.content(), indent=2, ensure_ascii=False)


def write(outcome: Outcome, folder: Path) -> None:
    """Write bench_NAME.md, .json and .png into a folder; files of these names are replaced."""
    stem = folder / f"bench_{outcome.name.replace('-', '_')}"
    write_whole(stem.with_suffix(".md"), markdown(outcome) + "\n")
    write_whole(stem.with_suffix(".json"), as_json(outcome) + "\n")
    figure = outcome.figure()
    figure.set_dpi(DPI)
    write_picture(figure, stem.with_suffix(".png"))


def versions(packages: Sequence[str]) -> dict[str, str]:
    """Versions of minimd, numba, numpy, and of the packages and programs that took part, as they say themselves."""
    numbers = {"minimd": md.__version__}
    for name in ("numba", "numpy", *packages):
        numbers[name] = version(name)
        if numbers[name] == MISSING and shutil.which(name) is not None:
            command = [name, "--version"]
            answer = subprocess.run(command, capture_output=True, text=True, check=False).stdout
            number = re.search(r"version:?[ \t]+(\d\S*)", answer, re.IGNORECASE)
            numbers[name] = number[1] if number else "of unknown version"
    return numbers


def machine() -> dict[str, str | int]:
    """The machine: processor, cores that this process may use, platform, Python; and all in one line."""
    facts: dict[str, str | int] = {
        "processor": processor_name(),
        "cores": available_cores(),
        "platform": platform.platform(),
        "python": platform.python_version(),
    }
    text = "{processor} ({kind}), {cores} cores for this process; {platform}; Python {python}"
    return {"text": text.format(kind=platform.machine(), **facts), **facts}


def table(titles: Mapping[str, type], cells: Sequence[Sequence[Any]]) -> list[str]:
    """Lines of a Markdown table. titles : column → str or float, for left or right."""
    alignments = [ALIGN[kind] for kind in titles.values()]
    lines = [list(titles), alignments, *cells]
    return [f"| {' | '.join(map(str, line))} |" for line in lines]


def threads_text(n: int) -> str:
    """ "1 thread", "2 threads"."""
    return f"{n} thread{'s' if n > 1 else ''}"


def spread(values: Ratios) -> str:
    """The median (least to most) as text; empty without values, and 1 if a row is divided by itself."""
    if values is None:
        return ""
    if np.all(values == 1.0):
        return "1"
    middle = np.median(values)
    digits = max(0, DIGITS - 1 - floor(log10(middle)))
    return f"**{middle:.{digits}f}** ({values.min():.{digits}f} to {values.max():.{digits}f})"


def summary(values: Ratios) -> dict[str, Any] | None:
    """Median and the values of all rounds, for programs."""
    if values is None:
        return None
    return {"median": float(np.median(values)), "turns": values.tolist()}


def new_figure(height: float) -> "Figure":
    """An empty figure without a window.
    height : inches."""
    from matplotlib.figure import Figure

    return Figure(figsize=(WIDTH, height), layout="constrained")


def bars(ratios: Mapping[str, Array], label: str) -> "Figure":
    """Bars for the medians of ratios, with the ranges of their rounds, and a line at 1.
    label : of the axis."""
    figure = new_figure(max(2.0, 0.3 * len(ratios)))
    axes = figure.subplots()
    rounds = np.array(list(ratios.values()))
    middle = np.median(rounds, axis=1)
    ends = [middle - rounds.min(axis=1), rounds.max(axis=1) - middle]
    axes.barh(
        list(ratios),
        middle,
        xerr=ends,
        color="tab:blue",
        ecolor="gray",
    )
    axes.axvline(1.0, color="black", lw=0.8)
    axes.invert_yaxis()
    axes.set(xlabel=label, title="median and range of all rounds")
    return figure


def draw(panel: "Axes", curves: Mapping[str, tuple[Sequence[float], Array, bool]]) -> None:
    """Draw medians of all rounds and their ranges, six curves at most.
    curves : by name: x (P,), y (P, R), and whether it is minimd's."""
    for k, (name, (x, y, is_own)) in enumerate(curves.items()):
        color = f"C{k}"
        middle = np.median(y, axis=1)
        marker = MARKERS[k % MOST_CURVES]
        style, width = ("-", 2.5) if is_own else ("--", 1.5)
        panel.plot(
            x,
            middle,
            style,
            marker=marker,
            lw=width,
            color=color,
            label=name,
        )
        panel.fill_between(
            x,
            y.min(axis=1),
            y.max(axis=1),
            alpha=0.15,
            color=color,
        )


def name_curves(panel: Any) -> None:
    """Write the name of each curve to the right of the panel, in its color, at the height of its end or as near as
    other names allow; a thin line connects each name with the end of its curve.
    All curves must have been drawn, also those of panels that share an axis."""
    to_panel = panel.transData + panel.transAxes.inverted()
    panel.get_ylim()  # fixes limits that matplotlib chooses
    gap = BETWEEN_NAMES / (0.8 * panel.bbox.height / panel.figure.dpi)

    def place(curve: Any) -> tuple[float, float, float]:
        """Of ends of about the same height, the one farthest to the right comes first, so that no line crosses a
        curve."""
        x, y = to_panel.transform(curve.get_xydata()[-1])
        return round(y / gap), -round(x, 2), y

    height = -1.0

    for curve in sorted(panel.lines, key=place):
        height = max(place(curve)[2], height + gap)
        color = curve.get_color()
        panel.annotate(
            curve.get_label(),
            curve.get_xydata()[-1],
            (1.02, height),
            textcoords="axes fraction",
            va="center",
            color=color,
            arrowprops={"arrowstyle": "-", "lw": 0.6, "color": color, "alpha": 0.6},
            annotation_clip=False,
        )
