"""A team does each share of a task once, whoever comes to help, and nobody can hold it up."""

import os
import subprocess
import sys
import threading
import time
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest

from minimd.compiled import threads
from minimd.compiled.kernels import shared_kernel
from minimd.compiled.threads import MOST_CHUNKS, ThreadPool, Worker, thread_pool

N_PHASES = 4


@shared_kernel
def count_shares(me, task, n, done, early):
    """done (threads, phases, n) += 1 for each share; early (threads,) += shares begun before a phase had ended."""
    phase = threads.begin(me, task)
    for p in range(done.shape[1]):
        share = threads.take(me, phase, n)
        while share >= 0:
            for s in range(n if p > 0 else 0):
                times = 0
                for thread in range(done.shape[0]):
                    times += done[thread, p - 1, s]
                early[me.thread] += times != 1
            done[me.thread, p, share] += 1
            share = threads.finish_and_take(me, phase, n)
        phase = threads.barrier(me, phase)


def counts(n_threads, n, n_phases=N_PHASES):
    return np.zeros((n_threads, n_phases, n), dtype=np.int64), np.zeros(n_threads, dtype=np.int64)


def counted(team, n, n_phases=N_PHASES):
    done, early = counts(team.n_threads, n, n_phases)
    team.run(count_shares, n, done, early)
    assert not early.any()
    assert np.all(done.sum(axis=0) == 1)
    return done


@shared_kernel
def walk(me, task, n, most, last, place, after):
    """Up to most steps of all n shares, and their number; the first share stops it at step last. One more phase."""
    phase, made = threads.begin(me, task), 0
    while True:
        share = threads.take(me, phase, n)
        while share >= 0:
            place[share] += 1
            if share == 0 and place[share] == last:
                threads.stop(me, phase)
            share = threads.finish_and_take(me, phase, n)
        walked, phase = phase, threads.barrier(me, phase)
        made += 1
        if made == most or threads.was_stopped(me, walked):
            break
    share = threads.take(me, phase, n)
    while share >= 0:
        after[share] = place[share]
        share = threads.finish_and_take(me, phase, n)
    threads.barrier(me, phase)
    return made


@pytest.mark.parametrize("n_threads", [1, 2, pytest.param(4, marks=pytest.mark.slow), 8])
def test_a_stopped_task_ends_at_the_same_step_for_all_threads(n_threads):
    """More threads than cores: some are late by whole phases, the calling one too."""
    team, rng = thread_pool(n_threads), np.random.default_rng(2)
    for n, last in rng.integers(1, (20, 60), (1000, 2)):
        place, after = np.zeros(n, dtype=np.int64), np.zeros(n, dtype=np.int64)
        assert team.run(walk, n, 50, last, place, after) == min(50, last)
        assert np.all(place == min(50, last))
        assert np.array_equal(after, place)


@pytest.mark.parametrize("n_threads", [1, 2, 3, 8])
def test_each_share_is_done_once_in_each_phase(n_threads):
    team = thread_pool(n_threads)
    for n in (1, 2, 3, 7, 8, 9, 64, 1000, MOST_CHUNKS):
        for n_phases in (1, 3, 7):
            counted(team, n, n_phases)
    for n in np.random.default_rng(1).integers(1, 20, 1500):
        counted(team, int(n))


def test_helpers_help_when_they_come_and_hold_nobody_up_before(monkeypatch):
    """Nor do those that died."""
    awake, help_as_it_should = threading.Event(), ThreadPool._help
    monkeypatch.setattr(ThreadPool, "_help", lambda *of: awake.wait() and help_as_it_should(*of))
    team = ThreadPool(4)
    for n in (1, 5, 100):
        assert not counted(team, n)[1:].any()
    awake.set()
    until, is_helped = time.monotonic() + 30.0, False
    while not is_helped and time.monotonic() < until:
        is_helped = counted(team, MOST_CHUNKS)[1:].any()
    assert is_helped
    monkeypatch.setattr(ThreadPool, "_help", lambda self, thread, wake: None)
    team = ThreadPool(3)
    for helper in team._helpers:
        helper.join()
    counted(team, 10)


@pytest.mark.parametrize("n", [1, 4, MOST_CHUNKS])
def test_a_helper_that_comes_after_its_task_finds_nothing_to_do(n):
    team = ThreadPool(1)
    for _ in range(3):
        done, early = counts(2, n)
        team.run(count_shares, n, done, early)
        late = Worker(team._counters, 1, 2)
        for task in range(team._n_tasks + 1):
            count_shares(late, task, n, done, early)
        assert np.all(done.sum(axis=0) == 1)
        assert not done[1].any()


def test_an_interrupt_before_the_kernel_leaves_the_team_usable():
    def interrupted(me, task, *arguments):
        if me.thread == 0:
            raise KeyboardInterrupt
        count_shares(me, task, *arguments)

    team = ThreadPool(3)
    for _ in range(50):
        done, early = counts(3, 5)
        with pytest.raises(KeyboardInterrupt):
            team.run(interrupted, 5, done, early)
        counted(team, 9)
        assert not done.any()


def test_threads_of_python_take_turns_with_one_team():
    """Its helpers are shared by all who ask for as many."""
    team = thread_pool(2)
    assert team is thread_pool(2)
    with ThreadPoolExecutor(3) as pool:
        list(pool.map(lambda n: [counted(team, n) for _ in range(300)], [3, 17, 64]))


FORKED = """
import os, sys, warnings
import numpy as np
from references import liquid
from scenes import LJ, Scene
warnings.simplefilter("ignore")
simulation = lambda: Scene(liquid(8), [LJ]).simulation(threads=2)
before = simulation()
before.run(20)
assert before.engine.interactions.terms[0]._pool.n_threads == 2
child = os.fork()
fresh = simulation()
for run in (fresh, fresh, before):
    run.run(20)
same = np.array_equal(before.positions, fresh.positions)
child or os._exit(not same)
print("parent", same, "child", os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]))
"""


@pytest.mark.slow
@pytest.mark.skipif(not hasattr(os, "fork"), reason="no fork here")
def test_a_forked_child_runs_its_own_teams_and_those_it_inherits():
    where = os.environ | {"PYTHONPATH": os.pathsep.join(sys.path)}
    answer = subprocess.run([sys.executable, "-c", FORKED], capture_output=True, text=True, env=where, check=False)
    assert answer.stdout == "parent True child 0\n", answer.stderr
