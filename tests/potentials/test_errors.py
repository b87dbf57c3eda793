"""Wrong potentials, fields, tables and laws: refused with the name of the argument and its value, or with the atoms."""

from math import cos

import numpy as np
from wrong_calls import answered

import minimd as md

R = np.linspace(0.8, 2.5, 10)
CHAINS = [[k, k + 1, k + 2, k + 3] for k in range(7)]


LINE = md.System(np.arange(10)[:, None] * [1.0, 0.3, 0.0])
TWO = md.System([[0, 0, 0], [1, 0, 0]], bonds=[[0, 1]])
TALL = md.System([[0.1, 0.2, 0.3], [0.4, 0.2, -0.6]], cell=[[3.6, 0, 0], [1.2, 3.5, 0], [-0.8, 0.7, 4.0]])
WALL = md.Wall([0, 0, -1.6], [0, 0, 2.0])


def steered(**more):
    return md.SteeredSpring(1.0, [0, 0, 0], [1, 0, 0], **more)


def saddle(x, y, z, t, k):
    return k * x * y * (1.0 + t), -k * y * (1.0 + t), -k * x * (1.0 + t), 0.0, k * x * y


def pole(r2, a):
    return a / (r2 - 1.0), 2.0 * a / (r2 - 1.0) ** 2


