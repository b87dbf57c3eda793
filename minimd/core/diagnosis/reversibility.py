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
    n_steps : in each direction.
    distance, way : the largest of any atom from its start, at the end and at the reversal
        [length].
    rounding : growth of one rounding error from the turning point to the end, times √(2 n_steps) [length]; infinite if
        too chaotic to tell. Not measured, and 0, if is_exact.
    is_exact : whether all bits of positions and velocities came back.
    reason : why no run of this kind comes back to the last bit, if known.
    """

    n_steps: int
    distance: float
    way: float
    rounding: float
    unit: str
    is_exact: bool = False
    reason: str = ""

    @property
    def is_reversible(self) -> bool | None:
        """True if rounding explains the distance; None if rounding has grown too much to tell."""
        if self.distance == 0.0:
            return True
        if self.rounding > CHAOS * self.way:
            return None
        return self.distance <= ENOUGH * self.rounding

    def __str__(self) -> str:
        back = f"{self.n_steps} steps and back"
        if self.is_exact:
            return f"{back}, atoms went up to {self.way:.3g} {self.unit}: returned to the last bit"
        from_start = f"{self.distance:.1e} {self.unit} from the start (rounding grows to {self.rounding:.1e})"
        return f"{back}: {from_start}{self.reason}: {VERDICTS[self.is_reversible]}"

    def display_rows(self) -> Rows:
        """See Displayed."""
        summary, _, verdict = str(self).rpartition(": ")
        return [("reversibility", summary), ("", verdict)]


def make_steps_back(guard: RunGuard, n_steps: int) -> None:
    """See Simulation.run_back. At the end, step, time and velocities are those of the run that is retraced.
    Raises ValueError for an engine whose steps cannot be retraced to the last bit."""
    engine = guard.engine
    interactions = engine.interactions
    if interactions.grid is None:
        precision = repr(interactions.options.precision)
        raise ValueError(
            f"steps can be retraced only with precision='fixed-point'; precision is {precision}"
        )
    if engine.constraint_set.bonds is not None:
        raise ValueError(
            "steps with constraints cannot be retraced to the last bit: "
            "constraint impulses are rounded after they are computed"
        )
    if not engine.method.is_symmetric:
        raise ValueError(
            f"steps of {engine.method.name} cannot be retraced, because it is not symmetric: "
            "take velocity Verlet, position Verlet, leapfrog or symmetric compositions"
        )
    if engine.method.memory is not None:
        raise ValueError(
            f"steps of {engine.method.name} cannot be retraced: its memory has no way back"
        )
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
        bath = "there is a barostat"
        if engine.method.is_thermostat:
            bath = f"{engine.method.name} is a thermostat"
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
    unit = engine.system.units.length
    start = engine.snapshot()
    guard.make_steps(n_steps)
    way = longest(engine.positions - start.positions)[1]
    turn(engine)
    turning = engine.snapshot()
    forces = engine.forces.copy()
    guard.make_steps(n_steps)
    returned = engine.positions.copy()
    velocities = -engine.velocities
    has_returned = np.array_equal(returned, start.positions)
    if has_returned and np.array_equal(velocities, start.velocities):
        return Reversibility(n_steps, 0.0, way, 0.0, unit, is_exact=True)
    engine.restore(turning)
    # the turning point is displaced by some roundings of random sign: of coordinates (or the tolerance of a solver),
    # forces and velocities
    random = np.random.default_rng(1)
    shape = engine.positions.shape
    inverse_masses = engine.constraint_set.inverse_masses[:, None]
    bonds = engine.constraint_set.bonds
    amplified = AMPLIFIED * ROUNDING
    tolerance = 0.0 if bonds is None else AMPLIFIED * bonds.accuracy
    moves = (tolerance + amplified * np.abs(engine.positions)) * (inverse_masses > 0.0)
    engine.positions[:] += random.choice([-1.0, 1.0], shape) * moves
    kicks = np.abs(forces) * inverse_masses * abs(engine.method.timestep)
    sizes = kicks + np.abs(engine.velocities)
    engine.velocities[:] += random.choice([-1.0, 1.0], shape) * amplified * sizes
    guard.make_steps(n_steps)
    growth = longest(engine.positions - returned)[1]
    rounding = np.inf
    if growth <= CHAOS * way:
        # two roundings may undo each other, as where nothing acts
        rounding = max(growth / AMPLIFIED, ROUNDING * way) * (2.0 * n_steps) ** 0.5
    distance = longest(returned - start.positions)[1]
    is_rounded = bonds is not None and engine.interactions.grid is not None
    reason = ", since impulses of rigid bonds are rounded to the grid" if is_rounded else ""
    return Reversibility(n_steps, distance, way, rounding, unit, reason=reason)
