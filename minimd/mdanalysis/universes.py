"""Runs as universes of MDAnalysis, and its analyses.

MDAnalysis holds positions and velocities in float32, in Å and Å/ps, and a cell as lengths and angles only. Numbers in
reduced units are not converted: 1 σ becomes 1 Å and 1 τ becomes 1 ps.
"""

import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from math import ceil
from pathlib import Path
from typing import NamedTuple, TypeVar

import MDAnalysis
import numpy as np
from MDAnalysis.analysis.msd import EinsteinMSD
from MDAnalysis.analysis.rdf import InterRDF
from MDAnalysis.guesser.tables import SYMB2Z
from numpy.typing import NDArray
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from minimd.console.display import Displayed, Rows
from minimd.console.quiet import outside_minimd, quiet
from minimd.files.h5md_reader import H5MDContents, damage_told, read_file
from minimd.files.h5md_schema import has_edges
from minimd.files.turned_cell import Turn, turn_of
from minimd.mdanalysis.readers import Frames, RecordedReader, RunReader
from minimd.observers.motion import finite_size_correction, is_cubic
from minimd.simulation.simulation import Simulation
from minimd.structure.cell import Cell
from minimd.structure.constraints import DistanceConstraints
from minimd.structure.observables import center
from minimd.structure.statistics import FEW, with_error
from minimd.structure.system import System
from minimd.structure.units import ASE

__all__ = ["Diffusion", "Frames", "RadialDistribution", "RunUniverse", "Turn", "diffusion_coefficient",
           "mean_square_displacement", "radial_distribution", "universe"]  # fmt: skip

U = TypeVar("U", bound=MDAnalysis.Universe)
MOLECULE = "MOL"  # resname of a molecule without a formula
MOST_COUNTS = 10**7  # of molecules times species


def bare_universe(kind: type[U], system: System) -> U:
    """A universe without a trajectory: masses, types, names, elements if labels are symbols, bonds, angles, dihedrals;
    each molecule is a residue.

    kind : its class.  Residues are numbered from 1, in the order of their first atoms;
        their names are chemical formulas, or "MOL".
    """
    labels, of_atoms = [str(label) for label in system.species], molecules(system)
    n_molecules = int(of_atoms.max()) + 1
    made = kind.empty(
        len(system),
        n_residues=n_molecules,
        atom_resindex=of_atoms,
        residue_segindex=np.zeros(n_molecules, int),
        trajectory=False,
    )
    made.add_TopologyAttr("masses", system.masses)
    made.add_TopologyAttr("types", labels)
    made.add_TopologyAttr("names", labels)
    if any(label in SYMB2Z for label in labels):
        made.add_TopologyAttr("elements", [label if label in SYMB2Z else "" for label in labels])
    made.add_TopologyAttr("resids", np.arange(1, n_molecules + 1))
    made.add_TopologyAttr("resnames", _formulas(system, of_atoms))
    made.add_TopologyAttr("segids", ["SYSTEM"])
    for name, groups in system.groups().items():
        if len(groups):
            made.add_TopologyAttr(name, [tuple(group) for group in groups.tolist()])
    return made


def molecules(system: System) -> NDArray[np.int64]:
    """(N,) number of the molecule of each atom, from 0;
    bonds and lengths held fixed connect the atoms of a molecule."""
    held = [one.pairs for one in system.constraints if isinstance(one, DistanceConstraints)]
    i, j = np.concatenate([system.bonds, *held]).T
    numbers = connected_components(
        coo_array((np.ones(len(i), bool), (i, j)), shape=(len(system), len(system))), directed=False
    )[1]
    _, first, inverse = np.unique(numbers, return_index=True, return_inverse=True)
    order = np.empty(len(first), np.int64)
    order[np.argsort(first)] = np.arange(len(first))
    return order[inverse]


def _formulas(system: System, of_atoms: NDArray[np.int64]) -> list[str]:
    """Name of each molecule."""
    names = [str(name) for name in system.species_names]
    n_molecules = int(of_atoms.max()) + 1
    if n_molecules * len(names) > MOST_COUNTS:
        return [MOLECULE] * n_molecules
    counts = np.zeros((n_molecules, len(names)), np.int64)
    np.add.at(counts, (of_atoms, system.species_index), 1)
    kinds, which = np.unique(counts, axis=0, return_inverse=True)
    formulas = [_formula(dict(zip(names, row.tolist(), strict=True))) for row in kinds]
    return [formulas[kind] for kind in which.ravel().tolist()]


