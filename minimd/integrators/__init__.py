"""Kicks, drifts and the methods composed from them."""

from minimd.constraints.solver import ConstraintSolver
from minimd.integrators.dae.hessenberg import Hessenberg1, Hessenberg2, Hessenberg3
from minimd.integrators.dae.implicit import Implicit
from minimd.integrators.dae.mechanical import Mechanical
from minimd.integrators.dae.pencil import pencil_index
from minimd.integrators.manifold.holonomic import Holonomic
from minimd.integrators.manifold.invariants import Invariants, stabilized
from minimd.integrators.manifold.projection import index_two, projected, symmetrically_projected, with_multipliers
from minimd.integrators.method import Method
from minimd.integrators.methods import METHODS, SPLITTINGS, THERMOSTATS
from minimd.integrators.ode.adaptive import StepControl, run_adaptive
from minimd.integrators.ode.bdf import BDF1, BDF2, BDF3, BDF4, BDF5
from minimd.integrators.ode.drivers import run_steps, run_until
from minimd.integrators.ode.newton import FixedPoint, Newton
from minimd.integrators.ode.problems import FirstOrder, Partitioned, SecondOrder
from minimd.integrators.ode.reversible import DensityControl, run_reversible
from minimd.integrators.ode.runge_kutta import (
    GaussLegendre1,
    GaussLegendre2,
    GaussLegendre3,
    GaussLegendre4,
    ImplicitEuler,
    RadauIIA2,
    RadauIIA3,
    RungeKutta,
)
from minimd.integrators.ode.solution import Solution
from minimd.integrators.ode.stormer import stormer_summed, stormer_two_step
from minimd.integrators.ode.tableau import Tableau, collocation, gauss, radau_iia
from minimd.integrators.splitting.composing import adjoint, compose
from minimd.integrators.splitting.compositions import (
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
from minimd.integrators.splitting.linear_stability import accurate_step, energy_oscillation, stability_limit
from minimd.integrators.splitting.order_conditions import nystrom_order, separable_order
from minimd.integrators.splitting.splitting import Splitting
from minimd.integrators.splitting.state import Bath, State, Surroundings
from minimd.integrators.splitting.substeps import Drift, Kick
from minimd.integrators.splitting.thermostats import LangevinBAOAB, StochasticVelocityRescaling
from minimd.integrators.splitting.verlet import SE1, SE2, Leapfrog, PositionVerlet, VelocityVerlet
from minimd.structure.constraints import DistanceConstraints

__all__ = [
    "BDF1",
    "BDF2",
    "BDF3",
    "BDF4",
    "BDF5",
    "METHODS",
    "PEFRL",
    "SE1",
    "SE2",
    "SPLITTINGS",
    "THERMOSTATS",
    "Bath",
    "BlanesMoan4",
    "CandyRozmus4",
    "ConstraintSolver",
    "DensityControl",
    "DistanceConstraints",
    "Drift",
    "FirstOrder",
    "FixedPoint",
    "GaussLegendre1",
    "GaussLegendre2",
    "GaussLegendre3",
    "GaussLegendre4",
    "Hessenberg1",
    "Hessenberg2",
    "Hessenberg3",
    "Holonomic",
    "Implicit",
    "ImplicitEuler",
    "Invariants",
    "KahanLi6",
    "KahanLi8",
    "Kick",
    "LangevinBAOAB",
    "Leapfrog",
    "McLachlanAtela4",
    "Mechanical",
    "Method",
    "Newton",
    "Partitioned",
    "PositionVerlet",
    "RadauIIA2",
    "RadauIIA3",
    "RungeKutta",
    "Ruth3",
    "SecondOrder",
    "Solution",
    "Splitting",
    "State",
    "StepControl",
    "StochasticVelocityRescaling",
    "Surroundings",
    "Suzuki4",
    "Tableau",
    "VelocityVerlet",
    "Yoshida6",
    "accurate_step",
    "adjoint",
    "collocation",
    "compose",
    "energy_oscillation",
    "gauss",
    "index_two",
    "nystrom_order",
    "pencil_index",
    "projected",
    "radau_iia",
    "run_adaptive",
    "run_reversible",
    "run_steps",
    "run_until",
    "separable_order",
    "stability_limit",
    "stabilized",
    "stormer_summed",
    "stormer_two_step",
    "symmetrically_projected",
    "with_multipliers",
]
