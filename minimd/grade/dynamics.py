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
from minimd.grade.ensembles import LAWS, EnsembleLaw, Facts
from minimd.grade.findings import Finding, Grade
from minimd.grade.scenes import Array, Frames, Make, Scene, ends_of, gas, joined, ring, run, started
from minimd.structure.checks import checked_choice, checked_count, checked_number

ENSEMBLES = {"NVE": "constant energy", "NVT": "constant temperature", "NPT": "constant temperature and pressure"}
RATE = 1e-3  # of false alarms, of all laws together
PRESSURES = "pressure_au", "pressure", "externalstress"  # options that give it; some take a stress, of the other sign
STEPS = {"NVE": 1000, "NVT": 4000, "NPT": 16000}  # of a run
EVERY, OF_PATHS = 5, 20  # steps between two frames; in a comparison of paths
COARSE = 4.0  # times the frequencies: for the error of a long time step
LEAST_ORDER, SAME, KEPT = 1.7, 1e-7, 1e-6  # of the error of the energy; of paths, of momentum, relative
ACTED, NEVER = 0.2, 1e-6  # of the energy, or the volume, is new at the end of a run, at least; if nothing acts

SCENES = {"NVE": ("ring",), "NVT": ("ring", "coarse ring"), "NPT": ("gas",)}
COLLAPSE = "; is the pressure positive, the kinetic part 2K/3V in it, and has the virial its sign?"
OF_ENERGY = "total momentum", "order of the energy's error", "energy is kept", "reversible"


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
    name = getattr(dynamics, "__name__", "dynamics")
    ensemble, asked = claimed(ensemble, temperature_K, pressure, options)
    heat = checked_number("temperature_K", 300.0 if temperature_K is None else temperature_K, "positive and finite")
    kt = units.kB * heat
    options |= {"temperature_K": temperature_K} if temperature_K is not None else {}
    options |= {"pressure": pressure} if pressure is not None else {}
    n_steps = checked_count("steps", STEPS[ensemble] if steps is None else steps, 8 * EVERY)
    n_runs = checked_count("runs", runs, 6)
    checked_count("seed", seed, 0)
    checked_number("timestep", timestep, "positive and finite")

    given = 0.0 if ensemble != "NPT" else checked_number("pressure", asked, "positive and finite")

    def scenes(is_still: bool) -> list[Scene]:
        made = {
            "ring": lambda: ring(kt, timestep, is_still),
            "coarse ring": lambda: ring(kt, timestep, is_still, COARSE),
            "gas": lambda: gas(kt, timestep, given, is_still),
        }
        return [made[one]() for one in SCENES[ensemble]]

    make, still = maker(dynamics, timestep, options), scenes(True)[0]
    try:
        is_still = keeps_momentum(make, still, kt)
        answers = [*of_paths(make, scenes(is_still)[0])]
    except Exception as error:  # whatever a class raises
        said = f"{type(error).__name__}: {error}"
        raise ValueError(f"{name} could not make {OF_PATHS} steps with {options}; {said}") from error
    halved = maker(dynamics, 0.5 * timestep, options)
    if ensemble == "NVE":
        answers += of_energy(make, halved, scenes(is_still)[0], n_steps, is_still, seed)
    else:
        used = scenes(is_still)
        rate = RATE / sum(len(LAWS[scene.name]) for scene in used)
        for scene in used:
            answers += of_scene(make, scene, is_still, kt, given, (n_runs, n_steps, seed), rate)
    failed = {finding.name: finding.value for finding, _ in answers if finding.passed is False}
    faults = [fault for finding, fault in answers if fault and not follows(finding.name, failed)]
    if hot := failed.get("ring: temperature"):
        faults += of_half_a_step(halved, scenes(is_still)[0], is_still, kt, hot, (n_runs // 3, n_steps, seed))
    momentum = "kept at zero" if is_still else "not conserved"
    remarks = [f"the total momentum is {momentum}: {'3N − 3' if is_still else '3N'} degrees of freedom move"]
    if seen := [100.0 * one.limit for one, _ in answers if one.name.endswith((": temperature", ": mean volume"))]:
        what = "temperature or mean volume" if given else "temperature"
        remarks += [f"a {what} wrong by {max(seen):.0f} % would have been seen; more runs= or steps= show smaller ones"]
    if temperature_K is None and "temperature_K" in inspect.signature(dynamics).parameters:
        remarks += [f"judged as {ensemble}{' at 300 K' * (ensemble != 'NVE')}, since no temperature_K is given"]
    told = f"{name}({', '.join(options)}): {ensemble}, {ENSEMBLES[ensemble]}"
    return Grade(told, tuple(finding for finding, _ in answers), tuple(faults), remarks=tuple(remarks))


def follows(name: str, failed: dict[str, float]) -> bool:
    """Whether a law fails because another one does."""
    scene, _, law = name.partition(": ")
    return (scene == "coarse ring" and f"ring: {law}" in failed) or (
        law == "temperature of positions" and f"{scene}: temperature" in failed
    )


def of_half_a_step(
    halved: Make, scene: Scene, is_still: bool, kt: float, heat: float, how: tuple[int, int, int]
) -> list[str]:
    """A wrong temperature that depends on the time step."""
    answers = of_scene(halved, scene, is_still, kt, 0.0, how, RATE)
    found = next((one.value for one, _ in answers if one.name == "ring: temperature"), heat)
    if 0.7 < found / heat < 1.4:
        return []
    said = f"with half the time step the temperature is {found:.3f}, not {heat:.3f} times what was asked for"
    return [f"{said}: the noise of a step must go as √Δt"]


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
    if ensemble == "NVE":
        return [*names, *OF_ENERGY]
    for scene in SCENES[ensemble]:
        names += [f"{scene}: constant volume"] * (ensemble == "NVT")
        names += [f"{scene}: the bath acts", *(f"{scene}: {law.name}" for law in LAWS[scene])]
    return names


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
    n = len(atoms)
    dynamics.run(OF_PATHS)
    if len(atoms) != n:
        raise ValueError(f"{n} atoms have become {len(atoms)}")
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
    """Momentum, order and drift of the energy, the way back."""
    fault = "" if is_still else "the total momentum changes, though nothing acts from outside"
    yield Finding(OF_ENERGY[0], is_still, "constant" if is_still else "changes"), fault
    with np.errstate(all="ignore"):
        whole, half = (
            np.array(
                [_energies(one, scene, seed + k, n) for k in tqdm(range(8), desc="NVE", leave=False, disable=None)]
            )
            for one, n in ((make, steps), (halved, 2 * steps))
        )
        order = float(np.log2(whole.std(axis=1).mean() / half.std(axis=1).mean()))
        slopes = np.polyfit(np.linspace(0.0, 1.0, steps), whole.T, 1)[0] / whole.std()
    mean, error = slopes.mean(), slopes.std(ddof=1) / np.sqrt(len(slopes))
    limit = stats.t.isf(0.5 * RATE, len(slopes) - 1) * error
    drifts = not abs(mean) < limit
    fault = f"the error of the energy goes as Δt^{order:.1f}, that of a method of second order as Δt²: "
    if drifts and not order > LEAST_ORDER:
        fault += "with a drift, a force at other positions than those reached, or friction"
    elif order > 0.5:
        fault += "are positions and velocities those of one time, and the force that at the new positions?"
    else:
        fault += "the force is not minus the gradient of the energy (is it capped?), or x and p do not have one mass"
    yield Finding(OF_ENERGY[1], order > LEAST_ORDER, f"Δt^{order:.2f}", order), "" if order > LEAST_ORDER else fault
    words = f"in {steps} steps {mean:+.1g} ± {error:.1g} of its spread"
    yield Finding(OF_ENERGY[2], not drifts, words, mean), f"the energy drifts: {words}" if drifts else ""
    atoms, dynamics = started(make, scene, seed)
    start = atoms.positions.copy()
    dynamics.run(100)
    atoms.set_momenta(-atoms.get_momenta())
    make(atoms, np.random.RandomState(0)).run(100)
    off = float(np.abs(atoms.positions - start).max() / np.ptp(start))
    back = f"a path does not lead back: with turned momenta 100 steps end {off:.1e} beside the start"
    yield Finding(OF_ENERGY[3], off < SAME, f"100 steps and back: {off:.1e}", off), "" if off < SAME else back


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
            fault = f"run {k} of {scene.name} fails: {type(error).__name__}: {error}" + COLLAPSE * bool(pressure)
            yield Finding(f"{scene.name} runs", False, fault), fault
            return
    facts = Facts(scene, kt, is_still, pressure, joined(frames))
    if not pressure:
        changes = bool(np.ptp(facts.seen.volumes) > 0.0)
        fault = "the volume changes: give pressure= to have it judged as NPT" * changes
        yield Finding(f"{scene.name}: constant volume", not changes, "it is not" if changes else "it is"), fault
    column, of = (1, "volume") if pressure else (0, "energy")
    ends = facts.seen.ends[:, :, column]
    acted = float(((ends[:, 1] - ends[:, 0]) ** 2).mean()) / max(2.0 * float(ends.var()), 1e-300)
    words, fault = f"{min(acted, 1.0):.0%} of the {of} is new after {steps} steps", ""
    if acted < NEVER:
        fault = f"{scene.name}: the {of} never changes: nothing acts on it"
    elif acted < ACTED:
        words += ": too little to judge; take a shorter time of the bath, or more steps="
    yield Finding(f"{scene.name}: the bath acts", False if fault else acted >= ACTED or None, words, acted), fault
    answers = [judged(law, frames, facts, rate) for law in LAWS[scene.name]]
    yield from sorted(answers, key=_rank)


def _rank(answer: tuple[Finding, str]) -> tuple[int, float]:
    """What is told first: noise that repeats, then the largest deviations; positions follow momenta."""
    finding, law = answer[0], answer[0].name.partition(": ")[2]
    return {"new noise": 0, "temperature of positions": 2}.get(law, 1), -abs(finding.value - 1.0) / finding.limit


def judged(law: EnsembleLaw, frames: list[Frames], facts: Facts, rate: float) -> tuple[Finding, str]:
    """A law, by the mean over the runs and its error."""
    values = np.array([np.atleast_1d(law.measure(one, facts)) for one in frames])
    means, errors = values.mean(axis=0), values.std(axis=0, ddof=1) / np.sqrt(len(values))
    limits = stats.t.isf(0.5 * rate / len(means), len(values) - 1) * errors + law.spare + facts.scene.error
    worst = int(np.argmax(np.abs(means - 1.0) / limits))
    passed = bool(abs(means[worst] - 1.0) < limits[worst])
    words = f"{law.words}: {means[worst]:.3f} ± {errors[worst]:.3f} (finds {limits[worst]:.1%})"
    fault = "" if passed else f"{facts.scene.name}: {law.cause(means, facts)}"
    return Finding(
        f"{facts.scene.name}: {law.name}", passed, words, float(means[worst]), limit=float(limits[worst])
    ), fault
