"""The benchmark compares like with like."""

import numpy as np
import pytest

from minimd import cli
from minimd.bench import engines, melt


def test_table_has_a_row_for_each_engine_and_size(monkeypatch):
    monkeypatch.setattr(engines, "PEERS", {})
    monkeypatch.setattr(melt, "PEERS", {})
    monkeypatch.setattr(melt, "WARM_UP", 5)
    monkeypatch.setattr(melt, "SECONDS_A_TURN", 0.01)
    table = melt.run_melt((4, 5), repeats=2)
    assert "| 256 | minimd, float64 |" in table
    assert "| 500 | minimd, float64 |" in table


def test_engines_that_disagree_about_the_start_are_not_timed():
    melt._compare([("a", -100.0), ("b", -100.0001)])
    with pytest.raises(ArithmeticError, match="a has -100, b has -101"):
        melt._compare([("a", -100.0), ("b", -101.0)])


def test_scene_is_the_one_that_lammps_calls_melt():
    positions, velocities, edges = engines.melt(5)
    assert len(positions) / np.prod(edges) == pytest.approx(0.8442, rel=1e-12)
    assert (velocities**2).sum() / (3 * len(positions) - 3) == pytest.approx(1.44, rel=1e-12)
    assert engines.Minimd((positions, velocities, edges)).potential_energy() == pytest.approx(-6.7733681 * 500, rel=1e-7)


def test_command_prints_and_writes_the_table(monkeypatch, capsys, tmp_path):
    monkeypatch.setattr(melt, "PEERS", {})
    monkeypatch.setattr(melt, "WARM_UP", 5)
    monkeypatch.setattr(melt, "SECONDS_A_TURN", 0.01)
    assert cli.main(["bench", "lj", "--cells", "4", "--repeats", "1", "--out", str(tmp_path / "table.md")]) == 0
    assert capsys.readouterr().out == (tmp_path / "table.md").read_text(encoding="utf-8")
