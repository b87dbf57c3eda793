"""The check finds what is wrong with a file and passes what is right; the picture shows what it says."""

from pathlib import Path

import h5py
import numpy as np
import pytest
from charged_scenes import ions, run_of
from h5md_runs import N_ATOMS, PER_PICOSECOND, simulation
from scene_texts import SMOOTH

import minimd as md
from minimd.core.engine import record_picture
from minimd.scene import load_scene, run_scene
from minimd.view.check import check_file
from minimd.view.plot import plot_file

LJ, ASE = md.units.LJ, md.units.ASE
SLAB, OPEN = (pytest.param(ASE, cell, marks=pytest.mark.slow) for cell in ("slab", "open"))


@pytest.fixture(scope="module")
def run_file(tmp_path_factory):
    path = tmp_path_factory.mktemp("run") / "a.h5md"
    simulation().run(100, every=10, trajectory=path)
    return path


@pytest.mark.parametrize(("units", "cell"), [(LJ, "cubic"), SLAB, OPEN])
def test_good_run_passes_with_figures_and_tolerances_and_its_picture_shows_it(tmp_path, monkeypatch, units, cell):
    drawn, path, picture = [], tmp_path / "a.h5md", record_picture.Picture
    record = simulation(cell, units).run(200, every=10, trajectory=path)
    found = check_file(path)
    assert found.passed, str(found)
    for words in ("21 frames", "steps 0 to 200", "tolerance 6e-08", "tolerance 1e-06", "check          passed"):
        assert words in str(found)
    assert ("ang. momentum" in str(found)) == (cell == "open")
    assert 0.0 < found.comparisons[0].figure < 1e-6
    kept = lambda *given, **more: drawn.append(picture(*given, **more)) or drawn[0]  # noqa: E731
    monkeypatch.setattr(record_picture, "Picture", kept)
    assert plot_file(path) == tmp_path / "a.png"
    assert (tmp_path / "a.png").read_bytes()[:8] == b"\x89PNG\r\n\x1a\n"
    panels, length, time = drawn[0].axes, *(("σ", "τ") if units is LJ else ("Å", "ps"))
    fourth = (f"r  [{length}]", "g(r)") if cell == "cubic" else (f"lag  [{time}]", f"⟨|r(t) − r(0)|²⟩  [{length}²]")
    assert [panel.get_xlabel() for panel in panels] == [f"time  [{time}]"] * 3 + [fourth[0]]
    assert panels[3].get_ylabel() == fourth[1]
    times, temperature = panels[1].lines[0].get_data()
    np.testing.assert_allclose(times, record.time / (PER_PICOSECOND if units is ASE else 1.0), rtol=1e-12)
    np.testing.assert_array_equal(temperature, record.temperature)
    change, shape = panels[0].lines[0].get_ydata(), record.total_energy - record.total_energy[0]
    np.testing.assert_allclose(change / change[7], shape / shape[7], rtol=1e-9)
    power = panels[0].get_ylabel().partition("10^{")[2].partition("}")[0]
    np.testing.assert_allclose(change * 10.0 ** int(power or 0), shape / N_ATOMS, rtol=1e-12)
    assert units.energy in panels[0].get_ylabel()


def scale(name, factor):
    return lambda h5: h5[name].write_direct(h5[name][...] * factor)


def push(h5):
    h5["observables/momentum/value"][7] += [0.0, 2e-7 * h5["observables/absolute_momentum/value"][7], 0.0]


def drift(h5):
    potential, kinetic, total = (h5[f"observables/{name}_energy/value"] for name in ("potential", "kinetic", "total"))
    potential[...] += np.linspace(0.0, 20.0, 11)
    total[...] = potential[...] + kinetic[...]


def several(h5):
    scale("particles/trajectory/velocity/value", 1 + 3e-6)(h5)
    scale(VALUES.format("total_energy"), 1 + 1e-15)(h5)
    h5["particles/trajectory/position/step"][5] = 1  # a step back


VALUES = "observables/{}/value"
SPOILED = {  # what is done to a file, what fails, and what is said
    "v, E and a step": (several, {"kinetic energy", "Σ|mv|", "total energy", "steps"}, "FAILED"),
    "momentum of one frame": (push, {"momentum", "checksums"}, "frames 0 to 10"),  # of one block, with one sum
    "NaN": (lambda h5: h5[VALUES.format("kinetic_energy")].__setitem__(3, np.nan), {"kinetic energy"}, "FAILED"),
    "drift": (drift, {"checksums"}, "DRIFTS"),
}


@pytest.mark.parametrize("what", SPOILED)
def test_falsified_file_fails_by_name(what, run_file, tmp_path):
    path, (change, names, shown) = tmp_path / "spoiled.h5md", SPOILED[what]
    path.write_bytes(run_file.read_bytes())
    with h5py.File(path, "r+") as h5:
        change(h5)
    found = check_file(path)
    failed = {one.name for one in found.comparisons if not one.passed}
    assert (not found.passed, shown in str(found), names <= failed) == (True, True, True), str(found)
    assert shown == "FAILED" or failed == names


@pytest.mark.slow
@pytest.mark.parametrize("n_frames", [1, 2, 3])
def test_picture_of_few_frames_and_of_atoms_at_rest_goes_where_it_is_told(tmp_path, n_frames):
    sim, file = simulation("open"), tmp_path / "a.h5md"
    sim.velocities[:] = 0.0
    sim.run(5 * n_frames - 5, every=5, trajectory=file)
    assert plot_file(file, tmp_path / "b.pdf").read_bytes()[:4] == b"%PDF"
    assert f"NOT PASSED: {n_frames} frame" in str(check_file(file))


def test_check_knows_a_bond_longer_than_half_the_cell_and_the_accuracy_of_charges(tmp_path):
    turning = md.System([[0.0, 0.0, 0.0], [1.2, 0.0, 0.0]], velocities=[[0.3, -0.8, 0.0], [-0.3, 0.8, 0.0]], cell=2.0)
    nothing = md.LennardJones(1e-30, 0.01, 0.5, "force-shifted")
    simulation = md.Simulation(turning, nothing, md.VelocityVerlet(0.01), md.DistanceConstraints([[0, 1]], 1.2))
    with pytest.warns(UserWarning, match="velocities along bonds"):
        simulation.run(20, every=5, trajectory=tmp_path / "a.h5md")
    assert [one.passed for one in check_file(tmp_path / "a.h5md").comparisons if one.name == "lengths"] == [True]
    run_of(ions()).run(4, every=1, trajectory=tmp_path / "ions.h5md")
    told = str(check_file(tmp_path / "ions.h5md"))
    assert "charges        Coulomb(cutoff=2.7, accuracy=0.0001): " in told


@pytest.mark.parametrize("units", [LJ, ASE])
def test_momentum_in_fixed_point_arithmetic_is_constant_in_files_of_all_units(units, tmp_path):
    of, path = simulation("cubic", units), tmp_path / "a.h5md"
    md.Simulation(of.system, of.potentials, of.method, precision="fixed-point").run(20, every=5, trajectory=path)
    assert [one.passed for one in check_file(path).comparisons if one.name == "exact momentum"] == [True]


def test_a_title_with_dollars_is_drawn_as_text(tmp_path, here):
    Path("a.toml").write_text(f'title = "profit of $x_{{ and more$"\n{SMOOTH}')
    scene = load_scene("a.toml")
    run_scene(scene, trajectory=Path("a.h5md"), tell=lambda _: None, progress=False)
    assert plot_file("a.h5md").read_bytes()[:4] == b"\x89PNG"
