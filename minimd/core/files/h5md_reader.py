"""Reading a minimd file: the door, a first look, and record, restart and description; see h5md_schema for the layout.

Every HDF5 file that minimd reads or continues is opened here, and searched before anything in it is read. HDF5 lets a
file lead elsewhere: links may name objects in other files, and the numbers of a dataset may lie in any other file,
which is then read, or overwritten when a run goes on. A file of minimd consists of groups and plain datasets in itself;
all others are refused. On damaged bytes HDF5 may crash, or never end, and its process with it: a first look is taken in
a child process.
"""

import faulthandler
import os
import pickle
import re
import signal
import warnings
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from functools import partial
from math import prod
from pathlib import Path
from typing import Any, NamedTuple, NoReturn, TypeVar

import h5py
import numpy as np
from h5py import h5a, h5d, h5g, h5l, h5o, h5t, h5z

import minimd.core.diagnosis.shadow_energy  # noqa: F401 - registers an observable, of runs and of files
from minimd.core.console.display import Displayed, Rows
from minimd.core.console.quiet import quiet, warn
from minimd.core.console.words import printable
from minimd.core.engine.observer import StoredObserver
from minimd.core.engine.record import SERIES, Frame, Record
from minimd.core.engine.scene_in_words import scene_in_words
from minimd.core.engine.snapshot import Checkpoint
from minimd.core.files import h5md_digest as digest
from minimd.core.files.claim import end_with, repair
from minimd.core.files.h5_items import REFERENCE
from minimd.core.files.h5md_schema import (
    SPACING,
    STEPS,
    TRAJECTORY,
    factors,
    read_constraints,
    read_method,
    read_sites,
)
from minimd.core.integrators.barostats import StochasticCellRescaling
from minimd.core.integrators.splitting import Splitting
from minimd.core.integrators.table import METHODS
from minimd.core.structure.bond_graph import GROUPS
from minimd.core.structure.cell import Cell
from minimd.core.structure.checks import checked_path
from minimd.core.structure.errors import sentence
from minimd.core.structure.system import System
from minimd.core.structure.units import SYSTEMS, UnitSystem

Found = TypeVar("Found")


class Layout(NamedTuple):
    """What files of a program hold, besides groups and plain numbers.
    program : its name.
    group : in the root of all its files.
    texts, packed : the paths of datasets that may be texts, or packed by PACKING."""

    program: str
    group: str
    texts: re.Pattern[str]
    packed: re.Pattern[str]


MINIMD = Layout(
    "minimd",
    "minimd",
    re.compile("minimd/(species_names|crash_report/(findings|words|simulation))"),
    re.compile("(?!)"),  # nothing
)
GROMACS = Layout(
    "GROMACS",
    "particles",
    re.compile("h5md/modules/gromacs_topology/[^/]+/(particle|residue)_name_table"),
    re.compile("particles/.+/(step|time)"),
)
PACKING = {h5z.FILTER_DEFLATE, h5z.FILTER_SHUFFLE}
LARGEST_CHUNK = 2**20  # bytes of what is packed, which are unpacked at once
NUMBERS = (h5t.INTEGER, h5t.FLOAT, h5t.ENUM)  # bools and species are enumerations
TEXTS = (*NUMBERS, h5t.STRING)
LAYOUTS = (h5d.COMPACT, h5d.CONTIGUOUS, h5d.CHUNKED)
MOST_TEXTS = 256  # attributes of an object, and texts in an attribute; minimd has some 30
DEEPEST = 8  # groups in groups; minimd has 5
REASONS = {  # why a file cannot be opened, by the words of HDF5
    "unable to lock file": "another run is writing it",
    "truncated file": "it is damaged, it ends before its data do; copy it again, or run again",
}
# of processor time that a look may take; reading HDF5 needs a thousandth of it, and readers of texts a fifth
SECONDS = 10
BYTES_PER_SECOND = 1_000_000
# bytes that a look may take, and besides so many times those of the file, which readers of texts need
MEMORY = 2**32
SIZES = 64


def opened(path: str | Path, layout: Layout = MINIMD) -> h5py.File:
    """Open a file of minimd, or of another layout, for reading. A commit that was interrupted is finished first.

    Raises FileNotFoundError if it does not exist.  ValueError if it is not HDF5, or not of this layout.  OSError if
    it is damaged, as admitted.  BlockingIOError if a run is writing it.
    """
    h5 = _opened_hdf5(path)
    with damage_told(path):
        is_right = h5.id.links.exists(layout.group.encode())
    if not is_right:
        h5.close()
        raise ValueError(
            f"file {str(path)!r} was not written by {layout.program}; it has no group {layout.group!r}; the last frame "
            "of a file of GROMACS is read by minimd.ase.system_from_file"
        )
    return admitted(h5, path, layout)


