"""A pair potential from a table: as accurate as its spline, and its force is the derivative of the energy."""

import copy

import numpy as np
import pytest
from references import liquid
from wrong_calls import assert_answered

import minimd as md
from minimd.core.diagnosis.run_report import cutoff_lines
from minimd.core.potentials.law import evaluate_law

CUTOFF = 2.5
LJ = md.LennardJones(1.0, 1.0, CUTOFF)


def lennard_jones(r):
    return 4.0 * (r**-12 - r**-6)


def table(n, spacing=lambda x: x, truncation="shifted"):
    r = 0.8 + (CUTOFF - 0.8) * spacing(np.linspace(0.0, 1.0, n))
    return md.Tabulated(r, lennard_jones(r), truncation=truncation)


def force_over_distance(potential, r):
    return np.array([evaluate_law(potential.plain_law, x * x, (0.0,))[1] for x in r])


def test_energy_has_the_order_of_the_spline():
    """Half the spacing: an error 2⁶ times smaller in u, 2⁵ times in the force.
    Away from the ends, where the error is larger and falls off from knot to knot."""
    r, pair = np.linspace(1.3, 2.2, 400), (table(100), table(199))
    energies = [np.abs(one.pair_energy(r) - LJ.pair_energy(r)).max() for one in pair]
    forces = [np.abs(force_over_distance(one, r) - 24.0 * (2.0 * r**-14 - r**-8)).max() for one in pair]
    assert 45.0 < energies[0] / energies[1] < 90.0
    assert 24.0 < forces[0] / forces[1] < 45.0
    assert forces[1] < 1e-4


@pytest.mark.parametrize("spacing", [lambda x: x, lambda x: x**2, lambda x: np.sqrt(0.1 + x) - np.sqrt(0.1)])
def test_force_is_the_derivative_of_the_energy_to_rounding(spacing):
    """Of each piece, by its polynomial, also where points are not equally spaced; pieces meet in four derivatives."""
    potential = table(60, lambda x: spacing(x) / spacing(1.0))
    knots, coefficients, _ = potential.plain_law.table
    before, orders = None, np.arange(1, 5)
    assert np.array_equal(knots, potential.r)
    for k, width in enumerate(np.diff(knots)):
        piece = np.polynomial.Polynomial(coefficients[0, k, ::-1])
        inside = knots[k] + width * np.array([0.0, 0.3, 0.999])
        slope = piece.deriv()(inside - knots[k])
        size = sum(n * abs(c) * width ** (n - 1) for n, c in enumerate(piece.coef) if n)
        assert force_over_distance(potential, inside) == pytest.approx(-slope / inside, rel=1e-14, abs=1e-14 * size)
        if before is not None:
            meeting = [before.deriv(d)(knots[k] - knots[k - 1]) - piece.deriv(d)(0.0) for d in orders]
            sizes = [abs(before.deriv(d)(0.0)) + abs(piece.deriv(d)(0.0)) + size for d in orders]
            assert np.all(np.abs(meeting) < 1e-9 * np.array(sizes) * width ** (1.0 - orders))
        before = piece
    assert force_over_distance(potential, knots[-1:]) == pytest.approx(-piece.deriv()(width) / knots[-1], rel=1e-12)


def test_the_points_of_the_table_are_on_the_spline_and_nothing_is_known_before_them():
    potential = table(30)
    expected = lennard_jones(potential.r[:-1]) - lennard_jones(CUTOFF)
    assert potential.pair_energy(potential.r[:-1]) == pytest.approx(expected, rel=1e-13, abs=1e-13)
    assert np.isnan(potential.pair_energy(0.75))


@pytest.mark.slow
def test_energy_is_conserved_and_a_copy_goes_on_with_the_same_bits():
    """The table has forty points: its own energy is conserved, however far it is from that of Lennard-Jones."""
    sim = md.Simulation(liquid(3), table(40, truncation="smooth"), md.VelocityVerlet(0.001))
    record = sim.run(300, every=10, progress=False)
    assert np.ptp(record.total_energy) < 2e-3 * record.kinetic_energy.mean()
    assert "pair list" in sim.engine.interactions.pair_search
    twin = copy.deepcopy(sim)
    for one in (sim, twin):
        one.run(20, progress=False)
    assert np.array_equal(sim.positions, twin.positions)


def test_the_jump_at_the_cutoff_is_seen_of_a_table_that_begins_late():
    """Beyond 0.9 of the cutoff, where the report looks for the size of the law."""
    r = np.linspace(2.4, CUTOFF, 30)
    (line,) = cutoff_lines(md.System([[0.0, 0.0, 0.0]]), [md.Tabulated(r, lennard_jones(r), 2.47, "truncated")])
    assert line.verdict.startswith("THE ENERGY JUMPS")


def file_of(tmp_path, text):
    (tmp_path / "pairs.table").write_text(text)
    return tmp_path / "pairs.table"


def section(keyword, header, r, u, force, start=1):
    rows = [f"{k} {x!r} {y!r} {z!r}" for k, (x, y, z) in enumerate(np.column_stack([r, u, force]).tolist(), start)]
    return "\n".join([keyword, header, "", *rows, ""])


