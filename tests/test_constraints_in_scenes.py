"""Constraints in scene files: what a section means, and what a resumed scene keeps."""

import warnings
from pathlib import Path

import ase.io
import numpy as np
import pytest
from ase import Atoms
from ase.constraints import FixAtoms, FixBondLengths
from rigid_scenes import described

from minimd.scene import load_scene, parse_scene, resume_run, run_scene

DUMBBELLS = Path(__file__).parent.parent / "examples" / "dumbbells.toml"
RING = """
[structure]
file = "ring.xyz"
bonds = [[0, 1], [1, 2], [2, 3], [3, 0]]
[[potential]]
type = "harmonic-angle"
k_eV_rad2 = 3.0
angle_degree = 80.0
triples = [[0, 1, 2], [2, 3, 0]]
[constraints]
pairs = "bonds"
[dynamics]
timestep_fs = 1.0
temperature_K = 300.0
steps = 20
[output]
every = 10
"""
SQUARE = np.array([[0.0, 0, 0], [1.5, 0, 0], [1.5, 1.5, 0], [0, 1.5, 0]])
BONDS = [[0, 1], [1, 2], [2, 3], [3, 0]]


def ring_in(folder, *constraints, cell=None):
    """A scene whose structure is a square of four carbon atoms, in a file that keeps constraints."""
    atoms = Atoms("C4", SQUARE, cell=cell, pbc=cell is not None)
    atoms.set_constraint(list(constraints))
    ase.io.write(folder / "ring.xyz", atoms, format="extxyz")
    ase.io.write(folder / "ring.traj", atoms)
    return folder / "scene.toml"


def constraints_of_scene(folder, section, *constraints, suffix=".traj"):
    text = RING.replace("ring.xyz", "ring" + suffix).replace('[constraints]\npairs = "bonds"\n', section)
    return described(parse_scene(text, ring_in(folder, *constraints)).system().constraints)


def test_a_scene_makes_its_bonds_rigid(tmp_path):
    sim = parse_scene(RING, ring_in(tmp_path)).simulation()
    assert described(sim.constraints) == ([], [(BONDS, [1.5] * 4, 1e-12, "auto")])
    assert sim.n_dof == 12 - 3 - 4
    sim.run(20, every=10)
    assert sim.record.constraint_violation.max() < 1e-14
    assert np.abs(sim.positions - SQUARE).max() > 1e-3


@pytest.mark.parametrize(
    ("section", "expected"),
    [
        ("pairs = [[0, 2]]\nlengths_A = 2.0", ([], [([[0, 2]], [2.0], 1e-12, "auto")])),
        ("pairs = [[0, 1], [2, 3]]\nlengths_A = [1.4, 1.5]", ([], [([[0, 1], [2, 3]], [1.4, 1.5], 1e-12, "auto")])),
        (
            'pairs = "bonds"\nlengths_A = 1\ntolerance = 1e-9\nsolver = "shake"',
            ([], [(BONDS, [1.0] * 4, 1e-9, "shake")]),
        ),
        ("fixed = [3, 1]", ([[1, 3]], [])),
        ("fixed = [3]\npairs = [[0, 1]]\nlengths_A = 1.5", ([[3]], [([[0, 1]], [1.5], 1e-12, "auto")])),
        ("", ([], [])),
    ],
)
def test_every_key_of_the_section_arrives(section, expected, tmp_path):
    assert constraints_of_scene(tmp_path, f"[constraints]\n{section}\n", suffix=".xyz") == expected


def test_lengths_of_a_reduced_scene_are_plain_numbers():
    text = """
units = "LJ"
[structure]
lattice = "bcc"
repeat = [2, 2, 2]
density = 0.4
bonds = [[0, 1], [2, 3]]
[constraints]
pairs = "bonds"
lengths = 1.3
[[potential]]
type = "lennard-jones"
epsilon = 1.0
sigma = 1.0
cutoff = 2.5
[dynamics]
timestep = 0.002
steps = 10
"""
    assert described(parse_scene(text, Path("a.toml")).simulation().constraints) == (
        [],
        [([[0, 1], [2, 3]], [1.3, 1.3], 1e-12, "auto")],
    )


