"""Processes that tests start, in which minimd and the modules of this folder can be imported."""

import os
import subprocess
import sys
from pathlib import Path

PATHS = os.pathsep.join(map(str, Path(__file__).parents[:2]))


def ended(*command, folder=None, **environment):
    """A command that has ended: what follows `python`, unless it begins with another program."""
    command = command if isinstance(command[0], Path) else (sys.executable, *command)
    where = os.environ | {"PYTHONPATH": PATHS} | environment
    return subprocess.run(command, cwd=folder, env=where, capture_output=True, text=True, timeout=300)
