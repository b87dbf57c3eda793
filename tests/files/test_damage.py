"""Damaged files: every command ends in a sentence or a right result, and no check passes where a number was changed."""

import os
import resource
import shutil
import signal
from collections import Counter
from contextlib import suppress
from pathlib import Path

import ase.io
import h5py
import numpy as np
import pytest
from damages import (
    CRASH,
    FAILED,
    PASSED,
    RESTARTS,
    SCENES,
    SENTENCE,
    WAYS,
    damaged,
    in_child,
    make_file,
    numbers,
    outcome,
    run_command,
)
from wrong_calls import assert_answered

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
GOOD = {SENTENCE, FAILED, RIGHT}  # and not WRONG, DESTROYED, TRACEBACK, CRASH
SERIES_ALONE = (*RESTARTS, "minimd/blocks")  # to be left out: what a run in other parts may have otherwise


class Sound:
    """Files that are sound, and what they hold, and hold after they were resumed; each is made when it is wanted."""

    def __init__(self, folder):
        self.folder, self._files, self._numbers = folder, {}, {}

    def file(self, name):
        if name not in self._files:
            self._files[name] = make_file(self.folder, name)
        return self._files[name]

    def numbers(self, name):
        if name not in self._numbers:
            file, resumed = self.file(name), self.folder / "resumed.h5md"
            shutil.copy(file, resumed)
            for command in ("check", "replay" if name == "crash" else "resume"):
                expected = FAILED if (name, command) == ("crash", "check") else PASSED
                assert outcome(command, resumed)[0] == expected
            kept = {out: numbers(file, out) for out in (RESTARTS, RESTARTS[1:])}
            self._numbers[name] = kept | {"resume": numbers(resumed, SERIES_ALONE)}
        return self._numbers[name]

    def judged(self, name, seed, commands):
        """What commands make of a file that is damaged in a way: the way, the command, the judgement and its words."""
        target = self.folder / f"damaged-{seed}.h5md"
        way, known = damaged(self.file(name), target, seed), self.numbers(name)
        for command in commands:
            before = target.read_bytes()
            result, words = outcome(command, target)
            if result == PASSED:  # where a file is only read, nothing hangs on a restart that is not the newest
                leave_out = {"resume": SERIES_ALONE, "check": RESTARTS[1:]}.get(command, RESTARTS)
                expected = known["resume" if command == "resume" else leave_out]
                result = RIGHT if numbers(target, leave_out) == expected else WRONG
            elif result != CRASH and target.read_bytes() != before and "journal" not in way and "commit" not in way:
                result = DESTROYED
            yield name, way, seed, command, result, words
        for left in self.folder.glob("damaged-*"):
            left.rmdir() if left.is_dir() else left.unlink()


@pytest.fixture(scope="module")
def sound(tmp_path_factory):
    return Sound(tmp_path_factory.mktemp("sound"))


def counted(judgements):
    """How often each judgement was passed; fails with those that are bad."""
    found = list(judgements)
    assert not [one for one in found if one[4] not in GOOD]
    return Counter(one[4] for one in found)


