"""A rehearsal before a file is continued: a child process, which may crash,
does in memory what the run will do with the file.

Damage that is not noticed in reading, such as a wrong count of links, can crash HDF5 when it writes.
"""

from functools import partial

import h5py

from minimd.files.claim import Claim
from minimd.files.first_look import looked_at
from minimd.files.h5md_digest import BLOCKS, add_block, drop_frames, sign
from minimd.files.h5md_opening import admitted, damage_told
from minimd.files.h5md_reader import contents_of
from minimd.files.h5md_restart import read_restart, set_aside_damaged, write_restart
from minimd.files.journaled_file import JournaledFile


def rehearse(claim: Claim) -> None:
    """Raise as read_file if the claimed minimd file cannot be continued. Nothing is written to the disk."""
    looked_at(claim.path, partial(_continue_in_memory, claim))


def _continue_in_memory(claim: Claim) -> None:
    """Add the last frame once more, and two restarts, in memory only: nothing is committed."""
    with admitted(h5py.File(JournaledFile(claim), "r+"), claim.name) as h5:
        contents_of(h5, claim.name)
    with damage_told(claim.name), h5py.File(JournaledFile(claim), "r+") as h5:
        set_aside_damaged(h5)
        restart, n_frames, _ = read_restart(h5)
        drop_frames(h5, n_frames)
        last = {name: h5[name][-1:] for name in h5[BLOCKS].attrs["series"]}
        for name, entry in last.items():
            h5[name].resize(n_frames + 1, axis=0)
            h5[name][n_frames:] = entry
        add_block(h5, n_frames + 1, last)
        for _ in range(2):
            write_restart(h5, restart, n_frames + 1)
            h5.flush()
        sign(h5)
