"""The long runs: liquid argon as Rahman saw it, and the conservation of energy and momentum over many steps."""

from pathlib import Path

import numpy as np
import pytest
from scenes import SCENES

import minimd as md
from minimd.commands import main as cli
from minimd.diagnosis.report import conservation_report
from minimd.mdanalysis import diffusion_coefficient, radial_distribution

pytestmark = pytest.mark.slow
SMOOTH = md.LennardJones(1.0, 1.0, 2.5, "force-shifted")
EXAMPLES = Path(__file__).parents[2] / "examples"


def test_argon_is_rahmans(tmp_path):
    """D = 2.43e-5 cm²/s, first peak of g(r) at 3.7 Å, both by MDAnalysis from the file."""
    file = tmp_path / "argon.h5md"
    assert cli.main(["run", str(EXAMPLES / "argon.toml"), "--out", str(file), "--quiet"]) == 0
    g = radial_distribution(file)
    peak, diffusion = g.r[np.argmax(g.g)], diffusion_coefficient(file)
    print(f"peak of g(r) {peak:.3f} Å, {diffusion}")
    assert peak == pytest.approx(3.7, abs=0.1)
    assert diffusion.cm2_per_s == pytest.approx(2.43e-5, abs=0.25e-5)
    assert cli.main(["check", str(file)]) == 0


def test_a_hundred_thousand_steps_conserve_energy_and_momentum():
    melt = md.Simulation(SCENES["melt"]().system, SMOOTH, md.VelocityVerlet(0.004))
    melt.equilibrate(1500, 1.44)
    melt.run(500)
    simulation = md.Simulation(melt.system, SMOOTH, md.VelocityVerlet(0.002))
    report = conservation_report(simulation.run(100_000, every=50), angular=False)
    print(report)
    assert abs(report.energy_drift.slope) < max(report.energy_drift.error, 1e-6)
    assert report.momentum_change < 1e-14
