"""The benchmark compares like with like, and divides the right numbers."""

import json
import re
from importlib.util import find_spec

import numpy as np
import pytest

from minimd import cli
from minimd.bench import Options, engines, lj, memory, rows, run_lj, scenes, turns

N_ATOMS = 256  # four cells along each edge
PEER_SECONDS, ASE_SECONDS = 0.015, 0.35  # a step of a fake peer on one thread; more than 5 s in all the steps of a turn
OWN_SECONDS = {(1, "double"): 0.003, (1, "mixed"): 0.002, (2, "double"): 0.0018, (2, "mixed"): 0.0012}


class FakeEngine:
    """Takes no time, but turns the clock on."""

    clock = 0.0

    def __init__(self, name, threads, precision, seconds, energies=(-1700.0, -1200.0)):
        self.name, self.threads, self.precision = name, threads, precision
        self._seconds, self._energies = seconds, energies
        self.positions = np.zeros((N_ATOMS, 3))
        self.steps = []

    def potential_energy(self):
        return self._energies[0]

    def total_energy(self):
        return self._energies[1]

    def run(self, n_steps):
        self.steps.append(n_steps)
        FakeEngine.clock += n_steps * self._seconds


@pytest.fixture
def fakes(monkeypatch):
    """Engines of known speed instead of all others."""
    monkeypatch.setattr(turns, "perf_counter", lambda: FakeEngine.clock)
    monkeypatch.setattr(lj, "available_cores", lambda: 2)
    monkeypatch.setattr(lj, "find_spec", lambda name: True)
    monkeypatch.setattr(lj, "Minimd", lambda scene, threads, precision: FakeEngine("minimd", threads, precision, OWN_SECONDS[threads, precision]))
    fast = engines.Peer(lambda scene, threads: FakeEngine("fast", threads, "single", PEER_SECONDS / threads), threaded=True)
    slow = engines.Peer(lambda scene, threads: FakeEngine("slow (serial)", 1, "double", ASE_SECONDS), most_atoms=N_ATOMS)
    monkeypatch.setattr(lj, "PEERS", {"fast": fast, "slow": slow})


@pytest.fixture
def short(monkeypatch):
    """Real engines, no time."""
    monkeypatch.setattr(turns, "WARM_UP", 5)
    monkeypatch.setattr(turns, "SECONDS_A_TURN", 0.01)
    monkeypatch.setattr(turns, "STEPS_A_TURN", 2)


def cells_of(table):
    """Rows of the first table, as lists of texts, without stars."""
    lines = [line for line in table.splitlines() if line.startswith("|")]
    return [[cell.strip() for cell in line.replace("**", "").strip("|").split("|")] for line in lines[2:]]


def test_ratios_of_the_table(fakes):
    """Speeds are 256 atoms / seconds of a step; peers are beside double on as many threads, minimd beside double on one."""
    table = cells_of(run_lj(Options(cells=(4,), threads=(1, 2), precisions=("double", "mixed"), repeats=2)).markdown())
    assert table == [
        ["minimd", "1", "double", "0.0853 (0.0853 to 0.0853)", "", "1"],
        ["minimd", "1", "mixed", "0.128 (0.128 to 0.128)", "", "1.50 (1.50 to 1.50)"],
        ["minimd", "2", "double", "0.142 (0.142 to 0.142)", "", "1.67 (1.67 to 1.67)"],
        ["minimd", "2", "mixed", "0.213 (0.213 to 0.213)", "", "2.50 (2.50 to 2.50)"],
        ["fast", "1", "single", "0.0171 (0.0171 to 0.0171)", "5.00 (5.00 to 5.00)", ""],
        ["fast", "2", "single", "0.0341 (0.0341 to 0.0341)", "4.17 (4.17 to 4.17)", ""],
        ["slow (serial)", "1", "double", "0.000731 (0.000731 to 0.000731)", "117 (117 to 117)", ""],
    ]


def test_peer_is_no_reference_and_ratios_stay_among_equals():
    """Rows in the worst order: nothing but minimd, double, of the same threads and scene, may be divided by."""
    speeds = np.ones(1)
    peer = lj.Row("peer", 1, "double", "melt", 1, 2.0 * speeds, 1.0)
    melts = [lj.Row("minimd", t, "double", "melt", 1, 10.0 * t * speeds, 1.0) for t in (2, 1)]
    chains = [lj.Row("minimd", t, "double", "chains", 1, 7.0 * t * speeds, 3.0) for t in (2, 1)]
    everything = [peer, *chains, *melts]
    assert rows.faster_than_peer(everything, peer) == [5.0]
    assert rows.beside_one_thread(everything, melts[0]) == [2.0]
    assert rows.beside_one_thread(everything, peer) is None
    assert [rows.beside_melt(everything, row) for row in chains] == [([0.7], [pytest.approx(2.1)])] * 2


