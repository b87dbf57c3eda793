"""A run that is killed at any of its writes goes on to the same last bit, and so does one that is stopped anywhere."""

import random

import numpy as np
import pytest
from cluster_scenes import atoms_per_domain
from damages import KILLED, killed_at
from h5md_runs import assert_same_file, bring_to_disk_every, resumed, simulation
from recorder.runs import KINDS, RESUMES, survey
from scenes import BONDED, LJ, SCENES, Scene

import minimd as md
from minimd.integrators.methods import METHODS
from minimd.integrators.splitting.splitting import Splitting
from minimd.structure.system import changed

NAMES = sorted(name for name, of in METHODS.items() if issubclass(of, Splitting))


def springs():
    """Two lists: bonded pairs are scaled in one law and not in the other; fixed atoms; open along z."""
    slab = changed(SCENES["slab"]().system, bonds=np.arange(108).reshape(-1, 2))
    return Scene(slab, [LJ, BONDED, md.HarmonicBond(20.0, 1.1)], [md.FixedAtoms([0, 7])])


def few():
    """Too few for clusters, without a cell."""
    of = SCENES["droplet"]().system
    return Scene(md.System(of.positions[:27], velocities=of.velocities[:27]), [LJ])


def bursting():
    """A hot droplet about a corner of a wide cell."""
    of = SCENES["argon"]().system
    return Scene(md.System(of.positions - 2.5, velocities=3.0 * of.velocities, cell=40.0), [LJ])


RUNS = {name: SCENES[name] for name in ("argon", "dumbbells")} | {"springs": springs, "few": few, "bursting": bursting}
COMMON = ["velocity-verlet", "position-verlet", "langevin-baoab"]  # whose kernels other tests compile, too
SLOW = [(scene, n, NAMES) for scene in RUNS for n in (1, 2)]


def begun(scene, name, threads=1, **options):
    """The simulation of a scene by the method of a name."""
    scene, of = RUNS[scene](), METHODS[name]
    method = of(scene.timestep, 1.2, 0.7, seed=4) if of.is_thermostat else of(scene.timestep)
    return scene.simulation(method, threads=threads, **options)


ROWS = [("argon", 2, COMMON), ("bursting", 1, COMMON[:1])]
ROWS += [pytest.param(*row, marks=pytest.mark.slow) for row in SLOW]


@pytest.mark.parametrize(("scene", "threads", "names"), ROWS)
def test_n_steps_and_m_steps_are_n_plus_m(scene, threads, names, tmp_path):
    """In one process and through a file, stopped anywhere, for some methods drawn at random."""
    draw = random.Random(f"{scene} {threads}")
    for k in range(2):
        name, n, m = draw.choice(names), draw.randrange(60), draw.randrange(1, 60)
        every, skin = draw.choice([1, 7, 10, 50, 1000]), draw.choice([None, 0.05])  # thin: lists where it stops
        file, path = tmp_path / f"{k}.h5md", tmp_path / f"{k} in parts.h5md"
        with atoms_per_domain(50):
            whole, parts = (begun(scene, name, threads, skin=skin) for _ in range(2))
            whole.run(n + m, every=every, trajectory=file)
            parts.run(n, every=every, trajectory=path)
            if k % 2:
                parts = md.Simulation.resume(path, parts.potentials, threads=draw.choice([1, 2, 3]))
            parts.run(until_step=n + m, every=every, trajectory=path, append=True)
        np.testing.assert_array_equal(parts.positions, whole.positions)
        np.testing.assert_array_equal(parts.velocities, whole.velocities)
        assert_same_file(path, file)


@pytest.mark.parametrize("n", [30, 34])
def test_a_look_between_two_drifts_builds_no_list(n, tmp_path):
    """The run itself needs no forces there; its list, of another place, decides the order of the sums."""
    whole, parts = (begun("argon", "position-verlet", skin=0.05) for _ in range(2))
    whole.run(80)
    parts.run(n, trajectory=tmp_path / "a.h5md")
    parts = md.Simulation.resume(tmp_path / "a.h5md", LJ, threads=1)
    parts.run(until_step=80)
    np.testing.assert_array_equal(parts.positions, whole.positions)


def test_a_run_that_is_killed_before_a_change_of_its_file_goes_on_to_the_same_bits(tmp_path, monkeypatch):
    bring_to_disk_every(0.0, monkeypatch)
    path, whole = tmp_path / "a.h5md", tmp_path / "whole.h5md"
    simulation().run(15, every=5, trajectory=whole)
    assert killed_at(12, lambda: simulation().run(15, every=5, trajectory=path)) == KILLED
    resumed(path).run(until_step=15, every=5, trajectory=path, append=True)
    assert_same_file(path, whole)


@pytest.mark.slow
@pytest.mark.parametrize("kind", [*KINDS, *RESUMES])
def test_a_run_goes_on_to_the_same_bits_whatever_is_on_the_disk(kind, tmp_path):
    assert not survey([kind], range(69), tmp_path)
