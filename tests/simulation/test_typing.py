"""A script with types is clean to mypy --strict, which finds mistakes in the words of choices."""

import subprocess
import sys
from pathlib import Path

import pytest

import minimd as md

SCRIPT = """
import numpy as np
from numpy.typing import NDArray
import minimd as md
Array = NDArray[np.float64]
class Weight(md.Term):
    def add(self, system: md.System, detail: int, forces: Array, energies: Array, virials: Array) -> None:
        forces[:, 2] -= 9.81 * system.masses
class Gravity:
    def bind(self, system: md.System) -> Weight:
        return Weight()
def look(sim: md.Simulation) -> None:
    print(sim.step, sim.temperature, sim.stress[0, 0])
system = md.System(np.arange(6.0).reshape(2, 3), cell=10.0, species=["Ar", "Ar"], bonds=[(0, 1)], units=md.units.LJ)
lj = md.LennardJones(1.0, 1.0, cutoff=2.5, truncation="force-shifted")
potentials = [lj, md.HarmonicBond(100.0, 1.0), md.Tabulated(np.arange(1.0, 7.0), {("Ar", "Ar"): np.ones(6)})]
sim = md.Simulation(system, potentials, md.VelocityVerlet(0.005), precision="fixed-point")
other = md.Simulation(system, [lj, Gravity()], md.LangevinBAOAB(0.005, 1.0, 1.0, seed=1))
record = sim.run(100, every=10, observers=[look], progress=False)
energies: Array = record.total_energy
record.plot().savefig("a.png")
record.to_csv("a.csv").unlink()
drift: float = sim.report().energy_drift.slope
forces: Array = md.evaluate(system, lj).forces
total: float = sim.pressure + sim.potential_energy
is_done: bool = md.minimize(system, potentials).converged
"""
MISTAKES = {  # lines, and what mypy says of each
    "md.Simulation(system, 3, md.VelocityVerlet(0.1))": '"int"; expected "Potential | Sequence[Potential]"',
    'md.LennardJones(1.0, 1.0, 2.5, "cut")': "Literal['cut']",
    'md.Simulation(system, lj, md.VelocityVerlet(0.1), precision="half")': "Literal['half']",
    'md.LennardJones({"A": (1.0, 1.0)}, mixing="mean")': "Literal['mean']",
}


@pytest.mark.slow
def test_a_script_of_a_user_is_clean_to_mypy_strict_and_mistakes_are_found(tmp_path):
    pytest.importorskip("mypy")
    (tmp_path / "script.py").write_text(SCRIPT + "\n".join(MISTAKES))
    command = [sys.executable, "-m", "mypy", "--strict", "--cache-dir", str(tmp_path), "script.py"]
    environment = {"PYTHONPATH": str(Path(md.__file__).parents[1]), "PATH": ""}
    done = subprocess.run(command, capture_output=True, text=True, check=False, cwd=tmp_path, env=environment)
    *told, _ = done.stdout.splitlines()
    for k, (line, words) in enumerate(zip(told, MISTAKES.values(), strict=True), SCRIPT.count("\n") + 1):
        assert line.startswith(f"script.py:{k}: error")
        assert words in line
