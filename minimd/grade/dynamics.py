"""Does a class of dynamics, as ASE has them, sample the ensemble that it claims?

Runs are independent and begin with an exact sample, so that their spread is the error of a mean. A law fails if the
mean is off by more than the error times a quantile of Student's t, chosen so that all laws together fail a right
dynamics in one of a thousand cases, and the error that any second-order splitting makes, (ωΔt)²/4.
"""

from __future__ import annotations

import inspect
from collections.abc import Iterator
from typing import Any

import numpy as np
from ase import Atoms, units
from scipy import stats
from tqdm import tqdm

from minimd.console.words import shown
from minimd.grade.ensembles import LAWS, Facts, Law
from minimd.grade.findings import Finding, Grade
from minimd.grade.scenes import Array, Frames, Make, Scene, ends_of, gas, joined, ring, run, started
from minimd.structure.checks import checked_choice, checked_count, checked_number

ENSEMBLES = {"NVE": "constant energy", "NVT": "constant temperature", "NPT": "constant temperature and pressure"}
RATE = 1e-3  # of false alarms, of all laws together
PRESSURES = "pressure_au", "pressure", "externalstress"  # options that give it; some take a stress, of the other sign
STEPS, EVERY, OF_PATHS = {"NVE": 1000, "NVT": 4000, "NPT": 8000}, 5, 20  # of a run; between two frames
COARSE = 4.0  # times the frequencies: for the error of a long time step
LEAST_ORDER, SAME, KEPT = 1.7, 1e-7, 1e-6  # of the error of the energy; of paths, of momentum, relative
ACTED = 0.2  # of the energy, or the volume, is new at the end of a run, at least

SCENES = {"NVE": (), "NVT": ("ring", "coarse ring"), "NPT": ("gas",)}
OF_ENERGY = "order of the energy's error", "energy is kept", "reversible", "total momentum"


def grade_dynamics(
    dynamics: Any,
    ensemble: str | None = None,
    timestep: float = units.fs,
    temperature_K: float | None = None,
    pressure: float | None = None,
    runs: int = 24,
    steps: int | None = None,
    seed: int = 0,
    **options: Any,
) -> Grade:
    """See grade."""
    name, (ensemble, asked) = (
        getattr(dynamics, "__name__", "dynamics"),
        claimed(ensemble, temperature_K, pressure, options),
    )
    kt = units.kB * checked_number("temperature_K", temperature_K or 300.0, "positive and finite")
    options |= {"temperature_K": temperature_K} if temperature_K is not None else {}
    options |= {"pressure": pressure} if pressure is not None else {}
    n_steps, n_runs = checked_count("steps", steps or STEPS[ensemble]), checked_count("runs", runs)
    checked_number("timestep", timestep, "positive and finite")

    def scenes(is_still: bool) -> list[Scene]:
        if ensemble == "NPT":
            return [gas(kt, timestep, checked_number("pressure", asked, "positive and finite"), is_still)]
        return [ring(kt, timestep, is_still), ring(kt, timestep, is_still, COARSE)][: 1 + (ensemble == "NVT")]

    make = maker(dynamics, timestep, options)
    try:
        is_still = keeps_momentum(make, scenes(True)[0], kt)
    except Exception as error:  # whatever a class raises
        said = f"{type(error).__name__}: {error}"
        raise ValueError(f"{name} could not make {OF_PATHS} steps with {options}; {said}") from error
    answers = [*of_paths(make, scenes(is_still)[0])]
    if ensemble == "NVE":
        halved = maker(dynamics, 0.5 * timestep, options)
        answers += of_energy(make, halved, scenes(is_still)[0], n_steps, is_still, seed)
    else:
        used = scenes(is_still)
        rate = RATE / sum(len(LAWS[scene.name]) for scene in used)
        for scene in used:
            answers += of_scene(make, scene, is_still, kt, asked or 0.0, (n_runs, n_steps, seed), rate)
    faults = tuple(fault for _, fault in answers if fault)
    momentum = "kept at zero" if is_still else "not conserved"
    remarks = (f"the total momentum is {momentum}: {'3N − 3' if is_still else '3N'} degrees of freedom move",)
    told = f"{name}({', '.join(options)}): {ensemble}, {ENSEMBLES[ensemble]}"
    return Grade(told, tuple(finding for finding, _ in answers), faults, remarks=remarks)


