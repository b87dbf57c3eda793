"""Splitting methods: the flows of the two halves of H = T(p) + V(q), composed as a sequence of substeps.

    drift  φ[1]:  r(t+cΔt) = r(t) + cΔt v            velocities are constant
    kick   φ[2]:  v(t+cΔt) = v(t) + cΔt F(r)/m       positions are constant

Each half is solved exactly, so every composition is symplectic and conserves total momentum. It is reversible if the
sequence equals its reverse. E. Hairer, C. Lubich, G. Wanner, Geometric Numerical Integration (2006), II.5.
"""

from collections.abc import Callable, Iterable
from typing import ClassVar

import numpy as np

from minimd.integrators.method import ClassProperty, Method, Problem, Step
from minimd.integrators.splitting.order_conditions import nystrom_order
from minimd.integrators.splitting.state import Cycle, State, Surroundings
from minimd.integrators.splitting.substeps import (
    Drift,
    Kick,
    Substep,
    Substeps,
    Thermalize,
    is_palindrome,
    mechanical,
    merged,
)

__all__ = ["Splitting"]

ComputeForces = Callable[[State, bool], None]  # fills state.forces; with True, evaluates the energy too

# (state, cycle, n): repeats a cycle up to n times; returns how many times, 0 if it cannot. Afterwards the forces are
# outdated.
March = Callable[[State, Cycle, int], int]


def stages(method: "type[Splitting]") -> int:
    """Force evaluations per step of a long run: groups of kicks with no drift between them;
    the last and the first kick form one group."""
    kicks = [isinstance(substep, Kick) for substep in merged(mechanical(method.substeps))]
    return sum(kicks) - (len(kicks) > 1 and kicks[0] and kicks[-1])


