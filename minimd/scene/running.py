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
from minimd.core.files.h5md_reader import read_file, verify_frames
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
OF_THE_START = ("structure.", "water.seed", "minimization.", "equilibration.")
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
    steps : in place of those of the scene.  trajectory : one file in place of those of the scene;
        the picture is written beside it.
    overwrite : replace files that exist. Without it, an error is raised at the start if a trajectory exists, or a
        picture whose name the scene gives; a picture without a name in the scene is not drawn if it exists.
    max_seconds : of wall time, in place of those of the scene, as for Simulation.run; minimization and equilibration
        do not count.
    progress : as for Simulation.run.  tell : called with each line about the run.

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
    named: dict[str, Any] = {
        "trajectory": files,
        "store_forces": output.forces,
        "overwrite": overwrite,
        "max_seconds": scene.sections.dynamics.max_seconds if max_seconds is None else max_seconds,
    }
    with kept(scene, files, n_steps):
        simulation.run(n_steps, every=output.every, observers=observers, progress=progress, **named)
    tell_results(simulation, observers, tell)
    drawn = []
    if picture is not None and picture.exists() and not overwrite:
        tell(f"not drawn      {picture} exists and is kept; draw the picture with: minimd plot")
    elif picture is not None:
        from minimd.view.plot import plot_file

        tell(f"drawing        {picture} ...")
        with kept(scene, files, n_steps):
            drawn = [plot_file(h5md_files(files)[0], picture)]
    tell(f"written        {', '.join(map(str, [*files, *drawn]))}{_how_to_go_on(files, n_steps)}")
    return simulation


