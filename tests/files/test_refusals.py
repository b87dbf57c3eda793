"""What cannot be read, or cannot go on, is refused with its reason, and stays as it is."""

import copy

import numpy as np
import pytest
from h5md_runs import at_step, simulation
from wrong_calls import assert_answered

import minimd as md
from minimd.files.claim import Claim
from minimd.files.h5md_reader import read_file
from minimd.files.h5md_writer import H5MDWriter


def bath(sim):
    sim.method = md.LangevinBAOAB(sim.method.timestep, 0.7, 1.0, seed=1)


def at_pressure(pressure):
    rescaling, of = md.StochasticCellRescaling(pressure, 0.1, 1.0, seed=1, temperature=1.0), simulation()
    return md.Simulation(of.system, of.potentials, md.VelocityVerlet(0.004), barostat=rescaling)


CONTINUED = [  # what has become of the simulation, and what is shown
    (lambda sim: object.__setattr__(sim.system, "masses", 7.0 * sim.system.masses), "masses"),
    (lambda sim: object.__setattr__(sim.system, "charges", sim.system.charges + 0.1), "charges"),
    (bath, "without a thermostat", "langevin-baoab"), (lambda sim: setattr(sim, "step", 0), "step 10", "step 0"),
    (lambda sim: setattr(sim, "extra_observables", ["stress"]), "extra_observables"),
    (lambda sim: simulation("triclinic"), "the cell"), (lambda sim: simulation("cubic", md.units.ASE), "units"),
    (lambda sim: at_pressure(2.0), "no barostat", "pressure=2.0"), (lambda sim: None, "without forces"),
]  # fmt: skip


def test_a_run_of_something_else_cannot_be_appended(tmp_path):
    first, path = simulation(), tmp_path / "a.h5md"
    first.run(10, every=5, trajectory=path)
    before = path.read_bytes()
    for change, *shown in CONTINUED:
        sim, options = copy.copy(first), {"trajectory": path, "append": True, "store_forces": "without forces" in shown}
        if made := change(sim):
            made.step, sim = 10, made
        assert_answered(lambda run=sim.run, by=options: run(10, **by), ValueError, "a.h5md", "new file", *shown)
        assert path.read_bytes() == before


def append_to_xtc(path):
    simulation().run(10, trajectory=path.with_suffix(".xtc"))
    simulation().run(10, trajectory=path.with_suffix(".xtc"), append=True)


def go_on_at_another_pressure(path):
    one, other = at_pressure(1.0), at_pressure(2.0)
    one.run(4, every=2, trajectory=path)
    other.restore(one.snapshot())
    other.run(4, every=2, trajectory=path, append=True)


def write_after_the_end(path):
    sim = simulation()
    writer = H5MDWriter(Claim(path), sim.engine, False)
    writer.close()
    writer.write(sim.frame())


def heat_on_the_way(path):
    sim = simulation()
    sim.run(10, every=5, trajectory=path, observers=[at_step(5, lambda: bath(sim))])


REFUSED = {append_to_xtc: [".h5md", "a.xtc"], go_on_at_another_pressure: ["pressure=1.0", "pressure=2.0"]}
REFUSED |= {write_after_the_end: ["closed", "step 0"], heat_on_the_way: ["langevin"]}


@pytest.mark.parametrize("call", REFUSED)
def test_what_a_file_cannot_take_is_refused(call, tmp_path):
    assert_answered(lambda: call(tmp_path / "a.h5md"), ValueError, *REFUSED[call])


def test_too_little_memory_is_no_damage_and_a_file_without_a_frame_leaves_nothing(tmp_path, monkeypatch):
    H5MDWriter(Claim(tmp_path / "empty.h5md"), simulation().engine, False).close()
    assert list(tmp_path.iterdir()) == []
    simulation().run(10, every=5, trajectory=tmp_path / "a.h5md")
    monkeypatch.setattr("minimd.files.h5md_digest.unflattened", lambda *_: np.empty(10**15))
    with pytest.raises(MemoryError):
        read_file(tmp_path / "a.h5md")


def test_refused_or_failed_output_leaves_nothing_of_the_others(tmp_path, monkeypatch):
    def fails(*_, **__):
        raise OSError("no more files")

    (tmp_path / "b.xyz").write_text("precious")
    with pytest.raises(FileExistsError, match=r"b\.xyz' exists"):
        simulation().run(5, trajectory=[tmp_path / "a.h5md", tmp_path / "b.xyz"])
    closed = []
    monkeypatch.setattr("minimd.files.turned_cell.MDAnalysisWriter.close", lambda of: closed.append(of.claim.release()))
    monkeypatch.setattr("minimd.files.h5md_writer.H5MDWriter.__init__", fails)
    with pytest.raises(OSError, match="no more files"):
        simulation().run(5, trajectory=[tmp_path / "a.h5md", tmp_path / "c.xtc"])
    assert (closed, [path.name for path in tmp_path.iterdir()]) == ([None], ["b.xyz"])
