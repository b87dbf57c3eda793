"""How a student's step is called: its parameters are recognized by their names, and its results by their shapes.

    x, r, q, pos, positions …           positions                  v, vel …              velocities;  p: momenta
    force, forces, f, compute_forces    a function of positions    acceleration, a       the same, divided by the masses
    m, mass, masses                     masses                     dt, h, timestep       time step
    x_old, x_prev …                     positions a step ago       v_half …              velocities half a step ago
    state, y                            [x, v] in one              n_steps               1: the last row of a path

Parameters with other names take the free places in step(x, v, force, m, dt), in this order. Coordinates are tried as
(N, 3), (N, 2), (N,) and one number; masses as (N,), (N, 1) and one number; force(x) returns F, (F, U) or (U, F). The
step is called in the first manner in which it returns without an error.
"""

from __future__ import annotations

import inspect
import re
from collections.abc import Callable, Iterator
from itertools import product
from typing import Any, NamedTuple

import numpy as np

from minimd.grade.problems import SHAPES, Array, Problem, problem

PLACES = ("x", "v", "force", "m", "dt")
NAMES = {  # whole names, in lower case and without underscores; patterns are below
    "x": ["x", "r", "q", "pos", "xyz", "rs", "xs", "qs", "x0", "r0", "q0", "xn", "rn", "qn"],
    "v": ["v", "vel", "vs", "v0", "vn", "u", "xdot", "qdot", "rdot"],
    "p": ["p", "mom", "ps", "p0", "pn"],
    "force": ["f", "fn", "func", "fs", "f0", "fun", "frc", "frcs"],
    "acceleration": ["a", "a0", "an", "accel"],
    "m": ["m", "ms"],
    "dt": ["dt", "h", "tau", "step", "δt", "δ", "deltat", "dtime", "stepsize"],
    "time": ["t", "time", "tn", "t0"],
    "box": ["l", "box", "boxlength", "boxsize", "lbox", "cell"],
}
STEPS, STATE = r"^(n|nt|n_?steps?|num_?steps|steps|n_?iter\w*)$", r"^(state|y|s|z|xv|phase\w*|rv)$"
PATTERNS = (  # the first that fits counts
    ("old", r"^(x|r|q|pos\w*)_*(old|prev\w*|last|before|minus|m1?)$"),
    ("old", r"^(old|prev\w*|last)_*(x|r|q|pos\w*)$"),
    ("half", r"^(v|vel\w*)_*(half|mid\w*|h)$"),
    ("force", r"^f_*(old|prev\w*|last|now|t|cur\w*)$"),
    ("acceleration", r"^a_*(old|prev\w*|last|now|t|cur\w*)$"),
    ("steps", STEPS),
    ("state", STATE),
    ("gradient", r"grad|^d[uv](dx|dr|dq)?$"),
    ("acceleration", r"acc"),
    ("force", r"force"),
    ("dt", r"time_?step|step_?size"),
    ("v", r"^vel"),
    ("p", r"^moment"),
    ("x", r"^pos|^coord"),
    ("m", r"^mass"),
)
IS_FUNCTION = r"func|fn|compute|calc|get|eval|callable|law|field"
IS_BEFORE = r"old|prev|last|before|minus|m1"
KNOWN = "pos, vel, frc, forces, compute_forces, acc, mass, h, timestep, p, x_old, v_half"
FORCES = ("force", "acceleration", "gradient")
ANSWERS = ("F", "(F, U)", "(U, F)")
FAR = 1e6  # edge of the box for a step that has such a parameter
TINY = 1e-6  # time step of the first call, which shows whether x or v is returned first


class Manner(NamedTuple):
    """roles : of the parameters, in their order; "known force" is the force at x as an array,
    "before force" the one a step earlier.
    masses, answers : how masses are given, and what force(x) returns; see the module."""

    roles: tuple[str, ...]
    names: tuple[str, ...]
    shape: tuple[int, ...]
    masses: str
    answers: str

    def told(self, name: str) -> str:
        """The call as text."""
        shapes = {(5, 3): "(N, 3)", (5, 2): "(N, 2)", (5,): "(N,)", (): "one number"}
        kinds = {"x": shapes[self.shape], "m": self.masses, **dict.fromkeys(FORCES, f"a function: {self.answers}")}
        pairs = zip(self.names, self.roles, strict=True)
        return f"{name}({', '.join(f'{one}: {kinds[role]}' if role in kinds else one for one, role in pairs)})"


