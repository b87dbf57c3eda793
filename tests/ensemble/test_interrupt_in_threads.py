"""Members in threads of one process are interrupted as those in processes are."""

import os
import signal
import threading
from concurrent.futures import ThreadPoolExecutor

import members
import pytest

import minimd as md
from minimd.structure.errors import Interrupted


@pytest.mark.skipif(os.name == "nt", reason="there are no such signals")
def test_ctrl_c_ends_members_in_threads_after_a_whole_step(tmp_path):
    n_steps, begun = 10**7, threading.Event()

    def told(member):
        if not begun.is_set():
            begun.set()
            threading.Timer(0.5, os.kill, (os.getpid(), signal.SIGINT)).start()
        return members.liquid(member)

    with ThreadPoolExecutor(2) as pool, pytest.raises(Interrupted) as interrupted:
        md.ensemble(told, members.TEMPERATURES, n_steps, every=1000, executor=pool, folder=tmp_path, progress=False)
    found = interrupted.value.result
    assert set(found["status"]) == {"begun", "missing"}
    law = md.LennardJones(1.0, 1.0, 1.8)
    assert all(0 <= md.Simulation.resume(file, law).step < n_steps for file in found["file"][:2])