def claimed(
    ensemble: str | None, temperature_K: float | None, pressure: float | None, options: dict[str, Any]
) -> tuple[str, float | None]:
    """The ensemble, and the pressure [eV/Å³], that options claim."""
    stated = [float(np.ravel(options[name])[0]) for name in PRESSURES if options.get(name) is not None]
    asked = abs(stated[0]) if pressure is None and stated else pressure
    found = "NVE" if temperature_K is None else "NVT" if asked is None else "NPT"
    ensemble = checked_choice("ensemble", ensemble or found, ENSEMBLES)
    if ensemble == "NPT" and asked is None:
        raise ValueError("pressure must be given for NPT [eV/Å³], as pressure= or as an option of the class; got none")
    return ensemble, asked


def names_of(options: dict[str, Any]) -> list[str]:
    """The names of all findings of a grade with these options."""
    named = {name: options.get(name) for name in ("ensemble", "temperature_K", "pressure")}
    ensemble, _ = claimed(**named, options=options)
    names = ["repeatable", "restart"]
    for scene in SCENES[ensemble]:
        names += [f"{scene}: the bath acts", *(f"{scene}: {law.name}" for law in LAWS[scene])]
    return names + ([*OF_ENERGY] if ensemble == "NVE" else [])


def maker(dynamics: Any, timestep: float, options: dict[str, Any]) -> Make:
    """Makes the dynamics of atoms; options that a function does not take are claims only, a generator goes where one
    is taken."""
    parameters = inspect.signature(dynamics).parameters
    takes_all = any(one.kind is one.VAR_KEYWORD for one in parameters.values()) and inspect.isclass(dynamics)
    taken = {name: value for name, value in options.items() if takes_all or name in parameters}
    claims = {"temperature_K", "pressure"}
    if left := [name for name in options if name not in taken and name not in claims]:
        raise ValueError(f"{shown(dynamics)} takes {', '.join(parameters)}; got {', '.join(left)}")

    def make(atoms: Atoms, rng: np.random.RandomState) -> Any:
        return dynamics(atoms, timestep, **taken, **({"rng": rng} if "rng" in parameters else {}))

    return make


def keeps_momentum(make: Make, scene: Scene, kt: float) -> bool:
    """Whether a scene at rest stays at rest."""
    atoms, dynamics = started(make, scene, 0)
    dynamics.run(OF_PATHS)
    p = atoms.get_momenta()
    return bool(np.abs(p.sum(axis=0)).max() < KEPT * np.sqrt(kt * atoms.get_masses().sum()))


