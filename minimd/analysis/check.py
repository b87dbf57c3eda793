"""The check of a run from its file only: energies and momenta recomputed from velocities read by MDAnalysis,
and conservation laws."""

from contextlib import nullcontext
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from minimd.console.display import Displayed
from minimd.constraints.constraint_set import ConstraintSet
from minimd.diagnosis.report import Report, conservation_report
from minimd.diagnosis.run_report import pressure_lines
from minimd.engine.record import SERIES, Record
from minimd.files.h5md_reader import damage, damage_told, frames_of
from minimd.files.turned_cell import as_in_run
from minimd.integrators import LangevinBAOAB
from minimd.mdanalysis.universes import VERSION, RunUniverse, diffusion_coefficient, radial_distribution, universe_of
from minimd.structure.cell import images_of_length
from minimd.structure.constraints import DistanceConstraints, lengths_of
from minimd.structure.observables import absolute_momentum, kinetic_energy, momentum
from minimd.structure.system import System

# 2⁻²⁴, relative rounding of a velocity to float32, and therefore the largest error of a momentum relative to Σ|mv|
SINGLE = 6e-8
KINETIC = 1e-6  # K is quadratic in velocities: its error is twice that rounding; the rest is a margin for the sum
LENGTHS = 2.1e-7  # √12 times that rounding: a length depends on six rounded coordinates
EXACT = 0.0
OBSERVED = (*SERIES, "constraint_violation")
ENOUGH_FRAMES = 20  # for a diffusion coefficient: its fit then has eight lags


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
        return (
            f"{self.name:<14} {self.meaning}: {self.figure:.2g}, tolerance {self.tolerance:.2g}: "
            f"{'ok' if self.passed else 'FAILED'}"
        )


@dataclass(frozen=True)
class FileCheck(Displayed):
    """The result of check_file. structure : lines about a periodic liquid. str() is the whole text."""

    heading: str
    comparisons: list[Comparison]
    report: Report
    structure: list[str]

    @property
    def passed(self) -> bool:
        """True if all comparisons agree, and energy and momentum are conserved;
        False also if there are too few frames to judge.

        A run that is too short to show a drift of the energy passes if the energy varies little: see Report.is_quiet.
        """
        report = self.report
        conserved = (report.energy_is_conserved is True or report.is_quiet) and report.momentum_is_conserved
        return conserved and all(one.passed for one in self.comparisons)

    @property
    def outcome(self) -> str:
        """The judgement in one line."""
        if not self.passed and self.report.energy_is_conserved is None and all(one.passed for one in self.comparisons):
            return f"NOT PASSED: {self.report.verdict}"
        return "passed" if self.passed else "FAILED"

    def __str__(self) -> str:
        return "\n".join(
            [
                self.heading,
                *map(str, self.comparisons),
                *self.structure,
                str(self.report),
                f"check          {self.outcome}",
            ]
        )


def check_file(path: str | Path) -> FileCheck:
    """Read a minimd file through MDAnalysis, compare stored observables with recomputed ones,
    and judge what should be constant.

    Stored observables are float64. Velocities are read in float32; the tolerances allow for this.
    Raises as minimd.mdanalysis.universe.
    """
    which = damage(path)
    with damage_told(path) if which else nullcontext(), universe_of(path) as made:
        return checked(made, which)


def checked(made: RunUniverse, damaged: str = "") -> FileCheck:
    """The check of a file with an open universe.  damaged : its damaged frames or restarts,
    see minimd.files.h5md_reader.damage."""
    written = (
        f"{damaged} are not those that were written" if damaged else "frames and restarts are those that were written"
    )
    sums = Comparison("checksums", float(bool(damaged)), EXACT, written)
    contents, moved, system = made.contents, recompute(made), made.system
    record, is_free = (
        Record.of(system.units, len(system), {"step": moved.step, "time": moved.time, **moved.stored}),
        contents.conserves_momentum,
    )
    lines, angular = tuple(pressure_lines(record, contents.barostat, is_free)), is_free and not system.cell.is_periodic
    n_dof = ConstraintSet(contents.system, contents.system.constraints).degrees_of_freedom(is_free)
    report = conservation_report(record, angular, None, is_free, lines, n_dof, contents.too_long_a_step)
    several = "s" * (contents.n_frames > 1)
    frames = (
        f"{contents.n_frames} frame{several}, steps {moved.step[0]} to {moved.step[-1]}, {contents.method}, "
        f"{system.units.name} units"
    )
    heading = (
        f"file           {Path(made.trajectory.filename)}: {contents.title}\nread           by MDAnalysis "
        f"{VERSION}: {frames}"
    )
    return FileCheck(heading, [*comparisons(moved), *exact_momenta(made), sums], report, liquid(made))


class Recomputed(NamedTuple):
    """Quantities of all frames, recomputed from what MDAnalysis reads, in the units of the simulation.

    step, time : (T,).  stored : observables of the file in float64, not rounded, with the names in OBSERVED.
    kinetic_energy, momentum, absolute_momentum : (T,), (T, 3), (T,), recomputed from float32 velocities.
    length_error : (T,), see the function length_error, from float32 positions.
    """

    step: NDArray[np.int64]
    time: NDArray[np.float64]
    stored: dict[str, NDArray[np.float64]]
    kinetic_energy: NDArray[np.float64]
    momentum: NDArray[np.float64]
    absolute_momentum: NDArray[np.float64]
    length_error: NDArray[np.float64]


