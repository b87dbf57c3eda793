"""The report of a run and of its file: what is conserved, its shadow too, how sure that is, and what it says beside."""

import re
import warnings
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from argon_atoms import CUTOFF, EPSILON, SIGMA, TIMESTEP, argon as of_ase
from charged_scenes import EDGE, LAWS, ions, run_of
from h5md_runs import record_of, simulation
from references import liquid, melt_scene, processes
from scenes import LJ, SCENES
from wrong_calls import answered

import minimd as md
from minimd.commands import main as cli
from minimd.core.diagnosis.report import DriftRate, conservation_report, drift, drift_of_walk
from minimd.core.diagnosis.run_report import cutoff_lines, pressure_lines
from minimd.core.engine.record import SERIES, Record
from minimd.core.files.h5md_reader import read_file
from minimd.integrators import SPLITTINGS
from minimd.mdanalysis import universe
from minimd.view.check import check_file

VERLET = md.VelocityVerlet(0.002)
N_SERIES = 400
JUMPS = [  # 4 (2.5⁻¹² − 2.5⁻⁶) ε = −0.0163 ε
    ("truncated", 0.0163169, 0.0389995, False), ("shifted", 0.0, 0.0389995, True),
    ("force-shifted", 0.0, 0.0, True), ("smooth", 0.0, 0.0, True),
]  # fmt: skip
OTHERS = [pytest.param(name, marks=pytest.mark.slow) for name in ("position-verlet", "leapfrog")]
VERLETS = pytest.mark.parametrize("name", ["velocity-verlet", *OTHERS])
SMOOTH = md.LennardJones(1.0, 1.0, 1.85, "smooth")


def liquid_run(n_steps, *observers, method=VERLET):
    simulation = SCENES["argon"]().simulation(method)
    simulation.run(n_steps, every=10, observers=list(observers))
    return simulation


@pytest.fixture(scope="module")
def conserved():
    return liquid_run(1000)


def test_the_speed_is_in_millions_of_atom_steps_of_each_second_of_the_steps(conserved):
    seconds = conserved.guard.seconds  # of wall time, without compilation and observations
    (speed,) = re.findall(r"^speed +(\S+) Matom-steps/s;", str(conserved.report()), re.M)
    assert float(speed) == pytest.approx(1e-6 * len(conserved.system) * 1000 / seconds, rel=1e-3)  # as printed
    assert "steps/s" not in str(conserved.report()).replace("Matom-steps/s", "")  # one number


def test_the_report_tells_conserved_from_not(conserved):
    scaled = lambda factor: lambda run: np.multiply(run.velocities, factor, out=run.velocities)  # noqa: E731
    good, runs = conserved.report(), ((1000, 0.99), (2000, 1.0 + 1e-5))
    bad, slight = (liquid_run(n, scaled(factor)).report() for n, factor in runs)
    assert good.energy_is_conserved is good.momentum_is_conserved is True
    assert bad.energy_is_conserved is slight.energy_is_conserved is False
    assert 1e-4 < slight.energy_drift.slope < 1e-2  # 1e-3 ε per atom per τ is a drift, however long the run
    wind = lambda run: np.add(run.velocities, [1e-6, 0.0, 0.0], out=run.velocities)  # noqa: E731
    assert not liquid_run(200, wind).report().momentum_is_conserved
    cluster = md.Simulation(md.System(liquid(2, jitter=0.0).positions - 1.0), LJ, VERLET)
    cluster.run(500, every=100)  # at rest as a whole: L = 0 is judged by its scale, and rounding is no change
    assert cluster.report().angular_momentum_change < 1e-12


def test_a_drift_of_many_errors_that_is_called_none_has_its_reason_beside_it(conserved):
    """3.9 errors known from few blocks; 40 errors of next to nothing. A drift within three errors needs no reason."""
    few, small = "in so short a run chance makes up to 4.3 of them", "below 1e-06 of the kinetic energy"
    for slope, error, n, reason in ((3.9, 1.0, 10.0, few), (4e-9, 1e-10, np.inf, small), (2.9, 1.0, 10.0, "")):
        report = replace(conserved.report(), energy_drift=DriftRate(slope, error, n), shadow_drift=DriftRate(0.0, 1.0))
        assert report.energy_is_conserved
        first, *others = str(report).splitlines()
        assert first.partition(" (")[2].startswith(f"standard error; {reason}" if reason else "standard error)")
        assert all(words not in line for line in others for words in (few, small))
    lost = str(replace(conserved.report(), energy_drift=DriftRate(5.0, 1.0, 10.0)))
    assert few not in lost
    assert "DRIFTS" in lost


