"""Running a scene from start to report, with a line about each stage; or handing it over to LAMMPS for the run."""

import json
import tomllib
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from time import time
from typing import TYPE_CHECKING, Any

from minimd.core.console.display import NAME_WIDTH
from minimd.core.console.signals import Terminated
from minimd.core.diagnosis.report import conservation_report
from minimd.core.files.crash_file import crash_file_place
from minimd.core.files.h5md_reader import H5MDContents, read_file, verify_frames
from minimd.core.files.h5md_schema import other_potentials
from minimd.core.files.trajectory import FORMATS, checked_output
from minimd.core.simulation.simulation import Simulation
from minimd.core.structure.errors import ConstraintError, NonFiniteError, sentence
from minimd.observers import Accumulator
from minimd.scene.document import h5md_files, stored
from minimd.scene.scene import Scene
from minimd.scene.sections import PLOT_SUFFIXES

if TYPE_CHECKING:
    from minimd.lammps import HandOver

Tell = Callable[[str], None]
# keys, or how they begin, that a run that goes on does not use
NOT_USED = ("structure.", "water.seed", "minimization.", "equilibration.", "output.trajectory")
LONGEST_VALUE = 60  # characters of a value in a message
CLOCK = 1.0  # s, the coarsest time stamps of a file system


def run_scene(
    scene: Scene,
    *,
    steps: int | None = None,
    trajectory: Path | None = None,
    overwrite: bool = False,
    max_seconds: float | None = None,
    progress: bool | None = None,
    tell: Tell = print,
) -> Simulation:
    """Build a scene, minimize and equilibrate it, run it, and write its files.

    Parameters
    ----------
    steps : in place of those of the scene.
    trajectory : one file in place of those of the scene; the picture is written beside it.
    overwrite : replace files that exist. Without it, an error is raised at the start if a trajectory exists, or a
        picture whose name the scene gives; a picture without a name in the scene is not drawn if it exists.
    max_seconds : of wall time, in place of those of the scene, as for Simulation.run; minimization and equilibration
        do not count.
    progress : as for Simulation.run.
    tell : called with each line about the run.

    Raises
    ------
    ValueError, OSError : for a scene that cannot be built, and files that cannot be written.  NonFiniteError,
        KeyboardInterrupt : as Simulation.run.
    """
    output = scene.sections.output
    n_steps = scene.sections.dynamics.steps if steps is None else steps
    files = scene.trajectories(trajectory)
    picture = scene.plot_name(files, beside=trajectory is not None)
    for file in scene.named_outputs(trajectory):
        checked_output(file, overwrite, FORMATS if file in files else PLOT_SUFFIXES)
    simulation = scene.simulation()
    for line in description(scene, simulation, n_steps):
        tell(line)
    minimize(scene, simulation, progress, tell)
    equilibrate(scene, simulation, progress, tell, crash_file_place(True, files))
    observers = scene.observers()
    if max_seconds is None:
        max_seconds = scene.sections.dynamics.max_seconds

    with kept(scene, files, n_steps):
        simulation.run(
            n_steps,
            every=output.every,
            observers=observers,
            trajectory=files,
            store_forces=output.forces,
            overwrite=overwrite,
            max_seconds=max_seconds,
            progress=progress,
        )

    tell_results(simulation, observers, tell)
    written = list(files)
    if picture is not None and picture.exists() and not overwrite:
        tell(f"not drawn      {picture} exists and is kept; draw the picture with: minimd plot")
    elif picture is not None:
        from minimd.view.plot import plot_file

        tell(f"drawing        {picture} ...")
        with kept(scene, files, n_steps):
            written.append(plot_file(h5md_files(files)[0], picture))

    tell(f"written        {', '.join(map(str, written))}{_how_to_go_on(files, n_steps)}")
    return simulation


