"""Archives of runs in fixed-point arithmetic: few frames, from which all others can be made again."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from minimd.console.display import Displayed
from minimd.engine.observation import observe
from minimd.files.trajectory import open_trajectories
from minimd.simulation.resuming import Potentials, check_is_fixed, go_to
from minimd.simulation.simulation import Simulation
from minimd.structure.checks import checked_count

REMEDY = "give the potentials of the run"


@dataclass(frozen=True)
class Archive(Displayed):
    """The result of archiving a file.  n_frames, n_bytes : before and after.  every : steps between kept frames."""

    file: Path
    every: int
    n_frames: tuple[int, int]
    n_bytes: tuple[int, int]

    def __str__(self) -> str:
        (frames, kept), (before, after) = self.n_frames, self.n_bytes
        sizes = f"{before / 1e6:.3g} MB -> {after / 1e6:.3g} MB, {before / after:.3g} times smaller"
        what = f"archive        {self.file}: {kept} of {frames} frames, one each {self.every} steps; {sizes}"
        return f"{what}\nany step       minimd frames {self.file} --at STEP"


def archive(
    file: str | Path, out: str | Path, every: int, potentials: Potentials = None, overwrite: bool = False
) -> Archive:
    """Write a file with few frames of a run in fixed-point arithmetic, from which all others can be made again,
    to the last bit.

    As a test, the forces of each kept frame are evaluated again, and the steps from the first to the second kept frame
    are made again: energies and positions must be those in the file.

    every : the first frame is kept, and those whose step is a multiple of it.  potentials : see Simulation.resume.

    Raises ValueError for a run with another precision, or if energies or positions differ.
    OSError as open_trajectories.
    """
    from minimd.files.h5md_reader import frames_of, read_file

    every, simulation, contents = checked_count("every", every), Simulation.resume(file, potentials), read_file(file)
    check_is_fixed(file, contents)
    steps, energies, engine = contents.record.step, contents.record.total_energy, simulation.engine
    kept = [k for k, step in enumerate(steps) if k == 0 or step % every == 0]
    if len(kept) > 1:
        again = Simulation.resume(file, potentials, step=int(steps[kept[0]]))
        again.make_steps(int(steps[kept[1]] - steps[kept[0]]))
        [second] = frames_of(file, [kept[1]], again.system.units)
        if not np.array_equal(again.positions, second.positions):
            what = f"step {steps[kept[1]]} of {str(file)!r} is not the same, to the last bit, when it is made again"
            raise ValueError(f"{what}: {REMEDY}")
    made: dict[str, Any] = {"every": every, "n_steps": int(steps[kept[-1]] - steps[kept[0]]), "overwrite": overwrite}
    with open_trajectories(out, engine, store_forces=False, **made) as [writer]:
        for k in kept:
            go_to(simulation, file, contents, k)
            frame = observe(engine)
            if frame.observables["total_energy"] != energies[k]:
                what = f"the energy of step {steps[k]} of {str(file)!r} is different when it is computed again"
                raise ValueError(f"{what}: {REMEDY}")
            writer.write(frame)
        engine.go_on_from(contents.restart)
    sizes = Path(file).stat().st_size, Path(out).stat().st_size
    return Archive(Path(out), every, (len(steps), len(kept)), sizes)
