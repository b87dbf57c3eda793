"""The table of an ensemble, its averages, and what is told of members while they run."""

import json
import os
import re
import time

import members
import numpy as np
import pytest
from members import STEPS, TEMPERATURES, run
from wrong_calls import assert_answered

import minimd as md
from minimd.core.console.whole_file import locked
from minimd.core.files.h5md_reader import read_file
from minimd.core.structure.statistics import mean_and_error, with_error
from minimd.ensemble import member as notes
from minimd.ensemble.folder import EnsembleFolder
from minimd.ensemble.table import status, table_of, told_averages


def test_the_table_holds_parameters_means_with_their_errors_and_files(done):
    """That of fewer members is a part; of more steps nothing is known yet."""
    assert done["temperature"].tolist() == TEMPERATURES["temperature"]
    assert (set(done["status"]), set(done["n_steps"])) == ({"done"}, {STEPS})
    assert md.Simulation.resume(done["file"][2], md.LennardJones(1.0, 1.0, 1.8)).step == STEPS
    pressure = read_file(done["file"][1]).record.pressure
    assert (len(pressure), np.isfinite(done["pressure_error"]).all()) == (13, True)
    assert (done["pressure_mean"][1], done["pressure_error"][1]) == mean_and_error(pressure)
    with EnsembleFolder(done.folder, writes=False) as folder:
        few, more = table_of(folder, folder.asked, 1), table_of(folder, folder.asked._replace(steps=STEPS + 1), 3)
    assert few["pressure_mean"].tolist() == done["pressure_mean"].tolist()[:1]
    assert (set(more["status"]), more.observables) == ({"begun"}, ())


def test_data_frame_csv_and_json_are_the_table(done):
    read = pytest.importorskip("pandas").read_csv(done.folder / "table.csv").set_index("index")
    told = json.loads((done.folder / "table.json").read_text())
    for numbers in (done.to_pandas()["pressure_mean"], read["pressure_mean [ε/σ³]"], told["columns"]["pressure_mean"]):
        assert list(numbers) == done["pressure_mean"].tolist()
    assert not [name for name in read if "angular" in name]  # of a periodic cell
    assert (told["units"]["pressure"], told["columns"]["file"]) == ("ε/σ³", members.FILES)


def test_a_run_of_the_users_gives_numbers_pairs_or_series(done, tmp_path):
    def by_hand(simulation, member):
        pressure = simulation.run(member.steps, every=5, progress=False).pressure
        return {"pressure": pressure, "last": float(pressure[-1]), "known": (1.0, 0.1)}

    table = run(tmp_path, run=by_hand)
    assert table.observables == ("pressure", "last", "known")
    for name in ("pressure_mean", "pressure_error"):
        assert table[name].tolist() == done[name].tolist()
    assert set(zip(table["known_mean"], table["known_error"], table["file"], strict=True)) == {(1.0, 0.1, "")}
    assert np.isnan(table["last_error"]).all()
    averages = table.averaged()
    assert with_error(averages["last_mean"][0], np.nan) in str(table).split()


def test_parameters_are_shown_to_ten_digits_and_kept_with_all(tmp_path):
    values = [0.1 * k for k in (3, 6, 9)]  # 0.3 and so on, but for rounding
    table = run(tmp_path, parameters={"temperature": values})
    assert table["temperature"].tolist() == values
    shown = [*str(table).splitlines(), *told_averages(table)]
    assert max(map(len, re.findall(r"0\.\d+", " ".join(shown)))) < 12
    assert any("0.3" in line and "0.9" in line for line in shown)


