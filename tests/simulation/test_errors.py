"""Wrong or senseless input of whatever a user calls is answered with a sentence, and soon; what is right is taken."""

import warnings
from fractions import Fraction
from pathlib import Path
from time import perf_counter

import numpy as np
import pytest
from h5md_runs import fill_the_disk
from scene_texts import REDUCED, everything_of
from wrong_calls import answer_of, answered, assert_answered, assert_right, is_foreseen

import minimd as md
from minimd.core.console.words import shown
from minimd.core.files.h5md_reader import read_file
from minimd.core.files.structure_file import system_from_file
from minimd.scene import load_scene

THREE = np.array([[0.0, 0.0, 0.0], [1.2, 0.0, 0.0], [0.0, 1.2, 0.0]])
NAN, MANY = float("nan"), 10**12
LJ, OPEN, VERLET = md.LennardJones(1.0, 1.0, 2.5), md.LennardJones(1.0, 1.0), md.VelocityVerlet(0.005)
MASKED = np.ma.masked_equal(THREE, 1.2)
OWN = {"Ar": (1.0, 1.0), "Kr": (2.0, 1.1)}
ARGON_IN_KRYPTON = md.System(THREE, species=["Ar", "Kr", "Ar"])
WITH_TAIL = md.LennardJones(1.0, 1.0, 2.5, "truncated", tail_correction=True)
SECONDS = 2.0  # for one call; none needs a hundredth of it once the kernels are compiled
ITSELF: list = []
ITSELF.append(ITSELF)
INF = float("inf")
STEP = md.VelocityVerlet(0.001)
# what no argument of any door may mean; the last is as large as it says, in eight bytes
SENSELESS = [NAN, [NAN], 1 + 2j, np.array([1j, 2, 3]), 10**400, -(10**30), np.datetime64("2020-01-01"), b"x"]
SENSELESS += [np.ma.masked, np.ma.array([1.0, 2.0, 3.0], mask=[0, 1, 0]), object(), [object()] * 3, {1: 2}, ITSELF]
SENSELESS += [[[1, 2], [3]], np.broadcast_to(1.0, (10**12, 3))]
STRANGE = [None, True, False, "False", "", "abc", "1.5", b"", np.bool_(True), np.array("1.5"), print, range(3)]
STRANGE += [[], (), {}, set(), INF, -INF, -1.0, -1, 0, 0.0, 5e-324, 1e-300, 1e300, 1e14, 2**63, 10**20, [10**12] * 3]
STRANGE += [Fraction(3, 2), np.float32(2.5), np.float32(1e-40), np.float16(3), np.int8(-1), np.uint64(2)]
STRANGE += [[True, 2.0, 3.0], np.array([None, 1.0]), np.array([]), np.zeros((0, 3)), np.zeros((2, 2, 2))]
STRANGE += [np.full((3, 3), INF)]
CHANGES = {  # of an array of good numbers
    "masked": lambda good: np.ma.masked_array(good, mask=np.ones_like(good, dtype=bool)),
    "complex": lambda good: good + 1j,        "texts": lambda good: good.astype(str),
    "NaN": lambda good: good * NAN,           "dates": lambda good: good.astype(int).astype("datetime64[s]"),
    "far": lambda good: good + 1e14,          "huge": lambda good: good * 1e300,
    "tiny": lambda good: good * 1e-300,       "negative": lambda good: -good,
    "bools": lambda good: good.astype(bool),  "unsigned": lambda good: good.astype(np.uint64),
    "single": lambda good: good.astype(np.float32), "list": lambda good: good.tolist(),
    "deeper": lambda good: good[None],        "longer": lambda good: np.repeat(good, 2, axis=0),
    "objects": lambda good: good.astype(object),
}  # fmt: skip


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
    ({"species": "A\n"}, "species", "'A\\n'"),
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
    (lambda: made([], constraints=rigid(200.0), cell=3.4), "lengths", "65536", "200", "1.8e+06"),
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


def without_a_number(name):
    """A run after a state was changed to NaN: no arithmetic is made with it, which NumPy would warn of."""
    sim = made(cell=9.0)
    getattr(sim, name)[1, 2] = np.nan
    with warnings.catch_warnings(action="error"):
        sim.run(1, progress=False)


