"""The parts of minimd that ASE finds by itself: the format of its files, and its calculator.

This file is beside the package, because ASE loads it with ase.io, and Python would load the whole package, with Numba,
before its modules.
"""

from typing import Any

from ase.utils.plugins import ExternalIOFormat

h5md = ExternalIOFormat(
    "trajectory of minimd, H5MD", "+S", module="minimd.ase.h5md_format", ext="h5md"
)  # entry point of group ase.ioformats


def __getattr__(name: str) -> Any:
    """The plugins of `ase info --plugins`, group ase.plugins, which nothing else of ASE looks for."""
    if name != "__ase_plugins__":
        raise AttributeError(f"module 'minimd_plugin' has no attribute {name!r}")
    from ase._4.plugins.plugin import CalculatorPlugin

    import minimd

    citation = "minimd, a molecular-dynamics mini-engine"
    return {
        CalculatorPlugin("minimd", citation=citation, module=minimd, implementation="minimd.ase.calculator.Calculator")
    }
