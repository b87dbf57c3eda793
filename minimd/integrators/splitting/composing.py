"""Methods made from other methods: compositions and adjoints."""

from collections.abc import Sequence
from itertools import chain

from minimd.integrators.splitting.splitting import Splitting
from minimd.integrators.splitting.substeps import Drift, Kick, Substep, Substeps, merged, mirrored, scaled

__all__ = ["adjoint", "compose"]

Part = Substep | type[Splitting]


def compose(*parts: Part, weights: Sequence[float] | None = None) -> type[Splitting]:
    """The method Φ¹ ∘ Φ² ∘ … ∘ Φˢ: the last one acts first, as in the formula.

    So compose(SE2, SE1) is Störmer-Verlet (A), compose(SE1, SE2) is (B), compose(Drift(1.0), Kick(1.0)) is SE1, and
    compose(*3 * [VelocityVerlet], weights=[g, 1 - 2 * g, g]) with g = 1/(2 − ∛2) has order 4.

    Parameters
    ----------
    parts : methods, or flows Kick(c) and Drift(c).
    weights : fraction of the time step for each part. If not given, methods get equal fractions, and flows last cΔt.

    Raises
    ------
    TypeError : for parts of another kind or with a bath, or methods mixed with flows without weights.
    ValueError : if there are no parts, or not as many weights as parts.
    """
    for part in parts:
        if not isinstance(part, (Kick, Drift)) and not (isinstance(part, type) and issubclass(part, Splitting)):
            raise TypeError(f"parts must be methods, such as VelocityVerlet, or flows, such as Kick(0.5); got {part!r}")
        _refuse_bath(part)
    if weights is None:
        weights = _equal_weights(parts)
    if len(weights) != len(parts) or not parts:
        raise ValueError(f"there must be at least one part, and as many weights; got {len(parts)} parts, {len(weights)} weights")
    sequences = [scaled(part.sequence() if isinstance(part, type) else (part,), weight) for part, weight in zip(parts, weights, strict=True)]
    title = " ∘ ".join(part.name if isinstance(part, type) else repr(part) for part in parts)
    return _method(f"compose({title})", merged(chain.from_iterable(reversed(sequences))), f"composition of its parts, {title}")


def adjoint(method: type[Splitting]) -> type[Splitting]:
    """The adjoint Φ*_Δt = (Φ_{−Δt})⁻¹: the substeps in reverse. With the opposite time step it undoes a step of the method.

    Raises
    ------
    TypeError : for a method with a bath, which cannot be undone.
    """
    _refuse_bath(method)
    return _method(f"adjoint({method.name})", mirrored(method.sequence()), f"adjoint of {method.name}: {method.source}")


def _refuse_bath(part: Part) -> None:
    if isinstance(part, type) and part.is_thermostat:
        raise TypeError(f"{part.name} has a bath: its steps have no inverse and no parts that last for a fraction of them")


def _equal_weights(parts: Sequence[Part]) -> list[float]:
    n_methods = sum(isinstance(part, type) for part in parts)
    if 0 < n_methods < len(parts):
        raise TypeError("methods and flows are composed with weights only: the fraction of the time step for each part")
    return [1.0 / n_methods if n_methods else 1.0] * len(parts)


def _method(name: str, substeps: Substeps, source: str) -> type[Splitting]:
    return type("Composition", (Splitting,), {"name": name, "substeps": substeps, "source": source, "__doc__": f"{name}."})
