"""Runs as universes of MDAnalysis, and its analyses.

MDAnalysis holds positions and velocities in float32, in Å and Å/ps, and a cell as lengths and angles only. Numbers in
reduced units are not converted: 1 σ becomes 1 Å and 1 τ becomes 1 ps.
"""

from collections.abc import Iterator
from contextlib import contextmanager, nullcontext
from functools import partial
from math import ceil
from pathlib import Path
from typing import Any

import MDAnalysis
import numpy as np
from MDAnalysis.coordinates.H5MD import H5MDReader
from MDAnalysis.coordinates.memory import MemoryReader
from MDAnalysis.guesser.tables import SYMB2Z
from MDAnalysis.lib.util import store_init_arguments
from numpy.typing import NDArray

from minimd import observers
from minimd.core.console.display import Displayed, Rows
from minimd.core.console.quiet import quiet, warn
from minimd.core.engine.engine import Engine
from minimd.core.files.h5md_reader import H5MDContents, admitted, damage_told, read_file
from minimd.core.files.h5md_schema import has_edges
from minimd.core.files.turned_cell import ROTATION, Turn, as_in_run, cell_dimensions, turn_of
from minimd.core.integrators.rows import VelocityVerlet
from minimd.core.simulation.simulation import Simulation
from minimd.core.structure.arrays import Array, Indices
from minimd.core.structure.constraints import molecules_of
from minimd.core.structure.system import System
from minimd.core.structure.units import CM2_PER_S
from minimd.observers.arguments import interval
from minimd.observers.motion import DisplacementResult
from minimd.observers.radial_distribution import RadialDistributionResult
from minimd.observers.viscosity import ViscosityResult

__all__ = [
    "Diffusion",
    "Frames",
    "RunUniverse",
    "Turn",
    "diffusion_coefficient",
    "mean_square_displacement",
    "radial_distribution",
    "universe",
]

VERSION = MDAnalysis.__version__
MOLECULE = "MOL"  # resname of a molecule without a formula
MOST_COUNTS = 10**7  # of molecules times species
# at most, the atoms of all frames together, so that g(r) takes a second
RDF_FRAMES = 50
RDF_ATOMS = 10**6
# at most
MSD_FRAMES = 500
MSD_ATOMS = 1000
MSD_LEVELS = 8
# largest relative difference between equal spacings of frames, whose times are rounded
UNEVEN = 1e-6


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
    moves_freely : whether nothing holds its center of mass.
    turn : Turn of a cell in an orientation that MDAnalysis does not hold; positions and velocities are kept turned.
        Else None.
    """

    def __init__(self) -> None:
        self.system: System | None = None
        self.turn: Turn | None = None
        self.conserves_momentum = False
        self.moves_freely = False
        self._rows: list[dict[str, Any]] = []
        self._moving: list[tuple[NDArray[np.float32], ...]] = []

    def __repr__(self) -> str:
        return f"Frames({len(self)} frames of {'no' if self.system is None else len(self.system)} atoms)"

    def __len__(self) -> int:
        return len(self._rows)

    def __call__(self, simulation: Simulation) -> None:
        """Keep the present state.
        Raises ValueError for another number of atoms than before."""
        system = simulation.system
        units = system.units
        angstrom = units.to_angstrom
        frame = simulation.frame()
        if self.system is None:
            self.system = system.copy()
            self.turn = turn_of(system.cell, angstrom)
            self.conserves_momentum = simulation.conserves_momentum
            self.moves_freely = simulation.engine.moves_freely
        if len(system) != len(self.system):
            raise ValueError(
                f"Frames keeps frames of one simulation, of {len(self.system)} atoms; this simulation has {len(system)}"
            )
        if self._rows and self._rows[-1]["step"] == frame.step:
            return
        row = {"step": frame.step, "time": frame.time * units.to_picosecond, **frame.observables}
        positions = frame.positions * angstrom
        velocities = frame.velocities * (angstrom / units.to_picosecond)
        box = cell_dimensions(system.cell, angstrom)
        if self.turn is not None:
            rotation, box = self.turn.of(system.cell.vectors)
            positions = positions @ rotation
            velocities = velocities @ rotation
            row[ROTATION] = rotation
        self._rows.append(row)
        arrays = (positions, velocities, np.zeros(6) if box is None else box)
        self._moving.append(tuple(np.asarray(array, np.float32) for array in arrays))

    def series(self, name: str) -> NDArray[Any]:
        """(T, ...) an observable, "step", or "time" [ps, or τ], of all frames."""
        return np.array([row[name] for row in self._rows])

    def reader_arguments(self, dt: float) -> dict[str, Any]:
        """Arguments for RecordedReader.
        dt : time between frames [ps, or τ]."""
        positions, velocities, dimensions = map(np.stack, zip(*self._moving, strict=True))
        return {
            "coordinate_array": positions,
            "velocities": velocities,
            "dimensions": dimensions,
            "dt": dt,
            "rows": self._rows,
        }


class RecordedReader(MemoryReader):
    """MDAnalysis' reader of arrays, with the recorded times and observables.
    rows : for each frame the entries of ts.data, with its time."""

    def __init__(
        self, coordinate_array: NDArray, rows: list[dict[str, Any]] | None = None, **options: Any
    ) -> None:
        self._recorded = rows
        super().__init__(coordinate_array, order="fac", **options)

    def _read_next_timestep(self, ts: Any = None) -> Any:
        ts = super()._read_next_timestep(ts)
        if self._recorded is not None:
            ts.data.update(self._recorded[ts.frame])
        return ts


class RunReader(H5MDReader):
    """Frames of a minimd file.
    turn : of its cell, or None; a transformation, but one that is not the user's, who can
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
    """The universe of a run.
    system : System.
    contents : of its file, apart from frames; a universe in memory has none.
    n_earlier : number of its frames before method, bath or state were changed last."""

    system: System
    times: Array  # of frames [ps, or τ]
    conserves_momentum: bool  # whether the run did
    moves_freely: bool  # whether nothing held its center of mass
    contents: H5MDContents
    n_earlier: int = 0

    @property
    def n_recent(self) -> int:
        """Number of the other frames, which analyses use; at least 1."""
        return len(self.times) - self.n_earlier


