"""Stochastic cell rescaling: its equations, what follows the cell, and what files and reports say of it."""

import ase.io
import MDAnalysis
import numpy as np
import pytest
from h5md_runs import record_of
from references import melt_scene, processes
from scene_texts import ARGON, scene_of
from scenes import LJ, SCENES
from scipy.optimize import minimize_scalar
from step_scenes import bead_melt
from wrong_calls import assert_answered

import minimd as md
from minimd.core.diagnosis.report import conservation_report
from minimd.core.diagnosis.run_report import pressure_lines
from minimd.core.engine.cell_rescaling import rescaling_of
from minimd.core.files.h5md_reader import read_file
from minimd.core.integrators.barostats import ThermodynamicState
from minimd.core.structure.statistics import FEWEST, mean_and_error, with_error
from minimd.core.structure.units import GRAM_PER_CM3
from minimd.mdanalysis import universe as universe_of
from minimd.scene import load_scene, resume_run, run_scene
from minimd.view.check import FileCheck, check_file

slow = pytest.mark.slow
BATH, BUSSI = md.LangevinBAOAB(0.003, 0.8, 1.0, 2), md.StochasticVelocityRescaling(0.003, 0.8, 0.1, 2)
NO_ROOM = md.LennardJones(1.0, 1.0, 2.05, "force-shifted", bonded_scale=(0.0, 0.0, 1.0))  # for a skin


def barostat(**changes):
    plain = {"pressure": 1.0, "compressibility": 0.05, "relaxation_time": 0.5, "seed": 3, "every": 5}
    return md.StochasticCellRescaling(**plain | changes)


def wrapped_dumbbells():
    """Rigid, many of them across the boundary, in a cell that has next to no room for a skin."""
    system, _, constraints = SCENES["dumbbells"]()[:3]
    places = system.cell.wrapped(system.positions + 0.9)
    return md.System(places, cell=system.cell, masses=system.masses, bonds=system.bonds), NO_ROOM, constraints


KINDS = {"clusters": lambda: SCENES["argon"]()[:3], "bonds": bead_melt, "dumbbells": wrapped_dumbbells}


def at_pressure(kind, method=BATH, temperature=0.8, **changes):
    system, laws, constraints = KINDS[kind]()
    bath = barostat(**{"temperature": temperature} | changes)
    simulation = md.Simulation(system, laws, method, constraints, barostat=bath)
    simulation.set_temperature(temperature, 1)
    return simulation


def strains_of_an_ideal_gas(coupling, duration, n_strains, d=3, n=12, pressure=0.7, thermal=1.3):
    """Volumes of its isothermal-isobaric ensemble before and after, in units of their mean, and ΔH/kT; (3, K)."""
    inverse = {"compressibility": 1.0 / pressure, "relaxation_time": 1.0}
    bath, rng, found = barostat(pressure=pressure, coupling=coupling, **inverse), np.random.default_rng(5), []
    wanted = thermal, pressure, d
    state = lambda p, v: ThermodynamicState(p.T @ p / v, v, 0.5 * np.square(p).sum(), *wanted)  # noqa: E731
    for number in range(n_strains):
        volume, momenta = rng.gamma(n + 1) * thermal / pressure, rng.normal(scale=thermal**0.5, size=(n, 3))
        momenta[:, d:] = 0.0
        before = state(momenta, volume)
        strain = bath.strain(before, duration, number)
        values, axes = np.linalg.eigh(strain)
        after = state(momenta @ (axes * np.exp(-values)) @ axes.T, volume * np.exp(values.sum()))
        found.append([volume, after.volume, bath.change_of_conserved(before, after, strain, duration)])
    mean = (n + 1) * thermal / pressure
    return np.array(found).T / [[mean], [mean], [thermal]]


IN_SPACE = [("isotropic", 3), ("triclinic", 3), *(pytest.param(c, 3, marks=slow) for c in ("z", "xy"))]


