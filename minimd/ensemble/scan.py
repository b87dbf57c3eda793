"""A scan, as of `minimd scan`: one scene file, with values of some of its keys that differ from member to member."""

from __future__ import annotations

import re
import tomllib
from collections.abc import Callable, Iterable, Sequence
from concurrent.futures import Executor
from contextlib import suppress
from dataclasses import dataclass
from decimal import Decimal, InvalidOperation
from itertools import product
from pathlib import Path
from typing import Any, NamedTuple

from minimd.core.console.whole_file import regular, write_whole
from minimd.core.engine.engine import Engine
from minimd.core.engine.observation import observe
from minimd.core.engine.record import Record
from minimd.core.files.crash_file import crash_file_place
from minimd.core.simulation.simulation import Simulation
from minimd.core.structure.checks import checked_count
from minimd.ensemble.folder import EnsembleFolder, alone
from minimd.ensemble.member import Member, Value, averages_of
from minimd.ensemble.running import checked_members, ensemble
from minimd.ensemble.table import EnsembleTable, checked_quantity
from minimd.scene.running import equilibrate, minimize
from minimd.scene.scene import Scene, load_scene, parse_scene

SEED = "dynamics.seed"
# keys that must be the same for all members, and what to do instead of setting them
OF_THE_SCAN = {
    "dynamics.steps": "give --steps N",
    "dynamics.max_seconds": "no member ends before its last step",
    "output.every": "write it into the scene",
    "output.trajectory": "each member has a file of its own",
}
MOST_VALUES = 10**6
MOST_TRIED = 1000  # scenes that are checked before the first run begins
SCENE = "scene.toml"

Tell = Callable[[str], None]


class Setting(NamedTuple):
    """A key of a scene, such as dynamics.temperature_K or potential[0].cutoff_A, and its values in the scan."""

    key: str
    values: list[Value]

    def __str__(self) -> str:
        values = [str(value) for value in self.values]
        n = len(values)
        if n > 12:
            values[6:-3] = ["..."]
        return f"{self.key} = {', '.join(values)} ({n} values)"


def parsed_setting(text: str) -> Setting:
    """Read KEY=FROM:TO:STEP, where TO is included if a step reaches it, or KEY=VALUE,VALUE,...

    Steps are counted in decimal arithmetic: 0.1:0.3:0.1 is 0.1, 0.2, 0.3.
    Raises ValueError.
    """
    key, _, values = text.partition("=")
    key = key.strip()
    if not key or not values.strip():
        raise ValueError(f"--set needs KEY=FROM:TO:STEP or KEY=VALUE,VALUE,...; it is {text!r}")
    numbers = [number.strip() for number in values.split(":")]
    if len(numbers) != 3:
        return Setting(key, [_value(value.strip()) for value in values.split(",")])
    try:
        start, end, step = map(Decimal, numbers)
        n = int((end - start) / step) + 1 if step else 0
    except (InvalidOperation, OverflowError, ValueError):
        raise ValueError(f"--set needs numbers FROM:TO:STEP; it is {text!r}") from None

    if not 1 <= n <= MOST_VALUES:
        raise ValueError(
            f"--set needs a STEP that leads from FROM to TO with at most {MOST_VALUES} values; it is {text!r}"
        )

    is_whole = all(number.lstrip("+-").isdecimal() for number in numbers)
    kind = int if is_whole else float
    return Setting(key, [kind(start + k * step) for k in range(n)])


def _value(text: str) -> Value:
    """A number, text or bool as TOML reads it; anything else is a text."""
    with suppress(tomllib.TOMLDecodeError, RecursionError):
        value = tomllib.loads(f"value = {text}")["value"]
        if isinstance(value, Value):
            return value
    return text


def changed_text(path: Path, text: str, values: Iterable[tuple[str, Value]]) -> str:
    """The text of a scene with new values; everything else, with the comments, is unchanged.
    Raises ValueError for a table that is not in it."""
    import tomlkit

    document = tomlkit.parse(text)

    for key, value in values:
        node: Any = document
        *way, last = [part for part in re.split(r"[.\[\]]", key) if part]

        for part in way:
            try:
                is_index = part.isdecimal() and isinstance(node, list)
                node = node[int(part) if is_index else part]
            except (KeyError, IndexError, TypeError):
                raise ValueError(f"{path} has no {key!r}, because it has no {part!r}") from None

        if not isinstance(node, dict):
            raise ValueError(
                f"{path} has no {key!r}: {last!r} must be a key in a table; write an entry of a list as in "
                "potential[0].cutoff"
            )

        node[last] = value

    return tomlkit.dumps(document)


