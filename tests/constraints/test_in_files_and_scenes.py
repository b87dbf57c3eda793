"""Constraints in H5MD files, on ASE's atoms and in scene files: what is read back is what was kept."""

from pathlib import Path

import ase.io
import h5py
import numpy as np
import pytest
from ase.calculators.lj import LennardJones
from ase.constraints import FixAtoms, FixBondLengths
from references import load, melt_scene
from rigid_scenes import PAIRS, RIGID_RING, SQUARE, VERLET, chain, described, dumbbells, ring_in
from scenes import BONDED
from wrong_calls import assert_answered

import minimd as md
from minimd.ase import ForcesFromCalculator
from minimd.core.files.h5md_reader import read_file
from minimd.core.files.h5md_writer import H5MDWriter
from minimd.scene import load_scene, parse_scene, resume_run, run_scene
from minimd.view.check import check_file

OTHERS = [  # lengths, fixed atoms, and what is said of the difference
    ({}, [0, 1, 5], "atom 5 is fixed in the simulation"),
    ({"pairs": PAIRS[1:-1]}, [0, 1], "atoms 62-63 is kept in the file"),
    ({"pairs": [*PAIRS[1:], (3, 4)]}, [0, 1], "atoms 3-4 is kept in the simulation"),
    ({"tolerance": 1e-9}, [0, 1], "1e-12 in the file and 1e-09"),
    ({"solver": "shake"}, [0, 1], "'auto' in the file and 'shake'"),
]
BONDS = [[0, 1], [1, 2], [2, 3], [3, 0]]
OF_BONDS = '[constraints]\npairs = "bonds"\n'
FILES_OWN = FixAtoms([1]), FixBondLengths([[0, 2], [2, 3]], tolerance=1e-10)
FILES_LENGTHS = [[0, 2], [2, 3]], [np.sqrt(4.5), 1.5]
WRONG = load("wrong_scenes.toml")["ring"]


def both_kinds(**options):
    return [md.DistanceConstraints(PAIRS[1:], **options), md.FixedAtoms([0, 1])]


def test_constraints_read_back_are_those_that_were_kept_to_the_last_bit(tmp_path):
    """A file holds what there is and no more; a system carries its constraints to the next simulation."""
    kinds = [(), md.FixedAtoms([3]), *(both_kinds(tolerance=1e-11, solver=one) for one in ("auto", "newton", "shake"))]
    for k, constraints in enumerate(kinds):
        sim, path = dumbbells(constraints), tmp_path / f"{k}.h5md"
        sim.run(5, every=5, trajectory=path)
        if k > 1:
            lengths, solver = sim.engine.constraint_set.bonds.lengths.tolist(), constraints[0].solver
            assert described(sim.constraints) == ([[0, 1]], [(PAIRS[1:].tolist(), lengths, 1e-11, solver)])
        again = md.Simulation(sim.system, [BONDED], VERLET)
        for constraints in (again.constraints, read_file(path).system.constraints):
            assert described(constraints) == described(sim.constraints)
        assert again.n_dof == sim.n_dof
        with h5py.File(path) as h5:
            assert ("minimd/constraints" in h5) == bool(sim.constraints)


def test_a_check_recomputes_the_lengths_of_a_run_that_went_on(tmp_path):
    first, path = dumbbells(both_kinds(), md.LangevinBAOAB(0.002, 1.0, 1.0, seed=4)), tmp_path / "a.h5md"
    first.run(23, every=5, trajectory=path)
    sim = md.Simulation.resume(path, [BONDED])
    sim.run(20, every=5, trajectory=path, append=True)
    contents, good = read_file(path), check_file(path)
    np.testing.assert_array_equal(contents.system.positions, sim.positions)
    assert sim.n_dof == first.n_dof == 3 * 62 - 31
    assert contents.record.constraint_violation.max() < 1e-13
    assert [one.passed for one in good.comparisons if one.name == "lengths"] == [True]
    with h5py.File(path, "r+") as h5:
        h5["particles/trajectory/position/value"][7, 9, 0] += 1e-5
    assert [one.name for one in check_file(path).comparisons if not one.passed] == ["lengths", "checksums"]


