"""The baths of ASE's thermostats as splittings of minimd, with the meaning of ASE's arguments, and at the same place in
the step as in ASE.

They differ from the thermostats of minimd.integrators in what users of ASE expect: parameters for each atom, a center
of mass that stays at rest (fixcm), degrees of freedom counted as by Atoms.get_number_of_degrees_of_freedom. Each raises
ValueError for a parameter out of range. k_B T is `bath.k_B` times the temperature [K].
"""

from math import exp, sqrt
from typing import Any, ClassVar

import numpy as np

from minimd.core.console.words import shown
from minimd.core.integrators.splitting import Splitting
from minimd.core.integrators.state import State, Surroundings
from minimd.core.integrators.substeps import Drift, Kick, Substeps, Thermalize
from minimd.core.integrators.thermostats import (
    LangevinBAOAB,
    StochasticVelocityRescaling,
    Thermostat,
    bath_of,
)
from minimd.core.structure.checks import checked_number
from minimd.core.structure.observables import kinetic_energy, momentum

__all__ = ["AndersenBath", "BerendsenBath", "BussiBath", "Chain", "LangevinBath", "NoseHooverBath"]

BEFORE = (Thermalize(1.0), Kick(0.5), Drift(1.0), Kick(0.5))
# of velocities in one step of Berendsen's bath, as in ASE
LEAST_SCALE = 0.9
MOST_SCALE = 1.1
_OUTER = 1.0 / (2.0 - 2.0 ** (1.0 / 3.0))
# of order 4: H. Yoshida, Phys. Lett. A 150, 262 (1990); M. Suzuki
WEIGHTS = (_OUTER, 1.0 - 2.0 * _OUTER, _OUTER)
# steps whose states a chain keeps: many more than in a block, which is repeated if it fails
KEPT_STEPS = 1000


class LangevinBath(Thermostat):
    """LangevinBAOAB with temperatures and frictions that may differ from atom to atom, optionally without a bath
    for the center of mass.

    temperature [K], friction [1/time] : ≥ 0, one number, or an array that broadcasts to (N, 3).
    keeps_center : whether the bath leaves the velocity of the center of mass unchanged; 3N − 3 degrees are thermal.
    """

    name = LangevinBAOAB.name
    source = LangevinBAOAB.source
    substeps: ClassVar[Substeps] = LangevinBAOAB.substeps
    conserves_momentum = False

    def __init__(
        self,
        timestep: float,
        temperature: Any,
        friction: Any,
        seed: int,
        keeps_center: bool = False,
    ) -> None:
        super().__init__(timestep, 0.0, seed)
        self.temperatures = np.asarray(temperature, float)
        self.frictions = np.asarray(friction, float)
        self.keeps_center = keeps_center
        for name, values in (("temperature", temperature), ("friction", friction)):
            numbers = np.asarray(values)
            if not ((numbers >= 0.0) & (numbers < np.inf)).all():
                raise ValueError(
                    f"{name} must be finite and not negative; {name} = {shown(values)}"
                )

    @property
    def parameters(self) -> dict[str, Any]:
        """The time step only: the others may be arrays."""
        return {"timestep": self.timestep}

    def thermalize(self, state: State, duration: float, around: Surroundings) -> None:
        """The Ornstein-Uhlenbeck process over a duration, see LangevinBAOAB."""
        bath = bath_of(around)
        velocities = state.velocities
        kept = np.exp(-self.frictions * duration)
        thermal = bath.k_B * self.temperatures
        spread = np.sqrt(thermal * (1.0 - kept * kept) * state.inverse_masses[:, None])
        noise = self.noise(bath).standard_normal(velocities.shape)
        new = kept * velocities + spread * noise
        if self.keeps_center:
            new -= momentum(new - velocities, state.masses) / state.masses.sum()
        velocities[:] = new


class BussiBath(StochasticVelocityRescaling):
    """StochasticVelocityRescaling before the step; the caller counts the degrees of freedom n_dof, and the motion of
    the center is rescaled, too.
    relaxation_time : τ > 0 [time]."""

    substeps: ClassVar[Substeps] = BEFORE  # type: ignore[assignment] # mypy takes the row of the base for its type

    def __init__(
        self, timestep: float, temperature: float, relaxation_time: float, seed: int, n_dof: int
    ) -> None:
        Thermostat.__init__(self, timestep, temperature, seed)
        if not relaxation_time > 0.0:
            raise ValueError(f"taut must be positive; taut = {shown(relaxation_time)}")
        self.relaxation_time = relaxation_time
        self.n_dof = n_dof

    def thermalize(self, state: State, duration: float, around: Surroundings) -> None:
        """See StochasticVelocityRescaling; for n_dof degrees of freedom."""
        bath = bath_of(around)
        bath.n_dof = self.n_dof
        bath.conserves_momentum = False
        super().thermalize(state, duration, around)


