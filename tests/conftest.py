"""Hypothesis draws the same scenes in every run, without a deadline: the first call compiles."""

from hypothesis import settings

settings.register_profile("minimd", deadline=None, derandomize=True, max_examples=100)
settings.load_profile("minimd")