def test_other_constraints_are_refused_before_anything_is_written(tmp_path):
    """But the order of pairs, and lengths that are measured anew, are no difference."""
    path = tmp_path / "a.h5md"

    def append(constraints):
        contents = read_file(path)
        sim = md.Simulation(contents.system, [BONDED], VERLET, constraints)
        sim.step, sim.time = contents.step, contents.time
        H5MDWriter.append_to(path, sim.engine).close()

    dumbbells(both_kinds()).run(10, every=5, trajectory=path)
    before = path.read_bytes()
    for lengths, atoms, words in OTHERS:
        with pytest.raises(ValueError, match=words):
            append([md.DistanceConstraints(**{"pairs": PAIRS[1:]} | lengths), md.FixedAtoms(atoms)])
        assert path.read_bytes() == before
    append([md.FixedAtoms([0]), md.DistanceConstraints(PAIRS[:0:-1, ::-1]), md.FixedAtoms([1])])
    assert read_file(path).step == 10


def test_constraints_survive_the_way_to_ase_and_back():
    """Lengths that are not given are measured across the boundary; momenta that violate them are not touched."""
    positions, pairs = chain(12)
    lengths = 1.7 * np.linalg.norm(positions[pairs[:, 1]] - positions[pairs[:, 0]], axis=1)
    kept = [md.FixedAtoms([2, 0]), md.DistanceConstraints(pairs, lengths * (1.0 + 1e-9), tolerance=1e-10)]
    system = md.System(1.7 * positions, masses=12.0, units=md.units.ASE, species=["C"] * 12, constraints=kept)
    atoms = system.to_ase()
    assert [type(one) for one in atoms.constraints] == [FixAtoms, FixBondLengths]
    for same in (atoms, atoms.copy()):
        assert described(md.System.from_ase(same).constraints) == described(system.constraints)
    rigid, v = [md.DistanceConstraints([[0, 1]])], np.array([[1.0, 0, 0], [0, 0, 0]])
    places = {"positions": [[0.1, 1, 1], [8.9, 1, 1]], "cell": 9.0, "species": ["N", "N"], "units": md.units.ASE}
    atoms = md.System(**places, masses=14.0, velocities=v, constraints=rigid).to_ase()
    assert atoms.constraints[0].bondlengths == pytest.approx([0.2], abs=1e-14)
    np.testing.assert_array_equal(atoms.get_momenta(), 14.0 * v)


@pytest.mark.parametrize(("name", "tolerance"), [("a.traj", 1e-300), ("a.extxyz", 1e-12)])  # ASE would not converge
def test_trajectories_of_ase_hold_frames_as_they_are_with_their_constraints(name, tolerance, tmp_path):
    sim, looks = dumbbells(both_kinds(tolerance=tolerance)), []
    see = lambda run: looks.append((run.positions.copy(), run.velocities.copy()))  # noqa: E731
    sim.run(20, every=10, trajectory=tmp_path / name, observers=[see])
    for frame, (positions, velocities) in zip(ase.io.read(tmp_path / name, ":"), looks, strict=True):
        assert np.abs(frame.positions - positions).max() < 1e-8  # decimals of the format
        assert np.abs(frame.get_velocities() - velocities).max() < 1e-8
        read = md.System.from_ase(frame).constraints
        assert described(read)[0] == [[0, 1]]
        assert name == "a.extxyz" or np.abs(read[1].lengths - 0.5).max() < 1e-12  # ASE measures them anew


def test_a_foreign_calculator_is_asked_for_forces_without_constraints():
    places, fixed = [[0.0, 0, 0], [1.0, 0, 0], [0, 1.1, 0]], [md.FixedAtoms([0])]
    system = md.System(places, masses=1.0, units=md.units.ASE, constraints=fixed)
    forces = md.evaluate(system, ForcesFromCalculator(LennardJones(sigma=1.0, epsilon=1.0, rc=3.0))).forces
    assert np.abs(forces.sum(axis=0)).max() < 1e-12 < 1.0 < np.abs(forces[0]).max()  # rounding


def constraints_of_scene(folder, section, *constraints, suffix=".traj"):
    text = RIGID_RING.replace("ring.xyz", "ring" + suffix).replace(OF_BONDS, section)
    return described(parse_scene(text, ring_in(folder, *constraints)).system().constraints)


