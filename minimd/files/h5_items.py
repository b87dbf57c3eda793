"""Groups, datasets and attributes of an HDF5 file as plain data, and how they are written.

They are written by the calls of HDF5 itself, because those of h5py above them take most of the time of a short run.
"""

from collections.abc import Mapping
from types import MappingProxyType
from typing import Any, NamedTuple

import h5py
import numpy as np
from h5py import h5a, h5d, h5g, h5o, h5p, h5r, h5s, h5t

NOTHING: Mapping[str, Any] = MappingProxyType({})
TEXT = h5py.string_dtype()
REFERENCE = "particles_group"  # the attribute that refers to a group; its value is the path of the group
IN_NEW_GROUPS = h5p.create(h5p.LINK_CREATE)
IN_NEW_GROUPS.set_create_intermediate_group(True)
IN_NEW_GROUPS.set_char_encoding(h5t.CSET_UTF8)


class Item(NamedTuple):
    """A group, a dataset, or a second name of one.

    attributes : numbers and texts.  data : of a dataset; texts are bytes in an array of TEXT.
    rows : in a chunk of a dataset that can grow, else 0.  other : path of the dataset of which this is a second name.
    """

    attributes: Mapping[str, Any] = NOTHING
    data: np.ndarray | None = None
    rows: int = 0
    other: str = ""


def put(group: h5py.Group, items: Mapping[str, Item]) -> None:
    """Write items, by their paths, in place of those that are there; a dataset keeps its shape, unless it can grow."""
    within = group.id
    for path, item in items.items():
        key = path.encode()
        if item.other:
            if not within.links.exists(key):
                within.links.create_hard(key, within, item.other.encode())
            continue
        try:
            there = h5o.open(within, key)
        except KeyError:
            there = _new(within, key, item)
        if item.data is not None:
            if item.rows:
                there.set_extent(item.data.shape)
            there.write(h5s.ALL, h5s.ALL, np.asarray(item.data, order="C"))
        for name, value in item.attributes.items():
            if name == REFERENCE:
                array = np.array(h5r.create(within, value.encode(), h5r.OBJECT), h5py.ref_dtype)
            else:
                array = np.asarray(value)
                array = array.astype(TEXT) if array.dtype.kind == "U" else array
            if h5a.exists(there, name.encode()):
                h5a.delete(there, name.encode())
            kind, space = h5t.py_create(array.dtype, logical=True), h5s.create_simple(array.shape)
            h5a.create(there, name.encode(), kind, space).write(array)


def _new(within: h5g.GroupID, key: bytes, item: Item) -> h5g.GroupID | h5d.DatasetID:
    """An empty group, or a dataset without its numbers, and the groups above it."""
    if item.data is None:
        return h5g.create(within, key, IN_NEW_GROUPS)
    made, shape = h5p.create(h5p.DATASET_CREATE), item.data.shape
    made.set_obj_track_times(False)
    if item.rows:
        made.set_chunk((item.rows, *shape[1:]))
    space = h5s.create_simple(shape, (h5s.UNLIMITED, *shape[1:]) if item.rows else shape)
    return h5d.create(within, key, h5t.py_create(item.data.dtype, logical=True), space, made, IN_NEW_GROUPS)
