"""Laws of the ensembles: each a row of a table, with its measure in a run, and what a wrong number means."""

from collections.abc import Callable
from typing import Any, TypeAlias

import numpy as np
from scipy import stats
from scipy.special import polygamma

from minimd.core.structure.arrays import Array
from minimd.judge.findings import Law, Measurement, nearest
from minimd.judge.scenes import SOFT, Frames, Scene, joined

UNSEEN = (
    0.2  # error of a law that is judged: it must be large enough to show beside that of statistics
)
LEAST = 0.2  # mean of a measure, for its error
ACTED = 0.2  # of the energy, or the volume, is new at the end of a run, at least
NEVER = 1e-6  # the same, at most, if nothing acts


class Seen:
    """What was seen of a scene.

    scene, runs : the scene, and the frames of each run.
    is_still : whether the total momentum is kept at zero.
    pressure : [eV/Å³].
    rate : of false alarms, of each law.
    has : features of the scene.
    all : frames of all runs.
    """

    def __init__(
        self, scene: Scene, runs: list[Frames], is_still: bool, pressure: float, rate: float
    ) -> None:
        self.scene = scene
        self.runs = runs
        self.is_still = is_still
        self.pressure = pressure
        self.rate = rate
        self.has = {*scene.has.split()}
        self.all = joined(runs)
        self.kt = runs[0].kt
        self.masses = self.all.masses
        self.n = 3 * len(self.masses)
        # <p²/m>/kT of a component
        self.shares = 1.0 - is_still * self.masses / self.masses.sum() - scene.rigid
        self.n_free = round(3.0 * self.shares.sum())

        # a body at rest whose momenta change with the volume; other than by moves of a Monte Carlo method, some of
        # which are rejected: those of a barostat that acts every few steps are at regular distances
        volumes = self.all.volumes.reshape(len(runs), -1)
        moved = np.diff(volumes, axis=1) != 0.0
        gaps = np.concatenate([np.diff(np.flatnonzero(row)) for row in moved])
        n = scene.n_bodies
        has_moves = gaps.size and np.ptp(gaps) > 1
        self.n_volume = n + 1 - (is_still and not has_moves)  # P<V>/kT
        self.excess = self.n_volume - (n - is_still)  # (P<V> − <P_int V>)/kT

        self.heat = self.all.kinetic.sum(axis=1).mean() / self.n_free
        self.runs_p2 = (self.all.p**2).mean(axis=(0, 2))
        self.log_volume = np.log(self.all.volumes).mean()

    def over_runs(
        self, measure: "Measure", said: "Said", spare: float, decides: bool
    ) -> Measurement:
        """The mean of a measure over the runs, and how far it is off beside its error; of several, the worst. The
        spread of runs goes with the mean: where the mean is small by chance, the spread is too small. A law passes only
        if an error of UNSEEN would show."""
        values = np.array([np.atleast_1d(measure(run, self)) for run in self.runs])
        means = values.mean(axis=0)
        n = len(values)
        errors = values.std(axis=0, ddof=1) / np.sqrt(n)
        quantile = stats.t.isf(0.5 * self.rate / len(means), n - 1)
        statistical = quantile * errors / np.clip(means, LEAST, 1.0)
        limits = statistical + spare + self.scene.error
        k = np.argmax(np.abs(means - 1.0) / limits)
        mean = means[k]
        limit = float(limits[k])
        off = (mean - 1.0) / limit
        is_unseen = abs(off) < 1.0 and statistical[k] > UNSEEN
        allowed = ""
        if self.scene.error > statistical[k]:
            allowed = f"; {self.scene.error:.1%} of that is allowed to the time step, (ωΔt)²/2"
        if is_unseen:
            off = np.nan
            allowed += ": too coarse to judge"
        is_open = decides and bool(is_unseen)
        return Measurement(mean, off, said(means, self), errors[k], limit, allowed, is_open)

    def acted(self) -> Measurement:
        """How much of the energy, or of the volume, is new at the end of a run."""
        column = int("volume" in self.has)
        ends = self.all.ends[:, :, column]
        changes = ends[:, 1] - ends[:, 0]
        share = (changes**2).mean() / max(2.0 * ends.var(), 1e-300)
        if share >= ACTED:
            return Measurement(min(share, 1.0), 0.0)
        off = 1.0 if share < NEVER else np.nan
        advice = ": too little to judge; take a shorter relaxation time, or more steps="
        return Measurement(share, off, advice, is_open=True)


Measure: TypeAlias = Callable[[Frames, Seen], Any]
Said: TypeAlias = Callable[[Array, Seen], str]


