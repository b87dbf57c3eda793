"""Laws of the splittings of higher order: order conditions, slopes and errors of a reference, closed forms, molecules."""

import json
from fractions import Fraction
from itertools import pairwise
from math import factorial
from pathlib import Path

import numpy as np
import pytest
from references import liquid

import minimd as md
from minimd.integrators import (
    PEFRL,
    SE1,
    SE2,
    SPLITTINGS,
    Drift,
    Kick,
    Leapfrog,
    PositionVerlet,
    Splitting,
    State,
    VelocityVerlet,
    compose,
)
from minimd.integrators.splitting.compositions import (
    BlanesMoan4,
    CandyRozmus4,
    KahanLi8,
    McLachlanAtela4,
    Suzuki4,
    Yoshida6,
)
from minimd.integrators.splitting.order_conditions import (
    lyndon_words,
    nystrom_order,
    nystrom_residuals,
    separable_order,
    separable_residuals,
    word_coefficient,
)
from minimd.integrators.splitting.substeps import is_palindrome, merged, scaled

REFERENCE = json.loads((Path(__file__).parent / "data/geometric/henon_heiles.json").read_text())
ORDERS = {
    "velocity-verlet": 2,
    "position-verlet": 2,
    "leapfrog": 2,
    "symplectic-euler-1": 1,
    "symplectic-euler-2": 1,
    "ruth-3": 3,
    "candy-rozmus-4": 4,
    "suzuki-4": 4,
    "mclachlan-atela-4": 4,
    "pefrl": 4,
    "blanes-moan-rkn-4": 4,
    "yoshida-6": 6,
    "kahan-li-6": 6,
    "kahan-li-8": 8,
}  # as their papers say
HIGHER = [method for method in SPLITTINGS.values() if ORDERS[method.name] > 2]
G = 1.0 / (2.0 - 2.0 ** (1.0 / 3.0))
TRIPLE_JUMP = [G, 1.0 - 2.0 * G, G]


def henon_heiles(s, with_energy=False):
    """H = (px² + py² + x² + y²)/2 + x² y − y³/3."""
    x, y = s.positions[0, :2]
    s.forces[0] = -x - 2.0 * x * y, -y - x * x + y * y, 0.0


def kepler(s, with_energy=False):
    s.forces[:] = -s.positions / np.linalg.norm(s.positions) ** 3


def end(method, forces, q, p, time, n_steps):
    """Position and velocity in the plane after n_steps of a body of mass one."""
    s = State(np.array([[*q, 0.0]]), np.array([[*p, 0.0]]), np.zeros((1, 3)), np.ones(1))
    method(time / n_steps).advance(s, forces, n_steps)
    return np.concatenate([s.positions[0, :2], s.velocities[0, :2]])


def henon_heiles_error(method, n_steps):
    start, exact = REFERENCE["start"], REFERENCE["end"]
    reached = end(method, henon_heiles, start["q"], start["p"], REFERENCE["T"], n_steps)
    return np.linalg.norm(reached - np.array([*exact["q"], *exact["p"]], dtype=float))


def worst(residuals, row, order):
    return max(abs(r) for k in range(1, order + 1) for r in residuals(row, k))


def shifted(row, first, second, amount):
    """The row with some duration moved from one substep to another of the same kind: the sums stay one."""
    change = {first: amount, second: -amount}
    return tuple(type(substep)(substep.coefficient + change.get(k, 0.0)) for k, substep in enumerate(row))


def test_answered_orders_are_those_of_the_papers():
    assert {name: method.order for name, method in SPLITTINGS.items()} == ORDERS


@pytest.mark.parametrize("method", SPLITTINGS.values())
def test_order_conditions_hold_to_rounding(method):
    """For q″ = f(q) all of them; for every T(p) + V(q) too, but for McLachlan and Atela's last one."""
    separable = 3 if method is McLachlanAtela4 else ORDERS[method.name]
    assert worst(nystrom_residuals, method.sequence(), ORDERS[method.name]) < 2e-15  # rounding, measured 3e-16
    assert worst(separable_residuals, method.sequence(), separable) < 2e-15
    assert separable_order(method.sequence()) == separable
    assert worst(nystrom_residuals, method.sequence(), ORDERS[method.name] + 1) > 1e-5
    assert worst(separable_residuals, method.sequence(), separable + 1) > 1e-6


