"""What objects show: calls that make them again, escaped tables of a notebook, public names; and warnings."""

import threading
import warnings
from inspect import signature
from typing import get_args

import numpy as np
import pytest

import minimd as md
from minimd.core.console.display import Displayed
from minimd.core.console.quiet import quiet
from minimd.core.forces.options import Precision
from minimd.core.potentials.coulomb import METHODS, MethodName
from minimd.core.potentials.pair import MIXING, MixingName
from minimd.core.potentials.truncation import TRUNCATIONS, TruncationName

SPECIES = {"A": (1.0, 1.0), "B": (0.5, 0.88)}
CUTOFFS = {("A", "A"): 2.5, ("A", "B"): 2.0, ("B", "B"): 2.2}
MORE = {"switch_start": 1.5, "bonded_scale": (0.0, 0.0, 0.5), "tail_correction": True, "mixing": "geometric"}
HELD, UNLIKE = md.HarmonicBond(3.0, [1.0, 1.1], [(0, 1), (1, 2)]), {("A", "B"): (1.5, 0.8)}
CALLS = [  # an object, and the call that makes it again, without what is a default
    (md.LennardJones(0.0104, 3.4, 8.5), "LennardJones(epsilon=0.0104, sigma=3.4, cutoff=8.5, truncation='shifted')"),
    (md.LangevinBAOAB(0.005, 0.7, 2.0, seed=3), "LangevinBAOAB(timestep=0.005, temperature=0.7, friction=2, seed=3)"),
    (HELD, "HarmonicBond(k=3.0, length=[1.0, 1.1], pairs=[[0, 1], [1, 2]])"),
    (md.VelocityVerlet(md.units.fs), "VelocityVerlet(timestep=0.09822694788)"),
    (md.Coulomb(8.5, 1e-6), "Coulomb(cutoff=8.5, accuracy=1e-06)"),
    (md.Coulomb(), "Coulomb(cutoff=None, accuracy=1e-05)"),
    (md.Coulomb(9.0, method="reaction-field", bonded_scale=[0, 0.5, 1]), None),
    (md.LennardJones(SPECIES, None, CUTOFFS, "switched", pairs=UNLIKE, **MORE), None),
]  # fmt: skip


def test_repr_is_the_call_with_all_that_is_no_default():
    for one, call in CALLS:
        assert repr(eval(repr(one), {**vars(md), "None": None})) == repr(one) == (call or repr(one))


def test_a_system_tells_its_net_charge_and_takes_rounding_for_none():
    molecule = [-0.7, 0.4, 0.3]
    for net, charges in ((0.0, 100 * molecule), (0.25, [*(99 * molecule), -0.45, 0.4, 0.3]), (None, 300 * [0.0])):
        system = md.System(np.random.default_rng(1).random((300, 3)), charges=charges)
        told = dict(system.display_rows()).get("charges")
        assert told == (net if net is None else f"net charge {net:g} e, at most 0.7 e on an atom")
        assert system.net_charge == pytest.approx(net or 0.0, rel=1e-12, abs=0.0)


def test_laws_of_pairs_tell_their_arguments_in_the_order_of_their_signature_and_are_pair_potentials():
    table = md.Tabulated(np.arange(1.0, 9.0), np.arange(8.0), exclusions=[[0, 1]])
    for one in (md.LennardJones(1.0, 1.0), table, md.PairPotential(lambda r2: (r2, -2.0))):
        names = [*signature(type(one)).parameters]
        told = [line.split(" : ")[0] for line in type(one).__doc__.splitlines() if " : " in line]
        assert isinstance(one, md.PairPotential)
        assert names == [*one.arguments()] == told[:-1]


def test_laws_tell_what_is_mixed_of_few_species_even_if_the_rule_fails():
    def told(n_species, mixing="geometric"):
        species = {f"X{k}": (1.0, 1.0 + k) for k in range(n_species)}
        lj = md.LennardJones(species, None, 2.5, mixing=mixing, pairs={("X0", "X2"): (1.0, 7.0)})
        return [name for name, _ in lj.display_rows() if name.startswith("X")]

    assert (told(3), told(40)) == (["X0-X1", "X1-X2"], [])
    assert told(3, lambda first, second: (1.0, -1.0)) == told(3, lambda first, second: first[2]) == []


def test_html_is_escaped():
    text = "a <b>          words & more\n               of the same"
    odd = type("Odd", (Displayed,), {"__str__": lambda self: text})()
    assert odd.display_rows() == [("a <b>", "words & more"), ("", "of the same")]
    assert [words for words in ("a &lt;b&gt;</th>", "words &amp; more") if words not in odd._repr_html_()] == []


def test_names_that_are_offered_are_public_ones_that_exist():
    names = [name for name in dir(md) if not name.startswith("__")]
    assert names == sorted(md.__all__)
    assert all(hasattr(md, name) for name in names)
    assert {"langevin-baoab LangevinBAOAB", "symplectic-euler-1 SE1"} <= {
        " ".join((name, words.split()[0])) for name, words in md.integrators.METHODS.display_rows()
    }
    assert callable(md.scene.load_scene)  # a package, imported when it is asked for
    assert not {"Any", "dataclass", "math"} & set(dir(md.units))
    choices = (TruncationName, TRUNCATIONS), (MixingName, MIXING), (MethodName, METHODS)
    for words, known in (*choices, (Precision, ["double", "fixed-point"])):
        assert set(get_args(words)) == set(known)


def test_warnings_are_passed_over_in_one_thread_alone():
    """Also where contexts of two threads end in the order in which they began: catch_warnings would ignore all."""
    inside, leave = threading.Event(), threading.Event()

    def elsewhere():
        with quiet():
            inside.set()
            leave.wait(10.0)
            warnings.warn("nobody hears this", stacklevel=1)

    with warnings.catch_warnings(record=True, action="always") as told:
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
