"""Slabs of charges, by a sum over three periodic directions, against one over two (D. E. Parry, Surf. Sci. 49, 433)."""

import re
from functools import cache

import numpy as np
import pytest
from ase.build import bulk
from charged_scenes import rms
from scipy.special import erf, erfc, erfcx
from wrong_calls import answered

import minimd as md
from minimd.ase import Calculator
from minimd.core.potentials.term import PER_ATOM, TOTALS, VOIGT
from minimd.core.structure.errors import RangeError
from minimd.scene import load_scene

OPEN = None
HEIGHTS = (16.0, 21.0, 34.0, OPEN)
ACCURACY = 1e-6
SQUARE = np.diag([4.0, 4.0, 0.0])
OBLIQUE = np.array([[4.0, 0.0, 0.0], [1.3, 3.7, 0.0], [0.6, -0.4, 0.0]])
ORDERS = [2, 0, 1], [1, 2, 0], [0, 1, 2]  # of x, y, z, in which z comes to be x, y or z
ANY_ACCURACY = pytest.mark.filterwarnings("ignore:the empty space")


def waves_in_plane(z, k, alpha):
    """exp(kz) erfc(k/2α + αz), which overflows and is small at once."""
    x = 0.5 * k / alpha + alpha * z
    small = np.exp(-((0.5 * k / alpha) ** 2) - (alpha * z) ** 2)
    return np.where(x > 0.0, small * erfcx(np.maximum(x, 0.0)), np.exp(np.minimum(k * z, 0.0)) * erfc(x))


def two_dimensional_ewald(positions, charges, plane, alpha=1.1, reach=5.5):
    """Energy and forces of charges that repeat in the plane xy only, k_e = 1.  plane : (2, 2) of its vectors."""
    area, inverse = abs(np.linalg.det(plane)), np.linalg.inv(plane)
    apart, products = positions[:, None] - positions, charges[:, None] * charges
    z = apart[:, :, 2]
    energy, forces = -alpha / np.sqrt(np.pi) * (charges**2).sum(), np.zeros_like(positions)
    most = np.ceil(reach / alpha * np.linalg.norm(inverse, axis=0) + 1.0).astype(int)
    nearest = np.round(apart[:, :, :2] @ inverse) @ plane
    for step in np.array([*np.ndindex(*(2 * most + 1))]) - most:
        d = apart.copy()
        d[:, :, :2] += step @ plane - nearest
        r = np.linalg.norm(d, axis=-1)
        is_pair = (r > 0.0) & (r < reach / alpha)
        r = np.where(is_pair, r, 1.0)
        u = np.where(is_pair, products * erfc(alpha * r) / r, 0.0)
        f = (u + np.where(is_pair, products, 0.0) * 2.0 * alpha / np.sqrt(np.pi) * np.exp(-((alpha * r) ** 2))) / r**2
        energy += 0.5 * u.sum()
        forces += (f[:, :, None] * d).sum(axis=1)
    most = np.ceil(reach * alpha / np.pi * np.linalg.norm(plane, axis=1)).astype(int)
    for wave in np.array([*np.ndindex(*(2 * most + 1))]) - most:
        k = 2.0 * np.pi * inverse @ wave
        size = np.linalg.norm(k)
        if 0.0 < size < 2.0 * reach * alpha:
            up, down = waves_in_plane(z, size, alpha), waves_in_plane(-z, size, alpha)
            phase = apart[:, :, :2] @ k
            of_pairs = np.pi / (area * size) * products
            energy += 0.5 * (of_pairs * np.cos(phase) * (up + down)).sum()
            forces[:, :2] += (of_pairs * np.sin(phase) * (up + down)).sum(axis=1)[:, None] * k
            forces[:, 2] -= size * (of_pairs * np.cos(phase) * (up - down)).sum(axis=1)
    bell = np.exp(-((alpha * z) ** 2)) / (alpha * np.sqrt(np.pi))
    energy -= np.pi / area * (products * (z * erf(alpha * z) + bell)).sum()
    forces[:, 2] += 2.0 * np.pi / area * (products * erf(alpha * z)).sum(axis=1)
    return energy, forces


def places(n, thickness, seed=1, edge=4.0):
    """n points in a layer, not too close to each other, also through its sides."""
    rng, chosen = np.random.default_rng(seed), np.empty((0, 3))
    while len(chosen) < n:
        one = rng.random(3) * (edge, edge, thickness)
        d = chosen - one
        d[:, :2] -= edge * np.round(d[:, :2] / edge)
        if len(chosen) == 0 or np.linalg.norm(d, axis=1).min() > 0.55:
            chosen = np.vstack([chosen, one])
    return chosen


