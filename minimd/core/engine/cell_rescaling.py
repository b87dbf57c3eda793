"""A barostat acting on an engine: every few steps it strains cell, positions, velocities, and counts the energy."""

from collections.abc import Callable
from typing import Any

import numpy as np

from minimd.core.constraints.constraint_set import ConstraintSet
from minimd.core.constraints.groups import bodies_of
from minimd.core.forces.forces import ForceResult, Forces
from minimd.core.forces.options import FIXED_POINT
from minimd.core.integrators.barostats import (
    StochasticCellRescaling,
    ThermodynamicState,
    exponential,
    turned_back,
)
from minimd.core.integrators.ramp import Level, Ramp, level_at
from minimd.core.integrators.splitting import Splitting
from minimd.core.integrators.state import Bath
from minimd.core.structure.arrays import Array
from minimd.core.structure.cell import Cell
from minimd.core.structure.checks import checked_kind
from minimd.core.structure.errors import RangeError
from minimd.core.structure.observables import center, kinetic_energy, momentum, pressure_tensor
from minimd.core.structure.system import System
from minimd.core.structure.vectors import inverse_of, strain_state

LARGEST_STRAIN = 0.2  # of the cell at once: a bath that strains it more does not act slowly
# times the volume at the start: a liquid grows by a factor of some 3 up to its critical point
EVAPORATED = 8.0


class StrainedBodies:
    """The bodies that move as a whole when the cell is strained: atoms tied by rigid lengths, with their sites, and
    single atoms.

    bodies : Bodies.
    masses : (B,) of the bodies [mass].
    """

    def __init__(self, system: System, constraints: ConstraintSet) -> None:
        pairs = constraints.kept[-1].pairs
        if system.sites is not None:
            pairs = np.concatenate([system.sites.pairs, pairs])
        self.bodies = bodies_of(pairs, constraints.inverse_masses)
        self._system = system
        self.masses = self._sums(system.masses)
        self._translations = np.zeros_like(system.positions)
        self._of = None
        self._cell = system.cell

    def _sums(self, values: Array) -> Array:
        return np.asarray(np.bincount(self.bodies.label, values), dtype=np.float64)

    def centers(self, vectors: Array) -> Array:
        """Mass-weighted mean of (N, 3) vectors over each body: (B, 3)."""
        weighted = self._system.masses[:, None] * vectors
        return (
            np.column_stack([self._sums(weighted[:, c]) for c in range(3)]) / self.masses[:, None]
        )

    def whole(self, bonds: Any) -> Array:
        """Lattice translations of the present cell, (N, 3) [length], that join the atoms of each body."""
        cell = self._system.cell
        if bonds is not self._of:
            self._translations = self._joined(bonds)
            self._of = bonds
            self._cell = cell
            cell.follow(cell, self._translations)
        elif cell is not self._cell:
            self._cell.follow(cell, self._translations)
            self._cell = cell
        return self._translations

    def _joined(self, bonds: Any) -> Array:
        from scipy.sparse import coo_array
        from scipy.sparse.csgraph import breadth_first_order

        translations = np.zeros_like(self._system.positions)
        if not bonds.offsets.any():
            return translations
        number = np.arange(1, len(bonds.pairs) + 1)
        both_ways = np.concatenate([bonds.pairs, bonds.pairs[:, ::-1]])
        values = np.concatenate([number, -number])
        shape = (len(translations), len(translations))
        graph = coo_array((values, both_ways.T), shape=shape).tocsr()
        for body in np.unique(self.bodies.label[bonds.pairs[bonds.offsets.any(axis=1), 0]]):
            order, parent = breadth_first_order(graph, int(self.bodies.last[body]), directed=True)
            for atom in order[1:]:
                k = int(graph[parent[atom], atom])
                translations[atom] = (
                    translations[parent[atom]] + np.sign(k) * bonds.offsets[abs(k) - 1]
                )
        return translations


