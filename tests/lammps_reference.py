"""LAMMPS' 29-atom molecules: what its input lines say, as laws of minimd."""

import numpy as np

import minimd as md

FTM2V = 1.0 / 48.88821291**2  # acceleration [Å/fs²] of 1 kcal/mol/Å on 1 g/mol
SCALE = (0.10, 0.25, 0.50)  # of pairs one, two and three bonds apart


def coefficients(lines):
    """Parameters of the types, and of pairs of unlike types."""
    own, unlike = {}, {}
    for line in lines:
        a, b, *numbers = line.split()
        target = own if a == b else unlike
        target[int(a) if a == b else (int(a), int(b))] = tuple(float(x) for x in numbers)
    return own, unlike


def per_term(lines, kinds):
    """Columns of parameters, one number for each term."""
    table = {int(line.split()[0]): [float(x) for x in line.split()[1:]] for line in lines}
    return np.array([table[kind] for kind in kinds]).T


def harmonic_bonds(table, lines):
    k, length = per_term(lines, np.array(table["bonds"])[:, 0])
    return md.HarmonicBond(2.0 * k, length)


def harmonic_angles(table, lines):
    angles = np.array(table["angles"])
    k, angle = per_term(lines, angles[:, 0])
    return md.HarmonicAngle(2.0 * k, np.radians(angle), angles[:, 1:] - 1)
