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

from minimd.grade.findings import all_of, coefficient, first_of, first_of_each, is_near
from minimd.grade.problems import Array, Problem, difference

Map = Callable[[Problem, Array, Array, float], tuple[Array, Array]]
SPACING, N_STEPS = 0.01, 8  # time steps for the extrapolation: SPACING · 1 … N_STEPS
SMALL = 1e-5  # coefficients below it are zero
UNEXPLAINED = 1e-4  # a term with a larger relative rest is not a combination of the known terms
DIFFERENCE = 1e-3  # of x along v, for the derivative J v
# of x₁ − x and of v₁ − v, by power of Δt: the right term and its coefficient
RIGHT = (("v", 0.0), ("v", 1.0), ("F/m", 0.5)), (("v", 0.0), ("F/m", 1.0), ("Jv", 0.5))
WITHOUT_MASSES = ("F", "F/m²", "mF", "mJv")  # the same as others for a step that takes no masses
PARTS = ("positions", "dx/dt = v"), ("velocities", "dv/dt = F/m")
STRANGE = (  # a rest of each power
    "{0} jump in each step, even in the shortest one: they are set, wrapped or rescaled in the step",
    "for short steps {0} do not change as {1} says: {2.rest:.1%} of the change is something else{2.place}",
    "{0} contain a term of order dt² that is not that of Newton's equation: {2.rest:.1%} of it is something "
    "else{2.place}; order 1",
)
# fmt: off
SECOND_ORDER = (  # coefficients of Δt² F/m in x, and of Δt² J v in v, times two
    (0, 0, "explicit Euler: positions move with the old velocity and velocities with the old force; order 1, the "
           "energy grows. Kick first, then let the positions move with the new velocity"),
    (2, 0, "symplectic Euler, kick first (v += dt F/m, then x += dt v): order 1. Kick by half a step before the drift "
           "and by half a step with the new force after it; or, if velocities are meant to be at half steps "
           "(leapfrog), start the run with half a kick: v(dt/2)"),
    (0, 2, "symplectic Euler, drift first (x += dt v, then v += dt F(new x)/m): order 1. The kick must be split into "
           "two halves, one before and one after the drift"),
    (1, 0, "the second half kick uses the old force F(x(t)): the force must be computed again after the positions have "
           "moved; order 1"),
    (1, 2, "your half step uses the new force twice: velocities are kicked by dt F(x(t+dt))/m, without the old force "
           "F(x(t)). Keep a copy of the old force before it is computed again; order 1"),
    (2, 1, "positions move by dt² F/m in place of ½ dt² F/m: the factor ½ is missing, or the first kick is that of a "
           "whole step"),
    (0, 1, "positions move with the old velocity, x += dt v(t): the term ½ dt² F/m is missing (the drift must use the "
           "velocity at half a step)"),
    (1, 0.5, "the second half kick uses the force at the middle of the drift, F(x + dt/2 v): it must be computed at "
             "the new positions; order 1"),
    (2, 2, "the new force and the new velocity are used where their means with the old ones are needed, as in an "
           "implicit Euler step: order 1"),
)
# fmt: on


class Coefficients(dict[str, float]):
    """Coefficients by term; 0 for terms that are not there."""

    def __missing__(self, _: str) -> float:
        return 0.0


class Power(NamedTuple):
    """One power of Δt.

    c : coefficients.  rest : relative norm of what no term explains.  place : the atoms or axes that are wrong, in
    words; "" if all are.
    """

    c: Coefficients
    rest: float
    place: str


def series(step: Map, where: Problem) -> list[Array]:
    """Coefficients of Δt⁰, Δt¹, Δt² of x₁ − x and of v₁ − v, (3, *shape) each."""
    times = SPACING * np.arange(1, N_STEPS + 1)
    matrix = np.vander(times / times[-1], increasing=True)
    ends = zip(*(step(where, where.x, where.v, h) for h in times), strict=True)
    changes = [np.array(end) - start for end, start in zip(ends, (where.x, where.v), strict=True)]
    powers = [np.linalg.solve(matrix, one.reshape(N_STEPS, -1))[:3] for one in changes]
    return [(one / times[-1] ** np.arange(3)[:, None]).reshape(3, *where.x.shape) for one in powers]


def terms(where: Problem) -> dict[str, Array]:
    """The terms of which the series may consist."""
    force, m = where.force(where.x), where.mass
    turning = difference(where.force, where.x, DIFFERENCE * where.v) / DIFFERENCE
    one = {"v": where.v, "F/m": force / m, "F": force, "F/m²": force / m**2, "mF": force * m}
    one |= {"x": where.x, "Jv": turning / m, "mJv": turning}
    return {name: np.asarray(value, dtype=float) for name, value in one.items()}


