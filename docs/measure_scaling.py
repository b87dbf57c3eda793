"""Measures what docs/scaling.md says: hand-overs to LAMMPS, ensembles, their tables. Five minutes on two cores that nobody else uses.

    python docs/measure_scaling.py                      # all tables, as Markdown
    python docs/measure_scaling.py steps phases files   # these
    python docs/measure_scaling.py --write              # into the page, in place of those that are there

Models are computed from the measured numbers.
"""

import json
import os
import resource
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import cache
from pathlib import Path

import numpy as np

PAGE = Path(__file__).parent / "scaling.md"
SMALL, LARGE = 32, 40  # cells of four atoms in each direction: 131 072 and 256 000 atoms
HAND_OVERS = ((SMALL, 1), (LARGE, 1), (LARGE, 2))  # cells, processes
STEPS, EVERY = 100, 50  # of a hand-over
BYTES_OF_A_FRAME = 48  # for each atom: position and velocity
PHASES = {"writing": 1, "verifying": 2, "running": 0, "reading back": 1}  # cores: one, LAMMPS' and then one, LAMMPS'
MEMBERS, MEMBER_STEPS, TURNS = 24, 20_000, 3
SHORT_MEMBERS = 50
ROWS = (1_000, 10_000, 100_000)
OBSERVABLES = 14
SECONDS_BETWEEN_SAMPLES = 0.02
Numbers = dict[str, float]


# ---------------------------------------------------------------- hand-overs


def melt(cells: int):
    """The Lennard-Jones melt at its start."""
    import minimd as md

    positions, edges = md.lattice.crystal("fcc", [cells] * 3, (4.0 / 0.8442) ** (1 / 3))
    simulation = md.Simulation(md.System(positions, cell=edges), md.LennardJones(1.0, 1.0, 2.5), md.VelocityVerlet(0.005), threads=1)
    simulation.set_temperature(1.44, seed=1)
    return simulation


