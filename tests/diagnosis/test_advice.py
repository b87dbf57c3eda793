"""Advice on the time step, which is where runs blow up; and hints before the first step: what is odd."""

import re
import warnings
from functools import partial
from time import time_ns

import numpy as np
import pytest
import scipy.linalg
from references import liquid
from rigid_scenes import SCENES as GRAPHS
from scenes import BONDED, LJ, OPEN, SCENES
from small_problems import SPLITTINGS
from step_scenes import MINIMA, at_minimum, diatomic, fcc, longest_stable_step
from wrong_calls import assert_answered

import minimd as md
from minimd.core.compiled.kernels import compile_clock
from minimd.core.integrators.substeps import repeated
from minimd.integrators import THERMOSTATS, SecondOrder, energy_oscillation, run_steps, stability_limit
from minimd.view.check import check_file

OTHERS = md.integrators.PEFRL, md.integrators.Ruth3, md.integrators.KahanLi6, md.PositionVerlet
QUICK = "diatomic", "chain", "ring", "rigid dumbbells", "squeezed, one layer fixed"
STEPS = [
    pytest.param(name, one, marks=[pytest.mark.slow] * (name not in QUICK and one is not md.integrators.PEFRL))
    for name, one in [*((name, md.VelocityVerlet) for name in MINIMA), *(("fcc crystal", one) for one in OTHERS)]
]
FS, ARGON = md.units.fs, md.LennardJones(0.0103, 3.4, 8.5, "force-shifted")
K = np.arange(40)
ROW = md.System(np.column_stack([K, 0 * K, 0 * K]), masses=2.0, bonds=np.column_stack([K[:-1], K[1:]]))
DIMER = md.System([[0.0, 0.0, 0.0], [2 ** (1 / 6), 0.0, 0.0]], masses=[1.0, 3.0])
ALL_PAIRS = [[0, 1], [1, 2], [0, 2]]
TRIANGLE = md.System(np.array([[0.0, 0, 0], [0.9, 0, 0], [0.45, 0.78, 0]]))
# length 1, a spring of rest length ½ to an anchor at distance 2: its tension stiffens, ω² = 1.5 k (1 + 1/2)/m
PULLED = md.System([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [3.0, 0.0, 0.0]], masses=[1.0, 2.0, 1.0])
HELD = [md.DistanceConstraints([[0, 1]]), md.FixedAtoms([0, 2])]
KNOWN = {  # scene and frequency; what cannot oscillate, however hard its atoms push each other, has none
    "row of beads": (ROW, md.HarmonicBond(50.0, 1.0), (), 2.0 * np.sqrt(50.0 / 2.0) * np.cos(np.pi / 80.0)),
    "dimer": (DIMER, OPEN, (), np.sqrt(4.0 * (156 * 2 ** (-14 / 6) - 42 * 2 ** (-8 / 6)) * 4.0 / 3.0)),  # √(u″(r₀)/μ)
    "pulled pendulum": (PULLED, md.HarmonicBond(40.0, 0.5, pairs=[[1, 2]]), HELD, np.sqrt(60.0 * 1.5 / 2.0)),
    "rigid triangle": (TRIANGLE, OPEN, md.DistanceConstraints(ALL_PAIRS), 0.0),
    "rigid rod": (md.System(np.outer([0.0, 0.4, 1.0], [1.0, 0, 0])), OPEN, md.DistanceConstraints(ALL_PAIRS), 0.0),
    "two free atoms": (md.System(np.outer(np.arange(2), [5.0, 0.0, 0.0])), LJ, (), 0.0),
    "64 free atoms": (md.System(np.outer(np.arange(64), [5.0, 0.0, 0.0])), LJ, (), 0.0),
}


@pytest.mark.parametrize(("name", "method"), STEPS)
def test_the_longest_stable_step_is_the_one_advised(name, method):
    state = at_minimum(MINIMA[name])
    limit = md.advise_timestep(*state, method=method).limit
    # truncation: six bisections of ±20 %
    assert longest_stable_step(state, method, limit) == pytest.approx(limit, rel=0.01)


