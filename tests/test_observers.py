"""Observers of a run: their answers are those of the frames, of formulas, and of MDAnalysis; a run that was cut goes on to the same answer."""

import json

import h5py
import MDAnalysis
import numpy as np
import pytest
from MDAnalysis.analysis.msd import EinsteinMSD
from MDAnalysis.analysis.rdf import InterRDF
from references import brute_force_pairs, liquid, melt_scene

import minimd as md
from minimd import observers
from minimd.analysis.check import check_file
from minimd.analysis.plot import plot_file
from minimd.files.h5md_observers import observers_of
from minimd.mdanalysis import universe
from minimd.observers.correlator import MultipleTau, Product, SquaredDifference, add_correlations
from minimd.observers.fluctuations import FEWEST, correlation_times
from minimd.scene import parse_scene, resume_run, run_scene

EVERY = {
    "radial-distribution": 10,
    "mean-square-displacement": 2,
    "velocity-autocorrelation": 2,
    "viscosity": 5,
    "fluctuations": 5,
    "profile": 10,
}


def simulation(units=md.units.LJ, **options):
    """A small mixture, whose positions float32 holds exactly at the start."""
    system = liquid(3)
    species = np.where(np.arange(len(system)) % 3, "A", "B")
    system = md.System(np.float32(system.positions), masses=np.where(species == "A", 1.0, 2.0), velocities=system.velocities,
                       cell=np.float32(system.cell.vectors), species=species)  # fmt: skip
    return md.Simulation(system, md.LennardJones(1.0, 1.0, 1.85, "switched"), md.VelocityVerlet(0.004), **options)


def several():
    return [observers.KINDS[kind](every=every) for kind, every in EVERY.items()]


class Seen:
    """An observer that keeps positions and velocities."""

    def __init__(self):
        self.positions, self.velocities, self.frames = [], [], []

    def __call__(self, sim):
        self.positions.append(sim.positions.copy())
        self.velocities.append(sim.velocities.copy())
        self.frames.append(sim.frame())


@pytest.fixture(scope="module")
def run():
    """A run that was looked at every second step by all observers, and by one that keeps everything."""
    sim, seen = simulation(), Seen()
    looking = [type(one)(every=2) for one in several()]
    record = sim.run(100, every=2, observers=[seen, *looking])
    return sim, seen, {one.kind: one for one in looking}, record


def relative(sim, series):
    """Positions or velocities, (T, N, 3), relative to the center of mass, which moves."""
    return np.array(series) - np.average(series, axis=1, weights=sim.system.masses)[:, None]


