"""Faults of a step that the expansion in dt does not show: velocities cut off at a limit, paths whose rows are all the same array."""

from __future__ import annotations

import numpy as np

from minimd.grade.calling import StudentStep
from minimd.grade.problems import Problem

SHORT = 1e-7  # a time step so short that nothing should change
CHANGED = 1e-4
FASTER = (1.0, 30.0)  # factors by which velocities are multiplied to find a limit


def clipped(step: StudentStep, where: Problem) -> list[str]:
    """A limit of the components of velocities, or of speeds: larger values are reduced to it, smaller ones do not change."""
    if where.x.ndim == 0:
        return []
    for faster in FASTER:
        v = faster * where.v
        _, new = step(where, where.x, v, SHORT)
        for what, old, now in (("components of velocities", np.abs(v), np.abs(new)), ("speeds", _speeds(v), _speeds(new))):
            cut = np.abs(now - old) > CHANGED * faster
            if cut.sum() < 2 or (cut.all() and faster == 1.0):
                continue
            limit = float(now[cut].mean())
            if np.ptp(now[cut]) < CHANGED and old[cut].min() > limit and (cut.all() or old[~cut].max() < limit + CHANGED * faster):
                return [f"{what} above {limit:.4g} are cut off: the velocities are limited (clipped) in the step"]
    return []


def _speeds(v: np.ndarray) -> np.ndarray:
    return np.asarray(np.linalg.norm(v.reshape(len(v), -1), axis=1))


def same_rows(step: StudentStep, where: Problem) -> list[str]:
    """A path whose rows are all alike, because the same array was appended again and again."""
    if "steps" not in step.manner.roles:
        return []
    step.n_steps = 3
    try:
        step(where, where.x, where.v, 0.1)
    finally:
        step.n_steps = 1
    for part in step.path[:1]:
        if len(part) > 2 and np.array_equal(part[0], part[-1]) and np.array_equal(part[1], part[-1]):
            return ["all rows of the path are alike: the array is changed in place after it was appended. Append a copy, as in xs.append(x.copy())"]
    return []
