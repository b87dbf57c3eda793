"""Our VelocityVerlet for ASE's atoms: ASE's motion, observers, files and errors."""

import ase.io
import ase.units
import numpy as np
import pytest
from argon_atoms import CUTOFF, EPSILON, SIGMA, TIMESTEP, argon, ase_lennard_jones, lennard_jones, same, with_calculator
from ase.md.verlet import VelocityVerlet as ASEVelocityVerlet

import minimd as md
from minimd.ase import Calculator, VelocityVerlet, system_from_atoms

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
    assert_same_motion(
        with_calculator(argon(), Calculator(lennard_jones())), with_calculator(argon(), calculator), 1000
    )


def observed(dynamics_class, folder, drive):
    """Everything an observer can see of a driven run."""
    seen = []
    atoms = with_calculator(argon(2), Calculator(lennard_jones()))
    dynamics = dynamics_class(
        atoms, TIMESTEP, trajectory=str(folder / "a.traj"), logfile=str(folder / "a.log"), loginterval=10
    )

    def look(name):
        seen.append(
            (
                name,
                dynamics.nsteps,
                dynamics.get_time(),
                atoms.get_potential_energy(),
                atoms.get_kinetic_energy(),
                *atoms.positions[0],
            )
        )

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
    "stopped from inside": lambda dynamics: (
        dynamics.attach(lambda: setattr(dynamics, "max_steps", 0), -17),
        dynamics.run(40),
        dynamics.nsteps,
    )[1:],
}


@pytest.mark.parametrize("drive", DRIVES)
def test_observers_files_and_answers_are_those_of_ase(drive, tmp_path):
    (tmp_path / "ours").mkdir()
    (tmp_path / "theirs").mkdir()
    seen, frames, log, answers = observed(VelocityVerlet, tmp_path / "ours", DRIVES[drive])
    expected_seen, expected_frames, expected_log, expected_answers = observed(
        ASEVelocityVerlet, tmp_path / "theirs", DRIVES[drive]
    )
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
    monkeypatch.setattr(
        md.Forces, "compute", lambda forces, detail, *unit: calls.append(detail) or compute(forces, detail, *unit)
    )
    monkeypatch.setattr(md.Forces, "march", lambda *_arguments: 0)  # all steps made one by one, so that each is counted
    atoms = with_calculator(argon(), Calculator(lennard_jones(), skin=1.0))
    dynamics = VelocityVerlet(atoms, TIMESTEP)
    dynamics.attach(lambda: None, 10)
    dynamics.run(1)
    calls.clear()
    dynamics.run(50)
    assert len(calls) == 50  # none at the start of a block: it goes on where the one before has ended
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


def test_after_a_blow_up_the_atoms_hold_the_last_good_state():
    atoms = with_calculator(argon(2, temperature=1e5), Calculator(lennard_jones()))
    dynamics = VelocityVerlet(atoms, 100 * ase.units.fs)
    with pytest.raises(md.NonFiniteError, match="timestep"):
        dynamics.run(1000)
    assert np.isfinite(atoms.positions).all()
    assert np.isfinite(atoms.get_momenta()).all()
    assert dynamics.nsteps < 1000
