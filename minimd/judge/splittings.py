"""Splittings of minimd, judged: kicks and drifts as a step; those that are in contact with a bath as dynamics."""

from __future__ import annotations

from inspect import Parameter, Signature, isclass, signature
from types import SimpleNamespace
from typing import Any

from minimd.core.integrators.splitting import Splitting
from minimd.core.integrators.substeps import Kick, Thermalize
from minimd.core.potentials.term import ForcesFromCalculator
from minimd.core.simulation.simulation import Simulation
from minimd.core.structure.system import System
from minimd.judge.problems import Function

GIVEN = {
    "timestep": "timestep",
    "temperature": "temperature_K",
    "seed": "rng",
}  # by names of splittings
T = 300.0  # K


def as_function(method: Any, kind: str | None, options: dict[str, Any]) -> tuple[Function, str]:
    """What a splitting, an instance or a class, is judged as: a step or dynamics, with its kind.

    options : of grade; those of an instance are added.
    Raises TypeError for overdamped motion, which has no velocities to be judged, and for a step with several forces.
    """
    own: Any = method if isclass(method) else type(method)
    if own.is_overdamped:
        raise TypeError(
            f"md.grade judges motion with inertia, and {own.__name__} has none: "
            "compare averages of positions with exact ones"
        )
    has_bath = own.is_thermostat or any(isinstance(part, Thermalize) for part in own.substeps)
    if kind == "step" or (kind is None and not has_bath):
        kicks = [type(part) for part in own.substeps if isinstance(part, Kick)]
        if kicks.count(Kick) < len(kicks):  # some are made with a part of the forces
            raise TypeError(
                f"md.grade judges a step with one force, and {own.__name__} has two; "
                'judge it with kind="dynamics"'
            )
        return step_of(own), "step"
    known = {} if own is method else method.parameters
    for name, value in known.items():
        if name != "seed":
            options.setdefault(GIVEN.get(name, name), value)
    if own.is_thermostat:
        options.setdefault("temperature_K", T)
    return dynamics_of(own), "dynamics"


def step_of(method: type[Splitting]) -> Function:
    """The kicks and drifts of a splitting, which compute forces where positions have moved."""
    parts = [part for part in method.sequence() if not isinstance(part, Thermalize)]

    def keeping(x: Any, v: Any, F: Any, force: Any, m: Any, dt: float) -> tuple[Any, ...]:
        for part in parts:
            if isinstance(part, Kick):
                F = force(x) if F is None else F
                v = v + part.coefficient * dt * F / m[:, None]
            else:
                x = x + part.coefficient * dt * v
                F = None
        return x, v, F

    def step(x: Any, v: Any, force: Any, m: Any, dt: float) -> tuple[Any, ...]:
        return keeping(x, v, None, force, m, dt)[:2]

    is_kept = all(isinstance(end, Kick) for end in parts[:1] + parts[-1:])
    chosen: Function = keeping if is_kept else step
    chosen.__name__ = method.__name__
    return chosen


def dynamics_of(method: type[Splitting]) -> Function:
    """Dynamics of atoms of ASE in simulations, with a method of their own: rng makes its seed. Seed, step and memory
    go with the atoms, as they do in a restart."""
    own = [*signature(method).parameters]

    def make(atoms: Any, timestep: float, rng: Any, **options: Any) -> Any:
        carried = atoms.info
        carried.setdefault("seed", int(rng.randint(2**31)))
        values = {**options, "timestep": timestep, "rng": carried["seed"]}
        known = {name: GIVEN.get(name, name) for name in own}
        used = {name: values[key] for name, key in known.items() if key in values}
        forces = ForcesFromCalculator(atoms.calc)
        bath = method(**used)
        if bath.memory is not None:
            bath.memory = carried.get("memory", bath.memory)
        simulation = Simulation(System.from_ase(atoms), forces, bath)
        simulation.step = carried.get("step", 0)

        def run(steps: int) -> None:
            simulation.make_steps(steps)
            carried.update(step=simulation.step, memory=bath.memory)
            atoms.positions[:] = simulation.positions
            atoms.set_velocities(simulation.velocities)

        return SimpleNamespace(run=run)

    names = ["atoms", *GIVEN.values(), *(name for name in own if name not in GIVEN)]
    parameters = [Parameter(name, Parameter.POSITIONAL_OR_KEYWORD) for name in names]
    make.__signature__ = Signature(parameters)  # type: ignore[attr-defined]
    make.__name__ = make.__qualname__ = method.__name__
    return make
