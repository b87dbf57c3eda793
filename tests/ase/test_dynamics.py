"""Classes of minimd in the place of ASE's: their arguments, motion, files, observers; any calculator; constraints."""

import copy
import inspect
import warnings
from importlib import import_module

import ase.io
import ase.units
import numpy as np
import pytest
from argon_atoms import TIMESTEP, ase_lennard_jones, copper, lennard_jones, liquid, same
from ase import build
from ase.calculators.emt import EMT
from ase.calculators.idealgas import IdealGas
from ase.calculators.lj import LennardJones
from ase.constraints import FixAtoms, FixBondLengths, FixCom, FixedPlane, FixLinearTriatomic
from ase.md import MDLogger
from wrong_calls import assert_answered

import minimd as md
import minimd.ase as ours
from minimd.ase import Calculator, ForcesFromCalculator

pytestmark = pytest.mark.filterwarnings("ignore:the calculator is")
KELVIN, TAU = 94.4, 100 * TIMESTEP
CLASSES = {  # class, its module in ase.md, arguments beside atoms and time step
    "VelocityVerlet": ("verlet", {}),
    "Langevin": ("langevin", {"temperature_K": KELVIN, "friction": 0.01, "fixcm": False, "rng": 1}),
    "LangevinBAOAB": ("langevinbaoab", {"temperature_K": KELVIN, "T_tau": TAU, "rng": 1}),
    "Bussi": ("bussi", {"temperature_K": KELVIN, "taut": TAU, "rng": 1}),
    "NoseHooverChainNVT": ("nose_hoover_chain", {"temperature_K": KELVIN, "tdamp": TAU}),
    "Andersen": ("andersen", {"temperature_K": KELVIN, "andersen_prob": 0.01, "fixcm": False, "rng": 1}),
    "NVTBerendsen": ("nvtberendsen", {"temperature_K": KELVIN, "taut": TAU}),
}
DRIVES = {
    "one run": lambda dynamics: dynamics.run(40),
    "several runs": lambda dynamics: [dynamics.run(n) for n in (13, 0, 1, 26)],
    "step by step": lambda dynamics: list(dynamics.irun(25)),
    "mixed": lambda dynamics: [*dynamics.irun(3), dynamics.run(20), *dynamics.irun(3)],
    "stopped from inside": lambda dynamics: (dynamics.attach(lambda: setattr(dynamics, "max_steps", 0), -17),
                                             dynamics.run(40), dynamics.nsteps)[1:],
}  # fmt: skip
OTHER = {"shifted": lennard_jones("force-shifted"), "force-shifted": lennard_jones("shifted")}
MEDDLERS = {
    "momenta": lambda d: d.atoms.set_momenta(1.05 * d.atoms.get_momenta()),
    "wrapped": lambda d: d.atoms.wrap(),
    "displaced": lambda d: d.atoms.rattle(0.05, seed=11),
    "cell": lambda d: d.atoms.set_cell(d.atoms.cell.array * 1.01, scale_atoms=True),
    "masses": lambda d: d.atoms.set_masses(1.1 * d.atoms.get_masses()),
    "charges": lambda d: d.atoms.set_initial_charges(1.1 * d.atoms.get_initial_charges()),
    "time step": lambda d: setattr(d, "dt", 0.5 * TIMESTEP),
    "another calculator": lambda d: setattr(d.atoms, "calc", Calculator(OTHER[d.atoms.calc.potentials.truncation])),
    "other potentials": lambda d: setattr(d.atoms.calc, "potentials", OTHER[d.atoms.calc.potentials.truncation]),
    "parameters of ASE's": lambda d: (d.atoms.calc.parameters.__setitem__("epsilon", 0.48), d.atoms.calc.reset()),
}


def theirs(name):
    return getattr(import_module(f"ase.md.{CLASSES[name][0]}"), name)


def made(name, atoms, *, by_ase=False, **options):
    arguments = CLASSES[name][1] | options
    if by_ase and "rng" in arguments:
        arguments["rng"] = np.random.RandomState(arguments["rng"])
    return (theirs(name) if by_ase else getattr(ours, name))(atoms, TIMESTEP, **arguments)


@pytest.mark.parametrize("name", CLASSES)
def test_classes_are_those_of_ase_with_their_arguments_attributes_and_dictionaries(name):
    cls = getattr(ours, name)
    assert issubclass(cls, theirs(name))
    assert list(inspect.signature(cls).parameters) == list(inspect.signature(theirs(name)).parameters)
    mine, other = made(name, liquid()), made(name, liquid(), by_ase=True)
    assert mine.todict() == other.todict()
    public = {key for key in vars(other) if not key.startswith("_")}
    assert all(hasattr(mine, key) for key in public), public
    numbers = {key: value for key, value in vars(other).items() if isinstance(value, bool | int | float | None)}
    assert numbers == {key: getattr(mine, key) for key in numbers}


