"""H5MD files after interrupts, kills, full disks and failed writes: valid, up to the last whole frame."""

import errno
import os
import shutil
import signal

import h5py
import numpy as np
import pytest
from h5md_runs import bring_to_disk_every, limited, opened, simulation

import minimd as md
from minimd.files import h5md_writer as h5md
from minimd.files.claim import Claim
from minimd.files.h5md_reader import read_file
from minimd.files.h5md_writer import H5MDWriter


@pytest.mark.parametrize(
    ("fault", "words"),
    [
        ("masses", "masses"),
        ("cell", "the cell"),
        ("step", "from step 10"),
        ("forces", "without forces"),
        ("units", "units"),
    ],
)
def test_appending_another_run_is_refused(tmp_path, fault, words):
    path = tmp_path / "a.h5md"
    simulation().run(10, every=5, trajectory=path)
    before = path.read_bytes()
    sim = simulation("triclinic" if fault == "cell" else "cubic", md.units.ASE if fault == "units" else md.units.LJ)
    sim.step = 0 if fault == "step" else 10
    if fault == "masses":
        object.__setattr__(sim.system, "masses", 7.0 * sim.system.masses)
    with pytest.raises(ValueError, match=words):
        H5MDWriter.append_to(path, sim.engine, store_forces=fault == "forces")
    assert path.read_bytes() == before


def test_exception_in_a_run_leaves_a_valid_file(tmp_path):
    def stop(sim):
        if sim.step == 15:
            raise RuntimeError("enough")

    with pytest.raises(RuntimeError, match="enough"):
        simulation().run(100, every=5, trajectory=tmp_path / "a.h5md", observers=[stop])
    assert read_file(tmp_path / "a.h5md").step == 15
    assert len(opened(tmp_path / "a.h5md").trajectory) == 4


def test_interrupted_run_restarts_where_it_stopped(tmp_path):
    def interrupt(sim):
        if sim.step == 15:
            signal.raise_signal(signal.SIGINT)

    sim = simulation()
    with pytest.raises(KeyboardInterrupt):
        sim.run(100, every=5, trajectory=tmp_path / "a.h5md", observers=[interrupt])
    contents = read_file(tmp_path / "a.h5md")
    assert contents.record.step.tolist() == [0, 5, 10, 15]
    assert contents.step == sim.step == 16
    np.testing.assert_array_equal(contents.system.positions, sim.positions)


def test_an_error_inside_a_write_leaves_whole_frames_only(tmp_path, monkeypatch):
    path, sim = tmp_path / "a.h5md", simulation()
    bring_to_disk_every(0.0, monkeypatch)
    writer = H5MDWriter(Claim(path), sim.engine, False)
    writer.write(sim.frame())
    sim.run(5)
    series_of = h5md.layout.series_of

    def interrupted(h5, column, frame, n_frames):
        if column.path.endswith("velocity/value"):
            raise KeyboardInterrupt
        return series_of(h5, column, frame, n_frames)

    monkeypatch.setattr(h5md.layout, "series_of", interrupted)
    with pytest.raises(KeyboardInterrupt):
        writer.write(sim.frame())
    shutil.copy(path, tmp_path / "copy.h5md")
    assert read_file(tmp_path / "copy.h5md").record.step.tolist() == [0]
    monkeypatch.setattr(h5md.layout, "series_of", series_of)
    writer.close()
    assert read_file(path).record.step.tolist() == [0, 5]


def test_file_of_a_killed_run_is_valid(tmp_path, monkeypatch):
    path, sim = tmp_path / "a.h5md", simulation()
    bring_to_disk_every(0.0, monkeypatch)
    copies = []

    def copy(sim):
        copies.append(tmp_path / f"{sim.step}.h5md")
        shutil.copy(path, copies[-1])

    sim.run(20, every=5, trajectory=path, observers=[copy])
    for number, name in enumerate(copies, start=1):
        contents = read_file(name)
        assert contents.n_frames == len(opened(name).trajectory) == number
        assert contents.step == contents.record.step[-1] == 5 * (number - 1)


def test_frames_are_flushed_once_a_second(tmp_path, monkeypatch):
    path, sim, now = tmp_path / "a.h5md", simulation(), [0.0]
    monkeypatch.setattr(h5md, "monotonic", lambda: now[0])
    found = []

    def look(_sim):
        shutil.copy(path, tmp_path / "copy.h5md")
        found.append(read_file(tmp_path / "copy.h5md").n_frames)
        now[0] += 0.4

    sim.run(30, every=5, trajectory=path, observers=[look])
    assert found == [1, 1, 1, 4, 4, 4, 7]


