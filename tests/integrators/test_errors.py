"""Wrong problems, methods, starts and counts: each is answered with one sentence that names it and shows the value."""

import dae_problems as dae
import numpy as np
import small_problems as small
from small_problems import ENERGY, KEPLER, KEPLER_START, ONE, OSCILLATOR, energy
from wrong_calls import answered

import minimd as md
import minimd.integrators as mi
from minimd.core.integrators.splitting import Splitting
from minimd.core.integrators.state import State, Surroundings
from minimd.core.integrators.steps import ForceSource, Steps
from minimd.core.integrators.substeps import Thermalize
from minimd.integrators import run_adaptive, run_reversible, run_steps, run_until

T, V, C = TypeError, ValueError, md.ConvergenceError
VERLET, GAUSS, RADAU = mi.VelocityVerlet(0.1), mi.GaussLegendre2(0.1), mi.RadauIIA2(0.05)
THREE = (1.0, 2.0, 3.0), (0.0, 0.0, 0.0)
GRID = np.ones((2, 3)), np.zeros((2, 3))
DECAY = mi.FirstOrder(lambda y: -y)
OFF = mi.Invariants(energy, value=-0.4)


def fall(q):
    return np.array([0.0, -1.0])


def circle(q):
    return [q @ q - 1.0]


def kept(invariants):
    run_steps(KEPLER, mi.projected(mi.RadauIIA2, invariants)(0.05), KEPLER_START, 5)


def stabilized(invariants):
    run_steps(mi.stabilized(KEPLER, invariants, 1.0), RADAU, KEPLER_START, 5)


def hanging(g=circle, masses=1.0):
    mi.Holonomic(fall, g, masses=masses).begin(((0.0, -1.0), (0.0, 0.0)))


def mechanical(mass=1.0, g=lambda q: q[0]):
    mi.Mechanical(mass, fall, g).begin(((0.0, 1.0), (0.0, 0.0)))


def index(pencil):
    mi.pencil_index(*pencil)


def steps_of(substeps, contact=None):
    """Steps of a user's method."""
    members = {"name": "mine", "substeps": substeps} | ({} if contact is None else {"contact": contact})
    method = type("Mine", (Splitting,), members)
    arrays = np.zeros((3, 2, 3))
    Steps(method(0.1), State(*arrays, np.ones(2)), Surroundings(), ForceSource(lambda *_: ())).advance(1)


OF_SUBSTEPS = (mi.separable_order, mi.nystrom_order, mi.stability_limit, lambda s: mi.energy_oscillation(s, 0.1),
    lambda s: mi.accurate_step(s, 0.01))  # fmt: skip
