"""Scene files: the simulation they make is physically what their keys say, and docs/scenes.md has every key."""

import importlib.util
import re
from pathlib import Path

import numpy as np
import pytest
from ase import Atoms
from ase.io import write
from references import melt_scene, scene_text
from scene_texts import ARGON, MIXTURE, REDUCED, SALT, TABULATED, WATER, R, U, scene_of, write_tables
from wrong_calls import assert_answered

import minimd as md
from minimd.ase import system_from_file
from minimd.core.files.h5md_reader import read_file
from minimd.integrators import THERMOSTATS, LangevinBAOAB
from minimd.scene import load_scene, resume_run, run_scene
from minimd.scene.running import differences
from minimd.scene.section import KEY_UNITS, Section, sections_below
from minimd.scene.water import water_of

DOCS = Path(__file__).parents[2] / "docs"
# SI values, independent of minimd.units (CODATA 2018; minimd has ASE's of 2014, equal to 1e-6)
U_MASS, EV, K_B, ANGSTROM = 1.66053906660e-27, 1.602176634e-19, 1.380649e-23, 1e-10
TIME_UNIT = ANGSTROM * np.sqrt(U_MASS / EV)  # s
CODATA = {"rel": 1e-6, "abs": 0.0}  # what two editions differ by; approx would take every number of SI size for zero
MOLECULE, PAIR = scene_text("molecule"), scene_text("pair")
ENDINGS = {  # of keys: SI / that of minimd, for each dimension
    "length":       (ANGSTROM, {"_A": ANGSTROM}),                    "time": (TIME_UNIT, {"_fs": 1e-15}),
    "temperature":  (1.0, {"_K": 1.0}),                              "energy": (EV, {"_eV": EV, "_K": K_B}),
    "force":        (EV / ANGSTROM, {"_eV_A": EV / ANGSTROM}),       "angle": (1.0, {"_degree": np.pi / 180}),
    "stiffness":    (EV / ANGSTROM**2, {"_eV_A2": EV / ANGSTROM**2}), "angular stiffness": (EV, {"_eV_rad2": EV}),
    "cubic stiffness": (EV / ANGSTROM**3, {"_eV_A3": EV / ANGSTROM**3}),
    "quartic stiffness": (EV / ANGSTROM**4, {"_eV_A4": EV / ANGSTROM**4}),
    "density":      (U_MASS / ANGSTROM**3, {"_g_cm3": 1000.0}),      "inverse length": (1e10, {"_per_A": 1e10}),
    "velocity":     (ANGSTROM / TIME_UNIT, {"_A_ps": ANGSTROM / 1e-12}),
    "acceleration": (ANGSTROM / TIME_UNIT**2, {"_A_ps2": ANGSTROM / 1e-24}),
    "pressure":     (EV / ANGSTROM**3, {"_bar": 1e5, "_GPa": 1e9}),
    "compressibility": (ANGSTROM**3 / EV, {"_per_bar": 1e-5, "_per_GPa": 1e-9}),
}  # fmt: skip


@pytest.fixture
def folder(here):
    """A current folder with the files that scenes of this page name."""
    write_tables()
    Path("bent.xyz").write_text("3\n\nH 1.1 0 0\nO 0 0 0\nH 0 0.9 0\n")  # arms of 1.1 Å and 0.9 Å at a right angle
    return here


def energy_of(scene):
    return md.evaluate(scene.system(), scene.potentials()).potential_energy


