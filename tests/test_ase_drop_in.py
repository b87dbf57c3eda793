"""Our classes in the place of ASE's: the same arguments, attributes, files and callers; forces of any calculator; constraints."""

import inspect
import io
import re
import warnings
from contextlib import redirect_stdout
from pathlib import Path

import ase.io
import ase.md.andersen
import ase.md.bussi
import ase.md.langevin
import ase.md.langevinbaoab
import ase.md.nose_hoover_chain
import ase.md.nvtberendsen
import ase.md.verlet
import ase.units
import numpy as np
import pytest
from argon_atoms import TIMESTEP, argon, lennard_jones, same, with_calculator
from ase.build import bulk, molecule
from ase.calculators.emt import EMT
from ase.calculators.idealgas import IdealGas
from ase.calculators.lj import LennardJones
from ase.constraints import FixAtoms, FixBondLengths, FixCom, FixedPlane, FixLinearTriatomic
from ase.io import Trajectory

import minimd as md
import minimd.ase as ours
from minimd.ase import Calculator, ForcesFromCalculator

KELVIN, TAU = 94.4, 100 * TIMESTEP
ARGUMENTS = {
    "VelocityVerlet": {},
    "Langevin": {"temperature_K": KELVIN, "friction": 0.01, "fixcm": False, "rng": 1},
    "LangevinBAOAB": {"temperature_K": KELVIN, "T_tau": TAU, "rng": 1},
    "Bussi": {"temperature_K": KELVIN, "taut": TAU, "rng": 1},
    "NoseHooverChainNVT": {"temperature_K": KELVIN, "tdamp": TAU},
    "Andersen": {"temperature_K": KELVIN, "andersen_prob": 0.01, "fixcm": False, "rng": 1},
    "NVTBerendsen": {"temperature_K": KELVIN, "taut": TAU},
}
MODULES = (
    ase.md.verlet,
    ase.md.langevin,
    ase.md.langevinbaoab,
    ase.md.bussi,
    ase.md.nose_hoover_chain,
    ase.md.andersen,
    ase.md.nvtberendsen,
)
THEIRS = {name: getattr(module, name) for name, module in zip(ARGUMENTS, MODULES, strict=True)}
DETERMINISTIC = ("VelocityVerlet", "NoseHooverChainNVT", "NVTBerendsen")


def made(name, atoms, *, by_ase=False, **options):
    arguments = ARGUMENTS[name] | options
    if by_ase and "rng" in arguments:
        arguments["rng"] = np.random.RandomState(arguments["rng"])
    return (THEIRS if by_ase else vars(ours))[name](atoms, TIMESTEP, **arguments)


def liquid(calculator=None):
    return with_calculator(argon(2), calculator or Calculator(lennard_jones()))


def copper(calculator=None):
    atoms = bulk("Cu", cubic=True)
    atoms.rattle(0.05, seed=1)
    atoms.set_momenta(np.random.default_rng(2).normal(0.0, 1.5, (4, 3)))
    atoms.calc = calculator or EMT()
    return atoms


# Classes


@pytest.mark.parametrize("name", ARGUMENTS)
def test_classes_are_those_of_ase_with_their_arguments_attributes_and_dictionaries(name):
    cls = getattr(ours, name)
    assert issubclass(cls, THEIRS[name])
    assert list(inspect.signature(cls).parameters) == list(inspect.signature(THEIRS[name]).parameters)
    mine, other = made(name, liquid()), made(name, liquid(), by_ase=True)
    assert mine.todict() == other.todict()
    public = {key for key in vars(other) if not key.startswith("_")}
    assert all(hasattr(mine, key) for key in public), public
    numbers = {key: value for key, value in vars(other).items() if isinstance(value, bool | int | float | None)}
    assert numbers == {key: getattr(mine, key) for key in numbers}


@pytest.mark.parametrize("name", DETERMINISTIC)
@pytest.mark.parametrize("scene", [liquid, copper])
def test_motion_without_noise_is_that_of_ase(name, scene):
    atoms, reference = scene(), scene()
    mine, other = made(name, atoms), made(name, reference, by_ase=True)
    start = atoms.positions.copy()
    with warnings.catch_warnings(action="ignore"):
        for dynamics in (mine, other):
            dynamics.run(30)
            dynamics.run(20)
    assert same(atoms.positions, reference.positions, 1e-11)
    assert same(atoms.get_momenta(), reference.get_momenta(), 1e-9)
    assert np.abs(atoms.positions - start).max() > 0.1
    if name == "NoseHooverChainNVT":
        assert mine.get_conserved_energy() == pytest.approx(other.get_conserved_energy(), rel=1e-11)


