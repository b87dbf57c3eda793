"""What made newcomers stumble once: words, units and species."""

import re
import subprocess
import sys

import ase.io
import numpy as np
import pytest
from references import liquid
from test_structures import write_data

import minimd as md
from minimd.ase import system_from_file

LJ = md.LennardJones(1.0, 1.0, 1.85, "switched")
TWO_ATOMS = """of two types

2 atoms

{n} atom types

0 9 xlo xhi
0 9 ylo yhi
0 9 zlo zhi

Masses

{masses}

Atoms # atomic

1 1 1.0 1.0 1.0
2 2 4.0 1.0 1.0
"""


@pytest.mark.parametrize(
    ("masses", "species"),
    [
        ((14.027, 15.035), ["1", "2"]),
        ((14.0, 13.0), ["1", "2"]),
        ((100.0, 120.0), ["1", "2"]),
        ((12.0, 16.0), ["C", "O"]),
        ((15.9994, 1.008), ["O", "H"]),
    ],
)
def test_types_of_lammps_data_are_elements_only_with_their_masses(tmp_path, masses, species):
    lines = "\n".join(f"{k + 1} {mass}" for k, mass in enumerate(masses))
    (tmp_path / "a.data").write_text(TWO_ATOMS.format(n=2, masses=lines))
    assert system_from_file(tmp_path / "a.data").species.tolist() == species


def test_angles_are_shown(tmp_path):
    write_data(tmp_path / "melt.data")
    system = system_from_file(tmp_path / "melt.data", units=md.units.LJ)
    assert len(system.angles)
    assert f"{len(system.angles)} angles" in repr(system)
    assert ["angles", str(len(system.angles))] in [line.split() for line in str(system).splitlines()]
    assert "angles" in system._repr_html_()


@pytest.mark.parametrize("suffix", ["h5md", "traj", "xyz"])
def test_a_stress_that_was_asked_for_reaches_ase(tmp_path, suffix):
    """As ASE has it: without the kinetic part, which its include_ideal_gas adds."""
    system = liquid(3)
    system = md.System(
        system.positions,
        velocities=system.velocities,
        masses=1.0,
        cell=system.cell,
        species=["Ar"] * len(system),
        units=md.units.ASE,
    )
    sim = md.Simulation(system, LJ, md.VelocityVerlet(0.002))
    sim.extra_observables = ("stress",)
    record = sim.run(20, every=10, trajectory=tmp_path / f"a.{suffix}")
    atoms = ase.io.read(tmp_path / f"a.{suffix}")
    full = atoms.get_stress(voigt=False, include_ideal_gas=True)
    assert full == pytest.approx(record.stress[-1], rel=1e-6, abs=1e-6)  # .xyz has 8 decimals
    virial = md.evaluate(sim.system, LJ).virial
    assert atoms.get_stress(voigt=False) == pytest.approx(-virial / sim.system.volume, rel=1e-6, abs=1e-6)


def test_first_and_last_are_no_range():
    sim = md.Simulation(liquid(3), LJ, md.VelocityVerlet(0.002))
    text = str(sim.run(20, every=10))
    assert "first " in text
    assert ", last " in text
    assert " from " not in text
    assert "of single atoms: least " in str(md.evaluate(liquid(3), LJ))


@pytest.mark.filterwarnings("ignore:timestep")
def test_times_and_lengths_of_a_replay_have_units(tmp_path):
    fs = md.units.fs
    system = md.System([[0, 0, 0], [1.12, 0, 0]], masses=14.0, bonds=[[0, 1]], units=md.units.ASE, cell=20.0)
    sim = md.Simulation(system, md.HarmonicBond(100.0, 1.1), md.VelocityVerlet(2.0004 * (0.07**0.5)))
    with pytest.raises(md.NonFiniteError) as caught:
        sim.run(3000, crash_report=tmp_path / "a.crash.h5md")
    assert re.search(r"atoms 0 and 1, \S+ Å apart", str(caught.value))
    assert "eV/Å on atom" in str(caught.value.crash_report)
    seen = md.replay(tmp_path / "a.crash.h5md", sim.potentials)
    heads, last = (
        str(seen).splitlines()[1].split(),
        next(line for line in str(seen).splitlines() if line.startswith(f"{sim.step:>8}")),
    )
    assert heads == ["ps", "eV", "Å", "eV/Å", "Å/ps"]
    assert float(last.split()[1]) == pytest.approx(sim.step * sim.method.timestep / fs / 1000.0, rel=1e-4)
    assert "/ ps, period" in str(md.advise_timestep(system, sim.potentials))
    with pytest.raises(FileExistsError, match="--overwrite"):
        md.replay(tmp_path / "a.crash.h5md", sim.potentials)
    with pytest.raises(
        ValueError, match=r"minimd.replay\(file, \[...\]\), or give the command a scene that has them with --scene"
    ):
        md.replay(tmp_path / "a.crash.h5md", overwrite=True)
    assert np.isfinite(seen.rows[-1].energy)


