"""The bridge to MDAnalysis: files of minimd as universes, structure and diffusion from them."""

from minimd.mdanalysis.universes import *  # noqa: F403
from minimd.mdanalysis.universes import __all__ as __all__