def role_of(name: str) -> str:
    """The role of a parameter with this name; empty if the name is not known."""
    plain = name.lower().replace("Δ", "d").strip("_")
    for role, names in NAMES.items():
        if plain.replace("_", "") in names:
            return role
    return next((role for role, pattern in PATTERNS if re.search(pattern, plain)), "")


def roles_of(function: Callable[..., Any]) -> tuple[list[str], list[str]]:
    """Names and roles of the parameters of a step; optional parameters with unknown names are left out.

    Raises TypeError for anything that is not a function, and for parameters that do not make a step.
    """
    try:
        parameters = list(inspect.signature(function).parameters.values())
    except (TypeError, ValueError):
        raise TypeError(f"step must be a function, such as step(x, v, force, m, dt); got {function!r}") from None
    if parameters and parameters[0].name == "self":
        raise TypeError(
            "step is a method without its object (its first parameter is self): pass the method of an object, as in "
            "md.grade(Simulation().step)"
        )
    pairs = [
        (one.name, role_of(one.name), one.default is one.empty)
        for one in parameters
        if one.kind not in (one.VAR_POSITIONAL, one.VAR_KEYWORD)
    ]
    if not any(role in FORCES for _, role, _ in pairs):  # a step with its own force keeps its own mass
        pairs = [pair for pair in pairs if pair[1] != "m" or pair[2]]
    pairs = [pair for pair in pairs if pair[1] or pair[2]]
    names, roles = [name for name, _, _ in pairs], [role for _, role, _ in pairs]
    have = {"force" if role in FORCES else "v" if role in ("p", "half", "old") else role for role in roles}
    left = [place for place in PLACES if place not in have and not ("state" in roles and place in ("x", "v"))]
    for k, role in enumerate(roles):
        if not role and left:
            roles[k] = left.pop(0)
    if (
        "dt" not in roles
        or not ("state" in roles or ({"v", "p", "half", "old"} & set(roles) and "x" in roles))
        or "" in roles
    ):
        told = ", ".join(names)
        unknown = [name for name in names if not role_of(name)]
        nobody = f"; the meaning of {' and '.join(unknown)} cannot be seen from the name" if unknown else ""
        raise TypeError("a step takes positions, velocities, a force function, masses and a time step, as step(x, v, "
                        "force, m, dt); "
                        f"the parameters of this one are ({told}){nobody}. Give them these names (m may be left out); "
                        f"also known are {KNOWN}")  # fmt: skip
    return names, roles


def manners(function: Callable[..., Any]) -> Iterator[Manner]:
    """The manners in which a step may be called, the most likely first."""
    names, roles = roles_of(function)
    forces = [k for k, role in enumerate(roles) if role in FORCES]
    if len(forces) > 1:
        functions = [k for k in forces if re.search(IS_FUNCTION, names[k].lower())] or [
            max(forces, key=lambda k: len(names[k]))
        ]
        choices = [[k for k in forces if k not in functions[:1]]]
    else:
        choices = [[], forces] if forces else [[]]
    masses = ("(N,)", "(N, 1)", "one number") if "m" in roles else ("one number",)
    for known, shape, mass, answers in product(choices, SHAPES, masses, ANSWERS):
        if (
            (shape == () and mass != "one number")
            or (shape == (5,) and mass == "(N, 1)")
            or (not forces and answers != "F")
        ):
            continue
        told = ["known" if k in known else role for k, role in enumerate(roles)]
        before = [k for k in known if len(known) > 1 and re.search(IS_BEFORE, names[k].lower())]
        told = [
            f"{'before' if k in before else 'known'} {roles[k]}" if role == "known" else role
            for k, role in enumerate(told)
        ]
        yield Manner(tuple(told), tuple(names), shape, mass, answers)


