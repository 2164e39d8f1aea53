"""Everything is killed, again and again, and nothing may be lost: ``python tests/soak.py [MINUTES] [SEED]``.

Three attacks take turns, each on real processes:

- **training**: a small lock-step run is stopped by every signal, its learner or a worker killed, a worker or
  the learner stopped, the disk filled, a bit of its newest checkpoint flipped; it is resumed until it ends.
  Its last checkpoint must be, bit for bit, that of a run that nobody disturbed, and its log that log.
- **files**: a process whose threads draw from a buffer and a goal store while it forks and saves is killed.
  What is on the disk must be whole, one of the states that were saved, and no older than the last one told.
- **pool**: workers are killed and stopped under a learner. No step of an environment may be lost, doubled or
  mixed with another's.

Prints a count for everything that was done and found, as JSON; exits 1 when a fault is among it. What it
does follows from the seed; when something is hit does not. Filling the disk needs the right to mount.
"""

from __future__ import annotations

import hashlib
import json
import os
import random
import shutil
import signal
import subprocess
import sys
import tempfile
import threading
import time
from collections import Counter
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path

MARK = "VHS_SOAK"
"""In the environment of every process that is started here: what is left over is found by it."""
HANG_S = 180.0
DISK_BYTES = 40_000_000
EPISODES = 2000
CONFIG = ["--config", str(Path(__file__).parents[1] / "configs" / "debug.yaml")]
SETTINGS = [
    f"train.episodes={EPISODES}", "train.checkpoint_every_s=0.2", "train.log_every=20",
    "env.num_workers=2", "env.deadline_s=4",
]  # fmt: skip


class Soak:
    """What was done, and what was found to be wrong."""

    def __init__(self, directory: Path, seed: int) -> None:
        self.directory = directory
        self.random = random.Random(seed)
        self.done: Counter[str] = Counter()
        self.faults: list[str] = []
        self.disk = self._mounted()

    def start(self, *command: str) -> subprocess.Popen[str]:
        """Start a process in a session of its own, its output in a file."""
        with (self.directory / "output").open("w") as output:
            return subprocess.Popen(
                [sys.executable, *command], stdout=output, stderr=subprocess.STDOUT, text=True,
                env=os.environ | {MARK: str(os.getpid()), "OMP_NUM_THREADS": "1"}, start_new_session=True,
            )  # fmt: skip

    def wait(self, process: subprocess.Popen[str], what: str) -> int:
        """The status of a process that must end, and of which nothing may be left."""
        try:
            status = process.wait(HANG_S)
        except subprocess.TimeoutExpired:
            self.fault(f"{what}: hangs")
            os.killpg(process.pid, signal.SIGKILL)
            return process.wait()
        deadline = time.monotonic() + 10
        while (left := marked()) and time.monotonic() < deadline:
            time.sleep(0.05)
        if left:
            self.fault(f"{what}: left {len(left)} processes behind")
            for pid in left:
                with suppress(ProcessLookupError):
                    os.kill(pid, signal.SIGKILL)
        return status

    def fault(self, text: str) -> None:
        """Remember a fault, with the end of the output that tells of it."""
        tail = (self.directory / "output").read_text(errors="replace")[-600:]
        self.faults.append(f"{text}\n{tail}")
        print(f"FAULT {text}\n{tail}", flush=True)

    def _mounted(self) -> Path | None:
        """A small disk of its own, where that may be had."""
        place = self.directory / "disk"
        place.mkdir()
        command = ["mount", "-t", "tmpfs", "-o", f"size={DISK_BYTES}", "tmpfs", str(place)]
        try:
            subprocess.run(command, check=True, capture_output=True)
        except (OSError, subprocess.CalledProcessError):
            return None
        return place

    def close(self) -> None:
        """Give the disk back."""
        if self.disk is not None:
            subprocess.run(["umount", "-l", str(self.disk)], check=False, capture_output=True)


def marked() -> list[int]:
    """Processes that were started here and are there yet."""
    needle, found = f"{MARK}={os.getpid()}".encode(), []
    for entry in Path("/proc").iterdir():
        with suppress(OSError):
            if entry.name.isdigit() and needle in (entry / "environ").read_bytes().split(b"\0"):
                found.append(int(entry.name))
    return found


def children(pid: int) -> list[int]:
    """Processes below a process."""
    with suppress(OSError):
        below = [int(one) for one in Path(f"/proc/{pid}/task/{pid}/children").read_text().split()]
        return below + [one for child in below for one in children(child)]
    return []


# --- training ---------------------------------------------------------------------------------------------


