"""Members while they run: those made by a function `run` go on where they were stopped, and a note says how far each is."""

import errno
import json
import os
import time

import members
import numpy as np
import pytest
from full_disk import fill_the_disk
from h5md_runs import bring_to_disk_every
from kills import killed_at
from members import STEPS, TEMPERATURES
from test_kills import assert_same_file

import minimd as md
from minimd.ensemble import notes
from minimd.ensemble.table import status
from minimd.files.claim import locked
from minimd.files.h5md_reader import read_file

FILES = [f"0000-0999/{k:04d}.h5md" for k in range(4)]


def run(folder, run=members.in_own_file, **options):
    options = {"prepare": members.melted, "workers": 0, **options}
    return md.ensemble(members.liquid, TEMPERATURES, STEPS, run=run, every=5, folder=folder, progress=False, **options)


@pytest.fixture(scope="module")
def done(tmp_path_factory):
    """An ensemble that nothing has disturbed."""
    return run(tmp_path_factory.mktemp("done"))


@pytest.fixture
def appended(monkeypatch):
    """Of each run of a simulation, whether it went on with a file."""
    calls, before = [], md.Simulation.run
    monkeypatch.setattr(
        md.Simulation, "run", lambda self, *n, **how: (calls.append("append" in how), before(self, *n, **how))[1]
    )
    return calls


def test_a_run_of_the_users_goes_on_in_its_file(done, tmp_path, monkeypatch, appended):
    """It is killed twice in the middle of the first member."""
    bring_to_disk_every(0.0, monkeypatch)
    reached = []
    for k in (30, 70):
        assert killed_at(k, lambda: run(tmp_path)) is None
        reached.append(read_file(tmp_path / FILES[0]).step)
    assert 0 < reached[0] < reached[1] < STEPS
    run(tmp_path)
    assert appended == [True, False, False, False]
    for name in ("table.csv", "table.json"):
        assert (tmp_path / name).read_bytes() == (done.folder / name).read_bytes()
    for name in FILES:
        assert_same_file(tmp_path / name, done.folder / name)
    assert sorted(path.name for path in (tmp_path / "0000-0999").iterdir()) == [f"{k:04d}.h5md" for k in range(4)]


def test_such_a_run_is_that_of_an_ensemble_without_one(done, tmp_path):
    plain = run(tmp_path, run=None)
    assert plain["pressure_mean"].tolist() == done["pressure_mean"].tolist()
    for name in FILES:
        assert_same_file(tmp_path / name, done.folder / name)


def fails_once(simulation, member):
    """The run ends, and then what is made of it fails."""
    numbers = members.in_own_file(simulation, member)
    if member.index == 2 and simulation.record is not None:
        raise ZeroDivisionError
    return numbers


def test_a_run_that_was_made_is_not_made_again(done, tmp_path, appended):
    with pytest.warns(UserWarning, match="1 of 4 members have failed"):
        run(tmp_path, fails_once)
    appended.clear()
    assert run(tmp_path, fails_once)["last_mean"].tolist() == done["last_mean"].tolist()
    assert appended == []


