"""What the suite catches: changes of one token each, made in a copy, and the test that finds each of them.

    python tests/mutants.py                 all of them; prints a line for each, and the share that was caught
    python tests/mutants.py 3 17 40-50      those with these numbers
    python tests/mutants.py neighbors       those in files whose names contain this

A mutant is caught if a test fails. Each runs the tests that its row names first, and then, if these pass, all others that are not slow. Mutants
that change what kernels compute are compiled anew, which is most of the time: some two minutes each. Exit code: 0 if 95 % were caught.
"""

import os
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path
from time import perf_counter

ROOT = Path(__file__).parents[1]
WANTED = 0.95  # the share that must be caught

FORCES, LISTS, LAWS = (
    "test_clusters test_potentials",
    "test_neighbors test_clusters",
    "test_potentials test_truncation test_reference_lammps",
)
STEPS, BATHS, RIGID = (
    "test_integrators test_compositions",
    "test_thermostats test_fixed_point",
    "test_constraints test_reference_constraints",
)
PRESSURE, FILES, SEEN = "test_constant_pressure", "test_h5md test_present_state", "test_observers test_fluctuations"
ENGINE = "test_side_by_side test_simulation test_present_state"

MUTANTS = [  # file in minimd/, old, new, tests that are run first
    # forces
    ("forces/cluster_loop.py", "own_share, scale = 0.5 if", "own_share, scale = 1.0 if", FORCES),
    ("forces/cluster_loop.py", "near = r2 < numbers[0]", "near = r2 < numbers[0] * 0.999", FORCES),
    ("forces/cluster_loop.py", "forces[place + n_lanes] -= without", "forces[place + n_lanes] += without", FORCES),
    ("forces/cluster_loop.py", "plus_virial(gy, dz, yz, steps)", "plus_virial(gy, dx, yz, steps)", FORCES),
    ("forces/cluster_loop.py", "lane == n_lanes - 1)", "lane == 0)", FORCES),
    ("forces/cluster_loop.py", "at_c, lanes) + 0.5 * in_steps", "at_c, lanes) + 1.0 * in_steps", FORCES),
    ("forces/cluster_loop.py", "-= n_laws * BIAS", "+= n_laws * BIAS", "test_fixed_point"),
    # potentials
    (
        "potentials/pair_loop.py",
        "fx, fy, fz = fx - gx, fy - gy, fz - gz",
        "fx, fy, fz = fx - gx, fy - gy, fz + gz",
        FORCES,
    ),
    ("potentials/pair_loop.py", "if r2 < numbers[0]:", "if r2 <= 0.99 * numbers[0]:", FORCES),
    (
        "potentials/pair_loop.py",
        "dx, dy, dz = dx + pairs.translations[t, 0]",
        "dx, dy, dz = dx - pairs.translations[t, 0]",
        FORCES,
    ),
    ("potentials/pair_loop.py", "energies[j] += 0.5 * u", "energies[j] += u", FORCES),
    (
        "potentials/pair_loop.py",
        "in_steps(hy * dz, sums), in_steps(hx * dz, sums)",
        "in_steps(hx * dz, sums), in_steps(hy * dz, sums)",
        FORCES,
    ),
    ("potentials/laws.py", "(2.0 * scale * s6 - scale) * (s6 * s2)", "(2.0 * scale * s6 + scale) * (s6 * s2)", LAWS),
    (
        "potentials/laws.py",
        "-0.5 * k * longest * longest * log(rest), -k / rest",
        "-0.5 * k * longest * longest * log(rest), -0.5 * k / rest",
        LAWS,
    ),
    ("potentials/laws.py", "(1.2 * s9 - 3.0 * s3)", "(1.2 * s9 - s3)", "test_fields test_potentials"),
    (
        "potentials/laws.py",
        "return parameters[0] * u, parameters[0] * f",
        "return parameters[0] * u, f",
        "test_polymers test_topology",
    ),
    (
        "potentials/truncation.py",
        "- (r - parameters[2]) * parameters[1], f + parameters[1] / r",
        "- (r - parameters[2]) * parameters[1], f - parameters[1] / r",
        LAWS,
    ),
    ("potentials/truncation.py", "return u - parameters[0], f", "return u, f", LAWS),
    ("potentials/truncation.py", "(x * (15.0 - 6.0 * x) - 10.0)", "(x * (15.0 + 6.0 * x) - 10.0)", LAWS),
    ("potentials/truncation.py", "c * f - 2.0 * slope * u", "c * f - slope * u", LAWS),
    ("potentials/truncation.py", "s * f - 2.0 * slope * u", "s * f + 2.0 * slope * u", LAWS),
    (
        "potentials/fields.py",
        "anchors[n, 0], y - sites.anchors[n, 1]",
        "anchors[n, 0], y + sites.anchors[n, 1]",
        "test_fields",
    ),
    ("potentials/fields.py", "power += _rate(found)", "power = _rate(found)", "test_fields"),
    (
        "potentials/fields.py",
        "moves = spring.start <= self.time < spring.end",
        "moves = spring.start < self.time <= spring.end",
        "test_fields",
    ),
    ("potentials/dihedrals.py", "in_steps(0.25 * u, sums)", "in_steps(u, sums)", "test_polymers test_topology"),
    ("potentials/angles.py", "size * cosine - ab * sine, ab * cosine", "size * cosine + ab * sine, ab * cosine", LAWS),
    # neighbors
    ("neighbors/search.py", "within[len(within) // 2 + 1 :]", "within[len(within) // 2 + 2 :]", LISTS),
    ("neighbors/search.py", "first_atom, row = i + 1 if", "first_atom, row = i if", LISTS),
    ("neighbors/search.py", "if nearest == row:", "if nearest != row:", LISTS),
    ("neighbors/search.py", "-(-grid.reach // grid.counts)", "(grid.reach // grid.counts)", LISTS),
    ("neighbors/search.py", "(cell_z != 0 and not pbc[2])", "(cell_z != 0 and not pbc[1])", LISTS),
    ("neighbors/verlet_list.py", "limit = 0.5 * margin", "limit = margin", LISTS),
    (
        "neighbors/verlet_list.py",
        "- 0.5 * (1.0 - self._stretch) * self.cutoff",
        "",
        "test_constant_pressure test_side_by_side test_neighbors",
    ),
    (
        "neighbors/verlet_list.py",
        "if not dx * dx + dy * dy + dz * dz <= limit2:",
        "if dx * dx + dy * dy + dz * dz > limit2:",
        LISTS,
    ),
    (
        "neighbors/verlet_list.py",
        "compute_uv=False)[-1]",
        "compute_uv=False)[0]",
        "test_constant_pressure test_side_by_side test_neighbors",
    ),
    ("neighbors/pair_list.py", "np.triu_indices(n, k=1)", "np.triu_indices(n, k=0)", LISTS),
    (
        "neighbors/pair_list.py",
        "before.follow(cell, self.pairs.translations)",
        "before.follow(cell, self.offsets)",
        PRESSURE,
    ),
    (
        "neighbors/cluster_search.py",
        "low, high = bottom[i] - along, top[i] + along",
        "low, high = bottom[i] - along, top[i]",
        LISTS,
    ),
    ("neighbors/cluster_search.py", "while j < last and top[j] < low:", "while j < last and bottom[j] < low:", LISTS),
    ("neighbors/cluster_search.py", "(lane + 1) << (lane + 1)) << LANES_FROM", "lane << lane) << LANES_FROM", LISTS),
    ("neighbors/cluster_search.py", "if ghost == home and other < slot:", "if ghost == home and other > slot:", LISTS),
    ("neighbors/cluster_search.py", "HOME + int(9.0 * a + 3.0 * b + c)", "HOME - int(9.0 * a + 3.0 * b + c)", LISTS),
    (
        "neighbors/cluster_search.py",
        "-depth if run_x > 0 else 0, depth + 1",
        "-depth if run_x > 0 else 0, depth",
        LISTS,
    ),
    ("neighbors/domains.py", "< 1.0 - columns.along[0]", "< 1.0", LISTS),
    ("neighbors/domains.py", "(image_y != 0 and not pbc[1])", "(image_y != 0 and not pbc[0])", LISTS),
    ("neighbors/domains.py", "low - OUTWARD * abs(low)", "low + 1e5 * OUTWARD * abs(low)", LISTS),
    # integrators
    (
        "integrators/splitting/flows.py",
        "return velocity + duration * inverse_mass * force",
        "return velocity - duration * inverse_mass * force",
        STEPS,
    ),
    (
        "integrators/splitting/flows.py",
        "return position + duration * velocity",
        "return position + 0.5 * duration * velocity",
        STEPS,
    ),
    (
        "integrators/splitting/flows.py",
        "momentum + times * select",
        "momentum + 2.0 * times * select",
        "test_fixed_point",
    ),
    (
        "integrators/splitting/verlet.py",
        "substeps = (Drift(0.5), Kick(1.0), Drift(0.5))",
        "substeps = (Drift(0.5), Kick(1.0), Drift(0.4))",
        STEPS,
    ),
    ("integrators/splitting/verlet.py", "opening = (Kick(-0.5),)", "opening = (Kick(0.5),)", STEPS),
    ("integrators/splitting/compositions.py", "-1.17767998417887100695", "1.17767998417887100695", STEPS),
    ("integrators/splitting/compositions.py", "-0.0390563049223486", "-0.0390563049223496", STEPS),
    ("integrators/splitting/compositions.py", "0.18453964097831570709", "0.18453964097831570609", STEPS),
    (
        "integrators/splitting/thermostats.py",
        "-np.expm1(-2.0 * self.friction * duration)",
        "-np.expm1(-self.friction * duration)",
        BATHS,
    ),
    (
        "integrators/splitting/thermostats.py",
        "2.0 * noise.standard_gamma(0.5 * (bath.n_dof - 1))",
        "2.0 * noise.standard_gamma(0.5 * bath.n_dof)",
        BATHS,
    ),
    ("integrators/splitting/thermostats.py", "2.0 * one * sqrt(kept * share)", "one * sqrt(kept * share)", BATHS),
    (
        "integrators/splitting/thermostats.py",
        "bath.energy += kinetic * (scale * scale - 1.0)",
        "bath.energy += kinetic * (scale - 1.0)",
        BATHS,
    ),
    ("integrators/splitting/thermostats.py", "bath.contact, bath.step % STEPS]", "bath.contact, 0]", BATHS),
    (
        "integrators/splitting/barostats.py",
        "0.5 * state.thermal / state.volume",
        "state.thermal / state.volume",
        PRESSURE,
    ),
    ("integrators/splitting/barostats.py", "2.0 / 3.0 * log(larger)", "1.0 / 3.0 * log(larger)", PRESSURE),
    ("integrators/splitting/barostats.py", "(1.0 + 0.5 * n_free) * entropy", "(0.5 * n_free) * entropy", PRESSURE),
    (
        "integrators/splitting/splitting.py",
        "around.work += duration * around.power",
        "around.work -= duration * around.power",
        "test_fields",
    ),
    (
        "integrators/splitting/splitting.py",
        "type(first)(first.coefficient + last.coefficient)",
        "type(first)(first.coefficient)",
        STEPS,
    ),
    # constraints
    ("constraints/settle.py", "r_a = 2.0 * fraction * height", "r_a = fraction * height", RIGID),
    ("constraints/settle.py", "gamma = xb0 * yb1 - xb1 * yb0", "gamma = xb0 * yb1 + xb1 * yb0", RIGID),
    (
        "constraints/settle.py",
        "recoil = 1.0 / duration, -inverse_masses[a]",
        "recoil = 1.0 / duration, -2.0 * inverse_masses[a]",
        RIGID,
    ),
    ("constraints/pairs.py", "w * w * dot(s, s), w * dot(p, s)", "w * dot(s, s), w * dot(p, s)", RIGID),
    ("constraints/pairs.py", "(targets[k] - along)", "(targets[k] + along)", RIGID),
    ("constraints/networks.py", "bonds.second[k], total[k] / duration, s[k]", "bonds.second[k], total[k], s[k]", RIGID),
    ("constraints/networks.py", "x[k] = 0.5 * (lengths2[k]", "x[k] = 0.25 * (lengths2[k]", RIGID),
    ("constraints/networks.py", "scale = gap / (2.0 * (atoms", "scale = gap / (1.0 * (atoms", RIGID),
    (
        "constraints/linear_triatomic.py",
        "kappa = alpha * inverse_masses[a] - beta",
        "kappa = alpha * inverse_masses[a] + beta",
        RIGID,
    ),
    # structure, engine
    (
        "structure/observables.py",
        "return 0.5 * mass * (vx**2",
        "return mass * (vx**2",
        "test_conserved test_simulation",
    ),
    (
        "structure/observables.py",
        "(3 if leaves_out_center",
        "(0 if leaves_out_center",
        "test_rigid_temperature test_thermostats",
    ),
    (
        "structure/observables.py",
        "(2.0 * kinetic + float(np.trace(virial)))",
        "(2.0 * kinetic - float(np.trace(virial)))",
        "test_reference_lammps test_constant_pressure",
    ),
    (
        "structure/observables.py",
        "ly += masses[i] * (z * vx - x * vz)",
        "ly += masses[i] * (x * vz - z * vx)",
        "test_conserved",
    ),
    (
        "engine/engine.py",
        "return time + (step - first) * self.method.timestep",
        "return time + step * self.method.timestep",
        ENGINE,
    ),
    (
        "engine/engine.py",
        "wants_energy, march = is_due or (with_energy and at == end)",
        "wants_energy, march = (with_energy and at == end)",
        PRESSURE,
    ),
    (
        "engine/engine.py",
        "step + self.noise_shift, 0",
        "step, 0",
        "test_thermostats test_simulation test_present_state",
    ),
    (
        "engine/engine.py",
        "self.surroundings.power = True, self.interactions.power",
        "self.surroundings.power = True, 0.0",
        "test_fields test_present_state",
    ),
    (
        "engine/observation.py",
        "look.total_energy - look.engine.reservoir_energy",
        "look.total_energy + look.engine.reservoir_energy",
        "test_thermostats test_conserved",
    ),
    (
        "engine/cell_rescaling.py",
        "tensor += thermal * np.eye(3) - np.outer",
        "tensor += np.eye(3) - np.outer",
        PRESSURE,
    ),
    (
        "engine/cell_rescaling.py",
        "return step % self.barostat.every == 0",
        "return step % self.barostat.every == 1",
        PRESSURE,
    ),
    (
        "engine/cell_rescaling.py",
        "virial = virial - self._inner_virial()",
        "virial = virial + self._inner_virial()",
        PRESSURE,
    ),
    # files, observers
    ("files/h5md_restart.py", '"clock_step": clock[0]', '"clock_step": clock[0] + 1', FILES),
    ("files/h5md_restart.py", "for name in (RESTART, EARLIER):", "for name in (EARLIER, RESTART):", FILES),
    (
        "files/h5md_restart.py",
        "return {} if name is None else read_group",
        "return {} if name is not None else read_group",
        FILES,
    ),
    (
        "files/frame_block.py",
        "self._entries[column.path][self.n_frames] =",
        "self._entries[column.path][self.n_frames - 1] =",
        FILES,
    ),
    ("files/journaled_file.py", "max(start, self._committed)", "min(start, self._committed)", FILES + " test_kills"),
    (
        "files/journaled_file.py",
        "is_changed = bool(self._pieces) or",
        "is_changed = bool(self._pieces) and",
        FILES + " test_kills",
    ),
    ("observers/correlator.py", "past = (slot + p - j) % p", "past = (slot + j) % p", SEEN),
    ("observers/correlator.py", "counts[level, first:n_kept] += 1.0", "counts[level, :n_kept] += 1.0", SEEN),
    ("observers/correlator.py", "np.arange(points) * RATIO **", "np.arange(1, points + 1) * RATIO **", SEEN),
    ("observers/fluctuations.py", "c_v = 0.5 * f * k_B / (1.0 - 2.0 *", "c_v = 0.5 * f * k_B / (1.0 - 1.0 *", SEEN),
    (
        "observers/radial_distribution.py",
        "(scene.numbers[b] - (a == b)) / (1.0 + (a == b))",
        "(scene.numbers[b]) / (1.0 + (a == b))",
        SEEN,
    ),
    (
        "observers/radial_distribution.py",
        "t[0], positions[i, 1] - t[1], positions[i, 2] - t[2]",
        "t[0], positions[i, 1] - t[1], positions[i, 2] + t[2]",
        SEEN,
    ),
]


