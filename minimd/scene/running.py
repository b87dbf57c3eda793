"""Running a scene from start to report, and telling so all the while."""

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path

import numpy as np

from minimd.diagnosis.crash_report import place_of
from minimd.files.h5md_writer import H5MDContents, H5MDWriter, annotate, read_file
from minimd.files.trajectory import checked_output
from minimd.potentials import PairPotential
from minimd.scene.document import Scene, parse_scene
from minimd.scene.ending import kept, nothing_written
from minimd.simulation.simulation import Observer, Simulation
from minimd.structure import units
from minimd.structure.constraints import DistanceConstraints, FixedAtoms
from minimd.structure.errors import ConstraintError, NonFiniteError

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
    """Build a scene, minimize and equilibrate it, run it, and write its files.

    Parameters
    ----------
    steps : instead of those of the scene.  trajectory : one file instead of those of the scene; the picture lies beside it.
    overwrite : replace files that exist; without it those that were named are refused before anything is computed, and
        a picture that was not named is left as it is.
    progress : as for Simulation.run.  tell : gets a line about each thing that is done.

    Raises
    ------
    ValueError, OSError : for what cannot be built or written.  NonFiniteError, KeyboardInterrupt : as Simulation.run.
    """
    dynamics, output = scene.sections.dynamics, scene.sections.output
    files = scene.trajectories() if trajectory is None else [trajectory]
    picture = scene.plot_name(files) if trajectory is None else scene.plot_beside(trajectory)
    n_steps = dynamics.steps if steps is None else steps
    check_outputs(files, picture if scene.names_its_plot and trajectory is None else None, overwrite)
    simulation = scene.simulation()
    for line in description(scene, simulation, n_steps):
        tell(line)
    place = place_of(True, files)
    with scene_kept(scene):
        minimize(scene, simulation, progress, tell)
        equilibrate(scene, simulation, progress, tell, place)
    with kept(files, n_steps), scene_kept(scene):
        simulation.run(
            n_steps,
            every=output.every,
            trajectory=files,
            store_forces=output.forces,
            overwrite=overwrite,
            observers=[_scene_keeper(scene, files)],
            progress=progress,
            crash_report=place or False,
        )
    tell(str(simulation.report()))
    if picture is not None:
        with kept(files, n_steps):
            files = [*files, *_drawn(files, picture, overwrite, tell)]
    tell(f"written        {', '.join(map(str, files))}")
    return simulation


def _drawn(files: Sequence[Path], picture: Path, overwrite: bool, tell: Tell) -> list[Path]:
    """Draw the picture of a run; none if that would replace one that stands there."""
    if picture.exists() and not overwrite:
        tell(f"not drawn      {picture} exists and is kept; draw with: minimd plot")
        return []
    tell(f"drawing        {picture} ...")
    from minimd.analysis.plot import plot_file

    return [plot_file(next(file for file in files if file.suffix.lower() == ".h5md"), picture)]


def resume_run(
    file: str | Path, steps: int | None = None, *, scene: Scene | None = None, progress: bool | None = None, tell: Tell = print
) -> Simulation:
    """Go on with the run in an H5MD file, from its restart, and append to it; its other trajectories are not continued.

    A run from a script has no scene in its file. There, read_file(file).system of minimd.h5md is the System at the restart, from
    which a new Simulation starts; with its step and time set to those of the contents, H5MDWriter.append_to continues the file.

    Parameters
    ----------
    steps : how many more; up to the end of the scene if not given.
    scene : whose potentials and method are used, instead of those of the scene that is stored in the file; it may name no other
        constraints than the file holds.

    Raises
    ------
    ValueError, OSError : for a file that cannot be continued or holds no scene.
    NonFiniteError, KeyboardInterrupt : as Simulation.run.
    """
    contents = read_file(file)
    if scene is None and not contents.scene:
        raise ValueError(f"file {str(file)!r} holds no scene from which to rebuild its potentials; name the scene file with --scene")
    scene = scene or parse_scene(contents.scene, Path(file))
    steps = _steps_left(contents, scene, file) if steps is None else steps
    if contents.scene and (other := differences(parse_scene(contents.scene, Path(file)), scene)):
        tell(f"NOTE           {', '.join(other)} differ from those of the run so far: its energies before and after are not comparable")
    simulation = scene.simulation(contents.system)
    simulation.step, simulation.time, simulation.heat = contents.step, contents.time, contents.heat
    for line in description(scene, simulation, steps):
        tell(line)
    tell(f"resumed        at step {contents.step}, {_time(contents.time, scene.units)}, behind {contents.n_frames} frames")
    if len(scene.trajectories()) > 1:
        tell(f"               only {file} is continued; the other trajectories of the scene stay as they are")
    with kept([Path(file)], contents.step + steps), scene_kept(scene):
        _append(Path(file), simulation, steps, scene.sections.output.every, progress)
    tell(str(simulation.report()))
    tell(f"written        {file}")
    return simulation


def differences(one: Scene, other: Scene) -> list[str]:
    """Keys of two scenes that decide over forces and steps, and differ."""
    keys = [f"dynamics.{key}" for key in ("method", "timestep") if getattr(one.sections.dynamics, key) != getattr(other.sections.dynamics, key)]
    return keys + ["potential"] * (one.sections.potential != other.sections.potential)


