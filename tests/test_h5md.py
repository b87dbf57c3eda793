"""The H5MD file: what MDAnalysis reads is what was run, what resumes is what stopped, and no failure spoils it."""

import errno
import os
import resource
import shutil
import signal

import h5py
import MDAnalysis
import numpy as np
import pytest

import minimd as md
from minimd import h5md
from minimd.h5md import H5MDWriter, annotate, read_file
from minimd.record import SERIES

PER_PICOSECOND, KJ_PER_MOL = 98.22694788464064, 96.48533288249877  # of ASE's units, as their documentation has them
CELLS = {
    "cubic": (3.6, None),
    "triclinic": ([[3.6, 0, 0], [0.7, 3.6, 0], [-0.4, 0.9, 3.6]], None),
    "turned": ([[0, 3.6, 0.3], [0, 0, 3.6], [3.6, 0.2, 0]], None),
    "slab": ([3.6, 3.6, 9.0], [True, True, False]),
    "slab without height": ([3.6, 3.6, 0.0], [True, True, False]),
    "open": (None, None),
    "open with vectors": (9.0, False),
}


def simulation(cell="cubic", units=md.units.LJ):
    """27 Lennard-Jones atoms of two species, three of them bonded, warm."""
    vectors, pbc = CELLS[cell]
    sites = np.stack(np.meshgrid(*[np.arange(3)] * 3, indexing="ij"), -1).reshape(-1, 3)
    positions = 1.2 * sites + np.random.default_rng(3).normal(0.0, 0.03, (27, 3))
    sigma, epsilon, mass, timestep, temperature = (1.0, 1.0, 1.0, 0.004, 0.7) if units is md.units.LJ else (3.4, 0.0104, 39.9, 0.4, 90.0)
    system = md.System(
        positions * sigma,
        masses=np.where(np.arange(27) % 2, mass, 2.1 * mass),
        cell=None if vectors is None else np.array(vectors) * sigma,
        pbc=pbc,
        species=np.where(np.arange(27) % 2, "Ar", "Kr"),
        bonds=[[0, 1], [1, 2]],
        units=units,
    )
    made = md.Simulation(system, md.LennardJones(epsilon, sigma, 1.6 * sigma, truncation="shifted"), md.VelocityVerlet(timestep))
    made.set_temperature(temperature, seed=5)
    return made


def resumed(path, cell="cubic"):
    """A simulation that stands at the restart of a file."""
    contents, made = read_file(path), simulation(cell)
    made.positions[:], made.velocities[:] = contents.system.positions, contents.system.velocities
    made.step, made.time = contents.step, contents.time
    made.forces_are_current = False
    return made


def opened(path, n_atoms=27):
    universe = MDAnalysis.Universe.empty(n_atoms, trajectory=False)
    return universe.load_new(str(path))


def limited(n_bytes):
    """A context in which no file grows beyond n_bytes, as on a full disk."""

    class Limit:
        def __enter__(self):
            self.before = resource.getrlimit(resource.RLIMIT_FSIZE)
            resource.setrlimit(resource.RLIMIT_FSIZE, (n_bytes, self.before[1]))

        def __exit__(self, *_):
            resource.setrlimit(resource.RLIMIT_FSIZE, self.before)

    return Limit()


@pytest.mark.parametrize("units", [md.units.LJ, md.units.ASE], ids=lambda units: units.name)
@pytest.mark.parametrize("cell", CELLS)
def test_trajectory_read_back_by_mdanalysis_is_the_trajectory_written(tmp_path, cell, units):
    sim, seen = simulation(cell, units), []
    per_ps, energy = (1.0, 1.0) if units is md.units.LJ else (PER_PICOSECOND, KJ_PER_MOL)
    sim.run(
        20,
        every=5,
        trajectory=tmp_path / "a.h5md",
        store_forces=True,
        observers=[lambda s: seen.append((s.step, s.time, s.positions.copy(), s.velocities.copy(), s.forces.copy()))],
    )
    frames = opened(tmp_path / "a.h5md").trajectory
    assert len(frames) == len(seen) == 5
    for ts, (step, time, positions, velocities, forces) in zip(frames, seen, strict=True):
        assert ts.data["step"] == step
        assert ts.time == pytest.approx(time / per_ps, rel=1e-14)
        np.testing.assert_array_equal(ts.positions, positions.astype(np.float32))
        np.testing.assert_allclose(ts.velocities, velocities * per_ps, rtol=1.2e-7)  # rounding to float32
        np.testing.assert_allclose(ts.forces, forces * energy, rtol=1.2e-7)
        assert ts.velocities.any()
        assert ts.forces.any()


