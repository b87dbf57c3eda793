"""Changes of pages on their way into the site: examples and tests become links, code fits into its frame."""

import re
from functools import cache
from os.path import relpath
from pathlib import Path

REPOSITORY = Path(__file__).parents[2]
COLUMNS = 110  # of a frame with code
SHORT = 28  # letters of a test's name
FENCED = re.compile(r"^(```.*?^```$)", re.M | re.S)
SIDE_COMMENT = re.compile(r"^( *)(\S.*?) +(# .*)$")


@cache
def places_of_tests() -> dict[str, Path]:
    """The file of each test, by its name."""
    files = sorted(REPOSITORY.glob("tests/**/test_*.py"))
    return {name: file for file in files for name in re.findall(r"^def (test_\w+)", file.read_text("utf-8"), re.M)}


def link(match: re.Match, folder: Path) -> str:
    """`examples/kepler.py` as a link to its page, `test_...` as one to its file; other code as it is."""
    name = match[1]
    if (REPOSITORY / name).is_file() and re.fullmatch(r"examples/\w+\.(py|ipynb)", name):
        return f"[{match[0]}]({relpath(REPOSITORY / 'docs/gallery', folder)}/{Path(name).stem}.rst)"
    if name in places_of_tests():
        words = name if len(name) <= SHORT else f"{name[:SHORT]}…"
        return f"[`{words}`]({relpath(places_of_tests()[name], folder)})"
    return match[0]


def narrow(code: str) -> str:
    """Side comments, if one leaves the frame, nearer to their lines, in one column, or else above them."""
    parts = [(line, SIDE_COMMENT.match(line)) for line in code.split("\n")]
    if not any(found and len(line) > COLUMNS for line, found in parts):
        return code
    column = max(len(found[1] + found[2]) for _, found in parts if found) + 2
    fits = all(column + len(found[3]) <= COLUMNS for _, found in parts if found)
    beside = (f"{(found[1] + found[2]).ljust(column)}{found[3]}" if found else line for line, found in parts)
    above = (f"{found[1]}{found[3]}\n{found[1]}{found[2]}" if found else line for line, found in parts)
    return "\n".join(beside if fits else above)


BUILT = {"](../examples)": "](gallery/index.rst)", "](../course)": "](course/index.rst)"}  # pages made of folders


def prepare(app: object, name: str, source: list[str]) -> None:
    """For Sphinx' event source-read: changes the text of a Markdown page in place."""
    path = Path(app.env.doc2path(name))
    if path.suffix == ".md":
        for folder, page in BUILT.items():
            source[0] = source[0].replace(folder, page)
        source[0] = "".join(
            narrow(part) if k % 2 else re.sub(r"(?<![`\[])`([\w/.]+)`(?!`)", lambda m: link(m, path.parent), part)
            for k, part in enumerate(FENCED.split(source[0]))
        )
