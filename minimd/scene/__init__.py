"""Whole scenes: files in TOML with units in their keys, as examples/argon.toml; water."""

from minimd.core.console.lazy import LazyNames

_names = LazyNames(__name__)
__getattr__, __dir__, __all__ = _names.load, _names.listed, [*_names.places]