def dipoles():
    """16 dipoles, side by side."""
    feet = np.array([*np.ndindex(4, 4)], dtype=float)
    at = np.concatenate([np.insert(feet, 2, height, axis=1) for height in (0.0, 0.4)])
    return at, np.repeat([-1.0, 1.0], 16)


def ions(net=0.0):
    return places(24, 2.0), (-1.0) ** np.arange(24) + net


def walls():
    """Ions between a wall with a charge and one without."""
    feet = np.array([*np.ndindex(4, 4)], dtype=float)
    at = [places(10, 1.2) + np.array([0.0, 0.0, 0.7]), *(np.insert(feet, 2, height, axis=1) for height in (0.0, 2.6))]
    return np.concatenate(at), np.concatenate([np.full(10, -0.5), np.full(16, 0.5), np.full(16, 0.0)])


LAYERS = {
    "dipoles": (dipoles, SQUARE),
    "ions": (ions, SQUARE),
    "ions, oblique": (ions, OBLIQUE),
    "net charge": (lambda: ions(0.3), OBLIQUE),
    "walls": (walls, SQUARE),
}


@cache
def reference(name):
    layer, edges = LAYERS[name]
    at, charges = layer()
    return two_dimensional_ewald(at @ (edges / 4.0 + np.diag([0.0, 0.0, 1.0])), charges, edges[:2, :2])


def slab(name, height, up=0.0, axis=2, repeat=(1, 1), scatter=0):
    """A layer in a cell.  height : OPEN, or that of the cell.  up : by which it is moved.  axis : across it.
    scatter : lattice vectors, by which atoms are moved at random."""
    layer, edges = LAYERS[name]
    at, charges = layer()
    cell = edges * (height is not OPEN) + np.diag([0.0, 0.0, height or 0.0])
    cell[:2] = edges[:2]
    positions = at @ (edges / 4.0 + np.diag([0.0, 0.0, 1.0])) + (0.0, 0.0, up)
    steps = [(i, j, 0) for i in range(repeat[0]) for j in range(repeat[1])]
    positions = np.concatenate([positions + step @ cell for step in np.array(steps)])
    charges = np.tile(charges, len(steps))
    cell[:2] *= np.array(repeat)[:, None]
    positions += np.random.default_rng(2).integers(-scatter, scatter + 1, positions.shape) @ cell
    order = ORDERS[axis]
    cell = cell[order][:, order]
    return md.System(positions[:, order], cell=cell, charges=charges, masses=1.0)


def coulomb(axis=2, accuracy=ACCURACY, method="waves", cutoff=1.6):
    return md.Coulomb(cutoff, accuracy, method=method, slab="none" if axis is OPEN else "xyz"[axis])


@pytest.mark.parametrize("name", LAYERS)
@pytest.mark.parametrize("method", ["waves", "mesh"])
def test_energy_and_forces_are_those_of_a_sum_over_two_directions(name, method):
    """At any height of the cell, or where it is open, wherever the layer is, and however its atoms are wrapped."""
    energy, forces = reference(name)
    for height, up, axis in zip((*HEIGHTS, OPEN), (0.0, -1.1, 33.3, 0.7, -40.0), (2, 0, 1, 2, 0), strict=True):
        system = slab(name, height, up, axis, scatter=axis)
        found = md.evaluate(system, coulomb(OPEN if up == 0.7 else axis, method=method))
        turned = found.forces[:, np.argsort(ORDERS[axis])]
        assert rms(turned - forces) < ACCURACY * rms(forces)
        assert found.potential_energy == pytest.approx(energy, abs=ACCURACY * np.abs(found.energies).sum())
        assert found.energies.sum() == pytest.approx(found.potential_energy, abs=1e-9)
        assert found.forces.sum(axis=0) == pytest.approx(0.0, abs=1e-9 * rms(forces))


