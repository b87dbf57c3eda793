"""Baths: the laws of their noise, and what they draw."""

import numpy as np
import pytest
from baths import BUSSI, LANGEVIN, OBABO, SCENE, in_contact, simulation, state
from scipy import stats

import minimd as md
from minimd.integrators import THERMOSTATS, State, adjoint, compose
from minimd.scene import parse_scene


def test_the_bath_of_langevin_is_the_ornstein_uhlenbeck_process():
    """Mean e^(−γΔt) v, variance k_B T (1 − e^(−2γΔt))/m, normal."""
    n, k_B, masses = 40_000, 0.7, np.repeat([1.0, 4.0], 20_000)  # noqa: N806
    s = state(np.full((n, 3), 0.8), masses)
    LANGEVIN.thermalize(s, 0.3, in_contact(k_B=k_B))
    kept = np.exp(-2.0 * 0.3)
    for mass in (1.0, 4.0):
        v = s.velocities[masses == mass].ravel()
        variance = k_B * 1.3 * (1.0 - kept**2) / mass
        assert v.mean() == pytest.approx(0.8 * kept, abs=4.0 * np.sqrt(variance / v.size))  # statistics
        assert v.var() == pytest.approx(variance, rel=4.0 * np.sqrt(2.0 / v.size))
        assert stats.kstest((v - 0.8 * kept) / np.sqrt(variance), "norm").pvalue > 1e-3


def rescaled_energies(kinetic, n_dof, duration, n=40_000):
    """Kinetic energies after one contact with the bath, from many steps."""
    energies = np.empty(n)
    for k in range(n):
        s, around = state(np.full((1, 3), np.sqrt(2.0 * kinetic / 3.0)), np.ones(1)), in_contact(n_dof=n_dof, step=k)
        BUSSI.thermalize(s, duration, around)
        energies[k] = 0.5 * (s.velocities**2).sum()
        assert around.bath.energy == pytest.approx(energies[k] - kinetic, abs=1e-12)
    return energies


def test_rescaling_makes_the_kinetic_energy_relax_as_its_equation_says():
    """Mean c K + (1 − c) K̄; variance 2 (1 − c)² K̄²/n + 4 c (1 − c) K K̄/n, of the exact solution."""
    kinetic, n_dof, duration = 3.0, 5, 0.2
    energies, kept, target = rescaled_energies(kinetic, n_dof, duration), np.exp(-0.2 / 0.5), 0.5 * 5 * 1.3
    variance = 2.0 * ((1.0 - kept) * target) ** 2 / n_dof + 4.0 * kept * (1.0 - kept) * kinetic * target / n_dof
    assert energies.mean() == pytest.approx(
        kept * kinetic + (1.0 - kept) * target, abs=4.0 * np.sqrt(variance / energies.size)
    )
    assert energies.var() == pytest.approx(variance, rel=0.05)


def test_rescaling_for_long_draws_the_canonical_kinetic_energy():
    energies = rescaled_energies(3.0, 5, 100.0, n=5000)
    assert stats.kstest(energies / 1.3, stats.gamma(2.5).cdf).pvalue > 1e-3


def test_rescaling_leaves_the_motion_of_the_whole_alone():
    """n_dof = 3N − 3: what is drawn is the kinetic energy relative to the center of mass, whatever the momentum; the same as at rest."""
    rng, masses, drift = np.random.default_rng(3), np.array([1.0, 2.0, 5.0]), np.array([0.3, -2.0, 7.0])
    inner = rng.normal(size=(3, 3))
    inner -= masses @ inner / masses.sum()
    rest, moving = state(inner, masses), state(inner + drift, masses)
    given = []
    for s in (rest, moving):
        around = in_contact(n_dof=6, conserves_momentum=True)
        BUSSI.thermalize(s, 0.2, around)
        given.append(around.bath.energy)
    assert np.abs(rest.velocities - inner).max() > 1e-3
    assert moving.velocities - drift == pytest.approx(rest.velocities, abs=1e-13)  # rounding
    assert masses @ moving.velocities == pytest.approx(masses.sum() * drift, rel=1e-14)
    assert given[1] == pytest.approx(given[0], rel=1e-12)
    assert given[0] == pytest.approx(
        0.5 * masses @ ((rest.velocities**2).sum(axis=1) - (inner**2).sum(axis=1)), rel=1e-12
    )


def test_rescaling_leaves_atoms_that_move_together_alone():
    """Nothing but rounding is left beside the motion of the whole; it is not blown up to a temperature."""
    s, around = state(np.full((7, 3), 0.1), np.linspace(1.0, 2.0, 7)), in_contact(n_dof=18, conserves_momentum=True)
    BUSSI.thermalize(s, 0.2, around)
    assert (s.velocities == 0.1).all()
    assert around.bath.energy == 0.0


def test_a_liquid_that_flows_has_the_temperature_of_its_bath_and_keeps_its_flow():
    sim = simulation(BUSSI)
    sim.velocities[:] += [3.0, 0.0, -1.0]
    inner = []

    def look(run):
        v = run.velocities - run.velocities.mean(axis=0)
        inner.append((v**2).sum() / (3 * len(v) - 3))

    sim.run(3000, every=20, observers=[look])
    blocks = np.array(inner[31:]).reshape(10, -1).mean(axis=1)
    assert sim.velocities.mean(axis=0) == pytest.approx([3.0, 0.0, -1.0], abs=1e-12)  # rounding
    assert blocks.mean() == pytest.approx(1.3, abs=4.0 * blocks.std(ddof=1) / np.sqrt(10))  # statistics


