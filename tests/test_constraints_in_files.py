"""Constraints outside scripts: in H5MD files, in scene files, on ASE's atoms; what is read back is what was kept."""

import warnings
from pathlib import Path

import ase.io
import h5py
import numpy as np
import pytest
from ase import Atoms
from ase.constraints import FixAtoms, FixBondLengths
from rigid_scenes import chain

import minimd as md
from minimd.analysis.check import check_file
from minimd.files.h5md_reader import read_file
from minimd.files.h5md_writer import H5MDWriter
from minimd.scene import load_scene, parse_scene, resume_run, run_scene
from minimd.structure.lattice import crystal

LENGTH = 0.5
CUTOFF = 2.2
DUMBBELLS = Path(__file__).parent.parent / "examples" / "dumbbells.toml"


def dumbbells(n_cells=2, density=0.9):
    """Rigid diatomic molecules in a periodic box."""
    centers, edges = crystal("fcc", [n_cells] * 3, (8.0 / density) ** (1 / 3))
    arms = np.random.default_rng(1).normal(size=centers.shape)
    arms *= 0.5 * LENGTH / np.linalg.norm(arms, axis=1)[:, None]
    positions = np.stack([centers - arms, centers + arms], axis=1).reshape(-1, 3)
    pairs = np.arange(len(positions)).reshape(-1, 2)
    return md.System(positions, cell=edges, bonds=pairs), pairs


def law():
    return md.LennardJones(1.0, 1.0, CUTOFF, truncation="switched", bonded_scale=(0, 1, 1))


def simulation(constraints, method=None):
    sim = md.Simulation(dumbbells()[0], law(), method or md.VelocityVerlet(0.002), constraints)
    sim.set_temperature(1.0, seed=2)
    return sim


def both_kinds(**options):
    return [md.DistanceConstraints(dumbbells()[1][1:], **options), md.FixedAtoms([0, 1])]


def resumed(path, constraints=None):
    """A simulation at the restart of a file, with other constraints if they are given."""
    if constraints is None:
        return md.Simulation.resume(path, law())
    contents = read_file(path)
    sim = md.Simulation(contents.system, law(), md.VelocityVerlet(0.002), constraints)
    sim.step, sim.time, sim.reservoir_energy = contents.step, contents.time, contents.reservoir_energy
    return sim


def described(constraints):
    """Constraints as plain values, to be compared."""
    fixed = [one.atoms.tolist() for one in constraints if isinstance(one, md.FixedAtoms)]
    lengths = [
        (one.pairs.tolist(), one.lengths.tolist(), one.tolerance, one.solver) for one in constraints if isinstance(one, md.DistanceConstraints)
    ]
    return fixed, lengths


# H5MD


@pytest.mark.parametrize("solver", ["auto", "newton", "shake"])
def test_constraints_read_back_are_those_that_were_kept_to_the_last_bit(solver, tmp_path):
    sim = simulation(both_kinds(tolerance=1e-11, solver=solver))
    sim.run(5, every=5, trajectory=tmp_path / "a.h5md")
    fixed, ((pairs, lengths, *rest),) = described(read_file(tmp_path / "a.h5md").system.constraints)
    assert fixed == [[0, 1]]
    assert pairs == dumbbells()[1][1:].tolist()
    assert lengths == sim.engine.constraint_set.bonds.lengths.tolist()
    assert rest == [1e-11, solver]


@pytest.mark.parametrize("constraints", [(), md.FixedAtoms([3]), md.DistanceConstraints(dumbbells()[1])], ids=["nothing", "fixed atoms", "lengths"])
def test_a_file_holds_what_there_is_and_no_more(constraints, tmp_path):
    sim = simulation(constraints)
    sim.run(1, trajectory=tmp_path / "a.h5md")
    assert described(read_file(tmp_path / "a.h5md").system.constraints) == described(sim.constraints)
    with h5py.File(tmp_path / "a.h5md") as h5:
        assert ("minimd/constraints" in h5) == bool(sim.constraints)


