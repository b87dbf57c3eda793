"""LAWS × METHODS × SCENES: each law of a step is kept by the methods that claim it, and broken by all others.

METHODS is where a method is registered; what it answers (order, symmetric, symplectic, explicit) is measured here."""

from collections.abc import Callable
from functools import cache
from operator import attrgetter
from typing import Any, NamedTuple

import numpy as np
import pytest
import small_problems as small
from references import load

import minimd as md
import minimd.integrators as mi

EPS = np.finfo(float).eps
HENON_HEILES = (*small.HENON_HEILES, lambda q, v: small.henon_heiles_energy(q.T, v.T))
SYMPLECTIC = [method for method in small.ONE_STEP if method.is_symplectic and method not in small.GAUSS]
LONGEST = [pytest.param(method, marks=pytest.mark.slow) for method in small.GAUSS]
B, C = np.array([1.0, -2.0, 0.5]), np.array([0.3, 1.0, 1.0])
CENTRE = np.array([0.3, -0.2])
ORBIT = (0.7, 0.1), (-0.1, 1.2)
IN_SPACE = (0.2, 0.5, -0.3), (0.4, 0.1, 0.6)
OFF_CENTRE = (1.0, 0.1), (0.1, 0.9)
OMEGA, BY_POSITION = 2.0, lambda e, x, v, h: e - (OMEGA**2 * h * x / 2.0) ** 2
SHADOWS = {  # what a method conserves of the oscillator, in place of e = v² + ω²x²
    md.VelocityVerlet: BY_POSITION, md.Leapfrog: BY_POSITION,
    md.PositionVerlet: lambda e, x, v, h: e - (OMEGA * h * v / 2.0) ** 2,
    mi.SE1: lambda e, x, v, h: e - h * OMEGA**2 * x * v, mi.SE2: lambda e, x, v, h: e + h * OMEGA**2 * x * v,
}  # fmt: skip
D, W = 0.1, np.sqrt(0.99)  # damping, and the frequency of the damped oscillator
RELATIVISTIC = mi.Partitioned(lambda v: v / np.sqrt(1.0 + v * v), lambda q: -(q**3))  # H = √(1 + v²) + q⁴/4
CLOSED_FORMS = {  # problem, start, and solution (q, v) at t
    "driven oscillator": (mi.SecondOrder(lambda t, q: -q + np.cos(2.0 * t)), ((1.0,), (0.0,)),
        lambda t: [(4.0 * np.cos(t) - np.cos(2.0 * t)) / 3.0, (-4.0 * np.sin(t) + 2.0 * np.sin(2.0 * t)) / 3.0]),
    "damped oscillator": (mi.SecondOrder(lambda q, v: -q - 2.0 * D * v), ((1.0,), (-D,)),
        lambda t: np.exp(-D * t) * np.array([np.cos(W * t), -D * np.cos(W * t) - W * np.sin(W * t)])),
    "electric and magnetic field": (mi.SecondOrder(lambda q, v: np.array([v[1] + 0.2, -v[0]])), ((0, 0), (0, 0)),
        lambda t: [0.2 * (1.0 - np.cos(t)), 0.2 * (np.sin(t) - t), 0.2 * np.sin(t), 0.2 * (np.cos(t) - 1.0)]),
    "relativistic oscillator": (RELATIVISTIC, ((1.0,), (0.8,)),
        lambda t: small.reference(RELATIVISTIC, ((1.0,), (0.8,)), t)),
}  # fmt: skip
STEPS = {1: 100, 2: 50, 3: 200, 4: 60, 5: 40, 6: 30, 8: 16}  # by order: errors small, above rounding
OF_CLOSED_FORMS = {1: 400, 2: 100, 3: 60, 4: 30}
DRIVEN_END = small.reference(small.DRIVEN, small.TWISTED_START, 1.5, t0=0.3)
COURSES = {
    "kepler": (small.KEPLER, small.KEPLER_START, 0.0, 2.0, small.kepler_orbit(2.0)),
    "driven": (small.DRIVEN, small.TWISTED_START, 0.3, 1.5, DRIVEN_END),
}
QUICK = md.VelocityVerlet, mi.SE1, mi.BlanesMoan4, *small.GAUSS, mi.ImplicitEuler, mi.BDF1, mi.BDF2, mi.BDF3
COURSES |= {name: (problem, start, 0.0, 6.0, end(6.0)) for name, (problem, start, end) in CLOSED_FORMS.items()}
FEW = [md.VelocityVerlet, mi.SE1, mi.SE2, mi.BlanesMoan4, mi.McLachlanAtela4, mi.GaussLegendre2]
RUNS = [("kepler", m) for m in small.ONE_STEP] + [(name, m) for name in CLOSED_FORMS for m in FEW]
RUNS += [pytest.param("driven", m, marks=[pytest.mark.slow] * (m not in QUICK)) for m in small.DETERMINISTIC]


