"""`minimd bench scene`: the cost of each ingredient of a scene, and a test that an absent ingredient costs nothing."""

import tempfile
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

import minimd as md
from minimd.bench import scenes
from minimd.bench.engines import Minimd
from minimd.bench.outcome import bars, spread, summary, table
from minimd.bench.scenes import SCENES, BenchScene, equilibrated, pairs_in_range
from minimd.bench.turns import take_turns, warm_up
from minimd.core.compiled.terminal import tell
from minimd.core.structure.arrays import Array, Indices
from minimd.core.structure.system import changed

if TYPE_CHECKING:
    from matplotlib.figure import Figure

PARTNERS = 1.3  # σ: only closer atoms are bonded; this is within the first peak of g(r)


class IngredientCost(NamedTuple):
    """The cost of one ingredient.
    seconds : (R,) of a step in each turn.
    n_pairs : number of pairs in range."""

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
        titles = {
            "scene": str,
            "atoms": float,
            "µs per step": float,
            "ratio to the melt": float,
            "pairs per atom": float,
            "ratio per pair": float,
        }
        pairs_of_melt = self.costs[0].n_pairs / self.costs[0].n_atoms
        cells = []

        for cost in self.costs:
            time = spread(1e6 * cost.seconds)
            ratio = self.ratio(cost)
            pairs = cost.n_pairs / cost.n_atoms
            by_pair = spread(ratio * pairs_of_melt / pairs)
            cells.append([cost.name, cost.n_atoms, time, spread(ratio), f"{pairs:.1f}", by_pair])

        head = (
            f"One thread, double precision, velocity Verlet; median of {self.repeats} rounds (least to most); only "
            "pairs in range are counted."
        )
        return [head, "", *table(titles, cells)]

    def content(self) -> dict[str, Any]:
        """See Outcome."""
        rows = []
        for cost in self.costs:
            row = cost._asdict()
            row["seconds_per_step"] = summary(row.pop("seconds"))
            rows.append(row)
        return {"repeats": self.repeats, "rows": rows}

    def figure(self) -> "Figure":
        """A figure of the times relative to that of the melt."""
        ratios = {cost.name: self.ratio(cost) for cost in self.costs}
        return bars(ratios, "time of a step per atom, relative to the melt")


def run_ingredients(n: int, repeats: int) -> IngredientCosts:
    """Measure the time of the melt of 4 n³ atoms, and with one ingredient more or less, in turns."""
    n_atoms = 4 * n**3
    base = equilibrated(SCENES[scenes.MELT](n))

    with tempfile.TemporaryDirectory() as folder:
        ingredients = _ingredients(base, n, Path(folder))
        engines = [Minimd(scene, 1, *options) for scene, *options in ingredients.values()]

        def pairs() -> list[int]:
            placed = zip(ingredients.values(), engines, strict=True)
            return [pairs_in_range(scene, engine.positions) for (scene, *_), engine in placed]

        n_steps = warm_up(engines, n_atoms)
        before = pairs()
        seconds = 1.0 / take_turns(engines, n_steps, repeats, n_atoms)
        n_pairs = 0.5 * np.add(before, pairs())

    sizes = [len(scene.system) for scene, *_ in ingredients.values()]
    tell("done")
    costs = map(IngredientCost, ingredients, sizes, n_pairs.tolist(), seconds)
    return IngredientCosts(list(costs), repeats)


def _ingredients(base: BenchScene, n: int, folder: Path) -> dict[str, tuple]:
    """For each name a scene and, where these are not as usual, the steps between observations and a trajectory."""
    bonds, length = partners(base.system)
    spring = md.HarmonicBond(400.0, length)
    excluding = scenes.lennard_jones(truncation="truncated", scale=scenes.UNBONDED)
    two_kinds = md.LennardJones(
        {"A": (1.0, 1.0), "B": (1.0, 1.0)}, cutoff=scenes.CUTOFF, truncation="truncated"
    )
    labels = np.where(np.arange(len(base.system)) % 2 == 0, "A", "B")
    mixed = _with(base, species=labels)._replace(potentials=(two_kinds,))
    bonded = _with(base, bonds=bonds)
    rigid = md.DistanceConstraints(bonds)
    held = bonded._replace(potentials=(excluding,), constraints=(rigid,))
    langevin = md.LangevinBAOAB(scenes.TIMESTEP, scenes.MELT_TEMPERATURE, friction=1.0, seed=1)
    return {
        "melt": (base,),
        "the melt once more": (base,),
        "said to have no bonds or constraints": (_with(base, bonds=np.zeros((0, 2), int)),),
        "+ energy and pressure every 10 steps": (base, 10),
        "+ H5MD trajectory every 10 steps": (base, 10, folder / "run.h5md"),
        "+ XTC trajectory every 10 steps": (base, 10, folder / "run.xtc"),
        "+ energy and pressure every step": (base, 1),
        "+ second species": (mixed,),
        "+ bonds": (bonded._replace(potentials=(*base.potentials, spring)),),
        "+ bonds, exclusions": (bonded._replace(potentials=(excluding, spring)),),
        "+ rigid bonds, exclusions": (held,),
        "+ Langevin bath": (base._replace(method=langevin),),
        "− periodic boundaries (droplet)": (_with(base, cell=base.edges, pbc=False),),
        "Kob-Andersen mixture": (equilibrated(SCENES["kob-andersen"](n)),),
        "chains of 100 beads": (equilibrated(SCENES["chains"](n)),),
    }


def _with(scene: BenchScene, **changes: Any) -> BenchScene:
    """The scene with other arguments of its system."""
    return scene._replace(system=changed(scene.system, **changes))


def partners(system: md.System) -> tuple[Indices, float]:
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
