"""md.ensemble: what a member becomes depends on its index, its parameters and the seed alone; what fails or stops costs nothing else."""

import json
import multiprocessing
import os
import signal
import subprocess
import sys
import threading
import time
import warnings
from concurrent.futures import ProcessPoolExecutor, ThreadPoolExecutor
from functools import partial
from pathlib import Path

import members
import numpy as np
import pytest
from kills import killed_at
from members import STEPS, TEMPERATURES
from test_kills import assert_same_file

import minimd as md
from minimd.ensemble.folder import EnsembleFolder, name_of
from minimd.ensemble.running import EnsembleError
from minimd.ensemble.workers import STARTS, ThisProcess, Worker
from minimd.files.h5md_reader import read_file
from minimd.structure.errors import Interrupted
from minimd.structure.statistics import mean_and_error

FILES = [f"0000-0999/{k:04d}.h5md" for k in range(4)]


def run(folder, build=members.liquid, parameters=TEMPERATURES, steps=STEPS, **options):
    return md.ensemble(build, parameters, steps, every=5, folder=folder, progress=False, **{"workers": 0, **options})


@pytest.fixture(scope="module")
def done(tmp_path_factory):
    """An ensemble that nothing has disturbed."""
    return run(tmp_path_factory.mktemp("done"))


def assert_same(folder, other):
    """Tables and files are the same, to the bit."""
    for name in ("table.csv", "table.json"):
        assert Path(folder, name).read_bytes() == Path(other, name).read_bytes()
    for name in FILES:
        assert_same_file(Path(folder, name), Path(other, name))


def assert_same_as(done, folder):
    assert_same(folder, done.folder)


def test_the_table_holds_parameters_means_and_files(done):
    assert done["temperature"].tolist() == TEMPERATURES["temperature"]
    assert set(done["status"]) == {"done"}
    assert set(done["n_steps"]) == {STEPS}
    contents = md.Simulation.resume(done["file"][2], md.LennardJones(1.0, 1.0, 1.8))
    assert contents.step == STEPS
    assert "pressure" in done.observables
    assert np.isfinite(done["pressure_error"]).all()
    assert "4 done" in str(done)


def test_mean_and_error_are_those_of_the_series(done):
    pressure = read_file(done["file"][1]).record.pressure
    assert len(pressure) == 13
    assert (done["pressure_mean"][1], done["pressure_error"][1]) == mean_and_error(pressure)


def test_blocks_see_a_correlation_that_single_entries_do_not():
    series = np.repeat(np.random.default_rng(1).standard_normal(400), 50)  # each number fifty times
    mean, error = mean_and_error(series)
    assert mean == pytest.approx(series.mean())
    assert error == pytest.approx(1.0 / np.sqrt(400), rel=0.5)  # statistics: of 20 blocks
    assert error > 4.0 * series.std() / np.sqrt(len(series))
    assert np.isnan(mean_and_error([1.0, 2.0])[1])


def test_seeds_are_children_of_one_sequence():
    children = np.random.SeedSequence(7).spawn(3)
    for k, child in enumerate(children):
        member = md.Member(k, {}, 7, 10, Path("a.h5md"))
        assert member.seed_sequence.generate_state(4).tolist() == child.generate_state(4).tolist()
        assert 0 <= member.seed < 2**63
    with pytest.raises(KeyError, match="no parameter 'density'; it has none"):
        member["density"]


def fork():
    return ProcessPoolExecutor(2, mp_context=multiprocessing.get_context("fork"))


@pytest.mark.filterwarnings("ignore:This process:DeprecationWarning")
@pytest.mark.parametrize("executor", [lambda: ThreadPoolExecutor(2), fork], ids=["threads", "fork"])
def test_any_executor_makes_the_same_bits(executor, done, tmp_path):
    with executor() as pool:
        run(tmp_path, workers=None, executor=pool)
    assert_same_as(done, tmp_path)


@pytest.mark.parametrize("workers", [1, 2])
def test_spawned_workers_make_the_same_bits(workers, done, tmp_path):
    run(tmp_path, workers=workers)
    assert_same_as(done, tmp_path)


def test_a_law_of_the_users_works_in_spawned_workers(tmp_path):
    run(tmp_path / "here", members.own_law)
    run(tmp_path / "there", members.own_law, workers=1)
    assert_same(tmp_path / "here", tmp_path / "there")


