"""What is wrong with a step: what single steps show, and the first terms of its expansion.

    x₁ = x + Δt v + ½ Δt² F/m + …              v₁ = v + Δt F/m + ½ Δt² J v + …         J v = d/dt F/m along v

The terms are measured by extrapolation to Δt = 0 and written as combinations of v, F/m, J v, and of terms that come
from faults, such as F and F/m², if a division by m is missing or made twice. For methods of order 2 both coefficients
of Δt² are ½. A step of order 1 has other coefficients, which show the force and the velocity that it used.
"""

from __future__ import annotations

from itertools import product

import numpy as np

from minimd.judge.calling import FORCES, StudentStep
from minimd.judge.findings import coefficient, first_of, is_near
from minimd.judge.problems import Array, TrialProblem, difference

# a step with more noise uses float32; smaller relative differences are rounding
SINGLE = 1e-8
ROUNDING = 1e-9
SHORT, CHANGED = 1e-7, 1e-4  # a time step so short that nothing should change, and a change
# velocities and starts at which limits are searched
FASTER = 30.0
FARTHER = 1.375 * 2.0 ** np.arange(12)
SPACING, N_STEPS = 0.01, 8  # time steps for the extrapolation: SPACING · 1 … N_STEPS
# coefficients that are zero, by power of Δt; relative rest of a fit
SMALL = (5e-8, 1e-6, 1e-5)
UNEXPLAINED = 1e-4
DIFFERENCE = 1e-3  # of x along v, for the derivative J v
PARTS = ("positions", "velocities")
POWERS = ("", " dt", " dt²")
# of x₁ − x and of v₁ − v, by power of Δt: the right term, its coefficient, and what it is
RIGHT = (
    (("", 0.0, ""), ("v", 1.0, "drift"), ("F/m", 0.5, "")),
    (("", 0.0, ""), ("F/m", 1.0, "kick"), ("Jv", 0.5, "")),
)
# fmt: off
MASSES = {  # terms in which the mass is wrong: those in which it is right, and what is wrong
    "F": ("F/m", "1/m is missing"), "F/m²": ("F/m", "it is divided by m twice"), "mJv": ("Jv", "1/m is missing"),
    "mF": ("F/m", "it is multiplied by m where it should be divided; in Python /2*m is not /(2*m)"),
}
# causes of terms that do not belong there, by part, power and term; "F" stands for all with F
ODD = {
    (0, 0, "v"): "the drift lacks dt", (0, 0, "F"): "the force term lacks dt²", (1, 0, "F"): "the kick lacks dt",
    (1, 0, "v"): "a thermostat, a rescaling, or (x_new − x_old)/dt where (x_new − x_old)/(2 dt) is needed",
    (0, 1, "F"): "the acceleration term needs dt², ½ dt² F/m", (1, 2, "F"): "a part of the kick has one dt too many",
    (1, 1, "v"): "friction, a drive, or a thermostat hidden in the step", (1, 1, "x"): "a force that was not given",
}
WEIGHTS = {  # causes of kicks that add up to another weight
    0.5: ": only half of the kick is made; a half kick is missing, or the velocity returned is that at half a step",
    1.5: ": one half kick is as large as a whole kick",
    2.0: ": each half kick is as large as a whole kick, or a factor ½ is missing",
}
TWICE = ": one half kick is multiplied by dt twice (a dv that already contains dt is multiplied by dt)"
SECOND_ORDER = (  # coefficients of Δt² F/m in x, and of Δt² J v in v, times two; all of order 1
    (0, 0, "explicit Euler: old velocity, old force; the energy grows. Kick first, then drift with the new velocity"),
    (2, 0, "symplectic Euler, kick first: make half a kick before the drift and half a kick, with the new force, after "
           "it; if velocities are meant to be at half steps (leapfrog), start the run with half a kick: v(dt/2)"),
    (0, 2, "symplectic Euler, drift first: split the kick into two halves, one before and one after the drift"),
    (1, 0, "the second half kick uses the old force F(x(t)): compute the force again after the positions have moved"),
    (1, 2, "your half step uses the new force twice: keep a copy of the old force before it is computed again"),
    (2, 1, "dt² F/m in place of ½ dt² F/m in the positions: the factor ½ is missing, or the first kick is a whole one"),
    (0, 1, "positions move with the old velocity: ½ dt² F/m is missing, or the velocity at half a step"),
    (1, 0.5, "the second half kick uses the force at the middle of the drift: compute it at the new positions"),
    (2, 2, "the new force and the new velocity are used where means of old and new are needed (implicit Euler)"),
)
# fmt: on


