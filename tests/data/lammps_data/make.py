"""Data files in the layouts of LAMMPS' benchmarks chain and rhodo, and LAMMPS' own numbers at step 0.

    python tests/data/lammps_data/make.py      # in the root of the repository; needs the package lammps

chain.data: Kremer-Grest chains, atom style bond, which the file does not name, with image flags.
rhodo.data: molecules with charges, dihedrals and impropers in real units, with Coeffs, and a section CMAP after
    Impropers that read_data alone does not know; LAMMPS is given the file without it.
step_0.json: temp, epair, emol, etotal, press as LAMMPS prints them, the commands, and the constants of its units.
"""

import json
import subprocess
import tempfile
from pathlib import Path

import numpy as np

from minimd.lammps.program import environment, find_program

HERE = Path(__file__).parent
PRINTED = "thermo_style custom temp epair emol etotal press\nthermo_modify norm no format float %.11g\nrun 0\n"
CHAIN = """units lj
atom_style bond
special_bonds fene
read_data chain.data
neighbor 0.4 bin
bond_style fene
bond_coeff 1 30.0 1.5 1.0 1.0
pair_style lj/cut 1.12
pair_modify shift yes
pair_coeff 1 1 1.0 1.0 1.12
"""
RHODO = """units real
atom_style full
boundary f f f
special_bonds lj/coul 0.0 0.0 0.5
bond_style harmonic
angle_style harmonic
dihedral_style charmm
improper_style harmonic
pair_style lj/cut/coul/cut 400.0
pair_modify mix arithmetic
read_data rhodo.data
"""
CONSTANTS = {"boltz": 0.0019872067, "qqr2e": 332.06371, "mvv2e": 48.88821291**2, "nktv2p": 68568.415}  # units real


def lines(title, rows):
    return f"\n{title}\n\n" + "".join(f"{row}\n" for row in rows)


