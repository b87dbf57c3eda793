"""Laws of the user's in the cache of compiled code: found again by the next process, and only if nothing that they read has changed."""

import copy
import os
import pickle
import subprocess
import sys
from pathlib import Path

import numba
import numpy as np
import pytest
from references import liquid

import minimd as md
from minimd.compiled.snapshot import Snapshot
from minimd.potentials import user_laws
from minimd.potentials.law import evaluate_law
from minimd.potentials.truncation import Shifted
from minimd.potentials.user_laws import is_recognized, is_user_law, user_law

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
    "constant": ("u = a", "u = 13.0 * a", 13.0 * UNCHANGED),
    "default": ("factor=1.0", "factor=17.0", 17.0 * UNCHANGED),
    "global": ("strength = 2.0", "strength = 4.0", 2.0 * UNCHANGED),
    "array": ("[1.0, 3.0]", "[1.0, 9.0]", 3.0 * UNCHANGED),
    "cell": ("make(11.0)", "make(5.5)", 0.5 * UNCHANGED),
    "helper of a helper": ("7.0 * x", "3.5 * x", 0.5 * UNCHANGED),
    "global without a digest": ("strength *", "place.x *", 2.5 * UNCHANGED),
}
EVALUATE = f"""
import minimd as md
def energy(source):
    names = {{"__name__": "__main__"}}
    exec(source, names)
    return md.evaluate(md.System([[0, 0, 0], [1, 0, 0]]), md.PairPotential(names["law"], (1.0,))).potential_energy
LAW, CHANGES = {LAW!r}, {CHANGES!r}
"""
EVERYWHERE = f"""
from numba.core import event
with event.install_recorder("numba:compile") as recorder:
    import minimd as md
    {LAW.replace(chr(10), chr(10) + "    ")}
    points = np.indices((n, n, n)).reshape(3, -1).T * 1.1
    forces = md.Forces(md.System(points, cell=1.1 * n), md.PairPotential(law, (1.0,), 2.0))
    forces.compute()
    assert ("cluster list" in forces.pair_search) == (n == 6), forces.pair_search
    two = md.System([[0, 0, 0], [1, 0, 0]], bonds=[(0, 1)])
    print(md.evaluate(two, [md.PairPotential(law, (1.0,)), md.BondPotential(law, (1.0,))]).potential_energy, forces.potential_energy)
print(len(recorder.buffer))
"""


def answer(code):
    environment = {**os.environ, "PYTHONPATH": str(Path(md.__file__).parents[1])}
    process = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False, env=environment)
    assert process.returncode == 0, process.stderr
    return [float(word) for word in process.stdout.split()]


def names_of(source, file="law.py"):
    names = {"__name__": "__main__"}
    exec(compile(source, file, "exec"), names)
    return names


def digest_of(source, file="law.py"):
    return Snapshot(names_of(source, file)["law"]).digest


@pytest.mark.parametrize("n", [3, pytest.param(6, marks=pytest.mark.slow)])
def test_second_process_compiles_nothing_for_a_law_of_the_user(n):
    """On the pair list, along bonds and, with 6³ atoms, on the cluster list, with helper functions; the numbers are those of the first process."""
    *first, _ = answer(f"n = {n}\n{EVERYWHERE}")
    *second, n_compiled = answer(f"n = {n}\n{EVERYWHERE}")
    assert n_compiled == 0
    assert first == second
    assert first[0] == pytest.approx(2.0 * UNCHANGED, rel=1e-14)  # rounding


def test_a_changed_law_is_compiled_again():
    """What changed is the law, its default, a global, an array, a closure cell, or a function called by one that it calls."""
    unchanged, *changed = answer(
        f"{EVALUATE}\nprint(energy(LAW), *(energy(LAW.replace(old, new)) for old, new, _ in CHANGES.values()))"
    )
    assert unchanged == pytest.approx(UNCHANGED, rel=1e-14)  # rounding
    assert changed == pytest.approx([expected for *_, expected in CHANGES.values()], rel=1e-14)


def test_the_digest_tells_what_changes_the_code_and_nothing_else():
    law = digest_of(LAW)
    assert digest_of("# a comment\n\n" + LAW, "elsewhere.py") == law
    assert digest_of(LAW + "\nunused = 3") == law
    for old, new, _ in list(CHANGES.values())[:-1]:
        assert digest_of(LAW.replace(old, new)) != law, new
    for old, new in (
        ("@numba.njit", "@numba.njit(fastmath=True)"),
        ("strength = 2.0", "strength = 2"),
        ("np.array([", "np.float32(["),
    ):
        assert digest_of(LAW.replace(old, new)) != law, new
    compiled = LAW + "\nlaw = numba.njit(law)"
    assert len({law, digest_of(compiled), digest_of(compiled.replace("njit(law)", "njit(fastmath=True)(law)"))}) == 3


def test_a_function_that_calls_itself_has_a_digest():
    source = "import numba\n@numba.njit\ndef law(r2, n):\n    return 1.0 if n < 1.0 else r2 * law(r2, n - 1.0)\n"
    snapshot = Snapshot(names_of(source)["law"])
    assert snapshot.digest == digest_of(source) != digest_of(source.replace("1.0 if", "2.0 if"))
    assert snapshot.function(3.0, 2.0) == snapshot.python(3.0, 2.0) == 9.0


