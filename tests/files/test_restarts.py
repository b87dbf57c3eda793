"""What a restart may hold: fields of another kind are damage, and the run goes on from the restart before it."""

import shutil

import h5py
import numpy as np
import pytest
from damages import FAILED, SENTENCE, outcome
from h5md_runs import N_ATOMS, resumed, simulation

from minimd.core.files.h5_items import put
from minimd.core.files.h5md_digest import EARLIER, RESTART, checked, read_group
from minimd.core.files.h5md_reader import damage, read_file

SOUND = np.zeros((N_ATOMS, 3))
FORGED = {  # arrays and numbers in place of those of the run; None: removed
    "a list of other atoms": {"list_0": np.zeros((1000, 3))},
    "a shorter list": {"list_0": SOUND[:-1]},
    "no list at all": {"list_0": SOUND[:0]},
    "a flat list": {"list_0": SOUND.ravel()},
    "a list of another type": {"list_0": SOUND.astype("f4")},
    "a list of whole numbers": {"list_0": SOUND.astype(int)},
    "a list that is not finite": {"list_0": SOUND * np.nan},
    "a list without a skin": {"list_3": SOUND},
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
            for field, value in changes.items():
                owner = arrays if field.startswith(ARRAYS) else numbers
                owner.pop(field, None)
                owner |= {} if value is None else {field: value}
            del h5[name]
            put(h5, checked(name, arrays, numbers))


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
