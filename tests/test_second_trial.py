"""What a second round of sixteen tasks stumbled over."""

import threading
import warnings
from dataclasses import replace

import numpy as np
import pytest
from h5md_runs import simulation

import minimd as md
from minimd.analysis.check import check_file
from minimd.engine.observation import OBSERVABLES, Observable, register
from minimd.engine.record import SERIES
from minimd.files.h5md_reader import damage, read_file
from minimd.files.h5md_schema import chunk_rows
from minimd.structure.quiet import quiet

SIDE = [[20.0, 0.0, 0.0], [0.0, 20.0, 0.0], [20.0, 20.0, 0.0]]


@pytest.mark.parametrize(
    ("cell", "pbc", "cure"),
    [
        (
            [20, 20, None],
            None,
            r"None\]: in a direction that does not repeat give length 0, .* pbc=\(True, True, False\)",
        ),
        ([20, 20], None, r"shape is \(2,\): .* pbc=\(True, True, False\)"),
        ([20, 20, np.inf], None, r"must be finite.* pbc=\(True, True, False\)"),
        (SIDE, None, r"linearly independent.* pbc=\(True, True, False\)"),
        ([20, 20, 0], True, r"cell\[2\] is zero; .* leave it open: pbc=\(True, True, False\)"),
        ([20, 0, 20], [False, True, True], r"leave it open: pbc=\(False, False, True\)"),
        (md.Cell.of(3.0), True, r"Cell\.of\(vectors, pbc\)"),
    ],
)
def test_messages_about_cells_name_pbc_where_it_is_the_cure(cell, pbc, cure):
    with pytest.raises(ValueError, match=cure):
        md.System(np.eye(3), cell=cell, pbc=pbc)


def test_a_universe_without_a_third_vector_says_that_it_has_no_cell():
    from minimd.mdanalysis import universe

    with pytest.warns(
        UserWarning, match=r"has no cell, because MDAnalysis needs three vectors.*pbc=\(True, True, False\)"
    ):
        universe(simulation("slab without height"))


def test_the_verdict_says_that_the_time_step_is_too_long(tmp_path):
    """Whether the energy drifts or not; in a file too."""
    made = simulation()
    made.method = md.VelocityVerlet(0.02)
    with pytest.warns(UserWarning, match=r"timestep 0.02 τ is long .*; see advise_timestep"):
        record = made.run(20, every=1, trajectory=tmp_path / "run.h5md")
    report = made.report()
    clause = "timestep 0.02 τ is long for Lennard-Jones atoms as light as these: in a liquid velocity-verlet conserves the energy well up to"
    assert clause in report.verdict
    assert clause in check_file(tmp_path / "run.h5md").report.verdict
    still = replace(report, energy_drift=replace(report.energy_drift, slope=0.0), energy_range=0.0)
    assert still.verdict.startswith(f"the total energy does not drift, BUT {clause}")
    falling = replace(report, energy_drift=replace(report.energy_drift, slope=-1.0, error=1e-3, is_unsure=False))
    assert falling.verdict.startswith(f"THE TOTAL ENERGY DRIFTS: {clause}")
    made.method = md.VelocityVerlet(0.002)
    assert "timestep" not in made.report().verdict
    assert len(record) == 21


@pytest.fixture
def forgetting():
    """What a test registers is forgotten."""
    yield
    OBSERVABLES.pop("first_mass", None)
    SERIES.pop("first_mass", None)


def test_a_file_keeps_its_observables(tmp_path, forgetting):
    """Appended to with others, its series would have different lengths."""
    file, made = tmp_path / "run.h5md", simulation()
    made.run(2, every=1, trajectory=file)
    register(Observable("first_mass", "", lambda look: look.system.masses[0]))
    with pytest.raises(
        ValueError, match=r"was begun without 'first_mass', which this run records: .* write to a new file"
    ):
        made.run(2, every=1, trajectory=file, append=True)
    assert not damage(file)
    assert read_file(file).n_frames == 3
    made.run(2, every=1, trajectory=tmp_path / "new.h5md")
    del OBSERVABLES["first_mass"]
    with pytest.raises(
        ValueError, match=r"holds 'first_mass', which this run does not record; register what is missing"
    ):
        made.run(2, every=1, trajectory=tmp_path / "new.h5md", append=True)
    assert not damage(tmp_path / "new.h5md")


def test_warnings_are_passed_over_in_one_thread_alone():
    """Also where contexts of two threads end in the order in which they began, after which catch_warnings leaves all warnings ignored."""
    inside, leave = threading.Event(), threading.Event()

    def elsewhere():
        with quiet():
            inside.set()
            leave.wait(10.0)
            warnings.warn("nobody hears this", stacklevel=1)

    with warnings.catch_warnings(record=True) as told:
        warnings.simplefilter("always")
        with quiet():
            other = threading.Thread(target=elsewhere)
            other.start()
            inside.wait(10.0)
            warnings.warn("nor this", stacklevel=1)
        warnings.warn("but this", stacklevel=1)
        leave.set()
        other.join()
        warnings.warn("and this", stacklevel=1)
    assert [str(one.message) for one in told] == ["but this", "and this"]


def test_a_file_that_a_universe_of_this_script_has_open_says_how_to_close_it(tmp_path):
    from minimd.mdanalysis import universe

    made = simulation()
    made.run(2, every=1, trajectory=tmp_path / "run.h5md")
    reading = universe(tmp_path / "run.h5md")
    with pytest.raises(OSError, match=r"close that first: universe\.trajectory\.close\(\)"):
        made.run(2, every=1, trajectory=tmp_path / "run.h5md", append=True)
    reading.trajectory.close()
    made.run(2, every=1, trajectory=tmp_path / "run.h5md", append=True)


def test_a_file_of_few_frames_is_small_and_that_of_many_has_large_chunks(tmp_path):
    """A chunk takes its full size on the disk, whatever is in it. Chunks of a long run stay as large as they were."""
    made = simulation()
    made.run(1, every=1, trajectory=tmp_path / "short.h5md")
    assert (tmp_path / "short.h5md").stat().st_size < 130_000
    number, numbers, many = np.zeros(()), np.zeros((27, 3)), 10_000
    assert (
        [chunk_rows(entry, many) for entry in (number, numbers)]
        == [chunk_rows(entry) for entry in (number, numbers)]
        == [512, 101]
    )
    assert [chunk_rows(entry, 2) for entry in (number, numbers, np.zeros((10_000, 3)))] == [16, 16, 1]
    made.run(40, every=1, trajectory=tmp_path / "short.h5md", append=True)
    assert read_file(tmp_path / "short.h5md").n_frames == 42


def test_numbers_of_a_cell_have_their_units():
    slab = str(md.System(np.eye(3), cell=[3.0, 3.0, 9.0], pbc=(True, True, False)))
    assert "(0, 0, 9) σ, open" in slab
    argon = str(md.System(np.eye(3), masses=40.0, cell=4.0, units=md.units.ASE))
    assert "cell a         (4, 0, 0) Å\n" in argon
    assert "volume         64 Å³\n" in argon