@pytest.mark.parametrize("method", SPLITTINGS, ids=lambda method: method.name)
def test_the_energy_of_an_oscillator_swings_as_told(method):
    """By the matrix of a step, which is linear, along a path."""
    h = 0.4 * stability_limit(method.sequence())
    ends = [run_steps(SecondOrder(lambda q: -q), method(h), start, 1) for start in (([1.0], [0.0]), ([0.0], [1.0]))]
    matrix, path = np.array([[end.q[-1, 0], end.v[-1, 0]] for end in ends]).T, [np.array([1.0, 0.3])]
    for _ in range(5000):
        path.append(matrix @ path[-1])
    energies = 0.5 * np.square(path).sum(axis=1)
    swing = (energies.max() - energies.min()) / (energies.max() + energies.min())
    assert energy_oscillation(method.sequence(), h) == pytest.approx(swing, rel=2e-3)  # the path misses the axes


def test_limits_and_recommendations_that_are_known():
    """A contact with a bath changes no limit; the recommended step swings the energy by 1/80."""
    for method in (md.VelocityVerlet, *THERMOSTATS.values()):
        limit = np.pi if method is md.LangevinRESPA else 2.0
        assert stability_limit(method.sequence()) == pytest.approx(limit, abs=1e-14)  # rounding
    twice = repeated(md.VelocityVerlet.sequence(), (0.5, 0.5))  # tr M touches −2 at h = 2√2, where nothing happens
    assert stability_limit(twice) == pytest.approx(4.0, rel=1e-6)
    advice, euler = md.advise_timestep(*diatomic()), md.advise_timestep(*diatomic(), method=md.integrators.SE1)
    h = advice.frequency * advice.recommended
    assert advice.period / advice.recommended == pytest.approx(20.0, rel=1e-3)
    swing = energy_oscillation(md.VelocityVerlet.sequence(), h)
    assert [swing, h**2 / (8.0 - h**2)] == pytest.approx([1.0 / 80.0] * 2, rel=1e-9)
    assert euler.recommended * euler.frequency / 2.0 == pytest.approx(1.0 / 80.0, rel=1e-6)  # symplectic Euler: h/2


@pytest.mark.parametrize("name", KNOWN)
def test_frequencies_are_the_closed_forms(name):
    *scene, frequency = KNOWN[name]
    advice = md.advise_timestep(*scene)
    assert advice.frequency == pytest.approx(frequency, rel=1e-4 if name == "row of beads" else 1e-7)  # ACCURACY
    if name == "pulled pendulum":
        assert advice.atoms == (1,)
    if frequency == 0.0:
        assert advice.limit == advice.recommended == np.inf
        assert "nothing oscillates" in str(advice)


def reduced_frequency(system, law, pairs):
    """Of M^−1/2 (∇²U − Σ λ ∇²g) M^−1/2, the highest one on the null space of all ∇g, where g = ½ (r_ij² − d²)."""
    n, x, bonds = 3 * len(system), system.positions.ravel().copy(), system.bonds
    forces = lambda y: md.evaluate(md.System(y.reshape(-1, 3), bonds=bonds), law).forces.ravel()  # noqa: E731
    hessian = np.array([forces(x - 1e-6 * e) - forces(x + 1e-6 * e) for e in np.eye(n)]) / 2e-6
    curvatures = []
    for i, j in pairs:
        b = np.zeros((3, n))
        b[:, 3 * j : 3 * j + 3], b[:, 3 * i : 3 * i + 3] = np.eye(3), -np.eye(3)
        curvatures.append(b.T @ b)
    gradients = np.array([g @ x for g in curvatures])
    root = 1.0 / np.sqrt(np.repeat(system.masses, 3))
    at_rest = np.linalg.lstsq((gradients * root).T, -forces(x) * root, rcond=None)[0]  # M⁻¹(F + λ ∇g) keeps g
    lagrangian = hessian - np.einsum("k,kab->ab", at_rest, np.array(curvatures))
    allowed = scipy.linalg.null_space(gradients * root)
    return np.sqrt(np.linalg.eigvalsh(allowed.T @ (root[:, None] * lagrangian * root) @ allowed)[-1])


