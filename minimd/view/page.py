"""A page about a run: one HTML file that contains style, program, numbers and pictures, and atoms in motion.

Some frames of a run are shown, as integers of 16 bits:

    r = Σ_k (low_k + width_k q_k / 2¹⁶) lattice_k        k = 1, 2, 3;  q_k = 0 … 2¹⁶ − 1

Along periodic directions of the reduced lattice low is 0 and width is 1: q counts fractions of the lattice vector, a
sum that overflows leads to the next cell, and the difference of two q, as a signed number, is that of nearest images.
Along open directions each frame has its own bounds.
"""

import html
import json
from base64 import b64encode
from collections.abc import Sequence
from importlib.resources import files
from math import ceil
from pathlib import Path
from string import Template
from tempfile import TemporaryDirectory
from typing import Any, NamedTuple

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from minimd.core.console import __version__
from minimd.core.console.display import Rows
from minimd.core.console.whole_file import rendered
from minimd.core.files.crash_file import read_crash_report
from minimd.core.files.h5md_reader import H5MDContents, read_file
from minimd.core.files.turned_cell import as_in_run
from minimd.core.forces.forces import Potential
from minimd.core.structure.arrays import Array, Indices
from minimd.core.structure.constraints import joined_pairs
from minimd.core.structure.system import System
from minimd.mdanalysis.universes import RunUniverse, universe_of
from minimd.past.replay import replay
from minimd.view.check import checked
from minimd.view.plot import drawn

LEVELS = 2**16
SVG = "image/svg+xml"  # MIME type
BYTES = 5_000_000  # of all positions, at most: 4000 atoms in 200 frames are 4.8 MB
ATOMS = 50_000  # at most: the number that the graphics of a laptop draws smoothly
SAMPLED = 2000  # atoms from which the distance of neighbors is computed
LARGEST_PICTURE = 1_500_000  # of an SVG in bytes; a larger one is drawn in pixels instead
ELEMENTS = {"H": "#dcdcdc", "C": "#5f6670", "N": "#3a5fcd", "O": "#d0342c", "F": "#6fbf4b",
            "Cl": "#2e9e3f", "S": "#d9b310", "P": "#e07b00", "Cu": "#c77b3f",
            "Ar": "#4fa7b8"}  # fmt: skip # the colors of Corey, Pauling and Koltun
# in turns, for species without a usual color
OTHERS = "#4a7fc1", "#d98032", "#3f9f6f", "#b0599f", "#c9a227", "#7a6fc9", "#4fa7b8", "#a3504a"


class Motion(NamedTuple):
    """Some frames of a run.

    contents : of its file.
    frames : (T,) int, indices in the file.
    atoms : (A,) int, indices in the system.
    counts : (T, A, 3) uint16, q.
    low, width : (T, 3), dimensionless along periodic directions, [length] along open
    ones.
    apart : for each species the distance to the nearest neighbor [length], the median in the first frame shown.
    """

    contents: H5MDContents
    frames: Indices
    atoms: Indices
    counts: NDArray[np.uint16]
    low: Array
    width: Array
    apart: Array

    def positions(self, k: int) -> Array:
        """(A, 3) [length] of frame k, off by at most half of width/2¹⁶ along each lattice vector, and by any vector of
        the periodic lattice."""
        lattice = self.contents.system.cell.lattice
        positions: Array = (self.low[k] + self.width[k] * self.counts[k] / LEVELS) @ lattice
        return positions


