"""Files of runs that go wrong: readable, with the last good frame; outputs that cannot be are told before the first step."""

import os
import signal

import numpy as np
import pytest
from stress_scenes import SMOOTH, assert_stops, solid

import minimd as md
from minimd.files.h5md_reader import read_file
from minimd.mdanalysis import universe

SUFFIXES = [".h5md", ".dcd", ".xtc", ".trr", ".extxyz", ".traj"]


def exploding():
    """A dumbbell whose step is past its limit, in a cell: good for some frames."""
    system = md.System([[4, 4, 4], [5.1, 4, 4], [1, 1, 1]], bonds=[[0, 1]], cell=9.0)
    return md.Simulation(system, md.HarmonicBond(1.0, 1.0), md.VelocityVerlet(2.0005 / 2**0.5))


def colliding():
    """Two fast atoms that meet after some frames, with a step too long."""
    system = md.System(
        [[1.0, 5, 5], [9.0, 5.05, 5], [5, 9, 9]], velocities=[[10.0, 0, 0], [-10.0, 0, 0], [0, 0, 0]], cell=20.0
    )
    return md.Simulation(system, SMOOTH, md.VelocityVerlet(0.05))


def frames_in(file):
    if file.suffix in (".extxyz", ".traj"):
        import ase.io

        return [atoms.positions for atoms in ase.io.read(file, ":")]
    if file.suffix == ".h5md":
        return [ts.positions.copy() for ts in universe(file).trajectory]
    import MDAnalysis

    return [ts.positions.copy() for ts in MDAnalysis.Universe.empty(3, trajectory=False).load_new(str(file)).trajectory]


@pytest.mark.parametrize("suffix", SUFFIXES)
@pytest.mark.parametrize(("scene", "every"), [(exploding, 10), (colliding, 1)])
def test_files_of_a_run_that_blows_up_hold_the_last_good_frame(scene, every, suffix, tmp_path):
    simulation, file = scene(), tmp_path / f"a{suffix}"
    assert_stops("The system holds the last good state", lambda: simulation.run(2000, every=every, trajectory=file))
    frames = frames_in(file)
    assert len(frames) == len(simulation.record) == simulation.step // every + 1 > 2
    assert all(np.isfinite(frame).all() for frame in frames)
    moved = (np.asarray(frames[-1]) - simulation.positions) / simulation.system.cell.vectors[0, 0]
    steps, edge = simulation.step - simulation.record.step[-1], simulation.system.cell.vectors[0, 0]
    assert steps < every
    farthest = np.abs(simulation.velocities).max() * simulation.method.timestep * steps / edge
    assert (
        np.abs(moved - np.rint(moved)).max() < 1e-2 + farthest
    )  # a file in float32 may hold what stands some cells away
    if suffix == ".h5md":
        contents = read_file(file)
        assert contents.step == simulation.step
        assert np.array_equal(contents.system.positions, simulation.positions)


@pytest.mark.parametrize("suffix", SUFFIXES)
def test_files_stay_valid_after_ctrl_c(suffix, tmp_path):
    file, simulation = (
        tmp_path / f"a{suffix}",
        md.Simulation(solid(2), md.LennardJones(1.0, 1.0, 1.6), md.VelocityVerlet(0.002)),
    )

    def interrupt(sim):
        if sim.step == 50:
            os.kill(os.getpid(), signal.SIGINT)

    with pytest.raises(KeyboardInterrupt, match="stopped after step"):
        simulation.run(100_000, every=10, trajectory=file, observers=[interrupt])
    if suffix == ".h5md":
        assert read_file(file).record.step.tolist() == list(range(0, simulation.step + 1, 10))[: len(simulation.record)]
    assert file.stat().st_size > 0
    simulation.run(20, every=10, trajectory=tmp_path / f"b{suffix}")  # and the simulation goes on


def test_ctrl_c_twice_at_an_observer_leaves_the_simulation_usable(tmp_path):
    simulation = md.Simulation(solid(2), md.LennardJones(1.0, 1.0, 1.6), md.VelocityVerlet(0.002))

    def twice(sim):
        if sim.step == 20:
            os.kill(os.getpid(), signal.SIGINT)
            os.kill(os.getpid(), signal.SIGINT)

    with pytest.raises(KeyboardInterrupt):
        simulation.run(1000, every=10, trajectory=tmp_path / "a.h5md", observers=[twice])
    assert read_file(tmp_path / "a.h5md").record.step.tolist() == [0, 10, 20]
    assert len(simulation.run(20, every=10)) == 3


@pytest.mark.parametrize(
    ("name", "error", "words"),
    [
        ("none/a.h5md", FileNotFoundError, "does not exist"),
        ("a.pdf", ValueError, "suffix of a trajectory must be one of"),
        ("a", ValueError, "suffix of a trajectory must be one of"),
        ("folder.h5md", FileExistsError, "exists"),
        ("old.h5md", FileExistsError, "exists"),
        ("x" * 300 + ".h5md", (OSError, ValueError), "cannot be written|too long"),
        ("", ValueError, "suffix"),
    ],
)
def test_outputs_that_cannot_be_are_told_before_the_first_step(name, error, words, tmp_path):
    (tmp_path / "folder.h5md").mkdir()
    (tmp_path / "old.h5md").write_text("precious")
    simulation = md.Simulation(solid(2), md.LennardJones(1.0, 1.0, 1.6), md.VelocityVerlet(0.002))
    with pytest.raises(error, match=words):
        simulation.run(10, trajectory=[tmp_path / "good.h5md", tmp_path / name])
    assert simulation.step == 0
    assert sorted(path.name for path in tmp_path.iterdir()) == ["folder.h5md", "old.h5md"]
    assert (tmp_path / "old.h5md").read_text() == "precious"
    simulation.run(10)


def test_a_full_disk_is_told_before_the_first_step():
    if not os.path.exists("/dev/full"):
        pytest.skip("no /dev/full here")
    simulation = md.Simulation(solid(2), md.LennardJones(1.0, 1.0, 1.6), md.VelocityVerlet(0.002))
    with pytest.raises((OSError, ValueError)):
        simulation.run(10, trajectory="/dev/full")
    assert simulation.step == 0


def test_one_file_twice_is_refused(tmp_path):
    simulation = md.Simulation(solid(2), md.LennardJones(1.0, 1.0, 1.6), md.VelocityVerlet(0.002))
    with pytest.raises((ValueError, OSError), match=r"a\.h5md"):
        simulation.run(10, trajectory=[tmp_path / "a.h5md", tmp_path / "a.h5md"])


def test_an_observer_that_raises_leaves_a_valid_file_and_a_usable_simulation(tmp_path):
    simulation = md.Simulation(solid(2), md.LennardJones(1.0, 1.0, 1.6), md.VelocityVerlet(0.002))

    def broken(sim):
        if sim.step == 20:
            raise ZeroDivisionError("mine")

    with pytest.raises(ZeroDivisionError, match="mine"):
        simulation.run(100, every=10, trajectory=tmp_path / "a.h5md", observers=[broken])
    assert read_file(tmp_path / "a.h5md").record.step.tolist() == [0, 10, 20]
    simulation.run(10)
    assert simulation.step == 30
