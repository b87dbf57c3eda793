"""Observers of molecules, of charges and of a surface have known answers."""

import numpy as np
import pytest
from references import processes
from wrong_calls import answered

import minimd as md
from minimd.observers.accumulator import BlockedSums, ObservedRun

NONE = md.LennardJones(1e-12, 1e-3, 0.1, "force-shifted")  # next to no forces
FREE = md.VelocityVerlet(1e-9)


def chains_of(steps, cell=50.0, **options):
    """Molecules whose bonds are steps (M, n - 1, 3), each atom moved to a random image."""
    n_chains = len(steps)
    rng = np.random.default_rng(5)
    starts = rng.uniform(-45.0, 45.0, (n_chains, 1, 3))
    positions = np.concatenate([starts, starts + np.cumsum(steps, axis=1)], axis=1)
    positions = positions.swapaxes(0, 1).reshape(-1, 3)
    positions += cell * rng.integers(-2, 3, positions.shape)
    atoms = np.arange(len(positions)).reshape(-1, n_chains)  # those of a molecule lie far apart in the list
    bonds = np.stack([atoms[:-1], atoms[1:]], axis=2).reshape(-1, 2)
    return md.System(positions, cell=cell, bonds=bonds, **options)


def looked_at(observer, system, n=1, method=FREE):
    sim = md.Simulation(system, NONE, method)
    observer.prepare(sim.engine)
    for _ in range(n):
        observer.observe(sim.engine)
        sim.engine.count(observer.every)
    return observer.result()


def directions(*shape, seed=1):
    vectors = np.random.default_rng(seed).normal(size=(*shape, 3))
    return vectors / np.linalg.norm(vectors, axis=-1, keepdims=True)


def test_freely_jointed_chains_have_the_sizes_of_theory():
    """⟨R_ee²⟩ = (n − 1) b², ⟨R_g²⟩ = b² (n² − 1)/6n, within four standard errors of independent chains."""
    n_chains, n, b = 1500, 20, 1.5
    result = looked_at(md.observers.ChainShape(every=1), chains_of(b * directions(n_chains, n - 1), cell=90.0))
    exact = b**2 * np.array([(n**2 - 1) / (6.0 * n), n - 1])
    scatter = np.array([0.35, 0.85]) * exact / np.sqrt(n_chains)
    assert (np.abs(result.values[[0, 3]] - exact) < 4.0 * scatter).all()  # statistics
    assert 0.35 < result.anisotropy < 0.5


def test_the_sizes_of_rods_and_squares_are_exact():
    rods = np.repeat(1.2 * directions(30, 1), 9, axis=1)
    result = looked_at(md.observers.ChainShape(every=1), chains_of(rods))
    size = 1.2**2 * (10**2 - 1) / 12.0
    np.testing.assert_allclose(result.values, [size, size, 1.0, 81 * 1.44], rtol=1e-9)  # rounding
    square = np.array([[0.0, 0, 0], [2, 0, 0], [2, 2, 0], [0, 2, 0]]) + 3.0
    ring = md.System(square % 4.5, cell=[4.5] * 3, bonds=[[0, 1], [1, 2], [2, 3], [3, 0]], masses=2.0)
    values = looked_at(md.observers.ChainShape(every=1), ring).values
    np.testing.assert_allclose(values, [2.0, 0.5, 0.25], rtol=1e-12)


def test_each_kind_of_molecule_has_its_own_mean():
    """Two rods of A and B, of other masses, a star and a single atom, which has no shape."""
    rod = [[0.0, 0, 0], [1.0, 0, 0]]
    star = [[5.0, 5, 5], [6.0, 5, 5], [5.0, 6, 5], [5.0, 5, 6]]
    far = [[3.0, 3, 3], [7.0, 7, 7], [8.0, 7, 7]]
    system = md.System(
        np.array(rod + star + far),
        cell=20.0,
        species=[*"AB", *"CBBB", *"A", *"AB"],
        masses=[1.0, 3.0] + [1.0] * 5 + [1.0, 3.0],
        bonds=[[1, 0], [2, 3], [2, 4], [2, 5], [7, 8]],
    )
    result = looked_at(md.observers.ChainShape(every=1), system)
    np.testing.assert_allclose(result.values[:4], [3.0 / 16.0, 3.0 / 16.0, 1.0, 1.0])
    assert result.squared_radius_of_gyration_B3C == pytest.approx(3.0 / 4.0 - 3.0 / 16.0)
    assert [name for name in result.numbers() if name.startswith("squared_end_to_end")] == [
        "squared_end_to_end_AB",
        "squared_end_to_end_AB_error",
    ]
    assert "R_g² of 2 molecules AB = 0.1875" in str(result)


