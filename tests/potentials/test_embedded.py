"""Embedded atoms: right beside a sum over all pairs, LAMMPS and published values; on both lists, with any threads."""

import json
import pickle
from pathlib import Path

import metals
import numpy as np
import pytest
from ase.build import bulk
from references import brute_force_pairs
from scipy.optimize import minimize_scalar

import minimd as md
from minimd.core.forces import pair_laws
from minimd.core.potentials.law import evaluate_law

DATA = json.loads((Path(__file__).parents[1] / "data" / "embedded_lammps.json").read_text())
GPA = 160.2176634  # in eV/Å³
BAR = 1.602176634e6  # of LAMMPS, whose constants differ in the eighth digit
TEXTS = {"eam": metals.funcfl(), "eam/alloy": metals.setfl(), "eam/fs": metals.setfl(both_ways=True)}
TUNGSTEN = (1.896373, 4.400224, 0.0, 3.25, 47.1346499, -33.7665655, 6.2541999)
MOLYBDENUM = (1.887117, 4.114825, 0.0, 3.25, 43.4475218, -31.9332978, 6.0804249)
COPPER = (0.0855, 1.224, 10.96, 2.278, 2.556)


def atoms_of(kind="eam", n=3):
    atoms = bulk("Cu", "fcc", 3.9, cubic=True) * (n, n, n)
    atoms.rattle(0.2, seed=7)
    if kind != "eam":
        atoms.symbols[::3] = "Al"
    return atoms


def system_of(kind="eam", n=3):
    return md.System.from_ase(atoms_of(kind, n))


def from_text(kind, tmp_path):
    file = tmp_path / f"metal.{kind.replace('/', '.')}"
    file.write_text(TEXTS[kind])
    return md.EmbeddedAtom.from_file(file)


GUPTA = md.EmbeddedAtom("gupta", COPPER, 5.5, "smooth")
ALLOY = md.EmbeddedAtom(
    "sutton-chen",
    {"Cu": (0.0124, 3.61, 39.4, 9.0, 6.0), "Al": (0.0331, 4.05, 16.4, 7.0, 6.0)},
    5.5,
    "force-shifted",
    pairs={("Al", "Cu"): (0.02, 3.8, 0.0, 8.0, 6.0)},
)
SINCLAIR = md.EmbeddedAtom("finnis-sinclair", TUNGSTEN, 4.400224)


@pytest.mark.parametrize("kind", TEXTS)
@pytest.mark.parametrize("clusters_from", [32, 1000])
def test_energy_and_forces_are_those_of_lammps(kind, clusters_from, tmp_path, monkeypatch):
    """On clusters, and on the pair list."""
    monkeypatch.setattr(pair_laws, "CLUSTERS_FROM", clusters_from)
    expected, system = DATA[kind], system_of(kind)
    result = md.evaluate(system, from_text(kind, tmp_path))
    xx, yy, zz, yz, xz, xy = expected["pressure_bar"]
    pressure = np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
    assert result.potential_energy == pytest.approx(expected["energy"], rel=1e-13)
    assert result.energies == pytest.approx(np.array(expected["energies"]), rel=1e-12)
    assert result.forces == pytest.approx(np.array(expected["forces"]), abs=1e-11)
    assert result.virial / system.volume * BAR == pytest.approx(pressure, rel=2e-7, abs=0.1)


def summed(potential, system):
    """The energy as a sum over all pairs and images, with the laws in Python."""
    density = np.zeros(len(system))
    energy = 0.0
    for i, j, *shift in brute_force_pairs(system.positions, system.cell.vectors, system.cell.pbc, potential.cutoff):
        r = np.linalg.norm(system.positions[j] - system.positions[i] + np.array(shift) @ system.cell.vectors)
        _, *numbers = potential.table(system.species_names)[
            tuple(system.species_index[[i, j]] if potential.depends_on_species else (0, 0))
        ]
        half = len(numbers) // 2
        energy += 0.5 * evaluate_law(potential.law.pair, r * r, tuple(numbers[:half]))[0]
        density[i] += evaluate_law(potential.law.density, r * r, tuple(numbers[half:]))[0]
    for name, rho in zip(system.species, density, strict=True):
        energy += evaluate_law(potential.laws.embedding, rho, tuple(potential.embedding([name]).table[0]))[0]
    return energy


