"""Kicks, drifts and the methods composed from them."""

from minimd.integrators.methods import METHODS, Leapfrog, PositionVerlet, VelocityVerlet
from minimd.integrators.splitting import Drift, Kick, Splitting, State

__all__ = ["METHODS", "Drift", "Kick", "Leapfrog", "PositionVerlet", "Splitting", "State", "VelocityVerlet"]