def layout_of(path: str | Path) -> Layout:
    """The layout of an H5MD file: minimd's, unless it has the group of the other, and not that of minimd.
    Raises as opened."""
    with _opened_hdf5(path) as h5, damage_told(path):
        links = h5.id.links
        is_other = links.exists(GROMACS.group.encode()) and not links.exists(MINIMD.group.encode())
        return GROMACS if is_other else MINIMD


def _opened_hdf5(path: str | Path) -> h5py.File:
    if not checked_path("file", path).is_file():
        raise FileNotFoundError(f"file {str(path)!r} does not exist; give the .h5md file of a run")
    try:
        repair(path)
        if not h5py.is_hdf5(path):
            raise ValueError(
                f"file {str(path)!r} is not an HDF5 file; give the .h5md file of a run"
            )

        return h5py.File(path, "r")
    except (OSError, RuntimeError) as error:
        message = sentence(error)
        known = [reason for sign, reason in REASONS.items() if sign in message]
        reason = known[0] if known else message.splitlines()[0]
        kind = BlockingIOError if isinstance(error, BlockingIOError) else OSError
        raise kind(f"file {str(path)!r} cannot be opened: {reason}") from error


def admitted(h5: h5py.File, path: str | Path, layout: Layout = MINIMD) -> h5py.File:
    """The file, if all of it is of the kinds of a layout, lies in the file, and is not larger than it.
    path : for messages.
    Raises OSError, with the name of the first thing that is not, and closes the file."""
    try:
        with damage_told(path):
            problem = _strange_thing(h5, layout)
        if problem:
            raise OSError(
                f"file {str(path)!r} is refused: {problem}; {layout.program} writes no such thing; do not use this file"
            )
    except BaseException:
        h5.close()
        raise
    return h5


def _strange_thing(h5: h5py.File, layout: Layout) -> str:
    """The first thing that is not of a layout, in words; empty if there is none.  No link out of the file is
    followed, and no number read."""
    room = h5.id.get_filesize()
    seen = {h5o.get_info(h5.id).addr}
    groups = [("", h5.id)]

    while groups:
        path, group = groups.pop()
        links: list[tuple[bytes, int]] = []
        # h5py uses one info for all
        group.links.iterate(
            lambda key, info, links=links: links.append((key, info.type)), info=True
        )

        for key, kind in links:
            name = f"{path}{key.decode(errors='replace')}"
            if kind != h5l.TYPE_HARD:
                return f"{name!r} is a link by name, which may lead into another file"
            item = h5o.open(group, key)
            address = h5o.get_info(item).addr
            is_second = address in seen
            if isinstance(item, h5g.GroupID):
                if is_second or name.count("/") >= DEEPEST:
                    return f"{name!r} is a group that has a second name, or lies inside more than {DEEPEST} others"
                groups.append((f"{name}/", item))

            if is_second:
                continue
            seen.add(address)
            problem, n_bytes = _strange_in(item, name, layout)
            room -= n_bytes
            if problem:
                return f"{name!r} {problem}"
            if room < 0:
                return f"{name!r} and all before it claim {-room} bytes more than the file has"

    return ""


def _strange_in(item: Any, name: str, layout: Layout) -> tuple[str, int]:
    """What is strange in a group or dataset, in words, and the number of bytes that it asks for."""
    n_attributes = h5a.get_num_attrs(item)
    if n_attributes > MOST_TEXTS:
        return f"has {n_attributes} attributes", 0
    keys: list[bytes] = []
    h5a.iterate(item, keys.append)
    n_bytes = 0

    for key in keys:
        attribute = h5a.open(item, key)
        n = prod(attribute.shape)
        kind = attribute.get_type()
        n_bytes += n * kind.get_size()
        known = key.decode(errors="replace")
        if kind.get_class() not in TEXTS and known != REFERENCE:
            return f"has the attribute {known!r} that is neither numbers nor texts", 0
        # each of them could be as long as the file
        if n > MOST_TEXTS and kind.get_class() == h5t.STRING:
            return f"has the attribute {known!r} of {n} texts", 0

    if isinstance(item, h5g.GroupID):
        return "", n_bytes
    if not isinstance(item, h5d.DatasetID):
        return "is neither a group nor a dataset", 0
    properties = item.get_create_plist()
    kind = item.get_type()
    if properties.get_external_count() > 0:
        return "is a dataset whose numbers lie in other files", 0
    if properties.get_layout() not in LAYOUTS:
        return "is a dataset that consists of parts of others", 0
    filters = {properties.get_filter(k)[0] for k in range(properties.get_nfilters())}
    if filters and not (layout.packed.fullmatch(name) and filters <= PACKING):
        return "is a dataset whose numbers pass through filters", 0
    if kind.get_class() not in (TEXTS if layout.texts.fullmatch(name) else NUMBERS):
        return "is a dataset of other things than numbers", 0
    if filters:
        if prod(properties.get_chunk()) * kind.get_size() > LARGEST_CHUNK:
            return f"is a dataset in packed chunks of more than {LARGEST_CHUNK} bytes", 0
        return "", n_bytes + item.get_storage_size()
    return "", n_bytes + prod(item.get_space().get_simple_extent_dims()) * kind.get_size()