def test_averages_over_sets_of_members_are_those_of_each_set(tmp_path):
    """Of two parameters; some members have failed, one is alone in its set, and of one observable no error is known."""
    rng, n = np.random.default_rng(1), 60
    means = [(f"{x}_{y}", float) for x in "pq" for y in ("mean", "error")]
    rows = np.zeros(n, dtype=[("a", "U3"), ("b", float), ("status", "U7"), *means])
    rows["a"], rows["b"] = rng.choice(["one", "two"], n), rng.choice([0.3, -0.1, 2.0], n)
    rows["status"] = rng.choice(["done", "failed"], n, p=[0.8, 0.2])
    rows["a"][0], rows["status"][0] = "own", "done"
    for name, _ in means:
        rows[name] = rng.standard_normal(n)
    rows["q_error"] = np.nan
    table = md.EnsembleTable(tmp_path, ["a", "b"], rows, None)
    made, done = table.averaged(), rows[rows["status"] == "done"]
    assert made[["a", "b"]].tolist() == list(dict.fromkeys(done[["a", "b"]].tolist()))
    for row in made:
        some = done[(done["a"] == row["a"]) & (done["b"] == row["b"])]
        assert row["n_members"] == len(some)
        for x in "pq":
            values, errors = some[f"{x}_mean"], some[f"{x}_error"]
            scatter = values.std(ddof=1) / np.sqrt(len(values)) if len(values) > 1 else np.nan
            expected = [values.mean(), np.fmax(np.sqrt((errors**2).sum()) / len(values), scatter)]
            np.testing.assert_allclose([row[f"{x}_mean"], row[f"{x}_error"]], expected, rtol=1e-13)  # rounding
    rows["status"] = "failed"
    assert len(table.averaged()) == 0


def test_it_is_printed_with_the_means_of_each_set_and_their_errors(done):
    told = [with_error(row["pressure_mean"], row["pressure_error"]) for row in done.averaged()]
    assert all(" ± " in one and one in str(done) for one in told)


def told(folder, words):
    """The lines of the status, as soon as they have these words; after a minute as they are."""
    end = time.monotonic() + 60.0
    while words not in (lines := "\n".join(status(folder)[1])) and time.monotonic() < end:
        time.sleep(0.01)
    return lines


def test_the_status_says_at_which_step_each_member_is(tmp_path, monkeypatch):
    monkeypatch.setattr(notes, "SECONDS_BETWEEN_NOTES", 0.01)
    found = {}

    def note(member, key, words):
        if member.index == 1:
            found[key] = told(tmp_path, words)

    def looked_at(simulation, member):
        look = lambda one: note(member, one.step, f"at step {one.step} of 60")  # noqa: E731
        return simulation.run(STEPS, every=20, observers=[look], progress=False)

    prepared = lambda _simulation, member: note(member, "prepared", "being prepared")  # noqa: E731
    run(tmp_path, run=looked_at, prepare=prepared, parameters={"temperature": [0.5, 0.6]})
    assert "running        member 1: being prepared" in found["prepared"]
    assert [words for words in ("running        member 1: at step 40 of 60", "1 done") if words not in found[40]] == []
    assert not list(tmp_path.rglob("*.running"))


def test_a_note_that_was_left_behind_is_not_believed(done):
    note, running = done.folder / "0000-0999" / "0002.running", "running        member 2: at step 40 of 60"
    note.write_text("at step 40 of 60\n")
    assert running not in status(done.folder)[1]
    descriptor = locked(note)
    assert running in status(done.folder)[1]
    os.close(descriptor)


def test_a_table_draws_an_observable_over_its_parameter_with_error_bars(done):
    rows = done.averaged()
    (panel,) = done.plot("temperature").axes
    ((line, _, (bars,)),) = panel.containers
    assert (panel.get_xlabel(), panel.get_ylabel()) == ("temperature", "mean temperature  [ε/$k_B$]")
    np.testing.assert_array_equal(line.get_xdata(), np.sort(rows["temperature"]))
    np.testing.assert_array_equal(line.get_ydata(), rows["temperature_mean"][np.argsort(rows["temperature"])])
    lengths = [np.ptp(bar[:, 1]) for bar in bars.get_segments()]
    errors = rows["temperature_error"][np.argsort(rows["temperature"])]
    np.testing.assert_allclose(lengths, 2.0 * errors, rtol=1e-12)
    assert "pressure" in done.plot().axes[0].get_ylabel()
    assert_answered(lambda: done.plot("presure"), ValueError, "presure", "pressure")