class Story(NamedTuple):
    """title, heading : texts.
    contents : of the file.
    motion : Motion.
    marked : atoms that caused a failure.
    cause : of a failure, with advice and fault; both are empty without one.
    picture : MIME type and bytes.
    alternative : the picture in words.
    report : text.
    notes : sentences about what is not shown.
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


def run_story(path: Path, frames: int) -> Story:
    """The check of a run as text, its picture, its atoms.
    Raises as minimd.mdanalysis.universe."""
    with universe_of(path) as run:
        motion = motion_of(run, frames)
        contents = run.contents
        picture = _scalable(drawn(run))
        report = str(checked(run))
    return Story(
        title=contents.title,
        heading=_heading(path, contents),
        contents=contents,
        motion=motion,
        marked=(),
        cause=(),
        picture=picture,
        alternative="Pictures of the run: change of the total energy, temperature, momentum or pressure, structure; "
        "the report has their figures.",
        report=report,
        notes=_left_out(motion, contents.repaired),
    )


def failure_story(
    path: Path, frames: int, potentials: Potential | Sequence[Potential] | None
) -> Story:
    """The last steps of a failed run, made again; or, without potentials, the two states in its file.
    Raises as minimd.replay."""
    past = read_crash_report(path)
    contents = read_file(path)
    findings = past.findings
    marked: tuple[int, ...] = (findings.fastest,)
    if findings.pair:
        marked = (findings.pair.first, findings.pair.second)
    elif findings.closest:
        marked = findings.closest[:2]

    with TemporaryDirectory() as folder:
        source = path
        steps = b""
        report = str(findings)
        alternative = "Pictures of the states in the file."
        notes = [
            "The steps between these states need the potentials of the script: "
            f"minimd.view({path.name!r}, potentials=...)."
        ]
        if potentials is not None or past.run.scene:
            drawing = Path(folder) / "steps.svg"
            again = replay(
                path, potentials, trajectory=Path(folder) / "steps.h5md", picture=drawing
            )
            source = again.trajectory or path
            steps = drawing.read_bytes()
            report = f"{findings}\n\n{again}"
            alternative = (
                "Four pictures against the step: total energy, distance of the closest pair, largest force, "
                "largest speed; the report has a table."
            )
            notes = []
        with universe_of(source) as run:
            motion = motion_of(run, frames, marked, latest=True)
            picture = (SVG, steps) if steps else _scalable(drawn(run))

    return Story(
        title=f"{contents.title}: failed",
        heading=_heading(path, contents),
        contents=contents,
        motion=motion,
        marked=marked,
        cause=(findings.cause, findings.advice, f"{findings.fault}, at step {findings.step}"),
        picture=picture,
        alternative=alternative,
        report=report,
        notes=(*notes, *_left_out(motion)),
    )


def _heading(path: Path, contents: H5MDContents) -> str:
    system = contents.system
    units = system.units
    step = units.shown(contents.timestep)
    return (
        f"{path.name}: {len(system)} atoms, {contents.method} with Δt = {step}, {units.name} units"
    )


def _left_out(motion: Motion, repaired: str = "") -> tuple[str, ...]:
    """Sentences about frames and atoms that are not shown, and about a damaged restart."""
    sentences = []
    n_frames = motion.contents.n_frames
    if len(motion.frames) < n_frames:
        sentences.append(f"{len(motion.frames)} of {n_frames} frames are shown.")
    n_atoms = len(motion.contents.system)
    if len(motion.atoms) < n_atoms:
        sentences.append(f"{len(motion.atoms)} of {n_atoms} atoms are shown, evenly chosen.")
    if repaired:
        sentences.append(f"{repaired}.")
    return tuple(sentences)


def _scalable(figure: Figure) -> tuple[str, bytes]:
    """A figure as SVG, or as PNG if that would be large."""
    vectors = rendered(figure, "svg")
    if len(vectors) > LARGEST_PICTURE:
        return "image/png", rendered(figure, "png")
    return SVG, vectors


def motion_of(
    run: RunUniverse, most: int, marked: Sequence[int] = (), latest: bool = False
) -> Motion:
    """The motion in a file whose universe is open.

    most : largest number of frames; fewer are used if there are many atoms.
    latest : the last frames, in place of evenly chosen ones.
    marked : atoms that are always shown; all are shifted so that, in the last frame, the first of these is in the
        middle of the cell.
    """
    contents = run.contents
    system = run.system
    cell = system.cell
    record = contents.record
    atoms = chosen_atoms(len(system), marked)
    most = min(most, max(2, BYTES // (6 * len(atoms))))
    frames = chosen_frames(contents.n_frames, most, latest)
    inverses: Any = [cell.inverse] * len(frames)
    if "cell" in record:
        inverses = np.linalg.inv(cell.reduction @ record.cell[frames])
    places = []
    for frame, inverse in zip(frames, inverses, strict=True):
        ts = run.trajectory[int(frame)]
        positions = as_in_run(ts, ts.positions[atoms]) / system.units.to_angstrom
        places.append(positions @ inverse)

    fractions = np.array(places)
    if marked:
        middle = 0.5 * cell.vectors.sum(axis=0) @ cell.inverse
        place = fractions[-1, np.searchsorted(atoms, marked[0])]
        fractions += np.where(cell.pbc, middle - place, 0.0)

    extent = np.ptp(fractions, axis=1)
    low = np.where(cell.pbc, 0.0, fractions.min(axis=1))
    width = np.where(cell.pbc, 1.0, np.where(extent > 0.0, extent, 1.0) * LEVELS / (LEVELS - 1))
    counts = np.rint((fractions - low[:, None]) / width[:, None] * LEVELS) % LEVELS
    species = system.species_index[atoms]
    apart = neighbor_distances(fractions[0] @ cell.lattice, species, len(system.species_names))
    return Motion(contents, frames, atoms, counts.astype(np.uint16), low, width, apart)


def bonds_among(atoms: Indices, system: System) -> Indices:
    """(B, 2) pairs of indices in atoms: bonded pairs, and pairs whose length is held fixed, if both atoms are shown;
    each pair once."""
    joined = np.unique(np.sort(joined_pairs(system), axis=1), axis=0)
    places = np.full(len(system), -1)
    places[atoms] = np.arange(len(atoms))
    pairs = places[joined]
    return pairs[(pairs >= 0).all(axis=1)]


def chosen_frames(n_frames: int, most: int, latest: bool = False) -> Indices:
    """Indices of at most `most` frames: the last ones, or evenly chosen ones with the first and the last."""
    if latest:
        return np.arange(max(0, n_frames - most), n_frames)
    return np.unique(np.rint(np.linspace(0, n_frames - 1, min(most, n_frames))).astype(np.int64))


def chosen_atoms(n_atoms: int, marked: Sequence[int] = ()) -> Indices:
    """All atoms, or every n-th and the marked ones."""
    return np.union1d(
        np.arange(0, n_atoms, ceil(n_atoms / ATOMS)), np.asarray(marked, dtype=np.int64)
    )


def neighbor_distances(positions: Array, species: Indices, n_species: int) -> Array:
    """Median distance to the nearest other atom for each species [length], without images; 1 if there is no other
    atom."""
    if len(positions) < 2:
        return np.ones(n_species)
    some = np.arange(0, len(positions), ceil(len(positions) / SAMPLED))
    distances, _ = cKDTree(positions).query(positions[some], k=2)
    nearest = distances[:, 1]
    kinds = species[some]
    medians = [
        np.median(nearest[kinds == k] if (kinds == k).any() else nearest) for k in range(n_species)
    ]
    return np.where(np.array(medians) > 0.0, medians, 1.0)


def page(story: Story) -> str:
    """A story as HTML."""
    motion = story.motion
    system = story.contents.system
    species = system.species_names
    about = json.dumps(known_to_the_program(story), allow_nan=False, separators=(",", ":"))
    failure = ""
    if story.cause:
        cause, advice, fault = map(html.escape, story.cause)
        failure = (
            f'<section class="failure"><h2>Why it failed</h2><p><strong>{cause}</strong></p>'
            f"<p>What to do: {advice}.</p><p>What happened: {fault}.</p></section>"
        )

    rows = [
        f'<tr><th scope="row">{html.escape(name)}</th><td>{html.escape(content)}</td></tr>'
        for name, content in parameters(story.contents)
    ]
    circle = '<svg viewBox="0 0 10 10" aria-hidden="true"><circle cx="5" cy="5" r="4.5" fill="{}"/></svg>'
    counts = np.bincount(system.species_index, minlength=len(species))
    legend = [
        f"<li>{circle.format(color)} {html.escape(str(name))} ({n})</li>"
        for color, name, n in zip(colors(species), species, counts, strict=True)
    ]
    kind, picture = story.picture
    return Template(_page_text("page.html")).substitute(
        title=html.escape(story.title),
        heading=html.escape(story.heading),
        alternative=html.escape(story.alternative),
        report=html.escape(story.report),
        notes=html.escape(" ".join(story.notes)),
        version=html.escape(__version__),
        frames=b64(motion.counts, "<u2"),
        species=b64(system.species_index[motion.atoms], "<u4"),
        bonds=b64(bonds_among(motion.atoms, system), "<u4"),
        about=about.replace("<", "\\u003c"),  # safe inside a script element
        picture=f"data:{kind};base64,{b64encode(picture).decode()}",
        # which developer tools would request
        library=_page_text("ngl.js").partition("//# sourceMappingURL")[0],
        library_licenses=html.escape(_page_text("ngl-licenses.txt")),
        style=_page_text("page.css"),
        program=_page_text("motion.js") + _page_text("page.js"),
        failure=failure,
        parameters="".join(rows),
        species_list="".join(legend),
    )


def parameters(contents: H5MDContents) -> Rows:
    """System, method and potentials, in the units of the system; times and rates in ps, or τ."""
    system = contents.system
    rows = [row for row in system.display_rows() if row[0] != "units"]
    known = {"system", "cell", "constraints"}  # these are in rows
    return rows + [row for row in contents.scene_in_words() if row[0] not in known]


def known_to_the_program(story: Story) -> dict[str, Any]:
    """The data for the program of the page, other than the counts: see motion.js."""
    motion = story.motion
    system = story.contents.system
    units = system.units
    record = motion.contents.record
    cell = motion.contents.system.cell
    times = record.time[motion.frames] * units.to_picosecond
    temperatures = record.temperature[motion.frames].tolist()
    return {
        "low": motion.low.tolist(),
        "width": motion.width.tolist(),
        "lattice": cell.lattice.tolist(),
        "edges": np.where(cell.pbc[:, None], cell.vectors, cell.lattice).tolist(),
        "reduction": (cell.reduction + np.diag(~cell.pbc)).tolist(),
        "periodic": cell.pbc.tolist(),
        "box": cell.vectors[np.any(cell.vectors != 0.0, axis=1)].tolist(),
        "steps": record.step[motion.frames].tolist(),
        "times": times.tolist(),
        "temperatures": [value if np.isfinite(value) else None for value in temperatures],
        "units": {
            "time": units.shown_time,
            "temperature": units.temperature,
            "length": units.length,
        },
        "radii": (0.5 * motion.apart).tolist(),
        "colors": colors(system.species_names),
        "marked": np.searchsorted(motion.atoms, story.marked).tolist(),
        "names": [str(atom) for atom in story.marked],
    }


def colors(species: Sequence[Any]) -> list[str]:
    """A color for each species: the usual one of an element, else one of the others in turns."""
    return [ELEMENTS.get(str(name), OTHERS[k % len(OTHERS)]) for k, name in enumerate(species)]


def b64(array: NDArray[Any], kind: str) -> str:
    """An array as base64 text, with numbers of the given type."""
    return b64encode(np.ascontiguousarray(array, dtype=kind).tobytes()).decode()


def _page_text(name: str) -> str:
    return (files("minimd.view") / "page" / name).read_text(encoding="utf-8")
