"""nvalchemi: NPT, isotropic, gives its barostat three times the temperature, so that the volume fluctuates too much.

All three diagonal elements of the strain rate are equal: one degree of freedom. Its thermostat counts three of them
(_cell_dof_count). An ideal gas of N atoms with its center of mass at rest has p(V) ∝ V^(N−1) exp(−PV/kT) under a
barostat that scales momenta, for which the variance of ln V is ψ′(N); 200 of them start from exact samples. (That the
atoms have 3N − 3 degrees of freedom, where NPT counts 3N, makes it 2 % larger.)
Cure: one degree of freedom for pressure_coupling="isotropic", in the count (npt_thermostat_half_step multiplies it by
3) and in the masses of its chain."""

import numpy as np
import torch
from ase import Atoms
from ase.units import kB
from nvalchemi.data import AtomicData, Batch
from nvalchemi.dynamics import NPT
from nvalchemi.models.base import BaseModelMixin, ModelConfig
from scipy.special import polygamma

N, SYSTEMS, T, PRESSURE = 8, 200, 300.0, 2e-4  # eV/Å³
EQUILIBRATION, STEPS, EVERY = 1000, 2000, 20  # of 4 fs
NAMES = {"energy", "forces", "stress"}
rng = np.random.default_rng(1)


class IdealGas(torch.nn.Module, BaseModelMixin):
    """No forces."""

    embedding_shapes = compute_embeddings = None

    def __init__(self):
        super().__init__()
        self.model_config = ModelConfig(outputs=frozenset(NAMES), autograd_outputs=frozenset())
        self.model_config.active_outputs = NAMES

    def forward(self, data):
        """Zeros."""
        return {
            "energy": torch.zeros((SYSTEMS, 1), dtype=torch.float64),
            "forces": torch.zeros_like(data.positions),
            "stress": torch.zeros_like(data.cell),
        }


def sample():
    """A gas with its center of mass at rest, of a volume and momenta from the ensemble."""
    edge = (rng.gamma(N) * kB * T / PRESSURE) ** (1 / 3)
    atoms = Atoms(f"Ar{N}", rng.uniform(0.0, edge, (N, 3)), cell=[edge] * 3, pbc=True)
    momenta = rng.normal(size=(N, 3)) * np.sqrt(kB * T * atoms.get_masses())[:, None]
    atoms.set_momenta(momenta - momenta.mean(axis=0))
    data = AtomicData.from_atoms(atoms, dtype=torch.float64)
    data.velocities = torch.tensor(atoms.get_velocities())
    data.forces = torch.zeros_like(data.velocities)
    return data


batch = Batch.from_data_list([sample() for _ in range(SYSTEMS)])
dynamics = NPT(IdealGas(), 4.0, T, PRESSURE, barostat_time=100.0, thermostat_time=50.0)
dynamics.run(batch, EQUILIBRATION)
logs = []
for _ in range(STEPS // EVERY):
    dynamics.run(batch, EVERY)
    logs.append(torch.linalg.det(batch.cell).log().numpy())
squares = (np.array(logs) - np.mean(logs)) ** 2
variances = squares.mean(axis=0)  # of each system
error = variances.std(ddof=1) / SYSTEMS**0.5
print(f"variance of ln V: {variances.mean():.4f} ± {error:.4f}; right: {polygamma(1, N):.4f}")
