"""minimd and ASE say the same: units, atoms in and out, calculators both ways, velocity Verlet, files."""

import copy
import pickle
import warnings

import ase.io
import ase.units
import numpy as np
import pytest
from ase import Atoms
from ase.build import bulk, molecule
from ase.calculators.emt import EMT
from ase.calculators.fd import calculate_numerical_stress
from ase.calculators.lj import LennardJones
from ase.constraints import FixedPlane, Hookean
from ase.filters import FrechetCellFilter
from ase.md.verlet import VelocityVerlet as ASEVelocityVerlet
from ase.optimize import BFGS

import minimd as md
from minimd.ase import Calculator, ForcesFromCalculator, VelocityVerlet, atoms_from_system, system_from_atoms
from minimd.velocities import maxwell_boltzmann

SIGMA, EPSILON, CUTOFF = 3.405, 0.0103, 8.0
TIMESTEP = 4.0 * ase.units.fs
ROUNDING = 1e-12  # of sums over 108 atoms with some 50 neighbors each


def argon(n_cells=3, temperature=188.8, seed=1):
    """Liquid argon on its way from an fcc lattice to 94.4 K: half of the heat melts it. 4 n³ atoms, 1.374 g/cm³."""
    atoms = bulk("Ar", "fcc", a=5.78, cubic=True) * n_cells
    atoms.rattle(0.1, seed=seed)
    velocities = maxwell_boltzmann(atoms.get_masses(), temperature, md.units.ASE.k_B, seed)
    atoms.set_momenta(velocities * atoms.get_masses()[:, None])
    return atoms


def lennard_jones(truncation="shifted", cutoff=CUTOFF):
    return md.LennardJones(EPSILON, SIGMA, cutoff, truncation)


def ase_lennard_jones(**options):
    return LennardJones(sigma=SIGMA, epsilon=EPSILON, rc=CUTOFF, **options)


def with_calculator(atoms, calculator):
    atoms = atoms.copy()
    atoms.calc = calculator
    return atoms


def same(a, b, tolerance=ROUNDING):
    a, b = np.asarray(a), np.asarray(b)
    return np.abs(a - b).max() <= tolerance * max(np.abs(b).max(), 1e-300)


def test_units_are_those_of_ase():
    assert md.units.ASE.k_B == ase.units.kB
    assert md.units.fs == ase.units.fs
    assert md.units.ps == pytest.approx(1000.0 * ase.units.fs, rel=1e-15)
    assert ase.units.mol / ase.units.kJ == md.units.KJ_PER_MOL_PER_EV == md.units.ASE.to_kj_per_mol
    assert ase.units.bar == md.units.BAR
    assert 1e-3 * ase.units.kg / (1e-2 * ase.units.m) ** 3 == pytest.approx(md.units.GRAM_PER_CM3, rel=1e-15)
    assert 1.0 / md.units.ASE.to_picosecond == pytest.approx(1000.0 * ase.units.fs, rel=1e-15)


# Atoms in and out


def test_atoms_survive_the_round_trip():
    rng = np.random.default_rng(3)
    atoms = Atoms("ArKrXeH2", rng.uniform(-50, 50, (5, 3)), cell=rng.standard_normal((3, 3)) * 9, pbc=(True, False, True))
    atoms.set_masses([39.9, 83.8, 131.3, 1.0, 2.0])
    atoms.set_momenta(rng.standard_normal((5, 3)))
    system = md.System.from_ase(atoms)
    back = system.to_ase()
    assert system.units is md.units.ASE
    assert system.species.tolist() == ["Ar", "Kr", "Xe", "H", "H"]
    assert np.array_equal(system.positions, atoms.positions)
    assert same(system.velocities, atoms.get_velocities(), 1e-15)
    assert same(back.get_momenta(), atoms.get_momenta(), 1e-15)
    for name in ("positions", "numbers", "pbc", "cell"):
        assert np.array_equal(getattr(back, name), getattr(atoms, name)), name
    assert np.array_equal(back.get_masses(), atoms.get_masses())


