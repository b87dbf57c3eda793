"""Files of runs, ways to damage them, and what a command then makes of one."""

import contextlib
import io
import operator
import os
import re
import shutil
import signal
import struct
import traceback
import zlib
from functools import partial
from pathlib import Path

import h5py
import numpy as np
from references import melt_scene

from minimd.commands import main as cli
from minimd.core.files.claim import MAGIC

BATH = 'method = "langevin-baoab"\nrelaxation_time = 1.0\n'
SCENES = {
    "plain": melt_scene(2, 60, "seed = 3\n[output]\nevery = 5\n"),
    "rigid": melt_scene(2, 60, BATH + "seed = 3\n[constraints]\npairs = [[0, 1], [2, 3]]\n[output]\nevery = 5\n"),
    "forces": melt_scene(2, 60, "seed = 3\n[output]\nevery = 5\nforces = true\n"),
    "crash": melt_scene(2, 4000, "seed = 3\n").replace("timestep = 0.004", "timestep = 0.05"),
}
OPTIONS = {"plot": ["--out", "a.png"], "replay": ["--overwrite"]}
GROUPS = ("h5md", "particles", "observables", "connectivity", "minimd")
RESTARTS = ("minimd/restart", "minimd/earlier_restart")
CHANGES = ("pwrite", "fsync", "ftruncate", "replace", "link", "unlink", "open")  # of os, by which minimd changes files
KILLED = f"died with status {int(signal.SIGKILL)}"
SENTENCE, PASSED, FAILED, TRACEBACK, CRASH = "a sentence", "passed", "failed", "a traceback", "a crash"
SIGNS = b"OHDR TREE HEAP SNOD GCOL \x89HDF value restart \x01\x00\x0c\x00 \x08\x00\x18\x00 \x03\x00".split(b" ")


def make_file(folder, name):
    """A sound file of a scene; the run is made in two parts, so that it has two restarts."""
    ends, quiet = {"crash": 3}.get(name, 0), "--quiet"
    with contextlib.chdir(folder):
        text = SCENES[name].replace("cutoff = 2.5", 'cutoff = 1.6\ntruncation = "force-shifted"')
        Path(f"{name}.toml").write_text(text)
        assert cli.main(["run", f"{name}.toml", quiet, *([] if ends else ["--steps", "40"])]) == ends
        assert ends or cli.main(["resume", f"{name}.h5md", "--steps", "10", quiet]) == 0
    return folder / (f"{name}.crash.h5md" if ends else f"{name}.h5md")


def run_command(command, file):
    with contextlib.chdir(Path(file).parent):
        return cli.main([command, Path(file).name, *OPTIONS.get(command, [])])


def in_child(work):
    """What work returns or prints, in a process of its own, or its error, in words; a file may do anything to HDF5."""
    listening, telling = os.pipe()
    child = os.fork()
    if child == 0:
        with open(telling, "w") as told, contextlib.suppress(BaseException):
            with contextlib.redirect_stdout(io.StringIO()) as out, contextlib.redirect_stderr(out):
                try:
                    answer = work()
                except BaseException:
                    answer = out.getvalue()[-500:] + traceback.format_exc()[-1500:]
            told.write(answer if isinstance(answer, str) else f"{out.getvalue()}\n{answer}")
        os._exit(0)
    os.close(telling)
    with open(listening) as told:
        answer = told.read()
    status = os.waitpid(child, 0)[1]
    return answer if status == 0 else f"died with status {status}"


def killed_at(k, work):
    """Do work in a process that dies, as by kill -9, before its k-th change of a file: KILLED, or what work does.
    Its children, which only read, live on."""

    def dying():
        n_changes, process = [0], os.getpid()
        signal.alarm(300)  # it ends, too, where the tests were ended before it

        def counted(call):
            def changed(*arguments, **options):
                n_changes[0] += 1
                if n_changes[0] == k and os.getpid() == process:
                    os.kill(process, signal.SIGKILL)
                return call(*arguments, **options)

            return changed

        for name in CHANGES:
            setattr(os, name, counted(getattr(os, name)))
        return work()

    return in_child(dying)


