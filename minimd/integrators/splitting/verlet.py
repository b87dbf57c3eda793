"""Symplectic Euler and the one-step forms of Störmer-Verlet: one sequence of substeps each, with timestep : Δt [time].

    (A) = SE2 ∘ SE1 over Δt/2 each = velocity Verlet        (B) = SE1 ∘ SE2 over Δt/2 each = position Verlet

E. Hairer, C. Lubich, G. Wanner, Acta Numerica 12, 399 (2003).
"""

from minimd.integrators.splitting.splitting import Splitting
from minimd.integrators.splitting.substeps import Drift, Kick

__all__ = ["SE1", "SE2", "Leapfrog", "PositionVerlet", "VelocityVerlet"]


class VelocityVerlet(Splitting):
    """Velocity Verlet, Störmer-Verlet (A): order 2, symplectic, time-reversible, one force evaluation per step.

    v(t+Δt/2) = v(t) + Δt/2 F(t)/m              kick
    r(t+Δt)   = r(t) + Δt v(t+Δt/2)             drift
    F(t+Δt)   = −∇U(r(t+Δt))
    v(t+Δt)   = v(t+Δt/2) + Δt/2 F(t+Δt)/m      kick
    """

    name = "velocity-verlet"
    substeps = (Kick(0.5), Drift(1.0), Kick(0.5))
    source = "W. C. Swope et al., J. Chem. Phys. 76, 637 (1982), eq. 16-17"


class PositionVerlet(Splitting):
    """Position Verlet, Störmer-Verlet (B): the same two flows with the drifts outside.

    r(t+Δt/2) = r(t) + Δt/2 v(t)                drift
    v(t+Δt)   = v(t) + Δt F(t+Δt/2)/m           kick
    r(t+Δt)   = r(t+Δt/2) + Δt/2 v(t+Δt)        drift
    """

    name = "position-verlet"
    substeps = (Drift(0.5), Kick(1.0), Drift(0.5))
    source = "M. Tuckerman, B. J. Berne, G. J. Martyna, J. Chem. Phys. 97, 1990 (1992), eq. 2.22"


class Leapfrog(Splitting):
    """Leapfrog: velocities at half steps.

        v(t+Δt/2) = v(t−Δt/2) + Δt F(t)/m           kick
        r(t+Δt)   = r(t) + Δt v(t+Δt/2)             drift

    The kick is made as two halves, so that velocities, energies and files show v(t) together with r(t), at any step:
    to the last bit this is velocity Verlet.
    """

    name = "leapfrog"
    substeps = (Kick(0.5), Drift(1.0), Kick(0.5))
    source = "R. W. Hockney, J. W. Eastwood, Computer Simulation Using Particles (1981), 4-3-1"


class SE1(Splitting):
    """Symplectic Euler, kick first: order 1, not symmetric; its adjoint is SE2.

    v(t+Δt) = v(t) + Δt F(t)/m                  kick
    r(t+Δt) = r(t) + Δt v(t+Δt)                 drift
    """

    name = "symplectic-euler-1"
    substeps = (Kick(1.0), Drift(1.0))
    source = "E. Hairer, C. Lubich, G. Wanner, Geometric Numerical Integration (2006), VI.3"


class SE2(Splitting):
    """Symplectic Euler, drift first: order 1, not symmetric; its adjoint is SE1.

    r(t+Δt) = r(t) + Δt v(t)                    drift
    v(t+Δt) = v(t) + Δt F(t+Δt)/m               kick
    """

    name = "symplectic-euler-2"
    substeps = (Drift(1.0), Kick(1.0))
    source = "E. Hairer, C. Lubich, G. Wanner, Geometric Numerical Integration (2006), VI.3"
