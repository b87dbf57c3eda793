"""A team does each share of a task once, whoever comes to help, and nobody can hold it up."""

import os
import subprocess
import sys
import threading
import time
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest
from cluster_scenes import atoms_per_domain

from minimd.compiled.kernels import shared_kernel
from minimd.compiled.threads import (
    MOST_CHUNKS,
    ThreadPool,
    Worker,
    barrier,
    begin,
    finish_and_take,
    stop,
    take,
    thread_pool,
    was_stopped,
)
from minimd.neighbors.cluster_list import ClusterList
from minimd.neighbors.clusters import covered, make_columns
from minimd.structure.cell import Cell

N_PHASES = 4
PATIENT = 30.0  # seconds after which a test gives up


@shared_kernel
def count_shares(me, task, n, done, early):
    """done (threads, phases, n) += 1 for each share; early (threads,) += shares of an earlier phase that were not done when one began."""
    phase = begin(me, task)
    for p in range(done.shape[1]):
        share = take(me, phase, n)
        while share >= 0:
            for s in range(n if p > 0 else 0):
                times = 0
                for thread in range(done.shape[0]):
                    times += done[thread, p - 1, s]
                early[me.thread] += times != 1
            done[me.thread, p, share] += 1
            share = finish_and_take(me, phase, n)
        phase = barrier(me, phase)


def counted(team, n, n_phases=N_PHASES):
    """done of one task, after a look at the order of its phases."""
    done, early = np.zeros((team.n_threads, n_phases, n), dtype=np.int64), np.zeros(team.n_threads, dtype=np.int64)
    team.run(count_shares, n, done, early)
    assert not early.any()
    return done


def is_complete(done):
    return bool(np.all(done.sum(axis=0) == 1))


@shared_kernel
def walk(me, task, n, most, last, place, after):
    """Up to most steps of all n shares; the first share stops the walk at step last. Then one more phase. Returns how many steps were made."""
    phase, made = begin(me, task), 0
    while True:
        share = take(me, phase, n)
        while share >= 0:
            place[share] += 1
            if share == 0 and place[share] == last:
                stop(me, phase)
            share = finish_and_take(me, phase, n)
        walked, phase = phase, barrier(me, phase)
        made += 1
        if made == most or was_stopped(me, walked):
            break
    share = take(me, phase, n)
    while share >= 0:
        after[share] = place[share]
        share = finish_and_take(me, phase, n)
    barrier(me, phase)
    return made


@pytest.mark.parametrize("n_threads", [1, 2, 4, 8])
def test_a_stopped_task_ends_at_the_same_step_for_all_threads(n_threads):
    """More threads than cores: some are late by whole phases, the calling one too."""
    team, rng = thread_pool(n_threads), np.random.default_rng(2)
    for n, last in zip(rng.integers(1, 20, 3000), rng.integers(1, 60, 3000), strict=True):
        place, after = np.zeros(n, dtype=np.int64), np.zeros(n, dtype=np.int64)
        assert team.run(walk, n, 50, last, place, after) == min(50, last)
        assert np.all(place == min(50, last))
        assert np.array_equal(after, place)


@pytest.fixture
def no_helpers(monkeypatch):
    """Helpers that sleep until the event is set, then do what they should."""
    awake, help_as_it_should = threading.Event(), ThreadPool._help

    def oversleep(self, thread, wake):
        awake.wait()
        help_as_it_should(self, thread, wake)

    monkeypatch.setattr(ThreadPool, "_help", oversleep)
    return awake


@pytest.mark.parametrize("n_threads", range(1, 9))
@pytest.mark.parametrize("n", [1, 2, 3, 7, 8, 9, 64, 1000, MOST_CHUNKS])
def test_each_share_is_done_once_in_each_phase(n_threads, n):
    team = thread_pool(n_threads)
    for n_phases in (1, 3, 7):
        assert is_complete(counted(team, n, n_phases))


@pytest.mark.parametrize("n_threads", [1, 2, 4])
def test_tasks_follow_each_other_thousands_of_times(n_threads):
    team, rng = thread_pool(n_threads), np.random.default_rng(1)
    for n in rng.integers(1, 20, 4000):
        assert is_complete(counted(team, int(n)))


def test_helpers_help():
    team, until = ThreadPool(2), time.monotonic() + PATIENT
    while time.monotonic() < until:
        done = counted(team, MOST_CHUNKS)
        if done[0].any() and done[1].any():
            return
    pytest.fail("one thread of two did everything")


def test_helpers_that_never_come_hold_nobody_up(no_helpers):
    team = ThreadPool(4)
    for n in (1, 5, 100):
        done = counted(team, n)
        assert is_complete(done)
        assert not done[1:].any()
    no_helpers.set()


