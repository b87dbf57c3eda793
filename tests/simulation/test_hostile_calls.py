"""Senseless calls, drawn from a table of doors and tables of values: a sentence or a right result, and soon."""

from fractions import Fraction
from time import perf_counter

import numpy as np
import pytest
from scene_texts import REDUCED, everything_of
from wrong_calls import answer_of, assert_right

import minimd as md
from minimd.console.words import shown

SECONDS = 2.0  # for one call; none needs a hundredth of it once the kernels are compiled
THREE = np.array([[0.0, 0.0, 0.0], [1.2, 0.0, 0.0], [0.0, 1.2, 0.0]])
ITSELF: list = []
ITSELF.append(ITSELF)
NAN, INF = float("nan"), float("inf")
LJ, VERLET = md.LennardJones(1.0, 1.0, 2.5), md.VelocityVerlet(0.001)
# what no argument of any door may mean; the last is as large as it says, in eight bytes
SENSELESS = [NAN, [NAN], 1 + 2j, np.array([1j, 2, 3]), 10**400, -(10**30), np.datetime64("2020-01-01"), b"x"]
SENSELESS += [np.ma.masked, np.ma.array([1.0, 2.0, 3.0], mask=[0, 1, 0]), object(), [object()] * 3, {1: 2}, ITSELF]
SENSELESS += [[[1, 2], [3]], np.broadcast_to(1.0, (10**12, 3))]
STRANGE = [None, True, False, "False", "", "abc", "1.5", b"", np.bool_(True), np.array("1.5"), print, range(3)]
STRANGE += [[], (), {}, set(), INF, -INF, -1.0, -1, 0, 0.0, 5e-324, 1e-300, 1e300, 1e14, 2**63, 10**20, [10**12] * 3]
STRANGE += [Fraction(3, 2), np.float32(2.5), np.float32(1e-40), np.float16(3), np.int8(-1), np.uint64(2)]
STRANGE += [[True, 2.0, 3.0], np.array([None, 1.0]), np.array([]), np.zeros((0, 3)), np.zeros((2, 2, 2))]
STRANGE += [np.full((3, 3), INF)]
CHANGES = {  # of an array of good numbers
    "masked": lambda good: np.ma.masked_array(good, mask=np.ones_like(good, dtype=bool)),
    "complex": lambda good: good + 1j,        "texts": lambda good: good.astype(str),
    "NaN": lambda good: good * NAN,           "dates": lambda good: good.astype(int).astype("datetime64[s]"),
    "far": lambda good: good + 1e14,          "huge": lambda good: good * 1e300,
    "tiny": lambda good: good * 1e-300,       "negative": lambda good: -good,
    "bools": lambda good: good.astype(bool),  "unsigned": lambda good: good.astype(np.uint64),
    "single": lambda good: good.astype(np.float32), "list": lambda good: good.tolist(),
    "deeper": lambda good: good[None],        "longer": lambda good: np.repeat(good, 2, axis=0),
    "objects": lambda good: good.astype(object),
}  # fmt: skip


# fmt: off
def system(**changed):
    return md.System(**{"positions": THREE, "cell": 10.0, "bonds": [[0, 1], [0, 2]], "species": list("ABA")} | changed)

def simulation(method=VERLET, constraints=(), **options):
    made = md.Simulation(system(), LJ, method, constraints, **options)
    made.make_steps(1)
    return made

def called(name):
    return lambda **arguments: getattr(simulation(), name)(**arguments)

def energy_of(kind):
    return lambda **arguments: md.evaluate(system(), kind(**arguments)).potential_energy

def run_by(kind):
    return lambda **arguments: simulation(kind(**arguments))

def held_by(kind):
    return lambda **arguments: simulation(constraints=kind(**arguments))
# fmt: on


def scene_with(**changed):
    """A scene in which numbers are replaced by other values, written as Python writes them."""
    text = REDUCED
    for key, value in changed.items():
        line = next(line for line in text.splitlines() if line.startswith(f"{key} ="))
        text = text.replace(line, f"{key} = {value!r}".replace("True", "true").replace("False", "false"), 1)
    return everything_of(text)


