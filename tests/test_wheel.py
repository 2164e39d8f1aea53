"""What is packed: the source distribution, from which every wheel is built, has all that a wheel holds."""

import importlib.util
import subprocess
import sys
import tarfile
from pathlib import Path

import pytest

pytestmark = pytest.mark.slow
ROOT = Path(__file__).parents[1]
CHECKER = ROOT / ".ci" / "check_wheel.py"


@pytest.fixture(scope="module")
def packed(tmp_path_factory: pytest.TempPathFactory) -> set[str]:
    """Names in the source distribution, below its top."""
    folder = tmp_path_factory.mktemp("dist")
    command = [sys.executable, "-m", "maturin", "sdist", "--out", str(folder)]
    subprocess.run(command, cwd=ROOT, check=True, capture_output=True)
    (path,) = folder.iterdir()
    with tarfile.open(path) as opened:
        return {name.partition("/")[2] for name in opened.getnames()}


def test_it_has_the_package_its_configurations_and_agents_and_no_more(packed: set[str]) -> None:
    spec = importlib.util.spec_from_file_location("check_wheel", CHECKER)
    assert spec is not None
    assert spec.loader is not None
    checker = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(checker)
    found = {name.removeprefix("python/") for name in packed if name.startswith("python/")}
    assert found == checker.shipped_files()


def test_it_has_what_the_extension_is_built_from(packed: set[str]) -> None:
    crates = [
        ROOT / "rust" / name for name in ("vhs-base", "vhs-core", "vhs-py", "vhs-raster", "vhs-rollout")
    ]
    sources = {str(path.relative_to(ROOT)) for crate in crates for path in (crate / "src").rglob("*.rs")}
    manifests = {"Cargo.toml", "Cargo.lock", "pyproject.toml", "LICENSE", "rust/vhs-py/build.rs"}
    assert sources | manifests <= packed
