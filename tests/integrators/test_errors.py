"""Wrong problems, methods, starts and counts: each is answered with one sentence that names it and shows the value."""

import dae_problems as dae
import numpy as np
import pytest
import small_problems as small
from small_problems import ENERGY, KEPLER, KEPLER_START, ONE, OSCILLATOR, energy
from wrong_calls import assert_answered

import minimd as md
import minimd.integrators as mi
from minimd.integrators import run_adaptive, run_reversible, run_steps, run_until

VERLET, GAUSS, RADAU = mi.VelocityVerlet(0.1), mi.GaussLegendre2(0.1), mi.RadauIIA2(0.05)
THREE = (1.0, 2.0, 3.0), (0.0, 0.0, 0.0)
GRID = np.ones((2, 3)), np.zeros((2, 3))
HANGING = (0.0, -1.0), (0.0, 0.0)
REST = (0.0, 1.0), (0.0, 0.0)
DECAY = mi.FirstOrder(lambda y: -y)


def falling(t, q, v):
    return -1.5 * (q @ v) / (q @ q)


def fall(q):
    return np.array([0.0, -1.0])


def kept(invariants):
    return lambda: run_steps(KEPLER, mi.projected(mi.RadauIIA2, invariants)(0.05), KEPLER_START, 5)


def stabilized(invariants):
    return lambda: run_steps(mi.stabilized(KEPLER, invariants, 1.0), RADAU, KEPLER_START, 5)


def adaptive(atol):
    return run_adaptive(OSCILLATOR, mi.SE1, ONE, 1.0, control=mi.StepControl(atol=atol))


def reversible(control):
    return run_reversible(KEPLER, VERLET, KEPLER_START, 1.0, control=control)


def of_index_two(invariants):
    return run_steps(mi.index_two(KEPLER, invariants), RADAU, KEPLER_START, 5)


def hanging(g=lambda q: [q @ q - 1.0], masses=1.0):
    return mi.Holonomic(fall, g, masses=masses).begin(HANGING)


def mechanical(mass=1.0, g=lambda q: q[0]):
    return mi.Mechanical(mass, fall, g).begin(REST)


def residual(f):
    return mi.Implicit(f).begin([0.0, 1.0])


def index(pencil):
    return mi.pencil_index(*pencil)


