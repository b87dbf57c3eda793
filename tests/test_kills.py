"""A run that is killed at any of its writes goes on to the same last bit, and so does one that is stopped anywhere."""

import os
import random

import MDAnalysis
import numpy as np
import pytest
from cluster_scenes import atoms_per_domain
from h5md_runs import bring_to_disk_every
from kills import killed_after, killed_at, seconds_of
from references import liquid

import minimd as md
from minimd.files.h5md_reader import read_file, verify_frames
from minimd.integrators.methods import METHODS
from minimd.integrators.splitting.splitting import Splitting
from minimd.structure.lattice import crystal

LAW = md.LennardJones(1.0, 1.0, 1.8)  # of a truncation for which other tests compile kernels too
NAMES = sorted(name for name, of in METHODS.items() if issubclass(of, Splitting))


def plain(method=None, **options):
    return simulation(liquid(3), LAW, method, **options)


def rigid(method=None, **options):
    """Dumbbells, some of their atoms fixed."""
    system = liquid(3)
    pairs = np.arange(len(system)).reshape(-1, 2)[5:]
    bonded = md.System(system.positions, cell=system.cell, bonds=pairs)
    return simulation(bonded, md.LennardJones(1.0, 1.0, 1.8, bonded_scale=(0.0, 1.0, 1.0)), method, [md.DistanceConstraints(pairs)], **options)


def springs(method=None, **options):
    """Two lists, because bonded pairs are scaled in one law and not in the other; fixed atoms; open along z."""
    system = liquid(3)
    pairs = np.arange(len(system)).reshape(-1, 2)
    slab = md.System(system.positions, cell=system.cell.vectors, pbc=(True, True, False), bonds=pairs)
    laws = [LAW, md.LennardJones(0.1, 1.0, 1.7, bonded_scale=(0.0, 1.0, 1.0)), md.HarmonicBond(20.0, 1.1)]
    return simulation(slab, laws, method, [md.FixedAtoms([0, 7])], **options)


def few(method=None, **options):
    """Too few for clusters, without a cell."""
    positions, _ = crystal("fcc", (2, 2, 2), 1.6)
    return simulation(md.System(positions), md.LennardJones(1.0, 1.0, 2.5), method, **options)


def crystal_of(n_cells):
    """Lennard-Jones atoms at the density of the melt."""
    positions, edges = crystal("fcc", [n_cells] * 3, 1.6796)
    return md.System(positions, cell=edges)


SCENES = {"plain": plain, "rigid": rigid, "springs": springs, "few": few}


def simulation(system, laws, method=None, constraints=None, **options):
    made = md.Simulation(system, laws, method or md.VelocityVerlet(0.003), constraints, **{"threads": 1, **options})
    made.set_temperature(1.2, 3)
    return made


def method_of(name):
    of = METHODS[name]
    return of(0.003, 1.2, 0.7, seed=4) if of.is_thermostat else of(0.003)


def assert_same_file(path, other):
    """All that minimd reads from them, to the last bit."""
    for one in (path, other):
        verify_frames(one)
    ours, theirs = read_file(path), read_file(other)
    for name in theirs.record.__dict__["_series"]:
        np.testing.assert_array_equal(getattr(ours.record, name), getattr(theirs.record, name), strict=True)
    for name in ("positions", "velocities"):
        np.testing.assert_array_equal(getattr(ours.system, name), getattr(theirs.system, name), strict=True)
    assert (ours.step, ours.time, ours.reservoir_energy) == (theirs.step, theirs.time, theirs.reservoir_energy)


SLOW = pytest.mark.slow  # the other half of the combinations


@pytest.mark.parametrize(
    ("precision", "threads"), [("double", 1), ("mixed", 2), pytest.param("double", 2, marks=SLOW), pytest.param("mixed", 1, marks=SLOW)]
)
@pytest.mark.parametrize("scene", SCENES)
def test_n_steps_and_m_steps_are_n_plus_m(scene, precision, threads, tmp_path):
    """In one process and through a file, stopped anywhere, for some methods drawn at random."""
    draw = random.Random(f"{scene} {precision} {threads}")
    for k in range(2):
        name, n, m, every = draw.choice(NAMES), draw.randrange(130), draw.randrange(1, 130), draw.choice([1, 7, 10, 50, 1000])
        skin = draw.choice([None, 0.05])  # with the latter, lists are built every few steps, some of them where a run stops
        with atoms_per_domain(50):
            whole, parts = (SCENES[scene](method_of(name), precision=precision, threads=threads, skin=skin) for _ in range(2))
            whole.run(n + m, every=every, trajectory=tmp_path / f"{k}.h5md")
            path = tmp_path / f"{k} in parts.h5md"
            parts.run(n, every=every, trajectory=path)
            if k % 2:
                parts = md.Simulation.resume(path, parts.potentials, threads=draw.choice([1, 2, 3]))
            parts.run(until_step=n + m, every=every, trajectory=path, append=True)
        np.testing.assert_array_equal(parts.positions, whole.positions)
        np.testing.assert_array_equal(parts.velocities, whole.velocities)
        assert_same_file(path, tmp_path / f"{k}.h5md")


