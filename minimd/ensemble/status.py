"""The state of an ensemble, read from its folder while the ensemble may be running."""

from collections.abc import Iterator
from itertools import islice
from pathlib import Path

import numpy as np

from minimd.ensemble.folder import DESCRIPTION, EnsembleFolder
from minimd.ensemble.notes import SUFFIX, read_note
from minimd.ensemble.table import EnsembleTable, table_of
from minimd.ensemble.work import BEGUN
from minimd.structure.errors import sentence

MOST_TOLD = 10  # members that are listed as running, and as begun


def status(folder: Path) -> tuple[EnsembleTable, list[str]]:
    """The table as it is now, and lines about it.  Raises FileNotFoundError, ValueError for a folder without an ensemble."""
    with EnsembleFolder(folder, writes=False) as opened:
        if opened.asked is None:
            raise FileNotFoundError(f"folder {str(folder)!r} holds no ensemble: there is no {DESCRIPTION} in it")
        table = table_of(opened, opened.asked, len(opened.asked.parameters))
        steps = opened.asked.steps
        noted = _noted(opened)
    lines = str(table).splitlines()
    begun = {index: table["file"][index] for index in np.flatnonzero(table["status"] == BEGUN).tolist()}
    now = {index: told for index in sorted(noted) if (told := read_note(opened.file(index)))}
    lines += _some("running", (f"member {index}: {told}" for index, told in now.items()), len(now))
    stopped = {index: file for index, file in begun.items() if index not in now}
    lines += _some("begun", (f"member {index}: {_progress(file, steps)}" for index, file in stopped.items()), len(stopped))
    return table, lines


def _noted(folder: EnsembleFolder) -> list[int]:
    """The members that have a note."""
    return [int(Path(name).stem) for name in folder.files() if name.endswith(SUFFIX)]


def _some(word: str, told: Iterator[str], n: int) -> list[str]:
    """The first of n lines, each after the word, and how many more there are."""
    lines = [f"{word:<14} {line}" for line in islice(told, MOST_TOLD)]
    return lines + ([f"{'':<14} and {n - MOST_TOLD} more"] if n > MOST_TOLD else [])


def _progress(file: str, steps: int) -> str:
    """The progress of a member in words. A file that is being written cannot be read."""
    from minimd.files.h5md_reader import read_file

    try:
        contents = read_file(file)
        return f"stopped after {contents.step - int(contents.record.step[0])} of {steps} steps"
    except (OSError, ValueError) as error:
        return "running" if "another run is writing it" in str(error) else sentence(error)
