"""Stochastic cell rescaling: a bath of constant pressure, which strains the cell and everything in it.

It acts every few steps, on the state between two steps: a splitting of the whole evolution in which each part is
reversible. The energy it gives to the system is counted like the heat of a thermostat:
total energy minus reservoir energy changes only by errors of the time step.
"""

from dataclasses import dataclass, field, fields
from math import inf, log, sqrt
from typing import Any, NamedTuple

import numpy as np

from minimd.core.compiled.normal_numbers import OF_BAROSTATS, STEPS, normals
from minimd.core.console.display import Displayed, Rows, as_text
from minimd.core.integrators.ramp import Level, checked_level
from minimd.core.integrators.thermostats import key_of
from minimd.core.structure.arrays import Array
from minimd.core.structure.checks import checked_choice, checked_count, checked_number
from minimd.core.structure.observables import SEEDS

__all__ = ["StochasticCellRescaling"]

AXES = "xyz"
COUPLINGS = ("isotropic", "triclinic", "x", "y", "z", "xy", "xz", "yz", "xyz")


class ThermodynamicState(NamedTuple):
    """What a barostat needs to know about a state.
    pressure : P, (3, 3) [energy/length³], kinetic part included.
    volume : V [length³].
    energy : E = K + U [energy].
    thermal, target : k_B T [energy] and P₀ [energy/length³] of the baths.
    dimensions : d, in which the cell is strained."""

    pressure: Array
    volume: float
    energy: float
    thermal: float
    target: float
    dimensions: int = 3

    @property
    def unit(self) -> Array:
        """1, (3, 3), with zeros along directions that are not strained."""
        return np.diag((np.arange(3) < self.dimensions).astype(np.float64))

    @property
    def mean_pressure(self) -> float:
        """P, the trace/d."""
        return float(self.pressure.trace()) / self.dimensions