@pytest.mark.parametrize("shape", ["water", "chain", "ring", "cube"])
def test_frequencies_with_constraints_are_those_of_the_reduced_problem(shape):
    one, pairs, masses = GRAPHS[shape]
    one, pairs, masses = (one[:9], pairs[:8], masses[:9]) if shape == "chain" else (one, pairs, masses)
    positions, pairs = np.concatenate([one, one + np.array([0.7, 1.5, 1.2])]), np.concatenate([pairs, pairs + len(one)])
    system, law = md.System(positions, masses=np.tile(masses, 2), bonds=pairs), md.LennardJones(1.0, 0.9)
    frequency = md.advise_timestep(system, law, md.DistanceConstraints(pairs)).frequency
    assert frequency == pytest.approx(reduced_frequency(system, law, pairs.tolist()), rel=1e-4)  # ACCURACY


def test_rigid_bonds_do_not_oscillate_and_of_others_the_stiffest_is_named():
    system, law, rigid = SCENES["dumbbells"]()[:3]
    stiff = [*law, md.HarmonicBond(1e6, 0.5)]
    alone = md.advise_timestep(system, law, rigid).frequency
    assert md.advise_timestep(system, stiff, rigid).frequency == pytest.approx(alone, rel=1e-3)
    assert md.advise_timestep(system, stiff, ()).frequency > 1000.0
    bonds = md.HarmonicBond(np.where(np.arange(11) == 4, 5000.0, 100.0), 1.0)
    advice = md.advise_timestep(SCENES["chain"]().system, bonds, method=md.VelocityVerlet(0.01))
    assert (advice.bond, set(advice.atoms)) == ((4, 5), {4, 5})
    assert sum(advice.shares) == pytest.approx(1.0, abs=0.02)
    assert "the bond of atoms 4 and 5" in str(advice)


def test_advice_leaves_the_system_alone_and_sees_far_atoms_and_refuses_what_has_no_advice():
    system, law, _ = fcc()
    before = system.positions.copy()
    here = md.advise_timestep(system, law)
    assert np.array_equal(system.positions, before)
    system.positions += 1000.0 * np.array([5.0, -7.0, 3.0])
    assert md.advise_timestep(system, law).frequency == pytest.approx(here.frequency, rel=1e-3)
    one = md.System(np.zeros((2, 3)))
    assert_answered(lambda: md.advise_timestep(one, OPEN), md.NonFiniteError, "atoms 0 and 1", "0 σ apart")
    assert_answered(lambda: md.advise_timestep(one, OPEN, method=0.01), TypeError, "method", "0.01")


def test_a_crystal_that_will_melt_is_given_the_step_of_collisions():
    """At T* 1.44 the step of the modes alone blows up; the hint of a run names the same step as the advice."""
    positions, edges = md.lattice.crystal("fcc", [4, 4, 4], 1.68)
    system, law = md.System(positions, cell=edges), md.LennardJones(1.0, 1.0, 2.5, truncation="force-shifted")
    cold = md.advise_timestep(system, law)
    assert cold.harmonic == pytest.approx(0.0285, rel=0.01)
    assert cold.recommended == cold.collision == pytest.approx(0.00588, rel=0.01)
    assert "collisions of Lennard-Jones atoms" in str(cold)
    sim = md.Simulation(system, law, md.VelocityVerlet(cold.harmonic))
    sim.set_temperature(1.44, seed=1)
    hot = md.advise_timestep(sim.system, law)
    assert hot.recommended == pytest.approx(0.00507, rel=0.01)  # ω 5.8 times that of a pair
    with pytest.warns(UserWarning, match=f"up to {md.units.LJ.shown(hot.recommended)}; .*advise_timestep"):
        sim.run(1)


