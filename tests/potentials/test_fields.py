"""Fields that depend on time: springs that are moved, and the work that goes through them into the energy."""

import numpy as np
import pytest

import minimd as md

MASS, K, V = 1.5, 6.0, np.array([0.8, 0.0, 0.0])
OMEGA = (K / MASS) ** 0.5


def pulled(method, **more):
    """One atom on a spring whose point leaves at constant velocity: x = vt − (v/ω) sin ωt, W = m v² (1 − cos ωt)."""
    return md.Simulation(md.System([[0.0, 0.0, 0.0]], masses=MASS), md.SteeredSpring(K, [0, 0, 0], V, **more), method)


@pytest.mark.parametrize("name", ["velocity-verlet", "position-verlet", "leapfrog", "suzuki-4", "pefrl"])
def test_methods_keep_their_order_in_time_dependent_fields(name):
    """Each force is evaluated at the time at which its kick stands, and the work with it."""
    method, errors, apart = md.integrators.METHODS[name], [], []
    for n in (40, 80):
        simulation = pulled(method(2.0 / n))
        record = simulation.run(n, every=n, progress=False)
        exact = V[0] * 2.0 - V[0] / OMEGA * np.sin(OMEGA * 2.0)
        errors.append(abs(simulation.positions[0, 0] - exact))
        apart.append(abs(record.work[-1] - MASS * V[0] ** 2 * (1.0 - np.cos(OMEGA * 2.0))))
        assert record.total_energy[-1] - record.work[-1] == pytest.approx(0.0, abs=2e-3)
    assert np.log2(errors[0] / errors[1]) == pytest.approx(method.order, abs=0.2)
    assert np.log2(apart[0] / apart[1]) == pytest.approx(method.order, abs=0.3)


@pytest.mark.parametrize("method", [md.VelocityVerlet, md.PositionVerlet])
def test_a_spring_moves_from_its_start_to_its_end_and_only_then(method):
    """A step that ends at the start does no work; the next one does, and the last ends at the end."""
    changes = np.diff(pulled(method(0.25), start=0.5, end=1.0).run(8, every=1, progress=False).work)
    assert (changes != 0.0).tolist() == [False, False, True, True, False, False, False, False]


def test_looking_changes_no_bit_of_the_work_though_it_evaluates_the_forces_again():
    """A bath at the end of a step leaves no energy there: it is evaluated at the time of the last kick exactly."""
    bath = md.StochasticVelocityRescaling(0.003, temperature=1.0, relaxation_time=0.2, seed=2)
    works = []
    for every in (1, 60):
        spring = md.SteeredSpring(10.0, [0, 0, 0], [0.3, 0.2, 0], start=0.02)
        simulation = md.Simulation(md.System(np.diag([0.01, 0.02, 0.03])), spring, bath)
        simulation.set_temperature(1.0, seed=1)
        simulation.run(60, every=every, progress=False)
        works.append(simulation.work)
    assert works[0] == works[1] != 0.0


def test_the_report_judges_the_energy_minus_the_work_and_an_equilibration_comes_before_the_time_zero():
    simulation = pulled(md.VelocityVerlet(0.02))
    assert np.ptp(simulation.run(2000, every=10, progress=False).total_energy) > 1.0
    assert "total energy minus work is conserved" in str(simulation.report())
    simulation = pulled(md.VelocityVerlet(0.02))
    simulation.set_temperature(1e-12, seed=1)
    simulation.equilibrate(30, 1e-12)
    assert (simulation.step, simulation.time, simulation.work) == (0, 0.0, 0.0)
    assert np.abs(simulation.positions).max() < 1e-5  # the way of such an atom; its point moves 0.5 in as many steps