def infinite():
    return md.System([[0.0, 0, 0], [1.0, 0, 0], [2.0, 0, 0]], cell=3.0, bonds=[[0, 1], [1, 2], [2, 0]])


test_what_has_no_answer_is_refused = answered(
    (lambda: looked_at(md.observers.ChainShape(), md.System(np.eye(3), cell=9.0)), ValueError, "bonds", "3 atoms"),
    (lambda: looked_at(md.observers.ChainShape(), infinite()), ValueError, "image", "[1, 2]"),
)


class Stressed(md.observers.SurfaceTension):
    """One that sees constructed stresses, at constant volume."""

    def _values(self, engine):
        tensor = next(self.stresses)
        look = type("Look", (), {"stress": tensor})
        with pytest.MonkeyPatch.context() as patch:
            patch.setattr("minimd.observers.surface_tension.Look", lambda engine: look)
            return super()._values(engine)


@pytest.mark.parametrize(("axis", "n_surfaces"), [("a", 2), ("b", 1), ("c", 2)])
@pytest.mark.parametrize("units", [md.units.LJ, md.units.ASE])
def test_the_tension_of_constructed_stresses_is_exact(axis, n_surfaces, units):
    """Of any cell that is upright along the axis, in mN/m by the constants of the SI."""
    k = "abc".index(axis)
    turn = np.linalg.qr(np.random.default_rng(2).normal(size=(3, 3)))[0]
    cell = np.diag([4.0, 4.0, 4.0])
    cell[k, k] = 12.0
    cell[k - 2, k - 1] = 1.5  # the other two need not be perpendicular
    system = md.System(np.eye(3), cell=cell @ turn, masses=1.0, units=units)
    pressures = np.random.default_rng(3).normal(size=(40, 3, 3))
    looking = Stressed(axis=axis, n_surfaces=n_surfaces, every=1)
    looking.stresses = iter(-turn.T @ pressure @ turn for pressure in pressures)
    result = looked_at(looking, system, 40)
    normal = pressures[:, k, k]
    others = 0.5 * (np.trace(pressures, axis1=1, axis2=2) - normal)
    each = 12.0 / n_surfaces * (normal - others)
    assert (result.tension, result.normal_pressure) == pytest.approx((each.mean(), normal.mean()))
    assert 0.5 < result.tension_error / (each.std() / np.sqrt(40)) < 2.0
    if units is md.units.ASE:
        shown = float(str(result).split("γ = ")[1].split()[0])
        assert shown == pytest.approx(1.602176634e4 * each.mean(), rel=0.02)  # eV/Å² = 16.02 N/m, as it is rounded


def film(temperature, seed):
    """A film of 1152 atoms in a cell of three times its height."""
    positions, edges = md.lattice.crystal("fcc", [6, 6, 8], (4.0 / 0.8) ** (1.0 / 3.0))
    system = md.System(positions + np.array([0.0, 0.0, edges[2]]), cell=edges * [1.0, 1.0, 3.0])
    bath = md.StochasticVelocityRescaling.with_relaxation_time(0.005, temperature, 1.0, seed=seed)
    sim = md.Simulation(system, md.LennardJones(1.0, 1.0, 2.5, "shifted"), bath)
    sim.set_temperature(temperature, seed=seed)
    sim.run(10_000, every=10_000, progress=False)
    looking = md.observers.SurfaceTension(every=10)
    sim.run(60_000, every=60_000, progress=False, observers=[looking])
    return looking.result()


@pytest.mark.slow
@pytest.mark.parametrize("temperature", [0.72, 0.9])
def test_the_surface_tension_of_the_lennard_jones_liquid_is_the_published_one(temperature):
    """J. Vrabec, G. K. Kedia, G. Fuchs, H. Hasse, Mol. Phys. 104, 1509 (2006), eq. 15, of the same cutoff."""
    result = film(temperature, 3)
    published = 2.08 * (1.0 - temperature / 1.0779) ** 1.21
    assert 0.01 < result.tension_error < 0.08
    assert abs(result.tension - published) < 4.0 * result.tension_error  # statistics
    assert abs(result.normal_pressure) < 0.05


def tilted():
    return md.System(np.eye(3), cell=[[9.0, 0, 0], [0, 9, 0], [1, 0, 9]])


test_what_has_no_surface_is_refused = answered(
    (lambda: looked_at(md.observers.SurfaceTension(), tilted()), ValueError, "axis", "'c'", "83.66"),
    (
        lambda: looked_at(md.observers.SurfaceTension(), md.System(np.eye(3), cell=9.0, pbc=[1, 1, 0])),
        ValueError,
        "pbc",
    ),
    (lambda: md.observers.SurfaceTension(n_surfaces=0), ValueError, "n_surfaces", "0"),
)


