"""NIST's Lennard-Jones reference configurations, to the last digit that is known of them."""

import numpy as np
import pytest
from references import load

import minimd as md
from minimd.core.potentials.truncation import SWITCHES

CASES = [(f"nist_lj/config{c}.json", k) for c in (1, 4) for k in range(3)]
SCHEMES = {"truncated_plus_LRC": "truncated", "linear_force_shift": "force-shifted"}
RELATIVE = 1e-12  # rounding of 3e5 terms


@pytest.mark.parametrize(("name", "k"), CASES)
def test_energy_virial_and_tail_are_nists(name, k):
    data = load(name)
    row, system = data["rows"][k], md.System(data["x"], cell=data["box"])
    truncation = SCHEMES[row["scheme"]]
    plain = md.evaluate(system, md.LennardJones(1.0, 1.0, row["rc"], truncation))
    assert plain.potential_energy == pytest.approx(row["Upair_recomputed"], rel=RELATIVE)
    assert np.trace(plain.virial) == pytest.approx(row["Wpair_recomputed"], rel=RELATIVE)
    if truncation == "truncated":
        whole = md.evaluate(system, md.LennardJones(1.0, 1.0, row["rc"], truncation, tail_correction=True))
        assert whole.potential_energy - plain.potential_energy == pytest.approx(row["ULRC_recomputed"], rel=RELATIVE)
        size, cutoff = 16.0 * np.pi * len(system) ** 2 / system.volume, row["rc"]
        closed_form = size * (2.0 / 3.0 * cutoff**-9 - cutoff**-3)
        assert np.trace(whole.virial - plain.virial) == pytest.approx(closed_form, rel=1e-11)  # of the difference


@pytest.mark.parametrize("truncation", SWITCHES)
def test_tail_makes_a_switched_fluid_that_of_the_full_law(truncation):
    """At uniform density, energy and virial with the tail are those of the full law, wherever the cutoff lies."""
    counts, volume = np.array([1000]), 2000.0
    energies, virials = [], []
    for cutoff in (3.0, 3.5):
        potential = md.LennardJones(1.0, 1.0, cutoff, truncation, switch_start=2.5, tail_correction=True)
        r = np.linspace(2.5, cutoff, 20_001)
        u = potential.pair_energy(r)
        tail = potential.tail(counts, ("X",), volume)
        pairs = 2 * np.pi * counts[0] ** 2 / volume
        energies.append(pairs * np.trapezoid(u * r**2, r) + tail[0])
        virials.append(pairs * np.trapezoid(-np.gradient(u, r) * r**3, r) + tail[1])
    assert energies[0] == pytest.approx(energies[1], rel=1e-8)  # truncation of the trapezoidal rule
    assert virials[0] == pytest.approx(virials[1], rel=1e-6)  # and of the gradient


def test_tail_follows_the_volume_and_is_shared_by_the_atoms():
    system = md.System(np.random.default_rng(1).uniform(0, 8, (100, 3)), cell=8.0)
    on, off = (md.LennardJones(1.0, 0.3, 2.0, "truncated", tail_correction=tail) for tail in (True, False))
    forces, plain = md.Forces(system, on), md.Forces(system, off)
    tails = []
    for edge in (8.0, 16.0):
        system.cell = md.Cell.of(edge)
        sums, without = forces.compute(2), plain.compute(2)
        tails.append((sums.potential_energy - without.potential_energy, np.trace(sums.virial - without.virial)))
        assert sums.energies.sum() == pytest.approx(sums.potential_energy, rel=1e-12)
        assert sums.virials.sum(axis=0)[:3].sum() == pytest.approx(np.trace(sums.virial), rel=1e-12)
    assert tails[0] == pytest.approx(np.multiply(8.0, tails[1]), rel=1e-6)
