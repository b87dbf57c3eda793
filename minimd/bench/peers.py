"""`minimd bench peers`: the same scene in minimd and in other installed engines, or many scenes beside LAMMPS."""

from bisect import bisect_left
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from itertools import compress
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from minimd.bench import outcome
from minimd.bench.engines import PEERS, Load, LoadedEngine, Minimd
from minimd.bench.outcome import spread, summary, table, threads_text
from minimd.bench.scaling import bytes_per_atom
from minimd.bench.scenes import EXACT, MELT, SCENES, WATER_CUTOFFS, BenchScene, equilibrated
from minimd.bench.turns import check_agreement, in_turns, thread_numbers, timed
from minimd.core.compiled.terminal import tell
from minimd.core.structure.arrays import Array

if TYPE_CHECKING:
    from matplotlib.figure import Figure

NO_PEERS = ("none",)
# whose lists miss no pair, but for GROMACS with its default buffer
BESIDE_SCENES = (
    "lammps-checked",
    "lammps-tuned",
    "lammps-shake",
    "gromacs",
    "gromacs-safe",
    "openmm-pme",
)
# accuracies that are tried, of the error that is allowed
LADDER = 2.0 ** np.arange(5.0, -4.5, -0.5)
# steps with which settings are compared, and how much slower than the fastest those may be that are measured
STEPS_TRIED = 100
TRIED = 1.3
# in smaller scenes the memory of atoms is not measured: that of Python and of the kernels hides it
FROM_ATOMS = 256_000

Asked = tuple[Sequence[Load], int]  # settings of which the fastest counts, and a number of threads
Placed = tuple[int, LoadedEngine]  # an engine with its place among those that are asked for


class EngineSpeed(NamedTuple):
    """The speed of one engine with one scene.
    speeds : (R,) atom-steps per second in each turn.
    bytes_per_atom : None if not measured."""

    engine: str
    threads: int
    precision: str
    scene: str
    n_atoms: int
    speeds: Array
    bytes_per_atom: float | None = None

    @property
    def is_minimd(self) -> bool:
        """False for a peer."""
        return self.engine.startswith("minimd")

    @property
    def shown(self) -> str:
        """The speed in 10⁶ atom-steps per second."""
        return spread(self.speeds / 1e6)


def ratios(rows: Sequence[EngineSpeed], row: EngineSpeed) -> tuple[outcome.Ratios, outcome.Ratios]:
    """For a peer, the speed of minimd on as many threads divided by its own; for minimd, its speed divided by that on
    one thread; each in each turn, None for the other kind of row, or if there is no such row of minimd."""
    threads = 1 if row.is_minimd else row.threads
    for own in rows:
        if own.is_minimd and own.threads == threads:
            faster = row.speeds / own.speeds
            return (None, faster) if row.is_minimd else (own.speeds / row.speeds, None)
    return None, None


class PeersOptions(NamedTuple):
    """Options of run_peers.
    threads : if empty, one thread and all cores.
    peers : names in PEERS; if empty, those of offered that are installed; "none" for no peer.
    offered : names in PEERS; if empty, all."""

    scenes: tuple[str, ...] = (MELT,)
    cells: tuple[int, ...] = (5, 10, 20)
    threads: tuple[int, ...] = ()
    peers: tuple[str, ...] = ()
    repeats: int = 7
    offered: tuple[str, ...] = ()


