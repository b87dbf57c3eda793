"""ASE's thermostats with the steps made by minimd. Arguments, defaults, attributes and setters are those of ASE's classes, their bases.

Noise is minimd's: its paths are not those of ASE's classes, its distributions are. Each class draws one seed from its rng, when the first step
is made; equal rngs make equal runs.
"""

import functools
from typing import Any

import ase.md.andersen
import ase.md.bussi
import ase.md.langevin
import ase.md.langevinbaoab
import ase.md.nose_hoover_chain
import ase.md.nvtberendsen
import numpy as np
from ase import Atoms, units
from ase.constraints import FixAtoms, FixCom
from ase.md.md import MolecularDynamics

from minimd.ase.baths import AndersenBath, BerendsenBath, BussiBath, Chain, LangevinBath, NoseHooverBath
from minimd.ase.dynamics import MinimdSteps
from minimd.integrators.splitting.splitting import Splitting
from minimd.integrators.splitting.verlet import VelocityVerlet
from minimd.structure.ase_constraints import fixes_center
from minimd.structure.checks import shown


class Noisy(MolecularDynamics):
    """A class with random numbers.

    rng : RandomState, Generator, numpy.random itself, or any object with standard_normal; an int or a SeedSequence becomes a Generator.
        Another one that is set takes over from the next step on.

    Raises TypeError for anything else.
    """

    _rng: Any = np.random
    _seed: int | None = None

    @property
    def rng(self) -> Any:
        """Where the seed of the noise is drawn."""
        return self._rng

    @rng.setter
    def rng(self, rng: Any) -> None:
        if rng is None:
            rng = np.random
        elif not hasattr(rng, "standard_normal"):
            try:
                rng = np.random.default_rng(rng)
            except (TypeError, ValueError):
                wanted = "a RandomState, a Generator, an int that is not negative, or a SeedSequence"
                raise TypeError(f"rng must be {wanted} of NumPy; rng = {shown(rng)}") from None
        self._rng, self._seed = rng, None

    def noise_seed(self) -> int:
        """The seed of the noise, drawn once from rng; the same for all processes of a parallel calculator."""
        if self._seed is None:
            drawn = np.asarray(self._rng.standard_normal(size=4), dtype=float)
            self.comm.broadcast(drawn, 0)
            words = np.random.SeedSequence(drawn.view(np.uint32).tolist()).generate_state(4)
            self._seed = int.from_bytes(words.tobytes(), "little")
        return self._seed


class Langevin(MinimdSteps, Noisy, ase.md.langevin.Langevin):
    """ase.md.langevin.Langevin with the steps of BAOAB, see minimd.LangevinBAOAB: the same distribution by another scheme.

    temperature_K and friction may be arrays with one value for each atom, (N, 1). With fixcm the center of mass is left alone, and the
    temperature of all other motions raised by n/(n − 3), n = atoms.get_number_of_degrees_of_freedom(), so that atoms.get_temperature() is
    temperature_K on average, as in ASE. A constraint FixCom, which ASE advises instead, is kept exactly. Where atoms are held by FixAtoms
    the center of mass is not free, and fixcm means nothing.
    """

    def method(self) -> Splitting:
        """BAOAB."""
        keeps_center, temperature = fixes_center(self.atoms), self.temp / units.kB
        if self.fix_com and _center_is_free(self.atoms):
            n_dof = self.atoms.get_number_of_degrees_of_freedom()
            if n_dof <= 3:
                raise ValueError(f"fixcm = True leaves no motion to {len(self.atoms)} atoms with {n_dof} degrees of freedom; use fixcm=False")
            keeps_center, temperature = True, temperature * n_dof / (n_dof - 3)
        return LangevinBath(self.dt, temperature, self.fr, self.noise_seed(), keeps_center)


class LangevinBAOAB(MinimdSteps, Noisy, ase.md.langevinbaoab.LangevinBAOAB):
    """ase.md.langevinbaoab.LangevinBAOAB for a cell that stays as it is; without temperature_K it is velocity Verlet.

    Raises NotImplementedError for externalstress, with which the cell would change.
    """

    @functools.wraps(ase.md.langevinbaoab.LangevinBAOAB.__init__)  # type: ignore[misc] # for the signature
    def __init__(self, *arguments: Any, **options: Any) -> None:
        super().__init__(*arguments, **options)
        if self.externalstress is not None:
            raise NotImplementedError(
                f"externalstress = {shown(self.externalstress)}: this class keeps the cell as it is; use ase.md.langevinbaoab.LangevinBAOAB, "
                "or minimd.Simulation with barostat=StochasticCellRescaling(...)"
            )

    def method(self) -> Splitting:
        """BAOAB, or velocity Verlet."""
        if self.temperature_K is None:
            return VelocityVerlet(self.dt)
        return LangevinBath(self.dt, self.temperature_K, self.gamma, self.noise_seed(), fixes_center(self.atoms))


