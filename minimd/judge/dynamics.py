"""Does a class of dynamics, as ASE has them, sample the ensemble that it claims?

Runs are independent and begin with an exact sample, so that their spread is the error of a mean. A law fails if the
mean is off by more than the error times a quantile of Student's t, chosen so that all laws together fail a right
dynamics in one of a thousand cases, and the error that a right splitting may make, (ωΔt)²/2.
"""

from __future__ import annotations

import inspect
from dataclasses import replace
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np
from ase import Atoms, units
from scipy import stats
from tqdm import tqdm

from minimd.core.console.words import shown
from minimd.core.structure.checks import checked_choice, checked_count, checked_flag, checked_number
from minimd.judge import ensembles
from minimd.judge.findings import Finding, Grade, Law, Measurement, causes, judged
from minimd.judge.scenes import SCENES, SOFT, Array, Frames, Make, ends_of, run, started

ENSEMBLES = {
    "NVE": "constant energy",
    "NVT": "constant temperature",
    "NPT": "constant temperature and pressure",
}
RATE = 1e-3  # of false alarms, of all laws together
# options that give it; some take a stress, of the other sign
PRESSURES = "pressure_au", "pressure", "externalstress"
STEPS = {"NVE": 1000, "NVT": 4000, "NPT": 10000}  # of a run
RUNS = {"NVE": 8, "NVT": 24, "NPT": 40}
AGAIN, NEARLY = 3, 0.65  # times the runs if a law nearly fails; of its limit
EVERY, OF_PATHS = 5, 20  # steps between two frames; in a comparison of paths
# of the error of the energy; of paths, of momentum, relative
LEAST_ORDER = 1.7
SAME = 1e-7
KEPT = 1e-6
USED = {"NVE": ("ring",), "NVT": ("ring", "coarse ring"), "NPT": ("gas",)}
COLLAPSE = (
    "; check that the pressure is positive, contains 2K/3V, and has the virial with the right sign"
)


class Claims(NamedTuple):
    """What a dynamics claims, and how it is judged.  scenes : their names, the first for paths."""

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
        # there all energy is
        offers = hasattr(dynamics, "get_conserved_energy") and self.ensemble != "NVE"
        is_rigid = self.scenes[0] == "chain"
        return {self.ensemble, *["conserved"] * offers, *["rigid"] * is_rigid}

    def laws(self) -> list[tuple[str, list[str]]]:
        """The names of the laws of each scene."""
        have = {
            name: {*self.scene(name, True).has.split()}
            for name in self.scenes * (self.ensemble != "NVE")
        }
        return [
            (name, [law.name for law in ensembles.LAWS if {*law.needs.split()} <= has])
            for name, has in have.items()
        ]


