"""md.ensemble: many runs on any executor, each with its own file; a call goes on where an earlier one was stopped."""

from __future__ import annotations

import pickle
import sys
import warnings
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import CancelledError, Executor, Future, ProcessPoolExecutor, ThreadPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from pathlib import Path
from queue import SimpleQueue
from secrets import randbits
from time import sleep
from typing import Any
from uuid import uuid4

from minimd.compiled.machine import available_cores
from minimd.console.progress import progress_of
from minimd.console.quiet import outside_minimd
from minimd.console.signals import Terminated, endings_are_told, raising_on_signals, stop_runs_of_threads, tell_ending
from minimd.console.words import shown
from minimd.ensemble.folder import ENTROPIES, Asked, EnsembleFolder, name_of
from minimd.ensemble.member import FAILED, Member, Plan, Row, checked_parameters, work
from minimd.ensemble.table import EnsembleTable, written_table
from minimd.ensemble.workers import SpawnedProcesses, ThisProcess, WorkerNeverBegan
from minimd.simulation.simulation import Simulation
from minimd.structure.checks import checked_count, checked_flag
from minimd.structure.errors import Interrupted, sentence

MOST_WAITING = 4096  # members submitted at a time to an executor that the caller brings
TOLD = 3  # failures that a warning names
BELOW = "put the call below: if __name__ == '__main__':"
OUTSIDE = f"If the script calls md.ensemble outside of functions, {BELOW}"
ANOTHER = "Call md.ensemble again to go on, with a new executor or none: some give up when one of their processes dies"
# seconds between requests to stop, repeated because a member that is between two runs does not notice one
BETWEEN_REQUESTS = 0.02


