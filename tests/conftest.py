"""Hypothesis draws the same scenes in every run, without a deadline: the first call compiles. Ctrl-C is not ignored, as it is behind nohup."""

import signal

from hypothesis import settings

settings.register_profile("minimd", deadline=None, derandomize=True, max_examples=100)
settings.load_profile("minimd")
signal.signal(signal.SIGINT, signal.default_int_handler)  # minimd leaves signals alone that are ignored, and tests raise them
