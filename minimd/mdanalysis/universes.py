"""Runs as universes of MDAnalysis, and its analyses.

MDAnalysis holds positions and velocities in float32, in Å and Å/ps, and a cell as lengths and angles only. Numbers in
reduced units are not converted: 1 σ becomes 1 Å and 1 τ becomes 1 ps.
"""

from collections.abc import Iterator
from contextlib import contextmanager, nullcontext
from dataclasses import dataclass
from functools import partial
from math import ceil
from pathlib import Path
from typing import Any, NamedTuple

import MDAnalysis
import numpy as np
from MDAnalysis.analysis.msd import EinsteinMSD
from MDAnalysis.analysis.rdf import InterRDF
from MDAnalysis.coordinates.H5MD import H5MDReader
from MDAnalysis.coordinates.memory import MemoryReader
from MDAnalysis.guesser.tables import SYMB2Z
from MDAnalysis.lib.util import store_init_arguments
from numpy.typing import NDArray
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from minimd.core.console.display import Displayed, Rows
from minimd.core.console.quiet import quiet, warn
from minimd.core.files.h5md_reader import H5MDContents, admitted, damage_told, read_file
from minimd.core.files.h5md_schema import has_edges
from minimd.core.files.turned_cell import ROTATION, Turn, cell_dimensions, turn_of
from minimd.core.simulation.simulation import Simulation
from minimd.core.structure.constraints import DistanceConstraints
from minimd.core.structure.observables import Array, center
from minimd.core.structure.statistics import FEW, with_error
from minimd.core.structure.system import System
from minimd.core.structure.units import ASE
from minimd.observers.motion import finite_size_correction, is_cubic, per_ps_in_words, with_its_error
from minimd.observers.viscosity import ViscosityResult

__all__ = ["Diffusion", "Frames", "RadialDistribution", "RunUniverse", "Turn", "diffusion_coefficient",
           "mean_square_displacement", "radial_distribution", "universe"]  # fmt: skip

VERSION = MDAnalysis.__version__
MOLECULE = "MOL"  # resname of a molecule without a formula
MOST_COUNTS = 10**7  # of molecules times species
RDF_FRAMES, RDF_DISTANCES = 50, 1e7  # at most, so that g(r) takes half a second
MSD_FRAMES, MSD_ATOMS = 200, 400  # at most
FIT_FROM, FIT_TO = 0.1, 0.5  # of the duration: after the ballistic start, and before there are too few pairs of frames
UNEVEN = 1e-6  # largest relative difference between equal spacings of frames, whose times are rounded
CM2_PER_S = 1e-4  # per Å²/ps


class Frames:
    """An observer that keeps frames in memory, for universe().

        frames = Frames()
        sim.run(1000, every=10, observers=[frames])
        u = universe(frames)

    Positions and velocities are kept in float32, as MDAnalysis uses them, observables in float64: 24 bytes for each
    atom and frame. A step that is observed twice, at the end of a run and at the start of the next, is kept once.

    Attributes
    ----------
    system : System, a copy made with the first frame; None before.
    conserves_momentum : whether the simulation does.
    turn : Turn of a cell in an orientation that MDAnalysis does not hold; positions and velocities are kept turned.
        Else None.
    """

    def __init__(self) -> None:
        self.system: System | None = None
        self.turn: Turn | None = None
        self.conserves_momentum = False
        self._rows: list[dict[str, Any]] = []
        self._moving: list[tuple[NDArray[np.float32], ...]] = []

    def __repr__(self) -> str:
        return f"Frames({len(self)} frames of {'no' if self.system is None else len(self.system)} atoms)"

    def __len__(self) -> int:
        return len(self._rows)

    def __call__(self, simulation: Simulation) -> None:
        """Keep the present state.  Raises ValueError for another number of atoms than before."""
        system, units, frame = simulation.system, simulation.system.units, simulation.frame()
        if self.system is None:
            self.system, self.turn = system.copy(), turn_of(system.cell, units.to_angstrom)
            self.conserves_momentum = simulation.conserves_momentum
        if len(system) != len(self.system):
            ours = f"Frames keeps frames of one simulation, of {len(self.system)} atoms"
            raise ValueError(f"{ours}; this simulation has {len(system)}")
        if self._rows and self._rows[-1]["step"] == frame.step:
            return
        row = {"step": frame.step, "time": frame.time * units.to_picosecond, **frame.observables}
        positions = frame.positions * units.to_angstrom
        velocities = frame.velocities * (units.to_angstrom / units.to_picosecond)
        box = cell_dimensions(system.cell, units.to_angstrom)
        if self.turn is not None:
            row[ROTATION], box = self.turn.of(system.cell.vectors)
            positions, velocities = positions @ row[ROTATION], velocities @ row[ROTATION]
        self._rows.append(row)
        moving = positions, velocities, np.zeros(6) if box is None else box
        self._moving.append(tuple(np.asarray(one, dtype=np.float32) for one in moving))

    def series(self, name: str) -> NDArray[Any]:
        """(T, ...) an observable, "step", or "time" [ps, or τ], of all frames."""
        return np.array([row[name] for row in self._rows])

    def reader_arguments(self, dt: float) -> dict[str, Any]:
        """Arguments for RecordedReader.  dt : time between frames [ps, or τ]."""
        names = "coordinate_array", "velocities", "dimensions"
        arrays = (np.stack(one) for one in zip(*self._moving, strict=True))
        return dict(zip(names, arrays, strict=True)) | {"dt": dt, "rows": self._rows}