def _formula(counts: dict[str, int]) -> str:
    """The formula in Hill's order: carbon, hydrogen, then the others by name; without carbon all elements,
    also hydrogen, by name."""
    present = {name: n for name, n in counts.items() if n}
    if len(present) == 1 and sum(present.values()) == 1:
        return next(iter(present))
    if not all(name in SYMB2Z for name in present):
        return MOLECULE
    first = ("C", "H") if "C" in present else ()
    ordered = sorted(present, key=lambda name: (first.index(name) if name in first else len(first), name))
    return "".join(name + (str(present[name]) if present[name] > 1 else "") for name in ordered)


Array = NDArray[np.float64]
VERSION = MDAnalysis.__version__
RDF_FRAMES, RDF_DISTANCES = 50, 1e7  # at most, so that g(r) takes half a second
MSD_FRAMES, MSD_ATOMS = 200, 400  # at most
FIT_FROM, FIT_TO = 0.1, 0.5  # of the duration: after the ballistic start, and before there are too few pairs of frames
UNEVEN = 1e-6  # largest relative difference between equal spacings of frames, whose times are rounded
CM2_PER_S = 1e-4  # per Å²/ps


class RunUniverse(MDAnalysis.Universe):
    """The universe of a run.  system : System.  contents : of its file, apart from frames;
    a universe in memory has none."""

    system: System
    conserves_momentum: bool  # whether the run did
    contents: H5MDContents


Run = str | Path | Simulation | Frames | RunUniverse


def universe(run: str | Path | Simulation | Frames, contents: H5MDContents | None = None) -> RunUniverse:
    """A minimd file as an MDAnalysis universe: masses, types, names, elements if labels are symbols, bonds, angles,
    dihedrals, residues.







    Each molecule is a residue: the atoms that bonds or fixed lengths connect. Observables are in ts.data.

    MDAnalysis places a cell with a along x and b in the xy plane. If the cell of the run has another orientation,
    positions, velocities and forces are turned with it, and a warning says so: r @ R, where R is ts.data["rotation"],
    and r @ R.T turns back. ts.data and the system are not turned. See Turn.

    run : a file; or, in memory, a simulation in its present state, or the Frames of a run.
    contents : of the file, if they have been read.

    Warns if frames are not evenly spaced, because MDAnalysis' dt is a single number.

    Raises
    ------
    FileNotFoundError, OSError, ValueError : as minimd.files.h5md_reader.read_file.  ValueError :
        for Frames that are empty.
    """
    if isinstance(run, Simulation):
        frames = Frames()
        frames(run)
        return _in_memory(frames, run.method.timestep * run.system.units.to_picosecond)
    if isinstance(run, Frames):
        return _in_memory(run)
    contents = contents or read_file(run)
    system = contents.system
    turn = turn_of(system.cell, system.units.to_angstrom)
    _tell_cell(f"the universe of {str(run)!r}", system.cell, turn)
    spacing = _spacing(
        f"the frames of {str(run)!r}", contents.record.step, contents.record.time * system.units.to_picosecond
    )
    with quiet():
        made = bare_universe(RunUniverse, system)
        made.contents, made.system, made.conserves_momentum = contents, system, contents.conserves_momentum
        with damage_told(run):
            made.trajectory = RunReader(
                str(run), turn=turn, n_atoms=len(system), **({} if spacing is None else {"dt": spacing})
            )
    return made


def _in_memory(frames: Frames, timestep: float = 1.0) -> RunUniverse:
    """The universe of frames in memory.  timestep : used as the time between frames if there is only one frame [ps,
    or τ]."""
    if frames.system is None:
        raise ValueError("these Frames are empty; pass them to a run as observers=[frames]")
    _tell_cell("the universe in memory", frames.system.cell, frames.turn)
    spacing = _spacing("the frames in memory", frames.series("step"), frames.series("time")) or timestep
    with quiet():
        made = bare_universe(RunUniverse, frames.system)
        made.system, made.conserves_momentum = frames.system, frames.conserves_momentum
        made.trajectory = RecordedReader(**frames.reader_arguments(spacing))
    return made


def _tell_cell(what: str, cell: Cell, turn: Turn | None) -> None:
    """Warn of a cell that is turned for MDAnalysis, or that MDAnalysis cannot hold."""
    if turn is not None:
        warnings.warn(turn.in_words(what, ": R is ts.data['rotation']"), stacklevel=outside_minimd())
    if cell.is_periodic and not has_edges(cell):
        warnings.warn(
            f"{what} has no cell, because MDAnalysis needs three vectors and this cell has fewer: distances are not "
            "those of nearest images; "
            "give the open direction a length into which all atoms fit, with pbc, as in cell=[20, 20, 50], pbc=(True, "
            "True, False)",
            stacklevel=outside_minimd(),
        )


