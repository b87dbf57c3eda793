"""Whether error bars are right: runs of a small Lennard-Jones liquid, what each claims, and what they scatter by.

python docs/measure_error_bars.py FOLDER [--write]

FOLDER keeps the sums of all runs. Those that are there already are not made again, so that another estimate is tried
in seconds. --write puts the table into docs/accuracy.md.
"""

import sys
from functools import partial
from pathlib import Path

import numpy as np

import minimd as md
from minimd.core.diagnosis.report import drift_of_walk
from minimd.core.structure.statistics import mean_and_error

N_RUNS, LENGTHS = 40, (100, 400)  # τ
EDGE, DENSITY, TEMPERATURE, TIMESTEP = 3, 0.8, 0.85, 0.005  # 108 atoms
BATHS = {
    "rescaling, 10 τ": lambda seed: md.StochasticVelocityRescaling.with_relaxation_time(
        TIMESTEP, TEMPERATURE, 10.0, seed=seed
    ),
    "Langevin, 0.5/τ": lambda seed: md.LangevinBAOAB(TIMESTEP, TEMPERATURE, 0.5, seed=seed),
}
ROWS = {
    "mean of a series: temperature": "mean temperature",
    "mean of a series: potential_energy": "mean potential energy",
    "mean of a series: pressure": "mean pressure",
    "drift: of the energy": "drift of the energy",
    "displacement: diffusion": "D from displacements",
    "velocity: diffusion": "D from velocities",
    "displacement: msd": "displacements, each lag",
    "velocity: vacf": "velocity autocorrelation, each lag",
    "velocity: integral": "integral of velocity autocorrelation, each lag",
    "stress: viscosity": "viscosity",
    "stress: autocorrelation": "stress autocorrelation, each lag",
    "stress: integral": "integral of stress autocorrelation, each lag",
    "structure: g": "g(r), each bin",
    "profile: density_X": "density profile, each layer",
    "profile: temperature": "temperature profile, each layer",
    "fluctuations: temperature": "temperature of `Fluctuations`",
    "fluctuations: heat_capacity_v": "heat capacity",
}
PAGE, BEGIN, END = (
    Path(__file__).parent / "accuracy.md",
    "<!-- measure_error_bars.py: begin -->",
    "<!-- measure_error_bars.py: end -->",
)
MELTING, SETTLING, PER_TAU = 4000, 16_000, round(1.0 / TIMESTEP)  # steps
OBSERVERS = {
    "displacement": partial(md.observers.MeanSquareDisplacement, every=20),
    "velocity": partial(md.observers.VelocityAutocorrelation, every=10),
    "stress": partial(md.observers.Viscosity, every=10),
    "fluctuations": partial(md.observers.Fluctuations, every=20),
    "structure": partial(md.observers.RadialDistribution, n_bins=60, every=100),
    "profile": partial(md.observers.Profile, n_bins=10, every=100),
}


