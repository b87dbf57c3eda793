"""minimd's docstrings, plain text for help() with indented formulas and one argument a line, as reStructuredText."""

import re
from collections.abc import Iterator

SECTION = re.compile(r"^(Parameters|Attributes|Returns|Raises|Yields|Notes)\n-+\n", re.M)
ENTRY = re.compile(r"^(?P<names>\*{0,2}[A-Za-z_][\w.]*(?:, \*{0,2}[A-Za-z_][\w.]*)*) : ")
NAMES = ENTRY.pattern[1:].replace("?P<names>", "?:")
BEFORE_ENTRIES = re.compile(rf"^(?!{NAMES}|[-\s])(.+\n)(?={NAMES})", re.M)  # a line of prose
BETWEEN_ENTRIES = re.compile(r"(?<=[.;])  +(?=[A-Za-z_][\w.]*(?:, [A-Za-z_][\w.]*)* : )")
ALIGNED = re.compile(r"\S {3,}\S")  # columns: a formula and its name
INITIAL = re.compile(
    r"^(?:[A-Za-z]\.|\([A-Za-z]\))(?= |$)"
)  # of a name; reStructuredText would take it for the letter of a list
BETWEEN_SECTIONS = re.compile(r"\n\s*\n")


def escaped(text: str) -> str:
    """A line of plain text in which reStructuredText finds no markup; what stands between backquotes becomes code."""
    parts = text.split("`")
    if len(parts) % 2 == 0:
        return _without_markup(text).replace("`", r"\`")
    return "".join(
        f"``{part}``" if k % 2 and part.strip() == part and part else _without_markup(part)
        for k, part in enumerate(parts)
    )


def _without_markup(text: str) -> str:
    return re.sub(r"_(?=\W|$)", r"\\_", re.sub(r"([\\*|])", r"\\\1", text))


def entries(lines: list[str]) -> Iterator[str]:
    """A definition list of lines "name : text", several of which may share a line; other lines go on with the last."""
    found: list[list[str]] = []
    for line in (part for whole in lines for part in BETWEEN_ENTRIES.split(whole)):
        if match := ENTRY.match(line):
            found.append([match["names"], line[match.end() :]])
        elif found:
            found[-1].append(line.strip())
        else:
            yield from (escaped(line), "")
    for names, *text in found:
        yield ", ".join(f"``{name}``" for name in names.split(", "))
        yield "    " + INITIAL.sub(r"\\\g<0>", escaped(" ".join(text)))
        yield ""


def _block(block: str) -> Iterator[str]:
    lines = block.split("\n")
    if match := SECTION.match(block):
        yield from (f".. rubric:: {match[1]}", "", *entries(lines[2:]))
    elif all(line.startswith("  ") for line in lines) or (
        not ENTRY.match(lines[0]) and any(ALIGNED.search(line) for line in lines)
    ):
        yield from (".. code-block:: text", "", *(f"    {line}" for line in lines), "")
    elif ENTRY.match(lines[0]):
        yield from (*entries(lines), "")
    elif re.match(r"[-*] |\d+\. ", lines[0]):
        yield from (re.sub(r"^(\s*(?:[-*] |\d+\. )?)(.*)$", lambda m: m[1] + escaped(m[2]), line) for line in lines)
        yield ""
    else:
        yield from (INITIAL.sub(r"\\\g<0>", escaped(lines[0])), *(escaped(line) for line in lines[1:]), "")


def as_rst(text: str) -> list[str]:
    """The lines of a docstring as reStructuredText."""
    blocks = BETWEEN_SECTIONS.split(BEFORE_ENTRIES.sub(r"\1\n", text.strip("\n")))
    return [line for block in blocks for line in _block(block)]


def process(_app: object, _what: str, _name: str, _obj: object, _options: object, lines: list[str]) -> None:
    """For Sphinx' event autodoc-process-docstring: changes lines in place."""
    lines[:] = as_rst("\n".join(lines))
