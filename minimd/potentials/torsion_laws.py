"""The laws u(φ) of a dihedral angle, each written once: law(phi, *parameters) returns u [energy] and u′(φ)
[energy/rad].

φ is zero where the first and the last atom lie on one side (cis), and π or −π where they lie on opposite sides (trans):
IUPAC's convention.
"""

from math import cos, pi, sin

import numpy as np

from minimd.compiled.kernels import scalar
from minimd.potentials.law import law_type


@scalar
def periodic(phi, k, n, phase):
    """Periodic torsion.

        u(φ)  = k [1 + cos(nφ − φ₀)]
        u′(φ) = −n k sin(nφ − φ₀)

    phi : dihedral angle [rad].  k : half the barrier [energy].  n : number of minima in a turn.  phase : φ₀ [rad].
    Returns u [energy], u′ [energy/rad].
    """
    x = n * phi - phase
    return k * (1.0 + cos(x)), -n * k * sin(x)


@scalar
def ryckaert_bellemans(phi, c0, c1, c2, c3, c4, c5):
    """Torsion as a polynomial in the cosine of ψ = φ − π, which is zero if the chain is stretched (trans).

        u(φ)  = Σ cₙ xⁿ,  x = cos ψ = −cos φ
        u′(φ) = (Σ n cₙ xⁿ⁻¹) sin φ

    phi : dihedral angle [rad].  c0 … c5 : [energy].  Returns u [energy], u′ [energy/rad].
    J.-P. Ryckaert, A. Bellemans, Chem. Phys. Lett. 30, 123 (1975).
    """
    x = -cos(phi)
    u = c0 + x * (c1 + x * (c2 + x * (c3 + x * (c4 + x * c5))))
    slope = c1 + x * (2.0 * c2 + x * (3.0 * c3 + x * (4.0 * c4 + x * 5.0 * c5)))
    return u, slope * sin(phi)


@scalar
def harmonic_torsion(phi, k, angle):
    """Harmonic improper.

        u(φ)  = ½ k x²,  x = φ − φ₀ minus the nearest multiple of 2π
        u′(φ) = k x

    phi : dihedral angle [rad].  k : stiffness [energy/rad²].  angle : φ₀ [rad].  Returns u [energy], u′ [energy/rad].
    """
    x = phi - angle
    x -= 2.0 * pi * np.floor(x / (2.0 * pi) + 0.5)
    return 0.5 * k * x * x, k * x


PeriodicLaw, HarmonicTorsionLaw = law_type("PeriodicLaw", periodic), law_type("HarmonicTorsionLaw", harmonic_torsion)
RyckaertBellemansLaw = law_type("RyckaertBellemansLaw", ryckaert_bellemans)
