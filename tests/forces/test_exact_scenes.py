"""Fixed-point runs have the same bits on every processor and for atoms in any order: twelve scenes, two hashes each.

`python tests/exact_scenes.py [STEPS [SCENE ...]]` prints the hashes, of the motion and of energies and pressures; those
of 100 steps are kept in tests/data. release/same_bits.py compares them on several processors.
"""

from pathlib import Path

import numpy as np
import pytest
from exact_scenes import SCENES, Run, moves_of
from processes import ended

from minimd.core.compiled.fixed_point import sum_in_any_order
from minimd.core.compiled.simd import vector
from minimd.core.potentials.prolates import prolate

DATA = Path(__file__).parents[1] / "data" / "fixed_point_hashes.txt"
HASHES = {line[35:]: line[:33] for line in DATA.read_text().splitlines()}
FAST = ("melt", "salt", "net charge", "salt, fixed atoms")
EACH = [pytest.param(name, marks=() if name in FAST else pytest.mark.slow) for name in SCENES]
OTHER_LIBRARIES = {"NPY_DISABLE_CPU_FEATURES": "X86_V3", "OPENBLAS_CORETYPE": "Nehalem"}

pytestmark = pytest.mark.filterwarnings("ignore")


def hash_in_another_process(name, **environment):
    script = str(Path(__file__).parents[1] / "exact_scenes.py")
    return ended("-W", "ignore", script, "100", name, **environment).stdout[:33]


@pytest.mark.parametrize("name", EACH)
def test_each_scene_has_one_hash_however_its_atoms_are_numbered_wrapped_and_moved(name):
    """Of rigid bonds positions after a drift are rounded in float64, which depends on where they are."""
    run = Run(name)
    assert run.hash == HASHES[name]
    assert Run(name, np.random.default_rng(5).permutation(len(run.order))).hash == run.hash
    if run.simulation.rigid_bonds is None:
        grid = run.simulation.engine.interactions.grid
        assert Run(name, moves=moves_of(name, grid), grid=grid).hash == run.hash


@pytest.mark.slow
@pytest.mark.parametrize("lanes", [4, 8])
def test_vectors_of_four_and_eight_numbers_give_these_hashes(lanes, monkeypatch):
    monkeypatch.setattr(vector, "register_bits", lambda: 64 * lanes)
    vector.lanes_for.cache_clear()
    try:
        assert {name: Run(name).hash for name in SCENES} == HASHES
    finally:
        vector.lanes_for.cache_clear()


@pytest.mark.slow
@pytest.mark.parametrize("environment", [{"MINIMD_VECTORS": "avx2"}, {"MINIMD_VECTORS": "sse-exact"}, OTHER_LIBRARIES])
def test_so_do_older_instructions_of_kernels_and_of_numpy_and_blas(environment):
    assert {name: hash_in_another_process(name, **environment) for name in SCENES} == HASHES


def test_a_processor_that_rounds_twice_is_told(monkeypatch):
    monkeypatch.setenv("MINIMD_VECTORS", "sse")
    with pytest.warns(UserWarning, match="no fused multiply-add.*MINIMD_VECTORS=sse-exact"):
        Run("melt", n_steps=2)


def test_the_sum_of_terms_does_not_depend_on_their_order():
    terms = np.random.default_rng(1).normal(size=(1000, 2)) * np.array([1.0, 1e-3])
    sums = [sum_in_any_order(terms[order]) for order in (slice(None), slice(None, None, -1), np.argsort(terms[:, 0]))]
    assert np.array_equal(sums[0], sums[1])
    assert np.array_equal(sums[0], sums[2])
    assert sums[0] == pytest.approx(terms.sum(axis=0), abs=1e-10)


@pytest.mark.parametrize("bandwidth", [2.0, 7.3, 20.1, 40.0])
def test_the_prolate_function_is_the_first_eigenvector(bandwidth):
    """ψ₀ against LAPACK."""
    from scipy.linalg import eigh_tridiagonal

    k = 2.0 * np.arange(30 + int(bandwidth))
    diagonal = k * (k + 1.0) + (2.0 * k * (k + 1.0) - 1.0) / ((2.0 * k + 3.0) * (2.0 * k - 1.0)) * bandwidth**2
    beside = (k + 2.0) * (k + 1.0) / ((2.0 * k + 3.0) * np.sqrt((2.0 * k + 1.0) * (2.0 * k + 5.0))) * bandwidth**2
    vector_of_lapack = eigh_tridiagonal(diagonal, beside[:-1], select="i", select_range=(0, 0))[1][:, 0]
    series = vector_of_lapack * np.sqrt(k + 0.5)
    assert prolate(bandwidth).series[::2] == pytest.approx(series / series[0], abs=1e-13)