@pytest.mark.parametrize(("times", "share"), [(10, (0.8, 1.0)), (300, (0.0, 0.1))])
def test_the_error_of_a_mean_over_few_correlation_times_is_a_lower_bound(times, share):
    """Of 50 runs of so many correlation times; constant quantities beside, with rounding, change nothing."""
    tau, n_runs, told = 4, 50, []
    series = processes(n_runs, times * tau, np.exp(-1.0 / tau), np.random.default_rng(times))
    for sizes in series.T:
        looking = md.observers.ChainShape()
        looking.scene, looking.sums = ObservedRun("LJ", ["A"], [2], 1.0, 6, 1.0, None), BlockedSums(9)
        for k, size in enumerate(sizes):
            values = np.array([5.0 + size, 0.1 + 1e-15 * (k % 3), 1.0, 2.0])
            looking.sums.total += [1.0, *values, *values**2]
            looking.sums.close_entry()
        told.append(
            "correlation times of the R_g² of 1 molecule A2 long: THE ERROR BARS ARE LOWER BOUNDS"
            in str(looking.result())
        )
    assert share[0] <= np.mean(told) <= share[1]


def test_the_picture_of_a_surface_names_its_quantity_and_has_the_times_of_the_run():
    film = md.System(np.random.default_rng(1).random((40, 3)) * [6.0, 6.0, 8.0], cell=[6.0, 6.0, 24.0])
    sim = md.Simulation(film, NONE, md.VelocityVerlet(0.1))
    sim.time = 50.0
    surface = md.observers.SurfaceTension(every=5)
    sim.run(160, observers=[surface], progress=False)
    panel = surface.result().plot().axes[0]
    assert panel.get_ylabel().startswith("γ, ")
    assert panel.get_title() == "surface tension, 33 frames, 50 to 66 τ"
    times = panel.lines[0].get_xdata()
    assert 50.0 < times[0] < times[-1] <= 66.0


def test_free_dipoles_have_the_dielectric_constant_of_theory():
    """ε = 1 + 4π k_e N μ²/3V k_B T of dipoles that point anywhere, at the temperature of the bath, in both units."""
    n_dipoles, n_looks, length, charge = 30, 500, 0.8, 0.7
    for units, bath in ((md.units.LJ, 1.3), (md.units.ASE, 300.0)):
        positions = np.repeat(np.random.default_rng(3).uniform(0.0, 12.0, (n_dipoles, 3)), 2, axis=0)
        bonds = np.arange(2 * n_dipoles).reshape(-1, 2)
        given = {"charges": np.resize([charge, -charge], 2 * n_dipoles), "masses": 1.0, "units": units}
        system = md.System(positions, cell=12.0, bonds=bonds, **given)
        sim = md.Simulation(system, NONE, md.LangevinBAOAB(1e-9, bath, 1.0, seed=1))
        looking = md.observers.DielectricConstant(every=1)
        looking.prepare(sim.engine)
        for arms in length * directions(n_looks, n_dipoles):
            sim.positions[1::2] = sim.positions[::2] + arms + 12.0 * np.rint(arms)  # in another image
            looking.observe(sim.engine)
            sim.engine.count(1)
        result = looking.result()
        thermal = units.k_B * bath
        strength = 4.0 * np.pi * units.coulomb * n_dipoles * (charge * length) ** 2 / (3.0 * 12.0**3 * thermal)
        error = strength * np.sqrt(2.0 / (3.0 * n_looks))
        assert abs(result.dielectric_constant - 1.0 - strength) < 4.0 * error  # statistics
        assert 0.7 < result.dielectric_constant_error / error < 2.0
        assert "LOWER BOUND" not in str(result)