def outcome(command, file):
    """What a command makes of a file, in a process of its own, and what it says."""
    words = in_child(lambda: run_command(command, file))
    if words.startswith("died with status"):
        return CRASH, words
    *told, code = filter(None, words.splitlines())
    known = {"0": PASSED, "1": FAILED, "2": SENTENCE}.get(code, TRACEBACK)
    is_sentence = told and told[-1].startswith("minimd: error: ")
    return (TRACEBACK if "Traceback" in words or (known == SENTENCE and not is_sentence) else known), words


def _keys(item):
    return [key for key in item.attrs if key != "particles_group"]


def numbers(file, leave_out=()):
    """Everything in a file: types, shapes, bytes, attributes, by name."""
    found = {}

    def look(name, group, key, depth=0):
        if name.startswith(leave_out) or depth > 6:
            return
        try:
            item = group[key]
        except (KeyError, RuntimeError):
            found[name] = {}
            return  # a link that leads nowhere, or to itself
        found[name] = {key: repr(np.asarray(item.attrs[key]).tolist()) for key in _keys(item)}
        if isinstance(item, h5py.Dataset):
            kept = repr(np.asarray(item[()]).tolist()) if item.dtype.kind == "O" else item[()].tobytes()
            found[name][""] = item.dtype.str, item.shape, kept
        elif isinstance(item, h5py.Group):
            for key in item:
                look(f"{name}/{key}", item, key, depth + 1)

    with h5py.File(file, "r") as h5:
        for group in GROUPS:
            look(group, h5, group)
    return found


def damaged(sound, target, seed):
    """A copy of a file, damaged in a way drawn by a seed; returns the name of the way."""
    rng, way = np.random.default_rng(seed), WAYS[seed % len(WAYS)]
    shutil.copy(sound, target)
    if way in IN_BYTES:
        target.write_bytes(IN_BYTES[way](bytearray(target.read_bytes()), rng))
    else:
        with h5py.File(target, "r+") as h5:
            IN_NUMBERS[way](h5, rng)
    return way


def _anywhere(content, rng, length=1):
    return int(rng.integers(len(content) - length))


def _length(rng):
    return int(2 ** rng.uniform(2, 12))


def _in_a_table(content, rng):
    """The place of a byte that is no number of a dataset, as far as one can see: beside a signature or a name."""
    places = [found.start() for sign in SIGNS for found in re.finditer(re.escape(sign), content)]
    return min(len(content) - 1, int(rng.choice(places)) + int(rng.integers(64)))


def _flip(place, content, rng):
    content[place(content, rng)] ^= 1 << int(rng.integers(8))
    return content


def _replace(place, times, choices, content, rng):
    for _ in range(times):
        content[place(content, rng)] = int(rng.choice(choices))
    return content


def _overwrite(make, content, rng):
    n = _length(rng)
    place = _anywhere(content, rng, n)
    content[place : place + n] = make(content, rng, n)
    return content


