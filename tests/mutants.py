"""What the suite catches: changes of one token each, made in a copy, and the test that finds each of them.

    python tests/mutants.py                 all of them; prints a line for each, and the share that was caught
    python tests/mutants.py 3 17 40-50      those with these numbers
    python tests/mutants.py neighbors       those in files whose names contain this

A mutant is caught if a test fails. Each runs the tests that its heading names first, and then, if these pass, all
others that are not slow. Mutants that change what kernels compute are compiled anew, which is most of the time: half a
minute each. Exit code: 0 if 95 % were caught."""

import os
import re
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path
from time import perf_counter
from typing import NamedTuple

ROOT = Path(__file__).parents[1]
WANTED = 0.95  # the share that must be caught
MUTANTS = """
forces/cluster_loop.py: forces/test_lists potentials/test_laws
    own_share, scale = 0.5 if => own_share, scale = 1.0 if
    near = r2 < numbers[0] => near = r2 < numbers[0] * 0.999
    forces[place + n_lanes] -= without => forces[place + n_lanes] += without
    plus_virial(gy, dz, yz, steps) => plus_virial(gy, dx, yz, steps)
    lane == n_lanes - 1) => lane == 0)
    at_c, lanes) + 0.5 * in_steps => at_c, lanes) + 1.0 * in_steps
forces/cluster_loop.py: forces/test_fixed_point
    -= n_laws * BIAS => += n_laws * BIAS
compiled/simd/functions.py: compiled/test_vectors
    k + 1.0, k), select(is_large, 0.5 * m => k, k), select(is_large, 0.5 * m
    fma(k, -REST_OF_PI, fma(k, -HALF_PI, x)) => fma(k, -HALF_PI, x)
    select(y < 0.0, -angle, angle) => angle
potentials/pair_loop.py: forces/test_lists potentials/test_laws
    fx, fy, fz = fx - gx, fy - gy, fz - gz => fx, fy, fz = fx - gx, fy - gy, fz + gz
    if r2 < numbers[0]: => if r2 <= 0.99 * numbers[0]:
    dx, dy, dz = dx + pairs.translations[t, 0] => dx, dy, dz = dx - pairs.translations[t, 0]
    energies[j] += 0.5 * u => energies[j] += u
    in_steps(hy * dz, steps), in_steps(hx * dz, steps) => in_steps(hx * dz, steps), in_steps(hy * dz, steps)
potentials/laws.py: potentials/test_laws potentials/test_truncation potentials/test_reference_lammps
    (2.0 * scale * s6 - scale) * (s6 * s2) => (2.0 * scale * s6 + scale) * (s6 * s2)
    return u, -k / rest + select => return u, -0.5 * k / rest + select
potentials/laws.py: potentials/test_laws potentials/test_fields potentials/test_formulas
    (1.2 * s9 - 3.0 * s3) => (1.2 * s9 - s3)
    return parameters[0] * u, parameters[0] * f => return parameters[0] * u, f
potentials/truncation.py: potentials/test_laws potentials/test_truncation potentials/test_reference_lammps
    f + parameters[1] / r => f - parameters[1] / r
    return u - parameters[0], f => return u, f
    (x * (15.0 - 6.0 * x) - 10.0) => (x * (15.0 + 6.0 * x) - 10.0)
    c * f - 2.0 * slope * u => c * f - slope * u
    s * f - 2.0 * slope * u => s * f + 2.0 * slope * u
potentials/fields.py: potentials/test_laws potentials/test_fields potentials/test_formulas
    anchors[n, 0], y - anchors[n, 1] => anchors[n, 0], y + anchors[n, 1]
    power += _rate(found) => power = _rate(found)
    moves = self.start <= term.time < self.end => moves = self.start < term.time <= self.end
potentials/links.py: potentials/test_laws
    in_steps(lane(u, k) / n_sites, steps) => in_steps(lane(u, k), steps)
potentials/links.py: potentials/test_laws potentials/test_truncation potentials/test_reference_lammps
    size * cosine - ab * sine, ab * cosine => size * cosine + ab * sine, ab * cosine
forces/wave_sum.py: potentials/test_laws potentials/test_coulomb
    rc - im, rs + ic, rc + im, ic - rs => rc - im, rs + ic, rc + im, ic + rs
    fma(nc, a[3], fma(ns, a[0], pzi)) => fma(nc, a[3], fma(ns, -a[0], pzi))
    u + g * kz * kz, g * ky => u + g * kz * ky, g * ky
forces/mesh_sum.py: potentials/test_laws potentials/test_coulomb
    min(shape[4], last - start) => min(shape[4], last - start - 1)
    fb = q2 * shape[0] * total(along_x * window), q2 * => fb = q2 * shape[0] * total(along_x * bend), q2 *
    2.0 * bends[:, None] * k => bends[:, None] * k
    mesh.shares[i] * rest => 0.5 * mesh.shares[i] * rest
forces/mesh_window.py: potentials/test_coulomb
    legendre.legval(y, wave.series) - wave.at_end => legendre.legval(y, wave.series)
potentials/coulomb.py: potentials/test_laws potentials/test_coulomb
    v + select(is_near, u, 0.0), g + select => v + u, g + select
    select(is_near, polynomial(t, slopes), -inverse3) => select(is_near, polynomial(t, slopes), inverse3)
potentials/prolates.py: potentials/test_coulomb
    wave.series[2] - wave.at_end / 3.0 => wave.series[2] + wave.at_end / 3.0
    0.5 * bend * kappa - shape => 0.5 * bend * kappa + shape
neighbors/search.py: neighbors/test_pair_list forces/test_lists neighbors/test_cluster_list
    within[len(within) // 2 + 1 :] => within[len(within) // 2 + 2 :]
    first_atom, row = i + 1 if => first_atom, row = i if
    + crossed[2] == row: => + crossed[2] != row:
    -(-grid.reach // grid.counts) => (grid.reach // grid.counts)
    (cell_z != 0 and not pbc[2]) => (cell_z != 0 and not pbc[1])
neighbors/verlet_list.py: neighbors/test_pair_list forces/test_lists neighbors/test_cluster_list
    limit = 0.5 * margin => limit = margin
    if not dx * dx + dy * dy + dz * dz <= limit2: => if dx * dx + dy * dy + dz * dz > limit2:
neighbors/verlet_list.py: engine/test_barostat forces/test_same_bits neighbors/test_pair_list
    - 0.5 * (1.0 - self._stretch) * self.cutoff =>
    compute_uv=False)[-1] => compute_uv=False)[0]
neighbors/pair_list.py: neighbors/test_pair_list forces/test_lists neighbors/test_cluster_list
    np.triu_indices(n, k=1) => np.triu_indices(n, k=0)
neighbors/pair_list.py: neighbors/test_pair_list engine/test_barostat
    before.follow(cell, self.pairs.translations) => before.follow(cell, self.offsets)
neighbors/cluster_search.py: neighbors/test_pair_list forces/test_lists neighbors/test_cluster_list
    low, high = bottom[i] - along, top[i] + along => low, high = bottom[i] - along, top[i]
    while j < last and top[j] < low: => while j < last and bottom[j] < low:
    (lane + 1) << (lane + 1) => lane << lane
    if ghost == home and other < slot: => if ghost == home and other > slot:
    HOME + int(9.0 * a + 3.0 * b + c) => HOME - int(9.0 * a + 3.0 * b + c)
    -depth if run_x > 0 else 0, depth + 1 => -depth if run_x > 0 else 0, depth
neighbors/domains.py: neighbors/test_pair_list forces/test_lists neighbors/test_cluster_list
    < 1.0 - columns.along[2] => < 1.0
    (image_y and not is_crossed[1]) => (image_y and not is_crossed[0])
    low - OUTWARD * abs(low) => low + 1e5 * OUTWARD * abs(low)
integrators/splitting/flows.py: integrators/test_splittings integrators/test_laws
    return velocity + duration * inverse_mass * force => return velocity - duration * inverse_mass * force
    return position + duration * velocity => return position + 0.5 * duration * velocity
integrators/splitting/flows.py: forces/test_fixed_point
    momentum + times * select => momentum + 2.0 * times * select
integrators/splitting/rows.py: integrators/test_splittings integrators/test_laws
    substeps = (Drift(0.5), Kick(1.0), Drift(0.5)) => substeps = (Drift(0.5), Kick(1.0), Drift(0.4))
    -1.17767998417887100695 => 1.17767998417887100695
    -0.0390563049223486 => -0.0390563049323486
    0.18453964097831570709 => 0.18453964197831570709
integrators/splitting/thermostats.py: integrators/test_baths forces/test_fixed_point
    -np.expm1(-2.0 * self.friction * duration) => -np.expm1(-self.friction * duration)
    sum_of_squares(stream, n_dof - 1) => sum_of_squares(stream, n_dof)
    2.0 * one * sqrt(kept * share) => one * sqrt(kept * share)
    rescaling.heat[0] += kinetic * (square - 1.0) => rescaling.heat[0] += kinetic * square
    bath.contact, bath.step % STEPS] => bath.contact, 0]
integrators/splitting/barostats.py: engine/test_barostat
    0.5 * state.thermal / state.volume => state.thermal / state.volume
    2.0 / 3.0 * log(larger) => 1.0 / 3.0 * log(larger)
    (1.0 + 0.5 * n_free) * entropy => (0.5 * n_free) * entropy
integrators/splitting/steps.py: potentials/test_laws potentials/test_fields potentials/test_formulas
    self._around.work += duration => self._around.work -= duration
integrators/splitting/substeps.py: integrators/test_splittings integrators/test_laws
    (sequence.pop().coefficient + substep.coefficient) => (sequence.pop().coefficient)
constraints/closed_forms.py: constraints/test_solvers constraints/test_references
    gamma = xb0 * yb1 - xb1 * yb0 => gamma = xb0 * yb1 + xb1 * yb0
    -share / (1.0 - 2.0 * share) * push => -2.0 * share / (1.0 - 2.0 * share) * push
    w * w * dot(s, s), w * dot(p, s) => w * dot(s, s), w * dot(p, s)
    (numbers(targets, (), block) - dot(r, minus(v, u))) => (numbers(targets, (), block) + dot(r, minus(v, u)))
    kappa, q = alpha * wa - beta * wc => kappa, q = alpha * wa + beta * wc
constraints/networks.py: constraints/test_solvers constraints/test_references
    i, j, total[k] / duration, s[k] => i, j, total[k], s[k]
    x[k] = 0.5 * (bonds.lengths2[k] => x[k] = 0.25 * (bonds.lengths2[k]
    scale = gap / (2.0 * (atoms => scale = gap / (1.0 * (atoms
constraints/groups.py: constraints/test_solvers constraints/test_references
    2.0 * share * height => share * height
structure/observables.py: simulation/test_observables simulation/test_simulation
    return 0.5 * mass * (vx**2 => return mass * (vx**2
    ly += masses[i] * (z * vx - x * vz) => ly += masses[i] * (x * vz - z * vx)
structure/observables.py: constraints/test_runs integrators/test_baths
    (3 if leaves_out_center => (0 if leaves_out_center
structure/observables.py: potentials/test_reference_lammps engine/test_barostat
    (2.0 * kinetic + float(np.trace(virial))) => (2.0 * kinetic - float(np.trace(virial)))
engine/engine.py: forces/test_same_bits simulation/test_simulation simulation/test_observables
    return time + (step - first) * self._pace => return time + step * self.method.timestep
engine/engine.py: engine/test_barostat
    at == due or (with_energy and at == end) => (with_energy and at == end)
engine/engine.py: integrators/test_baths simulation/test_simulation simulation/test_observables
    wants_energy, step + self.noise_shift) => wants_energy, step)
engine/engine.py: potentials/test_laws potentials/test_fields potentials/test_formulas simulation/test_observables
    self.surroundings.power = True, self.interactions.power => self.surroundings.power = True, 0.0
engine/observation.py: integrators/test_baths simulation/test_observables
    look.total_energy - look.engine.reservoir_energy => look.total_energy + look.engine.reservoir_energy
engine/cell_rescaling.py: engine/test_barostat
    tensor += thermal * np.eye(3) - np.outer => tensor += np.eye(3) - np.outer
    self.barostat.every - step % => self.barostat.every + step %
    virial = virial - self._inner_virial() => virial = virial + self._inner_virial()
files/h5md_digest.py: files/test_h5md files/test_trajectories files/test_interrupts simulation/test_observables
    "clock_step": clock[0] => "clock_step": clock[0] + 1
    for name in (RESTART, EARLIER): => for name in (EARLIER, RESTART):
    int(numbers["n_frames"]), arrays, name == EARLIER => int(numbers["n_frames"]), {}, name == EARLIER
files/h5md_writer.py: files/test_h5md simulation/test_observables
    self._room[column.path][self._n_waiting] = => self._room[column.path][self._n_waiting - 1] =
files/claim.py: files/test_h5md simulation/test_observables files/test_kills
    low, high = max(place, start), => low, high = min(place, start),
    is_changed = bool(pieces) or => is_changed = bool(pieces) and
observers/correlator.py: observers/test_observers
    past = (slot + p - j) % p => past = (slot + j) % p
    counts[level, first:n_kept] += 1.0 => counts[level, first + 1 : n_kept] += 1.0
    (entries * RATIO**level) => ((entries + 1) * RATIO**level)
observers/fluctuations.py: observers/test_observers
    0.5 * f * k_B / (1.0 - 2.0 * => 0.5 * f * k_B / (1.0 - 1.0 *
observers/radial_distribution.py: observers/test_observers
    (n[b] - (a == b)) / (1.0 + (a == b)) => (n[b]) / (1.0 + (a == b))
    positions[c, j] + t[c] => positions[c, j] + t[0]
    first = i + 1 - bin_start => first = i + 2 - bin_start
observers/scattering.py: observers/test_observers
    cx * cy - sx * sy => cx * cy + sx * sy
    np.linalg.inv(cell.vectors).T => np.linalg.inv(cell.vectors)
observers/stream.py: observers/test_stream
    length / time) => length * time)
    engine.step % self._rate => engine.step % self.every
"""  # file in minimd/: tests that are run first; below it old => new


