"""Constraints beside LAMMPS' reference numbers, and beside ASE's."""

import ase
import numpy as np
import pytest
from ase.constraints import FixAtoms, FixBondLengths, FixCom, FixLinearTriatomic
from ase.md.verlet import VelocityVerlet
from references import fourmol, load
from wrong_calls import assert_answered

import minimd as md
from minimd.ase import Calculator

FS, FTM2V = md.units.fs, 1.0 / 48.88821291**2  # acceleration [Å/fs²] of 1 kcal/mol/Å on 1 g/mol
BOND_LENGTHS = {5: 1.0, 2: 1.1, 3: 1.3}  # r0 of the constrained bond types [Å]
BONDS = np.arange(54).reshape(-1, 2)  # of nitrogen
LAW = md.LennardJones(0.0031, 3.3, cutoff=5.0, truncation="force-shifted", bonded_scale=(0, 1, 1))
SPRINGS = md.HarmonicBond(2.0, 1.1, pairs=np.array([[k, k + 1] for k in range(13, 53, 2)]))
TRIPLES = np.array([[0, 1], [1, 2], [0, 2], [10, 11], [11, 12], [10, 12]])
CASES = [  # constraint of ASE, law, bonds, steps, tolerance [Å]: rounding, amplified
    pytest.param(FixBondLengths(BONDS), LAW, BONDS, 500, 1e-9, marks=pytest.mark.slow, id="long"),
    pytest.param(FixBondLengths(BONDS), SPRINGS, TRIPLES, 20, 1e-10, id="bonds"),
    pytest.param(FixLinearTriatomic(np.array([[0, 1, 2], [10, 11, 12]])), SPRINGS, TRIPLES, 20, 1e-10, id="rods"),
    pytest.param([FixBondLengths([[0, 1], [2, 3]]), FixAtoms([5, 7, 9])], SPRINGS, TRIPLES, 20, 1e-10, id="both"),
]


def constrained_fourmol(pairs, lengths, angle_atoms):
    """LAMMPS' molecules after 8 steps; harmonic terms of the rigid bonds, and of angles over angle_atoms, left out."""

    def numbers(name, key, n=1):  # of pairs or types of terms
        rows = [line.split() for line in load(f"lammps_fourmol/{name}.json")[key]]
        return {tuple(map(int, row[:n])): tuple(map(float, row[n:])) for row in rows}

    (system, table), rigid = fourmol(), {tuple(sorted(pair)) for pair in pairs}
    bonds = np.array([row for row in table["bonds"] if tuple(sorted((row[1] - 1, row[2] - 1))) not in rigid])
    angles = np.array([row for row in table["angles"] if row[2] - 1 not in angle_atoms])
    of_pairs = numbers("mol-pair-lj_cut", "pair_coeff", 2)
    of_bonds, of_angles = numbers("bond-harmonic", "bond_coeff"), numbers("angle-harmonic", "angle_coeff")
    own = {a: row for (a, b), row in of_pairs.items() if a == b}
    unlike = {pair: row for pair, row in of_pairs.items() if pair[0] != pair[1]}
    scale = {"mixing": "geometric", "bonded_scale": (0.10, 0.25, 0.50)}
    k, length = np.array([of_bonds[kind,] for kind in bonds[:, 0]]).T
    stiffness, angle = np.array([of_angles[kind,] for kind in angles[:, 0]]).T
    lj = md.LennardJones(own, cutoff=8.0, truncation="truncated", pairs=unlike, **scale)
    angles = md.HarmonicAngle(2.0 * stiffness, np.radians(angle), angles[:, 1:] - 1)
    laws = [lj, md.HarmonicBond(2.0 * k, length, pairs=bonds[:, 1:] - 1), angles]
    system, kept = fourmol(masses=system.masses / FTM2V)[0], md.DistanceConstraints(pairs, lengths)
    simulation = md.Simulation(system, laws, md.VelocityVerlet(0.25), kept)
    with pytest.warns(UserWarning, match="projected onto the constraints"):
        simulation.run(8, every=8)
    return simulation


