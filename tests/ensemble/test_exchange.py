"""Replica exchange: each temperature keeps its canonical ensemble, and whatever stops a ladder, it goes on with the
same bits."""

import multiprocessing
import os
import signal
import subprocess
import sys
import time
from concurrent.futures import ProcessPoolExecutor
from functools import partial
from pathlib import Path

import ladders
import members
import numpy as np
import pytest
from damages import KILLED, killed_at
from h5md_runs import bring_to_disk_every
from ladders import BARRIER, STEPS, TEMPERATURES, TILT, assert_same, oscillators, run
from scipy.integrate import quad
from scipy.special import betainc
from wrong_calls import assert_answered

import minimd as md
from minimd.core.structure.errors import Interrupted
from minimd.ensemble.exchange import accepted_pairs
from minimd.ensemble.ladder import n_round_trips
from minimd.ensemble.workers import SpawnedProcesses, ThisProcess


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    """A ladder that nothing has disturbed."""
    return run(tmp_path_factory.mktemp("whole"))


def alone_in(folder):
    """For replicas with few atoms, which do not gain from threads."""
    return {"folder": folder, "executor": ThisProcess(), "progress": False}


def known_acceptance(n_dof, low, high):
    """Of n_dof harmonic degrees of freedom, whose energies are T times gamma numbers g of shape n_dof/2: by detailed
    balance ⟨min(1, w)⟩ is twice the probability of w > 1, which here is that of T g > T′ g′."""
    return 2.0 * betainc(0.5 * n_dof, 0.5 * n_dof, low / (low + high))


@pytest.mark.parametrize("n_dof", [1, 6, 40])
def test_harmonic_energies_are_exchanged_as_often_as_theory_says(n_dof):
    levels = np.array([0.5, 0.8, 1.1])
    energies = np.random.default_rng(1).gamma(0.5 * n_dof, levels, size=(12_000, 3))
    accepted = np.array([accepted_pairs(u, 1.0 / levels, 3, k) for k, u in enumerate(energies, 1)])
    assert not accepted[::2, 1].any()
    assert not accepted[1::2, 0].any()
    for k, times in ((0, accepted[::2, 0]), (1, accepted[1::2, 1])):
        expected = known_acceptance(n_dof, *levels[k : k + 2])
        assert times.mean() == pytest.approx(expected, abs=4.0 * (0.25 / len(times)) ** 0.5)  # statistics


def test_each_attempt_has_random_numbers_of_its_own_seed_and_number():
    levels = np.array([0.5, 0.8, 1.1, 1.5])
    energies = 2.0 * levels

    def made(seed):
        return np.array([accepted_pairs(energies, 1.0 / levels, seed, k) for k in range(1, 200)])

    np.testing.assert_array_equal(made(5), made(5))
    assert (made(5) != made(6)).any()
    assert 0 < made(5)[::2, 0].sum() < 100
    assert (made(5)[::2, 0] != made(5)[::2, 2]).any()


@pytest.mark.slow
def test_oscillators_are_exchanged_as_often_as_theory_says_at_the_energies_of_their_temperatures(tmp_path):
    """Averages of harmonic positions are exact at any time step. With little friction, velocities are those that an
    exchange has left."""
    levels = [0.8, 1.0, 1.25]
    build = partial(oscillators, friction=0.02)
    ladder = md.exchange(build, levels, 80_000, every=20, **alone_in(tmp_path)).after(50)
    for k, acceptance in enumerate(ladder.acceptance):
        expected = known_acceptance(12, levels[k], levels[k + 1])
        error = md.mean_and_error(ladder.accepted[(k + ladder.first + 1) % 2 :: 2, k].astype(float))[1]
        assert acceptance == pytest.approx(expected, abs=4.0 * error)  # statistics
    for name, factor in (("potential_energy", 1.0), ("kinetic_energy", 1.0 - 0.25 * 0.2**2)):
        means, errors = ladder.means(name)
        assert (np.abs(means - 6.0 * factor * np.array(levels)) < 4.0 * errors).all()  # statistics
        assert (errors < 0.03 * means).all()