def expansion(step: Map, problems: list[Problem], has_masses: bool) -> list[list[Power]]:
    """The powers Δt⁰, Δt¹, Δt² of x and of v, measured on several states at once, so that no two terms are alike."""
    measured, known = [series(step, where) for where in problems], [terms(where) for where in problems]

    def power_of(part: int, power: int) -> Power:
        basis = [name for name in known[0] if has_masses or name not in WITHOUT_MASSES]
        basis = [name for name in basis if power == 2 or "Jv" not in name]
        if problems[0].stiffness:  # for a spring, x and F/m are proportional, and so are v and J v
            basis = ["Jv" if part and power == 2 else "v", "F/m"]
        target = np.concatenate([np.ravel(one[part][power]) for one in measured])
        matrix = np.array([np.concatenate([np.ravel(one[name]) for one in known]) for name in basis]).T
        found = np.linalg.lstsq(matrix, target, rcond=None)[0]
        rest = np.linalg.norm(target - matrix @ found) / max(np.linalg.norm(target), 0.1 * np.sqrt(target.size))
        small = SMALL * max(1.0, float(np.abs(found).max())) ** 3  # the larger the terms, the larger their rounding
        c = {name: float(one) for name, one in zip(basis, found, strict=True) if abs(one) > small}
        name, weight = RIGHT[part][power]
        first, right = measured[0][part][power], weight * known[0][name]
        place = _one_mass(first, known[0]["F"], problems[0].m) if (part, power) == (1, 1) else ""
        return Power(Coefficients(c), float(rest), place or _places(first - right, right))

    return [[power_of(part, power) for power in range(3)] for part in range(2)]


def _places(off: Array, right: Array) -> str:
    """The atoms or axes for which a term is wrong, in words; empty if it is wrong for all or for none."""
    if off.ndim == 0:
        return ""
    bad = (np.abs(off) > 1e-4 * max(1.0, float(np.abs(right).max()))).reshape(len(off), -1)
    axes, atoms = np.flatnonzero(bad.any(axis=0)), np.flatnonzero(bad.any(axis=1))
    if off.ndim > 1 and 0 < len(axes) < bad.shape[1]:
        return ", along " + " and ".join("xyz"[k] for k in axes)
    return f", of atom {', '.join(map(str, atoms))} of {len(bad)}" if 0 < len(atoms) < len(bad) else ""


def _one_mass(change: Array, force: Array, m: Array) -> str:
    """A sentence if all forces are divided by the same mass, such as that of one atom or the mean; else empty."""
    if m.ndim == 0 or np.ptp(m) == 0.0:
        return ""
    flat, forces = change.reshape(len(m), -1), force.reshape(len(m), -1)
    ratio = (flat * forces).sum(axis=1) / (forces * forces).sum(axis=1)
    if np.ptp(ratio) > 1e-5 * np.abs(ratio).max():
        return ""
    means = {"the mean mass": m.mean(), "the sum of all masses": m.sum()}
    means |= {f"the mass of atom {k}": one for k, one in enumerate(m)}
    names = [name for name, one in means.items() if is_near(float(ratio[0] * one), 1.0)]
    return f"; all forces are divided by {names[0]}, instead of each by the mass of its atom" if names else ""


def explained(found: list[list[Power]]) -> list[str]:
    """The faults that the powers up to Δt² show, in words; empty for a method that seems to have order 2."""

    def strange(power: int) -> list[str]:
        rows = [(one[power], words) for one, words in zip(found, PARTS, strict=True)]
        return first_of(*((one.rest > UNEXPLAINED, STRANGE[power].format(*words, one)) for one, words in rows))

    x, v = ([power.c for power in part] for part in found)
    return (
        (strange(0) or _jumps(x[0], v[0]))
        or (strange(1) or [*_first_power_of_x(x[1], x[2]), *_first_power_of_v(v[1], v[2])])
        or (strange(2) or _second_power(x[2], v[2]))
    )


def _jumps(x: Coefficients, v: Coefficients) -> list[str]:
    """Faults in the terms of Δt⁰, which should be zero."""
    mass = "" if v["F/m"] else " (and 1/m)" if v["F"] else " (and is divided by m twice)"
    return first_of_each(
        ((x["v"], f"the drift lacks dt: positions change by {coefficient(x['v'])} v in each step, even in the shortest "
                  "one"),),
        ((x["F/m"] or x["F"], "positions change by a multiple of the force that does not shrink with dt"),),
        ((v["F/m"] or v["F"] or v["F/m²"], f"the kick lacks dt{mass}: velocities change by a multiple of the force in "
                                           "each step, even in the shortest one"),),
        ((is_near(v["v"], 1.0), "velocities are doubled in each step, even in the shortest one: are they (x_new − "
                                "x_old)/dt where (x_new − x_old)/(2 dt) is needed?"),
         (v["v"], f"velocities are multiplied by {1.0 + v['v']:.8g} in each step, even in the shortest one: the step "
                  "contains a thermostat or a rescaling")),
    )  # fmt: skip


