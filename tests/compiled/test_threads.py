"""A team makes each chunk of an operation once, whoever comes to help, and nobody can hold it up."""

import os
import threading
import time
from collections import namedtuple
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest
from processes import ended

from minimd.core.compiled import threads
from minimd.core.compiled.by_address import ByAddress
from minimd.core.compiled.kernels import DirectCalls, called_kernel
from minimd.core.compiled.program import GO_ON, JUMP, Program, in_python, operation, side_by_side

N_PHASES, STOPPED = 4, 7
CALLS = DirectCalls()
FORKED = """
import os, sys, warnings
import numpy as np
from references import liquid
from scenes import LJ, Scene
warnings.simplefilter("ignore")
simulation = lambda: Scene(liquid(8), [LJ]).simulation(threads=2)
before = simulation()
before.run(20)
assert before.engine.interactions.pool.n_threads == 2
child = os.fork()
fresh = simulation()
for run in (fresh, fresh, before):
    run.run(20)
same = np.array_equal(before.positions, fresh.positions)
child or os._exit(not same)
print("parent", same, "child", os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]))
"""


class Counts(ByAddress, namedtuple("Counts", "phase done early last waits")):
    """done (phases, n) += 1 for each chunk; early (n,) += chunks begun before a phase had ended.
    last : (1,), whether the last chunk was made.  waits : reads that chunk 0 waits for it."""


@called_kernel
def count_chunk(counts, chunk):
    phase, done, early, last, waits = counts
    for k in range(done.shape[1] if phase > 0 else 0):
        early[chunk] += done[phase - 1, k] != 1
    reads = 0
    while chunk == 0 and reads < waits and threads._read(last, 0) == 0:
        reads += 1
    early[chunk] -= waits > 0 and chunk == 0 and reads < waits
    done[phase, chunk] += 1
    last[0] = chunk == done.shape[1] - 1
    return GO_ON


def program(team, n, n_phases=N_PHASES, waits=0):
    done, early, last = (np.zeros(shape, dtype=np.int64) for shape in ((n_phases, n), n, 1))
    made = [operation(CALLS, count_chunk, Counts(phase, done, early, last, waits), n) for phase in range(n_phases)]
    return Program(lambda: made, lambda: 0, team), done, early


def counted(team, n, n_phases=N_PHASES):
    found, done, early = program(team, n, n_phases)
    found.run()
    assert (np.all(done == 1), early.any()) == (True, False)


class Walk(ByAddress, namedtuple("Walk", "place last most")):
    """place (n,) : steps of each chunk."""


@called_kernel
def walk(walk, chunk):
    walk.place[chunk] += 1
    return GO_ON


@called_kernel
def is_there(walk, _chunk):
    """Another step, or the end, or Python at a certain step."""
    if walk.place[0] == walk.last:
        return STOPPED
    return JUMP if walk.place[0] < walk.most else GO_ON


@pytest.mark.parametrize("n_threads", [1, 2, pytest.param(4, marks=pytest.mark.slow), 8])
def test_a_program_loops_and_stops_at_the_same_step_for_all_threads(n_threads):
    """More threads than cores: some are late by whole phases, the calling one too."""
    team, rng, asked = threads.thread_pool(n_threads), np.random.default_rng(2), []
    for n, last in rng.integers(1, (20, 60), (1000, 2)):
        data = Walk(np.zeros(n, dtype=np.int64), int(last), 50)

        def answer(given, place=data.place):
            asked.append((given, place.copy()))
            place += 1  # what Python does

        step = operation(CALLS, walk, data, int(n))
        check = operation(CALLS, is_there, data, otherwise=-1, python=answer)
        end = in_python(lambda: asked.append(None))
        Program(lambda made=(step, check, end): made, lambda: 0, team).run()
        assert asked.pop() is None
        if last <= 50:
            given, place = asked.pop()
            assert (given, np.all(place == last)) == (STOPPED, True)
        assert (asked, np.all(data.place == max(50, last + 1 if last <= 50 else 0))) == ([], True)


@pytest.mark.parametrize("n_threads", [1, 2, 3, 8])
def test_each_chunk_is_made_once_in_each_phase(n_threads):
    team = threads.thread_pool(n_threads)
    for n in (1, 2, 3, 7, 8, 9, 64, 1000, threads.MOST_CHUNKS):
        for n_phases in (1, 3, 7):
            counted(team, n, n_phases)
    for n in np.random.default_rng(1).integers(1, 20, 1500):
        counted(team, int(n))


def is_helped(team):
    found, done, early = program(team, 16, 1, waits=10**6)
    found.run()
    assert np.all(done == 1)
    return early[0] < 0


def test_helpers_help_when_they_come_and_hold_nobody_up_before(monkeypatch):
    awake, help_as_it_should = threading.Event(), threads.ThreadPool._help
    monkeypatch.setattr(threads.ThreadPool, "_help", lambda *of: awake.wait() and help_as_it_should(*of))
    team = threads.ThreadPool(4)
    for n in (1, 5, 100):
        counted(team, n)
    assert not is_helped(team)
    awake.set()
    until = time.monotonic() + 30.0
    while not (helped := is_helped(team)) and time.monotonic() < until:
        pass
    assert helped
    monkeypatch.setattr(threads.ThreadPool, "_help", lambda self, thread, wake: None)
    team = threads.ThreadPool(3)
    for helper in team._helpers:
        helper.join()
    counted(team, 10)


