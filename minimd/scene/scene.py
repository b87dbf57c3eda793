"""Scenes: a scene file, and the simulation that it describes."""

from pathlib import Path

from minimd.core.simulation.simulation import Simulation
from minimd.core.structure.checks import checked_path
from minimd.core.structure.system import System
from minimd.scene.document import Document, blamed_on, parsed


class Scene(Document):
    """A checked scene file."""

    def simulation(self, system: System | None = None) -> Simulation:
        """The simulation at its start; if the scene gives a temperature, velocities are drawn at it.

        system : a state from which to go on, with its velocities, in place of the structure of the scene; its
            constraints are kept unless the scene has a section [constraints].
        """
        dynamics = self.sections.dynamics
        start = self.system() if system is None else self.constrained(system.copy())
        potentials = self.potentials()
        method = self.method()

        with blamed_on(str(self.path)):
            simulation = Simulation(
                start,
                potentials,
                method,
                threads=dynamics.threads,
                precision=dynamics.precision,
                barostat=self.barostat(),
            )

        simulation.engine.notes.update(title=self.sections.title, scene=self.whole_text())
        for name in self.sections.output.extra_observables:
            with blamed_on(f"{self.path}: output.{name}"):
                simulation.extra_observables = (*simulation.extra_observables, name)
        if system is None and dynamics.first_temperature is not None:
            simulation.set_temperature(dynamics.first_temperature, dynamics.seed)
        return simulation


def load_scene(path: str | Path) -> Scene:
    """Read and check a scene file.

    Raises
    ------
    OSError : if it cannot be read.
    ValueError : if it is not valid TOML, or wrong: one line for each problem, with the
        file, the place, the value and what is expected.
    """
    file = checked_path("path", path)
    try:
        content = file.read_bytes()
        if content.startswith(b"\x89HDF"):
            raise ValueError(
                f"{file} is not a scene file (TOML), but the file of a run: minimd resume continues it; in a script, "
                "md.Simulation.resume(file) has its state"
            )

        return parse_scene(content.decode("utf-8"), file)
    except FileNotFoundError:
        raise FileNotFoundError(f"scene file {str(file)!r} does not exist") from None
    except UnicodeDecodeError as error:
        raise ValueError(
            f"{file}: a scene file (TOML) must be UTF-8 text, which this is not: {error}"
        ) from None
    except OSError as error:
        raise OSError(f"scene file {str(file)!r} cannot be read: {error.strerror}") from None


def parse_scene(text: str, path: Path) -> Scene:
    """Check the text of a scene file.
    path : the file; paths in it are relative to its folder.
    Raises ValueError as load_scene."""
    return parsed(Scene, text, path)
