"""Writes docs/scenes.md: every key of a scene file, with its unit and its default, from minimd/scene/sections.py.

    python docs/write_scenes.py

A key without a meaning below is refused, and a test compares the page with what is written here.
"""

import json
import re
import types
import typing
from collections.abc import Iterator
from pathlib import Path

from annotated_types import Ge, Gt, MaxLen
from pydantic_core import PydanticUndefined

from minimd.core.integrators.barostats import COUPLINGS
from minimd.core.potentials.embedded import FORMS
from minimd.core.potentials.pair import MIXING
from minimd.core.potentials.truncation import TRUNCATIONS
from minimd.core.structure.lattice import BASES
from minimd.observers import KINDS
from minimd.scene.section import KEY_UNITS, Dimension, Section
from minimd.scene.sections import METHODS, PLOT_SUFFIXES, SceneSections

PAGE = Path(__file__).parent / "scenes.md"
UNITS = {
    "_A": "Å", "_fs": "fs", "_K": "K", "_eV": "eV", "_eV_A": "eV/Å", "_g_cm3": "g/cm³", "_eV_A2": "eV/Å²",
    "_eV_A3": "eV/Å³", "_eV_A4": "eV/Å⁴",
    "_degree": "°", "_eV_rad2": "eV/rad²", "_per_A": "1/Å", "_A_ps": "Å/ps", "_A_ps2": "Å/ps²",
    "_bar": "bar", "_GPa": "GPa", "_per_bar": "1/bar", "_per_GPa": "1/GPa",
}  # fmt: skip
REDUCED = {
    "length": "σ", "time": "τ", "temperature": "ε/k_B", "energy": "ε", "force": "ε/σ", "density": "1/σ³",
    "stiffness": "ε/σ²", "cubic stiffness": "ε/σ³", "quartic stiffness": "ε/σ⁴",
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
    "law": FORMS,
    "axis": "abc",
}
MEANINGS = {
    "": {
        "title": "title line of reports and files",
        "units": "units of the whole file; LJ: reduced",
    },
    "structure": {
        "file": "structure file for ASE or MDAnalysis, with a path relative to the scene file; instead of `lattice`",
        "lattice": "crystal structure of a block of atoms",
        "element": "chemical symbol of the atoms of `lattice`; it gives the masses, which are 1 in reduced units",
        "planar": "whether the atoms of `file` move in the plane z = 0; those of a square or triangular lattice do",
        "repeat": "number of unit cells along x, y and z, or x and y",
        "density": "mass density of the crystal; in reduced units its number density",
        "lattice_constant": "edge of the unit cell, instead of `density`; see `md.lattice.crystal`",
        "cell": "edges of the cell, instead of those of the file; 0 in a direction that is not periodic",
        "pbc": "whether directions are periodic: one value for all, or three; `[true, true, false]` for a slab",
        "species": "a label for each atom; by default those of the file, or the element",
        "charges": "charges [e] of all atoms, or of species, `{ Na = 1.0, Cl = -1.0 }`; instead of those of the file",
        "format": 'format of `file`, such as `"lammps-data"`, if the suffix does not show it',
        "masses": (
            "masses [u, or reduced] of atoms whose file does not state them: one for all, a list, or by names of atoms "
            "or types, `{ W = 72.0 }`"
        ),
        "elements": 'elements of atoms, in place of those guessed from their names: a list, or `{ NA = "N" }`',
        "atom_style": 'LAMMPS\' atom style of a data file that does not name it, such as `"full"`',
        "lammps_units": 'LAMMPS\' units of a file that does not state them: `"real"`, `"metal"`, `"lj"`',
        "bonds": (
            'pairs of atoms; or `"file"`: the bonds, angles and dihedrals of `file`; or the name of another file with '
            "bonds; charges of that file are used if `file` has none"
        ),
    },
    "water": {
        "model": "model; its parameters are in the table of [water](water.md)",
        "molecules": "number of molecules; the atoms of each are O, H, H",
        "density": "density of water, which determines the edge of the cubic cell",
        "ions": "how many of which [ions](water.md#ions), `{ Na = 5, Cl = 5 }`: of the box, or those of the file",
        "cutoff": (
            "cutoff of Lennard-Jones and charges; if not given, 9 Å, or 0.45 of a shorter edge, with a warning, unless "
            "the atoms are those of a file"
        ),
        "accuracy": "accuracy of the forces of charges, see the potential `coulomb`",
        "seed": "seed of the orientations, and of the places of ions",
    },
    "constraints": {
        "pairs": 'pairs of atoms at a fixed distance; `"bonds"` for the bonds of the structure',
        "lengths": "fixed distance, one for all pairs or one for each; if not given, the distances at the start",
        "fixed": "atoms that do not move",
        "tolerance": "relative tolerance of the solver `shake`",
        "solver": "solver for the fixed distances",
    },
    "potential, lennard-jones": {
        "type": "type of the potential",
        "epsilon": "depth of the well, the same for all species",
        "sigma": "distance where u = 0, the same for all species",
        "species": "table of parameters of each species, see below; instead of `epsilon` and `sigma`",
        "pairs": "for two species, parameters that do not follow the mixing rule, see below",
        "mixing": "rule for unlike species",
        "cutoff": "r_c; required in a periodic cell",
        "truncation": "how the law goes to zero at the cutoff",
        "switch_start": 'distance where `"switched"`, `"charmm"` and `"smooth"` begin; if not given, 0.8 of the cutoff',
        "bonded_scale": "factors for pairs one, two and three bonds apart",
        "tail_correction": "whether to add energy and pressure of the pairs beyond the cutoff",
    },
    "potential, soft-repulsion": {
        "type": "type of the potential",
        "height": "A, half of u at r = 0",
        "cutoff": "r_c, where energy and force vanish",
        "bonded_scale": "factors for pairs one, two and three bonds apart",
    },
    "potential.species.X": {
        "epsilon": "depth of the well",
        "sigma": "distance where u = 0",
        "n": "exponent of repulsion",
        "m": "exponent of attraction",
    },
    "potential.pairs": {
        "epsilon": "depth of the well",
        "sigma": "distance where u = 0",
        "n": "exponent of repulsion",
        "m": "exponent of attraction",
        "species": "the two species",
        "file": "table of this pair, as `file` above",
        "parameters": "numbers of the law, in its order",
    },
    "files": {"text": "text of the file"},
    "tables": {"r": "distances", "u": "energies, one for each distance"},
    "potential, tabulated": {
        "type": "type of the potential",
        "file": (
            "file with a table for all atoms: columns r and u in the units of the scene; its path is relative to the "
            "scene file; or a name in `[tables]`"
        ),
        "pairs": "a table for each pair of species, see below; instead of `file`",
        "cutoff": "r_c; if not given, the last r of the table",
        "truncation": "how the law goes to zero at the cutoff",
        "switch_start": 'distance where `"switched"`, `"charmm"` and `"smooth"` begin; if not given, 0.8 of the cutoff',
        "bonded_scale": "factors for pairs one, two and three bonds apart",
    },
    "potential, embedded-atom": {
        "type": "type of the potential",
        "file": (
            "file of tables for LAMMPS' `eam`, `eam/alloy` or `eam/fs`, in eV and Å; its path is relative to the scene "
            "file; or a name in `[files]`"
        ),
        "law": "law by its name, instead of `file`",
        "parameters": (
            "numbers of the law, the same for all species, in the order of [metals](metals.md#by-name) and in the "
            "units of the scene: eV and Å, or reduced"
        ),
        "species": "for each species its numbers, `{ Cu = [0.0124, 3.61, 39.4, 9.0, 6.0] }`; instead of `parameters`",
        "pairs": "numbers for two different species, see below",
        "cutoff": "r_c; required in a periodic cell",
        "truncation": 'how φ and g go to zero at the cutoff; published parameters mean `"truncated"`',
        "switch_start": 'distance where `"switched"`, `"charmm"` and `"smooth"` begin; if not given, 0.8 of the cutoff',
    },
    "dynamics": {
        "method": "integration method",
        "timestep": "time step",
        "steps": "number of steps of the run",
        "temperature": "initial temperature, also that of a thermostat; if not given, the velocities are not changed. "
        "Of a thermostat also two numbers, from the first of which to the second it goes during the run, "
        "a [ramp](temperature.md#annealing-ramps-and-the-next-day)",
        "relaxation_time": "relaxation time of a thermostat, required with one; 1/friction in Langevin dynamics",
        "inner": "of `respa` and `langevin-respa`: number of [inner steps](timestep.md#several-time-steps), at most "
        "100; 4 if not given",
        "n_steps": "of `hybrid-monte-carlo`: steps of a [trajectory](hybrid-monte-carlo.md); 20 if not given. Then "
        "`steps` counts trajectories",
        "seed": "seed of velocities and noise",
        "threads": "largest number of threads; if not given, the number of cores that the process may use",
        "max_seconds": "seconds of wall time after which a run ends, [to be resumed](files.md#one-run-on-a-cluster)",
        "precision": "arithmetic of the run, see [fixed point](fixed-point.md)",
    },
    "barostat": {
        "pressure": "target pressure; or two numbers, from the first of which to the second it goes during the run",
        "compressibility": (
            "isothermal compressibility; a rough value is enough: 4.6e-5 bar⁻¹ for water, 2e-4 bar⁻¹ for liquid argon"
        ),
        "relaxation_time": "relaxation time of the volume, at least ten times the time between two strains",
        "coupling": "strain of the cell: the same along all axes, any strain, or independent ones along the named axes",
        "every": "steps between two strains",
        "seed": "seed of the noise",
    },
    "minimization": {
        "force_tolerance": "minimization ends when no force is larger",
        "max_steps": "largest number of steps of the minimization",
        "max_step_length": "largest displacement of an atom in one step",
    },
    "equilibration": {
        "steps": "number of steps before the run, which then begins at step 0",
        "temperature": "temperature to which velocities are rescaled; if not given, that of `[dynamics]`",
        "rescale_every": "steps between two rescalings",
    },
    "output": {
        "trajectory": (
            "one file or several; the suffix determines the format; if not given, the name of the scene with `.h5md`"
        ),
        "every": "steps between two observations",
        "forces": "whether to store forces in the trajectory",
        "shadow_energy": "whether to record the shadow energy",
        "stress": "whether to record the stress tensor",
        "plot": "whether to draw the run next to the trajectory; or a file name that ends in "
        + ", ".join(PLOT_SUFFIXES),
    },
}
MEANINGS["potential, mie"] = MEANINGS["potential, lennard-jones"] | {
    "species": "table of parameters of each species, see below; instead of `epsilon`, `sigma`, `n` and `m`",
    "n": "exponent of repulsion, larger than m; the same for all species",
    "m": "exponent of attraction; the same for all species",
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

The key of a quantity ends in its unit, as `timestep_fs` does. With `units = "LJ"` numbers are in reduced units, and \
keys have no such ending (`timestep`),
except for angles. minimd refuses an unknown key, and lists the known keys. The tables below have every \
key. (`docs/write_scenes.py` makes
this page from the code that reads scenes.)
"""
HEADINGS = {
    "": "At the top of the file",
    "potential.pairs": "[[potential.pairs]]",
    "observer": "[[observer]]",
}
NOTES = {
    "structure": (
        "Give either `file`; or `lattice`, `repeat`, and either `density` or `lattice_constant`. `lattice` also needs "
        "`element`, unless units are reduced."
    ),
    "water": (
        "Rigid water: charges, potentials and constraints of a water model, as `md.water` makes them. Further "
        "potentials may be added. Units must be ASE's, and `[constraints]` must not have `pairs`.\n\n"
        "Beside `[structure]` with `file`, the atoms are those of the file, O and H in any order: see "
        "[water of a file](water.md#water-of-a-file). Then leave out `molecules`, `density`, `seed`, and "
        "`bonds` and `charges` of the structure. Without `[structure]`, `[water]` alone makes 512 molecules of SPC/E. "
        "They stand on a lattice, with random orientations: add a `[minimization]`, and an `[equilibration]` or a "
        "thermostat."
    ),
    "constraints": "Optional. Constraints that are not given here are those of the structure file.",
    "potential, lennard-jones": (
        "Double brackets: a scene can have several potentials. Give either `epsilon` and `sigma`, or `species`."
    ),
    "potential, mie": (
        "Give either `epsilon`, `sigma`, `n` and `m`, or `species`. Species with different exponents need `pairs`."
    ),
    "potential, fene-bond": (
        "To exclude bonded pairs from a pair potential, set its `bonded_scale = [0.0, 1.0, 1.0]`."
    ),
    "potential, steered-spring": "The record has the work of the moving points as `work`.",
    "potential, wall": (
        "Walls are external forces. The page on [forces](forces.md) has the formulas of all potentials."
    ),
    "potential.species.X": (
        "One table for each species X, below its `[[potential]]`. A shorter form is the key `species = { X = { "
        "epsilon_eV = 0.01, sigma_A = 3.4 } }`."
    ),
    "potential.pairs": "Write one such table for each pair of species, below the `[[potential]]` to which it belongs.",
    "potential, tabulated": "Give either `file` or `pairs`.",
    "potential, embedded-atom": (
        "Metals. Give either `file`, and nothing else, or `law` with either `parameters` or `species`. The page on "
        "[metals](metals.md) has the laws and whole scenes."
    ),
    "potential, coulomb": "The charges are those of `[structure]`: from its `file`, or from its key `charges`.",
    "tables": (
        "The table `[tables.X]` is used instead of a file named X. The file of a run stores its scene with such tables."
    ),
    "files": (
        "The text in `[files.X]` is used instead of a file named X, by `embedded-atom`. The file of a run stores its "
        "scene with such texts."
    ),
    "barostat": (
        "Optional. Stochastic cell rescaling keeps the pressure constant, at the temperature of `[dynamics]`; see "
        "[pressure.md](pressure.md)."
    ),
    "minimization": (
        "Optional. Before all steps, atoms move to a nearby minimum of the energy. A `[minimization]` without keys "
        "uses the defaults."
    ),
    "equilibration": "Optional. Steps before the run, in which velocities are rescaled to a temperature.",
    "observer": (
        "Optional. Double brackets: a scene can have several observers. Keys that are not given have the defaults of "
        "the observer."
    ),
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
        return f"list of {f'{most} ' if most else ''}{many(what('', arguments[0], []))}"
    if origin is dict or (isinstance(kind, type) and issubclass(kind, Section)):
        return "table"
    least = next((f" ≥ {one.ge:g}" for one in limits if isinstance(one, Ge)), "")
    above = next((" > 0" for one in limits if isinstance(one, Gt)), "")
    return {int: "integer", float: "number", bool: "boolean", str: "string"}[kind] + (least or above)  # type: ignore[index]


def many(words: str) -> str:
    """The plural of a kind of value."""
    return re.sub("integer|number|boolean|string|table|list", r"\g<0>s", words, count=1)


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
        meaning = info.description or MEANINGS.get(name, {"type": "type of the potential"}).get(field)
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
        head = ["| key | meaning | value | unit | reduced | default |", "| --- | --- | --- | --- | --- | --- |"]
        parts.append("\n".join([f"## {heading}", "", *note, *head, *rows(name, section), ""]))
    return "\n".join(parts)


if __name__ == "__main__":
    PAGE.write_text(page(), encoding="utf-8")
