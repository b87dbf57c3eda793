"""Runs that fail, and runs that are watched: the step is found, a good state is kept, and the cause is told."""

import json
import re
import shutil
from pathlib import Path

import ase.build
import h5py
import numpy as np
import pytest
from ase import units
from ase.calculators.emt import EMT
from ase.calculators.lj import LennardJones
from ase.md.velocitydistribution import thermalize_momenta
from charged_scenes import ions, run_of
from references import melt_scene
from scenes import LJ, SCENES
from wrong_calls import assert_answered

import minimd as md
from minimd.ase import Calculator, ForcesFromCalculator, VelocityVerlet
from minimd.core.diagnosis.contacts import contacts
from minimd.core.diagnosis.crash_report import examine
from minimd.core.diagnosis.run_guard import BLOCK
from minimd.core.files.crash_file import read_crash_report
from minimd.core.files.h5md_digest import sign
from minimd.core.files.h5md_reader import read_file

BIG_STEP = 0.024  # at which a liquid lives for some hundred steps
BATH = 'method = "langevin-baoab"\nrelaxation_time = 1.0\nseed = 3\n[equilibration]\nsteps = 2000\nrescale_every = 10\n'
ALTERED = [  # findings: as a text, or values to be changed, of the pair in the last two
    "null", "[" * 100_000, {"closest": {}}, {"fault": None}, {"closest": [0, 12, 1.0]}, {"timestep": None},
    {"largest_force": 10**400}, {"pair": {"first": 99_999_999_999}}, {"pair": {"law": 3}},
]  # fmt: skip


def failing(run, *arguments, **how):
    if isinstance(run, md.Simulation):
        run, arguments = run.run, (4000,)
    with pytest.raises((md.NonFiniteError, md.ConstraintError)) as caught:
        run(*arguments, **how)
    return caught.value


def melt(timestep, method=md.VelocityVerlet, **options):
    return SCENES["argon"]().simulation(method(timestep, **options))


def chain():
    return SCENES["chain"]().simulation(md.VelocityVerlet(0.15))


def rigid_with_one_fixed():
    scene = SCENES["dumbbells"]()
    return scene._replace(constraints=[*scene.constraints, md.FixedAtoms([2])]).simulation(md.VelocityVerlet(0.08))


def heated_on_a_grid():  # which is not the one that would be chosen for its last state
    simulation = SCENES["argon"]().simulation(md.VelocityVerlet(0.004), precision="fixed-point")
    simulation.velocities[:] *= 4.0
    simulation.method = md.VelocityVerlet(0.02)
    return simulation


def of_two(law, second, timestep, velocities=0.0, constraints=None):
    system = md.System([[0.0, 0, 0], [second, 0, 0]], velocities=np.full((2, 3), velocities))
    return md.Simulation(system, law, md.VelocityVerlet(timestep), constraints)


def one_fast_atom():
    simulation = melt(0.005)
    simulation.velocities[7] = [400.0, 0.0, 0.0]
    return simulation


# no number where r² is below the limit
HOLLOW = md.PairPotential(lambda r2, a: ((r2 - a) ** 0.5, -1.0 / (r2 - a) ** 0.5), (1.0,), 3.0, "truncated")
APPROACHING, FAST = [[1.0, 0, 0], [0.0, 0, 0]], [9e74, 0, 0]
SPRING = md.HarmonicBond(1e-3, 1.0, pairs=[[0, 1]])
CASES = [  # scene, kind of the cause, what is said
    (lambda: of_two(LJ, 0.55, 0.005), "overlap", "Likely cause: .*atoms 0 and 1.*\nAt step 0"),
    (lambda: melt(0.004), "overlap", "Likely cause: atoms 0 and 1 overlap at step 20"),
    (chain, "bond", r"Δt·ω = \d\.\d+ .* together.* 2, which is .* alone is "), (lambda: melt(0.04), "pair", "atoms"),
    (one_fast_atom, "hot", "atom 7"), (rigid_with_one_fixed, "constraint", "atoms"),
    (lambda: of_two(HOLLOW, 1.5, 0.01, APPROACHING), "law", "atoms 0 and 1"),
    (lambda: of_two(md.LennardJones(1, 1), 0.02, 0.004, constraints=md.DistanceConstraints([[0, 1]])), "law", "holds"),
    # beyond all numbers in use: positions are still finite, but no System can hold them
    (lambda: of_two(SPRING, 1.0, 10.0, FAST), "pair", r"\nAt step 1: positions of 2 .* 1e\+75"),
]  # fmt: skip