def lennard_jones_section(keyword="LJ", header="N 200 R 0.8 2.5", spacing="R", factor=1.0):
    r = np.linspace(0.8, CUTOFF, 200)
    if spacing == "RSQ":
        r = np.sqrt(np.linspace(0.64, CUTOFF**2, 200))
    force = factor * 24.0 * (2.0 * r**-13 - r**-7)
    return section(keyword, header, r.round(6), lennard_jones(r), force)


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize("spacing", ["R", "RSQ", ""])
def test_a_table_file_of_lammps_is_its_law(tmp_path, spacing):
    """Rounded distances are those of the spacing, if there is one; comments, empty lines and other sections pass by."""
    ends = f"{spacing} 0.8 2.5 FPRIME -5e3 0.1" if spacing else "FP -5e3 0.1"
    other = section("OTHER", "N 7", np.arange(1.0, 8.0), np.arange(7.0), -np.ones(7))
    text = f"# by hand\n\n{other}\n  # more\n{lennard_jones_section('LJ', f'N 200 {ends}   # ends', spacing)}\n"
    potential = md.Tabulated.from_file(file_of(tmp_path, text), "LJ")
    r = np.linspace(1.0, 2.4, 50)
    assert potential.pair_energy(r) == pytest.approx(
        LJ.pair_energy(r), abs=1e-7 if spacing else 1e-3
    )  # six digits of r
    assert potential.cutoff == CUTOFF
    assert md.Tabulated.from_file(file_of(tmp_path, text), "OTHER", cutoff=6.0).cutoff == 6.0


def test_kilocalories_become_electronvolts_as_in_lammps(tmp_path):
    file = file_of(tmp_path, "\ufeff# DATE: 2020-01-01 UNITS: real\n" + lennard_jones_section())
    potential = md.Tabulated.from_file(file, truncation="truncated")
    assert potential.pair_energy(1.1) == pytest.approx(lennard_jones(1.1) * 4.184 / 96.48533, rel=1e-6)


@pytest.mark.parametrize("factor", [-1.0, 2.0, 1.05])
def test_a_force_that_is_not_the_slope_is_told_and_the_slope_taken(tmp_path, factor):
    with pytest.warns(UserWarning, match=r"force in the table is not -du/dr at \d+ distances"):
        potential = md.Tabulated.from_file(file_of(tmp_path, lennard_jones_section(factor=factor)))
    assert force_over_distance(potential, [1.2]) == pytest.approx(24.0 * (2.0 * 1.2**-14 - 1.2**-8), rel=1e-6)


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize(("n", "digits"), [(500, 5), (2000, 6), (40, 8)])
def test_rounded_and_coarse_tables_have_no_wrong_forces(tmp_path, n, digits):
    r = np.linspace(0.9, CUTOFF, n)
    u = [float(f"{x:.{digits}g}") for x in lennard_jones(r)]
    force = [float(f"{x:.{digits}g}") for x in 24.0 * (2.0 * r**-13 - r**-7)]
    md.Tabulated.from_file(file_of(tmp_path, section("LJ", f"N {n}", r, u, force)))


GOOD = lennard_jones_section()
WRONG = {
    "a row of three": (GOOD.replace("\n7 ", "\n", 1), "N = 200", "from 4 to 3 at row 7"),
    "three columns": ("LJ\nN 6\n" + "1 2.0 3.0\n" * 6, "N = 6", "6 of 3"),
    "too few rows": ("\n".join(GOOD.splitlines()[:-2]), "N = 200", "198 of 4"),
    "too few before a section": (GOOD.replace("N 200", "N 201") + GOOD.replace("LJ", "B"), "N = 201", "row 201"),
    "more rows than N": (GOOD.replace("N 200 R 0.8 2.5", "N 199"), "line 203", "N of the section before"),
    "no rows": ("LJ\nN 6\n", "N = 6", "0 of"),
    "no N": (GOOD.replace("N 200 ", ""), "line 1", "must have N"),
    "half an N": (GOOD.replace("N 200", "N 200.5"), "line 1", "200.5"),
    "bitmap": (GOOD.replace("R 0.8", "BITMAP 0.8"), "line 1", "BITMAP"),
    "another spacing": (GOOD.replace("R 0.8", "RSQ 0.8"), "line 1", "row 2"),
    "ends in reverse": (GOOD.replace("0.8 2.5", "2.5 0.8"), "line 1", "row 1 must be 2.5"),
    "not a number": (GOOD.replace("\n7 ", "\nseven ", 1), "N = 200", "'seven'"),
    "nan": (GOOD + section("B", "N 6", np.arange(1.0, 7.0), np.full(6, np.nan), np.zeros(6)), "'B'", "finite"),
    "the same twice": (GOOD + GOOD, "line 204", "'LJ'", "new keyword"),
    "another unit": ("# UNITS: electron\n" + GOOD, "UNITS", "electron"),
    "no keyword": (GOOD.partition("\n")[2].partition("\n")[2], "line 2", "keyword"),
    "nothing": ("# nothing\n", "keyword must", "'LJ'"),
    "no line with N": ("LJ\n", "line 1", "must have N"),
    "another keyword": (GOOD.replace("LJ", "MORSE"), "'MORSE'", "keyword = 'LJ'"),
}


@pytest.mark.parametrize("name", WRONG)
def test_files_that_are_not_understood_are_refused_with_their_line(tmp_path, name):
    text, *words = WRONG[name]
    assert_answered(lambda: md.Tabulated.from_file(file_of(tmp_path, text), "LJ"), ValueError, *words)


def test_keywords_are_of_sections(tmp_path):
    file = file_of(tmp_path, GOOD + GOOD.replace("LJ", "B"))
    for keyword, shown in ((None, "None"), ("L", "'L'"), (3, "3"), ({}, "{}")):
        assert_answered(lambda keyword=keyword: md.Tabulated.from_file(file, keyword), ValueError, "'LJ', 'B'", shown)
    assert_answered(lambda: md.Tabulated.from_file(file.parent), ValueError, "regular file")
