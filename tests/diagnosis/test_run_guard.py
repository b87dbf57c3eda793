"""Runs that fail, and runs that are watched: the step is found, a good state is kept, and the true cause is told."""

import ase.build
import numpy as np
import pytest
from ase import units
from ase.calculators.emt import EMT
from ase.calculators.lj import LennardJones
from ase.md.velocitydistribution import thermalize_momenta
from scenes import LJ, SCENES
from wrong_calls import assert_answered

import minimd as md
from minimd.ase import Calculator, ForcesFromCalculator, Langevin, VelocityVerlet
from minimd.diagnosis import run_guard
from minimd.diagnosis.run_guard import BLOCK

IN_A_BATH = {"temperature_K": 300, "friction": 0.01 / units.fs}
TOO_LONG = 60.0 * units.fs  # of copper, whose limit is 41 fs


def failure(run, *arguments, **options):
    with pytest.raises(md.NonFiniteError) as caught:
        run(*arguments, **options)
    return caught.value


def test_a_failure_is_judged_by_the_energy_of_its_own_positions(monkeypatch):
    """A method that ends with a drift has not evaluated forces at its last positions; the replay of a failure does."""
    judged, runaway = [], run_guard.runaway

    def judge(engine, *by):
        judged.append((engine.interactions.potential_energy, md.evaluate(engine.system, [LJ]).potential_energy))
        return runaway(engine, *by)

    monkeypatch.setattr(run_guard, "runaway", judge)
    failure(SCENES["argon"]().simulation(md.PositionVerlet(0.03)).run, 4000)
    held, true = np.array(judged).T
    assert len(judged) > 1
    assert held == pytest.approx(true, rel=1e-9)  # rounding


def test_what_is_no_count_or_no_end_is_refused_and_no_steps_are_none(tmp_path):
    """What is refused leaves the last record and the state."""
    sim, file = SCENES["argon"]().simulation(), tmp_path / "a.h5md"
    record, before = sim.run(0, trajectory=file), sim.positions.copy()
    with pytest.raises(FileExistsError):
        sim.run(10, trajectory=file)
    for name, make in [
        ("n_steps", sim.run),
        ("until_step", lambda n: sim.run(until_step=n)),
        ("n_steps", sim.make_steps),
        ("n_steps", lambda n: sim.equilibrate(n, 1.0)),
        ("max_steps", lambda n: sim.minimize(max_steps=n)),
    ]:
        for count in (True, 2.0, -1, "3"):
            assert_answered(lambda make=make, count=count: make(count), ValueError, name, repr(count))
    for both in ({}, {"n_steps": 5, "until_step": 5}):
        assert_answered(lambda both=both: sim.run(**both), ValueError, "n_steps", "until_step")
    assert sim.record is record
    sim.make_steps(0)
    assert len(sim.run(np.int64(0))) == 1
    assert sim.step == 0
    assert np.array_equal(sim.positions, before)


def copper(calculator=None):
    atoms = ase.build.bulk("Cu", cubic=True).repeat(2)
    atoms.calc = EMT() if calculator is None else calculator
    thermalize_momenta(atoms, 300, rng=np.random.default_rng(1))
    return atoms


def nitrogen(timestep):
    system = md.System([[0, 0, 0], [1.12, 0, 0]], masses=14.0, bonds=[[0, 1]], units=md.units.ASE, cell=20.0)
    return md.Simulation(system, md.HarmonicBond(100.0, 1.1), md.VelocityVerlet(timestep * units.fs))


@pytest.mark.filterwarnings("ignore:the calculator is EMT", "ignore:timestep")
@pytest.mark.parametrize("bath", [{}, pytest.param(IN_A_BATH, marks=pytest.mark.slow)], ids=["alone", "bath"])
def test_a_calculator_of_others_fails_at_its_step_for_its_cause(bath, tmp_path):
    """ASE alone has 11.5 eV after the first step and 2.4e5 eV after the second; where each step is looked at, too."""
    atoms = copper()
    start, run = atoms.get_total_energy(), (Langevin if bath else VelocityVerlet)(atoms, TOO_LONG, **bath)
    found = failure(run.run, 300).crash_report
    assert run.nsteps == found.last_good_step == found.step - 1 <= 2
    assert abs(atoms.get_total_energy() - start) < 5.0  # one kinetic energy
    assert found.kind == "step"
    assert f"timestep 60 fs too large: {run.method().name} is stable up to " in found.cause
    assert "as advise_timestep recommends" in found.advice
    if not bath:
        limit = md.advise_timestep(atoms, ForcesFromCalculator(EMT())).limit
        assert f"up to {md.units.ASE.shown(limit)[:2]}" in found.cause
        run = VelocityVerlet(copper(), TOO_LONG, logfile=str(tmp_path / "a.log"), loginterval=1)
        assert "At step 2: the total energy has gone from 0.735 to 2.4" in str(failure(run.run, 300))
        assert run.nsteps == 1


