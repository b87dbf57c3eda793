"""Files of runs in which one thing is not what minimd writes, with right checksums, and what doors make of them.

A forged value that a run could have had is another state, and no fault: what must be right is what follows from it.
"""

import contextlib
import json
import os
import resource
import shutil
import signal
from pathlib import Path

import h5py
import numpy as np
from damages import BATH, in_child
from references import melt_scene

import minimd as md
from minimd.ase.h5md_format import read_minimd_h5md
from minimd.commands import main as cli
from minimd.core.files import h5md_digest as digest
from minimd.core.files.h5_items import put
from minimd.core.files.h5md_reader import damage, frames_of, read_file
from minimd.core.files.trajectory import MARK
from minimd.core.simulation.resuming import stored_potentials
from minimd.ensemble.member import Member, Plan, work
from minimd.mdanalysis import universe
from minimd.scene import load_scene

BYSTANDER, PRECIOUS = "bystander.xyz", b"precious" * 1000
SECONDS = 10  # of processor time, in which every door must have answered
OUTPUT = "seed = 3\n[output]\nevery = 5\n"
LOOKING = "".join(
    f'[[observer]]\nkind = "{kind}"\nevery = 5\n'
    for kind in ("radial-distribution", "mean-square-displacement", "self-scattering", "viscosity", "fluctuations")
)
PRESSED = "[barostat]\npressure = 1.0\ncompressibility = 0.05\nrelaxation_time = 2.0\n"
SCENES = {
    "plain": OUTPUT,
    "rigid": BATH + "seed = 3\n[constraints]\npairs = [[0, 1], [2, 3]]\n[output]\nevery = 5\n",
    "observed": OUTPUT + LOOKING,
    "pressed": BATH + OUTPUT + PRESSED + LOOKING,
    "fixed-point": 'precision = "fixed-point"\n' + OUTPUT,
}
RESTARTS = ("minimd/restart", "minimd/earlier_restart")
RIGHT, REFUSED = "right", "refused"
REFUSALS = (OSError, ValueError, TypeError, md.NonFiniteError, md.ConstraintError, md.RangeError)


def make_file(folder, name):
    """A sound file of a scene, with two restarts."""
    with contextlib.chdir(folder):
        text = melt_scene(2, 60, SCENES[name]).replace("cutoff = 2.5", 'cutoff = 1.6\ntruncation = "force-shifted"')
        Path(f"{name}.toml").write_text(text)
        assert cli.main(["run", f"{name}.toml", "--quiet", "--steps", "60"]) == 0
        assert cli.main(["resume", f"{name}.h5md", "--quiet", "--steps", "10"]) == 0
    return folder / f"{name}.h5md"


def other_kind(array, rng):
    kinds = ["f4", "f8", "i8", "i4", "u1", ">f8", "?", "f2", "u8"]
    with np.errstate(all="ignore"):
        return array.astype(str(rng.choice([kind for kind in kinds if np.dtype(kind) != array.dtype])))


def other_shape(array, rng):
    flat = array.ravel()
    shapes = [flat, array[None], array[..., None], array.T, flat[:1], flat[:0], np.array(flat[0] if flat.size else 0)]
    if array.ndim:
        shapes += [array[:-1], array[:1], array[:0], array[::2], np.concatenate([array, array]), array[..., :1]]
    if array.ndim and array.size < 10_000:
        shapes.append(np.tile(array, (1000,) + (1,) * (array.ndim - 1)))
    return np.ascontiguousarray(shapes[rng.integers(len(shapes))])


def other_value(array, rng):
    array = array.copy()
    if not array.size:
        return array
    real = [np.nan, np.inf, -1.0, 0.0, 1e300, 1e9, -1e9, 1e-300, 0.37, 100.0]
    values = real if array.dtype.kind == "f" else [-1, 0, 1, 7, 2**31, 2**62, -(2**63), 2**63 - 1]
    value = values[rng.integers(len(values))]
    with np.errstate(all="ignore"), contextlib.suppress(OverflowError):
        if rng.random() < 0.5:
            array[...] = value
        else:
            array.flat[rng.integers(array.size)] = value
    return array


def other_order(array, rng):
    return array[::-1].copy() if array.ndim else array


def other_scale(array, rng):
    with np.errstate(all="ignore"):
        return (array * np.float64(rng.choice([-1.0, 2.0, 1e3, 1e-3]))).astype(array.dtype)


def other_text(text, rng):
    """A text of JSON with one value changed."""
    content = json.loads(text)
    owner = content
    while True:
        key = list(owner)[rng.integers(len(owner))] if isinstance(owner, dict) else int(rng.integers(len(owner)))
        if not (isinstance(owner[key], dict | list) and owner[key]) or rng.random() < 0.2:
            break
        owner = owner[key]
    values = [None, -1, 0, 2**62, 1e300, "x", [], {}, [1, [2]], True, [-1, 5], 10**9, 0.5]
    owner[key] = values[rng.integers(len(values))]
    return json.dumps(content)


CHANGES = (other_kind, other_shape, other_value, other_order, other_scale)


