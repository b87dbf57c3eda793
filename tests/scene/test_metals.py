"""Metals in scenes: tables of a file, whose text the run holds, or a law by its name; wrong ones are told."""

import os
import re
import tomllib
from pathlib import Path

import metals
import numpy as np
import pytest
from ase.build import bulk
from ase.io import write
from scene_texts import scene_of
from wrong_calls import assert_answered

import minimd as md
from minimd.core.files.h5md_reader import read_file
from minimd.scene import resume_run, run_scene
from minimd.scene.running import differences

COPPER = """
structure = { lattice = "fcc", element = "Cu", repeat = [4, 4, 4], lattice_constant_A = 3.8 }
potential = [{ type = "embedded-atom", file = "tables/copper.eam" }]
dynamics = { timestep_fs = 2.0, temperature_K = 600.0, seed = 1, steps = 4 }
output = { every = 2, trajectory = "a.h5md" }
"""
ALLOY = """
structure = { file = "alloy.xyz" }
dynamics = { timestep_fs = 2.0, steps = 4 }
output = { trajectory = "a.h5md" }

[[potential]]
type = "embedded-atom"
law = "sutton-chen"
cutoff_A = 5.5
truncation = "smooth"
switch_start_A = 4.5
pairs = [{ species = ["Al", "Cu"], parameters = [0.02, 3.8, 0.0, 8.0, 6.0] }]

[potential.species]
Cu = [0.0124, 3.61, 39.4, 9.0, 6.0]
Al = [0.0331, 4.05, 16.4, 7.0, 6.0]
"""
OWN = {"Cu": (0.0124, 3.61, 39.4, 9.0, 6.0), "Al": (0.0331, 4.05, 16.4, 7.0, 6.0)}
UNLIKE = {("Cu", "Al"): (0.02, 3.8, 0.0, 8.0, 6.0)}
SILENT = {"tell": lambda line: None, "progress": False}


@pytest.fixture
def folder(here):
    """A current folder with the files that scenes of this page name."""
    Path("tables").mkdir()
    Path("tables/copper.eam").write_text(metals.funcfl())
    Path("tables/alloy.fs").write_text(metals.setfl(both_ways=True))
    atoms = bulk("Cu", "fcc", 3.9, cubic=True) * (3, 3, 3)
    atoms.rattle(0.2, seed=7)
    atoms.symbols[::3] = "Al"
    write("alloy.xyz", atoms, format="extxyz")
    return here


def energy_of(scene):
    return md.evaluate(scene.system(), scene.potentials()).potential_energy


def test_a_run_of_a_file_goes_on_in_a_folder_without_the_file(folder, monkeypatch):
    """The run holds the text of the tables, and the resumed one has the bits of one that was not interrupted."""
    whole = run_scene(scene_of(COPPER), steps=8, trajectory=folder / "whole.h5md", **SILENT)
    run_scene(scene_of(COPPER), **SILENT)
    stored = tomllib.loads(read_file("a.h5md").scene)
    assert stored["files"]["tables/copper.eam"]["text"] == metals.funcfl()
    elsewhere = folder / "elsewhere"
    elsewhere.mkdir()
    Path("a.h5md").rename(elsewhere / "a.h5md")
    monkeypatch.chdir(elsewhere)
    resumed = md.Simulation.resume("a.h5md")
    resumed.run(4, every=2, progress=False)
    for simulation in (resumed, resume_run("a.h5md", 4, tell=lambda line: None)):
        assert np.array_equal(simulation.positions, whole.positions)
        assert np.array_equal(simulation.velocities, whole.velocities)


def test_a_scene_of_a_file_has_the_energy_of_a_script(folder):
    potential = '[[potential]]\ntype = "embedded-atom"\nfile = "tables/alloy.fs"\n'
    scene = scene_of(ALLOY[: ALLOY.index("[[potential]]")] + potential)
    script = md.EmbeddedAtom.from_file("tables/alloy.fs")
    assert energy_of(scene) == md.evaluate(scene.system(), script).potential_energy


def test_a_scene_of_a_law_has_the_energy_of_a_script(folder):
    script = md.EmbeddedAtom("sutton-chen", OWN, 5.5, "smooth", pairs=UNLIKE, switch_start=4.5)
    scene = scene_of(ALLOY)
    assert energy_of(scene) == md.evaluate(scene.system(), script).potential_energy
    one = md.EmbeddedAtom("gupta", (0.0855, 1.224, 10.96, 2.278, 2.556), 5.88, "truncated")
    of_all = (
        'law = "gupta", parameters = [0.0855, 1.224, 10.96, 2.278, 2.556], cutoff_A = 5.88, truncation = "truncated"'
    )
    scene = scene_of(COPPER.replace('file = "tables/copper.eam"', of_all))
    assert energy_of(scene) == md.evaluate(scene.system(), one).potential_energy
    reduced = scene.sections.potential[0].potential(str)
    assert repr(reduced) == repr(one)


