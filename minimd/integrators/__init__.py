"""Kicks, drifts and the methods composed from them."""

from minimd.integrators.composing import adjoint, compose
from minimd.integrators.compositions import (
    PEFRL,
    BlanesMoan4,
    CandyRozmus4,
    KahanLi6,
    KahanLi8,
    McLachlanAtela4,
    Ruth3,
    Suzuki4,
    Yoshida6,
)
from minimd.integrators.methods import METHODS, SPLITTINGS
from minimd.integrators.orders import nystrom_order, separable_order
from minimd.integrators.rows import Drift, Kick
from minimd.integrators.solution import Solution
from minimd.integrators.splitting import Splitting, State
from minimd.integrators.two_step import stormer_summed, stormer_two_step
from minimd.integrators.verlet import SE1, SE2, Leapfrog, PositionVerlet, VelocityVerlet

__all__ = [
    "METHODS",
    "PEFRL",
    "SE1",
    "SE2",
    "SPLITTINGS",
    "BlanesMoan4",
    "CandyRozmus4",
    "Drift",
    "KahanLi6",
    "KahanLi8",
    "Kick",
    "Leapfrog",
    "McLachlanAtela4",
    "PositionVerlet",
    "Ruth3",
    "Solution",
    "Splitting",
    "State",
    "Suzuki4",
    "VelocityVerlet",
    "Yoshida6",
    "adjoint",
    "compose",
    "nystrom_order",
    "separable_order",
    "stormer_summed",
    "stormer_two_step",
]
