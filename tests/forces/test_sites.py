"""Massless sites: forces that are gradients, energies of OpenMM, and runs that do not see them."""

from math import cos, radians, sin

import numpy as np
import pytest
from wrong_calls import answered

import minimd as md
from minimd.ase import system_from_file
from minimd.core.potentials.term import FORCES, TOTALS
from minimd.core.structure.system import changed
from minimd.lammps.model import AtomTypes
from minimd.mdanalysis import universe
from minimd.scene.water import water_of

FS = md.units.fs
TRICLINIC = [[7.0, 0.0, 0.0], [1.5, 6.5, 0.0], [-1.0, 0.8, 7.5]]


def cluster(kind, seed=1):
    """Eight molecules of three atoms, each with one site out of its plane, one of two atoms, or one of four parents;
    parents are in any images: system and potentials."""
    rng = np.random.default_rng(seed)
    centers = np.stack(np.meshgrid([0.5, 4.0], [0.5, 3.7], [0.5, 4.2], indexing="ij"), axis=-1).reshape(-1, 1, 3)
    atoms = centers + rng.uniform(-0.7, 0.7, (8, 3, 3)) + [[0, 0, 0], [1.0, 0, 0], [0, 1.1, 0]]
    images = rng.integers(-2, 3, (8, 3, 3)) @ np.array(TRICLINIC)
    parents = np.arange(24).reshape(8, 3)
    first, second, third = parents.T
    weights, out = [0.5, 0.3, 0.2], 0.0
    if kind == "out of plane":
        out = rng.uniform(0.2, 0.4, 8)
        weights = [0.7, 0.1, 0.2]
    elif kind == "two":
        parents, weights = parents[:, :2], [1.4, -0.4]
    elif kind == "four":
        parents, weights = parents[:, [0, 1, 2, 1]], rng.dirichlet(np.ones(4), 8)
    sites = np.arange(24, 32)
    positions = np.concatenate([(atoms + images).reshape(-1, 3), np.full((8, 3), 77.0)])
    system = md.System(
        positions,
        masses=1.0,
        cell=TRICLINIC,
        charges=[0.4, 0.3, 0.2] * 8 + [-0.9] * 8,
        species=["A", "A", "A"] * 8 + ["S"] * 8,
        bonds=np.concatenate([np.column_stack([first, end]) for end in (sites, second, third)]),
        sites=md.Sites(sites, parents, weights, out),
    )
    wells = {"A": (0.1, 1.5), "S": (0.2, 1.0)}
    lj = md.LennardJones(wells, cutoff=3.0, truncation="switched", bonded_scale=(0, 0, 1))
    charges = md.Coulomb(3.0, 1e-10, bonded_scale=(0, 0, 1))
    return system, [lj, charges, md.HarmonicBond(10.0, 1.2, np.column_stack([first, third]))]


KINDS = pytest.mark.parametrize("kind", ["mean", "out of plane", "two", "four"])


@KINDS
def test_force_is_minus_the_gradient_along_atoms(kind):
    system, potentials = cluster(kind)
    found = md.evaluate(system, potentials)
    assert not found.forces[24:].any()
    assert np.abs(found.forces.sum(axis=0)).max() < 1e-12 * np.abs(found.forces).max()
    forces, h = md.Forces(system, potentials), 1e-5
    here = system.positions.copy()
    for way in np.random.default_rng(2).normal(size=(3, *here.shape)):
        energies = []
        for step in (-h, h):
            system.positions[:] = here + step * way  # of sites, too: they come back
            energies.append(forces.compute(TOTALS).potential_energy)
        slope = (energies[0] - energies[1]) / (2.0 * h)
        assert slope == pytest.approx((found.forces[:24] * way[:24]).sum(), rel=1e-7)


@KINDS
def test_virial_is_the_slope_along_a_strain(kind):
    system, potentials = cluster(kind)
    found = md.evaluate(system, potentials)
    total = md.Forces(system, potentials).compute(TOTALS)
    assert found.virials.sum(axis=0)[:3] == pytest.approx(np.diag(found.virial), rel=1e-12)
    assert total.virial == pytest.approx(found.virial, abs=1e-10)
    here, h = system.positions.copy(), 1e-5
    for a, b in ((0, 0), (1, 1), (2, 2), (1, 2), (0, 2), (0, 1)):
        energies = []
        for step in (-h, h):
            strain = np.eye(3)
            strain[a, b] += 0.5 * step
            strain[b, a] += 0.5 * step
            strained = md.Cell.of(np.array(TRICLINIC) @ strain)
            moved = md.System(
                here @ strain, cell=strained, **{name: getattr(system, name) for name in (
                    "masses", "charges", "species", "bonds", "sites")}
            )  # fmt: skip
            energies.append(md.evaluate(moved, potentials).potential_energy)
        assert (energies[0] - energies[1]) / (2.0 * h) == pytest.approx(found.virial[a, b], rel=1e-5, abs=1e-6)


