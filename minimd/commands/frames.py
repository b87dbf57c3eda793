"""`minimd frames`: make any step of a run in fixed-point arithmetic again, to the last bit."""

import argparse
from pathlib import Path
from typing import Any

from minimd.commands.options import add_command, scene_of, silence, whole_number


def add(commands: Any) -> None:
    """Add the command to the subparsers of `minimd`."""
    text = "Make steps of a run with precision='fixed-point' again, from the frame before them."
    parser = add_command(
        commands, frames, "make any step of a run again", ("file", "trajectory (.h5md)"), "--scene", "--overwrite", "--quiet", description=text
    )
    parser.add_argument("--at", type=whole_number, nargs="+", required=True, metavar="STEP", help="steps to make again")
    parser.add_argument("--out", type=Path, metavar="FILE", help="file to write; for several steps, the step is added to the name")


def frames(arguments: argparse.Namespace) -> None:
    """Write a file for each step.  Raises as Simulation.resume."""
    import minimd as md

    scene, file = scene_of(arguments), arguments.file
    with silence(arguments.quiet):
        for step in arguments.at:
            out = arguments.out or file.with_name(f"{file.stem}-{step}.h5md")
            if arguments.out and len(arguments.at) > 1:
                out = out.with_name(f"{out.stem}-{step}{out.suffix}")
            simulation = md.Simulation.resume(file, scene and scene.potentials(), step=step)
            record = simulation.run(0, trajectory=out, overwrite=arguments.overwrite)
            energy, units = record.total_energy[0], simulation.system.units
            print(f"step {step:<9} t = {units.shown(simulation.time)}, total energy {energy!r} {units.energy}: written to {out}")
