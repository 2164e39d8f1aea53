"""The command line, ``vhs COMMAND``: training, evaluation, comparison and what shows them.

Heavy imports wait until a command needs them, so that ``vhs --help`` answers at once.
"""

from __future__ import annotations

import argparse
import json
import math
import sys
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING

from vhs import VhsError, __version__
from vhs.console import Output
from vhs.distribution import find_agent, find_sweep, pip_install
from vhs.errors import ToldError

if TYPE_CHECKING:
    from vhs import Task

_RUN_OR_AGENT = (
    "directory of a run or of an exported agent, one of ours by name (task1, task2, task3), or one of the "
    "Hugging Face Hub (hf://user/name)"
)


def main(arguments: Sequence[str] | None = None) -> int:
    """Run a command; the exit status is 0, 1 for an explained error, 130 for a run that was stopped.

    A reader of standard output that leaves early (``vhs eval RUN | head -3``) is no error, and nothing that
    happens to standard output ends a training or a sweep; a result that could not be told is an error.
    """
    options = _parser().parse_args(arguments)
    options.arguments = list(sys.argv[1:] if arguments is None else arguments)
    out, errors = Output(), Output(sys.stderr)
    options.say, options.warn = out.say, errors.say
    try:
        status: int = options.run(options)
    except ModuleNotFoundError as error:
        if error.name is None or error.name.partition(".")[0] == "vhs":
            raise
        errors.say(f"vhs: {error.name} is not installed; {pip_install(options.extra)}")
        status = 1
    except ToldError:
        status = 1
    except VhsError as error:
        errors.say(f"vhs: {error}")
        status = 1
    except KeyboardInterrupt:  # of a training that has begun it is a signal to save
        errors.say("vhs: stopped")
        status = 130
    if out.failure is not None and not out.is_unread:
        errors.say(f"vhs: standard output: cannot write: {out.failure.strerror}")
        status = status or 1
    for output in (out, errors):
        output.abandon()
    return status


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="vhs", description="Hindsight goals for reinforcement learning from images."
    )
    parser.set_defaults(extra="train")
    parser.add_argument("--version", action="version", version=f"vhs {__version__}")
    commands = parser.add_subparsers(title="commands", required=True, metavar="COMMAND")
    _add_train(commands.add_parser("train", help="train an agent, or resume its training"))
    _add_eval(commands.add_parser("eval", help="measure a trained agent"))
    _add_export(
        commands.add_parser("export", help="write a trained agent to a directory small enough to ship")
    )
    _add_push(commands.add_parser("push", help="push a trained agent to the Hugging Face Hub, with a card"))
    _add_sweep(commands.add_parser("sweep", help="train and evaluate a grid of configurations, or search"))
    _add_compare(commands.add_parser("compare", help="compare trained agents over their seeds"))
    _add_play(commands.add_parser("play", help="watch a trained agent, or drive the robot"))
    _add_report(commands.add_parser("report", help="write a page about a run, or about several"))
    _add_bench(
        commands.add_parser(
            "bench", help="measure how fast this machine trains, where the time goes and what helps"
        )
    )
    return parser


def _add_train(parser: argparse.ArgumentParser) -> None:
    _add_config(parser)
    parser.add_argument(
        "--out", type=Path, metavar="DIR", help="directory of the run (default: runs/TASK-METHOD-seedN)"
    )
    parser.add_argument(
        "--from",
        dest="start_from",
        metavar="RUN",
        help="begin with the weights, prototypes and goal images of a run or of an exported agent; short for "
        "--set train.start_from=RUN",
    )
    parser.add_argument(
        "--processes",
        type=_positive,
        default=1,
        metavar="N",
        help="train with so many processes on this machine; several machines: torchrun ... -m vhs train ...",
    )
    parser.set_defaults(run=_train)


