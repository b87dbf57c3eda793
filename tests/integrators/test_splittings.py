"""Splittings: order conditions of their coefficients, compositions, and the roads on which the same steps are made."""

from fractions import Fraction
from math import factorial

import numpy as np
import pytest
from references import load
from scenes import SCENES
from small_problems import DRIVEN, HENON_HEILES, KEPLER, SPLITTINGS, TWISTED_START, attraction

import minimd as md
import minimd.integrators as mi
from minimd.core.integrators.order_conditions import lyndon_words, nystrom_residuals, separable_residuals
from minimd.core.integrators.substeps import is_palindrome
from minimd.integrators import SE1, SE2, Drift, Kick, PositionVerlet, VelocityVerlet, compose

PAPERS = {
    1: "symplectic-euler-1 symplectic-euler-2", 2: "velocity-verlet position-verlet leapfrog", 3: "ruth-3",
    4: "candy-rozmus-4 suzuki-4 mclachlan-atela-4 pefrl blanes-moan-rkn-4", 6: "yoshida-6 kahan-li-6", 8: "kahan-li-8",
}  # fmt: skip
ORDERS = {name: order for order, names in PAPERS.items() for name in names.split()}
HIGHER = [method for method in SPLITTINGS if ORDERS[method.name] > 2]
G = 1.0 / (2.0 - 2.0 ** (1.0 / 3.0))
TRIPLE_JUMP = [G, 1.0 - 2.0 * G, G]
REFERENCE = load("geometric/henon_heiles.json")
MASSES = np.array([1.0, 3.0, 0.2])


def worst(residuals, row, order):
    return max(abs(r) for k in range(1, order + 1) for r in residuals(row, k))


def shifted(row, first, second, amount):
    """The row with some duration moved from one substep to another of the same kind: the sums stay one."""
    change = {first: amount, second: -amount}
    return tuple(type(substep)(substep.coefficient + change.get(k, 0.0)) for k, substep in enumerate(row))


@pytest.mark.parametrize("method", SPLITTINGS)
def test_order_conditions_hold_to_rounding(method):
    """For q″ = f(q) all of them; for every T(p) + V(q) too, but for McLachlan and Atela's last one."""
    row, order = method.sequence(), ORDERS[method.name]
    separable = 3 if method is mi.McLachlanAtela4 else order
    assert (method.order, mi.separable_order(row)) == (order, separable)
    assert worst(nystrom_residuals, row, order) < 2e-15  # rounding, measured 3e-16
    assert worst(separable_residuals, row, separable) < 2e-15
    assert worst(nystrom_residuals, row, order + 1) > 1e-5
    assert worst(separable_residuals, row, separable + 1) > 1e-6