def main(chosen: list[str]) -> int:
    """Try the mutants that were chosen; see above."""
    numbers = [k for k in range(len(MUTANTS)) if not chosen or any(_is_meant(one, k) for one in chosen)]
    missed = []
    for k in numbers:
        file, old, new, first = MUTANTS[k]
        start = perf_counter()
        caught_by = tried(file, old, new, first.split())
        missed += [] if caught_by else [k]
        print(
            f"{k:3d}  {file:45s} {old[:40]!r} -> {new[:40]!r}: {caught_by or 'NOT CAUGHT'}  ({perf_counter() - start:.0f} s)",
            flush=True,
        )
    share = 1.0 - len(missed) / max(1, len(numbers))
    print(f"{len(numbers) - len(missed)} of {len(numbers)} caught, {share:.0%}; not caught: {missed or 'none'}")
    return int(share < WANTED)


def _is_meant(one: str, k: int) -> bool:
    low, _, high = one.partition("-")
    return int(low) <= k <= int(high or low) if low.isdigit() else one in MUTANTS[k][0]


def tried(file: str, old: str, new: str, first: list[str]) -> str:
    """The test that fails if `old` is `new` in a file; empty if none does."""
    with tempfile.TemporaryDirectory() as folder:
        copy = Path(folder) / "copy"
        shutil.copytree(
            ROOT, copy, symlinks=True, ignore=shutil.ignore_patterns(".git", ".venv", "__pycache__", "site", "*_cache")
        )
        source = copy / "minimd" / file
        text = source.read_text()
        if text.count(old) != 1:
            raise SystemExit(f"a mutant must change one place; {old!r} stands {text.count(old)} times in minimd/{file}")
        source.write_text(text.replace(old, new))
        tests = [str(copy / "tests" / f"{name}.py") for name in first]
        return failed(copy, tests) or failed(copy, ["tests"])


def failed(copy: Path, tests: list[str]) -> str:
    """The first test that fails among some tests of a copy; empty if all pass."""
    environment = os.environ | {
        "PYTHONPATH": str(copy),
        "NUMBA_CACHE_DIR": str(copy / ".numba"),
        "OPENBLAS_NUM_THREADS": "1",
    }
    command = [
        sys.executable,
        "-m",
        "pytest",
        "-x",
        "-q",
        "--no-header",
        "-p",
        "no:cacheprovider",
        "--tb=no",
        "-rfE",
        *tests,
    ]
    answer = subprocess.run(command, cwd=copy, env=environment, capture_output=True, text=True, check=False)
    found = [
        line.split(" - ")[0].removeprefix("FAILED ").removeprefix("ERROR ")
        for line in answer.stdout.splitlines()
        if line.startswith(("FAILED", "ERROR"))
    ]
    return "" if answer.returncode == 0 else found[0] if found else f"exit code {answer.returncode}"


if __name__ == "__main__":
    raise SystemExit(main(sys.argv[1:]))