OTHERS = [  # calls that raise something else, its kind, and what its sentence must contain
    (lambda: simulate([[0, 0, 0], [3, 3, 3], [3, 3, 3]], cell=10), md.NonFiniteError, "atoms 1 and 2, 0 σ apart"),
    (lambda: simulate([[0, 0, 0], [3, 3, 3], [3, 3, 3.001]], cell=10), md.NonFiniteError, "force on atom", "0.001 σ"),
    (lambda: simulate(timestep=5.0, cell=10), md.NonFiniteError, "force on atom", "timestep 5 τ"),
    (lambda: system(units="SI"), TypeError, "units", "'SI'"), (lambda: md.PairPotential(3.0), TypeError, "law", "3.0"),
    (lambda: simulate(trajectory="/no/such/folder/a.h5md"), FileNotFoundError, "'/no/such/folder'"),
    (lambda: setattr(made(), "stp", 3), AttributeError, "'stp'", "did you mean 'step'"),
    (lambda: setattr(made(), "forces", THREE), AttributeError, "forces"),
    (lambda: setattr(made(), "timestep", 0.001), AttributeError, "sim.method = VelocityVerlet"),
    (lambda: made().timestep, AttributeError, "'timestep'", "sim.method.timestep"),
    (lambda: md.METHODS, AttributeError, "'METHODS'", "minimd.integrators.METHODS"),
    (lambda: md.LenardJones, AttributeError, "'LenardJones'", "'LennardJones'"),
    (lambda: lj(1.0, 1.0, rcut=2.5), TypeError, "'rcut'", "cutoff, truncation"),
    (lambda: md.VelocityVerlet(timstep=1.0), TypeError, "'timstep'", "did you mean 'timestep'"),
    (lambda: made().virial, AttributeError, "'virial'", "md.evaluate"), (lambda: made().stp, AttributeError, "'step'"),
    (lambda: without_a_number("positions"), md.NonFiniteError, "positions of 1 atoms", "atom 1", "step 0"),
    (lambda: without_a_number("velocities"), md.NonFiniteError, "velocities of 1 atoms", "atom 1", "step 0"),
]
# fmt: on
WRONG += [(lambda given=given: system(**given), *shown) for given, *shown in SYSTEMS]
ROWS = [(call, ValueError, *shown) for call, *shown in WRONG] + OTHERS
test_a_wrong_value_is_answered_with_its_name_and_itself = answered(*ROWS)


def test_one_text_is_the_species_of_all_atoms():
    assert md.System(THREE, species="Ar").species.tolist() == ["Ar", "Ar", "Ar"]


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
    with pytest.raises(OSError, match=r"b\.h5md.* step 2: No space left on device; the 2 earlier frames [^\n]*$"):
        simulate(every=1, trajectory=new)
    assert read_file(new).record.step.tolist() == [0, 1]


# fmt: off
def bonded(**changed):
    return md.System(**{"positions": THREE, "cell": 10.0, "bonds": [[0, 1], [0, 2]], "species": list("ABA")} | changed)

def simulation(method=STEP, constraints=(), **options):
    made = md.Simulation(bonded(), LJ, method, constraints, **options)
    made.make_steps(1)
    return made

def called(name):
    return lambda **arguments: getattr(simulation(), name)(**arguments)

def energy_of(kind):
    return lambda **arguments: md.evaluate(bonded(), kind(**arguments)).potential_energy

def run_by(kind):
    return lambda **arguments: simulation(kind(**arguments))

def held_by(kind):
    return lambda **arguments: simulation(constraints=kind(**arguments))
# fmt: on


def scene_with(**changed):
    """A scene in which numbers are replaced by other values, written as Python writes them."""
    text = REDUCED
    for key, value in changed.items():
        line = next(line for line in text.splitlines() if line.startswith(f"{key} ="))
        text = text.replace(line, f"{key} = {value!r}".replace("True", "true").replace("False", "false"), 1)
    return everything_of(text)