@pytest.mark.parametrize(("coupling", "d"), [*IN_SPACE, ("isotropic", 2), ("triclinic", 2)])
def test_strain_and_its_conserved_energy_obey_the_fluctuation_theorem(coupling, d):
    """⟨f(V′) e^(−ΔH/kT)⟩ = ⟨f(V)⟩: exactly, at any time step, in space and in a plane."""
    volume, larger, heat = strains_of_an_ideal_gas(coupling, 0.4, 4000, d)
    changes = np.array([np.exp(-heat) - 1.0, np.exp(-heat) * larger**3 - volume**3])
    error = changes.std(axis=1) / 4000**0.5
    assert (error > 1e-3).all()  # the step is long
    assert (np.abs(changes.mean(axis=1)) < 4.0 * error).all()  # statistics


def test_heat_that_the_strain_does_not_balance_falls_as_the_step_to_three_halves():
    """For the right drift of √V alone: ΔH would fall as √Δt for any other."""
    short, long = (np.square(strains_of_an_ideal_gas("isotropic", dt, 400)[2]).mean() ** 0.5 for dt in (0.00625, 0.025))
    assert np.log2(long / short) / 2.0 == pytest.approx(1.5, abs=0.1)  # truncation


@pytest.mark.parametrize("coupling", ["isotropic", "triclinic"])
@pytest.mark.parametrize("kind", KINDS)
def test_forces_in_a_strained_cell_are_those_of_new_lists(kind, coupling):
    simulation = at_pressure(kind, coupling=coupling)
    volume = simulation.system.volume
    simulation.run(100, every=50, progress=False)
    assert abs(simulation.system.volume / volume - 1.0) > 1e-4
    assert kind == "dumbbells" or simulation.engine.interactions.n_builds < 20  # of 20 strains
    fresh = md.evaluate(simulation.system, simulation.potentials)
    simulation.frame()
    assert simulation.forces == pytest.approx(fresh.forces, abs=1e-12 * np.abs(fresh.forces).max())  # rounding
    assert simulation.potential_energy == pytest.approx(fresh.potential_energy, rel=1e-12)


def test_a_contact_takes_one_evaluation_of_its_own():
    """In the strained cell: energy and virial before the strain are those of the step."""
    simulation = at_pressure("clusters")
    simulation.make_steps(0)
    before = simulation.engine.interactions.n_evaluations
    simulation.engine.advance(20)
    assert simulation.engine.interactions.n_evaluations - before == 20 + 4


@pytest.mark.parametrize("coupling", ["isotropic", "z", "triclinic"])
@pytest.mark.parametrize("kind", KINDS)
def test_what_the_barostat_gives_is_what_the_energy_gains(kind, coupling):
    """Without noise, far from the pressure, H is kept while E changes: the virial is the derivative of the energy."""
    far = {"pressure": 30.0, "relaxation_time": 0.25, "coupling": coupling, "every": 2}
    record = at_pressure(kind, md.VelocityVerlet(0.0005), 0.5, **far).run(60, every=2, progress=False)
    enthalpy = record.total_energy + 30.0 * record.volume
    assert np.ptp(record.volume) > 0.002 * record.volume[0]
    assert np.ptp(record.conserved_energy) < 0.02 * np.ptp(enthalpy) + 0.02 * np.ptp(record.total_energy)
    if kind == "dumbbells":
        assert record.constraint_violation.max() < 1e-12
    if coupling == "z":  # one axis alone changes
        assert (record.cell[0] == record.cell[-1]).all(axis=1).tolist() == [True, True, False]


class Clock(md.Term):
    """No force; remembers the times of evaluations with energy."""

    depends_on_time, times, bind = True, (), lambda self, _system: self

    def add(self, system, detail, forces, energies, virials):
        self.times += (round(self.time, 9),) * bool(detail)


