"""Warnings that are passed over, in one thread alone."""

import threading
import warnings

from minimd.structure.quiet import quiet


def test_warnings_are_passed_over_in_one_thread_alone():
    """Also where contexts of two threads end in the order in which they began: catch_warnings would ignore all."""
    inside, leave = threading.Event(), threading.Event()

    def elsewhere():
        with quiet():
            inside.set()
            leave.wait(10.0)
            warnings.warn("nobody hears this", stacklevel=1)

    with warnings.catch_warnings(record=True) as told:
        warnings.simplefilter("always")
        with quiet():
            other = threading.Thread(target=elsewhere)
            other.start()
            inside.wait(10.0)
            warnings.warn("nor this", stacklevel=1)
        warnings.warn("but this", stacklevel=1)
        leave.set()
        other.join()
        warnings.warn("and this", stacklevel=1)
    assert [str(one.message) for one in told] == ["but this", "and this"]