Run = str | Path | Simulation | Frames | RunUniverse


def universe(
    run: str | Path | Simulation | Frames, contents: H5MDContents | None = None
) -> RunUniverse:
    """A minimd file as an MDAnalysis universe: masses, charges, types, names, elements if labels are symbols, bonds,
    angles, dihedrals, residues.

    Names, residues and chains are those of system.topology, as of md.from_openmm. Without one each molecule is a
    residue: the atoms that bonds or fixed lengths connect. Observables are in ts.data.

    MDAnalysis places a cell with a along x and b in the xy plane. If the cell of the run has another orientation,
    positions, velocities and forces are turned with it, and a warning says so: r @ R, where R is ts.data["rotation"],
    and r @ R.T turns back. ts.data and the system are not turned. See Turn.

    run : a file; or, in memory, a simulation in its present state, or the Frames of a run.
    contents : of the file, if they have been read.

    Warns if frames are not evenly spaced, because MDAnalysis' dt is a single number.

    Raises
    ------
    FileNotFoundError, OSError, ValueError : as read_file.
    ValueError : for Frames that are empty.
    """
    spacing = {}
    damage: Any = nullcontext()
    if isinstance(run, str | Path):
        source: Any = contents or read_file(run)
        name = f"of {str(run)!r}"
        steps = source.record.step
        times = source.record.time * source.system.units.to_picosecond
        reader: Any = partial(RunReader, str(run), n_atoms=len(source.system))
        damage = damage_told(run)
    else:
        source = run if isinstance(run, Frames) else Frames()
        spacing["dt"] = 1.0
        if isinstance(run, Simulation):
            source(run)
            spacing["dt"] = run.method.duration * run.system.units.to_picosecond
        if source.system is None:
            raise ValueError("these Frames are empty; pass them to a run as observers=[frames]")
        name = "in memory"
        steps = source.series("step")
        times = source.series("time")
        reader = lambda turn, dt: RecordedReader(**source.reader_arguments(dt))  # noqa: E731 - the frames are turned
    system = source.system
    turn = turn_of(system.cell, system.units.to_angstrom)
    if turn is not None:
        warn(turn.in_words(f"the universe {name}", ": R is ts.data['rotation']"))
    if system.cell.is_periodic and not has_edges(system.cell):
        warn(
            f"the universe {name} has no cell, because MDAnalysis needs three vectors and this cell has fewer: "
            "distances are not those of nearest images; give the open direction a length into which all atoms fit, "
            "with pbc, as in cell=[20, 20, 50], pbc=(True, True, False)"
        )
    if len(times) > 1:
        spacing["dt"] = _spacing(name, steps, times)
    with quiet(), damage:
        answer = _with_topology(system)
        answer.system = system
        answer.times = times
        answer.conserves_momentum = source.conserves_momentum
        answer.moves_freely = source.moves_freely
        if isinstance(source, H5MDContents):
            answer.contents = source
            answer.n_earlier = min(int((steps < source.since).sum()), len(steps) - 1)
        answer.trajectory = reader(turn=turn, **spacing)
    return answer


