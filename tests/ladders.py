"""Small ladders of md.exchange, as functions that worker processes can import.

A skin is given where there are no lists: else it would be chosen again after each exchange, which takes time."""

from pathlib import Path

import numpy as np
from h5md_runs import assert_same_file
from members import liquid
from numba import njit

import minimd as md

TEMPERATURES, STEPS, EVERY = (0.5, 0.53, 0.56), 80, 10
BARRIER, TILT, SIDES = 1.0, 0.05, 4.0
ORIGIN = np.zeros((1, 3))


@njit
def two_wells(x, y, z, _t, barrier, tilt, k):
    """Minima near x = −1 and 1, harmonic in y and z."""
    s = x * x - 1.0
    u = barrier * s * s + tilt * x + 0.5 * k * (y * y + z * z)
    return u, -4.0 * barrier * s * x - tilt, -k * y, -k * z


def melt(simulation, member):
    simulation.equilibrate(20, 2.0 * member["temperature"], progress=False)


def run(folder, steps=STEPS, **options):
    """A small ladder of 32 atoms."""
    usual = {"build": liquid, "temperatures": TEMPERATURES, "every": EVERY, "prepare": melt, "progress": False}
    return md.exchange(steps=steps, folder=folder, **usual | options)


def in_the_left_well(member):
    """One particle."""
    bath = md.LangevinBAOAB(0.05, member["temperature"], friction=0.5, seed=member.seed)
    particle = md.System(ORIGIN - [1.0, 0.0, 0.0])
    simulation = md.Simulation(particle, md.Field(two_wells, (BARRIER, TILT, SIDES)), bath, skin=0.5)
    simulation.set_temperature(member["temperature"], member.seed)
    return simulation


def oscillators(member, n=4, friction=1.0):
    """n particles in harmonic wells: 3n degrees of freedom."""
    bath = md.LangevinBAOAB(0.2, member["temperature"], friction, seed=member.seed)
    positions = np.random.default_rng(member.seed).normal(scale=member["temperature"] ** 0.5, size=(n, 3))
    simulation = md.Simulation(md.System(positions), md.Restraint(1.0, ORIGIN[0]), bath, skin=0.5)
    simulation.set_temperature(member["temperature"], member.seed)
    return simulation


def assert_same(ladder, other):
    """Ladders, and the files of their replicas, to the last bit."""
    for name in ("temperatures", "places", "energies", "accepted"):
        np.testing.assert_array_equal(getattr(ladder, name), getattr(other, name), strict=True)
    for k in range(len(ladder.temperatures)):
        assert_same_file(ladder.file(k), other.file(k))
    assert {path.name for path in Path(ladder.folder).rglob("*") if path.is_file()} == {
        path.name for path in Path(other.folder).rglob("*") if path.is_file()
    }
