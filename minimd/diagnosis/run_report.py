"""The report of a run that a guard has made: its record, its cost, and the checks that need no run."""

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from minimd.diagnosis.first_hints import too_long_a_step
from minimd.diagnosis.report import Cost, Line, Report, block_means, conservation_report
from minimd.diagnosis.reversibility import Reversibility
from minimd.diagnosis.run_guard import RunGuard
from minimd.diagnosis.static_checks import static_checks
from minimd.engine.cell_rescaling import EVAPORATED
from minimd.engine.engine import Engine
from minimd.engine.record import Record

BLOCKS = 10  # means of the pressure, from which its standard error is taken
FAR = 4.0  # standard errors, themselves estimated from few means, within which a mean counts as that of the barostat


def report_of(guard: RunGuard, record: Record, reversibility: Reversibility | None) -> Report:
    """See Simulation.report."""
    engine = guard.engine
    engine.fit_images()
    interactions, bonds, is_free = engine.interactions, engine.constraint_set.bonds, engine.conserves_momentum
    cost = Cost(
        n_steps=guard.n_steps,
        seconds=guard.seconds,
        list_builds=interactions.n_builds,
        n_evaluations=interactions.n_evaluations,
        pair_search=interactions.pair_search,
        skipped=interactions.skipped(),
        constraints=f"{bonds.summary}; at most {bonds.iterations} iterations in a drift" if bonds else "",
    )
    angular, lines = is_free and not engine.system.cell.is_periodic, static_checks(engine, reversibility)
    lines += pressure_lines(engine, record)
    report = conservation_report(record, linear=is_free, angular=angular, cost=cost, lines=lines)
    return replace(report, too_long_a_step=too_long_a_step(engine) or "")


def pressure_lines(engine: Engine, record: Record) -> Iterator[Line]:
    """What a barostat did: the mean volume, and the mean pressure compared with its target. No line without a barostat.

    If the total momentum is constant, its degrees of freedom are missing in the recorded pressure; their k_B T/V is added.
    """
    barostat, units = engine.barostat, engine.system.units
    if barostat is None or len(record) < 2 * BLOCKS or not np.isfinite(record.pressure).all():
        return
    first, last = float(record.volume[0]), float(record.volume[-1])
    if last > EVAPORATED * first:
        grown = f"from {first:.4g} to {last:.4g} {units.volume}"
        yield Line("volume", grown, "EVAPORATED: a gas at this pressure and temperature; raise the pressure if it should be dense", False)
        return
    yield Line("volume", f"{record.volume.mean():.6g} {units.volume} on average", f"standard deviation {record.volume.std():.2g}", True)
    if barostat.coupling not in ("isotropic", "triclinic"):
        return
    moving = engine.n_dof / (engine.n_dof + 3.0 * engine.conserves_momentum)
    means = block_means(record.pressure + (1.0 / moving - 1.0) * 2.0 * record.kinetic_energy / (3.0 * record.volume), BLOCKS)
    mean, error = float(means.mean()), float(means.std(ddof=1)) / BLOCKS**0.5
    is_there = abs(mean - barostat.pressure) <= FAR * error
    words = f"{mean:.4g} ± {error:.1g} {units.pressure} on average, {barostat.pressure:.4g} wanted"
    yield Line("pressure", words, "reached" if is_there else "NOT REACHED; equilibrate longer", is_there)