def test_a_hydrogen_inside_its_oxygen_does_not_collide():
    places, species = [[0.0, 0, 0], [1.0, 0, 0], [4.0, 0, 0], [5.0, 0, 0]], ["O", "H", "O", "H"]
    system, held = md.System(places, masses=[16.0, 1.0] * 2, species=species), md.DistanceConstraints([[0, 1], [2, 3]])
    inside, alone = (md.LennardJones({"O": (1.0, 3.0), "H": (depth, 0.4)}) for depth in (0.3, 0.0))
    collision = md.advise_timestep(system, alone, held).collision
    assert md.advise_timestep(system, inside, held).collision == pytest.approx(collision, rel=1e-12)
    assert md.advise_timestep(system, inside).collision < 0.1 * collision


def hints_of(system, potentials, method=0.004, constraints=(), **options):
    """The warnings of a run of one step, by velocity Verlet if a time step is given."""
    method = md.VelocityVerlet(method) if isinstance(method, float) else method
    with warnings.catch_warnings(record=True, action="always") as told:
        simulation = md.Simulation(system, potentials, method, constraints, **options)
        simulation.run(1)
        simulation.run(1)  # what was told is told once
    assert {one.filename for one in told} <= {__file__}  # the line of the user
    return [str(one.message) for one in told]


ZIGZAG = md.System(
    np.column_stack([K, 0.1 * (K % 2), 0 * K]), bonds=ROW.bonds, angles=np.arange(38)[:, None] + [0, 1, 2]
)
STRETCH, BEND = md.HarmonicBond(1000.0, 1.01**0.5), md.HarmonicAngle(500.0, np.pi - 2.0 * np.arctan(0.1))
NETWORKS = {  # scene, and that of its harmonic bonds and angles alone
    "bonds": ([ROW, STRETCH], STRETCH),
    "bonds and angles": ([ZIGZAG, [STRETCH, BEND]], [STRETCH, BEND]),
    "angles between rigid bonds": ([ZIGZAG, BEND, md.DistanceConstraints(ROW.bonds)], BEND),
    "bonds of a liquid": ([md.System(ROW.positions, bonds=ROW.bonds, masses=2.0), [STRETCH, LJ]], STRETCH),
}


@pytest.mark.parametrize("name", NETWORKS)
def test_the_limit_of_all_bonds_together_is_told_before_and_after_a_run_with_the_step_advised(name):
    """At 0.7 of the limit of all, where each bond alone seems safe, and beyond it; at half of it nothing is told."""
    (system, laws, *rigid), harmonic = NETWORKS[name]
    limit = md.advise_timestep(system, harmonic, *rigid).limit
    assert hints_of(system.copy(), laws, 0.5 * limit, *rigid) == []
    for share in (0.7, 1.03):
        method = md.VelocityVerlet(share * limit)
        words = f"Δt·ω = {2.0 * share:.4g}.*{md.units.LJ.shown(limit)}; take "
        sim = md.Simulation(system.copy(), laws, method, *rigid)
        sim.set_temperature(1e-8, seed=1)
        recommended = md.advise_timestep(sim.system, laws, *rigid).recommended
        with pytest.warns(UserWarning, match=f"{words}{md.units.LJ.shown(recommended)}, as advise_timestep"):
            sim.run(1)
        now = md.advise_timestep(sim.system, laws, *rigid).recommended
        told = f"timestep .*Δt·ω = .*; take {md.units.LJ.shown(now)}, as advise_timestep"
        assert re.search(told, sim.report().verdict)


def like(system, **changes):
    """The same places in the same cell."""
    return md.System(system.positions, **{"velocities": system.velocities, "cell": system.cell} | changes)


def argon_crystal(law=ARGON, constant=5.4):
    positions, edges = md.lattice.crystal("fcc", [4] * 3, constant)
    return md.System(positions, cell=edges, masses=39.95, units=md.units.ASE), law


