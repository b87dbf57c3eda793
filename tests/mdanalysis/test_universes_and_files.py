"""Universes of runs without a cell, and of files that a run goes on to write."""

import pytest
from h5md_runs import simulation
from wrong_calls import assert_answered

from minimd.mdanalysis import universe


def test_a_universe_without_a_third_vector_says_that_it_has_no_cell():
    with pytest.warns(UserWarning, match=r"has no cell.*pbc=\(True, True, False\)"):
        universe(simulation("slab without height"))


def test_a_file_that_a_universe_of_this_script_has_open_says_how_to_close_it(tmp_path):
    made, file = simulation(), tmp_path / "run.h5md"
    made.run(2, every=1, trajectory=file)
    reading = universe(file)
    assert_answered(lambda: made.run(2, every=1, trajectory=file, append=True), OSError, "universe.trajectory.close()")
    reading.trajectory.close()
    made.run(2, every=1, trajectory=file, append=True)
