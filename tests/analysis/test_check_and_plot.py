"""The check finds what is wrong with a file and passes what is right; the picture shows what it says."""

import h5py
import numpy as np
import pytest
from h5md_runs import PER_PICOSECOND

import minimd as md
from minimd.analysis.check import check_file
from minimd.analysis.plot import plot_file
from minimd.engine import record_picture

LJ, ASE = md.units.LJ, md.units.ASE
BULK, SLAB, CLUSTER = (True, True, True), (True, True, False), (False, False, False)


def simulation(units=LJ, pbc=BULK):
    """A small warm crystal."""
    sites = 1.1 * np.stack(np.meshgrid(*[np.arange(4)] * 3, indexing="ij"), -1).reshape(-1, 3)
    reduced, argon = (1.0, 1.0, 1.0, 0.002, 0.6), (3.4, 0.0104, 39.948, 0.2, 70.0)
    sigma, epsilon, mass, timestep, temperature = reduced if units is LJ else argon
    cell = 4.4 * sigma if any(pbc) else None
    system = md.System(sigma * sites, masses=mass, cell=cell, pbc=pbc, species=["Ar"] * 64, units=units)
    law = md.LennardJones(epsilon, sigma, 2.0 * sigma, truncation="force-shifted")
    made = md.Simulation(system, law, md.VelocityVerlet(timestep))
    made.set_temperature(temperature, seed=8)
    return made


@pytest.fixture(scope="module")
def run_file(tmp_path_factory):
    path = tmp_path_factory.mktemp("run") / "a.h5md"
    simulation().run(400, every=20, trajectory=path)
    return path


@pytest.fixture
def spoiled(run_file, tmp_path):
    """A function that changes a copy of the file and checks it; returns the check and the names of what has failed."""

    def check(change):
        path = tmp_path / "spoiled.h5md"
        path.write_bytes(run_file.read_bytes())
        with h5py.File(path, "r+") as h5:
            change(h5)
        found = check_file(path)
        return found, {one.name: one.meaning for one in found.comparisons if not one.passed}

    return check


@pytest.mark.parametrize(("units", "pbc"), [(LJ, BULK), (ASE, SLAB), (ASE, CLUSTER)])
def test_good_run_passes_with_figures_and_tolerances_and_its_picture_shows_it(tmp_path, monkeypatch, units, pbc):
    class Drawn(record_picture.Picture):
        """A figure that can be looked at afterwards."""

        def __init__(self, *arguments, **keywords):
            super().__init__(*arguments, **keywords)
            drawn.append(self)

    drawn, path = [], tmp_path / "a.h5md"
    record = simulation(units, pbc).run(200, every=10, trajectory=path)
    found = check_file(path)
    assert found.passed, str(found)
    for words in ("21 frames", "steps 0 to 200", "tolerance 6e-08", "tolerance 1e-06", "check          passed"):
        assert words in str(found)
    assert ("ang. momentum" in str(found)) == (not any(pbc))
    assert 0.0 < found.comparisons[0].figure < 1e-6

    monkeypatch.setattr(record_picture, "Picture", Drawn)
    assert plot_file(path) == tmp_path / "a.png"
    assert (tmp_path / "a.png").read_bytes()[:8] == b"\x89PNG\r\n\x1a\n"
    panels, length, time = drawn[0].axes, *(("σ", "τ") if units is LJ else ("Å", "ps"))
    displacement = (f"lag  [{time}]", f"⟨|r(t) − r(0)|²⟩  [{length}²]")
    fourth = (f"r  [{length}]", "g(r)") if all(pbc) else displacement
    assert [panel.get_xlabel() for panel in panels] == [f"time  [{time}]"] * 3 + [fourth[0]]
    assert panels[3].get_ylabel() == fourth[1]
    times, temperature = panels[1].lines[0].get_data()
    np.testing.assert_allclose(times, record.time / (PER_PICOSECOND if units is ASE else 1.0), rtol=1e-12)
    np.testing.assert_array_equal(temperature, record.temperature)
    change, shape = panels[0].lines[0].get_ydata(), record.total_energy - record.total_energy[0]
    np.testing.assert_allclose(change / change[7], shape / shape[7], rtol=1e-9)
    power = panels[0].get_ylabel().partition("10^{")[2].partition("}")[0]
    np.testing.assert_allclose(change * 10.0 ** int(power or 0), shape / 64, rtol=1e-12)
    assert units.energy in panels[0].get_ylabel()


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
    found, failed = spoiled(lambda h5: h5[path].write_direct(h5[path][...] * change))
    assert name in failed
    assert not found.passed
    assert "check          FAILED" in str(found)


