"""Every benchmark still runs and finds its own result right; its speed is nobody's test."""

import importlib.util
import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path
from types import ModuleType

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


def load(name: str) -> ModuleType:
    spec = importlib.util.spec_from_file_location(name, ROOT / "benchmarks" / f"{name}.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@pytest.mark.slow
def test_a_run_is_measured_by_what_it_and_its_children_use() -> None:
    busy = (
        "import os, time; os.fork(); end = time.process_time() + 0.4\nwhile time.process_time() < end: pass"
    )
    words = [sys.executable, "-c", f"{busy}\ntime.sleep(60)"]
    measure = load("elsewhere").processor_seconds
    process, end = subprocess.Popen(words, start_new_session=True), time.monotonic() + 60
    try:
        while (used := measure(process.pid)) < 0.75 and process.poll() is None and time.monotonic() < end:
            time.sleep(0.05)
    finally:
        os.killpg(process.pid, signal.SIGKILL)
        process.wait()
    assert 0.75 <= used < 2.0, "two processes of 0.4 s each, and a start of Python"
    assert measure(process.pid) == 0.0


@pytest.mark.slow
def test_the_rival_trains_on_a_task_and_stops_when_asked(tmp_path: Path) -> None:
    pytest.importorskip("sb3_contrib")
    task, rows = ROOT / "examples" / "tasks" / "places", tmp_path / "rows.jsonl"
    given = ["--task", f"{task}.py", "--config", f"{task}.yaml", "--out", str(rows), "--every", "20"]
    process = subprocess.Popen([sys.executable, str(ROOT / "benchmarks" / "recurrent_ppo.py"), *given])
    end = time.monotonic() + 100
    while not (rows.exists() and rows.read_text()) and process.poll() is None and time.monotonic() < end:
        time.sleep(0.2)
    process.send_signal(signal.SIGTERM)
    assert process.wait(60) == 0
    row = json.loads(rows.read_text().splitlines()[0])
    assert row["episodes"] >= 20
    assert row["rate/success"] + row["rate/failure"] + row["rate/timeout"] == pytest.approx(1, abs=1e-3)
