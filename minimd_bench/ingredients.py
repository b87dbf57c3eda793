"""`minimd bench scene`: the cost of each ingredient of a scene, and a test that an absent ingredient costs nothing."""

import tempfile
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

import minimd as md
from minimd_bench.engines import Minimd
from minimd_bench.outcome import bars, spread, summary, table, tell
from minimd_bench.scenes import (
    CUTOFF,
    MELT_TEMPERATURE,
    SCENES,
    TIMESTEP,
    BenchScene,
    equilibrated,
    melt,
    pairs_in_range,
)
from minimd_bench.turns import take_turns, warm_up

if TYPE_CHECKING:
    from matplotlib.figure import Figure

PARTNERS = 1.3  # σ: only closer atoms are bonded; this is within the first peak of g(r)
EVERY = 10  # steps between observations, for ingredients with observations
BASE = "melt"


class IngredientCost(NamedTuple):
    """The cost of one ingredient.  seconds : (R,) of a step in each turn.  n_pairs : number of pairs in range."""

    name: str
    n_atoms: int
    n_pairs: float
    seconds: NDArray[np.float64]


@dataclass(frozen=True)
class IngredientCosts:
    """The costs of all ingredients, the melt first."""

    costs: Sequence[IngredientCost]
    repeats: int
    packages: Sequence[str] = ("h5py", "MDAnalysis")
    name: ClassVar[str] = "scene"

    def ratio(self, cost: IngredientCost) -> NDArray[np.float64]:
        """Time of a step per atom divided by that of the melt, in each turn, (R,)."""
        return cost.seconds / cost.n_atoms * self.costs[0].n_atoms / self.costs[0].seconds

    def lines(self) -> list[str]:
        """See Outcome."""
        base = self.costs[0]
        titles = {"scene": str} | dict.fromkeys(
            ["atoms", "µs per step", "ratio to the melt", "pairs per atom", "ratio per pair"], float
        )
        cells = []
        for cost in self.costs:
            ratio, pairs = self.ratio(cost), cost.n_pairs / cost.n_atoms
            by_pair = ratio * (base.n_pairs / base.n_atoms) / pairs
            times = [spread(1e6 * cost.seconds), spread(ratio)]
            cells.append([cost.name, str(cost.n_atoms), *times, f"{pairs:.1f}", spread(by_pair)])
        head = (
            f"One thread, double precision, velocity Verlet; median of {self.repeats} rounds (least to most); only "
            "pairs in range are counted."
        )
        return [head, "", *table(titles, cells)]

    def content(self) -> dict[str, Any]:
        """See Outcome."""
        rows = [
            {"name": c.name, "n_atoms": c.n_atoms, "n_pairs": c.n_pairs, "seconds_per_step": summary(c.seconds)}
            for c in self.costs
        ]
        return {"repeats": self.repeats, "rows": rows}

    def figure(self) -> "Figure":
        """A figure of the times relative to that of the melt."""
        ratios = {cost.name: self.ratio(cost) for cost in self.costs}
        return bars(ratios, "time of a step per atom, relative to the melt")


def run_ingredients(n: int, repeats: int) -> IngredientCosts:
    """Measure the time of the melt of 4 n³ atoms, and with one ingredient more or less, in turns."""
    with tempfile.TemporaryDirectory() as folder:
        loaded = {name: make() for name, make in _ingredients(equilibrated(melt(n)), n, Path(folder)).items()}
        engines = [engine for _, engine in loaded.values()]
        n_atoms = 4 * n**3
        n_steps = warm_up(engines, n_atoms)
        before = [pairs_in_range(scene, engine.positions) for scene, engine in loaded.values()]
        steps_per_second = take_turns(engines, n_steps, repeats, n_atoms)
        costs = []
        for k, (name, (scene, engine)) in enumerate(loaded.items()):
            n_pairs = 0.5 * (before[k] + pairs_in_range(scene, engine.positions))
            costs.append(IngredientCost(name, len(scene.system), n_pairs, 1.0 / steps_per_second[k]))
        tell("done")
        return IngredientCosts(costs, repeats)