class CellRescaling:
    """A barostat and the parts of an engine on which it works.

    Raises ValueError for a scene that cannot be at constant pressure, see check.
    """

    def __init__(
        self,
        barostat: StochasticCellRescaling,
        system: System,
        interactions: Forces,
        constraints: ConstraintSet,
        method: Splitting,
    ) -> None:
        self.barostat = barostat
        self._system = system
        self._constraints = constraints
        check(system, interactions, constraints)
        if system.dimensions == 2 and "z" in barostat.coupling:
            raise ValueError(
                f"a plane has no height to change: take a coupling without z; it is {barostat.coupling!r}"
            )
        self.temperature(method)
        self._molecules = None if constraints.bonds is None else StrainedBodies(system, constraints)
        self._first_volume = float(system.volume or 0.0)

    def temperature(self, method: Splitting) -> Level:
        """T of the bath.
        Raises ValueError if neither barostat nor thermostat has it, they differ, or timestep < 0."""
        own = self.barostat.temperature
        theirs = getattr(method, "temperature", None) if method.is_thermostat else None
        if method.timestep < 0.0:
            raise ValueError(
                f"time cannot run backwards with a barostat; timestep = {method.timestep!r}"
            )
        if own is None and theirs is None:
            why = "which has no temperature, needs temperature=... for its noise"
            raise ValueError(f"a barostat with {method.name}, {why}")
        if own is not None and theirs is not None and own != theirs:
            they = f"they have {own} and {theirs}: leave out the temperature of the barostat"
            raise ValueError(f"barostat and thermostat must have the same temperature; {they}")
        temperature: Any = theirs if own is None else own
        return temperature if isinstance(temperature, Ramp) else float(temperature)

    def next_step(self, step: int) -> int:
        """The first step after this one at which the cell is strained."""
        return step + self.barostat.every - step % self.barostat.every

    def apply(
        self,
        method: Splitting,
        noise_number: int,
        bath: Bath,
        sums: ForceResult,
        forces_follow: Callable[[], ForceResult],
        accepts: Callable[[float], bool] | None = None,
    ) -> None:
        """Strain the whole scene once.

        noise_number : selects the noise.
        sums : forces, energy and virial of the present state.
        forces_follow : computes them after cell and positions changed.
        accepts : decides about ΔH/k_B T of the change, in hybrid Monte Carlo; else nobody does, and ΔH is an error.

        Raises RangeError for a strain too large, or a cell that nothing holds together; ValueError without a virial.
        """
        barostat = self.barostat
        duration = barostat.every * method.duration
        thermal = self._system.units.k_B * level_at(self.temperature(method), noise_number)
        wanted = thermal, level_at(barostat.pressure, noise_number)
        before = self._thermodynamic_state(wanted, bath, sums)
        strain = barostat.strain(before, duration, noise_number)
        largest = float(np.abs(strain).max())
        if largest > LARGEST_STRAIN and accepts is not None:
            return  # not accepted: its reverse would not be, either
        if not largest <= LARGEST_STRAIN:
            if not np.isfinite(sums.virial).all() and np.isfinite(sums.forces).all():
                cure = "take one that does, such as a calculator with a stress"
                raise ValueError(f"a barostat needs the virial, but a potential gives none: {cure}")
            target = f"{before.target:.3g} {self._system.units.pressure}"
            why = f"pressure {before.mean_pressure:.3g}, target {target}"
            cure = "equilibrate first, take a longer relaxation_time, or check the unit of the pressure"
            raise RangeError(
                f"the barostat would strain the cell by {largest:.1e} at once ({why}): {cure}"
            )
        if before.target <= 0.0 and before.volume > EVAPORATED * self._first_volume:
            raise RangeError(self._growth(before))
        system = self._system
        cell, positions, velocities = system.cell, system.positions.copy(), system.velocities.copy()
        back = self._move(exponential(strain), bath)
        after = self._thermodynamic_state(wanted, bath, forces_follow(), back)
        change = barostat.change_of_conserved(before, after, strain, duration)
        if accepts is None:
            bath.energy += after.energy - before.energy - change
        elif accepts(change / thermal):
            bath.energy += after.energy - before.energy
        else:
            self._constraints.follow(system.cell, cell)
            system.cell, system.positions[:], system.velocities[:] = cell, positions, velocities
            forces_follow()

    def _growth(self, state: ThermodynamicState) -> str:
        volume = self._system.units.volume
        pressure = self._system.units.pressure
        grown = f"the cell has grown from {self._first_volume:.4g} to {state.volume:.4g} {volume}"
        why = f"at pressure {state.target:.3g} {pressure} a gas expands without end"
        cure = (
            "take a pressure above zero, at which the atoms stay together, or a lower temperature"
        )
        return f"{grown}: the atoms have evaporated, and {why}; {cure}"

    def _thermodynamic_state(
        self, wanted: tuple[float, float], bath: Bath, sums: ForceResult, back: Array | None = None
    ) -> ThermodynamicState:
        """The present state.
        wanted : k_B T and P₀.
        back : (3, 3) rotation applied to its tensors.

        If the total momentum is constant, it is no thermal motion; its degrees of freedom add k_B T/V.
        """
        system = self._system
        volume = float(system.volume or 0.0)
        moving = system.velocities
        masses = system.masses
        virial = sums.virial
        if self._molecules is not None:
            virial = virial - self._inner_virial(sums.forces)
            virial = 0.5 * (virial + virial.T)
            moving = self._molecules.centers(moving)
            masses = self._molecules.masses
        pressure = pressure_tensor(moving, masses, virial, volume)
        energy = kinetic_energy(system.velocities, system.masses) + sums.potential_energy
        state = ThermodynamicState(pressure, volume, energy, *wanted, system.dimensions)
        if bath.conserves_momentum:
            total = momentum(moving, masses)
            pressure += (wanted[0] * state.unit - np.outer(total, total) / masses.sum()) / volume
        return state if back is None else state._replace(pressure=back @ pressure @ back.T)

    def _inner_virial(self, forces: Array) -> Array:
        """Σ (r − R) ⊗ F [energy], (3, 3): the virial of atoms minus that of molecules, without rigid bonds."""
        molecules: Any = self._molecules
        whole = self._system.positions + molecules.whole(self._constraints.bonds)
        inner = whole - molecules.centers(whole)[molecules.bodies.label]
        return np.einsum("ia,ib->ab", inner, forces)

    def _move(self, stretch: Array, bath: Bath) -> Array | None:
        """Strain cell, positions, velocities by a symmetric (3, 3) matrix; returns the rotation after it, or None."""
        system = self._system
        before = self._system.cell
        rotation = None
        vectors = before.vectors @ stretch
        if self.barostat.coupling == "triclinic":
            vectors, rotation = turned_back(before.vectors, vectors)
        cell = before.strained(vectors)
        drift = center(system.velocities, system.masses, bath.conserves_momentum)
        inverse, _ = inverse_of(stretch)
        if self._molecules is None:
            if rotation is not None:
                stretch = stretch @ rotation
                inverse = inverse @ rotation
            strain_state(system.positions, system.velocities, stretch, inverse, drift)
        else:
            positions, velocities = self._moved_molecules(
                stretch, system.velocities - drift, inverse, cell, rotation
            )
            system.positions[:] = positions
            system.velocities[:] = velocities + drift
        system.cell = cell
        self._constraints.follow(before, cell)
        return rotation

    def _moved_molecules(
        self, stretch: Array, velocities: Array, inverse: Array, cell: Cell, rotation: Array | None
    ) -> tuple[Array, Array]:
        """Positions and velocities, (N, 3): the centers of molecules are strained, then all is rotated."""
        molecules: Any = self._molecules
        label = molecules.bodies.label
        translations = molecules.whole(self._constraints.bonds)
        whole = self._system.positions + translations
        shifts = [
            np.einsum("ij,jk->ik", centers, matrix - np.eye(3))
            for centers, matrix in (
                (molecules.centers(whole), stretch),
                (molecules.centers(velocities), inverse),
            )
        ]
        whole = whole + shifts[0][label]
        velocities = velocities + shifts[1][label]
        if rotation is not None:
            whole = np.einsum("ij,jk->ik", whole, rotation)
            velocities = np.einsum("ij,jk->ik", velocities, rotation)
        translations = translations.copy()
        self._system.cell.follow(cell, translations)
        return whole - translations, velocities


