"""Analysis during a run: observers that keep sums instead of frames, and give results with error bars; and a stream
of frames to other programs."""

from minimd.observers.accumulator import Accumulator, Result, joined
from minimd.observers.bond_order import BondOrder
from minimd.observers.chain_shape import ChainShape
from minimd.observers.conductivity import Conductivity
from minimd.observers.dielectric_constant import DielectricConstant
from minimd.observers.fluctuations import Fluctuations
from minimd.observers.motion import (
    MeanSquareDisplacement,
    VelocityAutocorrelation,
    finite_size_correction,
)
from minimd.observers.pressure_profile import PressureProfile
from minimd.observers.profile import Profile
from minimd.observers.radial_distribution import RadialDistribution
from minimd.observers.scattering import SelfScattering, StructureFactor
from minimd.observers.stream import Stream
from minimd.observers.surface_tension import SurfaceTension
from minimd.observers.thermal_conductivity import ThermalConductivity
from minimd.observers.viscosity import Viscosity

KINDS: dict[str, type[Accumulator]] = {
    observer.kind: observer
    for observer in (
        RadialDistribution,
        StructureFactor,
        Profile,
        MeanSquareDisplacement,
        VelocityAutocorrelation,
        SelfScattering,
        Viscosity,
        Conductivity,
        ThermalConductivity,
        Fluctuations,
        ChainShape,
        SurfaceTension,
        PressureProfile,
        DielectricConstant,
        BondOrder,
    )
}
__all__ = [
    "KINDS",
    "Accumulator",
    "BondOrder",
    "ChainShape",
    "Conductivity",
    "DielectricConstant",
    "Fluctuations",
    "MeanSquareDisplacement",
    "PressureProfile",
    "Profile",
    "RadialDistribution",
    "Result",
    "SelfScattering",
    "Stream",
    "StructureFactor",
    "SurfaceTension",
    "ThermalConductivity",
    "VelocityAutocorrelation",
    "Viscosity",
    "finite_size_correction",
    "joined",
]