class StudentStep:
    """A student's step as a map of (x, v) to (x, v).

    n_evaluations : how often it called the force function.  third :
        the force that it returned last as its third result, or None.
    swapped, in_place, is_procedure : whether it returns v first; whether it changes x or v in place;
        whether it changes both.
    """

    def __init__(self, function: Callable[..., Any], manner: Manner) -> None:
        self.function, self.manner = function, manner
        self.n_evaluations, self.n_steps = 0, 1
        self.path: list[Array] = []  # positions and velocities of all steps, from a function that returns a path
        self.third: Array | None = None
        self.swapped = self.in_place = self.is_procedure = False
        self.stiffness = 0.0  # of the oscillator inside a step that takes no force function

    def find_own_force(self) -> None:
        """Find the spring inside a step that takes no force function.  Raises TypeError if its force is not −k x."""
        self.stiffness = 1.0
        where = self.problem(0)
        rate = self(where, where.x, 0.0 * where.v, TINY)[1] / TINY
        k = -float(np.sum(rate * where.x) / np.sum(where.x**2))
        if not k > 0.0 or np.abs(rate + k * where.x).max() > 1e-4 * max(k, 1.0):
            raise TypeError("the step takes no force function, and its own force is not that of a spring, −k x: make "
                            "the force function an argument, "
                            "as step(x, v, force, m, dt)")  # fmt: skip
        self.stiffness = round(k, 5)

    @property
    def has_masses(self) -> bool:
        """Whether the step takes masses."""
        return "m" in self.manner.roles

    @property
    def is_given_forces(self) -> bool:
        """Whether the step takes a force or a force function."""
        return any(set(role.split()) & set(FORCES) for role in self.manner.roles)

    def problem(self, seed: int, stiffness: float = 0.0) -> Problem:
        """A state in the shape of the step; masses are 1 if the step takes neither masses nor accelerations."""
        one = problem(
            self.manner.shape, seed, self.manner.masses == "one number", stiffness=stiffness or self.stiffness
        )
        scaled = self.has_masses or any("acceleration" in role for role in self.manner.roles)
        return one if scaled else one._replace(m=np.ones_like(one.m))

    def __call__(self, where: Problem, x: Array, v: Array, h: float) -> tuple[Array, Array]:
        """One step.  Raises what the function raises, and ValueError for results that are not x and v."""
        roles, single = self.manner.roles, x.ndim == 0
        half = v - 0.5 * h * where.force(x) / where.mass if {"half", "old"} & set(roles) else v
        given = [self._argument(role, where, x, v, half, h) for role in roles]
        if single:
            given = [float(one) if isinstance(one, np.ndarray) else one for one in given]
            given = [list(map(float, one)) if role == "state" else one for role, one in zip(roles, given, strict=True)]
        before = [one.copy() if isinstance(one, np.ndarray) else one for one in given]
        answer = self.function(**dict(zip(self.manner.names, given, strict=True)))
        if "state" in roles:
            state = self._parts(given[roles.index("state")] if answer is None else answer, x.shape)
            return state[0], state[1]  # of a step that takes and returns both in one array or list
        of_x, of_v = roles.index("x"), next(roles.index(role) for role in ("v", "p", "half", "old") if role in roles)
        changed = [not single and not np.array_equal(given[k], before[k]) for k in (of_x, of_v)]
        self.in_place |= any(changed)
        if answer is None and not self.in_place:
            raise ValueError("the step returns None and does not change x and v; it must return x, v")
        self.is_procedure |= all(changed)
        if answer is None or (
            self.is_procedure and not isinstance(answer, (tuple, list, dict))
        ):  # changed in place; the result may be the force
            answer = (given[of_x], given[of_v], *([] if answer is None else [answer]))
        new = self._parts(answer, x.shape)
        if "old" in roles:
            return self._from_recursion(where, new, x, v, h)
        new_x, new_v = (new[1], new[0]) if self.swapped else (new[0], new[1])
        if roles[of_v] == "p":
            new_v = new_v / where.mass
        if roles[of_v] == "half":
            new_v = new_v + 0.5 * h * where.force(new_x) / where.mass
        return new_x, new_v

    def _argument(self, role: str, where: Problem, x: Array, v: Array, half: Array, h: float) -> Any:
        if role in FORCES:
            return self._force(role, where)
        if role.startswith("known"):
            return self._scaled(role.split()[1], where, where.force(x))
        if role.startswith("before"):
            earlier = x - h * v + 0.5 * h * h * where.force(x) / where.mass
            return self._scaled(role.split()[1], where, where.force(earlier))
        if role == "state":
            return [np.array(x), np.array(v)]
        if role == "m":
            shapes = {"(N,)": where.m, "(N, 1)": where.m.reshape(-1, 1), "one number": float(np.ravel(where.m)[0])}
            return np.array(shapes[self.manner.masses]) if self.manner.masses != "one number" else shapes["one number"]
        arrays = {"x": x, "v": v, "p": where.mass * v, "half": half, "old": x - h * half}
        return (
            np.array(arrays[role])
            if role in arrays
            else {"dt": h, "time": 0.0, "box": FAR, "steps": self.n_steps}[role]
        )

    def _scaled(self, role: str, where: Problem, force: Array) -> Array:
        return {"force": force, "acceleration": force / where.mass, "gradient": -force}[role]

    def _force(self, role: str, where: Problem) -> Callable[..., Any]:
        def force(x: Any, *_: Any) -> Any:
            self.n_evaluations += 1
            x = np.array(x, dtype=float)
            if x.size != where.x.size:
                raise TypeError(
                    f"the step calls its force with numbers of shape {x.shape}, but positions have shape "
                    f"{where.x.shape}; f(y, t) of "
                    "a whole state, as for SciPy, cannot be graded: write step(x, v, force, m, dt)"
                )
            scaled = self._scaled(role, where, where.force(x))
            answer: Any = float(scaled) if x.ndim == 0 else scaled
            energy = where.potential(x) if self.manner.answers != "F" else 0.0
            return {"F": answer, "(F, U)": (answer, energy), "(U, F)": (energy, answer)}[self.manner.answers]

        return force

    def _parts(self, answer: Any, shape: tuple[int, ...]) -> list[Array]:
        if isinstance(answer, dict):
            answer = sorted(
                answer.items(),
                key=lambda item: ("x", "v").index(role_of(item[0])) if role_of(item[0]) in ("x", "v") else 2,
            )
            answer = [value for _, value in answer]
        if not isinstance(answer, (tuple, list, np.ndarray)) or (
            isinstance(answer, np.ndarray) and answer.shape == shape
        ):
            if "old" not in self.manner.roles:
                raise ValueError(f"the step must return x and v; it returned {type(answer).__name__}")
            answer = (answer,)
        parts = [np.array(part, dtype=float) for part in answer]
        if "steps" in self.manner.roles:  # a path: its last row
            self.path = [part for part in parts if part.ndim == len(shape) + 1 and part.shape[1:] == shape]
            parts = [part[-1] if part.ndim == len(shape) + 1 and part.shape[1:] == shape else part for part in parts]
        for name, part in zip(("x", "v"), parts, strict=False):
            if part.shape != shape:
                raise ValueError(
                    f"the step must return {name} in the shape {shape} of its argument; it returned shape {part.shape}"
                )
        if len(parts) < 2 - ("old" in self.manner.roles):
            raise ValueError(f"the step must return x and v; it returned only {len(parts)} of them")
        self.third = parts[2] if len(parts) > 2 and parts[2].shape == shape else None
        return parts

    def _from_recursion(self, where: Problem, new: list[Array], x: Array, v: Array, h: float) -> tuple[Array, Array]:
        """x and v of a step that takes two positions: v as returned,
        else the velocity at the half step plus half a kick."""
        x1 = new[0]
        own = next((part for part in new[1:3] if not np.array_equal(part, x)), None)
        if own is not None and np.abs(own - v).max() < np.abs(own - x).max():
            return x1, own
        return x1, (x1 - x) / h + 0.5 * h * where.force(x1) / where.mass