@ANY_ACCURACY
def test_a_sheet_of_dipoles_has_one_energy_at_all_heights():
    """Without slab -224.136, -223.171 and -222.447 eV."""
    feet = 5.0 * np.array([*np.ndindex(4, 4)], dtype=float)
    at = np.concatenate([np.insert(feet, 2, height, axis=1) for height in (-1.0, 0.0)])
    given = {"charges": np.repeat([-1.0, 1.0], 16), "masses": 1.0, "units": md.units.ASE}
    for height in (30.0, 60.0, 240.0):
        sheet = md.System(at, cell=[20.0, 20.0, height], **given)
        energy = md.evaluate(sheet, md.Coulomb(9.0, 1e-7, slab="z")).potential_energy
        assert energy == pytest.approx(-222.20593, abs=1e-5)


def test_an_open_cell_is_higher_than_the_cutoff():
    """Of pairs, of which the waves have images, too."""
    energy, forces = reference("ions")
    found = md.evaluate(slab("ions", OPEN), md.Coulomb(6.0, 0.02))
    assert found.potential_energy == pytest.approx(energy, rel=1e-3)
    assert rms(found.forces - forces) < 0.01 * rms(forces)


@ANY_ACCURACY
@pytest.mark.parametrize("height", [6.0, OPEN])
@pytest.mark.parametrize("method", ["waves", "mesh"])
@pytest.mark.parametrize("name", ["ions, oblique", "net charge"])
def test_forces_are_the_gradient_and_the_virial_is_that_of_strain(name, method, height):
    """By differences, in an open cell, or in one so low that images act; shares of atoms add up."""
    system = slab(name, height)
    forces = md.Forces(system, coulomb(accuracy=1e-9, method=method))
    way = np.random.default_rng(3).normal(size=(24, 3))
    here, cell = system.positions.copy(), system.cell.vectors.copy()
    sums = forces.compute(PER_ATOM)
    assert sums.virials.sum(axis=0)[[0, 1, 2, 3]] == pytest.approx(sums.virial[(0, 1, 2, 1), (0, 1, 2, 2)], abs=1e-9)
    slope, virial = -(sums.forces * way).sum(), sums.virial.copy()

    def energy(step=0.0, strain=0.0):
        system.positions[:] = (here + step * way) @ (np.eye(3) + strain)
        system.cell = md.Cell.of(cell @ (np.eye(3) + strain), system.cell.pbc)
        if height is not OPEN:
            forces.follow()
        return forces.compute(TOTALS).potential_energy

    assert (energy(1e-5) - energy(-1e-5)) / 2e-5 == pytest.approx(slope, rel=1e-6)
    for a, b in ((0, 0), (1, 1), (2, 2), (1, 2), (0, 2), (0, 1)):
        strain = np.zeros((3, 3))
        strain[a, b] += 0.5e-5
        strain[b, a] += 0.5e-5
        by_strain = -(energy(strain=strain) - energy(strain=-strain)) / 2e-5
        assert virial[a, b] == pytest.approx(by_strain, abs=1e-6 * np.abs(virial).max())


def test_a_cell_that_repeats_along_the_layer_has_the_same_energy_for_each_atom():
    one = md.evaluate(slab("net charge", 30.0), coulomb())
    two = md.evaluate(slab("net charge", 30.0, repeat=(2, 1)), coulomb(accuracy=1e-6))
    assert two.energies[:24] == pytest.approx(one.energies, abs=1e-5)
    assert two.forces[24:] == pytest.approx(one.forces, abs=1e-4)


def film(height=30.0, n=27):
    """Rigid water: a block of the liquid between vacuum.  height : of the cell, or OPEN."""
    system, potentials, rigid = md.water("SPC/E", n, cutoff=4.3)
    edge = system.cell.vectors[0, 0]
    parts = {name: getattr(system, name) for name in ("masses", "charges", "species", "bonds", "units")}
    taller = md.System(system.positions, cell=[edge, edge, height or 0.0], **parts)
    without_tail = md.LennardJones(**potentials[0].arguments() | {"tail_correction": False})
    return taller, [without_tail, md.Coulomb(4.3, 1e-5, slab="z")], rigid


