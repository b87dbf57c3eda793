"""Writes the lists of public names: in each page of docs/reference/, and the last table of docs/where-is.md.

    python docs/write_names.py

A list stands between two marks in its page. Names and sentences come from minimd itself.
"""

import inspect
import re
from importlib import import_module
from pathlib import Path

from minimd.foreign_words import entries

DOCS = Path(__file__).parent
MARKS = "<!-- names -->", "<!-- end of names -->"
DIRECTIVE = re.compile(
    r"^\.\. (automodule|autoclass|autofunction|autoexception|currentmodule):: (\S+)\n((?:   .*\n)*)", re.M
)
CODE = re.compile(r"\b(?:md|sim|record|minimd)\.[\w.]*\w(?:\([^()]*(?:\([^()]*\)[^()]*)*\))?")


def sentence(item: object) -> str:
    """The first sentence of a docstring, as Markdown in a table."""
    first = " ".join((inspect.getdoc(item) or "").partition("\n\n")[0].split())
    first = re.split(r"(?<=[.;:]) +(?=\w+ : )|(?<=\.) +(?=[A-Z])|(?<=\)); +(?=see )", first)[0].rstrip(".;:")
    return re.sub(r"([|*$<])", r"\\\1", first)


def members(name: str, item: object) -> list[tuple[str, object]]:
    """The public attributes of a class that have a docstring."""
    own = vars(item).items() if inspect.isclass(item) else ()
    return [(f"{name}.{key}", value) for key, value in own if is_told(key, value)]


def is_told(key: str, value: object) -> bool:
    """Whether an attribute of a class is public and has a docstring of its own; arrays have one in some of NumPy's
    versions."""
    is_of_its_type = inspect.getdoc(value) == inspect.getdoc(type(value))
    is_code = callable(value) or hasattr(value, "__get__")
    return key[0] != "_" and is_code and not is_of_its_type and sentence(value) not in ("", "See Displayed")


def names_on(text: str) -> list[tuple[str, object]]:
    """What a page of the reference shows, by name, in its order."""
    found, module = [], "minimd"
    for kind, name, options in DIRECTIVE.findall(text):
        if kind == "currentmodule":
            module = name
        elif kind == "automodule":
            there = import_module(name)
            listed = re.search(r":members: (.+)", options)
            chosen = (
                listed[1].split(", ") if listed else getattr(there, "__all__", ()) if ":members:" in options else ()
            )
            found += [(one, getattr(there, one)) for one in chosen]
        else:
            item = getattr(import_module(module), name)
            found += [(name, item), *(members(name, item) if ":members:" in options else ())]
    return [(name, item) for name, item in found if "." in name or callable(item)]


def with_names(text: str) -> str:
    """A page of the reference with its list."""
    rows = [f"| `{name}` | {sentence(item)} |" for name, item in names_on(text)]
    return filled(text, ["| name | |", "| --- | --- |", *rows])


def where_is(text: str) -> str:
    """The page "where is ...?" with its last table."""
    rows = []
    for words, answer, page in entries():
        answer = CODE.sub(lambda match: f"`{match[0]}`", answer)
        rows.append(f"| {', '.join(words)} | {answer} | [{page}]({page}.md) |")
    return filled(text, ["| word | here | page |", "| --- | --- | --- |", *rows])


def filled(text: str, lines: list[str]) -> str:
    """A text with other lines between its marks; those of a page without marks follow its title."""
    if MARKS[0] not in text:
        title, _, rest = text.partition("\n")
        text = f"{title}\n\n{MARKS[0]}\n{MARKS[1]}\n{rest}"
    before, _, rest = text.partition(MARKS[0])
    return f"{before}{MARKS[0]}\n" + "\n".join(lines) + f"\n{MARKS[1]}{rest.partition(MARKS[1])[2]}"


def pages() -> dict[Path, str]:
    """The pages as they should be, by their files."""
    reference = sorted(page for page in (DOCS / "reference").glob("*.md") if page.stem != "index")
    texts = {page: with_names(page.read_text(encoding="utf-8")) for page in reference}
    page = DOCS / "where-is.md"
    return texts | {page: where_is(page.read_text(encoding="utf-8"))}


if __name__ == "__main__":
    for page, text in pages().items():
        page.write_text(text, encoding="utf-8")
