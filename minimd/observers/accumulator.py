"""The base of observers with results: their steps, scene, sums with error bars, and the display of results."""

from __future__ import annotations

import json
from abc import ABC, abstractmethod
from dataclasses import asdict, dataclass
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from minimd.console.display import Displayed, Rows, call_of
from minimd.console.words import shown
from minimd.engine.engine import Engine
from minimd.structure.checks import checked_count
from minimd.structure.units import SYSTEMS, UnitSystem

if TYPE_CHECKING:
    import pandas
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


from collections.abc import Callable

from minimd.structure.statistics import MOST_BLOCKS, replicas, spread

Array = NDArray[np.float64]


class BlockedSums:
    """Sums of n numbers over the entries of a run.



    All blocks have the same length, which grows with the run:
    they become longer than any correlation that the run is long enough to show.

    total : (n,), to which entries are added in place.  n_entries : number of complete entries.
    """

    def __init__(self, n: int) -> None:
        self.total = np.zeros(n)
        self.n_entries, self._length, self._n_marks = 0, 1, 0
        self._marks = np.zeros((MOST_BLOCKS, n))

    def close_entry(self) -> None:
        """Count an entry that has been added completely."""
        self.n_entries += 1
        if self.n_entries % self._length:
            return
        self._marks[self._n_marks] = self.total
        self._n_marks += 1
        if self._n_marks == MOST_BLOCKS:
            self._marks[: MOST_BLOCKS // 2] = self._marks[1::2]
            self._n_marks, self._length = MOST_BLOCKS // 2, 2 * self._length

    def parts(self) -> Array:
        """(K, n) sums over each block; a last block that is not full is left out."""
        return np.diff(self._marks[: self._n_marks], axis=0, prepend=0.0)

    def replicas(self, law: Callable[[Array], Any]) -> Array:
        """The result of a law for the sums without one block, (K, ...), for each of K blocks;
        their spread gives the standard error."""
        with np.errstate(all="ignore"):  # a lag that occurs in one block only has no error
            return replicas(law, self.total, self.parts())

    def estimate(self, law: Callable[[Array], Any]) -> tuple[Array, Array]:
        """The result of a law for the sums, and its standard error."""
        with np.errstate(all="ignore"):
            value = np.asarray(law(self.total), dtype=np.float64)
        found = self.replicas(law)
        return value, spread(found) if len(found) else np.full_like(value, np.nan)

    def state(self) -> dict[str, NDArray[Any]]:
        """The state, for restore."""
        numbers = np.array([self.n_entries, self._length, self._n_marks])
        return {"total": self.total, "marks": self._marks[: self._n_marks], "entries": numbers}

    def restore(self, state: dict[str, NDArray[Any]]) -> None:
        """Restore a state."""
        self.total[:] = state["total"]
        self.n_entries, self._length, self._n_marks = map(int, state["entries"])
        self._marks[: self._n_marks] = state["marks"]


@dataclass(frozen=True)
class ObservedRun:
    """The properties of a run that results need; they do not change from the first observation to the last.

    units : name of the unit system.  species : labels.  numbers : of atoms of each species.  spacing :
        time between observations [time].
    n_dof : degrees of freedom.  bath_temperature, bath_pressure : of thermostat and barostat; None without them.
    """

    units: str
    species: list[str]
    numbers: list[int]
    spacing: float
    n_dof: int
    bath_temperature: float | None
    bath_pressure: float | None

    @classmethod
    def of(cls, engine: Engine, every: int) -> ObservedRun:
        """The properties of the run of an engine."""
        system, barostat = engine.system, engine.barostat
        temperature = engine.method.parameters.get("temperature")
        return cls(
            units=system.units.name,
            species=[str(one) for one in system.species_names],
            numbers=np.bincount(system.species_index, minlength=len(system.species_names)).tolist(),
            spacing=every * engine.method.timestep,
            n_dof=engine.n_dof,
            bath_temperature=barostat.temperature if barostat is not None and temperature is None else temperature,
            bath_pressure=barostat.pressure if barostat is not None else None,
        )

    @property
    def unit_system(self) -> UnitSystem:
        """The units of all numbers."""
        return SYSTEMS[self.units]

    @property
    def n_atoms(self) -> int:
        """The number of atoms N."""
        return sum(self.numbers)


Series = list[tuple[str, Array, Array | None]]  # names, values and standard errors, the abscissa first


class Result(Displayed):
    """The result of an observer: series over an abscissa, and single numbers, in the units of the simulation.

    Columns, data frame, file and repr follow from series, coefficients and display_rows.
    """

    scene: ObservedRun
    title: ClassVar[str] = ""
    coefficients: ClassVar[tuple[str, ...]] = ()  # names of the attributes that are its single numbers

    def series(self) -> Series:
        """Its series, all of the same length; none if it has single numbers only."""
        return []

    def columns(self) -> dict[str, Array]:
        """Its series by name, the abscissa first, each followed by its standard errors."""
        made: dict[str, Array] = {}
        for name, values, errors in self.series():
            made |= {name: values} if errors is None else {name: values, f"{name}_error": errors}
        return made

    def numbers(self) -> dict[str, float]:
        """Its single numbers by name."""
        return {name: getattr(self, name) for name in self.coefficients}

    def to_pandas(self) -> pandas.DataFrame:
        """A data frame of columns(), with the numbers in its attrs.
        Raises ModuleNotFoundError if pandas is not installed."""
        from pandas import DataFrame

        table = DataFrame(self.columns())
        table.attrs.update(self.numbers())
        return table

    @abstractmethod
    def draw(self, panel: Axes) -> None:
        """Draw the result into axes of matplotlib."""

    def draw_curves(self, panel: Axes, x: Array, curves: dict[str, Array]) -> None:
        """Draw curves over x, (B,), with a legend if there are several."""
        for name, values in curves.items():
            panel.plot(x, values, lw=1.1, label=name)
        if len(curves) > 1:
            panel.legend(frameon=False, fontsize=8)

    def plot(self) -> Figure:
        """A figure, which a notebook shows; .savefig(path) writes it to a file."""
        from minimd.engine.record_picture import Picture  # matplotlib is slow to load

        figure = Picture(figsize=(6.0, 4.0), dpi=150, layout="constrained")
        panel = figure.subplots()
        panel.spines[["top", "right"]].set_visible(False)
        panel.grid(alpha=0.25, lw=0.6)
        self.draw(panel)
        return figure

    def __repr__(self) -> str:
        return f"{type(self).__name__}({self.display_rows()[0][1]})"


class Accumulator(ABC, Displayed):
    """An observer that looks at a run at regular steps, keeps sums, and computes a result from them.

        observer = md.observers.RadialDistribution(every=100)
        sim.run(100_000, observers=[observer])
        print(observer.result())

    It looks once at each step that is a multiple of every, and goes on in later runs of the simulation. Correlations in
    time begin anew if steps are missing between two looks, or if the state was changed between two runs.

    Attributes
    ----------
    every : steps between two looks.  name : its name in files.  scene : ObservedRun; None before the first run.
    n_looks : number of looks.  last_step : the step of the last look, −1 if there is none.
    """

    kind: ClassVar[str]  # its name in scene files and H5MD files
    arguments: ClassVar[tuple[str, ...]] = ("every",)  # with which, and with its name, it can be made again
    settled: ClassVar[tuple[str, ...]] = ()  # attributes that the first run sets: numbers and lists for JSON
    needs_energy: ClassVar[bool] = False  # whether it needs energies or the virial
    convention: ClassVar[int] = 1  # of its sums; those of another cannot go on
    sums: BlockedSums

    def __init__(self, every: int, name: str) -> None:
        self.every, self.name = checked_count("every", every), name or self._own_name()
        if not (isinstance(name, str) and self.name.isidentifier()):
            raise ValueError(
                f"the name of an observer must be made of letters, digits and underscores; name = {shown(name)}"
            )
        self.scene: ObservedRun | None = None
        self.last_step = -1

    def __repr__(self) -> str:
        made = self.made_with()
        return call_of(self, made if self.name != self._own_name() else {**made, "name": ""}, always=("every",))

    def display_rows(self) -> Rows:
        """See Displayed."""
        return self.result().display_rows() if self.n_looks else [("observer", f"{self!r}, has not looked yet")]

    @classmethod
    def _own_name(cls) -> str:
        return cls.kind.replace("-", "_")

    @property
    def n_looks(self) -> int:
        """The number of looks."""
        return self.sums.n_entries if self.scene is not None else 0

    def made_with(self) -> dict[str, Any]:
        """The arguments with which it was made."""
        return {name: getattr(self, name) for name in (*self.arguments, "name")}

    def prepare(self, engine: Engine) -> None:
        """Prepare for a run of an engine.  Raises ValueError if it cannot be observed,
        or is another scene than the one observed before."""
        scene = ObservedRun.of(engine, self.every)
        if self.scene is None:
            self._begin(engine)
            self.scene = scene
            self._laid_out(scene)
        elif self.scene != scene:
            raise ValueError(
                f"{self!r} has observed another system, or one with another time step or bath; make a new observer for "
                "this run"
            )

    def observe(self, engine: Engine) -> None:
        """Look at the present state, unless the last look was at this step."""
        if engine.step == self.last_step:
            return
        if self.last_step >= 0 and engine.step != self.last_step + self.every:
            self.interrupt()
        self._look(engine)
        self.sums.close_entry()
        self.last_step = engine.step

    def interrupt(self) -> None:
        """Do not correlate later looks with earlier ones."""

    def break_off(self, step: int) -> int:
        """A run has failed; step is its last good one. Returns the number of later looks, which remain in the sums."""
        n_later = max(0, self.last_step // self.every - step // self.every)
        if n_later:
            self.interrupt()
            self.last_step = -1
        return n_later

    def answered(self) -> ObservedRun:
        """The scene, which a result needs.  Raises ValueError before the first look."""
        if self.scene is None or not self.n_looks:
            raise ValueError(
                f"{self!r} has not looked yet; pass it to a run of {self.every} steps or more: sim.run(n_steps, "
                "observers=[...])"
            )
        return self.scene

    def _begin(self, engine: Engine) -> None:
        """Check the first run, and set the attributes named in settled."""

    @abstractmethod
    def _laid_out(self, scene: ObservedRun) -> None:
        """Make the sums."""

    @abstractmethod
    def _look(self, engine: Engine) -> None:
        """Add the present state to the sums."""

    @abstractmethod
    def result(self) -> Any:
        """The result.  Raises ValueError before the first look."""

    def _arrays(self) -> dict[str, NDArray[Any]]:
        """Arrays, other than the sums, on which the next looks depend."""
        return {}

    def _take_arrays(self, arrays: dict[str, NDArray[Any]]) -> None:
        """Restore the arrays of _arrays."""

    def state(self) -> dict[str, NDArray[Any]]:
        """Everything on which later results depend, for restore; empty before the first run."""
        if self.scene is None:
            return {}
        words = json.dumps(
            {
                "scene": asdict(self.scene),
                "settled": {name: getattr(self, name) for name in self.settled},
                "last_step": self.last_step,
                "convention": self.convention,
            }
        )
        return {"words": np.frombuffer(words.encode(), dtype=np.uint8), **self.sums.state(), **self._arrays()}

    def can_restore(self, state: dict[str, NDArray[Any]]) -> bool:
        """Whether a state has the convention of this observer."""
        return not state or bool(json.loads(bytes(state["words"])).get("convention", 1) == self.convention)

    def restore(self, state: dict[str, NDArray[Any]]) -> None:
        """Go on from the state of another observer, which must have been made with the same arguments.

        Raises ValueError if its sums have another convention, as those of an older version of minimd may.
        """
        if not state:
            return
        words = json.loads(bytes(state["words"]))
        if not self.can_restore(state):
            was = (
                f"its sums have convention {words.get('convention', 1)} of another version of minimd, not "
                f"{self.convention}"
            )
            raise ValueError(
                f"observer {self.name} cannot go on: {was}; go on without it, or with one of another name, which "
                "begins anew"
            )
        for name in self.settled:  # no other attribute, whatever a file says
            setattr(self, name, words["settled"][name])
        self.scene = ObservedRun(**words["scene"])
        self._laid_out(self.scene)
        self.last_step = words["last_step"]
        self.sums.restore(state)
        self._take_arrays(state)
