"""Public names: potentials, and what a term of your own needs."""

import sys

from minimd.core.console.lazy import LazyNames

__path__: list[str] = []  # modules of the folder that was here are found elsewhere, see moved.py
_names = LazyNames(__name__)
__getattr__, __dir__, __all__ = _names.load, _names.listed, [*_names.places]
sys.modules[__name__].__class__ = type(sys.modules["minimd"])  # water stays the function
