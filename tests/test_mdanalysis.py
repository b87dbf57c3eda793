"""The bridge to MDAnalysis: universes that know the system, analyses with known results."""

import warnings

import h5py
import MDAnalysis
import numpy as np
import pytest
from h5md_runs import opened
from loose_lattice import PER_PICOSECOND, TURNED_CELL, simulation, system
from MDAnalysis.analysis.msd import EinsteinMSD
from scipy.stats import linregress

import minimd as md
from minimd.analysis.check import liquid, recompute
from minimd.files.claim import Claim
from minimd.files.h5md_digest import digest_of_block, sign
from minimd.files.h5md_reader import damage
from minimd.files.h5md_writer import H5MDWriter
from minimd.files.turned_cell import as_in_run
from minimd.mdanalysis import (
    Frames,
    diffusion_coefficient,
    mean_square_displacement,
    radial_distribution,
    universe,
    universes,
)

SKEWED = np.array([[1, 0, 0], [2, 1, 0], [-3, 1, 1]])  # SKEWED @ cell spans the same lattice


def written(path, made, frames):
    """A file of the given positions, one frame for each step."""
    sim = md.Simulation(made, md.LennardJones(1e-12, 1e-6, 1e-3), md.VelocityVerlet(0.5))
    writer = H5MDWriter(Claim(path), sim.engine, False)
    for step, positions in enumerate(frames):
        writer.write(sim.frame()._replace(step=step, time=0.5 * step, positions=positions))
    sim.step = len(frames) - 1
    writer.close()
    return path


def test_universe_knows_the_system(tmp_path):
    sim = simulation()
    sim.run(4, every=2, trajectory=tmp_path / "a.h5md")
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        made = universe(tmp_path / "a.h5md")
    np.testing.assert_array_equal(made.atoms.masses, sim.system.masses)
    np.testing.assert_array_equal(made.atoms.bonds.indices, sim.system.bonds)
    assert (
        made.atoms.types.tolist()
        == made.atoms.names.tolist()
        == made.atoms.elements.tolist()
        == sim.system.species.tolist()
    )
    assert len(made.trajectory) == 3
    np.testing.assert_array_equal(made.trajectory[-1].positions, sim.positions.astype(np.float32))


@pytest.mark.parametrize("units", [md.units.LJ, md.units.ASE], ids=lambda units: units.name)
@pytest.mark.parametrize("who", ["universe", "the user", "the user, in memory"])
def test_dt_is_the_time_between_frames(tmp_path, units, who):
    """Also for those who open the file themselves, and from its first frame on, which is written before the second is known."""
    record = simulation(system(units=units)).run(20, every=5, trajectory=tmp_path / "a.h5md")
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        made = universe(tmp_path / "a.h5md") if who == "universe" else opened(tmp_path / "a.h5md", 24)
        if who == "the user, in memory":
            made.transfer_to_memory()
        trajectory, times = made.trajectory, record.time / (PER_PICOSECOND if units is md.units.ASE else 1.0)
        assert trajectory.dt == pytest.approx(times[1], rel=1e-14)
        assert trajectory.totaltime == pytest.approx(times[-1], rel=1e-14)
        np.testing.assert_allclose([ts.time for ts in trajectory], times, rtol=1e-14)


def test_dt_of_one_frame_is_that_of_the_run(tmp_path):
    simulation(system(units=md.units.LJ)).run(3, every=5, trajectory=tmp_path / "a.h5md")
    assert universe(tmp_path / "a.h5md").trajectory.dt == 2.0
    assert universe(tmp_path / "a.h5md").trajectory.totaltime == 0.0


def test_dt_of_a_file_that_does_not_hold_it_is_found_in_its_times(tmp_path):
    """As those of minimd 0.1.0; they can be continued too."""
    path, sim = tmp_path / "a.h5md", simulation(system(units=md.units.LJ))
    sim.run(20, every=5, trajectory=path)
    without_spacing(path)
    with opened(path, 24).trajectory as trajectory:
        assert "dt" not in trajectory.ts.data
    with universe(path).trajectory as trajectory:
        assert trajectory.dt == 2.0
    md.Simulation.resume(path, sim.potentials).run(20, every=5, trajectory=path, append=True)
    made = universe(path)
    assert (made.trajectory.dt, len(made.trajectory), made.trajectory.totaltime) == (2.0, 9, 16.0)
    assert not damage(path)


