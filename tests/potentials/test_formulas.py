"""Each law by itself: its zero, its minimum, what it does at its ends, what it takes; and the work of moving fields."""

import itertools
from decimal import Decimal, localcontext
from fractions import Fraction

import numba
import numpy as np
import pytest
from MDAnalysis.lib.distances import calc_dihedrals
from scenes import BONDED
from scipy.interpolate import CubicSpline

import minimd as md

LJ = md.LennardJones(1.0, 1.0)
WALLS = [("9-3", 0.4 ** (1 / 6), 10.0**0.5 / 3.0), pytest.param("12-6", 2.0 ** (1 / 6), 1, marks=pytest.mark.slow)]
RULES = [
    ({"mixing": "lorentz-berthelot"}, 2.0, 1.5),
    ({"mixing": "geometric"}, 2.0, 2.0**0.5),
    ({"mixing": lambda a, b: (min(a[0], b[0]), max(a[1], b[1]))}, 1.0, 2.0),
    ({"pairs": {("B", "A"): (3.0, 1.0)}}, 3.0, 1.0),
]
MASS, K, V = 1.5, 6.0, np.array([0.8, 0.0, 0.0])
OMEGA = (K / MASS) ** 0.5


def two(distance, *more):
    """Two bonded atoms at a distance along x."""
    return md.System([[0, 0, 0], [distance, 0, 0], *more], bonds=[[0, 1]])


def test_lennard_jones_is_its_formula_with_its_minimum_and_zero_where_it_says():
    law = md.LennardJones(0.0104, 3.4, 8.0)
    r = np.linspace(3.0, 8.5, 30)
    formula = 4.0 * 0.0104 * ((3.4 / r) ** 12 - (3.4 / r) ** 6 - (3.4 / 8.0) ** 12 + (3.4 / 8.0) ** 6)
    assert law.pair_energy(r) == pytest.approx(np.where(r < 8.0, formula, 0.0), rel=1e-13)
    at_minimum = md.evaluate(two(2.0 ** (1.0 / 6.0) * 3.4), md.LennardJones(0.0104, 3.4, truncation="truncated"))
    assert at_minimum.potential_energy == pytest.approx(-0.0104, rel=1e-15)
    assert np.abs(at_minimum.forces).max() < 1e-16
    assert abs(md.evaluate(two(3.4), md.LennardJones(0.0104, 3.4)).potential_energy) < 1e-17


def test_a_mie_well_is_as_deep_as_it_says_where_it_says_and_12_6_is_lennard_jones():
    r = np.linspace(0.85, 2.4, 30)
    lennard_jones = md.LennardJones(0.7, 1.1, 2.5).pair_energy(r)
    assert md.Mie(0.7, 1.1, 12, 6, 2.5).pair_energy(r) == pytest.approx(lennard_jones, rel=1e-13)  # rounding
    for n, m in ((14.0, 7.0), (50.0, 49.0), (9.0, 3.0), (12.65, 5.5)):
        law = md.Mie(0.7, 1.1, n, m, truncation="truncated")
        factor = n / (n - m) * (n / m) ** (m / (n - m))
        formula = 0.7 * factor * ((1.1 / r) ** n - (1.1 / r) ** m)
        assert law.pair_energy(r) == pytest.approx(formula, rel=1e-12, abs=1e-13)
        at_minimum = md.evaluate(two((n / m) ** (1.0 / (n - m)) * 1.1), law)
        assert at_minimum.potential_energy == pytest.approx(-0.7, rel=1e-13)
        assert np.abs(at_minimum.forces).max() < 1e-12
        assert abs(md.evaluate(two(1.1), law).potential_energy) < 1e-14


