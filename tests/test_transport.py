"""Viscosity and diffusion of the Lennard-Jones liquid near its triple point are the published ones."""

import numpy as np
import pytest

import minimd as md

VISCOSITY, DIFFUSION, N_PUBLISHED = 3.258, 0.0325, 1372  # K. Meier, A. Laesecke, S. Kabelac, J. Chem. Phys. 121, 3671 and 9526 (2004)
DENSITY, TEMPERATURE = 0.8442, 0.722


@pytest.mark.slow
def test_viscosity_and_diffusion_near_the_triple_point():
    """Within two standard errors. Of 500 atoms: the published diffusion is that of 1372, both are brought to an infinite system."""
    positions, edges = md.lattice.crystal("fcc", [5] * 3, md.lattice.constant_from_density("fcc", DENSITY))
    bath = md.StochasticVelocityRescaling.with_relaxation_time(0.004, TEMPERATURE, 10.0, seed=4)
    liquid = md.Simulation(md.System(positions, cell=edges), md.LennardJones(1.0, 1.0, 3.0), bath)
    liquid.set_temperature(2.0 * TEMPERATURE, seed=4)
    liquid.equilibrate(20_000, TEMPERATURE)
    stress, displacement = md.observers.Viscosity(every=4), md.observers.MeanSquareDisplacement(every=25)
    velocity = md.observers.VelocityAutocorrelation(every=5)
    liquid.run(300_000, every=1000, observers=[stress, displacement, velocity])
    eta, moved, turned = stress.result(), displacement.result(viscosity=VISCOSITY), velocity.result()
    print(eta, moved, turned, sep="\n")
    correction = md.observers.finite_size_correction(TEMPERATURE, VISCOSITY, (N_PUBLISHED / DENSITY) ** (1.0 / 3.0))
    assert eta.plateau.is_reached
    assert 0.0 < eta.viscosity_error < 0.08 * VISCOSITY
    assert abs(eta.viscosity - VISCOSITY) < 2.0 * eta.viscosity_error  # statistics
    assert 0.0 < moved.infinite_error < 0.02 * DIFFUSION
    assert abs(moved.infinite - (DIFFUSION + correction)) < 2.0 * np.hypot(moved.infinite_error, 0.01 * DIFFUSION)  # theirs is some 1 %
    assert abs(turned.diffusion - moved.diffusion) < 3.0 * np.hypot(turned.diffusion_error, moved.diffusion_error)
