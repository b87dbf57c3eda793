"""Laws of the user in the cache of compiled code: found again by the next process if nothing they read has changed."""

import copy
import inspect
import math
import pickle

import numba
import numpy as np
import pytest
from numpy.typing import ArrayLike
from processes import ended
from references import liquid
from wrong_calls import assert_answered

import minimd as md
from minimd.core.compiled.snapshot import FunctionSnapshot
from minimd.core.files.h5md_schema import other_potentials, potentials_in_words
from minimd.core.potentials.bonded import Bond
from minimd.core.potentials.declared import NOT_NEGATIVE, POSITIVE, declared, each, groups
from minimd.core.potentials.law import evaluate_law, is_recognized, is_user_law, user_law
from minimd.core.potentials.truncation import Shifted

LAW = """
from collections import namedtuple
import numba, numpy as np

Place = namedtuple("Place", "x")
place = Place(5.0)
strength = 2.0
table = np.array([1.0, 3.0])

@numba.njit
def inner(x):
    return 7.0 * x

@numba.njit
def helper(x):
    return inner(x)

def make(width):
    def law(r2, a, factor=1.0):
        u = a * factor * strength * table[1] * width * helper(1.0) / r2
        return u, 2.0 * u / r2
    return law

law = make(11.0)
"""
UNCHANGED = 2.0 * 3.0 * 11.0 * 7.0  # u at r = 1
CHANGES = {
    "constant": ("u = a", "u = 13.0 * a", 13.0 * UNCHANGED), "array": ("[1.0, 3.0]", "[1.0, 9.0]", 3.0 * UNCHANGED),
    "default": ("factor=1.0", "factor=17.0", 17.0 * UNCHANGED), "cell": ("make(11.0)", "make(5.5)", 0.5 * UNCHANGED),
    "global": ("strength = 2.0", "strength = 4.0", 2.0 * UNCHANGED),
    "helper of a helper": ("7.0 * x", "3.5 * x", 0.5 * UNCHANGED),
    "global without a digest": ("strength *", "place.x *", 2.5 * UNCHANGED),
}  # fmt: skip
EVALUATE = f"""
pair = md.System([[0, 0, 0], [1, 0, 0]])
def energy(source):
    names = {{"__name__": "__main__"}}
    exec(source, names)
    return md.evaluate(pair, md.PairPotential(names["law"], (1.0,))).potential_energy
LAW, CHANGES = {LAW!r}, {CHANGES!r}
print(energy(LAW), *(energy(LAW.replace(old, new)) for old, new, _ in CHANGES.values()))
"""
UNSEEN = [  # objects of classes of the user's, attributes of modules, arrays that may change, calls of anything
    ("strength *", "place.x *"), ("strength = 2.0", "import sys; strength = sys"), ("strength = 2.0", ""),
    ("np.array([1.0, 3.0])", "[1.0, 3.0]"), ("np.array([1.0, 3.0])", "np.zeros(10**6)"),
    ("np.array([1.0, 3.0])", "np.zeros(8)[::2]"), ("        u =", "        import math\n        u ="),
    ("@numba.njit\ndef inner", "@numba.njit('f8(f8)')\ndef inner"), ("@numba.njit\ndef inner", "def inner"),
]  # fmt: skip


def answer(code):
    """The numbers that another process prints."""
    process = ended("-c", f"import minimd as md\n{code}")
    assert process.returncode == 0, process.stderr
    return [float(word) for word in process.stdout.split()]


def names_of(source, file="law.py"):
    names = {"__name__": "__main__"}
    exec(compile(source, file, "exec"), names)
    return names


def digest_of(source, file="law.py"):
    return FunctionSnapshot(names_of(source, file)["law"]).digest


def on_a_pair(md, law):
    return [md.evaluate(md.System([[0, 0, 0], [1, 0, 0]]), md.PairPotential(law, (1.0,), 3.0)).potential_energy]


def on_clusters_and_bonds(md, law):
    points = [[1.1 * i, 1.1 * j, 1.1 * k] for i in range(6) for j in range(6) for k in range(6)]
    forces = md.Forces(md.System(points, cell=6.6), md.PairPotential(law, (1.0,), 2.0))
    sums = forces.compute(md.potentials.TOTALS)
    assert "cluster list" in forces.pair_search
    bonded = md.evaluate(md.System([[0, 0, 0], [1, 0, 0]], bonds=[(0, 1)]), md.BondPotential(law, (1.0,)))
    return [sums.potential_energy, bonded.potential_energy]