class Scene(NamedTuple):
    problem: Any
    start: Any
    h: float
    t0: float = 0.3
    n_steps: int = 1
    invariant: Callable | None = None  # of arrays (n, …) of q and v


def across(direction, x):
    """A vector that depends on all of x, perpendicular to the direction."""
    return np.cross(direction, np.sin(x + 0.3 * x[::-1] + 0.2))


def linear(q, v):
    """b·q + c·v, in rounding errors of its terms."""
    return (q @ B + v @ C) / (np.abs(q * B).max() + np.abs(v * C).max())


def turning(q, v):
    return small.angular_momentum((q - CENTRE).T, v.T)


NO_GRADIENTS = mi.Partitioned(  # q′ = g(v), v′ = f(q) has no divergence whatever g and f are; nothing is symplectic
    lambda v: np.array([np.sin(v[1] * v[2]) + v[0] ** 2, v[0] * v[2], np.cos(v[0] - v[1])]),
    lambda q: np.array([q[1] * q[2] - q[0], np.sin(q[0]) * q[1], np.exp(-q[1]) + 0.3 * q[2] ** 2]),
)
JOINT = mi.Partitioned(
    lambda q, v: np.sin(q @ v) * C * (B @ B) + across(B, v), lambda q, v: -np.sin(q @ v) * B * (B @ B) + across(C, q)
)
ROUND = mi.Partitioned(  # H = (1 + |d|²)|v|²/2 + |d|²/2, d = q − centre
    lambda q, v: (1.0 + (q - CENTRE) @ (q - CENTRE)) * v, lambda q, v: -(1.0 + v @ v) * (q - CENTRE)
)
SCALING = mi.Partitioned(  # H = sin(q₀v₀) + (q₀v₀)(q₁v₁): each qᵢvᵢ is conserved
    lambda q, v: q * np.array([np.cos(q[0] * v[0]) + q[1] * v[1], q[0] * v[0]]),
    lambda q, v: -v * np.array([np.cos(q[0] * v[0]) + q[1] * v[1], q[0] * v[0]]),
)
SCENES = {
    "kepler": Scene(small.KEPLER, ORBIT, 0.1),
    "driven": Scene(small.DRIVEN, small.TWISTED_START, 0.1),
    "swaying": Scene(small.SWAYING, small.TWISTED_START, 0.1),
    "no divergence": Scene(NO_GRADIENTS, ((0.3, 0.2, 0.5), (0.1, -0.4, 0.6)), 0.3),
    "b·q, c·v": Scene(mi.Partitioned(lambda v: across(B, v), lambda q: across(C, q)), IN_SPACE, 0.1, 0.0, 30, linear),
    "b·q + c·v": Scene(JOINT, IN_SPACE, 0.05, 0.0, 10, linear),
    "central force": Scene(mi.SecondOrder(lambda q: small.attraction(q - CENTRE)), OFF_CENTRE, 0.04, 0.0, 16, turning),
    "round": Scene(ROUND, OFF_CENTRE, 0.08, 0.0, 12, turning),
    "scaling": Scene(SCALING, OFF_CENTRE, 0.08, 0.0, 12, lambda q, v: (q * v)[:, 0]),
    "oscillator": Scene(small.OSCILLATOR, ((1.0,), (0.0,)), 0.8, 0.0, 60, lambda q, v: (q**2 + v**2)[:, 0]),
}  # fmt: skip
FLIP = np.array([1.0, 1.0, -1.0, -1.0])  # ρ, which turns the velocities around


def there_and_back(method, scene, back=None):
    """Φ_{−h} ∘ Φ_h − 1."""
    y = scene.problem.begin(scene.start)
    there = method.on(scene.problem)(scene.t0, y, scene.h)
    return np.abs((back or method).on(scene.problem)(scene.t0 + scene.h, there, -scene.h) - y).max()


def turned_there_and_back(method, scene):
    """ρ Φ_h ρ Φ_h − 1."""
    y, step = scene.problem.begin(scene.start), method.on(scene.problem)
    return np.abs(FLIP * step(0.0, FLIP * step(0.0, y, scene.h), scene.h) - y).max()


def turned(method, scene):
    """ρ Φ_h ρ − Φ_{−h}."""
    y, step = scene.problem.begin(scene.start), method.on(scene.problem)
    return np.abs(FLIP * step(0.0, FLIP * y, scene.h) - step(0.0, y, -scene.h)).max()


@cache
def derivative(method, problem, start, h, t0):
    """Φ′ of a step."""
    m = small.jacobian(problem, method, start, h, t0)
    assert np.abs(m - np.eye(len(m))).max() > 0.1
    return m


