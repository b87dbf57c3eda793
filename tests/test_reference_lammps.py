"""LAMMPS' reference numbers: a small molecule system with everything in it, and the 4000-atom melt."""

import numpy as np
import pytest
from references import fourmol, load, melt

import minimd as md

STRESS_ORDER = ([0, 1, 2, 0, 0, 1], [0, 1, 2, 1, 2, 2])  # xx yy zz xy xz yz
RELATIVE = 1e-12
FTM2V = 1.0 / 48.88821291**2  # acceleration [Å/fs²] of 1 kcal/mol/Å on 1 g/mol
SCALE = (0.10, 0.25, 0.50)


def coefficients(lines):
    own, unlike = {}, {}
    for line in lines:
        a, b, *numbers = line.split()
        target = own if a == b else unlike
        target[int(a) if a == b else (int(a), int(b))] = tuple(float(x) for x in numbers)
    return own, unlike


def per_term(lines, kinds):
    table = {int(line.split()[0]): [float(x) for x in line.split()[1:]] for line in lines}
    return np.array([table[kind] for kind in kinds]).T


def harmonic_bonds(table, lines):
    k, length = per_term(lines, np.array(table["bonds"])[:, 0])
    return md.HarmonicBond(2.0 * k, length)


def harmonic_angles(table, lines):
    angles = np.array(table["angles"])
    k, angle = per_term(lines, angles[:, 0])
    return md.HarmonicAngle(2.0 * k, np.radians(angle), angles[:, 1:] - 1)


def agree(system, potential, reference, energy, of_stress=RELATIVE):
    result, forces = md.evaluate(system, potential), np.array(reference["init_forces"])
    assert result.potential_energy == pytest.approx(energy, rel=RELATIVE)
    assert np.abs(result.forces - forces).max() < RELATIVE * np.abs(forces).max()
    stress = np.array(reference["init_stress"])
    assert np.abs(result.virial[STRESS_ORDER] - stress).max() < of_stress * np.abs(stress).max()
    assert result.energies.sum() == pytest.approx(energy, rel=RELATIVE)


def test_lennard_jones_with_scaled_bonded_pairs():
    reference = load("lammps_fourmol/mol-pair-lj_cut.json")
    system, _ = fourmol()
    own, unlike = coefficients(reference["pair_coeff"])
    for truncation, energy in (
        ("shifted", reference["init_vdwl"]),
        ("truncated", reference["extra"]["unshifted_init_vdwl"]),
    ):
        potential = md.LennardJones(own, cutoff=8.0, truncation=truncation, pairs=unlike, bonded_scale=SCALE)
        assert md.evaluate(system, potential).potential_energy == pytest.approx(energy, rel=1e-12)
    agree(system, md.LennardJones(own, cutoff=8.0, pairs=unlike, bonded_scale=SCALE), reference, reference["init_vdwl"])


def morse(r2, depth, alpha, r0):
    r = np.sqrt(r2)
    x = np.exp(-alpha * (r - r0))
    return depth * (x * x - 2.0 * x), 2.0 * depth * alpha * (x * x - x) / r


def lennard_jones_96(r2, epsilon, sigma):
    s3 = (sigma * sigma / r2) ** 1.5
    return 4.0 * epsilon * s3 * s3 * (s3 - 1.0), epsilon * s3 * s3 * (36.0 * s3 - 24.0) / r2


def test_laws_that_a_user_brings_are_as_exact():
    system, _ = fourmol()
    reference = load("lammps_fourmol/mol-pair-morse.json")
    own, unlike = coefficients(reference["pair_coeff"])
    potential = md.PairPotential(morse, own, 8.0, "truncated", pairs=unlike, bonded_scale=SCALE)
    agree(system, potential, reference, reference["init_vdwl"])
    reference = load("lammps_fourmol/mol-pair-lj96_cut.json")
    own, unlike = coefficients(reference["pair_coeff"])
    mixed = md.PairPotential(
        lennard_jones_96, own, 8.0, "truncated", pairs=unlike, mixing="lorentz-berthelot", bonded_scale=SCALE
    )
    agree(system, mixed, reference, reference["init_vdwl"])


def test_harmonic_bonds_and_angles():
    system, table = fourmol()
    reference = load("lammps_fourmol/bond-harmonic.json")
    agree(system, harmonic_bonds(table, reference["bond_coeff"]), reference, reference["init_energy"])
    reference = load("lammps_fourmol/angle-harmonic.json")
    agree(system, harmonic_angles(table, reference["angle_coeff"]), reference, reference["init_energy"])