def atom_with_clock(**changes):
    atom, bath = md.System([[0.0, 0.0, 0.0]], cell=3.0), {"temperature": 0.8, "relaxation_time": 50.0} | changes
    return md.Simulation(atom, Clock(), md.VelocityVerlet(0.1), barostat=barostat(**bath))


def test_heat_capacity_and_expansion_at_the_pressure_of_the_barostat():
    """And forces that depend on time are those of the step of the strain."""
    simulation, looking = atom_with_clock(), md.observers.Fluctuations(every=5)
    simulation.velocities[:] = 0.5, -1.0, 0.7
    record = simulation.run(40, every=5, observers=[looking], progress=False)
    (of_enthalpy, covariance), _ = np.cov(record.total_energy + record.volume, record.volume, ddof=0)
    found, grown = looking.result(), 1.0 + 2.0 / FEWEST  # the part that variances miss in so short a run
    assert found.heat_capacity_p == pytest.approx(grown * of_enthalpy / 0.8**2)
    assert found.expansion == pytest.approx(grown * covariance / (0.8**2 * record.volume.mean()))
    simulation = atom_with_clock()
    simulation.run(10, every=10, progress=False)
    assert simulation.potentials[0].times == (0.0, 0.5, 0.5, 1.0, 1.0)


@pytest.mark.parametrize("method", [BUSSI, pytest.param(BATH, marks=slow)])
def test_a_file_tells_volume_and_pressure_as_the_report_does_with_the_error_of_a_mean(method, tmp_path):
    simulation = at_pressure("clusters", method)
    record = simulation.run(100, every=5, trajectory=tmp_path / "a.h5md", progress=False)
    reports = simulation.report(), check_file(tmp_path / "a.h5md").report
    told, found = ([str(line) for line in one.lines if line.name in ("volume", "pressure")] for one in reports)
    of_center = 2.0 * record.kinetic_energy / (simulation.n_dof * record.volume) * simulation.conserves_momentum
    assert found == told
    assert f" {with_error(*mean_and_error(record.pressure + of_center))} " in told[1]


def test_a_run_goes_on_in_its_file_with_another_temperature_and_another_barostat(tmp_path):
    """The temperature of the barostat follows that of the thermostat; who changes it means it, and is not warned."""
    path = tmp_path / "a.h5md"
    first = at_pressure("clusters")
    first.run(10, every=5, trajectory=path, progress=False)
    cooler = md.LangevinBAOAB(0.003, 0.6, 1.0, 2)
    cooled = md.Simulation.resume(path, LJ, method=cooler)
    cooled.run(10, every=5, trajectory=path, append=True, progress=False)
    stored = read_file(path)
    assert (stored.parameters["temperature"], stored.barostat.temperature, stored.n_frames) == (0.6, None, 5)
    pressed = md.Simulation(stored.system, LJ, cooler, barostat=barostat(pressure=2.0))
    pressed.engine.go_on_from(stored.restart)
    with pytest.warns(UserWarning, match=r"pressure=1, .* before, .*pressure=2, .* now"):
        pressed.run(100, every=5, trajectory=path, append=True, progress=False)
    assert read_file(path).barostat == pressed.barostat
    (of_last_part,) = (line for line in check_file(path).report.lines if line.name == "pressure")
    record = read_file(path).record
    mean = with_error(*mean_and_error(record.pressure[record.step >= 20]))
    assert of_last_part.summary == f"{mean} ε/σ³ on average, 2 wanted"


def test_a_scene_with_a_barostat_is_cooled_in_its_file(here):
    bath = 'method = "langevin-baoab"\nrelaxation_time = 1.0\n[barostat]\npressure = 1.0\ncompressibility = 0.05\n'
    scene = melt_scene(4, 10, f"{bath}relaxation_time = 2.0\n")
    hot, cold = (scene_of(scene.replace("temperature = 1.44", f"temperature = {t}")) for t in (0.8, 0.6))
    run_scene(hot, trajectory=here / "a.h5md", tell=lambda _: None)
    lines = []
    resume_run("a.h5md", 10, scene=cold, tell=lines.append)
    assert any("temperature 0.6 ε/k_B" in line for line in lines)
    assert read_file("a.h5md").parameters["temperature"] == 0.6


