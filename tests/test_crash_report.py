"""A run that blows up says why, leaves a file, and can be seen failing again."""

import json
import shutil
from pathlib import Path

import h5py
import numpy as np
import pytest
from references import liquid, melt_scene
from test_rigid_runs import simulation as rigid_liquid

import minimd as md
from minimd.commands import main as cli
from minimd.diagnosis.crash_report import examine
from minimd.files.crash_file import read_crash_report
from minimd.files.h5md_digest import sign
from minimd.files.h5md_reader import read_file
from minimd.forces.contacts import contacts
from minimd.neighbors.queries import closest_pair
from minimd.potentials.term import PER_ATOM

LJ = md.LennardJones(1.0, 1.0, 2.5, "force-shifted")
BIG_STEP = 0.024  # at which a liquid lives for some hundred steps


def failing(simulation, n_steps=4000, **how):
    with pytest.raises((md.NonFiniteError, md.ConstraintError)) as caught:
        simulation.run(n_steps, **how)
    return caught.value


def chain(timestep, k=1000.0):
    """Ten beads on stiff springs."""
    n = np.arange(10)
    system = md.System(np.column_stack([n, 0 * n, 0 * n]), cell=20.0, bonds=np.column_stack([n[:-1], n[1:]]))
    lj = md.LennardJones(1.0, 1.0, 2.5, "switched", bonded_scale=(0, 1, 1))
    simulation = md.Simulation(system, [lj, md.HarmonicBond(k, 1.0)], md.VelocityVerlet(timestep))
    simulation.set_temperature(0.5, seed=1)
    return simulation


def hollow(r2, limit):
    """√(r² − limit): no number inside."""
    return (r2 - limit) ** 0.5, -1.0 / (r2 - limit) ** 0.5


def one_fast_atom():
    system = liquid(3, temperature=0.5)
    system.velocities[7] = [400.0, 0.0, 0.0]
    return md.Simulation(system, md.LennardJones(1.0, 1.0, 1.85, "switched"), md.VelocityVerlet(0.005))


def two_approaching(law):
    system = md.System([[0, 0, 0], [1.5, 0, 0]], velocities=[[1, 0, 0], [0, 0, 0]])
    return md.Simulation(system, law, md.VelocityVerlet(0.01))


CASES = {
    "overlap": (
        lambda: md.Simulation(md.System([[0, 0, 0], [0.55, 0, 0], [3, 3, 3]], cell=10.0), LJ, md.VelocityVerlet(0.005)),
        (0, 1),
        0,
    ),
    "bond": (lambda: chain(0.05), None, None),
    "pair": (
        lambda: md.Simulation(liquid(3), md.LennardJones(1.0, 1.0, 1.85, "switched"), md.VelocityVerlet(0.04)),
        None,
        None,
    ),
    "hot": (one_fast_atom, None, None),
    "constraint": (lambda: rigid_liquid(md.VelocityVerlet(0.08)), None, None),
    "law": (lambda: two_approaching(md.PairPotential(hollow, (1.0,), 3.0, "truncated")), (0, 1), None),
}


@pytest.mark.parametrize("kind", CASES)
def test_the_cause_is_told(kind):
    make, atoms, step = CASES[kind]
    error = failing(make())
    found = error.crash_report
    assert found.kind == kind
    assert f"Likely cause: {found.cause}" in str(error)
    assert "\n" not in found.cause
    assert found.advice in str(found)
    assert step is None or found.step == step
    if atoms:
        assert {found.pair.first, found.pair.second} == set(atoms)
    assert error.file is None


def test_a_step_that_drives_atoms_into_each_other_is_told_by_their_distance_then():
    """In a crystal at rest no pair is stiff: Δt·ω = 0.3 before the first step is not why it fails."""
    crystal = liquid(5, temperature=3.0, jitter=0.0)
    found = failing(md.Simulation(crystal, md.LennardJones(1.0, 1.0, 2.5), md.VelocityVerlet(0.06))).crash_report
    assert (found.kind, found.step) == ("pair", 1)
    moved = md.System(
        crystal.positions + 0.06 * crystal.velocities, cell=crystal.cell
    )  # forces of the crystal are zero
    (first, second, distance) = closest_pair(moved)
    assert {found.pair.first, found.pair.second} == {first, second}
    assert found.pair.distance == pytest.approx(distance, rel=1e-9)  # rounding
    assert found.pair.frequency * 0.06 > 2.0
    assert (
        f"step 1 drives atoms {found.pair.first} and {found.pair.second} into each other, {distance:.3g} σ apart"
        in found.cause
    )