@pytest.mark.parametrize("n_steps", [20, 23])
@pytest.mark.parametrize("method", [md.VelocityVerlet(0.002), md.LangevinBAOAB(0.002, 1.0, 1.0, seed=4)], ids=["Verlet", "Langevin"])
def test_a_resumed_run_is_the_uninterrupted_one(method, n_steps, tmp_path):
    whole = simulation(both_kinds(), method)
    whole.run(n_steps + 20, every=5)
    simulation(both_kinds(), method).run(n_steps, every=5, trajectory=tmp_path / "a.h5md")
    sim = resumed(tmp_path / "a.h5md")
    sim.run(20, every=5, trajectory=tmp_path / "a.h5md", append=True)
    np.testing.assert_array_equal(sim.positions, whole.positions)
    np.testing.assert_array_equal(sim.velocities, whole.velocities)
    assert sim.n_dof == whole.n_dof == 3 * 62 - 31
    assert sim.engine.constraint_set.bonds.lengths.tolist() == whole.engine.constraint_set.bonds.lengths.tolist()
    contents = read_file(tmp_path / "a.h5md")
    np.testing.assert_array_equal(contents.system.positions, sim.positions)
    assert contents.record.constraint_violation.max() < 1e-13


PAIRS = dumbbells()[1]
RIGID = md.DistanceConstraints(PAIRS[1:], LENGTH)
OTHERS = {
    "nothing": ((), "atom 0 is fixed in the file alone"),
    "an atom less": ([RIGID, md.FixedAtoms([0])], "atom 1 is fixed in the file alone"),
    "an atom more": ([RIGID, md.FixedAtoms([0, 1, 5])], "atom 5 is fixed in the simulation alone"),
    "no lengths": (md.FixedAtoms([0, 1]), "the file alone keeps lengths, 31 of them"),
    "a pair less": ([md.DistanceConstraints(PAIRS[1:-1]), md.FixedAtoms([0, 1])], "the length of atoms 62-63 is kept in the file alone"),
    "a pair more": ([md.DistanceConstraints([*PAIRS[1:], (3, 4)]), md.FixedAtoms([0, 1])], "atoms 3-4 is kept in the simulation alone"),
    "another length": (
        [md.DistanceConstraints(PAIRS[1:], [LENGTH, 0.6, *[LENGTH] * 29]), md.FixedAtoms([0, 1])],
        r"the length of atoms 4-5 is 0\.5\d* in the file and 0\.5999\d* in the simulation",
    ),
    "another tolerance": (
        [md.DistanceConstraints(PAIRS[1:], tolerance=1e-9), md.FixedAtoms([0, 1])],
        "the tolerance of lengths is 1e-12 in the file and 1e-09",
    ),
    "another solver": (
        [md.DistanceConstraints(PAIRS[1:], solver="shake"), md.FixedAtoms([0, 1])],
        "the solver of lengths is 'auto' in the file and 'shake'",
    ),
}


@pytest.mark.parametrize("other", OTHERS)
def test_other_constraints_are_refused_before_anything_is_written(other, tmp_path):
    path = tmp_path / "a.h5md"
    simulation([RIGID, md.FixedAtoms([0, 1])]).run(10, every=5, trajectory=path)
    before = path.read_bytes()
    constraints, words = OTHERS[other]
    sim = resumed(path, constraints)
    with pytest.raises(ValueError, match=f"holds a run with other constraints: .*{words}.*write to a new file"):
        H5MDWriter.append_to(path, sim.engine)
    assert path.read_bytes() == before


def test_constraints_behind_a_run_without_any_are_refused(tmp_path):
    simulation(()).run(10, every=5, trajectory=tmp_path / "a.h5md")
    with pytest.raises(ValueError, match="the simulation alone keeps lengths, 31 of them"):
        H5MDWriter.append_to(tmp_path / "a.h5md", resumed(tmp_path / "a.h5md", RIGID).engine)


def test_the_order_of_pairs_and_lengths_measured_anew_are_no_difference(tmp_path):
    path = tmp_path / "a.h5md"
    simulation([RIGID, md.FixedAtoms([0, 1])]).run(10, every=5, trajectory=path)
    same = resumed(path, [md.FixedAtoms([0]), md.DistanceConstraints(PAIRS[:0:-1, ::-1]), md.FixedAtoms([1])])
    H5MDWriter.append_to(path, same.engine).close()
    assert read_file(path).step == 10


