"""Public names: the methods for atoms, and those of the textbook."""

from minimd.core.console.lazy import LazyNames

__path__: list[str] = []  # modules of the folder that was here are found elsewhere, see moved.py
_names = LazyNames(__name__)
__getattr__ = _names.load
__dir__ = _names.listed
__all__ = [*_names.places]
