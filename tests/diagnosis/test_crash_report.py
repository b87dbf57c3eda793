"""A run that blows up says why, leaves a file, and can be seen failing again."""

import json
import re
import shutil
from pathlib import Path

import h5py
import numpy as np
import pytest
from references import liquid, melt_scene
from scenes import LJ, SCENES
from wrong_calls import assert_answered

import minimd as md
from minimd.commands import main as cli
from minimd.diagnosis.crash_report import examine
from minimd.files.crash_file import read_crash_report
from minimd.files.h5md_digest import sign
from minimd.files.h5md_reader import read_file
from minimd.forces.contacts import contacts
from minimd.neighbors.queries import closest_pair

BIG_STEP = 0.024  # at which a liquid lives for some hundred steps


def failing(simulation, n_steps=4000, **how):
    with pytest.raises((md.NonFiniteError, md.ConstraintError)) as caught:
        simulation.run(n_steps, **how)
    return caught.value


def melt(timestep, method=md.VelocityVerlet, **options):
    return SCENES["argon"]().simulation(method(timestep, **options))


def chain():
    return SCENES["chain"]().simulation(md.VelocityVerlet(0.15))


def rigid_with_one_fixed():
    scene = SCENES["dumbbells"]()
    fixed = [*scene.constraints, md.FixedAtoms([2])]
    return scene._replace(constraints=fixed).simulation(md.VelocityVerlet(0.08))


def of_two(law, second, timestep, velocities=0.0):
    system = md.System([[0.0, 0, 0], [second, 0, 0]], velocities=np.full((2, 3), velocities))
    return md.Simulation(system, law, md.VelocityVerlet(timestep))


def one_fast_atom():
    simulation = melt(0.005)
    simulation.velocities[7] = [400.0, 0.0, 0.0]
    return simulation


def hollow(r2, limit):
    """√(r² − limit): no number inside."""
    return (r2 - limit) ** 0.5, -1.0 / (r2 - limit) ** 0.5


HOLLOW = md.PairPotential(hollow, (1.0,), 3.0, "truncated")


def push_together(run):
    if run.step == 20:
        run.positions[1] = run.positions[0] + [0.3, 0.0, 0.0]


APPROACHING, FAST = [[1.0, 0, 0], [0.0, 0, 0]], [9e74, 0, 0]
SPRING = md.HarmonicBond(1e-3, 1.0, pairs=[[0, 1]])
CASES = [  # scene, kind of the cause, what is said
    (lambda: of_two(LJ, 0.55, 0.005), "overlap", "Likely cause: .*atoms 0 and 1.*\nAt step 0"),
    (lambda: melt(0.004), "overlap", "Likely cause: atoms 0 and 1 overlap at step 20"),
    (chain, "bond", r"Δt·ω = \d\.\d+ \(stable to 2\)"),
    (lambda: melt(0.04), "pair", "atoms"),
    (one_fast_atom, "hot", "atom 7"),
    (rigid_with_one_fixed, "constraint", "atoms"),
    (lambda: of_two(HOLLOW, 1.5, 0.01, APPROACHING), "law", "atoms 0 and 1"),
    # beyond all numbers in use: positions are still finite, but no System can hold them
    (lambda: of_two(SPRING, 1.0, 10.0, FAST), "pair", r"\nAt step 1: positions of 2 .* 1e\+75"),
]


@pytest.mark.parametrize(("make", "kind", "words"), CASES)
def test_the_cause_is_told(make, kind, words):
    """Also of an overlap that is made during the run, and of atoms that are flung beyond all numbers in use."""
    error = failing(make(), observers=[push_together] if "step 20" in words else [], every=10)
    found = error.crash_report
    assert found.kind == kind
    assert re.search(words, str(error))
    assert f"Likely cause: {found.cause}" in str(error)
    assert found.advice in str(found)
    assert error.file is None
    if make is chain:  # ω = √(k/μ), wherever it is
        masses, k = SCENES["chain"]().system.masses, np.linspace(100.0, 300.0, 11)[found.pair.first]
        inverse = 1.0 / masses[[found.pair.first, found.pair.second]]
        assert found.pair.is_bond
        assert found.pair.frequency == pytest.approx(np.sqrt(k * inverse.sum()), rel=1e-6)