@dataclass(frozen=True)
class SceneMembers:
    """Builds and prepares the members of a scan.
    path : of the scene, absolute.
    text : of the scene."""

    path: Path
    text: str

    def scene(self, member: Member) -> Scene:
        """The scene of a member; its dynamics.seed is the seed of the member, unless the scan sets dynamics.seed."""
        values = list(member.parameters.items())
        if SEED not in member.parameters:
            values.append((SEED, member.seed))
        return parse_scene(changed_text(self.path, self.text, values), self.path)

    def __call__(self, member: Member) -> Simulation:
        """The simulation of a member at its start."""
        return self.scene(member).simulation()

    def prepare(self, simulation: Simulation, member: Member) -> None:
        """Minimize and equilibrate, as the scene says."""
        scene = self.scene(member)
        minimize(scene, simulation, False, _silent)
        equilibrate(scene, simulation, False, _silent, crash_file_place(True, member.file))


def scan_scene(
    path: str | Path,
    settings: Sequence[Setting],
    *,
    replicas: int = 1,
    steps: int | None = None,
    executor: Executor | None = None,
    workers: int | None = None,
    seed: int = 0,
    folder: str | Path = "scan",
    resume: bool = True,
    members: range | None = None,
    retries: int = 0,
    progress: bool | None = None,
    plot: str | None = None,
    tell: Tell = print,
) -> EnsembleTable:
    """Run a scene with all combinations of the settings,
    each combination `replicas` times with different random numbers.

    Members are counted replica by replica, so that more replicas can be added later.

    Parameters
    ----------
    steps : in place of those of the scene.
    plot : an observable that will be drawn, checked before the first run begins.
    tell : called with each line of the report.
    others : see ensemble.

    Raises
    ------
    ValueError, OSError : for scenes that cannot be built, before the first run begins, and as ensemble.
    """
    scene = load_scene(path)
    place = Path(folder)
    build = SceneMembers(Path(path).absolute(), scene.text)
    for setting in settings:
        if setting.key in OF_THE_SCAN:
            raise ValueError(
                f"{setting.key} is the same for all members of a scan; {OF_THE_SCAN[setting.key]}"
            )
    keys = [setting.key for setting in settings]
    combinations = product(*(setting.values for setting in settings))
    grid = [dict(zip(keys, values, strict=True)) for values in combinations]
    n_steps = scene.sections.dynamics.steps if steps is None else steps
    for row in grid[:MOST_TRIED]:
        parse_scene(changed_text(Path(path), scene.text, row.items()), Path(path))
    first = build(Member(0, grid[0], seed, n_steps, place))
    _check_plot(plot, first.engine)
    replicas = checked_count("replicas", replicas)
    n_members = len(grid) * replicas
    kept = place / SCENE
    checked_members(members, n_members, resume)
    place.mkdir(parents=True, exist_ok=True)
    with alone(place):
        if not (resume and kept.exists()):
            # refuses one that is in use, before the change
            EnsembleFolder(place, writes=True, members=members).close()
            write_whole(kept, scene.text)
        else:
            with open(kept, encoding="utf-8", opener=regular) as stream:
                is_same = stream.read() == scene.text
            if not is_same:
                raise ValueError(
                    f"folder {str(place)!r} holds a scan of another scene, {kept}; choose another folder with --out"
                )
    title = scene.sections.title
    tell(f"scene          {path}: {title}" if title else f"scene          {path}")
    if scene.sections.observer:
        tell(
            "NOTE           the observers of the scene are not used: they need a single run, and a scan has many"
        )
    for setting in settings:
        tell(f"set            {setting}")
    tell(
        f"members        {n_members}, {n_steps} steps each; {replicas} for each set of values; files in {place}"
    )
    parameters: Any = grid * replicas if settings else replicas
    return ensemble(
        build,
        parameters,
        n_steps,
        prepare=build.prepare,
        every=scene.sections.output.every,
        executor=executor,
        workers=workers,
        seed=seed,
        folder=place,
        resume=resume,
        members=members,
        retries=retries,
        progress=progress,
    )


def _check_plot(plot: str | None, engine: Engine) -> None:
    """Raise ValueError for a quantity of which a run has no average."""
    if plot is not None:
        record = Record(engine.system.units, len(engine.system))
        record.append(observe(engine))
        checked_quantity(plot, [*averages_of(record, 1.0)])


def _silent(_line: str) -> None:
    """Discard a line: members of a scan print nothing."""
