"""Whole scenes: files in TOML with units in their keys, as examples/argon.toml; water."""

from minimd.core.console.lazy import LazyNames

_names = LazyNames(__name__)
__getattr__ = _names.load
__dir__ = _names.listed
__all__ = [*_names.places]