def test_argon_scene_is_rahmans_argon_at_94_kelvin_with_a_well_of_120_kelvin():
    scene = load_scene(ARGON)
    simulation, (potential,) = scene.simulation(), scene.potentials()
    system = simulation.system
    assert (len(system), set(system.masses)) == (864, {39.948})
    density = 864 * 39.948 * U_MASS / (system.volume * ANGSTROM**3)  # kg/m³
    assert density == pytest.approx(1374.0, **CODATA)
    assert simulation.method.timestep * TIME_UNIT == pytest.approx(10e-15, **CODATA)
    kinetic = 0.5 * 39.948 * np.sum(system.velocities**2) * EV
    assert 2.0 * kinetic / (3 * 863 * K_B) == pytest.approx(94.4, **CODATA)
    assert np.abs(system.velocities.mean(axis=0)).max() < 1e-15  # rounding
    depth, slope = 4 * (2.5**-12 - 2.5**-6), 4 * (-12 * 2.5**-13 + 6 * 2.5**-7)  # u(r_c)/ε, u′(r_c) σ/ε
    expected = -1.0 - depth - (2 ** (1 / 6) - 2.5) * slope  # force-shifted at 2.5 σ
    assert potential.pair_energy(2 ** (1 / 6) * 3.4) * EV / K_B == pytest.approx(120.0 * expected, **CODATA)


def test_every_unit_in_a_key_has_its_size():
    for dimension, (of_minimd, endings) in ENDINGS.items():
        found = {ending: size * of_minimd for ending, size in KEY_UNITS["ASE"][dimension].items()}
        assert found == pytest.approx(endings, **CODATA), dimension
    assert set(KEY_UNITS["ASE"]) == set(ENDINGS)


def test_reduced_scene_is_the_same_as_a_script():
    simulation = scene_of(REDUCED).simulation()
    edge = 4 * (4 / 0.8442) ** (1 / 3)
    assert simulation.system.cell.vectors == pytest.approx(edge * np.eye(3))
    system = md.System(simulation.system.positions, cell=edge)
    script = md.Simulation(system, md.LennardJones(1.0, 1.0, 2.5), md.VelocityVerlet(0.004))
    script.set_temperature(1.44, seed=3)
    ours, theirs = (run.run(20, every=5).total_energy for run in (simulation, script))
    assert ours == pytest.approx(theirs, rel=1e-12)  # rounding: the two edges differ by an ulp


def test_structure_file_is_read_beside_the_scene_with_its_velocities(tmp_path, monkeypatch):
    momenta = [[1.0, 2.0, 3.0], [0.0, -1.0, 0.5]]
    write(tmp_path / "pair.traj", Atoms("ArKr", [[0, 0, 0], [4.0, 0, 0]], cell=[30, 30, 30], pbc=True, momenta=momenta))
    (tmp_path / "scene.toml").write_text(PAIR)
    monkeypatch.chdir("/")
    system = load_scene(tmp_path / "scene.toml").simulation().system
    assert (system.species.tolist(), system.masses) == (["Ar", "Kr"], pytest.approx([39.948, 83.798]))
    assert system.velocities * system.masses[:, None] == pytest.approx(np.array(momenta))
    assert system.cell.pbc.all()


def test_bonds_and_angles_have_the_energy_of_their_formula_in_the_cell_of_the_scene(folder):
    scene = scene_of(MOLECULE)
    expected = 0.5 * 20.0 * (0.1**2 + 0.1**2) + 0.5 * 3.0 * np.radians(120.0 - 90.0) ** 2
    assert energy_of(scene) == pytest.approx(expected, rel=1e-12)  # rounding
    assert scene.system().cell.vectors == pytest.approx(np.diag([12.0, 13.0, 14.0]))
    assert scene.system().cell.pbc.tolist() == [True, False, True]


def test_charges_of_a_scene_are_those_of_its_species_its_list_or_its_file(folder):
    by_species, signs = scene_of(SALT), [1, -1, -1, 1, -1, 1, 1, -1]
    system = by_species.system()
    assert system.charges.tolist() == [0.7 * sign for sign in signs]
    given = md.System(system.positions, cell=2.8, charges=system.charges)
    laws = [md.LennardJones(1.0, 1.0, 1.3), md.Coulomb(1.39, 1e-4)]
    assert energy_of(by_species) == pytest.approx(md.evaluate(given, laws).potential_energy, rel=1e-12)
    by_list = scene_of(SALT.replace("{ A = 0.7, B = -0.7 }", str([0.7 * sign for sign in signs])))
    assert energy_of(by_list) == energy_of(by_species)
    atoms = Atoms("Na4Cl4", given.positions, cell=3 * [2.8], pbc=True)
    atoms.set_initial_charges(system.charges)
    write("ions.traj", atoms)
    lattice = SALT[SALT.index("structure") : SALT.index("dynamics")]
    by_file = scene_of(SALT.replace(lattice, 'structure = { file = "ions.traj" }\n'))
    assert energy_of(by_file) == pytest.approx(energy_of(by_species), rel=1e-12)
    run_scene(scene_of(SALT, "ions.toml"))
    assert resume_run("ions.h5md", 4).system.charges.tolist() == system.charges.tolist()


