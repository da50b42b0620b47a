"""`mixer list`: the classes that a configuration may name."""

from __future__ import annotations

from textwrap import indent

from mixer_torch.commands.text import table
from mixer_torch.plugins import everything


def list_members() -> str:
    """List the scorers, solvers, datasets and other classes that a configuration may name.

    In a configuration the bare class name, such as IoU, will do for all that are listed.
    """
    blocks = []
    for kind, found in everything().items():
        rows = [[member.class_path, member.summary] for member in found] or [["none", ""]]
        blocks.append(f"{kind}\n{indent(table(rows, left=2), '  ')}")
    return "\n\n".join(blocks)
