"""Scenes with exact answers, as structures of ASE with calculators in numpy, and the runs of a dynamics in them.

Each run starts from an exact sample of the ensemble: what keeps it keeps it from the first step on, so that many short
runs are independent samples, and their spread is the error. kT, the time step and the pressure set all scales. Liquids,
whose answers are those of NIST, start from a crystal that has melted.
"""

from collections.abc import Callable, Sequence
from functools import partial
from typing import Any, NamedTuple

import numpy as np
from ase import Atoms
from ase.build import bulk
from ase.calculators.abc import GetPropertiesMixin
from ase.calculators.lj import LennardJones
from ase.constraints import FixBondLengths
from ase.md.verlet import VelocityVerlet
from numpy.random import RandomState

from minimd.core.structure.arrays import Array
from minimd.judge.problems import largest

Make = Callable[[Atoms, RandomState], Any]

MASSES = np.repeat([2.45, 8.35, 30.4, 120.3], 2)  # amu, of the atoms of a ring
LIGHT, HEAVY = 4.45, 13.35  # amu, of the atoms of a molecule, as 1 to 3
REDUCED = 0.75 * LIGHT
STIFF = 0.06  # ω Δt of a bond of the ring, with the lighter of its atoms
QUARTIC = 0.05  # of k²/kT: makes the motion chaotic
STRETCH = 4.0  # length of the bonds of molecules, in units of their thermal motion
SOFT = 1e-6  # a rigid bond that is off by more is none
SMALLEST = 1e-4  # volume of a run, over that at its start
MOLECULES = 6  # of the gas
OF_MOLECULES = 0.12  # ω Δt of their bonds, and of the bonds of the chain
RIGID = 4  # molecules of the chain
COARSE = 4.0  # times the frequencies of the ring: for the error of a long time step
# T, ρ, U/N, P of liquids, of NIST [ε, σ]
STATES = (0.85, 0.82, -5.7947, 0.55355), (0.9, 0.776, -5.4689, 0.24056)
CUTOFF = 2.5  # of the liquids [σ]
PACE = 0.004  # their time step [σ √(m/ε)]
SIDE = 3  # cells of their crystal
MELTING = 1500  # steps in which that becomes a liquid


class AnharmonicSprings(GetPropertiesMixin):
    """A calculator: bonds with ½ k r² + ¼ q r⁴ of the displacement from their length.

    first, second : (B,) int, atoms of the bonds.
    k : (B,).
    q : (B,) or a number.
    lengths : (B, 3) of a crystal, whose bonds keep their direction, or (B,).
    draw : of an exact sample, for samplers that test these laws.
    """

    implemented_properties = ("energy", "free_energy", "forces", "stress")
    name = "springs"
    parameters: dict[str, Any] = {}  # noqa: RUF012 - never changed
    draw: Callable[[RandomState], Atoms]

    def __init__(self, first: Any, second: Any, k: Array, lengths: Array, q: Any = 0.0) -> None:
        self.first = first
        self.second = second
        self.k = k
        self.lengths = lengths
        self.q = q
        self.results: dict[str, Any] = {}

    def get_property(self, name: str, atoms: Any = None, allow_calculation: bool = True) -> Any:
        """A property by its name in ASE."""
        d, e, r2 = self.bonds(atoms.positions)
        if name not in ("forces", "stress"):
            energies = 0.5 * self.k * r2 + 0.25 * self.q * r2**2
            return energies.sum()
        pull = (self.k + self.q * r2)[:, None] * e
        if name == "stress":
            virial = (d.T @ pull).ravel()
            return virial[[0, 4, 8, 5, 2, 1]] / atoms.get_volume()
        forces = np.zeros_like(atoms.positions)
        np.add.at(forces, self.first, pull)
        np.add.at(forces, self.second, -pull)
        return forces

    def bonds(self, x: Array) -> tuple[Array, Array, Array]:
        """Vectors of the bonds, their displacements from the length, (B, 3), and squares of these, of x (N, 3)."""
        d = x[self.second] - x[self.first]
        if self.lengths.ndim == 2:
            e = d - self.lengths
        else:
            r = np.sqrt((d * d).sum(axis=1))
            e = (1.0 - self.lengths / r)[:, None] * d
        return d, e, (e * e).sum(axis=1)

    def curvature(self, x: Array) -> Array:
        """∇²U of each atom (N,), of a crystal."""
        r2 = self.bonds(x)[2]
        values = 3.0 * self.k + 5.0 * self.q * r2
        curvature = np.zeros(len(x))
        np.add.at(curvature, self.first, values)
        np.add.at(curvature, self.second, values)
        return curvature