def push_together(run):
    if run.step == 20:
        run.positions[1] = run.positions[0] + [0.3, 0.0, 0.0]


@pytest.mark.parametrize(("make", "kind", "words"), CASES)
def test_the_cause_is_told(make, kind, words):
    """Also of an overlap that is made during the run, and of atoms that are flung beyond all numbers in use."""
    error = failing(make().run, 4000, observers=[push_together] if "step 20" in words else [], every=10)
    found = error.crash_report
    assert (found.kind, error.file) == (kind, None)
    assert re.search(words, str(error))
    assert f"Likely cause: {found.cause}" in str(error)


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


def test_file_holds_the_last_good_state_and_loses_nothing(tmp_path, monkeypatch):
    """And the energies of all atoms are examined, of clusters too, whose totals are booked on one atom."""
    seen, simulation = [], melt(BIG_STEP)

    def noted(engine, failure):
        seen.append(engine.sums.energies.copy())
        return examine(engine, failure)

    monkeypatch.setattr("minimd.core.diagnosis.run_guard.examine", noted)
    error = failing(simulation, every=20, trajectory=tmp_path / "a.h5md")
    assert seen[0] == pytest.approx(md.evaluate(simulation.system, LJ).energies, rel=1e-9)  # rounding
    assert error.file == tmp_path / "a.crash.h5md"
    assert "minimd.replay(file, potentials)" in str(error)
    contents, kept = read_file(error.file), read_file(tmp_path / "a.h5md")
    assert contents.step == simulation.step == error.crash_report.last_good_step
    for name in ("positions", "velocities"):
        assert np.array_equal(getattr(contents.system, name), getattr(simulation, name))
    assert contents.record.step.tolist() == [error.crash_report.first_step, simulation.step]
    assert 20 <= simulation.step - error.crash_report.first_step <= 120
    assert (kept.step, kept.record.step.tolist()) == (simulation.step, list(range(0, kept.step + 1, 20)))


def test_files_are_written_where_they_were_asked_for_and_replace_nothing(here):
    failing(chain())
    failing(chain(), crash_report=False, trajectory="a.h5md")
    assert [path.name for path in here.iterdir()] == ["a.h5md"]
    for name in ("why.h5md", "why-2.h5md", "why-3.h5md"):
        assert failing(chain(), crash_report="why.h5md").file == Path(name)
    with pytest.raises(ValueError, match="is a trajectory of the run"):
        chain().run(10, trajectory="a.h5md", crash_report="a.h5md", overwrite=True)
    error = failing(chain(), crash_report=here / "nowhere" / "a.h5md")  # that does not hide the failure
    assert (error.file, "No crash report was written" in str(error)) == (None, True)


@pytest.fixture(scope="module")
def crash_file(tmp_path_factory):
    return failing(chain(), crash_report=tmp_path_factory.mktemp("crash") / "a.h5md").file


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
        assert_answered(lambda: read_crash_report(file), OSError, "is damaged")


LANGEVIN = {"method": md.LangevinBAOAB, "temperature": 1.44, "friction": 1.0, "seed": 2}
FAILING = {  # positions last, too: energies that a method has not evaluated at its last positions are
    "langevin": lambda: melt(BIG_STEP, **LANGEVIN), "rigid and fixed": rigid_with_one_fixed,
    "bonds": chain, "positions last": lambda: melt(0.03, md.PositionVerlet),
    "ions": lambda: run_of(ions(), 40.0), "on a grid": heated_on_a_grid,
}  # fmt: skip


