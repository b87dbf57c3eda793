"""The base of observers with results: steps, scene, sums with error bars, and results; the observers of a run."""

from __future__ import annotations

import copy
import json
from abc import abstractmethod
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, field, fields, replace
from inspect import cleandoc
from math import isfinite
from textwrap import fill
from typing import (
    TYPE_CHECKING,
    Any,
    ClassVar,
    NamedTuple,
    TypeVar,
    dataclass_transform,
    get_args,
    get_origin,
    get_type_hints,
)

import numpy as np
from numpy.typing import NDArray

from minimd.core.console.display import Displayed, Rows, call_of
from minimd.core.engine.engine import Engine
from minimd.core.engine.observer import StoredObserver
from minimd.core.integrators.ramp import Ramp
from minimd.core.structure.arrays import Array, Indices
from minimd.core.structure.checks import checked_kind
from minimd.core.structure.statistics import MOST_BLOCKS, replicas, spread
from minimd.core.structure.units import SYSTEMS, UnitSystem
from minimd.observers.arguments import Argument, argument, label, steps

if TYPE_CHECKING:
    import pandas
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

LINE = 64  # letters in a line of text in a picture
FEW_CURVES = 5  # with names in one column
COLORS = 10  # of curves, before they come again
AIR = 1.15  # height of a picture, where its highest curve is 1

State = dict[str, NDArray[Any]]
Observer = TypeVar("Observer", bound="Accumulator")


def _is_of_type(value: Any, kind: Any) -> bool:
    """Whether a value of JSON is of a type, such as float | None or list[list[int]]."""
    parts = get_args(kind)
    if get_origin(kind) is list:
        return isinstance(value, list) and all(_is_of_type(element, parts[0]) for element in value)
    if parts:
        return any(_is_of_type(value, part) for part in parts)
    return isfinite(value) if kind is float and type(value) in (int, float) else type(value) is kind


def _contents(state: State) -> dict[str, tuple[Any, ...]]:
    """Types, shapes and bytes of the arrays of a state, but for its words, which an older version may have put
    otherwise."""
    return {
        name: (array.dtype, array.shape, array.tobytes())
        for name, array in state.items()
        if name != "words"
    }


