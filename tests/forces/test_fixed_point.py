"""Fixed-point dynamics: momentum, reversibility and any order, to the last bit; see docs/fixed-point.md."""

import itertools
import pickle

import numpy as np
import pytest
from ase import units
from ase.build import bulk
from fixed_point_scenes import ANGLE, BOND, GRID, LAW, bits, mixture, plain, simulated, total_momentum
from wrong_calls import answered, assert_answered

import minimd as md
import minimd.ase
from minimd.core.forces.pair_laws import PairLaws
from minimd.core.integrators.table import SPLITTINGS
from minimd.core.potentials.term import OwnTerm
from minimd.core.structure.cell import nearest_vectors

CHAINS = np.arange(0, 96, 8)[:, None] + np.arange(4)
MAP = np.random.default_rng(5).normal(size=(6, 6))
TORSIONS = [md.PeriodicDihedral(1.0, 3, 0.4, CHAINS), md.DihedralMap(MAP, CHAINS, CHAINS + 1)]
FIELDS = [md.Gravity(0.5), md.Wall([0.0, 0.0, -3.0], [0.0, 0.0, 1.0])]
SLOW = [pytest.param(False, more, marks=pytest.mark.slow) for more in (TORSIONS, FIELDS)]
OTHERS = [("as it is", {"threads": 2}), ("as it is", {"threads": 3, "skin": 0.1}), ("as it is", {"skin": 0.6})]
OTHERS += [(name, {}) for name in ("on the pair list", "renumbered", "wrapped", "translated")]
ARGON = md.LennardJones(0.0104, 3.4, 5.0, truncation="force-shifted")


def there_and_back(simulation, n_steps=120, is_closed=True):
    """Steps, and back. The largest way of an atom."""
    simulation.make_steps(0)
    start, total, before = bits(simulation), total_momentum(simulation), simulation.positions.copy()
    simulation.make_steps(n_steps)
    way = np.abs(simulation.positions - before).max()
    assert total_momentum(simulation) == total or not is_closed
    simulation.run_back(n_steps)
    assert (bits(simulation), simulation.step) == (start, 0)
    return way


@pytest.mark.parametrize("name", SPLITTINGS)
def test_symmetric_methods_return_to_the_first_bit_and_keep_momentum(name):
    simulation = plain(SPLITTINGS[name](0.004))
    if simulation.method.is_symmetric:
        assert there_and_back(simulation) > 0.3
    else:
        total = total_momentum(simulation)
        simulation.make_steps(50)
        assert total_momentum(simulation) == total


def test_a_run_is_that_of_float64_but_for_the_steps_of_the_grid():
    one, other = plain(), plain(precision="double", grid=None)
    start = one.positions.copy()
    for simulation in (one, other):
        simulation.make_steps(60)
    assert np.abs(one.positions - start).max() > 0.2
    assert one.positions == pytest.approx(other.positions, abs=1e-10)


@pytest.mark.parametrize(("pbc", "more"), [(True, []), ((True, False, True), []), (False, []), *SLOW])
def test_bonds_angles_and_every_kind_of_cell_likewise(pbc, more):
    """Dihedrals, too; in fields that stay steps return."""
    simulation = simulated(mixture(pbc), potentials=[LAW, BOND, ANGLE, *more])
    assert there_and_back(simulation, is_closed=more is not FIELDS) > 0.3


def test_atoms_that_are_held_fixed_stay_where_they_are():
    held, simulation = [0, 1, 50], simulated(mixture(), constraints=md.FixedAtoms([0, 1, 50]))
    simulation.make_steps(0)
    start, before = bits(simulation), simulation.positions[held]
    simulation.make_steps(60)
    assert np.array_equal(simulation.positions[held], before)
    simulation.run_back(60)
    assert bits(simulation) == start


@pytest.fixture(scope="module")
def reference():
    simulation = simulated(mixture())
    return simulation, simulation.run(150, every=50)


def other_order(name):
    system, random = mixture(), np.random.default_rng(1)
    order, shift = np.arange(len(system)), 0.0
    if name == "renumbered":
        order = random.permutation(len(system))
        parts = {of: getattr(system, of)[order] for of in ("positions", "masses", "velocities", "species")}
        parts |= {of: np.argsort(order)[getattr(system, of)] for of in ("bonds", "angles")}
        system = md.System(cell=system.cell, **parts)
    elif name == "wrapped":
        shift = random.integers(-3, 4, (len(system), 3)) @ system.cell.vectors
    elif name == "translated":
        shift = np.array([12345, -99, 7_777_777]) * GRID.length
    system.positions[:] += shift
    return system, order, shift


