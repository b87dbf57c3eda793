"""minimd and ASE say the same: units, atoms in and out, energies, forces, stress; in random cells, after any change."""

import copy
import pickle
import warnings

import ase.neighborlist
import ase.units
import numpy as np
import pytest
from argon_atoms import CUTOFF, EPSILON, SIGMA, TIMESTEP, argon, ase_lennard_jones, lennard_jones, same, with_calculator
from ase import Atoms
from ase.build import bulk, molecule
from ase.calculators.emt import EMT
from ase.calculators.lj import LennardJones
from ase.constraints import FixedPlane, Hookean
from hypothesis import given, settings, strategies as st
from wrong_calls import answered, assert_answered

import minimd as md
import minimd.ase as ours

QUANTITIES = ("energy", "energies", "forces", "stress", "stresses")
CRYSTAL, MOLECULE = bulk("Cu", cubic=True) * 2, molecule("CH3CH2OH")
AS_ASE = {  # atoms, how much they are shaken, pbc, a calculator, and another that says the same of `QUANTITIES[:n]`
    "liquid": (argon(), 0.0, True, lennard_jones(), ase_lennard_jones(), 5),
    "slab": (argon(2), 0.0, (True, False, True), lennard_jones(), ase_lennard_jones(), 5),
    "slab by ASE": (argon(2), 0.0, (True, False, True), ours.ForcesFromCalculator(ase_lennard_jones()), None, 4),
    "cluster by ASE": (argon(2), 0.0, False, ours.ForcesFromCalculator(ase_lennard_jones()), None, 4),
    "crystal by EMT": (CRYSTAL, 0.1, True, ours.ForcesFromCalculator(EMT()), EMT(), 4),
    "molecule by EMT": (MOLECULE, 0.1, False, ours.ForcesFromCalculator(EMT()), EMT(), 3),
}
# rounding: positions up to 30 cells away (1e-14 of the cell), times the slope of the law, of some hundred pairs
RELATIVE = 1e-10
PROPERTIES = ("energy", "free_energy", "energies", "forces", "stress", "stresses")
OTHERS = md.LennardJones({"Ar": (0.02, 3.405), "Kr": (0.014, 3.65)}, cutoff=CUTOFF)
CHANGES = {
    "positions": lambda atoms: atoms.rattle(0.05, seed=9),
    "one position, far": lambda atoms: atoms.positions.__setitem__(3, atoms.positions[3] - 4 * atoms.cell[1]),
    "cell": lambda atoms: atoms.set_cell(atoms.cell.array * [[0.9], [1.0], [1.0]], scale_atoms=True),
    "cell, atoms left behind": lambda atoms: atoms.set_cell(atoms.cell.array * 0.97),
    "cell, smaller than the cutoff": lambda atoms: (atoms.__delitem__(slice(4, None)), atoms.set_cell(np.eye(3) * 5.6)),
    "pbc": lambda atoms: atoms.set_pbc((True, False, True)), "no pbc": lambda atoms: atoms.set_pbc(False),
    "pbc and back": lambda atoms: (atoms.set_pbc(False), atoms.get_forces(), atoms.set_pbc(True)),
    "numbers": lambda atoms: atoms.numbers.__setitem__(slice(0, 50), 36),
    "masses": lambda atoms: atoms.set_masses([2.0] * len(atoms)),
    "fewer atoms": lambda atoms: atoms.__delitem__(slice(0, 20)),
    "more atoms": lambda atoms: atoms.extend(Atoms("Kr", [[1.4, 1.4, 1.4]])),
    "potentials": lambda atoms: setattr(atoms.calc, "potentials", OTHERS),
    "charges": lambda atoms: atoms.set_initial_charges(0.3 * np.cos(np.arange(len(atoms)))),
}  # fmt: skip


def test_units_are_those_of_ase():
    a, our = ase.units, md.units
    assert (our.ASE.k_B, our.fs, our.BAR) == (a.kB, a.fs, a.bar)
    assert our.ps == pytest.approx(1000.0 * a.fs, rel=1e-15) == 1.0 / our.ASE.to_picosecond
    assert a.mol / a.kJ == our.KJ_PER_MOL_PER_EV == our.ASE.to_kj_per_mol
    assert 1e-3 * a.kg / (1e-2 * a.m) ** 3 == pytest.approx(our.GRAM_PER_CM3, rel=1e-15)
    second, volt = a.second, a.J / a.C
    of_si = (a.GPa, 1e-3 * a.J / a.m**2, a.C / (second * volt * a.m), a.J / (second * a.m))
    of_si += (1e-3 * a.Pascal * second, (1e-2 * a.m) ** 2 / second)
    ours_in_si = (our.GPA, our.MN_PER_M, our.S_PER_M, our.W_PER_M_K, our.MPA_S, our.CM2_PER_S)
    assert of_si == pytest.approx(ours_in_si, rel=1e-13)


