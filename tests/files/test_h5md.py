"""The H5MD file: what is read is what was run, and what goes on is what stopped."""

import warnings
from collections import namedtuple

import h5py
import numpy as np
import pytest
from charged_scenes import LAWS, ions, run_of
from h5md_runs import CELLS, PER_PICOSECOND, lengths_and_angles, opened, resumed, simulation

import minimd as md
from minimd.core.engine.record import SERIES
from minimd.core.files.h5md_reader import read_file
from minimd.core.files.h5md_schema import chunk_rows
from minimd.core.files.h5md_writer import H5MDWriter

KJ_PER_MOL = 96.48533288249877  # of eV, as ASE's documentation has it
LJ, ASE = md.units.LJ, md.units.ASE
RUNS = [*((cell, LJ) for cell in CELLS), ("cubic", ASE), ("triclinic", ASE), ("open", ASE)]
Run = namedtuple("Run", "cell units path sim record seen")  # seen: step, time, r, v and F at each frame
VERLET, BATH = md.VelocityVerlet(0.002), md.LangevinBAOAB(0.002, 1.0, 1.0, 3)
OTHER_STEPS = {  # the file has the first method, the others take over one after another
    VERLET: [(md.VelocityVerlet(0.001), ["timestep=0.002", "timestep=0.001"]),
             (md.PositionVerlet(0.001), ["velocity-verlet", "position-verlet"])],
    BATH: [(md.LangevinBAOAB(0.002, 2.0, 1.0, 4), ["seed=3", "seed=4"])],
}  # fmt: skip
COOLER = md.LangevinBAOAB(0.002, 0.5, 1.0, 3)


@pytest.fixture(scope="module", params=RUNS, ids=lambda row: f"{row[0]}-{row[1].name}")
def run(request, tmp_path_factory):
    """23 steps with a frame of every fifth: the end lies beyond the last frame."""
    (cell, units), seen = request.param, []
    path, sim = tmp_path_factory.mktemp("run") / "a.h5md", simulation(cell, units)
    look = [lambda s: seen.append((s.step, s.time, s.positions.copy(), s.velocities.copy(), s.forces.copy()))]
    return Run(cell, units, path, sim, sim.run(23, every=5, trajectory=path, store_forces=True, observers=look), seen)


def test_trajectory_read_back_by_mdanalysis_is_the_trajectory_written(run):
    per_ps, energy = (1.0, 1.0) if run.units is LJ else (PER_PICOSECOND, KJ_PER_MOL)
    frames = opened(run.path).trajectory
    assert len(frames) == len(run.seen) == 5
    for ts, (step, time, positions, velocities, forces) in zip(frames, run.seen, strict=True):
        assert (ts.data["step"], ts.time) == (step, pytest.approx(time / per_ps, rel=1e-14))
        np.testing.assert_array_equal(ts.positions, positions.astype(np.float32))
        np.testing.assert_allclose(ts.velocities, velocities * per_ps, rtol=1.2e-7)  # rounding to float32
        np.testing.assert_allclose(ts.forces, forces * energy, rtol=1.2e-7)
        assert (ts.velocities.any(), ts.forces.any()) == (True, True)
    cell, dimensions = run.sim.system.cell, frames.ts.dimensions
    assert read_file(run.path).system.cell.same_as(cell)
    if run.cell.startswith("open") or run.cell == "slab without height":
        assert dimensions is None
    else:
        np.testing.assert_allclose(dimensions, lengths_and_angles(cell.vectors), rtol=2e-7)


def test_observables_are_those_of_the_record_to_the_last_bit(run):
    read, names = read_file(run.path).record, [name for name in SERIES if name in run.record]
    assert {"total_energy", "momentum", "temperature"} <= set(names)
    assert ("pressure" in names) == hasattr(read, "pressure") == run.sim.system.cell.pbc.all()
    assert read.units is run.units
    stored = [dict(ts.data) for ts in opened(run.path).trajectory]
    for name in ("step", "time", *names):
        np.testing.assert_array_equal(getattr(read, name), getattr(run.record, name), strict=True)
    for name in names:
        np.testing.assert_array_equal([row[name] for row in stored], getattr(run.record, name), strict=True)