def of_paths(make: Make, scene: Scene) -> Iterator[tuple[Finding, str]]:
    """Whether numbers can be had again, and whether all that a step needs is in the atoms."""

    def path(*parts: int) -> Array:
        (atoms, _), state = started(make, scene, 1), np.random.RandomState(2)
        for n in parts:
            make(atoms, state).run(n)
        return atoms.positions

    once, again, parted = path(OF_PATHS), path(OF_PATHS), path(OF_PATHS // 2, OF_PATHS // 2)
    size = float(np.ptp(once))
    same, off = np.array_equal(once, again), float(np.abs(once - parted).max()) / size
    words = "the same seed gives the same numbers" if same else "the same seed gives other numbers: is rng used?"
    yield Finding("repeatable", same or None, words), ""
    words = f"a new object that goes on differs by {off:.1e}"
    told = words if off < SAME else f"{words}: not all that a step needs is in the atoms, or random numbers are new"
    yield Finding("restart", off < SAME or None, told, off), ""


def of_energy(
    make: Make, halved: Make, scene: Scene, steps: int, is_still: bool, seed: int
) -> Iterator[tuple[Finding, str]]:
    """Order and drift of the energy, the way back, momentum."""
    whole, half = (
        np.array([_energies(one, scene, seed + k, n) for k in tqdm(range(8), desc="NVE", leave=False, disable=None)])
        for one, n in ((make, steps), (halved, 2 * steps))
    )
    order = float(np.log2(whole.std(axis=1).mean() / half.std(axis=1).mean()))
    passed = order > LEAST_ORDER
    fault = (
        f"the error of the energy goes as Δt^{order:.2f}, that of a method of second order as Δt²: is the force the "
    )
    fault += "one at the new positions, and are positions and velocities those of one time?"
    yield Finding(OF_ENERGY[0], passed, f"Δt^{order:.2f}", order), "" if passed else fault
    slopes = np.polyfit(np.linspace(0.0, 1.0, steps), whole.T, 1)[0] / whole.std()
    mean, error = slopes.mean(), slopes.std(ddof=1) / np.sqrt(len(slopes))
    limit = stats.t.isf(0.5 * RATE, len(slopes) - 1) * error
    words = f"in {steps} steps {mean:+.1g} ± {error:.1g} of its oscillation"
    fault = "" if abs(mean) < limit else f"the energy drifts: {words}"
    yield Finding(OF_ENERGY[1], not fault, words, mean), fault
    atoms, dynamics = started(make, scene, seed)
    start = atoms.positions.copy()
    dynamics.run(100)
    atoms.set_momenta(-atoms.get_momenta())
    make(atoms, np.random.RandomState(0)).run(100)
    off = float(np.abs(atoms.positions - start).max() / np.ptp(start))
    fault = (
        "" if off < SAME else f"a path does not lead back: with turned momenta 100 steps end {off:.1e} beside the start"
    )
    yield Finding(OF_ENERGY[2], not fault, f"100 steps and back: {off:.1e}", off), fault
    fault = "" if is_still else "the total momentum changes, though nothing acts from outside"
    yield Finding(OF_ENERGY[3], is_still, "constant" if is_still else "changes"), fault


def _energies(make: Make, scene: Scene, seed: int, steps: int) -> Array:
    atoms, dynamics = started(make, scene, seed)
    found = np.empty(steps)
    for k in range(steps):
        dynamics.run(1)
        found[k] = ends_of(atoms)[0]
    return found


def of_scene(
    make: Make, scene: Scene, is_still: bool, kt: float, pressure: float, how: tuple[int, int, int], rate: float
) -> Iterator[tuple[Finding, str]]:
    """All laws of a scene.  how : runs, steps, seed.  rate : of false alarms, of each law."""
    n_runs, steps, seed = how
    frames = list[Frames]()
    for k in tqdm(range(n_runs), desc=scene.name, leave=False, disable=None):
        try:
            with np.errstate(all="ignore"):
                frames.append(run(make, scene, seed + k, steps, EVERY, kt))
        except Exception as error:  # whatever a class raises
            fault = f"run {k} of {scene.name} fails: {type(error).__name__}: {error}"
            yield Finding(f"{scene.name} runs", False, fault), fault
            return
    facts = Facts(scene, kt, is_still, pressure, joined(frames))
    column, of = (1, "volume") if pressure else (0, "energy")
    ends = facts.seen.ends[:, :, column]
    acted = float(((ends[:, 1] - ends[:, 0]) ** 2).mean()) / max(2.0 * float(ends.var()), 1e-300)
    words = f"{min(acted, 1.0):.0%} of the {of} is new after {steps} steps"
    if acted < ACTED:
        words += ": too little to judge; take a shorter time of the bath, or more steps="
    yield Finding(f"{scene.name}: the bath acts", True if acted >= ACTED else None, words, acted), ""
    for law in LAWS[scene.name]:
        yield judged(law, frames, facts, rate)


def judged(law: Law, frames: list[Frames], facts: Facts, rate: float) -> tuple[Finding, str]:
    """A law, by the mean over the runs and its error."""
    values = np.array([np.atleast_1d(law.measure(one, facts)) for one in frames])
    means, errors = values.mean(axis=0), values.std(axis=0, ddof=1) / np.sqrt(len(values))
    limits = stats.t.isf(0.5 * rate / len(means), len(values) - 1) * errors + law.spare + facts.scene.error
    worst = int(np.argmax(np.abs(means - 1.0) / limits))
    passed = bool(abs(means[worst] - 1.0) < limits[worst])
    words = f"{law.words}: {means[worst]:.3f} ± {errors[worst]:.3f} (finds {limits[worst]:.1%})"
    fault = "" if passed else f"{facts.scene.name}: {law.cause(means, facts)}"
    return Finding(f"{facts.scene.name}: {law.name}", passed, words, float(means[worst]), float(limits[worst])), fault
