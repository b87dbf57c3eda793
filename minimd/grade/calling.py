"""How a student's step or force function is called: parameters are recognized by their names, results by their shapes.

Parameters of steps with other names take the free places in step(x, v, force, m, dt), in this order. Coordinates are
tried as (N, 3), (N, 2), (N,) and one number; masses as (N,), (N, 1) and one number; force(x) returns F, (F, U) or
(U, F). The step is called in the first manner in which it returns without an error. What a force function is (forces
of all atoms, a law of the distance, the force of a pair) follows from the name of its first parameter, and from what
the function does with arrays: a law treats each element separately.
"""

from __future__ import annotations

import inspect
import re
from collections.abc import Callable, Iterator
from itertools import product
from typing import Any

import numpy as np

from minimd.grade.problems import SHAPES, Array, Problem, problem

EMPTY = inspect.Parameter.empty
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
PHYSICAL = ("epsilon", "sigma", "stiffness", "strength")
REST = r"^(r0|req|l0|d0|length|rest\w*|b0|x0)$"  # of a bond, if there is also a parameter for the stiffness
SQUARED, DISTANCE = r"^(r2|rsq|rsq\w*|d2|dist2|rsquared|rr)$", r"^(r|d|dist\w*|rij|s)$"
SEPARATION = r"^(rij|dr|d|dx|rvec|vec\w*|delta|disp\w*|sep\w*|r12)$"
ONE_OF_TWO = r"^(r|x|q|p|pos\w*|atom|vec)?(i|j|1|2|a|b)$"
IS_FUNCTION = r"func|fn|compute|calc|get|eval|callable|law|field"
IS_BEFORE = r"old|prev|last|before|minus|m1"
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


def parameters_of(function: Callable[..., Any], names: Names, example: str) -> dict[str, tuple[str, Any]]:
    """Role and default of each parameter, by name; EMPTY if there is no default.

    Raises TypeError for what has no parameters, or for a method without its object.
    """
    try:
        parameters = [*inspect.signature(function).parameters.values()]
    except (TypeError, ValueError):
        raise TypeError(
            f"{example.partition('(')[0]} must be a function, such as {example}; got {function!r}"
        ) from None
    if parameters and parameters[0].name == "self":
        raise TypeError(f"{called(function)} is a method without its object (its first parameter is self): pass the "
                        f"method of an object, as in md.grade(Simulation().{called(function)})")  # fmt: skip
    starred = (inspect.Parameter.VAR_POSITIONAL, inspect.Parameter.VAR_KEYWORD)
    return {one.name: (role_of(one.name, names), one.default) for one in parameters if one.kind not in starred}


def called(function: Callable[..., Any]) -> str:
    """The name of a function."""
    return getattr(function, "__name__", "function")


