"""Laws for a step, measured on a few particles: order, reversibility, symplectic form, momenta, energy, the oscillator,
the cost."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from minimd.grade.calling import StudentStep
from minimd.grade.findings import Finding
from minimd.grade.problems import Array, Problem

DURATION, COARSEST = 0.8, 8  # time after which errors are compared, and the smallest number of steps in it
HALVINGS = 4
ORDER_OFF = 0.25  # largest difference between the measured slope and the order
BACK = 10  # steps forwards, and as many backwards
LONG, LONG_STEP = 1000, 0.05  # number of steps of the run for the energy, and their length
BLOCKS, SIGNIFICANT = 10, 4.0
DELTA = 2e-3  # of differences of order 6
STENCIL = {1: 3 / 4, 2: -3 / 20, 3: 1 / 60}
TOO_LARGE = 1e6
EXACTLY = 1e-13  # smaller oscillations of the energy, relative to the kinetic energy, are rounding
FARTHEST = 6.0  # largest ω dt at which a limit of stability is searched


def _run(step: StudentStep, where: Problem, h: float, n: int) -> tuple[Array, Array]:
    x, v = where.x, where.v
    for _ in range(n):
        x, v = step(where, x, v, h)
    return x, v


def order_of(step: StudentStep, where: Problem, expected: int) -> Finding:
    """The order: the slope, in a logarithmic plot, of the error after a fixed time against the time step."""
    x, v = where.flow(DURATION)
    counts = COARSEST * 2 ** np.arange(HALVINGS)
    errors = []
    for n in counts:
        xn, vn = _run(step, where, DURATION / n, int(n))
        errors.append(float(np.sqrt(np.sum((xn - x) ** 2) + np.sum((vn - v) ** 2))))
    if not np.isfinite(errors).all():
        return Finding("order", False, "the path is unbounded: positions or velocities are not finite", float("nan"))
    kept = [k for k in range(HALVINGS) if errors[k] > 1e-11] or [0, 1]
    kept = kept[-3:] if len(kept) > 2 else [0, 1]
    slope = float(-np.polyfit(np.log(counts[kept]), np.log(np.maximum([errors[k] for k in kept], 1e-300)), 1)[0])
    if slope < ORDER_OFF:
        words = (
            f"0: the error does not decrease with dt, it remains {errors[-1]:.2g}; the step does not solve "
            "Newton's equation"
        )
        return Finding("order", False, words, slope)
    words = (
        f"{slope:.2f} measured, {expected} expected; error {errors[-1]:.1e} at t = {DURATION:g}, dt = "
        f"{DURATION / counts[-1]:g}"
    )
    return Finding("order", slope > expected - ORDER_OFF, words, slope)


def reversal(step: StudentStep, where: Problem, noise: float) -> Finding:
    """Some steps, velocities reversed, as many steps again: the distance from the start,
    compared with the length of the way."""
    x, v = _run(step, where, 0.05, BACK)
    way = float(np.abs(x - where.x).max())
    x, v = _run(step, where._replace(x=x, v=-v), 0.05, BACK)
    off = float(max(np.abs(x - where.x).max(), np.abs(v + where.v).max()))
    ok = off < max(1e-11, 100.0 * noise) * max(1.0, way)
    return Finding(
        "reversible",
        ok,
        f"after {BACK} steps and as many back, the distance from the start is {off:.1e}; the way was {way:.2g}",
        off,
    )


def jacobian(step: StudentStep, where: Problem, h: float) -> Array:
    """∂(x₁, v₁)/∂(x, v), by differences of order 6."""
    n, shape = where.x.size, where.x.shape
    start, columns = np.concatenate([np.ravel(where.x), np.ravel(where.v)]), []

    def end(y: Array) -> Array:
        x, v = step(where, y[:n].reshape(shape), y[n:].reshape(shape), h)
        return np.concatenate([np.ravel(x), np.ravel(v)])

    for unit in np.eye(2 * n):
        columns.append(
            sum(c * (end(start + k * DELTA * unit) - end(start - k * DELTA * unit)) for k, c in STENCIL.items()) / DELTA
        )
    return np.array(columns).T


def symplecticity(step: StudentStep, where: Problem, noise: float) -> list[Finding]:
    """JᵀΩJ = Ω in positions and momenta, and det J = 1."""
    matrix, n = jacobian(step, where, 0.1), where.x.size
    masses = np.ravel(np.broadcast_to(where.mass, where.x.shape))
    scale = np.concatenate([np.ones(n), masses])
    matrix = scale[:, None] * matrix / scale
    omega = np.block([[np.zeros((n, n)), np.eye(n)], [-np.eye(n), np.zeros((n, n))]])
    off, limit = float(np.abs(matrix.T @ omega @ matrix - omega).max()), max(1e-9, 1e3 * noise)
    volume = float(np.linalg.det(matrix)) - 1.0
    return [
        Finding("symplectic", off < limit, f"largest element of JᵀΩJ − Ω: {off:.1e} at dt = 0.1", off),
        Finding(
            "volume",
            abs(volume) < limit * n,
            f"det J = 1 {'+' if volume >= 0 else '−'} {abs(volume):.1e} at dt = 0.1",
            volume,
        ),
    ]


def momenta(step: StudentStep, where: Problem, noise: float) -> list[Finding]:
    """Changes of linear and angular momentum in some steps, for problems that conserve them."""
    if where.x.ndim == 0 or where.stiffness:
        return []
    x, v = _run(step, where, 0.05, 20)
    p0, p1 = where.mass * where.v, where.mass * v
    limit, scale = max(1e-11, 100.0 * noise), float(np.abs(p0).sum())
    off = float(np.abs(p1.sum(axis=0) - p0.sum(axis=0)).max()) / scale
    answers = [Finding("momentum", off < limit, f"changes by {off:.1e} of Σ|mv| in 20 steps", off)]
    if where.x.ndim == 2:
        before, after = (
            np.cross(np.pad(a, ((0, 0), (0, 3 - a.shape[1]))), np.pad(b, ((0, 0), (0, 3 - b.shape[1]))))
            for a, b in ((where.x, p0), (x, p1))
        )
        off = float(np.abs((after - before).sum(axis=0)).max()) / float(np.abs(before).sum())
        answers.append(Finding("angular momentum", off < limit, f"changes by {off:.1e} of Σ|r × mv| in 20 steps", off))
    return answers


def energy(step: StudentStep, where: Problem) -> Finding:
    """Drift and oscillation of the total energy in a long run, compared with the mean kinetic energy."""
    x, v, energies, kinetic = where.x, where.v, [], []
    for _ in range(LONG):
        x, v = step(where, x, v, LONG_STEP)
        energies.append(where.energy(x, v))
        kinetic.append(energies[-1] - where.potential(x))
        if not np.isfinite(energies[-1]) or abs(energies[-1]) > TOO_LARGE:
            return Finding(
                "energy",
                False,
                f"grows without bound: it is beyond {TOO_LARGE:g} after {len(energies)} steps of {LONG_STEP:g}",
                np.inf,
            )
    series, k = np.array(energies), float(np.mean(kinetic))
    means = series.reshape(BLOCKS, -1).mean(axis=1)
    slope, rest = np.polyfit(np.arange(BLOCKS), means, 1)[0] * BLOCKS / LONG, 0.0
    line = np.polyval(np.polyfit(np.arange(BLOCKS), means, 1), np.arange(BLOCKS))
    rest = (
        float(np.sqrt(np.sum((means - line) ** 2) / (BLOCKS - 2) / (BLOCKS * (BLOCKS**2 - 1) / 12.0))) * BLOCKS / LONG
    )
    oscillation = float(np.std(series - np.polyval(np.polyfit(np.arange(LONG), series, 1), np.arange(LONG)))) / k
    # slow oscillations look like less
    drifts = abs(slope) > SIGNIFICANT * rest and abs(slope) * LONG > max(1e-9, oscillation) * k
    verb = (
        ("grows" if slope > 0 else "falls") + f" by {abs(slope) / k:.1e} of the kinetic energy per step"
        if drifts
        else "does not drift"
    )
    if oscillation < EXACTLY:
        return Finding(
            "energy",
            False,
            f"constant to rounding, {oscillation:.1e} of the kinetic energy: no explicit step has this property by "
            "itself",
            0.0,
        )
    words = f"{verb}; it oscillates by {oscillation:.1e} (dt = {LONG_STEP:g})"
    return Finding("energy", not drifts, words, float(slope) / k)


def oscillator(step: StudentStep) -> Finding:
    """The step as a matrix, for x″ = −x: its determinant, the quadratic form that it conserves,
    and the longest stable step."""
    omega = np.sqrt(step.stiffness or 1.0)
    where = step.problem(1, stiffness=float(omega**2))
    where = where._replace(m=np.ones_like(where.m))

    def matrix(h: float) -> Array:
        columns = []
        for x0, v0 in ((1.0, 0.0), (0.0, omega)):
            x, v = step(where, x0 * np.ones_like(where.x), v0 * np.ones_like(where.v), h / omega)
            columns.append((np.ravel(x)[0], np.ravel(v)[0] / omega))
        return np.array(columns).T

    m, h = matrix(0.5), 0.5
    off = float(np.linalg.det(m)) - 1.0
    if not np.isfinite(off) or abs(off) > 1e-7:
        verb = "grows" if off > 0.0 else "falls"
        return Finding(
            "oscillator",
            False,
            f"no quadratic form is conserved: at ω dt = {h:g} the energy {verb} by the factor {1.0 + off:.4g} in each "
            "step",
            off,
        )
    skew = (m[1, 1] - m[0, 0]) / m[0, 1]
    mixed = "" if abs(skew) < 1e-9 else f" {'+' if skew > 0 else '−'} {abs(skew):.4g} ω x v"
    limit = stable_up_to(lambda one: abs(float(np.trace(matrix(one)))) <= 2.0 + 1e-9)
    stiffness = -m[1, 0] / m[0, 1]
    constant = f"v² {'+' if stiffness > 0.0 else '−'} {abs(stiffness):.6g} ω² x²{mixed}"
    return Finding(
        "oscillator", limit > 0.0, f"at ω dt = {h:g} it conserves {constant}; stable up to ω dt = {limit:.2f}", limit
    )


def stable_up_to(is_stable: Callable[[float], bool]) -> float:
    """The longest stable ω dt: the first failure on a grid, then bisection."""
    grid = np.linspace(0.2, FARTHEST, 30)
    first = next((float(one) for one in grid if not is_stable(float(one))), None)
    if first is None:
        return FARTHEST
    low, high = first - float(grid[1] - grid[0]), first
    for _ in range(10):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if is_stable(middle) else (low, middle)
    return low if low > 0.01 else 0.0


def cost(step: StudentStep, where: Problem) -> Finding:
    """The number of force evaluations in one step."""
    if not step.is_given_forces:
        return Finding("cost", None, "not counted: the step computes its force itself")
    step.n_evaluations = 0
    step(where, where.x, where.v, 0.05)
    n, more = step.n_evaluations, ""
    if n == 2:
        more = "; one is enough if the force at the end of a step is kept for the next step"
    return Finding("cost", None if n != 1 else True, f"{n} force evaluation{'s' * (n != 1)} per step{more}", float(n))
