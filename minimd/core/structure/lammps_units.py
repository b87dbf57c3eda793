"""LAMMPS' names of units, and how its files state them."""

import re

UNITS_OF_LAMMPS = ("lj", "real", "metal", "si", "cgs", "electron", "micro", "nano")
# as LAMMPS' write_data states them in the title of a data file
LAMMPS_UNITS = re.compile(rf"\bunits\s*=\s*({'|'.join(UNITS_OF_LAMMPS)})\b")
# LAMMPS' velocities [Å/ps]; lengths, masses, charges are those of ASE
PER_PICOSECOND = {"metal": 1.0, "real": 1e3}
