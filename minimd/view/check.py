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
from minimd.core.structure.arrays import Array
from minimd.core.structure.cell import images_of_length
from minimd.core.structure.constraints import DistanceConstraints, lengths_of
from minimd.core.structure.observables import absolute_momentum, kinetic_energy, momentum
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
MOST_PEAKS = 6  # of pairs of species that are told
OBSERVED = (*SERIES, "constraint_violation")


@dataclass(frozen=True)
class Comparison:
    """One comparison.
    figure : the largest difference in all frames, relative to a scale.
    tolerance : its limit.
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
        outcome = "ok" if self.passed else "FAILED"
        return f"{self.name:<14} {self.meaning}: {self.figure:.2g}, tolerance {self.tolerance:.2g}: {outcome}"


@dataclass(frozen=True)
class FileCheck(Displayed):
    """The result of check_file. structure : lines about a periodic liquid. str() is the whole text."""

    heading: str
    comparisons: list[Comparison]
    report: Report
    structure: list[str]

    @property
    def passed(self) -> bool:
        """True if all comparisons agree, energy and momentum are conserved, and a barostat has reached its pressure;
        False with too few frames to judge.

        A run that is too short to show a drift of the energy passes if the energy varies little: see Report.is_quiet.
        """
        report = self.report
        energy = report.energy_is_conserved is True or report.is_quiet
        is_kept = energy and report.momentum_is_conserved
        return is_kept and not report.is_far_from_pressure and self._agrees

    @property
    def _agrees(self) -> bool:
        return all(comparison.passed for comparison in self.comparisons)

    @property
    def outcome(self) -> str:
        """The judgement in one line."""
        if not self._agrees:
            return "FAILED: see the lines that end with FAILED; the verdict above does not count"
        if self.passed:
            return "passed"
        if self.report.energy_is_conserved is None or self.report.is_far_from_pressure:
            return f"NOT PASSED: {self.report.verdict}"
        return "FAILED"

    def __str__(self) -> str:
        outcome = f"check          {self.outcome}"
        lines = (self.heading, *self.comparisons, *self.structure, self.report, outcome)
        return "\n".join(map(str, lines))


def check_file(path: str | Path) -> FileCheck:
    """Read a minimd file through MDAnalysis, compare observables with recomputed ones, judge what should be constant.

    Stored observables are float64. Velocities are read in float32; the tolerances allow for this.
    Raises as minimd.mdanalysis.universe.
    """
    damaged = damage(path)
    with damage_told(path) if damaged else nullcontext(), universe_of(path) as run:
        return checked(run, damaged)


def checked(run: RunUniverse, damaged: str = "") -> FileCheck:
    """The check of a file with an open universe.
    damaged : its damaged frames or restarts, see h5md_reader.damage."""
    contents = run.contents
    system = run.system
    is_free = contents.conserves_momentum
    record, figures = recomputed(run)
    # at the present temperature and pressure
    recent = {name: getattr(record, name)[run.n_earlier :] for name in record.names}
    steady = Record.of(system.units, len(system), recent)
    lines = [*pressure_lines(steady, system.masses.sum(), contents.barostat, is_free)]
    for potential in contents.potentials:
        name, _, call = potential.partition(": ")
        if name == "Coulomb":
            bound = "accuracy bounds the rms error of the forces of charges, over their rms"
            lines.append(Line("charges", call, bound, True))

    if contents.thin_cell:
        remedy = "TOO THIN; open it in this direction, with pbc"
        lines.append(Line("cell", contents.thin_cell, remedy, False))
    report = conservation_report(
        record,
        angular=is_free and not system.cell.is_periodic,
        linear=is_free,
        lines=lines,
        n_dof=ConstraintSet(system, system.constraints).degrees_of_freedom(is_free),
        too_long_a_step=contents.too_long_a_step,
    )
    if "temperature" in contents.parameters:  # of a thermostat
        changed = "method, bath or state were changed during the run" if run.n_earlier else ""
        bath = (contents.parameters["temperature"], np.nan)
        report = replace(report, bath=bath, changed=changed)
    plural = "s" * (contents.n_frames > 1)
    heading = (
        f"file           {Path(run.trajectory.filename)}: {contents.title}\n"
        f"read           by MDAnalysis {VERSION}: {contents.n_frames} frame{plural}, "
        f"steps {record.step[0]} to {record.step[-1]}, {contents.method} with steps of "
        f"{system.units.shown(contents.timestep)}, {system.units.name} units\n"
        f"potentials     {printable('; '.join(contents.potentials) or 'none')}"
    )
    return FileCheck(heading, comparisons(run, record, figures, damaged), report, liquid(run))


def recomputed(run: RunUniverse) -> tuple[Record, list[Array]]:
    """What MDAnalysis reads of all frames, in the units of the simulation: the stored observables, in float64; and
    K, Σ p, Σ|p| and length_error, recomputed from float32 velocities and positions, (T,), (T, 3), (T,), (T,)."""
    system = run.system.copy()
    masses = run.atoms.masses
    units = system.units
    entries = []
    figures = []
    for ts in run.trajectory:
        velocities = as_in_run(ts, ts.velocities) * (units.to_picosecond / units.to_angstrom)
        system.positions[:] = as_in_run(ts, ts.positions) / units.to_angstrom
        if "cell" in ts.data:
            system.cell = system.cell.strained(ts.data["cell"])
        entry = {"step": ts.data["step"], "time": ts.time / units.to_picosecond}
        entry |= {name: np.array(ts.data[name]) for name in OBSERVED if name in ts.data}
        entries.append(entry)
        figures.append(
            (
                kinetic_energy(velocities, masses),
                momentum(velocities, masses),
                absolute_momentum(velocities, masses),
                length_error(system),
            )
        )

    series = {name: np.array([entry[name] for entry in entries]) for name in entries[0]}
    record = Record.of(units, len(system), series, run.conserves_momentum)
    return record, [np.array(column) for column in zip(*figures, strict=True)]


def length_error(system: System) -> float:
    """The largest | |r| − d | of the constrained lengths, relative to the largest coordinate; 0 without such
    lengths."""
    positions = system.positions
    cell = system.cell
    for constraint in system.constraints:
        if isinstance(constraint, DistanceConstraints):
            lengths = lengths_of(positions, cell, constraint)
            images = images_of_length(positions, cell, constraint.pairs, lengths)
            first, second = constraint.pairs.T
            bonds = positions[second] - positions[first] + images
            errors = np.abs(np.linalg.norm(bonds, axis=1) - lengths)
            return float(errors.max()) / float(np.abs(positions).max())
    return 0.0


def comparisons(
    run: RunUniverse, record: Record, figures: list[Array], damaged: str
) -> list[Comparison]:
    """Comparisons of recomputed quantities with stored ones.
    In fixed-point arithmetic Σ p is an integer in steps of the grid in each frame."""
    contents = run.contents
    kinetic, momenta, sizes, lengths = figures
    total = record.total_energy
    stored = "recomputed − stored, relative to the stored value"
    changes = np.linalg.norm(momenta - record.momentum, axis=1)
    sums = record.potential_energy + record.kinetic_energy - total
    energies = record.kinetic_energy
    rows = [
        _compared("kinetic energy", kinetic - energies, energies, KINETIC, stored),
        _compared("momentum", changes, sizes, SINGLE, "recomputed − stored, relative to Σ|mv|"),
        _compared("Σ|mv|", sizes - record.absolute_momentum, sizes, SINGLE, stored),
        _compared(
            "total energy", sums, total, EXACT, "potential + kinetic − total, relative to the total"
        ),
    ]
    if "constraint_violation" in record:
        meaning = "recomputed − prescribed, relative to the largest coordinate"
        rows.append(_compared("lengths", lengths, 1.0, LENGTHS, meaning))
    n_late = np.count_nonzero(np.diff(record.step) <= 0)
    rows.append(
        _compared("steps", n_late, 1.0, EXACT, "frames that are not later than the one before")
    )
    grid = contents.restart.grid
    if grid is not None and contents.conserves_momentum:
        frames = frames_of(run.trajectory.filename, range(contents.n_frames), run.system.units)
        inverse_masses = 1.0 / run.system.masses
        totals = np.array(
            [
                grid.momenta(frame.velocities, inverse_masses).astype(np.int64).sum(axis=0)
                for frame in frames
            ]
        )
        meaning = "change of Σ p, in whole steps of the grid"
        rows.append(_compared("exact momentum", totals - totals[0], 1.0, EXACT, meaning))

    which = f"{damaged} are not" if damaged else "frames and restarts are"
    rows.append(
        _compared("checksums", bool(damaged), 1.0, EXACT, f"{which} those that were written")
    )
    return rows


def _compared(
    name: str, differences: Any, scales: Any, tolerance: float, meaning: str
) -> Comparison:
    """A figure is 0 for a zero difference, and infinite for any other with a zero scale."""
    with np.errstate(divide="ignore", invalid="ignore"):
        ratios = np.abs(differences) / np.abs(scales)
    figure = float(np.where(differences == 0.0, 0.0, ratios).max())
    return Comparison(name, figure, tolerance, meaning)


def liquid(run: str | Path | RunUniverse) -> list[str]:
    """Lines about a liquid in a cell with a volume: the first peaks of g(r) of pairs of species, of some if
    there are many; D of atoms, or why it is not known, if there are enough frames.

    run : a file, or its universe.
    Raises as universe.
    """
    with universe_of(run) as universe:
        system = universe.system
        if system.volume is None or len(system) < 2:
            return []
        found = radial_distribution(universe)
        between = " between molecules" * found.is_between
        frames = f"{found.n_frames} of {universe.n_recent} frames"
        lines = [f"g(r)           of pairs of atoms{between}, from {frames}"]
        peaks = [text for _, text in found.display_rows()[1:]]
        lines += [f"               {text}" for text in peaks[:MOST_PEAKS]]
        if len(peaks) > MOST_PEAKS:
            others = f"{len(peaks) - MOST_PEAKS} more pairs: minimd.mdanalysis.radial_distribution has all"
            lines.append(f"               and {others}")
        if universe.n_recent > 1:
            diffusion = diffusion_coefficient(universe)
            if diffusion.result.diffusivity.state != SHORT:
                has_friction = universe.contents.method == LangevinBAOAB.name
                slowed = ", slowed by the friction of Langevin dynamics" if has_friction else ""
                lines.append(f"diffusion      {diffusion}{', of atoms' * found.is_between}{slowed}")

    return lines
