"""Force fields read by OpenMM: its Reference platform finds the same energies and forces."""

from pathlib import Path

import numpy as np
import pytest
from wrong_calls import answered

import minimd as md

openmm = pytest.importorskip("openmm")
app = pytest.importorskip("openmm.app")

KJ = 1.0 / md.units.KJ_PER_MOL_PER_EV
CUBE, TRICLINIC = np.eye(3) * 2.2, np.array([[2.3, 0.0, 0.0], [0.6, 2.2, 0.0], [-0.7, 0.5, 2.4]])  # nm
METHODS = {"NoCutoff": 0, "CutoffNonPeriodic": 1, "CutoffPeriodic": 2, "Ewald": 3, "PME": 4, "LJPME": 5}
ELEMENTS = ("C", "N", "C", "O", "H", "H")
N_CHAINS, N = 12, len(ELEMENTS)
OTHERS = ("NonbondedForce", "CMMotionRemover")
TOLERANCE = {"Ewald": 1e-9, "PME": 3e-8}  # which makes the forces of OpenMM's PME right to 4e-7
SCENES = [
    ("NoCutoff", CUBE, {}), ("NoCutoff", CUBE, {"charged": False}), ("NoCutoff", CUBE, {"wells": False}),
    ("CutoffNonPeriodic", CUBE, {"switched": True}), ("CutoffPeriodic", CUBE, {"wells": False, "dielectric": 4.0}),
    ("CutoffPeriodic", TRICLINIC, {}), ("CutoffPeriodic", TRICLINIC, {"charged": False, "switched": True}),
    ("Ewald", CUBE, {"wells": False}), ("Ewald", CUBE, {"switched": True}), ("PME", TRICLINIC, {}),
]  # fmt: skip
DATA = Path(__file__).parents[1] / "data"
PROTEIN = Path(app.__file__).parent / "data" / "test.pdb"  # villin in water
DIPEPTIDE, GAFF = DATA / "alanine_dipeptide.pdb", DATA / "gaff_b2" / "b2.prmtop"


def reference(made, places):
    """Energy [eV] and forces (N, 3) [eV/Å] by OpenMM, as a function of the group of forces: each bonded one has one,
    from 0 on, then NonbondedForce.  places : (N, 3) [nm]."""
    for group, one in enumerate(sorted(made.getForces(), key=lambda one: one.getName() in OTHERS)):
        one.setForceGroup(group)
    context = openmm.Context(made, openmm.VerletIntegrator(0.001), openmm.Platform.getPlatformByName("Reference"))
    context.setPositions(places)

    def of_group(group=None):
        state = context.getState(getEnergy=True, getForces=True, groups=-1 if group is None else 1 << group)
        return KJ * plain(state.getPotentialEnergy()), 0.1 * KJ * plain(state.getForces(asNumpy=True))

    return of_group


def plain(quantity):
    return quantity.value_in_unit_system(openmm.unit.md_unit_system)


def assert_same(found, energy, forces, tolerance=1e-6):
    """Energies of atoms may cancel in the sum: the errors are compared with their sizes."""
    assert abs(found.potential_energy - energy) < tolerance * np.abs(found.energies).sum()
    assert np.abs(found.forces - forces).max() < tolerance * np.sqrt((forces**2).mean())


