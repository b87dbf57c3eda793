"""Stochastic cell rescaling: its equations, and what follows the cell."""

import pickle
from dataclasses import replace

import numpy as np
import pytest
import step_scenes
from scipy.optimize import minimize_scalar

import minimd as md
from minimd.analysis.check import check_file
from minimd.diagnosis.report import conservation_report
from minimd.diagnosis.run_report import pressure_lines
from minimd.engine.cell_rescaling import rescaling_of
from minimd.engine.record import Record
from minimd.integrators.splitting.barostats import ThermodynamicState
from minimd.observers.fluctuations import FEWEST
from minimd.structure.cell import Cell
from minimd.structure.statistics import mean_and_error, with_error

COUPLINGS = ["isotropic", "z", "xy", "triclinic"]


def barostat(**changes):
    return md.StochasticCellRescaling(
        **{"pressure": 1.0, "compressibility": 0.05, "relaxation_time": 0.5, "seed": 3, "every": 5} | changes
    )


def wrapped_dumbbells():
    """Rigid dumbbells, many of which lie across the boundary."""
    system, laws, constraints = step_scenes.rigid_dumbbells()
    positions = system.cell.wrapped(system.positions + 0.9)
    return md.System(positions, cell=system.cell, masses=system.masses, bonds=system.bonds), laws, constraints


SCENE = """
[structure]
lattice = "fcc"
element = "Ar"
repeat = [3, 3, 3]
density_g_cm3 = 1.374

[[potential]]
type = "lennard-jones"
epsilon_K = 120.0
sigma_A = 3.4
cutoff_A = 7.0

[dynamics]
timestep_fs = 5.0
steps = 50
temperature_K = 94.4

[barostat]
pressure_bar = 50.0
compressibility_per_bar = 2e-4
relaxation_time_fs = 1500.0
every = 25
"""
SCENES = {"pair list": lambda: step_scenes.fcc(1.7), "bonds": step_scenes.bead_melt, "dumbbells": wrapped_dumbbells}


def at_pressure(scene, method=None, temperature=0.8, **changes):
    system, laws, constraints = SCENES[scene]()
    simulation = md.Simulation(
        system,
        laws,
        method or md.LangevinBAOAB(0.003, temperature, 1.0, 2),
        constraints,
        barostat=barostat(**{"temperature": temperature} | changes),
    )
    simulation.set_temperature(temperature, 1)
    return simulation


@pytest.mark.parametrize("coupling", COUPLINGS)
def test_strain_and_its_conserved_energy_obey_the_fluctuation_theorem(coupling):
    """⟨f(V′) e^(−ΔH/kT)⟩ = ⟨f(V)⟩ over the isothermal-isobaric ensemble, here of an ideal gas, at any time step: exactly, without an integrator."""
    n, pressure, thermal, duration = 12, 0.7, 1.3, 0.4
    bath = barostat(pressure=pressure, coupling=coupling, compressibility=1.0 / pressure, relaxation_time=1.0)
    rng, changes = np.random.default_rng(5), []
    for number in range(6000):
        volume, momenta = rng.gamma(n + 1) * thermal / pressure, rng.normal(scale=thermal**0.5, size=(n, 3))
        before = ThermodynamicState(momenta.T @ momenta / volume, volume, 0.5 * np.square(momenta).sum(), thermal)
        strain = bath.strain(before, duration, number)
        values, axes = np.linalg.eigh(strain)
        momenta = momenta @ (axes * np.exp(-values)) @ axes.T
        larger = volume * np.exp(values.sum())
        after = ThermodynamicState(momenta.T @ momenta / larger, larger, 0.5 * np.square(momenta).sum(), thermal)
        weight = np.exp(-bath.change_of_conserved(before, after, strain, duration) / thermal)
        changes.append([weight - 1.0, (weight * larger**3 - volume**3) * (pressure / thermal / (n + 1)) ** 3])
    error = np.std(changes, axis=0) / len(changes) ** 0.5
    assert (error > 1e-3).all()  # the step is long
    assert (np.abs(np.mean(changes, axis=0)) < 4.0 * error).all()  # statistics


