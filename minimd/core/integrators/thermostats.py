"""Methods in contact with a bath: the substeps of a splitting, and one more that changes velocities at random.

The noise depends only on the seed, the number of the step and the place of the contact within the step: a run that is
stopped and resumed, replayed after a failure, or made with another number of threads has the same noise. The energy
that the bath puts in is counted, so that total energy minus this sum changes only by the errors of kicks and drifts.
This difference drifts if Δt is large. G. Bussi, M. Parrinello, Phys. Rev. E 75, 056707 (2007); D. A. Sivak, J. D.
Chodera, G. E. Crooks, Phys. Rev. X 3, 011007 (2013).
"""

from collections import namedtuple
from collections.abc import Iterator
from functools import partial
from math import exp, sqrt
from typing import Any, ClassVar, Self

import numpy as np
from numpy.typing import NDArray

from minimd.core.compiled.by_address import ByAddress
from minimd.core.compiled.fixed_point import in_steps, is_fixed, on_grid
from minimd.core.compiled.kernels import DirectCalls, by_type, called_kernel, filling_kernel, scalar
from minimd.core.compiled.normal_numbers import (
    new_stream,
    normal,
    philox,
    start_stream,
    sum_of_squares,
    three_normals,
)
from minimd.core.compiled.program import GO_ON, Operation, Program, n_chunks_of, operation, share_of
from minimd.core.compiled.threads import thread_pool
from minimd.core.integrators.flows import mixed, momentum_in_steps, velocity_of
from minimd.core.integrators.method import Problem, Step
from minimd.core.integrators.ramp import Level, checked_level, level_at, points_of, value_at
from minimd.core.integrators.splitting import Splitting
from minimd.core.integrators.state import Bath, State, Surroundings
from minimd.core.integrators.steps import FIRST, MADE, Moment, projected
from minimd.core.integrators.substeps import (
    Drift,
    Kick,
    Substeps,
    Thermalize,
)
from minimd.core.structure.checks import SHORTEST, checked_count, checked_number
from minimd.core.structure.observables import AT_REST, SEEDS, kinetic_energy_of

__all__ = [
    "BrownianDynamics",
    "LangevinBAOAB",
    "LangevinGJF",
    "StochasticVelocityRescaling",
]

MOST_DRIFTS = 100
CALLS = {False: DirectCalls(), True: DirectCalls()}  # by whether there is a grid


def key_of(seed: int) -> NDArray[np.uint64]:
    """The key of Philox, (2,)."""
    return np.array([seed % 2**64, seed >> 64], dtype=np.uint64)


class Noise(ByAddress, namedtuple("Noise", "key counts begun contact")):
    """What selects noise.
    key : (2,) uint64 of Philox.
    counts, begun, contact : of a Moment."""


@scalar
def step_of(noise):
    """The number of the present step, see Moment."""
    return noise.counts[FIRST] + noise.counts[MADE] + noise.begun