@pytest.mark.parametrize("kelvin", [1.0, 1e5])
def test_berendsen_rescales_within_the_bounds_of_ase(kelvin):
    ends = []
    for by_ase in (False, True):
        atoms = liquid()
        made("NVTBerendsen", atoms, by_ase=by_ase, temperature_K=kelvin, taut=TIMESTEP).run(3)
        ends.append(atoms.get_momenta())
    assert same(*ends, 1e-11)


@pytest.mark.parametrize("name", ARGUMENTS)
def test_files_hold_what_those_of_ase_hold_with_stress(name, tmp_path):
    frames, keys = {}, {}
    for who in ("ours", "ASE's"):
        file = tmp_path / f"{who}.traj"
        for append in (False, True):
            with made(
                name, liquid(), by_ase=who != "ours", trajectory=str(file), loginterval=5, append_trajectory=append
            ) as dynamics:
                dynamics.run(10)
        frames[who] = ase.io.read(file, ":")
        keys[who] = [sorted(frame.calc.results) for frame in frames[who]]
    assert keys["ours"] == keys["ASE's"]
    assert all("stress" in one for one in keys["ours"])
    assert len(frames["ours"]) == 6
    for frame in frames["ours"]:
        again = liquid()
        again.positions[:] = frame.positions
        assert same(frame.get_stress(), again.get_stress(), 1e-11)
        assert frame.get_potential_energy() == pytest.approx(again.get_potential_energy(), rel=1e-12)


TUTORIAL = """
from ase.io.trajectory import Trajectory
from ase.lattice.cubic import FaceCenteredCubic
from ase.md import MDLogger
from ase.md.velocitydistribution import Stationary, thermalize_momenta

atoms = FaceCenteredCubic(directions=[[1, 0, 0], [0, 1, 0], [0, 0, 1]], symbol="Ar", latticeconstant=5.4, size=(3, 3, 3), pbc=True)
atoms.calc = calculator
thermalize_momenta(atoms, 80, rng=np.random.RandomState(3))
Stationary(atoms)
dyn = VelocityVerlet(atoms, 5 * units.fs, trajectory=str(folder / "md.traj"), logfile=str(folder / "md.log"))

def printenergy(a=atoms):
    epot, ekin = a.get_potential_energy() / len(a), a.get_kinetic_energy() / len(a)
    print(f"Energy per atom: Epot = {epot:.3f}eV  Ekin = {ekin:.3f}eV (T={ekin / (1.5 * units.kB):3.0f}K)  Etot = {epot + ekin:.3f}eV")

dyn.attach(printenergy, interval=10)
dyn.attach(MDLogger(dyn, atoms, str(folder / "stress.log"), header=True, stress=True, peratom=True, mode="w"), interval=25)
dyn.attach(Trajectory(str(folder / "own.traj"), "w", atoms).write, interval=20)
printenergy()
dyn.run(200)
"""


def test_a_tutorial_of_ase_runs_with_another_import(tmp_path):
    printed, frames = {}, {}
    for who, cls in (("ours", ours.VelocityVerlet), ("theirs", ase.md.verlet.VelocityVerlet)):
        folder = tmp_path / who
        folder.mkdir()
        names = {
            "np": np,
            "units": ase.units,
            "VelocityVerlet": cls,
            "folder": folder,
            "calculator": Calculator(lennard_jones()),
        }
        with redirect_stdout(io.StringIO()) as output:
            exec(TUTORIAL, names)
        printed[who] = output.getvalue(), (folder / "md.log").read_text(), (folder / "stress.log").read_text()
        frames[who] = [*ase.io.read(folder / "md.traj", ":"), *ase.io.read(folder / "own.traj", ":")]
    assert printed["ours"] == printed["theirs"]  # character for character
    for mine, other in zip(frames["ours"], frames["theirs"], strict=True):
        assert np.abs(mine.positions - other.positions).max() < 1e-9
        assert np.abs(mine.get_momenta() - other.get_momenta()).max() < 1e-9
        assert same(mine.get_stress(), other.get_stress(), 1e-9)


