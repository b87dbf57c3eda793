"""Kicks, drifts and the methods composed from them."""

from minimd.integrators.composing import adjoint, compose
from minimd.integrators.methods import METHODS
from minimd.integrators.orders import nystrom_order, separable_order
from minimd.integrators.rows import Drift, Kick
from minimd.integrators.solution import Solution
from minimd.integrators.splitting import Splitting, State
from minimd.integrators.two_step import stormer_summed, stormer_two_step
from minimd.integrators.verlet import SE1, SE2, Leapfrog, PositionVerlet, VelocityVerlet

__all__ = [
    "METHODS",
    "SE1",
    "SE2",
    "Drift",
    "Kick",
    "Leapfrog",
    "PositionVerlet",
    "Solution",
    "Splitting",
    "State",
    "VelocityVerlet",
    "adjoint",
    "compose",
    "nystrom_order",
    "separable_order",
    "stormer_summed",
    "stormer_two_step",
]