@pytest.mark.parametrize(("name", "options"), OTHERS)
def test_threads_and_skins_change_no_bit(name, options, reference, monkeypatch):
    """Nor do another list, another order of the atoms, and lattice vectors: of the state, energies, pressures."""
    (expected, record), (system, order, shift) = reference, other_order(name)
    if name == "on the pair list":
        monkeypatch.setattr(PairLaws, "fit_clusters", lambda *_: False)
    simulation = simulated(system, **options)
    found = simulation.run(150, every=50)
    assert ("pair list" in simulation.engine.interactions.pair_search) == (name == "on the pair list")
    assert np.array_equal((simulation.positions - shift)[np.argsort(order)], expected.positions)
    assert np.array_equal(simulation.velocities[np.argsort(order)], expected.velocities)
    for series in ("potential_energy", "total_energy", "temperature", "pressure"):
        assert np.array_equal(getattr(found, series), getattr(record, series)), series
    assert np.array_equal(found.momentum, np.repeat(found.momentum[:1], len(found), axis=0))


def test_a_scene_goes_on_after_a_force_beyond_its_range():
    simulation = plain()
    simulation.run(2)
    good = simulation.snapshot()
    simulation.positions[1] = simulation.positions[0] + 0.001
    assert_answered(lambda: simulation.run(1), md.RangeError)
    simulation.restore(good)
    simulation.run(3)
    other = plain()
    other.make_steps(5)
    assert np.array_equal(simulation.positions, other.positions)


@pytest.mark.slow
def test_any_step_of_a_run_in_units_of_ase_is_made_again_and_ases_dynamics_make_the_same_steps(tmp_path):
    """Files have Å/ps; what their rounding changes is less than half a step of the grid."""
    file, atoms = tmp_path / "run.h5md", bulk("Ar", "fcc", 5.4, cubic=True).repeat(2)
    run = md.Simulation(atoms, ARGON, md.VelocityVerlet(5.0 * md.units.fs), precision="fixed-point")
    run.set_temperature(94.4, seed=1)
    other = pickle.loads(pickle.dumps(run))
    run.run(60, every=20, trajectory=file)
    other.make_steps(47)
    assert bits(md.Past(file, ARGON).at(47)) == bits(other)
    assert md.archive(file, tmp_path / "small.h5md", 40, ARGON).n_frames == (4, 2)
    atoms.set_momenta(np.random.default_rng(4).normal(size=(32, 3)))
    atoms.calc = minimd.ase.Calculator(ARGON, precision="fixed-point", threads=1)
    sim = md.Simulation(atoms, ARGON, md.VelocityVerlet(2.0 * md.units.fs), precision="fixed-point")
    sim.make_steps(20)
    minimd.ase.VelocityVerlet(atoms, 2.0 * units.fs).run(20)
    assert np.array_equal(atoms.positions, sim.positions)


@pytest.mark.parametrize("bath", [md.LangevinBAOAB, md.StochasticVelocityRescaling])
def test_baths_keep_to_the_grid(bath):
    """A stopped run and one on other threads have the same bits; rescaling keeps the momentum to rounding."""
    bath = bath(0.004, 0.9, 1.0, seed=3)
    one, other = simulated(mixture(), bath), simulated(mixture(), bath, threads=2, skin=0.2)
    one.make_steps(100)
    other.make_steps(37)
    other = pickle.loads(pickle.dumps(other))
    other.make_steps(63)
    assert (bits(one), one.reservoir_energy) == (bits(other), other.reservoir_energy)
    momenta = one.velocities * one.system.masses[:, None] / GRID.momentum
    assert momenta == pytest.approx(np.rint(momenta), abs=0.01)


def test_rigid_bonds_keep_momentum_to_the_last_bit(tmp_path):
    system, file = mixture(), tmp_path / "rigid.h5md"
    system.velocities[:] -= (system.masses[:, None] * system.velocities).sum(axis=0) / system.masses.sum()
    simulation = simulated(system, constraints=md.DistanceConstraints(system.bonds), potentials=[LAW])
    simulation.make_steps(0)
    total = total_momentum(simulation)
    record = simulation.run(200, every=50, trajectory=file)
    assert total_momentum(simulation) == total
    assert record.constraint_violation.max() < 1e-9
    assert_answered(lambda: md.Past(file, [LAW]), ValueError, "rigid bonds")
    assert_answered(lambda: simulation.run_back(10), ValueError, "constraints")


def crystal():
    """Near its minimum, and cold: the forces of pairs cancel, their rounding errors do not."""
    positions, edges = md.lattice.crystal("fcc", (4, 4, 4), 1.55)
    positions += np.random.default_rng(3).normal(scale=1e-4, size=positions.shape)
    return md.System(positions, cell=edges, species=["A"] * len(positions))


