"""Molecules from files of others: groups that ASE or MDAnalysis finds are those of the run, or their loss is told."""

import os
import shutil
import time
import warnings
from pathlib import Path

import ase.io
import MDAnalysis
import numpy as np
import pytest
from ase.calculators.lj import LennardJones
from references import DATA, scene_text
from wrong_calls import assert_answered

import minimd as md
from minimd.ase import ForcesFromCalculator, system_from_file
from minimd.core.files import h5md_reader
from minimd.core.files.h5md_reader import read_file
from minimd.core.structure.system import changed
from minimd.mdanalysis import universe
from minimd.scene import load_scene, parse_scene, run_scene

N_CHAINS, LENGTH = 4, 5
EMPTY = MDAnalysis.Universe.empty(3, trajectory=True)  # of no masses: they are one in reduced units


def along_chains(size):
    return [[c * LENGTH + i + k for k in range(size)] for c in range(N_CHAINS) for i in range(LENGTH - size + 1)]


BONDS, ANGLES, DIHEDRALS, IMPROPERS = along_chains(2), along_chains(3), along_chains(4), [[4, 3, 2, 1]]
GROUPS = {"bonds": BONDS, "angles": ANGLES, "dihedrals": DIHEDRALS, "impropers": IMPROPERS}
IONS = [0.5, -0.8476]
POSITIONS = np.array([[1.0 * i + 0.5, 1.5 * c + 0.25, 0.125 * (i % 2)] for c in range(N_CHAINS) for i in range(LENGTH)])
FORMATS = {"data": "file", "pdb": "file", "psf": "melt.psf"}  # what is read, and what structure.bonds says
SCENE, GROUP_LAWS = scene_text("chains"), scene_text("laws_of_chains")
ANGLE_LAW = GROUP_LAWS[: GROUP_LAWS.index("[[potential]]", 1)]


@pytest.fixture
def folder(here):
    """The melt in all formats, and ions."""
    return shutil.copytree(DATA / "chains", here, dirs_exist_ok=True)


def scene(folder, form, more=None, laws=""):
    """A scene of a melt in a format, with the bonds that its files name if nothing else is said."""
    file = {"psf": "plain.pdb"}.get(form, f"melt.{form}")
    more = f'bonds = "{FORMATS[form]}"' if more is None else more
    (folder / "melt.toml").write_text(SCENE.replace('file = "melt.data"', f'file = "{file}"\n{more}') + laws)
    return load_scene(folder / "melt.toml")


def same_groups(found, expected):
    assert sorted(map(sorted, np.asarray(found).tolist())) == sorted(map(sorted, expected))


@pytest.mark.parametrize("form", ["data", *(pytest.param(form, marks=pytest.mark.slow) for form in ("pdb", "psf"))])
def test_melt_from_a_file_runs_with_its_groups_and_ends_as_fragments(folder, form):
    """The end-to-end distance from the file that was written is that of the engine."""
    names = {"data": list(GROUPS), "psf": ["bonds", "angles"], "pdb": ["bonds"]}[form]
    laws = {"data": GROUP_LAWS, "psf": ANGLE_LAW, "pdb": ""}[form]
    with warnings.catch_warnings(action="error"):
        sim = run_scene(scene(folder, form, laws=laws), tell=lambda _: None)
    heavy = np.arange(20) % LENGTH == 0
    np.testing.assert_array_equal(sim.system.masses, np.where(heavy, 2.0, 1.0) if form == "data" else np.ones(20))
    resumed = md.Simulation.resume("melt.h5md")
    resumed.run(5, every=5, trajectory="melt.h5md", append=True, progress=False)
    made = universe("melt.h5md")
    again = md.System.from_mdanalysis(made, units=md.units.LJ)
    assert [name for name, rows in sim.system.groups().items() if len(rows)] == names
    for name in names:
        same_groups(getattr(sim.system, name), GROUPS[name])
        same_groups(getattr(again, name), GROUPS[name])
        same_groups(getattr(made.atoms, name).indices, GROUPS[name])
        for other in (read_file("melt.h5md").system, resumed.system):
            np.testing.assert_array_equal(getattr(other, name), getattr(sim.system, name))
    made.trajectory[4]
    assert [len(chain) for chain in made.atoms.fragments] == [LENGTH] * N_CHAINS
    arms = np.array([chain.positions[-1] - chain.positions[0] for chain in made.atoms.fragments])
    ends = sim.positions.reshape(N_CHAINS, LENGTH, 3)[:, [0, -1]]
    np.testing.assert_allclose(arms, ends[:, 1] - ends[:, 0], atol=1e-5)  # float32
    assert np.all((arms**2).sum(axis=1) > 4.0)  # across the boundary of the cell, whole