class Thermostat(Splitting):
    """A splitting with a bath.
    timestep : Δt [time], positive.
    temperature : of the bath, ≥ 0, or a Ramp.
    seed : int ≥ 0, of the noise, below 2¹²⁸.
    Raises ValueError for a time step that is not positive, a temperature or a rate below zero, or a seed out of range.
    """

    temperature: Level
    seed: int
    is_symmetric = is_symplectic = False
    is_thermostat = True
    order = 2
    last_kick = 0.0  # of Δt, after the bath and the drifts, NaN if of several forces: see run_report.bath_of

    def __init__(self, timestep: float, temperature: Level, seed: int) -> None:
        super().__init__(timestep)
        if self.timestep < 0.0:
            raise ValueError(
                f"time cannot run backwards with a thermostat; timestep = {timestep!r}"
            )
        self.temperature = checked_level("temperature", temperature)
        self.seed = checked_count("seed", seed, 0, SEEDS)

    def temperature_at(self, step: int) -> float:
        """The temperature of the bath in the step with this number."""
        return level_at(self.temperature, step)

    @classmethod
    def with_relaxation_time(
        cls, timestep: float, temperature: Level, relaxation_time: float, seed: int
    ) -> Self:
        """The thermostat with this relaxation time, τ > 0 [time], which all have in scene files.
        Other arguments : see Thermostat."""
        raise NotImplementedError(
            f"{cls.name} cannot be used in a scene, because it has no with_relaxation_time; run it from a script"
        )

    @classmethod
    def on(cls, problem: Problem) -> Step:
        """Raises TypeError: a bath needs masses and a unit of temperature, which small problems do not have."""
        raise TypeError(
            f"{cls.name} cannot solve a bare problem, which has no unit of temperature; use it in a Simulation"
        )

    def contact(
        self, state: State, duration: float, around: Surroundings, moment: Moment
    ) -> Iterator[Operation]:
        """See Splitting; a derived class that has another thermalize is asked for that."""
        if type(self).thermalize is Thermostat.thermalize:
            yield from self.touch(state, duration, around, moment)
        else:
            yield from super().contact(state, duration, around, moment)

    def thermalize(self, state: State, duration: float, around: Surroundings) -> None:
        """The operations of touch, at once."""
        bath = bath_of(around)
        moment = Moment(np.array([0, 0, bath.step]), contact=bath.contact)
        touch = partial(self.touch, state, duration, around, moment)
        Program(touch, lambda: 0, thread_pool(1)).run()
        bath.contact += 1

    def noise_at(self, moment: Moment) -> "Noise":
        """What selects the noise of a contact."""
        return Noise(key_of(self.seed), moment.counts, moment.begun, moment.contact)

    def touch(
        self, state: State, duration: float, around: Surroundings, moment: Moment
    ) -> Iterator[Operation]:
        """The operations of a contact with the bath over a duration."""
        raise NotImplementedError(f"{self.name} has neither touch nor thermalize")

    def noise(self, bath: Bath) -> np.random.Generator:
        """The generator of random numbers for one contact with the bath: for this step and its place within it."""
        bath.contact += 1
        return philox(self.seed, bath.contact - 1, bath.step)


class LangevinBAOAB(Thermostat):
    """Langevin dynamics, with friction and independent noise on each atom: kick, drift, bath, drift, kick.

        v(t+Δt/2) = v(t) + Δt/2 F(t)/m                         B
        r(t+Δt/2) = r(t) + Δt/2 v                              A
        v ← e^(−γΔt) v + √(k_B T (1 − e^(−2γΔt))/m) ξ          O, the exact Ornstein-Uhlenbeck process; ξ normal
        r(t+Δt)   = r(t+Δt/2) + Δt/2 v                         A
        v(t+Δt)   = v + Δt/2 F(t+Δt)/m                         B

    Averages have errors of order 2. For harmonic forces, averages of positions are exact at any stable Δt, and those of
    v² are too low by the fraction (ωΔt)²/4: a kinetic temperature below that of the bath by O(Δt²) is an error of the
    time step, not of the bath. This also holds for rigid molecules; without forces they have the temperature of the
    bath. Momentum is not conserved, so all 3N degrees of freedom are thermal. Without friction this is velocity Verlet.

    Parameters
    ----------
    timestep : Δt > 0 [time].
    temperature : T ≥ 0, of the bath, or a Ramp.
    friction : γ ≥ 0 [1/time].
    seed : int ≥ 0 of the noise, below 2¹²⁸.
    drifts : in which each drift along rigid bonds is made: with more, atoms come nearer to their geodesics (g-BAOAB),
        without further forces. Nothing else changes.

    B. Leimkuhler, C. Matthews, Appl. Math. Res. Express 2013, 34 (2013); J. Chem. Phys. 138, 174102 (2013), eq. 7.
    With constraints: B. Leimkuhler, C. Matthews, Proc. R. Soc. A 472, 20160138 (2016).
    """

    name = "langevin-baoab"
    substeps: ClassVar[Substeps] = (
        Kick(0.5),
        Drift(0.5),
        Thermalize(1.0),
        Drift(0.5),
        Kick(0.5),
    )
    source = "B. Leimkuhler, C. Matthews, J. Chem. Phys. 138, 174102 (2013)"
    conserves_momentum = False
    last_kick = 0.5

    def __init__(
        self, timestep: float, temperature: Level, friction: float, seed: int, drifts: int = 1
    ) -> None:
        super().__init__(timestep, temperature, seed)
        self.friction = checked_number("friction", friction, "finite and not negative")
        self.drifts = checked_count("drifts", drifts, 1, MOST_DRIFTS)

    @classmethod
    def with_relaxation_time(
        cls,
        timestep: float,
        temperature: Level,
        relaxation_time: float,
        seed: int,
        **more: Any,
    ) -> Self:
        """See Thermostat; γ = 1/τ."""
        tau = checked_number("relaxation_time", relaxation_time, "positive and finite", SHORTEST)
        return cls(timestep, temperature, friction=1.0 / tau, seed=seed, **more)

    def kept_and_lost(self, duration: float) -> tuple[float, float]:
        """The part of a velocity that is left after a duration, e^(−γΔt), and that of its variance that is new."""
        return exp(-self.friction * duration), float(-np.expm1(-2.0 * self.friction * duration))

    def touch(
        self, state: State, duration: float, around: Surroundings, moment: Moment
    ) -> Iterator[Operation]:
        """The Ornstein-Uhlenbeck process over a duration, between two projections onto the constraints.

        The noise of an atom depends on seed, step, contact and the number of the atom."""
        bath = bath_of(around)
        n_chunks = n_chunks_of(len(state.velocities))
        is_held = around.constraints is not None
        touch = Touch(
            state.velocities,
            state.inverse_masses,
            state.masses,
            *self.kept_and_lost(duration),
            points_of(self.temperature, bath.k_B),
            self.noise_at(moment),
            np.zeros(n_chunks),
            bath.heat,
            int(is_held),
            bath.dimensions,
            state.steps,
        )
        calls = CALLS[bool(state.steps)]
        yield from projected(state, around)
        yield operation(calls, touch_atoms, touch, n_chunks)
        yield from projected(state, around)
        if is_held:
            yield operation(calls, add_kinetic, touch, n_chunks)
        yield operation(calls, count_heat, touch)