@pytest.mark.slow
def test_a_double_well_is_filled_as_boltzmann_says_although_no_cold_particle_crosses_the_barrier(tmp_path):
    levels = [0.08, 0.15, 0.28, 0.52, 1.0]
    steps = 160_000
    ladder = md.exchange(ladders.in_the_left_well, levels, steps, every=40, **alone_in(tmp_path)).after(200)
    for k, level in enumerate(levels):
        weights = [
            quad(lambda x, level: np.exp(-(BARRIER * (x * x - 1.0) ** 2 + TILT * x) / level), *side, args=(level,))[0]
            for side in ((-4.0, 0.0), (0.0, 4.0))
        ]
        is_right = np.array([frame.positions[0, 0] > 0.0 for frame in ladder.frames(k)])
        mean, error = md.mean_and_error(is_right.astype(float))
        expected = weights[1] / sum(weights)
        assert mean == pytest.approx(expected, abs=4.0 * error)  # statistics
        assert error < 0.05
    alone = ladders.in_the_left_well(md.Member(0, {"temperature": levels[0]}, 0, 0, tmp_path))
    rights = []
    alone.run(steps, every=40, observers=[lambda sim: rights.append(sim.positions[0, 0] > 0.0)], progress=False)
    assert not any(rights)
    assert ladder.round_trips.min() > 10


def test_velocities_are_rescaled_with_the_temperature_and_what_they_gain_is_given_by_the_bath(tmp_path):
    build = partial(oscillators, n=2, friction=1e-9)
    ladder = md.exchange(build, [0.5, 0.6, 0.8], 200, every=5, folder=tmp_path, progress=False)
    assert ladder.accepted.sum() > 5
    for replica, record in enumerate(ladder.records):
        levels = ladder.temperatures[ladder.places[:, replica]]
        given = record.total_energy - record.conserved_energy
        gains = np.diff(given)[1:] / record.kinetic_energy[1:-1]
        np.testing.assert_allclose(gains, levels[1:] / levels[:-1] - 1.0, atol=1e-3)  # noise of the bath
        conserved = record.potential_energy * (1.0 - 0.25 * 0.2**2) + record.kinetic_energy - given
        np.testing.assert_allclose(conserved, conserved[0], rtol=1e-4)  # noise of the bath


def test_a_ladder_is_a_walk_of_its_files(whole):
    """Places follow from what was accepted, frames and records from places."""
    n = len(TEMPERATURES)
    assert len(whole) == STEPS // 10 == len(whole.places) == len(whole.accepted)
    order = np.arange(n)
    for places, accepted in zip(whole.places, whole.accepted, strict=True):
        np.testing.assert_array_equal(places[order], np.arange(n))
        for k in np.flatnonzero(accepted):
            order[k], order[k + 1] = order[k + 1], order[k]
    assert 0 < whole.accepted.sum() < whole.accepted.size // 2
    later = whole.after(3)
    assert (len(later), later.first) == (len(whole) - 3, 4)
    law = members.liquid(md.Member(0, {"temperature": 0.5}, 0, 0, whole.folder)).potentials
    for k in range(n):
        frames = list(later.frames(k))
        energies = [md.evaluate(md.System(f.positions, cell=members.EDGES), law).potential_energy for f in frames]
        np.testing.assert_allclose(energies, later.at_temperatures()[:, k], rtol=1e-12)  # rounding
    np.testing.assert_array_equal(
        later.at_temperatures("pressure"), np.take_along_axis(
            np.array([record.pressure[4:] for record in whole.records]).T, later.replicas, axis=1
        )
    )  # fmt: skip
    pair = later.accepted[1::2, 0]
    assert later.acceptance[0] == pair.sum() / len(pair)
    assert later.numbers()["n_round_trips"] == later.round_trips.sum()
    assert len(str(whole).splitlines()) == 3 + 1 + n
    assert later.plot().axes[0].lines


