"""Wrong scenes, written or drawn at random: a sentence that names the place and what stands there, or a right one."""

import copy
import json
import math
import re
from pathlib import Path
from time import process_time

import numpy as np
import pytest
from references import liquid, load, melt_scene
from scene_texts import ARGON, MIXTURE, REDUCED, SALT, TABULATED, WATER, everything_of, scene_of, write_tables
from wrong_calls import answer_of, assert_answered, assert_right

import minimd as md
from minimd.scene import load_scene, resume_run

TEXTS = {"reduced": REDUCED, "argon": ARGON.read_text(), "tabulated": TABULATED, "mixture": MIXTURE}
TEXTS |= {"salt": SALT, "water": WATER}
ROWS = [(text, *row) for name, text in TEXTS.items() for row in load("wrong_scenes.toml")[name]]
ROWS += [(SALT, SALT[SALT.index("potential = ") :], "", "potential is missing")]
ROWS += [(REDUCED, "timestep = 0.004", f"timestep = 1{400 * '0'}", "dynamics.timestep")]
ROWS += [(WATER, WATER, 'units = "LJ"\nwater = {}\ndynamics = { timestep = 1.0, steps = 1 }', 'units = "LJ"', '"ASE"')]
THREE = "temperature_K = [150, 90, 60]"
ROWS += [(ARGON.read_text(), "temperature_K = 94.4", THREE, "dynamics.temperature_K", "--scene")]
NO_TABLES = [  # what stands in the file of a table, None for no file, and what the sentence must contain
    (None, "'lj.dat'", "does not exist"), ("".join(f"{k} nan\n" for k in range(6)), "u must be finite"),
    ("1 a\n", "'lj.dat'", "'a'"), ("1 2\n2 3\n", "r must be", "6"), ("1 2\n3\n", "'lj.dat'", "two"),
]  # fmt: skip
DEEP = "nested too deeply"
NO_TOML = [
    ("a = [", "not valid TOML"), ("b = 1\nb = 2\nc = 3\n", "(at line 2, column 6), in 'b = 2'"), (b"\xff\xfe", "UTF-8"),
    (f"x = {'[' * 2000}{']' * 2000}", DEEP), (f"{'a.' * 20_000}a = 1", DEEP), (f"[{'a . ' * 20_000}a]", DEEP),
    ("\ufeff", "dynamics is missing"), ("\ufeff\ufeff", "not valid TOML"),
]  # fmt: skip
STATUS, CLEAR = Path("/proc/self/status"), Path("/proc/self/clear_refs")
SECONDS, KILOBYTES = 2.0, 1_000_000  # for one scene, of processor time
SCENES = ("mutated_melt", "mutated_argon", "mutated_dumbbells", "mutated_table", "water")
SCENES = [load(f"scenes/{name}.toml") for name in SCENES]
SENSELESS = [math.nan, "", "no such thing", {}, {"a": 1}, [[[]]], [{"b": []}], -(2**63), "\0", "1.0", ["1", "2", "3"]]
STRANGE = [True, False, 0, 1, -1, 3, 10**4, 2**62, 0.0, -0.0, 0.5, -2.5, 1e-300, 5e-324, 1e-9, 1e9, 1e300]
STRANGE += [math.inf, -math.inf, [], [0, 0, 0], "auto", "Ar", "LJ"]
FACTORS = [-1, 0, 2, 10, 1e-3, 1e3, 1e14, 1e-14]
LARGE_IS_NO_MISTAKE = {"steps", "repeat", "max_steps", "rescale_every", "every"}
MAY_BE_TEXT = {"title", "plot", "trajectory", "species"}
MAY_BE_EMPTY = {"constraints", "minimization", "output", "water"}
WAYS = ["misspelt", "gone", "twice", "sense", "value", "value", "value", "scaled", "scaled", "elsewhere"]
SEEDS = [(1, 200, 0), *(pytest.param(seed, 1000, 2, marks=pytest.mark.slow) for seed in range(11, 21))]


