"""Checking a run from its file alone: what MDAnalysis recomputes from the velocities, and what should have been conserved."""

from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from minimd.diagnosis.report import Report, conservation_report
from minimd.engine.record import SERIES, Record
from minimd.files.h5md_writer import H5MDContents, read_file
from minimd.mdanalysis.universe import VERSION, diffusion_coefficient, radial_distribution, universe
from minimd.structure import observables
from minimd.structure.constraints import DistanceConstraints
from minimd.structure.images import images_of_length, lengths_of
from minimd.structure.system import System

SINGLE = 6e-8  # 2⁻²⁴, rounding of a velocity to float32, and so at most this part of Σ|mv|
KINETIC = 1e-6  # K is quadratic in velocities: twice that rounding, and room for the sum
LENGTHS = 2.1e-7  # √12 times that rounding: of three coordinates at either end
EXACT = 0.0
OBSERVED = (*SERIES, "constraint_violation")
ENOUGH_FRAMES = 20  # for a diffusion coefficient


@dataclass(frozen=True)
class Comparison:
    """One question to the file.  figure : the worst of all frames.  tolerance : its limit.  meaning : what the figure is."""

    name: str
    figure: float
    tolerance: float
    meaning: str

    @property
    def passed(self) -> bool:
        """True if the figure is within the tolerance; NaN is not."""
        return self.figure <= self.tolerance

    def __str__(self) -> str:
        return f"{self.name:<14} {self.meaning}: {self.figure:.2g}, tolerance {self.tolerance:.2g}: {'ok' if self.passed else 'FAILED'}"


@dataclass(frozen=True)
class FileCheck:
    """The outcome of check_file. structure : lines about the liquid. str() is the text for people."""

    heading: str
    comparisons: list[Comparison]
    report: Report
    structure: list[str]

    @property
    def passed(self) -> bool:
        """True if all comparisons agree, and energy and momentum are conserved; False also where too few frames do not tell."""
        conserved = self.report.energy_is_conserved is True and self.report.momentum_is_conserved
        return conserved and all(one.passed for one in self.comparisons)

    @property
    def outcome(self) -> str:
        """One line."""
        if self.report.energy_is_conserved is None and all(one.passed for one in self.comparisons):
            return f"NOT PASSED: too few frames to judge the energy ({self.report.n_frames}); observe more often"
        return "passed" if self.passed else "FAILED"

    def __str__(self) -> str:
        return "\n".join([self.heading, *map(str, self.comparisons), *self.structure, str(self.report), f"check          {self.outcome}"])


def check_file(path: str | Path) -> FileCheck:
    """Read a minimd file through MDAnalysis, recompute what can be recomputed, and judge what should be constant.

    Stored observables are float64 and uncast; velocities come in float32, which the tolerances allow for.

    Raises
    ------
    FileNotFoundError, OSError, ValueError : as minimd.h5md.read_file.
    """
    contents, moved = read_file(path), recompute(path)
    record, is_free = _record(contents, moved), contents.conserves_momentum
    return FileCheck(
        heading=_heading(Path(path), contents),
        comparisons=comparisons(moved),
        report=conservation_report(record, linear=is_free, angular=is_free and not contents.system.cell.is_periodic),
        structure=liquid(path),
    )


class Recomputed(NamedTuple):
    """All frames as MDAnalysis gives them, in the units of the simulation.

    step : (T,).  time : (T,).  stored : observables of the file, float64 and uncast, named as in OBSERVED.
    kinetic_energy, momentum, absolute_momentum : (T,), (T, 3), (T,), recomputed from float32 velocities.
    length_error : (T,), of the worst length that is kept, recomputed from float32 positions; see length_error.
    """

    step: NDArray[np.int64]
    time: NDArray[np.float64]
    stored: dict[str, NDArray[np.float64]]
    kinetic_energy: NDArray[np.float64]
    momentum: NDArray[np.float64]
    absolute_momentum: NDArray[np.float64]
    length_error: NDArray[np.float64]


def recompute(path: str | Path) -> Recomputed:
    """Stored observables, and energies and momenta recomputed from velocities and masses, of all frames.

    Raises
    ------
    As universe.
    """
    system = read_file(path).system
    units, made, rows = system.units, universe(path), []
    masses = made.atoms.masses
    for ts in made.trajectory:
        v = ts.velocities * np.float64(units.to_picosecond / units.to_angstrom)
        stored = [np.array(ts.data[name]) for name in OBSERVED if name in ts.data]
        moments = observables.kinetic_energy(v, masses), observables.momentum(v, masses), observables.absolute_momentum(v, masses)
        system.positions[:] = ts.positions / np.float64(units.to_angstrom)
        rows.append((ts.data["step"], ts.time / units.to_picosecond, *stored, *moments, length_error(system)))
    names = [name for name in OBSERVED if name in ts.data]
    made.trajectory.close()
    step, time, *series = (np.array(column) for column in zip(*rows, strict=True))
    return Recomputed(step, time, dict(zip(names, series, strict=False)), *series[len(names) :])


