"""What is done in the folder of an ensemble, seen from outside; an ensemble may be running there."""

from contextlib import suppress
from pathlib import Path

from minimd.ensemble.folder import DESCRIPTION, EnsembleFolder
from minimd.ensemble.table import EnsembleTable, table_of
from minimd.ensemble.work import BEGUN

MOST_TOLD = 10  # members in the middle of their runs


def status(folder: Path) -> tuple[EnsembleTable, list[str]]:
    """The table as it is now, and lines about it.  Raises FileNotFoundError, ValueError for a folder without an ensemble."""
    with EnsembleFolder(folder, writes=False) as opened:
        if opened.asked is None:
            raise FileNotFoundError(f"folder {str(folder)!r} holds no ensemble: there is no {DESCRIPTION} in it")
        table = table_of(opened, opened.asked, len(opened.asked.parameters))
        steps = opened.asked.steps
    lines = str(table).splitlines()
    begun = [index for index, word in enumerate(table["status"]) if word == BEGUN]
    for index in begun[:MOST_TOLD]:
        lines.append(f"{'begun':<14} member {index}: step {_step(table['file'][index])} of {steps}")
    return table, lines + ([f"{'':<14} and {len(begun) - MOST_TOLD} more"] if len(begun) > MOST_TOLD else [])


def _step(file: str) -> str:
    """The step of the restart in a file."""
    from minimd.files.h5md_reader import read_file

    with suppress(OSError, ValueError):
        return str(read_file(file).step)
    return "?"
