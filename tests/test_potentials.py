"""Laws of forces that every potential obeys. POTENTIALS is where a new one is registered."""

import itertools
from decimal import Decimal, localcontext
from fractions import Fraction

import numba
import numpy as np
import pytest
from references import brute_force_energy, numerical_forces

import minimd as md
from minimd.potentials.truncation import TRUNCATIONS

CUTOFF = 2.3


def yukawa(r2, strength, kappa):
    r = np.sqrt(r2)
    u = strength * np.exp(-kappa * r) / r
    return u, u * (kappa * r + 1.0) / r2


@numba.njit
def soft_core(r2, height):
    return height * np.exp(-r2), 2.0 * height * np.exp(-r2)


R = np.linspace(0.3, CUTOFF, 60)
TABLES = {("A", "A"): np.exp(-R), ("A", "B"): np.exp(-2.0 * R), ("B", "B"): 1.0 / R}
CHAINS = [[k, k + 1, k + 2, k + 3] for k in range(7)]
TWO_KINDS = {"A": (1.0, 1.0), "B": (0.5, 0.88)}
POTENTIALS = {
    **{f"lennard-jones {t}": md.LennardJones(1.0, 1.0, CUTOFF, t) for t in TRUNCATIONS},
    "lennard-jones mixture": md.LennardJones(TWO_KINDS, cutoff=CUTOFF),
    "kob-andersen": md.LennardJones(
        TWO_KINDS, cutoff={("A", "A"): 2.5, ("A", "B"): 2.0, ("B", "B"): 2.2}, pairs={("A", "B"): (1.5, 0.8)}
    ),
    "scaled neighbors": md.LennardJones(TWO_KINDS, cutoff=CUTOFF, truncation="switched", bonded_scale=(0.0, 0.3, 0.7)),
    "yukawa": md.PairPotential(yukawa, (2.0, 1.1), CUTOFF, "force-shifted"),
    "soft core": md.PairPotential(soft_core, (3.0,), CUTOFF),
    "tabulated": md.Tabulated(R, TABLES, truncation="switched", bonded_scale=(0.5, 1.0, 1.0)),
    "harmonic bonds": md.HarmonicBond(np.linspace(50, 90, 9), 1.1),
    "harmonic angles": md.HarmonicAngle(20.0, 2.0, [[k, k + 1, k + 2] for k in range(8)]),
    "morse bonds": md.MorseBond(np.linspace(3.0, 5.0, 9), 2.0, 1.1),
    "fene bonds": md.FENEBond(30.0, 1.9, 1.0, np.linspace(0.9, 1.2, 9)),
    "periodic dihedrals": md.PeriodicDihedral(np.linspace(0.5, 2.0, 7), [0, 1, 2, 3, 4, 5, 6], 0.4, CHAINS),
    "ryckaert-bellemans": md.RyckaertBellemans((1.3, 1.4, -1.6, -0.4, 3.1, -3.4), CHAINS),
    "harmonic impropers": md.HarmonicImproper(3.0, np.linspace(-3.1, 3.1, 7), CHAINS),
    "several": [
        md.LennardJones(1.0, 1.0, CUTOFF),
        md.PairPotential(yukawa, (1.0, 2.0), 1.9),
        md.HarmonicBond(30.0, 1.0),
    ],
}


SCENES = {
    "cube": {"cell": 4.7},
    "triclinic": {"cell": [[4.6, 0, 0], [1.5, 4.4, 0], [-1.0, 0.7, 5.0]]},
    "left-handed": {"cell": [[0, 4.6, 0], [4.7, 0, 0], [0, 0, 4.8]]},
    "slab": {"cell": [4.7, 4.9, 9.0], "pbc": (True, True, False)},
    "small": {"cell": 3.6},
    "open": {"cell": None},
}


def chain(cell, pbc=None, seed=4):
    """Ten atoms along a bent chain, 1 apart, of two species."""
    rng = np.random.default_rng(seed)
    k = np.arange(10)
    positions = np.column_stack([np.cos(k * 0.9), np.sin(k * 0.9), 0.36 * k]) * 1.15 + 0.05 * rng.normal(size=(10, 3))
    return md.System(
        positions, cell=cell, pbc=pbc, species=np.where(k % 3, "A", "B"), bonds=np.column_stack([k[:-1], k[1:]])
    )