def test_angles_and_constraints_of_a_file_are_those_named_by_hand(folder):
    system = scene(folder, "psf", laws=GROUP_LAWS).system()
    assert system.angles[:, 1].tolist() == [j for _, j, _ in ANGLES]
    found, expected = (md.evaluate(system, md.HarmonicAngle(5.0, 2.6, triples)) for triples in (None, ANGLES))
    assert found.potential_energy == pytest.approx(expected.potential_energy, rel=1e-14) != 0.0
    kept = scene(folder, "pdb", laws='[constraints]\npairs = "bonds"\nlengths = 1.0\n').system().constraints
    same_groups(kept[0].pairs, BONDS)


def test_scenes_have_every_field_and_law():
    made, wrong = parse_scene(scene_text("fields"), "scene.toml").potentials(), scene_text("gravity")
    kinds = [md.ConstantForce, md.Gravity, md.Restraint, md.SteeredSpring, md.Wall, md.CylinderWall, md.SphereWall]
    kinds += [md.MorseBond, md.OPLSDihedral, md.RyckaertBellemans, md.DihedralMap]
    assert [type(one) for one in made] == kinds
    assert repr(made[3]) == "SteeredSpring(k=3.0, points=[1.0, 2.0, 3.0], velocity=[0.1, 0.0, 0.0], atoms=[3], end=5)"
    words = "potential[0]", "'acceleration'", "'acceleration_A_ps2'"
    assert_answered(lambda: parse_scene(wrong, "scene.toml"), ValueError, *words)
    [fall] = parse_scene(wrong.replace("acceleration", "acceleration_A_ps2"), "scene.toml").potentials()
    assert fall.acceleration[2] == pytest.approx(-2.0 / md.units.ps**2, rel=1e-14)


@pytest.mark.parametrize("form", ["data", "pdb"])
def test_bonds_that_are_not_used_are_told(folder, form):
    with pytest.warns(UserWarning, match=rf"melt.{form}' has 16 bonds.*, which are not used.*bonds = \"file\""):
        assert len(scene(folder, form, more="").system().bonds) == 0
    with warnings.catch_warnings(action="error"):
        assert len(scene(folder, form, more="bonds = []").system().bonds) == 0
        assert scene(folder, form, more="bonds = [[0, 1]]").system().bonds.tolist() == [[0, 1]]


def test_lammps_data_keeps_its_types_velocities_and_bonds(folder):
    read = system_from_file("melt.data", units=md.units.LJ)
    np.testing.assert_allclose(read.positions, POSITIONS, atol=1e-12)
    np.testing.assert_allclose(read.velocities[:, 0], 0.5 * np.arange(20), rtol=1e-14)
    assert read.species.tolist() == ["2", "1", "1", "1", "1"] * N_CHAINS
    assert read.units is md.units.LJ
    atoms = ase.io.read("melt.data", format="lammps-data")
    same_groups(md.System.from_ase(atoms).bonds, BONDS)
    same_groups(md.System.from_ase(atoms).angles, ANGLES)
    assert md.System.from_ase(atoms, bonds=[[0, 1]]).bonds.tolist() == [[0, 1]]
    Path("melt.unknown").write_text(Path("melt.data").read_text())
    assert_answered(lambda: system_from_file("melt.unknown", format="lammps-data"), ValueError, "lammps_units=")
    same_groups(system_from_file("melt.unknown", format="lammps-data", units=md.units.LJ).bonds, BONDS)