def test_labels_that_are_no_elements_come_back():
    system = md.System([[0.0, 0, 0], [1, 0, 0], [2, 0, 0]], species=["A", "Ar", "bead"], velocities=np.eye(3), masses=[1.0, 2.0, 3.0])
    atoms = atoms_from_system(system)
    assert atoms.get_chemical_symbols() == ["X", "Ar", "X"]
    assert system_from_atoms(atoms).species.tolist() == ["A", "Ar", "bead"]
    assert system_from_atoms(atoms_from_system(md.System(system.positions, species=[7, 8, 7]))).species.tolist() == [7, 8, 7]
    assert np.array_equal(atoms.positions, system.positions)  # reduced units: the numbers are kept
    assert same(atoms.get_momenta(), np.diag([1.0, 2.0, 3.0]), 0.0)


def test_another_label_gives_another_energy():
    atoms = atoms_from_system(md.System([[0.0, 0, 0], [1.1, 0, 0]], species=["A", "A"]))
    atoms.calc = Calculator(md.LennardJones({"A": (1.0, 1.0), "B": (3.0, 1.0)}, cutoff=2.5))
    before = atoms.get_potential_energy()
    atoms.arrays["species_labels"][:] = "B"
    assert atoms.get_potential_energy() == pytest.approx(3.0 * before, rel=1e-14)


@pytest.mark.parametrize("constraint", [FixedPlane(0, (0, 0, 1)), Hookean(0, 1, 5.0, 1.0)])
def test_other_constraints_are_refused_by_name(constraint):
    atoms = argon(1)
    atoms.set_constraint(constraint)
    with pytest.raises(ValueError, match=type(constraint).__name__):
        system_from_atoms(atoms)
    atoms.calc = Calculator(lennard_jones())
    with pytest.raises(ValueError, match=type(constraint).__name__):
        VelocityVerlet(atoms, TIMESTEP).run(1)
    atoms.set_constraint()
    dynamics = VelocityVerlet(atoms, TIMESTEP)
    dynamics.run(1)
    atoms.set_constraint(constraint)  # between two runs
    with pytest.raises(ValueError, match=type(constraint).__name__):
        dynamics.run(1)


def test_what_is_no_atoms_is_refused():
    with pytest.raises(TypeError, match=r"ase\.Atoms is expected; got list"):
        md.System.from_ase([[0.0, 0.0, 0.0]])


# The calculator


@pytest.mark.parametrize("smooth", [False, True])
def test_calculator_is_evaluate_and_ases_lennard_jones(smooth):
    truncation, start = ("charmm", 0.66 * CUTOFF) if smooth else ("shifted", None)
    potential = md.LennardJones(EPSILON, SIGMA, CUTOFF, truncation, switch_start=start)
    atoms, reference = with_calculator(argon(), Calculator(potential)), with_calculator(argon(), ase_lennard_jones(smooth=smooth))
    result = md.evaluate(system_from_atoms(atoms), potential)
    assert same(atoms.get_potential_energy(), result.potential_energy, 1e-14)
    for method in ("get_potential_energy", "get_potential_energies", "get_forces", "get_stress", "get_stresses"):
        assert same(getattr(atoms, method)(), getattr(reference, method)()), method
    assert atoms.get_potential_energy(force_consistent=True) == atoms.get_potential_energy()
    assert np.trace(result.virial) == pytest.approx(-atoms.get_stress()[:3].sum() * atoms.get_volume(), rel=1e-13)


def test_pressure_is_minus_a_third_of_the_trace_of_ases_stress():
    atoms = with_calculator(argon(), Calculator(lennard_jones()))
    pressure = md.Simulation(atoms, lennard_jones(), md.VelocityVerlet(TIMESTEP)).frame().observables["pressure"]
    assert pressure == pytest.approx(-atoms.get_stress(include_ideal_gas=True)[:3].mean(), rel=1e-12)


def test_stress_is_the_slope_of_the_energy():
    rng = np.random.default_rng(2)
    atoms = argon(2)
    atoms.set_cell(atoms.cell.array @ (np.eye(3) + 0.1 * rng.standard_normal((3, 3))), scale_atoms=True)
    atoms.calc = Calculator(lennard_jones("switched"))
    numerical = calculate_numerical_stress(atoms, eps=1e-5)
    assert same(atoms.get_stress(), numerical, 1e-7)  # truncation of the difference, eps² times the third derivative


def test_atoms_may_be_thousands_of_cells_away():
    rng = np.random.default_rng(4)
    atoms, moved = argon(2), argon(2)
    moved.positions += rng.integers(-3000, 3000, (len(atoms), 3)) @ atoms.cell.array
    atoms.calc, moved.calc = Calculator(lennard_jones()), Calculator(lennard_jones())
    lost = np.spacing(np.abs(moved.positions).max())  # rounding of the positions themselves
    stiffness = 72.0 * EPSILON / SIGMA**2 * 100.0  # of the well, and a hundred times that of a close pair
    assert np.abs(atoms.get_forces() - moved.get_forces()).max() < lost * stiffness
    assert np.abs(atoms.get_forces()).max() > 1e6 * lost * stiffness