@dataclass
class Peers:
    """The rows of each scene and size.
    texts : descriptions of the scenes, by name.
    packages : of the peers that took part."""

    texts: Mapping[str, str]
    repeats: int
    packages: Sequence[str]
    sizes: Sequence[Sequence[EngineSpeed]]
    name = "peers"

    def lines(self) -> list[str]:
        """See Outcome."""
        lines = [
            "Speeds in 10⁶ atom-steps per second of whole runs, with lists and without compilation: median of "
            f"{self.repeats} rounds (least to most).",
            "In each round all engines run once, in one process; ratios are computed within a round.",
        ]
        if len(self.texts) > 1:
            titles = {
                "scene": str,
                "atoms": float,
                "minimd": float,
                "fastest peer, one thread": str,
                "its speed": float,
                "minimd is faster by": float,
            }
            cells = []

            for own, peer in self.fastest():
                ratio = spread(own.speeds / peer.speeds)
                row = [own.scene, own.n_atoms, own.shown, peer.engine, peer.shown, ratio]
                cells.append(row)

            lines += ["", *table(titles, cells)]

        for rows in self.sizes:
            scene = rows[0].scene
            title = f"## {scene}, {rows[0].n_atoms} atoms"
            lines += ["", title, "", f"{self.texts[scene]}.", "", *_table(rows)]

        return lines

    def fastest(self) -> list[tuple[EngineSpeed, EngineSpeed]]:
        """For each scene and size, on one thread: the row of minimd, double, and that of the fastest peer,
        or minimd's again without peers."""
        pairs = []
        for rows in self.sizes:
            peers = [row for row in rows if not row.is_minimd and row.threads == 1]
            best = max(peers, key=lambda row: float(np.median(row.speeds)), default=rows[0])
            pairs.append((rows[0], best))
        return pairs

    def content(self) -> dict[str, Any]:
        """See Outcome."""
        sizes = [
            {
                "scene": rows[0].scene,
                "n_atoms": rows[0].n_atoms,
                "rows": [_content(rows, row) for row in rows],
            }
            for rows in self.sizes
        ]
        return {"texts": dict(self.texts), "repeats": self.repeats, "sizes": sizes}

    def figure(self) -> "Figure":
        """Speed against the number of atoms, with a panel for each number of threads; at most the six fastest engines
        are drawn. For several scenes, how much faster minimd is than the fastest peer."""
        if len(self.texts) > 1:
            faster = {
                f"{own.scene}, {own.n_atoms}": own.speeds / peer.speeds
                for own, peer in self.fastest()
            }
            label = "speed of minimd, double, one thread, divided by that of the fastest peer"
            return outcome.bars(faster, label)

        rows = [row for rows in self.sizes for row in rows]
        all_threads = sorted({row.threads for row in rows})
        figure = outcome.new_figure(3.8 * len(all_threads))
        panels = figure.subplots(len(all_threads), sharex=True, sharey=True, squeeze=False)[:, 0]

        for panel, threads in zip(panels, all_threads, strict=True):
            curves = dict[str, list[EngineSpeed]]()
            for row in rows:
                if row.threads == threads:
                    curves.setdefault(row.engine, []).append(row)
            fastest = sorted(curves.items(), key=lambda curve: -np.median(curve[1][-1].speeds))
            drawn = {}
            for name, points in fastest[: outcome.MOST_CURVES]:
                speeds = np.array([point.speeds for point in points]) / 1e6
                drawn[name] = [point.n_atoms for point in points], speeds, points[0].is_minimd
            outcome.draw(panel, drawn)
            panel.set(
                xscale="log",
                yscale="log",
                ylabel="10⁶ atom-steps / s",
                title=f"{self.sizes[0][0].scene}, {threads_text(threads)}",
            )
            panel.yaxis.set_major_formatter("{x:g}")
            panel.yaxis.set_minor_formatter("{x:g}")

        for panel in panels:
            outcome.name_curves(panel)
        panels[-1].set_xlabel("atoms")
        return figure


def _table(rows: Sequence[EngineSpeed]) -> list[str]:
    titles: dict[str, type] = {
        "engine": str,
        "threads": float,
        "precision": str,
        "speed": float,
        "minimd, same threads, is faster by": float,
        "ratio to minimd, 1 thread": float,
    }
    has_memory = any(row.bytes_per_atom is not None for row in rows)
    if has_memory:
        titles["bytes per atom"] = float
    cells = []

    for row in rows:
        name = f"**{row.engine}**" if row.is_minimd else row.engine
        cells.append([name, row.threads, row.precision, row.shown, *map(spread, ratios(rows, row))])
        if has_memory:
            memory = row.bytes_per_atom
            cells[-1].append("" if memory is None else f"{memory:.0f}")

    return table(titles, cells)


