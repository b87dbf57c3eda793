"""minimd.view: a run, or the file that a failed run left, as a page that needs only a browser."""

import html
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from minimd.core.console.whole_file import write_whole
from minimd.core.engine.record import Record
from minimd.core.forces.forces import Potential
from minimd.core.structure.checks import checked_count

FRAMES = 200  # largest number of frames if not given
HEIGHT = 720  # of the page in a notebook [pixels]


@dataclass(frozen=True, repr=False)
class View:
    """An HTML page that contains everything: it makes no requests, and its policy forbids the browser to make any.

    A notebook shows it.
    html : the page.
    file : the file of the run.
    summary : what it shows, in words.
    """

    html: str
    file: Path
    summary: str

    def save(self, page: str | Path | None = None) -> Path:
        """Write the page and return its name; if not given, that of the run with .html. A file or link with this name
        is replaced.
        Raises OSError if it cannot be written."""
        path = self.file.with_suffix(".html") if page is None else Path(page)
        write_whole(path, self.html)
        return path

    def __repr__(self) -> str:
        size = len(self.html.encode()) / 1e6
        return f"View({str(self.file)!r}: {self.summary}; {size:.1f} MB; write it with .save())"

    def _repr_html_(self) -> str:
        style = f"width: 100%; height: {HEIGHT}px; border: 0"
        title = html.escape(str(self.file))
        return (
            f'<iframe title="{title}" style="{style}" srcdoc="{html.escape(self.html)}"></iframe>'
        )


def view(
    file: str | Path | Record,
    *,
    frames: int = FRAMES,
    potentials: Potential | Sequence[Potential] | None = None,
) -> View:
    """A run as a page: its report, its pictures, and its atoms in motion with cell, bonds and species.

    For a failed run (.crash.h5md) the page shows the last steps, made again one by one,
    and marks the pair of atoms that caused the failure.

    Parameters
    ----------
    file : .h5md file of a run, or .crash.h5md that a failed run left; or the record of a run that wrote a file.
    frames : largest number of frames, evenly chosen from those in the file; fewer are shown if there are many atoms.
    potentials : for a failed run only; if not given, those of the scene that is stored in the file. Without both, the
        page shows the two states in the file.

    Raises
    ------
    FileNotFoundError, OSError, ValueError : as md.replay for a failed run, else as minimd.mdanalysis.universe.
        ValueError also if potentials are given for a run that did not fail,
        if frames is not a whole number of at least 2, and for the record of a run that wrote no .h5md file.
    """
    frames = checked_count("frames", frames, least=2)
    place = file.trajectory if isinstance(file, Record) else file
    if place is None:
        raise ValueError(
            "a page needs the frames of the run, but the run wrote no .h5md file; run with trajectory='run.h5md'"
        )

    # these load h5py, MDAnalysis and matplotlib
    from minimd.core.files.crash_file import is_crash_file
    from minimd.core.files.h5md_reader import verify_frames
    from minimd.view.page import failure_story, page, run_story

    verify_frames(place)
    path = Path(place)
    has_failed = is_crash_file(path)
    if potentials is not None and not has_failed:
        raise ValueError(
            f"potentials are used for a failed run only; {str(path)!r} holds a run that did not fail: leave them out"
        )

    story = failure_story(path, frames, potentials) if has_failed else run_story(path, frames)
    motion = story.motion
    return View(page(story), path, f"{len(motion.frames)} frames of {len(motion.atoms)} atoms")
