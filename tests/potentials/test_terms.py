"""One door for forces: whatever has bind takes part, with as little as an add; wrong forces are found out."""

from typing import ClassVar

import numpy as np
import pytest
from references import liquid
from scenes import LJ
from wrong_calls import assert_answered

import minimd as md
from minimd.core.neighbors.pair_list import PairList

WRONG = {
    "twice": lambda force: force.__imul__(2.0),
    "the sign": lambda force: force.__imul__(-1.0),
    "one atom left out": lambda force: force[17].fill(0.0),
    "one component in a hundred off": lambda force: force[:, 1].__imul__(1.01),
    "forgotten": lambda force: force.fill(0.0),
    "three parts in 100 000 off": lambda force: force.__imul__(1.00003),
}


class Weight:
    """A potential of the user's whose term has nothing but add."""

    cutoff, list = 0.5, ["of the user's own"]  # names that mean something else here than in a Term

    def bind(self, _system):
        return self

    def add(self, system, detail, forces, energies, virials):
        forces[:, 2] -= 1.0
        if detail:
            energies += system.positions[:, 2]


def test_a_term_needs_nothing_but_add(argon):
    system = argon.system
    alone, both = md.Forces(system, LJ), md.Forces(system, [LJ, Weight()])
    own, sums = alone.compute(1), both.compute(1)
    assert sums.forces[:, 2] == pytest.approx(own.forces[:, 2] - 1.0, abs=1e-12)
    assert sums.potential_energy == pytest.approx(own.potential_energy + system.positions[:, 2].sum(), rel=1e-12)
    assert (both.pair_search, both.largest_cutoff) == (alone.pair_search, alone.largest_cutoff)
    assert md.Simulation(system, [LJ, Weight()], md.VelocityVerlet(0.001)).run(2, progress=False).n_atoms == len(system)


class Anchored:
    """Atoms begin at their anchors.  declared : what is special of an instance."""

    def __init__(self, **declared):
        self.__dict__.update(declared)

    def bind(self, system):
        self.anchors = system.positions.copy()
        return self


class Tether(Anchored):
    """U = ½ k |r − r₀|² of each atom, which begins at r₀.  spoil : changes the force.  kind : of the numbers."""

    acts_from_outside, spoil, kind, u = True, lambda self, force: None, np.float64, 1.0

    def add(self, system, detail, forces, energies, virials):
        away = self.kind(system.positions - self.anchors)
        force = -20.0 * away
        self.spoil(force)
        forces += force
        if detail:
            energies += self.u * (self.kind(10.0) * (away * away).sum(axis=1) - self.kind(100.0))


def ran(term, n_steps=2):
    return md.Simulation(liquid(3), [LJ, term], md.VelocityVerlet(0.001)).run(n_steps, every=1, progress=False)


def assert_found_out(kind, run):
    assert_answered(run, ValueError, kind.__name__, "gradient", "F·w = ", "-dU/dw = ")


def test_a_force_that_is_not_minus_the_gradient_of_its_energy_is_refused():
    for wrong in WRONG.values():
        assert_found_out(Tether, lambda wrong=wrong: ran(Tether(spoil=wrong)))
    for distance in (0.0, 1e-13):  # atoms at nearly one place do not spoil the comparison
        system = md.System([[5.0, 5.0, 5.0], [5.0, 5.0, 5.0 + distance]], cell=9.0)
        md.Simulation(system, Tether(), md.VelocityVerlet(0.001)).run(1)
        wrong = md.Simulation(system, Tether(spoil=WRONG["twice"], u=1e-3), md.VelocityVerlet(0.001))
        assert_found_out(Tether, lambda wrong=wrong: wrong.run(1))


def test_right_forces_rough_energies_and_forces_that_declare_none_run():
    """In float32, with 100 ε for each atom, differences are rounding.
    A force without energy, or said to be no gradient, is the user's.  The check leaves no trace in the run."""
    twice = WRONG["twice"]
    for term in (Tether(kind=np.float32), Tether(spoil=twice, is_checked=False), Tether(spoil=twice, u=0.0)):
        ran(term)
    one, other = (ran(Tether(is_checked=is_checked), 20).potential_energy for is_checked in (True, False))
    assert np.array_equal(one, other)


class Steep(Anchored, md.Term):
    """Σ exp(x/s), with a force twice too large; the first evaluations have no finite energy."""

    seen: ClassVar = []  # times, of copies too
    n_calls = 0

    def add(self, system, detail, forces, energies, virials):
        self.seen.append(self.time)
        self.n_calls += 1
        u = np.exp((system.positions[:, 0] - self.anchors[:, 0]) / self.length)
        forces[:, 0] -= 2.0 * u / self.length
        energies += np.where(1 < self.n_calls <= self.n_without, np.nan, u)


@pytest.mark.parametrize(("length", "without", "time"), [(1e-9, 0, 0.0), (1e9, 0, 0.0), (1.0, 9, 0.0), (1.0, 0, 7.0)])
def test_a_wrong_force_is_found_in_any_unit_among_energies_that_are_no_numbers_and_at_its_time(length, without, time):
    """Nine evaluations leave the last of three slopes finite; the others count neither for nor against."""
    start = liquid(2)
    system = md.System(length * start.positions, cell=length * start.cell.vectors)
    steep = Steep(length=length, n_without=without, depends_on_time=time > 0.0)
    simulation = md.Simulation(system, steep, md.VelocityVerlet(0.001))
    simulation.engine.time = time
    Steep.seen.clear()
    assert_found_out(Steep, lambda: simulation.run(1))
    assert set(Steep.seen) == {time}


class Listed(md.potentials.Term):
    """A term with a list of its own, of the skin 0.1."""

    def __init__(self):
        self.list = PairList(2, 1.0, 0.1, np.zeros((0, 2), dtype=np.int64))

    def bind(self, _system):
        return self


def test_a_skin_that_does_not_reach_the_list_of_a_term_is_refused():
    def simulation(**given):
        return md.Simulation(md.System(np.eye(2, 3)), Listed(), md.VelocityVerlet(0.002), **given)

    assert_answered(lambda: simulation(skin=0.3), ValueError, "skin must", "0.3", "0.1", "Listed")
    for given in ({"skin": 0.1}, {}):
        simulation(**given)
