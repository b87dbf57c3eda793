"""Baths: the laws of their noise, the ensembles they sample, and that a resumed run meets the same noise."""

import numpy as np
import pytest
from references import liquid
from scipy import stats

import minimd as md
from minimd.check import check_file
from minimd.h5md import H5MDWriter, read_file
from minimd.integrators import THERMOSTATS, Drift, Kick, State, adjoint, compose
from minimd.integrators.rows import Thermalize
from minimd.report import drift, drift_of_walk
from minimd.scene import parse_scene
from minimd.scene.running import resume_run, run_scene

LANGEVIN = md.LangevinBAOAB(0.01, temperature=1.3, friction=2.0, seed=5)
BUSSI = md.StochasticVelocityRescaling(0.01, temperature=1.3, relaxation_time=0.5, seed=5)
SCENE = """
units = "LJ"
[structure]
lattice = "fcc"
repeat = [3, 3, 3]
density = 0.8
[[potential]]
type = "lennard-jones"
epsilon = 1.0
sigma = 1.0
cutoff = 2.0
[dynamics]
method = "{method}"
timestep = 0.004
steps = 40
temperature = 1.2
relaxation_time = 0.3
[output]
every = 10
"""


def state(velocities, masses, n_dof=None, k_B=1.0):  # noqa: N803
    velocities = np.array(velocities, dtype=float)
    return State(np.zeros_like(velocities), velocities, np.zeros_like(velocities), 1.0 / masses, n_dof=n_dof or velocities.size, k_B=k_B)


def test_the_bath_of_langevin_is_the_ornstein_uhlenbeck_process():
    """Mean e^(−γΔt) v, variance k_B T (1 − e^(−2γΔt))/m, normal."""
    n, k_B, masses = 40_000, 0.7, np.repeat([1.0, 4.0], 20_000)  # noqa: N806
    s = state(np.full((n, 3), 0.8), masses, k_B=k_B)
    LANGEVIN.thermalize(s, 0.3)
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
        s = state(np.full((1, 3), np.sqrt(2.0 * kinetic / 3.0)), np.ones(1), n_dof)
        s.step = k
        BUSSI.thermalize(s, duration)
        energies[k] = 0.5 * (s.velocities**2).sum()
        assert s.heat == pytest.approx(energies[k] - kinetic, abs=1e-12)
    return energies


def test_rescaling_makes_the_kinetic_energy_relax_as_its_equation_says():
    """Mean c K + (1 − c) K̄; variance 2 (1 − c)² K̄²/n + 4 c (1 − c) K K̄/n, of the exact solution."""
    kinetic, n_dof, duration = 3.0, 5, 0.2
    energies, kept, target = rescaled_energies(kinetic, n_dof, duration), np.exp(-0.2 / 0.5), 0.5 * 5 * 1.3
    variance = 2.0 * ((1.0 - kept) * target) ** 2 / n_dof + 4.0 * kept * (1.0 - kept) * kinetic * target / n_dof
    assert energies.mean() == pytest.approx(kept * kinetic + (1.0 - kept) * target, abs=4.0 * np.sqrt(variance / energies.size))
    assert energies.var() == pytest.approx(variance, rel=0.05)


def test_rescaling_for_long_draws_the_canonical_kinetic_energy():
    energies = rescaled_energies(3.0, 5, 100.0, n=5000)
    assert stats.kstest(energies / 1.3, stats.gamma(2.5).cdf).pvalue > 1e-3


def test_rescaling_leaves_the_motion_of_the_whole_alone():
    """n_dof = 3N − 3: what is drawn is the kinetic energy relative to the center of mass, whatever the momentum; the same as at rest."""
    rng, masses, drift = np.random.default_rng(3), np.array([1.0, 2.0, 5.0]), np.array([0.3, -2.0, 7.0])
    inner = rng.normal(size=(3, 3))
    inner -= masses @ inner / masses.sum()
    rest, moving = state(inner, masses, n_dof=6), state(inner + drift, masses, n_dof=6)
    for s in (rest, moving):
        s.conserves_momentum = True
        BUSSI.thermalize(s, 0.2)
    assert np.abs(rest.velocities - inner).max() > 1e-3
    assert moving.velocities - drift == pytest.approx(rest.velocities, abs=1e-13)  # rounding
    assert masses @ moving.velocities == pytest.approx(masses.sum() * drift, rel=1e-14)
    assert moving.heat == pytest.approx(rest.heat, rel=1e-12)
    assert rest.heat == pytest.approx(0.5 * masses @ ((rest.velocities**2).sum(axis=1) - (inner**2).sum(axis=1)), rel=1e-12)