def without_spacing(path):
    """Make of a file one as minimd 0.1.0 wrote it, without the time between frames."""
    with h5py.File(path, "r+") as h5:
        del h5["observables/dt"]
        blocks = h5["minimd/blocks"]
        series, first = [name for name in blocks.attrs["series"] if "/dt/" not in name], 0
        for row, (last, _) in enumerate(blocks[:].tolist()):
            blocks[row] = last, digest_of_block({name: h5[name][first:last] for name in series})
            first = last
        blocks.attrs["series"] = series
        sign(h5)


def test_uneven_frames_are_told(tmp_path):
    path, sim = tmp_path / "a.h5md", simulation()
    sim.run(3)
    sim.run(17, every=5, trajectory=path)
    with pytest.warns(UserWarning, match="are 2 to 5 steps apart") as caught:
        made = universe(path)
    assert caught[0].filename == __file__
    assert made.trajectory.dt == pytest.approx(5 * 0.4 / PER_PICOSECOND)


def polymers(units=md.units.LJ):
    """Two chains of three beads, a diatomic molecule held rigid, and an atom; numbered across each other."""
    rng = np.random.default_rng(5)
    return md.System(
        3.0
        * rng.permutation(np.stack(np.meshgrid(*[np.arange(3)] * 3, indexing="ij"), -1).reshape(-1, 3))[:9].astype(
            float
        ),
        masses=np.arange(1.0, 10.0),
        cell=20.0,
        species=["C", "H", "N", "H", "N", "C", "H", "H", "Ar"],
        bonds=[[0, 1], [0, 3], [5, 6], [5, 7]],
        angles=[[1, 0, 3], [6, 5, 7]],
        constraints=[md.DistanceConstraints([[2, 4]])],
        units=units,
    )


def test_molecules_are_residues(tmp_path):
    """By bonds and by lengths that are held; their name is the formula, by Hill's order."""
    simulation(polymers()).run(0, trajectory=tmp_path / "a.h5md")
    made = universe(tmp_path / "a.h5md")
    assert made.atoms.resids.tolist() == [1, 1, 2, 1, 2, 3, 3, 3, 4]
    assert made.residues.resnames.tolist() == ["CH2", "N2", "CH2", "Ar"]
    assert made.select_atoms("resid 3").indices.tolist() == [5, 6, 7]
    assert made.select_atoms("resname CH2 and name H").indices.tolist() == [1, 3, 6, 7]
    assert made.select_atoms("bonded index 5").indices.tolist() == [6, 7]
    assert made.atoms.angles.indices.tolist() == [[1, 0, 3], [6, 5, 7]]
    labelled = md.System(polymers().positions, species=["A", "B", "A"] * 3, bonds=[[0, 1]])
    simulation(labelled).run(0, trajectory=tmp_path / "b.h5md")
    assert universe(tmp_path / "b.h5md").residues.resnames.tolist() == ["MOL", "A", "A", "B", "A", "A", "B", "A"]