class RecordedReader(MemoryReader):
    """MDAnalysis' reader of arrays, with the recorded times and observables.  rows : for each frame the entries of
    ts.data, with its time."""

    def __init__(self, coordinate_array: NDArray, rows: list[dict[str, Any]] | None = None, **options: Any) -> None:
        self._recorded = rows
        super().__init__(coordinate_array, order="fac", **options)

    def _read_next_timestep(self, ts: Any = None) -> Any:
        ts = super()._read_next_timestep(ts)
        if self._recorded is not None:
            ts.data.update(self._recorded[ts.frame])
        return ts


class RunReader(H5MDReader):
    """Frames of a minimd file.  turn : of its cell, or None; a transformation, but one that is not the user's, who can
    set transformations only once."""

    @store_init_arguments
    def __init__(self, filename: str, turn: Turn | None = None, **kwargs: Any) -> None:
        self._turn = turn
        super().__init__(filename, **kwargs)

    def open_trajectory(self) -> None:
        """Called by MDAnalysis, which opens the file itself; see admitted."""
        super().open_trajectory()
        admitted(self._file, self.filename)

    def _read_frame(self, frame: int) -> Any:
        ts = super()._read_frame(frame)
        return ts if self._turn is None else self._turn(ts)


class RunUniverse(MDAnalysis.Universe):
    """The universe of a run.  system : System.  contents : of its file, apart from frames; a universe in memory has
    none."""

    system: System
    conserves_momentum: bool  # whether the run did
    contents: H5MDContents


Run = str | Path | Simulation | Frames | RunUniverse


def universe(run: str | Path | Simulation | Frames, contents: H5MDContents | None = None) -> RunUniverse:
    """A minimd file as an MDAnalysis universe: masses, charges, types, names, elements if labels are symbols, bonds,
    angles, dihedrals, residues.

    Each molecule is a residue: the atoms that bonds or fixed lengths connect. Observables are in ts.data.

    MDAnalysis places a cell with a along x and b in the xy plane. If the cell of the run has another orientation,
    positions, velocities and forces are turned with it, and a warning says so: r @ R, where R is ts.data["rotation"],
    and r @ R.T turns back. ts.data and the system are not turned. See Turn.

    run : a file; or, in memory, a simulation in its present state, or the Frames of a run.
    contents : of the file, if they have been read.

    Warns if frames are not evenly spaced, because MDAnalysis' dt is a single number.

    Raises
    ------
    FileNotFoundError, OSError, ValueError : as read_file.  ValueError : for Frames that are
        empty.
    """
    if isinstance(run, str | Path):
        told: Any = contents or read_file(run)
        name, times, spacing = f"of {str(run)!r}", told.record.time * told.system.units.to_picosecond, {}
        reader: Any = partial(RunReader, str(run), n_atoms=len(told.system))
        steps = told.record.step
    else:
        told, spacing = run if isinstance(run, Frames) else Frames(), {"dt": 1.0}
        if isinstance(run, Simulation):
            told(run)
            spacing = {"dt": run.method.timestep * run.system.units.to_picosecond}
        if told.system is None:
            raise ValueError("these Frames are empty; pass them to a run as observers=[frames]")
        name, steps, times = "in memory", told.series("step"), told.series("time")
        reader = lambda turn, dt: RecordedReader(**told.reader_arguments(dt))  # noqa: E731 - the frames are turned
    turn = turn_of(told.system.cell, told.system.units.to_angstrom)
    if turn is not None:
        words = turn.in_words(f"the universe {name}", ": R is ts.data['rotation']")
        warn(words)
    if told.system.cell.is_periodic and not has_edges(told.system.cell):
        words = (
            f"the universe {name} has no cell, because MDAnalysis needs three vectors and this cell has fewer: "
            "distances are not those of nearest images; give the open direction a length into which all atoms fit, "
            "with pbc, as in cell=[20, 20, 50], pbc=(True, True, False)"
        )
        warn(words)
    if len(times) > 1:
        spacing = {"dt": _spacing(name, steps, times)}
    with quiet(), damage_told(run) if isinstance(run, str | Path) else nullcontext():
        made = _with_topology(told.system)
        made.system, made.conserves_momentum = told.system, told.conserves_momentum
        if isinstance(told, H5MDContents):
            made.contents = told
        made.trajectory = reader(turn=turn, **spacing)
    return made


