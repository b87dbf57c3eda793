"""The table of an ensemble as it is printed."""

import members
import numpy as np
from members import STEPS, TEMPERATURES

import minimd as md
from minimd.structure.statistics import with_error


def run(folder, parameters=TEMPERATURES, **options):
    return md.ensemble(members.liquid, parameters, STEPS, every=5, folder=folder, progress=False, workers=0, **options)


def test_it_has_the_lowest_and_the_highest_mean_with_their_errors(tmp_path):
    done = run(tmp_path / "done")
    rows, averages = dict(done.display_rows()), done.averaged()
    low, high = (pick(averages["pressure_mean"]) for pick in (np.argmin, np.argmax))
    told = [with_error(averages["pressure_mean"][k], averages["pressure_error"][k]) for k in (low, high)]
    assert all(" ± " in one for one in told)
    assert rows["mean pressure"] == f"from {told[0]} to {told[1]} ε/σ³"
    replicas = run(tmp_path / "replicas", parameters={"temperature": [0.5, 0.5]})
    (mean,) = replicas.averaged()
    assert (
        dict(replicas.display_rows())["mean pressure"]
        == f"{with_error(mean['pressure_mean'], mean['pressure_error'])} ε/σ³"
    )
    unknown = run(tmp_path / "user", run=members.pressure_alone)  # of one number there is no error
    assert "±" not in dict(unknown.display_rows())["mean last"]
