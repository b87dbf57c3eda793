"""The bridge to MDAnalysis: universes that know the system, analyses with known results."""

import itertools
import warnings

import h5py
import numpy as np
import pytest
from charged_scenes import ions, run_of
from h5md_runs import PER_PICOSECOND, opened, simulation
from wrong_calls import assert_answered

import minimd as md
from minimd.core.files.claim import Claim
from minimd.core.files.h5md_digest import digest_of, sign
from minimd.core.files.h5md_reader import damage
from minimd.core.files.h5md_writer import H5MDWriter
from minimd.mdanalysis import Frames, diffusion_coefficient, mean_square_displacement, radial_distribution, universe
from minimd.view.check import liquid

LJ, ASE = md.units.LJ, md.units.ASE
UNITS = pytest.mark.parametrize("units", [pytest.param(LJ, marks=pytest.mark.slow), ASE], ids=lambda one: one.name)
TURNED = np.array([[0.3, 9.0, 0.5], [1.0, 3.5, 8.0], [8.5, -2.0, 1.0]])  # left-handed, along no axis
SKEWED = np.array([[1, 0, 0], [2, 1, 0], [-3, 1, 1]])  # SKEWED @ cell spans the same lattice
SITES = np.stack(np.meshgrid(*[np.arange(5.0)] * 3, indexing="ij"), -1).reshape(-1, 3)


@pytest.fixture
def path(tmp_path):
    return tmp_path / "a.h5md"


def still(system, timestep=0.5):
    """A simulation of a system whose atoms do not feel each other."""
    return md.Simulation(system, md.LennardJones(1e-12, 1e-6, 1e-3, "force-shifted"), md.VelocityVerlet(timestep))


def written(path, made, frames, steps=None):
    """A file of the given positions, one frame for each step."""
    sim = still(made)
    writer = H5MDWriter(Claim(path), sim.engine, False)
    for step, positions in zip(steps or range(len(frames)), frames, strict=True):
        writer.write(sim.frame()._replace(step=step, time=0.5 * step, positions=positions))
    sim.step = step
    writer.close()
    return path


@UNITS
def test_universe_knows_the_system_and_the_time_between_frames(path, units):
    """Also for those who open the file themselves: the first frame is written before the second is known."""
    sim = simulation("cubic", units)
    times = sim.run(20, every=5, trajectory=path).time / (PER_PICOSECOND if units is ASE else 1.0)
    with warnings.catch_warnings(action="error"):
        made, plain, in_memory = universe(path), opened(path), opened(path)
        in_memory.transfer_to_memory()
        for trajectory in (made.trajectory, plain.trajectory, in_memory.trajectory):
            assert trajectory.dt == pytest.approx(times[1], rel=1e-14)
            assert trajectory.totaltime == pytest.approx(times[-1], rel=1e-14)
            np.testing.assert_allclose([ts.time for ts in trajectory], times, rtol=1e-14)
    np.testing.assert_array_equal(made.atoms.masses, sim.system.masses)
    np.testing.assert_array_equal(made.atoms.bonds.indices, sim.system.bonds)
    for labels in (made.atoms.types, made.atoms.names, made.atoms.elements):
        assert labels.tolist() == sim.system.species.tolist()
    np.testing.assert_array_equal(made.trajectory[-1].positions, sim.positions.astype(np.float32))


def test_dt_of_a_file_that_does_not_hold_it_is_found_in_its_times(path):
    """As those of minimd 0.1.0; they can be continued too."""
    sim = simulation()
    sim.run(20, every=5, trajectory=path)
    with h5py.File(path, "r+") as h5:
        del h5["observables/dt"]
        blocks = h5["minimd/blocks"]
        series = [name for name in blocks.attrs["series"] if "/dt/" not in name]
        for row, (first, last) in enumerate(itertools.pairwise([0, *blocks[:, 0].astype(int)])):
            blocks[row] = last, digest_of({name: h5[name][first:last] for name in series})
        blocks.attrs["series"] = series
        sign(h5)
    with opened(path).trajectory as trajectory:
        assert "dt" not in trajectory.ts.data
    with universe(path).trajectory as trajectory:
        assert trajectory.dt == pytest.approx(0.02)
    md.Simulation.resume(path, sim.potentials).run(20, every=5, trajectory=path, append=True)
    made = universe(path).trajectory
    assert (made.dt, len(made), made.totaltime) == (pytest.approx(0.02), 9, pytest.approx(0.16))
    assert not damage(path)


