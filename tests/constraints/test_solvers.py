"""Laws of distance constraints, for every solver, on bond graphs of every shape."""

from itertools import product

import numba
import numpy as np
import pytest
from hypothesis import given, settings, strategies as st
from rigid_scenes import SCENES, water
from scipy.optimize import fsolve

import minimd as md
from minimd.core.constraints import ConstraintSolver, DistanceConstraints
from minimd.core.diagnosis.report import drift as linear_drift

EPS = np.finfo(float).eps
SMALL = ["diatomics", "water", "ring", "rod"]
OF_WATER = [16.0, 1.0, 1.0]
CASES = [pytest.param(s, OF_WATER, marks=pytest.mark.slow) for s in ("newton", "shake")]


def every(names=tuple(SCENES), solvers=("auto", "newton", "shake")):
    return pytest.mark.parametrize(("name", "solver"), list(product(names, solvers)))


class Motion:
    """A bond graph about the origin without forces, with velocities at random that keep its lengths."""

    def __init__(self, name, solver="auto", tolerance=1e-12, tangent=True):
        positions, self.pairs, own = SCENES[name] if isinstance(name, str) else name
        self.masses, self.positions = np.asarray(own, dtype=float), positions - positions.mean(axis=0)
        self.velocities = np.random.default_rng(2).normal(size=positions.shape)
        kept = DistanceConstraints(self.pairs, tolerance=tolerance, solver=solver)
        self.bonds = ConstraintSolver(kept, self.positions, 1.0 / self.masses)
        if tangent:
            self.bonds.project_velocities(self.velocities, self.positions)

    def step(self, n_steps=1, duration=0.01):
        for _ in range(n_steps):
            self.bonds.drift(self.positions, self.velocities, duration)
            self.bonds.project_velocities(self.velocities, self.positions)
        return self

    def rounding(self):
        return 20.0 * EPS * np.abs(self.positions).max() / self.bonds.lengths.min()

    def momenta(self):
        return self.masses @ self.velocities, self.masses @ np.cross(self.positions, self.velocities)

    def kinetic_energy(self):
        return 0.5 * self.masses @ (self.velocities**2).sum(axis=1)

    def of_bonds(self, vectors):
        return vectors[self.pairs[:, 1]] - vectors[self.pairs[:, 0]]


@every()
def test_lengths_are_kept_to_rounding(name, solver):
    """After every step, and r · v = 0; sweeps keep both to their tolerance."""
    motion = Motion(name, solver, tolerance=1e-10)
    for _ in range({"sheet": 10, "chain": 80}.get(name, 150)):
        motion.step()
        limit = 1e-10 if solver == "shake" else motion.rounding()
        assert motion.bonds.violation(motion.positions).max() <= limit
        turning = (motion.of_bonds(motion.positions) * motion.of_bonds(motion.velocities)).sum(axis=1)
        assert np.abs(turning / motion.bonds.lengths).max() <= np.linalg.norm(motion.velocities, axis=1).max() * limit


@every()
def test_all_solvers_make_the_same_step(name, solver):
    here, swept = (Motion(name, one, tolerance=1e-13).step(5, 0.02) for one in (solver, "shake"))
    assert np.abs([here.positions - swept.positions, here.velocities - swept.velocities]).max() < 1e-9


@every([*SMALL, "cube", "triangle of three masses"])
def test_constraint_forces_conserve_momenta_and_do_no_work_and_a_reversed_motion_returns(name, solver):
    """Free motion; the energy of bodies is kept up to the order of the method: exactly, if they are straight."""
    motion = Motion(name, solver, tolerance=1e-13)
    start, (momentum, angular), energy = motion.positions.copy(), motion.momenta(), motion.kinetic_energy()
    now, turning = motion.step(100).momenta()
    assert np.abs(now - momentum).max() < 1e-11
    assert np.abs(turning - angular).max() < 1e-9
    assert motion.kinetic_energy() == pytest.approx(energy, rel=1e-9 if name in ("diatomics", "rod") else 0.01)
    assert np.abs(motion.positions - start).max() > 0.1
    motion.velocities *= -1.0
    assert np.abs(motion.step(100).positions - start).max() < 1e-9  # rounding, amplified