def test_water_of_a_scene_is_that_of_a_script_and_goes_on_from_its_file_alone(folder):
    """To the last bit: atoms, potentials with those that are added, rigid bonds, and the run."""
    scene, (system, potentials, rigid) = scene_of(WATER), md.water("OPC3", 27, 0.95, cutoff=4.0, accuracy=1e-4, seed=3)
    simulation, added = scene.simulation(), md.ConstantForce([0.01, 0.0, 0.0])
    script = md.Simulation(system, [*potentials, added], md.VelocityVerlet(md.units.fs), rigid)
    assert list(map(repr, simulation.potentials)) == list(map(repr, script.potentials))
    script.set_temperature(300.0, seed=1)
    ours, theirs = (run.run(4, every=4) for run in (simulation, script))
    assert np.array_equal(simulation.positions, script.positions)
    assert np.array_equal(ours.total_energy, theirs.total_energy)
    assert np.array_equal(simulation.system.charges, system.charges)
    told = []
    whole = run_scene(scene, steps=8, trajectory=folder / "whole.h5md", tell=told.append)
    run_scene(scene, tell=told.append)
    resumed = resume_run("a.h5md", 4, tell=told.append)
    assert np.array_equal(resumed.positions, whole.positions)
    assert np.array_equal(resumed.velocities, whole.velocities)
    assert resumed.n_dof == whole.n_dof == 6 * 27
    assert np.array_equal(read_file("a.h5md").record.total_energy, read_file("whole.h5md").record.total_energy)
    assert not any("NOTE" in line for line in told)
    assert load_scene(ARGON.with_name("water.toml")).simulation().n_dof == 747


def test_ions_of_a_scene_are_those_of_a_script_and_go_on_from_its_file_alone(folder):
    text = WATER.replace('"OPC3"', '"TIP3P"').replace("27", "27, ions = { Na = 2, Cl = 2 }")
    given = {"cutoff": 4.0, "accuracy": 1e-4, "seed": 3}
    scene, (system, potentials, _) = scene_of(text), md.water("TIP3P", 27, 0.95, ions={"Na": 2, "Cl": 2}, **given)
    assert list(map(repr, scene.potentials()[:2])) == list(map(repr, potentials))
    for name in ("positions", "charges", "masses"):
        assert np.array_equal(getattr(scene.system(), name), getattr(system, name))
    whole = run_scene(scene, steps=8, trajectory=folder / "whole.h5md", tell=lambda _: None)
    run_scene(scene, tell=lambda _: None)
    assert np.array_equal(resume_run("a.h5md", 4, tell=lambda _: None).positions, whole.positions)


def mixed_water(model="SPC/E", seed=4):
    """27 molecules of a model, as ASE's atoms: in another order, and wrapped, so that molecules cross faces."""
    system, rng = md.water(model, 27, cutoff=4.0)[0], np.random.default_rng(seed)
    order, edge = rng.permutation(81), [system.cell.vectors[0, 0]] * 3
    atoms = Atoms(system.species[order], system.positions[order], cell=edge, pbc=True)
    atoms.wrap()
    atoms.set_momenta(0.1 * rng.standard_normal((81, 3)))
    return atoms


WATER_OF_FILE = """
structure = { file = "box.extxyz" }
water = { model = "SPC/E", cutoff_A = 4.0 }
dynamics = { timestep_fs = 1.0, steps = 4 }
output = { every = 2, trajectory = "a.h5md" }
"""


