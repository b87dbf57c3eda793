"""`minimd bench --history`: the speed of minimd in a few scenes, a line for each commit."""

import csv
import shutil
import subprocess
from datetime import date
from io import StringIO
from pathlib import Path

import numpy as np

import minimd as md
from minimd.bench.outcome import table
from minimd.bench.peers import NO_PEERS, PeersOptions, run_peers
from minimd.core.compiled.machine import processor_name
from minimd.core.console.whole_file import write_whole

WATCHED = PeersOptions(("melt", "chains", "copper", "water"), (10,), (1,), NO_PEERS)
TITLES = {"commit": str, "date": str, "processor": str, **dict.fromkeys(WATCHED.scenes, float)}
HEAD = f"{','.join(TITLES)}\n"
CAPTION = "Median speeds in 10⁶ atom-steps per second, float64, one thread, 3000 to 4000 atoms."


def add_line(file: Path) -> list[str]:
    """Measure minimd, append a line to a CSV file, and return the table in that file as lines of Markdown.
    Raises ValueError if the file is another table."""
    text = file.read_text(encoding="utf-8") if file.exists() else HEAD
    if not text.startswith(HEAD):
        raise ValueError(
            f"--history must name a new file, or a table that begins with {HEAD.strip()}; it is {file}"
        )
    file.parent.mkdir(parents=True, exist_ok=True)
    speeds = [rows[0].speeds for rows in run_peers(WATCHED).sizes]
    line = StringIO()
    figures = [f"{np.median(speed) / 1e6:.3g}" for speed in speeds]
    csv.writer(line, lineterminator="\n").writerow(
        [commit(), date.today(), processor_name(), *figures]
    )
    text += line.getvalue()
    write_whole(file, text)
    return [CAPTION, "", *table(TITLES, [*csv.reader(text.splitlines())][1:])]


def commit() -> str:
    """The commit of the source tree that runs, with a "+" if files of it were changed; the version outside of a
    repository."""
    root = Path(md.__file__).parents[1]
    if not (root / ".git").exists() or shutil.which("git") is None:
        return md.__version__
    command = ["git", "-C", str(root), "describe", "--always", "--exclude=*", "--dirty=+"]
    return (
        subprocess.run(command, capture_output=True, text=True, check=False).stdout.strip()
        or md.__version__
    )
