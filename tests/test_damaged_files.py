"""Damaged files: every command ends in a sentence or a right result; none crashes, and no check passes where a number was changed."""

import os
import shutil
from collections import Counter
from contextlib import suppress
from pathlib import Path

import ase.io
import h5py
import numpy as np
import pytest
from damages import CRASH, FAILED, PASSED, SENTENCE, TRACEBACK, damaged, make_files, numbers, outcome
from ways_of_damage import HOSTILE, RESTARTS, WAYS

from minimd.commands import main as cli
from minimd.files import first_look
from minimd.files.first_look import looked_at
from minimd.files.h5md_digest import sign
from minimd.files.h5md_reader import damage, read_file, velocities_of, verify_frames
from minimd.files.h5md_writer import edit
from minimd.files.structure_file import system_from_file
from minimd.mdanalysis import universe
from minimd.mdanalysis.readers import RunReader

RIGHT, WRONG, DESTROYED = "a right result", "passed although changed", "something sound was destroyed"
GOOD, BAD = {SENTENCE, FAILED, RIGHT}, {WRONG, DESTROYED, TRACEBACK, CRASH}
SERIES_ALONE = (*RESTARTS, "minimd/blocks")  # to be left out: what a run in other parts may have otherwise


def references(files, folder):
    """What the sound files hold, and hold after they were resumed."""
    found = {}
    for name, file in files.items():
        resumed = folder / "resumed.h5md"
        resumed.write_bytes(file.read_bytes())
        commands = ("replay", "check", "plot") if name == "crash" else ("check", "plot", "resume")
        for command in commands:
            assert outcome(command, resumed)[0] == (FAILED if (name, command) == ("crash", "check") else PASSED), (
                outcome(command, resumed)
            )
        found[name] = {out: numbers(file, out) for out in (RESTARTS, RESTARTS[1:])}, numbers(resumed, SERIES_ALONE)
    return found


def all_commands(name, seed):
    """Those that read such a file; it is drawn only now and then, because that takes time."""
    return ["check", *(["plot"] if seed % 7 == 0 else []), "replay" if name == "crash" else "resume"]


