"""The number of threads changes nothing, to the last bit."""

import numpy as np
import pytest
from cluster_scenes import KINDS, SMOOTH, atoms_per_domain, n_domains, rod
from references import melt

import minimd as md
from minimd.forces.cluster_term import ClusterTerm
from minimd.forces.options import Options
from minimd.integrators.methods import METHODS

THREADS = [2, 3, 4, 8]
SERIES = (
    "potential_energy",
    "kinetic_energy",
    "total_energy",
    "temperature",
    "pressure",
    "momentum",
    "angular_momentum",
)


def mixture():
    """Chains of three species in a long cell, 1-2 and 1-3 neighbors excluded, held together by springs."""
    bonded = md.LennardJones(KINDS, cutoff=2.0, truncation="force-shifted", bonded_scale=(0.0, 0.0, 0.5))
    return rod(30, 5), [bonded, md.HarmonicBond(50.0, 1.1)]


SCENES = {
    "melt": lambda: (melt(), md.LennardJones(1.0, 1.0, 2.5)),
    "rod": lambda: (rod(30, 5), SMOOTH["two known laws"]),
    "mixture": mixture,
}


def ran(scene, precision, threads, n_steps):
    system, potentials = SCENES[scene]()
    with atoms_per_domain(100):  # a team of eight, and as many chunks as the cell is long
        simulation = md.Simulation(system, potentials, md.VelocityVerlet(0.003), threads=threads, precision=precision)
        if not system.velocities.any():
            simulation.set_temperature(1.5, 2)
        return simulation, simulation.run(n_steps, every=max(1, n_steps // 20))


def assert_same_bits_on_any_number_of_threads(scene, precision, n_steps):
    one, record = ran(scene, precision, 1, n_steps)
    term = next(term for term in one.engine.interactions.terms if term.list is not None)
    assert n_domains(term) >= 4
    assert term.list.n_builds > 1
    for threads in THREADS:
        other, same = ran(scene, precision, threads, n_steps)
        assert (
            next(term for term in other.engine.interactions.terms if term.list is not None)._pool.n_threads == threads
        )
        assert np.array_equal(other.positions, one.positions)
        assert np.array_equal(other.velocities, one.velocities)
        assert np.array_equal(other.forces, one.forces)
        assert all(np.array_equal(getattr(same, name), getattr(record, name)) for name in SERIES)


@pytest.mark.parametrize("precision", ["double", "mixed"])
@pytest.mark.parametrize("scene", SCENES)
def test_any_number_of_threads_gives_the_same_bits(scene, precision):
    assert_same_bits_on_any_number_of_threads(scene, precision, 200)


@pytest.mark.slow
@pytest.mark.parametrize("precision", ["double", "mixed"])
@pytest.mark.parametrize("scene", SCENES)
def test_a_thousand_steps_on_any_number_of_threads_give_the_same_bits(scene, precision):
    assert_same_bits_on_any_number_of_threads(scene, precision, 1000)


@pytest.mark.parametrize("precision", ["double", "mixed"])
def test_energies_of_atoms_have_the_same_bits_too(precision):
    system, potentials = mixture()
    with atoms_per_domain(100):
        one, eight = (md.Forces(system, potentials, Options(threads, precision)) for threads in (1, 8))
    for forces in (one, eight):
        forces.compute(md.potentials.PER_ATOM)
    assert np.array_equal(one.energies, eight.energies)
    assert np.array_equal(one.virials, eight.virials)
    assert np.array_equal(one.forces, eight.forces)


@pytest.mark.parametrize("precision", ["double", "mixed"])
def test_the_same_run_twice_gives_the_same_bits(precision):
    (one, _), (other, _) = (ran("mixture", precision, 2, 50) for _ in range(2))
    assert np.array_equal(one.positions, other.positions)


def marched(method, precision, marches, monkeypatch):
    """A gas of three species, open along z, whose clusters have padding: its end, and how many forces were evaluated and lists built."""
    monkeypatch.setattr(ClusterTerm, "marches", marches)
    positions = melt().positions * np.array([1.0, 1.0, 1.7])
    cell, species = np.diag([*melt().cell.heights[:2], 60.0]), ["A", "B", "C", "A"] * (len(positions) // 4)
    system = md.System(positions, cell=cell, pbc=(True, True, False), species=species)
    simulation = md.Simulation(system, SMOOTH["three species"], method, precision=precision)
    simulation.set_temperature(1.5, 2)
    simulation.run(75, every=25)
    return simulation.positions, simulation.velocities, simulation.engine.interactions.counts


@pytest.mark.parametrize(
    ("name", "precision"),
    [("velocity-verlet", "double"), ("velocity-verlet", "mixed"), ("position-verlet", "double"), ("ruth-3", "mixed")],
)
def test_many_steps_in_one_call_have_the_bits_of_single_ones(name, precision, monkeypatch):
    method = METHODS[name](0.004)
    together, alone = (marched(method, precision, marches, monkeypatch) for marches in (True, False))
    assert all(np.array_equal(one, other) for one, other in zip(together, alone, strict=True))
    assert alone[2][1] > 3  # lists


def test_plain_scenes_march_and_others_do_not(monkeypatch):
    calls, march = [], ClusterTerm.march
    monkeypatch.setattr(ClusterTerm, "march", lambda self, *arguments: calls.append(1) or march(self, *arguments))
    pair, fixed = md.LennardJones(1.0, 1.0, 2.5), md.FixedAtoms([0])
    scenes = {
        "plain": (md.VelocityVerlet(0.003), [pair], ()),
        "atoms fixed": (md.VelocityVerlet(0.003), [pair], fixed),
        "bath": (md.LangevinBAOAB(0.003, 1.0, 1.0, seed=1), [pair], ()),
        "rigid": (md.VelocityVerlet(0.003), [pair], md.DistanceConstraints([[0, 1]])),
        "springs": (md.VelocityVerlet(0.003), [pair, md.HarmonicBond(50.0, 1.1)], ()),
    }
    marching = set()
    for name, (method, potentials, constraints) in scenes.items():
        system = melt()
        if name == "springs":
            system = md.System(system.positions, cell=system.cell, bonds=[[0, 1]])
        calls.clear()
        md.Simulation(system, potentials, method, constraints).run(10)
        if calls:
            marching.add(name)
    assert marching == {"plain", "atoms fixed", "bath"}
