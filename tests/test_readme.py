"""The README's scripts run as they stand, shortened."""

import re
from pathlib import Path

import pytest

README = Path(__file__).parents[1] / "README.md"
SCRIPTS = re.findall(r"```python\n(.*?)```", README.read_text(encoding="utf-8"), re.S)


@pytest.mark.parametrize("script", SCRIPTS, ids=range(len(SCRIPTS)))
def test_readme_scripts_run(script, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    short = script.replace("equilibrate(4000", "equilibrate(100").replace("run(10_000, every=50", "run(200, every=10")
    exec(compile(short, str(README), "exec"), {})
    assert capsys.readouterr().out.strip()


def test_readme_has_no_blanks():
    assert "@" not in README.read_text(encoding="utf-8").replace("@dataclass", "")
