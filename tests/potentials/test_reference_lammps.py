"""LAMMPS' reference numbers: a small molecule system with everything in it, and the 4000-atom melt."""

from functools import partial

import numpy as np
import pytest
from lammps_scenes import morse
from references import fourmol, load, melt

import minimd as md

STRESS_ORDER = ([0, 1, 2, 0, 0, 1], [0, 1, 2, 1, 2, 2])  # xx yy zz xy xz yz
RELATIVE = 1e-12
FTM2V = 1.0 / 48.88821291**2  # acceleration [Å/fs²] of 1 kcal/mol/Å on 1 g/mol
OF_IMPROPERS = 5e-11  # as LAMMPS' own test: it divides by sin φ, and φ is near 0


def lennard_jones_96(r2, epsilon, sigma):
    s3 = (sigma * sigma / r2) ** 1.5
    return 4.0 * epsilon * s3 * s3 * (s3 - 1.0), epsilon * s3 * s3 * (36.0 * s3 - 24.0) / r2


def pairs(law, truncation="truncated", **more):
    """A pair potential with the parameters of LAMMPS' lines for the types, and for pairs of unlike types."""

    def made(_table, lines):
        numbers = {(int(a), int(b)): tuple(map(float, row)) for a, b, *row in [line.split() for line in lines]}
        own = {a: row for (a, b), row in numbers.items() if a == b}
        unlike = {(a, b): row for (a, b), row in numbers.items() if a != b}
        options = {"cutoff": 8.0, "truncation": truncation, "pairs": unlike, "bonded_scale": (0.10, 0.25, 0.50)}
        return law(own, **options, **more)

    return made


def groups(name, law):
    """A potential of the bonds, angles, ...: law(groups of atoms, *parameters of each)."""

    def made(table, lines):
        kinds, *atoms = np.array(table[name]).T
        numbers = {int(line.split()[0]): [float(x) for x in line.split()[1:]] for line in lines}
        return law(np.stack(atoms, axis=-1) - 1, *np.array([numbers[kind] for kind in kinds]).T)

    return made


HARMONIC_BONDS = groups("bonds", lambda _bonds, k, length: md.HarmonicBond(2.0 * k, length))
HARMONIC_ANGLES = groups("angles", lambda atoms, k, angle: md.HarmonicAngle(2.0 * k, np.radians(angle), atoms))
# the angles of impropers are all negative; LAMMPS' have no sign
CASES = {
    "mol-pair-lj_cut": pairs(md.LennardJones, "shifted"),
    "mol-pair-morse": pairs(partial(md.PairPotential, morse)),
    "mol-pair-lj96_cut": pairs(partial(md.PairPotential, lennard_jones_96), mixing="lorentz-berthelot"),
    "bond-harmonic": HARMONIC_BONDS,
    "bond-morse": groups("bonds", lambda _bonds, *parameters: md.MorseBond(*parameters)),
    "bond-fene": groups("bonds", lambda _bonds, *parameters: md.FENEBond(*parameters)),
    "angle-harmonic": HARMONIC_ANGLES,
    "dihedral-harmonic": groups("dihedrals", lambda atoms, k, d, n: md.PeriodicDihedral(k, n, np.pi * (d < 0), atoms)),
    "dihedral-opls": groups("dihedrals", lambda atoms, *parameters: md.OPLSDihedral(*parameters, atoms)),
    "improper-harmonic": groups("impropers", lambda g, k, at: md.HarmonicImproper(2.0 * k, -np.radians(at), g)),
}
SLOW = ("mol-pair-morse", "mol-pair-lj96_cut", "dihedral-opls", "improper-harmonic")  # each compiles a law of its own


@pytest.mark.parametrize("style", [pytest.param(one, marks=pytest.mark.slow if one in SLOW else ()) for one in CASES])
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


def test_walls():
    """On the atoms of the solute, where LAMMPS' run has brought them: only the upper wall is in reach."""
    reference, table = load("lammps_fourmol/fix-timestep-wall_lj93_const.json"), fourmol()[1]
    system = md.System(reference["run_pos"][:17])
    places = ((table["box_lo"][1], 1), (table["box_hi"][1], -1))
    lower, upper = (md.Wall([0, y, 0], [0, inward, 0], 100.0, 2.0, 5.0) for y, inward in places)
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
    laws = {"mol-pair-lj_cut": pairs(md.LennardJones, mixing="geometric")}
    laws |= {"bond-harmonic": HARMONIC_BONDS, "angle-harmonic": HARMONIC_ANGLES}
    of_lammps = {style: load(f"lammps_fourmol/{style}.json") for style in laws}
    potentials = [law(table, of_lammps[style][f"{style.split('-')[-2]}_coeff"]) for style, law in laws.items()]
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
    numbers = record.step, record.temperature, record.potential_energy / n, record.total_energy / n, record.pressure
    for (at, *found), (step, *row) in zip(np.transpose(numbers), reference["exact_list"], strict=True):
        assert at == step
        assert found == pytest.approx(row, rel=1e-7 if step == 0 else 5e-7)
