"""Short runs that write files, what tests of files look at, and records made by hand."""

import contextlib
import errno
import os
import resource

import ase.io
import MDAnalysis
import numpy as np

import minimd as md
from minimd.core.files.h5md_reader import read_file, verify_frames

PER_PICOSECOND = 98.22694788464064  # of the time unit of ASE, as its documentation has it
N_ATOMS = 27
CELLS = {
    "cubic": (3.6, None), "slab": ([3.6, 3.6, 9.0], [True, True, False]), "open": (None, None),
    "triclinic": ([[3.6, 0, 0], [0.7, 3.6, 0], [-0.4, 0.9, 3.6]], None), "open with vectors": (9.0, False),
    "turned": ([[0, 3.6, 0.3], [0, 0, 3.6], [3.6, 0.2, 0]], None),
    "slab without height": ([3.6, 3.6, 0.0], [True, True, False]),
}  # fmt: skip


def simulation(cell="cubic", units=md.units.LJ):
    """27 Lennard-Jones atoms of two species, three of them bonded, warm."""
    vectors, pbc = CELLS[cell]
    sites = np.stack(np.meshgrid(*[np.arange(3)] * 3, indexing="ij"), -1).reshape(-1, 3)
    positions = 1.2 * sites + np.random.default_rng(3).normal(0.0, 0.03, (N_ATOMS, 3))
    reduced, argon = (1.0, 1.0, 1.0, 0.004, 0.7), (3.4, 0.0104, 39.9, 0.4, 90.0)
    sigma, epsilon, mass, timestep, temperature = reduced if units is md.units.LJ else argon
    odd, cell = np.arange(N_ATOMS) % 2, None if vectors is None else np.array(vectors) * sigma
    atoms = {"masses": np.where(odd, mass, 2.1 * mass), "species": np.where(odd, "Ar", "Kr"), "bonds": [[0, 1], [1, 2]]}
    system = md.System(positions * sigma, cell=cell, pbc=pbc, units=units, **atoms)
    law = md.LennardJones(epsilon, sigma, 1.6 * sigma, truncation="force-shifted")
    made = md.Simulation(system, law, md.VelocityVerlet(timestep))
    made.set_temperature(temperature, seed=5)
    return made


def resumed(path, cell="cubic"):
    """The simulation in the restart of a file."""
    return md.Simulation.resume(path, simulation(cell).potentials)


def opened(path, n_atoms=N_ATOMS):
    """What the reader of MDAnalysis makes of a file, without minimd."""
    return MDAnalysis.Universe.empty(n_atoms, trajectory=False).load_new(str(path))


def frames_in(path, n_atoms=N_ATOMS):
    """Positions in all frames of a file, by its usual reader."""
    if path.suffix in (".extxyz", ".traj"):
        return np.array([atoms.positions for atoms in ase.io.read(path, ":")])
    with contextlib.closing(opened(path, n_atoms).trajectory) as read:
        return np.array([ts.positions.copy() for ts in read])


def lengths_and_angles(vectors):
    """Of a cell, in degrees, as MDAnalysis has them."""
    a, b, c = (v / np.linalg.norm(v) for v in vectors)
    return [*np.linalg.norm(vectors, axis=1), *np.degrees(np.arccos([b @ c, a @ c, a @ b]))]


def record_of(total, n_atoms=10, **changes):
    """A record of this total energy, of a kinetic energy of 1, and of no momentum."""
    n = len(total)
    flat, vectors = np.ones(n), np.zeros((n, 3))
    series = dict.fromkeys(("kinetic_energy", "temperature", "absolute_momentum", "absolute_angular_momentum"), flat)
    series |= {"total_energy": total, "potential_energy": total - 1.0, "momentum": vectors, "angular_momentum": vectors}
    return md.Record.of(md.units.LJ, n_atoms, {"step": np.arange(n), "time": np.arange(float(n)), **series, **changes})


def at_step(step, what):
    """An observer that does something at a step."""
    return lambda sim: what() if sim.step == step else None


def assert_same_file(path, other):
    """All that minimd reads from them, to the last bit."""
    for one in (path, other):
        verify_frames(one)
    ours, theirs = read_file(path), read_file(other)
    named = [(ours.record, theirs.record, name) for name in theirs.record.__dict__["_series"]]
    for one, same, name in [*named, *((ours.system, theirs.system, name) for name in ("positions", "velocities"))]:
        np.testing.assert_array_equal(getattr(one, name), getattr(same, name), strict=True)
    assert (ours.step, ours.time, ours.reservoir_energy) == (theirs.step, theirs.time, theirs.reservoir_energy)


@contextlib.contextmanager
def limited(n_bytes):
    """No file grows beyond n_bytes, as on a full disk."""
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (n_bytes, before[1]))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)


def bring_to_disk_every(seconds, monkeypatch):
    """Frames do not wait longer than this for the disk; with zero each is brought there when it comes."""
    monkeypatch.setattr("minimd.core.files.h5md_writer.SECONDS_BETWEEN_FLUSHES", seconds)
    monkeypatch.setattr("minimd.core.files.h5md_writer.MOST_OFTEN", 0.0)


def fill_the_disk(monkeypatch, after):
    """After so many calls of fsync, two for each flush, the disk is full."""
    left, fsync = iter(range(after)), os.fsync

    def syncing(descriptor):
        if next(left, None) is None:
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        fsync(descriptor)

    monkeypatch.setattr(os, "fsync", syncing)
    bring_to_disk_every(0.0, monkeypatch)
