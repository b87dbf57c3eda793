"""A run that is read while it goes on: by a plain socket and by MDAnalysis; no reader changes it."""

import signal
import socket
import struct
import threading
import time
from contextlib import suppress

import numpy as np
import pytest
from h5md_runs import N_ATOMS, simulation
from wrong_calls import assert_answered

import minimd as md
from minimd.core.console.signals import stop_runs_of_threads
from minimd.mdanalysis import universe

ASE, KJ_PER_MOL = md.units.ASE, 96.48533  # of an eV
DISCONNECT, GO, KILL, FORCES, PAUSE, RATE, RESUME, WAIT = 0, 3, 5, 6, 7, 8, 11, 16
BODIES = (
    (12, 1, "=ddq"),
    (1, 1, "=i9f"),
    (13, 1, "=9f"),
    *((kind, N_ATOMS, f"={3 * N_ATOMS}f") for kind in (2, 14, 15)),
)
HOSTILE = [
    b"GET / HTTP/1.1\r\n\r\n", struct.pack("!ii", FORCES, 2**31 - 1), struct.pack("!ii", 99, -1), b"\0\0\0\3\0", b"",
    struct.pack("!ii", PAUSE, 0) * 10**5,
]  # fmt: skip


class Running:
    """A run of 27 atoms in a thread, which waits for a reader; a file beside it."""

    def __init__(self, path, n_steps=40):
        self.sim, self.stream = simulation("triclinic", ASE), md.observers.Stream(port=0, every=10, wait=True)
        self.path, self.n_steps, self.error = path, n_steps, None
        self.thread = threading.Thread(target=self.run, daemon=True)

    def run(self):
        try:
            kept = {"trajectory": self.path, "store_forces": True, "every": 10, "progress": False}
            self.sim.run(self.n_steps, observers=[self.stream], **kept)
        except BaseException as error:
            self.error = error

    def __enter__(self):
        self.thread.start()
        while self.stream.address.endswith(":0") and self.thread.is_alive():
            time.sleep(0.01)
        return self

    def __exit__(self, *failed):
        if failed[0]:
            stop_runs_of_threads()
        self.thread.join(60)

    def reader(self, *said):
        """A socket, after the handshake.  said : types and numbers of messages."""
        made = socket.create_connection(("localhost", int(self.stream.address.rpartition(":")[2])), timeout=30)
        expected = struct.pack("!i", 4) + struct.pack("=i", 3) + struct.pack("!ii7B", 10, 7, 1, 1, 1, 1, 0, 1, 1)
        assert made.recv(len(expected), socket.MSG_WAITALL) == expected
        made.sendall(struct.pack(f"!{len(said)}i", *said))
        return made


def frame_from(reader):
    """Step, time, [temperature, energies], box, positions, velocities, forces; None at the end."""
    found = []
    for kind, number, body in BODIES:
        if not (header := reader.recv(8, socket.MSG_WAITALL)):
            return None
        assert struct.unpack("!ii", header) == (kind, number)
        found.append(struct.unpack(body, reader.recv(struct.calcsize(body), socket.MSG_WAITALL)))
    (_, now, step), (same, *energies), *vectors = found
    assert same == step
    return step, now, energies[:3], *(np.reshape(one, (-1, 3)) for one in vectors)


def assert_are_in_file(path, frames):
    """The file has the numbers of the frames; those of float32 are the same."""
    for (step, now, energies, box, *vectors), ts in zip(frames, universe(path).trajectory, strict=True):
        expected = [ts.data["temperature"], *(ts.data[f"{one}_energy"] * KJ_PER_MOL for one in ("total", "potential"))]
        np.testing.assert_allclose([now, *energies], [ts.time, *expected], rtol=1e-6)
        np.testing.assert_allclose(box, ts.triclinic_dimensions, rtol=1e-6, atol=1e-5)
        assert step == ts.data["step"]
        np.testing.assert_array_equal(vectors, (ts.positions, ts.velocities, ts.forces))


def test_a_socket_reads_what_the_file_has(tmp_path, capsys):
    with Running(tmp_path / "a.h5md") as run:
        address, reader = run.stream.address, run.reader(GO, 0)
        frames = [*iter(lambda: frame_from(reader), None)]
    assert f"waits for a reader at {address}\n" in capsys.readouterr().err
    assert [frame[0] for frame in frames] == [0, 10, 20, 30, 40]
    assert_are_in_file(run.path, frames)


def test_mdanalysis_reads_what_the_file_has(tmp_path):
    pytest.importorskip("imdclient")
    before, frames = {number: signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM)}, []
    with Running(tmp_path / "a.h5md") as run:
        for ts in universe(simulation("triclinic", ASE)).load_new(run.stream.address).trajectory:
            energies = [ts.data[name] for name in ("temperature", "total_energy", "potential_energy")]
            vectors = ts.positions.copy(), ts.velocities.copy(), ts.forces.copy()
            frames.append((ts.data["step"], ts.time, energies, ts.triclinic_dimensions, *vectors))
    for number, handler in before.items():
        signal.signal(number, handler)  # imdclient has set its own
    assert_are_in_file(run.path, frames)


