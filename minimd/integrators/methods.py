"""The table of splitting methods, by name."""

from minimd.integrators.splitting import Splitting
from minimd.integrators.verlet import SE1, SE2, Leapfrog, PositionVerlet, VelocityVerlet

METHODS: dict[str, type[Splitting]] = {method.name: method for method in (VelocityVerlet, PositionVerlet, Leapfrog, SE1, SE2)}
