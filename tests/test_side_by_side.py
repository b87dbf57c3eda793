"""Small scenes in compiled code: lists and baths without Python, and replicas in threads of one process, have the bits of single runs."""

import os
import signal
import threading
from concurrent.futures import ThreadPoolExecutor
from functools import partial

import members
import numpy as np
import pytest
from cluster_scenes import SMOOTH

import minimd as md
from minimd.compiled.normal_numbers import normal_numbers
from minimd.forces.cluster_term import ClusterTerm
from minimd.neighbors.cluster_list import ClusterList
from minimd.structure.errors import Interrupted
from minimd.structure.lattice import crystal

BATH, FREE = partial(md.LangevinBAOAB, 0.004, 1.2, 2.0, seed=2**100 + 7), partial(md.VelocityVerlet, 0.004)


def gas(method, precision="double", seed=1, **options):
    """108 atoms of three species."""
    positions, edges = crystal("fcc", [3, 3, 3], 1.9)
    system = md.System(positions, cell=edges, species=["A", "B", "C", "A"] * (len(positions) // 4))
    simulation = md.Simulation(system, SMOOTH["three species"], method, precision=precision, threads=1, **options)
    simulation.set_temperature(1.5, seed)
    return simulation


def ending(simulation, n_steps=150):
    """Positions, velocities, energy given by a bath, numbers of evaluations and list builds."""
    simulation.run(n_steps, every=50, progress=False)
    return (
        simulation.positions,
        simulation.velocities,
        simulation.reservoir_energy,
        simulation.engine.interactions.counts,
    )


def assert_same_bits(one, other):
    assert all(np.array_equal(a, b) for a, b in zip(one, other, strict=True))


def test_noise_has_the_bits_of_numpy():
    """Its rare branches too: numbers at the edges of layers and in the tail."""
    seed, step, contact, numbers = 2**100 + 12345678901234567, -3, 2, np.empty((5, 200_000))
    normal_numbers(np.array([seed % 2**64, seed >> 64], dtype=np.uint64), step, contact, numbers)
    for k, row in enumerate(numbers):
        counter = np.array([0, 0, contact, (step + k) % 2**64], dtype=np.uint64)
        assert np.array_equal(
            row, np.random.Generator(np.random.Philox(key=seed, counter=counter)).standard_normal(row.size)
        )
    assert np.abs(numbers).max() > 3.66  # in the tail


@pytest.mark.parametrize(
    ("method", "precision"),
    [(FREE, "double"), (BATH, "double"), (FREE, "fixed-point")],
    ids=["free", "bath", "fixed-point"],
)
def test_lists_built_in_a_kernel_have_the_bits_of_those_that_python_builds(method, precision, monkeypatch):
    """After the first list the memory becomes so scarce that the next build must be left to Python, too."""
    enlarged, make_room = [], ClusterList._make_room
    monkeypatch.setattr(ClusterList, "_make_room", lambda self: enlarged.append(self.n_builds) or make_room(self))
    inside, outside = gas(method(), precision), gas(method(), precision)
    inside.run(1, progress=False)
    outside.run(1, progress=False)
    found = inside.engine.interactions.terms[0].list
    found._entry_start[-1] = found._needed[0]
    inside = ending(inside)
    assert 1 in enlarged
    monkeypatch.setattr(ClusterList, "can_be_renewed", False)
    assert_same_bits(inside, ending(outside))
    assert inside[3][1] > 3


def test_lists_of_a_strained_cell_that_a_kernel_builds_have_the_bits_of_those_that_python_builds(monkeypatch):
    """Columns move with the cell, in their memory; lists are built for every cell but a few, some in the kernel."""
    bath, before, after = md.StochasticCellRescaling(3.0, 0.1, 0.2, seed=2, every=7, coupling="triclinic"), [], []
    build = ClusterList._build
    monkeypatch.setattr(
        ClusterList, "_build", lambda self, positions, cell: before.append(cell) or build(self, positions, cell)
    )
    inside = gas(BATH(), barostat=bath)
    ended = ending(inside)
    monkeypatch.setattr(ClusterList, "can_be_renewed", False)
    monkeypatch.setattr(
        ClusterList, "_build", lambda self, positions, cell: after.append(cell) or build(self, positions, cell)
    )
    outside = gas(BATH(), barostat=bath)
    assert_same_bits(ended, ending(outside))
    assert np.array_equal(inside.system.cell.vectors, outside.system.cell.vectors)
    assert len(before) < len(after)
    anew = md.evaluate(inside.system, inside.potentials)
    assert inside.forces == pytest.approx(anew.forces, rel=1e-10, abs=1e-10)


def test_a_bath_in_the_kernel_has_the_bits_of_one_outside(monkeypatch):
    inside = ending(gas(BATH()))
    monkeypatch.setattr(ClusterTerm, "marches", False)
    assert_same_bits(inside, ending(gas(BATH())))
    assert inside[2] != 0.0


def test_another_process_of_a_derived_bath_is_not_left_out():
    """The kernel makes the steps of LangevinBAOAB only."""

    class Frozen(md.LangevinBAOAB):
        def thermalize(self, state, duration, around):
            state.velocities[:] = 0.0

    simulation = gas(Frozen(0.004, 1.0, 1.0, 1))
    start = simulation.positions.copy()
    simulation.run(20, progress=False)
    assert np.abs(simulation.positions - start).max() < 0.01


def test_replicas_in_threads_have_the_bits_of_single_runs():
    def replica(seed):
        return ending(gas((BATH if seed % 2 else FREE)(), seed=seed), 300)

    with ThreadPoolExecutor(3) as pool:
        together = list(pool.map(replica, range(6)))
    for seed, one in enumerate(together):
        assert_same_bits(one, replica(seed))


@pytest.mark.skipif(os.name == "nt", reason="there are no such signals")
def test_ctrl_c_ends_members_in_threads_after_a_whole_step(tmp_path):
    n_steps, begun = 10**7, threading.Event()

    def told(member):
        begun.set()
        return members.liquid(member)

    def interrupt():
        begun.wait()
        threading.Event().wait(0.5)
        os.kill(os.getpid(), signal.SIGINT)

    threading.Thread(target=interrupt, daemon=True).start()
    with ThreadPoolExecutor(2) as pool, pytest.raises(Interrupted) as interrupted:
        md.ensemble(told, members.TEMPERATURES, n_steps, every=1000, executor=pool, folder=tmp_path, progress=False)
    assert set(interrupted.value.result["status"]) == {"begun", "missing"}
    assert all(
        0 <= md.Simulation.resume(file, md.LennardJones(1.0, 1.0, 1.8)).step < n_steps
        for file in interrupted.value.result["file"][:2]
    )
