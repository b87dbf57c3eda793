"""Formats that other libraries write: each holds the run, and none holds more than the restart beside it."""

import errno
import os
import shutil
from collections import Counter
from pathlib import Path

import h5md_runs
import MDAnalysis
import numpy as np
import pytest
from h5md_runs import PER_PICOSECOND, at_step, bring_to_disk_every, frames_in, opened, resumed, simulation

import minimd as md
from minimd.core.files import turned_cell
from minimd.core.files.h5md_reader import read_file

FORMATS = {"xtc": 0.5e-3, "dcd": 0.0, "trr": 0.0, "ncdf": 0.0}  # error of a position beyond float32 [Å]
ALL = [*FORMATS, "extxyz", "traj"]
LJ, ASE = md.units.LJ, md.units.ASE


@pytest.mark.parametrize(("cell", "units"), [("triclinic", LJ), ("triclinic", ASE), ("open", ASE)])
@pytest.mark.parametrize("suffix", FORMATS)
def test_what_mdanalysis_reads_is_what_was_run(tmp_path, suffix, cell, units):
    path, seen, sim = tmp_path / f"a.{suffix}", [], simulation(cell, units)
    look = [lambda s: seen.append((s.time, s.positions.copy(), s.velocities.copy()))]
    sim.run(12)
    sim.run(12, every=4, trajectory=path, observers=look)
    per_ps, made, vectors = PER_PICOSECOND if units is ASE else 1.0, opened(path), sim.system.cell.vectors
    assert len(made.trajectory) == 4
    for ts, (time, positions, velocities) in zip(made.trajectory, seen, strict=True):
        assert ts.time == pytest.approx(time / per_ps, rel=1e-6)
        np.testing.assert_allclose(ts.positions, positions, rtol=2e-7, atol=1.01 * FORMATS[suffix])
        assert ts.has_velocities == (suffix in ("trr", "ncdf"))
        if ts.has_velocities:
            np.testing.assert_allclose(ts.velocities, velocities * per_ps, rtol=4e-7)
        if cell == "open":
            assert ts.dimensions is None or not ts.dimensions[:3].any()
            continue
        np.testing.assert_allclose(ts.dimensions, h5md_runs.lengths_and_angles(vectors), rtol=1e-5)


def test_a_dcd_file_of_one_frame_is_whole_and_a_turned_cell_is_told_at_the_line_of_the_user(tmp_path):
    simulation().run(0, trajectory=tmp_path / "a.dcd")
    assert len(opened(tmp_path / "a.dcd").trajectory) == 1
    with pytest.warns(UserWarning, match=r"a\.nc' is turned") as caught:
        simulation("turned").run(2, every=1, trajectory=tmp_path / "a.nc")
    assert caught[0].filename == __file__
    with MDAnalysis.coordinates.TRJ.NCDFReader(str(tmp_path / "a.nc")) as read:
        assert len(read) == 3


def test_a_resumed_run_cuts_other_trajectories_to_its_restart(tmp_path, monkeypatch):
    """What a killed run leaves can be opened at every frame; a part of a frame behind it is cut off."""
    bring_to_disk_every(0.0, monkeypatch)
    (tmp_path / "copies").mkdir()
    h5md, paths, found, held = tmp_path / "a.h5md", [tmp_path / f"a.{suffix}" for suffix in ALL], Counter(), {}

    def look(sim):
        for path in filter(Path.exists, paths):  # a DCD file is begun with the second frame
            assert len(frames_in(Path(shutil.copy(path, tmp_path / "copies")))) == 1 + sim.step
            found[path] += 1
        if sim.step == 1:  # the index of a .traj file has room for 42 frames, at its end
            held[h5md] = h5md.read_bytes()

    simulation().run(8, every=1, trajectory=[h5md, *paths], observers=[look])
    assert min(found[path] for path in paths) >= 8
    whole = [frames_in(path) for path in paths]
    for path in paths:
        path.write_bytes(path.read_bytes() + path.read_bytes()[300:1000])
    h5md.write_bytes(held[h5md])  # with its inode, as a kill leaves it
    with pytest.warns(UserWarning, match="was cut") as told:
        resumed(h5md).run(4, every=1, trajectory=h5md, append=True)
    for path, frames in zip(paths, whole, strict=True):
        assert any(f"{path.name}' was cut" in str(one.message) for one in told)
        np.testing.assert_array_equal(frames_in(path), frames[:2])


@pytest.mark.parametrize("n_steps", [0, 4])
def test_a_trajectory_of_a_finished_run_is_never_cut(tmp_path, n_steps):
    sim, h5md, paths = simulation(), tmp_path / "a.h5md", [tmp_path / f"a.{suffix}" for suffix in ALL]
    sim.run(n_steps, every=2, trajectory=[h5md, *paths])
    for path in paths:
        path.write_bytes(path.read_bytes() + b"added")
    contents = [path.read_bytes() for path in paths]
    sim.run(4, every=2, trajectory=h5md, append=True)
    assert [path.read_bytes() for path in paths] == contents


def renewed(path):
    path.with_suffix(".new").write_bytes(path.read_bytes())
    path.with_suffix(".new").replace(path)


