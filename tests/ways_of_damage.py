"""Ways to damage the file of a run."""

import contextlib
import struct
import zlib

import h5py
import numpy as np

from minimd.files.journaled_file import MAGIC

RESTARTS = ("minimd/restart", "minimd/earlier_restart")


def _place(content, rng, length=1):
    return int(rng.integers(len(content) - length))


def _table(content, rng):
    """A byte that is no number of a dataset, as far as one can see: it lies beside a signature or a name."""
    signs = [
        b"OHDR",
        b"TREE",
        b"HEAP",
        b"SNOD",
        b"GCOL",
        b"\x89HDF",
        b"value",
        b"restart",
        b"\x01\x00\x0c\x00",
        b"\x08\x00\x18\x00",
        b"\x03\x00",
    ]
    places = [k for sign in signs for k in _all(bytes(content), sign)]
    return min(len(content) - 1, int(rng.choice(places)) + int(rng.integers(64)))


def _all(content, sign):
    place = content.find(sign)
    while place >= 0:
        yield place
        place = content.find(sign, place + 1)


def flip_bit(content, rng):
    content[_place(content, rng)] ^= 1 << int(rng.integers(8))
    return content


def flip_bit_in_a_table(content, rng):
    content[_table(content, rng)] ^= 1 << int(rng.integers(8))
    return content


def replace_byte_in_a_table(content, rng):
    content[_table(content, rng)] = int(rng.integers(256))
    return content


def replace_bytes_in_tables(content, rng):
    for _ in range(8):
        content[_table(content, rng)] = int(rng.choice([0, 1, 255, 128, int(rng.integers(256))]))
    return content


def replace_bytes(content, rng):
    for _ in range(16):
        content[_place(content, rng)] = int(rng.integers(256))
    return content


def flip_bit_at_the_start(content, rng):
    content[int(rng.integers(2048))] ^= 1 << int(rng.integers(8))
    return content


def _length(rng):
    return int(2 ** rng.uniform(2, 12))


def clear_block(content, rng):
    n = _length(rng)
    place = _place(content, rng, n)
    content[place : place + n] = bytes(n)
    return content


def overwrite_block(content, rng):
    n = _length(rng)
    place = _place(content, rng, n)
    content[place : place + n] = rng.bytes(n)
    return content


def swap_blocks(content, rng):
    n = _length(rng)
    one, other = _place(content, rng, n), _place(content, rng, n)
    first, second = content[one : one + n], content[other : other + n]
    content[other : other + n] = first
    content[one : one + n] = second
    return content


def truncate(content, rng):
    return content[: _place(content, rng)]


def append(content, rng):
    return content + rng.bytes(_length(rng))


def insert(content, rng):
    place = _place(content, rng)
    return content[:place] + rng.bytes(_length(rng)) + content[place:]


def _datasets(h5):
    found = []
    h5.visititems(
        lambda name, item: (
            found.append(name) if isinstance(item, h5py.Dataset) and item.size and item.dtype.kind != "O" else None
        )
    )
    return found


def _objects(h5):
    found = []
    h5.visit(found.append)
    return found


def change_number(h5, rng):
    series = h5[str(rng.choice(_datasets(h5)))]
    values = series[()]
    flat = np.atleast_1d(values).reshape(-1)
    k = int(rng.integers(flat.size))
    if flat.dtype.kind == "f":
        flat[k] = rng.choice(
            [np.nan, np.inf, -flat[k], np.nextafter(flat[k], np.inf), flat[k] * (1 + 1e-9), 0.0, 1e300]
        )
    else:
        flat[k] += rng.choice([1, -1, 1000])
    series[...] = flat.reshape(values.shape)


def swap_numbers(h5, rng):
    series = h5[str(rng.choice(_datasets(h5)))]
    values = series[()]
    series[...] = values[::-1] if values.ndim else values + 1


def change_attribute(h5, rng):
    owners = [name for name in _objects(h5) if any(key != "particles_group" for key in h5[name].attrs)]
    at = h5[str(rng.choice(owners))].attrs
    key = str(rng.choice([key for key in at if key != "particles_group"]))
    value = np.asarray(at[key])
    if value.dtype.kind in "fiub":
        flat = np.atleast_1d(value).reshape(-1).copy()
        if flat.size:
            k = int(rng.integers(flat.size))
            flat[k] = (
                rng.choice([np.nan, 0.0, -1.0, np.nextafter(flat[k], np.inf)])
                if flat.dtype.kind == "f"
                else flat[k] ^ 1
            )
        at.modify(key, flat.reshape(value.shape))
    else:
        at[key] = "LJ" if rng.random() < 0.5 else "other"


def remove(h5, rng):
    del h5[str(rng.choice(_objects(h5)))]


def remove_attribute(h5, rng):
    owners = [name for name in _objects(h5) if len(h5[name].attrs)]
    at = h5[str(rng.choice(owners))].attrs
    del at[str(rng.choice(list(at)))]


