"""Files of embedded atoms, made of simple functions."""

import numpy as np

RISE = {"Cu": (0.6, 1.3), "Al": (0.4, 1.1)}  # of the density that an atom gives
N_RHO, N_R, STEP, CUTOFF = 120, 110, 0.05, 5.4
LAST = 0.25 * N_RHO


def density(r, giver, at="Cu"):
    height, decay = RISE[giver]
    factor = 1.2 if at == "Al" else 1.0
    return factor * height * np.exp(-decay * (r - 2.5)) * np.clip(1.0 - r / CUTOFF, 0.0, None) ** 2


def pair(r, first, second):
    size = {"CuCu": 0.8, "AlAl": 0.5}.get(first + second, 0.6)
    return size * np.exp(-2.0 * (r - 2.5)) * np.clip(1.0 - r / CUTOFF, 0.0, None) ** 2


def embedding(rho, element):
    return -{"Cu": 1.3, "Al": 0.9}[element] * np.sqrt(rho) + 0.02 * rho


def lines(*columns):
    return "\n".join(
        " ".join(f"{x:.16e}" for x in row) for column in columns for row in np.split(column, len(column) // 5)
    )


def setfl(elements=("Cu", "Al"), both_ways=False, cutoff=CUTOFF, offset=0.0):
    """The text of a file for eam/alloy, or for eam/fs.
    offset : added to densities and r φ, which then do not end at zero."""
    r, rho = STEP * np.arange(N_R), 0.25 * np.arange(N_RHO)
    text = ["made for tests", "of simple functions", "in eV and Å", f"{len(elements)} {' '.join(elements)}"]
    text.append(f"{N_RHO} 0.25 {N_R} {STEP} {cutoff}")
    for element in elements:
        text += ["29 63.55 3.6 fcc", lines(embedding(rho, element))]
        text += [lines(density(r, element, at) + offset) for at in (elements if both_ways else elements[:1])]
    for k, first in enumerate(elements):
        text += [lines(r * pair(r, first, second) + offset) for second in elements[: k + 1]]
    return "\n".join(text) + "\n"


def funcfl():
    """The text of a file for eam."""
    r, rho = STEP * np.arange(N_R), 0.25 * np.arange(N_RHO)
    charge = np.sqrt(r * pair(r, "Cu", "Cu") / (27.2 * 0.529))
    columns = lines(embedding(rho, "Cu"), charge, density(r, "Cu"))
    return f"made for tests\n29 63.55 3.6 fcc\n{N_RHO} 0.25 {N_R} {STEP} {CUTOFF}\n{columns}\n"