def with_depth(epsilon, sigma=3.4):
    return *argon_crystal(md.LennardJones(epsilon, sigma, 2.2 * sigma, "force-shifted"), 5.4 * sigma / 3.4), 0.5 * FS


STIFF, LIQUID = diatomic()[:2], liquid(3)  # 2/ω = 0.1789
FLOWING = like(LIQUID, velocities=LIQUID.velocities + np.array([0.3, 0.0, 0.4]))
SPARSE = md.System(md.lattice.crystal("fcc", (3, 3, 3), 5.4)[0], cell=16.2)
BODIES = md.System(1.2 * np.eye(3), velocities=[[0.3, 0.0, 0.4], [0.2, 0.1, 0.4], [0.3, 0.1, -0.3]])
RIGID, BATH = md.DistanceConstraints([[1, 0]]), md.LangevinBAOAB(0.004, 1.0, 1.0, seed=1)
HINTS = {  # scene, and what is said
    "a sound scene": (LIQUID, LJ, None), "a step that is short enough": (LIQUID, LJ, 0.018, None),
    "lengths in another unit": (SPARSE, LJ, "no two atoms are within the cutoff, 1.8 σ: .*3.82 σ apart"),
    "a long step": (LIQUID, LJ, 0.022, "up to .*; .*advise_timestep"),
    "a step in seconds": (*argon_crystal(), 5e-15, r"such as 5 \* md.units.fs"),
    "a step far too short": (*argon_crystal(), 0.002 * md.units.fs, "timestep 0.002 fs is far shorter"),
    "one that is short": (*argon_crystal(), 0.02 * md.units.fs, None),
    "a step far too short for a bond": (*STIFF, 2e-5, "timestep 2e-05 τ is far shorter"),
    "one short for it": (*STIFF, 3e-5, None),
    "a center that moves": (FLOWING, LJ, "center of mass.*0.5 σ/τ"),
    "a depth in K": (*with_depth(120.0), r"^epsilon = 120 eV .* 0.0103 eV.* epsilon=120 \* md.units.ASE.k_B"),
    "the right depth": (*with_depth(0.0103), None),
    "one that is thermal": (FLOWING, LJ, BATH, None), "one of three bodies": (BODIES, LJ, None),
    "a start off its lengths": (*STIFF, 0.01, md.DistanceConstraints([[0, 1]], 0.9), "was projected"),
    "a step too long for a bond": (*STIFF, 0.18, "timestep 0.18 τ .* the bond of atoms 0 and 1; .* 0.1789 τ"),
    "one near its limit": (*STIFF, 0.17, "timestep 0.17 τ .* 0.1789 τ"),
    "one that is not": (*STIFF, 0.1, None), "a rigid bond": (*STIFF, 0.18, RIGID, None),
    "a bond with one end fixed": (*STIFF, 0.18, md.FixedAtoms([0]), None),  # 2/ω = 0.4
}  # fmt: skip


@pytest.mark.parametrize("name", HINTS)
def test_what_is_odd_is_told_before_the_first_step(name):
    system, *scene, words = HINTS[name]
    assert [bool(re.search(words, one)) for one in hints_of(system.copy(), *scene)] == [True] * (words is not None)


def test_a_skin_that_does_not_fit_is_clamped_and_said():
    system = like(LIQUID, bonds=np.arange(108).reshape(-1, 2))
    room = 0.5 * system.cell.heights.min() - 1.8
    with pytest.warns(UserWarning, match=f"skin {room + 0.5:g} σ does not fit, {room:.3g} is used"):
        sim = md.Simulation(system, BONDED, md.VelocityVerlet(0.004), skin=room + 0.5)
    assert sim.skins == pytest.approx([room])
    assert hints_of(system, BONDED, skin=0.9 * room) == []


@pytest.mark.slow
def test_the_first_step_compiles_all_that_the_next_ones_need():
    offset, start = 1e-30 * time_ns(), compile_clock.seconds
    spring = lambda r2: ((3.24 - r2) ** 2 + offset, 4.0 * (3.24 - r2))  # noqa: E731  the offset keeps it out of caches
    sim = md.Simulation(liquid(3), md.PairPotential(spring, (), 1.8), md.VelocityVerlet(0.004))
    sim.run(1)
    before = compile_clock.seconds
    sim.run(50, every=10)
    assert compile_clock.seconds == before > start


