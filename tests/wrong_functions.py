"""Steps and forces as students write them: a few right ones and many wrong ones, each with words that must be in a sentence about it."""

import math

import numpy as np


# right steps, in several shapes
def velocity_verlet(x, v, force, m, dt):
    a = force(x) / m[:, None]
    v = v + 0.5 * dt * a
    x = x + dt * v
    return x, v + 0.5 * dt * force(x) / m[:, None]


def in_place(pos, vel, masses, compute_forces, timestep):
    vel += 0.5 * timestep * compute_forces(pos) / masses.reshape(-1, 1)
    pos += timestep * vel
    vel += 0.5 * timestep * compute_forces(pos) / masses.reshape(-1, 1)


def with_accelerations(r, v, acceleration, h):
    a = acceleration(r)
    r = r + h * v + h**2 / 2 * a
    return r, v + h / 2 * (a + acceleration(r))


def in_momenta(q, p, grad_u, m, h):
    p = p - h / 2 * grad_u(q)
    q = q + h * p / m[:, None]
    return q, p - h / 2 * grad_u(q)


def handing_on(x, v, F, compute_force, m, dt):  # noqa: N803
    v = v + dt / 2 * F / m[:, None]
    x = x + dt * v
    F = compute_force(x)  # noqa: N806
    return x, v + dt / 2 * F / m[:, None], F


def stormer(x, x_old, force, m, dt):
    return 2 * x - x_old + dt**2 * force(x) / m[:, None], x


def one_particle(x, v, f, m, dt):
    v = v + dt / 2 * f(float(x)) / m
    x = x + dt * v
    return math.fsum([x]), v + dt / 2 * f(x) / m


RIGHT_STEPS = [velocity_verlet, in_place, with_accelerations, in_momenta, handing_on, stormer, one_particle]


# wrong steps
def explicit_euler(x, v, force, m, dt):
    """Positions move with the old velocity."""
    a = force(x) / m[:, None]
    return x + v * dt, v + a * dt


def kick_first(x, v, force, m, dt):
    v = v + dt * force(x) / m[:, None]
    return x + dt * v, v


def drift_first(x, v, force, m, dt):
    x = x + dt * v
    return x, v + dt * force(x) / m[:, None]


def old_force_twice(x, v, force, m, dt):
    f = force(x)
    v = v + dt / 2 * f / m[:, None]
    x = x + dt * v
    return x, v + dt / 2 * f / m[:, None]


def aliased(r, v, force, m, dt):
    a = force(r) / m[:, None]
    a_old = a
    r = r + v * dt + 0.5 * a * dt**2
    a[:] = force(r) / m[:, None]
    return r, v + 0.5 * (a_old + a) * dt


def no_mass(x, v, force, m, dt):
    v = v + dt / 2 * force(x)
    x = x + dt * v
    return x, v + dt / 2 * force(x)


def no_mass_in_one_half(x, v, force, m, dt):
    v = v + dt / 2 * force(x) / m[:, None]
    x = x + dt * v
    return x, v + dt / 2 * force(x)


def half_drift(x, v, force, m, dt):
    v = v + dt / 2 * force(x) / m[:, None]
    x = x + dt / 2 * v
    return x, v + dt / 2 * force(x) / m[:, None]


def whole_kicks(x, v, force, m, dt):
    v = v + dt * force(x) / m[:, None]
    x = x + dt * v
    return x, v + dt * force(x) / m[:, None]


def no_second_kick(x, v, force, m, dt):
    v = v + dt / 2 * force(x) / m[:, None]
    return x + dt * v, v


def no_half_in_positions(x, v, force, m, dt):
    f = force(x) / m[:, None]
    x = x + dt * v + f * dt**2
    return x, v + dt / 2 * (f + force(x) / m[:, None])


def dt_in_place_of_its_square(x, v, force, m, dt):
    f = force(x) / m[:, None]
    x = x + dt * v + 0.5 * f * dt
    return x, v + dt / 2 * (f + force(x) / m[:, None])


def wrong_sign(x, v, force, m, dt):
    v = v - dt / 2 * force(x) / m[:, None]
    x = x + dt * v
    return x, v - dt / 2 * force(x) / m[:, None]


def runge_kutta_4(x, v, force, m, dt):
    def rate(x, v):
        return v, force(x) / m[:, None]

    a, b = rate(x, v)
    c, d = rate(x + dt / 2 * a, v + dt / 2 * b)
    e, f = rate(x + dt / 2 * c, v + dt / 2 * d)
    g, h = rate(x + dt * e, v + dt * f)
    return x + dt / 6 * (a + 2 * c + 2 * e + g), v + dt / 6 * (b + 2 * d + 2 * f + h)


def hidden_friction(x, v, force, m, dt):
    x, v = velocity_verlet(x, v, force, m, dt)
    return x, v * (1 - 0.02 * dt)


