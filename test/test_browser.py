"""The browser that tests need, and what `scripts/test` says without one. Oracle: a PATH that has none."""

from __future__ import annotations

import re
import shutil
import subprocess
from pathlib import Path

import pytest
from browser import NAMES, executable

SCRIPT = Path(__file__).parents[1] / "scripts" / "test"


@pytest.fixture
def empty_path(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Set a PATH on which there is nothing but what the script needs to get to its folder."""
    for tool in ("bash", "dirname"):
        (tmp_path / tool).symlink_to(shutil.which(tool) or tool)
    monkeypatch.setenv("PATH", str(tmp_path))
    return tmp_path


def test_without_a_browser_scripts_test_says_in_one_line_what_to_install(empty_path: Path) -> None:
    done = subprocess.run([SCRIPT], capture_output=True, text=True, check=False)
    assert done.returncode == 1
    assert done.stdout == ""
    assert re.fullmatch(r"test: no browser.*'apt-get install chromium'\n", done.stderr)
    with pytest.raises(FileNotFoundError, match="apt-get install chromium"):
        executable()


@pytest.mark.parametrize("name", NAMES)
def test_a_browser_is_found_under_each_name(empty_path: Path, name: str) -> None:
    browser = empty_path / name
    browser.symlink_to("/bin/true")
    assert executable() == str(browser)


def test_scripts_test_looks_under_the_same_names() -> None:
    looked = re.search(r"command -v ([\w -]+) >/dev/null", SCRIPT.read_text())
    assert looked is not None
    assert tuple(looked[1].split()) == NAMES
