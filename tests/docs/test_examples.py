"""Examples, lessons and the notebook run; what they print stands beside the known value that they name."""

import os
import re
import runpy
import shutil
from ast import literal_eval
from inspect import signature
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
import pytest
from processes import ended

from minimd import LennardJones

REPOSITORY = Path(__file__).parents[2]
EXAMPLES, COURSE = REPOSITORY / "examples", REPOSITORY / "course"
SCRIPTS, LESSONS = sorted(EXAMPLES.glob("*.py")), sorted(COURSE.glob("*.py"))
LENGTHS = {"n_equilibration": 50, "n_steps": 1000, "n_periods": 5, "rounds": 2, "every": 10}
SHORTER = LENGTHS | {"duration": 200, "end": 2.0, "t_end": 3.0}
IN_FULL = ("own_law", "rigid_ring", "equation_of_state")  # by tests of their own
QUICK = ("kepler", "rigid_nitrogen", "1_phase_plane")  # the gallery of the site runs the others, too
pytestmark = pytest.mark.filterwarnings("ignore:FigureCanvasAgg is non-interactive")
SHORTENED = [path for path in [*SCRIPTS, LESSONS[0]] if path.stem not in IN_FULL]
EACH = [pytest.param(one, marks=[pytest.mark.slow] * (one.stem not in QUICK), id=one.name) for one in SHORTENED]
TITLES = {  # last line of a cell: the title of its table, and a word in it
    "system": ("System", "500: 500 X"), "lj": ("LennardJones", "switch_start"),
    "sim": ("Simulation", "velocity-verlet, timestep 0.005 τ"), "sim.report()": ("Report", "verdict"),
    "sim.method": ("LangevinBAOAB", "friction"), "table": ("Tabulated", "truncation"),
    "md.advise_timestep(system, lj)": ("StepAdvice", "recommended"),
    "record": ("Record", "201 entries of 500 atoms, step 0 to 2000"),
    "sim.probe_reversibility(50)": ("Reversibility", "reversible to rounding"),
    "md.evaluate(system, lj)": ("Evaluation", "virial"), "again": ("Simulation", "at"),
    "motion.result()": ("DisplacementResult", "D = "),
}  # fmt: skip


def shortened(path):
    """The text of a script, with fewer steps."""
    text = path.read_text(encoding="utf-8")
    for names, values in re.findall(r"^(\w+(?:, \w+)*) = ([\d_., ]*\d)(?:  #.*)?$", text, re.MULTILINE):
        pairs = zip(names.split(", "), values.split(", "), strict=True)
        shorter = [str(min(SHORTER.get(word, np.inf), literal_eval(value))) for word, value in pairs]
        text = text.replace(f"{names} = {values}", f"{names} = {', '.join(shorter)}")
    return text


@pytest.fixture
def run(here, capsys):
    """A function that runs the text of a script in an empty folder, and returns what it prints."""

    def running(text):
        Path("script.py").write_text(text, encoding="utf-8")
        try:
            runpy.run_path("script.py", run_name="__main__")
        finally:
            plt.close("all")
        return capsys.readouterr().out

    return running


@pytest.mark.parametrize("path", EACH)
def test_script_runs(path, run):
    if path.stem == "ensemble_checks":
        pytest.importorskip("physical_validation")
    if path.stem == "path_integrals" and shutil.which("i-pi") is None:
        with pytest.raises(SystemExit, match="pip install ipi"):
            run(shortened(path))
        pytest.skip("i-PI is not installed")
    told = run(shortened(path))
    assert "(" in told  # the known value
    assert not [bad for bad in ("nan", "THE TOTAL") if bad in told]  # the verdict of a report that is not content


@pytest.mark.slow
def test_a_ring_that_runs_along_itself_keeps_its_shape(run):
    told = run((EXAMPLES / "rigid_ring.py").read_text())
    running, squeezed = map(float, re.findall(r"off its curve by (\d+\.\d+) b", told))
    assert running < 0.2 < 10.0 < squeezed  # truncation: 0.12 with 200 beads, 0.20 with 100
    assert Path("rigid_ring.png").stat().st_size > 0