SPECIES = {"A": (1.0, 1.0), "B": (0.5, 0.9)}
CUTOFFS = {("A", "A"): 2.0, ("A", "B"): 2.5, ("B", "B"): 2.5}
SWITCHED = {"truncation": "switched", "switch_start": 2.0, "bonded_scale": (0.0, 0.5, 1.0), "tail_correction": True}
UNLIKE = {"mixing": "geometric", "pairs": {("A", "B"): (0.7, 1.0)}}
SOLVED = {"tolerance": 1e-10, "solver": "auto"}
SCENE = {"system": system(), "potentials": LJ}
INVERSE_SQUARE = {"law": lambda r2, a: (a / r2, 2.0 * a / r2**2), "parameters": (1.0,), "cutoff": 2.5}
BATH = {"timestep": 0.001, "temperature": 1.0, "seed": 3}
DOORS = [  # a name, a call, and arguments with which it works
    ("System", system, {"positions": THREE, "masses": [1.0, 2.0, 3.0], "velocities": THREE, "cell": [9.0, 9.0, 9.0]}),
    ("System", system, {"pbc": [True, True, False], "species": ["A", "A", "B"], "bonds": [[0, 1]]}),
    ("System", system, {"units": md.units.LJ, "constraints": ()}),
    ("Cell.of", md.Cell.of, {"vectors": np.eye(3), "pbc": [True, False, True]}),
    ("Cell", md.Cell, {"vectors": np.eye(3), "pbc": np.array([True, True, False])}),
    ("LennardJones", energy_of(md.LennardJones), {"epsilon": 1.0, "sigma": 1.0, "cutoff": 2.5} | SWITCHED),
    ("LennardJones", energy_of(md.LennardJones), {"epsilon": SPECIES, "cutoff": CUTOFFS} | UNLIKE),
    ("PairPotential", lambda **given: md.PairPotential(**given).pair_energy(1.0), INVERSE_SQUARE),
    ("pair_energy", LJ.pair_energy, {"r": [1.0, 2.0, 3.0]}),
    ("HarmonicBond", energy_of(md.HarmonicBond), {"k": [3.0, 1.0], "length": [1.0, 0.0], "pairs": [[0, 1], [1, 2]]}),
    ("HarmonicAngle", energy_of(md.HarmonicAngle), {"k": [3.0], "angle": [1.0], "triples": [[0, 1, 2]]}),
    ("DistanceConstraints", held_by(md.DistanceConstraints), {"pairs": [[0, 1]], "lengths": [1.2]} | SOLVED),
    ("FixedAtoms", held_by(md.FixedAtoms), {"atoms": [0, 2]}),
    ("VelocityVerlet", run_by(md.VelocityVerlet), {"timestep": 0.001}),
    ("LangevinBAOAB", run_by(md.LangevinBAOAB), BATH | {"friction": 1.0}),
    ("StochasticVelocityRescaling", run_by(md.StochasticVelocityRescaling), BATH | {"relaxation_time": 1.0}),
    ("Simulation", lambda **some: md.Simulation(**some).make_steps(1), SCENE | {"method": VERLET, "constraints": None}),
    ("Simulation", simulation, {"threads": 1, "precision": "double", "skin": 0.3}),
    ("run", called("run"), {"n_steps": 2, "every": 2, "trajectory": (), "store_forces": False}),
    ("run", called("run"), {"n_steps": 2, "overwrite": False, "observers": (), "progress": False}),
    ("set_temperature", called("set_temperature"), {"temperature": 1.0, "seed": 1}),
    ("equilibrate", called("equilibrate"), {"n_steps": 2, "temperature": 1.0, "every": 1, "progress": False}),
    ("make_steps", called("make_steps"), {"n_steps": 2}),
    ("minimize", called("minimize"), {"force_tolerance": 1e-3, "max_steps": 5, "max_step_length": 0.1}),
    ("minimize", called("minimize"), {"max_steps": 5, "progress": False}),
    ("neighbor_list", md.neighbor_list, {"quantities": "ijd", "system": system(), "cutoff": 2.5}),
    ("advise_timestep", md.advise_timestep, SCENE | {"method": md.VelocityVerlet}),
    ("crystal", md.lattice.crystal, {"lattice": "fcc", "repeat": [2, 2, 2], "lattice_constant": 1.5}),
    ("constant_from_density", md.lattice.constant_from_density, {"lattice": "fcc", "density": 0.8, "mass": 1.0}),
    ("scene", scene_with, {"timestep": 0.004, "steps": 20, "temperature": 1.44, "cutoff": 2.5}),
    ("scene", scene_with, {"repeat": [4, 4, 4], "density": 0.8}),
]
ENDLESS = {"n_steps", "max_steps", "steps"}  # a large one is no mistake, but takes its time
NUMBERS = (float, int, list, tuple, np.ndarray)


def hostile_value(key, good, rng):
    """(a value for an argument, in words, whether no sense can be made of it); None if there is none."""
    pool = [SENSELESS, STRANGE, CHANGES, CHANGES][int(rng.integers(4))]
    if pool is CHANGES and isinstance(good, NUMBERS) and not isinstance(good, bool) and np.size(good):
        change = str(rng.choice(list(CHANGES)))
        try:
            return CHANGES[change](np.array(good)), f"{key} {change}", False
        except (TypeError, ValueError):
            return None  # texts cannot be multiplied
    pool = STRANGE if pool is CHANGES else pool
    value = pool[int(rng.integers(len(pool)))]
    if key in ENDLESS and isinstance(value, int) and value > 100:
        return None
    return value, f"{key} = {shown(value)}", pool is SENSELESS


def hostile_calls(rounds, rng):
    """Every argument of every door made senseless so many times, half of them together with another one."""
    for name, call, good in rounds * DOORS:
        for key in good:
            others = [str(rng.choice(list(good)))] if rng.random() < 0.5 else []
            changes = {one: hostile_value(one, good[one], rng) for one in [key, *others]}
            found = {one: change for one, change in changes.items() if change}
            told = f"{name}({', '.join(words for _, words, _ in found.values())})"
            arguments = good | {one: value for one, (value, _, _) in found.items()}
            yield told, call, arguments, any(is_senseless for _, _, is_senseless in found.values())


def answer_to(call, arguments, is_senseless):
    started = perf_counter()
    answer = answer_of(lambda: call(**arguments), is_senseless, has_several_problems=call is scene_with)
    seconds = perf_counter() - started
    return answer if seconds < SECONDS else f"slow: {seconds:.1f} s"


@pytest.mark.parametrize("rounds", [1, pytest.param(100, marks=pytest.mark.slow)])
def test_every_senseless_call_is_answered_with_a_sentence_or_a_right_result(rounds):
    for _, call, good in DOORS:
        call(**good)  # compiles
    assert_right((told, answer_to(*rest)) for told, *rest in hostile_calls(rounds, np.random.default_rng(1)))