def slab(axis, tilt=0.0, polar=1.0, gap=3.0, shift=0.0):
    """Three layers of ions, charges +, 0, − with polar=1; mirrored with polar=0."""
    edge, layers = 4.0, [polar, 0.0, -polar] if polar else [1.0, -2.0, 1.0]
    places, charges = [], []
    for k, q in enumerate(layers):
        for i, j in np.ndindex(4, 4):
            at = np.insert(np.array([1.0 * i, 1.0 * j]), axis, 1.0 * k + shift)
            places.append(at)
            charges.append(q + 0.3 * (-1.0) ** (i + j))
    edges = np.diag(np.insert([edge, edge], axis, 2.0 + gap).astype(float))
    edges[axis] += tilt * np.roll(edges[(axis + 1) % 3], 0)
    return md.System(places, cell=edges, charges=charges)


@pytest.mark.parametrize("axis", [0, 1, 2])
@pytest.mark.parametrize(
    ("scene", "is_told"),
    [
        ({}, True),
        ({"tilt": 0.3}, True),
        ({"shift": 4.2}, True),
        ({"polar": 0.0}, False),
        ({"gap": 1.0}, False),
    ],
)
def test_a_slab_with_a_dipole_is_told(axis, scene, is_told):
    sim = md.Simulation(slab(axis, **scene), md.Coulomb(1.4, 1e-4), md.VelocityVerlet(1e-6))
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        sim.run(1)
    told = [str(one.message) for one in caught if "dipole" in str(one.message)]
    assert bool(told) == is_told, [str(one.message) for one in caught]
    if told:
        assert " 32 e σ " in told[0]  # 16 ions, two layers apart


CUT = md.LennardJones(1.0, 1.0, 2.5)
WCA = md.LennardJones(1.0, 1.0, 2.0 ** (1.0 / 6.0))
IONS = md.LennardJones({"Na": (0.0006, 2.16), "Cl": (0.0145, 4.83)}, cutoff=9.0)
FCC = np.array([[0.0, 1.0, 1.0], [1.0, 0.0, 1.0], [1.0, 1.0, 0.0]])
ROCK_SALT = {"cell": 2.82 * FCC, "species": ["Na", "Cl"]}
CHAIN = np.diag([10.0, 10.0, 1.12])


def plane(thickness, axis=2, tilt=0.0, **more):
    """A square lattice of spacing 1.15, shaken in its plane, as in a file of two dimensions.
    tilt : the share of each edge in the next one."""
    n = 6
    places = np.insert(1.15 * np.array([*np.ndindex(n, n)]), axis, 0.0, axis=1)
    shaken = np.insert(np.random.default_rng(5).normal(0.0, 0.07, (n * n, 2)), axis, 0.0, axis=1)
    edges = np.diag(np.insert([1.15 * n, 1.15 * n], axis, thickness))
    return md.System(places + shaken, cell=edges + tilt * np.eye(3, k=-1) @ edges, **more)


def fcc_cell(neighbor, repeat=1):
    """Of one atom, or of repeat² in a layer of one."""
    vectors = FCC * neighbor / np.sqrt(2.0)
    places = np.array([*np.ndindex(repeat, repeat)]) @ vectors[:2]
    return md.System(places, cell=vectors * [[repeat], [repeat], [1]])