def temperature_said(means: Array, seen: Seen) -> str:
    """What a wrong temperature means."""
    free = seen.n_free
    ratio = means[0]
    table = {
        0.25: "the noise is half as strong as the friction demands: a momentum needs √(2 γ kT m Δt)",
        0.5: "the noise is too weak by a factor √2, or the friction acts twice per step",
        2.0: "the noise is too strong by a factor √2, or the friction acts for half a step only",
        4.0: "the noise is twice as strong as the friction demands",
    }

    def count(n: int, cause: str) -> None:
        table[n / free] = f"{n} degrees of freedom are counted where {free} move{cause}"

    count(free - 3, ": three are subtracted twice")
    n_rigid = round(3.0 * seen.scene.rigid.sum())
    if n_rigid:
        count(free + n_rigid, ": bonds are rigid")
    if seen.is_still:
        count(free + 3, ", since the total momentum is kept at zero")
    else:
        count(free - 3, "")
    return f"the temperature is {ratio:.3f} times what was asked for" + nearest(ratio, table, 0.04)


def masses_said(means: Array, seen: Seen) -> str:
    """What a temperature that depends on the mass means."""
    masses = np.unique(seen.masses)
    logs = np.log(np.maximum(means, 1e-9))
    power = np.polyfit(np.log(masses), logs, 1)[0]
    pairs = zip(means, masses, strict=True)
    each = ", ".join(f"{mean:.2f} ({mass:g} amu)" for mean, mass in pairs)
    cause = ""
    if abs(power) > 0.3:
        cause = (
            f"; the temperature goes as m^{power:.1f}: momenta need noise as √m, velocities as 1/√m"
        )
    return f"atoms of different masses have different temperatures, relative to the mean: {each}{cause}"


def volume_said(means: Array, seen: Seen) -> str:
    """What a wrong mean volume means."""
    n = seen.scene.n_bodies
    ratio = means[0] * seen.n_volume
    table = dict[float, str]()
    for power in (n - 2, n - 1, n):
        table[power + 1.0] = f"p(V) goes as V^{power} exp(−PV/kT)"
    for k in (n, n + 0.5):
        table[2.0 * k] = "this is the value of free atoms: is the virial in the pressure?"
    for k in (n, n + 1 / 3):
        table[3.0 * k] = "the kinetic energy counts twice in the pressure"
    cause = nearest(ratio, table, 0.07)
    return f"P<V>/kT of {n} molecules is {ratio:.2f}, not {seen.n_volume}{cause}"


def pressure_said(means: Array, seen: Seen) -> str:
    """What a wrong balance of the pressures means."""
    difference = (means[0] - 1.0) * seen.n_volume + seen.excess
    table = {
        seen.excess - 1.0: "p(V) lacks one power of V: N where N + 1 is right",
        seen.excess + 1.0: "p(V) has one power of V too many: N + 2 where N + 1 is right",
        0.0: "the mean pressure is driven to P: add kT/V to P_int − P (in Martyna, Tobias, Klein a factor 1 + 3/N_f "
        "of the kinetic energy); a Monte Carlo move of ln V needs the power N + 1 of V for N particles, not N",
    }
    near = min(table, key=lambda value: abs(difference - value))
    cause = f": {table[near]}" if abs(difference - near) < 0.3 else ""
    return f"P<V> − <P_int V> is {difference:.2f} kT, not {seen.excess} kT{cause}"


def spread_said(means: Array, _: Seen) -> str:
    """What a wrong fluctuation of the volume means."""
    cause = "the volume is driven toward a pressure, and not drawn from its distribution"
    if means[0] > 1.0:
        cause = "the volume moves too fast: do momenta shrink as it grows, and is its noise √(2 γ W kT)?"
    return f"the variance of ln V is {means[0]:.2f} times that of the ensemble: {cause}"


def kinetic_said(means: Array, _: Seen) -> str:
    """What a wrong fluctuation of the kinetic energy means."""
    cause = ""
    if means[0] < 1.0:
        cause = ": velocities are scaled toward a temperature, and not drawn from its distribution"
    return f"the variance of the kinetic energy is {means[0]:.2f} times the canonical one{cause}"


def directions_said(means: Array, _: Seen) -> str:
    """What temperatures that depend on the direction mean."""
    x, y, z = means
    return (
        f"motion along x, y, z has {x:.2f}, {y:.2f}, {z:.2f} times the mean temperature: do all three get noise and "
        "friction?"
    )


def positions_said(means: Array, _: Seen) -> str:
    """What a wrong temperature of positions means."""
    return f"positions of atoms have {means.min():.3f} to {means.max():.3f} times the temperature asked for"