@pytest.mark.parametrize("coupling", ["isotropic", "triclinic"])
@pytest.mark.parametrize("scene", SCENES)
def test_forces_in_a_strained_cell_are_those_of_new_lists(scene, coupling):
    simulation = at_pressure(scene, coupling=coupling)
    volume = simulation.system.volume
    simulation.run(100, every=50, progress=False)
    assert abs(simulation.system.volume / volume - 1.0) > 1e-4
    if scene != "dumbbells":  # whose cell has no room for a skin
        assert simulation.engine.interactions.n_builds < 20  # of 20 strains
    fresh = md.evaluate(simulation.system, simulation.potentials)
    simulation.frame()
    scale = np.abs(fresh.forces).max()
    assert simulation.forces == pytest.approx(fresh.forces, abs=1e-12 * scale)  # rounding
    assert simulation.potential_energy == pytest.approx(fresh.potential_energy, rel=1e-12)


@pytest.mark.parametrize("coupling", ["isotropic", "z", "triclinic"])
@pytest.mark.parametrize("scene", SCENES)
def test_what_the_barostat_gives_is_what_the_energy_gains(scene, coupling):
    """Without noise and far from the pressure, H is kept while E changes: the virial, of molecules too, is the derivative of the energy."""
    simulation = at_pressure(
        scene, md.VelocityVerlet(0.0005), 0.5, pressure=30.0, relaxation_time=0.25, coupling=coupling, every=2
    )
    record = simulation.run(60, every=2, progress=False)
    enthalpy = record.total_energy + 30.0 * record.volume
    assert np.ptp(record.volume) > 0.002 * record.volume[0]
    assert np.ptp(record.conserved_energy) < 0.02 * np.ptp(enthalpy) + 0.02 * np.ptp(record.total_energy)
    if scene == "dumbbells":
        assert record.constraint_violation.max() < 1e-12


class Clock(md.Term):
    """No force; remembers the times of evaluations with energy."""

    depends_on_time = True

    def __init__(self):
        self.times = []

    def bind(self, system):
        return self

    def add(self, system, detail, forces, energies, virials):
        self.times += [round(self.time, 9)] if detail else []


def atom_with_clock(**changes):
    clock, bath = Clock(), barostat(**{"temperature": 0.8, "relaxation_time": 50.0} | changes)
    return md.Simulation(
        md.System([[0.0, 0.0, 0.0]], cell=[3.0] * 3), clock, md.VelocityVerlet(0.1), barostat=bath
    ), clock


def test_forces_that_depend_on_time_are_those_of_the_step_of_the_strain():
    simulation, clock = atom_with_clock()
    simulation.run(10, every=10, progress=False)
    assert clock.times == [0.0, 0.5, 0.5, 1.0, 1.0]


def test_heat_capacity_and_expansion_at_the_pressure_of_the_barostat():
    simulation, looking = atom_with_clock()[0], md.observers.Fluctuations(every=5)
    simulation.velocities[:] = 0.5, -1.0, 0.7
    record = simulation.run(40, every=5, observers=[looking], progress=False)
    enthalpy, volume, found = record.total_energy + record.volume, record.volume, looking.result()
    grown = 1.0 + 2.0 / FEWEST  # the part that variances miss in so short a run
    assert found.heat_capacity_p == pytest.approx(grown * enthalpy.var() / 0.8**2)
    assert found.expansion == pytest.approx(grown * np.cov(enthalpy, volume, ddof=0)[0, 1] / (0.8**2 * volume.mean()))


@pytest.mark.parametrize(
    "method",
    [md.LangevinBAOAB(0.003, 0.8, 1.0, 2), md.StochasticVelocityRescaling(0.003, 0.8, 0.1, 2)],
    ids=lambda one: one.name,
)
def test_a_file_tells_volume_and_pressure_as_the_report_does_with_the_error_of_a_mean(method, tmp_path):
    simulation = at_pressure("pair list", method)
    record = simulation.run(200, every=5, trajectory=tmp_path / "a.h5md", progress=False)
    told, found = (
        [str(line) for line in one.lines if line.name in ("volume", "pressure")]
        for one in (simulation.report(), check_file(tmp_path / "a.h5md").report)
    )
    center = (
        0.0 if method.name == "langevin-baoab" else 2.0 * record.kinetic_energy / (simulation.n_dof * record.volume)
    )
    assert found == told
    assert f" {with_error(*mean_and_error(record.pressure + center))} " in told[1]
    assert told[1].endswith(("wanted: reached", "NOT REACHED; equilibrate longer"))