def test_a_step_or_a_log_of_somebody_else_is_called_at_every_step():
    class Counting(ours.VelocityVerlet):
        steps = logs = 0

        def step(self, forces=None):
            self.steps += 1
            return super().step(forces)

    class Logging(ours.VelocityVerlet):
        logs = 0

        def log(self):
            self.logs += 1

    counting, logging, plain = (
        Counting(liquid(), TIMESTEP),
        Logging(liquid(), TIMESTEP),
        ours.VelocityVerlet(liquid(), TIMESTEP),
    )
    assert all(dynamics.run(7) is True for dynamics in (counting, logging, plain))
    assert (counting.steps, counting.nsteps, logging.logs) == (7, 7, 8)
    assert same(counting.atoms.positions, plain.atoms.positions)


# Calculators


def test_other_calculators_are_asked_once_per_step_and_said_so_once():
    atoms, calls = copper(), []
    calculate = atoms.calc.calculate
    atoms.calc.calculate = lambda *arguments: calls.append(1) or calculate(*arguments)
    dynamics = ours.VelocityVerlet(atoms, TIMESTEP)
    with pytest.warns(UserWarning, match=r"the calculator is EMT, not minimd\.ase\.Calculator") as told:
        dynamics.run(5)
    atoms.set_masses(1.1 * atoms.get_masses())
    with warnings.catch_warnings(action="error"):
        dynamics.run(5)
        list(dynamics.irun(5))
        atoms.get_potential_energy()
        atoms.get_stress()
    assert len(told) == 1
    assert len(calls) == 16


def test_a_calculator_sees_the_atoms_with_all_they_carry():
    class Charged(LennardJones):
        def calculate(self, atoms=None, *arguments):
            assert atoms.get_initial_charges()[0] == 0.5
            assert atoms.info["name"] == "copper"
            super().calculate(atoms, *arguments)

    atoms = copper(Charged(sigma=2.3, epsilon=0.4, rc=5.0))
    atoms.set_initial_charges([0.5, -0.5, 0.0, 0.0])
    atoms.info["name"] = "copper"
    with pytest.warns(UserWarning, match="Charged") as told:
        ours.VelocityVerlet(atoms, TIMESTEP).run(3)
    assert len(told) == 1  # not that charges are not used


def test_a_calculator_whose_parameters_an_observer_has_changed_is_asked_again():
    ends = []
    for cls in (ours.VelocityVerlet, ase.md.verlet.VelocityVerlet):
        atoms = copper(LennardJones(sigma=2.3, epsilon=0.4, rc=5.0))

        def deepen(calculator=atoms.calc):
            calculator.parameters.epsilon *= 1.2
            calculator.reset()

        dynamics = cls(atoms, TIMESTEP)
        dynamics.attach(deepen, 2)
        with warnings.catch_warnings(action="ignore"):
            dynamics.run(9)
        ends.append(np.hstack([atoms.positions, atoms.get_momenta()]))
    assert same(*ends, 1e-11)


def test_a_simulation_takes_a_calculator_of_ase_for_a_potential():
    expected = md.Simulation(copper(), ForcesFromCalculator(EMT()), md.VelocityVerlet(TIMESTEP)).run(10, every=5)
    with pytest.warns(UserWarning, match="the calculator is EMT") as told:
        simulation = md.Simulation(copper(), EMT(), md.VelocityVerlet(TIMESTEP))
    record = simulation.run(10, every=5)
    assert len(told) == 1
    assert np.array_equal(record.total_energy, expected.total_energy)
    assert np.array_equal(record.pressure, expected.pressure)
    with warnings.catch_warnings(action="ignore"):
        both = md.evaluate(copper(), [EMT(), ForcesFromCalculator(EMT())])
    assert same(both.forces, 2.0 * copper().get_forces())
    assert (
        md.Simulation(liquid(), Calculator(lennard_jones()), md.VelocityVerlet(TIMESTEP)).potentials[0].cutoff
        == lennard_jones().cutoff
    )
    with pytest.raises(TypeError, match="potentials must be potentials of minimd"):
        md.Simulation(copper(), "EMT", md.VelocityVerlet(TIMESTEP))


# Constraints


