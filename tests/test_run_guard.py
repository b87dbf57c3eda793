"""What was wrong once with runs, their failures and their warnings."""

import warnings
import weakref

import numpy as np
import pytest
from references import liquid

import minimd as md
from minimd.diagnosis import run_guard
from minimd.engine.engine import Engine

LJ = md.LennardJones(1.0, 1.0, 1.85, "switched")


def liquid_run(method=None):
    return md.Simulation(liquid(3), LJ, method or md.VelocityVerlet(0.003))


def test_a_refused_output_leaves_the_last_record(tmp_path):
    sim = liquid_run()
    record = sim.run(10, every=5, trajectory=tmp_path / "a.h5md")
    with pytest.raises(FileExistsError):
        sim.run(10, every=5, trajectory=tmp_path / "a.h5md")
    assert sim.record is record
    assert len(record) == 3
    assert "total energy" in str(sim.report())


def test_a_failure_is_judged_by_the_energy_of_its_own_positions(monkeypatch):
    """A method that ends with a drift has not evaluated the forces of its last positions; the replay of a failure does."""
    judged, runaway = [], run_guard.runaway

    def judge(engine, *by):
        judged.append((engine.interactions.potential_energy, md.evaluate(engine.system, LJ).potential_energy))
        return runaway(engine, *by)

    monkeypatch.setattr(run_guard, "runaway", judge)
    sim = liquid_run(md.PositionVerlet(0.03))
    with pytest.raises(md.NonFiniteError):
        sim.run(4000)
    held, true = np.array(judged).T
    assert len(judged) > 1
    assert held == pytest.approx(true, rel=1e-9)  # rounding


@pytest.mark.parametrize(("room", "n_kept"), [(1, 1), (300, 2)])
def test_states_to_go_back_to_are_as_many_as_there_is_room_for(monkeypatch, room, n_kept):
    made, snapshot = [], Engine.closed_snapshot

    def noted(engine):
        one = snapshot(engine)
        made.append(weakref.ref(one.positions))
        return one

    monkeypatch.setattr(Engine, "closed_snapshot", noted)
    monkeypatch.setattr(run_guard, "ROOM", room)
    sim = liquid_run()
    sim.run(300, every=60)
    assert (len(made), sum(positions() is not None for positions in made)) == (5, n_kept)


@pytest.mark.parametrize("count", [True, 2.0, -1, "3", None])
def test_what_is_no_count_is_refused(count):
    sim = liquid_run()
    makers = (
        sim.run,
        lambda n: sim.run(until_step=n),
        sim.make_steps,
        lambda n: sim.equilibrate(n, 1.0),
        lambda n: sim.minimize(max_steps=n),
    )
    for make in makers[2:] if count is None else makers:
        with pytest.raises(ValueError, match=r"(n_steps|max_steps|until_step) must be a whole number, at least"):
            make(count)
    assert sim.step == 0


@pytest.mark.parametrize("ends", [{}, {"n_steps": 5, "until_step": 5}])
def test_a_run_has_one_end(ends):
    with pytest.raises(ValueError, match="needs either n_steps or until_step"):
        liquid_run().run(**ends)


def test_no_steps_are_none():
    sim = liquid_run()
    before = sim.positions.copy()
    sim.make_steps(0)
    assert sim.step == 0
    assert np.array_equal(sim.positions, before)
    assert len(sim.run(np.int64(0))) == 1


def test_warnings_point_to_the_line_of_the_user():
    system = md.System([[0.0, 0, 0], [1.1, 0, 0], [5, 0, 0]], velocities=[[0, 0, 0], [1, 0, 0], [-1, 0, 0]])
    rigid = md.DistanceConstraints([[0, 1]], lengths=1.0)
    sim = md.Simulation(system, LJ, md.VelocityVerlet(0.001), rigid)
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        sim.run(1)
    assert [str(one.message)[:31] for one in caught] == ["the initial state was projected"]
    assert caught[0].filename == __file__


def test_a_mistake_in_the_diagnosis_is_not_hidden(monkeypatch):
    def mistaken(*_):
        raise KeyError("of our own")

    monkeypatch.setattr(run_guard, "examine", mistaken)
    with pytest.raises(KeyError, match="of our own"):
        liquid_run(md.VelocityVerlet(0.04)).run(4000)


def test_an_overlap_made_during_a_run_is_told_as_one():
    def push_together(run):
        if run.step == 20:
            run.positions[1] = run.positions[0] + [0.3, 0.0, 0.0]

    sim = liquid_run()
    with pytest.raises(md.NonFiniteError) as caught:
        sim.run(100, every=10, observers=[push_together])
    found = caught.value.crash_report
    assert found.kind == "overlap"
    assert "overlap at step 20" in found.cause
    assert {found.pair.first, found.pair.second} == {0, 1}


def test_atoms_flung_beyond_all_numbers_in_use_are_told_of():
    """Their positions are still finite, but no System can hold them."""
    system = md.System([[0.0, 0, 0], [1.0, 0, 0]], velocities=np.full((2, 3), [9e74, 0, 0]), bonds=[[0, 1]])
    with pytest.raises(
        md.NonFiniteError, match=r"Likely cause: .*\nAt step 1: positions of 2 atoms are not finite, or beyond 1e\+75"
    ):
        md.Simulation(system, md.HarmonicBond(1e-3, 1.0), md.VelocityVerlet(10.0)).run(100)


def tetrahedron():
    return np.array([[1, 1, 1], [1, -1, -1], [-1, 1, -1], [-1, -1, 1]]) / np.sqrt(8.0)


def test_a_bond_that_constraints_keep_from_stretching_asks_for_no_short_step():
    """Atoms that are fixed, or joined through other constraints, hold a bond however stiff it is."""
    fixed = md.FixedAtoms([0, 1])
    system = md.System(np.array([[0.0, 0, 0], [1.0, 0, 0], [0.5, 1.0, 0]]))
    stiff = md.HarmonicBond(1e6, 1.0, pairs=[[0, 1]])
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        md.Simulation(system, stiff, md.VelocityVerlet(0.01), fixed).run(1)
    corners = tetrahedron()
    pairs = [[0, 1], [0, 2], [1, 2], [0, 3], [1, 3], [2, 3]]
    apex = np.vstack([corners, corners[1] + corners[2] + corners[3]])  # a fifth atom, held by three lengths
    lengths = md.DistanceConstraints([*pairs, [1, 4], [2, 4], [3, 4]])
    across = md.HarmonicBond(1e6, float(np.linalg.norm(apex[4] - apex[0])), pairs=[[0, 4]])  # implied by the others
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        md.Simulation(md.System(apex), across, md.VelocityVerlet(0.01), lengths).run(1)
    with pytest.warns(UserWarning, match="longer than the bond of atoms 0 and 4 allows"):
        md.Simulation(md.System(apex), across, md.VelocityVerlet(0.01)).run(1)


def test_rounding_is_not_taken_for_a_mode():
    """A rigid triangle by itself cannot oscillate, however hard its atoms push each other."""
    triangle = np.array([[0.0, 0, 0], [0.9, 0, 0], [0.45, 0.78, 0]])
    rigid = md.DistanceConstraints([[0, 1], [1, 2], [0, 2]])
    advice = md.advise_timestep(md.System(triangle), md.LennardJones(1.0, 1.0), rigid)
    assert advice.frequency == 0.0
    assert "nothing oscillates" in str(advice)
