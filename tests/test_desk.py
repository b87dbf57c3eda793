"""What a session at the desk meets: representations, signatures, data frames, text files and pictures of a record, progress bars."""

import csv
import io
import pydoc
import subprocess
import sys
import types
from pathlib import Path
from typing import get_args

import numpy as np
import pytest
from references import liquid

import minimd as md
from minimd.forces.options import Precision
from minimd.potentials.pair import MIXING, MixingName
from minimd.potentials.truncation import TRUNCATIONS, TruncationName
from minimd.structure import console
from minimd.structure.display import Displayed

KOB_ANDERSEN = md.LennardJones(
    {"A": (1.0, 1.0), "B": (0.5, 0.88)},
    cutoff={("A", "A"): 2.5, ("A", "B"): 2.0, ("B", "B"): 2.2},
    truncation="switched",
    mixing="geometric",
    pairs={("A", "B"): (1.5, 0.8)},
    switch_start=1.5,
    bonded_scale=(0.0, 0.0, 0.5),
    tail_correction=True,
)


def soft(r2, height):
    return height / r2, 2.0 * height / r2**2


CALLS = {  # that make the object again, in full
    "LennardJones(epsilon=0.0104, sigma=3.4, cutoff=8.5, truncation='shifted')": md.LennardJones(0.0104, 3.4, 8.5),
    "LennardJones(epsilon={'A': (1, 1), 'B': (0.5, 0.88)}, cutoff={('A', 'A'): 2.5, ('A', 'B'): 2, ('B', 'B'): 2.2}, truncation='switched', "
    "mixing='geometric', pairs={('A', 'B'): (1.5, 0.8)}, switch_start=1.5, bonded_scale=(0, 0, 0.5), tail_correction=True)": KOB_ANDERSEN,
    "PairPotential(law=soft, parameters=(3,), cutoff=None, truncation='shifted')": md.PairPotential(soft, (3.0,)),
    "BondPotential(law=soft, parameters=(2.0,))": md.BondPotential(soft, (2.0,)),
    "HarmonicBond(k=3.0, length=[1.0, 1.1], pairs=[[0, 1], [1, 2]])": md.HarmonicBond(
        3.0, [1.0, 1.1], [(0, 1), (1, 2)]
    ),
    "HarmonicAngle(k=2.0, angle=1.0, triples=[[0, 1, 2]])": md.HarmonicAngle(2.0, 1.0, [(0, 1, 2)]),
    "LangevinBAOAB(timestep=0.005, temperature=0.7, friction=2, seed=3)": md.LangevinBAOAB(0.005, 0.7, 2.0, seed=3),
    "VelocityVerlet(timestep=0.09822694788)": md.VelocityVerlet(md.units.fs),
    "Cell([[2.0, 0.0, 0.0], [0.0, 2.0, 0.0], [0.0, 0.0, 2.0]], pbc=[True, True, True])": md.Cell.of(2.0),
    "minimd.units.ASE": md.units.ASE,
}


@pytest.fixture(scope="module")
def record():
    sim = md.Simulation(liquid(3), md.LennardJones(1.0, 1.0, 1.85, "switched"), md.VelocityVerlet(0.003))
    sim.extra_observables = ("stress",)
    return sim.run(10, every=2, progress=False)


@pytest.mark.parametrize("call", CALLS)
def test_repr_is_the_call_with_all_that_is_no_default(call):
    assert repr(CALLS[call]) == call


def test_repr_of_plain_potentials_makes_them_again():
    for one in (KOB_ANDERSEN, md.LennardJones(0.3, 1.2, 2.5, "charmm"), md.LangevinBAOAB(0.005, 0.7, 2.0, seed=3)):
        again = eval(repr(one), {**vars(md), "None": None})
        assert repr(again) == repr(one)


def test_html_is_escaped_and_text_of_one_object_keeps_its_lines():
    class Odd(Displayed):
        def __str__(self):
            return "a <b>          words & more\n               of the same"

    assert Odd().display_rows() == [("a <b>", "words & more"), ("", "of the same")]
    assert "a &lt;b&gt;</th>" in Odd()._repr_html_()
    assert "words &amp; more" in Odd()._repr_html_()
    report = md.Simulation(liquid(3), md.LennardJones(1.0, 1.0, 1.85, "switched"), md.VelocityVerlet(0.003))
    assert str(report).splitlines()[0].startswith("system         System(108 atoms")