@pytest.mark.parametrize("cell", CELLS)
def test_cell_of_mdanalysis_has_lengths_and_angles_of_ours(tmp_path, cell):
    sim = simulation(cell)
    sim.run(0, trajectory=tmp_path / "a.h5md")
    dimensions, cell_read = opened(tmp_path / "a.h5md").trajectory.ts.dimensions, read_file(tmp_path / "a.h5md").system.cell
    assert cell_read.same_as(sim.system.cell)
    if cell.startswith("open") or cell == "slab without height":
        assert dimensions is None
        return
    a, b, c = sim.system.cell.vectors
    lengths = [np.linalg.norm(v) for v in (a, b, c)]
    cosines = [b @ c / lengths[1] / lengths[2], a @ c / lengths[0] / lengths[2], a @ b / lengths[0] / lengths[1]]
    np.testing.assert_allclose(dimensions, [*lengths, *np.degrees(np.arccos(cosines))], rtol=2e-7)


@pytest.mark.parametrize("units", [md.units.LJ, md.units.ASE], ids=lambda units: units.name)
@pytest.mark.parametrize("cell", ["cubic", "open"])
def test_observables_are_those_of_the_record_to_the_last_bit(tmp_path, cell, units):
    record = simulation(cell, units).run(20, every=2, trajectory=tmp_path / "a.h5md")
    read = read_file(tmp_path / "a.h5md").record
    names = [name for name in SERIES if name != "conserved_energy" and (name != "pressure" or cell == "cubic")]
    for name in ("step", "time", *names):
        np.testing.assert_array_equal(getattr(read, name), getattr(record, name), strict=True)
    stored = [dict(ts.data) for ts in opened(tmp_path / "a.h5md").trajectory]
    for name in names:
        np.testing.assert_array_equal([row[name] for row in stored], getattr(record, name), strict=True)
    assert read.units is units
    assert not hasattr(read, "pressure") or cell == "cubic"


def test_series_share_one_step_and_one_time(tmp_path):
    simulation().run(4, every=2, trajectory=tmp_path / "a.h5md", store_forces=True)
    with h5py.File(tmp_path / "a.h5md") as h5:
        groups = [h5["observables/momentum"], *(h5[f"particles/trajectory/{name}"] for name in ("velocity", "force", "box/edges"))]
        for group in groups:
            assert group["step"] == h5["particles/trajectory/position/step"]
            assert group["time"] == h5["particles/trajectory/position/time"]
        assert h5["particles/trajectory/position/value"].dtype == np.float64
        assert h5["observables/total_energy/value"].attrs["unit"] == "ε"


@pytest.mark.parametrize("units", [md.units.LJ, md.units.ASE], ids=lambda units: units.name)
@pytest.mark.parametrize("n_steps", [20, 23])  # the end of the run is a frame, or lies beyond the last one
def test_restart_is_the_end_of_the_run_to_the_last_bit(tmp_path, units, n_steps):
    sim = simulation("triclinic", units)
    sim.run(n_steps, every=5, trajectory=tmp_path / "a.h5md")
    contents = read_file(tmp_path / "a.h5md")
    assert (contents.step, contents.time, contents.timestep) == (n_steps, sim.time, sim.method.timestep)
    assert contents.method == "velocity-verlet"
    assert md.integrators.SPLITTINGS[contents.method] is md.VelocityVerlet
    for name in ("positions", "velocities", "masses", "species", "bonds"):
        np.testing.assert_array_equal(getattr(contents.system, name), getattr(sim.system, name), strict=True)