class LangevinGJF(LangevinBAOAB):
    """Langevin dynamics by the method of Grønbech-Jensen and Farago: diffusion is exact at any time step.

        r(t+Δt) = r(t) + c (r(t) − r(t−Δt)) + b Δt² F(t)/m + b Δt √(k_B T γΔt/2m) (ξ(t−Δt) + ξ(t)),
        c = (1 − γΔt/2)/(1 + γΔt/2),  b = 1/(1 + γΔt/2);  ξ normal

    These are the positions of LangevinBAOAB, if its bath keeps c of a velocity and not e^(−γΔt); velocities are made
    as there. In harmonic forces, averages of positions are exact for both. A free particle has D = k_B T/(mγ) here, and
    (k_B T/mγ) (γΔt/2) coth(γΔt/2) there, which is too large by one part in twelve at γΔt = 1.

    Parameters : see LangevinBAOAB.

    N. Grønbech-Jensen, O. Farago, Mol. Phys. 111, 983 (2013); the set of such methods: N. Grønbech-Jensen, Mol. Phys.
    118, e1662506 (2020).
    """

    name = "langevin-gjf"
    source = "N. Grønbech-Jensen, O. Farago, Mol. Phys. 111, 983 (2013)"

    def kept_and_lost(self, duration: float) -> tuple[float, float]:
        """c, and 1 − c²."""
        half = 0.5 * self.friction * duration
        kept = (1.0 - half) / (1.0 + half)
        return kept, 1.0 - kept * kept