def hidden(step: StudentStep, where: TrialProblem) -> list[str]:
    """The reason why the step is not a function of x and v, such as noise or memory; empty if it is one."""
    first = np.array(step(where, where.x, where.v, 0.1))
    state = np.random.get_state()
    step.n_evaluations = 0
    off = float(np.abs(np.array(step(where, where.x, where.v, 0.1)) - first).max())
    np.random.set_state(state)
    return first_of(
        (step.n_evaluations == 0 and {*FORCES} & {*step.roles}, "the step never computes the force, or computes it in "
                                                                "its first call only and keeps that result"),
        (off, f"two steps from the same x and v differ by {off:.1e}: the step draws random numbers, as a thermostat "
              "does, or remembers earlier calls, such as a force kept outside. Pass all that it needs"),
    )  # fmt: skip


def faults_of(
    step: StudentStep,
    problems: list[TrialProblem],
    noise: float,
    n_powers: int,
    is_energy_kept: bool,
) -> list[str]:
    """The faults that single steps and the first powers of Δt show."""
    faults = first_of(
        (is_energy_kept, "the energy is kept to rounding: velocities are rescaled in each step to keep it, which hides "
                         "the error of the step and is neither symplectic nor reversible"),
        (step.rows_alike, "all states of the path are alike: the array is changed in place after it was appended. "
                          "Append a copy, as in xs.append(x.copy())"),
        (noise > SINGLE, f"the step rounds to {noise:.0e} of the coordinates: it uses float32 somewhere"),
    )  # fmt: skip
    faults = faults or explained(step, problems, n_powers) or limited(step, problems[0])
    where = problems[0]
    # the force that is returned, for the next step, is that at x₁
    new, _ = step(where, where.x, where.v, 0.1)
    known = (
        [role.split()[1] for role in step.roles if role.startswith("known")]
        if step.third.size
        else []
    )
    off = max(
        (float(np.abs(step.third / where.scaled(role, new) - 1.0).max()) for role in known[:1]),
        default=0.0,
    )
    return faults + first_of(
        (
            off > ROUNDING,
            "the force that is returned is not the one at the new positions (off by "
            f"{off:.1%}): the next step would begin with an old force",
        )
    )


def limited(step: StudentStep, where: TrialProblem) -> list[str]:
    """The fault of positions that are wrapped, found by starts farther and farther away (the forces of the test have no
    cell), or of velocities that are limited."""
    new = step(where, where.x, where.v, 0.02)[0]
    fast = step(where, where.x, FASTER * where.v, SHORT)[1]
    for far in np.outer(FARTHER, (-1.0, 1.0)).flat if where.x.ndim and not where.stiffness else ():
        jump = np.abs(step(where, where.x + far, where.v, 0.02)[0] - far - new)
        if jump.max() > 1e-6:
            return [
                f"atoms that start {far:g} farther away are moved by {jump[jump > 1e-6].min():.6g} more: positions "
                "are wrapped into a box in the step, or the step depends on the origin"
            ]
    off = np.abs(fast - FASTER * where.v).max()
    most = np.abs(fast).max()
    return first_of(
        (
            off > CHANGED * FASTER,
            f"velocities above {most:.4g} are cut off: they are limited (clipped)",
        )
    )


def series(step: StudentStep, where: TrialProblem) -> Array:
    """Coefficients of Δt⁰, Δt¹, Δt² of x₁ − x and of v₁ − v, (3, 2, *shape)."""
    times = SPACING * np.arange(1, N_STEPS + 1)
    ends = np.array(
        [np.array(step(where, where.x, where.v, h)) - np.array(where[:2]) for h in times]
    )
    powers = np.linalg.solve(
        np.vander(times / times[-1], increasing=True), ends.reshape(N_STEPS, -1)
    )[:3]
    return np.asarray((powers / times[-1] ** np.arange(3)[:, None]).reshape(3, 2, *where.x.shape))


def terms(where: TrialProblem) -> dict[str, Array]:
    """The terms of which the series may consist."""
    force = where.force(where.x)
    m = where.mass
    v = where.v
    turning = difference(where.force, where.x, DIFFERENCE * v) / DIFFERENCE
    one = {"v": v, "F/m": force / m, "F": force, "F/m²": force / m**2, "mF": force * m}
    return one | {"x": where.x, "Jv": turning / m, "mJv": turning}


def fit(
    known: list[dict[str, Array]], names: list[str], target: list[Array]
) -> tuple[Array, float]:
    """Coefficients of terms in the states, and the relative norm of what they do not explain."""
    matrix = np.array([np.concatenate([np.ravel(one[name]) for one in known]) for name in names]).T
    right = np.concatenate([np.ravel(one) for one in target])
    found = np.linalg.lstsq(matrix, right, rcond=None)[0]
    return found, float(
        np.linalg.norm(right - matrix @ found)
        / max(np.linalg.norm(right), 0.1 * np.sqrt(right.size))
    )