COLD, HOT = ({"temperature_K": t, "taut": TIMESTEP} for t in (1.0, 1e5))
MOTIONS = {  # class, atoms for minimd's, atoms for ASE's, numbers of steps, arguments
    "ASE's calculator": ("VelocityVerlet", lambda: liquid(None, 3), lambda: liquid(ase_lennard_jones(), 3), (40,), {}),
    "cold": ("NVTBerendsen", liquid, liquid, (3,), COLD), "hot": ("NVTBerendsen", liquid, liquid, (3,), HOT),
}  # fmt: skip
for of in ("VelocityVerlet", "NoseHooverChainNVT", "NVTBerendsen"):
    MOTIONS |= {f"{of}, {make.__name__}": (of, make, make, (30, 20), {}) for make in (liquid, copper)}


@pytest.mark.parametrize("motion", MOTIONS)
def test_motion_without_noise_is_that_of_ase(motion):
    """To rounding, grown by chaos. Berendsen's factors have the bounds of ASE, for atoms too cold or too hot."""
    name, scene, reference_scene, blocks, options = MOTIONS[motion]
    atoms, reference = scene(), reference_scene()
    mine, other = made(name, atoms, **options), made(name, reference, by_ase=True, **options)
    start, momenta = atoms.positions.copy(), atoms.get_momenta()
    for steps in blocks:
        mine.run(steps)
        other.run(steps)
    assert same(atoms.positions, reference.positions, 1e-11)
    assert same(atoms.get_momenta(), reference.get_momenta(), 1e-10)
    if sum(blocks) > 3:
        assert np.linalg.norm(atoms.positions - start, axis=1).max() > 0.1
    else:
        assert not same(atoms.get_momenta(), momenta, 0.2)
    if name == "NoseHooverChainNVT":
        assert mine.get_conserved_energy() == pytest.approx(other.get_conserved_energy(), rel=1e-11)


def observed(cls, folder, drive):
    folder.mkdir()
    seen, atoms = [], liquid()
    dynamics = cls(atoms, TIMESTEP, trajectory=str(folder / "a.traj"), logfile=str(folder / "a.log"), loginterval=10)

    def look(name):
        energies = atoms.get_potential_energy(), atoms.get_kinetic_energy()
        seen.append((name, dynamics.nsteps, dynamics.get_time(), *energies, *atoms.positions[0]))

    for name, interval in (("seven", 7), ("fifth", -5), ("twelve", 12)):
        dynamics.attach(look, interval, name)
    stress = MDLogger(dynamics, atoms, str(folder / "stress.log"), header=True, stress=True, peratom=True, mode="w")
    dynamics.attach(stress, interval=15)
    with ase.io.Trajectory(folder / "own.traj", "w", atoms) as own:
        dynamics.attach(own.write, interval=20)
        answers = drive(dynamics)
    frames = [*ase.io.read(folder / "a.traj", ":"), *ase.io.read(folder / "own.traj", ":")]
    numbers = [np.concatenate([f.positions[0], f.get_momenta()[1], f.get_forces()[2], f.get_stress()]) for f in frames]
    logs = [(folder / file).read_text() for file in ("a.log", "stress.log")]
    return seen, numbers, (answers, logs, [sorted(frame.calc.results) for frame in frames])


@pytest.mark.parametrize("drive", DRIVES)
def test_observers_files_and_answers_are_those_of_ase(drive, tmp_path):
    seen, frames, words = observed(ours.VelocityVerlet, tmp_path / "ours", DRIVES[drive])
    expected_seen, expected_frames, expected = observed(theirs("VelocityVerlet"), tmp_path / "theirs", DRIVES[drive])
    assert [row[:3] for row in seen] == [row[:3] for row in expected_seen]
    assert same([row[3:] for row in seen], [row[3:] for row in expected_seen])
    assert same(frames, expected_frames)
    assert words == expected


