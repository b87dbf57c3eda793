"""The report of a run that a guard has made: its record, its cost, and the checks that need no run."""

from dataclasses import replace

from minimd.compiled.machine import peak_memory
from minimd.diagnosis.first_hints import too_long_a_step
from minimd.diagnosis.pressure import pressure_lines
from minimd.diagnosis.report import Cost, Report, conservation_report
from minimd.diagnosis.reversibility import Reversibility
from minimd.diagnosis.run_guard import RunGuard
from minimd.diagnosis.static_checks import static_checks
from minimd.engine.record import Record


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
        peak_memory=peak_memory(),
    )
    angular, lines = is_free and not engine.system.cell.is_periodic, static_checks(engine, reversibility)
    lines += pressure_lines(record, engine.barostat, is_free)
    report = conservation_report(record, linear=is_free, angular=angular, cost=cost, lines=lines, n_dof=engine.n_dof)
    return replace(report, too_long_a_step=too_long_a_step(engine) or "")
