"""`minimd bench scaling`: time and memory of the melt against the number of atoms and of threads."""

import subprocess
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from math import nan
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from minimd.bench.engines import Minimd
from minimd.bench.outcome import draw, name_curves, new_figure, spread, summary, table, threads_text
from minimd.bench.scenes import MELT, SCENES
from minimd.bench.turns import in_turns, thread_numbers
from minimd.core.compiled.machine import STATUS, peak_memory
from minimd.core.compiled.terminal import tell
from minimd.core.structure.arrays import Array

if TYPE_CHECKING:
    from matplotlib.figure import Figure

CELLS = (3, 5, 8, 12, 20, 32, 63)  # 108 to 1 000 188 atoms
CELLS_QUICK = (3, 5, 10, 20)  # 108 to 32 000
MEMORY_OF = 63  # cells
MEMORY_OF_QUICK = 40
SMALL = 20  # cells: above 32 000 atoms, the memory of Python and of the kernels does not count
MEMORY_STEPS = 120  # enough for the snapshots to which a failed run goes back


class Size(NamedTuple):
    """Times for one number of atoms.
    seconds : for each number of threads (R,), of a step in each turn."""

    n_atoms: int
    seconds: dict[int, Array]


@dataclass
class Scaling:
    """Times by size and threads.
    memory : bytes per atom between 32 000 and memory_atoms atoms, if it is known."""

    sizes: Sequence[Size]
    memory: float | None
    memory_atoms: int
    repeats: int
    packages = ()
    name = "scaling"

    def lines(self) -> list[str]:
        """See Outcome."""
        threads = list(self.sizes[0].seconds)
        several = [t for t in threads if t > 1]
        titles = ["atoms"]
        titles += [f"ns per atom and step, {threads_text(t)}" for t in threads]
        titles += [f"speedup with {t} threads" for t in several]
        cells = []
        for n_atoms, seconds in self.sizes:
            times = [spread(1e9 * seconds[t] / n_atoms) for t in threads]
            speedups = [spread(seconds[1] / seconds[t]) for t in several]
            cells.append([n_atoms, *times, *speedups])
        head = f"The melt, double precision; median of {self.repeats} rounds (least to most)."
        lines = [head, "", *table(dict.fromkeys(titles, float), cells), ""]
        if self.memory is not None:
            lines.append(
                f"Peak memory from 32 000 to {self.memory_atoms} atoms grows by {self.memory:.0f} bytes per atom."
            )
        return lines

    def content(self) -> dict[str, Any]:
        """See Outcome."""
        sizes = [
            {
                "n_atoms": n_atoms,
                "seconds_per_step": {str(t): summary(x) for t, x in seconds.items()},
            }
            for n_atoms, seconds in self.sizes
        ]
        return {
            "repeats": self.repeats,
            "sizes": sizes,
            "bytes_per_atom": self.memory,
            "memory_atoms": self.memory_atoms,
        }

    def figure(self) -> "Figure":
        """Time of a step per atom against the number of atoms."""
        figure = new_figure(4.0)
        axes = figure.subplots()
        n = [size.n_atoms for size in self.sizes]
        curves = {}
        for t in self.sizes[0].seconds:
            times = np.array([1e9 * size.seconds[t] / size.n_atoms for size in self.sizes])
            curves[threads_text(t)] = n, times, True
        draw(axes, curves)
        axes.set(
            xscale="log",
            ylim=(0.0, None),
            xlabel="atoms",
            ylabel="ns per atom and step",
            title="Lennard-Jones melt",
        )
        name_curves(axes)
        return figure


def run_scaling(threads: Sequence[int], quick: bool, repeats: int) -> Scaling:
    """Measure time and memory of the melt.
    Raises ValueError for more threads than cores."""
    numbers = dict.fromkeys((1, *thread_numbers(threads)))
    sizes = []
    for n in CELLS_QUICK if quick else CELLS:
        scene = SCENES[MELT](n)
        n_atoms = 4 * n**3
        speeds = in_turns([Minimd(scene, t) for t in numbers], repeats, n_atoms)
        sizes.append(Size(n_atoms, dict(zip(numbers, 1.0 / speeds, strict=True))))
    n = MEMORY_OF_QUICK if quick else MEMORY_OF
    return Scaling(sizes, bytes_per_atom(MELT, n, 1), 4 * n**3, repeats)


def bytes_per_atom(scene: str, n: int, threads: int) -> float | None:
    """Growth of minimd's peak memory per additional atom, from a scene of 32 000 atoms to one of about 4 n³; both are
    built and run, in a process of their own. None if the operating system does not give the peak, or this fails."""
    if not STATUS.exists():
        return None
    program = f"from minimd.bench.scaling import growth; print(); print(growth({scene!r}, {n}, {threads}))"
    process = subprocess.run(
        [sys.executable, "-c", program], capture_output=True, text=True, check=False
    )
    if process.returncode:
        reason = (process.stderr.splitlines() or ["no reason given"])[-1]
        tell(f"memory could not be measured: {reason}")
        return None
    return float(process.stdout.splitlines()[-1])


def growth(scene: str, n: int, threads: int) -> float:
    """As bytes_per_atom, in this process, which must be new."""
    few, before = _peak(scene, SMALL, threads)
    many, after = _peak(scene, n, threads)
    return (after - before) / (many - few)


def _peak(name: str, n: int, threads: int) -> tuple[int, float]:
    """Build a scene and run it; returns the number of its atoms, and the peak memory afterwards."""
    scene = SCENES[name](n)
    n_atoms = len(scene.system)
    engine = Minimd(scene, threads)
    del scene  # the simulation has its own copy
    engine.run(MEMORY_STEPS)
    return n_atoms, peak_memory() or nan
