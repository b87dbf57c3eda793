"""The check of a run from its file only: energies and momenta recomputed from velocities read by MDAnalysis,
and conservation laws."""

from contextlib import nullcontext
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from minimd.core.console.display import Displayed
from minimd.core.console.words import printable
from minimd.core.constraints.constraint_set import ConstraintSet
from minimd.core.diagnosis.report import Line, Report, conservation_report
from minimd.core.diagnosis.run_report import pressure_lines
from minimd.core.engine.record import SERIES, Record
from minimd.core.files.h5md_reader import damage, damage_told, frames_of
from minimd.core.files.turned_cell import as_in_run
from minimd.core.integrators.thermostats import LangevinBAOAB
from minimd.core.structure.cell import images_of_length, nearest_vectors
from minimd.core.structure.constraints import DistanceConstraints, lengths_of
from minimd.core.structure.observables import Array, absolute_momentum, kinetic_energy, momentum
from minimd.core.structure.system import System
from minimd.mdanalysis.universes import (
    VERSION,
    RunUniverse,
    diffusion_coefficient,
    radial_distribution,
    universe_of,
)
from minimd.observers.diffusion import SHORT

# 2⁻²⁴, relative rounding of a velocity to float32, and therefore the largest error of a momentum relative to Σ|mv|
SINGLE = 6e-8
# K is quadratic in velocities: its error is twice that rounding; the rest is a margin for the sum
KINETIC = 1e-6
LENGTHS = 2.1e-7  # √12 times that rounding: a length depends on six rounded coordinates
EXACT = 0.0
OBSERVED = (*SERIES, "constraint_violation")


@dataclass(frozen=True)
class Comparison:
    """One comparison.  figure : the largest difference in all frames, relative to a scale.  tolerance : its limit.
    meaning : what is compared."""

    name: str
    figure: float
    tolerance: float
    meaning: str

    @property
    def passed(self) -> bool:
        """True if the figure is within the tolerance; False for NaN."""
        return self.figure <= self.tolerance

    def __str__(self) -> str:
        compared = f"{self.meaning}: {self.figure:.2g}, tolerance {self.tolerance:.2g}"
        return f"{self.name:<14} {compared}: {'ok' if self.passed else 'FAILED'}"


@dataclass(frozen=True)
class FileCheck(Displayed):
    """The result of check_file. structure : lines about a periodic liquid. str() is the whole text."""

    heading: str
    comparisons: list[Comparison]
    report: Report
    structure: list[str]

    @property
    def passed(self) -> bool:
        """True if all comparisons agree, and energy and momentum are conserved; False with too few frames to judge.

        A run that is too short to show a drift of the energy passes if the energy varies little: see Report.is_quiet.
        """
        report = self.report
        conserved = (
            report.energy_is_conserved is True or report.is_quiet
        ) and report.momentum_is_conserved
        return conserved and all(one.passed for one in self.comparisons)

    @property
    def outcome(self) -> str:
        """The judgement in one line."""
        if (
            not self.passed
            and self.report.energy_is_conserved is None
            and all(one.passed for one in self.comparisons)
        ):
            return f"NOT PASSED: {self.report.verdict}"
        if not all(one.passed for one in self.comparisons):
            return "FAILED: see the lines that end with FAILED; the verdict above does not count"
        return "passed" if self.passed else "FAILED"

    def __str__(self) -> str:
        lines = (
            self.heading,
            *self.comparisons,
            *self.structure,
            self.report,
            f"check          {self.outcome}",
        )
        return "\n".join(map(str, lines))


def check_file(path: str | Path) -> FileCheck:
    """Read a minimd file through MDAnalysis, compare observables with recomputed ones, judge what should be constant.

    Stored observables are float64. Velocities are read in float32; the tolerances allow for this.
    Raises as minimd.mdanalysis.universe.
    """
    which = damage(path)
    with damage_told(path) if which else nullcontext(), universe_of(path) as made:
        return checked(made, which)


def checked(made: RunUniverse, damaged: str = "") -> FileCheck:
    """The check of a file with an open universe.  damaged : its damaged frames or restarts, see h5md_reader.damage."""
    contents = made.contents
    system = made.system
    is_free = made.contents.conserves_momentum
    record, found = recomputed(made)
    lines = [*pressure_lines(record, system.masses.sum(), contents.barostat, is_free)]
    angular = is_free and not system.cell.is_periodic
    bound = "accuracy bounds the rms error of the forces of charges, over their rms"
    calls = (
        one.removeprefix("Coulomb: ") for one in contents.potentials if one.startswith("Coulomb: ")
    )
    lines += [Line("charges", call, bound, True) for call in calls]
    if contents.thin_cell:
        lines.append(
            Line("cell", contents.thin_cell, "TOO THIN; open it in this direction, with pbc", False)
        )
    n_dof = ConstraintSet(system, system.constraints).degrees_of_freedom(is_free)
    report = conservation_report(
        record, angular, None, is_free, lines, n_dof, contents.too_long_a_step
    )
    if "temperature" in contents.parameters:  # of a thermostat
        report = replace(report, bath=(contents.parameters["temperature"], 0.0))
    frames = f"{contents.n_frames} frame{'s' * (contents.n_frames > 1)}, steps {record.step[0]} to {record.step[-1]}"
    heading = (
        f"file           {Path(made.trajectory.filename)}: {contents.title}\n"
        f"read           by MDAnalysis {VERSION}: {frames}, {contents.method} with steps of "
        f"{system.units.shown(contents.timestep)}, {system.units.name} units\n"
        f"potentials     {printable('; '.join(contents.potentials) or 'none')}"
    )
    return FileCheck(heading, comparisons(made, record, found, damaged), report, liquid(made))


