"""What becomes of a run and its file when it is killed at any of its writes or stopped anywhere: the same last bit."""

import os
import random
import shutil
import signal
import zlib
from pathlib import Path
from tempfile import TemporaryDirectory
from unittest import mock

import numpy as np
import pytest
from cluster_scenes import atoms_per_domain
from damages import KILLED, in_child, killed_at
from h5md_runs import assert_same_file, at_step, bring_to_disk_every, limited, opened, resumed, simulation
from recorder.runs import KINDS, RESUMES, survey
from scenes import BONDED, LJ, SCENES, Scene

import minimd as md
from minimd.core.files import claim, h5md_writer as h5md
from minimd.core.files.h5md_reader import read_file
from minimd.core.integrators.splitting import Splitting
from minimd.core.structure.system import changed
from minimd.textbook.methods import METHODS

NAMES = sorted(name for name, of in METHODS.items() if issubclass(of, Splitting))


def springs():
    """Two lists: bonded pairs are scaled in one law and not in the other; fixed atoms; open along z."""
    slab = changed(SCENES["slab"]().system, bonds=np.arange(108).reshape(-1, 2))
    return Scene(slab, [LJ, BONDED, md.HarmonicBond(20.0, 1.1)], [md.FixedAtoms([0, 7])])


def few():
    """Too few for clusters, without a cell."""
    of = SCENES["droplet"]().system
    return Scene(md.System(of.positions[:27], velocities=of.velocities[:27]), [LJ])


def bursting():
    """A hot droplet about a corner of a wide cell."""
    of = SCENES["argon"]().system
    return Scene(md.System(of.positions - 2.5, velocities=3.0 * of.velocities, cell=40.0), [LJ])


RUNS = {name: SCENES[name] for name in ("argon", "dumbbells")} | {"springs": springs, "few": few, "bursting": bursting}
COMMON = ["velocity-verlet", "position-verlet", "langevin-baoab"]  # whose kernels other tests compile, too
ROWS = [("argon", 2, COMMON), ("bursting", 1, COMMON[:1])]
ROWS += [pytest.param(scene, n, NAMES, marks=pytest.mark.slow) for scene in RUNS for n in (1, 2)]


def begun(scene, name, threads=1, **options):
    """The simulation of a scene by the method of a name."""
    scene, of = RUNS[scene](), METHODS[name]
    timestep = 0.002 * scene.timestep if of.is_overdamped else scene.timestep
    method = of.with_relaxation_time(timestep, 1.2, 0.7, seed=4) if of.is_thermostat else of(timestep)
    return scene.simulation(method, threads=threads, **options)


@pytest.mark.parametrize(("scene", "threads", "names"), ROWS)
def test_n_steps_and_m_steps_are_n_plus_m(scene, threads, names, tmp_path):
    """In one process and through a file, stopped anywhere, for some methods drawn at random."""
    draw = random.Random(f"{scene} {threads}")
    for k in range(2):
        name, n, m = draw.choice(names), draw.randrange(60), draw.randrange(1, 60)
        every, skin = draw.choice([1, 7, 10, 50, 1000]), draw.choice([None, 0.05])  # thin: lists where it stops
        file, path = tmp_path / f"{k}.h5md", tmp_path / f"{k} in parts.h5md"
        with atoms_per_domain(50):
            whole, parts = (begun(scene, name, threads, skin=skin) for _ in range(2))
            whole.run(n + m, every=every, trajectory=file)
            parts.run(n, every=every, trajectory=path)
            if k % 2:
                parts = md.Simulation.resume(path, parts.potentials, threads=draw.choice([1, 2, 3]))
            parts.run(until_step=n + m, every=every, trajectory=path, append=True)
        np.testing.assert_array_equal(parts.positions, whole.positions)
        np.testing.assert_array_equal(parts.velocities, whole.velocities)
        assert_same_file(path, file)


