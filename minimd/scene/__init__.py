"""Whole scenes: files in TOML with units in their keys, as examples/argon.toml; water."""

from minimd.core.console.lazy import lazily

__getattr__, __dir__, __all__ = lazily(__name__, __file__)