def test_dask_makes_the_same_bits(done, tmp_path):
    distributed = pytest.importorskip("distributed")
    options = {"n_workers": 2, "threads_per_worker": 1, "processes": False, "dashboard_address": None}
    with distributed.LocalCluster(**options) as cluster, distributed.Client(cluster) as client:
        run(tmp_path, workers=None, executor=client.get_executor())
    assert_same_as(done, tmp_path)


def test_finished_members_are_skipped_and_more_can_be_asked_for(done, tmp_path):
    folder = tmp_path / "scan"
    few = {"temperature": TEMPERATURES["temperature"][:2]}
    run(folder, members.counted, few)
    run(folder, members.counted, few)
    assert (tmp_path / "calls").read_text() == "0 False\n1 False\n"
    run(folder, members.counted)
    assert (tmp_path / "calls").read_text() == "0 False\n1 False\n2 False\n3 False\n"
    assert_same_as(done, folder)


def test_more_steps_go_on_from_the_files(done, tmp_path):
    run(tmp_path, steps=35)
    run(tmp_path)
    assert_same_as(done, tmp_path)


def test_averages_of_fewer_steps_than_are_asked_for_are_none(tmp_path):
    from minimd.ensemble.table import table_of

    run(tmp_path, steps=35)
    with EnsembleFolder(tmp_path, writes=False) as folder:
        table = table_of(folder, folder.asked._replace(steps=STEPS), 4)
    assert set(table["status"]) == {"begun"}
    assert not table.observables


def test_fewer_members_are_a_part_of_the_table(done, tmp_path):
    run(tmp_path)
    table = run(tmp_path, parameters=[{"temperature": 0.4}])
    assert len(table) == 1
    assert table["pressure_mean"][0] == done["pressure_mean"][0]
    assert len(json.loads((tmp_path / "ensemble.json").read_text())["parameters"]["temperature"]) == 4


@pytest.mark.parametrize("k", [7, 25, *(pytest.param(k, marks=pytest.mark.slow) for k in (3, 12, 20, 31))])
def test_a_process_that_is_killed_anywhere_leaves_what_the_next_call_goes_on_with(k, done, tmp_path, monkeypatch):
    monkeypatch.setattr("minimd.files.h5md_writer.SECONDS_BETWEEN_FLUSHES", 0.0)
    assert killed_at(k, lambda: run(tmp_path)) is None
    run(tmp_path)
    assert_same_as(done, tmp_path)


@pytest.mark.slow
def test_a_killed_worker_costs_its_members_only(done, tmp_path):
    with pytest.warns(
        UserWarning,
        match=r"(?s)1 of 4 members have failed:.member 2 \(temperature = 0.6\): WorkerDied: .* was killed by SIGKILL",
    ):
        table = run(tmp_path, members.one_is_killed, workers=1)
    assert table["status"].tolist() == ["done", "done", "failed", "done"]
    assert np.isnan(table["pressure_mean"][2])
    run(tmp_path, members.one_is_killed, workers=1)
    assert_same_as(done, tmp_path)


def test_a_member_that_blows_up_is_told_with_its_crash_file_and_stops_no_other(tmp_path):
    for _ in range(2):  # the second call makes it anew
        with pytest.warns(
            UserWarning, match=r"(?s)1 of 4 members have failed:.member 3 .*NonFiniteError.*0003.crash.h5md"
        ):
            table = run(tmp_path, members.hot)
        assert table["status"].tolist() == ["done"] * 3 + ["failed"]
        assert sorted(path.name for path in (tmp_path / "0000-0999").iterdir())[-2:] == ["0003.crash.h5md", "0003.h5md"]
    assert "0003.crash.h5md" in table["message"][3]
    assert "FAILED" in str(table)


def test_nothing_goes_on_from_where_a_run_has_blown_up(done, tmp_path):
    """Not even if the caller was killed before it could note the failure."""
    with pytest.warns(UserWarning, match="have failed"):
        run(tmp_path, members.hot)
    journal = tmp_path / "members.jsonl"
    journal.write_text("".join(journal.read_text().splitlines(keepends=True)[:3]))
    run(tmp_path, partial(members.hot, timestep=0.004))
    assert_same_as(done, tmp_path)
    assert not (tmp_path / "0000-0999" / "0003.crash.h5md").exists()


