"""One door for forces: whatever has bind takes part, with as little as an add; what was computed can be set aside."""

import warnings
from typing import ClassVar

import numpy as np
import pytest
from references import liquid

import minimd as md

LJ = md.LennardJones(1.0, 1.0, 2.5)


class Weight:
    """A potential of the user's whose term has nothing but add."""

    cutoff, list = 0.5, ["of the user's own"]  # names that mean something else here than in a Term

    def bind(self, _system):
        return self

    def add(self, system, detail, forces, energies, virials):
        forces[:, 2] -= 1.0
        if detail:
            energies += system.positions[:, 2]


def soft(r2, height):
    return height / r2, 2.0 * height / r2**2


def test_a_term_needs_nothing_but_add():
    system = liquid(5)
    alone, both = md.Forces(system, LJ), md.Forces(system, [LJ, Weight()])
    for forces in (alone, both):
        forces.compute(1)
    assert both.forces[:, 2] == pytest.approx(alone.forces[:, 2] - 1.0, abs=1e-12)
    assert both.potential_energy == pytest.approx(alone.potential_energy + system.positions[:, 2].sum(), rel=1e-12)
    assert (both.skipped(), both.pair_search, both.largest_cutoff) == (
        alone.skipped(),
        alone.pair_search,
        alone.largest_cutoff,
    )
    assert md.Simulation(system, [LJ, Weight()], md.VelocityVerlet(0.001)).run(2, progress=False).n_atoms == len(system)


def test_what_is_no_potential_or_binds_to_no_term_is_refused():
    class Empty:
        def bind(self, _system):
            return None

    with pytest.raises(
        TypeError, match="potentials must be potentials of minimd, such as LennardJones or HarmonicBond; got 3"
    ):
        md.Forces(liquid(2), 3)
    with pytest.raises(TypeError, match="bind must return a term, an object with add"):
        md.Forces(liquid(2), Empty())


class Tether:
    """U = ½ k |r − r₀|² of each atom, which begins at r₀.  spoil : changes the force, (N, 3).  kind : of the numbers."""

    acts_from_outside = True

    def __init__(self, spoil=None, kind=np.float64, u=1.0, **declared):
        self.spoil, self.kind, self.u = spoil, kind, u
        self.__dict__.update(declared)

    def bind(self, system):
        self.anchors = system.positions.copy()
        return self

    def add(self, system, detail, forces, energies, virials):
        away = self.kind(system.positions - self.anchors)
        force = -20.0 * away
        if self.spoil is not None:
            self.spoil(force)
        forces += force
        if detail:
            energies += self.u * (self.kind(10.0) * (away * away).sum(axis=1) - self.kind(100.0))


def ran(term, n_steps=2):
    system = liquid(3)
    start = system.positions.copy()
    simulation = md.Simulation(system, [LJ, term], md.VelocityVerlet(0.001))
    record = simulation.run(n_steps, every=1, progress=False)
    assert np.abs(system.positions - start).max() < 0.1
    return record


WRONG = {
    "twice": lambda force: force.__imul__(2.0),
    "the sign": lambda force: force.__imul__(-1.0),
    "one atom left out": lambda force: force[17].fill(0.0),
    "one component in a hundred off": lambda force: force[:, 1].__imul__(1.01),
    "forgotten": lambda force: force.fill(0.0),
}


@pytest.mark.parametrize("wrong", WRONG.values(), ids=WRONG)
def test_a_force_that_is_not_minus_the_gradient_of_its_energy_is_refused(wrong):
    with pytest.raises(ValueError, match=r"Tether.* gradient .*F·w = .*-dU/dw = "):
        ran(Tether(wrong))


@pytest.mark.parametrize(
    "term", [Tether(), Tether(kind=np.float32), Tether(WRONG["twice"], is_checked=False), Tether(WRONG["twice"], u=0.0)]
)
def test_right_forces_rough_energies_and_forces_that_declare_none_run(term):
    """In float32, with 100 ε for each atom, differences are rounding; a force without energy, or said to be no gradient, is the user's."""
    ran(term)


class Steep(md.Term):
    """Σ exp(x/s), with a force twice too large; the first evaluations have no finite energy."""

    seen: ClassVar = []  # times, of copies too

    def __init__(self, length, n_without=0, **declared):
        self.length, self.n_without, self.n_calls = length, n_without, 0
        self.__dict__.update(declared)

    def bind(self, system):
        self.anchors = system.positions.copy()
        return self

    def add(self, system, detail, forces, energies, virials):
        self.seen.append(self.time)
        self.n_calls += 1
        u = np.exp((system.positions[:, 0] - self.anchors[:, 0]) / self.length)
        forces[:, 0] -= 2.0 * u / self.length
        energies += np.where(1 < self.n_calls <= self.n_without, np.nan, u)


