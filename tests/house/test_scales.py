"""Scales of the house: lines, files and statements of its packages, of the road of a step and of the tests.

`python tests/house/test_scales.py` prints the rows of today. Nothing may grow beyond its row;
rows are changed by hand; the commit says what the growth buys.
"""

import ast
import re
from functools import cache
from pathlib import Path

REPOSITORY = Path(__file__).parents[2]
PACKAGE, BENCH = REPOSITORY / "minimd", REPOSITORY / "minimd_bench"
WIDEST, LONGEST_FILE, LONGEST_FUNCTION = 120, 600, 60
ROAD, TESTS = "road of a step", "tests"
# fmt: off
ROWS = {  # lines, files, statements; what is not there is not weighed
    "minimd": (296, 3, 154),
    "analysis": (306, 3, 179),
    "ase": (824, 6, 435),
    "commands": (683, 4, 385),
    "compiled": (2195, 14, 1252),
    "console": (483, 7, 272),
    "constraints": (1267, 6, 790),
    "diagnosis": (2092, 10, 1347),
    "document": (967, 6, 581),
    "engine": (1288, 6, 777),
    "ensemble": (1717, 7, 1070),
    "files": (2643, 11, 1628),
    "forces": (2527, 12, 1579),
    "grade": (2616, 14, 1580),
    "integrators": (4689, 26, 2477),
    "lammps": (1520, 8, 988),
    "mdanalysis": (452, 2, 271),
    "minimization": (362, 2, 209),
    "neighbors": (1880, 12, 1206),
    "observers": (2434, 12, 1493),
    "potentials": (3466, 15, 1917),
    "scene": (358, 3, 217),
    "simulation": (830, 6, 428),
    "structure": (2030, 15, 1170),
    "view": (376, 3, 209),
    "minimd_bench": (1886, 10, 1158),
    "road of a step": (3826, 13),
    "tests": (20000,),
}
# fmt: on


@cache
def nodes_of(text):
    return [*ast.walk(ast.parse(text))]


@cache
def statements(text):
    found = [node for node in nodes_of(text) if isinstance(node, ast.stmt)]
    return sum(not (isinstance(one, ast.Expr) and isinstance(one.value, ast.Constant)) for one in found)


def weighed(files):
    texts = [file.read_text(encoding="utf-8") for file in files]
    return sum(text.count("\n") for text in texts), len(texts), sum(map(statements, texts))


def scales():
    """Of the packages, the modules beside them, the files of a step that docs/architecture.md lists, the tests."""
    packages = sorted(place.parent for place in [*PACKAGE.glob("*/__init__.py"), BENCH / "__init__.py"])
    page = (REPOSITORY / "docs" / "architecture.md").read_text(encoding="utf-8")
    found = {"minimd": weighed(PACKAGE.glob("*.py"))}
    found |= {package.name: weighed(package.rglob("*.py")) for package in packages}
    found[ROAD] = weighed(REPOSITORY / file for file in re.findall(r"^(minimd/\S+\.py) ", page, re.M))
    found[TESTS] = (sum(text.count("\n") for text in sources("tests").values()),)
    return found


def test_nothing_grows_beyond_its_row():
    found = scales()
    assert found.keys() == ROWS.keys()
    grown = {name: row for name, row in ROWS.items() if any(a > b for a, b in zip(found[name], row, strict=False))}
    assert grown == {}, {name: found[name] for name in grown}


def sources(*folders):
    files = [file for folder in folders for file in (REPOSITORY / folder).rglob("*.py")]
    return {file.relative_to(REPOSITORY): file.read_text(encoding="utf-8") for file in files}


def test_lines_files_and_functions_keep_to_their_size():
    texts = sources("minimd", "minimd_bench", "tests", "examples")
    assert [place for place, text in texts.items() if max(map(len, text.splitlines()), default=0) > WIDEST] == []
    assert [
        place for place, text in sources("minimd", "minimd_bench", "tests").items() if text.count("\n") > LONGEST_FILE
    ] == []
    for place, text in sources("minimd", "minimd_bench").items():
        for node in nodes_of(text):
            if isinstance(node, ast.FunctionDef):
                body = node.body[1:] if ast.get_docstring(node) else node.body
                length = body[-1].end_lineno - body[0].lineno + 1 if body else 0
                assert length <= LONGEST_FUNCTION, f"{place}: {node.name} has {length} lines"


if __name__ == "__main__":
    for name, numbers in scales().items():
        print(f'    "{name}": {numbers[: len(ROWS.get(name, "abc"))]},')
