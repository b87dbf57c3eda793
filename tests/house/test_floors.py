"""The house: a package is a floor of docs/architecture.md, imports go down, nothing goes round in a circle."""

import ast
import re
import subprocess
import sys
from graphlib import CycleError, TopologicalSorter
from pathlib import Path

import pytest
from references import liquid
from scenes import LJ, Scene

REPOSITORY = Path(__file__).parents[2]
PACKAGE = REPOSITORY / "minimd"
PAGE = (REPOSITORY / "docs" / "architecture.md").read_text(encoding="utf-8")
BEGIN_WITH = dict(re.findall(r"^\| `(\w+)` \| .* \| `([\w/.]+)` \|$", PAGE, re.M))
FLOORS = ["minimd" if name == "minimd" else f"minimd.{name}" for name in BEGIN_WITH]
STRANGERS = {"minimd.integrators", "minimd.potentials"}  # never import each other
HEAVY = {"ase", "MDAnalysis", "matplotlib", "h5py", "pydantic", "tqdm", "pandas", "IPython", "minimd.lammps"}


def name_of(path):
    return ".".join(path.relative_to(REPOSITORY).with_suffix("").parts).removesuffix(".__init__")


MODULES = {name_of(path): path for path in PACKAGE.rglob("*.py")}


def imports(path):
    """Modules a file imports, lazily and for type checkers too."""
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            names = (f"{node.module}.{alias.name}" for alias in node.names)
            yield from (name if name in MODULES else node.module for name in names)


def floor_of(module):
    return max((floor for floor in FLOORS if f"{module}.".startswith(f"{floor}.")), key=len)


def test_every_package_is_a_floor():
    packages = {place.parent.name for place in PACKAGE.glob("*/__init__.py")}
    assert set(BEGIN_WITH) == packages | {"minimd", "replay"}
    for name, file in BEGIN_WITH.items():
        assert (PACKAGE / ("" if name in ("minimd", "replay") else name) / file).exists()


def test_imports_go_down_the_floors_and_not_in_circles():
    """Lazy and TYPE_CHECKING imports count; nobody is exempt."""
    imported = {module: {*imports(path)} for module, path in MODULES.items()}
    for module, others in imported.items():
        for other in others:
            if other.split(".")[0] == "minimd" and (here := floor_of(module)) != (there := floor_of(other)):
                assert FLOORS.index(there) > FLOORS.index(here), f"{module} -> {other}"
                assert {here, there} != STRANGERS, f"{module} -> {other}"
    try:
        TopologicalSorter({one: others & MODULES.keys() - {one} for one, others in imported.items()}).prepare()
    except CycleError as circle:
        pytest.fail(f"a circle of imports: {' -> '.join(circle.args[1])}")


def test_importing_minimd_loads_no_bridge_and_compiles_nothing():
    code = f"""
import sys
from numba.core import event
with event.install_recorder("numba:compile") as recorder:
    import minimd
assert not {HEAVY} & set(sys.modules), {HEAVY} & set(sys.modules)
assert not recorder.buffer, len(recorder.buffer)
"""
    answer = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert answer.returncode == 0, answer.stderr


FILES = re.compile(r"A step of a liquid is these (\d+) files, ([\d ]+) lines in all:\n\n```\n(.*?)```", re.S)


@pytest.fixture(scope="module")
def steady_steps():
    """Chains of minimd's functions, from Simulation.run on, that a few steps without a list build go through."""
    sim = Scene(liquid(6), [LJ], timestep=0.001).simulation(threads=1, skin=0.6)
    sim.run(4, every=4, progress=False)  # compiles, which would take long under a profiler
    n_builds, stack, chains = sim.engine.interactions.n_builds, [], []

    def profile(frame, event, _argument):
        if event == "call":
            stack.append((Path(frame.f_code.co_filename), frame.f_code.co_name))
            chains.append([one for one in stack if one[0].is_relative_to(PACKAGE)])
        elif event == "return" and stack:
            stack.pop()

    sys.setprofile(profile)
    try:
        sim.run(4, every=4, progress=False)
    finally:
        sys.setprofile(None)
    assert sim.engine.interactions.n_builds == n_builds
    named = [(chain, [name for _, name in chain]) for chain in chains]
    return [chain[names.index("run") :] for chain, names in named if "advance" in names]


def test_the_page_lists_the_files_of_a_step_and_counts_their_lines(steady_steps):
    n_files, n_lines, table = FILES.search(PAGE).groups()
    files = re.findall(r"^(minimd/\S+\.py)", table, re.M)
    visited = {chain[-1][0].relative_to(REPOSITORY).as_posix() for chain in steady_steps}
    assert visited
    assert visited <= set(files), visited - set(files)
    assert len(files) == int(n_files)
    counted = sum((REPOSITORY / file).read_text(encoding="utf-8").count("\n") for file in files)
    assert counted == int(n_lines.replace(" ", ""))
