"""How a student's step or force function is called: parameters are recognized by their names, results by their shapes.

Parameters of steps with other names take the free places in step(x, v, force, m, dt), in this order. The function is
called in the first manner in which it returns without an error, and in the right shape.
"""

import re
from collections.abc import Iterable, Iterator
from inspect import Parameter, signature
from itertools import product
from typing import Any

import numpy as np

from minimd.core.structure.arrays import Array
from minimd.judge.problems import SHAPES, Function, TrialProblem, largest, problem

PLACES = ("x", "v", "force", "m", "dt")
Names = tuple[tuple[str, str], ...]
# role, and pattern of the name in lower case without underscores: the first counts
# fmt: off
OF_STEPS: Names = (
    ("x", r"^([xrq][s0n]?|pos|xyz)$"),
    ("v", r"^(v[s0n]?|vel|u|[xqr]dot)$"),
    ("p", r"^(p[s0n]?|mom)$"),
    ("force", r"^(f[ns0]?|func?|frcs?)$"),
    ("acceleration", r"^(a[0n]?|accel)$"),
    ("m", r"^ms?$"),
    ("dt", r"^(dt|h|tau|step|δt?|deltat|dtime|stepsize)$"),
    ("time", r"^(t[n0]?|time)$"),
    ("box", r"^(l|box|boxlength|boxsize|lbox|cell)$"),
    ("old", r"^(x|r|q|pos\w*)(old|prev\w*|last|before|minus|m1?)$"),
    ("old", r"^(old|prev\w*|last)(x|r|q|pos\w*)$"),
    ("half", r"^(v|vel\w*)(half|mid\w*|h)$"),
    ("force", r"^f(old|prev\w*|last|now|t|cur\w*)$"),
    ("acceleration", r"^a(old|prev\w*|last|now|t|cur\w*)$"),
    ("steps", r"^(n|nt|nsteps?|numsteps|steps|niter\w*)$"),
    ("state", r"^(state|y|s|z|xv|phase\w*|rv)$"),
    ("gradient", r"grad|^d[uv](dx|dr|dq)?$"),
    ("acceleration", r"acc"),
    ("force", r"force"),
    ("dt", r"timestep|stepsize"),
    ("v", r"^vel"),
    ("p", r"^moment"),
    ("x", r"^pos|^coord"),
    ("m", r"^mass"),
)
OF_FORCES: Names = (
    ("box", r"^(l|box\w*|cell|lbox|edge|size|side|length|periodic)$"),
    ("cutoff", r"^(rc|rcut\w*|cut\w*)$"),
    ("epsilon", r"^(eps|epsilon|ε|depth)$"),
    ("sigma", r"^(sig|sigma|σ|s)$"),
    ("n", r"^(n|natoms|nparticles|num\w*)$"),
    ("stiffness", r"^(k|ks|kb|kbond|kspring)$"),
    ("strength", r"^(q|charge|de)$"),
)
# fmt: on
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
PLACE_OF = dict.fromkeys(VELOCITIES, "v") | dict.fromkeys(FORCES, "force")
# how masses are passed, and the least dimensions of positions
MASSES = {"(N,)": 1, "(N, 1)": 2, "one number": 0}
SHAPE_NAMES = {(5, 3): "(N, 3)", (5, 2): "(N, 2)", (5,): "(N,)", (): "one number"}
KINDS = {
    "forces": "forces on all atoms",
    "law": "a law of the distance",
    "pair": "the force of a pair",
}
FAR = 1e6  # edge of the box for a step that has such a parameter
TINY = 1e-6  # time step of the first call
START = 1.1  # σ: distance of a pair in trial calls
SEPARATE = np.array([1.1, 0.2, 0.1])  # its vector
# three atoms in trial calls
TRIANGLE = np.array([[1.0, 1.0, 1.0], [2.1, 1.2, 1.1], [1.1, 2.3, 1.2]])


def plain(name: str) -> str:
    """A name in lower case, without underscores."""
    return name.lower().replace("_", "")


def role_of(name: str, names: Names = OF_STEPS) -> str:
    """The role of a parameter with this name; empty if the name is not known."""
    return next((role for role, pattern in names if re.search(pattern, plain(name))), "")


def places_of(roles: Iterable[str]) -> set[str]:
    """The places in step(x, v, force, m, dt) that these roles take."""
    places = {PLACE_OF.get(role, role) for role in roles}
    return places | {"x", "v"} if "state" in places else places