@pytest.mark.parametrize(("truncation", "is_rough"), [("truncated", True), ("shifted", True), ("force-shifted", False)])
def test_only_what_jumps_is_to_be_smoothed(truncation, is_rough):
    system = SCENES["argon"]().simulation(VERLET).system
    sim = md.Simulation(system, md.LennardJones(1.0, 1.0, 2.5, truncation), VERLET)
    sim.run(100, every=10)
    steady = {"energy_range": 0.0, "temperatures": (1.0, 1.0)}
    drifting = replace(sim.report(), energy_drift=DriftRate(1.0, 0.01), **steady)
    assert drifting.energy_is_conserved is False
    assert ("smooth the cutoff" in drifting.verdict) is is_rough


def test_the_speed_is_in_nanoseconds_of_each_day_where_time_has_a_unit(conserved):
    assert "ns/day" not in str(conserved.report())
    law = md.LennardJones(EPSILON, SIGMA, CUTOFF)
    sim = md.Simulation(of_ase(), law, md.VelocityVerlet(TIMESTEP))
    sim.run(40, every=20)
    report = sim.report()
    days = report.cost.seconds / 86400.0
    (speed,) = re.findall(r"^speed .* ([0-9.]+) ns/day;", str(report), re.M)
    assert float(speed) == pytest.approx(40 * sim.method.timestep / md.units.fs * 1e-6 / days, rel=1e-3)  # as printed


def ramp(tmp_path):
    """A run in which the temperature of the bath goes from 0.5 to 1; the file has one frame since."""
    sim = simulation()
    sim.method = md.LangevinBAOAB(0.002, 0.5, friction=1.0, seed=1)
    sim.set_temperature(0.5, seed=1)
    heat = lambda sim: setattr(sim.method, "temperature", 0.5 + sim.step / 1000)  # noqa: E731
    sim.run(500, every=10, trajectory=tmp_path / "ramp.h5md", observers=[heat])
    return sim


class Wind(md.Term):
    """A force without a potential, which does work."""

    acts_from_outside = True
    is_checked = False

    def bind(self, system):
        return self

    def add(self, system, detail, forces, energies, virials):
        forces += 0.3 * system.velocities


@pytest.mark.parametrize("is_checked", [False, True])  # it has no energy to compare with
def test_the_work_of_a_force_without_a_potential_is_no_drift(is_checked):
    wind = Wind()
    wind.is_checked = is_checked
    sim = md.Simulation(liquid(3), [LJ, wind], VERLET)
    sim.set_temperature(0.5, seed=1)
    sim.run(500, every=10)
    report = sim.report()
    assert report.energy_drift.is_significant
    assert report.energy_is_conserved is None
    assert "the work of Wind is not counted" in report.verdict
    assert "reduce the time step" not in str(report)


def test_atoms_that_a_bath_leaves_at_rest_have_a_report():
    bath = md.StochasticVelocityRescaling(0.001, 1.0, 1.0, seed=1)
    sim = md.Simulation(md.System([[0.0, 0.0, 0.0], [10.0, 0.0, 0.0]]), LJ, bath)
    sim.run(100, every=10)
    assert "the atoms are at rest" in str(sim.report())
    assert "STANDARD ERRORS" not in str(sim.report())


def test_a_mean_temperature_that_is_not_that_of_the_bath_is_told():
    report = simulation_at(0.5).report()
    far = replace(report, mean_temperature=0.6, temperature_error=0.02)
    near = replace(far, temperature_error=0.05)
    assert "5 STANDARD ERRORS" in str(far)
    assert "STANDARD ERRORS" not in str(near) + str(replace(far, bath=(0.5, np.nan)))


