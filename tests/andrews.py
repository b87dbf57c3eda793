"""Andrews' squeezing mechanism: seven rigid bodies, six constraints; angles q = (β, Θ, γ, Φ, δ, Ω, ε).

E. Hairer, G. Wanner, Solving ODEs II (1996), VII.7, eq. 7.7-7.10; IVP Test Set, problem Andrews."""

from math import cos, sin, sqrt

import numpy as np
from references import load

DATA = load("dae/andrews.json")
NUMBERS = dict(pair.split("=") for pair in DATA["parameters"].split())
named = lambda names: (float(NUMBERS[name]) for name in names.split())  # noqa: E731
m1, m2, m3, m4, m5, m6, m7 = named("m1 m2 m3 m4 m5 m6 m7")
i1, i2, i3, i4, i5, i6, i7 = named("I1 I2 I3 I4 I5 I6 I7")
xa, ya, xb, yb, xc, yc, c0, l0, mom = named("xa ya xb yb xc yc c0 l0 mom")
d, da, e, ea, rr, ra, ss, sa, sb, sc, sd = named("d da e ea rr ra ss sa sb sc sd")
ta, tb, u, ua, ub, zf, zt, fa = named("ta tb u ua ub zf zt fa")
START = np.array(DATA["q0"], dtype=float), np.zeros(7)


def mass(q):
    _, th, _, ph, _, om, _ = q.tolist()
    m = np.zeros((7, 7))
    m[0, 0] = m1 * ra**2 + m2 * (rr**2 - 2 * da * rr * cos(th) + da**2) + i1 + i2
    m[1, 0] = m[0, 1] = m2 * (da**2 - da * rr * cos(th)) + i2
    m[1, 1] = m2 * da**2 + i2
    m[2, 2] = m3 * (sa**2 + sb**2) + i3
    m[3, 3] = m4 * (e - ea) ** 2 + i4
    m[4, 3] = m[3, 4] = m4 * ((e - ea) ** 2 + zt * (e - ea) * sin(ph)) + i4
    m[4, 4] = m4 * (zt**2 + 2 * zt * (e - ea) * sin(ph) + (e - ea) ** 2) + m5 * (ta**2 + tb**2) + i4 + i5
    m[5, 5] = m6 * (zf - fa) ** 2 + i6
    m[6, 5] = m[5, 6] = m6 * ((zf - fa) ** 2 - u * (zf - fa) * sin(om)) + i6
    m[6, 6] = m6 * ((zf - fa) ** 2 - 2 * u * (zf - fa) * sin(om) + u**2) + m7 * (ua**2 + ub**2) + i6 + i7
    return m


def force(q, v):
    _, th, ga, ph, _, om, _ = q.tolist()
    bep, thp, _, php, dep, omp, epp = v.tolist()
    xd, yd = sd * cos(ga) + sc * sin(ga) + xb, sd * sin(ga) - sc * cos(ga) + yb
    length = sqrt((xd - xc) ** 2 + (yd - yc) ** 2)
    pull = -c0 * (length - l0) / length
    return [
        mom - m2 * da * rr * thp * (thp + 2 * bep) * sin(th), m2 * da * rr * bep**2 * sin(th),
        pull * (xd - xc) * (sc * cos(ga) - sd * sin(ga)) + pull * (yd - yc) * (sd * cos(ga) + sc * sin(ga)),
        m4 * zt * (e - ea) * dep**2 * cos(ph), -m4 * zt * (e - ea) * php * (php + 2 * dep) * cos(ph),
        -m6 * u * (zf - fa) * epp**2 * cos(om), m6 * u * (zf - fa) * omp * (omp + 2 * epp) * cos(om),
    ]  # fmt: skip


def closures(q):
    be, th, ga, ph, de, om, ep = q.tolist()
    x, y = rr * cos(be) - d * cos(be + th), rr * sin(be) - d * sin(be + th)
    return [
        x - ss * sin(ga) - xb, y + ss * cos(ga) - yb,
        x - e * sin(ph + de) - zt * cos(de) - xa, y + e * cos(ph + de) - zt * sin(de) - ya,
        x - zf * cos(om + ep) - u * sin(ep) - xa, y - zf * sin(om + ep) + u * cos(ep) - ya,
    ]  # fmt: skip


def gradient(q):
    be, th, ga, ph, de, om, ep = q.tolist()
    g = np.zeros((6, 7))
    g[::2, 0], g[::2, 1] = -rr * sin(be) + d * sin(be + th), d * sin(be + th)
    g[1::2, 0], g[1::2, 1] = rr * cos(be) - d * cos(be + th), -d * cos(be + th)
    g[0, 2], g[1, 2] = -ss * cos(ga), -ss * sin(ga)
    g[2, 3], g[2, 4] = -e * cos(ph + de), -e * cos(ph + de) + zt * sin(de)
    g[3, 3], g[3, 4] = -e * sin(ph + de), -e * sin(ph + de) - zt * cos(de)
    g[4, 5], g[4, 6] = zf * sin(om + ep), zf * sin(om + ep) - u * cos(ep)
    g[5, 5], g[5, 6] = -zf * cos(om + ep), -zf * cos(om + ep) - u * sin(ep)
    return g
