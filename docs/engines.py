"""Other engines as classes of dynamics, to be judged by md.grade: see dynamics.md.

Each takes atoms, a time step and the options of its row; run(steps) moves the atoms. Units are those of ASE.
"""

import os
from functools import cache, partial
from importlib import import_module
from types import SimpleNamespace

import numpy as np
from ase import units

FS, PS = units.fs, 1000.0 * units.fs
EV = 96.48533212331  # an eV in kJ/mol
KCAL = units.kcal / units.mol


def seed_from(rng):
    """A seed from the generator of a run."""
    return int(rng.randint(1, 900_000_000))


def hand_over(atoms, x, v):
    """Positions and velocities of an engine to atoms."""
    atoms.positions[:] = x
    atoms.set_velocities(np.asarray(v))


def openmm_system(atoms):
    """Masses and bonds, which keep their directions, as a System of OpenMM."""
    import openmm as mm

    springs, system = atoms.calc, mm.System()
    force = mm.CustomCompoundBondForce(2, "0.5*k*s + 0.25*q*s^2; s = (x2-x1-a)^2 + (y2-y1-b)^2 + (z2-z1-c)^2")
    for name in "kqabc":
        force.addPerBondParameter(name)
    bonds = zip(springs.first, springs.second, springs.k, springs.q, springs.lengths, strict=True)
    for i, j, k, q, length in bonds:
        force.addBond([int(i), int(j)], [1e2 * EV * k, 1e4 * EV * q, *(0.1 * length)])
    for mass in atoms.get_masses():
        system.addParticle(mass)
    system.addForce(force)
    return system


class OpenMM:
    """OpenMM.  integrator : the name of a class of (temperature, friction, time step), or of the time step alone; one
    of openmmtools' chains takes the System before them."""

    def __init__(self, atoms, timestep, integrator, temperature_K=None, friction=0.0, rng=np.random, module="openmm"):
        import openmm as mm

        self.atoms, system = atoms, openmm_system(atoms)
        ps, kelvin = mm.unit.picosecond, mm.unit.kelvin
        bath = () if temperature_K is None else (temperature_K * kelvin, PS * friction / ps)
        bath = (system, *bath) if integrator.startswith("NoseHooverChain") else bath
        self.stepper = getattr(import_module(module), integrator)(*bath, timestep / PS * ps)
        if hasattr(self.stepper, "setRandomNumberSeed"):
            self.stepper.setRandomNumberSeed(seed_from(rng))
        self.context = mm.Context(system, self.stepper, mm.Platform.getPlatformByName("Reference"))
        self.context.setPositions(0.1 * atoms.positions)
        self.context.setVelocities(0.1 * PS * atoms.get_velocities())

    def run(self, steps):  # noqa: D102 - as of any dynamics
        self.stepper.step(steps)
        state = self.context.getState(getPositions=True, getVelocities=True)
        x, v = state.getPositions(asNumpy=True)._value, state.getVelocities(asNumpy=True)._value
        hand_over(self.atoms, 10.0 * x, 10.0 / PS * v)


OpenMMTools = partial(OpenMM, module="openmmtools.integrators")
BOX = """units metal
atom_modify map array sort 0 0
comm_modify cutoff 50
boundary m m m
region all block 0 99 0 99 0 99
pair_style zero 1.0
create_box"""


class Lammps:
    """LAMMPS, with forces of the calculator.  fixes : what they are, as "nve" or "langevin 300 300 0.05 SEED"."""

    def __init__(self, atoms, timestep, fixes, temperature_K=None, rng=np.random):
        from lammps import lammps

        self.atoms, n, seed = atoms, len(atoms), str(seed_from(rng))
        self.lmp = lammps(cmdargs=["-log", "none", "-screen", "none"])
        self.lmp.commands_string(f"{BOX} {n} all\npair_coeff * *\ntimestep {timestep / PS}")
        self.lmp.commands_list([f"mass {k} {mass}" for k, mass in enumerate(atoms.get_masses(), 1)])
        types = [*range(1, n + 1)]
        self.lmp.create_atoms(n, types, types, atoms.positions.ravel(), (PS * atoms.get_velocities()).ravel())
        self.lmp.command("fix forces all external pf/callback 1 1")
        self.lmp.set_fix_external_callback("forces", self.add, None)
        self.lmp.commands_list([f"fix {k} all {fix.replace('SEED', seed)}" for k, fix in enumerate(fixes)])
        self.lmp.command("run 0 post no")

    def add(self, _caller, _step, _n, tags, x, f):  # noqa: D102 - forces, as LAMMPS asks for them
        order = np.argsort(tags)
        self.atoms.positions[:] = x[order]
        f[order] = self.atoms.get_forces()

    def run(self, steps):  # noqa: D102
        self.lmp.command(f"run {steps} pre no post no")
        x, v, tags = (self.lmp.numpy.extract_atom(name)[: len(self.atoms)] for name in ("x", "v", "id"))
        order = np.argsort(tags)
        hand_over(self.atoms, x[order], v[order] / PS)


