"""Baths: the laws of their noise, what runs with them conserve, also in parts or resumed, and the ensemble they sample.

P. T. Merz, M. R. Shirts, PLOS ONE 13, e0202764 (2018)."""

import numpy as np
import pytest
from scenes import SCENES
from scipy import stats
from wrong_calls import answered

import minimd as md
from minimd.core.files.h5md_writer import H5MDWriter
from minimd.core.integrators.barostats import ThermodynamicState
from minimd.core.integrators.substeps import Thermalize
from minimd.integrators import THERMOSTATS, Bath, Drift, Kick, State, Surroundings, adjoint, compose
from minimd.view.check import check_file

LANGEVIN = md.LangevinBAOAB(0.01, temperature=1.3, friction=2.0, seed=5)
BUSSI = md.StochasticVelocityRescaling(0.01, temperature=1.3, relaxation_time=0.5, seed=5)
K_B, FS = md.units.ASE.k_B, md.units.fs
METHODS = {
    "langevin": lambda t, seed: md.LangevinBAOAB(4 * FS, t, friction=1 / (500 * FS), seed=seed),
    "rescaling": lambda t, seed: md.StochasticVelocityRescaling(4 * FS, t, relaxation_time=200 * FS, seed=seed),
}
TEMPERATURES = (94.4, 100.0)  # K; the potential energies of 108 atoms overlap well
EVERY, SIGMAS = 25, 3.0
CONVERSIONS = {"energy": 96.485, "length": 0.1, "volume": 1e-3, "temperature": 1.0, "pressure": 1.602e6}
test_bad_baths_are_answered = answered(
    (lambda: md.LangevinBAOAB(-0.01, 1.0, 1.0, 1), ValueError, "timestep", "-0.01"),
    (lambda: md.LangevinBAOAB(0.01, -1.0, 1.0, 1), ValueError, "temperature", "-1.0"),
    (lambda: md.LangevinBAOAB(0.01, 1.0, np.nan, 1), ValueError, "friction", "nan"),
    (lambda: md.LangevinBAOAB(0.01, 1.0, 1.0, 2**128), ValueError, "seed", "340"),
    (lambda: md.StochasticVelocityRescaling(0.01, 1.0, 0.0, 1), ValueError, "relaxation_time", "0.0"),
    (lambda: md.LangevinBAOAB.on(md.integrators.SecondOrder(lambda q: -q)), TypeError, "langevin-baoab"),
    (lambda: compose(md.LangevinBAOAB), TypeError, "langevin-baoab"),
    (lambda: adjoint(md.StochasticVelocityRescaling), TypeError, "velocity-rescaling"),
)


def state(velocities, masses):
    v = np.array(velocities, dtype=float)
    return State(np.zeros_like(v), v, np.zeros_like(v), 1.0 / np.asarray(masses))


def in_contact(**bath):
    return Surroundings(bath=Bath(**bath))


def simulation(method, seed=3):
    sim = SCENES["argon"]().simulation(method)
    sim.set_temperature(1.3, seed)
    return sim


def test_the_bath_of_langevin_is_the_ornstein_uhlenbeck_process():
    """Mean e^(−γΔt) v, variance k_B T (1 − e^(−2γΔt))/m, normal."""
    n, k_B, masses = 40_000, 0.7, np.repeat([1.0, 4.0], 20_000)
    s, kept = state(np.full((n, 3), 0.8), masses), np.exp(-2.0 * 0.3)
    LANGEVIN.thermalize(s, 0.3, in_contact(k_B=k_B))
    for mass in (1.0, 4.0):
        v, variance = s.velocities[masses == mass].ravel(), k_B * 1.3 * (1.0 - kept**2) / mass
        assert v.mean() == pytest.approx(0.8 * kept, abs=4.0 * np.sqrt(variance / v.size))  # statistics
        assert v.var() == pytest.approx(variance, rel=4.0 * np.sqrt(2.0 / v.size))
        assert stats.kstest((v - 0.8 * kept) / np.sqrt(variance), "norm").pvalue > 1e-3


