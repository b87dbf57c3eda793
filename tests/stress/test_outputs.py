"""Files of runs that go wrong: readable, with the last good frame."""

import ase.io
import MDAnalysis
import numpy as np
import pytest
from stress_scenes import LAST_GOOD, SPRING, assert_stops, made

import minimd as md
from minimd.files.h5md_reader import read_file
from minimd.mdanalysis import universe


def exploding():
    """A dumbbell whose step is past its limit, in a cell: good for some frames."""
    return made(md.System([[4, 4, 4], [5.1, 4, 4], [1, 1, 1]], bonds=[[0, 1]], cell=9.0), SPRING, 2.0005 / 2**0.5)


def frames_in(file):
    if file.suffix in (".extxyz", ".traj"):
        return [atoms.positions for atoms in ase.io.read(file, ":")]
    made = universe(file) if file.suffix == ".h5md" else MDAnalysis.Universe.empty(3).load_new(str(file))
    return [ts.positions.copy() for ts in made.trajectory]


FURTHER = [pytest.param(one, marks=pytest.mark.slow) for one in (".xtc", ".trr", ".extxyz", ".traj")]


@pytest.mark.parametrize("suffix", [".h5md", ".dcd", *FURTHER])
def test_files_of_a_run_that_blows_up_hold_the_last_good_frame(suffix, tmp_path):
    simulation, every, file = exploding(), 10, tmp_path / f"a{suffix}"
    assert_stops(lambda: simulation.run(2000, every=every, trajectory=file), md.NonFiniteError, LAST_GOOD)
    frames = frames_in(file)
    assert len(frames) == len(simulation.record) == simulation.step // every + 1 > 2
    assert all(np.isfinite(frame).all() for frame in frames)
    steps, edge = simulation.step - simulation.record.step[-1], simulation.system.cell.vectors[0, 0]
    assert steps < every
    moved = (np.asarray(frames[-1]) - simulation.positions) / edge
    farthest = np.abs(simulation.velocities).max() * simulation.method.timestep * steps / edge
    assert np.abs(moved - np.rint(moved)).max() < 1e-2 + farthest  # float32 of what stands some cells away
    if suffix == ".h5md":
        contents = read_file(file)
        assert contents.step == simulation.step
        assert np.array_equal(contents.system.positions, simulation.positions)
