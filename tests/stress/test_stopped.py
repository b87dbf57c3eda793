"""Scenes that cannot be, or cannot go on: each is stopped with a sentence that names the cause."""

import itertools
from functools import partial

import numpy as np
import pytest
import stress_scenes as stress
from stress_scenes import FREQUENCY, LAST_GOOD, OPEN, SMOOTH, SPRING, STIFF, assert_stops, made, pair_at, ran, solid

import minimd as md

pytestmark = pytest.mark.slow  # pytest tests/stress -m "slow or not slow" runs them
DUMBBELL = pair_at(1.1, bonded=True)
GONE = "energy has gone|not finite"
PAST = "moves .* in one step, past every neighbor"
BATHS = [md.LangevinBAOAB, md.StochasticVelocityRescaling]


def overlap(distance, scene):
    """Two atoms at a distance, in a liquid or with a third one."""
    if scene != "liquid":
        return md.System([[0, 0, 0], [distance, 0, 0], [3.0, 0, 0]])
    system = solid(3)
    system.positions[1] = system.positions[0] + [distance, 0, 0]
    return system


def with_one_more(place, cell=True):
    """A crystal and another atom, by default of its first atom's place."""
    start = solid(3, jitter=0.0, cell=cell)
    return md.System(np.vstack([start.positions, start.positions[:1] + place]), cell=start.cell)


def refused_scenes():
    """Name, call, what the sentence must show."""
    for size in (1e-160, 1e160, 1e300):
        yield f"units {size}", partial(stress.scaled, size, 1.0, 1.0, 2), "take other units"
    yield "an atom beyond float64", partial(md.System, [[0, 0, 0], [1e160, 0, 0]]), "take other units"
    for skin in (1e4, 1e300):
        yield f"skin {skin}", partial(ran, solid(), SMOOTH, 0.004, 10, skin=skin), "skin"
    for cutoff, system in itertools.product((300.0, 1e3, 1e6), (solid(), md.System([[0, 0, 0]], cell=0.5))):
        law = md.LennardJones(1.0, 1.0, cutoff)
        yield f"cutoff {cutoff}, {len(system)} atoms", partial(ran, system, law, 0.004, 10), "reduce the cutoff"
    many = md.System(np.random.default_rng(1).uniform(0, 1e3, (60_000, 3)))
    yield "many atoms without a cutoff", partial(ran, many, OPEN, 0.004, 10), "pair lists hold up to"
    fixed = md.FixedAtoms(np.ones(32, dtype=bool))
    yield "all fixed", partial(ran, solid(2), SMOOTH, 0.004, 10, constraints=fixed), "no degree of freedom"
    fixed, one_spot = md.DistanceConstraints([[1, 2]]), md.System([[0, 0, 0], [1, 0, 0], [1, 0, 0]])
    run = partial(ran, one_spot, stress.WEAK, 0.01, 10, constraints=fixed)
    yield "rigid on one spot", run, "1 and 2 are at the same"


def scenes_that_meet():
    """Atoms on one spot or nearly: name, system, potential, what the sentence must show."""
    for distance, scene in itertools.product((0.3, 0.1, 1e-3, 1e-30, 0.0), ("liquid", "three atoms", "no cutoff")):
        apart = f"{distance:.3g}" if distance != 1e-30 else "(0|1e-30)"
        words = LAST_GOOD, "atoms 0 and 1 overlap", f"atoms 0 and 1, {apart} σ apart"
        yield f"{distance} {scene}", overlap(distance, scene), OPEN if scene == "no cutoff" else SMOOTH, *words
    edge, alike = 3 * 1.68, (LAST_GOOD, "0 σ apart")
    yield "one spot of all", md.System(np.ones((100, 3)), cell=9.0), SMOOTH, *alike
    yield "one spot modulo the cell", with_one_more([edge, 0, 0]), SMOOTH, *alike
    yield "one spot thousands of cells away", with_one_more([4096 * edge, 0, 0]), SMOOTH, *alike
    bonded = md.System([[0, 0, 0], [1, 0, 0], [1, 0, 0]], bonds=[[1, 2]])
    yield "bond on one spot", bonded, md.HarmonicBond(50.0, 1.0), "atoms 1 and 2, 0 σ apart"
    yield "angle on one spot", bonded, md.HarmonicAngle(5.0, 2.0, [[0, 1, 2]]), "atoms 1 and 2, 0 σ apart"
    yield "bond of two cells", md.System([[0, 0, 0], [8, 0, 0]], cell=4.0, bonds=[[0, 1]]), SPRING, "0 σ apart"