SPECIES = {"A": (1.0, 1.0), "B": (0.5, 0.9)}
CUTOFFS = {("A", "A"): 2.0, ("A", "B"): 2.5, ("B", "B"): 2.5}
SWITCHED = {"truncation": "switched", "switch_start": 2.0, "bonded_scale": (0.0, 0.5, 1.0), "tail_correction": True}
UNLIKE = {"mixing": "geometric", "pairs": {("A", "B"): (0.7, 1.0)}}
SOLVED = {"tolerance": 1e-10, "solver": "auto"}
SCENE = {"system": bonded(), "potentials": LJ}
INVERSE_SQUARE = {"law": lambda r2, a: (a / r2, 2.0 * a / r2**2), "parameters": (1.0,), "cutoff": 2.5}
BATH = {"timestep": 0.001, "temperature": 1.0, "seed": 3}
DOORS = [  # a name, a call, and arguments with which it works
    ("System", bonded, {"positions": THREE, "masses": [1.0, 2.0, 3.0], "velocities": THREE, "cell": [9.0, 9.0, 9.0]}),
    ("System", bonded, {"pbc": [True, True, False], "species": ["A", "A", "B"], "bonds": [[0, 1]]}),
    ("System", bonded, {"units": md.units.LJ, "constraints": ()}),
    ("Cell.of", md.Cell.of, {"vectors": np.eye(3), "pbc": [True, False, True]}),
    ("Cell", md.Cell, {"vectors": np.eye(3), "pbc": np.array([True, True, False])}),
    ("LennardJones", energy_of(md.LennardJones), {"epsilon": 1.0, "sigma": 1.0, "cutoff": 2.5} | SWITCHED),
    ("LennardJones", energy_of(md.LennardJones), {"epsilon": SPECIES, "cutoff": CUTOFFS} | UNLIKE),
    ("PairPotential", lambda **given: md.PairPotential(**given).pair_energy(1.0), INVERSE_SQUARE),
    ("pair_energy", LJ.pair_energy, {"r": [1.0, 2.0, 3.0]}),
    ("HarmonicBond", energy_of(md.HarmonicBond), {"k": [3.0, 1.0], "length": [1.0, 0.0], "pairs": [[0, 1], [1, 2]]}),
    ("HarmonicAngle", energy_of(md.HarmonicAngle), {"k": [3.0], "angle": [1.0], "triples": [[0, 1, 2]]}),
    ("DistanceConstraints", held_by(md.DistanceConstraints), {"pairs": [[0, 1]], "lengths": [1.2]} | SOLVED),
    ("FixedAtoms", held_by(md.FixedAtoms), {"atoms": [0, 2]}),
    ("VelocityVerlet", run_by(md.VelocityVerlet), {"timestep": 0.001}),
    ("LangevinBAOAB", run_by(md.LangevinBAOAB), BATH | {"friction": 1.0}),
    ("StochasticVelocityRescaling", run_by(md.StochasticVelocityRescaling), BATH | {"relaxation_time": 1.0}),
    ("Simulation", lambda **some: md.Simulation(**some).make_steps(1), SCENE | {"method": STEP, "constraints": None}),
    ("Simulation", simulation, {"threads": 1, "precision": "double", "skin": 0.3}),
    ("run", called("run"), {"n_steps": 2, "every": 2, "trajectory": (), "store_forces": False}),
    ("run", called("run"), {"n_steps": 2, "overwrite": False, "observers": (), "progress": False}),
    ("set_temperature", called("set_temperature"), {"temperature": 1.0, "seed": 1}),
    ("equilibrate", called("equilibrate"), {"n_steps": 2, "temperature": 1.0, "every": 1, "progress": False}),
    ("make_steps", called("make_steps"), {"n_steps": 2}),
    ("minimize", called("minimize"), {"force_tolerance": 1e-3, "max_steps": 5, "max_step_length": 0.1}),
    ("minimize", called("minimize"), {"max_steps": 5, "progress": False}),
    ("neighbor_list", md.neighbor_list, {"quantities": "ijd", "system": bonded(), "cutoff": 2.5}),
    ("advise_timestep", md.advise_timestep, SCENE | {"method": md.VelocityVerlet}),
    ("crystal", md.lattice.crystal, {"lattice": "fcc", "repeat": [2, 2, 2], "lattice_constant": 1.5}),
    ("constant_from_density", md.lattice.constant_from_density, {"lattice": "fcc", "density": 0.8, "mass": 1.0}),
    ("scene", scene_with, {"timestep": 0.004, "steps": 20, "temperature": 1.44, "cutoff": 2.5}),
    ("scene", scene_with, {"repeat": [4, 4, 4], "density": 0.8}),
]
ENDLESS = {"n_steps", "max_steps", "steps"}  # a large one is no mistake, but takes its time
NUMBERS = (float, int, list, tuple, np.ndarray)


