"""Tables of tabulated laws in scenes: files with two columns, or the same numbers in the scene itself.

A scene that is stored in the file of its run needs no other files:
[tables."argon.dat"] at its end holds the numbers of argon.dat.
"""

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, NamedTuple

import numpy as np
from pydantic import Field, FiniteFloat

from minimd.console.quiet import quiet
from minimd.document.section import KEY_UNITS, Dimension, Section
from minimd.potentials.tabulated import FEWEST

COLUMNS = 2
Column = Annotated[list[FiniteFloat], Field(min_length=FEWEST)]


class Numbers(NamedTuple):
    """r : distances [length].  u : energies [energy], one for each distance."""

    r: list[float]
    u: list[float]


class TableSection(Section):
    """[tables.NAME]: a table in the scene, in place of a file with this name."""

    r: Annotated[Column, Dimension("length")]
    u: Annotated[Column, Dimension("energy")]


def read_table(path: Path) -> Numbers:
    """The two columns of a text file, in the units of the scene; '#' begins a comment.  Raises ValueError,
    with the path, for anything else."""
    if path.exists() and not path.is_file():
        raise ValueError(f"table {str(path)!r} is not a regular file")
    try:
        with quiet():  # NumPy warns of an empty file, which is refused
            columns = np.loadtxt(path, ndmin=2, encoding="utf-8")
    except FileNotFoundError:
        raise ValueError(f"table {str(path)!r} does not exist; its path is taken relative to the scene file") from None
    except OSError as error:
        raise ValueError(f"table {str(path)!r} cannot be read: {error.strerror or error}") from None
    except ValueError as error:
        raise ValueError(f"table {str(path)!r} must hold two numbers on each line, r and u: {error}") from None
    if columns.shape[1:] != (COLUMNS,) or not len(columns):
        raise ValueError(
            f"table {str(path)!r} must hold two numbers on each line, r and u; it has {len(columns)} lines of "
            f"{columns.shape[1]}"
        )
    return Numbers(*columns.T.tolist())


def as_sections(tables: Mapping[str, Numbers], units: str) -> str:
    """The text that adds these tables to a scene, to the last bit.  units : of the scene, "ASE" or "LJ"."""
    (length, *_), (*_, energy) = (
        KEY_UNITS[units]["length"],
        KEY_UNITS[units]["energy"],
    )  # the units of the engine, of size 1: the first of lengths, the last of energies
    lines = [
        f"\n[tables.{json.dumps(name, ensure_ascii=False)}]\nr{length} = {one.r}\nu{energy} = {one.u}\n"
        for name, one in tables.items()
    ]
    return "".join(lines)
