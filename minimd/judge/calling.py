"""How a student's step or force function is called: parameters are recognized by their names, results by their shapes.

Parameters of steps with other names take the free places in step(x, v, force, m, dt), in this order. The function is
called in the first manner in which it returns without an error, and in the right shape.
"""

import inspect
import re
from collections.abc import Iterator
from itertools import product
from typing import Any

import numpy as np

from minimd.judge.problems import SHAPES, Array, Function, TrialProblem, problem

PLACES = ("x", "v", "force", "m", "dt")
# role, and pattern of the name in lower case without underscores: the first counts
Names = tuple[tuple[str, str], ...]
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
PHYSICAL = ("epsilon", "sigma", "stiffness", "strength")
# of a bond, if there is also a parameter for the stiffness
REST = r"^(r0|req|l0|d0|length|rest\w*|b0|x0)$"
SQUARED = r"^(r2|rsq|rsq\w*|d2|dist2|rsquared|rr)$"
DISTANCE = r"^(r|d|dist\w*|rij|s)$"
SEPARATION = r"^(rij|dr|d|dx|rvec|vec\w*|delta|disp\w*|sep\w*|r12)$"
ONE_OF_TWO = r"^(r|x|q|p|pos\w*|atom|vec)?(i|j|1|2|a|b)$"
IS_FUNCTION = r"func|fn|compute|calc|get|eval|callable|law|field"
IS_BEFORE = r"old|prev|last|before|minus|m1"
FORCES = ("force", "acceleration", "gradient")
ANSWERS = ("F", "(F, U)", "(U, F)")
VELOCITIES = ("v", "p", "half", "old")  # roles that take the place of velocities
# how they are given, and the least dimensions of positions
MASSES = {"(N,)": 1, "(N, 1)": 2, "one number": 0}
TOLD = {(5, 3): "(N, 3)", (5, 2): "(N, 2)", (5,): "(N,)", (): "one number"}
KINDS = {"forces": "forces on all atoms", "law": "a law of the distance", "pair": "the force of a pair"}
FAR = 1e6  # edge of the box for a step that has such a parameter
TINY = 1e-6  # time step of the first call
# σ: the distance and the vector of a pair in trial calls
START = 1.1
SEPARATE = np.array([1.1, 0.2, 0.1])
# three atoms in trial calls
TRIANGLE = np.array([[1.0, 1.0, 1.0], [2.1, 1.2, 1.1], [1.1, 2.3, 1.2]])
# fmt: on


def plain(name: str) -> str:
    """A name in lower case, without underscores."""
    return name.lower().replace("_", "")


def role_of(name: str, names: Names = OF_STEPS) -> str:
    """The role of a parameter with this name; empty if the name is not known."""
    return next((role for role, pattern in names if re.search(pattern, plain(name))), "")


class Called:
    """A student's function.  roles, defaults : of its parameters, by name.

    Raises TypeError for what has no parameters, or for a method without its object.
    """

    def __init__(self, function: Function, names: Names, example: str) -> None:
        self.function = function
        self.name = getattr(function, "__name__", "function")
        try:
            parameters = inspect.signature(function).parameters
        except (TypeError, ValueError):
            raise TypeError(f"give a function, such as {example}; got {function!r}") from None
        if [*parameters][:1] == ["self"]:
            raise TypeError(
                f"{self.name} is a method without its object (its first parameter is self): pass the "
                f"method of an object, as in md.grade(Simulation().{self.name})"
            )
        starred = (inspect.Parameter.VAR_POSITIONAL, inspect.Parameter.VAR_KEYWORD)
        kept = {name: one.default for name, one in parameters.items() if one.kind not in starred}
        self.roles = {name: role_of(name, names) for name in kept}
        self.defaults = {
            name: value for name, value in kept.items() if value is not inspect.Parameter.empty
        }


