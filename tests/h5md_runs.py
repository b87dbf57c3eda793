"""Short runs that write H5MD files."""

import resource

import MDAnalysis
import numpy as np

import minimd as md

CELLS = {
    "cubic": (3.6, None),
    "triclinic": ([[3.6, 0, 0], [0.7, 3.6, 0], [-0.4, 0.9, 3.6]], None),
    "turned": ([[0, 3.6, 0.3], [0, 0, 3.6], [3.6, 0.2, 0]], None),
    "slab": ([3.6, 3.6, 9.0], [True, True, False]),
    "slab without height": ([3.6, 3.6, 0.0], [True, True, False]),
    "open": (None, None),
    "open with vectors": (9.0, False),
}


def simulation(cell="cubic", units=md.units.LJ):
    """27 Lennard-Jones atoms of two species, three of them bonded, warm."""
    vectors, pbc = CELLS[cell]
    sites = np.stack(np.meshgrid(*[np.arange(3)] * 3, indexing="ij"), -1).reshape(-1, 3)
    positions = 1.2 * sites + np.random.default_rng(3).normal(0.0, 0.03, (27, 3))
    sigma, epsilon, mass, timestep, temperature = (
        (1.0, 1.0, 1.0, 0.004, 0.7) if units is md.units.LJ else (3.4, 0.0104, 39.9, 0.4, 90.0)
    )
    system = md.System(
        positions * sigma,
        masses=np.where(np.arange(27) % 2, mass, 2.1 * mass),
        cell=None if vectors is None else np.array(vectors) * sigma,
        pbc=pbc,
        species=np.where(np.arange(27) % 2, "Ar", "Kr"),
        bonds=[[0, 1], [1, 2]],
        units=units,
    )
    made = md.Simulation(
        system, md.LennardJones(epsilon, sigma, 1.6 * sigma, truncation="shifted"), md.VelocityVerlet(timestep)
    )
    made.set_temperature(temperature, seed=5)
    return made


def resumed(path, cell="cubic"):
    """The simulation in the restart of a file."""
    return md.Simulation.resume(path, simulation(cell).potentials)


def opened(path, n_atoms=27):
    universe = MDAnalysis.Universe.empty(n_atoms, trajectory=False)
    return universe.load_new(str(path))


def limited(n_bytes):
    """A context in which no file grows beyond n_bytes, as on a full disk."""

    class Limit:
        def __enter__(self):
            self.before = resource.getrlimit(resource.RLIMIT_FSIZE)
            resource.setrlimit(resource.RLIMIT_FSIZE, (n_bytes, self.before[1]))

        def __exit__(self, *_):
            resource.setrlimit(resource.RLIMIT_FSIZE, self.before)

    return Limit()


def bring_to_disk_every(seconds, monkeypatch):
    """Frames do not wait longer than this for the disk; with zero each is brought there when it comes."""
    monkeypatch.setattr("minimd.files.h5md_writer.SECONDS_BETWEEN_FLUSHES", seconds)
    monkeypatch.setattr("minimd.files.h5md_writer.MOST_OFTEN", 0.0)
