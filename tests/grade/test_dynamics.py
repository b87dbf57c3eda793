"""Dynamics are judged: exact samplers pass, samplers that are a little wrong are told how; classes of ASE; refusals."""

import json

import numpy as np
import pytest
from ase.md.bussi import Bussi
from ase.md.langevinbaoab import LangevinBAOAB
from ase.md.nose_hoover_chain import NoseHooverChainNVT
from ase.md.verlet import VelocityVerlet
from ase.units import fs, kB
from minimd.grade import laws_of
from wrong_calls import answered

import minimd as md
from minimd.commands.main import main
from minimd.core.integrators.substeps import Thermalize
from minimd.integrators import Splitting
from minimd.judge.telling import named

NVT, NPT = {"temperature_K": 300.0, "runs": 16, "steps": 200}, {"pressure": 0.002}
RIGID = {"constraints": True}


class Exact:
    """Draws a new sample in place of each step."""

    def __init__(self, atoms, timestep, rng, wrong=lambda own, new: None, **claims):
        self.atoms, self.rng, self.wrong, self.timestep = atoms, rng, wrong, timestep

    def run(self, steps):
        self.wrong(self, new := self.atoms.calc.draw(self.rng))
        self.atoms.set_cell(new.cell)
        self.atoms.positions[:] = new.positions
        self.atoms.set_momenta(new.get_momenta(), apply_constraint=False)


def hotter(factor):
    return lambda own, new: new.set_momenta(new.get_momenta() * np.sqrt(factor(own)), apply_constraint=False)


def pushed(own, new):
    new.set_momenta(new.get_momenta() + np.sqrt(300.0 * 8.617333e-5) * own.rng.standard_normal(3))


WRONG = {
    "half": (hotter(lambda _: 0.5), {}, "weak"),
    "with the step": (hotter(lambda own: own.timestep * 5.0), {}, "√Δt"),
    "by mass": (hotter(lambda own: own.atoms.get_masses()[:, None] / 40.0), {}, "m^1.0"),
    "3N": (hotter(lambda _: 24.0 / 21.0), {}, "24 degrees of freedom are counted where 21 move"),
    "z": (hotter(lambda _: np.array([1.0, 1.0, 0.1])), {}, "along x, y, z"),
    "same noise": (pushed, {}, "correlated"),
    "one number": (lambda own, new: new.set_momenta(new.get_momenta()[:, [0, 0, 2]]), {}, "x, y, z of a momentum"),
    "whole masses": (hotter(lambda own: np.round(own.atoms.get_masses())[:, None] / own.atoms.get_masses()[:, None]),
                     {"steps": 800}, "different masses"),
    "changes": (lambda own, new: new.set_cell(new.cell * own.rng.uniform(0.9, 1.0)), {}, "give pressure="),
    "positions": (
        lambda own, new: new.set_positions(0.5 * (new.positions + own.atoms.calc.draw(own.rng).positions)),
        {}, "positions"),
    "3N, rigid": (hotter(lambda own: 21.0 / 17.0 if own.atoms.constraints else 1.0), RIGID | {"steps": 800},
                  "21 degrees of freedom are counted where 17 move: bonds are rigid"),
    "soft": (lambda own, new: new.set_positions(1.001 * new.positions, apply_constraint=False), RIGID, "rigid bonds"),
    "volume": (lambda _, new: new.set_cell(new.cell * 0.9), NPT, "<V>"),
    "frozen": (lambda own, new: new.set_cell(own.atoms.cell), NPT, "volume never changes"),
    "collapse": (lambda own, new: new.set_cell(new.cell * 1e-3), NPT, "2K/3V"),
}  # fmt: skip


@pytest.mark.parametrize(("wrong", "options", "words"), WRONG.values(), ids=WRONG)
def test_a_wrong_sampler_is_told_its_fault(wrong, options, words):
    grade = md.grade(Exact, wrong=wrong, **NVT | options)
    assert not grade.passed
    assert any(words in fault for fault in grade.faults), str(grade)


@pytest.mark.parametrize("options", [{}, NPT, RIGID | {"steps": 800}])
def test_an_exact_sampler_passes(options):
    grade = md.grade(Exact, **NVT | options)
    assert grade.passed, str(grade)
    assert "3N − 3" in grade.remarks[0]


def test_a_bath_that_is_wrong_beyond_what_the_runs_see_does_not_pass():
    """A line whose statistical limit is above 20 % has no tick; without a temperature the grade has no verdict."""
    grade = md.grade(Exact, **NVT | {"runs": 6, "steps": 40}, wrong=hotter(lambda own: own.rng.choice([0.1, 2.7])))
    assert grade.passed is None, str(grade)
    assert "too short to judge: ring: temperature" in grade.verdict
    assert "?" in dict(grade.display_rows())["ring: temperature"]
    (law,) = (law for law in laws_of(Exact, **NVT | {"runs": 6, "steps": 40}) if repr(law) == "ring: temperature")
    with pytest.raises(AssertionError, match="too coarse to judge"):
        law()


