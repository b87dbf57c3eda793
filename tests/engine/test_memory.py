"""A bath with a memory, in a script: what it remembers is undone, stored and resumed with the state."""

import copy

import numpy as np
import pytest
from scenes import SCENES

import minimd as md
from minimd.core.integrators.splitting import Splitting
from minimd.core.integrators.substeps import Thermalize


class NoseHoover(Splitting):
    """Velocity Verlet, and half a step of the bath before and after it:

        dξ/dt = (2K − N_f k_B T)/Q,   dv/dt = −ξ v,   dη/dt = ξ;   H + ½ Q ξ² + N_f k_B T η is constant

    memory : ξ and η.  W. G. Hoover, Phys. Rev. A 31, 1695 (1985).
    """

    name = "nose-hoover"
    source = "W. G. Hoover, Phys. Rev. A 31, 1695 (1985)"
    substeps = (Thermalize(0.5), *md.VelocityVerlet.substeps, Thermalize(0.5))
    is_thermostat = True
    is_symplectic = False

    def __init__(self, timestep, temperature, mass):
        super().__init__(timestep)
        self.temperature = temperature
        self.mass = mass
        self.memory = np.zeros(2)

    @property
    def parameters(self):
        return {"timestep": self.timestep, "temperature": self.temperature, "mass": self.mass}

    def thermalize(self, state, duration, around):
        n_dof = around.bath.n_dof
        for _ in range(2):  # half a kick of ξ before and after the velocities are scaled
            self.memory[0] += 0.5 * duration * (2.0 * state.kinetic_energy() - n_dof * self.temperature) / self.mass
            if _ == 0:
                state.velocities *= np.exp(-duration * self.memory[0])
                self.memory[1] += duration * self.memory[0]


def melt():
    simulation = SCENES["argon"]().simulation(NoseHoover(0.004, 0.8, 60.0))
    simulation.set_temperature(1.0, seed=4)
    return simulation


def test_the_extended_energy_is_conserved():
    """Of 324 atoms' degrees of freedom, while the bath exchanges a hundred times the error."""
    simulation = melt()
    energies, heats = [], []
    for _ in range(40):
        simulation.run(10, every=10, progress=False)
        xi, eta = simulation.method.memory
        n_dof = simulation.n_dof
        heats.append(0.5 * 60.0 * xi**2 + n_dof * 0.8 * eta)
        energies.append(float(simulation.record.total_energy[-1]) + heats[-1])
    assert np.ptp(energies) < 0.02 * np.ptp(heats)
    assert np.ptp(heats) > 1.0


def test_a_run_in_two_parts_a_copy_and_a_resumed_one_have_the_bits_of_one(tmp_path):
    whole, parts, resumed_from = melt(), melt(), tmp_path / "run.h5md"
    whole.run(40, every=20, progress=False)
    parts.run(20, every=20, progress=False, trajectory=resumed_from)
    twin = copy.deepcopy(parts)
    again = md.Simulation.resume(resumed_from, SCENES["argon"]().laws, method=NoseHoover(0.004, 0.8, 60.0))
    assert again.method.memory.all()
    for simulation in (parts, twin, again):
        simulation.run(20, every=20, progress=False)
        assert np.array_equal(simulation.positions, whole.positions)
        assert np.array_equal(simulation.method.memory, whole.method.memory)
    assert twin.method.memory is not parts.method.memory


def test_a_snapshot_brings_the_memory_back():
    simulation = melt()
    simulation.run(8, every=8, progress=False)
    snapshot, memory = simulation.snapshot(), simulation.method.memory.copy()
    simulation.run(8, every=8, progress=False)
    assert not np.array_equal(simulation.method.memory, memory)
    simulation.restore(snapshot)
    assert np.array_equal(simulation.method.memory, memory)


def test_a_memory_of_another_shape_is_refused_and_a_method_without_one_takes_over(tmp_path):
    simulation = melt()
    simulation.run(4, every=4, progress=False, trajectory=tmp_path / "run.h5md")
    longer = NoseHoover(0.004, 0.8, 60.0)
    longer.memory = np.zeros(3)
    with pytest.raises(ValueError, match=r"memory of nose-hoover.*\(2,\).*\(3,\)"):
        md.Simulation.resume(tmp_path / "run.h5md", SCENES["argon"]().laws, method=longer)
    before = simulation.positions.copy(), simulation.step
    snapshot = simulation.snapshot()
    simulation.run(4, every=4, progress=False)
    now = simulation.positions.copy()
    simulation.method.memory = np.zeros(3)
    with pytest.raises(ValueError, match="memory of nose-hoover"):
        simulation.restore(snapshot)  # nothing is restored
    assert np.array_equal(simulation.positions, now)
    simulation.method.memory = np.zeros(2)
    simulation.restore(snapshot)
    assert np.array_equal(simulation.positions, before[0])
    plain = md.Simulation.resume(tmp_path / "run.h5md", SCENES["argon"]().laws, method=md.VelocityVerlet(0.004))
    assert np.array_equal(plain.positions, before[0])
    fixed = SCENES["argon"]().simulation(NoseHoover(0.004, 0.8, 60.0), precision="fixed-point")
    with pytest.raises(ValueError, match="memory has no way back"):
        fixed.run_back(4)
