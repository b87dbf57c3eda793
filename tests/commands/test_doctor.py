"""minimd doctor: it finds this machine in order, and notices what is not."""

import os

import numba
import pytest

import minimd as md
from minimd.commands import doctor
from minimd.commands import main as cli
from minimd.compiled import kernels as compiling
from minimd.compiled.code_cache import CodeFiles


class Careless(md.Simulation):
    def __init__(self, *arguments, threads=None):
        super().__init__(*arguments, threads=threads)
        self.positions[0, 0] += 1e-15 * (threads == 2)


class Leaking(md.VelocityVerlet):
    def advance(self, state, compute_forces, n_steps, with_energy, surroundings, march):
        state.velocities[:] *= 0.9999
        surroundings.open_end = None
        return super().advance(state, compute_forces, n_steps, with_energy, surroundings, march)


def test_doctor_finds_this_machine_in_order(capsys):
    assert cli.main(["doctor"]) == 0
    told = capsys.readouterr().out
    assert "FAILED" not in told
    assert told.count(" OK ") == len(doctor.TESTS) == 7
    for words in (f"minimd         {md.__version__}", "numba ", "equal to the last bit", "million atom-steps/s on one"):
        assert words in told
    doctor.same_bits()
    with pytest.raises(ValueError, match="not initialized"):  # as doctor says: minimd's threads are its own
        numba.threading_layer()


@pytest.mark.skipif(os.name == "nt", reason="signals of POSIX")
def test_doctor_outlives_a_test_that_crashes_and_goes_on(capsys, monkeypatch):
    monkeypatch.setattr(doctor, "TESTS", {"crash": os.abort, "cache folder": doctor.cache})
    assert cli.main(["doctor"]) == 1
    crashed, cache, conclusion = capsys.readouterr().out.splitlines()[-3:]
    assert crashed.startswith("crash          FAILED")
    assert cache.startswith("cache folder   OK")
    assert "NOT work" in conclusion


def test_doctor_finds_damaged_compiled_code_and_loads_nothing_of_it(tmp_path, monkeypatch):
    monkeypatch.setattr(compiling, "cache_folder", lambda: tmp_path)
    (tmp_path / "forces").mkdir()
    files = CodeFiles(str(tmp_path / "forces"), "twice", "now")
    for signature in ("floats", "integers"):
        files.save(signature, f"code for {signature}")
    (tmp_path / "forces" / "gone.nbi").symlink_to(tmp_path / "nowhere")  # as one that another process has just replaced
    assert doctor.cache() == (True, str(tmp_path))
    file = tmp_path / "forces" / files._load_index()["floats"]
    code = bytearray(file.read_bytes())
    code[-3] ^= 1
    file.write_bytes(code)
    fine, sentence = doctor.cache()
    assert fine
    assert (sentence.startswith(str(tmp_path)), sentence.endswith(": 1")) == (True, True)
    assert doctor.cache() == (True, str(tmp_path))
    assert (files.load("floats"), files.load("integers")) == (None, "code for integers")


def test_doctor_notices_wrong_forces_bits_that_depend_on_threads_and_drifts(monkeypatch):
    evaluate = md.evaluate

    def wrongly(system, potentials):
        found = evaluate(system, potentials)
        found.forces[:] *= 1.001
        return found

    wrong = {"evaluate": wrongly, "Simulation": Careless, "VelocityVerlet": Leaking}
    tests = (doctor.gradient, doctor.same_bits, doctor.conservation)
    for (name, one), test in zip(wrong.items(), tests, strict=True):
        with monkeypatch.context() as patch:
            patch.setattr(doctor.md, name, one)
            fine, sentence = test()
        assert not fine, sentence
        assert name != "Simulation" or sentence.endswith("2 from 1")
