"""The road of one step is as short as docs/architecture.md says."""

import re
import sys
from pathlib import Path

import pytest
from references import liquid
from scenes import LJ, Scene

REPOSITORY = Path(__file__).parents[2]
PACKAGE = REPOSITORY / "minimd"
PAGE = (REPOSITORY / "docs" / "architecture.md").read_text(encoding="utf-8")
FILES = re.compile(r"A step of a liquid is these (\d+) files, ([\d ]+) lines in all:\n\n```\n(.*?)```", re.S)


@pytest.fixture(scope="module")
def steady_steps():
    """Chains of minimd's functions, from Simulation.run on, that a few steps without a list build go through."""
    sim = Scene(liquid(6), [LJ], timestep=0.001).simulation(threads=1, skin=0.6)
    sim.run(4, every=4, progress=False)  # compiles, which would take long under a profiler
    n_builds, stack, chains = sim.engine.interactions.n_builds, [], []

    def profile(frame, event, _argument):
        if event == "call":
            stack.append((Path(frame.f_code.co_filename), frame.f_code.co_name))
            chains.append([one for one in stack if one[0].is_relative_to(PACKAGE)])
        elif event == "return" and stack:
            stack.pop()

    sys.setprofile(profile)
    try:
        sim.run(4, every=4, progress=False)
    finally:
        sys.setprofile(None)
    assert sim.engine.interactions.n_builds == n_builds
    named = [(chain, [name for _, name in chain]) for chain in chains]
    return [chain[names.index("run") :] for chain, names in named if "advance" in names]


def test_from_run_to_the_kernel_there_are_eight_functions(steady_steps):
    to_kernel = [chain for chain in steady_steps if (chain[-1][0].name, chain[-1][1]) == ("threads.py", "run")]
    assert to_kernel
    assert max(map(len, to_kernel)) <= 8, to_kernel[0]
    assert {"march", "add_to"} <= {name for chain in to_kernel for _, name in chain}
    for file, name in {place for chain in to_kernel for place in chain}:
        assert re.search(rf"`\w+\.{name}` \| `{file.relative_to(PACKAGE).as_posix()}`", PAGE), name


def test_the_page_lists_the_files_of_a_step_and_counts_their_lines(steady_steps):
    n_files, n_lines, table = FILES.search(PAGE).groups()
    files = re.findall(r"^(minimd/\S+\.py)", table, re.M)
    visited = {chain[-1][0].relative_to(REPOSITORY).as_posix() for chain in steady_steps}
    assert visited
    assert visited <= set(files), visited - set(files)
    assert len(files) == int(n_files)
    counted = sum((REPOSITORY / file).read_text(encoding="utf-8").count("\n") for file in files)
    assert counted == int(n_lines.replace(" ", ""))
