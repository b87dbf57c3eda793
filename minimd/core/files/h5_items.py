"""Groups, datasets and attributes of an HDF5 file as plain data. They are written by the calls of HDF5 itself: those of
h5py above them would take most of the time of a short run."""

from collections.abc import Mapping
from types import MappingProxyType
from typing import Any, NamedTuple

import h5py
import numpy as np
from h5py import h5a, h5d, h5g, h5o, h5p, h5r, h5s, h5t

NOTHING: Mapping[str, Any] = MappingProxyType({})
TEXT = h5py.string_dtype()
# the attribute that refers to a group; its value is the path of the group
REFERENCE = "particles_group"
IN_NEW_GROUPS = h5p.create(h5p.LINK_CREATE)
IN_NEW_GROUPS.set_create_intermediate_group(True)
IN_NEW_GROUPS.set_char_encoding(h5t.CSET_UTF8)


class Item(NamedTuple):
    """A group, a dataset, or a second name of one.

    attributes : numbers and texts.
    data : of a dataset; texts are bytes in an array of TEXT.
    rows : in a chunk of a dataset that can grow, else 0; data is then its end, which begins at the index `first`.
    other : path of the dataset of which this is a second name.
    """

    attributes: Mapping[str, Any] = NOTHING
    data: np.ndarray | None = None
    rows: int = 0
    first: int = 0
    other: str = ""


def put(h5: h5py.File, items: Mapping[str, Item]) -> None:
    """Write items, by their paths, in place of what is there, which must be of the same kind and shape."""
    file = h5.id

    for path, item in items.items():
        try:
            stored = h5o.open(file, path.encode())
        except KeyError:
            stored = _created(file, path.encode(), item)

        if item.data is not None:
            data = np.asarray(item.data, order="C")
            place = h5s.ALL
            if item.rows:
                stored.set_extent((item.first + len(data), *data.shape[1:]))
                place = stored.get_space()
                place.select_hyperslab((item.first, *(0,) * (data.ndim - 1)), data.shape)

            stored.write(h5s.create_simple(data.shape), place, data)

        for name, value in item.attributes.items():
            key = name.encode()
            array = np.asarray(value)
            if name == REFERENCE:
                array = np.array(h5r.create(file, value.encode(), h5r.OBJECT), h5py.ref_dtype)
            elif array.dtype.kind == "U":
                array = array.astype(TEXT)

            if h5a.exists(stored, key):
                h5a.delete(stored, key)
            kind = h5t.py_create(array.dtype, logical=True)
            h5a.create(stored, key, kind, h5s.create_simple(array.shape)).write(array)


def _created(file: h5g.GroupID, key: bytes, item: Item) -> h5g.GroupID | h5d.DatasetID | None:
    """A new item without attributes and numbers, and the groups above it."""
    if item.other:
        return file.links.create_hard(key, file, item.other.encode())
    if item.data is None:
        return h5g.create(file, key, IN_NEW_GROUPS)
    shape = item.data.shape
    kind = h5t.py_create(item.data.dtype, logical=True)
    space = h5s.create_simple(shape)
    properties = h5p.create(h5p.DATASET_CREATE)
    properties.set_obj_track_times(False)
    if item.rows:
        space = h5s.create_simple(shape, (h5s.UNLIMITED, *shape[1:]))
        properties.set_chunk((item.rows, *shape[1:]))
    return h5d.create(file, key, kind, space, properties, IN_NEW_GROUPS)
