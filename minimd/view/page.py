"""The page itself: one HTML file that contains style, program, numbers and pictures."""

import html
import json
from base64 import b64encode
from collections.abc import Sequence
from importlib.resources import files
from string import Template
from typing import Any

import numpy as np
from numpy.typing import NDArray

from minimd.compiled.machine import version
from minimd.console.display import Rows
from minimd.view.motion import Motion
from minimd.view.stories import Story

# of Corey, Pauling and Koltun
ELEMENTS = {
    "H": "#dcdcdc", "C": "#5f6670", "N": "#3a5fcd", "O": "#d0342c", "F": "#6fbf4b", "Cl": "#2e9e3f", "S": "#d9b310",
    "P": "#e07b00", "Cu": "#c77b3f", "Ar": "#4fa7b8",
}  # fmt: skip
# in turns, for species without a usual color
OTHERS = "#4a7fc1", "#d98032", "#3f9f6f", "#b0599f", "#c9a227", "#7a6fc9", "#4fa7b8", "#a3504a"


def page(story: Story) -> str:
    """A story as HTML."""
    motion, system = story.motion, story.contents.system
    known = {
        "frames": b64(motion.counts, "<u2"),
        "species": b64(system.species_index[motion.atoms], "<u4"),
        "bonds": b64(motion.bonds, "<u4"),
        # safe inside a script element
        "about": json.dumps(about(story), allow_nan=False, separators=(",", ":")).replace("<", "\\u003c"),
        "picture": f"data:{story.picture[0]};base64,{b64encode(story.picture[1]).decode()}",
        "library": _text("ngl.js").partition("//# sourceMappingURL")[0],  # which developer tools would request
        "library_licenses": html.escape(_text("ngl-licenses.txt")),
        "style": _text("page.css"),
        "program": _text("motion.js") + _text("page.js"),
        "failure": failure(story.cause),
        "notes": " ".join(html.escape(words) for words in story.notes),
        "parameters": table(story.parameters),
        "species_list": legend(motion, system.species_names, system.species_index),
        "version": html.escape(version("minimd")),
    }
    words = {name: html.escape(getattr(story, name)) for name in ("title", "heading", "alternative", "report")}
    return Template(_text("page.html")).substitute(known, **words)


def about(story: Story) -> dict[str, Any]:
    """The data for the program of the page, other than the counts: see motion.js."""
    motion, system, units = story.motion, story.contents.system, story.contents.system.units
    cell, place = motion.cell, {int(atom): k for k, atom in enumerate(motion.atoms)}
    lists = {
        **{name: getattr(motion, name) for name in ("low", "width", "steps", "times")},
        "lattice": cell.lattice,
        "edges": np.where(cell.pbc[:, None], cell.vectors, cell.lattice),
        "reduction": cell.reduction + np.diag(~cell.pbc),
        "periodic": cell.pbc,
        "box": cell.vectors[np.any(cell.vectors != 0.0, axis=1)],
        "radii": 0.5 * motion.apart,
    }
    return {name: array.tolist() for name, array in lists.items()} | {
        "temperatures": [value if np.isfinite(value) else None for value in motion.temperatures.tolist()],
        "units": {"time": units.shown_time, "temperature": units.temperature, "length": units.length},
        "colors": colors(system.species_names),
        "marked": [place[atom] for atom in story.marked],
        "names": [str(atom) for atom in story.marked],
    }


def colors(species: Sequence[Any]) -> list[str]:
    """A color for each species: the usual one of an element, else one of the others in turns."""
    return [ELEMENTS.get(str(name), OTHERS[k % len(OTHERS)]) for k, name in enumerate(species)]


def legend(motion: Motion, names: Sequence[Any], index: NDArray[np.int64]) -> str:
    """Species, colors and numbers as items of a list."""
    rows = zip(names, colors(names), np.bincount(index, minlength=len(names)), strict=True)
    return "".join(
        f'<li><svg viewBox="0 0 10 10" aria-hidden="true"><circle cx="5" cy="5" r="4.5" fill="{color}"/></svg> '
        f"{html.escape(str(name))} ({n})</li>"
        for name, color, n in rows
    )


def table(rows: Rows) -> str:
    """Names and words as rows of a table."""
    cells = ((html.escape(name), html.escape(words)) for name, words in rows)
    return "".join(f'<tr><th scope="row">{name}</th><td>{words}</td></tr>' for name, words in cells)


def failure(cause: Sequence[str]) -> str:
    """The box with the reason why a run failed; empty if it did not fail."""
    if not cause:
        return ""
    first, advice, fault = (html.escape(words) for words in cause)
    lines = f"<p><strong>{first}</strong></p><p>What to do: {advice}.</p><p>What happened: {fault}.</p>"
    return f'<section class="failure"><h2>Why it failed</h2>{lines}</section>'


def b64(array: NDArray[Any], kind: str) -> str:
    """An array as base64 text, with numbers of the given type."""
    return b64encode(np.ascontiguousarray(array, dtype=kind).tobytes()).decode()


def _text(name: str) -> str:
    return (files("minimd.view") / "page" / name).read_text(encoding="utf-8")