def test_a_text_in_the_scene_is_used_instead_of_the_file_and_another_text_is_told(folder):
    """Also a text with a control character in its comment."""
    comment = "made for\x7f tests"
    Path("tables/copper.eam").write_text(metals.funcfl().replace("made for tests", comment))
    scene = scene_of(COPPER)
    stored = scene_of(scene.whole_text(), "elsewhere/a.toml")
    assert stored.sections.files["tables/copper.eam"].text.startswith(comment)
    assert energy_of(stored) == energy_of(scene)
    assert differences(stored, scene) == []
    Path("tables/copper.eam").write_text(metals.funcfl())
    (difference,) = differences(stored, scene)
    assert difference.startswith("files.tables/copper.eam.text: ")
    assert len(difference) < 1000


def test_the_scenes_of_the_page_on_metals_are_scenes(folder):
    Path("Ni99.eam.alloy").write_text(metals.setfl(("Cu",)).replace("1 Cu", "1 Ni", 1))
    atoms = bulk("Cu", "fcc", 3.57, cubic=True) * (4, 4, 4)
    atoms.symbols[::2] = "Ni"
    write("alloy.xyz", atoms, format="extxyz")
    page = Path(__file__).parents[2] / "docs" / "metals.md"
    scenes = re.findall(r"```toml\n(.*?)```", page.read_text(encoding="utf-8"), re.S)
    energies = [energy_of(scene_of(text)) for text in scenes]
    assert len(energies) == 2
    assert -4.5 < energies[1] / len(atoms) < -3.5  # between the cohesive energies of nickel and copper


FILE, NUMBERS = 'file = "tables/copper.eam"', "Cu = [0.0124, 3.61, 39.4, 9.0, 6.0]\n"
WRONG = [  # the scene, what stands there, what is written instead, and what the sentence must contain
    (COPPER, f", {FILE}", "", "potential[0]", "either file", "or law"),
    (COPPER, FILE, f'{FILE}, law = "gupta"', "potential[0]", "either file", "or law"),
    (COPPER, FILE, f"{FILE}, cutoff_A = 5.0", "potential[0]", "with a file", "nothing else"),
    (COPPER, FILE, f"{FILE}, parameters = [1.0]", "potential[0]", "with a file", "nothing else"),
    (COPPER, FILE, 'law = "gupta", cutoff_A = 5.0', "potential[0]", "either parameters", "species"),
    (COPPER, FILE, 'law = "gupt", parameters = [1.0]', "potential[0].law", "'gupta'", '"gupt"'),
    (COPPER, FILE, 'law = "gupta", cutoff_A = 5.0, parameters = [1.0, 2.0]', "potential[0]", "5 numbers", "A, xi, p"),
    (COPPER, FILE, 'law = "gupta", parameters = [0.1, 1.0, 9.0, 2.0, 2.5]', "cutoff", "periodic cell"),
    (COPPER, "copper.eam", "nickel.eam", "potential[0]", "nickel.eam", "cannot be read", "relative to the scene"),
    (COPPER, "/copper.eam", "", "potential[0]", "'tables'", "regular file"),
    (COPPER, "tables/copper.eam", "alloy.xyz", "potential[0]", "five finite numbers"),
    (COPPER, '"Cu"', '"Ni"', "names of elements", "'Ni'"),
    (COPPER + "[files.nickel]\ntext = ''\n", "", "", "no potential uses files.'nickel'"),
    (COPPER + '[files."tables/copper.eam"]\n', "", "", "files.tables/copper.eam.text is missing"),
    (ALLOY, NUMBERS, f"{NUMBERS}Ni = 1.0\n", "potential[0].species.Ni", "1.0"),
    (ALLOY, NUMBERS, "", "no parameters for species 'Cu'"),
    (ALLOY, "pairs = [{ species", "pairs = [{ specis", "potential[0].pairs[0]", "did you mean 'species'?"),
    (ALLOY, ALLOY[ALLOY.index("pairs") : ALLOY.index("\n\n[potential.s")], "", "'Al', 'Cu'", "pairs"),
]


@pytest.mark.parametrize("row", WRONG, ids=lambda row: " ".join(row[3:]))
def test_a_wrong_metal_is_answered_with_its_place_and_itself(row, folder):
    text, old, new, *shown = row
    assert old in text

    def energy():
        return energy_of(scene_of(text.replace(old, new, 1)))

    assert_answered(energy, ValueError, *shown)


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="no named pipes")
def test_a_pipe_is_no_file_of_tables(folder):
    os.mkfifo("tables/pipe")
    assert_answered(scene_of(COPPER.replace("copper.eam", "pipe")).potentials, ValueError, "regular file", "pipe")