def test_single_and_fixed_atoms_keep_all_their_degrees_of_freedom():
    """A momentum that is no constant is thermal: it is rescaled with the rest."""
    lj, one = md.LennardJones(1.0, 1.0, cutoff=2.0), md.System([[0.0, 0.0, 0.0]], velocities=[[1.0, 2.0, 3.0]])
    two = md.System([[0.0, 0.0, 0.0], [9.0, 0.0, 0.0]], velocities=[[0.0, 0.0, 0.0], [1.0, 2.0, 3.0]])
    for system, fixed in ((one, None), (two, md.FixedAtoms([0]))):
        sim = md.Simulation(system, lj, BUSSI, fixed)
        sim.run(1)
        assert sim.n_dof == 3
        assert sim.velocities[-1] / [1.0, 2.0, 3.0] == pytest.approx(sim.velocities[-1, 0], rel=1e-14)
        assert abs(sim.velocities[-1, 0] - 1.0) > 1e-3


def test_noise_depends_on_seed_and_step_alone():
    def after(step, seed=5):
        s = state(np.ones((4, 3)), np.ones(4))
        md.LangevinBAOAB(0.01, 1.3, 2.0, seed).thermalize(s, 0.01, in_contact(step=step))
        return s.velocities

    assert (after(7) == after(7)).all()
    assert (after(7) != after(8)).all()
    assert (after(7) != after(7, seed=6)).all()
    assert (after(-3) != after(3)).all()


def test_two_contacts_in_a_step_have_two_noises():
    """Free atoms from rest: variance k_B T (1 − e^(−2γΔt))/m after one step, as after one contact; with equal noises it would be larger."""
    s = state(np.zeros((20_000, 3)), np.ones(20_000))
    OBABO(1.0, 1.3, 0.5, seed=2).advance(s, lambda s, with_energy: None, 1, surroundings=in_contact())
    assert s.velocities.var() == pytest.approx(
        1.3 * (1.0 - np.exp(-1.0)), rel=4.0 * np.sqrt(2.0 / s.velocities.size)
    )  # statistics


def test_configurations_of_an_oscillator_are_exact_at_large_timesteps():
    """ωΔt = 1.5: ⟨q²⟩ = k_B T/k without error, ⟨v²⟩ = k_B T/m (1 − (ωΔt)²/4) with one. B. Leimkuhler, C. Matthews (2013)."""
    n, omega, temperature = 3000, 1.5, 1.0
    method = md.LangevinBAOAB(1.0, temperature, friction=1.0, seed=1)
    rng = np.random.default_rng(2)
    s = State(rng.normal(size=(n, 3)) / omega, rng.normal(size=(n, 3)), np.zeros((n, 3)), np.ones(n))
    around = in_contact(n_dof=3 * n)

    def springs(s, with_energy):
        s.forces[:] = -(omega**2) * s.positions

    squares = []
    for _ in range(60):
        method.advance(s, springs, 5, surroundings=around)
        squares.append([(s.positions**2).mean(), (s.velocities**2).mean()])
    squares = np.array(squares[10:])
    error = squares.std(axis=0, ddof=1) / np.sqrt(len(squares))
    assert error[0] * omega**2 < 0.005
    assert abs(squares[:, 0].mean() - temperature / omega**2) < 4.0 * error[0]  # statistics
    assert abs(squares[:, 1].mean() - temperature * (1.0 - omega**2 / 4.0)) < 4.0 * error[1]


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: md.LangevinBAOAB(-0.01, 1.0, 1.0, 1), "time cannot run backwards"),
        (lambda: md.LangevinBAOAB(0.01, -1.0, 1.0, 1), "temperature must be finite and not negative"),
        (lambda: md.LangevinBAOAB(0.01, 1.0, np.nan, 1), "friction must be finite"),
        (lambda: md.LangevinBAOAB(0.01, 1.0, 1.0, 1.5), "seed must be a whole number"),
        (lambda: md.LangevinBAOAB(0.01, 1.0, 1.0, 2**128), "below 3.4e.38; seed = 340"),
        (lambda: md.StochasticVelocityRescaling(0.01, 1.0, 0.0, 1), "relaxation_time must be positive"),
        (lambda: parse_scene(SCENE.format(method="velocity-verlet"), "x.toml"), "which has no relaxation time"),
        (
            lambda: parse_scene(SCENE.format(method="langevin-baoab").replace("relaxation_time = 0.3", ""), "x.toml"),
            "must have relaxation_time with",
        ),
    ],
)
def test_bad_baths_are_told(make, message):
    with pytest.raises(ValueError, match=message):
        make()


@pytest.mark.parametrize("method", THERMOSTATS.values())
def test_every_thermostat_can_be_made_from_its_relaxation_time_and_again_from_its_parameters(method):
    bath = method.with_relaxation_time(0.01, temperature=1.3, relaxation_time=0.5, seed=7)
    own = {"friction": 2.0} if method is md.LangevinBAOAB else {"relaxation_time": 0.5}
    assert type(bath) is method
    assert bath.parameters == {"timestep": 0.01, "temperature": 1.3, "seed": 7, **own}
    assert method(**bath.parameters).parameters == bath.parameters


def test_small_problems_are_refused():
    with pytest.raises(TypeError, match="runs in a Simulation"):
        md.LangevinBAOAB.on(md.integrators.SecondOrder(lambda q: -q))


def test_what_cannot_be_undone_is_not_composed():
    for make in (lambda: compose(md.LangevinBAOAB), lambda: adjoint(md.StochasticVelocityRescaling)):
        with pytest.raises(TypeError, match="has a bath"):
            make()