def resume_run(
    file: str | Path,
    steps: int | None = None,
    *,
    until_step: int | None = None,
    scene: Scene | None = None,
    max_seconds: float | None = None,
    progress: bool | None = None,
    tell: Tell = print,
) -> Simulation:
    """Go on with the run in an H5MD file from its restart, and append to this file;
    other trajectories are cut to their frames up to it.

    The file of a run from a script has no scene; go on with it by Simulation.resume.

    Parameters
    ----------
    steps : number of further steps; if not given, the run goes on to the last step of the scene.
    until_step : the step at which it ends, in place of steps.
    scene : replaces the scene in the file, except for the sections of the start; a note lists the differences. It must
        have the same constraints. If it is not given, the method is that of the last steps in the file.
    max_seconds : as for run_scene.

    Raises
    ------
    ValueError, OSError : for a file that cannot be continued, or that has no scene if none is given.
    NonFiniteError, KeyboardInterrupt : as Simulation.run.
    """
    verify_frames(file)
    path = Path(file)
    contents = read_file(file)
    own_scene = stored(Scene, contents.scene, path) if contents.scene else None
    is_own = scene is None
    scene = scene or own_scene
    if scene is None:
        raise ValueError(
            f"file {str(file)!r} holds no scene from which to rebuild its potentials; go on in the script: "
            f"sim = minimd.Simulation.resume({str(file)!r}, potentials); "
            f"sim.run(n_steps, trajectory={str(file)!r}, append=True)"
        )

    end = _end(scene, contents, (steps, until_step), str(file))
    changes = [] if own_scene is None else differences(own_scene, scene)
    if changes:
        tell(
            "NOTE           the scene given replaces the one of the run so far; the keys that differ are:"
        )

    for change in changes:
        tell(f"               {change}")
    if contents.repaired:
        tell(f"repaired       {contents.repaired}")
    simulation = scene.simulation(contents.system)
    simulation.engine.go_on_from(contents.restart)
    if is_own:
        _tell_changes(simulation, contents, tell)
    elif not _is_method_of(simulation, contents):
        simulation.engine.changed()

    for line in description(scene, simulation, end - contents.step):
        tell(line)
    when = scene.units.shown(contents.time)
    tell(f"resumed        at step {contents.step}, {when}, after {contents.n_frames} frames")
    if len(scene.trajectories()) > 1:
        tell(
            f"               only {file} is continued; the other trajectories keep their frames up to this step"
        )

    observers = scene.observers()
    if max_seconds is None:
        max_seconds = scene.sections.dynamics.max_seconds

    with kept(scene, [path], end):
        simulation.run(
            until_step=end,
            every=scene.sections.output.every,
            observers=observers,
            trajectory=path,
            append=True,
            max_seconds=max_seconds,
            progress=progress,
        )

    tell_results(simulation, observers, tell)
    tell(f"written        {file}{_how_to_go_on([path], end)}")
    return simulation


def _end(
    scene: Scene, contents: H5MDContents, asked: tuple[int | None, int | None], file: str
) -> int:
    """The step at which a resumed run ends.
    asked : steps and until_step of resume_run.
    Raises ValueError if both are given, or the run has reached this step, or the end of its scene."""
    step = contents.step
    steps, until_step = asked
    if until_step is not None and (steps is not None or until_step < step):
        raise ValueError(
            f"--until-step must be at least {step}, the step of the run in {file!r}, and takes the place of --steps; "
            f"it is {until_step}"
        )
    if until_step is not None:
        return until_step
    if steps is not None:
        return step + steps
    end = scene.sections.dynamics.steps
    if end > step:
        return end
    if contents.lacks_results:  # it was killed after its last step
        return step
    raise ValueError(
        f"the run in {file!r} has reached the end of its scene: it is at step {step}, dynamics.steps = {end}; give the "
        "number of further steps with --steps"
    )


def _is_method_of(simulation: Simulation, contents: H5MDContents) -> bool:
    method = simulation.method
    return (method.name, method.parameters) == (contents.method, contents.parameters)


