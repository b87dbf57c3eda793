"""Advice on the time step, which is where runs blow up; and hints before the first step: what is odd."""

import re
import warnings
from time import time_ns

import numpy as np
import pytest
import scipy.linalg
from argon_atoms import argon, lennard_jones, with_calculator
from ase.md.velocitydistribution import Stationary, thermalize_momenta
from references import liquid
from rigid_scenes import SCENES as GRAPHS
from scenes import BONDED, LJ, OPEN, SCENES
from step_scenes import MINIMA, at_minimum, diatomic, fcc, longest_stable_step
from wrong_calls import assert_answered

import minimd as md
import minimd.ase
from minimd.compiled.kernels import compile_clock
from minimd.diagnosis.first_hints import _long_timestep, too_long_a_step
from minimd.engine.engine import Engine
from minimd.integrators import SPLITTINGS, THERMOSTATS, SecondOrder, energy_oscillation, run_steps, stability_limit
from minimd.integrators.splitting.substeps import repeated
from minimd.structure.lattice import crystal

OTHERS = md.integrators.PEFRL, md.integrators.Ruth3, md.integrators.KahanLi6, md.PositionVerlet
STEPS = [
    pytest.param(name, method, marks=[pytest.mark.slow] * (name == "mixture" or method is md.integrators.KahanLi6))
    for name, method in [*((name, md.VelocityVerlet) for name in MINIMA), *(("fcc crystal", one) for one in OTHERS)]
]


@pytest.mark.parametrize(("name", "method"), STEPS)
def test_the_longest_stable_step_is_the_one_advised(name, method):
    state = at_minimum(MINIMA[name])
    limit = md.advise_timestep(*state, method=method).limit
    # truncation: six bisections of ±20 %
    assert longest_stable_step(state, method, limit) == pytest.approx(limit, rel=0.01)


@pytest.mark.parametrize("method", SPLITTINGS.values(), ids=lambda method: method.name)
def test_an_oscillator_is_bounded_below_the_limit_and_not_above_and_its_energy_swings_as_told(method):
    """By the matrix of a step, which is linear: its eigenvalues, and the energies along a path."""

    def step(h):
        starts = ([1.0], [0.0]), ([0.0], [1.0])
        paths = [run_steps(SecondOrder(lambda q: -q), method(h), start, 1) for start in starts]
        return np.array([[path.q[-1, 0], path.v[-1, 0]] for path in paths]).T

    limit = stability_limit(method.sequence())
    for h in np.linspace(0.05, 0.999, 20) * limit:
        assert np.abs(np.linalg.eigvals(step(h))).max() < 1.0 + 1e-7
    assert np.abs(np.linalg.eigvals(step(1.001 * limit))).max() > 1.001  # 1.002 for blanes-moan-rkn-4
    path, matrix = [np.array([1.0, 0.3])], step(0.4 * limit)
    for _ in range(5000):
        path.append(matrix @ path[-1])
    energies = 0.5 * np.square(path).sum(axis=1)
    swing = (energies.max() - energies.min()) / (energies.max() + energies.min())
    # the path does not meet the axes exactly
    assert energy_oscillation(method.sequence(), 0.4 * limit) == pytest.approx(swing, rel=2e-3)


def test_limits_and_recommendations_that_are_known():
    """A contact with a bath changes no limit; the recommended step swings the energy by 1/80."""
    for method in (md.VelocityVerlet, *THERMOSTATS.values()):
        assert stability_limit(method.sequence()) == pytest.approx(2.0, abs=1e-14)  # rounding
    twice = repeated(md.VelocityVerlet.sequence(), (0.5, 0.5))  # tr M touches −2 at h = 2√2, where nothing happens
    assert stability_limit(twice) == pytest.approx(4.0, rel=1e-6)
    advice = md.advise_timestep(*diatomic())
    h = advice.frequency * advice.recommended
    assert advice.period / advice.recommended == pytest.approx(20.0, rel=1e-3)
    swing = energy_oscillation(md.VelocityVerlet.sequence(), h)
    assert swing == pytest.approx(1.0 / 80.0, rel=1e-9)
    assert swing == pytest.approx(h**2 / (8.0 - h**2), rel=1e-9)
    euler = md.advise_timestep(*diatomic(), method=md.integrators.SE1)
    assert euler.recommended * euler.frequency / 2.0 == pytest.approx(1.0 / 80.0, rel=1e-6)  # symplectic Euler: h/2


