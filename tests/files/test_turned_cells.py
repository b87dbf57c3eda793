"""Cells that MDAnalysis places otherwise: universes and files are turned with them, and lead back."""

import pickle

import MDAnalysis
import numpy as np
import pytest
from MDAnalysis.lib.distances import distance_array
from scipy.spatial.transform import Rotation
from wrong_calls import assert_answered

import minimd as md
from minimd.core.files.turned_cell import ROTATION, Turn, finds_all_images
from minimd.core.structure.cell import Cell
from minimd.mdanalysis import Frames, universe
from minimd.view.check import check_file
from minimd.view.page import motion_of

TRICLINIC = np.array([[5.0, 0.0, 0.0], [1.5, 4.5, 0.0], [-1.0, 1.2, 4.0]])
SOMEHOW = Rotation.from_euler("xyz", [0.7, -1.1, 2.3]).as_matrix()
CELLS = {
    "turned": TRICLINIC @ SOMEHOW,
    "left-handed": TRICLINIC[[1, 0, 2]],
    "skewed": np.array([[1, 0, 0], [2, 1, 0], [-3, 1, 1]]) @ TRICLINIC,
    "all of it": np.array([[1, 0, 0], [2, -1, 0], [-3, 1, 1]]) @ TRICLINIC @ SOMEHOW,
}
FLOAT32 = 6e-6  # of float32, in coordinates up to 40


def images(reach):
    return np.stack(np.meshgrid(*[np.arange(-reach, reach + 1)] * 3, indexing="ij"), -1).reshape(-1, 3)


def moving(vectors):
    """16 atoms, some outside the cell, that hardly feel each other."""
    rng = np.random.default_rng(4)
    made = md.System(rng.uniform(-1.0, 2.0, (16, 3)) @ vectors, velocities=rng.normal(0.0, 1.0, (16, 3)), cell=vectors)
    return md.Simulation(made, md.LennardJones(0.01, 0.3, 1.2, "force-shifted"), md.VelocityVerlet(0.002))


def nearest_distances(positions, lattice):
    """(N, N), by trying 125 images of differences that were brought near 0 before."""
    apart = positions[None, :] - positions[:, None]
    apart -= np.rint(apart @ np.linalg.inv(lattice)) @ lattice
    return np.linalg.norm(apart[:, :, None] + images(2) @ lattice, axis=-1).min(axis=-1)


@pytest.mark.filterwarnings("ignore:.* turned")
@pytest.mark.parametrize("kind", CELLS)
def test_universes_and_files_have_the_distances_of_the_run(tmp_path, kind):
    """In a file, in memory, and through MDAnalysis' own formats; each vector leads back by R."""
    sim, frames = moving(CELLS[kind]), Frames()
    names = [tmp_path / f"a.{suffix}" for suffix in ("h5md", "trr", "ncdf", "xtc")]
    with pytest.warns(UserWarning, match="trajectory .* is turned"):
        sim.run(10, every=5, trajectory=names, store_forces=True, observers=[frames])
    expected = nearest_distances(sim.positions, TRICLINIC @ SOMEHOW if kind in ("turned", "all of it") else TRICLINIC)
    own = [universe(names[0]), universe(frames), universe(sim)]
    several = [*own, *(MDAnalysis.Universe(own[0]._topology, str(name)) for name in names[1:])]
    for made in several:
        ts, precision = made.trajectory[-1], 2e-3 if made is several[-1] else FLOAT32
        assert np.abs(distance_array(ts.positions, ts.positions, box=ts.dimensions) - expected).max() < precision
    for made in own:
        ts = made.trajectory[-1]
        back = ts.data[ROTATION].T
        assert np.linalg.det(back) == pytest.approx(1.0)
        np.testing.assert_allclose(ts.positions @ back, sim.positions, atol=FLOAT32)
        np.testing.assert_allclose(ts.velocities @ back, sim.velocities, atol=FLOAT32)
        np.testing.assert_array_equal(ts.data["momentum"], sim.frame().observables["momentum"])
    np.testing.assert_allclose(own[0].trajectory[-1].forces @ back, sim.forces, atol=1e-6 * np.abs(sim.forces).max())


@pytest.mark.filterwarnings("ignore:.* turned")
def test_a_turned_universe_is_copied_pickled_transformed_and_checked(tmp_path):
    """Users may add transformations of their own, which MDAnalysis allows only once."""
    sim, file = moving(CELLS["all of it"]), tmp_path / "a.h5md"
    sim.run(10, every=5, trajectory=file)
    made = universe(file)
    made.trajectory[1]
    for same in (made.copy(), pickle.loads(pickle.dumps(made))):
        np.testing.assert_array_equal(same.trajectory[1].positions, made.trajectory[1].positions)
    apart, cell = motion_of(made, 3).positions(2) - sim.positions, sim.system.cell
    np.testing.assert_allclose(apart, np.rint(apart @ cell.inverse) @ cell.lattice, atol=1e-4)
    made.trajectory.add_transformations(lambda ts: ts)
    assert all(one.passed for one in check_file(file).comparisons)
    own = MDAnalysis.Universe.empty(16, trajectory=False)
    own.load_new(str(file), format="H5MD")
    own.trajectory.add_transformations(Turn(cell))
    np.testing.assert_array_equal(own.trajectory[1].positions, made.trajectory[1].positions)
    assert_answered(lambda: Turn(Cell.of([3.0, 3.0, 0.0])), ValueError, "three independent vectors")


def test_a_linear_program_says_whether_27_images_are_enough():
    """Against trying: random differences, as MDAnalysis brings them into the cell, and its 27 images."""
    rng, seen = np.random.default_rng(1), set()
    for _ in range(24):
        vectors = np.tril(rng.uniform(-1.2, 1.2, (3, 3)), -1) + np.eye(3)
        parts = rng.uniform(-1.0, 1.0, (400, 3))
        found, true = (np.linalg.norm((parts[:, None] + images(n)) @ vectors, axis=-1).min(axis=1) for n in (1, 3))
        seen.add((finds_all_images(Cell.of(vectors)), bool(np.abs(found - true).max() < 1e-12)))
    assert {(True, True), (False, False)} <= seen
    assert (True, False) not in seen
