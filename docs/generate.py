"""Write the generated parts of the docs: `python docs/generate.py`; `--check` names what is no longer true.

A part stands in a page between `<!-- generated: NAME -->` and `<!-- end -->`; `PARTS` says what makes it.
"""

import re
import sys
from collections.abc import Callable
from pathlib import Path

from reference.generated import command_line, configuration, errors
from results import tables

DOCS = Path(__file__).parent
PARTS: dict[str, Callable[[], str]] = {
    "command line": command_line,
    "configuration": configuration,
    "errors": errors,
    "success after 100,000 episodes": tables.long_runs,
    "success after 30,000 episodes": tables.short_runs,
    "episodes to a rate": tables.first_to_rate,
    "relabelling": tables.relabelling,
    "shipped agents": tables.shipped,
    "overlooked goals": tables.overlooked,
    "goals behind objects": tables.aside,
    "missed by agents": tables.missed,
    "localisation": tables.localisation,
    "imitated again": tables.replay,
    "memory": tables.memory,
    "ways": tables.ways,
    "again": tables.again,
    "goals behind objects, again": tables.aside_again,
    "new objects, shown": tables.shown,
    "new objects, learned": tables.learned,
    "elsewhere": tables.elsewhere,
    "profile": tables.profile,
}
_PART = re.compile(r"(<!-- generated: (.+?) -->\n).*?(<!-- end -->)", re.DOTALL)


def generated(page: str) -> str:
    """The text of a page with each of its generated parts made anew.

    Raises:
        KeyError: a part that nothing makes.
    """
    return _PART.sub(lambda found: f"{found[1]}{PARTS[found[2]]()}\n{found[3]}", page)


def main() -> int:
    """Write every page that is no longer true; with `--check` name them instead."""
    is_check, stale = "--check" in sys.argv, []
    for path in [*sorted(DOCS.rglob("*.md")), DOCS.parent / "README.md"]:
        page = path.read_text(encoding="utf-8")
        made = generated(page)
        if made != page:
            stale.append(path.name)
            if not is_check:
                path.write_text(made, encoding="utf-8")
    for name in stale:
        print(f"{name}: {'not true any more: python docs/generate.py' if is_check else 'made anew'}")
    return int(is_check and bool(stale))


if __name__ == "__main__":
    sys.exit(main())
