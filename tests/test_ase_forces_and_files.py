"""ASE's calculators as forces of a Simulation, and trajectories that ASE reads."""

import warnings

import ase.io
import ase.units
import numpy as np
import pytest
from argon_atoms import CUTOFF, EPSILON, SIGMA, TIMESTEP, argon, ase_lennard_jones, lennard_jones, same, with_calculator
from ase.build import bulk, molecule
from ase.calculators.emt import EMT
from ase.calculators.lj import LennardJones

import minimd as md
from minimd.ase import Calculator, ForcesFromCalculator, system_from_atoms

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
    record = simulation.run(
        25, every=10, trajectory=tmp_path / name, store_forces=store_forces, observers=[simulation_state]
    )
    frames = ase.io.read(tmp_path / name, ":", format="traj" if decimals is None else "extxyz")
    assert len(frames) == len(kept) == 3
    tolerance = 1e-14 if decimals is None else 0.51 * 10.0**-decimals
    masses = simulation.system.masses[:, None]
    for frame, energy, (step, time, positions, velocities, forces) in zip(
        frames, record.potential_energy, kept, strict=True
    ):
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
