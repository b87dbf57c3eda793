"""The description of an engine that a simulation displays."""

from minimd.engine.engine import Engine
from minimd.forces.options import described
from minimd.structure.display import Rows


def simulation_rows(engine: Engine) -> Rows:
    """What makes up a simulation, and where it stands. Nothing is computed."""
    options, units = engine.interactions.options, engine.system.units
    chosen = {"threads": options.threads, "skin": options.skin}
    words = [f"{name} {value:g}" for name, value in chosen.items() if value is not None]
    rows = [("system", repr(engine.system))]
    rows += [("potential", repr(one)) for one in engine.interactions.potentials]
    rows += [("method", repr(engine.method)), *(("constraint", repr(one)) for one in engine.constraints)]
    rows += [("barostat", repr(engine.barostat))] if engine.barostat is not None else []
    rows += [("observed too", ", ".join(engine.extra_observables))] if engine.extra_observables else []
    rows += [("options", ", ".join([described(options.precision), *words]))]
    rows += (
        [("grid", f"{grid!r}: positions, lattice vectors and momenta are rounded to it")]
        if (grid := engine.interactions.grid)
        else []
    )
    return [*rows, ("at", f"step {engine.step}, {units.shown(engine.time)}")]
