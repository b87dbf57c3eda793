"""ASE's own Lennard-Jones dynamics, and that of asap3 on ASE's atoms: engines that `minimd bench` compares with.

Å, eV, u and ASE's unit of time are σ, ε, m and τ here, so that the numbers of a scene in reduced units stay as they are.
"""

from ase import Atoms
from ase.calculators.lj import LennardJones
from ase.md.verlet import VelocityVerlet

from minimd.bench.scenes import CUTOFF, Scene, pairs_in_range
from minimd.structure.ase_atoms import atoms_from_system

ARGON = 18  # asap3 wants a chemical element; the masses remain those of the scene


class ASE:
    """ASE's calculator LennardJones and its VelocityVerlet; see minimd.bench.engines.Engine."""

    def __init__(self, scene: Scene, timestep: float) -> None:
        self.name, self.threads, self.precision = "ASE (serial)", 1, "double"
        self._scene, self._atoms = scene, atoms_from_system(scene.system)
        self._atoms.calc = LennardJones(sigma=1.0, epsilon=1.0, rc=CUTOFF, smooth=False)
        self._dynamics = VelocityVerlet(self._atoms, timestep)

    def potential_energy(self) -> float:
        """U [ε], without the shift that ASE's calculator gives each pair."""
        at_cutoff = 4.0 * (CUTOFF**-12 - CUTOFF**-6)
        return float(self._atoms.get_potential_energy()) + at_cutoff * pairs_in_range(self._scene, self._atoms.positions)

    def total_energy(self) -> float:
        """U + K [ε]."""
        return self.potential_energy() + float(self._atoms.get_kinetic_energy())

    def run(self, n_steps: int) -> None:
        """Make steps."""
        self._dynamics.run(n_steps)


class Asap:
    """asap3's calculator LennardJones and its compiled VelocityVerlet; see minimd.bench.engines.Engine."""

    def __init__(self, scene: Scene, timestep: float) -> None:
        import asap3
        from asap3.md.verlet import VelocityVerlet_Asap

        self.name, self.threads, self.precision = "asap3 (serial)", 1, "double"
        self._atoms = _argon(scene)
        self._atoms.calc = asap3.LennardJones([ARGON], 1.0, 1.0, rCut=CUTOFF, modified=False, verbose=False)
        self._dynamics = VelocityVerlet_Asap(self._atoms, timestep)  # ASE's, with the same calculator, takes twice as long

    def potential_energy(self) -> float:
        """U [ε] of the present positions."""
        return float(self._atoms.get_potential_energy())

    def total_energy(self) -> float:
        """U + K [ε] of the present state."""
        return self.potential_energy() + float(self._atoms.get_kinetic_energy())

    def run(self, n_steps: int) -> None:
        """Make steps."""
        self._dynamics.run(n_steps)


def _argon(scene: Scene) -> Atoms:
    """ASE's atoms that are argon by name and keep their masses."""
    atoms = atoms_from_system(scene.system)
    masses = atoms.get_masses()
    atoms.numbers[:] = ARGON
    atoms.set_masses(masses)
    return atoms