@pytest.fixture(params=SCENES)
def system(request):
    return chain(**SCENES[request.param])


@pytest.fixture(params=POTENTIALS)
def potential(request):
    return POTENTIALS[request.param]


def test_force_is_minus_the_gradient(system, potential):
    forces = md.evaluate(system, potential).forces
    assert forces == pytest.approx(
        numerical_forces(system, potential), rel=1e-6, abs=2e-6
    )  # truncation h², rounding u/h


def test_forces_sum_to_zero(system, potential):
    forces = md.evaluate(system, potential).forces
    assert np.abs(forces.sum(axis=0)).max() < 1e-13 * np.abs(forces).sum()  # rounding


def test_virial_is_the_strain_derivative_of_the_energy(system, potential):
    """W = −∂U/∂(strain) at zero strain, for every component."""
    virial, h = md.evaluate(system, potential).virial, 1e-6
    for a, b in itertools.product(range(3), repeat=2):
        energies = []
        for sign in (-1, 1):
            strain = np.eye(3)
            strain[a, b] += sign * h
            cell = md.Cell.of(system.cell.vectors @ strain, system.cell.pbc)
            moved = md.System(system.positions @ strain, cell=cell, species=system.species, bonds=system.bonds)
            energies.append(md.evaluate(moved, potential).potential_energy)
        assert virial[a, b] == pytest.approx((energies[0] - energies[1]) / (2 * h), rel=1e-5, abs=1e-5)


def test_energy_is_that_of_the_atoms(system, potential):
    result = md.evaluate(system, potential)
    assert result.energies.sum() == pytest.approx(result.potential_energy, rel=1e-13, abs=1e-13)


def test_nothing_depends_on_place_direction_or_order(system, potential):
    rng = np.random.default_rng(0)
    result = md.evaluate(system, potential)
    rotation = np.linalg.qr(rng.normal(size=(3, 3)))[0]
    cells_away = rng.integers(-2, 3, (len(system), 3)) * system.cell.pbc
    positions = (system.positions + cells_away @ system.cell.vectors + rng.normal(size=3)) @ rotation
    cell = md.Cell.of(system.cell.vectors @ rotation, system.cell.pbc)
    moved = md.evaluate(md.System(positions, cell=cell, species=system.species, bonds=system.bonds), potential)
    assert moved.potential_energy == pytest.approx(result.potential_energy, rel=1e-11, abs=1e-11)
    assert moved.forces == pytest.approx(result.forces @ rotation, rel=1e-10, abs=1e-10)
    assert moved.virial == pytest.approx(rotation.T @ result.virial @ rotation, rel=1e-10, abs=1e-10)
    assert moved.energies == pytest.approx(result.energies, rel=1e-10, abs=1e-10)


@pytest.mark.parametrize("name", ["lennard-jones shifted", "lennard-jones mixture", "kob-andersen", "yukawa"])
def test_relabeled_atoms_feel_the_same(name):
    system, order = chain(4.7), np.random.default_rng(1).permutation(10)
    relabeled = md.System(system.positions[order], cell=4.7, species=system.species[order])
    forces = md.evaluate(md.System(system.positions, cell=4.7, species=system.species), POTENTIALS[name]).forces
    assert md.evaluate(relabeled, POTENTIALS[name]).forces == pytest.approx(forces[order], rel=1e-12, abs=1e-12)


@pytest.mark.parametrize("scene", ["cube", "triclinic", "left-handed"])
def test_replicated_cell_has_replicated_energy(scene):
    one = chain(**SCENES[scene])
    one = md.System(one.positions, cell=one.cell, species=one.species)
    shifts = np.array(list(itertools.product(range(2), range(3), range(1)))) @ one.cell.vectors
    many = md.System(
        (one.positions + shifts[:, None, :]).reshape(-1, 3),
        cell=one.cell.vectors * [[2], [3], [1]],
        species=np.tile(one.species, 6),
    )
    potential = POTENTIALS["lennard-jones mixture"]
    a, b = md.evaluate(one, potential), md.evaluate(many, potential)
    assert b.potential_energy == pytest.approx(6 * a.potential_energy, rel=1e-12)
    assert b.forces == pytest.approx(np.tile(a.forces, (6, 1)), rel=1e-11, abs=1e-11)
    assert b.virial == pytest.approx(6 * a.virial, rel=1e-12, abs=1e-11)


