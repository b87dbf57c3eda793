"""Does a run conserve energy and momentum, seen during the run? MDAnalysis reads liquid argon live.

The run sends its frames by the protocol IMDv3. The reader adds ½ Σ m v² to the potential energy that it receives, and
computes Σ m v. Here both are in one process; another process opens imd://localhost:8888.
Needs: pip install '.[live]'"""

from importlib.util import find_spec
from threading import Thread
from time import sleep

import matplotlib.pyplot as plt
import numpy as np

import minimd as md
from minimd.mdanalysis import universe

ASE, fs = md.units.ASE, md.units.fs
n_equilibration, n_steps = 500, 2000
kinetic_unit = 0.01  # kJ/mol, of u Å²/ps²

positions, edges = md.lattice.crystal("fcc", [6, 6, 6], 5.78)  # 864 atoms
system = md.System(positions, masses=39.948, cell=edges, units=ASE)
argon = md.LennardJones(120.0 * ASE.k_B, 3.4, cutoff=8.5, truncation="force-shifted")
simulation = md.Simulation(system, argon, md.VelocityVerlet(10.0 * fs))
simulation.set_temperature(190.0, seed=1)
simulation.equilibrate(n_equilibration, 95.0)


def watch(trajectory, masses):
    """Total energy of each frame [kJ/mol], and the largest |Σ m v| relative to Σ |m v|."""
    totals, shares = [], []
    for ts in trajectory:
        kinetic = 0.5 * kinetic_unit * (masses * (ts.velocities**2).sum(axis=1)).sum()
        momenta = masses[:, None] * ts.velocities
        totals.append(ts.data["potential_energy"] + kinetic)
        shares.append(np.linalg.norm(momenta.sum(axis=0)) / np.linalg.norm(momenta, axis=1).sum())
        print(f"step {ts.data['step']:5d}: {totals[-1]:10.3f} kJ/mol", end="\r")
    return np.array(totals), max(shares)


if find_spec("imdclient") is None:
    print("nobody reads: the package imdclient is missing (pip install '.[live]')")
else:
    stream = md.observers.Stream(port=0, every=20, wait=True)  # any free port; the run begins when a reader connects
    run = Thread(target=simulation.run, args=[n_steps], kwargs={"observers": [stream], "progress": False})
    reader = universe(simulation)
    run.start()
    while run.is_alive() and stream.address.endswith(":0"):  # until the port is open
        sleep(0.01)
    reader.load_new(stream.address)
    energies, share = watch(reader.trajectory, reader.atoms.masses)
    run.join()
    strays = np.ptp(energies) / len(positions)
    print(f"{len(energies)} frames: total energy varies by {strays:.1e} kJ/mol an atom   (expected: below 2e-3)")
    print(f"sum of momenta: {share:.0e} of what they are   (expected: below 1e-6, the rounding of float32)")
    plt.plot(energies / len(positions), ".-")
    plt.xlabel("frame")
    plt.ylabel("total energy per atom [kJ/mol]")
    plt.savefig("live.png", dpi=120)