@pytest.mark.parametrize(
    ("path", "trips"),
    [([0, 1, 2, 1, 0], 1), ([0, 1, 2, 1, 2, 1], 0), ([2, 1, 0, 0, 1, 2, 1, 0, 1, 2], 2), ([1, 1], 0), ([], 0)],
)
def test_round_trips_are_ways_from_end_to_end_and_back(path, trips):
    assert n_round_trips(np.array(path, dtype=int), 2) == trips


@pytest.mark.parametrize("at", [pytest.param(k, marks=[pytest.mark.slow] * (k != 40)) for k in (9, 20, 33, 40, 55, 71)])
def test_a_ladder_that_is_killed_goes_on_with_the_same_bits(at, whole, tmp_path, monkeypatch):
    """At a change of a file; the files of some replicas then are ahead of others."""
    with monkeypatch.context() as patch:
        bring_to_disk_every(0.0, patch)
        assert killed_at(at, partial(run, tmp_path, executor=ThisProcess())) == KILLED
    assert_same(run(tmp_path), whole)


@pytest.mark.slow
def test_more_steps_and_lost_or_damaged_files_make_the_same_ladder(whole, tmp_path):
    run(tmp_path, 40)
    (tmp_path / "0000-0999/0001.h5md").unlink()
    with (tmp_path / "0000-0999/0002.h5md").open("r+b") as file:
        file.seek(3000)
        file.write(b"\xff" * 4000)
    assert_same(run(tmp_path), whole)
    assert_same(run(tmp_path), whole)  # there is nothing left to do


@pytest.mark.slow
def test_an_error_and_ctrl_c_leave_the_last_whole_round(whole, tmp_path, monkeypatch):
    n_runs, before = [0], md.Simulation.run

    def stopped(error):
        def breaks(simulation, *of, **how):
            n_runs[0] += 1
            record = before(simulation, *of, **how)
            if n_runs[0] % 10 == 0:
                raise error
            return record

        return breaks

    with monkeypatch.context() as patch:
        patch.setattr(md.Simulation, "run", stopped(md.NonFiniteError("broken")))
        with pytest.raises(md.NonFiniteError, match="broken") as failure:
            run(tmp_path)
        assert "member" in failure.value.__notes__[0]
        patch.setattr(md.Simulation, "run", stopped(KeyboardInterrupt()))
        with pytest.raises(Interrupted, match=r"of 8 attempts are made and kept") as interrupted:
            run(tmp_path)
    ladder = interrupted.value.result
    assert 0 < len(ladder) < len(whole)
    np.testing.assert_array_equal(ladder.energies, whole.energies[: len(ladder)])
    assert_same(run(tmp_path), whole)


EXECUTORS = {"fork": lambda: ProcessPoolExecutor(2, mp_context=multiprocessing.get_context("fork"))}
EXECUTORS |= {"spawned": lambda: SpawnedProcesses(2), "this process": ThisProcess}
KINDS = [pytest.param(kind, marks=[pytest.mark.slow] * (kind != "this process")) for kind in (*EXECUTORS, "dask")]


@pytest.mark.filterwarnings("ignore:This process:DeprecationWarning")
@pytest.mark.parametrize("kind", KINDS)
def test_any_executor_makes_the_same_bits(kind, whole, tmp_path):
    if kind == "dask":
        distributed = pytest.importorskip("distributed")
        cluster = distributed.LocalCluster(n_workers=2, threads_per_worker=1, processes=False, dashboard_address=None)
        with cluster, distributed.Client(cluster) as client:
            run(tmp_path, 40)
            ladder = run(tmp_path, executor=client)
    else:
        with EXECUTORS[kind]() as executor:
            executor.submit(int).result()  # a process that is forked later keeps the lock of a folder
            ladder = run(tmp_path, executor=executor)
    assert_same(ladder, whole)