def test_rescaling_leaves_atoms_that_move_together_alone():
    """Nothing but rounding is left beside the motion of the whole; it is not blown up to a temperature."""
    s = state(np.full((7, 3), 0.1), np.linspace(1.0, 2.0, 7), n_dof=18)
    s.conserves_momentum = True
    BUSSI.thermalize(s, 0.2)
    assert (s.velocities == 0.1).all()
    assert s.heat == 0.0


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
        s.step = step
        md.LangevinBAOAB(0.01, 1.3, 2.0, seed).thermalize(s, 0.01)
        return s.velocities

    assert (after(7) == after(7)).all()
    assert (after(7) != after(8)).all()
    assert (after(7) != after(7, seed=6)).all()
    assert (after(-3) != after(3)).all()


class OBABO(md.LangevinBAOAB):
    """Two contacts with the bath in a step. G. Bussi, M. Parrinello, Phys. Rev. E 75, 056707 (2007)."""

    name = "langevin-obabo"
    letters = (Thermalize(0.5), Kick(0.5), Drift(1.0), Kick(0.5), Thermalize(0.5))


def test_two_contacts_in_a_step_have_two_noises():
    """Free atoms from rest: variance k_B T (1 − e^(−2γΔt))/m after one step, as after one contact; with equal noises it would be larger."""
    s = state(np.zeros((20_000, 3)), np.ones(20_000))
    OBABO(1.0, 1.3, 0.5, seed=2).advance(s, lambda s, look: None, 1)
    assert s.velocities.var() == pytest.approx(1.3 * (1.0 - np.exp(-1.0)), rel=4.0 * np.sqrt(2.0 / s.velocities.size))  # statistics


def test_configurations_of_an_oscillator_are_exact_at_large_timesteps():
    """ωΔt = 1.5: ⟨q²⟩ = k_B T/k without error, ⟨v²⟩ = k_B T/m (1 − (ωΔt)²/4) with one. B. Leimkuhler, C. Matthews (2013)."""
    n, omega, temperature = 3000, 1.5, 1.0
    method = md.LangevinBAOAB(1.0, temperature, friction=1.0, seed=1)
    rng = np.random.default_rng(2)
    s = State(rng.normal(size=(n, 3)) / omega, rng.normal(size=(n, 3)), np.zeros((n, 3)), np.ones(n), n_dof=3 * n)

    def springs(s, look):
        s.forces[:] = -(omega**2) * s.positions

    squares = []
    for _ in range(60):
        method.advance(s, springs, 5)
        squares.append([(s.positions**2).mean(), (s.velocities**2).mean()])
    squares = np.array(squares[10:])
    error = squares.std(axis=0, ddof=1) / np.sqrt(len(squares))
    assert error[0] * omega**2 < 0.005
    assert abs(squares[:, 0].mean() - temperature / omega**2) < 4.0 * error[0]  # statistics
    assert abs(squares[:, 1].mean() - temperature * (1.0 - omega**2 / 4.0)) < 4.0 * error[1]


def simulation(method, seed=3):
    lj = md.LennardJones(1.0, 1.0, cutoff=2.0, truncation="force-shifted")
    sim = md.Simulation(liquid(3), lj, method)
    sim.set_temperature(1.3, seed)
    return sim


@pytest.mark.parametrize("method", [LANGEVIN, BUSSI], ids=list(THERMOSTATS))
def test_temperature_counts_the_degrees_of_freedom_that_the_bath_leaves(method):
    sim = simulation(method)
    n = len(sim.system)
    assert sim.n_dof == (3 * n if method is LANGEVIN else 3 * n - 3)
    sim.run(0)
    assert sim.record.temperature[0] == pytest.approx(1.3, rel=1e-14)
    assert 2.0 * sim.record.kinetic_energy[0] == pytest.approx(1.3 * sim.n_dof, rel=1e-14)


@pytest.mark.parametrize("method", [LANGEVIN, BUSSI], ids=list(THERMOSTATS))
def test_total_energy_minus_heat_is_conserved(method):
    """As well as the total energy is without a bath, though the bath moves it by a hundred times more."""
    parameters = {**method.parameters, "timestep": 0.002}
    sim = simulation(type(method)(**parameters))
    sim.equilibrate(500, 1.3)
    record = sim.run(2000, every=25)
    conserved, total = record.conserved_energy, record.total_energy
    assert np.ptp(conserved) < 0.05 * np.ptp(total)
    assert sim.report().energy_is_conserved
    assert "minus heat is conserved" in sim.report().verdict
    assert total[-1] - conserved[-1] == pytest.approx(sim.heat, rel=1e-9)