def test_two_atoms_on_one_spot_are_an_error_that_names_them():
    atoms = argon(1)
    atoms.positions[2] = atoms.positions[1]
    atoms.calc = Calculator(lennard_jones())
    with pytest.raises(md.NonFiniteError, match="atoms 1 and 2"):
        atoms.get_forces()
    atoms.positions[2] += 3.5
    assert np.isfinite(atoms.get_forces()).all()


def test_list_is_kept_while_atoms_move_a_little():
    atoms = with_calculator(argon(), Calculator(lennard_jones(), skin=1.0))
    for _ in range(5):
        atoms.get_forces()
        atoms.rattle(0.01, seed=5)
    atoms.get_stresses()
    assert atoms.calc.n_builds == 1
    atoms.positions[0] += 0.6  # more than half the skin
    atoms.get_forces()
    assert atoms.calc.n_builds == 2
    atoms.set_cell(atoms.cell.array * 1.001)
    atoms.get_forces()
    assert atoms.calc.n_builds == 3
    atoms.positions[0] += atoms.cell[0]  # an atom moved by a lattice vector has moved
    atoms.get_forces()
    assert atoms.calc.n_builds == 4


def pressed(atoms):
    atoms.set_cell(atoms.cell.array * [[0.9, 0.9, 0.9], [1, 1, 1], [1, 1, 1]], scale_atoms=True)


def smaller_than_the_cutoff(atoms):
    del atoms[4:]
    atoms.set_cell(np.eye(3) * 5.6)


CHANGES = {
    "positions": lambda atoms: atoms.rattle(0.05, seed=9),
    "one position, far": lambda atoms: atoms.positions.__setitem__(3, atoms.positions[3] + atoms.cell[0] - 4 * atoms.cell[1]),
    "cell": pressed,
    "cell, atoms left behind": lambda atoms: atoms.set_cell(atoms.cell.array * 0.97),
    "pbc": lambda atoms: atoms.set_pbc((True, False, True)),
    "no pbc": lambda atoms: atoms.set_pbc(False),
    "numbers": lambda atoms: atoms.numbers.__setitem__(slice(0, 50), 36),
    "masses": lambda atoms: atoms.set_masses([2.0] * len(atoms)),
    "fewer atoms": lambda atoms: atoms.__delitem__(slice(0, 20)),
    "more atoms": lambda atoms: atoms.append("Kr") or atoms.positions.__setitem__(-1, [1.4, 1.4, 1.4]),
    "cell, smaller than the cutoff": smaller_than_the_cutoff,
}


@pytest.mark.parametrize("change", CHANGES)
def test_results_are_right_after_every_kind_of_change(change):
    mixture = md.LennardJones({"Ar": (0.0103, 3.405), "Kr": (0.014, 3.65)}, cutoff=CUTOFF)
    atoms = with_calculator(argon(), Calculator(mixture))
    atoms.set_masses(atoms.get_masses())  # given, so that another element has the same
    before = atoms.get_potential_energy()
    for redo in (CHANGES[change], lambda atoms: atoms.rattle(0.02, seed=10)):  # and once more with what was kept
        redo(atoms)
        expected = md.evaluate(system_from_atoms(atoms), mixture)
        assert same(atoms.get_potential_energy(), expected.potential_energy)
        assert same(atoms.get_forces(), expected.forces)
        assert same(atoms.get_potential_energies(), expected.energies)
        if change not in ("masses", "one position, far"):  # neither changes the energy
            assert atoms.get_potential_energy() != before


def test_small_cluster_can_become_periodic():
    atoms = with_calculator(argon(1), Calculator(lennard_jones()))
    for pbc in (False, True, (True, False, False), False):
        atoms.pbc = pbc
        assert same(atoms.get_forces(), md.evaluate(system_from_atoms(atoms), lennard_jones()).forces)