@pytest.mark.filterwarnings("ignore:the calculator is EMT")
def test_what_others_do_between_two_steps_is_no_runaway():
    """Atoms that are pushed, a calculator that is another from now on, a run of its own; a heat that was asked for."""
    atoms = copper(LennardJones(sigma=2.3, epsilon=1e-6, rc=5.0))
    atoms.set_momenta(1e-3 * atoms.get_momenta())
    run = VelocityVerlet(atoms, 1.0 * units.fs)
    run.attach(lambda: setattr(atoms, "calc", EMT()) if run.nsteps >= 4 else None, 2)
    run.attach(lambda: atoms.set_momenta(1e3 * atoms.get_momenta()), -8)
    run.run(12)
    atoms.set_momenta(1e3 * atoms.get_momenta())
    run.run(2)
    assert run.nsteps == 14
    simulation = nitrogen(1.0)
    simulation.run(10)
    simulation.set_temperature(3e8, seed=1)
    simulation.make_steps(2 * BLOCK)
    assert simulation.step == 10 + 2 * BLOCK


@pytest.mark.filterwarnings("ignore:timestep")
def test_a_bond_beyond_its_limit_fails_at_once_with_the_advice_of_advise_timestep(tmp_path):
    """Run by a Simulation, in an equilibration, and as dynamics of ASE."""
    warm, simulation, law = nitrogen(8.0), nitrogen(8.0), md.HarmonicBond(100.0, 1.1, pairs=[[0, 1]])
    warm.set_temperature(300, seed=1)
    assert failure(warm.equilibrate, 300, 300.0, every=50).crash_report.step == warm.step + 1 < 5
    atoms = ase.Atoms("N2", simulation.positions, cell=[20] * 3, pbc=True, calculator=Calculator(law))
    of_ase = failure(VelocityVerlet(atoms, 8.0 * units.fs).run, 300)
    error = failure(simulation.run, 300, crash_report=tmp_path / "a.crash.h5md")
    seen = md.replay(error.file, simulation.potentials)  # fails where the run did
    assert (seen.failed_at, [row.step for row in seen.rows]) == (1, [0])
    assert [atoms.get_total_energy(), simulation.frame().observables["total_energy"]] == pytest.approx([0.02] * 2)
    for found, system in ((of_ase.crash_report, atoms), (error.crash_report, simulation.system)):
        recommended = md.advise_timestep(system, law).recommended
        assert (found.step, found.last_good_step) == (1, 0)
        assert f"take {md.units.ASE.shown(recommended)}, as advise_timestep recommends" in found.advice


@pytest.mark.filterwarnings("ignore:timestep")
def test_a_mode_that_grows_slowly_is_followed_back_to_a_good_state_and_replayed_in_units(tmp_path):
    """Δt·ω = 2.0004: energies grow by some 8 % in a step, and raise the alarm two blocks after the last good state."""
    simulation = nitrogen(1.0)
    simulation.method = md.VelocityVerlet(2.0004 / (100.0 / 7.0) ** 0.5)
    error = failure(simulation.run, 3000, every=1000, crash_report=tmp_path / "a.crash.h5md")
    assert error.crash_report.step == simulation.step + 1
    assert "has gone from 0.02 to" in str(error)
    assert simulation.frame().observables["total_energy"] < 0.06  # twice K + |U| of the start, and a step
    seen = md.replay(error.file, simulation.potentials, picture=False, trajectory=False)
    assert seen.failed_at == error.crash_report.step
    lines = str(seen).splitlines()
    last = next(line for line in lines if line.startswith(f"{simulation.step:>8}"))
    assert lines[1].split() == ["ps", "eV", "Å", "eV/Å", "Å/ps"]
    assert float(last.split()[1]) == pytest.approx(simulation.time / md.units.ps, rel=1e-4)
