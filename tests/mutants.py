"""What the suite catches: changes of one token each, made in a copy, and the test that finds each of them.

    python tests/mutants.py                 all of them; prints a line for each, and the share that was caught
    python tests/mutants.py 3 17 40-50      those with these numbers
    python tests/mutants.py neighbors       those in files whose names contain this

A mutant is caught if a test fails. Each runs the tests that its heading names first, and then, if these pass, all
others that are not slow. Mutants that change what kernels compute are compiled anew, which is most of the time: half a
minute each. Exit code: 0 if 95 % were caught."""

import os
import re
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path
from time import perf_counter
from typing import NamedTuple

ROOT = Path(__file__).parents[1]
WANTED = 0.95  # the share that must be caught
MUTANTS = ROOT / "tests" / "data" / "mutants.txt"


class Mutant(NamedTuple):
    """One token of a file, and what stands there instead."""

    file: str
    old: str
    new: str
    first: list[str]


def listed() -> list[Mutant]:
    """All mutants, in the order of the table, whose first line says how it is written."""
    mutants, file, first = [], "", [""]
    for line in MUTANTS.read_text(encoding="utf-8").splitlines()[1:]:
        if line.startswith(" "):
            old, _, new = line.strip().partition(" =>")
            mutants.append(Mutant(file, old, new.strip(), first))
        else:
            file, _, names = line.partition(": ")
            first = names.split()
    return mutants


def main(chosen: list[str]) -> int:
    """Try the mutants that were chosen; see above."""
    mutants, missed = listed(), []
    numbers = [k for k, one in enumerate(mutants) if any(_is_meant(word, k, one.file) for word in chosen or [""])]
    with tempfile.TemporaryDirectory() as cache:  # of kernels; what a mutant compiles anew is deleted behind it
        subprocess.run([sys.executable, "-c", "import minimd"], env=environment(ROOT, Path(cache)), check=True)
        for k in numbers:
            start, mutant = perf_counter(), mutants[k]
            caught_by = tried(mutant, Path(cache))
            missed += [] if caught_by else [k]
            change = f"{mutant.old[:40]} => {mutant.new[:40]}"
            seconds = f"{perf_counter() - start:.0f} s"
            print(f"{k:3d}  {mutant.file}  {change}: {caught_by or 'NOT CAUGHT'} ({seconds})", flush=True)
    share = 1.0 - len(missed) / max(1, len(numbers))
    print(f"{len(numbers) - len(missed)} of {len(numbers)} caught, {share:.0%}; not caught: {missed or 'none'}")
    return int(share < WANTED)


def _is_meant(one: str, k: int, file: str) -> bool:
    numbers = re.fullmatch(r"(\d+)(?:-(\d+))?", one)
    return int(numbers[1]) <= k <= int(numbers[2] or numbers[1]) if numbers else one in file


def tried(mutant: Mutant, cache: Path) -> str:
    """The test that fails if `old` is `new` in a file; empty if none does."""
    with tempfile.TemporaryDirectory() as folder:
        copy, kept = Path(folder) / "copy", {*cache.iterdir()}
        ignored = shutil.ignore_patterns(".git", ".venv", ".nox", "__pycache__", "site", "*_cache")
        shutil.copytree(ROOT, copy, symlinks=True, ignore=ignored)
        source = copy / "minimd" / mutant.file
        text = source.read_text()
        if (n := text.count(mutant.old)) != 1:
            raise SystemExit(f"a mutant must change one place; {mutant.old!r} stands {n} times there")
        source.write_text(text.replace(mutant.old, mutant.new))
        tests = [str(copy / "tests" / f"{name}.py") for name in mutant.first]
        caught_by = failed(copy, tests, cache) or failed(copy, ["tests"], cache)
        for made in {*cache.iterdir()} - kept:
            shutil.rmtree(made)
        return caught_by


def environment(root: Path, cache: Path) -> dict[str, str]:
    """For processes that import the minimd in a folder."""
    own = {"PYTHONPATH": str(root), "NUMBA_CACHE_DIR": str(cache), "MINIMD_ALL_CASES": "yes"}
    return os.environ | {**own, "OPENBLAS_NUM_THREADS": "1"}


def failed(copy: Path, tests: list[str], cache: Path) -> str:
    """The first test that fails among some tests of a copy; empty if all pass."""
    command = [sys.executable, "-m", "pytest", "-x", "-q", "--no-header", "-p", "no:cacheprovider", "--tb=no", "-rfE"]
    where = {"cwd": copy, "env": environment(copy, cache)}
    answer = subprocess.run([*command, *tests], **where, capture_output=True, text=True, check=False)
    found = re.findall(r"^(?:FAILED|ERROR) (.*?)(?: - .*)?$", answer.stdout, re.M)
    return "" if answer.returncode == 0 else found[0] if found else f"exit code {answer.returncode}"


if __name__ == "__main__":
    raise SystemExit(main(sys.argv[1:]))
