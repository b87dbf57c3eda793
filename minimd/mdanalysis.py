"""The bridge to MDAnalysis: minimd files as universes, its trajectory formats, its analyses. Only this module imports it.

MDAnalysis holds positions and velocities in float32, in Å and Å/ps, and knows a cell by lengths and angles alone. Reduced numbers
pass unchanged, 1 σ as 1 Å and 1 τ as 1 ps.
"""

import warnings
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from errno import ENOSPC
from math import ceil
from pathlib import Path
from shutil import disk_usage
from typing import TYPE_CHECKING, Any, NamedTuple

import MDAnalysis
import numpy as np
from MDAnalysis.analysis.msd import EinsteinMSD
from MDAnalysis.analysis.rdf import InterRDF
from MDAnalysis.guesser.tables import SYMB2Z
from MDAnalysis.lib.mdamath import triclinic_box, triclinic_vectors
from numpy.typing import NDArray

from minimd.cell import Cell
from minimd.h5md import read_file
from minimd.h5md_layout import has_edges
from minimd.record import Frame
from minimd.stacklevel import outside_minimd
from minimd.units import ASE

if TYPE_CHECKING:
    from minimd.simulation import Simulation

VERSION = MDAnalysis.__version__
FORMATS = {".nc": "NCDF"}  # of suffixes that are not their name
XTC_DECIMALS = 4  # of nm, one more than usual, because σ is written as 0.1 nm
RDF_FRAMES, RDF_DISTANCES = 50, 1e7  # at most, so that g(r) takes half a second
MSD_FRAMES, MSD_ATOMS = 200, 400  # at most
ROOM = 2**18  # B that must stay free beside a frame, for what C libraries buffer
FIT_FROM, FIT_TO = 0.1, 0.5  # of the duration: behind the ballistic start, before few pairs of frames are left
CM2_PER_S = 1e-4  # per Å²/ps


