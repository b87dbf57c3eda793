"""The past of a run in fixed-point arithmetic: every step, forwards and backwards, has the bits of the run."""

import pickle

import numpy as np
import pytest
from fixed_point_scenes import KINDS, LAW, bits, mixture, simulated
from wrong_calls import assert_answered

import minimd as md
from minimd.analysis.check import check_file

FIRST, LAST, EVERY = 3, 70, 20
BATHS = [md.LangevinBAOAB(0.004, 0.9, 1.0, seed=3), md.StochasticVelocityRescaling(0.004, 0.9, 1.0, seed=3)]
OTHER = md.LennardJones(KINDS | {"B": (0.6, 0.9)}, cutoff=1.8, truncation="switched", bonded_scale=(0.0, 0.5, 1.0))


def plain(method=None, **options):
    return simulated(mixture(with_bonds=False), method, **options)


def looking():
    return [one(every=2) for one in md.observers.KINDS.values()]


def whole(simulation):
    return simulation.step, simulation.time, simulation.reservoir_energy, *bits(simulation)


def ran(file, method=None, every=EVERY, **options):
    """A run that has written a file, and the state of each of its steps by its number, from another run."""
    states, one, other = {}, plain(method, **options), plain(method, **options)
    one.make_steps(FIRST)
    one.run(until_step=LAST, every=every, trajectory=file)
    other.run(LAST, every=1, observers=[lambda now: states.update({now.step: whole(now)})])
    return one, states


@pytest.mark.parametrize("method", [None, *BATHS], ids=lambda one: one and one.name)
def test_any_step_is_made_again_from_a_file_and_from_its_archive(method, tmp_path):
    """Positions, velocities, time and heat, from frames on both sides or, with a bath, before it; observers, too."""
    file, small = tmp_path / "run.h5md", tmp_path / "small.h5md"
    run, states = ran(file, method, every=1)
    assert (archive := md.archive(file, small, EVERY, LAW)).n_frames == (LAST - FIRST + 1, 4)  # 3, 20, 40, 60
    assert archive.n_bytes[1] < archive.n_bytes[0]
    assert method or "momentum       exactly constant" in str(check_file(file))
    past = md.Past(small, LAW)
    assert (past.worst, past.cost(37)) == ((19, 17) if method else (10, -3))
    assert f"at most {past.worst} steps" in str(past)
    for step in [*range(FIRST, LAST, 3), LAST]:
        assert whole(past.at(step)) == states[step], step
    assert bits(md.Simulation.resume(small, LAW)) == bits(run)
    then, now, seen, other = looking(), looking(), [], plain(method)
    other.make_steps(36)
    record = other.run(until_step=64, every=4, observers=then)
    found = past.observe([*now, lambda sim: seen.append(whole(sim))], 36, 64, every=4)
    assert seen == [states[step] for step in range(36, 65, 4)]
    np.testing.assert_equal(found.columns(), record.columns())
    for one, same in zip(now, then, strict=True):
        np.testing.assert_equal(one.state(), same.state())


def test_a_branch_is_the_run_until_it_is_changed_and_has_a_file_of_its_own(tmp_path):
    _, states = ran(file := tmp_path / "run.h5md")
    before, past = file.read_bytes(), md.Past(file, LAW)
    branch, changed = past.branch(33), past.branch(33)
    changed.velocities[7] *= -1.0
    for one, name in ((branch, "one"), (changed, "other")):
        one.run(until_step=LAST, every=10, trajectory=tmp_path / f"{name}.h5md")
    assert whole(branch) == states[LAST]
    assert bits(changed) != bits(branch)
    own = md.Past(tmp_path / "other.h5md", LAW)
    assert (own.steps[0], own.contents.title) == (33, "108 atoms of A, B, branched from step 33 of run.h5md")
    assert file.read_bytes() == before


def test_atoms_that_have_spread_are_resumed_and_copied_in_the_same_cell(tmp_path):
    """Although a scene of their size would begin with a coarser grid."""
    run, file = plain(grid=None), tmp_path / "run.h5md"
    run.make_steps(0)
    run.positions[:] += np.array([9, -8, 5]) @ run.system.cell.vectors
    run.run(10, every=10, trajectory=file)
    for other in (pickle.loads(pickle.dumps(run)), md.Simulation.resume(file, LAW), md.Past(file, LAW).at(10)):
        assert np.array_equal(other.system.cell.vectors, run.system.cell.vectors)


@pytest.fixture(scope="module")
def files(tmp_path_factory):
    """A run; the same in float64; with two time steps; acted on at step 30; and damaged."""
    folder = tmp_path_factory.mktemp("files")
    ran(folder / "run.h5md")
    plain(precision="double", grid=None).run(2, every=1, trajectory=folder / "double.h5md")
    (slower := plain()).run(4, every=2, trajectory=folder / "slower.h5md")
    slower.method = md.VelocityVerlet(0.002)
    slower.run(4, every=2, trajectory=folder / "slower.h5md", append=True)
    plain().run(40, every=10, trajectory=folder / "acted.h5md", observers=[turn_at(30)])
    sound = (folder / "run.h5md").read_bytes()
    place = sound.index(md.Past(folder / "run.h5md", LAW).at(20).velocities.tobytes())
    (folder / "damaged.h5md").write_bytes(sound[:place] + b"\1" + sound[place + 1 :])
    return folder


def turn_at(step):
    return lambda now: np.negative(now.velocities, out=now.velocities) if now.step == step else None


CALLS = [
    (lambda past: past("run").at(LAST + 1), ValueError, "step", "71"),
    (lambda past: past("run").branch(FIRST - 1), ValueError, "step", "2"),
    (lambda past: past("run").observe([], 10, 71), ValueError, "step", "71"),
    (lambda past: past("run").observe([], 10, 9), ValueError, "until_step", "9"),
    (lambda past: past("run", OTHER).at(20), ValueError, "potentials", "step 20"),
    (lambda past: past("run").observe([turn_at(30)], 10, 60), ValueError, "observers", "step 40"),
    (lambda past: past("acted").observe([], 20, 40, every=10), ValueError, "step 40"),
    (lambda past: past("double"), ValueError, "precision", "'double'"),
    (lambda past: past("slower"), ValueError, "time steps", "0.004", "0.002"),
    (lambda past: past("damaged"), OSError, "damaged", "frames"),
    (lambda past: past("none"), FileNotFoundError, "none.h5md"),
]


@pytest.mark.parametrize("row", CALLS, ids=lambda row: row[-1])
@pytest.mark.filterwarnings("ignore:the potentials are not", "ignore:the run in")
def test_what_is_not_the_past_is_refused(row, files):
    call, *answer = row
    assert_answered(lambda: call(lambda name, law=LAW: md.Past(files / f"{name}.h5md", law)), *answer)