def test_bonded_scene_is_right_when_the_cell_shrinks_below_twice_the_cutoff():
    """Then the nearest image of an excluded pair can change between two builds of the list."""
    bonds = [(0, 1), (1, 2), (2, 3)]
    potentials = [md.LennardJones(EPSILON, SIGMA, CUTOFF, bonded_scale=(0, 0, 0.5)), md.HarmonicBond(1.0, 4.0)]
    atoms = Atoms("Ar4", np.arange(4)[:, None] * [3.8, 0.1, 0.2], cell=[40.0] * 3, pbc=True)
    atoms.calc = Calculator(potentials, bonds, skin=2.0)
    atoms.get_forces()
    atoms.set_cell([15.0, 40.0, 40.0])
    for move in (0.0, -0.3, 0.3):  # atoms 0 and 2 are 7.6 apart, or 7.4 through the boundary
        atoms.positions[2, 0] += move
        expected = md.evaluate(system_from_atoms(atoms, bonds), potentials)
        assert same(atoms.get_forces(), expected.forces)
        assert same(atoms.get_stress()[:3].sum() * atoms.get_volume(), -np.trace(expected.virial))


def test_a_failed_call_leaves_nothing_behind():
    atoms = with_calculator(argon(1), Calculator(md.LennardJones({"Ar": (EPSILON, SIGMA)}, cutoff=CUTOFF)))
    before = atoms.get_potential_energy()
    atoms.numbers[0] = 36
    for _ in range(2):
        with pytest.raises(ValueError, match="no parameters for species 'Kr'"):
            atoms.get_potential_energy()
    atoms.numbers[0] = 18
    assert atoms.get_potential_energy() == pytest.approx(before, rel=1e-14)


@pytest.mark.parametrize("duplicate", [copy.deepcopy, lambda thing: pickle.loads(pickle.dumps(thing))])
def test_atoms_with_calculator_can_be_copied_and_pickled(duplicate):
    atoms = with_calculator(argon(), Calculator(lennard_jones("switched")))
    expected = atoms.get_forces()
    other = duplicate(atoms)
    assert (atoms.calc.n_builds, other.calc.n_builds) == (1, 0)  # the list stays behind
    other.rattle(0.1, seed=8)
    assert same(atoms.get_forces(), expected, 0.0)
    other.positions[:] = atoms.positions
    assert same(other.get_forces(), expected)


def test_open_cluster_has_no_stress():
    atoms = molecule("H2O")
    atoms.calc = Calculator(md.LennardJones(1.0, 1.0))
    assert atoms.get_forces().shape == (3, 3)
    with pytest.raises(NotImplementedError, match="stress"):
        atoms.get_stress()


def lattice_constant(cutoff):
    """fcc Lennard-Jones crystal of least energy, in σ: a = (2 S₁₂/S₆)^(1/6), S_n = Σ |R|⁻ⁿ over the lattice with a = 1, within the cutoff."""
    grid = np.stack(np.meshgrid(*[np.arange(-9, 10)] * 3, indexing="ij"), axis=-1).reshape(-1, 3)
    r = 0.5 * np.linalg.norm(grid[(grid.sum(axis=1) % 2 == 0) & grid.any(axis=1)], axis=1)
    r = r[r * 1.545 < cutoff]
    return (2.0 * (r**-12).sum() / (r**-6).sum()) ** (1.0 / 6.0)


def test_relaxed_argon_has_the_lattice_constant_of_the_lattice_sums():
    cutoff = 2.78  # σ, amid the widest gap between shells of neighbors, so that none crosses it on the way
    atoms = bulk("Ar", "fcc", a=1.56 * SIGMA, cubic=True)
    atoms.rattle(0.05, seed=2)
    atoms.set_cell(atoms.cell.array @ [[1.01, 0.02, 0], [0, 0.99, 0], [0.01, 0, 1.01]], scale_atoms=True)
    atoms.calc = Calculator(lennard_jones(cutoff=cutoff * SIGMA))
    assert BFGS(FrechetCellFilter(atoms), logfile=None, alpha=5.0).run(fmax=1e-7, steps=100)  # alpha: argon is softer than ASE's guess
    lengths = atoms.cell.lengths() / SIGMA
    assert lengths == pytest.approx(lattice_constant(cutoff), rel=1e-7)  # truncation: fmax over the stiffness of the crystal
    assert lattice_constant(7.0) == pytest.approx(
        np.sqrt(2.0) * (2.0 * 12.13188 / 14.45392) ** (1 / 6), rel=1e-3
    )  # Kittel, table 3.3: cutoff infinite
    assert np.abs(atoms.get_stress()).max() < 1e-8


