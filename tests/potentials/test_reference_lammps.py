"""LAMMPS' reference numbers: a small molecule system with everything in it, and the 4000-atom melt."""

import numpy as np
import pytest
from lammps_reference import FTM2V, SCALE, coefficients, harmonic_angles, harmonic_bonds, per_term
from references import fourmol, load, melt

import minimd as md

STRESS_ORDER = ([0, 1, 2, 0, 0, 1], [0, 1, 2, 1, 2, 2])  # xx yy zz xy xz yz
RELATIVE = 1e-12
OF_IMPROPERS = 5e-11  # as LAMMPS' own test: it divides by sin φ, and φ is near 0


def morse(r2, depth, alpha, r0):
    r = np.sqrt(r2)
    x = np.exp(alpha * (r0 - r))
    return depth * (x * x - 2.0 * x), 2.0 * depth * alpha * (x * x - x) / r


def lennard_jones_96(r2, epsilon, sigma):
    s3 = (sigma * sigma / r2) ** 1.5
    scale = epsilon * s3 * s3
    return 4.0 * scale * (s3 - 1.0), scale * (36.0 * s3 - 24.0) / r2


def lennard_jones(lines, truncation="truncated", **more):
    own, unlike = coefficients(lines)
    return md.LennardJones(own, cutoff=8.0, truncation=truncation, pairs=unlike, bonded_scale=SCALE, **more)


def users(law, **more):
    def made(_table, lines):
        own, unlike = coefficients(lines)
        return md.PairPotential(law, own, 8.0, "truncated", pairs=unlike, bonded_scale=SCALE, **more)

    return made


def groups(table, name, lines):
    """Parameters of each term, and its atoms."""
    kinds, *atoms = np.array(table[name]).T
    return per_term(lines, kinds), np.stack(atoms, axis=-1) - 1


def of_bonds(law):
    return lambda table, lines: law(*groups(table, "bonds", lines)[0])


def opls(table, lines):
    parameters, quadruples = groups(table, "dihedrals", lines)
    return md.OPLSDihedral(*parameters, quadruples)


def periodic(table, lines):
    (k, d, n), quadruples = groups(table, "dihedrals", lines)
    return md.PeriodicDihedral(k, n, np.where(d > 0.0, 0.0, np.pi), quadruples)


def improper(table, lines):
    """Both angles are negative; LAMMPS' have no sign."""
    (k, angle), quadruples = groups(table, "impropers", lines)
    return md.HarmonicImproper(2.0 * k, -np.radians(angle), quadruples)


CASES = {
    "mol-pair-lj_cut": lambda table, lines: lennard_jones(lines, "shifted"),
    "mol-pair-morse": users(morse),
    "mol-pair-lj96_cut": users(lennard_jones_96, mixing="lorentz-berthelot"),
    "bond-harmonic": harmonic_bonds,
    "bond-morse": of_bonds(md.MorseBond),
    "bond-fene": of_bonds(md.FENEBond),
    "angle-harmonic": harmonic_angles,
    "dihedral-harmonic": periodic,
    "dihedral-opls": opls,
    "improper-harmonic": improper,
}


@pytest.mark.parametrize("style", CASES)
def test_energy_forces_and_virial_are_those_of_lammps(style):
    system, table = fourmol()
    reference = load(f"lammps_fourmol/{style}.json")
    (lines,) = (reference[name] for name in reference if name.endswith("_coeff"))
    energy = reference["init_vdwl" if "pair" in style else "init_energy"]
    found, forces = md.evaluate(system, CASES[style](table, lines)), np.array(reference["init_forces"])
    assert found.potential_energy == pytest.approx(energy, rel=RELATIVE)
    assert found.energies.sum() == pytest.approx(energy, rel=RELATIVE)
    assert np.abs(found.forces - forces).max() < RELATIVE * np.abs(forces).max()
    stress, of_stress = np.array(reference["init_stress"]), OF_IMPROPERS if "improper" in style else RELATIVE
    assert np.abs(found.virial[STRESS_ORDER] - stress).max() < of_stress * np.abs(stress).max()


def test_energy_without_a_shift():
    reference = load("lammps_fourmol/mol-pair-lj_cut.json")
    found = md.evaluate(fourmol()[0], lennard_jones(reference["pair_coeff"]))
    assert found.potential_energy == pytest.approx(reference["extra"]["unshifted_init_vdwl"], rel=RELATIVE)


def test_walls():
    """On the atoms of the solute, where LAMMPS' run has brought them: only the upper wall is in reach."""
    reference, table = load("lammps_fourmol/fix-timestep-wall_lj93_const.json"), fourmol()[1]
    system = md.System(reference["run_pos"][:17])
    lower, upper = (
        md.Wall([0, table[end][1], 0], [0, inward, 0], 100.0, 2.0, 5.0)
        for end, inward in (("box_lo", 1), ("box_hi", -1))
    )
    found = md.evaluate(system, [lower, upper])
    assert found.potential_energy == pytest.approx(reference["global_scalar"], rel=RELATIVE)
    assert found.forces.sum(axis=0) == pytest.approx([0.0, -reference["global_vector"][1], 0.0], rel=RELATIVE)
    assert not md.evaluate(system, lower).forces.any()


@pytest.mark.parametrize("method", [md.VelocityVerlet, md.Leapfrog])
def test_eight_steps_of_the_solute(method):
    """Forces of everything, motion of molecules 1 and 2: the others are made immovable by enormous masses."""
    reference = load("lammps_fourmol/fix-timestep-nve.json")
    system, table = fourmol()
    solute = np.isin(table["mol"], (1, 2))
    system = fourmol(masses=np.where(solute, system.masses / FTM2V, 1e30))[0]
    moving_velocities = system.velocities.copy()
    system.velocities[~solute] = 0.0
    pairs, bonds, angles = (
        load(f"lammps_fourmol/{name}.json") for name in ("mol-pair-lj_cut", "bond-harmonic", "angle-harmonic")
    )
    potentials = [
        lennard_jones(pairs["pair_coeff"], mixing="geometric"),
        harmonic_bonds(table, bonds["bond_coeff"]),
        harmonic_angles(table, angles["angle_coeff"]),
    ]
    simulation = md.Simulation(system, potentials, method(0.25))
    simulation.run(8, every=8)
    assert np.abs(simulation.positions - reference["run_pos"]).max() < 1e-13
    velocities = np.where(solute[:, None], simulation.velocities, moving_velocities)
    assert np.abs(velocities - reference["run_vel"]).max() < 1e-13


def test_melt_follows_the_exact_list():
    reference = load("lammps_lj/melt4000.json")
    simulation = md.Simulation(melt(), md.LennardJones(1.0, 1.0, 2.5, "truncated"), md.VelocityVerlet(0.005))
    record = simulation.run(150, every=50)
    n = record.n_atoms
    measured = np.column_stack(
        [record.temperature, record.potential_energy / n, record.total_energy / n, record.pressure]
    )
    for found, at, (step, *row) in zip(measured, record.step, reference["exact_list"], strict=True):
        assert at == step
        assert found == pytest.approx(row, rel=1e-7 if step == 0 else 5e-7)
