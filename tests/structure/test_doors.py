"""Structure files of other programs: what comes in is what the file states, what is guessed is told, else refused."""

import bz2
import gzip
import warnings
from collections import Counter
from pathlib import Path

import ase.io
import MDAnalysis
import numpy as np
import pytest
from ase import Atoms
from ase.data import atomic_masses, atomic_numbers
from structure.corpus import judged
from wrong_calls import assert_answered

import minimd as md
from minimd.ase import system_from_file
from minimd.scene import parse_scene

CELL = "   4.20000   4.20000   4.20000"
# names of residue and atom, and the element; -: it must be refused
NAMES = [row.split() for row in """
    NA NA Na; CL CL Cl; ION NA+ Na; ION CL- Cl; MG MG Mg; ZN2 ZN Zn; CA2+ CA Ca; AR AR Ar; RB RB Rb
    XE XE Xe; K K K; SOD SOD Na; CLA CLA Cl; POT POT K; CES CES Cs; ALA CA C; GLU CD C; LYS CE C; SER HG H
    THR OG1 O; ARG NE N; ARG HE H; ILE CD1 C; TRP CZ3 C; CYS SG S; MSE SE Se; LEU 1HB H; VAL 2HG1 H
    DA HO5' H; DG P P; HOH OW O; SOL HW2 H; LIG CL1 Cl; LIG C21 C; POPC O11 O; HEM FE Fe; DUM Na Na; SOL MW -; SOL OM -
    TIP4 EP -; W W -; DPPC GL1 -; HEM NA -; T X -""".replace("\n", ";").split(";")[1:]]  # fmt: skip


def gro_line(k, residue, name, position, width=8, decimals=3):
    return f"{k + 1:5d}{residue:<5s}{name:>5s}{k + 1:5d}" + "".join(f"{x:{width}.{decimals}f}" for x in position)


def pdb_line(k, residue, name, position, element="", altloc=" "):
    at = f" {name:<3s}" if len(name) < 4 and not name[0].isdigit() else f"{name:<4s}"
    return (
        f"ATOM  {k + 1:5d} {at}{altloc}{residue:<4s}A{k + 1:4d}    "
        + "".join(f"{x:8.3f}" for x in position)
        + (f"  1.00  0.00          {element:>2s}")
    )


def write(name, *lines):
    with open(name, "w", encoding="utf-8") as file:
        file.write("\n".join(lines) + "\n")
    return name


def read(name, *told, **options):
    """The system of a file, and of each warning one of the words that must be in them."""
    with warnings.catch_warnings(record=True, action="always") as seen:
        system = system_from_file(name, **options)
    messages = [str(one.message) for one in seen]
    assert len(messages) == len(told), messages
    for words, message in zip(told, messages, strict=True):
        assert words in message
    return system


def mass(symbol):
    return atomic_masses[atomic_numbers[symbol]]


@pytest.mark.parametrize("form", ["gro", "pdb"])
@pytest.mark.parametrize(("residue", "name", "element"), NAMES)
def test_elements_of_names_are_right_and_told_or_refused(residue, name, element, form, here):
    lines = ["made up", "    1", gro_line(0, residue, name, (0.3, 0.1, 0.2)), CELL]
    if form == "pdb":
        lines = [pdb_line(0, residue, name, (3.0, 1.0, 2.0)), "END"]
    write(f"a.{form}", *lines)
    if element == "-":
        assert_answered(lambda: system_from_file(f"a.{form}"), ValueError, repr(name), "masses=", "elements=")
        assert read(f"a.{form}", masses={name: 72.0}).masses.tolist() == [72.0]
        assert read(f"a.{form}", elements={name: "W"}).species.tolist() == ["W"]
        assert read(f"a.{form}", units=md.units.LJ).masses.tolist() == [1.0]
    else:
        system = read(f"a.{form}", f"{name!r}, is {element}")
        assert (system.masses.tolist(), system.species.tolist()) == ([mass(element)], [element])


def test_a_stated_element_wins_over_every_name(here):
    write("a.pdb", pdb_line(0, "HEM", "NA", (0, 0, 0), "N"), pdb_line(1, "LIG", "CA", (3, 0, 0), "CA"), "END")
    assert read("a.pdb").species.tolist() == ["N", "Ca"]
    assert_answered(lambda: md.System.from_ase(ase.io.read(write("b.pdb", pdb_line(0, "ALA", "CA", (0, 0, 0)), "END"))),
                    ValueError, "'CA'", "Ca", "system_from_file")  # fmt: skip


def test_beads_are_not_atoms_by_their_distances(here):
    """Names of coarse models that are names of atoms, too."""
    beads = [gro_line(0, "LIP", "NC3", (0.0, 0.0, 0.0)), gro_line(0, "LIP", "PO4", (0.35, 0.0, 0.0))]
    write("a.gro", "beads", "    2", *beads, CELL)
    assert_answered(lambda: system_from_file("a.gro"), ValueError, "beads", "3.5 Å", "masses=")
    assert read("a.gro", masses=72.0).species.tolist() == ["NC3", "PO4"]
    assert_answered(lambda: md.System.from_ase(ase.io.read("a.gro")), ValueError, "beads")
    metal = [gro_line(0, "ALK", "Na", (0.0, 0.0, 0.0)), gro_line(0, "ALK", "Na", (0.35, 0.0, 0.0))]
    write("b.gro", "metal", "    2", *metal, CELL)
    assert read("b.gro", "'Na', is Na").species.tolist() == ["Na", "Na"]


