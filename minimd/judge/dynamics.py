"""Does a class of dynamics, as ASE has them, sample the ensemble that it claims?

Runs are independent and begin with an exact sample, so that their spread is the error of a mean. A law fails if the
mean is off by more than the error times a quantile of Student's t, chosen so that all laws together fail a right
dynamics in one of a thousand cases, and the error that a right splitting may make, (ωΔt)²/2.
"""

from __future__ import annotations

from dataclasses import replace
from functools import cached_property
from inspect import Parameter, signature
from typing import Any, NamedTuple

import numpy as np
from ase import Atoms, units
from numpy.random import RandomState
from scipy import stats
from tqdm import tqdm

from minimd.core.console.words import shown
from minimd.core.structure.arrays import Array
from minimd.core.structure.checks import checked_choice, checked_count, checked_flag, checked_number
from minimd.judge import ensembles
from minimd.judge.findings import Answer, Finding, Grade, Law, Measurement, causes, judged, needed
from minimd.judge.problems import largest
from minimd.judge.scenes import SCENES, SOFT, Frames, Make, ends_of, run, started

ENSEMBLES = {
    "NVE": "constant energy",
    "NVT": "constant temperature",
    "NPT": "constant temperature and pressure",
}
RATE = 1e-3  # of false alarms, of all laws together
PRESSURES = ("pressure_au", "pressure", "externalstress")  # some take a stress, of the other sign
STEPS = {"NVE": 1000, "NVT": 4000, "NPT": 10000}  # of a run
RUNS = {"NVE": 8, "NVT": 24, "NPT": 40}
AGAIN = 3  # times the runs if a law nearly fails
NEARLY = 0.65  # of its limit
EVERY = 5  # steps between two frames
OF_PATHS = 20  # steps in a comparison of paths
LEAST_ORDER = 1.7  # of the error of the energy
SAME = 1e-7  # of paths, relative
KEPT = 1e-6  # of momentum, relative
USED = {"NVE": ("ring",), "NVT": ("ring", "coarse ring"), "NPT": ("gas",)}
RANKS = {"new noise": 1, "independent directions": 1, "temperature of positions": 3}
COLLAPSE = (
    "; check that the pressure is positive, contains 2K/3V, and has the virial with the right sign"
)


class Claims(NamedTuple):
    """What a dynamics claims, and how it is judged.

    scenes : their names, the first for paths.
    """

    ensemble: str
    kt: float
    pressure: float
    timestep: float
    runs: int
    steps: int
    seed: int
    scenes: tuple[str, ...]

    def scene(self, name: str, is_still: bool) -> Any:
        """A scene with these claims."""
        return SCENES[name](self.kt, self.timestep, self.pressure, is_still)

    def has(self, dynamics: Any) -> set[str]:
        """What laws of paths may need."""
        has = {self.ensemble}
        if hasattr(dynamics, "get_conserved_energy") and self.ensemble != "NVE":
            has.add("conserved")
        if self.scenes[0] == "chain":
            has.add("rigid")
        return has

    def laws(self) -> list[str]:
        """The names of the laws of all scenes, each with its scene; none for NVE."""
        names = list[str]()
        if self.ensemble != "NVE":
            for name in self.scenes:
                has = {*self.scene(name, True).has.split()}
                names += [f"{name}: {law.name}" for law in needed(ensembles.LAWS, has)]
        return names