class BrownianDynamics(LangevinBAOAB):
    """Brownian dynamics: overdamped motion, which has no inertia, by the method of Leimkuhler and Matthews.

        dr = F/(mγ) dt + √(2 k_B T/(mγ)) dW
        r(t+Δt) = r(t) + Δt/(mγ) F(t) + √(2 k_B T Δt/(mγ)) (ξ(t) + ξ(t+Δt))/2;  ξ normal

    Each number ξ is used twice: averages of positions have errors of order 2, those of harmonic forces none at any
    stable Δt, where the method of Euler and Maruyama has order 1. A free particle has D = k_B T/(mγ), exactly. There
    are no hydrodynamic interactions.

    This is the limit of LangevinBAOAB where the bath forgets all of a velocity, with substeps over √(2Δt/γ), the
    stride: it is stable while ω² Δt/γ < 2. A step begins with a whole kick, so that velocities between two steps are
    √(k_B T/m) ξ alone, and do not correlate in time. Pressure and reservoir energy are as there.

    Parameters
    ----------
    timestep : Δt > 0 [time], of the overdamped motion.
    temperature : T ≥ 0, of the bath, or a Ramp.
    friction : γ > 0 [1/time].
    seed : int ≥ 0 of the noise, below 2¹²⁸.

    B. Leimkuhler, C. Matthews, Appl. Math. Res. Express 2013, 34 (2013); B. Leimkuhler, C. Matthews, M. V.
    Tretyakov, Proc. R. Soc. A 470, 20140120 (2014).
    """

    name = "brownian-dynamics"
    substeps: ClassVar[Substeps] = (Kick(1.0), Drift(0.5), Thermalize(1.0), Drift(0.5))  # type: ignore[assignment]
    source = "B. Leimkuhler, C. Matthews, Appl. Math. Res. Express 2013, 34 (2013)"
    is_overdamped = True
    last_kick = 0.0

    def __init__(self, timestep: float, temperature: Level, friction: float, seed: int) -> None:
        super().__init__(timestep, temperature, friction, seed)
        checked_number("friction", friction, "positive and finite", SHORTEST)

    @property
    def stride(self) -> float:
        """√(2Δt/γ), see Splitting."""
        return sqrt(2.0 * self.timestep / self.friction)

    def timestep_of(self, stride: float) -> float:
        """See Splitting."""
        return 0.5 * self.friction * stride * stride

    @classmethod
    def sequence(cls) -> Substeps:
        """Of these steps, begun in the middle of a kick."""
        return LangevinBAOAB.sequence()

    def kept_and_lost(self, duration: float) -> tuple[float, float]:
        """Nothing is kept."""
        return 0.0, 1.0


class Touch(
    ByAddress,
    namedtuple(
        "Touch",
        "velocities inverse_masses masses kept lost thermal noise parts heat is_held dimensions steps",
    ),
):
    """The contact of atoms with a bath, see LangevinBAOAB.
    velocities : (N, 3).
    inverse_masses, masses : (N,), zero for atoms that are held fixed.
    kept, lost : e^(−γΔt), and 1 − e^(−2γΔt).
    thermal : k_B T [energy], points of a ramp.
    noise : Noise.
    parts : (chunks,) output, heat of each chunk [energy].
    heat : (1,), to which it is added.
    is_held : whether constraints follow, before the kinetic energy afterwards is known.
    dimensions : 3, or 2 of a plane, whose z stays.
    steps : of a grid, or ()."""


@filling_kernel
def touch_atoms(touch, chunk):
    """v ← kept · v + √(k_B T lost/m) ξ."""
    velocities = touch.velocities
    masses = touch.masses
    n_chunks = touch.parts.size
    n = masses.size
    stream = new_stream(touch.noise.key)
    noise = touch.noise
    heat = 0.0
    step = step_of(noise)
    spread = sqrt(value_at(touch.thermal, step) * touch.lost)
    first, last = share_of(chunk, n_chunks, n)
    for i in range(first, last):
        if touch.inverse_masses[i] > 0.0:
            heat -= kinetic_energy_at(velocities, masses, i, touch.steps)
            scale = spread * sqrt(touch.inverse_masses[i])
            for c, xi in enumerate(three_normals(stream, i, noise.contact, step)):
                if c < touch.dimensions:
                    v = mixed(velocities[i, c], xi, touch.kept, scale)
                    velocities[i, c] = settled(v, touch.inverse_masses[i], touch.steps)
            if not touch.is_held:
                heat += kinetic_energy_at(velocities, masses, i, touch.steps)
    touch.parts[chunk] = heat
    return GO_ON


@called_kernel
def add_kinetic(touch, chunk):
    """The heat of a chunk += its kinetic energy now."""
    n = touch.masses.size
    n_chunks = touch.parts.size
    first, last = share_of(chunk, n_chunks, n)
    for i in range(first, last):
        touch.parts[chunk] += kinetic_energy_at(touch.velocities, touch.masses, i, touch.steps)
    return GO_ON