@pytest.mark.parametrize("n", [30, 34])
def test_a_look_between_two_drifts_builds_no_list(n, tmp_path):
    """The run itself needs no forces there, also where it goes on from a file; its list, of another place, decides the order of the sums."""
    whole, parts = (plain(md.PositionVerlet(0.003), skin=0.05) for _ in range(2))
    whole.run(80)
    parts.run(n, trajectory=tmp_path / "a.h5md")
    parts = md.Simulation.resume(tmp_path / "a.h5md", LAW, threads=1)
    parts.run(until_step=80)
    np.testing.assert_array_equal(parts.positions, whole.positions)


def large(method=None, **options):
    """32 000 atoms."""
    return simulation(crystal_of(20), LAW, method, **options)


def assert_survives_kills(scene, every_kth, folder, monkeypatch):
    """Start, flushes with new chunks, checkpoints between two frames, and the close; then the resumed run is killed likewise."""
    bring_to_disk_every(0.0, monkeypatch)
    monkeypatch.setattr("minimd.files.h5md_schema.CHUNK_BYTES", 6000)  # two frames
    monkeypatch.setattr("minimd.simulation.simulation.SECONDS_BETWEEN_CHECKPOINTS", 0.0)
    monkeypatch.setattr("minimd.diagnosis.run_guard.RunGuard.block", 4)
    method = md.LangevinBAOAB(0.003, 1.2, 0.7, seed=4) if scene is rigid else md.VelocityVerlet(0.003)
    whole, path, n_steps = folder / "whole.h5md", folder / "a.h5md", 13
    reference = scene(method)
    reference.run(n_steps, every=5, trajectory=whole)

    def begin():
        scene(method).run(n_steps, every=5, trajectory=path)

    def go_on():
        md.Simulation.resume(path, reference.potentials, threads=1).run(until_step=n_steps, every=5, trajectory=path, append=True)

    n_changes = killed_at(0, begin)
    assert n_changes > 40
    path.unlink()
    n_lost = n_killed = 0
    for k in range(1, n_changes + 1, every_kth):
        assert killed_at(k, begin) is None
        if path.exists():
            if not (folder / "a.h5md.journal").exists():  # nothing to repair
                universe = MDAnalysis.Universe.empty(len(reference.system)).load_new(str(path))
                assert len(universe.trajectory) >= 1
                universe.trajectory.close()
            if read_file(path).step < n_steps:
                n_killed += killed_at(1 + k % 17, go_on) is None
                go_on()
        else:
            n_lost += 1
            begin()
        assert_same_file(path, whole)
        path.unlink()
    assert n_lost * every_kth < 60  # kills before the first frame was there
    assert n_killed * every_kth > 50
    assert sorted(os.listdir(folder)) == ["whole.h5md"]
    return n_changes


def test_a_run_killed_at_some_writes_goes_on_to_the_same_bits(tmp_path, monkeypatch):
    assert_survives_kills(rigid, 58, tmp_path, monkeypatch)


@pytest.mark.slow
@pytest.mark.parametrize("scene", [plain, rigid, large])
def test_a_run_killed_at_any_write_goes_on_to_the_same_bits(scene, tmp_path, monkeypatch):
    print(f"killed at {assert_survives_kills(scene, 1, tmp_path, monkeypatch)} places")


@pytest.mark.slow
@pytest.mark.parametrize("threads", [1, 2])
@pytest.mark.parametrize("seed", range(10))
def test_random_kills_while_it_runs_and_resumes(seed, threads, tmp_path, monkeypatch):
    """Each run is killed fifty times, at any moment, and brings all it has to the disk as often as it can.

    The longest time before a kill is three times what a resumed run of 100 steps takes, on a processor as busy as now.
    """
    bring_to_disk_every(0.01, monkeypatch)
    monkeypatch.setattr("minimd.simulation.simulation.SECONDS_BETWEEN_CHECKPOINTS", 0.01)
    draw, path, whole = random.Random(f"{seed} {threads}"), tmp_path / "a.h5md", tmp_path / "whole.h5md"
    scene, method = SCENES[draw.choice(sorted(SCENES))], draw.choice(NAMES)

    def go_on(end):
        known = path.exists()
        made = scene(method_of(method), threads=threads)
        sim = md.Simulation.resume(path, made.potentials, threads=threads) if known else made
        sim.run(until_step=end, every=50, trajectory=path, append=known)

    with atoms_per_domain(50):
        scene(method_of(method)).run(50)  # the children find kernels that are loaded
        resumed = min([seconds_of(lambda: go_on(end)) for end in (50, 150, 250)][1:])
        path.unlink()
        assert sum(killed_after(3 * resumed * draw.random(), lambda: go_on(10**9)) for _ in range(50)) == 50
        end = read_file(path).step + 100
        assert end > 300
        go_on(end)
        scene(method_of(method)).run(end, every=50, trajectory=whole)
    assert_same_file(path, whole)