class Bussi(MinimdSteps, Noisy, ase.md.bussi.Bussi):
    """ase.md.bussi.Bussi: the kinetic energy of all ndof degrees of freedom has its canonical distribution.

    temp, ndof and target_kinetic_energy = ½ ndof temp may be set between steps, as well as taut.
    transferred_energy : what the bath has given to the atoms so far [eV].
    """

    @property
    def target_kinetic_energy(self) -> float:
        """½ ndof temp [eV]; to set it sets temp [eV]."""
        return float(0.5 * self.temp * self.ndof)

    @target_kinetic_energy.setter
    def target_kinetic_energy(self, energy: float) -> None:
        if energy != self.target_kinetic_energy:
            self.temp = 2.0 * energy / self.ndof

    def method(self) -> Splitting:
        """Stochastic velocity rescaling, then velocity Verlet."""
        return BussiBath(self.dt, self.temp / units.kB, self.taut, self.noise_seed(), self.ndof)

    def _count_heat(self, energy: float) -> None:
        self.transferred_energy += energy


class NoseHooverChainNVT(MinimdSteps, ase.md.nose_hoover_chain.NoseHooverChainNVT):  # type: ignore[misc] # ASE's step returns nothing
    """ase.md.nose_hoover_chain.NoseHooverChainNVT: the same motion, to rounding, and the same get_conserved_energy.

    Unlike ASE's class it counts degrees of freedom by atoms.get_number_of_degrees_of_freedom(), which is 3N without constraints, keeps
    constraints, and takes notice of what others do to the atoms between steps.
    """

    def __init__(self, atoms: Atoms, timestep: float, temperature_K: float, tdamp: float, tchain: int = 3, tloop: int = 1, **kwargs: Any) -> None:  # noqa: N803
        super().__init__(atoms, timestep, temperature_K, tdamp, tchain, tloop, **kwargs)
        self._chain = Chain(units.kB * temperature_K, int(atoms.get_number_of_degrees_of_freedom()), tdamp, tchain, tloop)

    def method(self) -> Splitting:
        """Velocity Verlet between two half steps of the chain."""
        return NoseHooverBath(self.dt, self._chain)

    def get_conserved_energy(self) -> float:
        """U + K + the energy of the chain [eV]; constant but for the error of the time step."""
        return float(self.atoms.get_potential_energy(force_consistent=True) + self.atoms.get_kinetic_energy() + self._chain.energy)


class Andersen(MinimdSteps, Noisy, ase.md.andersen.Andersen):
    """ase.md.andersen.Andersen. With fixcm the center of mass comes to rest and stays there, unless atoms are held by FixAtoms."""

    def method(self) -> Splitting:
        """Collisions between the first kick and the drift of velocity Verlet."""
        return AndersenBath(self.dt, self.temp / units.kB, self.andersen_prob, self.noise_seed(), _keeps_center(self.atoms, self.fix_com))


class NVTBerendsen(MinimdSteps, ase.md.nvtberendsen.NVTBerendsen):
    """ase.md.nvtberendsen.NVTBerendsen: the same motion, to rounding. With fixcm total momentum is taken out, unless atoms are held by FixAtoms."""

    def method(self) -> Splitting:
        """One factor for all velocities, then velocity Verlet."""
        n_dof = int(self.atoms.get_number_of_degrees_of_freedom())
        return BerendsenBath(self.dt, self.temperature, self.taut, n_dof, _keeps_center(self.atoms, self.fix_com))


def _center_is_free(atoms: Atoms) -> bool:
    """Whether nothing holds the center of mass: neither FixCom nor FixAtoms."""
    return not any(isinstance(constraint, FixAtoms | FixCom) for constraint in atoms.constraints)


def _keeps_center(atoms: Atoms, fixcm: bool) -> bool:
    return fixes_center(atoms) or (fixcm and _center_is_free(atoms))