@called_kernel
def count_heat(touch, _chunk):
    """The heat of all chunks."""
    heat = 0.0
    for part in touch.parts:
        heat += part
    touch.heat[0] += heat
    return GO_ON


@scalar
def kinetic_energy_at(velocities, masses, i, steps):
    """½ m v² of atom i [energy]; on a grid rounded to it."""
    x, y, z = velocities[i, 0], velocities[i, 1], velocities[i, 2]
    return in_steps(kinetic_energy_of(masses[i], x, y, z), steps)


@by_type
def on_steps(momentum, steps):
    """A momentum, rounded to its grid if there is one."""
    if is_fixed(steps):
        return lambda momentum, steps: on_grid(momentum, steps.momentum)
    return lambda momentum, steps: momentum


@by_type
def settled(velocity, inverse_mass, steps):
    """A velocity, rounded to its grid if there is one."""
    if not is_fixed(steps):
        return lambda velocity, inverse_mass, steps: velocity
    return lambda velocity, inverse_mass, steps: velocity_of(
        momentum_in_steps(velocity, inverse_mass, steps), inverse_mass, steps
    )


class StochasticVelocityRescaling(Thermostat):
    """Velocity Verlet, then velocities times one factor, drawn so that kinetic energy has its canonical distribution.

        dK = (K̄ − K) dt/τ + 2 √(K K̄/n_dof) dW/√τ,  K̄ = n_dof k_B T/2

    solved exactly over Δt: with c = e^(−Δt/τ), normal ξ and S the sum of n_dof − 1 squares of others,

        K′ = c K + (1 − c) K̄/n_dof (S + ξ²) + 2 ξ √(c (1 − c) K K̄/n_dof)

    K is the kinetic energy of the n_dof degrees of freedom. If total momentum is conserved, the motion of the center of
    mass is not among them: K is then relative to its velocity V, which is kept, v ← V + √(K′/K) (v − V). If atoms are
    held fixed, V is zero. Directions of motion are kept, so that the dynamics is hardly disturbed.

    Parameters
    ----------
    timestep : Δt > 0 [time].
    temperature : T ≥ 0, of the bath, or a Ramp.
    relaxation_time : τ > 0 [time].
    seed : int ≥ 0 of the noise, below 2¹²⁸.

    G. Bussi, D. Donadio, M. Parrinello, J. Chem. Phys. 126, 014101 (2007), eq. A7.
    """

    name = "stochastic-velocity-rescaling"
    substeps = (Kick(0.5), Drift(1.0), Kick(0.5), Thermalize(1.0))
    source = "G. Bussi, D. Donadio, M. Parrinello, J. Chem. Phys. 126, 014101 (2007)"

    def __init__(
        self, timestep: float, temperature: Level, relaxation_time: float, seed: int
    ) -> None:
        super().__init__(timestep, temperature, seed)
        self.relaxation_time = checked_number(
            "relaxation_time", relaxation_time, "positive and finite", SHORTEST
        )

    @classmethod
    def with_relaxation_time(
        cls, timestep: float, temperature: Level, relaxation_time: float, seed: int
    ) -> Self:
        """See Thermostat."""
        return cls(timestep, temperature, relaxation_time, seed)

    def touch(
        self, state: State, duration: float, around: Surroundings, moment: Moment
    ) -> Iterator[Operation]:
        """The exact change of the kinetic energy over a duration."""
        bath = bath_of(around)
        n_chunks = n_chunks_of(len(state.velocities))
        calls = CALLS[bool(state.steps)]
        rescaling = Rescaling(
            state.velocities,
            state.inverse_masses,
            state.masses,
            exp(-duration / self.relaxation_time),
            points_of(self.temperature, bath.k_B),
            float(state.masses.sum()),
            bath.thermal,
            self.noise_at(moment),
            np.zeros((n_chunks, 4)),
            np.zeros(4),
            bath.heat,
            state.steps,
        )
        yield from projected(state, around)
        yield operation(calls, sum_motion, rescaling, n_chunks)
        yield operation(calls, draw_scale, rescaling)
        yield operation(calls, rescale_atoms, rescaling, n_chunks)


