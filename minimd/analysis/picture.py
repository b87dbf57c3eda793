"""Pictures of four panels, drawn without a window."""

from pathlib import Path

from matplotlib.axes import Axes
from matplotlib.figure import Figure

INCHES, DOTS_PER_INCH = (10.0, 7.0), 150


def four_panels() -> tuple[Figure, list[Axes]]:
    """An empty picture and its panels, row by row."""
    figure = Figure(figsize=INCHES, dpi=DOTS_PER_INCH, layout="constrained")
    panels = list(figure.subplots(2, 2).ravel())
    for panel in panels:
        panel.spines[["top", "right"]].set_visible(False)
        panel.grid(alpha=0.25, lw=0.6)
    return figure, panels


def save(figure: Figure, picture: Path) -> Path:
    """Write a picture and return its name.  Raises OSError if it cannot be written."""
    try:
        figure.savefig(picture)
    except OSError as error:
        raise OSError(f"picture {str(picture)!r} cannot be written: {error.strerror or error}") from error
    return picture
