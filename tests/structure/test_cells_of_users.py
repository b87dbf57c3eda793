"""What users give as cells: open directions, and what they are told."""

import numpy as np
import pytest
from wrong_calls import assert_answered

import minimd as md

SIDE = [[20.0, 0.0, 0.0], [0.0, 20.0, 0.0], [20.0, 20.0, 0.0]]
SLAB = "pbc=(True, True, False)"


@pytest.mark.parametrize(
    ("cell", "pbc", "shown"),
    [
        ([20, 20, None], None, ["None", SLAB]),
        ([20, 20], None, ["(2,)", SLAB]),
        ([20, 20, np.inf], None, ["finite", SLAB]),
        (SIDE, None, ["linearly independent", SLAB]),
        ([20, 20, 0], True, ["cell[2]", SLAB]),
        ([20, 0, 20], [False, True, True], ["pbc=(False, False, True)"]),
        (md.Cell.of(3.0), True, ["Cell.of(vectors, pbc)"]),
        (-3.0, None, ["negative", "-3"]),
        ([3, 3, -1], None, ["negative", "-1"]),
    ],
)
def test_messages_about_cells_name_pbc_where_it_is_the_cure(cell, pbc, shown):
    assert_answered(lambda: md.System(np.eye(3), cell=cell, pbc=pbc), ValueError, *shown)


def test_numbers_of_a_cell_have_their_units():
    slab = str(md.System(np.eye(3), cell=[3.0, 3.0, 9.0], pbc=(True, True, False)))
    assert "(0, 0, 9) σ, open" in slab
    argon = str(md.System(np.eye(3), masses=40.0, cell=4.0, units=md.units.ASE))
    assert "cell a         (4, 0, 0) Å\n" in argon
    assert "volume         64 Å³\n" in argon
