"""Sentences for what a user is likely to have forgotten."""

import warnings

import numpy as np
import pytest

import minimd as md
from minimd.scene import parse_scene
from minimd.scene.running import differences
from minimd.structure.lattice import crystal

LJ = md.LennardJones(1.0, 1.0, 2.0)


def triple(**more):
    return md.System([[0.0, 0, 0], [1.0, 0, 0], [2.2, 0, 0]], **more)


@pytest.mark.parametrize(
    "potential", [md.LennardJones(1.0, 1.0, 2.0, bonded_scale=(0, 1, 1)), md.HarmonicBond(1.0, 1.0)]
)
def test_bonds_that_are_missing_are_told(potential):
    with pytest.warns(
        UserWarning, match=r"has no effect: the system has no bonds; give them as System\(bonds="
    ) as told:
        md.Simulation(triple(), [LJ, potential], md.VelocityVerlet(0.001))
    assert told[0].filename == __file__
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        md.Simulation(triple(bonds=[[0, 1]]), [LJ, potential], md.VelocityVerlet(0.001))


def test_constraints_of_a_kind_that_is_not_given_again_are_told():
    system = triple(constraints=[md.FixedAtoms([2])])
    with pytest.warns(UserWarning, match=r"replace those of the system, and FixedAtoms\(1 atoms\) is lost"):
        md.Simulation(system, LJ, md.VelocityVerlet(0.001), md.DistanceConstraints([[0, 1]]))
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        md.Simulation(system, LJ, md.VelocityVerlet(0.001), [md.DistanceConstraints([[0, 1]]), md.FixedAtoms([1])])
        md.Simulation(system, LJ, md.VelocityVerlet(0.001), ())


@pytest.mark.parametrize(
    ("make", "words"),
    [(lambda: triple(cell=-3.0), "must not be negative"), (lambda: triple(cell=[3, 3, -1]), "negative")],
)
def test_negative_lengths_of_a_cell_are_refused(make, words):
    with pytest.raises(ValueError, match=words):
        make()


def test_a_single_bonded_scale_is_refused():
    with pytest.raises(ValueError, match="bonded_scale must be three finite factors"):
        md.LennardJones(1.0, 1.0, 2.0, bonded_scale=0)


def test_rigid_pairs_are_no_overlap_at_the_start():
    """Two dumbbells of an atom and a light one without a well, thrown at each other: their own lengths are not the cause."""
    positions, pairs = [[0.0, 0, 0], [0.3, 0, 0], [1.6, 0, 0], [1.9, 0, 0]], [[0, 1], [2, 3]]
    velocities = [[0, 0, 0], [0, 0, 0], [-90.0, 0, 0], [-90.0, 0, 0]]
    system = md.System(positions, species=["A", "B", "A", "B"], velocities=velocities)
    law = md.LennardJones({"A": (1.0, 1.0), "B": (0.0, 1.0)}, cutoff=2.5)
    with pytest.raises((md.NonFiniteError, md.ConstraintError)) as caught:
        md.Simulation(system, law, md.VelocityVerlet(0.01), md.DistanceConstraints(pairs)).run(100)
    assert "Likely cause" in str(caught.value)
    assert "overlap at the start" not in str(caught.value)


def test_a_start_out_of_equilibrium_is_told_beside_a_drift():
    positions, edges = crystal("fcc", [4, 4, 4], 1.68)
    run = md.Simulation(
        md.System(positions, cell=edges), md.LennardJones(1.0, 1.0, 2.5, "truncated"), md.VelocityVerlet(0.02)
    )
    run.set_temperature(2.0, seed=1)
    run.run(100, every=1)
    report = run.report()
    assert report.is_settling
    assert report.temperatures[0] > 1.1 * report.temperatures[1]
    assert not report.energy_is_conserved
    assert "the temperature went from" in report.verdict
    assert "equilibrate first" in report.verdict


SCENE = """
units = "LJ"
[structure]
lattice = "fcc"
lattice_constant = 1.7
repeat = [3, 3, 3]
[[potential]]
type = "lennard-jones"
epsilon = 1.0
sigma = 1.0
cutoff = 2.0
[dynamics]
method = "velocity-verlet"
timestep = 0.004
steps = 10
temperature = 1.0
"""


def test_scenes_that_differ_in_what_matters_are_told_apart():
    one = parse_scene(SCENE, "a.toml")
    assert differences(one, parse_scene(SCENE + "\n# the same", "b.toml")) == []
    assert differences(one, parse_scene(SCENE.replace("steps = 10", "steps = 20"), "b.toml")) == [
        "dynamics.steps: 10 before, 20 now"
    ]
    other = parse_scene(SCENE.replace("sigma = 1.0", "sigma = 0.9").replace("0.004", "0.002"), "b.toml")
    assert differences(one, other) == [
        "potential[0].sigma: 1.0 before, 0.9 now",
        "dynamics.timestep: 0.004 before, 0.002 now",
    ]


def test_velocities_of_a_scene_are_drawn_behind_its_minimization(tmp_path, monkeypatch):
    from minimd.scene import run_scene

    monkeypatch.chdir(tmp_path)
    bonds = "bonds = [[0, 1], [1, 2], [3, 4]]\n"  # shorter than their neighbors are apart: they turn on the way down
    text = (
        SCENE.replace('lattice = "fcc"', bonds + 'lattice = "fcc"')
        + '[constraints]\npairs = "bonds"\nlengths = 1.0\n[minimization]\nmax_steps = 50\n'
    )
    run = run_scene(parse_scene(text, tmp_path / "a.toml"), tell=lambda line: None, progress=False)
    assert run.record.temperature[0] == pytest.approx(1.0, rel=1e-9)
    assert np.isfinite(run.record.total_energy).all()
