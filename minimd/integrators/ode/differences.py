"""Derivatives by finite differences."""

from collections.abc import Callable

import numpy as np

from minimd.compiled.machine import EPS
from minimd.integrators.method import Array

CENTRAL = EPS ** (1.0 / 3.0)  # step of central differences relative to a variable: truncation and rounding are then alike, some 1e-11
FORWARD = EPS**0.5  # the same of forward differences: some 1e-8
LEAST = 1e-3  # smallest size of a variable for its step, relative to the largest one


def central_differences(function: Callable[[Array], Array], x: Array, step: float = CENTRAL, size: float = 0.0) -> Array:
    """∂function/∂x, one column per variable.

    step : relative to each variable; wide for noisy functions.  size : of the largest variable, where x may be smaller by chance.
    """
    steps = step * np.maximum(np.abs(x), LEAST * (max(np.abs(x).max(), size) or 1.0))
    columns = []
    for k in range(x.size):
        ahead, behind = x.copy(), x.copy()
        ahead[k] += steps[k]
        behind[k] -= steps[k]
        columns.append((function(ahead) - function(behind)) / (ahead[k] - behind[k]))
    return np.stack(columns, axis=-1)


def forward_differences(function: Callable[[Array], Array], x: Array, at_x: Array) -> Array:
    """∂function/∂x, one column per variable: half the evaluations of central differences, and half the digits.  at_x : function(x)."""
    jacobian = np.empty((at_x.size, x.size))
    steps = FORWARD * np.maximum(np.abs(x), LEAST * (np.abs(x).max() or 1.0))
    for k in range(x.size):
        moved = x.copy()
        moved[k] += steps[k]
        jacobian[:, k] = (function(moved) - at_x) / (moved[k] - x[k])
    return jacobian