@pytest.mark.parametrize("scene", SCENES)
def test_pair_energy_equals_the_textbook_sum(scene):
    system = chain(**SCENES[scene])
    shift = 4.0 * (CUTOFF**-12 - CUTOFF**-6)
    expected = brute_force_energy(system, lambda r: 4.0 * (r**-12 - r**-6) - shift, CUTOFF)
    assert md.evaluate(system, md.LennardJones(1.0, 1.0, CUTOFF)).potential_energy == pytest.approx(expected, rel=1e-12)


def test_lennard_jones_has_its_minimum_and_zero_where_it_says():
    r_minimum = 2.0 ** (1.0 / 6.0) * 3.4
    at_minimum = md.evaluate(
        md.System([[0, 0, 0], [r_minimum, 0, 0]]), md.LennardJones(0.0104, 3.4, truncation="truncated")
    )
    assert at_minimum.potential_energy == pytest.approx(-0.0104, rel=1e-15)
    assert np.abs(at_minimum.forces).max() < 1e-16
    at_zero = md.evaluate(md.System([[0, 0, 0], [3.4, 0, 0]]), md.LennardJones(0.0104, 3.4, truncation="truncated"))
    assert abs(at_zero.potential_energy) < 1e-17


def test_a_spring_of_length_zero_pulls_with_k_times_the_distance_down_to_none():
    """u = ½ k r² is smooth where two atoms lie on one spot: no force there, and a curvature that advises a time step."""
    springs, apart = [md.HarmonicBond(3.0, 0.0), md.HarmonicBond([3.0], [0.0])], np.array([0.3, 0.0, -0.4])
    for spring in springs:
        for distance in (0.0, 1e-200, 1e-9, 1.0):
            system = md.System([[1.0, 2.0, 3.0], [1.0, 2.0, 3.0] + distance * apart], bonds=[[0, 1]])
            found, between = md.evaluate(system, spring), system.positions[1] - system.positions[0]
            assert found.forces.tolist() == [(3.0 * between).tolist(), (-3.0 * between).tolist()]
            assert found.potential_energy == pytest.approx(1.5 * between @ between, rel=1e-15)  # rounding
    at_rest = md.System([[1.0, 2.0, 3.0], [1.0, 2.0, 3.0]], bonds=[[0, 1]])
    assert md.advise_timestep(at_rest, springs[0]).frequency == pytest.approx(
        6.0**0.5, rel=1e-6
    )  # k/μ, truncation of the difference
    assert md.Simulation(at_rest, springs[0], md.VelocityVerlet(0.01)).run(
        10, progress=False
    ).total_energy.tolist() == [0.0]
    with pytest.raises(md.NonFiniteError, match="atoms 0 and 1, 0 σ apart"):
        md.evaluate(at_rest, md.HarmonicBond(3.0, 1.0))


def test_mixing_rules():
    def of_extremes(first, second):
        return min(first[0], second[0]), max(first[1], second[1])

    for mixing, expected in (
        ("lorentz-berthelot", (2.0, 1.5)),
        ("geometric", (2.0, 2.0**0.5)),
        (of_extremes, (1.0, 2.0)),
    ):
        mixed = md.LennardJones({"A": (1.0, 1.0), "B": (4.0, 2.0)}, cutoff=5.0, truncation="truncated", mixing=mixing)
        epsilon, sigma = expected
        assert float(mixed.pair_energy(1.8, "A", "B")) == pytest.approx(
            4 * epsilon * ((sigma / 1.8) ** 12 - (sigma / 1.8) ** 6), rel=1e-14
        )
    explicit = md.LennardJones(
        {"A": (1.0, 1.0), "B": (4.0, 2.0)}, cutoff=5.0, truncation="truncated", pairs={("B", "A"): (3.0, 1.0)}
    )
    assert float(explicit.pair_energy(1.0 * 2 ** (1 / 6), "A", "B")) == pytest.approx(-3.0)