def direct(series, lag, stride, law):
    """A mean over the origins that a level of the correlator has: every stride-th entry."""
    chosen = series[::stride]
    return np.mean([law(chosen[k], chosen[k + lag // stride]) for k in range(len(chosen) - lag // stride)], axis=0)


@pytest.mark.parametrize(
    ("kind", "attribute", "law"),
    [
        ("mean-square-displacement", "positions", lambda a, b: (b - a) ** 2),
        ("velocity-autocorrelation", "velocities", lambda a, b: a * b),
    ],
)
def test_displacements_and_velocity_correlations_are_those_of_the_frames(run, kind, attribute, law):
    sim, seen, looking, _ = run
    result, series, species = looking[kind].result(), relative(sim, getattr(seen, attribute)), sim.system.species_index
    assert result.times == pytest.approx(
        0.008 * np.array([*range(16), *range(16, 32, 2), *range(32, 52, 4)][: len(result.times)])
    )
    for k, time in enumerate(result.times):
        lag = round(time / 0.008)
        of_atoms = direct(series, lag, 1 if lag < 16 else 2 if lag < 32 else 4, law)
        expected = [
            of_atoms.sum(axis=1).mean(),
            *(of_atoms[species == s].sum(axis=1).mean() for s in (0, 1)),
            *of_atoms.mean(axis=0),
        ]
        np.testing.assert_allclose(result.means[:, k], expected, rtol=1e-10, atol=1e-13)


def in_memory(sim, positions):
    made = MDAnalysis.Universe.empty(len(sim.system), trajectory=True)
    edges = np.diag(sim.system.cell.vectors)
    made.load_new(
        np.array(positions, dtype=np.float32),
        dimensions=np.array([[*edges, 90.0, 90.0, 90.0]] * len(positions)),
        order="fac",
    )
    return made


def test_displacements_are_those_of_mdanalysis():
    """Of positions that float32 holds exactly, with a bath that moves the center; lags of the first level, which has all origins."""
    sim, looking, kept = simulation(), observers.MeanSquareDisplacement(every=1), []
    sim.method = md.LangevinBAOAB(0.004, 1.0, 1.0, seed=1)
    looking.prepare(sim.engine)
    rng, step = np.random.default_rng(3), 2.0**-12
    for _ in range(30):
        sim.positions[:] = np.float32(
            np.round((sim.positions + rng.normal(0.0, 0.1, sim.positions.shape)) / step) * step
        )
        sim.engine.count(1)
        looking.observe(sim.engine)
        kept.append(sim.positions.copy())
    theirs = EinsteinMSD(in_memory(sim, kept).atoms, fft=False).run().results.timeseries
    np.testing.assert_allclose(looking.result().msd[:16], theirs[:16], rtol=1e-10)


def test_radial_distribution_is_that_of_mdanalysis_and_of_all_pairs():
    sim, n_bins, r_max = simulation(), 40, 2.4
    looking = observers.RadialDistribution(r_max=r_max, n_bins=n_bins, every=1)
    looking.prepare(sim.engine)
    looking.observe(sim.engine)
    result, system = looking.result(), sim.system
    made = in_memory(sim, [system.positions])
    shells = 4.0 / 3.0 * np.pi * np.diff(np.linspace(0.0, r_max, n_bins + 1) ** 3)
    for k, (a, b) in enumerate((("A", "A"), ("A", "B"), ("B", "B"))):
        one, other = (made.atoms[np.flatnonzero(system.species == label)] for label in (a, b))
        theirs = (
            InterRDF(one, other, nbins=n_bins, range=(0.0, r_max), exclusion_block=(1, 1) if a == b else None)
            .run()
            .results
        )
        assert result.pairs[k] == f"{a}-{b}"
        np.testing.assert_allclose(result.r, theirs.bins, rtol=1e-12)
        np.testing.assert_allclose(result.g_of_pairs[k], theirs.rdf, rtol=1e-10)
        n_pairs = len(one) * (len(other) - (a == b))
        counts = np.histogram(distances(system, a, b, r_max), n_bins, (0.0, r_max))[0]
        np.testing.assert_allclose(result.g_of_pairs[k], counts / n_pairs * system.volume / shells, rtol=1e-10)


def distances(system, a, b, cutoff):
    """From atoms of species a to those of species b, in both directions if they are one species."""
    pairs = brute_force_pairs(system.positions, system.cell.vectors, system.cell.pbc, cutoff)
    found = [system.positions[j] - system.positions[i] + np.array(s) @ system.cell.vectors
             for i, j, *s in pairs if (system.species[i], system.species[j]) == (a, b)]  # fmt: skip
    return np.linalg.norm(found, axis=1)


def test_radial_distribution_of_a_crystal_and_its_images():
    """A simple cubic lattice of one atom in each cell has 6, 12 and 8 neighbors, all of them images; in any cell that makes it."""
    for cell in (np.eye(3), np.array([[1.0, 0.0, 0.0], [1.0, 1.0, 0.0], [0.0, -1.0, 1.0]])):
        system = md.System(np.array([[0.0, 0.0, 0.0], [2.0, 1.0, 1.0]]) @ cell, cell=np.diag([4.0, 2.0, 2.0]) @ cell)
        sim = md.Simulation(system, md.LennardJones(1e-9, 0.1, 0.3), md.VelocityVerlet(0.1))
        looking = observers.RadialDistribution(r_max=5.0, n_bins=500, every=1)
        looking.prepare(sim.engine)
        looking.observe(sim.engine)
        result = looking.result()
        counts = (
            result.g * (4.0 / 3.0 * np.pi * np.diff(np.linspace(0.0, 5.0, 501) ** 3)) / system.volume
        )  # of one pair of atoms
        found = {round(float(r), 3): n for r, n in zip(result.r, counts, strict=True) if n > 1e-12}
        exact = np.linalg.norm(list(images(system)), axis=1)
        assert sum(found.values()) == pytest.approx((exact < 5.0).sum())
        assert min(found) == pytest.approx(exact.min(), abs=0.01)


def images(system):
    """Half the vectors from one atom to the other and to the images of both."""
    for steps in np.ndindex(9, 9, 9):
        shift = (np.array(steps) - 4) @ system.cell.vectors
        yield system.positions[1] - system.positions[0] + shift
        if tuple(steps) > (4, 4, 4):
            yield shift
            yield shift


def test_viscosity_and_fluctuations_are_those_of_the_frames(run):
    """The autocorrelation of the first level against the stress of frames; C_V from the kinetic energies."""
    sim, seen, looking, record = run
    virials = []
    for positions, velocities in zip(seen.positions, relative(sim, seen.velocities), strict=True):
        made = sim.system.copy()
        made.positions[:], made.velocities[:] = positions, velocities
        momenta = made.masses[:, None] * velocities
        pressure = (
            np.einsum("ia,ib->ab", momenta, velocities) + md.evaluate(made, sim.potentials).virial
        ) / made.volume
        virials.append(0.5 * (pressure + pressure.T) - np.eye(3) * np.trace(pressure) / 3.0)
    series, result = np.array(virials), looking["viscosity"].result()
    expected = [np.mean(np.einsum("tab,tab->t", series[lag:], series[: len(series) - lag])) / 10.0 for lag in range(32)]
    np.testing.assert_allclose(result.autocorrelation[:32], expected, rtol=1e-9, atol=1e-12)
    weight = sim.system.volume / record.temperature.mean()
    assert result.integral[31] == pytest.approx(np.trapezoid(expected, dx=0.008) * weight, rel=1e-9)
    n_dof, temperature = 3 * len(sim.system) - 3, record.temperature.mean()
    kinetic = 0.5 * n_dof * record.temperature * grown(looking["fluctuations"])[0]
    assert looking["fluctuations"].result().heat_capacity_v == pytest.approx(
        0.5 * n_dof / (1.0 - 2.0 * kinetic.var() / (n_dof * temperature**2))
    )


def test_lags_beyond_half_of_the_run_have_no_error_bar(run):
    """Few blocks contain them; what these tell of each other is far less than the error."""
    for name, error in (
        ("viscosity", "autocorrelation_error"),
        ("viscosity", "integral_error"),
        ("mean-square-displacement", "msd_error"),
    ):
        looking = run[2][name]
        columns, half = looking.result().columns(), 0.5 * (looking.n_looks - 1) * looking.scene.spacing
        assert np.isnan(columns[error][columns["time"] > half]).all()
        assert np.isfinite(columns[error][columns["time"] <= 0.5 * half]).all()


@pytest.mark.parametrize("kind", md.observers.KINDS)
def test_a_state_sets_what_its_kind_has_and_nothing_else(kind, run):
    made = run[2][kind]
    state, other = made.state(), type(made)(**made.made_with())
    words = json.loads(bytes(state["words"]))
    words["settled"] |= {"every": 7, "result": "not callable"}
    other.restore(state | {"words": np.frombuffer(json.dumps(words).encode(), dtype=np.uint8)})
    assert (other.every, other.made_with()) == (made.every, made.made_with())
    assert callable(other.result)


def test_an_observer_of_a_file_that_asks_for_too_much_memory_is_refused(tmp_path):
    sim = simulation()
    sim.run(4, every=2, trajectory=tmp_path / "a.h5md", observers=[md.observers.RadialDistribution(every=2)])
    with h5py.File(tmp_path / "a.h5md", "r+") as h5:
        group = h5["minimd/observers/radial_distribution"]
        group.attrs["arguments"] = json.dumps(json.loads(group.attrs["arguments"]) | {"n_bins": 10**12})
        with pytest.raises(ValueError, match="radial_distribution asks for more memory"):
            observers_of(h5)


def test_sums_of_another_convention_do_not_go_on(tmp_path, monkeypatch):
    """Those of an older version, which gives no number: displacements were not relative to the center of mass."""
    file, sim = tmp_path / "a.h5md", simulation()
    with monkeypatch.context() as older:
        older.setattr(observers.MeanSquareDisplacement, "convention", None, raising=False)
        older.setattr(
            json,
            "dumps",
            lambda made, dumps=json.dumps, **options: dumps(made, **options).replace(', "convention": null', ""),
        )
        sim.run(
            20,
            every=10,
            trajectory=file,
            observers=[observers.MeanSquareDisplacement(every=2), observers.Profile(every=10)],
        )
    found, resumed = md.read_observers(file), md.Simulation.resume(file, sim.potentials)
    assert {name: one.n_looks for name, one in found.items()} == {"mean_square_displacement": 0, "profile": 3}
    assert check_file(file).comparisons
    assert plot_file(file).exists()
    with pytest.raises(ValueError, match=r"mean_square_displacement .* convention 1 .* not 2; go on without it"):
        resumed.run(10, every=10, trajectory=file, append=True, observers=list(found.values()))
    for names in ([], ["displacement"]):
        anew = [observers.MeanSquareDisplacement(every=2, name=name) for name in names]
        with pytest.warns(UserWarning, match="which this run does not go on with"):
            resumed.run(10, every=10, trajectory=file, append=True, observers=anew)


def grown(looking):
    """Factors for deviations of K, E and V, so that their variances contain the part that is missing in a short run."""
    return np.sqrt(1.0 + 2.0 / np.fmax(FEWEST, np.nan_to_num(correlation_times(looking.sums), nan=np.inf)))


def test_a_profile_is_that_of_the_frames(run):
    sim, seen, looking, record = run
    result, edges = looking["profile"].result(), np.diag(sim.system.cell.vectors)
    z = np.array(seen.positions)[:, :, 2] % edges[2]
    layers = np.linspace(0.0, edges[2], 101)
    for s in (0, 1):
        counts = np.histogram(z[:, sim.system.species_index == s], layers)[0]
        np.testing.assert_allclose(result.densities[s], counts / len(z) / (edges.prod() / 100), rtol=1e-12)
    weights = result.density / result.density.sum()
    assert (weights * np.nan_to_num(result.temperature)).sum() == pytest.approx(record.temperature.mean(), rel=1e-9)


def test_free_atoms_move_as_their_velocities_say():
    """Ballistic motion: the displacement is ⟨v²⟩ t² at every lag, whatever level; it is that of the atoms where the cell grows under them."""
    velocities = np.random.default_rng(2).normal(size=(20, 3))
    velocities -= velocities.mean(axis=0)
    for growth in (1.0, 1.001):
        sim = md.Simulation(
            md.System(np.zeros((20, 3)), velocities=velocities, cell=50.0),
            md.LennardJones(1e-12, 1e-3, 0.1),
            md.VelocityVerlet(0.01),
        )
        looking = observers.MeanSquareDisplacement(every=1)
        looking.prepare(sim.engine)
        for step in range(200):
            looking.observe(sim.engine)
            sim.engine.count(1)
            if growth != 1.0 and step:
                sim.system.cell = md.Cell.of(growth * sim.system.cell.vectors)
                sim.positions[:] *= growth
            sim.positions[:] += 0.01 * velocities
        result = looking.result()
        assert len(result.times) > 40
        np.testing.assert_allclose(
            result.msd, (velocities**2).sum(axis=1).mean() * result.times**2, rtol=1e-9, atol=1e-15
        )


def test_correlations_of_a_known_process():
    """x(n+1) = a x(n) + noise has ⟨x(0) x(n)⟩ = aⁿ; the integral over averaged levels is 1/(1 − a) − ½ by trapezoids."""
    n, decay, chains = 4000, 0.95, 200
    rng = np.random.default_rng(5)
    noise = rng.normal(0.0, np.sqrt(1.0 - decay**2), (n, chains))
    x = np.empty((n, chains))
    x[0] = rng.normal(size=chains)
    for k in range(1, n):
        x[k] = decay * x[k - 1] + noise[k]
    for averages in (True, False):
        correlator = MultipleTau(Product(), np.array([0, chains]), 1, 16, 8, averages)
        sums = np.zeros(correlator.size)
        for row in x:
            correlator.add(row[None], sums)
        counts, found = correlator.correlations(sums)
        found = found[:, 0, 0] / chains
        expected = decay**correlator.lags
        assert (
            np.abs(found - expected)[correlator.lags < 200].max() < 0.03
        )  # statistics: four errors of 50 chains of 20000/40 independent entries
        assert np.trapezoid(found[correlator.lags < 200], correlator.lags[correlator.lags < 200]) == pytest.approx(
            1.0 / (1.0 - decay) - 0.5, rel=0.05
        )
        assert counts[0] == n


def test_the_laws_of_the_correlator_are_plain_sums():
    ring = np.random.default_rng(1).normal(size=(16, 3, 7))
    for law, of in ((Product(), lambda a, b: a * b), (SquaredDifference(), lambda a, b: (a - b) ** 2)):
        sums = np.zeros((16, 2, 3))
        add_correlations(law, ring, 3, 8, 12, np.array([0, 4, 7]), sums)
        for lag in range(16):
            terms = of(ring[3], ring[(3 - lag) % 16]) * (8 <= lag < 12)
            np.testing.assert_allclose(sums[lag], [terms[:, :4].sum(axis=1), terms[:, 4:].sum(axis=1)], atol=1e-13)


def answers(looking):
    return {one.name: (one.result().columns(), one.result().numbers()) for one in looking}


def same(ours, theirs):
    for name, (columns, numbers) in ours.items():
        for key, series in columns.items():
            assert np.array_equal(series, theirs[name][0][key], equal_nan=True), (name, key)
        np.testing.assert_array_equal(list(numbers.values()), list(theirs[name][1].values()), err_msg=name)


def test_a_run_that_was_cut_goes_on_to_the_same_answers(tmp_path):
    """In one process, and through a file, to the last bit; the steps have the bits of a run without observers."""
    whole, alone = several(), simulation()
    alone.run(230, every=50)
    sim = simulation()
    sim.run(230, every=50, observers=whole)
    assert np.array_equal(sim.positions, alone.positions)
    cut, sim = several(), simulation()
    for n_steps in (103, 127):
        sim.run(n_steps, every=50, observers=cut)
    same(answers(cut), answers(whole))
    file, sim = tmp_path / "a.h5md", simulation()
    sim.run(103, every=50, trajectory=file, observers=several())
    resumed, again = several(), md.Simulation.resume(file, sim.potentials)
    again.run(until_step=230, every=50, trajectory=file, append=True, observers=resumed)
    same(answers(resumed), answers(whole))
    same(answers(md.read_observers(file).values()), answers(whole))
    with h5py.File(file) as h5:
        for one in whole:
            for name, series in one.result().columns().items():
                assert np.array_equal(h5[f"minimd/observers/{one.name}/{name}"][:], series, equal_nan=True)
        assert h5["minimd/observers/viscosity"].attrs["viscosity"] == whole[3].result().viscosity
    with pytest.raises(ValueError, match="with the arguments"):
        again.run(10, trajectory=file, append=True, observers=[observers.Profile(every=7)])
    with pytest.warns(UserWarning, match="'viscosity', which this run does not go on with"):
        again.run(
            10, every=50, trajectory=file, append=True, observers=[one for one in resumed if one.kind != "viscosity"]
        )
    assert plot_file(file).stat().st_size > 10_000
    assert len(universe(file).trajectory) == 5


SCENE = melt_scene(
    3,
    40,
    'seed = 3\n[[observer]]\nkind = "radial-distribution"\nevery = 5\nr_max = 2.0\n[[observer]]\nkind = "viscosity"\n[output]\nevery = 20\n',
)


def test_a_scene_has_observers(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    scene, told = parse_scene(SCENE, tmp_path / "melt.toml"), []
    run_scene(scene, steps=20, tell=told.append)
    assert any(line.startswith("g(r)") for line in told)
    resume_run("melt.h5md", tell=told.append)
    found = md.read_observers("melt.h5md")
    assert {name: one.n_looks for name, one in found.items()} == {"radial_distribution": 9, "viscosity": 9}
    for text, message in (
        (
            SCENE.replace("r_max = 2.0", 'axis = "c"'),
            r"cannot have axis with kind 'radial-distribution', which takes every, name, r_max, n_bins",
        ),
        (SCENE.replace('"viscosity"', '"viscous"'), "must be one of 'radial-distribution'"),
    ):
        with pytest.raises(ValueError, match=message):
            parse_scene(text, tmp_path / "melt.toml")


def test_what_cannot_be_observed_is_refused_in_a_sentence():
    sim = simulation()
    for bad, message in (
        (lambda: sim.run(1, observers=[3]), "observers must be a list of functions"),
        (lambda: sim.run(1, observers=[observers.Profile]), "observers must be a list of functions"),
        (lambda: sim.run(1, observers=[observers.Profile(), observers.Profile()]), "'profile' is the name of several"),
        (lambda: observers.Profile().result(), "has not looked yet"),
        (lambda: observers.RadialDistribution(every=0), "every must be a whole number"),
        (lambda: observers.Profile("d"), "axis must be one of"),
        (lambda: observers.Viscosity(name="a/b"), "letters, digits and underscores"),
        (lambda: sim.run(1, observers=[observers.Profile(extent=(0.0, 1.0))]), "leave extent out"),
    ):
        with pytest.raises((TypeError, ValueError), match=message):
            bad()
    open_one = md.Simulation(md.System(np.eye(3)), md.LennardJones(1.0, 0.5, 2.0), md.VelocityVerlet(0.001))
    for one in (observers.RadialDistribution(), observers.Viscosity()):
        with pytest.raises(ValueError, match="periodic in all"):
            open_one.run(1, observers=[one])
    looking = observers.Profile(every=1)
    sim.run(1, observers=[looking])
    sim.method = md.VelocityVerlet(0.002)
    with pytest.raises(ValueError, match="another time step"):
        sim.run(1, observers=[looking])


def test_the_correction_of_yeh_and_hummer(run):
    looking = run[2]["mean-square-displacement"]
    window = (0.1, 0.3)
    result = looking.result(window=window, viscosity=2.0)
    edge = run[0].system.volume ** (1 / 3)
    expected = 2.837297 * result.temperature / (6.0 * np.pi * 2.0 * edge)
    assert result.infinite - result.diffusion == pytest.approx(expected, rel=1e-12)
    assert result.diffusion == looking.result(window=window).diffusion
    assert "in a larger cell D is larger" in str(looking.result(window=window))
    assert "Yeh and Hummer" in str(result)
    with pytest.raises(ValueError, match="at least 3 lags"):
        looking.result(window=(0.1, 0.101))


def test_fluctuations_at_constant_pressure_are_those_of_the_record():
    """T and P₀ are those of the barostat, with a thermostat and without: C_P, κ_T and α_P from energies and volumes of the frames."""
    thermal, pressure = 0.9, 1.5
    bath = md.StochasticCellRescaling(pressure, 0.05, 0.5, seed=1, temperature=thermal, every=5)
    for method in (md.VelocityVerlet(0.004), md.StochasticVelocityRescaling(0.004, thermal, 0.1, 3)):
        looking, sim = observers.Fluctuations(every=5), simulation(barostat=bath)
        sim.method = method
        record = sim.run(100, every=5, observers=[looking], progress=False)
        _, of_energy, of_volume = grown(looking)
        result, volume, mean = looking.result(), record.volume * of_volume, record.volume.mean()
        enthalpy = record.total_energy * of_energy + pressure * volume
        assert result.ensemble == "constant pressure"
        assert result.heat_capacity_p == pytest.approx(enthalpy.var() / thermal**2, rel=1e-9)
        assert result.compressibility == pytest.approx(volume.var() / (thermal * mean), rel=1e-9)
        expected = np.mean((volume - volume.mean()) * enthalpy) / (thermal**2 * mean)
        assert result.expansion == pytest.approx(expected, rel=1e-9)
    sim.method = md.StochasticVelocityRescaling(0.004, thermal, 0.2, 3)
    sim.run(5, observers=[looking], progress=False)
    other = simulation()
    with pytest.raises(ValueError, match="or bath"):
        other.run(5, observers=[looking], progress=False)


def test_looks_after_the_last_good_state_are_told(monkeypatch):
    """Nobody looks at a state that is known to have failed; earlier looks, of steps that the failure has undone, are told of."""
    sim, looking = simulation(), observers.MeanSquareDisplacement(every=2)
    start, good = sim.engine.snapshot(), sim.guard.observe

    def observe():
        if sim.step < 10:
            return good()
        sim.engine.restore(start)
        raise md.NonFiniteError("the total energy has run away")

    monkeypatch.setattr(sim.guard, "is_hot", lambda: True)
    monkeypatch.setattr(sim.guard, "observe", observe)
    with pytest.raises(md.NonFiniteError), pytest.warns(UserWarning, match="has looked 4 times after step 0"):
        sim.run(100, observers=[looking], progress=False)
    assert looking.n_looks == 5
    monkeypatch.undo()
    sim.run(4, observers=[looking], progress=False)
    counts = looking._correlator.correlations(looking.sums.total[3:])[0]
    assert counts[:5].tolist() == [8, 6, 4, 2, 1]  # lags within five looks, and within three