def _spacing(what: str, steps: NDArray[np.int64], times: Array) -> float | None:
    """dt [ps] for MDAnalysis, which has a single spacing of frames: the median, with a warning if spacings differ;
    None for one frame."""
    spacings = np.diff(times)
    if not len(spacings):
        return None
    spacing = float(np.median(spacings))
    if np.ptp(spacings) > UNEVEN * spacing:
        least, most = np.diff(steps)[[spacings.argmin(), spacings.argmax()]]
        apart = f"{least} to {most} steps apart"
        if least == most:
            apart = f"{spacings.min():.4g} to {spacings.max():.4g} apart in time, because the time step changed"
        warnings.warn(
            f"{what} are {apart}, so trajectory.dt and totaltime are not right for all of them; use the time of each "
            "frame, ts.time",
            stacklevel=outside_minimd(),
        )
    return spacing


@contextmanager
def universe_of(run: Run) -> Iterator[RunUniverse]:
    """The universe of a run; if run is a universe, it stays open, else the universe is closed at the end.
    Raises as universe."""
    with quiet():  # the analyses here use the time of each frame
        made = run if isinstance(run, RunUniverse) else universe(run)
    try:
        yield made
    finally:
        if made is not run:
            made.trajectory.close()


class RadialDistribution(NamedTuple):
    """g(r) of all atoms.  r : (B,) [length of the file].  g : (B,) dimensionless."""

    r: Array
    g: Array

    def __repr__(self) -> str:
        k = int(np.argmax(self.g))
        return (
            f"RadialDistribution({len(self.r)} distances from {self.r[0]:.4g} to {self.r[-1]:.4g}; highest at "
            f"{self.r[k]:.4g}, {self.g[k]:.4g})"
        )


def radial_distribution(run: Run, n_bins: int = 200) -> RadialDistribution:
    """g(r) by MDAnalysis' InterRDF, up to half the smallest height of the cell, from evenly chosen frames and atoms.

    Bonded pairs count like all others. If distances between all atoms would take too long,
    they are measured from some atoms to all atoms.
    run : an argument of universe, or a universe.

    Raises
    ------
    ValueError : if the cell is not periodic in all directions, or there is only one atom.  Others as universe.
    """
    with universe_of(run) as made, quiet():
        system = made.system
        if not system.cell.pbc.all() or len(system) < 2:
            raise ValueError(
                f"g(r) needs at least two atoms, and a cell that is periodic in all directions; {_name(made)} holds "
                f"{system!r}"
            )
        r_max = float(system.cell.heights.min() / 2.0) * system.units.to_angstrom
        stride = ceil(len(made.trajectory) / RDF_FRAMES)
        some = _every(made, RDF_DISTANCES * stride / len(made.trajectory) / len(system))
        # The range begins after the first bin, so that no atom is its own neighbor; each atom has N − 1 others.
        result = InterRDF(some, made.atoms, nbins=n_bins - 1, range=(r_max / n_bins, r_max)).run(step=stride).results
    return RadialDistribution(result.bins / system.units.to_angstrom, result.rdf * len(system) / (len(system) - 1))


def _every(made: MDAnalysis.Universe, n_atoms: float) -> MDAnalysis.AtomGroup:
    """About n_atoms atoms, evenly chosen."""
    return made.atoms[:: max(1, ceil(len(made.atoms) / max(1.0, n_atoms)))]


def _name(made: RunUniverse) -> str:
    return repr(made.trajectory.filename) if hasattr(made, "contents") else "this run"


@dataclass(frozen=True)
class Diffusion(Displayed):
    """Self-diffusion by Einstein's relation ⟨|r(t) − r(0)|²⟩ → 6 D t. str() is one line about it.

    Attributes
    ----------
    coefficient : D in this cell [Å²/ps, or σ²/τ].  cm2_per_s : the same in cm²/s, None in reduced units.
    error : standard error of D, from the scatter of the slopes of the atoms; NaN for fewer than 4 atoms.
    infinite : D in an infinite system, by the correction of Yeh and Hummer; None if no viscosity was given.
    window : lags of the straight-line fit [ps or τ].  lags, displacements : (T,) [ps or τ], (T,)
        mean squares [Å² or σ²].
    """

    coefficient: float
    cm2_per_s: float | None
    window: tuple[float, float]
    lags: Array
    displacements: Array
    error: float = np.nan
    infinite: float | None = None

    def display_rows(self) -> Rows:
        """See Displayed."""
        unit, time = ("σ²/τ", "τ") if self.cm2_per_s is None else ("Å²/ps", "ps")
        size = "in a larger cell D is larger: viscosity= corrects for this"
        if self.infinite is not None:
            size = f"D = {with_error(self.infinite, self.error)} {unit} in an infinite system, by Yeh and Hummer"
        return [("diffusion", str(self)), ("", size), ("lags", f"{len(self.lags)}, up to {self.lags[-1]:.4g} {time}")]

    def __repr__(self) -> str:
        return f"Diffusion({self})"

    def __str__(self) -> str:
        unit, time = ("σ²/τ", "τ") if self.cm2_per_s is None else ("Å²/ps", "ps")
        absolute = "" if self.cm2_per_s is None else f" = {self.cm2_per_s:.4g} cm²/s"
        return (
            f"D = {with_error(self.coefficient, self.error)} {unit}{absolute}, from lags of {self.window[0]:.4g} to "
            f"{self.window[1]:.4g} {time}"
        )


