"""The problem on which a student's step is tested: a few particles with smooth, anharmonic forces in its dimensions,
U = Σ_{i<j} ½ k r² + ¼ g r⁴, or one number, U = ½ q² + ¼ 0.3 q⁴. Frequencies are about 1, and all masses differ."""

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np

from minimd.core.structure.arrays import Array

Function = Callable[..., Any]  # a student's
STIFFNESS = 0.25  # k and g for N particles
QUARTIC = 0.06
MASSES = np.array([1.0, 1.7, 0.6, 2.3, 1.2])
SHAPES: tuple[tuple[int, ...], ...] = ((5, 3), (5, 2), (5,), ())


def largest(x: Any) -> Any:
    """The largest absolute value in an array."""
    return np.abs(x).max()


def difference(f: Callable[[Any], Any], x: Any, step: Any) -> Any:
    """step · f′(x) along a step, by a difference of order 6."""
    weights = {1: 3 / 4, 2: -3 / 20, 3: 1 / 60}
    return sum(c * (f(x + k * step) - f(x - k * step)) for k, c in weights.items())


def bisected(
    is_low: Callable[[float, float, float], bool], low: float, high: float, n: int
) -> tuple[float, float]:
    """An interval after n bisections.

    is_low(low, middle, high) : whether the middle is the new lower end.
    """
    for _ in range(n):
        middle = 0.5 * (low + high)
        if is_low(low, middle, high):
            low = middle
        else:
            high = middle
    return low, high


def multiple_of(f: Array, g: Array, within: float) -> float:
    """c if f = c g within a fraction of the largest |g|, else NaN."""
    c = np.sum(f * g) / np.sum(g * g)
    is_multiple = largest(f - c * g) < within * largest(g)
    return c if is_multiple else np.nan


class TrialProblem(NamedTuple):
    """A state of a few particles.

    x, v : positions and velocities of one shape: (N, d), (N,) or ().
    m : masses, (N,) or ().
    stiffness : if it is not zero, of springs to the origin, which replace all other forces.
    """

    x: Array
    v: Array
    m: Array
    stiffness: float = 0.0

    def at(self, x: Array) -> tuple[Array, float]:
        """−∇U, in the shape of x, and U."""
        k = self.stiffness
        g = 0.0
        if self.x.ndim == 0 and not k:
            k = 1.0
            g = 0.3
        if k:
            energy = np.sum(0.5 * k * x * x + 0.25 * g * x**4)
            return np.asarray(-x * (k + g * x * x)), float(energy)
        points = x.reshape(len(x), -1)
        apart = points[:, None] - points
        r2 = (apart * apart).sum(axis=2, keepdims=True)
        energy = (0.5 * STIFFNESS * r2 + 0.25 * QUARTIC * r2 * r2).sum() / 2.0
        force = -((STIFFNESS + QUARTIC * r2) * apart).sum(axis=1)
        return force.reshape(x.shape), float(energy)

    def force(self, x: Array) -> Array:
        """−∇U, in the shape of x."""
        return self.at(x)[0]

    def scaled(self, name: str, x: Array) -> Array:
        """−∇U as a "force", as an "acceleration", or with the other sign as a "gradient"."""
        force = self.force(x)
        if name == "gradient":
            return -force
        return force / self.mass if name == "acceleration" else force

    @property
    def mass(self) -> Array:
        """Masses in a shape that can be multiplied with x."""
        n_missing = self.x.ndim - self.m.ndim
        return self.m.reshape(self.m.shape + (1,) * n_missing)

    def flow(self, time: float) -> Array:
        """The exact x and v after a time, to about 1e-13, (2, *shape of x)."""
        from scipy.integrate import solve_ivp

        def slope(_: float, y: Array) -> Array:
            x, v = y.reshape(2, *self.x.shape)
            return np.ravel([v, self.force(x) / self.mass])

        start = np.ravel([self.x, self.v])
        path = solve_ivp(slope, (0.0, time), start, "DOP853", rtol=1e-13, atol=1e-14)
        return path.y[:, -1].reshape(2, *self.x.shape)


def problem(shape: tuple[int, ...], seed: int, same_mass: bool, stiffness: float) -> TrialProblem:
    """A random state.

    same_mass : the same mass for all particles; it depends on the seed.
    """
    random = np.random.default_rng(seed)
    x = random.uniform(0.5, 2.5, shape)
    v = random.normal(0.0, 0.6, shape)
    masses = np.roll(MASSES, seed)
    if same_mass or not shape:
        masses = masses[0] * np.ones(shape[:1])
    return TrialProblem(np.asarray(x), np.asarray(v), np.asarray(masses), stiffness)