def test_check_recomputes_the_lengths_of_a_file(tmp_path):
    simulation(both_kinds()).run(200, every=5, trajectory=tmp_path / "a.h5md")
    good = check_file(tmp_path / "a.h5md")
    assert [one.passed for one in good.comparisons if one.name == "lengths"] == [True]
    assert "lengths        kept to" in str(good)
    with h5py.File(tmp_path / "a.h5md", "r+") as h5:
        h5["particles/trajectory/position/value"][7, 9, 0] += 1e-5
    bad = check_file(tmp_path / "a.h5md")
    assert [one.name for one in bad.comparisons if not one.passed] == ["lengths", "checksums"]
    assert not bad.passed


# ASE


def test_constraints_survive_the_way_to_ase_and_back():
    positions, pairs = chain(12)
    lengths = 1.7 * np.linalg.norm(positions[pairs[:, 1]] - positions[pairs[:, 0]], axis=1)
    kept = md.DistanceConstraints(pairs, lengths * (1.0 + 1e-9), tolerance=1e-10)
    system = md.System(1.7 * positions, masses=12.0, units=md.units.ASE, species=["C"] * 12, constraints=[md.FixedAtoms([2, 0]), kept])
    atoms = system.to_ase()
    assert [type(one) for one in atoms.constraints] == [FixAtoms, FixBondLengths]
    assert described(md.System.from_ase(atoms).constraints) == described(system.constraints)
    assert described(md.System.from_ase(atoms.copy()).constraints) == described(system.constraints)


def test_lengths_that_are_not_given_go_to_ase_as_they_are_across_the_boundary():
    system = md.System(
        [[0.1, 1, 1], [8.9, 1, 1]], masses=14.0, cell=9.0, units=md.units.ASE, species=["N", "N"], constraints=[md.DistanceConstraints([[0, 1]])]
    )
    (constraint,) = system.to_ase().constraints
    assert constraint.bondlengths == pytest.approx([0.2], abs=1e-14)


def test_velocities_on_their_way_to_ase_are_not_touched():
    """The momenta of a state that violates a constraint stay as they are."""
    velocities = np.array([[1.0, 0, 0], [0, 0, 0]])
    rigid = md.DistanceConstraints([[0, 1]])
    atoms = md.System([[0, 0, 0], [1, 0, 0]], masses=2.0, velocities=velocities, units=md.units.ASE, constraints=[rigid]).to_ase()
    np.testing.assert_array_equal(atoms.get_momenta(), 2.0 * velocities)


@pytest.mark.parametrize("name", ["a.traj", "a.extxyz"])
def test_trajectories_of_ase_hold_frames_as_they_are_with_their_constraints(name, tmp_path):
    sim = simulation(both_kinds())
    looks = []
    sim.run(20, every=10, trajectory=tmp_path / name, observers=[lambda s: looks.append((s.positions.copy(), s.velocities.copy()))])
    for frame, (positions, velocities) in zip(ase.io.read(tmp_path / name, ":"), looks, strict=True):
        assert np.abs(frame.positions - positions).max() < 1e-8  # decimals of the format
        assert np.abs(frame.get_velocities() - velocities).max() < 1e-8
        read = md.System.from_ase(frame).constraints
        assert described(read)[0] == [[0, 1]]
        if name == "a.traj":
            assert np.abs(read[1].lengths - LENGTH).max() < 1e-12  # ASE measures them anew


def test_frames_for_ase_do_not_pass_through_its_solver(tmp_path):
    """It would not converge to this tolerance."""
    sim = simulation(md.DistanceConstraints(PAIRS, tolerance=1e-300))
    sim.run(4, every=2, trajectory=tmp_path / "a.traj")
    assert len(ase.io.read(tmp_path / "a.traj", ":")) == 3


def test_a_foreign_calculator_is_asked_for_forces_without_constraints():
    from ase.calculators.lj import LennardJones

    from minimd.ase import ForcesFromCalculator

    system = md.System([[0.0, 0, 0], [1.0, 0, 0], [0, 1.1, 0]], masses=1.0, units=md.units.ASE, constraints=[md.FixedAtoms([0])])
    found = md.evaluate(system, ForcesFromCalculator(LennardJones(sigma=1.0, epsilon=1.0, rc=3.0)))
    assert np.abs(found.forces.sum(axis=0)).max() < 1e-12  # rounding
    assert np.abs(found.forces[0]).max() > 1.0


def test_state_of_a_simulation_carries_the_constraints_that_it_keeps():
    sim = simulation(both_kinds())
    again = md.Simulation(sim.system, law(), md.VelocityVerlet(0.002))
    assert described(again.constraints) == described(sim.constraints) == described(sim.system.constraints)
    assert again.n_dof == sim.n_dof


