"""Runs whose center of mass must not move, as FixCom of ASE demands."""

from minimd.integrators.splitting.splitting import Splitting
from minimd.structure.system import AnySystem, System


def holds_center(system: AnySystem) -> bool:
    """Whether the system is an ase.Atoms with FixCom; a System never has it."""
    if isinstance(system, System):
        return False
    from minimd.structure.ase_atoms import fixes_center  # here, because it loads ase

    return fixes_center(system)


def check_center(is_held: bool, stays: bool, method: Splitting) -> None:
    """Raise ValueError for atoms with FixCom whose center of mass would move."""
    if stays or not is_held:
        return
    cause = "a force from outside or a fixed atom moves the center of mass: remove one of them"
    if not method.conserves_momentum:
        cause = (
            f"{method.name} moves the center of mass: take StochasticVelocityRescaling or minimd.ase.Langevin, or "
            "remove FixCom"
        )
    raise ValueError(f"atoms.constraints holds FixCom, but {cause}")
