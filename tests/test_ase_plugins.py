"""What ASE finds of minimd by its entry points, as they are declared in pyproject.toml."""

import subprocess
import sys
import tomllib
from importlib.metadata import EntryPoint
from pathlib import Path

import ase.io
import numpy as np
import pytest
from ase.calculators.calculator import get_calculator_class
from ase.io.formats import define_external_io_format, ioformats
from h5md_runs import simulation

import minimd as md
import minimd.ase

REPOSITORY = Path(__file__).parents[1]


def entry_points():
    project = tomllib.loads((REPOSITORY / "pyproject.toml").read_text())["project"]
    return {group: project["entry-points"][group] for group in ("ase.ioformats", "ase.plugins")}


@pytest.fixture
def installed(tmp_path, monkeypatch):
    """A folder in which minimd is installed as far as entry points go."""
    place = tmp_path / "site" / "minimd-0.dist-info"
    place.mkdir(parents=True)
    lines = [
        f"[{group}]\n" + "".join(f"{name} = {target}\n" for name, target in points.items())
        for group, points in entry_points().items()
    ]
    (place / "entry_points.txt").write_text("\n".join(lines))
    (place / "METADATA").write_text("Metadata-Version: 2.1\nName: minimd\nVersion: 0\nSummary: installed\n")
    monkeypatch.setenv("PYTHONPATH", str(place.parent), prepend=":")
    monkeypatch.setenv("PYTHONPATH", str(REPOSITORY), prepend=":")
    return place.parent


def answer(code):
    made = subprocess.run(
        [sys.executable, "-W", "error::UserWarning", "-c", code], capture_output=True, text=True, check=False
    )
    assert made.returncode == 0, made.stderr
    return made.stdout


def define():
    """Make the format known in this process, whether or not minimd is installed with its entry points."""
    if "minimd-h5md" not in ioformats:
        define_external_io_format(
            EntryPoint("minimd-h5md", entry_points()["ase.ioformats"]["minimd-h5md"], "ase.ioformats")
        )


known = pytest.fixture(define, name="known")


@pytest.mark.parametrize("units", [md.units.ASE, md.units.LJ], ids=lambda units: units.name)
def test_ase_reads_the_frames_of_a_run(tmp_path, known, units):
    """To the last bit; forces, which the file holds in kJ/mol, to rounding."""
    sim, seen = simulation("triclinic", units), []
    look = [lambda s: seen.append((s.step, s.time, s.positions.copy(), s.velocities.copy(), s.forces.copy()))]
    record = sim.run(20, every=5, trajectory=tmp_path / "a.h5md", store_forces=True, observers=look)
    frames = ase.io.read(tmp_path / "a.h5md", index=":")
    assert len(frames) == len(seen) == 5
    for atoms, energy, (step, time, positions, velocities, forces) in zip(
        frames, record.potential_energy, seen, strict=True
    ):
        np.testing.assert_array_equal(atoms.positions, positions)
        np.testing.assert_allclose(atoms.get_velocities(), velocities, rtol=1e-14)
        np.testing.assert_allclose(atoms.get_forces(), forces, rtol=1e-14)
        assert atoms.get_potential_energy() == energy
        assert (atoms.info["step"], atoms.info["time"]) == (step, time)
        np.testing.assert_array_equal(atoms.get_masses(), sim.system.masses)
        np.testing.assert_array_equal(atoms.cell.array, sim.system.cell.vectors)
        assert atoms.get_chemical_symbols() == sim.system.species.tolist()
    for index, steps in ((-1, 20), (0, 0), (2, 10)):
        assert ase.io.read(tmp_path / "a.h5md", index=index).info["step"] == steps
    assert [atoms.info["step"] for atoms in ase.io.read(tmp_path / "a.h5md", index="1::2")] == [5, 15]
    np.testing.assert_array_equal(md.System.from_ase(frames[0]).bonds, sim.system.bonds)


def test_frames_without_forces_have_none(tmp_path, known):
    simulation().run(0, trajectory=tmp_path / "a.h5md")
    atoms = ase.io.read(tmp_path / "a.h5md")
    assert "forces" not in atoms.calc.results
    (tmp_path / "b.h5md").write_text("none")
    with pytest.raises(ValueError, match="not an HDF5 file"):
        ase.io.read(tmp_path / "b.h5md")


def test_angles_of_a_run_come_back_through_ase(tmp_path, known):
    system = md.System(
        2.0 * np.eye(4, 3),
        masses=1.0,
        bonds=[[0, 1], [1, 2], [3, 1]],
        angles=[[0, 1, 2], [2, 1, 3]],
        units=md.units.ASE,
    )
    md.Simulation(system, md.HarmonicBond(1.0, 2.0), md.VelocityVerlet(0.1)).run(0, trajectory=tmp_path / "a.h5md")
    read = md.System.from_ase(ase.io.read(tmp_path / "a.h5md"))
    assert read.bonds.tolist() == system.bonds.tolist()
    assert read.angles.tolist() == system.angles.tolist()


def test_ase_finds_the_format_by_the_entry_point(installed):
    """Without loading minimd: everybody who imports ase.io would wait for it."""
    code = "import sys, ase.io.formats as f; print('minimd-h5md' in f.ioformats, f.filetype('run.h5md', read=False), 'minimd' in sys.modules)"
    assert answer(code).split() == ["True", "minimd-h5md", "False"]


def test_ase_lists_the_calculator(installed):
    code = "from ase._4.plugins import plugins; print(*[(p.name, p.implementation.__name__) for p in plugins if p.package == 'minimd'])"
    assert answer(code).strip() == "('minimd', 'Calculator')"
    assert get_calculator_class("minimd") is minimd.ase.Calculator
