"""Archives of runs in fixed-point arithmetic: few frames, from which all others can be made again."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from minimd.core.console.display import Displayed
from minimd.core.files.trajectory import open_trajectories
from minimd.core.simulation.resuming import Potentials
from minimd.core.structure.checks import checked_count, checked_path
from minimd.past.past import Past, go_to


@dataclass(frozen=True)
class Archive(Displayed):
    """The result of archiving a file.
    n_frames, n_bytes : before and after.
    every : steps between kept frames."""

    file: Path
    every: int
    n_frames: tuple[int, int]
    n_bytes: tuple[int, int]

    def __str__(self) -> str:
        frames, kept = self.n_frames
        before, after = self.n_bytes
        return (
            f"archive        {self.file}: {kept} of {frames} frames, one every {self.every} steps; "
            f"{before / 1e6:.3g} MB -> {after / 1e6:.3g} MB, {before / after:.3g} times smaller\n"
            f"any step       minimd frames {self.file} --at STEP"
        )


def archive(
    file: str | Path,
    out: str | Path,
    every: int,
    potentials: Potentials = None,
    overwrite: bool = False,
) -> Archive:
    """Write a file with few frames of a run in fixed-point arithmetic, from which all others can be made again,
    to the last bit.

    As a test, the forces of each kept frame are evaluated again, and the steps from the first to the second kept frame
    are made again: energies must be those in the file, to the last bit.

    every : the first frame is kept, and those whose step is a multiple of it.
    potentials : see Simulation.resume.

    Raises ValueError as Past, and if energies differ.
    OSError as open_trajectories.
    """
    every = checked_count("every", every)
    past = Past(file, potentials)
    out = checked_path("out", out)
    contents = past.contents
    steps = contents.record.step
    kept = [k for k, step in enumerate(steps) if k == 0 or step % every == 0]
    first = steps[kept[0]]
    if len(kept) > 1:
        past.observe((), first, steps[kept[1]], every)
    simulation = past.at(first)
    with open_trajectories(
        out,
        simulation.engine,
        store_forces=False,
        overwrite=overwrite,
        every=every,
        n_steps=int(steps[kept[-1]] - first),
    ) as [writer]:
        for k in kept:
            writer.write(go_to(simulation, file, contents, k))
        simulation.engine.go_on_from(contents.restart)
    n_bytes = (Path(file).stat().st_size, out.stat().st_size)
    return Archive(out, every, (len(steps), len(kept)), n_bytes)