class Redrawn(VelocityVerlet):
    """Hybrid Monte Carlo: all momenta are drawn anew every so many steps, or with a probability in each step."""

    def __init__(self, atoms, timestep, rng, every=0, probability=0.0, temperature_K=300.0):
        super().__init__(atoms, timestep)
        self.rng, self.every, self.probability, self.kt = rng, every, probability, kB * temperature_K

    def step(self):
        super().step()
        is_drawn = self.nsteps % self.every == self.every - 1 if self.every else self.rng.random() < self.probability
        if is_drawn:
            widths = np.sqrt(self.kt * self.atoms.get_masses())[:, None]
            self.atoms.set_momenta(self.rng.standard_normal((len(self.atoms), 3)) * widths)


@pytest.mark.parametrize("how", [{"every": 40}, {"every": 5}, {"probability": 0.05}])
def test_rare_redraws_of_all_momenta_pass(how):
    grade = md.grade(Redrawn, temperature_K=300.0, runs=8, steps=800, **how)
    assert grade.passed is not False, str(grade)
    assert "3N degrees" in grade.remarks[0]


def test_laws_are_tests_and_the_command_tells_them_as_json(capsys, tmp_path):
    laws = laws_of(Exact, **NVT, wrong=hotter(lambda _: 2.0))
    with pytest.raises(AssertionError, match="strong"):
        next(law for law in laws if repr(law) == "ring: temperature")()
    assert next(law for law in laws if repr(law) == "ring: constant volume")().passed
    options = ["steps=50", "temperature_K=300", "taut=5", "runs=8", "--json", f"--out={tmp_path / 'grade.png'}"]
    main(["grade", "ase.md.bussi:Bussi", *options])
    found = json.loads(capsys.readouterr().out)["passed"]
    assert found == md.grade(Bussi, temperature_K=300, taut=5, runs=8, steps=50).passed
    assert (tmp_path / "grade.png").stat().st_size > 10_000


def euler(atoms, timestep):
    class Euler(VelocityVerlet):
        def step(self):
            p, f = self.atoms.get_momenta(), self.atoms.get_forces()
            self.atoms.positions += self.dt * p / self.masses
            self.atoms.set_momenta(p + self.dt * f)

    return Euler(atoms, timestep)


class Unbound(VelocityVerlet):
    def __init__(self, atoms, *more):
        super().__init__(atoms, *more)
        atoms.set_constraint()


def test_steps_of_constant_energy_are_judged():
    for one in (VelocityVerlet, Unbound):
        assert md.grade(one, **RIGID, steps=40)["rigid bonds"].passed is (one is VelocityVerlet)
    right, wrong = md.grade(VelocityVerlet, steps=200), md.grade(euler, steps=200)
    twice = md.grade(lambda atoms, timestep: VelocityVerlet(atoms, 2.0 * timestep), steps=200)
    assert twice["center of mass"].value == pytest.approx(2.0)
    assert [one.name for one in twice if one.passed is False] == ["center of mass"]
    assert right.passed
    assert right["order of the energy's error"].value == pytest.approx(2.0, abs=0.1)
    assert {"energy is kept", "reversible"} <= {one.name for one in wrong if one.passed is False}


class Starred(VelocityVerlet):
    def __init__(self, *args):
        super().__init__(*args)


class Named(VelocityVerlet):
    def __init__(self, **kwargs):
        super().__init__(**kwargs)


def chosen(atoms, *args, **kwargs):
    return (LangevinBAOAB if "T_tau" in kwargs else VelocityVerlet)(atoms, *args, **kwargs)


class Default(VelocityVerlet):
    def __init__(self, system=None, dt=fs):
        super().__init__(system, dt)


class Friction(VelocityVerlet):
    def __init__(self, friction=1.0):
        self.friction = friction


class Runless:
    def __init__(self, *args):
        self.args = args


@pytest.mark.parametrize("dynamics", [Starred, Named, Default, chosen])
def test_a_class_is_judged_however_it_takes_atoms_and_time_step(dynamics):
    grade, known = md.grade(dynamics, steps=100), md.grade(VelocityVerlet, steps=100)
    assert grade.passed, str(grade)
    assert [law.value for law in grade] == [law.value for law in known]