@pytest.mark.skipif(os.name == "nt", reason="signals of POSIX")
@pytest.mark.parametrize("n_killed", [2, 3])
def test_a_worker_killed_while_it_starts_is_replaced_unless_all_are(n_killed, done, tmp_path, monkeypatch):
    start, killed = Worker.__init__, []

    def start_and_kill(worker):
        start(worker)
        if len(killed) < n_killed:
            killed.append(worker.process)
            os.kill(worker.process.pid, signal.SIGKILL)

    monkeypatch.setattr(Worker, "__init__", start_and_kill)
    if n_killed < STARTS:
        run(tmp_path, workers=1)
    else:
        with pytest.raises(EnsembleError, match=r"member 0 .* killed by SIGKILL"):
            run(tmp_path, workers=1)
        run(tmp_path)
    assert len(killed) == n_killed
    assert_same_as(done, tmp_path)


def test_what_an_executor_raises_that_takes_no_member_is_told_with_the_table_of_those_that_are_done(done, tmp_path):
    class Broken(ThisProcess):
        left = 2

        def submit(self, *arguments):
            self.left -= 1
            if self.left < 0:
                raise MemoryError("a worker is gone")
            return super().submit(*arguments)

    with pytest.raises(EnsembleError, match=r"member 2 .*MemoryError: a worker is gone") as broken:
        run(tmp_path, workers=None, executor=Broken())
    assert isinstance(broken.value.__cause__, MemoryError)
    written = json.loads((tmp_path / "table.json").read_text())
    assert written["columns"]["status"] == ["done", "done", "missing", "missing"]
    run(tmp_path)
    assert_same_as(done, tmp_path)


def test_functions_are_named_as_others_import_them(monkeypatch):
    monkeypatch.setattr(sys.modules["__main__"], "__file__", "/somewhere/script.py", raising=False)
    monkeypatch.setattr(members.hot, "__module__", "__main__")
    assert name_of(partial(partial(members.hot, timestep=1.0))) == name_of(members.hot) == "script.hot"
    assert name_of(lambda member: 3).endswith("<lambda>")


def test_if_all_fail_the_first_failure_is_raised_with_its_traceback(tmp_path):
    told = r"(?s)all 4 members have failed; the first failure was:.member 0 .*LookupError: no structure for 0"
    with pytest.raises(RuntimeError, match=told) as failure:
        run(tmp_path, members.broken)
    assert "in broken" in failure.value.__notes__[0]


@pytest.mark.parametrize("workers", [0, 1])
def test_ctrl_c_leaves_what_is_done(workers, done, tmp_path):
    """It comes when the first member has ended, and the second has begun."""

    def interrupt():
        journal = tmp_path / "members.jsonl"
        while not journal.exists() or not journal.read_text():
            time.sleep(0.01)
        while not (tmp_path / FILES[1]).exists():
            time.sleep(0.01)
        os.kill(os.getpid(), signal.SIGINT)

    thread = threading.Thread(target=interrupt)
    thread.start()
    with pytest.raises(
        Interrupted, match=rf"1 of 4 members are done and kept in {tmp_path}; the same call goes on"
    ) as stopped:
        run(tmp_path, members.second_is_slow, workers=workers)
    thread.join()
    assert stopped.value.result["status"].tolist() == ["done", "begun", "missing", "missing"]
    assert read_file(tmp_path / FILES[1]).step < STEPS
    run(tmp_path, partial(members.second_is_slow, seconds=0.0))
    assert_same_as(done, tmp_path)


def test_a_damaged_file_begins_anew(done, tmp_path):
    run(tmp_path, steps=35)
    with (tmp_path / FILES[1]).open("r+b") as file:
        file.seek(3000)
        file.write(b"\xff" * 4000)
    run(tmp_path)
    assert_same_as(done, tmp_path)


@pytest.mark.slow
def test_half_a_line_of_the_journal_is_forgotten(done, tmp_path):
    run(tmp_path)
    journal = tmp_path / "members.jsonl"
    text = journal.read_text()
    journal.write_text(text[: len(text) - 40])
    run(tmp_path)
    assert_same_as(done, tmp_path)
    assert [json.loads(line)["index"] for line in journal.read_text().splitlines()] == [0, 1, 2, 3]


def test_another_ensemble_is_refused_unless_it_is_to_be_replaced(done, tmp_path):
    run(tmp_path, seed=5, steps=35)
    for change, told in (
        ({"seed": 6}, "seed = 5 there, 6 here"),
        ({"seed": 5, "steps": 20}, "steps = 35 there, 20 here"),
        ({"seed": 5, "build": members.hot}, "build = members.liquid there, members.hot here"),
        ({"seed": 5, "build": partial(members.hot, timestep=0.004)}, "build = members.liquid there, members.hot here"),
        ({"seed": 5, "prepare": members.melted}, "prepare = None there, members.melted here"),
        (
            {"seed": 5, "parameters": {"temperature": [0.4, 0.9]}},
            "member 1 has the parameters {'temperature': 0.5} there, {'temperature': 0.9} here",
        ),
    ):
        with pytest.raises(
            ValueError,
            match=f"holds another ensemble: {told}; choose another folder, or replace what is there with resume=False",
        ):
            run(tmp_path, **change)
    run(tmp_path, resume=False)
    assert_same_as(done, tmp_path)


