"""Thermostats for ASE's scripts: the distributions of ASE, any rng, changing parameters, blocks of any size."""

from types import SimpleNamespace

import ase.units
import numpy as np
import pytest
from argon_atoms import TIMESTEP, liquid, same
from ase import Atoms
from ase.constraints import FixCom

import minimd as md
import minimd.ase as ours
from minimd.ase.baths import Chain

pytestmark = pytest.mark.filterwarnings("ignore:The implementation of `fixcm=True`")
N, KELVIN, NO_FORCES = 50, 300.0, md.LennardJones(0.0, 3.4, 20.0)
FAST = 2.0 / TIMESTEP  # a rate: after some steps nothing is left of the past
NOISY = {
    "Langevin": {"temperature_K": KELVIN, "friction": FAST, "fixcm": False},
    "LangevinBAOAB": {"temperature_K": KELVIN, "T_tau": 1.0 / FAST},
    "Andersen": {"temperature_K": KELVIN, "andersen_prob": 0.9, "fixcm": False},
    "Bussi": {"temperature_K": KELVIN, "taut": 1.0 / FAST},
}
CANONICAL = [  # class, arguments, number of atoms, whether their center is held, samples, steps between them
    ("Bussi", {}, N, False, 400, 1), ("Langevin", {}, N, True, 400, 1),
    *(pytest.param(name, {}, N, False, 400, 1, marks=pytest.mark.slow) for name in NOISY if name != "Bussi"),
    *(pytest.param(name, {}, N, True, 400, 1, marks=pytest.mark.slow) for name in ("LangevinBAOAB", "Andersen")),
    pytest.param("Andersen", {"andersen_prob": 0.3}, 4, True, 600, 4, marks=pytest.mark.slow),  # rare collisions
]  # fmt: skip
DRIVES = (
    lambda dynamics: dynamics.run(6),
    lambda dynamics: list(dynamics.irun(6)),
    lambda dynamics: [dynamics.step() for _ in range(6)],
    lambda dynamics: [dynamics.run(2), dynamics.atoms.set_pbc([1, 1, 0]), dynamics.run(3), dynamics.run(1)],
    lambda dynamics: [dynamics.step(), dynamics.step(), dynamics.atoms.set_pbc([1, 1, 0]), dynamics.run(4)],
)