def row_of_beads():
    """ω = 2 √(k/m) cos(π/2N)."""
    k = np.arange(40)
    system = md.System(np.column_stack([k, 0 * k, 0 * k]), masses=2.0, bonds=np.column_stack([k[:-1], k[1:]]))
    return system, md.HarmonicBond(50.0, 1.0), (), 2.0 * np.sqrt(50.0 / 2.0) * np.cos(np.pi / 80.0)


def dimer():
    """ω² = u″(r₀)/μ at r₀ = 2^(1/6)."""
    u2 = 4.0 * (12 * 13 * 2 ** (-14 / 6) - 6 * 7 * 2 ** (-8 / 6))
    system = md.System([[0.0, 0.0, 0.0], [2 ** (1 / 6), 0.0, 0.0]], masses=[1.0, 3.0])
    return system, OPEN, (), np.sqrt(u2 * 4.0 / 3.0)


def pulled_pendulum():
    """Length 1, a spring of rest length ½ to an anchor at distance 2: its tension stiffens, ω² = 1.5 k (1 + 1/2)/m."""
    system = md.System([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [3.0, 0.0, 0.0]], masses=[1.0, 2.0, 1.0])
    held = [md.DistanceConstraints([[0, 1]]), md.FixedAtoms([0, 2])]
    return system, md.HarmonicBond(40.0, 0.5, pairs=[[1, 2]]), held, np.sqrt(60.0 * 1.5 / 2.0)


def rigid_triangle():
    """It cannot oscillate, however hard its atoms push each other: rounding is not taken for a mode."""
    system = md.System(np.array([[0.0, 0, 0], [0.9, 0, 0], [0.45, 0.78, 0]]))
    return system, OPEN, md.DistanceConstraints([[0, 1], [1, 2], [0, 2]]), 0.0


def free(n_atoms):
    return md.System(np.outer(np.arange(n_atoms), [5.0, 0.0, 0.0])), LJ, (), 0.0


KNOWN = [row_of_beads, dimer, pulled_pendulum, rigid_triangle, lambda: free(2), lambda: free(64)]


@pytest.mark.parametrize("make", KNOWN)
def test_frequencies_are_the_closed_forms(make):
    *scene, frequency = make()
    advice = md.advise_timestep(*scene)
    assert advice.frequency == pytest.approx(frequency, rel=1e-4 if make is row_of_beads else 1e-7)  # ACCURACY
    if make is pulled_pendulum:
        assert advice.atoms == (1,)
    if frequency == 0.0:
        assert advice.limit == advice.recommended == np.inf
        assert "nothing oscillates" in str(advice)


def reduced_frequency(system, law, quadratic, linear):
    """The highest frequency of M^−1/2 (∇²U − Σ λ ∇²g) M^−1/2 on the null space of all ∇g, by dense algebra.

    quadratic : pairs (i, j), each with g = ½ (r_ij² − d²).  linear : rows (3N,) whose product with r is constant.
    """
    n, x = 3 * len(system), system.positions.ravel().copy()

    def forces(y):
        return md.evaluate(md.System(y.reshape(-1, 3), bonds=system.bonds), law).forces.ravel()

    hessian = np.array([forces(x - 1e-6 * e) - forces(x + 1e-6 * e) for e in np.eye(n)]) / 2e-6
    curvatures = []
    for i, j in quadratic:
        b = np.zeros((3, n))
        b[:, 3 * j : 3 * j + 3], b[:, 3 * i : 3 * i + 3] = np.eye(3), -np.eye(3)
        curvatures.append(b.T @ b)
    gradients = np.array([*(g @ x for g in curvatures), *linear])
    root = 1.0 / np.sqrt(np.repeat(system.masses, 3))
    at_rest = np.linalg.lstsq((gradients * root).T, -forces(x) * root, rcond=None)[0]  # M⁻¹(F + λ ∇g) keeps g
    lagrangian = hessian - np.einsum("k,kab->ab", at_rest[: len(curvatures)], np.array(curvatures))
    allowed = scipy.linalg.null_space(gradients * root)
    return np.sqrt(np.linalg.eigvalsh(allowed.T @ (root[:, None] * lagrangian * root) @ allowed)[-1])


