"""Scene files: the simulation they make is physically what their keys say, and what is wrong is said in one sentence each."""

from pathlib import Path

import numpy as np
import pytest
from scene_texts import ARGON, REDUCED, scene_of

import minimd as md
from minimd.files.h5md_reader import read_file
from minimd.integrators import THERMOSTATS, LangevinBAOAB
from minimd.integrators.splitting.thermostats import Thermostat
from minimd.scene import load_scene, run_scene
from minimd.scene.section import KEY_UNITS
from minimd.structure.lattice import BASES, constant_from_density, crystal

# SI values, independent of minimd.units (CODATA 2018; minimd has ASE's of 2014, equal to 1e-6)
ATOMIC_MASS, ELECTRON_VOLT, BOLTZMANN, ANGSTROM = 1.66053906660e-27, 1.602176634e-19, 1.380649e-23, 1e-10
TIME_UNIT = ANGSTROM * np.sqrt(ATOMIC_MASS / ELECTRON_VOLT)  # s
CODATA = (
    1e-6  # relative, always with abs=0: approx would take every number of SI size for zero; what two editions differ by
)
MOLECULE = """
[structure]
file = "bent.xyz"
bonds = [[0, 1], [1, 2]]
[[potential]]
type = "harmonic-bond"
k_eV_A2 = 20.0
length_A = 1.0
[[potential]]
type = "harmonic-angle"
k_eV_rad2 = 3.0
angle_degree = 120.0
triples = [[0, 1, 2]]
[dynamics]
timestep_fs = 0.5
steps = 10
"""


def bent_molecule(folder):
    """Two arms of 1.1 Å and 0.9 Å at a right angle."""
    (folder / "bent.xyz").write_text("3\n\nH 1.1 0 0\nO 0 0 0\nH 0 0.9 0\n")
    return folder / "scene.toml"


def test_argon_scene_is_rahmans_argon():
    simulation = load_scene(ARGON).simulation()
    system = simulation.system
    assert len(system) == 864
    assert system.species_names == ("Ar",)
    assert np.all(system.masses == 39.948)
    density = 864 * 39.948 * ATOMIC_MASS / (system.volume * ANGSTROM**3)  # kg/m³
    assert density == pytest.approx(1374.0, rel=CODATA, abs=0.0)
    assert simulation.method.timestep * TIME_UNIT == pytest.approx(10e-15, rel=CODATA, abs=0.0)


def test_argon_scene_draws_velocities_of_94_kelvin():
    system = load_scene(ARGON).simulation().system
    kinetic = 0.5 * 39.948 * np.sum(system.velocities**2) * ELECTRON_VOLT
    assert 2.0 * kinetic / (3 * 863 * BOLTZMANN) == pytest.approx(94.4, rel=CODATA, abs=0.0)
    assert np.abs(system.velocities.mean(axis=0)).max() < 1e-15  # rounding


def test_argon_potential_has_its_well_at_120_kelvin():
    (potential,) = load_scene(ARGON).potentials()
    pair = md.System([[0.0, 0.0, 0.0], [2 ** (1 / 6) * 3.4, 0.0, 0.0]], masses=1.0, units=md.units.ASE)
    depth, slope = 4 * (2.5**-12 - 2.5**-6), 4 * (-12 * 2.5**-13 + 6 * 2.5**-7)  # u(r_c)/ε, u′(r_c) σ/ε
    expected = -1.0 - depth - (2 ** (1 / 6) - 2.5) * slope  # force-shifted at 2.5 σ
    found = md.evaluate(pair, potential).potential_energy * ELECTRON_VOLT / BOLTZMANN
    assert found == pytest.approx(120.0 * expected, rel=CODATA, abs=0.0)


@pytest.mark.parametrize(
    ("dimension", "ending", "si"),
    [
        ("length", "_A", ANGSTROM),
        ("time", "_fs", 1e-15),
        ("temperature", "_K", 1.0),
        ("energy", "_eV", ELECTRON_VOLT),
        ("energy", "_K", BOLTZMANN),
        ("force", "_eV_A", ELECTRON_VOLT / ANGSTROM),
        ("density", "_g_cm3", 1000.0),
        ("stiffness", "_eV_A2", ELECTRON_VOLT / ANGSTROM**2),
        ("angular stiffness", "_eV_rad2", ELECTRON_VOLT),
        ("angle", "_degree", np.pi / 180),
        ("inverse length", "_per_A", 1.0 / ANGSTROM),
        ("velocity", "_A_ps", ANGSTROM / 1e-12),
        ("acceleration", "_A_ps2", ANGSTROM / 1e-24),
        ("pressure", "_bar", 1e5),
        ("pressure", "_GPa", 1e9),
        ("compressibility", "_per_bar", 1e-5),
        ("compressibility", "_per_GPa", 1e-9),
    ],
)
def test_every_unit_in_a_key_has_its_size(dimension, ending, si):
    engine = {
        "length": ANGSTROM,
        "time": TIME_UNIT,
        "energy": ELECTRON_VOLT,
        "force": ELECTRON_VOLT / ANGSTROM,
        "density": ATOMIC_MASS / ANGSTROM**3,
        "stiffness": ELECTRON_VOLT / ANGSTROM**2,
        "angular stiffness": ELECTRON_VOLT,
        "inverse length": 1.0 / ANGSTROM,
        "velocity": ANGSTROM / TIME_UNIT,
        "acceleration": ANGSTROM / TIME_UNIT**2,
        "pressure": ELECTRON_VOLT / ANGSTROM**3,
        "compressibility": ANGSTROM**3 / ELECTRON_VOLT,
    }
    assert KEY_UNITS["ASE"][dimension][ending] * engine.get(dimension, 1.0) == pytest.approx(si, rel=CODATA, abs=0.0)