def _first_power_of_x(c: Coefficients, after: Coefficients) -> list[str]:
    """Faults in the terms of Δt in x, which should be v with the coefficient 1, and no others."""
    drift, masses = c["v"], {"F/m": "", "F": ", and 1/m is missing", "F/m²": ", and it is divided by m twice"}
    return first_of_each(
        ((is_near(drift, 0.0), "positions do not move with the velocity: the drift dt v is missing"
                               + ": it has dt² in place of dt" * bool(after["v"])),
         (drift < 0.0, f"the drift has the wrong sign: positions change by {coefficient(drift)} dt v"),
         (not is_near(drift, 1.0), f"the drift is {coefficient(drift)} dt v where it should be dt v: it is multiplied "
                                   f"by {_multiple(drift)}")),
        *(((c[name], f"positions change by {coefficient(c[name])} dt {name}: the acceleration term needs dt², ½ dt² "
                     f"F/m{mass}"),) for name, mass in masses.items()),
        ((c["x"], f"positions are scaled by 1 + {coefficient(c['x'])} dt in each step"),),
    )  # fmt: skip


def _first_power_of_v(c: Coefficients, after: Coefficients) -> list[str]:
    """Faults in the terms of Δt in v, which should be F/m with the coefficient 1, and no others."""
    kick, bare, twice, times = (c[name] for name in ("F/m", "F", "F/m²", "mF"))
    total, once = kick + bare + twice + times, bare and not twice
    half, word = is_near(total, 0.5), "friction" if c["v"] < 0.0 else "a drive"
    why = {1.5: ": one half kick is that of a whole step",
           2.0: ": each half kick is that of a whole step, or a factor ½ is missing"}  # fmt: skip
    return first_of_each(
        ((c["v"], f"velocities change by {coefficient(c['v'])} dt v in addition to the kick: {word}, or a thermostat "
                  "hidden in the step"),),
        ((once and not kick, "the kick lacks 1/m" + ("" if is_near(bare, 1.0) else f", and is {coefficient(bare)} of "
                                                                                   "it")),
         (once, f"1/m is missing in a part of the kick: {coefficient(kick)} dt F/m + {coefficient(bare)} dt F"),
         (twice, f"{'a part of the kick' if kick else 'the kick'} is divided by m twice: {coefficient(twice)} dt "
                 "F/m²")),
        ((times, f"the kick is multiplied by m where it should be divided: {coefficient(times)} dt m F (/2*m for "
                 "/(2*m)?)"),),
        ((is_near(total, 0.0), "the kick is missing: velocities do not change with the force"
                               + ": it has dt² in place of dt" * bool(after["F/m"] or after["F"])),
         (total < 0.0, f"the kick has the wrong sign: velocities change by {coefficient(total)} dt F/m; F = −∇U is a "
                       "force, not a gradient"),
         (half and is_near(after["F/m"], 0.5), "one half kick is multiplied by dt twice: ½ dt² F/m is added to the "
                                               "velocities (a dv that already contains dt is multiplied by dt)"),
         (half, "only half of the kick is made: velocities change by ½ dt F/m. One of the two half kicks is missing, "
                "or the velocity that is returned is that at half a step"),
         (not is_near(total, 1.0), f"the kicks of a step add up to {coefficient(total)} dt F/m, not to dt F/m: they "
                                   f"are {_multiple(total)} times too large{why.get(round(total, 6), '')}")),
        ((c["x"], f"velocities change by {coefficient(c['x'])} dt x, a force that is not the one that was given"),),
    )  # fmt: skip


def _multiple(value: float) -> str:
    words = {0.5: "½ (as by dt/2 in place of dt)", 2.0: "2", 1.5: "3/2"}
    return words.get(round(value, 6), coefficient(value))


def _second_power(x: Coefficients, v: Coefficients) -> list[str]:
    """Faults in the terms of Δt², which should be ½ F/m in x and ½ J v in v."""
    total, turning = x["F/m"] + x["F"] + x["F/m²"] + x["mF"], v["Jv"] + v["mJv"]
    extra = "a part of the kick has one power of dt too many", "it belongs to no method"
    faults = first_of_each(
        ((x["F"], f"the force term of the positions lacks 1/m: they move by {coefficient(x['F'])} dt² F"),
         (x["F/m²"], "the force term of the positions is divided by m twice: they move by "
                     f"{coefficient(x['F/m²'])} dt² F/m²")),
        ((x["mF"], "the force term of the positions is multiplied by m where it should be divided: "
                   f"{coefficient(x['mF'])} dt² m F; in Python /2*m is not /(2*m)"),),
        [(x[name], f"positions change by {coefficient(x[name])} dt² {name}, which belongs to no method")
         for name in ("v", "x")],
        ((v["mJv"], "1/m is missing where the new force enters the velocities"),),
        *(((v[name], f"velocities change by {coefficient(v[name])} dt² {name}: {extra[name in ('v', 'x')]}"),)
          for name in ("v", "F/m", "F", "F/m²", "x")),
    )  # fmt: skip
    if faults and is_near(total, 0.0) and is_near(turning, 0.0):
        return faults
    known = [(is_near(2.0 * total, c) and is_near(2.0 * turning, d), sentence) for c, d, sentence in SECOND_ORDER]
    return faults + (first_of(*known) or all_of(
        (not is_near(2.0 * total, 1.0), f"positions contain {coefficient(total)} dt² F/m where ½ dt² F/m is needed"),
        (not is_near(2.0 * turning, 1.0) and not v["F/m"], "the new force enters the velocities with the weight "
                                                           f"{coefficient(turning)} where ½ is needed"),
    ))  # fmt: skip
