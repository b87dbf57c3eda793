"""The cache of compiled code: found again, never stale, in any place that can be written."""

import contextlib
import gc
import os
import subprocess
import sys
from collections import namedtuple
from pathlib import Path

import numba
import pytest

import minimd
from minimd.core.compiled import kernels
from minimd.core.compiled.code_cache import CodeFiles

POSIX = pytest.mark.skipif(not hasattr(os, "getuid"), reason="POSIX permissions, locks and links")
OF_A_LOOP = """
import minimd as md
md.evaluate(md.System([[0, 0, 0], [1.1, 0, 0]]), md.LennardJones(1.0, 1.0))
from minimd.core.potentials.pair_loop import add_pair_forces as loop
print(sum(loop.stats.cache_hits.values()), sum(loop.stats.cache_misses.values()))
"""
TWICE = """
from minimd.core.compiled.kernels import kernel
def twice(x): return x + x
compiled = kernel(twice)
print(compiled(2), type(compiled._cache).__name__)
"""
Pair = namedtuple("Pair", "r s")
IMPORTS = ["compiled.kernels import (\n    cache_folder,\n    scalar,\n)", "numbers import HALF"]
IMPORTS += ["shapes import (\n    Pair,\n)", "structure import units"]
SOURCES = {
    "compiled/kernels.py": "b = 1\n", "law.py": "".join(f"from minimd.core.{one}\n" for one in IMPORTS),
    "numbers.py": "from minimd.core.thirds import THIRD\nHALF = 1.5 * THIRD\n", "thirds.py": "THIRD = 1 / 3\n",
    "shapes.py": "Pair = None\n", "structure/__init__.py": "", "structure/units.py": "MASS = 1.0\n",
    "choices.py": "from numba.extending import overload\n", "grade.py": "from minimd.core.law import law\n",
}  # fmt: skip
COMPILED_MODULES = """
import gc, importlib, pkgutil
from numba.core.dispatcher import Dispatcher
import minimd
OPTIONAL = {"minimd.__main__"}
for module in pkgutil.walk_packages(minimd.__path__, "minimd."):
    if module.name not in OPTIONAL:
        importlib.import_module(module.name)
of_dispatchers = {one.py_func.__module__ for one in gc.get_objects() if isinstance(one, Dispatcher)}
print(*sorted(name for name in of_dispatchers if name.startswith("minimd.")))
"""
DAMAGED = """
import glob, os, sys
from minimd.core.compiled.kernels import kernel
def thrice(x): return 3.0 * x
def called():
    again = kernel(thrice)
    assert again(2.0) == 6.0
    return sum(again.stats.cache_misses.values())
assert (called(), called()) == (1, 0)
for ending in ("nbc", "nbi"):
    def found():
        (place,) = glob.glob(os.environ["NUMBA_CACHE_DIR"] + "/**/*thrice*." + ending, recursive=True)
        return place
    size = os.path.getsize(found())
    for k, bit in [(-1, 0), *((k, bit) for k in range(0, size - 2, size // int(sys.argv[1])) for bit in (0, 1, 128))]:
        code = bytearray(open(found(), "rb").read())
        code[k] ^= bit
        open(found(), "wb").write(code if bit else code[:k])  # a flipped bit, or the beginning of the file
        assert (called(), called()) == (1, 0), (ending, k, bit)
"""


def started(script, text, *arguments, **places):
    """A process that runs a script; it has no cache but in these places."""
    script.write_text(text)
    hidden = ("NUMBA_CACHE_DIR", "XDG_CACHE_HOME", "HOME")
    clean = {k: v for k, v in os.environ.items() if k not in hidden} | {k: str(v) for k, v in places.items()}
    clean["PYTHONPATH"] = str(Path(minimd.__file__).parents[1])
    told = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE, "text": True}
    return subprocess.Popen([sys.executable, script, *map(str, arguments)], env=clean, **told)


def ended(process):
    out, errors = process.communicate(timeout=300)
    assert process.returncode == 0, errors
    return out, errors


