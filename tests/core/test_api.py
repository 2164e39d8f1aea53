"""The public face: names, stub and what an import costs."""

from __future__ import annotations

import ast
import subprocess
import sys
import types
from pathlib import Path

import numpy as np
import pytest

import vhs
from vhs import _core

# Names that bring gymnasium or torch with them, when they are first used.
LAZY = {"HindsightRecorder", "RolloutPool", "train"}
REPOSITORY = Path(__file__).parents[2]


def run(*arguments: str) -> str:
    done = subprocess.run(
        [sys.executable, *arguments], capture_output=True, text=True, cwd=REPOSITORY, check=False
    )
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout


def test_all_names_what_is_exported() -> None:
    exported = {
        name
        for name, value in vars(vhs).items()
        if not name.startswith("_") and not isinstance(value, types.ModuleType)
    }
    exported -= {"Any", "TYPE_CHECKING", "import_module"}  # what the module itself needs
    assert exported | LAZY == set(vhs.__all__)
    assert all(hasattr(vhs, name) for name in LAZY)
    with pytest.raises(AttributeError, match="no attribute 'HindsightRecoder'"):
        _ = vhs.HindsightRecoder
    assert len(vhs.__all__) == len(set(vhs.__all__))


def test_everything_compiled_is_exported() -> None:
    """All but the parts that the renderer and the pool are made of."""
    inner = {"RasterCanvas", "RasterScene", "RasterSource", "RolloutLearner", "RolloutWorker"}
    ours = {"Move", "Outcome", "OutcomeReward", "RasterRenderer", "Seen", "Task", "TaskSpec", "Turn"}
    assert set(_core.__all__) - inner == set(vhs.__all__) - ours - LAZY


def test_importing_vhs_imports_numpy_alone() -> None:
    code = """
import sys
before = set(sys.modules)
import vhs
vhs.GoalStore(1, (1,), 1).push(__import__("numpy").zeros(1, "uint8"), 0)
loaded = {name.partition(".")[0] for name in set(sys.modules) - before}
print(sorted(loaded - sys.stdlib_module_names))
"""
    # What the standard library and the interpreter's own start-up bring does not count.
    assert run("-c", code).strip() == "['numpy', 'vhs']"


def test_outcomes_are_named() -> None:
    assert [(outcome.name.lower(), int(outcome)) for outcome in vhs.Outcome] == [
        ("success", 0),
        ("failure", 1),
        ("timeout", 2),
    ]
    assert vhs.Outcome.from_name("timeout") is vhs.Outcome.TIMEOUT
    with pytest.raises(
        vhs.ArgumentError, match='expected one of "success", "failure", "timeout", got \'won\''
    ):
        vhs.Outcome.from_name("won")


def test_help_says_what_the_stub_says() -> None:
    stub = ast.parse((Path(vhs.__file__).parent / "_core.pyi").read_text(encoding="utf-8"))
    compared = 0
    for node in stub.body:
        if isinstance(node, ast.FunctionDef):
            assert getattr(_core, node.name).__doc__ == ast.get_docstring(node)
        if not isinstance(node, ast.ClassDef) or issubclass(getattr(_core, node.name, Exception), Exception):
            continue
        made = getattr(_core, node.name)
        members = [member for member in node.body if isinstance(member, ast.FunctionDef)]
        text = [ast.get_docstring(node), *(ast.get_docstring(m) for m in members if m.name == "__new__")]
        assert made.__doc__ == "\n\n".join(text), node.name
        for member in members:
            said = ast.get_docstring(member)
            if said is not None and not member.name.startswith("__"):
                assert getattr(made, member.name).__doc__ == said, f"{node.name}.{member.name}"
                compared += 1
    assert compared > 100


def test_a_buffer_without_a_critic_takes_no_values() -> None:
    frame = np.zeros(1, np.uint8)
    buffer = vhs.EpisodeBuffer((1,), num_streams=1, max_episode_steps=2, capacity_steps=2, num_actions=4)
    assert (buffer.num_actions, buffer.interactions) == (4, {})
    buffer.begin(0, frame)
    buffer.append(0, 3, 1.0, None, frame)
    buffer.append_batch([0], [3], [1.0], None, [frame])
    assert buffer.gather([buffer.finish(0, "success")]).values.tolist() == [[0.0, 0.0]]
