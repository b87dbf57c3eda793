"""Spawned worker processes, each of which can die without ending the others; an executor that uses this process only;
and the executors that `minimd scan` knows by name.

concurrent.futures.ProcessPoolExecutor gives up all members when one of its processes is killed. Here each process has
its own pipe and thread; if a process dies, its member fails, and the next member gets a new process.
"""

import multiprocessing
import os
import pickle
import signal
import threading
from collections.abc import Callable, Iterator
from concurrent.futures import Executor, Future, ThreadPoolExecutor
from contextlib import contextmanager, suppress
from typing import Any

from minimd.core.compiled.machine import available_cores
from minimd.core.console.signals import endings_are_told
from minimd.core.console.words import shown
from minimd.core.files.claim import end_with

EXECUTORS = ("processes", "threads", "dask", "mpi")
READY = b"ready"
STARTS = 3  # attempts to start a worker process; if all of them are killed, the next would be, too


class WorkerDied(RuntimeError):  # noqa: N818  # the name says what happened
    """The process that ran a member has died.  The message says how."""


class WorkerStopped(Exception):  # noqa: N818
    """A process was told to end."""


class WorkerNeverBegan(RuntimeError):  # noqa: N818
    """A process ended before it could take a member."""


class SpawnedProcesses(Executor):
    """An executor with n_workers processes, each spawned when it is first needed."""

    def __init__(self, n_workers: int) -> None:
        self._threads = ThreadPoolExecutor(n_workers, thread_name_prefix="minimd worker")
        self._own = threading.local()
        self._workers = list[WorkerProcess]()
        self._is_stopped = False

    def submit(self, function: Callable, /, *args: Any, **kwargs: Any) -> Future:
        """Call function(*args, **kwargs) in one of the processes; function and arguments must be picklable."""
        return self._threads.submit(self._in_process, pickle.dumps((function, args, kwargs)))

    def stop(self) -> None:
        """End the processes, a run after a whole step; jobs that are waiting do not begin."""
        self._is_stopped = True
        for worker in list(self._workers):
            worker.process.terminate()

    def shutdown(self, wait: bool = True, *, cancel_futures: bool = False) -> None:
        """Wait for the submitted jobs, then end the processes."""
        self._threads.shutdown(wait, cancel_futures=cancel_futures)
        for worker in self._workers:
            worker.end()

    def _in_process(self, job: bytes) -> Any:
        worker = getattr(self._own, "worker", None) or self._ready_worker()
        try:
            if self._is_stopped:
                raise WorkerStopped
            return worker.do(job)
        except (WorkerDied, WorkerStopped):
            self._own.worker = None
            self._workers.remove(worker)
            if self._is_stopped:
                raise WorkerStopped from None
            raise

    def _ready_worker(self) -> "WorkerProcess":
        """A new worker of this thread; if it is killed while it starts, another one.

        Raises WorkerNeverBegan, WorkerStopped.
        """
        for _ in range(STARTS):
            worker = WorkerProcess()
            self._workers.append(worker)
            if worker.is_ready():
                self._own.worker = worker
                return worker
            self._workers.remove(worker)
            if self._is_stopped:
                raise WorkerStopped
            # an error, which another process would meet, too
            if (worker.process.exitcode or 0) >= 0:
                break
        raise WorkerNeverBegan(worker.ending())


class WorkerProcess:
    """A process that does one job after the other."""

    def __init__(self) -> None:
        context = multiprocessing.get_context("spawn")
        self._pipe, theirs = context.Pipe()
        self.process = context.Process(target=serve, args=(theirs, os.getpid()), daemon=True)
        self.process.start()
        theirs.close()

    def is_ready(self) -> bool:
        """Wait until the process can take jobs; False if it has ended before."""
        with suppress(EOFError, OSError):
            return self._pipe.recv_bytes() == READY
        self.process.join()
        return False

    def do(self, job: bytes) -> Any:
        """The result of a pickled job.
        Raises what the job raises, WorkerDied if the process dies, WorkerStopped if it was told to end."""
        try:
            self._pipe.send_bytes(job)
            result, error = pickle.loads(self._pipe.recv_bytes())
        except (EOFError, OSError):
            self.process.join()
            raise WorkerDied(self.ending()) from None
        if error is not None:
            raise error
        return result

    def end(self) -> None:
        """Close the pipe, which ends the process, and wait for its end."""
        self._pipe.close()
        self.process.join()

    def ending(self) -> str:
        """How the process has ended."""
        code = self.process.exitcode or 0
        with suppress(ValueError):
            return f"its worker process was killed by {signal.Signals(-code).name}"
        return f"its worker process ended with code {code}"


