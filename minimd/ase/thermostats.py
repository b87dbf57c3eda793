"""ASE's thermostats with the steps made by minimd; arguments, defaults, attributes and setters are those of ASE.

The noise is minimd's: paths differ from those of ASE's classes, distributions are the same. Each class draws one seed
from its rng when the first step is made; equal rngs give equal runs.
"""

import functools
from typing import Any

import numpy as np
from ase import Atoms, units
from ase.constraints import FixAtoms, FixCom
from ase.md import andersen, bussi, langevin, langevinbaoab, nose_hoover_chain, nvtberendsen
from ase.md.md import MolecularDynamics

from minimd.ase.baths import (
    AndersenBath,
    BerendsenBath,
    BussiBath,
    Chain,
    LangevinBath,
    NoseHooverBath,
)
from minimd.ase.dynamics import MinimdSteps, named_as_in_ase
from minimd.core.console.words import shown
from minimd.core.integrators.rows import VelocityVerlet
from minimd.core.integrators.splitting import Splitting
from minimd.core.structure.ase_atoms import fixes_center


class Noisy(MolecularDynamics):
    """The base of classes that use random numbers.

    rng : RandomState, Generator, numpy.random itself, or any object with standard_normal; an int or a SeedSequence
        becomes a Generator. An rng that is set later is used from the next step on.

    Raises TypeError for anything else.
    """

    _rng: Any = np.random
    _seed: int | None = None

    @property
    def rng(self) -> Any:
        """The source of the seed of the noise."""
        return self._rng

    @rng.setter
    def rng(self, rng: Any) -> None:
        if rng is None:
            rng = np.random
        elif not hasattr(rng, "standard_normal"):
            try:
                rng = np.random.default_rng(rng)
            except (TypeError, ValueError):
                raise TypeError(
                    "rng must be a RandomState, a Generator, an int that is not negative, or a SeedSequence of "
                    f"NumPy; rng = {shown(rng)}"
                ) from None
        self._rng = rng
        self._seed = None

    def noise_seed(self) -> int:
        """The seed of the noise, drawn once from rng; the same for all processes of a parallel calculator."""
        if self._seed is None:
            drawn = np.asarray(self._rng.standard_normal(size=4), float)
            self.comm.broadcast(drawn, 0)
            sequence = np.random.SeedSequence(drawn.view(np.uint32).tolist())
            self._seed = int.from_bytes(sequence.generate_state(4).tobytes(), "little")
        return self._seed


class Langevin(MinimdSteps, Noisy, langevin.Langevin):
    """ase.md.langevin.Langevin with the steps of BAOAB, see minimd.LangevinBAOAB: the same distribution.

    temperature_K and friction may be arrays with one value for each atom, (N, 1). With fixcm the bath does not act on
    the center of mass. The temperature of all other motions is then n/(n − 3) times temperature_K, with n =
    atoms.get_number_of_degrees_of_freedom(), so that the mean of atoms.get_temperature() is temperature_K, as in ASE. A
    constraint FixCom, which ASE recommends instead, is kept exactly. If atoms are held by FixAtoms, the center of mass
    is not free, and fixcm has no effect.
    """

    def method(self) -> Splitting:
        """BAOAB."""
        keeps_center = fixes_center(self.atoms)
        temperature = self.temp / units.kB
        if self.fix_com and _center_is_free(self.atoms):
            n_dof = self.atoms.get_number_of_degrees_of_freedom()
            if n_dof <= 3:
                raise ValueError(
                    f"fixcm = True needs more than 3 degrees of freedom; {len(self.atoms)} atoms have {n_dof}: use "
                    "fixcm=False"
                )
            keeps_center = True
            temperature = temperature * n_dof / (n_dof - 3)
        return LangevinBath(self.dt, temperature, self.fr, self.noise_seed(), keeps_center)