def test_named_mixing_of_mie_keeps_equal_exponents_and_refuses_others():
    wells = {"A": (1.0, 1.0, 14.0, 7.0), "B": (4.0, 2.0, 14.0, 7.0)}
    for rule, sigma in (("lorentz-berthelot", 1.5), ("geometric", 2.0**0.5)):
        mixed = md.Mie(wells, cutoff=5.0, mixing=rule)
        expected = md.Mie(2.0, sigma, 14.0, 7.0, 5.0).pair_energy(1.8)
        assert mixed.pair_energy(1.8, "A", "B") == pytest.approx(expected, rel=1e-14)
    wells["B"] = (4.0, 2.0, 12.0, 6.0)
    hudson = md.Mie(wells, cutoff=5.0, mixing=lambda a, b: [0.5 * (x + y) for x, y in zip(a, b, strict=True)])
    assert hudson.pair_energy(1.8, "A", "B") == pytest.approx(md.Mie(2.5, 1.5, 13.0, 6.5, 5.0).pair_energy(1.8))
    with pytest.raises(ValueError, match=r"\(14.0, 7.0\) and \(12.0, 6.0\)"):
        md.Mie(wells, cutoff=5.0).pair_energy(1.8, "A", "B")


def test_a_soft_repulsion_ends_with_its_force_and_has_none_where_atoms_meet():
    law = md.SoftRepulsion(3.0, 1.2)
    r = np.array([1e-9, 0.3, 0.6, 1.19, 1.2, 1.3])
    expected = np.where(r < 1.2, 3.0 * (1.0 + np.cos(np.pi * r / 1.2)), 0.0)
    assert law.pair_energy(r) == pytest.approx(expected, rel=1e-13)
    for distance, force in ((0.0, 0.0), (1e-9, 3.0 * (np.pi / 1.2) ** 2 * 1e-9), (1.2 * (1.0 - 1e-9), 0.0)):
        assert md.evaluate(two(distance), law).forces[1, 0] == pytest.approx(force, rel=1e-12, abs=3e-8)


@pytest.mark.parametrize("precision", ["double", pytest.param("fixed-point", marks=pytest.mark.slow)])
def test_mie_soft_and_quartic_laws_on_vectors_are_the_sum_over_pairs(precision):
    """All at once on the cluster list; in fixed point to its grid."""
    places = 1.1 * np.stack(np.meshgrid(*[np.arange(6)] * 3), axis=-1).reshape(-1, 3)
    places += np.random.default_rng(2).uniform(-0.1, 0.1, places.shape)
    system = md.System(places, cell=6.6, bonds=np.arange(216).reshape(-1, 2))
    apart = places[:, None] - places
    r = np.linalg.norm(apart - 6.6 * np.rint(apart / 6.6), axis=2)
    stretch = r[::2, 1::2].diagonal() - 1.05
    mie, soft = md.Mie(1.0, 0.9, 14.0, 7.0, 1.7), md.SoftRepulsion(3.0, 1.9)
    quartic = md.QuarticBond(30.0, -20.0, 10.0, 1.05)
    energy = (mie.pair_energy(r[np.triu_indices(216, 1)]) + soft.pair_energy(r[np.triu_indices(216, 1)])).sum()
    energy += (stretch**2 * (30.0 + stretch * (10.0 * stretch - 20.0))).sum()
    sim = md.Simulation(system, [mie, soft, quartic], md.VelocityVerlet(0.001), precision=precision, threads=1)
    assert sim.potential_energy == pytest.approx(energy, rel=1e-11 if precision == "double" else 1e-8)
    assert "cluster" in sim.engine.interactions.pair_search


def test_a_spring_of_length_zero_pulls_with_k_times_the_distance_down_to_none():
    """u = ½ k r² is smooth where two atoms lie on one spot: no force there, a curvature that advises a time step."""
    apart, springs = np.array([0.3, 0.0, -0.4]), [md.HarmonicBond(3.0, 0.0), md.HarmonicBond([3.0], [0.0])]
    for spring, distance in itertools.product(springs, (0.0, 1e-200, 1e-9, 1.0)):
        system = md.System([[1.0, 2.0, 3.0], [1.0, 2.0, 3.0] + distance * apart], bonds=[[0, 1]])
        found, between = md.evaluate(system, spring), system.positions[1] - system.positions[0]
        assert found.forces.tolist() == [(3.0 * between).tolist(), (-3.0 * between).tolist()]
        assert found.potential_energy == pytest.approx(1.5 * between @ between, rel=1e-15)  # rounding
    frequency = md.advise_timestep(two(0.0), springs[0]).frequency
    assert frequency == pytest.approx(6.0**0.5, rel=1e-6)  # √(k/μ), truncation of the difference
    record = md.Simulation(two(0.0), springs[0], md.VelocityVerlet(0.01)).run(10, progress=False)
    assert record.total_energy.tolist() == [0.0]


