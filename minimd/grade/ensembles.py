"""Laws of the ensembles: each a row of a table, with its measure in a run, and what a wrong number means."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from scipy.special import polygamma

from minimd.grade.scenes import Array, Frames, Scene


@dataclass
class Facts:
    """What is known when a law is judged.

    is_still : whether the total momentum is kept at zero.  seen : all frames of all runs.  pressure : [eV/Å³].
    """

    scene: Scene
    kt: float
    is_still: bool
    pressure: float
    seen: Frames

    def __post_init__(self) -> None:
        self.masses = self.seen.masses
        self.shares = 1.0 - self.is_still * self.masses / self.masses.sum()  # <p²/m>/kT of a component
        self.n = 3 * len(self.masses)
        self.n_free = self.n - 3 * self.is_still
        # a body at rest whose momenta change with the volume; other than by moves of a Monte Carlo method, some of
        # which are rejected: those of a barostat that acts every few steps are at regular distances
        moved = np.diff(self.seen.volumes.reshape(len(self.seen.ends), -1), axis=1) != 0.0
        gaps = np.concatenate([np.diff(np.flatnonzero(row)) for row in moved])
        n, has_moves = self.scene.n_bodies, bool(gaps.size and np.ptp(gaps) > 1)
        self.n_volume = n + 1 - (self.is_still and not has_moves)  # P<V>/kT
        self.excess = self.n_volume - (n - self.is_still)  # (P<V> − <P_int V>)/kT
        self.heat = float(self.seen.kinetic.sum(axis=1).mean()) / self.n_free
        self.runs_p2 = (self.seen.p**2).mean(axis=(0, 2))
        self.log_volume = float(np.log(self.seen.volumes).mean())


class EnsembleLaw(NamedTuple):
    """One law of an ensemble.

    measure : of a run, a number or one of each group; 1 if the law holds.  words : what is measured.
    cause : what other numbers (G,) mean, in a sentence.
    spare : what is allowed beside the error, since the distribution of the measure is skew.
    """

    name: str
    words: str
    measure: Callable[[Frames, Facts], float | Array]
    cause: Callable[[Array, Facts], str]
    spare: float = 0.0


def nearest(found: float, table: dict[float, str], within: float) -> str:
    """: and the meaning of the number in a table that is nearest, if it is near."""
    best = min(table, key=lambda one: abs(np.log(max(found, 1e-9) / one)))
    return f": {table[best]}" if abs(found / best - 1.0) < within else ""


def temperature_said(means: Array, facts: Facts) -> str:
    """What a wrong temperature means."""
    n, free, ratio = facts.n, facts.n_free, float(means[0])
    table = {
        0.25: "the noise is half as strong as the friction demands: √(2 γ kT m Δt) for a momentum",
        0.5: "the noise is too weak by √2, or the friction acts twice for each noise",
        2.0: "the noise is too strong by √2, or the friction acts for half of the step",
        4.0: "the noise is twice as strong as the friction demands",
        (free - 3.0) / free: f"{free - 3} degrees of freedom are counted where {free} move: three are subtracted twice",
    }
    at_rest = ", since the total momentum is kept at zero" if facts.is_still else ""
    counted = n if facts.is_still else n - 3
    table[counted / free] = f"{counted} degrees of freedom are counted where {free} move{at_rest}"
    said = f"the temperature is {ratio:.3f} times what was asked for"
    return said + nearest(ratio, table, 0.04)


def masses_said(means: Array, facts: Facts) -> str:
    """What a temperature that depends on the mass means."""
    masses = np.unique(facts.masses)
    power = float(np.polyfit(np.log(masses), np.log(np.maximum(means, 1e-9)), 1)[0])
    each = ", ".join(f"{mean:.2f} ({mass:g} amu)" for mean, mass in zip(means, masses, strict=True))
    said = f"atoms of different masses have different temperatures, over that of all: {each}"
    noise = "the noise of a momentum goes with √m, that of a velocity with 1/√m"
    return f"{said}; it goes as m^{power:.1f}: {noise}" if abs(power) > 0.3 else said


def volume_said(means: Array, facts: Facts) -> str:
    """What a wrong mean volume means."""
    n, found = facts.scene.n_bodies, float(means[0]) * facts.n_volume
    table = {float(k): f"p(V) goes as V^{k - 1} exp(−PV/kT)" for k in (n - 1, n, n + 1)}
    table |= {2.0 * k: "it is that of free atoms: is the virial in the pressure?" for k in (n, n + 0.5)}
    table |= {3.0 * k: "the kinetic energy counts twice in the pressure" for k in (n, n + 1 / 3)}
    return f"P<V>/kT of {n} molecules is {found:.2f}, not {facts.n_volume}" + nearest(found, table, 0.07)


def pressure_said(means: Array, facts: Facts) -> str:
    """What a wrong balance of the pressures means."""
    found = (float(means[0]) - 1.0) * facts.n_volume + facts.excess
    table = {
        facts.excess - 1.0: "one power of V too little: N where N + 1 is right",
        facts.excess + 1.0: "one power of V too much: N + 2 where N + 1 is right",
        0.0: "the volume is driven until the mean pressure is P: kT/V is missing beside P_int − P (a factor "
        "1 + 3/N_f of the kinetic energy in Martyna, Tobias, Klein); in a move of ln V, N is for N + 1, N particles",
    }
    near = min(table, key=lambda one: abs(found - one))
    cause = f": {table[near]}" if abs(found - near) < 0.3 else ""
    return f"P<V> − <P_int V> is {found:.2f} kT, not {facts.excess} kT{cause}"


def of_masses(seen: Frames, facts: Facts) -> Array:
    """Kinetic temperatures of atoms of each mass, over that of all."""
    each = seen.kinetic.mean(axis=0) / (3.0 * facts.shares * facts.heat)
    return np.array([each[facts.masses == one].mean() for one in np.unique(facts.masses)])


def of_directions(seen: Frames, facts: Facts) -> Array:
    """Kinetic temperatures along x, y and z, over that of all."""
    energies = (seen.p**2 / (facts.kt * facts.masses)[:, None]).mean(axis=0).sum(axis=0)
    return energies * 3.0 / (facts.heat * facts.n_free)


def of_positions(seen: Frames, facts: Facts) -> Array:
    """<|∇U|²>/(kT <∇²U>) of each atom."""
    curvature = np.mean([facts.scene.springs.curvature(x) for x in seen.x[::4]], axis=0)
    return (seen.f**2).sum(axis=2).mean(axis=0) / (curvature * facts.kt)


def of_pairs(seen: Frames, facts: Facts) -> float:
    """1 + the correlation of momenta of different atoms, less that of a body at rest."""
    u, root = seen.p / np.sqrt(facts.heat * facts.kt * facts.masses)[:, None], np.sqrt(facts.masses)
    pairs = (u.sum(axis=1) ** 2).sum(axis=1).mean() - (u**2).sum(axis=(1, 2)).mean()
    at_rest = -3.0 * facts.is_still * (root.sum() ** 2 - facts.masses.sum()) / facts.masses.sum()
    return 1.0 + float(pairs - at_rest) / facts.n


def of_noise(seen: Frames, facts: Facts) -> float:
    """1 + the correlation of one change of the total momentum with the next."""
    jumps = np.diff(seen.p.sum(axis=1), axis=0)
    size = float((jumps**2).sum())
    if facts.is_still:
        return 1.0
    return 1.0 + (float((jumps[1:] * jumps[:-1]).sum()) / size if size > 1e-20 * facts.kt * facts.masses.sum() else 1.0)


def of_shape(seen: Frames, facts: Facts) -> float:
    """<u⁴>/3<u²>² of the momenta."""
    return float((seen.p**4 / (3.0 * facts.runs_p2**2)[:, None]).mean())


def of_kinetic(seen: Frames, facts: Facts) -> float:
    """The variance of the kinetic energy over that at its mean."""
    each, mean = seen.kinetic.sum(axis=1), facts.heat * facts.n_free
    return float(((each - mean) ** 2).mean()) * facts.n_free / (2.0 * mean**2)


def of_pressure(seen: Frames, facts: Facts) -> float:
    """1 + P<V> − <P_int V> less its value, in units of P<V>;  P_int V = (2 K + Σ r·F)/3."""
    d, e, _ = zip(*(facts.scene.springs.bonds(x) for x in seen.x), strict=True)
    virial = -np.einsum("fbd,fbd,b->f", d, e, facts.scene.springs.k)
    inner = (seen.kinetic.sum(axis=1) + virial / facts.kt) / 3.0
    return 1.0 + float((seen.volumes * facts.pressure / facts.kt - inner).mean() - facts.excess) / facts.n_volume


def of_volume(seen: Frames, facts: Facts) -> float:
    """The variance of ln V over that of p(V) ∝ Vⁿ exp(−PV/kT), ψ′ of P<V>/kT."""
    return float(((np.log(seen.volumes) - facts.log_volume) ** 2).mean() / polygamma(1, facts.n_volume))


BY_DIRECTION = EnsembleLaw(
    "temperature by direction",
    "that along x, y or z, over that of all",
    of_directions,
    lambda means, _: (
        f"motion along x, y, z has {', '.join(f'{mean:.2f}' for mean in means)} times the mean temperature: "
        "do all three get noise and friction?"
    ),
)
TEMPERATURE = EnsembleLaw(
    "temperature",
    "kinetic energy over its share of kT",
    lambda seen, facts: float(seen.kinetic.sum(axis=1).mean()) / facts.n_free,
    temperature_said,
)
BY_MASS = EnsembleLaw("temperature by mass", "that of atoms of a mass, over that of all", of_masses, masses_said)
OF_POSITIONS = EnsembleLaw(
    "temperature of positions",
    "<|∇U|²>/(kT <∇²U>) of atoms",
    of_positions,
    lambda means, _: f"positions of atoms have {means.min():.3f} to {means.max():.3f} times the temperature asked for",
)
CANONICAL = (
    BY_MASS,
    BY_DIRECTION,
    TEMPERATURE,
    OF_POSITIONS,
    EnsembleLaw(
        "fluctuation of the kinetic energy",
        "its variance over that of the canonical ensemble",
        of_kinetic,
        lambda means, _: (
            f"the variance of the kinetic energy is {means[0]:.2f} times the canonical one"
            + ": velocities are scaled toward a temperature, and not drawn from its distribution" * bool(means[0] < 1.0)
        ),
        0.05,
    ),
    EnsembleLaw(
        "normal momenta",
        "<u⁴>/3<u²>² of momenta",
        of_shape,
        lambda means, _: f"momenta are not normally distributed: <u⁴>/3<u²>² is {means[0]:.3f}",
        0.03,
    ),
    EnsembleLaw(
        "independent momenta",
        "1 + correlation of momenta of different atoms",
        of_pairs,
        lambda means, _: (
            f"momenta of different atoms are correlated, by {means[0] - 1.0:+.2f}: each atom needs noise of its own"
        ),
        0.05,
    ),
    EnsembleLaw(
        "new noise",
        "1 + correlation of a change of the total momentum with the next",
        of_noise,
        lambda *_: "the noise of one step is that of the step before: is the generator seeded anew in each step?",
        0.3,
    ),
)
UNDER_PRESSURE = (
    BY_MASS,
    TEMPERATURE,
    EnsembleLaw(
        "mean volume",
        "P<V>/kT over its value",
        lambda seen, facts: float(seen.volumes.mean()) * facts.pressure / (facts.kt * facts.n_volume),
        volume_said,
    ),
    EnsembleLaw("balance of pressures", "1 + the error of P<V> − <P_int V>, over P<V>", of_pressure, pressure_said),
    EnsembleLaw(
        "fluctuation of the volume",
        "the variance of ln V over that of the ensemble",
        of_volume,
        lambda means, _: (
            f"the variance of ln V is {means[0]:.2f} times that of the ensemble: "
            + (
                "the volume is driven toward a pressure, and not drawn from its distribution"
                if means[0] < 1.0
                else "its motion is too hot: do momenta shrink as the volume grows, is its noise √(2 γ W kT)?"
            )
        ),
        0.03,
    ),
)
LAWS: dict[str, tuple[EnsembleLaw, ...]] = {
    "ring": CANONICAL,
    "coarse ring": (TEMPERATURE, OF_POSITIONS),
    "gas": UNDER_PRESSURE,
}