SHIFT = [[0, 1, 0], [0, 0, 0], [0, 0, 0]], [[0, 0, 1], [1, 0, 0], [0, 0, 0]]
# fmt: off
GROUPS = [  # function, error, argument, and several of (what the function is called with, the value shown)
    # functions whose arguments would be mistaken, or no functions
    (mi.SecondOrder, T, "f must take", (lambda q, t: -q, "(q, t)"), (lambda v, q: -q, "(v, q)"),
        (lambda q, v, t: -q, "(q, v, t)"), (lambda q, p, t: -q, "(q, p, t)"), (lambda t, x: -x, "(t, x)"),
        (lambda t, q, v, more: -q, "more)"), (lambda t, *rest: -rest[0], "(t, *rest)")),
    (mi.FirstOrder, T, "f must take y", (lambda y, t: -y, "(y, t)"), (lambda t, y, more: -y, "(t, y, more)")),
    (lambda j: mi.FirstOrder(lambda y: -y, jacobian=j), T, "jacobian", (lambda y, t: np.eye(1), "(y, t)")),
    (mi.SecondOrder, T, "f must be a function", (1.0, "1.0")),
    (lambda g: mi.Partitioned(g, lambda q: q), T, "g must be a function", (1.0, "1.0")),
    (lambda f: mi.Hessenberg2(f, lambda t, y: y - t), T, "f must take some of t, y, z", (lambda x: x, "(x)")),
    (lambda g: mi.Hessenberg2(lambda z: z, g), T, "g must be a function of t, y", (3.0, "3.0")),
    (lambda g: mi.Hessenberg2(lambda z: z, g), T, "g must take some of t, y", (lambda y, t: y, "(y, t)")),
    (mi.Invariants, T, "g must", (3.0, "3.0"), (lambda t, q, v: q[0], "not depend on t")),
    (lambda f: mi.Holonomic(f, circle), V, "f", (lambda q, v: -v, "f takes v")),
    # starts
    (lambda s: run_steps(OSCILLATOR, VERLET, s, 1), V, "the start", ([1.0, 0.0, 0.0], "[1.0, 0.0, 0.0]"),
        (None, "None"), (((), ()), "(0,)"), (((1.0, 2.0), (0.0,)), "(2,) and (1,)"), (((0.0,), (np.inf,)), "1 is inf")),
    (lambda s: run_steps(DECAY, GAUSS, s, 1), V, "the start", (1.0, "()"), ([[1.0]], "(1, 1)"), ([], "(0,)")),
    (dae.path_of_x().begin, V, "y", ([1.0], "tuple of y, z"), (([np.nan],), "y of the start"), (("a",), "'a'"),
        ((None,), "None"), (([1j],), "complex")),
    (dae.path_of_x().begin, V, "z of the start", (([0.0], "b"), "'b'")),
    (mi.Implicit(lambda y, slope: slope - y).begin, V, "one-dimensional", ([[1.0]], "[[1.0]]")),
    (lambda p: run_steps(p, VERLET, [1.0], 1), T, "velocity-verlet", (DECAY, "FirstOrder")),
    (lambda i: run_steps(mi.index_two(KEPLER, i), RADAU, KEPLER_START, 5), V, "constraint 0 = g", (OFF, "-1.00e-01")),
    # problems of another index, or another size
    (mi.Hessenberg1(lambda z: z, lambda y, z: y - 1 + 0 * z).begin, V, "g_z", (([1.0], [0.0]), "full rank")),
    (mi.Hessenberg2(lambda y, z: [z[0], -y[0]], lambda y: y[1] - 1).begin, V, "g_y f_z", (([0.0, 1.0],), "rank")),
    (mi.Hessenberg2(lambda y, z: y[:1] + z, lambda y: y[0] - 1).begin, V, "f", (([1.0, 2.0],), "got 1")),
    (mi.Hessenberg3(lambda z: z, lambda y, u: 0 * u - y, lambda y: y).begin, V, "g_y f_z k_u", (([0.0], [0.0]), "")),
    (lambda g: mechanical(g=g), V, "G M⁻¹ Gᵀ", (lambda q: [q[0], 2 * q[0]], "full rank")),
    (mechanical, V, "mass", (np.ones(3), "3 numbers"), ([1.0, 0.0], "must be regular")),
    (lambda f: mi.Implicit(f).begin([0.0, 1.0]), V, "", (lambda y, slope: 2 * [slope[0] - y[1]], "singular"),
        (lambda y, slope: slope[:1] - y[:1], "F has 1, y has 2")),
    (hanging, V, "independent", (lambda q: 2 * circle(q), "")),
    (lambda m: hanging(masses=m), V, "masses", ([1.0, 0], "0.")),
    (index, V, "", (([[1, 0], [0, 0]], [[1, 1], [0, 0]]), "singular"), (2 * ([[1, 1], [1, 1]],), "singular")),
    (index, V, "", (2 * (np.zeros((2, 2)),), "singular"), (SHIFT, "singular"), (([[np.nan]], [[1.0]]), "finite")),
    (index, V, "", ((np.eye(2), np.eye(3)), "(2, 2) and (3, 3)")),
    # counts and numbers
    (lambda n: run_steps(OSCILLATOR, VERLET, ONE, n), V, "n_steps", (0, "0"), (-1, "-1"), (1.0, "1.0")),
    (lambda n: run_steps(OSCILLATOR, VERLET, ONE, 3, every=n), V, "every", (True, "True"), ("3", "'3'")),
    (lambda q: mi.stormer_summed(np.negative, q, 0.0, 0.1, 10), V, "same shape", ([1.0, 2.0], "(2,), ()")),
    (lambda t: run_steps(OSCILLATOR, VERLET, ONE, 3, t0=t), V, "t0", (np.nan, "nan"), (np.inf, "inf")),
    (lambda t: run_until(OSCILLATOR, VERLET, ONE, t), V, "t_end", (np.nan, "nan"), (0.0, "0.0"), (-1.0, "-1.0")),
    (mi.VelocityVerlet, V, "timestep", (0.0, "0.0"), (np.inf, "inf"), ("0.1", "'0.1'"), (None, "None")),
    (lambda g: mi.stabilized(KEPLER, ENERGY, g), V, "gamma", (0.0, "0.0"), (np.nan, "nan"), ("much", "'much'")),
    (mi.Newton, V, "max_iterations", (0, "0")),
    (lambda d: mi.DensityControl(density=d), V, "density", (0.0, "0.0"), (np.nan, "nan")),
    (lambda r: mi.StepControl(rtol=r), V, "rtol", (-1e-6, "-1e-06"), (np.nan, "nan"), ("1e-6", "'1e-6'")),
    (lambda a: mi.StepControl(rtol=0.0, atol=a), V, "atol", (0.0, "0.0"), ([1e-9, -1e-9], "-1e-09"),
        (np.ma.masked_equal([1e-9, 1e-6], 1e-6), "masked")),
    (lambda h: mi.StepControl(first_step=h), V, "first_step", (0.0, "0.0"), (-0.1, "-0.1"), (np.nan, "nan")),
    (lambda h: mi.StepControl(min_step=h, max_step=0.1), V, "min_step", (0.2, "0.2"), (np.nan, "nan")),
    (lambda h: mi.StepControl(max_step=h), V, "max_step", (0.0, "0.0")),
    (lambda a: run_adaptive(OSCILLATOR, mi.SE1, ONE, 1.0, control=mi.StepControl(atol=a)), V, "atol",
        ([1e-9, 1e-9, 1e-9], "(3,)"), ([[1e-9], [1e-9]], "(2, 1)")),
    # coefficients
    *((f, T, "substeps must be", (None, "None"), ("ab", "'ab'"), (0.5, "0.5"), (np.nan, "nan"), ([1.0], "[1.0]"),
        (mi.Kick(1.0), "Kick")) for f in OF_SUBSTEPS),
    *((f, V, "coefficient of substeps[1]", ((mi.Kick(1.0), mi.Drift(np.nan)), "nan"),
        ((mi.Kick(1.0), mi.Drift("1")), "'1'")) for f in OF_SUBSTEPS),
    (lambda h: mi.energy_oscillation(VERLET.substeps, h), V, "h must", ("a", "'a'"), (None, "None"), (np.nan, "nan")),
    (lambda x: mi.accurate_step(VERLET.substeps, x), V, "oscillation", (-0.1, "-0.1"), (None, "None"), (np.nan, "nan")),
    (lambda w: mi.compose(mi.SE1, mi.SE2, weights=w), V, "weights", ("ab", "'ab'"), (0.5, "0.5"), (np.nan, "nan"),
        ([np.nan, 1.0], "[nan, 1.0]"), ([[0.5, 0.5]], "[[0.5, 0.5]]"), ([1.0], "1 weights")),
    (mi.collocation, V, "nodes", (0.5, "0.5"), (None, "None"), ("a", "'a'"), ([], "[]"), ([np.nan], "nan"),
        ([0.5, 0.5], "[0.5, 0.5]"), ([[0.5]], "[[0.5]]")),
    # steps of a user's method
    (steps_of, T, "substeps", ((mi.Kick(1.0), "drift"), "'drift'")),
    (steps_of, V, "substeps", ((), "()"), ((mi.Kick(0.0),), "Kick")),
    (lambda answer: steps_of((mi.Drift(1.0), Thermalize(1.0)), lambda *_: answer), T, "Mine.contact", ((), "none"),
        (None, "none"), (iter(()), "none")),
    # kinds
    (lambda m: run_steps(OSCILLATOR, m, ONE, 3), T, "method", (mi.SE1, "SE1"), ("verlet", "'verlet'")),
    (lambda m: run_reversible(KEPLER, m, KEPLER_START, 1.0), T, "with its time step", (mi.SE1, "SE1")),
    (lambda m: run_adaptive(OSCILLATOR, m, ONE, 1.0), T, "method", (VERLET, "0.1"), ("verlet", "'verlet'")),
    (lambda m: run_adaptive(DECAY, m, [1.0], 1.0), T, "its path", (mi.BDF2, "bdf-2"), (mi.BDF5, "bdf-5")),
    (lambda m: run_reversible(KEPLER, m, KEPLER_START, 1.0), V, "symmetric", (mi.SE1(0.1), "euler-1")),
    (lambda p: run_steps(p, VERLET, ONE, 1), T, "problem", (np.negative, "negative"), (None, "None")),
    (lambda r: mi.DensityControl(rate=r), T, "rate", (1.0, "1.0"), ("fast", "'fast'")),
    (lambda g: mi.Holonomic(np.negative, g), T, "g", (1.0, "1.0"), (None, "None")),
    (lambda j: mi.Holonomic(np.negative, circle, jacobian=j), T, "jacobian", (1.0, "1.0")),
    (mi.adjoint, T, "method", (VERLET, "0.1"), ("verlet", "'verlet'"), (None, "None")),
    (lambda s: mi.SecondOrder(np.negative, solver=s), T, "solver", (None, "None"), (mi.Newton, "Newton")),
    (lambda s: mi.Hessenberg2(lambda z: z, lambda t, y: y - t, solver=s), T, "solver", (mi.FixedPoint(), "Fixed")),
    (lambda m: mi.projected(m, ENERGY), T, "method", (VERLET, "0.1")),
    (lambda i: mi.symmetrically_projected(mi.VelocityVerlet, i), T, "invariants must be", (energy, "energy")),
    (lambda p: mi.index_two(p, ENERGY), T, "problem", (object(), "object")),
    (lambda p: mi.stabilized(p, ENERGY, 1.0), T, "problems", (object(), "object")),
    (lambda c: run_reversible(KEPLER, VERLET, KEPLER_START, 1.0, control=c), T, "control", (energy, "energy")),
    (lambda i: run_steps(small.RIGID_BODY, mi.projected(mi.RadauIIA2, i)(0.05), small.TURNING, 5), T,
        "g takes q and v", (ENERGY, "but the problem has none")),
    (lambda h: run_steps(dae.swing(), mi.SE1(h), dae.SWING_START, 10), C, "step 1", (5.0, "5")),
]
MISFITS = [  # invariants
    (mi.Invariants(energy, value=[1.0, 2.0]), V, "g has 1, value has 2"),
    (mi.Invariants(energy, lambda q, v: v), V, "jacobian must have 1 × 4 numbers, ∂g/∂y; got 2"),
    (mi.Invariants(lambda y: y), V, "got 4 ", "of 4"),
    (mi.Invariants(lambda y: []), V, "got 0 ", "of 4"),
    (mi.Invariants(lambda y: np.nan * y[0]), V, "finite at the start"),
    (mi.Invariants(lambda q, v: energy(q, v) * np.array([1.0, 2.0]), value=[-0.4, -0.8]), C,
        "invariant 1 is not independent"),
    (mi.Invariants(lambda q, v: q[0] * 0.0, value=1.0), C, "invariant 0"),
]
ANSWERS = [  # of f
    (lambda q: q.T, GRID, V, "(2, 3); got shape (3, 2)"),
    (lambda q: -q if q[0] > 0.95 else 0.0, THREE, V, "(3,); got shape ()"),  # within a run
    (lambda q: -q[:2], THREE, V, "(3,); got shape (2,)"),
    (lambda q: None, ONE, T, "None"),
    (lambda q: 1j * q, ONE, T, "real numbers"),
    (lambda q: "a", ONE, T, "'a'"),
]
test_a_wrong_call_is_answered_with_its_argument_and_its_value = answered(
    *((lambda call=c, x=x: call(x), e, name, shown) for c, e, name, *wrong in GROUPS for x, shown in wrong),
    *((lambda run=run, i=i: run(i), *row) for run in (kept, stabilized) for i, *row in MISFITS),
    *((lambda f=f, m=m, s=s: run_steps(mi.SecondOrder(f), m, s, 10), error, "f", shown)
        for m in (VERLET, GAUSS) for f, s, error, shown in ANSWERS),
)
# fmt: on
