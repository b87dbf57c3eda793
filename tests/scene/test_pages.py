"""docs/scenes.md has every key of a scene file, and the scenes of the pages are scenes."""

import importlib.util
import re
from pathlib import Path

import numpy as np
import pytest
from scene_texts import R, U, scene_of, write_tables

from minimd.scene.section import Section, sections_below

DOCS = Path(__file__).parents[2] / "docs"


@pytest.fixture(scope="module")
def written():
    """docs/write_scenes.py."""
    spec = importlib.util.spec_from_file_location("write_scenes", DOCS / "write_scenes.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def test_the_page_is_what_the_sections_say(written):
    """If not: python docs/write_scenes.py"""
    assert (DOCS / "scenes.md").read_text(encoding="utf-8") == written.page()


def test_every_section_and_key_is_on_the_page(written, monkeypatch):
    text, sections = written.page(), dict(map(reversed, written.sections()))
    assert set(sections) == {one for one in sections_below(Section) if one.__module__.startswith("minimd.")}
    for section, name in sections.items():
        for key, (field, _) in section.keys("ASE").items():
            heads = [] if name else [f"## [{field}]", f"## [[{field}]]"]
            assert any(one in text for one in [f"`{key}`", *heads]), key
    monkeypatch.delitem(written.MEANINGS["output"], "plot")
    with pytest.raises(KeyError, match="no meaning for the key 'plot'"):
        written.page()


def test_the_scenes_of_the_pages_are_scenes(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    write_tables()
    np.savetxt("argon.dat", np.column_stack([3.4 * R, 0.01 * U]))
    scenes, notebook = ((DOCS / name).read_text(encoding="utf-8") for name in ("scenes.md", "notebook.md"))
    assert len(scene_of(re.findall(r"```toml\n(.*?)```", scenes, re.S)[0]).system()) == 256
    (section,) = re.findall(r"```toml\n(.*?)```", notebook, re.S)
    text = f'[structure]\nfile = "pair.xyz"\n{section}[dynamics]\ntimestep_fs = 1.0\nsteps = 0\n'
    (potential,) = scene_of(text).potentials()
    assert (potential.cutoff, potential.truncation, len(potential.r)) == (8.5, "shifted", len(R))