def _spacing(name: str, steps: NDArray[np.int64], times: Array) -> float:
    """dt [ps] for MDAnalysis, which has a single spacing of frames: the median, with a warning if spacings differ."""
    spacings = np.diff(times)
    median = float(np.median(spacings))
    if np.ptp(spacings) > UNEVEN * median:
        least, most = np.diff(steps)[[spacings.argmin(), spacings.argmax()]]
        apart = f"{least} to {most} steps apart"
        if least == most:
            apart = f"{spacings.min():.4g} to {spacings.max():.4g} apart in time, because the time step changed"
        advice = "trajectory.dt and totaltime are not right for all of them; use the time of each frame, ts.time"
        warn(f"the frames {name} are {apart}, so {advice}")
    return median


def _with_topology(system: System) -> RunUniverse:
    """A universe without a trajectory. Residues are molecules, numbered from 1 in the order of their first atoms;
    bonds and lengths held fixed connect the atoms of a molecule."""
    held = [one.pairs for one in system.constraints if isinstance(one, DistanceConstraints)]
    i, j = np.concatenate([system.bonds, *held]).T
    bonded = coo_array((np.ones(len(i), bool), (i, j)), shape=(len(system), len(system)))
    parts = np.unique(connected_components(bonded, directed=False)[1], return_index=True, return_inverse=True)
    of_atoms, n_molecules = parts[1].argsort().argsort()[parts[2]], len(parts[0])
    labels, segments = [str(label) for label in system.species], np.zeros(n_molecules, int)
    topology = {"masses": system.masses, "types": labels, "names": labels, "resids": np.arange(1, n_molecules + 1)}
    topology |= {"resnames": _formulas(system, of_atoms, n_molecules), "segids": ["SYSTEM"]}
    known = {"elements": [label if label in SYMB2Z else "" for label in labels], "charges": system.charges.tolist()}
    topology |= {name: values for name, values in known.items() if any(values)}
    topology |= {name: [tuple(row) for row in rows.tolist()] for name, rows in system.groups().items() if len(rows)}
    made = RunUniverse.empty(len(system), n_molecules, atom_resindex=of_atoms, residue_segindex=segments)
    for name, values in topology.items():
        made.add_TopologyAttr(name, values)
    return made


def _formulas(system: System, of_atoms: NDArray[np.int64], n_molecules: int) -> list[str]:
    """The formula of each molecule in Hill's order: carbon, hydrogen, then the others by name; without carbon all
    elements by name. A single atom is called by its name, and what has no formula "MOL"."""
    names = [str(name) for name in system.species_names]
    if n_molecules * len(names) > MOST_COUNTS:
        return [MOLECULE] * n_molecules
    ones = np.ones(len(system), np.int64)
    counts = coo_array((ones, (of_atoms, system.species_index)), shape=(n_molecules, len(names))).toarray()
    kinds, which = np.unique(counts, axis=0, return_inverse=True)
    formulas = []
    for row in kinds.tolist():
        present = {name: n for name, n in zip(names, row, strict=True) if n}
        first = ("C", "H") if "C" in present else ()
        ordered = sorted(present, key=lambda name: (name not in first, name))
        has_formula = sum(row) == 1 or present.keys() <= SYMB2Z.keys()
        formula = "".join(name if present[name] == 1 else f"{name}{present[name]}" for name in ordered)
        formulas.append(formula if has_formula else MOLECULE)
    return [formulas[kind] for kind in which.ravel().tolist()]


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
        found = f"{len(self.r)} distances from {self.r[0]:.4g} to {self.r[-1]:.4g}"
        return f"RadialDistribution({found}; highest at {self.r[k]:.4g}, {self.g[k]:.4g})"