def test_a_function_that_takes_any_name_gets_all_options():
    grade = md.grade(chosen, temperature_K=300.0, T_tau=50 * fs, runs=6, steps=40)
    assert grade.function.startswith("chosen(temperature_K, T_tau): NVT")


def test_a_conserved_energy_is_judged_where_one_is_offered():
    name = "order of the conserved energy's error"
    assert md.grade(NoseHooverChainNVT, **NVT, tdamp=50 * fs)[name].value == pytest.approx(2.0, abs=0.1)


@pytest.mark.slow
def test_a_liquid_has_the_energy_of_nist():
    grade = md.grade(LangevinBAOAB, temperature_K=300.0, T_tau=100 * fs, runs=8, liquids=True)
    names = [f"liquid {k}: energy of the liquid" for k in (1, 2)]
    assert [grade[name].value for name in names] == pytest.approx([1.0, 1.0], abs=0.02)
    assert [grade[name].passed for name in names] == [True, True]
    assert grade.passed is not False, str(grade)  # eight runs of the small scenes are too few to tell more


test_what_cannot_be_judged_is_refused = answered(
    (lambda: md.grade(Bussi, temperature_K=300.0), ValueError, "taut"),
    (lambda: md.grade(Bussi, temperature_K=-1.0, taut=5.0), ValueError, "temperature_K", "-1"),
    (lambda: md.grade(Bussi, "NPT", temperature_K=300.0), TypeError, "potential"),
    (lambda: md.grade(VelocityVerlet, ensemble="NPT"), ValueError, "pressure"),
    (lambda: md.grade(Exact, **NVT, **NPT, **RIGID), ValueError, "constraints"),
    (lambda: md.grade(VelocityVerlet, ensemble="NPH"), ValueError, "ensemble", "NPH"),
    (lambda: md.grade(VelocityVerlet, constraints="yes"), ValueError, "constraints", "'yes'"),
    (lambda: md.grade(VelocityVerlet, liquids=True), ValueError, "liquids", "NVE"),
    (lambda: md.grade(Bussi, temperature_K=0.0, taut=5.0, runs=6, steps=40), ValueError, "temperature_K", "0.0"),
    (lambda: md.grade(Bussi, pressure=[]), ValueError, "pressure", "[]"),
    (lambda: md.grade(Friction), TypeError, "Friction(atoms, timestep", "(friction)"),
    (lambda: md.grade(Runless), TypeError, "Runless", "run(steps)"),
    (lambda: md.grade(lambda x, v, dt: (x, v), temperature_K=300.0), TypeError, "temperature_K", "dynamics"),
    (lambda: named("ase.md.bussi:Busi"), ValueError, "Busi"),
)


class Andersen(Splitting):
    """Of each atom a new velocity, at a rate.  factor : of the temperature, 1 if it is right."""

    name, source = "andersen", "H. C. Andersen, J. Chem. Phys. 72, 2384 (1980)"
    substeps = (*md.VelocityVerlet.substeps, Thermalize(1.0))
    is_thermostat, is_symmetric, is_symplectic, conserves_momentum = True, False, False, False

    def __init__(self, timestep, temperature, rate, seed, factor=1.0):
        super().__init__(timestep)
        self.temperature, self.rate, self.seed, self.factor = temperature, rate, seed, factor

    def thermalize(self, state, duration, around):
        rng = np.random.default_rng([self.seed, around.bath.step])
        is_hit = rng.random(len(state.velocities)) < -np.expm1(-self.rate * duration)
        spread = np.sqrt(self.factor * around.bath.k_B * self.temperature * state.inverse_masses[is_hit])
        state.velocities[is_hit] = spread[:, None] * rng.standard_normal((is_hit.sum(), 3))


FEW = {"runs": 12, "steps": 200}


def test_a_splitting_with_a_bath_is_judged_as_a_class_and_as_an_instance():
    of_class = md.grade(Andersen, rate=0.1 / fs, **FEW)
    of_instance = md.grade(Andersen(fs, 300.0, 0.1 / fs, seed=3), **FEW)
    assert of_class.passed is not False, str(of_class)
    assert of_class["restart"].passed  # seed, step and memory go with the atoms
    assert [law.value for law in of_class] == [law.value for law in of_instance]
    hot = md.grade(Andersen, rate=0.1 / fs, factor=1.4, **FEW)
    assert hot["ring: temperature"].passed is False
    with pytest.raises(ValueError, match=r"Andersen.* takes atoms, .*, rate, factor; got rat"):
        md.grade(Andersen, rat=0.1)


def test_a_splitting_with_rigid_bonds_keeps_them():
    grade = md.grade(md.VelocityVerlet(fs), kind="dynamics", steps=40, **RIGID)
    assert grade.passed, str(grade)
    assert grade["rigid bonds"].value < 1e-9