def simulation_at(temperature):
    sim = simulation()
    sim.method = md.LangevinBAOAB(0.002, temperature, friction=1.0, seed=1)
    sim.run(100, every=10)
    return sim


def test_a_file_with_one_frame_since_its_bath_was_changed_is_checked(tmp_path):
    ramp(tmp_path)
    check = check_file(tmp_path / "ramp.h5md")
    assert all(one.passed for one in check.comparisons)
    assert not any("diffusion" in line for line in check.structure)


def test_a_change_of_the_bath_is_no_fault_of_the_run(tmp_path):
    told = ramp(tmp_path).report(), check_file(tmp_path / "ramp.h5md").report
    for report, words in zip(told, ("the temperature of the bath changed", "method, bath or state"), strict=True):
        assert report.energy_is_conserved is not False
        assert words in str(report)
    drifting = replace(told[0], energy_drift=DriftRate(1.0, 0.01), energy_range=told[0].kinetic_energy)
    assert drifting.energy_is_conserved is False
    assert "temperature of the bath changed" in drifting.verdict
    assert "equilibrate" not in drifting.verdict
    assert "K on average" not in str(told[0])
    assert "in the first fifth of the run" in str(told[0])
    steady = replace(drifting, energy_drift=DriftRate(3.9, 1.0, 10.0), energy_range=0.1 * drifting.kinetic_energy)
    assert (steady.energy_drift.is_significant, steady.energy_is_conserved) == (False, None)
    slight = replace(drifting, energy_range=1e-3 * drifting.kinetic_energy)
    assert slight.energy_is_conserved is None
    assert slight.is_quiet
    assert "whether it drifts cannot be told" in slight.verdict


@pytest.mark.parametrize(("length", "is_short"), [(5.0, True), (400.0, False)])
def test_a_mean_over_few_correlation_times_is_told_to_have_a_lower_bound_as_error(length, is_short):
    """Temperature, density and pressure of a run of this many correlation times."""
    series = 1.0 + 0.1 * processes(1, N_SERIES, np.exp(-length / N_SERIES), np.random.default_rng(2))[:, 0]
    record = record_of(np.full(N_SERIES, 2.0), temperature=series, volume=series, pressure=series)
    barostat = md.StochasticCellRescaling(1.0, compressibility=0.05, relaxation_time=0.5, seed=3)
    lines = tuple(pressure_lines(record, 1.0, barostat, False))
    text = str(conservation_report(record, angular=False, lines=lines))
    for name in ("temperature", "density", "pressure"):
        assert (f"correlation times of the {name} long: THE ERROR BARS ARE LOWER BOUNDS" in text) is is_short


def test_what_the_time_step_takes_from_the_temperature_is_explained_on_a_page(conserved):
    report = replace(conserved.report(), bath=(1.0, 0.5))
    (page,) = re.findall(r"docs/\S+\.md", str(report))
    assert "## Which temperature?" in (Path(__file__).parents[2] / page).read_text()


@pytest.mark.parametrize("value", [np.nan, np.inf])
@pytest.mark.parametrize("bath", [False, True], ids=["alone", "bath"])
def test_nothing_is_conserved_where_something_is_not_finite(conserved, value, bath):
    record = conserved.record
    known = {name: np.array(getattr(record, name))[:31] for name in ("step", "time", *SERIES) if name in record}
    known |= {"shadow_energy": known["total_energy"], "constraint_violation": np.zeros(31)}
    known |= {"conserved_energy": known["total_energy"]} if bath else {}

    def judged(series, angular=True):
        report = conservation_report(Record.of(md.units.LJ, 108, series), angular=angular)
        energies = report.energy_is_conserved, report.shadow_is_conserved
        return report.verdict, (*energies, report.momentum_is_conserved, report.angular_momentum_is_conserved)

    assert judged(known, angular=False)[1][:3] == (True, True, True)
    for frames in ([0], [17], [30], slice(None)):
        for name in known.keys() - {"step"}:
            series = known | {name: known[name].copy()}
            series[name][frames] = value
            verdict, found = judged(series)
            assert found == (False,) * 4
            assert verdict.startswith(f"NOTHING IS CONSERVED: {name.replace('_', ' ')} is not finite at step")
        energy = known["total_energy"].copy()
        energy[frames] = 1e308 * np.random.default_rng(1).random(len(energy[frames]))  # it overflows
        assert bath or judged(known | {"total_energy": energy})[1][0] is False


