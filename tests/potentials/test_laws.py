"""Laws of forces that every potential obeys. POTENTIALS is where a new one is registered."""

import itertools
from functools import cache

import numba
import numpy as np
import pytest
from references import brute_force_pairs

import minimd as md
from minimd.core.potentials.term import PER_ATOM, TOTALS

CUTOFF = 2.3


def yukawa(r2, strength, kappa):
    r = np.sqrt(r2)
    u = strength / r * np.exp(-kappa * r)
    return u, u * (1.0 + kappa * r) / r2


@numba.njit
def soft_core(r2, height):
    u = height * np.exp(-r2)
    return u, 2.0 * u


def traveling_saddle(x, y, z, t, k):
    """Hills that move along z."""
    wave, slope = np.sin(z - 0.7 * t), np.cos(z - 0.7 * t)
    return k * (x * x - y * y) + wave, -2.0 * k * x, 2.0 * k * y, -slope, -0.7 * slope


R = np.linspace(0.3, CUTOFF, 60)
TABLES = {("A", "A"): np.exp(-R), ("A", "B"): np.exp(-2.0 * R), ("B", "B"): 1.0 / R}
TWO_KINDS, CUTOFFS = {"A": (1.0, 1.0), "B": (0.5, 0.88)}, {("A", "A"): 2.5, ("A", "B"): 2.0, ("B", "B"): 2.2}
CHAINS = [[k, k + 1, k + 2, k + 3] for k in range(7)]
MAPS = np.random.default_rng(3).normal(size=(2, 6, 6))
pytestmark = pytest.mark.filterwarnings("ignore:the charges of the atoms", "ignore:the net charge")
PAIRS = {
    "lennard-jones": md.LennardJones(1.0, 1.0, CUTOFF),
    "force-shifted": md.LennardJones(1.0, 1.0, CUTOFF, "force-shifted"),
    "mixture": md.LennardJones(TWO_KINDS, cutoff=CUTOFF),
    "kob-andersen": md.LennardJones(TWO_KINDS, cutoff=CUTOFFS, pairs={("A", "B"): (1.5, 0.8)}),
    "yukawa": md.PairPotential(yukawa, (2.0, 1.1), CUTOFF, "force-shifted"),
    "soft core": md.PairPotential(soft_core, (3.0,), CUTOFF),
    "mie": md.Mie(
        {"A": (1.0, 1.0, 14.0, 7.0), "B": (0.5, 0.9, 12.65, 6.0)},
        cutoff=CUTOFF,
        truncation="switched",
        pairs={("A", "B"): (0.8, 0.95, 13.0, 6.5)},
    ),
    "soft repulsion": md.SoftRepulsion({"A": (3.0,), "B": (1.0,)}, CUTOFFS, pairs={("A", "B"): (2.0,)}),
}
BONDED = {
    "scaled neighbors": md.LennardJones(TWO_KINDS, cutoff=CUTOFF, truncation="switched", bonded_scale=(0.0, 0.3, 0.7)),
    "tabulated": md.Tabulated(R, TABLES, truncation="switched", bonded_scale=(0.5, 1.0, 1.0)),
    "harmonic bonds": md.HarmonicBond(np.linspace(50, 90, 9), 1.1),
    "harmonic angles": md.HarmonicAngle(20.0, 2.0, [[k, k + 1, k + 2] for k in range(8)]),
    "morse bonds": md.MorseBond(np.linspace(3.0, 5.0, 9), 2.0, 1.1),
    "quartic bonds": md.QuarticBond(np.linspace(50, 90, 9), -120.0, 100.0, 1.05),
    "fene bonds": md.FENEBond(30.0, 1.9, 1.0, np.linspace(0.9, 1.2, 9)),
    "periodic dihedrals": md.PeriodicDihedral(np.linspace(0.5, 2.0, 7), [0, 1, 2, 3, 4, 5, 6], 0.4, CHAINS),
    "ryckaert-bellemans": md.RyckaertBellemans((1.3, 1.4, -1.6, -0.4, 3.1, -3.4), CHAINS),
    "harmonic impropers": md.HarmonicImproper(3.0, np.linspace(-3.1, 3.1, 7), CHAINS),
    "dihedral maps": md.DihedralMap(MAPS, CHAINS[:-1], CHAINS[1:], [0, 1, 0, 1, 1, 0]),
    "charges": md.Coulomb(1.75, 1e-7, bonded_scale=(0.0, 0.3, 1.0)),
    "reaction field": md.Coulomb(CUTOFF, method="reaction-field", bonded_scale=(0.5, 1.0, 0.5)),
    "charged": [md.LennardJones(TWO_KINDS, cutoff=1.6, bonded_scale=(0.0, 0.0, 0.5)), md.Coulomb(1.75, 1e-7)],
    "embedded atoms": md.EmbeddedAtom(
        "sutton-chen",
        {"A": (0.5, 1.0, 3.0, 8.0, 5.0), "B": (0.3, 1.1, 4.0, 9.0, 6.0)},
        CUTOFF,
        "switched",
        pairs={("A", "B"): (0.4, 1.05, 0.0, 8.5, 5.5)},
    ),
    "several": [PAIRS["lennard-jones"], PAIRS["yukawa"], md.HarmonicBond(30.0, 1.0)],
}
EVERYWHERE, STRENGTHS = ("open", "slab", "tube", "triclinic"), np.linspace(0.5, 1.0, 10)
FIELDS = {  # and where they may act: walls lie along the periodic directions
    "constant force": (md.ConstantForce([0.3, -0.2, 0.5], [0, 2]), EVERYWHERE),
    "gravity": (md.Gravity(2.0), EVERYWHERE),
    "restraint": (md.Restraint([3.0, 0.0, 2.0], [[0.8, 0.9, -0.3], [-0.6, 1.3, 0.2]], [1, 4]), EVERYWHERE),
    "steered": (md.SteeredSpring(3.0, [[0.2, 0.3, 0.1], [1.0, 0.0, 2.0]], [0.4, 0, 0], [3, 7]), EVERYWHERE),
    "wall 9-3": (md.Wall([0, 0, -0.8], [0, 0, 2.0], 1.3, 0.9, 2.0), ("open", "slab")),
    "wall 12-6": (md.Wall([0, 0, 4.7], [0, 0, -1.0], STRENGTHS, 0.8, 2.0, "12-6"), ("open", "slab")),
    "cylinder": (md.CylinderWall([0.1, 0.2, 0.3], [0, 0, 1], 2.1, 1.0, 0.7, 2.5, "12-6"), ("open", "tube")),
    "sphere": (md.SphereWall([0.1, 0.0, 1.9], 2.9, 1.0, 0.7), ("open", "triclinic")),
    "user's": (md.Field(traveling_saddle, (0.8,)), ("open",)),
}
POTENTIALS = PAIRS | BONDED | {name: field for name, (field, _) in FIELDS.items()}
CELLS = {
    "open": {}, "cube": {"cell": 4.7}, "triclinic": {"cell": [[4.6, 0, 0], [1.5, 4.4, 0], [-1.0, 0.7, 5.0]]},
    "left-handed": {"cell": [[0, 4.6, 0], [4.7, 0, 0], [0, 0, 4.8]]}, "small": {"cell": 3.6},
    "slab": {"cell": [4.7, 4.9, 9.0], "pbc": (True, True, False)},
    "tube": {"cell": [9.0, 9.0, 4.8], "pbc": (False, False, True)},
}  # fmt: skip
INSIDE = [*CELLS][:-1]
SLOW = {"soft core", "ryckaert-bellemans", "harmonic impropers", "wall 12-6", "cylinder"}  # the mechanism of another