def test_a_bath_alone_is_a_method():
    noise = type("Noise", (md.LangevinBAOAB,), {"name": "noise", "substeps": (Thermalize(1.0),)})
    sim, kept = simulation(noise(0.01, 0.0, friction=2.0, seed=5)), np.exp(-2.0 * 0.03)
    before, places = sim.velocities.copy(), sim.positions.copy()
    sim.run(3)
    assert sim.velocities == pytest.approx(kept * before, rel=1e-12)
    assert np.array_equal(sim.positions, places)


def rescaled_energies(kinetic, n_dof, duration, n):
    """Kinetic energies after one contact with the bath, from many steps."""
    energies = np.empty(n)
    for k in range(n):
        s, around = state(np.full((1, 3), np.sqrt(2.0 * kinetic / 3.0)), [1.0]), in_contact(n_dof=n_dof, step=k)
        BUSSI.thermalize(s, duration, around)
        energies[k] = 0.5 * (s.velocities**2).sum()
        assert around.bath.energy == pytest.approx(energies[k] - kinetic, abs=1e-12)
    return energies


def test_rescaling_makes_the_kinetic_energy_relax_as_its_equation_says():
    """Mean c K + (1 − c) K̄; variance 2 (1 − c)² K̄²/n + 4 c (1 − c) K K̄/n; after long, the canonical distribution."""
    kinetic, n_dof, kept, target = 3.0, 5, np.exp(-0.2 / 0.5), 0.5 * 5 * 1.3
    energies = rescaled_energies(kinetic, n_dof, 0.2, 5000)
    variance = 2.0 * ((1.0 - kept) * target) ** 2 / n_dof + 4.0 * kept * (1.0 - kept) * kinetic * target / n_dof
    mean, error = kept * kinetic + (1.0 - kept) * target, np.sqrt(variance / energies.size)
    assert energies.mean() == pytest.approx(mean, abs=4.0 * error)  # statistics
    assert energies.var() == pytest.approx(variance, rel=0.1)
    assert stats.kstest(rescaled_energies(3.0, 5, 100.0, 1500) / 1.3, stats.gamma(2.5).cdf).pvalue > 1e-3


def test_rescaling_leaves_the_motion_of_the_whole_alone():
    """n_dof = 3N − 3: the kinetic energy relative to the center is drawn, whatever the momentum, as at rest."""
    rng, masses, drift = np.random.default_rng(3), np.array([1.0, 2.0, 5.0]), np.array([0.3, -2.0, 7.0])
    inner = rng.normal(size=(3, 3))
    inner -= masses @ inner / masses.sum()
    rest, moving, given = state(inner, masses), state(inner + drift, masses), []
    for s in (rest, moving):
        around = in_contact(n_dof=6, conserves_momentum=True)
        BUSSI.thermalize(s, 0.2, around)
        given.append(around.bath.energy)
    gained = 0.5 * masses @ ((rest.velocities**2).sum(axis=1) - (inner**2).sum(axis=1))
    assert np.abs(rest.velocities - inner).max() > 1e-3
    assert moving.velocities - drift == pytest.approx(rest.velocities, abs=1e-13)  # rounding
    assert masses @ moving.velocities == pytest.approx(masses.sum() * drift, rel=1e-14)
    assert given == pytest.approx([gained, gained], rel=1e-12)
    together, around = state(np.full((7, 3), 0.1), np.linspace(1, 2, 7)), in_contact(n_dof=18, conserves_momentum=True)
    BUSSI.thermalize(together, 0.2, around)  # nothing but rounding is left: it is not blown up to a temperature
    assert ((together.velocities == 0.1).all(), around.bath.energy) == (True, 0.0)