def _tell_changes(simulation: Simulation, contents: H5MDContents, tell: Tell) -> None:
    """Note what a script has changed since the scene was stored; the method of the last steps is taken over."""
    if not _is_method_of(simulation, contents):
        simulation.method = contents.integrator()
        tell(
            f"NOTE           the last steps were made with {simulation.method!r}, not with the method of the"
        )
        tell("               scene in the file; the run goes on with the method of these steps")
    changed = other_potentials(contents.potentials, simulation.potentials)
    if changed:
        tell(
            "NOTE           the last steps were made with other potentials than the scene in the file has; the run "
            f"goes on with those of the scene: {changed}"
        )


def tell_results(simulation: Simulation, observers: Sequence[Accumulator], tell: Tell) -> None:
    """Tell the report of a run, and the results of observers, in one or several lines for each."""
    tell(str(simulation.report()))
    for observer in observers:
        if observer.n_looks:
            tell(str(observer.result()))


def differences(one: Scene, other: Scene) -> list[str]:
    """The keys whose values differ in two scenes, with both values as written in the files."""
    lines = []
    before, now = (dict(_entries(tomllib.loads(scene.whole_text()))) for scene in (one, other))
    for key in before | now:
        old = before.get(key, "not given")
        new = now.get(key, "not given")
        if old != new:
            remark = " (no effect on a run that goes on)" if key.startswith(NOT_USED) else ""
            lines.append(f"{key}: {_shortened(old)} before, {_shortened(new)} now{remark}")
    return lines


def _shortened(value: str) -> str:
    return value if len(value) <= LONGEST_VALUE else f"{value[:LONGEST_VALUE]}..."


def _entries(value: Any, key: str = "") -> Iterator[tuple[str, str]]:
    """The full key and the value, as text, of each entry of a document."""
    if isinstance(value, dict):
        for name, inside in value.items():
            yield from _entries(inside, f"{key}.{name}" if key else name)
    elif isinstance(value, list) and value and isinstance(value[0], dict):
        for k, inside in enumerate(value):
            yield from _entries(inside, f"{key}[{k}]")
    else:
        yield key, json.dumps(value, ensure_ascii=False, default=str)


def minimize(scene: Scene, simulation: Simulation, progress: bool | None, tell: Tell) -> None:
    """Move the atoms to a minimum, if the scene asks for it."""
    plan = scene.sections.minimization
    dynamics = scene.sections.dynamics
    if plan is None:
        return
    with kept(scene):
        minimum = simulation.minimize(**plan.model_dump(), progress=progress)
    if dynamics.first_temperature is not None:
        # drawn again, because rigid bonds have turned
        simulation.set_temperature(dynamics.first_temperature, dynamics.seed)
    tell(str(minimum))


def equilibrate(
    scene: Scene,
    simulation: Simulation,
    progress: bool | None,
    tell: Tell,
    crash_report: Path | None = None,
) -> None:
    """Run the equilibration of the scene, if it has one."""
    plan = scene.sections.equilibration
    target = (plan and plan.temperature) or scene.sections.dynamics.first_temperature
    # SceneSections has checked that there is a target
    if plan is None or target is None or plan.steps == 0:
        return
    every = plan.rescale_every
    temperature = f"{target:g} {scene.units.temperature}"
    tell(f"equilibration  {plan.steps} steps, rescaled to {temperature} every {every}")
    with kept(scene, where=" of the equilibration"):
        simulation.equilibrate(plan.steps, target, every, progress, crash_report)


def description(scene: Scene, simulation: Simulation, n_steps: int) -> list[str]:
    """Lines about what has been built and will be run."""
    title = scene.sections.title
    rows = [("scene", f"{scene.path}: {title}" if title else f"{scene.path}")]
    rows += simulation.engine.scene_in_words()
    if simulation.constraints:
        rows.append(("n_dof", f"{simulation.n_dof} degrees of freedom"))
    duration = scene.units.shown(n_steps * simulation.method.duration)
    every = scene.sections.output.every
    rows.append(("run", f"{n_steps} steps = {duration}, observed every {every}"))
    return [f"{name:<{NAME_WIDTH}} {text}" for name, text in rows]


