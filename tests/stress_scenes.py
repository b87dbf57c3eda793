"""What the stress tests share: scenes, and the two ways in which a scene may end."""

import re

import numpy as np
import pytest

import minimd as md
from minimd.forces.options import Options
from minimd.potentials.term import TOTALS
from minimd.structure.lattice import crystal

SMOOTH = md.LennardJones(1.0, 1.0, 2.5, "force-shifted")
OPEN = md.LennardJones(1.0, 1.0)
BOTTOM = 2.0 ** (1.0 / 6.0)  # of the well [σ]
CURVATURE = 72.0 / 2.0 ** (1.0 / 3.0)  # u″ there [ε/σ²]
ROUNDING = 1e-12  # of sums over some thousand pairs, relative to the largest
LAST_GOOD = r"The system holds the last good state, that of step \d+"


def solid(n_cells=4, jitter=0.05, cell=True, seed=1, **more):
    """An fcc crystal a little out of order: 4 n³ atoms."""
    positions, edges = crystal("fcc", [n_cells] * 3, 1.68)
    positions = positions + jitter * np.random.default_rng(seed).standard_normal(positions.shape)
    return md.System(positions, cell=edges if cell else None, **more)


def forces_of(system, potentials, **options):
    """Forces, with energy and virial, under some Options."""
    forces = md.Forces(system, potentials, Options(**options))
    forces.compute(TOTALS)
    return forces


def ran(
    system,
    potentials,
    timestep,
    n_steps,
    *,
    temperature=None,
    every=100,
    constraints=None,
    method=md.VelocityVerlet,
    **options,
):
    """A simulation that has run."""
    simulation = md.Simulation(
        system, potentials, method(timestep) if isinstance(method, type) else method, constraints, **options
    )
    if temperature is not None:
        simulation.set_temperature(temperature, seed=1)
    simulation.run(n_steps, every=every)
    return simulation


def oscillation(simulation):
    """Largest departure of the total energy from its start, relative to the largest kinetic energy."""
    record = simulation.record
    return float(np.abs(record.total_energy - record.total_energy[0]).max() / record.kinetic_energy.max())


def assert_stops(words, run, error=md.NonFiniteError):
    """The run ends with a sentence that names the cause, and one of what was seen: no NaN in it, nothing from the inside."""
    with pytest.raises(error, match=words) as caught:
        run()
    message = str(caught.value)
    assert type(caught.value) is error
    assert message.count("\n") <= (error in (md.NonFiniteError, md.ConstraintError))
    assert not re.search(r"\b(nan|None|Traceback)\b", message)
    return message


def is_finite(simulation):
    """Whether every number of the state and of the record is one."""
    record = simulation.record
    series = [
        record.total_energy,
        record.temperature,
        record.momentum,
        record.angular_momentum,
        simulation.positions,
        simulation.velocities,
    ]
    return all(np.isfinite(values).all() for values in series)
