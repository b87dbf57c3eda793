"""What ASE reads of the files of a run, and finds of minimd by the entry points in pyproject.toml."""

import ase.io
import numpy as np
import pytest
from argon_atoms import REPOSITORY, define, entry_points
from ase.calculators.calculator import get_calculator_class
from h5md_runs import simulation
from processes import ended
from references import liquid
from scenes import LJ
from wrong_calls import assert_answered

import minimd as md
import minimd.ase
from minimd.core.structure.system import changed

TEXT, EXACT = 0.51e-8, 1e-14  # of files with eight decimals; of numbers in binary
FILES = {"a.traj": EXACT, "b.TRAJ": EXACT, "a.xyz": TEXT, "a.extxyz": TEXT, "a.h5md": EXACT}
known = pytest.fixture(define, name="known")
TWO_ATOMS = "of two types\n\n2 atoms\n2 atom types\n\n0 9 xlo xhi\n0 9 ylo yhi\n0 9 zlo zhi\n\nMasses\n\n1 {}\n2 {}\n"
TWO_ATOMS += "\nAtoms # atomic\n\n1 1 1.0 1.0 1.0\n2 2 4.0 1.0 1.0\n"
ANSWER = """
import sys, ase.io.formats as f
print('minimd-h5md' in f.ioformats, f.filetype('run.h5md', read=False), 'minimd' in sys.modules)
from ase._4.plugins import plugins
print(*[(p.name, p.implementation.__name__) for p in plugins if p.package == 'minimd'])
"""


@pytest.fixture(scope="module", params=[(md.units.ASE, True), (md.units.ASE, False), (md.units.LJ, True)])
def written(request, tmp_path_factory):
    units, has_forces = request.param
    folder, sim, seen = tmp_path_factory.mktemp("run"), simulation("triclinic", units), []
    look = [lambda s: seen.append((s.step, s.time, s.positions.copy(), s.velocities.copy(), s.forces.copy()))]
    files = [folder / name for name in FILES]
    record = sim.run(20, every=5, trajectory=files, store_forces=has_forces, observers=look)
    return folder, sim.system, record, seen, has_forces


def is_near(found, expected, tolerance):
    """Decimals are absolute, bits are relative to the largest."""
    return np.abs(found - expected).max() <= tolerance * (1.0 if tolerance == TEXT else np.abs(expected).max())


@pytest.mark.parametrize("name", FILES)
def test_ase_reads_the_frames_of_a_run(name, written, known):
    folder, system, record, seen, has_forces = written
    frames = ase.io.read(folder / name, ":", format={"xyz": "extxyz", "raj": "traj"}.get(name[-3:].lower()))
    assert len(frames) == len(seen) == 5
    for atoms, energy, looked in zip(frames, record.potential_energy, seen, strict=True):
        step, time, positions, velocities, forces = looked
        assert (atoms.info["step"], atoms.info["time"], atoms.get_potential_energy()) == (step, time, energy)
        assert system.cell.same_as(md.Cell.of(atoms.cell.array, atoms.pbc))
        assert atoms.get_chemical_symbols() == system.species.tolist()
        assert is_near(atoms.positions, positions, FILES[name] * (FILES[name] == TEXT))
        assert is_near(atoms.get_masses(), system.masses, FILES[name])
        assert is_near(atoms.get_momenta(), system.masses[:, None] * velocities, FILES[name])
        assert ("forces" in atoms.calc.results) == has_forces
        assert not has_forces or is_near(atoms.get_forces(), forces, FILES[name])


def test_any_frames_of_an_h5md_file_are_read_and_atoms_are_bonded(written, known):
    folder, system, *_ = written
    for index, steps in ((-1, 20), (0, 0), (2, 10)):
        assert ase.io.read(folder / "a.h5md", index=index).info["step"] == steps
    frames = ase.io.read(folder / "a.h5md", index="1::2")
    assert [atoms.info["step"] for atoms in frames] == [5, 15]
    assert np.array_equal(md.System.from_ase(frames[0]).bonds, system.bonds)