def of(name):
    return pytest.mark.slow if name in SLOW else ()


OF_PAIRS = [pytest.param(*row, marks=of(row[0])) for row in itertools.product(PAIRS, INSIDE)]
NOT_THERE = [("reaction field", "open")]
OF_OTHERS = [row for row in itertools.product(BONDED, INSIDE) if row not in NOT_THERE]
INTERNAL = [*OF_PAIRS, *(pytest.param(*row, marks=of(row[0])) for row in OF_OTHERS)]
EXTERNAL = [pytest.param(name, cell, marks=of(name)) for name, (_, cells) in FIELDS.items() for cell in cells]


def chain(cell="open", bonded=True):
    """Ten atoms along a bent chain, 1 apart, of two species."""
    k = np.arange(10)
    places = np.column_stack([np.cos(k * 0.9), np.sin(k * 0.9), 0.36 * k]) * 1.15
    places += 0.05 * np.random.default_rng(4).normal(size=(10, 3))
    given = {"species": np.where(k % 3, "A", "B"), "masses": np.linspace(1.0, 2.0, 10)}
    given["charges"] = 3.0 * np.sin(k * k) - 0.2  # a net charge, too
    return md.System(places, bonds=np.column_stack([k[:-1], k[1:]]) if bonded else None, **given, **CELLS[cell])


