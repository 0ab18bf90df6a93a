"""docs/export.md says what the code does."""

from pathlib import Path

from hybrid_dynamics.export import FORMATS
from hybrid_dynamics.export.reference import tables

PAGE = (Path(__file__).parents[1] / "docs" / "export.md").read_text(encoding="utf-8")


def test_the_tables_are_those_of_the_code():
    assert tables() in PAGE, "run: make pages"


def test_every_format_is_explained():
    assert all(f"| `{form}` | " in PAGE for form in FORMATS)