def steep(length, *given, **declared):
    system = md.System(length * liquid(3).positions, cell=length * liquid(3).cell.vectors)
    return md.Simulation(system, Steep(length, *given, **declared), md.VelocityVerlet(0.001))


@pytest.mark.parametrize("length", [1e-9, 1.0, 1e9])
def test_a_wrong_force_is_found_in_any_unit_of_length(length):
    with pytest.raises(ValueError, match="gradient"):
        steep(length).run(1)


@pytest.mark.parametrize("distance", [0.0, 1e-13])
def test_atoms_at_nearly_one_place_do_not_spoil_the_comparison(distance):
    system = md.System([[5.0, 5.0, 5.0], [5.0, 5.0, 5.0 + distance]], cell=9.0)
    md.Simulation(system, Tether(), md.VelocityVerlet(0.001)).run(1)
    with pytest.raises(ValueError, match="gradient"):
        md.Simulation(system, Tether(WRONG["twice"], u=1e-3), md.VelocityVerlet(0.001)).run(1)


def test_slopes_that_are_not_finite_count_neither_for_nor_against_a_force():
    with pytest.raises(ValueError, match="gradient"):
        steep(1.0, 9).run(1)  # the last of three slopes is finite


def test_a_term_that_depends_on_time_is_tried_at_the_time_of_the_run():
    simulation = steep(1.0, depends_on_time=True)
    simulation.engine.time = 7.0
    Steep.seen.clear()
    with pytest.raises(ValueError, match="gradient"):
        simulation.run(1)
    assert set(Steep.seen) == {7.0}


def test_the_check_leaves_no_trace_in_the_run():
    one, other = (ran(Tether(is_checked=is_checked), 20).potential_energy for is_checked in (True, False))
    assert np.array_equal(one, other)


def test_a_law_of_the_user_is_tried_once(monkeypatch):
    """Not for every pair of species, not at every plan, not in another cell."""
    from minimd.potentials import pair

    tried, check = [], pair.check_user_law
    monkeypatch.setattr(pair, "check_user_law", lambda *arguments: tried.append(check(*arguments)))
    system = liquid(5)
    species = np.array(["A", "B", "C"])[np.arange(len(system)) % 3]
    system = md.System(system.positions, cell=system.cell, species=species)
    forces = md.Forces(
        system, md.PairPotential(soft, {"A": (1.0,), "B": (2.0,), "C": (3.0,)}, 2.0, mixing=lambda a, b: (a[0] + b[0],))
    )
    forces.fit_skin(0.01)
    forces.compute()
    system.cell = md.Cell.of(1.01 * system.cell.vectors[0, 0])
    forces.compute()
    assert len(tried) == 1


def test_what_was_computed_can_be_set_aside():
    system = liquid(5)
    forces = md.Forces(system, [LJ, Weight()])
    forces.compute(2)
    kept = forces.forces.copy(), forces.potential_energy, forces.virial, forces.energies, forces.virials
    here = system.positions.copy()
    array, vectors = forces.forces, kept[0]
    with forces.set_aside():
        system.positions[:] += np.random.default_rng(1).normal(0.0, 0.01, here.shape)
        for detail in (0, 1, 2):
            assert not np.array_equal(forces.compute(detail), vectors)
            assert forces.has_energy == (detail > 0)
    assert forces.forces is array
    assert forces.has_energy
    for after, before in zip(
        (forces.forces, forces.potential_energy, forces.virial, forces.energies, forces.virials), kept, strict=True
    ):
        assert np.array_equal(after, before)


def test_what_finds_no_bonds_is_told_once():
    system = liquid(5)
    with warnings.catch_warnings(record=True) as told:
        warnings.simplefilter("always")
        forces = md.Forces(system, [md.LennardJones(1.0, 1.0, 2.5, bonded_scale=(0, 0, 1)), md.HarmonicBond(1.0, 1.0)])
        forces.compute()
        system.cell = md.Cell.of(1.01 * system.cell.vectors[0, 0])
        forces.compute()
    assert [str(one.message).split(":")[0].rsplit(" has", 1)[1] for one in told] == [" no effect"] * 2
    assert "bond loop" in forces.skipped()
