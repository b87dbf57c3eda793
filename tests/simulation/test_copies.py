"""What travels: pickle, copy and deepcopy of all objects, and runs in files, with the same bits and nothing shared."""

import copy
import pickle

import numpy as np
import pytest
from engine.test_barostat import at_pressure
from fixed_point_scenes import mixture, simulated
from members import gaussian
from rigid_scenes import PAIRS, dumbbells
from scenes import SCENES

import minimd as md

WAYS = {"pickle": lambda one: pickle.loads(pickle.dumps(one)), "copy": copy.copy, "deepcopy": copy.deepcopy}
MINE = md.units.UnitSystem(name="mine", k_B=2.0)
OBJECTS = [
    md.System(np.eye(3), cell=3.0, species=["A", "B", "A"], bonds=[[0, 1]], charges=[0.5, -1.0, 0.5]), md.Coulomb(1.4),
    md.LennardJones({"A": (1.0, 1.0), "B": (0.5, 0.9)}, cutoff=2.5, truncation="switched"),
    md.PairPotential(gaussian, (1.0, 2.0), 2.0), md.HarmonicBond(1.0, 1.0), md.LangevinBAOAB(0.1, 1.0, 1.0, seed=2),
    md.DistanceConstraints([[0, 1]], 1.0),
]  # fmt: skip
BATH, BUSSI = md.LangevinBAOAB(0.003, 1.0, 1.0, seed=3), md.StochasticVelocityRescaling(0.003, 1.0, 0.5, seed=3)
HELD = [md.DistanceConstraints(PAIRS[1:]), md.FixedAtoms([0, 1])]
FIXED, STRAIN, ATOM = [md.FixedAtoms([0, 7])], {"coupling": "triclinic"}, md.System(np.zeros((1, 3)), masses=1.5)
SPRING = md.SteeredSpring(6.0, [0, 0, 0], [0.8, 0, 0], start=0.2, end=1.1)
RUNS = {  # of which these first ones have no bath
    "slab": lambda: SCENES["slab"]()._replace(constraints=FIXED).simulation(md.PositionVerlet(0.003), threads=1),
    "chain": lambda: SCENES["chain"]().simulation(md.Leapfrog(0.003)), "droplet": SCENES["droplet"]().simulation,
    "fixed-point": lambda: simulated(mixture()), "pulled": lambda: md.Simulation(ATOM, SPRING, md.PositionVerlet(0.02)),
    "pulled in a bath": lambda: md.Simulation(ATOM, SPRING, md.LangevinBAOAB(0.02, 0.5, 1.0, seed=2)),
    "dumbbells": lambda: dumbbells(HELD, BATH),
    "argon": lambda: SCENES["argon"]().simulation(BATH), "rescaled": lambda: SCENES["argon"]().simulation(BUSSI),
    "strained": lambda: at_pressure("clusters", **STRAIN), "rigid": lambda: at_pressure("dumbbells", **STRAIN),
}  # fmt: skip


def state_of(one):
    return one.positions, one.velocities, one.system.cell.vectors, one.time, one.reservoir_energy, one.work


@pytest.mark.parametrize("way", WAYS)
def test_objects_travel_and_units_stay_the_same_object(way):
    for one in OBJECTS:
        other = WAYS[way](one)
        assert type(other) is type(one)
        assert repr(other) == repr(one)
        arrays = {name: array for name, array in vars(one).items() if isinstance(array, np.ndarray)}
        assert all(np.array_equal(vars(other)[name], array) for name, array in arrays.items())
        assert all(vars(other)[name].flags.writeable == array.flags.writeable for name, array in arrays.items())
    of_ase = md.System(np.eye(3), masses=40.0, units=md.units.ASE)
    assert WAYS[way](md.units.ASE) is WAYS[way](of_ase).units is md.units.ASE
    assert WAYS[way](MINE) == MINE


@pytest.mark.parametrize("way", ["pickle", pytest.param("copy", marks=pytest.mark.slow), "deepcopy", "file"])
@pytest.mark.parametrize("scene", RUNS)
def test_a_copy_of_a_simulation_and_one_from_its_file_make_the_steps_of_the_run_in_one(scene, way, tmp_path):
    (whole, one), file = (RUNS[scene]() for _ in range(2)), tmp_path / "a.h5md"
    whole.run(87, every=29)
    one.run(37, every=10, trajectory=file)
    assert one.potential_energy < 1e6  # a look
    other = WAYS[way](one) if way in WAYS else md.Simulation.resume(file, one.potentials)
    assert (type(other.method), other.barostat) == (type(one.method), one.barostat)
    assert (other.n_dof, other.engine.interactions.grid) == (one.n_dof, one.engine.interactions.grid)
    start = one.positions.copy()
    other.run(50, every=10)
    assert np.array_equal(one.positions, start)  # nothing is shared
    checkpoint = one.engine.checkpoint()
    one.run(50, every=10)
    for simulation in (one, other):
        assert all(map(np.array_equal, state_of(simulation), state_of(whole)))
    assert (one.work != 0.0, one.reservoir_energy != 0.0) == ("pulled" in scene, scene not in [*RUNS][:5])
    assert np.array_equal(one.record.total_energy, other.record.total_energy)
    if way in WAYS:
        assert str(WAYS[way](one).report()).split("speed")[0] == str(one.report()).split("speed")[0]
    one.engine.go_on_from(checkpoint)  # which stayed as it was
    one.run(50)
    assert np.array_equal(one.positions, other.positions)


def test_a_copy_knows_that_its_state_was_changed():
    one = RUNS["slab"]()
    one.run(20)
    one.velocities[:] *= 1.1
    other = copy.copy(one)
    one.run(20)
    other.run(20)
    assert np.array_equal(one.positions, other.positions)