@pytest.mark.parametrize("n_steps", [20, 23])
def test_appended_run_continues_without_doubled_frames(tmp_path, n_steps):
    path = tmp_path / "a.h5md"
    simulation().run(n_steps, every=5, trajectory=path, store_forces=True)
    sim = resumed(path)
    writer = H5MDWriter.append_to(path, sim)
    record = sim.run(20, every=5, observers=[lambda s: writer.write(s.frame())])
    writer.close(completed=True)
    contents = read_file(path)
    expected = [0, 5, 10, 15, 20, *range(n_steps + 5, n_steps + 25, 5)] if n_steps == 20 else [0, 5, 10, 15, 20, *range(23, 48, 5)]
    assert contents.record.step.tolist() == expected
    assert (np.diff(contents.record.time) > 0.0).all()
    assert contents.step == n_steps + 20
    np.testing.assert_array_equal(contents.record.total_energy[-4:], record.total_energy[-4:])
    last = opened(path).trajectory[-1]
    assert len(opened(path).trajectory) == len(expected)
    np.testing.assert_array_equal(last.positions, sim.positions.astype(np.float32))
    np.testing.assert_allclose(last.forces, sim.forces, rtol=1.2e-7)


def test_frames_behind_the_restart_are_dropped(tmp_path):
    path = tmp_path / "a.h5md"
    simulation().run(20, every=5, trajectory=path)
    with h5py.File(path, "r+") as h5:
        h5["minimd/restart"].attrs["step"] = 10
    H5MDWriter.append_to(path, resumed(path)).close(completed=True)
    assert read_file(path).record.step.tolist() == [0, 5, 10]
    assert len(opened(path).trajectory) == 3


@pytest.mark.parametrize(
    ("fault", "words"),
    [("masses", "masses"), ("cell", "the cell"), ("step", "from step 10"), ("forces", "without forces"), ("units", "units")],
)
def test_appending_another_run_is_refused(tmp_path, fault, words):
    path = tmp_path / "a.h5md"
    simulation().run(10, every=5, trajectory=path)
    before = path.read_bytes()
    sim = simulation("triclinic" if fault == "cell" else "cubic", md.units.ASE if fault == "units" else md.units.LJ)
    sim.step = 0 if fault == "step" else 10
    if fault == "masses":
        object.__setattr__(sim.system, "masses", 7.0 * sim.system.masses)
    with pytest.raises(ValueError, match=words):
        H5MDWriter.append_to(path, sim, store_forces=fault == "forces")
    assert path.read_bytes() == before


def test_exception_in_a_run_leaves_a_valid_file(tmp_path):
    def stop(sim):
        if sim.step == 15:
            raise RuntimeError("enough")

    with pytest.raises(RuntimeError, match="enough"):
        simulation().run(100, every=5, trajectory=tmp_path / "a.h5md", observers=[stop])
    assert read_file(tmp_path / "a.h5md").step == 15
    assert len(opened(tmp_path / "a.h5md").trajectory) == 4


def test_interrupted_run_restarts_at_its_last_frame(tmp_path):
    def interrupt(sim):
        if sim.step == 15:
            signal.raise_signal(signal.SIGINT)

    with pytest.raises(KeyboardInterrupt):
        simulation().run(100, every=5, trajectory=tmp_path / "a.h5md", observers=[interrupt])
    contents = read_file(tmp_path / "a.h5md")
    assert contents.record.step.tolist() == [0, 5, 10, 15]
    assert contents.step == 15  # one step is made after it, and is not the end of the run


def test_interrupt_inside_a_write_leaves_whole_frames_only(tmp_path, monkeypatch):
    path, sim = tmp_path / "a.h5md", simulation()
    monkeypatch.setattr(h5md, "SECONDS_BETWEEN_FLUSHES", 0.0)
    writer = H5MDWriter(path, sim, False)
    writer.write(sim.frame())
    sim.run(5)
    series_of = h5md.layout.series_of

    def interrupted(h5, column, frame):
        if column.path.endswith("velocity/value"):
            raise KeyboardInterrupt
        return series_of(h5, column, frame)

    monkeypatch.setattr(h5md.layout, "series_of", interrupted)
    with pytest.raises(KeyboardInterrupt):
        writer.write(sim.frame())
    assert {len(series) for series in h5md.layout.all_series(writer._h5)} == {1}
    monkeypatch.setattr(h5md.layout, "series_of", series_of)
    writer.close(completed=True)
    assert read_file(path).record.step.tolist() == [0, 5]


