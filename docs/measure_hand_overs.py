"""Hand-overs to LAMMPS: time, memory and files of each phase. A part of measure_scaling.py."""

import json
import os
import re
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import cache
from pathlib import Path
from statistics import median

SMALL, LARGE = 32, 40  # cells of four atoms in each direction: 131 072 and 256 000 atoms
HAND_OVERS = ((SMALL, 1), (LARGE, 1), (LARGE, 2))  # cells, processes
STEPS, EVERY, TURNS = 100, 50, 3  # of a hand-over; how often it is made: numbers are medians
BYTES_OF_A_FRAME = 48  # for each atom: position and velocity
PHASES = ("writing", "verifying", "running", "reading back")
SECONDS_BETWEEN_SAMPLES = 0.02


def table_of(titles: list, rows: list[list]) -> Iterator[str]:
    """A Markdown table."""
    yield f"| {' | '.join(map(str, titles))} |"
    yield f"|{' --- |' * len(titles)}"
    for row in rows:
        yield f"| {' | '.join(map(str, row))} |"


def melt(cells: int):
    """The Lennard-Jones melt at its start."""
    import minimd as md

    positions, edges = md.lattice.crystal("fcc", [cells] * 3, (4.0 / 0.8442) ** (1 / 3))
    simulation = md.Simulation(
        md.System(positions, cell=edges), md.LennardJones(1.0, 1.0, 2.5), md.VelocityVerlet(0.005), threads=1
    )
    simulation.set_temperature(1.44, seed=1)
    return simulation


class Sampler:
    """Looks every 20 ms at the memory of this process and of LAMMPS' processes that it has started, and at files.

    own, others : bytes at most, by phase.  sizes : bytes at most, by file.
    """

    def __init__(self, folder: Path, phase: Callable[[], str]) -> None:
        self._folder, self._phase, self._ended = folder, phase, threading.Event()
        self.own, self.others, self.sizes = {}, {}, {}
        self._thread = threading.Thread(target=self._look_on, daemon=True)

    def __enter__(self) -> "Sampler":
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._ended.set()
        self._thread.join()

    def _look_on(self) -> None:
        while not self._ended.wait(SECONDS_BETWEEN_SAMPLES):
            phase = self._phase()
            self.own[phase] = max(self.own.get(phase, 0), memory_of(os.getpid()))
            self.others[phase] = max(self.others.get(phase, 0), sum(map(memory_of, started(os.getpid()))))
            for file in self._folder.glob("*"):
                try:
                    self.sizes[file.name] = max(self.sizes.get(file.name, 0), file.stat().st_size)
                except FileNotFoundError:
                    continue


def memory_of(process: int) -> int:
    """Bytes that a process holds now; 0 if it is gone."""
    try:
        return int(Path(f"/proc/{process}/statm").read_text().split()[1]) * os.sysconf("SC_PAGE_SIZE")
    except (OSError, IndexError):
        return 0


def started(process: int) -> Iterator[int]:
    """LAMMPS' processes among those that a process has started, and that they have started."""
    try:
        children = [
            int(one)
            for task in Path(f"/proc/{process}/task").iterdir()
            for one in (task / "children").read_text().split()
        ]
        yield from (child for child in children if Path(f"/proc/{child}/comm").read_text().strip() == "lmp")
    except OSError:
        return
    for child in children:
        yield from started(child)


def one_hand_over(cells: int, processes: int) -> None:
    """Print what one hand-over takes, as JSON. In a process of its own, whose memory is that of this hand-over."""
    from minimd.lammps import handing_over

    simulation, minimd, lammps = melt(cells), dict[str, float](), dict[str, float]()
    simulation.run(1, progress=False)  # kernels
    with tempfile.TemporaryDirectory() as base:
        folder = Path(base, "melt")
        names, phase = list(PHASES), handing_over.phase

        @contextmanager
        def timed(job: handing_over.Job, name: str) -> Iterator[None]:
            started, before = time.thread_time(), os.times()
            with phase(job, name):
                yield
            minimd[name] = time.thread_time() - started  # without the sampler
            lammps[name] = sum(os.times()[2:4]) - sum(before[2:4])

        handing_over.phase = timed
        with Sampler(folder, lambda: names[min(len(minimd), len(names) - 1)]) as sampler:
            done = handing_over.hand_over(
                simulation, folder, STEPS, processes=processes, every=EVERY, progress=False, tell=None
            )
        log = (folder / "run.log").read_text()
        loop, busy = (float(re.search(words, log)[1]) for words in (r"Loop time of (\S+)", r"(\S+)% CPU use"))
        told = {
            "n": len(simulation.system),
            "frames": len(done.record),
            "loop": loop * busy / 100 * processes,  # processor time of all processes
            "minimd": minimd,
            "lammps": lammps,
        }
        print(json.dumps(told | {"own": sampler.own, "others": sampler.others, "sizes": sampler.sizes}))