@pytest.mark.parametrize("make", FAILING.values(), ids=FAILING)
def test_findings_come_back_and_a_replay_fails_again_at_the_same_step_on_the_same_path(tmp_path, make):
    simulation = make()
    error = failing(simulation, trajectory=tmp_path / "a.h5md")
    found, seen = error.crash_report, md.replay(error.file, simulation.potentials, picture=make is chain)
    past = read_crash_report(error.file)
    assert (past.findings, str(past.findings)) == (found, str(found))
    assert (past.run.method, past.run.parameters) == (simulation.method.name, simulation.method.parameters)
    assert past.run.system.charges.tolist() == simulation.system.charges.tolist()
    assert (len(past.run.system.constraints), seen.failed_at) == (len(simulation.constraints), found.step)
    assert [row.step for row in seen.rows] == list(range(found.first_step, found.last_good_step + 1))
    assert seen.rows[-1].energy == pytest.approx(read_file(error.file).record.total_energy[-1], rel=1e-6)
    replayed = read_file(seen.trajectory)
    assert (seen.trajectory, replayed.n_frames) == (tmp_path / "a.replay.h5md", len(seen.rows))
    assert replayed.restart.grid == past.run.restart.grid
    assert make is not chain or (tmp_path / "a.replay.png").read_bytes().startswith(b"\x89PNG")
    other = tmp_path / "a.replay.h5md"  # replaced unless it is named
    assert_answered(
        lambda: md.replay(error.file, simulation.potentials, trajectory=other), FileExistsError, "overwrite"
    )


def test_replay_says_when_it_does_not_fail_again_and_what_it_does_not_know(crash_file, tmp_path):
    seen = md.replay(crash_file, md.HarmonicBond(1.0, 1.0), trajectory=False, picture=False)
    assert (seen.failed_at, "did not fail again" in str(seen)) == (None, True)
    simulation = chain()
    simulation.method = type("Mine", (md.VelocityVerlet,), {"name": "mine"})(0.15)
    mine = failing(simulation, crash_report=tmp_path / "a.h5md").file
    assert_answered(lambda: md.replay(mine, simulation.potentials), ValueError, "'mine'")
    assert_answered(lambda: md.replay(crash_file), ValueError, "holds no scene")


@pytest.mark.filterwarnings("ignore:timestep")
@pytest.mark.parametrize("more", [pytest.param("", marks=pytest.mark.slow), BATH], ids=["run", "equilibration"])
def test_scene_that_blows_up_is_replayed_from_its_file_alone_with_the_same_noise(more, told, here):
    Path("melt.toml").write_text(melt_scene(3, 4000, more).replace("timestep = 0.004", "timestep = 0.04"))
    assert "Crash report in melt.crash.h5md" in told("run", "melt.toml", "--quiet", code=3)
    Path("melt.toml").unlink()
    assert "failed again" in told("replay", "melt.crash.h5md", "--out", "other.h5md")
    assert (read_crash_report("melt.crash.h5md").noise_shift < 0) == bool(more)
    assert Path("other.h5md").exists()
    told("replay", "melt.h5md" if Path("melt.h5md").exists() else "other.h5md", code=2)  # no crash report


def test_what_is_no_count_or_no_end_is_refused_and_no_steps_are_none(tmp_path):
    sim, file = SCENES["argon"]().simulation(), tmp_path / "a.h5md"
    record, before = sim.run(0, trajectory=file), sim.positions.copy()
    assert_answered(lambda: sim.run(10, trajectory=file), FileExistsError)
    for count in (True, 2.0, -1, "3"):
        assert_answered(lambda count=count: sim.run(count), ValueError, "n_steps", repr(count))
        assert_answered(lambda count=count: sim.run(until_step=count), ValueError, "until_step", repr(count))
    for both in ({}, {"n_steps": 5, "until_step": 5}):
        assert_answered(lambda both=both: sim.run(**both), ValueError, "n_steps", "until_step")
    assert sim.record is record
    assert (len(sim.run(np.int64(0))), sim.step) == (1, 0)
    assert np.array_equal(sim.positions, before)
    sim.run(10)
    assert_answered(lambda: sim.run(until_step=7), ValueError, "until_step", "7", "step 10")
    assert (len(sim.run(until_step=10)), sim.step) == (1, 10)


def copper(calculator=None):
    atoms = ase.build.bulk("Cu", cubic=True).repeat(2)
    atoms.calc = EMT() if calculator is None else calculator
    thermalize_momenta(atoms, 300, rng=np.random.default_rng(1))
    return atoms


def nitrogen(timestep):
    system = md.System([[0, 0, 0], [1.12, 0, 0]], masses=14.0, bonds=[[0, 1]], units=md.units.ASE, cell=20.0)
    return md.Simulation(system, md.HarmonicBond(100.0, 1.1), md.VelocityVerlet(timestep * units.fs))