def understood(function: Callable[..., Any]) -> StudentStep:
    """The step, called in the first manner that works.

    Raises TypeError for other arguments, and ValueError for a step that fails in every manner,
    with the first error and its call.
    """
    first: tuple[str, str] | None = None
    cause: Exception | None = None
    for manner in manners(function):
        step = StudentStep(function, manner)
        where = step.problem(0)
        try:
            with np.errstate(all="ignore"):
                x, v = step(where, where.x, where.v, TINY)
        except Exception as error:  # whatever a student's function raises
            if first is None:
                first, cause = (
                    (manner.told(getattr(function, "__name__", "step")), f"{type(error).__name__}: {error}"),
                    error,
                )
            continue
        if not (np.isfinite(x).all() and np.isfinite(v).all()):
            raise ValueError(
                f"the step returned numbers that are not finite after one step of {TINY:g}, called as "
                f"{manner.told('step')}"
            )
        as_told, swapped = (np.abs(a - where.x).max() + np.abs(b - where.v).max() for a, b in ((x, v), (v, x)))
        step.swapped = bool(swapped < 0.01 * as_told) and not {"old", "p"} & set(manner.roles)
        if not step.is_given_forces:
            step.find_own_force()
        return step
    if first is None:
        raise TypeError("the step cannot be called")
    raise ValueError(
        f"the step failed when it was called as {first[0]}, and in every other manner: {first[1]}"
    ) from cause