@pytest.mark.slow
def test_a_drawn_seed_is_written_down_and_used_again(tmp_path):
    run(tmp_path, seed=None, steps=35)
    drawn = json.loads((tmp_path / "ensemble.json").read_text())["seed"]
    run(tmp_path, seed=None)
    assert json.loads((tmp_path / "ensemble.json").read_text())["seed"] == drawn > 2**32


def test_two_calls_cannot_use_one_folder(tmp_path):
    with (
        EnsembleFolder(tmp_path, writes=True),
        pytest.raises(OSError, match="an ensemble is running there; wait for its end, or choose another"),
    ):
        run(tmp_path)


def test_prepare_comes_before_the_first_step_only(tmp_path):
    run(tmp_path / "whole", prepare=members.melted)
    run(tmp_path / "parts", prepare=members.melted, steps=35)
    run(tmp_path / "parts", prepare=members.melted)
    assert_same(tmp_path / "whole", tmp_path / "parts")


def test_a_run_of_the_users_gives_numbers_pairs_or_series(done, tmp_path):
    table = run(tmp_path, run=members.pressure_alone)
    assert table.observables == ("pressure", "last", "known")
    assert set(zip(table["known_mean"], table["known_error"], strict=True)) == {(1.0, 0.1)}
    assert np.isnan(table["last_error"]).all()
    assert table["file"].tolist() == [""] * 4
    with pytest.raises(ValueError, match="steps = 60 there, 80 here"):
        run(tmp_path, run=members.pressure_alone, steps=80)


def test_a_worker_has_one_thread_unless_told_otherwise(monkeypatch, tmp_path):
    from minimd.forces.options import Options

    threads = []
    monkeypatch.setattr(
        Options,
        "most_threads",
        property(lambda options, before=Options.most_threads.fget: threads.append(before(options)) or 1),
    )
    run(tmp_path / "one", parameters=[{"temperature": 0.5}], steps=5)
    assert set(threads) == {1}
    threads.clear()
    run(tmp_path / "two", members.two_threads, parameters=[{"temperature": 0.5}], steps=5)
    assert set(threads) == {2}


def test_averages_over_members_with_the_same_parameters(tmp_path):
    table = run(tmp_path, parameters={"temperature": [0.5, 0.7, 0.5]})
    pairs = table.averaged()
    assert pairs["temperature"].tolist() == [0.5, 0.7]
    assert pairs["n_members"].tolist() == [2, 1]
    means, errors = table["pressure_mean"][[0, 2]], table["pressure_error"][[0, 2]]
    assert pairs["pressure_mean"][0] == pytest.approx(means.mean())
    assert pairs["pressure_error"][0] == pytest.approx(max(np.hypot(*errors) / 2, means.std(ddof=1) / np.sqrt(2)))
    assert pairs["pressure_error"][1] == table["pressure_error"][1]


def test_the_table_as_data_frame_csv_and_json(done):
    pandas = pytest.importorskip("pandas")
    frame = done.to_pandas()
    read = pandas.read_csv(done.folder / "table.csv").set_index("index")
    assert frame["pressure_mean"].tolist() == read["pressure_mean"].tolist()
    told = json.loads((done.folder / "table.json").read_text())
    assert told["columns"]["pressure_mean"] == done["pressure_mean"].tolist()
    assert told["units"]["pressure"] == "ε/σ³"
    assert told["columns"]["file"] == FILES


