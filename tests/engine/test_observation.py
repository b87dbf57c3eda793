"""An observable of one's own is in record and file, with its unit."""

import h5py
import numpy as np
import pytest
from references import liquid

import minimd as md
from minimd.engine.observation import OBSERVABLES, Observable, register
from minimd.engine.record import SERIES


def test_an_observable_of_ones_own_is_in_record_and_file(tmp_path, monkeypatch):
    monkeypatch.setattr("minimd.engine.observation.OBSERVABLES", dict(OBSERVABLES))
    register(Observable("doubled_energy", "energy", lambda look: 2.0 * look.total_energy))
    try:
        sim = md.Simulation(liquid(3), md.LennardJones(1.0, 1.0, 1.85, "switched"), md.VelocityVerlet(0.003))
        record = sim.run(6, every=3, trajectory=tmp_path / "a.h5md")
        assert np.array_equal(record.doubled_energy, 2.0 * record.total_energy)
        with h5py.File(tmp_path / "a.h5md") as h5:
            stored = h5["observables/doubled_energy/value"]
            assert np.array_equal(stored[:], record.doubled_energy)
            assert stored.attrs["unit"] == md.units.LJ.energy
    finally:
        SERIES.pop("doubled_energy")


def test_names_in_use_and_units_that_are_none_are_refused():
    with pytest.raises(ValueError, match="'pressure' is already in use"):
        register(Observable("pressure", "pressure", lambda look: 0.0))
    with pytest.raises(ValueError, match="unit = 'speed'"):
        register(Observable("fastest", "speed", lambda look: 0.0))
    assert "fastest" not in OBSERVABLES
    assert "fastest" not in SERIES