def test_no_result_fills_the_screen(tmp_path):
    """What a cell of a notebook ends with is a few lines, none of which shows an address."""
    from ase.build import molecule

    from minimd.ase import Calculator, Langevin
    from minimd.files.h5md_reader import read_file
    from minimd.mdanalysis import Frames, diffusion_coefficient, radial_distribution

    frames = Frames()
    sim = md.Simulation(liquid(3), LJ, md.VelocityVerlet(0.002))
    sim.run(60, every=2, trajectory=tmp_path / "a.h5md", observers=[frames])
    problem = md.integrators.SecondOrder(lambda q: -q)
    atoms = molecule("N2")
    atoms.calc = Calculator(md.HarmonicBond(100.0, 1.1, pairs=[[0, 1]]))
    shown = [
        radial_distribution(frames),
        diffusion_coefficient(frames),
        read_file(tmp_path / "a.h5md"),
        frames,
        problem,
        atoms.calc,
    ]
    shown += [md.integrators.run_steps(problem, md.VelocityVerlet(0.1), ([1.0], [0.0]), 1000)]
    shown += [Langevin(atoms, 1.0, temperature_K=300.0, friction=0.01), md.integrators.FirstOrder(lambda y: -y)]
    for one in shown:
        for text in (repr(one), str(one)):
            assert " at 0x" not in text, text
            assert "array(" not in text, text
            assert len(text.splitlines()) < 20
        assert len(repr(one)) < 300
        assert "\n" not in repr(one)
    assert repr(problem) == "SecondOrder(f(q))"
    assert "frames         31, without forces" in str(shown[2])
    assert "states         1001 of q and v" in str(shown[6])


def test_units_offer_units_only():
    offered = [name for name in dir(md.units) if not name.startswith("_")]
    assert {"ASE", "LJ", "fs", "ps"} <= set(offered)
    assert not {"Any", "dataclass", "math"} & set(offered)


def test_python_runs_the_command_as_a_module():
    done = subprocess.run([sys.executable, "-m", "minimd", "--version"], capture_output=True, text=True, check=True)
    assert done.stdout.startswith("minimd ")


def test_density_of_mass_is_in_grams():
    """Argon at 1.374 g/cm³ has 0.0207 atoms/Å³."""
    system = md.System(
        [[0.0, 0, 0]], masses=39.948, cell=[1.0, 1.0, 39.948 / (1.374 * 0.6022140858549161)], units=md.units.ASE
    )
    assert "1.374 g/cm³" in str(system)


def test_a_misspelt_attribute_of_a_simulation_is_refused():
    sim = md.Simulation(liquid(3), LJ, md.VelocityVerlet(0.002))
    with pytest.raises(AttributeError, match="has no attribute 'stp' that could be set; did you mean 'step'"):
        sim.stp = 3
    with pytest.raises(AttributeError, match="has no attribute 'timstep'"):
        sim.timstep = 3
    sim.step, sim.method = 7, md.VelocityVerlet(0.001)
    assert sim.step == 7

    class Mine(md.Simulation):
        pass

    mine = Mine(liquid(3), LJ, md.VelocityVerlet(0.002))
    mine.note = "kept"
    assert mine.note == "kept"


def test_diffusion_of_langevin_dynamics_is_called_that(tmp_path):
    from minimd.analysis.check import liquid as lines_of

    hot = md.System(liquid(3).positions, cell=liquid(3).cell)
    for method, told in ((md.LangevinBAOAB(0.004, 3.0, 0.1, seed=1), True), (md.VelocityVerlet(0.004), False)):
        sim = md.Simulation(hot, LJ, method)
        sim.set_temperature(3.0, seed=1)
        sim.run(1000, every=10, trajectory=tmp_path / "a.h5md", overwrite=True)
        found = [line for line in lines_of(tmp_path / "a.h5md") if line.startswith("diffusion")]
        assert len(found) == 1
        assert ("of Langevin dynamics" in found[0]) is told
