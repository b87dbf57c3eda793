"""Fields, walls and springs that are moved: forces are −∇u, images do not matter, work is what goes into the energy."""

import pickle

import numpy as np
import pytest
from references import numerical_forces

import minimd as md

RNG = np.random.default_rng(7)
PLACES = RNG.uniform(-1.0, 1.0, (6, 3))
CELLS = {
    "open": {"cell": None},
    "slab": {"cell": [[3.1, 0, 0], [0.9, 3.0, 0], [0, 0, 9.0]], "pbc": (True, True, False)},
    "tube": {"cell": [9.0, 9.0, 3.2], "pbc": (False, False, True)},
    "skewed": {"cell": [[3.6, 0, 0], [1.2, 3.5, 0], [-0.8, 0.7, 4.0]]},
}


def saddle(x, y, z, t, k):
    """Hills that move along z."""
    phase = z - 0.7 * t
    wave = np.sin(phase)
    return k * (x * x - y * y) + wave, -2.0 * k * x, 2.0 * k * y, -np.cos(phase), -0.7 * np.cos(phase)


FIELDS = {
    "constant force": (md.ConstantForce([0.3, -0.2, 0.5], [0, 2]), CELLS),
    "gravity": (md.Gravity(2.0), CELLS),
    "restraint": (md.Restraint([3.0, 0.0, 2.0], PLACES[:2] + 0.4, [1, 4]), CELLS),
    "steered": (md.SteeredSpring(3.0, [0.2, 0.3, 0.1], [0.4, 0, 0], [3]), CELLS),
    "wall 9-3": (md.Wall([0, 0, -1.6], [0, 0, 2.0], 1.3, 0.9, 2.0), ("open", "slab")),
    "wall 12-6": (md.Wall([0, 0, 1.7], [0, 0, -1.0], np.linspace(0.5, 1.0, 6), 0.8, 2.0, "12-6"), ("open", "slab")),
    "cylinder": (md.CylinderWall([0.1, 0.2, 0.3], [0, 0, 1], 1.8, 1.0, 0.7, 2.5, "12-6"), ("open", "tube")),
    "sphere": (md.SphereWall([0.1, 0.0, 0.0], 2.1, 1.0, 0.7), ("open", "skewed")),
    "user's": (md.Field(saddle, (0.8,)), ("open",)),
}
ROWS = [(name, cell) for name, (_, cells) in FIELDS.items() for cell in cells]


def atoms_in(cell, positions=PLACES):
    return md.System(positions, cell=CELLS[cell]["cell"], pbc=CELLS[cell].get("pbc"), masses=np.linspace(1.0, 2.0, 6))


@pytest.mark.parametrize(("name", "cell"), ROWS)
def test_force_is_minus_the_gradient_and_energies_are_those_of_atoms(name, cell):
    system, field = atoms_in(cell), FIELDS[name][0]
    found = md.evaluate(system, field)
    assert np.abs(found.forces).max() > 0.1
    assert found.forces == pytest.approx(numerical_forces(system, field), rel=1e-6, abs=1e-6)  # truncation
    assert found.energies.sum() == pytest.approx(found.potential_energy, rel=1e-13)
    assert not found.virial.any()  # it acts from outside


@pytest.mark.parametrize(("name", "cell"), [row for row in ROWS if row[0] not in ("gravity", "constant force")])
def test_images_feel_the_same(name, cell):
    system, field = atoms_in(cell), FIELDS[name][0]
    away = RNG.integers(-3, 4, (6, 3)) * system.cell.pbc
    moved = atoms_in(cell, PLACES + away @ system.cell.vectors)
    one, other = md.evaluate(system, field), md.evaluate(moved, field)
    assert other.forces == pytest.approx(one.forces, rel=1e-11, abs=1e-11)
    assert other.energies == pytest.approx(one.energies, rel=1e-11, abs=1e-11)


