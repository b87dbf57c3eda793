"""Scenes as texts, for tests of what they mean and of what is wrong with them."""

from pathlib import Path

import numpy as np
from references import melt_scene

from minimd.scene import parse_scene

ARGON = Path(__file__).parent.parent / "examples" / "argon.toml"
REDUCED = melt_scene(4, 20, "seed = 3\n[output]\nevery = 5\n")
SMOOTH = melt_scene(4, 40, "[output]\nevery = 10\n").replace("cutoff =", 'truncation = "force-shifted"\ncutoff =')
R = np.linspace(0.8, 2.5, 2000)  # their text is longer than the 64 kB that an attribute of HDF5 can have in place
U = 4.0 * (R**-12 - R**-6)
TABULATED = melt_scene(3, 4, '[output]\nevery = 2\nstress = true\ntrajectory = "a.h5md"\n')
LAW = 'type = "lennard-jones"\nepsilon = 1.0\nsigma = 1.0\ncutoff = 2.5\n'
TABULATED = TABULATED.replace(LAW, 'type = "tabulated"\nfile = "lj.dat"\ncutoff = 2.4\n')
MIXTURE = """
structure = { file = "pair.xyz" }
dynamics = { timestep_fs = 1.0, steps = 0 }
potential = [{ type = "tabulated", truncation = "truncated", pairs = [{ species = ["Ar", "Ar"], file = "like" }, \
    { species = ["Kr", "Ar"], file = "unlike" }, { species = ["Kr", "Kr"], file = "like" }] }]
[tables]
like = { r_A = [2.0, 3.0, 4.0, 5.0, 6.0, 7.0], u_K = [600.0, 500.0, 400.0, 300.0, 200.0, 100.0] }
[tables.unlike]
r_A = [2.0, 3.0, 4.0, 5.0, 6.0, 7.0]
u_eV = [6.0, 5.0, 4.0, 3.0, 2.0, 1.0]
"""
SALT = """
units = "LJ"
structure = { lattice = "sc", repeat = [2, 2, 2], lattice_constant = 1.4, charges = { A = 0.7, B = -0.7 }, \
    species = ["A", "B", "B", "A", "B", "A", "A", "B"] }
dynamics = { timestep = 0.001, steps = 4, temperature = 0.5 }
output = { every = 2 }
potential = [{ type = "lennard-jones", epsilon = 1.0, sigma = 1.0, cutoff = 1.3 }, \
    { type = "coulomb", cutoff = 1.39, accuracy = 1e-4, method = "ewald" }]
"""
WATER = """
water = { model = "OPC3", molecules = 27, density_g_cm3 = 0.95, cutoff_A = 4.0, accuracy = 1e-4, seed = 3 }
minimization = { max_steps = 3 }
dynamics = { timestep_fs = 1.0, steps = 4, temperature_K = 300.0 }
output = { every = 2, trajectory = "a.h5md" }
potential = [{ type = "constant-force", force_eV_A = [0.01, 0.0, 0.0] }]
observer = [{ kind = "mean-square-displacement", every = 1 }]
"""


def write_tables(scale=1.0):
    """The files that TABULATED and MIXTURE name."""
    np.savetxt("lj.dat", np.column_stack([R, scale * U]), fmt="%.17g", header="r/σ  u/ε")
    Path("pair.xyz").write_text("3\n\nAr 0 0 0\nKr 4.5 0 0\nAr 0 5.5 0\n")


def scene_of(text, path="scene.toml"):
    return parse_scene(text, Path(path))


def everything_of(text):
    scene = scene_of(text)
    scene.plot_name(scene.trajectories())
    return scene.simulation()