@pytest.mark.slow
def test_ase_finds_format_and_calculator_by_the_entry_points(tmp_path):
    """The format without loading minimd: everybody who imports ase.io would wait for it."""
    place = tmp_path / "site" / "minimd_engine-0.dist-info"  # installed as far as entry points go
    place.mkdir(parents=True)
    rows = [f"[{group}]\n{name} = {target}\n" for group, of in entry_points().items() for name, target in of.items()]
    (place / "entry_points.txt").write_text("".join(rows))
    (place / "METADATA").write_text("Metadata-Version: 2.1\nName: minimd-engine\nVersion: 0\nSummary: installed\n")
    made = ended("-W", "error::UserWarning", "-c", ANSWER, PYTHONPATH=f"{REPOSITORY}:{place.parent}")
    assert made.returncode == 0, made.stderr
    assert made.stdout.splitlines() == ["True minimd-h5md False", "('minimd', 'Calculator')"]
    assert get_calculator_class("minimd") is minimd.ase.Calculator


def test_types_of_lammps_data_are_elements_only_with_their_masses_and_unknown_symbols_are_told(tmp_path):
    known = {(12.0, 16.0): ["C", "O"], (15.9994, 1.008): ["O", "H"]}
    known |= {masses: ["1", "2"] for masses in [(14.027, 15.035), (14.0, 13.0), (100.0, 120.0)]}
    for masses, species in known.items():
        (tmp_path / "a.data").write_text(TWO_ATOMS.format(*masses))
        assert minimd.ase.system_from_file(tmp_path / "a.data", lammps_units="metal").species.tolist() == species
    (tmp_path / "ab.xyz").write_text("2\n\nA 0 0 0\nB 1 0 0\n")
    assert_answered(lambda: minimd.ase.system_from_file(tmp_path / "ab.xyz"), ValueError, "chemical symbol", "'A'")


@pytest.mark.parametrize("suffix", ["h5md", "traj", "xyz"])
def test_a_stress_that_was_asked_for_reaches_ase(tmp_path, suffix):
    """As ASE has it: without the kinetic part, which its include_ideal_gas adds."""
    system = changed(liquid(3), species=["Ar"] * 108, units=md.units.ASE)
    sim = md.Simulation(system, LJ, md.VelocityVerlet(0.002))
    sim.extra_observables = ("stress",)
    record = sim.run(20, every=10, trajectory=tmp_path / f"a.{suffix}")
    atoms = ase.io.read(tmp_path / f"a.{suffix}")
    close = {"rel": 1e-6, "abs": 1e-6}  # .xyz has 8 decimals
    assert atoms.get_stress(voigt=False, include_ideal_gas=True) == pytest.approx(record.stress[-1], **close)
    virial = md.evaluate(sim.system, LJ).virial
    assert atoms.get_stress(voigt=False) == pytest.approx(-virial / sim.system.volume, **close)


@pytest.mark.parametrize("suffix", ["traj", "xyz", "h5md"])
def test_files_of_reduced_runs_keep_species_masses_and_velocities(tmp_path, suffix):
    made, file, species = simulation(), tmp_path / f"run.{suffix}", ["1", "Ar", "2"] * 9
    system = changed(made.system, species=species)
    sim = md.Simulation(system, made.potentials, made.method)
    sim.run(2, every=1, trajectory=file)
    read = minimd.ase.system_from_file(file, units=md.units.LJ)
    assert read.units is md.units.LJ
    assert read.species.tolist() == species
    np.testing.assert_allclose(read.masses, system.masses, rtol=1e-7)
    np.testing.assert_allclose(read.velocities, sim.velocities, atol=2e-8)
    if suffix == "h5md":
        assert minimd.ase.system_from_file(file).units is md.units.LJ
        assert_answered(lambda: minimd.ase.system_from_file(file, units=md.units.ASE), ValueError, "units", "'LJ'")
