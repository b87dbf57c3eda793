"""What is done in the folder of an ensemble, seen from outside; an ensemble may be running there."""

from pathlib import Path

from minimd.ensemble.folder import DESCRIPTION, EnsembleFolder
from minimd.ensemble.table import EnsembleTable, table_of
from minimd.ensemble.work import BEGUN
from minimd.structure.errors import sentence

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
        lines.append(f"{'begun':<14} member {index}: {_progress(table['file'][index], steps)}")
    return table, lines + ([f"{'':<14} and {len(begun) - MOST_TOLD} more"] if len(begun) > MOST_TOLD else [])


def _progress(file: str, steps: int) -> str:
    """How far a member is, in words. A file that is being written cannot be read."""
    from minimd.files.h5md_reader import read_file

    try:
        contents = read_file(file)
        return f"stopped after {contents.step - int(contents.record.step[0])} of {steps} steps"
    except (OSError, ValueError) as error:
        return "running" if "another run is writing it" in str(error) else sentence(error)
