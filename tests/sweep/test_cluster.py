"""What is said of a Ray cluster that cannot be used; and what a node says that does not see a sweep."""

import socket
import sys
from pathlib import Path

import pytest

from vhs import __version__
from vhs.errors import ConfigError
from vhs.sweep.cluster import RayPlace
from vhs.sweep.node import Site, work


def test_a_missing_ray_names_the_extra(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "ray", None)
    with pytest.raises(ConfigError, match=r"--ray: ray is not installed; pip install 'vhs-rl\[ray\]'"):
        RayPlace("auto", None)


@pytest.mark.parametrize("address", ["auto", "nowhere", "127.0.0.1:{port}", "127.0.0.1:99999"])
@pytest.mark.filterwarnings("default")  # Ray's own
def test_an_address_without_a_cluster_is_refused_at_once(
    address: str, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    pytest.importorskip("ray", reason="needs vhs-rl[ray]")
    monkeypatch.delenv("RAY_ADDRESS", raising=False)
    monkeypatch.setenv("RAY_TMPDIR", str(tmp_path))  # where it looks for clusters of this machine
    with socket.socket() as unheard:
        unheard.bind(("127.0.0.1", 0))
        told = address.format(port=unheard.getsockname()[1])
        with pytest.raises(ConfigError, match=f"^--ray {told}: expected auto, local or the address of"):
            RayPlace(told, None)


@pytest.mark.parametrize("found", [None, "another"])
def test_a_node_without_the_directory_does_nothing_and_says_so(found: str | None, tmp_path: Path) -> None:
    mark = tmp_path / "out" / ".lock"
    if found is not None:
        mark.parent.mkdir()
        mark.write_text(found)
    said = work(Site(tmp_path, mark, "token"), ["train"], tmp_path / "log")
    assert said.startswith(
        f"node {socket.gethostname()}: expected to see {tmp_path / 'out'}, on a file system"
    )
    assert not (tmp_path / "log").exists()


def test_a_node_names_a_directory_in_which_it_cannot_stand(tmp_path: Path) -> None:
    (tmp_path / ".lock").write_text("token")
    missing = Site(tmp_path / "project", tmp_path / ".lock", "token").what_is_missing()
    assert f"expected to see {tmp_path / 'project'}, on a file system" in missing
    assert Site(tmp_path, tmp_path / ".lock", "token").what_is_missing() == ""


def test_a_node_with_another_version_says_so(tmp_path: Path) -> None:
    (tmp_path / ".lock").write_text("token")
    missing = Site(tmp_path, tmp_path / ".lock", "token", version="0.0.1").what_is_missing()
    assert missing == f"node {socket.gethostname()}: expected vhs 0.0.1, found {__version__}"