def test_what_x_and_a_massless_site_weigh_is_not_known():
    assert_answered(
        lambda: md.System.from_ase(Atoms("ArX", [[0, 0, 0], [4, 0, 0]])), ValueError, "atom 1", "'X'", "masses"
    )
    made = MDAnalysis.Universe.empty(2, trajectory=True)
    made.add_TopologyAttr("names", ["OW", "MW"])
    made.add_TopologyAttr("masses", [15.999, 0.0])
    assert_answered(lambda: md.System.from_mdanalysis(made), ValueError, "atom 1", "'MW'", "massless")


def water_lines(shift=0.0):
    places = {"O": (1.0 + shift, 1.0, 1.0), "H1": (1.96 + shift, 1.0, 1.0), "H2": (0.76 + shift, 1.93, 1.0)}
    return [pdb_line(k, "HOH", name, place, name[0]) for k, (name, place) in enumerate(places.items())]


CONECT = ["CONECT    1    2    3", "CONECT    2    1", "CONECT    3    1"]
CRYST = "CRYST1{:9.3f}{:9.3f}{:9.3f}{:7.2f}{:7.2f}{:7.2f} P 1           1"
MODELS = {
    "two models": ["MODEL        1", *water_lines(), "ENDMDL", "MODEL        2", *water_lines(2.0), "ENDMDL"],
    "END after ENDMDL": ["MODEL        1", *water_lines(2.0), "ENDMDL", *CONECT, "MASTER", "END"],
    "models of other atoms": ["MODEL        1", water_lines()[0], "ENDMDL", "MODEL        2", *water_lines(2.0)],
    "no END": water_lines(2.0),
}  # fmt: skip


def test_names_residues_and_chains_of_a_file_are_selected_in_a_run_of_it(here):
    """Of PDB and GRO files; a text that is not ASCII keeps all of them out."""
    mdanalysis = pytest.importorskip("minimd.mdanalysis")
    alanine = [pdb_line(0, "ALA", "N", (0, 0, 0), "N"), pdb_line(4, "ALA", "CA", (1.5, 0, 0), "C")]
    write("a.pdb", *alanine, *water_lines(5.0), "END")
    write("a.gro", "made up", "    2", gro_line(6, "ALA", "CA", (0, 0, 0)), gro_line(7, "SOL", "OW", (1, 0, 0)), CELL)
    rows = {
        "a.pdb": [["N", "N", "ALA", "1", "A"], ["CA", "C", "ALA", "5", "A"], ["O", "O", "HOH", "1", "A"]],
        "a.gro": [["CA", "C", "ALA", "7", "SYSTEM"], ["OW", "O", "SOL", "8", "SYSTEM"]],
    }
    for name, topology in rows.items():
        with warnings.catch_warnings(action="ignore"):
            system = system_from_file(name)
        assert system.topology[: len(topology)].tolist() == topology
        sim = md.Simulation(system, [], md.VelocityVerlet(0.1))
        sim.run(1, trajectory=f"{name}.h5md", progress=False)
        atoms = mdanalysis.universe(f"{name}.h5md").atoms
        protein = [k for k, row in enumerate(topology) if row[2] == "ALA"]
        assert atoms.select_atoms("protein").indices.tolist() == protein
        assert atoms.residues.resnames.tolist() == MDAnalysis.Universe(name).residues.resnames.tolist()
    made = MDAnalysis.Universe("a.pdb")
    made.add_TopologyAttr("masses", np.ones(5))
    made.residues[0].resname = "ALÅ"
    assert md.System.from_mdanalysis(made).topology.size == 0


@pytest.mark.parametrize("kind", MODELS)
@pytest.mark.parametrize("suffix", ["pdb", "ent", "pdb.gz", "pdb.bz2", "of @300K.pdb"])
def test_pdb_files_give_their_last_model_and_their_bonds(kind, suffix, here):
    text = "\n".join(MODELS[kind]) + "\n"
    opened = {"gz": gzip.open, "bz2": bz2.open}.get(suffix.rpartition(".")[2], open)
    with opened(f"a.{suffix}", "wt") as file:
        file.write(text)
    system = read(f"a.{suffix}")
    np.testing.assert_array_equal(system.positions[0], [3.0, 1.0, 1.0])
    assert (system.species.tolist(), len(system.bonds)) == (["O", "H", "H"], 2 * ("CONECT" in text))


@pytest.mark.parametrize(("edges", "angles", "pbc"), [
    ((1.0, 1.0, 1.0), (90.0, 90.0, 90.0), (False, False, False)), ((0.0, 0.0, 0.0), (90.0, 90.0, 90.0), (False,) * 3),
    ((30.0, 30.0, 30.0), (0.0, 0.0, 0.0), (False,) * 3), ((30.0, 31.0, 0.0), (90.0, 90.0, 90.0), (True, True, False)),
    ((30.1, 31.2, 32.3), (90.0, 90.0, 60.0), (True, True, True)),
])  # fmt: skip
def test_a_cell_that_a_pdb_file_does_not_have_is_none(edges, angles, pbc, here):
    write("a.pdb", CRYST.format(*edges, *angles), *water_lines(), "END")
    system = read("a.pdb")
    assert system.cell.pbc.tolist() == list(pbc)
    lengths = np.linalg.norm(system.cell.vectors, axis=1)
    np.testing.assert_allclose(lengths, np.where(pbc, edges, 0.0), rtol=1e-12)
    assert read("a.pdb", cell=[9.0, 9.0, 9.0]).cell.pbc.all()
    assert not read("a.pdb", pbc=False, cell=[0, 0, 0]).cell.pbc.any()


