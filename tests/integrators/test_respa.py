"""Multiple time steps: bonded forces in inner steps, all others by kicks around them."""

import numpy as np
import pytest
from fixed_point_scenes import total_momentum
from scenes import SCENES, Scene

import minimd as md

SPRING = md.HarmonicBond(k=3000.0, length=1.0)
LJ = md.LennardJones(1.0, 1.0, cutoff=2.2, truncation="smooth")


@pytest.fixture(scope="module")
def chains():
    """Twenty chains of ten beads at k_BT = 1."""
    positions, edges, bonds = md.lattice.chains(20, beads=10, density=0.6, seed=1)
    start = md.minimize(md.System(positions, cell=edges, bonds=bonds), [LJ, SPRING]).system
    sim = md.Simulation(start, [LJ, SPRING], md.LangevinBAOAB(0.003, 1.0, 1.0, seed=2))
    sim.set_temperature(1.0, seed=1)
    sim.run(1500, every=1500, progress=False)
    return Scene(sim.system, [LJ, SPRING])


def moved(scene, method, n_steps, **options):
    sim = Scene(scene.system.copy(), scene.laws, scene.constraints).simulation(method, **options)
    sim.run(n_steps, every=n_steps, progress=False)
    return sim


def forces_of(system, law):
    return md.evaluate(system, [law]).forces


@pytest.mark.parametrize("inner", [1, 3])
def test_a_step_is_that_of_the_paper(chains, inner):
    system = chains.system.copy()
    dt, masses = 0.006, system.masses[:, None]
    for _ in range(3):
        system.velocities += dt / 2 * forces_of(system, LJ) / masses
        for _ in range(inner):
            system.velocities += dt / inner / 2 * forces_of(system, SPRING) / masses
            system.positions += dt / inner * system.velocities
            system.velocities += dt / inner / 2 * forces_of(system, SPRING) / masses
        system.velocities += dt / 2 * forces_of(system, LJ) / masses
    sim = moved(chains, md.RESPA(dt, inner), 3)
    assert np.allclose(sim.positions, system.positions, rtol=0, atol=1e-12)
    assert np.allclose(sim.velocities, system.velocities, rtol=0, atol=1e-11)


def test_the_energy_is_that_of_shorter_steps_and_has_order_2(chains):
    def spread(method):
        sim = Scene(chains.system.copy(), chains.laws).simulation(method)
        sim.run(round(1.2 / method.timestep), every=round(0.048 / method.timestep), progress=False)
        return np.std(sim.record.total_energy)

    plain, shorter, double = (spread(md.VelocityVerlet(dt)) for dt in (0.006, 0.003, 0.012))
    several = spread(md.RESPA(0.006))
    assert several < 0.5 * plain
    assert several < 1.5 * shorter
    assert double > 3.0 * plain
    assert spread(md.RESPA(0.012)) == pytest.approx(4.0 * several, rel=0.4)


def test_without_other_forces_it_is_velocity_verlet_with_inner_steps(chains):
    alone = chains._replace(laws=[SPRING])
    several, plain = moved(alone, md.RESPA(0.012, 4), 50), moved(alone, md.VelocityVerlet(0.003), 200)
    assert np.allclose(several.positions, plain.positions, rtol=0, atol=1e-11)
    assert (md.RESPA(0.012, 5).order, md.RESPA.is_symmetric, md.RESPA.is_symplectic) == (2, True, True)
    assert md.integrators.stability_limit(md.RESPA(0.01, 1).sequence()) == pytest.approx(2.0)
    assert md.integrators.stability_limit(md.RESPA(0.01, 100).sequence()) == pytest.approx(np.pi)  # of resonance


def test_without_bonded_terms_it_is_velocity_verlet():
    scene = SCENES["argon"]()
    several, plain = moved(scene, md.RESPA(0.004, 3), 20), moved(scene, md.VelocityVerlet(0.004), 20)
    assert np.allclose(several.positions, plain.positions, rtol=0, atol=1e-12)


@pytest.mark.parametrize("method", [md.RESPA(0.006, 3), md.LangevinRESPA(0.006, 1.0, 0.5, seed=3)], ids=repr)
def test_blocks_threads_and_resumed_runs_have_the_same_bits(chains, method, tmp_path):
    sims = [moved(chains, method, 40, threads=threads) for threads in (1, 2)]
    parts = Scene(chains.system.copy(), chains.laws).simulation(method)
    for n in (1, 7, 12):
        parts.run(n, every=1, progress=False)
    parts.run(5, every=5, trajectory=tmp_path / "a.h5md", progress=False)
    parts = md.Simulation.resume(tmp_path / "a.h5md", chains.laws)
    assert repr(parts.method) == repr(method)
    parts.run(15, every=15, progress=False)
    for sim in (*sims[1:], parts):
        assert np.array_equal(sim.positions, sims[0].positions)
        assert np.array_equal(sim.velocities, sims[0].velocities)