def test_helpers_that_come_late_join(no_helpers):
    team = ThreadPool(3)
    assert is_complete(counted(team, 10))
    no_helpers.set()
    until, helped = time.monotonic() + PATIENT, False
    while not helped and time.monotonic() < until:
        done = counted(team, MOST_CHUNKS)
        assert is_complete(done)
        helped = done[1:].any()
    assert helped


def test_helpers_that_died_hold_nobody_up(monkeypatch):
    monkeypatch.setattr(ThreadPool, "_help", lambda self, thread, wake: None)
    team = ThreadPool(3)
    for helper in team._helpers:
        helper.join()
    assert is_complete(counted(team, 10))


@pytest.mark.parametrize("n", [1, 4, MOST_CHUNKS])
def test_a_helper_that_comes_after_its_task_finds_nothing_to_do(n):
    team = ThreadPool(1)
    for _ in range(3):
        done, early = np.zeros((2, N_PHASES, n), dtype=np.int64), np.zeros(2, dtype=np.int64)
        team.run(count_shares, n, done, early)
        late = Worker(team._counters, 1, 2)
        for task in range(team._n_tasks + 1):
            count_shares(late, task, n, done, early)
        assert is_complete(done)
        assert not done[1].any()


def test_an_interrupt_before_the_kernel_leaves_the_team_usable():
    def interrupted(me, task, *arguments):
        if me.thread == 0:
            raise KeyboardInterrupt
        count_shares(me, task, *arguments)

    team = ThreadPool(3)
    for _ in range(50):
        done, early = np.zeros((3, N_PHASES, 5), dtype=np.int64), np.zeros(3, dtype=np.int64)
        with pytest.raises(KeyboardInterrupt):
            team.run(interrupted, 5, done, early)
        assert is_complete(counted(team, 9))
        assert not done.any()


def test_two_threads_of_python_take_turns_with_one_team():
    team = thread_pool(2)

    def many(n):
        return all(is_complete(counted(team, n)) for _ in range(500))

    with ThreadPoolExecutor(3) as pool:
        assert list(pool.map(many, [3, 17, 64])) == [True, True, True]


def test_no_more_threads_work_than_the_team_has():
    for n_threads in (1, 3):
        assert len(thread_pool(n_threads)._helpers) == n_threads - 1
        assert (thread_pool(n_threads) is thread_pool(n_threads)) == (
            n_threads > 1
        )  # helpers are shared; one thread waits for nobody
    assert all(helper.daemon for helper in thread_pool(3)._helpers)


@pytest.mark.parametrize("n", [100, 3000, 8000])
def test_chunks_are_never_more_than_a_team_can_share_out(n):
    """A thread of atoms, each of them its own column."""
    positions, cell = np.arange(n)[:, None] * np.array([1.1, 0.0, 0.0]), Cell.of(None)
    with atoms_per_domain(1):
        found = ClusterList(n, 1.8, 0.2, np.zeros((0, 2), dtype=np.int64), "double", thread_pool(2))
        found.update(positions, cell)
    columns, chunks = (
        make_columns(cell, len(positions), 2.0, found.lanes, *covered(cell, positions, 2.0)),
        found.domains,
    )
    assert len(chunks.column) - 1 == min(MOST_CHUNKS, columns.counts[0] // columns.reach[0])
    assert np.all(np.diff(chunks.column) >= columns.reach[0])
    assert (chunks.column[0], chunks.column[-1], chunks.cluster[-1]) == (0, columns.counts[0], found.n_clusters)


FORKED = """
import os, sys, warnings
import numpy as np
import minimd as md
from references import liquid

warnings.simplefilter("ignore")

def simulation():
    return md.Simulation(liquid(8), md.LennardJones(1.0, 1.0, 2.5), md.VelocityVerlet(0.004), threads=2)

before = simulation()
before.run(20)
child = os.fork()
fresh = simulation()
for run in (fresh, fresh, before):
    run.run(20)
same = np.array_equal(before.positions, fresh.positions)
if child == 0:
    os._exit(0 if same else 1)
status = os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])
print("parent", same, "child", status)
"""


@pytest.mark.skipif(not hasattr(os, "fork"), reason="no fork here")
def test_a_forked_child_runs_its_own_teams_and_those_it_inherits():
    where = os.environ | {"PYTHONPATH": os.pathsep.join([os.path.dirname(__file__), *sys.path])}
    answer = subprocess.run(
        [sys.executable, "-c", FORKED], capture_output=True, text=True, timeout=300, env=where, check=False
    )
    assert answer.stdout == "parent True child 0\n", answer.stderr
