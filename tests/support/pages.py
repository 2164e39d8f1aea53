"""Pages of the docs, and the code in them."""

import re
from pathlib import Path

ROOT = Path(__file__).parents[2]
DOCS = ROOT / "docs"


def blocks(language: str, page: str) -> list[str]:
    """The code blocks of a page in a language, which may be a regular expression."""
    return re.findall(rf"```{language}\n(.*?)```", page, re.DOTALL)


def read(page: Path) -> str:
    """The text of a page."""
    return page.read_text(encoding="utf-8")