def training(soak: Soak) -> None:
    """One run from its first start to its end, disturbed, beside the same run in peace."""
    soak.done["training: runs"] += 1
    seed = soak.done["training: runs"] % 3  # three runs in peace serve for all
    place = soak.disk or soak.directory
    run, calm = place / "run", soak.directory / f"calm-{seed}"
    if not calm.exists() and soak.wait(start_training(soak, calm, seed), "training in peace") != 0:
        soak.fault("training in peace: failed")
        return
    shutil.rmtree(run, ignore_errors=True)
    attacks = [
        *SIGNALS,
        kill_worker,
        stop_worker,
        stop_learner,
        kill_all,
        *([fill_disk] if soak.disk else []),
    ]
    deadline = time.monotonic() + 6 * HANG_S
    while time.monotonic() < deadline:
        process = start_training(soak, run, seed)
        if soak.random.random() < 0.9:
            if soak.random.random() < 0.8:
                wait_for_workers(process)
            time.sleep(soak.random.uniform(0.0, 5.0))
            soak.random.choice(attacks)(soak, process, run)
        status = soak.wait(process, "training")
        output = (soak.directory / "output").read_text(errors="replace")
        # Ctrl-C may come before the program has begun; TensorBoard's thread prints why it fails before we do.
        is_early = output.endswith("KeyboardInterrupt\n") and "in main" not in output
        is_board = "tensorboard: cannot write" in output.splitlines()[-1] if output else False
        if "Traceback" in output and not (is_early or is_board):
            soak.fault("training: a traceback")
        if status == 0 and newest(run) == EPISODES:
            break
        if soak.random.random() < 0.2:
            flip_bit(soak, run, seed)
    if newest(run) != EPISODES:
        soak.fault("training: not done in time")
    elif tensors(run) != tensors(calm) or rows(run) != rows(calm):
        soak.fault(f"training: another result than in peace (seed {seed})")
    else:
        soak.done["training: bit for bit as in peace"] += 1


def start_training(soak: Soak, run: Path, seed: int) -> subprocess.Popen[str]:
    sets = [part for setting in [*SETTINGS, f"seed={seed}"] for part in ("--set", setting)]
    return soak.start("-m", "vhs.cli", "train", *CONFIG, *sets, "--out", str(run))


def wait_for_workers(process: subprocess.Popen[str]) -> None:
    """Until a training has begun, or ended; imports take most of a short run."""
    while process.poll() is None and not children(process.pid):
        time.sleep(0.05)


def signalled(number: signal.Signals) -> Callable[[Soak, subprocess.Popen[str], Path], None]:
    def attack(soak: Soak, process: subprocess.Popen[str], _run: Path) -> None:
        soak.done[f"training: {number.name} to the learner"] += process.poll() is None
        process.send_signal(number)

    return attack


SIGNALS = [signalled(signal.Signals[f"SIG{name}"]) for name in ("KILL", "KILL", "TERM", "INT", "HUP")]


def kill_worker(soak: Soak, process: subprocess.Popen[str], _run: Path) -> None:
    to_worker(soak, process, signal.SIGKILL)


def stop_worker(soak: Soak, process: subprocess.Popen[str], _run: Path) -> None:
    to_worker(soak, process, signal.SIGSTOP)


def to_worker(soak: Soak, process: subprocess.Popen[str], number: signal.Signals) -> None:
    """Four times in a row, so that a run meets more than one."""
    for _ in range(4):
        if below := children(process.pid):
            with suppress(ProcessLookupError):
                os.kill(soak.random.choice(below), number)
                soak.done[f"training: {number.name} to a worker"] += 1
        time.sleep(soak.random.uniform(0.1, 1.5))


def stop_learner(soak: Soak, process: subprocess.Popen[str], _run: Path) -> None:
    """Stopped for longer than a deadline: workers that waited meanwhile were not late."""
    process.send_signal(signal.SIGSTOP)
    soak.done["training: learner stopped for 5 s"] += process.poll() is None
    time.sleep(5)
    process.send_signal(signal.SIGCONT)


def kill_all(soak: Soak, process: subprocess.Popen[str], _run: Path) -> None:
    soak.done["training: SIGKILL to all at once"] += process.poll() is None
    for pid in [process.pid, *children(process.pid)]:
        with suppress(ProcessLookupError):
            os.kill(pid, signal.SIGKILL)


def fill_disk(soak: Soak, process: subprocess.Popen[str], run: Path) -> None:
    """Until the run ends, which it must with a sentence, or a little while; then the space is given back."""
    ballast = run.parent / "ballast"
    with suppress(OSError), ballast.open("wb") as file:
        while True:
            file.write(bytes(1 << 16))
            file.flush()
    with suppress(subprocess.TimeoutExpired):
        process.wait(20)
    ballast.unlink()
    soak.done["training: full disks"] += 1
    output = (soak.directory / "output").read_text(errors="replace")
    if process.poll() not in (None, 0):
        soak.done["training: full disks that ended a run by a sentence"] += "No space left" in output
        if "No space left" not in output:
            soak.fault("training: a full disk, and no sentence about it")


