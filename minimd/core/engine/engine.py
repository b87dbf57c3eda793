"""The engine: one system, its forces, its constraints and one method. It advances, stores and restores a state."""

import operator
import zlib
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from functools import partial
from math import inf
from typing import Any

import numpy as np

from minimd.core.compiled.program import Operation, in_python
from minimd.core.console.display import Rows
from minimd.core.console.quiet import quiet
from minimd.core.constraints.constraint_set import ConstraintSet
from minimd.core.constraints.groups import bodies_of
from minimd.core.engine.cell_rescaling import CellRescaling, check_cell, rescaling_of
from minimd.core.engine.proposals import CHECKED_EVERY, Proposals
from minimd.core.engine.scene_checks import (
    check_center,
    checked_method,
    holds_center,
    warn_of_dropped,
)
from minimd.core.engine.scene_in_words import scene_in_words
from minimd.core.engine.snapshot import Checkpoint, Snapshot
from minimd.core.forces.forces import ForceResult, Forces, Potential
from minimd.core.forces.options import FIXED_POINT, Options, described
from minimd.core.integrators.barostats import StochasticCellRescaling
from minimd.core.integrators.hybrid_monte_carlo import HybridMonteCarlo
from minimd.core.integrators.ramp import Level, Ramp, level_at
from minimd.core.integrators.splitting import Splitting
from minimd.core.integrators.state import Bath, GridState, State, Surroundings
from minimd.core.integrators.steps import ForceSource, Moment, Steps, first_unit
from minimd.core.integrators.substeps import Drift, mechanical
from minimd.core.potentials.term import FORCES, TOTALS
from minimd.core.structure.arrays import Array
from minimd.core.structure.constraints import Constraint
from minimd.core.structure.errors import NonFiniteError, RangeError
from minimd.core.structure.grid import Grid
from minimd.core.structure.observables import center, kinetic_energy, leaves_out_center
from minimd.core.structure.system import AnySystem, System

MOST_STEPS = 16  # of methods: replica exchange goes to and fro between temperatures