@pytest.mark.filterwarnings("ignore:the calculator is EMT", "ignore:timestep")
@pytest.mark.slow
def test_a_calculator_of_others_fails_at_its_step_for_its_cause():
    """ASE alone has 11.5 eV after the first step and 2.4e5 eV after the second."""
    atoms = copper()
    start, run = atoms.get_total_energy(), VelocityVerlet(atoms, 60.0 * units.fs)  # the limit is 41 fs
    found = failing(run.run, 300).crash_report
    assert run.nsteps == found.last_good_step == found.step - 1 <= 2
    assert abs(atoms.get_total_energy() - start) < 5.0  # one kinetic energy
    assert (found.kind, "as advise_timestep recommends" in found.advice) == ("step", True)
    assert f"timestep 60 fs too large: {run.method().name} is stable up to " in found.cause
    limit = md.advise_timestep(atoms, ForcesFromCalculator(EMT())).limit
    assert f"up to {md.units.ASE.shown(limit)[:2]}" in found.cause


@pytest.mark.filterwarnings("ignore:the calculator is EMT")
def test_what_others_do_between_two_steps_is_no_runaway():
    """Atoms that are pushed, a calculator that is another from now on, a run of its own; a heat that was asked for."""
    atoms = copper(LennardJones(sigma=2.3, epsilon=1e-6, rc=5.0))
    atoms.set_momenta(1e-3 * atoms.get_momenta())
    run = VelocityVerlet(atoms, 1.0 * units.fs)
    run.attach(lambda: setattr(atoms, "calc", EMT()) if run.nsteps >= 4 else None, 2)
    run.attach(lambda: atoms.set_momenta(1e3 * atoms.get_momenta()), -8)
    run.run(12)
    atoms.set_momenta(1e3 * atoms.get_momenta())
    run.run(2)
    assert run.nsteps == 14
    simulation = nitrogen(1.0)
    simulation.run(10)
    simulation.set_temperature(3e8, seed=1)
    simulation.make_steps(2 * BLOCK)
    assert simulation.step == 10 + 2 * BLOCK


@pytest.mark.filterwarnings("ignore:timestep")
def test_a_bond_beyond_its_limit_fails_at_once_with_the_advice_of_advise_timestep(tmp_path):
    warm, simulation, law = nitrogen(8.0), nitrogen(8.0), md.HarmonicBond(100.0, 1.1, pairs=[[0, 1]])
    warm.set_temperature(300, seed=1)
    assert failing(warm.equilibrate, 300, 300.0, every=50).crash_report.step == warm.step + 1 < 5
    atoms = ase.Atoms("N2", simulation.positions, cell=[20] * 3, pbc=True, calculator=Calculator(law))
    of_ase = failing(VelocityVerlet(atoms, 8.0 * units.fs).run, 300)
    error = failing(simulation.run, 300, crash_report=tmp_path / "a.crash.h5md")
    seen = md.replay(error.file, simulation.potentials, picture=False)  # fails where the run did
    assert (seen.failed_at, [row.step for row in seen.rows]) == (1, [0])
    assert [atoms.get_total_energy(), simulation.frame().observables["total_energy"]] == pytest.approx([0.02] * 2)
    for found, system in ((of_ase.crash_report, atoms), (error.crash_report, simulation.system)):
        recommended = md.advise_timestep(system, law).recommended
        assert (found.step, found.last_good_step) == (1, 0)
        assert f"take {md.units.ASE.shown(recommended)}, as advise_timestep recommends" in found.advice


@pytest.mark.filterwarnings("ignore:timestep")
def test_a_mode_that_grows_slowly_is_followed_back_to_a_good_state_and_replayed_in_units(tmp_path):
    """Δt·ω = 2.0004: energies grow by some 8 % in a step, and raise the alarm two blocks after the last good state."""
    simulation = nitrogen(1.0)
    simulation.method = md.VelocityVerlet(2.0004 / (100.0 / 7.0) ** 0.5)
    error = failing(simulation.run, 3000, every=1000, crash_report=tmp_path / "a.crash.h5md")
    assert error.crash_report.step == simulation.step + 1
    assert simulation.frame().observables["total_energy"] < 0.06  # twice K + |U| of the start, and a step
    seen = md.replay(error.file, simulation.potentials, picture=False, trajectory=False)
    assert seen.failed_at == error.crash_report.step
    lines = str(seen).splitlines()
    last = next(line for line in lines if line.startswith(f"{simulation.step:>8}"))
    assert lines[1].split() == ["ps", "eV", "Å", "eV/Å", "Å/ps"]
    assert float(last.split()[1]) == pytest.approx(simulation.time / md.units.ps, rel=1e-4)