def explained(step: StudentStep, problems: list[TrialProblem], n_powers: int) -> list[str]:
    """The faults that the first powers of Δt show in several states at once, so that no two terms are alike."""
    measured = [series(step, one) for one in problems]
    known = [terms(one) for one in problems]
    found = dict[tuple[int, int], dict[str, float]]()
    rests = dict[tuple[int, int], float]()
    for power, part in product(range(n_powers), range(2)):
        names = [
            name
            for name in known[0]
            if (step.takes("m", "acceleration") or name not in MASSES)
            and (power == 2 or "Jv" not in name)
        ]
        if problems[0].stiffness:  # for a spring, x and F/m are proportional, and so are v and J v
            names = ["Jv" if part and power == 2 else "v", "F/m"]
        weights, rests[part, power] = fit(known, names, [one[power, part] for one in measured])
        # large terms have more rounding
        small = SMALL[power] * max(1.0, float(np.abs(weights).max())) ** 3
        found[part, power] = {
            name: float(c) for name, c in zip(names, weights, strict=True) if abs(c) > small
        }
    for power in range(n_powers):
        for part in range(2):
            if rests[part, power] > UNEXPLAINED:
                return [
                    stranger(
                        part,
                        power,
                        rests[part, power],
                        [one[power, part] for one in measured],
                        known,
                    )
                ]
        faults = [fault for part in range(2) for fault in wrong_terms(part, power, found)]
        if power == 2 and not faults:
            x, v = (2.0 * sum(found[part, 2].values()) for part in range(2))
            faults = first_of(
                *((is_near(x, c) and is_near(v, d), words) for c, d, words in SECOND_ORDER),
                (
                    not is_near(x, 1.0),
                    f"positions contain {coefficient(x / 2)} dt² F/m where ½ dt² F/m is needed",
                ),
                (
                    not is_near(v, 1.0),
                    f"the new force has the weight {coefficient(v / 2)} in the velocities, not ½",
                ),
            )
        if faults:
            return faults
    return []


def stranger(
    part: int, power: int, rest: float, changes: list[Array], known: list[dict[str, Array]]
) -> str:
    """The fault of a change that is no combination of the known terms."""
    off = changes[0] - RIGHT[part][power][1] * known[0].get(RIGHT[part][power][0], 0.0)
    bad = (np.abs(off) > CHANGED * max(1.0, float(np.abs(off).max()))).reshape(
        len(off) if off.ndim else 1, -1
    )
    axes = np.flatnonzero(bad.any(axis=0))
    atoms = np.flatnonzero(bad.any(axis=1))
    place = f" along {' and '.join('xyz'[k] for k in axes)}" if len(axes) < bad.shape[1] else ""
    if len(atoms) < len(bad):
        place = (
            f" of atom {', '.join(map(str, atoms))} of {len(bad)} (check the bounds of the loop)"
        )
    alone = [fit([one], ["v", "F/m"], [change]) for one, change in zip(known, changes, strict=True)]
    told = ", ".join(f"{c[0]:.3g}" for c, _ in alone[:3])
    return first_of(
        (
            part and off.ndim and max(one for _, one in alone) < UNEXPLAINED,
            f"velocities change by {told}, … "
            f"v{POWERS[power]} in addition to the kick: they are rescaled, as by a thermostat",
        ),
        (
            True,
            f"{PARTS[part]}{place} do not change as Newton's equation says (off by {rest:.1%} of a "
            f"term{POWERS[power]}): they are set, limited, wrapped or rescaled, or another force or mass acts",
        ),
    )[0]


def wrong_terms(part: int, power: int, found: dict[tuple[int, int], dict[str, float]]) -> list[str]:
    """Faults of one part in one power of Δt: terms that do not belong there, wrong masses, and a wrong weight."""
    term, right, what = RIGHT[part][power]
    c = found[part, power]
    faults = list[str]()
    total = 0.0
    for name, value in c.items():
        meant, mass = MASSES.get(name, (name, ""))
        change = f"{PARTS[part]} change by {coefficient(value)}{POWERS[power]} {name} in each step"
        if power == 0 and name == "xv"[part]:
            change = f"{PARTS[part]} are multiplied by {1.0 + value:.8g} in each step, even in the shortest one"
        if meant != term:
            why = ODD.get((part, power, "F" if "F" in name else name), "it belongs to no method")
            faults.append(f"{change}: {why}{', and ' * bool(mass)}{mass}")
            continue
        total += value
        if mass:
            faults.append(
                f"{'a part of ' * (term in c)}the {what or 'force term'} has a wrong mass: {mass}; {change}"
            )
    later = found.get((part, power + 1), {})
    why = WEIGHTS.get(round(total, 5), "") if what == "kick" else ""
    why = TWICE if why and is_near(total, 0.5) and is_near(later.get("F/m", 0.0), 0.5) else why
    return faults if not what or is_near(total, right) else faults + first_of(
        (is_near(total, 0.0), f"the {what} is missing: {PARTS[part]} lack dt {term}{'; it has dt²' * (term in later)}"),
        (total < 0.0, f"the {what} has the wrong sign: {PARTS[part]} change by {coefficient(total)} dt {term}"),
        (True, f"the {what} is multiplied by {coefficient(total)}: {PARTS[part]} change by {total:.7g} dt {term}{why}"),
    )  # fmt: skip
