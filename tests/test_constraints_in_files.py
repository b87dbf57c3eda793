"""Constraints in H5MD files and on ASE's atoms: what is read back is what was kept."""

import ase.io
import h5py
import numpy as np
import pytest
from ase.constraints import FixAtoms, FixBondLengths
from rigid_scenes import chain, described

import minimd as md
from minimd.analysis.check import check_file
from minimd.files.h5md_reader import read_file
from minimd.files.h5md_writer import H5MDWriter
from minimd.structure.lattice import crystal

LENGTH = 0.5
CUTOFF = 2.2


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


@pytest.mark.parametrize(
    "constraints",
    [(), md.FixedAtoms([3]), md.DistanceConstraints(dumbbells()[1])],
    ids=["nothing", "fixed atoms", "lengths"],
)
def test_a_file_holds_what_there_is_and_no_more(constraints, tmp_path):
    sim = simulation(constraints)
    sim.run(1, trajectory=tmp_path / "a.h5md")
    assert described(read_file(tmp_path / "a.h5md").system.constraints) == described(sim.constraints)
    with h5py.File(tmp_path / "a.h5md") as h5:
        assert ("minimd/constraints" in h5) == bool(sim.constraints)


@pytest.mark.parametrize("n_steps", [20, 23])
@pytest.mark.parametrize(
    "method", [md.VelocityVerlet(0.002), md.LangevinBAOAB(0.002, 1.0, 1.0, seed=4)], ids=["Verlet", "Langevin"]
)
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
    "a pair less": (
        [md.DistanceConstraints(PAIRS[1:-1]), md.FixedAtoms([0, 1])],
        "the length of atoms 62-63 is kept in the file alone",
    ),
    "a pair more": (
        [md.DistanceConstraints([*PAIRS[1:], (3, 4)]), md.FixedAtoms([0, 1])],
        "atoms 3-4 is kept in the simulation alone",
    ),
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
    system = md.System(
        1.7 * positions, masses=12.0, units=md.units.ASE, species=["C"] * 12, constraints=[md.FixedAtoms([2, 0]), kept]
    )
    atoms = system.to_ase()
    assert [type(one) for one in atoms.constraints] == [FixAtoms, FixBondLengths]
    assert described(md.System.from_ase(atoms).constraints) == described(system.constraints)
    assert described(md.System.from_ase(atoms.copy()).constraints) == described(system.constraints)


def test_lengths_that_are_not_given_go_to_ase_as_they_are_across_the_boundary():
    system = md.System(
        [[0.1, 1, 1], [8.9, 1, 1]],
        masses=14.0,
        cell=9.0,
        units=md.units.ASE,
        species=["N", "N"],
        constraints=[md.DistanceConstraints([[0, 1]])],
    )
    (constraint,) = system.to_ase().constraints
    assert constraint.bondlengths == pytest.approx([0.2], abs=1e-14)


def test_velocities_on_their_way_to_ase_are_not_touched():
    """The momenta of a state that violates a constraint stay as they are."""
    velocities = np.array([[1.0, 0, 0], [0, 0, 0]])
    rigid = md.DistanceConstraints([[0, 1]])
    atoms = md.System(
        [[0, 0, 0], [1, 0, 0]], masses=2.0, velocities=velocities, units=md.units.ASE, constraints=[rigid]
    ).to_ase()
    np.testing.assert_array_equal(atoms.get_momenta(), 2.0 * velocities)


@pytest.mark.parametrize("name", ["a.traj", "a.extxyz"])
def test_trajectories_of_ase_hold_frames_as_they_are_with_their_constraints(name, tmp_path):
    sim = simulation(both_kinds())
    looks = []
    sim.run(
        20,
        every=10,
        trajectory=tmp_path / name,
        observers=[lambda s: looks.append((s.positions.copy(), s.velocities.copy()))],
    )
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

    system = md.System(
        [[0.0, 0, 0], [1.0, 0, 0], [0, 1.1, 0]], masses=1.0, units=md.units.ASE, constraints=[md.FixedAtoms([0])]
    )
    found = md.evaluate(system, ForcesFromCalculator(LennardJones(sigma=1.0, epsilon=1.0, rc=3.0)))
    assert np.abs(found.forces.sum(axis=0)).max() < 1e-12  # rounding
    assert np.abs(found.forces[0]).max() > 1.0


def test_state_of_a_simulation_carries_the_constraints_that_it_keeps():
    sim = simulation(both_kinds())
    again = md.Simulation(sim.system, law(), md.VelocityVerlet(0.002))
    assert described(again.constraints) == described(sim.constraints) == described(sim.system.constraints)
    assert again.n_dof == sim.n_dof
