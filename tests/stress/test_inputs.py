"""What users hand over, and what they do to a simulation while it runs."""

import numpy as np
import pytest
from stress_scenes import OPEN, ROUNDING, SMOOTH, assert_stops, forces_of, is_finite, oscillation, ran, solid

import minimd as md

NAN, INF = float("nan"), float("inf")
TWO = [[0, 0, 0], [2, 0, 0]]
REFUSED = {
    "zero mass": (lambda: md.System(TWO, masses=[1, 0]), "masses must be positive and finite"),
    "negative mass": (lambda: md.System(TWO, masses=-1), "masses must be positive and finite"),
    "NaN mass": (lambda: md.System(TWO, masses=[NAN, 1]), "masses must be positive and finite"),
    "infinite mass": (lambda: md.System(TWO, masses=INF), "masses must be positive and finite"),
    "NaN position": (lambda: md.System([[NAN, 0, 0]]), "positions must be finite"),
    "infinite position": (lambda: md.System([[INF, 0, 0]]), "positions must be finite"),
    "NaN velocity": (lambda: md.System(TWO, velocities=[[0, 0, 0], [0, NAN, 0]]), "velocities must be finite"),
    "huge velocity": (lambda: md.System(TWO, velocities=np.full((2, 3), 1e200)), "velocities must be below"),
    "NaN cell": (lambda: md.System(TWO, cell=NAN), "cell must be finite"),
    "cell of no volume": (lambda: md.System(TWO, cell=[[1, 0, 0], [2, 0, 0], [0, 0, 1]]), "linearly independent"),
    "periodic without vector": (lambda: md.System(TWO, pbc=True), "pbc"),
    "complex positions": (lambda: md.System(np.array(TWO) + 1j), "positions must be .* complex"),
    "masked positions": (lambda: md.System(np.ma.masked_equal(TWO, 2)), "positions must be .* masked"),
    "ragged positions": (lambda: md.System([[1, 2, 3], [4, 5]]), "positions must be"),
    "words for positions": (lambda: md.System([["a", "b", "c"]]), "positions must be"),
    "no atoms": (lambda: md.System(np.zeros((0, 3))), "N > 0"),
    "atoms in a plane of numbers": (lambda: md.System(np.zeros((4, 2))), r"\(N, 3\)"),
    "a bond with a missing atom": (lambda: md.System(TWO, bonds=[[0, 2]]), "bonds must name atoms 0 to 1"),
    "a bond with half an atom": (lambda: md.System(TWO, bonds=[[0, 0.5]]), "bonds must be"),
    "negative epsilon": (lambda: md.LennardJones(-1.0, 1.0), "epsilon must be finite and not negative"),
    "NaN epsilon": (lambda: md.LennardJones(NAN, 1.0), "epsilon must be finite"),
    "zero sigma": (lambda: md.LennardJones(1.0, 0.0), "sigma must be positive and finite"),
    "negative sigma of a mixture": (
        lambda: md.LennardJones({"A": (1.0, 1.0), "B": (1.0, -1.0)}),
        "sigma of 'B' must be positive and finite",
    ),
    "infinite cutoff": (lambda: md.LennardJones(1.0, 1.0, INF), "cutoff must be positive and finite"),
    "zero cutoff": (lambda: md.LennardJones(1.0, 1.0, 0.0), "cutoff must be positive and finite"),
    "huge cutoff": (lambda: md.LennardJones(1.0, 1.0, 1e200), "cutoff must be positive and finite"),
    "NaN spring": (lambda: md.HarmonicBond(NAN, 1.0), "must be finite"),
    "no cutoff in a cell": (lambda: ran(solid(2), OPEN, 0.004, 1), "cutoff must be given"),
    "NaN time step": (lambda: md.VelocityVerlet(NAN), "timestep must be finite"),
    "zero time step": (lambda: md.VelocityVerlet(0.0), "timestep must be finite and not zero"),
    "half a step": (lambda: ran(solid(2), SMOOTH, 0.004, 0.5), "n_steps must be a whole number"),
    "negative temperature": (lambda: ran(solid(2), SMOOTH, 0.004, 1, temperature=-1.0), "temperature must be finite"),
    "NaN temperature": (lambda: ran(solid(2), SMOOTH, 0.004, 1, temperature=NAN), "temperature must be finite"),
    "infinite friction": (lambda: md.LangevinBAOAB(0.004, 1.0, INF, 1), "friction must be finite"),
    "NaN skin": (lambda: ran(solid(2), SMOOTH, 0.004, 1, skin=NAN), "skin must be"),
}


@pytest.mark.parametrize("name", REFUSED)
def test_what_cannot_be_is_refused_with_a_sentence(name):
    make, words = REFUSED[name]
    with pytest.raises(ValueError, match=words) as caught:
        make()
    assert "\n" not in str(caught.value)


