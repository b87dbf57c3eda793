"""Every example runs, and what it prints stands beside the known value it names."""

import re
import runpy
from pathlib import Path

import numpy as np
import pytest

import minimd as md
from minimd import cli
from minimd.h5md import read_file

EXAMPLES = Path(__file__).parent.parent / "examples"
SHORTER = {"n_equilibration": 50, "n_steps": 1000}
SCRIPTS = sorted(path.name for path in EXAMPLES.glob("*.py"))


def run_shortened(name, folder):
    """Run an example with fewer steps."""
    text = (EXAMPLES / name).read_text()
    line = re.search(r"^(n_equilibration.*) = .*$", text, re.MULTILINE)
    if line:
        values = [SHORTER.get(word.strip(), 10) for word in line[1].split(",")]
        text = text.replace(line[0], f"{line[1]} = {', '.join(map(str, values))}")
    (folder / name).write_text(text)
    runpy.run_path(str(folder / name), run_name="__main__")


@pytest.mark.parametrize("name", SCRIPTS)
def test_example_runs(name, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    run_shortened(name, tmp_path)
    told = capsys.readouterr().out
    assert "(" in told  # the known value
    assert "nan" not in told
    assert "THE TOTAL" not in told  # the verdict of a report that is not content


@pytest.mark.parametrize("name", SCRIPTS)
def test_example_is_short(name):
    assert len((EXAMPLES / name).read_text().splitlines()) <= 60


def test_own_laws_give_what_their_formulas_say(capsys):
    runpy.run_path(str(EXAMPLES / "own_law.py"), run_name="__main__")
    frequency, expected, force, difference = map(float, re.findall(r"-?\d+\.\d{3,}", capsys.readouterr().out))
    assert frequency == pytest.approx(expected, rel=1e-3)  # truncation: amplitude 1e-3, and a finite number of swings
    assert force == pytest.approx(difference, abs=2e-6)  # as printed


@pytest.mark.slow
def test_argon_scene_diffuses_and_is_structured_as_rahman_found(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert cli.main(["run", str(EXAMPLES / "argon.toml"), "--quiet"]) == 0
    assert (tmp_path / "argon.png").is_file()
    import h5py

    with h5py.File("argon.h5md") as h5:
        positions = h5["particles/trajectory/position/value"][:]
    contents = read_file("argon.h5md")
    assert contents.record.temperature.mean() == pytest.approx(
        94.4, abs=5.0
    )  # statistics: the energy is fixed, the mean temperature scatters by 1.2 K
    lags = np.arange(4, 30)  # 2 to 15 ps
    squares = [np.mean(np.sum((positions[lag:] - positions[:-lag]) ** 2, axis=2)) for lag in lags]
    diffusion = np.polyfit(0.5 * lags, squares, 1)[0] / 6.0 * 1e-4  # cm²/s
    assert diffusion == pytest.approx(2.43e-5, abs=0.25e-5)
    edges = np.arange(2.5, 10.0, 0.05)
    radii = 0.5 * (edges[1:] + edges[:-1])
    counts = sum(np.histogram(md.neighbor_list("d", md.System(frame, cell=contents.system.cell), 10.0), edges)[0] for frame in positions[::20])
    assert radii[np.argmax(counts / radii**2)] == pytest.approx(3.7, abs=0.1)
    assert np.abs(contents.record.total_energy - contents.record.total_energy[0]).max() / 864 < 5e-6  # eV per atom
