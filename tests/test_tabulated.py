"""A pair potential from a table: as accurate as its spline, a force that is the derivative of the energy, and tables that are none."""

import copy

import numpy as np
import pytest
from references import liquid

import minimd as md
from minimd.diagnosis.run_report import cutoff_lines
from minimd.potentials.law import evaluate_law
from minimd.potentials.tabulated import Table, TabulatedLaw

CUTOFF = 2.5
ENDS = 0.8, CUTOFF
LJ = md.LennardJones(1.0, 1.0, CUTOFF)


def lennard_jones(r):
    return 4.0 * (r**-12 - r**-6)


def table(n, spacing=lambda x: x):
    low, high = ENDS
    r = low + (high - low) * spacing(np.linspace(0.0, 1.0, n))
    return md.Tabulated(r, lennard_jones(r))


def force_over_distance(potential, r):
    return np.array([evaluate_law(potential.plain_law, x * x, (0.0,))[1] for x in r])


def test_energy_has_the_order_of_the_spline():
    """Half the spacing: an error 2⁶ times smaller in u, 2⁵ times in the force."""
    r = np.linspace(1.3, 2.2, 400)  # away from the ends, where the error is larger and falls off from knot to knot
    exact = 24.0 * (2.0 * r**-14 - r**-8)
    coarse, fine = table(100), table(199)
    errors = [np.abs(one.pair_energy(r) - LJ.pair_energy(r)).max() for one in (coarse, fine)]
    assert 45.0 < errors[0] / errors[1] < 90.0
    errors = [np.abs(force_over_distance(one, r) - exact).max() for one in (coarse, fine)]
    assert 24.0 < errors[0] / errors[1] < 45.0
    assert errors[1] < 1e-4


@pytest.mark.parametrize("spacing", [lambda x: x, lambda x: x**2, lambda x: np.sqrt(0.1 + x) - np.sqrt(0.1)])
def test_force_is_the_derivative_of_the_energy_to_rounding(spacing):
    """Of each piece, by its own polynomial, also where points are not equally spaced; and the pieces meet in the fourth derivative."""
    potential = table(60, lambda x: spacing(x) / spacing(1.0))
    knots, coefficients, _ = potential.plain_law.table
    before = None
    assert np.array_equal(knots, potential.r)
    for k in range(len(knots) - 1):
        piece = np.polynomial.Polynomial(coefficients[0, k, ::-1])
        inside = knots[k] + (knots[k + 1] - knots[k]) * np.array([0.0, 0.3, 0.999])
        slope = piece.deriv()(inside - knots[k])
        size = sum(n * abs(c) * (knots[k + 1] - knots[k]) ** (n - 1) for n, c in enumerate(piece.coef) if n)
        assert force_over_distance(potential, inside) == pytest.approx(-slope / inside, rel=1e-14, abs=1e-14 * size)
        if before is not None:
            meeting = [before.deriv(d)(knots[k] - knots[k - 1]) - piece.deriv(d)(0.0) for d in range(1, 5)]
            sizes = [abs(before.deriv(d)(0.0)) + abs(piece.deriv(d)(0.0)) + size for d in range(1, 5)]
            assert np.all(np.abs(meeting) < 1e-9 * np.array(sizes) * (knots[k + 1] - knots[k]) ** -np.arange(4.0))
        before = piece
    assert force_over_distance(potential, knots[-1:]) == pytest.approx(
        -piece.deriv()(knots[-1] - knots[-2]) / knots[-1], rel=1e-12
    )


def test_the_points_of_the_table_are_on_the_spline():
    potential = table(30)
    shift = lennard_jones(CUTOFF)
    assert potential.pair_energy(potential.r[:-1]) == pytest.approx(
        lennard_jones(potential.r[:-1]) - shift, rel=1e-13, abs=1e-13
    )


def test_a_liquid_from_a_table_is_the_liquid_of_the_law():
    system, potential = liquid(5), table(500)
    one, other = md.evaluate(system, potential), md.evaluate(system, LJ)
    assert one.potential_energy == pytest.approx(other.potential_energy, abs=1e-5)
    assert one.forces == pytest.approx(other.forces, abs=1e-5)
    assert one.virial == pytest.approx(other.virial, abs=1e-4)


def test_energy_is_conserved_and_a_copy_goes_on_with_the_same_bits():
    """The table has forty points: its own energy is conserved, however far it is from that of Lennard-Jones."""
    r = np.linspace(*ENDS, 40)
    smooth = md.Tabulated(r, lennard_jones(r), truncation="smooth")
    sim = md.Simulation(liquid(5), smooth, md.VelocityVerlet(0.001))
    record = sim.run(300, every=10, progress=False)
    assert np.ptp(record.total_energy) < 2e-3 * record.kinetic_energy.mean()
    assert "pair list" in sim.engine.interactions.pair_search
    twin = copy.deepcopy(sim)
    for one in (sim, twin):
        one.run(20, progress=False)
    assert np.array_equal(sim.positions, twin.positions)


