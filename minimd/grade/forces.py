"""The grade of a force function: whether forces are a gradient, pairwise, symmetric, periodic, cut off correctly,
and equal to minimd's."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from minimd.grade.bodies import Bodies
from minimd.grade.findings import Fault, Finding, Grade, Kind, coefficient, without
from minimd.grade.force_calling import START, Array, StudentForce, checked_positions, edges
from minimd.grade.parameters import places_of_epsilon_and_sigma, without_effect
from minimd.grade.profile import (
    FARTHEST,
    NEAREST,
    Law,
    cutoff_findings,
    lennard_jones_fault,
    powers_of,
    ratio_of,
    related,
    slope_of,
)

BOX, CUTOFF = 12.0, 2.5  # σ: cell and cutoff for a function that takes them, if the user gives none
POINTS = 40  # number of distances at which laws are compared


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
    options = {"box": box, "cutoff": cutoff or CUTOFF, "epsilon": 1.0, "sigma": 1.0, "n": 0}
    options |= {"box given": lengths is not None, "cutoff given": cutoff is not None}
    parameters = getattr(potential, "parameters", None)
    if isinstance(parameters, tuple) and len(parameters) == 2:
        options |= {"epsilon": parameters[0], "sigma": parameters[1]}
    force = StudentForce(function, options, kind, given)
    if force.takes_box and lengths is None:
        lengths = np.full(3, BOX)
    if force.takes_cutoff:
        cutoff = cutoff or CUTOFF
    told = (
        f"{force.name}({', '.join(force.names)}): "
        + {"forces": "forces on all atoms", "law": "a law of the distance", "pair": "the force of a pair"}[force.kind]
    )
    told += " and the energy" if force.has_energy else ""
    with np.errstate(all="ignore"):
        findings, faults, law, remarks = (_of_bodies if force.kind == "forces" else _of_a_law)(
            force, potential, lengths, cutoff, given
        )
    if force.changes_input:
        faults.append("the function changes the positions that it is given: work on a copy")
    return Grade(told, tuple(findings), tuple(dict.fromkeys(fault for fault in faults if fault)), law, tuple(remarks))


Answer = tuple[list[Finding], list[str], str, list[str]]


def _of_a_law(
    force: StudentForce, potential: Any, lengths: Array | None, cutoff: float | None, given: Array | None
) -> Answer:
    """Grade a law f(r) or the force F(r_ij) of a pair."""
    findings, faults, remarks = [], [], []

    def at(r: float) -> tuple[float, float]:
        if force.kind == "law":
            f, u = force(r * r if force.is_squared else r)
            return float(f), float(u)
        direction = np.array([0.6, 0.0, 0.8])
        f, u = force(r * direction)
        return float(f @ direction), float(np.asarray(u))

    if force.kind == "pair":
        vector, _ = force(np.array([0.9, 0.5, -0.4]))
        off = float(np.linalg.norm(np.cross(vector, [0.9, 0.5, -0.4])) / np.linalg.norm(vector))
        findings.append(Finding("central", off < 1e-9, f"F × r_ij is {off:.1e} of F r", off))
        faults += (
            ["the force of the pair does not point along r_ij: the direction must be r_ij/r in all three components"]
            if off >= 1e-9
            else []
        )
    farthest = FARTHEST
    more = profile_findings(
        lambda r: at(r)[0],
        (lambda r: at(r)[1]) if force.has_energy else None,
        potential,
        cutoff,
        farthest,
        is_law=force.kind == "law",
    )
    findings += more[0]
    faults += more[1]
    remarks += more[3]
    trial = {"law": np.array(1.2 * START), "pair": np.array([START, 0.2, 0.1])}[force.kind]
    return findings, _of_parameters(force, trial, lambda r: at(r)[0], cutoff, findings, faults), more[2], remarks


def _of_parameters(
    force: StudentForce, x: Array, pair: Law | None, cutoff: float | None, findings: list[Finding], faults: list[str]
) -> list[str]:
    """The faults, those of the function's parameters first, in place of less exact ones;
    its own ε and σ are not judged as ε = σ = 1."""
    wrong = without_effect(force, x)
    if pair is not None:
        places = places_of_epsilon_and_sigma(
            force, pair, np.linspace(NEAREST + 0.05, min(0.9 * (cutoff or 2.5), 2.2), POINTS)
        )
        if places is not None:
            faults = without(faults, Kind.OF_UNITS)
            wrong += places
        if places == []:
            findings[:] = [
                replace(one, passed=True) if one.name == "powers of r" and one.passed is False else one
                for one in findings
            ]
    return wrong + (without(faults, Kind.BESIDE_MINIMD) if wrong else faults)


def profile_findings(
    f: Law, u: Law | None, potential: Any, cutoff: float | None, farthest: float, is_law: bool = False
) -> Answer:
    """Grade the force of a pair as a function of the distance.  f : > 0 for repulsion."""
    findings: list[Finding] = []
    faults: list[str] = []
    remarks: list[str] = []
    end = min(farthest, 0.9 * (cutoff or 2.5), 2.2)
    ended = [x for x in np.linspace(1.15, end, 60) if f(float(x)) == 0.0]
    r = np.linspace(NEAREST + 0.05, 0.99 * ended[0] if ended else end, POINTS)
    values = np.array([f(float(x)) for x in r])
    if not np.isfinite(values).all():
        where = r[np.argmin(np.isfinite(values))]
        findings.append(Finding("finite", False, f"the force of a pair is not finite at r = {where:.3g}"))
        return findings, ["the force of a pair is not finite at an ordinary distance"], "", remarks
    if u is not None:
        slopes = -np.array([slope_of(u, float(x)) for x in r])
        pair = ratio_of(values, slopes, r)
        words, fault = related(pair, "−du/dr", is_law)
        if is_law and pair is not None and pair[1] == -1.0:
            remarks.append("the law returns f = −u′(r)/r, as minimd's laws do: multiply it by the vector r_ij")
            values, f = values * r, (lambda f: lambda x: f(x) * x)(f)
        size = float("nan") if pair is None else pair[0]
        findings.append(Finding("force = −∇U", pair is not None and not fault, words, size))
        faults += [fault] if fault else []
        faults += _apart(values, r, u) if pair is None else []
    law, own = "", powers_of(values, r)
    alone = potential is None and u is None
    if own is not None and own.exponents == (1,) and len(own.coefficients) == 1 and alone and not is_law:
        meant = "If q²/r² is meant, a factor 1/r is missing: q² r_ij/r³, not q² r_ij/r²"
        remarks.append(f"the force of a pair decreases as r^−1. {meant}")
        findings.append(Finding("powers of r", None, f"F = {own}"))
    elif own is not None:
        law, suspected = lennard_jones_fault(own)
        findings.append(Finding("powers of r", not suspected if alone else None, f"F = {own}"))
        if potential is None and (u is None or not faults):
            faults += suspected if u is None else []
    if potential is not None:
        known = np.array([reference(potential, float(x)) for x in r])
        pair = ratio_of(values, known, r)
        if is_law and pair is not None and pair[1] == -1.0:
            remarks.append("the law returns f/r: multiply it by the vector r_ij")
            pair = pair[0], 0.0
        words, fault = related(pair, "minimd's force")
        off = float(np.abs(values - known).max() / np.abs(known).max())
        ok = off < SAME_FORCE
        said = f"largest difference {off:.1e} of the largest force" if pair is None or ok else words
        findings.append(Finding("as minimd's", ok, said, off))
        if not ok:
            faults += [fault] if fault else (lennard_jones_fault(own)[1] if own is not None else [])
            faults += (
                []
                if faults
                else [Fault(Kind.BESIDE_MINIMD, f"the force differs from minimd's by {off:.1%} of the largest")]
            )
    elif len(values) and values[0] < 0.0 and not faults:
        findings.append(Finding("sign", None, f"attractive at r = {r[0]:.2f}: {values[0]:.3g}", float(values[0])))
    more, wrong = cutoff_findings(f, u, cutoff, farthest)
    if getattr(potential, "truncation", "") == "truncated":  # minimd's energy jumps, too, as the user has chosen
        jumps = [finding.name == "energy continuous" and not finding.passed for finding in more]
        more = [replace(one, passed=None) if jump else one for one, jump in zip(more, jumps, strict=True)]
        wrong = without(wrong, Kind.JUMP)
    return findings + more, faults + wrong, law, remarks


SAME_FORCE = 1e-9


def _apart(values: Array, r: Array, u: Law) -> list[str]:
    """The wrong powers of r in the force, if energy and force are sums of powers."""
    energy, force = powers_of(np.array([u(float(x)) for x in r]), r), powers_of(values, r)
    if energy is None or force is None:
        return ["the force is not minus the slope of the energy, nor a multiple of it"]
    right = {n + 1: n * c for n, c in zip(energy.exponents, energy.coefficients, strict=True)}
    have = dict(zip(force.exponents, force.coefficients, strict=True))
    parts = [
        f"{have[n]:.6g} r^−{n} where {right[n]:.6g} r^−{n} is needed"
        for n in have
        if n in right and not np.isclose(have[n], right[n], rtol=1e-5)
    ]
    parts += [f"r^−{n} does not belong in it" for n in have if n not in right] + [
        f"{c:.6g} r^−{n} is missing" for n, c in right.items() if n not in have
    ]
    return [
        f"the force is not minus the slope of the energy, u = {energy}: wrong exponent or coefficient: "
        f"{', '.join(parts)}"
    ]


def reference(potential: Any, r: float) -> float:
    """minimd's force of a pair at a distance, > 0 for repulsion."""
    return float(evaluated(np.array([[0.0, 0.0, 0.0], [r, 0.0, 0.0]]), potential, None).forces[1, 0])