class Mutant(NamedTuple):
    """One token of a file, and what stands there instead."""

    file: str
    old: str
    new: str
    first: list[str]


def listed() -> list[Mutant]:
    """All mutants, in the order of the table."""
    mutants, file, first = [], "", [""]
    for line in MUTANTS.strip().splitlines():
        if line.startswith(" "):
            old, _, new = line.strip().partition(" =>")
            mutants.append(Mutant(file, old, new.strip(), first))
        else:
            file, _, names = line.partition(": ")
            first = names.split()
    return mutants


def main(chosen: list[str]) -> int:
    """Try the mutants that were chosen; see above."""
    mutants, missed = listed(), []
    numbers = [k for k, one in enumerate(mutants) if any(_is_meant(word, k, one.file) for word in chosen or [""])]
    with tempfile.TemporaryDirectory() as cache:  # of kernels; what a mutant compiles anew is deleted behind it
        subprocess.run([sys.executable, "-c", "import minimd"], env=environment(ROOT, Path(cache)), check=True)
        for k in numbers:
            start, mutant = perf_counter(), mutants[k]
            caught_by = tried(mutant, Path(cache))
            missed += [] if caught_by else [k]
            change = f"{mutant.old[:40]} => {mutant.new[:40]}"
            seconds = f"{perf_counter() - start:.0f} s"
            print(f"{k:3d}  {mutant.file}  {change}: {caught_by or 'NOT CAUGHT'} ({seconds})", flush=True)
    share = 1.0 - len(missed) / max(1, len(numbers))
    print(f"{len(numbers) - len(missed)} of {len(numbers)} caught, {share:.0%}; not caught: {missed or 'none'}")
    return int(share < WANTED)


