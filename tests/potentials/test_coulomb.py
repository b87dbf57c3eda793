"""Coulomb's law: sums over all images against closed sums of crystals, a Gaussian Ewald sum, NIST; what is refused."""

import json
from itertools import product
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pytest
from charged_scenes import CRYSTALS, OTHER_CRYSTALS, crystal, ewald, rms, salt
from scipy.special import erfc
from wrong_calls import answered

import minimd as md
from minimd.core.forces import pair_laws
from minimd.core.forces.options import Options
from minimd.core.forces.pair_laws import PairLaws
from minimd.core.potentials.coulomb import ChargedLaw
from minimd.core.potentials.prolates import error_of, prolate, split_for
from minimd.core.potentials.term import PER_ATOM, TOTALS
from minimd.core.structure.units import ASE, BOLTZMANN_EV_PER_K, COULOMB, KJ_PER_MOL_PER_EV
from minimd.scene.water import IONS

SHEAR = ((1, 0, 0), (1, 1, 0), (0, -1, 1))
TRICLINIC = ((1.0, 0.0, 0.0), (0.4, 1.1, 0.0), (-0.3, 0.2, 1.0))
NIST = json.loads((Path(__file__).parents[1] / "data" / "nist_spce" / "config1.json").read_text())
SCENES = {
    "salt": lambda: salt(2), "molten": lambda: salt(2, disorder=0.3), "triclinic": lambda: salt(2, cell=TRICLINIC),
    "slab of charge": lambda: salt(2, np.diag([1.0, 1.0, 3.0]), charges=lambda places: np.sign(places[:, 2] - 1.5)),
    "net charge": lambda: salt(2, charges=lambda places: 0.3 + (-1.0) ** places.sum(axis=1)),
}  # fmt: skip
WRONG = [
    (lambda: md.Coulomb(-1.0), "cutoff"), (lambda: md.Coulomb(9.0, 1e-20), "accuracy", "1e-20", "1e-13"),
    (lambda: md.Coulomb(9.0, 0.5), "accuracy", "0.5"),
    (lambda: md.Coulomb(9.0, method="pme"), "method", "pme", "ewald"),
    (lambda: md.Coulomb(9.0, bonded_scale=(0, 1)), "bonded_scale"),
    (lambda: md.System(np.zeros((2, 3)), charges=[1.0]), "charges", "2"),
    (lambda: md.System(np.eye(3), charges=[1.0, np.nan, 0.0]), "charges", "nan"),
    (lambda: md.evaluate(md.System(np.eye(3), cell=5.0), md.Coulomb(2.0)), "charges", "zero"),
    (lambda: md.evaluate(md.System(np.eye(3), cell=5.0, charges=[1, 1, -2]), md.Coulomb()), "cutoff"),
    (lambda: md.evaluate(md.System(np.eye(3), cell=5.0, pbc=(1, 0, 0), charges=[1, 1, -2]), md.Coulomb(2.0)),
     "periodic", "shifted-force"),
    (lambda: md.evaluate(salt(1), md.Coulomb(0.9, 1e-13, method="mesh")), "waves", "1e-13"),
    (lambda: md.Simulation(salt(1), md.Coulomb(0.9, method="mesh"), md.VelocityVerlet(0.1), precision="fixed-point"),
     "fixed-point", "waves"),
    (lambda: md.water("TIP5P"), "TIP5P", "SPC/E"), (lambda: md.water(n=0), "n"),
    (lambda: md.water("OPC3", ions={"Na": 1}), "ions", "'OPC3'", "'TIP3P'"),
    (lambda: md.water(ions={"Mg": 1}), "ions", "'Mg'"), (lambda: md.water(ions={"Na": -1}), "ions['Na']", "-1"),
]  # fmt: skip
ON_ONE_SPOT = md.System(np.zeros((2, 3)), cell=5.0, charges=[1.0, -1.0])
test_what_cannot_be_done_is_refused = answered(
    *((call, ValueError, *words) for call, *words in WRONG),
    (lambda: md.evaluate(ON_ONE_SPOT, md.Coulomb(2.0)), md.NonFiniteError, "atom"),
)


