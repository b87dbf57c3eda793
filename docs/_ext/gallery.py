"""What the gallery shows: copies of the examples with a title, so that a build writes nothing beside the originals."""

import re
import shutil
from collections.abc import Sequence
from pathlib import Path

from plain_docstrings import as_rst
from sphinx_gallery.scrapers import figure_rst
from write_notebook import parts

FONT_SIZE = 14  # of pictures that are shown at three fifths of their size
# In this order; an example that is not named here comes last.
THEMES = {
    "The first hour": "notebook",
    "Liquids": "liquid_argon constant_pressure equation_of_state viscosity live mixture spce_water",
    "Metals": "metal",
    "Heat baths and ensembles": "thermostats ensemble_checks stretched_chain path_integrals",
    "Molecules and rigid bonds": "rigid_nitrogen timestep_gain bead_chain rigid_chain rigid_ring",
    "Laws and forces of your own": "own_law own_force compiled_force compiled_drag",
    "To the last bit, and how smooth": "to_the_last_bit droplet_born precision smooth_cutoff",
    "Planets and stars": "kepler kepler_reversed adaptive_kepler outer_solar_system three_body henon_heiles "
    "work_precision",
    "Mechanisms": "pendulum stiff_spring mechanism coupled_wells",
}
ORDER = " ".join(THEMES.values()).split()
CARD = """.. raw:: html

    <div class="sphx-glr-thumbcontainer\""""
DIVISION = """.. raw:: html

    </div>

{title}
{line}

.. raw:: html

    <div class="sphx-glr-thumbnails">

"""
# Worker processes import the script that made them, which Sphinx runs under another name.
WORKERS = """
# sphinx_gallery_start_ignore
import sys

sys.modules["__main__"].__spec__ = None
sys.modules["__main__"].__file__ = {path!r}
# sphinx_gallery_end_ignore
"""


def with_title(text: str, path: Path) -> str:
    """A script whose docstring begins with a title: its first words, up to a comma, a colon or the end of a question.

    A script that has such a title already is left as it is.
    """
    docstring, code = text[3:].split('"""', 1)
    if "\n====" in docstring:
        return text
    title = re.match(r"[^,:?\n]+\??", docstring)[0].rstrip(".")
    workers = WORKERS.format(path=str(path)) if "__main__" in code else ""
    head = [title, "=" * len(title), "", *as_rst(docstring)]
    return 'r"""\n' + "\n".join(head).rstrip() + f'\n"""\n{workers}{code}'


def script_of(page: Path) -> str:
    """The cells of a page as a script for sphinx-gallery, whose comments are reStructuredText.

    Links to headings lead to their pages.
    """
    (_, head), *cells = parts(page.read_text(encoding="utf-8"))
    title, _, text = head.removeprefix("# ").partition("\n")
    blocks = [f'r"""\n{title}\n{"=" * len(title)}\n{restructured(text)}\n"""']
    for kind, cell in cells:
        comment = "\n".join(f"# {line}".rstrip() for line in restructured(cell).splitlines())
        blocks.append(cell if kind == "code" else f"# %%\n{comment}")
        if kind == "code":
            blocks.append("# %%")
    return "\n\n".join(blocks) + "\n"


def restructured(text: str) -> str:
    """Paragraphs, headings, links and code of Markdown as reStructuredText."""
    text = re.sub(r"`([^`]+)`", r"``\1``", text)
    text = re.sub(r"\[([^\]]+)\]\(([\w-]+)\.md(?:#[\w-]+)?\)", r":doc:`\1 <../\2>`", text)
    text = re.sub(r"\[([^\]]+)\]\(\.\./(\w+)\)", r"\1", text)
    return re.sub(r"^## (.*)$", lambda match: f"{match[1]}\n{'-' * len(match[1])}", text, flags=re.M)


def prepare(source: Path, target: Path, header: str, pages: Sequence[Path] = ()) -> str:
    """Copy the scripts of a folder to another, which sphinx-gallery reads, and return it.

    A copy that is up to date is left alone.
    header : the text above the scripts, unless the folder has one in README.rst.
    pages : that are scripts, too: each with its cells.
    """
    target.mkdir(parents=True, exist_ok=True)
    for path in target.glob("*.png"):
        path.unlink()  # see saved_pictures
    texts = {
        path.name: with_title(path.read_text(encoding="utf-8"), target / path.name)
        for path in sorted(source.glob("*.py"))
    }
    texts |= {page.with_suffix(".py").name: script_of(page) for page in pages}
    own_header = source / "README.rst"
    texts["GALLERY_HEADER.rst"] = own_header.read_text(encoding="utf-8") if own_header.exists() else header
    for path in target.glob("*.py"):
        if path.name not in texts:
            path.unlink()
    for name, text in texts.items():
        path = target / name
        if not path.exists() or path.read_text(encoding="utf-8") != text:
            path.write_text(text, encoding="utf-8")
    return str(target)


def escape_bars(_app: object, name: str, source: list[str]) -> None:
    """For Sphinx' event source-read: |v| in the prose of a script is the length of v, and no substitution."""
    if name.startswith(("gallery/", "course/")):
        lines = source[0].split("\n")
        prose = (line[:1] not in (" ", ".", "|", "") and "``" not in line and ":math:" not in line for line in lines)
        source[0] = "\n".join(
            re.sub(r"(?<!\\)\|", r"\|", line) if is_prose else line for line, is_prose in zip(lines, prose, strict=True)
        )


def by_theme(name: str) -> tuple[int, str]:
    """For within_subsection_order of sphinx-gallery: the place of a script."""
    return ORDER.index(Path(name).stem) if Path(name).stem in ORDER else len(ORDER), name


def divide(_app: object, name: str, source: list[str]) -> None:
    """For Sphinx' event source-read: a heading above the cards of each theme."""
    if name == "gallery/index":
        head, *cards = source[0].split(CARD)
        last, parts = "", [head]
        for card in cards:
            script = re.search(r"sphx_glr_(\w+)_thumb", card)[1]
            title = next((one for one, names in THEMES.items() if script in names.split()), "More")
            parts.append((DIVISION.format(title=title, line="-" * len(title)) if title != last else "") + CARD + card)
            last = title
        source[0] = "".join(parts)


n_pictures: dict[str, int] = {}  # of a script, of all blocks so far


def saved_pictures(_block: tuple, names: dict, conf: dict) -> str:
    """An image scraper of sphinx-gallery: what a block of a script has saved, if it has drawn nothing with pyplot."""
    script = names["src_file"]
    drawn, moved = len(names["image_path_iterator"]) > n_pictures.get(script, 0), []
    for path in sorted(Path(script).parent.glob("*.png")):
        if drawn:
            path.unlink()
        else:
            moved.append(shutil.move(path, next(names["image_path_iterator"])))
    n_pictures[script] = len(names["image_path_iterator"])
    return figure_rst(moved, conf["src_dir"])


def large_fonts(_conf: object, _script: str) -> None:
    """Before each example: letters in its pictures that can be read at the width of a page."""
    from matplotlib import rcParams

    rcParams["font.size"] = FONT_SIZE
