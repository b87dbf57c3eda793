"""Wrong input of systems, potentials, methods and simulations is answered with one sentence; what is right is taken."""

import numpy as np
import pytest
from h5md_runs import fill_the_disk
from wrong_calls import answered, assert_answered

import minimd as md
from minimd.files.h5md_reader import read_file

THREE = np.array([[0.0, 0.0, 0.0], [1.2, 0.0, 0.0], [0.0, 1.2, 0.0]])
NAN, MANY = float("nan"), 10**12
LJ, OPEN, VERLET = md.LennardJones(1.0, 1.0, 2.5), md.LennardJones(1.0, 1.0), md.VelocityVerlet(0.005)
MASKED = np.ma.masked_equal(THREE, 1.2)
OWN = {"Ar": (1.0, 1.0), "Kr": (2.0, 1.1)}
ARGON_IN_KRYPTON = md.System(THREE, species=["Ar", "Kr", "Ar"])
WITH_TAIL = md.LennardJones(1.0, 1.0, 2.5, "truncated", tail_correction=True)


# fmt: off
def system(positions=THREE, **options):
    return md.System(positions, **options)

def simulate(positions=THREE, laws=LJ, timestep=0.005, n_steps=10, cell=None, **options):
    simulation = md.Simulation(system(positions, cell=cell), laws, md.VelocityVerlet(timestep))
    simulation.set_temperature(1.0, seed=1)
    return simulation.run(n_steps, progress=False, **options)

def made(laws=LJ, method=VERLET, constraints=(), cell=None, **options):
    return md.Simulation(system(cell=cell), laws, method, constraints, **options)

def energy(laws, positions=THREE, **options):
    return md.evaluate(system(positions, **options), laws).potential_energy

def lj(*arguments, **options):
    return md.LennardJones(*(arguments or (1.0, 1.0)), **{"cutoff": 2.5} | options)

def mixed(scene=ARGON_IN_KRYPTON, **options):
    return md.evaluate(scene, md.LennardJones(OWN, cutoff=2.5, **options)).potential_energy

def moved_by(distance):
    simulation = made(cell=9.0)
    simulation.positions[:] += distance
    simulation.run(1, progress=False)

def rigid(length=None, **options):
    return md.DistanceConstraints([[0, 1]], length, **options)

