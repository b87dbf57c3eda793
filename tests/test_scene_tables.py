"""Tabulated laws in scenes, in files of two columns or in the scene itself; and the stress in record and file."""

import re
from pathlib import Path

import numpy as np
import pytest
from references import liquid, melt_scene
from scene_texts import scene_of

import minimd as md
from minimd.files.h5md_reader import read_file
from minimd.scene import resume_run, run_scene
from minimd.scene.running import differences

PAGE = (Path(__file__).parents[1] / "docs" / "notebook.md").read_text(encoding="utf-8")
R = np.linspace(0.8, 2.5, 2000)  # their text is longer than the 64 kB that an attribute of HDF5 can have in place
U = 4.0 * (R**-12 - R**-6)
LAW = 'type = "lennard-jones"\nepsilon = 1.0\nsigma = 1.0\ncutoff = 2.5\n'
TABLE = 'type = "tabulated"\nfile = "lj.dat"\ncutoff = 2.4\n'
TEXT = melt_scene(3, 4, '[output]\nevery = 2\nstress = true\ntrajectory = "a.h5md"\n').replace(LAW, TABLE)
MIXTURE = """
[structure]
file = "pair.xyz"
[[potential]]
type = "tabulated"
pairs = [{ species = ["Ar", "Ar"], file = "like" }, { species = ["Kr", "Ar"], file = "unlike" }, { species = ["Kr", "Kr"], file = "like" }]
truncation = "truncated"
[tables.like]
r_A = [2.0, 3.0, 4.0, 5.0, 6.0, 7.0]
u_K = [600.0, 500.0, 400.0, 300.0, 200.0, 100.0]
[tables.unlike]
r_A = [2.0, 3.0, 4.0, 5.0, 6.0, 7.0]
u_eV = [6.0, 5.0, 4.0, 3.0, 2.0, 1.0]
[dynamics]
timestep_fs = 1.0
steps = 0
"""


@pytest.fixture
def folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    np.savetxt("lj.dat", np.column_stack([R, U]), fmt="%.17g", header="r/σ  u/ε")
    (tmp_path / "pair.xyz").write_text("3\n\nAr 0 0 0\nKr 4.5 0 0\nAr 0 5.5 0\n")
    return tmp_path


def test_a_table_in_a_file_is_that_of_a_script(folder):
    (potential,) = scene_of(TEXT).potentials()
    script = md.Tabulated(R, U, cutoff=2.4)
    assert repr(potential) == repr(script)
    assert np.array_equal(potential.pair_energy(R[:-200]), script.pair_energy(R[:-200]))


def test_tables_of_pairs_have_the_unit_of_their_keys(folder):
    scene = scene_of(MIXTURE)
    found = md.evaluate(scene.system(), scene.potentials()).potential_energy
    far = (4.5**2 + 5.5**2) ** 0.5  # beyond the end
    assert far > 7.0
    assert found == pytest.approx(3.5 + 250.0 * 8.617330337e-5, rel=1e-7)


def test_a_run_goes_on_from_its_file_alone_with_its_table_and_its_stress(folder):
    lines = []
    whole = run_scene(scene_of(TEXT), steps=8, trajectory=folder / "whole.h5md", tell=lines.append)
    run_scene(scene_of(TEXT), tell=lines.append)
    (folder / "lj.dat").unlink()
    resumed = resume_run("a.h5md", 4, tell=lines.append)
    assert np.array_equal(resumed.positions, whole.positions)
    record = read_file("a.h5md").record
    assert record.stress.shape == (5, 3, 3)
    assert np.array_equal(record.stress, read_file("whole.h5md").record.stress)
    assert -np.trace(record.stress, axis1=1, axis2=2) / 3.0 == pytest.approx(record.pressure, rel=1e-12)  # rounding
    assert "potential      Tabulated, cutoff 2.4 σ, shifted" in lines


def test_a_table_that_was_changed_is_another_potential(folder):
    stored = scene_of(scene_of(TEXT).whole_text(), "elsewhere/a.h5md")
    assert differences(stored, scene_of(TEXT)) == []
    np.savetxt("lj.dat", np.column_stack([R, 1.1 * U]))
    [words] = differences(stored, scene_of(TEXT))
    assert words.startswith("tables.lj.dat.u: ")