def test_atoms_at_rest_are_no_breach_of_momentum():
    tiny, still = np.full(5, 1e-28), {"momentum": 1e-14 * np.arange(15.0).reshape(5, 3)}
    still |= {"kinetic_energy": tiny, "temperature": tiny, "absolute_momentum": np.full(5, 1e-12)}
    report = conservation_report(record_of(np.full(5, -6.0), 4, **still), angular=False)
    assert report.momentum_is_conserved
    assert "the atoms are at rest: set_temperature" in report.verdict
    warm = record_of(np.full(5, -6.0), 4, **still | {"kinetic_energy": np.ones(5)})
    assert not conservation_report(warm, angular=False).momentum_is_conserved


def test_a_stable_oscillation_near_the_limit_is_no_drift():
    """Δt ω = 1.9 of 2: the energy oscillates for ever."""
    bond = md.System([[0.0, 0, 0], [1.3, 0, 0]], bonds=[(0, 1)])
    sim = md.Simulation(bond, md.HarmonicBond(0.5, 1.0), md.VelocityVerlet(1.9))
    sim.run(4000, every=1)
    report = sim.report()
    assert report.energy_is_conserved is False
    assert "VARIES BY" in report.verdict
    assert "DRIFT" not in report.verdict


def test_no_verdict_near_the_limit_of_the_bonds_leaves_the_time_step_out():
    """A chain with Δt at 0.97 of its limit, in short and long runs: whatever the energy does."""
    k = np.arange(20)
    places = np.column_stack([k, 0.05 * np.sin(k), 0 * k])
    chain = md.System(places, bonds=np.column_stack([k[:-1], k[1:]]))
    law = md.HarmonicBond(1000.0, 1.0)
    limit = md.advise_timestep(chain, law).limit
    verdicts = []
    for seed, n_steps, every in ((1, 2000, 20), (2, 2000, 20), (3, 4000, 20), (4, 200, 2), (5, 20, 10)):
        sim = md.Simulation(chain.copy(), law, md.VelocityVerlet(0.97 * limit))
        sim.set_temperature(0.01, seed=seed)
        sim.run(n_steps, every=every)
        verdicts.append(sim.report().verdict)
    assert [verdict for verdict in verdicts if "timestep 0.03" not in verdict] == []
    assert [verdict for verdict in verdicts if "as advise_timestep recommends" not in verdict] == []


@pytest.mark.slow
@pytest.mark.parametrize("is_rigid", [False, True])
def test_the_report_tells_what_the_time_step_takes_from_the_temperature(is_rigid):
    """Stiff bonds, Δt ω = 0.8: T (ωΔt)²/4 of the stretching. A rigid one does not stretch."""
    n, k = 200, 0.5 * (0.8 / 0.02) ** 2  # ω² = k (1/m + 1/m)
    first = np.random.default_rng(4).uniform(0.0, 40.0, (n, 3))
    pairs = np.column_stack([np.arange(n), n + np.arange(n)])
    system = md.System(np.concatenate([first, first + np.array([1.0, 0.0, 0.0])]), bonds=pairs)
    method = md.LangevinBAOAB(0.02, 2.0, friction=1.0, seed=2)
    sim = md.Simulation(system, md.HarmonicBond(k, 1.0), method, md.DistanceConstraints(pairs) if is_rigid else ())
    sim.set_temperature(2.0, seed=3)
    sim.run(500)
    sim.run(4000, every=5)
    report = sim.report()
    asked, deficit = report.bath
    assert asked == 2.0
    assert deficit == pytest.approx(0.0 if is_rigid else 2.0 * 0.8**2 / 4.0 / 6.0, rel=0.1, abs=1e-12)  # statistics
    assert abs(report.mean_temperature - (asked - deficit)) < 4.0 * report.temperature_error
    assert " 2 ε/k_B" in str(report)
    assert ("positions have what is asked" in str(report)) is not is_rigid
    method.temperature = 1.0
    sim.run(100, every=10, observers=[lambda sim: setattr(sim.method, "temperature", 1.0 + 0.01 * sim.step)])
    assert sim.report().bath[0] == method.temperature


