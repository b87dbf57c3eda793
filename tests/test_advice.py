"""Advice on the time step: what it calls the limit is where runs blow up, for every scene and every method; closed forms; words."""

import warnings

import numpy as np
import pytest
import scipy.linalg
from rigid_scenes import SCENES as RIGID
from step_scenes import SCENES, at_minimum, diatomic, fcc, longest_stable_step, rigid_dumbbells

import minimd as md
from minimd.integrators import SPLITTINGS, THERMOSTATS, SecondOrder, energy_oscillation, run_steps, stability_limit
from minimd.integrators.splitting.substeps import repeated

EXPLICIT = [*SPLITTINGS.values()]


def oscillator_path(method, h, n_steps):
    return run_steps(SecondOrder(lambda q: -q), method(h), ([1.0], [0.3]), n_steps)


@pytest.mark.parametrize("name", SCENES)
def test_the_longest_stable_step_is_the_one_advised(name):
    state = at_minimum(SCENES[name])
    advice = md.advise_timestep(*state)
    measured = longest_stable_step(*state, md.VelocityVerlet, advice.limit)
    assert measured == pytest.approx(advice.limit, rel=0.01)  # truncation: six bisections of ±20 %


@pytest.mark.parametrize(
    "method", [md.integrators.PEFRL, md.integrators.Ruth3, md.integrators.KahanLi6, md.PositionVerlet]
)
def test_the_limit_holds_for_other_methods(method):
    state = at_minimum(fcc)
    advice = md.advise_timestep(*state, method=method)
    assert longest_stable_step(*state, method, advice.limit) == pytest.approx(
        advice.limit, rel=0.01
    )  # truncation, as above


@pytest.mark.parametrize("method", EXPLICIT, ids=lambda method: method.name)
def test_an_oscillator_stays_bounded_below_the_limit_and_not_above(method):
    limit = stability_limit(method.sequence())
    for h in np.linspace(0.05, 0.999, 20) * limit:
        assert np.abs(oscillator_path(method, h, 1000).q).max() < 100.0
    assert (
        not np.abs(oscillator_path(method, 1.001 * limit, 4000).q).max() < 1000.0
    )  # slowly for blanes-moan-rkn-4, e^0.002 in a step


def test_limits_that_are_known():
    assert stability_limit(md.VelocityVerlet.sequence()) == pytest.approx(2.0, abs=1e-14)  # rounding
    for method in THERMOSTATS.values():
        assert stability_limit(method.sequence()) == pytest.approx(
            2.0, abs=1e-14
        )  # rounding; contacts with the bath left out
    twice = repeated(md.VelocityVerlet.sequence(), (0.5, 0.5))  # tr M touches −2 at h = 2√2, where nothing happens
    assert stability_limit(twice) == pytest.approx(4.0, rel=1e-6)


@pytest.mark.parametrize("method", EXPLICIT, ids=lambda method: method.name)
def test_the_energy_of_an_oscillator_swings_as_told(method):
    h = 0.4 * stability_limit(method.sequence())
    path = oscillator_path(method, h, 20_000)
    energies = 0.5 * (path.q**2 + path.v**2)
    swing = (energies.max() - energies.min()) / (energies.max() + energies.min())
    assert energy_oscillation(method.sequence(), h) == pytest.approx(
        swing, rel=2e-3
    )  # the path does not meet the axes exactly


def test_verlet_makes_twenty_steps_a_period_and_the_energy_swings_by_an_80th():
    advice = md.advise_timestep(*diatomic())
    assert advice.period / advice.recommended == pytest.approx(20.0, rel=1e-3)
    h = advice.frequency * advice.recommended
    assert energy_oscillation(md.VelocityVerlet.sequence(), h) == pytest.approx(1.0 / 80.0, rel=1e-9)
    assert energy_oscillation(md.VelocityVerlet.sequence(), h) == pytest.approx(h**2 / (8.0 - h**2), rel=1e-9)
    euler = md.advise_timestep(*diatomic(), method=md.integrators.SE1)
    assert euler.recommended * euler.frequency / 2.0 == pytest.approx(1.0 / 80.0, rel=1e-6)  # symplectic Euler: h/2


def test_frequency_of_a_chain_is_the_closed_form():
    k = np.arange(40)
    system = md.System(np.column_stack([k, 0 * k, 0 * k]), masses=2.0, bonds=np.column_stack([k[:-1], k[1:]]))
    advice = md.advise_timestep(system, md.HarmonicBond(50.0, 1.0))
    assert advice.frequency == pytest.approx(
        2.0 * np.sqrt(50.0 / 2.0) * np.cos(np.pi / 80.0), rel=1e-4
    )  # ACCURACY of iterations


