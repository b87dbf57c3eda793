"""Scripts that make ensembles: told what to do where no worker can import their functions; killed in the middle, they go on."""

import os
import signal
import subprocess
import sys
import time
from contextlib import suppress
from pathlib import Path

import numpy as np
import pytest


def script(tmp_path, text):
    (tmp_path / "script.py").write_text(text)
    paths = os.pathsep.join(map(str, (Path(__file__).parent, Path(__file__).parent.parent)))
    return subprocess.run(
        [sys.executable, "script.py"],
        cwd=tmp_path,
        env=os.environ | {"PYTHONPATH": paths},
        capture_output=True,
        text=True,
        check=False,
    )


def test_a_script_without_a_main_is_told_so(tmp_path):
    ended = script(
        tmp_path,
        "import minimd as md\nfrom members import liquid\nmd.ensemble(liquid, {'temperature': [0.5]}, 5, workers=1)\n",
    )
    assert ended.returncode == 1
    assert "a worker process imports the script, which calls md.ensemble again" in ended.stderr
    assert ended.stderr.rstrip().endswith("put that call below the line: if __name__ == '__main__':")


def test_functions_of_a_notebook_are_not_sent_to_spawned_workers():
    code = "import minimd as md\ndef build(member): ...\nmd.ensemble(build, 2, 5, workers=1)"
    ended = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert (
        "it was defined in a session, which other processes cannot import. Define it with def at the top level of a file, and import it"
        in ended.stderr
    )


KILLED = """
import sys, minimd as md
from members import TEMPERATURES, in_own_file, liquid, melted
if __name__ == "__main__":
    run = {"plain": None, "own": in_own_file}[sys.argv[1]]
    md.ensemble(liquid, TEMPERATURES, 20_000, prepare=melted, run=run, every=100, workers=2, folder=sys.argv[2], progress=False)
"""


def children_of(process):
    """Processes that were started by a process, workers of spawn among them."""
    found = []
    for task in Path(f"/proc/{process}/task").iterdir():
        found += map(int, (task / "children").read_text().split())
    return [one for one in found if b"spawn_main" in Path(f"/proc/{one}/cmdline").read_bytes()]


@pytest.mark.slow
@pytest.mark.skipif(sys.platform != "linux", reason="reads /proc")
@pytest.mark.parametrize("kind", ["plain", "own"])
@pytest.mark.parametrize("victims", ["parent", "worker", "both"])
def test_a_scan_that_is_killed_again_and_again_has_the_same_table(kind, victims, tmp_path):
    """kill -9 when files grow, and the next call at once."""
    paths = os.pathsep.join(map(str, (Path(__file__).parent, Path(__file__).parent.parent)))
    (tmp_path / "script.py").write_text(KILLED)
    rng = np.random.default_rng(1)

    def begun(folder):
        return subprocess.Popen(
            [sys.executable, "script.py", kind, folder], cwd=tmp_path, env=os.environ | {"PYTHONPATH": paths}
        )

    assert begun("whole").wait() == 0
    for _ in range(4):
        scan = begun("killed")
        before = sum(file.stat().st_size for file in tmp_path.glob("killed/*/*.h5md*"))
        while scan.poll() is None and sum(file.stat().st_size for file in tmp_path.glob("killed/*/*.h5md*")) == before:
            time.sleep(0.01)
        time.sleep(rng.uniform(0.0, 0.5))
        targets = children_of(scan.pid)[:1] if victims != "parent" and scan.poll() is None else []
        for process in [*targets, *([scan.pid] if victims != "worker" else [])]:
            with suppress(ProcessLookupError):
                os.kill(process, signal.SIGKILL)
        scan.wait()
    assert begun("killed").wait() == 0
    for name in ("table.csv", "table.json"):
        assert (tmp_path / "killed" / name).read_bytes() == (tmp_path / "whole" / name).read_bytes()
    assert not list(tmp_path.glob("killed/*/*.stopped.h5md"))