@pytest.mark.parametrize("n", [1, 4, threads.MOST_CHUNKS])
def test_a_helper_that_comes_after_its_program_finds_nothing_to_do(n):
    team = threads.ThreadPool(2)
    for helper, wake in zip(team._helpers, team._wake, strict=True):
        team._task = ()
        wake.release()
        helper.join(0.01)
    for _ in range(3):
        found, done, early = program(team, n)
        found.run()
        late, rows = threads.Worker(team._counters, 1, 2), found._rows
        for task in range(1, int(team._counters[1]) + 1):
            threads.run_operations(late, task, rows, np.zeros(1, dtype=np.int64))
        assert (np.all(done == 1), early.any()) == (True, False)


def test_an_interrupt_before_the_kernel_leaves_the_team_usable(monkeypatch):
    team = threads.ThreadPool(3)
    counted(team, 9)

    def interrupted(worker, task, operations, course):
        raise KeyboardInterrupt

    for _ in range(50):
        found, done, _ = program(team, 5)
        with monkeypatch.context() as broken:
            broken.setattr(team, "_code", interrupted)
            with pytest.raises(KeyboardInterrupt):
                found.run()
        counted(team, 9)
        assert not done.any()


def test_threads_of_python_take_turns_with_one_team():
    team = threads.thread_pool(2)
    assert team is threads.thread_pool(2)
    with ThreadPoolExecutor(3) as pool:
        list(pool.map(lambda n: [counted(team, n) for _ in range(300)], [3, 17, 64]))


@pytest.mark.parametrize("n_threads", [1, 2, 3, 8])
def test_the_operation_behind_pythons_is_begun_beside_it_and_no_later_one(n_threads):
    """Python waits for a chunk of the long operation, which only a helper can make; those that need Python's wait."""
    team = threads.thread_pool(n_threads)
    for n in (1, 2, 9, threads.MOST_CHUNKS, *np.random.default_rng(3).integers(1, 20, 300)):
        program_of, done, early = program(team, int(n), 3)
        before, long, after = program_of._make()
        seen = []

        def look(done=done, seen=seen):
            until = time.monotonic() + 10.0
            while n_threads > 1 and not done[1].any() and time.monotonic() < until:
                time.sleep(0.0)
            time.sleep(1e-5)
            seen.append(done.any(axis=1).tolist())

        first, part = [before, long._replace(is_long=True)], [in_python(look, is_beside=True), after]
        Program(lambda made=(first, part): list(side_by_side(made[0], [made[1]], n_threads)), lambda: 0, team).run()
        assert seen == [[True, True, False]]
        assert (np.all(done == 1), early.any()) == (True, False)


def test_parts_are_begun_before_a_long_operation_only_up_to_pythons():
    made = [operation(CALLS, walk, Walk(np.zeros(1, dtype=np.int64), 1, 1), 1) for _ in range(6)]
    long, beside = made[1]._replace(is_long=True), in_python(print, is_beside=True)
    first, parts = [made[0], long, made[2]], [[made[3]], [made[4], beside, made[5]]]
    alone = [made[0], long, made[2], made[3], made[4], beside, made[5]]
    assert list(side_by_side(first, parts, 1)) == alone
    assert list(side_by_side([made[0]], parts, 2)) == [made[0], made[4], beside, made[3], made[5]]
    assert list(side_by_side(first, parts, 2)) == [
        *(made[0], made[4], beside, long, made[2]),
        *(made[3], made[5]),
    ]


@pytest.mark.parametrize("n_threads", [1, 2, 3])
def test_an_error_of_python_beside_an_operation_comes_when_that_has_ended(n_threads):
    team = threads.thread_pool(n_threads)

    def fail():
        raise KeyboardInterrupt

    for n in (1, 5, 64) * 20:
        program_of, done, _ = program(team, n, 2)
        before, long = program_of._make()
        made = [before, in_python(fail, is_beside=True), long._replace(is_long=True), in_python(pytest.fail)]
        with pytest.raises(KeyboardInterrupt):
            Program(lambda made=made: made, lambda: 0, team).run()
        assert np.all(done == 1)
        counted(team, n)


@pytest.mark.parametrize("n_threads", [1, 2])
def test_counters_begin_anew_before_they_overflow(n_threads):
    team = threads.ThreadPool(n_threads)
    counted(team, 5)
    team._counters[threads.OPEN] = (threads.MOST_PHASES << threads.BITS | threads.MOST_OPERATIONS) << threads.BITS
    for n in (5, 3, 64):
        counted(team, n)
    assert team._counters[threads.OPEN] >> 2 * threads.BITS < 100


def test_a_program_is_made_anew_when_its_memory_was_replaced():
    version, made, seen = [0], [], []

    def make():
        made.append(version[0])
        yield in_python(lambda: (seen.append(len(made)), version.__setitem__(0, 1)))
        yield in_python(lambda: seen.append(len(made)))

    found = Program(make, lambda: version[0], threads.thread_pool(1))
    found.run()
    assert (made, seen) == ([0, 1], [1, 2])
    found.run(1)
    assert (made, seen) == ([0, 1], [1, 2, 2])
    assert found._course[threads.AT] == 2


@pytest.mark.slow
@pytest.mark.skipif(not hasattr(os, "fork"), reason="no fork here")
def test_a_forked_child_runs_its_own_teams_and_those_it_inherits():
    answer = ended("-c", FORKED)
    assert answer.stdout == "parent True child 0\n", answer.stderr
