"""What users hand over, and do to a simulation while it runs: taken, or refused; files of runs that go wrong."""

from functools import partial

import numpy as np
import pytest
from h5md_runs import frames_in
from stress_scenes import LAST_GOOD, SMOOTH, SPRING, assert_stops, is_finite, made, oscillation, pair_at, ran, solid

import minimd as md
from minimd.core.files.h5md_reader import read_file
from minimd.mdanalysis import universe

TWO_KINDS = {"species": ["A", "B"] * 128}
CHANGES = {
    "NaN": (lambda sim: sim.positions.__setitem__(3, np.nan), md.NonFiniteError, "positions of 1 atoms"),
    "a small cell": (lambda sim: setattr(sim.system, "cell", md.Cell.of(2.0)), md.NonFiniteError, "atoms .* apart"),
    "one spot": (lambda sim: sim.positions.__setitem__(0, sim.positions[1]), md.NonFiniteError, "atoms 0 and 1, 0 σ"),
    "a long step": (lambda sim: setattr(sim, "method", md.VelocityVerlet(0.5)), md.NonFiniteError, "timestep 0.5 τ"),
    "fewer atoms": (lambda sim: setattr(sim.system, "positions", np.zeros((10, 3))), ValueError, "108 atoms"),
    "other masses": (lambda sim: setattr(sim.system, "masses", np.zeros(108)), AttributeError, "masses"),
    "a number for a cell": (lambda sim: setattr(sim.system, "cell", 9.0), TypeError, "Cell"),
    "a run in a run": (lambda sim: sim.run(10), RuntimeError, "running"),
}
HOLED = md.PairPotential(lambda r2, a: (0.0 * r2, 0.0 * r2 / (abs(r2 - a) > 0.01)), (1.21,), 2.5, "truncated")
FLYING = pair_at(2.0, velocities=[[1.0, 0, 0], [0, 0, 0]])
FURTHER = [pytest.param(one, marks=pytest.mark.slow) for one in (".xtc", ".trr", ".extxyz", ".traj")]


@pytest.mark.parametrize("name", CHANGES)
def test_what_an_observer_breaks_is_named(name):
    change, error, words = CHANGES[name]
    simulation = made(solid(3), SMOOTH, 0.004, temperature=1.0)
    with pytest.raises(error, match=words):
        simulation.run(100, every=10, observers=[lambda sim: change(sim) if sim.step == 20 else None], progress=False)
    assert (simulation.step, len(simulation.record)) == (20, 3)


def test_subnormal_and_negative_zero_numbers_are_numbers_but_masses_may_be_too_small_for_their_forces():
    places, velocities = [[5e-324, -0.0, 0.0], [1.1, 5e-324, -5e-324]], [[5e-324, 0, 0], [0, -0.0, 0]]
    assert is_finite(ran(md.System(places, velocities=velocities), SMOOTH, 0.004, 100))
    system = md.System(places, masses=[1.0, 1e-70])
    assert_stops(lambda: ran(system, SMOOTH, 0.004, 100), md.NonFiniteError, "force on atom 1 would move it")


@pytest.mark.parametrize("system", [FLYING, pytest.param(solid(3), marks=pytest.mark.slow)])
def test_a_law_with_a_hole_stops_where_an_atom_falls_into_it(system):
    where = r"At step \d+: .*not finite.*\n?.*atoms"
    assert_stops(partial(ran, system, HOLED, 0.004, 400, temperature=1.0), md.NonFiniteError, where)


def test_positions_set_as_a_whole_are_those_that_move():
    """The arrays of a system are those of its simulation, whoever assigns to them."""
    set_once, in_place = (made(solid(3), SMOOTH, 0.004, temperature=1.0) for _ in range(2))
    set_once.system.positions = set_once.system.positions + 0.01
    set_once.system.velocities = 2.0 * set_once.system.velocities
    in_place.positions[:] += 0.01
    in_place.velocities[:] *= 2.0
    for simulation in (set_once, in_place):
        simulation.run(50, observers=[lambda sim: setattr(sim.system, "positions", sim.positions[::1] * 1.0)])
    assert np.array_equal(set_once.positions, in_place.positions)
    assert np.abs(set_once.positions - solid(3).positions).max() > 0.1


@pytest.mark.slow  # compiles two laws
def test_cutoffs_may_be_ten_times_apart_and_species_without_interaction_fly_through():
    kinds = {("A", "A"): 2.5, ("A", "B"): 1.2, ("B", "B"): 0.25}
    law = md.LennardJones({"A": (1.0, 1.0), "B": (1.0, 0.1)}, cutoff=kinds, truncation="force-shifted")
    assert oscillation(ran(solid(4, **TWO_KINDS), law, 0.002, 1000, temperature=1.0)) < 1e-2
    ghosts = md.LennardJones({"A": (1.0, 1.0), "B": (0.0, 1.0)}, cutoff=2.5, truncation="force-shifted")
    start = solid(4, **TWO_KINDS)
    simulation = ran(start, ghosts, 0.004, 1000, temperature=1.0)
    straight = start.positions[1] + simulation.time * simulation.velocities[1]
    assert np.abs(simulation.positions[1] - straight).max() < 1e-10
    assert oscillation(simulation) < 1e-2
    twice = np.vstack([start.positions, start.positions[1:2] + 1e-3])
    assert is_finite(ran(md.System(twice, species=[*start.species, "B"], cell=start.cell), ghosts, 0.004, 10))


def test_an_observer_that_heats_is_no_runaway():
    def heat(sim):
        if sim.step in (10, 20, 30):
            sim.velocities[:] = np.random.default_rng(sim.step).standard_normal(sim.velocities.shape) * 10.0 * sim.step

    record = made(solid(3), SMOOTH, 1e-6).run(40, every=1, observers=[heat], progress=False)
    assert record.kinetic_energy.max() > 1e4 * abs(record.total_energy[0])


@pytest.mark.parametrize("suffix", [".h5md", ".dcd", *FURTHER])
def test_files_of_a_run_that_blows_up_hold_the_last_good_frame(suffix, tmp_path):
    """Of a dumbbell whose step is past its limit, in a cell: good for some frames."""
    system = md.System([[4, 4, 4], [5.1, 4, 4], [1, 1, 1]], bonds=[[0, 1]], cell=9.0)
    simulation, every, file = made(system, SPRING, 2.0005 / 2**0.5), 10, tmp_path / f"a{suffix}"
    assert_stops(lambda: simulation.run(2000, every=every, trajectory=file), md.NonFiniteError, LAST_GOOD)
    frames = frames_in(file, 3)
    assert len(frames) == len(simulation.record) == simulation.step // every + 1 > 2
    assert all(np.isfinite(frame).all() for frame in frames)
    steps, edge = simulation.step - simulation.record.step[-1], simulation.system.cell.vectors[0, 0]
    assert steps < every
    moved = (np.asarray(frames[-1]) - simulation.positions) / edge
    farthest = np.abs(simulation.velocities).max() * simulation.method.timestep * steps / edge
    assert np.abs(moved - np.rint(moved)).max() < 1e-2 + farthest  # float32 of what stands some cells away
    if suffix == ".h5md":
        contents = read_file(file)
        assert (len(universe(file).trajectory), contents.step) == (len(frames), simulation.step)
        assert np.array_equal(contents.system.positions, simulation.positions)
