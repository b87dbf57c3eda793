"""Fixed-point dynamics at length: a melt of 4000 atoms, every width of vectors, NIST's configurations, the energy."""

import numpy as np
import pytest
from fixed_point_scenes import bits, mixture, simulated, total_momentum
from hypothesis import HealthCheck, given, settings, strategies as st

import minimd as md
from minimd.bench.scenes import melt
from minimd.core.compiled.simd.vector import Lanes4, Lanes8
from minimd.core.neighbors import cluster_list

pytestmark = pytest.mark.slow
LJ = md.LennardJones(1.0, 1.0, cutoff=2.5)


def of_melt(cells, precision="fixed-point", timestep=0.005, **options):
    return md.Simulation(melt(cells).system, LJ, md.VelocityVerlet(timestep), precision=precision, **options)


def test_a_long_run_of_a_melt():
    """4000 atoms, 100 000 steps on two threads: Σ P changes by 0; 20 000 steps and back return all bits."""
    simulation = of_melt(10, threads=2)
    grid = simulation.engine.interactions.grid
    assert (grid.length, grid.momentum) == (2.0**-41, 2.0**-44)  # what the page says
    simulation.make_steps(0)
    start, total = bits(simulation), total_momentum(simulation)
    simulation.make_steps(20_000)
    simulation.run_back(20_000)
    assert bits(simulation) == start
    simulation.make_steps(100_000)
    assert total_momentum(simulation) == total


def test_vectors_of_every_width_have_the_same_bits(monkeypatch):
    usual = simulated(mixture())
    usual.make_steps(500)
    for kind in (Lanes4, Lanes8):
        monkeypatch.setattr(cluster_list, "lanes_for", kind)
        other = simulated(mixture())
        other.make_steps(500)
        assert kind in [type(term.list.lanes) for term in other.engine.interactions.terms if term.list is not None]
        assert bits(other) == bits(usual)


@pytest.mark.parametrize("timestep", [0.008, 0.005, 0.002])
def test_the_energy_oscillates_as_in_float64(timestep):
    runs = [of_melt(8, one, timestep).run(int(2.0 / timestep), every=1) for one in ("double", "fixed-point")]
    assert runs[1].total_energy.std() == pytest.approx(runs[0].total_energy.std(), rel=0.01)


def test_the_energy_does_not_drift():
    law = md.LennardJones(1.0, 1.0, cutoff=2.5, truncation="switched")
    simulation = md.Simulation(melt(5).system, law, md.VelocityVerlet(0.004), precision="fixed-point")
    simulation.run(250_000, every=50)
    drift = simulation.report().energy_drift
    print(drift)
    assert abs(drift.slope) < 3.0 * drift.error


@settings(max_examples=200, suppress_health_check=list(HealthCheck))
@given(
    *(st.floats(0.1, 1e4), st.floats(0.3, 2.0), st.integers(0, 10**6), st.sampled_from([1e-4, 1e-3, 5e-3])),
    st.integers(0, 99),
)
def test_hot_fast_and_far_atoms_are_right_or_stopped(speed, distance, far, timestep, seed):
    """Whatever happens, momentum is constant and steps lead back, or an error says what left its range."""
    system = mixture(with_bonds=False)
    system.velocities[3] = speed * np.random.default_rng(seed).normal(size=3)
    system.positions[4] = system.positions[5] + distance * np.array([1.0, 0.0, 0.0])
    system.positions[:] += far * system.cell.vectors[0]
    message = "beyond the range"
    try:
        simulation = simulated(system, md.VelocityVerlet(timestep), grid=None)
        simulation.make_steps(0)
        start, total = bits(simulation), total_momentum(simulation)
        simulation.make_steps(30)
        assert total_momentum(simulation) == total
        simulation.run_back(30)
        assert bits(simulation) == start
    except (md.RangeError, md.NonFiniteError, ValueError) as error:
        message = str(error)
    words = ("beyond the range", "past every neighbor", "would move it", "not finite", "shift them")
    assert any(word in message for word in words), message