@pytest.mark.parametrize("units", [md.units.LJ, md.units.ASE], ids=lambda units: units.name)
def test_universe_in_memory_is_that_of_the_file(tmp_path, units):
    """Frames, times, cell and topology; observables in ts.data have the engine's bits."""
    sim, frames = simulation(polymers(units)), Frames()
    record = sim.run(10, every=5, trajectory=tmp_path / "a.h5md", observers=[frames])
    second = sim.run(10, every=5, trajectory=tmp_path / "a.h5md", append=True, observers=[frames])
    kept, stored = universe(frames), universe(tmp_path / "a.h5md")
    assert len(kept.trajectory) == len(stored.trajectory) == len(frames) == 5
    assert kept.trajectory.dt == pytest.approx(stored.trajectory.dt, rel=1e-12)
    assert kept.trajectory.totaltime == pytest.approx(stored.trajectory.totaltime, rel=1e-12)
    for ours, theirs in zip(kept.trajectory, stored.trajectory, strict=True):
        for name in ("positions", "velocities", "dimensions"):
            np.testing.assert_array_equal(getattr(ours, name), getattr(theirs, name))
        assert ours.time == theirs.time
        assert set(ours.data) == set(theirs.data)
        for name in theirs.data.keys() - {"dt"}:
            np.testing.assert_array_equal(ours.data[name], theirs.data[name])
    energies = [ts.data["total_energy"] for ts in kept.trajectory]
    np.testing.assert_array_equal(energies, [*record.total_energy, *second.total_energy[1:]])
    assert kept.atoms.resids.tolist() == stored.atoms.resids.tolist()
    assert len(radial_distribution(frames, 20).r) == 19
    assert (
        diffusion_coefficient(frames, (0.0, 1e9)).coefficient == diffusion_coefficient(stored, (0.0, 1e9)).coefficient
    )


def test_simulation_as_a_universe_is_its_present_state():
    sim = simulation(polymers())
    sim.run(3, every=3)
    made = universe(sim)
    np.testing.assert_array_equal(made.atoms.positions, sim.positions.astype(np.float32))
    np.testing.assert_array_equal(made.atoms.velocities, sim.velocities.astype(np.float32))
    assert made.trajectory.ts.data["total_energy"] == sim.frame().observables["total_energy"]
    assert (made.trajectory.time, made.trajectory.ts.data["step"], made.trajectory.totaltime) == (
        pytest.approx(1.2),
        3,
        0.0,
    )
    with pytest.raises(ValueError, match="these Frames are empty"):
        universe(Frames())


def test_d_by_the_usual_lines_is_that_of_minimd(tmp_path):
    """Lags from trajectory.dt, as everybody writes it."""
    rng = np.random.default_rng(6)
    walk = np.cumsum(rng.normal(0.0, 0.3, (40, 50, 3)), axis=0)
    walk -= walk.mean(axis=1, keepdims=True)
    path = written(tmp_path / "a.h5md", md.System(walk[0], masses=1.0, cell=9.0, units=md.units.ASE), walk)
    made = universe(path)
    msd = EinsteinMSD(made, msd_type="xyz", fft=False).run()
    lags = np.arange(msd.n_frames) * made.trajectory.dt
    chosen = slice(4, 20)
    usual = linregress(lags[chosen], msd.results.timeseries[chosen]).slope / 6.0
    ours = diffusion_coefficient(path, (3.5 * made.trajectory.dt, 19.5 * made.trajectory.dt)).coefficient
    assert usual == pytest.approx(ours, rel=1e-6)


def test_labels_that_are_no_symbols_are_no_elements(tmp_path):
    made = system(units=md.units.LJ)
    labelled = md.System(made.positions, species=np.where(np.arange(24) % 2, "Ar", "bead"))
    simulation(labelled).run(0, trajectory=tmp_path / "a.h5md")
    read = universe(tmp_path / "a.h5md").atoms
    assert read.elements.tolist() == ["", "Ar"] * 12
    assert read.types.tolist() == ["bead", "Ar"] * 12


