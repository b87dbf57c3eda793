"""Hybrid Monte Carlo: exact chances, detailed balance as an identity of whole numbers, and averages without an error of
the time step."""

from decimal import Decimal, localcontext
from fractions import Fraction
from itertools import product

import numpy as np
import pytest
from scenes import SCENES
from scipy import stats
from wrong_calls import answered

import minimd as md
from minimd.core.compiled.normal_numbers import philox
from minimd.core.engine.proposals import Proposals
from minimd.core.integrators import exact_chances as chances
from minimd.core.structure.errors import RangeError
from minimd.core.structure.statistics import mean_and_error

T = 1.3
HMC = md.HybridMonteCarlo(0.01, T, seed=5, n_steps=10)


def soft(r2, a, b):
    """a/(1 + r²)³ − b/(1 + r²): finite where atoms meet."""
    c = 1.0 / (1.0 + r2)
    return a * c**3 - b * c, 2.0 * (3.0 * a * c**4 - b * c**2)


def two_atoms(size, spacing=0.5, timestep=1.0, n_steps=3):
    """Masses 2 and 3 on a line of few places, where half of all displacements lie between two of them."""
    law = md.PairPotential(soft, (6.0, 4.0), cutoff=0.45 * size * spacing, truncation="truncated")
    system = md.System([[0.0, 0.0, 0.0], [2.0, 0.0, 0.0]], cell=[size * spacing] * 3, masses=[2.0, 3.0])
    grid = md.Grid(length=spacing, momentum=0.5, energy=2.0**-3)
    method = md.HybridMonteCarlo(timestep, 2.0, 1, n_steps)
    return md.Simulation(system, law, method, precision="fixed-point", grid=grid, threads=1)


def whole(sim):
    """The state of two atoms: places modulo the cell, and momenta, in steps."""
    grid = sim.engine.interactions.grid
    places = np.rint(sim.positions[:, 0] / grid.length) % (sim.system.cell.vectors[0, 0] / grid.length)
    momenta = np.rint(sim.velocities[:, 0] * sim.system.masses / grid.momentum)
    return tuple(map(int, (*places, *momenta)))


def survey(size, most, n_steps=3):
    """Where each state of two atoms goes if its trajectory is accepted, with momenta turned round, and its H/k_B T."""
    sim = two_atoms(size, n_steps=n_steps)
    engine = sim.engine
    grid = engine.interactions.grid
    engine.begin()
    _, proposals = engine._own_steps
    states = [*product(range(size), range(size), *2 * [range(-most, most + 1)])]
    to, levels = {}, {}

    def put(x):
        sim.positions[:, 0] = np.array(x[:2]) * grid.length
        sim.velocities[:, 0] = np.array(x[2:]) * grid.momentum / sim.system.masses
        engine.changed()

    for x in states:
        put(x)
        levels[x] = proposals.level(0, engine.evaluate().potential_energy)
        assert whole(sim) == x
        assert engine._trajectory() is not None
        a, b, p, q = whole(sim)
        to[x] = (a, b, -p, -q)
    return to, levels


def check_balance(to, levels):
    """π_i P_ij = π_j P_ji for all pairs, as whole powers of e^(−1/k_B T); returns how many pairs were unequal."""
    wrong = 0
    for x, y in to.items():
        if y in to:
            there = max(levels[x], levels[y])  # π_i min(1, π_j/π_i) = e^(−max)
            wrong += to[y] != x or there != max(levels[y], levels[to[y]])
    return wrong


def places_reached(to):
    """How many pairs of places are joined by trajectories."""
    near = {}
    for x, y in to.items():
        near.setdefault(x[:2], set()).add(y[:2])
    seen, left = {(0, 0)}, [(0, 0)]
    while left:
        for place in near[left.pop()] - seen:
            seen.add(place)
            left.append(place)
    return len(seen)


