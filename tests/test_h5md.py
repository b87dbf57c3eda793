"""The H5MD file: what MDAnalysis reads is what was run, what resumes is what stopped, and no failure spoils it."""

import h5py
import numpy as np
import pytest
from h5md_runs import CELLS, opened, resumed, simulation

import minimd as md
from minimd.engine.record import SERIES
from minimd.files.h5md_reader import read_file
from minimd.files.h5md_writer import H5MDWriter, annotate

PER_PICOSECOND, KJ_PER_MOL = 98.22694788464064, 96.48533288249877  # of ASE's units, as their documentation has them


@pytest.mark.parametrize("units", [md.units.LJ, md.units.ASE], ids=lambda units: units.name)
@pytest.mark.parametrize("cell", CELLS)
def test_trajectory_read_back_by_mdanalysis_is_the_trajectory_written(tmp_path, cell, units):
    sim, seen = simulation(cell, units), []
    per_ps, energy = (1.0, 1.0) if units is md.units.LJ else (PER_PICOSECOND, KJ_PER_MOL)
    sim.run(
        20,
        every=5,
        trajectory=tmp_path / "a.h5md",
        store_forces=True,
        observers=[lambda s: seen.append((s.step, s.time, s.positions.copy(), s.velocities.copy(), s.forces.copy()))],
    )
    frames = opened(tmp_path / "a.h5md").trajectory
    assert len(frames) == len(seen) == 5
    for ts, (step, time, positions, velocities, forces) in zip(frames, seen, strict=True):
        assert ts.data["step"] == step
        assert ts.time == pytest.approx(time / per_ps, rel=1e-14)
        np.testing.assert_array_equal(ts.positions, positions.astype(np.float32))
        np.testing.assert_allclose(ts.velocities, velocities * per_ps, rtol=1.2e-7)  # rounding to float32
        np.testing.assert_allclose(ts.forces, forces * energy, rtol=1.2e-7)
        assert ts.velocities.any()
        assert ts.forces.any()


@pytest.mark.parametrize("cell", CELLS)
def test_cell_of_mdanalysis_has_lengths_and_angles_of_ours(tmp_path, cell):
    sim = simulation(cell)
    sim.run(0, trajectory=tmp_path / "a.h5md")
    dimensions, cell_read = opened(tmp_path / "a.h5md").trajectory.ts.dimensions, read_file(tmp_path / "a.h5md").system.cell
    assert cell_read.same_as(sim.system.cell)
    if cell.startswith("open") or cell == "slab without height":
        assert dimensions is None
        return
    a, b, c = sim.system.cell.vectors
    lengths = [np.linalg.norm(v) for v in (a, b, c)]
    cosines = [b @ c / lengths[1] / lengths[2], a @ c / lengths[0] / lengths[2], a @ b / lengths[0] / lengths[1]]
    np.testing.assert_allclose(dimensions, [*lengths, *np.degrees(np.arccos(cosines))], rtol=2e-7)


@pytest.mark.parametrize("units", [md.units.LJ, md.units.ASE], ids=lambda units: units.name)
@pytest.mark.parametrize("cell", ["cubic", "open"])
def test_observables_are_those_of_the_record_to_the_last_bit(tmp_path, cell, units):
    record = simulation(cell, units).run(20, every=2, trajectory=tmp_path / "a.h5md")
    read = read_file(tmp_path / "a.h5md").record
    names = [
        name
        for name in SERIES
        if name not in ("conserved_energy", "shadow_energy", "constraint_violation") and (name != "pressure" or cell == "cubic")
    ]
    for name in ("step", "time", *names):
        np.testing.assert_array_equal(getattr(read, name), getattr(record, name), strict=True)
    stored = [dict(ts.data) for ts in opened(tmp_path / "a.h5md").trajectory]
    for name in names:
        np.testing.assert_array_equal([row[name] for row in stored], getattr(record, name), strict=True)
    assert read.units is units
    assert not hasattr(read, "pressure") or cell == "cubic"


