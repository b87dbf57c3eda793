"""`minimd bench`: its benchmarks and their options. A benchmark is imported only when it runs."""

from argparse import Namespace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

from minimd.commands.table import Argument, Command, at_least_one, flag, written_to

if TYPE_CHECKING:
    from minimd.bench.outcome import Outcome

REPEATS = 7
REPEATS_QUICK = 3
PEER_NAMES = (
    "lammps, lammps-checked, lammps-tuned, lammps-shake, lammps-plain, lammps-omp, gromacs, gromacs-safe, openmm, "
    "openmm-pme, ase, asap3"
)
SCENE_NAMES = (
    "melt, cutoff-4, wca, kob-andersen, gas, droplet, slab, npt, chains, chain, decane, dumbbells, triangles, copper, "
    "water, water-fine"
)
QUICK = flag("--quick", "take only a few minutes: fewer sizes, methods and rounds")


def benchmark(name: str, text: str, *arguments: Argument, description: str = "") -> Command:
    """One benchmark, with the options that all benchmarks have."""
    rounds = f"rounds; every engine runs once in each (default: {REPEATS}, quick {REPEATS_QUICK})"
    files = f"write bench_{name.replace('-', '_')}.md, .json and .png into this folder; older files are replaced"
    return Command(
        name,
        text,
        description or f"{text[0].upper()}{text[1:]}.",
        (
            QUICK,
            Argument("--repeats", rounds, at_least_one, "R"),
            written_to("FOLDER", files),
            *arguments,
        ),
        partial(bench, name),
        epilog="Let no other program run meanwhile.",
    )


def bench(name: str, arguments: Namespace) -> None:
    """Run a benchmark, print its outcome, and write it with --out.
    Raises as the benchmark."""
    from minimd.bench.outcome import markdown, write

    if arguments.history:
        arguments.refuse("--history measures its own scenes: leave out the benchmark")
    if arguments.out:
        arguments.out.mkdir(parents=True, exist_ok=True)
    default = REPEATS_QUICK if arguments.quick else REPEATS
    outcome = _outcome(name, arguments, arguments.repeats or default)
    print(markdown(outcome))
    if arguments.out:
        write(outcome, arguments.out)


def history(arguments: Namespace) -> None:
    """Measure minimd, add a line to a table of speeds, and print the table.
    Raises as add_line."""
    from minimd.bench.history import add_line

    if arguments.history is None:
        arguments.refuse("name a benchmark, or --history FILE")
    print("\n".join(add_line(arguments.history)))


def _outcome(name: str, arguments: Namespace, repeats: int) -> "Outcome":
    quick = arguments.quick
    if name == "work-precision":
        from minimd.bench.work_precision import run_work_precision

        return run_work_precision(arguments.scenes, quick, repeats)

    if name == "scene":
        from minimd.bench.ingredients import run_ingredients

        return run_ingredients(arguments.cells, repeats)

    if name == "scaling":
        from minimd.bench.scaling import run_scaling

        return run_scaling(arguments.threads, quick, repeats)

    from minimd.bench.peers import BESIDE_SCENES, PeersOptions, run_peers
    from minimd.bench.scenes import SCENES

    scenes = (arguments.scene,)
    cells: tuple[int, ...] = (5, 10) if quick else (5, 10, 20, 40)
    threads = arguments.threads
    offered: tuple[str, ...] = ()
    if arguments.scenes is not None:
        scenes = tuple(dict.fromkeys(arguments.scenes or SCENES))
        cells = (10,)
        threads = threads or (1,)
        offered = BESIDE_SCENES

    cells = arguments.cells or cells
    return run_peers(PeersOptions(scenes, cells, threads, arguments.peers, repeats, offered))


def counts(text: str) -> tuple[int, ...]:
    """Whole numbers, at least 1, separated by commas; repeated ones count once."""
    return tuple(dict.fromkeys(at_least_one(word) for word in words(text)))


def words(text: str) -> tuple[str, ...]:
    """Words separated by commas; repeated ones count once."""
    return tuple(dict.fromkeys(word.strip() for word in text.split(",")))


SEVERAL = {"nargs": "*"}
COMMAND = Command("bench", "measure the speed of minimd: compared with other engines, and run time against error",
                  "Measure the speed of minimd: compared with other engines, and run time against error.", (
        Argument("--history", "measure four scenes in minimd alone, in two minutes; add a line with commit, date, "
                 "processor and speeds to this table (CSV), and print it", Path, "FILE"),
    ), history, (
    benchmark("peers", "the same scene in minimd, LAMMPS, GROMACS, OpenMM, ASE and asap3",
        Argument("--scene", f"{SCENE_NAMES} (default: melt)", more={"default": "melt"}),
        Argument("--scenes", "several scenes (default: all) beside LAMMPS with its list checked, melt and water beside "
                 "GROMACS, water beside OpenMM, in one table (default of --cells: 10, of --threads: 1)", None, "NAME",
                 SEVERAL),
        Argument("--cells", "sizes: 4 N³ atoms, or about as many; water: 3 N³ (default: 5,10,20,40)", counts, "N,..."),
        Argument("--threads", "numbers of threads, for engines that can use several (default: 1 and all cores)", counts,
                 "T,...", {"default": ()}),
        Argument("--peers", f"{PEER_NAMES}, or none (default: all that are installed)", words, "NAME,...",
                 {"default": ()}),
        description="Time whole runs of minimd and of other installed engines, in turns, after a check that all "
                    "compute the same energies."),
    benchmark("work-precision", "run time against error: every method and time step",
        Argument("scenes", "argon, argon-smooth, chains, dumbbells, kepler (default: all)", None, "SCENE", SEVERAL)),
    benchmark("scene", "the cost of each ingredient of a scene, and a test that an absent ingredient costs nothing",
        Argument("--cells", "size: 4 N³ atoms (default: 10)", at_least_one, "N", {"default": 10})),
    benchmark("scaling", "time and memory against the number of atoms and threads",
        Argument("--threads", "default: 1 and all cores", counts, "T,...", {"default": ()})),
))  # fmt: skip