def manners(function: Function) -> Iterator["StudentStep"]:
    """The manners in which a step may be called, the most likely first; optional parameters with unknown names are
    left out.  Raises TypeError for parameters that do not make a step."""
    one = Called(function, OF_STEPS, "step(x, v, force, m, dt)")
    has_force = {*one.roles.values()} & {*FORCES}  # a step with its own force keeps its own mass
    known = {
        name: role
        for name, role in one.roles.items()
        if name not in one.defaults or (role and (has_force or role != "m"))
    }
    have = {
        "force" if role in FORCES else "v" if role in VELOCITIES else role
        for role in known.values()
    }
    left = iter(
        [
            place
            for place in PLACES
            if place not in have and not ("state" in have and place in ("x", "v"))
        ]
    )
    names = tuple(known)
    roles = [role or next(left, "") for role in known.values()]
    if (
        "dt" not in roles
        or not ("state" in roles or ("x" in roles and {*VELOCITIES} & {*roles}))
        or "" in roles
    ):
        unknown = " and ".join(name for name in names if not known[name]) or "none"
        raise TypeError(
            "a step takes positions, velocities, a force function, masses and a time step, as step(x, v, "
            f"force, m, dt); its parameters are ({', '.join(names)}), the meaning of {unknown} is unknown. "
            "Give them these names, or pos, vel, frc, forces, compute_forces, acc, mass, h, "
            "timestep, p, x_old, v_half; m may be left out"
        )
    forces = [k for k, role in enumerate(roles) if role in FORCES]
    is_old = [re.search(IS_BEFORE, name.lower()) for name in names]
    choices = [[], forces] if forces else [[]]  # of the parameters that are arrays
    if len(forces) > 1:
        like = {
            k: (bool(re.search(IS_FUNCTION, names[k].lower())), not is_old[k], len(names[k]))
            for k in forces
        }
        choices = [[k for k in forces if k != max(forces, key=lambda k: like[k])]]
    masses = [*MASSES] if "m" in roles else ["one number"]
    for arrays, shape, mass, answers in product(
        choices, SHAPES, masses, ANSWERS if forces else ANSWERS[:1]
    ):
        when = {k: "before " if len(arrays) > 1 and is_old[k] else "known " for k in arrays}
        if len(shape) >= MASSES[mass]:
            told = {name: when.get(k, "") + roles[k] for k, name in enumerate(names)}
            yield StudentStep(function, told, shape, mass, answers)


