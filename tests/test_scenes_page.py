"""docs/scenes.md has every key of a scene file."""

import importlib.util
from pathlib import Path

import pytest

from minimd.scene.document import parse_scene
from minimd.scene.section import Section, sections_below

DOCS = Path(__file__).parents[1] / "docs"


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


def test_every_section_and_key_is_on_the_page(written):
    text = written.page()
    assert {section for _, section in written.sections()} == {
        one for one in sections_below(Section) if one.__module__.startswith("minimd.")
    }
    for name, section in written.sections():
        for key, (field, _) in section.keys("ASE").items():
            assert (
                f"`{key}`" in text
                or (name == "" and f"## [{field}]" in text)
                or (name == "" and f"## [[{field}]]" in text)
            ), key


def test_a_key_without_a_meaning_is_refused(written, monkeypatch):
    monkeypatch.delitem(written.MEANINGS["output"], "plot")
    with pytest.raises(KeyError, match="no meaning for the key 'plot'"):
        written.page()


def test_the_scene_of_the_page_is_one():
    text = (DOCS / "scenes.md").read_text(encoding="utf-8").partition("```toml\n")[2].partition("```")[0]
    assert len(parse_scene(text, Path("scene.toml")).system()) == 256


def test_a_table_that_is_none_is_answered_with_its_keys():
    text = (DOCS / "scenes.md").read_text(encoding="utf-8").partition("```toml\n")[2].partition("```")[0]
    wrong = text.replace(
        "[potential.species.Ar]\nepsilon_K = 119.8\nsigma_A = 3.405", "species = { Ar = [0.0103, 3.405] }"
    )
    with pytest.raises(
        ValueError,
        match=r"species\.Ar must be a table with the keys epsilon_K, epsilon_eV, sigma_A; .* = \[0\.0103, 3\.405\]",
    ):
        parse_scene(wrong, Path("scene.toml"))
