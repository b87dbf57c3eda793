"""ASE's own Lennard-Jones dynamics, and that of asap3 on ASE's atoms:
engines with which `minimd bench` compares minimd.

Å, eV, u and ASE's unit of time stand for σ, ε, m and τ here,
so that the numbers of a scene in reduced units do not change.
"""

from typing import Any

from ase import Atoms
from ase.calculators.lj import LennardJones
from ase.md.verlet import VelocityVerlet

from minimd.structure.ase_atoms import atoms_from_system
from minimd_bench.scenes import CUTOFF, SHIFT, BenchScene, pairs_in_range

ARGON = 18  # asap3 needs a chemical element; the masses are those of the scene


class OnASE:
    """An engine on ASE's atoms and dynamics; see minimd_bench.engines.TimedEngine."""

    threads, precision = 1, "double"

    def __init__(self, name: str, atoms: Atoms, dynamics: Any) -> None:
        self.name, self._atoms, self._dynamics = name, atoms, dynamics

    def potential_energy(self) -> float:
        """U [ε] of the present positions."""
        return float(self._atoms.get_potential_energy())

    def total_energy(self) -> float:
        """U + K [ε] of the present state."""
        return self.potential_energy() + float(self._atoms.get_kinetic_energy())

    def run(self, n_steps: int) -> None:
        """Make n_steps steps."""
        self._dynamics.run(n_steps)


class ASE(OnASE):
    """ASE's calculator LennardJones and its VelocityVerlet."""

    def __init__(self, scene: BenchScene, timestep: float) -> None:
        atoms = atoms_from_system(scene.system)
        atoms.calc = LennardJones(sigma=1.0, epsilon=1.0, rc=CUTOFF, smooth=False)
        super().__init__("ASE (serial)", atoms, VelocityVerlet(atoms, timestep))
        self._scene = scene

    def potential_energy(self) -> float:
        """U [ε], without the shift that ASE's calculator adds for each pair."""
        return super().potential_energy() + SHIFT * pairs_in_range(self._scene, self._atoms.positions)


def asap(scene: BenchScene, timestep: float) -> OnASE:
    """asap3's calculator LennardJones and its compiled VelocityVerlet;
    ASE's VelocityVerlet with this calculator takes twice as long."""
    import asap3
    from asap3.md.verlet import VelocityVerlet_Asap

    atoms = atoms_from_system(scene.system)
    masses = atoms.get_masses()
    atoms.numbers[:] = ARGON
    atoms.set_masses(masses)
    atoms.calc = asap3.LennardJones([ARGON], 1.0, 1.0, rCut=CUTOFF, modified=False, verbose=False)
    return OnASE("asap3 (serial)", atoms, VelocityVerlet_Asap(atoms, timestep))


ENGINES = {"ase": ASE, "asap3": asap}
