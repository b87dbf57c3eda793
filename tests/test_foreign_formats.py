"""Formats that MDAnalysis writes hold the run."""

import errno
import os
import shutil

import ase.io
import MDAnalysis
import numpy as np
import pytest
from h5md_runs import bring_to_disk_every
from loose_lattice import PER_PICOSECOND, TURNED_CELL, simulation, system

import minimd as md
from minimd.files import mdanalysis_writer
from minimd.files.h5md_reader import read_file

FORMATS = {"xtc": 0.5e-3, "dcd": 0.0, "trr": 0.0, "ncdf": 0.0}  # error of a position beyond float32 [Å]


@pytest.mark.parametrize("units", [md.units.LJ, md.units.ASE], ids=lambda units: units.name)
@pytest.mark.parametrize("suffix", FORMATS)
def test_foreign_format_read_back_is_the_trajectory_written(tmp_path, suffix, units):
    path, seen = tmp_path / f"a.{suffix}", []
    sim = simulation(system(units=units))
    sim.run(12)
    sim.run(
        12,
        every=4,
        trajectory=path,
        observers=[lambda s: seen.append((s.time, s.positions.copy(), s.velocities.copy()))],
    )
    per_ps = PER_PICOSECOND if units is md.units.ASE else 1.0
    made = MDAnalysis.Universe.empty(24, trajectory=False).load_new(str(path))
    assert len(made.trajectory) == 4
    for ts, (time, positions, velocities) in zip(made.trajectory, seen, strict=True):
        assert ts.time == pytest.approx(time / per_ps, rel=1e-6)
        np.testing.assert_allclose(ts.dimensions, [9.0, 10.0, 11.0, 90.0, 90.0, 90.0], rtol=1e-6)
        np.testing.assert_allclose(ts.positions, positions, rtol=2e-7, atol=1.01 * FORMATS[suffix])
        assert ts.has_velocities == (suffix in ("trr", "ncdf"))
        if ts.has_velocities:
            np.testing.assert_allclose(ts.velocities, velocities * per_ps, rtol=4e-7)


@pytest.mark.parametrize("suffix", FORMATS)
@pytest.mark.parametrize("cell", [[[9.0, 0, 0], [2.0, 9.0, 0], [-1.0, 3.0, 9.0]], None], ids=["triclinic", "open"])
def test_foreign_format_keeps_lengths_and_angles(tmp_path, suffix, cell):
    simulation(system(cell)).run(4, every=2, trajectory=tmp_path / f"a.{suffix}")
    dimensions = (
        MDAnalysis.Universe.empty(24, trajectory=False).load_new(str(tmp_path / f"a.{suffix}")).trajectory.ts.dimensions
    )
    if cell is None:
        assert dimensions is None or not dimensions[:3].any()
    else:
        a, b, c = np.array(cell)
        angles = [
            np.degrees(np.arccos(u @ v / np.linalg.norm(u) / np.linalg.norm(v))) for u, v in ((b, c), (a, c), (a, b))
        ]
        np.testing.assert_allclose(dimensions, [*np.linalg.norm(cell, axis=1), *angles], rtol=1e-5)


def test_dcd_of_one_frame_is_whole(tmp_path):
    simulation().run(0, trajectory=tmp_path / "a.dcd")
    assert len(MDAnalysis.Universe.empty(24, trajectory=False).load_new(str(tmp_path / "a.dcd")).trajectory) == 1


def test_cell_that_lengths_and_angles_cannot_hold_is_told(tmp_path):
    with pytest.warns(UserWarning, match="is turned, because MDAnalysis holds a cell as lengths and angles"):
        simulation(system(3.0 * TURNED_CELL)).run(0, trajectory=tmp_path / "a.trr")


def frames_in(path):
    """Positions in all frames of a file, by its usual reader."""
    if path.suffix in (".extxyz", ".traj"):
        return np.array([atoms.positions for atoms in ase.io.read(path, ":")])
    universe = MDAnalysis.Universe.empty(24, trajectory=False).load_new(str(path))
    return np.array([ts.positions.copy() for ts in universe.trajectory])


@pytest.mark.parametrize("suffix", [*FORMATS, "extxyz", "traj"])
def test_a_resumed_run_cuts_other_trajectories_to_its_restart(tmp_path, suffix, monkeypatch):
    """What a killed run leaves can be opened at every frame; a part of a frame behind it is cut off."""
    bring_to_disk_every(0.0, monkeypatch)
    path, found = tmp_path / f"a.{suffix}", []

    def look(sim):
        if path.exists():  # a DCD file is begun with the second frame
            shutil.copy(path, tmp_path / f"b.{suffix}")
            found.append((len(frames_in(tmp_path / f"b.{suffix}")), 1 + sim.step))
        if sim.step == 1:  # the index of a .traj file has room for 42 frames, at its end
            shutil.copy(tmp_path / "a.h5md", tmp_path / "b.h5md")

    sim = simulation()
    sim.run(14, every=1, trajectory=[tmp_path / "a.h5md", path], observers=[look])
    assert len(found) >= 14
    assert all(n == m for n, m in found)
    whole = frames_in(path)
    with path.open("ab") as file:
        file.write(path.read_bytes()[300:1000])
    (tmp_path / "a.h5md").write_bytes((tmp_path / "b.h5md").read_bytes())  # with its inode, as a kill leaves it
    with pytest.warns(UserWarning, match=rf"a\.{suffix}' was cut"):
        md.Simulation.resume(tmp_path / "a.h5md", sim.potentials).run(
            4, every=1, trajectory=tmp_path / "a.h5md", append=True
        )
    np.testing.assert_array_equal(frames_in(path), whole[:2])


