"""`minimd bench peers`: the same scene in minimd and in other installed engines, or many scenes beside LAMMPS."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, ClassVar, NamedTuple

import numpy as np
from numpy.typing import NDArray

from minimd.compiled.machine import available_cores
from minimd_bench.engines import PEERS, Minimd, TimedEngine
from minimd_bench.memory import FROM_ATOMS, bytes_per_atom
from minimd_bench.outcome import (
    MOST_CURVES,
    End,
    bars,
    name_curves,
    new_figure,
    spread,
    summary,
    table,
    tell,
    threads_text,
)
from minimd_bench.scenes import MELT, SCENES, BenchScene, equilibrated
from minimd_bench.turns import check_agreement, take_turns, warm_up

if TYPE_CHECKING:
    from matplotlib.figure import Figure

MINIMD = "minimd"
NO_PEERS = ("none",)
BESIDE_SCENES = ("lammps-checked", "lammps-tuned", "lammps-shake")  # whose lists miss no pair


class EngineSpeed(NamedTuple):
    """The speed of one engine with one scene.

    speeds : (R,) atom-steps per second in each turn.  bytes_per_atom : None if not measured.
    """

    engine: str
    threads: int
    precision: str
    scene: str
    n_atoms: int
    speeds: NDArray[np.float64]
    bytes_per_atom: float | None = None

    @property
    def is_minimd(self) -> bool:
        """False for a peer."""
        return self.engine == MINIMD


def faster_than_peer(rows: Sequence[EngineSpeed], peer: EngineSpeed) -> NDArray[np.float64] | None:
    """Speed of minimd, double, on as many threads, divided by the speed of the peer, in each turn;
    None if that did not run."""
    ours = None if peer.is_minimd else _double(rows, peer.threads, peer.scene)
    return None if ours is None else ours.speeds / peer.speeds


def beside_one_thread(rows: Sequence[EngineSpeed], row: EngineSpeed) -> NDArray[np.float64] | None:
    """Speed of a row of minimd divided by that of minimd, double, on one thread, for the same scene; None for peers."""
    reference = _double(rows, 1, row.scene) if row.is_minimd else None
    return None if reference is None else row.speeds / reference.speeds


def _double(rows: Sequence[EngineSpeed], threads: int, scene: str) -> EngineSpeed | None:
    """The row of minimd on this number of threads."""
    return next((row for row in rows if row.is_minimd and (row.threads, row.scene) == (threads, scene)), None)


class PeersOptions(NamedTuple):
    """Options of run_peers.

    threads : if empty, one thread and all cores.  peers : names in PEERS; if empty, all that are installed;
        "none" for no peer.
    """

    scenes: tuple[str, ...] = (MELT,)
    cells: tuple[int, ...] = (5, 10, 20)
    threads: tuple[int, ...] = ()
    peers: tuple[str, ...] = ()
    repeats: int = 7

    def all_threads(self) -> tuple[int, ...]:
        """Numbers of threads, without repetition."""
        return tuple(dict.fromkeys(self.threads or (1, available_cores())))


def run_peers(options: PeersOptions) -> "Peers":
    """Measure one scene and one size after the other; progress is printed to standard error.

    Raises ValueError for options that do not fit, or if a peer does not start.  HandOverError as check_agreement.
    """
    check_options(options)
    peers, texts = _peers(options), {name: SCENES[name](min(options.cells)).text for name in options.scenes}
    sizes = [_beside_peers(name, n, options, peers) for name in options.scenes for n in options.cells]
    return Peers(texts, options.repeats, tuple(dict.fromkeys(PEERS[name].package for name in peers)), sizes)


@dataclass(frozen=True)
class Peers:
    """The rows of each scene and size.  texts : descriptions of the scenes, by name.  packages : of the peers that took
    part."""

    texts: Mapping[str, str]
    repeats: int
    packages: Sequence[str]
    sizes: Sequence[Sequence[EngineSpeed]]
    name: ClassVar[str] = "peers"

    def lines(self) -> list[str]:
        """See Outcome."""
        speeds = (
            "Speeds in 10⁶ atom-steps per second of whole runs, with lists and without compilation: median of "
            f"{self.repeats} rounds (least to most)."
        )
        head = [
            speeds,
            "In each round all engines run once, in one process; ratios are computed within a round.",
            *(["", *self._summary()] if len(self.texts) > 1 else []),
        ]
        return head + [line for rows in self.sizes for line in ["", *_table(rows, self.texts[rows[0].scene])]]

    def fastest(self) -> list[tuple[EngineSpeed, EngineSpeed]]:
        """For each scene and size, on one thread: the row of minimd, double, and that of the fastest peer,
        or minimd's again without peers."""
        peers = [[row for row in rows if not row.is_minimd and row.threads == 1] or [rows[0]] for rows in self.sizes]
        best = [max(rows, key=lambda row: float(np.median(row.speeds))) for rows in peers]
        return list(zip([rows[0] for rows in self.sizes], best, strict=True))

    def _summary(self) -> list[str]:
        titles = {"scene": str, "atoms": float, "minimd": float, "fastest peer, one thread": str, "its speed": float}
        cells = []
        for own, peer in self.fastest():
            speeds = [spread(own.speeds / 1e6), peer.engine, spread(peer.speeds / 1e6)]
            cells.append([own.scene, str(own.n_atoms), *speeds, spread(own.speeds / peer.speeds)])
        return table(titles | {"minimd is faster by": float}, cells)

    def content(self) -> dict[str, Any]:
        """See Outcome."""
        sizes = [
            {"scene": rows[0].scene, "n_atoms": rows[0].n_atoms, "rows": [_as_mapping(rows, row) for row in rows]}
            for rows in self.sizes
        ]
        return {"texts": dict(self.texts), "repeats": self.repeats, "sizes": sizes}

    def figure(self) -> "Figure":
        """Speed against the number of atoms, with a panel for each number of threads;
        at most the six fastest engines are drawn. For several scenes, how much faster minimd is than the fastest peer.
        """
        if len(self.texts) > 1:
            ratios = {f"{own.scene}, {own.n_atoms}": own.speeds / peer.speeds for own, peer in self.fastest()}
            return bars(ratios, "speed of minimd, double, one thread, divided by that of the fastest peer")
        all_threads = sorted({row.threads for rows in self.sizes for row in rows})
        figure = new_figure(3.8 * len(all_threads))
        panels = figure.subplots(len(all_threads), sharex=True, sharey=True, squeeze=False)[:, 0]
        ends = []
        for panel, threads in zip(panels, all_threads, strict=True):
            ends.append(_draw(panel, [row for rows in self.sizes for row in rows if row.threads == threads]))
            panel.set_title(f"{self.sizes[0][0].scene}, {threads_text(threads)}")
        for panel, named in zip(panels, ends, strict=True):
            name_curves(panel, named)
        panels[-1].set_xlabel("atoms")
        return figure


