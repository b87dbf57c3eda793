"""Calls that make no sense, drawn at random from a table of doors and a table of values: a sentence or a right result, and soon."""

from collections import Counter
from fractions import Fraction
from time import perf_counter

import numpy as np
import pytest
from answers import answer_of
from scene_texts import REDUCED, everything_of

import minimd as md
from minimd.structure.checks import shown

SECONDS = 2.0  # for one call; none needs a hundredth of it once the kernels are compiled
THREE = np.array([[0.0, 0.0, 0.0], [1.2, 0.0, 0.0], [0.0, 1.2, 0.0]])
ITSELF: list = []
ITSELF.append(ITSELF)

SENSELESS = [  # what no argument of any door may mean
    *(
        float("nan"),
        [float("nan")],
        1 + 2j,
        np.array([1j, 2, 3]),
        10**400,
        -(10**30),
        np.datetime64("2020-01-01"),
        b"x",
    ),
    *(
        np.ma.masked,
        np.ma.array([1.0, 2.0, 3.0], mask=[0, 1, 0]),
        object(),
        [object()] * 3,
        {1: 2},
        ITSELF,
        [[1, 2], [3]],
    ),
    np.broadcast_to(1.0, (10**12, 3)),  # as large as it says, in eight bytes
]
STRANGE = [
    *(
        None,
        True,
        False,
        "False",
        "",
        "abc",
        "1.5",
        b"",
        np.bool_(True),
        np.array("1.5"),
        print,
        range(3),
        [],
        (),
        {},
        set(),
    ),
    *(
        float("inf"),
        -float("inf"),
        -1.0,
        -1,
        0,
        0.0,
        5e-324,
        1e-300,
        1e300,
        1e14,
        2**63,
        10**20,
        [10**12] * 3,
        Fraction(3, 2),
    ),
    *(
        np.float32(2.5),
        np.float32(1e-40),
        np.float16(3),
        np.int8(-1),
        np.uint64(2),
        [True, 2.0, 3.0],
        np.array([None, 1.0]),
    ),
    *(np.array([]), np.zeros((0, 3)), np.zeros((2, 2, 2)), np.full((3, 3), np.inf)),
]
CHANGES = {
    "masked": lambda good: np.ma.masked_array(np.array(good), mask=np.ones_like(np.array(good), dtype=bool)),
    "complex": lambda good: np.array(good) + 1j,
    "texts": lambda good: np.array(good).astype(str),
    "NaN": lambda good: np.array(good) * float("nan"),
    "dates": lambda good: np.array(good).astype(int).astype("datetime64[s]"),
    "far": lambda good: np.array(good) + 1e14,
    "huge": lambda good: np.array(good) * 1e300,
    "tiny": lambda good: np.array(good) * 1e-300,
    "negative": lambda good: -np.array(good),
    "bools": lambda good: np.array(good).astype(bool),
    "unsigned": lambda good: np.array(good).astype(np.uint64),
    "single": lambda good: np.array(good).astype(np.float32),
    "list": lambda good: np.array(good).tolist(),
    "deeper": lambda good: np.array(good)[None],
    "longer": lambda good: np.repeat(np.array(good), 2, axis=0),
    "objects": lambda good: np.array(good).astype(object),
}


def law(r2, a):
    return a / r2, 2.0 * a / r2**2


def system(**changed):
    return md.System(
        **({"positions": THREE, "cell": 10.0, "bonds": [[0, 1], [0, 2]], "species": ["A", "B", "A"]} | changed)
    )


def energy_of(potential):
    return md.evaluate(system(), potential).potential_energy


def simulation(method=None, constraints=(), **options):
    made = md.Simulation(
        system(), md.LennardJones(1.0, 1.0, 2.5), method or md.VelocityVerlet(0.002), constraints, **options
    )
    made.make_steps(1)
    return made


def called(name):
    return lambda **arguments: getattr(simulation(), name)(**arguments)