@contextmanager
def _quiet() -> Iterator[None]:
    """Without MDAnalysis' warnings about what minimd files mean not to hold."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        yield


def universe(path: str | Path) -> MDAnalysis.Universe:
    """A minimd file as an MDAnalysis universe: masses, types, names, elements where labels are symbols, bonds, all frames.

    MDAnalysis places a cell with its first vector along x and the second in the xy plane. Where the cell of the file lies
    otherwise, its periodic distances are wrong until positions are turned likewise, as radial_distribution does.

    Raises
    ------
    FileNotFoundError, OSError, ValueError : as minimd.h5md.read_file.
    """
    system = read_file(path).system
    labels = [str(label) for label in system.species]
    with _quiet():
        made = MDAnalysis.Universe.empty(len(system), trajectory=False)
        made.add_TopologyAttr("masses", system.masses)
        made.add_TopologyAttr("types", labels)
        made.add_TopologyAttr("names", labels)
        if any(label in SYMB2Z for label in labels):
            made.add_TopologyAttr("elements", [label if label in SYMB2Z else "" for label in labels])
        if len(system.bonds):
            made.add_TopologyAttr("bonds", [tuple(bond) for bond in system.bonds.tolist()])
        made.load_new(str(path), format="H5MD")
    return made


class MDAnalysisWriter:
    """Frames to .xtc, .dcd, .trr or .ncdf (.nc) through MDAnalysis: float32, positions unwrapped, Å and ps or reduced numbers.

    TRR and NCDF hold velocities; XTC, rounded to 0.001 Å, and DCD do not. A DCD states the time between its frames at
    its beginning, so that it is begun with the second frame.

    Raises
    ------
    OSError : if the file cannot be written.
    """

    def __init__(self, file: Path, simulation: "Simulation") -> None:
        system = simulation.system
        self._file, self._format = Path(file), FORMATS.get(Path(file).suffix.lower(), Path(file).suffix[1:].upper())
        self._angstrom, self._picosecond = system.units.to_angstrom, system.units.to_picosecond
        self._timestep = simulation.method.timestep * self._picosecond
        self._dimensions = _dimensions(system.cell, self._angstrom)
        self._waiting: list[Frame] = []
        self._writer: Any = None
        with _quiet():
            self._universe = MDAnalysis.Universe.empty(len(system), trajectory=True, velocities=True)
        _warn_if_turned(self._file, system.cell)

    def write(self, frame: Frame) -> None:
        """Append one frame."""
        self._waiting.append(frame._replace(positions=frame.positions.copy(), velocities=frame.velocities.copy()))
        if self._format != "DCD" or self._writer is not None or len(self._waiting) > 1:
            self._write_waiting()

    def close(self, completed: bool) -> None:
        """Finish the file, the same whether the run was completed or not; do nothing if it has failed."""
        self._write_waiting()
        self._shut()

    def _write_waiting(self) -> None:
        waiting, self._waiting = self._waiting, []
        for frame in waiting:
            try:
                with _quiet():
                    _check_room(self._file, frame.positions.nbytes + ROOM)
                    self._writer = self._writer or self._opened(waiting)
                    self._place(frame)
                    self._writer.write(self._universe)
            except (OSError, RuntimeError) as error:
                with suppress(OSError, RuntimeError):
                    self._shut()
                reason = getattr(error, "strerror", None) or error
                raise OSError(f"trajectory {str(self._file)!r} could not take the frame of step {frame.step}: {reason}") from error

    def _shut(self) -> None:
        writer, self._writer = self._writer, None
        if writer:
            writer.close()

    def _opened(self, waiting: list[Frame]) -> Any:
        options: dict[str, dict[str, Any]] = {"XTC": {"precision": XTC_DECIMALS}, "NCDF": {"velocities": True}, "DCD": self._spacing(waiting)}
        return MDAnalysis.Writer(str(self._file), n_atoms=len(self._universe.atoms), format=self._format, **options.get(self._format, {}))

    def _spacing(self, waiting: list[Frame]) -> dict[str, Any]:
        """Steps between frames, their time [ps] and the first step."""
        steps = waiting[1].step - waiting[0].step if len(waiting) > 1 else 1
        return {"nsavc": steps, "dt": steps * self._timestep, "istart": waiting[0].step}

    def _place(self, frame: Frame) -> None:
        ts = self._universe.trajectory.ts
        ts.positions = frame.positions * self._angstrom
        ts.velocities = frame.velocities * (self._angstrom / self._picosecond)
        ts.dimensions = self._dimensions
        ts.time, ts.data["step"] = frame.time * self._picosecond, frame.step


def _check_room(file: Path, n_bytes: int) -> None:
    """Raise OSError where a disk has less room [B]: not every format notices that it could not write."""
    if disk_usage(file.absolute().parent).free < n_bytes:
        raise OSError(ENOSPC, "no room on the disk")


def _dimensions(cell: Cell, to_angstrom: float) -> NDArray[np.float32] | None:
    """Lengths and angles of a cell [Å, °], or None where nothing repeats or three independent vectors are missing."""
    return triclinic_box(*(cell.vectors * to_angstrom)) if has_edges(cell) else None


def _warn_if_turned(file: Path, cell: Cell) -> None:
    dimensions = _dimensions(cell, 1.0)
    if dimensions is not None and not np.allclose(triclinic_vectors(dimensions), cell.vectors, atol=1e-4 * abs(cell.vectors).max()):
        warnings.warn(
            f"trajectory {str(file)!r} knows the cell by lengths and angles, as if its first vector lay along x and its second in the "
            "xy plane, which they do not; distances across the boundary will be wrong, write .h5md too",
            stacklevel=outside_minimd(),
        )


class RadialDistribution(NamedTuple):
    """g(r) of all atoms.  r : (B,) [length of the file].  g : (B,) dimensionless."""

    r: NDArray[np.float64]
    g: NDArray[np.float64]


def radial_distribution(path: str | Path, n_bins: int = 200) -> RadialDistribution:
    """g(r) by MDAnalysis' InterRDF, up to half the smallest height of the cell, from evenly chosen frames and atoms.

    Bonded pairs count like all others. Distances are measured from some atoms to all if all would take too long.

    Raises
    ------
    ValueError : if the cell is not periodic in all directions, or there is one atom only.  And as universe.
    """
    system = read_file(path).system
    if not system.cell.pbc.all() or len(system) < 2:
        raise ValueError(f"g(r) needs two atoms and a cell periodic in all directions; {str(path)!r} holds {system!r}")
    r_max = float(system.cell.heights.min() / 2.0) * system.units.to_angstrom
    width = r_max / n_bins
    with _quiet():
        made = universe(path)
        made.trajectory.add_transformations(_turned(system.cell, system.units.to_angstrom))
        stride = ceil(len(made.trajectory) / RDF_FRAMES)
        some = _every(made, RDF_DISTANCES * stride / len(made.trajectory) / len(system))
        # From one bin on, so that no atom is its own neighbor; the others of N atoms are N − 1.
        result = InterRDF(some, made.atoms, nbins=n_bins - 1, range=(width, r_max)).run(step=stride).results
        made.trajectory.close()
    return RadialDistribution(result.bins / system.units.to_angstrom, result.rdf * len(system) / (len(system) - 1))


def _every(made: MDAnalysis.Universe, n_atoms: float) -> MDAnalysis.AtomGroup:
    """About so many atoms, evenly chosen."""
    return made.atoms[:: max(1, ceil(len(made.atoms) / max(1.0, n_atoms)))]


def _turned(cell: Cell, to_angstrom: float) -> Any:
    """Transformation of frames into the reduced lattice as MDAnalysis places it; all periodic distances stay."""
    dimensions = triclinic_box(*(cell.lattice * to_angstrom))
    vectors, inverse = triclinic_vectors(dimensions, dtype=np.float64), cell.inverse / to_angstrom

    def turn(ts: Any) -> Any:
        fractions = ts.positions.astype(np.float64) @ inverse
        ts.positions = (fractions - np.floor(fractions)) @ vectors
        ts.dimensions = dimensions
        return ts

    return turn


@dataclass(frozen=True)
class Diffusion:
    """Self-diffusion by Einstein's relation ⟨|r(t) − r(0)|²⟩ → 6 D t. str() is the sentence for people.

    Attributes
    ----------
    coefficient : D [Å²/ps, or σ²/τ].  cm2_per_s : the same in cm²/s, None in reduced units.
    window : lags of the straight-line fit [ps or τ].  lags, displacements : (T,) [ps or τ], (T,) mean squares [Å² or σ²].
    """

    coefficient: float
    cm2_per_s: float | None
    window: tuple[float, float]
    lags: NDArray[np.float64]
    displacements: NDArray[np.float64]

    def __str__(self) -> str:
        unit, time = ("σ²/τ", "τ") if self.cm2_per_s is None else ("Å²/ps", "ps")
        absolute = "" if self.cm2_per_s is None else f" = {self.cm2_per_s:.4g} cm²/s"
        return f"D = {self.coefficient:.4g} {unit}{absolute}, from lags of {self.window[0]:.4g} to {self.window[1]:.4g} {time}"


def mean_square_displacement(path: str | Path) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Lags [ps, or τ], (T,), and ⟨|r(t₀ + lag) − r(t₀)|²⟩ [Å², or σ²], (T,), by MDAnalysis' EinsteinMSD.

    Frames and atoms are evenly chosen where there are many.

    Raises
    ------
    ValueError : if there is one frame only.  And as universe.
    """
    with _quiet():
        made = universe(path)
        if len(made.trajectory) < 2:
            raise ValueError(f"a displacement needs at least 2 frames; {str(path)!r} holds {len(made.trajectory)}")
        result = EinsteinMSD(_every(made, MSD_ATOMS), fft=False).run(step=ceil(len(made.trajectory) / MSD_FRAMES)).results
        made.trajectory.close()
    return np.asarray(result.delta_t_values, dtype=np.float64), np.asarray(result.timeseries)


def diffusion_coefficient(path: str | Path, window: tuple[float, float] | None = None) -> Diffusion:
    """D from the mean-square displacement, a straight line fitted within a window of lags.

    window : [ps, or τ]; from a tenth to half of the duration if not given.

    Raises
    ------
    ValueError : if the window holds fewer than three lags.  And as mean_square_displacement.
    """
    lags, squares = mean_square_displacement(path)
    start, end = window or (FIT_FROM * lags[-1], FIT_TO * lags[-1])
    chosen = (lags >= start) & (lags <= end)
    if chosen.sum() < 3:
        raise ValueError(f"the window of the fit must hold at least 3 lags; ({start:.4g}, {end:.4g}) holds {chosen.sum()} of {len(lags)}")
    coefficient = float(np.polyfit(lags[chosen], squares[chosen], 1)[0]) / 6.0
    absolute = coefficient * CM2_PER_S if read_file(path).system.units is ASE else None
    return Diffusion(coefficient, absolute, (float(start), float(end)), lags, squares)