def test_columns_have_one_name_for_each_number(record):
    columns = record.columns()
    assert list(columns)[:2] == ["step", "time"]
    assert np.array_equal(columns["momentum_y"], record.momentum[:, 1])
    assert np.array_equal(columns["stress_xz"], record.stress[:, 0, 2])
    assert all(column.shape == (6,) for column in columns.values())
    assert "momentum" not in columns


def test_a_data_frame_has_the_steps_as_index_and_units(record):
    pytest.importorskip("pandas")
    table = record.to_pandas()
    assert table.index.name == "step"
    assert np.array_equal(table.index, record.step)
    assert np.array_equal(table["total_energy"], record.total_energy)
    assert table.attrs["units"]["stress"] == md.units.LJ.pressure
    assert table.attrs["units"]["time"] == "τ"


def test_without_pandas_a_sentence_says_what_to_do(record, monkeypatch):
    monkeypatch.setitem(sys.modules, "pandas", None)
    with pytest.raises(
        ModuleNotFoundError,
        match=r"to_pandas needs pandas, which is not installed: install pandas, or use record.columns\(\)",
    ):
        record.to_pandas()


def test_text_has_every_bit_and_no_file_is_replaced_unasked(record, tmp_path):
    file = record.to_csv(tmp_path / "a.csv")
    rows = list(csv.DictReader(io.StringIO(file.read_text(encoding="utf-8"))))
    assert [int(row["step"]) for row in rows] == record.step.tolist()
    for name, column in record.columns().items():
        assert np.array_equal([float(row[name]) for row in rows], column), name
    with pytest.raises(FileExistsError, match=r"a.csv' exists; choose another name, or pass overwrite=True"):
        record.to_csv(file)
    assert record.to_csv(file, overwrite=True) == file
    assert [path.name for path in tmp_path.iterdir()] == ["a.csv"]


def test_a_record_draws_itself(record, tmp_path):
    figure = record.plot()
    titles = [panel.get_title() for panel in figure.axes]
    assert [title.split("   ")[0] for title in titles] == [
        "total energy per atom",
        "temperature",
        "total momentum",
        "pressure",
    ]
    assert figure._repr_png_().startswith(b"\x89PNG")
    drawn = figure.axes[1].lines[0].get_ydata()
    assert np.array_equal(drawn, record.temperature)
    with pytest.raises(ValueError, match="there is nothing to plot: the record has no entries"):
        md.Record(md.units.LJ, 2).plot()
    assert str(md.Record(md.units.LJ, 2)) == "record         no entries"


def test_a_record_in_the_open_draws_its_potential_energy():
    sim = md.Simulation(md.System([[0.0, 0, 0], [1.2, 0, 0]]), md.LennardJones(1.0, 1.0, 2.5), md.VelocityVerlet(0.001))
    figure = sim.run(3, every=1, progress=False).plot()
    assert figure.axes[3].get_title().startswith("potential energy per atom")


def test_a_notebook_has_a_bar_unless_it_is_not_wanted(monkeypatch):
    """By default as on a terminal; the bar is that of tqdm.auto."""
    made = []

    class Bar:
        n = 0

        def __init__(self, **options):
            made.append(options)

        def __enter__(self):
            return self

        def __exit__(self, *_):
            pass

        def update(self, n):
            self.n += n

    monkeypatch.setitem(sys.modules, "tqdm.auto", types.SimpleNamespace(tqdm=Bar))
    kernel = types.SimpleNamespace(get_ipython=lambda: types.SimpleNamespace(kernel=1))
    for module, shows in ((None, False), (types.SimpleNamespace(get_ipython=lambda: None), False), (kernel, True)):
        monkeypatch.setitem(sys.modules, "IPython", module)
        made.clear()
        with console.progress_of(10, "running") as tell:
            tell(5)
        assert bool(made) == shows
    with console.progress_of(10, "running", False) as tell:
        tell(5)
    assert len(made) == 1


def test_dir_has_the_public_names_only():
    names = [name for name in dir(md) if not name.startswith("__")]
    assert names == sorted(md.__all__)
    assert not {"report", "fire", "team", "engine", "structure"} & set(names)
    assert all(hasattr(md, name) for name in names)