def test_water_of_a_file_is_the_same_water_by_one_key(folder):
    """Whatever the order of the atoms: energy, masses, charges and degrees of freedom, with velocities of the file."""
    atoms, (system, potentials, _) = mixed_water(), md.water("SPC/E", 27, cutoff=4.0)
    write("box.extxyz", atoms)
    scene = scene_of(WATER_OF_FILE)
    simulation = scene.simulation()
    expected = md.evaluate(system, potentials).potential_energy
    assert energy_of(scene) == pytest.approx(expected, rel=1e-6)  # rounding: the file has 8 decimals
    assert list(map(repr, simulation.potentials)) == list(map(repr, potentials))
    assert simulation.n_dof == 6 * 27 - 3
    assert simulation.system.species.tolist() == atoms.get_chemical_symbols()
    assert simulation.velocities == pytest.approx(atoms.get_velocities(), abs=1e-8)
    for name in ("masses", "charges"):
        by_kind = [dict(zip(one.species, getattr(one, name), strict=True)) for one in (simulation.system, system)]
        assert by_kind[0] == by_kind[1]
    (long,) = scene_of(WATER_OF_FILE.replace(", cutoff_A = 4.0", "")).potentials()[1:]
    assert long.cutoff == 9.0


@pytest.mark.parametrize("suffix", ["pdb", "gro"])
def test_water_of_a_file_takes_the_lengths_of_its_model_and_goes_on_without_the_file(folder, suffix):
    write(f"box.{suffix}", mixed_water("TIP3P"))
    scene = scene_of(WATER_OF_FILE.replace("extxyz", suffix))
    with pytest.warns(UserWarning, match="projected onto the constraints"):
        whole = run_scene(scene, steps=8, trajectory=folder / "whole.h5md", tell=lambda _: None)
    held = md.water("SPC/E", 27, cutoff=4.0)[2]
    assert whole.constraints[0].lengths == pytest.approx(held.lengths, rel=1e-15)
    with pytest.warns(UserWarning, match="projected onto the constraints"):
        run_scene(scene, tell=lambda _: None)
    Path(f"box.{suffix}").unlink()
    assert np.array_equal(resume_run("a.h5md", 4, tell=lambda _: None).positions, whole.positions)


def test_ions_of_a_file_are_those_of_their_names(folder):
    """Of the same atoms, in another order, from a file that states no charges: energy, charges and masses."""
    ions = {"Na": 2, "Cl": 1}
    system, potentials, rigid = md.water("TIP3P", 27, ions=ions, cutoff=4.0)
    expected = md.evaluate(system, potentials).potential_energy
    atoms = system.to_ase()[np.random.default_rng(1).permutation(84)]
    write("box.gro", atoms)
    again, laws, held = water_of(system_from_file("box.gro"), "TIP3P", cutoff=4.0)
    assert md.evaluate(again, laws).potential_energy == pytest.approx(
        expected, rel=1e-2
    )  # rounding: 0.01 Å in the file
    assert (again.net_charge, len(held.pairs)) == (pytest.approx(1.0), len(rigid.pairs))
    assert again.charges[again.species == "Na"].tolist() == [1.0, 1.0]
    scene = WATER_OF_FILE.replace("extxyz", "gro").replace("SPC/E", "TIP3P")
    with_ions = scene.replace("cutoff_A", "ions = { Na = 2, Cl = 1 }, cutoff_A")
    assert energy_of(scene_of(with_ions)) == pytest.approx(md.evaluate(again, laws).potential_energy, rel=1e-12)
    assert_answered(scene_of(scene).system, ValueError, "water.ions", "{'Na': 2, 'Cl': 1}")
    assert_answered(lambda: water_of(again, "OPC3"), ValueError, "ions", "'OPC3'")


