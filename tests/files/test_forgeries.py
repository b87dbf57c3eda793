"""Files made by others: whatever a field holds, its checksum right, every door ends in a sentence or a right result."""

import pytest
from forgeries import DOORS, SCENES, judged, make_file


@pytest.fixture(scope="module")
def sound(tmp_path_factory):
    folder = tmp_path_factory.mktemp("sound")
    made = {}

    def file(name):
        if name not in made:
            made[name] = make_file(folder, name)
        return made[name]

    return file


def faults(sound, folder, seeds, n_doors):
    """What is wrong, over files forged by these seeds, each opened by some of the doors in turn."""
    names, doors = list(SCENES), list(DOORS)
    folder.mkdir(exist_ok=True)
    for seed in seeds:
        chosen = [doors[(seed // 4 + k * 4) % len(doors)] for k in range(n_doors)]
        yield from judged(sound(names[seed // 4 % len(names)]), folder, seed, chosen)


@pytest.mark.slow
def test_forged_files_end_in_a_sentence_or_a_right_result(sound, tmp_path):
    assert not list(faults(sound, tmp_path / "forged", range(0, 120, 13), 1))


@pytest.mark.slow
def test_three_thousand_forged_files_end_in_a_sentence_or_a_right_result(sound, tmp_path):
    assert not list(faults(sound, tmp_path / "forged", range(1000, 4000), 2))
