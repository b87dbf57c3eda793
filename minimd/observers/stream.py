"""A run that other programs read while it goes on: a server of the protocol IMDv3, which MDAnalysis understands."""

from __future__ import annotations

import socket
import struct
from contextlib import suppress
from math import gcd
from time import monotonic, sleep
from typing import Any

import numpy as np
from numpy.typing import NDArray

from minimd.core.compiled.terminal import tell
from minimd.core.console.display import call_of
from minimd.core.console.quiet import warn
from minimd.core.console.words import shown
from minimd.core.engine.engine import Engine
from minimd.core.engine.observation import Look
from minimd.core.engine.observer import PeriodicObserver
from minimd.core.structure.checks import checked_count, checked_flag

# types of messages
DISCONNECT, ENERGIES, COORDINATES, GO, HANDSHAKE, KILL, PUSH, PAUSE, RATE = range(9)
SESSION, RESUME, TIME, BOX, VELOCITIES, FORCES, WAIT = range(10, 17)
HEADER = struct.Struct("!ii")  # of a message: its type, and a number
VERSION = 3
PORTS = 2**16
MOST_STEPS = 2**31 - 1
READ = 4096  # bytes that are taken at once from a reader; how many it says that it sends does not matter
NAP = 0.005  # seconds between two attempts, where the run waits for a reader
SECONDS_TO_GO = 1.0  # after the handshake, as the protocol demands
PATIENCE = 60.0  # seconds with a reader that takes nothing and has not asked for a pause
KEEP_ALIVE = 5  # s of silence, s between two attempts, attempts
FAREWELL = 2.0  # seconds for the reader to take the last frames, after the run