def in_a_file_of_its_own(simulation, member):
    simulation.run(member.steps // 2, trajectory=member.file, progress=False)
    if not (member.file.parents[1] / "again").exists():
        raise ZeroDivisionError
    return {"last": simulation.step}


def test_a_run_that_writes_the_file_itself_begins_anew(tmp_path):
    with pytest.raises(RuntimeError, match="all 4 members have failed"):
        run(tmp_path, in_a_file_of_its_own)
    (tmp_path / "again").touch()
    assert set(run(tmp_path, in_a_file_of_its_own)["last_mean"]) == {STEPS // 2}
    assert not list(tmp_path.rglob("*.stopped.h5md"))


def test_a_damaged_file_of_such_a_run_begins_anew(done, tmp_path, monkeypatch):
    bring_to_disk_every(0.0, monkeypatch)
    assert killed_at(30, lambda: run(tmp_path)) is None
    file = tmp_path / FILES[0]
    assert read_file(file).step > 0
    file.write_bytes(file.read_bytes()[:5000])
    assert run(tmp_path)["last_mean"].tolist() == done["last_mean"].tolist()


def test_a_full_disk_costs_the_members_that_meet_it(done, tmp_path, monkeypatch):
    """It is full in the middle of the first member. Those behind it cannot begin, and there is no room for a table either."""
    with monkeypatch.context() as full:
        fill_the_disk(full, 12)
        with pytest.raises(OSError, match=r"table\.csv' cannot be written: No space left on device$"):
            run(tmp_path)
        assert [path.name for path in (tmp_path / "0000-0999").iterdir()] == ["0000.h5md"]
    assert 0 < read_file(tmp_path / FILES[0]).step < STEPS
    lines = [json.loads(line) for line in (tmp_path / "members.jsonl").read_text().splitlines()]
    assert [line["status"] for line in lines] == ["failed"] * 4
    assert all("No space left on device" in line["message"] and "\n" not in line["message"] for line in lines)
    run(tmp_path)
    assert (tmp_path / "table.csv").read_bytes() == (done.folder / "table.csv").read_bytes()


def test_a_journal_without_room_ends_the_call_with_a_sentence(done, tmp_path, monkeypatch):
    """Half a line of the second member is on the disk."""
    write, lines = os.write, []

    def half(descriptor, text):
        if bytes(text[:9]) != b'{"index":':
            return write(descriptor, text)
        lines.append(text)
        if len(lines) == 2:
            write(descriptor, text[:20])
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        return write(descriptor, text)

    with monkeypatch.context() as full:
        full.setattr(os, "write", half)
        with pytest.raises(
            OSError, match=r"members.jsonl cannot store the results of member 1: No space left on device$"
        ):
            run(tmp_path)
    run(tmp_path)
    assert (tmp_path / "table.csv").read_bytes() == (done.folder / "table.csv").read_bytes()


def told(folder, words):
    """The lines of the status, as soon as they have these words; after a minute as they are."""
    end = time.monotonic() + 60.0
    while words not in (lines := "\n".join(status(folder)[1])) and time.monotonic() < end:
        time.sleep(0.01)
    return lines


def test_the_status_says_at_which_step_each_member_is(tmp_path, monkeypatch):
    monkeypatch.setattr(notes, "SECONDS_BETWEEN_NOTES", 0.01)
    found = {}

    def prepared(simulation, member):
        if member.index == 1:
            found["prepared"] = told(tmp_path, "being prepared")

    def looked_at(simulation, member):
        looks = {
            1: lambda one: found.setdefault(one.step, told(tmp_path, f"at step {one.step} of 60")),
            2: lambda one: None,
        }
        return simulation.run(STEPS, every=20, observers=[looks[1 if member.index == 1 else 2]], progress=False)

    run(tmp_path, looked_at, prepare=prepared)
    assert "running        member 1: being prepared" in found["prepared"]
    assert "running        member 1: at step 40 of 60" in found[40]
    assert "1 done" in found[40]
    assert not list(tmp_path.rglob("*.running"))


def test_a_note_that_was_left_behind_is_not_believed(tmp_path):
    run(tmp_path)
    note = tmp_path / "0000-0999" / "0003.running"
    note.write_text("at step 40 of 60\n")
    assert not any("running" in line for line in status(tmp_path)[1])
    descriptor = locked(note)
    assert "running        member 3: at step 40 of 60" in status(tmp_path)[1]
    os.close(descriptor)
    with notes.noting(md.Member(3, {}, 0, STEPS, note.with_suffix(".h5md"))):
        pass
    assert not note.exists()


def by_hand(rows, observable):
    """Means and errors over members with the same parameters, one set after the other."""
    sets = {}
    for row in rows:
        sets.setdefault((row["a"], row["b"]), []).append(row)
    for (a, b), some in sets.items():
        means, errors = (np.array([row[f"{observable}_{what}"] for row in some]) for what in ("mean", "error"))
        scatter = means.std(ddof=1) / np.sqrt(len(means)) if len(means) > 1 else np.nan
        yield a, b, len(means), means.mean(), np.fmax(np.sqrt((errors**2).sum()) / len(means), scatter)


def test_averages_over_sets_of_members_are_those_of_each_set(tmp_path):
    rng = np.random.default_rng(1)
    rows = np.zeros(
        60,
        dtype=[
            ("a", "U3"),
            ("b", float),
            ("status", "U7"),
            *((f"{x}_{y}", float) for x in "pq" for y in ("mean", "error")),
        ],
    )
    rows["a"], rows["b"] = rng.choice(["one", "two"], 60), rng.choice([0.3, -0.1, 2.0], 60)
    rows["status"] = rng.choice(["done", "failed"], 60, p=[0.8, 0.2])
    rows["a"][0], rows["status"][0] = "own", "done"  # a set of one
    for name in rows.dtype.names[3:]:
        rows[name] = rng.standard_normal(60)
    rows["q_error"] = np.nan
    table = md.EnsembleTable(tmp_path, ["a", "b"], rows, None)
    made = table.averaged()
    for x in "pq":
        got = [tuple(row) for row in made[["a", "b", "n_members", f"{x}_mean", f"{x}_error"]].tolist()]
        expected = list(by_hand(rows[rows["status"] == "done"], x))
        assert [row[:3] for row in got] == [row[:3] for row in expected]
        np.testing.assert_allclose([row[3:] for row in got], [row[3:] for row in expected], rtol=1e-13)  # rounding
    rows["status"] = "failed"
    assert len(table.averaged()) == 0
