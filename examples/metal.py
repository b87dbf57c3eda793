"""Two metals: are the elastic constants of tungsten those of the paper, and when does a droplet of copper melt?

Tungsten by Finnis and Sinclair (Philos. Mag. A 50, 45 (1984), tables 1 and 2), copper by Cleri and Rosato (Phys. Rev. B
48, 22 (1993)). A small cluster melts far below the crystal: most of its atoms are at the surface.
"""

import matplotlib.pyplot as plt
import numpy as np
from ase.build import bulk
from ase.cluster import Icosahedron
from scipy.spatial.distance import pdist

import minimd as md

fs, ps, GPA = md.units.fs, md.units.ps, 1e4 * md.units.BAR
n_equilibration, n_steps, every = 2000, 4000, 50
temperatures = np.arange(300.0, 1301.0, 50.0)  # K
numbers = (1.896373, 4.400224, 0.0, 3.25, 47.1346499, -33.7665655, 6.2541999)  # A, d, β, c, c₀, c₁, c₂
tungsten = md.EmbeddedAtom("finnis-sinclair", numbers, cutoff=4.400224)
# smooth between the fifth and the sixth shell of neighbors: the crystal keeps the properties of the paper
copper = md.EmbeddedAtom("gupta", (0.0855, 1.224, 10.96, 2.278, 2.556), 6.2, "smooth", switch_start=5.75)
distances = []  # between all atoms of the cluster, at each look


def stress(strain):
    """Stress of strained tungsten at 0 K [GPa]. Each atom is a center of symmetry, so that none moves to relax it."""
    crystal = bulk("W", "bcc", a=3.1652, cubic=True) * (5, 5, 5)
    crystal.set_cell(crystal.cell.array @ (np.eye(3) + strain), scale_atoms=True)
    return -md.evaluate(md.System.from_ase(crystal), tungsten).virial / crystal.get_volume() / GPA


def look(run):
    distances.append(pdist(run.positions))


along, shear = np.zeros((2, 3, 3))
along[0, 0] = shear[1, 2] = shear[2, 1] = 1e-4
pull, tilt = ((stress(strain) - stress(-strain)) / 2e-4 for strain in (along, shear))
print(f"W  C11 {pull[0, 0]:.1f}, C12 {pull[1, 1]:.1f}, C44 {tilt[1, 2] / 2:.1f} GPa   (paper: 522.4, 204.4, 160.6)")

cluster = Icosahedron("Cu", 4)  # 147 atoms, in free space
bath = md.LangevinBAOAB(4.0 * fs, temperatures[0], friction=1.0 / ps, seed=1)
simulation = md.Simulation(cluster, copper, bath)
simulation.set_temperature(temperatures[0], seed=2)
energies, deltas = [], []  # Lindemann's index δ: standard deviation over mean of a distance, averaged over all pairs
for temperature in temperatures:
    simulation.method.temperature = temperature
    simulation.run(n_equilibration, every=n_equilibration, progress=False)
    distances.clear()
    record = simulation.run(n_steps, every=every, observers=[look], progress=False)
    energies.append(record.potential_energy.mean() / len(cluster))
    deltas.append((np.std(distances, axis=0) / np.mean(distances, axis=0)).mean())
    print(f"Cu  {temperature:4.0f} K: {energies[-1]:.4f} eV per atom, Lindemann's index {deltas[-1]:.3f}")
first = np.argmax(np.array(deltas) > 0.1)
print(f"Cu  melts between {temperatures[first - 1]:.0f} and {temperatures[first]:.0f} K, on heating (crystal: 1358 K)")
figure, (left, right) = plt.subplots(1, 2, figsize=(9, 4), layout="constrained")
for axes, values, name in ((left, energies, "potential energy / eV per atom"), (right, deltas, "Lindemann's index")):
    axes.plot(temperatures, values, "o-")
    axes.set(xlabel="T / K", ylabel=name)
figure.savefig("metal.png", dpi=150)