def test_the_lines_of_a_run_are_in_the_units_that_scenes_take(here):
    """Bar and ps, of a scene in bar and ps; and the units of the numbers of a potential are told."""
    text = ARGON.read_text() + "[barostat]\npressure_bar = 25.0\ncompressibility_per_bar = 2e-4\n"
    scene = scene_of(text + "relaxation_time_fs = 2000.0\n")
    lines = dict(scene.simulation().engine.scene_in_words())
    assert "pressure 25 bar, compressibility 0.0002 per bar, relaxation time 2 ps" in lines["barostat"]
    assert "98.227 make a ps" in lines["units"]


def test_a_pressure_is_reached_within_three_standard_errors():
    noise = np.random.default_rng(1).normal(size=200)
    mean, error = mean_and_error(noise)
    for n_errors, is_reached in ((0.0, True), (2.5, True), (-3.43, False), (6.0, False)):
        pressure = 1.0 + noise - mean + n_errors * error
        record = record_of(np.full(200, 2.0), pressure=pressure, volume=100.0 + 0.1 * noise)
        lines = tuple(pressure_lines(record, 1.0, barostat(), False))
        report = conservation_report(record, angular=False, lines=lines)
        assert [line.is_good for line in report.lines] == [True, True, is_reached]
        assert report.is_far_from_pressure is not is_reached
    for n_atoms, of_center in ((8, 0.5), (1, 0.0)):  # is added where it is left out
        record = record_of(np.full(40, 2.0), n_atoms, volume=np.full(40, 2.0), pressure=np.full(40, 1.25))
        _, density, pressure = map(str, pressure_lines(record, 1.0, barostat(), True))
        assert f" {with_error(1.25 + of_center, 0.0)} " in pressure
        assert f" {with_error(n_atoms / 2.0, 0.0)} atoms/σ³ " in density
    record.units = md.units.ASE
    _, density, _ = map(str, pressure_lines(record, 2.0 * GRAM_PER_CM3, barostat(), True))
    assert f" {with_error(1.0, 0.0)} g/cm³ " in density


@pytest.mark.parametrize("coupling", ["isotropic", "triclinic", "xyz", "z"])
def test_the_pressure_is_compared_unless_some_lengths_of_the_cell_are_constant(coupling):
    flat = np.ones(40) + 0.01 * np.random.default_rng(1).normal(size=40)
    record = record_of(np.full(40, 2.0), volume=flat, pressure=flat)
    names = [line.name for line in pressure_lines(record, 1.0, barostat(coupling=coupling), False)]
    assert ("pressure" in names) is (coupling != "z")


VOLUMES = {  # of (T,) times in units of the run
    "it collapses at the start": lambda t: 1.0 + 0.4 * np.exp(-t / 0.05),
    "it relaxes": lambda t: 1.0 + 0.3 * np.exp(-t / 0.3),
    "it grows steadily": lambda t: 1.0 + 0.2 * t,
    "it collapses at the end": lambda t: 1.0 - 0.3 * (t > 0.85),
    "it fluctuates": lambda t: 1.0 + 0.0 * t,
    "a small gas fluctuates": lambda t: 1.0 + 0.2 * processes(1, len(t), 0.7, np.random.default_rng(3))[:, 0],
    "it has settled at the start": lambda t: 1.0 + 0.4 * np.exp(-t / 0.01),
}