def judged(files, references, folder, seed, commands):
    """What the commands make of a file that is damaged in a way: the way, and the command, the judgement and its words."""
    name = list(files)[(seed + seed // len(WAYS)) % len(files)]
    target = folder / f"damaged-{seed}.h5md"
    way = damaged(files[name], target, seed)
    known, resumed = references[name]
    for command in commands(name, seed):
        before = target.read_bytes()
        result, words = outcome(command, target)
        if result == PASSED:
            if command == "resume":
                result = RIGHT if numbers(target, SERIES_ALONE) == resumed else WRONG
            else:
                leave_out = (
                    RESTARTS[1:] if command == "check" else RESTARTS
                )  # nothing hangs on a restart before the newest that is not there
                result = RIGHT if numbers(target, leave_out) == known[leave_out] else WRONG
        elif result != CRASH and target.read_bytes() != before and "journal" not in way and "commit" not in way:
            result = DESTROYED
        yield f"{name} {way}", (command, result, words)
    for left in folder.glob("damaged-*"):
        left.rmdir() if left.is_dir() else left.unlink()


@pytest.fixture(scope="module")
def sound(tmp_path_factory):
    folder = tmp_path_factory.mktemp("sound")
    files = make_files(folder)
    return files, references(files, folder), folder


def test_damaged_files_end_in_a_sentence_or_a_right_result(sound):
    """Every third way once, with one command."""
    counts = check_seeds(sound, range(1, len(WAYS), 3), commands_of_one)
    assert counts[SENTENCE] > len(WAYS) // 9
    assert counts[RIGHT] > 0


def commands_of_one(name, seed):
    """One of those of all_commands."""
    several = all_commands(name, seed)
    return [several[seed % len(several)]]


@pytest.mark.slow
def test_two_thousand_damaged_files_end_in_a_sentence_or_a_right_result(sound):
    counts = check_seeds(sound, range(1000, 3000), all_commands)
    assert counts[SENTENCE] > 2000
    assert counts[RIGHT] > 200


def check_seeds(sound, seeds, commands):
    """Counts of the judgements; fails with those that are bad."""
    found = [(seed, kind, *one) for seed in seeds for kind, one in judged(*sound, seed, commands)]
    assert not [one for one in found if one[3] not in GOOD]
    return Counter(one[3] for one in found)


def spoiled(sound, path, change):
    """A copy of the plain file, changed through h5py."""
    shutil.copy(sound[0]["plain"], path)
    with h5py.File(path, "r+") as h5:
        change(h5)
    return path


@pytest.mark.parametrize(
    "name",
    ["observables/pressure/value", "particles/trajectory/velocity/value", "minimd/masses", "minimd/restart/positions"],
)
@pytest.mark.parametrize("kind", [">f8", "<i8"])
def test_the_same_bytes_of_another_type_are_not_what_was_written(sound, tmp_path, name, kind):
    def retyped(h5):
        values, grows = h5[name][()], h5[name].maxshape[:1] == (None,)
        del h5[name]
        h5.create_dataset(name, data=values.view(kind), maxshape=(None, *values.shape[1:]) if grows else None)

    path = spoiled(sound, tmp_path / "a.h5md", retyped)
    if "restart" in name:
        assert "newest restart" in damage(path)
        assert "newest restart" in read_file(path).repaired
    else:
        with pytest.raises(OSError, match=r"a\.h5md' is damaged"):
            verify_frames(path)


def test_every_name_is_signed(sound, tmp_path):
    """Also those of an item that has several."""
    path = spoiled(
        sound,
        tmp_path / "a.h5md",
        lambda h5: h5.move("observables/angular_momentum/time", "observables/angular_momentum/tine"),
    )
    with pytest.raises(OSError, match="description is not the one that was written"):
        verify_frames(path)


def test_a_series_that_was_added_is_damage(sound, tmp_path):
    def added(h5):
        h5["observables/conserved_energy/value"] = np.zeros(len(h5["minimd/time"]))

    with pytest.raises(OSError, match="description is not the one that was written"):
        read_file(spoiled(sound, tmp_path / "a.h5md", added))


def test_a_dataset_larger_than_the_file_is_refused_before_memory_is_asked_for(sound, tmp_path):
    with pytest.raises(OSError, match="larger than the file"):
        read_file(spoiled(sound, tmp_path / "a.h5md", lambda h5: h5["minimd/time"].resize(10**14, axis=0)))


READERS = {
    "check": lambda file: cli.main(["check", file]),
    "plot": lambda file: cli.main(["plot", file]),
    "view": lambda file: cli.main(["view", file]),
    "resume": lambda file: cli.main(["resume", file, "--steps", "5"]),
    "frames": lambda file: cli.main(["frames", file, "--at", "5"]),
    "replay": lambda file: cli.main(["replay", file]),
    "append": lambda file: edit(file, lambda h5: None),
    "universe": universe,
    "ase": lambda file: ase.io.read(file),
    "structure": lambda file: system_from_file(file),
    "frame by frame": lambda file: list(velocities_of(file, 1)),
    "MDAnalysis": lambda file: RunReader(file),
}


@pytest.mark.parametrize("way", HOSTILE)
def test_a_file_that_leads_elsewhere_is_refused_wherever_it_is_opened(way, sound, tmp_path, monkeypatch, capfd):
    """Its maker has signed it again. No other file is changed, and the message names the culprit."""
    monkeypatch.chdir(tmp_path)
    shutil.copy(sound[0]["plain"], "a.h5md")
    Path("precious").write_bytes(np.ones(10**4).tobytes())
    with h5py.File("precious.h5", "w") as other:
        other["x"] = np.ones((32, 3))
    with h5py.File("a.h5md", "r+") as h5:
        culprit = HOSTILE[way](h5, tmp_path)
        with suppress(Exception):
            sign(h5)
    before = {file: file.read_bytes() for file in Path().iterdir()}
    for name, read in READERS.items():
        try:
            assert read("a.h5md") == 2, name
            words = capfd.readouterr().err
        except (OSError, ValueError) as error:
            words = str(error)
        assert "refused" in words, (name, words)
        assert culprit in words, (name, words)
    assert {file: file.read_bytes() for file in Path().iterdir()} == before


def test_a_damaged_restart_is_set_aside_by_resume(sound, tmp_path):
    """Where it claims to lie may be the place of others: it is not written, nor given free."""

    def spoil(h5):
        h5["minimd/restart/velocities"][...] = np.nan

    path = spoiled(sound, tmp_path / "a.h5md", spoil)
    assert outcome("resume", path)[0] == PASSED
    with h5py.File(path) as h5:
        assert np.isnan(h5["minimd/restart_damaged_1/velocities"]).all()
    assert outcome("check", path)[0] == PASSED
    assert numbers(path, SERIES_ALONE) == sound[1]["plain"][1]


def children():
    """The processes that this one has started, and that are not waited for."""
    return {one for task in Path("/proc/self/task").iterdir() for one in (task / "children").read_text().split()}


def test_a_look_that_crashes_or_never_ends_is_a_sentence(tmp_path, monkeypatch, capfd):
    monkeypatch.setattr(first_look, "SECONDS", 1)
    path, before = tmp_path / "a.h5md", children()
    path.write_bytes(b"something")

    def endless():
        while True:
            pass

    with pytest.raises(OSError, match=r"a\.h5md' is damaged: to read it takes more memory"):
        looked_at(path, lambda: np.zeros(first_look.MEMORY // 4))
    for look in (os.abort, endless, lambda: os._exit(0), lambda: os._exit(7)):
        with pytest.raises(OSError, match=r"a\.h5md' is damaged: HDF5 crashes"):
            looked_at(path, look)
    assert looked_at(path, lambda: (1, "two")) == (1, "two")
    with pytest.raises(ZeroDivisionError):
        looked_at(path, lambda: 1 // 0)
    assert capfd.readouterr() == ("", "")
    assert children() == before  # none is left