@pytest.mark.parametrize("accuracy", [1e-4, 1e-8, 1e-13])
@pytest.mark.parametrize("shear", [np.eye(3, dtype=int), SHEAR], ids=["cube", "sheared"])
@pytest.mark.parametrize("name", CRYSTALS)
def test_crystals_have_their_madelung_energies(name, shear, accuracy):
    system, n, expected = crystal(name, shear=shear)
    for method in ("waves", "mesh")[: 1 + (accuracy > 1e-12)]:
        found = md.evaluate(system, md.Coulomb(1.3, accuracy, method=method))
        assert found.potential_energy / n == pytest.approx(expected, rel=accuracy, abs=0.0)
        assert np.abs(found.forces).max() < max(1e-13, accuracy)  # each ion is in a center of symmetry


@pytest.mark.parametrize("name", SCENES)
def test_the_accuracy_that_was_asked_for_is_reached(name):
    """Never above, and not much below: of the rms force, against a converged sum over Gaussians."""
    system = SCENES[name]()
    energy, forces = ewald(system.positions, system.charges, system.cell.vectors, 1.6, 5.5)
    for accuracy, method in product((1e-3, 1e-5, 1e-6, 1e-8, 1e-10), ("waves", "mesh")):
        with pytest.warns(UserWarning, match="net charge") if name == "net charge" else np.errstate():
            found = md.evaluate(system, md.Coulomb(1.9, accuracy, method=method))
        assert 0.01 < rms(found.forces - forces) / rms(forces) / accuracy < 1.0
        assert found.potential_energy == pytest.approx(energy, rel=accuracy)


@pytest.mark.parametrize("method", ["waves", "mesh"])
@pytest.mark.parametrize("name", ["CsCl", *(pytest.param(name, marks=pytest.mark.slow) for name in OTHER_CRYSTALS)])
def test_in_crystals_the_accuracy_is_that_of_the_force_between_neighbors(name, method):
    """Forces cancel there, and their errors do not."""
    perfect, _, _ = crystal(name, 2 if name == "CaF2" else 3)
    edge, charges = perfect.cell.vectors[0, 0], perfect.charges
    apart = perfect.positions - perfect.positions[0]
    distances = np.linalg.norm(apart - edge * np.round(apart / edge), axis=1)
    nearest = 1 + int(np.argmin(distances[1:]))
    between_neighbors = abs(charges[0] * charges[nearest]) / distances[nearest] ** 2
    for displacement in (1e-6, 1e-4, 1e-2, 1e-1):
        off = np.random.default_rng(1).normal(0.0, displacement / 3.0**0.5, perfect.positions.shape)
        system = md.System(perfect.positions + off, cell=edge, charges=charges)
        exact = md.evaluate(system, md.Coulomb(0.49 * edge, 1e-13, method="waves")).forces
        for accuracy in (1e-3, 1e-5, 1e-8, 1e-10):
            forces = md.evaluate(system, md.Coulomb(0.4 * edge, accuracy, method=method)).forces
            assert rms(forces - exact) < accuracy * max(rms(exact), between_neighbors), (displacement, accuracy)


@pytest.mark.parametrize("method", ["waves", "mesh"])
def test_energies_of_single_ions_in_a_charged_cell_do_not_depend_on_the_cutoff(method):
    """The background belongs to each ion as its charge times that of the cell."""
    rng = np.random.default_rng(5)
    edges = np.array([[9.0, 0.0, 0.0], [1.0, 8.0, 0.0], [0.5, -1.0, 10.0]])
    charges = (-1.0) ** np.arange(40) + 0.2
    system = md.System(rng.random((40, 3)) @ edges, cell=edges, charges=charges)
    near, far = (md.evaluate(system, md.Coulomb(cutoff, 1e-9, method=method)) for cutoff in (2.5, 3.6))
    assert near.energies.sum() == pytest.approx(near.potential_energy, rel=1e-12)  # rounding
    assert np.abs(near.energies - far.energies).max() < 1e-7 * np.abs(far.energies).max()  # accuracy


