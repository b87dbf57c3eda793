"""Hints before the first step: a skin that does not fit, units that do not match, a step that is too long, a drift."""

import re
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

FS, ARGON = md.units.fs, md.LennardJones(0.0103, 3.4, 8.5, "force-shifted")
BAROSTAT = md.StochasticCellRescaling(1.0, 1.0, 40.0, seed=1, temperature=80.0, every=5)


def hints_of(system, potentials, method=0.004, barostat=None, **options):
    """The warnings of a run of one step, by velocity Verlet if a time step is given."""
    method = md.VelocityVerlet(method) if isinstance(method, float) else method
    with warnings.catch_warnings(record=True) as told:
        warnings.simplefilter("always")
        md.Simulation(system, potentials, method, barostat=barostat, **options).run(1)
    return [str(one.message) for one in told]


def like(system, **changes):
    """The same places in the same cell."""
    return md.System(system.positions, **{"velocities": system.velocities, "cell": system.cell} | changes)


def argon_crystal(constant=5.4):
    positions, edges = crystal("fcc", [4] * 3, constant)
    return md.System(positions, cell=edges, masses=39.95, units=md.units.ASE)


def sparse():
    positions, edges = crystal("fcc", (3, 3, 3), 5.4)
    return md.System(positions, cell=edges)


def with_depth(epsilon, sigma=3.4):
    law = md.LennardJones(epsilon, sigma, 2.2 * sigma, "force-shifted")
    return argon_crystal(5.4 * sigma / 3.4), law, 0.5 * FS


def flowing():
    system = liquid(3)
    return like(system, velocities=system.velocities + np.array([0.3, 0.0, 0.4]))


def long_step():
    return f"well up to {md.units.LJ.shown(md.advise_timestep(liquid(3), LJ).collision)}; see advise_timestep"


HINTS = {  # scene, and what is said
    "a sound scene": (lambda: (liquid(3), LJ), None),
    "lengths in another unit": (lambda: (sparse(), LJ), "no two atoms are within the cutoff, 1.8 σ: .*3.82 σ apart"),
    "a single atom": (lambda: (md.System([[0.0, 0.0, 0.0]]), LJ), None),
    "a step that is short enough": (lambda: (liquid(3), LJ, 0.018), None),
    "a long step": (lambda: (liquid(3), LJ, 0.022), long_step),
    "a step long for lighter atoms": (lambda: (like(liquid(3), masses=4.0), LJ, 0.022), None),
    "a step in seconds": (lambda: (argon_crystal(), ARGON, 5e-15), r"check its unit, such as 5 \* md.units.fs"),
    "a step no slip makes": (lambda: (argon_crystal(), ARGON, 1e-100), None),  # as in ASE's own tests
    "a center that moves": (lambda: (flowing(), LJ), "center of mass.*0.5 σ/τ"),
    "a pressure in bar": (lambda: (argon_crystal(), ARGON, 0.4, BAROSTAT), r"is 1.6e\+06 bar; .* 1 \* md.units.BAR"),
    "a depth in K": (lambda: with_depth(120.0), r"^epsilon = 120 eV .* 0.0103 eV, epsilon=120 \* md.units.ASE.k_B"),
    "a depth in kJ/mol": (lambda: with_depth(0.997), "^epsilon = 0.997 eV .* 0.0103 eV, epsilon=0.997 / md.units.KJ_"),
    "the right depth": (lambda: with_depth(0.0103), None),
    "the depth of tungsten": (lambda: with_depth(1.07, 2.56), None),
    "one that is thermal": (lambda: (flowing(), LJ, md.LangevinBAOAB(0.004, 1.0, 1.0, seed=1)), None),
}


@pytest.mark.parametrize("name", HINTS)
def test_what_is_odd_is_told_before_the_first_step(name):
    make, words = HINTS[name]
    told = hints_of(*make())
    assert [bool(re.search(words() if callable(words) else words, one)) for one in told] == [True] * (words is not None)


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


@pytest.mark.slow
def test_the_first_step_compiles_all_that_the_next_ones_need():
    start, law = compile_clock.seconds, md.PairPotential(never_compiled(1e-30 * time_ns()), (), 1.8)
    sim = md.Simulation(liquid(3), law, md.VelocityVerlet(0.004))
    sim.run(1)
    before = compile_clock.seconds
    sim.run(50, every=10)
    assert compile_clock.seconds == before > start


def test_a_failure_names_the_epsilon_first():
    law = md.LennardJones(120.0, 3.4, 8.5, "force-shifted")
    sim = md.Simulation(argon_crystal(), law, md.VelocityVerlet(5 * FS))
    sim.set_temperature(90.0, seed=1)
    with pytest.warns(UserWarning, match="^epsilon = 120 eV"), pytest.raises(md.NonFiniteError) as caught:
        sim.run(500, every=20)
    assert "ikely cause: epsilon = 120 eV is far deeper" in str(caught.value)
    assert "halve" not in str(caught.value)
    for depth, is_named in ((120.0, True), (0.0103, False)):  # in a report, too
        system, law, _ = with_depth(depth)
        found = too_long_a_step(Engine(system, law, md.VelocityVerlet(5 * FS))) or ""
        assert found.startswith("epsilon") is is_named


def test_the_call_that_is_told_stops_a_center_that_moves():
    (hint,) = hints_of(flowing(), LJ)
    sim = md.Simulation(flowing(), LJ, md.VelocityVerlet(0.004))
    exec(hint.split("; ")[-1].removesuffix(" stops it"), {"sim": sim})
    for velocities in (sim.velocities, np.float32(sim.velocities)):
        assert hints_of(like(sim.system, velocities=velocities), LJ) == []


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
