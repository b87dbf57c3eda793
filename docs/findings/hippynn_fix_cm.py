"""hippynn: ASELangevinDynamics with fix_cm=True, the default, is wrong for unequal masses, as ASE's
fixcm=True, from which it is derived.

It subtracts the mean of the noise with weights that are right for equal masses only. Four free atoms, 300 K: light
atoms get the noise of heavy ones. fix_cm=False is right.
Cure: subtract sum(m r)/sum(m) of both noises, rnd_vel and rnd_pos, from every atom."""

import torch
from ase.units import fs, kB
from hippynn.molecular_dynamics import md

MASSES = torch.tensor([[2.45, 8.35, 30.4, 120.3]], dtype=torch.float64)
STEPS, T = 100_000, 300.0


def no_force(positions, batch_size):
    """A model without forces."""
    return {"forces": torch.zeros_like(positions)}


no_force.inputs = []
for fix_cm in (True, False):
    torch.manual_seed(1)
    x = torch.zeros((1, 4, 3), dtype=torch.float64)
    v = torch.randn((1, 4, 3), dtype=torch.float64) * (kB * T / MASSES[..., None]) ** 0.5 * fs
    v -= (MASSES[..., None] * v).sum(dim=1) / MASSES.sum()
    updater = md.ASELangevinDynamics("forces", temperature_K=T, frix=0.02, fix_cm=fix_cm)
    data = {"position": x, "velocity": v, "acceleration": torch.zeros_like(x), "mass": MASSES.clone()}
    atoms = md.Variable("atoms", data, {"positions": "position"}, updater)
    dynamics = md.MolecularDynamics([atoms], no_force)
    twice = torch.zeros(4, dtype=torch.float64)
    for _ in range(STEPS):
        dynamics._step(1.0)
        twice += MASSES[0] * ((atoms.data["velocity"][0] / fs) ** 2).sum(dim=1)
    moving = 9 if fix_cm else 12
    each = ", ".join(f"{t:.2f}" for t in twice / STEPS / (3.0 * kB * T))
    print(f"fix_cm={fix_cm}: T = {twice.sum() / STEPS / moving / kB:.0f} K; <p²/3m>/kT of the atoms: {each}")
print("right with a center at rest: 1 − m/Σm:", ", ".join(f"{1 - m / MASSES.sum():.2f}" for m in MASSES[0]))
