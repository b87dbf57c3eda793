"""The house: a package is a floor of docs/architecture.md, imports go down, nothing goes round in a circle."""

import ast
import re
import subprocess
import sys
from functools import cache
from graphlib import CycleError, TopologicalSorter
from pathlib import Path

import pytest
from references import liquid
from scenes import LJ, Scene

import minimd

REPOSITORY = Path(__file__).parents[2]
PACKAGE = REPOSITORY / "minimd"
INSTALLED = Path(minimd.__file__).parent  # or the same folder
PAGE = (REPOSITORY / "docs" / "architecture.md").read_text(encoding="utf-8")
BEGIN_WITH = dict(re.findall(r"^\| `([\w/]+)` \| .* \| `([\w/.]+)` \|$", PAGE, re.M))
TOP = {"minimd"}
FLOORS = [name if name in TOP else f"minimd.{name.replace('/', '.')}" for name in BEGIN_WITH]
CORE = {f"core/{place.parent.name}" for place in (PACKAGE / "core").glob("*/__init__.py")}
STRANGERS = {"minimd.core.integrators", "minimd.core.potentials"}  # never import each other
BRIDGES = {  # folders and modules that may import ase or MDAnalysis when they are imported
    *("ase", "mdanalysis", "core/structure/ase_atoms.py", "core/structure/mdanalysis_atoms.py"),
    *("core/files/structure_file.py", "core/files/turned_cell.py", "judge/dynamics.py", "judge/scenes.py"),
}
FOREIGN = {"minimd.bench.engines"}  # reaches for private names of OpenMM and LAMMPS
HEAVY = {"ase", "MDAnalysis", "matplotlib", "h5py", "pydantic", "tqdm", "pandas", "IPython", "openmm", "minimd.lammps"}
FILES = re.compile(r"A step of a liquid is these (\d+) files, ([\d ]+) lines in all:\n\n```\n(.*?)```", re.S)
MODULES = {path.relative_to(REPOSITORY): path for name in TOP for path in (REPOSITORY / name).rglob("*.py")}
MODULES = {".".join(place.with_suffix("").parts).removesuffix(".__init__"): path for place, path in MODULES.items()}


@cache
def nodes_of(path):
    return [*ast.walk(ast.parse(path.read_text()))]


def imports(path, when_imported=False):
    """Modules a file imports, lazily and for type checkers too; with when_imported only what its own import loads."""
    nodes = nodes_of(path)
    for node in nodes[0].body if when_imported else nodes:
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            names = (f"{node.module}.{alias.name}" for alias in node.names)
            yield from (name if name in MODULES else node.module for name in names)


def floor_of(module):
    return max((floor for floor in FLOORS if f"{module}.".startswith(f"{floor}.")), key=len)


def test_every_package_is_a_floor():
    assert (
        set(BEGIN_WITH)
        == {place.parent.name for place in PACKAGE.glob("*/__init__.py") if place.parent.name != "core"} | TOP | CORE
    )
    for name, file in BEGIN_WITH.items():
        folder = REPOSITORY / name if name in TOP else PACKAGE / name
        assert (folder / file).exists()


def test_no_module_reaches_for_the_private_name_of_another():
    reached = []
    for module, path in MODULES.items():
        nodes = nodes_of(path)
        attributes = [node for node in nodes if isinstance(node, ast.Attribute)]
        own = {"_asdict", "_replace", "_fields", "_make"}
        own |= {node.name for node in nodes if isinstance(node, ast.FunctionDef | ast.ClassDef)}
        own |= {node.attr for node in attributes if isinstance(node.ctx, ast.Store)}
        own |= {ast.unparse(node.target) for node in nodes if isinstance(node, ast.AnnAssign)}
        for node in nodes:
            if isinstance(node, ast.ImportFrom) and (node.module or "").startswith("minimd"):
                reached += [f"{module}: {alias.name}" for alias in node.names if re.match(r"_[^_]", alias.name)]
        for node in attributes:
            owner = node.value.id if isinstance(node.value, ast.Name) else ""
            is_foreign = owner not in ("self", "cls", "sys", "os") and module not in FOREIGN
            if re.match(r"_[^_]", node.attr) and node.attr not in own and is_foreign:
                reached.append(f"{module}: {ast.unparse(node)}")
    assert reached == []


def test_only_the_bridges_import_ase_and_mdanalysis():
    for path in PACKAGE.rglob("*.py"):
        place = path.relative_to(PACKAGE)
        if not BRIDGES & {place.as_posix(), place.parts[0]}:
            roots = {module.split(".")[0] for module in imports(path, when_imported=True)}
            assert not roots & {"ase", "MDAnalysis"}, path


def test_nobody_assigns_to_a_name_of_a_lower_floor():
    """Neither to an attribute of what is imported from there nor by appending to a list of it."""
    reached = []
    for module, path in MODULES.items():
        nodes = nodes_of(path)
        imported = {
            alias.asname or alias.name: node.module
            for node in nodes
            if isinstance(node, ast.ImportFrom) and (node.module or "").split(".")[0] in TOP
            for alias in node.names
            if floor_of(node.module) != floor_of(module)
        }
        for node in nodes:
            is_set = isinstance(node, ast.Attribute) and isinstance(node.ctx, ast.Store | ast.Del)
            is_changed = isinstance(node, ast.Attribute) and node.attr in ("append", "extend", "insert", "update")
            if (is_set or is_changed) and isinstance(node.value, ast.Name) and node.value.id in imported:
                reached.append(f"{module}: {ast.unparse(node)}")
    assert reached == []


def test_imports_go_down_the_floors_and_not_in_circles():
    """Lazy and TYPE_CHECKING imports count; nobody is exempt."""
    imported = {module: {*imports(path)} for module, path in MODULES.items()}
    for module, others in imported.items():
        for other in others:
            if other.split(".")[0] in TOP and (here := floor_of(module)) != (there := floor_of(other)):
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


@pytest.fixture(scope="module")
def steady_steps():
    """Chains of minimd's functions, from Simulation.run to the steps and below, without a list build."""
    sim = Scene(liquid(6), [LJ], timestep=0.001).simulation(threads=1, skin=0.6)
    sim.run(4, every=4, progress=False)  # compiles, which would take long under a profiler
    n_builds, stack, chains = sim.engine.interactions.n_builds, [], []

    def profile(frame, event, _argument):
        if event == "call":
            stack.append((Path(frame.f_code.co_filename), frame.f_code.co_name))
            chains.append([one for one in stack if one[0].is_relative_to(INSTALLED)])
        elif event == "return" and stack:
            stack.pop()

    sys.setprofile(profile)
    try:
        sim.run(4, every=4, progress=False)
    finally:
        sys.setprofile(None)
    assert sim.engine.interactions.n_builds == n_builds
    of_steps = [chain for chain in chains if ("steps.py", "advance") in [(file.name, name) for file, name in chain]]
    return [chain[[name for _, name in chain].index("run") :] for chain in of_steps]


def test_the_page_lists_the_files_of_a_step_and_counts_their_lines(steady_steps):
    n_files, n_lines, table = FILES.search(PAGE).groups()
    files = re.findall(r"^(minimd/\S+\.py)", table, re.M)
    visited = {f"minimd/{chain[-1][0].relative_to(INSTALLED).as_posix()}" for chain in steady_steps}
    assert visited
    assert visited <= set(files), visited - set(files)
    assert len(files) == int(n_files)
    counted = sum((REPOSITORY / file).read_text(encoding="utf-8").count("\n") for file in files)
    assert counted == int(n_lines.replace(" ", ""))
