"""Ten minima of the potential energy, and the longest stable time step around each, found by trying.  Run as a script, it prints a table."""

import warnings

import numpy as np

import minimd as md
from minimd.structure.lattice import crystal

AMPLITUDE, GROWTH = (
    1e-7,
    1e4,
)  # of the first displacement [length]; how much larger it must become to be called unstable
N_STEPS, LOOK = 3000, 100


def diatomic():
    return (
        md.System([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0]], masses=[1.0, 4.0], bonds=[[0, 1]]),
        md.HarmonicBond(100.0, 1.0),
        (),
    )


def chain():
    k = np.arange(12)
    system = md.System(np.column_stack([k, 0 * k, 0 * k]), masses=1.0 + k % 3, bonds=np.column_stack([k[:-1], k[1:]]))
    return system, md.HarmonicBond(np.linspace(100.0, 300.0, 11), 1.0), ()


def ring():
    angle = 2.0 * np.pi * np.arange(6) / 6
    pairs = np.column_stack([np.arange(6), (np.arange(6) + 1) % 6])
    system = md.System(np.column_stack([np.cos(angle), np.sin(angle), 0.0 * angle]), bonds=pairs)
    triples = np.column_stack([pairs[:, 0], pairs[:, 1], (pairs[:, 1] + 1) % 6])
    return system, [md.HarmonicBond(80.0, 1.0), md.HarmonicAngle(60.0, 2.0 * np.pi / 3.0, triples)], ()


def dimer():
    return md.System([[0.0, 0.0, 0.0], [0.0, 2 ** (1 / 6), 0.0]], masses=[1.0, 2.0]), md.LennardJones(1.0, 1.0), ()


def fcc(lattice_constant=1.55, masses=1.0, stretch=(1.0, 1.0, 1.0)):
    positions, edges = crystal("fcc", [3, 3, 3], lattice_constant)
    return (
        md.System(positions * stretch, cell=edges * stretch, masses=masses),
        md.LennardJones(1.0, 1.0, cutoff=2.2, truncation="switched"),
        (),
    )


def fcc_of_two_masses():
    return fcc(masses=np.where(np.arange(108) % 4 == 0, 1.0, 40.0))


def mixture():
    rng = np.random.default_rng(2)
    species = np.array(["A"] * 160 + ["B"] * 40)
    system = md.System(
        rng.uniform(0.0, 5.5, (200, 3)), cell=5.5, species=species.tolist(), masses=np.where(species == "A", 1.0, 0.3)
    )
    pairs = {("A", "B"): (1.5, 0.8)}
    laws = md.LennardJones({"A": (1.0, 1.0), "B": (0.5, 0.88)}, cutoff=2.2, truncation="switched", pairs=pairs)
    return system, laws, ()


def bead_melt():
    k = np.arange(10)
    walk = np.column_stack([0.9 * k, 0.4 * (k % 2), 0.4 * (k // 2 % 2)])
    corners = np.stack(np.meshgrid([0.0], np.arange(5) * 1.8, np.arange(5) * 1.8, indexing="ij"), axis=-1).reshape(
        -1, 1, 3
    )
    pairs = np.column_stack([k[:-1], k[1:]])
    system = md.System(
        (corners + walk).reshape(-1, 3), cell=[9.0, 9.0, 9.0], bonds=np.concatenate([pairs + 10 * c for c in range(25)])
    )
    return (
        system,
        [
            md.HarmonicBond(400.0, 0.97),
            md.LennardJones(1.0, 1.0, cutoff=2.2, truncation="switched", bonded_scale=(0, 1, 1)),
        ],
        (),
    )


def rigid_dumbbells():
    centers, edges = crystal("fcc", [2, 2, 2], 2.07)
    arms = np.random.default_rng(1).standard_normal((32, 3))
    arms *= 0.25 / np.linalg.norm(arms, axis=1)[:, None]
    pairs = np.arange(64).reshape(-1, 2)
    system = md.System(
        np.stack([centers - arms, centers + arms], axis=1).reshape(-1, 3),
        cell=edges,
        masses=[1.0, 3.0] * 32,
        bonds=pairs,
    )
    laws = md.LennardJones(1.0, 1.0, cutoff=2.05, truncation="switched", bonded_scale=(0, 1, 1))
    return system, laws, md.DistanceConstraints(pairs)


def squeezed_with_fixed_layer():
    system, laws, _ = fcc(masses=np.geomspace(1.0, 200.0, 108), stretch=(1.0, 1.05, 0.93))
    return system, laws, md.FixedAtoms(system.positions[:, 0] < 0.1)


SCENES = {
    "diatomic": diatomic,
    "chain": chain,
    "ring": ring,
    "LJ dimer": dimer,
    "fcc crystal": fcc,
    "fcc of two masses": fcc_of_two_masses,
    "mixture": mixture,
    "bead melt": bead_melt,
    "rigid dumbbells": rigid_dumbbells,
    "squeezed, one layer fixed": squeezed_with_fixed_layer,
}


def at_minimum(scene):
    """The scene with its atoms at rest in a minimum."""
    system, potentials, constraints = scene()
    found = md.minimize(system, potentials, constraints, force_tolerance=1e-9, max_steps=40_000)
    return found.system, potentials, constraints


def is_stable(system, potentials, constraints, method, n_steps=N_STEPS):
    """Whether a displacement of 1e-7 stays small."""
    start = system.copy()
    start.positions += AMPLITUDE * np.random.default_rng(5).standard_normal(start.positions.shape)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # that the step is too long, and that lengths are put right
        simulation = md.Simulation(start, potentials, method, constraints)
        simulation.velocities[:] = 0.0
        for _ in range(n_steps // LOOK):
            try:
                simulation.run(LOOK, every=LOOK)
            except ArithmeticError:
                return False
            moved = simulation.positions - system.positions
            if np.abs(moved - moved.mean(axis=0)).max() > GROWTH * AMPLITUDE:
                return False
    return True


def longest_stable_step(system, potentials, constraints, method, around, n_bisections=6):
    """Between 0.8 and 1.2 times the expected one; NaN if it is not in between."""
    low, high = 0.8 * around, 1.2 * around
    if not is_stable(system, potentials, constraints, method(low)) or is_stable(
        system, potentials, constraints, method(high)
    ):
        return float("nan")
    for _ in range(n_bisections):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if is_stable(system, potentials, constraints, method(middle)) else (low, middle)
    return 0.5 * (low + high)


if __name__ == "__main__":
    print(f"{'scene':<28}{'atoms':>6}{'2/ω_max':>10}{'measured':>10}{'ratio':>8}{'recommended':>13}{'evaluations':>13}")
    for name, scene in SCENES.items():
        state = at_minimum(scene)
        advice = md.advise_timestep(*state)
        measured = longest_stable_step(*state, md.VelocityVerlet, advice.limit, n_bisections=9)
        numbers = f"{advice.limit:>10.5f}{measured:>10.5f}{measured / advice.limit:>8.4f}{advice.recommended:>13.5f}{advice.n_evaluations:>13}"
        print(f"{name:<28}{len(state[0]):>6}{numbers}", flush=True)
