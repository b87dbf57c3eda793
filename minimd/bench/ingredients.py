"""`minimd bench scene`: the cost of each ingredient of a scene, and a test that an absent ingredient costs nothing."""

import tempfile
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

import minimd as md
from minimd.bench import scenes
from minimd.bench.engines import Minimd
from minimd.bench.outcome import bars, spread, summary, table
from minimd.bench.scenes import SCENES, BenchScene, equilibrated, pairs_in_range
from minimd.bench.turns import take_turns, warm_up
from minimd.core.compiled.terminal import tell
from minimd.core.structure.observables import Array
from minimd.core.structure.system import changed

if TYPE_CHECKING:
    from matplotlib.figure import Figure

PARTNERS = 1.3  # σ: only closer atoms are bonded; this is within the first peak of g(r)


class IngredientCost(NamedTuple):
    """The cost of one ingredient.  seconds : (R,) of a step in each turn.  n_pairs : number of pairs in range."""

    name: str
    n_atoms: int
    n_pairs: float
    seconds: Array


@dataclass
class IngredientCosts:
    """The costs of all ingredients, the melt first."""

    costs: Sequence[IngredientCost]
    repeats: int
    packages = ("h5py", "MDAnalysis")
    name = "scene"

    def ratio(self, cost: IngredientCost) -> Array:
        """Time of a step per atom divided by that of the melt, in each turn, (R,)."""
        return cost.seconds / cost.n_atoms * self.costs[0].n_atoms / self.costs[0].seconds

    def lines(self) -> list[str]:
        """See Outcome."""
        base = self.costs[0]
        cells = []
        for cost in self.costs:
            ratio = self.ratio(cost)
            pairs = cost.n_pairs / cost.n_atoms
            by_pair = spread(ratio * (base.n_pairs / base.n_atoms) / pairs)
            cells.append(
                [
                    cost.name,
                    cost.n_atoms,
                    spread(1e6 * cost.seconds),
                    spread(ratio),
                    f"{pairs:.1f}",
                    by_pair,
                ]
            )
        numbers = ("atoms", "µs per step", "ratio to the melt", "pairs per atom", "ratio per pair")
        head = (
            f"One thread, double precision, velocity Verlet; median of {self.repeats} rounds (least to most); only "
            "pairs in range are counted."
        )
        return [head, "", *table({"scene": str} | dict.fromkeys(numbers, float), cells)]

    def content(self) -> dict[str, Any]:
        """See Outcome."""
        rows = [cost._asdict() for cost in self.costs]
        return {
            "repeats": self.repeats,
            "rows": [one | {"seconds_per_step": summary(one.pop("seconds"))} for one in rows],
        }

    def figure(self) -> "Figure":
        """A figure of the times relative to that of the melt."""
        return bars(
            {cost.name: self.ratio(cost) for cost in self.costs},
            "time of a step per atom, relative to the melt",
        )


def run_ingredients(n: int, repeats: int) -> IngredientCosts:
    """Measure the time of the melt of 4 n³ atoms, and with one ingredient more or less, in turns."""
    n_atoms = 4 * n**3
    base = equilibrated(SCENES[scenes.MELT](n))
    with tempfile.TemporaryDirectory() as folder:
        rows = _ingredients(base, n, Path(folder))
        engines = [Minimd(scene, **how) for scene, how in rows.values()]
        loaded = [
            (scene, engine) for (scene, _), engine in zip(rows.values(), engines, strict=True)
        ]
        n_steps = warm_up(engines, n_atoms)
        before = [pairs_in_range(scene, engine.positions) for scene, engine in loaded]
        seconds = 1.0 / take_turns(engines, n_steps, repeats, n_atoms)
        after = [pairs_in_range(scene, engine.positions) for scene, engine in loaded]
    sizes = [len(scene.system) for scene, _ in loaded]
    n_pairs = 0.5 * np.add(before, after)
    tell("done")
    return IngredientCosts(
        list(map(IngredientCost, rows, sizes, n_pairs.tolist(), seconds)), repeats
    )


def _ingredients(
    base: BenchScene, n: int, folder: Path
) -> dict[str, tuple[BenchScene, dict[str, Any]]]:
    """Scenes and the options of their engines, by name."""
    bonds, length = partners(base.system)
    plain, excluding = (
        md.LennardJones(1.0, 1.0, scenes.CUTOFF, "truncated", bonded_scale=(scale, 1.0, 1.0))
        for scale in (1.0, 0.0)
    )
    spring = md.HarmonicBond(400.0, length)
    rigid = md.DistanceConstraints(bonds)
    bonded = _with(base, bonds=bonds)
    labels = np.where(np.arange(len(base.system)) % 2 == 0, "A", "B")
    two_kinds = md.LennardJones(
        {"A": (1.0, 1.0), "B": (1.0, 1.0)}, cutoff=scenes.CUTOFF, truncation="truncated"
    )
    langevin = md.LangevinBAOAB(scenes.TIMESTEP, scenes.MELT_TEMPERATURE, friction=1.0, seed=1)
    often = {"every": 10}  # steps between observations
    return {
        "melt": (base, {}),
        "the melt once more": (base, {}),
        "said to have no bonds or constraints": (_with(base, bonds=np.zeros((0, 2), int))._replace(constraints=()), {}),
        "+ energy and pressure every 10 steps": (base, often),
        "+ H5MD trajectory every 10 steps": (base, often | {"trajectory": folder / "run.h5md"}),
        "+ XTC trajectory every 10 steps": (base, often | {"trajectory": folder / "run.xtc"}),
        "+ energy and pressure every step": (base, {"every": 1}),
        "+ second species": (_with(base, species=labels)._replace(potentials=(two_kinds,)), {}),
        "+ bonds": (bonded._replace(potentials=(plain, spring)), {}),
        "+ bonds, exclusions": (bonded._replace(potentials=(excluding, spring)), {}),
        "+ rigid bonds, exclusions": (bonded._replace(potentials=(excluding,), constraints=(rigid,)), {}),
        "+ Langevin bath": (base._replace(method=langevin), {}),
        "− periodic boundaries (droplet)": (_with(base, cell=base.system.cell.vectors, pbc=False), {}),
        "Kob-Andersen mixture": (equilibrated(SCENES["kob-andersen"](n)), {}),
        "chains of 100 beads": (equilibrated(SCENES["chains"](n)), {}),
    }  # fmt: skip


def _with(scene: BenchScene, **changes: Any) -> BenchScene:
    """The scene with other arguments of its system."""
    return scene._replace(system=changed(scene.system, **changes))


def partners(system: md.System) -> tuple[NDArray[np.int64], float]:
    """Pairs of neighbors, with each atom in at most one pair, (K, 2), and the mean of their distances [σ]."""
    taken = np.zeros(len(system), dtype=bool)
    pairs = []
    lengths = []
    for i, j, length in zip(*md.neighbor_list("ijd", system, PARTNERS), strict=True):
        if not (taken[i] or taken[j]):
            taken[[i, j]] = True
            pairs.append((i, j))
            lengths.append(length)
    return np.array(pairs), float(np.mean(lengths))
