"""One file, one run: what comes second or cannot go on is refused and touches nothing; no link is written through."""

import copy
import os
import threading
import warnings
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from pathlib import Path

import numpy as np
import pytest
from h5md_runs import at_step, bring_to_disk_every, resumed, simulation
from matplotlib.figure import Figure
from wrong_calls import assert_answered

import minimd as md
from minimd.core.console.whole_file import write_picture, write_whole
from minimd.core.files.claim import Claim
from minimd.core.files.h5md_reader import read_file
from minimd.core.files.h5md_writer import H5MDWriter
from minimd.core.files.trajectory import open_trajectories
from minimd.view.viewing import View

FORMATS = ["a.h5md", "a.xtc", "a.dcd", "a.trr", "a.ncdf", "a.traj", "a.xyz"]
EACH = pytest.mark.parametrize("name", FORMATS)


def files_of(folder):
    return sorted(path.name for path in folder.iterdir())


@EACH
def test_a_second_run_is_refused_and_the_first_goes_on(name, tmp_path):
    path, refused = tmp_path / name, []

    def second(overwrite):
        with pytest.raises((OSError, ValueError), match=name) as failure:
            simulation().run(10, every=5, trajectory=path, overwrite=overwrite)
        refused.append(str(failure.value))

    look = [at_step(5, lambda: second(False)), at_step(10, lambda: second(True))]
    for is_old in (False, True):
        simulation().run(20, every=5, trajectory=path, overwrite=is_old, observers=look)
        assert ["another run" in one for one in refused[-1:]] == [True]
        assert (len(refused), files_of(tmp_path)) == (2 + 2 * is_old, [name])
    if name == "a.h5md":
        assert read_file(path).record.step.tolist() == [0, 5, 10, 15, 20]


def test_what_is_replaced_is_kept_until_the_first_frame_and_a_pipe_is_not_replaced(tmp_path):
    for name in FORMATS:
        (path := tmp_path / name).write_text("precious")
        with open_trajectories(path, simulation().engine, store_forces=False, overwrite=True):
            assert path.read_text() == "precious"
        assert path.read_text() == "precious"
        path.unlink()
        os.mkfifo(path)
        assert_answered(lambda: simulation().run(1, trajectory=path, overwrite=True), ValueError, "regular file")
    assert_answered(lambda: write_whole(path, "text"), OSError, "regular file")
    assert files_of(tmp_path) == sorted(FORMATS)


def test_links_to_a_file_are_that_file(tmp_path):
    link, file = tmp_path / "link.h5md", tmp_path / "elsewhere" / "a.h5md"
    file.parent.mkdir()
    link.symlink_to(file)
    assert_answered(lambda: simulation().run(10, trajectory=[link, file]), ValueError, "are the same file")
    file.touch()  # a link to nothing is refused, see below
    simulation().run(10, every=5, trajectory=link, overwrite=True)
    assert link.is_symlink()
    assert read_file(file).n_frames == 3

    def second(_sim):
        with pytest.raises(OSError, match="another run"):
            simulation().run(1, trajectory=file, overwrite=True)

    simulation().run(5, every=5, trajectory=link, overwrite=True, observers=[second])
    assert read_file(link).n_frames == 2


@EACH
def test_a_link_at_a_temporary_name_is_not_followed(name, tmp_path, monkeypatch):
    """Whoever can write to the folder can put one there; after the claim, libraries would open its target by name."""
    path, precious, link = tmp_path / name, tmp_path / "precious", tmp_path / f"{name}.minimd-unfinished"
    precious.write_text("precious")

    def put_link(*_):
        link.unlink(missing_ok=True)
        link.symlink_to(precious)

    put_link()
    simulation().run(10, every=5, trajectory=path)
    assert (path.is_file(), path.is_symlink(), files_of(tmp_path)) == (True, False, sorted([name, "precious"]))
    path.unlink()
    made = Claim.__init__
    monkeypatch.setattr(Claim, "__init__", lambda *args, **options: (made(*args, **options), put_link())[0])
    with pytest.raises(OSError, match="was replaced"):
        simulation().run(10, every=5, trajectory=path)
    assert precious.read_text() == "precious"


def test_a_link_to_nothing_makes_no_file_elsewhere(tmp_path):
    (elsewhere := tmp_path / "elsewhere").mkdir()
    for suffix in ("h5md", "xtc", "extxyz"):
        (path := tmp_path / f"a.{suffix}").symlink_to(elsewhere / f"new.{suffix}")
        for overwrite in (False, True):
            with pytest.raises(OSError, match="link"):
                simulation().run(10, every=5, trajectory=path, overwrite=overwrite)
    assert not list(elsewhere.iterdir())