@cache
def jax_functions(springs, simulator, **options):
    """The two functions of a simulator of JAX MD, for the bonds of a calculator."""
    import jax
    from jax_md import simulate

    jax.config.update("jax_enable_x64", True)

    def energy(x, **_):
        e = x[springs.second] - x[springs.first] - springs.lengths
        r2 = (e * e).sum(axis=1)
        return (0.5 * springs.k * r2 + 0.25 * springs.q * r2**2).sum()

    start, step = getattr(simulate, simulator)(energy, lambda x, dx, **_: x + dx, **options)
    return start, jax.jit(lambda state, steps: jax.lax.fori_loop(0, steps, lambda _, now: step(now), state))


class JaxMD:
    """JAX MD.  simulator : a function of jax_md.simulate, of which `options` are arguments."""

    def __init__(self, atoms, timestep, simulator, temperature_K=None, rng=np.random, **options):
        kt = {} if temperature_K is None else {"kT": units.kB * temperature_K}
        start, self.advance = jax_functions(atoms.calc, simulator, dt=timestep, **kt, **options)
        from jax.random import PRNGKey

        self.atoms, more = atoms, {} if kt else {"kT": 1.0}
        motion = {"mass": atoms.get_masses(), "momenta": atoms.get_momenta()}
        self.state = start(PRNGKey(seed_from(rng)), atoms.positions, **motion, **more)

    def run(self, steps):  # noqa: D102
        self.state = self.advance(self.state, steps)
        hand_over(self.atoms, self.state.position, self.state.momentum / self.state.mass)


@cache
def torch_springs(springs):
    """Energy, forces and stress of the bonds of a calculator, of x (N, 3) and a volume, for PyTorch."""
    import torch

    first, second = torch.as_tensor(springs.first), torch.as_tensor(springs.second)
    k, q, lengths = (torch.as_tensor(values) for values in (springs.k, springs.q, springs.lengths))

    def compute(x, volume=1.0):
        d = x[second] - x[first]
        e = d - lengths if lengths.ndim == 2 else (1.0 - lengths / d.norm(dim=1))[:, None] * d
        r2 = (e * e).sum(dim=1)
        pull = (k + q * r2)[:, None] * e
        forces = torch.zeros_like(x).index_add_(0, first, pull).index_add_(0, second, -pull)
        return (0.5 * k * r2 + 0.25 * q * r2**2).sum()[None], forces, (d.T @ pull)[None] / volume

    return compute


class TorchSim:
    """TorchSim.  integrator : as "nvt_langevin".  start : arguments of nvt_langevin_init; options : of _step."""

    def __init__(
        self, atoms, timestep, integrator, temperature_K=300.0, pressure=None, start=(), rng=np.random, **options
    ):
        import torch
        import torch_sim
        from torch_sim import integrators

        def model(state):
            answer = springs(state.positions, state.volume[0])
            return dict(zip(("energy", "forces", "stress"), answer, strict=True))

        self.atoms, springs = atoms, torch_springs(atoms.calc)
        model.device, model.dtype = torch.device("cpu"), torch.float64
        state = torch_sim.initialize_state(atoms, model.device, model.dtype)
        state.momenta = torch.tensor(atoms.get_momenta())
        state.rng = seed_from(rng)
        common = {"model": model, "dt": timestep, "kT": units.kB * temperature_K}
        begin = getattr(integrators, integrator.replace("crescale_isotropic", "crescale") + "_init")
        self.state = begin(state, **common, **dict(start))
        load = {} if pressure is None else {"external_pressure": pressure}
        self.step = partial(getattr(integrators, f"{integrator}_step"), **common, **load, **options)

    def run(self, steps):  # noqa: D102
        for _ in range(steps):
            self.state = self.step(state=self.state)
        self.atoms.set_cell(self.state.row_vector_cell[0].numpy())
        hand_over(self.atoms, self.state.positions, self.state.momenta / self.state.masses[:, None])