@pytest.mark.parametrize("way", ["limit", "patched"])
def test_full_disk_is_told_once_and_spoils_nothing(tmp_path, monkeypatch, way):
    path, sim = tmp_path / "a.h5md", simulation()
    bring_to_disk_every(0.0, monkeypatch)
    writer = H5MDWriter(Claim(path), sim.engine, True)
    written = 0

    def full(*_):
        raise OSError(errno.ENOSPC, "No space left on device")

    def write_until_full():
        nonlocal written
        for written in range(2000):
            if written == 7 and way == "patched":
                monkeypatch.setattr(os, "pwrite", full)
            writer.write(sim.frame())
            sim.step += 1

    with (
        limited(1_200_000 if way == "limit" else 2**40),
        pytest.raises(OSError, match=r"a\.h5md.*frame of step") as failure,
    ):
        write_until_full()
    monkeypatch.undo()
    writer.close()
    assert 5 < written < 2000
    assert f"{written} frames before it are valid" in str(failure.value)
    assert read_file(path).record.step.tolist() == list(range(written))
    assert len(opened(path).trajectory) == written
    assert path.stat().st_size <= 1_200_000
    with pytest.raises(ValueError, match="closed"):
        writer.write(sim.frame())


def test_failing_write_leaves_the_frames_before_it(tmp_path, monkeypatch):
    path, sim = tmp_path / "a.h5md", simulation()
    series_of = h5md.layout.series_of

    def failing(h5, column, like, n_frames):
        if sim.step == 10 and column.path.endswith("position/value"):
            raise OSError(errno.EIO, "Input/output error")
        return series_of(h5, column, like, n_frames)

    monkeypatch.setattr(h5md.layout, "series_of", failing)
    bring_to_disk_every(0.0, monkeypatch)
    with pytest.raises(OSError, match="frame of step 10: Input/output error; the 2 frames"):
        sim.run(50, every=5, trajectory=path)
    assert read_file(path).record.step.tolist() == [0, 5]


def test_files_that_are_no_runs_are_named(tmp_path):
    with pytest.raises(FileNotFoundError, match=r"missing\.h5md"):
        read_file(tmp_path / "missing.h5md")
    (tmp_path / "text.h5md").write_text("not at all")
    with pytest.raises(ValueError, match="not an HDF5 file"):
        read_file(tmp_path / "text.h5md")
    with h5py.File(tmp_path / "foreign.h5md", "w") as h5:
        h5["data"] = [1, 2]
    with pytest.raises(ValueError, match="not written by minimd"):
        read_file(tmp_path / "foreign.h5md")


def test_a_file_without_a_frame_leaves_nothing(tmp_path):
    H5MDWriter(Claim(tmp_path / "empty.h5md"), simulation().engine, False).close()
    assert list(tmp_path.iterdir()) == []


def test_end_of_a_run_inside_an_except_block_is_the_restart(tmp_path):
    sim = simulation()
    try:
        raise RuntimeError("of the caller, who then runs")
    except RuntimeError:
        sim.run(15, every=10, trajectory=tmp_path / "a.h5md")
    assert read_file(tmp_path / "a.h5md").step == 15


def test_refused_or_failed_output_leaves_nothing_of_the_others(tmp_path, monkeypatch):
    (tmp_path / "b.xyz").write_text("precious")
    with pytest.raises(FileExistsError, match=r"b\.xyz' exists"):
        simulation().run(5, trajectory=[tmp_path / "a.h5md", tmp_path / "b.xyz"])
    assert [path.name for path in tmp_path.iterdir()] == ["b.xyz"]

    closed = []
    monkeypatch.setattr(
        "minimd.files.mdanalysis_writer.MDAnalysisWriter.close", lambda self: closed.append(self.claim.release())
    )
    monkeypatch.setattr(
        "minimd.files.h5md_writer.H5MDWriter.__init__", lambda *_, **__: (_ for _ in ()).throw(OSError("no more files"))
    )
    with pytest.raises(OSError, match="no more files"):
        simulation().run(5, trajectory=[tmp_path / "a.h5md", tmp_path / "c.xtc"])
    assert closed == [None]
    assert [path.name for path in tmp_path.iterdir()] == ["b.xyz"]


def test_truncated_file_is_said_to_be_damaged(tmp_path):
    simulation().run(20, every=5, trajectory=tmp_path / "a.h5md")
    content = (tmp_path / "a.h5md").read_bytes()
    (tmp_path / "a.h5md").write_bytes(content[: len(content) // 2])
    with pytest.raises(OSError, match="it is damaged"):
        read_file(tmp_path / "a.h5md")