class Called:
    """A student's function.

    roles, defaults : of its parameters, by name.

    Raises TypeError for what has no parameters, or for a method without its object.
    """

    def __init__(self, function: Function, names: Names, example: str) -> None:
        self.function = function
        self.name = getattr(function, "__name__", "function")
        try:
            parameters = signature(function).parameters
        except (TypeError, ValueError):
            raise TypeError(f"give a function, such as {example}; got {function!r}") from None
        if [*parameters][:1] == ["self"]:
            raise TypeError(
                f"{self.name} is a method without its object (its first parameter is self): pass the method of an "
                f"object, as in md.grade(Simulation().{self.name})"
            )

        starred = (Parameter.VAR_POSITIONAL, Parameter.VAR_KEYWORD)
        self.first = next(iter(parameters.values()), None)
        self.roles = dict[str, str]()
        self.defaults = dict[str, Any]()
        for name, parameter in parameters.items():
            if parameter.kind in starred:
                continue
            self.roles[name] = role_of(name, names)
            if parameter.default is not Parameter.empty:
                self.defaults[name] = parameter.default


def manners(function: Function) -> Iterator["StudentStep"]:
    """The manners in which a step may be called, the most likely first; optional parameters with unknown names are
    left out.  Raises TypeError for parameters that do not make a step."""
    student = Called(function, OF_STEPS, "step(x, v, force, m, dt)")
    has_force = "force" in places_of(student.roles.values())
    roles = dict[str, str]()
    for name, role in student.roles.items():
        # a step with its own force keeps its own mass
        is_used = role and (has_force or role != "m")
        if name not in student.defaults or is_used:
            roles[name] = role
    taken = places_of(roles.values())
    left = iter([place for place in PLACES if place not in taken])
    unknown = [name for name, role in roles.items() if not role]
    for name in unknown:
        roles[name] = next(left, "")
    places = places_of(roles.values())
    if "" in places or not {"x", "v", "dt"} <= places:
        names = " and ".join(unknown) or "none"
        raise TypeError(
            "a step takes positions, velocities, a force function, masses and a time step, as step(x, v, force, m, "
            f"dt); its parameters are ({', '.join(roles)}), the meaning of {names} is unknown. "
            "Give them these names, or pos, vel, frc, forces, compute_forces, acc, mass, h, timestep, p, x_old, "
            "v_half; m may be left out"
        )

    old = {name for name in roles if re.search(IS_BEFORE, name.lower())}
    forces = [name for name, role in roles.items() if role in FORCES]
    arrays = {name: f"known {roles[name]}" for name in forces}
    choices = [{}, arrays] if forces else [{}]
    if len(forces) > 1:

        def likeness(name: str) -> tuple[bool, bool, int]:
            is_function = bool(re.search(IS_FUNCTION, name.lower()))
            return is_function, name not in old, len(name)

        del arrays[max(forces, key=likeness)]
        if len(arrays) > 1:
            arrays |= {name: f"before {roles[name]}" for name in arrays if name in old}
        choices = [arrays]

    all_masses = [*MASSES] if "m" in places else ["one number"]
    all_answers = ANSWERS if forces else ANSWERS[:1]
    for kinds, shape, masses, answers in product(choices, SHAPES, all_masses, all_answers):
        if len(shape) >= MASSES[masses]:
            yield StudentStep(function, roles | kinds, shape, masses, answers)


