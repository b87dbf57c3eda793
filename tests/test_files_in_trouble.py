"""What becomes of a file, and of the run that writes it, when something comes in between."""

import os
import resource
import signal
import zlib
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
import pytest
from h5md_runs import bring_to_disk_every, resumed, simulation
from test_kills import assert_same_file

import minimd as md
from minimd.files import h5md_reader, h5md_writer, journaled_file
from minimd.files.claim import Claim
from minimd.files.h5md_reader import read_file, verify_frames


def interrupt(*_):
    raise KeyboardInterrupt


def test_a_run_after_single_steps_from_a_restored_state_has_its_restart(tmp_path):
    sim = simulation()
    sim.restore(sim.snapshot())
    sim.make_steps(10)
    sim.run(20, every=5, trajectory=tmp_path / "a.h5md")
    assert read_file(tmp_path / "a.h5md").step == sim.step == 30


def test_a_step_is_counted_before_a_restart_is_written(tmp_path, monkeypatch):
    """A second Ctrl-C may come anywhere: also between the last step of a block and its count."""
    bring_to_disk_every(0.0, monkeypatch)
    sim, path, looks = simulation(), tmp_path / "a.h5md", []

    def interrupted(engine):
        looks.append(engine.step)
        if len(looks) == 3:
            raise KeyboardInterrupt

    monkeypatch.setattr("minimd.diagnosis.run_guard.fault_of", interrupted)
    with pytest.raises(KeyboardInterrupt):
        sim.run(30, every=5, trajectory=path)
    monkeypatch.undo()
    whole = simulation()
    whole.run(read_file(path).step, every=5)
    np.testing.assert_array_equal(read_file(path).system.positions, whole.positions)


def test_what_has_a_second_name_is_not_emptied(tmp_path):
    """A run that is killed while its file gets its name may leave both."""
    path, precious = tmp_path / "a.h5md", tmp_path / "precious.h5md"
    simulation().run(10, every=5, trajectory=path)
    os.link(path, tmp_path / "a.h5md.begun")
    simulation().run(10, every=5, trajectory=path, overwrite=True)
    os.link(path, tmp_path / "a.h5md.begun")
    path.rename(precious)
    simulation().run(10, every=5, trajectory=path)
    assert_same_file(precious, path)
    assert sorted(os.listdir(tmp_path)) == ["a.h5md", "precious.h5md"]


def killed_in_a_commit(path, monkeypatch):
    """A file of 15 steps whose last commit is in its journal only."""
    simulation().run(10, every=5, trajectory=path)
    with monkeypatch.context() as patch:
        patch.setattr(journaled_file, "_apply", interrupt)
        with pytest.raises(KeyboardInterrupt):
            resumed(path).run(10, every=5, trajectory=path, append=True)


def test_a_journal_that_cannot_be_carried_out_is_told(monkeypatch):
    """A run was killed in a commit, and its file cannot be written now; its reader is not root."""
    with TemporaryDirectory(dir="/tmp") as name:
        folder, path = Path(name), Path(name) / "a.h5md"
        killed_in_a_commit(path, monkeypatch)
        path.chmod(0o444)
        folder.chmod(0o555)

        def read():
            if os.geteuid() == 0:
                os.setuid(65534)
            with pytest.raises(OSError, match=r"a\.h5md' cannot be opened: .*commit was interrupted"):
                read_file(path)

        try:
            assert in_a_child(read)
        finally:
            folder.chmod(0o755)
            path.chmod(0o666)
        assert read_file(path).step == 15


@pytest.mark.parametrize("lie", ["length", "place", "place beyond", "size", "size beyond", "before", "head", "end"])
def test_a_journal_that_nobody_wrote_changes_nothing(lie, tmp_path):
    """Its checksum is right, its numbers are not."""
    path = tmp_path / "a.h5md"
    simulation().run(10, every=5, trajectory=path)
    n = path.stat().st_size
    place = {"place": -8, "place beyond": n}.get(lie, 0)
    body = journaled_file.PIECE.pack(place, {"length": -16, "end": 5}.get(lie, 4)) + b"evil"
    body = body[:1] if lie == "head" else body
    size, before = {"size": -1, "size beyond": 2**40}.get(lie, n), 2**40 if lie == "before" else n
    head = journaled_file.END.pack(before, size, len(body), 0, journaled_file.MAGIC)
    checksum = zlib.crc32(head, zlib.crc32(body))
    with open(path, "ab") as file:
        file.write(body + journaled_file.END.pack(before, size, len(body), checksum, journaled_file.MAGIC))
    content = path.read_bytes()
    assert read_file(path).n_frames == 3
    assert path.read_bytes() == content


