"""What an engine checks about its parts: method, constraints, and a center of mass that must not move."""

from collections.abc import Sequence
from typing import Any

from minimd.core.console.quiet import warn
from minimd.core.integrators.splitting import Splitting
from minimd.core.structure.checks import checked_kind
from minimd.core.structure.constraints import Constraint
from minimd.core.structure.system import AnySystem, System


def checked_method(method: Splitting) -> Any:
    """The method.
    Raises TypeError for anything but a splitting with its time step."""
    needed = "an integrator with its time step, such as VelocityVerlet(0.005)"
    return checked_kind("method", method, Splitting, needed)


def warn_of_dropped(
    of_system: Sequence[Constraint], constraints: Constraint | Sequence[Constraint] | None
) -> None:
    """Warn if the given constraints replace those of the system and one kind of the latter is missing."""
    if constraints is None:
        return
    kinds = set(map(type, constraints if isinstance(constraints, Sequence) else [constraints]))
    lost = ", ".join(repr(constraint) for constraint in of_system if type(constraint) not in kinds)
    if kinds and lost:
        warn(f"the constraints given replace those of the system, and {lost} is lost")


def holds_center(system: AnySystem) -> bool:
    """Whether the system is an ase.Atoms with FixCom; a System never has it."""
    if isinstance(system, System):
        return False
    from minimd.core.structure.ase_atoms import fixes_center  # loads ase

    return fixes_center(system)


def check_center(is_held: bool, stays: bool, method: Splitting) -> None:
    """Raise ValueError for atoms with FixCom whose center of mass would move."""
    if stays or not is_held:
        return
    cause = "a force from outside or a fixed atom moves the center of mass: remove FixCom, or what moves it"
    if not method.conserves_momentum:
        cause = (
            f"{method.name} moves the center of mass: "
            "take StochasticVelocityRescaling or minimd.ase.Langevin, or remove FixCom"
        )
    raise ValueError(f"atoms.constraints holds FixCom, but {cause}")