def gas(n=N, held=False):
    rng = np.random.default_rng(5)
    positions = rng.uniform(0.0, 50.0, (n, 3))
    symbols = "Ar" * (n // 2) + "He" * (n - n // 2)
    atoms = Atoms(symbols, positions, cell=[50.0] * 3, pbc=True, calculator=ours.Calculator(NO_FORCES))
    atoms.set_constraint(FixCom() if held else None)
    atoms.set_momenta(rng.normal(0.5, 1.0, (n, 3)))
    return atoms


def made(name, atoms, rng=1, **options):
    return getattr(ours, name)(atoms, TIMESTEP, rng=rng, **NOISY[name] | options)


def temperatures(dynamics, n=400, apart=1):
    dynamics.run(20)
    seen = []
    dynamics.attach(lambda: seen.append(dynamics.atoms.get_temperature()), apart)
    dynamics.run(n * apart)
    return np.array(seen[-n:])


@pytest.mark.parametrize(("name", "options", "n", "is_held", "samples", "apart"), CANONICAL)
def test_the_kinetic_energy_of_all_degrees_of_freedom_is_canonical(name, options, n, is_held, samples, apart):
    """Mean and variance of the kinetic temperature; successive values have correlations of at most 0.25, hence 1.3."""
    atoms = gas(n, is_held)
    center, n_dof = atoms.get_center_of_mass(), 3 * n - 3 * is_held
    sample = temperatures(made(name, atoms, **options), samples, apart)
    error = 4.0 * 1.3 * np.sqrt(2.0 / samples)  # statistics
    assert sample.mean() == pytest.approx(KELVIN, rel=error / np.sqrt(n_dof))
    assert sample.var() == pytest.approx(2.0 * KELVIN**2 / n_dof, rel=error)
    momentum = np.abs(atoms.get_momenta().sum(axis=0)).max()
    assert momentum < 1e-10 if is_held else momentum > 1e-3
    assert not is_held or np.abs(atoms.get_center_of_mass() - center).max() < 1e-10


def test_fixcm_leaves_the_center_alone_and_gives_ases_thermometer_the_temperature():
    atoms = gas(4)
    momentum = atoms.get_momenta().sum(axis=0)
    of_center = momentum @ momentum / (12.0 * atoms.get_masses().sum() * ase.units.kB)  # on the thermometer [K]
    sample = temperatures(made("Langevin", atoms, fixcm=True), 300) - of_center
    assert same(atoms.get_momenta().sum(axis=0), momentum, 1e-10)
    error = 4.0 * 1.3 * KELVIN * np.sqrt(2.0 / 9.0 / len(sample))  # 9 degrees, 12 on the thermometer
    assert sample.mean() == pytest.approx(KELVIN, abs=error)


def test_each_atom_may_have_its_own_temperature_and_friction():
    atoms = gas(400)
    kelvin, friction = np.repeat([100.0, 900.0], 200)[:, None], np.repeat([0.0, FAST], 200)[:, None]
    cold = atoms[:200].get_kinetic_energy()
    made("Langevin", atoms, temperature_K=kelvin, friction=friction).run(20)
    assert atoms[:200].get_kinetic_energy() == pytest.approx(cold, rel=1e-12)  # no friction, no bath
    assert atoms[200:].get_temperature() == pytest.approx(900.0, rel=4.0 * np.sqrt(2.0 / 600))


def end_of(name, rng, drive=lambda dynamics: dynamics.run(6)):
    atoms = gas(6)
    drive(made(name, atoms, rng))
    return atoms.get_momenta()


@pytest.mark.parametrize("name", NOISY)
def test_equal_seeds_make_equal_runs_in_blocks_of_any_size_and_others_do_not(name):
    for kind in (int, np.random.RandomState, np.random.default_rng, np.random.SeedSequence):
        first = end_of(name, kind(7))
        assert np.array_equal(first, end_of(name, kind(7)))
        assert not same(first, end_of(name, kind(8)), 1e-3)
    rng = np.random.default_rng(3)
    assert not same(end_of(name, rng), end_of(name, rng), 1e-3)
    first, second = (np.random.seed(seed) or end_of("Langevin", None) for seed in (1, 2))
    assert not same(first, second, 1e-3)
    first, *others = (end_of(name, 5, drive) for drive in DRIVES)
    assert all(same(other, first, 1e-12) for other in others)  # one run, with noise that never returns


def test_all_processes_of_a_parallel_calculator_have_the_noise_of_the_first():
    comm = SimpleNamespace(rank=1, size=2, broadcast=lambda array, root: array.fill(0.25))
    seeds = [made("Langevin", gas(), rng, comm=comm).noise_seed() for rng in (1, 2)]
    assert seeds[0] == seeds[1]


@pytest.mark.parametrize("name", ["Langevin", "LangevinBAOAB", "Andersen"])
def test_a_temperature_set_at_every_step_is_that_of_the_next(name):
    atoms, seen = gas(500), []
    dynamics = made(name, atoms)
    dynamics.attach(lambda: seen.append(atoms.get_temperature()), 1)
    dynamics.attach(lambda: dynamics.set_temperature(temperature_K=100.0 + 10.0 * dynamics.nsteps), 1)
    dynamics.run(60)
    assert np.mean(seen[30:60] / (100.0 + 10.0 * (np.arange(30, 60) - 1.5))) == pytest.approx(1.0, abs=0.05)


def test_friction_time_step_and_target_that_are_set_take_effect():
    atoms, reference = liquid(), liquid()
    mine = ours.Langevin(atoms, TIMESTEP, temperature_K=90.0, friction=0.01, fixcm=False, rng=1)
    mine.set_friction(0.0)
    mine.set_timestep(0.5 * TIMESTEP)
    mine.run(10)
    ours.VelocityVerlet(reference, 0.5 * TIMESTEP).run(10)
    assert same(atoms.positions, reference.positions)
    bussi = made("Bussi", gas(500))
    bussi.run(1)
    bussi.target_kinetic_energy *= 3.0
    assert bussi.temp == pytest.approx(3.0 * KELVIN * ase.units.kB)
    bussi.run(20)
    assert bussi.atoms.get_temperature() == pytest.approx(3.0 * KELVIN, rel=4.0 * np.sqrt(2.0 / 1500))


def test_a_chain_goes_back_with_a_block_that_is_made_again():
    chain = Chain(0.03, 12, 0.5, 3, 1)
    states = {}
    for step in (0, 1, 2, 3, 1, 2):
        chain.begin(step)
        states.setdefault(step, (chain.eta.copy(), chain.p.copy()))
        assert states[step] == (chain.eta, chain.p)
        chain.advance(0.5, 0.05)
    chain.advance(0.7, 0.05)  # another way than the first time
    end = chain.p.copy()
    chain.begin(3)
    assert chain.p == end
