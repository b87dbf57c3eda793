"""md.grade: right steps and forces pass, wrong ones are told what is wrong with them, what does not fit is refused."""

import re

import numpy as np
import pytest
import wrong_functions as written
from wrong_calls import assert_answered
from wrong_functions import W, composed, explicit_euler, pairs, runge_kutta, velocity_verlet

import minimd as md
from minimd.commands.main import main

TWO = np.array([[0.0, 0.0, 0.0], [0.9, 0.5, 0.2]])
SLOWEST = "no minimum image", "one direction", "du/dr times the vector", "cutoff of components", "wrapped positions"


def slow_unless(is_quick, value, name):
    return pytest.param(value, id=name, marks=() if is_quick else pytest.mark.slow)


@pytest.mark.parametrize("name", [slow_unless(k < written.N_QUICK, n, n) for k, n in enumerate(written.WRONG_STEPS)])
def test_a_wrong_step_is_told_its_fault(name):
    step, words = written.WRONG_STEPS[name]
    grade = md.grade(step)
    assert not grade.passed
    assert any(words in fault for fault in grade.faults), str(grade)


def test_figures_of_a_grade_are_those_of_theory():
    euler = md.grade(explicit_euler)
    assert euler["oscillator"].value == pytest.approx(0.25)  # the energy grows by 1 + (ωΔt)²
    assert euler["order"].value == pytest.approx(1.0, abs=0.1)
    symplectic = md.grade(composed(1.0, 1.0), order=1)
    found = euler["volume"].passed, symplectic["symplectic"].passed, symplectic["reversible"].passed
    assert found == (False, True, None)


RIGHT = {step.__name__: (step, 2, 2) for step in written.RIGHT_STEPS}  # step, order asked for, order that is reached
RIGHT |= {"yoshida": (written.yoshida, 2, 4), "yoshida, 4": (written.yoshida, 4, 4), "nystrom": (written.nystrom, 4, 4)}
RIGHT |= {"beeman": (written.beeman, 2, None), "Euler": (composed(1.0, 1.0), 1, 1)}
COMPOSITIONS = {
    "forest, ruth": ((W / 2, W, (1 - W) / 2, 1 - 2 * W, (1 - W) / 2, W, W / 2), 4),
    "forest, ruth, drifts first": ((0, W / 2, W, (1 - W) / 2, 1 - 2 * W, (1 - W) / 2, W, W / 2), 4),
    "ruth": ((7 / 24, 2 / 3, 3 / 4, -2 / 3, -1 / 24, 1.0), 3),
    "halves": ((1 / 4, 1 / 2, 1 / 2, 1 / 2, 1 / 4), 2),
    "drifts first": ((0, 1 / 2, 1, 1 / 2), 2),
}
for name, (weights, order) in COMPOSITIONS.items():
    for manner in range(4):
        RIGHT[f"{name}, {manner}"] = composed(*weights, manner=manner), order, order if order != 2 else None
FAST = (velocity_verlet.__name__, "ruth, 0", "forest, ruth, 1")


@pytest.mark.parametrize("row", [slow_unless(name in FAST, row, name) for name, row in RIGHT.items()])
def test_a_right_step_passes_in_every_shape(row):
    step, order, reached = row
    grade = md.grade(step, order=order)
    assert grade.passed, str(grade)
    assert grade["order"].value == pytest.approx(reached or 2, abs=0.1)  # truncation
    assert reached != 2 or grade["oscillator"].value == pytest.approx(2.0, abs=0.01)  # the limit ωΔt = 2


@pytest.mark.slow
def test_a_runge_kutta_method_passes_if_its_order_is_asked_for():
    right = md.grade(lambda x, v, force, m, dt: runge_kutta(x, v, force, m, dt), order=4)
    assert (right.passed, right["energy"].passed, right["cost"].value) == (True, None, 4), str(right)
    assert right["order"].value == pytest.approx(4.0, abs=0.1)
    assert any("not symplectic" in remark for remark in right.remarks)
    wrong = md.grade(lambda x, v, force, m, dt: runge_kutta(x, v, force, m, dt, third=1), order=4)
    assert any("stage 3 has the weights" in fault for fault in wrong.faults), str(wrong)