# Velocity Verlet


def assert_same_motion(atoms, reference, n_steps):
    """Positions and momenta to 1e-9: rounding, grown by the chaos of a few picoseconds."""
    start = atoms.positions.copy()
    VelocityVerlet(atoms, TIMESTEP).run(n_steps)
    ASEVelocityVerlet(reference, TIMESTEP).run(n_steps)
    assert np.abs(atoms.positions - reference.positions).max() < 1e-9
    assert np.abs(atoms.get_momenta() - reference.get_momenta()).max() < 1e-9
    assert np.linalg.norm(atoms.positions - start, axis=1).mean() > 0.1 * SIGMA  # they really moved


@pytest.mark.parametrize("calculator", [ase_lennard_jones(), Calculator(lennard_jones())], ids=["ASE's", "ours"])
def test_velocity_verlet_is_that_of_ase(calculator):
    assert_same_motion(with_calculator(argon(), Calculator(lennard_jones())), with_calculator(argon(), calculator), 1000)


def observed(dynamics_class, folder, drive):
    """Everything an observer can see of a driven run."""
    seen = []
    atoms = with_calculator(argon(2), Calculator(lennard_jones()))
    dynamics = dynamics_class(atoms, TIMESTEP, trajectory=str(folder / "a.traj"), logfile=str(folder / "a.log"), loginterval=10)

    def look(name):
        seen.append((name, dynamics.nsteps, dynamics.get_time(), atoms.get_potential_energy(), atoms.get_kinetic_energy(), *atoms.positions[0]))

    for name, interval in (("seven", 7), ("fifth", -5), ("twelve", 12)):
        dynamics.attach(look, interval, name)
    answers = drive(dynamics)
    frames = ase.io.read(folder / "a.traj", ":")
    log = (folder / "a.log").read_text()
    return seen, [(f.get_potential_energy(), *f.get_momenta()[1], *f.get_forces()[2]) for f in frames], log, answers


DRIVES = {
    "one run": lambda dynamics: dynamics.run(40),
    "several runs": lambda dynamics: [dynamics.run(n) for n in (13, 0, 1, 26)],
    "step by step": lambda dynamics: list(dynamics.irun(25)),
    "mixed": lambda dynamics: [*dynamics.irun(3), dynamics.run(20), *dynamics.irun(3)],
    "stopped from inside": lambda dynamics: (dynamics.attach(lambda: setattr(dynamics, "max_steps", 0), -17), dynamics.run(40), dynamics.nsteps)[1:],
}


@pytest.mark.parametrize("drive", DRIVES)
def test_observers_files_and_answers_are_those_of_ase(drive, tmp_path):
    (tmp_path / "ours").mkdir()
    (tmp_path / "theirs").mkdir()
    seen, frames, log, answers = observed(VelocityVerlet, tmp_path / "ours", DRIVES[drive])
    expected_seen, expected_frames, expected_log, expected_answers = observed(ASEVelocityVerlet, tmp_path / "theirs", DRIVES[drive])
    assert [row[:3] for row in seen] == [row[:3] for row in expected_seen]
    assert same([row[3:] for row in seen], [row[3:] for row in expected_seen])
    assert same(frames, expected_frames)
    assert log == expected_log
    assert answers == expected_answers


def heat(atoms):
    atoms.set_momenta(1.05 * atoms.get_momenta())


def stretch(atoms):
    atoms.set_cell(atoms.cell.array * 1.01, scale_atoms=True)


def exchange(atoms):
    """Take the other of two truncations."""
    other = "force-shifted" if atoms.calc.potentials.truncation == "shifted" else "shifted"
    atoms.calc = Calculator(lennard_jones(other))


MEDDLERS = {
    "momenta": heat,
    "wrapped": lambda atoms: atoms.wrap(),
    "displaced": lambda atoms: atoms.rattle(0.05, seed=11),
    "cell": stretch,
    "masses": lambda atoms: atoms.set_masses(1.1 * atoms.get_masses()),
    "another calculator": exchange,
}