def _draw(panel: Any, rows: Sequence[EngineSpeed]) -> dict[str, End]:
    """Draw median speeds of engines and their ranges; returns the ends of the curves."""
    curves, ends = dict[str, list[EngineSpeed]](), {}
    for row in rows:
        curves.setdefault(row.engine, []).append(row)
    fastest = sorted(curves.items(), key=lambda curve: -np.median(curve[1][-1].speeds))[:MOST_CURVES]
    for k, (name, points) in enumerate(fastest):
        n, speeds = [point.n_atoms for point in points], np.array([point.speeds for point in points]) / 1e6
        middle, (line, width) = np.median(speeds, axis=1), ("-", 2.5) if points[0].is_minimd else ("--", 1.5)
        panel.plot(n, middle, marker="os^vD<"[k], ls=line, lw=width, color=f"C{k}")
        panel.fill_between(n, speeds.min(axis=1), speeds.max(axis=1), alpha=0.15, color=f"C{k}")
        ends[name] = End(n[-1], float(middle[-1]), f"C{k}")
    panel.set(xscale="log", yscale="log", ylabel="10⁶ atom-steps / s")
    panel.yaxis.set_major_formatter("{x:g}")
    panel.yaxis.set_minor_formatter("{x:g}")
    return ends


def check_options(options: PeersOptions) -> None:
    """Raise ValueError unless the options fit together, and fit this machine."""
    for name, value, allowed in (
        ("scene", options.scenes, SCENES),
        ("peers", options.peers, (*PEERS, *NO_PEERS) if len(options.peers) == 1 else PEERS),
    ):
        unknown = [word for word in value if word not in allowed]
        if unknown:
            raise ValueError(f"--{name} must be one of {', '.join(allowed)}; it is {unknown[0]!r}")
    if max(options.all_threads()) > available_cores():
        raise ValueError(
            f"--threads {max(options.threads)} is more than the {available_cores()} cores that this process may use"
        )
    smallest = min(options.cells)
    for name in options.scenes:
        scene = SCENES[name](smallest)
        if scene.edges.min() < 2.0 * scene.law.cutoff:
            raise ValueError(
                f"--cells {smallest} makes a cell narrower than twice the cutoff in the scene {name!r}; give a larger "
                "number"
            )
    for name in () if options.peers == NO_PEERS else options.peers:
        if not set(options.scenes) & set(PEERS[name].scenes):
            wrong = f"cannot run the scene {options.scenes[0]!r}; it runs {', '.join(PEERS[name].scenes)}"
            raise ValueError(f"--peers {name} {wrong}")
        if not PEERS[name].is_installed:
            raise ValueError(f"{PEERS[name].package} is not installed; {PEERS[name].installer} installs it")