@pytest.mark.parametrize("file", ["a.traj", "a.extxyz", None], ids=str)
def test_bonds_angles_and_dihedrals_survive_the_way_through_atoms(tmp_path, file):
    """In the order of their first atoms; also through a file, but not .traj, which has no place for them."""
    given = {"bonds": BONDS[::-1], "angles": ANGLES, "dihedrals": DIHEDRALS, "charges": np.linspace(-0.5, 0.8, 20)}
    atoms = md.System(POSITIONS, masses=1.0, units=md.units.ASE, **given).to_ase()
    if file:
        ase.io.write(tmp_path / file, atoms)
        atoms = ase.io.read(tmp_path / file)
    back = md.System.from_ase(atoms)
    assert back.bonds.tolist() == ([] if file == "a.traj" else sorted(map(list, BONDS)))
    for name in ("angles", "dihedrals"):
        same_groups(getattr(back, name), [] if file == "a.traj" else GROUPS[name])
    assert np.array_equal(back.positions, POSITIONS) or file
    np.testing.assert_allclose(back.charges, given["charges"], rtol=0.0, atol=5e-9 if file == "a.extxyz" else 0.0)
    assert set(md.System(POSITIONS).to_ase().arrays) == {"numbers", "positions", "masses", "momenta"}


@pytest.mark.parametrize("change", [lambda a: a[5:10], lambda a: a * (2, 1, 1), lambda a: a[::-1]])
def test_bonds_of_atoms_that_were_cut_or_repeated_are_not_trusted(folder, change):
    atoms = change(ase.io.read("melt.data", format="lammps-data"))
    with pytest.raises(ValueError, match=r"may have been cut out, repeated or sorted .* bonds=\(\) for none"):
        md.System.from_ase(atoms)
    none = md.System.from_ase(atoms, bonds=())
    assert len(none.bonds) == len(none.angles) == 0


def test_what_cannot_be_a_structure_is_named(folder):
    (folder / "melt.unknown").write_text("LAMMPS\n")
    atoms = ase.io.read("plain.pdb")
    ase.io.write("small.xyz", atoms[:7])
    assert_answered(lambda: system_from_file("melt.unknown"), ValueError, "format")
    assert_answered(lambda: system_from_file("small.xyz", bonds="melt.psf"), ValueError, "melt.psf", "20", "7")
    assert_answered(lambda: md.System.from_mdanalysis("melt.pdb"), TypeError, "universe", "melt.pdb")
    assert_answered(lambda: md.System.from_mdanalysis(EMPTY), ValueError, "masses")
    atoms.arrays["bonds"] = np.array(["25(1)", *["_"] * 19])
    assert_answered(lambda: md.System.from_ase(atoms), ValueError, "atom 0", "25(1)")
    assert md.System.from_mdanalysis(EMPTY, units=md.units.LJ).masses.tolist() == [1.0] * 3


@pytest.mark.parametrize("units", [md.units.LJ, md.units.ASE], ids=lambda units: units.name)
def test_system_from_a_universe_is_the_one_that_wrote_it(tmp_path, units):
    given = {"masses": np.arange(1.0, 21.0), "species": ["A", "B"] * 10, "bonds": BONDS, "angles": ANGLES}
    cell = [[6.0, 0.0, 0.0], [1.0, 7.0, 0.0], [0.5, -1.0, 8.0]]
    old = md.System(POSITIONS, velocities=0.01 * POSITIONS, cell=cell, units=units, **given)
    md.Simulation(old, md.LennardJones(1e-3, 1.0, 1.8), md.VelocityVerlet(1e-3)).run(0, trajectory=tmp_path / "a.h5md")
    made = universe(tmp_path / "a.h5md")
    new = md.System.from_mdanalysis(made, units=units)
    for name in given:
        np.testing.assert_array_equal(getattr(new, name), getattr(old, name), strict=True)
    for name in ("positions", "velocities"):
        np.testing.assert_allclose(getattr(new, name), getattr(old, name), rtol=2e-7)
    np.testing.assert_allclose(new.cell.vectors, old.cell.vectors, atol=1e-5)
    assert (new.cell.pbc.all(), new.units is units) == (True, True)
    assert not md.System.from_mdanalysis(made, units=units, pbc=False, bonds=()).cell.pbc.any()


def test_charges_of_a_structure_come_before_those_of_its_file_of_bonds(folder):
    ase.io.write("own.traj", md.System(POSITIONS, charges=20 * [0.25]).to_ase())
    assert system_from_file("own.traj", bonds="ions.psf").charges.tolist() == 20 * [0.25]


