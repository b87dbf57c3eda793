"""How a student's force function is called, and its kind: forces on all atoms, a law of the distance,
or the force of one pair.

    force(positions)                 (N, 3) -> (N, 3), or with the energy: (F, U), (U, F)          forces
    force(positions, box, cutoff)    the same, with an edge and a cutoff                            forces
    force(r), law(r2)                numbers -> numbers, or (u, f)                                  law of the distance
    force(rij), force(ri, rj)        (3,) -> (3,)                                                  force of a pair

The kind follows from the names of the parameters, and from what the function does with arrays:
a law treats each element separately.
"""

from __future__ import annotations

import inspect
import re
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
KINDS = ("forces", "law", "pair")
OPTIONS = {
    "box": r"^(l|box\w*|cell|lbox|edge|size|side|length|l_?box|periodic)$",
    "cutoff": r"^(rc|r_c|r_?cut\w*|cut\w*)$",
    "epsilon": r"^(eps|epsilon|ε|depth)$",
    "sigma": r"^(sig|sigma|σ|s)$",
    "n": r"^(n|n_?atoms|n_?particles|natoms|num\w*)$",
}
SQUARED = r"^(r2|rsq|r_?sq\w*|d2|dist2|r_squared|rr)$"
DISTANCE = r"^(r|d|dist\w*|rij|r_ij|s)$"
SEPARATION = r"^(rij|r_ij|dr|d|dx|rvec|r_vec|vec\w*|delta|disp\w*|sep\w*|r12|r)$"
ONE_OF_TWO = r"^(r|x|q|p|pos\w*|atom|vec)?_?(i|j|1|2|a|b)$"
START = 1.1  # σ: the distance in trial calls


def option_of(name: str) -> str:
    """The option that a parameter with this name stands for; empty if there is none."""
    return next((option for option, pattern in OPTIONS.items() if re.search(pattern, name.lower())), "")


