"""Functions that worker processes can import: members of small ensembles, and what may happen to them."""

import os
import signal
import time
from pathlib import Path

import numpy as np
from numba import njit

import minimd as md
from minimd.structure.lattice import crystal

TEMPERATURES = {"temperature": [0.4, 0.5, 0.6, 0.7]}
STEPS = 60
POSITIONS, EDGES = crystal("fcc", [2, 2, 2], 1.6)


@njit
def gaussian(r2, height, width2):
    """A soft repulsion, as a user would write it."""
    u = height * np.exp(-r2 / width2)
    return u, 2.0 * u / width2


def liquid(member, law=None, timestep=0.004, **options):
    """32 atoms in a bath."""
    method = md.LangevinBAOAB(timestep, member["temperature"], 1.0, seed=member.seed)
    simulation = md.Simulation(
        md.System(POSITIONS, cell=EDGES), law or md.LennardJones(1.0, 1.0, 1.8), method, **options
    )
    simulation.set_temperature(member["temperature"], member.seed)
    return simulation


def own_law(member):
    return liquid(member, md.PairPotential(gaussian, (1.0, 0.5), 1.8))


def two_threads(member):
    return liquid(member, threads=2)


def hot(member, timestep=0.3):
    """Members above 0.6 blow up."""
    return liquid(member, timestep=timestep if member["temperature"] > 0.6 else 0.004)


def broken(member):
    raise LookupError(f"no structure for {member.index}")


def melted(simulation, member):
    simulation.equilibrate(20, 2.0 * member["temperature"], progress=False)


def pressure_alone(simulation, member):
    record = simulation.run(member.steps, every=10, progress=False)
    return {"pressure": record.pressure, "last": float(record.pressure[-1]), "known": (1.0, 0.1)}


def in_own_file(simulation, member):
    record = member.run(simulation, every=5)
    return {"pressure": record.pressure, "last": float(record.pressure[-1]), "step": simulation.step}


def one_is_killed(member):
    """The process of member 2 is killed, once."""
    once = member.file.parents[1] / "killed"
    simulation = liquid(member)
    if member.index == 2 and not once.exists():
        once.touch()
        os.kill(os.getpid(), signal.SIGKILL)
    return simulation


def counted(member):
    """Each call leaves a mark beside the folder."""
    with Path(member.file.parents[2] / "calls").open("a") as file:
        file.write(f"{member.index} {member.file.exists()}\n")
    return liquid(member)


def second_is_slow(member, seconds=0.5):
    """Each block of steps of member 1 takes half a second."""
    simulation = liquid(member)
    advance = simulation.engine.advance

    def slowly(*arguments, **options):
        time.sleep(seconds)
        return advance(*arguments, **options)

    if member.index == 1:
        simulation.engine.advance = slowly
    return simulation
