"""The command ``mixer``: associate observations, or take the steps of it one by one.

Each command is a function in ``mixer_torch.commands``. Its signature is what the command accepts,
its docstring is the help, and the text that it returns is printed.
"""

from __future__ import annotations

import argparse
import inspect
import os
import re
import sys
from collections.abc import Callable, Sequence
from importlib import import_module, resources
from pathlib import Path
from typing import Any, NoReturn

from jsonargparse import ArgumentParser

from mixer_torch.commands.associate import associate, score, solve
from mixer_torch.commands.bench import bench
from mixer_torch.commands.evaluate import evaluate
from mixer_torch.commands.members import list_members
from mixer_torch.commands.track import track
from mixer_torch.extras import require
from mixer_torch.plugins import everything, near
from mixer_torch.progress import Bars

COMMANDS: dict[str, Callable[..., str]] = {
    "demo": associate,
    "associate": associate,
    "score": score,
    "solve": solve,
    "track": track,
    "evaluate": evaluate,
    "bench": bench,
    "list": list_members,
}
SUMMARIES = {"demo": "Run `associate` on the parking lot that comes with the project."}
GIVEN = ("config", "progress")
"""Parameters of commands that :func:`main` fills in; they are no options."""
DEFAULTS = {"demo": "parking_lot.yaml", "track": "track.yaml"}
"""The file in the folder `configs` that a command starts from."""
SWITCHES = ("--ablate", "--video", "--quick", "--from_rows")
"""Options that may be given without a value, which then means true."""
POSITIONAL = ("solve", "evaluate", "bench")
"""Commands whose required arguments are given without their names."""
REPEATED = {"track": ("sequences", "Folders and files, as they are or inside $MIXER_DATA.")}
"""The parameter that takes all arguments which are given without a name, and its help."""
SHARED = {"dataset", "scorers", "solver", "pairs", "fusion", "ablate", "video", "device", "tracker"}
"""Shared options; commands ignore those that they do not use, so that one file serves them all."""
UNKNOWN_CLASS = (
    re.compile(r"Expected a dot import path string: (?P<name>\S+)"),
    re.compile(r"Problem with given class_path '(?P<name>[^']+)':"),
)
"""How jsonargparse says that it finds no class of a name."""


class Parser(ArgumentParser):
    """A parser whose message for an unknown class name lists the names that are near to it."""

    def error(self, message: str, *args: Any, **kwargs: Any) -> NoReturn:
        for pattern in UNKNOWN_CLASS:
            if found := pattern.search(message):
                message = message.replace(found[0], near(found["name"]))
        super().error(message, *args, **kwargs)


def main(argv: Sequence[str] | None = None) -> int:
    """Run one command.

    Args:
        argv: The arguments; those of the process if None.

    Returns:
        The exit code: 0, or 2 where the input is at fault, with one message on standard error.
        Set MIXER_TRACEBACK=1 to see where it came from.
    """
    _make_current_folder_importable()
    parser, parsers = build_parsers()
    arguments = parser.parse_args(_spelled_out(sys.argv[1:] if argv is None else argv))
    name = arguments.subcommand
    command = COMMANDS[name]
    config = parsers[name].dump(arguments[name], skip_unset=False)
    try:
        with Bars() as bars:
            given = {"config": config, "progress": bars}
            wanted = inspect.signature(command).parameters
            chosen = parsers[name].instantiate(arguments[name])
            chosen = {key: chosen[key] for key in wanted if key not in GIVEN}
            text = command(**chosen, **{key: given[key] for key in GIVEN if key in wanted})
    except (ValueError, KeyError, TypeError, OSError, ImportError) as error:
        if os.environ.get("MIXER_TRACEBACK"):
            raise
        print(f"mixer {name}: error: {_message(error)}", file=sys.stderr)
        return 2
    except KeyboardInterrupt as stop:
        print(f"mixer {name}: interrupted{': ' * bool(stop.args)}{stop}", file=sys.stderr)
        return 130
    print(text)
    return 0


def train(argv: Sequence[str] | None = None) -> int:
    """Run ``mixer-train``, or say which extra it needs; the arguments are as for :func:`main`."""
    try:
        require("lightning", extra="train")
        require("pytorch_metric_learning", extra="train")
    except ImportError as error:
        print(f"mixer-train: error: {error}", file=sys.stderr)
        return 2
    run: Callable[..., int] = import_module("mixer_torch.train.cli").main
    return run(argv)


def build_parsers() -> tuple[Parser, dict[str, Parser]]:
    """The parser of ``mixer``, and those of its commands by name."""
    everything()  # makes bare class names known to them
    parser = Parser(prog="mixer", description=(__doc__ or "").splitlines()[0])
    subcommands = parser.add_subcommands(required=True, metavar="COMMAND")
    parsers = {}
    for name, command in COMMANDS.items():
        parsers[name] = _command_parser(name, command)
        summary = SUMMARIES.get(name) or (inspect.getdoc(command) or "").splitlines()[0]
        subcommands.add_subcommand(name, parsers[name], help=summary)
    return parser, parsers


def _command_parser(name: str, command: Callable[..., str]) -> Parser:
    default = resources.files("mixer_torch.configs") / DEFAULTS.get(name, "")
    parser = Parser(default_config_files=[str(default)] if name in DEFAULTS else [])
    if name == "list":
        return parser
    parser.add_argument("--config", action="config", help="File with any of the options below.")
    parameters = set(inspect.signature(command).parameters)
    given: set[str | int] = {key for key in GIVEN if key in parameters}
    if name in REPEATED:
        several, meaning = REPEATED[name]
        parser.add_argument(several, nargs="+", type=Path, help=meaning)
        given.add(several)
    parser.add_function_arguments(command, as_positional=name in POSITIONAL, skip=given)
    if name == "demo":
        parser.set_defaults({"out": "out/demo"})
    for key in sorted(SHARED - parameters):
        parser.add_argument(
            f"--{key}", type=dict | list | bool | str | None, help=argparse.SUPPRESS
        )
    return parser


def _spelled_out(argv: Sequence[str]) -> list[str]:
    """The arguments with `--ablate` spelled out as `--ablate true`, and so for every switch.

    `--result FILE` of `mixer evaluate` becomes the argument without a name that it stands for.
    """
    words = []
    for word, following in zip(argv, [*argv[1:], "--"], strict=True):
        if word == "--result":
            continue
        words.append(word.removeprefix("--result="))
        if word in SWITCHES and following.startswith("-"):
            words.append("true")
    return words


def _make_current_folder_importable() -> None:
    """Let a configuration name `my_scorer.Depth` of a file in the current folder.

    The folder comes last, so that no file in it hides an installed module.
    """
    if os.getcwd() not in sys.path:
        sys.path.append(os.getcwd())


def _message(error: Exception) -> str:
    text = error.args[0] if isinstance(error, KeyError) and error.args else error
    return str(text) or type(error).__name__