@pytest.mark.parametrize("species", [["A", "Ar", "A"], [7, 8, 7]])
def test_labels_that_are_no_elements_come_back_and_another_one_gives_another_energy(species):
    places = np.outer([0.0, 1.1, 5.0], [1, 0, 0])
    system = md.System(places, species=species, velocities=np.eye(3), masses=[1.0, 2.0, 3.0])
    atoms = ours.atoms_from_system(system)
    assert atoms.get_chemical_symbols() == ["Ar" if one == "Ar" else "X" for one in species]
    assert ours.system_from_atoms(atoms).species.tolist() == species
    assert np.array_equal(atoms.positions, system.positions)  # reduced units: the numbers are kept
    assert same(atoms.get_momenta(), np.diag([1.0, 2.0, 3.0]), 0.0)
    a, b = species[:2]
    atoms.calc = ours.Calculator(md.LennardJones({a: (1.0, 1.0), b: (9.0, 1.0)}, cutoff=2.5))
    before = atoms.get_potential_energy()
    atoms.arrays["species_labels"][:] = a
    assert atoms.get_potential_energy() == pytest.approx(before / 3.0, rel=1e-14)


@pytest.mark.parametrize("scene", AS_ASE)
def test_energies_forces_and_stress_are_those_of_ase(scene):
    atoms, shaken, pbc, potential, other, n = AS_ASE[scene]
    atoms.rattle(shaken, seed=1)
    atoms.pbc = pbc
    mine = with_calculator(atoms, ours.Calculator(potential))
    reference = with_calculator(atoms, other or ours.Calculator(lennard_jones()))
    for name in QUANTITIES[:n]:
        assert same(mine.calc.get_property(name, mine), reference.calc.get_property(name, reference)), name
    assert mine.get_potential_energy(force_consistent=True) == mine.get_potential_energy()
    if n == 5 and pbc is True:
        pressure = md.Simulation(mine, potential, md.VelocityVerlet(TIMESTEP)).frame().observables["pressure"]
        assert pressure == pytest.approx(-mine.get_stress(include_ideal_gas=True)[:3].mean(), rel=1e-12)


