"""Networks of a configuration: what cannot be made is a sentence."""

import pytest

from vhs.acting.setup import learn_spec, settled, task_of
from vhs.config import load_config
from vhs.errors import ConfigError
from vhs.models import make_agent


@pytest.mark.parametrize("sizes", [f"model.hidden_dim={10**30}", f"model.channels=[8, {10**30}]"])
def test_sizes_that_cannot_be_made_are_told_in_a_line(sizes: str) -> None:
    """Torch puts the frames of its C++ behind what it says, more of them under some builds of Python."""
    config = load_config([], ["env.num_workers=0", sizes])
    task = task_of(config)
    spec = learn_spec(config, task)
    with pytest.raises(ConfigError, match=r"^model: expected networks that can be made, found \S") as caught:
        make_agent(settled(config, spec), spec)
    assert len(str(caught.value).splitlines()) == 1
