"""Profiles of films, in layers about their center."""

import numpy as np
import pytest

import minimd as md


@pytest.mark.parametrize("move", [7.0, 23.0, -41.0])  # the film of 8 σ is cut by the boundary at ±12 σ, or is an image
def test_layers_about_the_center_move_with_a_film(move):
    places = np.random.default_rng(1).random((200, 3)) * [6.0, 6.0, 8.0]
    found = []
    for shift in (0.0, move):
        film = md.System(places + shift * np.eye(3)[2], masses=np.linspace(1.0, 2.0, 200), cell=[6.0, 6.0, 24.0])
        layers = md.observers.Profile(n_bins=48, center=True)
        md.Simulation(film, [], md.VelocityVerlet(0.004)).run(1, observers=[layers], progress=False)
        found.append(layers.result())
    np.testing.assert_array_equal(found[0].densities, found[1].densities)
    assert (found[0].z[0], found[0].z[-1]) == (-11.75, 11.75)
    occupied = found[0].z[found[0].density > 0.0]
    assert (occupied.min(), occupied.max()) == pytest.approx((-4.0, 4.0), abs=0.5)  # of the center, one bin