def test_bonded_scale_acts_on_the_bond_graph():
    bent = md.System(
        [[0, 0, 0], [1.1, 0, 0], [1.5, 1.0, 0], [1.4, 1.4, 1.1], [0.4, 1.6, 1.6]],
        bonds=[[0, 1], [1, 2], [2, 3], [3, 4]],
    )
    free = md.System(bent.positions)
    scale = (0.1, 0.2, 0.4, 1.0)
    expected = 0.0
    for i, j in itertools.combinations(range(5), 2):
        pair = md.System(free.positions[[i, j]])
        expected += scale[j - i - 1] * md.evaluate(pair, md.LennardJones(1.0, 1.0)).potential_energy
    assert md.evaluate(bent, md.LennardJones(1.0, 1.0, bonded_scale=scale[:3])).potential_energy == pytest.approx(
        expected, rel=1e-13
    )
    assert md.evaluate(bent, md.LennardJones(1.0, 1.0)).potential_energy == pytest.approx(
        md.evaluate(free, md.LennardJones(1.0, 1.0)).potential_energy
    )


def test_excluded_pairs_may_sit_on_each_other():
    system = md.System([[0, 0, 0], [1e-9, 0, 0], [1.5, 0, 0]], bonds=[[0, 1]])
    assert np.isfinite(md.evaluate(system, md.LennardJones(1.0, 1.0, bonded_scale=(0, 1, 1))).forces).all()


def exact_angle(positions, k, theta0):
    """Force on the first atom and energy of a harmonic angle δ or π − δ, δ < 0.01, with 40 digits: fractions, and the series of arctan."""
    i, j, l = ([Fraction(c) for c in row] for row in positions.tolist())
    a, b = ([c - m for c, m in zip(end, j, strict=True)] for end in (i, l))
    n = np.cross(a, b).tolist()
    a2, ab, n2 = (decimal(sum(x * y for x, y in zip(u, v, strict=True))) for u, v in ((a, a), (a, b), (n, n)))
    tangent = n2.sqrt() / abs(ab)
    delta = sum((-1) ** m * tangent ** (2 * m + 1) / (2 * m + 1) for m in range(10))
    stretch = (delta if ab > 0 else Decimal("3.14159265358979323846264338327950288419716939937510") - delta) - Decimal(
        theta0
    )
    across = [decimal(c) for c in np.cross(n, a).tolist()]
    return [float(Decimal(k) * stretch * c / (a2 * n2.sqrt())) for c in across], float(Decimal(k) * stretch**2 / 2)


def decimal(fraction):
    return Decimal(fraction.numerator) / Decimal(fraction.denominator)


def test_angles_near_0_and_pi_have_all_their_digits():
    """At any place in space; the reference takes the angle that the rounded coordinates have."""
    rng = np.random.default_rng(6)
    deltas, laws = 10.0 ** np.arange(-8, -2), [(1.9, 20.0), (np.pi, 20.0), (0.0, 20.0)]
    with localcontext(prec=60):
        for sign, delta, (theta0, k) in itertools.product((1.0, -1.0), deltas, laws):
            arm, side = np.linalg.qr(rng.normal(size=(3, 2)))[0].T
            ends = np.array([arm, [0.0] * 3, 1.3 * (sign * np.cos(delta) * arm + np.sin(delta) * side)])
            system = md.System(ends + rng.uniform(-2.0, 2.0, 3))
            force, energy = exact_angle(system.positions, k, theta0)
            found = md.evaluate(system, md.HarmonicAngle(k, theta0, [[0, 1, 2]]))
            assert np.linalg.norm(found.forces[0] - force) <= 1e-14 * np.linalg.norm(force)  # rounding
            assert found.potential_energy == pytest.approx(energy, rel=1e-14, abs=0.0)


@pytest.mark.parametrize("angle", [0.0, 2.0, np.pi])
def test_straight_and_folded_angles_pull_nowhere(angle):
    for end in ([2.2, 0, 0], [0.3, 0, 0]):
        exactly = md.System([[0, 0, 0], [1, 0, 0], end])
        found = md.evaluate(exactly, md.HarmonicAngle(10.0, angle, [[0, 1, 2]]))
        assert not found.forces.any()
        assert found.potential_energy == pytest.approx(
            5.0 * ((np.pi if end[0] > 1.0 else 0.0) - angle) ** 2, rel=1e-14, abs=1e-30
        )