@dataclass(frozen=True, repr=False)
class StochasticCellRescaling(Displayed):
    """Constant pressure by stochastic cell rescaling: a first-order bath with the fluctuations of the
    isothermal-isobaric ensemble.

        dλ = −(βλ/2τ) (P₀ − P − k_B T/2V) dt + √(k_B T β/2τ) dW,  λ = √V   isotropic: Bernetti and Bussi, eq. 7
        dε = −(β/dτ) 𝒫[P₀ 1 − P] dt + √(2 k_B T β/dVτ) 𝒫[dW]                          anisotropic: Del Tatto et al.
        r ← r e^ε,  v ← v e^(−ε),  cell ← cell e^ε;  isotropic e^ε = (V′/V)^(1/d)

    d is 3, or 2 in a plane. P is the pressure, isotropic its trace/d; ε is the strain and W a symmetric matrix of
    white noise. 𝒫 keeps the strains that the coupling allows: along some axes, each by itself, or all of them
    ("triclinic"), followed by the rotation that keeps the direction of the first lattice vector and the plane of
    the first two. ε is symmetric, and its trace is d ln V, as in eq. 4 of the first paper. Atoms joined by fixed
    lengths form molecules: their centers of mass move as above, and P is the molecular pressure.

    The bath acts at every n-th step, over h = nΔt, by one Euler step with the drift b = −(βλh/2τ)(…) or m = −(βh/dτ)
    𝒫[…]. It changes

        H = E − reservoir energy

    by ΔE + P₀ΔV − ½ k_B T ln(V′/V) + (τ/βh) [(λ′ − λ + b′)² − (λ′ − λ − b)²], or, with n free strains,
    by ΔE + P₀ΔV − (1 + n/2) k_B T ln(V′/V) + (dτ/4βh) [V′|ε + m′|² − V|ε − m|²], where ′ means afterwards. This is zero
    up to errors of the finite h, as for thermostats. All other energy it gives to the system, heat and work, is counted
    in the reservoir energy. Fluctuations of V are too large by a fraction of the order h/τ.

    With a thermostat this gives the isothermal-isobaric (NPT) ensemble. Without one, only the noise of the cell brings
    the temperature to T, and it does so slowly; until then the run samples no standard ensemble,
    not even the isobaric-isenthalpic one.

    Parameters
    ----------
    pressure : P₀ [energy/length^d], or a Ramp.
    compressibility : β, isothermal [length^d/energy]; a rough value is enough, since only β/τ matters;
        4.6e-5 bar⁻¹ for water.
    relaxation_time : τ of the volume, > 0 [time]; at least 10 nΔt. With one free axis it takes three times as long.
    seed : int ≥ 0 of the noise, below 2¹²⁸.
    temperature : T ≥ 0, or a Ramp; that of the thermostat if not given.
    coupling : "isotropic", "triclinic", or axes that change each by itself, such as "z" or "xy".
    every : n, number of steps between two strains. Each costs as much as several steps: energy and virial twice.

    Raises
    ------
    ValueError : for a number out of range or an unknown coupling.

    M. Bernetti, G. Bussi, J. Chem. Phys. 153, 114107 (2020); V. Del Tatto, P. Raiteri, M. Bernetti, G. Bussi, Appl.
    Sci. 12, 1139 (2022).
    """

    pressure: Level
    compressibility: float
    relaxation_time: float
    seed: int
    temperature: Level | None = None
    coupling: str = "isotropic"
    every: int = 50
    mask: Array = field(init=False, compare=False)  # of the strains that 𝒫 keeps
    _key: Array = field(init=False, compare=False)  # of the noise

    def __post_init__(self) -> None:
        object.__setattr__(self, "pressure", checked_level("pressure", self.pressure, "finite"))
        checked_number("compressibility", self.compressibility, "positive and finite")
        checked_number("relaxation_time", self.relaxation_time, "positive and finite")
        checked_count("seed", self.seed, 0, SEEDS)
        checked_count("every", self.every)
        if self.temperature is not None:
            level = checked_level("temperature", self.temperature)
            object.__setattr__(self, "temperature", level)
        checked_choice("coupling", self.coupling, COUPLINGS)
        axes = np.array([axis in self.coupling for axis in AXES], dtype=np.float64)
        mask = np.ones((3, 3)) if self.coupling == "triclinic" else np.diag(axes)
        object.__setattr__(self, "mask", mask)
        object.__setattr__(self, "_key", key_of(self.seed))

    def __repr__(self) -> str:
        arguments = (f"{name}={as_text(value)}" for name, value in self.stated.items())
        return f"StochasticCellRescaling({', '.join(arguments)})"

    def display_rows(self) -> Rows:
        """See Displayed."""
        rows = [("barostat", "stochastic cell rescaling")]
        return rows + [(name, as_text(value)) for name, value in self.stated.items()]

    @property
    def parameters(self) -> dict[str, float | int | str | None]:
        """The constructor arguments that recreate this barostat, by name."""
        return {field.name: getattr(self, field.name) for field in fields(self) if field.init}

    @property
    def stated(self) -> dict[str, Any]:
        """Those of the parameters that are not None."""
        return {name: value for name, value in self.parameters.items() if value is not None}

    def strain(self, state: ThermodynamicState, duration: float, number: int) -> Array:
        """ε, (3, 3).
        duration : h [time].
        number : of the step; it selects the noise."""
        white = normals(self._key, 0, OF_BAROSTATS, np.uint64(number % STEPS), 9).reshape(3, 3)
        if self.coupling == "isotropic":
            variance = 0.5 * state.thermal * self.compressibility * duration / self.relaxation_time
            change = self._drift_of_root(state, duration) + sqrt(variance) * white[0, 0]
            larger = 1.0 + change / sqrt(state.volume)  # λ′/λ
            along = 2.0 / state.dimensions * log(larger) if larger > 0.0 else -inf
            return np.where(state.unit == 1.0, along, 0.0)
        slowness = state.dimensions * state.volume * self.relaxation_time
        spread = sqrt(2.0 * state.thermal * self.compressibility * duration / slowness)
        noise = spread * self._kept(state) * 0.5 * (white + white.T)
        return self._drift_of_strain(state, duration) + noise

    def change_of_conserved(
        self, before: ThermodynamicState, after: ThermodynamicState, strain: Array, duration: float
    ) -> float:
        """ΔH [energy] of one strain, as above.

        It is k_B T ln of the ratio of two probabilities: of the strain and of its reverse,
        each times that of the state it starts from."""
        work = after.energy - before.energy + before.target * (after.volume - before.volume)
        entropy = before.thermal * log(after.volume / before.volume)
        rate = self.relaxation_time / (self.compressibility * duration)
        if self.coupling == "isotropic":
            change = sqrt(after.volume) - sqrt(before.volume)
            back = change + self._drift_of_root(after, duration)
            there = change - self._drift_of_root(before, duration)
            return work - 0.5 * entropy + rate * (back**2 - there**2)
        returned = strain + self._drift_of_strain(after, duration)
        gone = strain - self._drift_of_strain(before, duration)
        n_free = np.tril(self._kept(after)).sum()
        gaussian = after.volume * np.square(returned).sum() - before.volume * np.square(gone).sum()
        of_noise = 0.25 * after.dimensions * rate * gaussian
        return float(work - (1.0 + 0.5 * n_free) * entropy + of_noise)

    def _kept(self, state: ThermodynamicState) -> Array:
        """The strains that 𝒫 keeps, (3, 3), 1 or 0."""
        axes = state.unit.diagonal()
        return np.asarray(self.mask * np.outer(axes, axes))

    def _drift_of_root(self, state: ThermodynamicState, duration: float) -> float:
        """b = −(βλh/2τ) (P₀ − P − k_B T/2V) [√volume]."""
        excess = state.mean_pressure - state.target + 0.5 * state.thermal / state.volume
        root = sqrt(state.volume)
        return 0.5 * self.compressibility * root * duration / self.relaxation_time * excess

    def _drift_of_strain(self, state: ThermodynamicState, duration: float) -> Array:
        """m = −(βh/dτ) 𝒫[P₀ 1 − P], (3, 3)."""
        factor = self.compressibility * duration / (state.dimensions * self.relaxation_time)
        return factor * self._kept(state) * (state.pressure - state.target * np.eye(3))


def exponential(strain: Array) -> Array:
    """e^ε of a symmetric (3, 3) matrix."""
    if strain[0, 1] == strain[0, 2] == strain[1, 2] == 0.0:
        return np.diag(np.exp(strain.diagonal()))
    values, vectors = np.linalg.eigh(strain)
    return np.asarray((vectors * np.exp(values)) @ vectors.T)


def turned_back(before: Array, strained: Array) -> tuple[Array, Array]:
    """Strained lattice vectors (3, 3), rows, rotated so that the first has its old direction and the first two their
    old plane; and the rotation."""
    frame, _ = np.linalg.qr(before.T)
    own, triangle = np.linalg.qr(strained.T)
    # of the axes: a strain turns them only slightly
    signs = np.sign(np.einsum("ij,ij->j", frame, own))
    own = own * signs
    triangle = triangle * signs[:, None]
    return triangle.T @ frame.T, own @ frame.T
