"""A spring pulls a chain: what does the work say about the free energy? Jarzynski's equality.

Four beads on harmonic springs of length zero are in a bath. The first bead is held at the origin. A spring, whose point
moves from 0 to L in a time τ, pulls the last bead. Positions are Gaussian, so the free energy is exact: for springs in
series, k_eff = 1/(3/k + 1/κ) and ΔF = k_eff L²/2.

    ⟨W⟩ ≥ ΔF, by the second law;   −k_B T ln ⟨exp(−W/k_B T)⟩ = ΔF, at any speed;
    ⟨W⟩ − var W/(2 k_B T) = ΔF, because W is Gaussian

C. Jarzynski, Phys. Rev. Lett. 78, 2690 (1997); O. Mazonka, C. Jarzynski, arXiv:cond-mat/9912121 (1999). Reduced units.
"""

import matplotlib.pyplot as plt
import numpy as np

import minimd as md

n_chains, temperature, k, kappa, length = 400, 1.0, 8.0, 10.0, 2.0
exact = 0.5 * length**2 / (3.0 / k + 1.0 / kappa)
atoms = np.arange(4 * n_chains).reshape(n_chains, 4)
bonds = np.concatenate([atoms[:, c : c + 2] for c in range(3)])  # many chains at once, which do not interact
system = md.System(np.zeros((4 * n_chains, 3)), bonds=bonds)


def works(duration, seed):
    """The work on each chain, ∫ −v·F dt, for one pull of this duration."""
    spring = md.SteeredSpring(kappa, [0.0, 0.0, 0.0], [length / duration, 0.0, 0.0], atoms[:, 3])
    bath = md.LangevinBAOAB(0.05, temperature, friction=1.0, seed=seed)
    simulation = md.Simulation(system, [md.HarmonicBond(k, 0.0), spring], bath, md.FixedAtoms(atoms[:, 0]))
    simulation.set_temperature(temperature, seed)
    simulation.equilibrate(400, temperature, every=400)  # it ends at time 0, when the point starts
    power = []

    def watch(now):
        stretch = spring.points_at(now.time) - now.positions[atoms[:, 3]]
        power.append(kappa * stretch[:, 0] * length / duration)

    record = simulation.run(round(duration / 0.05), every=1, observers=[watch], progress=False)
    return np.trapezoid(power, record.time, axis=0), record


print(f"exact ΔF = {exact:.3f} ε   (expected: ⟨W⟩ above it, the others equal where W varies by little more than k_B T)")
figure, panel = plt.subplots(figsize=(6, 4), layout="constrained")
for duration in (2.0, 10.0, 50.0):
    done, record = works(duration, seed=1)
    average, spread = done.mean(), done.std(ddof=1) / n_chains**0.5
    jarzynski = -temperature * np.log(np.mean(np.exp(-done / temperature)))
    cumulant = average - done.var(ddof=1) / (2.0 * temperature)
    drift = np.ptp(record.conserved_energy) / n_chains
    off = abs(record.work[-1] / done.sum() - 1.0)
    print(f"τ = {duration:.0f}: ⟨W⟩ = {average:.3f} ± {spread:.3f}, Jarzynski {jarzynski:.3f}, Gaussian {cumulant:.3f}")
    print(f"    recorded work is their sum to {off:.0e}; E − Q − W varies by {drift:.3f} ε a chain")
    panel.hist(done, bins=25, density=True, alpha=0.5, label=f"τ = {duration:.0f}")
panel.axvline(exact, color="k", ls="--", label="ΔF, exact")
panel.set(xlabel="work on one chain / ε", ylabel="probability density / ε⁻¹")
panel.legend(frameon=False)
figure.savefig("stretched_chain.png", dpi=150)
