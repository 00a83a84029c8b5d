"""The README's tables say what the code declares; links inside the repository lead somewhere."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from jpap_ros.nodes.parameter_tables import tables, with_tables

ROOT = Path(__file__).parent.parent
PAGES = sorted([*ROOT.glob("*.md"), *ROOT.glob("docs/**/*.md")])


def test_parameter_tables_are_those_of_the_code() -> None:
    # Oracle: the declarations that the nodes hand to rclpy.
    text = (ROOT / "README.md").read_text(encoding="utf-8")
    assert with_tables(text) == text, "run scripts/docs"
    for name in ("`fleet_file`", "`scheme` *", "`setpoint_rate_hz`", "`speedup`"):
        assert f"| {name} |" in tables()


def test_a_page_without_marks_is_refused() -> None:
    with pytest.raises(ValueError, match="marks"):
        with_tables("# a page")


@pytest.mark.parametrize("page", PAGES, ids=lambda page: str(page.relative_to(ROOT)))
def test_links_lead_somewhere(page: Path) -> None:
    # Oracle: the file system, and GitHub's rule for headings (lower case, spaces to dashes, punctuation dropped).
    text = page.read_text(encoding="utf-8")
    for target in re.findall(r"\]\(([^)\s]+)\)", re.sub(r"```.*?```", "", text, flags=re.DOTALL)):
        if re.match(r"[a-z]+:", target):
            continue
        path, _, anchor = target.partition("#")
        linked = (page.parent / path).resolve() if path else page
        assert linked.exists(), f"{target} does not exist"
        if anchor:
            headings = re.findall(r"^#+ (.+)$", linked.read_text(encoding="utf-8"), flags=re.MULTILINE)
            anchors = {re.sub(r"[^\w\- ]", "", heading.lower()).replace(" ", "-") for heading in headings}
            assert anchor in anchors, f"{target}: no such heading"