def test_dihedral_angles_are_those_of_mdanalysis_and_planar_ones_have_forces():
    """The sign, trans and cis; and no division by sin φ: at φ = 0 and π forces are finite, and at a barrier zero."""
    from MDAnalysis.lib.distances import calc_dihedrals

    rng = np.random.default_rng(3)
    for angle in (*rng.uniform(-np.pi, np.pi, 5), 0.0, np.pi):
        end = np.array([-0.6, np.cos(angle), np.sin(angle)]) * [-1.0, 1.0, -1.0] + [1.2, 0.0, 0.0]
        system = md.System([[-0.6, 1.0, 0.0], [0.0, 0.0, 0.0], [1.2, 0.0, 0.0], end], dihedrals=[[0, 1, 2, 3]])
        found = float(calc_dihedrals(*system.positions))
        energy = md.evaluate(system, md.HarmonicImproper(2.0, 0.7, [[0, 1, 2, 3]])).potential_energy
        assert energy == pytest.approx(
            ((found - 0.7 + np.pi) % (2.0 * np.pi) - np.pi) ** 2, rel=1e-6
        )  # MDAnalysis computes in float32
        assert np.isfinite(md.evaluate(system, md.PeriodicDihedral(1.0, 3, 0.4)).forces).all()
    assert (
        np.abs(md.evaluate(system, md.PeriodicDihedral(1.0, 3)).forces).max() < 1e-14
    )  # trans, at the bottom: rounding
    straight = md.System([[-1.0, 0, 0], [0, 0, 0], [1, 0, 0], [1.5, 1, 0]], dihedrals=[[0, 1, 2, 3]])
    assert np.isfinite(md.evaluate(straight, md.PeriodicDihedral(1.0, 3, 0.4)).forces).all()


def test_a_broken_fene_bond_is_told_and_a_morse_bond_breaks():
    apart = md.System([[0, 0, 0], [1.5, 0, 0]], bonds=[[0, 1]])
    with pytest.raises(md.NonFiniteError, match="not finite"):
        md.evaluate(apart, md.FENEBond(30.0, 1.5))
    far = md.System([[0, 0, 0], [40.0, 0, 0]], bonds=[[0, 1]])
    assert md.evaluate(far, md.MorseBond(3.0, 2.0, 1.1)).potential_energy == pytest.approx(3.0, rel=1e-15)
    assert md.evaluate(far, md.MorseBond(3.0, 2.0, 1.1)).forces == pytest.approx(0.0, abs=1e-30)


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: md.MorseBond(1.0, 0.0, 1.0), "a of a Morse bond must be positive"),
        (lambda: md.FENEBond(-1.0, 1.5), "k of a FENE bond must not be negative"),
        (lambda: md.PeriodicDihedral(1.0, 1.5), "the number of minima in a turn, must be a whole number"),
        (lambda: md.RyckaertBellemans([1.0] * 7), "at most 6"),
        (lambda: md.HarmonicImproper(1.0, 4.0), "angle must lie between -pi and pi"),
        (
            lambda: md.evaluate(chain(None), md.PeriodicDihedral([1.0, 2.0], 1, 0.0, CHAINS)),
            "k must be one number or 7, one for each of the dihedrals",
        ),
        (lambda: md.PeriodicDihedral(1.0, 1, quadruples=[[0, 1, 2, 2]]), "quadruples must name different atoms"),
    ],
)
def test_impossible_bonds_and_dihedrals_are_refused(make, message):
    with pytest.raises(ValueError, match=message):
        make()


def test_bonds_in_any_order_keep_their_own_parameters():
    system = md.System([[0, 0, 0], [1.0, 0, 0], [2.1, 0, 0], [3.3, 0, 0]], bonds=[[2, 3], [1, 0], [1, 2]])
    k, length = np.array([10.0, 200.0, 3000.0]), np.array([1.0, 0.9, 1.2])
    distances = np.array([1.2, 1.0, 1.1])
    expected = (0.5 * k * (distances - length) ** 2).sum()
    assert md.evaluate(system, md.HarmonicBond(k, length)).potential_energy == pytest.approx(expected, rel=1e-13)


