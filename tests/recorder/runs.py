"""Runs that are recorded, what may be on the disk after kills and power failures, and what a user makes of it.

kill    the first k calls
torn    the same, and a half or some sectors of the next call
power   of each file, any sectors of what was written since its last fsync, and any of the lengths that it had

NAMES of files after a power failure: as on ext4, which keeps their order, and saves that of a file with its fsync; or
strictly what POSIX promises: a name is safe when its folder was synced.

T. S. Pillai et al., All File Systems Are Not Created Equal (OSDI 2014); https://www.sqlite.org/atomiccommit.html

python tests/recorder/runs.py FOLDER    makes the runs in FOLDER, which has a folder with the scene of each, by name"""

import contextlib
import hashlib
import os
import random
import shutil
import struct
import subprocess
import sys
from collections import namedtuple
from functools import cache
from pathlib import Path
from typing import NamedTuple
from unittest import mock

import h5py
import numpy as np
import pytest

sys.path.insert(0, str(Path(__file__).parents[1]))

from damages import in_child, numbers
from h5md_runs import frames_in
from references import melt_scene

from minimd.commands import main as cli
from minimd.core.diagnosis.run_guard import RunGuard
from minimd.core.files import h5md_schema, h5md_writer, trajectory
from minimd.core.files.claim import repair
from minimd.core.files.crash_file import read_crash_report
from minimd.core.files.h5md_reader import read_file
from minimd.core.simulation import simulation

HEAD = struct.Struct("<iiiiqqqq")  # what, process, parent, descriptor, offset, value, bytes of the path, of the data
OPEN, WRITE, TRUNCATE, FSYNC, RENAME, LINK, UNLINK, MKDIR, CLOSE, DUP = range(1, 11)
NAMES = ("ext4", "strict")
STEPS = 13
FILE, SCENE, CRASH = "run.h5md", "run.toml", "run.crash.h5md"
RUN, RESUME = ["run", SCENE, "--quiet"], ["resume", FILE, "--quiet"]
SEEN = ("radial-distribution", "mean-square-displacement", "viscosity", "fluctuations")
OBSERVERS = "".join(f'[[observer]]\nkind = "{kind}"\nevery = 2\n' for kind in SEEN)
BATH, EVERY = 'method = "langevin-baoab"\nrelaxation_time = 1.0\n', "[output]\nevery = 3\n"
PRESSURE = 'pressure = 1.0\ncompressibility = 0.1\nrelaxation_time = 0.1\nevery = 3\ncoupling = "triclinic"\n'
KINDS = {  # what is added to a melt of 108 atoms
    "nve": EVERY, "triclinic": f"{BATH}[barostat]\n{PRESSURE}{EVERY}", "observers": OBSERVERS + EVERY,
    "rigid": "[constraints]\npairs = [[0, 1], [2, 3]]\n" + EVERY,
    "fixed-point": 'precision = "fixed-point"\n' + EVERY, "forces": BATH + EVERY + "forces = true\n",
    "formats": OBSERVERS + EVERY + 'trajectory = ["run.xtc", "run.h5md", "run.extxyz", "run.traj", "run.dcd"]\n',
    "appended": EVERY, "crash": EVERY,
}  # fmt: skip
RESUMES = ("resumed when killed", "resumed when finished")
COMMANDS = {"appended": [[*RUN, "--steps", "6"], RESUME], RESUMES[0]: [RESUME], RESUMES[1]: [[*RESUME, "--steps", "6"]]}
EARLIER = ("minimd/earlier_restart", "minimd/blocks")  # other in runs of other parts
MODELS = ("kill", "torn", *NAMES)
Reference = namedtuple("Reference", "folder steps numbers frames")  # what an uninterrupted run has left


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
            changes.append(Change({WRITE: "write", TRUNCATE: "size", FSYNC: "sync"}[what], files[fd], offset, data))
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