class Stream(PeriodicObserver):
    """Sends a run to a reader while it goes on, by the protocol IMDv3 of the package imdclient: with MDAnalysis,

        sim.run(100_000, observers=[md.observers.Stream(every=10)])

        universe.load_new("imd://localhost:8888")       # in another process

    A frame has step and time, temperature, total and potential energy, the cell if it has three vectors, positions (not
    wrapped), velocities and forces, in float32 and the units of the protocol: ps, K, kJ/mol, Å. Numbers in reduced
    units are sent as they are. The parts of the potential energy, of which the protocol has six, are NaN.

    One reader at a time; when it has gone, the next one may come. No reader changes a bit of the run. No frame is left
    out: the run waits for a slow reader, as long as it asks for a pause or takes something within a minute. A reader
    can change the number of steps between frames, and end the run as Ctrl-C does. Forces from a reader are refused.

    Parameters
    ----------
    port : of TCP; 0 for any that is free, see address.
    every : steps between two frames.
    host : the name or address at which it listens. Whoever reaches it can pause and end the run, without a password.
    wait : whether the run waits until a reader has come, and again when it has gone; a reader may change it.

    Raises ValueError for arguments out of range; when a run begins, OSError if the port cannot be opened.
    """

    def __init__(
        self, port: int = 8888, every: int = 10, host: str = "localhost", wait: bool = False
    ) -> None:
        if not isinstance(host, str) or not host:
            raise ValueError(
                f"host must be a name or an address, such as 'localhost'; host = {shown(host)}"
            )
        self.port = checked_count("port", port, 0, PORTS)
        self.host = host
        self.wait = checked_flag("wait", wait)
        self._given = checked_count("every", every)
        self._listener: socket.socket | None = None
        self._engine: Engine | None = None
        self._reader: socket.socket | None = None
        self._heard = b""
        self._part_with_reader()

    def __repr__(self) -> str:
        arguments = {"port": self.port, "every": self._given, "host": self.host, "wait": self.wait}
        return call_of(self, arguments)

    @property
    def address(self) -> str:
        """What a reader opens, such as imd://localhost:8888."""
        port = self._listener.getsockname()[1] if self._listener else self.port
        return f"imd://{self.host}:{port}"

    @property
    def needs_energy(self) -> bool:
        """Whether somebody reads."""
        return self._has_gone

    def prepare(self, engine: Engine) -> None:
        """Listen, and wait for a reader if asked to.
        Raises OSError without a port, ValueError in a second run."""
        if self._engine is not None:
            raise ValueError(
                f"{self!r} is in another run, or twice in this one: give each run a Stream of its own"
            )

        try:
            self._listener = socket.create_server((self.host, self.port), backlog=1)
        except (OSError, TypeError) as error:  # a name that is too long is a TypeError
            reason = getattr(error, "strerror", "") or error
            where = f"port {self.port} of {shown(self.host)}"
            advice = "pass host=, or port=, 0 for any that is free"
            raise OSError(f"{where} cannot be opened: {reason}; {advice}") from error

        self._engine = engine
        self._listener.setblocking(False)
        cell = engine.system.cell
        self._has_box = bool(cell.pbc.any() and np.linalg.det(cell.vectors) != 0.0)
        # time, energies, box, coordinates, are they wrapped, velocities, forces
        contents = bytes([1, 1, self._has_box, 1, 0, 1, 1])
        self._greeting = struct.pack("!i", HANDSHAKE) + struct.pack("=i", VERSION)
        self._greeting += HEADER.pack(SESSION, len(contents)) + contents
        self._frame = empty_frame(len(engine.positions), self._has_box)
        self._waits = self.wait
        self._attend(engine)

    def observe(self, engine: Engine) -> None:
        """Do what the reader asks for, and send it the present state if it is due."""
        self._attend(engine)
        if not self._has_gone or engine.step % self._rate:
            return
        self._fill(engine)
        rest = memoryview(self._frame.view(np.uint8).data)
        since = monotonic()

        while rest and self._reader is not None:
            try:
                rest = rest[self._reader.send(rest) :]
                since = monotonic()
            except BlockingIOError:
                self._hear(engine)
                since = monotonic() if self._is_paused else since
                if engine.surroundings.stop_requested:
                    self._part_with_reader()
                elif monotonic() - since > PATIENCE:
                    self._part_with_reader(f"has taken nothing for {PATIENCE:.0f} s")

                sleep(NAP)
            except OSError:
                self._hear(engine)  # its last message
                self._part_with_reader()

    def end(self, engine: Engine) -> None:
        """The run of an engine has ended: let the reader take what was sent, and close the port."""
        if self._engine is not engine:  # another run has this stream
            return
        self._engine = None
        if self._listener is not None:
            self._listener.close()
            self._listener = None
        if self._reader is not None:
            # closed at once, with messages that nobody has read, the last frames are lost
            with suppress(OSError):
                self._reader.shutdown(socket.SHUT_WR)
                self._reader.settimeout(FAREWELL)
                until = monotonic() + FAREWELL
                while monotonic() < until and self._reader.recv(READ):
                    pass
            self._part_with_reader()

    def _attend(self, engine: Engine) -> None:
        """Hear the reader, and wait as long as it has paused the run, or the run is to wait for one."""
        is_told = False
        while True:
            self._hear(engine)
            is_to_wait = self._is_paused or (self._waits and not self._has_gone)
            if not is_to_wait or engine.surroundings.stop_requested:
                return
            if self._reader is None and not is_told:
                is_told = True
                tell(f"minimd: the run waits for a reader at {self.address}")
            sleep(NAP)

    def _hear(self, engine: Engine) -> None:
        """Welcome a reader if there is none, and do what it asks for."""
        try:
            if self._reader is None and self._listener is not None:
                self._reader, _ = self._listener.accept()
                self._reader.setblocking(False)
                # its machine may vanish
                self._reader.setsockopt(socket.SOL_SOCKET, socket.SO_KEEPALIVE, 1)

                for name in ("TCP_KEEPIDLE", "TCP_KEEPINTVL", "TCP_KEEPCNT"):
                    option = getattr(socket, name, None)
                    if option is not None:  # not every system can be told
                        self._reader.setsockopt(socket.IPPROTO_TCP, option, KEEP_ALIVE)

                self._reader.sendall(self._greeting)
                self._go_until = monotonic() + SECONDS_TO_GO

            heard = b"" if self._reader is None else self._reader.recv(READ)
            if not heard:
                return self._part_with_reader()
            self._heard += heard
        except BlockingIOError:
            pass
        except OSError:
            return self._part_with_reader()

        while self._reader is not None and len(self._heard) >= HEADER.size:
            kind, value = HEADER.unpack_from(self._heard)
            self._heard = self._heard[HEADER.size :]
            self._obey(kind, value, engine)

        if self._reader is not None and not self._has_gone and monotonic() > self._go_until:
            self._part_with_reader("has not asked for frames")

    def _obey(self, kind: int, value: int, engine: Engine) -> None:
        """Do what a message asks for."""
        if kind == GO:
            self._has_gone = True
        elif kind in (PAUSE, RESUME):
            self._is_paused = kind == PAUSE
        elif kind == WAIT:
            self._waits = value != 0
        elif kind == RATE:
            self._rate = value if value > 0 else self._given
            self.every = gcd(self._rate, self._given)
        elif kind == KILL:
            engine.surroundings.stop_requested = True
            self._part_with_reader("has ended the run")
        elif kind == DISCONNECT:
            self._part_with_reader()
        elif kind == PUSH:
            self._part_with_reader("has sent forces, which no run takes")
        else:
            self._part_with_reader("does not speak IMDv3")

    def _part_with_reader(self, reason: str = "") -> None:
        """Close the connection, if there is one, and be ready for the next.
        reason : to be told, if there is one."""
        if self._reader is not None:
            self._reader.close()
            self._reader = None
        self._heard = b""
        self._has_gone = False
        self._is_paused = False
        # frames are at multiples of rate, looks at those of every
        self._rate = self._given
        self.every = self._given
        if reason:
            # even if warnings are errors, no reader ends a run with one
            with suppress(UserWarning):
                warn(f"a reader of {self!r} {reason}; it is disconnected")

    def _fill(self, engine: Engine) -> None:
        """Put the present state into the frame."""
        engine.evaluate()
        look = Look(engine)
        units = engine.system.units
        frame = self._frame
        length = units.to_angstrom
        time = units.to_picosecond
        energy = units.to_kj_per_mol
        frame["clock"][0] = engine.method.duration * time, engine.time * time
        frame["step"] = engine.step
        frame["step_of_energies"] = min(engine.step, MOST_STEPS)
        energies = (look.temperature, look.total_energy * energy, look.potential_energy * energy)

        with np.errstate(over="ignore"):  # infinite where float32 is too small
            frame["energies"][0, :3] = energies
            for name, array, factor in (
                ("box", engine.system.cell.vectors, length),
                ("positions", engine.positions, length),
                ("velocities", engine.velocities, length / time),
                ("forces", engine.forces, energy / length),
            ):
                if name != "box" or self._has_box:
                    np.multiply(array, factor, out=frame[name][0], casting="unsafe")


def empty_frame(n_atoms: int, has_box: bool) -> NDArray[Any]:
    """The messages of a frame as one record, (1,), with their headers filled in."""
    of_atoms = {COORDINATES: "positions", VELOCITIES: "velocities", FORCES: "forces"}
    bodies: dict[int, list[tuple]] = {
        TIME: [("clock", "f8", 2), ("step", "i8")],
        ENERGIES: [("step_of_energies", "i4"), ("energies", "f4", 9)],
    }
    if has_box:
        bodies[BOX] = [("box", "f4", (3, 3))]
    for kind, name in of_atoms.items():
        bodies[kind] = [(name, "f4", (n_atoms, 3))]
    fields: list[tuple] = []
    for kind, body in bodies.items():
        fields += [(f"header {kind}", ">i4", 2), *body]
    frame = np.zeros(1, fields)
    for kind in bodies:
        frame[f"header {kind}"] = kind, n_atoms if kind in of_atoms else 1
    frame["energies"] = np.nan
    return frame