@KINDS
def test_lattice_vectors_change_nothing(kind):
    system, potentials = cluster(kind)
    found = md.evaluate(system, potentials)
    moved = system.copy()
    moved.positions[:] += np.random.default_rng(3).integers(-3, 4, (32, 3)) @ np.array(TRICLINIC)
    again = md.evaluate(moved, potentials)
    assert again.potential_energy == pytest.approx(found.potential_energy, rel=1e-10)
    assert again.forces == pytest.approx(found.forces, abs=1e-9)


def water(model="TIP4P/2005", n=64, timestep=2.0, method=md.VelocityVerlet, **options):
    system, potentials, rigid = md.water(model, n, cutoff=min(9.0, 0.45 * (n / 0.0333) ** (1 / 3)))
    sim = md.Simulation(system, potentials, method(timestep * FS), rigid, **options)
    sim.minimize(max_steps=60, progress=False)
    sim.set_temperature(298.0, seed=1)
    return sim


# lengths [nm], angle [degrees], charges of H [e], ε [kJ/mol] and σ [nm], distance of M [nm]: as papers have them
PUBLISHED = {
    "TIP4P": (0.09572, 104.52, 0.52, 4.184 * 610.0**2 / 2.4e6, 0.1 * (600e3 / 610.0) ** (1 / 6), 0.015),
    "TIP4P-Ew": (0.09572, 104.52, 0.52422, 0.680946, 0.316435, 0.0125),
    "TIP4P/2005": (0.09572, 104.52, 0.5564, 93.2 * 8.314462618e-3, 0.31589, 0.01546),
    "OPC": (0.08724, 103.6, 0.6791, 0.89036, 0.316655, 0.01594),
}


def of_openmm(model, n):
    """n molecules O, H, H, M of OpenMM: system, topology."""
    openmm = pytest.importorskip("openmm")
    from openmm import app, unit

    length, angle, charge, epsilon, sigma, offset = PUBLISHED[model]
    weight = offset / (2.0 * length * cos(radians(angle) / 2.0))
    made, topology, pairs = openmm.System(), app.Topology(), openmm.NonbondedForce()
    chain = topology.addChain()
    for m in range(n):
        residue = topology.addResidue("HOH", chain)
        for name, symbol, q in (("O", "O", 0.0), ("H1", "H", charge), ("H2", "H", charge), ("M", None, -2.0 * charge)):
            element = symbol and app.Element.getBySymbol(symbol)
            topology.addAtom(name, element, residue)
            made.addParticle(element.mass if element else 0.0 * unit.dalton)
            pairs.addParticle(q, sigma if name == "O" else 1.0, epsilon if name == "O" else 0.0)
        o, h, other, site = range(4 * m, 4 * m + 4)
        made.setVirtualSite(site, openmm.ThreeParticleAverageSite(o, h, other, 1.0 - 2.0 * weight, weight, weight))
        for i, j in ((o, h), (o, other), (o, site), (h, other), (h, site), (other, site)):
            pairs.addException(i, j, 0.0, 1.0, 0.0)
        for i, j, d in ((o, h, length), (o, other, length), (h, other, 2.0 * length * sin(radians(angle) / 2.0))):
            made.addConstraint(i, j, d)
    made.addForce(pairs)
    return made, topology, pairs