def test_atoms_of_a_file_that_are_no_water_are_told_by_the_first_of_them(folder):
    two = [[0, 0, 0], [1.0, 0, 0], [0, 1.0, 0], [4, 0, 0], [5.0, 0, 0], [4, 1.0, 0]]
    for gone, shown in ((0, "atom 0, H, has 0"), (1, "atom 0, O, has 1"), (3, "atom 3, H, has 0")):
        atoms = Atoms("OH2OH2", two, cell=[12.0] * 3, pbc=True)
        del atoms[gone]
        write("box.extxyz", atoms)
        assert_answered(scene_of(WATER_OF_FILE).system, ValueError, "scene.toml: structure: ", "two H", shown)
    places = [[0, 0, 0], [0.96, 0, 0], [-0.24, 0.93, 0], [0.1, 0.1, 0]]
    four = md.System(places, cell=9.0, species=["O", "H", "H", "MW"], masses=1.0, units=md.units.ASE)
    assert_answered(lambda: water_of(four), ValueError, "no fourth site; atom 3, MW")


def test_every_registered_thermostat_is_built_from_its_own_parameters(monkeypatch):
    def begin(self, timestep, temperature, friction, seed, strength=2.0):
        LangevinBAOAB.__init__(self, timestep, temperature, strength * friction, seed)

    third = type("Third", (LangevinBAOAB,), {"name": "third", "__init__": begin})  # registered by a user
    monkeypatch.setitem(THERMOSTATS, "third", third)
    method = scene_of(REDUCED.replace("seed = 3", 'seed = 3\nmethod = "third"\nrelaxation_time = 0.5')).method()
    assert type(method) is third
    assert (method.timestep, method.temperature, method.friction, method.seed) == (0.004, 1.44, 4.0, 3)


def test_inner_steps_of_a_scene_are_those_of_its_method():
    bath = "\nrelaxation_time = 0.5"
    for name, more in (("respa", ""), ("langevin-respa", bath)):
        keys = f'seed = 3\nmethod = "{name}"{more}'
        for inner, line in ((4, ""), (7, "\ninner = 7")):
            method = scene_of(REDUCED.replace("seed = 3", keys + line)).method()
            assert (method.name, method.inner) == (name, inner)
    assert (method.timestep, method.temperature, method.friction, method.seed) == (0.004, 1.44, 2.0, 3)


def test_a_step_of_hybrid_monte_carlo_has_the_inner_steps_of_its_scene():
    keys = 'seed = 3\nmethod = "hybrid-monte-carlo"\nrelaxation_time = 0.5'
    for n_steps, line in ((20, ""), (7, "\nn_steps = 7")):
        method = scene_of(REDUCED.replace("seed = 3", keys + line)).method()
        assert (method.n_steps, method.friction, method.seed) == (n_steps, 2.0, 3)


def test_unlike_pairs_follow_the_mixing_rule_unless_they_are_given(folder):
    Path("pair.xyz").write_text("2\n\nAr 0 0 0\nKr 4.0 0 0\n")
    for extra, epsilon, sigma in (
        ("", np.sqrt(120.0 * 164.0), 0.5 * (3.4 + 3.65)),
        ('mixing = "geometric"', np.sqrt(120.0 * 164.0), np.sqrt(3.4 * 3.65)),
        ('pairs = [{ species = ["Kr", "Ar"], epsilon_K = 150.0, sigma_A = 3.5 }]', 150.0, 3.5),
    ):
        found = energy_of(scene_of(PAIR.replace(".traj", ".xyz") + extra)) * EV / K_B
        assert found == pytest.approx(4.0 * epsilon * ((sigma / 4.0) ** 12 - (sigma / 4.0) ** 6), **CODATA)