def test_damaged_files_end_in_a_sentence_or_a_right_result(sound):
    """Every third way once, with one command."""
    commands = {"plain": ["check", "resume"], "crash": ["check", "replay"]}
    seeds = [(seed, ["plain", "crash"][seed // 3 % 2]) for seed in range(1, len(WAYS), 3)]
    counts = counted(one for seed, name in seeds for one in sound.judged(name, seed, [commands[name][seed // 2 % 2]]))
    assert counts[SENTENCE] > len(WAYS) // 9
    assert counts[RIGHT] > 0


@pytest.mark.slow
def test_two_thousand_damaged_files_end_in_a_sentence_or_a_right_result(sound):
    def all_of(seed):
        name = list(SCENES)[(seed + seed // len(WAYS)) % len(SCENES)]
        plot = ["plot"] if seed % 7 == 0 else []  # it takes time
        return sound.judged(name, seed, ["check", *plot, "replay" if name == "crash" else "resume"])

    assert run_command("plot", sound.file("plain")) == 0  # children find loaded what they need
    counts = counted(one for seed in range(1000, 3000) for one in all_of(seed))
    assert counts[SENTENCE] > 2000
    assert counts[RIGHT] > 200


def within(change):
    """A damage of a file that is done through h5py."""

    def damaging(path):
        with h5py.File(path, "r+") as h5:
            change(h5)

    return damaging


def retyped(name, kind):
    """The same bytes of another type."""

    def change(h5):
        grows = h5[name].maxshape[:1] == (None,)
        values = h5.pop(name)[()].view(kind)
        h5.create_dataset(name, data=values, maxshape=(None, *values.shape[1:]) if grows else None)

    return within(change)


def foreign(path):
    with h5py.File(path, "w") as h5:
        h5["data"] = [1, 2]


def add_series(h5):
    h5["observables/conserved_energy/value"] = np.zeros(len(h5["minimd/time"]))


def rename_a_link(h5):
    """One of the names of an item that has several."""
    h5.move("observables/angular_momentum/time", "observables/angular_momentum/tine")


FOREIGN = {  # what is in the place of the file, the error, and what is said
    "nothing": (Path.unlink, FileNotFoundError, "does not exist"),
    "a text": (lambda path: path.write_text("not at all"), ValueError, "not an HDF5 file"),
    "a file of others": (foreign, ValueError, "not written by minimd"),
}
TYPED = ("observables/pressure/value", "particles/trajectory/velocity/value", "minimd/masses")
DAMAGES = {  # what is damaged, and what is said
    "half a file": (lambda path: os.truncate(path, path.stat().st_size // 2), "is damaged"),
    **{f"{name} as {kind}": (retyped(name, kind), "is damaged") for name in TYPED for kind in (">f8", "<i8")},
    "a name": (within(rename_a_link), "its description is not"),
    "a new series": (within(add_series), "its description is not"),
    "a size": (within(lambda h5: h5["minimd/time"].resize(10**14, axis=0)), "larger than the file"),
}


@pytest.mark.parametrize("what", [*FOREIGN, *DAMAGES])
def test_what_is_damaged_is_said(what, sound, tmp_path):
    """Sizes before memory is asked for."""
    change, error, shown = FOREIGN.get(what) or (DAMAGES[what][0], OSError, DAMAGES[what][1])
    path = Path(shutil.copy(sound.file("plain"), tmp_path / "a.h5md"))
    change(path)
    assert_answered(lambda: verify_frames(path), error, "a.h5md", shown)
    if " as " not in what:
        assert_answered(lambda: read_file(path), error, "a.h5md", shown)


@pytest.mark.parametrize("kind", [">f8", "<i8"])
def test_a_restart_of_another_type_is_not_the_newest(kind, sound, tmp_path):
    path = Path(shutil.copy(sound.file("plain"), tmp_path / "a.h5md"))
    retyped("minimd/restart/positions", kind)(path)
    assert "newest restart" in damage(path)
    assert "newest restart" in read_file(path).repaired


def test_a_damaged_restart_is_set_aside_by_resume(sound, tmp_path):
    """Where it claims to lie may be the place of others: it is not written, nor given free."""

    path = Path(shutil.copy(sound.file("plain"), tmp_path / "a.h5md"))
    within(lambda h5: h5["minimd/restart/velocities"].write_direct(np.full((32, 3), np.nan)))(path)
    assert outcome("resume", path)[0] == PASSED
    with h5py.File(path) as h5:
        assert np.isnan(h5["minimd/restart_damaged_1/velocities"]).all()
    assert outcome("check", path)[0] == PASSED
    assert numbers(path, SERIES_ALONE) == sound.numbers("plain")["resume"]


COMPOUND, ANY_LENGTH, TEXT = np.dtype([("a", "f8"), ("b", "i8")]), h5py.vlen_dtype(np.float64), h5py.string_dtype()
POSITIONS = "minimd/restart/positions"


def external(h5, name, folder):
    values = h5.pop(name)[()]
    h5.create_dataset(name, values.shape, values.dtype, external=[(str(folder / "precious"), 0, values.nbytes)])


def virtual(h5, name, folder):
    values = h5.pop(name)[()]
    layout = h5py.VirtualLayout(values.shape, values.dtype)
    layout[...] = h5py.VirtualSource(str(folder / "precious.h5"), "x", values.shape)
    h5.create_virtual_dataset(name, layout)


def typed(kind):
    return lambda h5, name, _: h5.create_dataset(name, h5.pop(name).shape, kind)


def made(**how):
    return lambda h5, name, _: h5.create_dataset(name, **how)


def put(make):
    """Something in the place of what was there, if anything was."""
    return lambda h5, name, folder: (h5.pop(name, None), h5.__setitem__(name, make(h5, folder)))


def attribute(key, make, kind=None):
    return lambda h5, name, _: h5[name].attrs.create(key, make, dtype=kind)


def linked_group(h5, name, _):
    h5.move(name, "kept")
    h5[name] = h5py.ExternalLink("a", "b")


def deep(h5, name, _):
    h5.create_group("minimd/" + "/".join("a" * 2000))


def half_as_large(h5, name, _):
    for k in range(3):
        h5.create_dataset(f"{name}{k}", (h5.id.get_filesize() // 16,), "f8")


HOSTILE = {  # a file leads elsewhere, or asks for what it does not hold: what is done, and the name of the culprit
    "an external restart": (external, POSITIONS),
    "external frames": (external, "particles/trajectory/velocity/value"),
    "external species": (external, "minimd/species_index"),
    "a virtual dataset": (virtual, "minimd/restart/velocities"),
    "an external link": (put(lambda h5, folder: h5py.ExternalLink(str(folder / "precious.h5"), "x")), "minimd/masses"),
    "an external link as a group": (linked_group, "observables"),
    "a link to a link": (put(lambda *_: h5py.SoftLink("/minimd/restart/../cell")), "minimd/cell"),
    "a link to itself": (put(lambda *_: h5py.SoftLink("/minimd/loop")), "minimd/loop"),
    "a group in itself": (put(lambda h5, _: h5["/"]), "minimd/again"),
    "a deep group": (deep, "minimd/a/a/a/a/a/a/a/a"),
    "a compound": (typed(COMPOUND), POSITIONS),
    "references": (typed(h5py.ref_dtype), "minimd/masses"),
    "numbers of any length": (typed(ANY_LENGTH), "minimd/cell"),
    "texts": (typed(TEXT), POSITIONS),
    "opaque bytes": (typed("V8"), "minimd/masses"),
    "no numbers": (made(data=h5py.Empty("V8")), "minimd/nothing"),
    "a type": (put(lambda *_: np.dtype("f8")), "minimd/kind"),
    "a filter": (made(data=np.zeros(10), chunks=(10,), compression="gzip"), "minimd/zipped"),
    "numbers that are not there": (made(shape=(10**12,), dtype="f8", chunks=(1,)), "minimd/zeros"),
    "a size that overflows": (made(shape=(2**40, 2**40), dtype="f8", chunks=(1, 1)), "minimd/zeros"),
    "many half as large": (half_as_large, "minimd/zeros"),
    "an attribute of another kind": (attribute("extra", np.zeros((), COMPOUND), COMPOUND), "minimd"),
    "an attribute of many texts": (attribute("more", ["a"] * 300, TEXT), "minimd"),
    "many attributes": (lambda h5, name, _: [h5[name].attrs.create(f"a{k}", k) for k in range(300)], "minimd"),
}
READERS = {
    "check": lambda file: cli.main(["check", file]),
    "plot": lambda file: cli.main(["plot", file]),
    "view": lambda file: cli.main(["view", file]),
    "resume": lambda file: cli.main(["resume", file, "--steps", "5"]),
    "frames": lambda file: cli.main(["frames", file, "--at", "5"]),
    "replay": lambda file: cli.main(["replay", file]),
    "append": lambda file: edit(file, lambda h5: None),
    "universe": universe,
    "ase": ase.io.read,
    "structure": system_from_file,
    "frame by frame": lambda file: list(velocities_of(file, 1)),
    "MDAnalysis": RunReader,
}
ONE_OF = {way: [list(READERS)[k % len(READERS)]] for k, way in enumerate(HOSTILE)}  # another reader for each way
ALL_OF = {way: list(READERS) for way in HOSTILE}
FAST = {**ONE_OF, "an external restart": list(READERS)}


@pytest.mark.parametrize(
    ("way", "readers"),
    [*FAST.items(), *(pytest.param(*row, marks=pytest.mark.slow) for row in ALL_OF.items())],
    ids=[*HOSTILE, *(f"{way}, by all readers" for way in HOSTILE)],
)
def test_a_file_that_leads_elsewhere_is_refused_wherever_it_is_opened(
    way, readers, sound, tmp_path, monkeypatch, capfd
):
    """Its maker has signed it again. No other file is changed, and the message names the culprit."""
    monkeypatch.chdir(tmp_path)
    change, culprit = HOSTILE[way]
    shutil.copy(sound.file("plain"), "a.h5md")
    Path("precious").write_bytes(np.ones(10**4).tobytes())
    with h5py.File("precious.h5", "w") as other:
        other["x"] = np.ones((32, 3))
    with h5py.File("a.h5md", "r+") as h5:
        change(h5, culprit, tmp_path)
        if change is not deep:  # which takes a quarter of a minute
            with suppress(Exception):
                sign(h5)
    before = {file: file.read_bytes() for file in Path().iterdir()}
    for name in readers:
        try:
            assert READERS[name]("a.h5md") == 2, name
            words = capfd.readouterr().err
        except (OSError, ValueError) as error:
            words = str(error)
        assert "refused" in words, (name, words)
        assert culprit in words, (name, words)
    assert {file: file.read_bytes() for file in Path().iterdir()} == before


@pytest.mark.parametrize("trouble", ["little time", "children are ignored"])
def test_a_first_look_needs_no_more_than_it_has(trouble, sound):
    def look():
        if trouble == "little time":
            resource.setrlimit(resource.RLIMIT_CPU, (1000, 1000))
            first_look.SECONDS = 10_000
        else:
            signal.signal(signal.SIGCHLD, signal.SIG_IGN)
        verify_frames(sound.file("plain"))
        return "right"

    sound.file("plain")
    assert in_child(look) == "right"


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