def test_arrays_of_any_kind_are_the_same_scene():
    """Integers, lists, half precision, Fortran order, strides, other byte order, read-only: copied at the door."""
    whole = np.array(list(np.ndindex(6, 6, 6))) * 2
    expected = forces_of(md.System(whole.astype(float), cell=12.0), SMOOTH).forces
    padded = np.zeros((216, 7))
    padded[:, 1:7:2] = whole
    locked = whole.astype(float)
    locked.setflags(write=False)
    kinds = [
        whole,
        whole.tolist(),
        whole.astype(np.float16),
        np.asfortranarray(whole, dtype=float),
        padded[:, 1:7:2],
        whole[::-1][::-1],
    ]
    for kind in [*kinds, whole.astype(">f8"), whole.astype(np.uint8), locked, whole.astype(object), np.ma.array(whole)]:
        system = md.System(kind, cell=[12, 12, 12])
        assert np.array_equal(forces_of(system, SMOOTH).forces, expected)
        system.positions[0] += 0.25
        assert system.positions.flags.c_contiguous
        assert system.positions.dtype == np.float64
    assert np.array_equal(locked, whole)


def test_subnormal_and_negative_zero_numbers_are_numbers():
    system = md.System(
        [[5e-324, -0.0, 0.0], [1.1, 5e-324, -5e-324]], velocities=[[5e-324, 0, 0], [0, -0.0, 0]], masses=[1.0, 1e-70]
    )
    assert is_finite(ran(md.System(system.positions, velocities=system.velocities), SMOOTH, 0.004, 100))
    assert_stops("force on atom 1 would move it", lambda: ran(system, SMOOTH, 0.004, 100))


CHANGES = {
    "NaN": (lambda sim: sim.positions.__setitem__(3, NAN), md.NonFiniteError, "positions of 1 atoms are not finite"),
    "infinite velocities": (lambda sim: sim.velocities.fill(INF), md.NonFiniteError, "not finite"),
    "a small cell": (lambda sim: setattr(sim.system, "cell", md.Cell.of(2.0)), md.NonFiniteError, "atoms .* apart"),
    "two atoms on one spot": (
        lambda sim: sim.positions.__setitem__(0, sim.positions[1]),
        md.NonFiniteError,
        "atoms 0 and 1, 0 σ apart",
    ),
    "hot atoms": (
        lambda sim: np.multiply(sim.velocities, 1e5, out=sim.velocities),
        md.NonFiniteError,
        "moves .* in one step",
    ),
    "a long step": (
        lambda sim: setattr(sim, "method", md.VelocityVerlet(0.5)),
        md.NonFiniteError,
        "timestep 0.5 τ too large",
    ),
    "another system": (lambda sim: setattr(sim, "system", solid(2)), AttributeError, "system"),
    "fewer atoms": (
        lambda sim: setattr(sim.system, "positions", np.zeros((10, 3))),
        ValueError,
        "one row for each of the 108 atoms",
    ),
    "other masses": (
        lambda sim: setattr(sim.system, "masses", np.zeros(108)),
        AttributeError,
        "masses of a System cannot be changed",
    ),
    "a number for a cell": (lambda sim: setattr(sim.system, "cell", 9.0), TypeError, "can be replaced by a Cell"),
    "a run in a run": (lambda sim: sim.run(10), RuntimeError, "this simulation is running"),
    "an equilibration in a run": (lambda sim: sim.equilibrate(10, 1.0), RuntimeError, "this simulation is running"),
}


@pytest.mark.parametrize("name", CHANGES)
def test_what_an_observer_breaks_is_named(name):
    change, error, words = CHANGES[name]
    simulation = md.Simulation(solid(3), SMOOTH, md.VelocityVerlet(0.004))
    simulation.set_temperature(1.0, seed=1)
    with pytest.raises(error, match=words):
        simulation.run(100, every=10, observers=[lambda sim: change(sim) if sim.step == 20 else None])
    assert simulation.step == 20
    assert len(simulation.record) == 3


def test_positions_set_as_a_whole_are_those_that_move():
    """The arrays of a system are those of its simulation, whoever assigns to them."""
    set_once, in_place = (md.Simulation(solid(3), SMOOTH, md.VelocityVerlet(0.004)) for _ in range(2))
    for simulation in (set_once, in_place):
        simulation.set_temperature(1.0, seed=1)
    set_once.system.positions = set_once.system.positions + 0.01
    set_once.system.velocities = 2.0 * set_once.system.velocities
    in_place.positions[:] += 0.01
    in_place.velocities[:] *= 2.0
    for simulation in (set_once, in_place):
        simulation.run(50, observers=[lambda sim: setattr(sim.system, "positions", sim.positions[::1] * 1.0)])
    assert np.array_equal(set_once.positions, in_place.positions)
    assert np.abs(set_once.positions - solid(3).positions).max() > 0.1


