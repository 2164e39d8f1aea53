"""Draw the pictures of the ideas: `python docs/concepts/draw.py` writes the SVG files beside this script.

The small pictures are what the robot sees in rooms of Task 2.
"""

import base64
from pathlib import Path
from xml.sax.saxutils import escape

import gymnasium
import numpy as np
from numpy.typing import NDArray

from vhs.envs import OBJECT_NAMES, plan
from vhs.png import png_bytes

HERE = Path(__file__).parent
INK, SOFT, RULE, CARD, PAPER = "#16191d", "#59626d", "#c9ced6", "#f5f6f8", "#ffffff"
GOOD, BAD, GOAL = "#00815d", "#c44e00", "#0072b2"
Picture = NDArray[np.uint8]


class Drawing:
    """Parts of one SVG, in the order in which they are drawn."""

    def __init__(self, width: int, height: int, says: str) -> None:
        """An empty sheet; `says` is what it shows, for who cannot see it."""
        self._parts = [
            f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {width} {height}" role="img" '
            f'font-family="system-ui, sans-serif" font-size="16">',
            f"<title>{escape(says)}</title>",
            '<defs><marker id="tip" viewBox="0 0 10 10" refX="9" refY="5" markerWidth="7" markerHeight="7" '
            'orient="auto-start-reverse"><path d="M0 0 10 5 0 10z" fill="context-stroke"/></marker></defs>',
            f'<rect width="{width}" height="{height}" rx="14" fill="{PAPER}"/>',
        ]

    def text(self, x: float, y: float, text: str, colour: str = INK, size: int = 16, bold: bool = False,
             anchor: str = "start") -> None:  # fmt: skip
        """Words, `y` at their foot; a line break begins a new line."""
        weight = ' font-weight="650"' if bold else ""
        for row, line in enumerate(text.split("\n")):
            self._parts.append(
                f'<text x="{x:g}" y="{y + 1.25 * size * row:g}" fill="{colour}" font-size="{size}"{weight} '
                f'text-anchor="{anchor}">{escape(line)}</text>'
            )

    def box(
        self, x: float, y: float, width: float, height: float, text: str = "", colour: str = SOFT
    ) -> None:
        """A card with words in its middle, the first line bold."""
        self._parts.append(
            f'<rect x="{x:g}" y="{y:g}" width="{width:g}" height="{height:g}" rx="10" fill="{CARD}" '
            f'stroke="{colour}" stroke-width="1.6"/>'
        )
        lines = text.split("\n") if text else []
        top = y + height / 2 - 9.5 * (len(lines) - 1) + 5.5
        for row, line in enumerate(lines):
            size, ink = (16, INK) if row == 0 else (14, SOFT)
            self.text(x + width / 2, top + 19 * row, line, ink, size, row == 0, "middle")

    def picture(self, x: float, y: float, side: float, picture: Picture, rim: str = RULE) -> None:
        """What the robot saw."""
        data = base64.b64encode(png_bytes(picture)).decode("ascii")
        place = f'x="{x:g}" y="{y:g}" width="{side:g}" height="{side:g}"'
        width = 1.5 if rim == RULE else 4
        self._parts += [
            f'<image {place} href="data:image/png;base64,{data}"/>',
            f'<rect {place} rx="3" fill="none" stroke="{rim}" stroke-width="{width}"/>',
        ]

    def arrow(self, path: str, colour: str = SOFT, dashed: bool = False) -> None:
        """A line along an SVG path, with a tip at its end."""
        dashes = ' stroke-dasharray="6 5"' if dashed else ""
        style = f'fill="none" stroke="{colour}" stroke-width="2"{dashes}'
        self._parts.append(f'<path d="{path}" {style} marker-end="url(#tip)"/>')

    def dot(self, x: float, y: float, colour: str, radius: float = 5) -> None:
        """A point."""
        self._parts.append(f'<circle cx="{x:g}" cy="{y:g}" r="{radius:g}" fill="{colour}"/>')

    def star(self, x: float, y: float, colour: str) -> None:
        """A prototype."""
        angles = np.pi * (np.arange(10) / 5 - 0.5)
        radii = np.where(np.arange(10) % 2, 6, 14)
        points = " ".join(
            f"{x + r * np.cos(a):.1f},{y + r * np.sin(a):.1f}" for r, a in zip(radii, angles, strict=True)
        )
        self._parts.append(
            f'<polygon points="{points}" fill="{colour}" stroke="{PAPER}" stroke-width="1.5"/>'
        )

    def save(self, name: str) -> None:
        """Write the file beside this script."""
        (HERE / name).write_text("\n".join([*self._parts, "</svg>", ""]), encoding="utf-8")