def liquid(bath, seed):
    """108 atoms in equilibrium."""
    positions, edges = md.lattice.crystal("fcc", [EDGE] * 3, md.lattice.constant_from_density("fcc", DENSITY))
    made = md.Simulation(
        md.System(positions, cell=edges), md.LennardJones(1.0, 1.0, 2.5), BATHS["rescaling, 10 τ"](seed), threads=1
    )
    made.set_temperature(2.0 * TEMPERATURE, seed=seed)
    made.equilibrate(MELTING, TEMPERATURE)
    made.run(SETTLING, every=SETTLING, progress=False)
    made = md.Simulation(made.system, md.LennardJones(1.0, 1.0, 2.5), BATHS[bath](seed + 1000), threads=1)
    made.run(SETTLING // 4, every=SETTLING, progress=False)
    return made


def make(file, bath, seed):
    """Write the sums of a run at each length, and its record."""
    simulation, looking, kept, done = liquid(bath, seed), {name: one() for name, one in OBSERVERS.items()}, {}, 0
    for length in LENGTHS:
        record = simulation.run(
            (length - done) * PER_TAU, every=PER_TAU // 4, observers=list(looking.values()), progress=False
        )
        done, series = length, record.columns()
        kept |= {
            f"{length}/{name}/{key}": np.array(value)
            for name, one in looking.items()
            for key, value in one.state().items()
        }
        kept |= {
            f"record/{name}": np.concatenate([kept.get(f"record/{name}", one[:1]), one[1:]])
            for name, one in series.items()
        }
    np.savez(file, **kept)


def of_result(result):
    """Values and errors by name: single numbers as arrays of one."""
    both = {**result.numbers(), **result.columns()}
    return {name: np.atleast_1d([both[name], both[f"{name}_error"]]) for name in both if f"{name}_error" in both}


def of_run(file, length):
    """Values and errors of everything at a length of a run, (2, n) each, by name."""
    found, looked = {}, np.load(file)
    for name, observer in OBSERVERS.items():
        one, start = observer(), f"{length}/{name}/"
        one.restore({key.removeprefix(start): looked[key] for key in looked.files if key.startswith(start)})
        found |= {f"{name}: {what}": np.reshape(both, (2, -1)) for what, both in of_result(one.result()).items()}
    time = looked["record/time"]
    now = time <= time[0] + length
    series = {key.removeprefix("record/"): looked[key][now] for key in looked.files if key.startswith("record/")}
    for name in ("temperature", "potential_energy", "pressure"):
        found[f"mean of a series: {name}"] = np.array(mean_and_error(series[name]))[:, None]
    slope = drift_of_walk(time[now], series["conserved_energy"])
    return found | {"drift: of the energy": np.array([[slope.slope], [slope.error]])}


def claimed_and_seen(runs, name):
    """Of the entries that most runs have: claimed error over scatter, the share within two errors, their number."""
    n = min(run[name].shape[1] for run in runs)
    values, errors = np.array([run[name][:, :n] for run in runs]).transpose(1, 0, 2)
    has_both = np.isfinite(values) & np.isfinite(errors)  # D is NaN in a run that is not diffusive yet
    values, errors = np.where(has_both, values, np.nan), np.where(has_both, errors, np.nan)
    known = has_both.mean(axis=0) > 0.75
    known[known] = np.nanstd(values[:, known], axis=0) > 0.0
    values, errors, has_both = values[:, known], errors[:, known], has_both[:, known]
    ratios = np.sqrt(np.nanmean(errors**2, axis=0) / np.nanvar(values, axis=0, ddof=1))
    is_within = np.abs(values - np.nanmean(values, axis=0)) < 2.0 * errors
    return np.median(ratios), is_within.sum() / has_both.sum(), known.sum()


def table(folder):
    """Lines of a table in Markdown."""
    columns = {(bath, length): files_of(folder, bath) for bath in BATHS for length in LENGTHS}
    columns = {
        (bath, length): [of_run(file, length) for file in files] for (bath, length), files in columns.items() if files
    }
    yield f"| error bar of | {' | '.join(f'{bath}; {length} τ' for bath, length in columns)} |"
    yield f"|{' --- |' * (1 + len(columns))}"
    for name, words in ROWS.items():
        cells = [
            f"{ratio:.2f}, {100.0 * share:.0f} %"
            for ratio, share, _ in (claimed_and_seen(runs, name) for runs in columns.values())
        ]
        yield f"| {words} | {' | '.join(cells)} |"


def files_of(folder, bath):
    """The files of runs with a bath."""
    return sorted(folder.glob(f"{bath.split(',')[0].replace(' ', '-')}-*.npz"))


def main(folder, write):
    """Make the runs that are missing, and print the table."""
    folder.mkdir(exist_ok=True)
    for bath in BATHS:
        for seed in range(1, N_RUNS + 1):
            file = folder / f"{bath.split(',')[0].replace(' ', '-')}-{seed}.npz"
            if not file.exists():
                make(file, bath, seed)
    text = "\n".join(table(folder))
    print(text)
    if write:
        before, _, rest = PAGE.read_text(encoding="utf-8").partition(BEGIN)
        PAGE.write_text(f"{before}{BEGIN}\n{text}\n{END}{rest.partition(END)[2]}", encoding="utf-8")


if __name__ == "__main__":
    main(Path(sys.argv[1]), "--write" in sys.argv)