def test_single_and_fixed_atoms_keep_all_their_degrees_of_freedom():
    """A momentum that is no constant is thermal: it is rescaled with the rest."""
    moving = [[0.0, 0.0, 0.0], [1.0, 2.0, 3.0]]
    for n, fixed in ((1, None), (2, md.FixedAtoms([0]))):
        system = md.System([[0.0, 0.0, 0.0], [9.0, 0.0, 0.0]][:n], velocities=moving[-n:])
        sim = md.Simulation(system, md.LennardJones(1.0, 1.0, cutoff=2.0), BUSSI, fixed)
        sim.run(1)
        assert (sim.n_dof, abs(sim.velocities[-1, 0] - 1.0) > 1e-3) == (3, True)
        assert sim.velocities[-1] / [1.0, 2.0, 3.0] == pytest.approx(sim.velocities[-1, 0], rel=1e-14)


def test_noise_depends_on_seed_step_and_contact_alone():
    drawn = []
    for step, seed in ((7, 5), (7, 5), (8, 5), (7, 6), (-7, 5)):
        s = state(np.ones((4, 3)), np.ones(4))
        md.LangevinBAOAB(0.01, 1.3, 2.0, seed).thermalize(s, 0.01, in_contact(step=step))
        drawn.append(s.velocities)
    assert (drawn[1] == drawn[0]).all()
    assert (np.array(drawn[2:]) != drawn[0]).all()
    # two contacts in a step have two: free atoms from rest have the variance of one long contact, not a larger one;
    # G. Bussi, M. Parrinello, Phys. Rev. E 75, 056707 (2007)
    substeps = Thermalize(0.5), Kick(0.5), Drift(1.0), Kick(0.5), Thermalize(0.5)
    obabo = type("OBABO", (md.LangevinBAOAB,), {"name": "langevin-obabo", "substeps": substeps})
    s, expected = state(np.zeros((20_000, 3)), np.ones(20_000)), 1.3 * (1.0 - np.exp(-1.0))
    obabo(1.0, 1.3, 0.5, seed=2).advance(s, lambda s, with_energy: None, 1, surroundings=in_contact())
    assert s.velocities.var() == pytest.approx(expected, rel=4.0 * np.sqrt(2.0 / s.velocities.size))  # statistics


def test_configurations_of_an_oscillator_are_exact_at_large_timesteps():
    """ωΔt = 1.5: ⟨q²⟩ = k_B T/k, but ⟨v²⟩ = k_B T/m (1 − (ωΔt)²/4). B. Leimkuhler, C. Matthews (2013)."""
    n, omega, rng, squares = 3000, 1.5, np.random.default_rng(2), []
    method, around = md.LangevinBAOAB(1.0, temperature=1.0, friction=1.0, seed=1), in_contact(n_dof=9000)
    s = State(rng.normal(size=(n, 3)) / omega, rng.normal(size=(n, 3)), np.zeros((n, 3)), np.ones(n))
    springs = lambda s, with_energy: np.multiply(-(omega**2), s.positions, out=s.forces)  # noqa: E731
    for _ in range(60):
        method.advance(s, springs, 5, surroundings=around)
        squares.append([(s.positions**2).mean(), (s.velocities**2).mean()])
    squares = np.array(squares[10:])
    error = squares.std(axis=0, ddof=1) / np.sqrt(len(squares))
    assert error[0] * omega**2 < 0.005
    assert (np.abs(squares.mean(axis=0) - (1.0 / omega**2, 1.0 - omega**2 / 4.0)) < 4.0 * error).all()  # statistics