@pytest.mark.parametrize("meddler", MEDDLERS)
def test_an_observer_may_change_the_atoms(meddler):
    ends = []
    for dynamics_class in (VelocityVerlet, ASEVelocityVerlet):
        atoms = with_calculator(argon(2), Calculator(lennard_jones()))
        if meddler == "masses" and dynamics_class is ASEVelocityVerlet:
            atoms.set_masses(atoms.get_masses())
        dynamics = dynamics_class(atoms, TIMESTEP)
        dynamics.attach(MEDDLERS[meddler], 10, atoms)
        dynamics.run(35)
        ends.append(np.hstack([atoms.positions, atoms.get_momenta(), atoms.get_forces()]))
    assert same(*ends, 1e-11)


def test_another_timestep_takes_effect():
    atoms, reference = (with_calculator(argon(2), Calculator(lennard_jones())) for _ in range(2))
    ours, theirs = VelocityVerlet(atoms, TIMESTEP), ASEVelocityVerlet(reference, TIMESTEP)
    for dynamics in (ours, theirs):
        dynamics.run(5)
        dynamics.dt = 0.5 * TIMESTEP
        dynamics.run(5)
    assert same(atoms.positions, reference.positions)


def test_steps_are_made_in_blocks_with_one_force_evaluation_each(monkeypatch):
    calls, compute = [], md.Forces.compute
    monkeypatch.setattr(md.Forces, "compute", lambda forces, detail: calls.append(detail) or compute(forces, detail))
    atoms = with_calculator(argon(), Calculator(lennard_jones(), skin=1.0))
    dynamics = VelocityVerlet(atoms, TIMESTEP)
    dynamics.attach(lambda: None, 10)
    dynamics.run(1)
    calls.clear()
    dynamics.run(50)
    assert len(calls) == 50 + 6  # and one at the start of each block: to step 10, 20, 30, 40, 50, 51
    assert atoms.calc.n_builds == 1  # the calculator itself was asked only before the first step


def test_exchanged_potentials_are_seen():
    atoms = with_calculator(argon(), Calculator(lennard_jones()))
    dynamics = VelocityVerlet(atoms, TIMESTEP)
    dynamics.run(2)
    weak = atoms.get_potential_energy()
    atoms.calc.potentials = md.LennardJones(2.0 * EPSILON, SIGMA, CUTOFF)
    strong = md.evaluate(system_from_atoms(atoms), atoms.calc.potentials)
    assert atoms.get_potential_energy() == pytest.approx(strong.potential_energy, rel=1e-12, abs=0.0)  # rounding
    assert abs(strong.potential_energy - weak) > 0.1 * abs(weak)
    dynamics.run(1)
    expected = md.evaluate(system_from_atoms(atoms), atoms.calc.potentials)
    assert same(atoms.get_forces(), expected.forces)


def test_another_calculator_is_referred_to_ase():
    with pytest.raises(TypeError, match=r"it is EMT: use ase\.md\.verlet\.VelocityVerlet"):
        VelocityVerlet(with_calculator(bulk("Cu"), EMT()), TIMESTEP).run(1)


def test_after_a_blow_up_the_atoms_hold_the_last_good_state():
    atoms = with_calculator(argon(2, temperature=1e5), Calculator(lennard_jones()))
    dynamics = VelocityVerlet(atoms, 100 * ase.units.fs)
    with pytest.raises(md.NonFiniteError, match="timestep"):
        dynamics.run(1000)
    assert np.isfinite(atoms.positions).all()
    assert np.isfinite(atoms.get_momenta()).all()
    assert dynamics.nsteps < 1000


# Forces from a calculator


def scene(pbc):
    atoms = argon(2)
    atoms.pbc = pbc
    return atoms


@pytest.mark.parametrize("pbc", [True, (True, False, True), False])
def test_forces_energy_and_virial_come_from_the_calculator(pbc):
    system = system_from_atoms(scene(pbc))
    ours, theirs = md.evaluate(system, lennard_jones()), md.evaluate(system, ForcesFromCalculator(ase_lennard_jones()))
    for name in ("potential_energy", "forces", "virial", "energies"):
        assert same(getattr(theirs, name), getattr(ours, name)), name


def test_several_potentials_add_up_with_a_calculator():
    system = system_from_atoms(scene(True))
    both = md.evaluate(system, [ForcesFromCalculator(ase_lennard_jones()), lennard_jones()])
    assert same(both.forces, 2.0 * md.evaluate(system, lennard_jones()).forces)


def test_a_run_with_a_calculator_is_the_run_with_the_potential():
    records = []
    for potential in (lennard_jones(), ForcesFromCalculator(ase_lennard_jones())):
        simulation = md.Simulation(scene(True), potential, md.VelocityVerlet(TIMESTEP))
        records.append(simulation.run(20, every=5))
    for name in ("total_energy", "pressure", "temperature"):
        assert same(getattr(records[1], name), getattr(records[0], name), 1e-11), name


