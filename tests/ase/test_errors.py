"""What users of ASE get wrong: one sentence names it, and nothing is left behind."""

import ase.io
import numpy as np
import pytest
from argon_atoms import CUTOFF, EPSILON, SIGMA, TIMESTEP, argon, copper, define, lennard_jones, liquid, with_calculator
from ase.constraints import FixedPlane, Hookean
from wrong_calls import assert_answered

import minimd as md
import minimd.ase as ours
from minimd.ase import Calculator, ForcesFromCalculator, system_from_atoms


def held(*constraints):
    atoms = with_calculator(argon(1), Calculator(lennard_jones()))
    atoms.set_constraint(constraints)
    return atoms


def langevin(atoms=None, rng=1, **options):
    atoms = atoms or liquid()
    atoms.calc = Calculator(lennard_jones())
    return ours.Langevin(atoms, TIMESTEP, **{"temperature_K": 90.0, "friction": 0.01, "rng": rng} | options)


NOT_YET = (NotImplementedError, "externalstress", "-0.01")
PLANE, SPRING = FixedPlane(0, (0, 0, 1)), Hookean(0, 1, 5.0, 1.0)
WRONG = [
    (lambda: md.System.from_ase([[0.0, 0.0, 0.0]]), TypeError, "ase.Atoms", "list"),
    (lambda: system_from_atoms(held(PLANE)), ValueError, "atoms.constraints", "FixedPlane"),
    (lambda: system_from_atoms(held(SPRING)), ValueError, "atoms.constraints", "Hookean"),
    (lambda: ours.VelocityVerlet(held(SPRING), TIMESTEP).run(1), ValueError, "atoms.constraints", "Hookean"),
    (lambda: ours.VelocityVerlet(argon(1), TIMESTEP).step(), RuntimeError, "atoms.calc", "no calculator"),
    (lambda: ForcesFromCalculator(lennard_jones()), TypeError, "calculator", "LennardJones"),
    (lambda: md.Simulation(copper(), "EMT", md.VelocityVerlet(TIMESTEP)), TypeError, "potentials", "'EMT'"),
    (lambda: langevin(rng="seven"), TypeError, "rng", "'seven'"),
    (lambda: langevin(rng=-1), TypeError, "rng", "-1"),
    (lambda: langevin(rng=object()), TypeError, "rng", "object"),
    (lambda: langevin(held()[:1], fixcm=True).run(1), ValueError, "fixcm", "3"),
    (lambda: langevin(fixcm=False, friction=-1.0).run(1), ValueError, "friction", "-1.0"),
    (lambda: ours.Bussi(liquid(), TIMESTEP, 300.0, -1.0, rng=2).run(1), ValueError, "taut", "-1.0"),
    (lambda: ours.LangevinBAOAB(held(), TIMESTEP, externalstress=-0.01), *NOT_YET),
]


@pytest.mark.filterwarnings("ignore")
@pytest.mark.parametrize("row", range(len(WRONG)))
def test_wrong_calls_are_answered(row):
    call, error, *shown = WRONG[row]
    with np.errstate(invalid="ignore"):
        assert_answered(call, error, *shown)


def test_a_file_of_another_kind_is_refused_and_a_failed_call_leaves_nothing_behind(tmp_path):
    define()
    (tmp_path / "b.h5md").write_text("none")
    with pytest.raises(ValueError, match=r"b\.h5md"):
        ase.io.read(tmp_path / "b.h5md")
    atoms = with_calculator(argon(1), Calculator(md.LennardJones({"Ar": (EPSILON, SIGMA)}, cutoff=CUTOFF)))
    before = atoms.get_potential_energy()
    atoms.numbers[0] = 36
    for _ in range(2):
        assert_answered(atoms.get_potential_energy, ValueError, "species", "'Kr'")
    atoms.numbers[0] = 18
    atoms.positions[2], there = atoms.positions[1], atoms.positions[2].copy()
    assert_answered(atoms.get_forces, md.NonFiniteError, "atoms 1 and 2")
    atoms.positions[2] = there
    assert atoms.get_potential_energy() == pytest.approx(before, rel=1e-14)