def form_defect(method, scene):
    """Φ′ᵀ J Φ′ − J."""
    return small.symplecticity_defect(derivative(method, scene.problem, scene.start, 2.0 * scene.h, scene.t0))


def volume_defect(method, scene):
    return abs(np.linalg.det(derivative(method, scene.problem, scene.start, 2.0 * scene.h, scene.t0)) - 1.0)


def change(method, scene):
    """Of the invariant, in rounding errors of numbers of order one, for each step and stage."""
    path = mi.run_steps(scene.problem, method(scene.h), scene.start, scene.n_steps)
    values = scene.invariant(path.q, path.v)
    assert np.ptp(path.q[:, 0]) > 0.1
    return np.abs(values - values[0]).max() / (EPS * scene.n_steps * method.stages)


class Law(NamedTuple):
    measure: Callable
    claimed: Callable  # by a method
    kept: float  # the largest defect of those who claim it: rounding
    broken: float  # the smallest of all others: truncation
    scenes: tuple
    methods: list = small.ONE_STEP


by_all, by_symmetric, by_symplectic = (lambda method: True), attrgetter("is_symmetric"), attrgetter("is_symplectic")
# of Gauss methods only those with one or two stages keep the volume: Hairer, Lubich, Wanner, VI.9
TO_THREE, by_two_stages = small.SPLITTINGS + small.GAUSS[:3], lambda method: method is not mi.GaussLegendre3
LAWS = {
    "its own inverse": Law(there_and_back, by_symmetric, 3e-15, 1e-9, ("kepler", "driven")),
    "reversible": Law(turned_there_and_back, by_symmetric, 3e-15, 1e-9, ("kepler", "swaying")),
    "turned around": Law(turned, by_all, 3e-15, np.inf, ("kepler", "swaying")),
    "adjoint": Law(lambda m, scene: there_and_back(m, scene, mi.adjoint(m)), by_all, 1e-14, np.inf, ("driven",),
                   small.SPLITTINGS),
    "symplectic form": Law(form_defect, by_symplectic, 1e-11, 1e-8, ("kepler", "driven")),
    "volume": Law(volume_defect, by_symplectic, 1e-11, 1e-8, ("kepler", "driven")),
    "volume without a Hamiltonian": Law(volume_defect, by_two_stages, 1e-11, 1e-8, ("no divergence",), TO_THREE),
    "no form without a Hamiltonian": Law(form_defect, lambda method: False, 0.0, 1e-2, ("no divergence",)),
    "linear invariant": Law(change, by_all, 1.0, np.inf, ("b·q, c·v", "b·q + c·v")),
    "bilinear invariant": Law(change, by_symplectic, 1.0, 1e3, ("central force", "round", "scaling")),
    "quadratic invariant": Law(change, lambda method: method in small.GAUSS, 1.0, 1e4, ("oscillator",)),
}  # fmt: skip
ROWS = [(law, scene, method) for law in LAWS for scene in LAWS[law].scenes for method in LAWS[law].methods]


@pytest.mark.parametrize(("law", "scene", "method"), ROWS, ids=[f"{a}-{b}-{m.name}" for a, b, m in ROWS])
def test_a_law_is_kept_by_the_methods_that_claim_it_and_by_no_other(law, scene, method):
    law = LAWS[law]
    defect = law.measure(method, SCENES[scene])
    assert defect < law.kept if law.claimed(method) else defect > law.broken


@pytest.mark.parametrize(("name", "method"), RUNS)
def test_measured_order_is_the_answered_order(method, name):
    """Methods made for q″ = f(q) alone answer a lower one elsewhere. Near a pericentre errors of BDFs change sign."""
    problem, start, t0, time, end = COURSES[name]
    order = method.order_on(problem)
    n_steps = STEPS[order] * ((8 if method is mi.Ruth3 else 2) if name == "kepler" else 1)
    n_steps *= 6 if method not in small.ONE_STEP and order > 3 else 1
    n_steps = OF_CLOSED_FORMS[order] if name in CLOSED_FORMS else n_steps // (2 if name == "driven" else 1)
    runs = (mi.run_steps(problem, method(time / n), start, n, t0=t0, every=n) for n in (n_steps, 2 * n_steps))
    coarse, fine = (np.linalg.norm(run.y[-1] - end) for run in runs)
    within, is_lower = 0.25 if name in CLOSED_FORMS else 0.2, name not in ("kepler", "driven oscillator")
    assert np.log2(coarse / fine) == pytest.approx(order, abs=within)  # truncation
    assert order == (3 if method is mi.McLachlanAtela4 and is_lower else method.order)