def test_group_of_atoms_keeps_the_bonds_within_it(folder):
    part = md.System.from_mdanalysis(MDAnalysis.Universe("melt.psf", "plain.pdb").select_atoms("resid 2 3")[::-1])
    np.testing.assert_allclose(part.positions, POSITIONS[5:15][::-1], atol=1e-6)
    same_groups(part.bonds, [[9 - i + 5, 9 - j + 5] for i, j in BONDS if 5 <= i < 15])
    assert (part.species.tolist(), len(part.angles)) == (["CT"] * 10, 6)


def salt():
    atoms = ase.Atoms("NaCl", [[1.0, 1.0, 1.0], [3.5, 1.0, 1.0]], cell=[8.0] * 3, pbc=True)
    atoms.set_initial_charges(IONS)
    return atoms


def from_mdanalysis():
    made = MDAnalysis.Universe.empty(2, trajectory=True)
    made.add_TopologyAttr("masses", [23.0, 35.45])
    made.add_TopologyAttr("charges", IONS)
    made.atoms.positions = [[1.0, 1.0, 1.0], [3.5, 1.0, 1.0]]
    return md.System.from_mdanalysis(made)


WAYS_IN = {
    "a universe": from_mdanalysis, "atoms": lambda: md.System.from_ase(salt()),
    "a file of ASE": lambda: (ase.io.write("a.traj", salt()), system_from_file("a.traj"))[1],
    "LAMMPS data, full": lambda: system_from_file("salt-full.data", units=md.units.ASE),
    "LAMMPS data, charge": lambda: system_from_file("salt-charge.data", units=md.units.LJ),
    "LAMMPS data beside": lambda: system_from_file("salt.xyz", bonds="salt-full.data"),
    "a PSF beside": lambda: system_from_file("melt.pdb", bonds="ions.psf"),
    "a PSF": lambda: md.System.from_mdanalysis(MDAnalysis.Universe("ions.psf", "plain.pdb")),
}  # fmt: skip


@pytest.mark.parametrize("way", WAYS_IN)
def test_charges_come_with_a_structure_and_a_warning_tells_if_nothing_uses_them(folder, way):
    """One warning, which shows the largest; none where Coulomb or a calculator may use them, or all are zero."""
    system = WAYS_IN[way]()
    assert system.charges.tolist() == (20 * IONS[1:] if "PSF" in way else IONS)
    law, neutral = md.LennardJones(1e-3, 0.5, 2.6), changed(system, charges=None)
    with warnings.catch_warnings(record=True, action="always") as told:
        md.evaluate(system, [law, md.Coulomb(2.6)])
        md.evaluate(system, [law, ForcesFromCalculator(LennardJones(rc=2.6))])
        md.evaluate(neutral, [law])
        md.evaluate(system, law)  # a part of the energy
        assert [one for one in told if "no potential uses" in str(one.message)] == []
        md.evaluate(system, [law])
    assert ["0.8476 e" in str(one.message) for one in told if "no potential uses" in str(one.message)] == [True]


@pytest.mark.skipif(not hasattr(os, "fork"), reason="the limits are those of a child process")
@pytest.mark.parametrize("text", [  # they take more than their time and more than their memory
    "1000000000000\n\nAr 0 0 0\n", "1\nProperties=species:S:1:pos:R:3:x:R:1000000000\nAr 0 0 0\n",
])  # fmt: skip
def test_a_structure_that_claims_more_than_it_has_costs_little_time_and_memory(text, tmp_path, monkeypatch):
    monkeypatch.setattr(h5md_reader, "SECONDS", 2)
    (tmp_path / "a.xyz").write_text(text)
    started = time.process_time()
    assert_answered(lambda: system_from_file(tmp_path / "a.xyz"), ValueError, "a.xyz")
    assert time.process_time() - started < 2.0  # of this process


def test_warnings_of_a_reader_are_those_of_the_call(tmp_path):
    ase.io.write(tmp_path / "a.xyz", ase.Atoms("Ar2", [[0, 0, 0], [3, 0, 0]]))
    system = system_from_file(tmp_path / "a.xyz", cell=9.0)
    assert system.cell.pbc.all()
