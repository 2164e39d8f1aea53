"""Returns that trust the critic in part: TD(lambda), after Sutton and Barto 2018, Eq. 12.20."""

from __future__ import annotations

import torch
from torch import Tensor

from vhs.losses.shapes import check_shape


def lambda_returns(
    rewards: Tensor,
    values: Tensor,
    valid: Tensor,
    gamma: float,
    mixing: float,
    beyond: Tensor | None = None,
) -> Tensor:
    """R_t = r_t + gamma ((1 - lambda) V_{t+1} + lambda R_{t+1}); nothing follows the end of a task.

    With lambda = 1 these are the Monte-Carlo returns of paper section 3.1, with 0 one-step targets. R_t - V_t
    is the generalised advantage of Schulman et al. 2016.

    Args:
        rewards: r_t, shape [B, T].
        values: V(o_t), shape [B, T]; constants.
        valid: 1 inside the episode, 0 after its end, shape [B, T].
        gamma: discount a step, in 0..=1.
        mixing: lambda, in 0..=1.
        beyond: V(o_T) of each episode that a limit cut off, 0 of one that ended, shape [B]; a constant. None:
            all ended.

    Returns:
        R_t, a constant, 0 after the end of each episode, shape [B, T].

    Raises:
        ShapeError: the tensors do not fit together.
    """
    check_shape("B T", rewards=rewards, values=values, valid=valid)
    values = values.detach() * valid
    rewards = rewards * valid
    if beyond is not None:
        check_shape("B", valid=valid[:, 0], beyond=beyond)
        # V and R after the last step are the same, so it counts as if it were paid.
        is_last = valid - torch.cat([valid[:, 1:], torch.zeros_like(valid[:, :1])], 1)
        rewards = rewards + gamma * beyond.detach().unsqueeze(1) * is_last
    none = torch.zeros_like(values[:, :1])
    trusted = (1 - mixing) * torch.cat([values[:, 1:], none], 1)
    following, found = none[:, 0], [none[:, :0]]
    # Four kernels a step; a product with powers of gamma lambda is one, and rounds otherwise.
    for reward, value in zip(reversed(rewards.unbind(1)), reversed(trusted.unbind(1)), strict=True):
        following = reward + gamma * (value + mixing * following)
        found.append(following.unsqueeze(1))
    return torch.cat(found[::-1], 1)
