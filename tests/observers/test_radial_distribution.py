"""g(r) of molecules: which pairs count, how many there are, of which centers, and in files."""

import json
from dataclasses import replace

import numpy as np
import pytest
from wrong_calls import answered

import minimd as md
from minimd.mdanalysis import radial_distribution
from minimd.observers.accumulator import first_peak
from minimd.view.check import check_file
from minimd.view.plot import plot_file

NONE = md.LennardJones(1e-12, 1e-3, 0.1, "force-shifted")  # next to no forces
EDGE, N_MOLECULES = 5.0, 6
SPECIES = ["A", "B", "A", "C"]  # of the four atoms of a molecule; one more atom C is a molecule of its own
BONDS = np.array([[0, 1], [1, 2], [2, 3]])
MOLECULE = np.append(np.repeat(np.arange(N_MOLECULES), 4), N_MOLECULES)


def system(bonds="bonds"):
    """Six bent chains of four atoms and one atom, without forces."""
    joined = np.concatenate([BONDS + 4 * m for m in range(N_MOLECULES)])
    given = {"bonds": joined} if bonds == "bonds" else {"constraints": [md.DistanceConstraints(joined)]}
    masses = [1.0, 2.0, 3.0, 0.5] * N_MOLECULES + [7.0]
    species = SPECIES * N_MOLECULES + ["C"]
    return md.System(places(np.random.default_rng(1)), cell=EDGE, species=species, masses=masses, **given)


def places(rng):
    """Rigid molecules at random places, turned at random: an ideal gas of molecules; some are cut by the cell."""
    shape = np.array([[0.0, 0.0, 0.0], [0.9, 0.0, 0.0], [1.2, 0.8, 0.0], [1.2, 0.8, 0.7]])
    turns = np.linalg.qr(rng.normal(size=(N_MOLECULES, 3, 3)))[0]
    atoms = (rng.random((N_MOLECULES, 1, 3)) * EDGE + shape @ turns).reshape(-1, 3)
    return np.concatenate([atoms, rng.random((1, 3)) * EDGE]) % EDGE


def seen(*observers, made=None, n_frames=1, seed=2):
    """The positions of the frames that observers have seen."""
    sim = md.Simulation(made or system(), [], md.VelocityVerlet(0.1))
    rng, frames = np.random.default_rng(seed), []
    for observer in observers:
        observer.prepare(sim.engine)
    for _ in range(n_frames):
        sim.positions[:] = places(rng)
        frames.append(sim.positions.copy())
        for observer in observers:
            observer.observe(sim.engine)
        sim.engine.count(1)
    return np.array(frames)


def looking(**options):
    return md.observers.RadialDistribution(every=1, **options)


def counted(frames, first, second, edges, is_counted):
    """Pairs of all frames in bins, each once, by nearest images."""
    total = 0
    for positions in frames:
        apart = positions[first][:, None] - positions[second]
        apart -= EDGE * np.rint(apart / EDGE)
        total = total + np.histogram(np.linalg.norm(apart, axis=2)[is_counted], edges)[0]
    return total


@pytest.mark.parametrize("intramolecular", [False, True])
@pytest.mark.parametrize("bonds", ["bonds", "lengths held fixed"])
def test_pairs_of_two_molecules_are_those_of_their_numbers(bonds, intramolecular):
    """Pair by pair as brute force counts them; N_ab is the number of pairs of which a histogram is made."""
    observer = looking(intramolecular=intramolecular, n_bins=40)
    frames = seen(observer, made=system(bonds), n_frames=5)
    result, species = observer.result(), np.array([*SPECIES * N_MOLECULES, "C"])
    edges = np.linspace(0.0, observer.reach, 41)
    shells = 4.0 / 3.0 * np.pi * np.diff(edges**3)
    assert result.pairs == ("A-A", "A-B", "A-C", "B-B", "B-C", "C-C")
    for pair, g in zip(result.pairs, result.g_of_pairs, strict=True):
        first, second = (np.flatnonzero(species == name) for name in pair.split("-"))
        counts = first[:, None] != second if intramolecular else MOLECULE[first][:, None] != MOLECULE[second]
        found = counted(frames, first, second, edges, counts)
        np.testing.assert_allclose(g, found / len(frames) * EDGE**3 / counts.sum() / shells, rtol=1e-12)  # rounding
    assert result.is_between == (not intramolecular)
    assert ("without pairs of one molecule" in str(result)) == (not intramolecular)
    assert ("between molecules" in result.plot().axes[0].get_title()) == (not intramolecular)


def test_a_picture_of_one_pair_names_it():
    observer = looking(pairs="A-B")
    seen(observer, made=system("bonds"), n_frames=2)
    assert observer.result().plot().axes[0].get_ylabel() == "g(r) of A-B"


