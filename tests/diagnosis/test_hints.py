"""Hints before the first step: a skin that does not fit, units that do not match, a step that is too long, a drift."""

import warnings
from time import time_ns

import numpy as np
import pytest
from argon_atoms import argon, lennard_jones, with_calculator
from ase.md.velocitydistribution import Stationary, thermalize_momenta
from references import liquid
from scenes import BONDED, LJ

import minimd as md
import minimd.ase
from minimd.compiled.kernels import compile_clock
from minimd.diagnosis.first_hints import _long_timestep, too_long_a_step
from minimd.engine.engine import Engine
from minimd.potentials.term import Term
from minimd.structure.lattice import crystal

FS = md.units.fs


def hints_of(system, potentials, timestep=0.004, method=md.VelocityVerlet, **options):
    """The warnings of a run of one step."""
    with warnings.catch_warnings(record=True) as told:
        warnings.simplefilter("always")
        md.Simulation(system, potentials, method(timestep), **options).run(1)
    return [str(one.message) for one in told]


def like(system, **changes):
    """The same places in the same cell."""
    return md.System(system.positions, cell=system.cell, **changes)


def argon_crystal(constant=5.4):
    positions, edges = crystal("fcc", [4] * 3, constant)
    return md.System(positions, cell=edges, masses=39.95, units=md.units.ASE)