def test_a_split_joins_its_parts_smoothly_and_waves_of_its_rest_are_those_of_its_bound():
    """L and L′ at the cutoff are those of 1/r; L̂(k) is the integral of L (its derivative by difference)."""
    split = split_for(2.0, 1e-6)
    scale, values, slopes = split.numbers
    assert np.polyval(values[::-1], 1.0) == pytest.approx(0.5, rel=1e-9)
    assert np.polyval(slopes[::-1], 1.0) == pytest.approx(-0.125, rel=1e-6)
    assert error_of(split.bandwidth) == pytest.approx(1e-6, rel=5e-3)
    assert np.polyval(values[::-1], -1.0) == split.at_zero
    # ∫ (1/r − L) exp(ik·r) d³r = 4π/k² − L̂(k), and without the wave
    x, w = np.polynomial.legendre.leggauss(200)
    r = x + 1.0
    short = r * (1.0 - r * np.polyval(values[::-1], scale * r * r - 1.0))
    assert 4.0 * np.pi * (w * short).sum() == pytest.approx(split.moment, rel=1e-9)
    for k in (0.5, 3.0, 7.0):
        of_short = 4.0 * np.pi / k * (w * short / r * np.sin(k * r)).sum()
        (low, found, high), (_, slope, _) = split.spectrum(k * k + np.array([-1e-5, 0.0, 1e-5]))
        assert 4.0 * np.pi / k**2 - of_short == pytest.approx(found, rel=1e-6, abs=1e-9)
        assert slope == pytest.approx((high - low) / 2e-5, rel=1e-6)
    assert prolate(10.0).series[0] == 1.0


def nist_water():
    """Configuration 1 of NIST's SPC/E water, molecules whole, and its potentials with NIST's numbers."""
    positions = np.array(NIST["rows"])
    n, first = len(positions) // 3, 3 * np.arange(len(positions) // 3)[:, None]
    bonds = (first[:, :, None] + [[0, 1], [0, 2]]).reshape(-1, 2)
    given = {"charges": [-0.8476, 0.4238, 0.4238] * n, "species": ["O", "H", "H"] * n, "masses": 1.0, "bonds": bonds}
    return md.System(positions, cell=20.0, units=ASE, **given)


def test_spce_of_nist_by_parts_and_against_a_converged_sum():
    """NIST's Gaussian parts, with its own few waves, by six digits; the total of a converged sum to 1e-10."""
    system = nist_water()
    q, box, alpha, kelvin = system.charges, 20.0, 5.6 / 20.0, COULOMB / BOLTZMANN_EV_PER_K
    r = system.positions[:, None] - system.positions
    r = np.sqrt(((r - box * np.round(r / box)) ** 2).sum(axis=-1))
    own = np.arange(len(q)) // 3 == np.arange(len(q))[:, None] // 3
    inside, products = np.where(own, 1.0, r), np.where(own, 0.0, np.outer(q, q))
    real = 0.5 * np.where(r < 10.0, products * erfc(alpha * inside) / inside, 0.0).sum()
    assert real * kelvin == pytest.approx(NIST["expected"]["Ereal"], rel=2e-6)
    assert -alpha / np.sqrt(np.pi) * (q**2).sum() * kelvin == pytest.approx(NIST["expected"]["Eself"], rel=2e-6)
    bonded = own & (r > 0.0)
    within = np.where(bonded, r, 1.0)
    smooth = 0.5 * np.where(bonded, np.outer(q, q) * (1.0 - erfc(alpha * within)) / within, 0.0).sum()
    assert -smooth * kelvin == pytest.approx(NIST["expected"]["Eintra"], rel=2e-6)
    total, _forces = ewald(system.positions, q, system.cell.vectors, 0.35)
    excluded = 0.5 * np.where(bonded, np.outer(q, q) / within, 0.0).sum()
    found = md.evaluate(system, md.Coulomb(9.0, 1e-11))
    assert found.potential_energy == pytest.approx(COULOMB * (total - excluded), rel=1e-10)
    assert found.energies.sum() == pytest.approx(found.potential_energy, rel=1e-13)


