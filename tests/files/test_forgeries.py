"""Files made by others: whatever a field holds, its checksum right, every door ends in a sentence or a right result."""

import pytest
from forgeries import DOORS, SCENES, judged, make_file, warm

QUICK = ("digest", "read", "check", "ASE", "universe", "append")


@pytest.fixture(scope="module")
def sound(tmp_path_factory):
    folder = tmp_path_factory.mktemp("sound")
    made = {}

    def file(name):
        if name not in made:
            made[name] = make_file(folder, name)
        return made[name]

    return file


def test_a_sample_of_forged_files_ends_in_a_sentence_or_a_right_result(sound):
    folder = sound("plain").parent / "sample"
    folder.mkdir()
    for seed in range(12):
        assert not list(judged(sound("plain"), folder, seed, [QUICK[seed % len(QUICK)]]))


@pytest.mark.slow
def test_three_thousand_forged_files_end_in_a_sentence_or_a_right_result(sound):
    names, doors = list(SCENES), list(DOORS)
    folder = sound("plain").parent / "forged"
    folder.mkdir()
    for name in names:
        warm(sound(name), folder)
    faults = []
    for seed in range(1000, 4000):
        chosen = [doors[(seed // 4 + k * 4) % len(doors)] for k in range(2)]
        faults += judged(sound(names[seed // 4 % len(names)]), folder, seed, chosen)
    assert not faults
