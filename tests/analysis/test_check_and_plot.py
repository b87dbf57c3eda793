"""The check finds what is wrong with a file and passes what is right; the picture shows what it says."""

from pathlib import Path

import h5py
import numpy as np
import pytest
from charged_scenes import ions, run_of
from h5md_runs import N_ATOMS, PER_PICOSECOND, simulation
from scene_texts import SMOOTH
from wrong_calls import assert_answered

import minimd as md
from minimd.core.engine import record_picture
from minimd.mdanalysis.universes import mean_square_displacement, universe_of
from minimd.scene import load_scene, run_scene
from minimd.view.check import check_file
from minimd.view.plot import drawn, plot_file

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


def titles(figure):
    """Of its panels, without figures in brackets."""
    return [panel.get_title().partition("   ")[0].partition(",")[0] for panel in figure.axes]


KEPT, DRIVEN = md.VelocityVerlet(0.004), md.LangevinBAOAB(0.004, 0.7, 1.0, seed=1)
GENTLE = md.StochasticVelocityRescaling(0.004, 0.7, relaxation_time=0.5, seed=1)
ENERGY, HEAT = ["total energy per atom", "temperature"], ["total energy − heat per atom", "temperature"]
MOMENTUM, GAS, LIQUID = "total momentum", "mean-square displacement", "radial distribution between molecules"
DRAWN = {  # method, barostat, cell; panels of a record, and of a file
    "energy": (KEPT, False, "cubic", [*ENERGY, MOMENTUM, "pressure"], [*ENERGY, MOMENTUM, LIQUID]),
    "open": (KEPT, False, "open", [*ENERGY, MOMENTUM, "potential energy per atom"], [*ENERGY, MOMENTUM, GAS]),
    "Langevin": (
        *(DRIVEN, False, "cubic"),
        *([*HEAT, "pressure", "potential energy per atom"], [*HEAT, "pressure", LIQUID]),
    ),
    "open Langevin": (
        *(DRIVEN, False, "open", [*HEAT, "potential energy per atom"]),
        [*HEAT, "potential energy per atom", GAS],
    ),
    "pressure, Langevin": (
        *(DRIVEN, True, "cubic", [*HEAT, "volume", "pressure"]),
        [*HEAT, "volume", "pressure", LIQUID],
    ),
    "pressure": (
        *(GENTLE, True, "cubic", [*HEAT, MOMENTUM, "volume", "pressure"]),
        [*HEAT, MOMENTUM, "volume", "pressure", LIQUID],
    ),
}


@pytest.mark.parametrize("of", DRAWN)
def test_pictures_show_momentum_and_drift_only_where_they_are_conserved_and_volume_where_it_changes(tmp_path, of):
    method, is_pressed, cell, of_record, of_file = DRAWN[of]
    start, file = simulation(cell), tmp_path / "a.h5md"
    barostat = md.StochasticCellRescaling(0.1, 0.1, 5.0, seed=2, every=5) if is_pressed else None
    sim = md.Simulation(start.system, start.potentials, method, barostat=barostat)
    record = sim.run(200, every=5, trajectory=file)
    assert titles(record.plot()) == of_record
    with universe_of(file) as run:
        figure = drawn(run)
    assert titles(figure) == of_file
    legend = figure.axes[0].get_legend()
    assert (legend is None) == (method is not KEPT)
    if legend:
        slope = float(legend.texts[0].get_text().split()[1])
        assert slope == pytest.approx(sim.report().energy_drift.slope, rel=0.01)
        assert legend.texts[0].get_text().startswith(f"drift: {sim.report().energy_drift} ")
    if is_pressed:
        density = float(figure.axes[of_file.index("volume")].get_title().split()[3])
        assert density == pytest.approx((N_ATOMS / record.volume).mean(), rel=1e-3)


def test_a_file_of_several_temperatures_is_drawn_and_its_motion_measured_since_the_last_change(tmp_path):
    sim, file = simulation("open"), tmp_path / "a.h5md"
    for step, temperature in ((100, 0.2), (150, 0.7)):
        sim.method = md.LangevinBAOAB(0.004, temperature, 1.0, seed=1)
        sim.run(until_step=step, every=10, trajectory=file, append="auto")
    with universe_of(file) as run:
        panel = drawn(run).axes[3]
        lags, _ = mean_square_displacement(run)
    assert "from step 100 on" in panel.get_title()
    assert panel.lines[0].get_xdata()[-1] == lags[-1] == pytest.approx(50 * 0.004)
    sim.method = md.LangevinBAOAB(0.004, 0.9, 1.0, seed=1)
    sim.run(0, every=10, trajectory=file, append=True)
    with universe_of(file) as run:
        assert len(drawn(run).axes) == 3  # nothing has moved since
        assert_answered(lambda: mean_square_displacement(run), ValueError, "2 frames", "holds 1", "changed")


def test_what_a_change_of_the_state_spoils_is_not_drawn_as_conserved(tmp_path):
    sim, file = simulation(), tmp_path / "a.h5md"
    sim.run(20, every=10, trajectory=file)
    sim.velocities += 0.1
    sim.run(20, every=10, trajectory=file, append=True)
    with universe_of(file) as run:
        figure = drawn(run)
    assert (titles(figure)[2], figure.axes[0].get_legend()) == ("pressure", None)


def test_structure_that_an_observer_has_measured_is_drawn_once(tmp_path):
    file = tmp_path / "a.h5md"
    simulation().run(40, every=10, trajectory=file, observers=[md.observers.RadialDistribution(every=10)])
    with universe_of(file) as run:
        figure = drawn(run)
    assert titles(figure) == [*ENERGY, MOMENTUM, LIQUID]
    assert "5 frames, 0 to 0.16 τ" in figure.axes[3].get_title()
