"""docs/formats.md: its scripts run in their order, its tables are those of the code."""

import re
import tomllib
from pathlib import Path

import numpy as np
import pytest
from test_structures import POSITIONS, write_data, write_pdb, write_psf

import minimd as md
from minimd.ase import system_from_file
from minimd.files.structure_file import SUFFIXES
from minimd.files.trajectory import FORMATS
from minimd.scene import load_scene

PAGE = (Path(__file__).parents[1] / "docs" / "formats.md").read_text(encoding="utf-8")
SCRIPTS = re.findall(r"```python\n(.*?)```", PAGE, re.S)
SCENE = re.findall(r"```toml\n(.*?)```", PAGE, re.S)


@pytest.fixture
def folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    write_data(tmp_path / "melt.data")
    write_pdb(tmp_path / "melt.pdb", with_bonds=True)
    write_psf(tmp_path / "melt.psf")
    return tmp_path


def test_scripts_of_the_page_run(folder, capsys):
    """In one process, on the file of a run of the melt."""
    pytest.importorskip("minimd_plugin")
    from test_ase_plugins import define

    define()
    sim = md.Simulation(system_from_file("melt.pdb"), md.LennardJones(0.01, 0.9, 2.5), md.VelocityVerlet(0.1))
    sim.run(20, every=5, trajectory="run.h5md")
    names = {}
    for script in SCRIPTS:
        exec(compile(script, "formats.md", "exec"), names)
        assert capsys.readouterr().out.strip()
    assert len(SCRIPTS) == 7
    assert len(POSITIONS) == len(names["atoms"])


def test_end_to_end_distances_of_the_page_are_those_of_whole_molecules(folder, capsys):
    """Also if the boundary cuts a molecule in the file that was given, whose frames are cut, too."""
    script, found = next(one for one in SCRIPTS if "ends = " in one), []
    for shift in (0.0, 0.6):
        system = system_from_file("melt.pdb")
        system.positions[:] = (
            system.cell.wrapped(system.positions + shift * system.cell.vectors.diagonal())
            if shift
            else system.positions
        )
        sim = md.Simulation(system, md.LennardJones(0.01, 0.9, 2.5), md.VelocityVerlet(0.1))
        sim.run(5, every=5, trajectory="run.h5md", overwrite=True)
        exec(compile(script, "formats.md", "exec"), names := {})
        found.append(names["ends"])
        names["u"].trajectory.close()
    np.testing.assert_allclose(found[1], found[0], rtol=1e-5)


def test_scene_of_the_page_is_one(folder):
    (folder / "melt.toml").write_text(SCENE[0] + "[dynamics]\ntimestep_fs = 1.0\nsteps = 0\n")
    assert tomllib.loads(SCENE[0])["structure"]["bonds"] == "file"
    scene = load_scene("melt.toml")
    assert len(scene.system().angles) == 12
    assert len(scene.simulation().potentials) == 2


def test_table_of_formats_is_that_of_the_code():
    written, read = PAGE.split("Read as structures")
    assert set(re.findall(r"`(\.\w+)`", written.split("can go on")[1].split('"Can go on"')[0])) == set(FORMATS)
    assert set(SUFFIXES) <= set(re.findall(r"`(\.\w+)`", read))