def test_spread_is_over_turns():
    ours = lj.Row("minimd", 1, "double", "melt", 10, np.array([4e6, 6e6, 5e6]))
    peer = lj.Row("peer", 1, "double", "melt", 10, np.array([2e6, 2e6, 1e6]))
    table = cells_of(lj.Outcome("melt", ["text"], 3, (), [[ours, peer]]).markdown())
    assert table[0][3] == "5.00 (4.00 to 6.00)"
    assert table[1][3:5] == ["2.00 (1.00 to 2.00)", "3.00 (2.00 to 5.00)"]  # the median of ratios, not the ratio of medians


def test_scene_is_measured_beside_the_melt_by_atoms_and_by_pairs(fakes, monkeypatch):
    seconds = iter([0.002, 0.005])  # melt, mixture
    counts = iter([6000, 8000, 7000, 9000])  # melt and mixture before, and after
    monkeypatch.setattr(lj, "Minimd", lambda scene, threads, precision: FakeEngine("minimd", threads, precision, next(seconds)))
    monkeypatch.setattr(lj, "pairs_in_range", lambda scene, positions: next(counts))
    monkeypatch.setattr(lj, "equilibrated", lambda scene: scene)
    melt, mixture = cells_of(run_lj(Options("kob-andersen", cells=(4,), threads=(1,), repeats=2)).markdown())
    assert melt == ["melt", "256", "1", "double", "0.128 (0.128 to 0.128)", "25.4", "3.25 (3.25 to 3.25)", "", ""]
    assert mixture[:6] == ["kob-andersen", "256", "1", "double", "0.0512 (0.0512 to 0.0512)", "33.2"]
    assert mixture[6:] == ["1.70 (1.70 to 1.70)", "0.400 (0.400 to 0.400)", "0.523 (0.523 to 0.523)"]  # 8500/6500 of 0.4


def test_json_holds_every_turn_and_where_it_was_measured(fakes):
    content = json.loads(run_lj(Options(cells=(4, 5), threads=(1,), repeats=3)).json())
    assert content["machine"]["cores"] >= 1
    assert set(content["versions"]) == {"minimd", "numba", "numpy", "fast", "slow"}
    assert [size["n_atoms"] for size in content["sizes"]] == [256, 500]
    assert [row["engine"] for row in content["sizes"][1]["rows"]] == ["minimd", "fast"]  # the slow one only if asked for
    own, fast, _ = content["sizes"][0]["rows"]
    assert own["atom_steps_per_second"]["turns"] == pytest.approx([256 / 0.003] * 3)
    assert own["minimd_is_faster_by"] is None
    assert fast["minimd_is_faster_by"]["median"] == pytest.approx(5.0)
    assert fast["bytes_per_atom"] is None


def test_slow_peer_takes_part_in_large_scenes_if_asked_for(fakes):
    outcome = run_lj(Options(cells=(5,), threads=(1,), peers=("slow",), repeats=1))
    assert [row.engine for row in outcome.sizes[0]] == ["minimd", "slow (serial)"]


def test_reference_on_one_thread_always_runs():
    assert Options(threads=(2,), precisions=("mixed",)).kinds() == [(1, "double"), (2, "mixed")]


def test_turns_are_long_enough_for_lists_and_short_enough_for_people():
    assert turns.steps_in_a_turn(0.001) == 500
    assert turns.steps_in_a_turn(0.1) == 40
    assert turns.steps_in_a_turn(0.5) == 10
    assert turns.steps_in_a_turn(60.0) == 1


def test_engines_take_turns(fakes):
    first, second = FakeEngine("a", 1, "double", 0.01), FakeEngine("b", 1, "double", 0.02)
    speeds = turns.take_turns([first, second], [50, 25], 3, N_ATOMS)
    assert first.steps == [50] * 3
    assert second.steps == [25] * 3
    assert speeds == pytest.approx(np.array([[100.0] * 3, [50.0] * 3]))


@pytest.mark.parametrize(("energies", "message"), [((-1700.1, -1200.0), "potential energy at step 0"), ((-1700.0, -1199.0), "total energy per atom")])
def test_peer_with_another_energy_is_refused(fakes, monkeypatch, capsys, energies, message):
    other = engines.Peer(lambda scene, threads: FakeEngine("other", 1, "double", 0.01, energies))
    monkeypatch.setattr(lj, "PEERS", {"other": other})
    assert cli.main(["bench", "lj", "--cells", "4", "--threads", "1"]) == cli.FAILED
    out, err = capsys.readouterr()
    assert not out
    assert message in err.splitlines()[-1]
    assert "minimd, double, 1 thread has -" in err


def test_peer_with_another_time_step_is_refused(monkeypatch):
    right = engines.Minimd(scenes.melt(4))
    monkeypatch.setattr(engines, "TIMESTEP", 0.00505)
    wrong = engines.Minimd(scenes.melt(4))
    with pytest.raises(ArithmeticError, match="potential energy per atom after 10 steps"):
        turns.check_agreement([right, wrong], N_ATOMS)