@pytest.mark.parametrize(("potential", "kind"), [(GUPTA, "eam"), (ALLOY, "eam/alloy"), (SINCLAIR, "eam")])
@pytest.mark.parametrize("n", [1, 3])
def test_energy_is_the_sum_over_all_pairs(potential, kind, n):
    system = system_of(kind, n)
    found = md.evaluate(system, potential)
    assert found.potential_energy == pytest.approx(summed(potential, system), rel=1e-12)
    assert np.abs(found.forces.sum(axis=0)).max() < 1e-12 * np.abs(found.forces).sum()


@pytest.mark.parametrize("potential", [GUPTA, ALLOY, SINCLAIR])
def test_force_is_minus_the_gradient_on_clusters(potential):
    system, way = system_of("eam/alloy"), np.random.default_rng(1).normal(size=(108, 3))
    h, energies = 1e-4, []
    for step in (-2, -1, 1, 2):
        moved = system.copy()
        moved.positions += step * h * way
        energies.append(md.evaluate(moved, potential).potential_energy)
    slope = (energies[0] - 8.0 * energies[1] + 8.0 * energies[2] - energies[3]) / (12.0 * h)
    assert (md.evaluate(system, potential).forces * way).sum() == pytest.approx(-slope, rel=1e-7)


PUBLISHED = {  # lattice, a [Å], cohesive energy [eV], C11, C12, C44 [GPa], vacancy [eV]; digits as printed
    # M. W. Finnis, J. E. Sinclair (1984), tables 1 and 2
    "W": (md.EmbeddedAtom("finnis-sinclair", TUNGSTEN, 4.400224), "bcc", (3.1652, 8.90, 522.4, 204.4, 160.6, 3.63)),
    "Mo": (md.EmbeddedAtom("finnis-sinclair", MOLYBDENUM, 4.114825), "bcc", (3.1472, 6.82, 464.7, 161.5, 108.9, 2.55)),
    # F. Cleri, V. Rosato (1993), tables I and II; neighbors up to the fifth shell
    "Cu": (md.EmbeddedAtom("gupta", COPPER, 5.88, "truncated"), "fcc", (3.615, 3.544, 176.0, 125.0, 82.0, None)),
}
DIGITS = (1e-3, 5e-3, 0.4, 0.4, 0.4, 5e-3)


@pytest.mark.parametrize("element", PUBLISHED)
def test_crystals_have_the_properties_of_the_papers(element):
    """Lattice constant and energy at the minimum, elastic constants from stresses, a vacancy that relaxes."""
    potential, lattice, expected = PUBLISHED[element]
    found = properties(potential, element, lattice, expected[0], with_vacancy=expected[5] is not None)
    for value, published, digits in zip(found, expected, DIGITS, strict=True):
        assert published is None or value == pytest.approx(published, abs=digits)


def properties(potential, element, lattice, start, with_vacancy):
    def crystal(a):
        return bulk(element, lattice, a=a, cubic=True) * (5, 5, 5)

    def energy(a):
        atoms = crystal(a)
        return md.evaluate(md.System.from_ase(atoms), potential).potential_energy / len(atoms)

    found = minimize_scalar(energy, bounds=(0.97 * start, 1.03 * start), method="bounded", options={"xatol": 1e-8})
    a, cohesive = float(found.x), -float(found.fun)

    def stress(*strain):
        atoms = crystal(a)
        xx, yz = strain
        deformed = np.array([[1.0 + xx, 0.0, 0.0], [0.0, 1.0, yz], [0.0, yz, 1.0]])
        atoms.set_cell(atoms.cell.array @ deformed, scale_atoms=True)
        system = md.System.from_ase(atoms)
        return -md.evaluate(system, potential).virial / system.volume * GPA

    h = 1e-4
    along = (stress(h, 0.0) - stress(-h, 0.0)) / (2.0 * h)
    shear = (stress(0.0, 0.5 * h) - stress(0.0, -0.5 * h)) / (2.0 * h)
    vacancy = None
    if with_vacancy:
        atoms = crystal(a)
        del atoms[0]
        sim = md.Simulation(atoms, potential, md.VelocityVerlet(md.units.fs))
        sim.minimize(force_tolerance=1e-3, progress=False)
        vacancy = sim.potential_energy + len(atoms) * cohesive
    return a, cohesive, along[0, 0], along[1, 1], shear[1, 2], vacancy


