"""Damaged files: every command ends in a sentence or a right result, and no check passes where a number was changed."""

import os
import re
import resource
import shutil
import signal
from collections import Counter
from contextlib import suppress
from functools import partial
from pathlib import Path
from unittest import mock

import ase.io
import damages
import h5py
import numpy as np
import pytest
from damages import FAILED, PASSED, RESTARTS, SENTENCE, WAYS, in_child, numbers, outcome, run_command
from h5md_runs import simulation
from wrong_calls import assert_answered

import minimd as md
from minimd.commands import main as cli
from minimd.core.files import h5md_reader
from minimd.core.files.h5md_digest import sign
from minimd.core.files.h5md_reader import damage, frames_of, looked_at, read_file, verify_frames
from minimd.core.files.h5md_writer import H5MDWriter
from minimd.core.files.structure_file import system_from_file
from minimd.mdanalysis import universe
from minimd.mdanalysis.universes import RunReader

RIGHT, WRONG, DESTROYED = "a right result", "passed although changed", "something sound was destroyed"
GOOD = {SENTENCE, FAILED, RIGHT}  # and not WRONG, DESTROYED, TRACEBACK, CRASH
SERIES_ALONE = (*RESTARTS, "minimd/blocks")  # to be left out: what a run in other parts may have otherwise
COMPOUND, ANY_LENGTH, TEXT = np.dtype([("a", "f8"), ("b", "i8")]), h5py.vlen_dtype(np.float64), h5py.string_dtype()
POSITIONS = "minimd/restart/positions"
ENDLESS = pytest.param(lambda: any(iter(int, 1)), marks=pytest.mark.slow)
LOOKS = [os.abort, lambda: os._exit(0), lambda: os._exit(7), ENDLESS]


class Sound:
    """Files that are sound, and what they hold, and hold after they were resumed; each is made when it is wanted."""

    def __init__(self, folder):
        self.folder, self._files, self._numbers = folder, {}, {}

    def file(self, name):
        if name not in self._files:
            self._files[name] = damages.make_file(self.folder, name)
        return self._files[name]

    def numbers(self, name):
        if name not in self._numbers:
            file, resumed = self.file(name), self.folder / "resumed.h5md"
            shutil.copy(file, resumed)
            is_crash = name == "crash"
            assert outcome("check", resumed)[0] == (FAILED if is_crash else PASSED)
            assert outcome("replay" if is_crash else "resume", resumed)[0] == PASSED
            kept = {out: numbers(file, out) for out in (RESTARTS, RESTARTS[1:])}
            self._numbers[name] = kept | {"resume": numbers(resumed, SERIES_ALONE)}
        return self._numbers[name]

    def judged(self, name, seed, commands):
        """What commands make of a file that is damaged in a way: the way, the command, the judgement and its words."""
        target = self.folder / f"damaged-{seed}.h5md"
        way, known = damages.damaged(self.file(name), target, seed), self.numbers(name)
        for command in commands:
            before = target.read_bytes()
            result, words = outcome(command, target)
            if result == PASSED:  # where a file is only read, nothing hangs on a restart that is not the newest
                leave_out = {"resume": SERIES_ALONE, "check": RESTARTS[1:]}.get(command, RESTARTS)
                expected = known["resume" if command == "resume" else leave_out]
                result = RIGHT if numbers(target, leave_out) == expected else WRONG
            elif result != damages.CRASH and target.read_bytes() != before and not re.search("journal|commit", way):
                result = DESTROYED
            yield name, way, seed, command, result, words
        for left in self.folder.glob("damaged-*"):
            left.rmdir() if left.is_dir() else left.unlink()


@pytest.fixture(scope="module")
def sound(tmp_path_factory):
    return Sound(tmp_path_factory.mktemp("sound"))


@pytest.fixture
def path(sound, tmp_path):
    """A copy of a sound file."""
    return Path(shutil.copy(sound.file("plain"), tmp_path / "a.h5md"))


def counted(judgements):
    """How often each judgement was passed; fails with those that are bad."""
    found = list(judgements)
    assert not [one for one in found if one[4] not in GOOD]
    return Counter(one[4] for one in found)


