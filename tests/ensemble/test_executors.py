"""Executors of md.ensemble: all make the same bits; an error, a process that dies, and Ctrl-C cost no other member."""

import multiprocessing
import os
import signal
import sys
import threading
from concurrent.futures import Future, ProcessPoolExecutor, ThreadPoolExecutor
from contextlib import contextmanager, nullcontext
from functools import partial
from pathlib import Path

import members
import numpy as np
import pytest
from processes import ended

import minimd as md
from minimd.core.forces.options import Options
from minimd.core.structure.errors import Interrupted
from minimd.ensemble.running import EnsembleError
from minimd.ensemble.workers import STARTS, SpawnedProcesses, ThisProcess, WorkerProcess

ONE = {"parameters": {"temperature": [0.5]}, "steps": 5}


@contextmanager
def dask():
    distributed = pytest.importorskip("distributed")
    cluster = distributed.LocalCluster(n_workers=2, threads_per_worker=1, processes=False, dashboard_address=None)
    with cluster, distributed.Client(cluster) as client:
        yield client


EXECUTORS = {"this process": ThisProcess, "threads": partial(ThreadPoolExecutor, 2)}
EXECUTORS |= {"fork": partial(ProcessPoolExecutor, 2, mp_context=multiprocessing.get_context("fork"))}
EXECUTORS |= {"spawned": partial(SpawnedProcesses, 1), "dask": dask}
KINDS = [pytest.param(kind, marks=[pytest.mark.slow] * (kind != "threads")) for kind in EXECUTORS]


@pytest.fixture(scope="module", params=KINDS)
def executor(request):
    with EXECUTORS[request.param]() as made:
        made.submit(int).result()  # a process that is forked later keeps the lock of a folder
        yield made


@pytest.mark.filterwarnings("ignore:This process:DeprecationWarning")
def test_any_executor_makes_the_same_bits_and_an_error_costs_one_member(executor, done, tmp_path):
    with pytest.warns(UserWarning, match="1 of 3 members have failed"):
        table = members.run(tmp_path, members.third_breaks_once, executor=executor)
    assert table["status"].tolist() == ["done", "done", "failed"]
    assert table["message"][2] == "LookupError: no structure for 2"
    assert np.isnan(table["pressure_mean"]).tolist() == [False, False, True]
    members.run(tmp_path)
    members.assert_same(tmp_path, done.folder)


@pytest.mark.slow
@pytest.mark.parametrize("executor", ["spawned"], indirect=True)
def test_a_law_of_the_users_works_in_spawned_workers(executor, tmp_path):
    here = members.run(tmp_path / "here", build=members.own_law, **ONE)
    there = members.run(tmp_path / "there", build=members.own_law, executor=executor, **ONE)
    assert there["pressure_mean"][0] == here["pressure_mean"][0] != 0.0


@pytest.mark.slow
def test_a_worker_that_is_killed_while_it_starts_is_replaced_unless_all_are(done, tmp_path, monkeypatch):
    start, left = WorkerProcess.__init__, [np.inf]

    def start_and_kill(worker):
        start(worker)
        if left[0] > 0:
            left[0] -= 1
            os.kill(worker.process.pid, signal.SIGKILL)

    monkeypatch.setattr(WorkerProcess, "__init__", start_and_kill)
    with pytest.raises(EnsembleError, match="SIGKILL"):
        members.run(tmp_path, workers=1)
    left[0] = STARTS - 1
    members.run(tmp_path, workers=1)
    assert left == [0]
    members.assert_same(tmp_path, done.folder)


def test_if_all_fail_the_first_failure_is_raised_with_its_traceback(tmp_path):
    with pytest.raises(EnsembleError, match=r"member 0 .*LookupError: no structure for 0") as failure:
        members.run(tmp_path, members.broken)
    assert "in broken" in failure.value.__notes__[0]


@pytest.mark.slow
def test_members_that_blow_up_are_told_with_their_crash_files_and_warnings_name_a_few(tmp_path):
    for n_failed in (1, 4):  # the second call makes the first of them anew
        parameters = {"temperature": [0.5, *[0.7] * n_failed]}
        told = rf"(?s){n_failed} of {n_failed + 1} members have failed:.member 1 .*NonFiniteError"
        with pytest.warns(UserWarning, match=told) as caught:
            table = members.run(tmp_path, prepare=members.blows_up, parameters=parameters)
        assert table["status"].tolist() == ["done"] + ["failed"] * n_failed
        assert (tmp_path / "0000-0999/0001.crash.h5md").exists()
    assert [str(one.message).count("\nmember") for one in caught if "have failed" in str(one.message)] == [3]
    assert "0001.crash.h5md" in table["message"][1]


def test_a_worker_has_one_thread_unless_told_otherwise(monkeypatch, tmp_path):
    seen, before = [], Options.most_threads.fget
    monkeypatch.setattr(Options, "most_threads", property(lambda options: seen.append(before(options)) or 1))
    members.run(tmp_path / "one", **ONE)
    assert set(seen) == {1}
    seen.clear()
    members.run(tmp_path / "two", build=partial(members.liquid, threads=2), **ONE)
    assert set(seen) == {2}