def text_of(kind):
    if kind == "crash":
        return melt_scene(3, 400, "threads = 1\n[output]\nevery = 1\n").replace("timestep = 0.004", "timestep = 0.05")
    return melt_scene(3, STEPS, "threads = 1\n" + KINDS.get(kind, EVERY))


def make(kind, folder):
    """The work of a user in a folder, with a commit for each frame and between them; two frames fill a chunk."""
    h5md_writer.SECONDS_BETWEEN_FLUSHES = h5md_writer.MOST_OFTEN = simulation.SECONDS_BETWEEN_CHECKPOINTS = 0.0
    h5md_schema.CHUNK_BYTES, RunGuard.block = 6000, 2
    with contextlib.chdir(folder):
        assert {cli.main(one) for one in COMMANDS.get(kind, [RUN])} <= {3 if kind == "crash" else 0}


def survey(kinds, seeds, folder):
    """States of the disk of some runs, drawn by each model, that do not end as the uninterrupted run did."""
    root, resumes = folder / "root", sorted(set(kinds) & set(RESUMES))
    for kind in [kind for kind in kinds if kind not in RESUMES] + ["nve"][: len(resumes)]:
        _begin(root / kind, {SCENE: text_of(kind).encode()})
    disk = recorded(__file__, root, folder)
    if resumes:  # of a file that was killed in the middle of a commit, and of one that is finished
        root, plain = folder / "resumes", disk.part("nve")
        commit = [k for k, one in enumerate(plain.changes) if one.what == "sync"][8]
        for kind, k in zip(RESUMES, (commit + 3, len(plain.changes)), strict=True):
            _begin(root / kind, plain.killed(k))
        disk = recorded(__file__, root, folder)
    surveys = [Survey(kind, disk.part(kind), root / kind, folder / "state") for kind in kinds]
    found = [(one.kind, model, seed, *one.of(model, seed)) for one in surveys for model in MODELS for seed in seeds]
    print(f"{len(found)} states of {kinds}, {sum(len(one.seen) for one in surveys)} of them differ after their repair")
    return [one for one in found if one[-1] != "identical"]


def _begin(folder, files):
    folder.mkdir(parents=True)
    for name, content in files.items():
        (folder / name).write_bytes(content)


def frames_of(file):
    """The series of a file."""
    with h5py.File(file, "r") as h5:
        return {name: h5[name][:] for name in h5["minimd/blocks"].attrs["series"]}


def content_of(file):
    """All that is in a file, apart from what belongs to its parts and its inode."""
    found = numbers(file, (*EARLIER, "minimd/restart/beside"))
    del found["minimd/restart"]["digest"]
    return found


def put(files, folder):
    """Put a state of a disk into a folder, repaired; returns a name for what is there now."""
    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir()
    key = hashlib.sha256()
    for name, content in sorted(files.items()):
        (folder / name).write_bytes(content)
        if name in (FILE, CRASH):
            repair(folder / name)
        key.update(f"{name} {(folder / name).stat().st_size} ".encode() + (folder / name).read_bytes())
    return key.digest()


