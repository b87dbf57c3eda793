"""Lines of a report about a barostat, from a record only, so that a file has them, too."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from minimd.diagnosis.report import Line
from minimd.engine.cell_rescaling import EVAPORATED
from minimd.engine.record import Record
from minimd.integrators.splitting.barostats import StochasticCellRescaling
from minimd.structure.statistics import mean_and_error, with_error

ENOUGH = 20  # frames, for a mean that is judged
FAR = 3.0  # standard errors within which a mean counts as that of the barostat


def pressure_lines(record: Record, barostat: StochasticCellRescaling | None, conserves_momentum: bool) -> Iterator[Line]:
    """Lines with the mean volume, and the mean pressure compared with the target of the barostat. No line without a barostat."""
    if barostat is None or len(record) < ENOUGH or not np.isfinite(record.pressure).all():
        return
    first, last, units = float(record.volume[0]), float(record.volume[-1]), record.units
    if last > EVAPORATED * first:
        grown = f"from {first:.4g} to {last:.4g} {units.volume}"
        yield Line("volume", grown, "EVAPORATED: a gas at this pressure and temperature; raise the pressure if it should be dense", False)
        return
    yield Line("volume", f"{record.volume.mean():.6g} {units.volume} on average", f"standard deviation {record.volume.std():.2g}", True)
    if barostat.coupling not in ("isotropic", "triclinic"):
        return
    missing = units.k_B * record.temperature / record.volume if conserves_momentum else 0.0  # of the center of mass
    mean, error = mean_and_error(record.pressure + missing)
    is_there = abs(mean - barostat.pressure) <= FAR * error
    words = f"{with_error(mean, error)} {units.pressure} on average, {barostat.pressure:.4g} wanted"
    yield Line("pressure", words, "reached" if is_there else "NOT REACHED; equilibrate longer", is_there, not is_there)