def judged(pressure, volume, energy):
    """The report of a run with a barostat at pressure 1, from its series."""
    n = len(pressure)
    flat, none = np.ones(n), np.zeros((n, 3))
    series = {
        "step": np.arange(n),
        "time": np.arange(float(n)),
        "pressure": pressure,
        "volume": volume,
        "temperature": flat,
    }
    series |= {"potential_energy": flat, "kinetic_energy": flat, "total_energy": 2.0 * flat, "conserved_energy": energy}
    series |= {"momentum": none, "angular_momentum": none, "absolute_momentum": flat, "absolute_angular_momentum": flat}
    record = Record.of(md.units.LJ, 8, series)
    return conservation_report(record, angular=False, lines=tuple(pressure_lines(record, barostat(), False)))


@pytest.mark.parametrize(
    ("n_errors", "is_reached"), [(0.0, True), (2.5, True), (-3.43, False), (3.43, False), (6.0, False)]
)
def test_a_pressure_is_reached_within_three_standard_errors(n_errors, is_reached):
    """3.43 : 1.48 ± 0.14, 1 wanted."""
    noise = np.random.default_rng(1).normal(size=200)
    mean, error = mean_and_error(noise)
    report = judged(1.0 + noise - mean + n_errors * error, 100.0 + 0.1 * noise, np.ones(200))
    assert [line.is_good for line in report.lines] == [True, is_reached]
    for name in ("pressure", "P"):  # no name decides
        assert (
            replace(report, lines=tuple(replace(line, name=name) for line in report.lines)).is_far_from_pressure
            is not is_reached
        )


@pytest.mark.parametrize("where", ["volume", "pressure", "neither"])
def test_an_energy_that_drifts_on_the_way_to_a_pressure_is_not_blamed_on_the_step(where):
    """The volume grows by a quarter as exp(−t) does; or the pressure is 3 for 1."""
    rng = np.random.default_rng(1)
    volume = (
        100.0 + rng.normal(size=200) + (25.0 * (1.0 - np.exp(-np.arange(200.0) / 40.0)) if where == "volume" else 0.0)
    )
    pressure = rng.normal(size=200) + (3.0 if where == "pressure" else 1.0)
    report = judged(pressure, volume, np.arange(200.0) + 0.01 * rng.normal(size=200))
    assert report.energy_is_conserved is False
    assert report.is_far_from_pressure is (where != "neither")
    assert ("reduce the time step" in report.verdict) is (where == "neither")
    assert ("the volume changed" in report.verdict) is (where == "volume")


def test_a_file_tells_that_a_liquid_has_evaporated():
    series = {"volume": np.geomspace(1.0, 9.0, 20), "pressure": np.ones(20)}
    (line,) = pressure_lines(
        Record.of(md.units.LJ, 8, {"step": np.arange(20), "time": np.arange(20.0)} | series), barostat(), False
    )
    assert "EVAPORATED" in str(line)


@pytest.mark.parametrize(("n_atoms", "center"), [(8, 0.5), (1, 0.0)])
def test_the_pressure_of_the_center_of_mass_is_added_where_it_is_left_out(n_atoms, center):
    series = {"volume": np.full(40, 2.0), "pressure": np.full(40, 1.25), "temperature": np.ones(40)}
    record = Record.of(md.units.LJ, n_atoms, {"step": np.arange(40), "time": np.arange(40.0)} | series)
    assert f" {with_error(1.25 + center, 0.0)} " in str(list(pressure_lines(record, barostat(), True))[1])


def test_fluctuations_belong_to_one_bath():
    looking = md.observers.Fluctuations()
    simulation = md.Simulation(md.System([[0.0, 0.0, 0.0]]), Clock(), md.LangevinBAOAB(0.1, 0.8, 1.0, 2))
    looking.prepare(simulation.engine)
    simulation.method = md.LangevinBAOAB(0.1, 0.9, 1.0, 2)
    with pytest.raises(ValueError, match="another system, or one with another time step or bath"):
        looking.prepare(simulation.engine)


def test_a_cell_that_is_opened_between_two_runs_is_refused():
    simulation, _ = atom_with_clock()
    simulation.run(5, progress=False)
    simulation.system.cell = Cell(simulation.system.cell.vectors, [True, True, False])
    with pytest.raises(ValueError, match=r"periodic in all three directions \(for a slab"):
        simulation.make_steps(5)


