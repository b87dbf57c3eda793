"""Four short chains in a cell, as files of LAMMPS, of the PDB and of CHARMM have them."""

import numpy as np

N_CHAINS, LENGTH, EDGE = 4, 5, 6.0


def along_chains(size):
    return [[c * LENGTH + i + k for k in range(size)] for c in range(N_CHAINS) for i in range(LENGTH - size + 1)]


BONDS, ANGLES, DIHEDRALS, IMPROPERS = along_chains(2), along_chains(3), along_chains(4), [[4, 3, 2, 1]]
GROUPS = {"bonds": BONDS, "angles": ANGLES, "dihedrals": DIHEDRALS, "impropers": IMPROPERS}
POSITIONS = np.array([[1.0 * i + 0.5, 1.5 * c + 0.25, 0.125 * (i % 2)] for c in range(N_CHAINS) for i in range(LENGTH)])


def write_data(path):
    """A melt as LAMMPS writes it, with image flags; atoms and ids in another order than the lines."""
    lines = ["melt", "", "20 atoms", "2 atom types"]
    lines += [f"{len(rows)} {name}\n1 {name[:-1]} types" for name, rows in GROUPS.items()]
    lines += [f"0 {EDGE} {x}lo {x}hi" for x in "xyz"] + ["\nMasses\n\n1 1.0\n2 2.0\n\nAtoms # molecular\n"]
    for i in reversed(range(20)):
        (x, y, z), image = POSITIONS[i], int(POSITIONS[i, 0] > 4.0)
        lines.append(f"{i + 1} {i // LENGTH + 1} {1 + (i % LENGTH == 0)} {x - EDGE * image} {y} {z} {image} 0 0")
    lines += ["\nVelocities\n", *(f"{i + 1} {0.5 * i} 0 0" for i in range(20))]
    for name, rows in GROUPS.items():
        lines += [f"\n{name.capitalize()}\n"]
        lines += [f"{k} 1 {' '.join(str(atom + 1) for atom in row)}" for k, row in enumerate(rows, start=1)]
    path.write_text("\n".join(lines) + "\n")


def write_pdb(path, with_bonds):
    """Carbon beads; each bond of a CONECT record stands there twice, as in most files."""
    lines = [f"CRYST1{EDGE:9.3f}{EDGE:9.3f}{EDGE:9.3f}  90.00  90.00  90.00 P 1           1"]
    for i, (x, y, z) in enumerate(POSITIONS):
        place = f"{i + 1:5d}  C   BEA A{i // LENGTH + 1:4d}    {x:8.3f}{y:8.3f}{z:8.3f}"
        lines.append(f"ATOM  {place}  1.00  0.00           C  ")
    if with_bonds:
        lines += [f"CONECT{a + 1:5d}{b + 1:5d}" for i, j in BONDS for a, b in ((i, j), (j, i))]
    path.write_text("\n".join([*lines, "END"]) + "\n")


def write_psf(path, charge=0.0):
    """As CHARMM and NAMD have it: eight columns of bonds, nine of angles."""
    lines = ["PSF", "", "       1 !NTITLE", " REMARKS melt", "", f"{20:8d} !NATOM"]
    numbers = f"{charge:10.6f}  {12.011:12.4f}           0"
    lines += [f"{i + 1:8d} MELT {i // LENGTH + 1:<4d} BEA  C    CT   {numbers}" for i in range(20)]
    for name, groups, per_line in (("NBOND: bonds", BONDS, 4), ("NTHETA: angles", ANGLES, 3)):
        lines += ["", f"{len(groups):8d} !{name}"]
        rows = [groups[k : k + per_line] for k in range(0, len(groups), per_line)]
        lines += ["".join(f"{i + 1:8d}" for group in row for i in group) for row in rows]
    path.write_text("\n".join([*lines, ""]) + "\n")
