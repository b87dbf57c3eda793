"""Molecules from files with bonds, angles, dihedrals and impropers, through a run, to MDAnalysis and back."""

import MDAnalysis
import numpy as np
import pytest
from MDAnalysis.guesser.default_guesser import DefaultGuesser

import minimd as md
from minimd.files.structure_file import system_from_file
from minimd.forces.forces import Forces
from minimd.mdanalysis import universe
from minimd.scene import parse_scene

N = 12
GROUPS = {"bonds": 2, "angles": 3, "dihedrals": 4}
CHAIN = {name: [[k + c for c in range(size)] for k in range(N - size + 1)] for name, size in GROUPS.items()} | {
    "impropers": [[4, 3, 5, 6]]
}


def helix(spacing=0.97):
    k = np.arange(N)
    places = np.column_stack([np.cos(1.2 * k), np.sin(1.2 * k), 0.6 * k])
    return places * (spacing / np.linalg.norm(places[1] - places[0]))


def lammps_data(file):
    """A chain whose atoms stand in another order than their numbers, in a cell of 20."""
    lines = ["a polymer", "", f"{N} atoms", "1 atom types"]
    lines += [f"{len(rows)} {name}\n1 {name[:-1]} types" for name, rows in CHAIN.items()]
    lines += [f"0.0 20.0 {c}lo {c}hi" for c in "xyz"] + ["", "Masses", "", "1 1.0", "", "Atoms # molecular", ""]
    order = np.random.default_rng(2).permutation(N)
    lines += [f"{k + 1} 1 1 {x:.15g} {y:.15g} {z:.15g}" for k, (x, y, z) in ((k, helix()[k] + 8.0) for k in order)]
    for name, rows in CHAIN.items():
        lines += ["", name.capitalize(), ""] + [
            f"{n} 1 {' '.join(str(atom + 1) for atom in row)}" for n, row in enumerate(rows, start=1)
        ]
    file.write_text("\n".join([*lines, ""]))


def pdb(file):
    """Carbon atoms with CONECT records and no cell."""
    atoms = [
        f"HETATM{k + 1:5d}  C   LIG A   1    {x:8.3f}{y:8.3f}{z:8.3f}  1.00  0.00           C"
        for k, (x, y, z) in enumerate(helix(1.53))
    ]
    file.write_text("\n".join([*atoms, *(f"CONECT{i + 1:5d}{j + 1:5d}" for i, j in CHAIN["bonds"]), "END", ""]))


SCENE = """
units = "LJ"
[structure]
file = "polymer.data"
bonds = "file"
[[potential]]
type = "lennard-jones"
epsilon = 1.0
sigma = 1.0
cutoff = 1.12246
bonded_scale = [0.0, 1.0, 1.0]
[[potential]]
type = "fene-bond"
k = 30.0
longest = 1.5
epsilon = 1.0
sigma = 1.0
[[potential]]
type = "harmonic-angle"
k = 5.0
angle_degree = 120.0
[[potential]]
type = "periodic-dihedral"
k = 0.5
n = 3
[[potential]]
type = "harmonic-improper"
k = 1.0
angle_degree = 30.0
[dynamics]
timestep = 0.005
temperature = 1.0
steps = 200
"""


def distance_between_ends(made):
    """By MDAnalysis: the ends are the atoms with one bond, of the one molecule that the bonds make."""
    (molecule,) = made.atoms.fragments
    ends = [atom for atom in molecule if len(atom.bonds) == 1]
    assert len(ends) == 2
    return np.linalg.norm(ends[1].position - ends[0].position)


def assert_joined(made, impropers=1):
    assert sorted(map(tuple, made.bonds.indices.tolist())) == sorted(map(tuple, CHAIN["bonds"]))
    assert (len(made.angles), len(made.dihedrals)) == (N - 2, N - 3)
    assert len(getattr(made, "impropers", ())) == impropers


