"""Two scene files: what differs in them; and where the velocities of one are drawn."""

import numpy as np
import pytest
from references import melt_scene

from minimd.scene import parse_scene, run_scene
from minimd.scene.running import differences

SCENE = melt_scene(3, 10).replace("cutoff = 2.5", "cutoff = 2.0")


def changed(*pairs):
    """The scene with some words replaced."""
    text = SCENE
    for old, new in pairs:
        assert old in text
        text = text.replace(old, new)
    return text


def test_scenes_that_differ_in_what_matters_are_told_apart():
    steps = "dynamics.steps: 10 before, 20 now"
    both = ["potential[0].sigma: 1.0 before, 0.9 now", "dynamics.timestep: 0.004 before, 0.002 now"]
    for text, told in [
        (SCENE + "\n# the same", []),
        (changed(("steps = 10", "steps = 20")), [steps]),
        (changed(("sigma = 1.0", "sigma = 0.9"), ("0.004", "0.002")), both),
    ]:
        assert differences(parse_scene(SCENE, "a.toml"), parse_scene(text, "b.toml")) == told


def test_velocities_of_a_scene_are_drawn_behind_its_minimization(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    bonds = "bonds = [[0, 1], [1, 2], [3, 4]]\n"  # shorter than their neighbors are apart: they turn on the way down
    more = '[constraints]\npairs = "bonds"\nlengths = 1.0\n[minimization]\nmax_steps = 50\n'
    text = changed(('lattice = "fcc"', bonds + 'lattice = "fcc"'), ("1.44", "1.0")) + "\n" + more
    run = run_scene(parse_scene(text, tmp_path / "a.toml"), tell=lambda line: None, progress=False)
    assert run.record.temperature[0] == pytest.approx(1.0, rel=1e-9)
    assert np.isfinite(run.record.total_energy).all()