def recomputed(made: RunUniverse) -> tuple[Record, list[Array]]:
    """What MDAnalysis reads of all frames, in the units of the simulation: the stored observables, in float64; and
    K, Σ p, Σ|p| and length_error, recomputed from float32 velocities and positions, (T,), (T, 3), (T,), (T,)."""
    system = made.system.copy()
    masses = made.atoms.masses
    units = made.system.units
    rows = []
    for ts in made.trajectory:
        v = as_in_run(ts, ts.velocities) * (units.to_picosecond / units.to_angstrom)
        system.positions[:] = as_in_run(ts, ts.positions) / units.to_angstrom
        if "cell" in ts.data:
            system.cell = system.cell.strained(ts.data["cell"])
        at = {"step": ts.data["step"], "time": ts.time / units.to_picosecond}
        at |= {name: np.array(ts.data[name]) for name in OBSERVED if name in ts.data}
        rows.append(
            (
                at,
                kinetic_energy(v, masses),
                momentum(v, masses),
                absolute_momentum(v, masses),
                length_error(system),
            )
        )
    stored, *found = zip(*rows, strict=True)
    series = {name: np.array([row[name] for row in stored]) for name in stored[0]}
    return Record.of(units, len(system), series), [np.array(one) for one in found]


def length_error(system: System) -> float:
    """The largest | |r| − d | of the constrained lengths, relative to the largest coordinate; 0 without such
    lengths."""
    positions = system.positions
    cell = system.cell
    for one in system.constraints:
        if isinstance(one, DistanceConstraints):
            lengths = lengths_of(positions, cell, one)
            images = images_of_length(positions, cell, one.pairs, lengths)
            bonds = positions[one.pairs[:, 1]] - positions[one.pairs[:, 0]] + images
            return float(np.abs(np.linalg.norm(bonds, axis=1) - lengths).max()) / float(
                np.abs(positions).max()
            )
    return 0.0


def comparisons(
    made: RunUniverse, record: Record, found: list[Array], damaged: str
) -> list[Comparison]:
    """Comparisons of recomputed quantities with stored ones. A figure is 0 for a zero difference, and infinite for any
    other with a zero scale. In fixed-point arithmetic Σ p is an integer in steps of the grid in each frame."""
    kinetic, momenta, sizes, lengths = found
    grid = made.contents.restart.grid
    energy = record.potential_energy + record.kinetic_energy
    relative = "recomputed − stored, relative to"
    stored = f"{relative} the stored value"
    written = f"{damaged} are not" if damaged else "frames and restarts are"
    rows: list[tuple[str, Any, Any, float, str]] = [
        ("kinetic energy", kinetic - record.kinetic_energy, record.kinetic_energy, KINETIC, stored),
        ("momentum", np.linalg.norm(momenta - record.momentum, axis=1), sizes, SINGLE, f"{relative} Σ|mv|"),
        ("Σ|mv|", sizes - record.absolute_momentum, sizes, SINGLE, stored),
        ("total energy", energy - record.total_energy, record.total_energy, EXACT,
         "potential + kinetic − total, relative to the total"),
        *([("lengths", lengths, 1.0, LENGTHS, "recomputed − prescribed, relative to the largest coordinate")]
          if "constraint_violation" in record else []),
        ("steps", np.count_nonzero(np.diff(record.step) <= 0), 1.0, EXACT,
         "frames that are not later than the one before"),
        ("checksums", bool(damaged), 1.0, EXACT, f"{written} those that were written"),
    ]  # fmt: skip
    if grid is not None and made.contents.conserves_momentum:
        frames = frames_of(
            made.trajectory.filename, range(made.contents.n_frames), made.system.units
        )
        steps = (
            grid.momenta(one.velocities, 1.0 / made.system.masses).astype(np.int64)
            for one in frames
        )
        totals = np.array([one.sum(axis=0) for one in steps])
        rows.insert(
            -1,
            (
                "exact momentum",
                totals - totals[0],
                1.0,
                EXACT,
                "change of Σ p, in whole steps of the grid",
            ),
        )
    with np.errstate(divide="ignore", invalid="ignore"):
        return [
            Comparison(
                name,
                float(np.where(figures == 0.0, 0.0, np.abs(figures) / np.abs(scales)).max()),
                limit,
                meaning,
            )
            for name, figures, scales, limit, meaning in rows
        ]


def liquid(run: str | Path | RunUniverse) -> list[str]:
    """Lines about a liquid that is periodic in all directions: the first peak of g(r); D, or why it is not known, if
    there are enough frames.

    run : a file, or its universe.  Raises as universe.
    """
    with universe_of(run) as made:
        contents = made.contents
        system = made.system
        if not system.cell.pbc.all() or len(system) < 2:
            return []
        r, g = radial_distribution(made)
        # the first interval of this has the first peak
        above = np.append(g >= 0.5 * g.max(), False)
        first = int(np.argmax(above))
        peak = float(r[first + np.argmax(g[first : first + int(np.argmin(above[first:]))])])
        rigid = [one.pairs for one in system.constraints if isinstance(one, DistanceConstraints)]
        bonds = nearest_vectors(
            system.positions, system.cell, np.concatenate([system.bonds, *rigid])
        )
        apart = np.linalg.norm(bonds, axis=1)
        inside = ", between bonded atoms" * bool((np.abs(apart - peak) < 0.1 * peak).any())
        lines = [f"g(r)           first peak at {peak:.3g} {system.units.length}{inside}"]
        if contents.n_frames > 1:
            diffusion = diffusion_coefficient(made)
            if diffusion.result.diffusivity.state != SHORT:
                slowed = ", slowed by the friction of Langevin dynamics" * (
                    contents.method == LangevinBAOAB.name
                )
                lines.append(f"diffusion      {diffusion}{slowed}")
    return lines
