"""Force fields read by OpenMM: its Reference platform finds the same energies and forces."""

from copy import deepcopy
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
    context.computeVirtualSites()

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


def read(file, water="amber14/tip3p", protein="amber14-all", **options):
    """A file with a force field, or that with GAFF, without a tail: system, topology, positions [nm]."""
    if file == GAFF:
        model, made = app.AmberInpcrdFile(str(file.with_suffix(".inpcrd"))), app.AmberPrmtopFile(str(file))
        topology, made = made.topology, made.createSystem(nonbondedCutoff=0.9, **options)
    else:
        pdb, field = app.PDBFile(str(file)), app.ForceField(f"{protein}.xml", f"{water}.xml")
        model = app.Modeller(pdb.topology, pdb.positions)
        if pdb.topology.getPeriodicBoxVectors() is None:
            has_sites = water.endswith(("opc", "tip4pew"))
            model.addSolvent(field, "tip4pew" if has_sites else "tip3p", padding=1.0)
        topology, made = model.topology, field.createSystem(model.topology, nonbondedCutoff=0.9, **options)
    without_tail(made)
    return made, topology, plain(model.positions)


def without_tail(made):
    for force in made.getForces():
        if isinstance(force, openmm.NonbondedForce):
            force.setUseDispersionCorrection(False)
        elif isinstance(force, openmm.CustomNonbondedForce):
            force.setUseLongRangeCorrection(False)


@pytest.mark.parametrize(("file", "method"), [(DIPEPTIDE, "PME"), (PROTEIN, "CutoffPeriodic"), (GAFF, "NoCutoff")])
def test_molecules_have_the_energies_and_the_forces_of_openmm(file, method):
    assert_agrees(*read(file, nonbondedMethod=getattr(app, method), ewaldErrorTolerance=1e-7))


WATERS = [  # with Amber's proteins, those with maps of ff19SB, and CHARMM's, with maps and tables of wells
    ("amber14/opc", "amber14-all"), ("amber14/tip4pew", "amber14-all"), ("amber19/opc", "amber19/protein.ff19SB"),
    pytest.param("charmm36_2024/water", "charmm36_2024", marks=pytest.mark.slow),
]  # fmt: skip


@pytest.mark.parametrize(("water", "protein"), WATERS)
def test_a_dipeptide_in_water_has_the_forces_of_openmm(water, protein):
    """On atoms: OpenMM leaves forces on sites where they are, besides handing them over."""
    made, topology, places = read(DIPEPTIDE, water, protein, nonbondedMethod=app.PME, ewaldErrorTolerance=1e-7)
    system, potentials, _ = md.from_openmm(made, topology, places)
    found, (energy, forces) = md.evaluate(system, potentials), reference(made, places)()
    if system.sites is not None:
        forces[system.sites.atoms] = 0.0
    assert_same(found, energy, forces)
    assert found.potential_energy == pytest.approx(energy, rel=1e-6)
    kinds = [type(potential) for potential in potentials]
    assert (md.DihedralMap in kinds) == (protein != "amber14-all")


def villin(field):
    """The protein in vacuum: system, topology, positions [nm]."""
    pdb = app.PDBFile(str(PROTEIN))
    model = app.Modeller(pdb.topology, pdb.positions)
    model.delete([residue for residue in pdb.topology.residues() if residue.name in ("HOH", "Cl")])
    return app.ForceField(f"{field}.xml").createSystem(model.topology), model.topology, plain(model.positions)


@pytest.mark.parametrize("field", ["amber19-all", "charmm36", pytest.param("charmm36_2024", marks=pytest.mark.slow)])
def test_a_protein_with_maps_has_the_energies_and_forces_of_openmm(field):
    """The maps alone, and all."""
    made, topology, places = villin(field)
    (system, potentials, _), openmm_finds = md.from_openmm(made, topology, places), reference(made, places)
    assert_same(md.evaluate(system, potentials), *openmm_finds())
    [maps] = [potential for potential in potentials if isinstance(potential, md.DihedralMap)]
    [force] = [force for force in made.getForces() if isinstance(force, openmm.CMAPTorsionForce)]
    assert len(maps.phi) == force.getNumTorsions() == 33
    assert_same(md.evaluate(system, maps), *openmm_finds(force.getForceGroup()), 1e-11)  # rounding
    [lj] = [potential for potential in potentials if isinstance(potential, md.LennardJones)]
    n_pairs = 0 if lj.pairs is None else len(lj.pairs)
    assert (n_pairs, len(lj.parameters)) == {"amber19-all": (0, 14), "charmm36": (0, 24), "charmm36_2024": (1, 26)}[
        field
    ]


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


