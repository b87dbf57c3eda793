"""Constraints beside LAMMPS' reference numbers, and beside ASE's."""

import copy

import ase
import numpy as np
import pytest
from ase import units
from ase.constraints import FixAtoms, FixBondLengths, FixCom, FixLinearTriatomic
from ase.md.verlet import VelocityVerlet
from references import fourmol, load
from test_reference_lammps import FTM2V, SCALE, coefficients, harmonic_angles, per_term

import minimd as md
from minimd import ase as bridge
from minimd.ase import Calculator
from minimd.potentials.term import Term

BOND_LENGTHS = {5: 1.0, 2: 1.1, 3: 1.3}  # r0 of the constrained bond types [Å]
WATER_ANGLE = np.radians(110.1)


def constrained_fourmol(pairs, lengths, angle_atoms):
    """LAMMPS' molecules with some bonds rigid: the harmonic terms of these bonds, and of the angles over angle_atoms, are left out."""
    system, table = fourmol()
    rigid = {tuple(sorted(pair)) for pair in pairs}
    kept_bonds = [bond for bond in table["bonds"] if tuple(sorted((bond[1] - 1, bond[2] - 1))) not in rigid]
    kept_angles = [angle for angle in table["angles"] if angle[2] - 1 not in angle_atoms]
    own, unlike = coefficients(load("lammps_fourmol/mol-pair-lj_cut.json")["pair_coeff"])
    lj = md.LennardJones(own, cutoff=8.0, truncation="truncated", pairs=unlike, mixing="geometric", bonded_scale=SCALE)
    k, length = per_term(load("lammps_fourmol/bond-harmonic.json")["bond_coeff"], np.array(kept_bonds)[:, 0])
    bond = md.HarmonicBond(2.0 * k, length, pairs=np.array(kept_bonds)[:, 1:] - 1)
    angle = harmonic_angles({"angles": kept_angles}, load("lammps_fourmol/angle-harmonic.json")["angle_coeff"])
    system = fourmol(masses=system.masses / FTM2V)[0]
    simulation = md.Simulation(
        system, [lj, bond, angle], md.VelocityVerlet(0.25), md.DistanceConstraints(pairs, lengths)
    )
    with pytest.warns(UserWarning, match="projected onto the constraints"):
        simulation.run(8, every=8)
    return simulation


def test_rattle_of_three_waters():
    """Bonds and angles of molecules 3, 4 and 5 as distances."""
    oxygens = [17, 20, 23]
    pairs = [pair for o in oxygens for pair in ((o, o + 1), (o, o + 2), (o + 1, o + 2))]
    simulation = constrained_fourmol(pairs, np.tile([1.0, 1.0, 2.0 * np.sin(WATER_ANGLE / 2.0)], 3), oxygens)
    reference = load("lammps_fourmol/fix-timestep-rattle_angle.json")
    assert [group.shape for group in simulation.engine.constraint_set.bonds.groups] == ["triangles"]
    off = (
        np.abs(simulation.positions - reference["run_pos"]).max(),
        np.abs(simulation.velocities - reference["run_vel"]).max(),
    )
    print(f"{off[0]:.1e} Å, {off[1]:.1e} Å/fs off")
    assert np.abs(simulation.positions - reference["run_pos"]).max() < 2e-10
    assert np.abs(simulation.velocities - reference["run_vel"]).max() < 2e-10


def test_shake_of_the_hydrogens_of_the_solute():
    """Bonds of molecules 1 and 2 to atoms of mass 4.00794. LAMMPS does not project velocities here."""
    system, table = fourmol()
    solute = np.isin(table["mol"], (1, 2))
    light = solute & np.isclose(system.masses, 4.00794)
    bonds = [bond for bond in table["bonds"] if solute[bond[1] - 1] and (light[bond[1] - 1] or light[bond[2] - 1])]
    pairs = [(bond[1] - 1, bond[2] - 1) for bond in bonds]
    simulation = constrained_fourmol(pairs, [BOND_LENGTHS[bond[0]] for bond in bonds], [])
    reference = load("lammps_fourmol/fix-timestep-shake_bond.json")
    off = (
        np.abs(simulation.positions - reference["run_pos"]).max(),
        np.abs(simulation.velocities - reference["run_vel"]).max(),
    )
    print(f"{off[0]:.1e} Å, {off[1]:.1e} Å/fs off")
    assert np.abs(simulation.positions - reference["run_pos"]).max() < 2e-10


def nitrogen(constraint=None):
    """27 molecules in a cubic box, with velocities that keep their lengths."""
    rng = np.random.default_rng(1)
    arms = rng.normal(size=(27, 3))
    arms *= 0.55 / np.linalg.norm(arms, axis=1)[:, None]
    centers = 4.0 * np.array([[i, j, k] for i in range(3) for j in range(3) for k in range(3)]) + 0.2
    positions = np.stack([centers - arms, centers + arms], axis=1).reshape(-1, 3)
    atoms = ase.Atoms("N" * 54, positions, cell=[12.0] * 3, pbc=True)
    atoms.set_constraint(FixBondLengths(np.arange(54).reshape(-1, 2)) if constraint is None else constraint)
    atoms.set_velocities(np.random.default_rng(3).normal(size=(54, 3)) * 0.03)
    return atoms


def nitrogen_law():
    return md.LennardJones(0.0031, 3.3, cutoff=5.0, truncation="force-shifted", bonded_scale=(0, 1, 1))


