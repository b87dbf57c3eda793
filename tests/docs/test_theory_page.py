"""The chapter on theory: what it names exists, and what it says of published coefficients is so."""

import ast
import re
from pathlib import Path

import pytest

from minimd.integrators import Drift, Kick, McLachlanAtela4, Ruth3, VelocityVerlet
from minimd.integrators.splitting.order_conditions import nystrom_order, separable_order

REPOSITORY = Path(__file__).parents[1]
PAGE = REPOSITORY / "docs" / "theory.md"
TEXT = PAGE.read_text(encoding="utf-8")


def functions_of(path):
    return {
        node.name for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))) if isinstance(node, ast.FunctionDef)
    }


def test_every_path_and_link_of_the_chapter_exists():
    named = re.findall(r"`((?:tests|examples|docs|minimd)/[\w/.]+)`", TEXT)
    assert len(named) > 50
    missing = [path for path in named if not (REPOSITORY / path).exists()]
    missing += [link for link in re.findall(r"\]\(([\w./-]+\.md)\)", TEXT) if not (PAGE.parent / link).exists()]
    assert not missing


def test_every_test_that_the_chapter_names_exists_where_it_says():
    """A name belongs to a file of the same paragraph, or of an entry of a list before it in its section."""
    known = {path.name: functions_of(path) for path in (REPOSITORY / "tests").glob("test_*.py")}
    for section in re.split(r"^## ", TEXT, flags=re.M)[1:]:
        files = re.findall(r"`tests/(test_\w+\.py)`", section)
        for name in re.findall(r"`(test_\w+)`", section):
            assert any(name in known[file] for file in files), (
                f"{name} is in none of {files} of section {section[:30]!r}"
            )


def test_every_section_of_the_chapter_names_a_test():
    sections = re.split(r"^## ", TEXT, flags=re.M)[1:-1]
    assert len(sections) == 11
    assert all(re.search(r"`test_\w+`", section) for section in sections)


def test_coefficients_of_ruth_in_another_order_have_order_one():
    kicks, drifts = (7 / 24, 3 / 4, -1 / 24), (2 / 3, -2 / 3, 1.0)
    right = tuple(part for b, a in zip(kicks, drifts, strict=True) for part in (Kick(b), Drift(a)))
    assert right == Ruth3.substeps
    assert separable_order(right) == separable_order(right[::-1]) == 3
    drift_first = tuple(part for b, a in zip(kicks, drifts, strict=True) for part in (Drift(a), Kick(b)))
    backwards = tuple(part for b, a in zip(kicks[::-1], drifts[::-1], strict=True) for part in (Kick(b), Drift(a)))
    assert separable_order(drift_first) == separable_order(backwards) == 1


def test_an_optimal_method_loses_its_order_if_kicks_and_drifts_change_places():
    exchanged = tuple(
        (Drift if isinstance(part, Kick) else Kick)(part.coefficient) for part in McLachlanAtela4.substeps
    )
    assert (nystrom_order(McLachlanAtela4.substeps), separable_order(McLachlanAtela4.substeps)) == (4, 3)
    assert nystrom_order(exchanged) == 3


def test_a_triple_jump_over_symplectic_euler_has_order_one():
    w = 1.0 / (2.0 - 2.0 ** (1.0 / 3.0))
    assert (
        separable_order(tuple(part for weight in (w, 1.0 - 2.0 * w, w) for part in (Kick(weight), Drift(weight)))) == 1
    )
    assert separable_order(VelocityVerlet.substeps) == 2


@pytest.mark.parametrize("formula", re.findall(r"\$\$(.*?)\$\$", TEXT, re.S))
def test_formulas_are_balanced(formula):
    assert formula.count("{") == formula.count("}")
