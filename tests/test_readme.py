"""The README's scripts run as they stand, shortened; it is short; numbers of the pages are those of the code."""

import gc
import re
import runpy
import shutil
from pathlib import Path

import pytest

from minimd.forces.pair_laws import CLUSTERS_FROM
from minimd.neighbors import domains
from minimd.neighbors.domains import ATOMS_PER_DOMAIN

REPOSITORY = Path(__file__).parents[1]
README = REPOSITORY / "README.md"
FAST_FORCES = REPOSITORY / "docs" / "fast-forces.md"
LISTS = REPOSITORY / "docs" / "lists.md"
SCRIPTS = re.findall(r"```python\n(.*?)```", README.read_text(encoding="utf-8"), re.S)


@pytest.mark.parametrize("script", SCRIPTS, ids=range(len(SCRIPTS)))
def test_readme_scripts_run(script, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    if "resume(" in script:  # what an earlier script left, which has it open no longer
        run_shortened(SCRIPTS[0])
        gc.collect()
    run_shortened(script)
    assert capsys.readouterr().out.strip()


def run_shortened(script):
    for long, short in {
        "equilibrate(4000": "equilibrate(100",
        "run(10_000, every=50": "run(200, every=10",
        "12_000": "300",
    }.items():
        script = script.replace(long, short)
    exec(compile(script, str(README), "exec"), {})


def test_readme_has_no_blanks():
    assert "@" not in README.read_text(encoding="utf-8").replace("@dataclass", "")


def test_readme_can_be_read_in_five_minutes():
    assert README.read_text(encoding="utf-8").count("\n") <= 120


def test_fast_forces_quotes_the_loop_as_it_stands():
    quoted = re.search(r"```python\n(.*?)```", FAST_FORCES.read_text(encoding="utf-8"), re.S)
    source = (REPOSITORY / "minimd" / "forces" / "cluster_loop.py").read_text(encoding="utf-8")
    lines = {line.strip() for line in source.splitlines()}
    assert [line for line in quoted[1].splitlines() if line not in lines] == []


def test_numbers_of_atoms_are_those_of_the_code():
    assert f"Scenes with fewer than {2 * ATOMS_PER_DOMAIN} atoms" in LISTS.read_text(encoding="utf-8")
    assert f"if it has {CLUSTERS_FROM} atoms or more" in LISTS.read_text(encoding="utf-8")
    assert f"A domain has at least {ATOMS_PER_DOMAIN} atoms" in FAST_FORCES.read_text(encoding="utf-8")
    assert f"- {CLUSTERS_FROM} atoms or more" in FAST_FORCES.read_text(encoding="utf-8")


def test_picture_of_clusters_can_be_drawn_anew(tmp_path, monkeypatch):
    monkeypatch.setattr(domains, "ATOMS_PER_DOMAIN", ATOMS_PER_DOMAIN)  # the script makes it smaller
    runpy.run_path(shutil.copy(REPOSITORY / "docs" / "draw_clusters.py", tmp_path), run_name="__main__")
    assert (tmp_path / "clusters.png").stat().st_size > 0
