"""H5MD files of GROMACS: one made by hand is read with its units, and a run is written in the same layout."""

import h5py
import numpy as np
import pytest
from gromacs_files import ATOMS, BONDS, BOX, TOPOLOGY, text, texts, write_sample
from h5md_runs import CELLS, simulation

import minimd as md
from minimd.ase import system_from_file
from minimd.core.files.h5md_reader import frames_of, read_file
from minimd.core.structure.system import arguments_of

PS = md.units.ps
POSITION, VELOCITY, BOX_EDGES = (f"{ATOMS}/{name}/value" for name in ("position", "velocity", "box/edges"))


@pytest.mark.parametrize("real", [np.float32, np.float64])
def test_the_last_frame_of_gromacs_is_a_system_in_our_units(tmp_path, real):
    positions, velocities = write_sample(tmp_path / "traj.h5md", real)
    system = system_from_file(tmp_path / "traj.h5md")
    assert system.units is md.units.ASE
    assert np.array_equal((system.positions / 10).astype(np.float32), positions.astype(np.float32))
    assert system.velocities * PS / 10 == pytest.approx(velocities, rel=1e-6)  # rounding of float32
    assert system.cell.vectors == pytest.approx(10 * BOX.astype(float), rel=1e-6)
    assert system.cell.pbc.all()
    assert system.masses.tolist() == [15.9994, 1.008, 1.008] * 2 + [22.9898, 35.45]
    assert system.charges.tolist() == [-0.8476, 0.4238, 0.4238] * 2 + [1.0, -1.0]
    assert system.species.tolist() == ["O", "H", "H", "O", "H", "H", "Na", "Cl"]
    assert system.bonds.tolist() == BONDS
    assert system.topology[[0, 4, 6]].tolist() == [
        ["OW", "O", "SOL", "1", "SOL"], ["HW1", "H", "SOL", "2", "SOL"], ["NA", "Na", "NA", "3", "NA"],
    ]  # fmt: skip


@pytest.mark.filterwarnings("ignore:the charges|the center of mass")
def test_a_run_begins_with_a_frame_of_gromacs(tmp_path):
    write_sample(tmp_path / "traj.h5md", boundary=("periodic", "periodic", "none"))
    system = system_from_file(tmp_path / "traj.h5md")
    assert system.cell.pbc.tolist() == [True, True, False]
    run = md.Simulation(system, md.HarmonicBond(20.0, 5.0), md.VelocityVerlet(0.01))
    energies = run.run(10, every=10).total_energy
    assert energies[1] == pytest.approx(energies[0], rel=1e-3)  # truncation
    with pytest.raises(ValueError, match="states units = 'ASE'"):
        system_from_file(tmp_path / "traj.h5md", units=md.units.LJ)


def replaced(path, data, **options):
    def change(h5):
        attributes = dict(h5[path].attrs)
        values = h5[path][()]
        del h5[path]
        h5.create_dataset(path, data=data(values), **options).attrs.update(attributes)

    return change


def attribute(path, name, value):
    return lambda h5: h5[path].attrs.__setitem__(name, value)


def removed(path):
    return lambda h5: h5.__delitem__(path)


def not_finite(values):
    values[-1, 0, 0] = np.nan
    return values


