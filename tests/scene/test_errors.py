"""Scenes that are wrong are answered with one sentence each, which names the place and shows what stands there."""

from pathlib import Path

import numpy as np
import pytest
from references import liquid, melt_scene
from scene_texts import ARGON, MIXTURE, REDUCED, SALT, TABULATED, WATER, everything_of, scene_of, write_tables
from wrong_calls import assert_answered

import minimd as md
from minimd.scene import load_scene, resume_run

# fmt: off
WRONG = [  # what stands in the scene, what is written there, and what the sentence must contain
    ("timestep = 0.004", "timestep_fs = 4.0", "dynamics", "'timestep_fs' (= 4.0)", "did you mean 'timestep'?", "LJ"),
    ("timestep = 0.004", "timestep = -0.004", "dynamics.timestep", "0", "= -0.004"),
    ("timestep = 0.004", f"timestep = 1{400 * '0'}", "dynamics.timestep"),
    ("timestep = 0.004\n", "", "dynamics.timestep is missing"), ("steps = 20", "steps = 2.5", "dynamics.steps", "2.5"),
    ("seed = 3", "threads = 0", "dynamics.threads", "0"), ("every = 5", "every = 0", "output.every", "= 0"),
    ("cutoff = 2.5", "cutoff = -2.5", "potential[0].cutoff", "-2.5"), ("cutoff = 2.5\n", "", "cutoff", "periodic cell"),
    ("cutoff = 2.5\n", "cutoff = 2.5\nspecies = {Ar = [0.01, 3.4]}\n", "species.Ar", "epsilon, sigma", "[0.01, 3.4]"),
    ("sigma = 1.0\n", "", "potential[0]", "epsilon and sigma"), ("[[potential]]", "[potential]", "[[potential]]"),
    ('"lennard-jones"', '"lenard-jones"', "potential[0].type", "'harmonic-bond'", '"lenard-jones"'),
    ("[4, 4, 4]", "[4, 4, 1000000000000]", "structure: repeat", "1000000000000"),
    ("[4, 4, 4]", "[4, 40000, 40000]", "structure: repeat", "2.6e+10"),
    ("[4, 4, 4]", "[4, 4, 0]", "structure.repeat[2]", "= 0"), ("every = 5", 'plot = "a.docx"', "plot", "a.docx"),
    ("density = 0.8442\n", "", "structure", "density or lattice_constant"),
    ("density = 0.8442", 'density = 0.8442\nfile = "a.xyz"', "structure", "file or lattice"),
    ("density = 0.8442", "density = 0.8442\nbonds = [[0, 256]]", "structure: bonds", "0 to 255", "[0, 256]"),
    ("every = 5", 'plot = true\ntrajectory = "a.xyz"', "output.plot", ".h5md", "a.xyz"),
    ('units = "LJ"', 'units = "SI"', "units", "'ASE' or 'LJ'", '"SI"'),
    ("temperature = 1.44\nsteps = 20\nseed = 3\n", "steps = 20\n[equilibration]\nsteps = 10\ntemperature = 1.0\n",
     "equilibration", "dynamics.temperature"),
]
WRONG_ARGON = [  # in ASE's units
    ("epsilon_K = 120.0", "epsilon_K = 120.0\nepsilon_eV = 0.0103", "potential[0]", "'epsilon_eV'", "another unit"),
    ("density_g_cm3", "density", "structure", "'density' (= 1.374)", "did you mean 'density_g_cm3'?"),
]
WRONG_TABLES = [  # of the scene with a table in a file, and of the mixture with tables in it
    (TABULATED, 'file = "lj.dat"\n', "", "potential[0]", "file", "pairs"),
    (TABULATED, "density = 0.8442", "density = 0.8442\npbc = [true, true, false]", "output.stress", "volume"),
    (MIXTURE, "\nlike = ", "\nLike = ", "tables.'Like'"),  (MIXTURE, "u_eV = [6.0", "u_eV = [7.0, 6.0", "6 energies"),
    (MIXTURE, ", 1.0]", "]", "tables.unlike.u_eV", "6"),   (MIXTURE, "[6.0, ", '["6", ', "tables.unlike.u_eV[0]"),
    (MIXTURE, "7.0]\nu_eV", "7.5]\nu_eV", "the same r", "'unlike'", "'like'"),
]
WRONG_SALT = [
    ("B = -0.7", "C = -0.7", "structure: charges", "'A', 'B'", "'A', 'C'"), ("{ A = 0.7, B = -0.7 }", "[0.7]", "(1,)"),
    ("B = -0.7", 'B = "x"', "structure.charges.B", '"x"'), ("{ A = 0.7, B = -0.7 }", "0.7", "a list or a table"),
    ("charges = { A = 0.7, B = -0.7 }, ", "", "structure.charges"), ("1.39, ", "0.001, ", "cutoff", "0.001"),
    ("1e-4", "0.5", "potential[1]: accuracy", "0.5"), ('"ewald"', '"pme"', "potential[1].method", "'reaction-field'"),
    ("cutoff = 1.39, ", "", "cutoff", "periodic cell"), ("cutoff = 1.39", "cutof = 1.39", "did you mean 'cutoff'?"),
]
WRONG_WATER = [
    ("\nwater", '\nstructure = { file = "a.xyz" }\nwater', "structure and water"), ("27", "0", "molecules", "= 0"),
    ("\nwater", '\nconstraints = { pairs = "bonds" }\nwater', "constraints.pairs", "water"),
    ("\nwater", "\nconstraints = { pairs = [] }\nwater", "constraints.pairs", "water"), ("27", "10e9", "10000000000.0"),
    ('"OPC3"', '"SPC"', "water.model", "'SPC/E'", '"SPC"'), ("density_g_cm3", "density", "mean 'density_g_cm3'?"),
    ("0.95", "-0.95", "water.density_g_cm3", "-0.95"), ("= 4.0", "= -4.0", "water.cutoff_A", "-4.0"),
    ("1e-4", "0.5", "water: accuracy", "0.5"), ("27", "1_000_000_000", "water.molecules", "1000000000"),
    (WATER.splitlines()[1], "", "structure is missing"), (WATER.splitlines()[1], "water = 3", "must be a table", "= 3"),
    (WATER, 'units = "LJ"\nwater = {}\ndynamics = { timestep = 1.0, steps = 1 }', 'units = "LJ"', '"ASE"'),
]
NO_TABLES = [  # what stands in the file of a table, None for no file, and what the sentence must contain
    (None, "'lj.dat'", "does not exist"), ("".join(f"{k} nan\n" for k in range(6)), "u must be finite"),
    ("1 a\n", "'lj.dat'", "'a'"), ("1 2\n2 3\n", "r must be", "6"),
    ("1 2\n3\n", "'lj.dat'", "two"),
]
DEEP = "nested too deeply"
NO_TOML = [
    ("a = [", "not valid TOML"), ("b = 1\nb = 2\nc = 3\n", "(at line 2, column 6), in 'b = 2'"),
    (b"\xff\xfe", "UTF-8"), (f"x = {'[' * 2000}{']' * 2000}", DEEP),
    ("\ufeff", "not valid TOML"), (f"{'a.' * 20_000}a = 1", DEEP),
    (f"[{'a . ' * 20_000}a]", DEEP),
]
ROWS = [(REDUCED, *row) for row in WRONG] + [(ARGON.read_text(), *row) for row in WRONG_ARGON] + WRONG_TABLES
ROWS += [(SALT, *row) for row in WRONG_SALT] + [(WATER, *row) for row in WRONG_WATER]
ROWS += [(SALT, SALT[SALT.index("potential = ") :], "", "potential is missing")]
# fmt: on