def forged_mark(h5md, rng):
    """The mark of another file, that of the bystander, with all that a stranger can know of it."""
    victim = h5md.with_name(BYSTANDER)
    size = int(rng.integers(len(PRECIOUS)))
    content = [PRECIOUS[:128], PRECIOUS[:size][-256:]] if rng.random() < 0.3 else [bytes(128), bytes(256)]
    inodes = [one.stat().st_ino if rng.random() < 0.8 else 7 for one in (h5md, victim)]
    content[rng.integers(2)] = rng.bytes(64)
    return np.frombuffer(MARK.pack(*inodes, size, *content) + BYSTANDER.encode(), np.uint8)


def forge_restart(h5, rng):
    """A field of the restarts, or of one of them."""
    name = None
    for path in RESTARTS if rng.random() < 0.8 else RESTARTS[:1]:
        arrays, numbers = digest.read_group(h5[path])
        fields = sorted([*arrays, *numbers])
        name = name or str(rng.choice(fields))
        owner = arrays if name in arrays else numbers
        way = rng.random()
        if name not in owner:
            continue
        if way < 0.05:
            del owner[name]
        elif way < 0.1:
            owner[f"{name}_0"] = owner.pop(name)
        elif way < 0.15:
            arrays[str(rng.choice(["list_1", "list_7", "images", "cell", "region_of_list_3"]))] = np.zeros((4, 3))
        elif way < 0.2:
            name, arrays["beside.0"] = "beside.0", forged_mark(Path(h5.filename), rng)
        elif name.endswith(".words"):
            owner[name] = np.frombuffer(other_text(bytes(owner[name]), rng).encode(), np.uint8)
        else:
            owner[name] = CHANGES[rng.integers(len(CHANGES))](np.asarray(owner[name]), rng)
        del h5[path]
        with np.errstate(all="ignore"):
            put(h5, {path: digest.Item({**numbers, "digest": np.uint32(digest.digest_of(arrays, numbers))})})
        put(h5, {f"{path}/{key}": digest.Item(data=array) for key, array in arrays.items()})
    return name


def forge_frames(h5, rng):
    """A series of the frames; the row of their only block is made again."""
    series = list(h5[digest.BLOCKS].attrs["series"])
    name = str(rng.choice(series))
    values = CHANGES[rng.integers(len(CHANGES))](h5[name][()], rng)
    if not values.ndim:
        values = values[None]
    attributes = dict(h5[name].attrs)
    others = [path for path in ("position/step", "position/time") if name.endswith(path)]
    if others or values.shape != h5[name].shape or values.dtype != h5[name].dtype:
        del h5[name]
        h5.create_dataset(name, data=values, maxshape=(None, *values.shape[1:]), chunks=True)
        h5[name].attrs.update(attributes)
    else:
        h5[name][...] = values
    rows, first = [], 0
    for last, _ in h5[digest.BLOCKS][:].tolist():
        rows.append((last, digest.digest_of({path: h5[path][first:last] for path in series})))
        first = last
    h5[digest.BLOCKS][...] = np.array(rows)
    return name


def forge_description(h5, rng):
    """A dataset or an attribute of what does not change."""
    found = []
    h5.visit(found.append)
    own = [name for name in found if name.startswith("minimd") and not name.startswith((*RESTARTS, digest.BLOCKS))]
    name = str(rng.choice([one for one in own if one != "minimd/time"]))
    item = h5[name]
    if isinstance(item, h5py.Dataset) and item.dtype.kind in "if" and rng.random() < 0.7:
        values = CHANGES[rng.integers(len(CHANGES))](item[()], rng)
        del h5[name]
        h5[name] = values
        return name
    keys = [key for key in item.attrs if key not in ("digest", "particles_group")]
    if not keys:
        return name
    key = str(rng.choice(keys))
    value = item.attrs[key]
    if isinstance(value, str):
        item.attrs[key] = (
            other_text(value, rng) if value[:1] in "{[" and value else str(rng.choice(["", "x", "\x1b[2J"]))
        )
    elif np.asarray(value).dtype.kind in "ifb":
        item.attrs[key] = CHANGES[rng.integers(len(CHANGES))](np.asarray(value), rng)
    else:
        del item.attrs[key]
    return f"{name}, {key}"


FORGERS = (forge_restart, forge_restart, forge_frames, forge_description)


def forged(sound, target, seed):
    """A copy of a file with one thing forged; returns its name."""
    rng = np.random.default_rng(seed)
    shutil.copy(sound, target)
    with h5py.File(target, "r+") as h5:
        name = FORGERS[seed % len(FORGERS)](h5, rng)
        with contextlib.suppress(Exception):  # what cannot be signed is refused
            digest.sign(h5)
    return name


def forces_again(simulation, potentials):
    """Potential energy and forces of the present state, of a simulation that is made anew."""
    again = md.Simulation(simulation.system.copy(), potentials, md.VelocityVerlet(0.004), threads=1, constraints=[])
    return again.potential_energy, again.forces