SOL, PACKED = f"{TOPOLOGY}/SOL", {"compression": "gzip", "chunks": (3, 8, 3)}
BOMB = {"compression": "gzip", "chunks": (2**18,), "maxshape": (None,)}
FORGED = {  # a change of the file, and the word of the sentence about it
    "no positions": (removed(f"{ATOMS}/position"), "nstxout"),
    "no group of atoms": (lambda h5: h5.move(ATOMS, "particles/some"), "particles/system"),
    "no box": (removed(f"{ATOMS}/box/edges"), "box/edges/value"),
    "no steps": (removed(f"{ATOMS}/position/step"), "position/step"),
    "no frames": (replaced(POSITION, lambda x: x[:0]), "no frame"),
    "other unit": (attribute(POSITION, "unit", text("Angstrom")), "Angstrom"),
    "no unit": (lambda h5: h5[POSITION].attrs.__delitem__("unit"), "unit 'nm'"),
    "other unit of velocities": (attribute(VELOCITY, "unit", text("m s-1")), "m s-1"),
    "whole numbers": (replaced(POSITION, lambda x: x.astype(int)), "position/value"),
    "two dimensions": (replaced(POSITION, lambda x: x[..., :2]), "position/value"),
    "fewer boxes": (replaced(BOX_EDGES, lambda x: x[:1]), "box/edges/value"),
    "other velocities": (replaced(VELOCITY, lambda x: x[:, :5]), "velocity/value"),
    "not finite": (replaced(POSITION, not_finite), "position/value"),
    "packed positions": (replaced(POSITION, np.array, **PACKED), "filters"),
    "large packed chunks": (replaced(f"{ATOMS}/position/step", np.array, **BOMB), "packed chunks"),
    "words elsewhere": (lambda h5: h5.create_dataset(f"{SOL}/words", data="x"), "other things than numbers"),
    "a link": (lambda h5: h5.__setitem__("particles/other", h5py.ExternalLink("x.h5", "/")), "link by name"),
    "boundary": (attribute(f"{ATOMS}/box", "boundary", texts("periodic", "open", "none")), "boundary"),
    "version": (attribute(TOPOLOGY, "version", np.array([1, 0])), "version"),
    "counts": (attribute(TOPOLOGY, "molecule_block_counts", np.array([2**30, 1, 1])), "atoms"),
    "negative counts": (attribute(TOPOLOGY, "molecule_block_counts", np.array([3, -1, 0])), "counts"),
    "names without group": (attribute(TOPOLOGY, "molecule_block_names", texts("SOL", "NA", "K")), "'K'"),
    "negative mass": (replaced(f"{SOL}/mass", np.negative), "mass"),
    "unit of charges": (attribute(f"{SOL}/charge", "unit", text("C")), "charge"),
    "fewer masses": (replaced(f"{SOL}/mass", lambda m: m[:2]), "charge"),
    "names beyond the table": (replaced(f"{SOL}/particle_name", lambda k: k + 1), "particle_name"),
    "negative names": (replaced(f"{SOL}/residue_name", lambda k: k - 1), "residue_name"),
    "bonds of no atom": (replaced("connectivity/bonds", lambda b: b + 3), "bonds"),
    "bonds of three": (replaced("connectivity/bonds", lambda b: b.reshape(1, -1)), "bonds"),
}  # fmt: skip


@pytest.mark.parametrize("name", FORGED)
def test_each_field_of_a_file_is_checked_before_it_is_used(tmp_path, name):
    file = tmp_path / "traj.h5md"
    write_sample(file)
    change, word = FORGED[name]
    with h5py.File(file, "r+") as h5:
        change(h5)
    with pytest.raises(ValueError, match=word) as refusal:
        system_from_file(file)
    assert str(file) in str(refusal.value)
    assert "gives up" not in str(refusal.value)  # a sentence of our own


def test_velocities_of_another_step_are_not_those_of_the_last_frame(tmp_path):
    write_sample(tmp_path / "traj.h5md")
    with h5py.File(tmp_path / "traj.h5md", "r+") as h5:
        h5[f"{ATOMS}/velocity/step"][-1] = 50
    assert not system_from_file(tmp_path / "traj.h5md").velocities.any()


def layout(path):
    """Type, dimensions without atoms, unit and HDF5's kind of texts of everything under particles/system."""
    with h5py.File(path) as h5:
        found = {}
        for name in ("position", "velocity", "box/edges"):
            for series in ("value", "step", "time"):
                stored = h5[f"{ATOMS}/{name}/{series}"]
                unit = stored.attrs.get_id("unit").dtype if "unit" in stored.attrs else None
                found[name, series] = stored.dtype, stored.ndim, stored.shape[2:], stored.attrs.get("unit"), unit
        box = h5[f"{ATOMS}/box"].attrs
        found["box"] = box["boundary"].dtype, box["boundary"].shape, box["dimension"]
        found["h5md"] = h5["h5md"].attrs["version"].tolist(), h5["connectivity/bonds"].dtype
        return {key: [str(part) for part in parts] for key, parts in found.items()}


