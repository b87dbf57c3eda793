"""Tables of tabulated laws in scenes: files of two columns, and the same numbers as a part of the scene.

A scene that is stored in the file of its run goes on without other files: [tables."argon.dat"] at its end holds what argon.dat held.
"""

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, NamedTuple

import numpy as np
from pydantic import Field, FiniteFloat

from minimd.potentials.tabulated import FEWEST
from minimd.scene.section import KEY_UNITS, Dimension, Section
from minimd.structure.quiet import quiet

COLUMNS = 2
Column = Annotated[list[FiniteFloat], Field(min_length=FEWEST)]


class Numbers(NamedTuple):
    """r : distances [length].  u : energies [energy], as many."""

    r: list[float]
    u: list[float]


class TableSection(Section):
    """[tables.NAME]: what a file of this name would hold."""

    r: Annotated[Column, Dimension("length")]
    u: Annotated[Column, Dimension("energy")]


def read_table(path: Path) -> Numbers:
    """The two columns of a text file, in the units of the scene; '#' begins a comment.  Raises ValueError, naming the file, for anything else."""
    try:
        with quiet():  # NumPy warns of an empty file, which is refused
            columns = np.loadtxt(path, ndmin=2, encoding="utf-8")
    except FileNotFoundError:
        raise ValueError(f"table {str(path)!r} does not exist; its place is that of the scene file") from None
    except OSError as error:
        raise ValueError(f"table {str(path)!r} cannot be read: {error.strerror or error}") from None
    except ValueError as error:
        raise ValueError(f"table {str(path)!r} must hold two numbers on each line, r and u: {error}") from None
    if columns.shape[1:] != (COLUMNS,) or not len(columns):
        raise ValueError(f"table {str(path)!r} must hold two numbers on each line, r and u; it has {len(columns)} lines of {columns.shape[1]}")
    return Numbers(*columns.T.tolist())


def as_sections(tables: Mapping[str, Numbers], units: str) -> str:
    """The text that gives a scene these tables, to the last bit.  units : of the scene, "ASE" or "LJ"."""
    (length, *_), (*_, energy) = KEY_UNITS[units]["length"], KEY_UNITS[units]["energy"]  # the last is the engine's own, of size 1
    lines = [f"\n[tables.{json.dumps(name, ensure_ascii=False)}]\nr{length} = {one.r}\nu{energy} = {one.u}\n" for name, one in tables.items()]
    return "".join(lines)
