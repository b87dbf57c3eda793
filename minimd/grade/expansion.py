"""The first terms of a step in powers of Δt, and the meaning of each wrong coefficient.

    x₁ = x + Δt v + ½ Δt² F/m + …              v₁ = v + Δt F/m + ½ Δt² J v + …         J v = d/dt F/m along v

The terms are measured by extrapolation to Δt = 0 and written as combinations of v, F/m, J v, and of terms that come
from faults, such as F and F/m², if a division by m is missing or made twice. For methods of order 2 both coefficients
of Δt² are ½. A step of order 1 has other coefficients, which show the force and the velocity that it used.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from minimd.grade.findings import coefficient, is_near
from minimd.grade.problems import Array, Problem

Map = Callable[[Problem, Array, Array, float], tuple[Array, Array]]
SPACING, N_STEPS = 0.01, 8  # time steps for the extrapolation: SPACING · 1 … N_STEPS
SMALL = 1e-5  # coefficients below it are zero
UNEXPLAINED = 1e-4  # a term with a larger relative rest is not a combination of the known terms
DIFFERENCE = 1e-3  # of x along v, for the derivative J v

SECOND_ORDER = {  # coefficients of Δt² F/m in x, and of Δt² J v in v, times two
    (
        0,
        0,
    ): "explicit Euler: positions move with the old velocity and velocities with the old force; order 1, the energy "
    "grows. Kick first, then let the positions move with the new velocity",
    (
        2,
        0,
    ): "symplectic Euler, kick first (v += dt F/m, then x += dt v): order 1. Kick by half a step before the drift and "
    "by half a step with "
    "the new force after it; or, if velocities are meant to be at half steps (leapfrog), start the run with half a "
    "kick: v(dt/2)",
    (
        0,
        2,
    ): "symplectic Euler, drift first (x += dt v, then v += dt F(new x)/m): order 1. The kick must be split into two "
    "halves, one before and one after the drift",
    (
        1,
        0,
    ): "the second half kick uses the old force F(x(t)): the force must be computed again after the positions have "
    "moved; order 1",
    (1, 2): "your half step uses the new force twice: velocities are kicked by dt F(x(t+dt))/m, without the old force "
    "F(x(t)). Keep a copy of the old force before it is computed again; order 1",
    (
        2,
        1,
    ): "positions move by dt² F/m in place of ½ dt² F/m: the factor ½ is missing, or the first kick is that of a whole "
    "step",
    (0, 1): "positions move with the old velocity, x += dt v(t): the term ½ dt² F/m is missing (the drift must use the "
    "velocity at half a step)",
    (
        1,
        0.5,
    ): "the second half kick uses the force at the middle of the drift, F(x + dt/2 v): it must be computed at the new "
    "positions; order 1",
    (
        2,
        2,
    ): "the new force and the new velocity are used where their means with the old ones are needed, as in an implicit "
    "Euler step: order 1",
}


class Expansion(NamedTuple):
    """Coefficients by power of Δt and by term, of positions and of velocities.

    rests : relative norms of what no term explains.  places : the atoms or axes that are wrong, in words,
        by part and power; "" if all are.
    """

    x: tuple[dict[str, float], ...]
    v: tuple[dict[str, float], ...]
    rests: tuple[tuple[float, ...], tuple[float, ...]]
    places: tuple[tuple[str, ...], tuple[str, ...]]


def series(step: Map, where: Problem) -> tuple[Array, Array]:
    """Coefficients of Δt⁰, Δt¹, Δt² of x₁ − x and of v₁ − v, (3, *shape) each."""
    times = SPACING * np.arange(1, N_STEPS + 1)
    ends = [step(where, where.x, where.v, h) for h in times]
    matrix = np.vander(times / times[-1], increasing=True)
    both = []
    for part, start in zip(zip(*ends, strict=True), (where.x, where.v), strict=True):
        changes = (np.array(part) - start).reshape(N_STEPS, -1)
        powers = np.linalg.solve(matrix, changes)[:3] / times[-1] ** np.arange(3)[:, None]
        both.append(powers.reshape(3, *start.shape))
    return both[0], both[1]


def terms(where: Problem) -> dict[str, Array]:
    """The terms of which the series may consist."""
    ahead, behind = (where.force(where.x + side * where.v) for side in (DIFFERENCE, -DIFFERENCE))
    further, back = (where.force(where.x + 2 * side * where.v) for side in (DIFFERENCE, -DIFFERENCE))
    turning = (8.0 * (ahead - behind) - (further - back)) / (12.0 * DIFFERENCE)
    force, m = where.force(where.x), where.mass
    one = {
        "v": where.v,
        "F/m": force / m,
        "F": force,
        "F/m²": force / m**2,
        "mF": force * m,
        "Jv": turning / m,
        "mJv": turning,
        "x": where.x,
    }
    return {name: np.asarray(value, dtype=float) for name, value in one.items()}


def expansion(step: Map, problems: list[Problem], has_masses: bool) -> Expansion:
    """The expansion of a step, measured on several states at once, so that no two terms are alike."""
    measured = [series(step, where) for where in problems]
    names = ["v", "F/m", *(["F", "F/m²", "mF"] if has_masses else []), "x"]
    known = [terms(where) for where in problems]
    answers: list[list[dict[str, float]]] = [[], []]
    rests: list[list[float]] = [[], []]
    for of_velocity in (0, 1):
        for power in range(3):
            basis = [*names, *(["Jv", *(["mJv"] if has_masses else [])] if power == 2 else [])]
            if problems[0].stiffness:  # for a spring, x and F/m are proportional, and so are v and J v
                basis = ["Jv" if of_velocity and power == 2 else "v", "F/m"]
            target = np.concatenate([np.ravel(one[of_velocity][power]) for one in measured])
            matrix = np.array([np.concatenate([np.ravel(one[name]) for one in known]) for name in basis]).T
            found = np.linalg.lstsq(matrix, target, rcond=None)[0]
            rest = float(
                np.linalg.norm(target - matrix @ found) / max(np.linalg.norm(target), 0.1 * np.sqrt(target.size))
            )
            small = SMALL * max(1.0, float(np.abs(found).max())) ** 3  # the larger the terms, the larger their rounding
            answers[of_velocity].append(
                {name: float(c) for name, c in zip(basis, found, strict=True) if abs(c) > small}
            )
            rests[of_velocity].append(rest)
    expected = [("", "v", "F/m"), ("", "F/m", "Jv")]
    places = []
    for of_velocity in (0, 1):
        series_of_first, told = measured[0][of_velocity], []
        for power, name in enumerate(expected[of_velocity]):
            right = known[0][name] * (0.5 if power == 2 else 1.0) if name else 0.0 * problems[0].x
            told.append(_places(series_of_first[power] - right, right))
        places.append(tuple(told))
    masses = _one_mass(measured[0][1][1], known[0]["F"], problems[0])
    return Expansion(
        tuple(answers[0]),
        tuple(answers[1]),
        (tuple(rests[0]), tuple(rests[1])),
        (places[0], (places[1][0], masses or places[1][1], places[1][2])),
    )


def _places(off: Array, right: Array) -> str:
    """The atoms or axes for which a term is wrong, in words; empty if it is wrong for all or for none."""
    if off.ndim == 0:
        return ""
    bad = np.abs(off) > 1e-4 * max(1.0, float(np.abs(right).max()))
    if bad.ndim > 1 and 0 < bad.any(axis=0).sum() < bad.shape[1]:
        return ", along " + " and ".join("xyz"[k] for k in np.flatnonzero(bad.any(axis=0)))
    atoms = bad.reshape(len(bad), -1).any(axis=1)
    return f", of atom {', '.join(map(str, np.flatnonzero(atoms)))} of {len(bad)}" if 0 < atoms.sum() < len(bad) else ""


def _one_mass(change: Array, force: Array, where: Problem) -> str:
    """A sentence if all forces are divided by the same mass, such as that of one atom or the mean; else empty."""
    if where.m.ndim == 0 or np.ptp(where.m) == 0.0:
        return ""
    flat, forces = change.reshape(len(where.m), -1), force.reshape(len(where.m), -1)
    ratio = (flat * forces).sum(axis=1) / (forces * forces).sum(axis=1)
    if np.ptp(ratio) > 1e-5 * np.abs(ratio).max():
        return ""
    means = {
        "the mean mass": where.m.mean(),
        "the sum of all masses": where.m.sum(),
        **{f"the mass of atom {k}": m for k, m in enumerate(where.m)},
    }
    return next(
        (
            f"; all forces are divided by {name}, instead of each by the mass of its atom"
            for name, m in means.items()
            if is_near(float(ratio[0] * m), 1.0)
        ),
        "",
    )


def explained(found: Expansion) -> list[str]:
    """The faults that the powers up to Δt² show, in words; empty for a method that seems to have order 2."""
    if faults := _jumps(found):
        return faults
    parts = list(zip(("positions", "velocities"), ("dx/dt = v", "dv/dt = F/m"), found.rests, found.places, strict=True))
    for part, law, rest, place in parts:
        if rest[1] > UNEXPLAINED:
            return [
                f"for short steps {part} do not change as {law} says: {rest[1]:.1%} of the change is something "
                f"else{place[1]}"
            ]
    if faults := [*_first_power_of_x(found.x[1], found.x[2]), *_first_power_of_v(found.v[1], found.v[2])]:
        return faults
    for part, _, rest, place in parts:
        if rest[2] > UNEXPLAINED:
            return [
                f"{part} contain a term of order dt² that is not that of Newton's equation: {rest[2]:.1%} of it is "
                f"something else{place[2]}; order 1"
            ]
    return _second_power(found)


def _jumps(found: Expansion) -> list[str]:
    faults = []
    x, v = found.x[0], found.v[0]
    for part, rest in zip(("positions", "velocities"), found.rests, strict=True):
        if rest[0] > UNEXPLAINED:
            return [
                f"{part} jump in each step, even in the shortest one: they are set, wrapped or rescaled in the step"
            ]
    if "v" in x:
        faults.append(
            f"the drift lacks dt: positions change by {coefficient(x['v'])} v in each step, even in the shortest one"
        )
    if {"F/m", "F"} & set(x):
        faults.append("positions change by a multiple of the force that does not shrink with dt")
    if "F/m" in v or "F" in v or "F/m²" in v:
        mass = "" if "F/m" in v else " (and 1/m)" if "F" in v else " (and is divided by m twice)"
        faults.append(
            f"the kick lacks dt{mass}: velocities change by a multiple of the force in each step, even in the shortest "
            "one"
        )
    if "v" in v and is_near(v["v"], 1.0):
        faults.append(
            "velocities are doubled in each step, even in the shortest one: are they (x_new − x_old)/dt where (x_new − "
            "x_old)/(2 dt) is needed?"
        )
    elif "v" in v:
        faults.append(
            f"velocities are multiplied by {1.0 + v['v']:.8g} in each step, even in the shortest one: the step "
            "contains a thermostat or a rescaling"
        )
    return faults


def _first_power_of_x(c: dict[str, float], next_c: dict[str, float]) -> list[str]:
    """Faults in the terms of Δt in x, which should be v with the coefficient 1, and no others."""
    faults = []
    drift = c.get("v", 0.0)
    if is_near(drift, 0.0):
        faults.append(
            "positions do not move with the velocity: the drift dt v is missing"
            + (": it has dt² in place of dt" if "v" in next_c else "")
        )
    elif drift < 0.0:
        faults.append(f"the drift has the wrong sign: positions change by {coefficient(drift)} dt v")
    elif not is_near(drift, 1.0):
        faults.append(
            f"the drift is {coefficient(drift)} dt v where it should be dt v: it is multiplied by {_multiple(drift)}"
        )
    for name in ("F/m", "F", "F/m²"):
        if name in c:
            mass = {"F/m": "", "F": ", and 1/m is missing", "F/m²": ", and it is divided by m twice"}[name]
            faults.append(
                f"positions change by {coefficient(c[name])} dt {name}: the acceleration term needs dt², ½ dt² "
                f"F/m{mass}"
            )
    if "x" in c:
        faults.append(f"positions are scaled by 1 + {coefficient(c['x'])} dt in each step")
    return faults


def _first_power_of_v(c: dict[str, float], next_c: dict[str, float]) -> list[str]:
    """Faults in the terms of Δt in v, which should be F/m with the coefficient 1, and no others."""
    faults = []
    kick, bare, twice, friction, times = (c.get(name, 0.0) for name in ("F/m", "F", "F/m²", "v", "mF"))
    if friction:
        word = "friction" if friction < 0.0 else "a drive"
        faults.append(
            f"velocities change by {coefficient(friction)} dt v in addition to the kick: {word}, or a thermostat "
            "hidden in the step"
        )
    if bare and twice == 0.0:
        part = (
            "the kick lacks 1/m"
            if not kick
            else f"1/m is missing in a part of the kick: {coefficient(kick)} dt F/m + {coefficient(bare)} dt F"
        )
        faults.append(part + (f", and is {coefficient(bare)} of it" if not kick and not is_near(bare, 1.0) else ""))
    elif twice:
        faults.append(
            f"{'the kick' if not kick else 'a part of the kick'} is divided by m twice: {coefficient(twice)} dt F/m²"
        )
    if times:
        faults.append(
            f"the kick is multiplied by m where it should be divided: {coefficient(times)} dt m F (/2*m for /(2*m)?)"
        )
    total = kick + bare + twice + times
    if is_near(total, 0.0):
        faults.append(
            "the kick is missing: velocities do not change with the force"
            + (": it has dt² in place of dt" if "F/m" in next_c or "F" in next_c else "")
        )
    elif total < 0.0:
        faults.append(
            f"the kick has the wrong sign: velocities change by {coefficient(total)} dt F/m; F = −∇U is a force, not a "
            "gradient"
        )
    elif is_near(total, 0.5) and is_near(next_c.get("F/m", 0.0), 0.5):
        faults.append(
            "one half kick is multiplied by dt twice: ½ dt² F/m is added to the velocities (a dv that already contains "
            "dt is multiplied by dt)"
        )
    elif is_near(total, 0.5):
        faults.append("only half of the kick is made: velocities change by ½ dt F/m. One of the two half kicks is "
                      "missing, or the velocity that is "
                      "returned is that at half a step")  # fmt: skip
    elif not is_near(total, 1.0):
        faults.append(
            f"the kicks of a step add up to {coefficient(total)} dt F/m, not to dt F/m: they are "
            f"{_multiple(total)} times too large"
            + {
                1.5: ": one half kick is that of a whole step",
                2.0: ": each half kick is that of a whole step, or a factor ½ is missing",
            }.get(round(total, 6), "")
        )
    if "x" in c:
        faults.append(f"velocities change by {coefficient(c['x'])} dt x, a force that is not the one that was given")
    return faults


def _multiple(value: float) -> str:
    words = {0.5: "½ (as by dt/2 in place of dt)", 2.0: "2", 1.5: "3/2"}
    return words.get(round(value, 6), coefficient(value))


def _second_power(found: Expansion) -> list[str]:
    """Faults in the terms of Δt², which should be ½ F/m in x and ½ J v in v."""
    x, v, faults = found.x[2], found.v[2], []
    a, b = (c.get("F/m", 0.0) for c in (x, v))
    total = a + x.get("F", 0.0) + x.get("F/m²", 0.0) + x.get("mF", 0.0)
    if "F" in x or "F/m²" in x:
        word = "lacks 1/m" if "F" in x else "is divided by m twice"
        faults.append(f"the force term of the positions {word}: they move by "
                      f"{coefficient(x.get('F', x.get('F/m²', 0.0)))} dt² "
                      f"{'F' if 'F' in x else 'F/m²'}")  # fmt: skip
    if "mF" in x:
        faults.append("the force term of the positions is multiplied by m where it should be divided: "
                      f"{coefficient(x['mF'])} dt² m F; "
                      "in Python /2*m is not /(2*m)")  # fmt: skip
    if "v" in x or "x" in x:
        faults.append(
            f"positions change by {coefficient(x.get('v', x.get('x', 0.0)))} dt² {'v' if 'v' in x else 'x'}, which "
            "belongs to no method"
        )
    turning = v.get("Jv", 0.0) + v.get("mJv", 0.0)
    if "mJv" in v:
        faults.append("1/m is missing where the new force enters the velocities")
    extra = {name: c for name, c in v.items() if name in ("v", "F/m", "F", "F/m²", "x")}
    for name, c in extra.items():
        faults.append(
            f"velocities change by {coefficient(c)} dt² {name}: "
            + ("a part of the kick has one power of dt too many" if name.startswith("F") else "it belongs to no method")
        )
    pair = 2.0 * total, 2.0 * turning
    for (c, d), sentence in SECOND_ORDER.items():
        if is_near(pair[0], c) and is_near(pair[1], d):
            return [*faults, sentence] if not faults or (c, d) != (0, 0) else faults
    if not is_near(pair[0], 1.0):
        faults.append(f"positions contain {coefficient(total)} dt² F/m where ½ dt² F/m is needed")
    if not is_near(pair[1], 1.0) and b == 0.0:
        faults.append(f"the new force enters the velocities with the weight {coefficient(turning)} where ½ is needed")
    return faults
