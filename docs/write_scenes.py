"""Writes docs/scenes.md: every key of a scene file, with its unit and its default, from minimd/document/sections.py.

    python docs/write_scenes.py

A key without a meaning below is refused, and a test compares the page with what is written here.
"""

import json
import types
import typing
from collections.abc import Iterator
from pathlib import Path

from annotated_types import Ge, Gt, MaxLen
from pydantic_core import PydanticUndefined

from minimd.document.section import KEY_UNITS, Dimension, Section
from minimd.document.sections import METHODS, PLOT_SUFFIXES, SceneSections
from minimd.integrators.splitting.barostats import COUPLINGS
from minimd.observers import KINDS
from minimd.potentials.pair import MIXING
from minimd.potentials.truncation import TRUNCATIONS
from minimd.structure.lattice import BASES

PAGE = Path(__file__).parent / "scenes.md"
UNITS = {
    "_A": "Å", "_fs": "fs", "_K": "K", "_eV": "eV", "_eV_A": "eV/Å", "_g_cm3": "g/cm³", "_eV_A2": "eV/Å²",
    "_degree": "°", "_eV_rad2": "eV/rad²", "_per_A": "1/Å", "_A_ps": "Å/ps", "_A_ps2": "Å/ps²",
    "_bar": "bar", "_GPa": "GPa", "_per_bar": "1/bar", "_per_GPa": "1/GPa",
}  # fmt: skip
REDUCED = {
    "length": "σ", "time": "τ", "temperature": "ε/k_B", "energy": "ε", "force": "ε/σ", "density": "1/σ³",
    "stiffness": "ε/σ²",
    "angular stiffness": "ε/rad²", "angle": "°", "inverse length": "1/σ", "velocity": "σ/τ", "acceleration": "σ/τ²",
    "pressure": "ε/σ³", "compressibility": "σ³/ε",
}  # fmt: skip
CHOICES = {
    "lattice": BASES,
    "mixing": MIXING,
    "truncation": TRUNCATIONS,
    "method": METHODS,
    "coupling": COUPLINGS,
    "kind": KINDS,
    "axis": "abc",
}
MEANINGS = {
    "": {
        "title": "a line for reports and files",
        "units": "of the whole file",
    },
    "structure": {
        "file": "of any format that ASE or MDAnalysis reads, relative to the scene; instead of `lattice`",
        "lattice": "a block of a cubic crystal",
        "element": "chemical symbol of the atoms of `lattice`, also for their masses; in reduced units masses are 1",
        "repeat": "cells of `lattice` along x, y and z",
        "density": "of `lattice`: of mass, in reduced units of atoms",
        "lattice_constant": "edge of the cubic cell, instead of `density`",
        "cell": "edges, instead of those of the file; 0 in a direction that does not repeat",
        "pbc": "periodic directions, one for all or three; of a slab `[true, true, false]`",
        "species": "a label for each atom, instead of those of the file or the element",
        "charges": "of all atoms [e], or of each species, as `{ Na = 1.0, Cl = -1.0 }`; instead of those of the file",
        "format": 'of `file`, if its suffix does not tell it, such as `"lammps-data"`',
        "bonds": (
            'pairs of atoms; `"file"` for those that the file names, with its angles and dihedrals; or another file '
            "that names them, from which charges are taken, too, if the first has none"
        ),
    },
    "water": {
        "model": "its numbers are in the table of [water](water.md)",
        "molecules": "an O and two H each, in this order",
        "density": "from which the edge of the cubic cell follows",
        "cutoff": "of Lennard-Jones and charges; if not given 9 Å, or 0.45 of a shorter edge, with a warning",
        "accuracy": "of the forces of charges, as of the potential `coulomb`",
        "seed": "of the orientations",
    },
    "constraints": {
        "pairs": 'of atoms whose distance is held; `"bonds"` for those of the structure',
        "lengths": "one for all, or one for each pair; as they are at the start if not given",
        "fixed": "atoms that stay where they are",
        "tolerance": "relative, of the solver `shake`",
        "solver": "for the lengths",
    },
    "potential, lennard-jones": {
        "type": "of the potential",
        "epsilon": "depth of the well, the same for all species",
        "sigma": "distance where u = 0, the same for all species",
        "species": "instead of `epsilon` and `sigma`: a table of tables, see below",
        "pairs": "parameters of two species that do not follow the mixing rule, see below",
        "mixing": "rule for unlike species",
        "cutoff": "needed in a periodic cell",
        "truncation": "how the law goes to zero at the cutoff",
        "switch_start": 'where `"switched"`, `"charmm"` and `"smooth"` begin; 0.8 of the cutoff if not given',
        "bonded_scale": "factors for pairs one, two and three bonds apart",
        "tail_correction": "add the energy and pressure of the pairs beyond the cutoff",
    },
    "potential.species.X": {"epsilon": "depth of the well", "sigma": "distance where u = 0"},
    "potential.pairs": {
        "epsilon": "depth of the well",
        "sigma": "distance where u = 0",
        "species": "the two",
        "file": "their table",
    },
    "tables": {"r": "distances", "u": "energies, as many"},
    "potential, tabulated": {
        "type": "of the potential",
        "file": (
            "table of all atoms: two columns, r and u in the units of the scene, relative to the scene; or a name in "
            "`[tables]`"
        ),
        "pairs": "instead of `file`: a table for each pair of species, see below",
        "cutoff": "the last r of the table if not given",
        "truncation": "how the law goes to zero at the cutoff",
        "switch_start": 'where `"switched"`, `"charmm"` and `"smooth"` begin; 0.8 of the cutoff if not given',
        "bonded_scale": "factors for pairs one, two and three bonds apart",
    },
    "dynamics": {
        "method": "of integration",
        "timestep": "Δt",
        "steps": "of the run",
        "temperature": "of the initial velocities, and of a thermostat; without it velocities stay as they are",
        "relaxation_time": "of a thermostat, which needs it; for Langevin dynamics 1/friction",
        "seed": "of velocities and noise",
        "threads": "at most; all cores of the process if not given",
        "precision": "of the forces between pairs",
    },
    "barostat": {
        "pressure": "P₀",
        "compressibility": "isothermal; a rough value is enough: 4.6e-5 bar⁻¹ for water, 2e-4 bar⁻¹ for liquid argon",
        "relaxation_time": "of the volume, at least ten times the time between two strains",
        "coupling": "which strains the cell can have: the same along all axes, any, or along some axes independently",
        "every": "steps between two strains",
        "seed": "of the noise",
    },
    "minimization": {
        "force_tolerance": "the largest force that may remain",
        "max_steps": "largest number of steps",
        "max_step_length": "largest displacement of an atom in one step",
    },
    "equilibration": {
        "steps": "before the run, which then begins at step 0",
        "temperature": "to which velocities are rescaled; that of `[dynamics]` if not given",
        "rescale_every": "steps between two rescalings",
    },
    "output": {
        "trajectory": (
            "a file, or several, of the format that the suffix names; the name of the scene with `.h5md` if not given"
        ),
        "every": "steps between two observations",
        "forces": "store them in the trajectory",
        "shadow_energy": "observe it",
        "stress": "observe the tensor",
        "plot": "draw the run, next to the trajectory or into a file that ends in " + ", ".join(PLOT_SUFFIXES),
    },
}
INTRODUCTION = """# What can stand in a scene file?

A scene file describes a run: atoms, potentials, method, steps and output. Write one in [TOML](https://toml.io), \
and run it with
`minimd run scene.toml`.

```toml
title = "liquid argon"

[structure]
lattice = "fcc"
element = "Ar"
repeat = [4, 4, 4]
density_g_cm3 = 1.374

[[potential]]
type = "lennard-jones"
cutoff_A = 8.0
truncation = "switched"

[potential.species.Ar]
epsilon_K = 119.8
sigma_A = 3.405

[dynamics]
timestep_fs = 4.0
steps = 20
temperature_K = 94.4
```

The key of a quantity ends in its unit, as `timestep_fs` does. With `units = "LJ"` numbers are reduced and keys \
have no such ending (`timestep`),
except for angles. An unknown key is refused, and the message lists the known ones. The tables below have every \
key. (This page is written by
`docs/write_scenes.py` from the code that reads scenes.)
"""
HEADINGS = {
    "": "At the top of the file",
    "potential.pairs": "[[potential.pairs]]",
    "observer": "[[observer]]",
}
NOTES = {
    "structure": (
        "Either `file`, or `lattice` with `repeat` and `density` or `lattice_constant`, and `element` unless units "
        "are reduced."
    ),
    "water": (
        "Rigid water by the name of its model, instead of `[structure]`: atoms, charges, potentials and constraints, "
        "as `md.water` makes them. Further potentials may be added. `[water]` alone is 512 molecules of SPC/E. They "
        "stand on a lattice, turned at random: give a `[minimization]`, and an `[equilibration]` or a bath. "
        "`units` is ASE; `[constraints]` has no `pairs` then."
    ),
    "constraints": "Optional. What it does not name is taken from the structure file.",
    "potential, lennard-jones": (
        "Double brackets: a scene can have several potentials. Either `epsilon` and `sigma`, or `species`."
    ),
    "potential, fene-bond": (
        "Exclude bonded pairs from the potential between all beads with `bonded_scale = [0.0, 1.0, 1.0]`."
    ),
    "potential, steered-spring": "The work that moving the points does is recorded as `work`.",
    "potential, wall": (
        "Fields are external forces. Their formulas, and those of all other potentials, are on the page on "
        "[forces](forces.md)."
    ),
    "potential.species.X": (
        "A table for each species X, below its `[[potential]]`, or: `species = { X = { epsilon_eV = 0.01, sigma_A = "
        "3.4 } }`"
    ),
    "potential.pairs": "One table for each pair, below its `[[potential]]`.",
    "potential, tabulated": "Either `file` or `pairs`.",
    "potential, coulomb": "The charges are those of `[structure]`: of its `file`, or its key `charges`.",
    "tables": (
        "A table `[tables.X]` is what a file named X would hold: a scene that is stored in the file of its run has "
        "its tables there."
    ),
    "barostat": (
        "Optional: constant pressure by stochastic cell rescaling, at the temperature of `[dynamics]`; see "
        "[pressure.md](pressure.md)."
    ),
    "minimization": (
        "Optional: before everything else, atoms move to a nearby minimum of the energy. `[minimization]` alone is "
        "enough."
    ),
    "equilibration": "Optional: steps before the run, with velocities rescaled.",
    "observer": "Optional. Double brackets: a scene can have several. The defaults are those of the kind.",
    "output": "Optional.",
}