def test_a_drop_comes_back_from_pdb_and_gro_without_a_cell(here):
    drop = md.System(3.7 * np.arange(12.0).reshape(4, 3), masses=mass("Ar"), species=["Ar"] * 4, units=md.units.ASE)
    md.Simulation(drop, md.LennardJones(0.0104, 3.4, 10.0), md.VelocityVerlet(1.0)).run(0, trajectory="drop.h5md")
    from minimd.mdanalysis import universe

    for suffix in ("pdb", "gro"):
        universe("drop.h5md").atoms.write(f"drop.{suffix}")
        with warnings.catch_warnings(action="ignore"):
            back = system_from_file(f"drop.{suffix}")
        assert (back.cell.pbc.any(), back.species.tolist()) == (False, ["Ar"] * 4)
        np.testing.assert_allclose(back.positions, drop.positions, atol=5.1e-3)


def test_an_alternate_location_is_refused_with_its_atoms(here):
    lines = [
        pdb_line(0, "SER", "N", (0, 0, 0), "N"),
        *(pdb_line(1, "SER", "CB", (0.7 * k + 1, 0, 0), "C", "AB"[k]) for k in (0, 1)),
    ]
    write("a.pdb", *(line[:22] + "   1" + line[26:] for line in lines), "END")
    assert_answered(lambda: system_from_file("a.pdb"), ValueError, "atoms 1 and 2", "'CB'", "alternate")


GRO = ["made up", "    2", *(gro_line(k, "AR", "AR", (0.1 + 0.4 * k, 0.1, 0.2)) for k in (0, 1))]


def test_gro_files_of_all_kinds(here):
    guess = "'AR', is Ar"
    write("slab.gro", *GRO, "   3.00000   3.00000   0.00000")
    assert read("slab.gro", guess, pbc=(True, True, False)).cell.pbc.tolist() == [True, True, False]
    assert read("slab.gro", guess).cell.pbc.tolist() == [True, True, False]
    write("open.gro", *GRO, "   0.00000   0.00000   0.00000")
    assert not read("open.gro", guess).cell.pbc.any()
    write("touching.gro", *GRO, "1000.000001000.000001000.00000")
    np.testing.assert_allclose(np.diag(read("touching.gro", guess).cell.vectors), 1e4)
    digits = [gro_line(k, "AR", "AR", (0.123456 + 0.4 * k, 0.1, 0.2), 11, 6) for k in (0, 1)]
    write("digits.gro", "made up", "    2", *digits, CELL)
    assert read("digits.gro", guess).positions[0, 0] == pytest.approx(1.23456, rel=1e-15)
    write("frames.gro", *GRO, CELL, *(line.replace("0.100", "0.700") for line in GRO), CELL)
    assert read("frames.gro", guess).positions[0].tolist() == [7.0, 7.0, 2.0]
    moving = [f"{line}{0.25 * k:8.4f}{0.5:8.4f}{-0.125:8.4f}" for k, line in enumerate(GRO[2:])]
    write("moving.gro", *GRO[:2], *moving, CELL)
    np.testing.assert_allclose(read("moving.gro", guess).velocities[1] * md.units.ps, [2.5, 5.0, -1.25], rtol=1e-6)
    reduced = read("moving.gro", units=md.units.LJ)
    assert (reduced.positions[0].tolist(), reduced.velocities[1].tolist()) == ([0.1, 0.1, 0.2], [0.25, 0.5, -0.125])
    assert (reduced.cell.vectors[0, 0], reduced.masses.tolist()) == (4.2, [1.0, 1.0])


@pytest.mark.parametrize(("form", "n_less"), [("gro", 2), ("gro", 12), ("gro", 31), ("gro", 60), ("gro", 90),
                                              ("pdb", 26), ("pdb", 33), ("pdb", 45), ("pdb", 70)])  # fmt: skip
def test_files_that_were_cut_are_refused(form, n_less, here):
    """Behind the position of an atom, a PDB file ends as well as any other."""
    text = "\n".join([*GRO, CELL, ""] if form == "gro" else water_lines())
    Path(f"a.{form}").write_text(text[:-n_less])
    assert_answered(lambda: system_from_file(f"a.{form}"), ValueError, f"a.{form}")


def test_a_slab_of_mdanalysis_is_a_slab():
    made = MDAnalysis.Universe.empty(2, trajectory=True)
    made.add_TopologyAttr("masses", [2.0, 3.0])
    made.atoms.positions = [[0, 0, 0], [4, 0, 0]]
    made.dimensions = [30, 31, 0, 90, 90, 90]
    system = md.System.from_mdanalysis(made)
    assert (system.cell.pbc.tolist(), np.diag(system.cell.vectors).tolist()) == ([True, True, False], [30.0, 31.0, 0.0])