def flip_bit(soak: Soak, run: Path, seed: int) -> None:
    """In the newest checkpoint: it must be named and refused, and the run go on once it is moved away."""
    found = sorted((run / "checkpoints").glob("episode-*")) if run.exists() else []
    if not found:
        return
    path = soak.random.choice(sorted(found[-1].iterdir()))
    content = bytearray(path.read_bytes())
    bit = soak.random.randrange(8 * len(content))
    content[bit // 8] ^= 1 << bit % 8
    path.write_bytes(content)
    soak.done["training: bits flipped in a checkpoint"] += 1
    status = soak.wait(start_training(soak, run, seed), "training from a flipped bit")
    if path.name == "manifest.json" and status in (0, None):
        return  # white space of the manifest, say: what it says is unchanged, or the files would differ
    if status == 0 or found[-1].name not in (soak.directory / "output").read_text(errors="replace"):
        soak.fault(f"training: a flipped bit {bit} of {path.name} was not refused by name")
    shutil.rmtree(found[-1])


def newest(run: Path) -> int:
    found = [int(path.name.removeprefix("episode-")) for path in (run / "checkpoints").glob("episode-*")]
    return max(found, default=0)


def tensors(run: Path) -> tuple[str, str]:
    """Digests of the last checkpoint's tensors and of its goal store."""
    last = run / "checkpoints" / f"episode-{EPISODES:09d}"
    state, goals = (
        hashlib.sha256((last / name).read_bytes()).hexdigest() for name in ("state.safetensors", "goals.vhs")
    )
    return state, goals


def rows(run: Path) -> list[dict[str, object]]:
    """The log without what a clock says."""
    lines = (run / "log.jsonl").read_text().splitlines()
    whole = [json.loads(line) for line in lines]
    told_by_clock = ("time/", "speed/", "sha256")
    return [{k: v for k, v in row.items() if not k.startswith(told_by_clock)} for row in whole]


# --- files ------------------------------------------------------------------------------------------------


def files(soak: Soak) -> None:
    """Kill a process that saves, in the middle of it; look at what is on the disk."""
    import vhs

    place = soak.directory / "files"
    shutil.rmtree(place, ignore_errors=True)
    place.mkdir()
    process = soak.start(__file__, "--writer", str(place))
    time.sleep(soak.random.uniform(1.0, 4.0))
    process.send_signal(signal.SIGKILL)
    soak.wait(process, "files")
    soak.done["files: writers killed"] += 1
    told = (soak.directory / "output").read_text(errors="replace").split()
    if "bad" in told:
        soak.fault("files: a forked child hung, or drew what its parent drew")
    saves = [int(word) for word in told if word.isdigit()]
    soak.done["files: saves"] += len(saves)
    soak.done["files: forks"] += told.count("fork")
    for name, load in (("episodes.vhs", vhs.EpisodeBuffer.load), ("goals.vhs", vhs.GoalStore.load)):
        if not (place / name).exists():
            if saves:
                soak.fault(f"files: {name} was saved and is gone")
            continue
        try:
            size = len(load(place / name))
        except Exception as error:  # any error is a fault here
            soak.fault(f"files: {name}: {error}")
            continue
        # One more may have been made than was told of.
        expected = {min(one, 64) for one in (saves[-1], saves[-1] + 1)} if saves else {1}
        if size not in expected:
            soak.fault(f"files: {name} holds {size} of {expected}")


def writer(place: Path) -> None:
    """Save a buffer and a store that grow by one, for ever; say a number after each pair of saves."""
    import numpy as np

    import vhs

    shape = (32, 32, 3)
    buffer = vhs.EpisodeBuffer(shape, num_streams=1, max_episode_steps=8, capacity_steps=64 * 7, seed=0)
    store = vhs.GoalStore(1, shape, 64, seed=0)
    frames = np.random.default_rng(0).integers(0, 255, (8, *shape), dtype=np.uint8)

    def draw() -> None:
        while True:
            with suppress(vhs.EmptyError):
                buffer.sample_transitions(64)
                store.sample(16)

    for _ in range(2):
        threading.Thread(target=draw, daemon=True).start()
    for count in range(1, 1_000_000):
        buffer.begin(0, frames[0])
        for frame in frames[1:]:
            buffer.append(0, 0, 0.0, None, frame)
        buffer.finish(0, "success")
        store.push(frames[-1], 0)
        buffer.save(place / "episodes.vhs")
        store.save(place / "goals.vhs")
        print(count, flush=True)
        if count % 8 == 0:
            print("fork" if forked(buffer) else "bad", flush=True)


def forked(buffer: object) -> bool:
    """Whether a child forked while threads draw can draw, ends in time and draws other than its parent."""
    read, write = os.pipe()
    pid = os.fork()
    if pid == 0:
        os.write(write, buffer.sample_transitions(64).ids.tobytes()[:512])  # type: ignore[attr-defined]
        os._exit(0)
    os.close(write)
    ended = threading.Event()
    watch = threading.Timer(20.0, lambda: None if ended.is_set() else os.kill(pid, signal.SIGKILL))
    watch.start()
    status = os.waitpid(pid, 0)[1]
    ended.set()
    watch.cancel()
    drawn = os.read(read, 512)
    os.close(read)
    return status == 0 and drawn != buffer.sample_transitions(64).ids.tobytes()[:512]  # type: ignore[attr-defined]


# --- pool -------------------------------------------------------------------------------------------------


def pool(soak: Soak) -> None:
    """Kill and stop workers under a learner; it checks each step that it gets."""
    process = soak.start(__file__, "--learner", str(soak.random.randrange(2**31)))
    status = soak.wait(process, "pool")
    told = (soak.directory / "output").read_text(errors="replace").strip().splitlines()
    if status != 0:
        soak.fault("pool: the learner failed")
        return
    for name, count in json.loads(told[-1]).items():
        soak.done[f"pool: {name}"] += count


def make_counting() -> object:
    """An environment whose observation is (own number of episode, step)."""
    import gymnasium
    import numpy as np

    class Counting(gymnasium.Env):  # type: ignore[type-arg]
        observation_space = gymnasium.spaces.Box(0, 2**31, (2,), np.int64)
        action_space = gymnasium.spaces.Discrete(1_000_000)

        def reset(
            self, *, seed: int | None = None, options: object = None
        ) -> tuple[object, dict[str, object]]:
            super().reset(seed=seed)
            self._now = np.array([self.np_random.integers(1, 2**30), 0], dtype=np.int64)
            return self._now.copy(), {}

        def step(self, action: int) -> tuple[object, float, bool, bool, dict[str, object]]:
            assert action == self._now[1], "the action of another step"
            self._now[1] += 1
            return self._now.copy(), float(self._now[1]), bool(self._now[1] >= 50), False, {}

    return Counting()


def learner(seed: int) -> None:
    """Step a pool whose workers are killed; every row must be the next step of its environment's episode."""
    from vhs.rollout import RolloutPool

    drawn, done, envs = random.Random(seed), Counter[str](), 8
    with RolloutPool(make_counting, num_workers=4, envs_per_worker=2, seed=seed, deadline_s=2.0) as workers:
        workers.reset()
        last: list[tuple[int, int] | None] = [None] * envs
        until, next_kill = time.monotonic() + 20, time.monotonic()
        while time.monotonic() < until:
            batch = workers.recv(drawn.randint(1, envs))
            actions = []
            for row, env in enumerate(batch.env_ids.tolist()):
                episode, step = batch.observation[row].tolist()
                before = last[env]
                goes_on = before is not None and before == (episode, step - 1)
                # The first step of an episode: after a reset, or of a worker that came for a dead one.
                assert goes_on or step == 0, f"environment {env}: ({episode}, {step}) after {before}"
                last[env] = (episode, step)
                done["steps"] += goes_on
                done["episodes"] += step == 0
                actions.append(step)
            workers.send(actions, batch.env_ids)
            if time.monotonic() >= next_kill:
                next_kill = time.monotonic() + drawn.uniform(0.05, 0.8)
                if below := children(os.getpid()):
                    number = drawn.choice([signal.SIGKILL, signal.SIGKILL, signal.SIGKILL, signal.SIGSTOP])
                    with suppress(ProcessLookupError):
                        os.kill(drawn.choice(below), number)
                        done[f"{number.name} to a worker"] += 1
    print(json.dumps(done))


def main() -> None:
    """Attack in turn until the time is over."""
    signal.signal(signal.SIGINT, signal.default_int_handler)  # a shell's background has it ignored
    minutes, seed = (float(sys.argv[1]) if len(sys.argv) > 1 else 30.0), int((*sys.argv, 0, 0)[2])
    with tempfile.TemporaryDirectory(prefix="vhs-soak-") as directory:
        soak = Soak(Path(directory), seed)
        try:
            until = time.monotonic() + 60 * minutes
            while time.monotonic() < until:
                for attack in (training, files, files, pool):
                    attack(soak)
                print(json.dumps(soak.done), flush=True)
        finally:
            soak.close()
    counts = {"minutes": minutes, "seed": seed, **dict(sorted(soak.done.items())), "faults": len(soak.faults)}
    print(json.dumps(counts, indent=2))
    sys.exit(bool(soak.faults))


if __name__ == "__main__":
    if "--writer" in sys.argv:
        writer(Path(sys.argv[2]))
    elif "--learner" in sys.argv:
        learner(int(sys.argv[2]))
    else:
        main()
