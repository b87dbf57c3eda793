"""Multiple time steps: forces of bonds, angles and dihedrals in inner steps, all others by kicks around them."""

from math import nan

from minimd.core.integrators.method import ClassProperty, Problem, Step
from minimd.core.integrators.ramp import Level
from minimd.core.integrators.rows import VelocityVerlet
from minimd.core.integrators.splitting import Splitting
from minimd.core.integrators.substeps import BondedKick, Kick, Substeps, merged, scaled
from minimd.core.integrators.thermostats import LangevinBAOAB
from minimd.core.structure.checks import checked_count

__all__ = ["RESPA", "LangevinRESPA"]

# inner steps, if not given, and at most
INNER = 4
MOST_INNER = 100


def with_inner_steps(substeps: Substeps, n: int) -> Substeps:
    """S_{Δt/2} ∘ (Φ_{Δt/n})ⁿ ∘ S_{Δt/2}: Φ are the substeps with kicks by bonded terms alone, S is a kick by all other
    forces."""
    outer = (Kick(0.5), BondedKick(-0.5))
    inner = [
        BondedKick(part.coefficient) if isinstance(part, Kick) else part
        for part in scaled(substeps, 1.0 / n)
    ]
    return merged((*outer, *n * inner, *outer[::-1]))


class RESPA(Splitting):
    """r-RESPA, multiple time steps: bonds, angles and dihedrals by n steps of velocity Verlet over Δt/n, all other
    forces, F − F_b, by kicks before and after them; order 2, symplectic, time-reversible.

        v ← v + Δt/2 (F − F_b)/m
        n times: velocity Verlet over Δt/n with F_b
        v ← v + Δt/2 (F − F_b)/m

    F_b are the forces of bonds, angles and dihedrals, and those of the excluded and scaled pairs of their atoms. They
    are computed n + 2 times in a step, all forces once. Kicks of the others resonate with a vibration whose half period
    is Δt: it must stay below a third of the shortest period, whatever n. Constraints are kept in each inner step.

    Parameters
    ----------
    timestep : Δt [time], of the outer step.
    inner : n, from 1 to 100.

    Raises ValueError for another n.

    M. Tuckerman, B. J. Berne, G. J. Martyna, J. Chem. Phys. 97, 1990 (1992); H. Grubmüller, H. Heller, A. Windemuth, K.
    Schulten, Mol. Simul. 6, 121 (1991); the resonance: T. Schlick, M. Mandziuk, R. D. Skeel, K. Srinivas, J. Comput.
    Phys. 140, 1 (1998).
    """

    name = "respa"
    inner = INNER
    substeps = ClassProperty(lambda method: with_inner_steps(VelocityVerlet.substeps, method.inner))
    source = "M. Tuckerman, B. J. Berne, G. J. Martyna, J. Chem. Phys. 97, 1990 (1992)"

    def __init__(self, timestep: float, inner: int = INNER) -> None:
        super().__init__(timestep)
        self.inner = checked_count("inner", inner, 1, MOST_INNER + 1)

    @classmethod
    def on(cls, problem: Problem) -> Step:
        """Raises TypeError: a bare problem has one force."""
        raise TypeError(
            f"{cls.name} cannot solve a bare problem, which has one force and no bonds; use it in a Simulation"
        )


class LangevinRESPA(LangevinBAOAB):
    """Langevin dynamics with multiple time steps: RESPA whose inner steps are those of LangevinBAOAB, each with noise.

        v ← v + Δt/2 (F − F_b)/m
        n times: LangevinBAOAB over Δt/n with F_b
        v ← v + Δt/2 (F − F_b)/m

    The kicks at both ends make velocities too slow, as those of LangevinBAOAB do; by how much is not known here. Energy
    minus reservoir energy drifts, since the bath takes up what kicks do wrong (shadow work), in proportion to friction.

    Parameters
    ----------
    timestep, temperature, friction, seed : see LangevinBAOAB.
    inner : n, see RESPA.
    """

    name = "langevin-respa"
    inner = INNER
    substeps = ClassProperty(lambda method: with_inner_steps(LangevinBAOAB.substeps, method.inner))
    source = RESPA.source
    last_kick = nan

    def __init__(
        self, timestep: float, temperature: Level, friction: float, seed: int, inner: int = INNER
    ) -> None:
        super().__init__(timestep, temperature, friction, seed)
        self.inner = checked_count("inner", inner, 1, MOST_INNER + 1)