@pytest.mark.parametrize("cell", CELLS)
@pytest.mark.parametrize("units", [md.units.LJ, md.units.ASE], ids=lambda units: units.name)
def test_a_run_is_written_as_gromacs_reads_and_writes_it(tmp_path, units, cell):
    run, out = tmp_path / "run.h5md", tmp_path / "traj.h5md"
    made = simulation(cell, units)
    record = made.run(40, every=20, trajectory=run, store_forces=True)
    md.to_gromacs(run, out)
    write_sample(tmp_path / "sample.h5md", boundary=("none",) * 3)
    ours, theirs = layout(out), layout(tmp_path / "sample.h5md")
    assert [key for key in theirs if key != "box" and ours[key] != theirs[key]] == []

    with h5py.File(out) as h5:
        atoms = h5[ATOMS]
        steps, times = atoms["position/step"][:], atoms["position/time"][:]
        stored = {name: atoms[f"{name}/value"][:] for name in ("position", "velocity", "force", "box/edges")}
        assert str(atoms["force/value"].attrs["unit"], "utf-8") == "kJ mol-1 nm-1"
        boundary = [str(word, "utf-8") for word in atoms["box"].attrs["boundary"]]
    assert steps.tolist() == record.step.tolist()
    assert times == pytest.approx(record.time * units.to_picosecond)
    has_box = made.system.cell.is_periodic and np.linalg.matrix_rank(made.system.cell.vectors) == 3
    assert boundary == ["periodic" if has_box and flag else "none" for flag in made.system.cell.pbc]
    to_nm, kj = units.to_angstrom / 10, units.to_kj_per_mol
    for k, frame in enumerate(frames_of(run, range(3), units)):
        box = stored["box/edges"][k].astype(float)
        vectors = made.system.cell.vectors * to_nm * has_box
        assert np.array_equal(box, np.tril(box))  # a along x, b in the xy plane
        assert box @ box.T == pytest.approx(vectors @ vectors.T, abs=1e-6)  # rounding of float32
        for name, factor in (("position", to_nm), ("velocity", to_nm / units.to_picosecond), ("force", kj / to_nm)):
            own = factor * getattr(frame, {"position": "positions", "velocity": "velocities", "force": "forces"}[name])
            found = stored[name][k].astype(float)
            assert found @ found.T == pytest.approx(own @ own.T, rel=1e-5, abs=1e-5 * np.abs(own).max() ** 2)
            if has_box:  # turned with the box
                assert found @ box.T == pytest.approx(own @ vectors.T, rel=1e-5, abs=1e-5 * np.abs(own).max())


def test_what_was_written_for_gromacs_comes_back(tmp_path):
    made = simulation("triclinic", md.units.ASE)
    made.run(45, every=1, trajectory=tmp_path / "run.h5md")  # more frames than in a commit
    md.to_gromacs(tmp_path / "run.h5md", tmp_path / "traj.h5md")
    back = system_from_file(tmp_path / "traj.h5md")
    assert back.positions == pytest.approx(made.positions, rel=1e-6)  # rounding of float32
    assert back.velocities == pytest.approx(made.velocities, rel=1e-6, abs=1e-6)
    assert back.cell.vectors == pytest.approx(made.system.cell.vectors, rel=1e-6, abs=1e-6)
    assert back.bonds.tolist() == made.system.bonds.tolist()
    assert back.masses == pytest.approx(made.system.masses, rel=1e-7)
    assert back.species.tolist() == made.system.species.tolist()
    with pytest.raises(ValueError, match="not written by minimd"):
        read_file(tmp_path / "traj.h5md")


def salt_water(topology=None):
    """Two waters, Na and Cl."""
    masses, charges = [15.999, 1.008, 1.008] * 2 + [22.99, 35.45], [-0.8476, 0.4238, 0.4238] * 2 + [1.0, -1.0]
    species, places = ["O", "H", "H"] * 2 + ["Na", "Cl"], 3.0 * np.arange(24.0).reshape(8, 3)
    return md.System(places, masses=masses, charges=charges, species=species, bonds=BONDS, units=md.units.ASE,
                     topology=topology)  # fmt: skip


def reduced():
    """Species that are symbols of elements by chance, and atoms of molecules that do not follow each other."""
    masses, species = np.where(np.arange(8) % 2, 2.0, 1.0), ["B", "A"] * 4
    return md.System(3.0 * np.arange(24.0).reshape(8, 3), masses=masses, species=species, bonds=[[0, 2], [1, 3]])


def named():
    """Residues of names and numbers of their own: two waters without bonds, and two residues of one molecule."""
    rows = [["OW", "O", "SOL", "1", "SOL"], ["HW1", "H", "SOL", "1", "SOL"], ["HW2", "H", "SOL", "1", "SOL"]]
    rows += [[*row[:3], "2", row[4]] for row in rows]
    rows += [["NA", "Na", "ONE", "7", "ONE"], ["CL", "Cl", "TWO", "8", "ONE"]]
    system = salt_water(np.array(rows))
    return md.System(**{**arguments_of(system), "bonds": [[6, 7]]})


