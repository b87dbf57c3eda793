"""The H5MD file: what MDAnalysis reads is what was run, what resumes is what stopped, and no failure spoils it."""

import warnings

import h5py
import numpy as np
import pytest
from h5md_runs import CELLS, opened, resumed, simulation

import minimd as md
from minimd.engine.record import SERIES
from minimd.files.h5md_reader import read_file
from minimd.files.h5md_writer import edit

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
    dimensions, cell_read = (
        opened(tmp_path / "a.h5md").trajectory.ts.dimensions,
        read_file(tmp_path / "a.h5md").system.cell,
    )
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
    names = [name for name in SERIES if name in record]
    assert {"total_energy", "momentum", "temperature"} <= set(names)
    assert ("pressure" in names) is (cell == "cubic")
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
        groups = [
            h5["observables/momentum"],
            *(h5[f"particles/trajectory/{name}"] for name in ("velocity", "force", "box/edges")),
        ]
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
def test_appended_run_continues_on_the_grid_of_the_first_one(tmp_path, n_steps):
    path = tmp_path / "a.h5md"
    simulation().run(n_steps, every=5, trajectory=path, store_forces=True)
    sim = resumed(path)
    record = sim.run(until_step=n_steps + 20, every=5, trajectory=path, append=True)
    contents = read_file(path)
    assert contents.record.step.tolist() == [*range(0, n_steps + 20, 5), 40][: 9 if n_steps == 23 else None]
    assert (np.diff(contents.record.time) > 0.0).all()
    assert contents.step == n_steps + 20
    np.testing.assert_array_equal(contents.record.total_energy[-3:], record.total_energy[-3:])
    frames = opened(path).trajectory
    assert len(frames) == 9
    assert len(frames[-1].forces) == 27


BATHS = {
    "method": (
        md.VelocityVerlet(0.002),
        md.PositionVerlet(0.002),
        r"velocity-verlet\(timestep=0.002\) before, position-verlet\(timestep=0.002\) now",
    ),
    "time step": (
        md.VelocityVerlet(0.002),
        md.VelocityVerlet(0.001),
        r"\(timestep=0.002\) before, velocity-verlet\(timestep=0.001\) now",
    ),
    "temperature": (
        md.LangevinBAOAB(0.002, 1.0, 1.0, 3),
        md.LangevinBAOAB(0.002, 2.0, 1.0, 3),
        r"temperature=1, .* before, .* temperature=2, .* now",
    ),
    "seed": (
        md.LangevinBAOAB(0.002, 1.0, 1.0, 3),
        md.LangevinBAOAB(0.002, 1.0, 1.0, 4),
        r"seed=3\) before, .* seed=4\) now",
    ),
}


@pytest.mark.parametrize("what", BATHS)
def test_a_run_that_goes_on_with_other_steps_says_so(what, tmp_path):
    before, now, told = BATHS[what]
    sim, path = simulation(), tmp_path / "a.h5md"
    sim.method = before
    sim.run(4, every=2, trajectory=path)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        sim.run(4, every=2, trajectory=path, append=True)  # with the same ones it is silent
        resumed(path).run(4, every=2, trajectory=path, append=True)
    again = resumed(path)
    again.method = now
    with pytest.warns(
        UserWarning, match=f"goes on with other steps: .*{told}; frames before and after belong to different runs"
    ) as caught:
        again.run(4, every=2, trajectory=path, append=True)
    assert caught[0].filename == __file__
    assert read_file(path).parameters == now.parameters


def test_another_barostat_and_a_bath_that_was_not_there_are_refused(tmp_path):
    sim, path = simulation(), tmp_path / "a.h5md"
    sim.run(4, every=2, trajectory=path)
    sim.method = md.LangevinBAOAB(0.002, 1.0, 1.0, 3)
    with pytest.raises(
        ValueError,
        match="was written without a thermostat; it cannot be continued with langevin-baoab: write to a new file",
    ):
        sim.run(4, every=2, trajectory=path, append=True)
    one, other = (md.StochasticCellRescaling(p, 0.1, 1.0, seed=1, temperature=1.0) for p in (1.0, 2.0))
    at_one, at_other = (
        md.Simulation(simulation().system, sim.potentials, md.VelocityVerlet(0.002), barostat=bath)
        for bath in (one, other)
    )
    at_one.run(4, every=2, trajectory=tmp_path / "b.h5md")
    at_other.restore(at_one.snapshot())
    with pytest.raises(
        ValueError,
        match=r"holds a run with \w+\(pressure=1\.0, .*; the simulation has \w+\(pressure=2\.0, .*\): write to a new file",
    ):
        at_other.run(4, every=2, trajectory=tmp_path / "b.h5md", append=True)


def test_a_title_and_a_scene_can_be_stored(tmp_path):
    path = tmp_path / "a.h5md"
    text = "structure = 'ä'\n" * 10_000
    sim = simulation()
    sim.engine.notes.update(title="two species", scene=text)
    sim.run(4, every=2, trajectory=path)
    contents = read_file(path)
    assert (contents.title, contents.scene, contents.n_frames) == ("two species", text, 3)
    resumed(path).run(4, every=2, trajectory=path, append=True)
    assert read_file(path).scene == text


def test_a_file_that_is_being_written_is_not_changed_by_others(tmp_path):
    path, told = tmp_path / "a.h5md", []

    def meddle(_sim):
        with pytest.raises(OSError, match="another run is writing it") as failure:
            edit(path, lambda h5: h5["minimd"].attrs.update(title="mine"))
        told.append(str(failure.value))

    simulation().run(4, every=2, trajectory=path, observers=[meddle])
    assert len(told) == 3
    assert read_file(path).title == "27 atoms of Ar, Kr"


def test_integer_species_stay_integers(tmp_path):
    system = md.System(np.diag([1.0, 2.0, 3.0]), species=[7, 3, 7])
    sim = md.Simulation(system, md.LennardJones(1.0, 1.0, 2.5), md.VelocityVerlet(0.001))
    sim.run(1, trajectory=tmp_path / "a.h5md")
    assert read_file(tmp_path / "a.h5md").system.species.tolist() == [7, 3, 7]