class Rigid(AnharmonicSprings):
    """Springs between rigid bonds of one length, of atoms 0 and 1, 2 and 3, …"""

    length = 1.0

    def softness(self, seen: "Frames") -> float:
        """How far lengths are off, or velocities along bonds beside thermal ones."""
        velocities = seen.p / seen.masses[:, None]
        d = seen.x[:, 1::2] - seen.x[:, ::2]
        v = velocities[:, 1::2] - velocities[:, ::2]
        thermal = np.sqrt(seen.masses[:2].mean() / seen.kt)
        along = (d * v).sum(axis=2) / self.length * thermal
        stretch = np.linalg.norm(d, axis=2) / self.length - 1.0
        return max(largest(stretch), largest(along))


class Scene(NamedTuple):
    """A structure, drawn anew for each run.

    draw : of an exact sample.
    has : its features, as ensembles.LAWS need them.
    error : of means, relative, by the time step: the largest (ωΔt)²/2, if momenta are drawn at half a step.
    n_bodies : n of p(V) ∝ Vⁿ exp(−PV/kT).
    rigid : the part of <p²/m>/kT that rigid bonds take, of each atom.
    wanted : of a liquid, its energy [eV] or volume [Å³].
    slowness : its runs have so many times fewer steps.
    """

    draw: Callable[[RandomState], Atoms]
    calculator: Any
    has: str
    error: float
    n_bodies: int = 0
    rigid: Array = np.zeros(1)
    wanted: float = 0.0
    slowness: int = 1


def momenta(rng: RandomState, masses: Array, kt: float, is_still: bool = False) -> Array:
    """(N, 3) of a canonical ensemble, of one whose center of mass is at rest if is_still."""
    thermal = np.sqrt(kt * masses)
    p = rng.standard_normal((len(masses), 3)) * thermal[:, None]
    if is_still:
        p -= masses[:, None] * p.sum(axis=0) / masses.sum()
    return p


def boxed(x: Array, masses: Array, p: Array, edge: float, calculator: Any) -> Atoms:
    """Atoms with momenta in a periodic cubic cell."""
    symbols = "H" * len(x)
    cell = [edge] * 3
    return Atoms(symbols, x, masses=masses, momenta=p, cell=cell, pbc=True, calculator=calculator)