@pytest.mark.parametrize(("sites", "words"), [
    (["Na1 Na 0 0 0 0.55", "K1 K 0 0 0 0.45", "Cl1 Cl 0.5 0.5 0.5 1.0"], ("atom 0", "0.55 of Na", "0.45 of K")),
    (["O1 O 0 0 0 1.0", "H1 H 0.2 0 0 0.5", "H2 H 0 0.2 0 0.5"], ("atom 1", "0.5 of H")),
])  # fmt: skip
def test_sites_that_are_occupied_in_part_are_refused(sites, words, here):
    head = [f"_cell_length_{axis} 5.6" for axis in "abc"] + [
        f"_cell_angle_{name} 90" for name in ("alpha", "beta", "gamma")
    ]
    columns = ["label", "type_symbol", "fract_x", "fract_y", "fract_z", "occupancy"]
    loop = ["loop_", *(f"_atom_site_{name}" for name in columns)]
    group = "_symmetry_space_group_name_H-M 'P 1'"
    write("a.cif", "data_made", *head, group, *loop, *sites)
    for door in (system_from_file, lambda file: md.System.from_ase(ase.io.read(file))):
        assert_answered(lambda door=door: door("a.cif"), ValueError, "occupancy", *words)
    write("b.cif", "data_made", *head, group, *loop, "Na1 Na 0 0 0 1.0", "Cl1 Cl 0.5 0.5 0.5 ?")
    assert read("b.cif").species.tolist() == ["Na", "Cl"]


def test_columns_of_extended_xyz_are_read_and_labels_that_may_be_names_refused(here):
    head = 'Lattice="9 0 0 0 9 0 0 0 9" Properties=species:S:1:pos:R:3:mass:R:1:charge:R:1:{}:R:3'
    rows = ["H 0 0 0 2.014 0.4 0.001 0 0", "O 1 0 0 15.5 -0.4 0 0.002 0"]
    write("a.xyz", "2", head.format("vel"), *rows)
    system = read("a.xyz", "Å/fs")
    assert (system.masses.tolist(), system.charges.tolist()) == ([2.014, 15.5], [0.4, -0.4])
    assert system.velocities[0, 0] * md.units.fs == pytest.approx(0.001, rel=1e-12)
    write("b.xyz", "2", head.format("velo"), *rows)
    assert read("b.xyz", "ASE's units").velocities[1].tolist() == [0.0, 0.002, 0.0]
    reduced = read("b.xyz", units=md.units.LJ)
    assert (reduced.masses.tolist(), reduced.velocities[0].tolist()) == ([2.014, 15.5], [0.001, 0.0, 0.0])
    write("c.xyz", "1", "", "CA 0 0 0", "", "", "")
    assert_answered(lambda: system_from_file("c.xyz"), ValueError, "'CA'", "'Ca' or 'C'")


DUMP = ["ITEM: TIMESTEP", "0", "ITEM: NUMBER OF ATOMS", "2", "ITEM: BOX BOUNDS pp pp pp", "0 9", "0 9", "0 9"]


def test_dumps_state_their_units_and_types_are_no_elements(here):
    columns = "ITEM: ATOMS id type {} x y z vx vy vz"
    rows = "2 1 {} 4 1 1 0 0 0", "1 1 {} 1 1 1 0.003 0 0"
    atoms = lambda name, value: [columns.format(name), *(row.format(value) for row in rows)]  # noqa: E731
    for unit, scale in (("real", 1.0), ("metal", 1e-3)):
        write("a.dump", "ITEM: UNITS", unit, *DUMP, *atoms("mass", 39.948))
        system = read("a.dump")
        assert system.velocities[0, 0] * md.units.fs == pytest.approx(0.003 * scale, rel=1e-9)
        assert (system.masses.tolist(), system.species.tolist()) == ([39.948] * 2, ["1", "1"])
    write("b.dump", *DUMP, *atoms("element", "Ar"))
    assert_answered(lambda: system_from_file("b.dump"), ValueError, "units", "lammps_units=")
    assert read("b.dump", lammps_units="real").species.tolist() == ["Ar", "Ar"]
    write("c.dump", "ITEM: UNITS", "metal", *DUMP, *atoms("q", 0.0))
    assert_answered(lambda: system_from_file("c.dump"), ValueError, "'1'", "masses=")
    assert read("c.dump", masses={1: 131.3}).masses.tolist() == [131.3] * 2
    write("h.dump", "ITEM: UNITS", "real", *DUMP, *atoms("element", "H"))
    assert read("h.dump").species.tolist() == ["H", "H"]
    write("n.dump", "ITEM: UNITS", "nano", *DUMP, *atoms("mass", 1e-4))
    assert read("n.dump").masses[0] == pytest.approx(60.22, rel=1e-3)
    write("d.dump", "ITEM: UNITS", "lj", *DUMP, *atoms("q", 0.0))
    reduced = read("d.dump")
    assert (reduced.units, reduced.velocities[0].tolist()) == (md.units.LJ, [0.003, 0.0, 0.0])
    assert (reduced.species.tolist(), reduced.masses.tolist()) == (["1", "1"], [1.0, 1.0])