class StudentStep:
    """A student's step as a map of (x, v) to (x, v), called in one manner.

    roles : of the parameters, by name; "known force" is the force at x as an array, "before force" the one a step
    earlier.  masses, answers : how masses are given, and what force(x) returns.  n_evaluations : how often it called
    the force function.  third : the force that it returned last as its third result, if any.  swapped, in_place :
    whether it returns v first; whether it changes x or v in place.  rows_alike : whether it returned a path whose rows
    are all the same.  stiffness : of the oscillator inside a step without a force function.
    """

    n_evaluations = 0
    stiffness = 0.0
    third = np.array([])
    swapped = in_place = rows_alike = False

    def __init__(
        self, function: Any, roles: dict[str, str], shape: Any, masses: str, answers: str
    ) -> None:
        self.function = function
        self.names = roles
        self.shape = shape
        self.masses = masses
        self.answers = answers
        self.roles = [*roles.values()]
        self.words = {*" ".join(roles.values()).split()}
        kinds = {"x": TOLD[shape], "m": masses, **dict.fromkeys(FORCES, f"a function: {answers}")}
        told = (f"{name}: {kinds[role]}" if role in kinds else name for name, role in roles.items())
        self.call_text = f"{getattr(function, '__name__', 'step')}({', '.join(told)})"

    def takes(self, *words: str) -> bool:
        """Whether one of these words is in the roles of the parameters."""
        return not self.words.isdisjoint(words)

    def problem(self, seed: int, stiffness: float = 0.0) -> TrialProblem:
        """A state in the shape of the step; masses are 1 if the step takes neither masses nor accelerations."""
        one = problem(self.shape, seed, self.masses == "one number", stiffness or self.stiffness)
        return one if self.takes("m", "acceleration") else one._replace(m=np.ones_like(one.m))

    def __call__(self, where: TrialProblem, x: Array, v: Array, h: float) -> tuple[Array, Array]:
        """One step.  Raises what the function raises, and ValueError for results that are not x and v."""
        roles = self.roles
        one = float if x.ndim == 0 else np.array
        m: Any = {"(N,)": where.m, "(N, 1)": where.m.reshape(-1, 1), "one number": where.m.flat[0]}[
            self.masses
        ]
        half = v - 0.5 * h * where.force(x) / where.mass if self.takes("half", "old") else v
        before = (
            x - h * v + 0.5 * h * h * where.force(x) / where.mass if self.takes("before") else x
        )
        of_v = next((role for role in VELOCITIES if role in roles), "v")
        arrays: dict[str, Any] = {
            "x": x,
            "v": v,
            "p": where.mass * v,
            "half": half,
            "old": x - h * half,
        }
        known = [(role, before if "before" in role else x) for role in roles if " " in role]
        arrays |= {role: where.scaled(role.split()[1], place) for role, place in known}
        others: dict[str, Any] = {
            "dt": h,
            "time": 0.0,
            "box": FAR,
            "steps": 1,
            "state": [one(x), one(v)],
        }
        others |= {
            "m": np.array(m) if np.ndim(m) else float(m),
            **{role: self._force(role, where) for role in FORCES},
        }
        given = {role: one(arrays[role]) if role in arrays else others[role] for role in roles}
        answer = self.function(**{name: given[role] for name, role in self.names.items()})
        if "state" in roles:  # of a step that takes and returns both in one array or list
            new = self._parts(given["state"] if answer is None else answer, x.shape)
            return new[0], new[1]
        own = given["x"], given[of_v]
        changed = [
            not np.array_equal(mine, arrays[role])
            for mine, role in zip(own, ("x", of_v), strict=True)
        ]
        self.in_place |= any(changed)
        if answer is None and not self.in_place:
            raise ValueError(
                "the step returns None and does not change x and v; it must return x, v"
            )
        if answer is None or (all(changed) and not isinstance(answer, (tuple, list, dict))):
            # changed in place; the result may be the force
            answer = (*own, *([] if answer is None else [answer]))
        new = self._parts(answer, x.shape)
        if "old" in roles:  # v as returned, else the velocity at the half step plus half a kick
            returned = next((part for part in new[1:3] if not np.array_equal(part, x)), x)
            if np.abs(returned - v).max() < np.abs(returned - x).max():
                return new[0], returned
            new = [new[0], (new[0] - x) / h]
        new_x, new_v = (new[1], new[0]) if self.swapped else (new[0], new[1])
        push = 0.5 * h * where.force(new_x) / where.mass if of_v in ("half", "old") else 0.0
        return new_x, (new_v / where.mass if of_v == "p" else new_v + push)

    def _force(self, role: str, where: TrialProblem) -> Function:
        def force(x: Any, *_: Any) -> Any:
            self.n_evaluations += 1
            x = np.array(x, dtype=float)
            if x.size != where.x.size:
                raise TypeError(
                    f"the step calls its force with numbers of shape {x.shape}, but positions have shape "
                    f"{where.x.shape}; f(y, t) of a whole state, as for SciPy, cannot be graded: write "
                    "step(x, v, force, m, dt)"
                )
            scaled = where.scaled(role, x)
            answer: Any = float(scaled) if x.ndim == 0 else scaled
            energy = where.at(x)[1] if self.answers != "F" else 0.0
            return {"F": answer, "(F, U)": (answer, energy), "(U, F)": (energy, answer)}[
                self.answers
            ]

        return force

    def _parts(self, answer: Any, shape: tuple[int, ...]) -> list[Array]:
        """The arrays in the result, x and v first; the last rows of a path."""
        if isinstance(answer, dict):
            answer = [
                answer[key]
                for key in sorted(answer, key=lambda key: {"x": 0, "v": 1}.get(role_of(key), 2))
            ]
        is_many = isinstance(answer, (np.ndarray, tuple, list)) and (
            self.takes("state") or np.shape(answer) != shape
        )
        parts = [np.array(part, dtype=float) for part in (answer if is_many else [answer])]
        if self.takes("steps"):
            self.rows_alike = (
                parts[0].shape[1:] == shape
                and len(parts[0]) > 1
                and not np.ptp(parts[0], axis=0).any()
            )
            parts = [part[-1] if part.ndim and part.shape[1:] == shape else part for part in parts]
        if len(parts) < 2 - self.takes("old") or {part.shape for part in parts[:2]} != {shape}:
            raise ValueError(
                f"the step must return x and v in the shape {shape} of its arguments; it returned shapes "
                f"{', '.join(str(part.shape) for part in parts)}"
            )
        self.third = parts[2] if len(parts) > 2 and parts[2].shape == shape else np.array([])
        return parts

    def find_own_force(self) -> None:
        """Find the spring inside a step that takes no force function.  Raises TypeError if its force is not −k x."""
        self.stiffness = 1.0
        where = self.problem(0)
        rate = self(where, where.x, 0.0 * where.v, TINY)[1] / TINY
        k = -np.sum(rate * where.x) / np.sum(where.x**2)
        if not k > 0.0 or np.abs(rate + k * where.x).max() > 1e-4 * max(k, 1.0):
            raise TypeError(
                "the step takes no force function, and its own force is not that of a spring, −k x: make "
                "the force function an argument, as step(x, v, force, m, dt)"
            )
        self.stiffness = round(k, 5)