@pytest.mark.parametrize("atoms", [bulk("Cu", cubic=True) * 2, molecule("CH3CH2OH")], ids=["crystal", "molecule"])
def test_emt_through_minimd_and_back_is_emt(atoms):
    atoms.rattle(0.1, seed=1)
    twice, once = with_calculator(atoms, Calculator(ForcesFromCalculator(EMT()))), with_calculator(atoms, EMT())
    assert same(twice.get_potential_energy(), once.get_potential_energy())
    assert same(twice.get_potential_energies(), once.get_potential_energies())
    assert same(twice.get_forces(), once.get_forces())
    if atoms.pbc.all():
        assert same(twice.get_stress(), once.get_stress())


class WithoutStress(LennardJones):
    implemented_properties = ("energy", "forces")

    def calculate(self, *arguments):
        super().calculate(*arguments)
        self.results = {name: self.results[name] for name in self.implemented_properties}


def test_unknown_stress_is_no_number_and_said_so():
    calculator = WithoutStress(sigma=SIGMA, epsilon=EPSILON, rc=CUTOFF)
    with pytest.warns(UserWarning, match="WithoutStress gives no stress"):
        periodic = md.evaluate(system_from_atoms(scene(True)), ForcesFromCalculator(calculator))
    assert np.isnan(periodic.virial).all()
    assert same(periodic.energies, periodic.potential_energy / len(periodic.energies))
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        cluster = md.evaluate(system_from_atoms(scene(False)), ForcesFromCalculator(calculator))
    assert same(cluster.virial, md.evaluate(system_from_atoms(scene(False)), lennard_jones()).virial)


def test_what_is_no_calculator_is_refused():
    with pytest.raises(TypeError, match="calculator must be a calculator of ASE"):
        ForcesFromCalculator(lennard_jones())


# Files


@pytest.mark.parametrize("store_forces", [False, True])
@pytest.mark.parametrize(("name", "decimals"), [("a.traj", None), ("a.xyz", 8), ("a.extxyz", 8), ("a.TRAJ", None)])
def test_ase_reads_the_trajectory_that_was_written(name, decimals, store_forces, tmp_path):
    simulation = md.Simulation(argon(2), lennard_jones(), md.VelocityVerlet(TIMESTEP))
    kept = []
    simulation_state = lambda s: kept.append((s.step, s.time, s.positions.copy(), s.velocities.copy(), s.forces.copy()))  # noqa: E731
    record = simulation.run(25, every=10, trajectory=tmp_path / name, store_forces=store_forces, observers=[simulation_state])
    frames = ase.io.read(tmp_path / name, ":", format="traj" if decimals is None else "extxyz")
    assert len(frames) == len(kept) == 3
    tolerance = 1e-14 if decimals is None else 0.51 * 10.0**-decimals
    masses = simulation.system.masses[:, None]
    for frame, energy, (step, time, positions, velocities, forces) in zip(frames, record.potential_energy, kept, strict=True):
        assert (frame.info["step"], frame.info["time"]) == (step, time)
        assert frame.get_potential_energy() == energy
        assert np.array_equal(frame.cell, simulation.system.cell.vectors)
        assert frame.pbc.all()
        assert np.abs(frame.positions - positions).max() <= tolerance
        assert np.abs(frame.get_momenta() - masses * velocities).max() <= tolerance
        assert np.abs(frame.get_masses() - masses[:, 0]).max() <= tolerance
        if store_forces:
            assert np.abs(frame.get_forces() - forces).max() <= tolerance
        assert ("forces" in frame.calc.results) == store_forces


def test_labels_and_reduced_numbers_are_in_an_xyz_file(tmp_path):
    system = md.System([[0.0, 0, 0], [1.1, 0, 0]], species=["A", "bead"], velocities=[[0.1, 0, 0], [0, 0.2, 0]])
    simulation = md.Simulation(system, md.LennardJones(1.0, 1.0), md.VelocityVerlet(0.001))
    simulation.run(0, trajectory=tmp_path / "a.xyz")
    back = system_from_atoms(ase.io.read(tmp_path / "a.xyz"))
    assert back.species.tolist() == ["A", "bead"]
    assert same(back.velocities, system.velocities, 1e-7)