def _is_meant(one: str, k: int, file: str) -> bool:
    numbers = re.fullmatch(r"(\d+)(?:-(\d+))?", one)
    return int(numbers[1]) <= k <= int(numbers[2] or numbers[1]) if numbers else one in file


def tried(mutant: Mutant, cache: Path) -> str:
    """The test that fails if `old` is `new` in a file; empty if none does."""
    with tempfile.TemporaryDirectory() as folder:
        copy, kept = Path(folder) / "copy", {*cache.iterdir()}
        ignored = shutil.ignore_patterns(".git", ".venv", "__pycache__", "site", "*_cache")
        shutil.copytree(ROOT, copy, symlinks=True, ignore=ignored)
        source = copy / "minimd" / mutant.file
        text = source.read_text()
        if (n := text.count(mutant.old)) != 1:
            raise SystemExit(f"a mutant must change one place; {mutant.old!r} stands {n} times there")
        source.write_text(text.replace(mutant.old, mutant.new))
        tests = [str(copy / "tests" / f"{name}.py") for name in mutant.first]
        caught_by = failed(copy, tests, cache) or failed(copy, ["tests"], cache)
        for made in {*cache.iterdir()} - kept:
            shutil.rmtree(made)
        return caught_by


def environment(root: Path, cache: Path) -> dict[str, str]:
    """For processes that import the minimd in a folder."""
    return os.environ | {"PYTHONPATH": str(root), "NUMBA_CACHE_DIR": str(cache), "OPENBLAS_NUM_THREADS": "1"}


def failed(copy: Path, tests: list[str], cache: Path) -> str:
    """The first test that fails among some tests of a copy; empty if all pass."""
    command = [sys.executable, "-m", "pytest", "-x", "-q", "--no-header", "-p", "no:cacheprovider", "--tb=no", "-rfE"]
    where = {"cwd": copy, "env": environment(copy, cache)}
    answer = subprocess.run([*command, *tests], **where, capture_output=True, text=True, check=False)
    found = re.findall(r"^(?:FAILED|ERROR) (.*?)(?: - .*)?$", answer.stdout, re.M)
    return "" if answer.returncode == 0 else found[0] if found else f"exit code {answer.returncode}"


if __name__ == "__main__":
    raise SystemExit(main(sys.argv[1:]))
