"""Judges the dynamics of ASE, minimd, OpenMM and LAMMPS, and writes the table of docs/dynamics.md.

    python docs/measure_dynamics.py

Engines that are not installed are left out. Every row is one call of md.grade, which the table repeats.
"""

import ctypes
import re
import sys
from functools import partial
from importlib.util import find_spec
from pathlib import Path

import ase.md.andersen
import ase.md.bussi
import ase.md.langevin
import ase.md.langevinbaoab
import ase.md.nose_hoover_chain
import ase.md.nptberendsen
import ase.md.nvtberendsen
import ase.md.verlet
from ase.units import fs
from engines import Lammps, OpenMM

import minimd as md

PAGE, T, P, RATE = Path(__file__).parent / "dynamics.md", {"temperature_K": 300.0}, 0.002, 0.02 / fs
LANGEVIN = T | {"friction": RATE}
OF_ASE = (
    (ase.md.verlet.VelocityVerlet, {}),
    (ase.md.langevin.Langevin, LANGEVIN),
    (ase.md.langevin.Langevin, LANGEVIN | {"fixcm": False}),
    (ase.md.langevinbaoab.LangevinBAOAB, T | {"T_tau": 50 * fs}),
    (ase.md.andersen.Andersen, T | {"andersen_prob": 0.02}),
    (ase.md.bussi.Bussi, T | {"taut": 50 * fs}),
    (ase.md.nose_hoover_chain.NoseHooverChainNVT, T | {"tdamp": 50 * fs}),
    (ase.md.nvtberendsen.NVTBerendsen, T | {"taut": 50 * fs}),
    (ase.md.langevinbaoab.LangevinBAOAB,
     T | {"T_tau": 50 * fs, "P_tau": 100 * fs, "externalstress": -P, "hydrostatic": True}),
    (ase.md.nose_hoover_chain.IsotropicMTKNPT, T | {"pressure_au": P, "tdamp": 50 * fs, "pdamp": 100 * fs}),
    (ase.md.nptberendsen.NPTBerendsen,
     T | {"pressure_au": P, "taut": 50 * fs, "taup": 100 * fs, "compressibility_au": 1.0 / P}),
)  # fmt: skip
OF_MINIMD = (
    (md.VelocityVerlet, {"kind": "dynamics"}),
    (md.LangevinBAOAB, LANGEVIN),
    (md.StochasticVelocityRescaling, T | {"relaxation_time": 50 * fs}),
)
OF_OPENMM = (
    ("VerletIntegrator", {}),
    ("LangevinIntegrator", LANGEVIN),
    ("LangevinMiddleIntegrator", LANGEVIN),
    ("NoseHooverIntegrator", LANGEVIN),
)
OF_LAMMPS = (
    (["nve"], {}),
    (["nve", "langevin 300 300 0.05 SEED"], T),
    (["nve", "langevin 300 300 0.05 SEED zero yes"], T),
    (["nve", "temp/csvr 300 300 0.05 SEED"], T),
    (["nve", "temp/berendsen 300 300 0.05"], T),
    (["nvt temp 300 300 0.05"], T),
)


def shown(name, value):
    """An option, times in fs."""
    if name in ("T_tau", "P_tau", "taut", "taup", "tdamp", "pdamp"):
        return f"{name}={value / fs:.3g} fs"
    if name == "friction":
        return f"{name}={value * fs:.3g}/fs"
    return f"{name}={value:.3g}" if isinstance(value, float) else f"{name}={value}"


def rows():
    """Name, options as text, and the call of each row."""
    for made, options in OF_ASE:
        said = ", ".join(shown(name, value) for name, value in options.items())
        yield f"ase: `{made.__name__}`", said, partial(md.grade, made, **options)
    for method, options in OF_MINIMD:
        yield f"minimd: `{method.__name__}`", "", partial(md.grade, method, **options)
    for name, options in OF_OPENMM if find_spec("openmm") else ():
        yield f"OpenMM: `{name}`", "", partial(md.grade, OpenMM, integrator=name, **options)
    for fixes, claims in OF_LAMMPS if find_spec("lammps") else ():
        yield f"LAMMPS: `fix {'`, `fix '.join(fixes)}`", "", partial(md.grade, Lammps, fixes=fixes, **claims)


def main():
    """Write the table."""
    for library in sorted(Path(sys.prefix, "lib").glob("libmpi.so.*")):  # that the wheel of LAMMPS needs
        ctypes.CDLL(str(library), mode=ctypes.RTLD_GLOBAL)
    lines = ["| dynamics | options | claims | momentum | what was found |", "| --- | --- | --- | --- | --- |"]
    for name, options, call in rows():
        try:
            grade = call()
        except ValueError as error:
            print(name, error, file=sys.stderr)
            continue
        claims, momentum = (
            grade.function.rsplit(": ", 1)[1].split(",")[0],
            grade.remarks[0].split(": ")[0].split(" is ")[1],
        )
        faults = "; ".join(dict.fromkeys(re.sub("^(coarse )?(ring|gas): ", "", one) for one in grade.faults))
        lines.append(f"| {name} | {options} | {claims} | {momentum} | {faults or 'all laws hold'} |")
        print(lines[-1], flush=True)
    text = PAGE.read_text(encoding="utf-8")
    start, end = (
        text.index(mark) + len(mark) * (k == 0) for k, mark in enumerate(("<!-- table -->\n", "<!-- end -->"))
    )
    PAGE.write_text(text[:start] + "\n".join(lines) + "\n" + text[end:], encoding="utf-8")


if __name__ == "__main__":
    main()