class Sampler:
    """Looks every 20 ms at the memory of this process and of LAMMPS' processes that it has started, and at the files of a folder.

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
        children = [int(one) for task in Path(f"/proc/{process}/task").iterdir() for one in (task / "children").read_text().split()]
        yield from (child for child in children if Path(f"/proc/{child}/comm").read_text().strip() == "lmp")
    except OSError:
        return
    for child in children:
        yield from started(child)


def one_hand_over(cells: int, processes: int) -> None:
    """Print what one hand-over takes, as JSON. In a process of its own, whose memory is that of this hand-over."""
    from minimd.lammps import handing_over

    simulation, parts = melt(cells), {"compare": 0.0}
    simulation.run(1, progress=False)  # kernels
    compare = handing_over.compare

    def timed(*arguments: object) -> object:
        started = time.perf_counter()
        answer = compare(*arguments)
        parts["compare"] = time.perf_counter() - started
        return answer

    handing_over.compare = timed
    with tempfile.TemporaryDirectory() as base:
        folder = Path(base, "melt")
        job = handing_over.Job(simulation, folder, STEPS, processes, EVERY, False)
        names = list(PHASES)
        with job.in_folder(False), Sampler(folder, lambda: names[min(len(job.seconds), len(names) - 1)]) as sampler:
            done = job.run(job.prepare(), False)
        loop = next(float(line.split()[3]) for line in (folder / "run.log").read_text().splitlines() if line.startswith("Loop time of"))
        told = {"n": len(simulation.system), "frames": len(done.record), "loop": loop, "seconds": job.seconds | parts}
        print(json.dumps(told | {"own": sampler.own, "others": sampler.others, "sizes": sampler.sizes}))


def in_a_process(*arguments: object) -> dict:
    """What this script prints last when it is called so."""
    command = [sys.executable, __file__, *map(str, arguments)]
    return json.loads(subprocess.run(command, check=True, capture_output=True, text=True).stdout.splitlines()[-1])


@cache
def hand_overs() -> dict[tuple[int, int], dict]:
    """All of them."""
    return {kind: in_a_process("--hand-over", *kind) for kind in HAND_OVERS}


def steps() -> Iterator[str]:
    """Weak and strong scaling."""
    found = hand_overs()
    speed = {kind: told["n"] * STEPS / told["loop"] / 1e6 for kind, told in found.items()}
    yield from table_of(
        ["atoms", "processes", "seconds for 100 steps", "million atom-steps per second"],
        [[f"{told['n']:,}", kind[1], f"{told['loop']:.1f}", f"{speed[kind]:.2f}"] for kind, told in found.items()],
    )
    one, two = found[LARGE, 1]["loop"], found[LARGE, 2]["loop"]
    yield ""
    yield f"Strong scaling, {found[LARGE, 1]['n']:,} atoms: {one / two:.2f} times faster on two processes."
    yield f"Weak scaling, about {found[SMALL, 1]['n']:,} atoms for each: {speed[LARGE, 2] / speed[SMALL, 1]:.2f} times the atom-steps per second."


def growth(name: str, phase: str) -> float:
    """Growth of seconds or bytes per atom, between the small and the large scene on one process."""
    small, large = hand_overs()[SMALL, 1], hand_overs()[LARGE, 1]
    return (large[name].get(phase, 0) - small[name].get(phase, 0)) / (large["n"] - small["n"])


def phases() -> Iterator[str]:
    """Time and memory of each phase."""
    cores = {0: "those of LAMMPS", 1: "one", 2: "LAMMPS', then one"}
    rows = []
    for phase, kind in PHASES.items():
        rows.append(
            [phase, cores[kind], f"{1e6 * growth('seconds', phase):.1f}", f"{growth('own', phase):.0f}", f"{growth('others', phase):.0f}"],
        )
    rows.insert(2, ["of this the comparison by minimd", "one", f"{1e6 * growth('seconds', 'compare'):.1f}", "", ""])
    return table_of(["phase", "cores", "µs per atom", "bytes per atom in minimd", "bytes per atom in LAMMPS"], rows)


def file_bytes(name: str) -> float:
    """Growth of a file per atom [B]."""
    small, large = hand_overs()[SMALL, 1], hand_overs()[LARGE, 1]
    return (large["sizes"][name] - small["sizes"][name]) / (large["n"] - small["n"])


def files() -> Iterator[str]:
    """Sizes of files."""
    meanings = {
        "atoms.data": "atoms, as text",
        "step0.bin": "energies, forces and virials at step 0, until they are compared",
        "last.bin": "the last state, and each frame in `frames.bin`, until they are read back",
        "run.h5md": "minimd's file: 48 for each of three frames, and two restarts",
    }
    return table_of(["file", "bytes per atom", ""], [[f"`{name}`", f"{file_bytes(name):.0f}", told] for name, told in meanings.items()])


def large_model() -> Iterator[str]:
    """What a hand-over of more atoms takes."""
    speed = hand_overs()[LARGE, 1]["n"] * STEPS / hand_overs()[LARGE, 1]["loop"]
    atoms = (1e6, 1e7, 1e8, 1e9)

    def row(words: str, per_atom: float, unit: str, digits: Callable[[float], str]) -> list[str]:
        return [words, *(f"{digits(per_atom * n)} {unit}" for n in atoms)]

    own = max(growth("own", phase) for phase in PHASES)
    rows = [
        row("memory of minimd, at most", own / 1e9, "GB", rounded),
        row("memory of LAMMPS, all processes", max(growth("others", phase) for phase in PHASES) / 1e9, "GB", rounded),
        row("`atoms.data`", file_bytes("atoms.data") / 1e9, "GB", rounded),
        row("a frame of `run.h5md`", BYTES_OF_A_FRAME / 1e9, "GB", rounded),
        row("writing, one core", growth("seconds", "writing") / 60, "min", rounded),
        row("comparing step 0, one core", growth("seconds", "compare") / 60, "min", rounded),
        row("reading back, three frames, one core", growth("seconds", "reading back") / 60, "min", rounded),
        row("10⁶ steps on a thousand cores", 1e6 / speed / 1000 / 3600, "h", rounded),
    ]
    return table_of(["", *(f"10{'⁶⁷⁸⁹'[k]} atoms" for k in range(len(atoms)))], rows)


def rounded(number: float) -> str:
    """Two digits."""
    return f"{float(f'{number:.2g}'):,g}"


# ---------------------------------------------------------------- ensembles


def liquid(member):
    """256 atoms in a bath."""
    import minimd as md

    positions, edges = md.lattice.crystal("fcc", [4, 4, 4], 1.728)
    bath = md.LangevinBAOAB(0.004, 1.0, 1.0, seed=member.seed)
    simulation = md.Simulation(md.System(positions, cell=edges), md.LennardJones(1.0, 1.0, 2.5), bath)
    simulation.set_temperature(1.0, member.seed)
    return simulation


@contextmanager
def measured() -> Iterator[Numbers]:
    """Wall time, and processor time of this process and of its children that have ended, of what happens inside [s]."""
    told: Numbers = {}
    started, own, others = time.perf_counter(), resource.getrusage(resource.RUSAGE_SELF), resource.getrusage(resource.RUSAGE_CHILDREN)
    yield told
    told["wall"] = time.perf_counter() - started
    for name, before, who in (("own", own, resource.RUSAGE_SELF), ("children", others, resource.RUSAGE_CHILDREN)):
        now = resource.getrusage(who)
        told[name] = now.ru_utime + now.ru_stime - before.ru_utime - before.ru_stime


def one_ensemble(n: int, n_steps: int, workers: int, every: int = 100) -> Numbers:
    """Times of an ensemble, and seconds that its members took, in all."""
    import minimd as md

    with tempfile.TemporaryDirectory() as folder:
        with measured() as told:
            md.ensemble(liquid, n, n_steps, every=every, workers=workers, folder=Path(folder, "scan"), progress=False)
        rows = [json.loads(line) for line in Path(folder, "scan", "members.jsonl").read_text().splitlines()]
        told["members"] = sum(row["seconds"] for row in rows)
        told["bytes"] = sum(file.stat().st_size for file in Path(folder, "scan").rglob("*.h5md")) / n
    return told


def ensembles() -> Iterator[str]:
    """Members per hour on one worker and on two."""
    one_ensemble(1, 100, 0)  # kernels
    turns = [(one_ensemble(MEMBERS, MEMBER_STEPS, 1), one_ensemble(MEMBERS, MEMBER_STEPS, 2)) for _ in range(TURNS)]
    rows = []
    for k in (0, 1):
        wall = np.median([turn[k]["wall"] for turn in turns])
        busy = np.median([turn[k]["members"] / ((k + 1) * turn[k]["wall"]) for turn in turns])
        processor = np.median([(turn[k]["own"] + turn[k]["children"]) / MEMBERS for turn in turns])
        rows.append([k + 1, f"{wall:.1f}", f"{3600 * MEMBERS / wall:.0f}", f"{100 * busy:.0f} %", f"{processor:.2f}"])
    titles = ["workers", f"seconds for {MEMBERS} members", "members per hour", "of the workers' time in members", "processor seconds per member"]
    yield from table_of(titles, rows)
    ratios = np.array([one["wall"] / two["wall"] for one, two in turns])
    work = np.array([two["children"] / one["children"] for one, two in turns])
    yield ""
    yield f"Two workers beside one, in {TURNS} turns: {np.median(ratios):.2f} ({ratios.min():.2f} to {ratios.max():.2f}) times the members per hour,"
    yield f"for {np.median(work):.2f} times the processor time."


def members() -> Iterator[str]:
    """What a member takes besides its steps."""
    one_ensemble(1, 100, 0)
    few, many = one_ensemble(10, 1, 0, every=1), one_ensemble(10 + SHORT_MEMBERS, 1, 0, every=1)
    each = {name: (many[name] - few[name]) / SHORT_MEMBERS for name in ("wall", "own")}
    idle, spawned = one_ensemble(1, 1, 0, every=1), one_ensemble(1, 1, 1, every=1)
    yield from table_of(
        ["", "processor time", "wall time"],
        [
            ["a member of one step: scene, kernels, file, averages, line", f"{1e3 * each['own']:.0f} ms", f"{1e3 * each['wall']:.0f} ms"],
            [
                "a worker: start of Python, imports, kernels loaded",
                f"{spawned['children'] + spawned['own'] - each['own']:.1f} s",
                f"{spawned['wall'] - idle['wall']:.1f} s",
            ],
        ],
    )
    frames = one_ensemble(2, 2000, 0, every=10)["bytes"] - few["bytes"]
    yield ""
    yield f"The file of a member of 256 atoms: {few['bytes'] / 1e3:.0f} kB with 2 frames, and {frames / 199 / 1e3:.1f} kB for each other one."


# ---------------------------------------------------------------- tables


def one_table(n: int) -> None:
    """Print what the table of n members takes, as JSON."""
    from minimd.ensemble.folder import Asked, EnsembleFolder
    from minimd.ensemble.member import checked_parameters
    from minimd.ensemble.status import status
    from minimd.ensemble.table import table_of as table_in

    told: Numbers = {}

    @contextmanager
    def timed(name: str) -> Iterator[None]:
        started = time.process_time()
        yield
        told[name] = time.process_time() - started

    averages = {f"observable_{k}": 1.2345678901234567 / (k + 1) for k in range(OBSERVABLES)}
    row = {"status": "done", "n_steps": 10, "n_atoms": 256, "units": "LJ", "means": averages, "errors": averages, "seconds": 1.0}
    with tempfile.TemporaryDirectory() as base:
        folder = Path(base, "scan")
        with EnsembleFolder(folder, writes=True) as opened:
            with timed("begin"):
                asked = Asked(0, 10, 5, checked_parameters([{"temperature": k // 4 / n} for k in range(n)]), "b", "", "")
                asked = opened.begin(asked, True)
            with timed("lines"):
                for k in range(n):
                    opened.take({"index": k, "parameters": asked.parameters[k], **row})
        with EnsembleFolder(folder, writes=True) as opened:
            pass
        with timed("journal"), EnsembleFolder(folder, writes=False) as opened:
            pass
        with timed("table"):
            table = table_in(opened, asked, n)
        with timed("written"):
            table.write()
        with timed("averaged"):
            table.averaged()
        told["memory"] = 1024 * resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
        with timed("status"):
            status(folder)
        told["bytes"] = sum(file.stat().st_size for file in folder.iterdir())
        told["bytes of the journal"] = (folder / "members.jsonl").stat().st_size
    print(json.dumps(told))


def tables() -> Iterator[str]:
    """What tables take, against the number of members."""
    found = {n: in_a_process("--table", n) for n in ROWS}
    words = {
        "lines": "lines of all members, as they end",
        "journal": "reading the journal",
        "table": "making the table",
        "written": "writing `table.csv` and `table.json`",
        "averaged": "`averaged()`, sets of four members",
        "status": "`minimd scan --status`",
    }
    rows = [[told, *(f"{found[n][name]:.2f} s" for n in ROWS)] for name, told in words.items()]
    rows.append(["journal and tables on the disk", *(f"{found[n]['bytes'] / 1e6:.0f} MB" for n in ROWS)])
    rows.append(["memory at most", *(f"{found[n]['memory'] / 1e6:.0f} MB" for n in ROWS)])
    return table_of(["", *(f"{n:,} members" for n in ROWS)], rows)


# ---------------------------------------------------------------- the page


def table_of(titles: list, rows: list[list]) -> Iterator[str]:
    """A Markdown table."""
    yield f"| {' | '.join(map(str, titles))} |"
    yield f"|{' --- |' * len(titles)}"
    for row in rows:
        yield f"| {' | '.join(map(str, row))} |"


PARTS = {part.__name__: part for part in (steps, phases, files, large_model, ensembles, members, tables)}


def written(page: str, name: str, text: str) -> str:
    """The page with another text between the marks of a part."""
    begin, end = f"<!-- {name} -->", f"<!-- end of {name} -->"
    before, _, rest = page.partition(begin)
    return f"{before}{begin}\n{text}\n{end}{rest.partition(end)[2]}"


def main(arguments: list[str]) -> None:
    """See the top of this file."""
    if arguments[:1] in (["--hand-over"], ["--table"]):
        {"--hand-over": one_hand_over, "--table": one_table}[arguments[0]](*map(int, arguments[1:]))
        return
    from minimd.bench.outcome import machine

    page = PAGE.read_text(encoding="utf-8") if PAGE.exists() else ""
    parts = {"machine": lambda: iter([f"{machine()['text']}."])} | PARTS
    for name in [one for one in arguments if one != "--write"] or parts:
        text = "\n".join(parts[name]())
        print(f"\n## {name}\n\n{text}", flush=True)
        page = written(page, name, text)
    if "--write" in arguments:
        PAGE.write_text(page, encoding="utf-8")


if __name__ == "__main__":
    main(sys.argv[1:])
