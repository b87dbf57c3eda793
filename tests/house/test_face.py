"""The face: what an import loads, public names that do not depend on the order of imports, old names of modules."""

import pickle
import subprocess
import sys
import warnings
from importlib import import_module
from pathlib import Path
from zipfile import ZipFile

import pytest

import minimd as md
from minimd import moved, old_names
from minimd.core.diagnosis.report import DriftRate

HEAVY = "numpy numba scipy h5py ase MDAnalysis matplotlib pydantic tqdm"
LOADED = f"""
import sys
def loaded(*names):
    return [name for name in ({HEAVY!r} + ' ' + ' '.join(names)).split() if name in sys.modules]
"""
STEP = """
import minimd as md
def step(x, v, force, m, dt):
    v = v + 0.5 * dt * force(x) / m
    x = x + dt * v
    return x, v + 0.5 * dt * force(x) / m
assert "velocity-verlet" in str(md.grade(step))
"""
DYNAMICS = """
import ase.md.verlet
import minimd as md
assert md.grade(ase.md.verlet.VelocityVerlet)
"""
RUN = """
import minimd as md
positions, edges = md.lattice.crystal("fcc", [3, 3, 3], 1.68)
md.Simulation(md.System(positions, cell=edges), md.LennardJones(1.0, 1.0, 2.0), md.VelocityVerlet(0.004)).run(2)
"""
COMMAND = """
from minimd.commands.main import main
assert main(["run", sys.argv[1], "--steps", "2", "--quiet", "--overwrite"]) == 0
"""
ENGINE = "minimd.core.compiled minimd.core.engine minimd.core.forces minimd.core.simulation"
ANNEXES = "minimd.ensemble minimd.lammps minimd.openmm minimd.judge minimd.past minimd.textbook minimd.ase"
VIEWED = """
import importlib, minimd as md
for module in ("view.page", "ensemble.running", "judge.grading", "past.replay"):
    importlib.import_module(f"minimd.{module}")
assert all(callable(getattr(md, name)) for name in ("view", "ensemble", "grade", "replay"))
import minimd.grade
assert minimd.grade is md.grade and callable(md.grade)
"""


def answer(code, *arguments):
    """What a new process prints."""
    command = [sys.executable, "-W", "error::DeprecationWarning:__main__", "-c", LOADED + code, *map(str, arguments)]
    process = subprocess.run(command, capture_output=True, text=True, check=False, timeout=300)
    assert process.returncode == 0, process.stderr
    return process.stdout.splitlines()[-1] if process.stdout else ""


@pytest.mark.parametrize(
    ("code", "spared"),
    [("import minimd", HEAVY), ("import minimd as md; md.integrators; md.potentials; dir(md)", HEAVY),
     (STEP, f"numba h5py ase MDAnalysis matplotlib {ENGINE}"), (RUN, f"h5py ase MDAnalysis matplotlib {ANNEXES}"),
     pytest.param(DYNAMICS, f"numba h5py MDAnalysis {ENGINE}", marks=pytest.mark.slow)],
)  # fmt: skip
def test_what_is_not_used_is_not_loaded(code, spared):
    names = answer(f"{code}\nprint(*loaded({f'{ENGINE} {ANNEXES}'!r}))").split()
    assert set(names) & set(spared.split()) == set()


def test_a_command_loads_what_it_uses(here):
    (here / "melt.toml").write_text(MELT)
    names = answer(f"{COMMAND}\nprint(*loaded({ANNEXES!r}))", here / "melt.toml").split()
    assert "numba" in names
    assert set(names) & set(ANNEXES.split()) == set()


MELT = """
units = "LJ"
structure = { lattice = "fcc", repeat = [3, 3, 3], density = 0.8442 }
potential = [{ type = "lennard-jones", epsilon = 1.0, sigma = 1.0, cutoff = 2.0 }]
dynamics = { timestep = 0.004, temperature = 1.44, steps = 2 }
"""


def test_functions_keep_their_names_whatever_is_imported_first():
    answer(VIEWED)


@pytest.mark.parametrize("name", sorted(md.__all__))
def test_each_public_name_is_there(name):
    assert getattr(md, name) is getattr(md, name)
    assert name in dir(md)


@pytest.mark.parametrize("package", ["integrators", "potentials", "view", "scene", "ensemble"])
def test_each_name_of_a_stub_is_where_it_says(package):
    module = import_module(f"minimd.{package}")
    assert module.__all__
    assert all(getattr(module, name) is not None for name in module.__all__)
    with pytest.raises(AttributeError, match="no_such_name"):
        module.no_such_name  # noqa: B018 - it raises