@pytest.mark.parametrize(("size", "most"), [(5, 2), pytest.param(16, 7, marks=pytest.mark.slow)])
def test_detailed_balance_is_an_identity_of_whole_numbers(size, most):
    """All states of two atoms: every trajectory is undone by itself, and H is a rational number."""
    to, levels = survey(size, most)
    assert all(isinstance(level, Fraction) for level in levels.values())
    assert sum(y in to and y != x for x, y in to.items()) > 0.4 * len(to)
    assert check_balance(to, levels) == 0
    assert places_reached(to) == size * size


def test_a_drift_that_is_rounded_down_breaks_detailed_balance(monkeypatch):
    """The survey sees it; the engine's steps as they are, followed by a move of one place, are no map of their own
    inverse."""
    of_engine = md.core.engine.engine.Engine._trajectory

    def skewed(engine):
        is_complete = of_engine(engine)
        engine.positions[:, 0] += engine.interactions.grid.length * (engine.velocities[:, 0] > 0.0)
        return is_complete

    monkeypatch.setattr(md.core.engine.engine.Engine, "_trajectory", skewed)
    assert check_balance(*survey(6, 1)) > 30


@pytest.mark.parametrize("x", ["1/3", "1", "12345678901234567/36028797018963968", "41/2", "1/99999999999999999999"])
@pytest.mark.parametrize("bits", [8, 72, 200])
def test_bounds_enclose_the_exponential(x, bits):
    x = Fraction(x)
    low, high = chances.bounds_of_exp(x, bits)
    with localcontext(prec=150):
        exact = (-Decimal(x.numerator) / Decimal(x.denominator)).exp() * Decimal(2) ** bits
    assert low <= exact <= high
    assert high - low <= 2


def test_decisions_have_their_probability():
    words = philox(7, 0, 0).bit_generator.random_raw
    for x in (Fraction(1, 7), Fraction(1), Fraction(5, 2)):
        seen = np.mean([chances.happens(x, words) for _ in range(20_000)])
        p = np.exp(-float(x))
        assert abs(seen - p) < 4.0 * (p * (1.0 - p) / 20_000) ** 0.5
    assert chances.happens(Fraction(0), None)  # without a word
    near = chances.bounds_of_exp(Fraction(1), 64)[0]  # the first word does not decide
    for further, expected in ((0, True), (2**64 - 1, False)):
        given = iter([near, further])
        assert chances.happens(Fraction(1), lambda: next(given)) is expected