@pytest.mark.parametrize("meddler", MEDDLERS)
def test_an_observer_may_change_the_atoms(meddler):
    ends = []
    for by_ase in (False, True):
        atoms = copper(LennardJones(sigma=2.3, epsilon=0.4, rc=5.0)) if "ASE" in meddler else liquid()
        if meddler == "masses" and by_ase:
            atoms.set_masses(atoms.get_masses())
        if meddler == "charges":
            atoms.set_initial_charges([0.2, -0.2] * (len(atoms) // 2))
            atoms.calc.potentials = [lennard_jones(), md.Coulomb(5.0, 1e-3)]
        dynamics = made("VelocityVerlet", atoms, by_ase=by_ase)
        dynamics.attach(MEDDLERS[meddler], 2 if "ASE" in meddler else 10, dynamics)
        dynamics.run(9 if "ASE" in meddler else 35)
        ends.append(np.hstack([atoms.positions, atoms.get_momenta(), atoms.get_forces()]))
    assert same(*ends, 1e-11)


def test_a_step_or_a_log_of_somebody_else_is_called_at_every_step():
    calls = []

    def counting(name):
        def counted(self, *given):
            calls.append(name)
            return getattr(ours.VelocityVerlet, name)(self, *given)

        return type("Counting", (ours.VelocityVerlet,), {name: counted})

    classes = counting("step"), counting("log"), ours.VelocityVerlet
    stepping, logging, plain = (cls(liquid(), TIMESTEP) for cls in classes)
    assert all(dynamics.run(7) is True for dynamics in (stepping, logging, plain))
    assert (calls.count("step"), stepping.nsteps, calls.count("log")) == (7, 7, 8)
    assert same(stepping.atoms.positions, plain.atoms.positions)


@pytest.mark.filterwarnings("ignore:timestep 100 fs is long")
def test_after_a_blow_up_the_atoms_hold_the_last_good_state():
    atoms = liquid()
    atoms.set_momenta(23.0 * atoms.get_momenta())  # 1e5 K
    dynamics = ours.VelocityVerlet(atoms, 100 * ase.units.fs)
    assert_answered(lambda: dynamics.run(1000), md.NonFiniteError, "timestep")
    assert np.isfinite([atoms.positions, atoms.get_momenta()]).all()
    assert dynamics.nsteps < 1000


class Charged(LennardJones):
    n_calls = 0

    def calculate(self, atoms=None, *arguments):
        assert (atoms.get_initial_charges()[0], atoms.info["name"]) == (0.5, "copper")
        self.n_calls += 1
        super().calculate(atoms, *arguments)


@pytest.mark.filterwarnings("default:the calculator is")
def test_other_calculators_are_asked_once_per_step_with_the_atoms_themselves_and_said_so_once():
    atoms = copper(Charged(sigma=2.3, epsilon=0.4, rc=5.0))
    atoms.set_initial_charges([0.5, -0.5, 0.0, 0.0])
    atoms.info["name"] = "copper"
    dynamics = ours.VelocityVerlet(atoms, TIMESTEP)
    with pytest.warns(UserWarning, match="Charged") as told:
        dynamics.run(5)
    atoms.set_masses(1.1 * atoms.get_masses())
    with warnings.catch_warnings(action="error"):
        dynamics.run(5)
        list(dynamics.irun(5))
        atoms.get_potential_energy()
        atoms.get_stress()
    assert (len(told), atoms.calc.n_calls) == (1, 16)  # nothing was said of the charges


@pytest.mark.filterwarnings("default:the calculator is", "ignore:the center of mass moves")
def test_a_simulation_takes_a_calculator_of_ase_for_a_potential():
    expected = md.Simulation(copper(), ForcesFromCalculator(EMT()), md.VelocityVerlet(TIMESTEP)).run(10, every=5)
    with pytest.warns(UserWarning, match="EMT") as told:
        simulation = md.Simulation(copper(), EMT(), md.VelocityVerlet(TIMESTEP))
    record = simulation.run(10, every=5)
    assert len(told) == 1
    assert np.array_equal(record.total_energy, expected.total_energy)
    assert np.array_equal(record.pressure, expected.pressure)
    with warnings.catch_warnings(action="ignore"):
        both = md.evaluate(copper(), [EMT(), ForcesFromCalculator(EMT())])
    assert same(both.forces, 2.0 * copper().get_forces())


class Wind(IdealGas):
    def calculate(self, atoms=None, *arguments):
        super().calculate(atoms, *arguments)
        self.results["forces"] = np.full((len(atoms), 3), 0.1)


def of_masses():
    atoms = copper(Wind())
    atoms.set_masses([20.0, 30.0, 60.0, 90.0])
    return atoms


def molecule(name):
    atoms = build.molecule(name, calculator=EMT())
    atoms.set_momenta(np.random.default_rng(4).normal(0.0, 0.3, (3, 3)))
    return atoms


LENGTHS, LINEAR = [(0, 1), (0, -1), (-2, -1)], [(-2, -3, -1)]  # some atoms counted from the end
HELD = {  # atoms, constraint, what stays, tolerance
    "atoms": (copper, FixAtoms([0, -1]), lambda atoms: atoms.positions[[0, 3]], 0.0),
    "lengths": (lambda: molecule("H2O"), FixBondLengths(LENGTHS), lambda atoms: atoms.get_all_distances(), 1e-10),
    "rods": (lambda: molecule("CO2"), FixLinearTriatomic(LINEAR), lambda atoms: atoms.get_all_distances(), 1e-10),
    "center": (of_masses, FixCom(), lambda atoms: atoms.get_center_of_mass(), 1e-10),
}


@pytest.mark.parametrize("kind", HELD)
@pytest.mark.parametrize("name", CLASSES)
def test_what_is_held_stays_and_other_constraints_are_refused(name, kind):
    make, constraint, held, tolerance = HELD[kind]
    atoms = make()
    atoms.set_constraint(copy.deepcopy(constraint))
    atoms.set_momenta(atoms.get_momenta())
    before, start = held(atoms), atoms.positions.copy()
    dynamics = made(name, atoms)
    for _ in range(4):
        dynamics.run(5)
    assert np.abs(held(atoms) - before).max() <= tolerance
    moved = np.abs(atoms.positions - start).max(axis=1) > 1e-3
    assert moved.tolist() == [False, True, True, False] if kind == "atoms" else moved.sum() >= 2
    atoms.set_constraint(FixedPlane(0, (0, 0, 1)))  # between two runs
    assert_answered(lambda: dynamics.run(1), ValueError, "FixedPlane")