def test_a_pair_keeps_the_name_by_which_it_was_asked_for():
    system = md.System(np.eye(3), cell=9.0, species=["Na", "Cl", "Na"])
    for pair in ("Na-Cl", "Cl-Na"):
        observer = md.observers.RadialDistribution(pairs=pair)
        observer.observe(md.Simulation(system, (), md.VelocityVerlet(0.001)).engine)
        assert observer.result().pairs == (pair,)
        assert f"{pair}: first peak" in str(observer.result())


def test_few_molecules_of_an_ideal_gas_have_a_distribution_of_one():
    """N² in place of N_ab would give 0.84 for A-A."""
    observer = looking(n_bins=8)
    seen(observer, n_frames=2000)
    result = observer.result()
    weights = np.diff(np.linspace(0.0, observer.reach, 9) ** 3)
    means = result.g_of_pairs @ weights / weights.sum()
    assert means == pytest.approx(np.ones(6), abs=0.02)  # statistics: four errors of C-C, the fewest pairs
    far = result.g_of_pairs[0, 4:] - 1.0
    assert np.abs(far).max() < 4.0 * result.errors_of_pairs[0, 4:].max()


def test_chosen_pairs_are_those_of_all_and_g_is_their_mean():
    every, two, one = looking(), looking(pairs=["C-A", "B-B"]), looking(pairs="A-A")
    seen(every, two, one, n_frames=3)
    result = every.result()
    rows = dict(zip(result.pairs, result.g_of_pairs, strict=True))
    assert two.result().pairs == ("C-A", "B-B")
    np.testing.assert_array_equal(two.result().g_of_pairs, [rows["A-C"], rows["B-B"]])
    np.testing.assert_array_equal(one.result().g, rows["A-A"])
    numbers = 12 * 7 - 12, 6 * 5 // 2  # A-C: without the two in each of six molecules
    mean = (numbers[0] * rows["A-C"] + numbers[1] * rows["B-B"]) / sum(numbers)
    assert two.numbers == [*numbers]
    np.testing.assert_allclose(two.result().g, mean, rtol=1e-12)


def test_centers_of_molecules_are_those_of_points_there():
    """Also of molecules that the cell cuts; their species are formulas."""
    observer = looking(of="molecules", n_bins=50)
    frames, made = seen(observer, n_frames=4), system()
    points, centers = looking(n_bins=50, r_max=observer.reach), []
    for positions in frames:
        whole = positions.copy()
        for i, j in made.bonds:  # in the order of the chain
            apart = positions[j] - positions[i]
            whole[j] = whole[i] + apart - EDGE * np.rint(apart / EDGE)
        centers.append(
            [np.average(whole[m == MOLECULE], 0, made.masses[m == MOLECULE]) for m in range(N_MOLECULES + 1)]
        )
    at_centers = md.System(centers[0], cell=EDGE, species=["M"] * N_MOLECULES + ["C"])
    sim = md.Simulation(at_centers, [], md.VelocityVerlet(0.1))
    points.prepare(sim.engine)
    for positions in centers:
        sim.positions[:] = positions
        points.observe(sim.engine)
        sim.engine.count(1)
    found, expected = observer.result(), points.result()
    rows = dict(zip(found.pairs, found.g_of_pairs, strict=True))
    assert rows.keys() == {"C-C", "C-A2BC", "A2BC-A2BC"}
    np.testing.assert_array_equal(rows["C-A2BC"], expected.g_of_pairs[1])
    np.testing.assert_array_equal(rows["A2BC-A2BC"], expected.g_of_pairs[2])
    first, second = made.bonds.T
    assert np.abs(frames[:, second] - frames[:, first]).max() > 0.5 * EDGE  # some are cut


def test_of_a_single_molecule_all_pairs_count():
    one = md.System(places(np.random.default_rng(3))[:4], cell=EDGE, bonds=BONDS)
    observer = looking()
    md.Simulation(one, [], md.VelocityVerlet(0.1)).run(0, observers=[observer])
    assert observer.result().g.max() > 0.0
    assert "molecule" not in str(observer.result())


def test_a_file_counts_the_same_pairs_and_says_so(tmp_path):
    """Positions of MDAnalysis are in float32; a pair on the edge of a bin may be in the next one."""
    file, sim = tmp_path / "a.h5md", md.Simulation(system(), [], md.VelocityVerlet(0.01))
    choices = {"pairs": "A-C"}, {"of": "molecules"}, {"intramolecular": True}, {}
    observers = [looking(name=f"g{k}", n_bins=10, **choice) for k, choice in enumerate(choices)]
    sim.set_temperature(1.0, seed=1)
    sim.run(5)
    sim.run(20, every=1, trajectory=file, observers=observers)
    for observer, choice in zip(observers, choices, strict=True):
        found = radial_distribution(file, 10, **choice)
        np.testing.assert_allclose(found.g, observer.result().g, rtol=0.05, atol=0.02)
        assert found.scene.times == pytest.approx(observer.result().scene.times)
    told = str(check_file(file))
    assert "g(r)           of pairs of atoms between molecules, from " in told
    peaks = radial_distribution(file).peaks()
    assert len(peaks) > 1
    for pair, (r, _, _) in peaks.items():  # each at its own place, whatever the sum of all does
        assert f"               {pair}: first peak at {r:.4g} σ, " in told
    kept = md.read_observers(file)
    assert [str(one.result()) for one in observers] == [str(kept[one.name].result()) for one in observers]
    assert plot_file(file).exists()