@pytest.mark.slow
def test_processes_that_start_on_an_empty_cache_compile_once_and_others_nothing(tmp_path):
    one = lambda: started(tmp_path / "script.py", OF_A_LOOP, NUMBA_CACHE_DIR=tmp_path)  # noqa: E731
    misses = sum(int(ended(process)[0].split()[1]) for process in (one(), one()))
    if hasattr(os, "getuid"):
        assert misses == 1  # one compiles, the other waits for it
    assert ended(one())[0].split() == ["1", "0"]
    (tmp_path / "file").write_text("in the way")  # a home that cannot be written is no obstacle
    process = started(tmp_path / "script.py", TWICE, HOME=tmp_path / "file", TMPDIR=tmp_path)
    assert ended(process)[0].startswith("4 ")


@pytest.mark.slow
@POSIX
def test_without_a_cache_kernels_are_compiled_all_the_same(tmp_path):
    tmp_path.chmod(0o777)
    nowhere = dict.fromkeys(("NUMBA_CACHE_DIR", "HOME", "TMPDIR"), tmp_path)
    out, errors = ended(started(tmp_path / "script.py", TWICE, **nowhere))
    assert (out.split(), errors.count("UserWarning")) == (["4", "NullCache"], 3)


@pytest.fixture
def folder(tmp_path, monkeypatch):
    monkeypatch.setattr(kernels, "cache_folder", lambda: tmp_path)
    return tmp_path


@POSIX
def test_a_kernel_that_cannot_be_compiled_keeps_nobody_waiting(folder):
    import fcntl

    with pytest.raises(numba.TypingError):
        kernels.kernel(lambda x: x.no_such_thing)(1.0)
    (lock,) = folder.rglob("*.lock")
    with lock.open("r+") as file:
        fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)  # it would raise


def test_fields_in_another_order_are_another_type(folder, monkeypatch):
    for fields in ("r s", "s r"):
        monkeypatch.setitem(globals(), "Pair", namedtuple("Pair", fields))
        for n_misses in (1, 0):
            compiled = kernels.kernel(lambda pair: pair.r)
            assert (compiled(Pair(r=1.0, s=2.0)), sum(compiled.stats.cache_misses.values())) == (1.0, n_misses)


@pytest.mark.parametrize("n_flipped", [1, pytest.param(20, marks=pytest.mark.slow)])
def test_damaged_compiled_code_is_compiled_anew_and_said_once(n_flipped, tmp_path):
    """Machine code in which a bit is flipped would end the process."""
    _, errors = ended(started(tmp_path / "script.py", DAMAGED, n_flipped, NUMBA_CACHE_DIR=tmp_path))
    assert errors.count("was damaged and is compiled anew") == len(errors.splitlines()) == 1


@POSIX
def test_a_link_in_the_cache_is_not_written_through(tmp_path):
    (tmp_path / "precious").write_text("precious")
    files = CodeFiles(str(tmp_path), "twice", "now")
    for name in ("twice.nbi", "twice.lock"):
        (tmp_path / name).symlink_to(tmp_path / "precious")
    files.save("floats", "code for floats")
    assert (files.load("floats"), (tmp_path / "precious").read_text()) == ("code for floats", "precious")


@pytest.mark.parametrize("n_replaced", [0, 1, 2])
def test_a_process_killed_between_two_files_leaves_no_code_of_another_signature(n_replaced, tmp_path, monkeypatch):
    """Code lies there from an earlier state of the source, which the index does not name any more."""
    CodeFiles(str(tmp_path), "twice", "earlier").save("integers", "code for integers")
    replace, files, done = os.replace, CodeFiles(str(tmp_path), "twice", "now"), []

    def killing(*names):
        done.append(names)
        if len(done) > n_replaced:
            raise KeyboardInterrupt
        replace(*names)

    with monkeypatch.context() as patch, contextlib.suppress(KeyboardInterrupt):
        patch.setattr(os, "replace", killing)
        files.save("floats", "code for floats")
    assert files.load("floats") == ("code for floats" if n_replaced == 2 else None)
    files.save("integers", "new code for integers")
    assert files.load("integers") == "new code for integers"