class BlockedSums:
    """Sums of n numbers over the entries of a run, and over blocks of it.

    All blocks have the same length, which grows with the run: they become longer than any correlation that the run is
    long enough to show.

    total : (n,), to which entries are added in place.
    n_entries : number of complete entries.
    """

    def __init__(self, n: int) -> None:
        self.total = np.zeros(n)
        self.n_entries = 0
        self._length = 1
        self._n_marks = 0
        self._marks = np.zeros((MOST_BLOCKS, n))

    @classmethod
    def joined(cls, runs: Sequence[BlockedSums]) -> BlockedSums:
        """The sums of several runs: their blocks one after the other, those of short runs together as long as those of
        the longest. Entries behind the last block of a run count in the total, but are in no block."""
        sums = cls(runs[0].total.size)
        sums.total = np.sum([run.total for run in runs], axis=0)
        sums.n_entries = sum(run.n_entries for run in runs)
        # lengths are powers of 2, so that blocks that become shorter always fill a longer one
        ordered = sorted(runs, key=lambda run: -run._length)
        ends = np.cumsum(np.concatenate([np.full(run._n_marks, run._length) for run in ordered]))
        marks = np.cumsum(np.concatenate([run.parts() for run in ordered]), axis=0)
        sums._length = ordered[0]._length
        while ends[-1] // sums._length >= MOST_BLOCKS:
            sums._length *= 2
        marks = marks[ends % sums._length == 0]
        sums._n_marks = len(marks)
        sums._marks[: len(marks)] = marks
        return sums

    def begins_as(self, other: BlockedSums) -> bool:
        """Whether two runs have the same sums at an end of a block of both, which are not zero."""
        _, own, theirs = np.intersect1d(self.ends, other.ends, return_indices=True)
        if not len(own):
            return False
        last = self.until()[own[-1]]
        return bool(last.any()) and np.array_equal(last, other.until()[theirs[-1]], equal_nan=True)

    def close_entry(self) -> None:
        """Count an entry that has been added completely."""
        self.n_entries += 1
        if self.n_entries % self._length:
            return
        self._marks[self._n_marks] = self.total
        self._n_marks += 1
        if self._n_marks == MOST_BLOCKS:
            self._n_marks //= 2
            self._marks[: self._n_marks] = self._marks[1::2]
            self._length *= 2

    def parts(self) -> Array:
        """(K, n) sums over each block; a last block that is not full is left out."""
        return np.diff(self.until(), axis=0, prepend=0.0)

    def until(self) -> Array:
        """(K, n) sums up to the end of each block."""
        return self._marks[: self._n_marks]

    @property
    def ends(self) -> Indices:
        """(K,) numbers of entries up to the end of each block."""
        return self._length * np.arange(1, self._n_marks + 1)

    def replicas(self, law: Callable[[Array], Any]) -> Array:
        """The result of a law for the sums without one block, (K, ...), for each of K blocks; their spread gives the
        standard error."""
        with np.errstate(all="ignore"):  # a lag that occurs in one block only has no error
            return replicas(law, self.total, self.parts())

    def estimate(self, law: Callable[[Array], Any]) -> tuple[Array, Array]:
        """The result of a law for the sums, and its standard error."""
        with np.errstate(all="ignore"):
            value = np.asarray(law(self.total), dtype=np.float64)
        return value, spread(self.replicas(law))

    def state(self) -> State:
        """The state, for restore."""
        numbers = np.array([self.n_entries, self._length, self._n_marks])
        return {"total": self.total, "marks": self._marks[: self._n_marks], "entries": numbers}

    def restore(self, state: State) -> None:
        """Restore a state."""
        self.n_entries, self._length, self._n_marks = map(int, state["entries"])
        is_possible = 0 <= self._n_marks == self.n_entries // self._length < MOST_BLOCKS
        if not is_possible:
            blocks = f"{self._n_marks} blocks of {self._length}"
            raise ValueError(f"{blocks} do not make {self.n_entries} looks")
        self.total[:] = state["total"]
        self._marks[: self._n_marks] = state["marks"]


@dataclass(frozen=True)
class ObservedRun:
    """The properties of a run that results need; they do not change from the first observation to the last.

    units : name of the unit system.
    species : labels.
    numbers : of atoms of each species.
    spacing : time between observations [time].
    n_dof : degrees of freedom.
    bath_temperature, bath_pressure : of thermostat and barostat; None without them.
    times : of the first and of the last look so far [time]; of a run that began with an older version of minimd, fewer.
    has_molecules : whether bonds or rigid lengths join atoms; of such a run, true.
    n_fixed : number of fixed atoms; of such a run, 0.
    dimensions : 3, or 2 of a plane.
    """

    units: str
    species: list[str]
    numbers: list[int]
    spacing: float
    n_dof: int
    bath_temperature: float | None
    bath_pressure: float | None
    times: list[float] = field(default_factory=list, compare=False)
    has_molecules: bool = field(default=True, compare=False)
    n_fixed: int = field(default=0, compare=False)
    dimensions: int = 3

    @classmethod
    def of(cls, engine: Engine, every: int) -> ObservedRun:
        """The properties of the run of an engine."""
        system = engine.system
        temperature, pressure = engine.bath_settings
        numbers = np.bincount(system.species_index, minlength=len(system.species_names))
        return cls(
            units=system.units.name,
            species=[*map(str, system.species_names)],
            numbers=numbers.tolist(),
            spacing=every * engine.method.duration,
            n_dof=engine.n_dof,
            bath_temperature=temperature,
            bath_pressure=pressure,
            has_molecules=bool(len(system.bonds) or engine.constraint_set.bonds),
            n_fixed=engine.constraint_set.n_fixed,
            dimensions=system.dimensions,
        )

    @property
    def unit_system(self) -> UnitSystem:
        """The units of all numbers."""
        units = SYSTEMS[self.units]
        return units if self.dimensions == 3 else units.in_plane

    @property
    def n_atoms(self) -> int:
        """The number of atoms N."""
        return sum(self.numbers)

    def frames(self, n: int) -> str:
        """n looks in words, with the time from the first to the last: "401 frames, 0 to 40 ps"."""
        words = f"{n} frame{'s' * (n > 1)}"
        if len(self.times) < min(n, 2) or self.times != sorted(self.times):
            return words
        units = self.unit_system
        ends = " to ".join(f"{time * units.to_picosecond:.6g}" for time in self.times)
        return f"{words}, {ends} {units.shown_time}"


