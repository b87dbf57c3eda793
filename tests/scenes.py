"""Twelve named scenes in reduced units, built once: `SCENES[name]()` and the fixture of that name are fresh copies.

Scenes of one kind share their law and its truncation, so that the suite compiles few kernels."""

from collections.abc import Sequence
from functools import cache
from typing import NamedTuple

import numpy as np
import references

import minimd as md
from minimd.core.structure.lattice import crystal
from minimd.core.structure.system import changed

LJ = md.LennardJones(1.0, 1.0, 1.8, "force-shifted")  # one species; cell, open or smaller than the cutoff
OPEN = md.LennardJones(1.0, 1.0)  # no cutoff
TWO_KINDS = md.LennardJones({"A": (1.0, 1.0), "B": (0.5, 0.88)}, cutoff=1.8, truncation="switched")
BONDED = md.LennardJones(1.0, 1.0, 1.8, "force-shifted", bonded_scale=(0.0, 0.0, 1.0))


class Scene(NamedTuple):
    """What a simulation needs, and a time step at which it runs well."""

    system: md.System
    laws: Sequence
    constraints: Sequence = ()
    timestep: float = 0.004

    def simulation(self, method=None, **options):
        """A Simulation, by velocity Verlet unless a method is given."""
        method = method or md.VelocityVerlet(self.timestep)
        return md.Simulation(self.system, self.laws, method, self.constraints, **options)


def argon():
    """108 atoms of the liquid, out of order: the smallest scene with a cluster list."""
    return Scene(references.liquid(3), [LJ])


def melt():
    """LAMMPS' 4000-atom melt with its own starting velocities."""
    return Scene(references.melt(), [LJ], timestep=0.005)


def mixture():
    """200 atoms of two species, sizes and masses in a triclinic cell."""
    positions, edges = crystal("fcc", [5, 5, 2], 1.7)
    rng = np.random.default_rng(2)
    cell = np.diag(edges) + np.array([[0, 0, 0], [1.3, 0, 0], [-0.4, 0.9, 0]])
    species = rng.permutation(["A"] * 160 + ["B"] * 40)
    positions = positions @ np.linalg.inv(np.diag(edges)) @ cell + 0.04 * rng.standard_normal(positions.shape)
    system = md.System(positions, cell=cell, species=species, masses=np.where(species == "A", 1.0, 0.3))
    return Scene(references.warm(system, 0.9), [TWO_KINDS], timestep=0.003)


def water():
    """32 rigid molecules of three sites, without charges."""
    centers, edges = crystal("fcc", [2, 2, 2], 2.4)
    shape = np.array([[0.0, 0.0, 0.0], [0.24, 0.18, 0.0], [-0.24, 0.18, 0.0]])
    turns = np.linalg.qr(np.random.default_rng(3).standard_normal((32, 3, 3)))[0]
    pairs = np.concatenate([np.array([[0, 1], [0, 2], [1, 2]]) + 3 * m for m in range(32)])
    positions = (centers[:, None] + shape @ turns).reshape(-1, 3)
    system = md.System(positions, cell=edges, masses=[16.0, 1.0, 1.0] * 32, bonds=pairs)
    rigid = [md.DistanceConstraints(pairs)]
    return Scene(references.warm(system, 1.0, rigid), [BONDED], rigid, timestep=0.002)


def dumbbells():
    """32 rigid pairs of unequal masses in a cubic cell."""
    centers, edges = crystal("fcc", [2, 2, 2], 2.07)
    arms = np.random.default_rng(1).standard_normal((32, 3))
    arms *= 0.25 / np.linalg.norm(arms, axis=1)[:, None]
    pairs = np.arange(64).reshape(-1, 2)
    ends = np.stack([centers - arms, centers + arms], axis=1).reshape(-1, 3)
    system = md.System(ends, cell=edges, masses=[1.0, 3.0] * 32, bonds=pairs)
    rigid = [md.DistanceConstraints(pairs)]
    return Scene(references.warm(system, 1.0, rigid), [BONDED], rigid, timestep=0.002)


def chain():
    """12 atoms of three masses in a row, held by springs, in open space."""
    k = np.arange(12)
    bonds = np.column_stack([k[:-1], k[1:]])
    system = md.System(np.column_stack([k, 0.1 * (k % 2), 0 * k]), masses=1.0 + k % 3, bonds=bonds)
    return Scene(references.warm(system, 0.5), [md.HarmonicBond(np.linspace(100.0, 300.0, 11), 1.0)], timestep=0.005)


def ring():
    """Six atoms with springs and angles, in open space."""
    angle, k = 2.0 * np.pi * np.arange(6) / 6, np.arange(6)
    pairs = np.column_stack([k, (k + 1) % 6])
    triples = np.column_stack([k, (k + 1) % 6, (k + 2) % 6])
    system = md.System(np.column_stack([np.cos(angle), np.sin(angle), 0.0 * angle]), bonds=pairs)
    laws = [md.HarmonicBond(80.0, 1.0), md.HarmonicAngle(60.0, 2.0 * np.pi / 3.0, triples)]
    return Scene(references.warm(system, 0.3), laws, timestep=0.005)


def droplet():
    """32 atoms that hold together in open space."""
    return Scene(references.warm(md.System(references.liquid(2, jitter=0.02).positions), 0.2), [LJ])


def gas():
    """256 atoms, thin, in a periodic cell."""
    return Scene(references.liquid(4, density=0.25, temperature=2.0), [LJ])


def slab():
    """108 atoms, periodic in x and y, open along z."""
    dense = references.liquid(3)
    return Scene(changed(dense, cell=md.Cell.of(dense.cell.vectors, [True, True, False])), [LJ])


def two_atoms():
    """Near the bottom of their well, in open space."""
    velocities = [[0, 0.1, 0.05], [0, -0.05, -0.025]]
    return Scene(md.System([[0, 0, 0], [0, 1.2, 0]], velocities=velocities, masses=[1.0, 2.0]), [OPEN])


def small_molecule():
    """LAMMPS' 29-atom example `fourmol`, with its bonds, in its cell."""
    system, _ = references.fourmol()
    return Scene(references.warm(system.copy(), 0.5), [md.HarmonicBond(300.0, 1.2)], timestep=0.002)


BUILDERS = [argon, melt, mixture, water, dumbbells, chain, ring, droplet, gas, slab, two_atoms, small_molecule]
_built = cache(lambda build: build())  # once, and copied for each who asks
SCENES = {one.__name__: lambda one=one: _built(one)._replace(system=_built(one).system.copy()) for one in BUILDERS}
