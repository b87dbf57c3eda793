"""Many runs: the members of an ensemble are run by any executor, each with its own file;
a table holds their averages."""

from minimd.core.console.lazy import LazyNames

_names = LazyNames(__name__)
__getattr__ = _names.load
__dir__ = _names.listed
__all__ = [*_names.places]