@pytest.mark.parametrize("scene", SCENES)
def test_a_run_goes_on_with_the_same_bits(scene, tmp_path):
    def made():
        return at_pressure(scene, coupling="triclinic")

    whole = made()
    record = whole.run(80, every=10, progress=False)
    parts, file = made(), tmp_path / "run.h5md"
    parts.run(33, every=10, progress=False, trajectory=file)
    copy = pickle.loads(pickle.dumps(parts))
    resumed = md.Simulation.resume(file, parts.potentials)
    assert resumed.barostat == whole.barostat
    for other in (parts, copy, resumed):
        other.run(until_step=80, every=20, progress=False)
        for name in ("positions", "velocities", "reservoir_energy"):
            assert np.array_equal(getattr(other, name), getattr(whole, name)), name
        assert np.array_equal(other.system.cell.vectors, record.cell[-1])


def test_every_file_has_the_cell_of_every_frame(tmp_path):
    import ase.io
    import MDAnalysis

    import minimd.mdanalysis

    simulation = at_pressure("dumbbells", coupling="triclinic")
    names = [f"run.{suffix}" for suffix in ("h5md", "extxyz", "traj", "xtc", "dcd", "trr", "ncdf")]
    record = simulation.run(40, every=10, progress=False, trajectory=[tmp_path / name for name in names])
    assert np.ptp(record.volume) > 0.0
    for name in names[:3]:
        frames = ase.io.read(tmp_path / name, ":")
        cells = np.array([frame.cell.array for frame in frames])
        assert cells == pytest.approx(record.cell, rel=0.0, abs=1e-7 if name.endswith("xyz") else 0.0)
    topology = MDAnalysis.Universe.empty(len(simulation.system), trajectory=False)
    for name in ["run.h5md", *names[3:]]:
        universe = (
            minimd.mdanalysis.universe(tmp_path / name)
            if name.endswith("h5md")
            else MDAnalysis.Universe(topology._topology, str(tmp_path / name))
        )
        volumes = [float(ts.volume) for ts in universe.trajectory]
        assert volumes == pytest.approx(record.volume, rel=1e-4 if name.endswith("xtc") else 1e-6)  # float32


@pytest.mark.filterwarnings("ignore:the barostat acts")
def test_a_sheared_crystal_without_heat_finds_the_lattice_constant_of_least_energy():
    positions, edges = md.lattice.crystal("fcc", [3, 3, 3], 1.6)
    shear = np.array([[1.0, 0.0, 0.0], [0.05, 1.02, 0.0], [-0.03, 0.02, 0.99]])
    law = md.LennardJones(1.0, 1.0, cutoff=2.2, truncation="switched")
    slow = barostat(
        pressure=0.0, temperature=0.0, coupling="triclinic", compressibility=0.02, relaxation_time=0.003, every=1
    )
    simulation = md.Simulation(
        md.System(positions @ shear, cell=np.diag(edges) @ shear), law, md.VelocityVerlet(0.001), barostat=slow
    )
    simulation.run(150, every=150, progress=False)

    def energy(constant):
        at, box = md.lattice.crystal("fcc", [3, 3, 3], constant)
        return md.evaluate(md.System(at, cell=box), law).potential_energy

    least = minimize_scalar(energy, bounds=(1.4, 1.7), method="bounded", options={"xatol": 1e-9}).x
    assert simulation.system.cell.vectors / 3.0 == pytest.approx(least * np.eye(3), abs=1e-6)
    assert simulation.system.cell.vectors[np.triu_indices(3, 1)].tolist() == [0.0, 0.0, 0.0]


def test_one_axis_alone_changes():
    record = at_pressure("pair list", coupling="z").run(40, every=40, progress=False)
    first, last = record.cell[0], record.cell[-1]
    assert np.array_equal(first[:2], last[:2])
    assert last[2, 2] != first[2, 2]


