"""What a user may choose about the computation of forces arrives where it matters; the skin chooses itself well."""

from pathlib import Path

import numpy as np
import pytest
from ase.build import bulk
from cluster_scenes import pair_laws
from hypothesis import given
from hypothesis import strategies as st
from references import liquid, melt, melt_scene

import minimd as md
from minimd.ase import Calculator, VelocityVerlet
from minimd.forces.options import Options
from minimd.forces.pair_laws import skin_for
from minimd.neighbors.cluster_search import LAYERS
from minimd.neighbors.verlet_list import BUILD_COST, CALLS_COST, DEFAULT_SKIN, SKINS, STEP_COST, best_skin
from minimd.scene import parse_scene
from minimd.structure.system import number_density

LJ = md.LennardJones(1.0, 1.0, 2.5)
POSITIVE = st.floats(1e-3, 1e3)
SCENE = melt_scene(10, 1)


def options_of(simulation):
    return simulation.engine.interactions.options


def skin_of(simulation):
    return simulation.engine.interactions.terms[0].list.skin


def after_start(system, potentials=LJ, timestep=0.004, **options):
    """A simulation that has seen how fast its atoms are."""
    simulation = md.Simulation(system, potentials, md.VelocityVerlet(timestep), **options)
    simulation.run(0)
    return simulation


@pytest.mark.parametrize(
    ("option", "value"),
    [("threads", value) for value in (0, -1, 1.5, "2", np.nan)]
    + [("precision", value) for value in ("single", "", None, 64, "Double")]
    + [("skin", value) for value in (-0.1, np.nan, np.inf, "0.3", 1j)],
)
def test_an_impossible_choice_is_told_by_name_and_value(option, value):
    for choose in (
        lambda: Options(**{option: value}),
        lambda: md.Simulation(liquid(2), LJ, md.VelocityVerlet(0.004), **{option: value}),
        lambda: Calculator(LJ, **{option: value}),
    ):
        with pytest.raises(ValueError, match=f"{option} must be .*; {option} = ") as told:
            choose()
        assert str(told.value).endswith(f"{option} = {value!r}")


def test_options_are_values():
    assert Options() == Options(None, "double", None)
    assert Options(threads=np.int64(3)).most_threads == 3
    assert Options().most_threads >= 1
    with pytest.raises(AttributeError):
        Options().threads = 2


@pytest.mark.parametrize("chosen", ["threads = 2\nprecision = 'mixed'", "threads = 1", "precision = 'double'", ""])
def test_a_scene_file_passes_its_choices_on(chosen):
    simulation = parse_scene(SCENE + chosen, Path("scene.toml")).simulation()
    expected = {
        "threads": 2 if "2" in chosen else 1 if "1" in chosen else None,
        "precision": "mixed" if "mixed" in chosen else "double",
    }
    assert options_of(simulation) == Options(**expected)
    simulation.run(1)
    assert f"{expected['precision']} precision" in str(simulation.report())


@pytest.mark.parametrize(
    ("chosen", "named"),
    [("threads = 0", "threads"), ("precision = 'single'", "precision"), ("threads = 1.5", "threads")],
)
def test_a_scene_file_with_an_impossible_choice_is_refused(chosen, named):
    with pytest.raises(ValueError, match=f"dynamics.{named}"):
        parse_scene(SCENE + chosen, Path("scene.toml"))


def test_a_calculator_passes_its_choices_on():
    atoms = bulk("Ar", "fcc", a=5.4, cubic=True) * 8
    atoms.rattle(0.1, seed=1)
    potential, found = md.LennardJones(0.0103, 3.405, 8.0), {}
    for precision in ("double", "mixed"):
        atoms.calc = Calculator(potential, threads=2, precision=precision, skin=1.25)
        found[precision] = atoms.get_forces()
        assert atoms.calc._plan[1].options == Options(2, precision, 1.25)
        assert atoms.calc._plan[1].pair_search.startswith(f"cluster list (skin 1.25, 2 threads, {precision} precision)")
        dynamics = VelocityVerlet(atoms.copy(), 1.0)
        dynamics.atoms.calc = atoms.calc
        dynamics.run(1)
        assert options_of(dynamics._guard) == Options(2, precision, 1.25)
    difference = np.abs(found["double"] - found["mixed"]).max()
    assert 0.0 < difference < 1e-5 * np.abs(found["double"]).max()


@pytest.mark.parametrize("precision", ["double", "mixed"])
@pytest.mark.parametrize(("threads", "words"), [(1, "1 thread"), (2, "2 threads"), (64, "4 threads")])
def test_the_report_names_skin_threads_and_precision(threads, words, precision):
    """No more threads than have work: the list of these 4000 atoms is cut into four chunks."""
    simulation = md.Simulation(melt(), LJ, md.VelocityVerlet(0.004), threads=threads, precision=precision, skin=0.25)
    simulation.run(1)
    assert f"cluster list (skin 0.25, {words}, {precision} precision)" in str(simulation.report())


