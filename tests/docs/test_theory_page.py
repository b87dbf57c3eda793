"""The chapter on theory: what it names exists. What it says is held by the tests that it names."""

import ast
import re
from pathlib import Path

REPOSITORY = Path(__file__).parents[2]
PAGE = REPOSITORY / "docs" / "theory.md"
TEXT = PAGE.read_text(encoding="utf-8")
SECTIONS = re.split(r"^## ", TEXT, flags=re.M)[1:]


def functions_of(path):
    tree = ast.parse((REPOSITORY / path).read_text(encoding="utf-8"))
    return {node.name for node in ast.walk(tree) if isinstance(node, ast.FunctionDef)}


def test_every_path_and_link_of_the_chapter_exists():
    named = re.findall(r"`((?:tests|examples|docs|minimd)/[\w/.]+)`", TEXT)
    assert len(named) > 50
    missing = [path for path in named if not (REPOSITORY / path).exists()]
    missing += [link for link in re.findall(r"\]\(([\w./-]+\.md)\)", TEXT) if not (PAGE.parent / link).exists()]
    assert not missing


def test_every_test_and_every_law_that_the_chapter_names_is_in_a_file_that_its_section_names():
    """A law is a row of LAWS, as in `LAWS["volume"]`."""
    for section in SECTIONS:
        files = re.findall(r"`(tests/(?:\w+/)?test_\w+\.py)`", section)
        known = set().union(*map(functions_of, files)) if files else set()
        assert set(re.findall(r"`(test_\w+)`", section)) <= known, section[:30]
        for law in re.findall(r"`LAWS(\[\"[^\"]+\"\])`", section):
            assert any(f"    {law[1:-1]}: Law(" in (REPOSITORY / file).read_text(encoding="utf-8") for file in files), (
                law
            )


def test_every_section_of_the_chapter_names_a_test():
    assert len(SECTIONS[:-1]) == 11
    assert all(re.search(r"`test_\w+`|`LAWS\[", section) for section in SECTIONS[:-1])


def test_formulas_are_balanced():
    for formula in re.findall(r"\$\$(.*?)\$\$", TEXT, re.S):
        assert formula.count("{") == formula.count("}")
