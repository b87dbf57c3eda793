"""Measures what docs/scaling.md says: hand-overs to LAMMPS, ensembles, tables. Five minutes on two idle cores.

    python docs/measure_scaling.py                      # all tables, as Markdown
    python docs/measure_scaling.py steps phases files   # these
    python docs/measure_scaling.py --write              # into the page, in place of those that are there

Models are computed from the measured numbers.
"""

import json
import resource
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
from measure_hand_overs import files, in_a_process, large_model, one_hand_over, phases, steps, table_of

PAGE = Path(__file__).parent / "scaling.md"
MEMBERS, MEMBER_STEPS, TURNS = 24, 20_000, 3
SHORT_MEMBERS = 50
ROWS = (1_000, 10_000, 100_000)
OBSERVABLES = 14
Numbers = dict[str, float]


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
    started, own, others = (
        time.perf_counter(),
        resource.getrusage(resource.RUSAGE_SELF),
        resource.getrusage(resource.RUSAGE_CHILDREN),
    )
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
    titles = [
        "workers",
        f"seconds for {MEMBERS} members",
        "members per hour",
        "of the workers' time in members",
        "processor seconds per member",
    ]
    yield from table_of(titles, rows)
    ratios = np.array([one["wall"] / two["wall"] for one, two in turns])
    work = np.array([two["children"] / one["children"] for one, two in turns])
    yield ""
    gain = f"{np.median(ratios):.2f} ({ratios.min():.2f} to {ratios.max():.2f})"
    yield f"Two workers beside one, in {TURNS} turns: {gain} times the members per hour,"
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
            [
                "a member of one step: scene, kernels, file, averages, line",
                f"{1e3 * each['own']:.0f} ms",
                f"{1e3 * each['wall']:.0f} ms",
            ],
            [
                "a worker: start of Python, imports, kernels loaded",
                f"{spawned['children'] + spawned['own'] - each['own']:.1f} s",
                f"{spawned['wall'] - idle['wall']:.1f} s",
            ],
        ],
    )
    frames = one_ensemble(2, 2000, 0, every=10)["bytes"] - few["bytes"]
    yield ""
    first, other = f"{few['bytes'] / 1e3:.0f} kB", f"{frames / 199 / 1e3:.1f} kB"
    yield f"The file of a member of 256 atoms: {first} with 2 frames, and {other} for each other one."


def one_table(n: int) -> None:
    """Print what the table of n members takes, as JSON."""
    from minimd.ensemble.folder import Asked, EnsembleFolder
    from minimd.ensemble.member import checked_parameters
    from minimd.ensemble.table import status
    from minimd.ensemble.table import table_of as table_in

    told: Numbers = {}

    @contextmanager
    def timed(name: str) -> Iterator[None]:
        started = time.process_time()
        yield
        told[name] = time.process_time() - started

    averages = {f"observable_{k}": 1.2345678901234567 / (k + 1) for k in range(OBSERVABLES)}
    row = {
        "status": "done",
        "n_steps": 10,
        "n_atoms": 256,
        "units": "LJ",
        "means": averages,
        "errors": averages,
        "seconds": 1.0,
    }
    with tempfile.TemporaryDirectory() as base:
        folder = Path(base, "scan")
        with EnsembleFolder(folder, writes=True) as opened:
            with timed("begin"):
                asked = Asked(
                    0, 10, 5, checked_parameters([{"temperature": k // 4 / n} for k in range(n)]), "b", "", ""
                )
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
        told["memory"] = peak()
        with timed("status"):
            status(folder)
        told["bytes"] = sum(file.stat().st_size for file in folder.iterdir())
        told["bytes of the journal"] = (folder / "members.jsonl").stat().st_size
    print(json.dumps(told))


def peak() -> float:
    """Bytes that this process has held at most."""
    line = next(one for one in Path("/proc/self/status").read_text().splitlines() if one.startswith("VmHWM:"))
    return 1024.0 * float(line.split()[1])


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
    from minimd_bench.outcome import machine

    parts, texts = {"machine": lambda: iter([f"{machine()['text']}."])} | PARTS, dict[str, str]()
    for name in [one for one in arguments if one != "--write"] or parts:
        texts[name] = "\n".join(parts[name]())
        print(f"\n## {name}\n\n{texts[name]}", flush=True)
    if "--write" in arguments:
        page = PAGE.read_text(encoding="utf-8")
        for name, text in texts.items():
            page = written(page, name, text)
        PAGE.write_text(page, encoding="utf-8")


if __name__ == "__main__":
    main(sys.argv[1:])