def rename(h5, rng):
    name = str(rng.choice(_objects(h5)))
    h5.move(name, f"{name}_" if rng.random() < 0.5 else "elsewhere")


def retype(h5, rng):
    """The same bytes, or the same values, of another type or shape."""
    name = str(rng.choice(_datasets(h5)))
    values, at, grows = h5[name][()], dict(h5[name].attrs), h5[name].maxshape[:1] == (None,)
    values = np.asarray(values)
    bits = {"f": np.int64, "i": np.float64}.get(values.dtype.kind if values.itemsize == 8 else "", values.dtype)
    others = [
        values.view(values.dtype.newbyteorder(">")),
        values.view(bits),
        values.astype(np.float32),
        np.array("text", "S4"),
    ]
    others += [values.reshape(-1), values.T, values[:-1] if values.ndim else values + 1]
    other = others[int(rng.integers(len(others)))]
    del h5[name]
    h5.create_dataset(name, data=other, maxshape=(None, *other.shape[1:]) if grows and other.ndim else None)
    h5[name].attrs.update({key: value for key, value in at.items() if key != "particles_group"})


def resize(h5, rng):
    names = [name for name in _datasets(h5) if h5[name].maxshape[:1] == (None,)]
    chosen = names if rng.random() < 0.3 else [str(rng.choice(names))]
    for name in chosen:
        h5[name].resize(max(0, len(h5[name]) + int(rng.choice([-3, -1, 1, 100]))), axis=0)


def resize_all_with_their_checksums(h5, rng):
    blocks, n = h5["minimd/blocks"], int(h5["minimd/blocks"][0, 0])
    for name in blocks.attrs["series"]:
        h5[name].resize(n, axis=0)
    blocks.resize(1, axis=0)


def add_series(h5, rng):
    name = str(rng.choice(["conserved_energy", "constraint_violation", "shadow_energy", "stranger"]))
    if f"observables/{name}" in h5:
        del h5[f"observables/{name}"]
    h5[f"observables/{name}/value"] = np.zeros(len(h5["minimd/time"]))


def link_elsewhere(h5, rng):
    name = str(rng.choice(_objects(h5)))
    del h5[name]
    elsewhere = [
        h5py.SoftLink("/nowhere"),
        h5py.SoftLink("/minimd/time"),
        h5py.ExternalLink("b.h5", "/x"),
        h5py.SoftLink(f"/{name}"),
    ]
    h5[name] = elsewhere[int(rng.integers(4))]


def exchange(h5, rng):
    one, other = (str(name) for name in rng.choice(_datasets(h5), 2))
    with contextlib.suppress(ValueError, KeyError, RuntimeError):
        h5.move(one, "between")
        h5.move(other, one)
        h5.move("between", other)


def damage_both_restarts(h5, rng):
    for name in RESTARTS:
        if name in h5:
            positions = h5[f"{name}/{rng.choice(['positions', 'velocities'])}"]
            positions[3, 1] = rng.choice([np.nan, np.nextafter(positions[3, 1], 9.0)])


def damage_a_restart(h5, rng):
    group = h5[str(rng.choice([name for name in RESTARTS if name in h5]))]
    key = str(rng.choice(["step", "time", "reservoir_energy", "clock_step", "digest"]))
    value = group.attrs[key]
    group.attrs.modify(
        key,
        np.asarray(
            np.nan if rng.random() < 0.5 and key in ("time", "reservoir_energy") else value + 1, dtype=value.dtype
        ),
    )


