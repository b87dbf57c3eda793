"""A plugin of pytest for ASE's own tests: minimd's classes stand where ASE's stood, before a test module is imported.

    pytest -p ases_tests_with_minimd --pyargs ase.test.md.test_bussi

MINIMD_CALCULATOR=1 puts minimd's Calculator in the place of EMT as well: Lennard-Jones with parameters of metals."""

import importlib
import os
import sys

import ase.calculators.emt
import ase.md

import minimd as md
import minimd.ase

PLACES = {"VelocityVerlet": "verlet", "Langevin": "langevin", "LangevinBAOAB": "langevinbaoab", "Bussi": "bussi"}
PLACES |= {"NoseHooverChainNVT": "nose_hoover_chain", "Andersen": "andersen", "NVTBerendsen": "nvtberendsen"}
METALS = {"Cu": (0.409, 2.338), "Ag": (0.345, 2.644), "Au": (0.449, 2.637), "Pt": (0.694, 2.542), "Al": (0.392, 2.620)}
for name, module in PLACES.items():
    ours = getattr(minimd.ase, name)
    setattr(importlib.import_module(f"ase.md.{module}"), name, ours)
    if hasattr(ase.md, name):
        setattr(ase.md, name, ours)
if os.environ.get("MINIMD_CALCULATOR"):
    law = md.LennardJones(METALS, cutoff=6.0, truncation="force-shifted")
    ase.calculators.emt.EMT = lambda: minimd.ase.Calculator(law)


def pytest_terminal_summary(terminalreporter):
    tested = [m for name, m in sys.modules.items() if name.startswith("ase.test.") and hasattr(m, "__file__")]
    found = [(m, name) for m in tested for name in PLACES if hasattr(m, name)]
    left = [f"{m.__name__}.{name}" for m, name in found if getattr(m, name) is not getattr(minimd.ase, name)]
    terminalreporter.write_line(f"not minimd's: {', '.join(left) or 'none'}")
