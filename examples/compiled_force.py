"""A force of one's own as a compiled operation on all threads: a constant pull on half of the atoms. Reduced units."""

from collections import namedtuple

import numpy as np

import minimd as md
from minimd.core.compiled.by_address import ByAddress
from minimd.core.compiled.fixed_point import force_along, in_steps
from minimd.core.compiled.kernels import DirectCalls, called_kernel
from minimd.core.compiled.program import GO_ON, n_chunks_of, operation
from minimd.core.potentials.term import PER_ATOM, TOTALS, OwnTerm


class Data(ByAddress, namedtuple("Data", "positions atoms force forces energies detail totals steps")):
    """Data of the kernel pull.  totals : (chunks,) output, energy of each chunk."""


@called_kernel
def pull(data, chunk):
    """U = −F · r of each atom."""
    positions, atoms, force, forces, energies, detail, totals, steps = data
    totals[chunk] = 0.0
    for i in atoms[chunk * atoms.size // totals.size : (chunk + 1) * atoms.size // totals.size]:
        u = 0.0
        for c in range(3):
            forces[i, c] += force_along(force[c], 1.0, steps)
            u -= force[c] * positions[i, c]
        totals[chunk] += in_steps(u, steps)
        if detail == PER_ATOM:
            energies[i] += in_steps(u, steps)
    return GO_ON


class Pull(OwnTerm):
    acts_from_outside = fits_grid = True  # external: it has no virial; on a grid force_along rounds it

    def __init__(self, atoms, force):
        self.atoms, self.force, self.calls = np.asarray(atoms), np.asarray(force), DirectCalls()
        self.totals = np.zeros(n_chunks_of(len(self.atoms)))

    def bind(self, system):
        return Pull(self.atoms, self.force)

    def operations(self, system, target):
        place = system.positions, self.atoms, self.force, target.forces, target.energies
        yield operation(self.calls, pull, Data(*place, target.detail, self.totals, target.steps), len(self.totals))

    def collect(self, target):
        target.energies[:1] += self.totals.sum() if target.detail == TOTALS else 0.0


positions, edges = md.lattice.crystal("fcc", [8, 8, 8], 1.68)  # 2048 atoms; the pulled half is two chunks
potentials = [md.LennardJones(1.0, 1.0, 2.5, "force-shifted"), Pull(np.arange(0, 2048, 2), [0.5, 0.0, 0.0])]
for precision in ("double", "fixed-point"):
    sim = md.Simulation(md.System(positions, cell=edges), potentials, md.VelocityVerlet(0.002), precision=precision)
    sim.set_temperature(1.0, seed=1)
    record = sim.run(500, every=10)
    print(f"{precision}: the energy oscillates by {np.ptp(record.total_energy) / 2048:.1e} ε per atom (exact: 0)")
record.plot().savefig("compiled_force.png")