@pytest.mark.parametrize("n", [30, 34])
def test_a_look_between_two_drifts_builds_no_list(n, tmp_path):
    """The run itself needs no forces there; its list, of another place, decides the order of the sums."""
    whole, parts = (begun("argon", "position-verlet", skin=0.05) for _ in range(2))
    whole.run(80)
    parts.run(n, trajectory=tmp_path / "a.h5md")
    parts = md.Simulation.resume(tmp_path / "a.h5md", LJ, threads=1)
    parts.run(until_step=80)
    np.testing.assert_array_equal(parts.positions, whole.positions)


def test_a_run_that_is_killed_before_a_change_of_its_file_goes_on_to_the_same_bits(tmp_path, monkeypatch):
    bring_to_disk_every(0.0, monkeypatch)
    path, whole = tmp_path / "a.h5md", tmp_path / "whole.h5md"
    simulation().run(15, every=5, trajectory=whole)
    assert killed_at(12, lambda: simulation().run(15, every=5, trajectory=path)) == KILLED
    resumed(path).run(until_step=15, every=5, trajectory=path, append=True)
    assert_same_file(path, whole)


@pytest.mark.slow
@pytest.mark.parametrize("kind", [*KINDS, *RESUMES])
def test_a_run_goes_on_to_the_same_bits_whatever_is_on_the_disk(kind, tmp_path):
    assert not survey([kind], range(69), tmp_path)


