"""Averages of a run, and their standard errors; see structure.statistics."""

from collections.abc import Mapping
from typing import Any

import numpy as np

from minimd.engine.record import Record
from minimd.structure.checks import shown
from minimd.structure.statistics import mean_and_error

Averages = dict[str, tuple[float, float]]  # name: mean, standard error


def averages_of(result: Any) -> Averages:
    """Means and errors of what the function run returned: a Record, or a dict of numbers, of tuples (mean, error) or of series; none for None.

    Raises TypeError, ValueError for anything else.
    """
    if result is None:
        return {}
    if isinstance(result, Record):
        return {name: mean_and_error(column) for name, column in result.columns().items() if name not in ("step", "time")}
    if not isinstance(result, Mapping):
        raise TypeError(f"run must return a Record, a dict of numbers, of tuples (mean, error) or of series, or None; it returned {shown(result)}")
    return {_checked_name(name): _of_value(name, value) for name, value in result.items()}


def _checked_name(name: Any) -> str:
    if not isinstance(name, str) or not name:
        raise TypeError(f"the names in the dict that run returns must be texts that are not empty; one is {shown(name)}")
    return name


def _of_value(name: str, value: Any) -> tuple[float, float]:
    array = np.asarray(value)
    if array.dtype.kind not in "biuf" or array.ndim > 1:
        raise TypeError(f"the values in the dict that run returns must be numbers, tuples (mean, error), or series; {name} = {shown(value)}")
    if array.ndim == 0:
        return float(array), np.nan
    return (float(array[0]), float(array[1])) if isinstance(value, tuple) and len(value) == 2 else mean_and_error(array)
