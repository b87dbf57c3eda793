"""Public names: the methods for atoms, and those of the textbook."""

from minimd.core.console.lazy import lazily

__path__: list[str] = []  # modules of the folder that was here are found elsewhere, see moved.py
__getattr__, __dir__, __all__ = lazily(__name__, __file__)