@pytest.mark.parametrize(("rule", "epsilon", "sigma"), RULES)
def test_mixing_rules_and_what_is_given_instead(rule, epsilon, sigma):
    mixed = md.LennardJones({"A": (1.0, 1.0), "B": (4.0, 2.0)}, cutoff=5.0, truncation="truncated", **rule)
    expected = 4 * epsilon * ((sigma / 1.8) ** 12 - (sigma / 1.8) ** 6)
    assert float(mixed.pair_energy(1.8, "A", "B")) == pytest.approx(expected, rel=1e-14)


@pytest.mark.parametrize("cell", [None, 3.0, [[2.9, 0, 0], [1.2, 3.0, 0], [-0.8, 0.9, 3.3]]])
def test_scaled_pairs_are_those_along_the_bonds_at_their_nearest_image(cell):
    """The textbook sum over all images of all pairs: farther images count in full, and so do fourth neighbors, unless
    the pair is excluded."""
    positions = np.array([[0.1, 0.2, 0.3], [1.2, 0.4, 0.1], [1.4, 1.6, 0.5], [0.2, 1.5, 1.7], [0.4, 0.3, 1.6]])
    shifts = np.zeros((1, 3)) if cell is None else np.array([*np.ndindex(9, 9, 9)]) - 4
    scale, cutoff, expected, excluded = (0.0, 0.3, 0.7, 1.0), 4.0, 0.0, [[4, 0], [0, 2]]
    for i, j in itertools.product(range(5), repeat=2):
        distances = np.sort(np.linalg.norm(positions[j] - positions[i] + shifts @ md.Cell.of(cell).vectors, axis=1))
        distances = distances[int(i == j) :]
        energies = np.where(distances < cutoff, 4.0 * (distances**-12 - distances**-6), 0.0)
        if i != j:
            energies[0] *= scale[abs(i - j) - 1] * ([i, j] not in excluded and [j, i] not in excluded)
        expected += 0.5 * energies.sum()
    system = md.System(positions, cell=cell, bonds=[[0, 1], [1, 2], [2, 3], [3, 4]])
    law = md.LennardJones(1.0, 1.0, cutoff, "truncated", bonded_scale=scale[:3], exclusions=excluded)
    assert md.evaluate(system, law).potential_energy == pytest.approx(expected, rel=1e-12)


@pytest.mark.parametrize("n", [2, 5])
def test_laws_that_leave_out_different_pairs_share_a_list(n):
    """The pair list and clusters: all laws together give the sum of what each gives alone."""
    places = 1.1 * np.stack(np.meshgrid(*[np.arange(n)] * 3), axis=-1).reshape(-1, 3)
    system = md.System(places, charges=np.cos(np.arange(n**3)), cell=[1.1 * n + 0.1] * 3, bonds=[[0, 1], [1, 3]])
    lj = md.LennardJones(1.0, 1.0, 1.3, bonded_scale=(1.0, 0.5, 1.0), exclusions=[[0, 1], [4, 6]])
    charges = md.Coulomb(1.3, method="reaction-field", bonded_scale=(0.2, 1.0, 1.0), exclusions=[[3, 2], [4, 5]])
    energies = [md.evaluate(system, laws).potential_energy for laws in ([lj, charges], lj, charges)]
    assert energies[0] == pytest.approx(energies[1] + energies[2], rel=1e-13)