class Motion:
    """A dynamics in a scene, and what is measured on single paths: see Law.measure.

    halved : makes it with half the time step.
    has : see Claims.
    """

    def __init__(self, make: Make, halved: Make, claims: Claims) -> None:
        self.make = make
        self.halved = halved
        self.claims = claims
        self.scene = claims.scene(claims.scenes[0], True)
        atoms, dynamics = started(make, self.scene, 0)
        n = len(atoms)

        self.heat = np.sqrt(claims.kt * atoms.get_masses().sum())  # a momentum
        is_nve = claims.ensemble == "NVE"
        n_parts = 1 if is_nve else claims.steps // OF_PATHS  # rare draws of momenta are seen
        for _ in range(n_parts):
            dynamics.run(OF_PATHS)
            if len(atoms) != n:
                raise ValueError(
                    f"the dynamics changed the number of atoms from {n} to {len(atoms)}"
                )
            p = atoms.get_momenta().sum(axis=0)
            self.change = largest(p) / self.heat
            self.is_still = self.change < KEPT  # whether a scene at rest stays at rest
            if not self.is_still:
                break
        self.scene = claims.scene(claims.scenes[0], self.is_still and not is_nve)
        self.has = claims.has(dynamics)

    def path(self, *parts: int) -> Array:
        """Positions after some steps, of which each part is made by a new object."""
        atoms, _ = started(self.make, self.scene, 1)
        state = RandomState(2)
        for n in parts:
            self.make(atoms, state).run(n)
        return atoms.positions

    def again(self) -> Measurement:
        """Whether numbers can be had again."""
        if np.array_equal(self.path(OF_PATHS), self.path(OF_PATHS)):
            return Measurement(0.0, 0.0, "the same")
        return Measurement(0.0, np.nan, "other numbers: take noise from rng")

    def restart(self) -> Measurement:
        """Whether all that a step needs is in the atoms."""
        once = self.path(OF_PATHS)
        parted = self.path(OF_PATHS // 2, OF_PATHS // 2)
        off = largest(once - parted) / np.ptp(once)
        cause = ""
        if off >= SAME:
            cause = ": it keeps variables, or random numbers, that are not in the atoms; the samples may still be right"
        return Measurement(off, 0.0 if off < SAME else np.nan, cause)

    def center(self) -> Answer:
        """The way of the center of mass over P t/M; open if the momentum is taken away."""
        atoms, dynamics = started(self.make, self.scene, 0)
        start = atoms.get_center_of_mass()
        p = atoms.get_momenta().sum(axis=0)
        dynamics.run(OF_PATHS)
        right = p * OF_PATHS * self.claims.timestep / atoms.get_masses().sum()
        moved = atoms.get_center_of_mass() - start
        way = moved @ right / (right @ right)
        p = atoms.get_momenta().sum(axis=0)
        is_taken = largest(p) < KEPT * self.heat
        return way, np.nan if is_taken else way - 1.0

    @cached_property
    def energies(self) -> list[Array]:
        """The energies that should be constant, (runs, steps), with the time step and with half of it."""

        def path(make: Make, seed: int, steps: int) -> Array:
            atoms, dynamics = started(make, self.scene, seed)
            energy = getattr(dynamics, "get_conserved_energy", lambda: ends_of(atoms)[0])
            values = np.empty(steps)
            for k in range(steps):
                dynamics.run(1)
                values[k] = energy()
            return values

        n = self.claims.steps
        runs = self.claims.runs
        seed = self.claims.seed
        if self.claims.ensemble != "NVE":
            n = min(n, STEPS["NVE"])
            runs = min(runs, RUNS["NVE"])
        whole = []
        half = []
        for k in tqdm(range(seed, seed + runs), desc="energy", leave=False, disable=None):
            whole.append(path(self.make, k, n))
            half.append(path(self.halved, k, 2 * n))
        return [np.array(whole), np.array(half)]

    def drift(self) -> Answer:
        """The mean slope of the energy, in its spread a run, over what passes."""
        whole = self.energies[0]
        runs, steps = whole.shape
        times = np.linspace(0.0, 1.0, steps)
        slopes = np.polyfit(times, whole.T, 1)[0] / whole.std()
        slope = slopes.mean()
        error = slopes.std(ddof=1) / np.sqrt(runs)
        quantile = stats.t.isf(0.5 * RATE, runs - 1)
        off = slope / (quantile * error)
        return slope, off if np.isfinite(off) else np.inf, error, steps

    def order(self) -> Measurement:
        """The order of the error of the energy."""
        whole, half = self.energies
        error = whole.std(axis=1).mean()
        error_of_half = half.std(axis=1).mean()
        order = np.log2(error / error_of_half)
        if not np.isfinite(order):
            return Measurement(0.0, 1.0, "the energy grows without bound")
        is_right = order > LEAST_ORDER
        if not is_right and not abs(self.drift()[1]) < 1.0:
            cause = "look for friction, or for a force at other positions than the new ones"
        elif order > 0.5:
            cause = "do positions and velocities belong to one time, and the force to the new positions?"
        else:
            cause = (
                "the force is not minus the gradient of the energy (is the force capped?), or x and p use two "
                "masses"
            )
        return Measurement(order, 0.0 if is_right else 1.0, cause)

    def softness(self) -> float:
        """How far rigid bonds are off."""
        claims = self.claims
        seen = run(self.make, self.scene, claims.seed, 2 * OF_PATHS, 1, claims.kt)
        return self.scene.calculator.softness(seen)

    def reversal(self) -> Answer:
        """The distance from the start after steps forwards and as many back, over the size of the scene."""
        atoms, dynamics = started(self.make, self.scene, self.claims.seed)
        start = atoms.positions.copy()
        dynamics.run(100)
        atoms.set_momenta(-atoms.get_momenta())
        self.make(atoms, RandomState(0)).run(100)
        off = largest(atoms.positions - start) / np.ptp(start)
        return off, off if np.isfinite(off) else np.inf


ORDER = "the error of the energy goes as Δt^{0:.1f}, that of a method of second order as Δt²: {2}"
LAWS = (  # of paths
    Law("repeatable", Motion.again, 0.5, "the same seed gives {2}"),
    Law("restart", Motion.restart, 0.5, "a run that a new object continues differs by {0:.1e}{2}"),
    Law(
        "total momentum",
        lambda motion: motion.change,
        KEPT,
        "changes by {0:.1e} of a thermal momentum",
        "the total momentum changes, though nothing acts from outside",
        "NVE",
    ),
    Law(
        "center of mass",
        Motion.center,
        1e-4,
        "moves by {0:.6g} P t/M",
        "the center of mass moves by {0:.6g} times its velocity times the time: do positions move for the whole time "
        "step?",
        "NVE",
    ),
    Law("order of the energy's error", Motion.order, 0.5, "Δt^{0:.2f}", ORDER, "NVE"),
    Law(
        "energy is kept",
        Motion.drift,
        1.0,
        "drift in {3} steps {0:+.1g} ± {2:.1g} of its spread",
        "the energy drifts by {0:+.1g} ± {2:.1g} of its spread in {3} steps",
        "NVE",
    ),
    Law(
        "reversible",
        Motion.reversal,
        SAME,
        "100 steps and back: {0:.1e}",
        "100 steps with reversed momenta do not lead back: the end is {0:.1e} from the start",
        "NVE",
    ),
    Law("rigid bonds", Motion.softness, SOFT, ensembles.BONDS, ensembles.BONDS_FAULT, "NVE rigid"),
    Law(
        "order of the conserved energy's error", Motion.order, 0.5, "Δt^{0:.2f}", ORDER, "conserved"
    ),
)


def grade_dynamics(dynamics: Any, options: dict[str, Any]) -> Grade:
    """The grade of a class of dynamics, see grade."""
    claims = claimed(options)
    name = getattr(dynamics, "__name__", "dynamics")
    ensemble = claims.ensemble
    make = maker(dynamics, claims.timestep, options)
    halved = maker(dynamics, 0.5 * claims.timestep, options)
    try:
        motion = Motion(make, halved, claims)
        with np.errstate(all="ignore"):
            findings = judged(LAWS, motion)
    except Exception as error:  # whatever a class raises
        bonds = ""
        if "chain" in claims.scenes:
            bonds = f"; the atoms have rigid bonds: does {name} support constraints?"
        raise ValueError(
            f"{name} failed with {options}: {type(error).__name__}: {error}{bonds}"
        ) from error

    is_still = motion.is_still
    names = claims.laws()
    if names:
        rate = RATE / len(names)
        for scene in claims.scenes:
            findings += of_scene(make, claims, scene, is_still, rate)
    failed = {law.name: law.value for law in findings if law.passed is False}
    faults = causes(law for law in findings if not follows(law.name, failed))
    heat = failed.get("ring: temperature")
    if heat is not None:
        faults += of_half_a_step(halved, claims, is_still, heat)

    momentum = "kept at zero: 3N − 3" if is_still else "not conserved: 3N"
    remarks = [f"the total momentum is {momentum} degrees of freedom move"]
    means = [law for law in findings if law.name.endswith((": temperature", ": mean volume"))]
    if means:
        coarsest = max(means, key=lambda law: law.limit)
        scene = coarsest.name.partition(":")[0]
        quantity = "temperature or mean volume" if claims.pressure else "temperature"
        remarks.append(
            f"the least precise scene, {scene!r}, finds a {quantity} that is wrong by {100.0 * coarsest.limit:.0f} %; "
            "more runs= or steps= find smaller errors"
        )
    if "temperature_K" not in options and "temperature_K" in signature(dynamics).parameters:
        at_heat = "" if ensemble == "NVE" else " at 300 K"
        remarks.append(f"judged as {ensemble}{at_heat}, since no temperature_K is given")
    call_text = f"{name}({', '.join(options)}): {ensemble}, {ENSEMBLES[ensemble]}"
    return Grade(call_text, tuple(findings), tuple(faults), remarks=tuple(remarks))


def follows(name: str, failed: dict[str, float]) -> bool:
    """Whether a law fails because another one does."""
    scene, _, law = name.partition(": ")
    if scene in ("coarse ring", "chain") and f"ring: {law}" in failed:
        return True
    return law == "temperature of positions" and f"{scene}: temperature" in failed


def of_half_a_step(halved: Make, claims: Claims, is_still: bool, heat: float) -> list[str]:
    """A wrong temperature that depends on the time step."""
    fewer = claims._replace(runs=max(2, claims.runs // 3))
    findings = of_scene(halved, fewer, "ring", is_still, RATE)
    new = next((law.value for law in findings if law.name == "ring: temperature"), heat)
    if 0.7 < new / heat < 1.4:
        return []
    return [
        f"with half the time step the temperature is {new:.3f}, not {heat:.3f} times what was asked for: the noise of "
        "a step must be proportional to √Δt"
    ]


def claimed(options: dict[str, Any]) -> Claims:
    """What the options claim; those that are not for the dynamics are taken out."""

    def taken(name: str, default: Any) -> Any:
        value = options.pop(name, None)
        return default if value is None else value

    ensemble = taken("ensemble", "")
    has_bonds = checked_flag("constraints", options.pop("constraints", False))
    has_liquids = checked_flag("liquids", options.pop("liquids", False))
    pressures = list[float]()
    for name in PRESSURES:
        value = options.get(name)
        if value is not None:
            first = [*np.ravel(value).tolist(), value][0]  # of a tensor, or what is none
            pressures.append(checked_number(name, first))

    temperature = options.get("temperature_K")
    if not ensemble:
        ensemble = "NPT" if pressures else "NVT"
        if temperature is None:
            ensemble = "NVE"
    checked_choice("ensemble", ensemble, ENSEMBLES)
    if ensemble == "NPT" and not pressures:
        raise ValueError(
            "pressure must be given for NPT [eV/Å³], as pressure= or as an option of the class; got none"
        )
    if (has_bonds and ensemble == "NPT") or (has_liquids and ensemble == "NVE"):
        raise ValueError(
            f"constraints are judged for NVE and NVT, liquids for NVT and NPT; got {ensemble}"
        )

    scenes = USED[ensemble]
    if has_bonds:
        scenes = ("chain",) if ensemble == "NVE" else (*scenes, "chain")
    if has_liquids:
        scenes += ("liquid 1", "liquid 2")

    if temperature is None:
        temperature = 300.0
    kt = units.kB * checked_number("temperature_K", temperature, "positive and finite")
    pressure = 0.0
    if ensemble == "NPT":
        pressure = checked_number("pressure", abs(pressures[0]), "positive and finite")
    timestep = checked_number("timestep", taken("timestep", units.fs), "positive and finite")
    runs = checked_count("runs", taken("runs", RUNS[ensemble]), 6)
    steps = checked_count("steps", taken("steps", STEPS[ensemble]), 8 * EVERY)
    # runs count from the seed, and NumPy takes 32 bits
    seed = checked_count("seed", taken("seed", 0), 0, 2**31)
    return Claims(ensemble, kt, pressure, timestep, runs, steps, seed, scenes)


def names_of(dynamics: Any, options: dict[str, Any]) -> list[str]:
    """The names of the laws by which a class is judged with these options."""
    claims = claimed({**options})
    names = [law.name for law in needed(LAWS, claims.has(dynamics))]
    return names + claims.laws()


def maker(dynamics: Any, timestep: float, options: dict[str, Any]) -> Make:
    """Makes the dynamics of atoms. Options that a function does not take are claims only; one that takes any name gets
    all. A generator goes where one is taken. Atoms and time step are passed in this order, or by their names if only
    these are taken.

    Raises TypeError if neither can be passed, and ValueError for options that are not taken.
    """
    parameters = signature(dynamics).parameters
    kinds = [parameter.kind for parameter in parameters.values()]
    has_any_name = Parameter.VAR_KEYWORD in kinds
    n_places = kinds.count(Parameter.POSITIONAL_ONLY)
    n_places += kinds.count(Parameter.POSITIONAL_OR_KEYWORD)
    is_in_order = Parameter.VAR_POSITIONAL in kinds or n_places > 1
    if not (is_in_order or has_any_name or {"atoms", "timestep"} <= parameters.keys()):
        name = getattr(dynamics, "__name__", "dynamics")
        raise TypeError(
            f"dynamics are called as {name}(atoms, timestep, …), with options by their names; {name} takes "
            f"({', '.join(parameters)})"
        )

    taken = {name: value for name, value in options.items() if has_any_name or name in parameters}
    left = [name for name in options if name not in (*taken, "temperature_K", "pressure")]
    if left:
        raise ValueError(f"{shown(dynamics)} takes {', '.join(parameters)}; got {', '.join(left)}")

    def make(atoms: Atoms, rng: RandomState) -> Any:
        noise = {"rng": rng} if "rng" in parameters else {}
        if is_in_order:
            return dynamics(atoms, timestep, **taken, **noise)
        return dynamics(atoms=atoms, timestep=timestep, **taken, **noise)

    return make


def of_scene(make: Make, claims: Claims, name: str, is_still: bool, rate: float) -> list[Finding]:
    """The findings of a scene: those without a number to judge, then the largest deviations; positions follow momenta,
    and noise that repeats explains the rest.

    rate : of false alarms, of each law.
    """
    scene = claims.scene(name, is_still)
    frames = list[Frames]()
    steps = claims.steps // scene.slowness
    for n in (claims.runs, AGAIN * claims.runs):
        for k in tqdm(range(len(frames), n), desc=name, leave=False, disable=None):
            try:
                with np.errstate(all="ignore"):
                    frames.append(run(make, scene, claims.seed + k, steps, EVERY, claims.kt))
            except Exception as error:  # whatever a class raises
                fault = f"run {k} of {name} fails: {type(error).__name__}: {error}"
                if claims.pressure:
                    fault += COLLAPSE
                return [Finding(f"{name} runs", False, fault, cause=fault)]
        seen = ensembles.Seen(scene, frames, is_still, claims.pressure, 0.5 * rate)
        findings = judged(ensembles.LAWS, seen)
        if not any(NEARLY < deviation(law) < 1.0 for law in findings):
            break

    def rank(law: Finding) -> tuple[int, float]:
        off = deviation(law)
        return RANKS.get(law.name, 2) if off else 0, -off

    findings.sort(key=rank)
    return [
        replace(law, name=f"{name}: {law.name}", cause=f"{name}: {law.cause}") for law in findings
    ]


def deviation(law: Finding) -> float:
    """How far a number is off, over what passes; 0 if it has no limit."""
    return 0.0 if np.isnan(law.limit) else abs(law.value - 1.0) / law.limit