def test_frequency_of_a_dimer_at_its_minimum():
    u2 = 4.0 * (12 * 13 * 2 ** (-14 / 6) - 6 * 7 * 2 ** (-8 / 6))  # u″ at r = 2^(1/6)
    system = md.System([[0.0, 0.0, 0.0], [2 ** (1 / 6), 0.0, 0.0]], masses=[1.0, 3.0])
    assert md.advise_timestep(system, md.LennardJones(1.0, 1.0)).frequency == pytest.approx(
        np.sqrt(u2 * 4.0 / 3.0), rel=1e-7
    )


def test_tension_of_a_rigid_bond_stiffens_its_swinging():
    """A pendulum of length 1, pulled by a spring of rest length ½ to an anchor at distance 2: ω² = 1.5 k (1 + 1/2)/m."""
    system = md.System([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [3.0, 0.0, 0.0]], masses=[1.0, 2.0, 1.0])
    spring = md.HarmonicBond(40.0, 0.5, pairs=[[1, 2]])
    held = [md.DistanceConstraints([[0, 1]]), md.FixedAtoms([0, 2])]
    advice = md.advise_timestep(system, spring, held)
    assert advice.frequency == pytest.approx(np.sqrt(60.0 * 1.5 / 2.0), rel=1e-7)
    assert advice.atoms == (1,)


def reduced_frequency(system, law, quadratic, linear):
    """The highest frequency of M^−1/2 (∇²U − Σ λ ∇²g) M^−1/2 on the null space of all ∇g, by dense algebra.

    quadratic : pairs (i, j), each with g = ½ (r_ij² − d²).  linear : rows (3N,) whose product with r is constant.
    """
    n, x = 3 * len(system), system.positions.ravel().copy()

    def forces(y):
        return md.evaluate(md.System(y.reshape(-1, 3), bonds=system.bonds), law).forces.ravel()

    hessian = np.array([forces(x - 1e-6 * e) - forces(x + 1e-6 * e) for e in np.eye(n)]) / 2e-6
    curvatures = []
    for i, j in quadratic:
        b = np.zeros((3, n))
        b[:, 3 * j : 3 * j + 3], b[:, 3 * i : 3 * i + 3] = np.eye(3), -np.eye(3)
        curvatures.append(b.T @ b)
    gradients = np.array([*(g @ x for g in curvatures), *linear])
    root = 1.0 / np.sqrt(np.repeat(system.masses, 3))
    multipliers = np.linalg.lstsq((gradients * root).T, -forces(x) * root, rcond=None)[
        0
    ]  # at rest: M⁻¹(F + λ ∇g) keeps g
    lagrangian = hessian - np.einsum("k,kab->ab", multipliers[: len(curvatures)], np.array(curvatures))
    allowed = scipy.linalg.null_space(gradients * root)
    return np.sqrt(np.linalg.eigvalsh(allowed.T @ (root[:, None] * lagrangian * root) @ allowed)[-1])


@pytest.mark.parametrize("shape", ["water", "chain", "ring", "cube", "rod"])
def test_frequencies_with_constraints_are_those_of_the_reduced_problem(shape):
    one, pairs, masses = RIGID[shape]
    one, pairs, masses = (one[:9], pairs[:8], masses[:9]) if shape == "chain" else (one, pairs, masses)
    positions, pairs = np.concatenate([one, one + np.array([0.7, 1.5, 1.2])]), np.concatenate([pairs, pairs + len(one)])
    system = md.System(positions, masses=np.tile(masses, 2), bonds=pairs)
    law = md.LennardJones(1.0, 0.9)
    quadratic, linear = pairs.tolist(), []
    if shape == "rod":  # its ends are atoms 0 and 2, the middle one lies at 1.16 of 2.5 between them
        quadratic = [[0, 2], [3, 5]]
        for start in (0, 3):
            for c in range(3):
                row = np.zeros(18)
                row[3 * np.array([start, start + 1, start + 2]) + c] = 1.16 / 2.5 - 1.0, 1.0, -1.16 / 2.5
                linear.append(row)
    advice = md.advise_timestep(system, law, md.DistanceConstraints(pairs))
    assert advice.frequency == pytest.approx(
        reduced_frequency(system, law, quadratic, linear), rel=1e-4
    )  # ACCURACY of iterations


def test_rigid_bonds_do_not_oscillate():
    system, law, rigid = rigid_dumbbells()
    stiff = md.HarmonicBond(1e6, 0.5)
    assert md.advise_timestep(system, [law, stiff], rigid).frequency == pytest.approx(
        md.advise_timestep(system, law, rigid).frequency, rel=1e-3
    )
    assert md.advise_timestep(system, [law, stiff]).frequency > 1000.0