class EnsembleError(RuntimeError):
    """All members have failed, with the traceback of the first in the notes; or members cannot be run at all."""


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
    folder : for all files; see minimd.ensemble.folder.  resume : False to replace what is in the folder.
    progress : whether to show a bar that counts members, as for Simulation.run.

    A simulation has one thread, unless build says otherwise.

    Raises
    ------
    TypeError, ValueError : for wrong arguments, functions that cannot be sent to a process, a folder with another
        ensemble.
    EnsembleError, a RuntimeError : if all members fail or cannot be run; if only some fail, a warning and the table say
        why.
    KeyboardInterrupt : after Ctrl-C; finished members are kept, and the next call goes on.
    OSError : if the folder cannot be written.
    """
    rows, place = checked_parameters(parameters), Path(folder)
    steps, every = checked_count("steps", steps, 0), checked_count("every", every)
    resume, seed = checked_flag("resume", resume), None if seed is None else checked_count("seed", seed, 0, ENTROPIES)
    plan = Plan(build, prepare, run, every, uuid4().hex)
    n_workers = _check_executor(executor, workers, plan)
    with EnsembleFolder(place, writes=True) as opened:
        if seed is None:
            seed = opened.asked.seed if resume and opened.asked is not None else randbits(128)
        asked = opened.begin(Asked(seed, steps, every, rows, name_of(build), name_of(prepare), name_of(run)), resume)
        todo = [index for index in range(len(rows)) if not asked.is_done(opened.rows.get(index))]
        jobs = (
            (Member(k, rows[k], seed, steps, opened.file(k)), opened.rows.get(k, {}).get("is_blown_up", False))
            for k in todo
        )
        try:
            with (
                endings_are_told(),
                raising_on_signals(),
                _executor(executor, n_workers) as (chosen, most_waiting),
                progress_of(len(rows), "ensemble", progress, "member") as tell,
            ):
                tell(len(rows) - len(todo))
                for n_made, row in enumerate(_rows(chosen, plan, jobs, most_waiting), start=1):
                    opened.take(row)
                    tell(len(rows) - len(todo) + n_made)
        except (KeyboardInterrupt, Terminated) as stopped:
            table = written_table(opened, asked, len(rows))
            told = f"{int(table.done.sum())} of {len(rows)} members are done and kept in {place}; the same call goes on"
            if isinstance(stopped, Terminated):
                stopped.words, stopped.kept = f"{stopped.words}; {told}", ()
                tell_ending(stopped)
                raise
            raise Interrupted(f"interrupted: {told}", table) from None
        except EnsembleError:
            written_table(opened, asked, len(rows))
            raise
        table = written_table(opened, asked, len(rows))
    _tell_failures(table, opened.rows)
    return table


def _rows(executor: Executor, plan: Plan, jobs: Iterator[tuple[Member, bool]], most_waiting: int) -> Iterator[Row]:
    """Rows of members, in the order in which they end. If the caller stops early, no further member begins."""
    ended: SimpleQueue[Future] = SimpleQueue()
    members: dict[Future, Member] = {}
    try:
        while True:
            while len(members) < most_waiting and (job := next(jobs, None)) is not None:
                try:
                    future = executor.submit(work, plan, *job)
                except Exception as error:  # such as that of an executor which has lost a process
                    while not ended.empty():
                        yield _row_of(ended.get(), members)
                    words = f"{job[0]} could not be given to the executor: {type(error).__name__}: {sentence(error)}"
                    raise EnsembleError(f"{words}. {ANOTHER}") from error
                members[future] = job[0]
                future.add_done_callback(ended.put)
            if not members:
                return
            yield _row_of(ended.get(), members)
    finally:
        for future in members:
            future.cancel()
        while isinstance(executor, ThreadPoolExecutor) and not all(future.done() for future in members):
            stop_runs_of_threads()
            sleep(BETWEEN_REQUESTS)


def _row_of(future: Future, members: dict[Future, Member]) -> Row:
    """The row of a member that has ended, also if its worker died.  Raises EnsembleError if members cannot be run, and
    KeyboardInterrupt."""
    member = members.pop(future)
    try:
        row: Row = future.result()
        return row
    except (WorkerNeverBegan, BrokenProcessPool, pickle.PicklingError) as error:
        advice = ANOTHER if isinstance(error, BrokenProcessPool) else OUTSIDE
        words = f"{member} could not be run, and neither can the others: {sentence(error)}. {advice}"
        raise EnsembleError(words) from None
    except (CancelledError, SystemExit):
        raise KeyboardInterrupt from None
    except Exception as error:  # of a worker that died, or any error of an executor
        message = f"{type(error).__name__}: {sentence(error)}"
        row = {"index": member.index, "parameters": dict(member.parameters), "status": FAILED, "message": message}
        return row | {"traceback": "", "crash_file": "", "seconds": 0.0}


@contextmanager
def _executor(executor: Executor | None, n_workers: int) -> Iterator[tuple[Executor, int]]:
    """The executor, and how many members it may have at a time.

    An executor made here is shut down at the end, at once after an error.
    """
    if executor is not None:
        yield executor.get_executor() if hasattr(executor, "get_executor") else executor, MOST_WAITING
    elif n_workers == 0:
        yield ThisProcess(), 1
    else:
        own = SpawnedProcesses(n_workers)
        try:
            yield own, 2 * n_workers
        except BaseException:
            own.stop()
            raise
        finally:
            own.shutdown(cancel_futures=True)


def _check_executor(executor: Executor | None, workers: int | None, plan: Plan) -> int:
    """The number of processes to spawn.  Raises TypeError, ValueError, RuntimeError if functions, executor and workers
    are wrong, or cannot work together."""
    functions = {"build": plan.build, "prepare": plan.prepare, "run": plan.run}
    for name, function in functions.items():
        if not callable(function) and (function is not None or name == "build"):
            of = " of a member" if name == "build" else ""
            raise TypeError(f"{name} must be a function{of}; {name} = {shown(function)}")
    if executor is not None and workers is not None:
        words = "workers is the number of minimd's own processes; with an executor leave it out"
        raise ValueError(f"{words}; workers = {shown(workers)}")
    if executor is not None and not callable(getattr(executor, "submit", None)):
        words = "executor must have a method submit, like a concurrent.futures.Executor"
        raise TypeError(f"{words}; executor = {shown(executor)}")
    n_workers = available_cores() if workers is None else checked_count("workers", workers, 0)
    if isinstance(executor, ProcessPoolExecutor) or (executor is None and n_workers):
        for name, function in functions.items():
            _check_can_be_sent(name, function)
        frame = sys._getframe()
        while frame.f_back is not None:
            if frame.f_code.co_name == "<module>" and frame.f_globals.get("__name__") == "__mp_main__":
                raise RuntimeError(f"a worker process imports the script, which calls md.ensemble again; {BELOW}")
            frame = frame.f_back
    return n_workers


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


def _tell_failures(table: EnsembleTable, rows: dict[int, Row]) -> None:
    """Warn of members that have failed.  Raises EnsembleError if all have failed."""
    sentences, of = list(table.failures()), f"{len(table)} members have failed"
    if sentences and len(sentences) == len(table):
        failure = EnsembleError(f"all {of}; the first failure was:\n{sentences[0]}")
        failure.add_note(next(row["traceback"] for row in rows.values() if row["status"] == FAILED))
        raise failure
    if sentences:
        told, n_more = [f"{len(sentences)} of {of}:", *sentences[:TOLD]], len(sentences) - TOLD
        told += [f"and {n_more} more, see the messages in the table"] if n_more > 0 else []
        warnings.warn("\n".join([*told, "The next call tries them again."]), stacklevel=outside_minimd())
