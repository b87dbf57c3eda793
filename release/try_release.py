"""Builds sdist and wheel, and tries the wheel in empty environments: what is to be seen before a release is published.

    python release/try_release.py                 every Python of the classifiers that is found
    python release/try_release.py PYTHON ...      these Pythons, by their paths

Of the last commit: sdist, then wheel from sdist, in `dist/`; the version is that of `CITATION.cff`, `CHANGELOG.md` and
`recipe.yaml`. For each Python, in environments of their own: the first command of the README, with the wheel in place
of the source tree, and each extra alone; after each `pip check`. The last lines are a table; the exit code is 1 if a
row of it failed."""

import os
import re
import shutil
import subprocess
import sys
import tempfile
import tomllib
from hashlib import sha256
from pathlib import Path
from time import monotonic

ROOT = Path(__file__).parents[1]
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
VERSIONS = re.findall(r":: (3\.\d+)$", "\n".join(PROJECT["classifiers"]), re.M)
BIN = "Scripts" if os.name == "nt" else "bin"


def found_pythons() -> dict[str, str]:
    """The Pythons on the path, or of pyenv, by version."""
    found = {}
    for version in VERSIONS:
        places = [*Path.home().glob(f".pyenv/versions/{version}.*/bin/python"), shutil.which(f"python{version}")]
        for place in filter(None, places):
            answer = subprocess.run([place, "-c", "print('here')"], capture_output=True, text=True, check=False)
            if answer.stdout == "here\n":
                found[version] = str(place)
                break
    return found


def disagreements(version: str) -> list[str]:
    """Files that state another version, or in the recipe other dependencies, than the package."""
    recipe = (ROOT / "release" / "recipe.yaml").read_text(encoding="utf-8")
    stated = {"CITATION.cff": f"\nversion: {version}\n", "CHANGELOG.md": f"\n## {version} ("}
    found = [name for name, words in stated.items() if words not in (ROOT / name).read_text(encoding="utf-8")]
    needed = [
        one.lower().replace("matplotlib", "matplotlib-base").replace(">=", " >=") for one in PROJECT["dependencies"]
    ]
    wanted = [f'version: "{version}"', *(f"    - {one}\n" for one in needed)]
    return found + [f"release/recipe.yaml, {words.strip()}" for words in wanted if words not in recipe]


def build(python: str, folder: Path) -> tuple[Path, Path]:
    """sdist and wheel of the last commit, built from a copy without anything else."""
    archive = subprocess.run(["git", "archive", "HEAD"], cwd=ROOT, capture_output=True, check=True).stdout
    (source := folder / "source").mkdir()
    subprocess.run(["tar", "-xf", "-", "-C", source], input=archive, check=True)
    subprocess.run([python, "-m", "venv", folder / "builder"], check=True)
    own = folder / "builder" / BIN / "python"
    subprocess.run([own, "-m", "pip", "install", "--quiet", "build"], check=True)
    shutil.rmtree(ROOT / "dist", ignore_errors=True)
    subprocess.run([own, "-m", "build", "--outdir", ROOT / "dist", source], check=True, stdout=subprocess.DEVNULL)
    (sdist,), (wheel,) = (ROOT / "dist").glob("*.tar.gz"), (ROOT / "dist").glob("*.whl")
    return sdist, wheel


def tried(command: str, folder: Path) -> tuple[str, str]:
    """Run a command in a folder; "ok" or "FAILED" with its time, and its last line if it failed."""
    begun, own = monotonic(), {"NUMBA_CACHE_DIR": str(folder / ".numba"), "MPLBACKEND": "Agg"}
    environment = {name: value for name, value in os.environ.items() if name != "PYTHONPATH"} | own
    done = subprocess.run(command, shell=True, cwd=folder, env=environment, capture_output=True, text=True, check=False)
    lines = [line for line in (done.stdout + done.stderr).splitlines() if line.strip()]
    error = next((line for line in lines if line.startswith("ERROR")), lines[-1] if lines else "")
    return f"{'FAILED' if done.returncode else 'ok'}, {monotonic() - begun:.0f} s", error if done.returncode else ""


def main(pythons: dict[str, str]) -> int:
    """Build, try with each Python, print the table; 1 if a row failed."""
    missing = [version for version in VERSIONS if not any(version in python for python in pythons)]
    print(f"Pythons: {', '.join(pythons)}; not tried: {', '.join(missing) or 'none'}", flush=True)
    first = re.search(
        r"^python3 -m venv .*pip install \. && .*$", (ROOT / "README.md").read_text(encoding="utf-8"), re.M
    )[0]
    with tempfile.TemporaryDirectory() as temporary:
        sdist, wheel = build(next(iter(pythons.values())), Path(temporary))
        print(f"built {sdist.name} (sha256 {sha256(sdist.read_bytes()).hexdigest()}) and {wheel.name}", flush=True)
        rows = [f"| | {where} | FAILED | |" for where in disagreements(wheel.name.split("-")[1])]
        for version, python in pythons.items():
            start, check = f"{python} -m venv .venv", f".venv/{BIN}/pip check"
            install = first.replace("python3 -m venv .venv", start).replace(" . ", f" {wheel} ")
            commands = {"README": f"{install} && {check}"}
            for extra in PROJECT["optional-dependencies"]:
                install = f".venv/{BIN}/pip install --no-compile '{PROJECT['name']}[{extra}] @ {wheel.as_uri()}'"
                commands[extra] = f"{start} && {install} && {check}"
            for name, command in commands.items():
                with tempfile.TemporaryDirectory() as folder:
                    shutil.copytree(ROOT / "examples", Path(folder, "examples"))
                    rows.append(f"| {version} | {name} | {' | '.join(tried(command, Path(folder)))} |")
                    print(rows[-1], flush=True)
    print("| Python | what | result | why |", "| --- | --- | --- | --- |", *rows, sep="\n")
    return int(any("FAILED" in row for row in rows))


if __name__ == "__main__":
    raise SystemExit(main({path: path for path in sys.argv[1:]} or found_pythons()))
