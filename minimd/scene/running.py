"""Running a scene from start to report, with a line about each thing that is done."""

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path

import numpy as np

from minimd.files.crash_file import crash_file_place
from minimd.files.h5md_reader import H5MDContents, read_file
from minimd.files.h5md_writer import H5MDWriter, annotate
from minimd.files.trajectory import checked_output
from minimd.potentials import PairPotential
from minimd.scene.document import Scene, parse_scene
from minimd.scene.ending import kept, nothing_written
from minimd.simulation.simulation import Observer, Simulation
from minimd.structure import units
from minimd.structure.constraints import FixedAtoms
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
    picture = scene.plot_name(files, beside=trajectory is not None)
    n_steps = dynamics.steps if steps is None else steps
    check_outputs(files, picture if isinstance(output.plot, str) and trajectory is None else None, overwrite)
    simulation = scene.simulation()
    for line in description(scene, simulation, n_steps):
        tell(line)
    place = crash_file_place(True, files)
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
    if picture is not None and picture.exists() and not overwrite:
        tell(f"not drawn      {picture} exists and is kept; draw with: minimd plot")
    elif picture is not None:
        from minimd.analysis.plot import plot_file

        tell(f"drawing        {picture} ...")
        with kept(files, n_steps):
            files = [*files, plot_file(next(file for file in files if file.suffix.lower() == ".h5md"), picture)]
    tell(f"written        {', '.join(map(str, files))}")
    return simulation


def resume_run(
    file: str | Path, steps: int | None = None, *, scene: Scene | None = None, progress: bool | None = None, tell: Tell = print
) -> Simulation:
    """Go on with the run in an H5MD file, from its restart, and append to it; other trajectories of the run are not continued.

    The file of a run from a script has no scene. Its restart is read_file(file).system, see minimd.files.h5md_writer: a new Simulation
    starts from there, and with step and time set to those of the contents H5MDWriter.append_to continues the file.

    Parameters
    ----------
    steps : how many more; up to the end of the scene if not given.
    scene : gives potentials and method, instead of the scene in the file; it must have the constraints of the file.

    Raises
    ------
    ValueError, OSError : for a file that cannot be continued, or has no scene.
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
    simulation.step, simulation.time, simulation.reservoir_energy = contents.step, contents.time, contents.reservoir_energy
    for line in description(scene, simulation, steps):
        tell(line)
    tell(f"resumed        at step {contents.step}, {scene.units.shown(contents.time)}, after {contents.n_frames} frames")
    if len(scene.trajectories()) > 1:
        tell(f"               only {file} is continued; the other trajectories of the scene stay as they are")
    with kept([Path(file)], contents.step + steps), scene_kept(scene):
        _run_and_append(Path(file), simulation, steps, scene.sections.output.every, progress)
    tell(str(simulation.report()))
    tell(f"written        {file}")
    return simulation


def differences(one: Scene, other: Scene) -> list[str]:
    """Keys that have different values in two scenes, of those that determine forces and steps."""
    keys = [f"dynamics.{key}" for key in ("method", "timestep") if getattr(one.sections.dynamics, key) != getattr(other.sections.dynamics, key)]
    return keys + ["potential"] * (one.sections.potential != other.sections.potential)


def _run_and_append(file: Path, simulation: Simulation, steps: int, every: int, progress: bool | None) -> None:
    """Run, and append the frames to the file."""
    writer, completed = H5MDWriter.append_to(file, simulation.engine), False
    try:
        observers = [lambda run: writer.write(run.frame())]
        simulation.run(steps, every=every, observers=observers, progress=progress, crash_report=crash_file_place(True, file) or False)
        completed = True
    finally:
        writer.close(completed)


def _steps_left(contents: H5MDContents, scene: Scene, file: str | Path) -> int:
    """Steps from the restart to the end of the scene.  Raises ValueError if there are none."""
    left = scene.sections.dynamics.steps - contents.step
    if left <= 0:
        raise ValueError(
            f"the run in {str(file)!r} has reached the end of its scene: it stands at step {contents.step}, dynamics.steps = "
            f"{scene.sections.dynamics.steps}; give the number of further steps with --steps"
        )
    return left


def _scene_keeper(scene: Scene, files: Sequence[Path]) -> Observer:
    """An observer that stores the scene in its H5MD files at the first frame, so that even a killed run can be resumed."""

    def keep_scene(run: Simulation) -> None:
        for file in files if run.step == 0 else ():
            if file.suffix.lower() == ".h5md":
                with suppress(OSError):  # the next frame reports a full disk
                    annotate(file, title=scene.sections.title or None, scene=scene.text)

    return keep_scene


@contextmanager
def scene_kept(scene: Scene) -> Iterator[None]:
    """Store the scene in the crash file of a run that fails, so that the run can be replayed."""
    try:
        yield
    except (NonFiniteError, ConstraintError) as error:
        if error.file is not None:
            with suppress(OSError, ValueError):  # the failure itself is reported
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
    plan, dynamics = scene.sections.minimization, scene.sections.dynamics
    if plan is None:
        return
    with nothing_written():
        found = simulation.minimize(**plan.model_dump(), progress=progress)
    if dynamics.temperature is not None:
        simulation.set_temperature(dynamics.temperature, dynamics.seed)  # anew: rigid bonds have turned
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
    """Lines about what has been built and will be run."""
    dynamics, shown = scene.sections.dynamics, scene.units.shown
    relaxation = dynamics.relaxation_time
    bath = f", bath at {dynamics.temperature:g} {scene.units.temperature}, relaxation time {shown(relaxation)}" if relaxation else ""
    return [
        f"scene          {scene.path}" + (f": {scene.sections.title}" if scene.sections.title else ""),
        f"system         {_atoms(simulation)}",
        f"cell           {_cell(simulation)}",
        *([f"constraints    {_constraints(simulation)}"] if simulation.constraints else []),
        *(f"potential      {_potential(potential, scene.units)}" for potential in scene.potentials()),
        f"method         {dynamics.method}, timestep {shown(dynamics.timestep)}{bath}",
        f"run            {n_steps} steps = {shown(n_steps * dynamics.timestep)}, observed every {scene.sections.output.every}",
    ]


def _atoms(simulation: Simulation) -> str:
    system = simulation.system
    counts = np.bincount(system.species_index)
    names = ", ".join(f"{count} {name}" for name, count in zip(system.species_names, counts, strict=True))
    bonds = f"; {len(system.bonds)} bonds" if len(system.bonds) else ""
    return f"{len(system)} atoms ({names}){bonds}"


def _constraints(simulation: Simulation) -> str:
    fixed = [f"atoms fixed: {len(one.atoms)}" for one in simulation.constraints if isinstance(one, FixedAtoms)]
    lengths = [f"lengths kept: {len(one.pairs)}" for one in simulation.constraints if not isinstance(one, FixedAtoms)]
    return f"{', '.join(lengths + fixed)}; {simulation.n_dof} degrees of freedom"


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
    return f"{name}, " + ("no cutoff" if np.isinf(potential.cutoff) else f"cutoff {potential.cutoff:g} {unit_system.length}, {potential.truncation}")