@named_as_in_ase
class LangevinBAOABDynamics(MinimdSteps, Noisy, langevinbaoab.LangevinBAOAB):
    """ase.md.langevinbaoab.LangevinBAOAB for a constant cell; without temperature_K it is velocity Verlet.

    Raises NotImplementedError for externalstress, with which the cell would change.
    """

    @functools.wraps(langevinbaoab.LangevinBAOAB.__init__)  # type: ignore[misc] # for the signature
    def __init__(self, *arguments: Any, **options: Any) -> None:
        super().__init__(*arguments, **options)
        if self.externalstress is not None:
            raise NotImplementedError(
                f"externalstress = {shown(self.externalstress)}: this class needs a constant cell; use "
                "ase.md.langevinbaoab.LangevinBAOAB, or minimd.Simulation with "
                "barostat=StochasticCellRescaling(...)"
            )

    def method(self) -> Splitting:
        """BAOAB, or velocity Verlet."""
        if self.temperature_K is None:
            return VelocityVerlet(self.dt)
        return LangevinBath(
            self.dt, self.temperature_K, self.gamma, self.noise_seed(), fixes_center(self.atoms)
        )


LangevinBAOAB = LangevinBAOABDynamics


class Bussi(MinimdSteps, Noisy, bussi.Bussi):
    """ase.md.bussi.Bussi: the kinetic energy of all ndof degrees of freedom has its canonical distribution.

    temp, ndof, target_kinetic_energy = ½ ndof temp, and taut may be set between steps.
    transferred_energy : energy that the bath has given to the atoms so far [eV].
    """

    @property
    def target_kinetic_energy(self) -> float:
        """½ ndof temp [eV]; setting it sets temp [eV]."""
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


class NoseHooverChainNVT(MinimdSteps, nose_hoover_chain.NoseHooverChainNVT):  # type: ignore[misc]
    """ase.md.nose_hoover_chain.NoseHooverChainNVT: the same motion, to rounding, and the same get_conserved_energy.

    Unlike ASE's class it counts degrees of freedom by atoms.get_number_of_degrees_of_freedom(), which is 3N without
    constraints; it keeps constraints, and uses changes that others make to the atoms between steps.
    """

    def __init__(
        self,
        atoms: Atoms,
        timestep: float,
        temperature_K: float,
        tdamp: float,
        tchain: int = 3,
        tloop: int = 1,
        **kwargs: Any,
    ) -> None:
        super().__init__(atoms, timestep, temperature_K, tdamp, tchain, tloop, **kwargs)
        n_dof = int(atoms.get_number_of_degrees_of_freedom())
        self._chain = Chain(units.kB * temperature_K, n_dof, tdamp, tchain, tloop)

    def method(self) -> Splitting:
        """Velocity Verlet between two half steps of the chain."""
        return NoseHooverBath(self.dt, self._chain)

    def get_conserved_energy(self) -> float:
        """U + K + the energy of the chain [eV]; constant except for the error of the time step."""
        potential_energy = self.atoms.get_potential_energy(force_consistent=True)
        return float(potential_energy + self.atoms.get_kinetic_energy() + self._chain.energy)


class Andersen(MinimdSteps, Noisy, andersen.Andersen):
    """ase.md.andersen.Andersen.
    With fixcm the center of mass comes to rest and stays there, unless atoms are held by FixAtoms."""

    def method(self) -> Splitting:
        """Collisions between the first kick and the drift of velocity Verlet."""
        seed = self.noise_seed()
        keeps_center = _keeps_center(self.atoms, self.fix_com)
        return AndersenBath(self.dt, self.temp / units.kB, self.andersen_prob, seed, keeps_center)


class NVTBerendsen(MinimdSteps, nvtberendsen.NVTBerendsen):
    """ase.md.nvtberendsen.NVTBerendsen: the same motion, to rounding.
    With fixcm the total momentum is removed, unless atoms are held by FixAtoms."""

    def method(self) -> Splitting:
        """One factor for all velocities, then velocity Verlet."""
        n_dof = int(self.atoms.get_number_of_degrees_of_freedom())
        keeps_center = _keeps_center(self.atoms, self.fix_com)
        return BerendsenBath(self.dt, self.temperature, self.taut, n_dof, keeps_center)


def _center_is_free(atoms: Atoms) -> bool:
    """Whether nothing holds the center of mass: neither FixCom nor FixAtoms."""
    return not any(isinstance(constraint, FixAtoms | FixCom) for constraint in atoms.constraints)


def _keeps_center(atoms: Atoms, fixcm: bool) -> bool:
    return fixes_center(atoms) or (fixcm and _center_is_free(atoms))
