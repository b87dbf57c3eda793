"""Temperatures and pressures of baths that change during a run."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any

import numpy as np

from minimd.core.compiled.kernels import scalar
from minimd.core.console.words import shown
from minimd.core.structure.arrays import Array
from minimd.core.structure.checks import checked_count, checked_number

__all__ = ["Ramp"]

LAST_STEP = 2**53  # steps are float64 in kernels


class Ramp(tuple[tuple[int, float], ...]):
    """A temperature or a pressure that changes with the number of the step: linear from each of its points to the next,
    constant before the first and after the last. It is the tuple of these points, each a step and a value.

        md.LangevinBAOAB(0.005, md.Ramp(0.2, 1.2, 100_000), friction=1.0, seed=1)     0.2 at step 0, 1.2 at step 100 000
        md.Ramp.through({0: 300.0, 10_000: 300.0, 60_000: 20.0})                      constant, then cooled

    A bath takes the value at the number of the step that it makes. A resumed run goes on at the value of its step, and
    equilibrations, whose steps come before step 0, have the first one. A function f of time is a ramp through
    `{n: f(n * timestep) for n in range(0, last + 1, 100)}`.

    Parameters
    ----------
    start, stop : values, in the unit of what they are given for.
    steps : number of steps from the first value to the last, at least 1.
    first : the step at which it begins.

    Raises
    ------
    ValueError : for values that are not finite, or steps that are not whole numbers in ascending order.
    """

    def __new__(cls, start: float, stop: float, steps: int, first: int = 0) -> Ramp:
        """See Ramp."""
        first = checked_count("first", first, 0)
        steps = checked_count("steps", steps)
        return cls.through({first: start, first + steps: stop})

    def __reduce__(self) -> tuple[Any, ...]:
        return Ramp.through, (tuple(self),)

    @classmethod
    def through(cls, points: Mapping[int, float] | Iterable[Any]) -> Ramp:
        """The ramp through points: values by their steps, or pairs of step and value."""
        pairs = list(points.items() if isinstance(points, Mapping) else points)
        is_right = bool(pairs) and all(
            isinstance(each, list | tuple) and len(each) == 2 for each in pairs
        )
        if not is_right:
            raise ValueError(
                "points of a ramp must be pairs of a step and a value, such as {0: 20.0, 1000: 60.0}; "
                f"points = {shown(points)}"
            )
        checked = [
            (
                checked_count("step of a ramp", step, 0, LAST_STEP),
                checked_number("value of a ramp", value),
            )
            for step, value in pairs
        ]
        steps = [step for step, _ in checked]
        if sorted(set(steps)) != steps:
            raise ValueError(f"steps of a ramp must ascend; they are {shown(steps)}")
        return tuple.__new__(cls, checked)

    def __repr__(self) -> str:
        if len(self) == 2:
            (first, start), (last, stop) = self
            return f"Ramp({start!r}, {stop!r}, {last - first}{f', {first}' if first else ''})"
        return f"Ramp.through({dict(self)!r})"

    def at(self, step: int) -> float:
        """The value at a step."""
        steps, values = zip(*self, strict=True)
        return float(np.interp(step, steps, values))

    def changes_after(self, step: int) -> bool:
        """Whether the value will be another one later."""
        later = [value for n, value in self if n > step]
        return any(value != self.at(step) for value in later)


Level = float | Ramp


def checked_level(name: str, value: Any, demand: str = "finite and not negative") -> Level:
    """A number, or a ramp of numbers; also one that was stored as a list.
    demand : see checked_number."""
    if not isinstance(value, Ramp | list):
        if isinstance(value, tuple):
            raise ValueError(
                f"{name} must be a number or a ramp, such as md.Ramp(20, 60, 10_000), from 20 to 60 in 10 000 steps; "
                f"{name} = {shown(value)}"
            )
        return checked_number(name, value, demand)
    ramp = Ramp.through(value)
    for _, level in ramp:
        checked_number(f"each value of the ramp of {name}", level, demand)
    return ramp


def level_at(level: Any, step: int) -> Any:
    """The value of a number or a ramp at a step; None of None."""
    return level.at(step) if isinstance(level, Ramp) else level


def points_of(level: Level, unit: float) -> Array:
    """What value_at takes, (K, 2): steps, and values times a unit."""
    points = level if isinstance(level, Ramp) else [(0, level)]
    return np.array([(step, unit * value) for step, value in points])


@scalar
def value_at(points, step):
    """The value at a step, from points (K, 2)."""
    last = points.shape[0] - 1
    k = 0
    while k < last and points[k + 1, 0] <= step:
        k += 1
    if k == last or step <= points[k, 0]:
        return points[k, 1]
    fraction = (step - points[k, 0]) / (points[k + 1, 0] - points[k, 0])
    return points[k, 1] + fraction * (points[k + 1, 1] - points[k, 1])
