"""`vhs play` writes films of episodes, and says what is missing for one."""

import shutil
import sys
from itertools import islice
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from vhs.acting.policy import load_agent
from vhs.acting.seeds import episode_seeds
from vhs.acting.setup import make_env
from vhs.cli import main
from vhs.show.moments import Moment, play_moments
from vhs.show.pictures import HEIGHT_PX, SIDE_PX, WIDTH_PX, draw


def moments(run: Path, episodes: int) -> list[list[Moment]]:
    agent = load_agent(run)
    env = make_env(agent.task, agent.spec, rendering=True)
    played: list[list[Moment]] = [[]]
    for moment in play_moments(agent, env, islice(episode_seeds(0, purpose=1), episodes), 0, greedy=False):
        played[-1].append(moment)
        if moment.outcome is not None:
            played.append([])
    return played[:-1]


def test_an_episode_has_one_moment_more_than_steps(run: Path) -> None:
    for episode in moments(run, 3):
        assert [moment.step for moment in episode] == list(range(len(episode)))
        assert all(m.outcome is None and m.action is not None for m in episode[:-1])
        assert episode[-1].outcome is not None
        assert episode[-1].action is None


def test_a_picture_shows_both_views_and_words(run: Path) -> None:
    first = moments(run, 1)[0][0]
    assert "interaction" in first.instruction  # Task 3
    picture = np.asarray(draw(first))
    assert picture.shape == (HEIGHT_PX, WIDTH_PX, 3)
    # The middle of a pixel of the robot's view, enlarged.
    scale = SIDE_PX / 84
    assert (picture[int(40.5 * scale), int(20.5 * scale)] == first.view[40, 20]).all()
    caption = picture[SIDE_PX + 30 :]
    assert (caption.max(axis=2) > 200).sum() > 500
    assert picture[:SIDE_PX, -SIDE_PX:].std() > 20


def test_a_gif_has_a_frame_a_moment(run: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    film = tmp_path / "film.gif"
    assert main(["play", str(run), "--episodes", "2", "--out", str(film)]) == 0
    expected = sum(len(episode) for episode in moments(run, 2))
    with Image.open(film) as gif:
        assert (gif.format, gif.n_frames, gif.size) == ("GIF", expected, (WIDTH_PX, HEIGHT_PX))
    assert f"{expected} frames" in capsys.readouterr().out
    assert list(tmp_path.iterdir()) == [film]


def test_the_same_seed_makes_the_same_film(run: Path, tmp_path: Path) -> None:
    for name in ("a.gif", "b.gif"):
        main(["play", str(run), "--episodes", "1", "--seed", "3", "--out", str(tmp_path / name)])
    assert (tmp_path / "a.gif").read_bytes() == (tmp_path / "b.gif").read_bytes()


def test_an_mp4_can_be_read_back(run: Path, tmp_path: Path) -> None:
    ffmpeg = pytest.importorskip("imageio_ffmpeg")
    film = tmp_path / "film.mp4"
    assert main(["play", str(run), "--episodes", "1", "--greedy", "--out", str(film)]) == 0
    frames = ffmpeg.read_frames(str(film))
    assert next(frames)["size"] == (WIDTH_PX, HEIGHT_PX)
    frames.close()


def test_mp4_without_an_encoder_says_what_to_install(
    run: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setitem(sys.modules, "imageio_ffmpeg", None)
    assert main(["play", str(run), "--out", str(tmp_path / "film.mp4")]) == 1
    assert "pip install 'vhs-rl[mp4]'" in capsys.readouterr().err


def test_without_display_and_out_there_is_a_sentence(
    run: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    pytest.importorskip("tkinter")
    monkeypatch.delenv("DISPLAY", raising=False)
    for options in ([], ["--human"]):
        assert main(["play", str(run), *options]) == 1
        told = capsys.readouterr().err
        assert "display" in told
        assert "--out FILE.gif" in told


def test_a_person_drives_the_room_of_a_run_from_another_machine(
    run: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    pytest.importorskip("tkinter")
    monkeypatch.delenv("DISPLAY", raising=False)
    text = (run / "config.yaml").read_text()
    (tmp_path / "config.yaml").write_text(text.replace("device: auto", "device: cuda:99"))
    assert main(["play", str(tmp_path), "--human"]) == 1
    assert "display" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (["--out", "film.avi"], "expected a name that ends in .gif or .mp4, found .avi"),
        (["--out", "nowhere/film.gif"], "expected an existing folder"),
        (["--out", "film.gif", "--human"], "--human: expected a window, found --out"),
    ],
)
def test_a_film_that_cannot_be_is_refused_before_anything_is_played(
    options: list[str], message: str, run: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:  # fmt: skip
    monkeypatch.chdir(tmp_path)
    assert main(["play", str(run), *options]) == 1
    assert message in capsys.readouterr().err
    assert not list(tmp_path.iterdir())


def test_a_run_without_checkpoint_is_a_clear_error(
    run: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    shutil.copy(run / "config.yaml", tmp_path)
    assert main(["play", str(tmp_path), "--out", str(tmp_path / "film.gif")]) == 1
    assert "expected a checkpoint" in capsys.readouterr().err
    assert main(["play", str(tmp_path / "none"), "--out", str(tmp_path / "film.gif")]) == 1
    assert "expected the directory of a run" in capsys.readouterr().err
