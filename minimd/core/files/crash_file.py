"""The file that a failed run leaves: an H5MD file with the last good state, an earlier state,
and all that a replay needs.

frames                 the earlier state and the last good one, with forces and observables;
                       the restart is the last good state
minimd/crash_report    findings, and the shift of the noise, as JSON
    start              the earlier state to the last bit
"""

import json
import os
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import asdict
from itertools import chain, count
from pathlib import Path
from shlex import quote
from typing import Any, NamedTuple, get_args, get_type_hints

import numpy as np

from minimd.core.console.whole_file import temporary
from minimd.core.console.words import printable, shown
from minimd.core.diagnosis.crash_report import CrashReport
from minimd.core.diagnosis.judge import RUNAWAY
from minimd.core.diagnosis.run_guard import RunGuard
from minimd.core.engine.engine import Snapshot
from minimd.core.engine.observation import observe
from minimd.core.files.trajectory import named_files
from minimd.core.forces.contacts import Contact
from minimd.core.neighbors.queries import ClosestPair
from minimd.core.structure.checks import COUNTS
from minimd.core.structure.errors import ConstraintError, NonFiniteError

SUFFIX = ".crash.h5md"
REPORT = "minimd/crash_report"
ATOMS = ("first", "second", "pushed", "fastest")  # in findings, by index


class CrashFile(NamedTuple):
    """The contents of a crash file.  findings : CrashReport.  run : H5MDContents, with the system in the earlier state.
    start : that state.  noise_shift : of the engine.  judgment : of the run guard."""

    findings: CrashReport
    run: Any
    start: Snapshot
    noise_shift: int
    judgment: tuple[dict[str, float] | None, float]


def crash_file_place(
    crash_report: Any, trajectories: str | Path | Sequence[str | Path]
) -> Path | None:
    """Where a run leaves its crash file: the path given, or for True beside its first trajectory; None if there is no
    such place.  Raises ValueError for the path of a trajectory, which the crash file would replace."""
    several = named_files("trajectory", trajectories)
    if isinstance(crash_report, bool | None):
        return several[0].with_suffix(SUFFIX) if crash_report and several else None
    [place] = named_files("crash_report", [crash_report])
    if place.resolve() in [file.resolve() for file in several]:
        words = f"{str(crash_report)!r} is a trajectory of the run: choose another name"
        raise ValueError(f"crash_report must be a file of its own; {words}")
    return place


@contextmanager
def crash_file_left(path: Path | None, guard: RunGuard, overwrite: bool) -> Iterator[None]:
    """If a run fails, write its crash file and name it in the error; unless overwrite,
    an existing file is kept and the new one gets a number."""
    try:
        yield
    except (NonFiniteError, ConstraintError) as error:
        if path is not None and error.crash_report is not None:
            suffix = SUFFIX if path.name.endswith(SUFFIX) else path.suffix
            numbered = (
                path.with_name(f"{path.name.removesuffix(suffix)}-{number}{suffix}")
                for number in count(2)
            )
            file = next(
                free for free in chain([path], numbered) if overwrite or not os.path.lexists(free)
            )
            try:
                write_crash_report(file, guard, error.crash_report)
                error.file = file
                again = (
                    f"minimd replay {quote(str(file))}"
                    if guard.engine.notes["scene"]
                    else "minimd.replay(file, potentials)"
                )
                look = f"to see the last steps again: {again}; in the browser: minimd view {file}"
                hint = f"Crash report in {file}; {look}"
            except Exception as reason:  # of any kind: the error of the run itself must be raised
                hint = f"No crash report was written: {reason}"
            error.args = (f"{error}. {hint}",)
        raise


