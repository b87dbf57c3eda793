"""Laws for a step, measured on a few particles: order, reversibility, symplectic form, momenta, energy, the oscillator,
the cost."""

from __future__ import annotations

import numpy as np
from numpy.polynomial import Polynomial

from minimd.grade.calling import StudentStep
from minimd.grade.findings import Finding
from minimd.grade.problems import Array, Problem, bisected, difference

DURATION, COARSEST, HALVINGS = 0.8, 8, 4  # errors are compared after this time, made in 8, 16, 32 and 64 steps
ORDER_OFF = 0.25  # largest difference between the measured slope and the order
SHORT, LONG = 0.05, 1000  # time step of the runs, and number of steps of the run for the energy
BACK, SOME = 10, 20  # steps forwards, and as many backwards; steps in which momenta are compared
BLOCKS, SIGNIFICANT = 10, 4.0
DELTA = 2e-3  # of differences
TOO_LARGE = 1e6
EXACTLY = 1e-13  # smaller oscillations of the energy, relative to the kinetic energy, are rounding
FARTHEST = 6.0  # largest ω dt at which a limit of stability is searched


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
    x, v = run(step, where, SHORT, BACK)
    way = float(np.abs(x - where.x).max())
    x, v = run(step, where._replace(x=x, v=-v), SHORT, BACK)
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
    x, v = run(step, where, SHORT, SOME)
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
        x, v = step(where, x, v, SHORT)
        energies.append(where.energy(x, v))
        kinetic.append(energies[-1] - where.potential(x))
        if not np.isfinite(energies[-1]) or abs(energies[-1]) > TOO_LARGE:
            words = f"grows without bound: it is beyond {TOO_LARGE:g} after {len(energies)} steps of {SHORT:g}"
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
    words = f"{verb if drifts else 'does not drift'}; it oscillates by {oscillation:.1e} (dt = {SHORT:g})"
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
    step(where, where.x, where.v, SHORT)
    n = step.n_evaluations
    more = "; one is enough if the force at the end of a step is kept for the next step" if n == 2 else ""
    return Finding("cost", True if n == 1 else None, f"{n} force evaluation{'s' * (n != 1)} per step{more}", float(n))
