"""Averages of a run, and their standard errors by blocks."""

from collections.abc import Mapping
from typing import Any

import numpy as np

from minimd.diagnosis.report import BLOCKS, FEW, block_means
from minimd.engine.record import Record
from minimd.structure.checks import shown

Averages = dict[str, tuple[float, float]]  # name: mean, standard error


def mean_and_error(series: Any) -> tuple[float, float]:
    """Mean of a series, and the standard error of the mean from the scatter of 20 blocks: σ(block means) / √20.

    The error is right where a block is much longer than the correlation time, and too small where it is not. With fewer than 20 entries
    each is a block; with fewer than 4 the error is NaN.
    H. Flyvbjerg, H. G. Petersen, J. Chem. Phys. 91, 461 (1989).
    """
    values = np.asarray(series, dtype=np.float64)
    n = min(BLOCKS, len(values))
    if n < FEW:
        return float(values.mean()) if n else np.nan, np.nan
    return float(values.mean()), float(block_means(values, n).std(ddof=1) / np.sqrt(n))


def averages_of(result: Any) -> Averages:
    """Means and errors of what a run has returned: a Record, or names with numbers, pairs of mean and error, or series; nothing of None.

    Raises TypeError, ValueError for anything else.
    """
    if result is None:
        return {}
    if isinstance(result, Record):
        return {name: mean_and_error(column) for name, column in result.columns().items() if name not in ("step", "time")}
    if not isinstance(result, Mapping):
        raise TypeError(f"run must return a record, a dict of numbers or of series, or None; it has returned {shown(result)}")
    return {_checked_name(name): _of_value(name, value) for name, value in result.items()}


def _checked_name(name: Any) -> str:
    if not isinstance(name, str) or not name:
        raise TypeError(f"the names of what run returns must be texts; one is {shown(name)}")
    return name


def _of_value(name: str, value: Any) -> tuple[float, float]:
    array = np.asarray(value)
    if array.dtype.kind not in "biuf" or array.ndim > 1:
        raise TypeError(f"what run returns must be numbers, pairs of mean and error, or series; {name} = {shown(value)}")
    if array.ndim == 0:
        return float(array), np.nan
    return (float(array[0]), float(array[1])) if isinstance(value, tuple) and len(value) == 2 else mean_and_error(array)