def test_walls_have_their_laws():
    """9-3: well √10/3 ε at d = (2/5)^(1/6) σ; 12-6: ε at 2^(1/6) σ; both are continuous at the cutoff."""
    for law, d, depth in (("9-3", 0.4 ** (1 / 6), 10.0**0.5 / 3.0), ("12-6", 2.0 ** (1 / 6), 1.0)):
        wall = md.Wall([0, 0, 1.0], [0, 0, 1], 2.0, 1.5, law=law)
        at_bottom = md.evaluate(md.System([[5.0, 6.0, 1.0 + 1.5 * d]]), wall)
        assert at_bottom.potential_energy == pytest.approx(-2.0 * depth, rel=1e-14)
        assert np.abs(at_bottom.forces).max() < 1e-14
        cut = md.Wall([0, 0, 1.0], [0, 0, 1], 2.0, 1.5, 3.0, law)
        energies = [md.evaluate(md.System([[0.0, 0.0, 4.0 + dz]]), cut).potential_energy for dz in (-1e-9, 1e-9)]
        assert energies == pytest.approx([0.0, 0.0], abs=1e-8)
        round_wall = md.SphereWall([0, 0, 0], 5.0, 2.0, 1.5, 3.0, law)
        assert md.evaluate(md.System([[0, 0, -3.7]]), round_wall).potential_energy == pytest.approx(
            md.evaluate(md.System([[0, 0, 2.3]]), cut).potential_energy, rel=1e-13
        )


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (
            lambda: md.evaluate(atoms_in("open"), md.Wall([0, 0, 0], [0, 0, 1])),
            r"in front of a Wall; atom \d lies .* behind it",
        ),
        (lambda: md.evaluate(atoms_in("open"), md.SphereWall([0, 0, 0], 0.5)), "in front of a SphereWall"),
        (
            lambda: md.evaluate(atoms_in("skewed"), FIELDS["wall 9-3"][0]),
            "must lie along all periodic directions; it crosses c",
        ),
        (lambda: md.Wall([0, 0, 0], [0, 0, 0]), "normal must not be zero"),
        (lambda: md.SteeredSpring(1.0, [0, 0, 0], [1, 0, 0], end=np.array([1.0, 2.0])), "end must be finite"),
        (lambda: md.Wall([0, 0, 0], [0, 0, 1], law="10-4"), "law must be one of '9-3', '12-6'"),
        (
            lambda: md.evaluate(atoms_in("open"), md.ConstantForce([0, 0, 1], [6])),
            "must be atoms 0 to 5; they name atom 6",
        ),
        (lambda: md.Restraint(-1.0, [0, 0, 0]), "k must be one number or three, finite and not negative"),
        (
            lambda: md.evaluate(atoms_in("open"), md.Restraint(1.0, PLACES[:2])),
            r"points must be three numbers or \(6, 3\)",
        ),
        (lambda: md.SteeredSpring(1.0, [0, 0, 0], [1, 0, 0], start=2.0, end=1.0), "end after start"),
    ],
)
def test_impossible_fields_are_refused(make, message):
    with pytest.raises(ValueError, match=message):
        make()


def test_fields_of_the_user_are_tried_before_they_are_trusted():
    def wrong_sign(x, y, z, t):
        return x * y, -y, x, 0.0

    def forgets_the_rate(x, y, z, t):
        return x * t, -t, 0.0, 0.0

    def three(x, y, z, t):
        return x, 1.0, 0.0

    system = atoms_in("open")
    with pytest.raises(ValueError, match=r"it returns [-\d.]+ where -∂u/∂y is"):
        md.evaluate(system, md.Field(wrong_sign))
    with pytest.raises(ValueError, match="must return ∂u/∂t as its fifth number"):
        md.evaluate(system, md.Field(forgets_the_rate))
    with pytest.raises(TypeError, match="it returns 3 numbers"):
        md.evaluate(system, md.Field(three))
    with pytest.raises(TypeError, match="must take x, y, z, t and 2 parameters"):
        md.evaluate(system, md.Field(saddle, (1.0, 2.0)))
    with pytest.raises(ValueError, match="fields that stay the same"):
        md.Simulation(system, FIELDS["user's"][0], md.VelocityVerlet(0.01), precision="fixed-point")
    with pytest.warns(UserWarning, match="periodic along a, but the field is not"):
        md.evaluate(atoms_in("skewed"), FIELDS["user's"][0])


MASS, K, V = 1.5, 6.0, np.array([0.8, 0.0, 0.0])
OMEGA = (K / MASS) ** 0.5


def pulled(method, **more):
    """One atom on a spring whose point leaves with a constant velocity: x = vt − (v/ω) sin ωt, W = m v² (1 − cos ωt)."""
    return md.Simulation(md.System([[0.0, 0.0, 0.0]], masses=MASS), md.SteeredSpring(K, [0, 0, 0], V, **more), method)


@pytest.mark.parametrize("size", [1e-300, 1.0, 1e300])
def test_normals_may_have_any_length(size):
    assert md.Wall([0, 0, 0], [3.0 * size, 0, -4.0 * size]).normal == pytest.approx([0.6, 0.0, -0.8])


@pytest.mark.parametrize("name", ["velocity-verlet", "position-verlet", "leapfrog", "suzuki-4", "pefrl"])
def test_methods_keep_their_order_in_time_dependent_fields(name):
    """Each force is evaluated at the time at which its kick stands, and the work with it."""
    method, errors, apart = md.integrators.METHODS[name], [], []
    for n in (40, 80):
        simulation = pulled(method(2.0 / n))
        record = simulation.run(n, every=n, progress=False)
        exact = V[0] * 2.0 - V[0] / OMEGA * np.sin(OMEGA * 2.0)
        errors.append(abs(simulation.positions[0, 0] - exact))
        apart.append(abs(record.work[-1] - MASS * V[0] ** 2 * (1.0 - np.cos(OMEGA * 2.0))))
        assert record.total_energy[-1] - record.work[-1] == pytest.approx(0.0, abs=2e-3)
    assert np.log2(errors[0] / errors[1]) == pytest.approx(method.order, abs=0.2)
    assert np.log2(apart[0] / apart[1]) == pytest.approx(method.order, abs=0.3)


