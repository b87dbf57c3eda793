"""The cache of compiled code: found again, never stale, in any place that can be written."""

import contextlib
import os
import subprocess
import sys
from pathlib import Path

import pytest

import minimd
from minimd.compiled import kernels as compiling
from minimd.compiled.code_cache import CodeFiles

RUN = """
import numpy as np, minimd as md
from minimd.forces.pair_list_term import gather
md.evaluate(md.System([[0, 0, 0], [1.1, 0, 0]]), md.LennardJones(1.0, 1.0, 2.5))
from minimd.potentials.pair_loop import add_pair_forces as loop
print(sum(loop.stats.cache_hits.values()), sum(loop.stats.cache_misses.values()))
"""


def run(environment, code=RUN):
    clean = {k: v for k, v in os.environ.items() if k not in ("NUMBA_CACHE_DIR", "XDG_CACHE_HOME", "HOME")}
    clean["PYTHONPATH"] = str(Path(minimd.__file__).parents[1])
    return subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, check=False, env={**clean, **environment}
    )


def test_second_process_compiles_nothing(tmp_path):
    first, second = (run({"NUMBA_CACHE_DIR": str(tmp_path)}) for _ in range(2))
    assert first.stdout.split() == ["0", "1"], first.stderr
    assert second.stdout.split() == ["1", "0"], second.stderr


def test_a_home_that_cannot_be_written_is_no_obstacle(tmp_path):
    (tmp_path / "file").write_text("in the way")
    answer = run({"HOME": str(tmp_path / "file"), "TMPDIR": str(tmp_path)})
    assert answer.returncode == 0, answer.stderr


def test_two_processes_that_start_on_an_empty_cache_compile_once(tmp_path):
    clean = {**os.environ, "NUMBA_CACHE_DIR": str(tmp_path), "PYTHONPATH": str(Path(minimd.__file__).parents[1])}
    both = [
        subprocess.Popen([sys.executable, "-c", RUN], env=clean, stdout=subprocess.PIPE, stderr=subprocess.PIPE)
        for _ in range(2)
    ]
    misses = 0
    for process in both:
        out, errors = process.communicate(timeout=200)
        assert process.returncode == 0, errors
        misses += int(out.split()[1])
    if hasattr(os, "getuid"):
        assert misses == 1  # one compiles, the other waits for it


@pytest.mark.skipif(not hasattr(os, "getuid"), reason="locks")
def test_a_kernel_that_cannot_be_compiled_keeps_nobody_waiting(tmp_path):
    code = """
import fcntl, glob, os, numba
from minimd.compiled.kernels import kernel
def wrong(x): return x.no_such_thing
broken = kernel(wrong)
try:
    broken(1.0)
except numba.TypingError:
    (lock,) = glob.glob(os.environ["NUMBA_CACHE_DIR"] + "/**/*.lock", recursive=True)
    fcntl.flock(os.open(lock, os.O_RDWR), fcntl.LOCK_EX | fcntl.LOCK_NB)
    print("free")
"""
    (tmp_path / "script.py").write_text(code)
    answer = run(
        {"NUMBA_CACHE_DIR": str(tmp_path)},
        f"exec(compile(open({str(tmp_path / 'script.py')!r}).read(), {str(tmp_path / 'script.py')!r}, 'exec'))",
    )
    assert answer.stdout == "free\n", answer.stderr