class Motion:
    """A dynamics in a scene, and what is measured on single paths: see Law.measure.

    halved : makes it with half the time step.  has : see Claims.
    """

    def __init__(self, make: Make, halved: Make, claims: Claims) -> None:
        self.make = make
        self.halved = halved
        self.claims = claims
        self.scene = claims.scene(claims.scenes[0], True)
        atoms, dynamics = started(make, self.scene, 0)
        n = len(atoms)
        self.heat = np.sqrt(claims.kt * atoms.get_masses().sum())  # a momentum
        # rare draws of momenta are seen
        for _ in range(1 if claims.ensemble == "NVE" else claims.steps // OF_PATHS):
            dynamics.run(OF_PATHS)
            if len(atoms) != n:
                raise ValueError(
                    f"the dynamics changed the number of atoms from {n} to {len(atoms)}"
                )
            self.change = float(np.abs(atoms.get_momenta().sum(axis=0)).max() / self.heat)
            self.is_still = self.change < KEPT  # whether a scene at rest stays at rest
            if not self.is_still:
                break
        self.scene = claims.scene(claims.scenes[0], self.is_still and claims.ensemble != "NVE")
        self.has = claims.has(dynamics)

    def path(self, *parts: int) -> Array:
        """Positions after some steps, of which each part is made by a new object."""
        atoms, _ = started(self.make, self.scene, 1)
        state = np.random.RandomState(2)
        for n in parts:
            self.make(atoms, state).run(n)
        return atoms.positions

    def again(self) -> Measurement:
        """Whether numbers can be had again."""
        same = np.array_equal(self.path(OF_PATHS), self.path(OF_PATHS))
        return (
            Measurement(0.0, 0.0, "the same")
            if same
            else Measurement(0.0, np.nan, "other numbers: take noise from rng")
        )

    def restart(self) -> Measurement:
        """Whether all that a step needs is in the atoms."""
        once = self.path(OF_PATHS)
        parted = self.path(OF_PATHS // 2, OF_PATHS // 2)
        off = float(np.abs(once - parted).max() / np.ptp(once))
        kept = ": a step needs more than the atoms hold, or random numbers differ" * (off >= SAME)
        return Measurement(off, 0.0 if off < SAME else np.nan, kept)

    def center(self) -> tuple[float, float]:
        """The way of the center of mass over P t/M; open if the momentum is taken away."""
        atoms, dynamics = started(self.make, self.scene, 0)
        start = atoms.get_center_of_mass()
        p = atoms.get_momenta().sum(axis=0)
        dynamics.run(OF_PATHS)
        right = p * OF_PATHS * self.claims.timestep / atoms.get_masses().sum()
        way = float((atoms.get_center_of_mass() - start) @ right / (right @ right))
        is_taken = np.abs(atoms.get_momenta().sum(axis=0)).max() < KEPT * self.heat
        return way, np.nan if is_taken else way - 1.0

    @cached_property
    def energies(self) -> list[Array]:
        """The energies that should be constant, (runs, steps), with the time step and with half of it."""

        def one(make: Make, seed: int, steps: int) -> Array:
            atoms, dynamics = started(make, self.scene, seed)
            energy = getattr(dynamics, "get_conserved_energy", lambda: ends_of(atoms)[0])
            found = np.empty(steps)
            for k in range(steps):
                dynamics.run(1)
                found[k] = energy()
            return found

        n = self.claims.steps
        runs = self.claims.runs
        seed = self.claims.seed
        if self.claims.ensemble != "NVE":
            n = min(n, STEPS["NVE"])
            runs = min(runs, RUNS["NVE"])
        bar = tqdm(range(seed, seed + runs), desc="energy", leave=False, disable=None)
        pairs = [(one(self.make, k, n), one(self.halved, k, 2 * n)) for k in bar]
        return [np.array(energies) for energies in zip(*pairs, strict=True)]

    def drift(self) -> tuple[float, float, float, int]:
        """The mean slope of the energy, in its spread a run, over what passes."""
        whole = self.energies[0]
        slopes = np.polyfit(np.linspace(0.0, 1.0, whole.shape[1]), whole.T, 1)[0] / whole.std()
        error = slopes.std(ddof=1) / np.sqrt(len(slopes))
        off = slopes.mean() / (stats.t.isf(0.5 * RATE, len(slopes) - 1) * error)
        return (
            float(slopes.mean()),
            float(off) if np.isfinite(off) else np.inf,
            float(error),
            whole.shape[1],
        )

    def order(self) -> Measurement:
        """The order of the error of the energy."""
        whole, half = self.energies
        order = float(np.log2(whole.std(axis=1).mean() / half.std(axis=1).mean()))
        if not np.isfinite(order):
            return Measurement(0.0, 1.0, "the energy grows without bound")
        if not order > LEAST_ORDER and not abs(self.drift()[1]) < 1.0:
            said = "look for friction, or for a force at other positions than the new ones"
        elif order > 0.5:
            said = "do positions and velocities belong to one time, and the force to the new positions?"
        else:
            said = "the force is not minus the gradient of the energy (is the force capped?), or x and p use two masses"
        return Measurement(order, 0.0 if order > LEAST_ORDER else 1.0, said)

    def softness(self) -> float:
        """How far rigid bonds are off."""
        seen = run(self.make, self.scene, self.claims.seed, 2 * OF_PATHS, 1, self.claims.kt)
        return float(self.scene.calculator.softness(seen))

    def reversal(self) -> tuple[float, float]:
        """The distance from the start after steps forwards and as many back, over the size of the scene."""
        atoms, dynamics = started(self.make, self.scene, self.claims.seed)
        start = atoms.positions.copy()
        dynamics.run(100)
        atoms.set_momenta(-atoms.get_momenta())
        self.make(atoms, np.random.RandomState(0)).run(100)
        off = float(np.abs(atoms.positions - start).max() / np.ptp(start))
        return off, off if np.isfinite(off) else np.inf


# fmt: off
ORDER = "the error of the energy goes as Δt^{0:.1f}, that of a method of second order as Δt²: {2}"
LAWS = (  # of paths
    Law("repeatable", Motion.again, 0.5, "the same seed gives {2}"),
    Law("restart", Motion.restart, 0.5, "a run that a new object continues differs by {0:.1e}{2}"),
    Law("total momentum", lambda s: s.change, KEPT, "changes by {0:.1e} of a thermal momentum",
        "the total momentum changes, though nothing acts from outside", "NVE"),
    Law("center of mass", Motion.center, 1e-4, "moves by {0:.6g} P t/M", "the center of mass moves by {0:.6g} times "
        "its velocity times the time: do positions move for the whole time step?", "NVE"),
    Law("order of the energy's error", Motion.order, 0.5, "Δt^{0:.2f}", ORDER, "NVE"),
    Law("energy is kept", Motion.drift, 1.0, "drift in {3} steps {0:+.1g} ± {2:.1g} of its spread",
        "the energy drifts by {0:+.1g} ± {2:.1g} of its spread in {3} steps", "NVE"),
    Law("reversible", Motion.reversal, SAME, "100 steps and back: {0:.1e}",
        "100 steps with reversed momenta do not lead back: the end is {0:.1e} from the start", "NVE"),
    Law("rigid bonds", Motion.softness, SOFT, ensembles.BONDS, ensembles.BONDS_FAULT, "NVE rigid"),
    Law("order of the conserved energy's error", Motion.order, 0.5, "Δt^{0:.2f}", ORDER, "conserved"),
)
# fmt: on


def grade_dynamics(dynamics: Any, options: dict[str, Any]) -> Grade:
    """See grade."""
    claims = claimed(options)
    name = getattr(dynamics, "__name__", "dynamics")
    ensemble = claims.ensemble
    make, halved = (maker(dynamics, part * claims.timestep, options) for part in (1.0, 0.5))
    try:
        motion = Motion(make, halved, claims)
        with np.errstate(all="ignore"):
            findings = judged(LAWS, motion)
    except Exception as error:  # whatever a class raises
        hint = f"; the atoms have rigid bonds: does {name} support constraints?" * (
            "chain" in claims.scenes
        )
        raise ValueError(
            f"{name} failed with {options}: {type(error).__name__}: {error}{hint}"
        ) from error
    is_still = motion.is_still
    laws = claims.laws()
    rate = RATE / max(1, sum(len(names) for _, names in laws))
    findings += [one for scene, _ in laws for one in of_scene(make, claims, scene, is_still, rate)]
    failed = {one.name: one.value for one in findings if one.passed is False}
    faults = causes(one for one in findings if not follows(one.name, failed))
    if "ring: temperature" in failed:
        faults += of_half_a_step(halved, claims, is_still, failed["ring: temperature"])
    momentum = "kept at zero" if is_still else "not conserved"
    remarks = [
        f"the total momentum is {momentum}: {'3N − 3' if is_still else '3N'} degrees of freedom move"
    ]
    means = [one for one in findings if one.name.endswith((": temperature", ": mean volume"))]
    if means:
        what = "temperature or mean volume" if claims.pressure else "temperature"
        coarsest = max(means, key=lambda one: one.limit)
        seen = f"{coarsest.name.partition(':')[0]!r}, finds a {what} that is wrong by {100.0 * coarsest.limit:.0f} %"
        remarks += [f"the least precise scene, {seen}; more runs= or steps= find smaller errors"]
    if "temperature_K" not in options and "temperature_K" in inspect.signature(dynamics).parameters:
        remarks += [
            f"judged as {ensemble}{' at 300 K' * (ensemble != 'NVE')}, since no temperature_K is given"
        ]
    told = f"{name}({', '.join(options)}): {ensemble}, {ENSEMBLES[ensemble]}"
    return Grade(told, tuple(findings), tuple(faults), remarks=tuple(remarks))


def follows(name: str, failed: dict[str, float]) -> bool:
    """Whether a law fails because another one does."""
    scene, _, law = name.partition(": ")
    return (scene in ("coarse ring", "chain") and f"ring: {law}" in failed) or (
        law == "temperature of positions" and f"{scene}: temperature" in failed
    )


def of_half_a_step(halved: Make, claims: Claims, is_still: bool, heat: float) -> list[str]:
    """A wrong temperature that depends on the time step."""
    answers = of_scene(
        halved, claims._replace(runs=max(2, claims.runs // 3)), "ring", is_still, RATE
    )
    found = next((one.value for one in answers if one.name == "ring: temperature"), heat)
    said = f"with half the time step the temperature is {found:.3f}, not {heat:.3f} times what was asked for"
    return (
        []
        if 0.7 < found / heat < 1.4
        else [f"{said}: the noise of a step must be proportional to √Δt"]
    )


def claimed(options: dict[str, Any]) -> Claims:
    """What the options claim; those that are not for the dynamics are taken out."""
    taken = {
        name: options.pop(name, None) for name in ("ensemble", "timestep", "runs", "steps", "seed")
    }
    has_bonds, has_liquids = (
        checked_flag(name, options.pop(name, False)) for name in ("constraints", "liquids")
    )
    named = [(name, options[name]) for name in PRESSURES if options.get(name) is not None]
    stated = [checked_number(name, [*np.ravel(value).tolist(), value][0]) for name, value in named]
    asked = abs(stated[0]) if stated else None
    temperature = 300.0 if options.get("temperature_K") is None else options["temperature_K"]
    found = "NVE" if options.get("temperature_K") is None else "NVT" if asked is None else "NPT"
    ensemble = checked_choice("ensemble", taken["ensemble"] or found, ENSEMBLES)
    if ensemble == "NPT" and asked is None:
        raise ValueError(
            "pressure must be given for NPT [eV/Å³], as pressure= or as an option of the class; got none"
        )
    if (has_bonds and ensemble == "NPT") or (has_liquids and ensemble == "NVE"):
        raise ValueError(
            f"constraints are judged for NVE and NVT, liquids for NVT and NPT; got {ensemble}"
        )
    scenes = (
        ("chain",) * has_bonds if ensemble == "NVE" else USED[ensemble] + ("chain",) * has_bonds
    )
    return Claims(
        ensemble,
        units.kB * checked_number("temperature_K", temperature, "positive and finite"),
        0.0 if ensemble != "NPT" else checked_number("pressure", asked, "positive and finite"),
        checked_number(
            "timestep",
            units.fs if taken["timestep"] is None else taken["timestep"],
            "positive and finite",
        ),
        checked_count("runs", RUNS[ensemble] if taken["runs"] is None else taken["runs"], 6),
        checked_count(
            "steps", STEPS[ensemble] if taken["steps"] is None else taken["steps"], 8 * EVERY
        ),
        # runs count from it, and NumPy takes 32 bits
        checked_count("seed", taken["seed"] or 0, 0, 2**31),
        (scenes or USED[ensemble]) + ("liquid 1", "liquid 2") * has_liquids,
    )


def names_of(dynamics: Any, options: dict[str, Any]) -> list[str]:
    """The names of the laws by which a class is judged with these options."""
    claims = claimed({**options})
    own = [law.name for law in LAWS if {*law.needs.split()} <= claims.has(dynamics)]
    return own + [f"{scene}: {law}" for scene, laws in claims.laws() for law in laws]


def maker(dynamics: Any, timestep: float, options: dict[str, Any]) -> Make:
    """Makes the dynamics of atoms; options that a function does not take are claims only, a generator goes where one
    is taken."""
    parameters = inspect.signature(dynamics).parameters
    takes_all = any(one.kind is one.VAR_KEYWORD for one in parameters.values()) and inspect.isclass(
        dynamics
    )
    taken = {name: value for name, value in options.items() if takes_all or name in parameters}
    claims = {"temperature_K", "pressure"}
    if left := [name for name in options if name not in taken and name not in claims]:
        raise ValueError(f"{shown(dynamics)} takes {', '.join(parameters)}; got {', '.join(left)}")

    def make(atoms: Atoms, rng: np.random.RandomState) -> Any:
        return dynamics(atoms, timestep, **taken, **({"rng": rng} if "rng" in parameters else {}))

    return make


def of_scene(make: Make, claims: Claims, name: str, is_still: bool, rate: float) -> list[Finding]:
    """The findings of a scene: those without a number to judge, then the largest deviations; positions follow momenta,
    and noise that repeats explains the rest.  rate : of false alarms, of each law."""
    scene = claims.scene(name, is_still)
    frames = list[Frames]()
    steps = claims.steps // scene.slowness
    for n in (claims.runs, AGAIN * claims.runs):
        for k in tqdm(range(len(frames), n), desc=name, leave=False, disable=None):
            try:
                with np.errstate(all="ignore"):
                    frames.append(run(make, scene, claims.seed + k, steps, EVERY, claims.kt))
            except Exception as error:  # whatever a class raises
                fault = (
                    f"run {k} of {name} fails: {type(error).__name__}: {error}"
                    + COLLAPSE * bool(claims.pressure)
                )
                return [Finding(f"{name} runs", False, fault, cause=fault)]
        found = judged(
            ensembles.LAWS, ensembles.Seen(scene, frames, is_still, claims.pressure, 0.5 * rate)
        )
        if not any(NEARLY < abs(one.value - 1.0) / one.limit < 1.0 for one in found):
            break
    ranks = {"new noise": 1, "independent directions": 1, "temperature of positions": 3}

    def rank(one: Finding) -> tuple[int, float]:
        off = 0.0 if np.isnan(one.limit) else abs(one.value - 1.0) / one.limit
        return ranks.get(one.name, 2) * bool(off), -off

    return [
        replace(one, name=f"{name}: {one.name}", cause=f"{name}: {one.cause}")
        for one in sorted(found, key=rank)
    ]
