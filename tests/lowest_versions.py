"""The suite with the lowest versions that pyproject.toml allows, in an environment of its own, made for this.

    python tests/lowest_versions.py                 makes the environment, installs minimd in it, runs the fast suite
    python tests/lowest_versions.py FOLDER [...]    keeps the environment in a folder; what follows is for pytest

To be run before a release. Exit code: that of pytest, or of pip."""

import os
import re
import subprocess
import sys
import tempfile
import tomllib
import venv
from pathlib import Path

ROOT = Path(__file__).parents[1]
BOUND = re.compile(r"^([\w-]+)>=([\d.]+)")


def lowest() -> list[str]:
    """Each dependency of the package and of its tests, at its lower bound."""
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    named = [*project["dependencies"], *project["optional-dependencies"]["test"]]
    return [f"{found[1]}=={found[2]}" for one in named if (found := BOUND.match(one))]


def main(folder: str | None = None, *arguments: str) -> int:
    with tempfile.TemporaryDirectory() as temporary:
        place = Path(folder or temporary).absolute()
        python = place / ("Scripts" if os.name == "nt" else "bin") / "python"
        if not python.exists():
            venv.create(place, with_pip=True)
        print(*lowest())
        install = subprocess.run([python, "-m", "pip", "install", "--quiet", *lowest(), f"{ROOT}[test]"], check=False)
        if install.returncode:
            return install.returncode
        return subprocess.run([python, "-m", "pytest", "-q", *arguments], cwd=ROOT, check=False).returncode


if __name__ == "__main__":
    raise SystemExit(main(*sys.argv[1:]))