def at(system, positions, cell=None, order=slice(None)):
    """The system at other positions, perhaps in another cell, its atoms perhaps in another order."""
    given = {name: getattr(system, name)[order] for name in ("species", "masses", "charges")}
    bonds = np.argsort(np.arange(10)[order])[system.bonds]
    return md.System(positions[order], cell=cell or system.cell, bonds=bonds, **given)


@cache
def scene(name, cell):
    """System, potential, and what is evaluated there."""
    system = chain(cell, bonded=name not in PAIRS)
    return system, POTENTIALS[name], md.evaluate(system, POTENTIALS[name])


@pytest.mark.parametrize(("name", "cell"), INTERNAL + EXTERNAL)
def test_force_is_minus_the_gradient(name, cell):
    (system, potential, found), h = scene(name, cell), 2e-6
    assert np.abs(found.forces).max() > 0.1
    for along in np.random.default_rng(1).normal(size=(4, 10, 3)):
        low, high = (md.evaluate(at(system, system.positions + s * along), potential) for s in (-h, h))
        slope = (low.potential_energy - high.potential_energy) / (2.0 * h)
        assert (found.forces * along).sum() == pytest.approx(slope, rel=1e-6, abs=2e-6)  # truncation h², rounding u/h


@pytest.mark.parametrize(("name", "cell"), INTERNAL + EXTERNAL)
def test_energy_and_virial_are_those_of_the_atoms(name, cell):
    system, potential, found = scene(name, cell)
    totals, of_atoms = (md.Forces(system, potential).compute(detail) for detail in (TOTALS, PER_ATOM))
    assert found.energies.sum() == pytest.approx(found.potential_energy, rel=1e-13, abs=1e-13)  # rounding
    assert totals.potential_energy == pytest.approx(of_atoms.energies.sum(), rel=1e-13, abs=1e-13)
    assert np.trace(totals.virial) == pytest.approx(of_atoms.virials[:, :3].sum(), rel=1e-12, abs=1e-12)
    assert totals.virial == pytest.approx(found.virial, rel=1e-12, abs=1e-12)
    shares = found.virials.sum(axis=0)[[[0, 5, 4], [5, 1, 3], [4, 3, 2]]]
    assert shares == pytest.approx(found.virial, rel=1e-12, abs=1e-12)


def test_atoms_of_a_term_have_equal_shares_of_its_virial():
    places = np.array([[0, 0, 0], [1.1, 0, 0], [1.5, 1.0, 0], [2.5, 1.2, 0.7]])
    angle, torsion = md.HarmonicAngle(3.0, 1.5, [[0, 1, 2]]), md.PeriodicDihedral(2.0, 2, 0.3, [[0, 1, 2, 3]])
    bond = md.HarmonicBond(5.0, 1.0)
    for potential, n in ((md.LennardJones(1.0, 1.0), 2), (bond, 2), (angle, 3), (torsion, 4)):
        found = md.evaluate(md.System(places[:n], bonds=[[0, 1]][: potential is bond]), potential)
        xx, yy, zz, yz, xz, xy = found.virials.T
        assert np.abs(found.virials).max() > 0.1
        for component, whole in ((xx, (0, 0)), (yy, (1, 1)), (zz, (2, 2)), (yz, (1, 2)), (xz, (0, 2)), (xy, (0, 1))):
            assert component == pytest.approx(np.full(n, found.virial[whole] / n), rel=1e-12, abs=1e-14)


def test_virials_of_charges_and_tails_add_up_to_that_of_all():
    system, potentials, _ = md.water("SPC/E", 27, cutoff=4.0, ions={"Na": 1, "Cl": 1})
    found = md.evaluate(system, potentials)
    shares = found.virials.sum(axis=0)[[[0, 5, 4], [5, 1, 3], [4, 3, 2]]]
    assert shares == pytest.approx(found.virial, abs=1e-12 * np.abs(found.virials).sum())  # rounding


@pytest.mark.parametrize(("name", "cell"), INTERNAL)
def test_forces_sum_to_zero_and_the_virial_is_the_strain_derivative_of_the_energy(name, cell):
    """W = −∂U/∂(strain) at zero strain, along some strains with nine components each."""
    (system, potential, found), h = scene(name, cell), 1e-6
    assert np.abs(found.forces.sum(axis=0)).max() < 1e-13 * np.abs(found.forces).sum()  # rounding
    for along in np.random.default_rng(2).normal(size=(4, 3, 3)):
        energies = []
        for strain in (np.eye(3) - h * along, np.eye(3) + h * along):
            strained = md.Cell.of(system.cell.vectors @ strain, system.cell.pbc)
            energies.append(md.evaluate(at(system, system.positions @ strain, strained), potential).potential_energy)
        slope = (energies[0] - energies[1]) / (2.0 * h)
        assert (found.virial * along).sum() == pytest.approx(slope, rel=1e-5, abs=1e-5)


