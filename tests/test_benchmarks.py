"""Every benchmark still runs and finds its own result right; its speed is nobody's test."""

import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parent.parent
QUICK = {"bench_env.py": ["--steps", "40"]}
"""What makes a benchmark short; `--quick` unless said otherwise."""


@pytest.mark.slow
@pytest.mark.parametrize("path", sorted((ROOT / "benchmarks").glob("bench_*.py")), ids=lambda path: path.name)
def test_benchmark_runs(path: Path, tmp_path: Path) -> None:
    numbers = tmp_path / "numbers.json"
    command = [sys.executable, str(path), *QUICK.get(path.name, ["--quick"]), "--json", str(numbers)]
    done = subprocess.run(command, capture_output=True, text=True, timeout=110, check=False, cwd=ROOT)
    if "needs OpenGL" in done.stderr or "NoOpenGLError" in done.stderr:
        pytest.skip("no OpenGL")
    assert done.returncode == 0, done.stderr
    assert numbers.stat().st_size > 2