def understood(function: Function) -> StudentStep:
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
            first = first or (step.call_text, error)
            continue
        if not (np.isfinite(x).all() and np.isfinite(v).all()):
            raise ValueError(
                f"the step returned numbers that are not finite after one step of {TINY:g}, called as "
                f"{step.call_text}"
            )
        as_told, swapped = (
            np.abs(a - where.x).max() + np.abs(b - where.v).max() for a, b in ((x, v), (v, x))
        )
        step.swapped = bool(swapped < 0.01 * as_told) and not step.takes("old", "p")
        if not step.takes(*FORCES):
            step.find_own_force()
        return step
    told, cause = first or ("step()", TypeError("it cannot be called"))
    raise ValueError(
        f"the step failed when it was called as {told}, and in every other manner: "
        f"{type(cause).__name__}: {cause}"
    ) from cause


class StudentForce(Called):
    """A student's force function.

    kind, dimensions : what it is called as; one of KINDS.  is_squared : whether the law takes r².  has_energy :
    whether it also returns an energy.  names : of the parameters without defaults.  values : what is given for those
    after the positions.  takes : their roles.  physical : values of ε, σ and others, by name.
    """

    kind = "forces"
    dimensions = 3
    has_energy = False
    changes_input = False
    energy_first: bool | None = None

    def __init__(
        self, function: Any, options: dict[str, Any], kind: str | None, positions: Array | None
    ) -> None:
        super().__init__(function, OF_FORCES, "forces(positions)")
        self.names = [name for name in self.roles if name not in self.defaults]
        if not self.names:
            raise TypeError(
                f"{self.name} has no parameter for the positions; a force function is called as "
                "forces(positions)"
            )
        first = plain(self.names[0])
        self.is_squared = re.search(SQUARED, first)
        may_be_pair = len(self.names) > 1 and not self.is_squared and kind != "law"
        self.is_of_two = may_be_pair and all(
            re.search(ONE_OF_TWO, plain(name)) for name in self.names[:2]
        )
        extra = self.names[1 + self.is_of_two :]
        if kind != "law" and (
            unknown := [name for name in extra if self.roles[name] not in options]
        ):
            raise TypeError(
                f"{self.name} takes ({', '.join(self.names)}), and the meaning of {unknown[0]} is not "
                f"known; pass a function of positions only, such as lambda x: {self.name}(x, …), or pass "
                "cell= and cutoff="
            )
        given = [
            *extra,
            *(name for name in self.defaults if options.get(f"{self.roles[name]} given")),
        ]
        self.values = {name: options.get(self.roles[name], 1.0) for name in given}
        self.takes = {self.roles[name] for name in given}
        values = {**self.defaults, **self.values}
        has_stiffness = "stiffness" in self.roles.values()  # then a rest length is physical, too
        self.physical = {
            name: float(value)
            for name, value in values.items()
            if isinstance(value, (int, float))
            and value > 0
            and not isinstance(value, bool)
            and (self.roles[name] in PHYSICAL or (has_stiffness and re.search(REST, plain(name))))
        }
        guesses = [
            one
            for one, names in (("law", DISTANCE), ("pair", SEPARATION), ("forces", ""))
            if re.search(names, first)
        ]
        guesses = ["law"] if self.is_squared else ["pair"] if self.is_of_two else guesses
        self._look([kind] if kind else guesses, positions)

    def _look(self, kinds: list[str], positions: Array | None) -> None:
        """Find the kind, and the place of the energy in the result.  Raises ValueError for functions that cannot be
        called, and results of other shapes."""
        wrong = list[str]()
        is_free = kinds[-1] == "forces" and positions is None
        for self.kind, self.dimensions in [
            *((kind, 3) for kind in kinds),
            *[("forces", 2)] * is_free,
        ]:
            atoms = TRIANGLE[:, : self.dimensions] if positions is None else positions
            trial: Any = {"law": START**2 if self.is_squared else START, "pair": SEPARATE}.get(
                self.kind, atoms
            )
            try:
                wrong.append(self._misfit(self.answer(trial), np.shape(trial), "pair" in kinds))
            except Exception as error:  # whatever a student's function raises
                wrong.append(f"{np.shape(trial)}, and raised {type(error).__name__}: {error}")
            if not wrong[-1]:
                return
        raise ValueError(
            f"{self.name}({', '.join(self.names)}) was called with {self.names[0]} of shape "
            f"{wrong[len(kinds) - 1]}. If {self.name} is written for a fixed number of atoms, pass them: "
            "positions=..."
        )

    def _misfit(self, answer: Any, shape: tuple[int, ...], may_be_pair: bool) -> str:
        """What is wrong with a result for an argument of a shape; "" if nothing is."""
        has_parts = isinstance(answer, tuple) or (isinstance(answer, list) and shape == ())
        shapes = [np.shape(part) for part in (answer[:2] if has_parts else [answer])]
        if (
            answer is None
            or shape not in shapes
            or not {*shapes} <= {shape, ()}
            or len(shapes) <= has_parts
        ):
            returned = "None" if answer is None else f"shape {', '.join(map(str, shapes))}"
            return f"{shape}, and returned {returned}; forces must have the shape of the positions"
        if self.kind == "law" and may_be_pair and self._is_vector():
            return "(), but is a function of the vector r_ij"
        self.has_energy = len(shapes) > 1 and () in shapes
        self.energy_first = (
            (shapes[0] != shape if shape else self._energy_is_first()) if has_parts else None
        )
        return ""

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
        values = {
            name: len(first) if self.roles[name] == "n" else value
            for name, value in self.values.items()
        }
        values |= {self.names[1]: np.zeros(3)} if self.is_of_two else {}
        args = [
            first if first.ndim else float(first),
            *(values.pop(name) for name in self.names[1:]),
        ]
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
        return np.asarray(f, dtype=float), np.asarray(u if self.has_energy else np.nan, dtype=float)

    def _energy_is_first(self) -> bool:
        """Whether the first of two numbers of a law is the energy: the other one is its slope times a power of r."""
        r = np.linspace(0.95, 1.6, 12)
        h = 1e-4
        at = np.array(
            [
                [self.answer(x**2 if self.is_squared else x)[:2] for x in r + e]
                for e in (-h, 0.0, h)
            ],
            float,
        )

        def off(u: int) -> float:
            logs = np.log(np.abs(at[1, :, 1 - u] / (at[2, :, u] - at[0, :, u])))
            logs = logs[np.isfinite(logs)]
            return float(np.median(np.abs(logs - np.median(logs)))) if logs.size else np.inf

        return off(0) <= off(1)