def episode(goal: int, seed: int) -> list[Picture]:
    """What the robot sees on a shortest way to an object: one picture a step, and that of the end."""
    env = gymnasium.make("vhs/InteractiveObjectNav-v0")
    seen = [env.reset(seed=seed, options={"goal": goal})[0]["image"]]
    for action in plan(env):
        seen.append(env.step(action)[0]["image"])
    return seen


def hindsight() -> None:
    """A failure, and the same episode as a success at what it reached."""
    milk, mustard = OBJECT_NAMES.index("milk"), OBJECT_NAMES.index("mustard")
    asked, way = episode(milk, 3)[-1], episode(mustard, WAY)[-5:]
    sheet = Drawing(
        980, 400, "An episode that failed is learned from again, with what it reached as its goal"
    )
    for top, goal, rim, title in (
        (26, asked, RULE, "As it was: a failure"),
        (256, way[-1], GOAL, "In hindsight: a success at something else"),
    ):
        sheet.text(176, top + 8, title, bold=True, size=18)
        sheet.text(24, top + 12, "asked for", SOFT, 14)
        sheet.picture(24, top + 20, 96, goal, rim)
        sheet.arrow(f"M130 {top + 68} h34")
        for column, picture in enumerate(way):
            sheet.picture(176 + 104 * column, top + 20, 96, picture, GOAL if column == len(way) - 1 else RULE)
        sheet.arrow(f"M{176 + 104 * len(way)} {top + 68} h24")
    end = 210 + 104 * len(way)
    sheet.text(end, 78, "mustard, not milk", BAD, 16, bold=True)
    sheet.text(end, 100, "reward -1:\n“what I did\nwas bad”", SOFT, 14)
    sheet.text(end, 308, "it is what was asked", GOOD, 15, bold=True)
    sheet.text(end, 330, "“had I been asked\nfor this, every step\nwas right”: imitate", SOFT, 14)
    last = 176 + 104 * (len(way) - 1) + 48
    sheet.arrow(f"M{last} 146 C{last} 220 72 150 72 250", GOAL)
    sheet.text(250, 222, "the last picture becomes the goal", GOAL, 15, bold=True)
    sheet.save("hindsight.svg")


def goals() -> None:
    """Goal store, features, prototypes, and where a failure's end lies among them."""
    sheet = Drawing(980, 400, "Pictures of reached goals, their features, the prototype of each class")
    colours = ("#b98900", "#882255", "#0072b2")
    names = ("mustard", "barbecue_sauce", "milk")
    sheet.text(24, 34, "Goal store", bold=True, size=18)
    sheet.text(24, 56, "last pictures of successes, by what was asked for", SOFT, 14)
    plane = {"mustard": (720, 120), "barbecue_sauce": (860, 220), "milk": (690, 260)}
    rng = np.random.default_rng(0)
    for row, (name, colour) in enumerate(zip(names, colours, strict=True)):
        top = 74 + 92 * row
        for column in range(4):
            seen = episode(OBJECT_NAMES.index(name), 20 + column)[-1]
            sheet.picture(24 + 88 * column, top, 80, seen, colour if column == 0 else RULE)
        sheet.text(382, top + 45, name.replace("_", " "), colour, 15, bold=True)
        x, y = plane[name]
        for dx, dy in rng.normal(0, 17, (9, 2)):
            sheet.dot(x + dx, y + dy, colour)
        sheet.star(x, y, colour)
    sheet.arrow("M520 200 h60")
    sheet.text(548, 190, "f", INK, 20, bold=True, anchor="middle")
    sheet.text(600, 34, "Features", bold=True, size=18)
    sheet.text(600, 56, "a point per picture; a star is the mean: the prototype", SOFT, 14)
    sheet.text(300, 378, "a failure's last picture", BAD, 14, bold=True, anchor="end")
    sheet.picture(310, 350, 44, episode(OBJECT_NAMES.index("mustard"), WAY)[-1], BAD)
    sheet.arrow("M364 372 C560 380 640 320 672 190 T706 152", BAD, dashed=True)
    sheet.text(742, 372, "nearest star: the goal of hindsight", BAD, 14, bold=True, anchor="middle")
    sheet.save("goals.svg")


