"""A record in a session: columns, data frames, text files, pictures; and the bar that tells how far a run is."""

import csv
import io
import sys

import numpy as np
import pytest
from scenes import SCENES
from wrong_calls import assert_answered

import minimd as md


@pytest.fixture(scope="module")
def record():
    simulation = SCENES["argon"]().simulation()
    simulation.extra_observables = ("stress",)
    return simulation.run(10, every=2, progress=False)


def test_a_data_frame_has_the_steps_as_index_and_units_and_text_every_bit(record, monkeypatch, tmp_path):
    columns = record.columns()
    assert list(columns)[:2] == ["step", "time"]
    assert np.array_equal(columns["momentum_y"], record.momentum[:, 1])
    assert np.array_equal(columns["stress_xz"], record.stress[:, 0, 2])
    file = record.to_csv(tmp_path / "a.csv")
    rows = list(csv.DictReader(io.StringIO(file.read_text(encoding="utf-8"))))
    for name, column in columns.items():
        assert np.array_equal([float(row[name]) for row in rows], column), name
    assert_answered(lambda: record.to_csv(file), FileExistsError, "a.csv", "overwrite=True")
    assert (record.to_csv(file, overwrite=True), [path.name for path in tmp_path.iterdir()]) == (file, ["a.csv"])
    pytest.importorskip("pandas")
    table = record.to_pandas()
    assert np.array_equal(table.index, record.step)
    assert np.array_equal(table["total_energy"], record.total_energy)
    assert (table.attrs["units"]["stress"], table.attrs["units"]["time"]) == (md.units.LJ.pressure, "τ")
    monkeypatch.setitem(sys.modules, "pandas", None)
    assert_answered(record.to_pandas, ModuleNotFoundError, "to_pandas", "install pandas", "record.columns()")


def test_a_record_draws_itself_unless_it_has_no_entries(record):
    figure = record.plot()
    titles = [panel.get_title().split("   ")[0] for panel in figure.axes]
    assert titles == ["total energy per atom", "temperature", "total momentum", "pressure"]
    assert figure._repr_png_().startswith(b"\x89PNG")
    assert np.array_equal(figure.axes[1].lines[0].get_ydata(), record.temperature)
    assert_answered(md.Record(md.units.LJ, 2).plot, ValueError, "no entries")
    scene = SCENES["argon"]()
    assert "of single atoms: least " in str(md.evaluate(scene.system, scene.laws))