@pytest.mark.parametrize("change", CHANGES)
def test_results_are_right_after_every_kind_of_change(change):
    mixture = md.LennardJones({"Ar": (0.0103, 3.405), "Kr": (0.014, 3.65)}, cutoff=CUTOFF)
    charged = [mixture, md.Coulomb(CUTOFF, 1e-3)]
    atoms = with_calculator(argon(), ours.Calculator(charged if change == "charges" else mixture))
    atoms.set_initial_charges([0.2, -0.2] * (len(atoms) // 2) if change == "charges" else None)
    atoms.set_masses(atoms.get_masses())  # given, so that another element has the same
    before = atoms.get_potential_energy()
    for redo in (CHANGES[change], lambda atoms: atoms.rattle(0.02, seed=10)):  # and once more with what was kept
        redo(atoms)
        expected = md.evaluate(ours.system_from_atoms(atoms), atoms.calc.potentials)
        assert same(atoms.get_potential_energy(), expected.potential_energy)
        assert same(atoms.get_forces(), expected.forces)
        assert same(atoms.get_potential_energies(), expected.energies)
        assert same(atoms.get_stress()[:3].sum() * atoms.get_volume(), -np.trace(expected.virial))
        if change not in ("masses", "one position, far", "pbc and back"):  # these do not change the energy
            assert atoms.get_potential_energy() != before


@pytest.mark.slow
def test_bonded_scene_is_right_when_the_cell_shrinks_below_twice_the_cutoff():
    """Then the nearest image of an excluded pair can change between two builds of the list."""
    bonds = [(0, 1), (1, 2), (2, 3)]
    law = md.LennardJones(EPSILON, SIGMA, CUTOFF, "force-shifted", bonded_scale=(0, 0, 0.5))
    potentials = [law, md.HarmonicBond(1.0, 4.0)]
    atoms = Atoms("Ar4", np.arange(4)[:, None] * [3.8, 0.1, 0.2], cell=[40.0] * 3, pbc=True)
    atoms.calc = ours.Calculator(potentials, bonds, skin=2.0)
    atoms.get_forces()
    atoms.set_cell([15.0, 40.0, 40.0])
    for move in (0.0, -0.3, 0.3):  # atoms 0 and 2 are 7.6 apart, or 7.4 through the boundary
        atoms.positions[2, 0] += move
        expected = md.evaluate(ours.system_from_atoms(atoms, bonds), potentials)
        assert same(atoms.get_forces(), expected.forces)
        assert same(atoms.get_stress()[:3].sum() * atoms.get_volume(), -np.trace(expected.virial))


@pytest.mark.parametrize("duplicate", [copy.deepcopy, lambda thing: pickle.loads(pickle.dumps(thing))])
def test_atoms_with_calculator_can_be_copied_and_pickled(duplicate):
    atoms = with_calculator(argon(), ours.Calculator(lennard_jones()))
    expected = atoms.get_forces()
    other = duplicate(atoms)
    assert (atoms.calc.n_builds, other.calc.n_builds) == (1, 0)  # the list stays behind
    other.rattle(0.1, seed=8)
    assert same(atoms.get_forces(), expected, 0.0)
    other.positions[:] = atoms.positions
    assert same(other.get_forces(), expected)


class WithoutStress(LennardJones):
    implemented_properties = ("energy", "forces")

    def calculate(self, *arguments):
        super().calculate(*arguments)
        self.results = {name: self.results[name] for name in self.implemented_properties}


def test_unknown_stress_is_no_number_and_said_so():
    crystal, cluster = ours.system_from_atoms(argon(2)), argon(2)
    cluster.pbc = False
    unknown = ours.ForcesFromCalculator(WithoutStress(sigma=SIGMA, epsilon=EPSILON, rc=CUTOFF))
    cluster = ours.system_from_atoms(cluster)
    with pytest.warns(UserWarning, match="WithoutStress"):
        periodic = md.evaluate(crystal, unknown)
    assert np.isnan(periodic.virial).all()
    assert same(periodic.energies, periodic.potential_energy / len(periodic.energies))
    with warnings.catch_warnings(action="error"):
        virial = md.evaluate(cluster, unknown).virial
    assert same(virial, md.evaluate(cluster, lennard_jones()).virial)


def held(*constraints):
    atoms = with_calculator(argon(1), ours.Calculator(lennard_jones()))
    atoms.set_constraint(constraints)
    return atoms


def langevin(atoms=None, rng=1, **options):
    calm = with_calculator(atoms or argon(1), ours.Calculator(lennard_jones()))
    return ours.Langevin(calm, TIMESTEP, **{"temperature_K": 90.0, "friction": 0.01, "rng": rng} | options)


PLANE, SPRING = FixedPlane(0, (0, 0, 1)), Hookean(0, 1, 5.0, 1.0)
test_wrong_calls_are_answered = pytest.mark.filterwarnings("ignore")(answered(
    (lambda: md.System.from_ase([[0.0, 0.0, 0.0]]), TypeError, "ase.Atoms", "[[0.0, 0.0, 0.0]]"),
    (lambda: ours.system_from_atoms(held(PLANE)), ValueError, "atoms.constraints", "FixedPlane"),
    (lambda: ours.VelocityVerlet(held(SPRING), TIMESTEP).run(1), ValueError, "atoms.constraints", "Hookean"),
    (lambda: ours.VelocityVerlet(argon(1), TIMESTEP).step(), RuntimeError, "atoms.calc", "no calculator"),
    (lambda: ours.ForcesFromCalculator(lennard_jones()), TypeError, "calculator", "LennardJones"),
    (lambda: md.Simulation(argon(1), "EMT", md.VelocityVerlet(TIMESTEP)), TypeError, "own-laws", "'EMT'"),
    (lambda: ours.NPTBerendsen, ImportError, "no NPTBerendsen", "NVTBerendsen"),
    (lambda: langevin(rng="seven"), TypeError, "rng", "'seven'"), (lambda: langevin(rng=-1), TypeError, "rng", "-1"),
    (lambda: langevin(held()[:1], fixcm=True).run(1), ValueError, "fixcm", "3"),
    (lambda: langevin(fixcm=False, friction=-1.0).run(1), ValueError, "friction", "-1.0"),
    (lambda: ours.Bussi(held(), TIMESTEP, 300.0, -1.0, rng=2).run(1), ValueError, "taut", "-1.0"),
    (lambda: ours.LangevinBAOAB(held(), TIMESTEP, externalstress=-0.01), NotImplementedError, "externalstress"),
))  # fmt: skip


def test_a_failed_call_leaves_nothing_behind():
    atoms = with_calculator(argon(1), ours.Calculator(md.LennardJones({"Ar": (EPSILON, SIGMA)}, cutoff=CUTOFF)))
    before = atoms.get_potential_energy()
    atoms.numbers[0] = 36
    for _ in range(2):
        assert_answered(atoms.get_potential_energy, ValueError, "species", "'Kr'")
    atoms.numbers[0] = 18
    atoms.positions[2], there = atoms.positions[1], atoms.positions[2].copy()
    assert_answered(atoms.get_forces, md.NonFiniteError, "atoms 1 and 2")
    atoms.positions[2] = there
    assert atoms.get_potential_energy() == pytest.approx(before, rel=1e-14)


def closest(atoms):
    for reach in (2.0, 4.0, 8.0):
        distances = ase.neighborlist.neighbor_list("d", atoms, reach)
        if distances.size:
            return distances.min()
    return np.inf


@st.composite
def scenes(draw):
    """Atoms on a distorted lattice, scaled so that the closest pair is 0.9 to 1.2 σ apart: no overlap, for any cell."""
    rng = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    pbc = np.array(draw(st.tuples(st.booleans(), st.booleans(), st.booleans())))
    counts = np.array(draw(st.tuples(st.integers(1, 2), st.integers(1, 2), st.integers(1, 3))))
    cell = np.diag(counts) + 0.25 * rng.standard_normal((3, 3))
    places = np.stack(np.meshgrid(*map(np.arange, counts), indexing="ij"), axis=-1).reshape(-1, 3)
    positions = (places + rng.uniform(-0.2, 0.2, places.shape)) / counts @ cell
    strength = draw(st.sampled_from([0, 1, 4]))
    for _ in range(3):
        i, j = rng.permutation(3)[:2]
        cell[i] += rng.integers(-strength, strength + 1) * cell[j]
    if draw(st.booleans()):
        cell[rng.integers(3)] *= -1.0
    if draw(st.booleans()):
        cell[~pbc] = 0.0
    atoms = Atoms(f"Ar{len(places)}", positions, cell=cell, pbc=pbc)
    distance = closest(atoms)
    scale = SIGMA * draw(st.floats(0.9, 1.2)) / distance if np.isfinite(distance) else SIGMA
    atoms.set_cell(cell * scale, scale_atoms=False)
    n = draw(st.sampled_from([0, 1, 30]))
    away = rng.integers(-n, n + 1, (len(places), 3)) * pbc + rng.uniform(-n, n, 3) * ~pbc
    atoms.positions = positions * scale + away @ (cell * scale)
    return atoms


def scales(atoms, cutoff):
    """What each property is a sum of, with all its terms positive: the scale of its rounding."""
    i, d = ase.neighborlist.neighbor_list("id", atoms, cutoff)
    s6 = (SIGMA / d) ** 6
    energies = np.bincount(i, 4.0 * EPSILON * (s6 + s6**2), len(atoms))
    forces = np.bincount(i, 24.0 * EPSILON * (s6 + 2.0 * s6**2) / d, len(atoms))
    virials = np.bincount(i, 24.0 * EPSILON * (s6 + 2.0 * s6**2), len(atoms))
    stress = virials.sum() / (atoms.get_volume() if atoms.cell.rank == 3 else np.inf)
    sums = energies.sum(), energies.sum(), energies.max(), forces.max(), stress, stress
    return dict(zip(PROPERTIES, sums, strict=True))


def assert_law_of_ase(atoms, cutoff, truncation, start, **options):
    reference = LennardJones(sigma=SIGMA, epsilon=EPSILON, rc=cutoff, ro=start, **options)
    calculator = ours.Calculator(md.LennardJones(EPSILON, SIGMA, cutoff, truncation, switch_start=start))
    reference.calculate(atoms)
    calculator.calculate(atoms, PROPERTIES)
    assert set(calculator.results) == set(reference.results)  # no stress where ASE has none
    size = scales(atoms, cutoff)
    for name, expected in reference.results.items():
        assert np.abs(calculator.results[name] - expected).max() <= RELATIVE * size[name], name


@pytest.mark.parametrize("n", [15, pytest.param(220, marks=pytest.mark.slow)])
def test_laws_are_those_of_ase(n):
    @settings(max_examples=n)
    @given(scenes(), st.floats(1.31, 3.0), st.floats(0.4, 0.95))
    def same_as_ase(atoms, cutoff, start):
        cutoff *= SIGMA
        assert_law_of_ase(atoms, cutoff, "shifted", None)
        assert_law_of_ase(atoms, cutoff, "charmm", start * cutoff, smooth=True)

    same_as_ase()
