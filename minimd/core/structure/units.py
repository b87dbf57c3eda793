"""Unit systems. The core computes in any consistent units; all conversion factors of minimd are in this file.

ASE's units: length Å, energy eV, mass u, hence time Å √(u/eV). Constants are those of ase.units (CODATA 2014), so that
a number given to ASE and taken back is the same number; a test compares the two.
"""

import math
from dataclasses import dataclass, replace
from typing import Any

BOLTZMANN_EV_PER_K = 8.617330337217213e-05
FEMTOSECOND = 0.09822694788464063  # Å √(u/eV)
PICOSECOND = 1000.0 * FEMTOSECOND
KJ_PER_MOL_PER_EV = 96.48533288249877
GRAM_PER_CM3 = 0.6022140858549161  # u/Å³
MOL_PER_L = 1e-3 * GRAM_PER_CM3  # 1/Å³
BAR = 6.241509125883258e-07  # eV/Å³
GPA = 1e4 * BAR  # eV/Å³
MN_PER_M = 100.0 * BAR  # eV/Å², of surface tensions: a bar times an Å is 0.01 mN/m
CM2_PER_S = 1e4 / PICOSECOND  # Å²/(Å √(u/eV)), of coefficients of diffusion
MPA_S = 1e4 * BAR * PICOSECOND  # eV/Å³ · Å √(u/eV): a bar times a picosecond is 1e-4 mPa s
# e²/(eV Å) per Å √(u/eV), of conductivities: 1 S/m is 1 J/(V² s m)
S_PER_M = 1e3 * BAR / PICOSECOND
W_PER_M_K = S_PER_M  # eV/(K Å) per Å √(u/eV): 1 W/(m K) is 1 J/(K s m)
COULOMB = 14.399645351950548  # eV Å/e²
DEGREE = math.pi / 180.0  # rad


@dataclass(frozen=True)
class UnitSystem:
    """A consistent set of units, and the factors that convert its numbers to Å, ps and kJ/mol; default: reduced units.
    name : "ASE" or "LJ".
    k_B : Boltzmann constant [energy/temperature].
    coulomb : k_e = 1/(4π ε₀) [energy · length/e²].
    to_angstrom, to_picosecond, to_kj_per_mol : factors for files that must have these units. Reduced numbers are
        written unchanged (1 σ as 1 Å, 1 τ as 1 ps, 1 ε as 1 kJ/mol), as most tools do.
    shown_time : name of the unit of time · to_picosecond, as it is shown.
    small_time : the same for time steps, of which shown_small_time make one.
    shown_pressure, to_shown_pressure : the unit in which pressures are shown, and the factor that converts to it.
    length, volume, time, energy, temperature, pressure, momentum, angular_momentum : names of the units, for files,
        plots and reports."""

    name: str = "LJ"
    k_B: float = 1.0
    coulomb: float = 1.0
    to_angstrom: float = 1.0
    to_picosecond: float = 1.0
    to_kj_per_mol: float = 1.0
    length: str = "σ"
    time: str = "τ"
    shown_time: str = "τ"
    small_time: str = "τ"
    shown_small_time: float = 1.0
    energy: str = "ε"
    temperature: str = "ε/k_B"
    pressure: str = "ε/σ³"
    shown_pressure: str = "ε/σ³"
    to_shown_pressure: float = 1.0
    momentum: str = "√(m ε)"
    angular_momentum: str = "σ √(m ε)"
    volume: str = "σ³"

    @property
    def is_reduced(self) -> bool:
        """Whether they are those of a law, σ, ε and m."""
        return self.name == LJ.name

    @property
    def in_plane(self) -> "UnitSystem":
        """These units in two dimensions, with an area for a volume and a force per length for a pressure."""
        area = f"{self.length}²"
        pressure = f"{self.energy}/{area}"
        return replace(
            self, volume=area, pressure=pressure, shown_pressure=pressure, to_shown_pressure=1.0
        )

    def __repr__(self) -> str:
        known = SYSTEMS.get(self.name)
        if known is not None and self in (known, known.in_plane):
            return f"minimd.units.{self.name}{'' if self == known else '.in_plane'}"
        return f"UnitSystem({', '.join(f'{name}={value!r}' for name, value in vars(self).items())})"

    def __reduce__(self) -> tuple[Any, ...]:
        """For pickle and copy: ASE and LJ stay the same objects."""
        is_known = SYSTEMS.get(self.name) == self
        return (_system, (self.name,)) if is_known else (UnitSystem, tuple(vars(self).values()))

    def shown(self, time: float) -> str:
        """A time as text: with 4 digits below 1000 of the small unit, else with 6 digits in the large one; "2.5 fs",
        "12.5 ps", "0.004 τ"."""
        large = time * self.to_picosecond
        small = large * self.shown_small_time
        if abs(small) < 1000.0:
            return f"{small:.4g} {self.small_time}"
        return f"{large:.6g} {self.shown_time}"


LJ = UnitSystem()
ASE = UnitSystem(
    name="ASE",
    k_B=BOLTZMANN_EV_PER_K,
    coulomb=COULOMB,
    to_angstrom=1.0,
    to_picosecond=1.0 / PICOSECOND,
    to_kj_per_mol=KJ_PER_MOL_PER_EV,
    length="Å",
    time="Å √(u/eV)",
    shown_time="ps",
    small_time="fs",
    shown_small_time=1000.0,
    energy="eV",
    temperature="K",
    pressure="eV/Å³",
    shown_pressure="bar",
    to_shown_pressure=1.0 / BAR,
    momentum="√(u eV)",
    angular_momentum="Å √(u eV)",
    volume="Å³",
)

fs = FEMTOSECOND
ps = PICOSECOND
SYSTEMS = {"ASE": ASE, "LJ": LJ}


def _system(name: str) -> UnitSystem:
    return SYSTEMS[name]


def __dir__() -> list[str]:
    """The public names, without what this module imports."""
    others = ("UnitSystem", "fs", "ps")
    return [name for name in globals() if name.isupper() or name in others or name[:2] == "__"]