def chain_text(n_chains=16, length=20):
    """Chains along x, 1.85 σ apart, that cross the boundary of a cell of 15 beads."""
    rng = np.random.default_rng(1)
    edge = np.array([15 * 0.97, 7.4, 7.4])
    atoms = []
    for chain in range(n_chains):
        start = np.array([rng.uniform(0.0, edge[0]), 1.85 * (chain % 4), 1.85 * (chain // 4)])
        beads = start + np.arange(length)[:, None] * [0.97 * 15 / 24, 0.0, 0.0]
        beads[:, 1] += 0.37 * (-1.0) ** np.arange(length)
        beads += rng.uniform(-0.02, 0.02, beads.shape)
        for bead in beads:
            image = np.floor(bead / edge).astype(int)
            place = bead - image * edge - edge / 2
            numbers = [f"{x:.8g}" for x in place] + [str(k) for k in image]
            atoms.append(f"{len(atoms) + 1:6d} {chain + 1:5d} 1 {' '.join(numbers)}")
    n = len(atoms)
    velocities = rng.normal(size=(n, 3))
    velocities -= velocities.mean(axis=0)
    bonds = [(c * length + k, c * length + k + 1) for c in range(n_chains) for k in range(1, length)]
    header = f"LAMMPS FENE chain data file\n\n  {n}  atoms\n  {len(bonds)}  bonds\n  0  angles\n  0  dihedrals\n"
    header += "  0  impropers\n\n  1  atom types\n  1  bond types\n  0  angle types\n  0  dihedral types\n"
    header += "  0  improper types\n\n"
    header += "".join(f"  {-x / 2:.6f} {x / 2:.6f} {k}lo {k}hi\n" for k, x in zip("xyz", edge, strict=True))
    text = header + lines("Masses", ["  1  1.0"]) + lines("Atoms", atoms)
    text += lines("Velocities", (f"{k} {' '.join(f'{v:.8g}' for v in row)}" for k, row in enumerate(velocities, 1)))
    return text + lines("Bonds", (f"{k} 1 {i} {j}" for k, (i, j) in enumerate(bonds, 1)))


def rhodo_text(n_molecules=40):
    """Molecules of a planar center, three arms, and an end on one of them; in the order of atoms shuffled."""
    rng = np.random.default_rng(2)
    shape = np.array([[0.0, 0, 0], [1.3, 0, 0.1], [-0.7, 1.2, 0], [-0.7, -1.2, 0], [1.9, 1.3, 0.4]])
    types, charges = [1, 2, 3, 3, 3], [0.5, -0.3, -0.15, -0.15, 0.1]
    atoms, bonds, angles, dihedrals, impropers = [], [], [], [], []
    for k in range(n_molecules):
        turn = np.linalg.qr(rng.normal(size=(3, 3)))[0]
        center = 5.0 * np.array([k % 4, k // 4 % 4, k // 16])
        places = center + shape @ turn + rng.uniform(-0.05, 0.05, shape.shape)
        first = 5 * k + 1
        for a in range(5):
            atoms.append(f"{first + a} {k + 1} {types[a]} {charges[a]:.2f} {' '.join(f'{x:.7f}' for x in places[a])}")
        bonds += [f"{1 if b == 1 else 2} {first} {first + b}" for b in (1, 2, 3)] + [f"2 {first + 1} {first + 4}"]
        angles += [f"1 {first + a} {first} {first + b}" for a, b in ((1, 2), (1, 3), (2, 3))]
        angles.append(f"2 {first} {first + 1} {first + 4}")
        dihedrals += [f"{kind} {first + a} {first} {first + 1} {first + 4}" for kind, a in ((1, 2), (2, 3))]
        impropers.append(f"1 {first} {first + 1} {first + 2} {first + 3}")
    order = rng.permutation(len(atoms))
    velocities = 0.005 * rng.normal(size=(len(atoms), 3))
    velocities -= ((velocities.T * np.tile([12.011, 14.007, 1.008, 1.008, 1.008], n_molecules)).T).mean(axis=0) / 5.8084
    groups = {"Bonds": bonds, "Angles": angles, "Dihedrals": dihedrals, "Impropers": impropers}
    counts = {"atoms": len(atoms), **{name.lower(): len(rows) for name, rows in groups.items()}}
    counts |= {"atom types": 3, "bond types": 2, "angle types": 2, "dihedral types": 2, "improper types": 1}
    counts["crossterms"] = 2
    text = "LAMMPS data file from restart file: timestep = 0, procs = 1\n\n"
    text += "".join(f"{n} {name}\n" for name, n in counts.items()) + "\n"
    text += "".join(f"-20 60 {axis}lo {axis}hi # shrinks\n" for axis in "xyz")
    text += lines("Masses", ["1 12.011 # C", "2 14.007 # N", "3 1.008"])
    text += lines("Pair Coeffs # lj/cut/coul/cut", ["1 0.11 3.5636", "2 0.2 3.29632", "3 0.046 0.4"])
    text += lines("Bond Coeffs # harmonic", ["1 320 1.35", "2 340 1.4"])
    text += lines("Angle Coeffs # harmonic", ["1 50 118", "2 35 112.5"])
    text += lines("Dihedral Coeffs # charmm", ["1 0.2 1 180 0.0", "2 1.4 2 180 0.0"])
    text += lines("Improper Coeffs # harmonic", ["1 20 0"])
    text += lines("Atoms # full", (atoms[k] for k in order))
    text += lines("Velocities", (f"{k + 1} {' '.join(f'{v:.9f}' for v in velocities[k])}" for k in order[::-1]))
    for name, rows in groups.items():
        text += lines(name, (f"{k} {row}" for k, row in enumerate(rows, 1)))
    return text + lines("CMAP", ["1 1 5 1 2 3 4", "2 1 10 6 7 8 9"])


def step_0(text, name, commands):
    """What LAMMPS prints at step 0."""
    with tempfile.TemporaryDirectory() as folder:
        readable = text.split("\nCMAP\n")[0].replace("2 crossterms\n", "")
        Path(folder, name).write_text(readable)
        Path(folder, "in.lmp").write_text(commands + PRINTED)
        command = find_program().command("in.lmp", "log.lmp", 1)
        subprocess.run(command, cwd=folder, env=environment(), check=True, stdout=subprocess.DEVNULL)
        rows = Path(folder, "log.lmp").read_text().splitlines()
    k = next(k for k, row in enumerate(rows) if row.split()[:2] == ["Temp", "E_pair"])
    return dict(zip(["temp", "epair", "emol", "etotal", "press"], rows[k + 1].split(), strict=True))


if __name__ == "__main__":
    results = {"made by": f"LAMMPS {find_program().version}", "constants of real": CONSTANTS}
    for name, text, commands in (("chain", chain_text(), CHAIN), ("rhodo", rhodo_text(), RHODO)):
        (HERE / f"{name}.data").write_text(text)
        results[name] = {"commands": commands.splitlines(), "step 0": step_0(text, f"{name}.data", commands)}
    (HERE / "step_0.json").write_text(json.dumps(results, indent=1) + "\n")
