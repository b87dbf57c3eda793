"""A scene handed over to LAMMPS: minimd builds, minimizes and equilibrates it, and LAMMPS makes the run."""

from pathlib import Path

from minimd.diagnosis.report import conservation_report
from minimd.lammps import HandOver, check_hand_over, hand_over
from minimd.scene.running import Tell, description, equilibrate, minimize
from minimd.scene.scene import Scene


def hand_over_scene(
    scene: Scene,
    folder: Path,
    *,
    steps: int | None = None,
    processes: int = 1,
    overwrite: bool = False,
    progress: bool | None = None,
    tell: Tell = print,
) -> HandOver:
    """Build a scene, minimize and equilibrate it, and let LAMMPS run it.

    folder : for all files.  steps : in place of those of the scene.
        Other arguments and errors are those of minimd.lammps.hand_over.
    Raises ValueError, OSError also for a scene that cannot be built.
    """
    output, n_steps = scene.sections.output, scene.sections.dynamics.steps if steps is None else steps
    simulation = scene.simulation()
    for line in description(scene, simulation, n_steps):
        tell(line)
    check_hand_over(
        simulation, folder, n_steps, processes=processes, every=output.every, overwrite=overwrite
    )  # before the minimization begins
    if scene.sections.observer:
        tell(
            "NOTE           the observers of the scene are not used: they work in runs of minimd only, and LAMMPS "
            "makes this run"
        )
    minimize(scene, simulation, progress, tell)
    equilibrate(scene, simulation, progress, tell)
    done = hand_over(
        simulation,
        folder,
        n_steps,
        processes=processes,
        every=output.every,
        store_forces=output.forces,
        overwrite=overwrite,
        progress=progress,
        tell=tell,
    )
    is_free = simulation.conserves_momentum
    angular = is_free and not simulation.system.cell.is_periodic
    tell(str(conservation_report(done.record, linear=is_free, angular=angular, n_dof=simulation.n_dof)))
    return done
