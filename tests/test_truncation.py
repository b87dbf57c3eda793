"""How laws end at their cutoff."""

import numpy as np
import pytest

import minimd as md
from minimd.potentials.truncation import SWITCHES


def slopes(potential, r, h=1e-4):
    """u, u′ and u″ just around r by one-sided points."""
    u = [float(potential.pair_energy(r + k * h)) for k in (-2, -1, 0, 1, 2)]
    return u[2], (u[3] - u[1]) / (2 * h), (u[3] - 2 * u[2] + u[1]) / h**2


@pytest.mark.parametrize(
    ("truncation", "smoothness"),
    [("truncated", 0), ("shifted", 1), ("force-shifted", 2), ("charmm", 2), ("switched", 3), ("smooth", 3)],
)
def test_truncation_is_as_smooth_as_it_promises_and_no_smoother(truncation, smoothness):
    """Continuous derivatives at the cutoff: none, u, u and u′, (u, u′ and u″) for smoothness 0 to 3; of smooth more, see test_smooth_cutoff."""
    potential = md.LennardJones(1.0, 1.0, 2.5, truncation)
    jumps = [abs(a - b) for a, b in zip(slopes(potential, 2.5 - 1e-3), slopes(potential, 2.5 + 1e-3), strict=True)]
    full = [0.0163, 0.0390, 0.113]  # |u|, |u′|, |u″| of the law at 2.5
    for derivative, jump in enumerate(jumps):
        if derivative < smoothness:
            assert jump < 0.1 * full[derivative]
        elif derivative == smoothness:
            assert jump > 0.3 * full[derivative]


def test_switches_leave_the_law_alone_before_they_start():
    r = np.linspace(0.9, 1.99, 40)
    law = md.LennardJones(1.0, 1.0, 2.5, "truncated").pair_energy(r)
    for truncation in SWITCHES:
        assert md.LennardJones(1.0, 1.0, 2.5, truncation, switch_start=2.0).pair_energy(r) == pytest.approx(
            law, rel=1e-14
        )


def test_scaled_pairs_end_at_the_cutoff_too():
    far = md.System([[0, 0, 0], [1.2, 0, 0], [2.5, 0, 0]], bonds=[[0, 1], [1, 2]])
    scaled = md.evaluate(far, md.LennardJones(1.0, 1.0, 2.4, "truncated", bonded_scale=(0.0, 0.5, 1.0)))
    assert scaled.potential_energy == 0.0


def test_the_switch_starts_at_eight_tenths_of_the_cutoff():
    given = md.LennardJones(1.0, 1.0, 2.5, "switched", switch_start=2.0)
    default = md.LennardJones(1.0, 1.0, 2.5, "switched")
    r = np.linspace(1.9, 2.5, 30)
    assert np.array_equal(given.pair_energy(r), default.pair_energy(r))


@pytest.mark.parametrize("truncation", SWITCHES)
def test_switches_begin_as_smoothly_as_they_promise(truncation):
    potential = md.LennardJones(1.0, 1.0, 2.5, truncation, switch_start=2.0)
    before, after = slopes(potential, 2.0 - 1e-3), slopes(potential, 2.0 + 1e-3)
    scale = [abs(x) for x in before]
    assert abs(after[0] - before[0]) < 0.02 * scale[0]
    assert abs(after[1] - before[1]) < 0.02 * scale[1]
    if truncation != "charmm":
        assert abs(after[2] - before[2]) < 0.1 * scale[2]