@pytest.mark.parametrize("method", HIGHER)
def test_one_wrong_digit_breaks_an_order_condition(method):
    """Two stages of a kind, one longer and one shorter by 10⁻¹²: the sums are right, in the table also the symmetry."""
    row, n = method.sequence(), len(method.sequence())
    for k in range(n - 2):
        assert worst(nystrom_residuals, shifted(row, k, k + 2, 1e-12), ORDERS[method.name]) > 1e-14
    for k in range(n // 2 - 1) if method.is_symmetric else ():
        wrong = shifted(shifted(row, k, k + 2, 1e-12), n - 1 - k, n - 3 - k, 1e-12)
        assert is_palindrome(wrong)
        assert worst(nystrom_residuals, wrong, ORDERS[method.name]) > 1e-14


def test_conditions_are_as_many_as_theory_counts():
    """Dimensions of the free Lie algebra of two substeps (Witt), and numbers of special Nyström trees."""
    assert [len(lyndon_words(k)) for k in range(1, 9)] == [2, 1, 2, 3, 6, 9, 18, 30]
    assert [len(nystrom_residuals(SE1.sequence(), k)) - (k == 1) for k in range(1, 9)] == [1, 1, 2, 3, 6, 10, 20, 36]


def exact_residuals(row, order):
    """The conditions of an order in rational numbers, the slow way: all words of a product of exponentials."""
    series = {(): Fraction(1)}
    for substep in row:
        product = dict.fromkeys(series, Fraction(0))
        for word, value in series.items():
            for k in range(order - len(word) + 1):
                longer = (*word, *k * [type(substep)])
                product[longer] = product.get(longer, 0) + value * Fraction(substep.coefficient) ** k / factorial(k)
        series = product
    return [float(series.get(word, 0) - Fraction(1, factorial(order))) for word in lyndon_words(order)]


def test_order_conditions_in_rational_numbers_are_those_in_floating_point():
    """λ of PEFRL hardly enters the conditions, for its two kicks are close: exact arithmetic sees its 14 digits."""
    for method in (method for method in HIGHER if method.order < 6):
        for order in range(1, 6):
            exact = exact_residuals(method.sequence(), order)
            assert separable_residuals(method.sequence(), order) == pytest.approx(exact, abs=4e-16)
    assert max(map(abs, exact_residuals(mi.PEFRL.sequence(), 3))) < 1e-16
    assert max(map(abs, exact_residuals(shifted(shifted(mi.PEFRL.sequence(), 1, 3, 1e-14), 7, 5, 1e-14), 3))) > 2e-16


def test_the_exponent_slip_of_public_codes_is_caught():
    """0.82898… = 1/(2 − 2^(−1/3)), 0.29673… = 1/(4 − 4^(−1/3)): such weights add up to one, and stay at order 2."""
    for n in (2, 4):
        for exponent, order in ((-1.0 / 3.0, 2), (1.0 / 3.0, 4)):
            w = 1.0 / (n - n**exponent)
            weights = [*n // 2 * [w], 1.0 - n * w, *n // 2 * [w]]
            assert compose(*[VelocityVerlet] * (n + 1), weights=weights).order == order


def test_coefficients_of_ruth_in_another_order_have_order_one():
    kicks, drifts = [Kick(c) for c in (7 / 24, 3 / 4, -1 / 24)], [Drift(c) for c in (2 / 3, -2 / 3, 1.0)]
    in_turn = (kicks, drifts), (drifts, kicks), (kicks[::-1], drifts[::-1])
    right, *wrong = (sum(zip(*both, strict=True), ()) for both in in_turn)
    assert right == mi.Ruth3.substeps
    assert mi.separable_order(right) == mi.separable_order(right[::-1]) == 3
    assert [mi.separable_order(row) for row in wrong] == [1, 1]


def test_an_optimal_method_loses_its_order_if_kicks_and_drifts_change_places():
    row = mi.McLachlanAtela4.substeps
    exchanged = tuple((Drift if isinstance(part, Kick) else Kick)(part.coefficient) for part in row)
    assert (mi.nystrom_order(row), mi.separable_order(row), mi.nystrom_order(exchanged)) == (4, 3, 3)


def test_candy_rozmus_is_the_triple_jump_over_position_verlet():
    """Forest and Ruth's form: drifts θ/2, (1 − θ)/2, kicks θ, 1 − 2θ, with θ = 1/(2 − ∛2)."""
    forest_ruth = [G / 2, G, (1 - G) / 2, 1 - 2 * G, (1 - G) / 2, G, G / 2]
    for row in (mi.CandyRozmus4.sequence(), compose(*3 * [PositionVerlet], weights=TRIPLE_JUMP).sequence()):
        assert [type(substep) for substep in row] == 3 * [Drift, Kick] + [Drift]
        assert [substep.coefficient for substep in row] == pytest.approx(forest_ruth, abs=4e-16)


def test_higher_order_comes_from_lower_order_by_composition():
    """Triple jump: a symmetric method of order p gives one of order p + 2 with g = 1/(2 − 2^(1/(p + 1)))."""
    method = VelocityVerlet
    for order in (2, 4, 6):
        g = 1.0 / (2.0 - 2.0 ** (1.0 / (order + 1)))
        assert method.order == order
        method = compose(*3 * [method], weights=[g, 1.0 - 2.0 * g, g])
        assert method.is_symmetric
    assert (method.order, compose(*3 * [SE1], weights=TRIPLE_JUMP).order) == (8, 1)


def test_symplectic_euler_methods_are_adjoint_to_each_other_and_not_symmetric():
    assert (mi.adjoint(SE1).sequence(), SE1.is_symmetric, SE2.is_symmetric) == (SE2.sequence(), False, False)
    for method in SPLITTINGS:
        assert mi.adjoint(mi.adjoint(method)).sequence() == method.sequence()
        assert mi.adjoint(method).order == method.order


@pytest.mark.parametrize("name", REFERENCE["methods"])
def test_slopes_and_errors_on_henon_heiles_are_those_of_the_reference(name):
    method = compose(*3 * [VelocityVerlet], weights=TRIPLE_JUMP) if name == "triple-jump" else mi.SPLITTINGS[name]
    known, start, exact = REFERENCE["methods"][name], REFERENCE["start"], REFERENCE["end"]
    end, errors = np.array([*exact["q"], *exact["p"]], dtype=float), []
    for n in known["steps"]:
        path = mi.run_steps(HENON_HEILES[0], method(REFERENCE["T"] / n), (start["q"], start["p"]), n, every=n)
        errors.append(np.linalg.norm(path.y[-1] - end))
    assert -np.diff(np.log2(errors)) == pytest.approx([known["order"]] * 2, abs=0.1)  # truncation
    assert errors == pytest.approx(known["errors"], rel=1e-5, abs=4e-15)  # the reference has 80 bits, we round to 53


def springs(q):
    """Three bodies, each pulling each: translation and rotation invariant, not linear."""
    d = q[None] - q[:, None]
    return (d * (d**2).sum(axis=2, keepdims=True)).sum(axis=1)


def bodies():
    q, v = np.random.default_rng(2).normal(size=(2, 3, 3))
    return mi.State(q, 0.3 * v, np.zeros_like(q), 1.0 / MASSES)


@pytest.mark.parametrize("method", SPLITTINGS)
def test_blocks_of_steps_and_single_steps_of_atoms_are_those_of_small_problems(method):
    """To the last bit; forces are not asked for twice, the energy with the last ones."""
    together, alone, n_steps, asked = bodies(), bodies(), 50, []

    def compute_forces(s, with_energy):
        asked.append(with_energy)
        s.forces[:] = springs(s.positions)

    start = together.positions.copy(), together.velocities.copy()
    method(0.02).advance(together, compute_forces, n_steps)
    assert n_steps * method.stages <= len(asked) <= n_steps * method.stages + 1
    if isinstance(method.substeps[-1], Kick):
        assert asked == [False] * (len(asked) - 1) + [True]
    for _ in range(n_steps):
        method(0.02).advance(alone, compute_forces, 1)
    path = mi.run_steps(mi.SecondOrder(lambda q: springs(q) / MASSES[:, None]), method(0.02), start, n_steps)
    assert np.abs(together.positions - start[0]).max() > 0.1
    for name, expected in (("positions", path.q[-1]), ("velocities", path.v[-1])):
        assert np.array_equal(getattr(together, name), getattr(alone, name))
        assert getattr(together, name) == pytest.approx(expected, abs=1e-12)
    assert np.abs(MASSES @ together.velocities - MASSES @ start[1]).max() < 1e-12
    spin = MASSES @ np.cross(together.positions, together.velocities) - MASSES @ np.cross(*start)
    assert np.abs(spin).max() < 1e-12


@pytest.mark.filterwarnings("ignore:timestep 0.01")  # too long for methods of order one
@pytest.mark.parametrize("method", [method for method in SPLITTINGS if method.stages < 7])
def test_a_simulation_makes_the_steps_of_small_problems(method):
    """Of a chain, in blocks, with substeps that are backward or longer than the time step; momentum is kept, too."""
    system, laws = SCENES["chain"]()[:2]
    fresh = system.copy()

    def accelerations(q):
        fresh.positions[:] = q
        return md.evaluate(fresh, laws).forces / system.masses[:, None]

    simulation = md.Simulation(system, laws, method(0.01))
    record = simulation.run(4, every=2)
    path = mi.run_steps(mi.SecondOrder(accelerations), method(0.01), (system.positions, system.velocities), 4, every=4)
    assert simulation.positions == pytest.approx(path.q[-1], abs=1e-11)  # rounding, amplified
    assert simulation.velocities == pytest.approx(path.v[-1], abs=1e-9)
    assert np.linalg.norm(record.momentum - record.momentum[0], axis=1).max() < 1e-12 * record.absolute_momentum[0]


@pytest.mark.parametrize(("inner", "outer", "named"), [(SE1, SE2, VelocityVerlet), (SE2, SE1, PositionVerlet)])
def test_verlet_is_the_composition_of_symplectic_euler_with_its_adjoint(inner, outer, named):
    """SE2 ∘ SE1 is (A) and SE1 ∘ SE2 is (B) over half steps: to the last bit as one method, to rounding as two."""
    assert compose(outer, inner).sequence() == named.sequence()
    for problem, start in ((KEPLER, ((0.7, 0.1), (-0.1, 1.2))), (DRIVEN, TWISTED_START)):
        end = mi.run_steps(problem, named(0.1), start, 20, t0=0.3).y[-1]
        first, second = inner.on(problem), outer.on(problem)
        y = problem.begin(start)
        for t in 0.3 + 0.1 * np.arange(20):
            y = second(t + 0.05, first(t, y, 0.05), 0.05)
        assert y == pytest.approx(end, abs=1e-13)


def test_leapfrog_is_velocity_verlet():
    assert mi.Leapfrog.sequence() == VelocityVerlet.sequence()


@pytest.mark.parametrize("recursion", [mi.stormer_two_step, mi.stormer_summed])
def test_the_recursions_are_velocity_verlet(recursion):
    start = (0.7, 0.0), (0.0, 1.3)
    solution = recursion(attraction, *map(np.array, start), 0.01, 300)
    path = mi.run_steps(KEPLER, VelocityVerlet(0.01), start, 300)
    assert [*solution.t, solution.nfev] == pytest.approx([*path.t, 301])
    assert solution.q == pytest.approx(path.q, abs=1e-11)
    assert solution.v == pytest.approx(path.v, abs=1e-9)  # a difference of positions, over Δt
    back = recursion(attraction, solution.q[-1], solution.v[-1], -0.01, 300)
    assert back.q[-1] == pytest.approx(start[0], abs=1e-8)


def test_round_off_of_the_recursion_grows_as_the_square_of_the_steps_and_of_its_summed_form_does_not():
    """On the oscillator the recursion is solved by cos(nφ), 2 sin(φ/2) = Δt: what differs is rounding."""
    dt, n = 2e-4, 50_000
    exact = np.cos(2.0 * np.arcsin(dt / 2.0) * np.arange(n + 1))
    paths = (recursion(lambda q: -q, 1.0, 0.0, dt, n) for recursion in (mi.stormer_two_step, mi.stormer_summed))
    plain, summed = (np.abs(path.q - exact).max() for path in paths)
    assert summed < 1e-13
    assert plain > 50 * summed