@contextmanager
def damage_told(path: str | Path) -> Iterator[None]:
    """Turn any error in reading a file into an OSError with one sentence."""
    try:
        yield
    except MemoryError:
        raise
    except Exception as error:  # HDF5 and h5py raise almost anything for bytes they do not expect
        reason = printable(" ".join(str(error).split())) or type(error).__name__
        raise _damaged(path, reason) from error


def _damaged(path: str | Path, reason: str) -> OSError:
    return OSError(f"file {str(path)!r} is damaged: {reason}; copy it again, or run again")


def looked_at(path: str | Path, look: Callable[[], Found]) -> Found:
    """Return or raise what look() does, and repeat its warnings; it is called in a child process if the system can
    fork, else in this one.
    Raises OSError if the child crashes, or takes more time or memory than reading could take."""
    checked_path("file", path)
    if not hasattr(os, "fork"):
        return look()
    parent = os.getpid()
    listening, telling = os.pipe()
    try:
        with quiet():  # Python warns of forks with threads; h5py holds its lock in a fork
            child = os.fork()
    except OSError:
        os.close(listening)
        os.close(telling)
        raise

    if child == 0:
        _tell(parent, telling, path, look)
    os.close(telling)
    try:
        with open(listening, "rb") as pipe:
            answer = pipe.read()
    except BaseException:
        os.kill(child, signal.SIGKILL)
        raise
    finally:
        status = 0
        # not known, because this process ignores the ends of its children
        with suppress(ChildProcessError):
            status = os.waitpid(child, 0)[1]

    if status or not answer:
        raise _damaged(path, "its reader crashes or finds no end")
    contents, error, caught = pickle.loads(answer)
    for warning in caught:
        warn(str(warning.message))
    if error is not None:
        raise error
    return contents


def _tell(parent: int, pipe: int, path: str | Path, look: Callable[[], Any]) -> NoReturn:
    """In the child: call look with little time and memory, send its result or error, and end without any output."""
    status = 1
    try:
        import resource  # a system without fork does not have this module

        end_with(parent)
        faulthandler.disable()
        os.dup2(os.open(os.devnull, os.O_WRONLY), 2)
        n_bytes = os.path.getsize(path) if os.path.exists(path) else 0
        limits = {
            resource.RLIMIT_CORE: 0,
            resource.RLIMIT_CPU: SECONDS + n_bytes // BYTES_PER_SECOND,
        }
        with suppress(OSError):  # not every system tells how much memory a process has
            pages = int(Path("/proc/self/statm").read_text(encoding="ascii").split()[0])
            limits[resource.RLIMIT_AS] = pages * resource.getpagesize() + MEMORY + SIZES * n_bytes

        for which, limit in limits.items():
            hard = resource.getrlimit(which)[1]
            soft = limit if hard == resource.RLIM_INFINITY else min(limit, hard)
            resource.setrlimit(which, (soft, hard))

        contents: Any = None
        problem: Exception | None = None

        with warnings.catch_warnings(record=True) as caught:
            warnings.simplefilter("ignore", DeprecationWarning)  # for those who write ASE
            try:
                contents = look()
            except MemoryError:
                reason = f"to read it takes more memory than {MEMORY / 1e9:.2g} GB"
                problem = _damaged(path, reason)
            except Exception as error:
                problem = error

        with open(pipe, "wb") as answer:
            pickle.dump((contents, problem, caught), answer)
        status = 0
    finally:
        os._exit(status)