class AndersenBath(Thermostat):
    """Collisions between the first kick and the drift: each component of a velocity is drawn again at random.

        v ← √(k_B T/m) ξ      with probability p in each step; ξ normal

    probability : p in each step, 0 to 1.
    keeps_center : whether the center of mass stays at rest; it gets a thermal velocity before the collisions, which
        is removed after them.  H. C. Andersen, J. Chem. Phys. 72, 2384 (1980).
    """

    name = "andersen"
    substeps = (Kick(0.5), Thermalize(1.0), Drift(1.0), Kick(0.5))
    source = "H. C. Andersen, J. Chem. Phys. 72, 2384 (1980)"

    def __init__(
        self, timestep: float, temperature: float, probability: float, seed: int, keeps_center: bool
    ) -> None:
        super().__init__(timestep, temperature, seed)
        self.probability = checked_number("andersen_prob", probability, "finite and not negative")
        self.keeps_center = keeps_center
        if self.probability > 1.0:
            raise ValueError(
                f"andersen_prob must be a probability from 0 to 1; andersen_prob = {probability!r}"
            )

    def thermalize(self, state: State, duration: float, around: Surroundings) -> None:
        """The collisions of one step."""
        bath = bath_of(around)
        velocities = state.velocities
        noise = self.noise(bath)
        thermal = bath.k_B * self.temperature_at(bath.step)
        if self.keeps_center:
            velocities += sqrt(thermal / state.masses.sum()) * noise.standard_normal(3)
        spread = np.sqrt(thermal * state.inverse_masses[:, None])
        new = spread * noise.standard_normal(velocities.shape)
        collides = noise.random(velocities.shape) < self.probability
        np.copyto(velocities, new, where=collides)
        if self.keeps_center:
            velocities -= momentum(velocities, state.masses) / state.masses.sum()


class BerendsenBath(Splitting):
    """All velocities are multiplied by one factor before each step, which brings the kinetic temperature T′ closer to
    T. It samples no ensemble.

        v ← λ v,   λ² = 1 + (T/T′ − 1) Δt/τ,   0.9 ≤ λ ≤ 1.1

    relaxation_time : τ, not 0.
    n_dof : degrees of freedom in T′.
    keeps_center : whether total momentum is removed, in equal shares from all atoms.  H. J. C. Berendsen et al., J.
        Chem. Phys. 81, 3684 (1984).
    """

    name = "berendsen"
    substeps = BEFORE
    source = "H. J. C. Berendsen et al., J. Chem. Phys. 81, 3684 (1984)"
    order = 1
    is_symmetric = False
    is_symplectic = False
    is_thermostat = True

    def __init__(
        self,
        timestep: float,
        temperature: float,
        relaxation_time: float,
        n_dof: int,
        keeps_center: bool,
    ) -> None:
        super().__init__(timestep)
        self.temperature = checked_number("temperature", temperature, "finite and not negative")
        self.relaxation_time = checked_number("taut", relaxation_time, "finite and not zero")
        self.n_dof = n_dof
        self.keeps_center = keeps_center

    def thermalize(self, state: State, duration: float, around: Surroundings) -> None:
        """Rescale the velocities, see the class; atoms at rest stay at rest."""
        velocities = state.velocities
        kinetic = kinetic_energy(velocities, state.masses)
        if kinetic == 0.0:
            return
        ratio = 0.5 * self.n_dof * bath_of(around).k_B * self.temperature / kinetic
        scale = sqrt(max(1.0 + (ratio - 1.0) * duration / self.relaxation_time, 0.0))
        velocities *= min(max(scale, LEAST_SCALE), MOST_SCALE)
        if self.keeps_center:
            share = momentum(velocities, state.masses) / len(velocities)
            velocities -= share * state.inverse_masses[:, None]


