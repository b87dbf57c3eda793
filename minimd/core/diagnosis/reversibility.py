"""Whether a simulation is reversible: some steps, all velocities reversed, and as many steps again.

A symmetric method without a bath returns to its start except for rounding, which grows along a chaotic path. This
growth is measured on the same path: the way back is made twice, the second time from a turning point displaced by some
rounding errors. Forces that depend on the past, a list that misses pairs, a solver that stops early do not return.
"""

from dataclasses import dataclass

import numpy as np

from minimd.core.console.display import Displayed, Rows
from minimd.core.console.signals import stop_on_signals
from minimd.core.diagnosis.run_guard import RunGuard
from minimd.core.engine.engine import Engine
from minimd.core.structure.observables import longest

ROUNDING = 2.0**-52  # of the forces
# rounding errors by which the turning point is displaced, so that their growth stands out
AMPLIFIED = 1e3
# times what one rounding grows to, times the square root of the steps: up to this, a distance is due to rounding
ENOUGH = 3.0
CHAOS = 0.01  # of the way that atoms went: beyond it, rounding has grown too much to tell
VERDICTS = {
    True: "reversible to rounding",
    None: "too chaotic to tell; probe fewer steps",
    False: "NOT REVERSIBLE",
}


@dataclass(frozen=True)
class Reversibility(Displayed):
    """The result of Simulation.probe_reversibility. str() gives one line.

    Attributes
    ----------
    n_steps : in each direction.  distance, way : the largest of any atom from its start, at the end and at the reversal
        [length].
    rounding : growth of one rounding error from the turning point to the end, times √(2 n_steps) [length]; infinite if
        too chaotic to tell. Not measured, and 0, if is_exact.
    is_exact : whether all bits of positions and velocities came back.
    """

    n_steps: int
    distance: float
    way: float
    rounding: float
    unit: str
    is_exact: bool = False

    @property
    def is_reversible(self) -> bool | None:
        """True if rounding explains the distance; None if rounding has grown too much to tell."""
        if self.distance == 0.0:
            return True
        return None if self.rounding > CHAOS * self.way else self.distance <= ENOUGH * self.rounding

    def __str__(self) -> str:
        back = f"{self.n_steps} steps and back"
        if self.is_exact:
            return f"{back}, atoms went up to {self.way:.3g} {self.unit}: returned to the last bit"
        from_start = f"{self.distance:.1e} {self.unit} from the start (rounding grows to {self.rounding:.1e})"
        return f"{back}: {from_start}: {VERDICTS[self.is_reversible]}"

    def display_rows(self) -> Rows:
        """See Displayed."""
        words, _, verdict = str(self).rpartition(": ")
        return [("reversibility", words), ("", verdict)]


def make_steps_back(guard: RunGuard, n_steps: int) -> None:
    """See Simulation.run_back. At the end, step, time and velocities are those of the run that is retraced.
    Raises ValueError for an engine whose steps cannot be retraced to the last bit."""
    engine = guard.engine
    precision = guard.engine.interactions.options.precision
    if engine.interactions.grid is None:
        raise ValueError(
            f"steps can be retraced only with precision='fixed-point'; precision is {precision!r}"
        )
    if engine.constraint_set.bonds is not None:
        rounded = "constraint impulses are rounded after they are computed"
        raise ValueError(f"steps with constraints cannot be retraced to the last bit: {rounded}")
    if not engine.method.is_symmetric:
        take = "it is not symmetric: take velocity Verlet, position Verlet, leapfrog or symmetric compositions"
        raise ValueError(f"steps of {engine.method.name} cannot be retraced, because {take}")
    with guard.uncounted(), stop_on_signals(engine.surroundings):
        guard.check_start()
        step = engine.step
        turn(engine)
        try:
            guard.make_steps(n_steps)
        finally:
            turn(engine)
            engine.count(-2 * (engine.step - step))
            engine.leave()


def turn(engine: Engine) -> None:
    """Reverse all velocities; zeros keep their sign."""
    engine.velocities[:] = 0.0 - engine.velocities


def probe(guard: RunGuard, n_steps: int) -> Reversibility:
    """See Simulation.probe_reversibility."""
    engine = guard.engine
    if engine.has_bath:
        bath = (
            f"{engine.method.name} is a thermostat"
            if engine.method.is_thermostat
            else "there is a barostat"
        )
        raise ValueError(f"{bath}: its noise cannot be undone, so no run with it is reversible")
    if engine.interactions.depend_on_time:
        raise ValueError(
            "a run with forces that depend on time has no way back: probe a run without these forces"
        )
    before = engine.snapshot()
    with guard.uncounted():
        guard.check_start()
        try:
            with stop_on_signals(engine.surroundings):
                return _probed(guard, n_steps)
        finally:
            engine.restore(before)


def _probed(guard: RunGuard, n_steps: int) -> Reversibility:
    """Probe, without restoring the state."""
    engine = guard.engine
    start = engine.snapshot()
    guard.make_steps(n_steps)
    way = longest(engine.positions - start.positions)[1]
    turn(engine)
    turning = engine.snapshot()
    forces = engine.forces.copy()
    guard.make_steps(n_steps)
    returned = engine.positions.copy()
    if np.array_equal(returned, start.positions) and np.array_equal(
        -engine.velocities, start.velocities
    ):
        return Reversibility(n_steps, 0.0, way, 0.0, engine.system.units.length, is_exact=True)
    engine.restore(turning)
    # the turning point is displaced by some roundings of random sign: of coordinates (or the tolerance of a solver),
    # forces and velocities
    random = np.random.default_rng(1)
    shape = engine.positions.shape
    moving = engine.constraint_set.inverse_masses[:, None]
    amplified = AMPLIFIED * ROUNDING
    kicks = np.abs(forces) * moving * abs(engine.method.timestep)
    swept = 0.0 if engine.constraint_set.bonds is None else engine.constraint_set.bonds.accuracy
    sizes = (AMPLIFIED * swept + amplified * np.abs(engine.positions)) * (moving > 0.0)
    engine.positions[:] += random.choice([-1.0, 1.0], shape) * sizes
    engine.velocities[:] += (
        random.choice([-1.0, 1.0], shape) * amplified * (kicks + np.abs(engine.velocities))
    )
    guard.make_steps(n_steps)
    growth = longest(engine.positions - returned)[1]
    # two roundings may undo each other, as where nothing acts
    one = max(growth / AMPLIFIED, ROUNDING * way)
    rounding = one * (2.0 * n_steps) ** 0.5 if growth <= CHAOS * way else np.inf
    return Reversibility(
        n_steps, longest(returned - start.positions)[1], way, rounding, engine.system.units.length
    )