def verdict(kind, folder, known, n_least):
    """What becomes of a state of a disk: "identical", or an error.  n_least : number of frames that were committed."""
    os.chdir(folder)
    # the files of a state have other inodes than the run's
    mock.patch.object(trajectory, "_has_inode", return_value=True).start()
    n_frames = None
    if Path(FILE).exists():
        assert cli.main(["check", FILE]) in (0, 1)
        n_frames = len(frames_in(Path(FILE), 108))
        assert n_frames >= n_least, f"{n_frames} frames of {n_least}"
        for name, series in frames_of(FILE).items():
            np.testing.assert_array_equal(series, known.frames[name][: len(series)], strict=True)
        now, reported = read_file(FILE), Path(CRASH).exists()
        if now.step < known.steps or now.lacks_results or (kind == "crash" and not reported):
            more = ["--steps", str(known.steps - now.step)] if kind == RESUMES[1] else []
            assert cli.main([*RESUME, *more]) == 0 or kind == "crash"
    else:
        assert n_least == 0, f"no file, {n_least} frames were committed"
        assert cli.main([*RUN, "--overwrite"]) == (3 if kind == "crash" else 0)
    if kind == "crash":  # what comes after the last good state depends on lists that are lost with it
        for name, series in frames_of(FILE).items():
            np.testing.assert_array_equal(series[: len(known.frames[name])], known.frames[name], strict=True)
        if n_frames is None or now.step < known.steps or reported:
            assert read_crash_report(CRASH).findings.step == read_crash_report(known.folder / CRASH).findings.step
        return "identical"
    found = content_of(FILE)
    other = [name for name in {**found, **known.numbers} if found.get(name) != known.numbers.get(name)]
    assert not other, f"other numbers: {other}"
    others = [file for file in Path().glob("run.*") if file.suffix in (".xtc", ".extxyz", ".traj", ".dcd")]
    for file in others:  # up to the restart, or all of a run begun again
        frames, whole = (frames_in(one, 108) for one in (file, known.folder / file))
        n_expected = len(whole) if n_frames is None else n_frames
        assert len(frames) == n_expected, f"{file}: {len(frames)} frames, {n_expected} at the restart"
        np.testing.assert_array_equal(frames, whole[: len(frames)])
    return "identical"


class Survey:
    """States of the disk of a run, and what becomes of each; those that are the same when repaired are judged once.

    kind : of the run.  disk : its part of the disk.  made : the folder in which it was made.  scratch : folder."""

    def __init__(self, kind, disk, made, scratch):
        self.kind, self._disk, self._scratch, self.seen, self._frames = kind, disk, scratch, {}, {}
        file = made / FILE
        self._known = Reference(made, read_file(file).step, content_of(file), frames_of(file))
        scratch.mkdir(exist_ok=True)
        shutil.copy(file, scratch)  # children find loaded what they need
        assert cli.main(["check", str(scratch / FILE)]) in (0, 1)
        assert cli.main(["resume", str(scratch / FILE), "--quiet", "--steps", "2"]) == 0 or kind == "crash"
        names = [k for k, one in enumerate(disk.changes) if one.what == "name" and one.name == FILE]
        folders = [k for k, one in enumerate(disk.changes) if one.what == "sync folder" and k > names[0]]
        self._file, self._is_safe_from = disk.changes[names[0]].file, folders[0] + 1

    def of(self, model, seed):
        """A state that a model draws: its place among the changes, and what becomes of it."""
        draw, disk = random.Random(f"{self.kind} {model} {seed}"), self._disk
        if model == "torn":
            k = draw.choice([k for k in range(disk.start, len(disk.changes)) if disk.changes[k].what == "write"])
            files = disk.torn(k, draw)
        else:
            k = draw.randint(disk.start, len(disk.changes))
            files = disk.killed(k) if model == "kill" else disk.without_power(k, draw, model)
        n_least = self._n_committed(k) if model in ("kill", "torn") or k >= self._is_safe_from else 0
        if (key := put(files, self._scratch)) not in self.seen:
            self.seen[key] = in_child(lambda: verdict(self.kind, self._scratch, self._known, n_least))
        return k, self.seen[key]

    def _n_committed(self, k):
        """The number of frames that were safe after k changes: those after the last fsync of the file."""
        mine = [at + 1 for at, one in enumerate(self._disk.changes[:k]) if one[:2] == ("sync", self._file)]
        last = max(mine, default=0)
        if last not in self._frames:
            put(files := self._disk.killed(last), self._scratch)
            count = in_child(lambda: str(read_file(self._scratch / FILE).n_frames)) if FILE in files else 0
            self._frames[last] = int(count)
        return self._frames[last]


if __name__ == "__main__":
    for place in sorted(Path(sys.argv[1]).iterdir()):
        make(place.name, place)