@pytest.mark.parametrize("suffix", [*FORMATS, "extxyz", "traj"])
@pytest.mark.parametrize("n_steps", [0, 4])
def test_a_trajectory_of_a_finished_run_is_never_cut(tmp_path, suffix, n_steps):
    sim, path = simulation(), tmp_path / f"a.{suffix}"
    sim.run(n_steps, every=2, trajectory=[tmp_path / "a.h5md", path])
    with path.open("ab") as file:
        file.write(b"added")
    content = path.read_bytes()
    sim.run(4, every=2, trajectory=tmp_path / "a.h5md", append=True)
    assert path.read_bytes() == content


OF_ANOTHER_RUN = {
    "a copy": lambda path, old: (
        path.with_suffix(".new").write_bytes(path.read_bytes()),
        path.with_suffix(".new").replace(path),
    ),
    "restart in a copy": lambda path, old: (
        old.with_suffix(".new").write_bytes(old.read_bytes()),
        old.with_suffix(".new").replace(old),
    ),
    "rewritten": lambda path, old: path.write_bytes(path.read_bytes()[::-1]),
    "a link": lambda path, old: path.symlink_to(path.replace(path.with_name("b.xtc"))),
}


@pytest.mark.parametrize("change", OF_ANOTHER_RUN)
def test_a_trajectory_that_is_not_of_the_run_is_left_alone_and_told(tmp_path, change, monkeypatch):
    def look(sim):
        if sim.step == 4:
            held.append((tmp_path / "a.h5md").read_bytes())

    bring_to_disk_every(0.0, monkeypatch)
    sim, path, held = simulation(), tmp_path / "a.xtc", []
    sim.run(8, every=2, trajectory=[tmp_path / "a.h5md", path], observers=[look])
    (tmp_path / "a.h5md").write_bytes(held[0])
    OF_ANOTHER_RUN[change](path, tmp_path / "a.h5md")
    content = path.read_bytes()
    with pytest.warns(UserWarning, match=r"a\.xtc' may hold frames after the restart"):
        md.Simulation.resume(tmp_path / "a.h5md", sim.potentials).run(
            4, every=2, trajectory=tmp_path / "a.h5md", append=True
        )
    assert path.read_bytes() == content


def test_a_mark_is_read_from_the_file_that_was_claimed(tmp_path, monkeypatch):
    """Another program has put a link to a secret in the place of the trajectory."""

    def swap(self):
        if self.claim.path.exists() and not self.claim.path.is_symlink():
            self.claim.path.unlink()
            self.claim.path.symlink_to(secret)

    bring_to_disk_every(0.0, monkeypatch)
    (secret := tmp_path / "secret").write_text("precious")
    monkeypatch.setattr(mdanalysis_writer.MDAnalysisWriter, "checkpoint", swap)
    with pytest.raises(OSError, match="it was replaced"):
        simulation().run(8, every=2, trajectory=[tmp_path / "a.h5md", tmp_path / "a.xtc"])
    assert b"precious" not in (tmp_path / "a.h5md").read_bytes()


def test_a_trajectory_whose_disk_fails_is_named_and_the_h5md_file_is_whole(tmp_path, monkeypatch):
    def failing(descriptor):
        if len(seen) > 1 and os.path.samestat(os.fstat(descriptor), os.stat(tmp_path / "a.xtc")):
            raise OSError(errno.EIO, "Input/output error")
        fsync(descriptor)

    fsync, seen = os.fsync, []
    bring_to_disk_every(0.0, monkeypatch)
    monkeypatch.setattr("os.fsync", failing)
    with pytest.raises(OSError, match=r"a\.xtc' .*Input/output error"):
        simulation().run(
            8,
            every=2,
            trajectory=[tmp_path / "a.h5md", tmp_path / "a.xtc"],
            observers=[lambda sim: seen.append(sim.step)],
        )
    assert seen == [0, 2]
    held = read_file(tmp_path / "a.h5md")
    assert (held.step, held.n_frames) == (4, 3)


@pytest.mark.parametrize("suffix", ["xtc", "ncdf"])
def test_exception_leaves_a_valid_foreign_file(tmp_path, suffix):
    def stop(sim):
        if sim.step == 4:
            raise RuntimeError("enough")

    with pytest.raises(RuntimeError, match="enough"):
        simulation().run(20, every=2, trajectory=tmp_path / f"a.{suffix}", observers=[stop])
    assert len(MDAnalysis.Universe.empty(24, trajectory=False).load_new(str(tmp_path / f"a.{suffix}")).trajectory) == 3


@pytest.mark.parametrize("suffix", FORMATS)
def test_full_disk_is_told_by_every_format(tmp_path, monkeypatch, suffix):
    def fill(sim):
        if sim.step == 4:
            monkeypatch.setattr(mdanalysis_writer, "disk_usage", lambda folder: usage(folder)._replace(free=1000))

    usage = mdanalysis_writer.disk_usage
    with pytest.raises(OSError, match=rf"a\.{suffix}' could not take the frame of step 6: no room"):
        simulation().run(20, every=2, trajectory=tmp_path / f"a.{suffix}", observers=[fill])
    assert len(MDAnalysis.Universe.empty(24, trajectory=False).load_new(str(tmp_path / f"a.{suffix}")).trajectory) == 3


def test_failing_foreign_write_is_told_once(tmp_path, monkeypatch):
    def full(*_):
        raise OSError("write error")

    monkeypatch.setattr(MDAnalysis.coordinates.TRR.TRRWriter, "write", full)
    monkeypatch.setattr(MDAnalysis.coordinates.TRR.TRRWriter, "close", full)
    with pytest.raises(OSError, match=r"a\.trr' could not take the frame of step 0: write error"):
        simulation().run(4, every=2, trajectory=tmp_path / "a.trr")
    monkeypatch.undo()
