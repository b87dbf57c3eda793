"""The contents of a page about a run, or about a failed run."""

import io
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, NamedTuple

from matplotlib.figure import Figure

from minimd.analysis.check import checked
from minimd.analysis.plot import drawn
from minimd.console.display import Rows
from minimd.diagnosis.crash_report import CrashReport
from minimd.files.crash_file import read_crash_report
from minimd.files.h5md_reader import H5MDContents, read_file
from minimd.forces.forces import Potential
from minimd.mdanalysis.universes import RunUniverse, universe_of
from minimd.structure.units import ASE
from minimd.view.motion import Motion, motion_of

LARGEST_PICTURE = 1_500_000  # of an SVG in bytes; a larger one is drawn in pixels instead


class Story(NamedTuple):
    """title, heading, report : texts.  contents : of the file.  notes : sentences about what is not shown.

    marked : atoms that caused a failure; empty without one.  cause : of a failure, with advice and fault; or empty.
    picture : MIME type and bytes.  alternative : the picture in words.
    """

    title: str
    heading: str
    contents: H5MDContents
    motion: Motion
    marked: tuple[int, ...]
    cause: tuple[str, ...]
    picture: tuple[str, bytes]
    alternative: str
    report: str
    notes: tuple[str, ...]

    @property
    def parameters(self) -> Rows:
        """System, method and potentials, with their units."""
        return parameters(self.contents)

    @property
    def summary(self) -> str:
        """The numbers of frames and atoms shown, in words."""
        return f"{len(self.motion.frames)} frames of {len(self.motion.atoms)} atoms"


def run_story(path: Path, frames: int) -> Story:
    """The check of a run as text, its picture, its atoms.  Raises as minimd.mdanalysis.universe."""
    with universe_of(path) as made:
        motion, contents = motion_of(made, frames), made.contents
        words = "Four pictures: change of the total energy, temperature, change of the momentum, and structure; "
        words += "the report has their figures."
        shown = (_scalable(drawn(made)), words, str(checked(made)), _left_out(motion, contents.repaired))
        return Story(contents.title, _heading(path, contents), contents, motion, (), (), *shown)


def failure_story(path: Path, frames: int, potentials: Potential | Sequence[Potential] | None) -> Story:
    """The last steps of a failed run, made again; or, without potentials, the two states in its file.
    Raises as minimd.replay."""
    past = read_crash_report(path)
    found = past.findings
    atoms = (found.pair.first, found.pair.second) if found.pair else found.closest[:2] if found.closest else ()
    marked = atoms or (found.fastest,)
    moved = partial(motion_of, most=frames, marked=marked, latest=True)
    if potentials is not None or past.run.scene:
        contents, shown = read_file(path), _steps(path, found, potentials, moved)
    else:
        with universe_of(path) as made:
            contents, motion, picture = made.contents, moved(made), _scalable(drawn(made))
        note = f"the potentials of the script: minimd.view({path.name!r}, potentials=...)"
        notes = (f"The steps between these states need {note}.", *_left_out(motion))
        shown = motion, picture, "Four pictures of the states in the file.", str(found), notes
    motion, *rest = shown
    cause = (found.cause, found.advice, f"{found.fault}, at step {found.step}")
    return Story(f"{contents.title}: failed", _heading(path, contents), contents, motion, marked, cause, *rest)


def _steps(path: Path, findings: CrashReport, potentials: Any, moved: Callable[[RunUniverse], Motion]) -> tuple:
    """Motion, picture and its words, report and notes for the steps that led to the failure, made again."""
    from minimd.replay import replay

    with TemporaryDirectory() as folder:
        steps, drawing = Path(folder) / "steps.h5md", Path(folder) / "steps.svg"
        seen = replay(path, potentials, trajectory=steps, picture=drawing)
        with universe_of(seen.trajectory or path) as made:
            motion = moved(made)
        words = "Four pictures against the step: total energy, distance of the closest pair, largest force, largest "
        words += "speed; the report has a table."
        picture = ("image/svg+xml", drawing.read_bytes())
        return motion, picture, words, f"{findings}\n\n{seen}", _left_out(motion)


def _heading(path: Path, contents: H5MDContents) -> str:
    step = contents.system.units.shown(contents.timestep)
    method = f"{contents.method} with Δt = {step}, {contents.system.units.name} units"
    return f"{path.name}: {len(contents.system)} atoms, {method}"


def parameters(contents: H5MDContents) -> Rows:
    """System, method and potentials, in the units of the system; times and rates in ps, or τ."""
    system, units = contents.system, contents.system.units
    mass, picosecond = ("u", f", of which {units.to_picosecond**-1:.5g} make a ps") if units is ASE else ("m", "")
    sizes = f"lengths in {units.length}, energies in {units.energy}, masses in {mass}"
    told = {"system", "cell", "constraints"}  # by the rows of the system
    rows = [row for row in system.display_rows() if row[0] != "units"]
    rows += [row for row in contents.scene_in_words() if row[0] not in told]
    return [*rows, ("units", f"{sizes}, times in {units.time}{picosecond}, temperatures in {units.temperature}")]


def _left_out(motion: Motion, repaired: str = "") -> tuple[str, ...]:
    """Sentences about frames and atoms that are not shown, and about a damaged restart."""
    n_frames, n_atoms, words = len(motion.frames), len(motion.atoms), []
    if n_frames < motion.n_frames:
        words.append(f"{n_frames} of {motion.n_frames} frames are shown.")
    if n_atoms < motion.n_atoms:
        words.append(f"{n_atoms} of {motion.n_atoms} atoms are shown, evenly chosen.")
    return (*words, f"{repaired}.") if repaired else tuple(words)


def _scalable(figure: Figure) -> tuple[str, bytes]:
    """A figure as SVG, or as PNG if that would be large."""
    vectors, dots = io.BytesIO(), io.BytesIO()
    figure.savefig(vectors, format="svg")
    if vectors.tell() <= LARGEST_PICTURE:
        return "image/svg+xml", vectors.getvalue()
    figure.savefig(dots, format="png")
    return "image/png", dots.getvalue()
