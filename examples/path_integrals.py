"""Rahman's liquid argon moves by classical mechanics: how much kinetic energy does quantum mechanics add?

i-PI replaces each atom by a ring of beads, joined by springs: path integrals. It moves the beads, and asks minimd for
energy and forces. To the order ħ², E. Wigner (Phys. Rev. 40, 749 (1932)) needs forces F of a classical run alone: an
atom has K = 3/2 k_B T + ħ² ⟨F²⟩ / 24 m (k_B T)². Six beads give 35/36 of the second term, and what is beyond ħ².
"""

import os
import shutil
import subprocess
import time
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
from ase.build import bulk
from ase.calculators.socketio import SocketClient

import minimd as md
from minimd.ase import Calculator

if shutil.which("i-pi") is None:
    raise SystemExit("i-PI is missing: install it with 'pip install ipi', and run this again")

n_equilibration, n_steps, n_beads, temperature, every = 4000, 4000, 6, 94.4, 10  # K
fs, k_B, hbar = md.units.fs, md.units.ASE.k_B, 0.6582119569 * md.units.fs  # ħ = 0.658 eV fs
argon = md.LennardJones(120 * k_B, 3.4, cutoff=8.0, truncation="smooth")
atoms = bulk("Ar", "fcc", 5.78, cubic=True) * (3, 3, 3)  # 108 atoms at Rahman's density
simulation = md.Simulation(atoms, argon, md.LangevinBAOAB(10 * fs, temperature, 0.002 / fs, seed=1))
simulation.set_temperature(2 * temperature, seed=2)  # half of it goes into the melting crystal
simulation.run(n_equilibration, every=n_equilibration)
classical, kelvin, squares = 1.5 * temperature, len(atoms) * k_B, []  # Σ F² of the frames
simulation.run(n_steps, every=every, observers=[lambda run: squares.append((run.forces**2).sum())])
wigner = classical + hbar**2 * np.mean(squares) / (24 * 39.948 * (k_B * temperature) ** 2) / kelvin

address, edge = f"argon-{os.getpid()}", atoms.cell[0, 0]
cell = f"# CELL(abcABC): {edge} {edge} {edge} 90 90 90 cell{{angstrom}} positions{{angstrom}}"
atoms.positions[:], atoms.calc = simulation.positions, Calculator(argon)
atoms.write("start.xyz", format="xyz", comment=cell)
Path("ring.xml").write_text(f"""<simulation> <total_steps> {n_steps} </total_steps> <output prefix='ring'>
  <properties filename='out' stride='{every}'> [kinetic_cv{{electronvolt}}] </properties> </output>
  <ffsocket name='minimd' mode='unix'> <address> {address} </address> </ffsocket> <system>
  <forces> <force forcefield='minimd'/> </forces> <ensemble> <temperature units='kelvin'> {temperature} </temperature>
  </ensemble> <initialize nbeads='{n_beads}'> <file mode='xyz'> start.xyz </file> </initialize>
  <motion mode='dynamics'> <dynamics mode='nvt'> <timestep units='femtosecond'> 10 </timestep> <thermostat
  mode='pile_l'> <tau units='femtosecond'> 500 </tau> </thermostat> </dynamics> </motion> </system> </simulation>""")
ipi = subprocess.Popen(["i-pi", "ring.xml"], stdout=subprocess.DEVNULL)
while ipi.poll() is None and not Path(f"/tmp/ipi_{address}").exists():
    time.sleep(0.1)
SocketClient(unixsocket=address).run(atoms)  # until i-PI has made all its steps
ipi.wait()
kinetic = np.loadtxt("ring.out") / kelvin
mean, error = md.mean_and_error(kinetic[len(kinetic) // 10 :])
print(f"kinetic energy {mean:.2f} ± {error:.2f} K   (Wigner: {wigner:.2f} K; classical: {classical:.2f} K)")
plt.plot(0.01 * every * np.arange(len(kinetic)), kinetic, "0.7", label="path integrals (i-PI)")
for energy, color, name in ((mean, "k", "mean"), (wigner, "C3", "Wigner"), (classical, "C0", "classical")):
    plt.axhline(energy, color=color, label=name)
plt.gca().set(xlabel="time / ps", ylabel="kinetic energy of an atom / K")
plt.legend(frameon=False)
plt.savefig("path_integrals.png", dpi=150)
