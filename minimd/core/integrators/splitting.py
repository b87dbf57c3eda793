"""Splitting methods: the flows of the two halves of H = T(p) + V(q), composed as a sequence of substeps.

    drift  φ[1]:  r(t+cΔt) = r(t) + cΔt v            velocities are constant
    kick   φ[2]:  v(t+cΔt) = v(t) + cΔt F(r)/m       positions are constant

Each half is solved exactly, so every composition is symplectic and conserves total momentum. It is reversible if the
sequence equals its reverse. E. Hairer, C. Lubich, G. Wanner, Geometric Numerical Integration (2006), II.5.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from functools import partial
from typing import TYPE_CHECKING, ClassVar

from minimd.core.integrators.method import ClassProperty, Method, Problem, Step
from minimd.core.integrators.order_conditions import nystrom_order
from minimd.core.integrators.substeps import (
    Kick,
    Substeps,
    is_palindrome,
    mechanical,
    merged,
    outer_substeps,
)
from minimd.core.structure.arrays import Array

if TYPE_CHECKING:
    from minimd.core.compiled.program import Operation
    from minimd.core.integrators.state import State, Surroundings
    from minimd.core.integrators.steps import Moment

__all__ = ["Splitting"]


def stages(method: type[Splitting]) -> int:
    """Force evaluations per step of a long run: groups of kicks with no drift between them;
    the last and the first kick form one group."""
    row = outer_substeps(mechanical(method.substeps))
    kicks = [isinstance(substep, Kick) for substep in row]
    return sum(kicks) - (len(kicks) > 1 and kicks[0] and kicks[-1])


class Splitting(Method):
    """A splitting method, given by its sequence of substeps.

    Forces are computed when a kick needs them and positions have moved since. With constraints every drift is
    projected, and at the end of each step velocities are. So a state between two steps is all that the next step needs:
    n steps and then m have the same bits as n + m. Where kicks and drifts follow each other, also those of two steps,
    they are made in one pass over memory, each with its own rounding: velocity Verlet costs what leapfrog costs.

    A memory is undone with a step that is undone, and stored with each restart. Give each simulation a method of its
    own.

    Parameters, Raises : as Method.

    Attributes of each method
    -------------------------
    name, substeps, source : key in METHODS; kicks and drifts of one step; literature.
    conserves_momentum : true unless a bath acts on each atom separately.
    is_thermostat : whether a bath acts at all.
    is_overdamped : whether motion has no inertia.
    is_dynamics : whether steps follow each other in time; not of Monte Carlo.
    drifts : in how many parts drifts along rigid bonds are made.
    memory : (M,) float64, what a bath of yours remembers, such as ξ of Nosé and Hoover, changed in place; or None.

    Attributes computed from them
    -----------------------------
    sequence : a function without arguments: one step, neighbors of one kind merged.
    order : p of the global error O(Δtᵖ) for H = p²/2m + V(q).
    stages : force evaluations per step of a long run.
    is_symmetric : whether Φ_Δt ∘ Φ_{−Δt} = 1; the method is then also reversible.
    is_symplectic : true without a bath.
    """

    substeps: ClassVar[Substeps]
    is_symplectic: ClassVar[bool] = True
    is_explicit: ClassVar[bool] = True
    conserves_momentum: ClassVar[bool] = True
    is_thermostat: ClassVar[bool] = False
    is_overdamped: ClassVar[bool] = False
    is_dynamics: ClassVar[bool] = True
    memory: Array | None = None
    drifts: int = 1
    sequence = ClassProperty(lambda method: partial(merged, method.substeps))
    order = ClassProperty(lambda method: nystrom_order(method.sequence()))
    is_symmetric = ClassProperty(lambda method: is_palindrome(method.sequence()))
    stages = ClassProperty(stages)

    @property
    def stride(self) -> float:
        """The time over which the substeps of a step act [time]: the time step, except in overdamped dynamics."""
        return self.timestep

    @property
    def duration(self) -> float:
        """The time that a step of a simulation takes [time]: the time step, except in Monte Carlo."""
        return self.timestep

    def adapt(self) -> None:
        """Called again and again in an equilibration, where a method may adapt itself; here it does nothing."""

    def timestep_of(self, stride: float) -> float:
        """The time step with a stride [time]."""
        return stride

    @classmethod
    def on(cls, problem: Problem) -> Step:
        """The step on a problem with q and v, see Partitioned.sequence_step.
        Raises TypeError for other problems."""
        if not hasattr(problem, "sequence_step"):
            raise TypeError(
                f"{cls.name} needs a problem with q and v, SecondOrder or Partitioned; got {type(problem).__name__}"
            )
        return problem.sequence_step(cls.sequence())

    @classmethod
    def order_on(cls, problem: Problem) -> int:
        """See Method."""
        if hasattr(problem, "sequence_order"):
            return problem.sequence_order(cls.sequence())
        return cls.order

    def advance(
        self,
        state: State,
        compute_forces: Callable[[State, bool], None],
        n_steps: int,
        with_energy: bool = True,
        surroundings: Surroundings | None = None,
    ) -> int:
        """Make n_steps steps, or fewer (at least one) if surroundings.stop_requested becomes true;
        return how many were made.

        compute_forces : fills state.forces; if called with True, evaluates the energy, too.
        with_energy : evaluate the energy, too, with the last forces.
        surroundings : constraints and bath, if any.

        Raises
        ------
        ConstraintError : if a constrained length cannot be kept.
        ValueError : from a thermostat without a bath.
        """

        # Numba is slow to load, and who names a method needs none
        from minimd.core.integrators import python_steps

        return python_steps.advance(self, state, compute_forces, n_steps, with_energy, surroundings)

    def contact(
        self, state: State, duration: float, around: Surroundings, moment: Moment
    ) -> Iterable[Operation]:
        """Contact with the bath over a duration, at a moment: the operations of a substep Thermalize."""

        from minimd.core.integrators import python_steps

        return python_steps.contact(self, state, duration, around, moment)

    def thermalize(self, state: State, duration: float, around: Surroundings) -> None:
        """The same, made once, by Python: velocities are changed in place. They are projected onto constraints before
        and after, and what a thermostat gives to the kinetic energy is counted as heat."""
        raise NotImplementedError(f"{self.name} has no thermostat")