def test_a_figure_says_how_sure_it_is():
    """± is a standard error; one frame has none; few are not judged; a run may be too short to tell."""
    records = (record_of(1.0 + 0.01 * np.random.default_rng(1).normal(size=n)) for n in (1, 3, 51))
    one, few, many = (conservation_report(record, angular=False) for record in records)
    assert [one.energy_is_conserved, few.energy_is_conserved] == [None, None]
    assert ["±" in str(report).splitlines()[0] for report in (one, few, many)] == [False, False, True]
    for size, quiet in ((0.001, "varies by 0.2 % of"), (0.1, "varies")):
        short = conservation_report(record_of(1.0 + size * np.sin(np.linspace(0.0, 5.0, 51))), angular=False)
        assert (short.energy_is_conserved, short.is_quiet) == (None, size == 0.001)
        assert re.search(f"energy {quiet}.* too short to tell whether it drifts", short.verdict)


@pytest.mark.parametrize(("correlation", "n", "most"), [(0.0, 51, 0.01), (0.8, 51, 0.03), (0.95, 501, 0.02)])
def test_few_correlated_series_seem_to_drift(correlation, n, most):
    """0.003 expected where the correlation is known; an error blind to it finds every third of 51 with 0.8 drifting."""
    rng, t = np.random.default_rng(3), np.arange(float(n))
    found = [drift(t, one) for one in processes(N_SERIES, n, correlation, rng).T]
    assert np.mean([one.is_significant for one in found]) <= most
    judged = np.array([one.slope / one.error for one in found if not one.is_too_short])
    assert 0.8 < np.sqrt(np.mean(judged**2)) < 1.6  # 1 expected


def test_a_drift_that_is_there_is_found():
    rng, t = np.random.default_rng(3), np.arange(51.0)
    assert all(drift(t, one + 0.3 * t).is_significant for one in processes(20, 51, 0.5, rng).T)
    found = drift(t, np.exp(0.01 * t)), drift(t, 2.0 * t), drift(t, np.ones(51)), DriftRate(0.0, 0.0)
    assert [one.is_significant for one in found] == [True, True, False, False]  # the first is smooth, and no line
    for slope in (drift, drift_of_walk):
        assert slope(t, np.where(t == 20.0, np.nan, 1.0)).is_significant


@pytest.mark.parametrize("noise", [0.0, 1.0, 5.0])
def test_the_error_of_a_walk_that_fluctuates_is_its_scatter(noise):
    """The energy without that of a bath wanders, and the error of the energy fluctuates. Few runs seem to drift."""
    rng, t = np.random.default_rng(3), np.arange(50.0)
    walks = [rng.normal(size=50).cumsum() + noise * rng.normal(size=50) for _ in range(N_SERIES)]
    found = [drift_of_walk(t, walk) for walk in walks]
    slopes, errors = np.array([(one.slope, one.error) for one in found]).T
    assert 0.85 < np.sqrt((errors**2).mean()) / slopes.std() < 1.3
    assert np.mean([one.is_significant for one in found]) < 0.03  # 0.003 if the error were known exactly
    assert all(drift_of_walk(t, walk + 10.0 * t).is_significant for walk in walks)


def test_slow_changes_that_the_energy_hides_are_seen_in_the_kinetic_energy():
    """Fast noise on top of a slow wave: by itself the series seems to drift."""
    rng, t = np.random.default_rng(3), np.arange(51.0)
    slow = np.sin(t / 30.0)
    series = [slow + 0.3 * rng.normal(size=51) for _ in range(20)]
    alone, beside = [drift(t, one) for one in series], [drift(t, one, beside=3.0 - slow) for one in series]
    assert np.mean([one.is_significant for one in alone]) > 0.3
    assert not any(one.is_significant for one in beside)
    assert all(b.error >= a.error for a, b in zip(alone, beside, strict=True))
    assert sum(one.is_too_short for one in beside) >= sum(one.is_significant for one in alone)


