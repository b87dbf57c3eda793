"""The order of bonds in perfect crystals is the known one, in any cell."""

import numpy as np
import pytest
from wrong_calls import answered

import minimd as md

HCP = np.array([[0.0, 0, 0], [1, 1, 0], [1, 1 / 3, 1], [0, 4 / 3, 1]]) * [0.5, 3**0.5 / 2, (2 / 3) ** 0.5]
LATTICES = {  # positions, edges of a cell
    "fcc": md.lattice.crystal("fcc", [1] * 3, 1.6),
    "bcc": md.lattice.crystal("bcc", [1] * 3, 1.3),
    "hcp": (HCP, np.array([1.0, 3**0.5, (8 / 3) ** 0.5])),
}
FREE = md.LennardJones(1e-12, 1e-3, 0.1, "force-shifted")
KNOWN = {  # q4, q6
    "fcc": (0.1909, 0.5745),
    "bcc": (0.0364, 0.5107),
    "hcp": (0.0972, 0.4848),
}


def looked_at(system, *arguments, **options):
    looking = md.observers.BondOrder(*arguments, every=1, **options)
    md.Simulation(system, FREE, md.VelocityVerlet(1e-9)).run(0, observers=[looking])
    return looking.result()


@pytest.mark.filterwarnings("ignore")
@pytest.mark.parametrize("lattice", LATTICES)
def test_crystals_have_their_orders(lattice):
    """Of few atoms, whose neighbors are images of each other, and turned: all atoms are alike."""
    pytest.importorskip("freud")
    positions, edges = LATTICES[lattice]
    turn = np.linalg.qr(np.random.default_rng(1).normal(size=(3, 3)))[0]
    system = md.System(positions @ turn, cell=np.diag(edges) @ turn)
    result = looked_at(system, ["q4", "q6"])
    expected = np.repeat(KNOWN[lattice], 2)
    if lattice == "hcp":
        assert (result.values[[1, 3]] < result.values[[0, 2]] + 1e-6).all()
        expected[[1, 3]] = result.values[[1, 3]]
    np.testing.assert_allclose(result.values, expected, atol=6e-5)  # four digits


@pytest.mark.filterwarnings("ignore")
def test_a_triangular_lattice_is_hexatic():
    pytest.importorskip("freud")
    rows = np.array([[i + 0.5 * (j % 2), j * 0.75**0.5, 0.0] for j in range(8) for i in range(8)])
    system = md.System(rows, cell=[8.0, 8 * 0.75**0.5, 9.0])
    np.testing.assert_allclose(looked_at(system, "psi6", cutoff=1.3).values, 1.0, atol=1e-6)  # float32
    assert looked_at(system, "psi4", cutoff=1.3).psi4 < 1e-6
    alone = md.System(np.zeros((1, 3)), cell=9.0)
    np.testing.assert_array_equal(looked_at(alone, ["q6", "psi6"], cutoff=1.3).values, 0.0)


test_wrong_orders_are_refused = answered(
    (lambda: md.observers.BondOrder("q21"), ValueError, "order", "'q21'"),
    (lambda: md.observers.BondOrder(["q6", "psi"]), ValueError, "order", "'psi'"),
    (lambda: md.observers.BondOrder(cutoff=0.0), ValueError, "cutoff", "0"),
    (lambda: looked_at(md.System(np.zeros((1, 3)), cell=9.0, pbc=[1, 1, 0])), ValueError, "volume", "False"),
)


@pytest.mark.filterwarnings("ignore")
def test_of_one_species_both_atoms_and_neighbors_are_meant():
    """Another species in the gaps of an fcc crystal changes nothing, nor the cutoff that is not given."""
    pytest.importorskip("freud")
    positions, edges = md.lattice.crystal("fcc", [3, 3, 3], 1.6)
    both = np.concatenate([positions, positions + 0.8])
    salt = md.System(both, cell=edges, species=["A"] * len(positions) + ["B"] * len(positions))
    alone = looked_at(salt, ["q4", "q6"], species="A").values
    np.testing.assert_allclose(alone, np.repeat(KNOWN["fcc"], 2), atol=6e-5)  # four digits
    assert abs(looked_at(salt, ["q4", "q6"]).values - alone).max() > 0.1


test_wrong_species_are_refused = answered(
    (lambda: md.observers.BondOrder(species=["A", "A"]), ValueError, "species", "'A'"),
    (lambda: looked_at(md.System(np.eye(3), cell=9.0), species="A"), ValueError, "species", "X", "'A'"),
)