def scene_with(**changed):
    """A scene in which numbers are replaced by other values, written as Python writes them."""
    text = REDUCED
    for key, value in changed.items():
        line = next(line for line in text.splitlines() if line.startswith(f"{key} ="))
        text = text.replace(line, f"{key} = {value!r}".replace("True", "true").replace("False", "false"), 1)
    return everything_of(text)


SPECIES = {"A": (1.0, 1.0), "B": (0.5, 0.9)}
DOORS = {  # a call, and arguments with which it works
    "System": (system, {"positions": THREE, "masses": [1.0, 2.0, 3.0], "velocities": THREE, "cell": [9.0, 9.0, 9.0]}),
    "System, more": (
        system,
        {
            "pbc": [True, True, False],
            "species": ["A", "A", "B"],
            "bonds": [[0, 1]],
            "units": md.units.LJ,
            "constraints": (),
        },
    ),
    "Cell.of": (md.Cell.of, {"vectors": np.eye(3), "pbc": [True, False, True]}),
    "Cell": (md.Cell, {"vectors": np.eye(3), "pbc": np.array([True, True, False])}),
    "LennardJones": (
        lambda **some: energy_of(md.LennardJones(**some)),
        {"epsilon": 1.0, "sigma": 1.0, "cutoff": 2.5, "truncation": "switched", "switch_start": 2.0}
        | {"bonded_scale": (0.0, 0.5, 1.0), "tail_correction": True},
    ),
    "LennardJones of species": (
        lambda **some: energy_of(md.LennardJones(**some)),
        {
            "epsilon": SPECIES,
            "cutoff": {("A", "A"): 2.0, ("A", "B"): 2.5, ("B", "B"): 2.5},
            "mixing": "geometric",
            "pairs": {("A", "B"): (0.7, 1.0)},
        },
    ),
    "PairPotential": (
        lambda **some: md.PairPotential(**some).pair_energy(1.0),
        {"law": law, "parameters": (1.0,), "cutoff": 2.5},
    ),
    "pair_energy": (lambda r: md.LennardJones(1.0, 1.0, 2.5).pair_energy(r), {"r": [1.0, 2.0, 3.0]}),
    "HarmonicBond": (
        lambda **some: energy_of(md.HarmonicBond(**some)),
        {"k": [3.0, 1.0], "length": [1.0, 0.0], "pairs": [[0, 1], [1, 2]]},
    ),
    "HarmonicAngle": (
        lambda **some: energy_of(md.HarmonicAngle(**some)),
        {"k": [3.0], "angle": [1.0], "triples": [[0, 1, 2]]},
    ),
    "DistanceConstraints": (
        lambda **some: simulation(constraints=md.DistanceConstraints(**some)),
        {"pairs": [[0, 1]], "lengths": [1.2], "tolerance": 1e-10, "solver": "auto"},
    ),
    "FixedAtoms": (lambda atoms: simulation(constraints=md.FixedAtoms(atoms)), {"atoms": [0, 2]}),
    "VelocityVerlet": (lambda timestep: simulation(md.VelocityVerlet(timestep)), {"timestep": 0.001}),
    "LangevinBAOAB": (
        lambda **some: simulation(md.LangevinBAOAB(**some)),
        {"timestep": 0.001, "temperature": 1.0, "friction": 1.0, "seed": 3},
    ),
    "StochasticVelocityRescaling": (
        lambda **some: simulation(md.StochasticVelocityRescaling(**some)),
        {"timestep": 0.001, "temperature": 1.0, "relaxation_time": 1.0, "seed": 3},
    ),
    "Simulation": (
        lambda **some: md.Simulation(**some).make_steps(1),
        {
            "system": system(),
            "potentials": md.LennardJones(1.0, 1.0, 2.5),
            "method": md.VelocityVerlet(0.001),
            "constraints": None,
        },
    ),
    "Simulation, options": (simulation, {"threads": 1, "precision": "double", "skin": 0.3}),
    "run": (
        called("run"),
        {
            "n_steps": 2,
            "every": 2,
            "trajectory": (),
            "store_forces": False,
            "overwrite": False,
            "observers": (),
            "progress": False,
        },
    ),
    "set_temperature": (called("set_temperature"), {"temperature": 1.0, "seed": 1}),
    "equilibrate": (called("equilibrate"), {"n_steps": 2, "temperature": 1.0, "every": 1, "progress": False}),
    "make_steps": (called("make_steps"), {"n_steps": 2}),
    "minimize": (
        called("minimize"),
        {"force_tolerance": 1e-3, "max_steps": 5, "max_step_length": 0.1, "progress": False},
    ),
    "neighbor_list": (md.neighbor_list, {"quantities": "ijd", "system": system(), "cutoff": 2.5}),
    "advise_timestep": (
        md.advise_timestep,
        {"system": system(), "potentials": md.LennardJones(1.0, 1.0, 2.5), "method": md.VelocityVerlet},
    ),
    "crystal": (md.lattice.crystal, {"lattice": "fcc", "repeat": [2, 2, 2], "lattice_constant": 1.5}),
    "constant_from_density": (md.lattice.constant_from_density, {"lattice": "fcc", "density": 0.8, "mass": 1.0}),
    "scene": (
        scene_with,
        {"timestep": 0.004, "steps": 20, "temperature": 1.44, "cutoff": 2.5, "repeat": [4, 4, 4], "density": 0.8},
    ),
}
ENDLESS = {"n_steps", "max_steps", "steps"}  # a large one is no mistake, but takes its time
NUMBERS = (float, int, list, tuple, np.ndarray)


