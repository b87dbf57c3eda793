"""Distance constraints kept by every solver, on bond graphs of every shape."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from rigid_scenes import SCENES, chain, cube, ring, rod, water
from scipy.optimize import fsolve

import minimd as md
from minimd.constraints import ConstraintSolver, DistanceConstraints

EPS = np.finfo(float).eps


def scene(name, seed=2):
    """Bonds, positions about the origin, velocities that keep the lengths, masses."""
    positions, pairs, masses = SCENES[name]
    positions = positions - positions.mean(axis=0)
    velocities = np.random.default_rng(seed).normal(size=positions.shape)
    return pairs, positions, velocities, masses


def rounding(positions, lengths):
    return 20.0 * EPS * np.abs(positions).max() / lengths.min()


@pytest.mark.parametrize("solver", ["auto", "newton"])
@pytest.mark.parametrize("name", SCENES)
def test_lengths_are_kept_to_rounding(name, solver):
    pairs, positions, velocities, masses = scene(name)
    bonds = ConstraintSolver(DistanceConstraints(pairs, solver=solver), positions, 1.0 / masses)
    bonds.project_velocities(velocities, positions)
    for _ in range(50 if name == "sheet" else 500):
        bonds.drift(positions, velocities, 0.01)
        bonds.project_velocities(velocities, positions)
        assert bonds.violation(positions).max() <= rounding(positions, bonds.lengths)
        bonds_now, speeds = bonds.bonds(positions), np.linalg.norm(velocities, axis=1).max()
        turning = velocities[pairs[:, 1]] - velocities[pairs[:, 0]]
        assert np.abs((bonds_now * turning).sum(axis=1) / bonds.lengths).max() <= speeds * rounding(
            positions, bonds.lengths
        )


@pytest.mark.parametrize("name", SCENES)
def test_sweeps_keep_lengths_to_their_tolerance(name):
    pairs, positions, velocities, masses = scene(name)
    bonds = ConstraintSolver(DistanceConstraints(pairs, tolerance=1e-10, solver="shake"), positions, 1.0 / masses)
    bonds.project_velocities(velocities, positions)
    for _ in range(10 if name == "sheet" else 100):
        bonds.drift(positions, velocities, 0.01)
        bonds.project_velocities(velocities, positions)
    assert bonds.violation(positions).max() <= 1e-10
    assert bonds.velocity_violation(positions, velocities).max() <= 1e-10


@pytest.mark.parametrize("name", SCENES)
def test_all_solvers_make_the_same_step(name):
    def after(solver):
        pairs, positions, velocities, masses = scene(name)
        bonds = ConstraintSolver(DistanceConstraints(pairs, tolerance=1e-13, solver=solver), positions, 1.0 / masses)
        bonds.project_velocities(velocities, positions)
        for _ in range(5):
            bonds.drift(positions, velocities, 0.02)
            bonds.project_velocities(velocities, positions)
        return np.concatenate([positions, velocities])

    swept = after("shake")
    for solver in ("auto", "newton"):
        assert np.abs(after(solver) - swept).max() < 1e-9


@pytest.mark.parametrize("solver", ["auto", "newton", "shake"])
@pytest.mark.parametrize("name", ["diatomics", "water", "ring", "rod"])
def test_constraint_forces_conserve_momentum_and_angular_momentum(name, solver):
    """Free motion; energy too is kept by rigid bodies, up to the order of the method."""
    pairs, positions, velocities, masses = scene(name)
    bonds = ConstraintSolver(DistanceConstraints(pairs, solver=solver), positions, 1.0 / masses)
    bonds.project_velocities(velocities, positions)
    momentum, angular = masses @ velocities, masses @ np.cross(positions, velocities)
    for _ in range(500):
        bonds.drift(positions, velocities, 0.01)
        bonds.project_velocities(velocities, positions)
    assert np.abs(masses @ velocities - momentum).max() < 1e-11
    assert np.abs(masses @ np.cross(positions, velocities) - angular).max() < 1e-9


@pytest.mark.parametrize("masses", [[16.0, 1.0, 1.0], [1.0, 16.0, 16.0]])
@pytest.mark.parametrize("solver", ["auto", "newton", "shake"])
def test_rounding_of_lengths_over_a_short_step_is_no_momentum(solver, masses):
    """Whatever a solver leaves of the lengths, divided by Δt, acts on both atoms of a bond: 16,000 steps leave the rounding of velocities."""
    positions, pairs = water(64)
    masses = np.tile(masses, 64)
    velocities = np.random.default_rng(2).normal(size=positions.shape) / np.sqrt(masses)[:, None]
    bonds = ConstraintSolver(DistanceConstraints(pairs, solver=solver), positions, 1.0 / masses)
    bonds.project_velocities(velocities, positions)
    momentum, angular = masses @ velocities, masses @ np.cross(positions, velocities)
    for _ in range(160):
        for _ in range(100):
            bonds.drift(positions, velocities, 0.0005)
        bonds.project_velocities(velocities, positions)
    terms = masses[:, None] * np.abs(velocities)
    assert np.abs(masses @ velocities - momentum).max() < 5e-15 * terms.sum()  # rounding
    turning = (terms * np.linalg.norm(positions, axis=1)[:, None]).sum()
    assert (
        np.abs(masses @ np.cross(positions, velocities) - angular).max() < 2e-14 * turning
    )  # rounding, of positions too


@pytest.mark.parametrize("name", ["diatomics", "water", "cube", "ring"])
def test_a_drift_satisfies_its_equations(name):
    """M (r′ − r − Δt v) = Gᵀ λ with |r′_ij| = d, solved by SciPy."""
    pairs, positions, velocities, masses = scene(name)
    bonds = ConstraintSolver(DistanceConstraints(pairs), positions, 1.0 / masses)
    bonds.project_velocities(velocities, positions)
    start, speed, duration = positions.copy(), velocities.copy(), 0.02
    bonds.drift(positions, velocities, duration)
    old = start[pairs[:, 1]] - start[pairs[:, 0]]

    def moved(multipliers):
        displaced = start + duration * speed
        np.add.at(displaced, pairs[:, 1], multipliers[:, None] * old / masses[pairs[:, 1], None])
        np.add.at(displaced, pairs[:, 0], -multipliers[:, None] * old / masses[pairs[:, 0], None])
        return displaced

    exact = moved(fsolve(lambda x: bonds_squared(moved(x), pairs) - bonds.lengths**2, np.zeros(len(pairs)), xtol=1e-12))
    assert np.abs(positions - exact).max() < 1e-12
    assert np.abs(velocities - (exact - start) / duration).max() < 1e-10


@pytest.mark.parametrize("solver", ["auto", "newton", "shake"])
@pytest.mark.parametrize("name", ["diatomics", "water", "ring", "rod"])
def test_a_drift_does_not_see_what_a_projection_would_take_from_the_velocities(name, solver):
    """So velocities are projected only where somebody looks."""
    pairs, positions, velocities, masses = scene(name)
    bonds = ConstraintSolver(DistanceConstraints(pairs, tolerance=1e-13, solver=solver), positions, 1.0 / masses)
    others, projected = positions.copy(), velocities.copy()
    bonds.project_velocities(projected, others)
    assert np.abs(projected - velocities).max() > 0.1
    bonds.drift(positions, velocities, 0.01)
    bonds.drift(others, projected, 0.01)
    assert np.abs(positions - others).max() < 1e-13
    assert np.abs(velocities - projected).max() < 1e-11


def bonds_squared(positions, pairs):
    return ((positions[pairs[:, 1]] - positions[pairs[:, 0]]) ** 2).sum(axis=1)


def test_the_middle_of_a_rod_stays_on_the_line_and_does_no_work():
    pairs, positions, velocities, masses = scene("rod")
    bonds = ConstraintSolver(DistanceConstraints(pairs), positions, 1.0 / masses)
    assert bonds.n_constraints == 4  # of nine degrees of freedom five are left
    bonds.project_velocities(velocities, positions)
    energy = masses @ (velocities**2).sum(axis=1)
    for _ in range(1000):
        bonds.drift(positions, velocities, 0.01)
        bonds.project_velocities(velocities, positions)
    along = positions[2] - positions[0]
    assert np.abs(positions[1] - positions[0] - along * 1.16 / 2.5).max() < 1e-14
    assert masses @ (velocities**2).sum(axis=1) == pytest.approx(energy, rel=1e-12)


def test_constraint_forces_hold_a_pendulum():
    """A mass on a fixed pivot: λ d = −(m v²/d + m g cos φ), the tension in closed form."""
    angle, speed, mass, gravity = 0.7, 0.4, 2.0, 9.81
    positions = np.array([[0.0, 0.0, 0.0], [np.sin(angle), 0.0, -np.cos(angle)]])
    velocities = speed * np.array([[0.0, 0.0, 0.0], [np.cos(angle), 0.0, np.sin(angle)]])
    forces = np.array([[0.0, 0.0, 0.0], [0.0, 0.0, -mass * gravity]])
    bonds = ConstraintSolver(DistanceConstraints([[0, 1]]), positions, np.array([0.0, 1.0 / mass]))
    virial = bonds.virial(positions, velocities, forces)
    tension = mass * (speed**2 + gravity * np.cos(angle))
    assert np.trace(virial) == pytest.approx(-tension, rel=1e-14)


@pytest.mark.parametrize("name", ["diatomics", "water", "ring", "cube", "chain", "rod"])
def test_constraint_forces_keep_the_second_derivative_of_every_length_zero(name):
    pairs, positions, velocities, masses = scene(name)
    bonds = ConstraintSolver(DistanceConstraints(pairs), positions, 1.0 / masses)
    bonds.project_velocities(velocities, positions)
    accelerations = np.random.default_rng(5).normal(size=positions.shape)
    bonds.multipliers(positions, velocities, accelerations)
    r, v, a = (x[pairs[:, 1]] - x[pairs[:, 0]] for x in (positions, velocities, accelerations))
    assert np.abs((r * a).sum(axis=1) + (v * v).sum(axis=1)).max() < 1e-12


def test_a_start_that_violates_lengths_is_projected():
    pairs, positions, _, masses = scene("ring")
    lengths = np.linalg.norm(positions[pairs[:, 1]] - positions[pairs[:, 0]], axis=1)
    bonds = ConstraintSolver(DistanceConstraints(pairs, lengths), positions, 1.0 / masses)
    moved = positions + 0.03 * np.random.default_rng(6).normal(size=positions.shape)
    center = masses @ moved
    bonds.project_positions(moved)
    assert bonds.violation(moved).max() < 1e-14
    assert np.abs(masses @ moved - center).max() < 1e-13


def test_bonds_across_a_boundary_are_given_by_offsets():
    positions = np.array([[0.1, 0.0, 0.0], [9.4, 0.2, 0.0]])
    bonds = ConstraintSolver(
        DistanceConstraints([[0, 1]], lengths=0.8), positions, np.ones(2), offsets=np.array([[-10.0, 0.0, 0.0]])
    )
    bonds.project_positions(positions)
    assert np.linalg.norm(positions[1] - positions[0] - [10.0, 0.0, 0.0]) == pytest.approx(0.8, rel=1e-14)


@pytest.mark.parametrize(
    ("pairs", "lengths", "message"),
    [
        (np.empty((0, 2), dtype=int), None, "at least one pair"),
        ([[0.5, 1.0]], None, "atom indices"),
        ([[0, 0]], None, "different atoms"),
        (
            [[2, 1], [0, 1], [1, 0], [1, 2], [0, 1]],
            None,
            r"pairs\[0\] = \[2, 1\] is given 2 times",
        ),  # the first of them, as it is given
        ([[0, 1]], -1.0, "lengths must be positive"),
        ([[0, 99]], None, "atom 99"),
    ],
)
def test_bad_pairs_and_lengths_are_told(pairs, lengths, message):
    with pytest.raises(ValueError, match=message):
        ConstraintSolver(DistanceConstraints(pairs, lengths), cube()[0], np.ones(8))


def test_constraints_that_follow_from_others_are_named():
    corners, pairs = cube()
    with pytest.raises(ValueError, match=r"constraint \d+ \(atoms \d-\d\) follows from the other constraints"):
        ConstraintSolver(DistanceConstraints([*pairs.tolist(), [0, 7]]), corners, np.ones(8))
    with pytest.raises(ValueError, match="held fixed"):
        ConstraintSolver(DistanceConstraints([[0, 1]]), corners, np.zeros(8))
    with pytest.raises(ValueError, match="one of"):
        DistanceConstraints([[0, 1]], solver="lincs")


def test_lengths_of_a_triangle_that_cannot_be_are_refused():
    with pytest.raises(ValueError, match="longer than the sum of the other two"):
        ConstraintSolver(DistanceConstraints([[0, 1], [1, 2], [0, 2]], [1.0, 1.0, 2.5]), water(1)[0], np.ones(3))


@pytest.mark.parametrize("solver", ["auto", "newton", "shake"])
@pytest.mark.parametrize("name", ["diatomics", "water", "ring", "rod"])
def test_a_step_too_long_names_the_bond(name, solver):
    pairs, positions, velocities, masses = scene(name)
    bonds = ConstraintSolver(DistanceConstraints(pairs, solver=solver), positions, 1.0 / masses)
    bonds.project_velocities(velocities, positions)
    with pytest.raises(md.ConstraintError, match=r"constraint \d+ \(atoms \d+-\d+\) cannot be kept in a drift of 50"):
        bonds.drift(positions, velocities, 50.0)


@settings(max_examples=60, deadline=None)
@given(st.integers(2, 30), st.integers(0, 2**32 - 1))
def test_random_connected_graphs_are_kept_to_rounding_or_refused(n_atoms, seed):
    """Trees with some more bonds, masses 1 : 1000, lengths at random: never a hang, never a NaN."""
    rng = np.random.default_rng(seed)
    positions = rng.normal(size=(n_atoms, 3)) * 2.0
    tree = [(int(rng.integers(k)), k) for k in range(1, n_atoms)]
    more = {tuple(sorted(rng.choice(n_atoms, 2, replace=False).tolist())) for _ in range(int(rng.integers(0, n_atoms)))}
    pairs = np.array(tree + sorted(more - set(tree)))
    masses = 10.0 ** rng.uniform(0.0, 3.0, n_atoms)
    try:
        bonds = ConstraintSolver(DistanceConstraints(pairs), positions, 1.0 / masses)
    except ValueError as reason:
        assert "follows from the other constraints" in str(reason)  # noqa: PT017
        return
    velocities = rng.normal(size=positions.shape)
    bonds.project_velocities(velocities, positions)
    for _ in range(5):
        bonds.drift(positions, velocities, 1e-3)
        bonds.project_velocities(velocities, positions)
        assert bonds.violation(positions).max() <= 5.0 * rounding(positions, bonds.lengths)
        assert np.isfinite(velocities).all()


def test_scenes_are_sorted_by_shape():
    assert [
        type(group).__name__
        for group in ConstraintSolver(DistanceConstraints(water(2)[1]), water(2)[0], np.tile([1.0, 0.5, 0.5], 2)).groups
    ] == ["Triangles"]
    assert [
        type(group).__name__ for group in ConstraintSolver(DistanceConstraints(rod()[1]), rod()[0], np.ones(3)).groups
    ] == ["LinearTriatomics"]
    positions = np.concatenate([rod()[0], ring(6)[0] + 9.0, chain(2)[0] - 9.0])
    pairs = np.concatenate([rod()[1], ring(6)[1] + 3, chain(2)[1] + 9])
    bonds = ConstraintSolver(DistanceConstraints(pairs), positions, np.ones(len(positions)))
    assert sorted(type(group).__name__ for group in bonds.groups) == ["LinearTriatomics", "Networks", "Pairs"]
    assert sorted(np.concatenate([group.order for group in bonds.groups])) == list(range(len(pairs)))


@pytest.mark.parametrize("solver", ["auto", "newton", "shake"])
@pytest.mark.parametrize("name", ["diatomics", "water", "rod", "chain", "cube"])
def test_threads_change_no_bit(name, solver):
    pairs, positions, velocities, masses = scene(name)
    n, many = len(positions), 3000 // len(pairs)
    rng = np.random.default_rng(5)
    all_pairs = (pairs + n * np.arange(many)[:, None, None]).reshape(-1, 2)
    start = np.tile(positions, (many, 1)) + np.repeat(rng.normal(size=(many, 3)), n, axis=0)
    results = []
    for threads in (1, 3):
        bonds = ConstraintSolver(
            DistanceConstraints(all_pairs, solver=solver), start, np.tile(1.0 / masses, many), threads=threads
        )
        x, v = (
            start.copy(),
            np.tile(velocities, (many, 1)) * rng.uniform(0.5, 1.0, n * many)[:, None]
            if not results
            else results[0][2].copy(),
        )
        begin = v.copy()
        for _ in range(5):
            bonds.project_velocities(v, x)
            bonds.drift(x, v, 0.01)
        assert bonds.violation(x).max() < 1e-11
        assert (np.abs(x - start).max(axis=1) > 0.0).all()  # no component was left out
        results.append((x, v, begin))
    assert np.array_equal(results[0][0], results[1][0])
    assert np.array_equal(results[0][1], results[1][1])


def test_the_first_component_that_fails_is_told_by_any_number_of_threads():
    positions = np.zeros((6000, 3))
    positions[:, 0] = np.arange(6000)
    velocities = np.zeros_like(positions)
    velocities[[4001, 5001], 1] = 1e3
    pairs = np.arange(6000).reshape(-1, 2)
    bonds = ConstraintSolver(DistanceConstraints(pairs), positions, np.ones(6000), threads=3)
    with pytest.raises(md.ConstraintError, match=r"constraint 2000 \(atoms 4000-4001\)"):
        bonds.drift(positions, velocities, 1.0)
