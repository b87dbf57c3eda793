"""The road of one step is as short as docs/architecture.md says."""

import re
import sys
from pathlib import Path

from references import liquid
from scenes import LJ, Scene

import minimd as md

REPOSITORY = Path(__file__).parents[2]
PACKAGE = Path(md.__file__).parent  # installed, or in the repository


def steady_steps():
    """Chains of minimd's Python functions, from Simulation.run on, that a few steps without a list build go through."""
    sim = Scene(liquid(6), [LJ], timestep=0.001).simulation(threads=1, skin=0.6)
    sim.run(4, every=4, progress=False)  # compiles, which would take long under a profiler
    n_builds = sim.engine.interactions.n_builds
    stack, chains = [], []

    def profile(frame, event, _argument):
        if event == "call":
            stack.append((frame.f_code.co_filename, frame.f_code.co_name))
            chains.append([one for one in stack if Path(one[0]).is_relative_to(PACKAGE)])
        elif event == "return" and stack:
            stack.pop()

    sys.setprofile(profile)
    try:
        sim.run(4, every=4, progress=False)
    finally:
        sys.setprofile(None)
    assert sim.engine.interactions.n_builds == n_builds
    with_names = [(chain, [name for _, name in chain]) for chain in chains]
    return [chain[names.index("run") :] for chain, names in with_names if "advance" in names]


def files_of_the_road():
    """The files that docs/architecture.md lists as those of a step, and the number of lines it gives them."""
    text = (REPOSITORY / "docs" / "architecture.md").read_text(encoding="utf-8")
    listed = re.search(r"A step of a liquid is these (\d+) files, ([\d ]+) lines in all:\n\n```\n(.*?)```", text, re.S)
    return int(listed[1]), int(listed[2].replace(" ", "")), re.findall(r"^(minimd/\S+\.py)", listed[3], re.M)


def test_from_run_to_the_kernel_there_are_eight_functions():
    to_kernel = [chain for chain in steady_steps() if chain[-1][1] == "run" and chain[-1][0].endswith("threads.py")]
    assert to_kernel
    assert max(len(chain) for chain in to_kernel) <= 8, to_kernel[0]
    architecture = (REPOSITORY / "docs" / "architecture.md").read_text(encoding="utf-8")
    assert {"march", "add_to"} <= {name for chain in to_kernel for _, name in chain}
    for file, name in {place for chain in to_kernel for place in chain}:
        assert re.search(rf"`\w+\.{name}` \| `{Path(file).relative_to(PACKAGE).as_posix()}`", architecture), name


def test_the_page_lists_the_files_of_a_step_and_counts_their_lines():
    n_files, n_lines, files = files_of_the_road()
    visited = {f"minimd/{Path(chain[-1][0]).relative_to(PACKAGE).as_posix()}" for chain in steady_steps()}
    assert visited
    assert visited <= set(files), visited - set(files)
    assert len(files) == n_files
    assert sum((REPOSITORY / file).read_text(encoding="utf-8").count("\n") for file in files) == n_lines
