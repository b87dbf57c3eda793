"""The surface of the core: the names that annexes may use. Others are debts, whose number may only fall."""

import ast
import re
from collections import defaultdict
from pathlib import Path

import minimd as md
from minimd.core.console.lazy import places_of

REPOSITORY = Path(__file__).parents[2]
PACKAGE = REPOSITORY / "minimd"
PAGE = (REPOSITORY / "docs" / "architecture.md").read_text(encoding="utf-8")
TABLE = PAGE[PAGE.index("### The surface") : PAGE.index("## One run")]
STUBS = [md, md.integrators, md.potentials]
PUBLIC = {(place, name) for module in STUBS for name, place in places_of(module.__name__).items()}
PUBLIC_MODULES = {"minimd.core.structure.lattice", "minimd.core.structure.units"}  # md.lattice, md.units
MOST_NAMES, MOST_DEBTS = 83, 134


def listed():
    """The (module, name) of the table: rows with one room or two, names that begin with a module."""
    for row in re.findall(r"^\| (`\w+/`.*) \|$", TABLE, re.M):
        rooms, _, words = row.partition(" | ")
        for word in re.findall(r"`([\w.]+)`", words):
            module, _, name = word.rpartition(".")
            folders = [PACKAGE / "core" / room for room in re.findall(r"`(\w+)/`", rooms)]
            (folder,) = [one for one in folders if not module or (one / f"{module}.py").exists()]
            yield ".".join(filter(None, ("minimd.core", folder.name, module))), name


def used():
    """The (module, name) of the core that annexes import, with the annexes; not those of public modules."""
    users = defaultdict(set)
    for path in PACKAGE.glob("*/**/*.py"):
        annex = path.relative_to(PACKAGE).parts[0]
        if annex != "core":
            for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
                is_of_core = isinstance(node, ast.ImportFrom) and (node.module or "").startswith("minimd.core")
                if is_of_core and node.module not in PUBLIC_MODULES:
                    for alias in node.names:
                        users[node.module, alias.name].add(annex)
    return users


def test_each_name_of_the_surface_is_used_by_an_annex():
    assert len(set(listed())) <= MOST_NAMES
    assert set(listed()) - used().keys() == set()
    assert set(listed()) & PUBLIC == set()  # these are promised to everybody


def test_debts_only_fall():
    debts = {place: annexes for place, annexes in used().items() if place not in PUBLIC | {*listed()}}
    for module, name in sorted(debts):
        print(f"{module.removeprefix('minimd.core.')}.{name}: {', '.join(sorted(debts[module, name]))}")
    print(f"{len(debts)} debts; {len(set(listed()))} names of the surface; {len(used())} names used by annexes")
    assert len(debts) <= MOST_DEBTS