def test_a_step_that_drives_atoms_into_each_other_is_told_by_their_distance_then():
    """In a crystal at rest no pair is stiff: Δt·ω = 0.3 before the first step is not why it fails."""
    crystal = liquid(5, temperature=3.0, jitter=0.0)
    found = failing(md.Simulation(crystal, LJ, md.VelocityVerlet(0.06))).crash_report
    assert (found.kind, found.step) == ("pair", 1)
    moved = md.System(crystal.positions + 0.06 * crystal.velocities, cell=crystal.cell)  # the crystal has no forces
    first, second, distance = closest_pair(moved)
    assert {found.pair.first, found.pair.second} == {first, second}
    assert found.pair.distance == pytest.approx(distance, rel=1e-9)  # rounding
    assert found.pair.frequency * 0.06 > 2.0


def test_bonded_atoms_at_one_place_are_the_cause():
    system = md.System([[0, 0, 0], [1, 0, 0], [1, 0, 0]], bonds=[[1, 2]])
    for term in (md.HarmonicBond(50.0, 1.0), md.HarmonicAngle(5.0, 2.0, [[0, 1, 2]])):
        found = failing(md.Simulation(system, term, md.VelocityVerlet(0.01))).crash_report
        assert found.kind == "overlap"
        assert "atoms 1 and 2 are at the same place" in found.cause


def test_contact_knows_force_and_curvature_of_the_pair():
    system, law = md.System([[0, 0, 0], [0.9, 0, 0]], masses=[1.0, 3.0]), md.LennardJones(2.0, 0.8)
    (one,) = contacts(system, [law], 1.0 / system.masses, [0])
    u = [law.pair_energy(0.9 + h) for h in (-1e-4, 0.0, 1e-4)]
    assert one.force == pytest.approx((u[0] - u[2]) / 2e-4, rel=1e-4)
    assert one.frequency == pytest.approx(np.sqrt((u[0] - 2 * u[1] + u[2]) / 1e-8 / 0.75), rel=1e-4)
    assert one.ratio == pytest.approx(0.9 / 0.8)
    assert one.rest_frequency == pytest.approx(np.sqrt(72 * 2.0 / (2 ** (1 / 3) * 0.64) / 0.75))
    system = md.System([[0.1, 0, 0], [4.9, 0, 0], [2.5, 0, 0]], cell=5.0, bonds=[[0, 2]])  # an image, an exclusion
    law = md.LennardJones(1.0, 1.0, 2.49, "force-shifted", bonded_scale=(0, 1, 1))
    found = contacts(system, [law, md.HarmonicBond(1.0, 1.0)], np.ones(3), [0])
    assert {(one.first, one.second, one.is_bond) for one in found} == {(0, 1, False), (0, 2, True)}
    assert next(one for one in found if not one.is_bond).distance == pytest.approx(0.2)


def test_rigid_pairs_are_no_overlap():
    """Of an atom and a light one without a well, thrown at the same: their lengths are not the cause."""
    places, velocities = np.outer([0.0, 0.3, 1.6, 1.9], [1, 0, 0]), np.outer([0, 0, -90.0, -90.0], [1, 0, 0])
    system = md.System(places, species=["A", "B", "A", "B"], velocities=velocities)
    law, rigid = md.LennardJones({"A": (1.0, 1.0), "B": (0.0, 1.0)}, cutoff=2.5), [[0, 1], [2, 3]]
    run = md.Simulation(system, law, md.VelocityVerlet(0.01), md.DistanceConstraints(rigid))
    assert "overlap at the start" not in str(failing(run, 100))


