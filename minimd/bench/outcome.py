"""The outcome of a benchmark: as a table for people, as JSON for programs."""

import json
import platform
from collections.abc import Sequence
from math import floor, log10
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

import minimd as md
from minimd.bench.rows import MELT, Row, beside_melt, beside_one_thread, faster_than_peer
from minimd.doctor import available_cores, processor_name, version

NAME = "bench_lj"  # of the files
DIGITS = 3
ALIGN = {str: ":---", float: "---:"}

Ratios = NDArray[np.float64] | None


class Outcome(NamedTuple):
    """Rows of each size, and what they were measured with.

    scene : name.  texts : what the scenes are, in a line each.  packages : whose versions matter.
    """

    scene: str
    texts: Sequence[str]
    repeats: int
    packages: Sequence[str]
    sizes: Sequence[Sequence[Row]]

    def markdown(self) -> str:
        """The tables."""
        table = _melt_table if self.scene == MELT else _scene_table
        head = [
            "# minimd bench lj",
            "",
            *(f"{text}." for text in self.texts),
            f"{machine()['text']}.",
            f"{', '.join(f'{name} {number}' for name, number in self.versions().items())}.",
            "",
            f"Speeds in 10⁶ atom-steps per second, whole runs, lists included, compiling not: median of {self.repeats} turns (least to most).",
            "All engines take turns in one process; ratios are taken turn by turn.",
        ]
        return "\n".join(head + [line for rows in self.sizes for line in table(rows)])

    def versions(self) -> dict[str, str]:
        """Versions of minimd, what it stands on, and the peers that took part."""
        return {"minimd": md.__version__} | {name: version(name) for name in ("numba", "numpy", *self.packages)}

    def json(self) -> str:
        """Everything measured, every turn."""
        sizes = [{"n_atoms": rows[-1].n_atoms, "rows": [_as_mapping(rows, row) for row in rows]} for rows in self.sizes]
        content = {"scene": self.scene, "texts": list(self.texts), "repeats": self.repeats, "machine": machine(), "versions": self.versions()}
        return json.dumps(content | {"sizes": sizes}, indent=2, ensure_ascii=False)

    def write(self, folder: Path) -> None:
        """Write bench_lj.md and bench_lj.json into a folder; files of these names are replaced."""
        (folder / f"{NAME}.md").write_text(self.markdown() + "\n", encoding="utf-8")
        (folder / f"{NAME}.json").write_text(self.json() + "\n", encoding="utf-8")


def machine() -> dict[str, str | int]:
    """The machine: processor, cores that this process may use, platform, Python; and all in one line."""
    processor, cores, system, python = processor_name(), available_cores(), platform.platform(), platform.python_version()
    text = f"{processor} ({platform.machine()}), {cores} cores for this process; {system}; Python {python}"
    return {"text": text, "processor": processor, "cores": cores, "platform": system, "python": python}


def _melt_table(rows: Sequence[Row]) -> list[str]:
    titles = {
        "engine": str,
        "threads": float,
        "precision": str,
        "speed": float,
        "minimd double, same threads, is faster by": float,
        "beside minimd double, 1 thread": float,
    }
    cells = [[*_who(row), _spread(row.speeds / 1e6), _spread(faster_than_peer(rows, row)), _spread(beside_one_thread(rows, row))] for row in rows]
    return ["", f"## {rows[0].n_atoms} atoms", "", *_with_memory(rows, titles, cells)]


def _scene_table(rows: Sequence[Row]) -> list[str]:
    titles = {
        "scene": str,
        "atoms": float,
        "threads": float,
        "precision": str,
        "speed": float,
        "pairs in range per atom": float,
        "10⁶ pairs in range per second": float,
        "speed / melt's": float,
        "the same per pair in range": float,
    }
    cells = []
    for row in rows:
        by_atoms, by_pairs = beside_melt(rows, row) or (None, None)
        pairs = f"{(row.n_pairs or 0.0) / row.n_atoms:.1f}"
        speeds = [_spread(row.speeds / 1e6), pairs, _spread(None if row.pair_speeds is None else row.pair_speeds / 1e6)]
        cells.append([row.scene, str(row.n_atoms), *_who(row)[1:], *speeds, _spread(by_atoms), _spread(by_pairs)])
    return ["", f"## {rows[-1].scene}, {rows[-1].n_atoms} atoms, and the melt", "", *_with_memory(rows, titles, cells)]


def _who(row: Row) -> list[str]:
    return [f"**{row.engine}**" if row.is_minimd else row.engine, str(row.threads), row.precision]


def _spread(values: Ratios) -> str:
    """Median (least to most); nothing for no values, and 1 for a row beside itself."""
    if values is None:
        return ""
    if np.all(values == 1.0):
        return "1"
    digits = max(0, DIGITS - 1 - floor(log10(np.median(values))))
    return f"**{np.median(values):.{digits}f}** ({values.min():.{digits}f} to {values.max():.{digits}f})"


def _with_memory(rows: Sequence[Row], titles: dict[str, type], cells: list[list[str]]) -> list[str]:
    """The lines of a table; with a column for memory, where it was measured."""
    if any(row.bytes_per_atom is not None for row in rows):
        titles = titles | {"bytes per atom": float}
        cells = [[*line, "" if row.bytes_per_atom is None else f"{row.bytes_per_atom:.0f}"] for line, row in zip(cells, rows, strict=True)]
    lines = [list(titles), [ALIGN[kind] for kind in titles.values()], *cells]
    return [f"| {' | '.join(line)} |" for line in lines]


def _as_mapping(rows: Sequence[Row], row: Row) -> dict[str, Any]:
    by_atoms, by_pairs = beside_melt(rows, row) or (None, None)
    return {
        "engine": row.engine,
        "threads": row.threads,
        "precision": row.precision,
        "scene": row.scene,
        "n_atoms": row.n_atoms,
        "atom_steps_per_second": {"median": float(np.median(row.speeds)), "turns": row.speeds.tolist()},
        "minimd_is_faster_by": _summary(faster_than_peer(rows, row)),
        "beside_minimd_one_thread": _summary(beside_one_thread(rows, row)),
        "pairs_in_range": row.n_pairs,
        "beside_melt": _summary(by_atoms),
        "beside_melt_per_pair": _summary(by_pairs),
        "bytes_per_atom": row.bytes_per_atom,
    }


def _summary(ratios: Ratios) -> dict[str, Any] | None:
    return None if ratios is None else {"median": float(np.median(ratios)), "turns": ratios.tolist()}
