"""How a student's step or force function is called: parameters are recognized by their names, results by their shapes.

Steps   x, r, q, pos, positions …           positions                  v, vel …           velocities;  p: momenta
        force, forces, f, compute_forces    a function of positions    acceleration, a    the same over the masses
        m, mass, masses                     masses                     dt, h, timestep    time step
        x_old, x_prev …                     positions a step ago       v_half …           velocities half a step ago
        state, y                            [x, v] in one              n_steps            1: the last row of a path
Forces  force(positions, box, cutoff)       (N, 3) -> (N, 3), or with the energy: (F, U), (U, F); box, cutoff if needed
        force(r), law(r2)                   a law of the distance: numbers -> numbers, or (u, f)
        force(rij), force(ri, rj)           the force of a pair: (3,) -> (3,)

Parameters with other names take the free places in step(x, v, force, m, dt), in this order. Coordinates of steps are
tried as (N, 3), (N, 2), (N,) and one number; masses as (N,), (N, 1) and one number; force(x) returns F, (F, U) or
(U, F). The step is called in the first manner in which it returns without an error. The kind of forces follows from
the names of the parameters, and from what the function does with arrays: a law treats each element separately.
"""

from __future__ import annotations

import inspect
import re
from collections.abc import Callable, Iterator
from contextlib import suppress
from itertools import product
from typing import Any, NamedTuple

import numpy as np

from minimd.grade.problems import SHAPES, Array, Problem, problem

PLACES = ("x", "v", "force", "m", "dt")
Names = tuple[tuple[str, str], ...]  # role, and pattern of the name in lower case without underscores: the first counts
# fmt: off
OF_STEPS: Names = (
    ("x", r"^([xrq][s0n]?|pos|xyz)$"), ("v", r"^(v[s0n]?|vel|u|[xqr]dot)$"), ("p", r"^(p[s0n]?|mom)$"),
    ("force", r"^(f[ns0]?|func?|frcs?)$"), ("acceleration", r"^(a[0n]?|accel)$"), ("m", r"^ms?$"),
    ("dt", r"^(dt|h|tau|step|δt?|deltat|dtime|stepsize)$"), ("time", r"^(t[n0]?|time)$"),
    ("box", r"^(l|box|boxlength|boxsize|lbox|cell)$"),
    ("old", r"^(x|r|q|pos\w*)(old|prev\w*|last|before|minus|m1?)$"), ("old", r"^(old|prev\w*|last)(x|r|q|pos\w*)$"),
    ("half", r"^(v|vel\w*)(half|mid\w*|h)$"),
    ("force", r"^f(old|prev\w*|last|now|t|cur\w*)$"), ("acceleration", r"^a(old|prev\w*|last|now|t|cur\w*)$"),
    ("steps", r"^(n|nt|nsteps?|numsteps|steps|niter\w*)$"), ("state", r"^(state|y|s|z|xv|phase\w*|rv)$"),
    ("gradient", r"grad|^d[uv](dx|dr|dq)?$"), ("acceleration", r"acc"), ("force", r"force"),
    ("dt", r"timestep|stepsize"), ("v", r"^vel"), ("p", r"^moment"), ("x", r"^pos|^coord"), ("m", r"^mass"),
)
OF_FORCES: Names = (
    ("box", r"^(l|box\w*|cell|lbox|edge|size|side|length|periodic)$"), ("cutoff", r"^(rc|rcut\w*|cut\w*)$"),
    ("epsilon", r"^(eps|epsilon|ε|depth)$"), ("sigma", r"^(sig|sigma|σ|s)$"),
    ("n", r"^(n|natoms|nparticles|num\w*)$"), ("stiffness", r"^(k|ks|kb|kbond|kspring)$"),
    ("strength", r"^(q|charge|de)$"),
)
# fmt: on
REST = r"^(r0|req|l0|d0|length|rest\w*|b0|x0)$"  # of a bond, if there is also a parameter for the stiffness
SQUARED = r"^(r2|rsq|rsq\w*|d2|dist2|rsquared|rr)$"
DISTANCE = r"^(r|d|dist\w*|rij|s)$"
SEPARATION = r"^(rij|dr|d|dx|rvec|vec\w*|delta|disp\w*|sep\w*|r12)$"
ONE_OF_TWO = r"^(r|x|q|p|pos\w*|atom|vec)?(i|j|1|2|a|b)$"
IS_FUNCTION = r"func|fn|compute|calc|get|eval|callable|law|field"
IS_BEFORE = r"old|prev|last|before|minus|m1"
KNOWN = "pos, vel, frc, forces, compute_forces, acc, mass, h, timestep, p, x_old, v_half"
FORCES = ("force", "acceleration", "gradient")
ANSWERS = ("F", "(F, U)", "(U, F)")
VELOCITIES = ("v", "p", "half", "old")  # roles that take the place of velocities
MASSES_NEED = {"(N,)": 1, "(N, 1)": 2, "one number": 0}  # dimensions of the array of positions
KINDS = {"forces": "forces on all atoms", "law": "a law of the distance", "pair": "the force of a pair"}
FAR = 1e6  # edge of the box for a step that has such a parameter
TINY = 1e-6  # time step of the first call, which shows whether x or v is returned first
START = 1.1  # σ: the distance in trial calls
SEPARATE = np.array([START, 0.2, 0.1])  # the vector of a pair in trial calls
TRIANGLE = np.array([[1.0, 1.0, 1.0], [2.1, 1.2, 1.1], [1.1, 2.3, 1.2]])  # three atoms in trial calls