@dataclass(frozen=True, repr=False)
class H5MDContents(Displayed):
    """The contents of a minimd file, apart from its frames.

    record : Record, one entry for each frame.
    system : System at the restart, to the last bit, with the constraints of the run.
    restart : Checkpoint.
    step, time : int, [time], of the restart.
    timestep : [time].
    method : its name in integrators.METHODS.
    parameters : arguments with which it can be made again.
    barostat : StochasticCellRescaling, or None.
    precision, skin : of the options.
    potentials : in words.
    too_long_a_step : the warning of a Report that the time step is too long, or empty.
    thin_cell : that atoms are pushed by their own images, or empty.
    since : the first step from which on method, bath and state are those of one run; 0 for all of them.
    reservoir_energy : [energy], given by a thermostat up to the restart; 0 without one.
    conserves_momentum : whether the run did.
    moves_freely : whether nothing held its center; false in older files.
    n_frames : int.
    has_forces : whether frames hold forces.
    title, scene : texts, empty if none were stored.
    observers : of minimd.observers, by name, in their state at the restart.
    lacks_results : whether they have looked since their results were written, as in a killed run.
    repaired : a sentence if the newest restart is damaged and the one before it is used; else empty.
    """

    record: Record
    system: System
    restart: Checkpoint
    step: int
    time: float
    timestep: float
    method: str
    reservoir_energy: float
    conserves_momentum: bool
    moves_freely: bool
    n_frames: int
    has_forces: bool
    title: str
    scene: str
    parameters: dict[str, Any]
    precision: Any
    skin: float | None
    potentials: list[str]
    repaired: str
    observers: dict[str, StoredObserver]
    lacks_results: bool
    barostat: StochasticCellRescaling | None = None
    too_long_a_step: str = ""
    thin_cell: str = ""
    since: int = 0

    def __repr__(self) -> str:
        return f"H5MDContents({self.n_frames} frames of {len(self.system)} atoms, {self.method}, step {self.step})"

    def display_rows(self) -> Rows:
        """See Displayed."""
        shown = self.system.units.shown
        return [
            *([("title", self.title)] if self.title else []),
            *self.scene_in_words(),
            ("frames", f"{self.n_frames}, {'with' if self.has_forces else 'without'} forces"),
            ("restart", f"step {self.step}, {shown(self.time)}"),
            ("scene", "stored" if self.scene else "none stored"),
            *([("repaired", self.repaired)] if self.repaired else []),
        ]

    def scene_in_words(self) -> Rows:
        """System, potentials, method and barostat."""
        potentials = (stored.partition(": ")[2] for stored in self.potentials)
        return scene_in_words(self.system, potentials, self.method, self.parameters, self.barostat)

    def integrator(self) -> Splitting:
        """The method with its time step.
        Raises ValueError if it is not a method of minimd."""
        if self.method not in METHODS:
            raise ValueError(
                f"the run was made with the method {self.method!r}, which minimd does not have; "
                "pass the method of that run: Simulation.resume(file, method=...)"
            )
        method: Any = METHODS[self.method](**self.parameters)
        return method


def read_file(path: str | Path) -> H5MDContents:
    """Read record, restart and description of a minimd file, and verify their checksums; see verify_frames for frames.

    Raises FileNotFoundError, OSError as opened, and OSError if it is damaged.  ValueError if it is not HDF5,
    or not written by minimd.
    """
    with opened(path) as h5:
        return contents_of(h5, path)


def contents_of(h5: h5py.File, path: str | Path) -> H5MDContents:
    """Record, restart and description of an open minimd file.
    path : for messages.
    Raises as read_file."""
    with damage_told(path):
        digest.check_description(h5)
        n_frames = digest.n_whole_frames(h5)
        group = h5["minimd"]
        attributes = group.attrs
        restart = digest.read_restart(h5)
        state = restart.checkpoint.state
        observers = digest.observers_of(h5, restart)
        lacks_results = any(
            observer.n_looks > h5[f"{digest.OBSERVERS}/{name}"].attrs.get("n_looks", 0)
            for name, observer in observers.items()
        )
        repaired = ""
        if restart.is_earlier:
            repaired = f"the newest restart in {path} is damaged; the one before it is used, of step {state.step}"
        system = _stored_system(group, restart.checkpoint)
        method = read_method(group)
        record = _stored_record(h5, system, n_frames)
        since = int(attributes.get("since", 0))
        record.conserves_momentum = method["conserves_momentum"] and since <= record.step[0]
        return H5MDContents(
            record=record,
            system=system,
            restart=restart.checkpoint,
            step=state.step,
            time=state.time,
            timestep=float(attributes["timestep"]),
            since=since,
            reservoir_energy=state.reservoir_energy,
            n_frames=n_frames,
            has_forces=f"{TRAJECTORY}/force" in h5,
            title=printable(str(attributes["title"])),
            scene=str(attributes["scene"]),
            repaired=repaired,
            observers=observers,
            lacks_results=lacks_results,
            **method,
        )