@pytest.mark.slow
def test_own_laws_give_what_their_formulas_say(run):
    told = run((EXAMPLES / "own_law.py").read_text())
    frequency, expected, force, difference = map(float, re.findall(r"-?\d+\.\d{3,}", told))
    assert frequency == pytest.approx(expected, rel=1e-3)  # truncation: amplitude 1e-3, and a finite number of swings
    assert force == pytest.approx(difference, abs=2e-6)  # as printed


@pytest.mark.slow
def test_the_scan_of_an_equation_of_state_runs_in_worker_processes(tmp_path):
    (tmp_path / "scan.py").write_text(shortened(EXAMPLES / "equation_of_state.py").replace("0.70, 1.69", "0.85, 0.91"))
    told = ended("scan.py", folder=tmp_path)
    assert re.findall(r"T\* (\S+): .* \(NIST: (\S+),", told.stdout) == [("0.85", "-5.5121"), ("0.90", "-5.4689")]


@pytest.mark.slow
@pytest.mark.parametrize("path", LESSONS, ids=lambda path: path.name)
def test_lesson_in_full_finds_the_known_values(path, run):
    told = run(path.read_text(encoding="utf-8"))
    print(told)
    if path.name.startswith("2"):
        assert float(re.search(r"diffusion +(\S+)", told)[1]) == pytest.approx(2.43e-5, rel=0.12)  # statistics
        assert float(re.search(r"g\(r\) (\S+)", told)[1]) == pytest.approx(3.7, abs=0.1)
    if path.name.startswith("6"):
        first, second = map(float, re.search(r"D = (\S+) by Green and Kubo, (\S+) by", told).groups())
        assert first == pytest.approx(second, rel=0.1)
        assert float(re.search(r"η = (\S+)", told)[1]) == pytest.approx(3.25, rel=0.25)


def test_the_notebook_is_its_page():
    """If it is not: python docs/write_notebook.py"""
    written = runpy.run_path(str(REPOSITORY / "docs" / "write_notebook.py"))
    text = (REPOSITORY / "docs" / "notebook.md").read_text(encoding="utf-8")
    assert (EXAMPLES / "notebook.ipynb").read_text(encoding="utf-8") == written["notebook"](text)
    assert len(written["parts"](text)) > 30


@pytest.fixture(scope="module")
def cells(tmp_path_factory):
    """The outputs of each cell of the notebook, run headless, by its last line."""
    nbformat, nbclient, *_ = map(pytest.importorskip, ("nbformat", "nbclient", "ipykernel", "pandas"))
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("PYTHONPATH", os.pathsep.join(filter(None, [str(REPOSITORY), os.environ.get("PYTHONPATH")])))
        patch.delenv("MPLBACKEND", raising=False)
        patch.chdir(tmp_path_factory.mktemp("notebook"))
        notebook = nbformat.read(EXAMPLES / "notebook.ipynb", as_version=4)
        nbclient.NotebookClient(notebook, timeout=300, kernel_name="python3").execute()
    return {cell.source.splitlines()[-1]: cell.outputs for cell in notebook.cells if cell.cell_type == "code"}


def shown(outputs):
    (result,) = [one.data for one in outputs if one.output_type == "execute_result"]
    return result


@pytest.mark.slow
def test_every_result_is_a_table_and_aligned_text(cells):
    for line, (title, word) in TITLES.items():
        html, text = (shown(cells[line])[f"text/{kind}"] for kind in ("html", "plain"))
        assert f">{title}</caption>" in html, line
        assert html.count("<tr>") == html.count("</tr>") > 0
        assert (word in html, word in text, "object at 0x" in text) == (True, True, False), line
    assert all(f">{name}</th>" in shown(cells["lj"])["text/html"] for name in signature(LennardJones).parameters)


@pytest.mark.slow
def test_a_run_shows_one_progress_bar_and_a_record_is_a_picture_and_a_data_frame(cells):
    texts = [one.data["text/plain"] for one in cells["record"] if one.output_type == "display_data"]
    texts += [one.text for one in cells["record"] if one.output_type == "stream"]
    (bar,) = [text for text in texts if "running" in text]
    assert "running: step" not in bar  # the ten lines of a file
    assert len(shown(cells["figure"])["image/png"]) > 10_000
    assert all(word in shown(cells["record.to_pandas()"])["text/html"] for word in ("dataframe", "stress_xy"))