def test_fixed_point_steps_go_back_to_the_bit(chains):
    sim = Scene(chains.system.copy(), chains.laws).simulation(md.RESPA(0.006, 3), precision="fixed-point")
    sim.run(0, every=1, progress=False)
    start, momentum = sim.positions.copy(), total_momentum(sim)
    sim.run(300, every=300, progress=False)
    assert np.abs(sim.positions - start).max() > 0.1
    assert total_momentum(sim) == momentum
    sim.method = md.RESPA(-0.006, 3)
    sim.run(300, every=300, progress=False)
    assert np.array_equal(sim.positions, start)


def test_rigid_bonds_are_kept_in_inner_steps():
    scene = SCENES["water"]()
    angle = md.HarmonicBond(50.0, 0.6, pairs=np.arange(96).reshape(-1, 3)[:-1, [0, 2]])
    sim = moved(Scene(scene.system, [*scene.laws, angle], scene.constraints), md.RESPA(0.004, 3), 100)
    assert sim.engine.constraint_set.bonds.violation(sim.positions).max() < 1e-9
    assert abs(sim.record.total_energy[-1] - sim.record.total_energy[0]) < 0.05 * abs(sim.record.kinetic_energy[0])


def test_the_bath_has_its_temperature_and_lengths_of_bonds_theirs(chains):
    """⟨k (r − 1)²⟩ is that of LangevinBAOAB with a step of 0.002, whose temperature is 0.97 with a step of 0.008."""
    sim = Scene(chains.system.copy(), chains.laws).simulation(md.LangevinRESPA(0.008, 1.0, 2.0, seed=5, inner=4))
    squares, kinetic = [], []
    edge = sim.system.cell.lattice[0, 0]
    for _ in range(400):
        sim.run(20, every=20, progress=False)
        ends = sim.positions[sim.system.bonds]
        arms = ends[:, 0] - ends[:, 1]
        r = np.linalg.norm(arms - edge * np.rint(arms / edge), axis=1)
        squares.append(np.mean(3000.0 * (r - 1.0) ** 2))
        kinetic.append(sim.temperature)
    assert np.mean(squares) == pytest.approx(1.037, abs=0.025)
    assert np.mean(kinetic) == pytest.approx(0.995, abs=0.02)


def test_compositions_and_a_number_of_inner_steps_that_is_changed_are_what_they_say(chains):
    """Kicks of bonded terms in the middle of a step have the forces of the last inner step."""
    twice = md.integrators.compose(md.RESPA, md.RESPA)
    whole, parts = moved(chains, twice(0.01), 40), Scene(chains.system.copy(), chains.laws).simulation(twice(0.01))
    for _ in range(4):
        parts.run(10, every=10, progress=False)
    single = moved(chains, md.RESPA(0.005), 80)
    assert np.array_equal(whole.positions, parts.positions)
    assert np.allclose(whole.positions, single.positions, rtol=0, atol=1e-10)
    changed = md.RESPA(0.006, 2)
    changed.inner = 3
    assert np.array_equal(moved(chains, changed, 10).positions, moved(chains, md.RESPA(0.006, 3), 10).positions)


def test_massless_sites_follow_their_molecules_in_inner_steps():
    system, laws, rigid = md.water("TIP4P/2005", 64, density=0.997)
    sim = md.Simulation(system, laws, md.RESPA(1.0 * md.units.fs, 4), rigid)
    sim.set_temperature(300.0, seed=1)
    sim.run(50, every=50, progress=False)
    assert sim.probe_reversibility(25).is_reversible


def test_what_knows_one_force_only_is_refused():
    state = md.integrators.State(np.zeros((2, 3)), np.zeros((2, 3)), np.zeros((2, 3)), np.ones(2))
    for call in (
        lambda: md.RESPA(0.01).advance(state, lambda state, with_energy: None, 2),
        lambda: md.RESPA.on(None),
        lambda: md.grade(md.RESPA),
        lambda: md.grade(md.integrators.compose(md.RESPA, md.RESPA)),
    ):
        with pytest.raises(TypeError, match=r"(?i)respa|composition"):
            call()


def test_bad_numbers_of_inner_steps_are_refused():
    assert md.RESPA(0.004, np.int64(100)).inner == 100
    for n in (0, 101, 2.5, "4"):
        with pytest.raises((TypeError, ValueError), match="inner"):
            md.RESPA(0.004, n)
    with pytest.raises(ValueError, match="inner"):
        md.LangevinRESPA(0.004, 1.0, 1.0, seed=1, inner=-1)


def test_a_long_outer_step_is_told_by_its_collisions_and_advice_knows_inner_steps(chains):
    plain = md.advise_timestep(chains.system, chains.laws)
    for n, longest in ((3, 3.0 * plain.harmonic), (50, 0.25 * plain.period)):
        advice = md.advise_timestep(chains.system, chains.laws, method=md.RESPA(0.004, n))
        assert advice.collision == pytest.approx(plain.collision)
        assert advice.harmonic == pytest.approx(longest, rel=1e-3)
    with pytest.warns(UserWarning, match=r"respa is stable up to 3\.142"):
        moved(chains, md.RESPA(0.05, 50), 1)
    with pytest.warns(UserWarning, match="is long for Lennard-Jones atoms"):
        moved(SCENES["argon"](), md.RESPA(0.03, 50), 1)