OF_ANOTHER_RUN = {
    "a copy": lambda path, old: renewed(path), "restart in a copy": lambda path, old: renewed(old),
    "rewritten": lambda path, old: path.write_bytes(path.read_bytes()[::-1]),
    "a link": lambda path, old: path.symlink_to(path.replace(path.with_name("b.xtc"))),
}  # fmt: skip


@pytest.mark.parametrize("change", ["a link", *(pytest.param(one, marks=pytest.mark.slow) for one in OF_ANOTHER_RUN)])
def test_a_trajectory_that_is_not_of_the_run_is_left_alone_and_told(tmp_path, change, monkeypatch):
    bring_to_disk_every(0.0, monkeypatch)
    old, path, held = tmp_path / "a.h5md", tmp_path / "a.xtc", []
    simulation().run(8, every=2, trajectory=[old, path], observers=[at_step(4, lambda: held.append(old.read_bytes()))])
    old.write_bytes(held[0])
    OF_ANOTHER_RUN[change](path, old)
    content = path.read_bytes()
    with pytest.warns(UserWarning, match=r"a\.xtc' .*may hold frames"):
        resumed(old).run(4, every=2, trajectory=old, append=True)
    assert path.read_bytes() == content


def test_a_mark_is_read_from_the_file_that_was_claimed(tmp_path, monkeypatch):
    """Another program has put a link to a secret in the place of the trajectory."""

    def swap(self):
        if self.claim.path.exists() and not self.claim.path.is_symlink():
            self.claim.path.unlink()
            self.claim.path.symlink_to(secret)

    bring_to_disk_every(0.0, monkeypatch)
    (secret := tmp_path / "secret").write_text("precious")
    monkeypatch.setattr(turned_cell.MDAnalysisWriter, "checkpoint", swap)
    with pytest.raises(OSError, match="it was replaced"):
        simulation().run(8, every=2, trajectory=[tmp_path / "a.h5md", tmp_path / "a.xtc"])
    assert b"precious" not in (tmp_path / "a.h5md").read_bytes()


def test_a_trajectory_whose_disk_fails_is_named_and_the_h5md_file_is_whole(tmp_path, monkeypatch):
    def failing(descriptor):
        if len(seen) > 1 and os.path.samestat(os.fstat(descriptor), os.stat(tmp_path / "a.xtc")):
            raise OSError(errno.EIO, "Input/output error")
        fsync(descriptor)

    fsync, seen, files = os.fsync, [], [tmp_path / "a.h5md", tmp_path / "a.xtc"]
    bring_to_disk_every(0.0, monkeypatch)
    monkeypatch.setattr("os.fsync", failing)
    with pytest.raises(OSError, match=r"a\.xtc' .*Input/output error"):
        simulation().run(8, every=2, trajectory=files, observers=[lambda sim: seen.append(sim.step)])
    assert seen == [0, 2]
    held = read_file(tmp_path / "a.h5md")
    assert (held.step, held.n_frames) == (4, 3)


@pytest.mark.parametrize("suffix", FORMATS)
def test_full_disk_is_told_by_every_format(tmp_path, monkeypatch, suffix):
    usage, path = turned_cell.disk_usage, tmp_path / f"a.{suffix}"
    full = turned_cell, "disk_usage", lambda folder: usage(folder)._replace(free=1000)
    with pytest.raises(OSError, match=rf"a\.{suffix}' .*step 6"):
        simulation().run(20, every=2, trajectory=path, observers=[at_step(4, lambda: monkeypatch.setattr(*full))])
    assert len(opened(path).trajectory) == 3


@pytest.mark.parametrize("start", [0, 7, 10])
def test_times_in_a_dcd_file_are_those_of_its_frames(tmp_path, start):
    """A first frame between two multiples is left out, since all frames have one time between them."""
    sim, path, times = simulation(units=md.units.ASE), tmp_path / "a.dcd", []
    sim.run(start)
    look = [lambda sim: times.append(sim.time * md.units.ASE.to_picosecond)]
    if start % 5:
        with pytest.warns(UserWarning, match=f"step {start}"):
            sim.run(until_step=30, every=5, trajectory=path, observers=look)
        times.pop(0)
    else:
        sim.run(until_step=30, every=5, trajectory=path, observers=look)
    np.testing.assert_allclose([ts.time for ts in opened(path).trajectory], times, rtol=1e-5)  # float32 in the file


@pytest.mark.parametrize("places", [[[0.0, 0, 0], [2.2e6, 0, 0]], [[-1.5e6, 0, 0], [1.5e6, 0, 0]]])
def test_an_xtc_file_refuses_positions_that_it_cannot_hold(tmp_path, places):
    sim = md.Simulation(
        md.System(places, masses=40.0, units=md.units.ASE), md.LennardJones(0.01, 3.4, 8.0), md.VelocityVerlet(0.1)
    )
    with pytest.raises(OSError, match="xtc"):
        sim.run(10, trajectory=tmp_path / "a.xtc")
    sim.run(10, trajectory=tmp_path / "a.trr")
    np.testing.assert_array_equal(opened(tmp_path / "a.trr", 2).trajectory[0].positions, np.float32(places))