@pytest.mark.parametrize("shape", ["water", "chain", "ring", "cube", "rod"])
def test_frequencies_with_constraints_are_those_of_the_reduced_problem(shape):
    one, pairs, masses = GRAPHS[shape]
    one, pairs, masses = (one[:9], pairs[:8], masses[:9]) if shape == "chain" else (one, pairs, masses)
    positions, pairs = np.concatenate([one, one + np.array([0.7, 1.5, 1.2])]), np.concatenate([pairs, pairs + len(one)])
    system = md.System(positions, masses=np.tile(masses, 2), bonds=pairs)
    law, quadratic, linear = md.LennardJones(1.0, 0.9), pairs.tolist(), []
    if shape == "rod":  # its ends are atoms 0 and 2, the middle one lies at 1.16 of 2.5 between them
        quadratic = [[0, 2], [3, 5]]
        for start, c in np.ndindex(2, 3):
            row = np.zeros(18)
            row[3 * (3 * start + np.arange(3)) + c] = 1.16 / 2.5 - 1.0, 1.0, -1.16 / 2.5
            linear.append(row)
    frequency = md.advise_timestep(system, law, md.DistanceConstraints(pairs)).frequency
    assert frequency == pytest.approx(reduced_frequency(system, law, quadratic, linear), rel=1e-4)  # ACCURACY


def test_rigid_bonds_do_not_oscillate():
    system, law, rigid = SCENES["dumbbells"]()[:3]
    stiff = [*law, md.HarmonicBond(1e6, 0.5)]
    alone = md.advise_timestep(system, law, rigid).frequency
    assert md.advise_timestep(system, stiff, rigid).frequency == pytest.approx(alone, rel=1e-3)
    assert md.advise_timestep(system, stiff, ()).frequency > 1000.0


def test_the_stiffest_bond_is_named():
    stiffness = np.full(11, 100.0)
    stiffness[4] = 5000.0
    bonds = md.HarmonicBond(stiffness, 1.0)
    advice = md.advise_timestep(SCENES["chain"]().system, bonds, method=md.VelocityVerlet(0.01))
    assert advice.bond == (4, 5)
    assert set(advice.atoms) == {4, 5}
    assert sum(advice.shares) == pytest.approx(1.0, abs=0.02)
    for words in ("the bond of atoms 4 and 5", "velocity-verlet", "20 steps a period", "0.01 τ", "of the limit"):
        assert words in str(advice)


def test_advice_leaves_the_system_alone_and_sees_far_atoms():
    system, law, _ = fcc()
    before = system.positions.copy()
    here = md.advise_timestep(system, law)
    assert np.array_equal(system.positions, before)
    system.positions += 1000.0 * np.array([5.0, -7.0, 3.0])
    assert md.advise_timestep(system, law).frequency == pytest.approx(here.frequency, rel=1e-3)


def test_what_cannot_be_advised_is_refused():
    system = md.System([[0.0, 0.0, 0.0], [0.0, 0.0, 0.0]])
    assert_answered(lambda: md.advise_timestep(system, OPEN), md.NonFiniteError, "atoms 0 and 1", "0 σ apart")
    assert_answered(lambda: md.advise_timestep(system, OPEN, method=0.01), TypeError, "method", "0.01")


