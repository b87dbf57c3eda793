"""Runs with a bath sample the canonical ensemble. P. T. Merz, M. R. Shirts, PLOS ONE 13, e0202764 (2018)."""

import numpy as np
import pytest
from scipy import stats

import minimd as md

pytestmark = pytest.mark.slow
K_B, FS = md.units.ASE.k_B, md.units.fs
METHODS = {
    "langevin": lambda t, seed: md.LangevinBAOAB(4 * FS, t, friction=1 / (500 * FS), seed=seed),
    "rescaling": lambda t, seed: md.StochasticVelocityRescaling(4 * FS, t, relaxation_time=200 * FS, seed=seed),
}
TEMPERATURES = (94.4, 100.0)  # K; the potential energies of 108 atoms overlap well
EVERY, SIGMAS = 25, 3.0
CONVERSIONS = {"energy": 96.485, "length": 0.1, "volume": 1e-3, "temperature": 1.0, "pressure": 1.602e6}


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


def test_kinetic_energies_are_those_of_the_canonical_ensemble(runs):
    """Mean and width of the gamma distribution, n_dof/2 and k_B T, within three standard errors."""
    judged, (records, n_dof) = pytest.importorskip("physical_validation").kinetic_energy.distribution, runs
    for record, temperature in zip(records, TEMPERATURES, strict=True):
        both = (data_of(record, t, n_dof) for t in (temperature, 1.02 * temperature))
        right, wrong = (judged(data, verbosity=0, bootstrap_seed=1) for data in both)
        assert np.abs(right).max() < SIGMAS
        assert wrong[0] > SIGMAS  # it would see two percent


def test_potential_energies_at_two_temperatures_differ_by_the_boltzmann_factor(runs):
    """The ratio of their distributions is exp(−(1/k_B T₂ − 1/k_B T₁) U), within three standard errors."""
    judged, (records, n_dof) = pytest.importorskip("physical_validation").ensemble.check, runs

    def off(*temperatures):
        data = (data_of(record, temperature, n_dof) for record, temperature in zip(records, temperatures, strict=True))
        return judged(*data, verbosity=0, bootstrap_seed=1)[0]

    assert off(*TEMPERATURES) < SIGMAS
    assert off(TEMPERATURES[0], TEMPERATURES[0] + 0.1) > SIGMAS  # it would see that the temperatures differ


def test_kinetic_energies_are_gamma_distributed(runs):
    """Our own test, of frames far enough apart: Kolmogorov-Smirnov beside Γ(n_dof/2, k_B T)."""
    records, n_dof = runs
    for record, temperature in zip(records, TEMPERATURES, strict=True):
        right, wrong = (stats.gamma(0.5 * n_dof, scale=factor * K_B * temperature).cdf for factor in (1.0, 1.03))
        assert stats.kstest(record.kinetic_energy[::20], right).pvalue > 1e-3
        assert stats.kstest(record.kinetic_energy[::20], wrong).pvalue < 1e-3  # it would see three percent