@pytest.mark.slow
@pytest.mark.parametrize("field", ["amber19-all", "charmm36"])
def test_a_protein_with_maps_keeps_its_energy(field):
    """For 2 ps, without constraints."""
    system, potentials, _ = md.from_openmm(*villin(field))
    sim = md.Simulation(system, potentials, md.LangevinBAOAB(0.5 * md.units.fs, 300.0, 0.05 / md.units.fs, seed=3))
    sim.minimize()
    sim.run(2000, progress=False)
    sim = md.Simulation(sim.system, potentials, md.VelocityVerlet(0.5 * md.units.fs))
    sim.velocities -= sim.drift
    record = sim.run(4000, every=10, progress=False)
    energies, exchanged = np.array(record.total_energy), np.std(record.kinetic_energy)
    assert energies.std() < 0.012 * exchanged  # measured: 8.2e-3 and 8.3e-3, 4.2 times with 2 Δt
    assert np.ptp(np.polyval(np.polyfit(record.time, energies, 1), record.time)) < 5e-3 * exchanged


def of_argon(n, spacing=0.4, elements="Ar", ids=None):
    """n atoms of argon along a wave, each a residue: system, topology, positions [nm]; the system has no force yet."""
    made, topology = openmm.System(), app.Topology()
    chain = topology.addChain("B")
    for k in range(n):
        residue = topology.addResidue("GAS", chain, None if ids is None else ids[k])
        topology.addAtom(f"A{k}", app.Element.getBySymbol(elements) if elements else None, residue)
        made.addParticle(39.948)
    k = np.arange(n)[:, None]
    return made, topology, spacing * np.hstack([0.8 * k, 0.5 * np.sin(2.1 * k), 0.4 * np.cos(1.3 * k)])


def assert_one_force_agrees(made, topology, places, tolerance=1e-9):
    """Of a system with forces of one kind.  Returns the potentials."""
    system, potentials, _ = md.from_openmm(made, topology, places)
    assert_same(md.evaluate(system, potentials), *reference(made, places)(), tolerance)
    return potentials


@pytest.mark.parametrize(
    "force",
    [
        openmm.CMAPTorsionForce(), openmm.CustomTorsionForce("k*theta^3"), openmm.CustomBondForce("r^5"),
        openmm.CustomExternalForce("x"), openmm.CustomHbondForce("distance(d1,a1)"), openmm.GBSAOBCForce(),
        openmm.CustomCentroidBondForce(2, "distance(g1,g2)"), openmm.CustomNonbondedForce("1/r"),
    ],
    ids=lambda force: type(force).__name__,
)  # fmt: skip
def test_a_force_without_terms_is_left_out(force):
    made, topology, places = chains()
    found = md.evaluate(*md.from_openmm(made, topology, places)[:2])
    made.addForce(force)
    system, potentials, _ = md.from_openmm(made, topology, places)
    assert md.evaluate(system, potentials).potential_energy == found.potential_energy


PI = f"pi = {np.pi:.15g}"
TURNED = f"thetap = step(-(theta-theta0+pi))*2*pi+theta+step(theta-theta0-pi)*(-2*pi); {PI}"
TORUS = f"d = theta - phi0; {PI}"
IMPROPERS = [  # as files of CHARMM, DMS; CharmmPsfFile; AmberPrmtopFile; GromacsTopFile; ParmEd write it
    ("k*(theta-theta0)^2", ("k", "theta0"), 1.0),
    ("0.5*kappa * (theta - t)^2", ("t", "kappa"), 0.5),
    ("k*min(dtheta, 2*pi-dtheta)^2; dtheta = abs(theta-theta0);pi = 3.141593;", ("k", "theta0"), 1.0),
    (f"k*min(dtheta, 2*{np.pi}-dtheta)^2; dtheta = abs(theta-theta0)", ("theta0", "k"), 1.0),
    ("0.5*k*min(dtheta, 2*pi-dtheta)^2; dtheta = abs(theta-theta0); pi = 3.1415926535", ("k", "theta0"), 0.5),
    (f"0.5*k*(thetap-theta0)^2; {TURNED}", ("theta0", "k"), 0.5),
    (f"kf*torus^2; torus = d - floor(d/(2*pi)+0.5)*(2*pi); {TORUS}", ("kf", "phi0"), 1.0),
]