@pytest.mark.parametrize(
    ("solver", "masses"), [("auto", OF_WATER), pytest.param("auto", [1.0, 16.0, 16.0], marks=pytest.mark.slow), *CASES]
)
def test_rounding_of_lengths_over_a_short_step_is_no_momentum(solver, masses):
    """What a solver leaves of the lengths, divided by Δt, acts on both atoms: 16,000 steps leave rounding alone."""
    motion = Motion((*water(64), np.tile(masses, 64)), solver, tangent=False)
    motion.velocities /= np.sqrt(motion.masses)[:, None]
    motion.bonds.project_velocities(motion.velocities, motion.positions)
    momentum, angular = motion.momenta()
    for _ in range(160):
        for _ in range(100):
            motion.bonds.drift(motion.positions, motion.velocities, 0.0005)
        motion.bonds.project_velocities(motion.velocities, motion.positions)
    terms, (now, turned) = motion.masses[:, None] * np.abs(motion.velocities), motion.momenta()
    turning = (terms * np.linalg.norm(motion.positions, axis=1)[:, None]).sum()
    assert np.abs(now - momentum).max() < 5e-15 * terms.sum()  # rounding
    assert np.abs(turned - angular).max() < 2e-14 * turning  # rounding, of positions too


@pytest.mark.parametrize("name", ["diatomics", "water", "cube", "ring"])
def test_a_drift_satisfies_its_equations(name):
    """M (r′ − r − Δt v) = Gᵀ λ with |r′_ij| = d, solved by SciPy."""
    motion, duration = Motion(name), 0.02
    start, old, (first, second) = motion.positions.copy(), motion.of_bonds(motion.positions), motion.pairs.T
    free, m = start + duration * motion.velocities, motion.masses[:, None]
    motion.bonds.drift(motion.positions, motion.velocities, duration)

    def moved(multipliers):
        displaced, impulses = free.copy(), multipliers[:, None] * old
        np.add.at(displaced, second, impulses / m[second])
        np.add.at(displaced, first, -impulses / m[first])
        return displaced

    off = lambda by: (motion.of_bonds(moved(by)) ** 2).sum(axis=1) - motion.bonds.lengths**2  # noqa: E731
    exact = moved(fsolve(off, np.zeros(len(old)), xtol=1e-12))
    assert np.abs(motion.positions - exact).max() < 1e-12
    assert np.abs(motion.velocities - (exact - start) / duration).max() < 1e-10


@every(SMALL)
def test_a_drift_does_not_see_what_a_projection_would_take_from_the_velocities(name, solver):
    """So velocities are projected only where somebody looks."""
    here, projected = Motion(name, solver, 1e-13, tangent=False), Motion(name, solver, 1e-13)
    assert np.abs(projected.velocities - here.velocities).max() > 0.1
    for motion in (here, projected):
        motion.bonds.drift(motion.positions, motion.velocities, 0.01)
    assert np.abs(here.positions - projected.positions).max() < 1e-13
    assert np.abs(here.velocities - projected.velocities).max() < 1e-11


@pytest.mark.parametrize("name", [*SMALL, "cube", "chain"])
def test_constraint_forces_keep_the_second_derivative_of_every_length_zero(name):
    """r · a + v² = 0; and their virial is Σ F ⊗ r of what they add to the accelerations."""
    motion, rng = Motion(name), np.random.default_rng(5)
    x, m, forces = motion.positions, motion.masses[:, None], rng.normal(size=motion.positions.shape)
    accelerations = forces / m
    motion.bonds.multipliers(x, motion.velocities, accelerations)
    r, v, a = (motion.of_bonds(one) for one in (x, motion.velocities, accelerations))
    assert np.abs((r * a).sum(axis=1) + (v * v).sum(axis=1)).max() < 1e-12
    virial = motion.bonds.virial(x, motion.velocities, forces)
    assert np.abs(virial - (m * accelerations - forces).T @ x).max() < 1e-11 * np.abs(virial).max()  # rounding


def test_positions_that_violate_lengths_are_projected():
    """And the center stays; bonds across a boundary are given by offsets."""
    motion = Motion("ring")
    moved = motion.positions + 0.03 * np.random.default_rng(6).normal(size=motion.positions.shape)
    center = motion.masses @ moved
    motion.bonds.project_positions(moved)
    assert motion.bonds.violation(moved).max() < 1e-14
    assert np.abs(motion.masses @ moved - center).max() < 1e-13
    x, offsets = np.array([[0.1, 0.0, 0.0], [9.4, 0.2, 0.0]]), np.array([[-10.0, 0.0, 0.0]])
    ConstraintSolver(DistanceConstraints([[0, 1]], 0.8), x, np.ones(2), offsets=offsets).project_positions(x)
    assert np.linalg.norm(x[1] - x[0] - [10.0, 0.0, 0.0]) == pytest.approx(0.8, rel=1e-14)