def simulation(potential, threads=1, **given):
    system = system_of("eam/alloy", 8)
    return md.Simulation(system, potential, md.VelocityVerlet(2.0 * md.units.fs), threads=threads, **given)


def test_threads_and_a_resume_change_no_bit(tmp_path):
    alloy = from_text("eam/fs", tmp_path)
    runs = []
    for threads in (1, 2):
        sim = simulation(alloy, threads)
        sim.set_temperature(600, seed=1)
        sim.run(40, every=20, progress=False, trajectory=tmp_path / f"{threads}.h5md")
        runs.append(sim)
    resumed = md.Simulation.resume(tmp_path / "2.h5md", pickle.loads(pickle.dumps(alloy)))
    for sim in (*runs, resumed):
        sim.run(20, every=20, progress=False)
    one, two, again = (sim.system for sim in (*runs, resumed))
    assert np.array_equal(one.positions, two.positions)
    assert np.array_equal(one.positions, again.positions)
    assert np.array_equal(one.velocities, again.velocities)


def test_energy_is_conserved_to_the_order_of_the_method():
    """Smooth functions: half the step, a quarter of the error; momentum to rounding."""
    spreads = []
    for step in (4.0, 2.0):
        sim = md.Simulation(system_of("eam/alloy"), ALLOY_SMOOTH, md.VelocityVerlet(step * md.units.fs))
        sim.set_temperature(300, seed=1)
        sim.run(int(800 / step), every=400, progress=False)
        record = sim.run(int(1600 / step), every=int(8 / step), progress=False)
        spreads.append(np.std(record.total_energy))
        assert np.abs(record.momentum - record.momentum[0]).max() < 1e-11
    assert 3.3 < spreads[0] / spreads[1] < 4.8


ALLOY_SMOOTH = md.EmbeddedAtom(
    "sutton-chen", ALLOY.parameters, 5.5, "smooth", pairs={("Al", "Cu"): (0.02, 3.8, 0.0, 8.0, 6.0)}
)


def gupta_pair(r2, a, xi, p, q, length):
    r = np.sqrt(r2)
    u = 2.0 * a * np.exp(-p * (r / length - 1.0))
    return u, p * u / (length * r)


def gupta_density(r2, a, xi, p, q, length):
    r = np.sqrt(r2)
    g = xi * xi * np.exp(-2.0 * q * (r / length - 1.0))
    return g, 2.0 * q * g / (length * r)


def root(rho, a, xi, p, q, length):
    s = np.sqrt(rho)
    return -s, -0.5 / s


def wrong_root(rho, a, xi, p, q, length):
    return -np.sqrt(rho), -0.5 * np.sqrt(rho)


def test_functions_of_ones_own_are_as_good_as_those_with_a_name():
    own = md.EmbeddedAtom((gupta_pair, gupta_density, root), COPPER, 5.5, "smooth")
    found, expected = (md.evaluate(system_of(), potential) for potential in (own, GUPTA))
    assert found.potential_energy == pytest.approx(expected.potential_energy, rel=1e-13)
    assert found.forces == pytest.approx(expected.forces, abs=1e-12)
    with pytest.raises(ValueError, match=r"F'\(rho\)"):
        md.evaluate(system_of(), md.EmbeddedAtom((gupta_pair, gupta_density, wrong_root), COPPER, 5.5))


def test_an_atom_alone_and_two_atoms():
    alone = md.System(np.zeros((1, 3)), species=["Cu"], masses=63.5, units=md.units.ASE)
    assert md.evaluate(alone, GUPTA).potential_energy == 0.0
    two = md.System([[0, 0, 0], [2.5, 0, 0]], species=["Cu", "Cu"], masses=63.5, units=md.units.ASE)
    assert md.evaluate(two, GUPTA).potential_energy == pytest.approx(float(GUPTA.pair_energy(2.5)), rel=1e-14)