def test_the_references_agree():
    published = load("geometric/problems.json")["kepler_e0.6_T7.5"]
    end = np.array([*published["q"], *published["p"]], dtype=float)
    assert small.kepler_orbit(7.5) == pytest.approx(end, abs=2e-15)
    assert small.reference(small.KEPLER, small.KEPLER_START, 7.5) == pytest.approx(small.kepler_orbit(7.5), abs=1e-11)


def largest_errors(method, h, time, problem, start, energy):
    """Of the energy, in the first and in the second half of a run."""
    path = mi.run_steps(problem, method(h), start, round(time / h))
    errors = np.abs(energy(path.q, path.v) - energy(path.q[:1], path.v[:1]))
    return errors[: len(errors) // 2].max(), errors[len(errors) // 2 :].max()


@pytest.mark.parametrize("method", SYMPLECTIC + LONGEST)
def test_the_energy_error_of_a_symplectic_method_is_bounded_and_falls_with_the_order(method):
    h = {1: 0.02, 2: 0.1, 3: 0.1, 4: 0.2, 6: 0.4, 8: 0.6}[method.order] * (2 if method in small.GAUSS[:2] else 1)
    first, second = largest_errors(method, h, 200.0, *HENON_HEILES)
    half = max(largest_errors(method, h / 2, 100.0, *HENON_HEILES))
    assert second == pytest.approx(first, rel=0.15)
    assert np.log2(max(first, second) / half) == pytest.approx(method.order, abs=0.4)


@pytest.mark.parametrize("method", [md.VelocityVerlet, mi.GaussLegendre2])
def test_the_energy_of_a_hamiltonian_that_is_not_separable_does_not_drift(method):
    energy = lambda q, v: 0.5 * ((1.0 + (q**2).sum(1)) * (1.0 + (v**2).sum(1)) + q[:, 0] * v[:, 1])  # noqa: E731
    first, second = largest_errors(method, 0.2, 30.0, small.TWISTED, small.TWISTED_START, energy)
    assert second < 1.1 * first + 10 * EPS
    assert first < 5e-2


@pytest.mark.parametrize("method", [method for method in small.ONE_STEP if not method.is_symplectic])
def test_the_energy_of_a_method_that_is_not_symplectic_drifts(method):
    """Radau IIA damps; those of order 1 bring all motion to an end."""
    first, second = largest_errors(method, *((0.1, 10.0) if method.order == 1 else (0.5, 100.0)), *HENON_HEILES)
    assert second > 1.2 * first


@pytest.mark.parametrize("method", SHADOWS)
def test_the_shadow_energy_of_the_oscillator_is_conserved_to_rounding(method):
    for phase in (0.1, 1.0, 1.9):
        h, n_steps = phase / OMEGA, 5000
        path = mi.run_steps(mi.SecondOrder(lambda q: -(OMEGA**2) * q), method(h), ((1.0,), (0.3,)), n_steps)
        energy = path.v**2 + OMEGA**2 * path.q**2
        shadows = SHADOWS[method](energy, path.q, path.v, h)
        assert np.ptp(energy) > 0.2 * phase**2 * shadows[0]
        assert np.ptp(shadows) < n_steps * EPS * energy.max()


@pytest.mark.parametrize("method", small.SPLITTINGS)
def test_splittings_are_stable_up_to_where_theory_says(method):
    """ωΔt < 2s for s forces, none more stable than Verlet: M. M. Chawla, S. R. Sharma, BIT 21, 455 (1981)."""
    limit, y = mi.stability_limit(method.sequence()), small.OSCILLATOR.begin(((1.0,), (0.0,)))
    step, below = method.on(small.OSCILLATOR), np.linspace(0.01, 1.0 - 1e-6, 50)
    traces = [sum(step(0.0, unit, x * limit) @ unit for unit in np.eye(y.size)) for x in (*below, 1.0 + 1e-6)]
    assert np.abs(traces[:-1]).max() < 2.0 < abs(traces[-1])  # powers of a matrix of determinant one are bounded
    assert limit == pytest.approx(2.0, abs=1e-12) if method.stages == 1 else 1.0 < limit < 2.0 * method.stages


@pytest.mark.parametrize("method", small.DETERMINISTIC)
def test_stages_are_the_evaluations_or_the_stage_equations_of_a_step(method):
    """As the function of the user counts them; those of implicit methods by the times they are at."""
    times = []
    problem = mi.SecondOrder(lambda t, q: times.append(t) or small.attraction(q))
    solution = mi.run_steps(problem, method(0.01), ORBIT, 20)
    if method.is_explicit:
        assert 20 * method.stages <= len(times) == solution.nfev <= 20 * method.stages + 1
    else:
        assert len(np.unique(np.round([t for t in times if 0.1 + 1e-9 < t < 0.11 + 1e-9], 9))) == method.stages
