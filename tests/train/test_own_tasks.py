"""A task of one's own through every command, from the file that says it to the page about its run."""

import json
import os
import re
import shutil
from dataclasses import replace
from io import StringIO
from pathlib import Path

import gymnasium
import numpy as np
import pytest
from debug import DEBUG
from toy import ALGORITHMS, SMALL, Toy, toy_config, toy_task

import vhs
from vhs import Task
from vhs.acting.policy import load_agent
from vhs.acting.setup import task_of
from vhs.cli import main
from vhs.config import load_config
from vhs.errors import ConfigError
from vhs.eval import evaluate
from vhs.runs.directory import check_run, read_config
from vhs.runs.rows import read_log
from vhs.train import train

pytestmark = pytest.mark.slow

GRID = Path(__file__).parents[2] / "examples" / "tasks" / "grid.py"
FEW = ("train.episodes=24", "train.log_every=12", "env.num_envs=4", "env.num_workers=0", "method.warmup=2")
SETTINGS = [part for setting in FEW for part in ("--set", setting)]


def found(task: str) -> Task:
    return task_of(load_config([SMALL], task=task))


@pytest.fixture(scope="module")
def directory(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """`mine.py`, and `run`, which was trained on it."""
    made = tmp_path_factory.mktemp("own")
    shutil.copy(GRID, made / "mine.py")
    here = Path.cwd()
    os.chdir(made)
    try:
        assert main(["train", "--task", "mine.py", "--config", str(DEBUG), *SETTINGS, "--out", "run"]) == 0
    finally:
        os.chdir(here)
    return made


@pytest.fixture
def copy(directory: Path, tmp_path: Path) -> Path:
    """A copy of the run, to change."""
    return Path(shutil.copytree(directory / "run", tmp_path / "run"))


def test_the_run_knows_its_task_whoever_looks_at_it_from_where(directory: Path) -> None:
    config = read_config(directory / "run")
    assert (config.task, config.task_name) == (str(directory / "mine.py"), "mine")
    agent = load_agent(directory / "run")
    assert (agent.task.name, agent.spec.num_goals, agent.spec.num_actions) == ("mine", 4, 5)


def test_evaluation_leaves_out_what_the_task_does_not_say(
    copy: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["eval", str(copy), "--episodes", "4", "--json"]) == 0
    found = json.loads(capsys.readouterr().out)
    assert (found["spl"], found["optimal_steps"]) == (None, None)
    assert main(["compare", str(copy), "--out", str(copy / "compared")]) == 0
    assert json.loads((copy / "compared" / "compare.json").read_text())["groups"][0]["spl_mean"] is None
    row = next(line for line in capsys.readouterr().out.splitlines() if line.startswith("| vhs"))
    assert row.split("|")[6].strip() == "-"


def test_a_film_and_a_page_are_made_of_it(copy: Path) -> None:
    assert main(["play", str(copy), "--episodes", "1", "--out", str(copy / "film.gif")]) == 0
    assert main(["report", str(copy), "--episodes", "4"]) == 0
    page = (copy / "report.html").read_text()
    assert "asked \\ reached" in page
    assert "Steps taken and steps needed" not in page
    assert "From above" not in page


def test_an_agent_that_was_exported_runs_no_code_unasked(copy: Path, tmp_path: Path, directory: Path) -> None:
    agent, task = tmp_path / "agent", str(directory / "mine.py")
    assert main(["export", str(copy), str(agent)]) == 0
    with pytest.raises(ConfigError, match=r"expected to be told the task .* --task FILE.py \(it says mine\)"):
        load_agent(agent)
    assert main(["eval", str(agent), "--episodes", "2", "--task", task]) == 0


def test_a_file_that_moved_is_asked_for_and_taken_where_it_is(
    directory: Path, copy: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    text = (copy / "config.yaml").read_text()
    (copy / "config.yaml").write_text(text.replace(str(directory), str(tmp_path / "before")))
    assert main(["eval", str(copy)]) == 1
    assert "if it has moved, say where to: --task mine.py" in capsys.readouterr().err
    now = str(directory / "mine.py")
    assert main(["eval", str(copy), "--episodes", "2", "--task", now]) == 0
    longer = [*SETTINGS, "--set", "train.episodes=32", "--out", str(copy)]
    assert main(["train", "--task", now, "--config", str(DEBUG), *longer]) == 0
    assert read_config(copy).task == now
    assert read_log(copy)[-1]["episodes"] == 32


def test_another_task_is_refused_in_a_run_that_has_learned(
    copy: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["train", "--task", str(GRID), "--config", str(DEBUG), *SETTINGS, "--out", str(copy)]) == 1
    assert "holds a run with other values of task" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("content", "name", "message"),
    [
        ("", "", "expected a vhs.Task called `task` in .*mine.py, found none"),
        ("task = 3", "", "found a int"),
        ("import vhs; other = vhs.Task(make='A')", "", "it has other: say .*mine.py:other"),
        ("1 / 0", "", r"found ZeroDivisionError: division by zero \(mine.py, line 1\)"),
        ("import no_such_module", ":mine", "found ModuleNotFoundError"),
        ("task =", "", "found SyntaxError"),
    ],
)
def test_a_file_that_is_no_task_is_told(content: str, name: str, message: str, tmp_path: Path) -> None:
    (tmp_path / "mine.py").write_text(content)
    with pytest.raises(ConfigError, match=message):
        found(f"{tmp_path / 'mine.py'}{name}")


def test_a_task_of_a_module_is_found_by_its_name() -> None:
    assert found("toy:TOY").name == "toy"
    for task, message in {
        "toy:toys": "expected a vhs.Task called `toys` in toy, found none; it has TOY: say toy:TOY",
        "no_such.module:task": "expected the module no_such.module, found ModuleNotFoundError",
        "given:toy": "toy was given to the training from Python; say where it is",
    }.items():
        with pytest.raises(ConfigError, match=message):
            found(task)


def test_what_is_for_rooms_alone_is_refused_elsewhere() -> None:
    for key, value in {"env.room": "{stride_m: 1}", "env.renderer": "mujoco"}.items():
        with pytest.raises(ConfigError, match=f"{key}: expected none for TOY, which is no room"):
            task_of(load_config([SMALL], [f"{key}={value}"], task="toy:TOY"))


def test_a_task_in_words_needs_no_python(tmp_path: Path) -> None:
    gymnasium.register("own/Toy-v0", entry_point=lambda **sizes: Toy(**sizes), disable_env_checker=True)
    (tmp_path / "mine.yaml").write_text(
        """
task:
  make: toy:own/Toy-v0
  max_steps: 6
  image: image
  goal: goal
  interaction: interaction
  outcome: {success: reward > 5, failure: terminated and reward < 0}
  reward: {success: 1.0}
  interactions: {3: 0, 4: 1}
  moves: {1: {deg: 45}, 0: {forward_m: 0.5}}
  goals: [red, green, blue]
  metrics: []
env: {kwargs: {moves: 3}}
"""
    )
    run = tmp_path / "run"
    arguments = ["--config", str(SMALL), "--config", str(tmp_path / "mine.yaml"), *SETTINGS]
    assert main(["train", *arguments, "--out", str(run)]) == 0
    agent = load_agent(run)
    assert agent.task.name == "Toy-v0"
    assert agent.task.moves == {0: vhs.Move(forward_m=0.5), 1: vhs.Turn(deg=45)}
    assert agent.spec.success_reward == 0.99
    assert evaluate(run, episodes=3).spl is None
    again = main(["train", *arguments, "--set", "train.episodes=32", "--out", str(run)])
    assert again == 0


def test_words_say_what_is_beside_the_picture_and_what_is_reached_on_the_way() -> None:
    words = "task={make: own/Toy-v0, beside: [compass], touched: 'near > 0.5'}"
    task = task_of(load_config([SMALL], [words]))
    seen = task.read({"image": np.zeros((4, 4, 3)), "goal": 1, "compass": np.ones(2)})
    assert (seen.label, list(seen.fields)) == (1, ["compass"])
    assert [task.touched({"near": near}) for near in (0.2, 0.7)] == [False, True]
    with pytest.raises(vhs.ArgumentError, match="near"):
        task.touched({"far": 1})


@pytest.mark.parametrize(
    ("words", "message"),
    [
        ("{maek: A-v0}", r"unknown key `task.maek`; did you mean `task.make`\?"),
        ("{max_steps: 3}", "task.make: expected"),
        ("{make: A-v0, max_steps: 0}", "task.max_steps: expected greater than or equal to 1, found 0"),
        (
            "{make: A-v0, outcome: {success: 'reward >'}}",
            "task.outcome.success: expected a condition such as",
        ),
        ("{make: A-v0, outcome: {won: reward}}", "task.outcome.won"),
        ("[1]", "task: expected"),
    ],
)
def test_words_that_say_nothing_are_refused(words: str, message: str) -> None:
    with pytest.raises(ConfigError, match=message):
        load_config([SMALL], [f"task={words}"])


def test_from_python(tmp_path: Path) -> None:
    keys = {"train.episodes": 8, "env.num_workers": 0, "env.num_envs": 4, "model.channels": [4, 4, 4, 4]}
    assert vhs.train(toy_task(), keys, out=tmp_path / "given", stream=StringIO())
    assert read_config(tmp_path / "given").task == "given:toy"
    assert evaluate(tmp_path / "given", episodes=2, task=toy_task()).spl is None
    with pytest.raises(ConfigError, match="toy was given to the training from Python"):
        evaluate(tmp_path / "given")
    config = load_config([SMALL], FEW)
    assert vhs.train("toy:TOY", config, out=tmp_path / "named", stream=StringIO())
    assert read_config(tmp_path / "named").model.channels == config.model.channels
    assert evaluate(tmp_path / "named", episodes=2).spl is None
    with pytest.raises(ConfigError, match=r"unknown key `train.episods`; did you mean `train.episodes`"):
        vhs.train(toy_task(), {"train.episods": 3}, out=tmp_path / "none")


def test_a_start_that_failed_holds_nobody_to_what_it_was_started_with(tmp_path: Path) -> None:
    class Broken(Toy):
        def step(self, action: object) -> object:
            if self.t == 2 and self.goal == 2:
                raise RuntimeError("broken")
            return super().step(action)

    run, config = tmp_path / "run", toy_config("vhs", *FEW)
    with pytest.raises(RuntimeError, match="broken"):
        train(config, run, StringIO(), task=replace(toy_task(), make=Broken))
    other = toy_config("vhs", *FEW, "model.hidden_dim=16")
    assert train(other, run, StringIO(), task=toy_task())
    assert read_config(run).model.hidden_dim == 16


def test_a_resumed_run_drops_what_its_task_cannot_repeat_and_says_so(tmp_path: Path) -> None:
    class Unrepeatable(Toy):
        def reset(self, *, seed: object = None, options: object = None) -> object:
            return super().reset()

    task = replace(toy_task(), make=Unrepeatable, replayable=False)
    train(toy_config("vhs", *FEW), tmp_path / "run", StringIO(), task=task)
    said = StringIO()
    assert train(toy_config("vhs", *FEW, "train.episodes=48"), tmp_path / "run", said, task=task)
    assert re.search(
        r"dropped [1-9]\d* episodes that were under way: toy cannot repeat them", said.getvalue()
    )
    assert [row["episodes"] for row in read_log(tmp_path / "run")] == [12, 24, 36, 48]


@pytest.mark.parametrize("method", ["vhs", "a3c"])
def test_what_a_task_decides_is_no_other_value_when_a_run_goes_on(method: str, tmp_path: Path) -> None:
    few = [key for key in FEW if method == "vhs" or not key.startswith("method.")]
    config = load_config([SMALL, ALGORITHMS / f"{method}.yaml"], few, task="toy:TOY")
    config = config.model_copy(update={"method": config.method.model_copy(update={"supcon_batch": None})})
    train(config, tmp_path / "run", StringIO())
    check_run(config, tmp_path / "run")
    assert train(config, tmp_path / "run", StringIO())


def test_a_judge_that_never_says_success_is_doubted(tmp_path: Path) -> None:
    said = StringIO()
    never = replace(toy_task(), judge=lambda *_: vhs.Outcome.FAILURE)
    config = toy_config("vhs", *FEW, "train.episodes=120", "train.log_every=100")
    train(config, tmp_path / "run", said, task=never)
    assert "none of the first 100 episodes was a success; if one was, `judge` of task toy" in said.getvalue()


def test_a_sweep_finds_the_file_from_where_it_lies(tmp_path: Path) -> None:
    from vhs.sweep.file import read_sweep
    from vhs.sweep.plan import plan_runs

    path = tmp_path / "sweep.yaml"
    path.write_text("set: {task: mine.py}\ngrids: [{grid: {task: [other.py, task1]}}, {}]\n")
    runs = plan_runs(path, read_sweep(path), 1)
    assert [run.config.task for run in runs] == [
        str(tmp_path / "other.py"),
        "task1",
        str(tmp_path / "mine.py"),
    ]
    assert [run.name for run in runs] == ["other-vhs-seed0", "task1-vhs-seed0", "mine-vhs-seed0"]
    assert f"task={tmp_path / 'mine.py'}" in runs[2].arguments