class Chain:
    """A chain of M thermostats: the first is in contact with the atoms, each other one with the one before it;
    deterministic and reversible.

        η̇_j = p_j/Q_j,   ṗ_1 = 2K − n k_B T − p_1 p_2/Q_2,   ṗ_j = p_{j−1}²/Q_{j−1} − k_B T − p_j p_{j+1}/Q_{j+1},
        v̇ = −v p_1/Q_1

    thermal : k_B T [energy].
    n_dof : n.
    relaxation_time : τ; Q_1 = n k_B T τ², all others k_B T τ².
    length : M.
    loops : substeps of a contact.
    eta, p : (M,) η_j and p_j.  G. J. Martyna, M. L. Klein, M. E. Tuckerman, J. Chem. Phys. 97, 2635 (1992);
    integrator: G. J. Martyna et al., Mol. Phys. 87, 1117 (1996).
    """

    def __init__(
        self, thermal: float, n_dof: int, relaxation_time: float, length: int, loops: int
    ) -> None:
        self.thermal = thermal
        self.n_dof = n_dof
        self.loops = loops
        self.inertia = [thermal * relaxation_time**2] * length
        self.inertia[0] *= n_dof
        self.eta = [0.0] * length
        self.p = [0.0] * length
        # η and p at the start of steps, in their order
        self._starts: dict[int, tuple[list[float], list[float]]] = {}

    @property
    def energy(self) -> float:
        """n k_B T η_1 + k_B T Σ η_j + Σ p_j²/2Q_j: the energy that the atoms have given to the chain [energy]."""
        kinetic = sum(0.5 * p * p / q for p, q in zip(self.p, self.inertia, strict=True))
        return self.thermal * (self.n_dof * self.eta[0] + sum(self.eta[1:])) + kinetic

    def begin(self, step: int) -> None:
        """Go back to the start of this step if the chain has been there: a block of steps that failed is repeated."""
        starts = self._starts
        if starts and next(reversed(starts)) >= step:
            self.eta, self.p = map(list, starts.get(step, (self.eta, self.p)))
            for later in [n for n in starts if n >= step]:
                del starts[later]
        starts[step] = (self.eta.copy(), self.p.copy())
        if len(starts) > KEPT_STEPS:
            del starts[next(iter(starts))]

    def advance(self, twice_kinetic: float, duration: float) -> float:
        """Advance the chain in contact with atoms of kinetic energy K; returns the factor for their velocities.
        twice_kinetic : 2K [energy]."""
        factor = 1.0
        members = range(len(self.p))
        for weight in WEIGHTS * self.loops:
            h = weight * duration / self.loops
            for j in reversed(members):
                self._push(j, twice_kinetic * factor * factor, 0.5 * h)
            for j in members:
                self.eta[j] += h * self.p[j] / self.inertia[j]
            factor *= exp(-h * self.p[0] / self.inertia[0])
            for j in members:
                self._push(j, twice_kinetic * factor * factor, 0.5 * h)
        return factor

    def _push(self, j: int, twice_kinetic: float, h: float) -> None:
        """Advance p_j by a time h, with all others fixed: half of the friction, the force, half of the friction."""
        p = self.p
        q = self.inertia
        damped = exp(-0.5 * h * p[j + 1] / q[j + 1]) if j + 1 < len(p) else 1.0
        force = twice_kinetic - self.n_dof * self.thermal
        if j > 0:
            force = p[j - 1] ** 2 / q[j - 1] - self.thermal
        p[j] = (p[j] * damped + h * force) * damped


class NoseHooverBath(Splitting):
    """Velocity Verlet between two half steps of a Nosé-Hoover chain, which the caller keeps; order 2, symmetric.
    chain : changed in place."""

    name = "nose-hoover-chain"
    substeps = (Thermalize(0.5), Kick(0.5), Drift(1.0), Kick(0.5), Thermalize(0.5))
    source = "G. J. Martyna et al., Mol. Phys. 87, 1117 (1996)"
    order = 2
    is_symmetric = True
    is_symplectic = False
    is_thermostat = True

    def __init__(self, timestep: float, chain: Chain) -> None:
        super().__init__(timestep)
        self.chain = chain

    def thermalize(self, state: State, duration: float, around: Surroundings) -> None:
        """Contact of the chain with the atoms over a duration."""
        bath = bath_of(around)
        if bath.contact == 0:
            self.chain.begin(bath.step)
        bath.contact += 1
        kinetic = kinetic_energy(state.velocities, state.masses)
        state.velocities *= self.chain.advance(2.0 * kinetic, duration)