BAD = [
    ({"build": 3}, TypeError, "build must be a function of a member; build = 3"),
    ({"parameters": 0}, ValueError, "the number of members must be a whole number, at least 1"),
    ({"parameters": []}, ValueError, "an ensemble must have at least one member"),
    ({"parameters": [1, 2]}, TypeError, "parameters must be the number of members, a dict of columns"),
    ({"parameters": {"a": 3}}, TypeError, "parameter 'a' must be a list of values"),
    (
        {"parameters": {"a": [1, 2], "b": [1]}},
        ValueError,
        "'a' has 2, 'b' has 1. For all combinations of values, give a list of dicts",
    ),
    ({"parameters": [{"a": 1}, {"b": 1}]}, ValueError, "member 0 has 'a', member 1 has 'b'"),
    ({"parameters": {"index": [1]}}, ValueError, "columns of the table; it is 'index'"),
    (
        {"parameters": {"a": [[1]]}},
        TypeError,
        "parameter 'a' must be a number, a text, True or False; for member 0 it is",
    ),
    ({"steps": -1}, ValueError, "steps must be a whole number, at least 0"),
    ({"seed": -1}, ValueError, "seed must be a whole number, at least 0"),
    ({"workers": -1}, ValueError, "workers must be a whole number, at least 0"),
    ({"workers": 2, "executor": ThreadPoolExecutor(1)}, ValueError, "with an executor leave it out; workers = 2"),
    ({"workers": None, "executor": "dask"}, TypeError, "executor must have a method submit"),
    (
        {"workers": 2, "build": lambda member: None},
        TypeError,
        "build cannot be sent to worker processes: .*Define it with def at the top level",
    ),
    ({"build": lambda member: 3}, RuntimeError, "build must return a Simulation; for member 0 .* it returned 3"),
    (
        {"run": lambda *_: 3},
        RuntimeError,
        "run must return a Record, a dict of numbers, .* or of series, or None; it returned 3",
    ),
]


@pytest.mark.parametrize(("options", "kind", "told"), BAD, ids=[str(k) for k in range(len(BAD))])
def test_what_is_wrong_is_said_in_a_sentence(options, kind, told, tmp_path):
    with pytest.raises(kind, match=told):
        run(tmp_path, **options)


def test_rows_cost_the_same_whatever_their_number(tmp_path):
    """2000 members: a line each, and one table at the end."""
    from minimd.ensemble.folder import Asked
    from minimd.ensemble.table import table_of

    n, averages = 2000, {"pressure": 1.0}
    with EnsembleFolder(tmp_path, writes=True) as folder:
        asked = folder.begin(Asked(0, 10, 5, [{"temperature": k / n} for k in range(n)], "build", "", ""), True)
        sizes = []
        for k in reversed(range(n)):
            folder.take(
                {
                    "index": k,
                    "status": "done",
                    "n_steps": 10,
                    "n_atoms": 4,
                    "units": "LJ",
                    "means": averages,
                    "errors": averages,
                }
            )
            sizes.append((tmp_path / "members.jsonl").stat().st_size)
        table = table_of(folder, asked, n)
    assert np.ptp(np.diff(sizes)) <= 4  # digits of the index
    assert table["index"].tolist() == list(range(n))
    assert table["temperature"][7] == 7 / n


def test_nothing_heavy_is_loaded():
    code = "import sys, minimd.ensemble, minimd.ensemble.table; print({'h5py', 'pandas', 'dask', 'mpi4py', 'tqdm', 'pydantic'} & set(sys.modules))"
    assert subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout == "set()\n"


@pytest.mark.slow
def test_mpi_makes_the_same_bits(done, tmp_path):
    pytest.importorskip("mpi4py")
    mpiexec = Path(sys.executable).with_name("mpiexec")
    if not mpiexec.exists():
        pytest.skip("there is no mpiexec beside Python")
    (tmp_path / "script.py").write_text(
        "import members, minimd as md\nfrom mpi4py.futures import MPIPoolExecutor\n"
        "if __name__ == '__main__':\n    with MPIPoolExecutor() as pool:\n"
        f"        md.ensemble(members.liquid, members.TEMPERATURES, {STEPS}, every=5, executor=pool, folder='scan', progress=False)\n"
    )
    library = {"LD_LIBRARY_PATH": str(mpiexec.parents[1] / "lib")}
    command = [mpiexec, "-n", "3", sys.executable, "-m", "mpi4py.futures", "script.py"]
    ended = subprocess.run(
        command, cwd=tmp_path, env=os.environ | library, capture_output=True, text=True, check=False, timeout=300
    )
    assert ended.returncode == 0, ended.stderr
    assert_same_as(done, tmp_path / "scan")


def test_warnings_of_failures_name_a_few(tmp_path):
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        run(tmp_path, members.hot, {"temperature": [0.5, 0.7, 0.7, 0.7, 0.7, 0.7]})
    (told,) = [str(one.message) for one in caught if "have failed" in str(one.message)]
    assert "5 of 6 members have failed" in told
    assert "and 2 more" in told