def manners(function: Callable[..., Any]) -> Iterator[StudentStep]:
    """The manners in which a step may be called, the most likely first; optional parameters with unknown names are
    left out.  Raises TypeError for parameters that do not make a step."""
    parameters = parameters_of(function, OF_STEPS, "step(x, v, force, m, dt)")
    has_force = any(role in FORCES for role, _ in parameters.values())  # a step with its own force keeps its own mass
    kept = {name: role for name, (role, default) in parameters.items()
            if default is EMPTY or (role and (has_force or role != "m"))}  # fmt: skip
    have = {"force" if role in FORCES else "v" if role in VELOCITIES else role for role in kept.values()}
    left = iter([place for place in PLACES if place not in have and not ("state" in have and place in ("x", "v"))])
    names, roles = tuple(kept), [role or next(left, "") for role in kept.values()]
    has_state = "state" in roles or ("x" in roles and set(VELOCITIES) & set(roles))
    if "dt" not in roles or not has_state or "" in roles:
        unknown = [name for name in names if not kept[name]]
        nobody = f"; the meaning of {' and '.join(unknown)} cannot be seen from the name" if unknown else ""
        raise TypeError("a step takes positions, velocities, a force function, masses and a time step, as step(x, v, "
                        f"force, m, dt); the parameters of this one are ({', '.join(names)}){nobody}. Give them these "
                        "names (m may be left out); also known are pos, vel, frc, forces, compute_forces, acc, mass, "
                        "h, timestep, p, x_old, v_half")  # fmt: skip
    forces = [k for k, role in enumerate(roles) if role in FORCES]
    is_old = [bool(re.search(IS_BEFORE, name.lower())) for name in names]
    choices = [[], forces] if forces else [[]]  # of the parameters that are arrays
    if len(forces) > 1:
        like = {k: (bool(re.search(IS_FUNCTION, names[k].lower())), not is_old[k], len(names[k])) for k in forces}
        choices = [[k for k in forces if k != max(forces, key=lambda k: like[k])]]
    masses = ("(N,)", "(N, 1)", "one number") if "m" in roles else ("one number",)
    for known, shape, mass, answers in product(choices, SHAPES, masses, ANSWERS if forces else ANSWERS[:1]):
        when = {k: "before " if len(known) > 1 and is_old[k] else "known " for k in known}
        if len(shape) >= MASSES_NEED[mass]:
            told = tuple(when.get(k, "") + role for k, role in enumerate(roles))
            yield StudentStep(function, told, names, shape, mass, answers)