def _spacing(name: str, steps: Indices, times: Array) -> float:
    """dt [ps] for MDAnalysis, which has a single spacing of frames: the median, with a warning if spacings differ."""
    spacings = np.diff(times)
    median = float(np.median(spacings))
    if np.ptp(spacings) > UNEVEN * median:
        least, most = np.diff(steps)[[spacings.argmin(), spacings.argmax()]]
        apart = f"{least} to {most} steps apart"
        if least == most:
            apart = f"{spacings.min():.4g} to {spacings.max():.4g} apart in time, because the time step changed"
        warn(
            f"the frames {name} are {apart}, so trajectory.dt and totaltime are not right for all of them; use the "
            "time of each frame, ts.time"
        )
    return median


def _with_topology(system: System) -> RunUniverse:
    """A universe without a trajectory. Names, residues and chains are those of the system's topology. Without one,
    residues are molecules, numbered from 1 in the order of their first atoms; bonds and lengths held fixed connect the
    atoms of a molecule."""
    molecules, first, of_atom = np.unique(
        molecules_of(system), return_index=True, return_inverse=True
    )
    of_atom = first.argsort().argsort()[of_atom]
    n_molecules = len(molecules)
    labels = [str(label) for label in system.species]
    segments = np.zeros(n_molecules, int)
    topology: dict[str, Any] = {
        "masses": system.masses,
        "types": labels,
        "names": labels,
        "resids": np.arange(1, n_molecules + 1),
        "resnames": _formulas(system, of_atom, n_molecules),
        "segids": ["SYSTEM"],
    }
    elements = [label if label in SYMB2Z else "" for label in labels]
    if any(elements):
        topology["elements"] = elements
    if system.charges.any():
        topology["charges"] = system.charges.tolist()
    for name, groups in system.groups().items():
        if len(groups):
            topology[name] = [*map(tuple, groups.tolist())]
    texts = system.topology
    if len(texts):
        is_first = np.append(True, (texts[1:, 2:] != texts[:-1, 2:]).any(axis=1))
        of_atom = is_first.cumsum() - 1
        residues = texts[is_first]
        segids, segments = np.unique(residues[:, 4], return_inverse=True)
        topology |= {
            "names": texts[:, 0],
            "elements": texts[:, 1],
            "chainIDs": texts[:, 4],
            "segids": segids,
            "resnames": residues[:, 2],
            "resids": residues[:, 3].astype(int),
        }
    n_segments = len(topology["segids"])
    empty = RunUniverse.empty(
        len(system), len(segments), n_segments, atom_resindex=of_atom, residue_segindex=segments
    )
    for name, values in topology.items():
        empty.add_TopologyAttr(name, values)
    return empty


