"""A record in a session: columns, data frames, text files, pictures; and the bar that tells how far a run is."""

import csv
import io
import sys
import types

import numpy as np
import pytest
from scenes import SCENES
from wrong_calls import assert_answered

import minimd as md
from minimd.structure import console


@pytest.fixture(scope="module")
def record():
    simulation = SCENES["argon"]().simulation()
    simulation.extra_observables = ("stress",)
    return simulation.run(10, every=2, progress=False)


def test_columns_have_one_name_for_each_number(record):
    columns = record.columns()
    assert list(columns)[:2] == ["step", "time"]
    assert np.array_equal(columns["momentum_y"], record.momentum[:, 1])
    assert np.array_equal(columns["stress_xz"], record.stress[:, 0, 2])
    assert all(column.shape == (6,) for column in columns.values())
    assert "momentum" not in columns


def test_a_data_frame_has_the_steps_as_index_and_units(record, monkeypatch):
    pytest.importorskip("pandas")
    table = record.to_pandas()
    assert table.index.name == "step"
    assert np.array_equal(table.index, record.step)
    assert np.array_equal(table["total_energy"], record.total_energy)
    assert table.attrs["units"]["stress"] == md.units.LJ.pressure
    assert table.attrs["units"]["time"] == "τ"
    monkeypatch.setitem(sys.modules, "pandas", None)
    assert_answered(record.to_pandas, ModuleNotFoundError, "to_pandas", "install pandas", "record.columns()")


def test_text_has_every_bit_and_no_file_is_replaced_unasked(record, tmp_path):
    file = record.to_csv(tmp_path / "a.csv")
    rows = list(csv.DictReader(io.StringIO(file.read_text(encoding="utf-8"))))
    for name, column in record.columns().items():
        assert np.array_equal([float(row[name]) for row in rows], column), name
    assert_answered(lambda: record.to_csv(file), FileExistsError, "a.csv", "overwrite=True")
    assert record.to_csv(file, overwrite=True) == file
    assert [path.name for path in tmp_path.iterdir()] == ["a.csv"]


def test_a_record_draws_itself(record):
    figure = record.plot()
    titles = [panel.get_title().split("   ")[0] for panel in figure.axes]
    assert titles == ["total energy per atom", "temperature", "total momentum", "pressure"]
    assert figure._repr_png_().startswith(b"\x89PNG")
    assert np.array_equal(figure.axes[1].lines[0].get_ydata(), record.temperature)
    in_the_open = SCENES["two_atoms"]().simulation().run(3, every=1, progress=False).plot()
    assert in_the_open.axes[3].get_title().startswith("potential energy per atom")


def test_a_record_without_entries_says_so(record):
    empty = md.Record(md.units.LJ, 2)
    assert_answered(empty.plot, ValueError, "no entries")
    assert str(empty) == "record         no entries"
    assert "first " in str(record)
    assert ", last " in str(record)
    assert " from " not in str(record)  # first and last are no range
    scene = SCENES["argon"]()
    assert "of single atoms: least " in str(md.evaluate(scene.system, scene.laws))


def test_a_notebook_has_a_bar_unless_it_is_not_wanted(monkeypatch):
    """By default as on a terminal; the bar is that of tqdm.auto."""
    made = []

    class Bar:
        n = 0

        def __init__(self, **options):
            made.append(options)

        def __enter__(self):
            return self

        def __exit__(self, *_):
            pass

        def update(self, n):
            self.n += n

    monkeypatch.setitem(sys.modules, "tqdm.auto", types.SimpleNamespace(tqdm=Bar))
    for module, shows in (
        (None, False),
        (types.SimpleNamespace(get_ipython=lambda: None), False),
        (types.SimpleNamespace(get_ipython=lambda: types.SimpleNamespace(kernel=1)), True),
    ):
        monkeypatch.setitem(sys.modules, "IPython", module)
        made.clear()
        with console.progress_of(10, "running") as tell:
            tell(5)
        assert bool(made) == shows
    with console.progress_of(10, "running", False) as tell:
        tell(5)
    assert len(made) == 1
