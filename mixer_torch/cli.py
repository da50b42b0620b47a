"""The command ``mixer``: associate observations, or take the steps of it one by one."""

from __future__ import annotations

import argparse
import inspect
import os
import sys
from collections.abc import Callable, Sequence
from importlib import resources
from pathlib import Path

from jsonargparse import ArgumentParser

from mixer_torch.commands.associate import associate, score, solve
from mixer_torch.commands.bench import bench
from mixer_torch.commands.evaluate import evaluate
from mixer_torch.commands.members import list_members
from mixer_torch.commands.track import track
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
"""Parameters of commands that are not arguments: :func:`main` fills them in."""
DEFAULTS = {"demo": "parking_lot.yaml", "track": "mot.yaml"}
"""What a command takes from where the arguments do not say otherwise, in the folder `configs`."""
SWITCHES = ("--ablate", "--video", "--quick", "--from_rows")
POSITIONAL = ("solve", "evaluate", "bench")
"""Commands whose required arguments go without a name."""
REPEATED = {"track": ("sequences", "Folders, as they are or inside $MIXER_DATA.")}
"""The parameter of a command that takes all arguments without a name, and what they are."""
SHARED = {"dataset", "scorers", "solver", "pairs", "fusion", "ablate", "video", "device", "tracker"}
"""Options that one file may hold for all commands; one that has no use for them lets them by."""


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


def build_parsers() -> tuple[ArgumentParser, dict[str, ArgumentParser]]:
    """The parser of ``mixer``, and those of its commands by name."""
    parser = ArgumentParser(prog="mixer", description=__doc__)
    subcommands = parser.add_subcommands(required=True, metavar="COMMAND")
    parsers = {}
    for name, command in COMMANDS.items():
        parsers[name] = _command_parser(name, command)
        summary = SUMMARIES.get(name) or (inspect.getdoc(command) or "").splitlines()[0]
        subcommands.add_subcommand(name, parsers[name], help=summary)
    return parser, parsers


def _command_parser(name: str, command: Callable[..., str]) -> ArgumentParser:
    default = resources.files("mixer_torch.configs") / DEFAULTS.get(name, "")
    parser = ArgumentParser(default_config_files=[str(default)] if name in DEFAULTS else [])
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
    """The arguments with `--ablate`, alone, as `--ablate true`, and the like for every switch.

    The result to evaluate goes without a name, and may have its name, `--result`, all the same.
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
    """So that `my_scorer.Depth` of a file in the current folder can be named; ours come first."""
    if os.getcwd() not in sys.path:
        sys.path.append(os.getcwd())


def _message(error: Exception) -> str:
    text = error.args[0] if isinstance(error, KeyError) and error.args else error
    return str(text) or type(error).__name__