def _add_eval(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("run_directory", type=_named, metavar="RUN", help=_RUN_OR_AGENT)
    parser.add_argument(
        "--episodes", type=_positive, default=300, metavar="N", help="episodes to play (default: 300)"
    )
    parser.add_argument("--seed", type=_seed, default=0, metavar="N", help="which episodes (default: 0)")
    parser.add_argument("--greedy", action="store_true", help="take the likeliest action instead of sampling")
    parser.add_argument("--json", action="store_true", help="print one JSON object")
    _add_task(parser)
    parser.set_defaults(run=_eval)


def _add_export(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("run_directory", type=Path, metavar="RUN", help="directory of a run")
    parser.add_argument("directory", type=Path, metavar="DIR", help="a new directory for the agent")
    _add_task(parser)
    parser.set_defaults(run=_export)


def _add_push(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "run_directory", type=find_agent, metavar="RUN", help="directory of a run or of an exported agent"
    )
    parser.add_argument("name", metavar="USER/NAME", help="where to; made where there is none yet")
    parser.add_argument(
        "--episodes",
        type=_positive,
        default=300,
        metavar="N",
        help="episodes to evaluate where the agent was not evaluated yet (default: 300)",
    )
    parser.add_argument("--private", action="store_true", help="a new repository is seen by its owner alone")
    _add_task(parser)
    parser.set_defaults(run=_push, extra="hub")


def _add_sweep(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "file",
        type=find_sweep,
        metavar="FILE",
        help="YAML sweep file, or one of ours by name: quick, paper, search (see docs/guides/sweeps.md)",
    )
    parser.add_argument(
        "--out", type=Path, metavar="DIR", help="directory of the runs (default: runs/NAME-OF-FILE)"
    )
    parser.add_argument("--jobs", type=_positive, metavar="N", help="runs side by side (default: one a core)")
    parser.add_argument(
        "--ray",
        metavar="ADDRESS",
        help="run on a Ray cluster: auto, host:port, or local for one on this machine",
    )
    parser.add_argument(
        "--set",
        action="append",
        default=[],
        metavar="KEY=VALUE",
        help="set one key for every run, over the file's `set`, under its grids; may be repeated",
    )
    parser.add_argument(
        "--list",
        action="store_true",
        help="print the runs as lines for a shell, to be started by something else, and start none",
    )
    parser.set_defaults(run=_sweep)


def _add_compare(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("runs", type=Path, nargs="+", metavar="RUN", help="a run, or a directory of runs")
    parser.add_argument(
        "--reference", metavar="RUN-OR-GROUP", help="what SRR and SEI refer to (default: the first group)"
    )
    parser.add_argument(
        "--rate", type=_share, default=0.743, metavar="X", help="success rate to reach (default: 0.743)"
    )
    parser.add_argument(
        "--out",
        type=Path,
        default=Path("runs/compare"),
        metavar="DIR",
        help="where compare.md, .csv and .json go (default: runs/compare)",
    )
    parser.set_defaults(run=_compare, extra="report")


def _add_play(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("run_directory", type=_named, metavar="RUN", help=_RUN_OR_AGENT)
    parser.add_argument(
        "--episodes", type=_positive, default=3, metavar="N", help="episodes to play (default: 3)"
    )
    parser.add_argument("--seed", type=_seed, default=0, metavar="N", help="which episodes (default: 0)")
    parser.add_argument("--greedy", action="store_true", help="take the likeliest action instead of sampling")
    parser.add_argument(
        "--out", type=Path, metavar="FILE", help="film to write, .gif or .mp4 (default: open a window)"
    )
    parser.add_argument(
        "--human",
        action="store_true",
        help="act by the keys of the task; in the rooms the arrow keys",
    )
    _add_task(parser)
    parser.set_defaults(run=_play, extra="report")


def _add_report(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "path", type=Path, metavar="RUN-OR-DIRECTORY", help="a run, or a directory that holds some"
    )
    parser.add_argument(
        "--out", type=Path, metavar="FILE", help="HTML file (default: report.html in the directory)"
    )
    parser.add_argument(
        "--episodes", type=_positive, default=100, metavar="N", help="episodes to evaluate (default: 100)"
    )
    parser.add_argument("--seed", type=_seed, default=0, metavar="N", help="which episodes (default: 0)")
    _add_task(parser)
    parser.set_defaults(run=_report, extra="report")


def _add_bench(parser: argparse.ArgumentParser) -> None:
    _add_config(parser)
    parser.add_argument(
        "--seconds",
        type=_positive,
        default=2,
        metavar="N",
        help="of each of up to seven measurements, after a quarter as long to warm up (default: 2)",
    )
    parser.add_argument("--json", action="store_true", help="print one JSON object")
    parser.set_defaults(run=_bench)


def _add_task(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "--task",
        metavar="TASK",
        help="where the task of the run is now, as for `vhs train`",
    )


def _add_config(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "--task",
        metavar="TASK",
        help="task1, task2 or task3, or your own: FILE.py, package.module:name, or a YAML file with `task`",
    )
    parser.add_argument(
        "--config",
        type=Path,
        action="append",
        default=[],
        metavar="FILE",
        help="YAML overlay, or one of ours by name, as `task2` or `pg`; may be repeated",
    )
    parser.add_argument(
        "--set",
        action="append",
        default=[],
        metavar="KEY=VALUE",
        help="set one key, after all files; may be repeated",
    )


def _named(text: str) -> Path | str:
    """What is named as a RUN: a path, or an agent of the Hub, which is fetched when it is needed."""
    return text if text.startswith("hf://") else find_agent(text)


def _run_of(options: argparse.Namespace) -> Path:
    """The directory of a RUN, fetched if it is on the Hub."""
    if isinstance(options.run_directory, Path):
        return options.run_directory
    from vhs.runs.remote import fetch_agent

    options.extra = "hub"
    return fetch_agent(options.run_directory)


def _train(options: argparse.Namespace) -> int:
    from vhs.config import load_config
    from vhs.runs.directory import default_run_directory
    from vhs.train import train
    from vhs.world import is_rank, joined

    assigned = list(options.set)
    if options.start_from is not None:
        assigned.append(f"train.start_from={json.dumps(options.start_from)}")
    if options.processes > 1 and not is_rank():
        from vhs.world.launch import launch  # torch's launcher is slow to import, and talks on macOS

        load_config(options.config, assigned, task=options.task)  # what is wrong with it is told once
        return launch(options.processes, options.arguments)
    with joined() as world:
        with world.together():
            config = load_config(options.config, assigned, task=options.task)
        finished = train(config, options.out or default_run_directory(config), world=world)
    return 0 if finished else 130


def _eval(options: argparse.Namespace) -> int:
    from vhs.errors import OutputError
    from vhs.eval import evaluate, record_evaluation
    from vhs.runs.directory import is_exported

    run = _run_of(options)
    result = evaluate(
        run,
        episodes=options.episodes,
        seed=options.seed,
        greedy=options.greedy,
        task=_told_task(options, run),
    ).as_dict()
    try:
        # An exported agent is what it was when it was shipped, its evaluations too.
        if not is_exported(run):
            record_evaluation(run, result)
    except OutputError as error:
        # The result comes to the screen, so a run on a read-only disk is no failure.
        options.warn(f"vhs: {error}; the evaluation is not recorded")
    finally:
        if options.json:
            options.say(json.dumps(result))
        else:
            for name, value in result.items():
                options.say(f"{name} {value:.3f}" if isinstance(value, float) else f"{name} {value}")
    return 0


def _told_task(options: argparse.Namespace, run: Path) -> Task | None:
    """The task that `--task` names; None where it is not given."""
    if options.task is None:
        return None
    from vhs.acting.policy import told_task

    return told_task(run, options.task)


def _export(options: argparse.Namespace) -> int:
    from vhs.train.export import export_agent

    task = _told_task(options, options.run_directory)
    trained = export_agent(options.run_directory, options.directory, task)
    size = sum(path.stat().st_size for path in options.directory.iterdir())
    options.say(f"exported {options.directory} ({trained.trained_episodes} episodes, {size / 1e6:.1f} MB)")
    options.say(f"evaluate it:  vhs eval {options.directory}")
    return 0


def _push(options: argparse.Namespace) -> int:
    from vhs.hub import push

    task = _told_task(options, options.run_directory)
    address = push(
        options.run_directory, options.name, episodes=options.episodes, task=task, private=options.private
    )
    options.say(f"pushed {address}")
    options.say(f"evaluate it:  vhs eval hf://{options.name.removeprefix('hf://')}")
    return 0


def _sweep(options: argparse.Namespace) -> int:
    from vhs.sweep.listing import list_commands
    from vhs.sweep.runner import sweep

    out = options.out or Path("runs") / options.file.stem
    if options.list:
        lines, left_out = list_commands(options.file, out, options.set)
        for line in lines:
            options.say(line)
        if left_out:
            options.warn(left_out)
        return 0
    # A second Ctrl-C, or one while nothing runs, ends the runs, which resume from their checkpoints.
    return sweep(options.file, out, options.jobs, overrides=options.set, ray=options.ray)


def _compare(options: argparse.Namespace) -> int:
    from vhs.eval.compare import compare
    from vhs.eval.tables import as_markdown, write_comparison

    comparison = compare(options.runs, rate=options.rate, reference=options.reference)
    try:
        write_comparison(comparison, options.out)
    finally:
        options.say(as_markdown(comparison))
    return 0


def _share(text: str) -> float:
    try:
        number = float(text)
    except ValueError:
        number = math.nan
    if not 0 < number <= 1:
        raise argparse.ArgumentTypeError(f"expected a share above 0 and up to 1, found {text}")
    return number


def _play(options: argparse.Namespace) -> int:
    from vhs.play import play

    run = _run_of(options)
    done = play(
        run,
        episodes=options.episodes,
        seed=options.seed,
        greedy=options.greedy,
        out=options.out,
        is_human=options.human,
        task=_told_task(options, run),
    )
    options.say(done)
    return 0


def _report(options: argparse.Namespace) -> int:
    from vhs.report import report

    task = _told_task(options, options.path)
    options.say(report(options.path, options.out, episodes=options.episodes, seed=options.seed, task=task))
    return 0


def _bench(options: argparse.Namespace) -> int:
    from vhs.config import load_config
    from vhs.train.bench import bench

    config = load_config(options.config, options.set, task=options.task)
    options.warn(f"measuring for about {10 * options.seconds} seconds, and until a goal is reached")
    speed = bench(config, options.seconds)
    if options.json:
        options.say(json.dumps(asdict(speed)))
        return 0
    options.say(
        f"{speed.task}, {speed.method}; {speed.cores} cores, {speed.threads} thread(s), {speed.precision}"
    )
    options.say(f"environments alone {speed.environments_steps_per_s:7.0f} steps/s")
    options.say(f"training           {speed.steps_per_s:7.0f} steps/s, {speed.episodes_per_s:.0f} episodes/s")
    options.say(
        f"{config.train.episodes} episodes take about {speed.minutes:.0f} minutes, if they stay as long"
    )
    parts = ", ".join(f"{part} {share:.0%}" for part, share in speed.shares.items())
    options.say(f"of the time: {parts}")
    for trial in speed.trials:
        options.say(f"{trial.steps_per_s:7.0f} steps/s with {trial.said}")
    for sentence in speed.advice:
        options.say(sentence)
    return 0


def _positive(text: str) -> int:
    return _whole(text, 1)


def _seed(text: str) -> int:
    return _whole(text, 0)


def _whole(text: str, least: int) -> int:
    try:
        number = int(text)
    except ValueError:
        number = least - 1
    if number < least:
        raise argparse.ArgumentTypeError(f"expected a whole number of at least {least}, found {text}")
    return number


if __name__ == "__main__":
    sys.exit(main())
