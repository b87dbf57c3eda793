"""md.ensemble: many runs on any executor, each with its own file; a call goes on where an earlier one was stopped."""

from __future__ import annotations

import pickle
import sys
from collections import Counter, deque
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from concurrent.futures import (
    BrokenExecutor,
    CancelledError,
    Executor,
    Future,
    ProcessPoolExecutor,
    ThreadPoolExecutor,
)
from contextlib import contextmanager
from itertools import count, islice
from pathlib import Path
from queue import SimpleQueue
from secrets import randbits
from time import sleep
from typing import Any
from uuid import uuid4

from minimd.core.compiled.machine import available_cores
from minimd.core.console.progress import progress_of
from minimd.core.console.quiet import warn
from minimd.core.console.signals import (
    Terminated,
    endings_are_told,
    raising_on_signals,
    stop_runs_of_threads,
    tell_ending,
)
from minimd.core.console.words import shown
from minimd.core.simulation.simulation import Simulation
from minimd.core.structure.checks import checked_count, checked_flag, checked_kind, checked_path
from minimd.core.structure.errors import EnsembleError, Interrupted, sentence
from minimd.ensemble.folder import ENTROPIES, Asked, EnsembleFolder, name_of
from minimd.ensemble.member import (
    DONE,
    FAILED,
    Job,
    Member,
    Plan,
    Row,
    checked_parameters,
    work_through,
)
from minimd.ensemble.table import EnsembleTable, written_table
from minimd.ensemble.workers import SpawnedProcesses, ThisProcess, WorkerNeverBegan, WorkerStopped

MOST_WAITING = 4096  # batches submitted at a time to an executor that the caller brings
# members are submitted in batches that take about so long, with at most so many members; their times are those of the
# last members that have ended
SECONDS_OF_A_BATCH = 1.0
MOST_IN_A_BATCH = 100
RECENT = 64
TOLD = 3  # failures that a warning names
BELOW = "put the call below: if __name__ == '__main__':"
OUTSIDE = f"If the script makes this call outside of functions, {BELOW}"
ANOTHER = "Make the same call again to go on, with a new executor: the old one may have given up because a process died"
# seconds between requests to stop, repeated because a member that is between two runs does not notice one
BETWEEN_REQUESTS = 0.02


Parameters = int | Mapping[str, Sequence[Any]] | Sequence[Mapping[str, Any]]