DAMAGED = """
import glob, os, sys
from minimd.compiled.kernels import kernel
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


@pytest.mark.parametrize("n_flipped", [4, pytest.param(20, marks=pytest.mark.slow)])
def test_damaged_compiled_code_is_compiled_anew_and_said_once(n_flipped, tmp_path):
    """Machine code in which a bit is flipped would end the process."""
    (tmp_path / "script.py").write_text(DAMAGED)
    code = f"import runpy, sys; sys.argv[1:] = ['{n_flipped}']; runpy.run_path({str(tmp_path / 'script.py')!r})"
    answer = run({"NUMBA_CACHE_DIR": str(tmp_path)}, code)
    assert answer.returncode == 0, answer.stderr
    assert answer.stderr.count("was damaged and is compiled anew") == len(answer.stderr.splitlines()) == 1


@pytest.mark.skipif(not hasattr(os, "getuid"), reason="links")
def test_a_link_in_the_cache_is_not_written_through(tmp_path):
    (tmp_path / "precious").write_text("precious")
    files = CodeFiles(str(tmp_path), "twice", "now")
    for name in ("twice.nbi", "twice.lock"):
        (tmp_path / name).symlink_to(tmp_path / "precious")
    files.save("floats", "code for floats")
    assert files.load("floats") == "code for floats"
    assert (tmp_path / "precious").read_text() == "precious"


SOURCES = {
    "compiled/kernels.py": "b = 1\n",
    "law.py": """from minimd.compiled.kernels import (
    cache_folder,
    scalar,
)
from minimd.numbers import HALF
from minimd.shapes import (
    Pair,
)
from minimd.structure import units

@scalar
def law(pair: Pair):
    return HALF * units.MASS * pair.r
""",
    "numbers.py": "from minimd.thirds import THIRD\nHALF = 1.5 * THIRD\n",
    "thirds.py": "THIRD = 1 / 3\n",
    "shapes.py": "from collections import namedtuple\nPair = namedtuple('Pair', 'r s')\n",
    "structure/__init__.py": "",
    "structure/units.py": "MASS = 1.0\n",
    "choices.py": "from numba.extending import overload\noverload(abs)(lambda x: lambda x: 1)\n",
    "grade.py": "from minimd.law import law\n",
}


@pytest.mark.parametrize("name", SOURCES)
def test_edited_sources_of_kernels_and_no_others_get_another_cache(name, tmp_path, monkeypatch):
    """A kernel, its constants, those from which these are computed, its types, overloads."""
    package = tmp_path / "minimd"
    for file, text in SOURCES.items():
        (package / file).parent.mkdir(parents=True, exist_ok=True)
        (package / file).write_text(text)
    monkeypatch.setattr(compiling, "__file__", str(package / "compiled" / "kernels.py"))
    before = compiling._source_hash()
    (package / name).write_text(SOURCES[name] + "# edited\n")
    assert (compiling._source_hash() != before) == (name != "grade.py")


def test_fields_in_another_order_are_another_type(tmp_path):
    """Also if the file of the kernel does not import it."""
    (tmp_path / "script.py").write_text("""
