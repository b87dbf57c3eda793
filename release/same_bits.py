"""Fixed-point runs have the same bits with all vectors of this processor, and on 64-bit ARM: the scenes of
tests/exact_scenes.py.

    python release/same_bits.py                       twelve scenes, 100 steps; hashes also those of tests/data
    python release/same_bits.py melt "rigid water"    these scenes
    python release/same_bits.py --steps 100000        hashes also those of tests/data if that has them of as many steps
    python release/same_bits.py --steps 100000 --write    puts them there
    python release/same_bits.py --arm FOLDER          also on ARM, emulated: minutes for each scene

Each scene has a process for each set of vectors. A line shows the beginnings of both hashes: of the motion, and of
energies and pressures. FOLDER gets a small Debian for ARM and Python's packages in the versions that are installed
here. This needs root, debootstrap and qemu-user-static; a folder that has them already needs qemu-user-static alone."""

import argparse
import os
import platform
import subprocess
import sys
from importlib import metadata
from pathlib import Path
from time import perf_counter
from typing import NamedTuple

import llvmlite.binding as llvm

ROOT = Path(__file__).parents[1]
TESTS = ROOT / "tests"
KEPT = TESTS / "data" / "fixed_point_hashes.txt"
KEPT_LONG = TESTS / "data" / "fixed_point_hashes_long.txt"  # the first line says of how many steps
STEPS_OF_KEPT = 100
FEATURES = {"avx512": "avx512f", "avx2": "avx2", "sse-exact": "sse2"}  # of processors that have these vectors
COMPILED = ("numpy", "scipy", "llvmlite", "numba")  # packages that are not pure Python
SUITE, PYTHON = "bookworm", "3.11"  # a Debian and its Python


class Machine(NamedTuple):
    """What runs a scene.  python : its command.  environment : variables."""

    python: list[str]
    environment: dict[str, str]


def machines_here() -> dict[str, Machine]:
    """This processor, with each set of vectors that it has."""
    environment = os.environ | {"PYTHONPATH": str(ROOT)}
    features = llvm.get_host_cpu_features()
    names = [name for name, feature in FEATURES.items() if features.get(feature)]
    if not names:
        return {platform.machine(): Machine([sys.executable], environment)}
    return {name: Machine([sys.executable], environment | {"MINIMD_VECTORS": name}) for name in names}


def emulated_arm(folder: Path) -> Machine:
    """64-bit ARM, emulated; what it needs is put into a folder if it is not there."""
    root, site = folder / "root", folder / "site"
    if not site.exists():
        make_root(root)
        platforms = [f"--platform=manylinux_2_{n}_aarch64" for n in (17, 27, 28)]
        versions = [f"{name}=={metadata.version(name)}" for name in COMPILED]
        options = ["-q", "--no-deps", "--only-binary=:all:", f"--python-version={PYTHON}", *platforms]
        pip_install = [sys.executable, "-m", "pip", "install", "--target", site]
        subprocess.run([*pip_install, *options, *versions], check=True)
    paths = {"PYTHONPATH": f"{site}:{ROOT}", "NUMBA_CACHE_DIR": str(folder / "cache")}
    return Machine(["qemu-aarch64-static", "-L", str(root), f"{root}/usr/bin/python{PYTHON}"], paths)


def make_root(root: Path) -> None:
    """Unpack a Debian for ARM; nothing in it is configured."""
    options = ["--arch=arm64", "--foreign", "--variant=minbase", "--include=python3"]
    subprocess.run(["debootstrap", *options, SUITE, root], check=True)
    for package in sorted(root.glob("var/cache/apt/archives/*.deb")):
        subprocess.run(["dpkg", "-x", package, root], check=True)


def hash_of(scene: str, n_steps: int, machine: Machine) -> str:
    """Both digests of a run in another process."""
    command = [*machine.python, "-W", "ignore", str(TESTS / "exact_scenes.py"), str(n_steps), scene]
    answer = subprocess.run(command, env=machine.environment, capture_output=True, text=True, check=False)
    if answer.returncode != 0:
        raise SystemExit(f"\n{answer.stderr}\nexit code {answer.returncode}")
    return answer.stdout[:33]


def kept_hashes(n_steps: int) -> dict[str, str]:
    """Hashes by scene that tests/data has of as many steps."""
    if n_steps == STEPS_OF_KEPT:
        lines = KEPT.read_text(encoding="utf-8").splitlines()
    else:
        steps, *lines = KEPT_LONG.read_text(encoding="utf-8").splitlines() if KEPT_LONG.exists() else [""]
        if steps != f"{n_steps} steps":
            return {}
    return {line[35:]: line[:33] for line in lines}


def row(scene: str, n_steps: int, machines: dict[str, Machine], kept: str) -> set[str]:
    """The hashes of a scene, different ones only, printed in a line with the seconds of each process."""
    hashes, seconds = [kept], []
    print(f"{scene:32}{shortened(kept)}", end="", flush=True)
    for machine in machines.values():
        start = perf_counter()
        hashes.append(hash_of(scene, n_steps, machine))
        seconds.append(f"{perf_counter() - start:.0f}")
        print(shortened(hashes[-1]), end="", flush=True)
    print(*seconds, flush=True)
    return {*hashes} - {""}


def shortened(digests: str) -> str:
    """The first half of both digests, for a column of a table."""
    return f"{' '.join(digest[:8] for digest in digests.split()) or '-':19}"


def main(arguments: argparse.Namespace) -> None:
    """A line for each scene, and what is to be said of all."""
    n_steps, kept, machines = arguments.steps, kept_hashes(arguments.steps), machines_here()
    if arguments.arm:
        machines["arm"] = emulated_arm(arguments.arm.absolute())
    print(f"{'scene':32}" + "".join(f"{column:19}" for column in ("tests/data", *machines)) + "seconds")
    scenes = arguments.scenes or kept_hashes(STEPS_OF_KEPT)
    hashes = {scene: row(scene, n_steps, machines, kept.get(scene, "")) for scene in scenes}
    differing = [scene for scene, different in hashes.items() if len(different) > 1]
    if differing:
        raise SystemExit(f"THE HASHES DIFFER of {', '.join(differing)}")
    print(f"all hashes are equal, of {len(hashes)} scenes after {n_steps} steps")
    if arguments.write:
        kept |= {scene: digests for scene, (digests,) in hashes.items()}
        lines = [f"{kept[scene]}  {scene}" for scene in kept_hashes(STEPS_OF_KEPT) if scene in kept]
        KEPT_LONG.write_text("\n".join([f"{n_steps} steps", *lines, ""]), encoding="utf-8")


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("scenes", nargs="*", metavar="SCENE")
    parser.add_argument("--steps", type=int, default=STEPS_OF_KEPT)
    parser.add_argument("--write", action="store_true")
    parser.add_argument("--arm", type=Path, metavar="FOLDER")
    arguments = parser.parse_args()
    if arguments.write and arguments.steps == STEPS_OF_KEPT:
        parser.error(f"--write is for other numbers of steps than {STEPS_OF_KEPT}")
    main(arguments)