@pytest.mark.parametrize("s", [1, 2, 3, 7, 50])
def test_whole_normal_numbers_have_their_distribution(s):
    n = 200_000
    y = chances.whole_normals(11, 3, np.full(n // 3, s), 3)[:, :].ravel()
    values = np.arange(-12 * s, 12 * s + 1)
    expected = np.exp(-0.5 * (values / s) ** 2)
    expected *= len(y) / expected.sum()
    keep = expected > 5.0
    seen = np.bincount(y + 12 * s, minlength=len(values))
    square = ((seen - expected)[keep] ** 2 / expected[keep]).sum()
    assert stats.chi2.sf(square, keep.sum() - 1) > 1e-4


def test_floating_point_decides_as_whole_numbers_do():
    """With a wide margin whole numbers decide about a tenth, from the same words."""
    widths = np.tile([3 * 2**45 + 12345, 2, 1, 0], 100)
    fast = chances.whole_normals(2**70 + 5, -3, widths, 2)
    np.testing.assert_array_equal(fast, chances.whole_normals(2**70 + 5, -3, widths, 2, margin=0.05))
    assert not fast[widths == 0].any()
    assert not fast[:, 2].any()
    words = [philox(2**70 + 5, 0, -3, atom).bit_generator.random_raw for atom in (0, 1)]
    assert fast[:2, 0].tolist() == [chances.whole_normal(int(s), of) for s, of in zip(widths, words, strict=False)]


def test_a_rotation_of_whole_numbers_is_undone():
    rng = np.random.default_rng(1)
    p, q = (np.rint(2.0**44 * rng.standard_normal((50, 3))) for _ in range(2))
    turned, other = chances.rotated(p, q, 0.8)
    back, own = chances.rotated(turned, -other, 0.8)
    np.testing.assert_array_equal([back, -own], [p, q])
    np.testing.assert_allclose(turned, 0.8 * p + 0.6 * q, atol=2.0)


@pytest.mark.parametrize(
    ("precision", "friction"),
    [
        ("double", None),
        ("fixed-point", 2.0),
        pytest.param("double", 2.0, marks=pytest.mark.slow),
        pytest.param("fixed-point", None, marks=pytest.mark.slow),
    ],
)
def test_averages_have_no_error_of_the_time_step(precision, friction):
    """Oscillators with ωΔt = 0.8, where LangevinBAOAB has kinetic energies too low by 16 %."""
    n = 12
    masses = np.tile([1.0, 2.0], n // 2)
    sim = md.Simulation(
        md.System(np.zeros((n, 3)), masses=masses),
        md.Restraint(k=1.0, points=np.zeros((n, 3))),
        md.HybridMonteCarlo(0.8, T, seed=3, n_steps=2, friction=friction),
        precision=precision,
        threads=1,
    )
    sim.make_steps(200)
    record = sim.run(5000, every=2, progress=False)
    for energy in (record.kinetic_energy, record.potential_energy):
        mean, error = mean_and_error(energy / n)
        assert error < 0.06 * T
        assert abs(mean - 1.5 * T) < 4.5 * error
    assert 0.05 < sim.method.acceptance < 0.9
    mean, error = sim.method.mean_weight
    assert abs(mean - 1.0) < 5.0 * error
    assert "proposals" in str(sim.report())


def test_the_time_step_finds_itself():
    """From one that is far too short and one that is too long, to the same one."""
    found = []
    for timestep in (0.002, 0.03):
        sim = SCENES["argon"]().simulation(md.HybridMonteCarlo(timestep, T, 3, n_steps=5))
        sim.equilibrate(600, T)
        assert sim.method.memory.sum() == 0.0
        sim.make_steps(200)
        assert 0.65 < sim.method.acceptance < 0.95
        found.append(sim.method.timestep)
    assert found[0] == pytest.approx(found[1], rel=0.3)


def test_volumes_are_accepted_by_the_isothermal_isobaric_ensemble():
    """N atoms without forces at P and T: ⟨V⟩ = (N + 1) k_B T/P, standard deviation √(N + 1) k_B T/P; with a barostat
    that alone makes fluctuations too large by 16 %, and says so."""
    n, pressure, tau = 60, 0.5, 0.03
    edge = (n * T / pressure) ** (1 / 3)
    sim = md.Simulation(
        md.System(np.random.default_rng(4).uniform(0.0, edge, (n, 3)), cell=edge),
        md.LennardJones(0.0, 1.0, cutoff=0.5, truncation="shifted"),
        md.HybridMonteCarlo(0.01, T, 6, n_steps=1),
        barostat=md.StochasticCellRescaling(pressure, 1.0 / pressure, tau, seed=9, every=1),
        threads=1,
    )
    sim.make_steps(300)
    with pytest.warns(UserWarning, match="too long for its relaxation_time"):
        volume = sim.run(5000, every=1, progress=False).volume
    mean, error = mean_and_error(volume)
    assert error < 1.0
    assert abs(mean - (n + 1) * T / pressure) < 4.5 * error
    assert volume.std() == pytest.approx((n + 1) ** 0.5 * T / pressure, rel=0.06)
    assert (np.diff(volume) == 0.0).mean() > 0.05  # some are rejected


@pytest.mark.parametrize("precision", ["double", "fixed-point"])
def test_threads_and_skins_change_no_bit_of_a_chain(precision):
    """Of floating point, threads; of fixed point also the lists."""
    skins = [None, 0.1 if precision == "fixed-point" else None]
    ends = []
    for threads, skin in zip((1, 3), skins, strict=False):
        method = md.HybridMonteCarlo(0.02, T, 3, n_steps=3, friction=1.0)
        sim = SCENES["argon"]().simulation(method, threads=threads, skin=skin, precision=precision)
        sim.make_steps(40)
        assert 0.0 < method.acceptance < 1.0
        ends.append((sim.positions.copy(), sim.velocities.copy(), method.memory.copy()))
    for other in ends[1:]:
        for one, same in zip(ends[0], other, strict=True):
            np.testing.assert_array_equal(one, same)


def test_a_trajectory_that_is_stopped_leaves_the_state_before_it():
    sim = SCENES["argon"]().simulation(md.HybridMonteCarlo(0.01, T, 3, n_steps=50))
    sim.make_steps(2)
    before = sim.positions.copy(), sim.velocities.copy(), sim.engine.reservoir_energy
    sim.engine.surroundings.stop_requested = True
    with pytest.raises(KeyboardInterrupt):
        sim.make_steps(3)
    assert sim.step == 2
    np.testing.assert_array_equal(sim.positions, before[0])
    np.testing.assert_array_equal(sim.velocities, before[1])
    assert sim.engine.reservoir_energy == before[2]


def test_an_energy_that_changes_from_cell_to_cell_ends_the_run(monkeypatch):
    """Once in a thousand proposals it is asked, here at the first: an energy that knows in which cell atom 0 is."""
    sim = SCENES["argon"]().simulation(md.HybridMonteCarlo(0.002, T, 3), precision="fixed-point")
    evaluate, edge = md.core.engine.engine.Engine._evaluate, sim.system.cell.vectors[0, 0]

    def told(engine, step):
        sums = evaluate(engine, step)
        return sums._replace(potential_energy=sums.potential_energy + 2.0**-10 * (engine.positions[0, 0] > edge))

    monkeypatch.setattr(md.core.engine.engine.Engine, "_evaluate", told)
    with pytest.raises(RuntimeError, match="moved by lattice vectors"):
        sim.make_steps(1)


def test_a_trajectory_that_does_not_come_back_ends_the_run(monkeypatch):
    sim = SCENES["argon"]().simulation(md.HybridMonteCarlo(0.002, T, 3), precision="fixed-point")
    go = md.core.engine.engine.Engine._trajectory

    def skewed(engine):
        is_complete = go(engine)
        engine.positions[0, 0] += engine.interactions.grid.length
        return is_complete

    monkeypatch.setattr(md.core.engine.engine.Engine, "_trajectory", skewed)
    with pytest.raises(RuntimeError, match=r"ends .* from its start"):
        sim.make_steps(1)


class Lagging(md.Term):
    """A spring whose force has a part of the last one, as that of an iteration that begins with its last result."""

    acts_from_outside, is_checked = True, False
    before = 0.0

    def bind(self, system):
        return self

    def add(self, system, detail, forces, energies, virials):
        now = -system.positions.copy()
        forces += 0.97 * now + 0.03 * self.before
        self.before = now
        if len(energies):
            energies[0] += 0.5 * (system.positions**2).sum()


def test_forces_that_are_no_function_of_the_positions_end_the_run():
    system = md.System(np.random.default_rng(1).normal(size=(5, 3)))
    sim = md.Simulation(system, Lagging(), md.HybridMonteCarlo(0.1, T, 3), threads=1)
    sim.step = 999
    sim.make_steps(1)
    with pytest.raises(RuntimeError, match="forces computed twice differ by"):
        sim.make_steps(1)


@pytest.mark.parametrize(("timestep", "verdict"), [(0.2, "as theory says"), (1.9, "few are accepted")])
def test_the_report_tells_whether_few_are_accepted(timestep, verdict):
    system = md.System(np.zeros((100, 3)))
    sim = md.Simulation(system, md.Restraint(1.0, np.zeros((100, 3))), md.HybridMonteCarlo(timestep, T, 3), threads=1)
    sim.run(50, every=1, progress=False)
    assert verdict in str(sim.report())


def test_a_trajectory_to_infinity_is_not_accepted():
    sim = SCENES["argon"]().simulation(md.HybridMonteCarlo(0.3, T, 3), threads=1)
    before = sim.positions.copy()
    sim.make_steps(5)
    assert sim.method.acceptance == 0.0
    np.testing.assert_array_equal(sim.positions, before)


def test_a_proposal_that_was_stopped_changes_no_bit_of_those_to_come(monkeypatch):
    whole, stopped = (SCENES["argon"]().simulation(md.HybridMonteCarlo(0.01, T, 3), threads=1) for _ in range(2))
    whole.make_steps(12)
    stopped.make_steps(3)
    advance = md.core.integrators.steps.Steps.advance

    def halfway(steps, n_steps, *rest):
        stopped.engine.surroundings.stop_requested = n_steps > 1
        return advance(steps, n_steps // 2, *rest)

    monkeypatch.setattr(md.core.integrators.steps.Steps, "advance", halfway)
    with pytest.raises(KeyboardInterrupt):
        stopped.make_steps(9)
    monkeypatch.undo()
    stopped.engine.surroundings.stop_requested = False
    stopped.make_steps(9)
    np.testing.assert_array_equal(stopped.positions, whole.positions)
    np.testing.assert_array_equal(stopped.method.memory, whole.method.memory)


def test_rigid_bonds_are_sampled_in_float64():
    """Of n rigid dumbbells, 5n degrees of freedom are thermal."""
    sim = SCENES["dumbbells"]().simulation(md.HybridMonteCarlo(0.008, T, 3, n_steps=5))
    sim.make_steps(100)
    kinetic = sim.run(2000, every=2, progress=False).kinetic_energy
    mean, error = mean_and_error(kinetic)
    assert abs(mean - 0.5 * sim.n_dof * T) < 4.5 * error
    assert error < 0.01 * mean
    assert sim.method.acceptance > 0.3


def rigid():
    return SCENES["dumbbells"]().simulation(HMC, precision="fixed-point")


def seen_in_time():
    sim = SCENES["argon"]().simulation(md.HybridMonteCarlo(0.01, T, seed=5))
    sim.run(10, observers=[md.observers.MeanSquareDisplacement(every=1)])


def beside(force, cell=None, **options):
    sim = md.Simulation(md.System(np.zeros((1, 3)), cell=cell), force, HMC, threads=1, **options)
    sim.make_steps(1)


def coarse():
    sim = two_atoms(8, timestep=16.0)
    sim.make_steps(1)


MOVING = md.SteeredSpring(1.0, points=[0, 0, 0], velocity=[1.0, 0, 0], start=0.0, end=9.0)
test_what_cannot_be_sampled_is_answered = answered(
    (lambda: md.HybridMonteCarlo(0.01, 0.0, 1), ValueError, "temperature", "0.0"),
    (lambda: md.HybridMonteCarlo(0.01, T, 1, friction=0.0), ValueError, "friction", "0.0"),
    (lambda: md.HybridMonteCarlo(0.01, T, 1, n_steps=0), ValueError, "n_steps", "0"),
    (lambda: HMC.advance(None, None, 1), TypeError, "Simulation"),
    (lambda: rigid().make_steps(1), ValueError, "rigid bonds", "precision='double'"),
    (seen_in_time, ValueError, "mean-square-displacement", "LangevinBAOAB"),
    (lambda: beside(MOVING), ValueError, "depend on time"),
    (lambda: beside(md.ConstantForce([1.0, 0, 0]), [3.0, 4.0, 5.0]), ValueError, "along a", "pbc"),
    (coarse, ValueError, "too coarse", "0.5"),
)


def test_momenta_beyond_the_grid_end_the_run():
    sim = two_atoms(8)
    sim.engine.begin()
    sim.velocities[:, 0] = 2.0**50
    with pytest.raises(RangeError):
        sim.make_steps(1)


def test_proposals_are_made_anew_with_what_they_depend_on():
    sim = SCENES["argon"]().simulation(md.HybridMonteCarlo(0.01, T, seed=5))
    _, first = sim.engine._own_steps
    assert isinstance(first, Proposals)
    assert sim.engine._own_steps[1] is first
    sim.method.timestep = 0.005
    assert sim.engine._own_steps[1] is not first
    sim.method = md.VelocityVerlet(0.005)
    assert sim.engine._own_steps[1] is None