def radial_distribution(run: Run, n_bins: int = 200) -> RadialDistribution:
    """g(r) by MDAnalysis' InterRDF, up to half the smallest height of the cell, from evenly chosen frames and atoms.

    Bonded pairs count like all others. If distances between all atoms would take too long, they are measured from some
    atoms to all atoms.  run : an argument of universe, or a universe.

    Raises
    ------
    ValueError : if the cell is not periodic in all directions, or there is only one atom.  Others as universe.
    """
    with universe_of(run) as made, quiet():
        system, n_frames = made.system, len(made.trajectory)
        if not system.cell.pbc.all() or len(system) < 2:
            needs = "g(r) needs at least two atoms, and a cell that is periodic in all directions"
            raise ValueError(f"{needs}; {_name(made)} holds {system!r}")
        r_max = float(system.cell.heights.min() / 2.0) * system.units.to_angstrom
        stride = ceil(n_frames / RDF_FRAMES)
        some = _every(made, RDF_DISTANCES * stride / n_frames / len(system))
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
    infinite, infinite_error : D in an infinite system, by the correction of Yeh and Hummer; None if no viscosity was
        given.
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
    infinite_error: float = np.nan

    @property
    def _time(self) -> str:
        return "τ" if self.cm2_per_s is None else "ps"

    def _told(self, value: float, error: float) -> str:
        return f"{with_error(value, error)} σ²/τ" if self.cm2_per_s is None else per_ps_in_words(value, error)

    def display_rows(self) -> Rows:
        """See Displayed."""
        rows = [("diffusion", str(self)), ("lags", f"{len(self.lags)}, up to {self.lags[-1]:.4g} {self._time}")]
        larger = ("", "in a larger cell D is larger: viscosity= corrects for this")
        return rows if self.infinite is not None else [*rows, larger]

    def __repr__(self) -> str:
        return f"Diffusion({self})"

    def __str__(self) -> str:
        time, (start, end) = self._time, self.window
        found = f"D = {self._told(self.coefficient, self.error)}, from lags of {start:.4g} to {end:.4g} {time}"
        if self.infinite is None:
            return found
        return f"{found}; {self._told(self.infinite, self.infinite_error)} in an infinite system (Yeh and Hummer)"


def mean_square_displacement(run: Run) -> tuple[Array, Array]:
    """Lags [ps, or τ], (T,), and ⟨|r(t₀ + lag) − r(t₀)|²⟩ [Å², or σ²], (T,), by MDAnalysis' EinsteinMSD.

    They are relative to the center of mass of all atoms if the run conserved the momentum, as its file tells. If there
    are many frames or atoms, some of them are used, evenly chosen.  run : an argument of universe, or a universe.

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
    run: Run, window: tuple[float, float] | None = None, viscosity: float | ViscosityResult | None = None
) -> Diffusion:
    """D from the mean-square displacement, by a straight line fitted within a window of lags, with its standard error.

    The error is that of the mean over atoms, which move almost independently of each other.

    run : an argument of universe, or a universe.
    window : [ps, or τ]; from a tenth to half of the duration if not given.
    viscosity : η [energy time/length³], or the result of md.observers.Viscosity, whose error then counts, for the
        correction of Yeh and Hummer for the size of a cubic cell; see observers.motion.

    Raises
    ------
    ValueError : if the window holds fewer than three lags; if a viscosity is given, and the cell is not cubic or the
        run is in memory. Others as mean_square_displacement.
    """
    with universe_of(run) as made:
        (lags, of_atoms), cell, units = _displacements(made), made.system.cell, made.system.units
    squares, (start, end) = of_atoms.mean(axis=1), window or (FIT_FROM * lags[-1], FIT_TO * lags[-1])
    chosen, infinite = (lags >= start) & (lags <= end), None
    if chosen.sum() < 3:
        needs = f"the window of the fit must hold at least 3 lags; ({start:.4g}, {end:.4g})"
        raise ValueError(f"{needs} holds {chosen.sum()} of {len(lags)}")
    infinite_error = np.nan
    coefficient = float(np.polyfit(lags[chosen], squares[chosen], 1)[0]) / 6.0
    each = np.polyfit(lags[chosen], of_atoms[chosen], 1)[0] / 6.0
    error = float(each.std(ddof=1) / np.sqrt(len(each))) if len(each) >= FEW else np.nan
    if viscosity is not None:
        if not is_cubic(cell) or not hasattr(made, "contents"):
            needs = "the correction of Yeh and Hummer needs the file of a run in a cubic cell"
            raise ValueError(f"{needs} that is periodic in all directions; without one, do not pass viscosity")
        thermal_energy = units.k_B * float(made.contents.record.temperature.mean())
        eta, eta_error = with_its_error(viscosity)
        added = finite_size_correction(thermal_energy, eta, float(np.linalg.norm(cell.vectors[0])))
        added *= units.to_angstrom**2 / units.to_picosecond
        infinite, infinite_error = coefficient + added, float(np.hypot(error, added * eta_error / eta))
    absolute = coefficient * CM2_PER_S if units is ASE else None
    return Diffusion(coefficient, absolute, (float(start), float(end)), lags, squares, error, infinite, infinite_error)