def plain(name: str) -> str:
    """A name in lower case, without underscores."""
    return name.lower().replace("_", "")


def role_of(name: str, names: Names = OF_STEPS) -> str:
    """The role of a parameter with this name; empty if the name is not known."""
    return next((role for role, pattern in names if re.search(pattern, plain(name))), "")


def parameters_of(function: Callable[..., Any], example: str, name: str) -> list[inspect.Parameter]:
    """The parameters of a function.  Raises TypeError if there are none, or for a method without its object."""
    try:
        parameters = list(inspect.signature(function).parameters.values())
    except (TypeError, ValueError):
        kind = example.partition("(")[0]
        raise TypeError(f"{kind} must be a function, such as {example}; got {function!r}") from None
    if parameters and parameters[0].name == "self":
        raise TypeError(f"{name} is a method without its object (its first parameter is self): pass the method of an "
                        f"object, as in md.grade(Simulation().{name})")  # fmt: skip
    return [one for one in parameters if one.kind not in (one.VAR_POSITIONAL, one.VAR_KEYWORD)]


class Manner(NamedTuple):
    """roles : of the parameters, in their order; "known force" is the force at x as an array, "before force" the one a
    step earlier.  masses, answers : how masses are given, and what force(x) returns; see the module."""

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


def roles_of(function: Callable[..., Any]) -> tuple[list[str], list[str]]:
    """Names and roles of the parameters of a step; optional parameters with unknown names are left out.

    Raises TypeError for anything that is not a function, and for parameters that do not make a step.
    """
    parameters = parameters_of(function, "step(x, v, force, m, dt)", "step")
    pairs = [(one.name, role_of(one.name)) for one in parameters if one.default is one.empty or role_of(one.name)]
    if not any(role in FORCES for _, role in pairs):  # a step with its own force keeps its own mass
        kept = {one.name for one in parameters if one.default is not one.empty}
        pairs = [(name, role) for name, role in pairs if role != "m" or name not in kept]
    names, roles = [name for name, _ in pairs], [role for _, role in pairs]
    have = {"force" if role in FORCES else "v" if role in VELOCITIES else role for role in roles}
    left = iter([place for place in PLACES if place not in have and not ("state" in roles and place in ("x", "v"))])
    roles = [role or next(left, "") for role in roles]
    has_state = "state" in roles or ("x" in roles and set(VELOCITIES) & set(roles))
    if "dt" not in roles or not has_state or "" in roles:
        unknown = [name for name in names if not role_of(name)]
        nobody = f"; the meaning of {' and '.join(unknown)} cannot be seen from the name" if unknown else ""
        raise TypeError("a step takes positions, velocities, a force function, masses and a time step, as step(x, v, "
                        f"force, m, dt); the parameters of this one are ({', '.join(names)}){nobody}. Give them these "
                        f"names (m may be left out); also known are {KNOWN}")  # fmt: skip
    return names, roles