@pytest.mark.parametrize("times", [50, *(pytest.param(n, marks=pytest.mark.slow) for n in (100, 400))])
def test_the_error_of_a_dielectric_constant_knows_the_correlations_of_the_dipole(times):
    """100 runs of so many correlation times: 0.85 to 1.3 of the scatter; a short run says what it lacks."""
    tau, n_runs = 4, 100
    scene = ObservedRun("LJ", ["A"], [2], 1.0, 6, 1.0, None)
    moments = processes(3 * n_runs, times * tau, np.exp(-1.0 / tau), np.random.default_rng(times))
    found, told = [], []
    for dipoles in moments.reshape(len(moments), n_runs, 3).swapaxes(0, 1):
        looking = md.observers.DielectricConstant()
        looking.scene, looking.sums = scene, BlockedSums(9)
        for dipole in dipoles:
            looking.sums.total += [1.0, 1.0, 4.0 * np.pi / 3.0, *dipole, *dipole**2]
            looking.sums.close_entry()
        result = looking.result()
        found.append((result.dielectric_constant, result.dielectric_constant_error))
        told.append("LOWER BOUND" in str(result))
    values, errors = np.array(found).T
    assert values.mean() == pytest.approx(4.0, abs=4.0 * values.std() / np.sqrt(n_runs))  # statistics
    assert (np.abs(values - 4.0) < 2.0 * errors).mean() >= 0.88
    assert 0.85 < np.sqrt((errors**2).mean()) / values.std() < 1.3
    assert np.mean(told) > 0.9 if times == 50 else np.mean(told) < 0.1 if times == 400 else True


def drude(seed, n=200, n_looks=4000, spacing=0.2, **options):
    """Ions whose velocities are independent processes of correlation e^(-t), T = 1.5, m = 2, in a volume of 1000."""
    velocities = processes(3 * n, n_looks, np.exp(-spacing), np.random.default_rng(seed)).reshape(n_looks, n, 3)
    charges = np.resize([1.0, -1.0], n)
    system = md.System(np.zeros((n, 3)), cell=10.0, charges=charges, masses=2.0)
    bath = md.LangevinBAOAB(spacing, 1.5, 1.0, seed=1)  # whose center of mass moves
    sim = md.Simulation(system, NONE, bath)
    looking = md.observers.Conductivity(every=1, **options)
    looking.prepare(sim.engine)
    for entry in np.sqrt(0.75) * velocities:
        sim.velocities[:] = entry
        looking.observe(sim.engine)
        sim.engine.count(1)
    return looking.result(), np.sqrt(0.75) * charges @ velocities


def test_the_conductivity_of_a_drude_gas_is_exact():
    """σ = n q²/(m γ V) = 0.1, C(t) = n q² T e^(-γt)/m; of 40 ions of 200, the part of each is that of all."""
    result, _ = drude(1)
    assert result.conductivity == pytest.approx(0.1, abs=4.0 * result.conductivity_error)  # statistics
    assert 0.0 < result.conductivity_error < 0.02
    assert result.nernst_einstein == pytest.approx(0.1, abs=4.0 * result.nernst_einstein_error)
    assert 0.0 < result.nernst_einstein_error < 0.002
    few, _ = drude(1, most_atoms=40)
    assert few.nernst_einstein == pytest.approx(0.1, abs=4.0 * few.nernst_einstein_error)
    assert few.nernst_einstein_error > 1.5 * result.nernst_einstein_error
    assert few.conductivity == result.conductivity
    early = result.times < 1.0
    expected = 150.0 * np.exp(-result.times[early])
    np.testing.assert_allclose(result.autocorrelation[early], expected, rtol=0.25)  # 4 errors of 800 correlation times


def test_the_conductivity_is_the_slope_of_the_charge_that_has_moved():
    """Einstein's formula, from the integral of the current, over the octave of the plateau."""
    result, currents = drude(2)
    moved = 0.2 * np.cumsum(0.5 * (currents[1:] + currents[:-1]), axis=0)
    start, end = np.rint(np.array(result.plateau.window) / 0.2).astype(int)
    squares = [np.square(moved[lag:] - moved[:-lag]).sum(axis=1).mean() for lag in (start, end)]
    slope = np.diff(squares)[0] / (0.2 * (end - start)) / (6.0 * 1000.0)
    assert result.conductivity == pytest.approx(slope / 1.5, rel=0.1)  # the ends of the series


def charged(charges, **options):
    return md.System(np.eye(3), cell=9.0, charges=charges, bonds=[[0, 1]], **options)


test_what_has_no_dipole_or_no_current_is_refused = answered(
    (lambda: looked_at(md.observers.DielectricConstant(), charged(None)), ValueError, "charges", "3 atoms"),
    (lambda: looked_at(md.observers.DielectricConstant(), charged([1, -1, 2.5])), ValueError, "net charge", "2.5"),
    (lambda: looked_at(md.observers.DielectricConstant(), charged([1, -1, 0], pbc=[1, 1, 0])), ValueError, "periodic"),
    (lambda: looked_at(md.observers.Conductivity(), charged(None)), ValueError, "ions", "3 atoms"),
    (lambda: looked_at(md.observers.Conductivity(), charged([1, -1, 0])), ValueError, "ions", "3 atoms"),
    (lambda: looked_at(md.observers.Conductivity(), charged([1, 0, 0], pbc=[1, 1, 0])), ValueError, "periodic"),
)
