"""md.grade, the function that grades a step or a force function."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import suppress
from inspect import isclass, signature
from typing import Any

from numpy.typing import ArrayLike

from minimd.core.console.words import shown
from minimd.core.integrators.splitting import Splitting
from minimd.core.structure.checks import checked_choice, checked_count, checked_kind, checked_number
from minimd.judge.calling import KINDS, role_of
from minimd.judge.findings import Grade
from minimd.judge.forces import grade_forces
from minimd.judge.steps import grade_step


def names_of(function: Any) -> list[str]:
    """The names of the parameters of a function; none of what has no parameters."""
    with suppress(TypeError, ValueError):
        return [*signature(function).parameters]
    return []


def is_step(function: Any) -> bool:
    """Whether a function takes velocities and a time step, but no atoms."""
    names = names_of(function)
    is_of_atoms = isclass(function) or names[:1] == ["atoms"]
    return not is_of_atoms and {"v", "dt"} <= {role_of(name) for name in names}


def grade(
    function: Any,
    potential: Any = None,
    *,
    cell: float | Sequence[float] | None = None,
    cutoff: float | None = None,
    positions: ArrayLike | None = None,
    order: int | None = None,
    kind: str | None = None,
    **options: Any,
) -> Grade:
    """Test your own step, force function or dynamics: which laws it obeys, what is wrong with it, and by how much.

    A class of dynamics, as in ase.md, or a function make(atoms, timestep), is judged by the ensemble that it claims. A
    Splitting of minimd, an instance or a class, is judged by its kicks and drifts as a step, or, if it is in contact
    with a bath, as dynamics: temperature_K (300) and a random seed become its temperature and seed.
    A step is a function step(x, v, force, m, dt) -> x, v. Parameters are recognized by their names, in any order, and m
    may be left out. It may return x and v, or change them in place; force is a function of positions. Forces are a
    function forces(positions) -> F or (F, U), a law f(r) or law(r2) -> (u, f), or the force of a pair f(r_ij). What has
    a time step, or velocities and more than one other parameter, is graded as a step, any other function as forces.

    Dynamics get atoms, timestep and options, as in md.grade(Langevin, temperature_K=300.0, friction=0.02), and must
    have run(steps). With a temperature_K they claim NVT, with pressure_au, externalstress or pressure [eV/Å³] NPT,
    else NVE; ensemble= says so otherwise. Options of grade: timestep (1 fs) in ASE's unit, runs (24 or 40) of steps=
    each, seed; constraints=True judges rigid bonds, too, liquids=True two states of NIST (slow). Scenes with exact
    answers are run; a right dynamics fails once in a thousand times. kind="dynamics" if the name of the first parameter
    is not atoms.

    Parameters
    ----------
    function : the step, the force function, the class of dynamics or the splitting.
    potential : a potential of minimd with which forces are compared, such as LennardJones(1.0, 1.0, 2.5).
    cell : edge of the cubic cell, or three edges, if forces are periodic [length].
    cutoff : distance beyond which forces are zero [length].
    positions : (N, 3), for a force function that is written for these atoms only [length].
    order : expected order of a step; 2 if not given, or that of a Splitting.
    kind : "step", "forces", "law" or "pair", if the names of the parameters do not show it.

    Returns
    -------
    Grade : print it, or show it in a notebook; grade.faults are sentences, grade["order"].value is a number,
        grade.passed is True if all is right, None if runs were too short to tell.

    Raises
    ------
    TypeError : for anything that is not a function, or for parameters whose meaning is not known.
    ValueError : if the function raises an error, or returns None or another shape, with the call and the error;
        for options out of range.
    """
    if kind is not None:
        checked_choice("kind", kind, ("step", "dynamics", *KINDS))
    if isinstance(function, Splitting) or (isclass(function) and issubclass(function, Splitting)):
        from minimd.judge.splittings import as_function

        if order is None:
            order = function.order or None  # 0 if its coefficients are wrong
        function, kind = as_function(function, kind, options)
    hint = "a function, as step(x, v, force, m, dt) or forces(positions)"
    checked_kind("function", function, Callable, hint)
    names = names_of(function)
    runs = isclass(function) and hasattr(function, "run")
    if kind == "dynamics" or (kind is None and (runs or names[:1] == ["atoms"])):
        from minimd.judge.dynamics import grade_dynamics

        if any(value is not None for value in (potential, cell, cutoff, positions)):
            raise TypeError(
                "dynamics are judged in scenes of minimd: leave out potential, cell, cutoff and positions"
            )
        return grade_dynamics(function, options)
    if isclass(function) and kind is None:
        raise TypeError(
            f"a class of dynamics has run(steps), and {shown(function)} has not; of a step or a force function, pass "
            "the function, or the method of an object"
        )
    if options:
        raise TypeError(
            f"options such as {', '.join(options)} are for dynamics; {shown(function)} takes no atoms"
        )

    order = 2 if order is None else checked_count("order", order)
    if cutoff is not None:
        checked_number("cutoff", cutoff, "positive and finite")
    roles = {role_of(name) for name in names}
    moves = "dt" in roles or ("v" in roles and len(names) > 2)
    if kind == "step" or (kind is None and moves):
        return grade_step(function, order)
    return grade_forces(function, potential, cell, cutoff, positions, kind)