def first_peak(x: Array, y: Array) -> tuple[float, int]:
    """The place of the first peak of a curve y, (B,), over x, (B,): in the first interval where y is at least half of
    its maximum, the vertex of the parabola through the highest point and its neighbors; and the number of this point.
    """
    is_high = np.append(y >= 0.5 * y.max(), False)
    start = int(np.argmax(is_high))
    end = start + int(np.argmin(is_high[start:]))
    k = start + int(np.argmax(y[start:end]))
    if not 0 < k < len(y) - 1:
        return float(x[k]), k
    before, after = np.diff(y[k - 1 : k + 2]) / np.diff(x[k - 1 : k + 2])
    curvature = 2.0 * (after - before) / (x[k + 1] - x[k - 1])
    return float(0.5 * (x[k - 1] + x[k]) - before / curvature), k


class Series(NamedTuple):
    """A series of a result: its name and unit, values, (T,), and their standard errors, (T,) or None."""

    name: str
    unit: str
    values: Array
    errors: Array | None = None


@dataclass(frozen=True, repr=False)
class Result(Displayed):
    """The result of an observer: series over an abscissa, and single numbers, in the units of the simulation.

    A class gives series, coefficients and display_rows; columns, data frame, file, picture and repr follow from them.
    """

    scene: ObservedRun
    title: ClassVar[str] = ""
    # names of the attributes that are its single numbers
    coefficients: ClassVar[tuple[str, ...]] = ()

    @property
    def units(self) -> UnitSystem:
        """The units of all numbers."""
        return self.scene.unit_system

    def series(self) -> list[Series]:
        """Its series, all of the same length, the abscissa first; none if it has single numbers only."""
        return []

    def columns(self) -> dict[str, Array]:
        """Its series by name, the abscissa first, each followed by its standard errors."""
        columns: dict[str, Array] = {}
        for name, _, values, errors in self.series():
            columns[name] = values
            if errors is not None:
                columns[f"{name}_error"] = errors
        return columns

    def numbers(self) -> dict[str, float]:
        """Its single numbers by name."""
        return {name: getattr(self, name) for name in self.coefficients}

    def to_pandas(self) -> pandas.DataFrame:
        """A data frame of columns(), with the numbers in its attrs. Raises ModuleNotFoundError without pandas."""
        from pandas import DataFrame

        table = DataFrame(self.columns())
        table.attrs.update(self.numbers())
        return table

    def abscissa(self) -> tuple[Array, str]:
        """The abscissa of pictures, and its unit: a time is in ps, or τ."""
        _, unit, values, _ = self.series()[0]
        units = self.units
        if unit == units.time:
            return values * units.to_picosecond, units.shown_time
        return values, unit

    def draw(self, panel: Axes) -> None:
        """Draw the result into axes of matplotlib: the first series, and those with its unit, under the title if there
        are several; or the rows as text."""
        series = self.series()
        if series:
            x, first, *_ = series
            curves = [curve for curve in series[1:] if curve.unit == first.unit]
            quantity = self.title if len(curves) > 1 else first.name
            label = f"{quantity}  [{first.unit}]" if first.unit else quantity
            return self.draw_curves(panel, curves, x.name, label)
        text = "\n".join(fill(row, LINE) for _, row in self.display_rows())
        style: dict[str, Any] = {"va": "top", "fontsize": 8, "parse_math": False}
        panel.axis("off")
        panel.text(0.0, 1.0, text, transform=panel.transAxes, **style).set_in_layout(False)
        panel.set_title(self.title)

    def draw_curves(self, panel: Axes, curves: Sequence[Series], symbol: str, label: str) -> None:
        """Draw curves over the abscissa, with bands of one standard error, and with a legend if there are several.

        symbol : of the abscissa.
        label : of the other axis.
        """
        x, unit = self.abscissa()
        for k, (name, _, values, errors) in enumerate(curves):
            style = "-" if k < COLORS else "--"
            (line,) = panel.plot(x, values, style, lw=1.1, label=name.replace("$", r"\$"))
            if errors is not None:
                color = line.get_color()
                panel.fill_between(
                    x, values - errors, values + errors, color=color, alpha=0.25, lw=0
                )
        if len(curves) > 1:
            columns = 1 + len(curves) // FEW_CURVES
            panel.legend(frameon=False, fontsize=8, ncols=columns, loc="best")
        panel.set(xlabel=f"{symbol}  [{unit}]", ylabel=label, title=self.title)

    def plot(self) -> Figure:
        """A figure, which a notebook shows; .savefig(path) writes it to a file."""
        from minimd.core.engine.record_picture import Picture  # matplotlib is slow to load

        figure = Picture(figsize=(6.0, 4.0), dpi=150, layout="constrained")
        panel = figure.subplots()
        panel.spines[["top", "right"]].set_visible(False)
        panel.grid(alpha=0.25, lw=0.6)
        self.draw(panel)
        return figure

    def __repr__(self) -> str:
        return f"{type(self).__name__}({self.display_rows()[0][1]})"