EXCLUDING = md.LennardJones(1.0, 1.0, exclusions=[[0, 2]])
COULOMB = md.PairPotential(lambda r2, q: (q / r2**0.5, q / r2**1.5), (1.0,), 3.0, "truncated", tail_correction=True)
ONE_SPOT = md.System([[0, 0, 0], [1, 1, 1], [2, 0, 0], [1, 1, 1]], cell=5.0)
test_what_is_wrong_is_named_and_shown = answered(
    # bonds
    (lambda: md.FENEBond(-1.0, 1.5), ValueError, "k must", "-1.0"),
    (lambda: md.PeriodicDihedral(1.0, 1.5), ValueError, "n must", "1.5"),
    (lambda: md.RyckaertBellemans([1.0] * 7), ValueError, "coefficients", "1 to 6", "[1.0, "),
    (lambda: md.HarmonicImproper(1.0, 4.0), ValueError, "angle", "4.0"),
    (lambda: md.evaluate(LINE, md.PeriodicDihedral([1.0, 2.0], 1, 0.0, CHAINS)), ValueError, "k must", "7", "2"),
    (lambda: md.PeriodicDihedral(1.0, 1, quadruples=[[0, 1, 2, 2]]), ValueError, "quadruples", "[0, 1, 2, 2]"),
    (lambda: md.DihedralMap(np.zeros((2, 3)), CHAINS, CHAINS), ValueError, "energies", "(2, 3)"),
    (lambda: md.DihedralMap(np.zeros((0, 3, 3)), CHAINS, CHAINS), ValueError, "which", "maps, 0"),
    (lambda: md.DihedralMap([[np.nan]], CHAINS, CHAINS), ValueError, "energies", "nan"),
    (lambda: md.DihedralMap(np.eye(3), CHAINS, CHAINS[1:]), ValueError, "phi", "psi", "7 and 6"),
    (lambda: md.DihedralMap(np.eye(3), CHAINS, CHAINS, 1), ValueError, "which", "1.0"),
    (lambda: md.DihedralMap(np.eye(3), CHAINS, CHAINS, -1), ValueError, "which", "-1"),
    (lambda: md.DihedralMap(np.eye(3), [[0, 1, 2, 2]], [[0, 1, 2, 3]]), ValueError, "phi", "[0, 1, 2, 2]"),
    (lambda: md.evaluate(TWO, md.DihedralMap(np.eye(3), CHAINS, CHAINS)), ValueError, "phi", "0 to 1"),
    (lambda: md.evaluate(LINE, md.DihedralMap(np.eye(3), CHAINS, CHAINS, [0, 0])), ValueError, "which", "7", "(2,)"),
    (lambda: md.evaluate(md.System([[0, 0, 0], [1.5, 0, 0]], bonds=[[0, 1]]), md.FENEBond(30.0, 1.5)),
     md.NonFiniteError, "FENEBond", "atoms 0 and 1, 1.5 σ", "longest = 1.5 σ"),
    # pairs
    (lambda: md.evaluate(TWO, EXCLUDING), ValueError, "exclusions", "[0, 2]"),
    (lambda: md.PairPotential(lambda r2: (r2, -2.0), exclusions=[[1, 1]]), ValueError, "exclusions", "[1, 1]"),
    (lambda: md.Coulomb(exclusions=[[0, 1], [1, 0]]), ValueError, "exclusions", "2 times"),
    (lambda: md.Coulomb(5.0, method="reaction-field", dielectric=0.5), ValueError, "dielectric", "0.5"),
    (lambda: md.Coulomb(5.0, method="reaction-field", dielectric="water"), ValueError, "dielectric", "water"),
    # fields
    (lambda: md.evaluate(LINE, md.Wall([0, 0, 2.0], [0, 0, 1])), ValueError, "Wall", "atom 0"),
    (lambda: md.evaluate(TALL, WALL), ValueError, "Wall", "periodic", "crosses c", 'slab="z"'),
    (lambda: md.Wall([0, 0, 0], [0, 0, 0]), ValueError, "normal", "[0.0, 0.0, 0.0]"),
    (lambda: md.Wall([0, 0, 0], [0, 0, 1], law="10-4"), ValueError, "law", "10-4"),
    (lambda: steered(end=np.array([1.0, 2.0])), ValueError, "end", "[1., 2.]"),
    (lambda: steered(start=2.0, end=1.0), ValueError, "start = 2.0", "end = 1.0"),
    (lambda: md.evaluate(TWO, md.ConstantForce([0, 0, 1], [6])), ValueError, "atoms", "atom 6"),
    (lambda: md.evaluate(LINE, md.Restraint(1.0, np.zeros((2, 3)))), ValueError, "points", "(10, 3)", "(2, 3)"),
    (lambda: md.evaluate(LINE, md.Field(lambda x, y, z, t: (x * y, -y, x, 0.0))), ValueError, "∂u/∂y"),
    (lambda: md.evaluate(LINE, md.Field(lambda x, y, z, t: (x * t, -t, 0.0, 0.0))), ValueError, "∂u/∂t"),
    (lambda: md.evaluate(LINE, md.Field(lambda x, y, z, t: (x // 8 * cos(t), 0.0, 0.0, 0.0))), ValueError, "fifth"),
    (lambda: md.evaluate(LINE, md.Field(lambda x, y, z, t: (x, 1.0, 0.0))), TypeError, "returns 3 numbers"),
    (lambda: md.evaluate(LINE, md.Field(saddle, (1.0, 2.0))), TypeError, "2 parameters"),
    (lambda: md.Simulation(TWO, md.Field(saddle, (1.0,)), md.VelocityVerlet(0.01), precision="fixed-point"),
     ValueError, "fixed-point"),
    (lambda: md.Simulation(TWO, steered(), md.VelocityVerlet(0.01)).probe_reversibility(10), ValueError, "time"),
    # tables
    (lambda: md.Tabulated(R[:5], R[:5]), ValueError, "r must", "(5,)"),
    (lambda: md.Tabulated(np.append(R, 2.5), np.append(R, 0.0)), ValueError, "r must increase", "r[10] = 2.5"),
    (lambda: md.Tabulated(np.append(R, np.nan), np.append(R, 0.0)), ValueError, "r must", "r[10] = nan"),
    (lambda: md.Tabulated(R, np.append(np.inf, R[1:])), ValueError, "u must be finite", "inf at r[0] = 0.8"),
    (lambda: md.Tabulated(R, {("A", "B"): R[1:]}), ValueError, "u of ('A', 'B')", "(9,)"),
    (lambda: md.Tabulated(R, R, 2.6), ValueError, "cutoff = 2.6", "0.8 to 2.5"),
    (lambda: md.evaluate(TWO, md.Tabulated(R, {("A", "B"): R})), ValueError, "Tabulated", "('A', 'B')"),
    (lambda: md.evaluate(md.System([[0.0, 0, 0], [0.75, 0, 0]]), md.Tabulated(R, R)),
     md.NonFiniteError, "Tabulated", "atoms 0 and 1, 0.75"),
    # laws
    (lambda: md.evaluate(TWO, md.PairPotential(lambda r2, a: (a / r2, 2.0 * a / r2**1.5), (1.0,), 2.0)),
     ValueError, "at r = 1.86", "0.1671"),  # the force lacks an r
    (lambda: md.evaluate(TWO, md.PairPotential(pole, (), 2.0)), TypeError, "pole", "0 parameters"),
    (lambda: md.evaluate(md.System(TWO.positions, cell=9.0), COULOMB), ValueError, "tail"),
    *((lambda law=law: md.PairPotential(law), TypeError, "law", repr(law)) for law in ("law", (1.0, 2.0))),
    *((lambda law=law: md.BondPotential(law), TypeError, "law") for law in (len, dict, md.System, ())),
    (lambda: md.Forces(TWO, type("Nothing", (), {"bind": lambda self, system: None})()), TypeError, "bind", "add"),
    (lambda: md.evaluate(ONE_SPOT, md.LennardJones(1.0, 1.0, 2.0)), md.NonFiniteError, "atoms 1 and 3, 0 σ apart"),
)  # fmt: skip


def test_poles_and_fields_that_do_not_fit_the_cell_are_no_errors():
    md.PairPotential(pole, (1.0,), 2.0).table(("X",))
    md.Forces(TALL, md.Field(saddle, (0.8,)))