def test_charges_and_another_law_are_one_pass_on_both_lists_and_any_number_of_threads(monkeypatch):
    """Also where the other law reaches farther, and then takes a pass of its own."""
    system = salt(4, disorder=0.15)
    for cutoff, is_one, method in ((2.0, True, "waves"), (2.4, False, "waves"), (2.0, True, "mesh")):
        charges = md.Coulomb(2.2, method=method)
        lj = md.LennardJones({"Na": (0.1, 0.7), "Cl": (0.2, 0.9)}, cutoff=cutoff)
        alone = [md.evaluate(system, one) for one in (lj, charges)]
        one, other = (md.Forces(system, [lj, charges], Options(threads=threads)) for threads in (1, 2))
        sums, by_two = (forces.compute(TOTALS) for forces in (one, other))
        assert [words for words in ("cluster list", method) if words not in one.pair_search] == []
        assert isinstance(one.terms[0]._pair_laws.members[0].law, ChargedLaw) == is_one
        assert np.array_equal(sums.forces, by_two.forces)
        assert sums.potential_energy == by_two.potential_energy
        with monkeypatch.context() as patched:
            patched.setattr(PairLaws, "fit_clusters", lambda *_: False)
            listed = md.evaluate(system, [lj, charges])
        for found in (sums, listed):
            assert found.forces == pytest.approx(alone[0].forces + alone[1].forces, rel=1e-12, abs=1e-12)
            expected = alone[0].potential_energy + alone[1].potential_energy
            assert found.potential_energy == pytest.approx(expected, rel=1e-12)
            assert found.virial == pytest.approx(alone[0].virial + alone[1].virial, rel=1e-11, abs=1e-11)


def test_an_open_scene_has_all_pairs_and_laws_of_pairs_have_their_formulas():
    rng = np.random.default_rng(5)
    positions, charges = rng.random((40, 3)) * 6.0, rng.normal(size=40)
    distances = np.linalg.norm(positions[:, None] - positions, axis=-1)[np.triu_indices(40, 1)]
    products = np.outer(charges, charges)[np.triu_indices(40, 1)]
    system = md.System(positions, charges=charges)
    for coulomb in (md.Coulomb(), md.Coulomb(2.0)):
        assert md.evaluate(system, coulomb).potential_energy == pytest.approx((products / distances).sum(), rel=1e-13)
    near = distances < 2.0
    field = products * (1.0 / distances + distances**2 / 16.0 - 0.75)
    shifted = products * (1.0 / distances - 1.0 + 0.25 * distances)
    for method, expected in (("reaction-field", field), ("shifted-force", shifted)):
        found = md.evaluate(system, md.Coulomb(2.0, method=method))
        assert found.potential_energy == pytest.approx(expected[near].sum(), rel=1e-13)


def test_fixed_point_arithmetic_keeps_momentum_and_returns_with_charges():
    system = salt(2, disorder=0.05)
    system.velocities = np.random.default_rng(1).normal(size=(64, 3)) * 0.3
    laws = [md.LennardJones(0.3, 0.8, cutoff=1.8, truncation="switched"), md.Coulomb(1.9)]
    made = lambda **how: md.Simulation(system.copy(), laws, md.VelocityVerlet(0.01), **how)  # noqa: E731
    sims = [made(precision="fixed-point", threads=threads) for threads in (1, 2)] + [made(threads=1)]
    sims[0].make_steps(0)
    start, grid = sims[0].positions.copy(), sims[0].engine.interactions.grid
    records = [sim.run(60, every=20) for sim in sims]
    momenta = np.rint(sims[0].system.masses[:, None] * sims[0].velocities / grid.momentum).sum(axis=0)
    assert np.array_equal(records[0].momentum, np.repeat(records[0].momentum[:1], 4, axis=0))
    assert np.array_equal(momenta * grid.momentum, records[0].momentum[0])
    assert np.array_equal(sims[0].positions, sims[1].positions)
    assert sims[0].positions == pytest.approx(sims[2].positions, abs=1e-9)
    sims[0].run_back(60)
    assert np.array_equal(sims[0].positions, start)


