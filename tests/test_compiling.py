"""The cache of compiled code: found again, never stale, in any place that can be written."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

import minimd
from minimd.compiled import kernels as compiling

RUN = """
import numpy as np, minimd as md
from minimd.forces.pair_list_term import gather
md.evaluate(md.System([[0, 0, 0], [1.1, 0, 0]]), md.LennardJones(1.0, 1.0, 2.5))
from minimd.potentials.pair_loop import add_pair_forces as loop
print(sum(loop.stats.cache_hits.values()), sum(loop.stats.cache_misses.values()))
"""


def run(environment, code=RUN):
    clean = {k: v for k, v in os.environ.items() if k not in ("NUMBA_CACHE_DIR", "XDG_CACHE_HOME", "HOME")}
    clean["PYTHONPATH"] = str(Path(minimd.__file__).parents[1])
    return subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False, env={**clean, **environment})


def test_second_process_compiles_nothing(tmp_path):
    first, second = (run({"NUMBA_CACHE_DIR": str(tmp_path)}) for _ in range(2))
    assert first.stdout.split() == ["0", "1"], first.stderr
    assert second.stdout.split() == ["1", "0"], second.stderr


def test_a_home_that_cannot_be_written_is_no_obstacle(tmp_path):
    (tmp_path / "file").write_text("in the way")
    answer = run({"HOME": str(tmp_path / "file"), "TMPDIR": str(tmp_path)})
    assert answer.returncode == 0, answer.stderr


def test_two_processes_may_start_on_an_empty_cache(tmp_path):
    clean = {**os.environ, "NUMBA_CACHE_DIR": str(tmp_path), "PYTHONPATH": str(Path(minimd.__file__).parents[1])}
    both = [subprocess.Popen([sys.executable, "-c", RUN], env=clean, stdout=subprocess.PIPE, stderr=subprocess.PIPE) for _ in range(2)]
    for process in both:
        _, errors = process.communicate(timeout=200)
        assert process.returncode == 0, errors


def test_edited_sources_get_another_cache(tmp_path, monkeypatch):
    (tmp_path / "minimd").mkdir()
    (tmp_path / "minimd" / "law.py").write_text("a = 1")
    monkeypatch.setattr(compiling, "__file__", str(tmp_path / "minimd" / "compiling.py"))
    before = compiling._source_hash()
    (tmp_path / "minimd" / "law.py").write_text("a = 2")
    assert compiling._source_hash() != before


@pytest.mark.skipif(not hasattr(os, "getuid"), reason="POSIX permissions")
def test_a_cache_that_others_can_write_is_not_used(tmp_path):
    tmp_path.chmod(0o777)
    assert not compiling._is_mine(tmp_path)
    tmp_path.chmod(0o700)
    assert compiling._is_mine(tmp_path)