@pytest.mark.parametrize("name", VOLUMES)
def test_a_volume_that_still_changes_is_no_success_whatever_the_mean_pressure_is(name):
    t = np.linspace(0.0, 1.0, 200)
    noise = 0.005 * processes(1, len(t), 0.5, np.random.default_rng(2))[:, 0]
    record = record_of(np.full(200, 2.0), volume=VOLUMES[name](t) + noise, pressure=1.0 + noise)
    lines = tuple(pressure_lines(record, 1.0, barostat(), False))
    report = conservation_report(record, angular=False, lines=lines)
    changes = name.startswith(("it collapses", "it relaxes", "it grows"))
    assert report.is_far_from_pressure is changes
    assert report.energy_is_conserved
    check = FileCheck("", [], report, [])
    assert check.passed is not changes
    assert ("NOT REACHED" in str(check)) is changes
    assert ("far from its pressure" in check.outcome) is changes


def test_every_file_has_the_cell_of_every_frame(tmp_path):
    simulation = at_pressure("dumbbells", coupling="triclinic")
    names = [tmp_path / f"run.{suffix}" for suffix in ("h5md", "extxyz", "traj", "xtc", "dcd", "trr", "ncdf")]
    record = simulation.run(40, every=10, progress=False, trajectory=names)
    assert np.ptp(record.volume) > 0.0
    for name in names[:3]:
        cells = np.array([frame.cell.array for frame in ase.io.read(name, ":")])
        assert cells == pytest.approx(record.cell, rel=0.0, abs=1e-7 if name.suffix == ".extxyz" else 0.0)
    topology = MDAnalysis.Universe.empty(len(simulation.system), trajectory=False)._topology
    universes = [universe_of(names[0]), *(MDAnalysis.Universe(topology, str(one)) for one in names[3:])]
    for name, universe in zip([names[0], *names[3:]], universes, strict=True):
        volumes = [float(ts.volume) for ts in universe.trajectory]
        assert volumes == pytest.approx(record.volume, rel=1e-4 if name.suffix == ".xtc" else 1e-6)  # float32


@pytest.mark.filterwarnings("ignore:the barostat acts")
def test_a_sheared_crystal_without_heat_finds_the_lattice_constant_of_least_energy():
    positions, edges = md.lattice.crystal("fcc", [3, 3, 3], 1.6)
    shear = np.array([[1.0, 0.0, 0.0], [0.05, 1.02, 0.0], [-0.03, 0.02, 0.99]])
    cold = {"pressure": 0.0, "temperature": 0.0, "coupling": "triclinic", "compressibility": 0.02}
    slow = barostat(**cold, relaxation_time=0.003, every=1)
    sheared = md.System(positions @ shear, cell=np.diag(edges) @ shear)
    simulation = md.Simulation(sheared, LJ, md.VelocityVerlet(0.001), barostat=slow)
    simulation.run(250, every=250, progress=False)

    def energy(constant):
        at, box = md.lattice.crystal("fcc", [3, 3, 3], constant)
        return md.evaluate(md.System(at, cell=box), LJ).potential_energy

    least = minimize_scalar(energy, bounds=(1.4, 1.7), method="bounded", options={"xatol": 1e-9}).x
    assert simulation.system.cell.vectors / 3.0 == pytest.approx(least * np.eye(3), abs=1e-6)
    assert simulation.system.cell.vectors[np.triu_indices(3, 1)].tolist() == [0.0, 0.0, 0.0]


def test_what_evaporates_at_a_negative_pressure_is_told():
    """A dilute system grows without end: the barostat is the cause, in the message and in both reports."""
    simulation = atom_with_clock(pressure=-1.0, compressibility=1.0, relaxation_time=6.0)
    with pytest.raises(md.NonFiniteError, match=r"from 27 to 2\d\d.* pressure -1 ") as caught:
        simulation.run(1000, every=1000, progress=False)
    assert caught.value.crash_report.kind == "barostat"
    assert simulation.system.volume < 300.0
    record = record_of(np.ones(20), volume=np.geomspace(1.0, 9.0, 20), pressure=np.ones(20))  # of a file
    for is_ramp in (False, True):
        assert "EVAPORATED" in str(next(pressure_lines(record, 1.0, barostat(), False, is_ramp)))