def test_a_crystal_that_will_melt_is_given_the_step_of_collisions():
    """At T* 1.44 the step of the modes alone blows up; the hint of a run names the same step as the advice."""
    positions, edges = crystal("fcc", [4, 4, 4], 1.68)
    system, law = md.System(positions, cell=edges), md.LennardJones(1.0, 1.0, 2.5, truncation="force-shifted")
    cold = md.advise_timestep(system, law)
    assert cold.harmonic == pytest.approx(0.0285, rel=0.01)
    assert cold.recommended == cold.collision == pytest.approx(0.00588, rel=0.01)
    assert "collisions of Lennard-Jones atoms" in str(cold)
    sim = md.Simulation(system, law, md.VelocityVerlet(cold.harmonic))
    sim.set_temperature(1.44, seed=1)
    hot = md.advise_timestep(sim.system, law)
    assert hot.recommended == pytest.approx(0.00507, rel=0.01)  # ω 5.8 times that of a pair
    with pytest.warns(UserWarning, match=f"up to {md.units.LJ.shown(hot.recommended)}; see advise_timestep"):
        sim.run(1)


def test_a_hydrogen_inside_its_oxygen_does_not_collide():
    places, species = [[0.0, 0, 0], [1.0, 0, 0], [4.0, 0, 0], [5.0, 0, 0]], ["O", "H", "O", "H"]
    system, held = md.System(places, masses=[16.0, 1.0] * 2, species=species), md.DistanceConstraints([[0, 1], [2, 3]])
    inside, alone = (md.LennardJones({"O": (1.0, 3.0), "H": (depth, 0.4)}) for depth in (0.3, 0.0))
    collision = md.advise_timestep(system, alone, held).collision
    assert md.advise_timestep(system, inside, held).collision == pytest.approx(collision, rel=1e-12)
    assert md.advise_timestep(system, inside).collision < 0.1 * collision


FS, ARGON = md.units.fs, md.LennardJones(0.0103, 3.4, 8.5, "force-shifted")
BAROSTAT = md.StochasticCellRescaling(1.0, 1.0, 40.0, seed=1, temperature=80.0, every=5)


def hints_of(system, potentials, method=0.004, barostat=None, constraints=(), **options):
    """The warnings of a run of one step, by velocity Verlet if a time step is given."""
    method = md.VelocityVerlet(method) if isinstance(method, float) else method
    with warnings.catch_warnings(record=True) as told:
        warnings.simplefilter("always")
        simulation = md.Simulation(system, potentials, method, constraints, barostat=barostat, **options)
        simulation.run(1)
        simulation.run(1)  # what was told is told once
    assert {one.filename for one in told} <= {__file__}  # the line of the user
    return [str(one.message) for one in told]


def like(system, **changes):
    """The same places in the same cell."""
    return md.System(system.positions, **{"velocities": system.velocities, "cell": system.cell} | changes)


def argon_crystal(constant=5.4):
    positions, edges = crystal("fcc", [4] * 3, constant)
    return md.System(positions, cell=edges, masses=39.95, units=md.units.ASE)


def sparse():
    positions, edges = crystal("fcc", (3, 3, 3), 5.4)
    return md.System(positions, cell=edges)


def with_depth(epsilon, sigma=3.4):
    law = md.LennardJones(epsilon, sigma, 2.2 * sigma, "force-shifted")
    return argon_crystal(5.4 * sigma / 3.4), law, 0.5 * FS


def flowing():
    system = liquid(3)
    return like(system, velocities=system.velocities + np.array([0.3, 0.0, 0.4]))


BOND = diatomic()[:2]  # 2/ω = 0.1789
CORNERS = np.array([[1, 1, 1], [1, -1, -1], [-1, 1, -1], [-1, -1, 1]]) / np.sqrt(8.0)
APEX = md.System(np.vstack([CORNERS, CORNERS[1] + CORNERS[2] + CORNERS[3]]))  # a fifth atom, held by three lengths
HELD = [[0, 1], [0, 2], [1, 2], [0, 3], [1, 3], [2, 3], [1, 4], [2, 4], [3, 4]]


def across(i, j):
    """A stiff bond at its rest length."""
    length = float(np.linalg.norm(APEX.positions[j] - APEX.positions[i]))
    return md.HarmonicBond(1e6, length, pairs=[[i, j]])


def long_step():
    return f"well up to {md.units.LJ.shown(md.advise_timestep(liquid(3), LJ).collision)}; see advise_timestep"