@pytest.mark.parametrize("method", HIGHER)
def test_one_wrong_digit_breaks_an_order_condition(method):
    """Two stages of the same kind, one longer and one shorter by 10⁻¹²: the sums are right, the order is lost."""
    row = method.sequence()
    for k in range(len(row) - 2):
        wrong = shifted(row, k, k + 2, 1e-12)
        assert worst(nystrom_residuals, wrong, ORDERS[method.name]) > 1e-14


@pytest.mark.parametrize("method", [method for method in HIGHER if method.is_symmetric])
def test_one_wrong_digit_in_the_table_breaks_an_order_condition_though_the_row_stays_symmetric(method):
    row = method.sequence()
    n = len(row)
    for k in range(n // 2 - 1):
        wrong = shifted(shifted(row, k, k + 2, 1e-12), n - 1 - k, n - 3 - k, 1e-12)
        assert is_palindrome(wrong)
        assert worst(nystrom_residuals, wrong, ORDERS[method.name]) > 1e-14


def test_conditions_are_as_many_as_theory_counts():
    """Dimensions of the free Lie algebra of two substeps (Witt), and numbers of special Nyström trees."""
    assert [len(lyndon_words(k)) for k in range(1, 9)] == [2, 1, 2, 3, 6, 9, 18, 30]
    assert [len(nystrom_residuals(SE1.sequence(), k)) - (k == 1) for k in range(1, 9)] == [1, 1, 2, 3, 6, 10, 20, 36]


def test_word_coefficients_are_those_of_a_product_of_exponentials():
    """exp(aT) exp(bV) exp(cT): TVT has the coefficient a b c, TT (a + c)²/2, VTV none."""
    row = (Drift(0.3), Kick(0.7), Drift(0.4))
    assert word_coefficient(row, (Drift, Kick, Drift)) == pytest.approx(0.3 * 0.7 * 0.4, abs=1e-16)
    assert word_coefficient(row, (Drift, Drift)) == pytest.approx(0.7**2 / 2, abs=1e-16)
    assert word_coefficient(row, (Kick, Drift, Kick)) == 0.0


def exact_residuals(row, order):
    """The conditions of an order in rational numbers, the slow way: all words of a product of exponentials, substep by substep."""
    series = {(): Fraction(1)}
    for substep in row:
        product = dict.fromkeys(series, Fraction(0))
        for word, value in series.items():
            for k in range(order - len(word) + 1):
                longer = (*word, *k * [type(substep)])
                product[longer] = product.get(longer, 0) + value * Fraction(substep.coefficient) ** k / factorial(k)
        series = product
    return [float(series.get(word, 0) - Fraction(1, factorial(order))) for word in lyndon_words(order)]


@pytest.mark.parametrize("method", [method for method in HIGHER if method.order < 6])
def test_order_conditions_in_rational_numbers_are_those_in_floating_point(method):
    for order in range(1, 6):
        assert separable_residuals(method.sequence(), order) == pytest.approx(
            exact_residuals(method.sequence(), order), abs=4e-16
        )


def test_fourteen_digits_of_the_pefrl_constants_are_proved():
    """λ hardly enters the conditions, for its two kicks are close: only exact arithmetic sees its last digits."""
    assert max(map(abs, exact_residuals(PEFRL.sequence(), 3))) < 1e-16
    wrong = shifted(shifted(PEFRL.sequence(), 1, 3, 1e-14), 7, 5, 1e-14)
    assert max(map(abs, exact_residuals(wrong, 3))) > 2e-16


def test_the_exponent_slip_of_public_codes_is_caught():
    """0.82898… = 1/(2 − 2^(−1/3)) and 0.29673… = 1/(4 − 4^(−1/3)): such weights add up to one, and stay at order 2."""
    for n in (2, 4):
        for exponent, order in ((-1.0 / 3.0, 2), (1.0 / 3.0, 4)):
            w = 1.0 / (n - n**exponent)
            weights = [*n // 2 * [w], 1.0 - n * w, *n // 2 * [w]]
            assert compose(*[VelocityVerlet] * (n + 1), weights=weights).order == order


def test_inconsistent_rows_have_order_zero():
    assert nystrom_order((Kick(1.0), Drift(0.9))) == separable_order((Kick(1.0), Drift(0.9))) == 0
    assert nystrom_order((Kick(0.9), Drift(1.0))) == separable_order((Kick(0.9), Drift(1.0))) == 0


def test_kicks_and_drifts_of_the_same_duration_are_not_the_same():
    """Or SE1 would be its own mirror image, and velocity Verlet would be position Verlet."""
    assert Kick(0.5) != Drift(0.5)
    assert not SE1.is_symmetric
    assert VelocityVerlet.sequence() != PositionVerlet.sequence()


def test_flows_are_objects_that_one_composes():
    """The last one acts first, as in a formula; equal neighbors become one."""
    assert compose(Drift(1.0), Kick(1.0)).sequence() == SE1.sequence()
    assert compose(Kick(0.5), Drift(0.25), Drift(0.75), Kick(0.5)).sequence() == VelocityVerlet.sequence()
    assert compose(Kick(1.0), SE1, weights=[1.0, 1.0]).sequence() == (Kick(1.0), Drift(1.0), Kick(1.0))
    assert compose(Kick(1.0), SE1, weights=[1.0, 1.0]).order == 0  # two kicks in one step
    assert compose(Leapfrog).sequence() == VelocityVerlet.sequence()


def test_a_composition_refuses_what_it_does_not_know():
    with pytest.raises(TypeError, match="parts must be methods"):
        compose(VelocityVerlet(0.1))
    with pytest.raises(TypeError, match="only if weights are given"):
        compose(SE1, Kick(1.0))
    with pytest.raises(ValueError, match="as many weights as parts; got 2 parts, 1 weights"):
        compose(SE1, SE2, weights=[1.0])
    with pytest.raises(ValueError, match="at least one part"):
        compose()


def test_candy_rozmus_is_the_triple_jump_over_position_verlet():
    """Forest and Ruth: drifts θ/2, (1 − θ)/2, kicks θ, 1 − 2θ, with θ = 1/(2 − ∛2)."""
    forest_ruth = [G / 2, G, (1 - G) / 2, 1 - 2 * G, (1 - G) / 2, G, G / 2]
    yoshida = compose(*3 * [PositionVerlet], weights=TRIPLE_JUMP)
    for row in (CandyRozmus4.sequence(), yoshida.sequence()):
        assert [type(substep) for substep in row] == 3 * [Drift, Kick] + [Drift]
        assert [substep.coefficient for substep in row] == pytest.approx(forest_ruth, abs=4e-16)


def test_higher_order_comes_from_lower_order_by_composition():
    """Triple jump: a symmetric method of order p gives one of order p + 2 with g = 1/(2 − 2^(1/(p + 1)))."""
    method: type[Splitting] = VelocityVerlet
    for order in (2, 4, 6):
        g = 1.0 / (2.0 - 2.0 ** (1.0 / (order + 1)))
        assert method.order == order
        method = compose(*3 * [method], weights=[g, 1.0 - 2.0 * g, g])
        assert method.is_symmetric
    assert method.order == 8


@pytest.mark.parametrize("name", REFERENCE["methods"])
def test_slopes_and_errors_on_henon_heiles_are_those_of_the_reference(name):
    method = compose(*3 * [VelocityVerlet], weights=TRIPLE_JUMP) if name == "triple-jump" else SPLITTINGS[name]
    known = REFERENCE["methods"][name]
    errors = [henon_heiles_error(method, n) for n in known["steps"]]
    slopes = [np.log2(coarse / fine) for coarse, fine in pairwise(errors)]
    assert slopes == pytest.approx([known["order"]] * 2, abs=0.1)  # truncation
    assert errors == pytest.approx(known["errors"], rel=1e-5, abs=4e-15)  # the reference has 80 bits, we round to 53


@pytest.mark.parametrize("method", [method for method in SPLITTINGS.values() if method.is_symmetric])
def test_slope_on_a_kepler_orbit_around_the_pericentre(method):
    """e = 0.6, t = 7.5, past the second pericentre; Ruth's error of order 3 averages out over a revolution."""
    orbit = REFERENCE["kepler"]
    exact = np.array([*orbit["q"], *orbit["p"]], dtype=float)
    steps = {2: 4000, 4: 1000, 6: 600, 8: 100}[ORDERS[method.name]]
    errors = [
        np.linalg.norm(end(method, kepler, (0.4, 0.0), (0.0, 2.0), 7.5, n) - exact) for n in (steps, 3 * steps // 2)
    ]
    assert np.log(errors[0] / errors[1]) / np.log(1.5) == pytest.approx(ORDERS[method.name], abs=0.1)  # truncation


def test_blanes_moan_has_the_smallest_error_per_force_evaluation_of_order_four():
    costs = {
        method: henon_heiles_error(method, 120) * method.stages**4
        for method in SPLITTINGS.values()
        if method.order == 4
    }
    assert min(costs, key=costs.__getitem__) is BlanesMoan4
    assert 100 * costs[BlanesMoan4] < 10 * costs[Suzuki4] < costs[CandyRozmus4] * 2


@pytest.mark.parametrize("method", SPLITTINGS.values())
def test_energy_error_of_a_droplet_falls_with_the_order_of_the_method(method):
    """32 atoms without a cutoff, over a time in which they really move, through Simulation."""
    dt = {1: 0.001, 2: 0.004, 3: 0.004, 4: 0.008, 6: 0.008, 8: 0.02}[ORDERS[method.name]]

    def largest_error(dt):
        simulation = md.Simulation(
            md.System(liquid(2, jitter=0.02).positions), md.LennardJones(1.0, 1.0, 100.0), method(dt)
        )
        simulation.set_temperature(0.3, seed=5)
        n_steps = round(1.0 / dt)
        energy = simulation.run(n_steps, every=n_steps // 25).total_energy
        return np.abs(energy - energy[0]).max()

    assert np.log2(largest_error(dt) / largest_error(dt / 2)) == pytest.approx(
        ORDERS[method.name], abs=0.2
    )  # truncation


@pytest.mark.parametrize("method", SPLITTINGS.values())
def test_every_method_runs_the_melt(method):
    """4000 atoms, periodic: substeps longer than the time step, and backward ones, keep lists and momentum right."""
    simulation = md.Simulation(liquid(10), md.LennardJones(1.0, 1.0, 2.5, "switched"), method(0.002))
    record = simulation.run(10, every=5)
    assert np.ptp(record.total_energy) < {1: 1e-2}.get(ORDERS[method.name], 1e-3) * abs(record.total_energy[0])
    assert np.linalg.norm(record.momentum - record.momentum[0], axis=1).max() < 1e-12 * record.absolute_momentum[0]


def test_a_composition_runs_in_a_simulation():
    weights = [substep.coefficient for substep in Yoshida6.substeps if isinstance(substep, Drift)]
    methods = compose(*7 * [VelocityVerlet], weights=weights), Yoshida6
    composed, named = (md.Simulation(liquid(3), md.LennardJones(1.0, 1.0, 1.7), method(0.002)) for method in methods)
    composed.run(20)
    named.run(20)
    assert composed.positions == pytest.approx(named.positions, abs=1e-12)


def test_rows_merge_scale_and_drop_what_lasts_no_time():
    assert merged((Kick(0.5), Drift(0.0), Kick(0.5))) == (Kick(1.0),)
    assert merged((Kick(0.5), Drift(0.25), Drift(-0.25), Kick(0.5), Drift(1.0))) == (Kick(1.0), Drift(1.0))
    assert scaled((Kick(0.5), Drift(1.0)), -2.0) == (Kick(-1.0), Drift(-2.0))
    assert len(KahanLi8.sequence()) == 35
