"""Run time against error: fronts, advice, and errors that fall as they should."""

import numpy as np
import pytest

import minimd as md
from minimd.bench import work_precision
from minimd.bench.scenes import SCENES
from minimd.bench.work_precision import about_line


def test_the_front_of_work_precision_is_what_nothing_beats():
    def point(who, seconds, oscillation):
        return work_precision.Point(who, "verlet", 2, 0.01, 100.0, seconds, oscillation, 0.0, np.nan)

    ours = [
        point("minimd", 1.0, 1e-2),
        point("minimd", 2.0, 1e-3),
        point("minimd", 3.0, 2e-3),
        point("minimd", 0.5, np.inf),
    ]
    case = work_precision.Case("case", "text", "τ", [*ours, point("peer", 6.0, 1e-3), point("peer", 3.0, 2e-2)])
    assert case.front("oscillation") == ours[:2]
    assert case.advice("oscillation")[1:] == [
        "for oscillation 1e-02 use verlet, Δt = 0.01 τ, minimd: 1 s",
        "for oscillation 1e-03 use verlet, Δt = 0.01 τ, minimd: 2 s",
    ]
    assert case.beside() == ["peer: 3.00 times the time of minimd at equal oscillation (3.00 to 3.00)"]


def test_a_run_that_fails_has_no_finite_error():
    """Not even the distance, which was measured in a run that was shorter."""

    def failing():
        raise ArithmeticError

    engine = type("Engine", (), {"run": lambda *_: failing()})
    point = work_precision._point("minimd", SCENES["melt"](3), md.VelocityVerlet, 20, engine, 2, 1e-3)
    assert (point.seconds, point.oscillation, point.drift, point.distance) == (np.inf,) * 4


def test_errors_are_about_the_line_of_regression():
    time = np.linspace(0.0, 1.0, 41)
    energies = 3.0 + 0.5 * time + 0.1 * np.tile([1.0, -1.0], 21)[:41]
    oscillation, drift = about_line(time, energies)
    assert oscillation == pytest.approx(0.1, rel=1e-2)
    assert drift == pytest.approx(0.5, rel=1e-2)
    assert about_line(np.array([0.0, 1.0]), np.array([1.0, np.nan])) == (np.inf, np.inf)


@pytest.mark.slow
def test_work_precision_of_minimd_falls_with_the_order_of_the_method(monkeypatch):
    """Real runs of a few atoms: the errors of velocity Verlet fall with the square of the time step, and so do those of its paths."""
    monkeypatch.setattr(work_precision, "CELLS_QUICK", 4)
    monkeypatch.setattr(work_precision, "COSTS_QUICK", (100, 200, 400))
    monkeypatch.setattr(work_precision, "QUICK_METHODS", ("velocity-verlet",))
    monkeypatch.setattr(work_precision, "PEER_NAMES", ())
    (case,) = work_precision.run_work_precision(["argon-smooth"], True, 1).cases
    exact = [p for p in case.points if p.who == "minimd, double"]
    assert np.diff(np.log2([p.distance for p in exact])) == pytest.approx([-2.0, -2.0], abs=0.2)
    assert 8.0 < exact[0].oscillation / exact[2].oscillation < 32.0  # seen at twenty moments only
    assert [p.forces for p in exact] == pytest.approx([100, 200, 400])


@pytest.mark.slow
def test_kepler_of_work_precision_counts_forces(monkeypatch):
    runs = {name: rest for name, *rest in work_precision.kepler_runs((400,), 1)}
    assert len(runs) == 18
    order, timestep, forces, _, oscillation, _, distance = runs["velocity-verlet"]
    assert (order, forces * timestep) == (2, pytest.approx(1.0, rel=1e-2))
    assert oscillation < 1e-2
    assert runs["blanes-moan-rkn-4"][-1] < 0.1 * distance