def sections() -> Iterator[tuple[str, type[Section]]]:
    """Name and class of each table, in the order of the page."""
    yield "", SceneSections
    for name, info in SceneSections.model_fields.items():
        for section in dict.fromkeys(classes_in(info.annotation)):
            kind = (
                typing.get_args(section.model_fields["type"].annotation)[0] if "type" in section.model_fields else None
            )
            yield f"{name}, {kind}" if kind else name, section
            for inner, deeper in section.model_fields.items():
                for one in dict.fromkeys(classes_in(deeper.annotation)):
                    yield f"{name}.{inner}" + (".X" if "dict" in str(deeper.annotation) else ""), one


def classes_in(kind: object) -> Iterator[type[Section]]:
    """The sections in an annotation."""
    if isinstance(kind, type) and not isinstance(kind, types.GenericAlias) and issubclass(kind, Section):
        yield kind
    for inner in typing.get_args(kind):
        yield from classes_in(inner)


def what(name: str, kind: object, limits: list[object]) -> str:
    """The kind of a value, in words."""
    if name in CHOICES and not any(one in str(kind) for one in ("list", "Literal")):  # as the axis of a cylinder
        return " or ".join(f'`"{one}"`' for one in CHOICES[name])
    arguments, origin = typing.get_args(kind), typing.get_origin(kind)
    if origin is typing.Annotated:
        return what(
            "",
            arguments[0],
            [*limits, *arguments[1:], *(one for mark in arguments[1:] for one in getattr(mark, "metadata", ()))],
        )
    if origin is typing.Literal:
        return " or ".join(f'`"{one}"`' for one in arguments)
    if origin in (typing.Union, types.UnionType):
        return " or ".join(what("", one, limits) for one in arguments if one is not type(None))
    if origin is list:
        most = next((one.max_length for one in limits if isinstance(one, MaxLen)), None)
        return f"list{f' of {most}' if most else ''}: {what('', arguments[0], [])}"
    if origin is dict or (isinstance(kind, type) and issubclass(kind, Section)):
        return "table"
    least = next((f", at least {one.ge:g}" for one in limits if isinstance(one, Ge)), "")
    above = next((", positive" for one in limits if isinstance(one, Gt)), "")
    return {int: "whole number", float: "number", bool: "true or false", str: "text"}[kind] + (least or above)  # type: ignore[index]