def resumed(file):
    """Resume by the interface of Python: energies and forces, now and after some steps, are those of a new
    simulation."""
    contents = read_file(file)
    potentials = stored_potentials(contents, file)
    simulation = md.Simulation.resume(file, threads=1)
    for _ in range(2):
        energy, forces = forces_again(simulation, potentials)
        if abs(energy) < 1e12:
            np.testing.assert_allclose(simulation.potential_energy, energy, rtol=1e-6, atol=1e-6)
            np.testing.assert_allclose(simulation.forces, forces, rtol=1e-6, atol=1e-6 * np.abs(forces).max())
        for bonds in filter(None, [simulation.engine.constraint_set.bonds]):
            assert simulation.step == contents.step or bonds.violation(simulation.positions).max() < 1e-5
        simulation.run(3, progress=False)
    return RIGHT


def continued(file):
    """All that was observed goes on; the file is whole afterwards."""
    simulation = md.Simulation.resume(file, threads=1)
    observers = list(read_file(file).observers.values())
    simulation.run(10, every=5, trajectory=file, append=True, observers=observers, progress=False)
    read_file(file)
    return RIGHT


def looked_through(file):
    contents = read_file(file)
    for at in frames_of(file, range(contents.n_frames), contents.system.units):
        assert at.positions.shape == at.velocities.shape == (len(contents.system), 3)
    for one in contents.observers.values():
        if one.n_looks:
            str(one.result())
    return RIGHT


def steps_again(file):
    md.Past(file).at(7)
    return RIGHT


def by_command(*words):
    def door(file):
        with contextlib.chdir(Path(file).parent):
            code = cli.main([words[0], Path(file).name, *words[1:]])
        return {0: RIGHT, 1: REFUSED, 2: REFUSED, 3: REFUSED}[code]

    return door


def as_member(file):
    """The file of a member of an ensemble, which goes on with it, or begins anew."""
    scene = load_scene(Path(file).parent.parent / "plain.toml")
    member = Member(0, {}, 7, 12, Path(file))
    row = work(Plan(lambda _: scene.simulation(), None, None, 5, "call"), member, False)
    assert row["status"] == "done", row
    return RIGHT


def digested(file):
    damage(file)
    return RIGHT


def read_by_ase(file):
    for atoms in read_minimd_h5md(file, slice(None)):
        assert atoms.positions.shape == (len(atoms), 3)
    return RIGHT


DOORS = {
    "resume in Python": resumed,
    "append": continued,
    "read": looked_through,
    "check": by_command("check"),
    "resume": by_command("resume", "--steps", "5", "--quiet"),
    "resume by another scene": by_command("resume", "--steps", "5", "--quiet", "--scene", "../plain.toml"),
    "past": steps_again,
    "view": by_command("view", "--out", "page.html"),
    "plot": by_command("plot", "--out", "a.png"),
    "frames": by_command("frames", "--at", "5", "--out", "frame.h5md"),
    "archive": by_command("archive", "--every", "10", "--out", "archive.h5md"),
    "universe": lambda file: [ts.positions.sum() for ts in universe(file).trajectory] and RIGHT,
    "member of an ensemble": as_member,
    "digest": digested,
    "ASE": read_by_ase,
}


def answer(door, file):
    """RIGHT, REFUSED, or what is wrong: the error from inside, or how the process of the door died."""

    def opened():
        resource.setrlimit(resource.RLIMIT_CPU, (SECONDS, SECONDS))
        signal.alarm(12 * SECONDS)  # it may also wait
        try:
            return DOORS[door](file)
        except REFUSALS:
            return REFUSED

    words = in_child(opened)
    last = words.strip().splitlines()[-1] if words.strip() else "nothing"
    return last if last in (RIGHT, REFUSED) and "Traceback" not in words else words


def judged(sound, folder, seed, doors):
    """What doors make of a forged copy of a sound file: those that are wrong, in words."""
    target, bystander = folder / "forged.h5md", folder / BYSTANDER
    bystander.write_bytes(PRECIOUS)
    before = {file: file.stat().st_mtime_ns for file in (bystander, *folder.parent.glob("*.*"))}
    for door in doors:
        name = forged(sound, target, seed)
        found = answer(door, target)
        if found not in (RIGHT, REFUSED):
            yield seed, sound.name, name, door, found
        after = {file: file.stat().st_mtime_ns for file in folder.parent.glob("*.*")}
        if not bystander.exists() or before != {bystander: bystander.stat().st_mtime_ns, **after}:
            yield seed, sound.name, name, door, "another file was changed"
        for left in set(os.listdir(folder)) - {BYSTANDER}:
            (folder / left).unlink()


def warm(sound, folder):
    """Open a sound file by all doors, in this process: children then find kernels loaded."""
    inside = folder / "warm"
    inside.mkdir()
    for name, door in DOORS.items():
        copy = inside / sound.name
        shutil.copy(sound, copy)
        with contextlib.suppress(*REFUSALS):
            assert door(copy) in (RIGHT, REFUSED), name
    shutil.rmtree(inside)
