"""The grade of a step: its order, its symmetries, the quantities that it conserves,
and the faults that its first terms show."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np

from minimd.grade.calling import FORCES, StudentStep, understood
from minimd.grade.expansion import expansion, explained
from minimd.grade.findings import Finding, Grade
from minimd.grade.motion import cost, energy, momenta, order_of, oscillator, reversal, symplecticity
from minimd.grade.problems import Problem
from minimd.grade.variants import FEW, NOT_SYMPLECTIC, nearest_method, recognized, substeps_of, told

HIGH = 2.5  # a step of a higher measured order has the right terms up to dt², and need not be symmetric
ROUNDING = 1e-9  # smaller relative differences are rounding
SINGLE = 1e-8  # a step with more noise uses float32
# by the shape of x: the number of states needed to distinguish all terms
STATES = {(5, 3): 4, (5, 2): 5, (5,): 8, (): 24}
SHORT = 1e-7  # a time step so short that nothing should change
CHANGED = 1e-4
FASTER = (1.0, 30.0)  # factors by which velocities are multiplied to find a limit


def grade_step(function: Callable[..., Any], order: int = 2) -> Grade:
    """See grade."""
    step = understood(function)
    problems = [step.problem(seed) for seed in range(STATES[step.manner.shape])]
    called = step.manner.told(getattr(function, "__name__", "step"))
    remarks = _remarks(step, problems[0])
    with np.errstate(all="ignore"):
        faults = _hidden(step, problems[0])
        if faults:
            return Grade(
                called, (Finding("a map of x and v", False, faults[0]),), tuple(faults), remarks=tuple(remarks)
            )
        noise = noise_of(step, problems[0])
        findings = [
            order_of(step, problems[0], order),
            reversal(step, problems[0], noise),
            *symplecticity(step, problems[0], noise),
        ]
        is_high = findings[0].value > HIGH
        if (
            is_high and findings_of(findings, "symplectic").passed
        ):  # Ruth's method of order 3 is right, and not symmetric
            findings[1] = replace(findings[1], passed=findings[1].passed or None)
        if any(role.startswith("before") for role in step.manner.roles):
            remarks.append(
                "a step that takes the force of the previous step is not a map of x and v, and is not judged as one"
            )
            findings[1:] = [replace(finding, passed=None) for finding in findings[1:]]
        findings += [
            *momenta(step, problems[0], noise),
            energy(step, problems[0]),
            oscillator(step),
            cost(step, problems[0]),
        ]
        method, wrong = recognized(
            step(problems[0], problems[0].x, problems[0].v, 0.1), problems[0], 0.1, max(ROUNDING, 10.0 * noise)
        )
        if wrong == NOT_SYMPLECTIC and order == int(method[2]) and findings[0].passed:
            return Grade(called, _as_runge_kutta(findings), (), method, (*remarks, wrong))
        faults = [wrong] if wrong else _faults(step, problems, noise, is_high)
        if wrong == NOT_SYMPLECTIC:
            faults = [f"{wrong}. If it is meant, ask for its order: md.grade(step, order={method[2]})"]
        if not wrong and findings_of(findings, "energy").value == 0.0:
            faults = []
        parts = substeps_of(step, problems[0]) if not method else None
        method = told(parts) if parts else method
        faults += _of_substeps(parts, findings, order) if parts and not (faults and _is_plain(parts)) else []
    faults += _structural(findings, step) if not faults else []
    return Grade(called, tuple(findings), tuple(faults), method, tuple(remarks))


def _as_runge_kutta(findings: list[Finding]) -> tuple[Finding, ...]:
    """Findings of a correct Runge-Kutta method, if its order was given:
    laws that no such method obeys do not count as faults."""
    return tuple(replace(finding, passed=None) if finding.passed is False else finding for finding in findings)


def findings_of(findings: list[Finding], name: str) -> Finding:
    """The finding with this name."""
    return next(finding for finding in findings if finding.name == name)


def _hidden(step: StudentStep, where: Problem) -> list[str]:
    """The reason why the step is not a function of x and v, such as noise or memory; empty if it is one."""
    first = step(where, where.x, where.v, 0.1)
    step.n_evaluations = 0
    second = step(where, where.x, where.v, 0.1)
    if step.n_evaluations == 0 and any(role in FORCES for role in step.manner.roles):
        return [
            "the step does not compute the force: it called the force function in its first call, or never, and keeps "
            "using that result"
        ]
    off = max(float(np.abs(a - b).max()) for a, b in zip(first, second, strict=True))
    if off == 0.0:
        return []
    state = np.random.get_state()
    ends = []
    for _ in range(2):
        np.random.seed(1)
        ends.append(step(where, where.x, where.v, 0.1))
    np.random.set_state(state)
    if all(np.array_equal(a, b) for a, b in zip(*ends, strict=True)):
        return [
            f"the step draws random numbers: two steps from the same state differ by {off:.1e}. The step contains a "
            "thermostat"
        ]
    return [f"two steps from the same x and v differ by {off:.1e}: the step draws random numbers, or remembers earlier "
            "calls, such as a force "
            "that is kept outside. What a step needs must be among its arguments"]  # fmt: skip


def _remarks(step: StudentStep, where: Problem) -> list[str]:
    remarks = []
    if step.swapped:
        remarks.append("the step returns v before x; the usual order is x, v")
    if step.in_place:
        remarks.append("the step changes the arrays that it is given; copy them before if you need the old ones")
    if step.manner.masses == "(N, 1)":
        remarks.append("it does not work with masses of shape (N,); it was called with shape (N, 1)")
    if "half" in step.manner.roles:
        remarks.append("velocities are at half steps: half a kick was made before and after")
    if "old" in step.manner.roles:
        remarks.append("the step is a recursion of two positions; velocities are (x₁ − x₀)/dt + ½ dt F/m")
    return remarks


def noise_of(step: StudentStep, where: Problem) -> float:
    """Rounding of a step, relative to the coordinates, from third differences along a line of states 1e-6 apart."""
    line = np.array([np.ravel(step(where, where.x * (1.0 + 1e-6 * k), where.v, 0.1)[0]) for k in range(12)])
    return float(np.abs(np.diff(line, n=3, axis=0)).max() / 8.0 / np.abs(where.x).max())


def _faults(step: StudentStep, problems: list[Problem], noise: float, is_high: bool) -> list[str]:
    faults = same_rows(step, problems[0])
    if noise > SINGLE:
        faults.append(
            f"the step rounds to {noise:.0e} of the coordinates: it uses float32 somewhere; float64 rounds to 1e-16"
        )
    faults += (
        _left_out(step, problems) or (_wrapped(step, problems[0]) if not faults else []) or _thermostat(step, problems)
    )
    faults += clipped(step, problems[0]) if not faults else []
    if not faults and not is_high:
        scaled = step.is_scaled
        faults += explained(expansion(step, problems, scaled))
    if step.third is not None and any(role.startswith("known") for role in step.manner.roles):
        where, role = problems[0], next(role.split()[1] for role in step.manner.roles if role.startswith("known"))
        force = where.force(step(where, where.x, where.v, 0.1)[0])
        right = {"force": force, "acceleration": force / where.mass, "gradient": -force}[role]
        off = float(np.abs(step.third - right).max() / np.abs(right).max()) if step.third is not None else 0.0
        if off > ROUNDING:
            faults.append(
                f"the force that is returned is not the one at the new positions (off by {off:.1%}): the next step "
                "would begin with an old force"
            )
    return faults


def _left_out(step: StudentStep, problems: list[Problem]) -> list[str]:
    """Faults for atoms or axes that are not moved, or not kicked."""
    faults: list[str] = []
    if problems[0].x.ndim == 0:
        return faults
    ends = [step(where, where.x, where.v, 0.1) for where in problems]
    for part, verb, starts in ((0, "moved", [one.x for one in problems]), (1, "kicked", [one.v for one in problems])):
        still = np.all([end[part] == start for end, start in zip(ends, starts, strict=True)], axis=0)
        if still.all() or not still.any():
            continue
        for axis, what in ((1, "atom"), (0, "axis")):
            alone: Any = (
                []
                if still.ndim <= axis and what == "axis"
                else np.flatnonzero(still.all(axis=axis) if still.ndim > 1 else still)
            )
            if len(alone) and (what == "atom" or still.ndim > 1):
                last = ", the last," if what == "atom" and list(alone) == [len(still) - 1] else ""
                faults.append(
                    f"{what} {', '.join(map(str, alone))}{last} is not {verb}: check the bounds of the loop, such as "
                    "range(N − 1)"
                )
                break
    return faults


def _wrapped(step: StudentStep, where: Problem) -> list[str]:
    """The fault of positions that are wrapped, found by starts farther and farther away;
    the forces of the test have no cell."""
    if where.x.ndim == 0 or where.stiffness:
        return []
    new, _ = step(where, where.x, where.v, 0.02)
    for distance in 1.375 * 2.0 ** np.arange(12):
        for shift in (-distance, distance):
            far, _ = step(where, where.x + shift, where.v, 0.02)
            jump = np.abs(far - shift - new)
            if jump.max() > 1e-6:
                cell = f"{jump[jump > 1e-6].min():.6g}"
                return [
                    f"atoms that start {distance:g} farther away are moved by {cell} more: positions are wrapped "
                    f"into a box with this edge inside the "
                    "step, or it depends on the place of the origin. Wrap positions that are written, not those "
                    "that are integrated"
                ]
    return []


def _thermostat(step: StudentStep, problems: list[Problem]) -> list[str]:
    """The fault of velocities that are rescaled, at once or at a rate that depends on the state,
    or whose mean motion is removed."""
    where = problems[0]
    if where.x.ndim == 0:
        return []
    h = 1e-7
    changes = [step(one, one.x, one.v, h)[1] - one.v for one in problems]
    if np.abs(changes[0]).max() > 1e-4:
        if np.abs(changes[0] - changes[0].mean(axis=0)).max() < 1e-5:
            return [
                "the mean motion is removed in each step: all velocities change by the same vector. Do this only once, "
                "at the start"
            ]
        factors = [
            float(np.sum(change * one.v) / np.sum(one.v**2)) for change, one in zip(changes, problems, strict=True)
        ]
        rests = [np.abs(change - c * one.v).max() for change, c, one in zip(changes, factors, problems, strict=True)]
        if max(rests) < 1e-5 and np.ptp(factors) > 1e-4:
            told = ", ".join(f"{1.0 + c:.4g}" for c in factors[:3])
            return [f"velocities are multiplied by {told}, … in each step, even in the shortest one: they are rescaled "
                    "to a temperature, the step "
                    "contains a thermostat"]  # fmt: skip
        return []
    rates = []
    for change, one in zip(changes, problems, strict=True):
        basis = np.array([np.ravel(one.v), np.ravel(one.force(one.x) / one.mass)]).T
        found, *_ = np.linalg.lstsq(basis, np.ravel(change) / h, rcond=None)
        if np.abs(np.ravel(change) / h - basis @ found).max() > 1e-4:
            return []
        rates.append(float(found[0]))
    if np.ptp(rates) < 1e-4:
        return []
    told = ", ".join(f"{rate:.3g}" for rate in rates[:3])
    return [
        f"velocities change by {told}, … dt v in addition to the kick, at a rate that depends on the state: "
        "the step contains a thermostat such as Berendsen's"
    ]


def _is_plain(parts: list[tuple[str, float]]) -> bool:
    """Whether these are the substeps of a method of order 1 or 2, whose faults the first terms show."""
    return sum(kind == "kick" for kind, _ in parts) < FEW


def _of_substeps(parts: list[tuple[str, float]], findings: list[Finding], order: int) -> list[str]:
    """The fault of a sequence of three kicks or more of lower order than expected,
    or than a method with nearly its weights: weights are wrong."""
    kicks, reached = sum(kind == "kick" for kind, _ in parts), findings[0].value
    near = nearest_method(parts) if kicks >= FEW else ""
    if kicks < FEW or reached > (max(order - 0.5, HIGH) if near else order - 0.5):
        return []
    near = (
        f": {near}"
        if near
        else "; print(md.integrators.METHODS) lists those that have more, and md.integrators.CandyRozmus4.substeps "
        "their weights"
    )
    return [
        f"{kicks} kicks in a step, but no more than order {reached:.1f}: the weights of the substeps are not those of "
        f"a method of higher order{near}"
    ]


def clipped(step: StudentStep, where: Problem) -> list[str]:
    """A limit of the components of velocities, or of speeds: larger values are reduced to it,
    smaller ones do not change."""
    if where.x.ndim == 0:
        return []
    for faster in FASTER:
        v = faster * where.v
        _, new = step(where, where.x, v, SHORT)
        for what, old, now in (
            ("components of velocities", np.abs(v), np.abs(new)),
            ("speeds", _speeds(v), _speeds(new)),
        ):
            cut = np.abs(now - old) > CHANGED * faster
            if cut.sum() < 2 or (cut.all() and faster == 1.0):
                continue
            limit = float(now[cut].mean())
            if (
                np.ptp(now[cut]) < CHANGED
                and old[cut].min() > limit
                and (cut.all() or old[~cut].max() < limit + CHANGED * faster)
            ):
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
            return [
                "all rows of the path are alike: the array is changed in place after it was appended. Append a copy, "
                "as in xs.append(x.copy())"
            ]
    return []


def _structural(findings: list[Finding], step: StudentStep) -> list[str]:
    """Sentences for laws that fail although the first terms are right."""
    failed = {finding.name: finding for finding in findings if finding.passed is False}
    faults = []
    if "energy" in failed and failed["energy"].value == 0.0:
        faults.append("the energy is kept to rounding: velocities are rescaled in each step to keep it, which hides "
                      "the error of the step and is neither "
                      "symplectic nor reversible")  # fmt: skip
    if "order" in failed:
        faults.append(f"the first terms are right, but the measured order is {failed['order'].value:.2f}")
    if "momentum" in failed:
        faults.append(
            "the total momentum changes: the forces of a step are not all computed at the same positions, or atoms are "
            "moved one after another"
        )
    if "symplectic" in failed and "volume" in failed:
        faults.append(
            "the step shrinks or stretches phase space (see volume), as Runge-Kutta methods and thermostats do: its "
            "energy drifts"
        )
    elif "symplectic" in failed:
        faults.append("the step is not symplectic: it is not a product of kicks and drifts")
    elif "reversible" in failed:
        faults.append(
            "the step is symplectic, but not symmetric: kicks and drifts do not read the same forwards and backwards"
        )
    return faults
