"""What is wrong with a step: what single steps show, and the first terms of its expansion.

    x₁ = x + Δt v + ½ Δt² F/m + …              v₁ = v + Δt F/m + ½ Δt² J v + …         J v = d/dt F/m along v

The terms are measured by extrapolation to Δt = 0 and written as combinations of v, F/m, J v, and of terms that come
from faults, such as F and F/m², if a division by m is missing or made twice. For methods of order 2 both coefficients
of Δt² are ½. A step of order 1 has other coefficients, which show the force and the velocity that it used.
"""

from __future__ import annotations

from itertools import product

import numpy as np

from minimd.core.structure.arrays import Array
from minimd.judge.calling import FORCES, StudentStep
from minimd.judge.findings import coefficient, is_near
from minimd.judge.problems import TrialProblem, difference, largest

SINGLE = 1e-8  # a step with more noise uses float32
ROUNDING = 1e-9  # smaller relative differences are rounding
SHORT = 1e-7  # a time step so short that nothing should change
CHANGED = 1e-4  # a relative change
FASTER = 30.0  # times the velocities, in the search for limits
FARTHER = 1.375 * 2.0 ** np.arange(12)  # shifts of the start, in the search for a box
MOVED = 1e-6  # a difference of positions
SPACING = 0.01  # time steps for the extrapolation: SPACING · 1 … N_STEPS
N_STEPS = 8
SMALL = (5e-8, 1e-6, 1e-5)  # coefficients that are zero, by power of Δt
UNEXPLAINED = 1e-4  # relative rest of a fit
DIFFERENCE = 1e-3  # of x along v, for the derivative J v
PARTS = ("positions", "velocities")
POWERS = ("", " dt", " dt²")
# of x₁ − x and of v₁ − v, by power of Δt: the right term, its coefficient, and what it is
RIGHT = (
    (("", 0.0, ""), ("v", 1.0, "drift"), ("F/m", 0.5, "")),
    (("", 0.0, ""), ("F/m", 1.0, "kick"), ("Jv", 0.5, "")),
)
Terms = dict[str, Array]  # changes of x or v, by name
Weights = dict[tuple[int, int], dict[str, float]]  # coefficients of terms, by part and power
# fmt: off
MASSES = {  # terms in which the mass is wrong: those in which it is right, and what is wrong
    "F": ("F/m", "1/m is missing"),
    "F/m²": ("F/m", "it is divided by m twice"),
    "mJv": ("Jv", "1/m is missing"),
    "mF": ("F/m", "it is multiplied by m where it should be divided; in Python /2*m is not /(2*m)"),
}
# causes of terms that do not belong there, by part, power and term; "F" stands for all with F
ODD = {
    (0, 0, "v"): "the drift lacks dt",
    (0, 0, "F"): "the force term lacks dt²",
    (1, 0, "F"): "the kick lacks dt",
    (1, 0, "v"): "a thermostat, a rescaling, or (x_new − x_old)/dt where (x_new − x_old)/(2 dt) is needed",
    (0, 1, "F"): "the acceleration term needs dt², ½ dt² F/m",
    (1, 2, "F"): "a part of the kick has one dt too many",
    (1, 1, "v"): "friction, a drive, or a thermostat hidden in the step",
    (1, 1, "x"): "a force that was not given",
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


def hidden(step: StudentStep, where: TrialProblem) -> str:
    """The reason why the step is not a function of x and v, such as noise or memory; empty if it is one."""
    first = np.array(step(where, where.x, where.v, 0.1))
    state = np.random.get_state()
    step.n_evaluations = 0
    second = np.array(step(where, where.x, where.v, 0.1))
    np.random.set_state(state)
    off = largest(second - first)
    if step.n_evaluations == 0 and not {*FORCES}.isdisjoint(step.roles):
        return "the step never computes the force, or computes it in its first call only and keeps that result"
    if off:
        return (
            f"two steps from the same x and v differ by {off:.1e}: the step draws random numbers, as a thermostat "
            "does, or remembers earlier calls, such as a force kept outside. Pass all that it needs"
        )
    return ""


def faults_of(
    step: StudentStep,
    problems: list[TrialProblem],
    noise: float,
    n_powers: int,
    is_energy_kept: bool,
) -> list[str]:
    """The faults that single steps and the first powers of Δt show."""
    where = problems[0]
    if is_energy_kept:
        faults = [
            "the energy is kept to rounding: velocities are rescaled in each step to keep it, which hides the error "
            "of the step and is neither symplectic nor reversible"
        ]
    elif step.rows_alike:
        faults = [
            "all states of the path are alike: the array is changed in place after it was appended. Append a copy, as "
            "in xs.append(x.copy())"
        ]
    elif noise > SINGLE:
        faults = [f"the step rounds to {noise:.0e} of the coordinates: it uses float32 somewhere"]
    else:
        faults = explained(step, problems, n_powers) or limited(step, where)

    known = [role.split()[1] for role in step.roles if role.startswith("known")]
    new_x, _ = step(where, where.x, where.v, 0.1)
    if known and step.third.size:
        off = largest(step.third / where.scaled(known[0], new_x) - 1.0)
        if off > ROUNDING:
            faults.append(
                f"the force that is returned is not the one at the new positions (off by {off:.1%}): the next step "
                "would begin with an old force"
            )
    return faults


def limited(step: StudentStep, where: TrialProblem) -> list[str]:
    """The fault of positions that are wrapped, found by starts farther and farther away (the forces of the test have no
    cell), or of velocities that are limited."""
    if where.x.ndim and not where.stiffness:
        new_x, _ = step(where, where.x, where.v, 0.02)
        for far in np.outer(FARTHER, (-1.0, 1.0)).flat:
            moved_x, _ = step(where, where.x + far, where.v, 0.02)
            jump = np.abs(moved_x - far - new_x)
            if jump.max() > MOVED:
                smallest = jump[jump > MOVED].min()
                larger = "larger" if far > 0.0 else "smaller"
                return [
                    f"atoms whose coordinates are {larger} by {abs(far):g} are moved by {smallest:.6g} more: "
                    "positions are wrapped into a box in the step, or the step depends on the origin"
                ]

    fast = FASTER * where.v
    new_v = step(where, where.x, fast, SHORT)[1]
    if largest(new_v - fast) > CHANGED * FASTER:
        most = largest(new_v)
        return [f"velocities above {most:.4g} are cut off: they are limited (clipped)"]
    return []


def series(step: StudentStep, where: TrialProblem) -> Array:
    """Coefficients of Δt⁰, Δt¹, Δt² of x₁ − x and of v₁ − v, (3, 2, *shape)."""
    times = SPACING * np.arange(1, N_STEPS + 1)
    longest = times[-1]
    start = np.array(where[:2])
    changes = [np.array(step(where, where.x, where.v, h)) - start for h in times]
    matrix = np.vander(times / longest, increasing=True)
    right = np.reshape(changes, (N_STEPS, -1))
    powers = np.linalg.solve(matrix, right)[:3]
    coefficients = powers / longest ** np.arange(3)[:, None]
    return coefficients.reshape(3, *start.shape)


def terms(where: TrialProblem) -> Terms:
    """The terms of which the series may consist."""
    force = where.force(where.x)
    m = where.mass
    turning = difference(where.force, where.x, DIFFERENCE * where.v) / DIFFERENCE
    return {
        "v": where.v,
        "F/m": force / m,
        "F": force,
        "F/m²": force / m**2,
        "mF": force * m,
        "x": where.x,
        "Jv": turning / m,
        "mJv": turning,
    }


def fit(known: list[Terms], names: list[str], changes: list[Array]) -> tuple[Array, float]:
    """Coefficients of terms in the states, and the relative norm of what they do not explain."""
    columns = []
    for name in names:
        columns.append(np.concatenate([np.ravel(state[name]) for state in known]))
    matrix = np.array(columns).T
    right = np.concatenate([np.ravel(change) for change in changes])
    weights = np.linalg.lstsq(matrix, right, rcond=None)[0]
    size = max(np.linalg.norm(right), 0.1 * np.sqrt(right.size))
    return weights, np.linalg.norm(right - matrix @ weights) / size


def explained(step: StudentStep, problems: list[TrialProblem], n_powers: int) -> list[str]:
    """The faults that the first powers of Δt show in several states at once, so that no two terms are alike."""
    measured = [series(step, where) for where in problems]
    known = [terms(where) for where in problems]
    has_masses = step.takes("m", "acceleration")
    names_of_mass = [name for name in known[0] if has_masses or name not in MASSES]
    changes = dict[tuple[int, int], list[Array]]()
    weights = Weights()
    rests = dict[tuple[int, int], float]()
    for power, part in product(range(n_powers), range(2)):
        names = [name for name in names_of_mass if power == 2 or "Jv" not in name]
        if problems[0].stiffness:  # for a spring, x and F/m are proportional, and so are v and J v
            names = ["Jv" if part and power == 2 else "v", "F/m"]
        place = part, power
        changes[place] = [change[power, part] for change in measured]
        values, rests[place] = fit(known, names, changes[place])
        # large terms have more rounding
        small = SMALL[power] * max(1.0, largest(values)) ** 3
        pairs = zip(names, values.tolist(), strict=True)
        weights[place] = {name: value for name, value in pairs if abs(value) > small}

    for power in range(n_powers):
        for part in range(2):
            rest = rests[part, power]
            if rest > UNEXPLAINED:
                return [stranger(part, power, rest, changes[part, power], known)]
        faults = wrong_terms(0, power, weights) + wrong_terms(1, power, weights)
        if power == 2 and not faults:
            of_x = 2.0 * sum(weights[0, 2].values())
            of_v = 2.0 * sum(weights[1, 2].values())
            faults = wrong_second_order(of_x, of_v)
        if faults:
            return faults
    return []


def wrong_second_order(x: float, v: float) -> list[str]:
    """The fault of twice the coefficients of Δt² F/m in x, and of Δt² J v in v."""
    for right_x, right_v, cause in SECOND_ORDER:
        if is_near(x, right_x) and is_near(v, right_v):
            return [cause]
    if not is_near(x, 1.0):
        return [f"positions contain {coefficient(x / 2)} dt² F/m where ½ dt² F/m is needed"]
    if not is_near(v, 1.0):
        return [f"the new force has the weight {coefficient(v / 2)} in the velocities, not ½"]
    return []


def stranger(part: int, power: int, rest: float, changes: list[Array], known: list[Terms]) -> str:
    """The fault of a change that is no combination of the known terms."""
    term, weight, _ = RIGHT[part][power]
    off = np.abs(changes[0] - weight * known[0].get(term, 0.0))
    pairs = zip(known, changes, strict=True)
    fits = [fit([state], ["v", "F/m"], [change]) for state, change in pairs]
    if part and off.ndim and max(rest_of_one for _, rest_of_one in fits) < UNEXPLAINED:
        rates = ", ".join(f"{weights[0]:.3g}" for weights, _ in fits[:3])
        return (
            f"velocities change by {rates}, … v{POWERS[power]} in addition to the kick: they are rescaled, as by a "
            "thermostat"
        )

    limit = CHANGED * max(1.0, off.max())
    n_atoms = len(off) if off.ndim else 1
    is_bad = np.reshape(off > limit, (n_atoms, -1))
    axes = is_bad.any(axis=0)
    atoms = is_bad.any(axis=1)
    place = ""
    if not atoms.all():
        numbers = ", ".join(map(str, np.flatnonzero(atoms)))
        place = f" of atom {numbers} of {n_atoms} (check the bounds of the loop)"
    elif not axes.all():
        names = " and ".join("xyz"[k] for k in np.flatnonzero(axes))
        place = f" along {names}"
    return (
        f"{PARTS[part]}{place} do not change as Newton's equation says (off by {rest:.1%} of a term{POWERS[power]}): "
        "they are set, limited, wrapped or rescaled, or another force or mass acts"
    )


def wrong_terms(part: int, power: int, weights: Weights) -> list[str]:
    """Faults of one part in one power of Δt: terms that do not belong there, wrong masses, and a wrong weight."""
    term, right, what = RIGHT[part][power]
    values = weights[part, power]
    name_of_part = PARTS[part]
    faults = list[str]()
    total = 0.0
    for name, value in values.items():
        meant, mass = MASSES.get(name, (name, ""))
        change = f"{name_of_part} change by {coefficient(value)}{POWERS[power]} {name} in each step"
        if power == 0 and name == "xv"[part]:
            change = f"{name_of_part} are multiplied by {1.0 + value:.8g} in each step, even in the shortest one"
        if meant == term:
            total += value
            if mass:
                some = "a part of " if term in values else ""
                faults.append(
                    f"{some}the {what or 'force term'} has a wrong mass: {mass}; {change}"
                )
        else:
            cause = ODD.get((part, power, "F" if "F" in name else name), "it belongs to no method")
            if mass:
                cause += f", and {mass}"
            faults.append(f"{change}: {cause}")
    if not what or is_near(total, right):
        return faults

    later = weights.get((part, power + 1), {})
    if is_near(total, 0.0):
        it_has = "; it has dt²" if term in later else ""
        fault = f"the {what} is missing: {name_of_part} lack dt {term}{it_has}"
    elif total < 0.0:
        change = f"{name_of_part} change by {coefficient(total)} dt {term}"
        fault = f"the {what} has the wrong sign: {change}"
    else:
        cause = ""
        if what == "kick":
            cause = WEIGHTS.get(round(total, 5), "")
            if is_near(total, 0.5) and is_near(later.get("F/m", 0.0), 0.5):
                cause = TWICE
        change = f"{name_of_part} change by {total:.7g} dt {term}"
        fault = f"the {what} is multiplied by {coefficient(total)}: {change}{cause}"
    return [*faults, fault]
