"""Energies that run away within a block: the step is found, the state that is kept is a good one, and the cause is named."""

import ase.build
import ase.io
import numpy as np
import pytest
from ase import units
from ase.calculators.emt import EMT
from ase.md.velocitydistribution import thermalize_momenta

import minimd as md
from minimd.ase import Calculator, ForcesFromCalculator, VelocityVerlet
from minimd.diagnosis.run_guard import BLOCK

TOO_LONG = 60.0 * units.fs  # of copper, whose limit is 41 fs


def copper(calculator=None):
    atoms = ase.build.bulk("Cu", cubic=True).repeat(2)
    atoms.calc = EMT() if calculator is None else calculator
    thermalize_momenta(atoms, 300, rng=np.random.default_rng(1))
    return atoms


def nitrogen(timestep):
    system = md.System([[0, 0, 0], [1.12, 0, 0]], masses=14.0, bonds=[[0, 1]], units=md.units.ASE, cell=20.0)
    return md.Simulation(system, md.HarmonicBond(100.0, 1.1), md.VelocityVerlet(timestep * units.fs))


def failure(run, *arguments, **options):
    with pytest.raises(md.NonFiniteError) as caught:
        run(*arguments, **options)
    return caught.value


@pytest.mark.filterwarnings("ignore:the calculator is EMT", "ignore:timestep")
@pytest.mark.parametrize(
    "dynamics",
    [VelocityVerlet, lambda atoms, step: md.ase.Langevin(atoms, step, temperature_K=300, friction=0.01 / units.fs)],
)
def test_a_calculator_of_others_fails_at_its_step_for_its_cause(dynamics):
    """ASE alone, step by step, has 11.5 eV after the first step and 2.4e5 eV after the second."""
    atoms = copper()
    start, run = atoms.get_total_energy(), dynamics(atoms, TOO_LONG)
    error = failure(run.run, 300)
    found = error.crash_report
    assert run.nsteps == found.last_good_step == found.step - 1 <= 2
    assert abs(atoms.get_total_energy() - start) < 5.0  # one kinetic energy
    assert found.kind == "step"
    limit = md.advise_timestep(atoms, ForcesFromCalculator(EMT()))
    shown = md.units.ASE.shown
    assert f"timestep 60 fs too large: {run.method().name} is stable up to {shown(limit.limit)[:2]}" in found.cause
    assert "as advise_timestep recommends" in found.advice


@pytest.mark.filterwarnings("ignore:the calculator is EMT")
def test_energies_are_compared_with_those_at_the_start_of_the_run(tmp_path):
    """Also where every step is looked at, and each block is one step."""
    atoms = copper()
    run = VelocityVerlet(atoms, TOO_LONG, logfile=str(tmp_path / "a.log"), loginterval=1)
    error = failure(run.run, 300)
    assert "At step 2: the total energy has gone from 0.735 to 2.4" in str(error)
    assert run.nsteps == 1


@pytest.mark.filterwarnings("ignore:the calculator is EMT")
def test_what_others_do_between_two_steps_is_no_runaway():
    """Atoms that are pushed, a calculator that is another from now on, a run of its own."""

    class Scaled(EMT):
        factor = 1e-6

        def calculate(self, *arguments):
            super().calculate(*arguments)
            self.results = {name: self.factor * np.asarray(value) for name, value in self.results.items()}
            self.results["energy"] = self.results["free_energy"] = float(self.results["energy"])

        def check_state(self, atoms, tol=1e-15):
            return super().check_state(atoms, tol) or ["positions"]

    atoms = copper(Scaled())
    atoms.set_momenta(1e-3 * atoms.get_momenta())
    atoms.rattle(0.1, seed=1)
    run = VelocityVerlet(atoms, 1.0 * units.fs)
    run.attach(lambda: setattr(atoms.calc, "factor", 1.0 if run.nsteps >= 4 else 1e-6), 2)
    run.attach(lambda: atoms.set_momenta(1e3 * atoms.get_momenta()), -8)
    run.run(12)
    atoms.set_momenta(1e3 * atoms.get_momenta())
    run.run(2)
    assert run.nsteps == 14


@pytest.mark.filterwarnings("ignore:timestep")
@pytest.mark.parametrize("way", ["simulation", "ase"])
def test_a_bond_beyond_its_limit_fails_at_once_with_the_advice_of_advise_timestep(way):
    simulation = nitrogen(8.0)
    if way == "ase":
        atoms = ase.Atoms("N2", simulation.positions, cell=[20] * 3, pbc=True)
        atoms.calc = Calculator(md.HarmonicBond(100.0, 1.1, pairs=[[0, 1]]))
        error = failure(VelocityVerlet(atoms, 8.0 * units.fs).run, 300)
        energy, system = atoms.get_total_energy(), atoms
    else:
        error = failure(simulation.run, 300)
        energy, system = simulation.frame().observables["total_energy"], simulation.system
    found = error.crash_report
    assert (found.step, found.last_good_step) == (1, 0)
    assert energy == pytest.approx(0.02)
    recommended = md.advise_timestep(system, md.HarmonicBond(100.0, 1.1, pairs=[[0, 1]])).recommended
    assert f"take {md.units.ASE.shown(recommended)}, as advise_timestep recommends" in found.advice


@pytest.mark.filterwarnings("ignore:timestep")
def test_a_mode_that_grows_slowly_is_followed_back_to_a_good_state(tmp_path):
    """Δt·ω = 2.0004: energies grow by some 8 % in a step, and raise the alarm two blocks after the last good state."""
    simulation = nitrogen(1.0)
    omega = (100.0 / 7.0) ** 0.5
    simulation.method = md.VelocityVerlet(2.0004 / omega)
    error = failure(simulation.run, 3000, every=1000, crash_report=tmp_path / "a.crash.h5md")
    found = error.crash_report
    assert found.step == simulation.step + 1
    assert "has gone from 0.02 to" in str(error)
    kept = simulation.frame().observables
    assert kept["total_energy"] < 0.06  # twice K + |U| of the start, and a step
    seen = md.replay(error.file, simulation.potentials, picture=False, trajectory=False)
    assert seen.failed_at == found.step
    assert "failed again" in seen.ending


@pytest.mark.filterwarnings("ignore:timestep")
def test_a_replay_fails_where_the_run_did(tmp_path):
    simulation = nitrogen(8.0)
    simulation.run(0)
    error = failure(simulation.run, 300, crash_report=tmp_path / "a.crash.h5md")
    seen = md.replay(error.file, simulation.potentials)
    assert seen.failed_at == error.crash_report.step == 1
    assert [row.step for row in seen.rows] == [0]


@pytest.mark.filterwarnings("ignore:timestep")
def test_an_equilibration_fails_at_its_step():
    simulation = nitrogen(8.0)
    simulation.set_temperature(300, seed=1)
    error = failure(simulation.equilibrate, 300, 300.0, every=50)
    assert error.crash_report.step == simulation.step + 1 < 5


def test_steps_without_a_look_are_watched_too():
    simulation = nitrogen(1.0)
    simulation.run(10)
    simulation.set_temperature(3e8, seed=1)
    simulation.make_steps(2 * BLOCK)  # hot, as it was told to be
    assert simulation.step == 10 + 2 * BLOCK
