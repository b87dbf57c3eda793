"""The past of a run in fixed-point arithmetic: every step, forwards and backwards, has the bits of the run."""

import pickle

import numpy as np
import pytest
from fixed_point_scenes import LAW, bits, plain
from wrong_calls import assert_answered

import minimd as md
from minimd.view.check import check_file

BATHS = [of(0.004, 0.9, 1.0, seed=3) for of in (md.LangevinBAOAB, md.StochasticVelocityRescaling)]

# no molecules and no charges, a bath of each atom, a cell that is tilted, and another package
NOT_HERE = "bond-order", "chain-shape", "conductivity", "dielectric-constant", "thermal-conductivity", "surface-tension"


def whole(simulation):
    return simulation.step, simulation.time, simulation.reservoir_energy, *bits(simulation)


def turned_at(step):
    return lambda now: np.negative(now.velocities, out=now.velocities) if now.step == step else None


@pytest.mark.parametrize("method", [None, *BATHS], ids=lambda one: one and one.name)
def test_any_step_is_made_again_from_a_file_and_from_its_archive(method, tmp_path):
    """Positions, velocities, time and heat, from frames on both sides or, with a bath, before it; observers, too."""
    file, small, states, run, other = tmp_path / "run.h5md", tmp_path / "small.h5md", {}, plain(method), plain(method)
    run.make_steps(3)
    run.run(until_step=70, every=1, trajectory=file, observers=[lambda now: states.update({now.step: whole(now)})])
    archive, past = md.archive(file, small, 20, LAW), md.Past(small, LAW)
    assert (archive.n_frames, archive.n_bytes[1] < archive.n_bytes[0]) == ((68, 4), True)  # of steps 3, 20, 40 and 60
    assert method or "momentum       exactly constant" in str(check_file(file))
    assert (past.worst, past.cost(37)) == ((19, 17) if method else (10, -3))
    assert f"at most {past.worst} steps" in str(past)
    for step in [*range(3, 70, 3), 70]:
        assert whole(past.at(step)) == states[step], step
    kinds = [of for kind, of in md.observers.KINDS.items() if kind not in NOT_HERE]
    then, now = ([one(every=2) for one in kinds] for _ in range(2))
    other.make_steps(36)
    record, seen = other.run(until_step=64, every=4, observers=then), []
    found = past.observe([*now, lambda sim: seen.append(whole(sim))], 36, 64, every=4)
    assert seen == [states[step] for step in range(36, 65, 4)]
    np.testing.assert_equal(found.columns(), record.columns())
    np.testing.assert_equal([one.state() for one in now], [one.state() for one in then])


def test_a_branch_is_the_run_until_it_is_changed_and_has_a_file_of_its_own(tmp_path):
    file, own, run = tmp_path / "run.h5md", tmp_path / "own.h5md", plain()
    run.run(60, every=20, trajectory=file)
    before, (branch, other) = file.read_bytes(), (md.Past(file, LAW).branch(33) for _ in range(2))
    other.velocities[7] *= -1.0
    for one in (branch, other):
        one.run(until_step=60, every=10, trajectory=own, overwrite=True)
    assert bits(branch) == bits(run) != bits(other)
    past = md.Past(own, LAW)
    assert (past.steps[0], past.contents.title) == (33, "108 atoms of A, B, branched from step 33 of run.h5md")
    assert bits(past.at(60)) == bits(other)
    assert file.read_bytes() == before


def test_atoms_that_have_spread_beyond_the_first_grid_are_resumed_and_copied_in_the_same_cell(tmp_path):
    run, file = plain(grid=None), tmp_path / "run.h5md"
    run.make_steps(0)
    run.positions[:] += np.array([9, -8, 5]) @ run.system.cell.vectors
    run.run(10, every=10, trajectory=file)
    for other in (pickle.loads(pickle.dumps(run)), md.Simulation.resume(file, LAW), md.Past(file, LAW).at(10)):
        assert np.array_equal(other.system.cell.vectors, run.system.cell.vectors)


CALLS = [
    (lambda past: past("run").at(41), ValueError, "step", "41"),
    (lambda past: past("run").observe([], 10, 41), ValueError, "step", "41"),
    (lambda past: past("run").observe([], 30, 10), ValueError, "stop", "10"),
    (lambda past: past("annealed").at(19), ValueError, "'annealed.h5md'", "from 20 to 40", "step = 19"),
    (lambda past: past("kicked").at(39), ValueError, "'kicked.h5md'", "from 40 to 40", "step = 39"),
    (lambda past: md.Past(None), ValueError, "file", "None"),
    (lambda past: past("run", md.LennardJones(1.0, 0.9, 1.8)).at(20), ValueError, "potentials", "step 20"),
    (lambda past: past("run").observe([turned_at(15)], 0, 40, every=5), ValueError, "observers", "step 20"),
    (lambda past: past("double"), ValueError, "precision", "'double'"),
    (lambda past: past("slower"), ValueError, "time steps", "0.004", "0.002"),
    (lambda past: past("damaged"), OSError, "damaged", "frames"),
]


@pytest.mark.filterwarnings("ignore:the potentials are not", "ignore:the run in")
def test_what_is_not_the_past_is_refused(here):
    (run := plain()).run(40, every=20, trajectory="run.h5md")
    plain(precision="double", grid=None).run(2, every=1, trajectory="double.h5md")
    (slower := plain()).run(2, every=1, trajectory="slower.h5md")
    slower.method = md.VelocityVerlet(0.002)
    slower.run(2, every=1, trajectory="slower.h5md", append=True)
    for name, bath in (("annealed", BATHS[0]), ("kicked", None)):
        (changed := plain(bath)).run(20, every=20, trajectory=f"{name}.h5md")
        changed.velocities[0] *= 1.0 if bath else 2.0
        changed.method = md.LangevinBAOAB(0.004, 0.5, 1.0, seed=3) if bath else changed.method
        changed.run(20, every=20, trajectory=f"{name}.h5md", append=True)
        assert bits(md.Past(f"{name}.h5md", LAW).at(40)) == bits(changed)
    sound = (here / "run.h5md").read_bytes()
    place = sound.index(run.velocities.tobytes())  # of the last frame
    (here / "damaged.h5md").write_bytes(sound[:place] + b"\1" + sound[place + 1 :])
    for call, *answer in CALLS:
        assert_answered(lambda call=call: call(lambda name, law=LAW: md.Past(f"{name}.h5md", law)), *answer)