def test_the_stiffest_bond_is_named():
    system, _law, _ = SCENES["chain"]()
    stiffness = np.full(11, 100.0)
    stiffness[4] = 5000.0
    advice = md.advise_timestep(system, md.HarmonicBond(stiffness, 1.0), method=md.VelocityVerlet(0.01))
    assert advice.bond == (4, 5)
    assert set(advice.atoms) == {4, 5}
    assert sum(advice.shares) == pytest.approx(1.0, abs=0.02)
    text = str(advice)
    for words in ("the bond of atoms 4 and 5", "velocity-verlet", "20 steps a period", "0.01 τ", "of the limit"):
        assert words in text


@pytest.mark.parametrize("n_atoms", [2, 64])
def test_nothing_that_oscillates_limits_nothing(n_atoms):
    free = md.System(np.outer(np.arange(n_atoms), [5.0, 0.0, 0.0]))
    advice = md.advise_timestep(free, md.LennardJones(1.0, 1.0, cutoff=2.5))
    assert advice.frequency == 0.0
    assert advice.limit == advice.recommended == np.inf
    assert "nothing oscillates" in str(advice)


def test_advice_leaves_the_system_alone_and_sees_far_atoms():
    system, law, _ = fcc()
    before = system.positions.copy()
    here = md.advise_timestep(system, law)
    assert np.array_equal(system.positions, before)
    system.positions += 1000.0 * np.array([5.0, -7.0, 3.0])
    assert md.advise_timestep(system, law).frequency == pytest.approx(here.frequency, rel=1e-3)


def test_what_cannot_be_advised_is_refused():
    system = md.System([[0.0, 0.0, 0.0], [0.0, 0.0, 0.0]])
    with pytest.raises(md.NonFiniteError, match="atoms 0 and 1, 0 σ apart"):
        md.advise_timestep(system, md.LennardJones(1.0, 1.0))
    with pytest.raises(TypeError, match="method must be a splitting"):
        md.advise_timestep(system, md.LennardJones(1.0, 1.0), method=0.01)


def test_a_run_warns_of_a_step_too_long_for_a_bond():
    system, bond, _ = diatomic()  # 2/ω = 0.1789
    simulation = md.Simulation(system, bond, md.VelocityVerlet(0.18))
    with pytest.warns(
        UserWarning, match=r"timestep 0\.18 τ is longer than the bond of atoms 0 and 1 allows: .* up to 0\.1789 τ"
    ) as caught:
        simulation.run(1)
    assert caught[0].filename == __file__
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        simulation.run(1)  # said once
        md.Simulation(system, bond, md.VelocityVerlet(0.178)).run(1)
        md.Simulation(system, bond, md.integrators.PEFRL(0.26)).run(1)  # stable up to 2.989/ω
        md.Simulation(system, bond, md.VelocityVerlet(0.18), md.DistanceConstraints([[1, 0]])).run(1)
        md.Simulation(system, bond, md.VelocityVerlet(0.18), md.FixedAtoms([0])).run(1)  # 2/ω = 0.4


def test_a_crystal_that_will_melt_is_given_the_step_of_collisions():
    """At T* 1.44 the step of the modes alone, 0.0285 τ, blows up; the hint of a run names the same step as the advice."""
    positions, edges = md.lattice.crystal("fcc", [4, 4, 4], 1.68)
    system, law = md.System(positions, cell=edges), md.LennardJones(1.0, 1.0, 2.5, truncation="force-shifted")
    cold = md.advise_timestep(system, law)
    assert cold.harmonic == pytest.approx(0.0285, rel=0.01)
    assert cold.recommended == cold.collision == pytest.approx(0.00588, rel=0.01)
    assert "decided by     collisions of Lennard-Jones atoms" in str(cold)
    sim = md.Simulation(system, law, md.VelocityVerlet(cold.harmonic))
    sim.set_temperature(1.44, seed=1)
    hot = md.advise_timestep(sim.system, law)
    assert hot.recommended == pytest.approx(0.00507, rel=0.01)  # ω 5.8 times that of a pair
    with pytest.warns(UserWarning, match=f"up to {md.units.LJ.shown(hot.recommended)}; see advise_timestep"):
        sim.run(1)


def test_a_hydrogen_inside_its_oxygen_does_not_collide():
    system = md.System(
        [[0.0, 0, 0], [1.0, 0, 0], [4.0, 0, 0], [5.0, 0, 0]],
        masses=[16.0, 1.0, 16.0, 1.0],
        species=["O", "H", "O", "H"],
    )
    law = md.LennardJones({"O": (1.0, 3.0), "H": (0.3, 0.4)})
    held = md.DistanceConstraints([[0, 1], [2, 3]])
    alone = md.advise_timestep(system, md.LennardJones({"O": (1.0, 3.0), "H": (0.0, 0.4)}), held)
    assert md.advise_timestep(system, law, held).collision == pytest.approx(alone.collision, rel=1e-12)
    assert md.advise_timestep(system, law).collision < 0.1 * alone.collision