def ensemble(
    build: Callable[[Member], Simulation],
    parameters: Parameters,
    steps: int,
    *,
    prepare: Callable[[Simulation, Member], Any] | None = None,
    run: Callable[[Simulation, Member], Any] | None = None,
    every: int = 100,
    executor: Executor | None = None,
    workers: int | None = None,
    seed: int | None = 0,
    folder: str | Path = "scan",
    resume: bool = True,
    members: range | None = None,
    retries: int = 0,
    progress: bool | None = None,
) -> EnsembleTable:
    """Make many runs, each with parameters, random numbers and a file of its own; return a table of their averages.

    Members that an earlier call in the same folder has finished are skipped. Those that were stopped before the end go
    on from their files, with the same bits; those that failed begin anew. The result of a member depends on its index,
    its parameters and the seed alone.

    Parameters
    ----------
    build : function of a Member that returns its Simulation. It is called again if a member goes on from its file.
    parameters : number of members; or columns, such as {"temperature": [0.8, 0.9]}; or a list of dicts, one for each
        member.
    steps : number of steps of each member.
    prepare : function of simulation and member, such as an equilibration, called before the first step, but not when a
        member goes on.
    run : function of simulation and member that makes the run in place of minimd, and returns a Record, or a dict of
        numbers, of tuples (mean, error) or of series. A member that was stopped begins anew, unless the function calls
        member.run, which goes on from the file.
    every : steps between observations.
    executor : any concurrent.futures.Executor, such as client.get_executor() of dask or
        mpi4py.futures.MPIPoolExecutor(); all its workers must see the folder. If not given, processes are spawned on
        this machine.
    workers : number of those processes, one for each core if not given; 0 runs all members in this process, one after
        the other.
    seed : entropy of the SeedSequence from which each member gets a child; None for that of the folder, or a random one
        in a new folder.
    folder : for all files; see minimd.ensemble.folder.
    resume : False to delete all members in the folder, and begin anew.
    members : make only these, such as range(0, 50): other calls, also on other machines, may make others in the same
        folder at the same time. The table has the members of all calls.
    retries : how often a member is tried again in this call if its worker has died, or after an error of files,
        connections or memory. One that has blown up is not.
    progress : whether to show a bar that counts members, as for Simulation.run.

    A simulation has one thread, unless build says otherwise.

    Raises
    ------
    TypeError, ValueError : for wrong arguments, functions that cannot be sent to a process, a folder with another
        ensemble.
    EnsembleError, a RuntimeError : if all members fail, or the executor cannot run them, or not any more; if only some
        fail, a warning and the table say why.
    KeyboardInterrupt : after Ctrl-C; finished members are kept, and the next call goes on.
    OSError : if the folder cannot be written.
    """
    rows = checked_parameters(parameters)
    place = checked_path("folder", folder)
    steps = checked_count("steps", steps, 0)
    every = checked_count("every", every)
    resume = checked_flag("resume", resume)
    seed = None if seed is None else checked_count("seed", seed, 0, ENTROPIES)
    plan = Plan(build, prepare, run, every, uuid4().hex)
    retries = checked_count("retries", retries, 0)
    functions = {"build": build, "prepare": prepare, "run": run}
    check_functions(functions)
    n_workers = n_processes(executor, workers, functions)
    chosen_members = checked_members(members, len(rows), resume)

    with EnsembleFolder(place, writes=True, members=members and chosen_members) as opened:
        entropy = randbits(128) if seed is None else seed
        asked = Asked(entropy, steps, every, rows, *map(name_of, functions.values()))
        asked = opened.begin(asked, resume, any_seed=seed is None)
        todo = [index for index in chosen_members if not asked.is_done(opened.rows.get(index))]
        n_done = len(chosen_members) - len(todo)
        try:
            with (
                endings_are_told(),
                raising_on_signals(),
                opened_executor(executor, n_workers) as (chosen, most_waiting, seconds),
                progress_of(len(chosen_members), "ensemble", progress, "member") as tell,
            ):
                tell(n_done)
                jobs = _Jobs(_jobs_of(opened, asked, todo), retries, seconds)

                for row in _rows(chosen, plan, jobs, most_waiting):
                    opened.take(row)
                    n_done += 1
                    tell(n_done)
        except (KeyboardInterrupt, Terminated) as stopped:
            table = written_table(opened, asked, len(rows))
            n_kept = int(table.done.sum())
            state = f"{n_kept} of {len(table)} members are done and kept in {place}; make the same call again to go on"
            raise ending_of(stopped, state, table) from None
        except EnsembleError:
            written_table(opened, asked, len(rows))
            raise

        table = written_table(opened, asked, len(rows))

    _tell_failures(table, opened.rows, chosen_members)
    return table


def ending_of(
    stopped: KeyboardInterrupt | Terminated, state: str, result: Any
) -> Interrupted | Terminated:
    """What a call raises that was stopped by a signal, with its state in words and its result so far."""
    if not isinstance(stopped, Terminated):
        return Interrupted(f"interrupted: {state}", result)
    stopped.words = f"{stopped.words}; {state}"
    stopped.kept = ()
    tell_ending(stopped)
    return stopped


def _jobs_of(folder: EnsembleFolder, asked: Asked, indices: list[int]) -> Iterator[Job]:
    for k in indices:
        member = Member(k, asked.parameters[k], asked.seed, asked.steps, folder.file(k))
        yield member, folder.rows.get(k, {}).get("is_blown_up", False)