def test_a_table_ends_in_a_straight_line_and_begins_with_its_cubic(tmp_path):
    """Beyond the last density F goes on with its slope there; crowded atoms read nothing outside of the table."""
    potential = from_text("eam/alloy", tmp_path)
    law, (row,) = potential.laws.embedding, potential.parameters["Cu"]
    last = 0.25 * (metals.N_RHO - 1)
    (at_end, slope), (beyond, same) = (evaluate_law(law, rho, (row,)) for rho in (last, last + 7.0))
    assert beyond == pytest.approx(at_end + 7.0 * slope, rel=1e-12)
    assert same == pytest.approx(slope, rel=1e-12)
    crowded = md.System(
        0.4 * np.random.default_rng(0).normal(size=(60, 3)), species=["Cu"] * 60, masses=63.5, units=md.units.ASE
    )
    assert np.isfinite(md.evaluate(crowded, potential).forces).all()


def test_energy_and_force_agree_beyond_the_last_distance_of_a_file(tmp_path):
    """Straight lines go on from tables that do not end at zero, to the cutoff."""
    file = tmp_path / "beyond.eam"
    file.write_text(metals.setfl(("Cu",), cutoff=5.52, offset=0.01))
    potential = md.EmbeddedAtom.from_file(file)
    x, h = 5.49, 1e-4
    pair = md.System([[0, 0, 0], [x, 0, 0]], species=["Cu", "Cu"], masses=63.5, units=md.units.ASE)
    low, high = (float(potential.pair_energy(r, "Cu", "Cu")) for r in (x - h, x + h))
    force = md.evaluate(pair, potential).forces[1, 0]
    assert abs(force) > 1e-4
    assert force == pytest.approx((low - high) / (2.0 * h), rel=1e-6)


def test_written_tables_are_read_back_to_the_bit(tmp_path):
    for kind in TEXTS:
        tables = from_text(kind, tmp_path).given
        file = tmp_path / "again"
        file.write_text(tables.as_text())
        again = md.EmbeddedAtom.from_file(file).given
        for name in ("embedding", "density", "pair", "masses"):
            assert np.array_equal(getattr(again, name), getattr(tables, name))
        assert (again.cutoff, again.dr, again.drho) == (tables.cutoff, tables.dr, tables.drho)