def test_falsified_masses_are_refused(spoiled):
    with pytest.raises(OSError, match="is damaged: its description is not"):
        spoiled(
            lambda h5: h5["particles/trajectory/mass"].write_direct(h5["particles/trajectory/mass"][...] * 1.000003)
        )


def test_momentum_of_one_frame_is_compared(spoiled):
    def push(h5):
        scale = h5["observables/absolute_momentum/value"][17]
        h5["observables/momentum/value"][17] += [0.0, 2e-7 * scale, 0.0]

    _, failed = spoiled(push)
    assert list(failed) == ["momentum", "checksums"]
    assert "frames 1 to 20" in failed["checksums"]  # of one block, with one sum


def test_nan_and_backward_steps_fail(spoiled):
    def spoil(h5):
        h5["observables/kinetic_energy/value"][3] = np.nan
        h5["particles/trajectory/position/step"][5] = 1

    assert set(spoiled(spoil)[1]) >= {"kinetic energy", "steps"}


def test_drifting_energy_fails(spoiled):
    def drift(h5):
        potential, kinetic, total = (
            h5[f"observables/{name}_energy/value"] for name in ("potential", "kinetic", "total")
        )
        potential[...] += np.linspace(0.0, 20.0, 21)
        total[...] = potential[...] + kinetic[...]

    found, failed = spoiled(drift)
    assert set(failed) == {"checksums"}
    assert not found.passed
    assert "DRIFTS" in str(found)


def test_picture_goes_where_it_is_told(run_file, tmp_path):
    assert plot_file(run_file, tmp_path / "b.pdf") == tmp_path / "b.pdf"
    assert (tmp_path / "b.pdf").read_bytes()[:4] == b"%PDF"
    with pytest.raises(OSError, match="nowhere"):
        plot_file(run_file, tmp_path / "nowhere" / "b.png")


@pytest.mark.parametrize("n_frames", [1, 2, 3])
def test_picture_of_few_frames_and_of_atoms_at_rest(tmp_path, n_frames):
    sim = simulation(pbc=CLUSTER)
    sim.velocities[:] = 0.0
    sim.run(5 * n_frames - 5, every=5, trajectory=tmp_path / "a.h5md")
    assert plot_file(tmp_path / "a.h5md").stat().st_size > 10_000
    found = check_file(tmp_path / "a.h5md")
    assert found.passed is False
    assert f"NOT PASSED: {n_frames} frame" in str(found)


def test_check_knows_a_bond_longer_than_half_the_cell(tmp_path):
    turning = md.System([[0.0, 0.0, 0.0], [1.2, 0.0, 0.0]], velocities=[[0.3, -0.8, 0.0], [-0.3, 0.8, 0.0]], cell=2.0)
    nothing = md.LennardJones(1e-30, 0.01, 0.5, "force-shifted")
    simulation = md.Simulation(turning, nothing, md.VelocityVerlet(0.01), md.DistanceConstraints([[0, 1]], 1.2))
    with pytest.warns(UserWarning, match="velocities along bonds"):
        simulation.run(20, every=5, trajectory=tmp_path / "a.h5md")
    assert [one.passed for one in check_file(tmp_path / "a.h5md").comparisons if one.name == "lengths"] == [True]