def test_rescaling_keeps_momentum_and_langevin_does_not_promise_it():
    report = simulation(BUSSI), simulation(LANGEVIN)
    for sim in report:
        sim.run(200, every=20)
    assert report[0].report().momentum_change < 1e-13
    assert report[1].report().momentum_change is None
    assert "not a constant" in str(report[1].report())


def test_without_friction_langevin_is_velocity_verlet():
    free, verlet = simulation(md.LangevinBAOAB(0.004, 1.3, 0.0, 1)), simulation(md.VelocityVerlet(0.004))
    verlet.velocities[:] = free.velocities
    free.run(100)
    verlet.run(100)
    assert np.abs(free.positions - verlet.positions).max() < 1e-10  # rounding, amplified
    assert free.heat == pytest.approx(0.0, abs=1e-10)


@pytest.mark.parametrize("method", [LANGEVIN, BUSSI], ids=list(THERMOSTATS))
def test_a_run_in_two_parts_is_the_run_in_one(method):
    whole, parts = simulation(method), simulation(method)
    whole.run(60, every=30)
    parts.run(30, every=30)
    parts.run(30, every=30)
    assert abs(whole.heat) > 1.0
    assert (whole.positions == parts.positions).all()
    assert (whole.velocities == parts.velocities).all()
    assert whole.heat == parts.heat


def test_contacts_at_both_ends_of_a_step_are_not_made_one_where_nobody_looks():
    whole, parts = (simulation(OBABO(0.004, 1.3, 2.0, 5)) for _ in range(2))
    whole.run(40, every=40)
    parts.run(20, every=20)
    parts.run(20, every=20)
    assert whole.positions == pytest.approx(parts.positions, abs=1e-9)  # rounding: energies are summed with the forces or without


@pytest.mark.parametrize("method", THERMOSTATS)
def test_a_resumed_run_meets_the_noise_of_an_uninterrupted_one(method, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    scene = parse_scene(SCENE.format(method=method), tmp_path / "bath.toml")
    run_scene(scene, trajectory=tmp_path / "whole.h5md", tell=lambda _: None)
    run_scene(scene, steps=20, trajectory=tmp_path / "parts.h5md", tell=lambda _: None)
    resume_run(tmp_path / "parts.h5md", 20, tell=lambda _: None)
    whole, parts = read_file(tmp_path / "whole.h5md"), read_file(tmp_path / "parts.h5md")
    assert np.abs(whole.system.velocities - parts.system.velocities).max() < 1e-11  # rounding: the list is built anew, sums have another order
    assert np.abs(whole.record.conserved_energy - parts.record.conserved_energy).max() < 1e-10
    assert whole.heat == pytest.approx(parts.heat, rel=1e-10)
    assert abs(whole.heat) > 0.1


def test_equilibration_and_run_have_different_noise():
    sim = simulation(LANGEVIN)
    seen = []
    thermalize = sim.method.thermalize
    sim.method = md.LangevinBAOAB(0.01, 1.3, 2.0, 5)
    sim.method.thermalize = lambda s, duration: (seen.append(s.step), thermalize(s, duration))
    sim.equilibrate(5, 1.3)
    sim.run(3)
    assert seen == [-5, -4, -3, -2, -1, 0, 1, 2]
    assert sim.step == 3


def test_each_equilibration_has_noise_of_its_own_and_the_same_in_each_repetition():
    """Two of them, and one after a run: none meets the noise of another, or that of the run."""

    def steps_of_noise():
        sim, seen = simulation(LANGEVIN), []
        sim.method = md.LangevinBAOAB(0.01, 1.3, 2.0, 5)
        thermalize = sim.method.thermalize
        sim.method.thermalize = lambda s, duration: (seen.append(s.step), thermalize(s, duration))
        sim.equilibrate(5, 1.3)
        sim.equilibrate(3, 1.3)
        sim.run(4)
        sim.equilibrate(2, 1.3)
        return seen, sim.velocities

    first, again = steps_of_noise(), steps_of_noise()
    assert first[0] == again[0] == [-5, -4, -3, -2, -1, -8, -7, -6, 0, 1, 2, 3, -10, -9]
    assert (first[1] == again[1]).all()


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: md.LangevinBAOAB(-0.01, 1.0, 1.0, 1), "time cannot run backwards"),
        (lambda: md.LangevinBAOAB(0.01, -1.0, 1.0, 1), "temperature must be finite and not negative"),
        (lambda: md.LangevinBAOAB(0.01, 1.0, np.nan, 1), "friction must be finite"),
        (lambda: md.LangevinBAOAB(0.01, 1.0, 1.0, 1.5), "seed must be a whole number"),
        (lambda: md.LangevinBAOAB(0.01, 1.0, 1.0, 2**128), "below 2¹²⁸; seed = 340"),
        (lambda: md.StochasticVelocityRescaling(0.01, 1.0, 0.0, 1), "relaxation_time must be positive"),
        (lambda: parse_scene(SCENE.format(method="velocity-verlet"), "x.toml"), "takes? no relaxation time"),
        (lambda: parse_scene(SCENE.format(method="langevin-baoab").replace("relaxation_time = 0.3", ""), "x.toml"), "needs a temperature"),
    ],
)
def test_bad_baths_are_told(make, message):
    with pytest.raises(ValueError, match=message):
        make()