def hidden_noise(x, v, force, m, dt):
    x, v = velocity_verlet(x, v, force, m, dt)
    return x, v + 0.01 * np.random.normal(size=v.shape)


def rescaled(x, v, force, m, dt):
    x, v = velocity_verlet(x, v, force, m, dt)
    kinetic = 0.5 * np.sum(m[:, None] * v * v)
    return x, v * np.sqrt(1.5 * len(x) * 0.5 / kinetic)


def wrapped(x, v, force, m, dt):
    x, v = velocity_verlet(x, v, force, m, dt)
    return x % 10.0, v


def last_atom_forgotten(x, v, force, m, dt):
    f = force(x)
    for i in range(len(x) - 1):
        v[i] += dt / 2 * f[i] / m[i]
        x[i] += dt * v[i]
    f = force(x)
    for i in range(len(x) - 1):
        v[i] += dt / 2 * f[i] / m[i]
    return x, v


def atom_after_atom(x, v, force, m, dt):
    for i in range(len(x)):
        v[i] += dt * force(x)[i] / m[i]
        x[i] += dt * v[i]
    return x, v


def single_precision(x, v, force, m, dt):
    x, v = velocity_verlet(np.float32(x), np.float32(v), force, m, dt)
    return np.float32(x), np.float32(v)


def backward_difference(x, x_prev, force, m, dt):
    new = 2 * x - x_prev + dt**2 * force(x) / m[:, None]
    return new, x, (new - x) / dt


def stale(x, v, F, compute_force, m, dt):  # noqa: N803
    v = v + dt / 2 * F / m[:, None]
    new = x + dt * v
    return new, v + dt / 2 * compute_force(new) / m[:, None], compute_force(x)


def no_dt_in_the_kick(x, v, force, m, dt):
    v = v + force(x) / m[:, None]
    return x + v * dt, v


def recursion_without_mass(x, x_old, force, m, dt):
    return 2 * x - x_old + dt**2 * force(x), x


def recursion_with_half(x, x_old, force, m, dt):
    return 2 * x - x_old + 0.5 * dt**2 * force(x) / m[:, None], x


WRONG_STEPS = {
    explicit_euler: "old velocity",
    kick_first: "kick first",
    drift_first: "drift first",
    old_force_twice: "uses the old force",
    aliased: "uses the new force twice",
    no_mass: "lacks 1/m",
    no_mass_in_one_half: "1/m is missing in a part",
    half_drift: "multiplied by ½",
    whole_kicks: "2 times too large",
    no_second_kick: "only half of the kick",
    no_half_in_positions: "factor ½ is missing",
    dt_in_place_of_its_square: "needs dt²",
    wrong_sign: "wrong sign",
    runge_kutta_4: "not symplectic",
    hidden_friction: "friction",
    hidden_noise: "random numbers",
    rescaled: "thermostat",
    wrapped: "wrapped into a box",
    last_atom_forgotten: "atom 4, the last, is not moved",
    atom_after_atom: "one after another",
    single_precision: "float32",
    backward_difference: "half",
    stale: "old force",
    no_dt_in_the_kick: "lacks dt",
    recursion_without_mass: "1/m",
    recursion_with_half: "half",
}


# right forces
def lennard_jones(x, box=None, cutoff=2.5, shift=True):
    forces, energy = np.zeros_like(x), 0.0
    for i in range(len(x)):
        for j in range(i + 1, len(x)):
            d = x[i] - x[j]
            if box is not None:
                d = d - box * np.round(d / box)
            r2 = d @ d
            if r2 < cutoff**2:
                s6 = r2**-3
                f = 24 * (2 * s6 * s6 - s6) / r2 * d
                forces[i] += f
                forces[j] -= f
                energy += 4 * (s6 * s6 - s6) - shift * 4 * (cutoff**-12 - cutoff**-6)
    return forces, energy


def _pairs(x, law, box=0.0):
    d = x[:, None] - x
    if box:
        d = d - box * np.round(d / box)
    r = np.sqrt((d * d).sum(axis=2)) + np.eye(len(x)) * 1e10
    return (law(r)[:, :, None] * d / r[:, :, None]).sum(axis=1)


def force_of_distance(r):
    return 48 / r**13 - 24 / r**7


def law_of_minimd(r2, epsilon, sigma):
    s6 = (sigma**2 / r2) ** 3
    return 4 * epsilon * s6 * (s6 - 1), 24 * epsilon * s6 * (2 * s6 - 1) / r2


RIGHT_FORCES = [
    lennard_jones,
    force_of_distance,
    law_of_minimd,
    lambda x: _pairs(x, force_of_distance),
    lambda x: -3.0 * (len(x) * x - x.sum(axis=0)),
]