@pytest.mark.parametrize("method", ["waves", "mesh"])
def test_the_sum_follows_the_cell(method):
    """As the barostat strains it: the same as a new scene in that cell, as long as waves have room, and beyond."""
    system, coulomb = salt(cell=TRICLINIC), md.Coulomb(1.9, 1e-10 if method == "mesh" else 1e-5, method=method)
    forces = md.Forces(system, coulomb)
    forces.compute(TOTALS)  # in the first cell
    for stretch in (1.01, 1.05, 1.3, 0.8):
        system.positions[:] *= stretch
        system.cell = md.Cell.of(system.cell.vectors * stretch)
        forces.follow()
        sums, anew = forces.compute(TOTALS), md.Forces(system, coulomb).compute(TOTALS)
        assert sums.potential_energy == pytest.approx(anew.potential_energy, rel=1e-12)
        assert sums.forces == pytest.approx(anew.forces, rel=1e-10, abs=1e-11)
        assert sums.virial == pytest.approx(anew.virial, rel=1e-10, abs=1e-10)
        assert anew.forces.sum(axis=0) == pytest.approx(0.0, abs=1e-12)


def test_forces_of_a_coarse_mesh_are_the_gradient_of_its_energy_and_its_virial_that_of_the_cell():
    """By differences; also shares of atoms add up. Forces lack their sum: the center of mass stays where it is."""
    system, way = salt(cell=TRICLINIC), np.random.default_rng(3).normal(size=(216, 3))
    forces, here = md.Forces(system, md.Coulomb(1.9, 1e-2, method="mesh")), system.positions.copy()
    sums = forces.compute(PER_ATOM)
    slope, virial = -(sums.forces * (way - way.mean(axis=0))).sum(), np.trace(sums.virial)
    assert sums.energies.sum() == pytest.approx(sums.potential_energy, rel=1e-13)
    assert sums.virials.sum(axis=0)[:3].sum() == pytest.approx(virial, rel=1e-12)
    energies = []
    for step, stretch in ((-1e-5, 1.0), (1e-5, 1.0), (0.0, 1.0 - 1e-5), (0.0, 1.0 + 1e-5)):
        system.positions[:] = stretch * (here + step * (way - way.mean(axis=0)))
        system.cell = md.Cell.of(6.0 * stretch * np.array(TRICLINIC))
        forces.follow()
        energies.append(forces.compute(TOTALS).potential_energy)
    assert (energies[1] - energies[0]) / 2e-5 == pytest.approx(slope, rel=1e-7)
    assert (energies[2] - energies[3]) / 2e-5 == pytest.approx(virial, rel=1e-6)


@pytest.mark.parametrize("name", ["SPC/E", "TIP3P", "OPC3"])
def test_water_by_name_is_rigid_neutral_and_has_its_density(name):
    with pytest.warns(UserWarning, match=r" 4\.63 Å"):  # of a box so small
        system, potentials, rigid = md.water(name, np.uint64(40), density=1.1)
    assert system.charges.sum() == pytest.approx(0.0, abs=1e-12)
    assert system.masses.sum() / system.volume == pytest.approx(1.1 * 0.602214, rel=1e-6)
    assert rigid.lengths[2] == pytest.approx({"SPC/E": 1.63298, "TIP3P": 1.5139, "OPC3": 1.59849}[name], abs=5e-5)
    arms = np.diff(system.positions[rigid.pairs], axis=1)[:, 0]
    assert np.linalg.norm(arms, axis=1) == pytest.approx(rigid.lengths, rel=1e-14)
    oxygen = system.positions[::3, None] - system.positions[::3]
    oxygen -= system.cell.vectors[0, 0] * np.round(oxygen / system.cell.vectors[0, 0])
    assert np.sort(np.linalg.norm(oxygen, axis=-1), axis=1)[:, 1].min() > 2.4
    alone = md.System(system.positions[:3], charges=system.charges[:3], bonds=system.bonds[:2])
    assert md.evaluate(alone, md.Coulomb()).potential_energy == 0.0  # what is within a molecule is excluded
    assert [type(one).__name__ for one in potentials] == ["LennardJones", "Coulomb"]