@pytest.mark.parametrize(("energy", "names", "factor"), IMPROPERS)
def test_custom_torsions_of_harmonic_impropers_have_the_energies_and_forces_of_openmm(energy, names, factor):
    """Angles are all around the circle, also a millionth of π from ±π, and rest angles too where OpenMM has no jump."""
    turns = np.pi * np.array([-1.0 + 1e-6, -0.9, -0.5, -0.1, 0.2, 0.6, 0.95, 1.0 - 1e-6])
    rests = [0.0] if energy in ("k*(theta-theta0)^2", "0.5*kappa * (theta - t)^2") else [0.0, 0.6, -2.5, np.pi, -np.pi]
    scenes = [(turn, rest) for turn in turns for rest in rests if abs(abs(turn - rest) - np.pi) > 1e-5]
    made, topology, _ = of_argon(4 * len(scenes))
    force, places = openmm.CustomTorsionForce(energy), []
    for name in names:
        force.addPerTorsionParameter(name)
    for s, (turn, rest) in enumerate(scenes):
        last = [0.15 + 0.1 * np.cos(turn), 0.1 * np.sin(turn), 0.17]
        places += [np.add(at, [s, 0, 0]) for at in ([0.27, 0, 0.02], [0.15, 0, 0], [0.15, 0, 0.14], last)]
        stiffness = {"k": 40.0 + s, "kappa": 40.0 + s, "kf": 40.0 + s}
        force.addTorsion(*range(4 * s, 4 * s + 4), [stiffness.get(name, rest) for name in names])
    made.addForce(force)
    [improper] = assert_one_force_agrees(made, topology, np.array(places), 1e-5 if "3.141593" in energy else 1e-9)
    assert type(improper) is md.HarmonicImproper
    assert improper.k == pytest.approx(2.0 * factor * KJ * (40.0 + np.arange(len(scenes))))


def test_maps_of_two_dihedrals_have_the_energies_and_forces_of_openmm():
    """Of neighbors, which share atoms, and of others."""
    made, topology, places = of_argon(40)
    force, rng = openmm.CMAPTorsionForce(), np.random.default_rng(8)
    for _ in range(3):
        force.addMap(7, rng.normal(size=49))
    for k in range(33):
        force.addTorsion(k % 3, *range(k, k + 4), *range(k + 1, k + 5))
        force.addTorsion(2, *range(k, k + 4), *range(39, 35, -1))
    made.addForce(force)
    [maps] = assert_one_force_agrees(made, topology, places)
    assert type(maps) is md.DihedralMap


def test_a_jump_of_openmms_impropers_is_told():
    made, topology, places = of_argon(4)
    force = openmm.CustomTorsionForce("k*(theta-theta0)^2")
    force.addPerTorsionParameter("k")
    force.addPerTorsionParameter("theta0")
    force.addTorsion(0, 1, 2, 3, [50.0, 3.0])
    made.addForce(force)
    with pytest.warns(UserWarning, match="theta = pi"):
        md.from_openmm(made, topology, places)


GEOMETRIC = {  # as tutorials for OPLS, readers of DMS files and of GROMACS files write it; parameters by ε and σ
    "4*epsilon*((sigma/r)^12-(sigma/r)^6); sigma=sqrt(sigma1*sigma2); epsilon=sqrt(epsilon1*epsilon2)":
        lambda well, size: {"sigma": size, "epsilon": well},
    "4.0*eps12*((sig12/r)^12 - (sig12/r)^6); sig12=sqrt(sig1*sig2); eps12=sqrt(eps1*eps2)":
        lambda well, size: {"eps": well, "sig": size},
    "A1*A2/r^12-C1*C2/r^6":
        lambda well, size: {"C": np.sqrt(4 * well * size**6), "A": np.sqrt(4 * well * size**12)},
}  # fmt: skip