def manners(function: Callable[..., Any]) -> Iterator[Manner]:
    """The manners in which a step may be called, the most likely first."""
    names, roles = roles_of(function)
    forces = [k for k, role in enumerate(roles) if role in FORCES]
    choices = [[], forces] if forces else [[]]  # of the parameters that are arrays
    if len(forces) > 1:
        functions = [k for k in forces if re.search(IS_FUNCTION, names[k].lower())]
        first = functions[0] if functions else max(forces, key=lambda k: len(names[k]))
        choices = [[k for k in forces if k != first]]
    masses = ("(N,)", "(N, 1)", "one number") if "m" in roles else ("one number",)
    for known, shape, mass, answers in product(choices, SHAPES, masses, ANSWERS if forces else ANSWERS[:1]):
        if len(shape) < MASSES_NEED[mass]:
            continue
        before = [k for k in known if len(known) > 1 and re.search(IS_BEFORE, names[k].lower())]
        words = ["before " if k in before else "known " if k in known else "" for k in range(len(roles))]
        told = tuple(word + role for word, role in zip(words, roles, strict=True))
        yield Manner(told, tuple(names), shape, mass, answers)


class StudentStep:
    """A student's step as a map of (x, v) to (x, v).

    n_evaluations : how often it called the force function.  third : the force that it returned last as its third
    result, or None.  swapped, in_place, is_procedure : whether it returns v first; whether it changes x or v in place;
    whether it changes both.  path : positions and velocities of all steps, from a function that returns a path.
    stiffness : of the oscillator inside a step that takes no force function.
    """

    def __init__(self, function: Callable[..., Any], manner: Manner) -> None:
        self.function, self.manner, self.words = function, manner, set(" ".join(manner.roles).split())
        self.n_evaluations, self.n_steps, self.stiffness = 0, 1, 0.0
        self.path: list[Array] = []
        self.third: Array | None = None
        self.swapped = self.in_place = self.is_procedure = False
        self.is_given_forces, self.is_scaled = self.takes(*FORCES), self.takes("m", "acceleration")  # by masses

    def takes(self, *words: str) -> bool:
        """Whether one of these words is in the roles of the parameters."""
        return not self.words.isdisjoint(words)

    def find_own_force(self) -> None:
        """Find the spring inside a step that takes no force function.  Raises TypeError if its force is not −k x."""
        self.stiffness = 1.0
        where = self.problem(0)
        rate = self(where, where.x, 0.0 * where.v, TINY)[1] / TINY
        k = -float(np.sum(rate * where.x) / np.sum(where.x**2))
        if not k > 0.0 or np.abs(rate + k * where.x).max() > 1e-4 * max(k, 1.0):
            raise TypeError("the step takes no force function, and its own force is not that of a spring, −k x: make "
                            "the force function an argument, as step(x, v, force, m, dt)")  # fmt: skip
        self.stiffness = round(k, 5)

    def problem(self, seed: int, stiffness: float = 0.0) -> Problem:
        """A state in the shape of the step; masses are 1 if the step takes neither masses nor accelerations."""
        same_mass = self.manner.masses == "one number"
        one = problem(self.manner.shape, seed, same_mass, stiffness=stiffness or self.stiffness)
        return one if self.is_scaled else one._replace(m=np.ones_like(one.m))

    def __call__(self, where: Problem, x: Array, v: Array, h: float) -> tuple[Array, Array]:
        """One step.  Raises what the function raises, and ValueError for results that are not x and v."""
        roles, single = self.manner.roles, x.ndim == 0
        copy: Callable[[Any], Any] = float if single else np.array
        m = np.array(where.m if self.manner.masses == "(N,)" else where.m.reshape(-1, 1))
        half = v - 0.5 * h * where.force(x) / where.mass if self.takes("half", "old") else v
        before = x - h * v + 0.5 * h * h * where.force(x) / where.mass if self.takes("before") else x
        arrays: dict[str, Any] = {"x": x, "v": v, "p": where.mass * v, "half": half, "old": x - h * half}
        words = [role.split() for role in roles if " " in role]
        arrays |= {f"{when} {one}": where.scaled(one, before if when == "before" else x) for when, one in words}
        others: dict[str, Any] = {"dt": h, "time": 0.0, "box": FAR, "steps": self.n_steps, "state": [copy(x), copy(v)]}
        others |= {"m": float(m[0, 0]) if self.manner.masses == "one number" else m}
        others |= {role: self._force(role, where) for role in FORCES}
        given = [copy(arrays[role]) if role in arrays else others[role] for role in roles]
        answer = self.function(**dict(zip(self.manner.names, given, strict=True)))
        if "state" in roles:
            new = self._parts(given[roles.index("state")] if answer is None else answer, x.shape)
            return new[0], new[1]  # of a step that takes and returns both in one array or list
        of_v = next(role for role in VELOCITIES if role in roles)
        own = [given[roles.index(role)] for role in ("x", of_v)]
        changed = [
            not (single or np.array_equal(one, arrays[role])) for one, role in zip(own, ("x", of_v), strict=True)
        ]
        self.in_place |= any(changed)
        self.is_procedure |= all(changed)
        if answer is None and not self.in_place:
            raise ValueError("the step returns None and does not change x and v; it must return x, v")
        # changed in place; the result may be the force
        if answer is None or (self.is_procedure and not isinstance(answer, (tuple, list, dict))):
            answer = (*own, *([] if answer is None else [answer]))
        new = self._parts(answer, x.shape)
        if "old" in roles:  # v as returned, else the velocity at the half step plus half a kick
            returned = next((part for part in new[1:3] if not np.array_equal(part, x)), x)
            if np.abs(returned - v).max() < np.abs(returned - x).max():
                return new[0], returned
            new = [new[0], (new[0] - x) / h]
        new_x, new_v = (new[1], new[0]) if self.swapped else (new[0], new[1])
        if of_v == "p":
            return new_x, new_v / where.mass
        if of_v == "half" or "old" in roles:
            new_v = new_v + 0.5 * h * where.force(new_x) / where.mass
        return new_x, new_v

    def _force(self, role: str, where: Problem) -> Callable[..., Any]:
        def force(x: Any, *_: Any) -> Any:
            self.n_evaluations += 1
            x = np.array(x, dtype=float)
            if x.size != where.x.size:
                raise TypeError(f"the step calls its force with numbers of shape {x.shape}, but positions have shape "
                                f"{where.x.shape}; f(y, t) of a whole state, as for SciPy, cannot be graded: write "
                                "step(x, v, force, m, dt)")  # fmt: skip
            scaled = where.scaled(role, x)
            answer: Any = float(scaled) if x.ndim == 0 else scaled
            energy = where.potential(x) if self.manner.answers != "F" else 0.0
            return {"F": answer, "(F, U)": (answer, energy), "(U, F)": (energy, answer)}[self.manner.answers]

        return force

    def _parts(self, answer: Any, shape: tuple[int, ...]) -> list[Array]:
        """The arrays in the result, x and v first; the last rows of a path."""
        least = 2 - self.takes("old")
        if isinstance(answer, dict):
            answer = [answer[key] for key in sorted(answer, key=lambda key: {"x": 0, "v": 1}.get(role_of(key), 2))]
        is_array = isinstance(answer, np.ndarray)
        if (is_array and answer.shape == shape) or not (is_array or isinstance(answer, (tuple, list))):
            if least == 2:
                raise ValueError(f"the step must return x and v; it returned {type(answer).__name__}")
            answer = (answer,)
        parts = [np.array(part, dtype=float) for part in answer]
        if self.takes("steps"):
            self.path = [part for part in parts if part.ndim and part.shape[1:] == shape]
            parts = [part[-1] if part.ndim and part.shape[1:] == shape else part for part in parts]
        for name, part in zip(("x", "v"), parts, strict=False):
            if part.shape != shape:
                raise ValueError(f"the step must return {name} in the shape {shape} of its argument; it returned shape "
                                 f"{part.shape}")  # fmt: skip
        if len(parts) < least:
            raise ValueError(f"the step must return x and v; it returned only {len(parts)} of them")
        self.third = parts[2] if len(parts) > 2 and parts[2].shape == shape else None
        return parts