def hostile_value(key, good, rng):
    """(a value for an argument, in words, whether no sense can be made of it); None if there is none."""
    pool = [SENSELESS, STRANGE, CHANGES, CHANGES][int(rng.integers(4))]
    if pool is CHANGES and isinstance(good, NUMBERS) and not isinstance(good, bool) and np.size(good):
        change = str(rng.choice(list(CHANGES)))
        try:
            return CHANGES[change](np.array(good)), f"{key} {change}", False
        except (TypeError, ValueError):
            return None  # texts cannot be multiplied
    pool = STRANGE if pool is CHANGES else pool
    value = pool[int(rng.integers(len(pool)))]
    if key in ENDLESS and isinstance(value, int) and value > 100:
        return None
    return value, f"{key} = {shown(value)}", pool is SENSELESS


def hostile_calls(rounds, rng, doors=DOORS):
    """Every argument of every door made senseless so many times, half of them together with another one."""
    for name, call, good in rounds * doors:
        for key in good:
            others = [str(rng.choice(list(good)))] if rng.random() < 0.5 else []
            changes = {one: hostile_value(one, good[one], rng) for one in [key, *others]}
            found = {one: change for one, change in changes.items() if change}
            told = f"{name}({', '.join(words for _, words, _ in found.values())})"
            arguments = good | {one: value for one, (value, _, _) in found.items()}
            yield told, call, arguments, any(is_senseless for _, _, is_senseless in found.values())


def answer_to(call, arguments, is_senseless):
    started = perf_counter()
    answer = answer_of(lambda: call(**arguments), is_senseless, has_several_problems=call is scene_with)
    seconds = perf_counter() - started
    return answer if seconds < SECONDS else f"slow: {seconds:.1f} s"


@pytest.mark.parametrize("rounds", [1, pytest.param(100, marks=pytest.mark.slow)])
def test_every_senseless_call_is_answered_with_a_sentence_or_a_right_result(rounds):
    for _, call, good in DOORS:
        call(**good)  # compiles
    assert_right((told, answer_to(*rest)) for told, *rest in hostile_calls(rounds, np.random.default_rng(1)))


def written(**options):
    """A door that writes a file, which is removed before each call."""
    Path("a.csv").unlink(missing_ok=True)
    return simulation().run(1, progress=False).to_csv(**options)


def on_the_sphere(**options):
    return md.evaluate(md.System(THREE), md.SphereWall(**options))


def torsion(kind):
    chain = md.System([[0, 0, 0], [1.2, 0, 0], [1.9, 1, 0], [3, 1.2, 0.4]])
    return lambda **arguments: md.evaluate(chain, kind(**arguments, quadruples=[[0, 1, 2, 3]]))


