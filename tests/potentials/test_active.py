"""Active forces: how directions turn, how particles run, what a restart and a failed step keep."""

import numpy as np
import pytest
from wrong_calls import answered

import minimd as md
from minimd.core.potentials.active import REORIENTATIONS

KINDS = list(REORIENTATIONS)
TAU, FORCE, GAMMA, T = 0.8, 3.0, 2.0, 0.5
test_wrong_calls_are_answered = answered(
    (lambda: md.ActiveForce(1.0, 0.0, 1), ValueError, "persistence_time", "0.0"),
    (lambda: md.ActiveForce(-1.0, 1.0, 1), ValueError, "force", "-1.0"),
    (lambda: md.ActiveForce(1.0, 1.0, -1), ValueError, "seed", "-1"),
    (lambda: md.ActiveForce(1.0, 1.0, 1, "spin"), ValueError, "reorientation", "'spin'"),
    (lambda: free("tumble", 3, atoms=[5]), ValueError, "ActiveForce", "5"),
    (lambda: free("tumble", 3, force=[1.0, 2.0]), ValueError, "force", "(2,)"),
)


def free(kind, n, timestep=0.02, force=FORCE, atoms=None):
    """Particles without any other force."""
    push = md.ActiveForce(force, TAU, seed=7, reorientation=kind, atoms=atoms)
    method = md.BrownianDynamics(timestep, T, friction=GAMMA, seed=1)
    sim = md.Simulation(md.System(np.zeros((n, 3))), push, method)
    sim.set_temperature(T, seed=2)
    return sim


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("kept", [0.99, 0.8])
def test_directions_forget_themselves_as_they_say(kind, kept):
    """⟨e·e′⟩ = kept, ⟨e′²⟩ = 1, ⟨e′⟩ = 0; of 40 000 directions."""
    rng, turn = np.random.default_rng(3), REORIENTATIONS[kind]
    first = rng.standard_normal((40_000, 3)) / np.sqrt(3.0)
    if kind != "ornstein-uhlenbeck":
        first /= np.linalg.norm(first, axis=1, keepdims=True)
    last = turn(first, kept, rng)
    squares = (last**2).sum(axis=1)
    assert squares.mean() == pytest.approx(1.0, abs=1e-12 if kind != "ornstein-uhlenbeck" else 0.02)
    kept_by = (first * last).sum(axis=1)
    error = kept_by.std() / 200.0
    assert kept_by.mean() == pytest.approx(kept, abs=4.0 * error + 0.05 * (1.0 - kept) ** 3)
    assert np.abs(last.mean(axis=0)).max() < 4.0 / np.sqrt(3 * 40_000)


@pytest.mark.parametrize("kind", KINDS)
def test_a_free_particle_diffuses_as_theory_says(kind):
    """⟨Δr²⟩ = 6 D t + 2 v² τ (t − τ (1 − e^(−t/τ))), with v = f/(mγ); directions of the first step are exact."""
    n, n_steps, h = 3000, 300, 0.02
    sim = free(kind, n, h)
    sim.run(n_steps)
    t, v = n_steps * h, FORCE / GAMMA
    squares = np.square(sim.positions).sum(axis=1)
    expected = 6.0 * T / GAMMA * t + 2.0 * v * v * TAU * (t - TAU * (1.0 - np.exp(-t / TAU)))
    assert squares.mean() == pytest.approx(expected, abs=4.0 * squares.std() / np.sqrt(n) + 0.02 * expected)
    assert expected > 1.5 * 6.0 * T / GAMMA * t
    assert "the work of ActiveForce is not counted" in str(sim.report())


def test_only_the_atoms_that_are_named_are_pushed():
    sim = free("diffusion", 4, atoms=[1, 3], force=[1.0, 2.0])
    sim.engine.evaluate()
    assert np.linalg.norm(sim.forces, axis=1) == pytest.approx([0.0, 1.0, 0.0, 2.0])


def melt():
    positions, edges = md.lattice.crystal("fcc", [3, 3, 3], 1.8)
    laws = [md.LennardJones(1.0, 1.0, cutoff=2.0), md.ActiveForce(FORCE, TAU, seed=7)]
    sim = md.Simulation(md.System(positions, cell=edges), laws, md.LangevinBAOAB(0.004, T, 1.0, seed=1))
    sim.set_temperature(T, seed=2)
    return sim


def test_a_resumed_run_has_the_bits_of_one_that_was_not_interrupted(tmp_path):
    whole = melt()
    whole.run(160)
    part = melt()
    part.run(70, every=10, trajectory=tmp_path / "a.h5md")
    again = md.Simulation.resume(tmp_path / "a.h5md", melt().potentials)
    again.run(until_step=160)
    assert again.positions.tobytes() == whole.positions.tobytes()
    with pytest.raises(ValueError, match="pass method and potentials of that run"):
        md.Simulation.resume(tmp_path / "a.h5md", [md.ActiveForce(FORCE, TAU, 7, atoms=[0])])


def test_a_snapshot_has_the_directions():
    sim = melt()
    sim.run(20)
    before = sim.engine.snapshot()
    ends = []
    for _ in range(2):
        sim.engine.restore(before)
        sim.make_steps(15)
        ends.append(sim.positions.tobytes())
    assert ends[0] == ends[1]


def test_a_look_at_the_state_turns_nothing():
    """Also energies and forces at other places, which diagnosis asks for."""
    ends = []
    for looks in (False, True):
        sim = melt()
        for _ in range(4):
            sim.make_steps(5)
            if looks:
                sim.engine.changed()
                sim.engine.evaluate()
        ends.append(sim.positions.tobytes())
    assert ends[0] == ends[1]


def test_directions_outlast_a_new_cell():
    sim = melt()
    sim.make_steps(20)
    before = sim.engine.snapshot().memory
    sim.system.cell = md.Cell(1.01 * sim.system.cell.vectors, sim.system.cell.pbc)
    sim.engine.evaluate()
    assert np.array_equal(sim.engine.snapshot().memory, before)