class _Jobs:
    """Jobs that are to be done, in batches: those of short members together.

    seconds : that a batch should take, 0 for batches of one.
    retries : see ensemble.
    """

    def __init__(self, jobs: Iterator[Job], retries: int, seconds: float) -> None:
        self._jobs = jobs
        self._retries = retries
        self._seconds = seconds
        self._size = 1
        self._again = deque[Job]()
        self._tries = Counter[int]()
        self._recent = deque[float](maxlen=RECENT)

    def batch(self) -> list[Job]:
        """The next jobs; what is done again is done alone."""
        if self._again:
            return [self._again.popleft()]
        return list(islice(self._jobs, self._size))

    def take(self, batch: list[Job], future: Future) -> Iterator[Row]:
        """The rows of a batch that has ended, without those of members that are tried again.
        Raises EnsembleError if members cannot be run, and KeyboardInterrupt."""
        for job, row in zip(batch, _rows_of(batch, future), strict=True):
            if row["status"] == DONE:
                self._recent.append(row["seconds"])
            died = row.pop("died", False)
            is_transient = row.pop("is_transient", False)
            if died and len(batch) > 1:  # one of them may have killed the worker
                self._again.append(job)
            elif (died or is_transient) and self._tries[row["index"]] < self._retries:
                self._tries[row["index"]] += 1
                self._again.append(job)
            else:
                yield row

        if self._recent:
            most = min(2 * self._size, MOST_IN_A_BATCH)
            wanted = max(1.0, self._seconds / max(1e-9, *self._recent))
            self._size = int(min(most, wanted))


def _rows(executor: Executor, plan: Plan, jobs: _Jobs, most_waiting: int) -> Iterator[Row]:
    """Rows of members, in the order in which they end. If the caller stops early, no further member begins."""
    ended: SimpleQueue[Future] = SimpleQueue()
    waiting: dict[Future, list[Job]] = {}
    numbers = count()

    def next_rows() -> Iterator[Row]:
        future = ended.get()
        return jobs.take(waiting.pop(future), future)

    try:
        while True:
            # what has ended is looked at first: it says how large the next batch should be
            while len(waiting) < most_waiting and (not waiting or ended.empty()):
                batch = jobs.batch()
                if not batch:
                    break
                try:
                    future = executor.submit(work_through, plan, batch, next(numbers))
                except Exception as error:  # such as that of an executor which has lost a process
                    while not ended.empty():
                        yield from next_rows()
                    raise EnsembleError(
                        f"{batch[0][0]} could not be given to the executor: {type(error).__name__}: {sentence(error)}. "
                        f"{ANOTHER}"
                    ) from error

                waiting[future] = batch
                future.add_done_callback(ended.put)

            if not waiting:
                return
            yield from next_rows()
    finally:
        end_all(executor, waiting)


def end_all(executor: Executor, waiting: Collection[Future]) -> None:
    """End what an executor has not done yet; runs in threads end after a whole step."""
    for future in waiting:
        future.cancel()
    if isinstance(executor, ThreadPoolExecutor):
        while not all(future.done() for future in waiting):
            stop_runs_of_threads()
            sleep(BETWEEN_REQUESTS)


def _rows_of(batch: list[Job], future: Future) -> list[Row]:
    """The rows of a batch that has ended, also if its worker died.
    Raises as _Jobs.take."""
    try:
        rows: list[Row] = future.result()
        return rows
    except (WorkerNeverBegan, BrokenExecutor, CancelledError, pickle.PicklingError) as error:
        reason = sentence(error)
        if isinstance(error, CancelledError):
            reason = "the executor gave up, as dask does if it has lost its scheduler"
        advice = OUTSIDE if isinstance(error, WorkerNeverBegan | pickle.PicklingError) else ANOTHER
        raise EnsembleError(
            f"{batch[0][0]} could not be run, and neither can the others: {reason}. {advice}"
        ) from None
    except (WorkerStopped, SystemExit):
        raise KeyboardInterrupt from None
    except Exception as error:  # of a worker that died, or any error of an executor
        failure = {
            "status": FAILED,
            "message": f"{type(error).__name__}: {sentence(error)}",
            "died": True,
            "traceback": "",
            "crash_file": "",
            "seconds": 0.0,
        }
        members = [member for member, _ in batch]
        return [{"index": m.index, "parameters": dict(m.parameters), **failure} for m in members]