DECAY = md.integrators.FirstOrder(lambda t, y: -y)
OF_DECAY = {"problem": DECAY, "method": md.integrators.RadauIIA3, "start": [1.0], "t_end": 0.1, "t0": 0.0}
HAND_OVER = {"simulation": simulation(), "folder": "new", "steps": 3}
OTHER_DOORS = [  # as DOORS; found by a stranger who called everything with everything
    ("shadow_energy", md.shadow_energy, {"simulation": simulation()}),
    ("gauss", md.integrators.gauss, {"n_stages": 3}), ("radau_iia", md.integrators.radau_iia, {"n_stages": 3}),
    ("Newton", md.integrators.Newton, {"max_iterations": 5, "small": 1e-6}),
    ("run_adaptive", md.integrators.run_adaptive, OF_DECAY),
    ("water", md.water, {"model": "SPC/E", "n": 27, "density": 1.0, "cutoff": 4.0, "accuracy": 1e-4, "seed": 1}),
    ("water", md.water, {"n": 27, "ions": {"Na": 1}, "cutoff": 4.0}),
    ("to_csv", written, {"path": "a.csv", "overwrite": False}),
    ("SphereWall", on_the_sphere, {"point": [0.0, 0.0, 0.0], "radius": 9.0, "epsilon": 1.0, "cutoff": 2.0}),
    ("RyckaertBellemans", torsion(md.RyckaertBellemans), {"coefficients": [1.0, 2.0]}),
    ("PeriodicDihedral", torsion(md.PeriodicDihedral), {"k": 1.0, "n": 2, "phase": 0.5}),
    ("run", called("run"), {"n_steps": 2, "max_seconds": 60.0, "crash_report": False, "append": False}),
    ("check_hand_over", md.lammps.check_hand_over, HAND_OVER | {"every": 1, "processes": 1, "overwrite": True}),
    ("Stream", md.observers.Stream, {"port": 0, "every": 5, "host": "localhost", "wait": False}),
]  # fmt: skip
NO_PATHS = [5, None, 1.5, b"run.h5md", [], {}, object(), print, np.zeros(3), "a\0b", "x" * 10**5, "x" * 300 + ".h5md"]
PATHS = {  # a door: the name of its argument, and a call with it
    "read_record": ("file", md.read_record), "read_observers": ("file", md.read_observers),
    "view": ("file", md.view), "replay": ("file", lambda path: md.replay(path, LJ)), "Past": ("file", md.Past),
    "archive": ("file", lambda path: md.archive(path, "out.h5md", 10)), "resume": ("file", md.Simulation.resume),
    "system_from_file": ("file", system_from_file), "load_scene": ("path", load_scene),
    "run": ("trajectory", lambda path: made(cell=9.0).run(1, trajectory=[path])),
    "crash_report": ("crash_report", lambda path: made(cell=9.0).run(1, crash_report=path)),
    "to_csv": ("path", lambda path: made(cell=9.0).run(1).to_csv(path)),
    "ensemble": ("folder", lambda path: md.ensemble(made, 1, 1, folder=path, workers=0)),
    "check_hand_over": ("folder", lambda path: md.lammps.check_hand_over(made(cell=9.0), path, 1)),
    "write_input": ("folder", lambda path: md.lammps.write_input(made(cell=9.0), path, 1)),
}  # fmt: skip


@pytest.mark.parametrize("door", PATHS)
def test_what_names_no_file_is_refused_by_the_name_of_the_argument(door, here):
    name, call = PATHS[door]
    for path in NO_PATHS:
        if path is not None or door not in ("view", "crash_report"):  # where there is no file
            with pytest.raises((ValueError, TypeError), match=f"^{name} must be") as refused:
                call(path)
            assert is_foreseen(refused.value), refused.value


def test_no_flag_but_true_replaces_a_file(here):
    record = simulation().run(1, progress=False)
    Path("a.csv").write_text("precious")
    for flag in ("no", 1, None, [True]):
        assert_answered(lambda flag=flag: record.to_csv("a.csv", overwrite=flag), ValueError, "overwrite")
    assert Path("a.csv").read_text() == "precious"


test_what_was_taken_without_sense_is_refused = answered(
    (lambda: md.water(density=1e30), ValueError, "density", "1e+30"),
    (lambda: md.integrators.Newton(small="abc"), ValueError, "small", "'abc'"),
    (lambda: md.SphereWall([0, 0, 0], None), ValueError, "radius", "None"),
    (lambda: md.PeriodicDihedral(1.0, 2, 1e30), ValueError, "phase", "1e+30"),
    (lambda: md.RyckaertBellemans(()), ValueError, "coefficients", "()"),
    (lambda: md.RyckaertBellemans({}), ValueError, "coefficients", "{}"),
    (lambda: md.shadow_energy(5), TypeError, "simulation", "5"),
    (lambda: md.LennardJones(1.0, 1.0, pairs=5), ValueError, "pairs"),
    (lambda: made().restore(5), TypeError, "snapshot", "5"),
    (lambda: made().run(1, max_seconds=-1.0), ValueError, "max_seconds", "-1.0"),
)


@pytest.mark.parametrize("rounds", [1, pytest.param(100, marks=pytest.mark.slow)])
def test_senseless_calls_of_other_doors_are_answered_too(rounds, here):
    for _, call, good in OTHER_DOORS:
        call(**good)  # compiles
    seen = [(told, answer_to(*rest)) for told, *rest in hostile_calls(rounds, np.random.default_rng(2), OTHER_DOORS)]
    assert_right((told, answer) for told, answer in seen)


def test_times_may_be_as_short_as_in_the_tests_of_ase():
    assert md.VelocityVerlet(1e-101).timestep == 1e-101
    assert md.StochasticVelocityRescaling(1.0, 1.0, 1e-101, seed=1).relaxation_time == 1e-101
    assert_answered(lambda: md.VelocityVerlet(1e-160), ValueError, "timestep", "1e-150", "1e-160")