def evaluated(x: Array, potential: Any, lengths: Array | None) -> Any:
    """minimd's forces and energy.

    Bonds without pairs join the two atoms if there are two.  Raises ValueError if there are more.
    """
    from minimd.forces.evaluation import evaluate
    from minimd.potentials.bonded import Bond
    from minimd.structure.system import System

    bonds = None
    if isinstance(potential, Bond) and potential.arguments()["pairs"] is None:
        if len(x) != 2:
            raise ValueError(f"{potential!r} does not say which of the {len(x)} atoms are bonded: give it pairs, such "
                             "as pairs=[[0, 1]], or "
                             "positions= of two atoms")  # fmt: skip
        bonds = [[0, 1]]
    return evaluate(System(x, cell=lengths, bonds=bonds), potential)


def _of_bodies(
    force: StudentForce, potential: Any, lengths: Array | None, cutoff: float | None, given: Array | None
) -> Answer:
    """Grade forces on all atoms."""
    bodies = Bodies(force, lengths, cutoff, given)
    remarks = []
    if lengths is None and not bodies.is_field and (edge := bodies.period()) is not None:
        remarks.append(
            f"the forces are periodic along x with the period {edge:.6g}, which is taken as the edge of a cubic cell"
        )
        bodies = Bodies(force, lengths := np.full(3, edge), cutoff, given)
    findings, faults, law = bodies.findings(), list(bodies.faults), ""
    if bodies.takes_pairs and not (bodies.is_broken or bodies.is_field):
        farthest = FARTHEST if lengths is None else min(FARTHEST, 0.5 * float(lengths.min()) * 0.999)
        more = profile_findings(
            bodies.of_a_pair, bodies.energy_of_a_pair if force.has_energy else None, potential, cutoff, farthest
        )
        findings += more[0]
        faults = more[1] + faults
        law = more[2]
        remarks += more[3] if bodies.d == 3 else []
        if (cube := bodies.cube(farthest)) is not None:
            faults = [
                "the cutoff acts on the components, not on the distance: pairs in a cube with half the edge "
                f"{cube:.4g} interact. Compare dx² + dy² + dz² with the square of the cutoff",
                *without(faults, Kind.CUTOFF),
            ]
    if not bodies.is_broken:
        pair = bodies.of_a_pair if bodies.takes_pairs and not bodies.is_field else None
        faults = _of_parameters(force, bodies.x, pair, cutoff, findings, faults)
    if bodies.multiple != 1.0 and not faults:
        faults.append(related((bodies.multiple, 0.0), "−∇U")[1])
    if lengths is not None and cutoff is None and bodies.takes_pairs and not (bodies.is_broken or bodies.is_field):
        findings.append(_at_half_the_cell(bodies, float(lengths.min())))
    if potential is not None:
        finding, fault = _beside(bodies, potential, lengths)
        findings.append(finding)
        faults += fault if not faults else []
    return findings, faults, law, remarks


