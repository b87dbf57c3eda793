"""Every example runs, and what it prints stands beside the known value it names."""

import re
import runpy
import subprocess
import sys
from ast import literal_eval
from pathlib import Path

import numpy as np
import pytest

EXAMPLES = Path(__file__).parent.parent / "examples"
SHORTER = {
    "n_equilibration": 50,
    "n_steps": 1000,
    "n_periods": 5,
    "rounds": 2,
    "every": 10,
    "duration": 200,
    "end": 2.0,
    "t_end": 3.0,
}
RUN_BELOW = ("own_law.py", "rigid_ring.py", "equation_of_state.py")  # in full, by tests of their own
SCRIPTS = sorted(path.name for path in EXAMPLES.glob("*.py"))


def shortened(name):
    """The text of an example, with fewer steps."""
    text = (EXAMPLES / name).read_text()
    for names, values in re.findall(r"^(\w+(?:, \w+)*) = ([\d_., ]*\d)(?:  #.*)?$", text, re.MULTILINE):
        pairs = zip(names.split(", "), values.split(", "), strict=True)
        shorter = [str(min(SHORTER.get(word, np.inf), literal_eval(value))) for word, value in pairs]
        text = text.replace(f"{names} = {values}", f"{names} = {', '.join(shorter)}")
    return text


def run_shortened(name, folder):
    """Run an example with fewer steps."""
    (folder / name).write_text(shortened(name))
    runpy.run_path(str(folder / name), run_name="__main__")


KERNELS_OF_THEIR_OWN = (
    "precision.py",
    "to_the_last_bit.py",
    "viscosity.py",
    "constant_pressure.py",
    "stretched_chain.py",
)
SMALL_SYSTEMS = (
    "stiff_spring.py",
    "henon_heiles.py",
    "smooth_cutoff.py",
    "coupled_wells.py",
    "mechanism.py",
    "three_body.py",
    "work_precision.py",
)
LONG = (
    "ensemble_checks.py",
    "timestep_gain.py",
    *KERNELS_OF_THEIR_OWN,
    *SMALL_SYSTEMS,
)  # the gallery of the site runs them, too


@pytest.mark.parametrize(
    "name",
    [pytest.param(name, marks=pytest.mark.slow if name in LONG else ()) for name in SCRIPTS if name not in RUN_BELOW],
)
def test_example_runs(name, tmp_path, monkeypatch, capsys):
    if name == "ensemble_checks.py":
        pytest.importorskip("physical_validation")
    monkeypatch.chdir(tmp_path)
    run_shortened(name, tmp_path)
    told = capsys.readouterr().out
    assert "(" in told  # the known value
    assert "nan" not in told
    assert "THE TOTAL" not in told  # the verdict of a report that is not content


@pytest.mark.parametrize("name", SCRIPTS)
def test_example_is_short(name):
    assert len((EXAMPLES / name).read_text().splitlines()) <= 60


def test_a_ring_that_runs_along_itself_keeps_its_shape(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    runpy.run_path(str(EXAMPLES / "rigid_ring.py"), run_name="__main__")
    running, squeezed = map(float, re.findall(r"off its curve by (\d+\.\d+) b", capsys.readouterr().out))
    assert running < 0.2  # truncation: 0.12 with 200 beads, 0.20 with 100
    assert squeezed > 10.0
    assert (tmp_path / "rigid_ring.png").stat().st_size > 0


@pytest.mark.slow
def test_the_scan_of_an_equation_of_state_runs_in_worker_processes(tmp_path):
    """Of two temperatures only."""
    text = shortened("equation_of_state.py").replace("0.70, 1.69", "0.85, 0.91")
    (tmp_path / "scan.py").write_text(text)
    told = subprocess.run([sys.executable, "scan.py"], cwd=tmp_path, capture_output=True, text=True, check=True).stdout
    assert re.findall(r"T\* (\S+): .* \(NIST: (\S+),", told) == [("0.85", "-5.5121"), ("0.90", "-5.4689")]
    assert len((EXAMPLES / "equation_of_state.py").read_text().splitlines()) <= 40


@pytest.mark.slow
def test_the_script_of_the_page_on_ensembles_runs(tmp_path):
    (text,) = re.findall(
        r"```python\n(import minimd as md\n.*?)```",
        (EXAMPLES.parent / "docs" / "ensembles.md").read_text(encoding="utf-8"),
        re.S,
    )
    (tmp_path / "scan.py").write_text(text.replace("1000", "50").replace("500", "20"))
    told = subprocess.run([sys.executable, "scan.py"], cwd=tmp_path, capture_output=True, text=True, check=True).stdout
    assert "4 members in scan: 4 done" in told


def test_own_laws_give_what_their_formulas_say(capsys):
    runpy.run_path(str(EXAMPLES / "own_law.py"), run_name="__main__")
    frequency, expected, force, difference = map(float, re.findall(r"-?\d+\.\d{3,}", capsys.readouterr().out))
    assert frequency == pytest.approx(expected, rel=1e-3)  # truncation: amplitude 1e-3, and a finite number of swings
    assert force == pytest.approx(difference, abs=2e-6)  # as printed
