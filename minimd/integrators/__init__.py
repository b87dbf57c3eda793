"""Kicks, drifts and the methods composed from them."""

from minimd.integrators.bdf import BDF1, BDF2, BDF3, BDF4, BDF5
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
from minimd.integrators.constraints import DistanceConstraints, RigidBonds
from minimd.integrators.drivers import run_steps, run_until
from minimd.integrators.hessenberg import Hessenberg1, Hessenberg2, Hessenberg3
from minimd.integrators.holonomic import Holonomic
from minimd.integrators.implicit import Implicit
from minimd.integrators.invariants import Invariants, stabilized
from minimd.integrators.mechanical import Mechanical
from minimd.integrators.method import Method
from minimd.integrators.methods import METHODS, SPLITTINGS, THERMOSTATS
from minimd.integrators.nonlinear import FixedPoint, Newton
from minimd.integrators.orders import nystrom_order, separable_order
from minimd.integrators.pencil import pencil_index
from minimd.integrators.problems import FirstOrder, Partitioned, SecondOrder
from minimd.integrators.projection import index_two, projected, symmetrically_projected, with_multipliers
from minimd.integrators.reversible import DensityControl, run_reversible
from minimd.integrators.rows import Drift, Kick
from minimd.integrators.runge_kutta import (
    GaussLegendre1,
    GaussLegendre2,
    GaussLegendre3,
    GaussLegendre4,
    ImplicitEuler,
    RadauIIA2,
    RadauIIA3,
    RungeKutta,
)
from minimd.integrators.solution import Solution
from minimd.integrators.splitting import Splitting, State
from minimd.integrators.stability import accurate_step, energy_oscillation, stability_limit
from minimd.integrators.step_doubling import StepControl, run_adaptive
from minimd.integrators.tableau import Tableau, collocation, gauss, radau_iia
from minimd.integrators.thermostats import LangevinBAOAB, StochasticVelocityRescaling
from minimd.integrators.two_step import stormer_summed, stormer_two_step
from minimd.integrators.verlet import SE1, SE2, Leapfrog, PositionVerlet, VelocityVerlet

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
    "BlanesMoan4",
    "CandyRozmus4",
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
    "RigidBonds",
    "RungeKutta",
    "Ruth3",
    "SecondOrder",
    "Solution",
    "Splitting",
    "State",
    "StepControl",
    "StochasticVelocityRescaling",
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