class Splitting(Method):
    """A splitting method, given by its sequence of substeps.

    If the first and the last substep are of one kind, the two are merged between steps: within a block of steps
    velocity Verlet makes one kick and one drift per step, as leapfrog does. Forces are computed when a kick needs them
    and positions have moved since. With constraints every drift is projected. Velocities are projected only at the end
    of a block, because a constrained drift does not depend on the component that a projection removes. A block can
    continue from the open end of the previous one, see Surroundings: two blocks then give the same bits as one.

    Parameters, Raises : as Method.

    Attributes of each method
    -------------------------
    name, substeps, source : key in METHODS; kicks and drifts of one step; literature.
    conserves_momentum : true unless a bath acts on each atom separately.  is_thermostat : whether a bath acts at all.
    opening, closing : substeps before the first and after the last step of a block, for velocities at half steps.

    Attributes computed from them
    -----------------------------
    order : p of the global error O(Δtᵖ) for H = p²/2m + V(q).  stages : force evaluations per step of a long run.
    is_symmetric : whether Φ_Δt ∘ Φ_{−Δt} = 1; the method is then also reversible.  is_symplectic : true without a bath.
    """

    substeps: ClassVar[Substeps]
    opening: ClassVar[Substeps] = ()
    closing: ClassVar[Substeps] = ()
    is_symplectic: ClassVar[bool] = True
    is_explicit: ClassVar[bool] = True
    conserves_momentum: ClassVar[bool] = True
    is_thermostat: ClassVar[bool] = False
    order = ClassProperty(lambda method: nystrom_order(method.sequence()))
    is_symmetric = ClassProperty(lambda method: is_palindrome(method.sequence()))
    stages = ClassProperty(stages)

    @classmethod
    def sequence(cls) -> Substeps:
        """One step from opening to closing, neighbors of one kind merged."""
        return merged((*cls.opening, *cls.substeps, *cls.closing))

    @classmethod
    def on(cls, problem: Problem) -> Step:
        """The step on a problem with q and v, see Partitioned.sequence_step.  Raises TypeError for other problems."""
        if not hasattr(problem, "sequence_step"):
            raise TypeError(
                f"{cls.name} needs a problem with q and v, SecondOrder or Partitioned; got {type(problem).__name__}"
            )
        return problem.sequence_step(cls.sequence())

    @classmethod
    def order_on(cls, problem: Problem) -> int:
        """See Method."""
        return problem.sequence_order(cls.sequence()) if hasattr(problem, "sequence_order") else cls.order

    def advance(
        self,
        state: State,
        compute_forces: ComputeForces,
        n_steps: int,
        with_energy: bool = True,
        surroundings: Surroundings | None = None,
        march: March | None = None,
    ) -> int:
        """Make n_steps steps, or fewer (at least one) if surroundings.stop_requested becomes true;
        return how many were made.

        with_energy : evaluate the energy together with the forces of the last step.  surroundings :
            constraints and bath, if there are any.
        march : makes many steps at once where it can; see March.

        Raises
        ------
        ConstraintError : if a constrained length cannot be kept.  ValueError : from a thermostat without a bath.
        """
        around = Surroundings() if surroundings is None else surroundings
        start, cycle, end = self._grouped(may_merge_drifts=around.constraints is None)
        first_kick = next((k for k, substep in enumerate(cycle) if isinstance(substep, Kick)), 0)
        repeated = (
            None
            if march is None or around.constraints is not None
            else self.repeated(cycle[first_kick:] + cycle[:first_kick], around)
        )
        units = self.units({*start, *cycle, *end})
        step, goes_on = 0, around.take_up(state)
        behind = sum(
            substep.coefficient for substep in end if isinstance(substep, Drift)
        )  # of the drifts in an open end, in time steps
        while step <= n_steps:
            substeps = end if step == n_steps else start if step == 0 and not goes_on else cycle
            if step == n_steps:
                around.leave_open(state, end, cycle)
            around.phase = -behind if step > 0 or goes_on else 0.0
            for k, substep in enumerate(substeps):
                if (
                    march is not None
                    and repeated is not None
                    and substeps is cycle
                    and k == first_kick
                    and not state.forces_are_current
                ):
                    while not around.stop_requested and (made := march(state, repeated, n_steps - step - (k > 0))) > 0:
                        step += made
                        around.count(made)
                    if step == n_steps:
                        break
                duration, unit = substep.coefficient * self.timestep, units[substep] * self.timestep
                if isinstance(substep, Kick):
                    if not state.has_forces_over(unit):
                        is_last = k == len(substeps) - 1 and step == (n_steps if end else n_steps - 1)
                        compute_forces(state, with_energy and is_last)
                        state.forces_are_current = True
                    state.kick(duration, unit)
                    around.work += duration * around.power
                elif isinstance(substep, Thermalize):
                    self.thermalize(state, duration, around)
                    state.settle()
                else:
                    around.drift(state, duration, unit)
                    around.phase += substep.coefficient
                    state.forces_are_current = False
            else:
                if step < n_steps:
                    around.count(1)
                step += 1
                if around.stop_requested:
                    n_steps = min(n_steps, step)
        around.project(state)
        return n_steps

    def thermalize(self, state: State, duration: float, around: Surroundings) -> None:
        """Contact with the bath over a duration: what a substep Thermalize does.

        Methods without a bath have no such substep.
        """
        raise NotImplementedError(f"{self.name} has no thermostat")

    def _grouped(self, may_merge_drifts: bool) -> tuple[Substeps, Substeps, Substeps]:
        """Substeps of the first step of a block, of every other step, and after the last one:
        half a kick or drift if the two ends are of one kind.

        Two contacts with a bath are not merged, nor are two constrained drifts.
        """
        first, last = self.substeps[0], self.substeps[-1]
        may_merge = isinstance(first, Kick) or (may_merge_drifts and isinstance(first, Drift))
        if len(self.substeps) == 1 or type(first) is not type(last) or not may_merge:
            return self.opening + self.substeps, self.substeps, self.closing
        body, both = self.substeps[1:-1], type(first)(first.coefficient + last.coefficient)
        return (*self.opening, first, *body), (both, *body), (last, *self.closing)

    @classmethod
    def units(cls, substeps: Iterable[Substep]) -> dict[Substep, float]:
        """For each substep its unit: a coefficient of which its own is a whole multiple.

        On a grid, the change over one unit is rounded.

        The unit is the coefficient of the first or last substep of a step where the substep is a whole multiple of it:
        two merged half kicks then give the same bits as two half kicks.
        """
        sequence = cls.sequence()
        ends = {type(end): end.coefficient for end in (sequence[-1], sequence[0])}

        def unit(substep: Substep) -> float:
            end = ends.get(type(substep), substep.coefficient)
            return end if substep.coefficient % end == 0.0 else substep.coefficient

        return {substep: unit(substep) for substep in substeps}

    def repeated(self, cycle: Substeps, around: Surroundings) -> Cycle | None:
        """A cycle that begins with a kick, for a March; None unless kicks and drifts alternate."""
        if [type(substep) for substep in cycle] != [Kick, Drift] * (len(cycle) // 2):
            return None
        units = self.units(cycle)
        return Cycle(
            self.timestep * np.array([(substep.coefficient, units[substep]) for substep in cycle]).reshape(-1, 2, 2)
        )