SETFL, FUNCFL = TEXTS["eam/alloy"], TEXTS["eam"]
WRONG_FILES = {
    "empty": ("", "five finite numbers"),
    "text": ("a\nb\nc\nd\ne\nf\n", "five finite numbers"),
    "number": (SETFL.replace("e-01", "e-0x", 1), "F of Cu must be finite numbers; number"),
    "infinite step": (SETFL.replace(f"{metals.N_RHO} 0.25", f"{metals.N_RHO} inf", 1), "five finite numbers"),
    "infinite number": (SETFL.replace(f"{metals.N_RHO} 0.25", "inf 0.25", 1), "five finite numbers"),
    "tiny step": (SETFL.replace(f"{metals.N_RHO} 0.25", f"{metals.N_RHO} 1e-320", 1), "five finite numbers"),
    "variable": (SETFL.replace("2 Cu Al", "2 Cu $(sqrt(4))", 1), "letters and digits"),
    "no element": (SETFL.replace("2 Cu Al", "2 Cu NULL", 1), "letters and digits"),
    "funcfl blank": (FUNCFL.replace("29 63.55 3.6 fcc", "", 1), "atomic number"),
    "nan": (SETFL.replace("\n0.0000000000000000e+00", "\nnan", 1), "must be finite"),
    "short": (SETFL[: len(SETFL) // 2], "need"),
    "long": (SETFL + "1.0\n", "need"),
    "twice": (SETFL.replace("2 Cu Al", "2 Cu Cu", 1), "must be different"),
    "steps": (SETFL.replace(f"{metals.N_RHO} 0.25", f"{metals.N_RHO} -0.25", 1), "must be positive"),
    "few": (SETFL.replace(f"{metals.N_RHO} 0.25", "3 0.25", 1), "5 or more"),
    "reach": (SETFL.replace(f"{metals.STEP} {metals.CUTOFF}", f"{metals.STEP} 9.9", 1), "reach to the cutoff"),
    "mass": (SETFL.replace("29 63.55", "29 -63.55", 1), "mass"),
    "funcfl mass": (FUNCFL.replace("29 63.55", "29 x", 1), "mass"),
    "funcfl element": (FUNCFL.replace("29 63.55", "Cu 63.55", 1), "atomic number"),
    "funcfl short": (FUNCFL[:-200], "need"),
}


@pytest.mark.parametrize("name", WRONG_FILES)
def test_other_files_are_refused_in_words(name, tmp_path):
    text, words = WRONG_FILES[name]
    (tmp_path / "wrong").write_text(text)
    with pytest.raises(ValueError, match=words) as caught:
        md.EmbeddedAtom.from_file(tmp_path / "wrong")
    assert "wrong" in str(caught.value)


WRONG = {
    "name": (
        lambda: md.EmbeddedAtom("sutton", (1.0,) * 5),
        ValueError,
        "law of EmbeddedAtom must be one of 'sutton-chen'",
    ),
    "no law": (lambda: md.EmbeddedAtom(None, (1.0,) * 5), TypeError, "three functions"),
    "file": (lambda: md.EmbeddedAtom("Cu.eam.alloy"), ValueError, "EmbeddedAtom.from_file"),
    "count": (lambda: md.EmbeddedAtom("gupta", (1.0,) * 4), ValueError, "5 numbers"),
    "length": (
        lambda: md.EmbeddedAtom("gupta", (*COPPER[:4], -2.5), 5.0),
        ValueError,
        "r0 of 'gupta' must be positive",
    ),
    "lengths": (
        lambda: md.EmbeddedAtom("finnis-sinclair", {"W": (1.0, 0.0, *TUNGSTEN[2:])}, 5.0),
        ValueError,
        "d of 'finnis-sinclair' for 'W' must be positive",
    ),
    "mixing": (
        lambda: md.EmbeddedAtom("gupta", {"Cu": COPPER}, 5.5, mixing="geometric"),
        ValueError,
        "function of the tuples",
    ),
    "cutoff": (lambda: md.evaluate(system_of(), md.EmbeddedAtom("gupta", COPPER)), ValueError, "cutoff"),
    "species": (
        lambda: md.evaluate(system_of(), md.EmbeddedAtom("gupta", {"Al": COPPER}, 5.5)),
        ValueError,
        "no parameters for species 'Cu'",
    ),
    "fixed point": (
        lambda: md.Simulation(system_of(), GUPTA, md.VelocityVerlet(0.1), precision="fixed-point"),
        ValueError,
        "EmbeddedAtom cannot round",
    ),
    "exclusions": (
        lambda: md.evaluate(system_of(), [GUPTA, md.LennardJones(0.01, 2.0, 5.0, exclusions=[[0, 1]])]),
        ValueError,
        "acts on all pairs",
    ),
}


@pytest.mark.parametrize("name", WRONG)
def test_wrong_arguments_are_refused_in_words(name):
    call, kind, words = WRONG[name]
    with pytest.raises(kind, match=words):
        call()


def test_tables_need_elements_and_units_of_ase(tmp_path):
    potential = from_text("eam", tmp_path)
    with pytest.raises(ValueError, match="names of elements"):
        md.evaluate(system_of("eam/alloy"), potential)
    reduced = md.System(system_of().positions, species=["Cu"] * 108, cell=11.7)
    with pytest.raises(ValueError, match="units of ASE"):
        md.evaluate(reduced, potential)
    assert repr(potential) == "EmbeddedAtom.from_file('metal.eam')"


def test_lists_are_shared_with_other_potentials(tmp_path):
    """A wall of Lennard-Jones beside the metal: one list, the sum of both."""
    both = [from_text("eam/fs", tmp_path), md.LennardJones(0.01, 2.5, 6.0)]
    system = system_of("eam/fs", 4)
    result = md.evaluate(system, both)
    parts = [md.evaluate(system, potential) for potential in both]
    assert result.potential_energy == pytest.approx(sum(part.potential_energy for part in parts), rel=1e-13)
    assert result.forces == pytest.approx(parts[0].forces + parts[1].forces, abs=1e-12)
    assert md.Forces(system, both).pair_search.count("list") == 1