@pytest.mark.parametrize(
    ("content", "words"),
    [
        (None, r"potential\[0\]: table 'lj.dat' does not exist"),
        ("", "'lj.dat' must hold two numbers on each line, r and u; it has 0 lines"),
        ("1 2 3\n" * 9, "'lj.dat' must hold two numbers on each line, r and u; it has 9 lines of 3"),
        ("1 2\n3\n", "'lj.dat' must hold two numbers on each line, r and u: "),
        ("1 a\n", "'lj.dat' must hold two numbers on each line, r and u: .*'a'"),
        ("1 2\n2 3\n", "r must be at least 6 distances"),
        ("".join(f"{k} nan\n" for k in range(6)), "u must be finite"),
    ],
)
def test_a_file_that_is_no_table_is_told(folder, content, words):
    Path("lj.dat").unlink() if content is None else Path("lj.dat").write_text(content)
    with pytest.raises(ValueError, match=r"^scene\.toml: potential\[0\]: ") as caught:
        scene_of(TEXT).simulation()
    assert re.search(words, str(caught.value))
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("text", "old", "new", "words"),
    [
        (TEXT, 'file = "lj.dat"\n', "", r"potential\[0\] must have either file, the table of all atoms, or pairs"),
        (
            TEXT,
            "cutoff = 2.4",
            "epsilon = 1.0",
            r"potential\[0\] has no key 'epsilon'.* Keys in LJ units: type, file, pairs, cutoff, truncation",
        ),
        (TEXT, "stress = true", 'stress = "yes"', r"output\.stress must be a boolean; output\.stress = \"yes\""),
        (
            TEXT,
            "density = 0.8442",
            "density = 0.8442\npbc = [true, true, false]",
            r"output\.stress: pressure and stress need a volume",
        ),
        (MIXTURE, "[tables.like]", "[tables.Like]", "no tabulated potential uses tables.'Like'"),
        (MIXTURE, "u_eV = [6.0, ", 'u_eV = ["6", ', r"tables\.unlike\.u_eV\[0\] must be a number"),
        (MIXTURE, ", 1.0]", "]", r"tables\.unlike\.u_eV must have at least 6 entries"),
        (MIXTURE, "u_eV = [6.0", "u_eV = [7.0, 6.0", "u of .* must be 6 energies"),
        (
            MIXTURE,
            "7.0]\nu_eV",
            "7.5]\nu_eV",
            r"the tables of one potential must have the same r; those of 'unlike' and 'like' differ",
        ),
    ],
)
def test_sections_that_are_wrong_are_told(folder, text, old, new, words):
    assert old in text
    with pytest.raises(ValueError, match=words) as caught:
        scene_of(text.replace(old, new)).simulation()
    assert "\n" not in str(caught.value)


def test_the_scene_of_the_page_is_one(folder):
    np.savetxt("argon.dat", np.column_stack([3.4 * R, 0.01 * U]))
    (section,) = re.findall(r"```toml\n(.*?)```", PAGE, re.S)
    text = f'[structure]\nfile = "pair.xyz"\n{section}[dynamics]\ntimestep_fs = 1.0\nsteps = 0\n'
    (potential,) = scene_of(text).potentials()
    assert (potential.cutoff, potential.truncation, len(potential.r)) == (8.5, "shifted", len(R))


def test_a_stored_scene_reads_no_other_file(tmp_path):
    """A data file may be anybody's: its scene has its tables in it, or is refused, whatever its names lead to."""
    sim, path = md.Simulation(liquid(3), md.LennardJones(1.0, 1.0, 1.8), md.VelocityVerlet(0.004)), tmp_path / "a.h5md"
    sim.engine.notes["scene"] = melt_scene(3, 10).replace(LAW, TABLE)
    sim.run(4, every=2, trajectory=path)
    (tmp_path / "lj.dat").write_text("not for others\n")
    for go_on in (md.Simulation.resume, resume_run):
        with pytest.raises(ValueError, match=r"it names 'lj\.dat'"):
            go_on(path)
