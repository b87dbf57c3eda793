"""What is run on minimd, each session in an environment of its own: `nox -s tests`, and `nox -l` lists them.

What follows `--` is passed on: `nox -s tests -- tests/forces`. Another Python: `nox -s tests --force-python 3.14`.
`nox` alone runs the first three.
"""

import nox

nox.needs_version = ">=2025.2.9"
nox.options.default_venv_backend = "virtualenv"
DEV = nox.project.dependency_groups(nox.project.load_toml("pyproject.toml"), "dev")


@nox.session
def lint(session):
    """All hooks of .pre-commit-config.yaml: ruff, codespell, forms of files."""
    session.install("--no-compile", *DEV)
    session.run("pre-commit", "run", "--all-files", "--show-diff-on-failure", *session.posargs)


@nox.session
def types(session):
    """Type hints, by mypy."""
    session.install("--no-compile", ".[test]", *DEV)
    session.run("mypy", *session.posargs)


@nox.session
def tests(session):
    """The tests that are not slow."""
    session.install("--no-compile", ".[test]")
    session.run("pytest", *session.posargs)


@nox.session(default=False)
def slow(session):
    """The slow tests, some of which need other engines; an hour and more."""
    session.install("--no-compile", ".[dev]")
    session.run("pytest", "-m", "slow", *session.posargs)


@nox.session(default=False)
def lowest(session):
    """The tests with the lowest versions that pyproject.toml allows."""
    session.run("python", "tests/lowest_versions.py", f"{session.virtualenv.location}/lowest", *session.posargs)


@nox.session(default=False)
def docs(session):
    """The site, in the folder site; `-- -D plot_gallery=0` leaves out the outputs of the examples."""
    session.install("--no-compile", ".[docs]")
    session.run("sphinx-build", "-WEa", *session.posargs, "docs", "site")


@nox.session(default=False)
def mutants(session):
    """Faults of one token each: does a test find them? `-- neighbors`, or numbers, for some of them."""
    session.install("--no-compile", ".[test]")
    session.run("python", "tests/mutants.py", *session.posargs)


@nox.session(default=False)
def release(session):
    """sdist and wheel of the last commit, tried with every Python that is found; `-- PYTHON` for one."""
    session.run("python", "release/try_release.py", *session.posargs)


@nox.session(default=False)
def bench(session):
    """A line in the table of speeds; `-- peers --quick`, or another benchmark."""
    session.install("--no-compile", "--editable", ".")
    session.run("minimd", "bench", *(session.posargs or ("--history", "release/speeds.csv")))