def interrupted_commit(content, rng):
    """A piece of the file is half replaced; the journal at its end has it."""
    n = _length(rng)
    place, before = _place(content, rng, n), len(content)
    body = struct.pack("<qq", place, n) + content[place : place + n]
    end = struct.pack("<qqqI17s", before, before, len(body), 0, MAGIC)
    end = struct.pack("<qqqI17s", before, before, len(body), zlib.crc32(end, zlib.crc32(body)), MAGIC)
    content[place : place + n // 2] = rng.bytes(n // 2)
    return content + body + end


def interrupted_commit_with_a_damaged_journal(content, rng):
    before = len(content)
    content = interrupted_commit(content, rng)
    how = int(rng.integers(3))
    if how == 0:
        return content[: before + int(rng.integers(len(content) - before))]
    if how == 1:
        content[before + int(rng.integers(len(content) - before))] ^= 1 << int(rng.integers(8))
    else:
        content[before:] = rng.bytes(len(content) - before)
    return content


def strange_journal(content, rng):
    return content + rng.bytes(44) + MAGIC


def _made_anew(name, make):
    """A way that replaces a dataset by what make(h5, its values, folder) makes under its name; returns the name."""

    def way(h5, folder):
        values = h5[name][()]
        del h5[name]
        make(h5, values, folder)
        return name

    return way


def _external(name):
    return _made_anew(
        name,
        lambda h5, values, folder: h5.create_dataset(
            name, values.shape, values.dtype, external=[(str(folder / "precious"), 0, values.nbytes)]
        ),
    )


def _virtual(name):
    def make(h5, values, folder):
        layout = h5py.VirtualLayout(values.shape, values.dtype)
        layout[...] = h5py.VirtualSource(str(folder / "precious.h5"), "x", values.shape)
        h5.create_virtual_dataset(name, layout)

    return _made_anew(name, make)


def _typed(name, kind):
    return _made_anew(name, lambda h5, values, _: h5.create_dataset(name, values.shape, kind))


def _linked(name, link):
    return _made_anew(name, lambda h5, _values, folder: h5.__setitem__(name, link(folder)))


def _put(name, make):
    """A way that puts something into the file that was not there."""

    def way(h5, folder):
        make(h5)
        return name

    return way


def _attribute(h5, kind):
    h5["minimd"].attrs.create("extra", np.zeros((), kind), dtype=kind)


COMPOUND, NUMBERS_OF_ANY_LENGTH = np.dtype([("a", "f8"), ("b", "i8")]), h5py.vlen_dtype(np.float64)
HOSTILE = {  # ways in which a file leads elsewhere, or asks for what it does not hold; each returns the name of the culprit
    "an external restart": _external("minimd/restart/positions"),
    "external frames": _external("particles/trajectory/velocity/value"),
    "external species": _external("minimd/species_index"),
    "a virtual dataset": _virtual("minimd/restart/velocities"),
    "an external link": _linked("minimd/masses", lambda folder: h5py.ExternalLink(str(folder / "precious.h5"), "x")),
    "an external link as a group": _put(
        "observables",
        lambda h5: (h5.move("observables", "kept"), h5.__setitem__("observables", h5py.ExternalLink("a", "b"))),
    ),
    "a link to a link": _linked("minimd/cell", lambda _: h5py.SoftLink("/minimd/restart/../cell")),
    "a link to itself": _put("minimd/loop", lambda h5: h5.__setitem__("minimd/loop", h5py.SoftLink("/minimd/loop"))),
    "a group in itself": _put("minimd/again", lambda h5: h5.__setitem__("minimd/again", h5["/"])),
    "a deep group": _put("minimd/a/a/a/a/a/a/a/a", lambda h5: h5.create_group("minimd/" + "/".join("a" * 2000))),
    "a compound": _typed("minimd/restart/positions", COMPOUND),
    "references": _typed("minimd/masses", h5py.ref_dtype),
    "numbers of any length": _typed("minimd/cell", NUMBERS_OF_ANY_LENGTH),
    "texts": _typed("minimd/restart/positions", h5py.string_dtype()),
    "opaque bytes": _typed("minimd/masses", "V8"),
    "no numbers": _put("minimd/nothing", lambda h5: h5.create_dataset("minimd/nothing", data=h5py.Empty("V8"))),
    "a type": _put("minimd/kind", lambda h5: h5.__setitem__("minimd/kind", np.dtype("f8"))),
    "a filter": _put(
        "minimd/zipped",
        lambda h5: h5.create_dataset("minimd/zipped", data=np.zeros(10), chunks=(10,), compression="gzip"),
    ),
    "numbers that are not there": _put(
        "minimd/zeros", lambda h5: h5.create_dataset("minimd/zeros", (10**12,), "f8", chunks=(1,))
    ),
    "a size that overflows": _put(
        "minimd/zeros", lambda h5: h5.create_dataset("minimd/zeros", (2**40, 2**40), "f8", chunks=(1, 1))
    ),
    "many half as large": _put(
        "minimd/zeros",
        lambda h5: [h5.create_dataset(f"minimd/zeros{k}", (h5.id.get_filesize() // 16,), "f8") for k in range(3)],
    ),
    "an attribute of another kind": _put("minimd", lambda h5: _attribute(h5, COMPOUND)),
    "an attribute of many texts": _put(
        "minimd", lambda h5: h5["minimd"].attrs.create("more", ["a"] * 300, dtype=h5py.string_dtype())
    ),
    "many attributes": _put("minimd", lambda h5: [h5["minimd"].attrs.create(f"a{k}", k) for k in range(300)]),
}

IN_BYTES = (
    flip_bit,
    flip_bit_in_a_table,
    replace_byte_in_a_table,
    replace_bytes_in_tables,
    replace_bytes,
    flip_bit_at_the_start,
    clear_block,
    overwrite_block,
    swap_blocks,
    truncate,
    append,
    insert,
    interrupted_commit,
    interrupted_commit_with_a_damaged_journal,
    strange_journal,
)
IN_NUMBERS = (
    change_number,
    swap_numbers,
    change_attribute,
    remove,
    remove_attribute,
    rename,
    retype,
    resize,
    resize_all_with_their_checksums,
    add_series,
    link_elsewhere,
    exchange,
    damage_both_restarts,
    damage_a_restart,
)
WAYS = IN_BYTES + IN_NUMBERS + (flip_bit_in_a_table, replace_byte_in_a_table, change_number)