@pytest.mark.parametrize("scene", [mixture, pytest.param(crystal, marks=pytest.mark.slow)])
def test_forces_and_energies_are_those_of_float64_to_the_steps_of_the_grid(scene, monkeypatch):
    """Each impulse over a unit of time is rounded to p0, each energy to e0, whatever their size."""
    rounded = simulated(scene())
    rounded.make_steps(60)
    frame, here = rounded.frame(), rounded.system
    monkeypatch.setattr(PairLaws, "fit_clusters", lambda *_: False)  # compiles less
    exact = md.evaluate(here, rounded.engine.interactions.potentials)
    pairs = np.array(list(itertools.combinations(range(len(here)), 2)))
    pairs = pairs[np.linalg.norm(nearest_vectors(here.positions, here.cell, pairs), axis=1) < LAW.cutoff]
    atoms = np.concatenate([pairs.ravel(), here.bonds.ravel(), here.angles.ravel(), here.angles[:, 1]])
    n_impulses = np.bincount(atoms, minlength=len(here))
    step, errors = GRID.momentum / rounded.engine.interactions.unit, frame.forces - exact.forces
    assert (np.abs(errors) <= 0.5 * step * n_impulses[:, None] + 1e-15 * np.abs(exact.forces).max()).all()
    of_all = step * np.sqrt(n_impulses.mean() / 12.0)
    assert np.sqrt((errors**2).mean()) == pytest.approx(of_all, rel=0.16)  # statistics: four errors of 324 numbers
    of_energy = GRID.energy * np.sqrt((len(pairs) + len(here.bonds) + len(here.angles)) / 12.0)
    error = abs(frame.observables["potential_energy"] - exact.potential_energy)
    assert error <= 4.0 * of_energy + 1e-15 * abs(exact.potential_energy)  # statistics and rounding
    assert rounded.engine.sums.virial == pytest.approx(exact.virial, rel=1e-10, abs=1e-9)


def test_a_grid_is_chosen_from_the_scene_and_widened_with_it():
    simulation = plain(grid=None)
    chosen = simulation.engine.interactions.grid
    assert 1e-14 < chosen.length < 1e-12
    assert np.array_equal(simulation.positions / chosen.length, np.rint(simulation.positions / chosen.length))
    simulation.velocities[:] *= 2.0
    simulation.make_steps(0)
    assert simulation.engine.interactions.grid == chosen  # else steps back would not be those forward
    simulation.velocities[:] *= 50.0
    simulation.make_steps(0)
    assert simulation.engine.interactions.grid.momentum == pytest.approx(100.0 * chosen.momentum, rel=0.5)


def test_a_momentum_or_a_force_that_leaves_its_range_stops_the_run():
    """Before anything wraps round: the state is the last good one."""
    hot = plain(grid=md.Grid(2.0**-42, 2.0**-47, 2.0**-36))  # momenta up to 8
    hot.velocities[:] *= 2.0
    assert_answered(lambda: hot.make_steps(20_000), md.RangeError, "At step ", ": the momentum of atom ")
    assert np.abs(hot.velocities * hot.system.masses[:, None]).max() <= 8.0


def one_step_with(name, number):
    simulation = plain()
    getattr(simulation, name)[7, 1] = number
    simulation.make_steps(1)


class Pull(md.Term):
    bind = lambda self, _system: self  # noqa: E731


class CompiledPull(Pull, OwnTerm):
    """Nor does it say that it fits a grid."""


test_what_cannot_be_done_is_refused = answered(
    (lambda: plain(SPLITTINGS["symplectic-euler-1"](0.004)).run_back(1), ValueError, "symplectic-euler-1", "symmetric"),
    (lambda: plain(precision="double", grid=None).run_back(1), ValueError, "precision", "double"),
    (lambda: one_step_with("velocities", 1e4), md.RangeError, "momentum of atom 7", "1e+04", "64"),
    (lambda: one_step_with("positions", 1e4), md.RangeError, "atom 7", "1e+04 from the origin", "1.02e+03"),
    (lambda: simulated(mixture(), potentials=[LAW, Pull()]), ValueError, "precision", "fixed-point"),
    (lambda: simulated(mixture(), potentials=[LAW, CompiledPull()]), ValueError, "CompiledPull", "fixed-point"),
    (lambda: simulated(mixture(), precision="double"), ValueError, "grid", "double"),
    (lambda: md.Grid(1e-12, 2.0**-44, 2.0**-36), ValueError, "length", "1e-12"),
)