@pytest.mark.parametrize(
    "method", [md.VelocityVerlet(0.03), md.PositionVerlet(0.03), md.LangevinBAOAB(0.03, 0.5, 1.0, seed=2)]
)
def test_work_and_time_survive_pauses_copies_and_files(method, tmp_path):
    def made():
        return pulled(method, start=0.2, end=1.1)

    whole, parts, file = made(), made(), tmp_path / "pulled.h5md"
    whole.run(60, every=20, progress=False)
    parts.run(13, every=5, progress=False)
    assert parts.potential_energy >= 0.0
    parts = pickle.loads(pickle.dumps(parts))
    parts.run(20, every=10, trajectory=file, progress=False)
    resumed = md.Simulation.resume(file, md.SteeredSpring(K, [0, 0, 0], V, start=0.2, end=1.1))
    resumed.run(until_step=60, every=9, trajectory=file, append=True, progress=False)
    assert resumed.positions.tolist() == whole.positions.tolist()
    assert resumed.velocities.tolist() == whole.velocities.tolist()
    assert resumed.work == whole.work != 0.0
    assert resumed.time == whole.time


def test_looking_changes_no_bit_of_the_work_though_it_evaluates_the_forces_again():
    """A bath at the end of a step leaves no energy there: it is evaluated at the same time, to the last bit, as the last kick."""
    bath = md.StochasticVelocityRescaling(0.003, temperature=1.0, relaxation_time=0.2, seed=2)
    seen, unseen = (
        md.Simulation(
            md.System(np.diag([0.01, 0.02, 0.03])), md.SteeredSpring(10.0, [0, 0, 0], [0.3, 0.2, 0], start=0.02), bath
        )
        for _ in "ab"
    )
    for simulation, every in ((seen, 1), (unseen, 60)):
        simulation.set_temperature(1.0, seed=1)
        simulation.run(60, every=every, progress=False)
    assert seen.work == unseen.work != 0.0


def test_the_report_judges_the_energy_minus_the_work(tmp_path):
    simulation = pulled(md.VelocityVerlet(0.02))
    record = simulation.run(4000, every=10, progress=False)
    assert np.ptp(record.total_energy) > 1.0
    told = str(simulation.report())
    assert "total energy minus work is conserved" in told
    assert "E - work" in told
    with pytest.raises(ValueError, match="time goes on while atoms return"):
        simulation.probe_reversibility(10)
    simulation.equilibrate(10, 1.0)
    assert (simulation.step, simulation.time, simulation.work) == (0, 0.0, 0.0)


def test_an_equilibration_comes_before_the_time_zero():
    """The spring that starts then has not moved before."""
    simulation = pulled(md.VelocityVerlet(0.02))
    simulation.set_temperature(1e-12, seed=1)
    simulation.equilibrate(30, 1e-12)
    assert simulation.time == 0.0
    assert np.abs(simulation.positions).max() < 1e-5  # the way of such an atom; its point moves 0.5 in as many steps


@pytest.mark.slow
def test_fields_that_stay_and_dihedrals_are_exact_in_fixed_point():
    from fixed_point_scenes import bits

    places = np.column_stack([np.cos(np.arange(6)), np.sin(np.arange(6)), 0.7 * np.arange(6)])
    system = md.System(
        places, bonds=[[k, k + 1] for k in range(5)], dihedrals=[[k, k + 1, k + 2, k + 3] for k in range(3)]
    )
    potentials = [
        md.HarmonicBond(50.0, 1.0),
        md.PeriodicDihedral(1.0, 3),
        md.Gravity(0.5),
        md.Wall([0, 0, -2.0], [0, 0, 1.0]),
    ]
    simulation = md.Simulation(system, potentials, md.VelocityVerlet(0.005), precision="fixed-point")
    simulation.set_temperature(1.0, seed=1)
    simulation.make_steps(0)
    start = bits(simulation)
    simulation.make_steps(300)
    simulation.run_back(300)
    assert bits(simulation) == start
    free = md.Simulation(system, potentials[:2], md.VelocityVerlet(0.005), precision="fixed-point")
    record = free.run(200, every=50, progress=False)
    assert (record.momentum == record.momentum[0]).all()
    with pytest.raises(ValueError, match="fields that stay the same"):
        md.Simulation(
            system, md.SteeredSpring(1.0, [0, 0, 0], [1, 0, 0], [0]), md.VelocityVerlet(0.005), precision="fixed-point"
        )
