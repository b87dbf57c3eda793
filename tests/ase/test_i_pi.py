"""i-PI's protocol: a server that moves atoms gets energy, forces and stress as from a calculator that is called."""

import os
import threading

import numpy as np
import pytest
from argon_atoms import argon, lennard_jones, same, with_calculator
from ase.calculators.socketio import SocketClient, SocketServer

from minimd.ase import Calculator

BEADS = np.random.default_rng(4).normal(0.0, 0.15, (4, 32, 3))  # Å, of one ring: a client computes them in turn
ROUNDING = 1e-11  # the protocol has numbers in hartree and bohr; sums over 32 atoms


@pytest.mark.parametrize("pbc", [True, False])
def test_a_client_of_the_protocol_gives_what_the_calculator_gives(pbc):
    atoms = argon(2)
    atoms.pbc = pbc
    client = with_calculator(atoms, Calculator(lennard_jones()))
    direct = with_calculator(atoms, Calculator(lennard_jones()))
    address = f"minimd-test-{os.getpid()}-{pbc}"

    with SocketServer(unixsocket=address, timeout=60) as server:
        connection = SocketClient(unixsocket=address, timeout=60)
        answering = threading.Thread(target=connection.run, args=(client, True))  # with stress
        answering.start()
        try:
            for turn in range(3):
                for bead in BEADS:
                    direct.set_cell(atoms.cell.array * (1.0 + 0.01 * turn), scale_atoms=False)
                    direct.positions[:] = atoms.positions * (1.0 + 0.01 * turn) + bead
                    answer = server.calculate(direct)
                    stress = direct.get_stress(voigt=False)
                    assert same(answer["energy"], direct.get_potential_energy(), ROUNDING)
                    assert same(answer["forces"], direct.get_forces(), ROUNDING)
                    assert same(answer["virial"], -direct.get_volume() * stress, ROUNDING)
        finally:
            server.protocol.end()
            answering.join(60)
    assert not answering.is_alive()
