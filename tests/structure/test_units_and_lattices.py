"""Times in the units that people use, crystals of the right distances and density, and the line of Numba that tells."""

import numpy as np
import pytest

import minimd as md
from minimd.structure.errors import why_not_compiled
from minimd.structure.lattice import BASES, constant_from_density, crystal

NEIGHBORS = {"sc": (6, 1), "bcc": (8, 0.75**0.5), "fcc": (12, 0.5**0.5), "diamond": (4, 3**0.5 / 4)}


def test_times_are_shown_in_the_unit_that_people_use():
    for time, words in ((2.5, "2.5 fs"), (-999.9, "-999.9 fs"), (12345600.0, "12345.6 ps")):
        assert md.units.ASE.shown(time * md.units.fs) == words
    for time in (0.004, 12345.6):
        assert md.units.LJ.shown(time) == f"{time} τ"


@pytest.mark.parametrize("lattice", BASES)
def test_every_lattice_has_its_nearest_neighbors_and_the_density_it_was_asked_for(lattice):
    neighbors, distance = NEIGHBORS[lattice]
    positions, edges = crystal(lattice, (3, 4, 5), 2.0)
    assert len(positions) == 60 * len(BASES[lattice])
    assert edges.tolist() == [6.0, 8.0, 10.0]
    first, d = md.neighbor_list("id", md.System(positions, cell=edges), 2.0 * distance * 1.01)
    assert np.all(np.bincount(first) == neighbors)
    assert d == pytest.approx(2.0 * distance)
    positions, edges = crystal(lattice, (2, 2, 2), constant_from_density(lattice, density=1.7, mass=3.0))
    assert len(positions) * 3.0 / edges.prod() == pytest.approx(1.7)


def test_what_numba_does_not_know_is_named():
    words = "Untyped global name 'erfc':\x1b[0m Cannot determine Numba type"
    message = f"Failed in nopython mode pipeline (step: nopython frontend)\n\x1b[1m{words}"
    assert why_not_compiled(message) == words.replace("\x1b[0m", "")
