"""The model card of an agent: what it does and how well, how it was trained, how it is used."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from vhs.config import Config, dump_config
from vhs.config.yaml12 import dump_yaml
from vhs.distribution import NAME, pip_install
from vhs.envs.task import ROOMS
from vhs.report.tracks import wilson_interval

FILM_NAME = "film.gif"


def model_card(repo: str, config: Config, meta: Mapping[str, Any], evaluation: Mapping[str, Any]) -> str:
    """The card as Markdown with the Hub's header.

    Args:
        repo: user and name on the Hub.
        config: of the agent.
        meta: its `run.json`.
        evaluation: one of its `eval.json`.
    """
    success, episodes = float(evaluation["success"]), int(evaluation["episodes"])
    low, high = wilson_interval(success, episodes)
    spl = "" if evaluation["spl"] is None else f", SPL {evaluation['spl']:.2f}"
    command = " ".join(str(meta.get("command", "not known")).split())
    return f"""---
{_header(config, success)}---

# {repo.partition("/")[2]}

An agent of [{NAME}](https://pypi.org/project/{NAME}): task {config.task_name}, method {config.method.name}.

![Three episodes: its view, goal, action and value]({FILM_NAME})

**{success:.1%} success** (95 % interval {low:.1%} to {high:.1%}{spl}) over {episodes} episodes of seed
{evaluation["seed"]}, actions {"greedy" if evaluation["greedy"] else "sampled"}, after
{int(evaluation["trained_episodes"]):,} episodes of training.

```sh
{pip_install("hub")}
vhs eval hf://{repo}{"" if _is_room(config) else " --task FILE.py"}
```

## How it was trained

    {command}

Version {meta.get("version", "not known")}, commit {meta.get("commit", "not known")},
{meta.get("machine", "machine not known")}, {meta.get("precision", "precision not known")}.

```yaml
{dump_config(config)}```
"""


def _header(config: Config, success: float) -> str:
    metric = {"type": "success_rate", "name": "success rate", "value": round(success, 4)}
    result = {
        "task": {"type": "reinforcement-learning"},
        "dataset": {"type": config.task_name, "name": config.task_name},
        "metrics": [metric],
    }
    return dump_yaml(
        {
            "library_name": NAME,
            "pipeline_tag": "reinforcement-learning",
            "tags": [
                "reinforcement-learning",
                "goal-conditioned",
                "hindsight",
                config.task_name,
            ],
            "model-index": [{"name": f"{config.method.name} on {config.task_name}", "results": [result]}],
        }
    )


def _is_room(config: Config) -> bool:
    return isinstance(config.task, str) and config.task in ROOMS
