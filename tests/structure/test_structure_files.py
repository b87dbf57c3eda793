"""Structures from files of others: the bonds that ASE or MDAnalysis finds in them are those of the run, or their loss is told."""

import subprocess
import sys
import warnings
from pathlib import Path

import ase.io
import MDAnalysis
import numpy as np
import pytest

import minimd as md
from minimd.ase import Calculator, VelocityVerlet, system_from_file
from minimd.files.h5md_reader import read_file
from minimd.mdanalysis import universe
from minimd.scene import load_scene, run_scene

N_CHAINS, LENGTH, EDGE = 4, 5, 6.0
BONDS = [[c * LENGTH + i, c * LENGTH + i + 1] for c in range(N_CHAINS) for i in range(LENGTH - 1)]
ANGLES = [[c * LENGTH + i, c * LENGTH + i + 1, c * LENGTH + i + 2] for c in range(N_CHAINS) for i in range(LENGTH - 2)]
POSITIONS = np.array([[1.0 * i + 0.5, 1.5 * c + 0.25, 0.125 * (i % 2)] for c in range(N_CHAINS) for i in range(LENGTH)])
FORMATS = {"data": "file", "pdb": "file", "psf": "melt.psf"}  # what is read, and what structure.bonds says
SCENE = """
units = "LJ"
[structure]
file = "{file}"
{more}
[[potential]]
type = "lennard-jones"
epsilon = 1.0
sigma = 1.0
cutoff = 1.8
bonded_scale = [0.0, 1.0, 1.0]
[[potential]]
type = "harmonic-bond"
k = 50.0
length = 1.0
[dynamics]
timestep = 0.002
steps = 20
temperature = 0.5
[output]
every = 5
"""
ANGLE = '[[potential]]\ntype = "harmonic-angle"\nk = 5.0\nangle_degree = 150.0\n'


def write_data(path):
    """A melt as LAMMPS writes it, with image flags; atoms and ids in another order than the lines."""
    lines = ["melt", "", "20 atoms", "16 bonds", "12 angles", "2 atom types", "1 bond types", "1 angle types", ""]
    lines += [f"0 {EDGE} {x}lo {x}hi" for x in "xyz"] + [
        "",
        "Masses",
        "",
        "1 1.0",
        "2 2.0",
        "",
        "Atoms # molecular",
        "",
    ]
    for i in reversed(range(20)):
        x, image = (POSITIONS[i, 0] - EDGE, 1) if POSITIONS[i, 0] > 4.0 else (POSITIONS[i, 0], 0)
        lines.append(
            f"{i + 1} {i // LENGTH + 1} {1 + (i % LENGTH == 0)} {x} {POSITIONS[i, 1]} {POSITIONS[i, 2]} {image} 0 0"
        )
    lines += ["", "Velocities", "", *(f"{i + 1} {0.5 * i} 0 0" for i in range(20))]
    lines += ["", "Bonds", "", *(f"{k + 1} 1 {i + 1} {j + 1}" for k, (i, j) in enumerate(BONDS))]
    lines += ["", "Angles", "", *(f"{k + 1} 1 {i + 1} {j + 1} {m + 1}" for k, (i, j, m) in enumerate(ANGLES))]
    path.write_text("\n".join(lines) + "\n")


def write_pdb(path, with_bonds):
    """Carbon beads; each bond of a CONECT record stands there twice, as in most files."""
    lines = [f"CRYST1{EDGE:9.3f}{EDGE:9.3f}{EDGE:9.3f}  90.00  90.00  90.00 P 1           1"]
    for i, (x, y, z) in enumerate(POSITIONS):
        lines.append(
            f"ATOM  {i + 1:5d}  C   BEA A{i // LENGTH + 1:4d}    {x:8.3f}{y:8.3f}{z:8.3f}  1.00  0.00           C  "
        )
    if with_bonds:
        lines += [f"CONECT{a + 1:5d}{b + 1:5d}" for i, j in BONDS for a, b in ((i, j), (j, i))]
    path.write_text("\n".join([*lines, "END"]) + "\n")