@pytest.mark.parametrize("row", ROWS, ids=lambda row: f"{row[3]} {row[-1]}")
def test_a_wrong_entry_is_answered_with_its_place_and_itself(row, here):
    write_tables()
    text, old, new, *shown = row
    assert old in text
    assert_answered(lambda: everything_of(text.replace(old, new, 1)), ValueError, "scene.toml: ", *shown)


def test_what_is_no_table_and_what_is_no_toml_is_told(here):
    for content, *shown in NO_TABLES:
        if content is not None:
            Path("lj.dat").write_text(content)
        assert_answered(lambda: everything_of(TABULATED), ValueError, "scene.toml: potential[0]: ", *shown)
    for content, *shown in NO_TOML:
        Path("a.toml").write_bytes(content if isinstance(content, bytes) else content.encode())
        assert_answered(lambda: load_scene("a.toml"), ValueError, "a.toml", *shown)


def test_all_problems_are_told_at_once():
    two = REDUCED.replace("density", "densty").replace("every", "evry")
    three = "steps = -20\nrelaxation_tim = 0.3\nsed = 2"
    for text, places in ((two, ["structure", "output"]), (REDUCED.replace("steps = 20", three), 3 * ["dynamics"])):
        with pytest.raises(ValueError, match=r"scene\.toml") as caught:
            scene_of(text)
        lines = str(caught.value).splitlines()
        assert [line.removeprefix("scene.toml: ").split(".")[0].split(" ")[0] for line in lines] == places


def test_a_stored_scene_reads_no_other_file(tmp_path):
    """A data file may be anybody's: its scene has its tables in it, or is refused, whatever its names lead to."""
    simulation = md.Simulation(liquid(3), md.LennardJones(1.0, 1.0, 1.8), md.VelocityVerlet(0.004))
    law = 'type = "lennard-jones"\nepsilon = 1.0\nsigma = 1.0\n'
    simulation.engine.notes["scene"] = melt_scene(3, 10).replace(law, 'type = "tabulated"\nfile = "lj.dat"\n')
    simulation.run(4, every=2, trajectory=tmp_path / "a.h5md")
    np.savetxt(tmp_path / "lj.dat", np.ones((9, 2)))
    for go_on in (md.Simulation.resume, resume_run):
        assert_answered(lambda: go_on(tmp_path / "a.h5md"), ValueError, "potential[0]", "'lj.dat'")