def default(info: typing.Any, size: float) -> str:
    """The default of a key, in words.  size : of the unit of the key, in that of the engine."""
    if info.is_required():
        return "required"
    if info.default is None or info.default is PydanticUndefined or isinstance(info.default, Section):
        return ""
    shown = info.default / size if isinstance(info.default, float) else info.default
    return f"`{json.dumps(shown)}`" if info.default != "" else "none"


def rows(name: str, section: type[Section]) -> Iterator[str]:
    """The rows of the table of a section.  Raises KeyError for a key without a meaning."""
    for field, info in section.model_fields.items():
        if any(True for _ in classes_in(info.annotation)) and name == "":
            continue
        dimension = next((mark for mark in info.metadata if isinstance(mark, Dimension)), None)
        keys, units, reduced, size = [field], "", "", 1.0
        if dimension is not None:
            keys = [field + ending for ending in KEY_UNITS["ASE"][dimension]]
            size = next(iter(KEY_UNITS["ASE"][dimension].values()))
            units = " or ".join(UNITS[ending] for ending in KEY_UNITS["ASE"][dimension])
            reduced = "" if name == "water" else REDUCED[dimension]
            if dimension == "angle":
                reduced = f"`{field}_degree`, {reduced}"
        kind = what(field, info.annotation, list(info.metadata))
        meaning = info.description or MEANINGS.get(name, {"type": "of the potential"}).get(field)
        if meaning is None:
            raise KeyError(f"docs/write_scenes.py has no meaning for the key {field!r} of [{name}]; give it one there")
        cells = [
            " or ".join(f"`{key}`" for key in keys),
            meaning,
            kind,
            units,
            reduced,
            default(info, size),
        ]
        yield f"| {' | '.join(cells)} |"


def page() -> str:
    """The whole page."""
    parts = [INTRODUCTION]
    for name, section in sections():
        kind = name.partition("potential, ")[2]
        heading = HEADINGS.get(name, f'[[potential]] with type = "{kind}"' if kind else f"[{name}]")
        note = [NOTES[name], ""] if name in NOTES else []
        head = ["| key | what it is | value | unit | reduced | default |", "| --- | --- | --- | --- | --- | --- |"]
        parts.append("\n".join([f"## {heading}", "", *note, *head, *rows(name, section), ""]))
    return "\n".join(parts)


if __name__ == "__main__":
    PAGE.write_text(page(), encoding="utf-8")
