"""What travels: pickle, copy and deepcopy of all objects, with the same bits afterwards and nothing shared."""

import copy
import pickle

import numpy as np
import pytest
from members import gaussian
from scenes import SCENES

import minimd as md

WAYS = {"pickle": lambda one: pickle.loads(pickle.dumps(one)), "copy": copy.copy, "deepcopy": copy.deepcopy}
MINE = md.units.UnitSystem(name="mine", k_B=2.0)
OBJECTS = [
    md.System(np.eye(3), cell=3.0, species=["A", "B", "A"], bonds=[[0, 1]]),
    md.LennardJones({"A": (1.0, 1.0), "B": (0.5, 0.9)}, cutoff=2.5, truncation="switched"),
    md.PairPotential(gaussian, (1.0, 2.0), 2.0), md.HarmonicBond(1.0, 1.0), md.LangevinBAOAB(0.1, 1.0, 1.0, seed=2),
    md.DistanceConstraints([[0, 1]], 1.0),
]  # fmt: skip
RUNS = {"slab": "position-verlet", "dumbbells": "langevin-baoab", "chain": "leapfrog", "droplet": "velocity-verlet"}


def simulated(name):
    """Atoms are held fixed in the slab."""
    method = RUNS[name]
    scene, bath = SCENES[name](), {"temperature": 1.0, "friction": 1.0, "seed": 3} if "langevin" in method else {}
    fixed = [md.FixedAtoms([0, 7])] if name == "slab" else scene.constraints
    return scene._replace(constraints=fixed).simulation(md.integrators.METHODS[method](0.003, **bath), threads=1)


@pytest.mark.parametrize("way", WAYS)
def test_objects_travel_and_units_stay_the_same_object(way):
    for one in OBJECTS:
        other = WAYS[way](one)
        assert type(other) is type(one)
        assert repr(other) == repr(one)
        arrays = {name: array for name, array in vars(one).items() if isinstance(array, np.ndarray)}
        assert all(vars(other)[name].flags.writeable == array.flags.writeable for name, array in arrays.items())
    assert WAYS[way](md.units.ASE) is md.units.ASE
    assert WAYS[way](md.System(np.eye(3), masses=40.0, units=md.units.ASE)).units is md.units.ASE
    assert WAYS[way](MINE) == MINE


@pytest.mark.parametrize("way", WAYS)
@pytest.mark.parametrize("scene", RUNS)
def test_a_copy_of_a_simulation_makes_the_same_steps(scene, way):
    one = simulated(scene)
    one.run(37, every=10)
    other, start = WAYS[way](one), one.positions.copy()
    other.run(50, every=10)
    assert np.array_equal(one.positions, start)  # nothing is shared
    checkpoint = one.engine.checkpoint()
    one.run(50, every=10)
    for name in ("positions", "velocities", "time", "reservoir_energy"):
        assert np.array_equal(getattr(one, name), getattr(other, name))
    assert np.array_equal(one.record.total_energy, other.record.total_energy)
    assert str(WAYS[way](one).report()).split("speed")[0] == str(one.report()).split("speed")[0]
    one.engine.go_on_from(checkpoint)  # which stayed as it was
    one.run(50)
    assert np.array_equal(one.positions, other.positions)


def test_a_copy_knows_that_its_state_was_changed():
    one = simulated("slab")
    one.run(20)
    one.velocities[:] *= 1.1
    other = copy.copy(one)
    one.run(20)
    other.run(20)
    assert np.array_equal(one.positions, other.positions)
