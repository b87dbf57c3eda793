"""Constraints that cannot be kept, and how each is answered."""

import numpy as np
import pytest
from rigid_scenes import RIGID_RING, cube, ring_in, water
from scenes import SCENES
from wrong_calls import assert_answered

import minimd as md
from minimd.constraints import ConstraintSolver, DistanceConstraints
from minimd.scene import parse_scene

EDGES = cube()[1].tolist()


def solver(pairs, lengths=None, positions=None, inverse_masses=None, **options):
    positions = cube()[0] if positions is None else positions
    inverse_masses = np.ones(len(positions)) if inverse_masses is None else inverse_masses
    return ConstraintSolver(DistanceConstraints(pairs, lengths, **options), positions, inverse_masses)


def kept(constraints):
    return SCENES["dumbbells"]()._replace(constraints=constraints).simulation()


WRONG = [  # call, error, what is shown
    (lambda: solver(np.empty((0, 2), dtype=int)), ValueError, "pairs"),
    (lambda: solver([[0, 0]]), ValueError, "pairs", "[0, 0]"),
    (lambda: solver([[2, 1], [0, 1], [1, 0], [1, 2], [0, 1]]), ValueError, "pairs[0]", "[2, 1]"),  # as it is given
    (lambda: solver([[0, 1]], -1.0), ValueError, "lengths", "-1.0"),
    (lambda: solver([[0, 99]]), ValueError, "99"),
    (lambda: solver([[0, 1]], solver="lincs"), ValueError, "solver", "'lincs'"),
    (lambda: solver([[0, 1]], tolerance=1.0), ValueError, "tolerance", "1.0"),
    (lambda: solver([*EDGES, [0, 7]]), ValueError, "follows from the other constraints", "atoms"),
    (lambda: solver([[0, 1]], inverse_masses=np.zeros(8)), ValueError, "(atoms 0-1)", "held fixed"),
    (lambda: solver([[0, 1], [1, 2], [0, 2]], [1.0, 1.0, 2.5], water(1)[0]), ValueError, "triangle", "[2, 1, 0]"),
    (lambda: kept(md.FixedAtoms(np.ones(5, dtype=bool))), ValueError, "fixed atoms", "64 atoms", "5 bools"),
    (lambda: kept(md.FixedAtoms([-1])), ValueError, "fixed atoms", "[-1]"),
    (lambda: kept(md.FixedAtoms([[0, 1]])), ValueError, "fixed atoms", "[[0, 1]]"),
    (lambda: kept("rigid"), TypeError, "constraints"),
    (lambda: kept([md.FixedAtoms([0]), "x"]), TypeError, "constraints"),
]


@pytest.mark.parametrize(("call", "error", "shown"), [(call, error, shown) for call, error, *shown in WRONG])
def test_wrong_constraints_are_answered(call, error, shown):
    assert_answered(call, error, *shown)


SECTIONS = [  # [constraints] of a scene, what is shown
    ("pair = [[0, 1]]", "constraints has no key 'pair'", "did you mean 'pairs'?"),
    ("pairs = [[0, 1]]\nlengths = 1.5", "constraints has no key 'lengths'", "did you mean 'lengths_A'?"),
    ('pairs = "bond"', "constraints.pairs", '"bond"'),
    ("pairs = [[0, 1, 2]]", "constraints.pairs[0]", "[0, 1, 2]"),
    ("pairs = [[0, 1], [1, 0]]", "constraints: pairs", "pairs[0] = [0, 1]"),
    ("pairs = [[0, 1], [1, 2]]\nlengths_A = [1.5]", "constraints", "lengths_A", "2 pairs"),
    ('pairs = "bonds"\nlengths_A = [1.5, 1.5]', "constraints: lengths", "(2,)"),
    ("pairs = [[0, 1], [1, 2]]\nlengths_A = [1.5, -1]", "constraints.lengths_A[1]", "= -1"),
    ("lengths_A = 1.5", "constraints", "pairs", "lengths_A"),
    ("fixed = [-1]", "constraints.fixed[0]", "= -1"),
    ("fixed = [4]", "fixed atoms", "atom 4"),
    ("fixed = [0, 1]\npairs = [[0, 1]]", "(atoms 0-1)"),
    ('pairs = [[0, 1]]\nsolver = "lincs"', "constraints.solver", '"lincs"'),
    ("pairs = [[0, 1]]\ntolerance = 0.0", "constraints.tolerance", "= 0.0"),
    ('solver = "shake"', "constraints", "tolerance and solver", "give pairs"),
    ("pairs = [[0, 1], [1, 2], [0, 2]]\nlengths_A = [1, 1, 3]", "constraint"),
]


@pytest.mark.parametrize(("section", "shown"), [(section, shown) for section, *shown in SECTIONS])
def test_wrong_constraints_of_a_scene_are_answered(section, shown, tmp_path):
    def simulation(text):
        return parse_scene(text, ring_in(tmp_path)).simulation()

    text = RIGID_RING.replace('pairs = "bonds"', section)
    assert_answered(lambda: simulation(text), ValueError, "scene.toml: ", *shown)
    without = RIGID_RING.replace("bonds = [[0, 1], [1, 2], [2, 3], [3, 0]]\n", "")
    assert_answered(lambda: simulation(without), ValueError, 'constraints.pairs = "bonds"', "structure.bonds")