def test_damaged_files_end_in_a_sentence_or_a_right_result(sound):
    seeds = range(1, len(WAYS), 6)
    counts = counted(one for k in seeds for one in sound.judged("plain", k, [["check", "resume"][k // 6 % 2]]))
    assert counts[SENTENCE] >= len(seeds) // 3
    assert counts[RIGHT] > 0


@pytest.mark.slow
def test_two_thousand_damaged_files_end_in_a_sentence_or_a_right_result(sound):
    def all_of(seed):
        name = list(damages.SCENES)[(seed + seed // len(WAYS)) % len(damages.SCENES)]
        plot = ["plot"] if seed % 7 == 0 else []  # it takes time
        return sound.judged(name, seed, ["check", *plot, "replay" if name == "crash" else "resume"])

    assert run_command("plot", sound.file("plain")) == 0  # children find loaded what they need
    counts = counted(one for seed in range(1000, 3000) for one in all_of(seed))
    assert counts[SENTENCE] > 2000
    assert counts[RIGHT] > 200


def retyped(h5, name, kind):
    """The same bytes of another type."""
    grows = h5[name].maxshape[:1] == (None,)
    values = h5.pop(name)[()].view(kind)
    h5.create_dataset(name, data=values, maxshape=(None, *values.shape[1:]) if grows else None)


FOREIGN = {  # what is in the place of the file, the error, and what is said
    "nothing": (Path.unlink, FileNotFoundError, "does not exist"),
    "a text": (lambda path: path.write_text("not at all"), ValueError, "not an HDF5 file"),
    "a file of others": (lambda path: h5py.File(path, "w").close(), ValueError, "not written by minimd"),
    "half a file": (lambda path: os.truncate(path, path.stat().st_size // 2), OSError, "is damaged"),
}
TYPED = ("observables/pressure/value", "particles/trajectory/velocity/value", "minimd/masses")
ANGULAR, ADDED = "observables/angular_momentum/ti", "observables/conserved_energy/value"
DAMAGES = {  # what is damaged, and what is said; an item may have several names
    **{f"{name} as {k}": (partial(retyped, name=name, kind=k), "is damaged") for name in TYPED for k in (">f8", "<i8")},
    "a name": (lambda h5: h5.move(f"{ANGULAR}me", f"{ANGULAR}ne"), "stored description"),
    "a new series": (lambda h5: h5.update({ADDED: np.zeros(len(h5["minimd/time"]))}), "stored description"),
    "a size": (lambda h5: h5["minimd/time"].resize(10**14, axis=0), "bytes more"),
}


@pytest.mark.parametrize("what", [*FOREIGN, *DAMAGES])
def test_what_is_damaged_is_said(what, path):
    """Sizes before memory is asked for."""
    change, *_, shown = (FOREIGN | DAMAGES)[what]
    if what in FOREIGN:
        change(path)
    else:
        with h5py.File(path, "r+") as h5:
            change(h5)
    for read in (verify_frames, read_file)[: 1 if " as " in what else 2]:
        assert_answered(lambda: read(path), FOREIGN[what][1] if what in FOREIGN else OSError, "a.h5md", shown)


@pytest.mark.parametrize("kind", [">f8", "<i8"])
def test_a_restart_of_another_type_is_not_the_newest(kind, path):
    with h5py.File(path, "r+") as h5:
        retyped(h5, "minimd/restart/positions", kind)
    assert all("newest restart" in told for told in (damage(path), read_file(path).repaired))


def test_a_damaged_restart_is_set_aside_by_resume(sound, path):
    """Where it claims to lie may be the place of others: it is not written, nor given free."""
    with h5py.File(path, "r+") as h5:
        h5["minimd/restart/velocities"][:] = np.nan
    assert outcome("resume", path)[0] == PASSED
    with h5py.File(path) as h5:
        assert np.isnan(h5["minimd/restart_damaged_1/velocities"]).all()
    assert (outcome("check", path)[0], numbers(path, SERIES_ALONE)) == (PASSED, sound.numbers("plain")["resume"])


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


HOSTILE = {  # a file leads elsewhere, or asks for what it does not hold: what is done, and the name of the culprit
    "an external restart": (external, POSITIONS), "external frames": (external, "particles/trajectory/velocity/value"),
    "external species": (external, "minimd/species_index"), "a virtual dataset": (virtual, "minimd/restart/velocities"),
    "an external link": (put(lambda h5, folder: h5py.ExternalLink(str(folder / "precious.h5"), "x")), "minimd/masses"),
    "an external link as a group": (linked_group, "observables"),
    "a link to a link": (put(lambda *_: h5py.SoftLink("/minimd/restart/../cell")), "minimd/cell"),
    "a link to itself": (put(lambda *_: h5py.SoftLink("/minimd/loop")), "minimd/loop"),
    "a group in itself": (put(lambda h5, _: h5["/"]), "minimd/again"),
    "a deep group": (lambda h5, *_: h5.create_group("minimd/" + "/".join("a" * 2000)), "minimd/a/a/a/a/a/a/a/a"),
    "a compound": (typed(COMPOUND), POSITIONS), "references": (typed(h5py.ref_dtype), "minimd/masses"),
    "numbers of any length": (typed(ANY_LENGTH), "minimd/cell"), "texts": (typed(TEXT), POSITIONS),
    "opaque bytes": (typed("V8"), "minimd/masses"), "no numbers": (made(data=h5py.Empty("V8")), "minimd/nothing"),
    "a type": (put(lambda *_: np.dtype("f8")), "minimd/kind"),
    "a filter": (made(data=np.zeros(10), chunks=(10,), compression="gzip"), "minimd/zipped"),
    "numbers that are not there": (made(shape=(10**12,), dtype="f8", chunks=(1,)), "minimd/zeros"),
    "a size that overflows": (made(shape=(2**40, 2**40), dtype="f8", chunks=(1, 1)), "minimd/zeros"),
    "many half as large": (lambda h5, name, _: [
        h5.create_dataset(f"{name}{k}", (h5.id.get_filesize() // 16,), "f8") for k in "012"], "minimd/zeros"),
    "an attribute of another kind": (attribute("extra", np.zeros((), COMPOUND), COMPOUND), "minimd"),
    "an attribute of many texts": (attribute("more", ["a"] * 300, TEXT), "minimd"),
    "many attributes": (lambda h5, name, _: [h5[name].attrs.create(f"a{k}", k) for k in range(300)], "minimd"),
}  # fmt: skip
READERS = {
    **{name: lambda file, name=name: cli.main([name, file]) for name in ("check", "plot", "view", "replay")},
    "resume": lambda file: cli.main(["resume", file, "--steps", "5"]),
    "frames": lambda file: cli.main(["frames", file, "--at", "5"]),
    "append": lambda file: H5MDWriter.append_to(file, simulation().engine),
    "frame by frame": lambda file: list(frames_of(file, [0], md.units.LJ)), "universe": universe, "ase": ase.io.read,
    "structure": system_from_file, "MDAnalysis": RunReader,
}  # fmt: skip
ONE_OF = {way: [list(READERS)[k % len(READERS)]] for k, way in enumerate(HOSTILE)}  # another reader for each way
ALL_OF = {way: list(READERS) for way in HOSTILE}
ROWS = [*ONE_OF.items(), *(pytest.param(*row, marks=pytest.mark.slow) for row in ALL_OF.items())]


@pytest.mark.parametrize(("way", "readers"), ROWS, ids=[*HOSTILE, *(f"{way}, by all readers" for way in HOSTILE)])
def test_a_file_that_leads_elsewhere_is_refused_wherever_it_is_opened(way, readers, path, monkeypatch, capfd):
    """Its maker has signed it again. No other file is changed, and the message names the culprit."""
    monkeypatch.chdir(path.parent)
    change, culprit = HOSTILE[way]
    Path("precious").write_bytes(np.ones(10**4).tobytes())
    with h5py.File("precious.h5", "w") as other:
        other["x"] = np.ones((32, 3))
    with h5py.File("a.h5md", "r+") as h5:
        change(h5, culprit, path.parent)
        with suppress(Exception):
            way == "a deep group" or sign(h5)  # a deep one takes a quarter of a minute
    before = {file: file.read_bytes() for file in Path().iterdir()}
    for name in readers:
        try:
            assert READERS[name]("a.h5md") == 2, name
            words = capfd.readouterr().err
        except (OSError, ValueError) as error:
            words = str(error)
        assert [shown for shown in ("refused", culprit) if shown not in words] == [], (name, words)
    assert {file: file.read_bytes() for file in Path().iterdir()} == before


def test_a_first_look_needs_no_more_than_it_has(path):
    def look():
        resource.setrlimit(resource.RLIMIT_CPU, (1000, 1000))  # little time, and children are ignored
        with mock.patch.object(h5md_reader, "SECONDS", 10_000):
            verify_frames(path)
        signal.signal(signal.SIGCHLD, signal.SIG_IGN)
        verify_frames(path)
        return "right"

    assert in_child(look) == "right"


@pytest.mark.parametrize("look", LOOKS)
def test_a_look_that_crashes_or_never_ends_is_a_sentence(look, tmp_path, monkeypatch, capfd):
    monkeypatch.setattr(h5md_reader, "SECONDS", 1)
    children = lambda: sorted(one.read_text() for one in Path("/proc/self/task").glob("*/children"))  # noqa: E731
    path, before = tmp_path / "a.h5md", children()
    path.write_bytes(b"something")
    with pytest.raises(OSError, match=r"a\.h5md' is damaged: to read it takes more memory"):
        looked_at(path, lambda: np.zeros(h5md_reader.MEMORY // 4))
    assert_answered(lambda: looked_at(path, look), OSError, "a.h5md' is damaged: its reader crashes")
    assert looked_at(path, lambda: (1, "two")) == (1, "two")
    with pytest.raises(ZeroDivisionError):
        looked_at(path, lambda: 1 // 0)
    assert capfd.readouterr() == ("", "")
    assert "".join(children()) == "".join(before)  # none is left
