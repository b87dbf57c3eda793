"""A notebook, run headless: what its cells show."""

import os
from inspect import signature
from pathlib import Path

import pytest

from minimd import LennardJones

nbformat, nbclient = pytest.importorskip("nbformat"), pytest.importorskip("nbclient")
pytest.importorskip("ipykernel")
pytest.importorskip("pandas")
pytestmark = pytest.mark.slow

REPOSITORY = Path(__file__).parents[2]
NOTEBOOK = REPOSITORY / "examples" / "notebook.ipynb"
# fmt: off
TITLES = {  # last line of a cell: the title of its table, and a word in it
    "system": ("System", "108: 108 X"), "system.cell": ("Cell", "volume"), "lj": ("LennardJones", "switch_start"),
    "sim": ("Simulation", "VelocityVerlet(timestep=0.003)"), "sim.report()": ("Report", "verdict"),
    "sim.method": ("VelocityVerlet", "order 2, symmetric, symplectic"), "table": ("Tabulated", "truncation"),
    "md.advise_timestep(system, lj)": ("StepAdvice", "recommended"),
    "record": ("Record", "21 entries of 108 atoms, step 0 to 200"),
    "sim.probe_reversibility(10)": ("Reversibility", "reversible to rounding"),
    "md.evaluate(sim.system, lj)": ("Evaluation", "virial"),
    "sim.minimize(max_steps=50)": ("Minimization", "largest force"),
}
# fmt: on


@pytest.fixture(scope="module")
def cells():
    """The outputs of each cell, by its last line."""
    with pytest.MonkeyPatch.context() as patch:
        path = filter(None, [str(REPOSITORY), os.environ.get("PYTHONPATH")])
        patch.setenv("PYTHONPATH", os.pathsep.join(path))
        patch.delenv("MPLBACKEND", raising=False)
        notebook = nbformat.read(NOTEBOOK, as_version=4)
        nbclient.NotebookClient(notebook, timeout=300, kernel_name="python3").execute()
    return {cell.source.splitlines()[-1]: cell.outputs for cell in notebook.cells if cell.cell_type == "code"}


def shown(outputs):
    (result,) = [one.data for one in outputs if one.output_type == "execute_result"]
    return result


def test_every_result_is_a_table_and_aligned_text(cells):
    for line, (title, word) in TITLES.items():
        html, text = (shown(cells[line])[f"text/{kind}"] for kind in ("html", "plain"))
        assert f">{title}</caption>" in html, line
        assert html.count("<tr>") == html.count("</tr>") > 0
        assert word in html, line
        assert word in text, line
        assert "object at 0x" not in text
    assert all(f">{name}</th>" in shown(cells["lj"])["text/html"] for name in signature(LennardJones).parameters)


def test_a_run_shows_one_progress_bar_and_a_record_is_a_picture_and_a_data_frame(cells):
    texts = [one.data["text/plain"] for one in cells["record"] if one.output_type == "display_data"]
    texts += [one.text for one in cells["record"] if one.output_type == "stream"]
    (bar,) = [text for text in texts if "running" in text]
    assert "running: step" not in bar  # the ten lines of a file
    assert len(shown(cells["record.plot()"])["image/png"]) > 10_000
    assert all(word in shown(cells["record.to_pandas()"])["text/html"] for word in ("dataframe", "stress_xy"))
