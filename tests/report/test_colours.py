"""The colours of the page are told apart by everybody: of methods, variants, outcomes, on light and dark."""

import re
from importlib.resources import files
from itertools import combinations

import numpy as np
import pytest
from numpy.typing import NDArray

Colour = NDArray[np.float64]

SIGHTS = {
    "common": np.eye(3),
    "protanopia": np.array(
        [[0.152286, 1.052583, -0.204868], [0.114503, 0.786281, 0.099216], [-0.003882, -0.048116, 1.051998]]
    ),
    "deuteranopia": np.array(
        [[0.367322, 0.860646, -0.227968], [0.280085, 0.672501, 0.047413], [-0.011820, 0.042940, 0.968881]]
    ),
    "tritanopia": np.array(
        [[1.255528, -0.076749, -0.178779], [-0.078411, 0.930809, 0.147602], [0.004733, 0.691367, 0.303900]]
    ),
}
"""What linear RGB looks like to whom (Machado et al. 2009, severity 1)."""
XYZ = np.array([[0.4124, 0.3576, 0.1805], [0.2126, 0.7152, 0.0722], [0.0193, 0.1192, 0.9505]])
LIGHT, DARK = re.findall(r":root \{(.*?)\}", files("vhs.report").joinpath("style.css").read_text(), re.DOTALL)
METHODS = [f"c{slot}" for slot in range(5)]
EVERYTHING = [f"c{slot}" for slot in range(8)]
OUTCOMES = ["success", "failure", "timeout"]


def linear(colour: str) -> Colour:
    share = np.array([int(colour[at : at + 2], 16) for at in (1, 3, 5)]) / 255
    return np.where(share <= 0.04045, share / 12.92, ((share + 0.055) / 1.055) ** 2.4)


def lab(rgb: Colour) -> Colour:
    xyz = XYZ @ np.clip(rgb, 0, 1) / (0.9505, 1.0, 1.089)
    f = np.where(xyz > 0.008856, np.cbrt(xyz), 7.787 * xyz + 16 / 116)
    return np.array([116 * f[1] - 16, 500 * (f[0] - f[1]), 200 * (f[1] - f[2])])


@pytest.mark.parametrize("sight", SIGHTS)
@pytest.mark.parametrize("style", [LIGHT, DARK], ids=["light", "dark"])
@pytest.mark.parametrize(
    ("names", "least"), [(METHODS, 35), (EVERYTHING, 20), (OUTCOMES, 19)], ids=["methods", "all", "outcomes"]
)
def test_colours_are_far_apart(names: list[str], least: float, style: str, sight: str) -> None:
    """Their distance in CIELAB; 2 is just visible, two blues of one palette had 12."""
    colours = dict(re.findall(r"--(\w+): (#\w{6});", style))
    for one, other in combinations(names, 2):
        seen = [lab(SIGHTS[sight] @ linear(colours[name])) for name in (one, other)]
        assert np.linalg.norm(seen[0] - seen[1]) > least, (one, other)


@pytest.mark.parametrize("style", [LIGHT, DARK], ids=["light", "dark"])
def test_lines_stand_out_of_the_paper(style: str) -> None:
    colours = dict(re.findall(r"--(\w+): (#\w{6});", style))
    paper = (XYZ @ linear(colours["paper"]))[1]
    for name in [*EVERYTHING, *OUTCOMES]:
        low, high = sorted([paper, (XYZ @ linear(colours[name]))[1]])
        assert (high + 0.05) / (low + 0.05) >= 3, name
