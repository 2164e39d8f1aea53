"""Recurrent PPO of sb3-contrib on a task of vhs: what somebody would use who does not know of hindsight.

It sees what ours sees, two frames stacked, with the same convolutions but batch norm; a goal class is one-hot
beside the picture, a picture that is told is stacked with it. It writes rows as `vhs train` does.

    python benchmarks/recurrent_ppo.py --task TASK --config FILE --out FILE.jsonl --seed 0    # until SIGTERM
"""

from __future__ import annotations

import argparse
import json
import signal
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
import torch
from gymnasium import spaces
from numpy.typing import NDArray
from sb3_contrib import RecurrentPPO
from stable_baselines3.common.callbacks import BaseCallback
from stable_baselines3.common.torch_layers import BaseFeaturesExtractor
from stable_baselines3.common.vec_env import DummyVecEnv

from vhs import Outcome
from vhs.acting.environment import TaskEnv
from vhs.acting.setup import learn_spec, make_env, settled, task_of
from vhs.config import Config, load_config
from vhs.task import TaskSpec

SETTINGS: dict[str, Any] = {
    "learning_rate": 5e-4,
    "n_steps": 64,
    "batch_size": 256,
    "n_epochs": 4,
    "gae_lambda": 0.95,
    "ent_coef": 0.01,
}
"""Beside these, gamma, the scale of rewards and the number of environments are ours."""


class Told(gymnasium.Wrapper[Any, Any, Any, Any]):
    """A task as PPO sees it: `image` [channels, height, width] and `goal`, class and interaction one-hot."""

    def __init__(self, env: TaskEnv, spec: TaskSpec, reward_scale: float) -> None:
        """Wrap an environment."""
        super().__init__(env)
        height, width, colours = spec.frame_shape
        self._has_picture = spec.goals == "observations"
        self._sizes = spec.num_goals, max(1, spec.num_interactions)
        self._reward_scale = reward_scale
        image = (colours * (3 if self._has_picture else 2), height, width)
        goal = spaces.Box(0, 1, (sum(self._sizes),), np.float32)
        self.observation_space = spaces.Dict(image=spaces.Box(0, 255, image, np.uint8), goal=goal)

    def reset(self, **named: Any) -> tuple[dict[str, NDArray[Any]], dict[str, Any]]:
        """Begin an episode: the first frame is stacked with itself."""
        observation, info = self.env.reset(**named)
        self._last = observation["frame"]
        return self._seen(observation), info

    def step(self, action: Any) -> tuple[dict[str, NDArray[Any]], float, bool, bool, dict[str, Any]]:
        """Take a step."""
        observation, reward, terminated, truncated, info = self.env.step(action)
        reward = float(reward) * self._reward_scale
        return self._seen(observation), reward, terminated, truncated, info

    def _seen(self, observation: dict[str, Any]) -> dict[str, NDArray[Any]]:
        parts = [self._last, observation["frame"]]
        if self._has_picture:
            parts.append(observation["desired_goal"])
        self._last = observation["frame"]
        goal = np.zeros(sum(self._sizes), np.float32)
        goal[[observation["goal"], self._sizes[0] + observation["interaction"]]] = 1
        return {"image": np.ascontiguousarray(np.concatenate(parts, -1).transpose(2, 0, 1)), "goal": goal}


class Convolutions(BaseFeaturesExtractor):
    """Those of `vhs.models.FeatureExtractor` without batch norm, then a layer that sees the goal too."""

    def __init__(self, space: spaces.Dict, channels: Sequence[int], features: int) -> None:
        """Build a convolution an entry of `channels`."""
        super().__init__(space, features)
        inputs, height, width = space["image"].shape or ()
        layers: list[torch.nn.Module] = []
        for outputs in channels:
            layers += [torch.nn.Conv2d(inputs, outputs, 3, 2, 1), torch.nn.ReLU()]
            inputs, height, width = outputs, (height + 1) // 2, (width + 1) // 2
        self.convolutions = torch.nn.Sequential(*layers, torch.nn.Flatten())
        goal = (space["goal"].shape or (0,))[0]
        self.project = torch.nn.Sequential(
            torch.nn.Linear(inputs * height * width + goal, features), torch.nn.ReLU()
        )

    def forward(self, seen: dict[str, torch.Tensor]) -> torch.Tensor:
        """Features [N, features]."""
        found: torch.Tensor = self.project(torch.cat([self.convolutions(seen["image"]), seen["goal"]], dim=1))
        return found


class Rows(BaseCallback):
    """Writes a row every so many episodes, and ends the training on SIGTERM."""

    def __init__(self, path: Path, every: int) -> None:
        """Begin a file."""
        super().__init__()
        self._file, self._every = path.open("w"), every
        self._ended: list[Outcome] = []
        self._episodes, self._is_asked, self._start = 0, False, time.monotonic()
        signal.signal(signal.SIGTERM, lambda *_: setattr(self, "_is_asked", True))

    def _on_step(self) -> bool:
        self._ended += [info["outcome"] for info in self.locals["infos"] if "outcome" in info]
        if len(self._ended) >= self._every:
            self._episodes += len(self._ended)
            row: dict[str, float] = {"episodes": self._episodes, "env_steps": self.num_timesteps}
            row["time/minutes"] = (time.monotonic() - self._start) / 60
            for outcome in Outcome:
                share = np.mean([ended == outcome for ended in self._ended])
                row[f"rate/{outcome.name.lower()}"] = round(float(share), 4)
            print(json.dumps(row), file=self._file, flush=True)
            self._ended = []
        return not self._is_asked


def make_model(config: Config) -> RecurrentPPO:
    """PPO with an LSTM on the task of a configuration."""
    task = task_of(config)
    spec = learn_spec(config, task)
    train = settled(config, spec).train

    def make() -> Told:
        return Told(make_env(task, spec), spec, train.reward_scale)

    envs = DummyVecEnv([make] * config.env.num_envs)
    networks = {
        "features_extractor_class": Convolutions,
        "features_extractor_kwargs": {
            "channels": config.model.channels,
            "features": config.model.feature_dim,
        },
        "lstm_hidden_size": config.model.hidden_dim,
        "net_arch": [config.model.head_dim],
        "shared_lstm": True,
        "enable_critic_lstm": False,
    }
    return RecurrentPPO(
        "MultiInputLstmPolicy",
        envs,
        gamma=train.gamma,
        seed=config.seed,
        device="cpu",
        policy_kwargs=networks,
        **SETTINGS,
    )


def main() -> None:
    """Train until SIGTERM."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--task")
    parser.add_argument("--config", action="append", default=[])
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--every", type=int, default=500, help="episodes of a row")
    parser.add_argument("--ppo", nargs="*", default=[], metavar="KEY=VALUE", help="over SETTINGS")
    arguments = parser.parse_args()
    torch.set_num_threads(1)
    SETTINGS.update({key: json.loads(value) for key, value in (pair.split("=") for pair in arguments.ppo)})
    config = load_config(
        arguments.config, [f"seed={arguments.seed}", "env.num_workers=0"], task=arguments.task
    )
    model = make_model(config)
    model.learn(10**9, callback=Rows(arguments.out, arguments.every))


if __name__ == "__main__":
    main()