@contextmanager
def kept(scene: Scene, files: Sequence[Path] = (), end: int = 0, where: str = "") -> Iterator[None]:
    """If a run fails, add to the message which files are kept and, if it was interrupted, how to go on.

    files : of the run; none for a preparation.
    end : the step at which it was to end, for the command that goes on.
    where : words on what was interrupted, such as " of the equilibration".
    """
    begun = time() - CLOCK
    try:
        yield
    except (KeyboardInterrupt, Terminated, NonFiniteError, ConstraintError, OSError) as error:
        there = [(file, file.stat()) for file in files if file.is_file()]
        written = [file for file, stat in there if stat.st_size and stat.st_mtime > begun]
        is_interrupted = isinstance(error, KeyboardInterrupt | Terminated)
        if written:
            ending = f"; what was written before is kept in {', '.join(map(str, written))}"
        elif is_interrupted:
            ending = f"{where}; nothing was written"
        else:
            raise

        if is_interrupted:
            ending += _how_to_go_on(written, end)
        if isinstance(error, Terminated):
            error.words += ending
            raise
        failure = type(error)(sentence(error) + ending)
        failure.__dict__.update(error.__dict__)  # such as the crash report
        raise failure from None


def _how_to_go_on(written: Sequence[Path], end: int) -> str:
    """The command that resumes a run which has ended before its last step, as a clause; empty if there is none."""
    for file in h5md_files(written):
        with suppress(OSError, ValueError):
            left = end - read_file(file).step
            return f"; resume with: minimd resume {file} --steps {left}" if left > 0 else ""
    return ""


def hand_over_scene(
    scene: Scene,
    folder: Path,
    *,
    steps: int | None = None,
    processes: int = 1,
    overwrite: bool = False,
    progress: bool | None = None,
    tell: Tell = print,
) -> "HandOver":
    """Build a scene, minimize and equilibrate it, and let LAMMPS run it. Without LAMMPS, only its input is written.

    folder : for all files.
    steps : in place of those of the scene.
        Other arguments and errors are those of minimd.lammps.hand_over.
    Raises ValueError, OSError also for a scene that cannot be built, FileNotFoundError after input without LAMMPS.
    """
    from minimd import lammps  # a run by minimd needs none of it

    output = scene.sections.output
    n_steps = scene.sections.dynamics.steps if steps is None else steps
    simulation = scene.simulation()
    for line in description(scene, simulation, n_steps):
        tell(line)
    options: dict[str, Any] = {
        "processes": processes,
        "every": output.every,
        "overwrite": overwrite,
    }
    # before the minimization begins
    lammps.check_hand_over(simulation, folder, n_steps, **options)
    missing = ""
    try:
        lammps.find_program(processes)
    except FileNotFoundError as error:
        missing = f"{error}; the input is in {str(folder)!r}, not compared with minimd: run lmp -in run.lmp there"
        tell(f"NOTE           {error}: the input is written, and nothing is run")
    if scene.sections.observer:
        tell(
            "NOTE           the observers of the scene are not used: they work in runs of minimd only, and LAMMPS "
            "makes this run"
        )

    minimize(scene, simulation, progress, tell)
    equilibrate(scene, simulation, progress, tell)
    if missing:
        lammps.write_input(simulation, folder, n_steps, every=output.every, overwrite=overwrite)
        raise FileNotFoundError(missing)
    options |= {"store_forces": output.forces, "progress": progress, "tell": tell}
    result = lammps.hand_over(simulation, folder, n_steps, **options)
    is_free = simulation.conserves_momentum
    angular = is_free and not simulation.system.cell.is_periodic
    n_dof = simulation.n_dof
    tell(str(conservation_report(result.record, linear=is_free, angular=angular, n_dof=n_dof)))
    return result
