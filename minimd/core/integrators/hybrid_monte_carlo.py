"""Hybrid Monte Carlo: trajectories of velocity Verlet, accepted or taken back, so that the time step makes no error."""

from math import exp, inf
from typing import Any, ClassVar

import numpy as np

from minimd.core.integrators.ramp import Level, checked_level
from minimd.core.integrators.rows import VelocityVerlet
from minimd.core.integrators.state import State, Surroundings
from minimd.core.integrators.thermostats import LangevinBAOAB
from minimd.core.structure.arrays import Array
from minimd.core.structure.checks import SHORTEST, checked_count, checked_number

__all__ = ["HybridMonteCarlo"]

N_STEPS = 20  # of a trajectory, if not given
WANTED = 0.8  # of all proposals, accepted in an equilibration
# of the time step there: Δt ← Δt exp(GAIN k^(−FORGETTING) (acceptance − WANTED)), k − 1 times turned round
GAIN, FORGETTING = 1.0, 0.7
FARTHEST = 1000.0  # times the first time step, for scenes that accept all
MADE, ACCEPTED, CHANCES, WEIGHTS, SQUARES, CHECKED = range(6)  # places in the memory
N_COUNTS = 6


class HybridMonteCarlo(LangevinBAOAB):
    """Hybrid (Hamiltonian) Monte Carlo: the canonical ensemble, without any error of the time step.

        1. new velocities, those of the temperature: v = √(k_B T/m) ξ, ξ normal; or, with a friction,
           v ← e^(−γt) v + √((1 − e^(−2γt)) k_B T/m) ξ,  t = n_steps Δt       (generalized hybrid Monte Carlo)
        2. n_steps steps of velocity Verlet; H changes by ΔH
        3. accepted with probability min(1, e^(−ΔH/k_B T)); if not, positions are those before 2, and velocities those
           before 2 turned round

    One step of a simulation is one such proposal, decided: what is seen of it has the distribution of the ensemble, at
    any time step. A longer one lowers the acceptance, and no more. There is no dynamics: what correlates in time is
    refused. All 3N degrees of freedom are thermal. In an equilibration the time step finds itself, so that 0.8 of all
    proposals are accepted. Later it stays.

    With precision="fixed-point" all this is *exact*: a trajectory is a one-to-one map of whole numbers, momenta come
    from the exact Gaussian distribution of whole numbers, and decisions are made by whole numbers: detailed balance,
    π_i P_ij = π_j P_ji, is an identity of integers. See docs/hybrid-monte-carlo.md. There are no rigid bonds then.

    Once in a thousand proposals a trajectory is undone: see Report. In fixed point a run ends with RangeError where a
    number leaves its range; in float64 atoms that leave for infinity are taken back.

    Parameters
    ----------
    timestep : Δt > 0 [time].
    temperature : T > 0, or a Ramp.
    seed : int ≥ 0, below 2¹²⁸.
    n_steps : of a trajectory.
    friction : γ > 0 [1/time] of a partial change of velocities; None for new ones.

    S. Duane, A. D. Kennedy, B. J. Pendleton, D. Roweth, Phys. Lett. B 195, 216 (1987); A. M. Horowitz, Phys. Lett. B
    268, 247 (1991).
    """

    name = "hybrid-monte-carlo"
    substeps = VelocityVerlet.substeps
    source = "S. Duane, A. D. Kennedy, B. J. Pendleton, D. Roweth, Phys. Lett. B 195, 216 (1987)"
    is_dynamics: ClassVar[bool] = False
    last_kick = 0.0
    memory: Array

    def __init__(
        self,
        timestep: float,
        temperature: Level,
        seed: int,
        n_steps: int = N_STEPS,
        friction: float | None = None,
    ) -> None:
        known = 0.0 if friction is None else friction
        super().__init__(timestep, temperature, known, seed)
        checked_level("temperature", temperature, "positive and finite")
        self.n_steps = checked_count("n_steps", n_steps)
        self.friction: Any = friction
        if friction is not None:
            checked_number("friction", friction, "positive and finite", SHORTEST)
        self.memory = np.zeros(N_COUNTS)
        self._first = self.timestep
        self._n_turns = 0  # of the time step, from too long to too short and back
        self._excess = 0.0

    @property
    def duration(self) -> float:
        """Of a trajectory, n_steps Δt [time]."""
        return self.n_steps * self.timestep

    def kept_and_lost(self, duration: float) -> tuple[float, float]:
        """See LangevinBAOAB."""
        return (0.0, 1.0) if self.friction is None else super().kept_and_lost(duration)

    def advance(
        self,
        state: State,
        compute_forces: Any,
        n_steps: int,
        with_energy: bool = True,
        surroundings: Surroundings | None = None,
    ) -> int:
        """Raises TypeError: decisions are made by a Simulation, which knows energies."""
        raise TypeError(f"{self.name} needs a Simulation, which decides by the energy")

    def note(self, x: float, is_accepted: bool) -> None:
        """Count a proposal with x = ΔH/k_B T."""
        weight = exp(min(-x, 700.0)) if x < inf else 0.0
        self.memory[:CHECKED] += 1.0, is_accepted, min(1.0, weight), weight, weight * weight

    def adapt(self) -> None:
        """See Splitting; the proposals so far are forgotten."""
        n_made, _, chances, *_ = self.memory
        if n_made:
            excess = chances / n_made - WANTED
            self._n_turns += excess * self._excess < 0.0
            self._excess = excess
            factor = exp(GAIN * (1 + self._n_turns) ** -FORGETTING * excess)
            self.timestep = min(factor * self.timestep, FARTHEST * self._first)
        self.memory[:] = 0.0

    @property
    def acceptance(self) -> float:
        """The part of all proposals that was accepted, since the last equilibration; NaN of none."""
        n_made, n_accepted = self.memory[[MADE, ACCEPTED]]
        return float(n_accepted / n_made) if n_made else float("nan")

    @property
    def mean_weight(self) -> tuple[float, float]:
        """⟨e^(−ΔH/k_B T)⟩ of all proposals, which is 1, and its standard error; NaN of fewer than two."""
        n_made, weights, squares = self.memory[[MADE, WEIGHTS, SQUARES]]
        if n_made < 2.0:
            return float("nan"), float("nan")
        mean = weights / n_made
        variance = max(0.0, squares / n_made - mean * mean)
        return float(mean), float((variance / (n_made - 1.0)) ** 0.5)