def opls(energy, method="CutoffPeriodic", switched=False, tail=False):
    """The chains, with wells that mix geometrically beside the charges: system, topology, positions."""
    made, topology, places = chains(method, wells=False, charged=not tail)
    wells, parameters = openmm.CustomNonbondedForce(energy), GEOMETRIC[energy]
    for name in parameters(1.0, 1.0):
        wells.addPerParticleParameter(name)
    for k in range(N_CHAINS * N):
        well, size = (0.0, 0.0) if k % 6 == 4 else (0.3 + 0.2 * (k % 6), 0.2 + 0.02 * (k % 6))
        wells.addParticle([*parameters(well, size).values()])
    pairs = nonbonded(made)
    for k in range(pairs.getNumExceptions()):
        wells.addExclusion(*pairs.getExceptionParameters(k)[:2])
    wells.setNonbondedMethod(METHODS[method])
    wells.setCutoffDistance(0.9)
    wells.setUseSwitchingFunction(switched)
    wells.setSwitchingDistance(0.7)
    wells.setUseLongRangeCorrection(tail)
    made.addForce(wells)
    return made, topology, places


@pytest.mark.parametrize(
    ("method", "switched"), [("NoCutoff", False), ("CutoffPeriodic", False), ("CutoffPeriodic", True)]
)
@pytest.mark.parametrize("energy", GEOMETRIC)
def test_wells_that_mix_geometrically_have_the_energies_and_forces_of_openmm(energy, method, switched):
    made, topology, places = opls(energy, method, switched)
    system, potentials, _ = md.from_openmm(made, topology, places)
    assert_same(md.evaluate(system, potentials), *reference(made, places)(), 1e-8)
    [lj] = [one for one in potentials if isinstance(one, md.LennardJones)]
    assert (lj.mixing, lj.truncation, lj.tail_correction) == (
        "geometric",
        "switched" if switched else "truncated",
        False,
    )


def test_the_tail_of_geometric_mixing_is_that_of_openmm_up_to_its_mean_over_pairs():
    """See the test of that of NonbondedForce; here OpenMM integrates numerically."""
    energy = next(iter(GEOMETRIC))
    made, topology, places = opls(energy, tail=True)
    system, potentials, _ = md.from_openmm(made, topology, places)
    [lj] = [one for one in potentials if isinstance(one, md.LennardJones)]
    counts, names, n = np.bincount(system.species_index), system.species_names, len(system)
    tail, _ = lj.tail(counts, names, system.volume)
    own = sum(lj.tail(row, names, system.volume)[0] for row in np.diag(np.sqrt(counts)))
    openmms = reference(made, places)()[0]
    made.getForce(made.getNumForces() - 1).setUseLongRangeCorrection(False)
    openmms -= reference(made, places)()[0]
    assert openmms == pytest.approx(n / (n + 1) * (tail + own), rel=1e-4)


TABLES = {  # as OpenMM's reader of XML files writes it, and those of PSF, AMBER and GROMACS; the power of A
    "acoef(type1, type2)/r^12 - bcoef(type1, type2)/r^6;": 1.0,
    "(a/r6)^2-b/r6; r6=r^6; a=acoef(type1, type2); b=bcoef(type1, type2)": 0.5,
}