def test_bonds_change_nothing_by_themselves_break_and_may_exclude_pairs_on_one_spot():
    bent = [[0, 0, 0], [1.1, 0, 0], [1.5, 1.0, 0], [1.4, 1.4, 1.1]]
    free, joined = (md.evaluate(md.System(bent, bonds=bonds), LJ) for bonds in (None, [[0, 1], [1, 2], [2, 3]]))
    assert joined.potential_energy == free.potential_energy
    assert np.isfinite(md.evaluate(two(1e-9, [1.5, 0, 0]), BONDED).forces).all()
    broken = md.evaluate(two(40.0), md.MorseBond(3.0, 2.0, 1.1))
    assert broken.potential_energy == pytest.approx(3.0, rel=1e-15)
    assert broken.forces == pytest.approx(0.0, abs=1e-30)
    row = md.System([[0, 0, 0], [1.0, 0, 0], [2.1, 0, 0], [3.3, 0, 0]], bonds=[[2, 3], [1, 0], [1, 2]])
    k, length = np.array([10.0, 200.0, 3000.0]), np.array([1.0, 0.9, 1.2])  # in the order of the bonds
    expected = (0.5 * k * (np.array([1.2, 1.0, 1.1]) - length) ** 2).sum()
    assert md.evaluate(row, md.HarmonicBond(k, length)).potential_energy == pytest.approx(expected, rel=1e-13)


def exact_angle(positions, k, theta0):
    """Force on the first atom and energy of a harmonic angle δ or π − δ, δ < 0.01, with 40 digits: by fractions, and
    by the series of arctan."""
    decimal = lambda fraction: Decimal(fraction.numerator) / Decimal(fraction.denominator)  # noqa: E731
    i, j, l = ([Fraction(c) for c in row] for row in positions.tolist())
    a, b = ([c - m for c, m in zip(end, j, strict=True)] for end in (i, l))
    n = np.cross(a, b).tolist()
    a2, ab, n2 = (decimal(sum(x * y for x, y in zip(u, v, strict=True))) for u, v in ((a, a), (a, b), (n, n)))
    tangent = n2.sqrt() / abs(ab)
    delta = sum((-1) ** m * tangent ** (2 * m + 1) / (2 * m + 1) for m in range(10))
    pi = Decimal("3.14159265358979323846264338327950288419716939937510")
    stretch = (delta if ab > 0 else pi - delta) - Decimal(theta0)
    across = [decimal(c) for c in np.cross(n, a).tolist()]
    return [float(Decimal(k) * stretch * c / (a2 * n2.sqrt())) for c in across], float(Decimal(k) * stretch**2 / 2)


def test_angles_near_0_and_pi_have_all_their_digits():
    """At any place in space; the reference takes the angle that the rounded coordinates have."""
    rng = np.random.default_rng(6)
    with localcontext(prec=60):
        for sign, delta, theta0 in itertools.product((1.0, -1.0), 10.0 ** np.arange(-8, -2), (1.9, np.pi, 0.0)):
            arm, side = np.linalg.qr(rng.normal(size=(3, 2)))[0].T
            ends = np.array([arm, [0.0] * 3, 1.3 * (sign * np.cos(delta) * arm + np.sin(delta) * side)])
            system = md.System(ends + rng.uniform(-2.0, 2.0, 3))
            force, energy = exact_angle(system.positions, 20.0, theta0)
            found = md.evaluate(system, md.HarmonicAngle(20.0, theta0, [[0, 1, 2]]))
            assert np.linalg.norm(found.forces[0] - force) <= 1e-14 * np.linalg.norm(force)  # rounding
            assert found.potential_energy == pytest.approx(energy, rel=1e-14, abs=0.0)
    for rest, (end, angle) in itertools.product((0.0, 2.0, np.pi), ((2.2, np.pi), (0.3, 0.0))):  # no force at all
        found = md.evaluate(two(1.0, [end, 0, 0]), md.HarmonicAngle(10.0, rest, [[0, 1, 2]]))
        assert not found.forces.any()
        assert found.potential_energy == pytest.approx(5.0 * (angle - rest) ** 2, rel=1e-14, abs=1e-30)