# wrong forces: (function, options of md.grade) and the words
def attracting(x):
    f, u = lennard_jones(x, cutoff=1e3)
    return -f, u


def half_of_it(x):
    f, u = lennard_jones(x, cutoff=1e3)
    return f / 2, u


def slope_times_vector(x):
    d = x[:, None] - x
    r = np.sqrt((d * d).sum(axis=2)) + np.eye(len(x)) * 1e10
    u = (4 * (r**-12 - r**-6)).sum() / 2
    return u, ((48 * r**-13 - 24 * r**-7)[:, :, None] * d).sum(axis=1)


def first_atom_only(positions):
    forces = np.zeros_like(positions)
    for i in range(len(positions)):
        for j in range(i + 1, len(positions)):
            d = positions[i] - positions[j]
            r = np.linalg.norm(d)
            forces[i] += (48 / r**14 - 24 / r**8) * d
    return forces


def overwritten(positions):
    forces = np.zeros_like(positions)
    for i in range(len(positions)):
        for j in range(len(positions)):
            if i != j:
                d = positions[i] - positions[j]
                r = np.linalg.norm(d)
                forces[i] = (48 / r**14 - 24 / r**8) * d
    return forces


def jumping(x):
    return lennard_jones(x, shift=False)


def one_direction(x, box, cutoff):
    forces = np.zeros_like(x)
    for i in range(len(x)):
        for j in range(i + 1, len(x)):
            d = x[i] - x[j]
            d[d > box / 2] -= box
            r2 = d @ d
            if r2 < cutoff**2:
                f = 24 * (2 / r2**6 - 1 / r2**3) / r2 * d
                forces[i] += f
                forces[j] -= f
    return forces


def in_a_cube(x, box, cutoff, of_positions=False):
    x = x - box * np.round(x / box) if of_positions else x
    d = x[:, None] - x
    d = d if of_positions else d - box * np.round(d / box)
    r2 = (d * d).sum(axis=2) + np.eye(len(x)) * 1e10
    inside = r2 < cutoff**2 if of_positions else (np.abs(d) < cutoff).all(axis=2)
    return (np.where(inside, 48 / r2**7 - 24 / r2**4, 0.0)[:, :, None] * d).sum(axis=1)


def wrapped_positions(x, box, cutoff):
    return in_a_cube(x, box, cutoff, True)


def itself(x):
    d = x[:, None] - x
    r = np.sqrt((d * d).sum(axis=2))
    return (force_of_distance(r)[:, :, None] * d / r[:, :, None]).sum(axis=1)


def not_a_gradient(x):
    return _pairs(x, force_of_distance) + 0.3 * np.stack([-x[:, 1], x[:, 0], 0 * x[:, 2]], axis=1)


def planar(x):
    f = _pairs(x, force_of_distance)
    f[:, 2] = 0.0
    return f


WRONG_FORCES = {
    "sign": (attracting, {}, "wrong sign"),
    "half": (half_of_it, {}, "half of"),
    "du/dr times the vector": (slope_times_vector, {}, "1/r is missing"),
    "only one atom": (first_atom_only, {}, "only one of the two atoms"),
    "= for +=": (overwritten, {}, "overwritten"),
    "jump of the energy": (jumping, {}, "energy jumps at the cutoff"),
    "cutoff not applied": (lambda x: lennard_jones(x, cutoff=1e3), {"cutoff": 2.5}, "cutoff 2.5 is not applied"),
    "no minimum image": (lambda x: lennard_jones(x), {"cell": 8.0}, "minimum image is missing"),
    "one direction": (one_direction, {}, "one direction"),
    "cutoff of components": (in_a_cube, {"cell": 8.0, "cutoff": 2.5}, "acts on the components"),
    "wrapped positions": (wrapped_positions, {"cell": 8.0, "cutoff": 2.5}, "differences are not"),
    "with itself": (itself, {}, "meets itself"),
    "no gradient": (not_a_gradient, {}, "not the gradient of any energy"),
    "a component missing": (planar, {}, "component"),
    "factor 2 in one term": (lambda r: 24 / r**13 - 24 / r**7, {}, "48"),
    "exponent": (lambda r: 48 / r**13 - 24 / r**6, {}, "exponent"),
    "energy's exponents": (lambda r: 48 / r**12 - 24 / r**6, {}, "1/r is missing"),
    "law with du/dr": (lambda r2: (4 * (r2**-6 - r2**-3), 24 * (2 * r2**-6 - r2**-3)), {}, "1/r is missing"),
    "twice": (lambda x: _pairs(x, lambda r: 96 / r**13 - 48 / r**7), {}, "twice"),
    "exponent beside the energy": (lambda r: (48 / r**13 - 24 / r**8, 4 / r**12 - 4 / r**6), {}, "24 r^−7"),
}