def test_small_problems_are_refused():
    with pytest.raises(TypeError, match="runs in a Simulation"):
        md.LangevinBAOAB.on(md.integrators.SecondOrder(lambda q: -q))


def test_what_cannot_be_undone_is_not_composed():
    for make in (lambda: compose(md.LangevinBAOAB), lambda: adjoint(md.StochasticVelocityRescaling)):
        with pytest.raises(TypeError, match="has a bath"):
            make()


def test_replay_meets_the_same_noise():
    """A run that blows up ends in the state of a run that stops just before, made step by step."""
    failing, twin = (simulation(md.LangevinBAOAB(0.045, 1.3, 1.0, 1)) for _ in range(2))
    with pytest.raises(md.NonFiniteError):
        failing.run(20_000, every=100)
    assert failing.step > 1
    twin.run(failing.step, every=1)
    assert (failing.positions, failing.heat) == (pytest.approx(twin.positions, abs=1e-9), pytest.approx(twin.heat, rel=1e-9))  # kicks merge


@pytest.mark.parametrize("method", [LANGEVIN, BUSSI], ids=list(THERMOSTATS))
def test_a_file_of_a_run_with_a_bath_passes_its_check(method, tmp_path):
    sim = simulation(type(method)(**{**method.parameters, "timestep": 0.002}))
    sim.equilibrate(1000, 1.3)
    sim.run(1000, every=10, trajectory=tmp_path / "bath.h5md")
    checked = check_file(tmp_path / "bath.h5md")
    assert checked.passed, str(checked)
    assert checked.report.verdict == sim.report().verdict


@pytest.mark.parametrize(("first", "then"), [(LANGEVIN, md.VelocityVerlet(0.01)), (md.VelocityVerlet(0.01), BUSSI)], ids=["without", "with"])
def test_a_file_with_a_bath_is_not_continued_without_and_the_other_way_round(first, then, tmp_path):
    simulation(first).run(20, every=10, trajectory=tmp_path / "a.h5md")
    other = simulation(then)
    other.step = 20
    with pytest.raises(ValueError, match=r"a thermostat, .* would continue it otherwise"):
        H5MDWriter.append_to(tmp_path / "a.h5md", other)


def test_drift_of_a_walk_has_an_honest_error():
    """Of walks without drift few seem to have one, where a fitted line finds it in most; one that is there is found."""
    rng, t = np.random.default_rng(0), np.linspace(0.0, 100.0, 4001)
    walks = np.cumsum(rng.normal(size=(300, t.size)), axis=1)
    misses = sum(abs(drift_of_walk(t, walk).slope) > 2.0 * drift_of_walk(t, walk).error for walk in walks)
    assert misses < 35  # 5 % expected, with few blocks 6
    assert sum(drift(t, walk).is_significant for walk in walks) > 150
    assert all(drift_of_walk(t, walk + 10.0 * np.sqrt(t.size) / 100.0 * t).is_significant for walk in walks)


@pytest.mark.slow
@pytest.mark.parametrize("make", [lambda s: md.LangevinBAOAB(0.004, 1.3, 5.0, s), lambda s: md.StochasticVelocityRescaling(0.004, 1.3, 0.1, s)])
def test_long_runs_that_are_fine_are_told_so(make):
    """Energy minus heat wanders by 1e-3 ε per atom in 25 000 steps; that is no drift."""
    ratios = []
    for seed in range(6):
        sim = simulation(make(seed), seed)
        sim.run(2000, every=2000)
        sim.run(25_000, every=10)
        ratios.append(sim.report().energy_drift.slope / sim.report().energy_drift.error)
    assert np.abs(ratios).max() < 3.5
    assert np.sqrt(np.mean(np.square(ratios))) < 2.0  # statistics: 1 expected
