"""No module needs, by way of others, one that needs it: in every crate, and in the Python package."""

from __future__ import annotations

import ast
import re
from collections import defaultdict
from collections.abc import Iterator
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
CRATES = sorted(path.parent for path in ROOT.glob("rust/*/src"))
PYTHON = ROOT / "python"

Graph = dict[str, set[str]]


def circle(graph: Graph) -> list[str]:
    """The nodes of a circle in the graph; empty where there is none."""
    left = {node: set(graph.get(node, ())) for node in set(graph).union(*graph.values())}
    while True:
        ends = {node for node, needed in left.items() if not needed}
        if not ends:
            break
        left = {node: needed - ends for node, needed in left.items() if node not in ends}
    walk: list[str] = []
    node = min(left, default="")
    while node and node not in walk:
        walk.append(node)
        node = min(left[node])
    return walk[walk.index(node) :] if walk else []


def folders(graph: Graph) -> Graph:
    """The same between the folders and files at the top: what a file needs, its folder needs."""
    top: Graph = defaultdict(set)
    for node, needed in graph.items():
        own = node.split("::", 1)[0]
        top[own] |= {other.split("::", 1)[0] for other in needed} - {own}
    return top


def rust_modules(crate: Path) -> dict[str, Path]:
    """The files of a crate by the path of their module, the root's is empty; without tests."""
    source, found = crate / "src", {}
    for path in source.rglob("*.rs"):
        parts = list(path.relative_to(source).with_suffix("").parts)
        if "tests" not in parts:
            found["::".join(part for part in parts if part not in ("mod", "lib", "main"))] = path
    return found


def leaves(tree: str) -> Iterator[str]:
    """The paths of a tree of imports: `a::{b, c::d}` has two."""
    head, brace, rest = tree.partition("{")
    if not brace:
        yield head.split(" as ")[0].strip()
        return
    depth, start = 0, 0
    inner = rest[: rest.rindex("}")]
    for place, letter in enumerate(inner + ","):
        depth += {"{": 1, "}": -1}.get(letter, 0)
        if letter == "," and depth == 0:
            if inner[start:place].strip():
                yield from (head.strip() + leaf for leaf in leaves(inner[start:place].strip()))
            start = place + 1


def rust_needs(module: str, path: Path, modules: dict[str, Path]) -> set[str]:
    """The modules of the crate that a file names, but for comments and its tests."""
    code = re.sub(r"//.*", "", path.read_text(encoding="utf-8"))
    code = code.split("#[cfg(test)]\nmod ")[0]
    trees = re.findall(r"\buse\s+((?:crate|super|self)::[^;]+);", code)
    trees += re.findall(r"(?<!use )\b((?:crate|super)(?:::\w+)+)", code)
    found = set()
    # `self` and `super` start at the module of the file.
    for leaf in (leaf for tree in trees for leaf in leaves(tree)):
        parts, at = leaf.split("::"), module.split("::") if module else []
        while parts and parts[0] in ("crate", "super", "self"):
            at = {"crate": [], "super": at[:-1], "self": at}[parts.pop(0)]
        named = [*at, *parts]
        while named and "::".join(named) not in modules:
            named.pop()
        found.add("::".join(named))
    return found - {module}


def rust_graph(crate: Path) -> Graph:
    modules = rust_modules(crate)
    graph = {module: rust_needs(module, path, modules) for module, path in modules.items()}
    # The root hands on what all have: that it names everything makes no circle.
    return {module: needed for module, needed in graph.items() if module}


def python_graph() -> Graph:
    modules = {}
    for path in [*PYTHON.glob("vhs/**/*.py"), PYTHON / "vhs/_core.pyi"]:
        parts = path.relative_to(PYTHON).with_suffix("").parts
        modules["::".join(part for part in parts if part != "__init__")] = path
    return {module: python_needs(module, path, modules) for module, path in modules.items()}


def python_needs(module: str, path: Path, modules: dict[str, Path]) -> set[str]:
    """What a file imports when it is imported itself: not in functions, not for type checkers alone."""
    found = set()
    for node in ast.parse(path.read_text(encoding="utf-8")).body:
        if isinstance(node, ast.ImportFrom) and node.module and not node.level:
            found |= {f"{node.module}.{alias.name}" for alias in node.names}
        if isinstance(node, ast.Import):
            found |= {alias.name for alias in node.names}
    needed = set()
    for name in found:
        parts = name.split(".")
        while parts and "::".join(parts) not in modules:
            parts.pop()
        needed.add("::".join(parts))
    return needed - {module, ""}


def test_a_circle_is_found() -> None:
    assert circle({"a": {"b"}, "b": {"c"}, "c": {"b"}, "d": {"a"}}) == ["b", "c"]
    assert circle({"a": {"b", "c"}, "b": {"c"}, "c": set()}) == []
    assert list(leaves("crate::{a::{self, b}, c as d}")) == ["crate::a::self", "crate::a::b", "crate::c"]


@pytest.mark.parametrize("crate", CRATES, ids=lambda crate: crate.name)
def test_a_crate_has_no_circles(crate: Path) -> None:
    graph = rust_graph(crate)
    assert circle(graph) == []
    assert circle(folders(graph)) == []


def test_the_python_package_has_no_circles() -> None:
    graph = python_graph()
    assert len(graph) > 50
    assert circle(graph) == []
