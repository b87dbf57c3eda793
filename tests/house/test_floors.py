"""The house: a package is a floor, imports go down, nothing goes round in a circle; and what an import must not do."""

import ast
import re
import subprocess
import sys
from graphlib import CycleError, TopologicalSorter
from pathlib import Path

import pytest

import minimd

PACKAGE = Path(minimd.__file__).parent
REPOSITORY = Path(__file__).parents[2]
FLOORS = [  # highest first; several on one floor do not know each other
    "minimd.commands",
    "minimd.bench",
    "minimd",
    "minimd.view",
    "minimd.grade",
    "minimd.replay",
    "minimd.ensemble",
    "minimd.scene",
    "minimd.analysis",
    "minimd.mdanalysis",
    "minimd.lammps",
    "minimd.simulation",
    "minimd.ase",
    "minimd.files",
    "minimd.observers",
    "minimd.diagnosis",
    "minimd.engine",
    "minimd.minimization",
    "minimd.forces",
    "minimd.integrators",
    "minimd.constraints",
    "minimd.potentials",
    "minimd.neighbors",
    "minimd.structure",
    "minimd.compiled",
]
STRANGERS = {
    ("minimd.integrators", "minimd.potentials"),
    ("minimd.potentials", "minimd.integrators"),
}  # never import each other
BRIDGES = {  # modules that may import ase or MDAnalysis when they are imported
    "structure/ase_atoms.py",
    "structure/mdanalysis_atoms.py",
    "files/ase_writer.py",
    "files/structure_file.py",
    "files/mdanalysis_writer.py",
    "files/turned_cell.py",
    "mdanalysis/readers.py",
    "mdanalysis/topology.py",
    "mdanalysis/universes.py",
}


def name_of(path):
    return ".".join(path.relative_to(PACKAGE.parent).with_suffix("").parts).removesuffix(".__init__")


MODULES = {name_of(path): path for path in PACKAGE.rglob("*.py")}


def imports(path, when_imported=False):
    """Modules a file imports, lazily and for type checkers too; with when_imported only what its own import loads."""
    tree = ast.parse(path.read_text())
    for node in tree.body if when_imported else ast.walk(tree):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            for alias in node.names:
                submodule = f"{node.module}.{alias.name}"
                yield submodule if submodule in MODULES else node.module


def floor_of(module):
    return max((floor for floor in FLOORS if f"{module}.".startswith(f"{floor}.")), key=len)


def test_imports_go_down_the_floors():
    """Lazy and TYPE_CHECKING imports count; nobody is exempt."""
    upward = []
    for module, path in MODULES.items():
        here = FLOORS.index(floor_of(module))
        for other in imports(path):
            if other.split(".")[0] == "minimd" and floor_of(other) != floor_of(module):
                there = FLOORS.index(floor_of(other))
                if there < here or (floor_of(module), floor_of(other)) in STRANGERS:
                    upward.append(f"{module} -> {other}")
    assert not upward, "\n".join(upward)


def test_there_are_no_circles():
    graph = {module: {*imports(path)} & MODULES.keys() - {module} for module, path in MODULES.items()}
    try:
        TopologicalSorter(graph).prepare()
    except CycleError as circle:
        pytest.fail(f"a circle of imports: {' -> '.join(circle.args[1])}")


def test_no_module_reaches_for_the_private_name_of_another():
    reached = []
    for module, path in MODULES.items():
        tree = ast.parse(path.read_text())
        own = {"_asdict", "_replace", "_fields", "_make"}
        for node in ast.walk(tree):
            if isinstance(node, ast.FunctionDef | ast.ClassDef):
                own.add(node.name)
            elif isinstance(node, ast.Attribute) and isinstance(node.ctx, ast.Store):
                own.add(node.attr)
            elif isinstance(node, ast.AnnAssign) and isinstance(node.target, ast.Name):
                own.add(node.target.id)
        for node in ast.walk(tree):
            if isinstance(node, ast.ImportFrom) and (node.module or "").startswith("minimd"):
                reached += [f"{module}: {alias.name}" for alias in node.names if re.match(r"_[^_]", alias.name)]
            elif isinstance(node, ast.Attribute) and re.match(r"_[^_]", node.attr) and node.attr not in own:
                owner = node.value.id if isinstance(node.value, ast.Name) else ""
                if owner not in ("self", "cls", "sys", "os"):
                    reached.append(f"{module}: {ast.unparse(node)}")
    allowed = {"minimd.bench.engines"}  # OpenMM's and LAMMPS' own
    assert not [one for one in reached if one.split(":")[0] not in allowed], reached


def test_only_the_bridges_import_ase_and_mdanalysis():
    for path in PACKAGE.rglob("*.py"):
        place = path.relative_to(PACKAGE)
        if place.as_posix() not in BRIDGES and place.parts[0] not in ("ase", "bench"):
            roots = {module.split(".")[0] for module in imports(path, when_imported=True)}
            assert not roots & {"ase", "MDAnalysis"}, path


def test_importing_minimd_loads_no_bridge_and_compiles_nothing():
    code = """
import sys
from numba.core import event
compiled = event.install_recorder("numba:compile")
with compiled as recorder:
    import minimd
heavy = {"ase", "MDAnalysis", "matplotlib", "h5py", "pydantic", "tqdm", "pandas", "IPython", "minimd.lammps"}
assert not heavy & set(sys.modules), heavy & set(sys.modules)
assert not recorder.buffer, len(recorder.buffer)
"""
    answer = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert answer.returncode == 0, answer.stderr


def test_the_floors_of_the_page_are_those_of_the_house():
    page = (REPOSITORY / "docs" / "architecture.md").read_text(encoding="utf-8")
    rows = re.findall(r"^\| `(\w+)` \| .* \| `([\w/.]+)` \|$", page, re.M)
    assert [name for name, _ in rows] == [floor.removeprefix("minimd.") for floor in FLOORS]
    for name, file in rows:
        assert (PACKAGE / ("" if name in ("minimd", "replay") else name) / file).exists()