THIN = {  # scene, and whether its cell is thinner than the distance of neighbors
    "bounds of 0.5": (plane(1.0), CUT, True), "bounds of 0.1": (plane(0.2), CUT, True),
    "across a": (plane(1.0, axis=0), CUT, True), "an inclined edge": (plane(1.0, tilt=1.0), CUT, True),
    "atoms that only repel": (plane(1.0), WCA, True), "bonds": (plane(0.96, bonds=[[0, 1], [1, 2]]), BONDED, True),
    "two thin edges": (md.System(np.outer(np.arange(20.0), [1.1, 0, 0]), cell=[22.0, 1.0, 1.0]), CUT, True),
    "open": (plane(1.0, pbc=(True, True, False)), CUT, False), "a thick cell": (plane(2.6), CUT, False),
    "at the minimum": (plane(1.12), CUT, False), "a liquid": (LIQUID, LJ, False),
    "a primitive cell": (fcc_cell(1.1), CUT, False), "a compressed one": (fcc_cell(0.9), CUT, False),
    "a compressed layer": (fcc_cell(0.9, 4), CUT, False), "soft atoms": (fcc_cell(0.9, 3), WCA, False),
    "chains along a short period": (md.System([[0, 0, 0], [5.0, 5.0, 0]], cell=CHAIN), CUT, False),
    "rock salt": (md.System([[0, 0, 0], [2.82, 0, 0]], **ROCK_SALT), IONS, False),
}  # fmt: skip


@pytest.mark.parametrize("name", THIN)
def test_a_cell_thinner_than_its_neighbors_is_told(name):
    """By an evaluation, and once by a simulation; no cell of a crystal is, however small or compressed."""
    system, law, is_thin = THIN[name]
    with warnings.catch_warnings(record=True, action="always") as evaluated:
        md.evaluate(system, law)
    told = [str(one.message) for one in evaluated]
    assert {one.filename for one in evaluated} <= {__file__}
    assert told == [one for one in hints_of(system.copy(), law, 1e-6) if "thin" in one]
    assert len(told) == is_thin
    if told:
        length = float(np.linalg.norm(system.cell.lattice, axis=1).min())
        assert f" {length:.3g} σ long, " in told[0]
        assert "pbc=" in told[0]
        assert "\n" not in told[0]


def test_a_thin_cell_stands_in_the_file_of_its_run(tmp_path):
    for system, is_thin in ((plane(1.0), True), (plane(1.0, pbc=(True, True, False)), False)):
        path = tmp_path / f"{is_thin}.h5md"
        with warnings.catch_warnings(action="ignore"):
            md.Simulation(system, CUT, md.VelocityVerlet(1e-5)).run(2, every=1, trajectory=path)
        checked = str(check_file(path))
        assert ("lattice vector [0. 0. 1.] is 1 σ long" in checked) is is_thin, checked


def test_forces_of_any_size_are_judged():
    """Their squares are beyond the largest number."""
    draw = np.random.default_rng(2)
    system = md.System(3.0 * draw.uniform(size=(8, 3)), velocities=draw.normal(size=(8, 3)))
    simulation = md.Simulation(system, md.ConstantForce([1e200, 0.0, 0.0]), md.VelocityVerlet(1e-3))
    with warnings.catch_warnings(action="error", category=RuntimeWarning), pytest.raises(md.NonFiniteError):
        simulation.run(0)


def pushing(x, y, z, t):
    """Walls across z, by a force that grows with the distance from the middle."""
    return 0.5e-6 * z * z, 0.0, 0.0, -1e-6 * z


@pytest.mark.parametrize(("charged", "is_told"), [("none", True), ("x", True), ("z", False)])
def test_a_field_across_a_periodic_direction_is_told_unless_a_slab_leaves_it_empty(charged, is_told):
    laws = [md.Coulomb(1.4, 1e-4, slab=charged), md.Field(pushing)]
    minimized = partial(md.minimize, max_steps=2)
    for look in (md.evaluate, minimized, lambda *scene: md.Simulation(*scene, md.VelocityVerlet(1e-6))):
        with warnings.catch_warnings(record=True) as caught:
            warnings.simplefilter("always")
            look(slab(2, gap=9.0), laws)
        told = [str(one.message) for one in caught if "but the field is not" in str(one.message)]
        assert len(told) == is_told
        assert all("periodic along c" in words and 'slab="z"' in words for words in told)
