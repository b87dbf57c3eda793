"""Hypothesis draws the same scenes in every run, without a deadline: the first call compiles. Signals are not ignored, as behind nohup.

BLAS has one thread, in the workers and in the processes that tests start: matrices here are small, and its threads would spend a third of the
processor time waiting for each other on the cores that tests share.
"""

import os
import signal

from hypothesis import settings

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # before anybody imports numpy
settings.register_profile("minimd", deadline=None, derandomize=True, max_examples=100)
settings.load_profile("minimd")
signal.signal(
    signal.SIGINT, signal.default_int_handler
)  # minimd leaves signals alone that are ignored, and tests raise them
signal.signal(signal.SIGHUP, signal.SIG_DFL)