def write_psf(path, charge=0.0):
    """As CHARMM and NAMD have it: eight columns of bonds, nine of angles."""
    lines = ["PSF", "", "       1 !NTITLE", " REMARKS melt", "", f"{20:8d} !NATOM"]
    lines += [
        f"{i + 1:8d} MELT {i // LENGTH + 1:<4d} BEA  C    CT   {charge:10.6f}  {12.011:12.4f}           0"
        for i in range(20)
    ]
    for name, groups, per_line in (("NBOND: bonds", BONDS, 4), ("NTHETA: angles", ANGLES, 3)):
        lines += ["", f"{len(groups):8d} !{name}"]
        rows = [groups[k : k + per_line] for k in range(0, len(groups), per_line)]
        lines += ["".join(f"{i + 1:8d}" for group in row for i in group) for row in rows]
    path.write_text("\n".join([*lines, ""]) + "\n")


@pytest.fixture
def folder(tmp_path, monkeypatch):
    """The melt in all formats."""
    monkeypatch.chdir(tmp_path)
    write_data(tmp_path / "melt.data")
    write_pdb(tmp_path / "melt.pdb", with_bonds=True)
    write_pdb(tmp_path / "plain.pdb", with_bonds=False)
    write_psf(tmp_path / "melt.psf")
    return tmp_path


def scene(folder, form, more=None, potentials=""):
    """A scene of a melt in a format, with the bonds that its files name if nothing else is said."""
    file = {"psf": "plain.pdb"}.get(form, f"melt.{form}")
    text = SCENE.format(file=file, more=f'bonds = "{FORMATS[form]}"' if more is None else more) + potentials
    (folder / "melt.toml").write_text(text)
    return load_scene(folder / "melt.toml")


def same_groups(found, expected):
    assert sorted(map(sorted, np.asarray(found).tolist())) == sorted(map(sorted, expected))


@pytest.mark.parametrize("form", FORMATS)
def test_melt_from_a_file_runs_with_its_bonds_and_ends_as_fragments(folder, form):
    """The end-to-end distance from the file that was written is that of the engine."""
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        sim = run_scene(scene(folder, form), tell=lambda _: None)
    same_groups(sim.system.bonds, BONDS)
    np.testing.assert_array_equal(
        sim.system.masses, np.where(np.arange(20) % LENGTH, 1.0, 2.0) if form == "data" else np.ones(20)
    )
    made = universe("melt.h5md")
    made.trajectory[-1]
    chains = made.atoms.fragments
    assert [len(chain) for chain in chains] == [LENGTH] * N_CHAINS
    squares = [float(np.sum((chain.positions[-1] - chain.positions[0]).astype(float) ** 2)) for chain in chains]
    ends = sim.positions.reshape(N_CHAINS, LENGTH, 3)[:, [0, -1]]
    np.testing.assert_allclose(squares, np.sum((ends[:, 1] - ends[:, 0]) ** 2, axis=1), rtol=1e-5)
    assert np.all(np.array(squares) > 4.0)  # across the boundary of the cell, whole


@pytest.mark.parametrize("form", ["data", "psf"])
def test_angles_of_a_file_are_used_and_survive_in_the_trajectory(folder, form):
    sim = run_scene(scene(folder, form, potentials=ANGLE), tell=lambda _: None)
    same_groups(sim.system.angles, ANGLES)
    assert sim.system.angles[:, 1].tolist() == [j for _, j, _ in ANGLES]
    np.testing.assert_array_equal(read_file("melt.h5md").system.angles, sim.system.angles)
    np.testing.assert_array_equal(universe("melt.h5md").atoms.angles.indices, sim.system.angles)
    by_hand = md.evaluate(sim.system, md.HarmonicAngle(5.0, np.deg2rad(150.0), ANGLES)).potential_energy
    assert md.evaluate(sim.system, md.HarmonicAngle(5.0, np.deg2rad(150.0))).potential_energy == pytest.approx(
        by_hand, rel=1e-14
    )
    assert by_hand > 0.0
    resumed = md.Simulation.resume("melt.h5md")
    resumed.run(5, every=5, trajectory="melt.h5md", append=True)
    np.testing.assert_array_equal(resumed.system.angles, sim.system.angles)