SCRIPT = """
import sys
from ladders import run
if __name__ == "__main__":
    run("killed", int(sys.argv[1]), workers=int(sys.argv[2]) or None)
"""


@pytest.mark.slow
@pytest.mark.parametrize(("workers", "steps"), [(0, 6000), (2, 300)])
def test_a_ladder_that_is_killed_again_and_again_has_the_same_bits(workers, steps, tmp_path):
    """kill -9 at random moments, and the next call at once."""
    (tmp_path / "script.py").write_text(SCRIPT)
    environment = os.environ | {"PYTHONPATH": os.pathsep.join(map(str, Path(__file__).parents[1:3]))}
    command = [sys.executable, "script.py", str(steps), str(workers)]
    begun = partial(subprocess.Popen, command, cwd=tmp_path, env=environment)
    rng = np.random.default_rng(1)
    size = lambda: sum(file.stat().st_size for file in tmp_path.glob("killed/*/*.h5md"))  # noqa: E731
    n_kills = 0
    for _ in range(6):
        process, before = begun(), size()
        while process.poll() is None and size() == before:
            time.sleep(0.01)
        time.sleep(rng.uniform(0.0, 2.0))
        n_kills += process.poll() is None
        process.send_signal(signal.SIGKILL)
        process.wait()
    assert n_kills > 2
    assert begun().wait() == 0
    assert_same(run(tmp_path / "killed", steps), run(tmp_path / "whole", steps))


def with_method(method, member, **options):
    simulation = md.Simulation(md.System(ladders.ORIGIN), md.Restraint(1.0, ladders.ORIGIN), method)
    for name, value in options.items():
        setattr(simulation, name, value)
    return simulation


def langevin(member, temperature=1.0, friction=1.0, seed=None):
    seed = member.seed if seed is None else seed
    return with_method(md.LangevinBAOAB(0.1, temperature, friction, seed), member)


def other_laws(member):
    simulation = ladders.oscillators(member)
    springs = md.Restraint(1.0 + member.index, np.zeros(3))
    return md.Simulation(simulation.system, springs, simulation.method)


class Derived(md.LangevinBAOAB):
    """A bath that computes something of its temperature once."""

    def __init__(self, timestep, temperature, friction, seed):
        super().__init__(timestep, temperature, friction, seed)
        self.spread = np.sqrt(temperature)


def derived(member):
    bath = Derived(0.2, member["temperature"], 1.0, member.seed)
    return md.Simulation(ladders.oscillators(member).system, md.Restraint(1.0, np.zeros(3)), bath, skin=0.5)


def test_what_a_bath_derives_of_its_temperature_follows_it(tmp_path, monkeypatch):
    seen = []
    touch = Derived.touch

    def told(self, *arguments):
        seen.append(self.spread / self.temperature**0.5)
        return touch(self, *arguments)

    monkeypatch.setattr(Derived, "touch", told)
    ladder = md.exchange(derived, [1.0, 1.1], 200, every=10, folder=tmp_path, progress=False)
    assert ladder.accepted.any()
    assert np.array(seen) == pytest.approx(1.0)


def other_sizes(member):
    return oscillators(member, n=2 + member.index)


def active(member):
    push = md.ActiveForce(1.0, 1.0, seed=1)
    return md.Simulation(md.System(ladders.ORIGIN), push, md.LangevinBAOAB(0.1, 1.0, 1.0, member.seed))


def timed(member):
    field = md.Field(lambda x, y, z, t: (x * np.sin(t), -np.sin(t), 0.0, 0.0, x * np.cos(t)))
    return md.Simulation(md.System(ladders.ORIGIN), field, md.LangevinBAOAB(0.1, 1.0, 1.0, member.seed))