def psf(name, atoms, bonds):
    rows = [f"{k:8d} MOL  1    HOH  {label:<4s} {label:<4s} {charge:10.6f} {weight:13.4f} {0:11d}"
            for k, (label, charge, weight) in enumerate(atoms, start=1)]  # fmt: skip
    pairs = "".join(f"{i + 1:8d}{j + 1:8d}" for i, j in bonds)
    return write(name, "PSF", "", "       1 !NTITLE", " REMARKS made", "", f"{len(atoms):8d} !NATOM", *rows, "",
                 f"{len(bonds):8d} !NBOND: bonds", pairs, "", "       0 !NTHETA: angles", "", "       0 !NPHI", "",
                 "       0 !NIMPHI", "")  # fmt: skip


O, H = ("OH2", -0.8, 15.9994), ("H1", 0.4, 1.008)


def test_a_second_file_must_hold_the_same_atoms(here):
    write("a.xyz", "3", "", "H 0 0 0", "H 1.6 0 0", "O 0.8 0.6 0")
    assert_answered(lambda: system_from_file("a.xyz", bonds=psf("b.psf", [O, H, H], [(0, 1), (0, 2)])), ValueError,
                    "atom 0", "'H'", "'OH2'", "15.9994 u", "order")  # fmt: skip
    system = read("a.xyz", bonds=psf("c.psf", [H, H, O], [(2, 0), (2, 1)]))
    assert (system.masses.tolist(), system.charges.tolist()) == ([1.008, 1.008, 15.9994], [0.4, 0.4, -0.8])
    lines = [pdb_line(k, "ALA", name, (1.2 * k, 0, 0), name[0]) for k, name in enumerate(("CA", "CB", "C"))]
    write("d.pdb", *(line[:22] + "   1" + line[26:] for line in lines), "END")
    atoms = [(name, 0.1, 12.011) for name in ("CB", "CA", "C")]
    assert_answered(
        lambda: system_from_file("d.pdb", bonds=psf("e.psf", atoms, [(0, 1)])), ValueError, "'CA'", "'CB'", "order"
    )
    assert_answered(lambda: system_from_file("d.pdb", bonds="c.psf"), ValueError, "atom 0", "1.008 u")
    write("f.xyz", "4", "", *["C 0 0 0"] * 4)
    assert_answered(lambda: system_from_file("f.xyz", bonds="e.psf"), ValueError, "e.psf", "3 atoms", "4")
    write("g.gro", "site", "    1", gro_line(0, "SOL", "MW", (0, 0, 0)), CELL)
    assert read("g.gro", bonds=psf("h.psf", [("MW", 0.0, 17.5)], [])).masses.tolist() == [17.5]


def test_a_topology_of_gromacs_gives_bonds_charges_and_masses_and_is_no_structure(here):
    write("a.gro", "made up", "    2", gro_line(0, "LIG", "C1", (0, 0, 0)), gro_line(1, "LIG", "H1", (0.1, 0, 0)), CELL)
    lines = ["; whole", "[ defaults ]", "1 2 no 1 1", "[ atomtypes ]", "CX 6 12 0 A 0.3 0.5", "HX 1 1 0 A 0.1 0.1",
             "[ moleculetype ]", "LIG 3", "[ atoms ]", "1 CX 1 LIG C1 1 -0.2 12.5", "2 HX 1 LIG H1 1 0.2 1.5",
             "[ bonds ]", "1 2 1 0.1 2e5", "[ system ]", "one", "[ molecules ]", "LIG 1"]  # fmt: skip
    for name in ("a.itp", "a.top"):
        system = read("a.gro", bonds=write(name, *lines))
        assert (system.bonds.tolist(), system.masses.tolist()) == ([[0, 1]], [12.5, 1.5])
        assert system.charges == pytest.approx([-0.2, 0.2])
    for name in ("a.itp", "a.top", write("a.psf", "PSF"), write("a.prmtop", "%VERSION")):
        assert_answered(lambda: system_from_file(name), ValueError, name, "bonds=", "minimd.from_openmm")


def test_masses_and_elements_are_given_by_names_or_one_by_one(here):
    write("a.gro", "made up", "    2", gro_line(0, "LIP", "B1", (0, 0, 0)), gro_line(1, "LIP", "B2", (1, 0, 0)), CELL)
    assert read("a.gro", masses={"B1": 45.0, "B2": 54.0}).masses.tolist() == [45.0, 54.0]
    assert read("a.gro", elements=["Ar", "Kr"]).masses.tolist() == [mass("Ar"), mass("Kr")]
    assert read("a.gro", units=md.units.LJ, masses={"B2": 3.0}).masses.tolist() == [1.0, 3.0]
    assert_answered(lambda: system_from_file("a.gro", masses={"B3": 1.0}), ValueError, "'B3'", "B1, B2")
    assert_answered(lambda: system_from_file("a.gro", masses=[1.0] * 3), ValueError, "masses", "2 atoms")
    assert_answered(lambda: system_from_file("a.gro", masses={"B1": -1.0}), ValueError, "masses", "positive")
    assert_answered(lambda: system_from_file("a.gro", elements={"B1": "Qq"}), ValueError, "element", "'Qq'")


