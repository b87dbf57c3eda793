"""Species, masses, velocities and stress on the way through files that ASE reads."""

import ase.io
import numpy as np
import pytest
from h5md_runs import simulation
from references import liquid
from wrong_calls import assert_answered

import minimd as md
from minimd.ase import system_from_file

LJ = md.LennardJones(1.0, 1.0, 1.85, "switched")
TWO_ATOMS = """of two types

2 atoms
2 atom types

0 9 xlo xhi
0 9 ylo yhi
0 9 zlo zhi

Masses

1 {}
2 {}

Atoms # atomic

1 1 1.0 1.0 1.0
2 2 4.0 1.0 1.0
"""


def test_types_of_lammps_data_are_elements_only_with_their_masses(tmp_path):
    known = {(12.0, 16.0): ["C", "O"], (15.9994, 1.008): ["O", "H"]}
    known |= {masses: ["1", "2"] for masses in [(14.027, 15.035), (14.0, 13.0), (100.0, 120.0)]}
    for masses, species in known.items():
        (tmp_path / "a.data").write_text(TWO_ATOMS.format(*masses))
        assert system_from_file(tmp_path / "a.data").species.tolist() == species


@pytest.mark.parametrize("suffix", ["h5md", "traj", "xyz"])
def test_a_stress_that_was_asked_for_reaches_ase(tmp_path, suffix):
    """As ASE has it: without the kinetic part, which its include_ideal_gas adds."""
    start = liquid(3)
    options = {"velocities": start.velocities, "masses": 1.0, "cell": start.cell, "units": md.units.ASE}
    system = md.System(start.positions, species=["Ar"] * len(start), **options)
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
    options = {"masses": made.system.masses, "velocities": made.velocities}
    system = md.System(made.positions, cell=3.6, species=species, **options)
    sim = md.Simulation(system, made.potentials, made.method)
    sim.run(2, every=1, trajectory=file)
    read = system_from_file(file, units=md.units.LJ)
    assert read.units is md.units.LJ
    assert read.species.tolist() == species
    np.testing.assert_allclose(read.masses, system.masses, rtol=1e-7)
    np.testing.assert_allclose(read.velocities, sim.velocities, atol=2e-8)
    if suffix == "h5md":
        assert system_from_file(file).units is md.units.LJ
        assert_answered(lambda: system_from_file(file, units=md.units.ASE), ValueError, "units", "'LJ'")


def test_labels_that_ase_does_not_know_are_told(tmp_path):
    (tmp_path / "ab.xyz").write_text("2\n\nA 0 0 0\nB 1 0 0\n")
    assert_answered(lambda: system_from_file(tmp_path / "ab.xyz"), ValueError, "chemical symbol", "'A'")
