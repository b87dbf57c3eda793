"""Wrong calls of md.ensemble and of minimd scan, each answered with one sentence."""

import json
import runpy
import sys
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from types import ModuleType

import members
import pytest
from members import leaves, run
from wrong_calls import assert_answered

from minimd.ensemble.folder import EnsembleFolder, name_of
from minimd.ensemble.running import EnsembleError
from minimd.ensemble.scan import parsed_setting

WRONG = [  # options, error, what is named and shown
    ({"build": 3}, TypeError, "build", "3"), ({"parameters": 0}, ValueError, "number of members", "0"),
    ({"parameters": []}, ValueError, "parameters", "empty"),
    ({"parameters": [1, 2]}, TypeError, "parameters", "[1, 2]"), ({"parameters": {"a": 3}}, TypeError, "'a'", "3"),
    ({"parameters": {"a": [1, 2], "b": [1]}}, ValueError, "'a' has 2", "'b' has 1"),
    ({"parameters": [{"a": 1}, {"b": 1}]}, ValueError, "'a'", "'b'"),
    ({"parameters": {"index": [1]}}, ValueError, "parameter", "'index'"),
    ({"parameters": {"a": [[1]]}}, TypeError, "'a'", "[1]"), ({"steps": -1}, ValueError, "steps", "-1"),
    ({"seed": -1}, ValueError, "seed", "-1"), ({"workers": -1}, ValueError, "workers", "-1"),
    ({"workers": 2, "executor": ThreadPoolExecutor(1)}, ValueError, "workers", "2"),
    ({"executor": "dask"}, TypeError, "executor", "'dask'"),
    ({"workers": 2, "build": lambda member: None}, TypeError, "build", "lambda"),
    ({"members": 3}, ValueError, "members", "3"), ({"members": range(3, 5)}, ValueError, "members", "range(3, 5)"),
    ({"members": range(0, 3, 2)}, ValueError, "members", "range(0, 3, 2)"),
    ({"members": range(2), "resume": False}, ValueError, "resume", "range(0, 2)"),
    ({"retries": -1}, ValueError, "retries", "-1"),
]  # fmt: skip


@pytest.mark.parametrize("row", range(len(WRONG)))
def test_wrong_arguments_are_named_and_shown(row, tmp_path):
    options, *answer = WRONG[row]
    assert_answered(lambda: members.run(tmp_path, **options), *answer)


@pytest.mark.parametrize("name", ["build", "run"])
def test_a_function_that_returns_something_else_is_named(name, tmp_path):
    with pytest.raises(EnsembleError, match=rf"TypeError: {name} must return .* it returned 3"):
        members.run(tmp_path, **{name: lambda *_: 3})


CHANGES = [  # of an ensemble of seed 5 and 35 steps
    ({"seed": 6}, "seed = 5 there, 6 here"), ({"steps": 20}, "steps = 35 there, 20 here"),
    ({"build": members.own_law}, "build = members.liquid, code ", " there, members.own_law, code "),
    ({"prepare": members.broken}, "prepare = members.melted, code "),
    ({"build": partial(members.liquid, threads=1)}, "build = members.liquid, code "),
    ({"prepare": None}, "prepare = members.melted there, None here"),
    ({"parameters": {"temperature": [0.4, 0.9]}}, "member 1", "'temperature': 0.5", "'temperature': 0.9"),
]  # fmt: skip


def test_another_ensemble_in_the_folder_is_refused_and_another_call_at_the_same_time(
    tmp_path, done_by_hand, monkeypatch
):
    monkeypatch.setattr(members.broken, "__qualname__", "melted")
    first = {"seed": 5, "steps": 35, "parameters": {"temperature": [0.4, 0.5]}}
    members.run(tmp_path, **first)
    content = lambda: {path: path.read_bytes() for path in tmp_path.rglob("*") if path.is_file()}  # noqa: E731
    before = content()
    for change, *shown in CHANGES:
        with pytest.raises(ValueError, match="another ensemble") as refused:
            members.run(tmp_path, **first | change)
        assert [words for words in shown if words not in str(refused.value)] == []
        assert "resume" not in str(refused.value)  # which would delete the members
        assert content() == before
    more = partial(members.run, done_by_hand.folder, run=members.in_own_file, steps=members.STEPS + 20)
    assert_answered(more, ValueError, "steps = 60 there, 80 here")  # that of a function run is not known to go on
    with EnsembleFolder(tmp_path, writes=True):
        assert_answered(partial(members.run, tmp_path), OSError, "folder", str(tmp_path))
    assert members.run(tmp_path, **first, members=range(10**12)).done.all()
    with EnsembleFolder(tmp_path, writes=True, members=range(1, 3)):
        for part in (None, range(2), range(1, 3)):
            assert_answered(partial(members.run, tmp_path, members=part), OSError, "folder", str(tmp_path), "running")
    description = json.loads((tmp_path / "ensemble.json").read_text())
    (tmp_path / "ensemble.json").write_text(json.dumps(description | {"prepare": "members.melted"}))
    assert members.run(tmp_path, prepare=members.broken, **first).done.all()


def test_functions_of_a_session_are_not_sent_to_spawned_workers(tmp_path, monkeypatch):
    """They are named as others import them."""

    def build(member): ...

    monkeypatch.setattr(sys.modules["__main__"], "__file__", "/somewhere/script.py", raising=False)
    monkeypatch.setattr(members.liquid, "__module__", "__main__")
    assert name_of(partial(partial(members.liquid, law=None))) == name_of(members.liquid)
    assert name_of(members.liquid).startswith("script.liquid, code ")
    session = ModuleType("__main__")  # of a notebook or a prompt: it has no file
    session.build, build.__module__, build.__qualname__ = build, "__main__", "build"
    monkeypatch.setitem(sys.modules, "__main__", session)
    assert_answered(partial(members.run, tmp_path, build=build, workers=1), TypeError, "build", "session")


def test_a_lambda_is_known_by_its_own_code(tmp_path):
    names = []
    for file, line in {"a": "lambda m: m, 4)", "b": "lambda m: m, 8)", "c": "lambda m: 2 * m, 8)"}.items():
        (tmp_path / file).write_text(f"pair = (\n{line}\n")
        names.append(name_of(runpy.run_path(tmp_path / file)["pair"][0]))
    assert names[0] == names[1] != names[2]


@pytest.mark.parametrize("text", ["a.b", "=1", "a=", "a=1:2:0", "a=1:2:x", "a=2:1:1", "a=1:2:1e-9", "a=1:inf:1"])
def test_settings_that_make_no_sense_are_refused(text):
    assert_answered(lambda: parsed_setting(text), ValueError, "--set", repr(text))


@pytest.mark.parametrize("workers", [0, 1])
def test_a_member_that_calls_exit_fails_alone(workers, tmp_path):
    with pytest.warns(UserWarning, match="SystemExit"):
        table = run(tmp_path / "scan", fate=leaves, workers=workers)
    assert table["status"].tolist() == ["done", "failed", "done"]
