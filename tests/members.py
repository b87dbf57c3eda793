"""Members of small ensembles, as functions that worker processes can import, and what may befall them."""

import sys
import time
from functools import partial
from pathlib import Path

import numpy as np
from numba import njit

import minimd as md

TEMPERATURES = {"temperature": [0.4, 0.5, 0.7]}
STEPS = 60
FILES = [f"0000-0999/{k:04d}.h5md" for k in range(3)]
POSITIONS, EDGES = md.lattice.crystal("fcc", [2, 2, 2], 1.6)


def liquid(member, fate=None, law=None, **options):
    """32 atoms in a bath.  fate : function of simulation and member, called at the end."""
    method = md.LangevinBAOAB(0.004, member["temperature"], 1.0, seed=member.seed)
    law = law or md.LennardJones(1.0, 1.0, 1.8)
    simulation = md.Simulation(md.System(POSITIONS, cell=EDGES), law, method, **options)
    simulation.set_temperature(member["temperature"], member.seed)
    if fate is not None:
        fate(simulation, member)
    return simulation


def leaves(_simulation, member):
    if member.index == 1:
        sys.exit(5)


def melted(simulation, member):
    simulation.equilibrate(20, 2.0 * member["temperature"], progress=False)


def run(folder, fate=None, **options):
    """A small ensemble, in this process unless options say otherwise; its build has the same name whatever the fate."""
    usual = {"build": partial(liquid, fate=fate), "parameters": TEMPERATURES, "steps": STEPS, "prepare": melted}
    usual |= {"every": 5, "progress": False, "workers": None if "executor" in options else 0}
    return md.ensemble(**usual | {"folder": folder} | options)


def assert_same(folder, other):
    """Tables are the same, and all that minimd reads from files of members, to the last bit."""
    for name in ("table.csv", "table.json"):
        assert Path(folder, name).read_bytes() == Path(other, name).read_bytes()
    assert_same_files(folder, other)


def assert_same_files(folder, other):
    from h5md_runs import assert_same_file  # which loads MDAnalysis, not wanted in the workers

    for name in FILES:
        assert_same_file(Path(folder, name), Path(other, name))


@njit
def gaussian(r2, height, width2):
    """A soft repulsion, as a user would write it."""
    u = height * np.exp(-r2 / width2)
    return u, 2.0 * u / width2


def own_law(member):
    return liquid(member, law=md.PairPotential(gaussian, (1.0, 0.5), 1.8))


def broken(simulation, member):
    raise LookupError(f"no structure for {member.index}")


def third_breaks_once(simulation, member):
    once = member.file.parents[1] / "broken"
    if member.index == 2 and not once.exists():
        once.touch()
        broken(simulation, member)


def blows_up(simulation, member):
    """Above 0.6, in the place of `melted`."""
    melted(simulation, member)
    if member["temperature"] > 0.6:
        simulation.method = md.LangevinBAOAB(0.04, member["temperature"], 1.0, seed=member.seed)


blows_up.__qualname__, blows_up.__wrapped__ = melted.__qualname__, melted  # of the same name and code


def second_is_slow(simulation, member):
    """Each block of steps of member 1 takes 0.2 s."""
    advance = simulation.engine.advance
    if member.index == 1:
        simulation.engine.advance = lambda *of, **how: (time.sleep(0.2), advance(*of, **how))[1]


def in_own_file(simulation, member):
    record = member.run(simulation, every=5)
    return {"pressure": record.pressure, "last": float(record.pressure[-1]), "step": simulation.step}