def test_file_holds_the_last_good_state_and_loses_nothing(tmp_path, monkeypatch):
    """And the energies of all atoms are examined, of clusters too, whose totals are booked on one atom."""
    seen, simulation = [], melt(BIG_STEP)

    def noted(engine, failure):
        seen.append(engine.interactions.energies.copy())
        return examine(engine, failure)

    monkeypatch.setattr("minimd.diagnosis.run_guard.examine", noted)
    error = failing(simulation, every=20, trajectory=tmp_path / "a.h5md")
    assert seen[0] == pytest.approx(md.evaluate(simulation.system, LJ).energies, rel=1e-9)  # rounding
    assert error.file == tmp_path / "a.crash.h5md"
    assert f"minimd replay {error.file}" in str(error)
    contents, kept = read_file(error.file), read_file(tmp_path / "a.h5md")
    assert contents.step == simulation.step == error.crash_report.last_good_step
    assert np.array_equal(contents.system.positions, simulation.positions)
    assert np.array_equal(contents.system.velocities, simulation.velocities)
    assert contents.record.step.tolist() == [error.crash_report.first_step, simulation.step]
    assert 20 <= simulation.step - error.crash_report.first_step <= 120
    assert kept.record.step.tolist() == list(range(0, kept.step + 1, 20))
    assert kept.step == simulation.step


