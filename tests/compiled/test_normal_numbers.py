"""The noise that kernels draw."""

import numpy as np

from minimd.compiled.normal_numbers import normal_numbers


def test_noise_has_the_bits_of_numpy():
    """Its rare branches too: numbers at the edges of layers and in the tail."""
    seed, step, contact, numbers = 2**100 + 12345678901234567, -3, 2, np.empty((5, 200_000))
    normal_numbers(np.array([seed % 2**64, seed >> 64], dtype=np.uint64), step, contact, numbers)
    for k, row in enumerate(numbers):
        counter = np.array([0, 0, contact, (step + k) % 2**64], dtype=np.uint64)
        expected = np.random.Generator(np.random.Philox(key=seed, counter=counter)).standard_normal(row.size)
        assert np.array_equal(row, expected)
    assert np.abs(numbers).max() > 3.66  # in the tail