@pytest.mark.filterwarnings("ignore:the calculator is")
@pytest.mark.parametrize("name", ARGUMENTS)
def test_atoms_that_are_fixed_stay_and_other_constraints_are_refused_by_name(name):
    atoms = copper()
    atoms.set_constraint(FixAtoms([0, -1]))
    atoms.set_momenta(atoms.get_momenta())
    before = atoms.positions.copy()
    dynamics = made(name, atoms)
    dynamics.run(3)
    dynamics.run(3)
    assert (np.abs(atoms.positions - before).max(axis=1) > 0.0).tolist() == [False, True, True, False]
    atoms.set_constraint(FixedPlane(0, (0, 0, 1)))
    with pytest.raises(ValueError, match="it holds FixedPlane"):
        dynamics.run(1)


@pytest.mark.filterwarnings("ignore:the calculator is")
@pytest.mark.parametrize("name", ["VelocityVerlet", "Langevin", "Bussi", "NoseHooverChainNVT"])
def test_lengths_are_kept_whoever_counts_the_atoms_from_the_end(name):
    water, gas = molecule("H2O"), molecule("CO2")
    water.set_constraint(FixBondLengths([(0, 1), (0, -1), (-2, -1)]))
    gas.set_constraint(FixLinearTriatomic(triples=[(-2, -3, -1)]))
    for atoms in (water, gas):
        atoms.calc = EMT()
        atoms.set_momenta(np.random.default_rng(4).normal(0.0, 0.3, (3, 3)))
        lengths, there = atoms.get_all_distances(), atoms.positions.copy()
        dynamics = made(name, atoms)
        for _ in range(4):
            dynamics.run(3)
        assert np.abs(atoms.get_all_distances() - lengths).max() < 1e-10
        assert np.abs(atoms.positions - there).max() > 1e-3


class Wind(IdealGas):
    """A force that is the same on all atoms."""

    def calculate(self, atoms=None, *arguments):
        super().calculate(atoms, *arguments)
        self.results["forces"] = np.full((len(atoms), 3), 0.1)


@pytest.mark.filterwarnings("ignore:the calculator is")
@pytest.mark.parametrize("name", ARGUMENTS)
def test_a_center_that_is_fixed_stays_whatever_the_forces(name):
    atoms = copper(Wind())
    atoms.set_constraint(FixCom())
    atoms.set_momenta(atoms.get_momenta())
    atoms.set_masses([20.0, 30.0, 60.0, 90.0])
    atoms.set_momenta(atoms.get_momenta())
    center, start = atoms.get_center_of_mass(), atoms.positions.copy()
    made(name, atoms).run(20)
    assert np.abs(atoms.get_center_of_mass() - center).max() < 1e-10
    assert np.abs(atoms.positions - start).max() > 0.1


def test_atoms_without_a_calculator_are_refused():
    atoms = copper()
    atoms.calc = None
    with pytest.raises(RuntimeError, match="calculator"):
        ours.VelocityVerlet(atoms, TIMESTEP).run(1)
    with pytest.raises(RuntimeError, match=r"set atoms\.calc"):
        ours.VelocityVerlet(atoms, TIMESTEP).step()


PAGE = Path(__file__).parents[1] / "docs" / "ase.md"


@pytest.mark.filterwarnings("ignore:the calculator is")
@pytest.mark.parametrize(
    "script", re.findall(r"```python\n(.*?)```", PAGE.read_text(encoding="utf-8"), re.S), ids=["dynamics", "simulation"]
)
def test_the_scripts_of_the_page_run(script, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    exec(compile(script.replace("repeat(4)", "repeat(2)"), str(PAGE), "exec"), {})
    assert capsys.readouterr().out.strip()


def test_a_barostat_is_refused_by_name():
    with (
        pytest.raises(NotImplementedError, match=r"externalstress.*needs a constant cell"),
        warnings.catch_warnings(action="ignore"),
    ):
        ours.LangevinBAOAB(liquid(), TIMESTEP, temperature_K=80.0, externalstress=-0.01, rng=1)


def test_an_open_trajectory_is_written_to(tmp_path):
    with Trajectory(tmp_path / "a.traj", "w") as trajectory:
        atoms = liquid()
        with ours.VelocityVerlet(atoms, TIMESTEP) as dynamics:
            dynamics.attach(trajectory.write, 5, atoms)
            dynamics.run(10)
    assert len(ase.io.read(tmp_path / "a.traj", ":")) == 3