HINTS = {  # scene, and what is said
    "a sound scene": (lambda: (liquid(3), LJ), None),
    "lengths in another unit": (lambda: (sparse(), LJ), "no two atoms are within the cutoff, 1.8 σ: .*3.82 σ apart"),
    "a single atom": (lambda: (md.System([[0.0, 0.0, 0.0]]), LJ), None),
    "a step that is short enough": (lambda: (liquid(3), LJ, 0.018), None),
    "a long step": (lambda: (liquid(3), LJ, 0.022), long_step),
    "a step long for lighter atoms": (lambda: (like(liquid(3), masses=4.0), LJ, 0.022), None),
    "a step in seconds": (lambda: (argon_crystal(), ARGON, 5e-15), r"check its unit, such as 5 \* md.units.fs"),
    "a step no slip makes": (lambda: (argon_crystal(), ARGON, 1e-100), None),  # as in ASE's own tests
    "a center that moves": (lambda: (flowing(), LJ), "center of mass.*0.5 σ/τ"),
    "a pressure in bar": (lambda: (argon_crystal(), ARGON, 0.4, BAROSTAT), r"is 1.6e\+06 bar; .* 1 \* md.units.BAR"),
    "a depth in K": (lambda: with_depth(120.0), r"^epsilon = 120 eV .* 0.0103 eV, epsilon=120 \* md.units.ASE.k_B"),
    "a depth in kJ/mol": (lambda: with_depth(0.997), "^epsilon = 0.997 eV .* 0.0103 eV, epsilon=0.997 / md.units.KJ_"),
    "the right depth": (lambda: with_depth(0.0103), None),
    "the depth of tungsten": (lambda: with_depth(1.07, 2.56), None),
    "one that is thermal": (lambda: (flowing(), LJ, md.LangevinBAOAB(0.004, 1.0, 1.0, seed=1)), None),
    "a start off its lengths": (lambda: (*BOND, 0.01, None, md.DistanceConstraints([[0, 1]], 0.9)), "was projected"),
    "a step too long for a bond": (lambda: (*BOND, 0.18), "timestep 0.18 τ .* the bond of atoms 0 and 1 .* 0.1789 τ"),
    "one that is not": (lambda: (*BOND, 0.178), None),
    "nor for another method": (lambda: (*BOND, md.integrators.PEFRL(0.26)), None),  # stable up to 2.989/ω
    "a rigid bond": (lambda: (*BOND, 0.18, None, md.DistanceConstraints([[1, 0]])), None),
    "a bond with one end fixed": (lambda: (*BOND, 0.18, None, md.FixedAtoms([0])), None),  # 2/ω = 0.4
    "a bond of fixed atoms": (lambda: (APEX, across(0, 1), 0.01, None, md.FixedAtoms([0, 1])), None),
    "a bond held by others": (lambda: (APEX, across(0, 4), 0.01, None, md.DistanceConstraints(HELD)), None),
    "the same bond alone": (lambda: (APEX, across(0, 4), 0.01), "longer than the bond of atoms 0 and 4 allows"),
}


@pytest.mark.parametrize("name", HINTS)
def test_what_is_odd_is_told_before_the_first_step(name):
    make, words = HINTS[name]
    told = hints_of(*make())
    assert [bool(re.search(words() if callable(words) else words, one)) for one in told] == [True] * (words is not None)