def ring(kt: float, timestep: float, _: float, is_still: bool, scale: float = 1.0) -> Scene:
    """Eight atoms of four masses on a ring of bonds that keep their directions, as in a crystal: nothing acts on them
    from outside, and nothing turns.

    scale : of ωΔt.
    """
    n = len(MASSES)
    first = np.arange(n)
    second = (first + 1) % n
    frequencies = scale * STIFF * np.tile([1.0, 1.5], n // 2) / timestep
    k = np.minimum(MASSES[first], MASSES[second]) * frequencies**2
    angles = 2.0 * np.pi * first / n
    circle = [np.cos(angles), np.sin(angles), 0.0 * angles]
    places = 50.0 + 10.0 * np.stack(circle, axis=1)
    lengths = places[second] - places[first]
    springs = AnharmonicSprings(first, second, k, lengths, QUARTIC * k**2 / kt)
    bonds = np.eye(n)[second] - np.eye(n)
    hessian = bonds.T @ (k[:, None] * bonds)
    values, modes = np.linalg.eigh(hessian)
    spread = modes[:, 1:] * np.sqrt(kt / values[1:])  # without the translation

    def draw(rng: RandomState) -> Atoms:
        while True:  # of the quadratic part alone, and accepted by the energy of the rest
            x = places + spread @ rng.standard_normal((n - 1, 3))
            rest = (springs.q * springs.bonds(x)[2] ** 2).sum()
            if rng.random_sample() < np.exp(-rest / (4.0 * kt)):
                return boxed(x, MASSES, momenta(rng, MASSES, kt, is_still), 100.0, springs)

    springs.draw = draw
    roots = np.sqrt(np.outer(MASSES, MASSES))
    omega2 = np.linalg.eigvalsh(hessian / roots)[-1]
    error = 0.5 * omega2 * timestep**2
    has = "ring masses spread" if scale == 1.0 else "coarse"
    return Scene(draw, springs, f"{has} places fixed", error)


def stiff_bonds(n: int, timestep: float) -> tuple[Array, float]:
    """Masses of n molecules of two atoms, and the k of their bonds."""
    return np.tile([LIGHT, HEAVY], n), REDUCED * (OF_MOLECULES / timestep) ** 2


def chain(kt: float, timestep: float, _: float, is_still: bool) -> Scene:
    """Rigid molecules of two atoms, in a chain of bonds as those of the ring."""
    n = RIGID
    masses, k = stiff_bonds(n, timestep)
    first = np.arange(1, 2 * n - 1, 2)
    length = np.sqrt(kt / k)
    apart = np.array([[5.0, 0.0, 0.0]])
    lengths = np.repeat(apart, n - 1, axis=0)
    springs = Rigid(first, first + 1, np.full(n - 1, k), lengths)
    springs.length = length

    def draw(rng: RandomState) -> Atoms:
        ways = rng.standard_normal((n, 3))
        ways /= np.linalg.norm(ways, axis=1)[:, None]
        displacements = rng.standard_normal((n - 1, 3))
        steps = apart + length * (displacements + ways[:-1])
        x = np.zeros((2 * n, 3))
        x[0::2] = np.cumsum(np.vstack([apart, steps]), axis=0)
        x[1::2] = x[0::2] + length * ways

        p = momenta(rng, masses, kt, is_still)
        v = p[1::2] / HEAVY - p[0::2] / LIGHT
        along = REDUCED * (v * ways).sum(axis=1)[:, None] * ways
        p[0::2] += along
        p[1::2] -= along

        atoms = boxed(x + 30.0, masses, p, 100.0, springs)
        atoms.set_constraint(FixBondLengths(np.arange(2 * n).reshape(n, 2)))
        return atoms

    springs.draw = draw
    has = "masses spread rigid fixed"
    shares = np.tile([0.75, 0.25], n) / 3.0
    return Scene(draw, springs, has, 0.5 * OF_MOLECULES**2, rigid=shares, slowness=4)


def liquid(kt: float, timestep: float, pressure: float, is_still: bool, state: int = 0) -> Scene:
    """A Lennard-Jones liquid of 108 atoms, which starts from a crystal: its energy, or, under pressure, its density."""
    heat, density, energy, p = STATES[state]
    n = 4 * SIDE**3
    epsilon = kt / heat
    sigma = 3.0
    if pressure:
        tail_of_p = 8.0 / 3.0 * np.pi * density * (CUTOFF**-9.0 / 1.5 - CUTOFF**-3.0)
        p_of_pairs = p - 2.0 * density * tail_of_p
        sigma = (p_of_pairs * epsilon / pressure) ** (1.0 / 3.0)
    calculator = LennardJones(sigma=sigma, epsilon=epsilon, rc=CUTOFF * sigma)
    masses = np.full(n, epsilon * (timestep / PACE / sigma) ** 2)

    def draw(rng: RandomState) -> Atoms:
        edge = sigma * (4.0 / density) ** (1.0 / 3.0)
        atoms = bulk("Ar", "fcc", a=edge, cubic=True) * (SIDE, SIDE, SIDE)
        atoms.set_masses(masses)
        atoms.calc = calculator
        atoms.set_momenta(momenta(rng, masses, 2.0 * kt))
        # at this volume; under pressure it would stay a crystal
        VelocityVerlet(atoms, timestep).run(MELTING)
        atoms.set_momenta(momenta(rng, masses, kt, is_still))
        return atoms

    if pressure:
        volume = n * sigma**3 / density
        return Scene(draw, calculator, "pressed", 0.01, wanted=volume, slowness=4)
    tail_of_u = 8.0 / 3.0 * np.pi * density * (CUTOFF**-9.0 / 3.0 - CUTOFF**-3.0)
    at_cutoff = 4.0 * (CUTOFF**-12.0 - CUTOFF**-6.0)  # by which ASE's energies of pairs are shifted
    shift = 2.0 / 3.0 * np.pi * density * CUTOFF**3 * at_cutoff
    u_of_pairs = energy - tail_of_u - shift
    return Scene(draw, calculator, "liquid fixed", 0.01, wanted=n * epsilon * u_of_pairs)


def gas(kt: float, timestep: float, pressure: float, is_still: bool) -> Scene:
    """Molecules of two atoms, which do not see each other, under pressure: p(V) ∝ Vⁿ exp(−PV/kT), n molecules."""
    n = MOLECULES
    masses, k = stiff_bonds(n, timestep)
    length = STRETCH * np.sqrt(kt / k)
    first = np.arange(0, 2 * n, 2)
    springs = AnharmonicSprings(first, first + 1, np.full(n, k), np.full(n, length))
    r = np.linspace(0.05, 2.5, 4000) * length
    energies = 0.5 * k * (r - length) ** 2
    weights = np.cumsum(r**2 * np.exp(-energies / kt))

    def draw(rng: RandomState) -> Atoms:
        volume = rng.standard_gamma(n + (not is_still)) * kt / pressure
        edge = volume ** (1.0 / 3.0)
        ways = rng.standard_normal((n, 3))
        drawn = rng.random_sample(n) * weights[-1]
        distances = r[np.searchsorted(weights, drawn)]
        norms = np.linalg.norm(ways, axis=1)
        apart = distances[:, None] * ways / norms[:, None]
        x = np.repeat(edge * rng.random_sample((n, 3)), 2, axis=0)
        x[0::2] -= 0.75 * apart
        x[1::2] += 0.25 * apart
        return boxed(x, masses, momenta(rng, masses, kt, is_still), edge, springs)

    springs.draw = draw
    return Scene(draw, springs, "masses volume", 0.5 * OF_MOLECULES**2, n)


SCENES: dict[str, Callable[..., Scene]] = {
    "ring": ring,
    "coarse ring": partial(ring, scale=COARSE),
    "chain": chain,
    "gas": gas,
    "liquid 1": liquid,
    "liquid 2": partial(liquid, state=1),
}


class Frames(NamedTuple):
    """What was seen of a run.

    masses : (N,).
    x, p, f : positions, momenta and forces, (F, N, 3).
    volumes, u : (F,), u potential energies.
    ends : (2, 2), energy and log of the volume, at the start and at the end.
    """

    masses: Array
    kt: float
    x: Array
    p: Array
    f: Array
    volumes: Array
    u: Array
    ends: Array

    @property
    def kinetic(self) -> Array:
        """p²/(m kT) of each frame and atom, (F, N)."""
        return (self.p**2).sum(axis=2) / (self.masses * self.kt)


def joined(runs: Sequence[Frames]) -> Frames:
    """All frames of several runs."""
    first = runs[0]
    series = (np.concatenate([run[k] for run in runs]) for k in range(2, 7))  # type: ignore[arg-type]
    ends = np.stack([run.ends for run in runs])
    return Frames._make([first.masses, first.kt, *series, ends])


def run(make: Make, scene: Scene, seed: int, steps: int, every: int, kt: float) -> Frames:
    """One run, of which the second half is seen.  Raises FloatingPointError if numbers are not finite."""
    atoms, dynamics = started(make, scene, seed)
    start = atoms.get_volume()
    ends = [ends_of(atoms)]
    frames = list[Sequence[Any]]()
    n = steps // every
    for k in range(n):
        dynamics.run(every)
        volume = atoms.get_volume()
        if not SMALLEST < volume / start < 1.0 / SMALLEST:
            raise FloatingPointError(
                f"the volume went from {start:.3g} to {volume:.3g} Å³ in {(k + 1) * every} steps"
            )
        if 2 * k >= n:
            forces = atoms.get_forces(apply_constraint=False)
            energy = atoms.get_potential_energy() if scene.wanted else 0.0
            frames.append((atoms.positions.copy(), atoms.get_momenta(), forces, volume, energy))

    ends.append(ends_of(atoms))
    edges = atoms.cell.lengths()
    angles = atoms.cell.angles()
    if np.ptp(edges) > 1e-6 * edges[0] or np.ptp(angles) > 1e-4:
        raise FloatingPointError(
            "the shape of the cell changes; a gas resists no shear: let only its volume change"
        )
    if not np.isfinite(ends).all():
        raise FloatingPointError(
            f"not finite: energy {ends[1][0]:.3g} eV or volume {atoms.get_volume():.3g} Å³"
        )
    x, p, f, volumes, u = map(np.array, zip(*frames, strict=True))
    return Frames(atoms.get_masses(), kt, x, p, f, volumes, u, np.array(ends))


def started(make: Make, scene: Scene, seed: int) -> tuple[Atoms, Any]:
    """Atoms and their dynamics at the start of a run."""
    np.random.seed(seed)  # for dynamics that are given no generator
    rng = RandomState(seed)
    atoms = scene.draw(rng)
    return atoms, make(atoms, rng)


def ends_of(atoms: Atoms) -> tuple[float, float]:
    """Energy, and log of the volume."""
    with np.errstate(all="ignore"):
        energy = atoms.get_potential_energy() + atoms.get_kinetic_energy()
        return energy, np.log(atoms.get_volume())
