"""What ASE reads of the files of a run, and finds of minimd by the entry points in pyproject.toml."""

import subprocess
import sys

import ase.io
import numpy as np
import pytest
from argon_atoms import REPOSITORY, define, entry_points, same
from ase.calculators.calculator import get_calculator_class
from h5md_runs import simulation

import minimd as md
import minimd.ase
from minimd.ase import system_from_atoms

TEXT, EXACT = 0.51e-8, 1e-14  # of files with eight decimals; of numbers in binary
FILES = {"a.traj": EXACT, "b.TRAJ": EXACT, "a.xyz": TEXT, "a.extxyz": TEXT, "a.h5md": EXACT}
known = pytest.fixture(define, name="known")


@pytest.fixture(scope="module", params=[(md.units.ASE, True), (md.units.ASE, False), (md.units.LJ, True)])
def written(request, tmp_path_factory):
    """A run of 27 atoms in a triclinic cell, written to files of all kinds, and what an observer has seen of it."""
    units, has_forces = request.param
    folder, sim, seen = tmp_path_factory.mktemp("run"), simulation("triclinic", units), []

    def look(s):
        seen.append((s.step, s.time, s.positions.copy(), s.velocities.copy(), s.forces.copy()))

    files = [folder / name for name in FILES]
    record = sim.run(20, every=5, trajectory=files, store_forces=has_forces, observers=[look])
    return folder, sim.system, record, seen, has_forces


def is_near(found, expected, tolerance):
    """Decimals are absolute, bits are relative to the largest."""
    return np.abs(found - expected).max() <= tolerance * (1.0 if tolerance == TEXT else np.abs(expected).max())


@pytest.mark.parametrize("name", FILES)
def test_ase_reads_the_frames_of_a_run(name, written, known):
    folder, system, record, seen, has_forces = written
    formats = {"xyz": "extxyz", "raj": "traj"}.get(name[-3:].lower())
    frames = ase.io.read(folder / name, ":", format=formats)
    assert len(frames) == len(seen) == 5
    for atoms, energy, (step, time, positions, velocities, forces) in zip(
        frames, record.potential_energy, seen, strict=True
    ):
        assert (atoms.info["step"], atoms.info["time"]) == (step, time)
        assert atoms.get_potential_energy() == energy
        assert np.array_equal(atoms.cell.array, system.cell.vectors)
        assert atoms.pbc.all()
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


def test_angles_of_a_run_come_back_through_ase(tmp_path, known):
    bonds, angles = [[0, 1], [1, 2], [3, 1]], [[0, 1, 2], [2, 1, 3]]
    system = md.System(2.0 * np.eye(4, 3), masses=1.0, bonds=bonds, angles=angles, units=md.units.ASE)
    md.Simulation(system, md.HarmonicBond(1.0, 2.0), md.VelocityVerlet(0.1)).run(0, trajectory=tmp_path / "a.h5md")
    read = md.System.from_ase(ase.io.read(tmp_path / "a.h5md"))
    assert read.bonds.tolist() == system.bonds.tolist()
    assert read.angles.tolist() == system.angles.tolist()


@pytest.mark.filterwarnings("ignore:the center of mass moves")
def test_labels_and_reduced_numbers_are_in_an_xyz_file(tmp_path):
    system = md.System([[0.0, 0, 0], [1.1, 0, 0]], species=["A", "bead"], velocities=[[0.1, 0, 0], [0, 0.2, 0]])
    simulation = md.Simulation(system, md.LennardJones(1.0, 1.0), md.VelocityVerlet(0.001))
    simulation.run(0, trajectory=tmp_path / "a.xyz")
    back = system_from_atoms(ase.io.read(tmp_path / "a.xyz"))
    assert back.species.tolist() == ["A", "bead"]
    assert same(back.velocities, system.velocities, 1e-7)


ANSWER = """
import sys, ase.io.formats as f
print('minimd-h5md' in f.ioformats, f.filetype('run.h5md', read=False), 'minimd' in sys.modules)
from ase._4.plugins import plugins
print(*[(p.name, p.implementation.__name__) for p in plugins if p.package == 'minimd'])
"""


def test_ase_finds_format_and_calculator_by_the_entry_points(tmp_path, monkeypatch):
    """The format without loading minimd: everybody who imports ase.io would wait for it."""
    place = tmp_path / "site" / "minimd-0.dist-info"  # installed as far as entry points go
    place.mkdir(parents=True)
    lines = [
        f"[{group}]\n" + "".join(f"{name} = {target}\n" for name, target in points.items())
        for group, points in entry_points().items()
    ]
    (place / "entry_points.txt").write_text("\n".join(lines))
    (place / "METADATA").write_text("Metadata-Version: 2.1\nName: minimd\nVersion: 0\nSummary: installed\n")
    for path in (place.parent, REPOSITORY):
        monkeypatch.setenv("PYTHONPATH", str(path), prepend=":")
    command = [sys.executable, "-W", "error::UserWarning", "-c", ANSWER]
    made = subprocess.run(command, capture_output=True, text=True, check=False)
    assert made.returncode == 0, made.stderr
    assert made.stdout.splitlines() == ["True minimd-h5md False", "('minimd', 'Calculator')"]
    assert get_calculator_class("minimd") is minimd.ase.Calculator
