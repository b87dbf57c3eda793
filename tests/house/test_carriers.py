"""An observable that is asked for in several places is computed by one function.

Each function is replaced, in all modules, by one with twice its result. Then every number that a user is shown must be
twice as large."""

import re
import sys

import numpy as np
import pytest

import minimd as md
from minimd.core.constraints.constraint_set import ConstraintSet
from minimd.core.structure import observables
from minimd.observers.fluctuations import Fluctuations
from minimd.observers.profile import Profile
from minimd.view.check import check_file

LJ = md.LennardJones(1.0, 1.0, 1.6, "shifted")


def doubled(monkeypatch, function):
    """Replace a function by one with twice its result, wherever a module of minimd holds it."""
    twice = lambda *arguments, **named: 2.0 * function(*arguments, **named)  # noqa: E731
    for name, module in [*sys.modules.items()]:
        if name.startswith("minimd"):
            for attribute in [key for key, value in vars(module).items() if value is function]:
                monkeypatch.setattr(module, attribute, twice)


def crystal():
    """With velocities that no carrier has made."""
    positions, edges = md.lattice.crystal("fcc", [3, 3, 3], 1.7)
    velocities = np.random.default_rng(1).normal(size=positions.shape)
    return md.System(positions, cell=edges, velocities=velocities - velocities.mean(axis=0))


def shown(path):
    """The temperatures and pressures that a run shows, by the name of the place; of one state, the same each time."""
    system = crystal()
    sim = md.Simulation(system, LJ, md.VelocityVerlet(0.001))
    profile = Profile(n_bins=1, every=1)
    fluctuations = Fluctuations(every=1)
    sim.run(4, every=1, observers=[profile, fluctuations], trajectory=path / "run.h5md", overwrite=True)
    report = sim.report()
    bath = md.LangevinBAOAB(0.001, 1.0, friction=1.0, seed=1)
    deficit = md.Simulation(system.copy(), LJ, bath)
    deficit.run(1)
    hot = system.copy()
    hot.velocities[:] *= 1e3
    return {
        "simulation": sim.temperature,
        "record": sim.record.temperature[-1],
        "report": report.mean_temperature,
        "bath": deficit.report().bath[1],
        "check": check_file(path / "run.h5md").report.mean_temperature,
        "profile": profile.result().temperature[0],
        "fluctuations": fluctuations.result().temperature,
        "advice": md.advise_timestep(system, LJ).temperature,
        "judge": hot_temperature(hot),
        "pressure": sim.pressure,
        "record's pressure": sim.record.pressure[-1],
    }


def hot_temperature(system):
    """Of the sentence about atoms that are too fast."""
    sim = md.Simulation(system, LJ, md.VelocityVerlet(0.001))
    with pytest.raises(md.NonFiniteError) as failure:
        sim.run(1000)
    return float(re.findall(r"at (\S+) ε/k_B", str(failure.value))[0])


@pytest.fixture
def before(tmp_path):
    return shown(tmp_path)


@pytest.mark.parametrize("function", [observables.temperature, observables.pressure])
def test_every_place_shows_what_one_function_computes(function, before, tmp_path, monkeypatch):
    doubled(monkeypatch, function)
    factors = {name: value / before[name] for name, value in shown(tmp_path).items()}
    expected = {name: 1.0 + (("pressure" in name) == (function.__name__ == "pressure")) for name in factors}
    assert factors == pytest.approx(expected, rel=0.01)  # a sentence has three digits


def test_all_means_of_one_run_are_of_the_same_temperature(before):
    """All of them look at each step; the profile has one layer."""
    for name in ("profile", "fluctuations", "check"):
        assert before[name] == pytest.approx(before["report"], rel=1e-12), name  # rounding


def test_the_shares_of_the_atoms_add_up_to_the_degrees_of_freedom():
    """Fixed atoms, rigid bonds, and the center: once each."""
    system = crystal()
    for constraints in ((), md.FixedAtoms([0, 3]), md.DistanceConstraints([(0, 1), (1, 2), (5, 6)])):
        for conserves_momentum in (False, True):
            of = ConstraintSet(system, constraints)
            shares = of.shares(system.positions, conserves_momentum)
            assert np.sum(shares) == pytest.approx(of.degrees_of_freedom(conserves_momentum), rel=1e-12)