def chains(method="NoCutoff", box=CUBE, charged=True, wells=True, switched=False, tail=False, dielectric=78.3):
    """Twelve chains of six atoms, all that is taken: system, topology, positions.

    Exceptions have arbitrary parameters; one is between two chains. In a periodic box atoms are wrapped into it."""
    rng, made, topology = np.random.default_rng(5), openmm.System(), app.Topology()
    made.setDefaultPeriodicBoxVectors(*box)
    bonds, angles = openmm.HarmonicBondForce(), openmm.HarmonicAngleForce()
    torsions, polynomials, pairs = openmm.PeriodicTorsionForce(), openmm.RBTorsionForce(), openmm.NonbondedForce()
    places, chain = [], topology.addChain()
    for c in range(N_CHAINS):
        residue, first = topology.addResidue("MOL", chain), N * c
        start = np.array([c % 2, c // 2 % 2, c // 4]) @ (box / [[2], [2], [3]]) + 0.1
        k = np.arange(N)[:, None] * [[0.11, 0.0, 0.07]] + [[0.0, 0.07 * (k % 2), 0.05 * (k % 3)] for k in range(N)]
        places.append(start + k @ np.linalg.qr(rng.normal(size=(3, 3)))[0] + rng.normal(scale=0.01, size=(N, 3)))
        of_chain, charges = [], rng.normal(size=N) * charged
        for k, name in enumerate(ELEMENTS):
            element = app.Element.getBySymbol(name)
            of_chain.append(topology.addAtom(f"{name}{k}", element, residue))
            made.addParticle(element.mass)
            size = 0.0 if k == 4 else 0.2 + 0.01 * k  # a ghost
            pairs.addParticle(charges[k] - charges.mean(), size, 0.0 if k == 4 else wells * (0.3 + 0.1 * k))
        for k in range(N - 1):
            topology.addBond(*of_chain[k : k + 2])
            bonds.addBond(first + k, first + k + 1, 0.14 + 0.002 * c, 2e5 + 1e3 * k)
            pairs.addException(first + k, first + k + 1, 0.0, 1.0, 0.0)
        for k in range(N - 2):
            angles.addAngle(first + k, first + k + 1, first + k + 2, 1.9 + 0.01 * c, 400.0 + k)
            pairs.addException(first + k, first + k + 2, 0.1 * charged * (k == 1), 0.2, 0.0)
        for k in range(N - 3):
            quadruple = [first + k + d for d in range(4)]
            torsions.addTorsion(*quadruple, k + 1, 0.3 * c, 5.0 + k)
            polynomials.addTorsion(*quadruple, *rng.normal(size=6))
            pairs.addException(first + k, first + k + 3, charged * rng.normal(), 0.25, wells * rng.uniform())
    pairs.addException(2, 3 * N + 4, -0.7 * charged, 0.24, 1.0 * wells)
    pairs.setNonbondedMethod(METHODS[method])
    pairs.setCutoffDistance(0.9)
    pairs.setUseSwitchingFunction(switched)
    pairs.setSwitchingDistance(0.7)
    pairs.setUseDispersionCorrection(tail)
    pairs.setReactionFieldDielectric(dielectric)
    pairs.setEwaldErrorTolerance(TOLERANCE.get(method, 1e-5))
    forces, is_periodic = (bonds, angles, torsions, polynomials, pairs), METHODS[method] > 1
    for force in forces:
        made.addForce(force)
        if force is not pairs:
            force.setUsesPeriodicBoundaryConditions(is_periodic)
    pairs.setExceptionsUsePeriodicBoundaryConditions(is_periodic)
    where = np.concatenate(places)
    return made, topology, where - np.floor(where @ np.linalg.inv(box)) @ box if is_periodic else where


def nonbonded(made):
    return next(one for one in made.getForces() if isinstance(one, openmm.NonbondedForce))


def assert_agrees(made, topology, places):
    """Term by term, and of all.  Returns system and potentials."""
    (system, potentials, _), openmm_finds = md.from_openmm(made, topology, places), reference(made, places)
    n_bonded = nonbonded(made).getForceGroup()
    for group in range(n_bonded):
        assert_same(md.evaluate(system, potentials[group]), *openmm_finds(group), 1e-9)  # rounding
    assert_same(md.evaluate(system, potentials[n_bonded:]), *openmm_finds(n_bonded))
    assert_same(md.evaluate(system, potentials), *openmm_finds())
    return system, potentials


@pytest.mark.parametrize(("method", "box", "options"), SCENES)
def test_energies_and_forces_are_those_of_openmm(method, box, options):
    made, topology, places = chains(method, box, **options)
    system, potentials = assert_agrees(made, topology, places)
    if METHODS[method] > 1:
        apart = np.linalg.norm(places[system.bonds[:, 0]] - places[system.bonds[:, 1]], axis=1)
        assert (apart > 1.0).any()
    kinds = [type(one).__name__ for one in potentials[4:]]
    absent = "LennardJones" if not options.get("wells", True) else "Coulomb" if not options.get("charged", True) else ""
    assert kinds == [one for one in ("LennardJones", "Coulomb", "BondPotential") if one != absent]


@pytest.mark.parametrize("switched", [False, True])
def test_the_tail_is_that_of_openmm_up_to_its_mean_over_pairs(switched):
    """OpenMM counts pairs of one kind as n (n + 1)/2, of N (N + 1)/2 in all; minimd as n²/2 of N²/2."""
    given = {"method": "CutoffPeriodic", "charged": False, "switched": switched}
    (made, topology, places), other = chains(tail=True, **given), chains(tail=False, **given)
    system, potentials, _ = md.from_openmm(made, topology, places)
    (_, without, _), lj, n = md.from_openmm(*other), potentials[4], len(system)
    tail = md.evaluate(system, lj).potential_energy - md.evaluate(system, without[4]).potential_energy
    counts, names = np.bincount(system.species_index), system.species_names
    own = sum(lj.tail(row, names, system.volume)[0] for row in np.diag(np.sqrt(counts)))
    assert tail == pytest.approx(lj.tail(counts, names, system.volume)[0], rel=1e-9)
    openmms = reference(made, places)(4)[0] - reference(other[0], places)(4)[0]
    assert openmms == pytest.approx(n / (n + 1) * (tail + own), rel=1e-9)


def test_what_is_no_force_arrives_in_the_units_of_ase():
    made, topology, places = chains("PME", TRICLINIC)
    made.addForce(openmm.CMMotionRemover())
    made.addConstraint(1, 0, 0.11)
    made.addConstraint(3, 4, 0.12)
    in_angstrom = openmm.unit.Quantity(places * 10.0, openmm.unit.angstrom)
    system, potentials, constraints = md.from_openmm(made, topology, in_angstrom)
    assert system.positions == pytest.approx(10.0 * places, rel=1e-15)
    assert (system.units is md.units.ASE, system.cell.pbc.all(), potentials[5].accuracy) == (True, True, 3e-8)
    assert system.masses[:6] == pytest.approx([12.01078, 14.00672, 12.01078, 15.99943, 1.007947, 1.007947])
    assert system.cell.vectors == pytest.approx(10.0 * TRICLINIC)
    assert system.species[:7].tolist() == ["C1", "N", "C2", "O", "H1", "H2", "C1"]
    assert system.bonds.tolist() == [[6 * c + k, 6 * c + k + 1] for c in range(12) for k in range(5)]
    assert (system.constraints, constraints[0].pairs.tolist()) == (constraints, [[1, 0], [3, 4]])
    assert constraints[0].lengths == pytest.approx([1.1, 1.2])
    assert not md.from_openmm(*chains())[0].cell.pbc.any()
    assert md.from_openmm(*chains())[2] == ()


def read(file, **options):
    """A file with Amber's force field, or that with GAFF, without a tail: system, topology, positions [nm]."""
    if file == GAFF:
        model, made = app.AmberInpcrdFile(str(file.with_suffix(".inpcrd"))), app.AmberPrmtopFile(str(file))
        topology, made = made.topology, made.createSystem(nonbondedCutoff=0.9, **options)
    else:
        pdb, field = app.PDBFile(str(file)), app.ForceField("amber14-all.xml", "amber14/tip3p.xml")
        model = app.Modeller(pdb.topology, pdb.positions)
        if pdb.topology.getPeriodicBoxVectors() is None:
            model.addSolvent(field, padding=1.0)
        topology, made = model.topology, field.createSystem(model.topology, nonbondedCutoff=0.9, **options)
    nonbonded(made).setUseDispersionCorrection(False)
    return made, topology, plain(model.positions)


@pytest.mark.parametrize(("file", "method"), [(DIPEPTIDE, "PME"), (PROTEIN, "CutoffPeriodic"), (GAFF, "NoCutoff")])
def test_molecules_have_the_energies_and_the_forces_of_openmm(file, method):
    assert_agrees(*read(file, nonbondedMethod=getattr(app, method), ewaldErrorTolerance=1e-7))


@pytest.mark.slow
@pytest.mark.parametrize(("file", "method", "timestep"), [(DIPEPTIDE, "PME", 1.0), (GAFF, "NoCutoff", 0.5)])  # fs
def test_molecules_keep_their_energy_and_their_bonds(file, method, timestep):
    """For 10 ps: a straight line through the energies rises by less than they fluctuate."""
    options = {"nonbondedMethod": getattr(app, method), "ewaldErrorTolerance": 1e-6}
    made, topology, places = read(file, constraints=app.HBonds, **options)
    nonbonded(made).setUseSwitchingFunction(True)
    nonbonded(made).setSwitchingDistance(0.75)
    system, potentials, (bonds,) = md.from_openmm(made, topology, places)
    sim = md.Simulation(system, potentials, md.LangevinBAOAB(1.0 * md.units.fs, 300.0, 0.05 / md.units.fs, seed=3))
    sim.minimize()
    sim.run(3000, progress=False)
    sim = md.Simulation(sim.system, potentials, md.VelocityVerlet(timestep * md.units.fs))
    sim.velocities -= sim.drift
    record = sim.run(round(10_000 / timestep), every=10, progress=False)
    apart = sim.system.positions[bonds.pairs[:, 1]] - sim.system.positions[bonds.pairs[:, 0]]
    assert np.linalg.norm(apart, axis=1) == pytest.approx(bonds.lengths, rel=1e-11)  # rounding
    energies, exchanged = np.array(record.total_energy), np.std(record.kinetic_energy)
    assert exchanged > 0.05
    assert energies.std() < 4e-3 * exchanged  # measured: 2.5e-3 and 3.4e-3, 4.8 and 3.9 times with 2 Δt
    assert np.ptp(np.polyval(np.polyfit(record.time, energies, 1), record.time)) < 3e-3 * exchanged


def changed(change, method="NoCutoff"):
    """The chains, after something was done to their system."""
    made, *others = chains(method)
    change(made)
    return made, *others


def with_force(force):
    return changed(lambda made: made.addForce(force))


def add_offset(made):
    made.getForce(4).addGlobalParameter("lambda", 1.0)
    made.getForce(4).addParticleParameterOffset("lambda", 0, 0.1, 0.0, 0.0)


SITE = openmm.TwoParticleAverageSite(0, 1, 0.5, 0.5)
REFUSED = [  # arguments, error, what must be named
    (lambda: with_force(openmm.CustomBondForce("r")), ValueError, "'CustomBondForce'"),
    (lambda: with_force(openmm.MonteCarloBarostat(1.0, 300.0)), ValueError, "'MonteCarloBarostat'", "md.Simulation"),
    (lambda: with_force(openmm.AndersenThermostat(300.0, 1.0)), ValueError, "'AndersenThermostat'"),
    (lambda: with_force(openmm.GBSAOBCForce()), ValueError, "'GBSAOBCForce'"),
    (lambda: with_force(openmm.CMAPTorsionForce()), ValueError, "'CMAPTorsionForce'"),
    (lambda: with_force(openmm.NonbondedForce()), ValueError, "second NonbondedForce"),
    (lambda: chains("LJPME"), ValueError, "LJPME"),
    (lambda: changed(lambda made: made.setVirtualSite(5, SITE)), ValueError, "virtual sites", "particle 5"),
    (lambda: changed(add_offset), ValueError, "offsets"),
    (lambda: changed(lambda made: made.getForce(4).setIncludeDirectSpace(False), "PME"), ValueError, "direct space"),
    (lambda: (*chains()[:2], np.zeros((3, 3))), ValueError, "number of atoms", "72, 72 and 3"),
    (lambda: (app.Topology(), *chains()[1:]), TypeError, "openmm.System", "Topology"),
]
CALLS = [(lambda make=make: md.from_openmm(*make()), *wanted) for make, *wanted in REFUSED]
test_what_minimd_does_not_have_is_refused_by_name = answered(*CALLS)
