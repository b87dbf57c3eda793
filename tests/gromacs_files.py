"""An H5MD file made by hand as GROMACS 2026 makes them (src/gromacs/fileio/h5md of its sources): paths, types, units,
texts of fixed length, one frame in a chunk, and steps and times packed by shuffle and deflate. Two waters, Na and Cl.
"""

import h5py
import numpy as np

ATOMS = "particles/system"
TOPOLOGY = "h5md/modules/gromacs_topology"
STEPS = [0, 50, 100]
BOX = np.array([[2.0, 0.0, 0.0], [0.5, 2.1, 0.0], [-0.25, 0.375, 2.2]], np.float32)  # nm
WATER = {"mass": [15.9994, 1.008, 1.008], "charge": [-0.8476, 0.4238, 0.4238], "species": [8, 1, 1]}
MOLECULES = {  # numbers, names of atoms, name of the residue
    "SOL": (WATER, ["OW", "HW1", "HW2"], "SOL"),
    "NA": ({"mass": [22.9898], "charge": [1.0], "species": [11]}, ["NA"], "NA"),
    "CL": ({"mass": [35.45], "charge": [-1.0], "species": [17]}, ["CL"], "CL"),
}
BLOCKS = {"SOL": 2, "NA": 1, "CL": 1}
BONDS = [[0, 1], [0, 2], [3, 4], [3, 5]]


def texts(*words):
    longest = max(map(len, words))
    return np.array([word.encode() for word in words], h5py.string_dtype("utf-8", longest + 1))


def text(word):
    return texts(word).reshape(())


def vectors(seed, real):
    return np.random.default_rng(seed).normal(0.0, 1.0, (len(STEPS), 8, 3)).astype(real)


def write_series(group, name, values, unit, steps):
    """A time-dependent element: value, and its own step and time."""
    element = group.create_group(name)
    element.create_dataset("value", data=values, chunks=(1, *values.shape[1:]), maxshape=(None, *values.shape[1:]))
    element["value"].attrs["unit"] = text(unit)
    packed = {"chunks": (1,), "maxshape": (None,), "shuffle": True, "compression": "gzip"}
    element.create_dataset("step", data=np.array(steps, np.int64), **packed)
    element.create_dataset("time", data=0.002 * np.array(steps), **packed)


def write_sample(path, real=np.float32, boundary=("periodic",) * 3):
    """The file; velocities are written at the first and the last step only. Returns positions [nm], velocities [nm/ps]
    of the last frame."""
    positions, velocities = vectors(1, real), vectors(2, real)
    with h5py.File(path, "w") as h5:
        modules = h5.create_group("h5md/modules")
        h5["h5md"].attrs["version"] = np.array([1, 1], np.int32)
        h5.create_group("h5md/author").attrs["name"] = text("somebody")
        h5.create_group("h5md/creator").attrs.update({"name": text("GROMACS"), "version": text("2026.1")})
        for name, version in (("gromacs", [0, 1]), ("units", [1, 0])):
            modules.create_group(name).attrs["version"] = np.array(version, np.int32)
        modules["units"].attrs["system"] = text("SI")

        atoms = h5.create_group(ATOMS)
        atoms.create_group("box").attrs.update({"boundary": texts(*boundary), "dimension": np.int32(3)})
        write_series(atoms, "position", positions, "nm", STEPS)
        edges = atoms.create_group("box/edges")
        edges.create_dataset("value", data=np.array([BOX] * 3, real), chunks=(1, 3, 3), maxshape=(None, 3, 3))
        edges["value"].attrs["unit"] = text("nm")
        edges["step"], edges["time"] = atoms["position/step"], atoms["position/time"]
        write_series(atoms, "velocity", velocities[::2], "nm ps-1", STEPS[::2])

        topology = h5.create_group(TOPOLOGY)
        topology.attrs.update({"version": np.array([0, 1], np.int32), "system_name": text("salt water")})
        topology.attrs["molecule_block_names"] = texts(*BLOCKS)
        topology.attrs["molecule_block_counts"] = np.array([*BLOCKS.values()], np.int32)
        for molecule, (numbers, names, residue) in MOLECULES.items():
            n, group = len(names), topology.create_group(molecule)
            group.attrs.update({"particle_count": np.int64(n), "residue_count": np.int32(1)})
            group["id"] = np.arange(1, n + 1)
            for name, values in numbers.items():
                group[name] = np.array(values, np.int32 if name == "species" else real)
            group["mass"].attrs["unit"], group["charge"].attrs["unit"] = text("u"), text("e")
            group["particle_name"], group["particle_name_table"] = np.arange(n, dtype=np.int32), texts(*names)
            group["residue_id"], group["residue_name"] = np.ones(n, np.int32), np.zeros(n, np.int32)
            group["sequence"], group["residue_name_table"] = np.zeros(1, np.int32), texts(residue)
        connectivity = h5.create_group("connectivity")
        connectivity["bonds"] = np.array(BONDS)
        connectivity.attrs["bond_count"] = np.int64(len(BONDS))
    return positions[-1], velocities[2]
