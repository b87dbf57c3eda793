"""Scenes as texts, for tests of what they mean and of what is wrong with them."""

from pathlib import Path

from references import melt_scene

from minimd.scene import parse_scene

ARGON = Path(__file__).parent.parent / "examples" / "argon.toml"
REDUCED = melt_scene(4, 20, "seed = 3\n[output]\nevery = 5\n")
SMOOTH = melt_scene(4, 40, "[output]\nevery = 10\n").replace(
    "cutoff = 2.5", 'cutoff = 2.5\ntruncation = "force-shifted"'
)


def scene_of(text, path="scene.toml"):
    return parse_scene(text, Path(path))


def everything_of(text):
    scene = scene_of(text)
    scene.plot_name(scene.trajectories())
    return scene.simulation()
