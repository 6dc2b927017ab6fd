"""Generated pages are what their scripts write, and links in the documentation lead somewhere."""

import pkgutil
import re
import runpy
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]


def test_table_of_fields_is_current():
    pages = runpy.run_path(str(ROOT / "docs" / "fields.py"))["pages"]()
    assert len(pages) == 3
    for path, text in pages.items():
        assert path.read_text() == text, "run python docs/fields.py"


@pytest.mark.parametrize("page", ["README.md", *(f"docs/{p.name}" for p in (ROOT / "docs").glob("*.md"))])
def test_links_lead_somewhere(page):
    path = ROOT / page
    for target in re.findall(r"\]\(([^)#]+)", path.read_text()):
        if not target.startswith("http"):
            assert (path.parent / target).exists(), f"{page} links to {target}"


def test_readme_names_every_field():
    text = (ROOT / "README.md").read_text()
    from xcg.fields.registry import listed

    assert [name for name in listed() if f"`{name}`" not in text] == []


def test_every_public_name_has_a_page():
    import xcg

    listed = set(re.findall(r"^   ([\w.]+)$", (ROOT / "docs" / "api.md").read_text(), re.MULTILINE))
    modules = {"FIELDS", "datasets", "readers"}  # FIELDS has the page on fields
    assert set(xcg.__all__) - modules <= listed
    for name in listed:
        assert pkgutil.resolve_name(f"xcg.{name}").__doc__, name
