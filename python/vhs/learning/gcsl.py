"""GCSL: imitate what was done on the way to what was reached, and nothing else.

After Ghosh et al. 2019, "Learning to Reach Goals via Iterated Supervised Learning", with prototypes as goals
and SupCon, as the paper's section "Baselines" extends it to images.
"""

from __future__ import annotations

import numpy as np
import torch
from torch import Tensor

from vhs.learning.learner import VHS
from vhs.learning.shares import Share
from vhs.losses import hindsight_imitation_loss
from vhs.models import GoalAgent


class GCSL(VHS):
    """Supervised learning of the actions of relabelled episodes: no reward, no critic, no entropy bonus."""

    def _episode_losses(self, agent: GoalAgent, share: Share, features: Tensor) -> dict[str, Tensor]:
        """The policy term of L_VHS alone, with its weight; every step counts alike, as in Ghosh et al."""
        batch, hindsight = share.batch, share.hindsight
        selected = np.flatnonzero(hindsight.selected)
        if not len(selected):
            return {"imitation_policy": features.new_zeros(())}
        chosen = self._tensor(selected)
        steps = torch.arange(batch.actions.shape[1], device=features.device)
        rows = self._tensor(batch.offsets)[chosen].unsqueeze(1) + steps
        reached = self._hindsight_goals(features[self._tensor(hindsight.goal_rows)[chosen]].detach())
        log_probs, values, _ = agent(
            features[rows.clamp(max=len(features) - 1)], reached, self._tensor(hindsight.interactions)[chosen]
        )
        actions, valid = self._tensor(batch.actions), self._tensor(batch.mask).float()
        imitation = hindsight_imitation_loss(
            log_probs, actions[chosen], values, values.detach(), valid[chosen], valid.sum()
        )
        return {"imitation_policy": imitation.policy}
