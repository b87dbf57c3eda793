"""Observers of a run have the answers of slow twins of theirs; a run that was cut goes on to the same answers."""

import copy
import json
import pickle
import re
import warnings
from dataclasses import dataclass
from importlib.util import find_spec

import h5py
import numpy as np
import pytest
from references import melt_scene, pressures_in_layers, processes
from scenes import LJ, argon, chain
from wrong_calls import answered, assert_answered

import minimd as md
from minimd.core.files.h5md_digest import observers_of, read_restart
from minimd.core.structure.checks import checked_count
from minimd.core.structure.statistics import FEWEST, with_error
from minimd.core.structure.system import changed
from minimd.observers.accumulator import Accumulator, BlockedSums, ObservedRun, Result, Series
from minimd.observers.arguments import argument, label, positive, steps
from minimd.observers.fluctuations import lengths
from minimd.observers.profile import limits
from minimd.scene import parse_scene, resume_run, run_scene
from minimd.view.check import check_file
from minimd.view.plot import plot_file

DISPLACEMENT, VELOCITY = "mean-square-displacement", "velocity-autocorrelation"
NONE = md.LennardJones(1e-12, 1e-3, 0.1, "force-shifted")  # next to no forces
EVERY = {"radial-distribution": 10, DISPLACEMENT: 2, VELOCITY: 2, "viscosity": 5, "fluctuations": 5, "profile": 10,
         "thermal-conductivity": 5, "surface-tension": 5, "pressure-profile": 5, "structure-factor": 10,
         "self-scattering": 2}  # fmt: skip
OF_MOLECULES = {"chain-shape": 2, "dielectric-constant": 2}
OF_IONS = {"conductivity": 2}
CHARGES = np.random.default_rng(7).normal(size=108)


def simulation(**options):
    atoms, masses, kinds = argon().system, np.resize([2.0, 1.0, 1.0], 108), np.resize(["B", "A", "A"], 108)
    given = {"masses": masses, "velocities": atoms.velocities, "cell": atoms.cell, "species": kinds}
    return md.Simulation(md.System(atoms.positions, **given), LJ, md.VelocityVerlet(0.004), **options)


def molecules():
    """The same atoms, three of them joined to a molecule without net charge; their forces are the same."""
    sim = simulation()
    pairs = np.concatenate([[[k, k + 1], [k + 1, k + 2]] for k in range(0, 108, 3)])
    return md.Simulation(changed(sim.system, bonds=pairs, charges={"B": 1.0, "A": -0.5}), LJ, sim.method)


def ions():
    """The same molecules, each with a charge of its own."""
    sim = molecules()
    return md.Simulation(changed(sim.system, charges=CHARGES), LJ, sim.method)


HERE = [kind for kind in md.observers.KINDS if kind != "bond-order" or find_spec("freud")]
OTHERS = {molecules: OF_MOLECULES, ions: OF_IONS}


def several(scene=simulation):
    return [md.observers.KINDS[kind](every=every) for kind, every in OTHERS.get(scene, EVERY).items()]


class Run:
    """A run of which all positions and velocities are kept, (T, N, 3), at every second step, as observers see it."""

    def __init__(self):
        self.sim, kept = simulation(), []
        with_orders = {"bond-order": {"order": "q2"}}
        self.looking = {
            kind: of(every=2, **with_orders.get(kind, {})) for kind, of in md.observers.KINDS.items() if kind in HERE
        }
        of_others = {scene: [self.looking[kind] for kind in kinds] for scene, kinds in OTHERS.items()}
        of_atoms = [one for kind, one in self.looking.items() if kind not in {*OF_MOLECULES, *OF_IONS}]
        keep = [lambda sim: kept.append([sim.positions.copy(), sim.velocities.copy()]), *of_atoms]
        self.record = self.sim.run(100, every=2, observers=keep)
        for scene, looking in of_others.items():
            scene().run(100, every=2, observers=looking)
        self.positions, self.velocities = np.array(kept).swapaxes(0, 1)
        self.species, self.masses = self.sim.system.species_index, self.sim.system.masses
        self.edges, self.n_dof = np.diag(self.sim.system.cell.vectors), 3 * len(self.species) - 3
        self.moved, self.thermal = map(self.relative, (self.positions, self.velocities))

    def relative(self, series):
        return series - np.average(series, axis=1, weights=self.masses)[:, None]


@pytest.fixture(scope="module")
def run():
    return Run()