def _peers(options: PeersOptions) -> tuple[str, ...]:
    """Names of the peers that take part; peers that are not installed are named on standard error."""
    able = [name for name, peer in PEERS.items() if set(options.scenes) & set(peer.scenes)]
    if not able or options.peers == NO_PEERS:
        return ()
    missing = {PEERS[name].package: PEERS[name].installer for name in able if not PEERS[name].is_installed}
    for installer in dict.fromkeys(() if options.peers else missing.values()):
        packages = [package for package, its in missing.items() if its == installer]
        tell(f"no comparison with {', '.join(packages)}: not installed; {installer} installs this")
    return tuple(name for name in options.peers or able if PEERS[name].package not in missing)


def _beside_peers(scene_name: str, n: int, options: PeersOptions, peers: Sequence[str]) -> list[EngineSpeed]:
    scene = SCENES[scene_name](n)
    if scene_name != MELT:  # the melt is equilibrated while the engines warm up
        scene = equilibrated(scene)
    engines: list[TimedEngine] = [Minimd(scene, n) for n in dict.fromkeys((1, *options.all_threads()))]
    n_atoms = len(scene.system)
    for name in (name for name in peers if scene_name in PEERS[name].scenes):
        if name in options.peers or n_atoms <= PEERS[name].most_atoms:
            counts = {"one": (1,), "each": options.all_threads(), "most": (max(options.all_threads()),)}[
                PEERS[name].threads
            ]
            engines.extend(_load(name, scene, threads) for threads in counts)
    check_agreement(engines, n_atoms, scene.scatter)
    tell(f"{scene_name}: the energies agree")
    speeds = n_atoms * take_turns(engines, warm_up(engines, n_atoms), options.repeats, n_atoms)
    rows = [EngineSpeed(e.name, e.threads, e.precision, scene.name, n_atoms, speeds[k]) for k, e in enumerate(engines)]
    for k, row in enumerate(rows):
        if row.is_minimd and 4 * n**3 >= FROM_ATOMS:  # large enough to measure its memory
            tell(f"{row.n_atoms} atoms: memory of minimd, {threads_text(row.threads)}")
            rows[k] = row._replace(bytes_per_atom=bytes_per_atom(row.scene, n, row.threads))
    return rows


def _load(name: str, scene: BenchScene, threads: int) -> TimedEngine:
    """A peer that has loaded the scene.  Raises ValueError for any failure of the peer."""
    try:
        return PEERS[name].load(scene, threads, scene.method.timestep)
    except Exception as error:
        reason = " ".join(str(error).split()) or type(error).__name__
        raise ValueError(
            f"{name} is installed but does not start: {reason}; to leave it out, name the others with --peers"
        ) from error


def _table(rows: Sequence[EngineSpeed], text: str) -> list[str]:
    titles: dict[str, type] = {"engine": str, "threads": float, "precision": str, "speed": float}
    titles |= {"minimd, same threads, is faster by": float, "ratio to minimd, 1 thread": float}
    cells = []
    for row in rows:
        name = f"**{row.engine}**" if row.is_minimd else row.engine
        ratios = [spread(faster_than_peer(rows, row)), spread(beside_one_thread(rows, row))]
        cells.append([name, str(row.threads), row.precision, spread(row.speeds / 1e6), *ratios])
    if any(row.bytes_per_atom is not None for row in rows):
        titles["bytes per atom"] = float
        cells = [
            [*line, "" if row.bytes_per_atom is None else f"{row.bytes_per_atom:.0f}"]
            for line, row in zip(cells, rows, strict=True)
        ]
    return [f"## {rows[0].scene}, {rows[0].n_atoms} atoms", "", f"{text}.", "", *table(titles, cells)]


def _as_mapping(rows: Sequence[EngineSpeed], row: EngineSpeed) -> dict[str, Any]:
    kind = {
        "engine": row.engine,
        "threads": row.threads,
        "precision": row.precision,
        "n_atoms": row.n_atoms,
        "bytes_per_atom": row.bytes_per_atom,
    }
    ratios = {
        "minimd_is_faster_by": faster_than_peer(rows, row),
        "beside_minimd_one_thread": beside_one_thread(rows, row),
    }
    return kind | {name: summary(values) for name, values in {"atom_steps_per_second": row.speeds, **ratios}.items()}