def _formulas(system: System, of_atom: Indices, n_molecules: int) -> list[str]:
    """The formula of each molecule in Hill's order: carbon, hydrogen, then the others by name; without carbon all
    elements by name. A single atom is called by its name, and what has no formula "MOL"."""
    names = [str(name) for name in system.species_names]
    if n_molecules * len(names) > MOST_COUNTS:
        return [MOLECULE] * n_molecules
    counts = np.zeros((n_molecules, len(names)), np.int64)
    np.add.at(counts, (of_atom, system.species_index), 1)
    kinds, kind_of = np.unique(counts, axis=0, return_inverse=True)
    formulas = []
    for row in kinds.tolist():
        numbers = {name: n for name, n in zip(names, row, strict=True) if n}
        first = ("C", "H") if "C" in numbers else ()
        formula = MOLECULE
        if sum(row) == 1 or numbers.keys() <= SYMB2Z.keys():
            ordered = sorted(numbers, key=lambda name: (name not in first, name))
            formula = "".join(
                f"{name}{numbers[name]}" if numbers[name] > 1 else name for name in ordered
            )
        formulas.append(formula)
    return [formulas[kind] for kind in kind_of.ravel().tolist()]


@contextmanager
def universe_of(run: Run) -> Iterator[RunUniverse]:
    """The universe of a run; if run is a universe, it stays open, else the universe is closed at the end.
    Raises as universe."""
    if isinstance(run, RunUniverse):
        yield run
        return
    with quiet():  # the analyses here use the time of each frame
        own = universe(run)
    try:
        yield own
    finally:
        own.trajectory.close()