class Engine:
    """One system, its forces, its constraints and one method; see Simulation for the parameters.

    system : System, the state; its arrays can be changed.
    step : number of steps made.
    time : [time].
    interactions : Forces, the sum of all terms.
    constraint_set : ConstraintSet.
    barostat : or None.
    surroundings : of the method.
    noise_shift : step n has the noise with number n + noise_shift.
    extra_observables : names of additional observables.
    notes : title and scene, texts for files.
    is_whole : whether a checkpoint has the bits of the run; false after a state was restored without its lists, and
        until steps that were made are counted.
    sums : ForceResult, of the last evaluation.
    beginnings : how often steps had to begin anew: what was checked before is to be checked again.
    holds_center : whether the center of mass must not move, because atoms with FixCom of ASE were given.
    counts_center : whether it counts as a degree of freedom although nothing moves it, as in ASE's dynamics.
    equilibrated : steps of equilibrations so far: none of them has the noise of another.
    """

    def __init__(
        self,
        system: AnySystem,
        potentials: Potential | Sequence[Potential],
        method: Splitting,
        constraints: Constraint | Sequence[Constraint] | None = None,
        options: Options | None = None,
        barostat: StochasticCellRescaling | None = None,
    ) -> None:
        self._method = checked_method(method)
        self._system = system.copy() if isinstance(system, System) else System.from_ase(system)
        self.holds_center = holds_center(system)
        self.counts_center = False
        self._step = 0
        self._clock = (0, 0.0)
        self._pace = method.duration
        self.noise_shift = 0
        self.equilibrated = 0
        self.is_whole = True
        self._whole_when_counted = False
        self.notes = {"title": "", "scene": ""}
        self.extra_observables: Sequence[str] = ()
        self.interactions = Forces(self.system, potentials, options)
        self.interactions.warn_of_potentials()
        warn_of_dropped(self.system.constraints, constraints)
        held = self.system.constraints if constraints is None else constraints
        self.constraint_set = ConstraintSet(
            self.system, held, self.interactions.options.most_threads
        )
        self.system.constraints = self.constraint_set.kept
        check_center(self.holds_center, self._is_still_under(method), method)
        self._state = self._laid_out()
        self._fit_grid()
        self._bath = Bath(k_B=self.system.units.k_B, dimensions=self.system.dimensions)
        self.surroundings = Surroundings(self.constraint_set.bonds, self._bath)
        # of the state to which forces and images belong, and whether steps can go on from there
        self._entered: list[int] | None = None
        self._goes_on = False
        self.beginnings = 0
        self.sums = ForceResult(self.interactions.forces)
        self._known_steps: list[tuple[tuple[Any, ...], Steps, Proposals | None]] = []
        self._describe_bath()
        parts = self.system, self.interactions, self.constraint_set, method, self.holds_center
        self.barostat, self._rescaling = barostat, rescaling_of(barostat, *parts)

    def _laid_out(self) -> State:
        """The state; in fixed-point arithmetic on a grid."""
        interactions = self.interactions
        options = self.interactions.options
        parts = (
            self.system.positions,
            self.system.velocities,
            interactions.forces,
            self.constraint_set.inverse_masses,
        )
        if options.precision != FIXED_POINT:
            return State(*parts)
        interactions.lay_grid(options.grid or self._grid_of_scene())
        bonds = self.constraint_set.bonds
        bodies = (
            None if bonds is None else bodies_of(bonds.pairs, self.constraint_set.inverse_masses)
        )
        return GridState(*parts, impulses=interactions.impulses, bodies=bodies)

    def _fit_grid(self) -> None:
        """In fixed-point arithmetic, after changes: larger steps of the grid if needed, and the state rounded to it."""
        interactions = self.interactions
        state = self._state
        if interactions.grid is None or not isinstance(state, GridState):
            return
        is_free = interactions.options.grid is None and self.method.is_dynamics
        if is_free and not interactions.grid.has_room_for(self.system):
            interactions.grid = interactions.grid.widened(self._grid_of_scene())
        self._lay(interactions.grid)
        state.grid.take(self.system, state.inverse_masses)

    def _grid_of_scene(self) -> Grid:
        """With room for thermal momenta, if a method draws them."""
        depth = self.interactions.depth()
        if isinstance(self._method, HybridMonteCarlo):
            depth = max(depth, self.system.units.k_B * self._method.temperature_at(self._step))
        return Grid.of_scene(self.system, self._method.stride, depth)

    def _lay(self, grid: Grid | None) -> None:
        """Take a grid for the steps to come, if this engine has one."""
        interactions = self.interactions
        state = self._state
        if grid is None or not isinstance(state, GridState):
            return
        interactions.grid = state.grid = grid
        interactions.unit = state.unit = first_unit(self.method)

    @property
    def _own_steps(self) -> tuple[Steps, Proposals | None]:
        """The steps of the method, and the proposals of hybrid Monte Carlo, made anew if anything else than the state
        is another one; some are remembered."""
        constraints = self.surroundings.constraints
        grid = self.interactions.grid
        made_of = self._method, constraints, grid, *vars(self._method).values()
        for parts, steps, proposals in self._known_steps:
            if len(parts) == len(made_of) and all(map(operator.is_, made_of, parts)):
                return steps, proposals
        forces = self.interactions
        power = (lambda: forces.powers) if forces.depend_on_time else None
        work = forces.version, lambda: forces.pool
        source = ForceSource(self._forces_at, *work, forces.running, power, self._taken, forces)
        steps = Steps(self._method, self._state, self.surroundings, source)
        proposals = None
        if isinstance(self._method, HybridMonteCarlo):
            scene = self._method, self._system, self._state, forces
            proposals = Proposals(*scene, self.surroundings, self.constraint_set)
        self._known_steps = [(made_of, steps, proposals), *self._known_steps[: MOST_STEPS - 1]]
        return steps, proposals

    def _forces_at(self, with_energy: bool, unit: float, moment: Moment) -> Iterator[Operation]:
        """The operations of forces at a moment of a step."""
        interactions = self.interactions
        if interactions.depend_on_time:
            yield in_python(
                lambda: setattr(interactions, "time", self._time_at(moment.time - self.noise_shift))
            )
        yield from interactions.operations(
            interactions.target(TOTALS if with_energy else FORCES, unit)
        )

    def _taken(self, with_energy: bool, unit: float) -> None:
        target = self.interactions.target(TOTALS if with_energy else FORCES, unit)
        self.sums = self.interactions.taken(target)

    def advance(self, n_steps: int, with_energy: bool = True) -> int:
        """Make n_steps steps, fewer if surroundings.stop_requested becomes true; return how many.

        step and time stay as they are. Blocks of any size have the same bits as one, if nothing is changed in between.

        Raises NonFiniteError, ConstraintError if a step fails; then the state is invalid: restore a snapshot.
        """
        self._keep_pace()
        self._entered = None
        self._whole_when_counted |= self.is_whole
        self.is_whole = False
        rescaling = self._rescaling
        step = self.step
        end = self.step + n_steps
        while step < end:
            due = None if rescaling is None else rescaling.next_step(step)
            at = end if due is None else min(end, due)
            wants_energy = at == due or (with_energy and at == end)
            steps, proposals = self._own_steps
            if proposals is None:
                n_done = steps.advance(at - step, wants_energy, step + self.noise_shift)
                self.interactions.n_evaluations += n_done * steps.n_evaluations
            else:
                n_done = self._propose(proposals, step)
            step += n_done
            if rescaling is not None and step == due and n_done:
                self._rescale_cell(rescaling, step, proposals)
            if self.surroundings.stop_requested:
                break
        self.interactions.place_sites()
        return step - self.step

    def _propose(self, proposals: Proposals, step: int) -> int:
        """One step of hybrid Monte Carlo; returns 1, or 0 if it was stopped, and the state is that before it."""

        def evaluated() -> ForceResult:
            self._state.forces_are_current = False
            return self._evaluate(step)

        number = step + self.noise_shift
        potential = self._evaluate(step).potential_energy
        energy = potential + self._state.kinetic_energy()
        before = self.snapshot(), self.interactions.lists_built()
        given = self.reservoir_energy
        proposals.begin(number, potential)
        if number % CHECKED_EVERY == 0:
            proposals.audit(self._trajectory, evaluated)
            self._state.forces_are_current = False
        end = self._trajectory()
        if end is None:
            proposals.take_back()
            self._state.forces_are_current = False
            self.velocities[:] = before[0].velocities
            self.reservoir_energy = given
            self._remember(before[0].memory)
            self.interactions.build_lists(before[1])
            return 0
        self._state.forces_are_current &= proposals.decide(number, end)
        after = self._evaluate(step).potential_energy + self._state.kinetic_energy()
        self.reservoir_energy = given + after - energy
        return 1

    def _trajectory(self) -> float | None:
        """Make a trajectory of hybrid Monte Carlo; returns the potential energy at its end [energy], infinite if atoms
        have left for infinity, or None if it was stopped.
        Raises RangeError in fixed point, where what is in range is no matter of the positions alone."""
        n_steps = self._method.n_steps  # type: ignore[attr-defined]
        steps, _ = self._own_steps
        try:
            n_done = steps.advance(n_steps, True)
        except NonFiniteError as error:
            if isinstance(error, RangeError):
                raise
            return inf
        self.interactions.n_evaluations += n_done * steps.n_evaluations
        return self.potential_energy if n_done == n_steps else None

    def _rescale_cell(
        self, rescaling: CellRescaling, step: int, proposals: Proposals | None
    ) -> None:
        """Contact with the barostat at the end of a step; with proposals, another cell is one of them."""

        def forces_follow() -> ForceResult:
            self._state.forces_are_current = False
            self.interactions.follow()
            return self._evaluate(step)

        check_cell(self._system)
        sums = self._evaluate(step)
        number = step + self.noise_shift
        accepts = None if proposals is None else partial(proposals.accepts_volume, number)
        rescaling.apply(self._method, number, self._bath, sums, forces_follow, accepts)

    def prepare(self) -> None:
        """Compile what steps need."""
        self._own_steps[0].prepare()

    def enter(self) -> bool:
        """Bring forces and images of rigid bonds up to date with a state that may have been changed since leave.

        Returns whether it was not: steps then go on as if there had been no pause.
        """
        self.interactions.place_sites()
        state = self._digest()
        if state != self._entered:
            self._entered = state
            self._goes_on = False
            self._state.forces_are_current = False
            self.constraint_set.fit(self._system)
            self.surroundings.constraints = self.constraint_set.bonds
        return self._goes_on

    def begin(self) -> bool:
        """Enter, to make steps: a changed state is projected onto the constraints. Returns as enter."""
        if self.enter():
            return True
        self.changed()
        self.is_whole = True
        self._describe_bath()
        self.constraint_set.begin(self._system)
        self._fit_grid()
        self.surroundings.constraints = self.constraint_set.bonds
        self.leave()
        return False

    def leave(self) -> None:
        """Remember the state, from which steps can go on, for enter."""
        self._entered = self._digest()
        self._goes_on = True

    def changed(self) -> None:
        """Begin anew with the next steps: what enter cannot see, such as a potential, was changed."""
        self._entered = None
        self._state.forces_are_current = False
        self.beginnings += 1

    def _digest(self) -> list[int]:
        """CRC-32 of each array; a changed array has the same one with a probability of 1 in 4·10⁹."""
        system = self._system
        cell = system.cell
        digest = []
        for array in (system.positions, system.velocities, system.masses, cell.vectors, cell.pbc):
            digest.append(zlib.crc32(np.ascontiguousarray(array).data))
        return digest

    def evaluate(self) -> ForceResult:
        """Forces, energy and virial, computed unless they are current; no bit of the steps to come changes."""
        return self._evaluate(self._step)

    def _evaluate(self, step: int) -> ForceResult:
        if self._state.forces_are_current and self.sums.has_energy:
            return self.sums
        # the run itself needs no forces here if its next step begins with a drift
        is_aside = isinstance(next(iter(mechanical(self._method.substeps)), None), Drift)
        before = self.interactions.lists_built() if is_aside else ()
        n_builds = self.interactions.n_builds
        self.interactions.time = self._time_at(step)
        self.sums = self.interactions.compute(TOTALS, self._state.unit)
        self._state.forces_are_current = True
        self.surroundings.powers = self.interactions.powers
        if is_aside:
            self.interactions.n_evaluations -= 1  # of an observation, not of a step
        if is_aside and self.interactions.n_builds != n_builds:
            self.interactions.build_lists(before)
        return self.sums

    @contextmanager
    def coasted(self, duration: float) -> Iterator[Array]:
        """Context in which atoms, and the clock of forces, have coasted for a duration [time]; yields (N, 3) forces."""
        interactions = self.interactions
        positions = self.positions.copy()
        forces = interactions.forces.copy()
        impulses = interactions.impulses.copy()
        time = interactions.time
        self.positions[:] += duration * self.velocities
        interactions.time = self.time + duration
        try:
            yield interactions.compute(FORCES).forces
        finally:
            self.positions[:] = positions
            interactions.forces[:] = forces
            interactions.impulses[:] = impulses
            interactions.time = time

    def snapshot(self) -> Snapshot:
        """A copy of the present state, for restore."""
        system = self._system
        memories = self.memories
        return Snapshot(
            self._step,
            self.time,
            system.positions.copy(),
            system.velocities.copy(),
            self.reservoir_energy,
            self._clock,
            self.work,
            cell=None if self.barostat is None else system.cell,
            memory=np.concatenate(memories) if memories else None,
        )

    def restore(self, snapshot: Snapshot, is_whole: bool = False) -> None:
        """Restore the state of a snapshot.
        is_whole : whether it is to be kept as a state of the run, although its lists are lost."""
        self._remember(snapshot.memory)
        self.changed()
        self.is_whole = is_whole
        self._whole_when_counted = False
        self.positions[:] = snapshot.positions
        self.velocities[:] = snapshot.velocities
        self.reservoir_energy = snapshot.reservoir_energy
        self.work = snapshot.work
        cell = snapshot.cell
        if cell is not None and cell is not self._system.cell:
            self.constraint_set.follow(self._system.cell, cell)
            self._system.cell = cell
        self._step = snapshot.step
        self._clock = snapshot.clock or (snapshot.step, snapshot.time)
        self._pace = self._method.duration
        if self.time != snapshot.time:  # counted with the time step of another method
            self.time = snapshot.time

    @property
    def memories(self) -> list[Array]:
        """What method and terms remember from step to step."""
        own = self._method.memory
        return [*([] if own is None else [own]), *self.interactions.memories]

    def _remember(self, memory: Array | None) -> None:
        """Give method and terms their memory back; those without a memory, which have taken over, need none."""
        own = self.memories
        if memory is None or not own:
            return
        ends = np.cumsum([*map(len, own)])
        if ends[-1:] != memory.shape:
            raise ValueError(
                f"the memory of {self._method.name} and of the potentials must have the shape of the one that was "
                f"stored, {memory.shape}; its shape is {(int(ends[-1]),)}: pass method and potentials of that run"
            )
        for part, values in zip(own, np.split(memory, ends[:-1]), strict=True):
            part[:] = values

    def checkpoint(self) -> Checkpoint:
        """A copy of all that determines the bits of the steps to come, for go_on_from."""
        bonds = self.constraint_set.bonds
        interactions = self.interactions
        images = None if bonds is None else (bonds.offsets.copy(), bonds.tolerance)
        lists = interactions.displacement, interactions.lists_built()
        return Checkpoint(self.snapshot(), *lists, images, self.equilibrated, interactions.grid)

    def go_on_from(self, checkpoint: Checkpoint) -> None:
        """Go on in place of the engine of a checkpoint: the next steps have the same bits as its next steps."""
        self.restore(checkpoint.state)
        self._lay(checkpoint.grid)
        self.equilibrated = checkpoint.equilibrated
        self.is_whole = True
        if checkpoint.images is not None:
            self.constraint_set.restore(self._system, *checkpoint.images)
            self.surroundings.constraints = self.constraint_set.bonds
        self.interactions.go_on_with(checkpoint.displacement, checkpoint.lists)
        self.leave()

    def __reduce__(self) -> tuple[Any, ...]:
        """For pickle and copy: a copy makes the steps that this engine would make, to the last bit."""
        interactions = self.interactions
        names = ("noise_shift", "extra_observables", "is_whole")
        scene = (
            self._system,
            interactions.potentials,
            self._method,
            self.constraints,
            interactions.options,
            self.barostat,
        )
        more = {name: getattr(self, name) for name in (*names, "holds_center", "counts_center")}
        more["notes"] = dict(self.notes)
        return _copied, (scene, self.checkpoint(), self.enter(), self.interactions.counts, more)

    @property
    def step(self) -> int:
        """Number of steps made. Setting it leaves the time as it is."""
        return self._step

    @step.setter
    def step(self, step: int) -> None:
        self._clock = (step, self.time)  # the time at the old step
        self._step = step

    @property
    def time(self) -> float:
        """[time] since the start: the time that was set last, plus the time steps since then."""
        return self._time_at(self._step)

    @time.setter
    def time(self, time: float) -> None:
        self._clock = self._step, time
        self._state.forces_are_current &= not self.interactions.depend_on_time

    def _time_at(self, step: float) -> float:
        first, time = self._clock
        return time + (step - first) * self._pace

    def _keep_pace(self) -> None:
        """Count further time with the time step that the method has now; it may have been changed in place."""
        if self._pace != self._method.duration:
            self._clock = (self._step, self.time)
            self._pace = self._method.duration

    def count(self, n_steps: int) -> None:
        """Count n_steps more steps."""
        self._step += n_steps
        self.is_whole |= self._whole_when_counted
        self._whole_when_counted = False

    @property
    def system(self) -> System:
        """The state. Its arrays can be changed, but it cannot be replaced by another system."""
        return self._system

    @property
    def method(self) -> Splitting:
        """The integrator with its time step; it can be replaced.

        Setting it raises TypeError for anything but a splitting with its time step; ValueError if it leaves no degree
        of freedom, moves the center of mass of atoms with FixCom, or has another temperature than the barostat.
        """
        return self._method

    @method.setter
    def method(self, method: Splitting) -> None:
        is_alone = (
            checked_method(method).conserves_momentum and not self.interactions.act_from_outside
        )
        self.constraint_set.degrees_of_freedom(is_alone)
        check_center(self.holds_center, self._is_still_under(method), method)
        if self._rescaling is not None:
            self._rescaling.temperature(method)
        if type(method) is not type(self._method) or method.parameters != self._method.parameters:
            self.changed()
        self._method = method
        self._keep_pace()
        self._describe_bath()

    def _describe_bath(self) -> None:
        """Set n_dof and conserves_momentum of the bath."""
        self._bath.n_dof = self.n_dof
        self._bath.conserves_momentum = leaves_out_center(
            len(self._system), self.conserves_momentum
        )

    @property
    def n_dof(self) -> int:
        """Degrees of freedom that share the thermal energy."""
        return self.constraint_set.degrees_of_freedom(self.conserves_momentum)

    @property
    def drift(self) -> Array:
        """Velocity of the center of mass if n_dof leaves it out, else 0 [length/time], (3,)."""
        system = self._system
        return center(system.velocities, system.masses, self.conserves_momentum)

    @property
    def has_bath(self) -> bool:
        """Whether a thermostat or a barostat gives energy to the system."""
        return self._method.is_thermostat or self.barostat is not None

    @property
    def bath_settings(self) -> tuple[float | None, float | None]:
        """Temperature and pressure of thermostat and barostat at this step; None without them, or if no number."""
        temperature, pressure = self.bath_levels
        return level_at(temperature, self.step), level_at(pressure, self.step)

    @property
    def bath_levels(self) -> tuple[Level | None, Level | None]:
        """The same, ramps as such."""
        temperature = self._method.parameters.get("temperature")
        if not isinstance(temperature, float | int | Ramp):
            temperature = None
        barostat = self.barostat
        if barostat is None:
            return temperature, None
        return barostat.temperature if temperature is None else temperature, barostat.pressure

    @property
    def conserves_momentum(self) -> bool:
        """Whether momentum is constant: no fixed atoms, no outside force, no bath of each atom, no counts_center."""
        return self._is_still_under(self._method)

    @property
    def moves_freely(self) -> bool:
        """Whether nothing holds the center of mass: no fixed atoms, no outside force."""
        return not (self.interactions.act_from_outside or self.constraint_set.n_fixed)

    def _is_still_under(self, method: Splitting) -> bool:
        is_pushed = self.interactions.act_from_outside or self.constraint_set.n_fixed
        return method.conserves_momentum and not (is_pushed or self.counts_center)

    @property
    def reservoir_energy(self) -> float:
        """Energy given to the system by thermostat and barostat since the start [energy]; set when a run is resumed."""
        return self._bath.energy

    @reservoir_energy.setter
    def reservoir_energy(self, energy: float) -> None:
        self._bath.energy = energy

    @property
    def work(self) -> float:
        """∫ ∂U/∂t dt, work of forces that depend on time, since the start [energy]; set when a run is resumed."""
        return self.surroundings.work

    @work.setter
    def work(self, work: float) -> None:
        self.surroundings.work = work

    @property
    def constraints(self) -> tuple[Constraint, ...]:
        """The constraints, with the lengths in use."""
        return self.constraint_set.kept

    @property
    def positions(self) -> Array:
        """(N, 3) [length], never wrapped."""
        return self._system.positions

    @property
    def velocities(self) -> Array:
        """(N, 3) [length/time]."""
        return self._system.velocities

    @property
    def forces(self) -> Array:
        """(N, 3) [energy/length], of the last evaluation."""
        return self.interactions.forces

    @property
    def potential_energy(self) -> float:
        """U [energy], of the last evaluation."""
        return self.sums.potential_energy

    @property
    def kinetic_energy(self) -> float:
        """K [energy]."""
        return kinetic_energy(self.velocities, self._system.masses)

    def scene_in_words(self) -> Rows:
        """What makes up a simulation."""
        potentials = map(repr, self.interactions.potentials)
        return scene_in_words(
            self.system, potentials, self.method.name, self.method.parameters, self.barostat
        )

    def display_rows(self) -> Rows:
        """What makes up a simulation, and where it stands. Nothing is computed."""
        options = self.interactions.options
        grid = self.interactions.grid
        chosen = [described(options.precision)]
        if options.threads is not None:
            chosen.append(f"threads {options.threads:g}")
        if options.skin is not None:
            chosen.append(f"skin {options.skin:g}")
        rows = self.scene_in_words()
        if self.extra_observables:
            rows.append(("observed too", ", ".join(self.extra_observables)))
        rows.append(("options", ", ".join(chosen)))
        if grid:
            rows.append(("grid", f"positions, lattice vectors and momenta are rounded to {grid!r}"))
        rows.append(("at", f"step {self.step}, {self.system.units.shown(self.time)}"))
        return rows


def _copied(
    scene: tuple[Any, ...],
    checkpoint: Checkpoint,
    goes_on: bool,
    counts: tuple[int, int],
    more: dict[str, Any],
) -> Engine:
    """The engine that __reduce__ has described. Its warnings have been given."""
    with quiet():
        engine = Engine(*scene)
    # the first grid of a scene that has spread is coarser than that of the run
    engine.system.cell = scene[0].cell
    engine.go_on_from(checkpoint)
    if not goes_on:  # its state was changed, and its next run will begin anew
        engine.changed()
    engine.interactions.counts = counts
    for name, value in more.items():
        setattr(engine, name, value)
    return engine
