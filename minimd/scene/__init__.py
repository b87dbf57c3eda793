"""Scene files: a simulation described in TOML, with units in its keys; an example is examples/argon.toml."""

from minimd.scene.running import resume_run, run_scene
from minimd.scene.scene import Scene, load_scene, parse_scene

__all__ = ["Scene", "load_scene", "parse_scene", "resume_run", "run_scene"]