WATERS = [[name, name, "MOL", number] for number in "12" for name in "OHH"]
RESIDUES = {
    salt_water: np.array([*WATERS, ["Na", "Na", "Na", "3"], ["Cl", "Cl", "Cl", "4"]]),
    reduced: np.array(
        [["BA"[k % 2], "", *(("MOL", str(1 + k % 2)) if k < 4 else ("BA"[k % 2], str(k - 1)))] for k in range(8)]
    ),
}


def for_gromacs(system, folder):
    """The system, in a run that was written as traj.h5md."""
    run = md.Simulation(system, [], md.VelocityVerlet(0.001))
    run.run(1, every=1, trajectory=folder / "run.h5md")
    md.to_gromacs(folder / "run.h5md", folder / "traj.h5md")
    return run.system


@pytest.mark.filterwarnings("ignore:the charges")
@pytest.mark.parametrize("system", [salt_water, reduced, named])
def test_masses_charges_elements_and_names_come_back_from_a_file_for_gromacs(tmp_path, system):
    made = for_gromacs(system(), tmp_path)
    back = system_from_file(tmp_path / "traj.h5md")
    assert back.masses.tolist() == made.masses.tolist()
    assert back.charges.tolist() == made.charges.tolist()
    assert back.species.tolist() == made.species.tolist()
    assert back.bonds.tolist() == made.bonds.tolist()
    residues = made.topology[:, :4] if len(made.topology) else RESIDUES[system]
    assert back.topology[:, :4].tolist() == residues.tolist()


def topology_of(path, molecule):
    """Of a type of molecule: its attributes, and its datasets by type, dimensions and unit."""
    with h5py.File(path) as h5:
        group = h5[TOPOLOGY]
        assert group.attrs["molecule_block_counts"].dtype == np.int32
        assert group.attrs["version"].tolist() == [0, 1]
        return {
            name: (item.dtype.kind, item.dtype.kind == "S" or item.dtype.itemsize, item.ndim, item.attrs.get("unit"))
            for name, item in group[molecule].items()
        }


@pytest.mark.filterwarnings("ignore:the charges")
def test_fields_of_atoms_are_written_as_gromacs_writes_them(tmp_path):
    write_sample(tmp_path / "sample.h5md")
    for_gromacs(salt_water(), tmp_path)
    ours, theirs = topology_of(tmp_path / "traj.h5md", "SYSTEM"), topology_of(tmp_path / "sample.h5md", "SOL")
    assert set(theirs) - set(ours) == {"id", "sequence"}  # which nobody needs
    assert [name for name in ours if ours[name] != theirs[name]] == []


def test_labels_in_reduced_units_are_no_elements(tmp_path):
    for_gromacs(reduced(), tmp_path)
    with h5py.File(tmp_path / "traj.h5md") as h5:
        assert not h5[f"{TOPOLOGY}/SYSTEM/species"][:].any()


def test_a_file_of_gromacs_without_masses_asks_for_elements_of_each_atom(tmp_path):
    write_sample(tmp_path / "traj.h5md")
    with h5py.File(tmp_path / "traj.h5md", "r+") as h5:
        del h5[TOPOLOGY]
    with pytest.raises(ValueError, match=r"elements=\['O', 'H', 'H', \.\.\.\]"):
        system_from_file(tmp_path / "traj.h5md")
    back = system_from_file(tmp_path / "traj.h5md", elements=["O", "H", "H"] * 2 + ["Na", "Cl"])
    assert back.masses[:2] == pytest.approx([15.999, 1.008])


def test_files_for_gromacs_replace_no_others(tmp_path):
    simulation().run(2, every=1, trajectory=tmp_path / "run.h5md")
    out = tmp_path / "traj.h5md"
    out.write_text("mine")
    with pytest.raises(FileExistsError, match="overwrite=True"):
        md.to_gromacs(tmp_path / "run.h5md", out)
    with pytest.raises(ValueError, match="suffix"):
        md.to_gromacs(tmp_path / "run.h5md", tmp_path / "traj.trr")
    with pytest.raises(OSError, match="another run is writing it"):
        md.to_gromacs(tmp_path / "run.h5md", tmp_path / "run.h5md", overwrite=True)
    assert out.read_text() == "mine"
    assert read_file(tmp_path / "run.h5md").n_frames == 3
    md.to_gromacs(tmp_path / "run.h5md", out, overwrite=True)
    assert h5py.is_hdf5(out)
    assert sorted(path.name for path in tmp_path.iterdir()) == ["run.h5md", "traj.h5md"]