def frames_of(
    path: str | Path, numbers: Iterable[int], units: UnitSystem, observables: Iterable[str] = ()
) -> Iterator[Frame]:
    """Frames of a minimd file in its units, converted to rounding; with forces (else None), cell and the observables of
    these names if the file has them.
    Raises as opened."""
    to = factors(units)

    with opened(path) as h5, damage_told(path):
        trajectory = h5[TRAJECTORY]
        arrays = {
            "positions": trajectory["position/value"],
            "velocities": trajectory["velocity/value"],
        }
        if "force/value" in trajectory:
            arrays["forces"] = trajectory["force/value"]
        stored = h5["observables"]
        series = {
            name: stored[f"{name}/value"] for name in ("cell", *observables) if name in stored
        }

        for k in numbers:
            frame: dict[str, Any] = {name: array[k] / to[name] for name, array in arrays.items()}
            frame.setdefault("forces", None)
            values = {name: entries[k] for name, entries in series.items()}
            yield Frame(
                int(h5[STEPS][k]),
                float(h5["minimd/time"][k]),
                **frame,
                observables=values,
                cell=_cell_of(h5["minimd"], values["cell"]) if "cell" in values else None,
            )


def damage(path: str | Path) -> str:
    """The frames, or else the restart, of a minimd file that are not as they were written, in words; empty if there are
    none. The whole file is read in a child process, which damaged bytes may crash.
    Raises as read_file."""
    frames, restart = looked_at(path, partial(_damage, path))
    return frames or restart


def verify_frames(path: str | Path) -> None:
    """Raise OSError unless all frames of a minimd file are as they were written.
    Raises as read_file, too."""
    frames, _ = looked_at(path, partial(_damage, path))
    if frames:
        raise _damaged(path, f"{frames} are not those that were written")


def _damage(path: str | Path) -> tuple[str, str]:
    """The damaged frames and the damaged restart, in words; see damage."""
    with opened(path) as h5, damage_told(path):
        digest.check_description(h5)
        n_frames = digest.read_restart(h5).n_frames
        n_whole = digest.n_whole_frames(h5)
        frames = digest.damaged_frames(h5)
        if not frames and n_whole < n_frames:
            frames = f"frames from {n_whole} on"
        return frames, digest.damaged_restart(h5)


def _cell_of(group: h5py.Group, vectors: np.ndarray) -> Cell:
    """The cell with these vectors, (3, 3), of a file."""
    attributes = group.attrs
    return Cell(vectors, attributes["pbc"].astype(bool), int(attributes.get("dimensions", 3)))


def _stored_system(group: h5py.Group, restart: Checkpoint) -> System:
    names = group["species_names"]
    labels = names.asstr()[:] if h5py.check_string_dtype(names.dtype) else names[:]
    texts = group["topology"][:] if "topology" in group else np.zeros((0, 5, 1), np.uint8)
    return System(
        restart.state.positions,
        velocities=restart.state.velocities,
        cell=restart.state.cell or _cell_of(group, group["cell"][:]),
        species=np.array(labels.tolist())[group["species_index"][:]],
        **{name: group[name][:] for name in ("masses", "charges", *GROUPS) if name in group},
        units=SYSTEMS[group.attrs["units"]],
        constraints=read_constraints(group),
        topology=texts.view(f"S{texts.shape[-1]}")[..., 0].astype(str),
        sites=read_sites(group),
    )


def _stored_record(h5: h5py.File, system: System, n_frames: int) -> Record:
    stored = h5["observables"]
    names = [name for name in SERIES if name in stored]
    names += [name for name in stored if name not in SERIES and name != SPACING]
    series = {"step": h5[STEPS], "time": h5["minimd/time"]}
    series |= {name: stored[f"{name}/value"] for name in names}
    entries = {name: values[:n_frames] for name, values in series.items()}
    return Record.of(system.units, len(system), entries)


def read_observers(path: str | Path) -> dict[str, StoredObserver]:
    """The observers in an H5MD file by name, in their state at its restart:
    read_observers("run.h5md")["viscosity"].result().

    Raises OSError, ValueError for a file that does not exist, is damaged, or was not written by minimd.
    """
    return read_file(path).observers


def read_record(path: str | Path) -> Record:
    """The Record of all frames in an H5MD file, also of a run that was continued.
    Raises as read_observers."""
    return read_file(path).record
