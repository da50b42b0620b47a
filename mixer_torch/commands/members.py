"""What a configuration may name."""

from __future__ import annotations

from mixer_torch.plugins import KINDS, members


def list_members() -> str:
    """List the scorers, solvers, datasets and the rest that a configuration may name."""
    blocks = []
    for kind in KINDS:
        found = members(kind)
        width = max((len(member.class_path) for member in found), default=0)
        rows = [f"  {member.class_path:<{width}}  {member.summary}" for member in found]
        blocks.append("\n".join([kind.name, *(rows or ["  none"])]))
    return "\n\n".join(blocks)