def test_a_polymer_from_lammps_data_runs_and_has_its_bonds_in_mdanalysis(tmp_path):
    lammps_data(tmp_path / "polymer.data")
    scene = parse_scene(SCENE, tmp_path / "scene.toml")
    simulation = scene.simulation()
    assert {name: len(rows) for name, rows in simulation.system.groups().items()} == {
        name: len(rows) for name, rows in CHAIN.items()
    }
    assert simulation.system.dihedrals.tolist() == CHAIN["dihedrals"]
    assert simulation.system.impropers.tolist() == CHAIN["impropers"]
    simulation.run(200, every=20, trajectory=tmp_path / "polymer.h5md", progress=False)
    made = universe(tmp_path / "polymer.h5md")
    assert_joined(made)
    made.trajectory[-1]
    positions = simulation.positions
    assert distance_between_ends(made) == pytest.approx(
        np.linalg.norm(positions[-1] - positions[0]), rel=1e-6
    )  # float32
    assert np.linalg.norm(positions[-1] - positions[0]) < 1.5 * (N - 1)
    resumed = md.Simulation.resume(tmp_path / "polymer.h5md")  # with the potentials of the scene
    assert resumed.system.groups().keys() == simulation.system.groups().keys()
    assert all(np.array_equal(resumed.system.groups()[name], rows) for name, rows in simulation.system.groups().items())
    again = md.System.from_mdanalysis(made, units=md.units.LJ)
    assert all(len(again.groups()[name]) == len(rows) for name, rows in simulation.system.groups().items())


def test_a_polymer_from_pdb_with_conect_likewise(tmp_path):
    """A PDB names bonds only; MDAnalysis finds the angles and dihedrals that they make."""
    pdb(tmp_path / "chain.pdb")
    assert system_from_file(tmp_path / "chain.pdb").bonds.tolist() == CHAIN["bonds"]
    read = MDAnalysis.Universe(str(tmp_path / "chain.pdb"))
    guesser = DefaultGuesser(read)
    read.add_TopologyAttr("angles", guesser.guess_angles(read.bonds))
    read.add_TopologyAttr("dihedrals", guesser.guess_dihedrals(read.angles))
    system = md.System.from_mdanalysis(read)
    assert (len(system.bonds), len(system.angles), len(system.dihedrals)) == (N - 1, N - 2, N - 3)
    potentials = [
        md.HarmonicBond(20.0, 1.53),
        md.HarmonicAngle(3.0, 1.95),
        md.RyckaertBellemans([0.1, 0.12, -0.14, -0.03, 0.27, -0.3]),
    ]
    simulation = md.Simulation(system, potentials, md.VelocityVerlet(0.5 * md.units.fs))
    simulation.set_temperature(300.0, seed=1)
    simulation.run(100, every=20, trajectory=tmp_path / "chain.h5md", progress=False)
    made = universe(tmp_path / "chain.h5md")
    assert_joined(made, impropers=0)
    made.trajectory[-1]
    ends = simulation.positions[[0, -1]]
    assert distance_between_ends(made) == pytest.approx(np.linalg.norm(ends[1] - ends[0]), rel=1e-6)  # float32
    back = md.System.from_ase(system.to_ase())
    assert all(len(back.groups()[name]) == len(rows) for name, rows in system.groups().items())


