"""The door: every HDF5 file that minimd reads or continues is opened here, and searched before anything in it is read.

HDF5 lets a file lead elsewhere: links may name objects in other files, and the numbers of a dataset may lie in any
other file, which is then read, or overwritten when a run goes on.
A file of minimd consists of groups and plain datasets in itself; all others are refused.
"""

from collections.abc import Iterator
from contextlib import contextmanager
from math import prod
from pathlib import Path
from typing import Any

import h5py
from h5py import h5a, h5d, h5g, h5l, h5o, h5t

from minimd.console.words import printable
from minimd.files.journaled_file import repair
from minimd.structure.errors import sentence

NUMBERS = (h5t.INTEGER, h5t.FLOAT, h5t.ENUM)  # bools and species are enumerations
TEXTS = (*NUMBERS, h5t.STRING)
CRASH_TEXTS = ("findings", "words", "simulation")
MAY_BE_TEXTS = ("minimd/species_names", *(f"minimd/crash_report/{name}" for name in CRASH_TEXTS))
REFERENCE = b"particles_group"  # the only attribute that refers to an object
LAYOUTS = (h5d.COMPACT, h5d.CONTIGUOUS, h5d.CHUNKED)
MOST_TEXTS = 256  # attributes of an object, and texts in an attribute; minimd has some 30
DEEPEST = 8  # groups in groups; minimd has 5
REASONS = {  # why a file cannot be opened, by the words of HDF5
    "unable to lock file": "another run is writing it",
    "truncated file": "it is damaged, it ends before its data do; copy it again, or run again",
}


def opened(path: str | Path) -> h5py.File:
    """Open a minimd file for reading. A commit that was interrupted is finished first.

    Raises FileNotFoundError if it does not exist.  ValueError if it is not HDF5, or not written by minimd.  OSError if
    it is damaged, as admitted, or if a run is writing it.
    """
    if not Path(path).is_file():
        raise FileNotFoundError(f"file {str(path)!r} does not exist; give the .h5md file of a run")
    try:
        repair(path)
        if not h5py.is_hdf5(path):
            raise ValueError(f"file {str(path)!r} is not an HDF5 file; give the .h5md file of a run")
        h5 = h5py.File(path, "r")
    except (OSError, RuntimeError) as error:
        words = sentence(error)
        reason = next((told for sign, told in REASONS.items() if sign in words), words.splitlines()[0])
        raise OSError(f"file {str(path)!r} cannot be opened: {reason}") from error
    with damage_told(path):
        is_ours = h5.id.links.exists(b"minimd")
    if not is_ours:
        h5.close()
        raise ValueError(f"file {str(path)!r} was not written by minimd; it has no group 'minimd'")
    return admitted(h5, path)


def admitted(h5: h5py.File, path: str | Path) -> h5py.File:
    """The file, if all of it is of the kinds that minimd writes, lies in the file, and is not larger than it.

    path : for messages.  Raises OSError, with the name of the first thing that is not, and closes the file.
    """
    try:
        with damage_told(path):
            problem = _strange_thing(h5)
        if problem:
            remedy = "minimd writes no such thing, do not use this file"
            raise OSError(f"file {str(path)!r} is refused: {problem}; {remedy}")
    except BaseException:
        h5.close()
        raise
    return h5


def _strange_thing(h5: h5py.File) -> str:
    """The first thing that minimd does not write, in words; empty if there is none.

    No link out of the file is followed, and no number read.
    """
    room, seen, groups = h5.id.get_filesize(), {h5o.get_info(h5.id).addr}, [("", h5.id)]
    while groups:
        path, group = groups.pop()
        links: list[tuple[bytes, int]] = []
        # h5py uses one info for all
        group.links.iterate(lambda key, info, links=links: links.append((key, info.type)), info=True)
        for key, kind in links:
            name = f"{path}{key.decode(errors='replace')}"
            if kind != h5l.TYPE_HARD:
                return f"{name!r} is a link by name, which may lead into another file"
            item = h5o.open(group, key)
            is_second = (address := h5o.get_info(item).addr) in seen
            seen.add(address)
            if isinstance(item, h5g.GroupID):
                groups.append((f"{name}/", item))
                if is_second or name.count("/") >= DEEPEST:
                    return f"{name!r} is a group with a second name, or in more than {DEEPEST} others"
            if not is_second:
                words, n_bytes = _strange_in(item, name)
                room -= n_bytes
                if room < 0 and not words:
                    words = f"with what precedes it would be larger than the file, by {-room} bytes"
                if words:
                    return f"{name!r} {words}"
    return ""


def _strange_in(item: Any, name: str) -> tuple[str, int]:
    """What is strange in a group or dataset, in words, and the number of bytes that it asks for."""
    if (n := h5a.get_num_attrs(item)) > MOST_TEXTS:
        return f"has {n} attributes", 0
    keys: list[bytes] = []
    h5a.iterate(item, keys.append)
    attributes = [h5a.open(item, key) for key in keys]
    for key, one in zip(keys, attributes, strict=True):
        kind, named = one.get_type().get_class(), f"has the attribute {key.decode(errors='replace')!r}"
        if kind not in TEXTS and key != REFERENCE:
            return f"{named} that is neither numbers nor texts", 0
        if prod(one.shape) > MOST_TEXTS and kind == h5t.STRING:  # each of them could be as long as the file
            return f"{named} of {prod(one.shape)} texts", 0
    n_bytes = sum(prod(one.shape) * one.get_type().get_size() for one in attributes)
    if isinstance(item, h5g.GroupID):
        return "", n_bytes
    if not isinstance(item, h5d.DatasetID):
        return "is neither a group nor a dataset", 0
    made, holds = item.get_create_plist(), item.get_type()
    strange = {
        "whose numbers lie in other files": made.get_external_count() > 0,
        "that consists of parts of others": made.get_layout() not in LAYOUTS,
        "whose numbers pass through filters": made.get_nfilters() > 0,
        "of other things than numbers": holds.get_class() not in (TEXTS if name in MAY_BE_TEXTS else NUMBERS),
    }
    for words, is_so in strange.items():
        if is_so:
            return f"is a dataset {words}", 0
    return "", n_bytes + prod(item.get_space().get_simple_extent_dims()) * holds.get_size()


@contextmanager
def damage_told(path: str | Path) -> Iterator[None]:
    """Turn any error in reading a file into an OSError with one sentence."""
    try:
        yield
    except MemoryError:
        raise
    except Exception as error:  # HDF5 and h5py raise almost anything for bytes they do not expect
        reason = printable(" ".join(str(error).split())) or type(error).__name__
        raise OSError(f"file {str(path)!r} is damaged: {reason}; copy it again, or run again") from error