def test_uneven_frames_and_missing_cells_are_told_and_dt_of_one_frame_is_that_of_the_run(path, tmp_path):
    sim = simulation()
    sim.run(3, every=5, trajectory=tmp_path / "b.h5md")
    one = universe(tmp_path / "b.h5md").trajectory
    assert (one.dt, one.totaltime) == (0.02, 0.0)
    sim.run(17, every=5, trajectory=path)
    with pytest.warns(UserWarning, match="2 to 5 steps apart") as caught:
        made = universe(path)
    assert (caught[0].filename, made.trajectory.dt) == (__file__, pytest.approx(0.02))
    with pytest.warns(UserWarning, match=r"has no cell.*pbc=\(True, True, False\)"):
        universe(simulation("slab without height"))
    assert_answered(lambda: sim.run(2, trajectory=path, append=True), OSError, "universe.trajectory.close()")
    made.trajectory.close()
    sim.run(2, trajectory=path, append=True)


def test_molecules_are_residues_and_labels_that_are_no_symbols_are_no_elements(path, tmp_path):
    """By bonds and by lengths that are held; their name is the formula, by Hill's order."""
    bonds, angles, rigid = [[0, 1], [0, 3], [5, 6], [5, 7]], [[1, 0, 3], [6, 5, 7]], [md.DistanceConstraints([[2, 4]])]
    species = ["C", "H", "N", "H", "N", "C", "H", "H", "Ar"]  # two chains, a rigid molecule and an atom, mixed
    polymers = md.System(3.0 * SITES[:9], cell=20.0, species=species, bonds=bonds, angles=angles, constraints=rigid)
    still(polymers).run(0, trajectory=path)
    made = universe(path)
    assert made.atoms.resids.tolist() == [1, 1, 2, 1, 2, 3, 3, 3, 4]
    assert made.residues.resnames.tolist() == ["CH2", "N2", "CH2", "Ar"]
    assert made.select_atoms("resid 3").indices.tolist() == [5, 6, 7]
    assert made.select_atoms("resname CH2 and name H").indices.tolist() == [1, 3, 6, 7]
    assert made.select_atoms("bonded index 5").indices.tolist() == [6, 7]
    assert made.atoms.angles.indices.tolist() == [[1, 0, 3], [6, 5, 7]]
    labelled = md.System(polymers.positions, species=["bead", "Ar", "bead"] * 3, bonds=[[0, 1]])
    still(labelled).run(0, trajectory=tmp_path / "b.h5md")
    made = universe(tmp_path / "b.h5md")
    assert made.residues.resnames.tolist() == ["MOL", "bead", "bead", "Ar", "bead", "bead", "Ar", "bead"]
    assert made.atoms.elements.tolist() == ["", "Ar", ""] * 3
    assert made.atoms.types.tolist() == ["bead", "Ar", "bead"] * 3


def test_charges_are_in_every_universe_and_come_back(path):
    sim, frames = run_of(ions(net=0.4)), Frames()
    sim.run(2, every=1, trajectory=path, observers=[frames])
    for made in (universe(path), universe(frames), universe(sim)):
        np.testing.assert_array_equal(md.System.from_mdanalysis(made).charges, sim.system.charges, strict=True)
        np.testing.assert_array_equal(md.System.from_mdanalysis(made.atoms[3:5]).charges, sim.system.charges[3:5])
    assert not hasattr(universe(simulation()).atoms, "charges")


@UNITS
def test_universe_in_memory_is_that_of_the_file(path, units):
    """Frames, times, cell and topology; observables in ts.data have the engine's bits."""
    sim, frames = simulation("triclinic", units), Frames()
    record = sim.run(10, every=5, trajectory=path, observers=[frames])
    second = sim.run(10, every=5, trajectory=path, append=True, observers=[frames])
    kept, stored = universe(frames), universe(path)
    assert len(kept.trajectory) == len(stored.trajectory) == len(frames) == 5
    assert kept.trajectory.dt == pytest.approx(stored.trajectory.dt, rel=1e-12)
    assert kept.trajectory.totaltime == pytest.approx(stored.trajectory.totaltime, rel=1e-12)
    for ours, theirs in zip(kept.trajectory, stored.trajectory, strict=True):
        for name in ("positions", "velocities", "dimensions", "time"):
            np.testing.assert_array_equal(getattr(ours, name), getattr(theirs, name))
        assert set(ours.data) == set(theirs.data)
        for name in theirs.data.keys() - {"dt"}:
            np.testing.assert_array_equal(ours.data[name], theirs.data[name])
    energies = [*record.total_energy, *second.total_energy[1:]]
    np.testing.assert_array_equal([ts.data["total_energy"] for ts in kept.trajectory], energies)
    assert kept.atoms.resids.tolist() == stored.atoms.resids.tolist()
    now, last = universe(sim).trajectory[0], stored.trajectory[-1]
    for name in ("positions", "velocities", "time"):
        np.testing.assert_array_equal(getattr(now, name), getattr(last, name))
    assert len(radial_distribution(frames, 20).r) == 20
    ours, theirs = (diffusion_coefficient(one, (0.0, 1e9)).coefficient for one in (frames, stored))
    assert ours == theirs