@pytest.mark.parametrize("model", PUBLISHED)
def test_water_has_the_energies_and_forces_of_openmm(model):
    """216 molecules, of OpenMM's Reference with the numbers of the papers; by name, and from OpenMM."""
    n = 216
    made, topology, pairs = of_openmm(model, n)
    openmm = pytest.importorskip("openmm")
    system, potentials, rigid = md.water(model, n, cutoff=8.0, accuracy=1e-8)
    order = np.column_stack([np.arange(3 * n).reshape(n, 3), np.arange(3 * n, 4 * n)]).ravel()
    edge = 0.1 * system.cell.vectors[0, 0]
    made.setDefaultPeriodicBoxVectors(*(edge * np.eye(3)))
    pairs.setNonbondedMethod(pairs.PME)
    pairs.setCutoffDistance(0.8)
    pairs.setEwaldErrorTolerance(3e-8)
    pairs.setUseSwitchingFunction(True)
    pairs.setSwitchingDistance(0.72)
    pairs.setUseDispersionCorrection(False)
    places = 0.1 * system.positions[order]
    context = openmm.Context(made, openmm.VerletIntegrator(0.001), openmm.Platform.getPlatformByName("Reference"))
    context.setPositions(places)
    context.computeVirtualSites()
    state = context.getState(getEnergy=True, getForces=True, getPositions=True)
    to_ev = 1.0 / md.units.KJ_PER_MOL_PER_EV
    energy = to_ev * state.getPotentialEnergy()._value
    forces = 0.1 * to_ev * state.getForces(asNumpy=True)._value
    assert 10.0 * state.getPositions(asNumpy=True)._value == pytest.approx(system.positions[order], abs=1e-6)

    tail = potentials[0].tail(np.bincount(system.species_index), system.species_names, system.volume)[0]
    taken, laws, (held,) = md.from_openmm(made, topology, places)
    is_atom = np.arange(4 * n) % 4 < 3
    for found, own, without in (
        (md.evaluate(system, potentials), order, tail),
        (md.evaluate(taken, laws), np.arange(4 * n), 0.0),
    ):
        scale = np.sqrt((forces**2).mean())
        assert found.potential_energy - without == pytest.approx(energy, rel=1e-6)
        assert np.abs(found.forces[own] - forces)[is_atom].max() < 1e-6 * scale
    assert np.sort(held.lengths) == pytest.approx(np.sort(rigid.lengths), rel=1e-6)