from minimd.compiled.kernels import kernel
from shapes import Pair
def first(pair): return pair.r
compiled = kernel(first)
print(compiled(Pair(r=1.0, s=2.0)), sum(compiled.stats.cache_misses.values()))
""")
    for fields in ("r s", "s r"):
        (tmp_path / "shapes.py").write_text(f"import collections\nPair = collections.namedtuple('Pair', {fields!r})\n")
        code = f"import sys, runpy; sys.path[0] = {str(tmp_path)!r}; runpy.run_path(sys.path[0] + '/script.py')"
        answer = run({"NUMBA_CACHE_DIR": str(tmp_path), "PYTHONDONTWRITEBYTECODE": "1"}, code)
        assert answer.stdout.split() == ["1.0", "1"], answer.stderr


POSIX = pytest.mark.skipif(not hasattr(os, "getuid"), reason="POSIX permissions")


def folder_of_cache(base, monkeypatch):
    """Where compiled code would be kept, if only this place were there."""
    monkeypatch.setattr(compiling, "_cache_bases", lambda: [base])
    return compiling.cache_folder.__wrapped__()


@POSIX
@pytest.mark.parametrize("mode", [0o777, 0o775, 0o722])
@pytest.mark.parametrize("opened", ["a", "a/b", "a/b/c"])
def test_a_cache_that_others_can_change_is_refused_whichever_folder_on_the_way_is_open(
    opened, mode, tmp_path, monkeypatch
):
    place = tmp_path / "a" / "b" / "c"
    place.mkdir(parents=True)
    assert folder_of_cache(place, monkeypatch).parent == place
    (tmp_path / opened).chmod(mode)
    with pytest.warns(
        UserWarning, match=f"compiled code is not kept in {place}, because other users can change {tmp_path / opened}; "
    ):
        assert folder_of_cache(place, monkeypatch) is None


@POSIX
def test_nothing_is_made_in_a_folder_that_others_can_change(tmp_path, monkeypatch):
    tmp_path.chmod(0o777)
    with pytest.warns(UserWarning, match="other users can change"):
        folder_of_cache(tmp_path / "new", monkeypatch)
    assert list(tmp_path.iterdir()) == []


@POSIX
def test_a_common_sticky_folder_may_lie_on_the_way_but_not_be_the_cache(tmp_path, monkeypatch):
    tmp_path.chmod(0o1777)
    folder = folder_of_cache(tmp_path / "own", monkeypatch)
    assert compiling.open_to_others(folder) is None
    assert compiling.open_to_others(tmp_path) == tmp_path
    (tmp_path / "own").chmod(0o770)
    assert compiling.open_to_others(folder) == tmp_path / "own"


@POSIX
@pytest.mark.parametrize("mode", [0o755, 0o1777])
def test_a_folder_of_another_user_is_refused_sticky_or_not(mode, tmp_path, monkeypatch):
    """As this user sees it who is not the owner."""
    owner = os.stat(tmp_path).st_uid
    theirs = tmp_path / "theirs"
    theirs.mkdir()
    theirs.chmod(mode)
    stat = Path.stat

    def foreign(path, **options):
        found = stat(path, **options)
        return os.stat_result([*found[:4], owner + 12345, *found[5:]]) if path == theirs else found

    monkeypatch.setattr(Path, "stat", foreign)
    assert compiling.open_to_others(theirs / "cache") == theirs


@POSIX
def test_links_are_followed_to_where_the_code_would_lie(tmp_path, monkeypatch):
    (tmp_path / "open" / "cache").mkdir(parents=True)
    (tmp_path / "link").symlink_to(tmp_path / "open" / "cache")
    assert folder_of_cache(tmp_path / "link", monkeypatch).parent == tmp_path / "open" / "cache"
    (tmp_path / "open").chmod(0o777)
    with pytest.warns(UserWarning, match="other users can change .*/open;"):
        assert folder_of_cache(tmp_path / "link", monkeypatch) is None


@POSIX
def test_new_folders_are_for_this_user_alone_whatever_the_umask(tmp_path, monkeypatch):
    before = os.umask(0)
    try:
        folder = folder_of_cache(tmp_path / "a" / "b", monkeypatch)
    finally:
        os.umask(before)
    assert all(part.stat().st_mode & 0o777 == 0o700 for part in (folder, folder.parent, folder.parent.parent))


@pytest.mark.slow
@POSIX
def test_without_a_cache_kernels_are_compiled_all_the_same(tmp_path):
    tmp_path.chmod(0o777)
    code = "import sys; from minimd.compiled.kernels import kernel\n@kernel\ndef twice(x): return x + x\nprint(twice(2), type(twice._cache).__name__)"
    answer = run({"NUMBA_CACHE_DIR": str(tmp_path), "HOME": str(tmp_path), "TMPDIR": str(tmp_path)}, code)
    assert answer.stdout.split() == ["4", "NullCache"], answer.stderr
    assert answer.stderr.count("UserWarning") == 3


@pytest.mark.parametrize("n_replaced", [0, 1, 2])
def test_a_process_killed_between_two_files_of_the_cache_leaves_no_code_of_another_signature(
    n_replaced, tmp_path, monkeypatch
):
    """Code lies there from an earlier state of the source, which the index does not name any more."""
    CodeFiles(str(tmp_path), "twice", "earlier").save("integers", "code for integers")
    replace, files = os.replace, CodeFiles(str(tmp_path), "twice", "now")

    def killing(*names, done=[]):  # noqa: B006
        done.append(names)
        if len(done) > n_replaced:
            raise KeyboardInterrupt
        replace(*names)

    monkeypatch.setattr(os, "replace", killing)
    with contextlib.suppress(KeyboardInterrupt):
        files.save("floats", "code for floats")
    monkeypatch.undo()
    assert files.load("floats") == ("code for floats" if n_replaced == 2 else None)
    files.save("integers", "new code for integers")
    assert files.load("integers") == "new code for integers"