def test_exception_in_a_run_leaves_valid_files_and_its_block_runs_go_on(tmp_path):
    paths, sim = [tmp_path / f"a.{suffix}" for suffix in ("h5md", "xtc", "ncdf")], simulation()
    sim.make_steps(10)
    try:
        sim.run(100, every=5, trajectory=paths, observers=[at_step(25, lambda: 1 // 0)])
    except ZeroDivisionError:
        assert (sim.step, [len(opened(path).trajectory) for path in paths]) == (25, [4, 4, 4])
        sim.run(15, every=10, trajectory=tmp_path / "b.h5md")
    assert [read_file(path).step for path in (paths[0], tmp_path / "b.h5md")] == [25, 40]


def test_a_run_that_was_interrupted_goes_on_with_the_same_bits_from_memory_and_from_its_file(tmp_path):
    whole, sim, path = simulation(), simulation(), tmp_path / "a.h5md"
    whole.run(100, every=25, trajectory=tmp_path / "whole.h5md")
    with pytest.raises(KeyboardInterrupt):
        sim.run(100, every=25, trajectory=path, observers=[at_step(25, lambda: signal.raise_signal(signal.SIGINT))])
    contents = read_file(path)
    assert contents.record.step.tolist() == [0, 25]
    assert contents.step == sim.step == 26
    np.testing.assert_array_equal(contents.system.positions, sim.positions)
    sim.run(until_step=100, every=25)
    np.testing.assert_array_equal(sim.velocities, whole.velocities)
    resumed(path).run(until_step=100, every=25, trajectory=path, append=True)
    assert_same_file(path, tmp_path / "whole.h5md")


def test_a_step_is_counted_before_a_restart_is_written(tmp_path, monkeypatch):
    """A second Ctrl-C may come anywhere: also between the last step of a block and its count."""
    bring_to_disk_every(0.0, monkeypatch)
    path, looks = tmp_path / "a.h5md", []

    def interrupted(engine, *when):
        looks.append(engine.step)
        if len(looks) == 3:
            raise KeyboardInterrupt

    with mock.patch("minimd.core.diagnosis.run_guard.fault_of", interrupted), pytest.raises(KeyboardInterrupt):
        simulation().run(30, every=5, trajectory=path)
    whole = simulation()
    whole.run(read_file(path).step, every=5)
    np.testing.assert_array_equal(read_file(path).system.positions, whole.positions)


def test_frames_are_flushed_once_a_second_and_files_of_killed_runs_are_valid(tmp_path, monkeypatch):
    path, now, found = tmp_path / "a.h5md", [0.0], []
    monkeypatch.setattr(h5md, "monotonic", lambda: now[0])

    def look(_sim):
        now[0] += 0.4
        if not path.exists():
            return found.append(0)
        copy = Path(shutil.copy(path, tmp_path / f"{len(found)}.h5md"))
        contents = read_file(copy)
        assert contents.n_frames == len(opened(copy).trajectory)
        assert contents.step == contents.record.step[-1] == 5 * (contents.n_frames - 1)
        return found.append(contents.n_frames)

    simulation().run(30, every=5, trajectory=path, observers=[look])
    assert found == [0, 0, 0, 4, 4, 4, 7]


def test_a_short_run_writes_its_file_in_one_commit(tmp_path):
    """Before it there is no file; fsync is called for the file and for its folder."""
    seen = []
    with mock.patch("os.fsync", wraps=os.fsync) as fsync:
        simulation().run(
            10, every=5, trajectory=tmp_path / "a.h5md", observers=[lambda _: seen.extend(tmp_path.glob("*.h5md"))]
        )
    assert (fsync.call_count, seen, read_file(tmp_path / "a.h5md").n_frames) == (2, [], 3)


@pytest.mark.parametrize("n_before", [0, 1])
def test_an_interrupt_inside_a_write_leaves_whole_frames_only(n_before, tmp_path, monkeypatch):
    path, sim, put = tmp_path / "a.h5md", simulation(), h5md.put

    def interrupted(h5, items):
        put(h5, dict([*items.items()][: len(items) // 2]))
        raise KeyboardInterrupt

    bring_to_disk_every(0.0, monkeypatch)
    writer = h5md.H5MDWriter(claim.Claim(path), sim.engine, False)
    for _ in range(n_before):
        writer.write(sim.frame())
        sim.run(5)
    with mock.patch("minimd.core.files.h5md_writer.put", interrupted), pytest.raises(KeyboardInterrupt):
        writer.write(sim.frame())
    assert path.exists() == bool(n_before)
    if n_before:
        shutil.copy(path, tmp_path / "copy.h5md")
        assert read_file(tmp_path / "copy.h5md").record.step.tolist() == [0]
    writer.close()
    assert read_file(path).record.step.tolist() == [0, 5][: n_before + 1]


@pytest.mark.parametrize("way", ["patched", pytest.param("limit", marks=pytest.mark.slow)])
def test_full_disk_is_told_once_and_spoils_nothing(tmp_path, monkeypatch, way):
    path, sim, most = tmp_path / "a.h5md", simulation(), 900_000
    bring_to_disk_every(0.0, monkeypatch)
    writer = h5md.H5MDWriter(claim.Claim(path), sim.engine, True)

    def write_until_full():
        for sim.step in range(2000):
            if sim.step == 7 and way == "patched":
                monkeypatch.setattr(os, "pwrite", lambda *_: os.write(os.open("/dev/full", os.O_WRONLY), b"full"))
            writer.write(sim.frame())

    with limited(most if way == "limit" else 2**40), pytest.raises(OSError, match=r"a\.h5md.*step") as failure:
        write_until_full()
    monkeypatch.undo()
    writer.close()
    assert 5 < sim.step < 2000
    assert f"{sim.step} earlier frames" in str(failure.value)
    assert (read_file(path).record.step.tolist(), len(opened(path).trajectory)) == ([*range(sim.step)], sim.step)
    assert path.stat().st_size <= most


def test_what_has_a_second_name_is_not_emptied(tmp_path):
    """A run that is killed while its file gets its name may leave both."""
    path, precious = tmp_path / "a.h5md", tmp_path / "precious.h5md"
    simulation().run(10, every=5, trajectory=path)
    os.link(path, tmp_path / "a.h5md.minimd-unfinished")
    simulation().run(10, every=5, trajectory=path, overwrite=True)
    os.link(path, tmp_path / "a.h5md.minimd-unfinished")
    path.rename(precious)
    simulation().run(10, every=5, trajectory=path)
    assert_same_file(precious, path)
    assert sorted(os.listdir(tmp_path)) == ["a.h5md", "precious.h5md"]


@pytest.fixture(scope="module")
def killed_in_a_commit(tmp_path_factory):
    """The content of a file of 15 steps whose last commit is in its journal, half of which is at its places."""
    path = tmp_path_factory.mktemp("killed") / "a.h5md"

    def half(descriptor, size, pieces):
        for place, data in pieces[: len(pieces) // 2]:
            os.pwrite(descriptor, data, place)
        raise KeyboardInterrupt

    simulation().run(10, every=5, trajectory=path)
    at_once = mock.patch("minimd.core.files.h5md_writer.SECONDS_BETWEEN_FLUSHES", 0.0)
    with at_once, mock.patch("minimd.core.files.claim._apply", half), pytest.raises(KeyboardInterrupt):
        resumed(path).run(10, every=5, trajectory=path, append=True)
    return path.read_bytes()


def test_a_file_that_is_moved_in_the_middle_of_a_commit_is_whole(tmp_path, killed_in_a_commit):
    simulation().run(20, every=5, trajectory=tmp_path / "whole.h5md")
    (moved := tmp_path / "moved.h5md").write_bytes(killed_in_a_commit)
    resumed(moved).run(until_step=20, every=5, trajectory=moved, append=True)
    assert_same_file(moved, tmp_path / "whole.h5md")


def test_a_journal_that_cannot_be_carried_out_is_told(killed_in_a_commit):
    """The file of a killed run cannot be written now; its reader is not root."""
    with TemporaryDirectory(dir="/tmp") as name:
        folder, path = Path(name), Path(name) / "a.h5md"
        path.write_bytes(killed_in_a_commit)
        path.chmod(0o444)
        folder.chmod(0o555)

        def read():
            if os.geteuid() == 0:
                os.setuid(65534)
            with pytest.raises(OSError, match=r"a\.h5md' cannot be opened: .*interrupted"):
                read_file(path)
            return "told"

        try:
            assert in_child(read) == "told"
        finally:
            folder.chmod(0o755)
            path.chmod(0o666)
        assert read_file(path).step == 15


def test_a_journal_that_nobody_wrote_changes_nothing(tmp_path):
    """Its checksum is right, its numbers are not."""
    path, pack, magic = tmp_path / "a.h5md", claim.END.pack, claim.MAGIC
    simulation().run(10, every=5, trajectory=path)
    sound, n = path.read_bytes(), path.stat().st_size
    # place and length of the piece, size of the file before and after; None: a body shorter than a head
    places = [(0, -16, n, n), (0, 5, n, n), (-8, 4, n, n), (n, 4, n, n)]
    for lie in (*places, (0, 4, 2**40, n), (0, 4, n, -1), (0, 4, n, 2**40), None):
        place, length, before, after = lie or (0, 4, n, n)
        body = (claim.PIECE.pack(place, length) + b"evil")[: None if lie else 1]
        head = pack(before, after, len(body), 0, magic)
        head = pack(before, after, len(body), zlib.crc32(head, zlib.crc32(body)), magic)
        path.write_bytes(sound + body + head)
        content = path.read_bytes()
        assert read_file(path).n_frames == 3
        assert path.read_bytes() == content, lie


def test_an_answer_that_fails_costs_no_frame_and_leaves_no_lock(tmp_path):
    class Failing(md.observers.MeanSquareDisplacement):
        def result(self):
            raise ValueError("no answer")

    sim, path = simulation(), tmp_path / "a.h5md"
    with pytest.raises(ValueError, match="no answer"):
        sim.run(20, every=10, trajectory=path, observers=[Failing()])
    assert (read_file(path).n_frames, sorted(tmp_path.iterdir())) == (3, [path])
    with pytest.warns(UserWarning, match="mean_square_displacement"):
        sim.run(10, every=10, trajectory=path, append=True)