def interrupted_commit(content, rng):
    """A piece of the file is half replaced; the journal at its end has it."""
    n = _length(rng)
    place, before = _anywhere(content, rng, n), len(content)
    body = struct.pack("<qq", place, n) + content[place : place + n]
    end = struct.pack("<qqqI17s", before, before, len(body), 0, MAGIC)
    end = struct.pack("<qqqI17s", before, before, len(body), zlib.crc32(end, zlib.crc32(body)), MAGIC)
    content[place : place + n // 2] = rng.bytes(n // 2)
    return content + body + end


def _objects(h5):
    found = []
    h5.visit(found.append)
    return found


def _datasets(h5):
    items = {name: h5[name] for name in _objects(h5)}
    return [k for k, one in items.items() if isinstance(one, h5py.Dataset) and one.size and one.dtype.kind != "O"]


def _one_of(h5, rng, among=_datasets):
    return str(rng.choice(among(h5)))


def _attribute_of(h5, rng):
    """The attributes of an object, and the name of one of them."""
    item = h5[str(rng.choice([name for name in _objects(h5) if _keys(h5[name])]))]
    return item.attrs, str(rng.choice(_keys(item)))


def change_number(h5, rng):
    series = h5[_one_of(h5, rng)]
    values = np.array(series[()])
    k = int(rng.integers(values.size))
    old = values.flat[k]
    real = [np.nan, np.inf, -old, np.nextafter(old, np.inf), old * (1 + 1e-9), 0.0, 1e300]
    values.flat[k] = rng.choice(real if values.dtype.kind == "f" else [old + 1, old - 1, old + 1000])
    series[...] = values


def change_attribute(h5, rng):
    at, key = _attribute_of(h5, rng)
    value = np.array(at[key])
    if value.dtype.kind not in "fiub":
        at[key] = "LJ" if rng.random() < 0.5 else "other"
    elif value.size:
        k = int(rng.integers(value.size))
        old = value.flat[k]
        is_real = value.dtype.kind == "f"
        value.flat[k] = rng.choice([np.nan, 0.0, -1.0, np.nextafter(old, np.inf)] if is_real else [old ^ 1])
        at.modify(key, value)


def resize(h5, rng):
    names = [name for name in _datasets(h5) if h5[name].maxshape[:1] == (None,)]
    for name in names if rng.random() < 0.3 else [str(rng.choice(names))]:
        h5[name].resize(max(0, len(h5[name]) + int(rng.choice([-3, -1, 1, 100]))), axis=0)


def resize_all_with_their_checksums(h5, rng):
    blocks = h5["minimd/blocks"]
    for name in blocks.attrs["series"]:
        h5[name].resize(int(blocks[0, 0]), axis=0)
    blocks.resize(1, axis=0)


def damage_both_restarts(h5, rng):
    for name in filter(h5.__contains__, RESTARTS):
        positions = h5[f"{name}/{rng.choice(['positions', 'velocities'])}"]
        positions[3, 1] = rng.choice([np.nan, np.nextafter(positions[3, 1], 9.0)])


def damage_a_restart(h5, rng):
    at = h5[str(rng.choice([name for name in RESTARTS if name in h5]))].attrs
    key = str(rng.choice(["step", "time", "reservoir_energy", "clock_step", "digest"]))
    new = np.nan if rng.random() < 0.5 and key in ("time", "reservoir_energy") else at[key] + 1
    at.modify(key, np.asarray(new, dtype=at[key].dtype))


IN_BYTES = {
    "flip a bit": partial(_flip, _anywhere), "flip a bit in a table": partial(_flip, _in_a_table),
    "flip a bit at the start": partial(_flip, lambda content, rng: int(rng.integers(2048))),
    "replace a byte in a table": partial(_replace, _in_a_table, 1, range(256)),
    "replace bytes in tables": partial(_replace, _in_a_table, 8, [0, 1, 128, 255, 77]),
    "replace bytes": partial(_replace, _anywhere, 16, range(256)),
    "clear a block": partial(_overwrite, lambda content, rng, n: bytes(n)),
    "overwrite a block": partial(_overwrite, lambda content, rng, n: rng.bytes(n)),
    "copy a block": partial(_overwrite, lambda content, rng, n: content[: _anywhere(content, rng) + n][-n:]),
    "insert": partial(_overwrite, lambda content, rng, n: rng.bytes(2 * n)),
    "truncate": lambda content, rng: content[: _anywhere(content, rng)],
    "append": lambda content, rng: content + rng.bytes(_length(rng)), "an interrupted commit": interrupted_commit,
    "a strange journal": lambda content, rng: content + rng.bytes(44) + MAGIC,
}  # fmt: skip
IN_NUMBERS = {
    "change a number": change_number, "change an attribute": change_attribute,
    "remove": lambda h5, rng: h5.pop(_one_of(h5, rng, _objects)),
    "remove an attribute": lambda h5, rng: operator.delitem(*_attribute_of(h5, rng)),
    "rename": lambda h5, rng: h5.move(_one_of(h5, rng, _objects), "elsewhere"), "resize": resize,
    "resize all with their checksums": resize_all_with_their_checksums,
    "damage both restarts": damage_both_restarts, "damage a restart": damage_a_restart,
}  # fmt: skip
WAYS = [*IN_BYTES, *IN_NUMBERS, "flip a bit in a table", "replace a byte in a table", "change a number"]
