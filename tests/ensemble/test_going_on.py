"""Whatever stops an ensemble, the next call goes on, and ends with the same table and files, to the last bit."""

import errno
import json
import os
import signal
import subprocess
import sys
import threading
import time
from contextlib import suppress
from functools import partial, wraps
from pathlib import Path

import members
import numpy as np
import pytest
from damages import KILLED, killed_at
from h5md_runs import bring_to_disk_every, fill_the_disk
from members import FILES, STEPS, assert_same, run

import minimd as md
from minimd.core.files.h5md_reader import read_file
from minimd.core.structure.errors import Interrupted
from minimd.ensemble.folder import EnsembleFolder
from minimd.ensemble.running import EnsembleError

PLAIN, BY_HAND = None, members.in_own_file


def killed(go, _folder, patch, at):
    """At this change of a file."""
    patch.setattr("minimd.core.files.h5md_writer.SECONDS_BETWEEN_FLUSHES", 0.0)
    assert killed_at(at, go) == KILLED


def cut_off(go, folder, patch):
    """The file of a member that was killed ends early."""
    bring_to_disk_every(0.0, patch)
    assert killed_at(30, go) == KILLED
    assert read_file(folder / FILES[0]).step > 0
    os.truncate(folder / FILES[0], 5000)


def damaged(go, folder, _patch):
    go(steps=35)
    with (folder / FILES[1]).open("r+b") as file:
        file.seek(3000)
        file.write(b"\xff" * 4000)


def blown_up_and_not_noted(go, folder, _patch):
    """The caller was killed before it could note the failure."""
    with pytest.warns(UserWarning, match="have failed"):
        go(prepare=members.blows_up)
    assert (folder / "0000-0999/0002.crash.h5md").exists()
    journal = folder / "members.jsonl"
    journal.write_text("".join(journal.read_text().splitlines(keepends=True)[:2]))


def failed_after_the_run(go, _folder, _patch):
    fails = wraps(BY_HAND)(lambda of, member: (BY_HAND(of, member), 1 / (member.index != 2))[0])
    with pytest.warns(UserWarning, match="1 of 3 members have failed"):
        go(run=fails)


def interrupted(go, folder, _patch, workers):
    """Ctrl-C, when the first member has ended and the second has begun."""

    def interrupt():
        journal = folder / "members.jsonl"
        while not (journal.exists() and journal.read_text() and (folder / FILES[1]).exists()):
            time.sleep(0.01)
        os.kill(os.getpid(), signal.SIGINT)

    thread = threading.Thread(target=interrupt)
    thread.start()
    with pytest.raises(Interrupted, match=f"1 of 3 members are done and kept in {folder}") as stopped:
        go(members.second_is_slow, workers=workers)
    thread.join()
    assert stopped.value.result["status"].tolist() == ["done", "begun", "missing"]
    assert read_file(folder / FILES[1]).step < STEPS


def a_full_disk(go, folder, patch):
    """In the middle of the first member. Those behind it cannot begin, and there is no room for a table either."""
    fill_the_disk(patch, 12)
    with pytest.raises(OSError, match=r"table\.csv.* No space left on device$"):
        go()
    patch.undo()
    assert [path.name for path in (folder / "0000-0999").iterdir()] == ["0000.h5md"]
    assert 0 < read_file(folder / FILES[0]).step < STEPS
    lines = [json.loads(line) for line in (folder / "members.jsonl").read_text().splitlines()]
    assert [line["status"] for line in lines] == ["failed"] * 3
    assert all("No space left on device" in line["message"] and "\n" not in line["message"] for line in lines)


def a_journal_without_room(go, _folder, patch):
    """Half a line of the second member is on the disk."""
    write, lines = os.write, []

    def half(descriptor, text):
        lines.extend([text] if bytes(text[:9]) == b'{"index":' else [])
        if len(lines) < 2:
            return write(descriptor, text)
        write(descriptor, text[:20])
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    patch.setattr(os, "write", half)
    with pytest.raises(OSError, match=r"members.jsonl .* member 1: No space left on device$"):
        go()


def another_ensemble(go, _folder, _patch):
    go(seed=5, steps=35)
    with pytest.raises(ValueError, match="another ensemble"):
        go()
    go(resume=False)


EVENTS = {  # what happens, the function run, and what is left: members that go on in their files, +, or begin anew, *
    "fewer steps": (lambda go, *_: go(steps=35), PLAIN, "0+1+2+"),
    "fewer members": (lambda go, *_: go(parameters={"temperature": [0.4, 0.5]}), PLAIN, "2*"),
    **{f"killed at {k}": (partial(killed, at=k), PLAIN, None) for k in (3, 7, 12, 20, 25, 31)},
    "damaged": (damaged, PLAIN, "0+1*2+"),              "cut off": (cut_off, BY_HAND, "0*1*2*"),
    "blown up and not noted": (blown_up_and_not_noted, PLAIN, "2*"),
    "failed after the run": (failed_after_the_run, BY_HAND, "2"),
    "Ctrl-C": (partial(interrupted, workers=0), PLAIN, "1+2*"),
    "Ctrl-C with a worker": (partial(interrupted, workers=1), PLAIN, "1+2*"),
    "a journal without room": (a_journal_without_room, BY_HAND, "12*"),
    "a full disk": (a_full_disk, BY_HAND, "0+1*2*"),    "another ensemble": (another_ensemble, PLAIN, ""),
}  # fmt: skip
ALL = [pytest.param(name, marks=[pytest.mark.slow] * (name != "killed at 25")) for name in EVENTS]