@pytest.mark.parametrize(("head", "rows", "pbc"), [
    ("1 1 2", ("20 0 0", "0 20 0", "0 0 20"), [True] * 3), ("1 1", ("20 0 0", "0 20 0", "0 0 20"), [True] * 3),
    ("1 3 2", ("0 10 0", "-12 0 0", "0 0 14"), [True] * 3), ("1 0 2", (), [False] * 3),
    ("1 6 2", ("10 0 0", "0 10 0", "0 0 0"), [True, True, False]),
])  # fmt: skip
@pytest.mark.parametrize("label", ["Ar", "NA", "Cl-", "OW"])
def test_files_of_dl_poly_have_their_cell_and_velocities_in_their_unit(head, rows, pbc, label, here):
    element = {"NA": "Na", "Cl-": "Cl", "OW": "O"}.get(label, label)
    atoms = [line for k in (0, 1) for line in (f"{label}       {k + 1}", f"{4.0 * k} 0.0 0.0", "0.25 0.0 -0.5")]
    write("CONFIG", "made up", head, *rows, *atoms)
    system = read("CONFIG", f"{label!r}, is {element}")
    np.testing.assert_allclose(system.velocities[1] * md.units.ps, [0.25, 0.0, -0.5], rtol=1e-12)
    assert (system.cell.pbc.tolist(), system.species[0], system.masses[1]) == (pbc, element, mass(element))
    if rows:
        assert system.cell.vectors.tolist() == [[float(x) for x in row.split()] for row in rows]
    assert read("CONFIG", units=md.units.LJ).velocities[1].tolist() == pytest.approx([0.25, 0.0, -0.5], rel=1e-12)


def test_universes_that_forget_what_was_guessed(here):
    lines = [gro_line(0, "CA", "CA", (0, 0, 0)), gro_line(1, "W", "W", (1, 0, 0)), gro_line(2, "W", "W", (2, 0, 0))]
    universe = MDAnalysis.Universe(write("a.gro", "made up", "    3", *lines, CELL))
    assert_answered(lambda: md.System.from_mdanalysis(MDAnalysis.Merge(universe.atoms)), ValueError, "'W'")
    universe.atoms[1:].masses = 72.0
    with pytest.warns(UserWarning, match="'CA', is Ca"):
        system = md.System.from_mdanalysis(universe)
    assert system.masses.tolist() == [mass("Ca"), 72.0, 72.0]


MOLECULES = [
    ("C60", "C1", "C"),
    ("C60", "C60", "C"),
    ("O2", "O2", "O"),
    ("N2", "N1", "N"),
    ("H2", "H1", "H"),
    ("OH", "OH", "O"),
]


@pytest.mark.parametrize(("residue", "name", "element"), MOLECULES)
def test_molecules_that_are_called_as_their_atoms_are_no_ions(residue, name, element, here):
    write("a.gro", "made up", "    1", gro_line(0, residue, name, (0, 0, 0)), CELL)
    assert read("a.gro", f"{name!r}, is {element}").masses.tolist() == [mass(element)]


def test_deuterium_a_mark_of_the_byte_order_and_the_dummy_cell(here):
    with open("a.pdb", "w", encoding="utf-8-sig") as file:
        file.write("\n".join([CRYST.format(20, 20, 20, 90, 90, 90), pdb_line(0, "DOD", "O", (0, 0, 0), "O"),
                              pdb_line(1, "DOD", "D1", (1, 0, 0), "D"), "END"]))  # fmt: skip
    system = read("a.pdb")
    assert (system.species.tolist(), system.masses[1], system.cell.pbc.all()) == (["O", "D"], 2.014, True)
    write("b.pdb", CRYST.format(1, 1, 1, 90, 90, 90), *water_lines(), "END")
    assert not md.System.from_ase(ase.io.read("b.pdb")).cell.pbc.any()


def test_what_stands_in_columns_that_are_not_read_is_told(here):
    write("a.xyz", "1", "", "Ar 0 0 0 0.1 0.2 0.3")
    assert read("a.xyz", "columns").masses.tolist() == [mass("Ar")]
    assert_answered(lambda: system_from_file("a.xyz", lammps_units="lj"), ValueError, "no LAMMPS file", "'lj'")


def test_repartitioned_masses_of_a_second_file_are_taken(here):
    write("a.xyz", "3", "", "O 0.8 0.6 0", "H 0 0 0", "H 1.6 0 0")
    heavy = [("OH2", -0.8, 11.9634), ("H1", 0.4, 3.024), ("H2", 0.4, 3.024)]
    assert read("a.xyz", bonds=psf("b.psf", heavy, [(0, 1), (0, 2)])).masses.tolist() == [11.9634, 3.024, 3.024]


@pytest.mark.parametrize("name", ["a.pdb", "a.ent", "a.gro", "a.xyz", "a.cif", "a.data", "a.mol2", "a.traj", "a.dump"])
def test_a_file_without_atoms_is_refused_in_one_sentence(name, here):
    for text in ("", "REMARK nothing\n", "<!ENTITY a>\n\n"):
        write(name, text)
        assert_answered(lambda: system_from_file(name), ValueError, name)


