"""minimd doctor: it finds this machine in order, and notices what is not."""

import numba
import pytest

import minimd as md
from minimd.commands import doctor
from minimd.commands import main as cli


def test_doctor_finds_this_machine_in_order(capsys):
    assert cli.main(["doctor"]) == 0
    told = capsys.readouterr().out
    assert "FAILED" not in told
    assert told.count(" OK ") == len(doctor.TESTS) == 7
    for words in (
        f"minimd         {md.__version__}",
        "numba ",
        "cores",
        "cache folder",
        "equal to the last bit",
        " µs",
        "million atom-steps/s on one thread",
    ):
        assert words in told


def test_no_layer_of_numba_is_used(capsys):
    """As doctor says: minimd's threads are its own."""
    doctor.same_bits()
    with pytest.raises(ValueError, match="not initialized"):
        numba.threading_layer()


def test_doctor_notices_a_wrong_force(capsys, monkeypatch):
    evaluate = md.evaluate

    def wrong(system, potentials):
        found = evaluate(system, potentials)
        found.forces[:] *= 1.001
        return found

    monkeypatch.setattr(doctor.md, "evaluate", wrong)
    assert cli.main(["doctor"]) == 1
    told = capsys.readouterr().out
    assert "forces         FAILED" in told
    assert "NOT work" in told


def test_doctor_notices_a_bit_that_depends_on_threads(monkeypatch):
    class Careless(md.Simulation):
        def __init__(self, *arguments, threads=None):
            super().__init__(*arguments, threads=threads)
            self.positions[0, 0] += 1e-15 * (threads == 2)

    monkeypatch.setattr(doctor.md, "Simulation", Careless)
    fine, sentence = doctor.same_bits()
    assert not fine
    assert sentence.endswith("2 from 1")


def test_doctor_notices_a_drift(monkeypatch):
    class Leaking(md.VelocityVerlet):
        def advance(self, state, compute_forces, n_steps, with_energy, surroundings, march):
            state.velocities[:] *= 0.9999
            surroundings.open_end = None
            return super().advance(state, compute_forces, n_steps, with_energy, surroundings, march)

    monkeypatch.setattr(doctor.md, "VelocityVerlet", Leaking)
    fine, sentence = doctor.conservation()
    assert not fine, sentence
