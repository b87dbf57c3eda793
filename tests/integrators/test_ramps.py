"""Ramps of the temperature and the pressure: what they are, what a bath makes of them, restarts, reports, scenes."""

import copy
import json
import pickle

import numpy as np
import pytest
from scenes import SCENES
from scipy.integrate import solve_ivp
from wrong_calls import answered

import minimd as md
from minimd.lammps import script
from minimd.lammps.model import Model
from minimd.scene.scene import load_scene

STEP = 0.01
RAMP = md.Ramp(0.5, 2.0, 400)
RAMPED = {
    "langevin": lambda ramp: md.LangevinBAOAB(STEP, ramp, friction=1.5, seed=5),
    "rescaling": lambda ramp: md.StochasticVelocityRescaling(STEP, ramp, relaxation_time=0.5, seed=5),
}
test_wrong_ramps_are_answered = answered(
    (lambda: md.Ramp(0.5, np.nan, 10), ValueError, "value of a ramp", "nan"),
    (lambda: md.Ramp(0.5, 1.0, 0), ValueError, "steps", "0"),
    (lambda: md.Ramp(0.5, 1.0, 2.5), ValueError, "steps", "2.5"),
    (lambda: md.Ramp.through([]), ValueError, "points of a ramp", "[]"),
    (lambda: md.Ramp.through([(0, 1.0), (0, 2.0)]), ValueError, "ascend", "[0, 0]"),
    (lambda: md.Ramp.through([(0, 1.0, 2.0)]), ValueError, "pairs of a step and a value"),
    (lambda: RAMPED["langevin"]((0.5, 2.0)), ValueError, "temperature", "md.Ramp("),
    (lambda: RAMPED["langevin"](md.Ramp(1.0, -1.0, 10)), ValueError, "temperature", "-1.0"),
    (lambda: md.StochasticCellRescaling(md.Ramp(0.0, 1.0, 10), 0.1, 1.0, 1, md.Ramp(1.0, -1.0, 5)), ValueError, "-1.0"),
)


def simulation(method, **options):
    sim = SCENES["argon"]().simulation(method, **options)
    sim.set_temperature(0.5, seed=3)
    return sim


def test_a_ramp_is_linear_between_its_points_and_constant_outside():
    ramp = md.Ramp.through({10: 1.0, 20: 3.0, 30: 0.0})
    assert [ramp.at(step) for step in (-5, 10, 15, 20, 29, 31)] == pytest.approx([1.0, 1.0, 2.0, 3.0, 0.3, 0.0])
    assert [ramp.changes_after(step) for step in (0, 29, 30)] == [True, True, False]
    assert not md.Ramp(2.0, 2.0, 10).changes_after(0)
    assert md.Ramp.through(json.loads(json.dumps(RAMP))) == RAMP


@pytest.mark.parametrize("ramp", [RAMP, md.Ramp(0.5, 2.0, 10, first=5), md.Ramp.through({0: 1.0, 5: 2.0, 9: 0.5})])
def test_a_ramp_is_made_again_by_its_call_a_pickle_and_a_copy(ramp):
    assert eval(repr(ramp), {"Ramp": md.Ramp}) == ramp
    for again in (pickle.loads(pickle.dumps(ramp)), copy.deepcopy(ramp)):
        assert again == ramp
        assert type(again) is md.Ramp


@pytest.mark.parametrize("bath", RAMPED)
def test_a_constant_ramp_has_the_bits_of_a_number(bath):
    """And so have runs before and after a ramp."""
    ends = []
    for temperature in (0.7, md.Ramp(0.7, 0.7, 10), md.Ramp(0.7, 2.0, 10, first=60), md.Ramp.through([(0, 0.7)])):
        sim = simulation(RAMPED[bath](temperature))
        sim.run(50)
        ends.append(sim.velocities.tobytes())
    assert len(set(ends)) == 1


@pytest.mark.parametrize("bath", RAMPED)
def test_a_harmonic_solid_follows_the_ramp_as_theory_says(bath):
    """⟨x²⟩, ⟨xv⟩ and ⟨v²⟩ of each direction obey three linear equations, with 2γ(k_B T/m − ⟨v²⟩) of the bath; rescaling
    is a friction ½(1 − K̄/K)/τ. Of 30 000 directions each mean has an error of √(2/30 000) = 0.8 %."""
    n, k = 10_000, 4.0
    start = np.random.default_rng(2).normal(0.0, np.sqrt(0.5 / k), (n, 3))
    solid = md.Restraint(k, np.zeros((n, 3)))
    sim = md.Simulation(md.System(start), solid, RAMPED[bath](RAMP))
    sim.set_temperature(0.5, seed=3)
    seen = []
    sim.run(600, every=100, observers=[lambda sim: seen.append(moments(sim))])

    def slope(t, y):
        xx, xv, vv = y
        target = RAMP.at(t / STEP)
        friction = 1.5 if bath == "langevin" else 0.5 * (1.0 - target / vv) / 0.5
        heat = 2.0 * 1.5 * target if bath == "langevin" else 0.0
        return 2.0 * xv, vv - k * xx - friction * xv, -2.0 * k * xv - 2.0 * friction * vv + heat

    times = STEP * np.arange(0, 601, 100)
    exact = solve_ivp(slope, (0.0, times[-1]), seen[0], t_eval=times, rtol=1e-9, atol=1e-12).y.T
    assert np.ptp(exact[:, 2]) > 1.0
    assert np.array(seen)[:, [0, 2]] == pytest.approx(exact[:, [0, 2]], abs=0.04)  # 4 errors of 2 · 0.8 %, and the step