def test_files_of_minimd_and_of_lammps_take_what_is_given(here):
    system = md.System([[0, 0, 0], [4, 0, 0]], masses=[72.0, 45.0], species=["W", "NC3"], units=md.units.ASE)
    md.Simulation(system, [], md.VelocityVerlet(1.0)).run(0, trajectory="a.h5md")
    assert read("a.h5md", masses={"W": 70.0}).masses.tolist() == [70.0, 45.0]
    assert read("a.h5md", elements={"W": "Kr"}).species.tolist() == ["Kr", "NC3"]
    rows = "1 1 1 1 1", "2 2 4 1 1"
    text = DATA.format(", units = real", "\nMasses\n\n1 72.0\n2 45.0\n", speed=0.0).replace(
        "1 atom types", "2 atom types"
    )
    write("a.data", text.replace("2 1 5 1 1", rows[1]))
    assert read("a.data", elements=np.array(["Ar", "Kr"])).species.tolist() == ["Ar", "Kr"]
    assert read("a.data", elements={"1": "Ar"}).species.tolist() == ["Ar", "2"]
    write("lj.data", text.replace("2 1 5 1 1", rows[1]).replace("real", "lj"))
    write("a.xyz", "2", "", "Ar 0 0 0", "Ar 4 0 0")
    assert read("a.xyz", bonds="lj.data").masses.tolist() == [mass("Ar")] * 2
    reduced = read("lj.data", bonds=psf("a.psf", [("1", 0.1, 39.9), ("2", 0.1, 39.9)], [(0, 1)]))
    assert (reduced.masses.tolist(), len(reduced.bonds)) == ([72.0, 45.0], 1)


def test_a_cell_that_cannot_be_is_told_and_replaced(here):
    write("a.pdb", CRYST.format(30.0, 30.0, 30.0, 10.0, 10.0, 170.0), *water_lines(), "END")
    assert not read("a.pdb", "no cell").cell.pbc.any()
    assert read("a.pdb", "no cell", cell=[9.0, 9.0, 9.0]).cell.pbc.all()


def test_a_format_may_be_named_in_small_letters(here):
    write("a.gro", *GRO, CELL, *(line.replace("0.100", "0.700") for line in GRO), CELL)
    assert read("a.gro", "'AR'", format="gro").positions[0, 0] == 7.0
    write("b.gro", "made up", "   -3", CELL)
    assert_answered(lambda: system_from_file("b.gro"), ValueError, "-3 atoms")


def test_a_scene_gives_what_its_file_does_not_state(here):
    beads = [gro_line(k, "W", "W", (0.1 + 0.5 * k, 0.1, 0.1)) for k in (0, 1)]
    write("a.gro", "made up", "    2", *beads, CELL)
    scene = '[structure]\nfile = "a.gro"\n{}[[potential]]\ntype = "lennard-jones"\nepsilon_eV = 0.05\nsigma_A = 4.7\n'
    rest = 'cutoff_A = 12.0\n[dynamics]\nmethod = "velocity-verlet"\ntimestep_fs = 20.0\nsteps = 2\n'
    for line, species in (("masses = { W = 72.0 }\n", "W"), ('elements = { W = "Kr" }\n', "Kr")):
        system = parse_scene(scene.format(line) + rest, Path("scene.toml")).system()
        assert (set(system.species.tolist()), system.masses[0]) == ({species}, 72.0 if species == "W" else mass("Kr"))
    with pytest.raises(ValueError, match=r"a\.gro.*masses="):
        parse_scene(scene.format("") + rest, Path("scene.toml")).system()


def argon():
    """All that a system has, apart from bonds."""
    draw = np.random.default_rng(5)
    places = draw.uniform(-20.0, 40.0, (6, 3))
    return md.System(places, masses=mass("Ar"), velocities=draw.normal(size=(6, 3)), cell=[21.0, 22.0, 23.0],
                     species=["Ar"] * 6, units=md.units.ASE)  # fmt: skip


def water():
    return md.water("SPC/E", 8, cutoff=3.0)[0]


def melt():
    """Chains in reduced units, of two masses, charged, in a skewed cell."""
    draw = np.random.default_rng(6)
    bonds = [[0, 1], [1, 2], [3, 4]]
    places, velocities = draw.uniform(0.0, 9.0, (5, 3)), draw.normal(size=(5, 3))
    return md.System(places, masses=[2.0, 1.0, 1.0, 2.0, 1.0], velocities=velocities,
                     cell=[[7.0, 0, 0], [1.0, 8.0, 0], [0.5, 2.0, 9.0]], species=["2", "1", "1", "2", "1"], bonds=bonds,
                     angles=[[0, 1, 2]], charges=[0.5, -0.5, 0.0, 0.25, -0.25])  # fmt: skip


def drop():
    return md.System(argon().positions, masses=mass("Ar"), species=["Ar"] * 6, units=md.units.ASE)


FIELDS = ("positions", "velocities", "masses", "charges", "cell", "pbc", "species", "bonds", "angles")
# what formats do not keep, and how well they keep the rest; docs/formats.md says so
LOST = {
    "h5md": ((), 0.0), "traj": (("bonds", "angles"), 1e-15), "extxyz": ((), 3e-8), "data": ((), 4e-14),
    "pdb": (("velocities", "masses", "charges", "angles"), 1e-3),
    "gro": (("masses", "charges", "bonds", "angles"), 6e-3),
}  # fmt: skip


def fields(system):
    values = {name: getattr(system, name) for name in FIELDS if name not in ("cell", "pbc")}
    return values | {"cell": system.cell.vectors * system.cell.pbc[:, None], "pbc": system.cell.pbc}