def test_file_of_a_killed_run_is_valid(tmp_path, monkeypatch):
    path, sim = tmp_path / "a.h5md", simulation()
    monkeypatch.setattr(h5md, "SECONDS_BETWEEN_FLUSHES", 0.0)
    copies = []

    def copy(sim):
        copies.append(tmp_path / f"{sim.step}.h5md")
        shutil.copy(path, copies[-1])

    sim.run(20, every=5, trajectory=path, observers=[copy])
    for number, name in enumerate(copies, start=1):
        contents = read_file(name)
        assert contents.n_frames == len(opened(name).trajectory) == number
        assert contents.step == contents.record.step[-1] == 5 * (number - 1)


def test_frames_are_flushed_once_a_second(tmp_path, monkeypatch):
    path, sim, now = tmp_path / "a.h5md", simulation(), [0.0]
    monkeypatch.setattr(h5md, "monotonic", lambda: now[0])
    found = []

    def look(_sim):
        shutil.copy(path, tmp_path / "copy.h5md")
        found.append(read_file(tmp_path / "copy.h5md").n_frames)
        now[0] += 0.4

    sim.run(30, every=5, trajectory=path, observers=[look])
    assert found == [1, 1, 1, 4, 4, 4, 7]


@pytest.mark.parametrize("way", ["limit", "patched"])
def test_full_disk_is_told_once_and_spoils_nothing(tmp_path, monkeypatch, way):
    path, sim = tmp_path / "a.h5md", simulation()
    monkeypatch.setattr(h5md, "SECONDS_BETWEEN_FLUSHES", 0.0)
    writer = H5MDWriter(path, sim, True)
    written = 0

    def full(*_):
        raise OSError(errno.ENOSPC, "No space left on device")

    def write_until_full():
        nonlocal written
        for written in range(2000):
            if written == 7 and way == "patched":
                monkeypatch.setattr(os, "posix_fallocate", full)
            writer.write(sim.frame())
            sim.step += 1

    with limited(1_200_000 if way == "limit" else 2**40), pytest.raises(OSError, match=r"a\.h5md.*frame of step") as failure:
        write_until_full()
    writer.close(completed=True)
    assert 5 < written < 2000
    assert f"{written} frames before that are valid" in str(failure.value)
    assert read_file(path).record.step.tolist() == list(range(written))
    assert len(opened(path).trajectory) == written
    assert path.stat().st_size < 1_200_000
    with pytest.raises(ValueError, match="closed"):
        writer.write(sim.frame())


def test_reserved_room_is_given_back(tmp_path):
    simulation().run(20, every=5, trajectory=tmp_path / "a.h5md")
    with h5py.File(tmp_path / "a.h5md") as h5:
        held = sum(series.id.get_storage_size() for series in h5md.layout.all_series(h5))
    assert (tmp_path / "a.h5md").stat().st_size < held + 100_000  # HDF5's own tables and what is written once


def test_failing_write_leaves_the_frames_before_it(tmp_path, monkeypatch):
    path, sim = tmp_path / "a.h5md", simulation()
    series_of = h5md.layout.series_of

    def failing(h5, column, frame):
        if frame.step == 10 and column.path.endswith("position/value"):
            raise OSError(errno.EIO, "Input/output error")
        return series_of(h5, column, frame)

    monkeypatch.setattr(h5md.layout, "series_of", failing)
    monkeypatch.setattr(h5md, "SECONDS_BETWEEN_FLUSHES", 0.0)
    with pytest.raises(OSError, match="frame of step 10: Input/output error; its 2 frames"):
        sim.run(50, every=5, trajectory=path)
    with h5py.File(path) as h5:
        assert {len(series) for series in h5md.layout.all_series(h5)} == {2}
    assert read_file(path).record.step.tolist() == [0, 5]