def pressed(member):
    bath = md.LangevinBAOAB(0.004, member["temperature"], 1.0, seed=member.seed)
    system = md.System(members.POSITIONS, cell=members.EDGES)
    barostat = md.StochasticCellRescaling(pressure=1.0, relaxation_time=1.0, compressibility=0.1, seed=1)
    return md.Simulation(system, md.LennardJones(1.0, 1.0, 1.8), bath, barostat=barostat)


WRONG = [  # options, error, what is named and shown
    ({"temperatures": [1.0]}, ValueError, "temperatures", "[1.0]"),
    ({"temperatures": [1.0, 0.5]}, ValueError, "temperatures", "[1.0, 0.5]"),
    ({"temperatures": [0.0, 0.5]}, ValueError, "temperatures", "[0.0, 0.5]"),
    ({"temperatures": [0.5, np.inf]}, ValueError, "temperatures", "inf"),
    ({"temperatures": "warm"}, ValueError, "temperatures"), ({"steps": 15}, ValueError, "steps", "15"),
    ({"every": 0}, ValueError, "every", "0"), ({"build": 3}, TypeError, "build", "3"),
    ({"prepare": 3}, TypeError, "prepare", "3"), ({"workers": -1}, ValueError, "workers", "-1"),
    ({"executor": "dask"}, TypeError, "executor", "'dask'"), ({"seed": -1}, ValueError, "seed", "-1"),
    ({"build": lambda _: 3}, TypeError, "build", "3"),
    ({"build": partial(with_method, md.VelocityVerlet(0.1))}, ValueError, "build", "VelocityVerlet", "no thermostat"),
    ({"build": partial(langevin, temperature=md.Ramp(0.1, 1.0, 10))}, ValueError, "build", "Ramp", "constant"),
    ({"build": partial(langevin, temperature=0.0)}, ValueError, "build", "temperature=0"),
    ({"build": partial(langevin, friction=0.0)}, ValueError, "build", "friction=0"),
    ({"build": other_laws}, ValueError, "same potentials", "member 1", "Restraint"),
    ({"build": partial(langevin, seed=3)}, ValueError, "build", "member 1", "seed 3"),
    ({"build": other_sizes}, ValueError, "build", "member 1"), ({"build": pressed}, ValueError, "build", "volume"),
    ({"build": active}, ValueError, "build", "active"), ({"build": timed}, ValueError, "build", "depend on time"),
]  # fmt: skip


@pytest.mark.parametrize("row", range(len(WRONG)))
def test_what_does_not_sample_the_canonical_ensemble_is_refused_and_wrong_arguments_are_named(row, tmp_path):
    options, *answer = WRONG[row]
    usual = {"build": langevin, "temperatures": TEMPERATURES, "steps": 20, "every": 10, "progress": False}
    assert_answered(lambda: md.exchange(folder=tmp_path, **usual | options), *answer)


def test_wrong_questions_are_answered(whole):
    assert_answered(lambda: whole.after(100), ValueError, "n_attempts", "100")
    assert_answered(lambda: whole.at_temperatures("presure"), ValueError, "name", "'presure'", "pressure")
    assert_answered(lambda: next(whole.frames(3)), ValueError, "k", "3")


def test_another_ladder_or_an_ensemble_in_the_folder_is_refused(whole, tmp_path):
    with pytest.raises(ValueError, match=r"3 temperatures there, md\.exchange between 4 temperatures here"):
        run(whole.folder, temperatures=(*TEMPERATURES, 0.9))
    with pytest.raises(ValueError, match="seed = 0 there, 1 here"):
        run(whole.folder, seed=1)
    rows = [{"temperature": level} for level in TEMPERATURES]
    with pytest.raises(ValueError, match="another ensemble"):
        members.run(whole.folder, parameters=rows, build=members.liquid, prepare=ladders.melt, steps=STEPS, every=10)
    other = run(tmp_path, seed=1)
    assert (other.energies[0] != whole.energies[0]).all()
    assert_same(run(tmp_path, resume=False), whole)
