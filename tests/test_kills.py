"""A run that is killed at any of its writes goes on to the same last bit, and so does one that is stopped anywhere."""

import os
import random

import numpy as np
import pytest
from cluster_scenes import atoms_per_domain
from damages import numbers
from h5md_runs import bring_to_disk_every
from kills import killed_after, seconds_of
from recorder import runs
from recorder.disk import NAMES as NAMES_KEPT
from recorder.disk import recorded
from recorder.runs import KINDS, RESUMES, Survey, begin, begin_resumes, reference, text_of
from references import liquid

import minimd as md
from minimd.commands import main as cli
from minimd.files import journaled_file
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
    return simulation(
        bonded,
        md.LennardJones(1.0, 1.0, 1.8, bonded_scale=(0.0, 1.0, 1.0)),
        method,
        [md.DistanceConstraints(pairs)],
        **options,
    )


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


EARLIER = ("minimd/earlier_restart", "minimd/blocks")
SLOW = pytest.mark.slow  # the other half of the combinations


@pytest.mark.parametrize(
    ("precision", "threads"),
    [("double", 1), ("mixed", 2), pytest.param("double", 2, marks=SLOW), pytest.param("mixed", 1, marks=SLOW)],
)
@pytest.mark.parametrize("scene", SCENES)
def test_n_steps_and_m_steps_are_n_plus_m(scene, precision, threads, tmp_path):
    """In one process and through a file, stopped anywhere, for some methods drawn at random."""
    draw = random.Random(f"{scene} {precision} {threads}")
    for k in range(2):
        name, n, m, every = (
            draw.choice(NAMES),
            draw.randrange(130),
            draw.randrange(1, 130),
            draw.choice([1, 7, 10, 50, 1000]),
        )
        skin = draw.choice(
            [None, 0.05]
        )  # with the latter, lists are built every few steps, some of them where a run stops
        with atoms_per_domain(50):
            whole, parts = (
                SCENES[scene](method_of(name), precision=precision, threads=threads, skin=skin) for _ in range(2)
            )
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


MODELS = ("kill", "torn", *NAMES_KEPT)


def survey(kinds, seeds, folder):
    """What becomes of states of the disk of some runs, drawn by each model: those that do not end as the uninterrupted run did."""
    root, resumes = folder / "root", sorted(set(kinds) & set(RESUMES))
    begin(root, [kind for kind in kinds if kind not in RESUMES] + ["nve"][: len(resumes)])
    disk = recorded(runs.__file__, root, folder)
    if resumes:
        root = folder / "resumes"
        begin_resumes(root, disk.part("nve"))
        disk = recorded(runs.__file__, root, folder)
    surveys = [Survey(kind, disk.part(kind), reference(root / kind), folder / "state") for kind in kinds]
    found = [(one.kind, model, seed, *one.of(model, seed)) for one in surveys for model in MODELS for seed in seeds]
    print(f"{len(found)} states of {kinds}, {sum(one.n_judged for one in surveys)} of them differ after their repair")
    return [one for one in found if one[-1] != "identical"]


def test_a_run_goes_on_to_the_same_bits_after_kills_and_power_failures(tmp_path):
    assert not survey(["formats"], range(7), tmp_path)


@pytest.mark.slow
@pytest.mark.parametrize("kind", [*KINDS, *RESUMES])
def test_a_run_goes_on_to_the_same_bits_whatever_is_on_the_disk(kind, tmp_path):
    assert not survey([kind], range(69), tmp_path)


def interrupt(*_):
    raise KeyboardInterrupt


def test_a_file_that_is_moved_in_the_middle_of_a_commit_is_whole(tmp_path, monkeypatch):
    sim, whole = plain(), plain()
    sim.run(10, every=5, trajectory=tmp_path / "a.h5md")
    whole.run(20, every=5, trajectory=tmp_path / "whole.h5md")

    def half(descriptor, size, pieces):
        for place, data in pieces[: len(pieces) // 2]:
            os.pwrite(descriptor, data, place)
        raise KeyboardInterrupt

    with monkeypatch.context() as patch:
        patch.setattr(journaled_file, "_apply", half)
        with pytest.raises(KeyboardInterrupt):
            sim.run(10, every=5, trajectory=tmp_path / "a.h5md", append=True)
    moved = (tmp_path / "a.h5md").rename(tmp_path / "moved.h5md")
    assert read_file(moved).step >= 10
    md.Simulation.resume(moved, LAW, threads=1).run(until_step=20, every=5, trajectory=moved, append=True)
    assert_same_file(moved, tmp_path / "whole.h5md")


def test_a_run_that_ends_before_its_results_are_written_gets_them(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    for name in ("a", "whole"):
        (tmp_path / f"{name}.toml").write_text(text_of("observers"))
    assert cli.main(["run", "whole.toml", "--quiet"]) == 0
    with monkeypatch.context() as patch:
        patch.setattr("minimd.files.h5md_writer.write_answers", interrupt)
        assert cli.main(["run", "a.toml", "--quiet"]) != 0
    assert numbers("a.h5md", EARLIER) != numbers("whole.h5md", EARLIER)
    assert cli.main(["resume", "a.h5md", "--quiet"]) == 0
    assert numbers("a.h5md", EARLIER) == numbers("whole.h5md", EARLIER)
    assert cli.main(["resume", "a.h5md", "--quiet"]) == 2
    assert "dynamics.steps = 13" in capsys.readouterr().err


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