@pytest.mark.parametrize("kind", THERMOSTATS.values(), ids=list(THERMOSTATS))
def test_temperature_counts_the_degrees_of_freedom_that_the_bath_leaves(kind):
    """Rescaling keeps the momentum, also of a liquid that flows, and Langevin does not promise it."""
    timestep, keeps = 1e-4 if kind.is_overdamped else 0.01, kind.conserves_momentum
    sim = simulation(kind.with_relaxation_time(timestep, 1.3, 0.5, seed=5))
    assert sim.n_dof == 3 * len(sim.system) - 3 * keeps
    record = sim.run(200, every=20)
    assert record.temperature[0] == pytest.approx(1.3, rel=1e-14)
    assert 2.0 * record.kinetic_energy[0] == pytest.approx(1.3 * sim.n_dof, rel=1e-14)
    change = sim.report().momentum_change
    assert change < 1e-13 if keeps else change is None
    assert ("not a constant" in str(sim.report())) is not keeps
    sim.velocities[:] += [3.0, 0.0, -1.0]
    sim.make_steps(100)
    assert (np.abs(sim.velocities.mean(axis=0) - [3.0, 0.0, -1.0]).max() < 1e-12) == keeps  # rounding


@pytest.mark.parametrize("method", [BUSSI, pytest.param(LANGEVIN, marks=pytest.mark.slow)])
def test_total_energy_minus_heat_is_conserved(method, tmp_path):
    """As without a bath, though the bath moves it by a hundred times more; and its file says the same."""
    sim = simulation(type(method)(**{**method.parameters, "timestep": 0.002}))
    sim.equilibrate(500, 1.3)
    record = sim.run(800, every=20, trajectory=tmp_path / "bath.h5md")
    conserved, total = record.conserved_energy, record.total_energy
    assert np.ptp(conserved) < 0.05 * np.ptp(total)
    assert sim.report().energy_is_conserved
    assert total[-1] - conserved[-1] == pytest.approx(sim.reservoir_energy, rel=1e-9)
    checked = check_file(tmp_path / "bath.h5md")
    assert (checked.passed, checked.report.verdict) == (True, sim.report().verdict), str(checked)
    without = simulation(md.VelocityVerlet(0.01))
    without.step = 800
    with pytest.raises(ValueError, match="a thermostat; it cannot be continued with"):
        H5MDWriter.append_to(tmp_path / "bath.h5md", without.engine)


def test_each_equilibration_has_noise_of_its_own_and_the_same_in_each_repetition():
    """Two of them, and one after a run: none meets the noise of another, or that of the run."""
    seen, ends = [], []

    class Noted(md.LangevinBAOAB):
        def thermalize(self, s, duration, around):
            seen.append(around.bath.step)
            super().thermalize(s, duration, around)

    for _ in range(2):
        sim = simulation(Noted(0.01, 1.3, 2.0, 5))
        sim.equilibrate(5, 1.3)
        sim.equilibrate(3, 1.3)
        sim.run(4)
        sim.equilibrate(2, 1.3)
        ends.append(sim.velocities)
    assert seen == 2 * [-5, -4, -3, -2, -1, -8, -7, -6, 0, 1, 2, 3, -10, -9]
    assert (ends[0] == ends[1]).all()


@pytest.fixture(scope="module", params=METHODS)
def runs(request):
    """Two records of liquid argon, 1 ns each, and the degrees of freedom."""
    made, law = [], md.LennardJones(120 * K_B, 3.4, 8.0, "switched")
    constant = md.lattice.constant_from_density("fcc", 1.374 * 0.6022140858549161, 39.948)
    positions, edges = md.lattice.crystal("fcc", (3, 3, 3), constant)
    argon = md.System(positions, masses=39.948, cell=edges, units=md.units.ASE)
    for seed, temperature in enumerate(TEMPERATURES, start=13):
        simulation = md.Simulation(argon, law, METHODS[request.param](temperature, seed), threads=1)
        simulation.set_temperature(2 * temperature, seed=seed)
        simulation.run(25_000, every=25_000)
        made.append(simulation.run(250_000, every=EVERY))
    assert "is conserved" in simulation.report().verdict
    return made, simulation.n_dof