def test_dihedral_angles_are_those_of_mdanalysis_and_planar_ones_have_forces():
    """The sign, trans and cis; and no division by sin φ: at φ = 0 and π forces are finite, and at a barrier zero."""
    for angle in (*np.random.default_rng(3).uniform(-np.pi, np.pi, 5), 0.0, np.pi):
        end = np.array([-0.6, np.cos(angle), np.sin(angle)]) * [-1.0, 1.0, -1.0] + [1.2, 0.0, 0.0]
        system = md.System([[-0.6, 1.0, 0.0], [0.0, 0.0, 0.0], [1.2, 0.0, 0.0], end], dihedrals=[[0, 1, 2, 3]])
        away = (float(calc_dihedrals(*system.positions)) - 0.7 + np.pi) % (2.0 * np.pi) - np.pi
        energy = md.evaluate(system, md.PeriodicDihedral(1.0, 1, 0.7)).potential_energy
        assert energy == pytest.approx(1.0 + np.cos(away), rel=1e-6, abs=1e-6)  # MDAnalysis computes in float32
        assert np.isfinite(md.evaluate(system, md.PeriodicDihedral(1.0, 3, 0.4)).forces).all()
    at_bottom = md.evaluate(system, md.PeriodicDihedral(1.0, 3))  # trans
    assert np.abs(at_bottom.forces).max() < 1e-14  # rounding
    straight = md.System([[-1.0, 0, 0], [0, 0, 0], [1, 0, 0], [1.5, 1, 0]], dihedrals=[[0, 1, 2, 3]])
    assert np.isfinite(md.evaluate(straight, md.PeriodicDihedral(1.0, 3, 0.4)).forces).all()


def test_maps_of_dihedrals_go_through_their_points_with_smooth_slopes():
    """u is the map at its points, and the product of two periodic splines between them, in any turn of the angles."""
    rng = np.random.default_rng(7)
    turns = 2.0 * np.pi * np.arange(6) / 5
    maps = rng.normal(size=(2, 5, 5))
    closed = np.pad(maps, ((0, 0), (0, 1), (0, 1)), "wrap")
    places = [*itertools.product(turns, turns), *rng.uniform(-np.pi, np.pi, (20, 2)), (np.pi, -np.pi)]
    for angles, which in itertools.product(places, (0, 1)):
        chains = [
            [[1.2 + x, 0, 0.1], [x, 0, 0], [x, 0, 1.1], [x + 1.3 * np.cos(angle), 1.3 * np.sin(angle), 1.2]]
            for x, angle in zip((0.0, 5.0), angles, strict=True)
        ]
        law = md.DihedralMap(maps, [[0, 1, 2, 3]], [[4, 5, 6, 7]], which)
        rows = CubicSpline(turns, closed[which], bc_type="periodic")(angles[0])
        rows[-1] = rows[0]
        expected = CubicSpline(turns, rows, bc_type="periodic")(angles[1])
        found = md.evaluate(md.System(np.concatenate(chains)), law).potential_energy
        assert found == pytest.approx(expected, rel=1e-12, abs=1e-12)
    straight = md.System([[-1.0, 0, 0], [0, 0, 0], [1, 0, 0], [2, 0, 0]])
    assert np.isfinite(md.evaluate(straight, md.DihedralMap(maps[0], [[0, 1, 2, 3]], [[3, 2, 1, 0]])).forces).all()


def test_dihedrals_follow_a_strained_cell():
    """As at constant pressure: their term goes on in the new cell, with the forces of a new one."""
    positions = np.array([[0.2, 2.7, 0.0], [-0.3, 3.6, 0.1], [0.4, 4.2, 0.8], [0.1, 5.1, 1.3]])
    system = md.System(positions, cell=4.0, dihedrals=[[0, 1, 2, 3]])
    system.positions[:] = system.cell.wrapped(system.positions)
    law, stretch = md.PeriodicDihedral(2.0, 3), np.array([[1.02, 0.01, 0.0], [0.01, 0.97, 0.0], [0.0, 0.0, 1.01]])
    forces = md.Forces(system, law)
    forces.compute()
    system.positions[:], system.cell = system.positions @ stretch, system.cell.strained(system.cell.vectors @ stretch)
    [term] = forces.terms
    forces.follow()
    sums = forces.compute()
    assert forces.terms == [term]
    assert sums.forces == pytest.approx(md.evaluate(system, law).forces, rel=1e-12)
    assert np.abs(sums.forces).max() > 0.1