def recompute(run: str | Path | RunUniverse) -> Recomputed:
    """Stored observables, and energies and momenta recomputed from velocities and masses, of all frames.

    run : a file, or its universe.  Raises as universe.
    """
    with universe_of(run) as made:
        system, masses, rows = made.system.copy(), made.atoms.masses, []
        units, names = system.units, [name for name in OBSERVED if name in made.trajectory.ts.data]
        for ts in made.trajectory:
            v = as_in_run(ts, ts.velocities) * (units.to_picosecond / units.to_angstrom)
            moments = (observable(v, masses) for observable in (kinetic_energy, momentum, absolute_momentum))
            system.positions[:] = as_in_run(ts, ts.positions) / units.to_angstrom
            if "cell" in ts.data:
                system.cell = system.cell.strained(ts.data["cell"])
            stored = (np.array(ts.data[name]) for name in names)
            rows.append((ts.data["step"], ts.time / units.to_picosecond, *stored, *moments, length_error(system)))
    step, time, *series = (np.array(column) for column in zip(*rows, strict=True))
    return Recomputed(step, time, dict(zip(names, series, strict=False)), *series[len(names) :])


def length_error(system: System) -> float:
    """The largest | |r| − d | of the constrained lengths, relative to the largest coordinate;
    0 without such lengths."""
    scale = float(np.abs(system.positions).max())
    for one in system.constraints:
        if isinstance(one, DistanceConstraints):
            lengths = lengths_of(system.positions, system.cell, one)
            images = images_of_length(system.positions, system.cell, one.pairs, lengths)
            bonds = system.positions[one.pairs[:, 1]] - system.positions[one.pairs[:, 0]] + images
            return float(np.abs(np.linalg.norm(bonds, axis=1) - lengths).max()) / scale
    return 0.0


def comparisons(moved: Recomputed) -> list[Comparison]:
    """Comparisons of recomputed quantities with stored ones."""
    stored, absolute = moved.stored, moved.absolute_momentum
    parts = stored["potential_energy"] + stored["kinetic_energy"]
    kinetic = _largest(moved.kinetic_energy - stored["kinetic_energy"], stored["kinetic_energy"])
    not_later = int(np.count_nonzero(np.diff(moved.step) <= 0))
    lengths = Comparison(
        "lengths",
        float(moved.length_error.max()),
        LENGTHS,
        "recomputed − prescribed, relative to the largest coordinate",
    )
    return [
        Comparison("kinetic energy", kinetic, KINETIC, "recomputed − stored, relative to the stored value"),
        Comparison(
            "momentum",
            _largest(moved.momentum - stored["momentum"], absolute),
            SINGLE,
            "recomputed − stored, relative to Σ|mv|",
        ),
        Comparison(
            "Σ|mv|",
            _largest(absolute - stored["absolute_momentum"], absolute),
            SINGLE,
            "recomputed − stored, relative to the stored value",
        ),
        Comparison(
            "total energy",
            _largest(parts - stored["total_energy"], stored["total_energy"]),
            EXACT,
            "potential + kinetic − total, relative to the total",
        ),
        *([lengths] if "constraint_violation" in stored else []),
        Comparison("steps", not_later, EXACT, "frames that are not later than the one before"),
    ]


def exact_momenta(made: RunUniverse) -> list[Comparison]:
    """For a run in fixed-point arithmetic: Σ p of each frame, an integer in steps of the grid,
    compared with that of the first frame."""
    contents, grid = made.contents, made.contents.restart.grid
    if grid is None or not contents.conserves_momentum:
        return []
    inverse_masses = 1.0 / made.system.masses
    totals = [
        grid.momenta(one.velocities, inverse_masses).astype(np.int64).sum(axis=0)
        for one in frames_of(made.trajectory.filename, range(contents.n_frames), made.system.units)
    ]
    changed = float(np.abs(np.array(totals) - totals[0]).max())
    return [Comparison("exact momentum", changed, EXACT, "change of Σ p, in whole steps of the grid")]


def _largest(differences: NDArray[np.float64], scales: NDArray[np.float64]) -> float:
    """The largest |difference| / |scale| in all frames; 0 for a zero difference,
    infinite for any other with a zero scale."""
    sizes, scales = (
        np.abs(differences) if differences.ndim == 1 else np.linalg.norm(differences, axis=1),
        np.abs(scales),
    )
    with np.errstate(divide="ignore", invalid="ignore"):
        return float(np.where(sizes == 0.0, 0.0, sizes / scales).max())


def liquid(run: str | Path | RunUniverse) -> list[str]:
    """Lines about a periodic liquid: the first peak of g(r),
    and D if there are enough frames and the atoms have left their places.

    They have left their places if they have moved by half the distance of neighbors within the window of the fit. Empty
    if the cell is not periodic in all directions.
    run : a file, or its universe.  Raises as universe.
    """
    with universe_of(run) as made:
        contents, units = made.contents, made.contents.system.units
        if not contents.system.cell.pbc.all() or len(contents.system) < 2:
            return []
        r, g = radial_distribution(made)
        above = np.append(g >= 0.5 * g.max(), False)  # the first interval of this has the first peak
        first = int(np.argmax(above))
        end = first + int(np.argmin(above[first:]))
        peak = float(r[first + np.argmax(g[first:end])])
        lines = [f"g(r)           first peak at {peak:.3g} {units.length}"]
        if contents.n_frames >= ENOUGH_FRAMES:
            diffusion = diffusion_coefficient(made)
            moved = float(diffusion.displacements[diffusion.lags <= diffusion.window[1]][-1]) ** 0.5
            if moved > 0.5 * peak * units.to_angstrom:
                slowed = (
                    ", of Langevin dynamics, whose friction slows it" if contents.method == LangevinBAOAB.name else ""
                )
                lines.append(f"diffusion      {diffusion}{slowed}")
    return lines