def test_rattle_and_shake_are_those_of_lammps():
    """Of three waters; and of the light atoms of the solute, where LAMMPS does not project velocities."""
    oxygens = [17, 20, 23]
    pairs = [pair for o in oxygens for pair in ((o, o + 1), (o, o + 2), (o + 1, o + 2))]
    waters = constrained_fourmol(pairs, np.tile([1.0, 1.0, 2.0 * np.sin(np.radians(110.1 / 2.0))], 3), oxygens)
    assert [group.shape for group in waters.engine.constraint_set.bonds.groups] == ["triangles"]
    reference = load("lammps_fourmol/fix-timestep-rattle_angle.json")
    assert np.abs(waters.positions - reference["run_pos"]).max() < 2e-10
    assert np.abs(waters.velocities - reference["run_vel"]).max() < 2e-10
    system, table = fourmol()
    light = np.isin(table["mol"], (1, 2)) & np.isclose(system.masses, 4.00794)
    bonds = [(kind, i - 1, j - 1) for kind, i, j in table["bonds"] if light[i - 1] or light[j - 1]]
    solute = constrained_fourmol([pair for _, *pair in bonds], [BOND_LENGTHS[kind] for kind, *_ in bonds], [])
    reference = load("lammps_fourmol/fix-timestep-shake_bond.json")
    assert np.abs(solute.positions - reference["run_pos"]).max() < 2e-10


def nitrogen(constraint=None):
    """27 molecules in a cubic box, with velocities that keep their lengths."""
    arms = np.random.default_rng(1).normal(size=(27, 3))
    arms *= 0.55 / np.linalg.norm(arms, axis=1)[:, None]
    centers = 4.0 * np.array(list(np.ndindex(3, 3, 3))) + 0.2
    positions = np.stack([centers - arms, centers + arms], axis=1).reshape(-1, 3)
    atoms = ase.Atoms("N" * 54, positions, cell=[12.0] * 3, pbc=True)
    atoms.set_constraint(FixBondLengths(BONDS) if constraint is None else constraint)
    atoms.set_velocities(np.random.default_rng(3).normal(size=(54, 3)) * 0.03)
    return atoms


@pytest.mark.parametrize(("constraint", "law", "bonds", "n_steps", "tolerance"), CASES)
def test_constraints_of_ase_are_kept_as_ase_keeps_them(constraint, law, bonds, n_steps, tolerance):
    atoms, same = nitrogen([]), nitrogen([])
    for scene in (atoms, same):
        if law is SPRINGS:
            scene.positions[[2, 12]] = 2.0 * scene.positions[[1, 11]] - scene.positions[[0, 10]]  # in a line
        scene.set_constraint(constraint)
        scene.set_momenta(scene.get_momenta())
    sim = md.Simulation(md.System.from_ase(same, bonds=bonds), law, md.VelocityVerlet(FS))
    sim.run(n_steps, every=n_steps)
    atoms.calc = Calculator(law, bonds=bonds)
    VelocityVerlet(atoms, FS).run(n_steps)
    assert np.abs(sim.positions - same.positions).max() > 0.002 * n_steps
    assert np.abs([sim.positions - atoms.positions, sim.velocities - atoms.get_velocities()]).max() < tolerance
    removed = sum(c.get_removed_dof(atoms) for c in atoms.constraints)
    assert sim.n_dof == 3 * 54 - 3 * (sim.engine.constraint_set.n_fixed == 0) - removed


def test_the_center_of_atoms_with_fixcom_is_held_or_what_would_move_it_is_refused():
    atoms, verlet, langevin = nitrogen(FixCom()), md.VelocityVerlet(FS), md.LangevinBAOAB(FS, 80.0, 0.1, seed=1)
    system, gravity = md.System.from_ase(atoms), md.ConstantForce([0.0, 0.0, 1.0])
    assert np.abs(system.masses @ system.velocities).max() < 1e-12
    for laws, method, fixed in ((LAW, langevin, ()), ([LAW, gravity], verlet, ()), (LAW, verlet, md.FixedAtoms([0]))):
        assert_answered(lambda: md.Simulation(atoms, laws, method, fixed), ValueError, "FixCom")
    simulation = md.Simulation(atoms, LAW, verlet)
    assert_answered(lambda: setattr(simulation, "method", langevin), ValueError, "FixCom")
    simulation.method = md.StochasticVelocityRescaling(FS, 80.0, 100.0 * FS, seed=1)
