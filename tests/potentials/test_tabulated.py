"""A pair potential from a table: as accurate as its spline, and its force is the derivative of the energy."""

import copy

import numpy as np
import pytest
from references import liquid

import minimd as md
from minimd.core.diagnosis.run_report import cutoff_lines
from minimd.core.potentials.law import evaluate_law

CUTOFF = 2.5
LJ = md.LennardJones(1.0, 1.0, CUTOFF)


def lennard_jones(r):
    return 4.0 * (r**-12 - r**-6)


def table(n, spacing=lambda x: x, truncation="shifted"):
    r = 0.8 + (CUTOFF - 0.8) * spacing(np.linspace(0.0, 1.0, n))
    return md.Tabulated(r, lennard_jones(r), truncation=truncation)


def force_over_distance(potential, r):
    return np.array([evaluate_law(potential.plain_law, x * x, (0.0,))[1] for x in r])


def test_energy_has_the_order_of_the_spline():
    """Half the spacing: an error 2⁶ times smaller in u, 2⁵ times in the force.
    Away from the ends, where the error is larger and falls off from knot to knot."""
    r, pair = np.linspace(1.3, 2.2, 400), (table(100), table(199))
    energies = [np.abs(one.pair_energy(r) - LJ.pair_energy(r)).max() for one in pair]
    forces = [np.abs(force_over_distance(one, r) - 24.0 * (2.0 * r**-14 - r**-8)).max() for one in pair]
    assert 45.0 < energies[0] / energies[1] < 90.0
    assert 24.0 < forces[0] / forces[1] < 45.0
    assert forces[1] < 1e-4


@pytest.mark.parametrize("spacing", [lambda x: x, lambda x: x**2, lambda x: np.sqrt(0.1 + x) - np.sqrt(0.1)])
def test_force_is_the_derivative_of_the_energy_to_rounding(spacing):
    """Of each piece, by its polynomial, also where points are not equally spaced; pieces meet in four derivatives."""
    potential = table(60, lambda x: spacing(x) / spacing(1.0))
    knots, coefficients, _ = potential.plain_law.table
    before, orders = None, np.arange(1, 5)
    assert np.array_equal(knots, potential.r)
    for k, width in enumerate(np.diff(knots)):
        piece = np.polynomial.Polynomial(coefficients[0, k, ::-1])
        inside = knots[k] + width * np.array([0.0, 0.3, 0.999])
        slope = piece.deriv()(inside - knots[k])
        size = sum(n * abs(c) * width ** (n - 1) for n, c in enumerate(piece.coef) if n)
        assert force_over_distance(potential, inside) == pytest.approx(-slope / inside, rel=1e-14, abs=1e-14 * size)
        if before is not None:
            meeting = [before.deriv(d)(knots[k] - knots[k - 1]) - piece.deriv(d)(0.0) for d in orders]
            sizes = [abs(before.deriv(d)(0.0)) + abs(piece.deriv(d)(0.0)) + size for d in orders]
            assert np.all(np.abs(meeting) < 1e-9 * np.array(sizes) * width ** (1.0 - orders))
        before = piece
    assert force_over_distance(potential, knots[-1:]) == pytest.approx(-piece.deriv()(width) / knots[-1], rel=1e-12)


def test_the_points_of_the_table_are_on_the_spline_and_nothing_is_known_before_them():
    potential = table(30)
    expected = lennard_jones(potential.r[:-1]) - lennard_jones(CUTOFF)
    assert potential.pair_energy(potential.r[:-1]) == pytest.approx(expected, rel=1e-13, abs=1e-13)
    assert np.isnan(potential.pair_energy(0.75))


@pytest.mark.slow
def test_energy_is_conserved_and_a_copy_goes_on_with_the_same_bits():
    """The table has forty points: its own energy is conserved, however far it is from that of Lennard-Jones."""
    sim = md.Simulation(liquid(3), table(40, truncation="smooth"), md.VelocityVerlet(0.001))
    record = sim.run(300, every=10, progress=False)
    assert np.ptp(record.total_energy) < 2e-3 * record.kinetic_energy.mean()
    assert "pair list" in sim.engine.interactions.pair_search
    twin = copy.deepcopy(sim)
    for one in (sim, twin):
        one.run(20, progress=False)
    assert np.array_equal(sim.positions, twin.positions)


def test_the_jump_at_the_cutoff_is_seen_of_a_table_that_begins_late():
    """Beyond 0.9 of the cutoff, where the report looks for the size of the law."""
    r = np.linspace(2.4, CUTOFF, 30)
    (line,) = cutoff_lines(md.System([[0.0, 0.0, 0.0]]), [md.Tabulated(r, lennard_jones(r), 2.47, "truncated")])
    assert line.verdict.startswith("THE ENERGY JUMPS")