def in_a_process(*arguments: object) -> dict:
    """What this script prints last when it is called so."""
    command = [sys.executable, sys.argv[0], *map(str, arguments)]
    return json.loads(subprocess.run(command, check=True, capture_output=True, text=True).stdout.splitlines()[-1])


@cache
def hand_overs() -> dict[tuple[int, int], list[dict]]:
    """What hand-overs take, in turns."""
    turns = [{kind: in_a_process("--hand-over", *kind) for kind in HAND_OVERS} for _ in range(TURNS)]
    return {kind: [turn[kind] for turn in turns] for kind in HAND_OVERS}


def steps() -> Iterator[str]:
    """Weak and strong scaling."""
    rows = []
    for kind, told in hand_overs().items():
        n, loops = told[0]["n"], [one["loop"] for one in told]
        speed = n * STEPS / median(loops) / 1e6
        spread = f"{median(loops):.1f} ({min(loops):.1f} to {max(loops):.1f})"
        rows.append([f"{n:,}", kind[1], spread, f"{speed:.2f}"])
    titles = ["atoms", "processes", "processor seconds for 100 steps", "million atom-steps per processor second"]
    return table_of(titles, rows)


def growth(name: str, phase: str) -> float:
    """Growth of seconds or bytes per atom, between the small and the large scene on one process.  phase : or file."""
    pairs = zip(hand_overs()[SMALL, 1], hand_overs()[LARGE, 1], strict=True)
    return median((b[name].get(phase, 0) - a[name].get(phase, 0)) / (b["n"] - a["n"]) for a, b in pairs)


def phases() -> Iterator[str]:
    """Processor time and memory of each phase."""
    rows = []
    for phase in PHASES:
        times = [f"{1e6 * growth(program, phase):.1f}" for program in ("minimd", "lammps")]
        rows.append([phase, *times, *(f"{max(0, growth(name, phase)):.0f}" for name in ("own", "others"))])
    return table_of(["phase", "µs per atom in minimd", "in LAMMPS", "bytes per atom in minimd", "in LAMMPS"], rows)


def file_bytes(name: str) -> float:
    """Growth of a file per atom [B]."""
    return growth("sizes", name)


def files() -> Iterator[str]:
    """Sizes of files."""
    meanings = {
        "atoms.data": "atoms, as text",
        "copy.data": "the smaller copy; removed after the comparison",
        "atoms.data.bin": "energies, forces and virials at step 0; the copy needs as much; both are removed then",
        "last.bin": "the last state; each frame in `frames.bin` needs as much; both are removed in the end",
        "run.h5md": "minimd's file: three frames of 48 bytes per atom, and two restarts",
    }
    return table_of(
        ["file", "bytes per atom", ""],
        [[f"`{name}`", f"{file_bytes(name):.0f}", told] for name, told in meanings.items()],
    )


def large_model() -> Iterator[str]:
    """What a hand-over of more atoms takes."""
    running = growth("lammps", "running") / STEPS
    atoms = (1e6, 1e7, 1e8, 1e9)

    def row(words: str, per_atom: float, unit: str, digits: Callable[[float], str]) -> list[str]:
        return [words, *(f"{digits(per_atom * n)} {unit}" for n in atoms)]

    own = max(growth("own", phase) for phase in PHASES)
    rows = [
        row("largest memory of minimd", own / 1e9, "GB", rounded),
        row("memory of LAMMPS, all processes", max(growth("others", phase) for phase in PHASES) / 1e9, "GB", rounded),
        row("`atoms.data`", file_bytes("atoms.data") / 1e9, "GB", rounded),
        row("a frame of `run.h5md`", BYTES_OF_A_FRAME / 1e9, "GB", rounded),
        row("writing, one core", growth("minimd", "writing") / 60, "min", rounded),
        row(
            "comparing step 0, both programs, one core",
            (growth("minimd", "verifying") + growth("lammps", "verifying")) / 60,
            "min",
            rounded,
        ),
        row("reading back, three frames, one core", growth("minimd", "reading back") / 60, "min", rounded),
        row("10⁶ steps on a thousand cores", 1e6 * running / 1000 / 3600, "h", rounded),
    ]
    return table_of(["", *(f"10{'⁶⁷⁸⁹'[k]} atoms" for k in range(len(atoms)))], rows)


def rounded(number: float) -> str:
    """Two digits."""
    return f"{float(f'{number:.2g}'):,g}"