class TorchMD:
    """TorchMD's only integrator: velocity Verlet, and with a temperature friction and noise."""

    def __init__(self, atoms, timestep, temperature_K=None, friction=None, rng=np.random):
        import torch
        from torchmd import integrator

        def compute(x, _box, forces):
            energy, new, _ = springs(x[0])
            forces[:] = new / KCAL
            return [float(energy) / KCAL]

        torch.manual_seed(seed_from(rng))
        self.atoms, springs, self.unit = atoms, torch_springs(atoms.calc), FS * integrator.TIMEFACTOR
        x, v = torch.tensor(atoms.positions)[None], self.unit * torch.tensor(atoms.get_velocities())[None]
        masses = torch.tensor(atoms.get_masses())[:, None]
        self.system = SimpleNamespace(pos=x, vel=v, box=None, forces=torch.zeros_like(x), masses=masses)
        compute(x, None, self.system.forces)
        forces = SimpleNamespace(compute=compute)
        rate = friction and PS * friction
        self.stepper = integrator.Integrator(self.system, forces, timestep / FS, "cpu", rate, temperature_K)

    def run(self, steps):  # noqa: D102
        self.stepper.step(steps)
        hand_over(self.atoms, self.system.pos[0], self.system.vel[0] / self.unit)


class Hippynn:
    """hippynn.  updater : a class of hippynn.molecular_dynamics."""

    def __init__(self, atoms, timestep, updater, temperature_K=None, friction=None, rng=np.random):
        import torch
        from hippynn.molecular_dynamics import md

        def model(positions, batch_size):
            return {"forces": springs(positions[0])[1][None]}

        model.inputs = []
        springs, masses = torch_springs(atoms.calc), torch.tensor(atoms.get_masses())[None]
        x, v = torch.tensor(atoms.positions)[None], FS * torch.tensor(atoms.get_velocities())[None]
        bath = {"temperature_K": temperature_K, "frix": FS * (friction or 0.0), "seed": seed_from(rng)}
        updater = getattr(md, updater)("forces", **(bath if friction else {}))
        acceleration = model(x, None)["forces"] / masses[..., None] * FS**2
        data = {"position": x, "velocity": v, "acceleration": acceleration, "mass": masses}
        self.variable = md.Variable("atoms", data, {"positions": "position"}, updater)
        self.dynamics = md.MolecularDynamics([self.variable], model)
        self.atoms, self.timestep = atoms, timestep / FS

    def run(self, steps):  # noqa: D102
        for _ in range(steps):  # its own run draws a bar of progress
            self.dynamics._step(self.timestep)
        hand_over(self.atoms, self.variable.data["position"][0], self.variable.data["velocity"][0] / FS)


@cache
def nvalchemi_model(springs):
    """The bonds of a calculator as a model of nvalchemi."""
    import torch
    from nvalchemi.models.base import BaseModelMixin, ModelConfig

    class Model(torch.nn.Module, BaseModelMixin):
        embedding_shapes = compute_embeddings = None

        def __init__(self):
            super().__init__()
            own = {"energy", "forces", "stress"}
            self.model_config = ModelConfig(outputs=frozenset(own), autograd_outputs=frozenset())
            self.model_config.active_outputs = own

        def forward(self, data):
            energy, forces, stress = torch_springs(springs)(data.positions, torch.linalg.det(data.cell[0]))
            return {"energy": energy[:, None], "forces": forces, "stress": stress}

    return Model()