def _append(file: Path, simulation: Simulation, steps: int, every: int, progress: bool | None) -> None:
    """Run, and append the frames to a file."""
    writer, completed = H5MDWriter.append_to(file, simulation), False
    try:
        observers = [lambda run: writer.write(run.frame())]
        simulation.run(steps, every=every, observers=observers, progress=progress, crash_report=place_of(True, file) or False)
        completed = True
    finally:
        writer.close(completed)


def _steps_left(contents: H5MDContents, scene: Scene, file: str | Path) -> int:
    """Steps from the restart to the end of the scene.  Raises ValueError if there are none."""
    left = scene.sections.dynamics.steps - contents.step
    if left <= 0:
        raise ValueError(
            f"the run in {str(file)!r} has come to the end of its scene: it stands at step {contents.step}, dynamics.steps = "
            f"{scene.sections.dynamics.steps}; say with --steps how many more"
        )
    return left


def _scene_keeper(scene: Scene, files: Sequence[Path]) -> Observer:
    """An observer that puts the scene into its H5MD files at the first frame, so that even a killed run can be resumed."""

    def keep_scene(run: Simulation) -> None:
        for file in files if run.step == 0 else ():
            if file.suffix.lower() == ".h5md":
                with suppress(OSError):  # a full disk is told of by the next frame
                    annotate(file, title=scene.sections.title or None, scene=scene.text)

    return keep_scene


@contextmanager
def scene_kept(scene: Scene) -> Iterator[None]:
    """Put the scene into the crash report of a run that fails, so that it can be replayed."""
    try:
        yield
    except (NonFiniteError, ConstraintError) as error:
        if error.file is not None:
            with suppress(OSError, ValueError):  # the failure itself must be heard
                annotate(error.file, title=scene.sections.title or None, scene=scene.text)
        raise


def check_outputs(trajectories: Sequence[Path], picture: Path | None, overwrite: bool) -> None:
    """Refuse what cannot be written.  Raises ValueError, OSError as trajectory.checked_output."""
    for file in trajectories:
        checked_output(file, overwrite)
    if picture is not None and picture.exists() and not overwrite:
        raise FileExistsError(f"output {str(picture)!r} exists; choose another name, or pass overwrite=True")
    if picture is not None and not picture.absolute().parent.is_dir():
        raise FileNotFoundError(f"output folder {str(picture.absolute().parent)!r} does not exist; make it first")


def minimize(scene: Scene, simulation: Simulation, progress: bool | None, tell: Tell) -> None:
    """Move the atoms to a minimum, if the scene asks for it."""
    plan = scene.sections.minimization
    if plan is None:
        return
    with nothing_written():
        found = simulation.minimize(
            force_tolerance=plan.force_tolerance, max_steps=plan.max_steps, max_step_length=plan.max_step_length, progress=progress
        )
    if scene.sections.dynamics.temperature is not None:
        simulation.set_temperature(scene.sections.dynamics.temperature, scene.sections.dynamics.seed)  # rigid bonds have turned
    tell(str(found))


def equilibrate(scene: Scene, simulation: Simulation, progress: bool | None, tell: Tell, crash_report: Path | None = None) -> None:
    """Run the equilibration of the scene, if it has one."""
    plan = scene.sections.equilibration
    target = (plan and plan.temperature) or scene.sections.dynamics.temperature
    if plan is None or target is None or plan.steps == 0:  # SceneSections has checked that there is a target
        return
    tell(f"equilibration  {plan.steps} steps, rescaled to {target:g} {scene.units.temperature} every {plan.rescale_every}")
    with nothing_written(" of the equilibration"):
        simulation.equilibrate(plan.steps, target, every=plan.rescale_every, progress=progress, crash_report=crash_report)


def description(scene: Scene, simulation: Simulation, n_steps: int) -> list[str]:
    """What has been built and will be run, in lines."""
    dynamics, output = scene.sections.dynamics, scene.sections.output
    duration = n_steps * dynamics.timestep
    lines = [
        f"scene          {scene.path}" + (f": {scene.sections.title}" if scene.sections.title else ""),
        f"system         {_atoms(simulation)}",
        f"cell           {_cell(simulation)}",
        *([f"constraints    {_constraints(simulation)}"] if simulation.constraints else []),
        *(f"potential      {_potential(potential, scene.units)}" for potential in scene.potentials()),
        f"method         {dynamics.method}, timestep {_time(dynamics.timestep, scene.units)}" + _bath(scene),
    ]
    return [*lines, f"run            {n_steps} steps = {_time(duration, scene.units)}, observed every {output.every}"]


def _bath(scene: Scene) -> str:
    dynamics = scene.sections.dynamics
    if dynamics.relaxation_time is None:
        return ""
    return f", bath at {dynamics.temperature:g} {scene.units.temperature}, relaxation time {_time(dynamics.relaxation_time, scene.units)}"


def _atoms(simulation: Simulation) -> str:
    system = simulation.system
    counts = np.bincount(system.species_index)
    names = ", ".join(f"{count} {name}" for name, count in zip(system.species_names, counts, strict=True))
    bonds = f"; {len(system.bonds)} bonds" if len(system.bonds) else ""
    return f"{len(system)} atoms ({names}){bonds}"


def _constraints(simulation: Simulation) -> str:
    lengths = [f"lengths kept: {len(one.pairs)}" for one in simulation.constraints if isinstance(one, DistanceConstraints)]
    fixed = [f"atoms fixed: {len(one.atoms)}" for one in simulation.constraints if isinstance(one, FixedAtoms)]
    return ", ".join([*lengths, *fixed]) + f"; {simulation.n_dof} degrees of freedom"


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