@pytest.mark.parametrize("event", ALL)
def test_the_next_call_makes_what_is_left_with_the_same_bits(event, done, done_by_hand, tmp_path, monkeypatch):
    happens, function, left = EVENTS[event]
    go, made, before = partial(run, tmp_path, run=function), [], md.Simulation.run
    with monkeypatch.context() as patch:
        happens(go, tmp_path, patch)
    noted = lambda *of, **how: (made.append("+" if "append" in how else "*"), before(*of, **how))[1]  # noqa: E731
    monkeypatch.setattr(md.Simulation, "run", noted)
    go(lambda _, member: made.append(str(member.index)))
    assert left in (None, "".join(made))
    assert_same(tmp_path, (done_by_hand if function else done).folder)
    assert sorted(path.name for path in (tmp_path / "0000-0999").iterdir()) == [Path(name).name for name in FILES]


def test_slices_that_run_at_the_same_time_make_the_same_table_whoever_is_last(done, tmp_path):
    inner = []

    def another(_simulation, member):
        if member.index == 1:
            inner.append(run(tmp_path, members=range(1)))

    with EnsembleFolder(tmp_path / "new", writes=True, members=range(1, 3)):  # by a call that has not begun yet
        run(tmp_path / "new", members=range(1))
    assert (tmp_path / "new" / "members.1-3.jsonl").exists()
    run(tmp_path, another, members=range(1, 3))
    assert inner[0]["status"].tolist() == ["done", "missing", "missing"]
    assert_same(tmp_path, done.folder)
    run(tmp_path, another)  # all is done
    assert len(inner) == 1
    assert_same(tmp_path, done.folder)


@pytest.mark.slow
def test_a_run_by_hand_in_the_file_of_the_member_is_that_without_it(done, done_by_hand, tmp_path):
    """A function that writes the file itself begins anew."""
    members.assert_same_files(done.folder, done_by_hand.folder)
    assert done_by_hand["pressure_mean"].tolist() == done["pressure_mean"].tolist()
    is_whole = False

    def itself(simulation, member):
        simulation.run(STEPS // 2, trajectory=member.file, progress=False)
        return {"last": simulation.step if is_whole else 1 / 0}

    with pytest.raises(EnsembleError):
        run(tmp_path, run=itself)
    is_whole = True
    assert set(run(tmp_path, run=itself)["last_mean"]) == {STEPS // 2}
    assert not list(tmp_path.rglob("*.stopped.h5md"))


@pytest.mark.slow
def test_a_drawn_seed_is_written_down_and_used_again(tmp_path):
    drawn = []
    for steps in (35, STEPS):
        run(tmp_path, seed=None, steps=steps)
        drawn.append(json.loads((tmp_path / "ensemble.json").read_text())["seed"])
    assert drawn[0] == drawn[1] > 2**32


SCRIPT = """
import sys
from members import in_own_file, run
if __name__ == "__main__":
    run(sys.argv[1], run=in_own_file, steps=20_000, every=100, workers=2)
"""


@pytest.mark.slow
@pytest.mark.skipif(sys.platform != "linux", reason="reads /proc")
@pytest.mark.parametrize("victims", ["parent", "worker", "both"])
def test_a_scan_that_is_killed_again_and_again_has_the_same_table(victims, tmp_path):
    """kill -9 when files grow, and the next call at once."""
    (tmp_path / "script.py").write_text(SCRIPT)
    environment = os.environ | {"PYTHONPATH": os.pathsep.join(map(str, Path(__file__).parents[1:3]))}
    rng, place = np.random.default_rng(1), {"cwd": tmp_path, "env": environment}
    begun = lambda folder: subprocess.Popen([sys.executable, "script.py", folder], **place)  # noqa: E731
    size = lambda: sum(file.stat().st_size for file in tmp_path.glob("killed/*/*.h5md*"))  # noqa: E731

    def workers(process):
        """That spawn has started."""
        found = " ".join((task / "children").read_text() for task in Path(f"/proc/{process}/task").iterdir()).split()
        return [int(one) for one in found if b"spawn_main" in Path(f"/proc/{one}/cmdline").read_bytes()]

    assert begun("whole").wait() == 0
    for _ in range(4):
        scan, before = begun("killed"), size()
        while scan.poll() is None and size() == before:
            time.sleep(0.01)
        time.sleep(rng.uniform(0.0, 0.5))
        targets = workers(scan.pid)[:1] if victims != "parent" and scan.poll() is None else []
        for process in [*targets, *([scan.pid] if victims != "worker" else [])]:
            with suppress(ProcessLookupError):
                os.kill(process, signal.SIGKILL)
        scan.wait()
    assert begun("killed").wait() == 0
    for name in ("table.csv", "table.json"):
        assert (tmp_path / "killed" / name).read_bytes() == (tmp_path / "whole" / name).read_bytes()
    assert not list(tmp_path.glob("killed/*/*.stopped.h5md"))