class NVAlchemi:
    """NVIDIA's ALCHEMI toolkit.  integrator : a class of nvalchemi.dynamics; options : of it, in ASE's units."""

    def __init__(self, atoms, timestep, integrator, rng=np.random, temperature_K=None, **options):
        import torch
        from nvalchemi import dynamics
        from nvalchemi.data import AtomicData, Batch

        data = AtomicData.from_atoms(atoms, dtype=torch.float64)
        data.velocities = torch.tensor(atoms.get_velocities())
        data.forces = torch.zeros_like(data.velocities)
        self.batch = Batch.from_data_list([data])
        if temperature_K is not None:
            options["temperature"] = temperature_K
        options |= {name: time / FS for name, time in options.items() if name.endswith("_time")}
        if "friction" in options:
            options |= {"friction": FS * options["friction"], "random_seed": seed_from(rng)}
        self.dynamics = getattr(dynamics, integrator)(nvalchemi_model(atoms.calc), timestep / FS, **options)
        self.atoms = atoms

    def run(self, steps):  # noqa: D102
        self.dynamics.run(self.batch, steps)
        self.atoms.set_cell(self.batch.cell[0].numpy())
        hand_over(self.atoms, self.batch.positions, self.batch.velocities)


class IPI:
    """i-PI.  dynamics : XML of its dynamics, such as "<dynamics mode='nve'></dynamics>".
    fixcom : whether i-PI keeps the center of mass at rest, its own default."""

    def __init__(self, atoms, timestep, dynamics, fixcom=True, temperature_K=300.0, rng=np.random):
        from ipi import scripting
        from ipi.utils.units import unit_to_internal

        def compute(cell, x):
            atoms.positions[:] = x.reshape(-1, 3) / self.length
            return atoms.get_potential_energy() * energy, atoms.get_forces() * energy / self.length, 0.0 * cell, ""

        names = ("length", "momentum", "energy", "mass")
        self.length, self.momentum, energy, mass = (unit_to_internal(name, "ase", 1.0) for name in names)
        self.atoms, springs = atoms, scripting.forcefield_xml("springs", pes="dummy")
        dynamics = dynamics.replace(">", f"> <timestep units='ase'> {timestep} </timestep>", 1)
        motion = f"<motion mode='dynamics'> <fixcom> {fixcom} </fixcom> {dynamics} </motion>"
        xml = scripting.simulation_xml(atoms, springs, motion, temperature_K, output="<output></output>")
        xml = xml.replace("<system>", f"<prng> <seed> {seed_from(rng)} </seed> </prng> <system>", 1)
        self.simulation = scripting.InteractiveSimulation(xml)
        self.simulation.chk.stride = 2**62  # it writes no RESTART
        self.simulation.fflist["springs"].driver.compute_structure = compute
        self.beads = self.simulation.syslist[0].beads
        self.beads.m[:] = mass * atoms.get_masses()
        self.beads.p[0] = self.momentum * atoms.get_momenta().ravel()

    def run(self, steps):  # noqa: D102
        self.simulation.run(steps, write_outputs=False)
        self.atoms.positions[:] = self.beads.q[0].reshape(-1, 3) / self.length
        self.atoms.set_momenta(self.beads.p[0].reshape(-1, 3) / self.momentum)


class PySCF:
    """PySCF.  integrator : a class of pyscf.md.integrators."""

    def __init__(self, atoms, timestep, integrator, temperature_K=None, taut=0.0):
        from pyscf import gto, lib
        from pyscf.md import integrators

        class Scanner(lib.GradScanner):
            converged, mol = True, gto.M(atom=[("H", x) for x in atoms.positions], verbose=0, output=os.devnull)

            def __init__(self):
                pass

            def __call__(self, mol):
                atoms.positions[:] = mol.atom_coords() * units.Bohr
                return atoms.get_potential_energy() / units.Ha, -atoms.get_forces() / units.Ha * units.Bohr

        atomic_time = units._aut * units.s
        masses = atoms.get_masses() * units._amu / units._me
        own = {"_masses": property(lambda _: masses, lambda *_: None)}  # instead of those of the elements
        bath = {"T": temperature_K, "taut": taut / atomic_time} if taut else {}
        integrator = type(integrator, (getattr(integrators, integrator),), own)
        self.dynamics = integrator(Scanner(), dt=timestep / atomic_time, **bath)
        self.atoms = atoms
        self.unit = units.Bohr / atomic_time
        self.dynamics.kernel(veloc=atoms.get_velocities() / self.unit, steps=1)  # the first only computes forces

    def run(self, steps):  # noqa: D102
        self.dynamics.kernel(steps=steps)
        hand_over(self.atoms, self.dynamics.mol.atom_coords() * units.Bohr, self.dynamics.veloc * self.unit)
