"""Observers in a minimd file: their arguments, their state at each restart, and their results at the end of a run.

minimd/observers/<name>             attributes kind and arguments (JSON); at the end of a run the result: a dataset
                                    for each series and for its standard error, and single numbers as attributes,
                                    in the units of the simulation (attribute units)
minimd/restart/observer.<name>.*    the arrays of its state, together with the restart to which they belong

H5MD keeps averages that do not depend on time as groups in observables. The reader of MDAnalysis takes everything there
for series with an entry for each frame, and refuses a file in which that is not so.
Therefore minimd keeps them in its own group.
"""

import json
import warnings
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import h5py
import numpy as np

from minimd.console.quiet import outside_minimd
from minimd.console.words import listed, shown
from minimd.files.h5md_digest import read_restart
from minimd.observers import KINDS
from minimd.observers.accumulator import Accumulator

GROUP, MARK = "minimd/observers", "observer."


def describe_observers(h5: h5py.File, observers: Sequence[Accumulator]) -> None:
    """Write the arguments of the observers, replacing those that the file has for the same names."""
    for one in observers:
        group = h5.require_group(f"{GROUP}/{one.name}")
        group.attrs.update({"kind": one.kind, "arguments": json.dumps(one.made_with())})


def states_of(observers: Sequence[Accumulator]) -> dict[str, np.ndarray]:
    """The arrays of the observers' states, to be kept with a restart."""
    return {f"{MARK}{one.name}.{key}": np.asarray(array) for one in observers for key, array in one.state().items()}


def restore_observers(h5: h5py.File, file: str | Path, observers: Sequence[Accumulator]) -> None:
    """Give observers that have not looked yet the state that the file holds for them.

    Raises ValueError if the file holds an observer of the same name with other arguments, or in a state of another
    convention. Warns of observers in the file that the run does not have.
    """
    known, states = h5.get(GROUP, {}), _states_in(h5)
    for one in observers:
        if one.name in known:
            if (was := json.loads(known[one.name].attrs["arguments"])) != json.loads(json.dumps(one.made_with())):
                holds = f"file {str(file)!r} holds the observer {one.name} with the arguments {was}"
                raise ValueError(f"{holds}; use the same arguments, or pass another name=")
            if not one.n_looks:
                one.restore(states.get(one.name, {}))
    if left := set(known) - {one.name for one in observers}:
        words = f"file {str(file)!r} holds {listed(sorted(left))}, which this run does not go on with"
        warnings.warn(f"{words}; to go on with them, pass observers=", stacklevel=outside_minimd())


def _states_in(h5: h5py.File) -> dict[str, dict[str, np.ndarray]]:
    """The state of each observer at the restart, by its name."""
    found: dict[str, dict[str, np.ndarray]] = {}
    for name, array in read_restart(h5).arrays.items() if len(h5.get(GROUP, {})) else ():
        if name.startswith(MARK):
            _, observer, key = name.split(".")
            found.setdefault(observer, {})[key] = array
    return found


def write_answers(h5: h5py.File, observers: Sequence[Accumulator]) -> None:
    """Write the results of the observers that have looked, in place of those in the file."""
    for one in observers:
        group = h5[f"{GROUP}/{one.name}"]
        for name in list(group):
            del group[name]
        if not one.n_looks:
            continue
        result = one.result()
        looks = {"n_looks": one.n_looks, "last_step": one.last_step}
        group.attrs.update({**looks, "units": result.scene.units, **result.numbers()})
        for name, series in result.columns().items():
            group[name.replace("/", "_")] = series  # HDF5 allows no slash in names, that of a species may contain one


def lack_results(h5: h5py.File, observers: Mapping[str, Accumulator]) -> bool:
    """Whether observers have looked since their results were written, as in a killed run.

    observers : as observers_of.
    """
    return any(one.n_looks > h5[f"{GROUP}/{name}"].attrs.get("n_looks", 0) for name, one in observers.items())


def observers_of(h5: h5py.File) -> dict[str, Accumulator]:
    """The observers in an open file, by name, in their state at the restart;
    new ones where the convention of the state is another."""
    states, found = _states_in(h5), {}
    for name, group in h5.get(GROUP, {}).items():
        arguments: dict[str, Any] = json.loads(group.attrs["arguments"])
        try:
            found[name] = KINDS[group.attrs["kind"]](**arguments)
            if found[name].can_restore(state := states.get(name, {})):
                found[name].restore(state)
        except MemoryError:
            raise ValueError(f"observer {name} asks for more memory than there is, by {shown(arguments)}") from None
    return found
