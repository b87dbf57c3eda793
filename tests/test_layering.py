"""Who may import whom, and what an import must not do."""

import ast
import subprocess
import sys
from pathlib import Path

import pytest

import minimd

PACKAGE = Path(minimd.__file__).parent
FOUNDATION = {"minimd.compiled.kernels", "minimd.compiled.simd", "minimd.structure.errors", "minimd.compiled.threads"}  # what both rooms stand on
ROOMS = {
    "potentials": {"numpy", "numba", "minimd.potentials", *FOUNDATION},
    "integrators": {"numpy", "numba", "scipy", "minimd.integrators", *FOUNDATION},
}
ENDS = {
    "minimd.ase",
    "minimd.mdanalysis",
    "minimd.scene",
    "minimd.commands.main",
    "minimd.bench",
    "minimd.analysis.check",
    "minimd.analysis.plot",
    "minimd.commands.doctor",
}
STANDARD = set(sys.stdlib_module_names)


def imports(path, lazy=True):
    """Modules a file imports; with lazy=False only those imported when it is."""
    tree = ast.parse(path.read_text())
    nodes = ast.walk(tree) if lazy else tree.body
    for node in nodes:
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            yield from ([f"minimd.{a.name}" for a in node.names] if node.module == "minimd" else [node.module])


def belongs(module, allowed):
    return any(module == name or module.startswith(name + ".") for name in allowed)


@pytest.mark.parametrize("room", ROOMS)
def test_rooms_import_only_what_they_may(room):
    for path in (PACKAGE / room).glob("*.py"):
        foreign = [m for m in imports(path) if not belongs(m, ROOMS[room]) and m.split(".")[0] not in STANDARD]
        assert not foreign, f"{path.name} imports {foreign}"


def test_only_the_bridges_import_ase_and_mdanalysis():
    for path in PACKAGE.rglob("*.py"):
        roots = (
            {m.split(".")[0] for m in imports(path)}
            if path.name not in ("system.py", "simulation.py", "dynamics.py", "motion.py", "forces.py", "advice.py", "minimization.py")
            else {m.split(".")[0] for m in imports(path, False)}
        )
        assert "ase" not in roots or path.parent.name == "ase", path
        assert "MDAnalysis" not in roots or path.name == "mdanalysis.py", path


def test_nothing_imports_the_ends_when_it_is_imported():
    for path in PACKAGE.rglob("*.py"):
        name = "minimd." + path.relative_to(PACKAGE).with_suffix("").as_posix().replace("/", ".")
        if not belongs(name.removesuffix(".__init__"), ENDS):
            assert not [m for m in imports(path, lazy=False) if belongs(m, ENDS)], path


def test_importing_minimd_loads_no_bridge_and_compiles_nothing():
    code = """
import sys
from numba.core import event
compiled = event.install_recorder("numba:compile")
with compiled as recorder:
    import minimd
heavy = [m for m in ("ase", "MDAnalysis", "matplotlib", "h5py", "pydantic", "tqdm") if m in sys.modules]
assert not heavy, heavy
assert not recorder.buffer, len(recorder.buffer)
"""
    answer = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert answer.returncode == 0, answer.stderr


def test_files_and_functions_keep_to_their_size():
    for path in PACKAGE.rglob("*.py"):
        text = path.read_text()
        assert text.count("\n") <= 300, path
        for node in ast.walk(ast.parse(text)):
            if isinstance(node, ast.FunctionDef):
                body = node.body[1:] if ast.get_docstring(node) else node.body
                length = body[-1].end_lineno - body[0].lineno + 1 if body else 0
                assert length <= 60, f"{path.name}: {node.name} has {length} lines"
