"""What is made of the file of a run: its page with atoms in motion, its pictures, its check."""

from minimd.core.console.lazy import lazily

__getattr__, __dir__, __all__ = lazily(__name__, __file__)