@pytest.mark.parametrize("row", ROWS, ids=lambda row: f"{row[3]} {row[-1]}")
def test_a_wrong_entry_is_answered_with_its_place_and_itself(row, here):
    write_tables()
    text, old, new, *shown = row
    assert old in text
    assert_answered(lambda: everything_of(text.replace(old, new, 1)), ValueError, "scene.toml: ", *shown)


def test_what_is_no_table_and_what_is_no_toml_is_told(here):
    for content, *shown in NO_TABLES:
        if content is not None:
            Path("lj.dat").write_text(content)
        assert_answered(lambda: everything_of(TABULATED), ValueError, "scene.toml: potential[0]: ", *shown)
    for content, *shown in NO_TOML:
        Path("a.toml").write_bytes(content if isinstance(content, bytes) else content.encode())
        assert_answered(lambda: load_scene("a.toml"), ValueError, "a.toml", *shown)


def test_all_problems_are_told_at_once():
    two = REDUCED.replace("density", "densty").replace("every", "evry")
    three = "steps = -20\nrelaxation_tim = 0.3\nsed = 2"
    for text, places in ((two, ["structure", "output"]), (REDUCED.replace("steps = 20", three), 3 * ["dynamics"])):
        with pytest.raises(ValueError, match=r"scene\.toml") as caught:
            scene_of(text)
        lines = str(caught.value).splitlines()
        assert [line.removeprefix("scene.toml: ").split(".")[0].split(" ")[0] for line in lines] == places


def test_a_stored_scene_reads_no_other_file(tmp_path):
    """A data file may be anybody's: its scene has its tables in it, or is refused, whatever its names lead to."""
    simulation = md.Simulation(liquid(3), md.LennardJones(1.0, 1.0, 1.8), md.VelocityVerlet(0.004))
    law = 'type = "lennard-jones"\nepsilon = 1.0\nsigma = 1.0\n'
    simulation.engine.notes["scene"] = melt_scene(3, 10).replace(law, 'type = "tabulated"\nfile = "lj.dat"\n')
    simulation.run(4, every=2, trajectory=tmp_path / "a.h5md")
    np.savetxt(tmp_path / "lj.dat", np.ones((9, 2)))
    for go_on in (md.Simulation.resume, resume_run):
        assert_answered(lambda: go_on(tmp_path / "a.h5md"), ValueError, "potential[0]", "'lj.dat'")


# fmt: off
def drawn(values, rng):
    return values[int(rng.integers(len(values)))]

def peak():
    """Most memory that this process had at once [kB], on Linux; 0 elsewhere."""
    return int(re.search(r"VmHWM:\s*(\d+)", STATUS.read_text())[1]) if STATUS.exists() else 0

def text_of(scene):
    return "\n".join(f"{key} = {toml_of(value)}" for key, value in scene.items())

def toml_of(value):
    """A value as TOML writes it, tables inline."""
    if isinstance(value, dict):
        return "{" + ", ".join(f"{json.dumps(key)} = {toml_of(one)}" for key, one in value.items()) + "}"
    if isinstance(value, list):
        return f"[{', '.join(map(toml_of, value))}]"
    return json.dumps(value) if isinstance(value, str | bool) else repr(value)

def places(value, path=()):
    """The paths of all values in a scene, of tables and lists too."""
    inside = value.items() if isinstance(value, dict) else enumerate(value) if isinstance(value, list) else ()
    for key, one in inside:
        yield (*path, key)
        yield from places(one, (*path, key))

def at(scene, path):
    """What stands at a path; an empty table if there is nothing any more."""
    for key in path:
        scene = scene[key] if isinstance(scene, list) or key in scene else {}
    return scene
# fmt: on