def test_every_unit_in_a_key_is_tested_above():
    (marker,) = test_every_unit_in_a_key_has_its_size.pytestmark
    tested = {(dimension, ending) for dimension, ending, _ in marker.args[1]}
    assert tested == {(dimension, ending) for dimension, endings in KEY_UNITS["ASE"].items() for ending in endings}


def test_reduced_scene_is_the_same_as_a_script():
    scene = scene_of(REDUCED)
    simulation = scene.simulation()
    edge = 4 * (4 / 0.8442) ** (1 / 3)
    assert simulation.system.cell.vectors == pytest.approx(edge * np.eye(3))
    system = md.System(simulation.system.positions, cell=edge)
    script = md.Simulation(system, md.LennardJones(1.0, 1.0, 2.5), md.VelocityVerlet(0.004))
    script.set_temperature(1.44, seed=3)
    ours, theirs = (run.run(20, every=5).total_energy for run in (simulation, script))
    assert ours == pytest.approx(theirs, rel=1e-12)  # rounding: the two edges differ by an ulp


def test_structure_file_is_read_beside_the_scene_with_its_velocities(tmp_path, monkeypatch):
    from ase import Atoms
    from ase.io import write

    atoms = Atoms(
        "ArKr", [[0, 0, 0], [4.0, 0, 0]], cell=[30, 30, 30], pbc=True, momenta=[[1.0, 2.0, 3.0], [0.0, -1.0, 0.5]]
    )
    write(tmp_path / "pair.traj", atoms)
    text = (
        '[structure]\nfile = "pair.traj"\n[[potential]]\ntype = "lennard-jones"\nepsilon_K = 120\nsigma_A = 3.4\ncutoff_A = 8.5\n'
        "[dynamics]\ntimestep_fs = 1\nsteps = 1\n"
    )
    (tmp_path / "scene.toml").write_text(text)
    monkeypatch.chdir("/")
    system = load_scene(tmp_path / "scene.toml").simulation().system
    assert system.species.tolist() == ["Ar", "Kr"]
    assert system.masses == pytest.approx([39.948, 83.798])
    assert system.velocities * system.masses[:, None] == pytest.approx(atoms.get_momenta())
    assert system.cell.pbc.all()


def test_cell_and_pbc_of_a_scene_replace_those_of_the_file(tmp_path):
    text = MOLECULE.replace(
        'file = "bent.xyz"', 'file = "bent.xyz"\ncell_A = [12.0, 13.0, 14.0]\npbc = [true, false, true]'
    )
    system = scene_of(text, bent_molecule(tmp_path)).system()
    assert system.cell.vectors == pytest.approx(np.diag([12.0, 13.0, 14.0]))
    assert system.cell.pbc.tolist() == [True, False, True]


def test_bonds_and_angles_have_the_energy_of_their_formula(tmp_path):
    scene = scene_of(MOLECULE, bent_molecule(tmp_path))
    found = md.evaluate(scene.system(), scene.potentials()).potential_energy
    expected = 0.5 * 20.0 * (0.1**2 + 0.1**2) + 0.5 * 3.0 * np.radians(120.0 - 90.0) ** 2
    assert found == pytest.approx(expected, rel=1e-12)  # rounding


@pytest.mark.parametrize(
    ("units", "time", "words"),
    [
        (md.units.ASE, 2.5 * md.units.fs, "2.5 fs"),
        (md.units.ASE, -999.9 * md.units.fs, "-999.9 fs"),
        (md.units.ASE, 12345.6 * md.units.ps, "12345.6 ps"),
        (md.units.LJ, 0.004, "0.004 τ"),
        (md.units.LJ, 12345.6, "12345.6 τ"),
    ],
)
def test_times_are_shown_in_the_unit_that_people_use(units, time, words):
    assert units.shown(time) == words


class Third(LangevinBAOAB):
    """A thermostat that is registered by a user."""

    name = "third"

    def __init__(self, timestep, temperature, friction, seed, strength=2.0):
        super().__init__(timestep, temperature, strength * friction, seed)


class Unusual(Third):
    """A thermostat that no relaxation time determines."""

    name = "unusual"
    with_relaxation_time = classmethod(Thermostat.with_relaxation_time.__func__)


def test_every_registered_thermostat_is_built_from_its_own_parameters(monkeypatch):
    monkeypatch.setitem(THERMOSTATS, "third", Third)
    method = scene_of(REDUCED.replace("seed = 3", 'seed = 3\nmethod = "third"\nrelaxation_time = 0.5')).method()
    assert type(method) is Third
    assert (method.timestep, method.temperature, method.friction, method.seed) == (0.004, 1.44, 4.0, 3)