class Rescaling(
    ByAddress,
    namedtuple(
        "Rescaling",
        "velocities inverse_masses masses kept thermal_energies mass "
        "thermal noise parts motion heat steps",
    ),
):
    """The contact of all atoms with a bath, see StochasticVelocityRescaling.
    velocities : (N, 3).
    inverse_masses, masses : (N,), zero for atoms that are held fixed.
    kept : e^(−Δt/τ).
    thermal_energies : k_B T [energy], points of a ramp.
    mass : of all atoms.
    thermal : of Bath.
    noise : Noise.
    parts : (chunks, 4) output, momentum and kinetic energy of each chunk.
    motion : (4,) output, V, and √(K′/K) with its sign.
    heat : (1,), to which the heat is added.
    steps : of a grid."""


@called_kernel
def sum_motion(rescaling, chunk):
    """Momentum and kinetic energy of a chunk."""
    v = rescaling.velocities
    masses = rescaling.masses
    steps = rescaling.steps
    n_chunks = rescaling.parts.shape[0]
    x = y = z = energy = 0.0
    first, last = share_of(chunk, n_chunks, masses.size)
    for i in range(first, last):
        x += on_steps(masses[i] * v[i, 0], steps)
        y += on_steps(masses[i] * v[i, 1], steps)
        z += on_steps(masses[i] * v[i, 2], steps)
        energy += kinetic_energy_at(v, masses, i, steps)
    for c, part in enumerate((x, y, z, energy)):
        rescaling.parts[chunk, c] = part
    return GO_ON


@filling_kernel
def draw_scale(rescaling, _chunk):
    """V, and the factor for the velocities relative to it; and the heat."""
    n_dof, leaves_out_center = rescaling.thermal
    motion = rescaling.motion
    kept = rescaling.kept
    for c in range(4):
        motion[c] = 0.0
        for part in rescaling.parts[:, c]:
            motion[c] += part
    kinetic = total = motion[3]
    for c in range(3):
        motion[c] = motion[c] / rescaling.mass if leaves_out_center else 0.0
        kinetic -= 0.5 * rescaling.mass * motion[c] * motion[c]
    motion[3] = 1.0
    if kinetic <= AT_REST * total:  # rounding
        return GO_ON
    stream = new_stream(rescaling.noise.key)
    step = step_of(rescaling.noise)
    start_stream(stream, 0, rescaling.noise.contact, step)
    xi = normal(stream)
    thermal_energy = value_at(rescaling.thermal_energies, step)
    share = (1.0 - kept) * 0.5 * thermal_energy / kinetic
    squares = sum_of_squares(stream, n_dof - 1) + xi * xi
    square = max(kept + share * squares + 2.0 * xi * sqrt(kept * share), 0.0)
    is_reversed = share > 0.0 and xi < -sqrt(kept / share)
    motion[3] = -sqrt(square) if is_reversed else sqrt(square)
    rescaling.heat[0] += in_steps(kinetic * (square - 1.0), rescaling.steps)
    return GO_ON


@called_kernel
def rescale_atoms(rescaling, chunk):
    """velocities = V + scale · (velocities − V)."""
    v = rescaling.velocities
    motion = rescaling.motion
    n = rescaling.masses.size
    n_chunks = rescaling.parts.shape[0]
    scale = motion[3]
    if scale == 1.0:
        return GO_ON
    first, last = share_of(chunk, n_chunks, n)
    for i in range(first, last):
        for c in range(3):
            moved = (1.0 - scale) * motion[c] + scale * v[i, c]
            v[i, c] = settled(moved, rescaling.inverse_masses[i], rescaling.steps)
    return GO_ON


def bath_of(around: Surroundings) -> Bath:
    """The bath that a thermostat needs.
    Raises ValueError if there is none."""
    if around.bath is None:
        raise ValueError(
            "a thermostat needs a bath to count the energy it gives: "
            "pass surroundings=Surroundings(bath=Bath(k_B, n_dof))"
        )
    return around.bath
