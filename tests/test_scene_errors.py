"""Scenes that are wrong are answered with one sentence."""

import pytest
from scene_texts import ARGON, REDUCED, everything_of, scene_of

from minimd.scene import load_scene

SLAB = """[structure]
file = "two.xyz"
{}
[[potential]]
type = "lennard-jones"
epsilon_K = 120.0
sigma_A = 3.4
cutoff_A = 8.5
[dynamics]
timestep_fs = 5.0
steps = 1
"""


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        (
            "timestep = 0.004",
            "timestep_fs = 4.0",
            ["dynamics has no key 'timestep_fs' (= 4.0)", "did you mean 'timestep'?", "LJ units"],
        ),
        ("timestep = 0.004", "timestep = -0.004", ["dynamics.timestep must be greater than 0", "= -0.004"]),
        ("timestep = 0.004", "timestep = nan", ["dynamics.timestep must be a finite number"]),
        ("timestep = 0.004", 'timestep = "4 fs"', ["dynamics.timestep must be a number", '"4 fs"']),
        ("timestep = 0.004\n", "", ["dynamics.timestep is missing"]),
        ("steps = 20", "steps = 2.5", ["dynamics.steps must be a whole number", "2.5"]),
        ("seed = 3", "sed = 3", ["dynamics has no key 'sed'", "did you mean 'seed'?"]),
        ("[dynamics]", "[dynamix]", ["a scene has no key 'dynamix'", "did you mean 'dynamics'?"]),
        ("temperature = 1.44", "temperature = true", ["dynamics.temperature must be a number", "true"]),
        ("cutoff = 2.5", "cutoff = -2.5", ["potential[0].cutoff must be greater than 0", "-2.5"]),
        (
            "cutoff = 2.5",
            'cutoff = 2.5\ntruncation = "shfted"',
            ["potential[0].truncation must be one of", "'shifted'", '"shfted"'],
        ),
        (
            "cutoff = 2.5",
            'cutoff = 2.5\nmixing = "mean"',
            ["potential[0].mixing must be one of", "'geometric'", '"mean"'],
        ),
        (
            "cutoff = 2.5",
            'cutoff = 2.5\ntruncation = "switched"\nswitch_start = 3',
            ["potential[0]: switch_start must lie between 0 and the cutoff"],
        ),
        ("cutoff = 2.5\n", "", ["cutoff must be given in a periodic cell"]),
        ("sigma = 1.0\n", "", ["potential[0] must have either epsilon and sigma"]),
        (
            '"lennard-jones"',
            '"lenard-jones"',
            ["potential[0].type must be one of", "'harmonic-bond'", '"lenard-jones"'],
        ),
        ('type = "lennard-jones"\n', "", ["potential[0].type is missing"]),
        ('"fcc"', '"hcp"', ["structure.lattice must be one of", "'diamond'", '"hcp"']),
        ("[4, 4, 4]", "[4, 4, 1000000000000]", ["structure: repeat must be", "1000000000000"]),
        ("[4, 4, 4]", "[4, 40000, 40000]", ["structure: repeat must make at most", "makes 2.6e+10"]),
        ("timestep = 0.004", f"timestep = 1{400 * '0'}", ["dynamics.timestep must be a"]),
        ("[4, 4, 4]", "[4, 4]", ["structure.repeat must have at least 3 entries", "[4, 4]"]),
        ("[4, 4, 4]", "[4, 4, 0]", ["structure.repeat[2] must be greater than 0", "= 0"]),
        ("density = 0.8442\n", "", ["structure must have either density or lattice_constant"]),
        ("density = 0.8442", 'density = 0.8442\nfile = "a.xyz"', ["structure must have either file or lattice"]),
        (
            "density = 0.8442",
            "density = 0.8442\nbonds = [[0, 256]]",
            ["structure: bonds must name atoms 0 to 255", "[0, 256]"],
        ),
        (
            "density = 0.8442",
            "density = 0.8442\nbonds = [[0, 1, 2]]",
            ["structure.bonds[0] must have at most 2 entries", "[0, 1, 2]"],
        ),
        ("density = 0.8442", 'density = 0.8442\nspecies = ["A"]', ["structure: species must be 256 labels"]),
        ("every = 5", "every = 0", ["output.every must be greater than 0", "= 0"]),
        ("every = 5", "plot = 3", ["output.plot must be a boolean or a string", "= 3"]),
        ("every = 5", 'plot = "a.docx"', ["output.plot must be true, false or a name", "a.docx"]),
        (
            "every = 5",
            'plot = true\ntrajectory = "a.xyz"',
            ["output.plot needs a trajectory that ends in .h5md", "a.xyz"],
        ),
        ('units = "LJ"', 'units = "SI"', ["units must be 'ASE' or 'LJ'", '"SI"']),
        (
            "[output]",
            "[equilibration]\nsteps = -1\n[output]",
            ["equilibration.steps must be greater than or equal to 0", "= -1"],
        ),
        ("[[potential]]", "[potential]", ["potential must be written [[potential]], with two brackets"]),
        ("seed = 3", 'method = "verlet"', ["dynamics.method must be one of", "'velocity-verlet'", '"verlet"']),
    ],
)
def test_wrong_entry_is_answered_with_one_sentence(old, new, words):
    assert old in REDUCED
    with pytest.raises(ValueError, match=r"scene\.toml: ") as caught:
        everything_of(REDUCED.replace(old, new, 1))
    assert "\n" not in str(caught.value)
    assert [word for word in words if word not in str(caught.value)] == [], caught.value