@pytest.mark.parametrize(
    "term", [md.HarmonicBond(50.0, 1.0), md.HarmonicAngle(5.0, 2.0, [[0, 1, 2]]), LJ], ids=["bond", "angle", "pair law"]
)
def test_bonded_atoms_at_one_place_are_the_cause(term):
    system = md.System([[0, 0, 0], [1, 0, 0], [1, 0, 0]], bonds=[[1, 2]])
    error = failing(md.Simulation(system, term, md.VelocityVerlet(0.01)))
    assert (
        error.crash_report.cause == "atoms 1 and 2 are at the same place, where the force between them is not defined"
    )
    assert error.crash_report.kind == "overlap"


def test_an_examination_sees_the_energy_of_each_atom(monkeypatch):
    """Of clusters too, whose totals are booked on one atom."""
    seen = []
    monkeypatch.setattr(
        "minimd.diagnosis.run_guard.examine",
        lambda engine, failure: seen.append(engine.interactions.energies.copy()) or examine(engine, failure),
    )
    simulation = md.Simulation(liquid(6), LJ, md.VelocityVerlet(0.1))
    assert simulation.engine.interactions.pair_search.startswith("cluster list")
    failing(simulation)
    assert seen[0] == pytest.approx(md.evaluate(simulation.system, LJ).energies, rel=1e-9)  # rounding


def test_figures_of_the_bond_are_those_of_the_oscillator():
    """ω = √(k/μ) of a harmonic bond, wherever it is; μ of two atoms of mass 1 is ½."""
    found = failing(chain(0.05)).crash_report
    assert found.pair.is_bond
    assert found.pair.frequency == pytest.approx(np.sqrt(1000.0 / 0.5), rel=1e-6)
    assert "Δt·ω = 2.24 (stable to 2)" in found.cause


def test_contact_knows_force_and_curvature_of_the_pair():
    system = md.System([[0, 0, 0], [0.9, 0, 0]], masses=[1.0, 3.0])
    (one,) = contacts(system, [md.LennardJones(2.0, 0.8)], 1.0 / system.masses, [0])
    u = [md.LennardJones(2.0, 0.8).pair_energy(0.9 + h) for h in (-1e-4, 0.0, 1e-4)]
    assert one.force == pytest.approx((u[0] - u[2]) / 2e-4, rel=1e-4)
    assert one.frequency == pytest.approx(np.sqrt((u[0] - 2 * u[1] + u[2]) / 1e-8 / 0.75), rel=1e-4)
    assert one.ratio == pytest.approx(0.9 / 0.8)
    assert one.rest_frequency == pytest.approx(np.sqrt(72 * 2.0 / (2 ** (1 / 3) * 0.64) / 0.75))


def test_contacts_see_images_and_exclusions():
    system = md.System([[0.1, 0, 0], [4.9, 0, 0], [2.5, 0, 0]], cell=5.0, bonds=[[0, 2]])
    potentials = [md.LennardJones(1.0, 1.0, 2.49, bonded_scale=(0, 1, 1)), md.HarmonicBond(1.0, 1.0)]
    found = contacts(system, potentials, np.ones(3), [0])
    assert {(one.first, one.second, one.is_bond) for one in found} == {(0, 1, False), (0, 2, True)}
    assert next(one for one in found if not one.is_bond).distance == pytest.approx(0.2)


def test_file_holds_the_last_good_state_and_loses_nothing(tmp_path):
    simulation = md.Simulation(liquid(3), md.LennardJones(1.0, 1.0, 1.85, "switched"), md.VelocityVerlet(BIG_STEP))
    error = failing(simulation, every=20, trajectory=tmp_path / "a.h5md")
    assert error.file == tmp_path / "a.crash.h5md"
    assert f"minimd replay {error.file}, or, in the browser, minimd view {error.file}" in str(error)
    contents = read_file(error.file)
    assert contents.step == simulation.step == error.crash_report.last_good_step
    assert np.array_equal(contents.system.positions, simulation.positions)
    assert np.array_equal(contents.system.velocities, simulation.velocities)
    assert contents.record.step.tolist() == [error.crash_report.first_step, simulation.step]
    assert 20 <= simulation.step - error.crash_report.first_step <= 120
    kept = read_file(tmp_path / "a.h5md")
    assert kept.record.step.tolist() == list(range(0, kept.step + 1, 20))
    assert kept.step == simulation.step


