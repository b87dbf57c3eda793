"""A scene file, read and checked, and the simulation that it describes."""

import re
import tomllib
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from pydantic import ValidationError

from minimd.diagnosis.shadow_energy import check_has_shadow
from minimd.integrators import Splitting
from minimd.scene.problems import problems
from minimd.scene.section import Reading
from minimd.scene.sections import SceneSections
from minimd.simulation.simulation import Simulation
from minimd.structure import units
from minimd.structure.lattice import constant_from_density, crystal
from minimd.structure.system import System


@dataclass(frozen=True)
class Scene:
    """A checked scene file.

    Attributes
    ----------
    path : the file; paths of structure files are relative to its folder.  text : of the file.
    sections : its content, checked, in the units of the engine.
    """

    path: Path
    text: str
    sections: SceneSections

    @property
    def units(self) -> units.UnitSystem:
        """The unit system of all numbers."""
        return units.SYSTEMS[self.sections.units]

    def system(self) -> System:
        """The atoms at the start of the scene, with their constraints.

        Raises
        ------
        ValueError, OSError : naming the file, for a structure that cannot be read or is impossible, or for impossible constraints.
        """
        with _blamed_on(f"{self.path}: structure"):
            system = self._from_lattice() if self.sections.structure.file is None else self._from_file()
        return self._constrained(system)

    def potentials(self) -> list[Any]:
        """The potentials, in the order of the file.  Raises ValueError, naming the file and the entry."""
        made = []
        for index, section in enumerate(self.sections.potential):
            with _blamed_on(f"{self.path}: potential[{index}]"):
                made.append(section.potential())
        return made

    def method(self) -> Splitting:
        """The integrator with its time step, and its bath if it has one.  Raises ValueError, naming the file, for numbers it refuses."""
        with _blamed_on(f"{self.path}: dynamics"):
            return self.sections.dynamics.integrator()

    def simulation(self, system: System | None = None) -> Simulation:
        """The simulation at its start, with velocities drawn at the temperature of the scene, if it names one.

        system : a state to go on from, instead of the structure of the scene; it keeps its velocities, and its constraints unless the
            scene names others.
        """
        dynamics = self.sections.dynamics
        start, potentials, method = self.system() if system is None else self._constrained(system.copy()), self.potentials(), self.method()
        with _blamed_on(str(self.path)):
            simulation = Simulation(start, potentials, method, threads=dynamics.threads, precision=dynamics.precision)
        if self.sections.output.shadow_energy:
            simulation.extra_observables = ("shadow_energy",)
            with _blamed_on(f"{self.path}: output.shadow_energy"):
                check_has_shadow(simulation.engine)
        if system is None and dynamics.temperature is not None:
            simulation.set_temperature(dynamics.temperature, dynamics.seed)
        return simulation

    def trajectories(self) -> list[Path]:
        """The trajectory files, relative to the current folder."""
        named = self.sections.output.trajectory
        several = [self.path.stem + ".h5md"] if named is None else [named] if isinstance(named, str) else named
        return [Path(name) for name in several]

    def plot_name(self, trajectories: list[Path], *, beside: bool = False) -> Path | None:
        """The picture that the scene asks for; None if it asks for none.

        beside : the trajectories replace those of the scene. The picture is then named after them, and None where it cannot be drawn.

        Raises
        ------
        ValueError : if no trajectory ends in .h5md, from which a picture is drawn, unless beside.
        """
        plot, drawn = self.sections.output.plot, [file for file in trajectories if file.suffix.lower() == ".h5md"]
        if plot is False or (beside and not drawn):
            return None
        if not drawn:
            raise ValueError(f"{self.path}: output.plot needs a trajectory that ends in .h5md; output.trajectory = {list(map(str, trajectories))}")
        if isinstance(plot, str):
            return drawn[0].with_suffix(Path(plot).suffix) if beside else Path(plot)
        return drawn[0].with_suffix(".png")

    def _constrained(self, system: System) -> System:
        """A system with the constraints of the scene."""
        section = self.sections.constraints
        if section is not None:
            with _blamed_on(f"{self.path}: constraints"):
                system.constraints = section.constraints(self.sections.structure.bonds, system.constraints)
        return system

    def _from_lattice(self) -> System:
        structure, unit_system = self.sections.structure, self.units
        lattice, element, mass = structure.lattice or "", structure.element, 1.0
        if unit_system is units.ASE:
            from minimd.files.structure_file import atomic_mass

            mass = atomic_mass(element or "")
        edge = structure.lattice_constant or constant_from_density(lattice, structure.density or 0.0, mass)
        positions, edges = crystal(lattice, structure.repeat or [], edge)
        species = structure.species or (element and [element] * len(positions))
        return System(positions, masses=mass, cell=edges, pbc=structure.pbc, species=species, bonds=structure.bonds, units=unit_system)

    def _from_file(self) -> System:
        structure, reduced = self.sections.structure, self.units is units.LJ
        from minimd.files.structure_file import system_from_file

        read = system_from_file(self.path.parent / (structure.file or ""), structure.cell, structure.pbc)
        return System(
            read.positions,
            masses=None if reduced else read.masses,
            velocities=None if reduced else read.velocities,
            cell=read.cell,
            species=structure.species or read.species,
            bonds=structure.bonds,
            units=self.units,
            constraints=read.constraints,
        )


def load_scene(path: str | Path) -> Scene:
    """Read and check a scene file.

    Raises
    ------
    OSError : if it cannot be read.  ValueError : if it is no TOML or something in it is wrong: one line for each problem, with
        the file, the place, the value and what is expected.
    """
    file = Path(path)
    try:
        return parse_scene(file.read_text(encoding="utf-8"), file)
    except FileNotFoundError:
        raise FileNotFoundError(f"scene file {str(file)!r} does not exist") from None
    except UnicodeDecodeError as error:
        raise ValueError(f"{file}: a scene file must be UTF-8 text: {error}") from None
    except OSError as error:
        raise OSError(f"scene file {str(file)!r} cannot be read: {error.strerror}") from None


def parse_scene(text: str, path: Path) -> Scene:
    """Check the text of a scene file.  path : its name in messages; paths of structure files are relative to its folder.

    Raises
    ------
    ValueError : as load_scene.
    """
    try:
        reading = Reading(tomllib.loads(text))
        return Scene(path, text, SceneSections.model_validate(reading.document, context=reading))
    except tomllib.TOMLDecodeError as error:
        place = re.search(r"at line (\d+)", str(error))  # else it is "at end of document"
        line = text.split("\n")[int(place[1]) - 1] if place else text.rstrip().rpartition("\n")[2]
        raise ValueError(f"{path}: this is no TOML: {error}, in {line!r}") from None
    except ValidationError as error:
        raise ValueError("\n".join(f"{path}: {sentence}" for sentence in problems(reading, error))) from None


@contextmanager
def _blamed_on(place: str) -> Iterator[None]:
    """Begin the message of an error with the place in the scene that has caused it."""
    try:
        yield
    except (ValueError, TypeError) as error:
        raise ValueError(f"{place}: {error}") from None