def test_thermostat_that_cannot_be_made_from_a_relaxation_time_is_refused(monkeypatch):
    monkeypatch.setitem(THERMOSTATS, "unusual", Unusual)
    scene = scene_of(REDUCED.replace("seed = 3", 'method = "unusual"\nrelaxation_time = 0.5'))
    with pytest.raises(
        ValueError,
        match=r"^scene\.toml: dynamics: unusual cannot be used in a scene, because it has no with_relaxation_time; run",
    ):
        scene.method()


@pytest.mark.parametrize(
    ("extra", "epsilon", "sigma"),
    [
        ("", np.sqrt(120.0 * 164.0), 0.5 * (3.4 + 3.65)),
        ('mixing = "geometric"', np.sqrt(120.0 * 164.0), np.sqrt(3.4 * 3.65)),
        ('pairs = [{ species = ["Kr", "Ar"], epsilon_K = 150.0, sigma_A = 3.5 }]', 150.0, 3.5),
    ],
)
def test_unlike_pairs_follow_the_mixing_rule_unless_they_are_given(tmp_path, extra, epsilon, sigma):
    text = f"""
[structure]
file = "pair.xyz"
[[potential]]
type = "lennard-jones"
truncation = "truncated"
cutoff_A = 12.0
{extra}
[potential.species.Ar]
epsilon_K = 120.0
sigma_A = 3.4
[potential.species.Kr]
epsilon_K = 164.0
sigma_A = 3.65
[dynamics]
timestep_fs = 1.0
steps = 1
"""
    (tmp_path / "pair.xyz").write_text("2\n\nAr 0 0 0\nKr 4.0 0 0\n")
    scene = scene_of(text, tmp_path / "scene.toml")
    found = md.evaluate(scene.system(), scene.potentials()).potential_energy * ELECTRON_VOLT / BOLTZMANN
    assert found == pytest.approx(4.0 * epsilon * ((sigma / 4.0) ** 12 - (sigma / 4.0) ** 6), rel=CODATA, abs=0.0)


def test_options_of_a_potential_arrive():
    options = 'truncation = "switched"\nswitch_start = 2.0\nbonded_scale = [0, 0, 0.5]\ntail_correction = true\n'
    (potential,) = scene_of(REDUCED.replace("cutoff = 2.5\n", "cutoff = 2.5\n" + options)).potentials()
    assert (potential.truncation, potential.switch_start, potential.bonded_scale, potential.tail_correction) == (
        "switched",
        2.0,
        (0.0, 0.0, 0.5),
        True,
    )


@pytest.mark.parametrize(
    ("lattice", "neighbors", "distance"),
    [("sc", 6, 1), ("bcc", 8, 0.75**0.5), ("fcc", 12, 0.5**0.5), ("diamond", 4, 3**0.5 / 4)],
)
def test_every_lattice_has_its_nearest_neighbors(lattice, neighbors, distance):
    positions, edges = crystal(lattice, (3, 4, 5), 2.0)
    assert len(positions) == 60 * len(BASES[lattice])
    assert edges.tolist() == [6.0, 8.0, 10.0]
    first, d = md.neighbor_list("id", md.System(positions, cell=edges), 2.0 * distance * 1.01)
    assert np.all(np.bincount(first) == neighbors)
    assert d == pytest.approx(2.0 * distance)


@pytest.mark.parametrize("lattice", BASES)
def test_lattice_has_the_density_it_was_asked_for(lattice):
    positions, edges = crystal(lattice, (2, 2, 2), constant_from_density(lattice, density=1.7, mass=3.0))
    assert len(positions) * 3.0 / edges.prod() == pytest.approx(1.7)


def test_equilibration_reaches_its_temperature_and_does_not_count(tmp_path):
    text = REDUCED + "[equilibration]\nsteps = 200\ntemperature = 0.9\nrescale_every = 10\n"
    simulation = run_scene(scene_of(text), steps=0, trajectory=tmp_path / "a.h5md", tell=lambda line: None)
    assert simulation.record.step.tolist() == [0]
    assert simulation.record.temperature[0] == pytest.approx(0.9)


def test_run_writes_what_the_scene_says_and_tells_it(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    told = []
    run_scene(
        scene_of(REDUCED.replace("every = 5", 'every = 5\nforces = true\ntrajectory = ["a.h5md", "b.extxyz"]')),
        tell=told.append,
    )
    contents = read_file("a.h5md")
    assert contents.record.step.tolist() == [0, 5, 10, 15, 20]
    assert contents.has_forces
    assert contents.scene.startswith("\nunits")
    assert (tmp_path / "b.extxyz").read_text().count("Lattice") == 5
    text = "\n".join(told)
    assert "256 atoms" in text
    assert "20 steps = 0.08 τ" in text
    assert "a.h5md, b.extxyz" in text


def test_trajectory_is_named_after_the_scene_by_default():
    assert scene_of(REDUCED, "folder/melt.toml").trajectories() == [Path("melt.h5md")]
