"""Measures what docs/scaling.md says: hand-overs to LAMMPS, ensembles, tables. All times are processor times,
which other work on the machine hardly changes, and medians. A quarter of an hour.

    python docs/measure_scaling.py                      # all tables, as Markdown
    python docs/measure_scaling.py steps phases files   # these
    python docs/measure_scaling.py --write              # into the page, in place of those that are there

Models are computed from the measured numbers.
"""

import json
import os
import re
import resource
import sys
import tempfile
import time
import types
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from unittest import mock

import numpy as np
from measure_hand_overs import files, in_a_process, large_model, one_hand_over, phases, steps, table_of

PAGE = Path(__file__).parent / "scaling.md"
MEMBERS, MEMBER_STEPS, EVERY, TURNS = 8, 20_000, 50, 3
SHORT_MEMBERS, ON_DASK = 50, 20_000
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


def one_ensemble(n: int, n_steps: int, workers: int, every: int = EVERY) -> Numbers:
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
    """Processor time on one worker and on two, in turns."""
    one_ensemble(1, 100, 0)  # kernels
    turns = [[one_ensemble(MEMBERS, MEMBER_STEPS, workers) for workers in (1, 2)] for _ in range(TURNS)]
    rows = []
    for k in (0, 1):
        each = [(turn[k]["own"] + turn[k]["children"]) / MEMBERS for turn in turns]
        rows.append([k + 1, f"{np.median(each):.2f} ({min(each):.2f} to {max(each):.2f})"])
    steps, frames = f"{MEMBER_STEPS:,}".replace(",", " "), MEMBER_STEPS // EVERY + 1
    titles = ["workers", f"processor seconds per member ({MEMBERS} of 256 atoms, {steps} steps, {frames} frames)"]
    return table_of(titles, rows)


def members() -> Iterator[str]:
    """What a member takes besides its steps."""
    one_ensemble(1, 100, 0)
    turns = [(one_ensemble(10, 1, 0, 1), one_ensemble(10 + SHORT_MEMBERS, 1, 0, 1)) for _ in range(TURNS)]
    each = np.median([(many["own"] - few["own"]) / SHORT_MEMBERS for few, many in turns])
    spawned = np.median([sum(one_ensemble(1, 1, 1, 1)[name] for name in ("own", "children")) for _ in range(TURNS)])
    rows = [
        ["a member of one step and two frames: scene, file, averages, line of the journal", f"{1e3 * each:.0f} ms"],
        ["calls of fsync", f"{syncs(10 + SHORT_MEMBERS) - syncs(10):.0f} for {SHORT_MEMBERS} members"],
        ["a worker: start of Python, imports, kernels loaded", f"{spawned - each:.1f} s"],
        [f"the caller, for each of {ON_DASK:,} members without work, on dask", f"{1e3 * on_dask() / ON_DASK:.2f} ms"],
    ]
    yield from table_of(["", "processor time"], rows)
    few, frames = turns[0][0]["bytes"], one_ensemble(2, 2000, 0, every=10)["bytes"]
    first, other = f"{few / 1e3:.0f} kB", f"{(frames - few) / 199 / 1e3:.1f} kB"
    yield ""
    yield f"The file of a member of 256 atoms: {first} with 2 frames, and {other} for each further frame."


def syncs(n: int) -> int:
    """Calls of fsync by an ensemble of n members in this process."""
    with mock.patch("os.fsync", wraps=os.fsync) as fsync:
        one_ensemble(n, 1, 0, 1)
    return fsync.call_count


def kept(_member, scenes=[]):  # noqa: B006 - one for each worker
    """The same simulation for all members."""
    if not scenes:
        scenes.append(liquid(types.SimpleNamespace(seed=0)))
    return scenes[0]


def nothing(_simulation, member):
    """The run of a member that does nothing."""
    return {"index": float(member.index)}


def on_dask() -> float:
    """Processor time of the caller for members without work, on dask [s]."""
    import measure_scaling as here  # by a name that workers can import
    from distributed import Client

    import minimd as md

    client = Client(n_workers=2, threads_per_worker=1, dashboard_address=None)
    with client, tempfile.TemporaryDirectory() as folder, measured() as told:
        md.ensemble(here.kept, ON_DASK, 0, run=here.nothing, executor=client, folder=folder, progress=False)
    return told["own"]


def one_table(n: int) -> None:
    """Print what the table of n members takes, as JSON."""
    from minimd.ensemble.folder import Asked, EnsembleFolder
    from minimd.ensemble.member import checked_parameters
    from minimd.ensemble.table import status, table_of as table_in

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
        "lines": "writing the lines of all members, as they end",
        "journal": "reading the journal",
        "table": "making the table",
        "written": "writing `table.csv` and `table.json`",
        "averaged": "`averaged()`, sets of four members",
        "status": "`minimd scan --status`",
    }
    rows = [[told, *(f"{found[n][name]:.2f} s" for n in ROWS)] for name, told in words.items()]
    rows.append(["journal and tables on the disk", *(f"{found[n]['bytes'] / 1e6:.0f} MB" for n in ROWS)])
    rows.append(["largest memory", *(f"{found[n]['memory'] / 1e6:.0f} MB" for n in ROWS)])
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
    from minimd.bench.outcome import machine

    facts = Path("/proc/cpuinfo").read_text()
    kind = ("Zen 5, " if re.search(r"cpu family\s*: 26", facts) else "") + ("AVX-512" if "avx512f" in facts else "AVX2")
    parts, texts = {"machine": lambda: iter([f"{kind}: {machine()['text']}."])} | PARTS, dict[str, str]()
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
