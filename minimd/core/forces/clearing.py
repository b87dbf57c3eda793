"""Memory set to zero before terms add to it."""

from collections import namedtuple

from minimd.core.compiled.by_address import ByAddress
from minimd.core.compiled.kernels import called_kernel
from minimd.core.compiled.program import GO_ON, share_of


class Clearing(ByAddress, namedtuple("Clearing", "forces n_chunks")):
    """Forces (N, 3) to be set to zero, in chunks."""


@called_kernel
def clear_forces(clearing, chunk):
    """Forces = 0."""
    forces, n_chunks = clearing
    n = forces.shape[0]
    first, last = share_of(chunk, n_chunks, n)
    for i in range(first, last):
        for c in range(3):
            forces[i, c] = 0
    return GO_ON


class Accumulators(ByAddress, namedtuple("Accumulators", "energies virials")):
    """Energies and virials of a Target."""


@called_kernel
def clear_accumulators(accumulators, _chunk):
    """Energies and virials = 0."""
    energies, virials = accumulators
    for i in range(energies.size):
        energies[i] = 0.0
        for c in range(virials.shape[1]):
            virials[i, c] = 0.0
    return GO_ON