@pytest.mark.parametrize("run", [on_a_pair, pytest.param(on_clusters_and_bonds, marks=pytest.mark.slow)])
def test_second_process_compiles_nothing_for_a_law_of_the_user(run, tmp_path):
    """Kept code knows the module it was compiled from; if that has another name, it is compiled again, and runs."""
    code = f"""
import sys
from numba.core import event
sys.path.insert(0, {str(tmp_path)!r})
{inspect.getsource(run)}
with event.install_recorder("numba:compile") as recorder:
    from MODULE import law
    print(*{run.__name__}(md, law), len(recorder.buffer))"""
    file = tmp_path / "law_of_mine.py"
    file.write_text(LAW.replace("strength = 2.0", "strength = 7.0"))  # no other test keeps this one's code
    (*first, _), (*second, n_compiled) = (answer(code.replace("MODULE", "law_of_mine")) for _ in range(2))
    assert (second, n_compiled) == (first, 0)
    file.rename(tmp_path / "renamed.py")
    assert answer(code.replace("MODULE", "renamed"))[:-1] == first


@pytest.mark.slow
def test_another_process_compiles_a_changed_law_again_and_takes_one_that_is_sent():
    """What changed is the law, its default, a global, an array, a closure cell, or a function of one that it calls."""
    sent = pickle.dumps(user_law(names_of(LAW)["law"]))
    received = f"import pickle\nfrom minimd.core.potentials.law import evaluate_law\nlaw = pickle.loads({sent!r})"
    unchanged, *changed, u, f = answer(f"{EVALUATE}\n{received}\nprint(*evaluate_law(law, 1.0, (1.0,)))")
    assert changed == pytest.approx([expected for *_, expected in CHANGES.values()], rel=1e-14)  # rounding
    assert [unchanged, u, f] == pytest.approx([UNCHANGED, UNCHANGED, 2.0 * UNCHANGED], rel=1e-14)


def test_the_digest_tells_what_changes_the_code_and_nothing_else():
    law = digest_of(LAW)
    assert digest_of("# a comment\n\n" + LAW, "elsewhere.py") == digest_of(LAW + "\nunused = 3") == law
    compiled = LAW + "\nlaw = numba.njit(law)"
    others = [compiled, compiled.replace("njit(law)", "njit(fastmath=True)(law)")]
    others += [LAW.replace(old, new) for old, new, _ in list(CHANGES.values())[:-1]]
    more = {"@numba.njit": "@numba.njit(fastmath=True)", "strength = 2.0": "strength = 2", "np.array([": "np.float32(["}
    others += [LAW.replace(old, new) for old, new in more.items()]
    assert len({law, *map(digest_of, others)}) == 1 + len(others)
    # a function that calls itself
    source = "import numba\n@numba.njit\ndef law(r2, n):\n    return 1.0 if n < 1.0 else r2 * law(r2, n - 1.0)\n"
    snapshot = FunctionSnapshot(names_of(source)["law"])
    assert snapshot.digest == digest_of(source) != digest_of(source.replace("1.0 if", "2.0 if"))
    assert snapshot.function(3.0, 2.0) == snapshot.python(3.0, 2.0) == 9.0


def test_what_may_change_unseen_has_no_digest_and_what_a_law_reads_must_be_there():
    assert [digest_of(LAW.replace(old, new)) for old, new in UNSEEN] == [""] * len(UNSEEN)
    law = names_of(LAW.replace("strength = 2.0", ""))["law"]
    assert_answered(lambda: md.PairPotential(law, (1.0,)).pair_energy(1.0), TypeError, "the law law", "'strength'")


UNCLEAR = LAW  # with all kinds that take the digest from a law; its numbers are the same
for _old, _new in (
    ("place = Place(5.0)", 'place = Place(1.0); import types; params = types.ModuleType("params")'),
    ("strength = 2.0", "params.strength = 2.0; scale = np.array([1.0, 1.0, 7.0])[::2]"),
    ("strength *", "place.x * params.strength *"),  # an object of a class of the user's, a name in a module
    ("np.array([1.0, 3.0])", "np.array([1.0, 0.0, 3.0])[::2]"),
    ("7.0 * x", "scale[1] * x"),  # an array of a helper
):
    UNCLEAR = UNCLEAR.replace(_old, _new)
CHANGE_UNCLEAR = "place, params.strength, table[1], scale[1] = Place(5.0), 9.0, 9.0, 9.0"
STATES = [(LAW, True, "strength, table[1] = 4.0, 30.0"), (UNCLEAR, False, CHANGE_UNCLEAR)]