def mean_square_displacement(run: Run) -> tuple[Array, Array]:
    """Lags [ps, or τ], (T,), and ⟨|r(t₀ + lag) − r(t₀)|²⟩ [Å², or σ²], (T,), by MDAnalysis' EinsteinMSD.

    They are relative to the center of mass of all atoms if the run conserved the momentum, as its file tells.
    If there are many frames or atoms, some of them are used, evenly chosen.  run : an argument of universe,
    or a universe.

    Raises
    ------
    ValueError : if there is only one frame.  Others as universe.
    """
    lags, of_atoms = _displacements(run)
    return lags, of_atoms.mean(axis=1)


def _displacements(run: Run) -> tuple[Array, Array]:
    """Lags, (T,), and mean squares of each of n atoms, (T, n); see mean_square_displacement."""
    with universe_of(run) as made, quiet():
        if len(made.trajectory) < 2:
            raise ValueError(f"a displacement needs at least 2 frames; {_name(made)} holds {len(made.trajectory)}")
        some, rows, positions = _every(made, MSD_ATOMS), [], []
        for ts in made.trajectory[:: ceil(len(made.trajectory) / MSD_FRAMES)]:
            rows.append({"time": ts.time})
            whole = np.asarray(ts.positions, dtype=np.float64)
            positions.append(whole[some.ix] - center(whole, made.system.masses, made.conserves_momentum))
        relative = MDAnalysis.Universe.empty(len(some))
        relative.trajectory = RecordedReader(np.array(positions), rows)
        apart = np.diff([row["time"] for row in rows])
        result = EinsteinMSD(relative.atoms, fft=False, non_linear=not np.allclose(apart, apart[0])).run().results
    return np.asarray(result.delta_t_values, dtype=np.float64), np.asarray(result.msds_by_particle)


def diffusion_coefficient(
    run: Run, window: tuple[float, float] | None = None, viscosity: float | None = None
) -> Diffusion:
    """D from the mean-square displacement, by a straight line fitted within a window of lags, with its standard error.

    The error is that of the mean over atoms, which move almost independently of each other.

    run : an argument of universe, or a universe.  window : [ps, or τ];
        from a tenth to half of the duration if not given.
    viscosity : η [energy time/length³], for the correction of Yeh and Hummer for the size of a cubic cell;
        see observers.motion.

    Raises
    ------
    ValueError : if the window holds fewer than three lags; if a viscosity is given, and the cell is not cubic or the
        run is in memory. Others as mean_square_displacement.
    """
    with universe_of(run) as made:
        (lags, of_atoms), units = _displacements(made), made.system.units
        squares, added = of_atoms.mean(axis=1), None if viscosity is None else _correction(made, viscosity)
    start, end = window or (FIT_FROM * lags[-1], FIT_TO * lags[-1])
    chosen = (lags >= start) & (lags <= end)
    if chosen.sum() < 3:
        raise ValueError(
            f"the window of the fit must hold at least 3 lags; ({start:.4g}, {end:.4g}) holds {chosen.sum()} of "
            f"{len(lags)}"
        )
    coefficient = float(np.polyfit(lags[chosen], squares[chosen], 1)[0]) / 6.0
    each = np.polyfit(lags[chosen], of_atoms[chosen], 1)[0] / 6.0
    error = float(each.std(ddof=1) / np.sqrt(len(each))) if len(each) >= FEW else np.nan
    infinite, absolute = (
        None if added is None else coefficient + added,
        coefficient * CM2_PER_S if units is ASE else None,
    )
    return Diffusion(coefficient, absolute, (float(start), float(end)), lags, squares, error, infinite)


def _correction(made: RunUniverse, viscosity: float) -> float:
    """The correction of D for the finite size of the cell [Å²/ps, or σ²/τ]."""
    cell, units = made.system.cell, made.system.units
    if not is_cubic(cell) or not hasattr(made, "contents"):
        raise ValueError(
            "the correction of Yeh and Hummer needs the file of a run in a cubic cell that is periodic in all "
            "directions; leave viscosity out"
        )
    thermal_energy = units.k_B * float(made.contents.record.temperature.mean())
    added = finite_size_correction(thermal_energy, viscosity, float(np.linalg.norm(cell.vectors[0])))
    return added * units.to_angstrom**2 / units.to_picosecond