@pytest.mark.parametrize("scene", [argon, water, melt, drop])
@pytest.mark.parametrize("form", LOST)
def test_what_is_written_is_read_back_but_for_what_a_format_loses(scene, form, here):
    from minimd.mdanalysis import universe

    system, (lost, tolerance) = scene(), LOST[form]
    simulation = md.Simulation(system, [], md.VelocityVerlet(1e-3))
    with warnings.catch_warnings(action="ignore"):
        if form == "data":
            system.write("a.data")
        elif form in ("pdb", "gro"):
            universe(simulation).atoms.write(f"a.{form}")
        else:
            simulation.run(0, trajectory=f"a.{form}")
        back = system_from_file(f"a.{form}", units=system.units)
    found, expected = fields(back), fields(system)
    if form == "gro" and scene is melt:  # 1 σ is 1 Å in MDAnalysis, which writes nm
        found |= {name: 10.0 * found[name] for name in ("positions", "velocities", "cell")}
    for name in (one for one in FIELDS if one not in lost):
        if name in ("bonds", "angles"):  # in any order
            assert sorted(found[name].tolist()) == sorted(expected[name].tolist()), name
        elif found[name].dtype.kind == "f":
            np.testing.assert_allclose(found[name], expected[name], rtol=0.0, atol=tolerance, err_msg=name)
        else:
            assert found[name].tolist() == expected[name].tolist(), name


DATA = """LAMMPS data file{}

2 atoms
1 atom types
0 15 xlo xhi
0 15 ylo yhi
0 15 zlo zhi
{}
Atoms # atomic

1 1 1 1 1
2 1 5 1 1

Velocities

1 {speed} 0 0
2 0 0 -{speed}
"""
MASSES = "\nMasses\n\n1 83.798\n"


@pytest.mark.parametrize(("unit", "per_fs"), [("real", 1.0), ("metal", 1e-3)])
def test_lammps_data_are_read_in_the_units_that_they_state(unit, per_fs, here):
    expected = pytest.approx(0.0021 / md.units.fs, rel=1e-9)
    write("a.data", DATA.format(f" via write_data, units = {unit}", MASSES, speed=0.0021 / per_fs))
    system = read("a.data")
    assert (system.velocities[0, 0], system.species.tolist()) == (expected, ["Kr", "Kr"])
    made = md.System.from_mdanalysis(MDAnalysis.Universe("a.data", atom_style="id type x y z"))
    assert made.velocities[0, 0] == pytest.approx(0.0021 / md.units.fs, rel=1e-6)
    with warnings.catch_warnings(record=True, action="always") as told:
        md.System.from_ase(ase.io.read("a.data", format="lammps-data"))
    assert ["units = real" in str(one.message) for one in told] == [True] * (unit == "real")
    assert_answered(lambda: system_from_file("a.data", units=md.units.LJ), ValueError, "units", unit, "'LJ'")
    assert_answered(lambda: system_from_file("a.data", lammps_units="si"), ValueError, unit, "'si'")


def test_units_of_lammps_data_that_are_not_known_are_refused(here):
    write("a.data", DATA.format("", MASSES, speed=1.5))
    for options in ({}, {"units": md.units.ASE}):
        assert_answered(lambda options=options: system_from_file("a.data", **options), ValueError, "lammps_units=")
    assert read("a.data", lammps_units="metal").velocities[0, 0] * md.units.ps == pytest.approx(1.5, rel=1e-12)
    assert_answered(lambda: system_from_file("a.data", lammps_units="reel"), ValueError, "lammps_units", "'reel'")
    universe = MDAnalysis.Universe("a.data", atom_style="id type x y z")
    assert_answered(lambda: md.System.from_mdanalysis(universe), ValueError, "velocities", "lammps_units=")
    reduced = md.System.from_mdanalysis(universe, units=md.units.LJ)
    assert (reduced.velocities[0, 0], reduced.masses[0]) == (pytest.approx(1.5, rel=1e-6), 83.798)
    write("b.data", DATA.format(", units = lj", "", speed=1.5))
    system = read("b.data")
    assert (system.units, system.velocities[0, 0], system.masses.tolist()) == (md.units.LJ, 1.5, [1.0, 1.0])
    assert_answered(lambda: system_from_file("b.data", units=md.units.ASE), ValueError, "lj", "'ASE'")


def test_types_of_lammps_are_no_elements_without_masses(here):
    write("a.data", DATA.format(", units = real", "", speed=0.0))
    assert_answered(lambda: system_from_file("a.data"), ValueError, "atom 0", "'1'", "masses=")
    assert read("a.data", masses={"1": 40.0}).species.tolist() == ["1", "1"]
    assert read("a.data", elements={"1": "Ar"}).masses.tolist() == [mass("Ar")] * 2
    atoms = ase.io.read("a.data", format="lammps-data", units="real")
    assert_answered(lambda: md.System.from_ase(atoms), ValueError, "atom 0", "'1'", "masses=")


@pytest.mark.slow
def test_files_of_others_are_right_or_refused_in_a_sentence():
    """Those of one package; corpus.py takes any folder."""
    tests = pytest.importorskip("MDAnalysisTests")
    counts, told = judged([Path(tests.__file__).parent / "data"])
    assert [row for row in told if row[0].isupper()] == []
    total = sum(counts.values(), Counter())
    assert sum(total.values()) > 200
    assert total["right"] + total["right, told"] > 150