@pytest.mark.parametrize(("law", "d", "depth"), WALLS)
def test_walls_have_their_laws(law, d, depth):
    """Where their wells lie, and how deep; they are continuous at the cutoff; at equal distance all are alike."""
    energy = lambda wall, z: md.evaluate(md.System([[0.0, 0.0, z]]), wall).potential_energy  # noqa: E731
    for size in (1e-300, 1e300):
        assert md.Wall([0, 0, 0], [3.0 * size, 0, -4.0 * size]).normal == pytest.approx([0.6, 0.0, -0.8])
    at_bottom = md.evaluate(md.System([[5.0, 6.0, 1.0 + 1.5 * d]]), md.Wall([0, 0, 1], [0, 0, 1], 2.0, 1.5, law=law))
    assert at_bottom.potential_energy == pytest.approx(-2.0 * depth, rel=1e-14)
    assert np.abs(at_bottom.forces).max() < 1e-14
    cut = md.Wall([0, 0, 1.0], [0, 0, 1], 2.0, 1.5, 3.0, law)
    assert [energy(cut, 4.0 + dz) for dz in (-1e-9, 1e-9)] == pytest.approx([0.0, 0.0], abs=1e-8)
    assert energy(md.SphereWall([0, 0, 0], 5.0, 2.0, 1.5, 3.0, law), -3.7) == pytest.approx(energy(cut, 2.3), rel=1e-13)


def test_a_restraint_is_a_spring_to_the_nearest_image_of_its_point():
    rng, k = np.random.default_rng(8), np.array([3.0, 1.0, 2.0])
    points, away = rng.uniform(-4.0, 4.0, (5, 3)), rng.uniform(-1.0, 1.0, (5, 3))
    system = md.System(points + away + 9.0 * rng.integers(-2, 3, (5, 3)), cell=9.0)
    found = md.evaluate(system, md.Restraint(k, points))
    assert found.potential_energy == pytest.approx(0.5 * (k * away**2).sum(), rel=1e-13)
    assert found.forces == pytest.approx(-k * away, rel=1e-12, abs=1e-13)


def test_parameters_given_once_or_for_each_are_of_one_type_for_the_compiler():
    """Else each combination of arrays that can be written and that cannot is compiled anew."""
    chain, fours = md.System(np.eye(5, 3)), [[0, 1, 2, 3], [1, 2, 3, 4]]
    twos, threes = ([four[:n] for four in fours] for n in (2, 3))
    bonded = (lambda k: md.HarmonicBond(k, 1.0, twos)), (lambda k: md.HarmonicAngle(k, 1.0, threes))
    wall = lambda k: md.Wall([0, 0, -1.0], [0, 0, 1], k, 1.0, atoms=[0, 1])  # noqa: E731
    for make in (*bonded, lambda k: md.PeriodicDihedral(k, 1, 0.0, fours), wall):
        terms = [vars(make(k).bind(chain)).values() for k in (2.0, [2.0, 3.0])]
        once, each = ([str(numba.typeof(one)) for one in term if isinstance(one, tuple)] for term in terms)
        assert once == each


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


@pytest.mark.parametrize("name", ["velocity-verlet", "position-verlet", "respa"])
def test_the_energy_minus_the_work_has_order_2_where_a_motion_begins_and_ends_under_tension(name):
    """Half a step of the power at either end is 0.03: of order 1."""
    apart = []
    for dt in (0.02, 0.01, -0.01):
        spring = md.SteeredSpring(10.0, [0, 0, 0], [0.3, 0, 0], start=np.sign(dt), end=3.0)
        laws = [md.Restraint(20.0, [0, 0, 0]), spring]
        sim = md.Simulation(md.System([[0.3, 0, 0]]), laws, md.integrators.METHODS[name](dt))
        record = sim.run(round(5.0 / abs(dt)), every=1, progress=False)
        apart.append(np.ptp(np.asarray(record.total_energy) - record.work))
    assert apart[0] < 0.01
    assert apart[0] == pytest.approx(4.0 * apart[1], rel=0.05)
    assert apart[2] < 2.0 * apart[1]


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
