"""Public names: the methods for atoms, and those of the textbook."""

from minimd.core.integrators.barostats import StochasticCellRescaling as StochasticCellRescaling
from minimd.core.integrators.hybrid_monte_carlo import HybridMonteCarlo as HybridMonteCarlo
from minimd.core.integrators.method import Method as Method
from minimd.core.integrators.order_conditions import (
    accurate_step as accurate_step,
    energy_oscillation as energy_oscillation,
    nystrom_order as nystrom_order,
    separable_order as separable_order,
    stability_limit as stability_limit,
)
from minimd.core.integrators.ramp import Ramp as Ramp
from minimd.core.integrators.respa import RESPA as RESPA, LangevinRESPA as LangevinRESPA
from minimd.core.integrators.rows import (
    PEFRL as PEFRL,
    SE1 as SE1,
    SE2 as SE2,
    BlanesMoan4 as BlanesMoan4,
    CandyRozmus4 as CandyRozmus4,
    KahanLi6 as KahanLi6,
    KahanLi8 as KahanLi8,
    Leapfrog as Leapfrog,
    McLachlanAtela4 as McLachlanAtela4,
    PositionVerlet as PositionVerlet,
    Ruth3 as Ruth3,
    Suzuki4 as Suzuki4,
    VelocityVerlet as VelocityVerlet,
    Yoshida6 as Yoshida6,
    adjoint as adjoint,
    compose as compose,
)
from minimd.core.integrators.splitting import Splitting as Splitting
from minimd.core.integrators.state import Bath as Bath, State as State, Surroundings as Surroundings
from minimd.core.integrators.substeps import Drift as Drift, Kick as Kick
from minimd.core.integrators.table import SPLITTINGS as SPLITTINGS, THERMOSTATS as THERMOSTATS
from minimd.core.integrators.thermostats import (
    BrownianDynamics as BrownianDynamics,
    LangevinBAOAB as LangevinBAOAB,
    LangevinGJF as LangevinGJF,
    StochasticVelocityRescaling as StochasticVelocityRescaling,
)
from minimd.textbook.dae.hessenberg import (
    Hessenberg1 as Hessenberg1,
    Hessenberg2 as Hessenberg2,
    Hessenberg3 as Hessenberg3,
    Mechanical as Mechanical,
)
from minimd.textbook.dae.implicit import Implicit as Implicit, pencil_index as pencil_index
from minimd.textbook.manifold.holonomic import Holonomic as Holonomic
from minimd.textbook.manifold.invariants import (
    Invariants as Invariants,
    index_two as index_two,
    projected as projected,
    stabilized as stabilized,
    symmetrically_projected as symmetrically_projected,
    with_multipliers as with_multipliers,
)
from minimd.textbook.methods import METHODS as METHODS
from minimd.textbook.ode.bdf import (
    BDF1 as BDF1,
    BDF2 as BDF2,
    BDF3 as BDF3,
    BDF4 as BDF4,
    BDF5 as BDF5,
)
from minimd.textbook.ode.drivers import (
    DensityControl as DensityControl,
    Solution as Solution,
    StepControl as StepControl,
    run_adaptive as run_adaptive,
    run_reversible as run_reversible,
    run_steps as run_steps,
    run_until as run_until,
    stormer_summed as stormer_summed,
    stormer_two_step as stormer_two_step,
)
from minimd.textbook.ode.newton import FixedPoint as FixedPoint, Newton as Newton
from minimd.textbook.ode.problems import (
    FirstOrder as FirstOrder,
    Partitioned as Partitioned,
    SecondOrder as SecondOrder,
)
from minimd.textbook.ode.runge_kutta import (
    GaussLegendre1 as GaussLegendre1,
    GaussLegendre2 as GaussLegendre2,
    GaussLegendre3 as GaussLegendre3,
    GaussLegendre4 as GaussLegendre4,
    ImplicitEuler as ImplicitEuler,
    RadauIIA2 as RadauIIA2,
    RadauIIA3 as RadauIIA3,
    RungeKutta as RungeKutta,
    Tableau as Tableau,
    collocation as collocation,
    gauss as gauss,
    radau_iia as radau_iia,
)