@contextmanager
def opened_executor(
    executor: Executor | None, n_workers: int
) -> Iterator[tuple[Executor, int, float]]:
    """The executor, how many batches it may have at a time, and how long one should take [s].

    An executor made here is shut down at the end, at once after an error.
    """
    if executor is not None:
        seconds = 0.0 if isinstance(executor, ThreadPoolExecutor) else SECONDS_OF_A_BATCH
        if hasattr(executor, "get_executor"):
            executor = executor.get_executor()
        yield executor, MOST_WAITING, seconds
    elif n_workers == 0:
        yield ThisProcess(), 1, 0.0
    else:
        own = SpawnedProcesses(n_workers)
        try:
            yield own, 2 * n_workers, 0.0
        except BaseException:
            own.stop()
            raise
        finally:
            own.shutdown(cancel_futures=True)


def check_functions(functions: Mapping[str, Callable | None]) -> None:
    """Raise TypeError unless these are functions, or None but for build."""
    for name, function in functions.items():
        kind = Callable if name == "build" else Callable | None
        checked_kind(name, function, kind, "a function of a member")


def n_processes(
    executor: Executor | None, workers: int | None, sent: Mapping[str, Callable | None]
) -> int:
    """The number of processes to spawn.
    sent : functions that processes call.
    Raises TypeError, ValueError, RuntimeError if functions, executor and workers are wrong, or cannot work together."""
    if executor is not None:
        if workers is not None:
            raise ValueError(
                "workers is the number of minimd's own processes; with an executor leave it out; workers = "
                f"{shown(workers)}"
            )
        if not callable(getattr(executor, "submit", None)):
            raise TypeError(
                "executor must have a method submit, like a concurrent.futures.Executor; executor = "
                f"{shown(executor)}"
            )

    n_workers = available_cores() if workers is None else checked_count("workers", workers, 0)
    if isinstance(executor, ProcessPoolExecutor) or (executor is None and n_workers):
        for name, function in sent.items():
            _check_can_be_sent(name, function)
        frame = sys._getframe()

        while frame.f_back is not None:
            is_module = frame.f_code.co_name == "<module>"
            if is_module and frame.f_globals.get("__name__") == "__mp_main__":
                raise RuntimeError(
                    f"a worker process imports the script, which makes this call again; {BELOW}"
                )

            frame = frame.f_back

    return n_workers


def checked_members(members: range | None, n_members: int, resume: bool) -> range:
    """The indices of members that this call makes.
    Raises ValueError."""
    if members is None:
        return range(n_members)
    is_slice = isinstance(members, range) and members.step == 1
    if not is_slice or not 0 <= members.start < min(members.stop, n_members):
        raise ValueError(
            f"members must be some of the {n_members} members, such as range(0, 50); members = {shown(members)}"
        )
    if not resume:
        raise ValueError(
            f"members = {members} cannot be given with resume = False (--overwrite), which deletes all members"
        )
    return range(members.start, min(members.stop, n_members))


def _check_can_be_sent(name: str, function: Callable | None) -> None:
    """Raise TypeError unless other processes can find the function."""
    main = sys.modules.get("__main__")  # a notebook, a prompt or a script
    is_of_main = getattr(function, "__module__", None) == "__main__" and main is not None
    try:
        pickle.dumps(function)
        reason = "it was defined in a session, which other processes cannot import"
        if not is_of_main or hasattr(main, "__file__"):
            return
    except Exception as error:  # pickle raises errors of many kinds
        reason = sentence(error)
    raise TypeError(
        f"{name} cannot be sent to worker processes: {reason}. Define it with def at the top level of a file, and "
        "import it if this is a notebook; or pass workers=0 to stay in this process; or use an executor that can send "
        "such functions, such as that of dask"
    )


def _tell_failures(table: EnsembleTable, rows: dict[int, Row], members: range) -> None:
    """Warn of members that have failed, of those that were to be made.
    Raises EnsembleError if all have failed."""
    sentences = list(table.failures(members))
    n_failed = len(sentences)
    n_members = len(members)
    if n_failed == n_members:
        failure = EnsembleError(
            f"all {n_members} members have failed; the first failure was:\n{sentences[0]}"
        )
        failure.add_note(rows[members.start]["traceback"])
        raise failure
    if sentences:
        lines = [f"{n_failed} of {n_members} members have failed:", *sentences[:TOLD]]
        if n_failed > TOLD:
            lines.append(f"and {n_failed - TOLD} more, see the messages in the table")
        lines.append("The next call tries them again.")
        warn("\n".join(lines))
