"""Many runs: the members of an ensemble are run by any executor, each with its own file;
a table holds their averages."""

from minimd.core.console.lazy import lazily

__getattr__, __dir__, __all__ = lazily(__name__, __file__)
