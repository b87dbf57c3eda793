"""The grade of a step: its order, its symmetries, the quantities that it conserves, and the faults that single steps
and its first terms show. All is measured on a few particles."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from itertools import product
from typing import Any

import numpy as np
from numpy.polynomial import Polynomial

from minimd.grade.calling import FORCES, StudentStep, understood
from minimd.grade.expansion import expansion, explained
from minimd.grade.findings import Finding, Grade, all_of, coefficient, first_of, first_of_each
from minimd.grade.problems import Array, Problem, bisected, difference
from minimd.grade.variants import Kind, kind_of, nearest_method, recognized, substeps_of
from minimd.integrators.splitting.substeps import Kick, Substeps

# of the faults
HIGH = 2.5  # a step of a higher measured order has the right terms up to dt², and need not be symmetric
FEW = 3  # a step with so many kicks or more should have an order above 2
ROUNDING = 1e-9  # smaller relative differences are rounding
SINGLE = 1e-8  # a step with more noise uses float32
# by the shape of x: the number of states needed to distinguish all terms
STATES = {(5, 3): 4, (5, 2): 5, (5,): 8, (): 24}
SHORT = 1e-7  # a time step so short that nothing should change
CHANGED = 1e-4
FASTER = (1.0, 30.0)  # factors by which velocities are multiplied to find a limit
# of the laws
DURATION, COARSEST, HALVINGS = 0.8, 8, 4  # errors are compared after this time, made in 8, 16, 32 and 64 steps
ORDER_OFF = 0.25  # largest difference between the measured slope and the order
PACE, LONG = 0.05, 1000  # time step of the runs, and number of steps of the run for the energy
BACK, SOME = 10, 20  # steps forwards, and as many backwards; steps in which momenta are compared
BLOCKS, SIGNIFICANT = 10, 4.0
DELTA = 2e-3  # of differences
TOO_LARGE = 1e6
EXACTLY = 1e-13  # smaller oscillations of the energy, relative to the kinetic energy, are rounding
FARTHEST = 6.0  # largest ω dt at which a limit of stability is searched


def grade_step(function: Callable[..., Any], order: int = 2) -> Grade:
    """See grade."""
    step = understood(function)
    problems = [step.problem(seed) for seed in range(STATES[step.manner.shape])]
    where, called, remarks = problems[0], step.manner.told(getattr(function, "__name__", "step")), _remarks(step)
    with np.errstate(all="ignore"):
        if faults := _hidden(step, where):
            found = Finding("a map of x and v", False, faults[0])
            return Grade(called, (found,), tuple(faults), remarks=tuple(remarks))
        noise = noise_of(step, where)
        findings = [order_of(step, where, order), *laws_of(step, where, noise), energy(step, where), oscillator(step)]
        laws = {one.name: one for one in [*findings, cost(step, where)]}
        is_high = laws["order"].value > HIGH
        # a step with the force before is no map of x and v; Ruth's method of order 3 is right, and not symmetric
        unknown = {"reversible", "symplectic", "volume"} if step.takes("before") else set[str]()
        unknown |= {"reversible"} if is_high and laws["symplectic"].passed and not laws["reversible"].passed else set()
        known = recognized(step, where, 0.1, max(ROUNDING, 10.0 * noise))
        parts = () if known else substeps_of(step, where)
        method = known.name if known else ", ".join(f"{kind_of(one)} {coefficient(one.coefficient)}" for one in parts)
        if known and known.wrong:
            faults = [known.wrong]
        elif known and known.kind is Kind.RUNGE_KUTTA and order == known.order and laws["order"].passed:
            unknown |= {name for name, one in laws.items() if one.passed is False}
            remarks.append(known.kind.value)
        elif known and known.kind is Kind.RUNGE_KUTTA:
            faults = [f"{known.kind.value}. If it is meant, ask for its order: md.grade(step, order={known.order})"]
        elif laws["energy"].value != 0.0:
            faults = _faults(step, problems, noise, is_high)
        laws |= {name: replace(laws[name], passed=None) for name in unknown}
        faults += _of_substeps(parts, laws["order"].value, order)
    return Grade(called, tuple(laws.values()), tuple(faults or _structural(laws)), method, tuple(remarks))


def noise_of(step: StudentStep, where: Problem) -> float:
    """Rounding of a step, relative to the coordinates, from third differences along a line of states 1e-6 apart."""
    line = np.array([np.ravel(step(where, where.x * (1.0 + 1e-6 * k), where.v, 0.1)[0]) for k in range(12)])
    return float(np.abs(np.diff(line, n=3, axis=0)).max() / 8.0 / np.abs(where.x).max())


def run(step: StudentStep, where: Problem, h: float, n: int) -> tuple[Array, Array]:
    """x and v after n steps."""
    x, v = where.x, where.v
    for _ in range(n):
        x, v = step(where, x, v, h)
    return x, v


def order_of(step: StudentStep, where: Problem, expected: int) -> Finding:
    """The order: the slope, in a logarithmic plot, of the error after a fixed time against the time step."""
    counts, (x, v) = COARSEST * 2 ** np.arange(HALVINGS), where.flow(DURATION)
    ends = [run(step, where, DURATION / n, int(n)) for n in counts]
    errors = np.array([np.sqrt(np.sum((xn - x) ** 2) + np.sum((vn - v) ** 2)) for xn, vn in ends])
    if not np.isfinite(errors).all():
        return Finding("order", False, "the path is unbounded: positions or velocities are not finite", float("nan"))
    kept = np.flatnonzero(errors > 1e-11)[-3:]
    kept = kept if len(kept) == 3 else np.arange(2)
    slope = float(-np.polyfit(np.log(counts[kept]), np.log(np.maximum(errors[kept], 1e-300)), 1)[0])
    words = (f"{slope:.2f} measured, {expected} expected; error {errors[-1]:.1e} at t = {DURATION:g}, dt = "
             f"{DURATION / counts[-1]:g}")  # fmt: skip
    if slope < ORDER_OFF:
        words = (f"0: the error does not decrease with dt, it remains {errors[-1]:.2g}; the step does not solve "
                 "Newton's equation")  # fmt: skip
    return Finding("order", slope > max(ORDER_OFF, expected - ORDER_OFF), words, slope)


def laws_of(step: StudentStep, where: Problem, noise: float) -> list[Finding]:
    """Laws that hold to rounding: the way back, the symplectic form and the volume of phase space; the momenta, for
    problems that conserve them."""
    x, v = run(step, where, PACE, BACK)
    way = float(np.abs(x - where.x).max())
    x, v = run(step, where._replace(x=x, v=-v), PACE, BACK)
    back = float(max(np.abs(x - where.x).max(), np.abs(v + where.v).max()))
    matrix, n = jacobian(step, where, 0.1), where.x.size
    omega = np.block([[np.zeros((n, n)), np.eye(n)], [-np.eye(n), np.zeros((n, n))]])
    form, volume = float(np.abs(matrix.T @ omega @ matrix - omega).max()), float(np.linalg.det(matrix)) - 1.0
    rounding, of_form = max(1e-11, 100.0 * noise), max(1e-9, 1e3 * noise)
    rows = [  # law, its defect, the largest that is rounding, words
        ("reversible", back, rounding * max(1.0, way), f"after {BACK} steps and as many back, the distance from the "
                                                       f"start is {back:.1e}; the way was {way:.2g}"),
        ("symplectic", form, of_form, f"largest element of JᵀΩJ − Ω: {form:.1e} at dt = 0.1"),
        ("volume", volume, of_form * n, f"det J = 1 {'+' if volume >= 0 else '−'} {abs(volume):.1e} at dt = 0.1"),
        *((f"{kind}momentum", off, rounding, f"changes by {off:.1e} of Σ|{symbol}| in {SOME} steps")
          for kind, symbol, off in changes_of_momenta(step, where)),
    ]  # fmt: skip
    return [Finding(law, abs(off) < limit, words, off) for law, off, limit, words in rows]


def jacobian(step: StudentStep, where: Problem, h: float) -> Array:
    """∂(x₁, p₁)/∂(x, p)."""
    n, shape = where.x.size, where.x.shape

    def end(y: Array) -> Array:
        return np.concatenate([np.ravel(part) for part in step(where, y[:n].reshape(shape), y[n:].reshape(shape), h)])

    start = np.concatenate([np.ravel(where.x), np.ravel(where.v)])
    matrix = np.array([difference(end, start, DELTA * unit) / DELTA for unit in np.eye(2 * n)]).T
    scale = np.concatenate([np.ones(n), np.ravel(np.broadcast_to(where.mass, shape))])
    return np.asarray(scale[:, None] * matrix / scale)


def changes_of_momenta(step: StudentStep, where: Problem) -> list[tuple[str, str, float]]:
    """Kind, symbol and relative change in some steps, for problems that conserve momenta."""
    if where.x.ndim == 0 or where.stiffness:
        return []
    x, v = run(step, where, PACE, SOME)
    p = where.mass * where.v, where.mass * v
    changes = [("", "mv", float(np.abs(p[1].sum(axis=0) - p[0].sum(axis=0)).max()) / float(np.abs(p[0]).sum()))]
    if where.x.ndim == 2:
        room = ((0, 0), (0, 3 - x.shape[1]))  # for three components
        before, after = (np.cross(np.pad(a, room), np.pad(b, room)) for a, b in zip((where.x, x), p, strict=True))
        off = float(np.abs((after - before).sum(axis=0)).max()) / float(np.abs(before).sum())
        changes.append(("angular ", "r × mv", off))
    return changes


def energy(step: StudentStep, where: Problem) -> Finding:
    """Drift and oscillation of the total energy in a long run, compared with the mean kinetic energy."""
    x, v, energies, kinetic = where.x, where.v, [], []
    for _ in range(LONG):
        x, v = step(where, x, v, PACE)
        energies.append(where.energy(x, v))
        kinetic.append(energies[-1] - where.potential(x))
        if not np.isfinite(energies[-1]) or abs(energies[-1]) > TOO_LARGE:
            words = f"grows without bound: it is beyond {TOO_LARGE:g} after {len(energies)} steps of {PACE:g}"
            return Finding("energy", False, words, np.inf)
    series, k, times = np.array(energies), float(np.mean(kinetic)), np.arange(LONG)
    (change, _), covariance = np.polyfit(np.arange(BLOCKS), series.reshape(BLOCKS, -1).mean(axis=1), 1, cov=True)
    slope, error = change * BLOCKS / LONG, np.sqrt(covariance[0, 0]) * BLOCKS / LONG
    oscillation = float(np.std(series - Polynomial.fit(times, series, 1)(times))) / k
    if oscillation < EXACTLY:
        words = f"constant to rounding, {oscillation:.1e} of the kinetic energy: no explicit step has this property by "
        return Finding("energy", False, f"{words}itself", 0.0)
    # slow oscillations look like less
    drifts = bool(abs(slope) > SIGNIFICANT * error and abs(slope) * LONG > max(1e-9, oscillation) * k)
    verb = f"{'grows' if slope > 0 else 'falls'} by {abs(slope) / k:.1e} of the kinetic energy per step"
    words = f"{verb if drifts else 'does not drift'}; it oscillates by {oscillation:.1e} (dt = {PACE:g})"
    return Finding("energy", not drifts, words, float(slope) / k)


def oscillator(step: StudentStep) -> Finding:
    """The step as a matrix, for x″ = −x: its determinant, the quadratic form that it conserves, and the longest stable
    step: the first failure on a grid, then bisection."""
    omega = np.sqrt(step.stiffness or 1.0)
    where = step.problem(1, stiffness=float(omega**2))
    one = np.ones_like(where.x)
    where = where._replace(m=np.ones_like(where.m))

    def matrix(h: float) -> Array:
        ends = [step(where, x * one, v * one, h / omega) for x, v in ((1.0, 0.0), (0.0, omega))]
        return np.array([(np.ravel(x)[0], np.ravel(v)[0] / omega) for x, v in ends]).T

    def is_stable(h: float) -> bool:
        return abs(float(np.trace(matrix(h)))) <= 2.0 + 1e-9

    m, h = matrix(0.5), 0.5
    off = float(np.linalg.det(m)) - 1.0
    if not np.isfinite(off) or abs(off) > 1e-7:
        words = f"no quadratic form is conserved: at ω dt = {h:g} the energy {'grows' if off > 0.0 else 'falls'} by the"
        return Finding("oscillator", False, f"{words} factor {1.0 + off:.4g} in each step", off)
    skew, stiffness = (m[1, 1] - m[0, 0]) / m[0, 1], -m[1, 0] / m[0, 1]
    mixed = "" if abs(skew) < 1e-9 else f" {'+' if skew > 0 else '−'} {abs(skew):.4g} ω x v"
    grid = np.linspace(0.2, FARTHEST, 30)
    first = next((float(one) for one in grid if not is_stable(float(one))), None)
    limit = FARTHEST
    if first is not None:
        low, _ = bisected(lambda low, h, high: is_stable(h), first - float(grid[1] - grid[0]), first, 10)
        limit = low if low > 0.01 else 0.0
    constant = f"v² {'+' if stiffness > 0.0 else '−'} {abs(stiffness):.6g} ω² x²{mixed}"
    words = f"at ω dt = {h:g} it conserves {constant}; stable up to ω dt = {limit:.2f}"
    return Finding("oscillator", limit > 0.0, words, limit)


def cost(step: StudentStep, where: Problem) -> Finding:
    """The number of force evaluations in one step."""
    if not step.is_given_forces:
        return Finding("cost", None, "not counted: the step computes its force itself")
    step.n_evaluations = 0
    step(where, where.x, where.v, PACE)
    n = step.n_evaluations
    more = "; one is enough if the force at the end of a step is kept for the next step" if n == 2 else ""
    return Finding("cost", True if n == 1 else None, f"{n} force evaluation{'s' * (n != 1)} per step{more}", float(n))


def _hidden(step: StudentStep, where: Problem) -> list[str]:
    """The reason why the step is not a function of x and v, such as noise or memory; empty if it is one."""
    first = step(where, where.x, where.v, 0.1)
    step.n_evaluations = 0
    second = step(where, where.x, where.v, 0.1)
    is_deaf = step.n_evaluations == 0 and bool(set(FORCES) & set(step.manner.roles))
    off = max(float(np.abs(a - b).max()) for a, b in zip(first, second, strict=True))
    state, ends = np.random.get_state(), []
    for _ in range(2):
        np.random.seed(1)
        ends.append(step(where, where.x, where.v, 0.1))
    np.random.set_state(state)
    is_random = off and all(np.array_equal(a, b) for a, b in zip(*ends, strict=True))
    return first_of(
        (is_deaf, "the step does not compute the force: it called the force function in its first call, or never, and "
                  "keeps using that result"),
        (is_random, f"the step draws random numbers: two steps from the same state differ by {off:.1e}. The step "
                    "contains a thermostat"),
        (off, f"two steps from the same x and v differ by {off:.1e}: the step draws random numbers, or remembers "
              "earlier calls, such as a force that is kept outside. What a step needs must be among its arguments"),
    )  # fmt: skip


def _remarks(step: StudentStep) -> list[str]:
    return all_of(
        (step.swapped, "the step returns v before x; the usual order is x, v"),
        (step.in_place, "the step changes the arrays that it is given; copy them before if you need the old ones"),
        (step.manner.masses == "(N, 1)", "it does not work with masses of shape (N,); it was called with shape (N, 1)"),
        (step.takes("half"), "velocities are at half steps: half a kick was made before and after"),
        (step.takes("old"), "the step is a recursion of two positions; velocities are (x₁ − x₀)/dt + ½ dt F/m"),
        (step.takes("before"), "a step that takes the force of the previous step is not a map of x and v, and is not "
                               "judged as one"),
    )  # fmt: skip


def _faults(step: StudentStep, problems: list[Problem], noise: float, is_high: bool) -> list[str]:
    """What is seen in single steps, and in the first terms if nothing else is wrong."""
    where, faults = problems[0], same_rows(step, problems[0])
    faults += all_of((noise > SINGLE, f"the step rounds to {noise:.0e} of the coordinates: it uses float32 somewhere; "
                                      "float64 rounds to 1e-16"))  # fmt: skip
    if where.x.ndim:
        may_wrap = not faults and not where.stiffness
        faults += _left_out(step, problems) or (may_wrap and _wrapped(step, where)) or _thermostat(step, problems)
        faults = faults or clipped(step, where)
    if not faults and not is_high:
        faults = explained(expansion(step, problems, step.is_scaled))
    return faults + _old_force(step, where)


def _old_force(step: StudentStep, where: Problem) -> list[str]:
    """The fault of a force that is returned, for the next step, and is not that at the new positions."""
    roles = [role.split()[1] for role in step.manner.roles if role.startswith("known")]
    if step.third is None or not roles:
        return []
    right = where.scaled(roles[0], step(where, where.x, where.v, 0.1)[0])
    off = float(np.abs(step.third - right).max() / np.abs(right).max())
    return all_of((off > ROUNDING, f"the force that is returned is not the one at the new positions (off by {off:.1%})"
                                   ": the next step would begin with an old force"))  # fmt: skip


def _left_out(step: StudentStep, problems: list[Problem]) -> list[str]:
    """Faults for atoms or axes that are not moved, or not kicked."""
    ends, faults = [step(where, where.x, where.v, 0.1) for where in problems], list[str]()
    for part, verb in enumerate(("moved", "kicked")):  # x and v are the first two fields of a problem
        still = np.all([end[part] == one[part] for end, one in zip(ends, problems, strict=True)], axis=0)
        still = still.reshape(len(still), -1)
        atoms, axes = np.flatnonzero(still.all(axis=1)), np.flatnonzero(still.all(axis=0))
        last = ", the last," if list(atoms) == [len(still) - 1] else ""
        check = f"is not {verb}: check the bounds of the loop, such as range(N − 1)"
        if not still.all():
            faults += first_of(
                (len(atoms), f"atom {', '.join(map(str, atoms))}{last} {check}"),
                (len(axes), f"axis {', '.join(map(str, axes))} {check}"),
            )
    return faults


def _wrapped(step: StudentStep, where: Problem) -> list[str]:
    """The fault of positions that are wrapped, found by starts farther and farther away;
    the forces of the test have no cell."""
    new, _ = step(where, where.x, where.v, 0.02)
    for distance, sign in product(1.375 * 2.0 ** np.arange(12), (-1.0, 1.0)):
        shift = sign * distance
        far, _ = step(where, where.x + shift, where.v, 0.02)
        jump = np.abs(far - shift - new)
        if jump.max() > 1e-6:
            return [f"atoms that start {distance:g} farther away are moved by {jump[jump > 1e-6].min():.6g} more: "
                    "positions are wrapped into a box with this edge inside the step, or it depends on the place of "
                    "the origin. Wrap positions that are written, not those that are integrated"]  # fmt: skip
    return []


def _thermostat(step: StudentStep, problems: list[Problem]) -> list[str]:
    """The fault of velocities that are rescaled, at once or at a rate that depends on the state,
    or whose mean motion is removed."""
    changes = [step(one, one.x, one.v, SHORT)[1] - one.v for one in problems]
    pairs = list(zip(changes, problems, strict=True))
    if np.abs(changes[0]).max() > CHANGED:
        factors = [float(np.sum(change * one.v) / np.sum(one.v**2)) for change, one in pairs]
        rests = [np.abs(change - c * one.v).max() for c, (change, one) in zip(factors, pairs, strict=True)]
        told = ", ".join(f"{1.0 + c:.4g}" for c in factors[:3])
        return first_of(
            (np.abs(changes[0] - changes[0].mean(axis=0)).max() < 1e-5, "the mean motion is removed in each step: all "
                "velocities change by the same vector. Do this only once, at the start"),
            (max(rests) < 1e-5 and np.ptp(factors) > CHANGED, f"velocities are multiplied by {told}, … in each step, "
                "even in the shortest one: they are rescaled to a temperature, the step contains a thermostat"),
        )  # fmt: skip
    bases = [np.array([np.ravel(one.v), np.ravel(one.force(one.x) / one.mass)]).T for one in problems]
    slopes = [np.ravel(change) / SHORT for change in changes]
    rates = [np.linalg.lstsq(basis, slope, rcond=None)[0] for basis, slope in zip(bases, slopes, strict=True)]
    off = max(np.abs(slope - basis @ c).max() for slope, basis, c in zip(slopes, bases, rates, strict=True))
    told = ", ".join(f"{rate:.3g}" for rate, _ in rates[:3])
    return all_of((off <= CHANGED and np.ptp([rate for rate, _ in rates]) >= CHANGED,
                   f"velocities change by {told}, … dt v in addition to the kick, at a rate that depends on the state: "
                   "the step contains a thermostat such as Berendsen's"))  # fmt: skip


def _of_substeps(parts: Substeps, reached: float, order: int) -> list[str]:
    """The fault of a sequence of three kicks or more of lower order than expected,
    or than a method with nearly its weights: weights are wrong."""
    kicks, near = sum(isinstance(one, Kick) for one in parts), nearest_method(parts)
    is_low = reached <= (max(order - 0.5, HIGH) if near else order - 0.5)
    hint = near or ("; print(md.integrators.METHODS) lists those that have more, and "
                    "md.integrators.CandyRozmus4.substeps their weights")  # fmt: skip
    return all_of((kicks >= FEW and is_low, f"{kicks} kicks in a step, but no more than order {reached:.1f}: the "
                   f"weights of the substeps are not those of a method of higher order{hint}"))  # fmt: skip


def clipped(step: StudentStep, where: Problem) -> list[str]:
    """A limit of the components of velocities, or of speeds: larger values are reduced to it, smaller ones do not
    change."""
    for faster in FASTER:
        v = faster * where.v
        both = [np.abs(v), np.abs(step(where, where.x, v, SHORT)[1])]
        speeds = [np.linalg.norm(one.reshape(len(v), -1), axis=1) for one in both]
        for what, (old, now) in (("components of velocities", both), ("speeds", speeds)):
            cut = np.abs(now - old) > CHANGED * faster
            if cut.sum() < 2 or (cut.all() and faster == 1.0):
                continue
            limit = float(now[cut].mean())
            is_kept = cut.all() or old[~cut].max() < limit + CHANGED * faster
            if np.ptp(now[cut]) < CHANGED and old[cut].min() > limit and is_kept:
                return [f"{what} above {limit:.4g} are cut off: the velocities are limited (clipped) in the step"]
    return []


def same_rows(step: StudentStep, where: Problem) -> list[str]:
    """A path whose rows are all alike, because the same array was appended again and again."""
    if not step.takes("steps"):
        return []
    step.n_steps = 3
    try:
        step(where, where.x, where.v, 0.1)
    finally:
        step.n_steps = 1
    return all_of(*((len(part) > 2 and (part == part[-1]).all(), "all rows of the path are alike: the array is changed "
                     "in place after it was appended. Append a copy, as in xs.append(x.copy())")
                    for part in step.path[:1]))  # fmt: skip


def _structural(laws: dict[str, Finding]) -> list[str]:
    """Sentences for laws that fail although the first terms are right."""
    failed = {name for name, one in laws.items() if one.passed is False}
    return first_of_each(
        (("energy" in failed and laws["energy"].value == 0.0, "the energy is kept to rounding: velocities are rescaled "
            "in each step to keep it, which hides the error of the step and is neither symplectic nor reversible"),),
        (("order" in failed, "the first terms are right, but the measured order is "
                             f"{laws['order'].value:.2f}"),),
        (("momentum" in failed, "the total momentum changes: the forces of a step are not all computed at the same "
                                "positions, or atoms are moved one after another"),),
        (({"symplectic", "volume"} <= failed, "the step shrinks or stretches phase space (see volume), as Runge-Kutta "
            "methods and thermostats do: its energy drifts"),
         ("symplectic" in failed, "the step is not symplectic: it is not a product of kicks and drifts"),
         ("reversible" in failed, "the step is symplectic, but not symmetric: kicks and drifts do not read the same "
                                  "forwards and backwards")),
    )  # fmt: skip
