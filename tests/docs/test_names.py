"""Names and words: lists are those of minimd, words of other programs are answered, examples are linked."""

import importlib.util
import re
from pathlib import Path

import pytest

import minimd as md
from minimd.core.console.words import near
from minimd.foreign_words import WORDS, answer_to, entries, plain

REPOSITORY = Path(__file__).parents[2]
DOCS = REPOSITORY / "docs"
SPEC = importlib.util.spec_from_file_location("write_names", DOCS / "write_names.py")
WRITTEN = importlib.util.module_from_spec(SPEC)
SPEC.loader.exec_module(WRITTEN)
PAGES = {path.relative_to(DOCS).as_posix(): text for path, text in WRITTEN.pages().items()}
ALL = [word for words, _, _ in entries() for word in words]
# pages that tell how, and not only that
TOPICS = [path for path in DOCS.glob("*.md") if path.stem not in ("theory", "architecture", "accuracy", "where-is")]


@pytest.mark.parametrize("name", PAGES)
def test_lists_of_names_are_those_of_minimd(name):
    """If not: python docs/write_names.py"""
    assert (DOCS / name).read_text(encoding="utf-8") == PAGES[name]


def test_each_name_of_the_reference_has_a_sentence():
    for name, text in PAGES.items():
        rows = re.findall(r"^\| `(\S+)` \| (.*) \|$", text, re.M)
        assert rows or name == "where-is.md"
        assert [row for row in rows if len(row[1]) < 4 or "see help" in row[1]] == [], name


@pytest.mark.parametrize("word", ALL)
def test_a_word_of_the_field_is_answered_in_python(word):
    (answer,) = {answer for words, answer, _ in entries() if word in words}
    assert word not in md.__all__
    with pytest.raises(AttributeError) as caught:
        getattr(md, word)
    assert f"no attribute '{word}'; " in str(caught.value)
    assert answer in str(caught.value)


@pytest.mark.parametrize(
    ("name", "meant"),
    [("LenardJones", "LennardJones"), ("lennardjones", "LennardJones"), ("Coulombs", "Coulomb"), ("Wal", "Wall"),
     ("Restraints", "Restraint"), ("Hessain", ""), ("NormalMode", ""), ("LeesEdward", ""), ("RMSD", ""), ("", "")],
)  # fmt: skip
def test_a_name_that_differs_in_more_than_two_letters_is_not_suggested(name, meant):
    assert near(name, md.__all__) == (f"; did you mean {meant!r}?" if meant else "")


def test_a_class_is_not_answered_as_a_function_of_the_same_letters():
    with pytest.raises(AttributeError, match=r"it is minimd.observers.RadialDistribution$"):
        _ = md.RadialDistribution


def test_each_word_has_one_answer_and_its_page_is_there():
    assert len({*map(plain, ALL)}) == len(ALL)
    for _, _, page in entries():
        assert (DOCS / f"{page}.md").exists(), page


def test_words_of_the_tables_are_answered_in_python():
    text = (DOCS / "where-is.md").read_text(encoding="utf-8").partition("## Any word")[0]
    first_columns = "".join(re.findall(r"^\| (.*?) \|", text, re.M))
    words = {*re.findall(r"`([A-Za-z]\w*)`", first_columns)} - {*md.__all__}
    assert len(words) > 50
    assert [word for word in sorted(words) if not answer_to(word)] == []


TEXTS = {name: (DOCS / f"{name}.md").read_text(encoding="utf-8") for name in ("where-is", "limits", "recipes")}


@pytest.mark.parametrize("text", [WORDS, *TEXTS.values()], ids=["words", *TEXTS])
def test_names_that_answers_give_exist(text):
    for path in {*re.findall(r"\bmd\.(\w+(?:\.[A-Za-z_]\w*)*)", text)} - {*ALL, "WORD"}:
        item = md
        for name in path.split("."):
            item = getattr(item, name)  # it raises
    for name in set(re.findall(r"\bsim\.([a-z_]\w*)", text)) - {"time"}:
        assert hasattr(md.Simulation, name) or name == "record", name


def test_each_example_is_linked_from_the_page_of_its_topic():
    text = "".join(path.read_text(encoding="utf-8") for path in TOPICS)
    examples = [path.relative_to(REPOSITORY).as_posix() for path in (REPOSITORY / "examples").glob("*.*")]
    assert [name for name in examples if f"`{name}`" not in text and name not in text] == []