FILES_OWN = (
    [[1]],
    [([[0, 2], [2, 3]], [np.sqrt(4.5), 1.5], 1e-10, "auto")],
)  # what the structure file of the next test holds


@pytest.mark.parametrize(
    ("section", "fixed", "lengths"),
    [
        ("", True, True),
        ("[constraints]\n", True, True),
        ("[constraints]\nfixed = []\n", False, True),
        ("[constraints]\npairs = []\n", True, False),
        ("[constraints]\npairs = []\nfixed = []\n", False, False),
    ],
)
def test_constraints_of_the_structure_file_hold_unless_the_section_says_otherwise(section, fixed, lengths, tmp_path):
    own = FixAtoms([1]), FixBondLengths([[0, 2], [2, 3]], tolerance=1e-10)
    expected = FILES_OWN[0] if fixed else [], FILES_OWN[1] if lengths else []
    assert constraints_of_scene(tmp_path, section, *own) == expected


def test_solver_and_tolerance_of_a_scene_are_those_of_the_lengths_in_the_structure_file(tmp_path):
    own = FixBondLengths([[0, 2], [2, 3]])
    section = '[constraints]\nsolver = "newton"\ntolerance = 1e-8\n'
    assert constraints_of_scene(tmp_path, section, own) == (
        [],
        [([[0, 2], [2, 3]], [np.sqrt(4.5), 1.5], 1e-8, "newton")],
    )


def test_lengths_of_the_structure_file_are_measured_in_the_cell_of_the_scene(tmp_path):
    """Atoms 0 and 3 are 1.5 Å apart, and 0.5 Å in a cell of 2 Å."""
    path = ring_in(tmp_path, FixBondLengths([[0, 3]]))
    text = (
        RING.replace("ring.xyz", "ring.traj")
        .replace('[constraints]\npairs = "bonds"\n', "")
        .replace("bonds = ", "cell_A = [0, 2, 0]\nbonds = ")
    )
    (constraint,) = parse_scene(text, path).system().constraints
    assert constraint.lengths == pytest.approx([0.5], abs=1e-15)


@pytest.mark.parametrize(
    ("section", "words"),
    [
        (
            "pair = [[0, 1]]",
            ["constraints has no key 'pair'", "did you mean 'pairs'?", "pairs, lengths_A, fixed, tolerance, solver"],
        ),
        ("pairs = [[0, 1]]\nlengths = 1.5", ["constraints has no key 'lengths'", "did you mean 'lengths_A'?"]),
        ("pairs = 3", ["constraints.pairs must be a list or 'bonds'", "= 3"]),
        ('pairs = "bond"', ["constraints.pairs must be a list or 'bonds'", '"bond"']),
        ("pairs = [[0, 1, 2]]", ["constraints.pairs[0] must have at most 2 entries", "[0, 1, 2]"]),
        (
            "pairs = [[0, 1], [1, 0]]",
            ["constraints: pairs must name each pair once", "pairs[0] = [0, 1] is given 2 times"],
        ),
        ("pairs = [[0, 0]]", ["constraints: pairs must name different atoms", "[0, 0]"]),
        ("pairs = [[0, 9]]", ["constraints must name atoms 0 to 3", "atom 9"]),
        (
            "pairs = [[0, 1], [1, 2]]\nlengths_A = [1.5]",
            ["constraints must have one number as lengths_A, or one for each of its 2 pairs", "it has 1"],
        ),
        ('pairs = "bonds"\nlengths_A = [1.5, 1.5]', ["constraints: lengths must be one number or 4", "(2,)"]),
        ("pairs = [[0, 1]]\nlengths_A = 0", ["constraints.lengths_A must be greater than 0", "= 0"]),
        (
            "pairs = [[0, 1], [1, 2]]\nlengths_A = [1.5, -1]",
            ["constraints.lengths_A[1] must be greater than 0", "= -1"],
        ),
        ("lengths_A = 1.5", ["constraints must have pairs together with lengths_A"]),
        ("fixed = [-1]", ["constraints.fixed[0] must be greater than or equal to 0", "= -1"]),
        ("fixed = [4]", ["fixed atoms must be among 0 to 3", "atom 4"]),
        ("fixed = 1", ["constraints.fixed must be a list", "= 1"]),
        ("fixed = [0, 1]\npairs = [[0, 1]]", ["connects two atoms that are held fixed"]),
        ('pairs = [[0, 1]]\nsolver = "lincs"', ["constraints.solver must be 'auto', 'newton' or 'shake'", '"lincs"']),
        ("pairs = [[0, 1]]\ntolerance = 0.0", ["constraints.tolerance must be greater than 0", "= 0.0"]),
        (
            'solver = "shake"',
            ["constraints: tolerance and solver are for lengths, and no lengths are held; give pairs"],
        ),
        ("pairs = [[0, 1], [1, 2], [0, 2]]\nlengths_A = [1, 1, 3]", ["contradict each other"]),
    ],
)
def test_wrong_constraints_of_a_scene_are_answered_with_one_sentence(section, words, tmp_path):
    text = RING.replace('pairs = "bonds"', section)
    with pytest.raises(ValueError, match=r"scene\.toml: ") as caught:
        parse_scene(text, ring_in(tmp_path)).simulation()
    assert "\n" not in str(caught.value)
    assert [word for word in words if word not in str(caught.value)] == [], caught.value


