"""The equation of state of the Lennard-Jones liquid, at twenty temperatures on all cores: is it that of NIST?

NIST has results for 500 atoms at ρ* = 0.776: https://mmlapps.nist.gov/srs/LJ_PURE/mc.htm. Here p is 0.014 lower,
because there are 256 atoms and forces do not feel the jump at the cutoff (docs/ensembles.md). An interrupted scan
continues when the script is run again; its folder needs 240 MB."""

import matplotlib.pyplot as plt
import numpy as np

import minimd as md

density, friction, timestep, n_cells = 0.776, 0.5, 0.004, 4
n_equilibration, n_steps, every = 4000, 25_000, 50
nist = {0.85: (-5.5121, 0.0067714), 0.90: (-5.4689, 0.24056)}  # T*: U*/N, p*
temperatures = np.round(np.arange(0.70, 1.69, 0.05), 2)


def build(member):
    """256 atoms in a bath, which start on a lattice."""
    positions, edges = md.lattice.crystal("fcc", [n_cells] * 3, (4.0 / density) ** (1 / 3))
    law = md.LennardJones(1.0, 1.0, 3.0, "truncated", tail_correction=True)
    bath = md.LangevinBAOAB(timestep, member["temperature"], friction, seed=member.seed)
    liquid = md.Simulation(md.System(positions, cell=edges), law, bath)
    liquid.set_temperature(2.0 * member["temperature"], member.seed)
    return liquid


def melt(liquid, member):
    """Equilibrate once, before the steps that count."""
    liquid.equilibrate(n_equilibration, 3.0, progress=False)
    liquid.run(n_equilibration, every=n_equilibration, progress=False)


if __name__ == "__main__":  # worker processes import this file
    scan = {"temperature": temperatures}
    table = md.ensemble(build, scan, n_steps, prepare=melt, every=every, folder="equation_of_state")
    for row in table.array:
        known = "   (NIST: {:.4f}, {:.4f})".format(*nist[row["temperature"]]) if row["temperature"] in nist else ""
        energy, error = row["potential_energy_mean"] / row["n_atoms"], row["potential_energy_error"] / row["n_atoms"]
        pressure = f"{row['pressure_mean']:.3f} ± {row['pressure_error']:.3f}"
        print(f"T* {row['temperature']:.2f}: U* {energy:.4f} ± {error:.4f}, p* {pressure}{known}")

    figure, panels = plt.subplots(1, 2, figsize=(9, 4), layout="constrained")
    for k, (panel, name, scale) in enumerate(zip(panels, ("potential_energy", "pressure"), (256, 1), strict=True)):
        values, errors = table[f"{name}_mean"] / scale, table[f"{name}_error"] / scale
        panel.errorbar(temperatures, values, errors, fmt=".-", label="20 runs of 256 atoms")
        panel.plot(list(nist), [known[k] for known in nist.values()], "D", color="C3", mfc="none", ms=9, label="NIST")
        panel.set(xlabel="T*", ylabel=("U* / N", "p*")[k])
        panel.legend(frameon=False)
    figure.savefig("equation_of_state.png", dpi=150)