@pytest.mark.parametrize(("distances", "every"), [(1e9, 1), (2e3, 6)])  # from every atom; from a few
@pytest.mark.parametrize("units", [md.units.LJ, md.units.ASE], ids=lambda units: units.name)
def test_radial_distribution_equals_counting_all_images(tmp_path, monkeypatch, units, distances, every):
    rng = np.random.default_rng(4)
    cell, n_atoms, n_frames, n_bins = TURNED_CELL, 24, 20, 6
    frames = [rng.uniform(-2.0, 2.0, (n_atoms, 3)) @ cell for _ in range(n_frames)]  # far outside of the cell too
    for positions in frames:
        positions[::2] = positions[1::2] + rng.normal(0.0, 0.6, (n_atoms // 2, 3))  # so that g(r) is not flat
    monkeypatch.setattr(universes, "RDF_DISTANCES", distances)
    made = md.System(frames[0], masses=1.0, cell=SKEWED @ cell, units=units)
    r, g = radial_distribution(written(tmp_path / "a.h5md", made, frames), n_bins)
    edges = np.linspace(1 / n_bins, 1.0, n_bins) * md.Cell.of(cell).heights.min() / 2
    counts = sum(counted(positions, cell, edges, every) for positions in frames)
    shells = 4 / 3 * np.pi * np.diff(edges**3)
    expected = counts / n_frames / (n_atoms / every) / (n_atoms - 1) * abs(np.linalg.det(cell)) / shells
    np.testing.assert_allclose(r, 0.5 * (edges[1:] + edges[:-1]), rtol=1e-6)
    np.testing.assert_allclose(g, expected, rtol=0.01)  # float32 may put a pair on the edge of a bin to the other side
    assert expected[0] > 2.0 > expected[-1] > 0.5


def counted(positions, cell, edges, every):
    """Distances from every so manieth atom to all images of all atoms, as a histogram: every image that could matter."""
    inverse = np.linalg.inv(cell)
    vectors = positions[None, :, :] - positions[::every][:, None, :]
    vectors -= np.round(vectors @ inverse) @ cell
    images = np.stack(np.meshgrid(*[np.arange(-2, 3)] * 3), -1).reshape(-1, 3) @ cell
    return np.histogram(np.linalg.norm(vectors[:, :, None, :] + images, axis=-1), bins=edges)[0]


def test_radial_distribution_needs_full_periodicity(tmp_path):
    simulation(system((9.0, 10.0, 11.0), (True, True, False))).run(0, trajectory=tmp_path / "a.h5md")
    with pytest.raises(ValueError, match="periodic in all directions"):
        radial_distribution(tmp_path / "a.h5md")


@pytest.mark.parametrize("units", [md.units.LJ, md.units.ASE], ids=lambda units: units.name)
def test_diffusion_of_a_random_walk_is_that_of_its_steps(tmp_path, units):
    rng, n_atoms, n_frames, step = np.random.default_rng(6), 500, 100, 0.3
    walk = np.cumsum(rng.normal(0.0, step, (n_frames, n_atoms, 3)), axis=0)
    path = written(tmp_path / "a.h5md", md.System(walk[0], masses=1.0, cell=9.0, units=units), walk)
    found = diffusion_coefficient(path)
    frame_time = 0.5 / (PER_PICOSECOND if units is md.units.ASE else 1.0)
    expected = step**2 / 2.0 / frame_time  # <x²> = step² a frame = 2 D t
    assert found.coefficient == pytest.approx(expected, rel=0.05)  # statistics: four standard errors of 500 walkers
    assert found.window == pytest.approx((0.1 * 99 * frame_time, 0.5 * 99 * frame_time))
    assert (found.cm2_per_s is None) == (units is md.units.LJ)
    if units is md.units.ASE:
        assert found.cm2_per_s == pytest.approx(found.coefficient * 1e-16 / 1e-12)
    assert diffusion_coefficient(path, (0.0, 20 * frame_time)).coefficient == pytest.approx(expected, rel=0.05)


def test_window_of_a_fit_must_hold_points(tmp_path):
    path = written(tmp_path / "a.h5md", md.System(np.eye(3)), [np.eye(3)] * 10)
    with pytest.raises(ValueError, match="at least 3 lags"):
        diffusion_coefficient(path, (100.0, 200.0))
    with pytest.raises(ValueError, match="at least 2 frames"):
        diffusion_coefficient(written(tmp_path / "b.h5md", md.System(np.eye(3)), [np.eye(3)]))


def test_displacement_of_unevenly_spaced_frames_is_that_of_their_times(tmp_path):
    steps, velocity = [0, 1, 2, 4, 8], np.outer([1.0, 0.0, -1.0], [0.1, 0.2, 0.2])
    made = md.System(np.eye(3), cell=9.0)
    sim = md.Simulation(made, md.LennardJones(1e-12, 1e-6, 1e-3), md.VelocityVerlet(0.5))
    writer = H5MDWriter(Claim(tmp_path / "a.h5md"), sim.engine, False)
    for step in steps:
        writer.write(sim.frame()._replace(step=step, time=0.5 * step, positions=np.eye(3) + 0.5 * step * velocity))
    writer.close()
    lags, squares = mean_square_displacement(tmp_path / "a.h5md")
    np.testing.assert_allclose(lags, 0.5 * np.array([0, 1, 2, 3, 4, 6, 7, 8]))
    np.testing.assert_allclose(squares, 0.06 * lags**2, rtol=1e-6)


@pytest.mark.parametrize("units", [md.units.LJ, md.units.ASE], ids=lambda units: units.name)
def test_moments_recomputed_from_velocities_are_those_of_the_record(tmp_path, units):
    record = simulation(system(units=units)).run(40, every=10, trajectory=tmp_path / "a.h5md")
    moved = recompute(tmp_path / "a.h5md")
    np.testing.assert_array_equal(moved.step, record.step)
    np.testing.assert_allclose(moved.time, record.time, rtol=1e-14)
    np.testing.assert_allclose(moved.kinetic_energy, record.kinetic_energy, rtol=1e-6)
    assert np.linalg.norm(moved.momentum - record.momentum, axis=1).max() < 6e-8 * record.absolute_momentum.max()
    np.testing.assert_array_equal(moved.stored["total_energy"], record.total_energy)
    assert np.ptp(record.kinetic_energy) > 1e-4 * record.kinetic_energy[0]


def test_warning_about_a_turned_cell_shows_the_line_of_the_user(tmp_path):
    made = md.System(np.eye(3), cell=np.array([[0.0, 9.0, 0.0], [9.0, 0.0, 0.0], [0.0, 0.0, 9.0]]))
    sim = md.Simulation(made, md.LennardJones(1e-12, 1e-6, 1e-3), md.VelocityVerlet(0.5))
    with pytest.warns(UserWarning, match="is turned, because MDAnalysis holds a cell as lengths") as caught:
        sim.run(2, every=1, trajectory=tmp_path / "a.nc")
    assert caught[0].filename == __file__
    assert len(MDAnalysis.coordinates.TRJ.NCDFReader(str(tmp_path / "a.nc"))) == 3


def test_diffusing_liquid_is_told_with_its_peak_and_coefficient(tmp_path):
    rng = np.random.default_rng(4)
    sites = np.stack(np.meshgrid(*[np.arange(5.0)] * 3, indexing="ij"), -1).reshape(-1, 3)
    steps = np.cumsum(rng.normal(0.0, 0.1, (100, 125, 3)), axis=0)  # D = 0.1² / (2 · 0.5)
    walk = written(tmp_path / "walk.h5md", md.System(sites, cell=5.0), sites + steps)
    first, second = liquid(walk)
    assert first.startswith("g(r)           first peak at ")
    assert second.startswith("diffusion      D = 0.0")
    still = written(tmp_path / "still.h5md", md.System(sites, cell=5.0), sites + rng.normal(0.0, 0.01, (100, 125, 3)))
    (line,) = liquid(still)
    assert float(line.split()[-2]) == pytest.approx(1.0, abs=0.03)  # σ, next neighbors of the crystal


def test_analyses_of_one_universe_are_those_of_its_file(tmp_path):
    """In any order, and the universe stays open for more."""
    rng = np.random.default_rng(4)
    frames = rng.uniform(0.0, 9.0, (20, 24, 3))
    path = written(tmp_path / "a.h5md", md.System(frames[0], cell=SKEWED @ TURNED_CELL), frames)
    made = universe(path)
    for _ in range(2):
        for found, expected in zip(
            (*radial_distribution(made), *mean_square_displacement(made)),
            (*radial_distribution(path), *mean_square_displacement(path)),
            strict=True,
        ):
            np.testing.assert_array_equal(found, expected)
        assert diffusion_coefficient(made).coefficient == diffusion_coefficient(path).coefficient
        assert recompute(made).step.tolist() == list(range(20))
    np.testing.assert_allclose(as_in_run(made.trajectory[3], made.trajectory[3].positions), frames[3], atol=2e-6)