class StudentStep:
    """A student's step as a map of (x, v) to (x, v), called in one manner.

    names : roles of the parameters, by name; "known force" is the force at x as an array, "before force" the one a
        step earlier.
    roles : without the names.
    masses, answers : how masses are given, and what force(x) returns.
    n_evaluations : how often it called the force function.
    third : the force that it returned last as its third result, if any.
    swapped, in_place : whether it returns v first; whether it changes x or v in place.
    rows_alike : whether it returned a path whose rows are all the same.
    stiffness : of the oscillator inside a step without a force function.
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
        self.parts_of_roles = {*" ".join(self.roles).split()}
        kinds = {"x": SHAPE_NAMES[shape], "m": masses}
        kinds |= dict.fromkeys(FORCES, f"a function: {answers}")
        arguments = [
            f"{name}: {kinds[role]}" if role in kinds else name for name, role in roles.items()
        ]
        self.call_text = f"{getattr(function, '__name__', 'step')}({', '.join(arguments)})"

    def takes(self, *parts: str) -> bool:
        """Whether one of these words is in the roles of the parameters."""
        return not self.parts_of_roles.isdisjoint(parts)

    def problem(self, seed: int, stiffness: float = 0.0) -> TrialProblem:
        """A state in the shape of the step; masses are 1 if the step takes neither masses nor accelerations."""
        has_one_mass = self.masses == "one number"
        where = problem(self.shape, seed, has_one_mass, stiffness or self.stiffness)
        if self.takes("m", "acceleration"):
            return where
        return where._replace(m=np.ones_like(where.m))

    def __call__(self, where: TrialProblem, x: Array, v: Array, h: float) -> tuple[Array, Array]:
        """One step.  Raises what the function raises, and ValueError for results that are not x and v."""
        roles = self.roles
        copied: Any = float if x.ndim == 0 else np.array
        half = v
        if self.takes("half", "old"):
            half = v - 0.5 * h * where.force(x) / where.mass
        before = x
        if self.takes("before"):
            before = x - h * v + 0.5 * h * h * where.force(x) / where.mass
        start = {"x": x, "v": v, "p": where.mass * v, "half": half, "old": x - h * half}
        for role in roles:
            when, _, force = role.partition(" ")
            if force:
                start[role] = where.scaled(force, before if when == "before" else x)

        arguments: dict[str, Any] = {
            "m": self._masses(where),
            "dt": h,
            "time": 0.0,
            "box": FAR,
            "steps": 1,
            "state": [copied(x), copied(v)],
        }
        for role, array in start.items():
            arguments[role] = copied(array)
        for role in FORCES:
            arguments[role] = self._force(role, where)
        answer = self.function(**{name: arguments[role] for name, role in self.names.items()})

        if "state" in roles:  # of a step that takes and returns both in one array or list
            parts = self._parts(arguments["state"] if answer is None else answer, x.shape)
            return parts[0], parts[1]
        of_v = next((role for role in VELOCITIES if role in roles), "v")
        own = [arguments["x"], arguments[of_v]]
        is_changed = [not np.array_equal(arguments[role], start[role]) for role in ("x", of_v)]
        self.in_place |= any(is_changed)
        if answer is None:
            if not self.in_place:
                raise ValueError(
                    "the step returns None and does not change x and v; it must return x, v"
                )
            answer = own
        elif all(is_changed) and not isinstance(answer, (tuple, list, dict)):
            answer = [*own, answer]  # changed in place; the result may be the force
        parts = self._parts(answer, x.shape)

        new_x = parts[0]
        if "old" in roles:  # v as returned, else the velocity at the half step plus half a kick
            returned = next((part for part in parts[1:3] if not np.array_equal(part, x)), x)
            if largest(returned - v) < largest(returned - x):
                return new_x, returned
            new_v = (new_x - x) / h
        elif self.swapped:
            new_v, new_x = parts[:2]
        else:
            new_v = parts[1]
        if of_v == "p":
            new_v = new_v / where.mass
        elif of_v != "v":
            new_v = new_v + 0.5 * h * where.force(new_x) / where.mass
        return new_x, new_v

    def _masses(self, where: TrialProblem) -> Any:
        """Masses as the step takes them, a copy."""
        if self.masses == "one number":
            return float(where.m.flat[0])
        masses = where.m.copy()
        return masses[:, None] if self.masses == "(N, 1)" else masses

    def _force(self, role: str, where: TrialProblem) -> Function:
        def force(x: Any, *_: Any) -> Any:
            self.n_evaluations += 1
            x = np.array(x, dtype=float)
            if x.size != where.x.size:
                raise TypeError(
                    f"the step calls its force with numbers of shape {x.shape}, but positions have shape "
                    f"{where.x.shape}; f(y, t) of a whole state, as for SciPy, cannot be graded: write step(x, v, "
                    "force, m, dt)"
                )
            answer: Any = where.scaled(role, x)
            if x.ndim == 0:
                answer = float(answer)
            if self.answers == "F":
                return answer
            energy = where.at(x)[1]
            return (answer, energy) if self.answers == "(F, U)" else (energy, answer)

        return force

    def _parts(self, answer: Any, shape: tuple[int, ...]) -> list[Array]:
        """The arrays in the result, x and v first; the last rows of a path."""
        if isinstance(answer, dict):
            ranks = {"x": 0, "v": 1}
            names = sorted(answer, key=lambda name: ranks.get(role_of(name), 2))
            answer = [answer[name] for name in names]
        is_many = isinstance(answer, (np.ndarray, tuple, list))
        if is_many and not self.takes("state"):
            is_many = np.shape(answer) != shape
        parts = [np.array(part, dtype=float) for part in (answer if is_many else [answer])]

        if self.takes("steps"):
            path = parts[0]
            is_path = path.shape[1:] == shape and len(path) > 1
            self.rows_alike = is_path and not np.ptp(path, axis=0).any()
            parts = [part[-1] if part.ndim and part.shape[1:] == shape else part for part in parts]

        n_needed = 1 if self.takes("old") else 2
        if len(parts) < n_needed or {part.shape for part in parts[:2]} != {shape}:
            shapes = ", ".join(str(part.shape) for part in parts)
            raise ValueError(
                f"the step must return x and v in the shape {shape} of its arguments; it returned shapes {shapes}"
            )

        self.third = np.array([])
        if len(parts) > 2 and parts[2].shape == shape:
            self.third = parts[2]
        return parts

    def find_own_force(self) -> None:
        """Find the spring inside a step that takes no force function.  Raises TypeError if its force is not −k x."""
        self.stiffness = 1.0
        where = self.problem(0)
        rate = self(where, where.x, 0.0 * where.v, TINY)[1] / TINY
        k = -np.sum(rate * where.x) / np.sum(where.x**2)
        off = largest(rate + k * where.x)
        if not k > 0.0 or off > 1e-4 * max(k, 1.0):
            raise TypeError(
                "the step takes no force function, and its own force is not that of a spring, −k x: make the force "
                "function an argument, as step(x, v, force, m, dt)"
            )
        self.stiffness = round(k, 5)


def understood(function: Function) -> StudentStep:
    """The step, called in the first manner that works.

    Raises TypeError for other arguments, and ValueError for a step that fails in every manner, with the first error
    and its call.
    """
    failures = list[tuple[str, Exception]]()
    for step in manners(function):
        where = step.problem(0)
        try:
            with np.errstate(all="ignore"):
                x, v = step(where, where.x, where.v, TINY)
        except Exception as error:  # whatever a student's function raises
            failures.append((step.call_text, error))
            continue
        if not (np.isfinite(x).all() and np.isfinite(v).all()):
            raise ValueError(
                f"the step returned numbers that are not finite after one step of {TINY:g}, called as {step.call_text}"
            )

        in_order = largest(x - where.x) + largest(v - where.v)
        swapped = largest(v - where.x) + largest(x - where.v)
        step.swapped = bool(swapped < 0.01 * in_order) and not step.takes("old", "p")
        if not step.takes(*FORCES):
            step.find_own_force()
        return step
    call_text, cause = failures[0]
    raise ValueError(
        f"the step failed when it was called as {call_text}, and in every other manner: {type(cause).__name__}: {cause}"
    ) from cause


class StudentForce(Called):
    """A student's force function.

    kind, dimensions : what it is called as; one of KINDS.
    is_squared : whether the law takes r².
    has_energy : whether it also returns an energy.
    names : of the parameters without defaults.
    values : what is given for those after the positions.
    takes : their roles.
    physical : values of ε, σ and others, by name.
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
        first = self.first
        if not self.names and first and first.kind not in (first.KEYWORD_ONLY, first.VAR_KEYWORD):
            # of a function that takes *args, or whose parameters all have defaults
            self.names = [first.name]
            self.defaults.pop(first.name, None)
        if not self.names:
            raise TypeError(
                f"{self.name} has no parameter for the positions; a force function is called as forces(positions)"
            )

        name = plain(self.names[0])
        self.is_squared = re.search(SQUARED, name)
        self.is_of_two = False
        if len(self.names) > 1 and not self.is_squared and kind != "law":
            self.is_of_two = all(re.search(ONE_OF_TWO, plain(name)) for name in self.names[:2])

        taken = self.names[1 + self.is_of_two :]
        unknown = [name for name in taken if self.roles[name] not in options]
        if unknown and kind != "law":
            raise TypeError(
                f"{self.name} takes ({', '.join(self.names)}), and the meaning of {unknown[0]} is not known; pass a "
                f"function of positions only, such as lambda x: {self.name}(x, …), or pass cell= and cutoff="
            )
        taken += [name for name in self.defaults if options.get(f"{self.roles[name]} given")]
        self.values = {name: options.get(self.roles[name], 1.0) for name in taken}
        self.takes = {self.roles[name] for name in taken}

        has_stiffness = "stiffness" in self.roles.values()  # then a rest length is physical, too
        self.physical = dict[str, float]()
        for parameter, value in {**self.defaults, **self.values}.items():
            is_length = has_stiffness and re.search(REST, plain(parameter))
            is_number = isinstance(value, (int, float)) and not isinstance(value, bool)
            if is_number and value > 0 and (self.roles[parameter] in PHYSICAL or is_length):
                self.physical[parameter] = float(value)

        kinds = ["forces"]
        if kind:
            kinds = [kind]
        elif self.is_squared:
            kinds = ["law"]
        elif self.is_of_two:
            kinds = ["pair"]
        else:
            if re.search(SEPARATION, name):
                kinds.insert(0, "pair")
            if re.search(DISTANCE, name):
                kinds.insert(0, "law")
        self._look(kinds, positions)

    def _look(self, kinds: list[str], positions: Array | None) -> None:
        """Find the kind, and the place of the energy in the result.  Raises ValueError for functions that cannot be
        called, and results of other shapes."""
        misfits = list[str]()
        trials = [(kind, 3) for kind in kinds]
        if kinds[-1] == "forces" and positions is None:
            trials.append(("forces", 2))
        for self.kind, self.dimensions in trials:
            x: Any = TRIANGLE[:, : self.dimensions] if positions is None else positions
            if self.kind == "pair":
                x = SEPARATE
            elif self.kind == "law":
                x = START**2 if self.is_squared else START
            try:
                answer = self.answer(x)
                misfits.append(self._misfit(answer, np.shape(x), "pair" in kinds))
            except Exception as error:  # whatever a student's function raises
                misfits.append(f"{np.shape(x)}, and raised {type(error).__name__}: {error}")
            if not misfits[-1]:
                return
        raise ValueError(
            f"{self.name}({', '.join(self.names)}) was called with {self.names[0]} of shape {misfits[len(kinds) - 1]}. "
            f"If {self.name} is written for a fixed number of atoms, pass them: positions=..."
        )

    def _misfit(self, answer: Any, shape: tuple[int, ...], may_be_pair: bool) -> str:
        """What is wrong with a result for an argument of a shape; "" if nothing is."""
        has_parts = isinstance(answer, tuple) or (isinstance(answer, list) and shape == ())
        shapes = [np.shape(part) for part in (answer[:2] if has_parts else [answer])]
        is_right = answer is not None and shape in shapes and {*shapes} <= {shape, ()}
        if not is_right or len(shapes) <= has_parts:
            returned = "None"
            if answer is not None:
                returned = f"shape {', '.join(map(str, shapes))}"
            return f"{shape}, and returned {returned}; forces must have the shape of the positions"
        if self.kind == "law" and may_be_pair and self._is_vector():
            return "(), but is a function of the vector r_ij"
        self.has_energy = len(shapes) > 1 and () in shapes
        self.energy_first = None
        if has_parts:
            self.energy_first = shapes[0] != shape if shape else self._energy_is_first()
        return ""

    def _is_vector(self) -> bool:
        """Whether the result for r_ij is a vector, whose components do not each depend on one component only."""
        try:
            number = self.answer(START)
            vector = self.answer(SEPARATE)
        except Exception:  # whatever a student's function raises
            return False
        numbers = number if isinstance(number, tuple) else (number,)
        vectors = vector if isinstance(vector, tuple) else (vector,)
        return any(np.shape(part) == (3,) and part[0] not in numbers for part in vectors)

    def answer(self, x: Any) -> Any:
        """What the function returns.  x : in the shape of the kind: (N, 3), a distance, or a vector."""
        first = np.array(x, dtype=float)
        values = {**self.values}
        for name in values:
            if self.roles[name] == "n":
                values[name] = len(first)
        if self.is_of_two:
            values[self.names[1]] = np.zeros(3)
        in_order = [values.pop(name) for name in self.names[1:]]
        argument = first if first.ndim else float(first)
        with np.errstate(all="ignore"):
            answer = self.function(argument, *in_order, **values)
        self.changes_input |= not np.array_equal(first, np.array(x, dtype=float))
        return answer

    def __call__(self, x: Any) -> tuple[Array, float | Array]:
        """F and U (NaN if there is none)."""
        answer = self.answer(x)
        if self.energy_first is None:
            return np.asarray(answer, dtype=float), np.nan
        f, u = answer[:2]
        if self.energy_first:
            u, f = f, u
        if not self.has_energy:
            u = np.nan
        return np.asarray(f, dtype=float), np.asarray(u, dtype=float)

    def _energy_is_first(self) -> bool:
        """Whether the first of two numbers of a law is the energy: the other one is its slope times a power of r."""
        r = np.linspace(0.95, 1.6, 12)
        answers = list[Any]()
        for change in (-1e-4, 0.0, 1e-4):
            places = (r + change) ** 2 if self.is_squared else r + change
            answers.append([self.answer(place)[:2] for place in places])
        before, at, after = np.array(answers, float)

        def off(u: int) -> float:
            slopes = after[:, u] - before[:, u]
            logs = np.log(np.abs(at[:, 1 - u] / slopes))
            logs = logs[np.isfinite(logs)]
            if not logs.size:
                return np.inf
            return np.median(np.abs(logs - np.median(logs)))

        return off(0) <= off(1)