def test_restart_is_the_end_of_the_run_to_the_last_bit_and_series_share_one_step_and_one_time(run):
    contents = read_file(run.path)
    assert (contents.step, contents.time, contents.timestep) == (23, run.sim.time, run.sim.method.timestep)
    assert md.integrators.SPLITTINGS[contents.method] is md.VelocityVerlet
    for name in ("positions", "velocities", "masses", "species", "bonds"):
        np.testing.assert_array_equal(getattr(contents.system, name), getattr(run.sim.system, name), strict=True)
    with h5py.File(run.path) as h5:
        position = h5["particles/trajectory/position"]
        groups = [f"particles/trajectory/{name}" for name in ("velocity", "force", "box/edges")]
        for one in [h5[name] for name in ("observables/momentum", *groups) if name in h5]:
            assert (one["step"], one["time"]) == (position["step"], position["time"])
        assert position["value"].dtype == np.float64
        assert h5["observables/total_energy/value"].attrs["unit"] == run.units.energy


@pytest.mark.parametrize("n_steps", [20, 23])  # the end of the run is a frame, or lies beyond the last one
def test_appended_run_continues_on_the_grid_of_the_first_one(tmp_path, n_steps):
    path, called = tmp_path / "a.h5md", []
    simulation().run(n_steps, every=5, trajectory=path, store_forces=True)
    look = [lambda sim: called.append(sim.step)]  # functions see the start, the file has it or does not want it
    record = resumed(path).run(until_step=n_steps + 20, every=5, trajectory=path, append=True, observers=look)
    contents = read_file(path)
    assert called == [n_steps, 25, 30, 35, 40] == record.step.tolist()
    assert contents.record.step.tolist() == [0, 5, 10, 15, 20, 25, 30, 35, 40]
    assert (np.diff(contents.record.time) > 0.0).all()
    assert contents.step == n_steps + 20
    np.testing.assert_array_equal(contents.record.total_energy[-3:], record.total_energy[-3:])
    frames = opened(path).trajectory
    assert (len(frames), len(frames[-1].forces)) == (9, 27)


@pytest.mark.parametrize("before", [VERLET, pytest.param(BATH, marks=pytest.mark.slow)])
def test_a_run_that_goes_on_with_other_steps_says_so(before, tmp_path):
    sim, path = simulation(), tmp_path / "a.h5md"
    sim.method = before
    sim.run(4, every=2, trajectory=path, append="auto")  # begins the file
    sim = resumed(path)
    with warnings.catch_warnings(action="error"):  # with the same ones, or at another temperature, it is silent
        sim.run(4, every=2, trajectory=path, append="auto")
        sim.method = COOLER if before is BATH else before
        sim.run(4, every=2, trajectory=path, append=True)
    for sim.method, shown in OTHER_STEPS[before]:
        with pytest.warns(UserWarning, match=".* before, .*".join(shown)) as caught:
            sim.run(4, every=2, trajectory=path, append=True)
        assert caught[0].filename == __file__
    assert read_file(path).parameters == sim.method.parameters


def test_a_method_that_takes_over_during_a_run_is_in_the_file(tmp_path):
    whole, sim, path = simulation(), simulation(), tmp_path / "a.h5md"
    shorten = [lambda sim: setattr(sim, "method", md.VelocityVerlet(0.001)) if sim.step == 10 else None]
    whole.run(40, every=5, observers=shorten)
    sim.run(20, every=5, trajectory=path, observers=shorten)
    again = resumed(path)
    again.run(20, every=5)
    assert (again.method.timestep, again.time) == (0.001, whole.time)
    np.testing.assert_array_equal(again.positions, whole.positions)
    before, time, again.method = again.snapshot(), again.time, md.VelocityVerlet(0.002)
    again.make_steps(7)
    again.restore(before)
    assert (again.step, again.time) == (40, time)  # whatever the method is


