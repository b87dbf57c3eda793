"""A scene file: its text, checked, and what it describes: atoms, potentials, method, bath, observers, files."""

import re
import tomllib
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any, TypeVar

from pydantic import ValidationError

from minimd.core.integrators.barostats import StochasticCellRescaling
from minimd.core.integrators.splitting import Splitting
from minimd.core.structure import units
from minimd.core.structure.lattice import constant_from_density, crystal
from minimd.core.structure.system import System, changed
from minimd.observers import Accumulator
from minimd.scene.problems import problems
from minimd.scene.section import Reading
from minimd.scene.sections import (
    OF_FILES,
    Numbers,
    SceneSections,
    WithFiles,
    as_sections,
    read_table,
    read_text,
)

D = TypeVar("D", bound="Document")
BYTE_ORDER_MARK = "\ufeff"  # with which editors of Windows begin UTF-8
# a key of tables in tables, for which tomllib would take gigabytes
DEEP_KEY = re.compile(r"(?<![\w\"'-])(?:[\w\"'-]+\s*\.\s*){64}")


@dataclass(frozen=True)
class Document:
    """A checked scene file.
    path : the file; paths of structure files are relative to its folder.
    text : of the file.
    sections : its content, checked, in the units of the engine."""

    path: Path
    text: str
    sections: SceneSections

    @property
    def units(self) -> units.UnitSystem:
        """The unit system of all numbers."""
        return units.SYSTEMS[self.sections.units]

    def system(self) -> System:
        """The atoms at the start, with their constraints.
        Raises ValueError, OSError, with the name of the file, for a structure that cannot be read or is impossible,
        or for impossible constraints."""
        structure = self.sections.structure
        water = self.sections.water
        if water is not None and structure.file is None:
            with blamed_on(f"{self.path}: water"):
                system = water.system(None)
        else:
            with blamed_on(f"{self.path}: structure"):
                system = self._from_lattice() if structure.file is None else self._from_file()
                changes = structure.model_dump(include={"species", "charges"}, exclude_none=True)
                system = changed(system, **changes)
                if water is not None:
                    system = water.system(system)
        return self.constrained(system)

    def potentials(self) -> list[Any]:
        """The potentials, those of water first, in the order of the file.
        Raises ValueError with the name of the file and the entry."""
        potentials: list[Any] = []
        if self.sections.water is not None:
            with blamed_on(f"{self.path}: water"):
                potentials += self.sections.water.potentials()
        for place, section in self._sections():
            with blamed_on(place):
                source = [SOURCES[section.kept_in]] if isinstance(section, WithFiles) else []
                potentials.append(section.potential(*(partial(read, self) for read in source)))
        return potentials

    def contents(self, kept_in: str) -> dict[str, Any]:
        """The contents of the files of potentials that a section has room for and does not hold, by name.
        Raises ValueError as potentials."""
        contents: dict[str, Any] = {}
        held = getattr(self.sections, kept_in)
        for place, section in self._sections():
            if isinstance(section, WithFiles) and section.kept_in == kept_in:
                with blamed_on(place):
                    for name in section.files:
                        if name not in held:
                            contents[name] = SOURCES[kept_in](self, name)
        return contents

    def _sections(self) -> Iterator[tuple[str, Any]]:
        """The sections of potentials, each with its place in the scene."""
        for index, section in enumerate(self.sections.potential):
            yield f"{self.path}: potential[{index}]", section

    def whole_text(self) -> str:
        """The text of the scene with all tables and files of potentials added to it: no other files are needed to make
        the potentials again."""
        files = self.contents("tables"), self.contents("files")
        return self.text + as_sections(*files, self.sections.units)

    def method(self) -> Splitting:
        """The integrator with its time step and its bath.
        Raises ValueError, with the name of the file."""
        with blamed_on(f"{self.path}: dynamics"):
            return self.sections.dynamics.integrator()

    def barostat(self) -> StochasticCellRescaling | None:
        """The barostat of the scene, or None."""
        section = self.sections.barostat
        dynamics = self.sections.dynamics
        return None if section is None else section.barostat(dynamics)

    def observers(self) -> list[Accumulator]:
        """New observers as described in the scene.
        Raises ValueError, with the file, if two have the same name."""
        made = [section.observer() for section in self.sections.observer]  # type: ignore[attr-defined]
        if len({one.name for one in made}) < len(made):
            raise ValueError(
                f"{self.path}: two observers have the same name; give one of them another name"
            )
        return made

    def trajectories(self, instead: Path | None = None) -> list[Path]:
        """The trajectory files, relative to the current folder.
        instead : one file in place of those of the scene."""
        names = self.sections.output.trajectory
        if instead is not None:
            return [instead]
        if names is None:
            names = self.path.stem + ".h5md"
        return [Path(name) for name in (names if isinstance(names, list) else [names])]

    def named_outputs(self, instead: Path | None = None) -> list[Path]:
        """Files that must not exist unless they may be replaced: trajectories, and a picture whose name is given."""
        plot = self.sections.output.plot
        files = self.trajectories(instead)
        if isinstance(plot, str) and instead is None:
            files.append(Path(plot))
        return files

    def plot_name(self, trajectories: list[Path], *, beside: bool = False) -> Path | None:
        """The picture that the scene asks for; None if it asks for none.
        beside : the trajectories replace those of the scene; then it is named after the first .h5md, None without one.
        Raises ValueError if no trajectory ends in .h5md, from which a picture is drawn, unless beside."""
        plot = self.sections.output.plot
        drawn = h5md_files(trajectories)
        if plot is False or (beside and not drawn):
            return None
        if not drawn:
            names = list(map(str, trajectories))
            raise ValueError(
                f"{self.path}: output.plot needs a trajectory that ends in .h5md; output.trajectory = {names}"
            )
        picture = Path(plot) if isinstance(plot, str) else drawn[0].with_suffix(".png")
        return drawn[0].with_suffix(picture.suffix) if beside else picture

    def _table(self, name: str) -> Numbers:
        """The numbers of a table.
        Raises ValueError as read_table."""
        table = self.sections.tables.get(name)
        if table is None:
            return read_table(self.path.parent / name)
        return Numbers(table.r, table.u)

    def _text(self, name: str) -> str:
        """The text of a file.
        Raises ValueError as read_text."""
        section = self.sections.files.get(name)
        return read_text(self.path.parent / name) if section is None else section.text

    def constrained(self, system: System) -> System:
        """Set the constraints of the scene, if it has a section for them, in place; return the same system.
        Raises ValueError, with the name of the file, for impossible ones."""
        section = self.sections.constraints
        if section is not None:
            with blamed_on(f"{self.path}: constraints"):
                system.constraints = section.constraints(system.bonds.tolist(), system.constraints)
        return system

    def _from_lattice(self) -> System:
        structure = self.sections.structure
        lattice = structure.lattice or ""
        element = structure.element
        mass = 1.0
        if self.units is units.ASE:
            from minimd.core.structure.elements import atomic_mass

            mass = atomic_mass(element or "")

        density = structure.density or 0.0
        edge = structure.lattice_constant or constant_from_density(lattice, density, mass)
        positions, edges = crystal(lattice, structure.repeat or [], edge)
        bonds: Any = structure.bonds
        planar = positions.shape[1] == 2
        return System(
            positions,
            masses=mass,
            cell=edges,
            pbc=structure.pbc,
            species=[element] * len(positions) if element else None,
            bonds=bonds,
            units=self.units,
            planar=planar,
        )

    def _from_file(self) -> System:
        from minimd.core.files.structure_file import system_from_file

        structure = self.sections.structure
        file = self.path.parent / (structure.file or "")
        options: dict[str, Any] = structure.model_dump(include=set(OF_FILES))
        options["units"] = self.units
        options["bonds"] = [] if self.sections.water else structure.bonds  # water has its own
        system = system_from_file(file, structure.cell, structure.pbc, **options)
        return system.in_plane() if structure.planar else system


