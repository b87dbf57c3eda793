"""`minimd bench scaling`: time and memory of the melt against the number of atoms and of threads."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, ClassVar, NamedTuple

import numpy as np
from numpy.typing import NDArray

from minimd.compiled.machine import available_cores
from minimd_bench.engines import Minimd
from minimd_bench.memory import bytes_per_atom
from minimd_bench.outcome import End, name_curves, new_figure, spread, summary, table, threads_text
from minimd_bench.scenes import MELT, melt
from minimd_bench.turns import take_turns, warm_up

if TYPE_CHECKING:
    from matplotlib.figure import Figure

CELLS, CELLS_QUICK = (3, 5, 8, 12, 20, 32, 63), (3, 5, 10, 20)  # 108 to 1 000 188 atoms; quick: 108 to 32 000
MEMORY_OF, MEMORY_OF_QUICK = 63, 40  # cells


class Size(NamedTuple):
    """Times for one number of atoms.  seconds : for each number of threads (R,), of a step in each turn."""

    n_atoms: int
    seconds: dict[int, NDArray[np.float64]]


@dataclass(frozen=True)
class Scaling:
    """Times by size and threads.  memory : bytes per atom between 32 000 and memory_atoms atoms, if it is known."""

    sizes: Sequence[Size]
    memory: float | None
    memory_atoms: int
    repeats: int
    packages: Sequence[str] = ()
    name: ClassVar[str] = "scaling"

    def lines(self) -> list[str]:
        """See Outcome."""
        threads = list(self.sizes[0].seconds)
        columns = [f"ns per atom and step, {threads_text(t)}" for t in threads] + [
            f"speedup with {t} threads" for t in threads if t > 1
        ]
        titles = dict.fromkeys(["atoms", *columns], float)
        cells = []
        for size in self.sizes:
            times = [spread(1e9 * size.seconds[t] / size.n_atoms) for t in threads]
            cells.append(
                [str(size.n_atoms), *times, *(spread(size.seconds[1] / size.seconds[t]) for t in threads if t > 1)]
            )
        head = f"The melt, double precision; median of {self.repeats} rounds (least to most)."
        lines = [head, "", *table(titles, cells), ""]
        if self.memory is None:
            return lines
        return [
            *lines,
            f"Peak memory from 32 000 to {self.memory_atoms} atoms grows by {self.memory:.0f} bytes per atom.",
        ]

    def content(self) -> dict[str, Any]:
        """See Outcome."""
        sizes = [
            {"n_atoms": s.n_atoms, "seconds_per_step": {str(t): summary(x) for t, x in s.seconds.items()}}
            for s in self.sizes
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
        ends = {}
        for k, t in enumerate(self.sizes[0].seconds):
            times = np.array([1e9 * size.seconds[t] / size.n_atoms for size in self.sizes])
            axes.plot(n, np.median(times, axis=1), "o-", color=f"C{k}")
            ends[threads_text(t)] = End(n[-1], float(np.median(times[-1])), f"C{k}")
            axes.fill_between(n, times.min(axis=1), times.max(axis=1), alpha=0.2, color=f"C{k}")
        axes.set(
            xscale="log", ylim=(0.0, None), xlabel="atoms", ylabel="ns per atom and step", title="Lennard-Jones melt"
        )
        name_curves(axes, ends)
        return figure


def run_scaling(threads: Sequence[int], quick: bool, repeats: int) -> Scaling:
    """Measure time and memory of the melt.  Raises ValueError for more threads than cores."""
    if max(threads, default=1) > available_cores():
        raise ValueError(
            f"--threads {max(threads)} is more than the {available_cores()} cores that this process may use"
        )
    kinds = tuple(dict.fromkeys((1, *(threads or (available_cores(),)))))
    sizes = []
    for n in CELLS_QUICK if quick else CELLS:
        scene, n_atoms = melt(n), 4 * n**3
        engines = [Minimd(scene, t) for t in kinds]
        speeds = take_turns(engines, warm_up(engines, n_atoms), repeats, n_atoms)
        sizes.append(Size(n_atoms, {t: 1.0 / speeds[k] for k, t in enumerate(kinds)}))
    n = MEMORY_OF_QUICK if quick else MEMORY_OF
    return Scaling(sizes, bytes_per_atom(MELT, n, 1), 4 * n**3, repeats)
