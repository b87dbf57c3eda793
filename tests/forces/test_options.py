"""Threads, precision and skin arrive where forces are computed; the skin chooses itself well."""

import numpy as np
from ase.build import bulk
from cluster_scenes import pair_laws
from hypothesis import given
from hypothesis import strategies as st
from references import liquid

import minimd as md
from minimd.ase import Calculator, VelocityVerlet
from minimd.forces.options import Options
from minimd.forces.pair_laws import skin_for
from minimd.neighbors.cluster_search import LAYERS
from minimd.neighbors.verlet_list import BUILD_COST, CALLS_COST, DEFAULT_SKIN, SKINS, STEP_COST, best_skin
from minimd.structure.system import number_density

LJ = md.LennardJones(1.0, 1.0, 1.8, "force-shifted")
POSITIVE = st.floats(1e-3, 1e3)
LIQUID = liquid(8)


def skin_of(system=LIQUID, timestep=0.004, **options):
    """The skin of a simulation that has seen how fast its atoms are."""
    simulation = md.Simulation(system, LJ, md.VelocityVerlet(timestep), **options)
    simulation.run(0)
    return simulation.engine.interactions.terms[0].list.skin


def test_a_calculator_passes_its_choices_on():
    atoms = bulk("Ar", "fcc", a=5.4, cubic=True) * 8
    atoms.rattle(0.1, seed=1)
    found = []
    for precision in ("double", "mixed"):
        chosen = {"threads": 2, "precision": precision, "skin": 1.25}
        atoms.calc = Calculator(md.LennardJones(0.0103, 3.405, 6.2, "force-shifted"), **chosen)
        found.append(atoms.get_forces())
        dynamics = VelocityVerlet(atoms.copy(), 1.0)
        dynamics.atoms.calc = atoms.calc
        dynamics.run(1)
        assert atoms.calc._plan[1].options == dynamics._guard.engine.interactions.options == Options(**chosen)
    assert 0.0 < np.abs(found[0] - found[1]).max() < 1e-5 * np.abs(found[0]).max()


@given(POSITIVE, POSITIVE, POSITIVE, st.integers(1, 10**7), st.integers(1, 3))
def test_the_best_skin_is_the_cheapest(cutoff, density, stride, n_atoms, layers):
    """The cost of a step by the formula, for skins to choose from."""
    skin = best_skin(cutoff, density, stride, n_atoms, layers)

    def cost(s):
        crowd = density * (cutoff + s) ** 3
        in_use = sum(density * (cutoff + s * layer / layers) ** 3 for layer in range(1, layers + 1)) / layers
        build = BUILD_COST[0] + BUILD_COST[1] * crowd + CALLS_COST / n_atoms
        return STEP_COST[0] + STEP_COST[1] * in_use + build / max(1.0, s / (2.0 * stride))

    assert skin in SKINS * cutoff
    assert cost(skin) <= min(cost(s) for s in SKINS * cutoff) * (1.0 + 1e-12)
    for unknown in (0.0, -1.0, np.nan):
        assert best_skin(cutoff, density, unknown, 500) == DEFAULT_SKIN * cutoff


def test_skins_follow_the_speed_of_the_atoms_and_of_the_method_and_not_threads_or_precision():
    skins = []
    for temperature, timestep in ((0.01, 0.001), (0.01, 0.004), (4.0, 0.004), (4.0, 0.01)):
        system = liquid(8, temperature=temperature)
        skins.append(skin_of(system, timestep))
        fastest = timestep * np.linalg.norm(system.velocities, axis=1).max()
        assert skins[-1] == best_skin(1.8, number_density(system, 1.8), fastest, len(system), LAYERS)
    assert np.all(np.diff(skins) > 0.0)
    assert skin_of(skin=0.2) == 0.2
    options = [{"threads": threads, "precision": name} for threads in (1, 2, 8) for name in ("double", "mixed")]
    assert len({skin_of(**one) for one in [{}, *options]}) == 1


@given(st.floats(1.001, 3.0), st.floats(0.0, 0.3), st.tuples(*[st.booleans()] * 3), st.booleans())
def test_a_skin_is_never_wider_than_the_cell_has_room_for(height, stride, pbc, has_excluded):
    rng = np.random.default_rng(1)
    cell = np.array([height, 1.3 * height, 2.0 * height]) * LJ.cutoff
    system = md.System(rng.uniform(0, 1, (300, 3)) * cell, cell=cell, pbc=pbc, bonds=[[0, 1]] if has_excluded else None)
    laws = pair_laws(system, [md.LennardJones(1.0, 1.0, 1.8, bonded_scale=(0.0, 1.0, 1.0))])
    skin, narrowest = skin_for(system, laws, Options(), stride), cell[np.array(pbc)].min(initial=np.inf)
    assert skin <= laws.cutoff
    if laws.fit_clusters(system, Options(), stride):
        assert laws.cutoff + skin <= narrowest
    if has_excluded and skin > 0.0:
        assert laws.cutoff + skin <= 0.5 * narrowest