@pytest.mark.parametrize(("source", "is_clear", "change"), STATES, ids=["clear", "unclear"])
def test_a_law_stays_what_it_was_when_the_potential_was_made(source, is_clear, change):
    """Compiled or not, with a digest or without. Its shift is computed in Python at each bind, its forces by code that
    is compiled at the first evaluation; the cache must not hold a later state under the digest of an earlier one."""
    names, pair = names_of(source), md.System([[0, 0, 0], [1, 0, 0]])
    potential = md.PairPotential(names["law"], (1.0,), 3.0)
    assert is_recognized(potential.law) == is_clear
    found = []
    for _ in range(2):
        exec(change, names)
        found += [md.evaluate(pair, potential).potential_energy, float(potential.pair_energy(1.0))]
    assert found == pytest.approx([UNCHANGED * (1.0 - 1.0 / 9.0)] * 4, rel=1e-14)  # rounding
    if is_clear:
        after = md.PairPotential(names["law"], (1.0,), 3.0)
        assert float(after.pair_energy(1.0)) == pytest.approx(20.0 * found[0], rel=1e-14)
        assert after.law != potential.law


def test_law_types_are_told_apart_and_copied():
    first, second = user_law(names_of(LAW)["law"]), user_law(names_of(LAW.replace("7.0", "8.0"))["law"])
    unclear = user_law(names_of(LAW.replace("strength *", "place.x *"))["law"])
    assert first == user_law(names_of(LAW)["law"]) != second
    assert Shifted(first) != Shifted(second)
    assert all(is_user_law(law) for law in (first, unclear, Shifted(second)))
    assert [is_recognized(Shifted(law)) for law in (first, second, unclear)] == [True, True, False]
    for law in (first, unclear):
        for twin in (copy.deepcopy(law), pickle.loads(pickle.dumps(law))):
            assert is_recognized(twin) == is_recognized(law)
            assert evaluate_law(twin, 1.0, (1.0,)) == evaluate_law(law, 1.0, (1.0,))


@pytest.mark.slow
def test_a_law_without_a_digest_runs_on_the_cluster_list():
    names, system = names_of(LAW.replace("strength *", "place.x *")), liquid(4)
    unclear = md.Forces(system, md.PairPotential(numba.njit(names["law"]), (1.0,), 2.0))
    clear = md.Forces(system, md.PairPotential(names_of(LAW)["law"], (2.5,), 2.0))
    for forces in (unclear, clear):
        forces.compute()
        assert "cluster list" in forces.pair_search
    np.testing.assert_allclose(unclear.forces, clear.forces, rtol=1e-12, atol=1e-8)  # rounding


class QuarticBond(Bond):
    """A bond that is soft at rest, u(r) = k (r − length)⁴."""

    law = user_law(lambda r2, k, b: (k * (np.sqrt(r2) - b) ** 4, -4.0 * k * (np.sqrt(r2) - b) ** 3 / np.sqrt(r2)))
    k: ArrayLike = declared(each, "u = k (r − length)⁴", "energy", NOT_NEGATIVE)
    length: ArrayLike = declared(each, "at rest", "length", POSITIVE, default=1.0)
    pairs: ArrayLike | None = declared(groups, of=2, default=None)


def test_a_law_is_declared_once_and_has_constructor_checks_words_and_forces():
    assert [*inspect.signature(QuarticBond).parameters] == ["k", "length", "pairs"]
    assert "k : one number, or one for each [energy]; u = k (r − length)⁴." in QuarticBond.__doc__
    assert repr(QuarticBond(2.0, pairs=[[0, 1]])) == "QuarticBond(k=2.0, length=1.0, pairs=[[0, 1]])"
    many, others = (QuarticBond(np.linspace(1.0, top, 50), pairs=np.arange(100).reshape(50, 2)) for top in (2.0, 3.0))
    assert (len(repr(many)) < 80, repr(many)) == (True, repr(others))  # short
    assert other_potentials(potentials_in_words([many]), [many]) == ""
    assert other_potentials(potentials_in_words([many]), [others]) != ""  # files know them apart
    for wrong, *shown in ((-1.0, "k", "-1.0"), (np.nan, "k", "nan"), ("soft", "k"), ([[1.0]], "k", "(1, 1)")):
        assert_answered(lambda wrong=wrong: QuarticBond(wrong), ValueError, *shown)
    system = md.System([[0, 0, 0], [1.3, 0, 0], [2.4, 0, 0]], bonds=[[0, 1], [1, 2]])
    found = md.evaluate(system, QuarticBond([2.0, 3.0]))
    assert found.potential_energy == pytest.approx(2.0 * 0.3**4 + 3.0 * 0.1**4, rel=1e-12)  # rounding
    np.testing.assert_allclose(found.forces[2, 0], -4.0 * 3.0 * 0.1**3, rtol=1e-12)
    assert_answered(lambda: md.evaluate(system, QuarticBond([1.0, 2.0, 3.0])), ValueError, "k", "2", "(3,)")


