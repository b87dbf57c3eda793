"""The site: built without a warning, a broken link or a request to any host; its search finds what people look for."""

import importlib.util
import json
import re
import shutil
import subprocess
import sys
from html import unescape
from pathlib import Path
from urllib.parse import unquote, urlsplit

import numpy as np
import pytest

SearchEnglish = pytest.importorskip("sphinx.search.en").SearchEnglish
pytestmark = pytest.mark.slow
REPOSITORY = Path(__file__).parents[2]
# of minimd and of other programs, as a newcomer may type them; the search looks for stems
WORDS = """ramp, heating, annealing, 2D disks, two dimensions, hexatic, Steinhardt, heat flux, thermal conductivity,
dielectric, dipole, ions, salt, chains, gyration, Rouse, order parameters, overlap, umbrella, WHAM, Jarzynski,
surface tension, pressure profile, elastic, virial, Mie, soft core, quartic, table, dump, NoseHoover, NPT, Berendsen,
Andersen, thermostat, integrator, slab, TIP4P, GPU, pulling, viscosity, stress, SPCE, minimizer, restart, LAMMPS,
GROMACS, OpenMM, join, chi4, ForceField, Tersoff, RESPA"""
SEARCHED = {"restart": "files", "bond": "bonds", "law": "own-laws", "charg": "water", "gpu": "limits"}  # by stems
NEEDED = ("sphinx", "myst_parser", "sphinx_gallery", "furo", "sphinx-mathjax-offline")


@pytest.fixture(scope="module")
def site(tmp_path_factory):
    """The folder of the site, built from a copy, without running the examples."""
    if missing := [name for name in NEEDED if importlib.util.find_spec(name) is None]:
        pytest.skip(f"{missing[0]} is not installed: pip install '.[docs]'")
    folder, ignored = tmp_path_factory.mktemp("site"), shutil.ignore_patterns("_build", "gallery", "__pycache__")
    for name in ("CHANGELOG.md", "README.md"):
        shutil.copy(REPOSITORY / name, folder)
    for name in ("docs", "examples", "course", "tests"):
        shutil.copytree(REPOSITORY / name, folder / name, ignore=ignored, ignore_dangling_symlinks=True)
    command = [sys.executable, "-m", "sphinx", "-W", "--keep-going", "-q", "-D", "plot_gallery=0", "docs", "site"]
    built = subprocess.run(command, cwd=folder, capture_output=True, text=True)
    assert built.returncode == 0, built.stderr[-4000:]
    return folder / "site"


def test_links_inside_lead_somewhere_and_nothing_is_fetched_from_outside(site):
    texts = {page: page.read_text(encoding="utf-8") for page in site.rglob("*.html")}
    places = {page: {*re.findall(r'\b(?:id|name)="([^"]+)"', text)} for page, text in texts.items()}
    assert len(texts) > 60
    for page, text in texts.items():
        sources = re.findall(r'<(?:img|script|iframe|source)\b[^>]*?\bsrc="([^"]+)"', text)
        sheets = [tag for tag in re.findall(r"<link\b[^>]*>", text) if 'rel="canonical"' not in tag]
        fetched = [unescape(one) for one in sources + re.findall(r'\bhref="([^"]+)"', " ".join(sheets))]
        for link in fetched + [unescape(one) for one in re.findall(r'<a\b[^>]*?\bhref="([^"]+)"', text)]:
            where = urlsplit(link)
            if where.scheme or where.netloc:
                assert link not in fetched, (page.name, link)
                continue
            target = (page.parent / unquote(where.path)).resolve() if where.path else page
            assert target.exists(), (page.name, link)
            if where.fragment and target in texts:
                assert unquote(where.fragment) in places[target], (page.name, link)
    for sheet in (site / "_static").rglob("*.css"):
        assert not re.search(r"url\(\s*['\"]?(?:https?:)?//", sheet.read_text(encoding="utf-8")), sheet.name


@pytest.fixture(scope="module")
def index(site):
    text = (site / "searchindex.js").read_text(encoding="utf-8")
    return json.loads(text[text.index("{") : text.rindex("}") + 1])


def test_the_search_finds_words_of_other_programs(index):
    """On a page with all of them: its words are those that are looked for, as stems."""
    stem = SearchEnglish({}).stem
    pages = [index["docnames"].index(name) for name in ("where-is", "limits", "recipes", "own-parts", "temperature")]
    for words in WORDS.replace("\n", " ").split(", "):
        found = [set(pages)]
        for word in words.split():
            entries = [index[table].get(stem(word.lower()), []) for table in ("terms", "titleterms")]
            found.append({number for one in entries for number in np.atleast_1d(one).tolist()})
        assert set.intersection(*found), words


def test_the_search_finds_the_pages_of_a_word(index):
    for word, page in SEARCHED.items():
        found = [index[table].get(word, []) for table in ("terms", "titleterms")]  # one number, or several
        assert page in [index["docnames"][number] for numbers in found for number in np.atleast_1d(numbers)]