class StudentStep:
    """A student's step as a map of (x, v) to (x, v), called in one manner.

    roles : of the parameters, in their order; "known force" is the force at x as an array, "before force" the one a
    step earlier.  masses, answers : how masses are given, and what force(x) returns; see the module.  n_evaluations :
    how often it called the force function.  third : the force that it returned last as its third result, or None.
    swapped, in_place : whether it returns v first; whether it changes x or v in place.  rows_alike : whether it
    returned a path whose rows are all the same.  stiffness : of the oscillator inside a step without a force function.
    """

    def __init__(
        self, function: Any, roles: tuple[str, ...], names: tuple[str, ...], shape: Any, masses: str, answers: str
    ) -> None:
        self.function, self.roles, self.names, self.shape = function, roles, names, shape
        self.masses, self.answers, self.words = masses, answers, set(" ".join(roles).split())
        self.n_evaluations, self.stiffness, self.third = 0, 0.0, np.array([])
        self.swapped = self.in_place = self.rows_alike = False
        shapes = {(5, 3): "(N, 3)", (5, 2): "(N, 2)", (5,): "(N,)", (): "one number"}
        kinds = {"x": shapes[shape], "m": masses, **dict.fromkeys(FORCES, f"a function: {answers}")}
        told = (f"{name}: {kinds[role]}" if role in kinds else name for name, role in zip(names, roles, strict=True))
        self.told = f"{called(function)}({', '.join(told)})"

    def takes(self, *words: str) -> bool:
        """Whether one of these words is in the roles of the parameters."""
        return not self.words.isdisjoint(words)

    def problem(self, seed: int, stiffness: float = 0.0) -> Problem:
        """A state in the shape of the step; masses are 1 if the step takes neither masses nor accelerations."""
        same_mass = self.masses == "one number"
        one = problem(self.shape, seed, same_mass, stiffness=stiffness or self.stiffness)
        return one if self.takes("m", "acceleration") else one._replace(m=np.ones_like(one.m))

    def __call__(self, where: Problem, x: Array, v: Array, h: float) -> tuple[Array, Array]:
        """One step.  Raises what the function raises, and ValueError for results that are not x and v."""
        roles, one = self.roles, float if x.ndim == 0 else np.array
        m = {"(N,)": where.m, "(N, 1)": where.m.reshape(-1, 1), "one number": where.m.flat[0]}[self.masses]
        half = v - 0.5 * h * where.force(x) / where.mass if self.takes("half", "old") else v
        before = x - h * v + 0.5 * h * h * where.force(x) / where.mass if self.takes("before") else x
        of_v = next((role for role in VELOCITIES if role in roles), "v")
        arrays: dict[str, Any] = {"x": x, "v": v, "p": where.mass * v, "half": half, "old": x - h * half}
        for role in roles:
            when, _, what = role.partition(" ")
            arrays |= {role: where.scaled(what, before if when == "before" else x)} if what else {}
        others: dict[str, Any] = {"dt": h, "time": 0.0, "box": FAR, "steps": 1, "state": [one(x), one(v)]}
        others |= {"m": np.array(m) if np.ndim(m) else float(m), **{role: self._force(role, where) for role in FORCES}}
        given = {role: one(arrays[role]) if role in arrays else others[role] for role in roles}
        answer = self.function(**{name: given[role] for name, role in zip(self.names, roles, strict=True)})
        if "state" in roles:  # of a step that takes and returns both in one array or list
            new = self._parts(given["state"] if answer is None else answer, x.shape)
            return new[0], new[1]
        own = given["x"], given[of_v]
        changed = [not np.array_equal(mine, arrays[role]) for mine, role in zip(own, ("x", of_v), strict=True)]
        self.in_place |= any(changed)
        if answer is None and not self.in_place:
            raise ValueError("the step returns None and does not change x and v; it must return x, v")
        if answer is None or (all(changed) and not isinstance(answer, (tuple, list, dict))):
            answer = (*own, *([] if answer is None else [answer]))  # changed in place; the result may be the force
        new = self._parts(answer, x.shape)
        if "old" in roles:  # v as returned, else the velocity at the half step plus half a kick
            returned = next((part for part in new[1:3] if not np.array_equal(part, x)), x)
            if np.abs(returned - v).max() < np.abs(returned - x).max():
                return new[0], returned
            new = [new[0], (new[0] - x) / h]
        new_x, new_v = (new[1], new[0]) if self.swapped else (new[0], new[1])
        push = 0.5 * h * where.force(new_x) / where.mass if of_v in ("half", "old") else 0.0
        return new_x, (new_v / where.mass if of_v == "p" else new_v + push)

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
            energy = where.at(x)[1] if self.answers != "F" else 0.0
            return {"F": answer, "(F, U)": (answer, energy), "(U, F)": (energy, answer)}[self.answers]

        return force

    def _parts(self, answer: Any, shape: tuple[int, ...]) -> list[Array]:
        """The arrays in the result, x and v first; the last rows of a path."""
        if isinstance(answer, dict):
            answer = [answer[key] for key in sorted(answer, key=lambda key: {"x": 0, "v": 1}.get(role_of(key), 2))]
        is_array = isinstance(answer, np.ndarray)
        is_one = (is_array and answer.shape == shape) or not (is_array or isinstance(answer, (tuple, list)))
        parts = [np.array(part, dtype=float) for part in ((answer,) if is_one else answer)]
        if len(parts) < 2 - self.takes("old"):
            raise ValueError(f"the step must return x and v; it returned {type(answer).__name__}, one of them")
        if self.takes("steps"):
            self.rows_alike = (
                parts[0].shape[1:] == shape and len(parts[0]) > 1 and bool((parts[0] == parts[0][-1]).all())
            )
            parts = [part[-1] if part.ndim and part.shape[1:] == shape else part for part in parts]
        for name, part in zip(("x", "v"), parts, strict=False):
            if part.shape != shape:
                raise ValueError(f"the step must return {name} in the shape {shape} of its argument; it returned shape "
                                 f"{part.shape}")  # fmt: skip
        self.third = parts[2] if len(parts) > 2 and parts[2].shape == shape else np.array([])
        return parts

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