def test_files_are_written_where_they_were_asked_for_and_replace_nothing(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    failing(chain())
    failing(chain(), crash_report=False, trajectory="a.h5md")
    assert [path.name for path in tmp_path.iterdir()] == ["a.h5md"]
    for name in ("why.h5md", "why-2.h5md", "why-3.h5md"):
        assert failing(chain(), crash_report="why.h5md").file == Path(name)
    with pytest.raises(ValueError, match="is a trajectory of the run"):
        chain().run(10, trajectory="a.h5md", crash_report="a.h5md", overwrite=True)
    error = failing(chain(), crash_report=tmp_path / "nowhere" / "a.h5md")  # that does not hide the failure
    assert "Likely cause" in str(error)
    assert "No crash report was written" in str(error)
    assert error.file is None


@pytest.fixture(scope="module")
def crash_file(tmp_path_factory):
    return failing(chain(), crash_report=tmp_path_factory.mktemp("crash") / "a.h5md").file


# fmt: off
ALTERED = [  # findings: as a text, or values to be changed, of the pair in the last three
    "{}", "null", "[" * 100_000, {"closest": {}}, {"fault": None}, {"pair": "x"}, {"closest": [0, 12, 1.0]},
    {"closest": [0, 1, "x"]}, {"fastest": 12}, {"timestep": None}, {"largest_force": 10**400},
    {"pair": {"first": 99_999_999_999}}, {"pair": {"second": -77}}, {"pair": {"law": 3}},
]
# fmt: on


def test_altered_findings_are_refused(crash_file, tmp_path):
    assert read_crash_report(crash_file).findings.pair is not None
    for change in ALTERED:
        file = shutil.copy(crash_file, tmp_path)
        with h5py.File(file, "r+") as h5:
            group = h5["minimd/crash_report"]
            found, text = json.loads(group["findings"].asstr()[()]), change
            if isinstance(change, dict):
                inner = {"pair": found["pair"] | change["pair"]} if isinstance(change.get("pair"), dict) else {}
                text = json.dumps(found | change | inner)
            del group["findings"]
            group["findings"] = text
            sign(h5)
        with pytest.raises(OSError, match="is damaged"):
            read_crash_report(file)


LANGEVIN = {"method": md.LangevinBAOAB, "temperature": 1.44, "friction": 1.0, "seed": 2}
FAILING = {"langevin": lambda: melt(BIG_STEP, **LANGEVIN), "rigid and fixed": rigid_with_one_fixed, "bonds": chain}


@pytest.mark.parametrize("make", FAILING.values(), ids=FAILING)
def test_findings_come_back_and_a_replay_fails_again_at_the_same_step_on_the_same_path(tmp_path, make):
    simulation = make()
    error = failing(simulation, trajectory=tmp_path / "a.h5md")
    found, seen = error.crash_report, md.replay(error.file, simulation.potentials)
    past = read_crash_report(error.file)
    assert (past.findings, str(past.findings)) == (found, str(found))
    assert (past.method.name, past.method.parameters) == (simulation.method.name, simulation.method.parameters)
    assert len(past.system.constraints) == len(simulation.constraints)
    assert seen.failed_at == found.step
    assert "failed again" in str(seen)
    assert [row.step for row in seen.rows] == list(range(found.first_step, found.last_good_step + 1))
    assert seen.rows[-1].energy == pytest.approx(read_file(error.file).record.total_energy[-1], rel=1e-6)
    assert (seen.trajectory, seen.picture) == (tmp_path / "a.replay.h5md", tmp_path / "a.replay.png")
    assert read_file(seen.trajectory).n_frames == len(seen.rows)
    assert seen.picture.read_bytes().startswith(b"\x89PNG")
    with pytest.raises(FileExistsError, match="replace it"):
        md.replay(error.file, simulation.potentials)


def test_replay_says_when_it_does_not_fail_again_and_what_it_does_not_know(crash_file, tmp_path):
    seen = md.replay(crash_file, md.HarmonicBond(1.0, 1.0), trajectory=False, picture=False)
    assert seen.failed_at is None
    assert "did not fail again" in str(seen)
    simulation = chain()
    simulation.method = type("Mine", (md.VelocityVerlet,), {"name": "mine"})(0.15)
    mine = failing(simulation, crash_report=tmp_path / "a.h5md").file
    assert_answered(lambda: md.replay(mine, simulation.potentials), ValueError, "'mine'")
    assert_answered(lambda: md.replay(crash_file), ValueError, "holds no scene")


def test_scene_that_blows_up_is_replayed_from_its_file_alone(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    Path("melt.toml").write_text(melt_scene(3, 4000).replace("timestep = 0.004", "timestep = 0.03"))
    assert cli.main(["run", "melt.toml", "--quiet"]) == 3
    assert "Crash report in melt.crash.h5md" in capsys.readouterr().err
    Path("melt.toml").unlink()
    assert cli.main(["replay", "melt.crash.h5md"]) == 0
    assert "failed again" in capsys.readouterr().out
    assert cli.main(["replay", "melt.crash.h5md", "--out", "other.h5md", "--quiet"]) == 0
    assert {"melt.replay.h5md", "melt.replay.png", "other.h5md"} <= {path.name for path in tmp_path.iterdir()}
    for file in ("melt.crash.h5md", "melt.h5md"):  # it was replayed; it holds no crash report
        assert cli.main(["replay", file]) == 2


def test_equilibration_of_a_scene_that_blows_up_leaves_its_crash_report(tmp_path, monkeypatch):
    """And is replayed with the same noise."""
    monkeypatch.chdir(tmp_path)
    bath = 'method = "langevin-baoab"\nrelaxation_time = 1.0\nseed = 3\n'
    scene = melt_scene(3, 10, f"{bath}[equilibration]\nsteps = 2000\nrescale_every = 10\n")
    Path("melt.toml").write_text(scene.replace("timestep = 0.004", "timestep = 0.04"))
    assert cli.main(["run", "melt.toml", "--quiet"]) == 3
    past, seen = read_crash_report("melt.crash.h5md"), md.replay("melt.crash.h5md")
    assert past.noise_shift < 0
    assert seen.failed_at == past.findings.step
    energy = read_file("melt.crash.h5md").record.total_energy[-1]
    assert seen.rows[-1].energy == pytest.approx(energy, rel=1e-6)