def test_series_share_one_step_and_one_time(tmp_path):
    simulation().run(4, every=2, trajectory=tmp_path / "a.h5md", store_forces=True)
    with h5py.File(tmp_path / "a.h5md") as h5:
        groups = [h5["observables/momentum"], *(h5[f"particles/trajectory/{name}"] for name in ("velocity", "force", "box/edges"))]
        for group in groups:
            assert group["step"] == h5["particles/trajectory/position/step"]
            assert group["time"] == h5["particles/trajectory/position/time"]
        assert h5["particles/trajectory/position/value"].dtype == np.float64
        assert h5["observables/total_energy/value"].attrs["unit"] == "ε"


@pytest.mark.parametrize("units", [md.units.LJ, md.units.ASE], ids=lambda units: units.name)
@pytest.mark.parametrize("n_steps", [20, 23])  # the end of the run is a frame, or lies beyond the last one
def test_restart_is_the_end_of_the_run_to_the_last_bit(tmp_path, units, n_steps):
    sim = simulation("triclinic", units)
    sim.run(n_steps, every=5, trajectory=tmp_path / "a.h5md")
    contents = read_file(tmp_path / "a.h5md")
    assert (contents.step, contents.time, contents.timestep) == (n_steps, sim.time, sim.method.timestep)
    assert contents.method == "velocity-verlet"
    assert md.integrators.SPLITTINGS[contents.method] is md.VelocityVerlet
    for name in ("positions", "velocities", "masses", "species", "bonds"):
        np.testing.assert_array_equal(getattr(contents.system, name), getattr(sim.system, name), strict=True)


@pytest.mark.parametrize("n_steps", [20, 23])
def test_appended_run_continues_without_doubled_frames(tmp_path, n_steps):
    path = tmp_path / "a.h5md"
    simulation().run(n_steps, every=5, trajectory=path, store_forces=True)
    sim = resumed(path)
    writer = H5MDWriter.append_to(path, sim.engine)
    record = sim.run(20, every=5, observers=[lambda s: writer.write(s.frame())])
    writer.close(completed=True)
    contents = read_file(path)
    expected = [0, 5, 10, 15, 20, *range(n_steps + 5, n_steps + 25, 5)] if n_steps == 20 else [0, 5, 10, 15, 20, *range(23, 48, 5)]
    assert contents.record.step.tolist() == expected
    assert (np.diff(contents.record.time) > 0.0).all()
    assert contents.step == n_steps + 20
    np.testing.assert_array_equal(contents.record.total_energy[-4:], record.total_energy[-4:])
    last = opened(path).trajectory[-1]
    assert len(opened(path).trajectory) == len(expected)
    np.testing.assert_array_equal(last.positions, sim.positions.astype(np.float32))
    np.testing.assert_allclose(last.forces, sim.forces, rtol=1.2e-7)


def test_frames_behind_the_restart_are_dropped(tmp_path):
    path = tmp_path / "a.h5md"
    simulation().run(20, every=5, trajectory=path)
    with h5py.File(path, "r+") as h5:
        h5["minimd/restart"].attrs["step"] = 10
    H5MDWriter.append_to(path, resumed(path)).close(completed=True)
    assert read_file(path).record.step.tolist() == [0, 5, 10]
    assert len(opened(path).trajectory) == 3


def test_title_and_scene_can_be_stored_by_an_observer(tmp_path):
    path = tmp_path / "a.h5md"
    text = "structure = 'ä'\n" * 10_000

    def note(sim):
        if sim.step == 0:
            annotate(path, title="two species", scene=text)

    simulation().run(4, every=2, trajectory=path, observers=[note])
    contents = read_file(path)
    assert (contents.title, contents.scene, contents.n_frames) == ("two species", text, 3)


def test_integer_species_stay_integers(tmp_path):
    system = md.System(np.diag([1.0, 2.0, 3.0]), species=[7, 3, 7])
    sim = md.Simulation(system, md.LennardJones(1.0, 1.0, 2.5), md.VelocityVerlet(0.001))
    sim.run(1, trajectory=tmp_path / "a.h5md")
    assert read_file(tmp_path / "a.h5md").system.species.tolist() == [7, 3, 7]
