"""The bridge to MDAnalysis: files of minimd as universes, structure and diffusion from them."""

from minimd.mdanalysis.universes import (
    Diffusion,
    RadialDistribution,
    RunUniverse,
    diffusion_coefficient,
    mean_square_displacement,
    radial_distribution,
    universe,
)

__all__ = ["Diffusion", "RadialDistribution", "RunUniverse", "diffusion_coefficient", "mean_square_displacement", "radial_distribution", "universe"]
