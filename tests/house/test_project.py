"""What stands around the package agrees: Pythons, addresses, and what outsiders look for."""

import re
import tomllib
from pathlib import Path

import mutants
import pytest
from slow_cases import quick_cases

REPOSITORY = Path(__file__).parents[2]
PROJECT = tomllib.loads((REPOSITORY / "pyproject.toml").read_text(encoding="utf-8"))["project"]
AROUND = ["CODE_OF_CONDUCT.md", "CONTRIBUTING.md", "SECURITY.md", "noxfile.py", ".pre-commit-config.yaml"]
FORMS = ["dependabot.yml", "pull_request_template.md", "ISSUE_TEMPLATE/bug.yml", "ISSUE_TEMPLATE/question.yml"]
WORKFLOWS = ["ci.yml", "docs.yml", "release.yml", "slow.yml"]
AROUND += [f".github/{name}" for name in FORMS] + [f".github/workflows/{name}" for name in WORKFLOWS]
MUTANTS = [(mutant.file, mutant.old) for mutant in mutants.listed()]
if not (REPOSITORY / ".ci").exists():
    pytest.skip("an sdist has no workflows", allow_module_level=True)


@pytest.mark.parametrize("name", AROUND)
def test_files_that_outsiders_look_for_are_there_and_their_address_is_that_of_the_project(name):
    source = PROJECT["urls"]["Source"]
    addresses = re.findall(r"https://github\.com/[\w-]+/[\w-]+", (REPOSITORY / name).read_text(encoding="utf-8"))
    assert {*addresses} <= {source}
    assert f'repository-code: "{source}"' in (REPOSITORY / "CITATION.cff").read_text(encoding="utf-8")
    assert all(url.startswith(source) for name, url in PROJECT["urls"].items() if name != "Documentation")


def test_workflows_run_the_pythons_of_the_classifiers():
    workflow = (REPOSITORY / ".github" / "workflows" / "ci.yml").read_text(encoding="utf-8")
    (matrix,) = re.findall(r"python: \[(.*)\]", workflow)
    pythons = re.findall(r":: (3\.\d+)$", "\n".join(PROJECT["classifiers"]), re.M)
    assert re.findall(r"3\.\d+", matrix) == pythons
    assert PROJECT["requires-python"] == f">={pythons[0]}"


@pytest.mark.parametrize(("file", "old"), MUTANTS)
def test_a_mutant_quotes_one_place(file, old):
    assert (REPOSITORY / "minimd" / file).read_text(encoding="utf-8").count(old) == 1


@pytest.mark.parametrize("name", dict(quick_cases()))
def test_what_is_marked_as_slow_is_there(name):
    file, _, test = name.partition("::")
    assert f"def {test}(" in (REPOSITORY / "tests" / file).read_text(encoding="utf-8")