@pytest.mark.parametrize("name", SOURCES)
def test_edited_sources_of_kernels_and_no_others_get_another_cache(name, tmp_path, monkeypatch):
    """A kernel, its constants, those from which these are computed, its types, overloads."""
    package = tmp_path / "minimd" / "core"
    for file, text in SOURCES.items():
        (package / file).parent.mkdir(parents=True, exist_ok=True)
        (package / file).write_text(text)
    monkeypatch.setattr(kernels, "__file__", str(package / "compiled" / "kernels.py"))
    before = kernels._source_hash()
    (package / name).write_text(SOURCES[name] + "# edited\n")
    assert (kernels._source_hash() != before) == (name != "grade.py")


def test_the_modules_of_all_compiled_functions_are_sources_of_the_key(tmp_path):
    """With one left out, an edited law would go on with its old machine code."""
    out, _ = ended(started(tmp_path / "script.py", COMPILED_MODULES))
    compiled = set(out.split())
    sources = set(kernels._kernel_sources())
    assert {"minimd.core.potentials.laws", "minimd.observers.radial_distribution"} <= compiled
    assert len(compiled) > 30
    assert compiled <= sources, compiled - sources


def folder_of_cache(base, monkeypatch):
    monkeypatch.setattr(kernels, "_cache_bases", lambda: [base])
    return kernels.cache_folder.__wrapped__()


@POSIX
@pytest.mark.parametrize("mode", [0o777, 0o775, 0o722])
@pytest.mark.parametrize("opened", ["a", "a/b", "a/b/c"])
def test_a_cache_that_others_can_change_is_refused_whichever_folder_is_open(opened, mode, tmp_path, monkeypatch):
    """Nothing is made there, and links are followed to where the code would lie."""
    place, link = tmp_path / "a" / "b" / "c", tmp_path / "link"
    place.mkdir(parents=True)
    link.symlink_to(place)
    assert folder_of_cache(link, monkeypatch).parent == place
    (tmp_path / opened).chmod(mode)
    for base in (place, link, place / "new"):
        with pytest.warns(UserWarning, match=f"{base}, because other users can change {tmp_path / opened}; "):
            assert folder_of_cache(base, monkeypatch) is None
    assert not (place / "new").exists()


@POSIX
def test_a_common_sticky_folder_may_lie_on_the_way_but_not_be_the_cache(tmp_path, monkeypatch):
    """New folders are for this user alone, whatever the umask; that of another user is refused, sticky or not."""
    tmp_path.chmod(0o1777)
    before = os.umask(0)
    try:
        folder = folder_of_cache(tmp_path / "own" / "b", monkeypatch)
    finally:
        os.umask(before)
    assert all(part.stat().st_mode & 0o777 == 0o700 for part in (folder, folder.parent, folder.parent.parent))
    assert (kernels.open_to_others(folder), kernels.open_to_others(tmp_path)) == (None, tmp_path)
    (tmp_path / "own").chmod(0o770)
    assert kernels.open_to_others(folder) == tmp_path / "own"
    stat = Path.stat
    for mode in (0o40755, 0o41777):
        theirs = os.stat_result([mode, *stat(tmp_path)[1:4], os.getuid() + 12345, *stat(tmp_path)[5:]])
        is_theirs = lambda path, theirs=theirs: theirs if path.name == "own" else stat(path)  # noqa: E731
        monkeypatch.setattr(Path, "stat", is_theirs)
        assert kernels.open_to_others(tmp_path / "own" / "cache") == tmp_path / "own"


@pytest.mark.parametrize("fails", [False, True])
@pytest.mark.parametrize("collects", [False, True])
def test_the_search_for_garbage_rests_while_a_kernel_is_compiled_and_then_is_as_it_was(collects, fails):
    seen = []

    @kernels.by_type
    def looking(x):
        seen.append(gc.isenabled())
        return None if fails else lambda x: x

    try:
        (gc.enable if collects else gc.disable)()
        with pytest.raises(numba.TypingError) if fails else contextlib.nullcontext():
            numba.njit(lambda x: looking(x))(1.0)
        assert gc.isenabled() == collects
    finally:
        gc.enable()
    assert {*seen} == {False}