def verlet_of(move=lambda x: x):
    """A step without masses, whose positions are moved at its end."""

    def step(x, v, force, dt):
        v = v + 0.5 * dt * force(x)
        x = move(x + dt * v)
        return x, v + 0.5 * dt * force(x)

    return step


def test_what_is_right_for_one_mass_only_is_told():
    grade = md.grade(verlet_of())
    assert grade.passed
    assert "m = 1" in grade.remarks[0]
    assert not any("m = 1" in remark for remark in md.grade(velocity_verlet).remarks)


def test_atoms_are_told_on_which_side_they_start():
    (fault,) = md.grade(verlet_of(lambda x: x % 10.0)).faults
    assert re.search(r"coordinates are (larger|smaller) by \d", fault), fault


def test_the_command_grades_a_step(tmp_path, capsys):
    file = tmp_path / "mine.py"
    file.write_text("def step(x, v, force, m, dt):\n    v = v + dt * force(x) / m\n    return x + dt * v, v\n")
    assert main(["grade", f"{file}:step"]) == 1
    assert "symplectic Euler" in capsys.readouterr().out


# fmt: off
def dt_twice(x, v, dt, force):
    v = v + 0.5 * dt * force(x) * dt
    x = x + dt * v
    return x, v + 0.5 * dt * force(x)

def without_copies(x, v, force, dt, n_steps):
    xs, vs = [x], [v]
    for _ in range(n_steps):
        v += 0.5 * dt * force(x)
        x += dt * v
        v += 0.5 * dt * force(x)
        xs.append(x)
        vs.append(v)
    return np.array(xs), np.array(vs)

def with_frc(pos, vel, frc, dt, compute_forces):
    pos += vel * dt + frc * dt**2
    new = compute_forces(pos)
    vel += 0.5 * (frc + new) * dt
    frc[:] = new

FAULTS = [(dt_twice, "multiplied by dt twice"), (without_copies, "x.copy()"), (with_frc, "dt² F/m in place of ½")]
# fmt: on


@pytest.mark.parametrize(("step", "words"), FAULTS)
def test_one_fault_is_named_and_no_other(step, words):
    grade = md.grade(step)
    assert len(grade.faults) == 1, str(grade)
    assert words in grade.faults[0]


def test_a_bond_of_minimd_is_between_the_two_atoms():
    def bond(pos, k=2.0, length=1.1):
        d = pos[1] - pos[0]
        r = np.linalg.norm(d)
        return np.array([k * (r - length) * d / r, -k * (r - length) * d / r])

    law = md.HarmonicBond(2.0, 1.1)
    grade = md.grade(bond, law, positions=TWO)
    assert grade.passed, str(grade)
    assert_answered(lambda: md.grade(bond), ValueError, "positions=")
    assert_answered(lambda: md.grade(lambda x: -x, law), ValueError, "pairs=[[0, 1]]")


def test_right_forces_pass():
    for force, options in written.RIGHT_FORCES:
        grade = md.grade(force, **options)
        assert grade.passed, str(grade)


@pytest.mark.parametrize("name", [slow_unless(name not in SLOWEST, name, name) for name in written.WRONG_FORCES])
def test_wrong_forces_are_told_their_fault(name):
    force, options, words = written.WRONG_FORCES[name]
    grade = md.grade(force, **options)
    assert not grade.passed
    assert any(words in fault for fault in grade.faults), str(grade)


@pytest.mark.parametrize(
    "force", [lambda *args: pairs(*args, lambda r: 1 / r**3), lambda x=TWO: pairs(x, lambda r: 1 / r**3)]
)
def test_forces_are_judged_if_their_only_parameter_is_starred_or_has_a_default(force):
    grade = md.grade(force)
    assert grade.passed, str(grade)
    with pytest.raises(TypeError, match=r"forces\(positions\)"):
        md.grade(lambda **kwargs: 0.0)


def test_atoms_beyond_the_cutoff_have_neither_forces_nor_energy():
    far, law = np.array([[0.0, 0.0, 0.0], [5.0, 0.0, 0.0]]), md.LennardJones(1.0, 1.0, 2.5)
    grade = md.grade(lambda x: (0.0 * x, 0.0), law, positions=far)
    found = [grade[one].passed for one in ("all atoms as minimd's", "all forces = −∇U", "as minimd's")]
    assert found == [True, True, False]


