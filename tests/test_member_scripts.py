"""Scripts whose functions no worker can import: they are told what to do."""

import os
import subprocess
import sys
from pathlib import Path


def script(tmp_path, text):
    (tmp_path / "script.py").write_text(text)
    paths = os.pathsep.join(map(str, (Path(__file__).parent, Path(__file__).parent.parent)))
    return subprocess.run(
        [sys.executable, "script.py"], cwd=tmp_path, env=os.environ | {"PYTHONPATH": paths}, capture_output=True, text=True, check=False
    )


def test_a_script_without_a_main_is_told_so(tmp_path):
    ended = script(tmp_path, "import minimd as md\nfrom members import liquid\nmd.ensemble(liquid, {'temperature': [0.5]}, 5, workers=1)\n")
    assert ended.returncode == 1
    assert "a worker process imports the script, which calls md.ensemble again" in ended.stderr
    assert ended.stderr.rstrip().endswith("put that call below a line: if __name__ == '__main__':")


def test_functions_of_a_notebook_are_not_sent_to_spawned_workers():
    code = "import minimd as md\ndef build(member): ...\nmd.ensemble(build, 2, 5, workers=1)"
    ended = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert "it was written in a session that no process can import. Define it with def at the top level of a file, and import it" in ended.stderr