@pytest.mark.parametrize("make", [lambda: SCENES["dumbbells"]()[:3], wrapped_dumbbells], ids=["whole", "wrapped"])
def test_displacements_of_rigid_molecules_are_those_beside_the_motion_of_their_centers(make):
    """A strain alone, which moves centers, is no displacement; of molecules that lie across the boundary, too."""
    system, laws, constraints = make()
    bath = barostat(temperature=0.8, coupling="triclinic")
    engine = md.Simulation(system, laws, md.VelocityVerlet(0.003), constraints, barostat=bath).engine
    looking, volume = md.observers.MeanSquareDisplacement(every=1), engine.system.volume
    parts = engine.barostat, engine.system, engine.interactions, engine.constraint_set, engine.method
    rescaling = rescaling_of(*parts, holds_center=False)

    def follow():
        engine.interactions.follow()
        engine.enter()
        return engine.evaluate()

    looking.prepare(engine)
    for _ in range(4):
        sums = engine.evaluate()
        looking.observe(engine)
        rescaling.apply(engine.method, engine.step, engine.surroundings.bath, sums, follow)
        engine.count(1)
    assert abs(engine.system.volume / volume - 1.0) > 1e-5
    assert looking.result().msd == pytest.approx(0.0, abs=1e-24)  # rounding


def test_what_cannot_be_at_constant_pressure_is_refused():
    system, law, _ = KINDS["clusters"]()
    flat = md.System(system.positions, cell=system.cell.vectors, pbc=[True, True, False])
    usual = {"system": system, "potentials": law, "method": md.VelocityVerlet(0.003)}
    usual["barostat"] = barostat(temperature=1.0)
    simulation = lambda **changes: md.Simulation(**usual | changes)  # noqa: E731
    for call, error, *shown in [
        (lambda: simulation(system=flat), ValueError, "barostat", "periodic"),
        (lambda: simulation(constraints=md.FixedAtoms([3])), ValueError, "barostat", "fixed"),
        (lambda: simulation(barostat=barostat()), ValueError, "temperature"),
        (lambda: simulation(method=md.LangevinBAOAB(0.003, 0.5, 1.0, 1)), ValueError, "temperature", "0.5"),
        (lambda: simulation(precision="fixed-point"), ValueError, "constant cell"),
        (lambda: simulation(method=md.VelocityVerlet(-0.003)), ValueError, "backwards", "-0.003"),
        (lambda: simulation(barostat=1.0), TypeError, "barostat", "1.0"),
        (lambda: simulation().probe_reversibility(10), ValueError, "barostat"),
        (lambda: barostat(coupling="sideways"), ValueError, "coupling", "'sideways'"),
    ]:
        assert_answered(call, error, *shown)
    with pytest.warns(UserWarning, match="acts every 5 steps"):
        simulation(barostat=barostat(temperature=1.0, relaxation_time=0.02)).run(5, progress=False)


@slow
def test_a_scene_has_a_barostat_in_bar(here):
    bath = "pressure_bar = 50.0\ncompressibility_per_bar = 2e-4\nrelaxation_time_fs = 1500.0\nevery = 25\n"
    text = ARGON.read_text().replace("[6, 6, 6]", "[3, 3, 3]").replace("8.5", "7.0").replace("= 4000", "= 10")
    (here / "npt.toml").write_text(f"{text}\n[barostat]\n{bath}")
    simulation = run_scene(load_scene("npt.toml"), steps=50, tell=lambda _: None, progress=False)
    assert simulation.barostat.pressure == pytest.approx(50.0 * md.units.BAR)
    resumed = md.Simulation.resume("argon.h5md")
    assert resumed.barostat == simulation.barostat
    assert np.array_equal(resumed.system.cell.vectors, simulation.system.cell.vectors)