def test_sums_of_an_older_version_are_refused_in_words():
    """In them pairs of one molecule count."""
    observer, again = looking(), looking()
    seen(observer)
    state = observer.state()
    about = json.loads(bytes(state["words"])) | {"convention": 1, "settled": {"reach": observer.reach}}
    state["words"] = np.frombuffer(json.dumps(about).encode(), dtype=np.uint8)
    assert not again.can_restore(state)
    with pytest.raises(ValueError, match="radial_distribution cannot be continued"):
        again.restore(state)


test_what_cannot_be_counted_is_refused = answered(
    (lambda: looking(pairs=[]), ValueError, "pairs", "[]"),
    (lambda: looking(pairs=["A-A", "A-A"]), ValueError, "pairs", "'A-A'"),
    (lambda: seen(looking(pairs="A-X")), ValueError, "pairs", "'A-X'", "'B'"),
    (lambda: seen(looking(pairs=["A-B", "B-A"])), ValueError, "pairs", "'B-A'"),
    (lambda: looking(intramolecular="no"), ValueError, "intramolecular", "'no'"),
    (lambda: looking(of="centers"), ValueError, "of", "'centers'"),
)


def test_frames_and_times_of_a_run_in_parts_are_those_of_all(argon, tmp_path):
    sim = argon.simulation(md.VelocityVerlet(0.004))
    looking = md.observers.RadialDistribution(every=10)
    file = tmp_path / "a.h5md"
    sim.run(20, every=10, trajectory=file, observers=[looking])
    before = looking.result()
    again = md.observers.RadialDistribution(every=10)
    md.Simulation.resume(file, sim.potentials).run(20, every=10, trajectory=file, append=True, observers=[again])
    assert before.scene.frames(3) == "3 frames, 0 to 0.08 τ"
    assert again.result().scene.frames(5) == "5 frames, 0 to 0.16 τ"
    state = looking.state()
    about = json.loads(bytes(state["words"]))
    del about["scene"]["times"]  # as an older version wrote it
    state["words"] = np.frombuffer(json.dumps(about).encode(), dtype=np.uint8)
    older = md.observers.RadialDistribution(every=10)
    older.restore(state)
    sim.run(10, every=10, observers=[older])
    assert older.result().scene.frames(4) == "4 frames"


@pytest.mark.parametrize("cell", [np.eye(3), np.array([[1.0, 0, 0], [1, 1, 0], [0, -1, 1]])], ids=["cubic", "skewed"])
def test_radial_distribution_of_a_crystal_counts_all_images(cell):
    """Half the vectors from one atom to the other, and to the images of both, far beyond the cell."""
    system = md.System(np.array([[0.0, 0.0, 0.0], [2.0, 1.0, 1.0]]) @ cell, cell=np.diag([4.0, 2.0, 2.0]) @ cell)
    looking = md.observers.RadialDistribution(r_max=5.0, n_bins=500, every=1)
    md.Simulation(system, NONE, md.VelocityVerlet(0.1)).run(0, observers=[looking])
    result = looking.result()
    counts = result.g * 4.0 / 3.0 * np.pi * np.diff(np.linspace(0.0, 5.0, 501) ** 3) / system.volume  # of one pair
    shifts = (np.indices((9, 9, 9)).reshape(3, -1).T - 4) @ system.cell.vectors
    own = shifts[len(shifts) // 2 + 1 :]  # one of each two opposite vectors
    exact = np.linalg.norm(np.concatenate([system.positions[1] - system.positions[0] + shifts, own, own]), axis=1)
    assert counts.sum() == pytest.approx((exact < 5.0).sum())
    assert result.r[counts > 1e-12][0] == pytest.approx(exact.min(), abs=0.01)


def test_the_first_peak_is_the_vertex_of_a_parabola():
    x = np.array([0.0, 1.0, 1.5, 2.5, 3.0, 4.0, 5.0])
    place, k = first_peak(x, np.maximum(0.0, 2.0 - (x - 2.2) ** 2) + 2.5 * (x == 5.0))  # not the higher one at the end
    assert (place, k) == (pytest.approx(2.2), 3)
    assert first_peak(x, x) == (5.0, 6)


def test_a_peak_within_its_error_is_noise():
    looking = md.observers.RadialDistribution(r_max=2.0, n_bins=20, every=1, pairs="A-B")
    seen(looking, n_frames=3)
    result = looking.result()
    ((_, g, _),) = result.peaks().values()
    for error, is_noise in ((0.49 * (g - 1.0), False), (0.51 * (g - 1.0), True)):
        known = replace(result, errors_of_pairs=np.full_like(result.errors_of_pairs, error))
        assert ("IS NOISE" in str(known)) == is_noise