OLD = ["import minimd; minimd.structure.statistics", "import minimd.simulation.simulation",
       "from minimd.neighbors import queries", "import minimd.document.sections",
       "from minimd.potentials.pair import LennardJones", "from minimd.potentials import links, LennardJones",
       "from minimd.integrators.splitting.rows import VelocityVerlet", "from minimd.integrators import method, ode",
       "from minimd.integrators.ode.newton import Newton", "from minimd.simulation import past, archiving",
       "from minimd.replay import ReplayedStep", "from minimd.analysis.check import check_file",
       "from minimd.files.h5md_reader import read_file", "import minimd; minimd.integrators.dae.implicit",
       "from minimd.potentials.water import water"]  # fmt: skip


def test_old_imports_work_and_are_told_at_the_line_of_their_user():
    """A module is found under its old name once."""
    code = f"""
import warnings
for k, line in enumerate({OLD!r}):
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        exec(compile(line, "of_a_user.py", "exec"))
    told = [one for one in caught if "the old name goes" in str(one.message)]
    assert {{(one.category.__name__, one.filename) for one in told}} == {{("DeprecationWarning", "of_a_user.py")}}, line
print(k)
"""
    assert answer(code) == str(len(OLD) - 1)


def test_all_old_modules_are_the_new_ones():
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", DeprecationWarning)
        for old, new in moved.MOVED.items():
            if old not in moved.HERE:
                assert __import__(old, fromlist=["_"]) is __import__(new, fromlist=["_"])
        with pytest.raises(ModuleNotFoundError, match=r"minimd\.structure\.no_such_module"):
            import minimd.structure.no_such_module  # noqa: F401


def test_pickles_with_old_names_are_read():
    """Those of version 0.2.0 name modules and classes as they were."""
    renames = [("minimd.core.structure", "minimd.structure"), ("minimd.core.diagnosis", "minimd.diagnosis"),
               ("DriftRate", "Drift")]  # fmt: skip
    for one in (md.System([[0.0, 0.0, 0.0]]), DriftRate(1.0, 0.5)):
        old = pickle.dumps(one, protocol=0)
        for new_name, old_name in renames:
            old = old.replace(new_name.encode(), old_name.encode())
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", DeprecationWarning)
            assert type(pickle.loads(old)) is type(one)


def test_renamed_classes_are_found_under_their_old_names():
    for module, names in old_names.RENAMED.items():
        there, find = vars(import_module(module)), old_names.attributes_of(module)
        assert [find(old) for old in names] == [there[new] for new in names.values()]


IN_THREADS = """
from threading import Barrier, Thread
import minimd as md
names = ["Simulation", "view", "water", "ensemble", "LangevinBAOAB", "Coulomb", "Past", "advise_timestep"]
barrier, found = Barrier(len(names)), []
def load(name):
    barrier.wait()
    found.append(getattr(md, name))
threads = [Thread(target=load, args=(name,)) for name in names]
[thread.start() for thread in threads]
[thread.join() for thread in threads]
print(len(found))
"""


def test_threads_may_load_names_at_once():
    assert answer(IN_THREADS) == "8"


def test_a_function_of_a_script_that_uses_minimd_is_sent_to_other_processes():
    code = """
import cloudpickle, pickle
import minimd as md
def build():
    return md.System([[0.0, 0.0, 0.0]])
print(len(pickle.loads(cloudpickle.dumps(build))()))
"""
    assert answer(code) == "1"


@pytest.mark.parametrize("name", ["__wrapped__", "_repr_html_", "__test__"])
def test_a_private_name_is_refused_without_loading_anything(name):
    assert answer(f"import minimd\nprint(hasattr(minimd, {name!r}), *loaded())").split() == ["False"]


def test_names_that_are_elsewhere_or_misspelt_are_hinted_at():
    for name, hint in (("RadialDistribution", "minimd.observers."), ("LennardJone", "LennardJones"), ("BDF2", "integr"),
                       ("universe", "minimd.mdanalysis.universe"), ("fs", "units")):  # fmt: skip
        with pytest.raises(AttributeError, match=hint):
            getattr(md, name)


def test_minimd_runs_from_a_zip(tmp_path):
    archive = tmp_path / "minimd.zip"
    folder = Path(md.__file__).parent
    with ZipFile(archive, "w") as packed:
        for file in [*folder.glob("*.py*"), *(folder / "core").rglob("*.py*")]:
            packed.write(file, file.relative_to(folder.parent))
    code = f"""
sys.path.insert(0, {str(archive)!r})
import minimd as md
print(md.__file__, len(md.System([[0.0, 0.0, 0.0]])))
"""
    assert answer(code) == f"{archive}/minimd/__init__.py 1"