def components_said(means: Array, _: Seen) -> str:
    """What correlated components of a momentum mean."""
    least = means.min() - 1.0
    most = means.max() - 1.0
    return (
        f"the components x, y, z of a momentum are correlated, by {least:+.2f} to {most:+.2f}: each needs a random "
        "number of its own"
    )


def of_masses(run: Frames, seen: Seen) -> Array:
    """Kinetic temperatures of atoms of each mass, over that of all."""
    each = run.kinetic.mean(axis=0) / (3.0 * seen.shares * seen.heat)
    return np.array([each[seen.masses == mass].mean() for mass in np.unique(seen.masses)])


def of_directions(run: Frames, seen: Seen) -> Array:
    """Kinetic temperatures along x, y and z, over that of all."""
    p2 = run.p**2 / (seen.kt * seen.masses)[:, None]
    energies = p2.mean(axis=0).sum(axis=0)
    return energies * 3.0 / (seen.heat * seen.n_free)


def of_positions(run: Frames, seen: Seen) -> Array:
    """<|∇U|²>/(kT <∇²U>) of each atom."""
    curvatures = [seen.scene.calculator.curvature(x) for x in run.x[::4]]
    forces2 = (run.f**2).sum(axis=2).mean(axis=0)
    return forces2 / (np.mean(curvatures, axis=0) * seen.kt)


def of_pairs(run: Frames, seen: Seen) -> float:
    """1 + the correlation of momenta of different atoms, less that of a body at rest."""
    masses = seen.masses
    u = run.p / np.sqrt(seen.heat * seen.kt * masses)[:, None]
    total2 = (u.sum(axis=1) ** 2).sum(axis=1).mean()
    pairs = total2 - (u**2).sum(axis=(1, 2)).mean()
    at_rest = 0.0
    if seen.is_still:
        at_rest = -3.0 * (np.sqrt(masses).sum() ** 2 - masses.sum()) / masses.sum()
    return 1.0 + (pairs - at_rest) / seen.n


def of_noise(run: Frames, seen: Seen) -> float:
    """1 + the correlation of one change of the total momentum with the next; 1 if it is negative, as of momenta that
    are drawn anew each time."""
    if seen.is_still:
        return 1.0
    jumps = np.diff(run.p.sum(axis=1), axis=0)
    size = (jumps**2).sum()
    if size <= 1e-20 * seen.kt * seen.masses.sum():
        return 2.0
    return 1.0 + max(0.0, (jumps[1:] * jumps[:-1]).sum() / size)


def of_kinetic(run: Frames, seen: Seen) -> float:
    """The variance of the kinetic energy over that at its mean."""
    mean = seen.heat * seen.n_free
    squares = (run.kinetic.sum(axis=1) - mean) ** 2
    return squares.mean() * seen.n_free / (2.0 * mean**2)


def of_pressure(run: Frames, seen: Seen) -> float:
    """1 + P<V> − <P_int V> less its value, in units of P<V>;  P_int V = (2 K + Σ r·F)/3."""
    calculator = seen.scene.calculator
    d, e, _ = zip(*(calculator.bonds(x) for x in run.x), strict=True)
    virial = -np.einsum("fbd,fbd,b->f", d, e, calculator.k)
    inner = (run.kinetic.sum(axis=1) + virial / seen.kt) / 3.0
    outer = run.volumes * seen.pressure / seen.kt
    difference = (outer - inner).mean()
    return 1.0 + (difference - seen.excess) / seen.n_volume


def of_temperature(run: Frames, seen: Seen) -> float:
    """The kinetic energy over its share of kT."""
    return run.kinetic.sum(axis=1).mean() / seen.n_free


def of_fourth_powers(run: Frames, seen: Seen) -> float:
    """<u⁴>/3<u²>² of momenta."""
    return (run.p**4 / (3.0 * seen.runs_p2**2)[:, None]).mean()


def of_components(run: Frames, seen: Seen) -> Array:
    """1 + the correlations of x and y, y and z, z and x of a momentum."""
    products = run.p * np.roll(run.p, -1, axis=2)
    return 1.0 + (products / seen.runs_p2[:, None]).mean(axis=(0, 1))


def of_volume(run: Frames, seen: Seen) -> float:
    """P<V>/kT over its value."""
    return run.volumes.mean() * seen.pressure / (seen.kt * seen.n_volume)


def of_log_volume(run: Frames, seen: Seen) -> float:
    """The variance of ln V over that of the ensemble."""
    spread = ((np.log(run.volumes) - seen.log_volume) ** 2).mean()
    return spread / polygamma(1, seen.n_volume)


