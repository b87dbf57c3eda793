"""Scenes that are wrong are answered with one sentence each, which names the place and shows what stands there."""

from pathlib import Path

import numpy as np
import pytest
from references import liquid, load, melt_scene
from scene_texts import ARGON, MIXTURE, REDUCED, SALT, TABULATED, WATER, everything_of, scene_of, write_tables
from wrong_calls import assert_answered

import minimd as md
from minimd.scene import load_scene, resume_run

TEXTS = {"reduced": REDUCED, "argon": ARGON.read_text(), "tabulated": TABULATED, "mixture": MIXTURE}
TEXTS |= {"salt": SALT, "water": WATER}
ROWS = [(text, *row) for name, text in TEXTS.items() for row in load("wrong_scenes.toml")[name]]
ROWS += [(SALT, SALT[SALT.index("potential = ") :], "", "potential is missing")]
ROWS += [(REDUCED, "timestep = 0.004", f"timestep = 1{400 * '0'}", "dynamics.timestep")]
ROWS += [(WATER, WATER, 'units = "LJ"\nwater = {}\ndynamics = { timestep = 1.0, steps = 1 }', 'units = "LJ"', '"ASE"')]
NO_TABLES = [  # what stands in the file of a table, None for no file, and what the sentence must contain
    (None, "'lj.dat'", "does not exist"), ("".join(f"{k} nan\n" for k in range(6)), "u must be finite"),
    ("1 a\n", "'lj.dat'", "'a'"), ("1 2\n2 3\n", "r must be", "6"), ("1 2\n3\n", "'lj.dat'", "two"),
]  # fmt: skip
DEEP = "nested too deeply"
NO_TOML = [
    ("a = [", "not valid TOML"), ("b = 1\nb = 2\nc = 3\n", "(at line 2, column 6), in 'b = 2'"), (b"\xff\xfe", "UTF-8"),
    (f"x = {'[' * 2000}{']' * 2000}", DEEP), (f"{'a.' * 20_000}a = 1", DEEP), (f"[{'a . ' * 20_000}a]", DEEP),
    ("\ufeff", "not valid TOML"),
]  # fmt: skip


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
