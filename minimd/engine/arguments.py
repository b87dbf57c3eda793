"""Checks of the arguments of an engine."""

import warnings
from collections.abc import Sequence

from minimd.integrators.splitting.splitting import Splitting
from minimd.structure.checks import shown
from minimd.structure.console import outside_minimd
from minimd.structure.constraints import Constraint


def checked_method(method: Splitting) -> Splitting:
    """The method.  Raises TypeError for anything but a splitting with its time step."""
    if not isinstance(method, Splitting):
        raise TypeError(
            f"method must be an integrator with its time step, such as VelocityVerlet(0.005); got {shown(method)}"
        )
    return method


def warn_of_dropped(those_of_system: Sequence[Constraint], given: Constraint | Sequence[Constraint] | None) -> None:
    """Warn if the given constraints replace those of the system and one kind of the latter is missing."""
    if given is None:
        return
    kinds = {type(one) for one in (given if isinstance(given, Sequence) else [given])}
    dropped = [repr(one) for one in those_of_system if type(one) not in kinds]
    if kinds and dropped:
        warnings.warn(
            f"the constraints given replace those of the system, and {', '.join(dropped)} is lost",
            stacklevel=outside_minimd(),
        )