@pytest.mark.parametrize("energy", TABLES)
def test_tables_of_wells_of_pairs_of_types_have_the_energies_and_forces_of_openmm(energy):
    """Of eight types, 0 and 6 are alike, 7 is not there, 4 has no well, the pair of 1 and 3 has one of its own."""
    depth, size = np.array([0.3, 0.5, 0.7, 0.9, 0.0, 1.3, 0.3, 2.0]), 0.2 + 0.02 * np.array([0, 1, 2, 3, 4, 5, 0, 9])
    depth, size = np.sqrt(np.outer(depth, depth)), 0.5 * np.add.outer(size, size)
    for pair in ((1, 3), (3, 1)):
        depth[pair], size[pair] = 1.1, 0.29
    made, topology, places = chains("CutoffPeriodic", wells=False)
    wells = openmm.CustomNonbondedForce(energy)
    wells.addPerParticleParameter("type")
    for name, values in (("acoef", (4 * depth * size**12) ** TABLES[energy]), ("bcoef", 4 * depth * size**6)):
        wells.addTabulatedFunction(name, openmm.Discrete2DFunction(8, 8, values.ravel()))
    for k in range(N_CHAINS * N):
        wells.addParticle([6 if k == 6 else k % 6])
    pairs = nonbonded(made)
    for k in range(pairs.getNumExceptions()):
        wells.addExclusion(*pairs.getExceptionParameters(k)[:2])
    wells.setNonbondedMethod(wells.CutoffPeriodic)
    wells.setCutoffDistance(0.9)
    made.addForce(wells)
    system, potentials, _ = md.from_openmm(made, topology, places)
    assert_same(md.evaluate(system, potentials), *reference(made, places)(), 1e-8)
    [lj] = [potential for potential in potentials if isinstance(potential, md.LennardJones)]
    assert (lj.mixing, sorted(lj.parameters)) == ("lorentz-berthelot", ["C1", "C2", "H1", "H2", "N", "O"])
    assert {frozenset(pair) for pair in lj.pairs} == {frozenset("NO")}
    assert lj.pairs[("N", "O")] == pytest.approx((1.1 * KJ, 2.9))


BUTANE = """
[ defaults ]
1 3 yes 0.5 0.5
[ atomtypes ]
CT CT 6 12.011 0.0 A 0.35 0.276144
CX CX 6 12.011 0.0 A 0.36 0.376144
HC HC 1 1.008 0.0 A 0.25 0.12552
[ moleculetype ]
BUT 3
[ atoms ]
1 CT 1 BUT C1 1 -0.18 12.011
2 CX 1 BUT C2 1 -0.06 12.011
3 CX 1 BUT C3 1 0.14 12.011
4 CT 1 BUT C4 1 -0.18 12.011
5 HC 1 BUT H1 1 0.28 1.008
[ bonds ]
1 2 1 0.153 224262.4
2 3 1 0.153 224262.4
3 4 1 0.153 224262.4
4 5 1 0.109 284512.0
[ pairs ]
1 4 1
2 5 1
[ angles ]
1 2 3 1 112.7 488.273
[ dihedrals ]
1 2 3 4 3 2.9288 -1.4644 0.2092 -1.6736 0.0 0.0
2 3 4 5 2 35.0 334.72
1 3 4 5 2 200.0 334.72
[ system ]
butane
[ molecules ]
BUT 8
"""


