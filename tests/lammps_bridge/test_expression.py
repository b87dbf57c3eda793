"""What is written for LAMMPS: laws in the words of Lepton, and a cell in LAMMPS' form. It needs no LAMMPS."""

import math

import numpy as np
import pytest
from lammps_scenes import ROTATION, SCENES, SKEWED, buckingham
from wrong_calls import assert_answered

import minimd as md
from minimd.core.potentials.law import checked_law
from minimd.core.structure.lammps_box import Box
from minimd.lammps.expression import UnwritableError, energy_expression
from minimd.lammps.model import Model
from minimd.lammps.script import write_atoms

UNWRITABLE = {
    "sinc": lambda r2, k: (k * np.sinc(r2), 0.0), "gamma": lambda r2, k: (k * math.gamma(r2), 0.0),
    "whole numbers": lambda r2, k: (k * [1.0, 2.0][int(r2)], 0.0),
    "more than 8 conditions": lambda r2, k: (next(x for x in range(20) if r2 < x) * k, 0.0),
    "inf": lambda r2, k: (k * math.inf * r2, 0.0),
}  # fmt: skip


def evaluated(text, r):
    whole, *named = text.replace("^", "**").split(";")
    names = vars(np) | {"r": r, "select": lambda a, b, c: b if a else c, "min": min, "max": max}
    names["step"] = lambda x: float(x >= 0.0)
    for one in reversed(named):
        name, _, formula = one.partition("=")
        names[name] = eval(formula, {}, names)
    return eval(whole, {}, names)


@pytest.mark.parametrize("truncation", ["truncated", "shifted", "force-shifted", "switched", "charmm", "smooth"])
def test_the_expression_of_a_law_is_the_law(truncation):
    potential = md.PairPotential(buckingham, (3e5, 0.08, 2.0), 2.5, truncation)
    text = energy_expression(potential.law, tuple(potential.table(["X"])[0, 0][1:]))
    for r in (0.9, 1.1, 1.9, 2.2, 2.4):
        assert evaluated(text, r) == pytest.approx(float(potential.pair_energy(r)), rel=1e-13)


def test_laws_are_followed_through_decisions_and_functions_of_numpy():
    def law(r2, width):
        r = np.sqrt(r2)
        if r < 1.0 and width > 0.0:
            u = np.where(r > 0.5, np.tanh(r), 0.25) + abs(r - 2.0)
        elif r <= 1.5:
            u = r2**1.5 - r**0.5 - np.maximum(r, 1.2) * (r >= 1.3)
        else:
            u = -math.log(r, 2.5) + np.minimum(2.0, r) + 2.0**-r
        return u, 0.0

    text = energy_expression(checked_law(law), (0.3,))
    for r in (0.4, 0.7, 1.1, 1.4, 1.9, 2.5):
        assert evaluated(text, r) == pytest.approx(float(law(r * r, 0.3)[0]), rel=1e-14)


@pytest.mark.parametrize("why", UNWRITABLE)
def test_laws_that_lepton_cannot_write_are_refused(why):
    call = lambda: energy_expression(checked_law(UNWRITABLE[why]), (1.0,))  # noqa: E731
    assert_answered(call, UnwritableError, "the law <lambda>", why)


def error_of_waves(simulation):
    words = " ".join(Model(simulation.engine).commands()).split()
    return float(words[words.index("kspace_style") + 2])


def test_charges_and_their_accuracy_as_text(tmp_path):
    """LAMMPS' units lj have k_e = 1 and errors of forces in energy / length."""
    simulation, ke = SCENES["skewed salt"](), md.units.ASE.coulomb
    model, forces = Model(simulation.engine), md.evaluate(simulation.system, md.Coulomb(5.4)).forces
    write_atoms(tmp_path / "atoms", model, model.box, simulation.velocities)
    rows = (tmp_path / "atoms").read_text().partition("Atoms # full\n\n")[2].splitlines()[:64]
    assert [float(row.split()[3]) for row in rows] == pytest.approx(np.sqrt(ke) * simulation.system.charges)
    assert error_of_waves(simulation) == pytest.approx(1e-5 * np.sqrt((forces**2).sum(axis=1).mean()))
    simulation.positions[:] = 3.0 * np.array(list(np.ndindex(4, 4, 4))) @ SKEWED @ ROTATION
    assert error_of_waves(simulation) > 1e-7  # without forces


@pytest.mark.parametrize("name", ["argon", "turned"])
def test_positions_come_back_to_where_they_were(name):
    system = SCENES[name]().system
    system.positions[:] += 7.0 * system.cell.vectors[0] - 11.0 * system.cell.vectors[2]
    box = Box(system.cell, system.positions)
    assert np.abs(box.positions_back(box.positions, system.positions) - system.positions).max() < 1e-12
    assert box.edges == pytest.approx(system.cell.lattice @ box.turn, abs=1e-12)
