"""What objects show: calls that make them again, escaped tables of a notebook, public names; and warnings."""

import threading
import warnings
from typing import get_args

import numpy as np
import pytest

import minimd as md
from minimd.forces.options import Precision
from minimd.potentials.pair import MIXING, MixingName
from minimd.potentials.truncation import TRUNCATIONS, TruncationName
from minimd.structure.display import Displayed
from minimd.structure.quiet import quiet
from minimd.structure.units import GRAM_PER_CM3

KINDS, CUTOFFS = {"A": (1.0, 1.0), "B": (0.5, 0.88)}, {("A", "A"): 2.5, ("A", "B"): 2.0, ("B", "B"): 2.2}
MORE = {"switch_start": 1.5, "bonded_scale": (0.0, 0.0, 0.5), "tail_correction": True}
KOB_ANDERSEN = md.LennardJones(
    KINDS, None, CUTOFFS, "switched", mixing="geometric", pairs={("A", "B"): (1.5, 0.8)}, **MORE
)


def soft(r2, height):
    return height / r2, 2.0 * height / r2**2


BONDS = md.HarmonicBond(3.0, [1.0, 1.1], [(0, 1), (1, 2)])
CALLS = {  # that make the object again, in full
    "LennardJones(epsilon=0.0104, sigma=3.4, cutoff=8.5, truncation='shifted')": md.LennardJones(0.0104, 3.4, 8.5),
    "LennardJones(epsilon={'A': (1, 1), 'B': (0.5, 0.88)}, "
    "cutoff={('A', 'A'): 2.5, ('A', 'B'): 2, ('B', 'B'): 2.2}, truncation='switched', mixing='geometric', "
    "pairs={('A', 'B'): (1.5, 0.8)}, switch_start=1.5, bonded_scale=(0, 0, 0.5), tail_correction=True)": KOB_ANDERSEN,
    "PairPotential(law=soft, parameters=(3,), cutoff=None, truncation='shifted')": md.PairPotential(soft, (3.0,)),
    "BondPotential(law=soft, parameters=(2.0,))": md.BondPotential(soft, (2.0,)),
    "HarmonicBond(k=3.0, length=[1.0, 1.1], pairs=[[0, 1], [1, 2]])": BONDS,
    "HarmonicAngle(k=2.0, angle=1.0, triples=[[0, 1, 2]])": md.HarmonicAngle(2.0, 1.0, [(0, 1, 2)]),
    "LangevinBAOAB(timestep=0.005, temperature=0.7, friction=2, seed=3)": md.LangevinBAOAB(0.005, 0.7, 2.0, seed=3),
    "VelocityVerlet(timestep=0.09822694788)": md.VelocityVerlet(md.units.fs),
    "Cell([[2.0, 0.0, 0.0], [0.0, 2.0, 0.0], [0.0, 0.0, 2.0]], pbc=[True, True, True])": md.Cell.of(2.0),
    "minimd.units.ASE": md.units.ASE,
}


def test_repr_is_the_call_with_all_that_is_no_default():
    assert [repr(one) for one in CALLS.values()] == list(CALLS)
    for one in (KOB_ANDERSEN, md.LennardJones(0.3, 1.2, 2.5, "charmm"), md.LangevinBAOAB(0.005, 0.7, 2.0, seed=3)):
        again = eval(repr(one), {**vars(md), "None": None})
        assert repr(again) == repr(one)


class Odd(Displayed):
    def __str__(self):
        return "a <b>          words & more\n               of the same"


def test_html_is_escaped():
    assert Odd().display_rows() == [("a <b>", "words & more"), ("", "of the same")]
    assert "a &lt;b&gt;</th>" in Odd()._repr_html_()
    assert "words &amp; more" in Odd()._repr_html_()


def test_a_system_shows_its_angles_and_its_density():
    """Argon at 1.374 g/cm³ has 0.0207 atoms/Å³."""
    edges = [1.0, 1.0, 3 * 39.948 / (1.374 * GRAM_PER_CM3)]
    system = md.System(np.eye(3), masses=39.948, cell=edges, angles=[[0, 1, 2], [1, 2, 0]], units=md.units.ASE)
    assert "2 angles" in repr(system)
    assert "angles" in system._repr_html_()
    assert pytest.approx(0.6022140858549161) == GRAM_PER_CM3  # u/Å³
    assert "1.374 g/cm³" in str(system)


def test_names_that_are_offered_are_public_ones_that_exist():
    names = [name for name in dir(md) if not name.startswith("__")]
    assert names == sorted(md.__all__)
    assert all(hasattr(md, name) for name in names)
    assert not {"Any", "dataclass", "math"} & set(dir(md.units))
    precisions = ["double", "mixed", "fixed-point"]
    for words, known in ((TruncationName, TRUNCATIONS), (MixingName, MIXING), (Precision, precisions)):
        assert set(get_args(words)) == set(known)


def test_warnings_are_passed_over_in_one_thread_alone():
    """Also where contexts of two threads end in the order in which they began: catch_warnings would ignore all."""
    inside, leave = threading.Event(), threading.Event()

    def elsewhere():
        with quiet():
            inside.set()
            leave.wait(10.0)
            warnings.warn("nobody hears this", stacklevel=1)

    with warnings.catch_warnings(record=True) as told:
        warnings.simplefilter("always")
        with quiet():
            other = threading.Thread(target=elsewhere)
            other.start()
            inside.wait(10.0)
            warnings.warn("nor this", stacklevel=1)
        warnings.warn("but this", stacklevel=1)
        leave.set()
        other.join()
        warnings.warn("and this", stacklevel=1)
    assert [str(one.message) for one in told] == ["but this", "and this"]
