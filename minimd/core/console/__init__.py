"""Where minimd meets its user: words of messages, progress, signals, display. No physics."""

__version__ = "0.2.0"  # of minimd: pyproject.toml reads it here