@pytest.mark.parametrize(
    ("entry", "words"),
    [
        (
            "cell_A = [20, 20]",
            [
                "structure.cell_A must have at least 3 entries",
                "= [20, 20]: give all three edges, 0 along",
                "[20, 20, 0] with pbc",
            ],
        ),
        ("cell_A = [20, 20, 20, 20]", ["structure.cell_A must have at most 3 entries", "give all three edges"]),
        (
            "pbc = [true, true]",
            ["structure.pbc must be", "= [true, true]: give one for all directions, or three", "[true, true, false]"],
        ),
    ],
)
def test_edges_that_are_not_three_are_answered_with_what_to_write(tmp_path, entry, words):
    (tmp_path / "two.xyz").write_text("2\n\nAr 0 0 0\nAr 4 0 0\n")
    with pytest.raises(ValueError, match=r"structure\.") as caught:
        scene_of(SLAB.format(entry))
    assert [word for word in words if word not in str(caught.value)] == [], caught.value
    path = tmp_path / "scene.toml"
    path.write_text(SLAB.format("cell_A = [20, 20, 0]\npbc = [true, true, false]"))  # as the message says
    assert load_scene(path).simulation().system.cell.pbc.tolist() == [True, True, False]


def test_pairs_of_a_misspelt_species_are_refused():
    species = "[potential.species.A]\nepsilon = 1.0\nsigma = 1.0\n[potential.species.B]\nepsilon = 1.0\nsigma = 1.0\n"
    pairs = '[[potential.pairs]]\nspecies = ["A", "Bb"]\nepsilon = 2.0\nsigma = 1.0\n'
    text = REDUCED.replace("epsilon = 1.0\nsigma = 1.0\n", "").replace(
        "cutoff = 2.5\n", f"cutoff = 2.5\n{species}{pairs}"
    )
    text = text.replace("density = 0.8442\n", f"density = 0.8442\nspecies = {128 * ['A', 'B']}\n")
    with pytest.raises(
        ValueError,
        match=r"scene\.toml: pairs of LennardJones must be of known species, 'A', 'B'; they name 'Bb'; did you mean 'B'\?",
    ):
        everything_of(text)
    everything_of(text.replace("Bb", "B"))


def test_all_problems_are_told_at_once():
    text = REDUCED.replace("density", "densty").replace("steps = 20", "steps = -20").replace("every", "evry")
    with pytest.raises(ValueError, match="densty") as caught:
        scene_of(text)
    assert len(str(caught.value).splitlines()) == 3


def test_one_quantity_in_two_units_is_refused():
    text = ARGON.read_text().replace("epsilon_K = 120.0", "epsilon_K = 120.0\nepsilon_eV = 0.0103")
    with pytest.raises(ValueError, match=r"potential\[0\] has 'epsilon_eV' and the same quantity in another unit"):
        scene_of(text)


def test_all_problems_of_one_table_are_told_at_once():
    text = REDUCED.replace("steps = 20", "steps = -20\nrelaxation_tim = 0.3\nsed = 2")
    with pytest.raises(ValueError, match="relaxation_tim") as caught:
        scene_of(text)
    assert [line.split(";")[0].split(" (")[0] for line in str(caught.value).splitlines()] == [
        "scene.toml: dynamics.steps must be greater than or equal to 0",
        "scene.toml: dynamics has no key 'relaxation_tim'",
        "scene.toml: dynamics has no key 'sed'",
    ]


def test_key_without_its_unit_is_no_quantity():
    with pytest.raises(
        ValueError, match=r"structure has no key 'density' \(= 1\.374\); did you mean 'density_g_cm3'\?"
    ):
        scene_of(ARGON.read_text().replace("density_g_cm3", "density"))


def test_equilibration_needs_a_temperature_to_start_from():
    text = REDUCED.replace("temperature = 1.44\n", "") + "[equilibration]\nsteps = 10\ntemperature = 1.0\n"
    with pytest.raises(ValueError, match=r"equilibration needs dynamics\.temperature"):
        scene_of(text)


@pytest.mark.parametrize(
    ("content", "words"),
    [
        ("a = [", "this is not valid TOML"),
        ("[b]\nkey = 1\nkey = 2", "this is not valid TOML: Cannot overwrite a value .*, in 'key = 2'$"),
        ("b = 1\nb = 2\nc = 3\n", r"Cannot overwrite a value \(at line 2, column 6\), in 'b = 2'$"),
        ("\ufeff", "this is not valid TOML"),
        (b"\xff\xfe", "must be UTF-8 text"),
        (f"x = {'[' * 2000}{']' * 2000}", "nested too deeply"),
        (f"x = {'{a=' * 2000}1{'}' * 2000}", "nested too deeply"),
        (f"{'a.' * 20_000}a = 1", "nested too deeply"),
        (f"[{'a . ' * 20_000}a]", "nested too deeply"),
    ],
)
def test_what_is_no_toml_is_told_in_one_line(tmp_path, content, words):
    (tmp_path / "a.toml").write_bytes(content if isinstance(content, bytes) else content.encode())
    with pytest.raises(ValueError, match=words) as caught:
        load_scene(tmp_path / "a.toml")
    assert "\n" not in str(caught.value)