def _at_half_the_cell(bodies: Bodies, edge: float) -> Finding:
    """The force of a pair at half the cell, where the nearest image changes; it should be zero there."""
    rest = abs(bodies.of_a_pair(0.4999 * edge))
    words = (
        "the force is zero there"
        if rest == 0.0
        else f"the force is still {rest:.2g}, and jumps where the nearest image changes: use a cutoff"
    )
    return Finding("at half the cell", True if rest == 0.0 else None, words, rest)


def _beside(bodies: Bodies, potential: Any, lengths: Array | None) -> tuple[Finding, list[str]]:
    """Compare all forces of a configuration with minimd's."""
    own, x = bodies.f(bodies.x), np.pad(bodies.x, ((0, 0), (0, 3 - bodies.d)))
    answer = evaluated(x, potential, lengths)
    known = answer.forces[:, : bodies.d]
    off = float(np.abs(own - known).max() / np.abs(known).max())
    c = float(np.sum(own * known) / np.sum(known**2))
    words = f"largest difference of {len(own)} atoms {off:.1e} of the largest force"
    is_multiple = float(np.abs(own - c * known).max()) < 1e-6 * float(np.abs(known).max())
    fault = (
        [f"the forces of {len(own)} atoms are {coefficient(c)} times minimd's"]
        if is_multiple and off > SAME_FORCE
        else []
    )
    if off > SAME_FORCE and not fault:
        words = f"the forces of {len(own)} atoms differ from minimd's by {off:.1%} of the largest"
        fault = [Fault(Kind.BESIDE_MINIMD, words)]
    energy = float(np.asarray(bodies.u(bodies.x)))
    if bodies.force.has_energy and not np.isclose(energy, answer.potential_energy, rtol=1e-9):
        fault.append(
            f"the energy of {len(own)} atoms is {energy:.8g}, {energy / answer.potential_energy:.4g} times minimd's, "
            f"{answer.potential_energy:.8g}"
        )
    return Finding("all atoms as minimd's", off < SAME_FORCE, words, off), fault