def write_crash_report(path: Path, guard: RunGuard, findings: CrashReport) -> None:
    """Write the crash file of a run that has just failed; its engine is in the last good state, before and afterwards.
    Raises OSError if it cannot be written."""
    from minimd.core.files.claim import Claim  # h5py is slow to load
    from minimd.core.files.h5_items import TEXT, Item
    from minimd.core.files.h5md_digest import checked, flattened
    from minimd.core.files.h5md_writer import H5MDWriter

    engine = guard.engine
    last = guard.engine.checkpoint()
    start = guard.failed_from or last.state
    first, growth = guard.judgment
    energies = {name: value for name, value in (first or {}).items() if name.endswith("energy")}
    known = {"noise_shift": engine.noise_shift, "first": energies or None, "growth": growth}
    texts = {
        "findings": json.dumps(asdict(findings)),
        "words": str(findings),
        "simulation": json.dumps(known),
    }
    told = {
        f"{REPORT}/{name}": Item(data=np.array(text.encode(), TEXT)) for name, text in texts.items()
    }

    part = temporary(path)  # so that no incomplete file has the final name
    claim = Claim(part, overwrite=True)
    every = max(1, last.state.step - start.step)
    try:
        if claim.path.name != part.name:
            raise OSError(f"{str(part)!r} is a link to another file; remove it")
        writer = H5MDWriter(claim, engine, store_forces=True, every=every, n_frames=2)
        try:
            writer.description |= told | checked(
                f"{REPORT}/start", *flattened(last._replace(state=start))
            )
            for snapshot in (start, last.state):
                engine.restore(snapshot)
                engine.enter()
                writer.write(observe(engine))
        finally:
            engine.go_on_from(last)
            writer.close()
        os.replace(part, path)
    finally:
        claim.release()
        part.unlink(missing_ok=True)


def is_crash_file(path: str | Path) -> bool:
    """Whether a file is a crash file.  Raises FileNotFoundError, OSError, ValueError as h5md_reader.opened."""
    from minimd.core.files.h5md_reader import opened

    with opened(path) as h5:
        return REPORT in h5


def read_crash_report(path: str | Path) -> CrashFile:
    """The contents of a crash file.  Raises FileNotFoundError, OSError, ValueError as read_file,
    and ValueError for another file of minimd."""
    from minimd.core.files.h5md_digest import read_group, unflattened
    from minimd.core.files.h5md_reader import damage_told, opened, read_file

    contents = read_file(path)
    with opened(path) as h5:
        if REPORT not in h5:
            raise ValueError(
                f"file {str(path)!r} holds no crash report; give the {SUFFIX} file of a run that failed"
            )
        group = h5[REPORT]
        system = contents.system
        with damage_told(path):
            texts = (group[name].asstr()[()] for name in ("simulation", "findings"))
            told, found = (json.loads(text, object_hook=_printable) for text in texts)
            start = unflattened(*read_group(group["start"])).state
            system.positions = start.positions
            system.velocities = start.velocities
            pair = found["pair"] and Contact(**found["pair"])
            closest = found["closest"] and ClosestPair(*found["closest"])
            findings = CrashReport(**found | {"pair": pair, "closest": closest})
            for part in (findings, pair, closest):
                _check_types(part, len(system))
    judgment = told.get("first"), told.get("growth", RUNAWAY)  # older files have none
    return CrashFile(findings, contents, start, told["noise_shift"], judgment)


def _printable(found: dict[str, Any]) -> dict[str, Any]:
    return {
        name: printable(value) if isinstance(value, str) else value for name, value in found.items()
    }


def _check_types(part: Any, n_atoms: int) -> None:
    """Raise ValueError unless all values of a part of the findings are of the types that it declares,
    and its atoms are among n_atoms."""
    for name, declared in get_type_hints(type(part)).items() if part else ():
        value = getattr(part, name)
        kinds = get_args(declared) or (declared,)
        least, limit = (0, n_atoms) if name in ATOMS else (-COUNTS, COUNTS)
        is_of_kind = type(value) in kinds or (type(value) is int and float in kinds)
        if not is_of_kind or (type(value) is int and not least <= value < limit):
            raise ValueError(f"its findings have {name} = {shown(value)}")
