"""The grade of a force function: whether forces are a gradient, pairwise, symmetric, periodic, cut off correctly, and
equal to minimd's."""

from collections.abc import Sequence
from typing import Any

import numpy as np

from minimd.core.structure.checks import checked_sizes
from minimd.judge.calling import KINDS, StudentForce
from minimd.judge.findings import Grade, Law, causes, judged
from minimd.judge.probe import CURE, CUTOFF, EQUAL, ROUNDING, SAME, Probe
from minimd.judge.problems import Function

BOX = 12.0  # σ: cell for a function that takes one, if the user gives none

LAWS = (  # the most telling first
    Law(
        "finite",
        Probe.not_finite,
        0.5,
        "{0:g} are not",
        "forces are not finite: an atom meets itself (i = j, r = 0), or two atoms coincide",
    ),
    Law("parameters", Probe.without_effect, 0.5, "{0} have no effect", "{2}"),
    Law(
        "central",
        Probe.sideways,
        1e-9,
        "F × r_ij is {0:.1e} of F r",
        "the force of the pair does not point along r_ij",
        "pair",
    ),
    Law(
        "nearest image",
        Probe.images,
        0.5,
        "atoms across {0} faces are no neighbors",
        "{2}",
        "forces pairs cell",
    ),
    Law(
        "rotation",
        Probe.turned,
        SAME,
        "turned forces differ by {0:.1e}",
        "forces do not turn with atoms: a component is missing, or r is not √(x² + y² + z²)",
        "forces nofield free",
    ),
    Law(
        "a gradient",
        Probe.curl,
        1e-4,
        "∂F_i/∂x_j − ∂F_j/∂x_i is {0:.1e} of the largest element",
        "the forces are not the gradient of any energy (∂F_i/∂x_j and ∂F_j/∂x_i differ): no energy is conserved",
        "forces noenergy",
    ),
    Law(
        "sum over pairs",
        Probe.sum_of_pairs,
        SAME,
        "F − Σ of single pairs is {0:.1e} of F",
        "{2}",
        "forces pairs",
    ),
    Law(
        "sum of forces",
        Probe.reaction,
        ROUNDING,
        "|Σ F| is {0:.1e} of F",
        "Σ F is not zero{2}",
        "forces nofield",
    ),
    Law(
        "not capped",
        Probe.cap,
        0.5,
        "the force follows its law down to r = 0.3",
        "the force is capped at close distances (r = {0:.3f} and below), where it no longer follows its law",
        "pairs",
    ),
    Law("powers of r", Probe.of_powers, 0.5, "F = {3}", "{2}", "pairs"),
    Law("force = −∇U", Probe.as_slope, 0.5, "F is {0:.6g} times −du/dr", "{2}", "pairs energy"),
    Law("as minimd's", Probe.as_known, 0.5, "F is {0:.6g} times it", "{2}", "pairs known"),
    Law(
        "cutoff",
        Probe.ending,
        1e-300,
        "the largest force beyond it is {0:.2g}",
        "the cutoff {2:g} is not applied, or acts on the components, not on the distance: the largest force beyond it "
        "is {0:.3g}",
        "pairs cutoff",
    ),
    Law(
        "force continuous",
        Probe.end,
        0.5,
        "{2}",
        "the force ends at r = {0:.6g}, where it should not: is r² compared with the cutoff, not with its square?",
        "pairs",
    ),
    Law(
        "energy continuous",
        Probe.jump,
        1e-300,
        "first jump: {0:+.4g}",
        "the energy jumps at the cutoff by {0:+.4g} whenever a pair crosses r = {2:.6g}; subtract u(r_c) = {3:.4g} "
        "from the energy of a pair",
        "pairs energy",
    ),
)
GENERAL = (  # told if no other law says why
    Law(
        "all forces = −∇U",
        Probe.all_slopes,
        EQUAL,
        "off by {0:.1e}",
        "the forces are not −∇U{2}",
        "forces energy",
    ),
    Law(
        "exchange",
        Probe.renumbered,
        ROUNDING,
        "renumbered forces differ by {0:.1e}",
        "forces depend on the numbering of atoms: pairs are left out, or forces overwritten (=)",
        "forces",
    ),
    Law(
        "translation",
        Probe.shifted,
        SAME,
        "shifted forces differ by {0:.1e}",
        "the forces change if all atoms are shifted",
        "forces nofield",
    ),
    Law(
        "periodic",
        Probe.in_other_cells,
        SAME,
        "in other cells forces differ by {0:.1e}",
        f"forces on atoms outside the cell differ: {CURE}",
        "forces nofield cell",
    ),
    Law(
        "all atoms as minimd's",
        Probe.all_beside,
        ROUNDING,
        "off by {0:.1e}",
        "against minimd {2}",
        "forces known",
    ),
    Law("external field", lambda probe: np.nan, 0.5, "a single atom feels a force", needs="field"),
)


def grade_forces(
    function: Function,
    potential: Any,
    cell: float | Sequence[float] | None,
    cutoff: float | None,
    positions: Any,
    kind: str | None,
) -> Grade:
    """The grade of a force function, see grade."""
    lengths = None if cell is None else checked_sizes("cell", cell, 3, "edge")
    if positions is not None:
        positions = np.array(positions, dtype=float)
        if positions.shape[1:] != (3,) or not np.isfinite(positions).all():
            raise ValueError(
                f"positions must be (N, 3) finite numbers; got shape {positions.shape}"
            )

    own_cutoff = getattr(potential, "cutoff", None)
    if cutoff is None and own_cutoff and np.isfinite(own_cutoff):
        cutoff = float(own_cutoff)
    units = getattr(potential, "parameters", None)
    if not isinstance(units, tuple) or len(units) != 2:
        units = (1.0, 1.0)
    edge: Any = BOX
    if lengths is not None:
        edge = lengths if np.ptp(lengths) else float(lengths[0])
    options = {
        "box": edge,
        "cutoff": cutoff or CUTOFF,
        "epsilon": units[0],
        "sigma": units[1],
        "n": 0,
        "box given": lengths is not None,
        "cutoff given": cutoff is not None,
    }
    with np.errstate(all="ignore"):
        call = StudentForce(function, options, kind, positions)
        if "box" in call.takes and lengths is None:
            lengths = np.full(3, BOX)
        if "cutoff" in call.takes:
            cutoff = options["cutoff"]
        probe = Probe(call, lengths, cutoff, positions, potential)
        period = probe.period()
        if period:
            probe = Probe(call, np.full(3, period), cutoff, positions, potential)
            probe.remarks.append(
                f"forces are periodic along x with the period {period:.6g}, taken as the edge of a cubic cell"
            )
        telling = judged(LAWS, probe)
        general = judged(GENERAL, probe)
        if cutoff is None and probe.cell is not None and probe.has >= {"forces", "pairs"}:
            rest = abs(probe.f(0.4999 * probe.cell.min()))
            if rest:
                probe.remarks.append(
                    f"the force jumps by {rest:.2g} where the nearest image changes: use a cutoff"
                )
    faults = causes(telling) or causes(general)
    if call.changes_input:
        faults.append("the function changes the positions that it is given: work on a copy")
    energy = " and the energy" if call.has_energy else ""
    call_text = f"{call.name}({', '.join(call.names)}): {KINDS[call.kind]}{energy}"
    return Grade(call_text, (*telling, *general), tuple(faults), probe.name, tuple(probe.remarks))