@pytest.mark.parametrize("name", engines.PEERS)
def test_peers_have_the_same_energies(name):
    if not find_spec(name):
        pytest.skip(f"{name} is not installed")
    scene = scenes.melt(4)
    turns.check_agreement([engines.Minimd(scene), engines.PEERS[name].load(scene, 1)], N_ATOMS)


def test_minimd_is_asked_for_threads_and_precision(monkeypatch):
    asked = {}
    monkeypatch.setattr(engines.md, "Simulation", lambda *arguments, **keywords: asked.update(keywords))
    engines.Minimd(scenes.melt(4), 2, "mixed")
    assert asked == {"threads": 2, "precision": "mixed"}


def test_command_prints_and_writes_the_table(short, capsys, tmp_path):
    folder = tmp_path / "new" / "results"
    arguments = ["bench", "lj", "--cells", "3,4", "--threads", "1", "--repeats", "1", "--peers", "none", "--out", str(folder)]
    assert cli.main(arguments) == 0
    table = (folder / "bench_lj.md").read_text(encoding="utf-8")
    assert capsys.readouterr().out == table
    assert re.findall(r"## (\d+) atoms", table) == ["108", "256"]
    assert json.loads((folder / "bench_lj.json").read_text(encoding="utf-8"))["repeats"] == 1


@pytest.mark.parametrize("scene", ["kob-andersen", "chains"])
def test_other_scenes_run(short, scene):
    melt, other = run_lj(Options(scene, cells=(4,), threads=(1,), repeats=1)).sizes[0]
    assert (melt.scene, other.scene) == ("melt", scene)
    assert other.n_pairs > 20 * other.n_atoms


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (["--scene", "ice"], "--scene must be of melt, kob-andersen, chains; it is 'ice'"),
        (["--precision", "double,half"], "--precision must be of double, mixed; it is 'half'"),
        (["--peers", "gromacs"], "--peers must be of lammps, openmm, ase, asap3, none; it is 'gromacs'"),
        (["--peers", "none,ase"], "--peers must be of lammps, openmm, ase, asap3; it is 'none'"),
        (["--threads", "1,100000"], "--threads 100000 is more than the "),
        (["--cells", "10,2"], "--cells 2 makes a cell narrower than twice the cutoff in the scene 'melt'; take more"),
        (["--scene", "chains", "--peers", "ase"], "--peers is for the melt; the scene 'chains' runs in minimd alone"),
    ],
)
def test_bad_options_get_one_sentence(capsys, options, message):
    assert cli.main(["bench", "lj", *options]) == cli.WRONG_INPUT
    (line,) = capsys.readouterr().err.splitlines()
    assert line.startswith(f"minimd: error: {message}")


@pytest.mark.parametrize("options", [["--cells", "4,x"], ["--threads", "0"], ["--repeats", "-1"], ["--cells", ""]])
def test_numbers_must_be_numbers(capsys, options):
    with pytest.raises(SystemExit, match="2"):
        cli.main(["bench", "lj", *options])
    assert "must be a whole number, at least 1; it is " in capsys.readouterr().err


def test_missing_peers_are_told_with_what_installs_them(fakes, monkeypatch, capsys):
    monkeypatch.setattr(lj, "find_spec", lambda name: name != "fast")
    outcome = run_lj(Options(cells=(4,), threads=(1,), repeats=1))
    assert [row.engine for row in outcome.sizes[0]] == ["minimd", "slow (serial)"]
    assert "not installed, so not compared with: fast; pip install 'minimd[peers]' installs them" in capsys.readouterr().err
    with pytest.raises(ValueError, match=r"fast is not installed; pip install 'minimd\[peers\]'"):
        run_lj(Options(cells=(4,), threads=(1,), peers=("fast",)))


def test_peer_that_does_not_start_is_named(fakes, monkeypatch):
    def load(scene, threads):
        raise RuntimeError("libmpi.so:\n not found")

    monkeypatch.setattr(lj, "PEERS", {"broken": engines.Peer(load)})
    with pytest.raises(ValueError, match=r"broken is installed but does not start: libmpi\.so: not found; name the others with --peers"):
        run_lj(Options(cells=(4,), threads=(1,)))


def test_memory_is_told_at_large_sizes_only(fakes, monkeypatch):
    monkeypatch.setattr(lj, "FROM_ATOMS", 500)
    monkeypatch.setattr(lj, "bytes_per_atom", lambda scene, n, threads, precision: 100.0 * n + threads)
    outcome = run_lj(Options(cells=(4, 5), threads=(1,), repeats=1))
    assert [row.bytes_per_atom for size in outcome.sizes for row in size] == [None, None, None, 501.0, None]
    assert outcome.markdown().count("bytes per atom") == 1
    assert "| 1 | 501 |" in outcome.markdown()


@pytest.mark.skipif(not memory.STATUS.exists(), reason="Linux tells the peak of a process, others do not")
@pytest.mark.slow
def test_memory_is_that_of_arrays_and_lists():
    ballast = np.ones(10**8)  # the parent's memory does not count
    assert 100.0 < memory.bytes_per_atom("melt", 30, 1, "double") < 5000.0
    assert ballast.all()
