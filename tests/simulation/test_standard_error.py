"""Standard error may be missing, closed, or an object of the host's: no run minds."""

import pytest
from processes import ended

STREAMS = {
    "without isatty": "class W:\n    write = flush = lambda *_: None\nsys.stderr = W()",
    "without anything": "sys.stderr = object()",
    "closed": "sys.stderr.close()",
    "missing": "sys.stderr = None",
    "broken": "class W:\n    def __getattr__(self, name): raise OSError('gone')\nsys.stderr = W()",
}
RUN = """
import sys
import minimd as md
from minimd.core.compiled import kernels
from minimd.core.console import signals
{stream}
kernels._tell_of_compilation()
system = md.System([[0, 0, 0], [1.2, 0, 0]])
for progress in (False, None, True):
    sim = md.Simulation(system, md.LennardJones(1.0, 1.0, 2.5), md.VelocityVerlet(0.1))  # a warning: too long a step
    sim.run(20, progress=progress)
    sim.equilibrate(2, 1.0, progress=progress)
    sim.minimize(progress=progress)
signals.tell_ending(signals.Terminated(15, "stopped"))
sys.stderr = sys.__stderr__  # which Python flushes at the end
print(sim.step)
"""


@pytest.mark.parametrize("name", STREAMS)
def test_a_run_needs_no_standard_error(name):
    process = ended("-c", RUN.format(stream=STREAMS[name]))
    assert (process.returncode, process.stdout) == (0, "0\n"), process.stderr
