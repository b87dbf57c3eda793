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
    *("core/structure/elements.py", "core/files/structure_file.py", "core/files/ase_writer.py"),
    *("core/files/turned_cell.py", "judge/dynamics.py", "judge/scenes.py"),
}
# reach for private names of OpenMM and LAMMPS; for the topology of MDAnalysis, which alone tells what was guessed;
# for what Numba knows of a function, and for flags that were set
FOREIGN = {
    "minimd.bench.engines",
    "minimd.core.structure.mdanalysis_atoms",
    "minimd.core.compiled.typing_memory",
}
HEAVY = {"ase", "MDAnalysis", "matplotlib", "h5py", "pydantic", "tqdm", "pandas", "IPython", "openmm", "minimd.lammps"}
FILES = re.compile(r"A step of a liquid is these files:\n\n```\n(.*?)```", re.S)
RINGS = ["compiled console structure neighbors potentials constraints integrators forces", "engine"]
RINGS += ["simulation files minimization diagnosis"]
PICTURE = re.search(r"  the tower +(.*?)   .*?  the ground +(.*?)       none", PAGE, re.S)
TOWER, GROUND = (re.findall(r"\w+", floor) for floor in PICTURE.groups())  # annexes on the ground do not use another
BY_NAME = {"observers by kind", "potentials of a scene"}  # what the core asks of annexes
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
            assert node.level == 0, f"{path}: imports are absolute"
            names = (f"{node.module}.{alias.name}" for alias in node.names)
            yield from (name if name in MODULES else node.module for name in names)


def floor_of(module):
    """Of a package that is in no row of docs/architecture.md it is the face."""
    return max((floor for floor in FLOORS if f"{module}.".startswith(f"{floor}.")), key=len)


def test_every_package_is_a_floor_in_table_and_picture_of_the_architecture():
    annexes = {place.parent.name for place in PACKAGE.glob("*/__init__.py") if place.parent.name != "core"}
    assert set(BEGIN_WITH) == annexes | TOP | CORE, "the table of rooms in docs/architecture.md"
    assert [*BEGIN_WITH][: len(annexes)] == TOWER + GROUND, "the picture above the table, in its order"
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


def rooms_of(folder, *rooms):
    """The modules of rooms, and what each imports of minimd."""
    within = tuple(f"{folder}.{room}" for room in rooms)
    for module, path in MODULES.items():
        if module.startswith(tuple(f"{room}." for room in within)) or module in within:
            yield module, [other for other in imports(path) if other.split(".")[0] in TOP]


def test_the_core_imports_nothing_of_minimd_outside_of_itself():
    """Neither lazily nor for type checkers."""
    outside = {(module, other) for module, others in rooms_of("minimd", "core") for other in others}
    assert {one for one in outside if not f"{one[1]}.".startswith("minimd.core.")} == set()


def test_arrows_of_the_core_lead_to_its_inner_rings():
    assert {room for ring in RINGS for room in ring.split()} == {name.removeprefix("core/") for name in CORE}
    for k, ring in enumerate(RINGS):
        outer = tuple(f"minimd.core.{room}." for further in RINGS[k + 1 :] for room in further.split())
        for module, others in rooms_of("minimd.core", *ring.split()):
            assert not [other for other in others if outer and f"{other}.".startswith(outer)], module


def test_annexes_on_the_ground_do_not_use_each_other():
    """Neither through the face."""
    for annex in GROUND:
        others = tuple(f"minimd.{other}." for other in GROUND if other != annex)
        for module, found in rooms_of("minimd", annex):
            assert "minimd" not in found, module
            assert not [other for other in found if f"{other}.".startswith(others)], module


def test_the_core_and_nobody_else_asks_annexes_for_two_things_by_name():
    """An arrow by name is still an arrow: what is asked for is counted, and the face provides each."""
    asking = [module for module, path in MODULES.items() if "from_annex" in path.read_text(encoding="utf-8")]
    assert all(module.startswith("minimd.core.") for module in asking), asking
    calls = [node for path in MODULES.values() for node in nodes_of(path) if isinstance(node, ast.Call)]

    def named(function):
        return {ast.literal_eval(node.args[0]) for node in calls if ast.unparse(node.func) == function}

    assert named("from_annex") == named("provide") == BY_NAME


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


def test_the_page_lists_the_files_of_a_step(steady_steps):
    files = re.findall(r"^(minimd/\S+\.py)", FILES.search(PAGE)[1], re.M)
    assert [file for file in files if not (REPOSITORY / file).is_file()] == []
    visited = {f"minimd/{chain[-1][0].relative_to(INSTALLED).as_posix()}" for chain in steady_steps}
    assert visited
    assert visited <= set(files), visited - set(files)