def hostile_call(rng):
    """A door, its name, and its arguments with one or two of them made senseless; whether no sense can be made of them."""
    name = str(rng.choice(list(DOORS)))
    call, good = DOORS[name]
    arguments, told, is_senseless = dict(good), [], False
    for key in rng.choice(list(good), size=min(len(good), int(rng.integers(1, 3))), replace=False):
        pool = [SENSELESS, STRANGE, CHANGES, CHANGES][int(rng.integers(4))]
        if (
            pool is CHANGES
            and isinstance(good[key], NUMBERS)
            and not isinstance(good[key], bool)
            and np.size(good[key])
        ):
            change = str(rng.choice(list(CHANGES)))
            try:
                arguments[key] = CHANGES[change](good[key])
            except (TypeError, ValueError):
                continue  # texts cannot be multiplied
            told.append(f"{key} {change}")
        else:
            pool = STRANGE if pool is CHANGES else pool
            value = pool[int(rng.integers(len(pool)))]
            if key in ENDLESS and isinstance(value, int) and value > 100:
                continue
            arguments[key], is_senseless = value, is_senseless or pool is SENSELESS
            told.append(f"{key} = {shown(value)}")
    return name, call, arguments, ", ".join(told), is_senseless


def answer_to(call, arguments, is_senseless):
    """The class of the answer: the name of the exception, or "result"; other words say what is wrong with it."""
    started = perf_counter()
    kind = answer_of(lambda: call(**arguments), is_senseless, has_several_problems=call is scene_with)
    seconds = perf_counter() - started
    return f"slow: {seconds:.1f} s" if seconds > SECONDS else kind


def answers(n_calls, seed=1):
    """How often each class of answers comes to random calls, and the calls whose answer is wrong."""
    rng, found, wrong = np.random.default_rng(seed), Counter(), []
    for call, good in DOORS.values():
        call(**good)  # compiles
    for _ in range(n_calls):
        name, call, arguments, told, is_senseless = hostile_call(rng)
        answer = answer_to(call, arguments, is_senseless)
        found[answer if answer.isidentifier() else "wrong"] += 1
        if not answer.isidentifier():
            wrong.append(f"{name}({told}): {answer}")
    return found, wrong


@pytest.mark.parametrize("n_calls", [120, pytest.param(10_000, marks=pytest.mark.slow)])
def test_every_senseless_call_is_answered_with_a_sentence_or_a_right_result(n_calls):
    found, wrong = answers(n_calls)
    assert not wrong, "\n".join(wrong[:20])
    assert found["result"] > 0.05 * n_calls
    assert found["ValueError"] > 0.3 * n_calls