@pytest.mark.parametrize("form", ["data", "pdb"])
def test_bonds_that_are_not_used_are_told(folder, form):
    with pytest.warns(
        UserWarning, match=rf"melt.{form}' has 16 bonds.*, which are not used; use them with bonds = \"file\""
    ):
        assert len(scene(folder, form, more="").system().bonds) == 0
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert len(scene(folder, form, more="bonds = []").system().bonds) == 0
        assert scene(folder, form, more="bonds = [[0, 1]]").system().bonds.tolist() == [[0, 1]]


@pytest.mark.slow
def test_a_command_tells_it_in_words_of_commands(folder):
    scene(folder, "pdb", more="")
    code = (
        "import sys, minimd_command; sys.argv = ['minimd', 'run', 'melt.toml', '--steps', '0']; minimd_command.main()"
    )
    answer = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    told = [line for line in answer.stderr.splitlines() if line.startswith("minimd: warning: ")]
    assert "has 16 bonds, which are not used" in told[0]
    assert ".py" not in answer.stderr
    assert answer.returncode == 0


def test_constraints_on_the_bonds_of_a_file(folder):
    kept = scene(folder, "pdb", potentials='[constraints]\npairs = "bonds"\nlengths = 1.0\n').system().constraints
    same_groups(kept[0].pairs, BONDS)


def test_lammps_data_in_reduced_units_keeps_its_masses_types_and_velocities(folder):
    read = system_from_file("melt.data", units=md.units.LJ)
    np.testing.assert_allclose(read.positions, POSITIONS, atol=1e-12)
    np.testing.assert_allclose(read.velocities[:, 0], 0.5 * np.arange(20), rtol=1e-14)
    assert read.species.tolist() == ["2", "1", "1", "1", "1"] * N_CHAINS
    assert read.units is md.units.LJ


def test_ase_atoms_with_bonds_in_their_arrays_are_bonded(folder):
    atoms = ase.io.read("melt.data", format="lammps-data")
    same_groups(md.System.from_ase(atoms).bonds, BONDS)
    same_groups(md.System.from_ase(atoms).angles, ANGLES)
    assert md.System.from_ase(atoms, bonds=[[0, 1]]).bonds.tolist() == [[0, 1]]
    assert len(md.System.from_ase(atoms, bonds=()).bonds) == len(md.System.from_ase(atoms, bonds=()).angles) == 0
    assert len(md.Simulation(atoms, md.HarmonicBond(1.0, 1.0), md.VelocityVerlet(0.1)).system.bonds) == len(BONDS)


@pytest.mark.parametrize("file", ["a.traj", "a.extxyz", None], ids=str)
def test_bonds_and_angles_survive_the_way_through_atoms(tmp_path, file):
    """In the order of their first atoms; also through a file, but not .traj, which has no place for them; cut atoms are not trusted."""
    system = md.System(POSITIONS, masses=1.0, bonds=BONDS[::-1], angles=ANGLES, units=md.units.ASE)
    atoms = system.to_ase()
    if file:
        ase.io.write(tmp_path / file, atoms)
        atoms = ase.io.read(tmp_path / file)
    back = md.System.from_ase(atoms)
    if file == "a.traj":
        assert len(back.bonds) == 0
        return
    assert back.bonds.tolist() == sorted(map(list, BONDS))
    same_groups(back.angles, ANGLES)
    assert np.array_equal(back.positions, POSITIONS) or file
    with pytest.raises(ValueError, match="may have been cut out"):
        md.System.from_ase(atoms[3:])
    assert set(md.System(POSITIONS).to_ase().arrays) == {"numbers", "positions", "masses", "momenta"}


