"""Whole scenes: files in TOML with units in their keys, as examples/argon.toml; water."""

from minimd.scene.running import resume_run as resume_run, run_scene as run_scene
from minimd.scene.scene import Scene as Scene, load_scene as load_scene, parse_scene as parse_scene