def understood(function: Callable[..., Any]) -> StudentStep:
    """The step, called in the first manner that works.

    Raises TypeError for other arguments, and ValueError for a step that fails in every manner, with the first error
    and its call.
    """
    first: tuple[Manner, Exception] | None = None
    for manner in manners(function):
        step = StudentStep(function, manner)
        where = step.problem(0)
        try:
            with np.errstate(all="ignore"):
                x, v = step(where, where.x, where.v, TINY)
        except Exception as error:  # whatever a student's function raises
            first = first or (manner, error)
            continue
        if not (np.isfinite(x).all() and np.isfinite(v).all()):
            raise ValueError(f"the step returned numbers that are not finite after one step of {TINY:g}, called as "
                             f"{manner.told('step')}")  # fmt: skip
        as_told, swapped = (np.abs(a - where.x).max() + np.abs(b - where.v).max() for a, b in ((x, v), (v, x)))
        step.swapped = bool(swapped < 0.01 * as_told) and not {"old", "p"} & set(manner.roles)
        if not step.is_given_forces:
            step.find_own_force()
        return step
    if first is None:
        raise TypeError("the step cannot be called")
    manner, cause = first
    raise ValueError(f"the step failed when it was called as {manner.told(getattr(function, '__name__', 'step'))}, and "
                     f"in every other manner: {type(cause).__name__}: {cause}") from cause  # fmt: skip