class StudentForce:
    """A student's force function, called in the manner that works.

    kind : one of KINDS.  is_squared : whether the law takes r².  has_energy : whether it also returns an energy.
    options : values for the parameters other than the positions.  takes_box : whether one of them is the cell.
    """

    def __init__(
        self, function: Callable[..., Any], options: dict[str, Any], kind: str | None, positions: Array | None
    ) -> None:
        self.function, self.name = function, getattr(function, "__name__", "force")
        try:
            parameters = list(inspect.signature(function).parameters.values())
        except (TypeError, ValueError):
            raise TypeError(f"forces must be a function, such as forces(positions); got {function!r}") from None
        needed = [
            one.name
            for one in parameters
            if one.default is one.empty and one.kind in (one.POSITIONAL_ONLY, one.POSITIONAL_OR_KEYWORD)
        ]
        optional = [one.name for one in parameters if one.default is not one.empty]
        if not needed:
            raise TypeError(
                f"{self.name} has no parameter for the positions; a force function is called as forces(positions)"
            )
        if needed[0] == "self":
            raise TypeError(
                f"{self.name} is a method without its object: pass the method of an object, as in "
                f"md.grade(Model().{self.name})"
            )
        self.names, self.defaults = (
            needed,
            {one.name: one.default for one in parameters if one.default is not one.empty},
        )
        self.is_squared = bool(re.search(SQUARED, needed[0].lower()))
        may_be_pair = len(needed) > 1 and not self.is_squared and kind != "law"
        self.is_of_two = may_be_pair and all(re.search(ONE_OF_TWO, name.lower()) for name in needed[:2])
        self.extra = [option_of(name) for name in needed[1 + self.is_of_two :]]
        if unknown := [
            name for name, option in zip(needed[1 + self.is_of_two :], self.extra, strict=True) if option not in options
        ]:
            raise TypeError(f"{self.name} takes ({', '.join(needed)}), and the meaning of {unknown[0]} is not known; "
                            f"pass a function of positions only, "
                            f"such as lambda x: {self.name}(x, …), or pass cell= and cutoff=")  # fmt: skip
        named = {
            one: option_of(one) for one in optional if option_of(one) in options and option_of(one) in ("box", "cutoff")
        }
        self.options, self.named = (
            options,
            {name: options[option] for name, option in named.items() if options[f"{option} given"]},
        )
        self.takes_box = "box" in self.extra or "box" in [option_of(name) for name in self.named]
        self.takes_cutoff = "cutoff" in self.extra or "cutoff" in [option_of(name) for name in self.named]
        self.energy_first: bool | None = None
        self.has_energy = self.changes_input = False
        self.dimensions = 3
        self.kind = kind or self._kind(positions)
        self._look_in(positions)

    def __call__(self, x: Any, n: int = 2) -> tuple[Array, float | Array]:
        """F and U (NaN if there is none).  x : in the shape of the kind: (N, 3), a distance, or a vector."""
        extra = [n if option == "n" else self.options[option] for option in self.extra]
        first = np.array(x, dtype=float)
        before = first.copy()
        args: list[Any] = [first, np.zeros(3)] if self.is_of_two else [first]
        if first.ndim == 0:
            args = [float(first)]
        with np.errstate(all="ignore"):
            answer = self.function(*args, *extra, **self.named)
        self.changes_input |= not np.array_equal(first, before)
        if isinstance(answer, (tuple, list)) and len(answer) >= 2 and self.energy_first is not None:
            u, f = (answer[0], answer[1]) if self.energy_first else (answer[1], answer[0])
            return np.asarray(f, dtype=float), np.asarray(u, dtype=float)
        return np.asarray(answer, dtype=float), np.nan

    def _kind(self, positions: Array | None) -> str:
        name = self.names[0].lower()
        if self.is_squared:
            return "law"
        if self.is_of_two:
            return "pair"
        trial = np.random.default_rng(3).uniform(0.9, 1.3, (4, 3)) if positions is None else np.array(positions)
        try:
            if re.search(DISTANCE, name) and self._is_of_each(trial):
                return "law"
        except (
            Exception
        ):  # a student's function may raise anything; then it is not a function of positions, or needs a single number
            if re.search(DISTANCE, name) and self._works(START):
                return "law"
        if re.search(SEPARATION, name) and name != "r" and self._works(np.array([START, 0.2, 0.1]), (3,)):
            return "pair"
        return "forces"

    def _works(self, x: Any, shape: tuple[int, ...] = ()) -> bool:
        try:
            answer = self(x)[0]
            return answer.shape == shape or (answer.ndim == 1 and answer.shape[0] == 2 and shape == ())
        except Exception:
            return False

    def _is_of_each(self, x: Array) -> bool:
        """Whether an element of the result depends on one element of the argument only."""
        extra = [len(x) if option == "n" else self.options[option] for option in self.extra]
        with np.errstate(all="ignore"):
            first = self.function(x.copy(), *extra, **self.named)
            other = x.copy()
            other[0, 0] += 0.05
            second = self.function(other, *extra, **self.named)
        first, second = (np.asarray(one[-1] if isinstance(one, tuple) else one, dtype=float) for one in (first, second))
        if first.shape != x.shape or not np.isfinite(first).all():
            return False
        return bool(np.count_nonzero(np.abs(first - second) > 1e-12) <= 1)

    def _look_in(self, positions: Array | None) -> None:
        """Try a call in three dimensions, then in two."""
        try:
            self._look(positions)
        except ValueError:
            if self.kind != "forces" or positions is not None:
                raise
            self.dimensions = 2
            try:
                self._look(None)
                return
            except ValueError:
                self.dimensions = 3
            raise

    def _look(self, positions: Array | None) -> None:
        """Find the place of the energy in the result.  Raises ValueError for results of other shapes."""
        trial: Any = {"law": START**2 if self.is_squared else START, "pair": np.array([START, 0.2, 0.1])}.get(self.kind)
        if trial is None:
            trial = (
                np.array([[1.0, 1.0, 1.0], [2.1, 1.2, 1.1], [1.1, 2.3, 1.2]])[:, : self.dimensions]
                if positions is None
                else np.array(positions)
            )
        shape = np.shape(trial)
        extra = [len(trial) if option == "n" else self.options[option] for option in self.extra]
        arguments = [np.array(trial), np.zeros(3)] if self.is_of_two else [np.array(trial) if shape else float(trial)]
        called = (
            f"{self.name}({', '.join(self.names)}) with {self.names[0]} {f'of shape {shape}' if shape else 'a number'}"
        )
        try:
            with np.errstate(all="ignore"):
                answer = self.function(*arguments, *extra, **self.named)
        except Exception as error:
            raise ValueError(
                f"{called} raised {type(error).__name__}: {error}; if it needs another number of atoms, give their "
                "positions="
            ) from error
        if answer is None:
            raise ValueError(f"{called} returned None; it must return the forces, or forces and energy")
        if isinstance(answer, tuple) or (isinstance(answer, list) and shape == ()):
            shapes = [np.asarray(part).shape for part in answer[:2]]
            if shape == ():
                self.has_energy, self.energy_first = len(answer) > 1, True
            elif shape in shapes:
                self.has_energy, self.energy_first = len(answer) > 1 and () in shapes, shapes[0] != shape
            else:
                raise ValueError(
                    f"{called} returned parts of shapes {shapes}; forces must have the shape of the positions, {shape}"
                )
        elif np.shape(answer) != shape:
            raise ValueError(f"{called} returned shape {np.shape(answer)}; forces must have the shape of the "
                             f"positions, {shape}. If it is written "
                             "for a fixed number of atoms, give their positions=")  # fmt: skip
        if self.kind == "law" and isinstance(answer, (tuple, list)):
            self.energy_first = self._energy_is_first()

    def _energy_is_first(self) -> bool:
        """Whether the first of two numbers is the energy: the slope of the energy is proportional to the other one."""
        self.energy_first = True

        def off(first: bool) -> float:
            grid, h = np.linspace(0.95, 1.6, 12), 1e-4
            at = [
                [np.array(self((r + e) ** 2 if self.is_squared else r + e)[::-1], dtype=float) for e in (-h, 0.0, h)]
                for r in grid
            ]
            here, slopes = np.array([one[1] for one in at]), np.array([one[2] - one[0] for one in at]) / (2.0 * h)
            ratio = here[:, 1] / slopes[:, 0] if first else here[:, 0] / slopes[:, 1]
            logs = np.log(np.abs(ratio[np.isfinite(ratio) & (ratio != 0.0)]))
            return float(np.median(np.abs(logs - np.median(logs)))) if logs.size else np.inf

        return off(True) <= off(False)


def checked_positions(positions: Any) -> Array | None:
    """The user's positions as an (N, 3) array.  Raises ValueError for another shape or numbers that are not finite."""
    if positions is None:
        return None
    array = np.array(positions, dtype=float)
    if array.ndim != 2 or array.shape[1] != 3 or not np.isfinite(array).all():
        raise ValueError(f"positions must be (N, 3) finite numbers; got shape {array.shape}")
    return array


def edges(cell: float | Sequence[float] | None) -> Array | None:
    """The edges (3,) of a rectangular cell.  Raises ValueError for any other cell."""
    if cell is None:
        return None
    array = np.array(cell, dtype=float)
    if array.shape == (3, 3) and not np.any(array - np.diag(np.diagonal(array))):
        array = np.diagonal(array).copy()
    if array.shape not in ((), (3,)) or not (np.isfinite(array).all() and (array > 0.0).all()):
        raise ValueError(f"cell must be the edge of a cube, or three edges, positive and finite; got {cell!r}")
    return np.broadcast_to(array, (3,)).copy()
