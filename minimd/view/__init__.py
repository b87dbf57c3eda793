"""What is made of the file of a run: its page with atoms in motion, its pictures, its check."""

from minimd.core.console.lazy import LazyNames

_names = LazyNames(__name__)
__getattr__ = _names.load
__dir__ = _names.listed
__all__ = [*_names.places]