def radial_distribution(
    run: Run,
    n_bins: int = 200,
    r_max: float | None = None,
    pairs: str | list[str] | None = None,
    intramolecular: bool = False,
    of: str = "atoms",
) -> RadialDistributionResult:
    """g(r) by the observer RadialDistribution, in the cell of each frame, from evenly chosen frames since method, bath
    or state were changed last: at most 50, and a million atoms in all; the result tells how many.

    run : an argument of universe, or a universe.
    r_max : as for the observer [length of the file].
    pairs, intramolecular, of : as for the observer.

    Raises
    ------
    ValueError : if the cell is not periodic in all directions, there is only one atom, or no such pair.  Others as
        universe.
    """
    observer = observers.RadialDistribution(
        r_max, n_bins, every=1, pairs=pairs, intramolecular=intramolecular, of=of, name=""
    )
    with universe_of(run) as frames, quiet():
        most = min(RDF_FRAMES, max(1, RDF_ATOMS // len(frames.system)))
        _observe(observer, frames, most)
    return observer.result()


class _Recorded(Engine):
    """An engine without forces, whose states are the frames of a run."""

    conserves_momentum = False
    moves_freely = False

    def __init__(self, run: RunUniverse, spacing: float) -> None:
        self.conserves_momentum = run.conserves_momentum
        self.moves_freely = run.moves_freely
        super().__init__(run.system.copy(), [], VelocityVerlet(spacing))

    def show(self, ts: Any) -> None:
        """Take the state of a frame of the universe."""
        system = self.system
        units = system.units
        speed = units.to_picosecond / units.to_angstrom
        system.positions[:] = as_in_run(ts, ts.positions) / units.to_angstrom
        system.velocities[:] = as_in_run(ts, ts.velocities) * speed
        if "cell" in ts.data:
            cell = system.cell.strained(ts.data["cell"])
            self.constraint_set.follow(system.cell, cell)
            system.cell = cell


def _observe(observer: Any, frames: RunUniverse, most: int) -> None:
    """Show evenly chosen frames of the last method to an observer; what is correlated begins anew where their spacing
    changes.
    most : number of frames, about."""
    stride = ceil(frames.n_recent / most)
    chosen = slice(frames.n_earlier, None, stride)
    spacings = np.diff(frames.times[chosen]) / frames.system.units.to_picosecond
    usual = float(np.quantile(spacings, 0.5, method="lower")) if len(spacings) else 1.0
    engine = _Recorded(frames, usual)
    engine.time = float(frames.times[frames.n_earlier]) / frames.system.units.to_picosecond
    for k, ts in enumerate(frames.trajectory[chosen]):
        engine.show(ts)
        if k and abs(spacings[k - 1] - usual) > UNEVEN * usual:
            observer.interrupt()
        observer.observe(engine)
        engine.count(1)


class Diffusion(Displayed):
    """Self-diffusion in the frames of a run, by the observer MeanSquareDisplacement. str() is one line about it.

    Attributes
    ----------
    result : DisplacementResult, in the units of the run.
    coefficient : D in this cell [Å²/ps, or σ²/τ]; NaN unless the slope has stopped to change with the lag.
        cm2_per_s : the same in cm²/s, None in reduced units.
    error : standard error of D, from blocks of time.
    infinite, infinite_error : D in an infinite system, by the correction of Yeh and Hummer; None if no viscosity was
        given.
    window : lags of D [ps or τ].
    lags, displacements : (T,) [ps or τ], (T,) mean squares [Å² or σ²].
    """

    def __init__(self, result: DisplacementResult) -> None:
        units = result.units
        ps = units.to_picosecond
        per_time = units.to_angstrom**2 / ps
        start, end = result.window
        self.result = result
        self.coefficient = per_time * result.diffusion
        self.error = per_time * result.diffusion_error
        self.cm2_per_s = None if units.is_reduced else result.diffusion / CM2_PER_S
        self.infinite = None if np.isnan(result.infinite) else per_time * result.infinite
        self.infinite_error = per_time * result.infinite_error
        self.window = (start * ps, end * ps)
        self.lags = result.times * ps
        self.displacements = result.msd * units.to_angstrom**2

    def display_rows(self) -> Rows:
        """See Displayed."""
        return self.result.display_rows()

    def __repr__(self) -> str:
        return f"Diffusion({self})"

    def __str__(self) -> str:
        lines = [line for _, line in self.display_rows()]
        return lines[0] if self.infinite is None else f"{lines[0]}; {lines[-1]}"


def mean_square_displacement(run: Run, of: str = "atoms") -> tuple[Array, Array]:
    """Lags [ps, or τ], (T,), and ⟨|r(t₀ + lag) − r(t₀)|²⟩ [Å², or σ²], (T,), by the observer MeanSquareDisplacement:
    relative to the center of mass, and without the motion of the cell, as described there.

    Frames before method, bath or state were changed last are left out. If there are many frames or atoms, some of them
    are used, evenly chosen. Where frames are not evenly spaced, a new series begins.
    run : an argument of universe, or a universe.
    of : "atoms" or "molecules", whose centers count.

    Raises
    ------
    ValueError : if there is only one such frame.  Others as universe.
    """
    diffusion = diffusion_coefficient(run, of=of)
    return diffusion.lags, diffusion.displacements


def diffusion_coefficient(
    run: Run,
    window: tuple[float, float] | None = None,
    viscosity: float | ViscosityResult | None = None,
    of: str = "atoms",
) -> Diffusion:
    """D from the mean-square displacement, with its standard error, if its slope has stopped to change with the lag.

    run, of : as for mean_square_displacement.
    window : [ps, or τ]; D is then the mean slope over its octaves, whether atoms diffuse there or not.
    viscosity : η [energy time/length³], or the result of md.observers.Viscosity, whose error then counts, for the
        correction of Yeh and Hummer for the size of a cubic cell; see observers.motion.

    Raises
    ------
    ValueError : if the window holds no octave of lags; if a viscosity is given, and the cell is not cubic.
        Others as mean_square_displacement.
    """
    with universe_of(run) as frames, quiet():
        if frames.n_recent < 2:
            file = hasattr(frames, "contents") and repr(frames.trajectory.filename)
            later = " since method, bath or state were changed" * bool(frames.n_earlier)
            raise ValueError(
                f"a displacement needs at least 2 frames; {file or 'this run'} holds {frames.n_recent}{later}"
            )
        observer = observers.MeanSquareDisplacement(
            every=1, n_levels=MSD_LEVELS, most_atoms=MSD_ATOMS, of=of, name=""
        )
        _observe(observer, frames, MSD_FRAMES)
        if window is not None:
            start, end = interval("window", window)
            ps = frames.system.units.to_picosecond
            window = (start / ps, end / ps)
        return Diffusion(observer.result(window, viscosity))
