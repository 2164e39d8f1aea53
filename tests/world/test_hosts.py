"""Two hosts train together: network namespaces with a cable between them, where a process may make them."""

import ctypes
import os
import subprocess
import sys
from collections.abc import Iterator
from functools import partial
from pathlib import Path

import pytest

from vhs.runs.rows import read_log

from .ranks import TRAIN, differences, start, state_of, together, wait_for

pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(not sys.platform.startswith("linux"), reason="network namespaces are Linux's"),
]


def ip(*arguments: str) -> None:
    subprocess.run(["ip", *arguments], check=True, capture_output=True)


@pytest.fixture
def hosts() -> Iterator[list[str]]:
    """Two names of namespaces, 10.77.0.1 and 10.77.0.2, each at its end of a cable of the same name."""
    names = [f"vhs{os.getpid() % 10_000}{end}" for end in "ab"]
    try:
        for name in names:
            ip("netns", "add", name)
        ip("link", "add", names[0], "netns", names[0], "type", "veth", "peer", names[1], "netns", names[1])
        for number, name in enumerate(names, 1):
            ip("-n", name, "addr", "add", f"10.77.0.{number}/24", "dev", name)
            for link in (name, "lo"):
                ip("-n", name, "link", "set", link, "up")
        yield names
    except (OSError, subprocess.CalledProcessError) as error:
        pytest.skip(f"no network namespaces here: {error}")
    finally:
        for name in names:
            subprocess.run(["ip", "netns", "delete", name], check=False, capture_output=True)


def move_to(host: str) -> None:
    """Live in a namespace from now on, and listen at its end of the cable."""
    file = os.open(f"/run/netns/{host}", os.O_RDONLY)
    assert ctypes.CDLL(None, use_errno=True).setns(file, 0) == 0
    os.close(file)
    os.environ |= {"MASTER_ADDR": "10.77.0.1", "GLOO_SOCKET_IFNAME": host, "LOCAL_RANK": "0"}


def command(run: Path, *settings: str) -> list[str]:
    return [*TRAIN, *(part for one in settings for part in ("--set", one)), "--out", str(run)]


def test_two_hosts_learn_what_two_processes_of_one_do(hosts: list[str], tmp_path: Path) -> None:
    near, far = tmp_path / "near", tmp_path / "far"
    short = ("train.episodes=16",)
    moves = [partial(move_to, host) for host in hosts]
    for run, prepare in ((near, ()), (far, moves)):
        for status, _, errors in together(*[command(run, *short)] * 2, prepare=prepare):
            assert status == 0, errors
    assert differences(state_of(near), state_of(far)) == []


def test_a_host_that_vanishes_is_noticed_in_time(hosts: list[str], tmp_path: Path) -> None:
    run = tmp_path / "run"
    endless = command(run, "train.episodes=100000", "train.log_every=8", "train.peer_timeout_s=3")
    first, second = start(*[endless] * 2, prepare=[partial(move_to, host) for host in hosts])
    wait_for(lambda: read_log(run))
    ip("-n", hosts[1], "link", "set", hosts[1], "down")
    status, _, errors = first.ended()
    assert status == 1
    assert errors.splitlines()[-1].startswith(
        "vhs: another process of this training is gone, or has not answered"
    )
    assert second.ended()[:1] == (1,)