@pytest.mark.filterwarnings("ignore:no potential uses the charges")
@pytest.mark.parametrize("n", [27, 32])
def test_water_has_the_energy_and_the_forces_of_a_sum_over_two_directions(n):
    """Less that of pairs in a molecule; with Lennard-Jones in the same pass."""
    system, potentials, _ = film(n=n)
    k_e = system.units.coulomb
    energy, forces = two_dimensional_ewald(system.positions, system.charges, system.cell.vectors[:2, :2], alpha=0.5)
    energy, forces = k_e * energy, k_e * forces
    for molecule in np.arange(3 * n).reshape(n, 3):
        for i, j in ((0, 1), (0, 2), (1, 2)):
            a, b = molecule[[i, j]]
            apart = system.positions[a] - system.positions[b]
            r = np.linalg.norm(apart)
            u = k_e * system.charges[a] * system.charges[b] / r
            energy -= u
            forces[[a, b]] -= np.outer([1.0, -1.0], u / r**2 * apart)
    beside = md.evaluate(system, potentials[0])
    for height in (31.0, 40.0, 62.0, OPEN):
        found = md.evaluate(film(height, n)[0], potentials)
        assert rms(found.forces - beside.forces - forces) < 1e-5 * rms(forces)
        assert found.potential_energy - beside.potential_energy == pytest.approx(energy, rel=1e-5)


def test_the_energy_is_the_same_whatever_the_open_slab_has_been():
    """To the bit: it becomes thicker by a molecule that leaves it, and thin again."""
    system, potentials, _ = film(OPEN)
    forces = md.Forces(system, potentials)
    here, n_versions, seen = system.positions.copy(), set(), []
    for up in (0.0, 1.0, 25.0, 90.0, -90.0, 0.0, 25.0):
        system.positions[:] = here
        system.positions[:3, 2] += up
        seen.append(forces.compute(TOTALS).potential_energy)
        n_versions.add(forces.version())
        assert seen[-1] == pytest.approx(md.evaluate(system, potentials).potential_energy, rel=1e-9)
        if abs(up) == 90.0:  # a dipole far from a layer: the mean of the field of the layer is zero
            alone = md.evaluate(system, potentials).forces[:3].sum(axis=0)
            assert np.abs(alone).max() < 1e-5 * rms(forces.forces)
    assert (seen[5], seen[6]) == (seen[0], seen[2])
    assert len(n_versions) > 4
    system.positions[:3, 2] += 1e7
    for _ in range(2):
        with pytest.raises(RangeError, match="walls"):
            forces.compute(TOTALS)
    system.positions[:] = here
    assert forces.compute(TOTALS).potential_energy == seen[0]


def test_molecules_that_are_cut_by_faces_or_move_through_them_have_the_same_energy():
    """The layer lies across the face of the cell; and one molecule, alone, on the other side of the vacuum."""
    system, potentials, _ = film()
    whole = md.evaluate(system, potentials)
    for up in (-2.0, 13.0):
        system.positions[:] = system.cell.wrapped(system.positions + np.array([0.0, 0.0, up]))
        cut = md.evaluate(system, potentials)
        assert cut.potential_energy == pytest.approx(whole.potential_energy, rel=1e-9)
        assert cut.forces == pytest.approx(whole.forces, abs=1e-6)
    system.positions[:3] += np.array([0.0, 0.0, 14.0]) - system.positions[0]
    there = md.evaluate(system, potentials).potential_energy
    system.positions[:3, 2] -= 30.0
    assert md.evaluate(system, potentials).potential_energy == pytest.approx(there, rel=1e-9)


SALT_FILM = """
[structure]
file = "film.xyz"
cell_A = [11.28, 11.28, 0.0]
pbc = [true, true, false]
charges = { Na = 1.0, Cl = -1.0 }
[[potential]]
type = "coulomb"
cutoff_A = 5.0
[dynamics]
timestep_fs = 1.0
steps = 1
"""


def test_ase_and_scenes_have_the_same_open_slab(tmp_path):
    """The stress is −W/V, V that of the cell that the atoms are given."""
    atoms = bulk("NaCl", "rocksalt", a=5.64, cubic=True) * (2, 2, 1)
    atoms.rattle(0.1, seed=1)
    atoms.set_initial_charges(np.where(atoms.numbers == 11, 1.0, -1.0))
    atoms.pbc = 1, 1, 0
    atoms.write(tmp_path / "film.xyz")
    (tmp_path / "scene.toml").write_text(SALT_FILM)
    found = md.evaluate(md.System.from_ase(atoms), md.Coulomb(5.0))
    atoms.calc = Calculator(md.Coulomb(5.0))
    assert atoms.get_potential_energy() == pytest.approx(found.potential_energy, rel=1e-9)
    assert atoms.get_forces() == pytest.approx(found.forces, abs=1e-9)
    stress = -found.virial[VOIGT] / atoms.get_volume()
    assert atoms.get_stress() == pytest.approx(stress, abs=1e-12)
    sim = load_scene(tmp_path / "scene.toml").simulation()
    assert sim.potential_energy == pytest.approx(found.potential_energy, rel=1e-6)  # digits of the file


