"""Ten minima of the energy, and the longest stable time step around each, found by trying.  As a script: a table."""

import warnings

import numpy as np
from scenes import BONDED, LJ, SCENES

import minimd as md

AMPLITUDE, GROWTH = 1e-7, 1e4  # of the first displacement [length]; how much larger it must become to be unstable
N_STEPS, LOOK = 3000, 100


def diatomic():
    return md.System([[0.0, 0, 0], [1.0, 0, 0]], masses=[1.0, 4.0], bonds=[[0, 1]]), md.HarmonicBond(100.0, 1.0), ()


def fcc(masses=1.0, stretch=(1.0, 1.0, 1.0), fixed=False):
    positions, edges = md.lattice.crystal("fcc", [3, 3, 3], 1.55)
    layer = md.FixedAtoms(positions[:, 0] < 0.1) if fixed else ()
    return md.System(positions * stretch, cell=edges * stretch, masses=masses), LJ, layer


def bead_melt():
    """25 chains of ten beads."""
    k = np.arange(10)
    walk = np.column_stack([0.9 * k, 0.4 * (k % 2), 0.4 * (k // 2 % 2)])
    corners = np.array([[0.0, 1.8 * y, 1.8 * z] for y in range(5) for z in range(5)])
    pairs = np.column_stack([k[:-1], k[1:]]) + 10 * np.arange(25)[:, None, None]
    system = md.System((corners[:, None] + walk).reshape(-1, 3), cell=9.0, bonds=pairs.reshape(-1, 2))
    return system, [md.HarmonicBond(400.0, 0.97), BONDED], ()


NAMED = {one: one for one in ("chain", "ring", "mixture")} | {"LJ dimer": "two_atoms", "rigid dumbbells": "dumbbells"}
MINIMA = {name: lambda scene=scene: SCENES[scene]()[:3] for name, scene in NAMED.items()}
MINIMA |= {"diatomic": diatomic, "fcc crystal": fcc, "bead melt": bead_melt} | {
    "fcc of two masses": lambda: fcc(np.where(np.arange(108) % 4 == 0, 1.0, 40.0)),
    "squeezed, one layer fixed": lambda: fcc(np.geomspace(1.0, 200.0, 108), (1.0, 1.05, 0.93), fixed=True),
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
    with warnings.catch_warnings(action="ignore"):  # that the step is too long, and that lengths are put right
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


def longest_stable_step(state, method, around, n_bisections=6):
    """Between 0.8 and 1.2 times the expected one; NaN if it is not in between."""
    low, high = 0.8 * around, 1.2 * around
    if not is_stable(*state, method(low)) or is_stable(*state, method(high)):
        return float("nan")
    for _ in range(n_bisections):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if is_stable(*state, method(middle)) else (low, middle)
    return 0.5 * (low + high)


if __name__ == "__main__":
    print(f"{'scene':<28}{'atoms':>6}{'2/ω_max':>10}{'measured':>10}{'ratio':>8}{'recommended':>13}{'evaluations':>13}")
    for name, scene in MINIMA.items():
        state = at_minimum(scene)
        advice = md.advise_timestep(*state)
        measured = longest_stable_step(state, md.VelocityVerlet, advice.limit, n_bisections=9)
        ratio, found = measured / advice.limit, f"{advice.recommended:>13.5f}{advice.n_evaluations:>13}"
        print(f"{name:<28}{len(state[0]):>6}{advice.limit:>10.5f}{measured:>10.5f}{ratio:>8.4f}{found}", flush=True)