def _ingredients(base: BenchScene, n: int, folder: Path) -> dict[str, Callable[[], tuple[BenchScene, Minimd]]]:
    """Functions that make a scene and its engine, by name."""
    bonds, length = partners(base.system)
    plain, excluding = (
        md.LennardJones(1.0, 1.0, CUTOFF, "truncated", bonded_scale=scale)
        for scale in ((1.0, 1.0, 1.0), (0.0, 1.0, 1.0))
    )
    spring, rigid = md.HarmonicBond(400.0, length), md.DistanceConstraints(bonds)
    bonded = _with(base, bonds=bonds)
    labels = np.where(np.arange(len(base.system)) % 2 == 0, "A", "B")
    two_kinds = md.LennardJones({"A": (1.0, 1.0), "B": (1.0, 1.0)}, cutoff=CUTOFF, truncation="truncated")
    langevin = md.LangevinBAOAB(TIMESTEP, MELT_TEMPERATURE, friction=1.0, seed=1)
    return {
        BASE: lambda: (base, Minimd(base)),
        "the melt once more": lambda: (base, Minimd(base)),
        "said to have no bonds, no constraints": lambda: _run(
            _with(base, bonds=np.zeros((0, 2), dtype=int))._replace(constraints=())
        ),
        "+ energy and pressure every 10 steps": lambda: (base, Minimd(base, every=EVERY)),
        "+ H5MD trajectory every 10 steps": lambda: (base, Minimd(base, every=EVERY, trajectory=folder / "run.h5md")),
        "+ XTC trajectory every 10 steps": lambda: (base, Minimd(base, every=EVERY, trajectory=folder / "run.xtc")),
        "+ energy and pressure every step": lambda: (base, Minimd(base, every=1)),
        "+ second species": lambda: _run(_with(base, species=labels)._replace(potentials=(two_kinds,))),
        "+ bonds": lambda: _run(bonded._replace(potentials=(plain, spring))),
        "+ bonds, exclusions": lambda: _run(bonded._replace(potentials=(excluding, spring))),
        "+ rigid bonds, exclusions": lambda: _run(bonded._replace(potentials=(excluding,), constraints=(rigid,))),
        "+ Langevin bath": lambda: (base, Minimd(base, method=langevin)),
        "− periodic boundaries (droplet)": lambda: _run(_with(base, pbc=False)),
        "Kob-Andersen mixture": lambda: _run(equilibrated(SCENES["kob-andersen"](n))),
        "chains of 100 beads": lambda: _run(equilibrated(SCENES["chains"](n))),
    }


def _run(scene: BenchScene) -> tuple[BenchScene, Minimd]:
    return scene, Minimd(scene)


def _with(scene: BenchScene, **changes: Any) -> BenchScene:
    """The scene with other species, bonds or pbc."""
    old = scene.system
    kept = {"species": old.species, "bonds": old.bonds, "pbc": old.cell.pbc} | changes
    system = md.System(
        old.positions, velocities=old.velocities, masses=old.masses, cell=old.cell.vectors, units=old.units, **kept
    )
    return scene._replace(system=system)


def partners(system: md.System) -> tuple[NDArray[np.int64], float]:
    """Pairs of neighbors, with each atom in at most one pair, (K, 2), and the mean of their distances [σ]."""
    edges = np.diag(system.cell.vectors)
    wrapped = system.positions % edges
    wrapped[wrapped >= edges] = 0.0
    near = cKDTree(wrapped, boxsize=edges).query_pairs(PARTNERS, output_type="ndarray")
    taken, chosen = np.zeros(len(system), dtype=bool), []
    for i, j in near:
        if not (taken[i] or taken[j]):
            taken[[i, j]] = True
            chosen.append((i, j))
    pairs = np.array(chosen)
    apart = system.positions[pairs[:, 1]] - system.positions[pairs[:, 0]]
    apart -= np.rint(apart / edges) * edges
    return pairs, float(np.linalg.norm(apart, axis=1).mean())
