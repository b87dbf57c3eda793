"""nvalchemi: NPT, isotropic, gives its barostat three times the temperature, so that the volume fluctuates too much.

All three diagonal elements of the strain rate are equal, one degree of freedom, but its thermostat counts three
(_cell_dof_count). An ideal gas of N atoms has p(V) ∝ V^N exp(−PV/kT), for which the variance of ln V is ψ′(N + 1).
Cure: one degree of freedom for pressure_coupling="isotropic"; npt_thermostat_half_step multiplies its count by 3."""

import numpy as np
import torch
from ase import Atoms
from ase.units import kB
from nvalchemi.data import AtomicData, Batch
from nvalchemi.dynamics import NPT
from nvalchemi.models.base import BaseModelMixin, ModelConfig
from scipy.special import polygamma

N, T, VOLUME, STEPS = 8, 300.0, 1000.0, 20_000
NAMES = {"energy", "forces", "stress"}


class IdealGas(torch.nn.Module, BaseModelMixin):
    """No forces."""

    embedding_shapes = compute_embeddings = None

    def __init__(self):
        super().__init__()
        self.model_config = ModelConfig(outputs=frozenset(NAMES), autograd_outputs=frozenset())
        self.model_config.active_outputs = NAMES

    def forward(self, data):
        """Zeros."""
        forces = torch.zeros_like(data.positions)
        return {"energy": forces[:1, :1], "forces": forces, "stress": torch.zeros_like(data.cell)}


rng = np.random.default_rng(1)
atoms = Atoms(f"Ar{N}", rng.uniform(0.0, 10.0, (N, 3)), cell=[VOLUME ** (1 / 3)] * 3, pbc=True)
momenta = rng.normal(size=(N, 3)) * np.sqrt(kB * T * atoms.get_masses())[:, None]
atoms.set_momenta(momenta - momenta.mean(axis=0))
data = AtomicData.from_atoms(atoms, dtype=torch.float64)
data.velocities = torch.tensor(atoms.get_velocities())
data.forces = torch.zeros_like(data.velocities)
batch = Batch.from_data_list([data])
pressure = (N + 1) * kB * T / VOLUME
dynamics = NPT(IdealGas(), 4.0, T, pressure, barostat_time=100.0, thermostat_time=50.0)
logs = []
for _ in range(STEPS):
    dynamics.run(batch, 1)
    logs.append(float(torch.log(torch.linalg.det(batch.cell[0]))))
logs = np.array(logs[STEPS // 10 :])
blocks = [block.var() for block in np.array_split(logs, 5)]
error = np.std(blocks, ddof=1) / len(blocks) ** 0.5
print(f"variance of ln V: {logs.var():.3f} ± {error:.3f}; right: {polygamma(1, N + 1):.3f}")