@every(SMALL)
def test_a_step_too_long_names_the_bond(name, solver):
    motion = Motion(name, solver)
    with pytest.raises(md.ConstraintError, match=r"constraint (\d+) \(atoms (\d+)-(\d+)\) .* 50") as caught:
        motion.step(1, 50.0)
    assert list(caught.value.atoms) in motion.pairs.tolist()


@settings(max_examples=25)
@given(st.integers(2, 30), st.integers(0, 2**32 - 1))
def test_random_connected_graphs_are_kept_to_rounding_or_refused(n_atoms, seed):
    """Trees with some more bonds, masses 1 : 1000, lengths at random: never a hang, never a NaN."""
    rng = np.random.default_rng(seed)
    positions, masses = rng.normal(size=(n_atoms, 3)) * 2.0, 10.0 ** rng.uniform(0.0, 3.0, n_atoms)
    pairs = {(int(rng.integers(k)), k) for k in range(1, n_atoms)}
    for _ in range(int(rng.integers(0, n_atoms))):
        pairs.add(tuple(sorted(rng.choice(n_atoms, 2, replace=False).tolist())))
    try:
        motion = Motion((positions, np.array(sorted(pairs)), masses))
    except ValueError as reason:
        assert "follows from the other constraints" in str(reason)  # noqa: PT017
        return
    limit = 5.0 * motion.rounding()
    for _ in range(5):
        assert motion.step(1, 1e-3).bonds.violation(motion.positions).max() <= limit
        assert np.isfinite(motion.velocities).all()


@pytest.mark.parametrize("third", [(2.0, 0.0, 0.0), (1.0, 1.0, 0.0)], ids=["rod", "water"])
def test_one_molecule_and_two_are_of_one_type_for_the_compiler(third):
    """Else their kernels are compiled for each."""
    one, kinds = np.array([(0.0, 0.0, 0.0), (1.0, 0.0, 0.0), third]), []
    for n in (1, 2):
        pairs = [(3 * k + a, 3 * k + b) for k in range(n) for a, b in ((0, 1), (1, 2), (0, 2))]
        system = md.System(np.vstack([one + 5.0 * k for k in range(n)]))
        rigid = md.Simulation(system, [], md.VelocityVerlet(0.01), DistanceConstraints(pairs)).engine.constraint_set
        kinds.append([str(numba.typeof(group.known)) for group in rigid.bonds.groups])
    assert kinds[0] == kinds[1]


@pytest.mark.parametrize("name", [*SMALL, "chain", "cube"])
def test_threads_change_no_bit(name):
    positions, pairs, masses = SCENES[name]
    n, many, rng = len(positions), 3000 // len(pairs), np.random.default_rng(5)
    kept = DistanceConstraints((pairs + n * np.arange(many)[:, None, None]).reshape(-1, 2))
    start = np.tile(positions, (many, 1)) + np.repeat(rng.normal(size=(many, 3)), n, axis=0)
    velocities, results = rng.normal(size=start.shape), []
    for threads in (1, 3):
        bonds = ConstraintSolver(kept, start, np.tile(1.0 / masses, many), threads=threads)
        x, v = start.copy(), velocities.copy()
        for _ in range(5):
            bonds.project_velocities(v, x)
            bonds.drift(x, v, 0.01)
        assert bonds.violation(x).max() < 1e-11
        assert (np.abs(x - start).max(axis=1) > 0.0).all()  # no component was left out
        results.append((x, v))
    assert np.array_equal(results[0], results[1])


@pytest.mark.slow
@pytest.mark.parametrize("name", SCENES)
def test_lengths_are_kept_to_rounding_over_100_000_steps(name):
    """After every single one, with Newton's method; and the energy of the free motion does not drift."""
    n_steps, timestep = (20_000, 0.002) if name == "sheet" else (100_000, 0.01)
    motion, energies, worst = Motion(name, "newton", tangent=False), [], 0.0
    motion.positions -= motion.masses @ motion.positions / motion.masses.sum()
    motion.velocities -= motion.momenta()[0] / motion.masses.sum()
    motion.bonds.project_velocities(motion.velocities, motion.positions)
    for step in range(n_steps):
        motion.step(1, timestep)
        x, v = motion.positions, motion.velocities
        off = max(motion.bonds.violation(x).max(), motion.bonds.velocity_violation(x, v).max())
        worst = max(worst, off / motion.rounding())
        energies += [motion.kinetic_energy()] if step % 100 == 0 else []
    assert worst < 1.0
    drift = linear_drift(timestep * 100 * np.arange(len(energies)), np.array(energies))
    assert abs(drift.slope) < 4.0 * drift.error or abs(drift.slope) * n_steps * timestep < 1e-9 * energies[0]