def test_what_evaporates_at_a_negative_pressure_is_told():
    """A dilute system, which would grow without end: the barostat is the cause, in the message and in the report of the crash."""
    simulation, _ = atom_with_clock(pressure=-1.0, compressibility=1.0, relaxation_time=6.0)
    with pytest.raises(
        md.NonFiniteError, match=r"cell has grown from 27 to 2\d\d.* at pressure -1 .* take a pressure above zero"
    ) as caught:
        simulation.run(1000, every=1000, progress=False)
    found = caught.value.crash_report
    assert found.kind == "barostat"
    assert "no dense state exists" in found.cause
    assert simulation.system.volume < 300.0
    gas = at_pressure("pair list", temperature=3.0, pressure=1e-3, compressibility=1.0, relaxation_time=0.2)
    gas.run(1500, every=50, progress=False)
    assert "EVAPORATED" in str(gas.report())


def test_displacements_of_rigid_molecules_are_those_beside_the_motion_of_their_centers():
    """A strain alone, which moves centers, is no displacement; of molecules that lie across the boundary, too."""
    for make in (step_scenes.rigid_dumbbells, wrapped_dumbbells):
        system, laws, constraints = make()
        simulation = md.Simulation(
            system,
            laws,
            md.VelocityVerlet(0.003),
            constraints,
            barostat=barostat(temperature=0.8, coupling="triclinic"),
        )
        engine, looking, volume = (
            simulation.engine,
            md.observers.MeanSquareDisplacement(every=1),
            simulation.system.volume,
        )
        rescaling = rescaling_of(
            engine.barostat,
            engine.system,
            engine.interactions,
            engine.constraint_set,
            engine.method,
            holds_center=False,
        )

        def forces_follow(engine=engine):
            engine.moved()
            engine.interactions.follow()
            engine.evaluate()

        looking.prepare(engine)
        engine.evaluate()
        for _ in range(4):
            looking.observe(engine)
            rescaling.apply(engine.method, engine.step, engine.surroundings.bath, forces_follow)
            engine.count(1)
        assert abs(engine.system.volume / volume - 1.0) > 1e-5
        assert looking.result().msd == pytest.approx(0.0, abs=1e-24)  # rounding


def test_what_cannot_be_at_constant_pressure_is_refused():
    system, law, _ = step_scenes.fcc(1.7)
    verlet, bath = md.VelocityVerlet(0.003), barostat(temperature=1.0)
    flat = md.System(system.positions, cell=system.cell.vectors, pbc=[True, True, False])
    for arguments, options, words in [
        ((flat, law, verlet), {"barostat": bath}, "periodic in all three directions"),
        ((system, law, verlet, md.FixedAtoms([3])), {"barostat": bath}, "held fixed"),
        ((system, law, verlet), {"barostat": barostat()}, "needs temperature"),
        ((system, law, md.LangevinBAOAB(0.003, 0.5, 1.0, 1)), {"barostat": bath}, "the same temperature"),
        ((system, law, verlet), {"barostat": bath, "precision": "fixed-point"}, "constant cell"),
        ((system, law, md.VelocityVerlet(-0.003)), {"barostat": bath}, "backwards"),
    ]:
        with pytest.raises(ValueError, match=words):
            md.Simulation(*arguments, **options)
    with pytest.raises(ValueError, match="coupling"):
        barostat(coupling="sideways")
    with pytest.raises(TypeError, match="StochasticCellRescaling"):
        md.Simulation(system, law, verlet, barostat=1.0)
    with pytest.raises(ValueError, match="there is a barostat"):
        md.Simulation(system, law, verlet, barostat=bath).probe_reversibility(10)
    with pytest.warns(UserWarning, match="acts every 5 steps"):
        md.Simulation(system, law, verlet, barostat=barostat(temperature=1.0, relaxation_time=0.02)).run(
            5, progress=False
        )


def test_a_scene_has_a_barostat_in_bar(tmp_path, monkeypatch):
    from minimd.scene import load_scene, run_scene

    monkeypatch.chdir(tmp_path)
    (tmp_path / "npt.toml").write_text(SCENE)
    lines = []
    simulation = run_scene(load_scene("npt.toml"), tell=lines.append, progress=False)
    assert simulation.barostat.pressure == pytest.approx(50.0 * md.units.BAR)
    assert "barostat" in "\n".join(lines)
    resumed = md.Simulation.resume("npt.h5md")
    assert resumed.barostat == simulation.barostat
    assert np.array_equal(resumed.system.cell.vectors, simulation.system.cell.vectors)
