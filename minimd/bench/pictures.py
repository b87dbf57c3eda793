"""Figures that can be read at the width of a page: few curves, with their names at their ends, in letters as large as those of the text."""

from collections.abc import Mapping
from typing import TYPE_CHECKING, NamedTuple

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

WIDTH = 7.5  # inches, the width of a page
MOST_CURVES = 6  # in a panel
BETWEEN_NAMES = 0.22  # inches, from one name to the next


class End(NamedTuple):
    """The last point of a curve, and its color."""

    x: float
    y: float
    color: str


def new_figure(height: float, width: float = WIDTH) -> "Figure":
    """An empty figure without a window.  width, height : inches."""
    from matplotlib.figure import Figure

    return Figure(figsize=(width, height), layout="constrained")


def name_curves(panel: "Axes", ends: Mapping[str, End]) -> None:
    """Write the name of each curve to the right of the panel, in its color, at the height of its end or as near as other names allow.

    All curves must have been drawn, also those of panels that share an axis.  A thin line connects each name with the end of its curve.
    """
    to_panel = panel.transData + panel.transAxes.inverted()
    panel.get_ylim()  # fixes limits that matplotlib chooses
    gap = BETWEEN_NAMES / (0.8 * panel.bbox.height / panel.figure.dpi)
    places = {name: to_panel.transform((end.x, end.y)) for name, end in ends.items()}
    height = -1.0
    # If ends have about the same height, the one farthest to the right comes first, so that no line crosses a curve.
    for name, (_, y) in sorted(places.items(), key=lambda item: (round(item[1][1] / gap), -round(item[1][0], 2), item[1][1])):
        height, color = max(y, height + gap), ends[name].color
        line = {"arrowstyle": "-", "lw": 0.6, "color": color, "alpha": 0.6}
        text = panel.annotate(name, ends[name][:2], (1.02, height), textcoords="axes fraction", va="center", color=color, arrowprops=line)
        text.set_annotation_clip(False)