def test_a_method_that_takes_over_during_a_run_is_in_the_file(tmp_path):
    def shorten(sim):
        if sim.step == 10:
            sim.method = md.VelocityVerlet(0.001)

    whole, sim, path = simulation(), simulation(), tmp_path / "a.h5md"
    whole.run(40, every=5, observers=[shorten])
    sim.run(20, every=5, trajectory=path, observers=[shorten])
    again = resumed(path)
    again.run(20, every=5)
    assert again.method.timestep == 0.001
    assert again.time == whole.time
    np.testing.assert_array_equal(again.positions, whole.positions)


def test_a_bath_cannot_take_over_during_a_run(tmp_path):
    def heat(sim):
        sim.method = md.LangevinBAOAB(sim.method.timestep, 0.7, 1.0, seed=1)

    with pytest.raises(ValueError, match="langevin-baoab can only take over in a new run"):
        simulation().run(10, every=5, trajectory=tmp_path / "a.h5md", observers=[heat])


def in_a_child(work):
    """Do work in a process of its own; whether it succeeded."""
    if (child := os.fork()) == 0:
        status = 1
        try:
            work()
            status = 0
        finally:
            os._exit(status)
    return os.waitpid(child, 0)[1] == 0


@pytest.mark.parametrize("trouble", ["little time", "children are ignored"])
def test_a_first_look_needs_no_more_than_it_has(trouble, tmp_path):
    path = tmp_path / "a.h5md"
    simulation().run(10, every=5, trajectory=path)

    def look():
        if trouble == "little time":
            resource.setrlimit(resource.RLIMIT_CPU, (1000, 1000))
            h5md_reader.looked_at.__globals__["SECONDS"] = 10_000
        else:
            signal.signal(signal.SIGCHLD, signal.SIG_IGN)
        verify_frames(path)

    assert in_a_child(look)


@pytest.mark.parametrize("way", ["memory", "file"])
def test_a_run_that_was_interrupted_goes_on_with_the_same_bits(way, tmp_path):
    def stop(sim):
        if sim.step == 50:
            signal.raise_signal(signal.SIGINT)

    whole, sim, path = simulation(), simulation(), tmp_path / "a.h5md"
    whole.run(200, every=50, trajectory=tmp_path / "whole.h5md")
    with pytest.raises(KeyboardInterrupt):
        sim.run(200, every=50, trajectory=path, observers=[stop])
    assert 50 < sim.step < 200
    sim = sim if way == "memory" else resumed(path)
    sim.run(until_step=200, every=50, trajectory=path, append=True)
    assert_same_file(path, tmp_path / "whole.h5md")


def test_time_is_restored_whatever_the_method_is():
    sim = simulation()
    sim.make_steps(20)
    before, time = sim.snapshot(), sim.time
    sim.method = md.VelocityVerlet(0.001)
    sim.make_steps(7)
    sim.restore(before)
    assert (sim.step, sim.time) == (20, time)


def test_too_little_memory_is_no_damage(tmp_path, monkeypatch):
    simulation().run(10, every=5, trajectory=tmp_path / "a.h5md")
    monkeypatch.setattr("minimd.files.h5md_restart.unflattened", lambda *_: np.empty(10**15))
    with pytest.raises(MemoryError):
        read_file(tmp_path / "a.h5md")


def test_an_append_that_is_interrupted_leaves_no_claim(tmp_path, monkeypatch):
    path = tmp_path / "a.h5md"
    simulation().run(10, every=5, trajectory=path)
    sim = resumed(path)
    with monkeypatch.context() as patch:
        patch.setattr(h5md_writer, "drop_frames", interrupt)
        with pytest.raises(KeyboardInterrupt):
            sim.run(10, every=5, trajectory=path, append=True)
    sim.run(10, every=5, trajectory=path, append=True)
    assert read_file(path).step == 20


def test_a_refused_crash_report_leaves_that_of_the_other_run(tmp_path):
    part = tmp_path / "a.crash.h5md.part"
    claim = Claim(part)
    claim.appear()
    sim = md.Simulation(
        md.System([[0.0, 0, 0], [0.9, 0, 0]], velocities=[[-5.0, 0, 0], [5.0, 0, 0]]),
        md.LennardJones(1.0, 1.0, 2.5),
        md.VelocityVerlet(0.2),
    )
    with pytest.raises(md.NonFiniteError, match="another run is writing it"):
        sim.run(1000, crash_report=tmp_path / "a.crash.h5md")
    claim.check()
    claim.release()