def test_mie_soft_and_quartic_laws_of_scenes_have_their_numbers_and_units(folder):
    """Two atoms 4 Å apart."""
    Path("pair.xyz").write_text("2\n\nAr 0 0 0\nKr 4.0 0 0\n")
    head = "structure = { file = 'pair.xyz' }\ndynamics = { timestep_fs = 0.5, steps = 10 }\n[[potential]]\n"
    mie = 'type = "mie"\ncutoff_A = 12.0\ntruncation = "truncated"\n'
    wells = (
        "species = { Ar = { epsilon_K = 120, sigma_A = 3.4, n = 14, m = 7 }, Kr = { epsilon_K = 164, sigma_A = 3.6, "
    )
    unlike = 'pairs = [{ species = ["Kr", "Ar"], epsilon_K = 150, sigma_A = 3.5, n = 14, m = 7 }]\n'
    soft, x = 'type = "soft-repulsion"\ncutoff_A = 6.0\n', 0.3
    quartic = (
        'type = "quartic-bond"\nk2_eV_A2 = 3.0\nk3_eV_A3 = -2.0\nk4_eV_A4 = 1.5\nlength_A = 3.7\npairs = [[0, 1]]\n'
    )
    well = lambda epsilon, sigma: 4.0 * epsilon * ((sigma / 4.0) ** 14 - (sigma / 4.0) ** 7)  # noqa: E731
    for text, energy in (
        (mie + "epsilon_K = 150.0\nsigma_A = 3.5\nn = 14.0\nm = 7.0\n", well(150.0, 3.5) * K_B / EV),
        (mie + wells + "n = 14.0, m = 7.0 } }\n", well(np.sqrt(120.0 * 164.0), 3.5) * K_B / EV),
        (mie + wells + "n = 12.0, m = 6.0 } }\n" + unlike, well(150.0, 3.5) * K_B / EV),
        (soft + "height_eV = 0.3\n", 0.3 * (1.0 - 0.5)),
        (quartic, 3.0 * x**2 - 2.0 * x**3 + 1.5 * x**4),
    ):
        scene = scene_of(head + text)
        is_bond = text == quartic
        found = energy_of(scene) if is_bond else scene.potentials()[0].pair_energy(4.0, "Ar", "Kr")
        assert found == pytest.approx(energy, **CODATA), text
    for text, word in (
        (mie + "epsilon_K = 150.0\nsigma_A = 3.5\nn = 14.0\n", "n and m"),
        (soft, "height_K is missing"),
    ):
        assert_answered(lambda text=text: scene_of(head + text), ValueError, "potential[0]", word)


def test_equilibration_reaches_its_temperature_and_does_not_count(tmp_path):
    text = REDUCED + "[equilibration]\nsteps = 200\ntemperature = 0.9\nrescale_every = 10\n"
    simulation = run_scene(scene_of(text), steps=0, trajectory=tmp_path / "a.h5md", tell=lambda line: None)
    assert (simulation.record.step.tolist(), simulation.record.temperature[0]) == ([0], pytest.approx(0.9))


def test_velocities_of_a_scene_are_drawn_behind_its_minimization(folder):
    bonds = "bonds = [[0, 1], [1, 2], [3, 4]]\n"  # shorter than their neighbors are apart: they turn on the way down
    text = melt_scene(3, 10).replace('lattice = "fcc"', bonds + 'lattice = "fcc"').replace("1.44", "1.0")
    text = text.replace("cutoff = 2.5", "cutoff = 2.0") + '\n[constraints]\npairs = "bonds"\nlengths = 1.0\n'
    run = run_scene(scene_of(text + "[minimization]\nmax_steps = 50\n"), tell=lambda line: None, progress=False)
    assert run.record.temperature[0] == pytest.approx(1.0, rel=1e-9)
    assert np.isfinite(run.record.total_energy).all()


def test_run_writes_what_the_scene_says_and_tells_it(folder):
    told, output = [], 'every = 5\nforces = true\ntrajectory = ["a.h5md", "b.extxyz"]'
    run_scene(scene_of(REDUCED.replace("every = 5", output)), tell=told.append)
    contents = read_file("a.h5md")
    assert contents.record.step.tolist() == [0, 5, 10, 15, 20]
    assert contents.has_forces
    assert contents.scene.splitlines()[1] == 'units = "LJ"'
    assert Path("b.extxyz").read_text().count("Lattice") == 5
    assert "20 steps = 0.08 τ" in "\n".join(told)
    assert scene_of(REDUCED, "folder/melt.toml").trajectories() == [Path("melt.h5md")]  # by default


def test_a_table_is_that_of_a_script_in_the_unit_of_its_keys(folder):
    (potential,), script = scene_of(TABULATED).potentials(), md.Tabulated(R, U, cutoff=2.4)
    assert repr(potential) == repr(script)
    assert np.array_equal(potential.pair_energy(R[:-200]), script.pair_energy(R[:-200]))
    # eV, K; the third pair is beyond the end of its table
    assert energy_of(scene_of(MIXTURE)) == pytest.approx(3.5 + 250.0 * 8.617330337e-5, rel=1e-7)