def test_jumps_at_the_cutoff_are_told_of_the_worst_pair_of_species_and_at_its_cutoff():
    """The wall of Weeks, Chandler and Andersen has none: shifted at 2^(1/6) σ, its force is zero to rounding."""
    jump = lambda law, system=liquid(2): next(iter(cutoff_lines(system, [law])))  # noqa: E731, B008
    for truncation, energy, force, is_good in JUMPS:
        line = jump(md.LennardJones(1.0, 1.0, 2.5, truncation))
        assert f"energy {energy:.1e} ε, force {force:.1e} ε/σ at 2.5 σ" in line.summary
        assert line.is_good == is_good
    assert jump(md.LennardJones(1.0, 1.0, 2 ** (1 / 6))).verdict == "energy and force are continuous"
    pair = md.System([[0, 0, 0], [1.2, 0, 0]], species=["A", "B"])
    own, cutoffs = {"A": (1.0, 1.0), "B": (0.5, 0.88)}, {("A", "A"): 2.5, ("A", "B"): 2.0, ("B", "B"): 2.2}
    mixture = md.LennardJones(own, cutoff=cutoffs, pairs={("A", "B"): (1.5, 0.8)}, truncation="truncated")
    assert jump(mixture, pair).summary.endswith("ε/σ at 2 σ")


def test_report_tells_of_list_cutoff_constraints_and_angular_momentum():
    rigid, droplet = SCENES["dumbbells"]().simulation(), SCENES["droplet"]().simulation(VERLET)
    rigid.run(50, every=10)
    text, stride = str(rigid.report()), np.linalg.norm(rigid.velocities, axis=1).max() * rigid.method.timestep
    told = "cutoff jump", "rigid bonds    velocities along them", ": obeyed", ": kept"
    assert [words for words in told if words not in text] == []
    assert f" {0.5 * rigid.skins[0] / stride:.3g} steps" in text
    droplet.run(200, every=20)
    assert droplet.report().angular_momentum_is_conserved
    torque = lambda sim: np.add.at(sim.velocities, ([0, -1], 1), [1e-6, -1e-6])  # noqa: E731
    droplet.run(200, every=20, observers=[torque])
    report = droplet.report()
    assert (report.momentum_is_conserved, report.angular_momentum_is_conserved) == (True, False)


def test_report_tells_of_the_sum_over_waves_and_a_net_charge_is_told_once():
    with warnings.catch_warnings(record=True, action="always") as told:
        sim = run_of(ions(net=0.4))
        sim.run(4, every=1)
        sim.system.cell = md.Cell.of(1.01 * EDGE)
        sim.run(4, every=1)
        text = str(sim.report())
    assert ["0.4 e" in str(one.message) for one in told if "net charge" in str(one.message)] == [True]
    bound, found = (
        LAWS[1].accuracy,
        re.search(r"sum over (\d+) waves \(error of forces at most (\S+) of their rms", text),
    )
    assert found
    assert int(found[1]) > 10
    assert float(found[2]) == pytest.approx(bound, rel=0.1)


def test_other_potentials_turned_cells_and_changed_time_steps_of_a_file_are_told(tmp_path):
    file, turned, made = tmp_path / "run.h5md", tmp_path / "turned.h5md", simulation()
    made.run(2, every=1, trajectory=file)
    with pytest.warns(UserWarning, match=r"LennardJones\(epsilon=1, .* before, .*LennardJones\(epsilon=3, .* now"):
        md.Simulation.resume(file, md.LennardJones(3.0, 1.0, 1.6, truncation="shifted"))
    with warnings.catch_warnings(action="error"):
        md.Simulation.resume(file, made.potentials)
    simulation("turned").run(2, every=1, trajectory=turned)
    with pytest.warns(UserWarning, match=r"the universe of .*turned\.h5md. is turned"):
        universe(turned).trajectory.close()
    made.method = md.VelocityVerlet(0.002)
    made.run(2, every=1, trajectory=file, append=True)
    with pytest.warns(UserWarning, match="because the time step changed"):
        universe(file).trajectory.close()