def network() -> None:
    """The agent."""
    sheet = Drawing(980, 250, "The goal gates what is seen; an LSTM remembers; heads act and value")
    sheet.picture(24, 40, 84, episode(OBJECT_NAMES.index("milk"), 3)[2])
    sheet.text(66, 144, "observation", SOFT, 14, anchor="middle")
    sheet.box(156, 52, 130, 60, "extractor f\nconvolutions")
    sheet.box(336, 52, 120, 60, "gate\nfeature by feature", GOAL)
    sheet.box(522, 52, 120, 60, "LSTM\nremembers")
    sheet.box(716, 22, 236, 54, "policy\nwhat to do")
    sheet.box(716, 92, 236, 54, "value\nwhat to expect")
    sheet.box(24, 176, 262, 54, "goal\nprototype, picture, word or vector", GOAL)
    sheet.box(490, 176, 180, 54, "interaction\nwhat to do there")
    sheet.arrow("M112 82 h38")
    sheet.arrow("M288 82 h42")
    sheet.text(309, 70, "256", SOFT, 13, anchor="middle")
    sheet.arrow("M458 82 h58")
    sheet.arrow("M644 82 C680 82 680 50 710 50")
    sheet.arrow("M644 82 C680 82 680 118 710 118")
    sheet.arrow("M288 203 C360 203 396 180 396 118", GOAL)
    sheet.arrow("M582 172 V118")
    sheet.save("network.svg")


def way_of_an_episode() -> None:
    """From the environments through an update and back."""
    sheet = Drawing(
        980, 420, "Environments fill the buffer, updates learn from it, goals come back to the policy"
    )
    sheet.box(24, 60, 200, 84, "16 environments\nstepped side by side\nwhile the learner learns")
    sheet.box(310, 60, 200, 84, "episode buffer\neach frame once")
    sheet.box(24, 270, 200, 84, "policy\none inference\nfor all environments")
    sheet.box(596, 24, 360, 200, "", GOAL)
    sheet.text(776, 52, "an update: 4 ended episodes", bold=True, anchor="middle")
    for row, line in enumerate((
        "1  relabel failures (indices, no copies)",
        "2  one extractor pass: episodes, goal images",
        "3  one LSTM pass: as lived, and relabelled",
        "4  weigh and sum the losses of the method",
        "5  one step of the optimiser",
    )):  # fmt: skip
        sheet.text(616, 84 + 27 * row, line, SOFT, 15)
    sheet.box(676, 290, 200, 84, "goal store\nlast pictures\nof successes")
    sheet.box(372, 290, 200, 84, "prototypes\nmean features\nof each class", GOAL)
    sheet.arrow("M226 102 h78")
    sheet.text(265, 92, "frames", SOFT, 13, anchor="middle")
    sheet.arrow("M512 102 h78")
    sheet.arrow("M776 226 v58")
    sheet.text(786, 262, "collect", SOFT, 13)
    sheet.arrow("M670 332 h-92")
    sheet.arrow("M366 332 C320 332 290 316 230 316", GOAL)
    sheet.text(300, 306, "goal", GOAL, 13, bold=True, anchor="middle")
    sheet.arrow("M590 200 C470 250 330 262 230 290")
    sheet.text(440, 232, "weights", SOFT, 13, anchor="middle")
    sheet.arrow("M90 264 V150")
    sheet.text(82, 212, "actions", SOFT, 13, anchor="end")
    sheet.arrow("M160 150 V264")
    sheet.text(168, 212, "observations", SOFT, 13)
    sheet.save("episode.svg")


WAY = 7
"""Seed of the room whose episode is shown."""

if __name__ == "__main__":
    hindsight()
    goals()
    network()
    way_of_an_episode()