def data_of(record, temperature, n_dof):
    """The same for physical_validation."""
    data, factors = pytest.importorskip("physical_validation").data, CONVERSIONS | {"time": 1e-3 / FS}
    atoms = {"mass": np.full(108, 39.948), "molecule_idx": np.arange(108), "nconstraints_per_molecule": np.zeros(108)}
    freedom = {"nconstraints": 0, "ndof_reduction_tra": 324 - n_dof, "ndof_reduction_rot": 0}
    return data.SimulationData(
        units=data.UnitData(kb=K_B, **{f"{name}_conversion": factor for name, factor in factors.items()}),
        dt=EVERY * 4 * FS,
        system=data.SystemData(natoms=108, **freedom, **atoms),
        ensemble=data.EnsembleData("NVT", natoms=108, volume=1.0, temperature=temperature),
        observables=data.ObservableData(record.kinetic_energy, record.potential_energy, record.total_energy),
    )


@pytest.mark.slow
def test_kinetic_energies_are_those_of_the_canonical_ensemble(runs):
    """Mean and width of the gamma distribution, n_dof/2 and k_B T, within three standard errors."""
    judged, (records, n_dof) = pytest.importorskip("physical_validation").kinetic_energy.distribution, runs
    for record, temperature in zip(records, TEMPERATURES, strict=True):
        both = (data_of(record, t, n_dof) for t in (temperature, 1.02 * temperature))
        right, wrong = (judged(data, verbosity=0, bootstrap_seed=1) for data in both)
        assert np.abs(right).max() < SIGMAS
        assert wrong[0] > SIGMAS  # it would see two percent


@pytest.mark.slow
def test_potential_energies_at_two_temperatures_differ_by_the_boltzmann_factor(runs):
    """The ratio of their distributions is exp(−(1/k_B T₂ − 1/k_B T₁) U), within three standard errors."""
    judged, (records, n_dof) = pytest.importorskip("physical_validation").ensemble.check, runs

    def off(*temperatures):
        data = (data_of(record, temperature, n_dof) for record, temperature in zip(records, temperatures, strict=True))
        return judged(*data, verbosity=0, bootstrap_seed=1)[0]

    assert off(*TEMPERATURES) < SIGMAS
    assert off(TEMPERATURES[0], TEMPERATURES[0] + 0.1) > SIGMAS  # it would see that the temperatures differ


@pytest.mark.slow
def test_kinetic_energies_are_gamma_distributed(runs):
    """Our own test, of frames far enough apart: Kolmogorov-Smirnov beside Γ(n_dof/2, k_B T)."""
    records, n_dof = runs
    for record, temperature in zip(records, TEMPERATURES, strict=True):
        right, wrong = (stats.gamma(0.5 * n_dof, scale=factor * K_B * temperature).cdf for factor in (1.0, 1.03))
        assert stats.kstest(record.kinetic_energy[::20], right).pvalue > 1e-3
        assert stats.kstest(record.kinetic_energy[::20], wrong).pvalue < 1e-3  # it would see three percent


def test_a_barostat_and_a_bath_with_one_seed_have_independent_noise():
    """Before, the strain of a step had the noise of atom 1 in the next one."""
    seed, step = 7, 40
    barostat = md.StochasticCellRescaling(1.0, 1.0, 1.0, seed, temperature=1.0, coupling="xyz")
    strain = barostat.strain(ThermodynamicState(np.eye(3), 1.0, 1.0, 1.0, 1.0), 1.0, step).diagonal()
    free = md.Restraint(k=0.0, points=np.zeros((6, 3)))
    bath = md.LangevinBAOAB(1.0, 1.0, 1e3, seed)  # a step forgets all velocities
    sim = md.Simulation(md.System(np.zeros((6, 3))), free, bath, threads=1)
    sim.step = step
    sim.make_steps(1)
    ratios = strain / np.sqrt(2.0 / 3.0) / sim.velocities
    assert np.abs(ratios - 1.0).min() > 1e-6