@pytest.mark.filterwarnings("ignore:a reader of")
def test_readers_pause_a_run_choose_its_frames_leave_vanish_and_end_it(tmp_path):
    with Running(tmp_path / "a.h5md", 10**6) as run:
        first = run.reader(GO, 0, PAUSE, 0)
        first.settimeout(0.2)
        with pytest.raises(TimeoutError):
            first.recv(1)
        first.settimeout(30)
        first.sendall(struct.pack("!4i", RATE, 25, RESUME, 0))
        assert [frame_from(first)[0] for _ in range(3)] == [0, 25, 50]
        first.sendall(struct.pack("!ii", DISCONNECT, 0))
        second = run.reader(GO, 0)
        seen = [frame_from(second)[0] for _ in range(3)]
        assert np.diff(seen).tolist() == [10, 10]
        second.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("ii", 1, 0))  # as one that is killed
        second.close()
        run.reader(GO, 0, KILL, 0).recv(1)
    assert isinstance(run.error, KeyboardInterrupt)
    assert md.Simulation.resume(run.path, run.sim.potentials).step == run.sim.step > seen[-1]


def test_a_reader_that_ends_the_run_and_leaves_while_a_frame_is_made_is_heard(monkeypatch):
    sim, stream = simulation("triclinic", ASE), md.observers.Stream(port=0)
    stream.prepare(sim.engine)
    reader = socket.create_connection(("localhost", int(stream.address.rpartition(":")[2])))
    reader.sendall(struct.pack("!ii", GO, 0))
    monkeypatch.setattr(sim.engine, "evaluate", lambda: (reader.sendall(struct.pack("!ii", KILL, 0)), reader.close()))
    with pytest.warns(UserWarning, match="has ended the run"):
        stream.observe(sim.engine)
    stream.end(sim.engine)


def test_hostile_readers_are_disconnected_and_hurt_nobody(tmp_path, recwarn):
    with Running(tmp_path / "a.h5md") as run:
        for said in HOSTILE:
            bad = run.reader()
            with suppress(ConnectionError):
                bad.sendall(said)
                assert bad.recv(1) == b""
        assert frame_from(run.reader(GO, 0, WAIT, 0))[0] == 0
    assert (run.error, run.sim.step) == (None, 40)
    told = " ".join(str(one.message) for one in recwarn)
    assert all(word in told for word in ("forces", "IMDv3", "asked for frames"))


def test_a_run_without_a_reader_does_not_wait_and_is_resumed_to_the_same_bits(tmp_path):
    path, sim, plain = tmp_path / "a.h5md", *(simulation("triclinic", ASE) for _ in range(2))
    sim.run(20, every=10, trajectory=path, observers=[md.observers.Stream(port=0)])
    assert md.read_observers(path) == {}
    again = md.Simulation.resume(path, sim.potentials)
    again.run(until_step=40, every=10, trajectory=path, append=True, observers=[md.observers.Stream(port=0)])
    plain.run(40, every=10)
    np.testing.assert_array_equal(again.positions, plain.positions)


def test_wrong_streams_are_refused(tmp_path):
    with socket.create_server(("localhost", 0)) as taken:
        looking = md.observers.Stream(port := taken.getsockname()[1])
        assert_answered(lambda: simulation().run(1, observers=[looking]), OSError, str(port), "port=")
    nowhere, one = md.observers.Stream(0, host="\0"), md.observers.Stream(0)
    assert_answered(lambda: simulation().run(1, observers=[nowhere]), OSError, "host=", r"\x00")
    with Running(tmp_path / "run.h5md") as run:
        assert_answered(lambda: simulation().run(1, observers=[run.stream]), ValueError, "Stream(port=0", "another run")
        run.reader(GO, 0, WAIT, 0).close()  # it still listens
    assert_answered(lambda: simulation().run(1, observers=[one, one]), ValueError, "Stream(port=0)", "twice")
    assert_answered(lambda: simulation().run(1, observers=[md.observers.Stream]), TypeError, "observers", "Stream")
    for name, value in [("port", 70000), ("every", 0), ("host", 5), ("host", ""), ("wait", "no")]:
        assert_answered(lambda: md.observers.Stream(**{name: value}), ValueError, name, str(value))


@pytest.mark.filterwarnings("ignore:a reader of")
def test_a_run_that_waits_for_another_reader_says_so(tmp_path, capsys):
    with Running(tmp_path / "a.h5md", 10**6) as run:
        first = run.reader(GO, 0)
        frame_from(first)
        capsys.readouterr()
        first.sendall(struct.pack("!4i", WAIT, 1, DISCONNECT, 0))
        until = time.monotonic() + 20.0
        while "waits for a reader" not in (said := capsys.readouterr().err) and time.monotonic() < until:
            time.sleep(0.05)
        run.reader(GO, 0, KILL, 0).recv(1)
    assert said.count("waits for a reader") == 1
