"""Pictures of four panels, written to files."""

from pathlib import Path

from matplotlib.figure import Figure

from minimd.engine.record_picture import four_panels

__all__ = ["four_panels", "save"]


def save(figure: Figure, picture: Path) -> Path:
    """Write a picture and return its name.  Raises OSError if it cannot be written."""
    try:
        figure.savefig(picture)
    except OSError as error:
        raise OSError(f"picture {str(picture)!r} cannot be written: {error.strerror or error}") from error
    return picture