@ANY_ACCURACY
@pytest.mark.parametrize("height", [30.0, OPEN])
def test_threads_and_restarts_change_no_bit(height, tmp_path):
    """Nor does a molecule that leaves the layer."""

    def made(threads):
        system, potentials, rigid = film(height)
        system.velocities[:, 2] = 12.0 / 26.0
        system.velocities[:3, 2] = -12.0  # 12 Å in 20 steps
        return md.Simulation(system, potentials, md.VelocityVerlet(0.5 * md.units.fs), rigid, threads=threads)

    def n_waves(sim):
        return re.search(r"\d+ waves|\d+ points", sim.engine.interactions.pair_search)[0]

    one, two = made(1), made(2)
    one.run(0)
    at_start = n_waves(one)
    record = one.run(20, every=10)
    assert (n_waves(one) != at_start) == (height is OPEN)
    assert np.array_equal(two.run(20, every=10).total_energy, record.total_energy)
    assert np.array_equal(two.positions, one.positions)
    again = made(1)
    again.run(10, trajectory=tmp_path / "film.h5md", every=10)
    resumed = md.Simulation.resume(tmp_path / "film.h5md", film(height)[1])
    resumed.run(10, every=10)
    assert np.array_equal(resumed.positions, one.positions)
    assert "slab across z" in one.engine.interactions.pair_search


@pytest.mark.slow
@pytest.mark.parametrize("height", [30.0, OPEN])
def test_a_film_of_water_keeps_its_energy(height):
    """0.5 ps: no drift, and oscillations as in bulk."""
    system, potentials, rigid = film(height)
    sim = md.Simulation(system, potentials, md.VelocityVerlet(1.0 * md.units.fs), rigid)
    sim.minimize(force_tolerance=0.1)
    sim.set_temperature(250.0, seed=1)
    sim.run(100)
    record = sim.run(500, every=10)
    slope = np.polyfit(record.time, record.total_energy, 1)[0] * np.ptp(record.time)
    assert abs(slope) / len(system) < 1e-5
    assert np.ptp(record.total_energy) / len(system) < 3e-5
    assert np.ptp(record.potential_energy) / len(system) > 1e-3
    assert np.ptp(record.momentum, axis=0) == pytest.approx(0.0, abs=1e-9)


def test_a_slab_that_fills_its_cell_is_told_and_refused():
    with pytest.warns(UserWarning, match=r"9\.24 σ wide for an accuracy of 1e-06; it is 0\."):
        md.evaluate(slab("ions", 2.1), coulomb(cutoff=1.0))
    line = np.tile(np.linspace(0.0, 2.0, 600, endpoint=False)[:, None], 3)
    full = md.System(line, cell=2.0, charges=(-1.0) ** np.arange(600))
    with pytest.warns(UserWarning, match="empty space"), pytest.raises(md.NonFiniteError, match="empty space"):
        md.evaluate(full, coulomb(cutoff=0.9))


def too_thick():
    system = slab("ions", OPEN)
    system.positions[3, 2] = 1e8
    return md.evaluate(system, coulomb())


def with_slab(slab="z", pbc=True, method="ewald"):
    return md.evaluate(
        md.System(places(8, 2.0), cell=[4.0, 4.0, 20.0], pbc=pbc, charges=(-1.0) ** np.arange(8)),
        md.Coulomb(1.9, method=method, slab=slab),
    )


test_what_cannot_be_done_is_refused = answered(
    (lambda: md.Coulomb(2.0, slab="c"), ValueError, "slab", "'c'"),
    (lambda: with_slab(method="shifted-force"), ValueError, "slab", "shifted-force"),
    (lambda: with_slab(slab="x", pbc=(True, True, False)), ValueError, "periodic", "slab"),
    (too_thick, RangeError, "1e+08", "slab"),
    (lambda: with_slab(slab="none", pbc=(True, False, False)), ValueError, "periodic", "slab"),
    (lambda: with_slab(pbc=False), ValueError, "periodic", "slab"),
    (
        lambda: md.Simulation(slab("ions", 21.0), coulomb(), md.VelocityVerlet(0.01), precision="fixed-point"),
        ValueError,
        "fixed-point",
        "slab",
    ),
)