def serve(pipe: Any, parent: int) -> None:
    """Main function of a worker process: it takes jobs from the pipe until the other end is closed,
    and it ends if its parent ends.

    Ctrl-C is for the parent alone, which then sends SIGTERM.
    """
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    end_with(parent, signal.SIGTERM)
    with endings_are_told(), suppress(EOFError, OSError):  # the other end of the pipe is closed
        pipe.send_bytes(READY)
        while True:
            pipe.send_bytes(_answer(pipe.recv_bytes()))


def _answer(job: bytes) -> bytes:
    """Result and error of a job, pickled."""
    result = None
    failure: BaseException | None = None
    try:
        function, args, kwargs = pickle.loads(job)
        result = function(*args, **kwargs)
    except (KeyboardInterrupt, SystemExit):
        failure = WorkerStopped()
    except Exception as error:
        failure = error
    try:
        return pickle.dumps((result, failure))
    except Exception as error:  # pickling objects of the user may raise any error
        failure = RuntimeError(f"the result of a worker cannot be sent back: {error}")
        return pickle.dumps((None, failure))


class ThisProcess(Executor):
    """An executor that does each job at once, in this process."""

    def submit(self, function: Callable, /, *args: Any, **kwargs: Any) -> Future:
        """Call function(*args, **kwargs); the future is done when this method returns."""
        future: Future = Future()
        try:
            future.set_result(function(*args, **kwargs))
        except Exception as error:
            future.set_exception(error)
        return future


@contextmanager
def named_executor(name: str, workers: int | None) -> Iterator[dict[str, Any] | None]:
    """The arguments `executor` and `workers` of ensemble for one of the EXECUTORS; None in a process of MPI that works
    for another.

    workers : number of processes or threads of this machine, one for each core if None.
    Raises ValueError for another name, if a package is missing, there is no other process of MPI, or workers is given
    where others choose it.
    """
    if name not in EXECUTORS:
        raise ValueError(
            f"--executor must be processes, threads, dask or mpi; --executor {shown(name)}"
        )

    try:
        if name == "dask":
            from dask import config
            from distributed import Client
        elif name == "mpi":
            from mpi4py.futures import MPICommExecutor
            from mpi4py.MPI import COMM_WORLD
    except ModuleNotFoundError as error:
        raise ValueError(
            f"--executor {name} needs {error.name}, which is missing: pip install 'minimd-engine[cluster]'"
        ) from error

    if name == "processes":
        yield {"workers": workers}
        return
    owner = "mpiexec" if name == "mpi" else ""
    if name == "dask" and config.get("scheduler-address", None):  # perhaps from the environment
        owner = "the scheduler"
    if owner and workers is not None:
        raise ValueError(
            f"--executor {name} uses all processes of {owner}: leave out --workers, which is {workers}"
        )

    n_workers = max(1, available_cores() if workers is None else workers)
    opened: Any
    if name == "threads":
        opened = ThreadPoolExecutor(n_workers)
    elif name == "dask":
        local = {"n_workers": n_workers, "threads_per_worker": 1, "dashboard_address": None}
        opened = Client(**({} if owner else local))
    else:
        if COMM_WORLD.size == 1:
            raise ValueError(
                "--executor mpi needs at least 2 processes of MPI; there is 1: begin the command by mpiexec -n P: the "
                "first process gives out the work"
            )
        opened = MPICommExecutor()

    with opened as executor:
        yield None if executor is None else {"executor": executor}