class StudentForce:
    """A student's force function, called in the manner that works.

    kind : one of KINDS.  is_squared : whether the law takes r².  has_energy : whether it also returns an energy.
    roles : of the parameters other than the positions.  values : those that are given to it.  takes : their roles.
    """

    def __init__(
        self, function: Callable[..., Any], options: dict[str, Any], kind: str | None, positions: Array | None
    ) -> None:
        self.function, self.name = function, getattr(function, "__name__", "force")
        parameters = parameters_of(function, "forces(positions)", self.name)
        self.defaults = {one.name: one.default for one in parameters if one.default is not one.empty}
        positional = (inspect.Parameter.POSITIONAL_ONLY, inspect.Parameter.POSITIONAL_OR_KEYWORD)
        self.names = [one.name for one in parameters if one.kind in positional and one.name not in self.defaults]
        if not self.names:
            raise TypeError(f"{self.name} has no parameter for the positions; a force function is called as "
                            "forces(positions)")  # fmt: skip
        first = plain(self.names[0])
        self.is_squared = bool(re.search(SQUARED, first))
        may_be_pair = len(self.names) > 1 and not self.is_squared and kind != "law"
        self.is_of_two = may_be_pair and all(re.search(ONE_OF_TWO, plain(name)) for name in self.names[:2])
        self.extra = self.names[1 + self.is_of_two :]
        self.roles = {name: role_of(name, OF_FORCES) for name in (*self.extra, *self.defaults)}
        if unknown := [name for name in self.extra if self.roles[name] not in options]:
            raise TypeError(f"{self.name} takes ({', '.join(self.names)}), and the meaning of {unknown[0]} is not "
                            f"known; pass a function of positions only, such as lambda x: {self.name}(x, …), or pass "
                            "cell= and cutoff=")  # fmt: skip
        given = {name: role for name, role in self.roles.items() if name in self.extra or options.get(f"{role} given")}
        self.values, self.takes = {name: options[role] for name, role in given.items()}, set(given.values())
        self.energy_first: bool | None = None
        self.has_energy = self.changes_input = False
        self.dimensions = 3
        self.kind = kind or self._kind(first, positions)
        try:
            self._look(positions)
        except ValueError:  # in three dimensions; then in two
            if self.kind != "forces" or positions is not None:
                raise
            self.dimensions = 2
            with suppress(ValueError):
                self._look(None)
                return
            raise

    def answer(self, x: Any) -> Any:
        """What the function returns.  x : in the shape of the kind: (N, 3), a distance, or a vector."""
        first = np.array(x, dtype=float)
        extra = [len(first) if self.roles[name] == "n" else self.values[name] for name in self.extra]
        named = {name: value for name, value in self.values.items() if name not in self.extra}
        args: list[Any] = [first if first.ndim else float(first), *([np.zeros(3)] if self.is_of_two else [])]
        with np.errstate(all="ignore"):
            answer = self.function(*args, *extra, **named)
        self.changes_input |= not np.array_equal(first, np.array(x, dtype=float))
        return answer

    def __call__(self, x: Any) -> tuple[Array, float | Array]:
        """F and U (NaN if there is none)."""
        answer = self.answer(x)
        if isinstance(answer, (tuple, list)) and len(answer) >= 2 and self.energy_first is not None:
            u, f = (answer[0], answer[1]) if self.energy_first else (answer[1], answer[0])
            return np.asarray(f, dtype=float), np.asarray(u, dtype=float)
        return np.asarray(answer, dtype=float), np.nan

    def _kind(self, name: str, positions: Array | None) -> str:
        if self.is_squared or self.is_of_two:
            return "law" if self.is_squared else "pair"
        trial = np.random.default_rng(3).uniform(0.9, 1.3, (4, 3)) if positions is None else positions
        if re.search(DISTANCE, name) and self._is_of_each(trial):
            return "law"
        return "pair" if re.search(SEPARATION, name) and self._shape_at(SEPARATE) == (3,) else "forces"

    def _shape_at(self, x: Any) -> tuple[int, ...] | None:
        try:
            return self(x)[0].shape
        except Exception:  # whatever a student's function raises
            return None

    def _is_of_each(self, x: Array) -> bool:
        """Whether an element of the result depends on one element of the argument only."""
        other = x.copy()
        other[0, 0] += 0.05
        try:
            answers = [self.answer(x), self.answer(other)]
            first, second = (np.asarray(one[-1] if isinstance(one, tuple) else one, dtype=float) for one in answers)
        except Exception:  # it is not a function of positions, or needs a single number
            return self._shape_at(START) in ((), (2,))
        is_one = first.shape == second.shape == x.shape and np.count_nonzero(np.abs(first - second) > 1e-12) <= 1
        return bool(is_one and np.isfinite(first).all())

    def _look(self, positions: Array | None) -> None:
        """Find the place of the energy in the result.  Raises ValueError for results of other shapes."""
        atoms = TRIANGLE[:, : self.dimensions] if positions is None else positions
        trial: Any = {"law": START**2 if self.is_squared else START, "pair": SEPARATE}.get(self.kind, atoms)
        shape = np.shape(trial)
        given = f"of shape {shape}" if shape else "a number"
        called = f"{self.name}({', '.join(self.names)}) with {self.names[0]} {given}"
        needed = f"forces must have the shape of the positions, {shape}"
        try:
            answer = self.answer(trial)
        except Exception as error:
            raise ValueError(f"{called} raised {type(error).__name__}: {error}; if it needs another number of atoms, "
                             "give their positions=") from error  # fmt: skip
        if answer is None:
            raise ValueError(f"{called} returned None; it must return the forces, or forces and energy")
        if isinstance(answer, tuple) or (isinstance(answer, list) and shape == ()):
            shapes = [np.asarray(part).shape for part in answer[:2]]
            if shape and shape not in shapes:
                raise ValueError(f"{called} returned parts of shapes {shapes}; {needed}")
            self.has_energy = len(answer) > 1 and () in shapes if shape else len(answer) > 1
            self.energy_first = shapes[0] != shape if shape else True
        elif np.shape(answer) != shape:
            raise ValueError(f"{called} returned shape {np.shape(answer)}; {needed}. If it is written for a fixed "
                             "number of atoms, give their positions=")  # fmt: skip
        if self.kind == "law" and isinstance(answer, (tuple, list)):
            self.energy_first = self._energy_is_first()

    def _energy_is_first(self) -> bool:
        """Whether the first of two numbers is the energy: the slope of the energy is proportional to the other one."""
        grid, h = np.linspace(0.95, 1.6, 12), 1e-4
        at = np.array([[self(r**2 if self.is_squared else r) for r in grid + e] for e in (-h, 0.0, h)], dtype=float)
        slopes = (at[2] - at[0]) / (2.0 * h)

        def off(ratio: Array) -> float:
            logs = np.log(np.abs(ratio[np.isfinite(ratio) & (ratio != 0.0)]))
            return float(np.median(np.abs(logs - np.median(logs)))) if logs.size else np.inf

        # the columns are force and energy, if the energy is the first of the two numbers
        return off(at[1, :, 0] / slopes[:, 1]) <= off(at[1, :, 1] / slopes[:, 0])