def test_every_key_of_the_section_arrives(tmp_path):
    for section, fixed, *kept in [
        ("pairs = [[0, 2]]\nlengths_A = 2.0", [], ([[0, 2]], [2.0], 1e-12, "auto")),
        ("pairs = [[0, 1], [2, 3]]\nlengths_A = [1.4, 1.5]", [], ([[0, 1], [2, 3]], [1.4, 1.5], 1e-12, "auto")),
        ('pairs = "bonds"\nlengths_A = 1\ntolerance = 1e-9\nsolver = "shake"', [], (BONDS, [1.0] * 4, 1e-9, "shake")),
        ("fixed = [3, 1]", [[1, 3]]),
        ("", []),
    ]:
        assert constraints_of_scene(tmp_path, f"[constraints]\n{section}\n", suffix=".xyz") == (fixed, kept), section
    reduced = parse_scene(melt_scene(2, 10, "[constraints]\npairs = [[0, 1]]\nlengths = 1.3\n"), Path("a.toml"))
    assert described(reduced.system().constraints) == ([], [([[0, 1]], [1.3], 1e-12, "auto")])


@pytest.mark.filterwarnings("error::UserWarning")  # the lattice has the lengths already
def test_the_scene_of_dumbbells_runs_as_its_comments_say():
    sim = load_scene(Path(__file__).parents[2] / "examples" / "dumbbells.toml").simulation()
    assert sim.run(50, every=10).constraint_violation.max() < 2e-14  # rounding
    assert sim.n_dof == 3 * 54 - 3 - 27 == 132  # as the file has it


def test_constraints_of_the_structure_file_hold_unless_the_section_says_otherwise(tmp_path):
    for section, fixed, lengths in (("", True, True), ("fixed = []\n", False, True), ("pairs = []\n", True, False)):
        section, expected = section and f"[constraints]\n{section}", [(*FILES_LENGTHS, 1e-10, "auto")] * lengths
        assert constraints_of_scene(tmp_path, section, *FILES_OWN) == ([[1]] * fixed, expected), section
    path = ring_in(tmp_path, FixBondLengths([[0, 3]]))  # 1.5 Å apart, and 0.5 Å in the cell of the scene
    text = RIGID_RING.replace("ring.xyz", "ring.traj").replace(OF_BONDS, "")
    (constraint,) = parse_scene(text.replace("bonds = ", "cell_A = [0, 2, 0]\nbonds = "), path).system().constraints
    assert constraint.lengths == pytest.approx([0.5], abs=1e-15)
    section = '[constraints]\nsolver = "newton"\ntolerance = 1e-8\n'  # of the lengths in the structure file
    assert constraints_of_scene(tmp_path, section, FILES_OWN[1]) == ([], [(*FILES_LENGTHS, 1e-8, "newton")])


@pytest.mark.slow
def test_a_scene_makes_its_bonds_rigid_and_resumed_it_is_the_uninterrupted_one(here):
    text = RIGID_RING.replace(OF_BONDS, OF_BONDS + "fixed = [2]\n")
    scene, quiet = parse_scene(text, ring_in(here)), {"tell": lambda _: None}
    whole = run_scene(scene, progress=False, trajectory=Path("whole.h5md"), **quiet)
    assert described(whole.constraints) == ([[2]], [(BONDS, [1.5] * 4, 1e-12, "auto")])
    assert whole.n_dof == 12 - 3 - 4
    assert whole.record.constraint_violation.max() < 1e-14
    assert np.abs(whole.positions - SQUARE).max() > 1e-3
    run_scene(scene, progress=False, trajectory=Path("parts.h5md"), steps=10, **quiet)
    texts = (text.replace('pairs = "bonds"\nfixed = [2]\n', section) for section in ("pairs = [[0, 1]]\n", ""))
    other, silent = (parse_scene(one, here / "scene.toml") for one in texts)
    with pytest.raises(ValueError, match="atoms 0-3 is kept in the file alone"):
        resume_run("parts.h5md", 10, scene=other, **quiet)
    (here / "ring.xyz").unlink()  # not needed any more
    sim = resume_run("parts.h5md", 10, scene=silent, **quiet)  # says nothing: those of the file
    assert (sim.step, described(sim.constraints)) == (20, described(whole.constraints))
    apart = sim.positions - whole.positions, sim.velocities - whole.velocities
    assert np.abs(apart).max() < 1e-13  # rounding


@pytest.mark.parametrize(("section", "shown"), [(section, shown) for section, *shown in WRONG])
def test_wrong_constraints_of_a_scene_are_answered(section, shown, tmp_path):
    for old, new, *words in (
        ('pairs = "bonds"', section, *shown),
        (f"bonds = {BONDS}\n", "", 'constraints.pairs = "bonds"', "structure.bonds"),
    ):
        text = RIGID_RING.replace(old, new)
        wrong = lambda text=text: parse_scene(text, ring_in(tmp_path)).simulation()  # noqa: E731
        assert_answered(wrong, ValueError, "scene.toml: ", *words)
