"""The bridge to ASE: atoms in and out, calculators both ways, ASE's molecular dynamics with compiled steps,
ASE's trajectory files.

ASE's units are Å, eV, u and Å √(u/eV); minimd.units.ASE are the same, so nothing is converted here. A scene in reduced
units crosses with its numbers unchanged. Only this package imports ase.
"""

from typing import TYPE_CHECKING, NoReturn

from ase.calculators.calculator import external_calculators

from minimd.ase.calculator import Calculator
from minimd.ase.dynamics import VelocityVerlet
from minimd.ase.thermostats import (
    Andersen,
    Bussi,
    Langevin,
    LangevinBAOAB,
    NoseHooverChainNVT,
    NVTBerendsen,
)
from minimd.core.files.ase_writer import ASEWriter
from minimd.core.files.structure_file import system_from_file
from minimd.core.potentials.term import ForcesFromCalculator
from minimd.core.structure.ase_atoms import atoms_from_system
from minimd.core.structure.elements import atomic_mass
from minimd.core.structure.system import System

system_from_atoms = System.from_ase
DYNAMICS = (
    VelocityVerlet,
    Langevin,
    LangevinBAOAB,
    Bussi,
    NoseHooverChainNVT,
    Andersen,
    NVTBerendsen,
)
# what ase.calculators.calculator.get_calculator_class("minimd") returns
external_calculators.setdefault("minimd", Calculator)

__all__ = [
    "ASEWriter",
    "Andersen",
    "Bussi",
    "Calculator",
    "ForcesFromCalculator",
    "Langevin",
    "LangevinBAOAB",
    "NVTBerendsen",
    "NoseHooverChainNVT",
    "VelocityVerlet",
    "atomic_mass",
    "atoms_from_system",
    "system_from_atoms",
    "system_from_file",
]

if not TYPE_CHECKING:  # for a type checker the module would have any name

    def __getattr__(name: str) -> NoReturn:
        """Raise ImportError for a class, such as a dynamics of ASE that is not here; AttributeError for the rest."""
        if name[:1].isupper():
            raise ImportError(
                f"minimd.ase has the dynamics {', '.join(each.__name__ for each in DYNAMICS)}, but no {name}; a class "
                "of ASE works with minimd.ase.Calculator, at ASE's speed: see docs/ase.md"
            )
        raise AttributeError(f"module 'minimd.ase' has no attribute {name!r}")
