"""Parts of pages that scripts write: what is between two marks ``<!-- name -->``."""

from pathlib import Path


def write_between(page: str, name: str, text: str) -> None:
    """Replace the text between the marks of this name in a page of docs/, and leave the rest."""
    path = Path(__file__).with_name(page)
    mark = f"<!-- {name} -->"
    parts = path.read_text().split(mark)
    if len(parts) != 3:
        msg = f"{path}: expected two marks {mark}, found {len(parts) - 1}"
        raise ValueError(msg)
    path.write_text(f"{parts[0]}{mark}\n{text.strip()}\n{mark}{parts[2]}")