@pytest.mark.parametrize(("style", "bond"), [("morse", md.MorseBond), ("fene", md.FENEBond)])
def test_bonds_that_break_and_bonds_that_do_not(style, bond):
    system, table = fourmol()
    reference = load(f"lammps_fourmol/bond-{style}.json")
    parameters = per_term(reference["bond_coeff"], np.array(table["bonds"])[:, 0])
    agree(system, bond(*parameters), reference, reference["init_energy"])


def test_dihedrals_and_impropers():
    system, table = fourmol()
    kinds, *atoms = np.array(table["dihedrals"]).T
    quadruples = np.stack(atoms, axis=-1) - 1
    reference = load("lammps_fourmol/dihedral-harmonic.json")
    k, d, n = per_term(reference["dihedral_coeff"], kinds)
    agree(
        system,
        md.PeriodicDihedral(k, n, np.where(d > 0.0, 0.0, np.pi), quadruples),
        reference,
        reference["init_energy"],
    )
    reference = load("lammps_fourmol/dihedral-opls.json")
    agree(
        system,
        md.OPLSDihedral(*per_term(reference["dihedral_coeff"], kinds), quadruples),
        reference,
        reference["init_energy"],
    )
    reference = load("lammps_fourmol/improper-harmonic.json")
    kinds, *atoms = np.array(table["impropers"]).T
    k, angle = per_term(reference["improper_coeff"], kinds)  # both angles are negative; LAMMPS' have no sign
    impropers = md.HarmonicImproper(2.0 * k, -np.radians(angle), np.stack(atoms, axis=-1) - 1)
    agree(
        system, impropers, reference, reference["init_energy"], of_stress=5e-11
    )  # as LAMMPS' own test: it divides by sin φ, and φ is near 0


def test_walls():
    """On the atoms of the solute, where LAMMPS' run has brought them: only the upper wall is in reach."""
    reference, table = load("lammps_fourmol/fix-timestep-wall_lj93_const.json"), fourmol()[1]
    positions = reference["run_pos"][:17]
    ends = {name: table[name][1] for name in ("box_lo", "box_hi")}
    lower, upper = (
        md.Wall([0, ends["box_lo"], 0], [0, 1, 0], 100.0, 2.0, 5.0),
        md.Wall([0, ends["box_hi"], 0], [0, -1, 0], 100.0, 2.0, 5.0),
    )
    found = md.evaluate(md.System(positions), [lower, upper])
    assert found.potential_energy == pytest.approx(reference["global_scalar"], rel=RELATIVE)
    assert found.forces.sum(axis=0) == pytest.approx([0.0, -reference["global_vector"][1], 0.0], rel=RELATIVE)
    assert not md.evaluate(md.System(positions), lower).forces.any()


@pytest.mark.parametrize("method", [md.VelocityVerlet, md.Leapfrog])
def test_eight_steps_of_the_solute(method):
    """Forces of everything, motion of molecules 1 and 2: the others are made immovable by enormous masses."""
    reference = load("lammps_fourmol/fix-timestep-nve.json")
    system, table = fourmol()
    solute = np.isin(table["mol"], (1, 2))
    system = fourmol(masses=np.where(solute, system.masses / FTM2V, 1e30))[0]
    moving_velocities = system.velocities.copy()
    system.velocities[~solute] = 0.0
    coefficients_lj, unlike = coefficients(load("lammps_fourmol/mol-pair-lj_cut.json")["pair_coeff"])
    potentials = [
        md.LennardJones(
            coefficients_lj, cutoff=8.0, truncation="truncated", pairs=unlike, mixing="geometric", bonded_scale=SCALE
        ),
        harmonic_bonds(table, load("lammps_fourmol/bond-harmonic.json")["bond_coeff"]),
        harmonic_angles(table, load("lammps_fourmol/angle-harmonic.json")["angle_coeff"]),
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
    for k, (step, *row) in enumerate(reference["exact_list"]):
        n = record.n_atoms
        measured = (
            record.temperature[k],
            record.potential_energy[k] / n,
            record.total_energy[k] / n,
            record.pressure[k],
        )
        assert record.step[k] == step
        assert measured == pytest.approx(row, rel=1e-7 if step == 0 else 5e-7)