def correlated(run, series, law):
    lags, means = np.array([*range(16), *range(16, 32, 2), *range(32, 51, 4)]), []
    for lag in lags:
        stride = 1 if lag < 16 else 2 if lag < 32 else 4
        chosen = series[::stride]
        of_atoms = law(chosen[: len(chosen) - lag // stride], chosen[lag // stride :]).mean(axis=0)
        kinds = (of_atoms[run.species == s].sum(axis=1).mean() for s in (0, 1))
        means.append([of_atoms.sum(axis=1).mean(), *kinds, *of_atoms.mean(axis=0)])
    return {"times": 0.008 * lags, "means": np.transpose(means)}


def pair_counts(run):
    pairs, bins = np.triu_indices(len(run.species), 1), np.linspace(0.0, run.edges[0] / 2.0, 201)
    kinds, vectors = run.species[np.array(pairs)].sum(axis=0), run.positions[:, pairs[1]] - run.positions[:, pairs[0]]
    distances = np.linalg.norm(vectors - run.edges * np.rint(vectors / run.edges), axis=2)
    counts = [np.histogram(distances[:, kinds == k], bins)[0] / (kinds == k).sum() for k in range(3)]
    shells = 4.0 / 3.0 * np.pi * np.diff(bins**3)
    assert run.looking["radial-distribution"].result().pairs == ("A-A", "A-B", "B-B")
    g = np.array(counts) / len(distances) * run.edges.prod() / shells
    return {"r": 0.5 * (bins[1:] + bins[:-1]), "g_of_pairs": g}


def integrated(series, divisor, weight):
    """Autocorrelation on the first level, and on one of means of two entries; and its integral times a weight."""
    expected = []
    for level, lags in ((series, range(32)), (0.5 * (series[:50:2] + series[1:50:2]), range(16, 25))):
        expected += [(level[lag:] * level[: len(level) - lag]).sum(axis=1).mean() / divisor for lag in lags]
    times, means = 0.008 * np.array([*range(32), *range(32, 50, 2)]), 0.5 * (np.array(expected[1:]) + expected[:-1])
    integral = np.concatenate([[0.0], np.cumsum(means * np.diff(times))])
    return {"times": times, "autocorrelation": expected, "integral": weight * integral}


def currents(run):
    """The charge of each molecule, times the velocity of its center."""
    velocities = run.thermal.reshape(len(run.thermal), 36, 3, 3).swapaxes(2, 3) @ np.array([0.5, 0.25, 0.25])
    currents = np.einsum("m,tmc->tc", CHARGES.reshape(36, 3).sum(axis=1), velocities)
    return integrated(currents, 3.0, 1.0 / (run.edges.prod() * run.record.temperature.mean()))


def stresses(run):
    series, made = [], run.sim.system.copy()
    for positions, velocities in zip(run.positions, run.thermal, strict=True):
        made.positions[:] = positions
        virial = md.evaluate(made, run.sim.potentials).virial
        pressure = ((run.masses[:, None] * velocities).T @ velocities + virial) / made.volume
        series.append(0.5 * (pressure + pressure.T) - np.eye(3) * np.trace(pressure) / 3.0)
    return integrated(np.reshape(series, (-1, 9)), 10.0, made.volume / run.record.temperature.mean())


def hexatics(run):
    """q_2 by the second Legendre polynomial of the angles between bonds."""
    made, found = run.sim.system.copy(), []
    for positions in run.positions:
        made.positions[:] = positions
        i, bonds = md.neighbor_list("iD", made, 1.4 * (made.volume / 108) ** (1.0 / 3.0))
        units = bonds / np.linalg.norm(bonds, axis=1, keepdims=True)
        each = [np.mean(1.5 * (one @ one.T) ** 2 - 0.5) ** 0.5 for one in (units[i == k] for k in range(108))]
        found.append(np.mean(each))
    return {"q2": np.mean(found)}


def heat(run):
    """Of the energy, of the mass of the atoms A, and of both together: two kinds of particles."""
    fluxes, made = [], run.sim.system.copy()
    for positions, velocities in zip(run.positions, run.thermal, strict=True):
        made.positions[:] = positions
        sums = md.evaluate(made, run.sim.potentials)
        tensors = sums.virials[:, [[0, 5, 4], [5, 1, 3], [4, 3, 2]]]
        energies = sums.energies + 0.5 * run.masses * (velocities**2).sum(axis=1)
        energy = energies @ velocities + np.einsum("nab,nb->a", tensors, velocities)
        mass = run.masses[run.species == 1] @ velocities[run.species == 1]
        fluxes.append([energy, mass, energy + mass])
    weight = 1.0 / (run.edges.prod() * run.record.temperature.mean() ** 2)
    energy, mass, both = (integrated(series, 3.0, weight) for series in np.array(fluxes).swapaxes(0, 1))
    cross = 0.5 * (both["integral"] - energy["integral"] - mass["integral"])
    with np.errstate(invalid="ignore"):
        less = np.nan_to_num(cross**2 / mass["integral"])
    return energy | {"integral": energy["integral"] - less}


def grown(looking):
    """Factors for deviations of K, E and V, so that their variances contain the part that is missing in a short run."""
    return np.sqrt(1.0 + 2.0 / np.fmax(FEWEST, np.nan_to_num(lengths(looking.sums), nan=np.inf)))


def tension(run):
    values = []
    made = run.sim.system.copy()
    for positions, velocities in zip(run.positions, run.thermal, strict=True):
        made.positions[:] = positions
        virial = md.evaluate(made, run.sim.potentials).virial
        x, y, z = np.diag((run.masses[:, None] * velocities).T @ velocities + virial) / made.volume
        values.append([0.5 * run.edges[2] * (z - 0.5 * (x + y)), z])
    return {"values": np.mean(values, axis=0)}


def heat_capacity(run):
    temperatures = run.record.temperature
    kinetic = 0.5 * run.n_dof * temperatures * grown(run.looking["fluctuations"])[0]
    return {"heat_capacity_v": 0.5 * run.n_dof / (1.0 - 2.0 * kinetic.var() / (run.n_dof * temperatures.mean() ** 2))}


def layers(run):
    z, edges, volume = run.positions[:, :, 2] % run.edges[2], np.linspace(0.0, run.edges[2], 101), run.edges.prod()
    in_layers = lambda numbers: np.histogram(z, edges, weights=numbers + 0.0 * z)[0]  # noqa: E731
    counts = np.array([in_layers(run.species == s) for s in (0, 1)])
    with np.errstate(invalid="ignore"):
        masses, shares = in_layers(run.masses), in_layers(3.0 - 3.0 * run.masses / run.masses.sum())
        flow = np.array([in_layers(along) for along in run.masses * run.thermal.T.swapaxes(1, 2)]) / masses
        heat = (in_layers(run.masses * (run.thermal**2).sum(axis=2)) - masses * (flow**2).sum(axis=0)) / shares
    return {"densities": counts / len(z) / (volume / 100), "temperature": heat, "flow": flow}


def scattered(run):
    """|Σ exp(i q r)|² / N, in shells of whole wave vectors."""
    looking = run.looking["structure-factor"]
    waves, q_max = 2.0 * np.pi * np.array(looking.waves) / run.edges, looking.result().q[-1] * 1.01
    lengths, width = np.linalg.norm(waves, axis=1), 3.0 * 1.15 * 2.0 * np.pi * 0.8442 ** (1.0 / 3.0) / 80
    assert len(np.unique(np.round(waves, 9), axis=0)) == len(waves) > 200
    assert q_max > lengths.max() > lengths.min() == pytest.approx(2.0 * np.pi / run.edges[0])
    squares = np.abs(np.exp(1j * run.positions @ waves.T).sum(axis=1)) ** 2 / len(run.species)
    shells = [np.floor(lengths / width) == k for k in np.unique(np.floor(lengths / width))]
    return {"q": [lengths[one].mean() for one in shells], "s": [squares[:, one].mean() for one in shells]}


def scattered_by_each(run):
    q = np.array(run.looking["self-scattering"].q_vectors)
    whole = q * run.edges / (2.0 * np.pi)
    np.testing.assert_allclose(whole, np.rint(whole), atol=1e-12)
    found = correlated(run, run.moved, lambda a, b: np.cos((b - a) @ q.T) / len(q))
    return {"times": found["times"], "means": found["means"][:3], "q": np.linalg.norm(q, axis=1).mean()}


def whole(run):
    """(T, 36, 3, 3) atoms B, A, A of molecules, whose bonds are shorter than half the cell, from the first one."""
    bonds = np.diff(run.positions.reshape(len(run.positions), 36, 3, 3), axis=2)
    bonds -= run.edges * np.rint(bonds / run.edges)
    return np.concatenate([0.0 * bonds[:, :, :1], np.cumsum(bonds, axis=2)], axis=2)


def dipoles(run):
    moments = np.array([1.0, -0.5, -0.5]) @ whole(run)
    looking = run.looking["dielectric-constant"]
    variance = moments.sum(axis=1).var(axis=0).sum() * (1.0 + 2.0 / max(FEWEST, looking._correlation_times()))
    strength = 4.0 * np.pi / (3.0 * run.edges.prod() * run.record.temperature.mean())
    return {"values": [1.0 + strength * variance]}


def sizes(run):
    """Eigenvalues are the roots of characteristic equations."""
    atoms = whole(run).reshape(-1, 3, 3)
    shares = np.array([2.0, 1.0, 1.0]) / 4.0
    expected = []
    for molecule in atoms:
        inner = molecule - shares @ molecule
        tensor = sum(share * np.outer(row, row) for share, row in zip(shares, inner, strict=True))
        minors = np.trace(tensor) ** 2 - np.trace(tensor @ tensor)
        roots = np.sort(np.roots([1.0, -np.trace(tensor), 0.5 * minors, -np.linalg.det(tensor)]).real)
        size = roots.sum()
        along = np.square(molecule[2] - molecule[0]).sum()
        expected.append([size, roots[2] - roots[:2].mean(), 1.0 - 1.5 * minors / size**2, along])
    return {"values": np.mean(expected, axis=0)}


TWINS = {  # expected attributes of the result
    DISPLACEMENT: lambda run: correlated(run, run.moved, lambda a, b: (b - a) ** 2),
    VELOCITY: lambda run: correlated(run, run.thermal, lambda a, b: a * b), "radial-distribution": pair_counts,
    "viscosity": stresses, "fluctuations": heat_capacity, "profile": layers,
    "structure-factor": scattered, "self-scattering": scattered_by_each, "chain-shape": sizes,
    "dielectric-constant": dipoles, "conductivity": currents, "thermal-conductivity": heat, "bond-order": hexatics,
    "surface-tension": tension, "pressure-profile": pressures_in_layers,
}  # fmt: skip


@pytest.mark.parametrize("kind", HERE)
def test_an_observer_has_the_result_of_its_slow_twin(kind, run):
    result = run.looking[kind].result()
    for name, expected in TWINS[kind](run).items():
        rtol = 1e-6 if kind == "bond-order" else 1e-9  # rounding, of float32 and float64
        np.testing.assert_allclose(getattr(result, name), expected, rtol=rtol, atol=1e-12, err_msg=name)


@pytest.mark.parametrize("kind", HERE)
def test_a_copy_of_an_observer_has_its_result(kind, run):
    copies = copy.deepcopy(run.looking[kind]), pickle.loads(pickle.dumps(run.looking[kind]))
    assert {str(one.result()) for one in copies} == {str(run.looking[kind].result())}


def test_of_molecules_atoms_of_each_species_are_chosen():
    """Of B, A, A, B, … each third is B: a stride of 3 over all atoms would choose no A."""
    kinds, sim = (md.observers.MeanSquareDisplacement, md.observers.SelfScattering), simulation()
    few, before = [kind(every=1, most_atoms=36) for kind in kinds], sim.positions.copy()
    sim.run(1, observers=few)
    moved = sim.positions - before
    squares = ((moved - np.average(moved, axis=0, weights=sim.system.masses))[few[0].chosen] ** 2).sum(axis=1)
    expected = squares.mean(), squares[:24].mean(), squares[24:].mean()
    np.testing.assert_allclose(few[0].result().means[:3, 1], expected, rtol=1e-9)  # rounding
    np.testing.assert_allclose(few[1].result().means[:, 0], 1.0)


def test_an_ideal_gas_scatters_as_theory_says(monkeypatch):
    """S(q) = 1, and F_s = ⟨cos q·v t⟩ at every lag, which is exp(−q² k_B T t²/2m) but for the number of atoms."""
    monkeypatch.setattr("minimd.observers.scattering.TABLE", 3000)
    n_atoms, thermal, mass, rng = 1000, 1.5, 2.0, np.random.default_rng(3)
    velocities = rng.normal(0.0, np.sqrt(thermal / mass), (n_atoms, 3))
    velocities -= velocities.mean(axis=0)
    cell = 10.0 * np.array([[1.0, 0.0, 0.0], [0.3, 1.0, 0.0], [0.0, -0.4, 1.1]])
    system = md.System(rng.random((n_atoms, 3)) @ cell, velocities=velocities, masses=mass, cell=cell)
    sim = md.Simulation(system, NONE, md.VelocityVerlet(0.02))
    whole, each = md.observers.StructureFactor(q_max=12.0, every=25), md.observers.SelfScattering(q=2.0, every=1)
    once = md.observers.StructureFactor(q_max=2.0, n_bins=1, n_waves=40, every=1)
    for one in (whole, each, once):
        one.prepare(sim.engine)
    once.observe(sim.engine)
    waves = 2.0 * np.pi * np.array(once.waves) @ np.linalg.inv(cell).T
    squares = np.abs(np.exp(1j * sim.positions @ waves.T).sum(axis=0)) ** 2 / n_atoms
    assert once.result().s == pytest.approx([squares.mean()], rel=1e-9)  # rounding
    assert once.result().q == pytest.approx([np.linalg.norm(waves, axis=1).mean()])
    for step in range(1500):
        each.observe(sim.engine)
        if step % 25 == 0:
            whole.observe(sim.engine)
        sim.engine.count(1)
        sim.positions[:] += 0.02 * velocities
    result, q = each.result(), np.array(each.q_vectors)
    exact = [np.cos(velocities @ q.T * time).mean() for time in result.times]
    np.testing.assert_allclose(result.means[0], exact, rtol=1e-9, atol=1e-11)
    assert result.q == pytest.approx(2.0, rel=0.05)
    np.testing.assert_allclose(q @ cell.T / (2.0 * np.pi), np.rint(q @ cell.T / (2.0 * np.pi)), atol=1e-12)
    gaussian = np.exp(-0.5 * result.q**2 * thermal / mass * result.times**2)
    np.testing.assert_allclose(result.means[0], gaussian, atol=4.0 * np.sqrt(0.5 / n_atoms))  # statistics
    assert result.relaxation_time == pytest.approx(np.sqrt(2.0 * mass / thermal) / result.q, rel=0.05)
    structure = whole.result()
    assert structure.s.mean() == pytest.approx(1.0, abs=4.0 / np.sqrt(60 * len(whole.waves)))  # statistics
    assert np.abs((structure.s - 1.0) / structure.error).mean() < 1.5  # of a normal distribution 0.8


def test_lags_beyond_half_of_the_run_have_no_error_bar(run):
    """Few blocks contain them; what these tell of each other is far less than the error."""
    for kind, name in (("viscosity", "autocorrelation"), ("viscosity", "integral"), (DISPLACEMENT, "msd")):
        columns = run.looking[kind].result().columns()
        is_known, times = np.isfinite(columns[f"{name}_error"]), columns["time"]
        assert (is_known[times > 0.2].any(), is_known[times <= 0.1].all()) == (False, True)


def test_a_diffusion_coefficient_without_an_error_bar_has_two_digits(run):
    looking = run.looking[DISPLACEMENT]
    end = looking.result().times[-1]
    for window, is_known in (((0.02, 0.1), True), ((0.5 * end, end), False)):
        result = looking.result(window=window)
        number = re.search(r"D = ([\d.e+-]+)", str(result))[1]
        assert np.isfinite(result.diffusion_error) == is_known
        assert is_known or number == f"{result.diffusion:.2g}"
        assert "nan" not in str(result)


def test_the_correction_of_yeh_and_hummer(run):
    looking, window = run.looking[DISPLACEMENT], (0.1, 0.3)
    result = looking.result(window=window, viscosity=2.0)
    expected = 2.837297 * result.temperature / (6.0 * np.pi * 2.0 * run.edges[0])
    assert result.infinite - result.diffusion == pytest.approx(expected, rel=1e-12)
    assert result.diffusion == looking.result(window=window).diffusion
    eta, added = run.looking["viscosity"].result(), result.infinite - result.diffusion
    both = looking.result(window=window, viscosity=eta)  # the correction goes as 1/η
    assert both.infinite - both.diffusion == pytest.approx(added * 2.0 / eta.viscosity)
    of_viscosity = added * 2.0 / eta.viscosity**2 * eta.viscosity_error
    assert both.infinite_error == pytest.approx(np.hypot(both.diffusion_error, of_viscosity))
    wrong = {"0.101": (0.1, 0.101), "(0.2, 0.1)": (0.2, 0.1), "'early'": "early", "= 0.1": 0.1, "None": (0.1, None)}
    for shown, value in wrong.items():
        assert_answered(lambda value=value: looking.result(window=value), ValueError, "window", shown)


def test_fluctuations_at_constant_pressure_are_those_of_the_record():
    """T and P₀ are those of the barostat, with a thermostat and without: C_P, κ_T and α_P from energies and volumes."""
    thermal, pressure = 0.9, 1.5
    bath = md.StochasticCellRescaling(pressure, 0.05, 0.5, seed=1, temperature=thermal, every=5)
    for method in (md.VelocityVerlet(0.004), md.StochasticVelocityRescaling(0.004, thermal, 0.1, 3)):
        looking, sim = md.observers.Fluctuations(every=5), simulation(barostat=bath)
        sim.method = method
        record = sim.run(100, every=5, observers=[looking], progress=False)
        _, of_energy, of_volume = grown(looking)
        result, volume, mean = looking.result(), record.volume * of_volume, record.volume.mean()
        enthalpy = record.total_energy * of_energy + pressure * volume
        joint = np.mean((volume - volume.mean()) * enthalpy)
        assert result.ensemble == "constant pressure"
        expected = [enthalpy.var() / thermal**2, volume.var() / (thermal * mean), joint / (thermal**2 * mean)]
        assert [result.heat_capacity_p, result.compressibility, result.expansion] == pytest.approx(expected, rel=1e-9)
    sim.method = md.StochasticVelocityRescaling(0.004, thermal, 0.2, 3)  # of the same temperature
    sim.run(5, observers=[looking], progress=False)
    assert_answered(lambda: simulation().run(5, observers=[looking], progress=False), ValueError, "Fluctuations")


@pytest.mark.parametrize("times", [50, *(pytest.param(n, marks=pytest.mark.slow) for n in (100, 400))])
def test_error_bars_of_fluctuations_hold_the_variance_also_of_short_runs(times):
    """Within two errors in 88 % of the runs or more, 0.85 to 1.3 of the scatter; a short run says what it misses."""
    tau, n_runs = 4, 100
    scene = ObservedRun("LJ", ["A"], [1], 1.0, 3, 1.0, 1.0)
    found, told = [], []
    for volume in processes(n_runs, times * tau, np.exp(-1.0 / tau), np.random.default_rng(times)).T:
        looking = md.observers.Fluctuations()
        looking.scene, looking.reference, looking.sums = scene, [0.0, 0.0, 100.0], BlockedSums(13)
        for one in volume:
            looking.sums.total += np.concatenate([[1.0, 0.0, 0.0, one], np.outer([0, 0, one], [0, 0, one]).ravel()])
            looking.sums.close_entry()
        result = looking.result()
        found.append((100.0 * result.compressibility, 100.0 * result.compressibility_error))
        told.append("LOWER BOUND" in str(result))
    values, errors = np.array(found).T
    assert (np.abs(values - 1.0) < 2.0 * errors).mean() >= 0.88
    assert 0.85 < np.sqrt((errors**2).mean()) / values.std() < 1.3
    assert np.mean(told) > 0.9 if times == 50 else np.mean(told) < 0.1 if times == 400 else True


@pytest.mark.parametrize("scene", [simulation, *OTHERS])
def test_a_run_that_was_cut_goes_on_to_the_same_answers(scene, tmp_path):
    """In one process, and through a file, to the last bit; the steps have the bits of a run without observers."""
    (whole, cut, resumed), file = (several(scene) for _ in range(3)), tmp_path / "a.h5md"
    alone, watched, in_parts, sim = (scene() for _ in range(4))
    alone.run(230, every=50)
    watched.run(230, every=50, observers=whole)
    assert np.array_equal(watched.positions, alone.positions)
    for n_steps in (103, 127):
        in_parts.run(n_steps, every=50, observers=cut)
    sim.run(103, every=50, trajectory=file, observers=several(scene))
    again = md.Simulation.resume(file, sim.potentials)
    again.run(until_step=230, every=50, trajectory=file, append=True, observers=resumed)
    answers = lambda many: {one.name: one.result().columns() | one.result().numbers() for one in many}  # noqa: E731
    for looking in (cut, resumed, md.read_observers(file).values()):
        np.testing.assert_equal(answers(looking), answers(whole))
    with h5py.File(file) as h5:
        for one in whole:
            for name, series in one.result().columns().items():
                np.testing.assert_array_equal(h5[f"minimd/observers/{one.name}/{name}"][:], series)
            for name, number in one.result().numbers().items():
                np.testing.assert_array_equal(h5[f"minimd/observers/{one.name}"].attrs[name], number)


@pytest.mark.parametrize("kind", HERE)
def test_a_state_sets_what_its_kind_has_and_nothing_else(kind, run):
    made = run.looking[kind]
    state, other = made.state(), type(made)(**made.made_with())
    words = json.loads(bytes(state["words"]))
    words["settled"] |= {"every": 7, "result": "not callable"}
    other.restore(state | {"words": np.frombuffer(json.dumps(words).encode(), dtype=np.uint8)})
    assert (other.every, other.made_with(), callable(other.result)) == (made.every, made.made_with(), True)


@pytest.mark.parametrize("kind", HERE)
def test_a_state_of_other_kinds_is_refused(kind, run):
    """Each array of another type or shape, one that is missing or unknown; each word of another type."""
    made = run.looking[kind]
    state = made.state()
    words = json.loads(bytes(state["words"]))

    def refused(state):
        with pytest.raises((ValueError, KeyError, IndexError, TypeError)):
            type(made)(**made.made_with()).restore(state)

    refused(state | {"surprise": np.zeros(3)})
    for name in state.keys() - {"words"}:
        array = state[name]
        refused({key: one for key, one in state.items() if key != name})
        others = [
            array.astype("f4"),
            array[None],
            array[:-1],
            array[:1],
            np.concatenate([array, array]),
            array[..., None],
        ]
        for other in others:
            if other.size or array.size:
                refused(state | {name: other})
    for part in ("scene", "settled"):
        for key in words[part]:
            for other in (
                {},
                [[[]]],
                True if key != "is_cubic" else 1,
                "x" if words[part][key] not in ("LJ", "x") else 1,
            ):
                if type(other) is not type(words[part][key]):
                    changed = words | {part: words[part] | {key: other}}
                    refused(state | {"words": np.frombuffer(json.dumps(changed).encode(), np.uint8)})


def test_observers_that_a_run_in_many_parts_leaves_behind_are_told_once(tmp_path, recwarn):
    warnings.simplefilter("always")
    sim, files = simulation(), [tmp_path / "a.h5md", tmp_path / "b.h5md"]
    for file in files:
        for part in range(4):
            looking = [md.observers.Profile(every=5, name=f"at_{part}")]
            sim.run(10, every=5, trajectory=file, append="auto", observers=looking)
    told = [str(warning.message) for warning in recwarn if "at_0" in str(warning.message)]
    assert [str(file) in sentence for file, sentence in zip(files, told, strict=True)] == [True, True]
    assert {*md.read_observers(files[0])} == {f"at_{part}" for part in range(4)}


@pytest.mark.slow
def test_sums_of_another_convention_do_not_go_on(tmp_path, monkeypatch):
    """Those of an older version, which gives no number: displacements were not relative to the center of mass."""
    file, sim, dumps = tmp_path / "a.h5md", simulation(), json.dumps
    with monkeypatch.context() as older:
        older.setattr(md.observers.MeanSquareDisplacement, "convention", None, raising=False)
        older.setattr(json, "dumps", lambda *made, **how: dumps(*made, **how).replace(', "convention": null', ""))
        looking = [md.observers.MeanSquareDisplacement(every=2), md.observers.Profile(every=10)]
        sim.run(20, every=10, trajectory=file, observers=looking)
    found, resumed = md.read_observers(file), md.Simulation.resume(file, sim.potentials)
    assert {name: one.n_looks for name, one in found.items()} == {"mean_square_displacement": 0, "profile": 3}
    assert all([check_file(file).comparisons, plot_file(file).exists()])
    go_on = lambda *many: resumed.run(10, every=10, trajectory=file, append=True, observers=many)  # noqa: E731
    assert_answered(lambda: go_on(*found.values()), ValueError, "mean_square_displacement", "convention 1", "not 3")
    assert_answered(lambda: go_on(md.observers.Profile(every=7)), ValueError, "with the arguments")
    with pytest.warns(UserWarning, match="profile"):
        go_on()


@pytest.mark.slow
def test_a_scene_has_observers(here):
    kinds = '[[observer]]\nkind = "radial-distribution"\nevery = 5\nr_max = 2.0\n[[observer]]\nkind = "viscosity"\n'
    text = melt_scene(3, 40, f"seed = 3\n{kinds}[output]\nevery = 20\n")
    run_scene(parse_scene(text, here / "melt.toml"), steps=20, tell=print)
    resume_run("melt.h5md", tell=print)
    found = md.read_observers("melt.h5md")
    assert {name: one.n_looks for name, one in found.items()} == {"radial_distribution": 9, "viscosity": 9}
    for old, new, shown in (("r_max = 2.0", 'axis = "c"', "axis"), ('"viscosity"', '"viscous"', "viscous")):
        with pytest.raises(ValueError, match=f"{shown}.*radial-distribution|radial-distribution.*{shown}"):
            parse_scene(text.replace(old, new), here / "melt.toml")


@dataclass(frozen=True, repr=False)
class SpeedsResult(Result):
    speeds: np.ndarray
    shares: np.ndarray
    errors: np.ndarray
    title = "distribution of speeds"

    def series(self):
        unit = f"{self.units.length}/{self.units.time}"
        return [Series("speed", unit, self.speeds), Series("share", "", self.shares, self.errors)]

    def display_rows(self):
        return [("speeds", f"most often {self.speeds[np.argmax(self.shares)]:.3g}")]


class Speeds(Accumulator):
    """The distribution of speeds."""

    kind = "speeds"
    fastest: float = argument(positive, "where the last bin ends", 8.0)
    n_bins: int = argument(checked_count, "number of bins", 16)
    every: int = steps(2)
    name: str = label()

    def _laid_out(self, scene):
        self.sums = BlockedSums(self.n_bins)

    def _look(self, engine):
        speeds = np.linalg.norm(engine.velocities, axis=1)
        self.sums.total += np.histogram(speeds, self.n_bins, (0.0, self.fastest))[0]

    def result(self):
        shares = self.sums.estimate(lambda sums: sums / sums.sum())
        return SpeedsResult(self.answered(), (np.arange(self.n_bins) + 0.5) * self.fastest / self.n_bins, *shares)


def test_a_new_observer_is_one_class_and_its_series(tmp_path, monkeypatch):
    monkeypatch.setitem(md.observers.KINDS, Speeds.kind, Speeds)
    sim, looking, file = simulation(), Speeds(fastest=10.0), tmp_path / "a.h5md"
    sim.run(100, every=20, trajectory=file, observers=[looking])
    (kept,), result = md.read_observers(file).values(), looking.result()
    assert "observers      took" in str(sim.report())
    assert repr(kept) == repr(looking) == "Speeds(fastest=10, every=2)"
    assert str(kept) == str(result) == "speeds         " + repr(result)[len("SpeedsResult(") : -1]
    assert list(result.columns()) == ["speed", "share", "share_error"] == [*result.to_pandas()]
    assert result.shares.sum() == pytest.approx(1.0)
    (panel,) = result.plot().axes
    assert (panel.get_xlabel(), panel.get_ylabel(), panel.get_title()) == ("speed  [σ/τ]", "share", result.title)
    np.testing.assert_array_equal(panel.lines[0].get_xydata().T, (result.speeds, result.shares))
    with h5py.File(file) as h5:
        np.testing.assert_array_equal(h5["minimd/observers/speeds/share_error"], result.errors)
    monkeypatch.delitem(md.observers.KINDS, Speeds.kind)
    with pytest.warns(UserWarning, match="left out: 'speeds'"):
        assert md.read_observers(file) == {}
    assert "fastest : where the last bin ends." in Speeds.__doc__
    assert_answered(lambda: Speeds(fastest=-1.0), ValueError, "fastest", "-1")


def test_looks_after_the_last_good_state_are_told(monkeypatch):
    """Nobody looks at a state that is known to have failed; earlier looks, of steps that were undone, are told of."""
    sim, looking = simulation(), md.observers.MeanSquareDisplacement(every=2)
    start, good = sim.engine.snapshot(), sim.guard.observe

    def observe():
        if sim.step < 10:
            return good()
        sim.engine.restore(start)
        raise md.NonFiniteError("the total energy has run away")

    monkeypatch.setattr(sim.guard, "is_hot", lambda: True)
    monkeypatch.setattr(sim.guard, "observe", observe)
    with pytest.raises(md.NonFiniteError), pytest.warns(UserWarning, match="step 0.* 4 "):
        sim.run(100, observers=[looking], progress=False)
    assert looking.n_looks == 5
    monkeypatch.undo()
    sim.run(4, observers=[looking], progress=False)
    counts = looking._correlator.correlations(looking.sums.total[3:])[0]
    assert counts[:5].tolist() == [8, 6, 4, 2, 1]  # lags within five looks, and within three


def seen_by(*looking, sim=None):
    (sim or simulation()).run(1, observers=list(looking), progress=False)


def open_along_z():
    system = md.System(np.eye(3), cell=[9.0, 9.0, 9.0], pbc=(True, True, False))
    return md.Simulation(system, [], md.VelocityVerlet(0.004))


def with_another_time_step():
    looking, sim = md.observers.Profile(every=1), simulation()
    seen_by(looking, sim=sim)
    sim.method = md.VelocityVerlet(0.002)
    seen_by(looking, sim=sim)


def test_a_file_that_asks_for_too_much_is_refused(tmp_path):
    simulation().run(4, every=2, trajectory=tmp_path / "a.h5md", observers=[md.observers.RadialDistribution(every=2)])
    with h5py.File(tmp_path / "a.h5md", "r+") as h5:
        group = h5["minimd/observers/radial_distribution"]
        group.attrs["arguments"] = json.dumps(json.loads(group.attrs["arguments"]) | {"n_bins": 10**12})
        assert_answered(lambda: observers_of(h5, read_restart(h5)), ValueError, "radial_distribution", "memory")


test_what_cannot_be_observed_is_refused = answered(
    (lambda: seen_by(3), TypeError, "observers", "[3]"),
    (lambda: seen_by(md.observers.Profile(), md.observers.Profile()), ValueError, "observers", "'profile'"),
    (lambda: md.observers.Profile().result(), ValueError, "Profile(every=50)"),
    (lambda: md.observers.RadialDistribution(every=0), ValueError, "every", "0"),
    (lambda: md.observers.Profile("d"), ValueError, "axis", "'d'"),
    (lambda: md.observers.Viscosity(name="a/b"), ValueError, "name", "'a/b'"),
    (lambda: seen_by(md.observers.Profile(extent=(0.0, 1.0))), ValueError, "extent", "axis c"),
    (lambda: seen_by(md.observers.Profile(center=True), sim=open_along_z()), ValueError, "axis c", "center"),
    (lambda: seen_by(md.observers.RadialDistribution(), sim=chain().simulation()), ValueError, "periodic", "12 atoms"),
    (with_another_time_step, ValueError, "time step"),
    (lambda: seen_by(md.observers.StructureFactor(), sim=chain().simulation()), ValueError, "periodic", "12 atoms"),
    (lambda: seen_by(md.observers.StructureFactor(q_max=0.1)), ValueError, "q_max", "0.1"),
    (lambda: seen_by(md.observers.StructureFactor(q_max=2e20)), ValueError, "q = ", "e+20", "10000"),
    (lambda: seen_by(md.observers.SelfScattering(q=1e18)), ValueError, "q = 1e+18", "10000"),
    (lambda: seen_by(md.observers.StructureFactor(n_bins=10**9)), ValueError, "n_bins", "1000000000"),
    (lambda: seen_by(md.observers.SelfScattering(q=0.1)), ValueError, "q", "0.1"),
)


def test_pictures_name_what_they_show(run):
    """F_s on a logarithmic axis, with its errors and q; density with the temperature; frames and times."""
    answers = {kind: looking.result() for kind, looking in run.looking.items()}
    figures = {kind: answer.plot() for kind, answer in answers.items()}
    (scattering,) = figures["self-scattering"].axes
    q = answers["self-scattering"].q
    assert (scattering.get_xscale(), len(scattering.collections)) == ("log", 3)
    assert scattering.get_title().endswith(f"q = {q:.4g} /σ")
    assert [text.get_text() for text in scattering.get_legend().texts] == ["Fₛ(q, t)", "Fₛ(q, t) A", "Fₛ(q, t) B"]

    assert "temperature from " in str(answers["profile"])
    for low, high, begins_at_zero in ((0.63, 0.84, False), (0.0, 0.8, True), (0.8, 0.801, False)):
        start, end = limits(np.array([low, high]))
        assert (start == 0.0) == begins_at_zero
        assert start <= low < high < end
        assert end - start > 0.2 * high
    profile, beside = figures["profile"].axes
    assert profile.get_title() == "density and temperature, mean of 51 frames, 0 to 0.4 τ"
    assert profile.get_ylim()[1] > 1.1 * answers["profile"].densities.max()
    bars = beside.containers[0].lines[0]
    known = np.isin(answers["profile"].z, bars.get_xdata())
    assert known.any()
    np.testing.assert_array_equal(bars.get_ydata(), answers["profile"].temperature[known])
    assert figures["structure-factor"].axes[0].get_ylabel() == "S(q)"
    assert "51 frames, 0 to 0.4 τ" in figures["radial-distribution"].axes[0].get_title()


@pytest.mark.parametrize("kind", ["fluctuations", "chain-shape", "surface-tension", "dielectric-constant"])
def test_a_mean_is_drawn_over_time_by_its_symbol_with_a_band_of_its_error(kind, run):
    """Fluctuations per atom, as they are printed."""
    result = run.looking[kind].result()
    (panel,) = result.plot().axes
    k, size = (1, len(run.species)) if kind == "fluctuations" else (0, 1.0)
    curve, band = panel.lines[0], panel.patches[0]
    np.testing.assert_allclose(curve.get_ydata(), result.parts[:, k] / size)
    assert result.quantities[k].symbol in (panel.get_ylabel(), panel.get_ylabel().split(",")[0], curve.get_label())
    assert result.quantities[k].name not in panel.get_ylabel() + curve.get_label()
    assert band.get_y() + 0.5 * band.get_height() == pytest.approx(result.values[k] / size)
    assert band.get_height() == pytest.approx(2.0 * np.nan_to_num(result.errors[k]) / size)


def test_the_numbers_of_the_first_peak_are_those_that_are_printed(run):
    result = run.looking["radial-distribution"].result()
    for pair, (r, g, error) in result.peaks().items():
        found = [result.numbers()[name] for name in (f"r_peak_{pair}", f"g_peak_{pair}", f"g_peak_{pair}_error")]
        assert found == [r, g, error]
        assert f"{pair}: first peak at {r:.4g} σ, {with_error(g, error)}" in str(result)
    result = run.looking["structure-factor"].result()
    assert result.numbers()["s_peak"] in result.s
    assert f"first peak at {result.numbers()['q_peak']:.4g} /σ, " in str(result)