SOURCES: Mapping[str, Callable[[Document, str], Any]] = {
    "tables": Document._table,
    "files": Document._text,
}


def h5md_files(files: Iterable[Path]) -> list[Path]:
    """The files that end in .h5md, which minimd can resume, check and plot."""
    return [file for file in files if file.suffix.lower() == ".h5md"]


def stored(kind: type[D], text: str, file: Path) -> D:
    """The scene in the file of a run, which others may have made: no other file is read for it.
    Raises ValueError as parsed, and if it names a table that is not in it."""
    document = parsed(kind, text, file)
    for index, section in enumerate(document.sections.potential):
        if not isinstance(section, WithFiles):
            continue
        kept: str = section.kept_in
        for name in section.files:
            if name not in getattr(document.sections, kept):
                raise ValueError(
                    f"{file}: potential[{index}] of the stored scene needs {kept}.{name!r}, which the scene does not "
                    "hold"
                )
    return document


def potentials_of_scene(scene: str, words: Sequence[str], file: Path) -> list[Any]:
    """The potentials of a scene, given as its text.
    words, file : the potentials of the run in words, and its file, for the messages.
    Raises ValueError if there is no scene, or as stored."""
    if scene:
        return stored(Document, scene, file).potentials()
    raise ValueError(
        f"file {str(file)!r} holds no scene from which to rebuild its potentials, {'; '.join(words)}; pass the "
        "potentials of the script, as in md.Simulation.resume(file, [...]); or give a --scene"
    )


def parsed(kind: type[D], text: str, path: Path) -> D:
    """Check the text of a scene file; a byte order mark is left out.
    kind : Document, or Scene.
    path : see Document.
    Raises ValueError, with one line for each problem: the file, the place, the value and what is expected."""
    text = text.removeprefix(BYTE_ORDER_MARK)
    try:
        if DEEP_KEY.search(text):
            raise RecursionError
        reading = Reading(tomllib.loads(text))
        return kind(path, text, SceneSections.model_validate(reading.document, context=reading))
    except tomllib.TOMLDecodeError as error:
        line = text.rstrip().rpartition("\n")[2]  # for a message that says "at end of document"
        place = re.search(r"at line (\d+)", str(error))
        if place:
            line = text.split("\n")[int(place[1]) - 1]
        raise ValueError(f"{path}: this is not valid TOML: {error}, in {line[:120]!r}") from None
    except RecursionError:
        raise ValueError(f"{path}: its tables are nested too deeply for a scene file") from None
    except ValidationError as error:
        lines = [f"{path}: {sentence}" for sentence in problems(reading, error)]
        raise ValueError("\n".join(lines)) from None
    except ValueError as error:  # a number of more digits than Python reads
        raise ValueError(f"{path}: {error}") from None


@contextmanager
def blamed_on(place: str) -> Iterator[None]:
    """Begin the message of an error with the place in the scene that caused it."""
    try:
        yield
    except (ValueError, TypeError, NotImplementedError) as error:
        raise ValueError(f"{place}: {error}") from None