def test_a_file_of_gromacs_with_the_rules_of_opls_has_the_energies_and_forces_of_openmm(tmp_path):
    """Geometric mixing, pairs 1-4 as bonds with A and C, harmonic impropers."""
    (tmp_path / "a.top").write_text(BUTANE)
    top = app.GromacsTopFile(str(tmp_path / "a.top"), periodicBoxVectors=[openmm.Vec3(*row) for row in CUBE])
    made = top.createSystem(nonbondedMethod=app.CutoffPeriodic, nonbondedCutoff=1.0, useDispersionCorrection=False)
    one = [[0.1, 0.1, 0.2], [0.25, 0.11, 0.2], [0.31, 0.24, 0.2], [0.46, 0.25, 0.22], [0.5, 0.32, 0.29]]
    places = np.concatenate([np.add(one, [1.1 * (k % 2), 1.1 * (k // 2 % 2), 1.03 * (k // 4)]) for k in range(8)])
    without_tail(made)
    potentials = assert_one_force_agrees(made, top.topology, places)
    kinds = {type(potential) for potential in potentials}
    assert {md.HarmonicImproper, md.LennardJones, md.BondPotential, md.RyckaertBellemans} <= kinds


def test_atoms_without_mass_are_fixed_atoms_with_the_mass_of_their_element():
    """As in OpenMM, lengths between them are no constraints."""
    made, topology, places = of_argon(5)
    made.addConstraint(0, 2, 0.5)
    made.addConstraint(3, 4, 0.33)
    for k in (0, 2):
        made.setParticleMass(k, 0.0)
    system, _, (lengths, fixed) = md.from_openmm(made, topology, places)
    assert (type(fixed), fixed.atoms.tolist(), lengths.pairs.tolist()) == (md.FixedAtoms, [0, 2], [[3, 4]])
    assert system.masses == pytest.approx(39.948, rel=1e-5)
    sim = md.Simulation(system, md.LennardJones(0.01, 3.4), md.VelocityVerlet(1.0 * md.units.fs))
    sim.run(20, progress=False)
    moved = np.abs(sim.system.positions - 10.0 * places).max(axis=1) > 0.0
    assert moved.tolist() == [False, True, False, True, True]


def test_atoms_keep_the_names_of_the_topology(tmp_path):
    """Names, elements, residues and chains, in memory and in a file, of which MDAnalysis selects them."""
    mdanalysis = pytest.importorskip("minimd.mdanalysis")
    made, topology, places = of_argon(5, ids=["7", "8", "8A", "-3", "12"])
    [*atoms] = topology.atoms()
    atoms[0].residue.name, atoms[1].residue.name = "HOH", "ALA"
    atoms[1].name, atoms[2].element = "CA", None
    system = md.from_openmm(made, topology, places)[0]
    rows = [["A0", "Ar", "HOH", "7", "B"], ["CA", "Ar", "ALA", "8", "B"], ["A2", "", "GAS", "3", "B"],
            ["A3", "Ar", "GAS", "-3", "B"], ["A4", "Ar", "GAS", "12", "B"]]  # fmt: skip
    assert system.topology.tolist() == rows
    sim = md.Simulation(system, [md.LennardJones(0.01, 3.4)], md.VelocityVerlet(1.0 * md.units.fs))
    sim.run(2, trajectory=tmp_path / "run.h5md", progress=False)
    resumed = md.Simulation.resume(tmp_path / "run.h5md", [md.LennardJones(0.01, 3.4)])
    assert resumed.system.topology.tolist() == rows
    for run in sim, tmp_path / "run.h5md":
        atoms = mdanalysis.universe(run).atoms
        assert atoms.select_atoms("protein").indices.tolist() == [1]
        assert atoms.select_atoms("resname HOH and chainID B and segid B and element Ar").indices.tolist() == [0]
        assert atoms.residues.resids.tolist() == [7, 8, 3, -3, 12]
        assert atoms.names.tolist() == ["A0", "CA", "A2", "A3", "A4"]


def changed(change, method="NoCutoff"):
    """The chains, after something was done to their system."""
    made, *others = chains(method)
    change(made)
    return made, *others


def with_force(force):
    return changed(lambda made: made.addForce(force))


def add_bath_and_strange(made):
    made.addForce(openmm.MonteCarloBarostat(1.0, 300.0))
    made.addForce(openmm.CustomExternalForce("x"))
    made.getForce(made.getNumForces() - 1).addParticle(0)


def add_offset(made):
    made.getForce(4).addGlobalParameter("lambda", 1.0)
    made.getForce(4).addParticleParameterOffset("lambda", 0, 0.1, 0.0, 0.0)


def with_terms(force, add, *numbers):
    getattr(force, f"add{add}")(*numbers)
    return with_force(force)


def with_torsion(energy, *names, is_global=False):
    force = openmm.CustomTorsionForce(energy)
    for name in names:
        force.addPerTorsionParameter(name)
    if is_global:
        force.addGlobalParameter("g", 1.0)
    return with_terms(force, "Torsion", 0, 1, 2, 3, [1.0] * len(names))


def with_maps():
    force = openmm.CMAPTorsionForce()
    force.addMap(3, [0.0] * 9)
    force.addMap(4, [0.0] * 16)
    return with_terms(force, "Torsion", 0, *range(4), *range(1, 5))


def with_pairs(energy, *names, wells=False, repulsive=False):
    made, *others = chains(wells=wells)
    force = openmm.CustomNonbondedForce(energy)
    for name in names:
        force.addPerParticleParameter(name)
    for _ in range(N_CHAINS * N):
        force.addParticle([1.0, 0.0 if repulsive else 1.0])
    made.addForce(force)
    return made, *others


def with_pairs_twice():
    made, *others = with_pairs("a1*a2/r^12-b1*b2/r^6", "a", "b")
    made.addForce(deepcopy(made.getForce(made.getNumForces() - 1)))
    return made, *others


def with_a_massless_site():
    made, topology, places = of_argon(4, elements="")
    made.setParticleMass(2, 0.0)
    return made, topology, places


SITE = openmm.LocalCoordinatesSite([0, 1, 2], [1, 0, 0], [-1, 1, 0], [0, -1, 1], openmm.Vec3(0.1, 0, 0))
REFUSED = [  # arguments, error, what must be named
    (lambda: with_terms(openmm.CustomBondForce("r"), "Bond", 0, 1), ValueError, "'CustomBondForce'", "energy r"),
    (lambda: with_torsion("k*(1+cos(theta-t))", "k", "t"), ValueError, "'CustomTorsionForce'", "k*(1+cos(theta-t))"),
    (lambda: with_torsion("g*(theta-t)^2", "t", is_global=True), ValueError, "'CustomTorsionForce'", "g*(theta-t)^2"),
    (lambda: with_torsion("k*(theta-t)^4", "t", "k"), ValueError, "'CustomTorsionForce'", "k*(theta-t)^4"),
    (lambda: with_pairs("a1*a2/r^9-b1*b2/r^6", "a", "b"), ValueError, "'CustomNonbondedForce'", "a1*a2/r^9-b1*b2/r^6"),
    (lambda: with_pairs("a1*b2/r^12-b1*a2/r^6", "a", "b"), ValueError, "'CustomNonbondedForce'"),
    (lambda: with_pairs("a1*a2/r^12-b1*b2/r^6", "a", "b", wells=True), ValueError, "NonbondedForce with wells"),
    (lambda: with_pairs("a1*a2/r^12-b1*b2/r^6", "a", "b", repulsive=True), ValueError, "A, C", "[1.0, 0.0]"),
    (with_pairs_twice, ValueError, "CustomNonbondedForce", "wells"),
    (lambda: changed(lambda made: made.getForce(4).setParticleParameters(0, 0.1, 0.2, -0.3)), ValueError, "epsilon"),
    (with_a_massless_site, ValueError, "particle 2", "mass 0"),
    (lambda: with_force(openmm.MonteCarloBarostat(1.0, 300.0)), ValueError, "'MonteCarloBarostat'", "md.Simulation"),
    (lambda: with_force(openmm.AndersenThermostat(300.0, 1.0)), ValueError, "'AndersenThermostat'"),
    (lambda: changed(add_bath_and_strange), ValueError, "OpenMM itself; nor 'MonteCarloBarostat'", "md.Simulation"),
    (lambda: with_terms(openmm.GBSAOBCForce(), "Particle", 0.0, 0.1, 0.8), ValueError, "'GBSAOBCForce'"),
    (with_maps, ValueError, "CMAP of several sizes"),
    (lambda: with_terms(openmm.NonbondedForce(), "Particle", 0, 1, 0), ValueError, "second NonbondedForce"),
    (lambda: chains("LJPME"), ValueError, "LJPME"),
    (
        lambda: changed(lambda made: made.setVirtualSite(5, SITE)),
        ValueError,
        "virtual sites",
        "LocalCoordinatesSite",
        "particle 5",
    ),
    (lambda: changed(add_offset), ValueError, "offsets"),
    (lambda: changed(lambda made: made.getForce(4).setIncludeDirectSpace(False), "PME"), ValueError, "direct space"),
    (lambda: (*chains()[:2], np.zeros((3, 3))), ValueError, "number of atoms", "72, 72 and 3"),
    (lambda: (app.Topology(), *chains()[1:]), TypeError, "openmm.System", "Topology"),
]
CALLS = [(lambda make=make: md.from_openmm(*make()), *wanted) for make, *wanted in REFUSED]
test_what_minimd_does_not_have_is_refused_by_name = answered(*CALLS)