def _content(rows: Sequence[EngineSpeed], row: EngineSpeed) -> dict[str, Any]:
    faster, beside = ratios(rows, row)
    fields = row._asdict()
    del fields["scene"]
    fields["atom_steps_per_second"] = summary(fields.pop("speeds"))
    fields["minimd_is_faster_by"] = summary(faster)
    fields["beside_minimd_one_thread"] = summary(beside)
    return fields


def run_peers(options: PeersOptions) -> Peers:
    """Measure one scene and one size after the other; progress and speeds are printed to standard error.
    Raises ValueError for options that do not fit, or if a peer does not start.  HandOverError as check_agreement."""
    texts = _checked_scenes(options)
    threads = thread_numbers(options.threads)
    peers = _checked_peers(options)
    packages = tuple(dict.fromkeys(PEERS[name].package for name in peers))
    sizes = []
    for scene in options.scenes:
        for n in options.cells:
            sizes.append(_beside(scene, n, options, threads, peers))
            tell("\n".join([f"{scene}:", *_table(sizes[-1])]))  # a later scene may fail
    return Peers(texts, options.repeats, packages, sizes)


def _checked_scenes(options: PeersOptions) -> dict[str, str]:
    """The texts of the scenes, by name.
    Raises ValueError for an unknown scene, or one with too small a cell."""
    _check_names("scene", options.scenes, SCENES)
    texts = {}
    smallest = min(options.cells)
    for name in options.scenes:
        scene = SCENES[name](smallest)
        if scene.edges.min() < 2.0 * scene.law.cutoff:
            raise ValueError(
                f"--cells {smallest} makes a cell narrower than twice the cutoff in the scene {name!r}; give a "
                "larger number"
            )
        texts[name] = scene.text
    return texts


def _checked_peers(options: PeersOptions) -> tuple[str, ...]:
    """The peers that take part.
    Raises ValueError for one that is unknown or missing, or can run no scene."""
    if options.peers == NO_PEERS:
        return ()
    allowed = (*PEERS, *NO_PEERS) if len(options.peers) == 1 else tuple(PEERS)
    _check_names("peers", options.peers, allowed)
    names = options.peers or options.offered or PEERS
    able = tuple(name for name in names if {*options.scenes} & {*PEERS[name].scenes})

    for name in options.peers:
        peer = PEERS[name]
        if name not in able:
            raise ValueError(
                f"--peers {name} cannot run the scene {options.scenes[0]!r}; it runs {', '.join(peer.scenes)}"
            )

        if not peer.is_installed:
            raise ValueError(f"{peer.package} is {peer.remedy}")

    if options.peers:
        return options.peers
    missing = {}

    for name in able:
        peer = PEERS[name]
        if not peer.is_installed:
            missing[peer.package] = peer.remedy

    for package, remedy in missing.items():
        tell(f"no comparison with {package}: {remedy}")
    return tuple(name for name in able if PEERS[name].package not in missing)


def _check_names(option: str, names: Sequence[str], allowed: Collection[str]) -> None:
    for name in names:
        if name not in allowed:
            raise ValueError(f"--{option} must be one of {', '.join(allowed)}; it is {name!r}")