def test_a_bath_that_gets_hotter_during_a_run_is_in_the_file(tmp_path):
    """The run that goes on from the restart is that of one piece, also if it stopped between two looks.
    Functions see the start of each run, and this one heats at multiples of 5 only."""
    whole, sim, path = simulation(), simulation(), tmp_path / "a.h5md"
    heat = [lambda sim: setattr(sim.method, "temperature", 1.0 + 0.1 * (sim.step - sim.step % 5))]
    for each in (whole, sim):
        each.method = md.LangevinBAOAB(0.002, 1.0, 1.0, 3)
    whole.run(40, every=5, observers=heat)
    sim.run(23, every=5, trajectory=path, observers=heat)
    again = resumed(path)
    assert again.method.temperature == 3.0
    again.run(17, every=5, trajectory=path, append=True, observers=heat)
    np.testing.assert_array_equal(again.positions, whole.positions)
    np.testing.assert_array_equal(again.velocities, whole.velocities)


class Own(md.VelocityVerlet):
    """A method of a script."""

    name = "own"


def test_a_run_with_a_method_of_a_script_goes_on_with_it(tmp_path):
    sim, path = simulation(), tmp_path / "a.h5md"
    sim.method = Own(0.002)
    sim.run(10, trajectory=path)
    with pytest.raises(ValueError, match="method="):
        md.Simulation.resume(path, sim.potentials)
    again = md.Simulation.resume(path, sim.potentials, method=Own(0.002))
    for each in (sim, again):
        each.run(10)
    np.testing.assert_array_equal(again.positions, sim.positions)


def test_a_title_a_scene_and_integer_species_are_kept(tmp_path):
    path, text = tmp_path / "a.h5md", "structure = 'ä'\n" * 10_000
    sim = simulation()
    sim.engine.notes.update(title="two species", scene=text)
    sim.run(4, every=2, trajectory=path)
    contents = read_file(path)
    assert (contents.title, contents.scene, contents.n_frames) == ("two species", text, 3)
    numbered = md.System(np.diag([1.0, 2.0, 3.0]), species=[7, 3, 7])
    md.Simulation(numbered, sim.potentials, sim.method).run(1, trajectory=tmp_path / "b.h5md")
    assert read_file(tmp_path / "b.h5md").system.species.tolist() == [7, 3, 7]


def test_charges_are_where_h5md_has_them_and_a_run_of_ions_goes_on_with_the_same_bits(tmp_path):
    path, whole, sim = tmp_path / "a.h5md", run_of(ions()), run_of(ions())
    record = whole.run(20, every=5)
    sim.run(10, every=5, trajectory=path)
    again = md.Simulation.resume(path, LAWS)
    again.run(10, every=5, trajectory=path, append=True)
    np.testing.assert_array_equal(again.positions, whole.positions)
    np.testing.assert_array_equal(read_file(path).record.total_energy, record.total_energy)
    with h5py.File(path) as h5:
        stored = h5["particles/trajectory/charge"]
        np.testing.assert_array_equal(stored, ions().charges, strict=True)
        assert stored.attrs["unit"] == "e"
    simulation().run(0, trajectory=tmp_path / "b.h5md")
    with h5py.File(tmp_path / "b.h5md") as h5:
        assert not {"charge", "charges"} & {*h5["particles/trajectory"], *h5["minimd"]}


def test_a_file_that_is_being_written_is_not_changed_by_others(tmp_path):
    path, told = tmp_path / "a.h5md", []

    def meddle(_sim):
        with pytest.raises(OSError, match=r"a\.h5md") as failure:
            H5MDWriter.append_to(path, simulation().engine)
        told.append(failure)

    simulation().run(4, every=2, trajectory=path, observers=[meddle])
    assert (len(told), read_file(path).title) == (3, "27 atoms of Ar, Kr")


def test_a_file_of_few_frames_is_small_and_that_of_many_has_large_chunks(tmp_path):
    """A chunk takes its full size on the disk, whatever is in it."""
    file, number, numbers = tmp_path / "short.h5md", np.zeros(()), np.zeros((27, 3))
    simulation().run(1, every=1, trajectory=file)
    assert file.stat().st_size < 130_000
    for many in ((10_000,), ()):
        assert [chunk_rows(entry, *many) for entry in (number, numbers)] == [512, 101]
    assert [chunk_rows(entry, 2) for entry in (number, numbers, np.zeros((10_000, 3)))] == [16, 16, 1]