def test_a_law_and_a_field_may_have_no_parameters_and_a_law_a_constant_force_over_distance():
    found = md.evaluate(md.System([[0, 0, 0], [1, 2, 2]]), md.BondPotential(lambda r2: (r2, -2.0), (), [[0, 1]]))
    assert (found.potential_energy, found.forces[1].tolist()) == (9.0, [-2.0, -4.0, -4.0])
    found = md.evaluate(md.System(np.diag([1.0, 2.0, 3.0])), md.Field(lambda x, y, z, t: (y * y, 0.0, -2.0 * y, 0.0)))
    assert (found.potential_energy, found.forces[1].tolist()) == (4.0, [0.0, -4.0, 0.0])


@pytest.mark.parametrize("factor", [1.0, 1.00003])
def test_laws_of_bonds_and_dihedrals_are_compared_with_their_slopes(factor):
    system = md.System([[0, 0, 0], [1.2, 0, 0], [1.9, 1, 0], [3, 1.2, 0.4]])
    bond = md.BondPotential(lambda r2: (r2 * r2, -4.0 * factor * r2), (), [[0, 1]])
    torsion = md.DihedralPotential(lambda phi: (math.cos(phi), -factor * math.sin(phi)), (), [[0, 1, 2, 3]])
    for potential, words in ((bond, "-u'(r)/r"), (torsion, "u'(phi)")):
        if factor == 1.0:
            assert np.abs(md.evaluate(system, potential).forces).max() > 0.1
        else:
            assert_answered(lambda one=potential: md.evaluate(system, one), ValueError, words)


POWERS = ["r**n", "pow(r, n)", "np.power(r, n)", "math.pow(r, n)", "r2 ** (0.5 * n)", "(1.0 / r) ** -n", "t"]
POWERS += ["max(r, n) / n * math.hypot(r**n, 0.0)", "np.exp(n * np.log(r))", "2.0**n * (0.5 * r) ** n"]  # r < n


@pytest.mark.parametrize("power", [POWERS[0], *(pytest.param(other, marks=pytest.mark.slow) for other in POWERS[1:])])
def test_a_law_may_raise_to_powers_that_belong_to_each_bond_or_species(power):
    names = {"np": np, "math": math}
    body = f"    r = np.sqrt(r2)\n    t = r\n    t **= n\n    u = k * {power}\n    return u, -n * u / r2\n"
    exec(f"def law(r2, k, n):\n{body}", names)
    law = names["law"]
    chain = md.System([[0, 0, 0], [1.3, 0, 0], [2.5, 0, 0]], species=list("ABA"), bonds=[[0, 1], [1, 2]])
    found = md.evaluate(chain, md.BondPotential(law, ([1.0, 2.0], [4.0, 6.0])))
    assert found.potential_energy == pytest.approx(1.3**4 + 2.0 * 1.2**6, rel=1e-12)  # rounding
    np.testing.assert_allclose(found.forces[0, 0], 4.0 * 1.3**3, rtol=1e-12)
    unlike = {"A": (1.0, 4.0), "B": (2.0, 9.0)}
    cut = {"cutoff": 2.0, "truncation": "truncated"}
    found = md.evaluate(chain, md.PairPotential(law, unlike, **cut, mixing="geometric", bonded_scale=(0.5, 0, 1)))
    assert found.potential_energy == pytest.approx(0.5 * 2.0**0.5 * (1.3**6 + 1.2**6), rel=1e-12)
    crystal, edges = md.lattice.crystal("sc", [4, 4, 4], 1.5)  # many atoms: the cluster list
    many = md.System(crystal, cell=edges, species=["A", "B"] * 32)
    alike = md.evaluate(
        many, md.PairPotential(law, {"A": (1.0, 4.0), "B": (1.0, 4.0)}, **cut, pairs={("A", "B"): (1.0, 6.0)})
    )
    assert alike.potential_energy == pytest.approx(64 * (2 * 1.5**4 + 1.5**6), rel=1e-12)
