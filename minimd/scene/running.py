"""Running a scene from start to report, and telling so all the while."""

from collections.abc import Callable, Sequence
from contextlib import suppress
from pathlib import Path

import numpy as np

from minimd import units
from minimd.h5md import H5MDWriter, annotate, read_file
from minimd.potentials import PairPotential
from minimd.scene.document import Scene, parse_scene
from minimd.simulation import Observer, Simulation
from minimd.trajectory import checked_output

Tell = Callable[[str], None]


def run_scene(
    scene: Scene,
    *,
    steps: int | None = None,
    trajectory: Path | None = None,
    overwrite: bool = False,
    progress: bool | None = None,
    tell: Tell = print,
) -> Simulation:
    """Build a scene, equilibrate it, run it, and write its files.

    Parameters
    ----------
    steps : instead of those of the scene.  trajectory : one file instead of those of the scene.
    overwrite : replace files that exist; without it they are refused before anything is computed.
    progress : as for Simulation.run.  tell : gets a line about each thing that is done.

    Raises
    ------
    ValueError, OSError : for what cannot be built or written.  NonFiniteError, KeyboardInterrupt : as Simulation.run.
    """
    dynamics, output = scene.sections.dynamics, scene.sections.output
    files = scene.trajectories() if trajectory is None else [trajectory]
    picture = scene.plot_name(files)
    n_steps = dynamics.steps if steps is None else steps
    check_outputs(files, picture, overwrite)
    simulation = scene.simulation()
    for line in description(scene, simulation, n_steps):
        tell(line)
    equilibrate(scene, simulation, progress, tell)
    simulation.run(
        n_steps,
        every=output.every,
        trajectory=files,
        store_forces=output.forces,
        overwrite=overwrite,
        observers=[_scene_keeper(scene, files)],
        progress=progress,
    )
    tell(str(simulation.report()))
    if picture is not None:
        from minimd.plot import plot_file

        drawn = next(file for file in files if file.suffix.lower() == ".h5md")
        files = [*files, plot_file(drawn, picture)]
    tell(f"written        {', '.join(map(str, files))}")
    return simulation


def resume_run(file: Path, steps: int, *, scene: Scene | None = None, progress: bool | None = None, tell: Tell = print) -> Simulation:
    """Go on with the run in an H5MD file for some more steps, from its restart, and append to it.

    scene : whose potentials and method are used, instead of those of the scene that is stored in the file.

    Raises
    ------
    ValueError, OSError : for a file that cannot be continued or holds no scene.
    NonFiniteError, KeyboardInterrupt : as Simulation.run.
    """
    contents = read_file(file)
    if scene is None and not contents.scene:
        raise ValueError(f"file {str(file)!r} holds no scene from which to rebuild its potentials; name the scene file with --scene")
    scene = scene or parse_scene(contents.scene, file)
    simulation = scene.simulation(contents.system)
    simulation.step, simulation.time = contents.step, contents.time
    for line in description(scene, simulation, steps):
        tell(line)
    tell(f"resumed        at step {contents.step}, {_time(contents.time, scene.units)}, behind {contents.n_frames} frames")
    writer = H5MDWriter.append_to(file, simulation)
    try:
        simulation.run(steps, every=scene.sections.output.every, observers=[lambda run: writer.write(run.frame())], progress=progress)
    finally:
        writer.close()
    tell(str(simulation.report()))
    tell(f"written        {file}")
    return simulation


def _scene_keeper(scene: Scene, files: Sequence[Path]) -> Observer:
    """An observer that puts the scene into its H5MD files at the first frame, so that even a killed run can be resumed."""

    def keep_scene(run: Simulation) -> None:
        for file in files if run.step == 0 else ():
            if file.suffix.lower() == ".h5md":
                with suppress(OSError):  # a full disk is told of by the next frame
                    annotate(file, title=scene.sections.title or None, scene=scene.text)

    return keep_scene


def check_outputs(trajectories: Sequence[Path], picture: Path | None, overwrite: bool) -> None:
    """Refuse what cannot be written, and leave nothing behind by trying.

    Raises
    ------
    ValueError, OSError : as trajectory.checked_output.
    """
    for file in trajectories:
        is_new = not file.exists()
        checked_output(file, overwrite)
        if is_new:
            file.unlink()
    if picture is not None and picture.exists() and not overwrite:
        raise FileExistsError(f"output {str(picture)!r} exists; choose another name, or say overwrite")
    if picture is not None and not picture.absolute().parent.is_dir():
        raise FileNotFoundError(f"output folder {str(picture.absolute().parent)!r} does not exist; make it first")


def equilibrate(scene: Scene, simulation: Simulation, progress: bool | None, tell: Tell) -> None:
    """Run the equilibration of the scene, if it has one."""
    plan = scene.sections.equilibration
    if plan is None or plan.steps == 0:
        return
    target = plan.temperature or scene.sections.dynamics.temperature
    tell(f"equilibration  {plan.steps} steps, rescaled to {target:g} {scene.units.temperature} every {plan.rescale_every}")
    simulation.equilibrate(plan.steps, target, every=plan.rescale_every, progress=progress)


def description(scene: Scene, simulation: Simulation, n_steps: int) -> list[str]:
    """What has been built and will be run, in lines."""
    dynamics, output = scene.sections.dynamics, scene.sections.output
    duration = n_steps * dynamics.timestep
    lines = [
        f"scene          {scene.path}" + (f": {scene.sections.title}" if scene.sections.title else ""),
        f"system         {_atoms(simulation)}",
        f"cell           {_cell(simulation)}",
        *(f"potential      {_potential(potential, scene.units)}" for potential in scene.potentials()),
        f"method         {dynamics.method}, timestep {_time(dynamics.timestep, scene.units)}",
    ]
    return [*lines, f"run            {n_steps} steps = {_time(duration, scene.units)}, observed every {output.every}"]


def _atoms(simulation: Simulation) -> str:
    system = simulation.system
    counts = np.bincount(system.species_index)
    names = ", ".join(f"{count} {name}" for name, count in zip(system.species_names, counts, strict=True))
    bonds = f"; {len(system.bonds)} bonds" if len(system.bonds) else ""
    return f"{len(system)} atoms ({names}){bonds}"


def _cell(simulation: Simulation) -> str:
    system = simulation.system
    if not system.cell.is_periodic:
        return "none, open in all directions"
    lengths = np.linalg.norm(system.cell.vectors, axis=1)
    periodic = " ".join(axis for axis, is_periodic in zip("abc", system.cell.pbc, strict=True) if is_periodic)
    return f"{' × '.join(f'{length:.4g}' for length in lengths)} {system.units.length}, periodic along {periodic}"


def _potential(potential: object, unit_system: units.UnitSystem) -> str:
    name = type(potential).__name__
    if not isinstance(potential, PairPotential):
        return name
    if np.isinf(potential.cutoff):
        return f"{name}, no cutoff"
    return f"{name}, cutoff {potential.cutoff:g} {unit_system.length}, {potential.truncation}"


def _time(duration: float, unit_system: units.UnitSystem) -> str:
    if unit_system is units.LJ:
        return f"{duration:.4g} {unit_system.time}"
    femtoseconds = duration / units.FEMTOSECOND
    return f"{femtoseconds:.4g} fs" if femtoseconds < 1000.0 else f"{femtoseconds / 1000.0:.6g} ps"
