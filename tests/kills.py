"""Runs that are stopped somewhere, and processes that are killed at work."""

import os
import signal
import time
import traceback

import numpy as np
from references import liquid
from scenes import BONDED, LJ

import minimd as md
from minimd.integrators.methods import METHODS
from minimd.structure.lattice import crystal

CALLS = ("pwrite", "fsync", "ftruncate", "replace", "link", "unlink", "open")  # of os, by which minimd changes files


def simulation(system, laws, method=None, constraints=None, **options):
    made = md.Simulation(system, laws, method or md.VelocityVerlet(0.003), constraints, **{"threads": 1, **options})
    made.set_temperature(1.2, 3)
    return made


def plain(method=None, **options):
    return simulation(liquid(3), LJ, method, **options)


def rigid(method=None, **options):
    """Dumbbells and single atoms."""
    system, pairs = liquid(3), np.arange(108).reshape(-1, 2)[5:]
    bonded = md.System(system.positions, cell=system.cell, bonds=pairs)
    return simulation(bonded, BONDED, method, [md.DistanceConstraints(pairs)], **options)


def springs(method=None, **options):
    """Two lists: bonded pairs are scaled in one law and not in the other; fixed atoms; open along z."""
    system, pairs = liquid(3), np.arange(108).reshape(-1, 2)
    slab = md.System(system.positions, cell=system.cell.vectors, pbc=(True, True, False), bonds=pairs)
    return simulation(slab, [LJ, BONDED, md.HarmonicBond(20.0, 1.1)], method, [md.FixedAtoms([0, 7])], **options)


def few(method=None, **options):
    """Too few for clusters, without a cell."""
    return simulation(md.System(crystal("fcc", (2, 2, 2), 1.6)[0][:27]), LJ, method, **options)


SCENES = {"plain": plain, "rigid": rigid, "springs": springs, "few": few}


def method_of(name):
    of = METHODS[name]
    return of(0.003, 1.2, 0.7, seed=4) if of.is_thermostat else of(0.003)


def at_work(work):
    """The number of a child process that does work."""
    child = os.fork()
    if child == 0:
        signal.alarm(300)  # it ends, too, where the tests were ended before it
        try:
            work()
        except Exception:
            traceback.print_exc()
        finally:
            os._exit(0)
    return child


def killed_at(k, work):
    """Do work in a child process that dies, as by kill -9, before its k-th change of a file; None if it was killed."""
    child = at_work(lambda: (_die_at(k), work()))
    status = os.waitpid(child, 0)[1]
    return None if os.WIFSIGNALED(status) else os.WEXITSTATUS(status)


def killed_after(seconds, work):
    """Do work in a child process, and kill it after some seconds; whether it was still at work."""
    child = at_work(work)
    time.sleep(seconds)
    os.kill(child, signal.SIGKILL)
    status = os.waitpid(child, 0)[1]
    time.sleep(0.05)  # children of its own die a moment later
    return os.WIFSIGNALED(status)


def _die_at(k):
    """Die at the k-th change of a file by this process; its children, which only read, live on."""
    n_changes, process = [0], os.getpid()

    def counted(call):
        def changed(*arguments, **options):
            n_changes[0] += 1
            if n_changes[0] == k and os.getpid() == process:
                os.kill(os.getpid(), signal.SIGKILL)
            return call(*arguments, **options)

        return changed

    for name in CALLS:
        setattr(os, name, counted(getattr(os, name)))
