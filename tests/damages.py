"""Files of runs, damaged copies of them, and what a command then makes of one."""

import contextlib
import os
import shutil
from pathlib import Path

import h5py
import numpy as np
from references import melt_scene
from ways_of_damage import IN_BYTES, WAYS

from minimd.commands import main as cli

RIGID = 'method = "langevin-baoab"\nrelaxation_time = 1.0\nseed = 3\n[constraints]\npairs = [[0, 1], [2, 3]]\n'
SCENES = {
    "plain": melt_scene(2, 60, "seed = 3\n[output]\nevery = 5\n").replace("cutoff = 2.5", "cutoff = 1.6"),
    "rigid": melt_scene(2, 60, RIGID + "[output]\nevery = 5\n").replace("cutoff = 2.5", "cutoff = 1.6"),
    "forces": melt_scene(2, 60, "seed = 3\n[output]\nevery = 5\nforces = true\n").replace(
        "cutoff = 2.5", "cutoff = 1.6"
    ),
    "crash": melt_scene(2, 4000, "seed = 3\n")
    .replace("timestep = 0.004", "timestep = 0.05")
    .replace("cutoff = 2.5", "cutoff = 1.6"),
}
COMMANDS = {
    "check": ["check"],
    "plot": ["plot", "--out", "a.png"],
    "resume": ["resume"],
    "replay": ["replay", "--overwrite"],
}
GROUPS = ("h5md", "particles", "observables", "connectivity", "minimd")
SENTENCE, PASSED, FAILED, TRACEBACK, CRASH = "a sentence", "passed", "failed", "a traceback", "a crash"


def make_files(folder):
    """A sound file of each scene; runs are made in two parts, so that they have two restarts. Every command is loaded then."""
    files = {}
    with contextlib.chdir(folder):
        for name, scene in SCENES.items():
            Path(f"{name}.toml").write_text(scene)
            code = cli.main(["run", f"{name}.toml", "--quiet", *([] if name == "crash" else ["--steps", "40"])])
            assert code == (3 if name == "crash" else 0)
            files[name] = folder / (f"{name}.crash.h5md" if name == "crash" else f"{name}.h5md")
            if name != "crash":
                assert cli.main(["resume", f"{name}.h5md", "--steps", "10", "--quiet"]) == 0
        for command, file in (("check", "plain.h5md"), ("plot", "plain.h5md"), ("replay", "crash.crash.h5md")):
            name, *options = COMMANDS[command]
            assert cli.main([name, file, *options]) == 0
    return files


def outcome(command, file):
    """What a command makes of a file, in a process of its own, and what it says."""
    told = Path(f"{file}.told")
    child = os.fork()
    if child == 0:
        _run_and_end(command, file, told)
    _, status = os.waitpid(child, 0)
    words = told.read_text(errors="replace")
    if os.WIFSIGNALED(status):
        return CRASH, words
    known = {0: PASSED, 1: FAILED, 2: SENTENCE}
    is_sentence = words.rstrip().splitlines()[-1:] and words.rstrip().splitlines()[-1].startswith("minimd: error: ")
    code = known.get(os.WEXITSTATUS(status), TRACEBACK)
    return (TRACEBACK if "Traceback" in words or (code == SENTENCE and not is_sentence) else code), words


def _run_and_end(command, file, told):
    status = 99
    try:
        os.chdir(Path(file).parent)
        descriptor = os.open(told, os.O_WRONLY | os.O_CREAT | os.O_TRUNC)
        with open(descriptor, "w") as stream, contextlib.redirect_stdout(stream), contextlib.redirect_stderr(stream):
            try:
                name, *options = COMMANDS[command]
                status = cli.main([name, Path(file).name, *options])
            except BaseException:
                import traceback

                traceback.print_exc()
    finally:
        os._exit(status)


def numbers(file, leave_out=()):
    """Everything in a file: types, shapes, bytes, attributes, by name."""
    found = {}

    def opened(group, key):
        with contextlib.suppress(KeyError, RuntimeError):
            return group[key]
        return None  # a link that leads nowhere, or to itself

    def look(name, item, depth=0):
        if name.startswith(leave_out) or depth > 6:
            return
        if item is None:
            found[name] = {}
            return
        found[name] = {
            key: repr(np.asarray(item.attrs[key]).tolist()) for key in item.attrs if key != "particles_group"
        }
        if isinstance(item, h5py.Dataset):
            content = item[()]
            found[name][""] = (
                item.dtype.str,
                item.shape,
                repr(np.asarray(content).tolist()) if item.dtype.kind == "O" else content.tobytes(),
            )
        elif isinstance(item, h5py.Group):
            for key in item:
                look(f"{name}/{key}", opened(item, key), depth + 1)

    with h5py.File(file, "r") as h5:
        for group in GROUPS:
            look(group, h5[group])
    return found


def damaged(sound, target, seed):
    """A copy of a file, damaged in a way drawn by a seed; returns the name of the way."""
    rng = np.random.default_rng(seed)
    way = WAYS[seed % len(WAYS)]
    shutil.copy(sound, target)
    if way in IN_BYTES:
        target.write_bytes(way(bytearray(target.read_bytes()), rng))
    else:
        with h5py.File(target, "r+") as h5:
            way(h5, rng)
    return way.__name__
