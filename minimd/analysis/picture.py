"""Pictures of four panels, written to files."""

from io import BytesIO
from pathlib import Path

from matplotlib.figure import Figure

from minimd.engine.record_picture import four_panels
from minimd.files.claim import write_whole

__all__ = ["four_panels", "save"]


def save(figure: Figure, picture: Path) -> Path:
    """Write a picture, in place of a file or link of its name, and return this name.
    Raises OSError if it cannot be written."""
    drawn = BytesIO()
    figure.savefig(drawn, format=picture.suffix[1:] or None)
    write_whole(picture, drawn.getvalue())
    return picture