# Scenes

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
        ('pairs = "bonds"\nlengths_A = 1\ntolerance = 1e-9\nsolver = "shake"', ([], [(BONDS, [1.0] * 4, 1e-9, "shake")])),
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
    assert described(parse_scene(text, Path("a.toml")).simulation().constraints) == ([], [([[0, 1], [2, 3]], [1.3, 1.3], 1e-12, "auto")])


FILES_OWN = ([[1]], [([[0, 2], [2, 3]], [np.sqrt(4.5), 1.5], 1e-10, "auto")])  # what the structure file of the next test holds


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
    assert constraints_of_scene(tmp_path, section, own) == ([], [([[0, 2], [2, 3]], [np.sqrt(4.5), 1.5], 1e-8, "newton")])


def test_lengths_of_the_structure_file_are_measured_in_the_cell_of_the_scene(tmp_path):
    """Atoms 0 and 3 are 1.5 Å apart, and 0.5 Å in a cell of 2 Å."""
    path = ring_in(tmp_path, FixBondLengths([[0, 3]]))
    text = RING.replace("ring.xyz", "ring.traj").replace('[constraints]\npairs = "bonds"\n', "").replace("bonds = ", "cell_A = [0, 2, 0]\nbonds = ")
    (constraint,) = parse_scene(text, path).system().constraints
    assert constraint.lengths == pytest.approx([0.5], abs=1e-15)


@pytest.mark.parametrize(
    ("section", "words"),
    [
        ("pair = [[0, 1]]", ["constraints has no key 'pair'", "did you mean 'pairs'?", "pairs, lengths_A, fixed, tolerance, solver"]),
        ("pairs = [[0, 1]]\nlengths = 1.5", ["constraints has no key 'lengths'", "did you mean 'lengths_A'?"]),
        ("pairs = 3", ["constraints.pairs must be a list or 'bonds'", "= 3"]),
        ('pairs = "bond"', ["constraints.pairs must be a list or 'bonds'", '"bond"']),
        ("pairs = [[0, 1, 2]]", ["constraints.pairs[0] must have at most 2 entries", "[0, 1, 2]"]),
        ("pairs = [[0, 1], [1, 0]]", ["constraints: pairs must name each pair once", "pairs[0] = [0, 1] comes 2 times"]),
        ("pairs = [[0, 0]]", ["constraints: pairs must name different atoms", "[0, 0]"]),
        ("pairs = [[0, 9]]", ["constraints must name atoms 0 to 3", "atom 9"]),
        (
            "pairs = [[0, 1], [1, 2]]\nlengths_A = [1.5]",
            ["constraints must have one number as lengths_A, or one for each of its 2 pairs", "it has 1"],
        ),
        ('pairs = "bonds"\nlengths_A = [1.5, 1.5]', ["constraints: lengths must be one number or 4", "(2,)"]),
        ("pairs = [[0, 1]]\nlengths_A = 0", ["constraints.lengths_A must be greater than 0", "= 0"]),
        ("pairs = [[0, 1], [1, 2]]\nlengths_A = [1.5, -1]", ["constraints.lengths_A[1] must be greater than 0", "= -1"]),
        ("lengths_A = 1.5", ["constraints must have pairs beside lengths_A"]),
        ("fixed = [-1]", ["constraints.fixed[0] must be greater than or equal to 0", "= -1"]),
        ("fixed = [4]", ["fixed atoms must be among 0 to 3", "atom 4"]),
        ("fixed = 1", ["constraints.fixed must be a list", "= 1"]),
        ("fixed = [0, 1]\npairs = [[0, 1]]", ["joins two atoms that are held fixed"]),
        ('pairs = [[0, 1]]\nsolver = "lincs"', ["constraints.solver must be 'auto', 'newton' or 'shake'", '"lincs"']),
        ("pairs = [[0, 1]]\ntolerance = 0.0", ["constraints.tolerance must be greater than 0", "= 0.0"]),
        ('solver = "shake"', ["constraints: tolerance and solver apply to lengths, of which there are none; give pairs"]),
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
    with pytest.raises(ValueError, match=r'constraints\.pairs = "bonds" needs structure\.bonds; give them there, or list the pairs'):
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