def understood(function: Callable[..., Any]) -> StudentStep:
    """The step, called in the first manner that works.

    Raises TypeError for other arguments, and ValueError for a step that fails in every manner, with the first error
    and its call.
    """
    first: tuple[str, Exception] | None = None
    for step in manners(function):
        where = step.problem(0)
        try:
            with np.errstate(all="ignore"):
                x, v = step(where, where.x, where.v, TINY)
        except Exception as error:  # whatever a student's function raises
            first = first or (step.told, error)
            continue
        if not (np.isfinite(x).all() and np.isfinite(v).all()):
            raise ValueError(f"the step returned numbers that are not finite after one step of {TINY:g}, called as "
                             f"{step.told}")  # fmt: skip
        as_told, swapped = (np.abs(a - where.x).max() + np.abs(b - where.v).max() for a, b in ((x, v), (v, x)))
        step.swapped = bool(swapped < 0.01 * as_told) and not step.takes("old", "p")
        if not step.takes(*FORCES):
            step.find_own_force()
        return step
    told, cause = first or ("step()", TypeError("it cannot be called"))
    raise ValueError(f"the step failed when it was called as {told}, and in every other manner: {type(cause).__name__}: "
                     f"{cause}") from cause  # fmt: skip


class StudentForce:
    """A student's force function.

    kind, dimensions : what it is called as; one of KINDS.  physical : values of ε, σ and others, by name.  is_squared : whether the law takes r².  has_energy : whether
    it also returns an energy.  roles : of the parameters other than the positions.  values : those that are given.
    """

    has_energy = changes_input = False
    energy_first: bool | None = None
    kind, dimensions = "forces", 3

    def __init__(
        self, function: Callable[..., Any], options: dict[str, Any], kind: str | None, positions: Array | None
    ) -> None:
        self.function, self.name = function, called(function)
        parameters = parameters_of(function, OF_FORCES, "forces(positions)")
        self.defaults = {name: default for name, (_, default) in parameters.items() if default is not EMPTY}
        self.names = [name for name in parameters if name not in self.defaults]
        if not self.names:
            raise TypeError(f"{self.name} has no parameter for the positions; a force function is called as "
                            "forces(positions)")  # fmt: skip
        first = plain(self.names[0])
        self.is_squared = bool(re.search(SQUARED, first))
        may_be_pair = len(self.names) > 1 and not self.is_squared and kind != "law"
        self.is_of_two = may_be_pair and all(re.search(ONE_OF_TWO, plain(name)) for name in self.names[:2])
        extra = self.names[1 + self.is_of_two :]
        self.roles = {name: parameters[name][0] for name in (*extra, *self.defaults)}
        if kind != "law" and (unknown := [name for name in extra if self.roles[name] not in options]):
            raise TypeError(f"{self.name} takes ({', '.join(self.names)}), and the meaning of {unknown[0]} is not "
                            f"known; pass a function of positions only, such as lambda x: {self.name}(x, …), or pass "
                            "cell= and cutoff=")  # fmt: skip
        given = {name: role for name, role in self.roles.items() if name in extra or options.get(f"{role} given")}
        self.values, self.takes = {name: options.get(role, 1.0) for name, role in given.items()}, set(given.values())
        values = {**self.defaults, **self.values}
        has_stiffness = "stiffness" in self.roles.values()  # then a rest length is physical, too
        self.physical = {
            name: float(value)
            for name, value in values.items()
            if (self.roles[name] in PHYSICAL or (has_stiffness and re.search(REST, plain(name))))
            and type(value) in (int, float, np.float64)
            and value > 0.0
        }
        may_be = (("law", f"{SQUARED}|{DISTANCE}"), ("pair", SEPARATION))
        guesses = ["pair"] if self.is_of_two else [one for one, names in may_be if re.search(names, first)]
        guesses = guesses if guesses and (self.is_squared or self.is_of_two) else [*guesses, "forces"]
        self._look([kind] if kind else guesses, positions)

    def _look(self, kinds: list[str], positions: Array | None) -> None:
        """Find the kind, and the place of the energy in the result.  Raises ValueError for results of other shapes."""
        tries = [(kind, 3) for kind in kinds] + [("forces", 2)] * (kinds[-1] == "forces" and positions is None)
        failed = ValueError("")
        for self.kind, self.dimensions in tries:
            atoms = TRIANGLE[:, : self.dimensions] if positions is None else positions
            trial: Any = {"law": START**2 if self.is_squared else START, "pair": SEPARATE}.get(self.kind, atoms)
            shape = np.shape(trial)
            told = f"{self.name}({', '.join(self.names)}) with {self.names[0]} of shape {shape}"
            try:
                answer = self.answer(trial)
                is_other = self.kind == "law" and "pair" in kinds and self._is_vector()
            except Exception as error:  # whatever a student's function raises
                words = (
                    f"{told} raised {type(error).__name__}: {error}; if it needs another number of atoms, give their "
                )
                failed = failed if self.dimensions == 2 else ValueError(f"{words}positions=")
                continue
            is_pair = isinstance(answer, tuple) or (isinstance(answer, list) and shape == ())
            shapes = [np.shape(part) for part in (answer[:2] if is_pair else [answer])]
            if shape in shapes and set(shapes) <= {shape, ()} and answer is not None and not is_other:
                self.has_energy = len(shapes) > 1 and () in shapes
                self.energy_first = (shapes[0] != shape if shape else self._energy_is_first()) if is_pair else None
                return
            what = "None" if answer is None else f"shape {', '.join(map(str, shapes))}"
            words = (
                f"{told} returned {what}; forces must have the shape of the positions. If it is written for a fixed "
            )
            failed = failed if self.dimensions == 2 else ValueError(f"{words}number of atoms, give their positions=")
        raise failed

    def _is_vector(self) -> bool:
        """Whether the result for r_ij is a vector, whose components do not each depend on one component only."""
        try:
            answers = [self.answer(x) for x in (START, SEPARATE)]
        except Exception:  # whatever a student's function raises
            return False
        numbers, vectors = (one if isinstance(one, tuple) else (one,) for one in answers)
        return any(np.shape(one) == (3,) and one[0] not in numbers for one in vectors)

    def answer(self, x: Any) -> Any:
        """What the function returns.  x : in the shape of the kind: (N, 3), a distance, or a vector."""
        first = np.array(x, dtype=float)
        values = {name: len(first) if self.roles[name] == "n" else value for name, value in self.values.items()}
        values |= {self.names[1]: np.zeros(3)} if self.is_of_two else {}
        args = [first if first.ndim else float(first), *(values.pop(name) for name in self.names[1:])]
        with np.errstate(all="ignore"):
            answer = self.function(*args, **values)
        self.changes_input |= not np.array_equal(first, np.array(x, dtype=float))
        return answer

    def __call__(self, x: Any) -> tuple[Array, float | Array]:
        """F and U (NaN if there is none)."""
        answer = self.answer(x)
        if self.energy_first is None:
            return np.asarray(answer, dtype=float), np.nan
        u, f = (answer[0], answer[1]) if self.energy_first else (answer[1], answer[0])
        return np.asarray(f, dtype=float), np.asarray(u, dtype=float)

    def _energy_is_first(self) -> bool:
        """Whether the first of two numbers of a law is the energy: the other one is its slope times a power of r."""
        r, h = np.linspace(0.95, 1.6, 12), 1e-4
        at = np.array([[self.answer(x**2 if self.is_squared else x)[:2] for x in r + e] for e in (-h, 0.0, h)], float)

        def off(u: int) -> float:
            logs = np.log(np.abs(at[1, :, 1 - u] / (at[2, :, u] - at[0, :, u])))
            logs = logs[np.isfinite(logs)]
            return float(np.median(np.abs(logs - np.median(logs)))) if logs.size else np.inf

        return off(0) <= off(1)