def test_rigid_bonds_without_bonds_are_refused(tmp_path):
    with pytest.raises(
        ValueError, match=r'constraints\.pairs = "bonds" needs structure\.bonds; give them there, or list the pairs'
    ):
        parse_scene(RING.replace("bonds = [[0, 1], [1, 2], [2, 3], [3, 0]]\n", ""), ring_in(tmp_path))


def run_in(folder, text, monkeypatch, **options):
    monkeypatch.chdir(folder)
    told = []
    return run_scene(parse_scene(text, folder / "scene.toml"), tell=told.append, progress=False, **options), told


def test_a_resumed_scene_is_the_uninterrupted_one(tmp_path, monkeypatch):
    ring_in(tmp_path)
    text = RING.replace('pairs = "bonds"', 'pairs = "bonds"\nfixed = [2]')
    whole, told = run_in(tmp_path, text, monkeypatch, trajectory=Path("whole.h5md"))
    assert "constraints    lengths kept: 4, atoms fixed: 1; 5 degrees of freedom" in told
    run_in(tmp_path, text, monkeypatch, steps=10, trajectory=Path("parts.h5md"))
    (tmp_path / "ring.xyz").unlink()  # not needed any more
    sim = resume_run("parts.h5md", tell=lambda _: None)
    assert sim.step == 20
    assert described(sim.constraints) == described(whole.constraints)
    assert np.abs(sim.positions - whole.positions).max() < 1e-13  # rounding
    assert np.abs(sim.velocities - whole.velocities).max() < 1e-13  # rounding


def test_a_run_is_not_resumed_with_the_constraints_of_another_scene(tmp_path, monkeypatch):
    path = ring_in(tmp_path)
    run_in(tmp_path, RING, monkeypatch, steps=10, trajectory=Path("a.h5md"))
    before = Path("a.h5md").read_bytes()
    for section, words in (
        ("pairs = [[0, 1]]", "atoms 0-3 is kept in the file alone"),
        ('pairs = "bonds"\nlengths_A = 1.4', "atoms 0-1 is 1.5 in the"),
    ):
        other = parse_scene(RING.replace('pairs = "bonds"', section), path)
        with pytest.raises(ValueError, match=words):
            resume_run("a.h5md", 10, scene=other, tell=lambda _: None)
    assert Path("a.h5md").read_bytes() == before
    silent = parse_scene(RING.replace('[constraints]\npairs = "bonds"\n', ""), path)  # says nothing: those of the file
    assert resume_run("a.h5md", 10, scene=silent, tell=lambda _: None).n_dof == 5


def test_the_scene_of_dumbbells_runs_as_its_comments_say():
    sim = load_scene(DUMBBELLS).simulation()
    assert sim.n_dof == 3 * 54 - 3 - 27
    assert sim.n_dof == 132  # as the file has it
    with warnings.catch_warnings():
        warnings.simplefilter("error")  # the lattice has the lengths already
        record = sim.run(200, every=10)
    assert record.constraint_violation.max() < 2e-14  # rounding
    assert record.temperature[0] == pytest.approx(1.5, rel=1e-12)
