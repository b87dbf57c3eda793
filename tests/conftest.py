"""Hypothesis draws the same scenes in every run, without a deadline: the first call compiles. Signals are not ignored, as behind nohup."""

import signal

from hypothesis import settings

settings.register_profile("minimd", deadline=None, derandomize=True, max_examples=100)
settings.load_profile("minimd")
signal.signal(signal.SIGINT, signal.default_int_handler)  # minimd leaves signals alone that are ignored, and tests raise them
signal.signal(signal.SIGHUP, signal.SIG_DFL)
