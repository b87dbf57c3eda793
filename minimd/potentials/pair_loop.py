"""The plain loop over pairs: the one place where a pair law becomes forces, energies and virial.

A bond is a pair whose list never changes; it runs through the same loop.
"""

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from minimd.compiled.kernels import kernel, without_cache
from minimd.potentials.law import evaluate_law, is_user_law
from minimd.potentials.parameters import parameters_of_pair

FORCES, TOTALS, PER_ATOM = 0, 1, 2  # what a loop is asked for; each includes the ones before


class Pairs(NamedTuple):
    """Pairs (i, j), grouped by their first atom: pairs start[i] to start[i+1] belong to atom i.

    start : (N+1,) int.  second : (P,) int, the atoms j.  image : (P,) int, row of translations to add to r_j − r_i.
    translations : (T, 3) [length]; with no rows, no pair is shifted and image is not read.
    """

    start: Any
    second: Any
    image: Any
    translations: Any


@kernel
def add_pair_forces(positions, pairs, law, parameters, detail, forces, energies, virials):
    """Add what a pair law does within its cutoff.

        r_ij = r_j − r_i + translation,   f = −u′(r)/r,   F_j += f r_ij,   F_i −= f r_ij,   W += f r_ij ⊗ r_ij

    positions, forces : (N, 3) [length], [energy/length].  energies : (N,) [energy].
    virials : (N, 6) [energy], xx yy zz yz xz xy.
    detail : FORCES touches forces only. TOTALS adds each pair to energies and virials of its first atom, so that their
        sums are right; PER_ATOM adds half of it to both atoms.
    """
    shifted = pairs.translations.shape[0] > 0
    own_share = 0.5 if detail == PER_ATOM else 1.0
    for i in range(pairs.start.size - 1):
        x, y, z = positions[i, 0], positions[i, 1], positions[i, 2]
        fx = fy = fz = energy = xx = yy = zz = yz = xz = xy = 0.0
        for p in range(pairs.start[i], pairs.start[i + 1]):
            j = pairs.second[p]
            dx, dy, dz = positions[j, 0] - x, positions[j, 1] - y, positions[j, 2] - z
            if shifted:
                image = pairs.image[p]
                dx += pairs.translations[image, 0]
                dy += pairs.translations[image, 1]
                dz += pairs.translations[image, 2]
            r2 = dx * dx + dy * dy + dz * dz
            numbers = parameters_of_pair(parameters, p, i, j)
            if r2 < numbers[0]:
                u, f = evaluate_law(law, r2, numbers[1:])
                fx -= f * dx
                fy -= f * dy
                fz -= f * dz
                forces[j, 0] += f * dx
                forces[j, 1] += f * dy
                forces[j, 2] += f * dz
                if detail != FORCES:
                    energy += u
                    xx += f * dx * dx
                    yy += f * dy * dy
                    zz += f * dz * dz
                    yz += f * dy * dz
                    xz += f * dx * dz
                    xy += f * dx * dy
                    if detail == PER_ATOM:
                        energies[j] += 0.5 * u
                        virials[j, 0] += 0.5 * f * dx * dx
                        virials[j, 1] += 0.5 * f * dy * dy
                        virials[j, 2] += 0.5 * f * dz * dz
                        virials[j, 3] += 0.5 * f * dy * dz
                        virials[j, 4] += 0.5 * f * dx * dz
                        virials[j, 5] += 0.5 * f * dx * dy
        forces[i, 0] += fx
        forces[i, 1] += fy
        forces[i, 2] += fz
        if detail != FORCES:
            energies[i] += own_share * energy
            virials[i, 0] += own_share * xx
            virials[i, 1] += own_share * yy
            virials[i, 2] += own_share * zz
            virials[i, 3] += own_share * yz
            virials[i, 4] += own_share * xz
            virials[i, 5] += own_share * xy


def pair_loop_for(law: tuple):
    """add_pair_forces, compiled so that the cache serves all laws it can recognise."""
    return without_cache(add_pair_forces) if is_user_law(law) else add_pair_forces


def fixed_pairs(pairs: NDArray[np.int64], n_atoms: int, periodic: bool) -> tuple[Pairs, NDArray[np.int64]]:
    """Pairs that never change, such as bonds, and the order in which they now stand: row p holds pairs[order[p]].

    In a periodic cell each pair has a translation of its own, to be filled with that of its nearest image.
    """
    order = np.argsort(pairs[:, 0], kind="stable")
    start = np.zeros(n_atoms + 1, dtype=np.int64)
    np.cumsum(np.bincount(pairs[:, 0], minlength=n_atoms), out=start[1:])
    return Pairs(
        start=start,
        second=pairs[order, 1].astype(np.uint32),
        image=np.arange(len(pairs) if periodic else 0, dtype=np.uint32),
        translations=np.zeros((len(pairs) if periodic else 0, 3)),
    ), order