def test_an_observer_that_heats_is_no_runaway():
    """Energies that grow ten thousand times because somebody makes them grow."""
    simulation = md.Simulation(solid(3), SMOOTH, md.VelocityVerlet(1e-6))

    def heat(sim):
        if sim.step in (10, 20, 30):
            sim.velocities[:] = np.random.default_rng(sim.step).standard_normal(sim.velocities.shape) * 10.0 * sim.step

    record = simulation.run(40, every=1, observers=[heat])
    assert record.kinetic_energy.max() > 1e4 * abs(record.total_energy[0])


@pytest.mark.parametrize("precision", ["double", pytest.param("mixed", marks=pytest.mark.slow)])
def test_a_cell_that_changes_in_an_observer_is_followed(precision):
    """Grown and shrunk across all kinds of lists: the forces are those of a fresh scene."""
    sizes = iter([7.0, 5.1, 3.0, 30.0, 5.04])
    differences = []

    def change(sim):
        sim.system.cell = md.Cell.of(next(sizes))
        fresh = md.evaluate(md.System(sim.positions, cell=sim.system.cell), GENTLE)
        differences.append(np.abs(sim.engine.interactions.compute() - fresh.forces).max())

    def gentle(r2):
        return 0.1 * np.exp(-r2), 0.2 * np.exp(-r2)

    GENTLE = md.PairPotential(gentle, (), 2.5, "force-shifted")  # noqa: N806
    simulation = md.Simulation(solid(3), GENTLE, md.VelocityVerlet(0.004), precision=precision)
    simulation.run(40, every=10, observers=[change])
    assert len(differences) == 5
    assert max(differences) < (ROUNDING if precision == "double" else 1e-5)


def test_a_law_with_a_hole_stops_where_an_atom_falls_into_it():
    def holed(r2, place):
        f = 0.0 * r2
        return f, f / (abs(r2 - place) > 0.01)

    holed_energy = md.PairPotential(lambda r2: ((1.0 - r2) ** 0.5, 0.0 * r2), (), 3.0, "truncated")
    start = md.System([[0, 0, 0], [2.0, 0, 0]], velocities=[[1.0, 0, 0], [0, 0, 0]])
    for many in (False, True):
        system = solid(3) if many else start
        message = assert_stops(
            r"At step \d+: .*not finite",
            lambda s=system: ran(s, md.PairPotential(holed, (1.21,), 2.5, "truncated"), 0.004, 400, temperature=1.0),
        )
        assert "atoms" in message
    assert_stops("not finite", lambda: ran(start, holed_energy, 0.004, 400))


def test_a_law_that_does_not_compile_is_told():
    def wordy(r2):
        return float(f"{r2}"), np.linalg.nothing(r2)

    def file(r2):
        with open("nothing") as lines:
            return lines, r2

    for law in (wordy, file):
        with pytest.raises((TypeError, ValueError, AttributeError, OSError)) as caught:
            ran(solid(3), md.PairPotential(law, (), 2.5, "truncated"), 0.004, 1)
        assert "Failed in nopython" not in str(caught.value).splitlines()[0] or "does not compile" in str(caught.value)


@pytest.mark.parametrize("precision", ["double", pytest.param("mixed", marks=pytest.mark.slow)])
def test_species_without_interaction_fly_through(precision):
    ghosts = md.LennardJones({"A": (1.0, 1.0), "B": (0.0, 1.0)}, cutoff=2.5, truncation="force-shifted")
    start = solid(4, species=["A", "B"] * 128)
    simulation = ran(start, ghosts, 0.004, 1000, temperature=1.0, precision=precision)
    straight = start.positions[1] + simulation.time * simulation.velocities[1]
    assert np.abs(simulation.positions[1] - straight).max() < (
        1e-10 if precision == "double" else 1e-6
    )  # the net force of rounding is shared by all
    assert oscillation(simulation) < 1e-2
    spots = md.System(
        np.vstack([start.positions, start.positions[1:2] + 1e-3]), species=[*start.species, "B"], cell=start.cell
    )
    assert is_finite(ran(spots, ghosts, 0.004, 10, precision=precision))


@pytest.mark.parametrize("precision", ["double", "mixed"])
def test_cutoffs_ten_times_apart(precision):
    cutoffs = {("A", "A"): 2.5, ("A", "B"): 1.2, ("B", "B"): 0.25}
    law = md.LennardJones({"A": (1.0, 1.0), "B": (1.0, 0.1)}, cutoff=cutoffs, truncation="force-shifted")
    assert (
        oscillation(ran(solid(4, species=["A", "B"] * 128), law, 0.002, 1000, temperature=1.0, precision=precision))
        < 1e-2
    )
