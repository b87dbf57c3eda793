"""Scenes as texts, for tests of what they mean and of what is wrong with them."""

from pathlib import Path

import numpy as np
from references import melt_scene, scene_text

from minimd.scene import parse_scene

ARGON = Path(__file__).parent.parent / "examples" / "argon.toml"
REDUCED = melt_scene(4, 20, "seed = 3\n[output]\nevery = 5\n")
SMOOTH = melt_scene(4, 40, "[output]\nevery = 10\n").replace("cutoff =", 'truncation = "force-shifted"\ncutoff =')
R = np.linspace(0.8, 2.5, 2000)  # their text is longer than the 64 kB that an attribute of HDF5 can have in place
U = 4.0 * (R**-12 - R**-6)
TABULATED = melt_scene(3, 4, '[output]\nevery = 2\nstress = true\ntrajectory = "a.h5md"\n')
LAW = 'type = "lennard-jones"\nepsilon = 1.0\nsigma = 1.0\ncutoff = 2.5\n'
TABULATED = TABULATED.replace(LAW, 'type = "tabulated"\nfile = "lj.dat"\ncutoff = 2.4\n')
MIXTURE, SALT, WATER = map(scene_text, ("mixture", "salt", "water"))


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