OFF = mi.Invariants(energy, value=-0.4)
GROUPS = [  # function, error, argument, and several of (what the function is called with, the value shown)
    # functions whose arguments would be mistaken, or no functions
    (mi.SecondOrder, TypeError, "f must take", (lambda q, t: -q, "(q, t)"), (lambda v, q: -q, "(v, q)")),
    (mi.SecondOrder, TypeError, "f must take", (lambda q, v, t: -q, "(q, v, t)"), (lambda q, p, t: -q, "(q, p, t)")),
    (mi.SecondOrder, TypeError, "f must take", (lambda t, q, v, more: -q, "more)"), (lambda t, x: -x, "(t, x)")),
    (mi.SecondOrder, TypeError, "f must take", (lambda t, *rest: -rest[0], "(t, *rest)")),
    (mi.FirstOrder, TypeError, "f must take y", (lambda y, t: -y, "(y, t)"), (lambda t, y, more: -y, "(t, y, more)")),
    (lambda j: mi.FirstOrder(lambda y: -y, jacobian=j), TypeError, "jacobian", (lambda y, t: np.eye(1), "(y, t)")),
    (mi.SecondOrder, TypeError, "f must be a function", (1.0, "1.0")),
    (mi.FirstOrder, TypeError, "f must be a function", (1.0, "1.0")),
    (lambda g: mi.Partitioned(g, lambda q: q), TypeError, "g must be a function", (1.0, "1.0")),
    (lambda f: mi.Hessenberg2(f, lambda t, y: y - t), TypeError, "f must take some of t, y, z", (lambda x: x, "(x)")),
    (lambda g: mi.Hessenberg2(lambda z: z, g), TypeError, "g must be a function of t, y", (3.0, "3.0")),
    (mi.Invariants, TypeError, "g must", (3.0, "3.0"), (lambda t, q, v: q[0], "not depend on t")),
    (lambda f: mi.Holonomic(f, lambda q: [q @ q - 1.0]), ValueError, "f", (lambda q, v: -v, "f takes v")),
    # starts
    (lambda s: run_steps(OSCILLATOR, VERLET, s, 1), ValueError, "the start", ([1.0, 0.0, 0.0], "[1.0, 0.0, 0.0]")),
    (lambda s: run_steps(OSCILLATOR, VERLET, s, 1), ValueError, "the start", (None, "None")),
    (lambda s: run_steps(OSCILLATOR, VERLET, s, 1), ValueError, "the start", (((1.0, 2.0), (0.0,)), "(2,) and (1,)")),
    (lambda s: run_steps(OSCILLATOR, VERLET, s, 1), ValueError, "the start", (((), ()), "(0,)")),
    (lambda s: run_steps(OSCILLATOR, VERLET, s, 1), ValueError, "the start", (((0.0,), (np.inf,)), "1 is inf")),
    (lambda s: run_steps(DECAY, GAUSS, s, 1), ValueError, "the start", (1.0, "()"), ([[1.0]], "(1, 1)"), ([], "(0,)")),
    (dae.path_of_x().begin, ValueError, "y", ([1.0], "tuple of y, z"), (([np.nan],), "y of the start")),
    (mi.Implicit(lambda y, slope: slope - y).begin, ValueError, "one-dimensional", ([[1.0]], "[[1.0]]")),
    (lambda p: run_steps(p, VERLET, [1.0], 1), TypeError, "velocity-verlet", (DECAY, "FirstOrder")),
    (of_index_two, ValueError, "constraint 0 = g", (OFF, "-1.00e-01")),
    # problems of another index, or another size
    (mi.Hessenberg1(lambda z: z, lambda y, z: y - 1 + 0 * z).begin, ValueError, "g_z", (([1.0], [0.0]), "full rank")),
    (
        mi.Hessenberg2(lambda y, z: [z[0], -y[0]], lambda y: y[1] - 1).begin,
        ValueError,
        "g_y f_z",
        (([0.0, 1.0],), "rank"),
    ),
    (mi.Hessenberg2(lambda y, z: y[:1] + z, lambda y: y[0] - 1).begin, ValueError, "f", (([1.0, 2.0],), "got 1")),
    (
        mi.Hessenberg3(lambda z: z, lambda y, u: 0 * u - y, lambda y: y).begin,
        ValueError,
        "g_y f_z k_u",
        (([0.0], [0.0]), "full rank"),
    ),
    (lambda g: mechanical(g=g), ValueError, "G M⁻¹ Gᵀ", (lambda q: [q[0], 2 * q[0]], "full rank")),
    (mechanical, ValueError, "mass", (np.ones(3), "3 numbers")),
    (mechanical, ValueError, "mass", ([1.0, 0.0], "must be regular")),
    (residual, ValueError, "", (lambda y, slope: 2 * [slope[0] - y[1]], "singular")),
    (residual, ValueError, "", (lambda y, slope: slope[:1] - y[:1], "F has 1, y has 2")),
    (hanging, ValueError, "independent", (lambda q: 2 * [q @ q - 1.0], "")),
    (lambda m: hanging(masses=m), ValueError, "masses", ([1.0, 0], "0.")),
    (index, ValueError, "", (([[1, 0], [0, 0]], [[1, 1], [0, 0]]), "singular")),
    (index, ValueError, "", (2 * ([[1, 1], [1, 1]],), "singular")),
    (index, ValueError, "", (2 * (np.zeros((2, 2)),), "singular")),
    (index, ValueError, "", (([[0, 1, 0], [0, 0, 0], [0, 0, 0]], [[0, 0, 1], [1, 0, 0], [0, 0, 0]]), "singular")),
    (index, ValueError, "", ((np.eye(2), np.eye(3)), "(2, 2) and (3, 3)")),
    (index, ValueError, "", (([[np.nan]], [[1.0]]), "finite")),
    # counts and numbers
    (lambda n: run_steps(OSCILLATOR, VERLET, ONE, n), ValueError, "n_steps", (0, "0"), (-1, "-1"), (1.0, "1.0")),
    (lambda n: run_steps(OSCILLATOR, VERLET, ONE, 3, every=n), ValueError, "every", (True, "True"), ("3", "'3'")),
    (lambda n: mi.stormer_two_step(np.negative, 1.0, 0.0, 0.1, n), ValueError, "n_steps", (0, "0"), (None, "None")),
    (lambda h: mi.stormer_summed(np.negative, 1.0, 0.0, h, 10), ValueError, "timestep", (0.0, "0.0"), (np.nan, "nan")),
    (lambda q: mi.stormer_summed(np.negative, q, 0.0, 0.1, 10), ValueError, "same shape", ([1.0, 2.0], "(2,), ()")),
    (lambda t: run_steps(OSCILLATOR, VERLET, ONE, 3, t0=t), ValueError, "t0", (np.nan, "nan"), (np.inf, "inf")),
    (lambda t: run_until(OSCILLATOR, VERLET, ONE, t), ValueError, "t_end", (np.nan, "nan"), (0.0, "0.0")),
    (lambda t: run_until(OSCILLATOR, VERLET, ONE, t), ValueError, "t_end", (-1.0, "-1.0")),
    (lambda t: run_adaptive(OSCILLATOR, mi.SE1, ONE, t), ValueError, "t_end", (-np.inf, "-inf"), (0.0, "0.0")),
    (lambda t: run_reversible(KEPLER, VERLET, KEPLER_START, t), ValueError, "t_end", (-1.0, "-1.0"), (np.nan, "nan")),
    (mi.VelocityVerlet, ValueError, "timestep", (0.0, "0.0"), (np.inf, "inf"), ("0.1", "'0.1'"), (None, "None")),
    (lambda g: mi.stabilized(KEPLER, ENERGY, g), ValueError, "gamma", (0.0, "0.0"), (np.nan, "nan")),
    (lambda g: mi.stabilized(KEPLER, ENERGY, g), ValueError, "gamma", ("much", "'much'")),
    (mi.Newton, ValueError, "max_iterations", (0, "0")),
    (mi.FixedPoint, ValueError, "max_iterations", (0, "0")),
    (lambda d: mi.DensityControl(density=d), ValueError, "density", (0.0, "0.0"), (np.nan, "nan")),
    (lambda n: mi.DensityControl(max_steps=n), ValueError, "max_steps", (0, "0"), (1.5, "1.5")),
    (lambda r: mi.StepControl(rtol=r), ValueError, "rtol", (-1e-6, "-1e-06"), (np.nan, "nan"), ("1e-6", "'1e-6'")),
    (lambda a: mi.StepControl(rtol=0.0, atol=a), ValueError, "atol", (0.0, "0.0"), ([1e-9, -1e-9], "-1e-09")),
    (
        lambda a: mi.StepControl(rtol=0.0, atol=a),
        ValueError,
        "atol",
        (np.ma.masked_equal([1e-9, 1e-6], 1e-6), "masked"),
    ),
    (lambda h: mi.StepControl(first_step=h), ValueError, "first_step", (0.0, "0.0"), (-0.1, "-0.1"), (np.nan, "nan")),
    (lambda h: mi.StepControl(min_step=h, max_step=0.1), ValueError, "min_step", (0.2, "0.2"), (np.nan, "nan")),
    (lambda h: mi.StepControl(max_step=h), ValueError, "max_step", (0.0, "0.0")),
    (adaptive, ValueError, "atol", ([1e-9, 1e-9, 1e-9], "(3,)"), ([[1e-9], [1e-9]], "(2, 1)")),
    # kinds
    (lambda m: run_steps(OSCILLATOR, m, ONE, 3), TypeError, "method", (mi.SE1, "SE1"), ("verlet", "'verlet'")),
    (lambda m: run_until(OSCILLATOR, m, ONE, 1.0), TypeError, "method", (mi.SE1, "SE1"), (None, "None")),
    (lambda m: run_reversible(KEPLER, m, KEPLER_START, 1.0), TypeError, "with its time step", (mi.SE1, "SE1")),
    (lambda m: run_adaptive(OSCILLATOR, m, ONE, 1.0), TypeError, "method", (VERLET, "0.1"), ("verlet", "'verlet'")),
    (lambda m: run_adaptive(DECAY, m, [1.0], 1.0), TypeError, "looks back", (mi.BDF2, "bdf-2"), (mi.BDF5, "bdf-5")),
    (lambda m: run_reversible(KEPLER, m, KEPLER_START, 1.0), ValueError, "symmetric", (mi.SE1(0.1), "euler-1")),
    (lambda p: run_steps(p, VERLET, ONE, 1), TypeError, "problem", (np.negative, "negative"), (None, "None")),
    (lambda p: run_until(p, VERLET, ONE, 1), TypeError, "problem", (3.0, "3.0")),
    (lambda p: run_adaptive(p, mi.VelocityVerlet, ONE, 1), TypeError, "problem", (3.0, "3.0")),
    (lambda s: mi.SecondOrder(np.negative, solver=s), TypeError, "solver", (None, "None"), (mi.Newton, "Newton")),
    (lambda s: mi.FirstOrder(np.negative, solver=s), TypeError, "solver", ("newton", "'newton'")),
    (
        lambda s: mi.Hessenberg2(lambda z: z, lambda t, y: y - t, solver=s),
        TypeError,
        "solver",
        (mi.FixedPoint(), "Fixed"),
    ),
    (lambda m: mi.projected(m, ENERGY), TypeError, "method", (VERLET, "0.1")),
    (lambda i: mi.symmetrically_projected(mi.VelocityVerlet, i), TypeError, "invariants must be", (energy, "energy")),
    (lambda i: mi.with_multipliers(mi.VelocityVerlet, i), TypeError, "invariants must be", (energy, "energy")),
    (lambda p: mi.index_two(p, ENERGY), TypeError, "problem", (object(), "object")),
    (lambda p: mi.stabilized(p, ENERGY, 1.0), TypeError, "problems", (object(), "object")),
    (reversible, TypeError, "control", (falling, "falling")),
]
TWICE = mi.Invariants(lambda q, v: [energy(q, v), 2.0 * energy(q, v)], value=[-0.4, -0.8])
MISFITS = [
    (mi.Invariants(energy, value=[1.0, 2.0]), ValueError, "g has 1, value has 2"),
    (mi.Invariants(energy, lambda q, v: v), ValueError, "jacobian must have 1 × 4 numbers, ∂g/∂y; got 2"),
    (mi.Invariants(lambda y: y), ValueError, "got 4 of 4"),
    (mi.Invariants(lambda y: []), ValueError, "got 0 of 4"),
    (mi.Invariants(lambda y: np.nan * y[0]), ValueError, "finite at the start"),
    (TWICE, md.ConvergenceError, "invariant 1 is not independent"),
    (mi.Invariants(lambda q, v: q[0] * 0.0, value=1.0), md.ConvergenceError, "invariant 0"),
]
ANSWERS = [
    (lambda q: q.T, GRID, ValueError, "(2, 3); got shape (3, 2)"),
    (lambda q: -q if q[0] > 0.95 else 0.0, THREE, ValueError, "(3,); got shape ()"),  # within a run
    (lambda q: -q[:2], THREE, ValueError, "(3,); got shape (2,)"),
    (lambda q: None, ONE, TypeError, "None"),
    (lambda q: 1j * q, ONE, TypeError, "real numbers"),
    (lambda q: "a", ONE, TypeError, "'a'"),
]
TURNED = (small.RIGID_BODY, mi.projected(mi.RadauIIA2, ENERGY)(0.05), small.TURNING, 5)
TABLE = [
    *((lambda call=c, x=x: call(x), e, name, shown) for c, e, name, *wrong in GROUPS for x, shown in wrong),
    *((run(invariants), error, shown) for run in (kept, stabilized) for invariants, error, shown in MISFITS),
    *(
        (lambda f=f, m=m, start=start: run_steps(mi.SecondOrder(f), m, start, 10), error, "f", shown)
        for m in (VERLET, GAUSS)
        for f, start, error, shown in ANSWERS
    ),
    (lambda: run_steps(*TURNED), TypeError, "g takes q and v, but the problem has none"),
    (lambda: run_steps(dae.swing(), mi.SE1(5.0), dae.SWING_START, 10), md.ConvergenceError, "step 1", "5"),
]


@pytest.mark.parametrize("row", range(len(TABLE)))
def test_a_wrong_call_is_answered_with_its_argument_and_its_value(row):
    assert_answered(*TABLE[row])


def test_counts_may_be_integers_of_numpy():
    assert len(run_steps(OSCILLATOR, VERLET, ONE, np.int32(3)).t) == 4