def blow_up(path):
    """A run that fails, and names its report."""
    pair = md.System([[0.0, 0, 0], [0.9, 0, 0]], velocities=[[-5.0, 0, 0], [5.0, 0, 0]])
    sim = md.Simulation(pair, simulation().potentials, md.VelocityVerlet(0.2))
    with pytest.raises(md.NonFiniteError) as failure, warnings.catch_warnings(action="ignore"):
        sim.run(1000, crash_report=path)
    return str(failure.value)


SMALL_FILES = {  # what writes them, given their name
    "a page": View("<html>", Path("a.h5md"), "").save,
    "a picture": lambda path: write_picture(Figure(), path.with_suffix(".png")),
    "a table in place of another": lambda path: simulation().run(5, every=5).to_csv(path, overwrite=True),
    "a description": lambda path: write_whole(path, "{}"), "a crash report": blow_up,
}  # fmt: skip


@pytest.mark.parametrize("kind", SMALL_FILES)
def test_no_small_file_is_written_through_a_link(kind, tmp_path):
    precious, path = tmp_path / "precious", tmp_path / "a.png"
    precious.write_text("precious")
    for name in ("a.png", *(f"{name}.minimd-unfinished" for name in ("a.png", "a.png.minimd-unfinished", "a-2.png"))):
        (tmp_path / name).symlink_to(precious)
    with suppress(FileExistsError):
        SMALL_FILES[kind](path)
    assert precious.read_text() == "precious"


def test_files_of_the_user_are_no_temporary_files(tmp_path):
    """Browsers name unfinished downloads so; nobody can know who made them."""
    names = ["a.csv.part", "a.h5md.begun", "a.h5md.part", "a.xtc.begun", "a.crash.h5md.part", "a.png.part", "a.csv.tmp"]
    for name in names:
        (tmp_path / name).write_text("mine")
    simulation().run(10, every=5, trajectory=[tmp_path / "a.h5md", tmp_path / "a.xtc"]).to_csv(tmp_path / "a.csv")
    write_picture(Figure(), tmp_path / "a.png")
    blow_up(tmp_path / "a.crash.h5md")
    assert {name: (tmp_path / name).read_text() for name in names} == dict.fromkeys(names, "mine")
    assert files_of(tmp_path) == sorted([*names, "a.h5md", "a.xtc", "a.csv", "a.png", "a.crash.h5md"])


@pytest.mark.parametrize("fate", ["removed", "replaced", "cut"])
def test_a_file_that_is_lost_under_the_run_is_told(fate, tmp_path, monkeypatch):
    bring_to_disk_every(0.0, monkeypatch)
    path = tmp_path / "a.h5md"
    meddle = {"removed": path.unlink, "cut": lambda: os.truncate(path, 1000)}
    meddle["replaced"] = lambda: (path.unlink(), path.write_text("mine"))
    with pytest.raises(OSError, match=rf"step 15: it was {fate}"):
        simulation().run(30, every=5, trajectory=path, observers=[at_step(10, meddle[fate])])
    assert fate != "replaced" or path.read_text() == "mine"
    assert files_of(tmp_path) == ([] if fate == "removed" else ["a.h5md"])


def test_a_resumed_file_is_claimed_too_and_so_is_a_crash_report(tmp_path):
    path, old = tmp_path / "a.h5md", Claim(tmp_path / "a.crash.h5md.minimd-unfinished")
    old.appear()
    assert "another run" in blow_up(tmp_path / "a.crash.h5md")
    old.check()
    old.release()
    simulation().run(10, every=5, trajectory=path)
    sim, claim = resumed(path), Claim(path, is_new=False)
    with pytest.raises(OSError, match="another run"):
        sim.run(10, trajectory=path, append=True)
    claim.release()
    sim.run(10, every=5, trajectory=path, append=True)
    np.testing.assert_array_equal(read_file(path).system.positions, sim.positions)


def test_of_two_threads_one_writes(tmp_path):
    path, both = tmp_path / "a.h5md", threading.Barrier(2)

    def run(sim):
        both.wait()
        sim.run(40, every=1, trajectory=path)

    with ThreadPoolExecutor(2) as pool:
        raised = [one.exception() for one in [pool.submit(run, simulation()) for _ in range(2)]]
    assert (sum(isinstance(one, OSError) for one in raised), raised.count(None)) == (1, 1), raised
    assert read_file(path).n_frames == 41


