"""A substep of one's own as compiled operations on all threads: a drag, whose heat is counted. Reduced units."""

from collections import namedtuple

import numpy as np

import minimd as md
from minimd.core.compiled.by_address import ByAddress
from minimd.core.compiled.kernels import DirectCalls, called_kernel
from minimd.core.compiled.program import GO_ON, n_chunks_of, operation
from minimd.core.integrators.substeps import Drift, Kick, Thermalize
from minimd.core.integrators.thermostats import kinetic_energy_at, settled

CALLS = {False: DirectCalls(), True: DirectCalls()}  # without and with a grid, which have data of different types


class Dragging(ByAddress, namedtuple("Dragging", "velocities masses inverse_masses kept parts heat steps")):
    """kept : e^(−γΔt), γ = 0.5.  parts : (chunks,) output.  heat : (1,) of the bath."""


@called_kernel
def drag(data, chunk):
    """v ← e^(−γΔt) v; adds the change of the kinetic energy, which is negative, to parts."""
    v, masses, inverse_masses, kept, parts, _, steps = data
    parts[chunk] = 0.0
    for i in range(chunk * masses.size // parts.size, (chunk + 1) * masses.size // parts.size):
        parts[chunk] -= kinetic_energy_at(v, masses, i, steps)
        for c in range(3):
            v[i, c] = settled(kept * v[i, c], inverse_masses[i], steps)
        parts[chunk] += kinetic_energy_at(v, masses, i, steps)
    return GO_ON


@called_kernel
def count(data, _chunk):
    data.heat[0] += data.parts.sum()
    return GO_ON


class Dragged(md.integrators.Splitting):
    name, substeps, source = "dragged", (Kick(0.5), Drift(1.0), Kick(0.5), Thermalize(1.0)), "this script"
    is_thermostat, is_symmetric, is_symplectic, conserves_momentum = True, False, False, False

    def contact(self, state, duration, around, moment):
        n_chunks, calls = n_chunks_of(len(state.velocities)), CALLS[bool(state.steps)]
        atoms, kept = (state.velocities, state.masses, state.inverse_masses), np.exp(-0.5 * duration)
        data = Dragging(*atoms, kept, np.zeros(n_chunks), around.bath.heat, state.steps)
        yield operation(calls, drag, data, n_chunks)
        yield operation(calls, count, data)


positions, edges = md.lattice.crystal("fcc", [8, 8, 8], 1.68)  # 2048 atoms: four chunks
law = md.LennardJones(1.0, 1.0, 2.5, "force-shifted")
for precision in ("double", "fixed-point"):
    sim = md.Simulation(md.System(positions, cell=edges), law, Dragged(0.002), precision=precision)
    sim.set_temperature(1.0, seed=1)
    record = sim.run(1000, every=10)
    lost, rest = np.ptp(record.total_energy) / 2048, np.ptp(record.conserved_energy) / 2048
    print(f"{precision}: energy per atom changes by {lost:.3f} ε, with what the drag took by {rest:.1e} ε (exact: 0)")
record.plot().savefig("compiled_drag.png")
