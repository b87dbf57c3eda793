"""How much room frames take on the disk."""

import numpy as np
from h5md_runs import simulation

from minimd.files.h5md_reader import read_file
from minimd.files.h5md_schema import chunk_rows


def test_a_file_of_few_frames_is_small_and_that_of_many_has_large_chunks(tmp_path):
    """A chunk takes its full size on the disk, whatever is in it. Chunks of a long run stay as large as they were."""
    made, file = simulation(), tmp_path / "short.h5md"
    made.run(1, every=1, trajectory=file)
    assert file.stat().st_size < 130_000
    number, numbers = np.zeros(()), np.zeros((27, 3))
    for many in ((10_000,), ()):
        assert [chunk_rows(entry, *many) for entry in (number, numbers)] == [512, 101]
    assert [chunk_rows(entry, 2) for entry in (number, numbers, np.zeros((10_000, 3)))] == [16, 16, 1]
    made.run(40, every=1, trajectory=file, append=True)
    assert read_file(file).n_frames == 42