def change(scene, rng):
    """One mistake in a scene: what it is, and whether no sense can be made of the scene now."""
    *path, key = drawn(list(places(scene)), rng)
    table, way, is_senseless = at(scene, path), drawn(WAYS, rng), False
    old, where = table[key], {key, *path}
    if way == "misspelt" and isinstance(table, dict) and ("species" not in path or isinstance(old, float)):
        table[f"{key}x"], is_senseless = table.pop(key), True
    elif way == "gone":
        del table[key]
    elif way == "twice" and isinstance(table, list):
        table.append(copy.deepcopy(old))
    elif way == "sense":
        table[key] = drawn(SENSELESS, rng)
        may_be_energy, may_be_empty = "u" in where and table[key] == -(2**63), key in MAY_BE_EMPTY and table[key] == {}
        is_senseless = not (MAY_BE_TEXT & where or may_be_energy or may_be_empty)
    elif way == "value":
        value = drawn(STRANGE, rng)
        is_large = isinstance(value, int) and value > 100 and LARGE_IS_NO_MISTAKE & where
        table[key] = old if is_large else value
    elif way == "scaled" and isinstance(old, int | float) and not LARGE_IS_NO_MISTAKE & where:
        table[key] = old * drawn(FACTORS, rng)
    elif way == "elsewhere":
        *others, last = drawn(list(places(scene)), rng)
        table[key] = copy.deepcopy(at(scene, [*others, last]))
    return f"{'.'.join(map(str, (*path, key)))} {way}", is_senseless


def mutated(rng):
    """The text of a scene with one to three mistakes, what they are, and whether no sense can be made of it."""
    scene, told, is_senseless = copy.deepcopy(drawn(SCENES, rng)), [], False
    for _ in range(int(rng.integers(1, 4))):
        words, is_senseless = change(scene, rng)
        told.append(words)
        if is_senseless:
            break  # before another mistake takes it away
    text = text_of(scene)
    if rng.random() < 0.2:  # and mistakes of typing
        k, n = int(rng.integers(len(text))), int(rng.integers(1, 5))
        text = text[:k] + drawn(["", "\n" + text[k : k + n], 2 * text[k : k + n]], rng) + text[k + n :]
        is_senseless = False
    return text, ", ".join(told), is_senseless


def built_and_run(text, n_steps):
    simulation = everything_of(text)
    if n_steps and len(simulation.system) < 2000:
        simulation.run(n_steps, every=1, progress=False, crash_report=False)
        assert np.isfinite(simulation.record.total_energy).all()


def answer_to(text, is_senseless, n_steps):
    """The class of the answer, an identifier; other words say what is wrong with it."""
    if STATUS.exists():
        CLEAR.write_text("5")  # the peak is counted anew
    started, before = process_time(), peak()
    kind = answer_of(lambda: built_and_run(text, n_steps), is_senseless, has_several_problems=True)
    seconds, grown = process_time() - started, peak() - before
    if grown > KILOBYTES or (seconds > SECONDS and not n_steps):  # with steps, it may compile
        return f"{seconds:.1f} s, {grown} kB more"
    return kind


@pytest.mark.parametrize(("seed", "n_scenes", "n_steps"), SEEDS)
def test_every_scene_with_mistakes_is_answered_with_a_sentence_or_a_right_result(seed, n_scenes, n_steps):
    as_they_are = [answer_to(text_of(scene), False, n_steps) for scene in SCENES * 2]  # the first time, they compile
    assert as_they_are[len(SCENES) :] == ["result"] * len(SCENES)
    rng = np.random.default_rng(seed)
    drawn_scenes = (mutated(rng) for _ in range(n_scenes))
    assert_right((f"{told}\n{text}\n", answer_to(text, senseless, n_steps)) for text, told, senseless in drawn_scenes)


LONG = {
    "title": f'title = "{"x" * 10**6}"', "number": f"x = {'1' * 10**5}", "words": f'title = "{"a b " * 10**5}"',
    "dots": f'title = "{"a." * 60}{"b" * 10**5}"', "keys": "\n".join(f"key_{k} = {k}" for k in range(5000)),
    "tables": "\n".join(f"[a{k}.b.c.d]" for k in range(3000)),
}  # fmt: skip


@pytest.mark.parametrize("name", LONG)
def test_a_long_scene_is_answered_in_time_and_not_at_length(name, here):
    started = process_time()
    with pytest.raises(ValueError, match=r"scene\.toml: ") as refused:
        scene_of(LONG[name])
    assert process_time() - started < SECONDS
    assert len(str(refused.value)) < 10**5
