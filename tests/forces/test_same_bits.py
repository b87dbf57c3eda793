"""What changes no bit: the number of threads, how many steps are made at a time, and where memory ends."""

from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest
from cluster_scenes import MANY, SKIN, atoms_per_domain, rod
from references import melt
from scenes import LJ, SCENES, TWO_KINDS

import minimd as md
from minimd.core.neighbors.cluster_list import ClusterList

SERIES = ("potential_energy", "total_energy", "temperature", "pressure", "momentum", "angular_momentum")
BONDED = [*MANY, md.HarmonicBond(50.0, 1.1)]
START = {  # as many domains as the cell is long, a team of eight
    "chains": lambda: (rod(6), BONDED), "melt": lambda: (melt(), [LJ]),
    "rod": lambda: (rod(6, 5), MANY),   "long chains": lambda: (rod(6, 5), BONDED),
}  # fmt: skip
LONG = [pytest.param(name, 1000, [2, 3, 4, 8], marks=pytest.mark.slow) for name in ("melt", "rod", "long chains")]
BATH = md.LangevinBAOAB(0.004, 1.2, 2.0, seed=2**100 + 7)
FREE = md.VelocityVerlet(0.004)
RESCALED = md.StochasticCellRescaling(3.0, 0.1, 0.2, seed=2, every=7, coupling="triclinic")  # few cells need no list
ON_THE_ROAD = {  # a method, and options
    "free": (FREE, {}), "bath": (BATH, {}), "fixed-point": (FREE, {"precision": "fixed-point"}),
    "strained": (BATH, {"barostat": RESCALED}),
    "two threads": (md.integrators.METHODS["position-verlet"](0.004), {"threads": 2, "is_open": True}),
}  # fmt: skip


def ran(scene, threads, n_steps):
    system, potentials = START[scene]()
    with atoms_per_domain(50):
        simulation = md.Simulation(system, potentials, md.VelocityVerlet(0.003), threads=threads, skin=SKIN)
        if not system.velocities.any():
            simulation.set_temperature(1.5, 2)
        return simulation, simulation.run(n_steps, every=max(1, n_steps // 20))


def clusters_of(simulation):
    return next(term for term in simulation.engine.interactions.terms if term.list is not None)


@pytest.mark.parametrize(("scene", "n_steps", "teams"), [("chains", 100, [2, 8]), *LONG])
def test_any_number_of_threads_gives_the_same_bits(scene, n_steps, teams):
    one, record = ran(scene, 1, n_steps)
    assert clusters_of(one).list.n_domains >= 4
    assert clusters_of(one).list.n_builds > 1
    for threads in teams:
        other, same = ran(scene, threads, n_steps)
        assert clusters_of(other).pool.n_threads == threads
        for name in ("positions", "velocities", "forces"):
            assert np.array_equal(getattr(other, name), getattr(one, name))
        assert all(np.array_equal(getattr(same, name), getattr(record, name)) for name in SERIES)


def mixture(method, precision="double", is_open=False, seed=1, **options):
    """Two species in a triclinic cell; open along z clusters have padding."""
    system = SCENES["mixture"]().system
    pbc = (True, True, not is_open)
    parts = {"species": system.species, "masses": system.masses, "cell": system.cell.vectors}
    system = md.System(system.positions * (1.0, 1.0, 1.3 if is_open else 1.0), pbc=pbc, **parts)
    simulation = md.Simulation(system, TWO_KINDS, method, precision=precision, **{"threads": 1, **options})
    simulation.set_temperature(1.5, seed)
    return simulation


def ended(simulation, n_steps=100):
    simulation.run(n_steps, every=25, progress=False)
    vectors = simulation.positions, simulation.velocities, simulation.system.cell.vectors
    return *vectors, simulation.reservoir_energy, simulation.engine.interactions.counts


def assert_same_bits(one, other):
    assert all(np.array_equal(a, b) for a, b in zip(one, other, strict=True))


@pytest.mark.parametrize("name", ON_THE_ROAD)
def test_scarce_memory_and_single_steps_change_no_bit(name, monkeypatch):
    """After the first list the memory becomes so scarce that Python must make room in the midst of a step."""
    method, options = ON_THE_ROAD[name]
    ends, enlarged, fit = [], [], ClusterList._fit

    def counted(self, *answers, **how):
        enlarged.extend(self.n_builds for _ in answers)
        fit(self, *answers, **how)

    monkeypatch.setattr(ClusterList, "_fit", counted)
    for kind in ("block", "scarce", "single"):
        with atoms_per_domain(50 if "threads" in options else 800):
            simulation = mixture(method, **options)
            simulation.run(1, progress=False)
            if kind == "scarce":
                found = clusters_of(simulation).list
                entry_start = found._store.entry_start
                entry_start[-1] = found._store.needed[-1] + entry_start[-2]
            if kind == "single":
                simulation.guard.make_steps(1)
                for _ in range(98):
                    simulation.engine.advance(1)
                    simulation.engine.count(1)
                simulation.engine.evaluate()
                vectors = simulation.positions, simulation.velocities, simulation.system.cell.vectors
                ends.append((*vectors, simulation.reservoir_energy))
            else:
                ends.append(ended(simulation, 99)[:-1])
    for end in ends[1:]:
        assert_same_bits(ends[0], end)
    assert max(enlarged) > 0
    assert simulation.engine.interactions.n_builds > 3
    assert (ends[0][-1] != 0.0) == (name in ("bath", "strained"))
    anew = md.evaluate(simulation.system, simulation.potentials).forces
    assert simulation.forces == pytest.approx(anew, abs=1e-10 * np.abs(anew).max(), rel=0)


def test_another_process_of_a_derived_bath_is_not_left_out():

    class Frozen(md.LangevinBAOAB):
        def thermalize(self, state, duration, around):
            state.velocities[:] = 0.0

    simulation = mixture(Frozen(0.004, 1.0, 1.0, 1))
    start = simulation.positions.copy()
    simulation.run(20, progress=False)
    assert np.abs(simulation.positions - start).max() < 0.05  # else 0.2


def test_replicas_in_threads_of_one_process_have_the_bits_of_single_runs():
    replica = lambda seed: ended(mixture(BATH if seed % 2 else FREE, seed=seed), 100)  # noqa: E731
    with ThreadPoolExecutor(3) as pool:
        together = list(pool.map(replica, range(4)))
    for seed, one in enumerate(together):
        assert_same_bits(one, replica(seed))


def test_maps_of_dihedrals_have_the_same_bits_with_threads_and_after_a_resume(tmp_path):
    """1200 terms, in two chunks."""
    k = np.arange(1205)
    places = np.column_stack([np.cos(0.9 * k), np.sin(0.9 * k), 0.4 * k + 0.1 * np.sin(k * k)])
    angles = k[:1200, None] + np.arange(4)
    maps = np.random.default_rng(2).normal(size=(3, 6, 6))
    laws = [md.DihedralMap(maps, angles, angles + 1, k[:1200] % 3), md.HarmonicBond(50.0, 1.0)]
    system = md.System(places, bonds=np.column_stack([k[:-1], k[1:]]))
    one = md.Simulation(system.copy(), laws, FREE, threads=1)
    one.run(25)
    other = md.Simulation(system.copy(), laws, FREE, threads=2)
    other.run(11, every=11, trajectory=tmp_path / "run.h5md")
    other = md.Simulation.resume(tmp_path / "run.h5md", laws, threads=2)
    other.run(14)
    assert np.abs(one.positions - places).max() > 0.01
    for name in ("positions", "velocities", "forces"):
        assert np.array_equal(getattr(other, name), getattr(one, name))