def scenes_that_break():
    """Name, system, potential, time step, what the sentence must show, options."""
    drifting = solid(3)
    drifting.velocities[:] += 1e4
    yield "drift", drifting, SMOOTH, 0.004, [PAST], {}
    collapse = md.PairPotential(lambda r2: (-1.0 / (r2 * r2), -4.0 / (r2 * r2 * r2)), (), 2.5, "force-shifted")
    yield "collapse", solid(3), collapse, 0.004, ["atoms .* apart"], {}
    hot = [f"timestep 0.01 τ.*\n.*moves .* in one step.*atoms .* σ apart.* {LAST_GOOD}"]
    yield "hot and dense", solid(3), SMOOTH, 0.01, hot, {"temperature": 50.0}
    fixed = md.System([[0, 0, 0], [0, 0, 0], [stress.BOTTOM, 0, 0]])
    yield "fixed overlap", fixed, OPEN, 0.004, ["atoms 0 and 1, 0 σ apart"], {"constraints": md.FixedAtoms([0, 1])}
    others = md.integrators
    for method in (md.PositionVerlet, md.Leapfrog, others.BlanesMoan4, others.PEFRL, others.Ruth3):
        yield method.__name__, DUMBBELL.copy(), SPRING, 4.0, [GONE], {"method": method(12.0 / FREQUENCY)}
    for x in (2.05, 2.5, 4.0):
        beads = stress.in_a_row(20, 0.1 * np.sin(np.arange(20)))
        yield f"beads {x}", beads, STIFF, x / 40.0, ["total energy has gone from", "too large"], {}
    for potential, speed in ((OPEN, 100.0), (SMOOTH, 100.0), (SMOOTH, 1000.0)):
        two = md.System([[0, 0, 0], [4.0, 0.1, 0]], velocities=[[speed, 0, 0], [-speed, 0, 0]])
        yield f"collision {potential.cutoff} {speed}", two, potential, 0.004, [f"moves .* in one step|{GONE}"], {}
    for bath, coupling in zip(BATHS, (1e3, 1e-3), strict=True):
        more = {"temperature": 1.0, "method": bath(0.002, 1e10, coupling, 1)}
        yield f"{bath.__name__} too hot", solid(3), SMOOTH, 0.002, [PAST], more
    for x, (bath, weak) in itertools.product((2.1, 3.0), zip(BATHS, (0.01, 1e4), strict=True)):
        more = {"temperature": 1.0, "method": bath(x / FREQUENCY, 1.0, weak, 1)}
        yield f"weak {bath.__name__} {x}", DUMBBELL.copy(), SPRING, 1.0, ["conserved energy has gone|not finite"], more


@pytest.mark.parametrize("row", [*refused_scenes()], ids=lambda row: row[0])
def test_what_cannot_be_is_refused(row):
    assert_stops(row[1], ValueError, row[2])


@pytest.mark.parametrize("row", [*scenes_that_meet()], ids=lambda row: row[0])
def test_atoms_that_meet_are_named(row):
    _, system, potential, *words = row
    assert_stops(lambda: ran(system.copy(), potential, 0.004, 1000), md.NonFiniteError, *words)


@pytest.mark.parametrize("row", [*scenes_that_break()], ids=lambda row: row[0])
def test_what_breaks_is_stopped_with_its_cause(row):
    _, system, potential, timestep, words, more = row
    assert_stops(lambda: ran(system, potential, timestep, 5000, **more), md.NonFiniteError, *words)


@pytest.mark.parametrize("timestep", [0.1, 0.3, 1.0, 10.0, 1e6])
def test_rigid_bonds_with_a_long_time_step_are_named(timestep):
    for system, bonds in (stress.rigid_ring(), stress.rigid_chain(1e-3)):
        words = r"constraint \d+ \(atoms \d+-\d+\) cannot be kept", "reduce the timestep"
        run = partial(ran, system, stress.WEAK, timestep, 2000, temperature=1.0, constraints=bonds)
        assert_stops(run, md.ConstraintError, *words)


def test_atoms_on_one_spot_are_named_without_a_step_and_too_hot_an_equilibration():
    assert_stops(lambda: md.evaluate(with_one_more([0, 0, 0]), SMOOTH), md.NonFiniteError, "atoms 0 and")
    simulation = made(solid(3), SMOOTH, 0.002, temperature=1.0)
    assert_stops(lambda: simulation.equilibrate(100, 1e9), md.NonFiniteError, "moves .* in one step")


@pytest.mark.parametrize("n_steps", [150, 1000, 5000])
@pytest.mark.parametrize("x", [2.001, 2.01, 2.1, 2.5, 4.0])
def test_an_oscillator_above_its_limit_is_stopped_in_a_state_from_before(x, n_steps):
    if x == 2.001 and n_steps == 150:
        pytest.skip("the energy has only doubled ten times")
    for every in (100, 10**6):
        simulation = made(DUMBBELL.copy(), SPRING, x / FREQUENCY)
        run = partial(simulation.run, n_steps, every=every)
        assert_stops(run, md.NonFiniteError, "total energy has gone from 0.005 to|not finite", "too large")
        assert np.abs(simulation.positions).max() < 1e4


@pytest.mark.parametrize(("law", "start"), [(STIFF, 1.1), (OPEN, 0.1)])
def test_equilibration_does_not_hide_a_blow_up(law, start):
    """Velocities are rescaled every few steps: what flies apart would look like a scene at that temperature."""
    system = md.System([[0, 0, 0], [start, 0, 0], [2, 2, 2]], bonds=[[0, 1]])
    simulation = made(system, law, 3.0 / 800**0.5, temperature=1.0)
    assert_stops(partial(simulation.equilibrate, 2000, 1.0), md.NonFiniteError, "(kinetic|total) energy has gone")
    assert np.abs(simulation.positions).max() < 100.0