def resume_run(
    file: str | Path,
    steps: int | None = None,
    *,
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
    known = stored(Scene, contents.scene, path) if contents.scene else None
    given = scene
    scene = scene or known
    if scene is None:
        resumed = f"sim = minimd.Simulation.resume({str(file)!r}, potentials)"
        script = f"go on in the script: {resumed}; sim.run(n_steps, trajectory={str(file)!r}, append=True)"
        raise ValueError(
            f"file {str(file)!r} holds no scene from which to rebuild its potentials; {script}"
        )
    end = scene.sections.dynamics.steps if steps is None else contents.step + steps
    if steps is None and end <= contents.step:
        if not contents.lacks_results:
            there = f"it is at step {contents.step}, dynamics.steps = {end}"
            remedy = "give the number of further steps with --steps"
            raise ValueError(
                f"the run in {str(file)!r} has reached the end of its scene: {there}; {remedy}"
            )
        end = contents.step  # it was killed after its last step
    if known is not None and (other := differences(known, scene)):
        tell(
            "NOTE           the scene given replaces the one of the run so far; the keys that differ are:"
        )
        for line in other:
            tell(f"               {line}")
    if contents.repaired:
        tell(f"repaired       {contents.repaired}")
    simulation = scene.simulation(contents.system)
    simulation.engine.go_on_from(contents.restart)
    if (simulation.method.name, simulation.method.parameters) != (
        contents.method,
        contents.parameters,
    ):
        if given is None:  # a script went on with a method other than that of the scene
            simulation.method = contents.integrator()
            tell(
                f"NOTE           the last steps were made with {simulation.method!r}, not with the method of the"
            )
            tell("               scene in the file; the run goes on with the method of these steps")
        else:
            simulation.engine.changed()
    if given is None and (changed := other_potentials(contents.potentials, simulation.potentials)):
        those = f"the run goes on with those of the scene: {changed}"
        tell(
            f"NOTE           the last steps were made with other potentials than the scene in the file has; {those}"
        )
    for line in description(scene, simulation, end - contents.step):
        tell(line)
    when = f"at step {contents.step}, {scene.units.shown(contents.time)}, after {contents.n_frames} frames"
    tell(f"resumed        {when}")
    if len(scene.trajectories()) > 1:
        tell(
            f"               only {file} is continued; the other trajectories keep their frames up to this step"
        )
    observers = scene.observers()
    named: dict[str, Any] = {
        "every": scene.sections.output.every,
        "trajectory": path,
        "append": True,
        "max_seconds": scene.sections.dynamics.max_seconds if max_seconds is None else max_seconds,
    }
    with kept(scene, [path], end):
        simulation.run(until_step=end, observers=observers, progress=progress, **named)
    tell_results(simulation, observers, tell)
    tell(f"written        {file}{_how_to_go_on([path], end)}")
    return simulation


def tell_results(simulation: Simulation, observers: Sequence[Accumulator], tell: Tell) -> None:
    """Tell the report of a run, and the results of observers, in one or several lines for each."""
    tell(str(simulation.report()))
    for one in observers:
        if one.n_looks:
            tell(str(one.result()))


def differences(one: Scene, other: Scene) -> list[str]:
    """The keys whose values differ in two scenes, with both values as written in the files."""
    found = []
    before, now = (dict(_entries(tomllib.loads(scene.whole_text()))) for scene in (one, other))
    for key in dict.fromkeys([*before, *now]):
        if before.get(key) != now.get(key):
            values = (scene.get(key, "not given") for scene in (before, now))
            was, becomes = (
                v if len(v) <= LONGEST_VALUE else f"{v[:LONGEST_VALUE]}..." for v in values
            )
            remark = " (no effect: the start is over)" if key.startswith(OF_THE_START) else ""
            found.append(f"{key}: {was} before, {becomes} now{remark}")
    return found


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
        found = simulation.minimize(**plan.model_dump(), progress=progress)
    if dynamics.temperature is not None:
        # drawn again, because rigid bonds have turned
        simulation.set_temperature(dynamics.temperature, dynamics.seed)
    tell(str(found))


def equilibrate(
    scene: Scene,
    simulation: Simulation,
    progress: bool | None,
    tell: Tell,
    crash_report: Path | None = None,
) -> None:
    """Run the equilibration of the scene, if it has one."""
    plan = scene.sections.equilibration
    target = (plan and plan.temperature) or scene.sections.dynamics.temperature
    # SceneSections has checked that there is a target
    if plan is None or target is None or plan.steps == 0:
        return
    every = plan.rescale_every
    tell(
        f"equilibration  {plan.steps} steps, rescaled to {target:g} {scene.units.temperature} every {every}"
    )
    with kept(scene, where=" of the equilibration"):
        simulation.equilibrate(plan.steps, target, every, progress, crash_report)


def description(scene: Scene, simulation: Simulation, n_steps: int) -> list[str]:
    """Lines about what has been built and will be run."""
    run = f"{n_steps} steps = {scene.units.shown(n_steps * simulation.method.timestep)}"
    rows = [
        ("scene", f"{scene.path}" + (f": {scene.sections.title}" if scene.sections.title else ""))
    ]
    rows += simulation.engine.scene_in_words()
    rows += [("n_dof", f"{simulation.n_dof} degrees of freedom")] if simulation.constraints else []
    rows += [("run", f"{run}, observed every {scene.sections.output.every}")]
    return [f"{name:<{NAME_WIDTH}} {words}" for name, words in rows]


@contextmanager
def kept(scene: Scene, files: Sequence[Path] = (), end: int = 0, where: str = "") -> Iterator[None]:
    """If a run fails, add to the message which files are kept and, if it was interrupted, how to go on.

    files : of the run; none for a preparation.  end : the step at which it was to end, for the command that goes on.
    where : words on what was interrupted, such as " of the equilibration".
    """
    begun = time() - CLOCK
    try:
        yield
    except (KeyboardInterrupt, Terminated, NonFiniteError, ConstraintError, OSError) as error:
        written = [
            file
            for file in files
            if file.is_file() and file.stat().st_size and file.stat().st_mtime > begun
        ]
        interrupted = isinstance(error, (KeyboardInterrupt, Terminated))
        if not written and not interrupted:
            raise
        files_kept = f"; what was written before is kept in {', '.join(map(str, written))}"
        ending = files_kept if written else f"{where}; nothing was written"
        if isinstance(error, Terminated):
            error.words += ending + _how_to_go_on(written, end)
            raise
        failure = type(error)(
            sentence(error) + ending + (_how_to_go_on(written, end) if interrupted else "")
        )
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
    """Build a scene, minimize and equilibrate it, and let LAMMPS run it.

    folder : for all files.  steps : in place of those of the scene.
        Other arguments and errors are those of minimd.lammps.hand_over.
    Raises ValueError, OSError also for a scene that cannot be built.
    """
    from minimd.lammps import check_hand_over, hand_over  # a run by minimd needs none of it

    output = scene.sections.output
    n_steps = scene.sections.dynamics.steps if steps is None else steps
    simulation = scene.simulation()
    for line in description(scene, simulation, n_steps):
        tell(line)
    # before the minimization begins
    check_hand_over(
        simulation, folder, n_steps, processes=processes, every=output.every, overwrite=overwrite
    )
    if scene.sections.observer:
        why = "they work in runs of minimd only, and LAMMPS makes this run"
        tell(f"NOTE           the observers of the scene are not used: {why}")
    minimize(scene, simulation, progress, tell)
    equilibrate(scene, simulation, progress, tell)
    asked: dict[str, Any] = {
        "every": output.every,
        "store_forces": output.forces,
        "overwrite": overwrite,
    }
    done = hand_over(
        simulation, folder, n_steps, processes=processes, progress=progress, tell=tell, **asked
    )
    is_free = simulation.conserves_momentum
    angular = is_free and not simulation.system.cell.is_periodic
    tell(
        str(
            conservation_report(
                done.record, linear=is_free, angular=angular, n_dof=simulation.n_dof
            )
        )
    )
    return done