def bath(sim):
    sim.method = md.LangevinBAOAB(sim.method.timestep, 0.7, 1.0, seed=1)


def at_pressure(pressure):
    rescaling, of = md.StochasticCellRescaling(pressure, 0.1, 1.0, seed=1, temperature=1.0), simulation()
    return md.Simulation(of.system, of.potentials, md.VelocityVerlet(0.004), barostat=rescaling)


CONTINUED = [  # what has become of the simulation, and what is shown
    (lambda sim: object.__setattr__(sim.system, "masses", 7.0 * sim.system.masses), "masses"),
    (lambda sim: object.__setattr__(sim.system, "charges", sim.system.charges + 0.1), "charges"),
    (bath, "without a thermostat", "langevin-baoab"), (lambda sim: setattr(sim, "step", 0), "step 10", "step 0"),
    (lambda sim: setattr(sim, "extra_observables", ["stress"]), "extra_observables"),
    (lambda sim: simulation("triclinic"), "the cell"), (lambda sim: simulation("cubic", md.units.ASE), "units"),
    (lambda sim: at_pressure(2.0), "without a barostat", "pressure=2,", "[structure] file"),
    (lambda sim: None, "without forces"),
]  # fmt: skip


def test_a_run_of_something_else_cannot_be_appended(tmp_path):
    first, path = simulation(), tmp_path / "a.h5md"
    first.run(10, every=5, trajectory=path)
    before = path.read_bytes()
    for change, *shown in CONTINUED:
        sim, options = copy.copy(first), {"trajectory": path, "append": True, "store_forces": "without forces" in shown}
        if made := change(sim):
            made.step, sim = 10, made
        assert_answered(lambda run=sim.run, by=options: run(10, **by), ValueError, "a.h5md", "new file", *shown)
        assert path.read_bytes() == before


def append_to_xtc(path):
    simulation().run(10, trajectory=path.with_suffix(".xtc"))
    simulation().run(10, trajectory=path.with_suffix(".xtc"), append=True)


def write_after_the_end(path):
    sim = simulation()
    writer = H5MDWriter(Claim(path), sim.engine, False)
    writer.close()
    writer.write(sim.frame())


def heat_on_the_way(path):
    sim = simulation()
    sim.run(10, every=5, trajectory=path, observers=[at_step(5, lambda: bath(sim))])


REFUSED = {append_to_xtc: [".h5md", "a.xtc"], heat_on_the_way: ["langevin"]}
REFUSED |= {write_after_the_end: ["closed", "step 0"]}


@pytest.mark.parametrize("call", REFUSED)
def test_what_a_file_cannot_take_is_refused(call, tmp_path):
    assert_answered(lambda: call(tmp_path / "a.h5md"), ValueError, *REFUSED[call])


def test_too_little_memory_is_no_damage_and_a_file_without_a_frame_leaves_nothing(tmp_path, monkeypatch):
    H5MDWriter(Claim(tmp_path / "empty.h5md"), simulation().engine, False).close()
    assert list(tmp_path.iterdir()) == []
    simulation().run(10, every=5, trajectory=tmp_path / "a.h5md")
    monkeypatch.setattr("minimd.core.files.h5md_digest.unflattened", lambda *_: np.empty(10**15))
    with pytest.raises(MemoryError):
        read_file(tmp_path / "a.h5md")


def test_refused_or_failed_output_leaves_nothing_of_the_others(tmp_path, monkeypatch):
    def fails(*_, **__):
        raise OSError("no more files")

    (tmp_path / "b.xyz").write_text("precious")
    with pytest.raises(FileExistsError, match=r"b\.xyz' exists"):
        simulation().run(5, trajectory=[tmp_path / "a.h5md", tmp_path / "b.xyz"])
    closed = []
    monkeypatch.setattr(
        "minimd.core.files.turned_cell.MDAnalysisWriter.close", lambda of: closed.append(of.claim.release())
    )
    monkeypatch.setattr("minimd.core.files.h5md_writer.H5MDWriter.__init__", fails)
    with pytest.raises(OSError, match="no more files"):
        simulation().run(5, trajectory=[tmp_path / "a.h5md", tmp_path / "c.xtc"])
    assert (closed, [path.name for path in tmp_path.iterdir()]) == ([None], ["b.xyz"])