def argon(method=None):
    return SCENES["argon"]().simulation(method or md.VelocityVerlet(0.003))


def smooth(name="velocity-verlet", dt=0.003, jitter=0.05):
    simulation = md.Simulation(liquid(3, jitter=jitter), SMOOTH, SPLITTINGS[name](dt))
    simulation.extra_observables = ("shadow_energy",)
    return simulation


@VERLETS
def test_shadow_energy_minus_the_work_of_a_field_is_conserved_to_the_fourth_order(name):
    """Time is a coordinate then, and minus the work its momentum. E − W falls by 4 where Δt is halved, not by 16."""
    spreads, start = [], {"velocities": [[0.2, 0.1, 0], [-0.3, 0, 0.4]], "masses": (1.0, 2.5), "bonds": [[0, 1]]}
    for dt in (0.1, 0.05, 0.025):
        laws = [md.HarmonicBond(1.0, 1.0), md.SteeredSpring(2.0, [0.1, 0, 0], [0.3, 0.2, 0])]
        simulation = md.Simulation(md.System([[0.3, 0, 0], [1.5, 0.2, 0]], **start), laws, SPLITTINGS[name](dt))
        simulation.extra_observables = ("shadow_energy",)
        record = simulation.run(round(10.0 / dt), every=1)
        assert np.ptp(record.work) > 0.1
        spreads.append([np.ptp(series - record.work) for series in (record.total_energy, record.shadow_energy)])
    assert -np.diff(np.log2(spreads), axis=0) == pytest.approx(np.array([[2.0, 4.0]] * 2), abs=0.1)  # truncation
    assert simulation.report().shadow_oscillation < spreads[-1][1]  # the report takes the work off


def test_shadow_energy_of_the_oscillator_is_its_closed_form():
    """Δt² (1/12 ω² v² − 1/24 ω⁴ x²) of one atom of mass 1 on a spring to a fixed one, ω = 1."""
    dt, x, v = 0.3, 0.4, 0.7
    system = md.System([[0, 0, 0], [1.0 + x, 0, 0]], velocities=[[0, 0, 0], [v, 0, 0]], bonds=[[0, 1]])
    simulation = md.Simulation(system, md.HarmonicBond(1.0, 1.0), md.VelocityVerlet(dt), md.FixedAtoms([0]))
    expected = 0.5 * v * v + 0.5 * x * x + dt**2 * (v * v / 12.0 - x * x / 24.0)
    assert md.shadow_energy(simulation) == pytest.approx(expected, rel=1e-10)  # rounding, over the nudge


@VERLETS
def test_shadow_energy_of_a_liquid_is_conserved_to_the_fourth_order(name):
    spreads = []
    for dt in (0.006, 0.003):
        simulation = smooth(name, dt, jitter=0.02)
        simulation.run(round(0.6 / dt), every=round(0.6 / dt))
        spreads.append(simulation.run(round(1.2 / dt), every=round(0.012 / dt)).shadow_energy.std())
    assert np.log2(spreads[0] / spreads[1]) == pytest.approx(4.0, abs=0.5)  # truncation, measured on one short path


@pytest.mark.slow
def test_shadow_energy_changes_nothing_and_shows_a_smaller_error_of_the_drift(tmp_path):
    (shown, plain), file = (smooth(), smooth()), tmp_path / "a.h5md"
    plain.extra_observables = ()
    plain.run(400, every=10)
    shown.run(400, every=10, trajectory=file)
    assert np.abs(shown.positions - plain.positions).max() < 1e-9  # rounding, amplified
    report = shown.report()
    assert report.shadow_is_conserved
    assert report.shadow_oscillation < 0.05 * report.energy_oscillation
    assert report.shadow_drift.error < 0.1 * report.energy_drift.error
    told = [str(one) for one in (report, check_file(file), plain.report())]
    assert ["shadow energy" in one for one in told] == [True, True, False]


