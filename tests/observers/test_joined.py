"""Observers of independent runs, joined: the result of all looks, with an error bar that holds."""

import copy
from dataclasses import dataclass

import numpy as np
import pytest
from scenes import LJ, argon
from wrong_calls import answered, assert_answered

import minimd as md
from minimd.core.structure.statistics import MOST_BLOCKS
from minimd.core.structure.system import changed
from minimd.observers.accumulator import Accumulator, BlockedSums, Result
from minimd.observers.arguments import label, steps
from minimd.observers.time_correlation import TimeCorrelation

EVERY = {"radial-distribution": 2, "structure-factor": 5, "profile": 2, "surface-tension": 1,
         "pressure-profile": 5, "mean-square-displacement": 1, "velocity-autocorrelation": 1, "self-scattering": 1,
         "viscosity": 1, "chain-shape": 1, "dielectric-constant": 1}  # fmt: skip
OF_ATOMS = {"conductivity": 1, "thermal-conductivity": 2}
GAS = md.LennardJones(1e-15, 1e-3, 4.0, "force-shifted")  # next to no forces
T = 1e-4


@dataclass(frozen=True, repr=False)
class Square(Result):
    value: float
    error: float

    def display_rows(self):
        return [("⟨v²⟩", f"{self.value} ± {self.error}")]


class SquareVelocity(Accumulator):
    """⟨v²⟩/3 of all atoms."""

    kind = "square-velocity"
    every: int = steps(1)
    name: str = label()

    def _laid_out(self, scene):
        self.sums = BlockedSums(2)

    def _look(self, engine):
        self.sums.total[:] += 1.0, (engine.velocities**2).mean()

    def result(self):
        return Square(self.answered(), *map(float, self.sums.estimate(lambda sums: sums[1] / sums[0])))


def molecules():
    atoms = argon().system
    pairs = np.concatenate([[[k, k + 1], [k + 1, k + 2]] for k in range(0, 108, 3)])
    charges = np.resize([1.0, -0.5, -0.5], 108)
    return md.Simulation(changed(atoms, bonds=pairs, charges=charges), LJ, md.VelocityVerlet(0.004))


def ions():
    charges = np.resize([1.0, -1.0], 108)
    return md.Simulation(changed(argon().system, charges=charges), LJ, md.VelocityVerlet(0.004))


def gas(seed, temperature=T):
    """A Langevin gas of 4 atoms, whose ⟨v²⟩ is T at any time step."""
    system = md.System(3.0 * np.eye(4, 3), cell=9.0)
    sim = md.Simulation(system, GAS, md.LangevinBAOAB(0.3, temperature, friction=1.0, seed=seed))
    sim.set_temperature(temperature, seed=seed)
    return sim


def looked(seed, temperature=T, of=SquareVelocity, **arguments):
    observer = of(**arguments)
    gas(seed, temperature).run(200, every=200, observers=[observer])
    return observer


@pytest.fixture(scope="module")
def runs():
    return [looked(seed) for seed in range(40)]


@pytest.mark.parametrize("lengths", [(1,), (31, 1, 2), (32, 32), (5, 700, 40, 1, 33), (40, 50, 4000), 60 * (20,)])
def test_joined_blocks_are_of_one_length_and_have_the_sums_of_their_entries(lengths):
    rng = np.random.default_rng(1)
    runs = []
    entries = []
    for n in lengths:
        series = rng.normal(size=(n, 2)) + 10.0
        sums = BlockedSums(2)
        for entry in series:
            sums.total += entry
            sums.close_entry()
        runs.append(sums)
        n_blocks, length = len(sums.ends), sums.ends[0]
        assert n_blocks == n // length < MOST_BLOCKS
        entries.append((length, series[: n_blocks * length]))
    whole = BlockedSums.joined(runs)
    everything = np.concatenate([series for _, series in sorted(entries, key=lambda each: -each[0])])
    length, n_blocks = whole.ends[0], len(whole.ends)
    assert max(length for length, _ in entries) <= length
    assert n_blocks == len(everything) // length < MOST_BLOCKS
    blocks = everything[: n_blocks * length].reshape(n_blocks, length, 2).sum(axis=1)
    assert whole.parts() == pytest.approx(blocks, rel=1e-12)  # rounding
    assert whole.n_entries == sum(lengths)
    assert whole.total == pytest.approx(sum(run.total for run in runs), rel=1e-14)
    if sum(lengths) > MOST_BLOCKS:
        assert n_blocks >= 12