@pytest.mark.parametrize(
    ("old", "new"),
    [
        ("strength *", "place.x *"),  # an object of a class of the user's
        (
            "strength = 2.0",
            "import numpy.ma as ma, sys; strength = sys",
        ),  # attributes of a module of the user's could change
        ("np.array([1.0, 3.0])", "[1.0, 3.0]"),
        ("np.array([1.0, 3.0])", "np.zeros(10**6)"),
        ("np.array([1.0, 3.0])", "np.zeros(8)[::2]"),
        ("@numba.njit\ndef inner", "@numba.njit('f8(f8)')\ndef inner"),
        ("@numba.njit\ndef inner", "def inner"),  # compiled by an overload, which may be anything
        ("        u =", "        import math\n        u ="),
        ("strength = 2.0", ""),
    ],
)
def test_what_may_change_unseen_has_no_digest(old, new):
    assert digest_of(LAW.replace(old, new)) == ""


def test_a_law_stays_what_it_was_when_the_potential_was_made():
    """Compiled or not: otherwise the cache would hold the code of a later state under the digest of an earlier one."""
    names, pair = names_of(LAW), md.System([[0, 0, 0], [1, 0, 0]])
    before = md.PairPotential(names["law"], (1.0,))
    names["strength"], names["table"][1] = 4.0, 30.0
    after = md.PairPotential(names["law"], (1.0,))
    for potential, factor in ((before, 1.0), (after, 20.0)):
        assert (
            potential.pair_energy(1.0)
            == md.evaluate(pair, potential).potential_energy
            == pytest.approx(factor * UNCHANGED, rel=1e-14)
        )


WITH_GAPS = "np.array([1.0, 0.0, 3.0])[::2]"
WITHOUT_DIGEST = {  # edits that take the digest from the law but leave its numbers, and a change of what it reads
    "an object of a class of the user's": (
        [("place = Place(5.0)", "place = Place(2.0)"), ("strength *", "place.x *")],
        "place = Place(9.0)",
    ),
    "an array with gaps": ([("np.array([1.0, 3.0])", WITH_GAPS)], "table[1] = 9.0"),
    "a name in a module": (
        [
            ("strength *", "params.strength *"),
            ("strength = 2.0", 'import types; params = types.ModuleType("params"); params.strength = 2.0'),
        ],
        "params.strength = 9.0",
    ),
    "an array of a helper": (
        [("7.0 * x", "scale[1] * x"), ("strength = 2.0", "strength = 2.0; scale = np.array([1.0, 1.0, 7.0])[::2]")],
        "scale[1] = 9.0",
    ),
}


@pytest.mark.parametrize("kind", WITHOUT_DIGEST)
def test_a_law_without_a_digest_stays_what_it_was_too(kind):
    """Its shift is computed in Python at each bind, its forces by code that is compiled at the first evaluation."""
    edits, change = WITHOUT_DIGEST[kind]
    source = LAW
    for old, new in edits:
        source = source.replace(old, new)
    names, pair = names_of(source), md.System([[0, 0, 0], [1, 0, 0]])
    potential = md.PairPotential(names["law"], (1.0,), 3.0)
    assert not is_recognized(potential.law)
    found = []
    for _ in range(2):
        exec(change, names)
        found += [md.evaluate(pair, potential).potential_energy, float(potential.pair_energy(1.0))]
    assert found == pytest.approx([UNCHANGED * (1.0 - 1.0 / 9.0)] * 4, rel=1e-14)  # rounding


def test_what_a_law_reads_must_be_there():
    with pytest.raises(TypeError, match=r"the law law must take .* name 'strength' is not defined"):
        md.PairPotential(names_of(LAW.replace("strength = 2.0", ""))["law"], (1.0,)).pair_energy(1.0)


@pytest.mark.parametrize("law", [len, dict, md.System, "law", (), (1.0, 2.0)])
def test_only_functions_and_law_types_are_laws(law):
    for potential in (md.PairPotential, md.BondPotential):
        with pytest.raises(TypeError, match="a law must be a function"):
            potential(law)


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


def test_a_law_can_be_sent_to_another_process():
    sent = pickle.dumps(user_law(names_of(LAW)["law"]))
    code = f"import pickle; from minimd.potentials.law import evaluate_law; print(*evaluate_law(pickle.loads({sent!r}), 1.0, (1.0,)))"
    assert answer(code) == pytest.approx([UNCHANGED, 2.0 * UNCHANGED], rel=1e-14)  # rounding


def test_law_types_of_earlier_runs_are_read():
    assert issubclass(getattr(user_laws, "UserLaw_" + "0" * 32), user_laws.UserLaw)
    with pytest.raises(AttributeError):
        user_laws.UserLaw_of_nobody  # noqa: B018


@pytest.mark.slow
def test_a_law_without_a_digest_runs_on_the_cluster_list():
    names, system = names_of(LAW.replace("strength *", "place.x *")), liquid(4)
    unclear = md.Forces(system, md.PairPotential(numba.njit(names["law"]), (1.0,), 2.0))
    clear = md.Forces(system, md.PairPotential(names_of(LAW)["law"], (2.5,), 2.0))
    for forces in (unclear, clear):
        forces.compute()
        assert "cluster list" in forces.pair_search
    np.testing.assert_allclose(unclear.forces, clear.forces, rtol=1e-12, atol=1e-8)  # rounding