SYSTEMS = [  # what is given to a system of three atoms that raises ValueError, and what its sentence must contain
    ({"positions": [[0, 0, 0], [1, NAN, 0]]}, "positions[1]", "nan"), ({"positions": [["a"]]}, "positions", "'a'"),
    ({"positions": np.broadcast_to(1.0, (MANY, 3))}, "positions", "3000000000000", "402653184"),
    ({"positions": THREE + 0j}, "positions", "complex"),      ({"positions": MASKED}, "positions", "masked"),
    ({"velocities": [[0, 0, 0]]}, "velocities", "3 atoms", "1"), ({"masses": [1, 0, 1]}, "masses[1]", "0.0"),
    ({"units": md.units.ASE}, "masses", "ASE"),               ({"species": ["Ar"]}, "species", "3", "(1,)"),
    ({"charges": [1.0, -1.0]}, "charges", "3", "(2,)"),       ({"charges": [1.0, NAN, 0.0]}, "charges[1]", "nan"),
    ({"charges": {"A": 1.0}, "species": ["A", "B", "A"]}, "charges", "'A', 'B'"), ({"charges": {"X": "a"}}, "'a'"),
    ({"species": ["Ar", 1, None]}, "species", "None"),        ({"bonds": [[1, 1]]}, "bonds[0]", "[1, 1]"),
    ({"bonds": [[0, 1], [1, 3]]}, "bonds[1]", "[1, 3]", "0 to 2"), ({"bonds": [[0, 1.5]]}, "bonds", "fractions"),
    ({"bonds": [[0, 1], [1, 0]]}, "bonds", "[0, 1]", "2 times"), ({"pbc": True}, "pbc[0]", "cell[0]"),
    ({"cell": [[1, 0, 0], [0, 1, 0], [1, 1, 0]]}, "independent"), ({"cell": 9, "pbc": "False"}, "pbc", "'False'"),
]
WRONG = [  # a call that raises ValueError, and what its sentence must contain
    (lambda: md.Cell.of([1e-5, 1e12, 1.0]), "lattice vectors", "differ"),
    # atoms so far away that rounding moves them
    (lambda: simulate(THREE + 1e14, cell=9.0), "positions", "4.1e+10", "1.0e+14", "0.02", "height of the cell, 9"),
    (lambda: moved_by(1e14), "positions", "4.1e+10", "height of the cell, 9"), (lambda: lj(1.0), "epsilon", "sigma"),
    (lambda: energy(LJ, THREE + 1e14), "positions", "of a potential, 2.5"), (lambda: lj(-1.0, 1.0), "epsilon", "-1.0"),
    (lambda: md.Simulation(system(THREE + 1e14), [], VERLET, rigid()), "positions", "the shortest rigid length"),
    (lambda: made([], constraints=rigid(200.0), cell=3.4), "lengths", "65536", "constraint 0 is 200", "1.8e+06"),
    (lambda: lj(1.0, 1e-300), "sigma", "1e-75", "1e-300"), (lambda: LJ.pair_energy([1.0, 0.0]), "r must", "[1.0, 0.0]"),
    (lambda: lj(truncation="shifted", tail_correction=True), "tail_correction", "'shifted'"),
    (lambda: simulate(laws=WITH_TAIL), "tail_correction", "periodic"),
    (lambda: simulate(laws=OPEN, cell=10), "cutoff", "LennardJones", "None"),
    (lambda: mixed(system(species=["Ar", "Kr", "Xe"])), "'Xe'", "'Ar', 'Kr'"),
    (lambda: mixed(pairs={("Ar", "Kx"): (3.0, 1.0)}), "pairs", "'Kx'", "did you mean 'Kr'?"),
    (lambda: mixed(mixing=lambda a, b: a), "mixing", "(1.0, 1.0)", "(2.0, 1.1)"),
    (lambda: md.PairPotential(lambda r2, k: (k, k), (1.0,), 2.5, pairs={("Ar", "Kr"): (2.0,)}), "pairs", "PairPot"),
    (lambda: md.PairPotential(lambda r2, k: (k * r2, -2.0 * k), (1.0,)).pair_energy(1.0), "cutoff", "'truncated'"),
    (lambda: md.HarmonicBond(-1.0, 1.0), "k must", "-1.0"),
    (lambda: made().set_temperature(-1.0), "temperature", "-1.0"),
    (lambda: energy(md.HarmonicBond([1.0, 2.0], 1.0), bonds=[[0, 1]]), "k must", "(2,)"),
    (lambda: energy(md.HarmonicAngle(1.0, 1.0, [[0, 1, 3]])), "triples[0]", "[0, 1, 3]", "0 to 2"),
    (lambda: md.HarmonicAngle(1.0, 109.5, [[0, 1, 2]]), "radians", "109.5"),
    (lambda: md.VelocityVerlet(0.0), "timestep", "0.0"), (lambda: simulate(trajectory="run.pdf"), ".h5md", "'run.pdf'"),
    (lambda: made().report(), "call run first"),
]
OTHERS = [  # calls that raise something else, its kind, and what its sentence must contain
    (lambda: simulate([[0, 0, 0], [3, 3, 3], [3, 3, 3]], cell=10), md.NonFiniteError, "atoms 1 and 2, 0 σ apart"),
    (lambda: simulate([[0, 0, 0], [3, 3, 3], [3, 3, 3.001]], cell=10), md.NonFiniteError, "force on atom", "0.001 σ"),
    (lambda: simulate(timestep=5.0, cell=10), md.NonFiniteError, "force on atom", "timestep 5 τ"),
    (lambda: system(units="SI"), TypeError, "units", "'SI'"), (lambda: md.PairPotential(3.0), TypeError, "law", "3.0"),
    (lambda: simulate(trajectory="/no/such/folder/a.h5md"), FileNotFoundError, "'/no/such/folder'"),
    (lambda: setattr(made(), "stp", 3), AttributeError, "'stp'", "did you mean 'step'"),
    (lambda: setattr(made(), "positions", THREE), AttributeError, "sim.positions[:]"),
    (lambda: setattr(made(), "timestep", 0.001), AttributeError, "sim.method = VelocityVerlet"),
]
# fmt: on
WRONG += [(lambda given=given: system(**given), *shown) for given, *shown in SYSTEMS]
ROWS = [(call, ValueError, *shown) for call, *shown in WRONG] + OTHERS
test_a_wrong_value_is_answered_with_its_name_and_itself = answered(*ROWS)


def test_a_library_of_pairs_may_know_more_species_than_the_system():
    library = OWN | {"Xe": (3.0, 1.2)}
    more = md.LennardJones(library, cutoff=2.5, pairs={("Kr", "Xe"): (9.0, 1.0)})
    assert md.evaluate(ARGON_IN_KRYPTON, more).potential_energy == mixed()
    complete = md.LennardJones({}, cutoff=2.5, pairs={(a, b): (1.0, 1.0) for a in library for b in library})
    assert md.evaluate(ARGON_IN_KRYPTON, complete).potential_energy == energy(LJ)


@pytest.mark.parametrize("kind", [np.float16, np.longdouble, np.int8, np.uint64, object])
def test_arrays_of_any_kind_of_real_numbers_are_taken(kind):
    positions, masses, cell = (np.array(one).astype(kind) for one in (10 * THREE, [1, 2, 3], [30, 40, 50]))
    taken = md.System(positions, masses=masses, cell=cell, pbc=[1, 1, 0])
    assert np.array_equal(taken.positions, 10 * THREE)
    assert np.array_equal(taken.masses, [1, 2, 3])
    assert np.array_equal(taken.cell.vectors, np.diag([30, 40, 50]))
    assert np.array_equal(md.System(np.ma.array(THREE)).positions, THREE)  # nothing is masked


def test_existing_output_is_kept_and_a_full_disk_ends_a_run_with_a_sentence_and_a_valid_file(tmp_path, monkeypatch):
    file, new = tmp_path / "a.h5md", tmp_path / "b.h5md"
    file.write_text("precious")
    assert_answered(lambda: simulate(trajectory=file), FileExistsError, "a.h5md", "overwrite=True")
    assert file.read_text() == "precious"
    fill_the_disk(monkeypatch, after=4)
    with pytest.raises(OSError, match=r"b\.h5md.* step 2: No space left on device; the 2 frames [^\n]*$"):
        simulate(every=1, trajectory=new)
    assert read_file(new).record.step.tolist() == [0, 1]