@pytest.mark.parametrize(("scene", "kinds"), [(molecules, EVERY), (ions, OF_ATOMS)])
@pytest.mark.filterwarnings("ignore:.*charges.*")
def test_a_joined_observer_has_the_result_of_one_that_looked_at_all_runs(scene, kinds):
    """To rounding, also error bars; those of correlations end at lags that each run is long enough for."""
    first, second = ([md.observers.KINDS[kind](every=every) for kind, every in kinds.items()] for _ in range(2))
    scene().run(39, every=39, observers=first)
    whole = copy.deepcopy(first)
    for observer in whole:
        observer.interrupt()
        observer.last_step = -1
        observer.name += "_of_both"
    again = scene()
    again.set_temperature(1.0, seed=2)
    again.run(39, every=39, observers=[*second, *whole])
    for one, other, both in zip(first, second, whole, strict=True):
        looks = one.n_looks
        joined = md.observers.joined([one, other])
        assert type(joined) is type(one)
        assert (one.n_looks, joined.n_looks, both.n_looks, joined.n_runs) == (looks, 2 * looks, 2 * looks, 2)
        found, expected = joined.result().columns(), both.result().columns()
        assert [*found] == [*expected]
        for name, column in expected.items():
            if not (name.endswith("_error") and isinstance(one, TimeCorrelation)):
                np.testing.assert_allclose(found[name], column, rtol=1e-9, atol=1e-11, err_msg=f"{one!r}: {name}")
        assert str(joined)


@pytest.mark.filterwarnings("ignore:.*charges.*")
def test_lags_of_joined_correlations_are_those_of_a_single_run():
    """Error bars end at half of a run, whatever the number of runs."""
    correlations = []
    for seed in (1, 2, 3, 4):
        sim = ions()
        sim.set_temperature(1.0, seed=seed)
        correlations.append(md.observers.VelocityAutocorrelation(every=1))
        sim.run(64, every=64, observers=correlations[-1:])
    one = correlations[0].result()
    all_runs = md.observers.joined(correlations).result()
    assert np.array_equal(np.isnan(one.errors), np.isnan(all_runs.errors))
    assert 0 < np.isnan(one.errors).sum() < one.errors.size


def test_the_error_bar_of_joined_runs_is_that_of_the_whole_and_covers(runs):
    """10 joins of 4 runs: half the error of one run, and within two errors of ⟨v²⟩ = T in 8 or more; 2 or more outside
    have a probability below 10⁻³ for bars that hold in 95 %."""
    single = np.array([observer.result().error for observer in runs])
    joins = [md.observers.joined(runs[k : k + 4]).result() for k in range(0, 40, 4)]
    errors = np.array([each.error for each in joins])
    assert errors.mean() / single.mean() == pytest.approx(0.5, abs=0.08)  # statistics: each is known to some 15 %
    inside = [abs(each.value - T) < 2.0 * each.error for each in joins]
    assert sum(inside) >= 8
    whole = md.observers.joined(runs)
    result = whole.result()
    assert result.value == pytest.approx(np.mean([each.value for each in joins]), rel=1e-12)
    assert result.value == pytest.approx(T, abs=4.0 * result.error)
    assert result.error / single.mean() == pytest.approx(40.0**-0.5, rel=0.5)


def test_a_joined_observer_looks_at_no_other_run(runs):
    joined = md.observers.joined(runs[:2])
    assert_answered(lambda: gas(1).run(1, observers=[joined]), ValueError, "2 runs", "SquareVelocity")
    gas(1).run(1, observers=[runs[0]])  # as before


def in_parts(seed):
    """An observer in the middle of a run, and at its end."""
    sim, observer = gas(seed), SquareVelocity()
    sim.run(300, observers=[observer])
    middle = copy.deepcopy(observer)
    sim.run(400, observers=[observer])
    return [middle, observer]


HEAT = md.observers.Fluctuations  # its sums are relative to the first look
test_observers_that_cannot_be_joined_are_answered = answered(
    (lambda: md.observers.joined([]), ValueError, "observers"),
    (lambda: md.observers.joined([looked(1), 3]), TypeError, "observers[1]", "3"),
    (lambda: md.observers.joined([looked(1), SquareVelocity()]), ValueError, "SquareVelocity", "not observed"),
    (lambda: md.observers.joined([looked(1), looked(2, every=2)]), ValueError, "observers[1]", "every"),
    (lambda: md.observers.joined([looked(1), looked(2, temperature=2e-4)]), ValueError, "observers[1]", "scene"),
    (lambda: md.observers.joined([looked(1), looked(2, of=HEAT)]), ValueError, "observers[1]", "class"),
    (lambda: md.observers.joined([looked(1, of=HEAT), looked(2, of=HEAT)]), ValueError, "observers[1]", "reference"),
    (lambda: md.observers.joined([looked(1), looked(2), looked(1)]), ValueError, "observers[2]", "observers[0]"),
    (lambda: md.observers.joined([md.observers.joined([looked(1), looked(2)]), looked(3)]), ValueError, "at once"),
    (lambda: md.observers.joined(in_parts(1)), ValueError, "observers[1]", "begins with the same sums"),
)