def test_a_byte_order_mark_changes_nothing(folder):
    """Of a scene, by its path and as text, and of its table: editors of Windows begin UTF-8 with it."""
    (plain,) = scene_of(TABULATED).potentials()
    for name, text in (("scene.toml", TABULATED), ("lj.dat", Path("lj.dat").read_text())):
        Path(name).write_text(text, encoding="utf-8-sig")
    marked = load_scene("scene.toml")
    assert marked.text == scene_of(Path("scene.toml").read_text(encoding="utf-8")).text == TABULATED
    (potential,) = marked.potentials()
    assert repr(potential) == repr(plain)


def test_a_run_goes_on_from_its_file_alone_with_its_table_and_its_stress(folder):
    lines = []
    whole = run_scene(scene_of(TABULATED), steps=8, trajectory=folder / "whole.h5md", tell=lines.append)
    run_scene(scene_of(TABULATED), tell=lines.append)
    (folder / "lj.dat").unlink()
    assert np.array_equal(resume_run("a.h5md", 4, tell=lines.append).positions, whole.positions)
    record = read_file("a.h5md").record
    assert record.stress.shape == (5, 3, 3)
    assert np.array_equal(record.stress, read_file("whole.h5md").record.stress)
    assert -np.trace(record.stress, axis1=1, axis2=2) / 3.0 == pytest.approx(record.pressure, rel=1e-12)  # rounding
    assert any(line.startswith("potential      Tabulated(") and "cutoff=2.4" in line for line in lines)


def test_scenes_that_differ_in_what_matters_are_told_apart(folder):
    slow = REDUCED.replace("sigma = 1.0", "sigma = 0.9").replace("0.004", "0.002").replace("steps = 20", "steps = 9")
    told = ["dynamics.steps: 20 before, 9 now", "dynamics.timestep: 0.004 before, 0.002 now"]
    told += ["potential[0].sigma: 1.0 before, 0.9 now"]
    assert sorted(differences(scene_of(REDUCED), scene_of(slow))) == told
    assert differences(scene_of(REDUCED), scene_of(REDUCED + "\n# the same")) == []
    stored = scene_of(scene_of(TABULATED).whole_text(), "elsewhere/a.h5md")
    assert differences(stored, scene_of(TABULATED)) == []
    write_tables(scale=1.1)
    [words] = differences(stored, scene_of(TABULATED))
    assert words.startswith("tables.lj.dat.u: ")


def test_the_page_of_scenes_has_every_section_and_key_and_is_up_to_date():
    """If it is not: python docs/write_scenes.py"""
    spec = importlib.util.spec_from_file_location("write_scenes", DOCS / "write_scenes.py")
    written = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(written)
    text, sections = written.page(), dict(map(reversed, written.sections()))
    assert (DOCS / "scenes.md").read_text(encoding="utf-8") == text
    assert set(sections) == {one for one in sections_below(Section) if one.__module__.startswith("minimd.")}
    for section, name in sections.items():
        for key, (field, _) in section.keys("ASE").items():
            heads = [] if name else [f"## [{field}]", f"## [[{field}]]"]
            assert any(one in text for one in [f"`{key}`", *heads]), key


def test_the_scenes_of_the_pages_are_scenes(folder):
    np.savetxt("argon.dat", np.column_stack([3.4 * R, 0.01 * U]))
    pages = [(DOCS / name).read_text(encoding="utf-8") for name in ("scenes.md", "own-laws.md")]
    (scene, *_), (section,) = (re.findall(r"```toml\n(.*?)```", page, re.S) for page in pages)
    assert len(scene_of(scene).system()) == 256
    text = f'[structure]\nfile = "pair.xyz"\n{section}[dynamics]\ntimestep_fs = 1.0\nsteps = 0\n'
    (potential,) = scene_of(text).potentials()
    assert (potential.cutoff, potential.truncation, len(potential.r)) == (8.5, "shifted", len(R))