@given(POSITIVE, POSITIVE, POSITIVE, st.integers(1, 10**7), st.integers(1, 3))
def test_the_best_skin_is_the_cheapest(cutoff, density, stride, n_atoms, layers):
    """The cost of a step by the formula, for skins to choose from."""
    skin = best_skin(cutoff, density, stride, n_atoms, layers)

    def cost(s):
        crowd = density * (cutoff + s) ** 3
        in_use = sum(density * (cutoff + s * layer / layers) ** 3 for layer in range(1, layers + 1)) / layers
        return (
            STEP_COST[0]
            + STEP_COST[1] * in_use
            + (BUILD_COST[0] + BUILD_COST[1] * crowd + CALLS_COST / n_atoms) / max(1.0, s / (2.0 * stride))
        )

    assert skin in SKINS * cutoff
    assert cost(skin) <= min(cost(s) for s in SKINS * cutoff) * (1.0 + 1e-12)


@given(POSITIVE, POSITIVE)
def test_the_default_skin_is_a_part_of_the_cutoff(cutoff, density):
    for unknown in (0.0, -1.0, np.nan):
        assert best_skin(cutoff, density, unknown, 500) == DEFAULT_SKIN * cutoff


def test_faster_atoms_get_a_wider_skin_and_denser_ones_a_thinner():
    by_stride = [best_skin(2.5, 0.8, stride, 4000) for stride in np.geomspace(1e-5, 0.1, 20)]
    by_density = [best_skin(2.5, density, 0.02, 4000) for density in np.geomspace(1e-4, 10.0, 20)]
    by_size = [best_skin(2.5, 0.8, 0.02, n_atoms) for n_atoms in (50, 500, 5000, 10**6)]
    assert by_size[0] > by_size[1] > by_size[-1]  # each build has calls to pay
    assert np.all(np.diff(by_stride) >= 0.0)
    assert by_stride[-1] > 3.0 * by_stride[0]
    assert np.all(np.diff(by_density) <= 0.0)
    assert by_density[0] > 2.0 * by_density[-1]


@given(POSITIVE, st.floats(1e-4, 0.2), st.floats(1e-3, 1e3))
def test_the_best_skin_does_not_depend_on_the_unit_of_length(density, stride, unit):
    assert best_skin(2.5 * unit, density / unit**3, stride * unit, 4000) == pytest.approx(
        unit * best_skin(2.5, density, stride, 4000), rel=0.05
    )


def test_skins_follow_the_speed_of_the_atoms_and_of_the_method():
    skins = []
    for temperature, timestep in ((0.01, 0.001), (0.01, 0.004), (4.0, 0.004), (4.0, 0.01)):
        system = liquid(8, temperature=temperature)
        skins.append(skin_of(after_start(system, timestep=timestep)))
        assert skins[-1] == skin_of(after_start(system, timestep=timestep))
        fastest = timestep * np.linalg.norm(system.velocities, axis=1).max()
        assert skins[-1] == best_skin(2.5, number_density(system, 2.5), fastest, len(system), LAYERS)
    assert np.all(np.diff(skins) > 0.0)
    assert skin_of(after_start(liquid(8), skin=0.2)) == 0.2


@pytest.mark.parametrize("threads", [1, 2, 8])
@pytest.mark.parametrize("precision", ["double", "mixed"])
def test_the_skin_does_not_depend_on_threads_or_precision(threads, precision):
    assert skin_of(after_start(liquid(8), threads=threads, precision=precision)) == skin_of(after_start(liquid(8)))


@given(
    st.floats(1.001, 3.0), st.floats(0.0, 0.3), st.tuples(st.booleans(), st.booleans(), st.booleans()), st.booleans()
)
def test_a_skin_is_never_wider_than_the_cell_has_room_for(height, stride, pbc, has_excluded):
    rng = np.random.default_rng(1)
    cell = np.array([height, 1.3 * height, 2.0 * height]) * LJ.cutoff
    system = md.System(rng.uniform(0, 1, (300, 3)) * cell, cell=cell, pbc=pbc, bonds=[[0, 1]] if has_excluded else None)
    laws = pair_laws(system, [md.LennardJones(1.0, 1.0, 2.5, bonded_scale=(0.0, 1.0, 1.0))])
    skin = skin_for(system, laws, Options(), stride)
    assert skin <= laws.cutoff
    if laws.fit_clusters(system, Options(), stride):
        assert laws.cutoff + skin <= cell[np.array(pbc)].min(initial=np.inf)
    if has_excluded and skin > 0.0:
        assert laws.cutoff + skin <= 0.5 * cell[np.array(pbc)].min(initial=np.inf)


@pytest.mark.parametrize("height", [2.56, 2.6, 2.8, 3.5])
def test_a_cell_with_little_room_still_gets_clusters(height):
    system = md.System(liquid(8).positions % height, cell=height)
    laws = pair_laws(system, [LJ])
    assert laws.fit_clusters(system, Options(), 0.05)
    assert 0.0 < skin_for(system, laws, Options(), 0.05) <= height - 2.5
