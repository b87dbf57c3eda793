"""`minimd bench lj`: Lennard-Jones scenes in minimd, and the melt in the other engines that are installed too."""

import sys
from collections.abc import Sequence
from importlib.util import find_spec
from typing import NamedTuple

from minimd.bench.engines import PEERS, Engine, Minimd, Precision
from minimd.bench.memory import FROM_ATOMS, bytes_per_atom
from minimd.bench.outcome import Outcome
from minimd.bench.rows import MELT, Row
from minimd.bench.scenes import CUTOFF, SCENES, Scene, equilibrated, melt, pairs_in_range
from minimd.bench.turns import check_agreement, take_turns, warm_up
from minimd.doctor import available_cores

PRECISIONS = ("double", "mixed")
NO_PEERS = ("none",)
INSTALL = "pip install 'minimd[peers]'"


class Options(NamedTuple):
    """What to run.

    threads : empty for one and all cores.  peers : names in PEERS; empty for those installed, "none" for none.
    """

    scene: str = MELT
    cells: tuple[int, ...] = (5, 10, 20)
    threads: tuple[int, ...] = ()
    precisions: tuple[Precision, ...] = ("double",)
    peers: tuple[str, ...] = ()
    repeats: int = 7

    def kinds(self) -> list[tuple[int, Precision]]:
        """Threads and precisions in which minimd runs: double on one thread, the reference, and those asked for."""
        return list(dict.fromkeys([(1, "double"), *((t, p) for t in self.all_threads() for p in self.precisions)]))

    def all_threads(self) -> tuple[int, ...]:
        """Numbers of threads, each once."""
        return tuple(dict.fromkeys(self.threads or (1, available_cores())))


def run_lj(options: Options) -> Outcome:
    """Measure, size by size; what is going on is told on standard error.

    Raises
    ------
    ValueError : for options that do not fit, or a peer that does not start.
    ArithmeticError : if two engines disagree about the start or the first steps.
    """
    check(options)
    peers = _peers(options)
    if options.scene == MELT:
        sizes = [_melt_beside_peers(n, options, peers) for n in options.cells]
        return Outcome(MELT, [melt(min(options.cells)).text], options.repeats, peers, sizes)
    texts = [SCENES[name](min(options.cells)).text for name in (options.scene, MELT)]
    return Outcome(options.scene, texts, options.repeats, (), [_scene_beside_melt(n, options) for n in options.cells])


def check(options: Options) -> None:
    """Make sure that the options fit together and to this machine.

    Raises
    ------
    ValueError : in one sentence, otherwise.
    """
    for name, value, allowed in (
        ("scene", (options.scene,), SCENES),
        ("precision", options.precisions, PRECISIONS),
        ("peers", options.peers, (*PEERS, *NO_PEERS) if len(options.peers) == 1 else PEERS),
    ):
        unknown = [word for word in value if word not in allowed]
        if unknown:
            raise ValueError(f"--{name} must be of {', '.join(allowed)}; it is {unknown[0]!r}")
    if max(options.all_threads()) > available_cores():
        raise ValueError(f"--threads {max(options.threads)} is more than the {available_cores()} cores that this process may use")
    smallest = min(options.cells)
    if SCENES[options.scene](smallest).edges.min() < 2.0 * CUTOFF:
        raise ValueError(f"--cells {smallest} makes a cell narrower than twice the cutoff in the scene {options.scene!r}; take more")
    if options.peers and options.scene != MELT:
        raise ValueError(f"--peers is for the melt; the scene {options.scene!r} runs in minimd alone")
    missing = [name for name in options.peers if name not in NO_PEERS and not find_spec(name)]
    if missing:
        raise ValueError(f"{missing[0]} is not installed; {INSTALL} installs the peers")


def _peers(options: Options) -> tuple[str, ...]:
    """Names of the peers that take part in the melt; those that could, but are missing, are told."""
    if options.scene != MELT or options.peers == NO_PEERS:
        return ()
    missing = [name for name in PEERS if not find_spec(name)]
    if missing and not options.peers:
        print(f"not installed, so not compared with: {', '.join(missing)}; {INSTALL} installs them", file=sys.stderr)
    return tuple(name for name in options.peers or PEERS if name not in (*missing, *NO_PEERS))


def _melt_beside_peers(n: int, options: Options, peers: Sequence[str]) -> list[Row]:
    scene = melt(n)
    engines: list[Engine] = [Minimd(scene, *kind) for kind in options.kinds()]
    for name in peers:
        if name in options.peers or len(scene.system) <= PEERS[name].most_atoms:
            engines.extend(_load(name, scene, threads) for threads in (options.all_threads() if PEERS[name].threaded else (1,)))
    n_atoms = len(scene.system)
    check_agreement(engines, n_atoms)
    speeds = n_atoms * take_turns(engines, warm_up(engines, n_atoms), options.repeats, n_atoms)
    rows = [Row(e.name, e.threads, e.precision, MELT, n_atoms, speeds[k]) for k, e in enumerate(engines)]
    return [_with_memory(row, n) for row in rows]


def _scene_beside_melt(n: int, options: Options) -> list[Row]:
    """Another scene and the melt of about as many atoms, in turns; pairs are counted before and after these."""
    scenes = melt(n), equilibrated(SCENES[options.scene](n))
    loaded = [(scene, Minimd(scene, *kind)) for kind in options.kinds() for scene in scenes]
    engines, n_atoms = [engine for _, engine in loaded], len(loaded[-1][0].system)
    n_steps = warm_up(engines, n_atoms)
    before = [pairs_in_range(scene, engine.positions) for scene, engine in loaded]
    steps_per_second = take_turns(engines, n_steps, options.repeats, n_atoms)
    rows = []
    for k, (scene, engine) in enumerate(loaded):
        n_pairs, atoms = 0.5 * (before[k] + pairs_in_range(scene, engine.positions)), len(scene.system)
        rows.append(Row(engine.name, engine.threads, engine.precision, scene.name, atoms, atoms * steps_per_second[k], n_pairs))
    return [_with_memory(row, n) for row in rows]


def _load(name: str, scene: Scene, threads: int) -> Engine:
    """A peer with the scene; whatever keeps it from starting becomes one sentence."""
    try:
        return PEERS[name].load(scene, threads)
    except Exception as error:
        reason = " ".join(str(error).split()) or type(error).__name__
        raise ValueError(f"{name} is installed but does not start: {reason}; name the others with --peers") from error


def _with_memory(row: Row, n: int) -> Row:
    if not row.is_minimd or 4 * n**3 < FROM_ATOMS:
        return row
    print(f"{row.n_atoms} atoms: memory of minimd, {row.precision}, {row.threads} threads", file=sys.stderr)
    return row._replace(bytes_per_atom=bytes_per_atom(row.scene, n, row.threads, row.precision))
