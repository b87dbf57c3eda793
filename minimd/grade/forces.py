"""The grade of a force function: whether forces are a gradient, pairwise, symmetric, periodic, cut off correctly,
and equal to minimd's."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from minimd.forces.evaluation import evaluate
from minimd.grade.bodies import Bodies
from minimd.grade.calling import KINDS, SEPARATE, START, StudentForce
from minimd.grade.findings import Fault, Finding, Grade, Kind, all_of, coefficient, first_of_each, without
from minimd.grade.problems import Array, difference, multiple_of
from minimd.grade.profile import (
    DELTA,
    FARTHEST,
    NEAREST,
    Law,
    cutoff_findings,
    lennard_jones_fault,
    places_of_epsilon_and_sigma,
    powers_of,
    ratio_of,
    related,
    without_effect,
)
from minimd.potentials.bonded import Bond
from minimd.structure.system import System

BOX, CUTOFF = 12.0, 2.5  # σ: cell and cutoff for a function that takes them, if the user gives none
POINTS = 40  # number of distances at which laws are compared
SAME_FORCE = 1e-9
SKEW = np.array([0.9, 0.5, -0.4])  # a vector of a pair that is parallel to no plane of the axes


@dataclass
class Draft:
    """What is collected while a force is graded."""

    potential: Any
    cutoff: float | None
    findings: list[Finding] = field(default_factory=list)
    faults: list[str] = field(default_factory=list)
    remarks: list[str] = field(default_factory=list)
    law: str = ""


def grade_forces(
    function: Callable[..., Any],
    potential: Any = None,
    cell: float | Sequence[float] | None = None,
    cutoff: float | None = None,
    positions: Any = None,
    kind: str | None = None,
) -> Grade:
    """See grade."""
    lengths, given = edges(cell), checked_positions(positions)
    if cutoff is None and potential is not None and np.isfinite(getattr(potential, "cutoff", np.inf) or np.inf):
        cutoff = float(potential.cutoff)
    edge = BOX if lengths is None else float(lengths[0])
    box = edge if lengths is None or np.ptp(lengths) == 0.0 else lengths
    parameters = getattr(potential, "parameters", None)
    epsilon, sigma = parameters if isinstance(parameters, tuple) and len(parameters) == 2 else (1.0, 1.0)
    options = {"box": box, "cutoff": cutoff or CUTOFF, "epsilon": epsilon, "sigma": sigma, "n": 0}
    options |= {"box given": lengths is not None, "cutoff given": cutoff is not None}
    force = StudentForce(function, options, kind, given)
    if "box" in force.takes and lengths is None:
        lengths = np.full(3, BOX)
    draft = Draft(potential, cutoff or CUTOFF if "cutoff" in force.takes else cutoff)
    with np.errstate(all="ignore"):
        if force.kind == "forces":
            of_bodies(draft, force, lengths, given)
        else:
            of_a_law(draft, force)
    draft.faults += all_of((force.changes_input, "the function changes the positions that it is given: work on a copy"))
    energy = " and the energy" if force.has_energy else ""
    told = f"{force.name}({', '.join(force.names)}): {KINDS[force.kind]}{energy}"
    faults = tuple(dict.fromkeys(draft.faults))
    return Grade(told, tuple(draft.findings), faults, draft.law, tuple(draft.remarks))


def of_a_law(draft: Draft, force: StudentForce) -> None:
    """Grade a law f(r) or the force F(r_ij) of a pair."""
    is_law, along = force.kind == "law", np.array([0.6, 0.0, 0.8])

    def at(r: float) -> tuple[float, float]:
        f, u = force((r * r if force.is_squared else r) if is_law else r * along)
        return float(f if is_law else f @ along), float(u)

    if not is_law:
        vector, _ = force(SKEW)
        off = float(np.linalg.norm(np.cross(vector, SKEW)) / np.linalg.norm(vector))
        draft.findings.append(Finding("central", off < 1e-9, f"F × r_ij is {off:.1e} of F r", off))
        draft.faults += all_of((off >= 1e-9, "the force of the pair does not point along r_ij: the direction must be "
                                "r_ij/r in all three components"))  # fmt: skip
    of_a_profile(draft, lambda r: at(r)[0], (lambda r: at(r)[1]) if force.has_energy else None, FARTHEST, is_law)
    of_parameters(draft, force, np.array(1.2 * START) if is_law else SEPARATE, lambda r: at(r)[0])


def of_parameters(draft: Draft, force: StudentForce, x: Array, pair: Law | None) -> None:
    """Put the faults of the function's parameters first, in place of less exact ones; its own ε and σ are not judged as
    ε = σ = 1."""
    wrong = without_effect(force, x)
    end = min(0.9 * (draft.cutoff or CUTOFF), 2.2)
    places = pair and places_of_epsilon_and_sigma(force, pair, np.linspace(NEAREST + 0.05, end, POINTS))
    if places is not None:
        draft.faults = without(draft.faults, Kind.OF_UNITS)
        wrong += places
    if places == []:
        draft.findings = with_passed(draft.findings, "powers of r", True)
    draft.faults = wrong + (without(draft.faults, Kind.BESIDE_MINIMD) if wrong else draft.faults)


def of_a_profile(draft: Draft, f: Law, u: Law | None, farthest: float, is_law: bool = False) -> None:
    """Grade the force of a pair as a function of the distance.  f : > 0 for repulsion."""
    potential, findings, faults = draft.potential, draft.findings, list[str]()
    alone = potential is None and u is None
    end = min(farthest, 0.9 * (draft.cutoff or CUTOFF), 2.2)
    ended = [x for x in np.linspace(1.15, end, 60) if f(float(x)) == 0.0]
    r = np.linspace(NEAREST + 0.05, 0.99 * ended[0] if ended else end, POINTS)
    values = np.array([f(float(x)) for x in r])
    if not np.isfinite(values).all():
        where = r[np.argmin(np.isfinite(values))]
        findings.append(Finding("finite", False, f"the force of a pair is not finite at r = {where:.3g}"))
        draft.faults.append("the force of a pair is not finite at an ordinary distance")
        return
    if u is not None:
        c, k = ratio_of(values, -np.array([difference(u, float(x), DELTA) / DELTA for x in r]), r)
        words, wrong = related(c, k, "−du/dr", is_law)
        wrong = [apart(values, r, u)] if np.isnan(c) else wrong
        findings.append(Finding("force = −∇U", not wrong, words, c))
        faults += wrong
        if is_law and k == -1.0:
            draft.remarks.append("the law returns f = −u′(r)/r, as minimd's laws do: multiply it by the vector r_ij")
            values, f = values * r, (lambda f: lambda x: f(x) * x)(f)
    name, suspected = "", list[str]()
    if (own := powers_of(values, r)) is not None:
        name, suspected = lennard_jones_fault(own)
        is_inverse = alone and own.exponents == (1,) and not is_law
        draft.remarks += all_of((is_inverse, "the force of a pair decreases as r^−1. If q²/r² is meant, a factor 1/r "
                                 "is missing: q² r_ij/r³, not q² r_ij/r²"))  # fmt: skip
        draft.law = name
        findings.append(Finding("powers of r", not suspected if alone and not is_inverse else None, f"F = {own}"))
        faults += suspected if alone else []
    if potential is not None:
        pairs = [np.array([[0.0, 0.0, 0.0], [x, 0.0, 0.0]]) for x in r]
        known = np.array([float(evaluated(pair, potential, None).forces[1, 0]) for pair in pairs])
        c, k = ratio_of(values, known, r)
        if is_law and k == -1.0:
            draft.remarks.append("the law returns f/r: multiply it by the vector r_ij")
            k = 0.0
        words, wrong = related(c, k, "minimd's force")
        off = float(np.abs(values - known).max() / np.abs(known).max())
        ok = off < SAME_FORCE
        said = f"largest difference {off:.1e} of the largest force" if np.isnan(c) or ok else words
        findings.append(Finding("as minimd's", ok, said, off))
        if not ok:
            beside = Fault(Kind.BESIDE_MINIMD, f"the force differs from minimd's by {off:.1%} of the largest")
            faults = faults + (wrong or suspected) or [beside]
    elif len(values) and values[0] < 0.0 and not faults:
        findings.append(Finding("sign", None, f"attractive at r = {r[0]:.2f}: {values[0]:.3g}", float(values[0])))
    more, wrong = cutoff_findings(f, u, draft.cutoff, farthest)
    if getattr(potential, "truncation", "") == "truncated":  # minimd's energy jumps, too, as the user has chosen
        more, wrong = with_passed(more, "energy continuous", None), without(wrong, Kind.JUMP)
    findings += more
    draft.faults += faults + wrong


def with_passed(findings: list[Finding], name: str, passed: bool | None) -> list[Finding]:
    """The findings, that of one law passed, or open, if it had failed."""
    return [replace(one, passed=passed) if (one.name, one.passed) == (name, False) else one for one in findings]


def apart(values: Array, r: Array, u: Law) -> str:
    """The wrong powers of r in the force, if energy and force are sums of powers."""
    energy, force = powers_of(np.array([u(float(x)) for x in r]), r), powers_of(values, r)
    if energy is None or force is None:
        return "the force is not minus the slope of the energy, nor a multiple of it"
    right, have = {n + 1: n * c for n, c in zip(*energy, strict=True)}, dict(zip(*force, strict=True))
    both = [n for n in have if n in right and not np.isclose(have[n], right[n], rtol=1e-5)]
    parts = [f"{have[n]:.6g} r^−{n} where {right[n]:.6g} r^−{n} is needed" for n in both]
    parts += [f"r^−{n} does not belong in it" for n in have if n not in right]
    parts += [f"{c:.6g} r^−{n} is missing" for n, c in right.items() if n not in have]
    return (f"the force is not minus the slope of the energy, u = {energy}: wrong exponent or coefficient: "
            f"{', '.join(parts)}")  # fmt: skip


def evaluated(x: Array, potential: Any, lengths: Array | None) -> Any:
    """minimd's forces and energy.

    Bonds without pairs join the two atoms if there are two.  Raises ValueError if there are more.
    """
    bonds = None
    if isinstance(potential, Bond) and potential.arguments()["pairs"] is None:
        if len(x) != 2:
            raise ValueError(f"{potential!r} does not say which of the {len(x)} atoms are bonded: give it pairs, such "
                             "as pairs=[[0, 1]], or positions= of two atoms")  # fmt: skip
        bonds = [[0, 1]]
    return evaluate(System(x, cell=lengths, bonds=bonds), potential)


def of_bodies(draft: Draft, force: StudentForce, lengths: Array | None, given: Array | None) -> None:
    """Grade forces on all atoms."""
    cutoff = draft.cutoff
    bodies = Bodies(force, lengths, cutoff, given)
    if lengths is None and not bodies.is_field and (edge := bodies.period()) is not None:
        draft.remarks.append(f"the forces are periodic along x with the period {edge:.6g}, which is taken as the edge "
                             "of a cubic cell")  # fmt: skip
        bodies = Bodies(force, lengths := np.full(3, edge), cutoff, given)
    draft.findings = bodies.findings()
    pair = bodies.of_a_pair if bodies.takes_pairs and not (bodies.is_broken or bodies.is_field) else None
    if pair is not None:
        farthest = FARTHEST if lengths is None else min(FARTHEST, 0.5 * float(lengths.min()) * 0.999)
        remarks = list(draft.remarks)
        energy = (lambda r: bodies.u(bodies.pair(r))) if force.has_energy else None
        of_a_profile(draft, pair, energy, farthest)
        if bodies.d != 3:
            draft.remarks = remarks
        if (cube := bodies.cube(farthest)) is not None:
            draft.faults = [
                "the cutoff acts on the components, not on the distance: pairs in a cube with half the edge "
                f"{cube:.4g} interact. Compare dx² + dy² + dz² with the square of the cutoff",
                *without(draft.faults, Kind.CUTOFF),
            ]
    draft.faults += bodies.faults
    if not bodies.is_broken:
        of_parameters(draft, force, bodies.x, pair)
    if not draft.faults:
        draft.faults += related(bodies.multiple, 0.0, "−∇U")[1]
    if lengths is not None and cutoff is None and pair is not None:
        rest = abs(pair(0.4999 * float(lengths.min())))  # where the nearest image changes
        words = f"the force is still {rest:.2g}, and jumps where the nearest image changes: use a cutoff"
        words = words if rest else "the force is zero there"
        draft.findings.append(Finding("at half the cell", None if rest else True, words, rest))
    if draft.potential is not None:
        beside(draft, bodies, lengths)


def beside(draft: Draft, bodies: Bodies, lengths: Array | None) -> None:
    """Compare all forces of a configuration with minimd's."""
    own, x = bodies.f(bodies.x), np.pad(bodies.x, ((0, 0), (0, 3 - bodies.d)))
    answer = evaluated(x, draft.potential, lengths)
    known = answer.forces[:, : bodies.d]
    off = float(np.abs(own - known).max()) / (float(np.abs(known).max()) or 1.0)
    c = multiple_of(own, known, 1e-6)
    energy, right = bodies.u(bodies.x), np.float64(answer.potential_energy)
    words = f"largest difference of {len(own)} atoms {off:.1e} of the largest force"
    differ = f"the forces of {len(own)} atoms differ from minimd's by {off:.1%} of the largest"
    is_wrong = bodies.force.has_energy and not np.isclose(energy, right, rtol=1e-9)
    faults = first_of_each(
        ((off > SAME_FORCE and np.isfinite(c), f"the forces of {len(own)} atoms are {coefficient(c)} times minimd's"),
         (off > SAME_FORCE, Fault(Kind.BESIDE_MINIMD, differ))),
        ((is_wrong, f"the energy of {len(own)} atoms is {energy:.8g}, {energy / right:.4g} times minimd's, "
                    f"{right:.8g}"),),
    )  # fmt: skip
    words = words if off <= SAME_FORCE or np.isfinite(c) else differ
    draft.findings.append(Finding("all atoms as minimd's", off < SAME_FORCE, words, off))
    draft.faults = draft.faults or faults


def checked_positions(positions: Any) -> Array | None:
    """The user's positions as an (N, 3) array.  Raises ValueError for another shape or numbers that are not finite."""
    if positions is None:
        return None
    array = np.array(positions, dtype=float)
    if array.ndim != 2 or array.shape[1] != 3 or not np.isfinite(array).all():
        raise ValueError(f"positions must be (N, 3) finite numbers; got shape {array.shape}")
    return array


def edges(cell: float | Sequence[float] | None) -> Array | None:
    """The edges (3,) of a rectangular cell.  Raises ValueError for any other cell."""
    if cell is None:
        return None
    array = np.array(cell, dtype=float)
    if array.shape == (3, 3) and not np.any(array - np.diag(np.diagonal(array))):
        array = np.diagonal(array).copy()
    if array.shape not in ((), (3,)) or not (np.isfinite(array).all() and (array > 0.0).all()):
        raise ValueError(f"cell must be the edge of a cube, or three edges, positive and finite; got {cell!r}")
    return np.broadcast_to(array, (3,)).copy()
