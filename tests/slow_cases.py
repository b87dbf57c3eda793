"""Tests most of whose cases are slow: with all of them the suite would take more than five minutes."""

from pathlib import Path

TABLE = Path(__file__).parent / "data" / "slow_tests.txt"


def quick_cases():
    """How many cases of a test are not slow, by its file and name, of the tests that take long."""
    file = ""
    for line in TABLE.read_text(encoding="utf-8").splitlines()[1:]:
        if line.startswith(" "):
            name, n_quick = line.split()
            yield f"{file}::{name}", int(n_quick)
        else:
            file = line.rstrip(":")
