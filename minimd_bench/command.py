"""`minimd bench`: its benchmarks and their options. A benchmark is imported only when it runs."""

import argparse
from pathlib import Path
from typing import TYPE_CHECKING, Any

from minimd.commands.runs import at_least_one

if TYPE_CHECKING:
    from minimd_bench.outcome import Outcome

REPEATS, REPEATS_QUICK = 7, 3
PEER_NAMES = "lammps, lammps-checked, lammps-tuned, lammps-shake, lammps-plain, lammps-omp, gromacs, openmm, ase, asap3"
SCENE_NAMES = "melt, cutoff-4, wca, kob-andersen, gas, droplet, slab, npt, chains, chain, decane, dumbbells, triangles"


def add(commands: Any) -> None:
    """Add the command, with all benchmarks and their options, to the subparsers of `minimd`."""
    text = "measure the speed of minimd: compared with other engines, and run time against error"
    parser = commands.add_parser("bench", help=text, description=f"{text[0].upper()}{text[1:]}.")
    benchmarks = parser.add_subparsers(metavar="benchmark", title="benchmarks", required=True)
    peers = _add(benchmarks, "peers", "the same scene in minimd, LAMMPS, OpenMM, ASE and asap3")
    peers.description = (
        "Time whole runs of minimd and of other installed engines, in turns, after a check that all "
        "compute the same energies."
    )
    peers.add_argument(
        "--scene",
        default="melt",
        help=f"{SCENE_NAMES} (default: melt)",
    )
    peers.add_argument(
        "--scenes",
        nargs="*",
        metavar="NAME",
        help="several scenes (default: all) beside LAMMPS with its list checked, in one table (default of --cells: 10, "
        "of --threads: 1)",
    )
    peers.add_argument(
        "--cells", type=counts, metavar="N,...", help="sizes: 4 N³ atoms, or about as many (default: 5,10,20,40)"
    )
    peers.add_argument(
        "--threads",
        type=counts,
        default=(),
        metavar="T,...",
        help="numbers of threads, for engines that can use several (default: 1 and all cores)",
    )
    peers.add_argument(
        "--peers",
        type=words,
        default=(),
        metavar="NAME,...",
        help=f"{PEER_NAMES}, or none (default: all that are installed)",
    )
    errors = _add(benchmarks, "work-precision", "run time against error: every method and time step")
    errors.add_argument(
        "scenes", nargs="*", metavar="SCENE", help="argon, argon-smooth, chains, dumbbells, kepler (default: all)"
    )
    scene = _add(
        benchmarks,
        "scene",
        "the cost of each ingredient of a scene, and a test that an absent ingredient costs nothing",
    )
    scene.add_argument("--cells", type=at_least_one, default=10, metavar="N", help="size: 4 N³ atoms (default: 10)")
    scaling = _add(benchmarks, "scaling", "time and memory against the number of atoms and threads")
    scaling.add_argument("--threads", type=counts, default=(), metavar="T,...", help="default: 1 and all cores")


def _add(benchmarks: Any, name: str, text: str) -> argparse.ArgumentParser:
    """Add one benchmark, with the options that all benchmarks have."""
    parser = benchmarks.add_parser(
        name, help=text, description=text[0].upper() + text[1:] + ".", epilog="Let no other program run meanwhile."
    )
    parser.add_argument("--quick", action="store_true", help="take only a few minutes: fewer sizes, methods and rounds")
    parser.add_argument(
        "--repeats",
        type=at_least_one,
        metavar="R",
        help=f"rounds; every engine runs once in each (default: {REPEATS}, quick {REPEATS_QUICK})",
    )
    files = f"bench_{name.replace('-', '_')}.md, .json and .png"
    parser.add_argument(
        "--out", type=Path, metavar="FOLDER", help=f"write {files} into this folder; older files are replaced"
    )
    parser.set_defaults(command=lambda arguments: bench(name, arguments))
    return parser


def bench(name: str, arguments: argparse.Namespace) -> None:
    """Run a benchmark, print its outcome, and write it with --out.  Raises as the benchmark."""
    from minimd_bench.outcome import markdown, write

    if arguments.out:
        arguments.out.mkdir(parents=True, exist_ok=True)
    outcome = _outcome(name, arguments, arguments.repeats or (REPEATS_QUICK if arguments.quick else REPEATS))
    print(markdown(outcome))
    if arguments.out:
        write(outcome, arguments.out)


def _outcome(name: str, given: argparse.Namespace, repeats: int) -> "Outcome":
    if name == "peers":
        from minimd_bench.engines import PEERS
        from minimd_bench.peers import BESIDE_SCENES, PeersOptions, run_peers
        from minimd_bench.scenes import SCENES

        cells = given.cells or ((5, 10) if given.quick else (5, 10, 20, 40))
        options = PeersOptions((given.scene,), cells, given.threads, given.peers, repeats)
        if given.scenes is not None:
            scenes, cells = tuple(dict.fromkeys(given.scenes or SCENES)), given.cells or (10,)
            peers = given.peers or tuple(name for name in BESIDE_SCENES if {*scenes} & {*PEERS[name].scenes})
            options = options._replace(scenes=scenes, cells=cells, threads=given.threads or (1,), peers=peers)
        return run_peers(options)
    if name == "work-precision":
        from minimd_bench.work_precision import run_work_precision

        return run_work_precision(given.scenes, given.quick, repeats)
    if name == "scene":
        from minimd_bench.ingredients import run_ingredients

        return run_ingredients(given.cells, repeats)
    from minimd_bench.scaling import run_scaling

    return run_scaling(given.threads, given.quick, repeats)


def counts(text: str) -> tuple[int, ...]:
    """Whole numbers, at least 1, separated by commas; repeated ones count once."""
    return tuple(dict.fromkeys(at_least_one(word) for word in words(text)))


def words(text: str) -> tuple[str, ...]:
    """Words separated by commas; repeated ones count once."""
    return tuple(dict.fromkeys(word.strip() for word in text.split(",")))