def test_water_of_a_file_gets_its_sites_behind_all_atoms():
    """In any order of atoms; with their names, and atoms that are fixed."""
    system = md.water("SPC/E", 27, cutoff=4.0)[0]
    order = np.random.default_rng(5).permutation(81)
    mixed = md.System(
        system.positions[order],
        masses=1.0,
        species=system.species[order],
        cell=system.cell,
        units=md.units.ASE,
        constraints=[md.FixedAtoms([0, 5])],
        topology=np.array([[f"A{k}", "", "HOH", str(k), "W"] for k in range(81)]),
    )
    made, potentials, rigid = water_of(mixed, "OPC", cutoff=4.0)
    parents = made.sites.parents
    assert made.species.tolist() == [*mixed.species, *27 * ["M"]]
    assert made.topology[81:].tolist() == [["M", "", "HOH", str(k), "W"] for k in parents[:, 0]]
    assert set(order[parents[3]]) == set(3 * (order[parents[3, 0]] // 3) + np.arange(3))
    sim = md.Simulation(made, potentials, md.VelocityVerlet(0.5 * FS), [rigid, *made.constraints])
    start = sim.positions.copy()
    with pytest.warns(UserWarning, match="projected"):
        sim.run(5)
    assert np.array_equal(sim.positions[[0, 5]], start[[0, 5]])
    oxygen = sim.positions[parents[:, 0]]
    assert np.linalg.norm(sim.positions[81:] - oxygen, axis=1) == pytest.approx(np.full(27, 0.1594), rel=1e-9)


@pytest.mark.parametrize("kind", ["two", "mean", "out of plane"])
def test_virtual_sites_of_openmm_have_its_forces(kind):
    openmm = pytest.importorskip("openmm")
    from openmm import app

    system, _ = cluster(kind)
    sites, rng = system.sites, np.random.default_rng(4)
    made, topology, pairs = openmm.System(), app.Topology(), openmm.NonbondedForce()
    residue = topology.addResidue("MOL", topology.addChain())
    for k in range(32):
        element = app.Element.getBySymbol("C") if k < 24 else None
        topology.addAtom(f"A{k}", element, residue)
        made.addParticle(12.0 if k < 24 else 0.0)
        pairs.addParticle(rng.normal(), 0.2, 0.5)
    rows = zip(sites.parents.tolist(), sites.weights, sites.out_of_plane, strict=True)
    for k, (parents, weights, out) in enumerate(rows):
        site = openmm.TwoParticleAverageSite(*parents, *weights) if kind == "two" else None
        if kind == "mean":
            site = openmm.ThreeParticleAverageSite(*parents, *weights)
        elif kind == "out of plane":
            site = openmm.OutOfPlaneSite(*parents, *weights[1:], 10.0 * out)
        made.setVirtualSite(24 + k, site)
        for parent in parents:
            pairs.addException(parent, 24 + k, 0.0, 1.0, 0.0)
    made.addForce(pairs)
    whole = 0.1 * system.positions
    context = openmm.Context(made, openmm.VerletIntegrator(0.001), openmm.Platform.getPlatformByName("Reference"))
    context.setPositions(whole)
    context.computeVirtualSites()
    state = context.getState(getEnergy=True, getForces=True, getPositions=True)
    taken, laws, _ = md.from_openmm(made, topology, whole)
    found, to_ev = md.evaluate(taken, laws), 1.0 / md.units.KJ_PER_MOL_PER_EV
    assert taken.positions == pytest.approx(10.0 * state.getPositions(asNumpy=True)._value, rel=1e-9)
    assert found.potential_energy == pytest.approx(to_ev * state.getPotentialEnergy()._value, rel=1e-7)
    forces = 0.1 * to_ev * state.getForces(asNumpy=True)._value[:24]
    assert found.forces[:24] == pytest.approx(forces, abs=1e-7 * np.abs(forces).max())


@pytest.mark.parametrize("method", [md.VelocityVerlet, md.PositionVerlet])
def test_water_keeps_its_energy_momentum_and_sites(method):
    sim = water(method=method)
    system, sites = sim.system, sim.system.sites
    assert sim.n_dof == 6 * 64 - 3
    assert sim.temperature == pytest.approx(298.0, rel=1e-12)
    sim.run(200)
    record = sim.run(400, every=20)
    sim.engine.advance(3)  # which nobody looks at
    here, momentum = system.positions[sites.parents], np.abs(record.momentum).max()
    assert system.positions[sites.atoms] == pytest.approx(np.einsum("sp,spc->sc", sites.weights, here), abs=1e-12)
    assert not system.velocities[sites.atoms].any()
    assert np.ptp(record.total_energy) / len(system) < 5e-5
    assert np.ptp(record.potential_energy) / len(system) > 1e-3  # work is done
    assert momentum < 1e-12 * np.abs(system.masses[:, None] * system.velocities).sum()


@pytest.mark.parametrize("method", [md.VelocityVerlet, md.PositionVerlet])
def test_a_resumed_run_and_threads_have_the_same_bits(method, tmp_path):
    one = water(method=method, threads=1)
    start = one.system.copy()
    one.run(40)
    for threads in (1, 2):
        path = tmp_path / f"{threads}.h5md"
        other = md.Simulation(start, one.potentials, one.method, one.constraints, threads=threads)
        other.run(17, every=17, trajectory=path)
        other = md.Simulation.resume(path, one.potentials, threads=threads)
        assert other.system.sites == start.sites
        other.run(23, every=23, trajectory=path, append=True)
        for name in ("positions", "velocities"):
            assert np.array_equal(getattr(other, name), getattr(one, name))


def test_mdanalysis_finds_sites_without_mass_in_their_places(tmp_path):
    """And so does whoever begins with the last frame."""
    sim = water()
    sim.run(20, every=10, trajectory=tmp_path / "water.h5md")
    atoms = universe(tmp_path / "water.h5md")
    sites = atoms.select_atoms("type M")
    assert (len(sites), sites.masses.any(), atoms.atoms.n_residues) == (64, False, 64)
    last = system_from_file(tmp_path / "water.h5md")
    assert (last.sites, np.array_equal(last.positions, sim.positions)) == (sim.system.sites, True)
    for frame in atoms.trajectory:
        places = frame.positions[sim.system.sites.parents]
        mean = np.einsum("sp,spc->sc", sim.system.sites.weights, places)
        assert sites.positions == pytest.approx(mean, abs=1e-5)  # float32


def test_pressure_of_rigid_water_is_conserved_with_a_barostat():
    """The reservoir counts the energy; molecules with their sites are strained as bodies."""
    sim = water(timestep=1.0)
    bath = md.LangevinBAOAB(1.0 * FS, 298.0, 0.01 / FS, seed=3)
    barostat = md.StochasticCellRescaling(md.units.BAR, 4.6e-5 / md.units.BAR, 500 * FS, seed=4, every=10)
    sim = md.Simulation(sim.system, sim.potentials, bath, sim.constraints, barostat=barostat)
    record = sim.run(300, every=20)
    assert np.ptp(record.volume) > 1.0
    assert np.ptp(record.conserved_energy) / len(sim.system) < 3e-4
    sites = sim.system.sites
    mean = np.einsum("sp,spc->sc", sites.weights, sim.system.positions[sites.parents])
    assert sim.system.positions[sites.atoms] == pytest.approx(mean, abs=1e-11)


def test_a_system_without_sites_has_no_operation_for_them():
    system, potentials = cluster("mean")
    plain = md.System(system.positions, cell=TRICLINIC, species=system.species, bonds=system.bonds)
    system = changed(plain, masses=1.0, sites=system.sites)
    numbers = []
    for each in (plain, system):
        forces = md.Forces(each, potentials[0])
        forces.compute()
        numbers.append(len([*forces.operations(forces.target(FORCES))]))
    assert numbers[1] - numbers[0] == 2


def held(*constraints):
    system, potentials = cluster("mean")
    return md.Simulation(system, potentials, md.VelocityVerlet(0.001), constraints)


test_senseless_sites_are_refused_by_name = answered(
    (lambda: md.Sites([3], [[0]], [[1.0]]), ValueError, "two parents", "1"),
    (lambda: md.Sites([3], [[0, 1]], [0.5, 0.5], 0.1), ValueError, "three", "2"),
    (lambda: md.Sites([3], [[0, 1]], [0.5, 0.6]), ValueError, "weights", "0.6"),
    (lambda: md.Sites([3, 3], [[0, 1], [0, 1]], [0.5, 0.5]), ValueError, "sites[1]", "3"),
    (lambda: md.Sites([3], [[0, 3]], [0.5, 0.5]), ValueError, "parents", "3"),
    (lambda: md.Sites([3], [[0, -1]], [0.5, 0.5]), ValueError, "parents", "-1"),
    (lambda: md.Sites([3], [0, 1], [0.5, 0.5]), ValueError, "(S, P)", "(2,)"),
    (lambda: md.Sites([3], [[0, 1]], [0.5]), ValueError, "weights", "(1,)"),
    (lambda: md.System(np.eye(3), sites=md.Sites([3], [[0, 1]], [0.5, 0.5])), ValueError, "atom 3", "0 to 2"),
    (lambda: md.System(np.eye(3), masses=[1, 1, 1], sites=md.Sites([2], [[0, 1]], [0.5, 0.5])), ValueError, "1.0"),
    (lambda: md.System(np.eye(3), masses=[1, 1, 0]), ValueError, "masses[2]", "0.0"),
    (lambda: md.System(np.eye(3), sites=[2]), TypeError, "sites", "[2]"),
    (lambda: held(md.FixedAtoms([0, 30])), ValueError, "atom 30", "FixedAtoms"),
    (lambda: held(md.DistanceConstraints([[0, 1], [0, 25]])), ValueError, "atom 25", "DistanceConstraints"),
    (lambda: cluster("mean")[0].write("never.data"), ValueError, "Sites(8"),
    (lambda: AtomTypes.of(held().engine), ValueError, "LAMMPS", "Sites(8"),
    (
        lambda: md.Simulation(*cluster("mean"), md.VelocityVerlet(0.01), precision="fixed-point"),
        ValueError,
        "fixed-point",
        "sites",
    ),
)


@pytest.mark.slow
def test_density_of_tip4p_2005_at_1_bar():
    """216 molecules at 298 K and 1 bar: 0.9979 g/cm³ of J. L. F. Abascal, C. Vega (2005), table II."""
    sim = water(n=216, timestep=2.0)
    bath = md.LangevinBAOAB(2.0 * FS, 298.0, 0.002 / FS, seed=3)
    barostat = md.StochasticCellRescaling(md.units.BAR, 4.6e-5 / md.units.BAR, 1000 * FS, seed=4, every=20)
    sim = md.Simulation(sim.system, sim.potentials, bath, sim.constraints, barostat=barostat)
    sim.run(25_000)
    record = sim.run(125_000, every=50)
    density, error = md.mean_and_error(sim.system.masses.sum() / record.volume / md.units.GRAM_PER_CM3)
    assert error < 0.004
    assert density == pytest.approx(0.9979, abs=4.0 * error)  # statistics
