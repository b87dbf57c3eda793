"""Checksums in a minimd file, which show whether its numbers are those that were written.

minimd/blocks             (B, 2) a row for each block of frames: the number of frames up to its end, and the CRC-32 of
                          the block; the attribute series names the datasets that grow with the frames
minimd/restart, ...       see h5md_restart
minimd, attribute digest  the CRC-32 of everything that does not change: names, types, attributes, and arrays
                          that do not grow

Types are part of every checksum: the same bytes in another order are other numbers.
"""

import zlib
from collections.abc import Iterator

import h5py
import numpy as np

from minimd.files.h5md_restart import DIGEST, EARLIER, RESTART, SPARE, digest_of_array

BLOCKS = "minimd/blocks"
FIXED = (
    "h5md",
    "particles",
    "observables",
    "connectivity",
    "minimd",
)  # groups that, apart from series and restarts, do not change


def add_block(h5: h5py.File, n_frames: int, entries: dict[str, np.ndarray]) -> None:
    """Append the row of a block: n_frames frames are now in the file; entries : of the frames of the block,
    by the paths of their series."""
    if BLOCKS not in h5:
        h5.create_dataset(BLOCKS, (0, 2), np.int64, maxshape=(None, 2), chunks=(64, 2)).attrs["series"] = sorted(
            entries
        )
    blocks = h5[BLOCKS]
    row = (
        int(np.searchsorted(blocks[:, 0], n_frames)) if len(blocks) else 0
    )  # a block that is written again replaces its row
    blocks.resize(row + 1, axis=0)
    blocks[row] = n_frames, digest_of_block(entries)


def digest_of_block(entries: dict[str, np.ndarray]) -> int:
    """CRC-32 of the entries of some frames, by the paths of their series."""
    digest = 0
    for path in sorted(entries):
        digest = digest_of_array(path, entries[path], digest)
    return digest


def damaged_frames(h5: h5py.File) -> str:
    """The frames that are not as they were written, in words; empty if there are none."""
    series, first = {one: h5[one] for one in h5[BLOCKS].attrs["series"]}, 0
    lengths = {len(one) for one in series.values()}
    for last, digest in h5[BLOCKS][:].tolist():
        if (
            not first < last <= min(lengths)
            or digest_of_block({path: one[first:last] for path, one in series.items()}) != digest
        ):
            return f"frames {first} to {last - 1}"
        first = last
    return "" if lengths == {first} else f"frames from {first} on"


def drop_frames(h5: h5py.File, n_frames: int) -> None:
    """Keep the first n_frames frames, and remove the others."""
    blocks = h5[BLOCKS]
    series = {one: h5[one] for one in blocks.attrs["series"]}
    for one in series.values():
        one.resize(n_frames, axis=0)
    blocks.resize(int(np.searchsorted(blocks[:, 0], n_frames, side="right")), axis=0)
    first = int(blocks[-1, 0]) if len(blocks) else 0
    if first < n_frames:
        add_block(h5, n_frames, {path: one[first:] for path, one in series.items()})


def n_whole_frames(h5: h5py.File) -> int:
    """The number of frames in the file that have a checksum."""
    return int(h5[BLOCKS][-1, 0]) if BLOCKS in h5 and len(h5[BLOCKS]) else 0


def sign(h5: h5py.File) -> None:
    """Store the digest of everything that does not change."""
    h5["minimd"].attrs[DIGEST] = np.uint32(_digest_of_description(h5))


def is_signed(h5: h5py.File) -> bool:
    """Whether the description is the one that was signed."""
    return h5["minimd"].attrs.get(DIGEST) == _digest_of_description(h5)


def _digest_of_description(h5: h5py.File) -> int:
    digest = 0
    for words in _description(h5):
        digest = zlib.crc32(words, digest)
    return digest


def _description(h5: h5py.File) -> Iterator[bytes]:
    """Names, attributes and contents of everything that does not change, in order."""
    items: dict[str, h5py.HLObject | None] = {}  # None for a second name of an item that is visited under another
    for group in FIXED:
        items[group] = h5[group]
        h5[group].visit_links(lambda name, group=group: items.update({f"{group}/{name}": None}))
        h5[group].visititems(
            lambda name, item, group=group: items.update({f"{group}/{name}": item})
        )  # visititems stops if the function returns anything but None
    for name, item in sorted(items.items()):
        if name == BLOCKS or name.startswith((RESTART, EARLIER, SPARE)):
            continue
        yield name.encode()
        if item is None:
            continue
        for key in sorted(item.attrs):
            if key not in (DIGEST, "particles_group"):
                yield repr((key, np.asarray(item.attrs[key]).tolist())).encode()
        if isinstance(item, h5py.Dataset):
            grows = item.maxshape[:1] == (None,)
            yield repr((item.shape[grows:], item.dtype.str)).encode()
            if not grows:
                content = np.asarray(item[()])
                yield repr(content.tolist()).encode() if item.dtype.kind == "O" else content.tobytes()