@pytest.mark.parametrize(
    "change", [lambda a: a[5:10], lambda a: a * (2, 1, 1), lambda a: a[::-1]], ids=["cut", "repeated", "turned"]
)
def test_bonds_of_atoms_that_were_cut_or_repeated_are_not_trusted(folder, change):
    atoms = change(ase.io.read("melt.data", format="lammps-data"))
    with pytest.raises(ValueError, match=r"may have been cut out, repeated or sorted .* bonds=\(\) for none"):
        md.System.from_ase(atoms)
    assert len(md.System.from_ase(atoms, bonds=()).bonds) == 0


def test_array_of_bonds_that_cannot_be_read_is_told(folder):
    atoms = ase.io.read("plain.pdb")
    atoms.arrays["bonds"] = np.array(["25(1)", *["_"] * 19])
    with pytest.raises(ValueError, match=r"must name atoms 0 to 19 .* for atom 0 it has '25\(1\)'"):
        md.System.from_ase(atoms)


def test_file_without_a_format_asks_for_it(folder):
    (folder / "melt.unknown").write_text((folder / "melt.data").read_text())
    with pytest.raises(ValueError, match=r"do not show its format; give it as format, such as 'lammps-data'"):
        system_from_file("melt.unknown")
    same_groups(system_from_file("melt.unknown", format="lammps-data").bonds, BONDS)
    scene(folder, "pdb", more='format = "PDB"\nbonds = "file"')
    same_groups(load_scene(folder / "melt.toml").system().bonds, BONDS)


def test_bonds_of_other_atoms_are_refused(folder):
    ase.io.write("small.xyz", ase.io.read("plain.pdb")[:7])
    with pytest.raises(ValueError, match=r"melt.psf' with the bonds has 20 atoms; the structure has 7"):
        system_from_file("small.xyz", bonds="melt.psf")
    with pytest.raises(ValueError, match=r"absent.psf' does not exist"):
        system_from_file("small.xyz", bonds="absent.psf")


def test_several_types_of_bonds_are_told(folder):
    text = Path("melt.data").read_text().replace("1 bond types", "2 bond types").replace("\n3 1 3 4", "\n3 2 3 4")
    Path("melt.data").write_text(text)
    with pytest.warns(UserWarning, match="are of 2 types, which a bond potential does not distinguish"):
        system_from_file("melt.data")


@pytest.mark.parametrize("units", [md.units.LJ, md.units.ASE], ids=lambda units: units.name)
def test_system_from_a_universe_is_the_one_that_wrote_it(tmp_path, units):
    """To float32; the cell by lengths and angles."""
    old = md.System(
        POSITIONS,
        masses=np.arange(1.0, 21.0),
        velocities=0.01 * POSITIONS,
        cell=[[6.0, 0.0, 0.0], [1.0, 7.0, 0.0], [0.5, -1.0, 8.0]],
        species=["A", "B"] * 10,
        bonds=BONDS,
        angles=ANGLES,
        units=units,
    )
    md.Simulation(old, md.LennardJones(1e-3, 1.0, 1.8), md.VelocityVerlet(1e-3)).run(0, trajectory=tmp_path / "a.h5md")
    made = universe(tmp_path / "a.h5md")
    new = md.System.from_mdanalysis(made, units=units)
    for name in ("masses", "species", "bonds", "angles"):
        np.testing.assert_array_equal(getattr(new, name), getattr(old, name), strict=True)
    for name in ("positions", "velocities"):
        np.testing.assert_allclose(getattr(new, name), getattr(old, name), rtol=2e-7)
    np.testing.assert_allclose(new.cell.vectors, old.cell.vectors, atol=1e-5)
    assert new.cell.pbc.all()
    assert new.units is units
    assert not md.System.from_mdanalysis(made, units=units, pbc=False, bonds=()).cell.pbc.any()


