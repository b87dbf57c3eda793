"""Forces of one's own: atoms fall onto an attractive floor, and a spring holds one atom. Is the total energy conserved?

    gravity  U = m g z                                F_z = −m g
    floor    U = ε [2/15 (σ/z)⁹ − (σ/z)³]             F_z = ε/z [6/5 (σ/z)⁹ − 3 (σ/z)³]
    spring   U = ½ k |r − r₀|²                        F = −k (r − r₀)

A potential has bind(system), which returns a term; its add(...) adds forces and energies. The field is compiled."""

import matplotlib.pyplot as plt
import numba
import numpy as np

import minimd as md
from minimd.potentials import FORCES, Term

gravity, floor_depth, stiffness, anchor = 0.5, 4.0, 20.0, np.array([3.0, 3.0, 4.0])  # σ/τ², ε, ε/σ², σ


@numba.njit
def add_field(positions, masses, g, epsilon, with_energy, forces, energies):
    for i in range(len(positions)):
        z, weight = positions[i, 2], masses[i] * g
        s3 = 1.0 / z**3
        forces[i, 2] += epsilon / z * (1.2 * s3**3 - 3.0 * s3) - weight
        if with_energy:
            energies[i] += epsilon * (2.0 / 15.0 * s3**3 - s3) + weight * z


class Outside(Term):
    acts_from_outside = True  # the total momentum is not conserved

    def bind(self, system):
        return self  # the potential is its own term


class Field(Outside):
    def add(self, system, detail, forces, energies, virials):
        add_field(system.positions, system.masses, gravity, floor_depth, detail != FORCES, forces, energies)


class Spring(Outside):
    def add(self, system, detail, forces, energies, virials):
        away = system.positions[0] - anchor
        forces[0] -= stiffness * away
        if detail != FORCES:
            energies[0] += 0.5 * stiffness * away @ away


sites = 1.2 * (np.indices((5, 5, 4)).reshape(3, -1).T + np.array([0.5, 0.5, 1.5]))
system = md.System(sites, cell=[6.0, 6.0, 20.0], pbc=(True, True, False))
laws = [md.LennardJones(1.0, 1.0, 2.5, "switched"), Field(), Spring()]
simulation = md.Simulation(system, laws, md.VelocityVerlet(0.002))
simulation.set_temperature(0.5, seed=1)
record = simulation.run(2000, every=20, progress=False)
potential, total = record.potential_energy, record.total_energy
print(f"potential energy  {potential[0]:.1f} -> {potential[-1]:.1f} ε: the atoms fall onto the floor")
print(f"total energy      varies by {np.ptp(total) / np.ptp(potential):.1e} of that   (expected: below 1e-3, ∝ Δt²)")
plt.plot(record.time, np.transpose([potential, record.kinetic_energy, total]), label=["potential", "kinetic", "total"])
plt.legend(title="energies / ε against time / τ", loc=(0.3, 0.27))
plt.savefig("own_force.png", dpi=150)
