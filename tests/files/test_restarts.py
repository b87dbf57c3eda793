"""What a restart may hold: fields of another kind are damage, and the run goes on from the restart before it."""

import re
import shutil

import h5py
import numpy as np
import pytest
from damages import FAILED, SENTENCE, outcome
from h5md_runs import N_ATOMS, resumed, simulation

from minimd.core.engine.record import SERIES
from minimd.core.engine.snapshot import Checkpoint, Snapshot
from minimd.core.files.h5_items import put
from minimd.core.files.h5md_digest import EARLIER, RESTART, checked, flattened, read_group, sign
from minimd.core.files.h5md_reader import damage, read_file
from minimd.core.files.h5md_schema import columns
from minimd.core.files.stored_fields import FIELDS
from minimd.core.neighbors.verlet_list import Built
from minimd.core.structure.cell import Cell
from minimd.core.structure.grid import Grid

SOUND = np.zeros((N_ATOMS, 3))
WITH_BATHS = {f"observables/{name}/value" for name in ("conserved_energy", "work", "volume", "cell")}
SERIES_OF_RUN = {name for name in FIELDS if "/" in name} - WITH_BATHS
BESIDE = {"beside.#", "n_frames"}  # what files keep with a checkpoint
FORGED = {  # arrays and numbers in place of those of the run; None: removed
    "a list of other atoms": {"list_0": np.zeros((1000, 3))},
    "a shorter list": {"list_0": SOUND[:-1]},
    "no list at all": {"list_0": SOUND[:0]},
    "a flat list": {"list_0": SOUND.ravel()},
    "a list of another type": {"list_0": SOUND.astype("f4")},
    "a list of whole numbers": {"list_0": SOUND.astype(int)},
    "a list that is not finite": {"list_0": SOUND * np.nan},
    "a cell of a list without its reduction": {"cell_of_list_0": np.eye(3) * 3.6},
    "images without bonds": {"images": np.zeros((2, 3))},
    "a region of one number": {"region_of_list_0": np.zeros(1)},
    "a region without extent": {"region_of_list_0": np.zeros(7)},
    "a flat cell": {"cell": np.ones((3, 3)), "cell_reduction": np.eye(3, dtype=int)},
    "a cell without its reduction": {"cell": np.eye(3) * 3.6},
    "another lattice": {"cell": np.eye(3) * 3.6, "cell_reduction": 2 * np.eye(3, dtype=int)},
    "a grid that is no power of two": {"grid": np.array([0.3, 0.5, 0.5])},
    "a negative skin": {"skins": np.array([-0.1])},
    "a skin that is no list": {"skins": np.float64(0.1)},
    "steps and a half": {"step": 10.5},
    "a step before the first frame": {"step": -70},
    "a time that is not finite": {"time": np.nan},
    "a tolerance of two": {"tolerance": 2.0},
    "no velocities": {"velocities": None},
    "velocities of one atom": {"velocities": SOUND[:1]},
    "no skins": {"skins": None},
    "a field that nobody knows": {"surprise": SOUND},
}  # fmt: skip
ARRAYS = ("list_", "images", "region_of_list_", "cell", "velocities", "surprise")


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    """A file with two restarts."""
    path = tmp_path_factory.mktemp("sound") / "a.h5md"
    simulation().run(10, every=5, trajectory=path)
    resumed(path).run(10, every=5, trajectory=path, append=True)
    return path


def forge(path, changes, restarts):
    with h5py.File(path, "r+") as h5:
        for name in restarts:
            arrays, numbers = read_group(h5[name])
            numbers = {key: value.tolist() if np.ndim(value) == 0 else value for key, value in numbers.items()}
            for field, value in changes.items():
                owner = arrays if field.startswith(ARRAYS) else numbers
                owner.pop(field, None)
                owner |= {} if value is None else {field: value}
            del h5[name]
            put(h5, checked(name, arrays, numbers))


def test_what_is_written_is_what_is_declared():
    """No field can be forgotten: a checkpoint that has all that one can have, and the series of all observables."""
    cell = Cell.of(np.eye(3) * 9.0)
    built = Built(0.1, SOUND, cell, np.ones(7))
    state = Snapshot(1, 0.1, SOUND, SOUND, 0.1, (1, 0.1), 0.1, cell, np.zeros(2))
    everything = Checkpoint(state, 0.1, (built, built), (SOUND, 1e-9), 1, Grid(0.5, 0.5, 0.5))
    assert not any(value is None for part in (built, state, everything) for value in part)
    written = {re.sub(r"\d+", "#", name) for part in flattened(everything) for name in part}
    assert written | BESIDE == {name for name in FIELDS if "/" not in name}
    series = {column.path for column in columns(simulation().system, list(SERIES), True, 0.1)}
    assert {name for name in FIELDS if "/" in name} - {"observables/volume/value"} <= series
    assert all(name.startswith("observables/") for name in series - FIELDS.keys())


def test_a_field_that_is_not_declared_is_damage(run, monkeypatch):
    with h5py.File(run) as h5:
        names = [*h5[RESTART], *h5[RESTART].attrs]
    assert "list_0" in names
    for name in set(names) - {"digest"}:
        with monkeypatch.context() as other:
            other.delitem(FIELDS, re.sub(r"\d+", "#", name))
            with pytest.raises(OSError, match="restart is damaged"):
                read_file(run)


@pytest.mark.parametrize("path", sorted(SERIES_OF_RUN))
def test_series_of_another_shape_are_damage(path, tmp_path):
    file, sim = tmp_path / "a.h5md", simulation()
    sim.extra_observables = ("stress",)
    sim.run(4, every=2, trajectory=file, store_forces=True)
    with h5py.File(file, "r+") as h5:
        values = np.repeat(h5[path][()][..., None], 2, axis=-1)
        del h5[path]
        h5.create_dataset(path, data=values, maxshape=(None, *values.shape[1:]), chunks=True)
        sign(h5)
    with pytest.raises(OSError, match=r"is damaged: .*, shape"):
        read_file(file)


@pytest.mark.parametrize("kind", FORGED)
def test_a_forged_restart_is_damage_and_the_one_before_is_used(kind, run, tmp_path):
    path = shutil.copy(run, tmp_path / "a.h5md")
    forge(path, FORGED[kind], [RESTART])
    assert "newest restart" in damage(path)
    assert (read_file(path).step, resumed(path).step) == (10, 10)
    forge(path, FORGED[kind], [EARLIER])
    with pytest.raises(OSError, match="is damaged"):
        resumed(path)


def test_a_restart_of_an_older_version_has_no_work(run, tmp_path):
    path = shutil.copy(run, tmp_path / "a.h5md")
    forge(path, {"work": None}, [RESTART, EARLIER])
    assert (damage(path), resumed(path).step) == ("", 20)


def test_check_fails_on_a_forged_restart(run, tmp_path):
    path = shutil.copy(run, tmp_path / "a.h5md")
    forge(path, FORGED["a shorter list"], [RESTART, EARLIER])
    assert outcome("check", path)[0] in (FAILED, SENTENCE)


@pytest.mark.parametrize("skin", [0.0, 1.5, 1e3, 1e10])
def test_forces_do_not_depend_on_a_forged_skin(skin, run, tmp_path):
    path = shutil.copy(run, tmp_path / "a.h5md")
    expected = resumed(path).potential_energy
    forge(path, {"skins": np.array([skin])}, [RESTART, EARLIER])
    assert resumed(path).potential_energy == pytest.approx(expected, rel=1e-12)  # rounding: another order of sums