@pytest.mark.parametrize("cell", [3.0, [[2.9, 0, 0], [1.2, 3.0, 0], [-0.8, 0.9, 3.3]]])
def test_scaled_pairs_in_small_cells_equal_the_textbook_sum(cell):
    """All images of all pairs, but the nearest image of a bonded one is scaled."""
    rng = np.random.default_rng(12)
    vectors = md.Cell.of(cell).vectors
    positions = np.array([[0.1, 0.2, 0.3], [1.2, 0.4, 0.1], [1.4, 1.6, 0.5], [0.2, 1.5, 1.7]]) + 0.05 * rng.normal(
        size=(4, 3)
    )
    scale, cutoff, expected = (0.0, 0.3, 0.7), 4.0, 0.0
    for i, j in itertools.product(range(4), repeat=2):
        shifts = np.array(list(itertools.product(range(-4, 5), repeat=3))) @ vectors
        distances = np.sort(np.linalg.norm(positions[j] - positions[i] + shifts, axis=1))
        if i == j:
            distances = distances[1:]
        energies = np.where(distances < cutoff, 4.0 * (distances**-12 - distances**-6), 0.0)
        if i != j:
            energies[0] *= scale[abs(i - j) - 1]
        expected += 0.5 * energies.sum()
    system = md.System(positions, cell=vectors, bonds=[[0, 1], [1, 2], [2, 3]])
    result = md.evaluate(system, md.LennardJones(1.0, 1.0, cutoff, "truncated", bonded_scale=scale))
    assert result.potential_energy == pytest.approx(expected, rel=1e-12)


def test_two_atoms_alone_on_one_spot_are_named():
    with pytest.raises(md.NonFiniteError, match="atoms 0 and 1, 0 σ apart"):
        md.evaluate(md.System([[1, 1, 1], [1, 1, 1]]), md.LennardJones(1.0, 1.0, 2.0))


def test_two_atoms_on_one_spot_are_an_error_that_names_them():
    system = md.System([[0, 0, 0], [1, 1, 1], [2, 0, 0], [1, 1, 1]], cell=5.0)
    with pytest.raises(md.NonFiniteError, match="atoms 1 and 3, 0 σ apart"):
        md.evaluate(system, md.LennardJones(1.0, 1.0, 2.0))


def test_laws_of_the_user_are_tried_before_they_are_trusted():
    pair = md.System([[0, 0, 0], [1, 0, 0]])

    def forgets_the_r(r2, a):
        return a / r2, 2.0 * a / r2**1.5

    def returns_one(r2, a):
        return a / r2

    def pole(r2, a):
        return a / (r2 - 1.0), 2.0 * a / (r2 - 1.0) ** 2

    with pytest.raises(ValueError, match=r"at r = 1\.86 it returns 0\.3108\d+ where -u'\(r\)/r is 0\.1671\d+"):
        md.evaluate(pair, md.PairPotential(forgets_the_r, (1.0,), 2.0))
    with pytest.raises(TypeError, match=r"the law returns_one must .*return"):
        md.evaluate(pair, md.PairPotential(returns_one, (1.0,), 2.0))
    with pytest.raises(TypeError, match="the law pole must take r² and 0 parameters"):
        md.evaluate(pair, md.PairPotential(pole, (), 2.0))
    md.PairPotential(pole, (1.0,), 2.0).table(("X",))


def test_evaluate_takes_atoms_of_ase():
    from ase import Atoms

    atoms = Atoms("Ar2", [[0, 0, 0], [4, 0, 0]])
    expected = md.evaluate(md.System.from_ase(atoms), md.LennardJones(0.01, 3.4)).potential_energy
    assert md.evaluate(atoms, md.LennardJones(0.01, 3.4)).potential_energy == expected


def test_laws_run_as_plain_python_too():
    from minimd.potentials.pair_loop import SameForAll, add_pair_forces, fixed_pairs
    from minimd.potentials.term import TOTALS

    system = chain(None)
    pairs, _ = fixed_pairs(np.argwhere(np.triu(np.ones((10, 10)), k=1)), 10, periodic=False)
    for potential in (md.LennardJones(1.0, 1.0, CUTOFF, "switched"), md.PairPotential(yukawa, (1.0, 2.0), CUTOFF)):
        numbers = SameForAll(tuple(potential.table(("A", "B"))[0, 0].tolist()))
        forces, energies, virials = np.zeros((10, 3)), np.zeros(10), np.zeros((10, 6))
        add_pair_forces.py_func(system.positions, pairs, potential.law, numbers, TOTALS, (forces, energies, virials))
        result = md.evaluate(system, potential)
        assert forces == pytest.approx(result.forces, rel=1e-13, abs=1e-14)
        assert energies.sum() == pytest.approx(result.potential_energy, rel=1e-13)