def test_a_skin_that_does_not_fit_is_clamped_and_said():
    system = like(liquid(3), bonds=np.arange(108).reshape(-1, 2))
    room = 0.5 * system.cell.heights.min() - 1.8
    (hint,) = hints_of(system, BONDED, skin=room + 0.5)
    assert hint.startswith(f"skin {room + 0.5:g} σ does not fit, {room:.3g} is used")
    with pytest.warns(UserWarning, match="does not fit"):
        sim = md.Simulation(system, BONDED, md.VelocityVerlet(0.004), skin=room + 0.5)
    assert sim.skins == pytest.approx([room])
    assert hints_of(system, BONDED, skin=0.9 * room) == []
    for skin, words in ((room - 1e-8, "no room for a wider skin"), (0.01, "a wider skin or a shorter")):
        sim = md.Simulation(system, BONDED, md.VelocityVerlet(0.004), skin=skin)
        sim.velocities[:, 0] = np.tile([40.0, -40.0], len(system) // 2)
        sim.run(0)
        assert words in str(sim.report())


@pytest.mark.parametrize(("masses", "is_long"), [((1.0, 4.0), True), ((4.0, 1.0), False), ((4.0, 4.0), False)])
def test_of_a_mixture_the_masses_of_those_count_that_push_each_other(masses, is_long):
    """Of two species, of which only the first has a law that is stiff."""
    system = like(liquid(3), species=["A", "B"] * 54, masses=np.tile(masses, 54))
    law = md.LennardJones({"A": (1.0, 1.0), "B": (0.0, 1.0)}, cutoff=1.8, truncation="switched")
    assert (_long_timestep(Engine(system, law, md.VelocityVerlet(0.022))) is not None) == is_long


class Weight(md.Term):
    """Gravity, on all atoms alike."""

    acts_from_outside = True

    def bind(self, _system):
        return self

    def add(self, system, detail, forces, energies, virials):
        forces[:, 2] -= system.masses
        if detail:
            energies += system.masses * system.positions[:, 2]


def test_a_force_from_outside_that_is_declared_is_no_fault():
    sim = md.Simulation(liquid(3), [LJ, Weight()], md.VelocityVerlet(0.002))
    sim.set_temperature(0.5, seed=1)
    sim.run(20, every=2)
    assert sim.n_dof == 3 * len(sim.system)
    assert "momentum is not a constant here" in sim.report().verdict


@pytest.mark.slow
def test_the_first_step_compiles_all_that_the_next_ones_need():
    offset, start = 1e-30 * time_ns(), compile_clock.seconds

    def spring(r2):  # no cache holds it: the offset is a part of its code
        return (3.24 - r2) ** 2 + offset, 4.0 * (3.24 - r2)

    sim = md.Simulation(liquid(3), md.PairPotential(spring, (), 1.8), md.VelocityVerlet(0.004))
    sim.run(1)
    before = compile_clock.seconds
    sim.run(50, every=10)
    assert compile_clock.seconds == before > start


def test_a_failure_names_the_epsilon_first():
    law = md.LennardJones(120.0, 3.4, 8.5, "force-shifted")
    sim = md.Simulation(argon_crystal(), law, md.VelocityVerlet(5 * FS))
    sim.set_temperature(90.0, seed=1)
    with pytest.warns(UserWarning, match="^epsilon = 120 eV"), pytest.raises(md.NonFiniteError) as caught:
        sim.run(500, every=20)
    assert "ikely cause: epsilon = 120 eV is far deeper" in str(caught.value)
    assert "halve" not in str(caught.value)
    for depth, is_named in ((120.0, True), (0.0103, False)):  # in a report, too
        system, law, _ = with_depth(depth)
        found = too_long_a_step(Engine(system, law, md.VelocityVerlet(5 * FS))) or ""
        assert found.startswith("epsilon") is is_named


def test_the_call_that_is_told_stops_a_center_that_moves():
    (hint,) = hints_of(flowing(), LJ)
    sim = md.Simulation(flowing(), LJ, md.VelocityVerlet(0.004))
    exec(hint.split("; ")[-1].removesuffix(" stops it"), {"sim": sim})
    for velocities in (sim.velocities, np.float32(sim.velocities)):
        assert hints_of(like(sim.system, velocities=velocities), LJ) == []


def test_a_thermal_center_of_ase_is_told_by_a_simulation_and_not_by_its_own_dynamics():
    atoms, law, step = argon(), lennard_jones("force-shifted"), 4.0 * FS
    thermalize_momenta(atoms, 94.4, rng=np.random.default_rng(1))
    speed = np.linalg.norm(atoms.get_momenta().sum(axis=0)) / atoms.get_masses().sum() * md.units.ps
    (hint,) = hints_of(atoms, law, step)
    assert f"{speed:.3g} Å/ps" in hint
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        minimd.ase.VelocityVerlet(with_calculator(atoms, minimd.ase.Calculator(law)), step).run(2)
    Stationary(atoms)
    assert hints_of(atoms, law, step) == []