@pytest.mark.slow
def test_500_steps_of_27_rigid_molecules_beside_ase():
    bonds = np.arange(54).reshape(-1, 2)
    atoms, same = nitrogen(), nitrogen()
    simulation = md.Simulation(md.System.from_ase(same, bonds=bonds), nitrogen_law(), md.VelocityVerlet(units.fs))
    simulation.run(500, every=500)
    atoms.calc = Calculator(nitrogen_law(), bonds=bonds)
    VelocityVerlet(atoms, units.fs).run(500)
    assert np.abs(simulation.positions - nitrogen().positions).max() > 1.0
    print(f"{np.abs(simulation.positions - atoms.positions).max():.1e} Å off")
    assert np.abs(simulation.positions - atoms.positions).max() < 1e-9
    assert np.abs(simulation.velocities - atoms.get_velocities()).max() < 1e-9


@pytest.mark.parametrize(
    "constraint",
    [
        FixBondLengths(np.arange(54).reshape(-1, 2)),
        FixAtoms([0, 5, 7]),
        FixLinearTriatomic(np.array([[0, 1, 2], [10, 11, 12]])),
        [FixBondLengths([[0, 1], [2, 3]]), FixAtoms([9])],
    ],
    ids=["bonds", "atoms", "rods", "both"],
)
def test_constraints_of_ase_are_kept_as_ase_keeps_them(constraint):
    atoms, same = nitrogen([]), nitrogen([])
    for scene in (atoms, same):
        scene.positions[[2, 12]] = 2.0 * scene.positions[[1, 11]] - scene.positions[[0, 10]]  # in a line
        scene.set_constraint(constraint)
        scene.set_momenta(scene.get_momenta())
    bonds = np.array([[0, 1], [1, 2], [0, 2], [10, 11], [11, 12], [10, 12]])
    springs = md.HarmonicBond(2.0, 1.1, pairs=np.array([[k, k + 1] for k in range(13, 53, 2)]))
    simulation = md.Simulation(md.System.from_ase(same, bonds=bonds), springs, md.VelocityVerlet(units.fs))
    simulation.run(20, every=20)
    atoms.calc = Calculator(springs, bonds=bonds)
    VelocityVerlet(atoms, units.fs).run(20)
    assert np.abs(simulation.positions - atoms.positions).max() < 1e-10
    assert np.abs(simulation.velocities - atoms.get_velocities()).max() < 1e-10
    assert simulation.n_dof == 3 * 54 - 3 * (simulation.engine.constraint_set.n_fixed == 0) - sum(
        c.get_removed_dof(atoms) for c in atoms.constraints
    )


def test_the_center_of_mass_is_held():
    system = md.System.from_ase(nitrogen(FixCom()))
    assert np.abs(system.masses @ system.velocities).max() < 1e-12
    with pytest.raises(ValueError, match="FixCartesian"):
        md.System.from_ase(nitrogen(ase.constraints.FixCartesian(0)))


class Push(Term):
    """The same force on all atoms."""

    acts_from_outside = True

    def bind(self, _system):
        return self


def test_atoms_with_fixcom_are_refused_where_their_center_would_move():
    atoms, law, langevin = nitrogen(FixCom()), nitrogen_law(), md.LangevinBAOAB(units.fs, 80.0, 0.1, seed=1)
    with pytest.raises(
        ValueError,
        match=r"FixCom, but langevin-baoab moves the center of mass: take StochasticVelocityRescaling or minimd\.ase",
    ):
        md.Simulation(atoms, law, langevin)
    with pytest.raises(ValueError, match="FixCom, but a force from outside or a fixed atom moves the center"):
        md.Simulation(atoms, [law, Push()], md.VelocityVerlet(units.fs))
    with pytest.raises(ValueError, match="FixCom, but a force from outside or a fixed atom moves the center"):
        md.Simulation(atoms, law, md.VelocityVerlet(units.fs), constraints=md.FixedAtoms([0]))
    for simulation in (sim := md.Simulation(atoms, law, md.VelocityVerlet(units.fs)), copy.copy(sim)):
        with pytest.raises(ValueError, match="FixCom, but langevin-baoab"):
            simulation.method = langevin
        assert simulation.method.name == "velocity-verlet"
        simulation.method = md.StochasticVelocityRescaling(units.fs, 80.0, 100.0 * units.fs, seed=1)
    md.Simulation(nitrogen(), law, langevin)


def test_ase_dynamics_keeps_the_constraints_of_the_atoms():
    atoms = nitrogen()
    atoms.calc = Calculator(nitrogen_law(), bonds=np.arange(54).reshape(-1, 2))
    lengths = atoms.positions[1::2] - atoms.positions[::2]
    bridge.VelocityVerlet(atoms, units.fs).run(50)
    now = atoms.positions[1::2] - atoms.positions[::2]
    assert np.abs(now - lengths).max() > 0.01
    assert np.linalg.norm(now, axis=1) == pytest.approx(np.linalg.norm(lengths, axis=1), rel=1e-14)
    atoms.set_constraint()  # what was removed is no longer kept
    dynamics = bridge.VelocityVerlet(atoms, units.fs)
    dynamics.run(1)
    atoms.set_constraint(FixAtoms([0]))
    dynamics.run(1)
    atoms.set_constraint()
    before = atoms.positions[0].copy()
    dynamics.run(20)
    assert np.abs(atoms.positions[0] - before).max() > 1e-6