def test_group_of_atoms_keeps_the_bonds_within_it(folder):
    made = MDAnalysis.Universe("melt.psf", "plain.pdb")
    group = made.select_atoms("resid 2 3")[::-1]
    part = md.System.from_mdanalysis(group)
    np.testing.assert_allclose(part.positions, POSITIONS[5:15][::-1], atol=1e-6)
    same_groups(part.bonds, [[9 - i + 5, 9 - j + 5] for i, j in BONDS if 5 <= i < 15])
    assert part.species.tolist() == ["CT"] * 10
    assert len(part.angles) == 6


def test_universe_without_masses_and_what_is_none(folder):
    made = MDAnalysis.Universe.empty(3, trajectory=True)
    assert md.System.from_mdanalysis(made, units=md.units.LJ).masses.tolist() == [1.0] * 3
    with pytest.raises(ValueError, match=r"set universe\.atoms\.masses"):
        md.System.from_mdanalysis(made)
    with pytest.raises(TypeError, match="an MDAnalysis Universe or AtomGroup is expected; got str"):
        md.System.from_mdanalysis("melt.pdb")


def salt(charges=(0.5, -0.8476)):
    atoms = ase.Atoms("NaCl", [[1.0, 1.0, 1.0], [3.5, 1.0, 1.0]], cell=[8.0] * 3, pbc=True)
    atoms.set_initial_charges(charges)
    return atoms


def full_data(path):
    """A LAMMPS file with atom_style full."""
    atoms = "\n".join(f"{k} 1 1 {q} {2.5 * k} 1.0 1.0" for k, q in ((1, 0.5), (2, -0.8476)))
    box = "\n".join(f"0 8 {x}lo {x}hi" for x in "xyz")
    path.write_text(f"water\n\n2 atoms\n1 atom types\n\n{box}\n\nMasses\n\n1 16.0\n\nAtoms # full\n\n{atoms}\n")
    return path


def charged_universe():
    made = MDAnalysis.Universe.empty(2, trajectory=True)
    made.add_TopologyAttr("masses", [23.0, 35.45])
    made.add_TopologyAttr("charges", [0.5, -0.8476])
    return made


def charged_psf(folder):
    write_psf(folder / "melt.psf", -0.8476)
    return system_from_file("melt.pdb", bonds="melt.psf")


def with_calculator():
    atoms = salt()
    atoms.calc = Calculator(md.LennardJones(0.01, 2.0, 3.5))
    VelocityVerlet(atoms, 1.0).run(2)
    atoms.positions[0] += 0.1
    atoms.get_forces()


WAYS_IN = {
    "from_ase": lambda folder: md.System.from_ase(salt()),
    "a simulation of atoms": lambda folder: md.Simulation(salt(), md.LennardJones(0.01, 2.0, 3.5), md.Leapfrog(0.01)),
    "calculator and dynamics": lambda folder: with_calculator(),
    "LAMMPS data": lambda folder: system_from_file(full_data(folder / "full.data")),
    "LAMMPS data in another cell": lambda folder: system_from_file(full_data(folder / "full.data"), cell=9.0),
    "a PSF beside a PDB": charged_psf,
    "from_mdanalysis": lambda folder: md.System.from_mdanalysis(charged_universe()),
}


@pytest.mark.parametrize("way", WAYS_IN)
def test_charges_are_not_dropped_in_silence(folder, way):
    """One warning for a structure, which shows the largest; none for charges that are zero."""
    with warnings.catch_warnings(record=True) as told:
        warnings.simplefilter("always")
        WAYS_IN[way](folder)
        md.System.from_ase(salt([0.0, 0.0]))
    about = [str(one.message) for one in told if "charges" in str(one.message)]
    assert len(about) == 1
    assert "0.8476" in about[0]
