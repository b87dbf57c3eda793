"""One door to the state: whoever looks enters, whoever makes steps begins; both see what was changed since leave."""

import re
import sys
from pathlib import Path

import numpy as np
import pytest
from references import liquid
from scenes import LJ, SCENES, Scene

import minimd as md
from minimd.core.engine.observation import observe
from minimd.core.potentials.term import FORCES, PER_ATOM, TOTALS


def moved(engine):
    engine.positions[3, 0] += 1e-9


def turned(engine):
    engine.velocities[5] *= -1.0


def strained(engine):
    engine.system.cell = md.Cell.of(engine.system.cell.vectors * 1.001)


def opened(engine):
    engine.system.cell = md.Cell.of(engine.system.cell.vectors, pbc=[True, True, False])


@pytest.fixture
def left():
    """An engine that has made steps and was left."""
    simulation = SCENES["argon"]().simulation()
    simulation.set_temperature(0.7, seed=1)
    simulation.run(4, every=4, progress=False)
    return simulation.engine


@pytest.mark.parametrize("change", [moved, turned, strained, opened], ids=lambda change: change.__name__)
def test_what_was_changed_is_seen_once_and_the_energy_is_that_of_the_state(change, left):
    assert (left.enter(), left.begin()) == (True, True)
    change(left)
    assert (left.enter(), left.enter()) == (False, False)  # until steps begin anew
    expected = md.evaluate(left.system, LJ)
    assert observe(left).observables["potential_energy"] == pytest.approx(expected.potential_energy, rel=1e-12)
    assert left.forces == pytest.approx(expected.forces, rel=1e-9, abs=1e-9)
    assert (left.begin(), left.begin()) == (False, True)


def test_what_cannot_be_seen_begins_anew_where_it_is_said(left):
    left.changed()
    assert (left.enter(), left.begin(), left.enter()) == (False, False, True)


def test_steps_that_nobody_has_left_are_a_change(left):
    left.advance(1)
    assert not left.enter()


def test_a_look_computes_forces_once_and_leaves_the_state(left):
    moved(left)
    before = left.positions.copy()
    left.enter()
    sums = left.evaluate()
    n_evaluations = left.interactions.n_evaluations
    assert left.enter() is False
    assert left.evaluate() is sums
    assert left.interactions.n_evaluations == n_evaluations
    assert np.array_equal(left.positions, before)


def test_only_steps_project_onto_constraints():
    """A look at rigid molecules whose atoms somebody is moving, one after the other, must not move them back."""
    engine = SCENES["dumbbells"]().simulation().engine
    engine.begin()
    engine.positions[0] += 1e-3
    stretched = engine.positions.copy()
    engine.enter()
    observe(engine)
    assert np.array_equal(engine.positions, stretched)
    engine.begin()
    assert not np.array_equal(engine.positions, stretched)
    assert engine.constraint_set.bonds.violation(engine.positions).max() < 1e-7


def test_an_evaluation_keeps_what_it_found():
    """Energies of one are not those of the next, wherever the atoms have gone since."""
    system = SCENES["mixture"]().system
    forces = md.Forces(system, SCENES["mixture"]().laws)
    here = forces.compute(PER_ATOM)
    kept = here.potential_energy, here.virial.copy(), here.energies.copy(), here.virials.copy()
    system.positions[:] *= 1.01
    elsewhere = forces.compute(TOTALS)
    forces.compute(FORCES)
    assert elsewhere.potential_energy != here.potential_energy
    found = here.potential_energy, here.virial, here.energies, here.virials
    assert all(np.array_equal(now, before) for now, before in zip(found, kept, strict=True))
    assert np.isnan(forces.compute(FORCES).potential_energy)  # not asked for


@pytest.mark.parametrize("precision", ["double", "fixed-point"])
def test_the_shadow_energy_changes_no_bit_of_the_run(precision):
    """In fixed-point arithmetic the impulses of a look ahead were those of the next kick."""
    runs = []
    for extra in ((), ("shadow_energy",)):
        simulation = SCENES["argon"]().simulation(precision=precision)
        simulation.set_temperature(0.7, seed=1)
        simulation.extra_observables = extra
        simulation.run(12, every=3, progress=False)
        runs.append(simulation)
    assert np.array_equal(runs[0].positions, runs[1].positions)
    assert np.array_equal(runs[0].velocities, runs[1].velocities)


def test_a_state_is_whole_only_while_its_lists_and_counts_are_those_of_the_run(left):
    assert left.is_whole
    left.advance(1)
    assert not left.is_whole  # not counted yet
    left.count(1)
    assert left.is_whole
    snapshot = left.snapshot()
    left.restore(snapshot)
    left.advance(1)
    left.count(1)
    assert not left.is_whole  # its lists were lost
    left.restore(snapshot, is_whole=True)
    assert left.is_whole


def test_setting_the_step_leaves_the_time_as_it_is():
    simulation = SCENES["argon"]().simulation()
    simulation.run(10, every=5, progress=False)
    time = simulation.time
    simulation.step = 0
    assert simulation.time == time > 0.0
    simulation.time = 1.0
    simulation.step = 100
    assert simulation.time == 1.0


def overlapping(simulation):
    simulation.positions[1] = simulation.positions[0] + 1e-3


def beyond_resolution(simulation):
    simulation.positions[3] += 1e14


def by_make_steps(simulation, change):
    change(simulation)
    simulation.make_steps(0)


def by_an_observer(simulation, change):
    simulation.run(5, every=5, observers=[lambda sim: change(sim) if sim.step == 10 else None], progress=False)


@pytest.mark.parametrize("change", [overlapping, beyond_resolution], ids=lambda change: change.__name__)
@pytest.mark.parametrize("way", [by_make_steps, by_an_observer], ids=lambda way: way.__name__)
def test_a_state_that_nobody_has_checked_is_checked_by_the_next_run(way, change):
    simulation = SCENES["argon"]().simulation()
    simulation.run(5, every=5, progress=False)
    way(simulation, change)
    for _ in range(2):
        with pytest.raises((md.NonFiniteError, ValueError), match=r"would move it by|positions must be below"):
            simulation.run(1, every=5, progress=False, crash_report=False)


def test_the_shell_of_a_short_run_is_thin():
    """Calls of Python functions, of whoever wrote them: 1370 in November 2026."""
    simulation = Scene(liquid(6), [LJ], timestep=0.001).simulation(threads=1, skin=0.6)
    simulation.set_temperature(0.7, seed=1)
    for _ in range(3):
        simulation.run(100, every=100, progress=False)
    n_calls = 0

    def profile(_frame, event, _argument):
        nonlocal n_calls
        n_calls += event == "call"

    sys.setprofile(profile)
    try:
        simulation.run(100, every=100, progress=False)
    finally:
        sys.setprofile(None)
    assert n_calls <= 500


def test_nobody_else_touches_the_flags():
    package = Path(md.__file__).parent
    texts = {path.relative_to(package).as_posix(): path.read_text(encoding="utf-8") for path in package.rglob("*.py")}
    writers = {place for place, text in texts.items() if re.search(r"\.is_whole (\|?=|&=) ", text)}
    assert writers == {"core/engine/engine.py"}
    readers = {place for place, text in texts.items() if "forces_are_current" in text}
    assert readers == {f"core/{name}.py" for name in ("engine/engine", "integrators/state", "integrators/steps")}
