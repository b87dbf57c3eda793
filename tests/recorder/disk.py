"""States of a disk: what may be on it when a process is killed, or the power fails, at any of the recorded calls.

kill    the first k calls
torn    the same, and a half or some sectors of the next call
power   of each file, any sectors of what was written since its last fsync, and any of the lengths that it had

NAMES of files after a power failure: as on ext4, which keeps their order, and saves that of a file with its fsync; or
strictly what POSIX promises: a name is safe when its folder was synced.

T. S. Pillai et al., All File Systems Are Not Created Equal (OSDI 2014); https://www.sqlite.org/atomiccommit.html
"""

import os
import shutil
import struct
import subprocess
import sys
from functools import cache
from pathlib import Path
from typing import NamedTuple

import pytest

HEAD = struct.Struct("<iiiiqqqq")  # what, process, parent, descriptor, offset, value, bytes of the path, of the data
OPEN, WRITE, TRUNCATE, FSYNC, RENAME, LINK, UNLINK, MKDIR, CLOSE, DUP = range(1, 11)
NAMES = ("ext4", "strict")


class Change(NamedTuple):
    """what : write, size, sync, name, unname, sync folder.  file : its number.  name : of it.  old : what it loses."""

    what: str
    file: int = -1
    offset: int = 0
    data: bytes = b""
    name: str = ""
    old: str = ""


@cache
def recorder(folder):
    """The compiled recorder."""
    compiler = shutil.which("cc")
    if not sys.platform.startswith("linux") or compiler is None:
        pytest.skip("the recorder needs Linux and a C compiler")
    source, made = Path(__file__).with_name("recorder.c"), Path(folder) / "recorder.so"
    subprocess.run([compiler, "-O1", "-shared", "-fPIC", "-o", made, source, "-ldl"], check=True)
    return made


def recorded(script, root, work):
    """The disk with the changes that a Python script, given the folder root, makes below it.  work : a folder."""
    before, log = _files(root), work / "log"
    log.unlink(missing_ok=True)
    known = {"LD_PRELOAD": str(recorder(work)), "RECORDED": str(root), "RECORD": str(log), "OPENBLAS_NUM_THREADS": "1"}
    subprocess.run([sys.executable, str(script), str(root)], env=os.environ | known, check=True, cwd=root)
    start = [Change("sync folder", name=name) for name in {os.path.dirname(name) for name in before}]
    for n, name in enumerate(before):
        start[:0] = Change("name", n, name=name), Change("write", n, 0, before[name]), Change("sync", n)
    disk = Disk(start + _changes(log.read_bytes(), str(root), before), len(start))
    assert disk.killed(len(disk.changes)) == _files(root)
    return disk


def _files(root):
    return {str(path.relative_to(root)): path.read_bytes() for path in sorted(root.rglob("*")) if path.is_file()}


def _changes(log, root, before):
    names = {name: number for number, name in enumerate(before)}
    n_files, tables, changes, at = len(before), {}, [], 0
    while at < len(log):
        what, process, parent, fd, offset, value, n_path, n_data = HEAD.unpack_from(log, at)
        at += HEAD.size + n_path + n_data
        path, data = log[at - n_path - n_data : at - n_data], log[at - n_data : at]
        files = tables.setdefault(process, dict(tables.get(parent, {})))
        name = path.decode().removeprefix(root).removeprefix("/")
        if what == OPEN:
            if (Path(root) / name).is_dir() or value & os.O_DIRECTORY:
                files[fd] = name
                continue
            if name not in names:
                if offset:  # it existed, but is none of ours
                    continue
                names[name], n_files = n_files, n_files + 1
                changes.append(Change("name", names[name], name=name))
            files[fd] = names[name]
            if value & os.O_TRUNC and offset:
                changes.append(Change("size", files[fd], 0))
        elif what in (RENAME, LINK):
            other = data.decode().removeprefix(root).removeprefix("/")
            names[other] = names.pop(name) if what == RENAME else names[name]
            changes.append(Change("name", names[other], name=other, old=name if what == RENAME else ""))
        elif what == UNLINK and name in names:
            changes.append(Change("unname", names.pop(name), name=name))
        elif what == CLOSE:
            files.pop(fd, None)
        elif what == DUP:
            files[value] = files[fd]
        elif what == FSYNC and isinstance(files.get(fd), str):
            changes.append(Change("sync folder", name=files[fd]))
        elif what in (WRITE, TRUNCATE, FSYNC) and not isinstance(files.get(fd), str):
            kind = {WRITE: "write", TRUNCATE: "size", FSYNC: "sync"}[what]
            changes.append(Change(kind, files[fd], offset, data))
    return changes