@pytest.mark.parametrize(("name", "cell"), INTERNAL)
def test_nothing_depends_on_place_direction_or_order(name, cell):
    """Pair potentials neither on the numbers of the atoms; groups of the others name them."""
    (system, potential, found), rng = scene(name, cell), np.random.default_rng(0)
    rotation = np.linalg.qr(rng.normal(size=(3, 3)))[0]
    cells_away = rng.integers(-2, 3, (10, 3)) * system.cell.pbc
    order = rng.permutation(10) if name in PAIRS else slice(None)
    positions = (system.positions + cells_away @ system.cell.vectors + rng.normal(size=3)) @ rotation
    turned = md.Cell.of(system.cell.vectors @ rotation, system.cell.pbc)
    moved = md.evaluate(at(system, positions, turned, order), potential)
    assert moved.potential_energy == pytest.approx(found.potential_energy, rel=1e-11, abs=1e-11)
    assert moved.forces == pytest.approx(found.forces[order] @ rotation, rel=1e-10, abs=1e-10)
    assert moved.virial == pytest.approx(rotation.T @ found.virial @ rotation, rel=1e-10, abs=1e-10)
    assert moved.energies == pytest.approx(found.energies[order], rel=1e-10, abs=1e-10)


@pytest.mark.parametrize(("name", "cell"), OF_PAIRS)
def test_energy_of_pairs_is_the_sum_over_all_pairs_and_images(name, cell):
    system, potential, found = scene(name, cell)
    expected = 0.0
    for i, j, *shift in brute_force_pairs(system.positions, system.cell.vectors, system.cell.pbc, potential.cutoff):
        r = np.linalg.norm(system.positions[j] - system.positions[i] + np.array(shift) @ system.cell.vectors)
        expected += 0.5 * float(potential.pair_energy(r, system.species[i], system.species[j]))
    assert found.potential_energy == pytest.approx(expected, rel=1e-12)


@pytest.mark.parametrize("cell", ["cube", "triclinic", "left-handed"])
@pytest.mark.parametrize("name", ["mixture", "kob-andersen"])
def test_replicated_cell_has_replicated_energy(name, cell):
    one, potential, found = scene(name, cell)
    shifts = np.array(list(np.ndindex(2, 3, 1))) @ one.cell.vectors
    positions, species = (one.positions + shifts[:, None, :]).reshape(-1, 3), np.tile(one.species, 6)
    of_many = md.evaluate(md.System(positions, cell=one.cell.vectors * [[2], [3], [1]], species=species), potential)
    assert of_many.potential_energy == pytest.approx(6 * found.potential_energy, rel=1e-12)
    assert of_many.forces == pytest.approx(np.tile(found.forces, (6, 1)), rel=1e-11, abs=1e-11)
    assert of_many.virial == pytest.approx(6 * found.virial, rel=1e-12, abs=1e-11)


@pytest.mark.parametrize(("name", "cell"), EXTERNAL)
def test_fields_act_from_outside_and_on_all_images_alike(name, cell):
    """Without a virial; the energy in a constant force changes steadily as an atom is pulled through the cells."""
    system, field, found = scene(name, cell)
    assert not found.virial.any()
    if name not in ("gravity", "constant force"):
        away = np.random.default_rng(7).integers(-3, 4, (10, 3)) * system.cell.pbc
        moved = md.evaluate(at(system, system.positions + away @ system.cell.vectors), field)
        assert moved.forces == pytest.approx(found.forces, rel=1e-11, abs=1e-11)
        assert moved.energies == pytest.approx(found.energies, rel=1e-11, abs=1e-11)


@pytest.mark.parametrize("name", ["user's", "steered"])
def test_power_is_what_time_alone_does_to_the_energy(name):
    forces, energies, h = md.Forces(chain(), POTENTIALS[name]), [], 1e-5
    for forces.time in (0.3 - h, 0.3 + h, 0.3):
        energies.append(forces.compute(TOTALS).potential_energy)
    assert forces.powers[1] == pytest.approx((energies[1] - energies[0]) / (2.0 * h), rel=1e-7)  # truncation
    assert abs(forces.powers[1]) > 0.1
