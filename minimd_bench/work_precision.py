"""`minimd bench work-precision`: run time against error, for every method, time step and precision,
and for peers that can run the scene.

Errors of a run, all relative:

    oscillation   standard deviation of the total energy about its line of regression / (k_B T √n_dof)
    drift         |slope of that line| · duration / (k_B T √n_dof)
    distance      of the positions from a converged path after a short time, root mean square / σ
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from time import perf_counter
from typing import TYPE_CHECKING, Any, ClassVar, NamedTuple

import numpy as np
from numpy.typing import NDArray

import minimd as md
from minimd.integrators.methods import IMPLICIT, SPLITTINGS
from minimd.integrators.splitting.splitting import Splitting
from minimd.potentials.truncation import TruncationName
from minimd.structure.errors import ConvergenceError
from minimd_bench import engines
from minimd_bench.outcome import MOST_CURVES, End, name_curves, new_figure, table, tell
from minimd_bench.scenes import CUTOFF, SCENES, BenchScene, equilibrated

if TYPE_CHECKING:
    from matplotlib.figure import Figure

DURATION, OBSERVATIONS = 4.0, 20  # τ of a run, and number of times at which its energy is read
SHORT = 0.2  # τ, time at which the distance is measured: before chaos has amplified rounding
COSTS, COSTS_QUICK = (100, 141, 200, 283, 400, 566, 800, 1600, 3200), (100, 200, 400, 800)  # forces per τ
REFERENCE, REFERENCE_COST = "kahan-li-8", 34_000
QUICK_METHODS = ("velocity-verlet", "symplectic-euler-1", "candy-rozmus-4", "pefrl", "blanes-moan-rkn-4", "kahan-li-8")
PEER_NAMES = ("lammps", "lammps-checked", "openmm")
CELLS, CELLS_QUICK = 10, 6  # 4000 atoms; 864
TARGETS = 10.0 ** np.arange(-1, -9, -1)
ERRORS = ("oscillation", "drift", "distance")
ECCENTRICITY, PERIODS = 0.6, 20
KEPLER = (
    f"Kepler's ellipse, eccentricity {ECCENTRICITY}, {PERIODS} periods; units a (half axis) and v (velocity in a "
    "circle)"
)
Q0 = np.array([1.0 - ECCENTRICITY, 0.0])
V0 = np.array([0.0, np.sqrt((1.0 + ECCENTRICITY) / (1.0 - ECCENTRICITY))])
END = 2.0 * np.pi * PERIODS

MakeEngine = Callable[[], engines.TimedEngine]


class Point(NamedTuple):
    """One run.  who : engine and precision.  order : of its method.  forces : evaluations per unit of time.
    Errors that are unknown are NaN."""

    who: str
    method: str
    order: int
    timestep: float
    forces: float
    seconds: float
    oscillation: float
    drift: float
    distance: float


class Case(NamedTuple):
    """All runs of one scene."""

    name: str
    text: str
    unit: str  # of time
    points: Sequence[Point]
    duration: str = f"{DURATION:g} τ"

    def front(self, error: str) -> list[Point]:
        """Runs for which no other run is better both in time and in the error, the fastest first."""
        best, answer = np.inf, []
        for point in sorted(self.points, key=lambda p: p.seconds):
            if (value := getattr(point, error)) < best:
                best = value
                answer.append(point)
        return answer

    def advice(self, error: str) -> list[str]:
        """For each power of ten, the fastest run whose error is at most that."""
        lines = []
        for target in TARGETS:
            if able := [point for point in self.points if getattr(point, error) <= target]:
                p = min(able, key=lambda p: p.seconds)
                lines.append(
                    f"for {error} {target:.0e} use {p.method}, Δt = {p.timestep:.3g} {self.unit}, {p.who}: "
                    f"{p.seconds:.3g} s"
                )
        return lines

    def beside(self, error: str = "oscillation") -> list[str]:
        """The time of each peer divided by that of the fastest run of minimd with the same error or a smaller one."""
        lines = []
        ours = [p for p in self.points if p.who.startswith("minimd")]
        for who in dict.fromkeys(p.who for p in self.points if not p.who.startswith("minimd")):
            ratios = []
            for peer in (p for p in self.points if p.who == who and np.isfinite(getattr(p, error))):
                if able := [p.seconds for p in ours if getattr(p, error) <= getattr(peer, error)]:
                    ratios.append(peer.seconds / min(able))
            if ratios:
                lines.append(
                    f"{who}: {np.median(ratios):.2f} times the time of minimd at equal {error} ({min(ratios):.2f} to "
                    f"{max(ratios):.2f})"
                )
        return lines


@dataclass(frozen=True)
class WorkPrecision:
    """The cases that ran."""

    cases: Sequence[Case]
    packages: Sequence[str]
    name: ClassVar[str] = "work-precision"

    def lines(self) -> list[str]:
        """See Outcome."""
        lines: list[str] = []
        for case in self.cases:
            lines += [f"## {case.name}", "", f"{case.text}.", ""]
            for error in ERRORS:
                lines += [f"- {line}" for line in case.advice(error)] + [""]
            lines += [f"- {line}" for line in case.beside()] + [""]
            titles = {
                "engine": str,
                "method": str,
                "Δt": float,
                "forces per time": float,
                "seconds": float,
            } | dict.fromkeys(ERRORS, float)
            cells = []
            for p in case.points:
                errors = (_number(getattr(p, error)) for error in ERRORS)
                cells.append([p.who, p.method, f"{p.timestep:.3g}", f"{p.forces:.0f}", f"{p.seconds:.3g}", *errors])
            lines += [*table(titles, cells), ""]
        return lines

    def content(self) -> dict[str, Any]:
        """See Outcome."""
        return {
            "cases": [
                {"name": c.name, "text": c.text, "points": [_finite(p._asdict()) for p in c.points]} for c in self.cases
            ]
        }

    def figure(self) -> "Figure":
        """For each case, the oscillation of the energy against seconds: velocity Verlet, peers,
        and the best other methods, six curves at most."""
        figure = new_figure(4.0 * len(self.cases))
        for panel, case in zip(figure.subplots(len(self.cases), squeeze=False)[:, 0], self.cases, strict=True):
            _draw(panel, case)
        return figure


def run_work_precision(names: Sequence[str], quick: bool, repeats: int) -> WorkPrecision:
    """Measure some cases, or all; each run is repeated, and the shortest time counts.
    Raises ValueError for an unknown name."""
    unknown = [name for name in names if name not in CASES]
    if unknown:
        raise ValueError(f"a scene must be one of {', '.join(CASES)}; it is {unknown[0]!r}")
    chosen = names or (("argon", "chains", "kepler") if quick else CASES)
    return WorkPrecision(
        [CASES[name](name, quick, repeats) for name in chosen],
        [p for p in ("lammps", "openmm") if engines.PEERS[p].is_installed],
    )


def _scene_case(name: str, quick: bool, repeats: int) -> Case:
    """The case of a scene; argon is the melt, with the truncation of the peers or with a smooth potential."""
    scene, words = equilibrated(SCENES[name if name in SCENES else "melt"](CELLS_QUICK if quick else CELLS)), ""
    if name == "argon":
        scene, words = (
            _with_law(scene, "shifted"),
            "cut at 2.5 σ and shifted, as in the peers",
        )
    elif name == "argon-smooth":
        scene, words = _with_law(scene, "smooth"), "cut at 2.5 σ by a switch with seven derivatives"
    return _dynamics(name, scene, words, quick, repeats)


def _with_law(scene: BenchScene, truncation: TruncationName) -> BenchScene:
    return scene._replace(potentials=(md.LennardJones(1.0, 1.0, CUTOFF, truncation),))


def _kepler(_name: str, quick: bool, repeats: int) -> Case:
    points = [Point("minimd", *run) for run in kepler_runs(COSTS_QUICK if quick else COSTS, repeats)]
    return Case("kepler", KEPLER, "a/v", points, f"{PERIODS} periods")


CASES = dict.fromkeys(("argon", "argon-smooth", "chains", "dumbbells"), _scene_case) | {"kepler": _kepler}


def _dynamics(name: str, scene: BenchScene, words: str, quick: bool, repeats: int) -> Case:
    """Measure all methods and time steps on one scene, and the peers with velocity Verlet."""
    costs, methods = (COSTS_QUICK, QUICK_METHODS) if quick else (COSTS, tuple(SPLITTINGS))
    start, reference = scene.system.positions, _path(scene, SPLITTINGS[REFERENCE], REFERENCE_COST)
    points = []
    for method in (SPLITTINGS[name] for name in methods):
        for cost in costs:
            steps = _steps(method, cost)
            tell(f"{name}: {method.name}, Δt = {DURATION / steps:.3g}")
            make: MakeEngine = lambda: engines.Minimd(scene, 1, method(DURATION / steps))  # noqa: E731
            path = _path(scene, method, cost)
            is_lost = path is None or reference is None
            distance = np.nan if is_lost else float(np.sqrt(np.mean((path - reference) ** 2)))  # type: ignore[operator]
            points.append(_point("minimd", scene, method, steps, make, repeats, distance))
    peers = () if name == "argon-smooth" else PEER_NAMES  # no peer has this potential
    for peer in (engines.PEERS[name] for name in peers if engines.PEERS[name].is_installed):
        for cost in costs:
            steps = _steps(md.VelocityVerlet, cost)
            tell(f"{name}: {peer.package}, Δt = {DURATION / steps:.3g}")
            make = lambda: peer.load(scene, 1, DURATION / steps)  # noqa: E731
            points.append(_point(make().name, scene, md.VelocityVerlet, steps, make, repeats, np.nan))
    text = f"{scene.text}{'; ' if words else ''}{words}; {len(start)} atoms, one thread, {DURATION:g} τ"
    return Case(name, text, "τ", points)


def _steps(method: type[Splitting], cost: float) -> int:
    """The number of steps with about `cost` force evaluations per τ, divisible by the number of observations."""
    return OBSERVATIONS * max(1, round(cost * DURATION / method.stages / OBSERVATIONS))


def _path(scene: BenchScene, method: type[Splitting], cost: float) -> NDArray[np.float64] | None:
    """Positions after a short time; None if the run fails."""
    steps = max(1, round(cost * SHORT / method.stages))
    engine = engines.Minimd(scene, 1, method(SHORT / steps))
    try:
        engine.run(steps)
    except ArithmeticError:
        return None
    return engine.positions


def _point(
    who: str, scene: BenchScene, method: type[Splitting], steps: int, make: MakeEngine, repeats: int, distance: float
) -> Point:
    """Measure one run; if it fails, its errors are infinite."""
    seconds, energies = np.inf, np.full(OBSERVATIONS + 1, np.nan)
    for _ in range(repeats):
        engine = make()
        try:
            energies, taken = _course(engine, steps)
        except (ArithmeticError, RuntimeError):
            break
        seconds = min(seconds, taken)
    n_dof = 3 * len(scene.system) - 3 - sum(len(rigid.pairs) for rigid in scene.constraints)
    oscillation, drift = about_line(
        np.linspace(0.0, 1.0, OBSERVATIONS + 1), energies / (scene.temperature * np.sqrt(n_dof))
    )
    if not np.isfinite(seconds):
        distance = np.inf
    return Point(
        who,
        method.name,
        method.order,
        DURATION / steps,
        steps * method.stages / DURATION,
        seconds,
        oscillation,
        drift,
        distance,
    )


def _course(engine: engines.TimedEngine, steps: int) -> tuple[NDArray[np.float64], float]:
    """Energies at all observations, and the seconds of the run; for a peer, without the observations."""
    engine.run(steps // OBSERVATIONS)  # compiles, and warms up
    if isinstance(engine, engines.Minimd):
        return engine.course(steps, OBSERVATIONS)
    energies, seconds = [engine.total_energy()], 0.0
    for _ in range(OBSERVATIONS):
        started = perf_counter()
        engine.run(steps // OBSERVATIONS)
        seconds += perf_counter() - started
        energies.append(engine.total_energy())
    return np.array(energies), seconds


def _draw(panel: Any, case: Case, error: str = "oscillation") -> None:
    curves: dict[tuple[str, str], list[Point]] = {}
    for point in case.points:
        if 0.0 < getattr(point, error) < np.inf:
            curves.setdefault((point.who, point.method), []).append(point)
    ends = {}
    for k, (who, method) in enumerate(_shown(curves, case.front(error))):
        points, ours = curves[who, method], who.startswith("minimd")
        seconds, errors = [p.seconds for p in points], [getattr(p, error) for p in points]
        panel.loglog(
            seconds, errors, marker="os^vD<"[k], ms=4, lw=2.5 if ours else 1.5, ls="-" if ours else "--", color=f"C{k}"
        )
        ends[method if ours else who] = End(seconds[-1], errors[-1], f"C{k}")
    panel.set(xlabel="seconds", ylabel=f"{error} of the energy", title=f"{case.name}: time of a run of {case.duration}")
    panel.xaxis.set_minor_formatter("")  # minor labels would overlap
    panel.grid(alpha=0.3)
    name_curves(panel, ends)


def _shown(curves: dict[tuple[str, str], list[Point]], front: Sequence[Point]) -> list[tuple[str, str]]:
    """The curves to draw, six at most: velocity Verlet, peers, and the other methods with most points on the front."""
    first = [one for one in curves if one[1] == md.VelocityVerlet.name]
    others = [one for one in curves if one not in first]
    on_front = {one: sum((p.who, p.method) == one for p in front) for one in others}
    best = sorted(others, key=lambda one: (-on_front[one], min(p.oscillation for p in curves[one])))
    return first[:MOST_CURVES] + best[: max(0, MOST_CURVES - len(first))]


def _number(value: float) -> str:
    return f"{value:.2e}" if np.isfinite(value) else ("failed" if np.isinf(value) else "")


def _finite(mapping: dict[str, Any]) -> dict[str, Any]:
    """The same mapping, with None for numbers that JSON does not have."""
    return {
        key: None if isinstance(value, float) and not np.isfinite(value) else value for key, value in mapping.items()
    }


def attraction(q):
    """−q/|q|³."""
    return -q / (q[0] * q[0] + q[1] * q[1]) ** 1.5


def about_line(time: NDArray[np.float64], energies: NDArray[np.float64]) -> tuple[float, float]:
    """Oscillation, the standard deviation about the line of regression, and drift, its |slope|;
    infinite if the run failed.  Both (T,)."""
    if not np.isfinite(energies).all():
        return np.inf, np.inf
    slope, start = np.polyfit(time, energies, 1)
    return float((energies - start - slope * time).std()), float(abs(slope))


def kepler_runs(
    costs: Sequence[int], repeats: int
) -> Iterator[tuple[str, int, float, float, float, float, float, float]]:
    """Kepler\'s ellipse, by every explicit splitting and every symmetric implicit method.

    For each run: method, order, Δt, forces per unit of time, seconds, oscillation, drift, distance.
    costs : ten times the forces per time.
    """
    from numba import njit

    problem = md.integrators.SecondOrder(njit(attraction))
    for method in (*SPLITTINGS.values(), *(method for method in IMPLICIT.values() if method.is_symmetric)):
        for cost in costs:
            # a tenth of the forces: orbits are slow
            n = PERIODS * max(1, round(cost / method.stages * END / PERIODS / 10))
            seconds = np.inf
            try:
                for _ in range(repeats):
                    started = perf_counter()
                    path = md.integrators.run_steps(
                        problem, method(END / n), (Q0, V0), n, every=max(1, n // (20 * PERIODS))
                    )
                    seconds = min(seconds, perf_counter() - started)
            except (ConvergenceError, ArithmeticError):
                yield method.name, method.order, END / n, cost, np.inf, np.inf, np.inf, np.inf
                continue
            energy = 0.5 * (path.v**2).sum(axis=1) - 1.0 / np.linalg.norm(path.q, axis=1)
            distance = float(np.linalg.norm(path.q[-1] - Q0))
            yield (
                method.name,
                method.order,
                END / n,
                path.nfev / END,
                seconds,
                *about_line(path.t / END, energy),
                distance,
            )