def rescaling_of(
    barostat: StochasticCellRescaling | None,
    system: System,
    interactions: Forces,
    constraints: ConstraintSet,
    method: Splitting,
    holds_center: bool,
) -> CellRescaling | None:
    """A barostat on the parts of an engine, or None.
    Raises TypeError for another object, ValueError as that."""
    if barostat is None:
        return None
    checked_kind("barostat", barostat, StochasticCellRescaling, "a StochasticCellRescaling")
    if holds_center:
        why = "a barostat moves the center of mass with the cell: remove FixCom"
        raise ValueError(f"atoms.constraints holds FixCom, but {why}")
    return CellRescaling(barostat, system, interactions, constraints, method)


def check(system: System, interactions: Forces, constraints: ConstraintSet) -> None:
    """Raise ValueError for a scene that cannot be at constant pressure."""
    check_cell(system)
    if constraints.n_fixed:
        held = f"{constraints.n_fixed} are held fixed: hold them with springs instead"
        raise ValueError(f"a barostat moves all atoms, but {held}")
    if interactions.act_from_outside:
        why = "external forces, such as fields and walls, have none: remove them"
        raise ValueError(f"a barostat needs the virial of all forces, but {why}")
    if interactions.options.precision == FIXED_POINT:
        why = "needs a constant cell, with vectors on the fixed-point grid: take precision='double'"
        raise ValueError(f"a barostat cannot be used with precision='fixed-point', which {why}")


def check_cell(system: System) -> None:
    """Raise ValueError for a cell without a volume."""
    if system.volume is None:
        what = "periodic in all directions, a plane in two (for a slab, with empty space)"
        raise ValueError(
            f"a barostat needs a cell that is {what}; pbc = {system.cell.pbc.tolist()}"
        )
