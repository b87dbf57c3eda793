"""The lessons of the course run, shortened; in full where long tests do."""

import re
import runpy
from ast import literal_eval
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
import pytest

COURSE = Path(__file__).parents[1] / "course"
LESSONS = sorted(path.name for path in COURSE.glob("*.py"))
SHORTER = {"n_equilibration": 50, "n_steps": 300, "duration": 100}


def shortened(name):
    """The text of a lesson, with fewer steps."""
    text = (COURSE / name).read_text(encoding="utf-8")
    for names, values in re.findall(r"^(\w+(?:, \w+)*) = ([\d_., ]*\d)(?:  #.*)?$", text, re.MULTILINE):
        pairs = zip(names.split(", "), values.split(", "), strict=True)
        shorter = [str(min(SHORTER.get(word, np.inf), literal_eval(value))) for word, value in pairs]
        text = text.replace(f"{names} = {values}", f"{names} = {', '.join(shorter)}")
    return text


def run(text, folder, name, capsys):
    (folder / name).write_text(text, encoding="utf-8")
    try:
        runpy.run_path(str(folder / name), run_name="__main__")
    finally:
        plt.close("all")
    return capsys.readouterr().out


@pytest.mark.filterwarnings("ignore:FigureCanvasAgg is non-interactive")
@pytest.mark.parametrize("name", [LESSONS[0], *(pytest.param(name, marks=pytest.mark.slow) for name in LESSONS[1:])])
def test_lesson_runs(name, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    told = run(shortened(name), tmp_path, name, capsys)
    assert "(" in told  # the known value
    assert "nan" not in told


@pytest.mark.parametrize("name", LESSONS)
def test_lesson_has_a_title_cells_and_tasks(name):
    text = (COURSE / name).read_text(encoding="utf-8")
    title, underline = text.split("\n")[1:3]
    assert title.startswith(f"{name[0]}. ")
    assert underline == "=" * len(title)
    assert text.count("# %%\n") >= 4
    assert text.rindex("# Tasks\n# -----\n") > text.rindex("# %%\n")
    assert len(re.findall(r"^# [1-9]\. ", text, re.M)) == 5


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore:FigureCanvasAgg is non-interactive")
@pytest.mark.parametrize("name", LESSONS)
def test_lesson_in_full_finds_the_known_values(name, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    told = run((COURSE / name).read_text(encoding="utf-8"), tmp_path, name, capsys)
    print(told)
    if name.startswith("2"):
        assert float(re.search(r"diffusion +(\S+)", told)[1]) == pytest.approx(2.43e-5, rel=0.12)  # statistics
        assert float(re.search(r"g\(r\) (\S+)", told)[1]) == pytest.approx(3.7, abs=0.1)
    if name.startswith("6"):
        first, second = map(float, re.search(r"D = (\S+) by Green and Kubo, (\S+) by", told).groups())
        assert first == pytest.approx(second, rel=0.1)
        assert float(re.search(r"η = (\S+)", told)[1]) == pytest.approx(3.25, rel=0.25)