# σ [Å] and ε [kcal/mol] of Joung and Cheatham as OpenMD has them, from another path than the table of minimd
JOUNG_CHEATHAM = {
    ("SPC/E", "Na"): (2.15953849277218, 0.3526418), ("SPC/E", "Cl"): (4.83045284975692, 0.0127850),
    ("TIP3P", "K"): (3.03796462885856, 0.1936829), ("TIP3P", "Br"): (4.64692771382001, 0.0586554),
}  # fmt: skip


@pytest.mark.parametrize(("model", "name"), JOUNG_CHEATHAM)
def test_ions_have_the_parameters_of_joung_and_cheatham(model, name):
    """u of two ions, and of an ion and an oxygen, by the rules of Lorentz and Berthelot."""
    _, (dispersion, _), _ = md.water(model, 27, ions={name: 2}, cutoff=4.5)
    (sigma, depth), r = JOUNG_CHEATHAM[model, name], 3.0
    depth *= 4.184 / KJ_PER_MOL_PER_EV
    of_oxygen = dispersion.epsilon["O"]
    for other, epsilon, length in (
        (name, depth, sigma),
        ("O", np.sqrt(depth * of_oxygen[0]), 0.5 * (sigma + of_oxygen[1])),
    ):
        two = md.System([[0, 0, 0], [r, 0, 0]], cell=20.0, species=[name, other], masses=1.0, units=md.units.ASE)
        bare = md.LennardJones(dispersion.epsilon, cutoff=4.5, truncation="truncated")
        expected = 4.0 * epsilon * ((length / r) ** 12 - (length / r) ** 6)
        assert md.evaluate(two, bare).potential_energy == pytest.approx(expected, rel=1e-7)  # rounding of σ there


def test_all_ions_are_those_of_ambers_files():
    """As OpenMM has them: charges, σ [nm] and ε [kJ/mol]; masses to their rounding."""
    app = pytest.importorskip("openmm.app")
    for model, file in (("SPC/E", "spce"), ("TIP3P", "tip3p"), ("TIP4P-Ew", "tip4pew")):
        tree = ElementTree.parse(Path(app.__file__).parent / "data" / "amber14" / f"{file}.xml")
        of_type = {atom.get("type"): atom for atom in tree.iter("Atom") if atom.get("sigma")}
        masses = {kind.get("name"): float(kind.get("mass")) for kind in tree.iter("Type")}
        charges = {atom.get("type"): float(atom.get("charge")) for atom in tree.iter("Atom") if atom.get("charge")}
        system, (dispersion, _), _ = md.water(model, 27, ions=dict.fromkeys(IONS, 1), cutoff=4.5)
        for name, ion in IONS.items():
            kind = f"{file}_standard-{name}{'+' if ion.charge > 0 else '-'}"
            epsilon, sigma = dispersion.epsilon[name]
            assert 10.0 * float(of_type[kind].get("sigma")) == pytest.approx(sigma, rel=1e-9)
            assert float(of_type[kind].get("epsilon")) == pytest.approx(KJ_PER_MOL_PER_EV * epsilon, rel=1e-9)
            assert system.charges[system.species == name] == charges[kind]
            assert system.masses[system.species == name] == pytest.approx(masses[kind], abs=0.01)


def test_ions_stand_far_apart_in_places_of_their_own():
    """n molecules all the same, each ion with the volume of one; by the seed; net charge is told."""
    made = [md.water("SPC/E", 54, ions={"Na": 4, "Cl": 4}, cutoff=4.5, seed=seed)[0] for seed in (1, 1, 2)]
    system = made[0]
    assert system.species.tolist() == ["O", "H", "H"] * 54 + ["Na"] * 4 + ["Cl"] * 4
    assert np.array_equal(system.positions, made[1].positions)
    assert not np.array_equal(system.positions[-8:], made[2].positions[-8:])
    assert system.volume == pytest.approx(62 / 54 * md.water("SPC/E", 54, cutoff=4.5)[0].volume)
    assert system.charges.sum() == pytest.approx(0.0, abs=1e-12)
    edge = system.cell.vectors[0, 0]
    apart = system.positions[::3][:54, None] - system.positions[-8:]
    apart -= edge * np.rint(apart / edge)
    assert np.linalg.norm(apart, axis=2).min() > 2.4
    apart = system.positions[-8:, None] - system.positions[-8:]
    apart -= edge * np.rint(apart / edge)
    distances = np.linalg.norm(apart, axis=2)[np.triu_indices(8, 1)]
    assert distances.min() > 0.4 * edge  # of random places 0.2
    charged, potentials, _ = md.water("SPC/E", 27, ions={"Li": 2}, cutoff=4.0)
    with pytest.warns(UserWarning, match="net charge of the cell is 2 e"):
        md.evaluate(charged, potentials)