def test_seeds_are_children_of_one_sequence():
    for k, child in enumerate(np.random.SeedSequence(7).spawn(3)):
        member = md.Member(k, {}, 7, 10, Path("a.h5md"))
        assert member.seed_sequence.generate_state(4).tolist() == child.generate_state(4).tolist()
        assert 0 <= member.seed < 2**63
    with pytest.raises(KeyError, match="'density'"):
        member["density"]


@pytest.mark.skipif(os.name == "nt", reason="there are no such signals")
def test_ctrl_c_ends_members_in_threads_after_a_whole_step(tmp_path):
    n_steps, begun = 10**7, threading.Event()

    def told(member):
        if not begun.is_set():
            begun.set()
            threading.Timer(0.1, os.kill, (os.getpid(), signal.SIGINT)).start()
        return members.liquid(member)

    with ThreadPoolExecutor(2) as pool, pytest.raises(Interrupted) as interrupted:
        md.ensemble(told, members.TEMPERATURES, n_steps, every=1000, executor=pool, folder=tmp_path, progress=False)
    found, law = interrupted.value.result, md.LennardJones(1.0, 1.0, 1.8)
    assert set(found["status"]) == {"begun", "missing"}
    assert all(0 <= md.Simulation.resume(file, law).step < n_steps for file in found["file"][:2])


@pytest.mark.slow
def test_nothing_heavy_is_loaded_and_a_script_without_a_main_is_told_so(tmp_path):
    """A worker imports the script, which would make workers again."""
    (tmp_path / "script.py").write_text(
        "import sys, minimd.ensemble, minimd.ensemble.table, minimd as md\n"
        "print({'h5py', 'pandas', 'dask', 'mpi4py', 'tqdm', 'pydantic'} & set(sys.modules))\n"
        "from members import liquid\nmd.ensemble(liquid, {'temperature': [0.5]}, 5, workers=1)\n"
    )
    script = ended("script.py", folder=tmp_path)
    assert (script.returncode, script.stdout.splitlines()[0]) == (1, "set()")
    assert script.stderr.rstrip().endswith("if __name__ == '__main__':")


DISK, BUG, BLOWN_UP = OSError("busy"), ValueError("wrong"), md.NonFiniteError("blown up")


@pytest.mark.parametrize(("error", "retries", "tries"), [(DISK, 2, 3), (DISK, 1, 2), (BUG, 2, 1), (BLOWN_UP, 2, 1)])
def test_only_what_may_pass_is_tried_again(error, retries, tries, tmp_path):
    made = []

    def fails_twice(simulation, member):
        made.append(member.index)
        if member.index == 1 and made.count(1) < 3:
            raise error

    with nullcontext() if tries == 3 else pytest.warns(UserWarning, match="1 of 3 members have failed"):
        assert int(members.run(tmp_path, fails_twice, retries=retries).done.sum()) == 2 + (tries == 3)
    assert sorted(made) == [0, *[1] * tries, 2]


class Remote(ThisProcess):
    """Whoever runs member 70 dies; after 90 calls, all are given up."""

    def __init__(self):
        self.batches = []

    def submit(self, function, plan, jobs, number):
        self.batches.append([member.index for member, _ in jobs])
        future = Future()
        if len(self.batches) > 90:
            future.cancel()
        elif 70 in self.batches[-1]:
            future.set_exception(RuntimeError("the worker died"))
        return future if future.done() else super().submit(function, plan, jobs, number)


def test_short_members_go_in_batches_and_of_one_that_dies_the_others_are_made(tmp_path):
    remote, options = Remote(), {"run": lambda *_: {"x": 1.0}, "prepare": None, "steps": 0, "folder": tmp_path}
    made = partial(members.run, parameters={"temperature": [0.5] * 200}, executor=remote, **options)
    with pytest.warns(UserWarning, match=r"1 of 200 members have failed:\nmember 70 .*RuntimeError: the worker died"):
        assert int(made().done.sum()) == 199
    assert [70] in remote.batches
    assert len(remote.batches) < 90
    remote.batches *= 90
    with pytest.raises(EnsembleError, match=r"member 70 .*could not be run.*Make the same call again"):
        made()


@pytest.mark.slow
def test_mpi_makes_the_same_bits(done, tmp_path):
    pytest.importorskip("mpi4py")
    mpiexec = Path(sys.executable).with_name("mpiexec")
    if not mpiexec.exists():
        pytest.skip("there is no mpiexec beside Python")
    (tmp_path / "script.py").write_text(
        "import members\nfrom mpi4py.futures import MPIPoolExecutor\n"
        "if __name__ == '__main__':\n    with MPIPoolExecutor() as pool:\n        members.run('scan', executor=pool)\n"
    )
    command, libraries = ("-n", "3", sys.executable, "-m", "mpi4py.futures", "script.py"), mpiexec.parents[1] / "lib"
    script = ended(mpiexec, *command, folder=tmp_path, LD_LIBRARY_PATH=str(libraries))
    assert script.returncode == 0, script.stderr
    members.assert_same(tmp_path / "scan", done.folder)