@pytest.mark.parametrize(
    "name",
    [
        "System",
        "Simulation",
        "LennardJones",
        "PairPotential",
        "HarmonicBond",
        "Tabulated",
        "DistanceConstraints",
        "minimize",
    ],
)
def test_help_fits_one_screen_before_the_text_begins(name):
    """24 lines of 80 letters; annotations as they are written, defaults by name."""
    text = pydoc.plain(pydoc.render_doc(getattr(md, name)))
    first = getattr(md, name).__doc__.splitlines()[0]
    before = text[: text.index(first)].splitlines()
    assert sum(1 + len(line) // 80 for line in before) < 24
    assert "numpy._typing" not in text[:3000]
    assert name != "System" or "units: 'UnitSystem' = minimd.units.LJ" in text


def test_names_of_choices_are_those_that_exist():
    assert set(get_args(TruncationName)) == set(TRUNCATIONS)
    assert set(get_args(MixingName)) == set(MIXING)
    assert set(get_args(Precision)) == {"double", "mixed", "fixed-point"}


SCRIPT = """
import numpy as np
from numpy.typing import NDArray

import minimd as md


class Weight(md.Term):
    def __init__(self, masses: NDArray[np.float64]) -> None:
        self.weights = 9.81 * masses

    def add(
        self, system: md.System, detail: int, forces: NDArray[np.float64], energies: NDArray[np.float64], virials: NDArray[np.float64]
    ) -> None:
        forces[:, 2] -= self.weights


class Gravity:
    def bind(self, system: md.System) -> Weight:
        return Weight(system.masses)


def look(sim: md.Simulation) -> None:
    print(sim.step, sim.temperature, sim.stress[0, 0])


system = md.System(np.arange(6.0).reshape(2, 3), cell=10.0, species=["Ar", "Ar"], bonds=[(0, 1)], units=md.units.LJ)
lj = md.LennardJones(1.0, 1.0, cutoff=2.5, truncation="force-shifted")
potentials = [lj, md.HarmonicBond(100.0, 1.0), md.Tabulated(np.arange(1.0, 7.0), {("Ar", "Ar"): np.ones(6)})]
sim = md.Simulation(system, potentials, md.VelocityVerlet(0.005), precision="mixed")
other = md.Simulation(system, [lj, Gravity()], md.LangevinBAOAB(0.005, 1.0, 1.0, seed=1))
record = sim.run(100, every=10, observers=[look], progress=False)
energies: NDArray[np.float64] = record.total_energy
record.plot().savefig("a.png")
record.to_csv("a.csv").unlink()
drift: float = sim.report().energy_drift.slope
forces: NDArray[np.float64] = md.evaluate(system, lj).forces
total: float = sim.pressure + sim.potential_energy
is_done: bool = md.minimize(system, potentials).converged
"""
MISTAKES = {
    "md.Simulation(system, 3, md.VelocityVerlet(0.1))": 'incompatible type "int"; expected "Potential | Sequence[Potential]"',
    'md.LennardJones(1.0, 1.0, 2.5, "cut")': "Literal['cut']",
    'md.Simulation(system, lj, md.VelocityVerlet(0.1), precision="half")': "Literal['half']",
    'md.LennardJones({"A": (1.0, 1.0)}, mixing="mean")': "Literal['mean']",
}


@pytest.mark.slow
def test_a_script_of_a_user_is_clean_to_mypy_strict_and_mistakes_are_found(tmp_path):
    """15 s, most of it for minimd."""
    pytest.importorskip("mypy")
    n_lines = SCRIPT.count("\n")
    (tmp_path / "script.py").write_text(SCRIPT + "\n".join(MISTAKES))
    command = [sys.executable, "-m", "mypy", "--strict", "--cache-dir", str(tmp_path), "script.py"]
    environment = {"PYTHONPATH": str(Path(md.__file__).parents[1]), "PATH": ""}
    told = subprocess.run(
        command, capture_output=True, text=True, check=False, cwd=tmp_path, env=environment
    ).stdout.splitlines()
    assert len(told) == len(MISTAKES) + 1, told
    for k, (line, words) in enumerate(zip(told, MISTAKES.values(), strict=False), n_lines + 1):
        assert line.startswith(f"script.py:{k}: error")
        assert words in line