def test_closer_than_the_table_nothing_is_known():
    system = md.System([[0.0, 0.0, 0.0], [0.75, 0.0, 0.0]])
    assert np.isnan(table(30).pair_energy(0.75))
    with pytest.raises(md.NonFiniteError, match=r"atoms 0 and 1, 0\.75"):
        md.evaluate(system, table(30))


@pytest.mark.parametrize(
    ("truncation", "verdict"),
    [
        ("truncated", "THE ENERGY JUMPS"),
        ("shifted", "the energy is continuous, the force jumps"),
        ("smooth", "energy and force are continuous"),  # to rounding
    ],
)
def test_the_jump_at_the_cutoff_is_seen_of_a_table_that_begins_late(truncation, verdict):
    """Beyond 0.9 of the cutoff, where the report looks for the size of the law."""
    r = np.linspace(2.4, CUTOFF, 30)
    (line,) = cutoff_lines(md.System([[0.0, 0.0, 0.0]]), [md.Tabulated(r, lennard_jones(r), 2.47, truncation)])
    assert line.verdict.startswith(verdict)


def test_a_run_that_comes_closer_than_the_table_ends_and_says_so():
    """Two atoms on their way to each other pass from 1.02 to 0.98, where the table begins at 1."""
    r = np.linspace(1.0, CUTOFF, 30)
    pair = md.System([[0.0, 0.0, 0.0], [1.02, 0.0, 0.0]], velocities=[[1.0, 0.0, 0.0], [-1.0, 0.0, 0.0]])
    sim = md.Simulation(pair, md.Tabulated(r, 1e-6 * r), md.VelocityVerlet(0.02))
    with pytest.raises(
        md.NonFiniteError, match=r"the law of Tabulated gives no finite number for atoms 0 and 1, 0\.98 σ apart"
    ):
        sim.run(3, progress=False, crash_report=False)


def test_tables_are_equal_only_to_themselves():
    """They are keys of caches."""
    one, other = (Table(np.arange(3.0), np.zeros((1, 2, 6)), 1.0) for _ in range(2))
    assert one == one
    assert one != other
    assert {TabulatedLaw(one): 1}[TabulatedLaw(one)] == 1


R = np.linspace(*ENDS, 10)
WRONG = {
    "too short": ((R[:5], R[:5]), r"r must be at least 6 distances, for a spline of degree 5; its shape is \(5,\)"),
    "two dimensions": ((np.ones((6, 6)), R), r"r must be at least 6 distances.* \(6, 6\)"),
    "not sorted": ((R[::-1], R), r"r must increase; r\[1\] = 2.3\d* follows r\[0\] = 2.5: sort the table"),
    "twice": ((np.append(R, 2.5), np.append(R, 0.0)), r"r must increase; r\[10\] = 2.5 follows r\[9\] = 2.5"),
    "negative": ((R - 1.0, R), r"r must be finite and not negative; r\[0\] = -0.2"),
    "no distance": ((np.append(R, np.nan), np.append(R, 0.0)), r"r must be finite and not negative; r\[10\] = nan"),
    "no energy": ((R, np.append(np.inf, R[1:])), r"u must be finite; it is inf at r\[0\] = 0.8: leave such points out"),
    "other length": ((R, R[1:]), r"u must be 10 energies, one for each r; its shape is \(9,\)"),
    "of a pair": ((R, {("A", "B"): R[1:]}), r"u of \('A', 'B'\) must be 10 energies"),
    "no tables": ((R, {}), "u must be energies, or a mapping with an entry for each pair of species; it is empty"),
    "beyond": (
        (R, R, 2.6),
        r"cutoff must lie within .*, which goes from r = 0.8 to 2.5; cutoff = 2.6: give another cutoff, or a longer table",
    ),
    "before": ((R, R, 0.7), r"cutoff must lie within the table.*; cutoff = 0.7"),
    "text": ((R, "LJ"), "u must be"),
}


@pytest.mark.parametrize("what", WRONG)
def test_tables_that_are_none_are_refused_in_words(what):
    arguments, words = WRONG[what]
    with pytest.raises(ValueError, match=words):
        md.Tabulated(*arguments)


def test_a_pair_without_a_table_is_named():
    system = md.System([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0]], species=["A", "C"])
    with pytest.raises(ValueError, match=r"Tabulated has no table for the pair 'A', 'A'; it has \('A', 'B'\)"):
        md.evaluate(system, md.Tabulated(R, {("A", "B"): R}))