@dataclass_transform(field_specifiers=(argument, steps, label, field))
class Accumulator(StoredObserver, Displayed):
    """An observer that looks at a run at regular steps, keeps sums, and computes a result from them.

        observer = md.observers.RadialDistribution(every=100)
        sim.run(100_000, observers=[observer])
        print(observer.result())

    It looks once at each step that is a multiple of every, and goes on in later runs of the simulation. Correlations in
    time begin anew if steps are missing between two looks, or if the state was changed between two runs.

    A class declares its arguments, and name as the last one, by argument(); constructor, checks, the section Parameters
    of its docstring, repr and the keys of scene files follow. Other fields, which have init=False, are what the first
    run settles: numbers and lists for JSON.

    Attributes
    ----------
    every : steps between two looks.
    name : its name in files.
    scene : ObservedRun; None before the first run.
    n_looks : number of looks.
    last_step : the step of the last look, −1 if there is none.
    n_runs : number of runs whose sums it has, more than 1 if it is joined.
    """

    n_runs: int = 1
    convention: ClassVar[int] = 1  # of its sums; those of another cannot go on
    fits_plane: ClassVar[bool] = False  # whether it is defined in two dimensions
    declared: ClassVar[dict[str, Argument]]  # all arguments
    settled: ClassVar[tuple[str, ...]]  # attributes that the first run sets
    every: int
    name: str
    sums: BlockedSums

    def __init_subclass__(cls) -> None:
        super().__init_subclass__()
        own = fields(dataclass(eq=False, repr=False)(cls))  # type: ignore[arg-type]
        for part in own:
            if part.init and "argument" not in part.metadata:
                raise TypeError(
                    f"{cls.__name__}.{part.name} must be declared by minimd.observers.arguments, such as "
                    f"{part.name}: float = argument(positive, 'what it is', 1.5, 'length')"
                )
        cls.declared = {part.name: part.metadata["argument"] for part in own if part.init}
        cls.settled = tuple(part.name for part in own if not part.init)
        lines = [cleandoc(cls.__doc__ or ""), "", "Parameters", "----------"]
        for name, (_, meaning, unit) in cls.declared.items():
            lines.append(f"{name} : {meaning}{unit and f' [{unit}]'}.")
        cls.__doc__ = "\n".join(lines)

    def __post_init__(self) -> None:
        for name, (check, _, _) in self.declared.items():
            value = getattr(self, name)
            if value is not None or getattr(type(self), name) is not None:
                setattr(self, name, check(name, value))
        self.name = self.name or self._own_name()
        self.scene: ObservedRun | None = None
        self.last_step = -1

    def __repr__(self) -> str:
        arguments = self.made_with()
        if self.name == self._own_name():
            arguments["name"] = ""
        return call_of(self, arguments, always=("every",))

    def display_rows(self) -> Rows:
        """See Displayed."""
        if not self.n_looks:
            return [("observer", f"{self!r}, has observed nothing yet")]
        return self.result().display_rows()

    @classmethod
    def _own_name(cls) -> str:
        return cls.kind.replace("-", "_")

    @property
    def n_looks(self) -> int:
        """The number of looks."""
        return self.sums.n_entries if self.scene is not None else 0

    def made_with(self) -> dict[str, Any]:
        """The arguments with which it was made."""
        arguments = {name: getattr(self, name) for name in self.declared}
        arguments["name"] = arguments.pop("name")  # the last one
        return arguments

    def setting(self) -> dict[str, Any]:
        """What is the same where sums can be added: class, arguments but for the name, what the first run settles."""
        setting = self.made_with() | {name: getattr(self, name) for name in self.settled}
        del setting["name"]
        return setting | {"class": type(self), "scene": self.scene}

    def prepare(self, engine: Engine) -> None:
        """Prepare for a run, or a look.
        Raises ValueError if the engine cannot be observed, as in a plane, or is another scene than the one observed
        before, or if the setting of a bath is going to change."""
        if engine.system.dimensions == 2 and not self.fits_plane:
            raise ValueError(f"{self.kind} is measured in three dimensions; this run is in a plane")
        for level in engine.bath_levels:
            if isinstance(level, Ramp) and level.changes_after(engine.step):
                raise ValueError(
                    f"{self!r} averages over a state that does not change, but {level!r} of the bath goes on "
                    f"until step {level[-1][0]}: pass the observer to a run after it"
                )
        if self.n_runs > 1:
            raise ValueError(
                f"{self!r} is joined from {self.n_runs} runs and cannot look at another one: "
                "pass a new observer to this run, and join it with them"
            )
        scene = ObservedRun.of(engine, self.every)
        if self.scene is None:
            self._begin(engine)
            self.scene = scene
            self._laid_out(scene)
        elif self.scene != scene:
            baths = f"at temperature {self.scene.bath_temperature}, now {scene.bath_temperature}"
            raise ValueError(
                f"{self!r} has observed another system, or another time step, thermostat or barostat ({baths}); "
                "make a new observer for this run"
            )

    def observe(self, engine: Engine) -> None:
        """Look at the present state, unless the last look was at this step."""
        if engine.step == self.last_step:
            return
        self.prepare(engine)  # functions may have changed the bath
        if self.last_step >= 0 and engine.step != self.last_step + self.every:
            self.interrupt()
        self._look(engine)
        self.sums.close_entry()
        self.last_step = engine.step
        if self.scene and (self.scene.times or self.n_looks == 1):
            self.scene.times[1:] = [engine.time]

    def interrupt(self) -> None:
        """Do not correlate later looks with earlier ones."""

    def break_off(self, step: int) -> int:
        """A run has failed; step is its last good one. Returns the number of later looks, which remain in the sums."""
        n_later = max(0, self.last_step // self.every - step // self.every)
        if n_later:
            self.interrupt()
            self.last_step = -1
        return n_later

    def end(self, engine: Engine) -> None:
        """The run of an engine has ended."""

    def answered(self) -> ObservedRun:
        """The scene, which a result needs.
        Raises ValueError before the first look."""
        if self.scene is None or not self.n_looks:
            raise ValueError(
                f"{self!r} has not observed any state yet; "
                f"pass it to a run of {self.every} steps or more: sim.run(n_steps, observers=[...])"
            )
        return replace(self.scene, times=[*self.scene.times])

    def _history(self, law: Callable[[Array], Any], sums: Array) -> tuple[Array, Array]:
        """The times of the last looks of K blocks, (K,), and the results of a law for sums (K, n), (K, ...)."""
        scene = self.answered()
        first = scene.times[0] if scene.times else 0.0
        times: Array = first + np.float64(scene.spacing) * (self.sums.ends - 1)
        with np.errstate(all="ignore"):
            return times, np.array([law(each) for each in sums], dtype=np.float64)

    def _begin(self, engine: Engine) -> None:
        """Check the first run, and set what it settles."""

    @abstractmethod
    def _laid_out(self, scene: ObservedRun) -> None:
        """Make the sums."""

    @abstractmethod
    def _look(self, engine: Engine) -> None:
        """Add the present state to the sums."""

    @abstractmethod
    def result(self) -> Any:
        """The result.
        Raises ValueError before the first look."""

    def _parts(self) -> list[Any]:
        """What is kept from look to look: each has state and restore, with names of its own for its arrays."""
        return [self.sums]

    def state(self) -> State:
        """Everything on which later results depend, for restore; empty before the first run."""
        if self.scene is None:
            return {}
        about = {
            "scene": asdict(self.scene),
            "settled": {name: getattr(self, name) for name in self.settled},
            "last_step": self.last_step,
            "convention": self.convention,
        }
        state = {"words": np.frombuffer(json.dumps(about).encode(), dtype=np.uint8)}
        for part in self._parts():
            state |= part.state()
        return state

    def can_restore(self, state: State) -> bool:
        """Whether a state has the convention of this observer."""
        if not state:
            return True
        convention = json.loads(bytes(state["words"])).get("convention", 1)
        return bool(convention == self.convention)

    def restore(self, state: State) -> None:
        """Go on from the state of another observer, which must have been made with the same arguments.

        Raises ValueError if its sums have another convention, as those of an older version of minimd may.
        """
        if not state:
            return
        about = json.loads(bytes(state["words"]))
        if not self.can_restore(state):
            convention = about.get("convention", 1)
            raise ValueError(
                f"observer {self.name} cannot be continued: its sums are of another version of minimd "
                f"(convention {convention}, not {self.convention}); "
                "leave this observer out, or give it another name, under which it begins anew"
            )

        for name in self.settled:  # no other attribute, whatever a file says
            setattr(self, name, about["settled"][name])
        self.scene = ObservedRun(**about["scene"])
        self.last_step = about["last_step"]

        for part, names in ((self, (*self.settled, "last_step")), (self.scene, vars(self.scene))):
            kinds = get_type_hints(type(part))
            for name in names:
                if not _is_of_type(getattr(part, name), kinds[name]):
                    raise ValueError(
                        f"{name} of the observer {self.name} is not of type {kinds[name]}"
                    )

        self._laid_out(self.scene)
        for part in self._parts():
            part.restore(state)
        if _contents(self.state()) != _contents(state):
            raise ValueError(
                f"the arrays of the observer {self.name} are not of the kinds that it keeps"
            )


def joined(observers: Sequence[Observer]) -> Observer:
    """An observer with the sums of several, which have looked at independent runs of one scene: its result is that of
    all of them, with a common error bar. It cannot look at another run.

        parts = [md.read_observers(file)["viscosity"] for file in files]
        print(md.observers.joined(parts).result())

    observers : of one class, with the same arguments, but for their names; they stay as they are.

    Raises
    ------
    TypeError : for anything but observers with results.
    ValueError : for none, for one that has not looked yet, for other arguments or another scene, for something that the
        first run has settled otherwise, as r_max by its cell or the reference of Fluctuations, and for two with the
        same sums, whose runs are one.
    """
    observers = list(observers)
    if not observers:
        raise ValueError("observers must be those of one run or more; there are none")
    for k, observer in enumerate(observers):
        checked_kind(f"observers[{k}]", observer, Accumulator, "an observer with a result")
        observer.answered()
        if observer.n_runs > 1:
            raise ValueError(
                f"observers[{k}] is joined from {observer.n_runs} runs already: join all runs at once"
            )
        setting = observer.setting()
        different = [
            name for name, value in observers[0].setting().items() if setting.get(name) != value
        ]
        if different:
            raise ValueError(
                f"observers[{k}] must be as observers[0], of the same scene; they differ in {', '.join(different)}: "
                f"{observer!r} and {observers[0]!r}; give both the same, or compare their results"
            )
        for i, other in enumerate(observers[:k]):
            if observer.sums.begins_as(other.sums):
                raise ValueError(
                    f"observers[{k}] must be of another run than observers[{i}], but begins with the same sums to the "
                    "last bit: give independent runs different seeds"
                )

    whole = copy.deepcopy(observers[0])
    whole.sums = BlockedSums.joined([observer.sums for observer in observers])
    whole.scene = replace(observers[0].answered(), times=[])
    whole.n_runs = len(observers)
    return whole