def _sectors(change, size):
    """A write in pieces, none of which goes beyond the end of a sector."""
    first = change.offset
    while first < change.offset + len(change.data):
        last = min(first - first % size + size, change.offset + len(change.data))
        yield change._replace(offset=first, data=change.data[first - change.offset : last - change.offset])
        first = last


def _change(content, change):
    if change.what == "size":
        del content[change.offset :]
        content.extend(bytes(change.offset - len(content)))
    else:
        content.extend(bytes(max(0, change.offset - len(content))))
        content[change.offset : change.offset + len(change.data)] = change.data


class Disk:
    """A disk and the changes that a process makes on it.  start : number of changes before the process begins."""

    def __init__(self, changes, start):
        self.changes, self.start = changes, start

    def part(self, folder):
        """The disk of a folder alone."""
        mine = {one.file for one in self.changes if one.what == "name" and os.path.dirname(one.name) == folder}
        kept, n_start = [], 0
        for at, one in enumerate(self.changes):
            if one.file in mine or (one.what == "sync folder" and one.name == folder):
                name = os.path.basename(one.name) if one.file >= 0 else ""
                kept.append(one._replace(name=name, old=os.path.basename(one.old)))
                n_start += at < self.start
        return Disk(kept, n_start)

    def killed(self, k):
        """The files after k changes: contents by name."""
        return self._after(self.changes[:k])

    def torn(self, k, draw):
        """The same, and a part of the next change."""
        change, parts = self.changes[k], []
        if change.what == "write":
            pieces = list(_sectors(change, draw.choice([512, 4096])))
            parts = [change._replace(data=change.data[: len(change.data) // 2])]
            if draw.random() < 0.7 and len(pieces) > 1:
                parts = [piece for piece in pieces if draw.random() < 0.5]
        return self._after([*self.changes[:k], *parts])

    def without_power(self, k, draw, names):
        """The files after a power failure after k changes.  names : the model, see NAMES."""
        changes, size, share = self.changes[:k], draw.choice([512, 4096]), draw.choice([0.0, 0.2, 0.5, 0.8, 1.0])
        synced = {change.file: at for at, change in enumerate(changes) if change.what == "sync"}
        contents, lengths = {}, {}
        for at, change in enumerate(changes):
            if change.what not in ("write", "size"):
                continue
            content = contents.setdefault(change.file, bytearray())
            if at < synced.get(change.file, -1):
                _change(content, change)
                continue
            now = lengths.setdefault(change.file, [len(content)])
            now.append(change.offset if change.what == "size" else max(now[-1], change.offset + len(change.data)))
            for piece in _sectors(change, size) if change.what == "write" else [change]:
                if draw.random() < share:
                    _change(content, piece)
        for file, several in lengths.items():
            _change(contents[file], Change("size", file, draw.choice([len(contents[file]), *several])))
        kept = _kept_names(changes, synced, draw, names)
        return {name: bytes(contents.get(file, b"")) for name, file in kept.items()}

    @staticmethod
    def _after(changes):
        names, contents = {}, {}
        for change in changes:
            if change.what in ("name", "unname"):
                _name(names, change)
            elif change.what in ("write", "size"):
                _change(contents.setdefault(change.file, bytearray()), change)
        return {name: bytes(contents.get(file, b"")) for name, file in names.items()}


def _kept_names(changes, synced, draw, model):
    """The names that are on the disk after a power failure, and the numbers of their files."""
    operations = [(at, change) for at, change in enumerate(changes) if change.what in ("name", "unname")]
    last = {change.name: at for at, change in enumerate(changes) if change.what == "sync folder"}
    safe = [at < last.get(os.path.dirname(change.name), -1) for at, change in operations]
    if model == "ext4":
        saved = [n + 1 for n, (at, change) in enumerate(operations) if safe[n] or at < synced.get(change.file, -1)]
        operations = operations[: draw.randint(max(saved, default=0), len(operations))]
    else:
        operations = [one for one, is_safe in zip(operations, safe, strict=True) if is_safe or draw.random() < 0.5]
    names = {}
    for _, change in operations:
        _name(names, change)
    return names


def _name(names, change):
    names.pop(change.old or change.name, None)
    if change.what == "name":
        names[change.name] = change.file
