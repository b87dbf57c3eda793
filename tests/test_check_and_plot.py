"""The check finds what is wrong with a file and passes what is right; the picture shows what it says."""

import h5py
import numpy as np
import pytest
from MDAnalysis.coordinates.H5MD import H5MDReader

import minimd as md
from minimd.analysis.check import check_file
from minimd.analysis.plot import plot_file
from minimd.engine import record_picture
from minimd.files import h5md_reader


def simulation(units=md.units.LJ, pbc=(True, True, True)):
    """A small warm crystal."""
    sites = np.stack(np.meshgrid(*[np.arange(4)] * 3, indexing="ij"), -1).reshape(-1, 3)
    sigma, epsilon, timestep, temperature = (1.0, 1.0, 0.002, 0.6) if units is md.units.LJ else (3.4, 0.0104, 0.2, 70.0)
    cell = 4.4 * sigma if any(pbc) else None
    system = md.System(
        1.1 * sigma * sites,
        masses=1.0 if units is md.units.LJ else 39.948,
        cell=cell,
        pbc=pbc,
        species=["Ar"] * 64,
        units=units,
    )
    made = md.Simulation(
        system, md.LennardJones(epsilon, sigma, 2.0 * sigma, truncation="force-shifted"), md.VelocityVerlet(timestep)
    )
    made.set_temperature(temperature, seed=8)
    return made


@pytest.fixture(scope="module")
def run_file(tmp_path_factory):
    path = tmp_path_factory.mktemp("run") / "a.h5md"
    simulation().run(400, every=5, trajectory=path)
    return path


@pytest.fixture
def spoiled(run_file, tmp_path):
    """The same file, to be changed."""
    path = tmp_path / "spoiled.h5md"
    path.write_bytes(run_file.read_bytes())
    return path


@pytest.mark.parametrize("units", [md.units.LJ, md.units.ASE], ids=lambda units: units.name)
@pytest.mark.parametrize(
    "pbc", [(True, True, True), (True, True, False), (False, False, False)], ids=["bulk", "slab", "cluster"]
)
def test_good_run_passes_with_figures_and_tolerances(tmp_path, units, pbc):
    simulation(units, pbc).run(200, every=5, trajectory=tmp_path / "a.h5md")
    found = check_file(tmp_path / "a.h5md")
    assert found.passed, str(found)
    text = str(found)
    figures = (
        "41 frames",
        "steps 0 to 200",
        "MDAnalysis",
        "tolerance 6e-08",
        "tolerance 1e-06",
        "restarts are those that were written",
    )
    for words in (*figures, "verdict", "check          passed"):
        assert words in text
    assert ("ang. momentum" in text) == (not any(pbc))
    assert 0.0 < found.comparisons[0].figure < 1e-6


@pytest.mark.parametrize(
    ("path", "change", "name"),
    [
        ("observables/kinetic_energy/value", 1 + 3e-6, "kinetic energy"),
        ("observables/absolute_momentum/value", 1 + 3e-7, "Σ|mv|"),
        ("observables/total_energy/value", 1 + 1e-15, "total energy"),
        ("particles/trajectory/velocity/value", 1 + 3e-6, "kinetic energy"),
    ],
)
def test_falsified_file_fails_by_name(spoiled, path, change, name):
    with h5py.File(spoiled, "r+") as h5:
        h5[path][...] = h5[path][...] * change
    found = check_file(spoiled)
    failed = [one.name for one in found.comparisons if not one.passed]
    assert name in failed
    assert not found.passed
    assert "check          FAILED" in str(found)


def test_falsified_masses_are_refused(spoiled):
    with h5py.File(spoiled, "r+") as h5:
        h5["particles/trajectory/mass"][...] *= 1 + 3e-6
    with pytest.raises(OSError, match="is damaged: its description is not the one that was written"):
        check_file(spoiled)


def test_momentum_of_one_frame_is_compared(spoiled):
    with h5py.File(spoiled, "r+") as h5:
        momentum, scale = h5["observables/momentum/value"], h5["observables/absolute_momentum/value"][17]
        momentum[17] += [0.0, 2e-7 * scale, 0.0]
    failed = [one for one in check_file(spoiled).comparisons if not one.passed]
    assert [one.name for one in failed] == ["momentum", "checksums"]
    assert failed[1].meaning == "frames 1 to 80 are not those that were written"  # of one block, with one sum


def test_nan_and_backward_steps_fail(spoiled):
    with h5py.File(spoiled, "r+") as h5:
        h5["observables/kinetic_energy/value"][3] = np.nan
        h5["particles/trajectory/position/step"][5] = 1
    assert {one.name for one in check_file(spoiled).comparisons if not one.passed} >= {"kinetic energy", "steps"}


