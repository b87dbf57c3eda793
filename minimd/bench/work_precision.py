"""`minimd bench work-precision`: run time against error, for every method, time step and precision,
and for peers that can run the scene.

Errors of a run, all relative:

    oscillation   standard deviation of the total energy about its line of regression / (k_B T √n_dof)
    drift         |slope of that line| · duration / (k_B T √n_dof)
    distance      of the positions from a converged path after a short time, root mean square / σ
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

import minimd as md
from minimd.bench import engines
from minimd.bench.outcome import MOST_CURVES, draw, name_curves, new_figure, table
from minimd.bench.scenes import MELT, SCENES, BenchScene, equilibrated, lennard_jones
from minimd.bench.turns import timed
from minimd.core.compiled.terminal import tell
from minimd.core.integrators.splitting import Splitting
from minimd.core.integrators.table import SPLITTINGS
from minimd.core.structure.arrays import Array
from minimd.core.structure.errors import ConvergenceError
from minimd.textbook.methods import IMPLICIT

if TYPE_CHECKING:
    from matplotlib.figure import Figure

DURATION = 4.0  # τ, of a run
OBSERVATIONS = 20  # times at which its energy is read
SHORT = 0.2  # τ, time at which the distance is measured: before chaos has amplified rounding
COSTS = (100, 141, 200, 283, 400, 566, 800, 1600, 3200)  # forces per τ
COSTS_QUICK = (100, 200, 400, 800)
REFERENCE = "kahan-li-8"
REFERENCE_COST = 34_000
QUICK_METHODS = (
    "velocity-verlet",
    "symplectic-euler-1",
    "candy-rozmus-4",
    "pefrl",
    "blanes-moan-rkn-4",
    "kahan-li-8",
)
PEER_NAMES = ("lammps", "lammps-checked", "openmm")
CELLS = 10  # 4000 atoms
CELLS_QUICK = 6  # 864
TARGETS = 10.0 ** np.arange(-1, -9, -1)
ERRORS = ("oscillation", "drift", "distance")
ECCENTRICITY = 0.6
PERIODS = 20
Q0 = np.array([1.0 - ECCENTRICITY, 0.0])
V0 = np.array([0.0, np.sqrt((1.0 + ECCENTRICITY) / (1.0 - ECCENTRICITY))])
END = 2.0 * np.pi * PERIODS


class Point(NamedTuple):
    """One run.
    who : engine and precision.
    order : of its method.
    forces : evaluations per unit of time.
    Errors that are unknown are NaN, those of a run that failed infinite."""

    who: str
    method: str
    order: int
    timestep: float
    forces: float
    seconds: float = np.inf
    oscillation: float = np.inf
    drift: float = np.inf
    distance: float = np.inf

    @property
    def is_minimd(self) -> bool:
        """False for a peer."""
        return self.who.startswith("minimd")


class Case(NamedTuple):
    """All runs of one scene."""

    name: str
    text: str
    unit: str  # of time
    points: Sequence[Point]
    duration: str = f"{DURATION:g} τ"

    def front(self, error: str) -> list[Point]:
        """Runs for which no other run is better both in time and in the error, the fastest first."""
        front = []
        least = np.inf
        for point in sorted(self.points, key=lambda p: p.seconds):
            value = getattr(point, error)
            if value < least:  # False for NaN
                front.append(point)
                least = value
        return front

    def advice(self, error: str) -> list[str]:
        """For each power of ten, the fastest run whose error is at most that."""
        lines = []
        for target in TARGETS:
            able = [point for point in self.points if getattr(point, error) <= target]
            if able:
                p = min(able, key=lambda p: p.seconds)
                step = f"Δt = {p.timestep:.3g} {self.unit}"
                advice = f"use {p.method}, {step}, {p.who}: {p.seconds:.3g} s"
                lines.append(f"for {error} {target:.0e} {advice}")
        return lines

    def beside(self) -> list[str]:
        """The time of each peer divided by that of the fastest run of minimd with the same oscillation or a smaller
        one."""
        ours = [p for p in self.points if p.is_minimd]
        ratios = dict[str, list[float]]()
        for peer in self.points:
            able = [p.seconds for p in ours if p.oscillation <= peer.oscillation]
            if able and np.isfinite(peer.oscillation) and not peer.is_minimd:
                ratios.setdefault(peer.who, []).append(peer.seconds / min(able))
        lines = []
        for who, times in ratios.items():
            span = f"({min(times):.2f} to {max(times):.2f})"
            middle = f"{np.median(times):.2f} times the time of minimd"
            lines.append(f"{who}: {middle} at equal oscillation {span}")
        return lines

    def draw(self, panel: Any) -> None:
        """Draw six curves at most: velocity Verlet, peers, and the other methods with most points on the front."""
        curves: dict[tuple[str, str], list[Point]] = {}
        for point in self.points:
            if 0.0 < point.oscillation < np.inf:
                curves.setdefault((point.who, point.method), []).append(point)
        on_front = [(p.who, p.method) for p in self.front("oscillation")]

        def rank(curve: tuple[str, str]) -> tuple[int, float]:
            return -on_front.count(curve), min(p.oscillation for p in curves[curve])

        first = [curve for curve in curves if curve[1] == md.VelocityVerlet.name]
        others = sorted((curve for curve in curves if curve not in first), key=rank)
        shown = {}

        for who, method in (first + others)[:MOST_CURVES]:
            points = curves[who, method]
            is_own = points[0].is_minimd
            errors = np.array([[p.oscillation] for p in points])
            shown[method if is_own else who] = [p.seconds for p in points], errors, is_own

        panel.set(xscale="log", yscale="log", xlabel="seconds", ylabel="oscillation of the energy")
        panel.set_title(f"{self.name}: time of a run of {self.duration}")
        draw(panel, shown)
        panel.xaxis.set_minor_formatter("")  # minor labels would overlap
        panel.grid(alpha=0.3)
        name_curves(panel)


@dataclass
class WorkPrecision:
    """The cases that ran."""

    cases: Sequence[Case]
    packages: Sequence[str]
    name = "work-precision"

    def lines(self) -> list[str]:
        """See Outcome."""
        lines: list[str] = []
        titles: dict[str, type] = {"engine": str, "method": str}
        titles |= dict.fromkeys(("Δt", "forces per time", "seconds", *ERRORS), float)
        for case in self.cases:
            lines += [f"## {case.name}", "", f"{case.text}.", ""]
            for items in (*map(case.advice, ERRORS), case.beside()):
                lines += [*(f"- {item}" for item in items), ""]
            cells = []
            for p in case.points:
                numbers = f"{p.timestep:.3g}", f"{p.forces:.0f}", f"{p.seconds:.3g}"
                cells.append([p.who, p.method, *numbers, *map(_number, p[-3:])])
            lines += [*table(titles, cells), ""]
        return lines

    def content(self) -> dict[str, Any]:
        """See Outcome.  JSON has no numbers that are not finite: they are None."""
        cases = []
        for case in self.cases:
            points = [_finite(point) for point in case.points]
            cases.append({"name": case.name, "text": case.text, "points": points})
        return {"cases": cases}

    def figure(self) -> "Figure":
        """For each case, the oscillation of the energy against seconds."""
        figure = new_figure(4.0 * len(self.cases))
        panels = figure.subplots(len(self.cases), squeeze=False)[:, 0]
        for panel, case in zip(panels, self.cases, strict=True):
            case.draw(panel)
        return figure


def _number(value: float) -> str:
    if np.isinf(value):
        return "failed"
    return "" if np.isnan(value) else f"{value:.2e}"


def _finite(point: Point) -> dict[str, Any]:
    """The fields of a point, with None for numbers that JSON does not have."""
    fields = point._asdict()
    for name, value in fields.items():
        if isinstance(value, float) and not np.isfinite(value):
            fields[name] = None
    return fields


def run_work_precision(names: Sequence[str], quick: bool, repeats: int) -> WorkPrecision:
    """Measure some cases, or all; each run is repeated, and the shortest time counts.
    Raises ValueError for an unknown name."""
    for name in names:
        if name not in CASES:
            raise ValueError(f"a scene must be one of {', '.join(CASES)}; it is {name!r}")
    chosen = names or (QUICK_CASES if quick else CASES)
    cases = [CASES[name](name, quick, repeats) for name in chosen]
    packages = [name for name in ("lammps", "openmm") if engines.PEERS[name].is_installed]
    return WorkPrecision(cases, packages)


def _dynamics(name: str, quick: bool, repeats: int) -> Case:
    """All methods and time steps on one scene, and the peers with velocity Verlet; argon is the melt, with the
    truncation of the peers or with a smooth potential."""
    scene = SCENES[name if name in SCENES else MELT](CELLS_QUICK if quick else CELLS)
    scene = equilibrated(scene)
    text = scene.text
    if name in ARGONS:
        truncation, cut = ARGONS[name]
        scene = scene._replace(potentials=(lennard_jones(truncation=truncation),))
        text += f"; {cut}"

    runs: list[tuple[type[Splitting], engines.Peer | None]] = []
    runs += [(SPLITTINGS[method], None) for method in (QUICK_METHODS if quick else SPLITTINGS)]
    if name != "argon-smooth":  # no peer has this potential
        peers = [engines.PEERS[peer] for peer in PEER_NAMES]
        runs += [(md.VelocityVerlet, peer) for peer in peers if peer.is_installed]
    reference = _path(scene, SPLITTINGS[REFERENCE], REFERENCE_COST)
    points = []

    for method, peer in runs:
        for cost in COSTS_QUICK if quick else COSTS:
            steps = OBSERVATIONS * max(1, round(cost * DURATION / method.stages / OBSERVATIONS))
            timestep = DURATION / steps
            tell(f"{name}: {peer.package if peer else method.name}, Δt = {timestep:.3g}")
            own = scene._replace(method=method(timestep))
            if peer is None:
                make: Any = partial(engines.Minimd, own, 1, steps // OBSERVATIONS)
                deviations = _path(scene, method, cost) - reference
                distance = np.sqrt(np.mean(deviations**2))
            else:
                make = partial(peer.load, own, 1)
                distance = np.nan

            points.append(measured(own, steps, make, repeats, distance))

    text += f"; {len(scene.system)} atoms, one thread, {DURATION:g} τ"
    return Case(name, text, "τ", points)


def _path(scene: BenchScene, method: type[Splitting], cost: float) -> Array:
    """Positions (N, 3) after a short time; NaN if the run fails."""
    steps = max(1, round(cost * SHORT / method.stages))
    engine = engines.Minimd(scene._replace(method=method(SHORT / steps)))
    try:
        engine.run(steps)
    except ArithmeticError:
        return np.full_like(engine.positions, np.nan)
    return engine.positions


def measured(
    scene: BenchScene,
    steps: int,
    make: Callable[[], engines.LoadedEngine],
    repeats: int,
    distance: float,
) -> Point:
    """Measure one run of a new engine; if it fails, its errors are infinite.  The observations count in the time of
    minimd, which makes them in its run, and not in that of a peer."""
    method = scene.method
    point = Point(
        "",
        method.name,
        method.order,
        DURATION / steps,
        steps * method.stages / DURATION,
    )
    seconds = np.inf

    for _ in range(repeats):
        engine = make()
        point = point._replace(who=engine.name)
        try:
            engine.run(steps // OBSERVATIONS)  # compiles, and warms up
            if isinstance(engine, engines.Minimd):
                record, taken = timed(engine.run, steps)
                energies = record.total_energy
            else:
                energies = np.array([engine.total_energy()])
                taken = 0.0
                for _ in range(OBSERVATIONS):
                    taken += timed(engine.run, steps // OBSERVATIONS)[1]
                    energies = np.append(energies, engine.total_energy())
        except (ArithmeticError, RuntimeError):
            return point

        seconds = min(seconds, taken)

    n_held = sum(len(rigid.pairs) for rigid in scene.constraints)
    n_dof = 3 * len(scene.system) - 3 - n_held
    scale = scene.temperature * np.sqrt(n_dof)
    time = np.linspace(0.0, 1.0, OBSERVATIONS + 1)
    errors = about_line(time, energies / scale)
    return point._replace(seconds=seconds, **errors, distance=distance)


def about_line(time: Array, energies: Array) -> dict[str, Any]:
    """Oscillation, the standard deviation about the line of regression, and drift, its |slope|;
    infinite if the run failed.  Both (T,)."""
    if not np.isfinite(energies).all():
        return {"oscillation": np.inf, "drift": np.inf}
    slope, start = np.polyfit(time, energies, 1)
    rest = energies - start - slope * time
    return {"oscillation": float(rest.std()), "drift": float(abs(slope))}


def attraction(q):
    """−q/|q|³."""
    return -q / (q[0] * q[0] + q[1] * q[1]) ** 1.5


def _kepler(_name: str, quick: bool, repeats: int) -> Case:
    """Kepler's ellipse, by every explicit splitting and every symmetric implicit method."""
    from numba import njit

    problem = md.integrators.SecondOrder(njit(attraction))
    points = []
    implicit = [method for method in IMPLICIT.values() if method.is_symmetric]

    explicit = [method for method in SPLITTINGS.values() if method is not md.RESPA]
    for method in (*explicit, *implicit):
        for cost in COSTS_QUICK if quick else COSTS:
            # a tenth of the forces: orbits are slow
            n = PERIODS * max(1, round(cost / method.stages * END / PERIODS / 10))
            every = max(1, n // (20 * PERIODS))
            timestep = END / n
            point = Point("minimd", method.name, method.order, timestep, cost)
            integrator = method(timestep)
            run = partial(
                md.integrators.run_steps,
                problem,
                integrator,
                (Q0, V0),
                every=every,
            )
            try:
                runs = [timed(run, n) for _ in range(repeats)]
            except (ConvergenceError, ArithmeticError):
                points.append(point)
                continue

            path = runs[-1][0]
            seconds = min(taken for _, taken in runs)
            kinetic = 0.5 * (path.v**2).sum(axis=1)
            potential = -1.0 / np.linalg.norm(path.q, axis=1)
            errors = about_line(path.t / END, kinetic + potential)
            errors["distance"] = float(np.linalg.norm(path.q[-1] - Q0))
            points.append(point._replace(forces=path.nfev / END, seconds=seconds, **errors))

    periods = f"{PERIODS} periods"
    units = "units a (half axis) and v (velocity in a circle)"
    text = f"Kepler's ellipse, eccentricity {ECCENTRICITY}, {periods}; {units}"
    return Case("kepler", text, "a/v", points, periods)


# how argon is cut
ARGONS: dict[str, tuple[Any, str]] = {
    "argon": ("shifted", "cut at 2.5 σ and shifted, as in the peers"),
    "argon-smooth": ("smooth", "cut at 2.5 σ by a switch with seven derivatives"),
}
QUICK_CASES = ("argon", "chains", "kepler")
CASES = dict.fromkeys((*ARGONS, "chains", "dumbbells"), _dynamics) | {"kepler": _kepler}
