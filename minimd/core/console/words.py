"""Words of messages: names that are near, lists of names, values shortened, texts that a terminal may show."""

from collections.abc import Iterable
from difflib import SequenceMatcher
from typing import Any

SHOWN = 80  # characters of a value in a message
MOST_WRONG = 2  # letters of a misspelt name; one of a name as short as Al for Ar


def near(name: Any, known: Iterable[Any]) -> str:
    """The words "did you mean ...?" with the known name that has the fewest other letters, two at most, upper and lower
    case alike; empty if there is none."""
    if not isinstance(name, str):
        return ""
    texts = [(_letters_wrong(name, text), text) for text in known if isinstance(text, str)]
    wrong, meant = min(texts, default=(len(name) + 1, ""))
    return f"; did you mean {meant!r}?" if wrong <= min(MOST_WRONG, (len(name) + 1) / 3) else ""


def _letters_wrong(name: str, meant: str) -> int:
    """How many letters of the longer name have no equal one, in the same order, in the other."""
    blocks = SequenceMatcher(
        None, name.lower(), meant.lower(), autojunk=False
    ).get_matching_blocks()
    return max(len(name), len(meant)) - sum(block.size for block in blocks)


def listed(names: Iterable[Any]) -> str:
    """The names, with commas between them."""
    return ", ".join(map(repr, names))


def printable(text: str) -> str:
    """A text of a file, with escapes in place of characters that a terminal would obey, or that reorder others;
    ends of lines are kept."""
    return "".join(
        char if char.isprintable() or char == "\n" else char.encode("unicode_escape").decode()
        for char in text
    )


def shown(value: Any) -> str:
    """A value as Python writes it, in one line, shortened."""
    try:
        text = " ".join(repr(value).split())
    except Exception:
        # whatever an object of the user's raises, or an integer of more digits than Python writes
        text = f"an object of type {type(value).__name__}"
    return text if len(text) <= SHOWN else text[: SHOWN - 4] + " ..."