def test_readers_trust_the_shortest_series(tmp_path):
    path = tmp_path / "a.h5md"
    simulation().run(20, every=5, trajectory=path)
    with h5py.File(path, "r+") as h5:
        h5["observables/momentum/value"].resize(3, axis=0)
        h5["minimd/restart"].attrs["step"] = 10
    assert len(read_file(path).record.total_energy) == read_file(path).n_frames == 3
    H5MDWriter.append_to(path, resumed(path)).close(completed=True)
    assert len(opened(path).trajectory) == 3


def test_title_and_scene_can_be_stored_by_an_observer(tmp_path):
    path = tmp_path / "a.h5md"
    text = "structure = 'ä'\n" * 10_000

    def note(sim):
        if sim.step == 0:
            annotate(path, title="two species", scene=text)

    simulation().run(4, every=2, trajectory=path, observers=[note])
    contents = read_file(path)
    assert (contents.title, contents.scene, contents.n_frames) == ("two species", text, 3)


def test_integer_species_stay_integers(tmp_path):
    system = md.System(np.diag([1.0, 2.0, 3.0]), species=[7, 3, 7])
    sim = md.Simulation(system, md.LennardJones(1.0, 1.0, 2.5), md.VelocityVerlet(0.001))
    sim.run(1, trajectory=tmp_path / "a.h5md")
    assert read_file(tmp_path / "a.h5md").system.species.tolist() == [7, 3, 7]


def test_files_that_are_no_runs_are_named(tmp_path):
    with pytest.raises(FileNotFoundError, match=r"missing\.h5md"):
        read_file(tmp_path / "missing.h5md")
    (tmp_path / "text.h5md").write_text("not at all")
    with pytest.raises(ValueError, match="not an HDF5 file"):
        read_file(tmp_path / "text.h5md")
    with h5py.File(tmp_path / "foreign.h5md", "w") as h5:
        h5["data"] = [1, 2]
    with pytest.raises(ValueError, match="not written by minimd"):
        read_file(tmp_path / "foreign.h5md")
    H5MDWriter(tmp_path / "empty.h5md", simulation(), False).close(completed=True)
    with pytest.raises(ValueError, match="no frame"):
        read_file(tmp_path / "empty.h5md")
    with pytest.raises(OSError, match=r"nowhere.*cannot be opened"):
        H5MDWriter(tmp_path / "nowhere" / "a.h5md", simulation(), False)


def test_end_of_a_run_inside_an_except_block_is_the_restart(tmp_path):
    sim = simulation()
    try:
        raise RuntimeError("of the caller, who then runs")
    except RuntimeError:
        sim.run(15, every=10, trajectory=tmp_path / "a.h5md")
    assert read_file(tmp_path / "a.h5md").step == 15


def test_refused_or_failed_output_leaves_nothing_of_the_others(tmp_path, monkeypatch):
    (tmp_path / "b.xyz").write_text("precious")
    with pytest.raises(FileExistsError, match=r"b\.xyz' exists"):
        simulation().run(5, trajectory=[tmp_path / "a.h5md", tmp_path / "b.xyz"])
    assert [path.name for path in tmp_path.iterdir()] == ["b.xyz"]

    closed = []
    monkeypatch.setattr("minimd.h5md.H5MDWriter.close", lambda _self, completed: closed.append(completed))
    monkeypatch.setattr("minimd.mdanalysis.MDAnalysisWriter.__init__", lambda *_: (_ for _ in ()).throw(OSError("no more files")))
    with pytest.raises(OSError, match="no more files"):
        simulation().run(5, trajectory=[tmp_path / "a.h5md", tmp_path / "c.xtc"])
    assert closed == [False]
    assert [path.name for path in tmp_path.iterdir()] == ["b.xyz"]


def test_truncated_file_is_said_to_be_damaged(tmp_path):
    simulation().run(20, every=5, trajectory=tmp_path / "a.h5md")
    content = (tmp_path / "a.h5md").read_bytes()
    (tmp_path / "a.h5md").write_bytes(content[: len(content) // 2])
    with pytest.raises(OSError, match="it is damaged"):
        read_file(tmp_path / "a.h5md")
