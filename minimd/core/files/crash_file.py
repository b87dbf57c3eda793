"""The file that a failed run leaves: an H5MD file with the last good state, an earlier state,
and all that a replay needs.

frames                 the earlier state and the last good one, with forces and observables;
                       the restart is the last good state
minimd/crash_report    findings, and the shift of the noise, as JSON
    start              the earlier state to the last bit
"""

import json
import os
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import asdict
from itertools import chain, count
from pathlib import Path
from shlex import quote
from typing import Any, NamedTuple, get_args, get_type_hints

import numpy as np

from minimd.core.console.whole_file import temporary
from minimd.core.console.words import printable, shown
from minimd.core.diagnosis.contacts import Contact
from minimd.core.diagnosis.crash_report import CrashReport
from minimd.core.diagnosis.judge import RUNAWAY
from minimd.core.diagnosis.run_guard import RunGuard
from minimd.core.engine.observation import observe
from minimd.core.engine.snapshot import Snapshot
from minimd.core.files.trajectory import Paths, named_files
from minimd.core.neighbors.queries import ClosestPair
from minimd.core.structure.checks import COUNTS, checked_path
from minimd.core.structure.errors import ConstraintError, NonFiniteError

SUFFIX = ".crash.h5md"
REPORT = "minimd/crash_report"
ATOMS = ("first", "second", "pushed", "fastest")  # in findings, by index


class CrashFile(NamedTuple):
    """The contents of a crash file.
    findings : CrashReport.
    run : H5MDContents, with the system in the earlier state.
    start : that state.
    noise_shift : of the engine.
    judgment : of the run guard."""

    findings: CrashReport
    run: Any
    start: Snapshot
    noise_shift: int
    judgment: tuple[dict[str, float] | None, float]


def crash_file_place(crash_report: Any, trajectories: Paths) -> Path | None:
    """Where a run leaves its crash file: the path given, or for True beside its first trajectory; None if there is no
    such place.
    Raises ValueError for the path of a trajectory, which the crash file would replace."""
    files = named_files("trajectory", trajectories)
    if isinstance(crash_report, bool | None):
        return files[0].with_suffix(SUFFIX) if crash_report and files else None
    place = checked_path("crash_report", crash_report)
    if place.resolve() in [file.resolve() for file in files]:
        raise ValueError(
            f"crash_report must be a file of its own; {str(crash_report)!r} is a trajectory of the run: "
            "choose another name"
        )
    return place


@contextmanager
def crash_file_left(path: Path | None, guard: RunGuard, overwrite: bool) -> Iterator[None]:
    """If a run fails, write its crash file and name it in the error; unless overwrite,
    an existing file is kept and the new one gets a number."""
    try:
        yield
    except (NonFiniteError, ConstraintError) as error:
        if path is not None and error.crash_report is not None:
            file = path if overwrite else _free_name(path)
            try:
                write_crash_report(file, guard, error.crash_report)
                error.file = file
                command = "minimd.replay(file, potentials)"
                if guard.engine.notes["scene"]:
                    command = f"minimd replay {quote(str(file))}"
                remark = (
                    f"Crash report in {file}; to see the last steps again: {command}; "
                    f"in the browser: minimd view {file}"
                )
            except Exception as reason:  # of any kind: the error of the run itself must be raised
                remark = f"No crash report was written: {reason}"

            error.args = (f"{error}. {remark}",)
        raise


def _free_name(path: Path) -> Path:
    """The path, or if it exists, the path with the first number of a file that does not."""
    suffix = SUFFIX if path.name.endswith(SUFFIX) else path.suffix
    stem = path.name.removesuffix(suffix)
    numbered = (path.with_name(f"{stem}-{number}{suffix}") for number in count(2))
    return next(file for file in chain([path], numbered) if not os.path.lexists(file))


def write_crash_report(path: Path, guard: RunGuard, findings: CrashReport) -> None:
    """Write the crash file of a run that has just failed; its engine is in the last good state, before and afterwards.
    Raises OSError if it cannot be written."""
    from minimd.core.files.claim import Claim  # h5py is slow to load
    from minimd.core.files.h5_items import TEXT, Item
    from minimd.core.files.h5md_digest import checked, flattened
    from minimd.core.files.h5md_writer import H5MDWriter

    engine = guard.engine
    last = engine.checkpoint()
    start = guard.failed_from or last.state
    first, growth = guard.judgment
    energies = {name: value for name, value in (first or {}).items() if name.endswith("energy")}
    simulation = {"noise_shift": engine.noise_shift, "first": energies or None, "growth": growth}
    texts = {
        "findings": json.dumps(asdict(findings)),
        "words": str(findings),
        "simulation": json.dumps(simulation),
    }

    part = temporary(path)  # so that no incomplete file has the final name
    claim = Claim(part, overwrite=True)
    every = max(1, last.state.step - start.step)
    try:
        if claim.path.name != part.name:
            raise OSError(f"{str(part)!r} is a link to another file; remove it")
        writer = H5MDWriter(claim, engine, store_forces=True, every=every, n_frames=2)
        try:
            for name, text in texts.items():
                writer.description[f"{REPORT}/{name}"] = Item(data=np.array(text.encode(), TEXT))
            writer.description |= checked(f"{REPORT}/start", *flattened(last._replace(state=start)))

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
    """Whether a file is a crash file.
    Raises FileNotFoundError, OSError, ValueError as h5md_reader.opened."""
    from minimd.core.files.h5md_reader import opened

    with opened(path) as h5:
        return REPORT in h5


def read_crash_report(path: str | Path) -> CrashFile:
    """The contents of a crash file.
    Raises FileNotFoundError, OSError, ValueError as read_file, and ValueError for another file of minimd."""
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
            simulation, values = (
                json.loads(group[name].asstr()[()], object_hook=_printable)
                for name in ("simulation", "findings")
            )
            start = unflattened(*read_group(group["start"])).state
            system.positions = start.positions
            system.velocities = start.velocities
            values["pair"] = values["pair"] and Contact(**values["pair"])
            values["closest"] = values["closest"] and ClosestPair(*values["closest"])
            findings = CrashReport(**values)
            for part in (findings, findings.pair, findings.closest):
                _check_types(part, len(system))

    # older files have no judgment
    judgment = (simulation.get("first"), simulation.get("growth", RUNAWAY))
    return CrashFile(findings, contents, start, simulation["noise_shift"], judgment)


def _printable(values: dict[str, Any]) -> dict[str, Any]:
    return {
        name: printable(value) if isinstance(value, str) else value
        for name, value in values.items()
    }


def _check_types(part: Any, n_atoms: int) -> None:
    """Raise ValueError unless all values of a part of the findings are of the types that it declares,
    and its atoms are among n_atoms."""
    for name, declared in get_type_hints(type(part)).items() if part else ():
        value = getattr(part, name)
        kinds = get_args(declared) or (declared,)
        is_number = type(value) is int
        is_of_kind = type(value) in kinds or (is_number and float in kinds)
        least, limit = (0, n_atoms) if name in ATOMS else (-COUNTS, COUNTS)
        if not is_of_kind or (is_number and not least <= value < limit):
            raise ValueError(f"its findings have {name} = {shown(value)}")