def test_drifting_energy_fails(spoiled):
    with h5py.File(spoiled, "r+") as h5:
        drift = np.linspace(0.0, 20.0, 81)
        for name in ("potential_energy", "total_energy"):
            h5[f"observables/{name}/value"][...] += drift
        h5["observables/total_energy/value"][...] = (
            h5["observables/potential_energy/value"][...] + h5["observables/kinetic_energy/value"][...]
        )
    found = check_file(spoiled)
    assert all(one.passed for one in found.comparisons if one.name != "checksums")
    assert not found.passed
    assert "DRIFTS" in str(found)


class Drawn(record_picture.Picture):
    """A figure that can be looked at afterwards."""

    last: "Drawn"

    def __init__(self, *arguments, **keywords):
        super().__init__(*arguments, **keywords)
        Drawn.last = self


@pytest.mark.parametrize(
    ("units", "pbc", "time", "fourth"),
    [
        (md.units.LJ, (True, True, True), "time  [τ]", ("r  [σ]", "g(r)")),
        (md.units.ASE, (True, True, True), "time  [ps]", ("r  [Å]", "g(r)")),
        (md.units.LJ, (True, True, False), "time  [τ]", ("lag  [τ]", "⟨|r(t) − r(0)|²⟩  [σ²]")),
        (md.units.ASE, (False, False, False), "time  [ps]", ("lag  [ps]", "⟨|r(t) − r(0)|²⟩  [Å²]")),
    ],
)
def test_picture_shows_the_series_in_physical_units(tmp_path, monkeypatch, units, pbc, time, fourth):
    monkeypatch.setattr(record_picture, "Picture", Drawn)
    record = simulation(units, pbc).run(100, every=5, trajectory=tmp_path / "a.h5md")
    drawn = plot_file(tmp_path / "a.h5md")
    assert drawn == tmp_path / "a.png"
    assert drawn.read_bytes()[:8] == b"\x89PNG\r\n\x1a\n"
    panels = Drawn.last.axes
    assert [panel.get_xlabel() for panel in panels] == [time] * 3 + [fourth[0]]
    assert panels[3].get_ylabel() == fourth[1]
    times, temperature = panels[1].lines[0].get_data()
    np.testing.assert_allclose(times, record.time / (98.22694788464064 if units is md.units.ASE else 1.0), rtol=1e-12)
    np.testing.assert_array_equal(temperature, record.temperature)
    change = panels[0].lines[0].get_ydata()
    shape = record.total_energy - record.total_energy[0]
    np.testing.assert_allclose(change / change[7], shape / shape[7], rtol=1e-9)
    power = panels[0].get_ylabel().partition("10^{")[2].partition("}")[0]
    np.testing.assert_allclose(change * 10.0 ** int(power or 0), shape / 64, rtol=1e-12)
    assert units.energy in panels[0].get_ylabel()


def test_picture_goes_where_it_is_told(run_file, tmp_path):
    assert plot_file(run_file, tmp_path / "b.pdf") == tmp_path / "b.pdf"
    assert (tmp_path / "b.pdf").read_bytes()[:4] == b"%PDF"
    with pytest.raises(OSError, match=r"nowhere.* cannot be written"):
        plot_file(run_file, tmp_path / "nowhere" / "b.png")


@pytest.mark.parametrize("n_frames", [1, 2, 3])
def test_picture_of_few_frames_and_of_atoms_at_rest(tmp_path, n_frames):
    sim = simulation(pbc=(False, False, False))
    sim.velocities[:] = 0.0
    sim.run(5 * n_frames - 5, every=5, trajectory=tmp_path / "a.h5md")
    assert plot_file(tmp_path / "a.h5md").stat().st_size > 10_000
    found = check_file(tmp_path / "a.h5md")
    assert found.passed is False
    assert f"NOT PASSED: {n_frames} frame" in str(found)


def test_check_knows_a_bond_longer_than_half_the_cell(tmp_path):
    turning = md.System([[0.0, 0.0, 0.0], [1.2, 0.0, 0.0]], velocities=[[0.3, -0.8, 0.0], [-0.3, 0.8, 0.0]], cell=2.0)
    nothing = md.LennardJones(1e-30, 0.01, cutoff=0.5)
    simulation = md.Simulation(turning, nothing, md.VelocityVerlet(0.01), md.DistanceConstraints([[0, 1]], 1.2))
    with pytest.warns(UserWarning, match="velocities along bonds"):
        simulation.run(20, every=5, trajectory=tmp_path / "a.h5md")
    assert [one.passed for one in check_file(tmp_path / "a.h5md").comparisons if one.name == "lengths"] == [True]


@pytest.mark.parametrize("look", [check_file, plot_file])
def test_a_file_is_read_once(run_file, tmp_path, monkeypatch, look):
    """By minimd, what is no frame; by one reader of MDAnalysis, the frames."""
    path, calls = tmp_path / "a.h5md", []
    path.write_bytes(run_file.read_bytes())
    for place, name in ((h5md_reader, "opened"), (H5MDReader, "__init__")):
        original = getattr(place, name)
        monkeypatch.setattr(
            place, name, lambda *a, name=name, original=original, **k: calls.append(name) or original(*a, **k)
        )
    look(path)
    assert calls == ["opened", "__init__"]  # the look at the checksums is a child's
