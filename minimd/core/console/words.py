"""Words of messages: names that are near, lists of names, values shortened, texts that a terminal may show."""

from collections.abc import Iterable
from difflib import get_close_matches
from typing import Any

SHOWN = 80  # characters of a value in a message
SIMILAR = 0.5  # of the letters are the same, as of Ar and Al


def near(name: Any, known: Iterable[Any]) -> str:
    """The words "did you mean ...?" with the most similar of the known names; empty if none is similar."""
    texts = [text for text in known if isinstance(text, str)]
    matches = get_close_matches(name, texts, n=1, cutoff=SIMILAR) if isinstance(name, str) else []
    return f"; did you mean {matches[0]!r}?" if matches else ""


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
