"""docs/paper-to-code.md names nothing that does not exist, and leaves out no equation, listing line or figure."""

from __future__ import annotations

import ast
import importlib
import re
from pathlib import Path

PAGE = Path(__file__).parents[1] / "docs" / "paper-to-code.md"
#: `file.py::name`, or `file.py::Class.name`.
REFERENCE = re.compile(r"`([\w/]+\.py)::([\w.]+)`")


def rows() -> list[list[str]]:
    """The cells of every table row of the page, headers and rules left out."""
    lines = (line for line in PAGE.read_text().splitlines() if line.startswith("| "))
    cells = ([cell.strip() for cell in line.strip("|").split("|")] for line in lines)
    return [row for row in cells if row[0] not in ("Paper", "Listing", "---")]


def test_everything_named_exists() -> None:
    """Oracle: the modules themselves, and the syntax trees of the tests."""
    references = REFERENCE.findall(PAGE.read_text())
    assert len(references) > 80
    for path, name in references:
        if path.startswith("test_"):
            tree = ast.parse((Path(__file__).parent / path).read_text())
            functions = {node.name for node in tree.body if isinstance(node, ast.FunctionDef)}
            assert name in functions, f"{path} has no test {name}"
        else:
            found: object = importlib.import_module("jpap_ros." + path.removesuffix(".py").replace("/", "."))
            for part in name.split("."):
                assert hasattr(found, part), f"jpap_ros/{path} has no {name}"
                found = getattr(found, part)


def test_every_row_names_code_and_a_test() -> None:
    for row in rows():
        assert len(row) == 4, row
        assert re.search(r"`planning/|`study/", row[2]), row
        tests = REFERENCE.findall(row[3])
        assert tests and all(path.startswith("test_") for path, _ in tests), row


def test_nothing_of_the_paper_is_left_out() -> None:
    """Oracle: the paper's printed numbers: equations 1 to 22, (6a) to (6e), (7a) to (7c), listing lines 1 to 16.

    Lines 12 and 13 only close what others open.
    """
    first = [row[0] for row in rows()]
    equations = {number for cell in first for number in re.findall(r"\((\d+[a-e]?)\)", cell)}
    expected = {str(number) for number in range(1, 23) if number not in (6, 7)}
    expected |= {f"6{letter}" for letter in "abcde"} | {f"7{letter}" for letter in "abc"}
    assert expected <= equations
    listing = {int(part) for cell in first if re.fullmatch(r"[\d, ]+", cell) for part in cell.split(",")}
    assert listing == set(range(1, 17)) - {12, 13}
    assert {1, 2, 3} == {int(number) for cell in first if "Figure" in cell for number in re.findall(r"\d", cell)}
