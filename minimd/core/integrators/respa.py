"""Multiple time steps: forces of bonds, angles and dihedrals in inner steps, all others by kicks around them."""

from minimd.core.integrators.method import Problem, Step
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
    forces.
    Raises ValueError unless n is from 1 to MOST_INNER."""
    n = checked_count("inner", n, 1, MOST_INNER)
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

    All forces are computed once in a step, those of bonded terms n + 2 times. Kicks of the others resonate with a
    vibration of half the period: Δt must stay below some third of the shortest one, whatever n. That does not exist
    with rigid bonds; constraints are kept in each inner step.

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
    substeps = with_inner_steps(VelocityVerlet.substeps, INNER)
    source = "M. Tuckerman, B. J. Berne, G. J. Martyna, J. Chem. Phys. 97, 1990 (1992)"

    def __init__(self, timestep: float, inner: int = INNER) -> None:
        super().__init__(timestep)
        self.substeps = with_inner_steps(VelocityVerlet.substeps, inner)  # type: ignore[misc]
        self.inner = inner

    @classmethod
    def on(cls, problem: Problem) -> Step:
        """Raises TypeError: a bare problem has one force."""
        raise TypeError(
            f"{cls.name} cannot solve a bare problem, which has one force and no bonds; use it in a Simulation"
        )


class LangevinRESPA(LangevinBAOAB):
    """Langevin dynamics with multiple time steps: RESPA whose inner steps are those of LangevinBAOAB, each with noise.

    Parameters
    ----------
    timestep, temperature, friction, seed : see LangevinBAOAB.
    inner : n, see RESPA.
    """

    name = "langevin-respa"
    substeps = with_inner_steps(LangevinBAOAB.substeps, INNER)
    source = RESPA.source

    def __init__(
        self, timestep: float, temperature: Level, friction: float, seed: int, inner: int = INNER
    ) -> None:
        super().__init__(timestep, temperature, friction, seed)
        self.substeps = with_inner_steps(LangevinBAOAB.substeps, inner)  # type: ignore[misc]
        self.inner = inner
        self.last_kick = 0.5 / self.inner  # of bonded terms