def test_no_file_where_none_was_asked_for(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    failing(chain(0.05))
    failing(chain(0.05), crash_report=False, trajectory="a.h5md")
    assert [path.name for path in tmp_path.iterdir()] == ["a.h5md"]
    assert failing(chain(0.05), crash_report="why.h5md").file == Path("why.h5md")
    assert read_crash_report("why.h5md").findings.kind == "bond"


def test_an_older_crash_report_is_not_lost(tmp_path):
    files = [
        failing(chain(0.05), trajectory=tmp_path / f"{k}.xyz", crash_report=tmp_path / "a.crash.h5md").file.name
        for k in range(3)
    ]
    assert files == ["a.crash.h5md", "a-2.crash.h5md", "a-3.crash.h5md"]


def test_an_crash_report_that_cannot_be_written_does_not_hide_the_failure(tmp_path):
    error = failing(chain(0.05), crash_report=tmp_path / "nowhere" / "a.h5md")
    assert "Likely cause" in str(error)
    assert "No crash report was written" in str(error)
    assert error.file is None


def test_a_term_that_cannot_be_examined_does_not_hide_the_failure(tmp_path):
    class Reluctant:
        def bind(self, _system):
            return self

        def add(self, _system, detail, _forces, _energies, _virials):
            if detail == PER_ATOM:
                raise NotImplementedError("totals only")

        def skipped(self):
            return ()

    simulation = md.Simulation(
        liquid(3), [md.LennardJones(1.0, 1.0, 1.85, "switched"), Reluctant()], md.VelocityVerlet(0.04)
    )
    error = failing(simulation, crash_report=tmp_path / "a.h5md")
    assert "The system holds the last good state" in str(error)
    assert error.crash_report is None


def test_an_crash_report_does_not_replace_the_trajectory(tmp_path):
    with pytest.raises(ValueError, match="is a trajectory of the run"):
        chain(0.05).run(10, trajectory=tmp_path / "a.h5md", crash_report=tmp_path / "a.h5md", overwrite=True)
    assert list(tmp_path.iterdir()) == []


def test_replay_says_which_method_it_does_not_know(tmp_path):
    simulation = chain(0.05)
    simulation.method = type("Mine", (md.VelocityVerlet,), {"name": "mine"})(0.05)
    error = failing(simulation, crash_report=tmp_path / "a.h5md")
    with pytest.raises(ValueError, match="the method 'mine', which minimd does not have"):
        md.replay(error.file, simulation.potentials)


def test_findings_come_back_from_the_file(tmp_path):
    error = failing(rigid_liquid(md.VelocityVerlet(0.08)), crash_report=tmp_path / "a.h5md")
    past = read_crash_report(error.file)
    assert past.findings == error.crash_report
    assert str(past.findings) == str(error.crash_report)
    assert past.method.name == "velocity-verlet"
    assert past.method.parameters == {"timestep": 0.08}
    assert past.system.constraints[0].pairs.shape == (108, 2)
    with pytest.raises(ValueError, match=r"holds no scene .*LennardJones"):
        md.replay(error.file)


@pytest.fixture(scope="module")
def crash_file(tmp_path_factory):
    return failing(chain(0.05), crash_report=tmp_path_factory.mktemp("crash") / "a.h5md").file


def other(name, value, part=None):
    """What changes a value of the findings, or of their pair."""
    return lambda found: json.dumps(found | ({name: value} if part is None else {part: found[part] | {name: value}}))


ALTERED = [  # findings
    lambda _: "{}",
    lambda _: "null",
    lambda _: "[" * 100_000,
    other("first", 99_999_999_999, "pair"),
    other("second", -77, "pair"),
    other("law", 3, "pair"),
    other("closest", {}),
    other("fault", None),
    other("pair", "x"),
    other("closest", [0, 10, 1.0]),
    other("closest", [0, 1, "x"]),
    other("fastest", 10),
    other("timestep", None),
    other("largest_force", 10**400),
]


@pytest.mark.parametrize("change", ALTERED)
def test_altered_findings_are_refused(change, crash_file, tmp_path):
    file = shutil.copy(crash_file, tmp_path)
    assert read_crash_report(file).findings.pair is not None
    with h5py.File(file, "r+") as h5:
        group = h5["minimd/crash_report"]
        found = json.loads(group["findings"].asstr()[()])
        del group["findings"]
        group["findings"] = change(found)
        sign(h5)
    with pytest.raises(OSError, match="is damaged"):
        read_crash_report(file)


@pytest.mark.parametrize(
    "make",
    [
        lambda: md.Simulation(liquid(3), md.LennardJones(1.0, 1.0, 1.85, "switched"), md.VelocityVerlet(BIG_STEP)),
        lambda: md.Simulation(
            liquid(3), md.LennardJones(1.0, 1.0, 1.85, "switched"), md.LangevinBAOAB(BIG_STEP, 1.44, 1.0, seed=2)
        ),
        lambda: rigid_liquid(
            md.VelocityVerlet(0.05), [md.DistanceConstraints(np.arange(216).reshape(-1, 2)), md.FixedAtoms([0])]
        ),
        lambda: chain(0.05),
    ],
    ids=["verlet", "langevin", "rigid and fixed", "bonds"],
)
def test_replay_fails_again_at_the_same_step_on_the_same_path(tmp_path, make):
    simulation = make()
    error = failing(simulation, trajectory=tmp_path / "a.h5md")
    seen = md.replay(error.file, simulation.potentials)
    assert seen.failed_at == error.crash_report.step
    assert "failed again" in str(seen)
    assert [row.step for row in seen.rows] == list(
        range(error.crash_report.first_step, error.crash_report.last_good_step + 1)
    )
    assert seen.rows[-1].energy == pytest.approx(read_file(error.file).record.total_energy[-1], rel=1e-6)
    assert (seen.trajectory, seen.picture) == (tmp_path / "a.replay.h5md", tmp_path / "a.replay.png")
    assert read_file(seen.trajectory).n_frames == len(seen.rows)
    assert seen.picture.read_bytes().startswith(b"\x89PNG")
    with pytest.raises(FileExistsError, match="replace it"):
        md.replay(error.file, simulation.potentials)


def test_replay_of_a_start_that_was_refused(tmp_path):
    make, _, _ = CASES["overlap"]
    error = failing(make(), trajectory=tmp_path / "a.h5md")
    seen = md.replay(error.file, LJ)
    assert [row.step for row in seen.rows] == [0]
    assert (seen.rows[0].first, seen.rows[0].second) == (0, 1)
    assert seen.trajectory is None


def test_replay_says_when_it_does_not_fail_again(tmp_path):
    error = failing(chain(0.05), trajectory=tmp_path / "a.h5md")
    seen = md.replay(error.file, md.HarmonicBond(1.0, 1.0))
    assert seen.failed_at is None
    assert "did not fail again" in str(seen)


def test_scene_that_blows_up_is_replayed_from_its_file_alone(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    Path("melt.toml").write_text(melt_scene(3, 4000).replace("timestep = 0.004", "timestep = 0.03"))
    assert cli.main(["run", "melt.toml", "--quiet"]) == 3
    assert "Crash report in melt.crash.h5md" in capsys.readouterr().err
    Path("melt.toml").unlink()
    assert cli.main(["replay", "melt.crash.h5md"]) == 0
    told = capsys.readouterr().out
    assert "failed again" in told
    assert "cause " in told
    assert Path("melt.replay.h5md").exists()
    assert Path("melt.replay.png").exists()
    assert cli.main(["replay", "melt.crash.h5md"]) == 2
    assert cli.main(["replay", "melt.crash.h5md", "--out", "other.h5md", "--quiet"]) == 0
    assert cli.main(["replay", "melt.h5md"]) == 2
    assert "holds no crash report" in capsys.readouterr().err


def test_equilibration_of_a_scene_that_blows_up_leaves_its_crash_report(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    scene = melt_scene(
        3,
        10,
        'method = "langevin-baoab"\nrelaxation_time = 1.0\nseed = 3\n[equilibration]\nsteps = 2000\nrescale_every = 10\n',
    )
    Path("melt.toml").write_text(scene.replace("timestep = 0.004", "timestep = 0.04"))
    assert cli.main(["run", "melt.toml", "--quiet"]) == 3
    past = read_crash_report("melt.crash.h5md")
    assert past.noise_shift < 0
    seen = md.replay("melt.crash.h5md")
    assert seen.failed_at == past.findings.step
    assert len(seen.rows) > 1
    assert seen.rows[-1].energy == pytest.approx(
        read_file("melt.crash.h5md").record.total_energy[-1], rel=1e-6
    )  # with the same noise
