"""What the core asks of annexes, by name: the face says where it is, so that the core imports none of them."""

from importlib import import_module
from typing import Any

_PLACES: dict[str, str] = {}


def provide(what: str, place: str) -> None:
    """Say where something is: place = "module:name"."""
    _PLACES[what] = place


def from_annex(what: str) -> Any:
    """The object, whose module is loaded if it is not yet.
    Raises KeyError for what the face does not provide."""
    module, _, name = _PLACES[what].partition(":")
    return getattr(import_module(module), name)