def test_parameters_of_a_force_are_what_they_say():
    def right(x, eps=0.5, sigma=1.1):
        return pairs(x, lambda r: 24 * eps * (2 * sigma**12 / r**13 - sigma**6 / r**7))

    def no_sigma(x, eps=0.7, sigma=1.2):
        return pairs(x, lambda r: 24 * eps * (2 * sigma**12 / r**13 - 1 / r**7))

    no_length = lambda x, k=2.0, r0=1.1: np.array([k * (x[1] - x[0]), k * (x[0] - x[1])])  # noqa: E731
    assert md.grade(right).passed is md.grade(lambda x, eps=0.5, sigma=1.0: right(x, eps, sigma)).passed is True
    assert "16.8 r^−7 where" in md.grade(no_sigma).faults[0]  # 24 ε, without σ⁶
    assert "eps" in md.grade(lambda r, eps=2.0: 48 / r**13 - 24 / r**7).faults[0]
    assert "r0" in md.grade(no_length, positions=TWO).faults[0]
    grade = md.grade(lambda x: pairs(x, lambda r: 1 / r))  # the field of a line of charges, or 1/r is forgotten
    assert grade["powers of r"].passed is None
    assert "a factor 1/r is missing" in grade.remarks[0]
    assert not md.grade(lambda x: pairs(x, lambda r: 1 / r**2)).remarks


class UnevenVerlet(md.integrators.Splitting):
    name, source = "uneven", "a wrong coefficient"
    substeps = (md.integrators.Kick(0.5), md.integrators.Drift(1.0), md.integrators.Kick(0.4))


@pytest.mark.parametrize("name", [name for name in md.integrators.SPLITTINGS if name != "respa"])
def test_each_splitting_is_judged_by_its_kicks_and_drifts(name):
    method = md.integrators.SPLITTINGS[name]
    grade = md.grade(method)
    assert grade.passed, str(grade)
    assert f"{method.order} expected" in str(grade)
    assert grade["order"].value == pytest.approx(method.order, abs=0.3)
    assert grade["cost"].value == method.stages


def test_a_wrong_coefficient_of_a_splitting_is_named_of_an_instance_too():
    for method in (UnevenVerlet, UnevenVerlet(0.01)):
        assert "velocities change by 0.9 dt F/m" in md.grade(method).faults[0]


REFUSED = [  # what is given, options, and what the sentence must contain
    (7, {}, TypeError, "must be a function"),
    (lambda x, v, force, m, dt: None, {}, ValueError, "returns None and does not change x and v"),
    (lambda x, v, force, m, dt: (x / 0.0, v), {}, ValueError, "not finite"),
    (lambda state, dt: state, {}, TypeError, "step(x, v, force, m, dt)"),
    (velocity_verlet, {"kind": "Verlet"}, ValueError, "kind must be one of", "'Verlet'"),
    (lambda x: None, {}, ValueError, "returned None"), (lambda x: x[0], {}, ValueError, "shape of the positions"),
    (lambda x, charges: x, {}, TypeError, "charges"),
    (lambda x: -x, {"cell": -1.0}, ValueError, "cell must be", "-1.0"),
    (lambda x, v, thing, m, dt, force: x, {}, TypeError, "the meaning of thing"),
    (lambda self, x, v, force, dt: (x, v), {}, TypeError, "method without its object"),
    (lambda y, t, dt, f: y + dt * f(y, t), {}, ValueError, "as for SciPy"),
]  # fmt: skip


@pytest.mark.filterwarnings("ignore:divide by zero", "ignore:invalid value")
@pytest.mark.parametrize("row", REFUSED, ids=lambda row: row[3])
def test_what_cannot_be_graded_is_refused_in_a_sentence(row):
    function, options, error, *shown = row
    assert_answered(lambda: md.grade(function, **options), error, *shown)


def test_a_grade_shows_itself_and_leaves_random_numbers_alone():
    np.random.seed(5)
    grade = md.grade(lambda r: 48 / r**13 - 24 / r**6)
    md.grade(lambda x, v, force, dt: (x + dt * v, v + 0.0 * dt))
    assert np.random.random() == np.random.RandomState(5).random()
    with pytest.raises(KeyError, match="order"):
        grade["order"]