def _beside(
    name: str, n: int, options: PeersOptions, threads: Sequence[int], peers: Sequence[str]
) -> list[EngineSpeed]:
    scene = SCENES[name](n)
    if name != MELT:  # the melt is equilibrated while the engines warm up
        scene = equilibrated(scene)
    n_atoms = len(scene.system)
    asked: list[Asked] = []
    for count in dict.fromkeys((1, *threads)):
        asked.append(((Minimd,), count))
    counts = {"one": (1,), "each": threads, "most": (max(threads),)}

    for peer_name in peers:
        peer = PEERS[peer_name]
        is_wanted = peer_name in options.peers or n_atoms <= peer.most_atoms
        if is_wanted and name in peer.scenes:
            loads = [partial(_load, peer_name, load) for load in (peer.load, *peer.others)]
            asked += [(loads, count) for count in counts[peer.threads]]

    if scene.error:
        groups = _accurate(asked, scene)
    else:
        groups = [[(k, loads[0](scene, count)) for k, (loads, count) in enumerate(asked)]]

    for group in groups:
        check_agreement([engine for _, engine in group], scene)
    tell(f"{name}: the energies agree")
    placed = [pair for group in groups for pair in group]
    if scene.error:
        placed = _quick(placed)
    places, engines = zip(*placed, strict=True)
    speeds = n_atoms * in_turns(engines, options.repeats, n_atoms)
    best = dict[int, EngineSpeed]()

    for k, engine, speed in zip(places, engines, speeds, strict=True):
        if k not in best or np.median(speed) > np.median(best[k].speeds):
            best[k] = EngineSpeed(
                engine.name, engine.threads, engine.precision, name, n_atoms, speed
            )

    for k, row in best.items():
        if row.is_minimd and 4 * n**3 >= FROM_ATOMS:
            tell(f"{n_atoms} atoms: memory of minimd, {threads_text(row.threads)}")
            best[k] = row._replace(bytes_per_atom=bytes_per_atom(name, n, row.threads))

    return [best[k] for k in sorted(best)]


def _accurate(asked: Sequence[Asked], scene: BenchScene) -> list[list[Placed]]:
    """For each cutoff that the cell has room for, the engines that are asked for, with their places: each with the
    least accuracy whose measured error is allowed, without those that do not reach it."""
    groups = []
    widest = 0.5 * scene.edges.min()

    for cutoff in [r for r in WATER_CUTOFFS if r <= widest] or [scene.law.cutoff]:
        exact = scene.cut(cutoff, EXACT)
        forces = Minimd(exact).forces
        charges = exact._replace(potentials=exact.potentials[1:])
        scale = float(np.linalg.norm(Minimd(charges).forces))
        group: list[Placed] = []

        for k, (loads, count) in enumerate(asked):
            for load in loads:
                with_accuracy = lambda accuracy: load(scene.cut(cutoff, accuracy), count)  # noqa: E731
                engine, error = _least_accurate(with_accuracy, scene.error, forces, scale)
                engine.name += f", r_c {cutoff:g} Å, error {error:.1e}"
                if error <= scene.error:
                    group.append((k, engine))
                    tell(f"{scene.name}: {engine.name}")
                else:
                    tell(f"{scene.name}: {engine.name}: left out, as no accuracy is high enough")

        groups.append(group)

    return groups


def _least_accurate(
    load: Callable[[float], LoadedEngine], allowed: float, forces: Array, scale: float
) -> tuple[LoadedEngine, float]:
    """An engine with the least accuracy whose error is allowed, and this error, found by bisection; or the most
    accurate one.
    forces, scale : the exact ones (N, 3), and what their error is divided by."""

    def measured(accuracy: float) -> tuple[LoadedEngine, float]:
        engine = load(accuracy)
        return engine, float(np.linalg.norm(forces - engine.forces)) / scale

    ladder = (allowed * LADDER).tolist()
    is_allowed = lambda accuracy: measured(accuracy)[1] <= allowed  # noqa: E731
    rung = bisect_left(ladder, True, hi=len(ladder) - 1, key=is_allowed)
    return measured(ladder[rung])


def _quick(placed: Sequence[Placed]) -> list[Placed]:
    """Without the engines that are much slower in a short run than another at the same place."""
    seconds = [timed(engine.run, STEPS_TRIED)[1] for _, engine in placed]
    least = dict[int, float]()
    for (k, _), duration in zip(placed, seconds, strict=True):
        least[k] = min(duration, least.get(k, duration))
    is_quick = [
        duration <= TRIED * least[k] for (k, _), duration in zip(placed, seconds, strict=True)
    ]
    return [*compress(placed, is_quick)]


def _load(name: str, load: Load, scene: BenchScene, threads: int) -> LoadedEngine:
    """A peer that has loaded the scene.
    Raises ValueError for any failure of the peer."""
    try:
        return load(scene, threads)
    except Exception as error:
        reason = " ".join(str(error).split()) or type(error).__name__
        raise ValueError(
            f"{name} is installed but does not start: {reason}; to leave it out, name the others with "
            "--peers"
        ) from error