FIELDS = """
[[potential]]
type = "constant-force"
force = [0.0, 0.0, -0.1]
atoms = [0]
[[potential]]
type = "gravity"
acceleration = [0.0, 0.0, -0.2]
[[potential]]
type = "restraint"
k = 2.0
points = [[1.0, 2.0, 3.0]]
atoms = [0]
[[potential]]
type = "steered-spring"
k = 3.0
points = [[1.0, 2.0, 3.0]]
velocity = [0.1, 0.0, 0.0]
atoms = [3]
end = 5.0
[[potential]]
type = "wall"
point = [0.0, 0.0, -1.0]
normal = [0.0, 0.0, 1.0]
epsilon = 1.0
sigma = 1.0
cutoff = 2.5
[[potential]]
type = "cylinder-wall"
point = [2.0, 2.0, 0.0]
axis = [0.0, 0.0, 1.0]
radius = 9.0
epsilon = 1.0
sigma = 1.0
law = "12-6"
[[potential]]
type = "sphere-wall"
point = [2.0, 2.0, 2.0]
radius = 9.0
epsilon = 1.0
sigma = 1.0
[[potential]]
type = "morse-bond"
depth = 3.0
a = 2.0
length = 1.1
pairs = [[0, 1]]
[[potential]]
type = "opls-dihedral"
k1 = 1.0
k2 = 2.0
k3 = 3.0
quadruples = [[0, 1, 2, 3]]
[[potential]]
type = "ryckaert-bellemans"
coefficients = [1.0, 2.0]
quadruples = [[0, 1, 2, 3]]
"""


def test_scenes_have_every_field_and_law():
    text = f"""units = "LJ"
[structure]
lattice = "sc"
repeat = [2, 2, 2]
lattice_constant = 1.3
pbc = false
{FIELDS}
[dynamics]
timestep = 0.001
steps = 2
"""
    made = parse_scene(text, "scene.toml").potentials()
    kinds = [md.ConstantForce, md.Gravity, md.Restraint, md.SteeredSpring, md.Wall, md.CylinderWall, md.SphereWall]
    assert [type(one) for one in made] == [*kinds, md.MorseBond, md.OPLSDihedral, md.RyckaertBellemans]
    assert repr(made[3]) == "SteeredSpring(k=3.0, points=[1.0, 2.0, 3.0], velocity=[0.1, 0.0, 0.0], atoms=[3], end=5)"
    in_ase = text.replace('units = "LJ"', "").replace("lattice_constant", 'element = "Ar"\nlattice_constant_A')
    with pytest.raises(
        ValueError, match=r"potential\[1\] has no key 'acceleration' .* did you mean 'acceleration_A_ps2'"
    ):
        parse_scene(in_ase, "scene.toml")
    fall = '[[potential]]\ntype = "gravity"\nacceleration_A_ps2 = [0.0, 0.0, -2.0]\n'
    in_ase = in_ase.replace(FIELDS, fall).replace("timestep", "timestep_fs")
    assert parse_scene(in_ase, "scene.toml").potentials()[0].acceleration[2] == pytest.approx(
        -2.0 / md.units.ps**2, rel=1e-14
    )


def test_dihedrals_follow_a_strained_cell():
    """As at constant pressure: their term goes on in the new cell, with the forces of a new one, across the boundary too."""
    positions = np.array([[0.2, 2.7, 0.0], [-0.3, 3.6, 0.1], [0.4, 4.2, 0.8], [0.1, 5.1, 1.3]])
    system = md.System(positions, cell=4.0, dihedrals=[[0, 1, 2, 3]])
    system.positions[:] = system.cell.wrapped(system.positions)
    law, stretch = md.PeriodicDihedral(2.0, 3), np.array([[1.02, 0.01, 0.0], [0.01, 0.97, 0.0], [0.0, 0.0, 1.01]])
    forces = Forces(system, law)
    forces.compute()
    system.positions[:], system.cell = system.positions @ stretch, system.cell.strained(system.cell.vectors @ stretch)
    [term] = forces.terms
    forces.follow()
    forces.compute()
    assert forces.terms == [term]
    assert forces.forces == pytest.approx(md.evaluate(system, law).forces, rel=1e-12)
    assert np.abs(forces.forces).max() > 0.1


def test_coefficients_that_are_no_list_are_refused():
    with pytest.raises(TypeError, match="coefficients must be a list, c0 to c5 at most"):
        md.RyckaertBellemans(5.0)