def test_shadow_energy_sees_a_drift_that_the_energy_hides():
    """Heat of 5e-8 of the velocities every ten steps is far below the oscillation of the energy in so short a run."""
    simulation = smooth()
    heat = lambda sim: np.multiply(sim.velocities, 1.0 + 5e-8, out=sim.velocities)  # noqa: E731
    simulation.run(1000, every=10, observers=[heat])
    report = simulation.report()
    put_in = 1e-7 * report.kinetic_energy / 0.03
    assert (report.shadow_drift.is_significant, report.shadow_is_conserved) == (True, False)
    assert report.shadow_drift.slope == pytest.approx(put_in, rel=0.2)
    assert abs(report.energy_drift.slope - put_in) > put_in


def test_scene_records_the_shadow_energy_and_goes_on_with_it(here):
    Path("melt.toml").write_text(melt_scene(3, 40, "[output]\nevery = 5\nshadow_energy = true\n"))
    assert cli.main(["run", "melt.toml", "--quiet"]) == 0
    assert cli.main(["resume", "melt.h5md", "--steps", "20"]) == 0
    record = read_file("melt.h5md").record
    assert record.step.tolist() == list(range(0, 61, 5))
    assert np.ptp(record.shadow_energy) < 0.2 * np.ptp(record.total_energy)


@pytest.mark.filterwarnings("ignore:timestep")  # too long for methods of order one
@pytest.mark.parametrize("name", SPLITTINGS)
def test_symmetric_methods_come_back_and_others_do_not(name):
    found = argon(SPLITTINGS[name](0.003)).probe_reversibility(60)
    assert found.is_reversible == SPLITTINGS[name].is_symmetric
    assert found.way > 0.1
    assert found.distance < 1e-11 if found.is_reversible else "NOT REVERSIBLE" in str(found)


def test_probe_restores_the_state_and_nothing_is_counted_among_the_steps_of_a_run():
    """Neither the steps of a probe nor those of minimization and equilibration; the memory is that of the process."""
    simulation = argon()
    simulation.run(50, every=10)
    before, cost = simulation.snapshot(), simulation.report().cost
    simulation.probe_reversibility(130)
    for name in ("positions", "velocities", "step", "time"):
        assert np.array_equal(getattr(simulation, name), getattr(before, name)), name
    simulation.minimize(max_steps=5)
    assert replace(simulation.report().cost, peak_memory=cost.peak_memory) == cost
    simulation.equilibrate(30, 1.0)
    after = simulation.report().cost
    assert (after.n_steps, after.n_evaluations) == (cost.n_steps, cost.n_evaluations)


def test_probes_of_a_long_way_of_rigid_bonds_and_of_an_atom_on_which_nothing_acts():
    far = argon(md.VelocityVerlet(0.005))
    far.set_temperature(3.0, seed=1)
    assert far.probe_reversibility(3000).is_reversible is None  # it cannot tell
    assert SCENES["dumbbells"]().simulation().probe_reversibility(60).is_reversible
    rounded = SCENES["dumbbells"]().simulation(precision="fixed-point").probe_reversibility(60)
    assert "impulses of rigid bonds are rounded to the grid" in str(rounded)
    assert not rounded.is_exact
    for speed in (0.0, 1.0):
        alone = md.System([[0.0, 0.0, 0.0]], velocities=[[speed, 0.0, 0.0]])
        simulation = md.Simulation(alone, md.LennardJones(1.0, 1.0), md.VelocityVerlet(0.01))
        assert simulation.probe_reversibility(10).is_reversible


BATH = md.LangevinBAOAB(0.003, 1.0, 1.0, seed=1)
test_what_is_not_known_or_cannot_be_undone_is_refused = answered(
    (lambda: md.shadow_energy(argon(BATH)), ValueError, "thermostat"),
    (lambda: md.shadow_energy(argon(SPLITTINGS["yoshida-6"](0.003))), ValueError, "yoshida-6"),
    (lambda: md.shadow_energy(SCENES["dumbbells"]().simulation()), ValueError, "rigid bonds"),
    (lambda: setattr(argon(), "extra_observables", ("entropy",)), ValueError, "extra_observables", "entropy"),
    (lambda: argon(BATH).probe_reversibility(10), ValueError, "noise"),
    *((lambda n=n: argon().probe_reversibility(n), ValueError, "n_steps", repr(n)) for n in (0, 1.5, "ten")),
)