def row(
    name: str,
    quantity: str,
    measure: Measure,
    said: Said,
    needs: str,
    spare: float = 0.0,
    decides: bool = False,
) -> Law:
    """A law of an ensemble.

    quantity : what is measured.
    measure : of a run, a number or one of each group; 1 if the law holds.
    said : what other numbers (G,) mean.
    spare : what is allowed beside the error, since the distribution of the measure is skew.
    decides : whether a grade needs its answer.
    """
    quantity += ": {0:.3f} ± {3:.3f} (an error of {4:.1%} would show{5})"
    return Law(
        name,
        lambda seen: seen.over_runs(measure, said, spare, decides),
        1.0,
        quantity,
        "{2}",
        needs,
    )


BONDS = "lengths, and velocities along bonds, are off by {0:.1e}"
BONDS_FAULT = "rigid bonds change their lengths, by {0:.1e}"
LAWS = (  # of what a scene has
    Law(
        "constant volume",
        lambda seen: float(np.ptp(seen.all.volumes) > 0.0),
        0.5,
        "changed in {0:g} of 1",
        "the volume changes: give pressure= to have it judged as NPT",
        "fixed",
    ),
    Law(
        "the bath acts",
        Seen.acted,
        0.5,
        "{0:.0%} of the energy is new at the end of a run{2}",
        "the energy never changes: nothing acts on it",
        "fixed",
    ),
    Law(
        "the barostat acts",
        Seen.acted,
        0.5,
        "{0:.0%} of the volume is new at the end of a run{2}",
        "the volume never changes: nothing acts on it",
        "volume",
    ),
    row(
        "temperature by mass",
        "that of atoms of one mass over that of all atoms",
        of_masses,
        masses_said,
        "masses",
    ),
    row(
        "temperature by direction",
        "that along x, y or z over the mean",
        of_directions,
        directions_said,
        "ring",
    ),
    row(
        "temperature",
        "kinetic energy over its share of kT",
        of_temperature,
        temperature_said,
        "",
        decides=True,
    ),
    row(
        "temperature of positions",
        "<|∇U|²>/(kT <∇²U>) of atoms",
        of_positions,
        positions_said,
        "places",
    ),
    row(
        "fluctuation of the kinetic energy",
        "its variance over that of the canonical ensemble",
        of_kinetic,
        kinetic_said,
        "spread",
        0.05,
    ),
    row(
        "normal momenta",
        "<u⁴>/3<u²>² of momenta",
        of_fourth_powers,
        lambda means, _: f"momenta are not normally distributed: <u⁴>/3<u²>² is {means[0]:.3f}",
        "ring",
        0.03,
    ),
    row(
        "independent momenta",
        "1 + correlation of momenta of different atoms",
        of_pairs,
        lambda means, _: (
            f"momenta of different atoms are correlated, by {means[0] - 1.0:+.2f}: each atom needs noise "
            "of its own"
        ),
        "ring",
        0.05,
    ),
    row(
        "independent directions",
        "1 + correlation of two components of a momentum",
        of_components,
        components_said,
        "ring",
        0.05,
    ),
    row(
        "new noise",
        "1 + correlation of a change of the total momentum with the next",
        of_noise,
        lambda *_: (
            "the noise of one step is that of the step before: is the generator seeded anew in each step?"
        ),
        "ring",
        0.3,
    ),
    row(
        "mean volume",
        "P<V>/kT over its value",
        of_volume,
        volume_said,
        "volume",
        decides=True,
    ),
    row(
        "balance of pressures",
        "1 + the error of P<V> − <P_int V>, over P<V>",
        of_pressure,
        pressure_said,
        "volume",
    ),
    row(
        "fluctuation of the volume",
        "the variance of ln V over that of the ensemble",
        of_log_volume,
        spread_said,
        "volume",
        0.03,
    ),
    Law(
        "rigid bonds",
        lambda seen: seen.scene.calculator.softness(seen.all),
        SOFT,
        BONDS,
        BONDS_FAULT,
        "rigid",
    ),
    row(
        "energy of the liquid",
        "over that of NIST",
        lambda run, seen: run.u.mean() / seen.scene.wanted,
        lambda means, _: f"the energy of the liquid is {means[0]:.4f} times that of NIST",
        "liquid",
    ),
    row(
        "density of the liquid",
        "V over that of NIST",
        lambda run, seen: run.volumes.mean() / seen.scene.wanted,
        lambda means, _: f"the volume of the liquid is {means[0]:.4f} times that of NIST",
        "pressed",
    ),
)
