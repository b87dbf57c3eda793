"""One file, one run: who comes second is refused, and touches nothing of the first."""

import os
import threading

import numpy as np
import pytest
from h5md_runs import bring_to_disk_every, resumed, simulation

from minimd.files.claim import Claim
from minimd.files.h5md_reader import read_file
from minimd.files.trajectory import open_trajectories

FORMATS = ["a.h5md", "a.xtc", "a.dcd", "a.trr", "a.ncdf", "a.traj", "a.xyz"]


def files_of(folder):
    return sorted(path.name for path in folder.iterdir())


@pytest.mark.parametrize("name", FORMATS)
@pytest.mark.parametrize("overwrite", [False, True])
def test_a_second_run_is_refused_and_the_first_goes_on(name, overwrite, tmp_path):
    path, refused = tmp_path / name, []
    if overwrite:
        path.write_text("an older file")

    def second(sim):
        with pytest.raises((OSError, ValueError)) as failure:
            simulation().run(10, every=5, trajectory=path, overwrite=sim.step > 5)
        refused.append(str(failure.value))

    simulation().run(20, every=5, trajectory=path, overwrite=overwrite, observers=[second])
    assert len(refused) == 5
    assert "another run is writing it" in refused[-1]
    assert files_of(tmp_path) == [name]
    if name == "a.h5md":
        assert read_file(path).record.step.tolist() == [0, 5, 10, 15, 20]


@pytest.mark.parametrize("name", FORMATS)
def test_what_is_replaced_is_kept_until_the_first_frame(name, tmp_path):
    path = tmp_path / name
    path.write_text("precious")
    with open_trajectories(path, simulation().engine, store_forces=False, overwrite=True):
        assert path.read_text() == "precious"
    assert path.read_text() == "precious"
    assert files_of(tmp_path) == [name]


def test_links_to_a_file_are_that_file(tmp_path):
    (tmp_path / "elsewhere").mkdir()
    (tmp_path / "link.h5md").symlink_to(tmp_path / "elsewhere" / "a.h5md")
    with pytest.raises(ValueError, match="are the same file: name it once"):
        simulation().run(10, trajectory=[tmp_path / "link.h5md", tmp_path / "elsewhere" / "a.h5md"])
    simulation().run(10, every=5, trajectory=tmp_path / "link.h5md")
    assert (tmp_path / "link.h5md").is_symlink()
    assert read_file(tmp_path / "elsewhere" / "a.h5md").n_frames == 3

    def second(_sim):
        with pytest.raises(OSError, match="another run is writing it"):
            simulation().run(1, trajectory=tmp_path / "elsewhere" / "a.h5md", overwrite=True)

    simulation().run(5, every=5, trajectory=tmp_path / "link.h5md", overwrite=True, observers=[second])
    assert read_file(tmp_path / "link.h5md").n_frames == 2


def test_of_two_threads_one_writes(tmp_path):
    path, outcomes, both = tmp_path / "a.h5md", [], threading.Barrier(2)

    def run():
        sim = simulation()
        both.wait()
        try:
            sim.run(40, every=1, trajectory=path)
            outcomes.append("written")
        except OSError as error:
            outcomes.append(str(error))

    threads = [threading.Thread(target=run) for _ in range(2)]
    for one in threads:
        one.start()
    for one in threads:
        one.join()
    assert sorted(one == "written" for one in outcomes) == [False, True], outcomes
    assert read_file(path).n_frames == 41


@pytest.mark.parametrize("name", FORMATS)
def test_a_pipe_is_no_trajectory(name, tmp_path):
    os.mkfifo(tmp_path / name)
    with pytest.raises(ValueError, match="must be a regular file"):
        simulation().run(1, trajectory=tmp_path / name, overwrite=True)


@pytest.mark.parametrize("fate", ["removed", "replaced", "cut"])
def test_a_file_that_is_lost_under_the_run_is_told(fate, tmp_path, monkeypatch):
    bring_to_disk_every(0.0, monkeypatch)
    path = tmp_path / "a.h5md"

    def meddle(sim):
        if sim.step == 10 and fate == "cut":
            os.truncate(path, 1000)
        elif sim.step == 10:
            path.unlink()
            if fate == "replaced":
                path.write_text("mine")

    with pytest.raises(OSError, match=rf"could not take the frame of step 15: it was {fate}"):
        simulation().run(30, every=5, trajectory=path, observers=[meddle])
    assert fate != "replaced" or path.read_text() == "mine"
    assert files_of(tmp_path) == ([] if fate == "removed" else ["a.h5md"])


def test_a_resumed_file_is_claimed_too(tmp_path):
    path = tmp_path / "a.h5md"
    simulation().run(10, every=5, trajectory=path)
    claim = Claim(path, is_new=False)
    with pytest.raises(OSError, match="another run is writing it"):
        resumed(path).run(10, trajectory=path, append=True)
    claim.release()
    sim = resumed(path)
    sim.run(10, every=5, trajectory=path, append=True)
    np.testing.assert_array_equal(read_file(path).system.positions, sim.positions)


def test_only_what_holds_a_restart_can_be_appended_to(tmp_path):
    simulation().run(10, trajectory=tmp_path / "a.xtc")
    with pytest.raises(ValueError, match=r"only \.h5md files can be appended to"):
        simulation().run(10, trajectory=tmp_path / "a.xtc", append=True)