def test_water_keeps_its_energy():
    """125 molecules, minimized, then 0.2 ps: the energy of rigid water oscillates by some µeV per atom."""
    system, potentials, rigid = md.water("SPC/E", 125)
    sim = md.Simulation(system, potentials, md.VelocityVerlet(1.0 * md.units.fs), rigid)
    sim.minimize(force_tolerance=0.05)
    sim.set_temperature(298.0, seed=1)
    sim.run(100)
    record = sim.run(200, every=10)
    assert np.ptp(record.total_energy) / len(system) < 8e-6  # 4.9e-6; 1.5e-5 with forces of waves wrong by 2.5 %
    assert np.ptp(record.potential_energy) / len(system) > 1e-3  # work is done


def test_excluded_pairs_across_a_boundary_and_charges_that_cannot_change():
    system = md.water("SPC/E", 27)[0]
    whole = md.evaluate(system, md.Coulomb(4.0, 1e-9)).potential_energy
    system.positions[::3] += system.cell.vectors[0]
    assert md.evaluate(system, md.Coulomb(4.0, 1e-9)).potential_energy == pytest.approx(whole, rel=1e-11)
    with pytest.raises(AttributeError, match="charges"):
        system.charges = np.zeros(81)
    assert np.array_equal(system.copy().charges, system.charges)


def soft(r2, strength, length):
    """Far below its cutoff it is zero."""
    r = np.sqrt(r2)
    x = np.maximum(0.0, 1.0 - r / length)
    return strength * x * x, 2.0 * strength * x / (length * r)


WELLS = {"O": (0.0067, 3.17), "H": (0.0, 1.0)}
BESIDE = {
    "a law that ends early": md.PairPotential(
        soft,
        {"O": (5.0, 2.0), "H": (50.0, 0.9)},
        5.0,
        "truncated",
        mixing=lambda a, b: (max(a[0], b[0]), min(a[1], b[1])),
    ),
    "bare hydrogens": md.LennardJones(WELLS, cutoff=5.0),
    "wells between unlike species": md.LennardJones(WELLS, cutoff=5.0, pairs={("H", "O"): (0.01, 1.5)}),
}


@pytest.mark.parametrize("name", BESIDE)
def test_species_without_another_law_have_the_same_forces_on_both_lists(name, monkeypatch):
    """Clusters skip the law beside that of charges in rows of atoms that have none."""
    rng = np.random.default_rng(2)
    places = 1.65 * np.indices((8, 8, 8)).reshape(3, -1).T + rng.uniform(-0.4, 0.4, (512, 3))
    species = np.where(np.arange(512) % 3, "H", "O")
    charges = np.where(species == "O", -0.8, 0.4)
    system = md.System(places, cell=13.2, species=species, charges=charges - charges.mean(), masses=1.0)
    results = []
    for clusters_from in (32, 10_000):
        monkeypatch.setattr(pair_laws, "CLUSTERS_FROM", clusters_from)
        results.append(md.evaluate(system, [BESIDE[name], md.Coulomb(5.0)]))
    ours, expected = results
    assert ours.potential_energy == pytest.approx(expected.potential_energy, rel=1e-12)
    assert ours.forces == pytest.approx(expected.forces, abs=1e-10)
    assert ours.virial == pytest.approx(expected.virial, rel=1e-9, abs=1e-9)
