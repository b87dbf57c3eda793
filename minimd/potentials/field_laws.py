"""Laws u(x, y, z, t) of fields, each written once: a law returns u [energy],
the force on the atom [energy/length] and ∂u/∂t [energy/time].

Laws of walls hold a law u(r) of the distance from the wall inside.
"""

from math import nan, sqrt

from minimd.compiled.kernels import scalar
from minimd.potentials.law import evaluate_law, law_type


@scalar
def constant(x, y, z, _t, fx, fy, fz):
    """Constant force: u = −F·r.  x, y, z : position [length].  fx, fy, fz : F [energy/length]."""
    return -(fx * x + fy * y + fz * z), fx, fy, fz, 0.0


@scalar
def restraint(x, y, z, _t, kx, ky, kz, vx, vy, vz):
    """Harmonic spring to a point that may move.

        u = ½ (kₓ x² + k_y y² + k_z z²),   F = −(kₓ x, k_y y, k_z z),   ∂u/∂t = F·v

    x, y, z : position relative to the point [length].  kx, ky, kz : stiffness [energy/length²].  vx, vy, vz :
        velocity of the point [length/time].
    """
    fx, fy, fz = -kx * x, -ky * y, -kz * z
    return -0.5 * (fx * x + fy * y + fz * z), fx, fy, fz, fx * vx + fy * vy + fz * vz


@scalar
def planar(x, law, rest):
    """Wall in a plane: u(d) of the distance d = n·r − p, for 0 < d < reach; NaN on the wall and behind it.

    x : first coordinate [length].  law : of d.  rest : (y, z, t, n, p, reach, *parameters of law); n is a unit vector,
        three numbers.
    """
    y, z, nx, ny, nz, reach = rest[0], rest[1], rest[3], rest[4], rest[5], rest[7]
    d = nx * x + ny * y + nz * z - rest[6]
    if d >= reach:
        return 0.0, 0.0, 0.0, 0.0, 0.0
    if not d > 0.0:
        return nan, nan, nan, nan, 0.0
    u, f = evaluate_law(law, d * d, rest[8:])
    return u, f * d * nx, f * d * ny, f * d * nz, 0.0


@scalar
def curved(x, law, rest):
    """Wall of a cylinder or a sphere, with atoms inside: u(d) of the distance d = R − ρ, for 0 < d < reach;
    NaN on the wall and outside.

    ρ = |r − (a·r) a| with r relative to a point on the axis; a = 0 makes it a sphere. The force points inwards,
    along −(r − (a·r) a)/ρ.

    x : first coordinate relative to the point [length].  law : of d.  rest : (y, z, t, a, R, reach,
        *parameters of law); a is a unit vector or 0.
    """
    y, z, ax, ay, az, reach = rest[0], rest[1], rest[3], rest[4], rest[5], rest[7]
    along = ax * x + ay * y + az * z
    px, py, pz = x - along * ax, y - along * ay, z - along * az
    rho = sqrt(px * px + py * py + pz * pz)
    d = rest[6] - rho
    if d >= reach:
        return 0.0, 0.0, 0.0, 0.0, 0.0
    if not d > 0.0:
        return nan, nan, nan, nan, 0.0
    u, f = evaluate_law(law, d * d, rest[8:])
    g = -f * d / rho if rho > 0.0 else 0.0
    return u, g * px, g * py, g * pz, 0.0


ConstantLaw, RestraintLaw = law_type("ConstantLaw", constant), law_type("RestraintLaw", restraint)
Planar, Curved = law_type("Planar", planar), law_type("Curved", curved)