def moments(sim):
    return (sim.positions**2).mean(), (sim.positions * sim.velocities).mean(), (sim.velocities**2).mean()


def test_the_volume_of_an_ideal_gas_follows_the_pressure():
    """V = (N + 1) k_B T/P of a ramp that is slow beside the barostat."""
    n, last = 500, 4000
    ramp = md.Ramp.through({0: 1.0, last // 2: 1.0, last: 4.0})
    push = md.StochasticCellRescaling(ramp, 0.5, 0.5, seed=1, every=5)
    places = np.random.default_rng(2).uniform(0.0, 8.0, (n, 3))
    gas = md.Simulation(
        md.System(places, cell=8.0), md.LennardJones(0.0, 1.0, cutoff=1.0), RAMPED["langevin"](1.0), barostat=push
    )
    gas.set_temperature(1.0, seed=2)
    gas.run(last, every=100)
    expected = np.array([(n + 1) / ramp.at(step) for step in gas.record.step])
    assert gas.record.volume[12:] == pytest.approx(expected[12:], rel=0.25)  # 4 √(1/500), and what it lags behind
    assert gas.record.volume[-1] < 0.35 * expected[0]
    assert gas.report().bath is not None
    assert "the pressure of the bath changed during the run" in str(gas.report())


@pytest.mark.parametrize("bath", RAMPED)
def test_a_resumed_ramp_has_the_bits_of_one_that_was_not_interrupted(bath, tmp_path):
    push = md.StochasticCellRescaling(md.Ramp(0.5, 2.0, 300), 0.05, 2.0, seed=1, every=20)
    whole = simulation(RAMPED[bath](RAMP), barostat=push)
    whole.run(300)
    part = simulation(RAMPED[bath](RAMP), barostat=push)
    part.run(130, every=10, trajectory=tmp_path / "a.h5md")
    again = md.Simulation.resume(tmp_path / "a.h5md", part.potentials)
    assert (again.method.temperature, again.barostat) == (RAMP, push)
    again.run(until_step=300)
    assert again.positions.tobytes() == whole.positions.tobytes()
    assert again.system.cell.vectors.tobytes() == whole.system.cell.vectors.tobytes()


def test_results_do_not_mix_the_states_of_a_ramp():
    sim = simulation(RAMPED["langevin"](RAMP))
    g = md.observers.RadialDistribution(every=10)
    with pytest.raises(ValueError, match=r"Ramp\(0\.5, 2\.0, 400\) of the bath goes on until step 400"):
        sim.run(10, observers=[g])
    sim.run(400, every=50)
    assert "the temperature of the bath changed during the run" in str(sim.report())
    sim.run(50, observers=[g])
    assert g.n_looks == 5 + 1


def test_an_equilibration_has_the_first_temperature_of_a_ramp():
    ends = []
    for temperature in (0.5, RAMP):
        sim = simulation(RAMPED["langevin"](temperature))
        sim.equilibrate(30, 0.5)
        ends.append(sim.velocities.tobytes())
    assert ends[0] == ends[1]


def test_lammps_is_given_the_ends_of_a_ramp():
    sim = simulation(RAMPED["langevin"](RAMP))
    for n_steps in (400, 200):
        text = script.run_script(sim.engine, Model(sim.engine), n_steps, 100)
        assert f"langevin 0.5 {RAMP.at(n_steps):g} " in text
    with pytest.raises(ValueError, match="from the first step of a run, 0, to its last, 500"):
        script.run_script(sim.engine, Model(sim.engine), 500, 100)


SCENE = """
units = "LJ"
[structure]
lattice = "fcc"
repeat = [3, 3, 3]
density = 0.8
[[potential]]
type = "lennard-jones"
cutoff = 2.2
species = { X = { epsilon = 1.0, sigma = 1.0 } }
[dynamics]
method = "langevin-baoab"
timestep = 0.004
steps = 60
temperature = [0.5, 2.0]
relaxation_time = 0.5
[barostat]
pressure = [0.0, 1.0]
compressibility = 0.05
relaxation_time = 2.0
"""


def test_a_scene_has_a_ramp_between_two_numbers(tmp_path):
    path = tmp_path / "heat.toml"
    path.write_text(SCENE)
    sim = load_scene(path).simulation()
    assert sim.method.temperature == md.Ramp(0.5, 2.0, 60)
    assert sim.barostat.pressure == md.Ramp(0.0, 1.0, 60)
    assert sim.temperature == pytest.approx(0.5)
    assert "temperature ε/k_B by steps: 0.5 at 0, 2 at 60" in str(sim)
    for wrong, words in (
        ("[0.5, 2.0, 1.0]", "from which and to which it goes during the run"),
        ("[0.5, -2.0]", "dynamics.temperature"),
    ):
        path.write_text(SCENE.replace("[0.5, 2.0]", wrong))
        with pytest.raises(ValueError, match=words):
            load_scene(path)
    text = SCENE.replace('"langevin-baoab"', '"velocity-verlet"').replace("relaxation_time = 0.5\n", "")
    path.write_text(text)
    with pytest.raises(ValueError, match="can change it during the run"):
        load_scene(path)