def test_a_skin_that_does_not_fit_is_clamped_and_said():
    system = like(liquid(3), bonds=np.arange(108).reshape(-1, 2))
    room = 0.5 * system.cell.heights.min() - 1.8
    (hint,) = hints_of(system, BONDED, skin=room + 0.5)
    assert hint.startswith(f"skin {room + 0.5:g} σ does not fit, {room:.3g} is used")
    with pytest.warns(UserWarning, match="does not fit"):
        sim = md.Simulation(system, BONDED, md.VelocityVerlet(0.004), skin=room + 0.5)
    assert sim.skins == pytest.approx([room])
    assert hints_of(system, BONDED, skin=0.9 * room) == []
    for skin, words in ((room - 1e-8, "no room for a wider skin"), (0.01, "a wider skin or a shorter")):
        sim = md.Simulation(system, BONDED, md.VelocityVerlet(0.004), skin=skin)
        sim.velocities[:, 0] = np.tile([40.0, -40.0], len(system) // 2)
        sim.run(0)
        assert words in str(sim.report())


def test_lengths_in_different_units_are_pointed_out():
    positions, edges = crystal("fcc", (3, 3, 3), 5.4)
    (hint,) = hints_of(md.System(positions, cell=edges), LJ)
    assert hint.startswith("no two atoms are within the cutoff, 1.8 σ: the closest,")
    assert "3.82 σ apart" in hint
    assert hints_of(md.System([[0.0, 0.0, 0.0]]), LJ) == []


@pytest.mark.parametrize(("timestep", "is_long"), [(0.004, False), (0.018, False), (0.022, True)])
def test_a_long_time_step_is_pointed_out(timestep, is_long):
    hot = liquid(3)
    advised = md.units.LJ.shown(md.advise_timestep(hot, LJ).collision)
    told = hints_of(hot, LJ, timestep)
    assert [f"conserves the energy well up to {advised}; see advise_timestep" in one for one in told] == [
        True
    ] * is_long
    assert md.advise_timestep(like(hot), LJ).collision == pytest.approx(0.005879, rel=1e-3)  # at rest
    assert hints_of(like(hot, masses=4.0), LJ, timestep) == []


@pytest.mark.parametrize(("masses", "is_long"), [((1.0, 4.0), True), ((4.0, 1.0), False), ((4.0, 4.0), False)])
def test_of_a_mixture_the_masses_of_those_count_that_push_each_other(masses, is_long):
    """Of two species, of which only the first has a law that is stiff."""
    system = like(liquid(3), species=["A", "B"] * 54, masses=np.tile(masses, 54))
    law = md.LennardJones({"A": (1.0, 1.0), "B": (0.0, 1.0)}, cutoff=1.8, truncation="switched")
    assert (_long_timestep(Engine(system, law, md.VelocityVerlet(0.022))) is not None) == is_long


class Weight(Term):
    """Gravity, on all atoms alike."""

    acts_from_outside = True

    def bind(self, _system):
        return self

    def add(self, system, detail, forces, energies, virials):
        forces[:, 2] -= system.masses
        if detail:
            energies += system.masses * system.positions[:, 2]


class Other:
    """The same, without the base class."""

    add, bind, acts_from_outside = Weight.add, Weight.bind, True


@pytest.mark.parametrize("weight", [Weight, Other])
def test_a_force_from_outside_that_is_declared_is_no_fault(weight):
    sim = md.Simulation(liquid(3), [LJ, weight()], md.VelocityVerlet(0.002))
    sim.set_temperature(0.5, seed=1)
    sim.run(20, every=2)
    assert sim.n_dof == 3 * len(sim.system)
    assert "momentum is not a constant here" in sim.report().verdict


def never_compiled(offset):
    """A law that no cache holds: the offset is a part of its code."""

    def spring(r2):
        return (3.24 - r2) ** 2 + offset, 4.0 * (3.24 - r2)

    return spring


def test_the_first_step_compiles_all_that_the_next_ones_need():
    start, law = compile_clock.seconds, md.PairPotential(never_compiled(1e-30 * time_ns()), (), 1.8)
    sim = md.Simulation(liquid(3), law, md.VelocityVerlet(0.004))
    sim.run(1)
    before = compile_clock.seconds
    sim.run(50, every=10)
    assert compile_clock.seconds == before > start


@pytest.mark.parametrize(
    ("epsilon", "sigma", "words"),
    [
        (120.0, 3.4, "in K it would be 0.0103 eV, epsilon=120 * md.units.ASE.k_B"),
        (0.997, 3.4, "in kJ/mol it would be 0.0103 eV, epsilon=0.997 / md.units.KJ_PER_MOL_PER_EV"),
        (0.0103, 3.4, None),
        (1.07, 2.56, None),  # tungsten
    ],
)
def test_an_epsilon_in_another_unit_is_named_before_the_time_step(epsilon, sigma, words):
    system = argon_crystal(constant=5.4 * sigma / 3.4)
    law = md.LennardJones(epsilon, sigma, 2.2 * sigma, "force-shifted")
    in_a_report = too_long_a_step(Engine(system, law, md.VelocityVerlet(5 * FS))) or ""
    assert in_a_report.startswith("epsilon" if words else "")
    told = hints_of(system, law, 0.5 * FS)
    assert len(told) == (words is not None)
    for hint in told:
        assert hint.startswith(f"epsilon = {epsilon:g} eV is far deeper")
        assert words in hint
        assert "timestep" not in hint


def test_a_failure_names_the_epsilon_first():
    law = md.LennardJones(120.0, 3.4, 8.5, "force-shifted")
    sim = md.Simulation(argon_crystal(), law, md.VelocityVerlet(5 * FS))
    sim.set_temperature(90.0, seed=1)
    with pytest.warns(UserWarning, match="^epsilon = 120 eV"), pytest.raises(md.NonFiniteError) as caught:
        sim.run(500, every=20)
    assert "ikely cause: epsilon = 120 eV is far deeper" in str(caught.value)
    assert "halve" not in str(caught.value)


@pytest.mark.parametrize(
    ("timestep", "pressure", "words"),
    [
        (5e-15, None, "check its unit, such as 5 * md.units.fs"),
        (0.4, 1.0, "1 eV/Å³ is 1.6e+06 bar; if 1 bar is meant, give 1 * md.units.BAR"),
        (1e-100, None, None),  # no slip of a unit: as in ASE's own tests, which ask for atoms that stand still
    ],
)
def test_a_time_step_in_seconds_and_a_pressure_in_bar_are_pointed_out(timestep, pressure, words):
    bath = pressure and md.StochasticCellRescaling(pressure, 1.0, 40.0, seed=1, temperature=80.0, every=5)
    law = md.LennardJones(0.0103, 3.4, 8.5, "force-shifted")
    told = hints_of(argon_crystal(), law, timestep, barostat=bath)
    assert [words in one for one in told] == [True] * (words is not None)


def test_a_center_that_moves_is_told_where_its_motion_is_no_degree_of_freedom():
    system = liquid(3)
    system.velocities += [0.3, 0.0, 0.4]
    (hint,) = hints_of(system, LJ)
    assert "center of mass" in hint
    assert "0.5 σ/τ" in hint
    assert hints_of(system, LJ, method=lambda dt: md.LangevinBAOAB(dt, 1.0, 1.0, seed=1)) == []
    sim = md.Simulation(system, LJ, md.VelocityVerlet(0.004))
    exec(hint.split("; ")[-1].removesuffix(" stops it"), {"sim": sim})
    assert hints_of(sim.system, LJ) == []
    system.velocities[:] = np.float32(sim.velocities)
    assert hints_of(system, LJ) == []


def test_a_thermal_center_of_ase_is_told_by_a_simulation_and_not_by_its_own_dynamics():
    atoms, law, step = argon(), lennard_jones("force-shifted"), 4.0 * FS
    thermalize_momenta(atoms, 94.4, rng=np.random.default_rng(1))
    speed = np.linalg.norm(atoms.get_momenta().sum(axis=0)) / atoms.get_masses().sum() * md.units.ps
    (hint,) = hints_of(atoms, law, step)
    assert f"{speed:.3g} Å/ps" in hint
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        minimd.ase.VelocityVerlet(with_calculator(atoms, minimd.ase.Calculator(law)), step).run(2)
    Stationary(atoms)
    assert hints_of(atoms, law, step) == []