def test_radial_distribution_equals_counting_all_images(path):
    rng, n_atoms, n_frames, n_bins = np.random.default_rng(4), 24, 20, 6
    frames = [rng.uniform(-2.0, 2.0, (n_atoms, 3)) @ TURNED for _ in range(n_frames)]  # far outside of the cell too
    for positions in frames:
        positions[::2] = positions[1::2] + rng.normal(0.0, 0.6, (n_atoms // 2, 3))  # so that g(r) is not flat
    made = md.System(frames[0], masses=1.0, cell=SKEWED @ TURNED, units=ASE)
    r, g = radial_distribution(universe(written(path, made, frames)), n_bins)
    edges = np.linspace(0.0, 1.0, n_bins + 1) * md.Cell.of(TURNED).heights.min() / 2
    images, counts = np.stack(np.meshgrid(*[np.arange(-2, 3)] * 3), -1).reshape(-1, 3) @ TURNED, 0
    for positions in frames:
        apart = positions[None, :, :] - positions[:, None, :]
        apart -= np.round(apart @ np.linalg.inv(TURNED)) @ TURNED
        counts += np.histogram(np.linalg.norm(apart[:, :, None, :] + images, axis=-1), bins=[1e-6, *edges[1:]])[0]
    shells = 4 / 3 * np.pi * np.diff(edges**3)
    expected = counts / n_frames / n_atoms / (n_atoms - 1) * abs(np.linalg.det(TURNED)) / shells
    np.testing.assert_allclose(r, 0.5 * (edges[1:] + edges[:-1]), rtol=1e-6)
    np.testing.assert_allclose(g, expected, rtol=0.01)  # float32 may put a pair on the edge of a bin to the other side
    assert expected[0] > 2.0 > expected[-1] > 0.5


@UNITS
def test_diffusion_of_a_random_walk_is_that_of_its_steps(path, units):
    rng, n_atoms, n_frames, step = np.random.default_rng(6), 200, 200, 0.3
    walk = np.cumsum(rng.normal(0.0, step, (n_frames, n_atoms, 3)), axis=0)
    found = diffusion_coefficient(universe(written(path, md.System(walk[0], masses=1.0, cell=9.0, units=units), walk)))
    frame_time = 0.5 / (PER_PICOSECOND if units is ASE else 1.0)
    expected = pytest.approx(step**2 / 2.0 / frame_time, rel=0.05)  # <x²> = step² a frame = 2 D t; four standard errors
    assert found.coefficient == expected
    assert abs(found.coefficient - step**2 / 2.0 / frame_time) < 3.0 * found.error
    assert found.window[1] <= 0.25 * 199 * frame_time * (1.0 + 1e-6)
    assert found.cm2_per_s == (None if units is LJ else pytest.approx(found.coefficient * 1e-16 / 1e-12))
    assert diffusion_coefficient(path, (0.0, 10 * frame_time)).coefficient == expected


def test_what_cannot_be_analyzed_is_refused(path, tmp_path):
    ten = written(path, md.System(np.eye(3)), [np.eye(3)] * 10)
    one, slab = written(tmp_path / "b.h5md", md.System(np.eye(3)), [np.eye(3)]), universe(simulation("slab"))
    assert_answered(lambda: diffusion_coefficient(ten, (100.0, 200.0)), ValueError, "a lag and its double", "200.0")
    assert_answered(lambda: diffusion_coefficient(one), ValueError, "at least 2 frames")
    assert_answered(lambda: radial_distribution(slab), ValueError, "periodic in all directions")
    assert_answered(lambda: universe(Frames()), ValueError, "empty")


def test_where_the_spacing_of_frames_changes_a_new_series_begins(path):
    steps, velocity = [0, 1, 2, 4, 8], np.outer([1.0, 0.0, -1.0], [0.1, 0.2, 0.2])
    written(path, md.System(np.eye(3), cell=9.0), [np.eye(3) + 0.5 * step * velocity for step in steps], steps)
    lags, squares = mean_square_displacement(path)
    np.testing.assert_allclose(lags, 0.5 * np.array([0, 1, 2]))
    np.testing.assert_allclose(squares, 0.06 * lags**2, rtol=1e-6)


@pytest.mark.slow
def test_diffusing_liquid_is_told_with_its_peak_and_coefficient(path, tmp_path):
    noise = np.random.default_rng(4).normal(0.0, 0.1, (100, 125, 3))
    first, peak, second = liquid(written(path, md.System(SITES, cell=5.0), SITES + np.cumsum(noise, axis=0)))
    assert first.startswith("g(r)           of pairs of atoms, from ")
    assert peak.startswith("               X-X: first peak at ")
    assert second.startswith("diffusion      D = 0.0")  # D = 0.1² / (2 · 0.5)
    _, line, still = liquid(written(tmp_path / "still.h5md", md.System(SITES, cell=5.0), SITES + 0.1 * noise))
    assert "D = " not in still
    peak = line.partition("first peak at ")[2].split()[0]
    assert float(peak) == pytest.approx(1.0, abs=0.03)  # σ, next neighbors of the crystal


ROWS = np.array([
    ["CA", "C", "ALA", "5", "A"], ["CB", "C", "ALA", "5", "A"], ["OW", "O", "HOH", "6", "A"],
    ["OW", "O", "HOH", "6", "B"], ["X", "", "HOH", "-7", "B"],
])  # fmt: skip
SPREAD = 3.0 * np.arange(15.0).reshape(5, 3)


def test_names_residues_and_chains_are_those_of_the_topology(path):
    """Of a system, its copies, and a file; residues end where name, number or chain change."""
    system = md.System(SPREAD, masses=12.0, units=ASE, topology=ROWS, species=["C1", "C1", "O", "O", "X"])
    sim = still(system)
    sim.run(1, trajectory=path, progress=False)
    for run in sim, path:
        u = universe(run)
        assert u.system.topology.tolist() == ROWS.tolist()
        assert not u.system.topology.flags.writeable
        assert u.atoms.names.tolist() == ["CA", "CB", "OW", "OW", "X"]
        assert u.atoms.elements.tolist() == ["C", "C", "O", "O", ""]
        assert u.residues.resids.tolist() == [5, 6, 6, -7]
        assert u.select_atoms("protein").indices.tolist() == [0, 1]
        assert u.select_atoms("resname HOH").indices.tolist() == [2, 3, 4]
        assert u.select_atoms("segid B and chainID B").indices.tolist() == [3, 4]
    assert len(md.System(SPREAD).topology) == 0


@pytest.mark.parametrize(
    ("topology", "shown"),
    [
        (ROWS[:3], "(5, 5)"), (ROWS[:, :4], "(5, 5)"), (np.zeros((5, 5)), "(5, 5)"), ("protein", "protein"),
        (np.where(ROWS == "-7", "7A", ROWS), "7A"), (np.where(ROWS == "CB", "\x1b[2J", ROWS), "[1]"),
        (np.where(ROWS == "CB", "C\nB", ROWS), "[1]"), (np.where(ROWS == "-7", "9" * 30, ROWS), "999"),
    ],
)  # fmt: skip
def test_what_is_no_topology_is_answered_with_a_sentence(topology, shown):
    assert_answered(lambda: md.System(SPREAD, topology=topology), ValueError, "topology", shown)


@pytest.mark.parametrize("stored", [
    np.full((4, 5, 1), 49, np.uint8), np.full((5, 5, 1), 200, np.uint8), np.full((5, 5, 2), 27, np.uint8),
    np.full((5, 5), 49, np.uint8), np.full((5, 5, 3), 49.0), np.zeros((5, 5, 0), np.uint8), np.uint8(49),
], ids=lambda stored: f"{stored.dtype}{stored.shape}")  # fmt: skip
def test_a_topology_of_a_file_that_minimd_does_not_write_is_refused(path, stored):
    still(md.System(SPREAD, masses=12.0, units=ASE, topology=ROWS)).run(1, trajectory=path, progress=False)
    with h5py.File(path, "r+") as h5:
        del h5["minimd/topology"]
        h5["minimd/topology"] = stored
        sign(h5)
    assert_answered(lambda: universe(path), OSError, "a.h5md", "damaged")