def length_error(system: System) -> float:
    """|r − d| of the worst length that a system should keep, of its largest coordinate; 0 if it keeps none."""
    scale = float(np.abs(system.positions).max())
    for one in system.constraints:
        if isinstance(one, DistanceConstraints):
            lengths = lengths_of(system.positions, system.cell, one)
            bonds = (
                system.positions[one.pairs[:, 1]]
                - system.positions[one.pairs[:, 0]]
                + images_of_length(system.positions, system.cell, one.pairs, lengths)
            )
            return float(np.abs(np.linalg.norm(bonds, axis=1) - lengths).max()) / scale
    return 0.0


def comparisons(moved: Recomputed) -> list[Comparison]:
    """Recomputed against stored."""
    stored, absolute = moved.stored, moved.absolute_momentum
    parts = stored["potential_energy"] + stored["kinetic_energy"]
    kinetic = _largest(moved.kinetic_energy - stored["kinetic_energy"], stored["kinetic_energy"])
    not_forward = int(np.count_nonzero(np.diff(moved.step) <= 0))
    lengths = Comparison("lengths", float(moved.length_error.max()), LENGTHS, "recomputed − kept, of the largest coordinate")
    return [
        Comparison("kinetic energy", kinetic, KINETIC, "recomputed − stored, of itself"),
        Comparison("momentum", _largest(moved.momentum - stored["momentum"], absolute), SINGLE, "recomputed − stored, of Σ|mv|"),
        Comparison("Σ|mv|", _largest(absolute - stored["absolute_momentum"], absolute), SINGLE, "recomputed − stored, of itself"),
        Comparison("total energy", _largest(parts - stored["total_energy"], stored["total_energy"]), EXACT, "potential + kinetic − total, of itself"),
        *([lengths] if "constraint_violation" in stored else []),
        Comparison("steps", not_forward, EXACT, "frames that do not come later than the one before"),
    ]


def _largest(differences: NDArray[np.float64], scales: NDArray[np.float64]) -> float:
    """Largest |difference| / |scale| of all frames; a difference of zero needs no scale, any other of a zero scale is infinite."""
    sizes, scales = np.abs(differences) if differences.ndim == 1 else np.linalg.norm(differences, axis=1), np.abs(scales)
    with np.errstate(divide="ignore", invalid="ignore"):
        return float(np.where(sizes == 0.0, 0.0, sizes / scales).max())


def _record(contents: H5MDContents, moved: Recomputed) -> Record:
    return Record.of(contents.system.units, len(contents.system), {"step": moved.step, "time": moved.time, **moved.stored})


def _heading(path: Path, contents: H5MDContents) -> str:
    first, last = contents.record.step[0], contents.record.step[-1]
    frames = f"{contents.n_frames} frames, steps {first} to {last}, {contents.method}, {contents.system.units.name} units"
    return f"file           {path}: {contents.title}\nread           by MDAnalysis {VERSION}: {frames}"


def liquid(path: str | Path) -> list[str]:
    """Lines about a periodic liquid: the first peak of g(r), and D where there are frames enough and the atoms left their places.

    Atoms have left them if they moved by half the distance of neighbors within the window of the fit. Empty if not periodic.

    Raises
    ------
    As universe.
    """
    contents = read_file(path)
    if not contents.system.cell.pbc.all() or len(contents.system) < 2:
        return []
    peak = _first_peak(*radial_distribution(path))
    lines = [f"g(r)           first peak at {peak:.3g} {contents.system.units.length}"]
    if contents.n_frames >= ENOUGH_FRAMES:
        diffusion = diffusion_coefficient(path)
        moved = float(diffusion.displacements[diffusion.lags <= diffusion.window[1]][-1]) ** 0.5
        if moved > 0.5 * peak * contents.system.units.to_angstrom:
            lines.append(f"diffusion      {diffusion}")
    return lines


def _first_peak(r: NDArray[np.float64], g: NDArray[np.float64]) -> float:
    """Where g is largest within the first stretch that lies above half of the highest peak."""
    above = np.append(g >= 0.5 * g.max(), False)
    first = int(np.argmax(above))
    end = first + int(np.argmin(above[first:]))
    return float(r[first + np.argmax(g[first:end])])
