"""Runs that are recorded, and what a user makes of a disk that one has left: `minimd check`, `minimd resume`.

python tests/recorder/runs.py FOLDER    makes the runs in FOLDER, which has a folder with the scene of each, by its name
"""

import contextlib
import hashlib
import os
import random
import shutil
import sys
from collections import namedtuple
from pathlib import Path

import ase.io
import h5py
import numpy as np

sys.path.insert(0, str(Path(__file__).parents[1]))

from damages import in_child, numbers
from h5md_runs import opened
from recorder.disk import NAMES, recorded
from references import melt_scene

from minimd.commands import main as cli
from minimd.diagnosis.run_guard import RunGuard
from minimd.files import h5md_schema, h5md_writer, trajectory
from minimd.files.crash_file import read_crash_report
from minimd.files.h5md_reader import read_file
from minimd.files.journaled_file import repair
from minimd.simulation import simulation

STEPS = 13
FILE, SCENE, CRASH = "run.h5md", "run.toml", "run.crash.h5md"
RUN, RESUME = ["run", SCENE, "--quiet"], ["resume", FILE, "--quiet"]
SEEN = ("radial-distribution", "mean-square-displacement", "viscosity", "fluctuations")
OBSERVERS = "".join(f'[[observer]]\nkind = "{kind}"\nevery = 2\n' for kind in SEEN)
BATH, EVERY = 'method = "langevin-baoab"\nrelaxation_time = 1.0\n', "[output]\nevery = 3\n"
PRESSURE = """[barostat]
pressure = 1.0\ncompressibility = 0.1\nrelaxation_time = 0.1\nevery = 3\ncoupling = "triclinic"
"""
KINDS = {  # what is added to a melt of 108 atoms
    "nve": EVERY,
    "triclinic": BATH + PRESSURE + EVERY,
    "observers": OBSERVERS + EVERY,
    "rigid": "[constraints]\npairs = [[0, 1], [2, 3]]\n" + EVERY,
    "fixed-point": 'precision = "fixed-point"\n' + EVERY,
    "forces": BATH + EVERY + "forces = true\n",
    "formats": OBSERVERS + EVERY + 'trajectory = ["run.xtc", "run.h5md", "run.extxyz", "run.traj", "run.dcd"]\n',
    "appended": EVERY,
    "crash": EVERY,
}
RESUMES = ("resumed when killed", "resumed when finished")
COMMANDS = {"appended": [[*RUN, "--steps", "6"], RESUME], RESUMES[0]: [RESUME], RESUMES[1]: [[*RESUME, "--steps", "6"]]}
EARLIER = ("minimd/earlier_restart", "minimd/blocks")  # other in runs of other parts
MODELS = ("kill", "torn", *NAMES)


Reference = namedtuple("Reference", "folder steps numbers frames")  # what an uninterrupted run has left


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


def others_of(file):
    """Positions of each frame in a file that is not H5MD."""
    if file.suffix in (".traj", ".extxyz"):
        return np.array([atoms.positions for atoms in ase.io.read(file, ":")])
    with contextlib.closing(opened(file, 108).trajectory) as read:
        return np.array([ts.positions.copy() for ts in read])


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
    trajectory._has_inode = lambda descriptor, inode: True  # the files of a state have other inodes than the run's
    n_frames = None
    if Path(FILE).exists():
        assert cli.main(["check", FILE]) in (0, 1)
        n_frames = len(others_of(Path(FILE)))
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
        frames, whole = others_of(file), others_of(known.folder / file)
        n_expected = len(whole) if n_frames is None else n_frames
        assert len(frames) == n_expected, f"{file}: {len(frames)} frames, {n_expected} at the restart"
        np.testing.assert_array_equal(frames, whole[: len(frames)])
    return "identical"


class Survey:
    """States of the disk of a run, and what becomes of each; those that are the same when repaired are judged once.

    kind : of the run.  disk : its part of the disk.  made : the folder in which it was made.  scratch : folder.
    """

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
